"""Suite 1 byte for byte: known answers, and two implementations that agree."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
import watermark_oracle as oracle
from write_watermark_vectors import CASES, PATH, answers, options

from manip3d import _core
from watermark_scans import ROOT_KEY, grid_scan, key_file, reflectances

VECTORS = json.loads(PATH.read_text())


def test_there_are_24() -> None:
    assert len(VECTORS) == len(CASES) == 24
    tags = [answer["frame_tag"] for vector in VECTORS for answer in vector["answers"]]
    assert len(set(tags)) == len(tags) == sum(case[-1] for case in CASES)


def test_chacha20_is_that_of_the_rfc() -> None:
    block = oracle.chacha20_block(
        bytes(range(32)), bytes.fromhex("01000000" + "000000090000004a00000000")
    )  # RFC 8439, 2.3.2
    assert block.hex().startswith("10f1e7e4d13b5915500fdd1fa32071c4")


@pytest.mark.parametrize("number", [1, 8, 19])
def test_the_independent_implementation_still_writes_them(number: int) -> None:
    assert answers(number) == VECTORS[number]["answers"]
    assert options(number) == {k: v for k, v in VECTORS[number].items() if k != "answers"}


@pytest.mark.parametrize("number", range(24))
def test_known_answers(number: int, tmp_path: Path) -> None:
    vector = VECTORS[number]
    key = _core.WatermarkKey(os.fsencode(key_file(tmp_path / "key", ROOT_KEY)))
    embedder = _core.WatermarkEmbedder(
        key, b"sensor".ljust(16, b"\0"), bytes([number] * 16), vector["embedding"],
        vector["slices"], vector["least"], False, False,
    )  # fmt: skip
    for frame, expected in enumerate(vector["answers"]):
        points = grid_scan(vector["points"], 100 * number + frame)
        values = reflectances(len(points), number)
        context = bytes(range(32)) if number % 3 == 2 else None
        written, record, *_ = embedder.embed(
            points, values if vector["intensity"] else np.empty(0, np.float32),
            10**9 * frame + number, 0, frame + 1 == vector["frames"], context,
        )  # fmt: skip
        assert record[-32:].hex() == expected["frame_tag"]
        assert hashlib.sha256(record).hexdigest() == expected["record"]
        sent = written if len(written) else points
        assert hashlib.sha256(sent.tobytes()).hexdigest() == expected["points"]


def test_slices_are_exact_on_their_boundaries() -> None:
    for slices in (4, 36, 360):
        for x, y in ((1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-5, 5), (-3, -3), (2, -2)):
            expected = int(np.degrees(np.arctan2(y, x)) % 360.0 * slices / 360.0 + 1e-9)
            assert oracle.slice_of(x, y, slices) == expected
