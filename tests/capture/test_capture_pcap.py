"""Recordings: byte orders, clocks, link types, and what damaged ones say."""

from __future__ import annotations

import hashlib
import lzma
import re
import struct
from fractions import Fraction
from pathlib import Path

import pytest

from command_line import manip3d
from manip3d import FormatError, InputError, capture
from velodyne_packets import (
    block,
    ethernet,
    packet,
    pcap,
    pcapng,
    seen_turns,
    udp6_frame,
    udp_frame,
)

PAYLOAD = packet([block(20 * b, [1000] * 32) for b in range(12)])
UDP = udp_frame(PAYLOAD)


def read(
    tmp_path: Path, data: bytes, name: str = "p.pcap"
) -> tuple[list[int | None], dict[str, int]]:
    path = tmp_path / name
    path.write_bytes(data)
    source = capture.open(f"pcap:{path}")
    times = [frame.time_ns for frame in source]
    return times, source.counters


def arrived(counters: dict[str, int]) -> int:
    """Return the number of packets that reached the decoder, most of which repeat `PAYLOAD`."""
    return counters["packets"] + counters["repeated_packets"]


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_byte_orders_and_clocks(tmp_path: Path, order: str, nanoseconds: bool) -> None:
    data = pcap([ethernet(UDP)] * 3, order=order, nanoseconds=nanoseconds, start=1234.75)
    times, counters = read(tmp_path, data)
    assert times == [1_234_750_000_000]
    assert arrived(counters) == 3
    assert counters["file_udp"] == 3


