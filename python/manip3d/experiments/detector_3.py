"""Detector III on real and simulated frames of an HDL-64E: detection rates and false alarms."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import authenticate, forge
from manip3d._util.shares import upper_limit
from manip3d.authenticate import SensorLattice, estimate_lattice, generic_consistency
from manip3d.experiments import _published, _recorded, _roc
from manip3d.experiments._lidar_attacks import ADDING, OTHERS, Target, as_written
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row, counted
from manip3d.io import read_scan
from manip3d.lidar import Box

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from manip3d.experiments._lidar_attacks import Points

RAW = "lidar/kitti_raw/"
TUNING = tuple(
    f"{RAW}2011_09_26/2011_09_26_drive_0002_sync/velodyne_points/data/{number:010d}.bin.xz"
    for number in range(10)
)
"""Frames of the drive from which the lattice is estimated; it and the `DONORS` are in no test."""
DONORS = (
    RAW + "unidentified_drive_a/velodyne_points/data/0000000000.bin.xz",
    RAW + "2011_09_26/unidentified_drive_b/velodyne_points/data/0000000000.bin.xz",
)
"""Frames from which pasted objects are cut."""
DRIVE_5 = RAW + "2011_09_26/2011_09_26_drive_0005_sync/velodyne_points/data"

ALARM_RATE = 0.01
WITH_TIME = "with the frame before"
MIN_FORGERIES = 20
"""Smallest number of forgeries from which an area under a ROC curve is judged; quick runs have
fewer."""
RANGES = (5.0, 35.0)
"""Smallest and largest distance of changed or pasted objects from the scanner, metres."""

SIMULATED_STREETS, FRAMES_PER_STREET = {"full": 210, "quick": 4}, 5
STREETS_PER_CASE = {"full": 15, "quick": 2}
TUNING_STREET = 5000
"""First street from which the lattice of simulated frames is estimated; tests use streets from 0
on."""


@dataclass(frozen=True)
class Scene:
    """Frames of one place."""

    name: str
    files: tuple[str, ...]


def _frame(number: int) -> str:
    return f"{DRIVE_5}/{number:010d}.bin.xz"


SCENES = (
    Scene("drive 0005", tuple(_frame(i) for i in range(0, 20, 2))),
    *(
        Scene(f"stereo-2015 {name}", (f"lidar/kitti_stereo2015/velodyne/{name}.bin.xz",))
        for name in ("000083", "000124", "000131")
    ),
    Scene("object", ("lidar/kitti_object/velodyne/demo.bin.xz",)),
    Scene(
        "drive 0079",
        (RAW + "2011_09_26/2011_09_26_drive_0079_extract/velodyne_points/data/0000000000.bin.xz",),
    ),
)
"""Scenes of the test. Frame 10 of drive 0005 is the same as frame 000002 of stereo-2015."""
ODOMETRY = Scene(
    "odometry 00", tuple(f"lidar/kitti_odometry/00/velodyne/{i:06d}.bin.xz" for i in range(6))
)
TIMED = Scene("drive 0005, pairs", tuple(_frame(i) for i in range(20)))
"""Frames 1, 3, ... are judged together with their previous frames."""
_DATA_SETS = (
    "kitti_drive_0002",
    "kitti_drive_0005",
    "kitti_drive_0079",
    "kitti_unidentified_a",
    "kitti_unidentified_b",
    "kitti_stereo2015",
    "kitti_object",
    "kitti_odometry_00",
)
CHOSEN_ON = ("stereo-2015 000124",)
"""Scenes on whose frames a threshold was chosen; they are judged but count in no rate."""
OBJECTS = {"full": {"drive 0005": 3}, "quick": {}}
OBJECTS_OF_ONE_FRAME = {"full": 8, "quick": 2}


def _here(scene: Scene) -> bool:
    """Return whether the files of a scene, and those that every real case needs, are here."""
    return _recorded.are_here((*TUNING, *DONORS, *scene.files))


def _load(file: str) -> Points:
    return read_scan(_recorded.located(file)).points


def _read(scans: Sequence[str]) -> dict[str, Any]:
    """Return the options that name the judged scans and the hashes of all files of a real case."""
    return {"scans": list(scans), "files": _recorded.sums((*TUNING, *DONORS, *scans))}


@functools.cache
def _real_lattice() -> SensorLattice:
    return estimate_lattice([_load(file) for file in TUNING])


@functools.cache
def _street_frames(seed: int) -> tuple[Points, ...]:
    from manip3d.simulate.lidar import hdl64e
    from manip3d.simulate.streets import street

    place = street(seed)
    end = min(place.duration, 20.0)
    times = [end * (i + 0.5) / FRAMES_PER_STREET for i in range(FRAMES_PER_STREET)]
    return tuple(
        hdl64e(place, time, rng=1000 * seed + i, threads=1).points for i, time in enumerate(times)
    )


@functools.cache
def _simulated_lattice() -> SensorLattice:
    return estimate_lattice([_street_frames(TUNING_STREET + i)[2] for i in range(8)])


# Cases


_RECORDED = {"data": "recorded", "role": "recorded by an HDL-64E (KITTI)"}
_CLEAN = {"model": "clean, real", "attack": ""}
_REMOVING = "subtractive"


def cases(plan: Plan) -> list[Case]:
    """Return cases of clean scenes, attacks on each, odometry, and simulated streets."""
    real = plan.data != "simulated"
    made: list[Case] = []
    for scene in SCENES:
        if not (real and _here(scene)):
            continue
        files = scene.files if plan.scale == "full" else scene.files[:1]
        options: dict[str, Any] = {
            "scene": scene.name,
            **_read(files),
            "seed": plan.seed,
            **_RECORDED,
        }
        made.append(Case(run_clean, {**options, **_CLEAN}))
        per_frame = OBJECTS[plan.scale].get(scene.name, OBJECTS_OF_ONE_FRAME[plan.scale])
        made += [
            Case(
                run_attack,
                {**options, "model": attack, "attack": attack, "objects": per_frame},
            )
            for attack in (*ADDING, *OTHERS)
        ]
    if real and _here(TIMED):
        files = TIMED.files if plan.scale == "full" else TIMED.files[:2]
        per_frame = OBJECTS[plan.scale].get("drive 0005", OBJECTS_OF_ONE_FRAME[plan.scale])
        name = f"{_REMOVING}, {WITH_TIME}"
        options = {
            "scene": TIMED.name,
            **_read(files),
            "seed": plan.seed,
            **_RECORDED,
            "model": name,
            "attack": name,
            "objects": per_frame,
        }
        made.append(Case(run_timed, options))
    if real and _here(ODOMETRY):
        made.append(
            Case(
                run_clean,
                {
                    "scene": ODOMETRY.name,
                    **_read(ODOMETRY.files),
                    "seed": 0,
                    **_RECORDED,
                    **_CLEAN,
                },
            )
        )
    if plan.data != "real":
        made += _simulated_cases(plan)
    return made


def _simulated_cases(plan: Plan) -> list[Case]:
    """Return cases of clean simulated streets, several streets in each case."""
    block, start = STREETS_PER_CASE[plan.scale], plan.street(0)
    return [
        Case(
            run_simulated,
            {
                "model": "clean, simulated",
                "scene": f"streets {first} to {first + block - 1}",
                "attack": "",
                "data": "simulated",
                "role": "simulated streets",
                "first": first,
                "streets": block,
            },
        )
        for first in range(start, start + SIMULATED_STREETS[plan.scale], block)
    ]


def run_clean(case: Case) -> Row:
    """Judge the clean frames of a scene."""
    lattice = _real_lattice()
    frames = [_load(file) for file in case.options["scans"]]
    results = [generic_consistency(frame, lattice=lattice) for frame in frames]
    return {
        "frames": len(frames),
        "scores": [result.score for result in results],
        "verdicts": [result.verdict for result in results],
        "found": _share([result.verdict == "tampered" for result in results]),
        "dropped": sorted(
            {kind for r in results for kind, e in r.evidence.items() if not e.used} - {"time"}
        ),
        **_published_detectors(frames),
    }


def run_simulated(case: Case) -> Row:
    """Judge clean simulated frames."""
    lattice = _simulated_lattice()
    first, streets = case.options["first"], case.options["streets"]
    results = [
        generic_consistency(frame, lattice=lattice)
        for seed in range(first, first + streets)
        for frame in _street_frames.__wrapped__(seed)
    ]
    return {
        "frames": len(results),
        "scores": [result.score for result in results],
        "verdicts": [result.verdict for result in results],
        "found": _share([result.verdict == "tampered" for result in results]),
    }


def run_attack(case: Case) -> Row:
    """Judge forgeries of a scene's frames."""
    lattice = _real_lattice()
    attack = {**ADDING, **OTHERS}[case.options["attack"]]
    forgeries, distances = [], []
    for number, file in enumerate(case.options["scans"]):
        random = np.random.default_rng([case.options["seed"], number])
        scan = _load(file)
        for target in _targets(scan, lattice, case.options["objects"], random):
            forgeries.append(as_written(attack(target), lattice))
            distances.append(target.distance)
    results = [generic_consistency(forgery, lattice=lattice) for forgery in forgeries]
    return {
        "frames": len(forgeries),
        "distances": distances,
        "scores": [result.score for result in results],
        "verdicts": [result.verdict for result in results],
        "found": _share([result.verdict == "tampered" for result in results]),
        **_published_detectors(forgeries),
    }


