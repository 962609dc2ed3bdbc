"""Reads frames as the page does; the layout is in stream_frame.hpp."""

from __future__ import annotations

import io
import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

HEADER = struct.Struct("<4sHHIIqqIIIf3f3fIIII")
WIDE, SHARED = 1, 2


@dataclass(frozen=True)
class ReadFrame:
    sequence: int
    time_ns: int
    captured_ns: int
    opacity: float
    vertices: NDArray[np.float64]
    texels: NDArray[np.uint16]
    body: NDArray[np.int64]
    phantom: NDArray[np.int64]
    body_jpeg: bytes
    phantom_jpeg: bytes
    is_shared: bool
    status: Any


def read_frame(message: bytes) -> ReadFrame:
    (magic, version, size, sequence, flags, time_ns, captured_ns, n, bodies, phantoms, opacity,
     *rest) = HEADER.unpack_from(message)  # fmt: skip
    low, step, (body_jpeg, phantom_jpeg, status, zero) = rest[:3], rest[3:6], rest[6:]
    assert (magic, version, size, zero) == (b"M3DL", 1, HEADER.size, 0)
    at = size

    def section(length: int) -> bytes:
        nonlocal at
        start = -(-at // 4) * 4
        at = start + length
        assert at <= len(message)
        return message[start:at]

    positions = np.frombuffer(section(6 * n), "<u2").reshape(-1, 3)
    texels = np.frombuffer(section(4 * n), "<u2").reshape(-1, 2)
    kind = "<u4" if flags & WIDE else "<u2"
    faces = np.frombuffer(section(3 * (bodies + phantoms) * int(kind[2])), kind).reshape(-1, 3)
    first = section(body_jpeg)
    second = b"" if flags & SHARED else section(phantom_jpeg)
    words = section(status)
    assert at == len(message)
    return ReadFrame(
        sequence,
        time_ns,
        captured_ns,
        opacity,
        np.array(low) + np.array(step) * positions,
        texels,
        faces[:bodies].astype(np.int64),
        faces[bodies:].astype(np.int64),
        first,
        second,
        bool(flags & SHARED),
        json.loads(words),
    )


def picture(jpeg: bytes) -> NDArray[np.uint8]:
    from PIL import Image

    with Image.open(io.BytesIO(jpeg)) as image:
        return np.asarray(image.convert("RGB"))
