"""Cost of kernels of forge and authenticate on scans of millions of points, one thread.

``python benchmarks/bench_scans.py [--rounds N] [--millions N]`` writes the section `scans` of the
results. Ratios are relative to copying the same scan (points and intensity) in the same run.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from measuring import measure, one_thread

Points = NDArray[np.float32]


def cave(points: float) -> Points:
    """Make a terrestrial scan of a bumpy cave: 360 x 100 degrees, columns in order, 3 mm noise."""
    step = math.sqrt(360.0 * 100.0 / points)
    random = np.random.default_rng(0)
    azimuth, elevation = np.meshgrid(
        np.radians(np.arange(-180.0 + step / 2, 180.0, step, dtype=np.float32)),
        np.radians(np.arange(-40.0 + step / 2, 60.0, step, dtype=np.float32)),
        indexing="ij",
    )
    r = 8 + 3 * np.sin(3 * azimuth) * np.cos(2 * elevation)
    r += np.float32(0.003) * random.standard_normal(r.shape, np.float32)
    level = r * np.cos(elevation)
    xyz = [level * np.cos(azimuth), level * np.sin(azimuth), r * np.sin(elevation)]
    scan: Points = np.stack(xyz, axis=-1).reshape(-1, 3).astype(np.float32)
    return scan


def ball(radius: float, count: int) -> Points:
    """Make points evenly spread over a sphere."""
    v = np.random.default_rng(1).normal(size=(count, 3))
    points: Points = (radius * v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)
    return points


Kernels = dict[str, Callable[[], Any]]


def kernels(scan: Points) -> Kernels:
    """Return the kernels by name."""
    from manip3d import authenticate, forge
    from manip3d.lidar import Box, LidarFrame
    from manip3d.metrics import nearest_distances

    frame = LidarFrame(scan, np.zeros(len(scan), np.float32), origin=(0.0, 0.0, 0.0))
    sparse, dense = ball(0.5, 2_000), ball(0.5, 36_000)
    place = (3.0, 1.0, 0.0)
    box = Box((6.0, 4.0, 0.0), (1.5, 1.5, 1.5))
    shuffled = np.random.default_rng(2).permutation(scan)
    away = scan + np.array([10.0, 5.0, 2.0], np.float32)
    near = 4e-3
    distances = nearest_distances(scan, threads=1)
    return {
        "copy": lambda: (frame.points.copy(), np.copy(frame.intensity)),  # type: ignore[arg-type]
        "CTP": lambda: forge.ctp(frame, dense, position=place, threads=1),
        "CRTP, thinned out": lambda: forge.crtp(
            frame, dense, position=place, spacing=3 * near, threads=1
        ),
        "CRTP, interpolated": lambda: forge.crtp(
            frame, sparse, position=place, spacing=near, threads=1
        ),
        "CRTP, spacing from the scan": lambda: forge.crtp(
            frame, dense, position=(8.0, 0.0, 0.0), threads=1
        ),
        "subtractive": lambda: forge.subtract(frame, box, threads=1),
        "deforming, random": lambda: forge.deform(frame, box, amplitude=0.1, threads=1),
        "deforming, dent": lambda: forge.deform(
            frame, box, amplitude=0.1, direction="normal", threads=1
        ),
        "occlusion-aware": lambda: forge.insert_occluding(frame, dense, position=place, threads=1),
        "segmentation": lambda: forge.segment(frame),
        "nearest neighbours": lambda: nearest_distances(scan, threads=1),
        "nearest neighbours, shuffled": lambda: nearest_distances(shuffled, threads=1),
        "detector I, distances known": lambda: authenticate.density_consistency(
            frame, distances=distances, threads=1
        ),
        "detector II": lambda: authenticate.occlusion_consistency(frame, threads=1),
        "angular grid": lambda: authenticate.estimate_grid(frame, threads=1),
        "origin, in (0, 0, 0)": lambda: authenticate.estimate_origin(frame, threads=1),
        "origin, elsewhere": lambda: authenticate.estimate_origin(away, threads=1),
    }


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--millions", type=float, default=10.0, help="of points")
    arguments = parser.parse_args()
    one_thread()
    import tables

    scan = cave(1e6 * arguments.millions)
    tasks = kernels(scan)
    best = dict.fromkeys(tasks, math.inf)
    for _ in range(arguments.rounds):  # outer loop, so that slow phases affect all kernels alike
        for name, task in tasks.items():
            best[name] = min(best[name], measure(task)[1].cpu_s)
    body = [
        [name, f"{1e3 * cost:.0f}", f"{1e9 * cost / len(scan):.1f}", f"{cost / best['copy']:.1f}"]
        for name, cost in best.items()
    ]
    head = [f"{len(scan):,} points", "ms", "ns a point", "times a copy"]
    tables.write_section("scans", tables.table(head, body))


if __name__ == "__main__":
    main()
