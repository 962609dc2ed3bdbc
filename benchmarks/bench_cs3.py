"""Time of each stage of CS3 on published scans and on full frames, on one and two cores.

``python benchmarks/bench_cs3.py [--rounds N]`` writes the section `cs3` of the results. Times are
the minimum over many rounds, for each stage separately, because other work on the machine can only
add time.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from manip3d import Intrinsics
    from manip3d.datasets import RangeScan
    from manip3d.simplify import Cs3Result, Cs3Stream

    Call = Callable[[Cs3Stream], Cs3Result]

STAGES = ("importance", "order", "sampling", "triangulation", "output")


def waves() -> Any:
    """Return a frame of 640 x 480 pixels, all with depth: waves, a step, and a sensor's noise."""
    import numpy as np

    v, u = np.mgrid[0:480, 0:640]
    noise = np.random.default_rng(0).normal(scale=2.0, size=u.shape)
    depth = 2000 + 300 * np.sin(u / 40) * np.cos(v / 30) + 400 * (u > 320) + noise
    return depth.astype(np.uint16)


def of_scan(scan: RangeScan) -> Call:
    """Return a call that simplifies a range scan."""
    points = scan.points.astype("float32")
    return lambda stream: stream.simplify_grid(points, scan.valid)


def of_frame(depth: Any, camera: Intrinsics) -> Call:
    """Return a call that simplifies a depth image."""
    return lambda stream: stream.simplify(depth, camera)


def inputs() -> list[tuple[str, int, Call]]:
    """Return name, target number of points, and call of each available input."""
    from manip3d import Intrinsics, datasets

    found: list[tuple[str, int, Call]] = []
    for name, target in (("bun000", 2012), ("happyStandRight_0", 3902)):
        with contextlib.suppress(datasets.DataMissingError):
            found.append((name, target, of_scan(datasets.load_scan(name))))
    for name in ("scene_livingroom", "person_turning"):
        with contextlib.suppress(datasets.DataMissingError):
            frame = datasets.load_frame(name)
            valid = int((frame.depth > 0).sum())
            call = of_frame(frame.depth, frame.intrinsics)
            found.append((f"{name}, {valid:,} pixels", round(0.05 * valid), call))
    camera = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    found.append(("waves, 307,200 pixels", 15360, of_frame(waves(), camera)))
    return found


def profile(
    call: Call, target: int, threads: int, rounds: int
) -> tuple[Cs3Result, dict[str, float], float]:
    """Return the result, and the minimum seconds of each stage and of the whole call."""
    from manip3d.simplify import Cs3Stream

    stream = Cs3Stream(target, threads=threads, frames=1)
    stages: dict[str, float] = {}
    whole = float("inf")
    for _ in range(rounds):
        start = time.perf_counter()
        result = call(stream)
        whole = min(whole, time.perf_counter() - start)
        stages = {k: min(stages.get(k, s), s) for k, s in result.timings.items()}
    return result, stages, whole


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=300)
    rounds = parser.parse_args().rounds
    import tables

    cores = sorted(os.sched_getaffinity(0))
    body = []
    for name, target, call in inputs():
        for threads in (1, 2):
            os.sched_setaffinity(0, cores if threads > 1 else cores[-1:])
            result, stages, whole = profile(call, target, threads, rounds)
            body.append(
                [
                    name,
                    f"{threads}",
                    f"{result.num_vertices:,}",
                    *(f"{1e3 * stages[stage]:.3f}" for stage in STAGES),
                    f"{1e3 * sum(stages.values()):.2f}",
                    f"{1e3 * whole:.2f}",
                ]
            )
    head = ["CS3, milliseconds", "threads", "vertices", *STAGES, "sum", "Python call"]
    tables.write_section("cs3", tables.table(head, body))


if __name__ == "__main__":
    main()
