"""Cars spoofed into scans of an HDL-64E: published defences compared with detectors III and IV."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d import authenticate
from manip3d.experiments import _roc
from manip3d.experiments._lidar_attacks import Target, appended, as_written, on_firings
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row
from manip3d.forge import MAX_SPOOFED
from manip3d.lidar import Box, box_corners

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from manip3d.experiments._lidar_attacks import Points

    Floats = NDArray[np.float64]

FIRST_STREET, DONORS = 91_000, 92_000
"""First streets of the scans, and of the cars whose returns are replayed. No threshold was chosen
on them."""
STREETS, STREETS_PER_CASE = {"full": 60, "quick": 2}, {"full": 10, "quick": 2}
MIN_RETURNS = 20
"""Smallest number of returns of a genuine or replayed car."""
GENUINE_RANGES, SPOOFED_RANGES = (5.0, 40.0), (5.0, 8.0)
"""Distances of the centre of a car, metres. Spoofed cars appear directly in front of the victim
[Sun et al., 2020]."""
WITHIN = math.radians(10.0)
"""Largest azimuth of a spoofed car to either side of straight ahead, radians."""

CELL = 0.25
"""Side of the cells of free space, metres."""
ALPHA = 0.25
"""Weight of a return at the far end, or at the lateral edge, of a shadow [Hau et al., 2021]."""
SENSOR_HEIGHT = 1.73
"""Height of KITTI's scanner above the ground, metres."""
LONGEST_SHADOW = 30.0
"""Largest length of a shadow, metres; used for cars as tall as the scanner or taller."""


class View(NamedTuple):
    """Frustum of a box seen from the scanner, with its returns.

    Attributes
    ----------
    points : (N, 3) float64
        Returns within the box's range of azimuth and elevation.
    ranges : (N,) float64
        Distances of these returns, metres.
    nearest, farthest : float
        Distances of the nearest and farthest corner of the box, metres.
    """

    points: Floats
    ranges: Floats
    nearest: float
    farthest: float


def _azimuths(points: Floats, box: Box) -> Floats:
    """Return azimuths relative to the centre of the box, radians, in [-pi, pi)."""
    middle = math.atan2(box.center[1], box.center[0])
    turned = np.arctan2(points[:, 1], points[:, 0]) - middle
    return np.asarray(np.mod(turned + math.pi, 2.0 * math.pi) - math.pi)


def _elevations(points: Floats) -> Floats:
    return np.asarray(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))


def view_of(points: Points, box: Box) -> View:
    """Return the frustum of a box: the returns within its range of azimuth and elevation."""
    every, corners = points.astype(np.float64), box_corners(box)
    inside = np.ones(len(every), bool)
    for of_points, of_corners in (
        (_azimuths(every, box), _azimuths(corners, box)),
        (_elevations(every), _elevations(corners)),
    ):
        inside &= (of_points >= of_corners.min()) & (of_points <= of_corners.max())
    seen = every[inside]
    away = np.linalg.norm(corners, axis=1)
    return View(seen, np.linalg.norm(seen, axis=1), float(away.min()), float(away.max()))


def penetration(points: Points, box: Box) -> float:
    """Return CARLO's g, the share of the returns of a box's frustum that lie behind the box."""
    view = view_of(points, box)
    return float(np.mean(view.ranges > view.farthest)) if len(view.ranges) else 0.0


def free_space(points: Points, box: Box) -> float:
    """Return CARLO's f, the share of a box's cells that a laser passed on its way to a return."""
    view = view_of(points, box)
    counts = np.maximum(1, np.ceil(np.asarray(box.size) / CELL)).astype(np.int64)
    passed = np.zeros(counts, bool)
    for range_ in np.arange(view.nearest, view.farthest, 0.4 * CELL):
        on = view.ranges > range_ + 0.5 * CELL
        there = view.points[on] * (range_ / view.ranges[on])[:, None] - np.asarray(box.center)
        cos, sin = math.cos(box.yaw), math.sin(box.yaw)
        along = cos * there[:, 0] + sin * there[:, 1]
        across = cos * there[:, 1] - sin * there[:, 0]
        shares = np.column_stack([along, across, there[:, 2]]) / np.asarray(box.size) + 0.5
        cells = np.floor(shares * counts).astype(np.int64)
        cells = cells[((cells >= 0) & (cells < counts)).all(axis=1)]
        passed[tuple(cells.T)] = True
    return float(passed.mean())


