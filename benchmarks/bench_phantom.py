"""Time of each stage of the phantom limb, compared with table 4.1: people at 8, 10 and 12 feet.

``python benchmarks/bench_phantom.py [--rounds N] [--frames N]`` writes the section `phantom` of the
results. The people are simulated. One thread is pinned to one core. The time of a stage is the mean
over the frames of the minimum wall time over many rounds, because other work on the machine can
only add time. The time of the whole call is the processor time of `PhantomPipeline.process` from
Python, into existing arrays; mean and 99th percentile over all calls.
"""

from __future__ import annotations

import argparse
import csv
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from measuring import one_thread

if TYPE_CHECKING:
    from manip3d import RgbdFrame

ROWS = {  # rows of the published table, with this package's names of the stages
    "point cloud segmentation": "segmentation",
    "removal of points": "removal",
    "mirroring the intact limb": "mirroring",
    "hole filling": "hole filling",
    "phantom skeleton generation": "phantom skeleton",
    "point cloud generation": "point cloud",
    "textured mesh generation": "textured mesh",
}
DISTANCES = (8, 10, 12)
LIMBS = ("right_arm", "right_leg")


@dataclass(frozen=True)
class Profile:
    """Times of one recording, milliseconds."""

    points: float
    faces: float
    stages: dict[str, float]
    mean: float
    p99: float

    def summary(self) -> dict[str, str]:
        """Return the rows below the stages."""
        return {
            "whole call, mean": f"{self.mean:.2f}",
            "whole call, p99": f"{self.p99:.2f}",
            "points": f"{self.points:,.0f}",
            "faces": f"{self.faces:,.0f}",
        }


def recording(limb: str, feet: int, frames: int) -> list[RgbdFrame]:
    """Simulate a person without the limb, who exercises the other one, seen by a Kinect V2."""
    from manip3d.simulate import BodySimulator

    motion = "arm-raise" if limb.endswith("arm") else "stepping"
    simulator = BodySimulator(
        motion=motion, amputated=limb, distance=0.3048 * feet, color="full", frames=frames
    )
    return list(simulator)


def profile(limb: str, frames: list[RgbdFrame], rounds: int) -> Profile:
    """Process the recording ``rounds`` times and return its times."""
    import numpy as np

    from manip3d.modify import PhantomPipeline
    from manip3d.modify._phantom import _Buffers

    pipeline = PhantomPipeline(limb)  # type: ignore[arg-type]
    buffers = _Buffers.of_size(*frames[0].depth.shape)
    stages = {name: np.full(len(frames), np.inf) for name in ROWS.values()}
    calls, points, faces = [], 0, 0
    for _ in range(rounds):
        pipeline.reset()
        for k, frame in enumerate(frames):
            start = time.thread_time()
            report: dict[str, Any] = pipeline._core.process(
                frame.depth,
                frame.body_index,
                frame.calibration.depth,
                frame.calibration.registration,
                frame.color,
                frame.skeletons,
                frame.time_ns,
                frame.number,
                buffers,
            )
            calls.append(time.thread_time() - start)
            for name, seconds in report["seconds"].items():
                stages[name][k] = min(stages[name][k], seconds)
            points += report["num_points"]
            faces += report["num_faces"]
    least = {name: 1e3 * float(seconds.mean()) for name, seconds in stages.items()}
    mean, p99 = 1e3 * float(np.mean(calls)), 1e3 * float(np.quantile(calls, 0.99))
    return Profile(points / len(calls), faces / len(calls), least, mean, p99)


def published() -> dict[str, list[float]]:
    """Return table 4.1: milliseconds by row."""
    from importlib.resources import files

    name = "table_4_1_phantom_limb_ms.csv"
    text = files("manip3d.experiments.published").joinpath(name).read_text(encoding="utf-8")
    rows = list(csv.reader(text.splitlines()))[1:]
    return {row[0]: [float(value) for value in row[1:]] for row in rows}


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=170)
    parser.add_argument("--frames", type=int, default=60)
    options = parser.parse_args()
    one_thread()
    import tables

    printed = published()
    columns = [(limb, feet) for feet in DISTANCES for limb in LIMBS]
    found = {
        key: profile(key[0], recording(*key, options.frames), options.rounds) for key in columns
    }
    head = ["Milliseconds"]
    for feet in DISTANCES:
        head += [f"published, {feet} ft", *(limb.replace("_", " ") for limb in LIMBS)]
    body = []
    for row, stage in [*ROWS.items(), ("total", "")]:
        line = [row]
        for k, feet in enumerate(DISTANCES):
            line.append(f"{printed[row][k]:g}")
            for limb in LIMBS:
                stages = found[limb, feet].stages
                value = stages[stage] if stage else sum(stages.values())
                line.append(f"{value:.4f}")
        body.append(line)
    summaries = {key: p.summary() for key, p in found.items()}
    for name in summaries[columns[0]]:
        line = [name]
        for feet in DISTANCES:
            line += ["", *(summaries[limb, feet][name] for limb in LIMBS)]
        body.append(line)
    tables.write_section("phantom", tables.table(head, body))


if __name__ == "__main__":
    main()
