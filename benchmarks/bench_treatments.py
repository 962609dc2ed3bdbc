"""Verdicts of `inspect` on scans that users cropped, thinned, rotated or rounded: `treatments`.

``python benchmarks/bench_treatments.py treated.jsonl`` applies treatments that are common on the
way from a scanner to an archive to clean scans and to scans with an edit, inspects the results and
writes the section `treatments`. No clean scan may be accused, and an edit whose evidence the
treatment destroyed may not get the verdict `no_trace`. ``--pairs N`` applies two treatments to each
scan, for N random pairs. ``--beside N`` treats the previous and the next turn of N frames of drive
0005, which are clean or have a deleted object.

The scans are those of ``$MANIP3D_DATA`` (KITTI's scanner, eleven others, terrestrial ones), or
frames of simulated streets if the data are absent. Edits are inserted into frames of KITTI's
scanner, and `inspect` sees the frame alone. The result of each scan is a line of the named file;
scans in the file are not judged again.
"""

from __future__ import annotations

import argparse
import functools
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from measuring import one_thread

if TYPE_CHECKING:
    from manip3d.lidar import LidarFrame

Line = dict[str, Any]
Doubles = NDArray[np.float64]
Treatment = Callable[["LidarFrame", np.random.Generator], "LidarFrame"]

EDITS = ("added", "moved", "rotated", "along rays")
"""Edits that detector III finds in all untreated frames."""

KITTI = (
    *(
        f"kitti_raw/{name}/velodyne_points/data/0000000000.bin.xz"
        for name in (
            "2011_09_26/2011_09_26_drive_0002_sync",
            "2011_09_26/2011_09_26_drive_0005_sync",
            "2011_09_26/2011_09_26_drive_0079_extract",
            "2011_09_26/unidentified_drive_b",
            "unidentified_drive_a",
        )
    ),
    *(f"kitti_stereo2015/velodyne/{number}.bin.xz" for number in ("000083", "000124", "000131")),
    "kitti_object/velodyne/demo.bin.xz",
)
OTHERS = (
    "packets/reference/vlp16_scan_1673400472138016708.pcd",
    "packets/reference/vlp32_scan_1713492677464078412.pcd",
    "other_sensors/kitti_camera_crops/000000.bin",
    "other_sensors/livox_detection_sample.pcd.xz",
    "other_sensors/ouster_os1_32.pcd.xz",
    "other_sensors/nuscenes_hdl32e.pcd.bin",
    "other_sensors/hesai_qt64.pcd.xz",
    "other_sensors/hesai_pandar40p.pcd.xz",
    "other_sensors/pandaset_pandar64_ego_00.pcd.xz",
    "hdl32_pair/251370668.pcd.xz",
    "kitti_odometry/00/velodyne/000000.bin.xz",
)
TERRESTRIAL = ("tls/3dtk_dat/scan000.3d.xz", "tls/pump_room_e57.ply.xz", "tls/room_scan1.ply.xz")
GROUPS = {"HDL-64E": KITTI, "other scanners": OTHERS, "terrestrial": TERRESTRIAL}

FIRST_STREET = 87_000
"""First of the simulated streets, on which no threshold was chosen."""

CAR = (2.7, 1.5)
"""Half length and half width, metres, of the box that users crop as their own car."""


def of(scan: LidarFrame, points: Doubles | NDArray[np.float32], **changes: Any) -> LidarFrame:
    """Return the scan with other coordinates, in the precision of a file."""
    points = np.ascontiguousarray(points, np.float32)
    return scan.replace(points=points, exact=None, format=None, **changes)


def kept(rows: Callable[[Doubles], NDArray[np.bool_]]) -> Treatment:
    """Return the treatment that keeps the points selected by ``rows``."""
    return lambda scan, _: scan.select(np.flatnonzero(rows(scan.points.astype(np.float64))))


def shown(values: Callable[[NDArray[np.float32]], Doubles | NDArray[np.float32]]) -> Treatment:
    """Return the treatment that changes reflectances; scans without them are unchanged."""

    def treat(scan: LidarFrame, _: np.random.Generator) -> LidarFrame:
        if scan.intensity is None:
            return scan
        return scan.replace(intensity=values(scan.intensity).astype(np.float32), format=None)

    return treat


