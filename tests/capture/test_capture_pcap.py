"""Recordings: byte orders, clocks, link types, and what damaged ones say."""

from __future__ import annotations

import lzma
import struct
from fractions import Fraction
from pathlib import Path

import pytest

from manip3d import FormatError, InputError, capture
from velodyne_packets import block, ethernet, packet, pcap, pcapng, udp6_frame, udp_frame

PAYLOAD = packet([block(20 * b, [1000] * 32) for b in range(12)])
UDP = udp_frame(PAYLOAD)


def read(tmp_path: Path, data: bytes, name: str = "p.pcap") -> tuple[list[int], dict[str, int]]:
    path = tmp_path / name
    path.write_bytes(data)
    source = capture.open(f"pcap:{path}")
    times = [frame.time_ns or 0 for frame in source]
    return times, source.counters


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_byte_orders_and_clocks(tmp_path: Path, order: str, nanoseconds: bool) -> None:
    data = pcap([ethernet(UDP)] * 3, order=order, nanoseconds=nanoseconds, start=1234.75)
    times, counters = read(tmp_path, data)
    assert times == [1_234_750_000_000]
    assert counters["points"] == 3 * 384
    assert counters["file_udp"] == 3


@pytest.mark.parametrize(
    ("link", "frame"),
    [
        (1, ethernet(UDP)),
        (1, ethernet(UDP, tags=1)),
        (1, ethernet(UDP, tags=2)),
        (1, ethernet(udp6_frame(PAYLOAD), kind=0x86DD)),
        (1, ethernet(UDP) + b"trailer"),
        (0, struct.pack("<I", 2) + UDP),
        (0, struct.pack(">I", 30) + udp6_frame(PAYLOAD)),
        (108, struct.pack(">I", 2) + UDP),
        (12, UDP),
        (101, udp6_frame(PAYLOAD)),
        (113, bytes(14) + b"\x08\x00" + UDP),
        (276, b"\x08\x00" + bytes(18) + UDP),
    ],
)
@pytest.mark.parametrize("kind", ["pcap", "pcapng"])
def test_link_types(tmp_path: Path, link: int, frame: bytes, kind: str) -> None:
    make = pcap if kind == "pcap" else pcapng
    _, counters = read(tmp_path, make([frame] * 2, link=link))
    assert (counters["points"], counters["file_packets"]) == (768, 2)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("tick", [0, 3, 6, 9, 10, 128 + 10, 128 + 32])
def test_pcapng_clocks(tmp_path: Path, order: str, tick: int) -> None:
    """To the nanosecond, where the clock of the interface ticks so often."""
    start = Fraction(1_700_000_000_123_456_789, 10**9)
    data = pcapng([ethernet(UDP)] * 2, order=order, tick=tick, start=start)
    times, counters = read(tmp_path, data)
    per_second = 2 ** (tick - 128) if tick >= 128 else 10**tick
    ticks = int(start * per_second)
    assert times == [round(Fraction(ticks * 10**9, per_second))]
    assert counters["points"] == 768


@pytest.mark.parametrize("tick", [20, 127, 128 + 64, 255])
def test_a_clock_that_ticks_too_often_for_64_bits_tells_no_time(tmp_path: Path, tick: int) -> None:
    assert read(tmp_path, pcapng([ethernet(UDP)] * 2, tick=tick))[0] == [0]


def test_compressed_recordings(tmp_path: Path) -> None:
    _, counters = read(tmp_path, lzma.compress(pcap([ethernet(UDP)] * 5)), "p.pcap.xz")
    assert counters["points"] == 5 * 384


