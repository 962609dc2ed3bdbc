"""Common parts of tables 6.1 and 6.2: simulated scans, their forgeries, and two detectors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import authenticate, datasets, forge, metrics
from manip3d.experiments._model import Case, Column, Finding, Plan, Row, counted
from manip3d.lidar import Box

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Points = NDArray[np.float32]

HOAXES = ("bun_zipper", "dragon_45k")
CLASSES = ("original", "CTP", "CRTP")
DETECTORS = ("I", "II")

# Numbers of forged scenes, as published: 13 outdoor and 8 indoor scenes by CTP, 7 and 5 by CRTP,
# each with both hoaxes; and 10 subtractive and deforming forgeries, five of each kind.
_FORGED = {
    ("outdoor", "CTP"): 13,
    ("outdoor", "CRTP"): 7,
    ("indoor", "CTP"): 8,
    ("indoor", "CRTP"): 5,
}
_EDITED = {
    "outdoor": ("subtractive", "subtractive", "subtractive", "deforming", "deforming"),
    "indoor": ("subtractive", "subtractive", "deforming", "deforming", "deforming"),
}

# Largest extent of a hoax, and its distances from the scanner; metres.
_SIZE = {"outdoor": 1.0, "indoor": 0.3}
_DISTANCE = {"outdoor": (10.0, 20.0), "indoor": (2.0, 3.5)}
_DENT = 0.1
_RESOLUTION = {"full": 0.06, "quick": 0.2}
_QUICK = 2
"""Number of scenes of each kind in a quick run."""


def resolution_note(rows: Sequence[Row]) -> str:
    """Return the note about the number of scans and their resolution."""
    steps = sorted({row["resolution_deg"] for row in rows})
    fineness = " and ".join(f"{step:g}" for step in steps)
    return f"This run: {counted(len(rows), 'scan')} with {fineness} degrees between rays."


NOTE = (
    "The scans are simulated (manip3d.simulate.scenes, 3 mm range noise); the published ones are "
    "of another scanner's data. Hoaxes stand on the "
    "ground, 1 m large at 10 to 20 m outdoors and 0.3 m large at 2 to 3.5 m indoors. Thresholds "
    "were fixed on the scenes named calibration-*, on which nothing is reported; those of detector "
    "I a second time, on twice as many of them, after a first run of this table."
)


TOO_FEW = "a quick run has too few scans to judge this"


def finding(rows: Sequence[Row], subject: str, holds: bool, numbers: str) -> Finding:
    """Return a finding on these rows; those of a quick run judge nothing."""
    if any(row["scale"] == "quick" for row in rows):
        return Finding(subject, None, numbers, unjudged=TOO_FEW)
    return Finding(subject, holds, numbers)


def role(real: bool) -> str:
    """Return the description of the scans and the hoaxes."""
    hoaxes = " and ".join(HOAXES) if real else "a ball and a knot in the place of Stanford models"
    return f"simulated scan in the place of the published one; hoaxes: {hoaxes}"


def cases(plan: Plan) -> list[Case]:
    """Return one case for each scene with all its forgeries, so that it is scanned only once."""
    from manip3d.simulate import scenes

    real = plan.data != "simulated" and all(datasets.is_here(datasets.get(name)) for name in HOAXES)
    if plan.data == "real" and not real:
        datasets.require(datasets.get(HOAXES[0]).files[0], HOAXES[0])
    return [
        Case(
            judge_scene,
            {
                "model": name,
                "kind": kind,
                "number": number,
                "hoaxes": list(HOAXES) if real else ["ball", "knot"],
                "data": "simulated",
                "role": role(real),
                "scale": plan.scale,
                "resolution_deg": _RESOLUTION[plan.scale],
                "seed": plan.seed,
            },
            inputs=HOAXES if real else (),
        )
        for kind, names in (("outdoor", scenes.OUTDOOR), ("indoor", scenes.INDOOR))
        for number, name in enumerate(names)
        if plan.scale == "full" or number < _QUICK
    ]


def judge_scene(case: Case) -> Row:
    """Scan a scene, forge the scan, and let both detectors judge the scan and its forgeries."""
    options = case.options
    random = np.random.default_rng([options["seed"], options["number"]])
    points = scan_of(options)
    judged = [_judge(points, attack="original")]
    for attack, hoax, front, forged in _forgeries(points, options, random):
        judged.append(
            _judge(forged.points, attack=attack, hoax=hoax, front=front, touched=forged.num_touched)
        )
    return {"points": len(points), "judged": judged}


def scan_of(options: Any) -> Points:
    """Return the simulated scan of a case."""
    from manip3d.simulate import scenes
    from manip3d.simulate.terrestrial import terrestrial_scan

    scan = terrestrial_scan(
        scenes.make(options["model"]),
        resolution_deg=options["resolution_deg"],
        rng=np.random.default_rng([options["seed"], 77, options["number"]]),
    )
    return scan.points


def _judge(points: Points, **about: Any) -> dict[str, Any]:
    distances = metrics.nearest_distances(points)
    density = authenticate.density_consistency(points, distances=distances)
    printed = authenticate.density_consistency(
        points, parameters=authenticate.PAPER_DENSITY, distances=distances
    )
    occlusion = authenticate.occlusion_consistency(points)
    literal = authenticate.occlusion_consistency(
        points,
        parameters=authenticate.PAPER_OCCLUSION,
        grid=authenticate.AngularGrid(occlusion.grid.azimuth_deg, occlusion.grid.elevation_deg),
    )
    return about | {
        "I": density.verdict,
        "I_score": density.score,
        "I_paper": printed.verdict,
        "II": occlusion.verdict,
        "II_score": occlusion.score,
        "II_paper": literal.verdict,
    }


def _forgeries(
    points: Points, options: Any, random: np.random.Generator
) -> Iterator[tuple[str, str, bool, forge.Forgery]]:
    kind, number = options["kind"], options["number"]
    for attack in ("CTP", "CRTP"):
        if number >= _FORGED[kind, attack]:
            continue
        for hoax in options["hoaxes"]:
            vertices, normals = open_hoax(hoax)
            scale = _SIZE[kind] / float(np.ptp(vertices, axis=0).max())
            place = free_place(points, kind, random)
            for front in (False, True):
                pasted = _facing(vertices, normals, scale, place) if front else vertices
                make = forge.ctp if attack == "CTP" else forge.crtp
                center = place + scale * (pasted.mean(axis=0) - vertices.mean(axis=0))
                center[2] += scale * float(vertices[:, 2].mean() - vertices[:, 2].min())
                yield attack, hoax, front, make(points, pasted, position=center, scale=scale)
    if number < len(_EDITED[kind]):
        attack = _EDITED[kind][number]
        box = object_box(points, kind)
        if attack == "subtractive":
            yield attack, "", False, forge.subtract(points, box)
        else:
            yield attack, "", False, forge.deform(points, box, amplitude=_DENT, rng=random)


def open_hoax(name: str) -> tuple[Points, Points]:
    """Return vertices (z up) and outward normals of a hoax: a Stanford model or a stand-in."""
    if name in HOAXES:
        mesh = datasets.load_mesh(name)
        vertices = mesh.vertices[:, [0, 2, 1]] * np.array([1.0, -1.0, 1.0])  # from y up to z up
        corners = vertices[mesh.faces]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals = np.zeros_like(vertices)
        for corner in range(3):
            np.add.at(normals, mesh.faces[:, corner], across)
        return vertices.astype(np.float32), normals.astype(np.float32)
    # A sphere with bumps, sampled evenly by a Fibonacci spiral.
    count = 35_947 if name == "ball" else 22_982
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    turn = math.pi * (1.0 + math.sqrt(5.0)) * index
    level = np.sqrt(1.0 - z * z)
    normal = np.column_stack([level * np.cos(turn), level * np.sin(turn), z])
    bumps = 1.0 + (0.1 if name == "ball" else 0.25) * np.sin(5 * normal[:, :1]) * normal[:, 2:]
    return (normal * bumps).astype(np.float32), normal.astype(np.float32)


def _facing(vertices: Points, normals: Points, scale: float, place: NDArray[np.float64]) -> Points:
    """Return the part of a hoax that faces the scanner in the origin."""
    to_scanner = -(place + scale * (vertices - vertices.mean(axis=0)))
    facing: Points = vertices[np.einsum("ij,ij->i", normals, to_scanner) > 0.0]
    return facing


def free_place(points: Points, kind: str, random: np.random.Generator) -> NDArray[np.float64]:
    """Find a free place on the ground for the hoax's lowest point, in the scan's coordinates."""
    size = _SIZE[kind]
    sample = points[:: max(1, len(points) // 400_000)].astype(np.float64)
    best: NDArray[np.float64] | None = None
    fewest = len(sample)
    for _ in range(200):
        distance, azimuth = random.uniform(*_DISTANCE[kind]), random.uniform(-math.pi, math.pi)
        x, y = distance * math.cos(azimuth), distance * math.sin(azimuth)
        near = np.hypot(sample[:, 0] - x, sample[:, 1] - y) < 0.75 * size
        if np.count_nonzero(near) < 5:
            continue
        heights = sample[near, 2]
        ground = float(np.quantile(heights, 0.1))
        if ground > 0.0:  # a surface above the scanner is a ceiling or a roof
            continue
        above = int(np.count_nonzero((heights > ground + 0.3 * size) & (heights < ground + size)))
        if above < fewest:
            best, fewest = np.array([x, y, ground]), above
        if above == 0:
            break
    if best is None:
        raise RuntimeError("no place for the hoax in this scan")
    return best


def object_box(points: Points, kind: str) -> Box:
    """Return the box of the first object that segmentation finds, or else a box of half a metre."""
    sample = points[:: max(1, len(points) // 200_000)]
    found = forge.segment(sample, max_range=30.0, tolerance=0.3 if kind == "outdoor" else 0.15)
    for box in found.boxes:
        if min(box.size) > 0.2 and max(box.size) < 4.0 and math.hypot(*box.center[:2]) > 1.5:
            return box
    middle = sample[len(sample) // 2].astype(float)
    return Box(tuple(middle.tolist()), (0.5, 0.5, 0.5))


# --- tables --------------------------------------------------------------------------------------

COLUMNS = (
    Column("points", "points"),
    *(
        Column(f"{detector}_{attack}", f"{detector}: {attack}")
        for detector in DETECTORS
        for attack in (*CLASSES, "subtractive", "deforming")
    ),
)


def complete(row: Row) -> Row:
    """Add to a row the number of correct verdicts of each detector and class."""
    counts = {
        f"{detector}_{attack}": _fraction(row, detector, attack)
        for detector in DETECTORS
        for attack in (*CLASSES, "subtractive", "deforming")
    }
    return row | counts


def _fraction(row: Row, detector: str, attack: str) -> str | None:
    right = [is_right(entry, detector) for entry in entries([row], attack)]
    return f"{sum(right)} of {len(right)}" if right else None


def entries(
    rows: Sequence[Row], attack: str, *, front: bool = False, kind: str = ""
) -> list[dict[str, Any]]:
    """Return the judged scans of a class: with whole hoaxes, or only with their fronts."""
    return [
        entry
        for row in rows
        if kind in ("", row.get("kind"))
        for entry in row.get("judged", ())
        if entry["attack"] == attack and bool(entry.get("front")) == front
    ]


def is_right(entry: dict[str, Any], detector: str) -> bool:
    """Return whether a verdict is correct; the verdict undecidable never is."""
    return bool(entry[detector] == ("no_trace" if entry["attack"] == "original" else "tampered"))


def accuracy(found: Sequence[dict[str, Any]], detector: str) -> float:
    """Return the percentage of correct verdicts."""
    return 100.0 * sum(is_right(entry, detector) for entry in found) / len(found)