def moved(matrix: Callable[[], Doubles], shift: tuple[float, float, float]) -> Treatment:
    """Return the treatment that transforms points to a frame whose pose the file does not state."""

    def treat(scan: LidarFrame, _: np.random.Generator) -> LidarFrame:
        return of(scan, scan.points.astype(np.float64) @ matrix().T + shift, origin=None)

    return treat


def rounded(units: float) -> Treatment:
    """Return the treatment that rounds coordinates to ``units`` steps per metre."""
    return lambda scan, _: of(scan, np.round(scan.points.astype(np.float64) * units) / units)


def ordered(key: Callable[[Doubles], Doubles]) -> Treatment:
    """Return the treatment that sorts points by a key."""
    return lambda scan, _: scan.select(
        np.argsort(key(scan.points.astype(np.float64)), kind="stable")
    )


def about(axis: int, degrees: float) -> Doubles:
    """Return the matrix of a rotation about an axis."""
    turn = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn[first, first] = turn[second, second] = cos
    turn[first, second], turn[second, first] = -sin, sin
    return turn


def voxels(size: float, *, centroid: bool) -> Treatment:
    """Return the treatment that keeps the first point of each voxel, or the mean of its points."""

    def treat(scan: LidarFrame, _: np.random.Generator) -> LidarFrame:
        cells = np.floor(scan.points / size).astype(np.int64)
        found = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        first, inverse = found[1], found[2].ravel()
        if not centroid:
            return scan.select(first)
        number = np.bincount(inverse)
        means = [np.bincount(inverse, scan.points[:, k]) / number for k in range(3)]
        return of(scan.select(first), np.column_stack(means))

    return treat


def without_outliers(scan: LidarFrame, neighbours: int, sigmas: float) -> LidarFrame:
    """Apply the statistical outlier filter of Open3D and PCL."""
    from scipy.spatial import cKDTree

    near, _ = cKDTree(scan.points).query(scan.points, neighbours + 1)
    mean = near[:, 1:].mean(axis=1)
    return scan.select(np.flatnonzero(mean < mean.mean() + sigmas * mean.std()))


def with_neighbours(scan: LidarFrame, radius: float, least: int) -> LidarFrame:
    """Apply the radius outlier filter of Open3D and PCL."""
    from scipy.spatial import cKDTree

    near, _ = cKDTree(scan.points).query(scan.points, least + 1)
    return scan.select(np.flatnonzero(near[:, least] < radius))


def repeated(scan: LidarFrame, rows: NDArray[np.intp]) -> LidarFrame:
    """Append copies of some rows to the scan."""
    return scan.select(np.concatenate([np.arange(scan.num_points), rows]))


def padded(scan: LidarFrame, rows: int) -> LidarFrame:
    """Append rows of zeros to the scan."""
    if scan.num_points == 0:
        return scan
    zeros = scan.select(np.zeros(rows, np.intp))
    points = np.concatenate([scan.points, np.zeros((rows, 3), np.float32)])
    values = scan.intensity
    if values is not None and zeros.intensity is not None:
        values = np.concatenate([values, np.zeros_like(zeros.intensity)])
    rings = scan.ring
    if rings is not None and zeros.ring is not None:
        rings = np.concatenate([rings, zeros.ring])
    return type(scan)(points, values, ring=rings, origin=scan.origin)


def marked(
    scan: LidarFrame, rows: NDArray[np.intp], place: tuple[float, float, float]
) -> LidarFrame:
    """Insert rows at a constant place before some of the scan's rows, as decoders do."""
    if scan.num_points == 0:
        return scan
    both = scan.select(np.insert(np.arange(scan.num_points), rows, 0))
    points = both.points.copy()
    points[rows + np.arange(len(rows))] = place
    return of(both, points)