def shadow(points: Points, box: Box) -> float:
    """Return the score of Shadow-Catcher, a weighted mean over the returns in a box's shadow.

    The weight of a return decreases with its distance from the start of the shadow and from the
    shadow's middle line. A shadow without returns has a score of 0.
    """
    every, corners = points.astype(np.float64), box_corners(box)
    azimuths, rho = _azimuths(every, box), np.hypot(every[:, 0], every[:, 1])
    half = float(np.abs(_azimuths(corners, box)).max())
    start = float(np.hypot(corners[:, 0], corners[:, 1]).max())
    top = box.center[2] + 0.5 * box.size[2]  # height relative to the scanner, metres
    length = start * (SENSOR_HEIGHT / -top - 1.0) if top < 0.0 else LONGEST_SHADOW
    length = min(length, LONGEST_SHADOW)
    covered = (np.abs(azimuths) < half) & (rho > start) & (rho < start + length)
    covered &= every[:, 2] < rho * (top / start)  # below the ray over the far upper edge
    if not covered.any():
        return 0.0
    to_start, to_middle = (rho[covered] - start) / length, np.abs(azimuths[covered]) / half
    mean = float(np.mean(ALPHA**to_start * ALPHA**to_middle))
    return (mean - ALPHA**2) / (1.0 - ALPHA**2)


PUBLISHED: Mapping[str, Callable[[Points, Box], float]] = MappingProxyType(
    {
        "CARLO, laser penetration": penetration,
        "CARLO, free space": free_space,
        "Shadow-Catcher": shadow,
    }
)
"""Scores of a box of a scan; a larger score is stronger evidence against a genuine car."""

OURS = ("III, alone", "IV, turns before and after")

ATTACKS: Mapping[str, Callable[[Target], Points]] = MappingProxyType(
    {"appended": appended, "on firings": on_firings}
)
"""Ways to insert replayed returns: appended as points, or only where firings could see them."""


class _Turns(NamedTuple):
    """A scan, the previous and the next one, and the boxes of the genuine cars."""

    before: Points
    scan: Points
    after: Points
    cars: tuple[Box, ...]


def _turns(number: int) -> _Turns:
    from manip3d import simulate

    start = float(np.random.default_rng(number).uniform(0.5, 10.0))
    street = simulate.street(number)
    frames = [*simulate.drive(street, 3, start=start, pictures=False, rng=number, threads=1)]
    before, scan, after = (frame.scan.points for frame in frames)
    cars = tuple(
        box
        for box in frames[1].boxes
        if box.label == "Car"
        and GENUINE_RANGES[0] < math.hypot(*box.center[:2]) < GENUINE_RANGES[1]
        and np.count_nonzero(_wider(box).contains(scan)) >= MIN_RETURNS
    )
    return _Turns(before, scan, after, cars)


def _wider(box: Box) -> Box:
    length, width, height = box.size
    return replace(box, size=(length + 0.1, width + 0.1, height + 0.1))


def _trace(number: int) -> tuple[Points, Box] | None:
    """Return the returns of a car and its box.

    None: no car of the street has few enough returns to be injected.
    """
    donor = _turns(number)
    random = np.random.default_rng(number)
    for box in donor.cars:
        returns = donor.scan[_wider(box).contains(donor.scan)]
        if len(returns) > MAX_SPOOFED:
            continue
        return returns[np.sort(random.permutation(len(returns)))], box
    return None


def _spoofed_box(box: Box, target: Target) -> Box:
    """Return the box of a replayed car, turned and moved like its returns."""
    center = target.hoax.mean(axis=0, dtype=np.float64)
    turn = target.azimuth - math.atan2(center[1], center[0])
    away = target.distance - math.hypot(center[0], center[1])
    cos, sin = math.cos(turn), math.sin(turn)
    x = cos * box.center[0] - sin * box.center[1] + away * math.cos(target.azimuth)
    y = sin * box.center[0] + cos * box.center[1] + away * math.sin(target.azimuth)
    return Box((x, y, box.center[2]), box.size, box.yaw + turn)


def run_streets(case: Case) -> Row:
    """Score the genuine cars of streets, and a car spoofed into each street."""
    first, streets = case.options["first"], case.options["streets"]
    lattice = authenticate.kitti_lattice()
    scores: dict[str, list[list[float]]] = {name: [] for name in ("genuine", *ATTACKS)}
    for number in range(first, first + streets):
        turns, trace = _turns(number), _trace(number - FIRST_STREET + DONORS)
        scores["genuine"] += _scores(turns, turns.scan, turns.cars, lattice)
        if trace is None:
            continue
        random = np.random.default_rng(number)
        target = Target(
            turns.scan, trace[1], trace[0], float(random.uniform(*SPOOFED_RANGES)),
            float(random.uniform(-WITHIN, WITHIN)), lattice, number,
        )  # fmt: skip
        box = _spoofed_box(trace[1], target)
        for name, attack in ATTACKS.items():
            scores[name] += _scores(turns, as_written(attack(target), lattice), [box], lattice)
    return {
        **{name: values for name, values in scores.items()},
        **{f"{name} cars": len(values) for name, values in scores.items()},
    }


