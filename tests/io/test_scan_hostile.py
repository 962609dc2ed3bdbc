"""Hostile scans and recordings of a mebibyte: a typed error or a scan, little memory, at once."""

from __future__ import annotations

import lzma
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from cost_of_reading import cost_of_reading
from velodyne_packets import block, ethernet, packet, pcap, udp_frame

MIB = 1 << 20
BYTES = "FIELDS x y z\nSIZE 1 1 1\nTYPE U U U\nWIDTH {n}\nHEIGHT 1\nDATA "
PLY = (
    "ply\nformat binary_little_endian 1.0\nelement vertex {n}\n"
    "property uchar x\nproperty uchar y\nproperty uchar z\nend_header\n"
)


def lzf_of_zeros(size: int) -> bytes:
    """Compress zeros as far as LZF can: one zero, then copies of 264 bytes from the byte before."""
    copies, rest = divmod(size - 1, 264)
    return b"\x00\x00" + b"\xe0\xff\x00" * copies + b"\x00\x00" * rest


def pcd_bomb(points: int) -> bytes:
    packed = lzf_of_zeros(3 * points)
    head = BYTES.format(n=points).encode() + b"binary_compressed\n"
    return head + struct.pack("<II", len(packed), 3 * points) + packed


def jumping_packets() -> bytes:
    """Return packets whose azimuths pass the cut in every second block: six frames per packet."""
    blocks = [block((17000 * b) % 36000, [1000] * 32) for b in range(12)]
    frame = ethernet(udp_frame(packet(blocks, product=0x22)))
    return pcap([frame] * (MIB // (len(frame) + 16)))


FILES: dict[str, tuple[str, Callable[[], bytes]]] = {
    "pcd, 30 million points of LZF": ("pcd", lambda: pcd_bomb(30_000_000)),
    "pcd, 4 million points of LZF": ("pcd", lambda: pcd_bomb(4_000_000)),
    "pcd, 2e9 points": (
        "pcd",
        lambda: BYTES.format(n=2_000_000_000).encode() + b"binary\n" + bytes(MIB),
    ),
    "pcd, a million header lines": ("pcd", lambda: b"#\n" * (MIB // 2)),
    "pcd, a million fields": ("pcd", lambda: b"FIELDS" + b" a" * (MIB // 2 - 9)),
    "pcd, one long word": ("pcd", lambda: BYTES.format(n=1).encode() + b"ascii\n" + b"1" * MIB),
    "ply, bytes in xz": (
        "ply.xz",
        lambda: lzma.compress(PLY.format(n=20 * MIB).encode() + bytes(60 * MIB), preset=0),
    ),
    "bin, zeros in xz": ("bin.xz", lambda: lzma.compress(bytes(60 * MIB), preset=0)),
    "3d, zeros in xz": ("3d.xz", lambda: lzma.compress(b"0 0 0\n" * (10 * MIB), preset=0)),
    "3d, one long line": ("3d", lambda: b"1 " * (MIB // 2)),
    "bin, a mebibyte of NaN": ("bin", lambda: b"\xff" * MIB),
    "pcap, frames without end": ("pcap", jumping_packets),
    "pcap, records of nothing": (
        "pcap",
        lambda: pcap([]) + struct.pack("<IIII", 0, 0, 0, 0) * (MIB // 16 - 2),
    ),
    "pcap in xz": ("pcap.xz", lambda: lzma.compress(pcap([bytes(60000)] * 1000), preset=0)),
}


@pytest.mark.parametrize("name", FILES)
def test_hostile_mebibyte_stays_small_and_quick(tmp_path: Path, name: str) -> None:
    suffix, make = FILES[name]
    data = make()
    assert len(data) < 1.2 * MIB
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(data)
    peak, seconds = cost_of_reading("packets" if "pcap" in suffix else "scan", path)
    assert peak <= 256 * MIB
    assert seconds <= 5.0  # a second on an idle machine; this one may be busy
