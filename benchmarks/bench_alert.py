"""An AlertMonitor in real time: an HDL-64E with a stereo pair, 10 frames per second, with a key.

``python benchmarks/bench_alert.py [--seconds N]`` writes the section `alert` of the results. The
frames are KITTI's drive 2011_09_26_0002 under ``MANIP3D_DATA``, repeated; each is embedded again,
so that the chain of records continues. As in ``manip3d alert run --live``, frames and checks for
which there is no time are skipped.
"""

from __future__ import annotations

import argparse
import os
import resource
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from manip3d.authenticate import AlertCounts

DRIVE = "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0002_sync"
PERIOD = 0.1  # seconds between frames
FARTHEST_BEHIND = 1.0  # longest delay of a frame in seconds, as in ``alert run --live``
SPEED = 10.0  # of the car, m/s


class Gaps:
    """The longest gap between two verdicts of each witness, in frames."""

    def __init__(self) -> None:
        self.last: dict[str, int] = {}
        self.longest: dict[str, int] = {}

    def hear(self, alert: Any) -> None:
        """Add the next alert."""
        for name, told in alert.witnesses.items():
            if told.verdict not in ("skipped", "absent"):
                gap = alert.number - self.last.get(name, -1)
                self.longest[name] = max(gap, self.longest.get(name, 0))
                self.last[name] = alert.number


def resident_mb() -> float:
    """Return the resident memory of this process, MiB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def play(seconds: float, *, budget: float, in_real_time: bool) -> dict[str, Any]:
    """Judge the drive for ``seconds`` of the stream.

    If not ``in_real_time``, the same number of frames is judged without waiting between frames.
    """
    from manip3d import LidarFrame, authenticate, datasets

    drive = datasets.open_kitti(Path(os.environ["MANIP3D_DATA"]) / DRIVE)
    scenes = []
    for frame in drive:
        scan, pair = frame.scan(), frame.pictures(2, 3)
        if pair is not None:
            scenes.append((LidarFrame(scan.points, scan.intensity), pair))
    rig = authenticate.StereoRig.from_calibration(drive[0].calibration())
    count = round(seconds / PERIOD)
    gaps, memory = Gaps(), []
    with (
        tempfile.TemporaryDirectory() as folder,
        authenticate.KeyFile.create(Path(folder) / "bench.key") as key,
        authenticate.Watermarker(key) as sender,
        authenticate.Watermarker(key) as receiver,
    ):
        monitor = authenticate.AlertMonitor(
            receiver, rig=rig, budget_s=budget, background=in_real_time
        )
        begin = 0.0
        for number in range(-1, count):  # frame -1 is a warm-up, which loads modules and tables
            scan, (left, right) = scenes[number % len(scenes)]
            sent = sender.embed(scan, is_end=False)
            if number == 0:
                begin = time.perf_counter()
            due, waited = begin + number * PERIOD, 0.0
            if in_real_time and number > 0:
                late = time.perf_counter() - due
                if late > FARTHEST_BEHIND:
                    monitor.skip()
                    continue
                time.sleep(max(-late, 0.0))
                waited = max(late, 0.0)
            alert = monitor.judge(
                sent.frame, record=sent.record, left=left, right=right, speed_mps=SPEED,
                time_s=number * PERIOD, waited_s=waited,
            )  # fmt: skip
            gaps.hear(alert)
            if number % 50 == 0:
                memory.append(resident_mb())
        monitor.finish()
        counts: AlertCounts = monitor.counts
    return {
        "points": scenes[0][0].num_points,
        "frames": counts.frames,
        "counts": counts.record(),
        "longest_gap_s": {name: gap * PERIOD for name, gap in gaps.longest.items()},
        "memory_mb": memory,
    }


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of the stream")
    parser.add_argument(
        "--memory", action="store_true", help="judge as fast as it goes and print memory alone"
    )
    arguments = parser.parse_args()
    if arguments.memory:
        found = play(arguments.seconds, budget=PERIOD, in_real_time=False)
        print(found["frames"], "frames;", "MB:", " ".join(f"{mb:.0f}" for mb in found["memory_mb"]))
        print(found["counts"])
        return
    import tables

    found = play(arguments.seconds, budget=PERIOD, in_real_time=True)
    counts, gaps = found["counts"], found["longest_gap_s"]
    missed = counts["verdicts"].get("skipped", 0)
    body = [["frames", f"{counts['frames']}"], ["left out whole", f"{missed}"],
            ["verdict later than 100 ms", f"{counts['late']}"],
            ["verdict, mean, ms", f"{1e3 * counts['mean_s']:.0f}"],
            ["verdict, slowest, ms", f"{1e3 * counts['slowest_s']:.0f}"]]  # fmt: skip
    for name, gap in gaps.items():
        spoke = counts["frames"] - counts["skipped"].get(name, 0)
        body.append([f"{name}: frames asked; longest time between, s", f"{spoke}; {gap:.1f}"])
    cores = len(os.sched_getaffinity(0))
    head = [f"{found['points']:,} points, {cores} cores", ""]
    tables.write_section("alert", tables.table(head, body))
    print(counts)


if __name__ == "__main__":
    main()