@pytest.mark.parametrize(
    ("link", "frame"),
    [
        (1, ethernet(UDP)),
        (1, ethernet(UDP, tags=(0x8100,))),
        (1, ethernet(UDP, tags=(0x8100, 0x8100))),
        (1, ethernet(UDP, tags=(0x88A8, 0x8100))),
        (1, ethernet(UDP, tags=(0x9100, 0x8100))),
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
    assert (arrived(counters), counters["file_packets"]) == (2, 2)


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
    assert arrived(counters) == 2


@pytest.mark.parametrize("tick", [20, 127, 128 + 64, 255])
def test_a_clock_that_ticks_too_often_for_64_bits_tells_no_time(tmp_path: Path, tick: int) -> None:
    assert read(tmp_path, pcapng([ethernet(UDP)] * 2, tick=tick))[0] == [None]


@pytest.mark.parametrize("order", ["<", ">"])
def test_an_interface_adds_seconds_to_its_times(tmp_path: Path, order: str) -> None:
    """The blocks' times count from the offset of the interface (if_tsoffset)."""
    recording = [ethernet(UDP)] * 2
    data = pcapng(recording, order=order, start=Fraction(1, 2), offset_s=1_700_000_000)
    assert read(tmp_path, data)[0] == [1_700_000_000_500_000_000]
    data = pcapng(recording, order=order, start=Fraction(1000), offset_s=-1001)
    assert read(tmp_path, data)[0] == [-(10**9)]
    for offset_s in (2**63 - 1, -(2**63), 9_000_000_000):
        data = pcapng(recording, order=order, tick=0, start=Fraction(1000), offset_s=offset_s)
        assert read(tmp_path, data)[0] == [None]


@pytest.mark.parametrize("order", ["<", ">"])
def test_obsolete_packet_blocks_are_read(tmp_path: Path, order: str) -> None:
    data = pcapng([ethernet(UDP)] * 2, order=order, obsolete=True)
    times, counters = read(tmp_path, data)
    assert times == [1000 * 10**9]
    assert (arrived(counters), counters["file_packets"]) == (2, 2)


def test_blocks_without_packets_may_be_long(tmp_path: Path) -> None:
    """Names of a Name Resolution Block, behind the interface."""
    size = 12 + 600_000
    names = struct.pack("<II", 4, size) + bytes(600_000) + struct.pack("<I", size)
    times, counters = read(tmp_path, NG[:60] + names + NG[60:])
    assert times == [1000 * 10**9]
    assert arrived(counters) == 2
    with pytest.raises(FormatError, match="file ends within a block") as caught:
        read(tmp_path, NG[:60] + names[:-1])
    assert caught.value.byte_offset == 60 + size - 1


@pytest.mark.parametrize("order", ["<", ">"])
def test_simple_blocks_have_no_time(tmp_path: Path, order: str) -> None:
    data = pcapng([ethernet(UDP)] * 2, order=order, simple=True)
    times, counters = read(tmp_path, data)
    assert times == [None]
    assert arrived(counters) == 2
    done = manip3d("convert", tmp_path / "p.pcap", "-o", tmp_path / "drive")
    assert done.returncode == 0
    assert [p.name for p in (tmp_path / "drive").iterdir()] == ["velodyne"]


def test_compressed_recordings(tmp_path: Path) -> None:
    _, counters = read(tmp_path, lzma.compress(pcap([ethernet(UDP)] * 5)), "p.pcap.xz")
    assert arrived(counters) == 5


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
    assert (counters["file_packets"], counters["file_udp"], arrived(counters)) == (3, 2, 2)


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
    frames = []
    for azimuth in (0, 40, 80):
        other = packet([block(azimuth, [2000] * 32) for _ in range(12)], product=0x22)
        frames += [ethernet(UDP), ethernet(udp_frame(other, port=2370))]
    (tmp_path / "p.pcap").write_bytes(pcap(frames))
    (frame,) = capture.open(f"pcap:{tmp_path}/p.pcap", port=2370)
    assert frame.num_points == 3 * 384
    assert frame.format is not None
    assert frame.format.header["model"] == "vlp16"
    with pytest.raises(InputError, match="port: expected 0 to 65535, got 65536"):
        capture.open(f"pcap:{tmp_path}/p.pcap", port=65536)


A, B = "192.168.1.201", "192.168.1.202"
TURN = seen_turns(0, 360, turns=1)
SENSORS = {
    "port": ([{"port": 2368}, {"port": 2369}], "127.0.0.1:2368", "127.0.0.1:2369"),
    "address": ([{"sender": A}, {"sender": B}], f"{A}:2368", f"{B}:2368"),
    "ipv6": ([{"sender": "fe80::1"}, {"sender": "fe80::2"}], "[fe80::1]:2368", "[fe80::2]:2368"),
}


def two_sensors(kind: str) -> bytes:
    """Packets of two sensors by turns; the first sends fewer, and its positions, too."""
    frames = []
    for number, payload in enumerate(TURN):
        for index, where in enumerate(SENSORS[kind][0]):
            if kind == "ipv6":
                udp = ethernet(udp6_frame(payload, **where), kind=0x86DD)  # type: ignore[arg-type]
            else:
                udp = ethernet(udp_frame(payload, **where))  # type: ignore[arg-type]
            if index == 1 or number < 5:
                frames.append(udp)
    if kind == "address":
        frames.insert(1, ethernet(udp_frame(bytes(512), port=8308, sender=A)))
    return pcap(frames)


@pytest.mark.parametrize("kind", SENSORS)
def test_two_sensors_are_not_mixed(tmp_path: Path, kind: str) -> None:
    (tmp_path / "p#1.pcap").write_bytes(two_sensors(kind))
    place = f"{tmp_path}/p#1.pcap"
    _, first, second = SENSORS[kind]
    listed = re.escape(f"#0 ({first}), #1 ({second}); got none")
    source = capture.open(f"pcap:{place}")
    for _ in range(2):
        with pytest.raises(InputError, match=listed):
            source.read()
    assert capture.scan_address(f"{place}#1") == f"pcap:{place}#1"
    for number, name in enumerate((first, second)):
        for chosen in (str(number), name):
            source = capture.open(f"pcap:{place}#{chosen}")
            assert isinstance(source, capture.LidarSource)
            assert sum(frame.num_points for frame in source) == (5, len(TURN))[number] * 384
            assert source.counters["other_sender"] == (len(TURN), 5)[number]
    for wrong in ("2", f"{first}0", "-1", "x"):
        with pytest.raises(InputError, match=re.escape(f"#1 ({second}); got #{wrong}")):
            list(capture.open(f"pcap:{place}#{wrong}"))


def test_a_sensor_is_chosen_by_its_address(tmp_path: Path) -> None:
    (tmp_path / "p.pcap").write_bytes(two_sensors("address"))
    source = capture.open(f"pcap:{tmp_path}/p.pcap#{B}")
    assert sum(frame.num_points for frame in source) == len(TURN) * 384
    assert source.counters["position_packets"] == 1
    (tmp_path / "p.pcap").write_bytes(two_sensors("port"))
    with pytest.raises(InputError, match=r"got #127\.0\.0\.1"):
        list(capture.open(f"pcap:{tmp_path}/p.pcap#127.0.0.1"))
    assert list(capture.open(f"pcap:{tmp_path}/p.pcap#127.0.0.1", port=2369))


def test_all_sensors_are_listed(tmp_path: Path) -> None:
    late = [ethernet(udp_frame(PAYLOAD, sender=f"10.0.0.{i}")) for i in range(1, 13)]
    frames = [ethernet(udp_frame(p, sender=A)) for p in TURN] * 2
    (tmp_path / "p.pcap").write_bytes(pcap([*frames, *late]))
    source = capture.open(f"pcap:{tmp_path}/p.pcap")
    assert source.read() is not None  # the turn before the second sensor began to send
    told = rf"#0 \({A}:2368\), #1 \(10\.0\.0\.1:2368\), .*#7 \(10\.0\.0\.7:2368\), \.\.\.; got"
    with pytest.raises(InputError, match=told):
        list(source)


def test_commands_take_one_of_two_sensors(tmp_path: Path) -> None:
    place = tmp_path / "p.pcap"
    place.write_bytes(two_sensors("address"))
    refused = manip3d("info", place)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert f"#0 ({A}:2368), #1 ({B}:2368)" in refused.stderr
    for chosen in ("#1", f"#{B}", f"#{B}:2368"):
        told = manip3d("info", f"{place}{chosen}", "--json")
        assert told.returncode == 0
        assert f'"points": {len(TURN) * 384}' in told.stdout
    log = tmp_path / "log.jsonl"
    judged = manip3d("inspect", f"{place}#1", "--no-power", "--json", "--log", log)
    assert judged.returncode == 4, judged.stderr
    assert hashlib.sha256(place.read_bytes()).hexdigest() in log.read_text()


@pytest.mark.parametrize("kept", [-1, -300, -1240])
def test_what_was_read_before_the_damage_is_given(tmp_path: Path, kept: int) -> None:
    """A recorder that is killed leaves a cut record: the turn before it is read all the same."""
    packets = seen_turns(0, 360, turns=2)
    whole = pcap(ethernet(udp_frame(p)) for p in packets)
    place = tmp_path / "p.pcap"
    place.write_bytes(whole[:kept])
    source = capture.open(f"pcap:{place}")
    frames = []
    for _ in range(2):
        frame = source.read()
        assert frame is not None
        frames.append(frame)
    assert sum(frame.num_points for frame in frames) == (len(packets) - 1) * 384
    for _ in range(2):
        with pytest.raises(FormatError, match="file ends within"):
            source.read()
    told = manip3d("info", place)
    assert told.returncode == 1
    assert f"points {(len(packets) - 1) * 384:,}".replace(",", " ") in told.stdout
    assert "file ends within" in told.stderr
    assert '"error": ' in manip3d("info", place, "--json").stdout
    written = manip3d("convert", place, "-o", tmp_path / "drive")
    assert written.returncode == 1
    assert len((tmp_path / "drive" / "times.txt").read_text().splitlines()) == 2
    assert len(list((tmp_path / "drive" / "velodyne").iterdir())) == 2


def test_packets_of_other_scanners_are_called_so(tmp_path: Path) -> None:
    place = tmp_path / "p.pcap"
    place.write_bytes(pcap([ethernet(udp_frame(b"\xee\xff" + bytes(1078)))] * 9))  # as Hesai's
    told = manip3d("info", place)
    assert told.returncode == 1
    assert "packets of Velodyne's HDL-64E, HDL-32E, VLP-16" in told.stderr
    assert "bad length 9" in told.stderr