def _scores(
    turns: _Turns,
    scan: Points,
    boxes: Sequence[Box],
    lattice: authenticate.SensorLattice,
) -> list[list[float]]:
    """Return scores for each box: those of published defences, then of detectors III and IV."""
    if not boxes:
        return []
    generic = authenticate.generic_consistency(
        scan, lattice=lattice, false_alarm_rate=0.999, threads=1
    )
    beside = authenticate.turn_consistency(
        scan, turns.before, turns.after, lattice=lattice, false_alarm_rate=0.999, threads=1
    )
    found = []
    for box in boxes:
        inside = _wider(box).contains(scan)
        of_generic = [
            -math.log10(max(region.p_value, 1e-300))
            for region in generic.regions
            if inside[region.rows].any()
        ]
        of_turns = [region.strength for region in beside.regions if inside[region.rows].any()]
        found.append(
            [
                *(score(scan, box) for score in PUBLISHED.values()),
                max(of_generic, default=0.0),
                max(of_turns, default=0.0),
            ]
        )
    return found


def _cases(plan: Plan) -> list[Case]:
    if plan.data == "real":
        return []
    block, start = STREETS_PER_CASE[plan.scale], plan.street(FIRST_STREET)
    return [
        Case(
            run_streets,
            {
                "model": f"streets {first} to {first + block - 1}",
                "first": first,
                "streets": block,
                "data": "simulated",
                "role": "simulated streets",
            },
        )
        for first in range(start, start + STREETS[plan.scale], block)
    ]


def _pooled(rows: Sequence[Row], kind: str) -> Floats:
    """Return (N, 5) the scores of all cars of a kind."""
    every = [score for row in rows for score in row.get(kind, ())]
    return np.asarray(every, np.float64).reshape(-1, len(PUBLISHED) + len(OURS))


def _beside(rows: Sequence[Row]) -> Iterator[Finding]:
    genuine = _pooled(rows, "genuine")
    for attack in ATTACKS:
        spoofed = _pooled(rows, attack)
        if not len(genuine) or not len(spoofed):
            continue
        for column, name in enumerate((*PUBLISHED, *OURS)):
            clean, forged = genuine[:, column], spoofed[:, column]
            # For fewer than 100 clean scores, this is the largest of them.
            limit = float(np.quantile(clean, 0.99, method="higher"))
            found = int(np.count_nonzero(forged > limit))
            yield Finding(
                f"{attack}: {name}",
                None,
                f"AUC {_roc.auc(clean, forged):.3f}; {found} of {len(forged)} spoofed cars above "
                f"99 % of {len(clean)} genuine ones",
            )


def figures(rows: Sequence[Row]) -> dict[str, Figure]:
    """Draw ROC curves, one figure for each way to insert the returns."""
    from matplotlib.figure import Figure

    genuine = _pooled(rows, "genuine")
    drawn = {}
    for attack in ATTACKS:
        spoofed = _pooled(rows, attack)
        if not len(genuine) or not len(spoofed):
            continue
        figure = Figure(figsize=(6.4, 5.2), layout="constrained")
        axes = figure.add_subplot()
        for column, name in enumerate((*PUBLISHED, *OURS)):
            clean, forged = genuine[:, column].tolist(), spoofed[:, column].tolist()
            label = f"{name}: {_roc.auc(clean, forged):.3f}"
            style = "-" if name in OURS else "--"
            axes.plot(*_roc.curve(clean, forged), style, label=label)
        axes.set(
            title=f"Spoofed cars, returns {attack}",
            xlabel="share of genuine cars called spoofed",
            ylabel="share of spoofed cars found",
        )
        axes.grid(alpha=0.3)
        axes.legend(title="area under the curve", fontsize="small")
        drawn[f"returns {attack}"] = figure
    return drawn


EXPERIMENT = Experiment(
    id="spoofing-6",
    title="Spoofed cars: CARLO, Shadow-Catcher and detectors III and IV",
    published="",
    data=(),
    cases=_cases,
    columns=(
        Column("model", "streets"),
        Column("genuine cars", "genuine cars"),
        *(Column(f"{attack} cars", f"spoofed, {attack}") for attack in ATTACKS),
    ),
    claims=(Claim("Side by side", "aim: none", _beside, together=True, reported=True),),
    figures=figures,
    notes=(
        "Returns of a car (at most 200, as one laser beside the road injects) are replayed at 5 to "
        "8 m, within 10 degrees of straight ahead, in one turn. The published defences ask whether "
        "a box that an object detector gives is a car. They are given the true boxes here, which "
        "no detector would give as well: genuine cars of at least 20 returns within 40 m, whatever "
        "hides them, and the box of the replayed car. Detectors III and IV are given no box; the "
        "strongest region with a return in it counts. CARLO's ratios are those of Sun et al. "
        "(USENIX Security 2020), with cells of 0.25 m, each ratio by itself; the score of "
        "Shadow-Catcher is that of Hau et al. (2021), with its first threshold, on the number of "
        "returns, left out. SVF and 3D-TC2 are trained networks and are not rebuilt. "
        "Regions of detector IV that clean frames often show as strong do not count.",
    ),
)