def in_16_bits(scan: LidarFrame) -> LidarFrame:
    """Convert the scan to half precision, without points out of its range."""
    within = np.abs(scan.points).max(axis=1, initial=0.0) < np.finfo(np.float16).max
    some = scan.select(np.flatnonzero(within))
    return of(some, some.points.astype(np.float16).astype(np.float32))


def fused(scan: LidarFrame, _: np.random.Generator) -> LidarFrame:
    """Merge the scan with a copy shifted by half a metre, like a map of several turns."""
    both = repeated(scan, np.arange(scan.num_points))
    points = both.points.astype(np.float64)
    points[scan.num_points :] = points[scan.num_points :] @ about(2, 1.0).T + [0.5, 0.0, 0.0]
    return of(both, points)


def deskewed(metres: float) -> Treatment:
    """Return the treatment that compensates a motion of the car during the turn."""

    def treat(scan: LidarFrame, _: np.random.Generator) -> LidarFrame:
        share = np.arctan2(scan.points[:, 1], scan.points[:, 0]) / (2.0 * np.pi)
        return of(scan, scan.points + np.outer(share, [metres, 0.0, 0.0]))

    return treat


def noisy(metres: float) -> Treatment:
    """Return the treatment that adds noise to coordinates."""
    return lambda scan, rng: of(scan, scan.points + rng.normal(0.0, metres, scan.points.shape))


def rings_of(scan: LidarFrame) -> NDArray[np.int64]:
    """Return the laser of each point; if the file does not state it, from the elevation."""
    if scan.ring is not None:
        return np.asarray(scan.ring, np.int64)
    x, y, z = scan.points.astype(np.float64).T
    elevation = np.degrees(np.arctan2(z, np.hypot(x, y)))
    steps: NDArray[np.int64] = np.floor((elevation + 90.0) / 0.4).astype(np.int64)
    return steps


def in_rings(holds: Callable[[NDArray[np.int64]], NDArray[np.bool_]]) -> Treatment:
    """Return the treatment that keeps some lasers."""
    return lambda scan, _: scan.select(np.flatnonzero(holds(rings_of(scan))))


