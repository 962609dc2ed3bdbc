"""Fit of the boxes of `inspect` to moved cars: the section `boxes` of the results.

``python benchmarks/bench_boxes.py`` moves each car of clean frames by 0.5 to 3 m over the ground in
a random direction and writes the frame as the scanner does. It compares the box of the strongest
region with the tight box around the car at its new place, by the intersection over union of the
volumes of the two rotated boxes. The frames are those of KITTI on which no threshold was chosen, if
the data are present, and of simulated streets that are in no calibration.
"""

from __future__ import annotations

import argparse
import math
import sys
from typing import TYPE_CHECKING

import numpy as np

from measuring import one_thread

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from manip3d.lidar import Box

    Points = NDArray[np.float32]
    Polygon = list[tuple[float, float]]

NEAREST, FARTHEST = 0.5, 3.0
"""Smallest and largest movement of a car, metres."""

MIN, MAX = (2.5, 1.2, 1.0), (5.5, 2.6, 2.4)
"""Smallest and largest length, width and height of the points of a car seen from two sides,
metres."""

FIRST_STREET = 89_000
"""First of the simulated streets, on which no threshold was chosen."""


def corners(box: Box) -> Polygon:
    """Return the four corners of a box seen from above, counter-clockwise."""
    cos, sin = math.cos(box.yaw), math.sin(box.yaw)
    x, y, _ = box.center
    half = [
        (0.5 * a * box.size[0], 0.5 * b * box.size[1])
        for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
    ]
    return [(x + cos * a - sin * b, y + sin * a + cos * b) for a, b in half]


def clipped(polygon: Polygon, by: Polygon) -> Polygon:
    """Clip a polygon by a convex one [Sutherland and Hodgman, CACM 1974]."""
    for (ax, ay), (bx, by_) in zip(by, [*by[1:], by[0]], strict=True):
        sides = [(bx - ax) * (y - ay) - (by_ - ay) * (x - ax) for x, y in polygon]
        kept: Polygon = []
        for i, (x, y) in enumerate(polygon):
            (px, py), before, here = polygon[i - 1], sides[i - 1], sides[i]
            if (before >= 0.0) != (here >= 0.0):
                share = before / (before - here)
                kept.append((px + share * (x - px), py + share * (y - py)))
            if here >= 0.0:
                kept.append((x, y))
        polygon = kept
    return polygon


def area(polygon: Polygon) -> float:
    """Return the area of a polygon."""
    turns = [x * polygon[i - 1][1] - polygon[i - 1][0] * y for i, (x, y) in enumerate(polygon)]
    return 0.5 * abs(math.fsum(turns))


def overlap(first: Box, second: Box) -> float:
    """Return the intersection over union, by volume, of two boxes rotated about the vertical."""
    tops = [box.center[2] + 0.5 * box.size[2] for box in (first, second)]
    feet = [box.center[2] - 0.5 * box.size[2] for box in (first, second)]
    height = max(0.0, min(tops) - max(feet))
    shared = area(clipped(corners(first), corners(second))) * height
    volumes = math.prod(first.size) + math.prod(second.size)
    return shared / (volumes - shared) if volumes > shared else 0.0


def real_frames() -> Iterator[tuple[str, Points]]:
    """Yield frames of KITTI on which detector III was not tuned; none if the data are absent."""
    from manip3d import datasets
    from manip3d.experiments.detector_3 import CHOSEN_ON, SCENES
    from manip3d.io import read_scan

    root = datasets.data_root()
    for scene in SCENES:
        for file in scene.files:
            if root is not None and scene.name not in CHOSEN_ON and (root / file).is_file():
                yield "KITTI", read_scan(root / file).points


def simulated_frames(streets: int) -> Iterator[tuple[str, Points]]:
    """Yield one frame of each of ``streets`` streets."""
    from manip3d.simulate.lidar import hdl64e
    from manip3d.simulate.streets import street

    for number in range(FIRST_STREET, FIRST_STREET + streets):
        yield "simulated", hdl64e(street(number), 3.0, rng=number, threads=1).points


