"""Write the 24 known answers of the watermark by the independent implementation.

``PYTHONPATH=tests python tests/authenticate/write_watermark_vectors.py`` writes
watermark_vectors.json.
"""

from __future__ import annotations

import hashlib
import json
import struct
from pathlib import Path
from typing import Any

import watermark_oracle as oracle

from watermark_scans import ROOT_KEY, grid_scan, reflectances

PATH = Path(__file__).with_name("watermark_vectors.json")

# embedding, points, slices, least points, with intensity, frames
CASES = [
    (embedding, points, slices, least, intensity, frames)
    for embedding in (oracle.DETACHED, oracle.LBM, oracle.QIM)
    for points, slices, least, intensity, frames in (
        (1, 36, 1000, True, 1),
        (40, 36, 1000, False, 2),
        (700, 4, 100, True, 1),
        (1500, 36, 30, True, 3),
        (1500, 36, 1000, False, 1),
        (900, 360, 2, True, 1),
        (800, 7, 200, True, 2),
        (2400, 36, 40, True, 1),
    )
]


def options(number: int) -> dict[str, Any]:
    embedding, points, slices, least, intensity, frames = CASES[number]
    return {"embedding": embedding, "points": points, "slices": slices, "least": least,
            "intensity": intensity, "frames": frames}  # fmt: skip


def answers(number: int) -> list[dict[str, str]]:
    embedding, count, slices, least, with_intensity, frames = CASES[number]
    embedder = oracle.Embedder(
        ROOT_KEY, b"sensor".ljust(16, b"\0"), bytes([number] * 16), embedding, slices, least
    )
    found = []
    for frame in range(frames):
        points = [tuple(map(float, row)) for row in grid_scan(count, 100 * number + frame)]
        values = [float(v) for v in reflectances(count, number)] if with_intensity else None
        context = bytes(range(32)) if number % 3 == 2 else None
        sent = embedder.embed(points, values, 10**9 * frame + number, frame + 1 == frames, context)
        packed = b"".join(struct.pack("<3f", *point) for point in sent.points)
        found.append({
            "record": hashlib.sha256(sent.record).hexdigest(),
            "frame_tag": sent.tag.hex(),
            "points": hashlib.sha256(packed).hexdigest(),
        })  # fmt: skip
    return found


if __name__ == "__main__":
    vectors = [options(n) | {"answers": answers(n)} for n in range(len(CASES))]
    PATH.write_text(json.dumps(vectors, indent=1) + "\n")
