"""Velodyne packets and recordings made from the manuals' descriptions, apart from the C++ code."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterable, Sequence
from fractions import Fraction

import numpy as np

from manip3d.capture import VelodyneCalibration

UPPER, LOWER = 0xEEFF, 0xDDFF
PRODUCT = {"hdl32e": 0x21, "vlp16": 0x22, "vlp16-hires": 0x24, "vlp32c": 0x28}
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39

Block = tuple[int, int, Sequence[tuple[int, int]]]
"""Flag, azimuth in 0.01 degrees, 32 times range and reflectivity."""


def block(azimuth: int, ranges: Sequence[int], *, flag: int = UPPER, shine: int = 7) -> Block:
    return flag, azimuth % 36000, [(int(r), (shine + i) % 256) for i, r in enumerate(ranges)]


def packet(
    blocks: Sequence[Block], *, mode: int = STRONGEST, product: int = 0x21, time_us: int = 0
) -> bytes:
    """Return the 1206 bytes of one data packet."""
    assert len(blocks) == 12
    data = b""
    for flag, azimuth, firings in blocks:
        data += struct.pack("<HH", flag, azimuth)
        data += b"".join(struct.pack("<HB", *firing) for firing in firings)
    return data + struct.pack("<IBB", time_us, mode, product)


def udp_frame(
    payload: bytes,
    *,
    port: int = 2368,
    protocol: int = 17,
    fragment: int = 0,
    sender: str = "127.0.0.1",
) -> bytes:
    """Return an IPv4 packet with a UDP datagram."""
    length = 20 + 8 + len(payload)
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, length, 1, fragment, 64, protocol, 0,
                     socket.inet_aton(sender), b"\x7f\0\0\1")  # fmt: skip
    return ip + struct.pack(">HHHH", 1, port, 8 + len(payload), 0) + payload


def udp6_frame(payload: bytes, *, port: int = 2368, sender: str = "::") -> bytes:
    length = 8 + len(payload)
    addresses = socket.inet_pton(socket.AF_INET6, sender) + bytes(16)
    header = struct.pack(">IHBB", 0x60000000, length, 17, 64) + addresses
    return header + struct.pack(">HHHH", 1, port, length, 0) + payload


def ethernet(ip: bytes, *, tags: Sequence[int] = (), kind: int = 0x0800) -> bytes:
    """Return an Ethernet frame with VLAN tags of these types."""
    vlan = b"".join(struct.pack(">HH", tag, 5) for tag in tags)
    return bytes(12) + vlan + struct.pack(">H", kind) + ip


def pcap(
    frames: Iterable[bytes], *, link: int = 1, order: str = "<", nanoseconds: bool = False,
    start: float = 1000.0, step: float = 0.25,
) -> bytes:  # fmt: skip
    """Return a pcap file with a frame every ``step`` seconds."""
    magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
    data = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link)]
    for i, frame in enumerate(frames):
        seconds, part = divmod(start + i * step, 1.0)
        ticks = round(part * (1e9 if nanoseconds else 1e6))
        data += [struct.pack(order + "IIII", int(seconds), ticks, len(frame), len(frame)), frame]
    return b"".join(data)


def pcapng(
    frames: Iterable[bytes],
    *,
    link: int = 1,
    order: str = "<",
    tick: int = 6,
    start: Fraction = Fraction(1000),
    simple: bool = False,
    obsolete: bool = False,
    offset_s: int = 0,
) -> bytes:
    """Return a pcapng file: section, interface, and an enhanced block per frame, 0.25 s apart.

    Simple blocks have no time; obsolete ones say that 7 packets were dropped. ``tick`` is the
    interface's if_tsresol: a power of ten, or of two where 128 is added. ``offset_s`` is its
    if_tsoffset, which is in no block's time.
    """

    def ng_block(kind: int, body: bytes) -> bytes:
        size = 12 + len(body)
        return struct.pack(order + "II", kind, size) + body + struct.pack(order + "I", size)

    per_second = 2 ** (tick - 128) if tick >= 128 else 10**tick
    data = [ng_block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))]
    option = struct.pack(order + "HHBxxx", 9, 1, tick)
    if offset_s:
        option += struct.pack(order + "HHq", 14, 8, offset_s)
    option += struct.pack(order + "HH", 0, 0)
    data.append(ng_block(1, struct.pack(order + "HHI", link, 0, 65535) + option))
    for i, frame in enumerate(frames):
        ticks = int((start + Fraction(i, 4)) * per_second) % 2**64
        head = struct.pack(order + "HH", 0, 7) if obsolete else bytes(4)
        head += struct.pack(order + "IIII", ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
        kind = 2 if obsolete else 6
        if simple:
            kind, head = 3, struct.pack(order + "I", len(frame))
        data.append(ng_block(kind, head + frame + bytes(-len(frame) % 4)))
    return b"".join(data)


def hdl64e_calibration(*, two_points: bool, seed: int = 0) -> VelodyneCalibration:
    """Return a calibration as of an HDL-64E: 64 lasers, offsets of centimetres to decimetres."""
    rng = np.random.default_rng(seed)
    elevation = np.concatenate([np.linspace(2.0, -8.33, 32), np.linspace(-8.83, -24.33, 32)])
    return VelodyneCalibration(
        elevation=elevation + rng.normal(0, 0.05, 64),
        azimuth_offset=rng.uniform(-9, 9, 64),
        range_offset=rng.uniform(0.8, 1.4, 64),
        two_points=np.full(64, two_points),
        range_offset_x=rng.uniform(0.8, 1.4, 64) if two_points else np.zeros(64),
        range_offset_y=rng.uniform(0.8, 1.4, 64) if two_points else np.zeros(64),
        vertical_offset=np.repeat([0.21, 0.12], 32) + rng.normal(0, 0.01, 64),
        horizontal_offset=np.where(np.arange(64) % 2, 0.026, -0.026),
    )


def ray_points(
    calibration: VelodyneCalibration, laser: np.ndarray, azimuth_deg: np.ndarray, raw: np.ndarray
) -> np.ndarray:
    """Return points by vectors: the place of a laser plus its direction times the range.

    The manual's axes (right, ahead, up) become x ahead, y left, z up.
    """
    azimuth = np.radians(azimuth_deg + calibration.azimuth_offset[laser])
    elevation = np.radians(calibration.elevation[laser])
    ahead = np.stack([np.sin(azimuth), np.cos(azimuth), 0 * azimuth], axis=-1)
    sideways = np.stack([np.cos(azimuth), -np.sin(azimuth), 0 * azimuth], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    beam = np.cos(elevation)[:, None] * ahead + np.sin(elevation)[:, None] * up
    across = -np.sin(elevation)[:, None] * ahead + np.cos(elevation)[:, None] * up
    place = (
        calibration.vertical_offset[laser, None] * across
        - calibration.horizontal_offset[laser, None] * sideways
    )
    sent = calibration.range_unit * raw
    at_far = sent + calibration.range_offset[laser]
    points = place + beam * at_far[:, None]
    if calibration.two_points.any():
        # Between the offsets measured at 2.4 m (x) or 1.93 m (y) and at 25.04 m.
        for axis, near, offsets in (
            (0, 2.4, calibration.range_offset_x),
            (1, 1.93, calibration.range_offset_y),
        ):
            share = (np.abs((place + beam * at_far[:, None])[:, axis]) - near) / (25.04 - near)
            offset = offsets[laser] * (1 - share) + calibration.range_offset[laser] * share
            moved = place + beam * (sent + offset)[:, None]
            points[:, axis] = moved[:, axis]
            if axis == 1:
                points[:, 2] = moved[:, 2]
    return np.stack([points[:, 1], -points[:, 0], points[:, 2]], axis=-1)


def vls128_packets(count: int) -> list[bytes]:
    """Return packets of a VLS-128: blocks of 4 x 32 lasers, one column after the other."""
    flags = (UPPER, LOWER, 0xCCFF, 0xBBFF)
    return [
        packet(
            [block(60 * i + 20 * (b // 4), [2000] * 32, flag=flags[b % 4]) for b in range(12)],
            product=0xA1,
            time_us=160 * i,
        )
        for i in range(count)
    ]


def seen_turns(
    low: float,
    high: float,
    *,
    turns: int = 6,
    hertz: int = 10,
    has_times: bool = True,
    has_dual: bool = False,
) -> list[bytes]:
    """Return packets of a VLP-16 with a field of view from ``low`` to ``high`` degrees.

    If ``low`` is larger, the view includes 0 degrees, where turns begin. As in the
    sensor, a packet holds the next twelve blocks that are seen, and the time of the first one.
    With ``has_dual`` two blocks hold the returns of one column.
    """
    column_us = 110.592
    step = 36e-3 * column_us * hertz  # 0.01 degrees per column
    columns = np.arange(int(36000 * turns / step))
    azimuths = columns * step % 36000
    inside = (azimuths >= 100 * low) & (azimuths <= 100 * high)
    if low > high:
        inside = (azimuths >= 100 * low) | (azimuths <= 100 * high)
    seen = columns[inside]
    if has_dual:
        seen = np.repeat(seen, 2)
    mode = DUAL if has_dual else STRONGEST
    packets = []
    for i in range(0, len(seen) - 11, 12):
        blocks = [block(int(azimuths[c]), [1000] * 32) for c in seen[i : i + 12]]
        time_us = round(seen[i] * column_us) if has_times else 0
        packets.append(packet(blocks, mode=mode, product=PRODUCT["vlp16"], time_us=time_us))
    return packets


def whole_recording(model: str) -> bytes:
    """Return packets of a little more than a turn, made of whole numbers only."""
    packets = []
    for index in range(90):
        blocks: list[Block] = []
        for b in range(12):
            azimuth = 37000 * (12 * index + b) // 1080
            if model == "hdl64e":
                azimuth = 37000 * (6 * index + b // 2) // 540
            ranges = [(index * 7919 + b * 104729 + i * 1299709) % 50000 for i in range(32)]
            flag = LOWER if model == "hdl64e" and b % 2 else UPPER
            blocks.append(block(azimuth, ranges, flag=flag))
        product = PRODUCT.get(model, 0)
        packets.append(packet(blocks, product=product, time_us=index * 1000))
    return pcap(ethernet(udp_frame(data)) for data in packets)


def plain_calibration() -> VelodyneCalibration:
    """Return a calibration of an HDL-64E with round numbers and offsets at two distances."""
    laser = np.arange(64.0)
    return VelodyneCalibration(
        elevation=2.0 - 0.375 * laser,
        azimuth_offset=0.25 * (laser % 16) - 2.0,
        range_offset=1.0 + laser / 256,
        two_points=np.ones(64, np.bool_),
        range_offset_x=1.0 + laser / 128,
        range_offset_y=1.0 - laser / 512,
        vertical_offset=0.25 - laser / 1024,
        horizontal_offset=np.where(laser % 2 == 1, 0.03125, -0.03125),
    )
