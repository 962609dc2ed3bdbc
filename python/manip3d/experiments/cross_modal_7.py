"""Table 7.2, columns of the cross-modal check: detected attacks and false positives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from manip3d import authenticate, datasets
from manip3d._util.shares import wilson
from manip3d.errors import Error
from manip3d.experiments import _alert_attacks, _alert_set, _published, _recorded
from manip3d.experiments._alert_attacks import ATTACKS
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row
from manip3d.lidar import Box, LidarFrame

_TABLE = "table_7_2_alert_detection"
_DRIVES = (1, 2, 3)
_QUICK_FRAMES = 2
_ACCURACY, _ALARMS = 0.9756, 0.0266
"""Published shares of right verdicts and of accused clean frames."""
_FULL_FRAMES = {1: 800, 2: 395, 3: 570}  # as published

TUNED = ("2011_09_26_drive_0002_sync", "kitti_odometry/00")
"""Real data on which thresholds were chosen; the results on the others are reported."""
REPORTED = ("2011_09_26_drive_0005_sync", "kitti_stereo2015", "kitti_object")
_DATA_SETS = (
    "kitti_calibration_0926",
    "kitti_drive_0002",
    "kitti_drive_0005",
    "kitti_stereo2015",
    "kitti_object",
    "kitti_odometry_00",
)
_DAY = "kitti_raw/2011_09_26"
_REAL = {
    "2011_09_26_drive_0002_sync": (f"{_DAY}/2011_09_26_drive_0002_sync", _DAY, (2, 3)),
    "2011_09_26_drive_0005_sync": (f"{_DAY}/2011_09_26_drive_0005_sync", _DAY, (2, 3)),
    "kitti_stereo2015": ("kitti_stereo2015", _DAY, (2, 3)),
    "kitti_object": ("kitti_object", "", (2, 3)),
    "kitti_odometry/00": ("kitti_odometry/00", "", (0, 1)),
}
"""Folder, folder of the calibration and numbers of the two cameras of each drive."""


TYPES = {
    "additive": ("additive",),
    "subtractive": ("subtractive",),
    "additive_subtractive": ("both", "modification"),  # the latter if both places are close
}
"""Correct types of an attack; the correct type of all other attacks is "modification"."""


class _Moment(NamedTuple):
    frame: LidarFrame
    disparity: authenticate.Disparity
    rig: authenticate.StereoRig
    boxes: Sequence[Box]


def _cases(plan: Plan) -> list[Case]:
    quick = plan.scale == "quick"
    cases = [
        Case(
            compare,
            {
                "model": f"drive {drive}",
                "seed": _alert_set.seed_of(drive, plan.seed),
                "scale": plan.scale,
                "frames": _QUICK_FRAMES if quick else _FULL_FRAMES[drive],
                "role": "simulated streets",
            },
        )
        for drive in _DRIVES
        if plan.data != "real"
    ]
    root = datasets.data_root()
    for name, (folder, _, _) in _REAL.items():
        if plan.data == "simulated" or root is None or not (root / "lidar" / folder).is_dir():
            continue
        half = "tuned on" if name in TUNED else "reported"
        options = {
            "model": name,
            "seed": plan.seed,
            "files": _recorded.sums(_files(name)),
            "data": "recorded",
            "role": f"recorded, {half}",
        }
        cases.append(Case(compare, options))
    return cases


def _files(name: str) -> list[str]:
    """Return the files of a drive that `compare` reads, relative to the data root.

    The list ends before whatever is missing or damaged: the case that reads it fails, and no other.
    """
    root = datasets.data_root()
    assert root is not None
    _, _, cameras = _REAL[name]
    read: dict[Path, None] = {}
    with suppress(Error, OSError):
        for frame in _drive(name):
            if all(camera in frame.images for camera in cameras):
                read |= dict.fromkeys([frame.scan_path, *(frame.images[c] for c in cameras)])
                read |= dict.fromkeys(frame.calibration_files)
    return [path.relative_to(root).as_posix() for path in read if path.is_file()]


def compare(case: Case) -> Row:
    """Judge each frame, clean and after each attack on its nearest object in view."""
    options = case.options
    if options["model"] in _REAL:
        moments = _of_drive(options["model"])
    else:
        moments = _simulated(options["seed"], options["frames"])
    row: Row = {"frames": 0, "clean": 0, "undecidable": 0, "points": 0.0}
    for attack in ATTACKS:
        row |= {attack: 0, f"{attack} of": 0, f"{attack} placed": 0, f"{attack} typed": 0}
    for number, moment in enumerate(moments):
        found = _judged(moment.frame, moment)
        row["frames"] += 1
        row["clean"] += found.verdict == "tampered"
        row["undecidable"] += found.verdict == "undecidable"
        row["points"] += found.judged_points
        objects = _alert_attacks.targets(moment.frame, moment.boxes)
        for attack in ATTACKS:
            rng = np.random.default_rng([options["seed"], number, ATTACKS.index(attack)])
            made = (
                _alert_attacks.attacked(moment.frame, objects[0], attack, rng) if objects else None
            )
            if made is None:
                continue
            told = _judged(made[0], moment)
            row[f"{attack} of"] += 1
            row[attack] += told.verdict == "tampered"
            row[f"{attack} typed"] += told.attack in TYPES.get(attack, ("modification",))
            row[f"{attack} placed"] += told.verdict == "tampered" and any(
                _touch(found, wanted) for found in told.boxes for wanted in made[1]
            )
    row["points"] /= max(row["frames"], 1)
    row["attacks"] = sum(row[f"{attack} of"] for attack in ATTACKS[:6])
    row["detected"] = sum(row[attack] for attack in ATTACKS[:6])
    row["placed"] = sum(row[f"{attack} placed"] for attack in ATTACKS[:6])
    return row


def _judged(frame: LidarFrame, moment: _Moment) -> authenticate.CrossModalResult:
    return authenticate.cross_modal_consistency(frame, moment.disparity, moment.rig)


def _touch(found: Box, wanted: Box, slack: float = 0.5) -> bool:
    """Return whether a found box is within ``slack`` metres of a changed box, seen from above."""
    gap = np.abs(np.subtract(found.center[:2], wanted.center[:2]))
    reach = max(wanted.size[:2]) / 2  # bound for any yaw
    return bool(np.all(gap <= np.add(found.size[:2], 2 * slack) / 2 + reach))


def _simulated(seed: int, count: int) -> Iterator[_Moment]:
    """Yield ``count`` frames of simulated streets, one per second of each street's drive."""
    from manip3d.simulate import cameras
    from manip3d.simulate.drives import drive
    from manip3d.simulate.streets import street

    rig = authenticate.StereoRig.from_calibration(datasets.KittiCalibration(*cameras.projections()))
    done = 0
    while done < count:
        place = street(seed)
        for start in np.arange(0.5, place.duration, 1.0)[: count - done]:
            (frame,) = drive(place, 1, start=float(start), rng=seed + done, threads=1)
            assert frame.pictures is not None
            disparity = authenticate.stereo_disparity(frame.pictures.left, frame.pictures.right)
            yield _Moment(frame.scan.frame, disparity, rig, frame.boxes)
            done += 1
        seed += 1


