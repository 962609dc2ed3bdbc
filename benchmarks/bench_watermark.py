"""Time of embedding and verifying a watermark, compared with a keyed hash of the same buffer.

``python benchmarks/bench_watermark.py [--rounds N]`` writes the section `watermark` of the results.
Times are processor times of one thread, the minimum of the rounds; each round measures all rows one
after another. The frame is one of KITTI's, in ``MANIP3D_DATA``.
"""

from __future__ import annotations

import argparse
import hashlib
import hmac
import math
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from measuring import one_thread

FRAME = (
    "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0002_sync/velodyne_points/data/0000000000.bin.xz"
)

# Table 7.1, drive 1: milliseconds of transmit and receive with each embedding.
PUBLISHED = {
    "embed, lbm": 99.80,
    "embed, qim": 110.60,
    "verify, lbm": 109.38,
    "verify, qim": 94.78,
    "paper, embed, lbm": 99.80,
    "paper, embed, qim-printed": 110.60,
    "paper, verify, lbm": 109.38,
    "paper, verify, qim-printed": 94.78,
}

Task = Callable[[], object]


def tasks(folder: Path) -> tuple[dict[str, Task], int]:
    """Return the timed tasks by name, and the number of points."""
    from manip3d import LidarFrame, authenticate
    from manip3d.io import read_scan

    scan = read_scan(Path(os.environ["MANIP3D_DATA"]) / FRAME)
    scan = LidarFrame(scan.points, scan.intensity)
    key = authenticate.KeyFile.create(folder / "bench.key")
    policy = authenticate.Policy(order="any")
    assert scan.intensity is not None
    buffer = np.column_stack([scan.points, scan.intensity]).tobytes()
    secret = bytes(32)
    found: dict[str, Task] = {
        "HMAC-SHA256 of the buffer (OpenSSL)": lambda: hmac.digest(secret, buffer, "sha256"),
        "BLAKE2b of the buffer (hashlib)": lambda: hashlib.blake2b(buffer, key=secret).digest(),
    }
    for embedding in authenticate.EMBEDDINGS:
        marker = authenticate.Watermarker(key, embedding=embedding)
        verifier = authenticate.Watermarker(key)
        sent = marker.embed(scan)

        def verify(
            verifier: authenticate.Watermarker = verifier,
            sent: authenticate.Watermarked = sent,
        ) -> None:
            verifier.reset()
            assert verifier.verify(sent.frame, sent.record, policy=policy).verdict == "authentic"

        found[f"embed, {embedding}"] = lambda marker=marker: marker.embed(scan)  # type: ignore[misc]
        found[f"verify, {embedding}"] = verify
    blocks = authenticate.noise_blocks(1)
    for name in authenticate.PAPER_EMBEDDINGS:
        marked = authenticate.embed_paper(scan, blocks, embedding=name)
        found[f"paper, embed, {name}"] = lambda name=name: authenticate.embed_paper(  # type: ignore[misc]
            scan, blocks, embedding=name
        )
        found[f"paper, verify, {name}"] = lambda m=marked: authenticate.compare_paper(  # type: ignore[misc]
            m.frame, blocks, m.metadata
        )
    return found, scan.num_points


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=30)
    arguments = parser.parse_args()
    one_thread()
    import tables

    with tempfile.TemporaryDirectory() as folder:
        todo, num_points = tasks(Path(folder))
        best = dict.fromkeys(todo, math.inf)
        for _ in range(arguments.rounds):
            for name, task in todo.items():
                start = time.process_time()
                task()
                best[name] = min(best[name], time.process_time() - start)
    base = best["HMAC-SHA256 of the buffer (OpenSSL)"]
    body = [
        [name, f"{1e3 * cost:.2f}", f"{cost / base:.1f}",
         f"{PUBLISHED[name]:.0f}" if name in PUBLISHED else ""]
        for name, cost in best.items()
    ]  # fmt: skip
    head = [f"{num_points:,} points", "ms", "times HMAC", "published, ms"]
    tables.write_section("watermark", tables.table(head, body))


if __name__ == "__main__":
    main()