def in_polygon(scan: LidarFrame, _: np.random.Generator) -> LidarFrame:
    """Crop the scan to a polygon seen from above."""
    corners = [(-8.0, -12.0), (25.0, -20.0), (40.0, 5.0), (15.0, 22.0), (-12.0, 9.0)]
    inside = np.ones(scan.num_points, np.bool_)
    for (ax, ay), (bx, by) in zip(corners, [*corners[1:], corners[0]], strict=True):
        x, y = scan.points[:, 0].astype(np.float64), scan.points[:, 1].astype(np.float64)
        inside &= (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0
    return scan.select(np.flatnonzero(inside))


def distance(points: Doubles) -> Doubles:
    """Return distances from the scanner, metres."""
    found: Doubles = np.sqrt((points * points).sum(axis=1))
    return found


def azimuth(points: Doubles) -> Doubles:
    """Return azimuths from straight ahead, radians, in [-pi, pi]."""
    found: Doubles = np.arctan2(points[:, 1], points[:, 0])
    return found


def own_car(points: Doubles) -> NDArray[np.bool_]:
    """Return the points in the box of the scanner's own car."""
    return (np.abs(points[:, 0]) < CAR[0]) & (np.abs(points[:, 1]) < CAR[1])


def some(share: float) -> Treatment:
    """Return the treatment that keeps a random share of the points."""
    return lambda scan, rng: scan.select(np.flatnonzero(rng.random(scan.num_points) < share))


TREATMENTS: dict[str, Treatment] = {
    "none": lambda scan, _: scan,
    "float64 and back": lambda scan, _: of(scan, scan.points.astype(np.float64) * 1.0),
    "float16": lambda scan, _: in_16_bits(scan),
    "rounded to 1 mm": rounded(1000.0),
    "rounded to 2 mm": rounded(500.0),
    "rounded to 1 cm": rounded(100.0),
    "rounded to 10 cm": rounded(10.0),
    "in millimetres": lambda scan, _: of(scan, scan.points * np.float32(1000.0)),
    "in centimetres": lambda scan, _: of(scan, scan.points * np.float32(100.0)),
    "scaled by 1.02": lambda scan, _: of(scan, scan.points * np.float32(1.02)),
    "shuffled": lambda scan, rng: scan.select(rng.permutation(scan.num_points)),
    "rows shifted round": ordered(
        lambda points: np.roll(np.arange(len(points), dtype=np.float64), len(points) // 3)
    ),
    "sorted by range": ordered(distance),
    "sorted by azimuth": ordered(azimuth),
    "sorted by x": ordered(lambda points: points[:, 0]),
    "reversed": ordered(lambda points: -np.arange(len(points), dtype=np.float64)),
    "own car cut out": kept(lambda points: ~own_car(points)),
    "beyond 3 m": kept(lambda points: distance(points) > 3.0),
    "up to 30 m": kept(lambda points: distance(points) < 30.0),
    "up to 50 m": kept(lambda points: distance(points) < 50.0),
    "up to 80 m": kept(lambda points: distance(points) < 80.0),
    "up to 100 m": kept(lambda points: distance(points) < 100.0),
    "box of 50 m": kept(lambda points: np.abs(points[:, :2]).max(axis=1) < 50.0),
    "ahead": kept(lambda points: points[:, 0] > 0.0),
    "90 degrees": kept(lambda points: np.abs(azimuth(points)) < np.pi / 4.0),
    "a polygon": in_polygon,
    "without the ground": kept(lambda points: points[:, 2] > -1.4),
    "without what is high": kept(lambda points: points[:, 2] < 0.6),
    "half of the points": some(0.5),
    "a tenth of the points": some(0.1),
    "99 of 100 points": some(0.99),
    "every tenth point": lambda scan, _: scan.select(np.arange(0, scan.num_points, 10)),
    "the first half": lambda scan, _: scan.select(np.arange(scan.num_points // 2)),
    "the last point left out": lambda scan, _: scan.select(np.arange(scan.num_points - 1)),
    "voxels of 10 cm, first points": voxels(0.1, centroid=False),
    "voxels of 10 cm, means": voxels(0.1, centroid=True),
    "outliers, 20 neighbours": lambda scan, _: without_outliers(scan, 20, 2.0),
    "outliers, within 0.5 m": lambda scan, _: with_neighbours(scan, 0.5, 5),
    "two turns in one": fused,
    "all rows twice": lambda scan, _: repeated(scan, np.arange(scan.num_points)),
    "5 % of the rows twice": lambda scan, rng: repeated(
        scan, rng.choice(scan.num_points, scan.num_points // 20, replace=False)
    ),
    "last row again": lambda scan, _: repeated(scan, np.full(1000, scan.num_points - 1)),
    "zeros": lambda scan, _: padded(scan, 1000),
    "three markers at 10 km": lambda scan, _: marked(
        scan, np.full(3, scan.num_points), (10_000.0, 0.0, 0.0)
    ),
    "1000 rows of 0x7FFF": lambda scan, rng: marked(
        scan, np.sort(rng.integers(0, scan.num_points, 1000)), (32_767.0,) * 3
    ),
    "200 rows in front, too": lambda scan, rng: scan.select(
        np.concatenate([rng.choice(scan.num_points, 200), np.arange(scan.num_points)])
    ),
    "near before far": ordered(lambda points: (distance(points) > 50.0).astype(np.float64)),
    "low before high": ordered(lambda points: (points[:, 2] > 1.5).astype(np.float64)),
    "a page lost": lambda scan, _: scan.select(
        np.flatnonzero(np.arange(scan.num_points) // 256 != scan.num_points // 512)
    ),
    "height above ground": moved(lambda: np.eye(3), (0.0, 0.0, 1.73)),
    "turned by 30 degrees": moved(lambda: about(2, 30.0), (0.0, 0.0, 0.0)),
    "pitched by 2 degrees": moved(lambda: about(1, 2.0), (0.0, 0.0, 0.0)),
    "in a map": moved(lambda: about(2, 70.0) @ about(1, 1.5), (120.0, -45.0, 3.0)),
    "camera axes": moved(lambda: np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]]), (0, 0, 0)),
    "left and right exchanged": moved(lambda: np.diag([1.0, -1.0, 1.0]), (0.0, 0.0, 0.0)),
    "deskewed by 1 m": deskewed(1.0),
    "deskewed by 5 cm": deskewed(0.05),
    "noise of 1 mm": noisy(0.001),
    "noise of 1 cm": noisy(0.01),
    "every second laser": in_rings(lambda rings: rings % 2 == 0),
    "one laser": in_rings(lambda rings: rings == np.bincount(rings).argmax()),
    "reflectances 0 to 255": shown(lambda values: np.round(values * 255.0)),
    "reflectances of 0": shown(np.zeros_like),
    "reflectances of 1": shown(np.ones_like),
    "brighter reflectances": shown(lambda values: np.clip(values * 1.3, 0.0, 1.0)),
    "reflectances spread over 0 to 1": shown(
        lambda values: (values - values.min()) / max(float(np.ptp(values)), 1e-9)
    ),
    "no reflectances": lambda scan, _: scan.replace(intensity=None, format=None),
    "without the dark": lambda scan, _: (
        scan if scan.intensity is None else scan.select(np.flatnonzero(scan.intensity > 0.05))
    ),
}
"""Treatments by their names in the table."""


def clean_scans() -> Iterator[tuple[str, str, LidarFrame]]:
    """Yield group, name and scan of each clean scan."""
    from manip3d import datasets
    from manip3d.io import read_scan

    root = datasets.data_root()
    found = False
    for group, files in GROUPS.items():
        for file in files:
            if root is not None and (path := root / "lidar" / file).is_file():
                found = True
                yield group, file, read_scan(path)
    if not found:
        from manip3d.simulate.lidar import hdl64e
        from manip3d.simulate.streets import street

        for number in range(FIRST_STREET, FIRST_STREET + 5):
            made = hdl64e(street(number), 3.0, rng=number, threads=1)
            yield "HDL-64E", f"street {number}", made.frame


def edited(scan: LidarFrame, number: int) -> Iterator[tuple[str, LidarFrame]]:
    """Yield the scan with each kind of edit of an object on the ground."""
    from manip3d.authenticate import kitti_lattice
    from manip3d.authenticate._edits import EDITS as CLASSES
    from manip3d.authenticate._power import _some_object

    if scan.intensity is None:
        return
    lattice = kitti_lattice()
    cloud = np.column_stack([scan.points, scan.intensity])
    random = np.random.default_rng(number)
    for name in EDITS:
        rows = _some_object(scan.points, random)
        if rows is not None:
            made = CLASSES[name](cloud, rows, lattice, random)
            yield name, type(scan)(
                np.ascontiguousarray(made[:, :3]), np.ascontiguousarray(made[:, 3]),
                origin=scan.origin,
            )  # fmt: skip


def judged(scan: LidarFrame) -> Line:
    """Return the verdict of `inspect`, and its time."""
    from manip3d.authenticate import inspect

    begin = time.process_time()
    found = inspect(scan, threads=1)
    return {
        "points": scan.num_points,
        "verdict": found.verdict,
        "reason": found.reason,
        "sensor": "" if found.sensor is None else found.sensor.name,
        "blind": list(found.blind),
        "seconds": time.process_time() - begin,
    }


def run(file: Path, pairs: int, until: float = math.inf) -> list[Line]:
    """Return the lines of all treated scans; judge and append those that the file lacks."""
    known = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(line["scan"], line["edit"], line["treatment"]) for line in known}
    for number, (group, name, clean) in enumerate(clean_scans()):
        versions = [("", clean)]
        if group == "HDL-64E":
            versions += list(edited(clean, number))
        for edit, scan in versions:
            for treatment, change in chosen(pairs, number, edit).items():
                if (name, edit, treatment) in done or time.monotonic() > until:
                    continue
                seed = np.random.default_rng([number, *treatment.encode()])
                line = {"group": group, "scan": name, "edit": edit, "treatment": treatment}
                line |= judged(change(scan, seed))
                known.append(line)
                with file.open("a") as out:
                    out.write(json.dumps(line) + "\n")
            print(f"{name} {edit}", file=sys.stderr, flush=True)
    return known


def run_beside(file: Path, frames: int, until: float) -> list[Line]:
    """Judge untreated frames of a drive between treated neighbours."""
    from bench_removed import recorded
    from manip3d.authenticate import inspect
    from manip3d.authenticate._power import _some_object

    known = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(line["scan"], line["treatment"]) for line in known}
    drive = recorded()
    for k in np.linspace(1, len(drive) - 2, frames).astype(int).tolist():
        frame, random = drive[k], np.random.default_rng(k)
        versions = {"": frame}
        if (rows := _some_object(frame.points, random)) is not None:
            versions["removed"] = frame.select(np.setdiff1d(np.arange(frame.num_points), rows))
        for name, treat in TREATMENTS.items():
            if (k, name) in done or time.monotonic() > until:
                continue
            before, after = treat(drive[k - 1], random), treat(drive[k + 1], random)
            for edit, scan in versions.items():
                found = inspect(scan, previous=before, following=after, threads=1)
                line = {"scan": k, "edit": edit, "treatment": name, "verdict": found.verdict}
                known.append(line | {"reason": found.reason})
                with file.open("a") as out:
                    out.write(json.dumps(known[-1]) + "\n")
    return known


def chosen(pairs: int, number: int, edit: str) -> dict[str, Treatment]:
    """Return all treatments or, if ``pairs`` > 0, that many random pairs for each scan."""
    if not pairs:
        return TREATMENTS
    random = np.random.default_rng([number, *edit.encode()])
    names = list(TREATMENTS)
    drawn = [random.choice(len(names), 2, replace=False) for _ in range(pairs)]
    return {
        f"{names[a]}, then {names[b]}": functools.partial(both, names[a], names[b])
        for a, b in drawn
    }


def both(first: str, second: str, scan: LidarFrame, rng: np.random.Generator) -> LidarFrame:
    """Apply two treatments one after the other."""
    treated = TREATMENTS[first](scan, rng)
    return TREATMENTS[second](treated, rng) if treated.num_points > 30 else treated


VERDICTS = ("tampered", "no_trace", "processed", "undecidable")


def counts(lines: list[Line]) -> list[str]:
    """Return the number of each verdict."""
    verdicts = Counter(line["verdict"] for line in lines)
    return [f"{verdicts[name]}" if lines else "–" for name in VERDICTS]


HEAD = ["treatment", "clean: accused", "no_trace", "processed", "undecidable",
        "edited: accused", "no_trace", "processed", "undecidable"]  # fmt: skip


def report(lines: list[Line]) -> str:
    """Return the table with a row for each treatment."""
    import tables

    names = list(dict.fromkeys(line["treatment"] for line in lines))
    if any(", then " in name for name in names):
        names = []
    parts: dict[str, list[Line]] = {
        name: [line for line in lines if line["treatment"] == name] for name in names
    }
    parts["all"] = lines
    rows = [
        [name, *counts([line for line in each if not line["edit"]]),
         *counts([line for line in each if line["edit"]])]
        for name, each in parts.items()
    ]  # fmt: skip
    return tables.table(HEAD, rows)


def main() -> None:
    """Treat, inspect and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="lines of what was judged, .jsonl")
    parser.add_argument("--pairs", type=int, default=0, help="pairs of treatments of each scan")
    parser.add_argument("--beside", type=int, default=0, help="frames between treated turns")
    parser.add_argument("--minutes", type=float, default=math.inf, help="judge no longer than this")
    options = parser.parse_args()
    one_thread()
    import tables

    until = time.monotonic() + 60.0 * options.minutes
    if options.beside:
        lines = run_beside(options.file, options.beside, until)
    else:
        lines = run(options.file, options.pairs, until)
    table = report(lines)
    if options.pairs or options.beside:
        print(table)
    else:
        tables.write_section("treatments", table)


if __name__ == "__main__":
    main()
