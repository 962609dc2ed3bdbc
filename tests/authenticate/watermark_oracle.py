"""Suite 1 of the watermark once more, in plain Python: slow, and independent of the package.

BLAKE2b is that of hashlib; ChaCha20 is written out after RFC 8439 and its original with a nonce of
8 bytes. Numbers are exact (`fractions`, integers); nothing here imports manip3d.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction

Sample = tuple[int, int, int, int]
Point = tuple[float, float, float]

DETACHED, LBM, QIM = 0, 1, 2


def blake(message: bytes, key: bytes = b"") -> bytes:
    return hashlib.blake2b(message, key=key, digest_size=32).digest()


def kdf(key: bytes, number: int) -> bytes:
    """libsodium's crypto_kdf: BLAKE2b of nothing, the number as salt, the context as person."""
    salt = number.to_bytes(8, "little") + bytes(8)
    person = b"m3d-wm01" + bytes(8)
    return hashlib.blake2b(b"", key=key, salt=salt, person=person, digest_size=32).digest()


def _rotated(value: int, by: int) -> int:
    return ((value << by) | (value >> (32 - by))) & 0xFFFFFFFF


def _quarter(s: list[int], a: int, b: int, c: int, d: int) -> None:
    for x, y, z, by in ((a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)):
        s[x] = (s[x] + s[y]) & 0xFFFFFFFF
        s[z] = _rotated(s[z] ^ s[x], by)


def chacha20_block(key: bytes, tail: bytes) -> bytes:
    """One block; ``tail`` holds counter and nonce, 16 bytes."""
    start = list(struct.unpack("<4I", b"expand 32-byte k"))
    start += struct.unpack("<8I", key) + struct.unpack("<4I", tail)
    s = start.copy()
    for _ in range(10):
        _quarter(s, 0, 4, 8, 12)
        _quarter(s, 1, 5, 9, 13)
        _quarter(s, 2, 6, 10, 14)
        _quarter(s, 3, 7, 11, 15)
        _quarter(s, 0, 5, 10, 15)
        _quarter(s, 1, 6, 11, 12)
        _quarter(s, 2, 7, 8, 13)
        _quarter(s, 3, 4, 9, 14)
    return struct.pack("<16I", *((a + b) & 0xFFFFFFFF for a, b in zip(s, start, strict=True)))


def chacha20(key: bytes, size: int) -> bytes:
    """The first bytes of the stream with nonce 0 (8 bytes) and a counter of 8 bytes."""
    blocks = (size + 63) // 64
    stream = b"".join(
        chacha20_block(key, n.to_bytes(8, "little") + bytes(8)) for n in range(blocks)
    )
    return stream[:size]


def chacha20_ietf_words(key: bytes, nonce: bytes) -> Iterator[int]:
    """The words of the stream with a nonce of 12 bytes and a counter of 4."""
    counter = 0
    while True:
        yield from struct.unpack("<16I", chacha20_block(key, struct.pack("<I", counter) + nonce))
        counter += 1


def permutation(key: bytes, nonce: bytes, size: int) -> list[int]:
    """Fisher-Yates, drawing again what would be biased."""
    words = chacha20_ietf_words(key, nonce)
    order = list(range(size))
    for left in range(size, 1, -1):
        drawn = next(words)
        while drawn < 2**32 % left:
            drawn = next(words)
        order[left - 1], order[drawn % left] = order[drawn % left], order[left - 1]
    return order