def run_timed(case: Case) -> Row:
    """Judge frames with removed objects with and without the previous frame (evidence ``time``)."""
    lattice = _real_lattice()
    attack = {**ADDING, **OTHERS}[_REMOVING]
    files = sorted(case.options["scans"])
    timed, alone, clean, clean_alone = [], [], [], []
    for number, (file, follower) in enumerate(zip(files[::2], files[1::2], strict=True)):
        random = np.random.default_rng([case.options["seed"], number])
        previous, scan = _load(file), _load(follower)
        judge = functools.partial(generic_consistency, lattice=lattice)
        clean.append(judge(scan, previous=previous))
        clean_alone.append(judge(scan))
        for target in _targets(scan, lattice, case.options["objects"], random):
            forged = as_written(attack(target), lattice)
            timed.append(judge(forged, previous=previous))
            alone.append(judge(forged))
    return {
        "frames": len(timed),
        "scores": [result.score for result in timed],
        "verdicts": [result.verdict for result in timed],
        "found": _share([result.verdict == "tampered" for result in timed]),
        "alone_scores": [result.score for result in alone],
        "alone_found": _share([result.verdict == "tampered" for result in alone]),
        "clean_scores": [result.score for result in clean],
        "clean_verdicts": [result.verdict for result in clean],
        "clean_alone_scores": [result.score for result in clean_alone],
    }