def _of_drive(name: str) -> Iterator[_Moment]:
    _, _, (left, right) = _REAL[name]
    for frame in _drive(name):
        pair = frame.pictures(left, right)
        if pair is None:
            continue
        rig = authenticate.StereoRig.from_calibration(frame.calibration(), left=left, right=right)
        scan = frame.scan(labels=False)
        disparity = authenticate.stereo_disparity(*pair)
        yield _Moment(scan, disparity, rig, _alert_attacks.segmented(scan))


def _drive(name: str) -> datasets.KittiDrive:
    folder, calibration, _ = _REAL[name]
    root = datasets.data_root()
    assert root is not None
    lidar = root / "lidar"
    return datasets.open_kitti(
        lidar / folder, calibration=lidar / calibration if calibration else None
    )


def _complete(row: Row) -> Row:
    drive = row["model"].removeprefix("drive ")
    lines = [line for line in _published.published_rows(_TABLE) if line["drive"] == drive]
    if not lines:
        return row
    forged = [line for line in lines if line["attack"] != "original"]
    return row | {
        "published clean": sum(
            int(line["cross_modal_detected_forged"])
            for line in lines
            if line["attack"] == "original"
        ),
        "published detected": sum(int(line["cross_modal_detected_forged"]) for line in forged),
        "published attacks": sum(int(line["frames"]) for line in forged),
    }


