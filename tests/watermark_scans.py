"""Scans, keys and frames for tests of the watermark."""

from __future__ import annotations

import hashlib
import os
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT_KEY = bytes(range(32))


def key_file(path: Path, root: bytes = ROOT_KEY, *, expires_ns: int = 0) -> Path:
    """Write a key file with a known key, as the format says it."""
    body = b"m3d-key1" + bytes([1]) + bytes(7) + bytes(range(16))
    body += struct.pack("<qq", 1, expires_ns) + root
    body += hashlib.blake2b(body, digest_size=32).digest()
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    os.write(descriptor, body)
    os.close(descriptor)
    return path


def grid_scan(count: int = 6000, seed: int = 0, *, reach: int = 30_000) -> NDArray[np.float32]:
    """Points on the grid of 1 mm: a street's ground and walls, with ties and repeated points."""
    random = np.random.default_rng(seed)
    units = random.integers(-reach, reach, (count, 3))
    units[:, 2] = random.integers(-1800, 2500, count)
    units[: count // 3, 2] = random.integers(-1740, -1720, count // 3)
    units[5:9] = units[-1]  # the same point five times
    units[9:12] = 0  # no returns
    return (units / 1000.0).astype(np.float32)


def reflectances(count: int, seed: int = 0) -> NDArray[np.float32]:
    values: NDArray[np.float32] = (
        np.random.default_rng(seed).integers(0, 100, count) / 100.0
    ).astype(np.float32)
    return values
