"""Share of deleted objects that `inspect` finds with the previous and next turn, by range and size.

``python benchmarks/bench_removed.py edits.jsonl`` deletes one object at a time, of at least 100
returns and 5 to 25 m away, from frames of simulated streets and of KITTI's drive 0005, on none of
which a threshold was chosen, and writes the section `removed` of the results. The false-alarm rate
of all detectors together is 1 %; the section `alarms` has the measured rate.

The result of each edit is a line of the named file. Frames in the file are not judged again, so
that a stopped run continues. ``--minutes`` stops the run after this time; the table then contains
the edits judged so far.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bench_alarms import interval
from measuring import one_thread

if TYPE_CHECKING:
    from collections.abc import Iterator

    from manip3d.lidar import LidarFrame

Line = dict[str, Any]

FIRST_STREET, JUDGED, EDITS = 94_000, 4, 3
"""First of the simulated streets, on which no threshold was chosen; number of judged frames of a
drive; number of edits of each frame."""

DRIVE = "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0005_sync/velodyne_points/data"

RANGES, SIZES = (5.0, 10.0, 15.0, 25.0), (100, 200, 400, 3000)
"""Limits of the table's rows: ranges in metres, and numbers of returns."""


def simulated(number: int) -> list[LidarFrame]:
    """Simulate consecutive frames on a street."""
    from manip3d import simulate

    start = float(np.random.default_rng(number).uniform(0.5, 15.0))
    drive = simulate.drive(
        simulate.street(number), JUDGED + 2, start=start, pictures=False, rng=number, threads=1
    )
    return [frame.scan.frame for frame in drive]


def recorded() -> list[LidarFrame]:
    """Return the frames of drive 0005; empty if KITTI's data are absent."""
    from manip3d import datasets
    from manip3d.io import read_scan

    root = datasets.data_root()
    if root is None:
        return []
    return [read_scan(file) for file in sorted((root / DRIVE).glob("*.bin.xz"))]


def removed(frames: list[LidarFrame], seed: int) -> Iterator[Line]:
    """Yield results of `inspect` on frames with a deleted object between two clean frames."""
    from manip3d.authenticate import inspect
    from manip3d.authenticate._power import _some_object

    random = np.random.default_rng(seed)
    for k in range(1, len(frames) - 1):
        points = frames[k].points
        for _ in range(EDITS):
            rows = _some_object(points, random)
            if rows is None:
                break
            kept = np.setdiff1d(np.arange(len(points)), rows)
            found = inspect(
                frames[k].select(kept), previous=frames[k - 1], following=frames[k + 1],
                power=False, threads=1,
            )  # fmt: skip
            yield {
                "frame": k,
                "returns": len(rows),
                "range": float(np.hypot(*points[rows, :2].mean(axis=0, dtype=np.float64))),
                "verdict": found.verdict,
                "accusing": [r.name for r in found.detectors if r.verdict == "tampered"],
            }


def run(file: Path, streets: int, until: float) -> list[Line]:
    """Return all lines; judge and append those that the file lacks."""
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {line["number"] for line in lines}
    for number in (-1, *range(FIRST_STREET, FIRST_STREET + streets)):
        if number in done or time.monotonic() > until:
            continue
        frames, kind = (recorded(), "KITTI") if number < 0 else (simulated(number), "simulated")
        more = [{"kind": kind, "number": number, **line} for line in removed(frames, abs(number))]
        with file.open("a") as out:
            out.write("".join(json.dumps(line) + "\n" for line in more))
        lines += more
        print(f"{kind} {number}: {len(more)} edits", file=sys.stderr, flush=True)
    return lines


def row(name: str, lines: list[Line]) -> list[str]:
    """Return a row of the table."""
    found = sum(line["verdict"] == "tampered" for line in lines)
    low, high = interval(found, len(lines))
    return [
        name,
        f"{len({(line['number'], line['frame']) for line in lines})}",
        f"{len(lines)}",
        f"{found}",
        f"{found / len(lines):.0%}",
        f"{low:.0%} to {high:.0%}",
    ]


def rows_of(kind: str, lines: list[Line]) -> Iterator[list[str]]:
    """Yield a row for all edits of a kind of frames, and rows for each range and size."""
    parts = {kind: lines}
    for low, high in itertools.pairwise(RANGES):
        name = f"{kind}, {low:g} to {high:g} m"
        parts[name] = [line for line in lines if low <= line["range"] < high]
    for least, most in itertools.pairwise(SIZES):
        name = f"{kind}, {least} to {most} returns"
        parts[name] = [line for line in lines if least <= line["returns"] < most]
    return (row(name, some) for name, some in parts.items() if some)


HEAD = ["deleted from", "frames", "edits", "found", "share", "95 % interval"]


def main() -> None:
    """Judge the edits that the file lacks, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="lines of what was judged, .jsonl")
    parser.add_argument("--streets", type=int, default=250, help="four frames each")
    parser.add_argument("--minutes", type=float, default=math.inf, help="judge no longer than this")
    options = parser.parse_args()
    until = time.monotonic() + 60.0 * options.minutes
    one_thread()
    import tables

    lines = run(options.file, options.streets, until)
    rows = [
        cells
        for kind in ("KITTI", "simulated")
        for cells in rows_of(kind, [line for line in lines if line["kind"] == kind])
        if any(line["kind"] == kind for line in lines)
    ]
    tables.write_section("removed", tables.table(HEAD, rows))


if __name__ == "__main__":
    main()