def cars(scan: Points) -> Iterator[NDArray[np.int64]]:
    """Yield the rows of each free-standing object of a car's size at a distance of 5 to 35 m."""
    from manip3d import forge
    from manip3d.authenticate._generic import tight_box

    found = forge.segment(scan, tolerance=0.2, ground_height=0.2)
    for index in range(len(found.boxes)):
        rows = found.rows(index)
        size = tight_box(scan[rows].astype(np.float64)).size
        sides = (max(size[:2]), min(size[:2]), size[2])
        rho = float(np.hypot(*scan[rows, :2].mean(axis=0)))
        fits = all(a <= side <= b for a, side, b in zip(MIN, sides, MAX, strict=True))
        if fits and 5.0 <= rho <= 35.0 and len(rows) >= 100:
            yield np.asarray(rows, np.int64)


def measured(frames: Iterator[tuple[str, Points]]) -> dict[str, list[tuple[float, float]]]:
    """Return movement (metres) and overlap of each car, by kind of frame; 0: not found."""
    from manip3d.authenticate import inspect, kitti_lattice
    from manip3d.authenticate._generic import tight_box
    from manip3d.experiments._lidar_attacks import as_written
    from manip3d.lidar import LidarFrame

    found: dict[str, list[tuple[float, float]]] = {}
    for number, (kind, scan) in enumerate(frames):
        random = np.random.default_rng(number)
        for rows in cars(scan):
            length, angle = random.uniform(NEAREST, FARTHEST), random.uniform(0.0, 2.0 * math.pi)
            shift = length * np.array([math.cos(angle), math.sin(angle), 0.0])
            moved = scan.copy()
            moved[rows] += shift.astype(np.float32)
            truth = tight_box(moved[rows].astype(np.float64))
            result = inspect(
                LidarFrame(as_written(moved, kitti_lattice()), origin=(0.0, 0.0, 0.0)),
                power=False, threads=1,
            )  # fmt: skip
            accused = [report for report in result.detectors if report.verdict == "tampered"]
            value = overlap(accused[0].regions[0].box, truth) if accused else 0.0
            found.setdefault(kind, []).append((length, value))
        print(kind, number, {k: len(v) for k, v in found.items()}, file=sys.stderr, flush=True)
    return found


HEAD = ["cars moved", "cars", "found", "median IoU", "lower quartile", "IoU >= 0.5"]


def rows_of(kind: str, values: list[tuple[float, float]]) -> Iterator[list[str]]:
    """Yield a row for all cars of a kind of frames, and one for each range of movements."""
    parts = {f"{kind}, 0.5 to 3 m": (NEAREST, FARTHEST)}
    parts |= {f"{kind}, {a:g} to {b:g} m": (a, b) for a, b in ((0.5, 1.0), (1.0, 2.0), (2.0, 3.0))}
    for name, (low, high) in parts.items():
        overlaps = [value for length, value in values if low <= length <= high]
        if overlaps:
            yield [
                name,
                f"{len(overlaps)}",
                f"{sum(value > 0.0 for value in overlaps)}",
                f"{np.median(overlaps):.2f}",
                f"{np.quantile(overlaps, 0.25):.2f}",
                f"{np.mean(np.asarray(overlaps) >= 0.5):.0%}",
            ]


def main() -> None:
    """Move cars, compare boxes, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--streets", type=int, default=40, help="simulated frames")
    options = parser.parse_args()
    one_thread()
    import tables

    found = measured(real_frames())
    found |= measured(simulated_frames(options.streets))
    rows = [row for kind, values in found.items() for row in rows_of(kind, values)]
    tables.write_section("boxes", tables.table(HEAD, rows))


if __name__ == "__main__":
    main()