def f32(value: float) -> float:
    """The nearest float32."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def f32_bits(value: float) -> int:
    return int(struct.unpack("<i", struct.pack("<f", value))[0])


def slice_of(x: float, y: float, slices: int) -> int:
    """Find the slice by exact comparison with directions times 2^28; (0, 0) is in slice 0."""
    if x == 0 and y == 0:
        return 0
    upper = y > 0 or (y == 0 and x > 0)  # azimuth in [0, pi)
    found = 0
    for s in range(1, slices):
        angle = 2 * math.pi * s / slices
        dx = math.floor(math.cos(angle) * 2**28 + 0.5)
        dy = math.floor(math.sin(angle) * 2**28 + 0.5)
        boundary_upper = dy > 0 or (dy == 0 and dx > 0)
        if boundary_upper and not upper:
            behind = True
        elif upper and not boundary_upper:
            behind = False
        else:
            behind = Fraction(dx) * Fraction(y) >= Fraction(dy) * Fraction(x)
        if behind:
            found = s
    return found


def merged(counts: list[int], least: int) -> list[int]:
    """Tile of each slice: the poorest group joins the poorer of its neighbours."""
    groups = [(n, [s]) for s, n in enumerate(counts)]
    while len(groups) > 1:
        at = min(range(len(groups)), key=lambda g: groups[g][0])
        if groups[at][0] >= least:
            break
        before, after = (at - 1) % len(groups), (at + 1) % len(groups)
        into = after if groups[after][0] < groups[before][0] else before
        groups[into] = (groups[into][0] + groups[at][0], groups[into][1] + groups[at][1])
        del groups[at]
    tile_of = [0] * len(counts)
    firsts = sorted(range(len(groups)), key=lambda g: min(groups[g][1]))
    for tile, g in enumerate(firsts):
        for s in groups[g][1]:
            tile_of[s] = tile
    return tile_of


@dataclass
class Embedded:
    points: list[Point]
    record: bytes
    tag: bytes


@dataclass
class Embedder:
    """Embeds the frames of one session."""

    root: bytes
    sensor: bytes
    session: bytes
    embedding: int = LBM
    slices: int = 36
    least: int = 1000
    frame: int = 0
    previous: bytes = bytes(32)
    units: int = 1000
    offset: tuple[int, int, int] = (0, 0, 0)
    is_exact: bool = False  # coordinates are written in float64
    carrier: int = 0
    binds_signs: bool = False  # early records distinguish -0 from 0
    keys: list[bytes] = field(init=False)

    def __post_init__(self) -> None:
        session_key = blake(b"m3d/session/v1" + self.sensor + self.session, self.root)
        self.keys = [kdf(session_key, number) for number in range(1, 6)]

    def bits(self, value: float) -> int:
        return f32_bits(0.0 if value == 0.0 and not self.binds_signs else value)

    def sample(self, point: Point, intensity: float) -> Sample:
        i = self.bits(intensity)
        if self.embedding == DETACHED:
            x, y, z = (self.bits(value) for value in point)
            return x, y, z, i
        x, y, z = (
            round(value * self.units) - at for value, at in zip(point, self.offset, strict=True)
        )
        if self.embedding == LBM:
            return x & ~1, y & ~1, z & ~1, i
        return x, y, (2 * z) // 5, i

    def order(self, s: Sample) -> tuple[int, ...]:
        x, y, z, i = s
        if self.embedding == DETACHED:
            return z, x, y, i
        return z, x * x + y * y, x, y, i

    def written(self, s: Sample, bit: int) -> Point:
        x, y, z, _ = s
        if self.is_exact:
            a, b, c = (((q | bit) + at) / self.units for q, at in zip(s, self.offset, strict=False))
            return a, b, c
        if self.embedding == LBM and self.units != 1000:
            return tuple(f32((q | bit) / self.units) for q in (x, y, z))  # type: ignore[return-value]
        if self.embedding == LBM:
            return f32((x | bit) / 1000), f32((y | bit) / 1000), f32((z | bit) / 1000)
        quarter = 0 if x == y == z == 0 else 4 * z + (3 if bit else 1)
        return f32(x / 1000), f32(y / 1000), f32(quarter / 1600)

    def embed(
        self,
        points: list[Point],
        intensity: list[float] | None,
        time_ns: int = 0,
        is_end: bool = False,
        context: bytes | None = None,
    ) -> Embedded:
        values = [0.0] * len(points) if intensity is None else intensity
        samples = [self.sample(p, i) for p, i in zip(points, values, strict=True)]
        flat = [
            (p[0], p[1]) if self.embedding == DETACHED else (s[0], s[1])
            for p, s in zip(points, samples, strict=True)
        ]
        slices = [slice_of(x, y, self.slices) for x, y in flat]
        least = self.least
        while True:
            tile_of = merged([slices.count(s) for s in range(self.slices)], least)
            tiles = max(tile_of) + 1
            rows: list[list[int]] = [[] for _ in range(tiles)]
            for row, s in enumerate(slices):
                rows[tile_of[s]].append(row)
            for each in rows:
                each.sort(key=lambda row: (self.order(samples[row]), row))
            effective = [len({samples[r] for r in each if samples[r][:3] != (0, 0, 0)})
                         for each in rows]  # fmt: skip
            if tiles == 1 or self.embedding == DETACHED or min(effective) >= 128:
                break
            least *= 4

        flags = (self.frame == 0) | is_end << 1 | (context is not None) << 3
        header = b"m3d-wm01" + struct.pack("<4B", 1, self.embedding, self.carrier, flags)
        header += self.sensor + self.session + struct.pack("<Qq", self.frame, time_ns)
        units = 0 if self.embedding == DETACHED else self.units
        header += struct.pack("<I3q", units, *self.offset)
        fields = (intensity is not None) | self.is_exact << 1
        header += struct.pack("<IHHHI", 0, fields, self.slices, tiles, 0)
        header += struct.pack(f"<{self.slices}H", *tile_of) + (context or bytes(32))
        tile_key, frame_key, bits_key = self.keys[:3]
        full = []
        record = header
        out = list(points)
        for tile, each in enumerate(rows):
            message = b"m3d-tile" + header + struct.pack("<II", tile, len(each))
            message += b"".join(struct.pack("<4i", *samples[row]) for row in each)
            tag = blake(message, tile_key)
            full.append(tag)
            record += struct.pack("<I", len(each)) + tag[:16]
            if self.embedding != DETACHED:
                self._write(each, samples, blake(tag, bits_key), out)
        record += self.previous
        self.previous = blake(b"m3d-frame" + record + b"".join(full), frame_key)
        own = blake(b"m3d-record" + record + self.previous, frame_key)
        self.frame += 1
        return Embedded(out, record + own + self.previous, self.previous)

    def _write(self, rows: list[int], samples: list[Sample], key: bytes, out: list[Point]) -> None:
        stream = chacha20(key, (len(rows) + 7) // 8)
        bits = [stream[n // 8] >> (n % 8) & 1 for n in range(len(rows))]
        n = 0
        while n < len(rows):
            end = n
            while end < len(rows) and samples[rows[end]] == samples[rows[n]]:
                end += 1
            for row, bit in zip(rows[n:end], sorted(bits[n:end]), strict=True):
                origin = samples[row][:3] == (0, 0, 0)
                out[row] = self.written(samples[row], 0 if origin else bit)
            n = end
