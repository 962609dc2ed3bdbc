"""Power of `inspect`: share of edits in real frames that it finds, by class of edits.

``python benchmarks/bench_power.py`` inserts edits into clean frames of KITTI's HDL-64E on which no
threshold was chosen, and writes the section `power` of the results. The previous and the next frame
are clean. The false-alarm rate of all detectors together is 1 %.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from measuring import one_thread

if TYPE_CHECKING:
    from manip3d.authenticate import Power
    from manip3d.lidar import LidarFrame

RAW = "lidar/kitti_raw/2011_09_26"
DRIVE = f"{RAW}/2011_09_26_drive_0005_sync/velodyne_points/data"
EXTRACT = f"{RAW}/2011_09_26_drive_0079_extract/velodyne_points/data/0000000000.bin.xz"
SINGLE = (
    *(f"{DRIVE}/{number:010d}.bin.xz" for number in (1, 6, 11, 16)),
    "lidar/kitti_stereo2015/velodyne/000083.bin.xz",
    "lidar/kitti_stereo2015/velodyne/000131.bin.xz",
    "lidar/kitti_object/velodyne/demo.bin.xz",
)


def measured(folder: Path) -> dict[str, dict[str, Power]]:
    """Measure the power by set of detectors, for `authenticate._known_power.MEASURED`."""
    from manip3d.authenticate import kitti_lattice, measure_power
    from manip3d.authenticate._edits import EDITS, REFLECTANCE_EDITS, WHITE_BOX
    from manip3d.io import read_scan

    def bare(frames: list[LidarFrame]) -> list[LidarFrame]:
        return [frame.replace(intensity=None) for frame in frames]

    lattice = kitti_lattice()
    drive = [read_scan(folder / f"{DRIVE}/{number:010d}.bin.xz") for number in range(20)]
    single = [read_scan(folder / name) for name in SINGLE]
    shapes = [name for name in EDITS if name not in REFLECTANCE_EDITS]
    black_box = [name for name in shapes if name not in WHITE_BOX]
    shining = [*REFLECTANCE_EDITS, *WHITE_BOX]
    eight = bare([*single, read_scan(folder / EXTRACT)])
    found: dict[str, dict[str, Power]] = {}

    def count(name: str, frames: list[LidarFrame], **options: Any) -> None:
        found[name] = measure_power(frames, lattice, threads=1, **options)
        print(name, {k: (p.found, p.planted) for k, p in found[name].items()}, file=sys.stderr)

    count("generic", eight, planted=5, classes=shapes)
    count("turns", bare(drive), planted=2, classes=shapes, neighbours=True)
    count("reflectance", drive[:13], planted=2, classes=shining, neighbours=True)
    count("reflectance alone", single, planted=6, classes=shining)
    for embedding in ("lbm", "qim"):
        count(f"generic {embedding}", eight, planted=5, classes=black_box, embedding=embedding)
    return found


def main() -> None:
    """Insert edits, count the detected ones, and write the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    one_thread()
    import tables
    from manip3d import datasets

    folder = datasets.data_root()
    if folder is None or not (folder / DRIVE).is_dir():
        raise SystemExit("set MANIP3D_DATA to the folder that holds KITTI's frames")
    found = measured(folder)
    names = list(dict.fromkeys(name for powers in found.values() for name in powers))
    rows = [
        [
            name,
            *(
                f"{powers[name].found} of {powers[name].planted}" if name in powers else "–"
                for powers in found.values()
            ),
        ]
        for name in names
    ]
    tables.write_section("power", tables.table(["edits found", *found], rows))


if __name__ == "__main__":
    main()