def _share(flags: Sequence[bool]) -> float:
    return float(np.mean(flags)) if flags else math.nan


def _published_detectors(frames: Sequence[Points]) -> Row:
    """Return the verdicts of detectors I and II on the same frames."""
    density = [authenticate.density_consistency(frame) for frame in frames]
    occlusion = [authenticate.occlusion_consistency(frame) for frame in frames]
    return {
        "density_found": _share([result.verdict == "tampered" for result in density]),
        "density_scores": [result.score for result in density],
        "occlusion_found": _share([result.verdict == "tampered" for result in occlusion]),
        "occlusion_scores": [result.score for result in occlusion],
    }


# Targets


@functools.cache
def _hoaxes() -> tuple[Points, ...]:
    """Return the points of objects of other drives."""
    return tuple(
        points for file in DONORS for _, points in _objects(_load(file)) if len(points) > 80
    )


def _objects(scan: Points) -> list[tuple[Box, Points]]:
    """Find objects of the size of people and cars that stand free on the ground."""
    found = forge.segment(scan, tolerance=0.2, ground_height=0.2)
    kept = []
    for index, box in enumerate(found.boxes):
        length, width, height = box.size
        foot = box.center[2] - 0.5 * height
        distance = math.hypot(box.center[0], box.center[1])
        if not RANGES[0] <= distance <= RANGES[1] or not 0.7 < height < 3.0 or foot > -1.1:
            continue
        if 0.3 < max(length, width) < 6.0:
            kept.append((box, scan[found.rows(index)]))
    return kept


def _targets(
    scan: Points, lattice: SensorLattice, number: int, random: np.random.Generator
) -> Iterator[Target]:
    """Choose targets: boxes of objects with a margin of 10 cm, and visible places on the ground."""
    objects, hoaxes = _objects(scan), _hoaxes()
    rho = np.hypot(scan[:, 0], scan[:, 1])
    ground = np.flatnonzero((scan[:, 2] < -1.4) & (rho > RANGES[0]) & (rho < RANGES[1]))
    ground = ground[np.argsort(rho[ground], kind="stable")]
    for index in random.permutation(len(objects))[:number]:
        box, _ = objects[index]
        wanted = np.searchsorted(rho[ground], random.uniform(*RANGES)).clip(0, len(ground) - 1)
        place = scan[ground[wanted]]
        yield Target(
            scan,
            replace(box, size=tuple(side + 0.2 for side in box.size)),
            hoaxes[int(random.integers(len(hoaxes)))],
            float(np.hypot(place[0], place[1])),
            float(np.arctan2(place[1], place[0])),
            lattice,
            int(random.integers(2**31)),
        )


