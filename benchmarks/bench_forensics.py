"""Time of the detectors, and of `inspect` with all of them, on one frame of an HDL-64E, one thread.

``python benchmarks/bench_forensics.py [--rounds N]`` writes the section `forensics` of the results.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from measuring import measure, one_thread

RAW = "lidar/kitti_raw"
TUNING = f"{RAW}/2011_09_26/2011_09_26_drive_0002_sync/velodyne_points/data"
FRAMES = (
    f"{TUNING}/0000000009.bin.xz",
    f"{RAW}/unidentified_drive_a/velodyne_points/data/0000000000.bin.xz",
    f"{RAW}/2011_09_26/unidentified_drive_b/velodyne_points/data/0000000000.bin.xz",
)

Detector = Callable[[Any], object]


def detectors(folder: Path) -> dict[str, Detector]:
    """Return the detectors by name; each judges one frame."""
    from manip3d import authenticate
    from manip3d.io import read_scan

    turns = [read_scan(folder / TUNING / f"000000000{k}.bin.xz") for k in (7, 8, 9)]
    before = turns[1]
    lattice = authenticate.estimate_lattice([read_scan(folder / TUNING / "0000000000.bin.xz")])
    return {
        "I, density": lambda scan: authenticate.density_consistency(scan, threads=1),
        "II, occlusion": lambda scan: authenticate.occlusion_consistency(scan, threads=1),
        "III, lattice known": lambda scan: authenticate.generic_consistency(
            scan, lattice=lattice, threads=1
        ),
        "III, with the frame before": lambda scan: authenticate.generic_consistency(
            scan, lattice=lattice, previous=before, threads=1
        ),
        "III, lattice from the frame": lambda scan: authenticate.generic_consistency(
            scan, threads=1
        ),
        "`inspect`, lattice known": lambda scan: authenticate.inspect(
            scan, lattice=lattice, power=False, threads=1
        ),
        "`inspect`, with the turns before and after": lambda _: authenticate.inspect(
            turns[1], previous=turns[0], following=turns[2], power=False, threads=1
        ),
    }


def _again(detect: Detector, frame: Any) -> float:
    """Return the processor time of a second call, which reuses the first call's memory.

    This is the time per frame of a stream.
    """
    start = time.process_time()
    detect(frame)
    return time.process_time() - start


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=7)
    rounds = parser.parse_args().rounds
    one_thread()  # must run before any library counts the cores
    import tables
    from manip3d import datasets
    from manip3d.io import read_scan

    folder = datasets.data_root()
    if folder is None or not (folder / RAW).is_dir():
        raise SystemExit("set MANIP3D_DATA to the folder that holds KITTI's frames")
    frames = [read_scan(folder / name) for name in FRAMES]
    body = []
    for name, detect in detectors(folder).items():
        first = statistics.median(
            min(measure(detect, frame)[1].cpu_s for _ in range(rounds)) for frame in frames
        )
        next_one = statistics.median(
            min(_again(detect, frame) for _ in range(rounds)) for frame in frames
        )
        points = float(np.mean([len(frame.points) for frame in frames]))
        body.append(
            [name, f"{1e3 * next_one:.1f}", f"{1e9 * next_one / points:.0f}", f"{1e3 * first:.1f}"]
        )
    head = ["detector", "ms a frame", "ns a point", "ms, the first frame"]
    tables.write_section("forensics", tables.table(head, body))


if __name__ == "__main__":
    main()