def _halves(rows: Sequence[Row]) -> Iterator[tuple[str, Sequence[Row]]]:
    yield "simulated drives", [row for row in rows if row["model"] not in _REAL]
    yield "recorded, reported half", [row for row in rows if row["model"] in REPORTED]


def _accuracy(rows: Sequence[Row]) -> Iterator[Finding]:
    for name, some in _halves(rows):
        right = sum(row["detected"] + row["frames"] - row["clean"] for row in some)
        of = sum(row["attacks"] + row["frames"] for row in some)
        if of:
            low, high = wilson(right, of)
            numbers = f"{right} of {of} right, {right / of:.1%} ({low:.1%} to {high:.1%})"
            errors = of * (1.0 - _ACCURACY)
            yield _published.finding_of_share(name, right / of >= _ACCURACY, numbers, errors)


def _false_positives(rows: Sequence[Row]) -> Iterator[Finding]:
    for name, some in _halves(rows):
        clean, of = sum(row["clean"] for row in some), sum(row["frames"] for row in some)
        if of:
            low, high = wilson(clean, of)
            numbers = (
                f"{clean} of {of} clean frames accused, {clean / of:.1%} ({low:.1%} to {high:.1%})"
            )
            yield _published.finding_of_share(name, clean / of <= _ALARMS, numbers, of * _ALARMS)


def _by_attack(rows: Sequence[Row]) -> Iterator[Finding]:
    for name, some in _halves(rows):
        for attack in ATTACKS:
            found, of = sum(r[attack] for r in some), sum(r[f"{attack} of"] for r in some)
            placed = sum(r[f"{attack} placed"] for r in some)
            typed = sum(r[f"{attack} typed"] for r in some)
            if of:
                low, high = wilson(found, of)
                numbers = (
                    f"{found} of {of} detected ({low:.0%} to {high:.0%}), {placed} of them at the "
                    f"right place, {typed} of the right type"
                )
                yield Finding(f"{name}: {attack}", None, numbers)


EXPERIMENT = Experiment(
    id="table-7.2-cross-modal",
    title="Attacks that LiDAR and cameras together detect, and clean frames that they accuse",
    published=_TABLE,
    data=_DATA_SETS,
    cases=_cases,
    role="simulated drives of an HDL-64E with a stereo pair, labelled",
    columns=(
        Column("frames", "clean frames", ratio=False),
        Column("clean", "accused", published="published clean", ratio=False),
        Column("attacks", "attacks", published="published attacks", ratio=False),
        Column("detected", "detected", published="published detected", ratio=False),
        Column("placed", "at the right place"),
        *(Column(attack, attack.replace("_", " ")) for attack in ATTACKS),
        Column("points", "judged points, share", digits=2),
    ),
    claims=(
        Claim("97.56 % of frames and attacks are judged rightly", "table 7.2", _accuracy),
        Claim(
            "At most 2.66 % of clean frames are accused (47 of 1765)", "table 7.2", _false_positives
        ),
        Claim("Attack by attack", "aim", _by_attack, reported=True),
    ),
    complete=_complete,
    notes=(
        "Each attack is done to the nearest object with 50 points that both sensors see, 6 to 30 m "
        "away. Attack 6 with the authors' 2 m sideways is counted beside the six. Simulated "
        "objects are the labelled ones, recorded ones are found by ground removal and clustering. "
        f"Thresholds were chosen on simulated streets of other seeds and on {' and '.join(TUNED)}; "
        f"{', '.join(REPORTED)} are reported. A frame whose cameras measure too little is "
        "undecidable and counts as not accused, and as not detected.",
    ),
)