# Claims


def _scores(rows: Sequence[Row], attack: str, name: str = "scores") -> dict[str, list[float]]:
    """Return the scores of real frames by scene; attack ``""``: the scores of clean frames."""
    tested = [row for row in rows if row["model"] != "clean, simulated"]
    left_out = (ODOMETRY.name, *CHOSEN_ON)
    wanted = [row for row in tested if row["attack"] == attack and row["scene"] not in left_out]
    return {row["scene"]: row[name] for row in wanted if row.get(name)}


def _simulated_scores(rows: Sequence[Row]) -> list[float]:
    return [s for row in rows if row["model"] == "clean, simulated" for s in row["scores"]]


def _numbers(rows: Sequence[Row], attack: str) -> tuple[float, str]:
    clean, forged = _scores(rows, ""), _scores(rows, attack)
    clean = {scene: clean[scene] for scene in forged}
    area = _roc.auc(np.concatenate([*clean.values()]), np.concatenate([*forged.values()]))
    low, high = _roc.auc_interval(clean, forged)
    every = np.concatenate([*forged.values()])
    text = f"AUC {area:.3f} [{low:.3f}, {high:.3f}], {counted(len(forged), 'scene')}, "
    text += counted(len(every), "forgery", "forgeries")
    simulated = _simulated_scores(rows)
    if simulated:
        threshold = max(float(np.quantile(simulated, 1.0 - ALARM_RATE)), 1e-9)
        text += f"; AUC against simulated clean frames {_roc.auc(simulated, every):.3f}"
        text += f"; {np.mean(every >= threshold):.1%} found at their 1 %"
    mine = [row for row in rows if row["attack"] == attack and row["scene"] not in CHOSEN_ON]
    weights = [row["frames"] for row in mine]
    for name, title in (
        ("found", "at the stated 1 %"),
        ("density_found", "by I"),
        ("occlusion_found", "by II"),
    ):
        text += f"; {np.average([row[name] for row in mine], weights=weights):.1%} {title}"
    return area, text


def _found(rows: Sequence[Row]) -> Iterator[Finding]:
    for attack in ADDING:
        if any(row["attack"] == attack for row in rows):
            area, text = _numbers(rows, attack)
            yield Finding(attack, area >= 0.98, text)


def _found_less(rows: Sequence[Row]) -> Iterator[Finding]:
    for attack in OTHERS:
        if any(row["attack"] == attack for row in rows):
            yield Finding(attack, None, _numbers(rows, attack)[1])