@pytest.mark.parametrize(
    ("frame", "counter"),
    [
        (ethernet(UDP, kind=0x0806), "file_other"),
        (ethernet(udp_frame(PAYLOAD, protocol=6)), "file_other"),
        (ethernet(udp_frame(PAYLOAD, fragment=0x2000)), "file_fragments"),
        (ethernet(udp_frame(PAYLOAD, fragment=0x0010)), "file_fragments"),
        (ethernet(UDP)[:-1], "file_cut_short"),
        (ethernet(UDP)[:30], "file_cut_short"),
        (b"\0" * 5, "file_cut_short"),
        (b"", "file_cut_short"),
        (ethernet(b"\x4f" + UDP[1:60]), "file_cut_short"),
        (ethernet(b"\x30" + UDP[1:]), "file_other"),
        (ethernet(UDP[:24] + b"\xff\xff" + UDP[26:]), "file_cut_short"),
        (ethernet(UDP[:24] + b"\x00\x07" + UDP[26:]), "file_cut_short"),
    ],
)
def test_other_traffic_is_counted(tmp_path: Path, frame: bytes, counter: str) -> None:
    _, counters = read(tmp_path, pcap([ethernet(UDP), frame, ethernet(UDP)]))
    assert counters[counter] == 1
    assert (counters["file_packets"], counters["file_udp"], counters["points"]) == (3, 2, 768)


WHOLE = pcap([ethernet(UDP)] * 2)
NG = pcapng([ethernet(UDP)] * 2)


@pytest.mark.parametrize(
    ("data", "byte", "reason"),
    [
        (b"", 0, "expected a pcap or pcapng file"),
        (b"abc", 0, "expected a pcap or pcapng file"),
        (b"\x89PNG" + bytes(100), 0, "expected a pcap or pcapng file"),
        (WHOLE[:20], 20, "file ends within the header"),
        (WHOLE[:30], 30, "file ends within the header of a record"),
        (WHOLE[:-1], len(WHOLE) - 1, "file ends within a record"),
        (WHOLE[:32] + b"\xff\xff\xff\x7f" + WHOLE[36:], 32, "records of at most 262144 bytes"),
        (NG[:10], 10, "file ends within a block"),
        (NG[:-1], len(NG) - 1, "file ends within a block"),
        (NG[:8] + b"abcd" + NG[12:], 8, "expected the byte order mark"),
        (NG[:4] + b"\x08\0\0\0" + NG[8:], 4, "expected a block of 12 bytes or more"),
        (NG[:4] + b"\x1d\0\0\0" + NG[8:], 4, "a multiple of 4"),
        (NG[:4] + b"\0\0\0\x7f" + NG[8:], 4, "records of at most 262144 bytes"),
    ],
)
def test_damaged_recordings(tmp_path: Path, data: bytes, byte: int, reason: str) -> None:
    with pytest.raises(FormatError, match=reason) as caught:
        read(tmp_path, data)
    assert caught.value.byte_offset == byte
    assert caught.value.file == str(tmp_path / "p.pcap")


def test_no_such_recording(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        capture.open(f"pcap:{tmp_path}/none.pcap")


@pytest.mark.parametrize(
    ("data", "points"), [(WHOLE, {24: 0, 1288: 384}), (NG, {28: 0, 60: 0, 1340: 384})]
)
def test_a_recording_may_end_between_records_alone(
    tmp_path: Path, data: bytes, points: dict[int, int]
) -> None:
    """Headers and blocks end at the named bytes; a file cut anywhere else is refused."""
    for size in {*range(0, len(data), 7), *points}:
        if size in points:
            assert read(tmp_path, data[:size])[1]["points"] == points[size]
        else:
            message = "file ends within" if size >= 4 else "expected a pcap or pcapng file"
            with pytest.raises(FormatError, match=message):
                read(tmp_path, data[:size])


def test_a_recording_has_no_newest_frame(tmp_path: Path) -> None:
    (tmp_path / "p.pcap").write_bytes(WHOLE)
    with pytest.raises(InputError, match=r"read_latest: .* is a recording"):
        capture.open(f"pcap:{tmp_path}/p.pcap").read_latest()


def test_one_of_two_sensors(tmp_path: Path) -> None:
    other = udp_frame(packet([block(0, [2000] * 32) for _ in range(12)], product=0x22), port=2370)
    (tmp_path / "p.pcap").write_bytes(pcap([ethernet(UDP), ethernet(other)] * 3))
    (frame,) = capture.open(f"pcap:{tmp_path}/p.pcap", port=2370)
    assert frame.num_points == 3 * 384
    assert frame.format is not None
    assert frame.format.header["model"] == "vlp16"
    with pytest.raises(InputError, match="port: expected 0 to 65535, got 65536"):
        capture.open(f"pcap:{tmp_path}/p.pcap", port=65536)