def _time_helps(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if WITH_TIME not in row["attack"]:
            continue
        area = _roc.auc(row["clean_scores"], row["scores"])
        before = _roc.auc(row["clean_alone_scores"], row["alone_scores"])
        clean = row["clean_verdicts"]
        yield Finding(
            row["attack"],
            area >= before if len(row["scores"]) >= MIN_FORGERIES else None,
            f"AUC {area:.3f}, alone {before:.3f}; {row['found']:.1%} found at the stated 1 %, "
            f"alone {row['alone_found']:.1%}; {row['frames']} forgeries of {len(clean)} frames; "
            f"{clean.count('tampered')} of the clean ones accused",
        )


def _no_alarm(rows: Sequence[Row]) -> Iterator[Finding]:
    real = [row for row in rows if row["model"] == "clean, real"]
    for row in real:
        alarms = row["verdicts"].count("tampered")
        numbers = f"{alarms} of {counted(row['frames'], 'frame')}; "
        numbers += ", ".join(sorted(set(row["verdicts"])))
        numbers += f"; dropped: {', '.join(row['dropped'])}" if row["dropped"] else ""
        chose = row["scene"] in CHOSEN_ON
        numbers += "; this scene chose the rate of lost returns" if chose else ""
        yield Finding(row["scene"], None if chose else alarms == 0, numbers)
    tested = [row for row in real if row["scene"] not in (ODOMETRY.name, *CHOSEN_ON)]
    if tested:
        frames = sum(row["frames"] for row in tested)
        alarms = sum(row["verdicts"].count("tampered") for row in tested)
        yield Finding(
            "what so few frames allow",
            None,
            f"{alarms} alarms: a rate of at most {upper_limit(alarms, frames):.1%} of "
            f"{frames} frames if they were independent, {upper_limit(0, len(tested)):.0%} of "
            f"{len(tested)} scenes (95 %)",
        )


def _rate_kept(rows: Sequence[Row]) -> Iterator[Finding]:
    simulated = [row for row in rows if row["model"] == "clean, simulated"]
    if simulated:
        frames = sum(row["frames"] for row in simulated)
        alarms = sum(row["verdicts"].count("tampered") for row in simulated)
        yield _published.finding_of_share(
            "simulated streets",
            alarms <= ALARM_RATE * frames,
            f"{alarms} of {frames} frames, at most {upper_limit(alarms, frames):.2%} (95 %); "
            f"largest score {max(_simulated_scores(rows)):.2f}",
            ALARM_RATE * frames,
        )


def figures(rows: Sequence[Row]) -> dict[str, Figure]:
    """Draw ROC curves of detectors I, II and III over all attacks that add or move points."""
    from matplotlib.figure import Figure

    clean = [s for scores in _scores(rows, "").values() for s in scores]
    drawn = {}
    for title, attacks in (("attacks that add or move", ADDING), ("other attacks", OTHERS)):
        figure = Figure(figsize=(6.4, 5.2), layout="constrained")
        axes = figure.add_subplot()
        for attack in attacks:
            forged = [s for scores in _scores(rows, attack).values() for s in scores]
            if forged and clean:
                false, found = _roc.curve(clean, forged)
                axes.plot(false, found, label=f"{attack}: {_roc.auc(clean, forged):.3f}")
        for name, detector, color in (("density", "I", "0.6"), ("occlusion", "II", "0.3")):
            quiet = [s for v in _scores(rows, "", f"{name}_scores").values() for s in v]
            loud = [
                s for a in attacks for v in _scores(rows, a, f"{name}_scores").values() for s in v
            ]
            if quiet and loud:
                label = f"detector {detector}, all: {_roc.auc(quiet, loud):.3f}"
                axes.plot(*_roc.curve(quiet, loud), "--", color=color, label=label)
        if not axes.lines:
            continue
        axes.set(
            title=f"Detector III on real frames: {title}",
            xlabel="share of clean frames called tampered",
            ylabel="share of forgeries found",
        )
        axes.grid(alpha=0.3)
        axes.legend(title="area under the curve", fontsize="small")
        drawn[title] = figure
    return drawn


EXPERIMENT = Experiment(
    id="detector-3",
    title="Detector III: LiDAR alone, every attack, real frames of an HDL-64E",
    published="",
    data=_DATA_SETS,
    cases=cases,
    columns=(
        Column("scene", "scene"),
        Column("frames", "frames"),
        Column("found", "III, %", 100.0, 1),
        Column("density_found", "I, %", 100.0, 1),
        Column("occlusion_found", "II, %", 100.0, 1),
    ),
    claims=(
        Claim(
            "III finds every attack that adds or moves points: AUC >= 0.98",
            "aim",
            _found,
            about=lambda row: row["attack"] == "" or row["attack"] in ADDING,
            together=True,
        ),
        Claim(
            "III and attacks that remove, bend or know the lattice",
            "aim: none",
            _found_less,
            about=lambda row: row["attack"] == "" or row["attack"] in OTHERS,
            together=True,
            reported=True,
        ),
        Claim(
            "The frame before helps III to find what was removed",
            "aim",
            _time_helps,
            about=lambda row: WITH_TIME in row["attack"],
        ),
        Claim(
            "III accuses no clean frame, on the lattice or off it",
            "aim",
            _no_alarm,
            about=lambda row: row["model"] == "clean, real",
        ),
        Claim(
            "III accuses 1 % of clean simulated frames at most",
            "aim",
            _rate_kept,
            about=lambda row: row["model"] == "clean, simulated",
        ),
    ),
    figures=figures,
    notes=(
        "The lattice is estimated from drive 0002; everything was tuned on it and two unidentified "
        "drives, the rate of lost returns on simulated streets of other seeds, where dark cars "
        "return nothing at all and look like removed ones: hence two areas. That rate was "
        "set anew after one false alarm on stereo-2015 000124: that scene is shown, and left out "
        "of all rates and areas. Forgeries are "
        "written as KITTI's files are: whole millimetres, ring after ring, each by azimuth; as the "
        "attacks leave them they are found more easily still.",
        "'with the frame before': one frame was edited, the one a turn earlier was not; odd frames "
        "of drive 0005.",
        "'on firings': the attacker knows the lattice and the firings of the frame, gives each "
        "firing one return and hides what is behind; 'ranges': he rounds to the range step too.",
    ),
)
