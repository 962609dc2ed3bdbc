"""Velodyne packets: positions, frames, returns, and exact counts of what is refused."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from manip3d import FormatError, InputError, LidarFrame, capture
from manip3d.capture import RETURN_TYPES
from velodyne_packets import (
    DUAL,
    LAST,
    LOWER,
    PRODUCT,
    STRONGEST,
    Block,
    block,
    ethernet,
    hdl64e_calibration,
    packet,
    pcap,
    ray_points,
    seen_turns,
    udp_frame,
    vls128_packets,
)

PER_COLUMN = {
    "hdl32e": 46.080e-6,
    "vlp16": 110.592e-6,
    "vlp16-hires": 110.592e-6,
    "vlp32c": 55.296e-6,
}


def decode(
    tmp_path: Path, payloads: Sequence[bytes], **options: Any
) -> tuple[list[LidarFrame], dict[str, int]]:
    path = tmp_path / "p.pcap"
    path.write_bytes(pcap(ethernet(udp_frame(data)) for data in payloads))
    source = capture.open(f"pcap:{path}", **options)
    return list(source), source.counters


def turning(model: str, azimuths: Sequence[int], raw: int = 1000, mode: int = STRONGEST) -> bytes:
    blocks = [block(a, [raw] * 32) for a in azimuths]
    return packet(blocks, mode=mode, product=PRODUCT[model])


def firings(counters: dict[str, int]) -> int:
    return sum(counters[k] for k in ("points", "no_return", "duplicates", "out_of_range"))


@pytest.mark.parametrize(
    ("model", "unit", "firing", "elevation", "offset", "delay"),
    [
        ("hdl32e", 0.002, 0, -30.67, 0.0, 0.0),
        ("hdl32e", 0.002, 31, 10.67, 0.0, 31 * 1.152e-6),
        ("vlp32c", 0.004, 3, -15.639, -1.4, 2.304e-6),
        ("vlp32c", 0.004, 14, 0.667, 4.2, 7 * 2.304e-6),
        ("vlp16", 0.002, 1, 1.0, 0.0, 2.304e-6),
        ("vlp16", 0.002, 30, -1.0, 0.0, 55.296e-6 + 14 * 2.304e-6),
        ("vlp16-hires", 0.002, 1, 0.67, 0.0, 2.304e-6),
        ("vlp16-hires", 0.002, 30, -0.67, 0.0, 55.296e-6 + 14 * 2.304e-6),
    ],
)
def test_one_return(
    tmp_path: Path, model: str, unit: float, firing: int, elevation: float, offset: float,
    delay: float,
) -> None:  # fmt: skip
    ranges = [0] * 32
    ranges[firing] = 2500
    blocks = [block(9000 + 20 * b, ranges if b == 4 else [0] * 32) for b in range(12)]
    (frame,), counters = decode(tmp_path, [packet(blocks, product=PRODUCT[model])])
    azimuth = 90.8 + 0.2 * delay / PER_COLUMN[model] + offset
    r = 2500 * unit
    flat = r * np.cos(np.radians(elevation))
    z = r * np.sin(np.radians(elevation))
    heights = {"vlp16": {1: -0.0007, 30: 0.0007}, "vlp16-hires": {1: -0.0009, 30: 0.0009}}
    z += heights.get(model, {}).get(firing, 0.0)  # the manual's tables
    expected = [flat * np.cos(np.radians(azimuth)), -flat * np.sin(np.radians(azimuth)), z]
    np.testing.assert_allclose(frame.points, [expected], atol=1e-6)
    assert frame.fields["azimuth"][0] == pytest.approx(azimuth, abs=1e-4)
    assert frame.fields["range"][0] == pytest.approx(r, abs=1e-6)
    assert frame.fields["time"][0] == pytest.approx(4 * PER_COLUMN[model] + delay, abs=1e-9)
    assert frame.fields["laser"][0] == firing % (16 if model.startswith("vlp16") else 32)
    assert frame.intensity is not None
    assert frame.intensity[0] == 7 + firing
    assert frame.format is not None
    assert frame.format.header["model"] == model
    assert frame.time_ns == 1000 * 10**9
    assert firings(counters) == 12 * 32
    assert (counters["packets"], counters["points"]) == (1, 1)


def test_rings_count_from_the_highest_laser_down(tmp_path: Path) -> None:
    (frame,), _ = decode(tmp_path, [turning("hdl32e", range(0, 240, 20))])
    assert frame.ring is not None
    order = np.argsort(frame.ring[:32])
    assert np.all(np.diff(frame.points[order, 2]) < 0)
    assert sorted(frame.ring[:32].tolist()) == list(range(32))


def test_frames_end_where_the_azimuth_passes_the_cut(tmp_path: Path) -> None:
    turns = [
        turning("hdl32e", [a + 100 * b for b in range(12)]) for a in range(30000, 110000, 1200)
    ]
    frames, counters = decode(tmp_path, turns)
    assert [f.format.header["is_complete"] for f in frames] == [False, True, True, False]  # type: ignore[union-attr]
    assert sum(f.num_points for f in frames) == counters["points"] == len(turns) * 384
    for frame in frames:
        assert np.all(np.diff(frame.fields["azimuth"][::32]) > 0)
    assert [f.fields["azimuth"].min() for f in frames[1:]] == [0.0, 0.0, 0.0]
    halves, _ = decode(tmp_path, turns, cut_azimuth=180.0)
    assert [f.fields["azimuth"][0] for f in halves[1:]] == [180.0, 180.0]
    assert counters["frames"] == len(frames)


def complete(frames: Sequence[LidarFrame]) -> list[bool]:
    return [f.format.header["is_complete"] for f in frames if f.format is not None]


@pytest.mark.parametrize(("hertz", "has_times"), [(5, False), (20, True)])
@pytest.mark.parametrize("cut", [0.0, 180.0, 300.0])
@pytest.mark.parametrize("field", [(100, 260), (270, 90), (170, 200), (0, 360)])
def test_a_limited_field_of_view_gives_a_frame_for_each_turn(
    tmp_path: Path, field: tuple[int, int], cut: float, hertz: int, has_times: bool
) -> None:
    """Wherever the cut is: within the field of view or beside it."""
    packets = seen_turns(*field, hertz=hertz, has_times=has_times)
    frames, counters = decode(tmp_path, packets, cut_azimuth=cut)
    assert counters["backward_azimuth"] == counters["lost_packets"] == 0
    assert counters["points"] == len(packets) * 384
    # A cut within the seen part divides the first turn and the last; a packet may hold the end of
    # one turn and the begin of the next.
    assert len(frames) in (6, 7)
    assert complete(frames)[1:-1] == [True] * (len(frames) - 2)
    for frame in frames:
        from_cut = (frame.fields["azimuth"][::32].astype(float) - cut) % 360
        assert np.all(np.diff(from_cut) > 0)


def test_a_field_of_view_of_few_degrees_needs_the_times_of_packets(tmp_path: Path) -> None:
    frames, counters = decode(tmp_path, seen_turns(100, 108, turns=8), cut_azimuth=0.0)
    assert len(frames) in (8, 9)
    assert max(f.num_points for f in frames) <= 1.6 * counters["points"] / 8


@pytest.mark.parametrize("hertz", [5, 10, 20])
def test_swapped_packets_make_no_turn(tmp_path: Path, hertz: int) -> None:
    """Two packets arrive in the wrong order, anywhere around the cut."""
    packets = seen_turns(0, 360, hertz=hertz)
    whole, _ = decode(tmp_path, packets)
    first = np.cumsum([f.format.header["packets"] for f in whole])[1]  # type: ignore[union-attr]
    for late in range(first - 3, first + 3):
        swapped = [*packets[:late], packets[late + 1], packets[late], *packets[late + 2 :]]
        frames, counters = decode(tmp_path, swapped)
        assert counters["backward_azimuth"] == 12
        assert counters["lost_packets"] == 0
        assert complete(frames) == complete(whole)
        assert abs(frames[2].num_points - whole[2].num_points) <= 12 * 32


def test_a_turn_with_a_large_gap_is_not_complete(tmp_path: Path) -> None:
    packets = seen_turns(0, 360)
    per_turn = len(packets) // 6
    lost = slice(3 * per_turn + 5, 3 * per_turn + 5 + 2 * per_turn // 3)
    frames, _ = decode(tmp_path, [*packets[: lost.start], *packets[lost.stop :]])
    assert complete(frames) == [False, True, True, False, True, False]


@pytest.mark.parametrize("mode", [STRONGEST, DUAL])
@pytest.mark.parametrize("hertz", [5, 20])
@pytest.mark.parametrize("field", [(100, 260), (270, 90), (0, 360)])
def test_lost_packets_are_counted(
    tmp_path: Path, field: tuple[int, int], hertz: int, mode: int
) -> None:
    """One packet and five in a row are lost within the field of view, in the fourth turn."""
    packets = seen_turns(*field, hertz=hertz, has_dual=mode == DUAL)
    whole, counters = decode(tmp_path, packets)
    assert counters["lost_packets"] == 0
    per_turn = len(packets) // 6
    low, high = field
    middle = 3 * per_turn + (per_turn // 2 if low < high else 0)  # of the field of view
    few = per_turn // 6
    lost = {middle - few, *range(middle + few, middle + few + min(5, few))}
    left = [each for number, each in enumerate(packets) if number not in lost]
    frames, counters = decode(tmp_path, left)
    assert counters["lost_packets"] == len(lost) > 1
    assert counters["packets"] == len(left)
    assert len(frames) == len(whole)


def test_pauses_and_wrong_times_are_no_lost_packets(tmp_path: Path) -> None:
    packets = seen_turns(0, 360, turns=16)
    paused = [*packets[:300], *packets[-100:]]  # 1.1 s later
    assert decode(tmp_path, paused)[1]["lost_packets"] == 0
    wrong = packets[:300]
    wrong[200] = with_bytes(wrong[200], 1200, b"\xff\xff\xff\xff")
    counters = decode(tmp_path, wrong)[1]
    assert (counters["bad_time"], counters["lost_packets"]) == (1, 0)


def moved(packets: Sequence[bytes], seconds: float) -> list[bytes]:
    """Return the packets with other times, which begin again each hour."""
    times = [int.from_bytes(p[1200:1204], "little") + round(1e6 * seconds) for p in packets]
    return [
        with_bytes(p, 1200, (t % 3_600_000_000).to_bytes(4, "little"))
        for p, t in zip(packets, times, strict=True)
    ]


def largest_time(frames: Sequence[LidarFrame]) -> float:
    return max(float(np.abs(frame.fields["time"]).max()) for frame in frames)


@pytest.mark.parametrize("seconds", [30.0, 1500.0, 2500.0, -1200.0])
def test_a_pause_or_a_set_clock_ends_the_turn(tmp_path: Path, seconds: float) -> None:
    packets = seen_turns(0, 360)
    per_turn = len(packets) // 6
    middle = 2 * per_turn + per_turn // 2
    stepped = [*packets[:middle], *moved(packets[middle:], seconds)]
    frames, counters = decode(tmp_path, moved(stepped, 1300.0))
    assert complete(frames) == [False, True, False, False, True, True, False]
    assert largest_time(frames) < 0.11
    assert frames[2].num_points + frames[3].num_points == frames[1].num_points
    assert counters["points"] == len(packets) * 384
    assert counters["lost_packets"] == counters["backward_azimuth"] == 0


def test_an_hour_that_begins_is_no_step_of_the_clock(tmp_path: Path) -> None:
    packets = seen_turns(0, 360)
    whole, _ = decode(tmp_path, packets)
    frames, counters = decode(tmp_path, moved(packets, -0.15))
    assert complete(frames) == complete(whole)
    assert largest_time(frames) < 0.11
    assert counters["lost_packets"] == 0


def test_a_late_packet_of_the_last_hour_has_a_time_before_the_frame(tmp_path: Path) -> None:
    """Two packets around the hour are swapped, and a frame begins with the one after it."""
    packets = seen_turns(0, 360)
    first = len(packets) // 6 * 2
    start = int.from_bytes(packets[first][1200:1204], "little")
    packets = moved(packets, -1e-6 * start)
    azimuth = int.from_bytes(packets[first][2:4], "little") / 100
    packets[first - 1 : first + 1] = packets[first], packets[first - 1]
    frames, _ = decode(tmp_path, packets, cut_azimuth=azimuth)
    assert min(float(f.fields["time"].min()) for f in frames) == pytest.approx(-0.00133, abs=1e-4)
    assert largest_time(frames) < 0.11


@pytest.mark.parametrize("bad", [range(1), range(200, 201), range(200, 204)])
def test_an_impossible_time_is_replaced_by_the_one_that_was_due(tmp_path: Path, bad: range) -> None:
    packets = seen_turns(0, 360)
    whole, _ = decode(tmp_path, packets)
    for number in bad:
        packets[number] = with_bytes(packets[number], 1200, b"\xff\xff\xff\xff")
    frames, counters = decode(tmp_path, packets)
    assert (counters["bad_time"], counters["lost_packets"]) == (len(bad), 0)
    assert largest_time(frames) < 0.11
    if bad.start:
        assert complete(frames) == complete(whole)
        for frame, expected in zip(frames, whole, strict=True):
            np.testing.assert_allclose(
                frame.fields["time"], expected.fields["time"], rtol=0, atol=1e-5
            )


def test_a_clock_that_is_set_back_a_little_finds_no_lost_packets(tmp_path: Path) -> None:
    packets = seen_turns(0, 360, turns=16)
    lost = [*packets[:1100], *packets[1104:1150], *moved(packets[1150:], -0.02)]
    assert decode(tmp_path, lost)[1]["lost_packets"] == 4


@pytest.mark.parametrize("has_clock", [True, False])
def test_an_hdl64e_without_a_clock_gives_whole_turns(tmp_path: Path, has_clock: bool) -> None:
    """Its old firmware sends its status where later ones send the time."""
    azimuths = np.arange(0, 4 * 36000, 18) % 36000
    packets = hdl64e_packets(np.full((len(azimuths), 64), 1000), azimuths[: len(azimuths) // 6 * 6])
    rng = np.random.default_rng(0)
    times = 288 * np.arange(len(packets)) + 30_000_000 * (np.arange(len(packets)) >= 500)
    if not has_clock:
        times = rng.integers(0, 3_600_000_000, len(packets))
    timed = [
        with_bytes(p, 1200, int(t).to_bytes(4, "little"))
        for p, t in zip(packets, times, strict=True)
    ]
    frames, _ = decode(tmp_path, timed, calibration=hdl64e_calibration(two_points=False))
    paused = [False, False, False, True, False]
    assert complete(frames) == (paused if has_clock else [False, True, True, False])


def test_packets_that_were_captured_twice_give_their_points_once(tmp_path: Path) -> None:
    packets = seen_turns(0, 360, turns=3)
    once, counters = decode(tmp_path, packets)
    assert counters["repeated_packets"] == 0
    twice, counters = decode(tmp_path, [each for each in packets for _ in range(2)])
    assert [f.num_points for f in twice] == [f.num_points for f in once]
    assert counters["repeated_packets"] == counters["packets"] == len(packets)
    assert counters["lost_packets"] == counters["backward_azimuth"] == 0


def test_a_stray_packet_is_no_vls128(tmp_path: Path) -> None:
    """Another device's payload of the same length may end in the byte of that product."""
    frames, _ = decode(tmp_path, [bytes(1205) + b"\xa1", GOOD])
    assert len(frames) == 1


@pytest.mark.parametrize(
    ("end", "refused"), [(b"\x37\x28", "bad_block_flag"), (b"\x37\x99", "unknown_product")]
)
def test_a_stray_packet_does_not_determine_the_model(
    tmp_path: Path, end: bytes, refused: str
) -> None:
    packets = seen_turns(0, 360, turns=2)
    expected, _ = decode(tmp_path, packets)
    frames, counters = decode(tmp_path, [bytes(1204) + end, *packets])
    assert [f.num_points for f in frames] == [f.num_points for f in expected]
    assert (counters["packets"], counters["other_product"]) == (len(packets), 0)
    assert counters[refused] == (12 if refused == "bad_block_flag" else 1)


def test_a_damaged_flag_does_not_determine_the_model(tmp_path: Path) -> None:
    first = with_bytes(FIRST, 200, b"\xff\xdd")
    (frame,), counters = decode(tmp_path, [first, GOOD])
    assert frame.num_points == 23 * 32
    assert counters["bad_block_flag"] == 1
    columns = np.arange(12)
    sent = hdl64e_packets(np.full((12, 64), 1000), 18 * columns)
    status = with_bytes(with_bytes(sent[0], 100, b"\0\0"), 1205, b"\x22")
    (frame,), counters = decode(
        tmp_path, [status, sent[1]], calibration=hdl64e_calibration(two_points=False)
    )
    assert frame.num_points == 23 * 32
    assert frame.format is not None
    assert frame.format.header["model"] == "hdl64e"


def test_packets_of_another_product_are_not_decoded_as_an_hdl64e(tmp_path: Path) -> None:
    options = {"calibration": hdl64e_calibration(two_points=False)}
    frames, counters = decode(tmp_path, [FIRST, GOOD], model="hdl64e", **options)
    assert frames == []
    assert counters["other_product"] == 2
    sent = hdl64e_packets(np.full((12, 64), 1000), 18 * np.arange(12))
    (frame,), counters = decode(tmp_path, [sent[0], GOOD, sent[1]], **options)
    assert frame.num_points == 24 * 32
    assert counters["other_product"] == 1


def test_a_vls128_is_named(tmp_path: Path) -> None:
    for options in ({}, {"calibration": hdl64e_calibration(two_points=False)}, {"model": "vlp16"}):
        with pytest.raises(FormatError, match=r"p\.pcap: packets of a Velodyne VLS-128"):
            decode(tmp_path, vls128_packets(3), **options)
    frames, counters = decode(tmp_path, [FIRST, *vls128_packets(3), GOOD])
    assert [f.num_points for f in frames] == [768]
    assert (counters["other_product"], counters["points"]) == (3, 768)


def test_dual_returns(tmp_path: Path) -> None:
    last = [1000, 2000, 0, 500] + [0] * 28
    strongest = [1000, 1500, 700, 0] + [0] * 28
    blocks: list[Block] = []
    for column in range(6):
        blocks += [block(100 * column, last), block(100 * column, strongest)]
    (frame,), counters = decode(tmp_path, [packet(blocks, mode=DUAL)])
    kinds = [RETURN_TYPES[k] for k in frame.fields["return_type"]]
    ranges = np.round(frame.fields["range"] * 500).astype(int).tolist()
    assert list(zip(kinds, ranges, strict=True))[:5] == [
        ("both", 1000), ("last", 2000), ("last", 500), ("strongest", 1500), ("strongest", 700),
    ]  # fmt: skip
    assert counters["points"] == 6 * 5
    assert counters["duplicates"] == 6
    # Both blocks of a column were fired at once.
    assert np.ptp(frame.fields["time"][[1, 3]]) == 0.0


@pytest.mark.parametrize(("mode", "kind"), [(STRONGEST, "strongest"), (LAST, "last")])
def test_single_returns_are_named(tmp_path: Path, mode: int, kind: str) -> None:
    (frame,), _ = decode(tmp_path, [turning("vlp16", range(0, 480, 40), mode=mode)])
    assert {RETURN_TYPES[k] for k in frame.fields["return_type"]} == {kind}


def hdl64e_packets(raw: np.ndarray, azimuths: np.ndarray) -> list[bytes]:
    """Packets of upper and lower blocks by turns; ``raw`` is (columns, 64)."""
    packets = []
    for start in range(0, len(azimuths), 6):
        blocks: list[Block] = []
        for ranges, azimuth in zip(
            raw[start : start + 6], azimuths[start : start + 6], strict=True
        ):
            blocks.append(block(int(azimuth), ranges[:32]))
            blocks.append(block(int(azimuth), ranges[32:], flag=LOWER))
        packets.append(packet(blocks, mode=0x48, product=0x31))  # status bytes, not modes
    return packets


@pytest.mark.parametrize("two_points", [False, True])
def test_hdl64e_round_trip(tmp_path: Path, two_points: bool) -> None:
    rng = np.random.default_rng(1)
    calibration = hdl64e_calibration(two_points=two_points)
    azimuths = np.arange(0, 36000, 18)[:1998]
    raw = rng.integers(500, 40000, (len(azimuths), 64))
    raw[rng.random(raw.shape) < 0.1] = 0
    (frame,), counters = decode(tmp_path, hdl64e_packets(raw, azimuths), calibration=calibration)
    column, laser = np.nonzero(raw)
    # Packets hold the upper 32 lasers, then the lower, of one column after the other.
    expected = ray_points(calibration, laser, azimuths[column] / 100, raw[column, laser])
    assert frame.num_points == len(expected)
    np.testing.assert_allclose(frame.points, expected, atol=2e-5)
    assert frame.fields["laser"].tolist() == laser.tolist()
    assert counters["no_return"] == np.count_nonzero(raw == 0)
    assert {RETURN_TYPES[k] for k in frame.fields["return_type"]} == {"unknown"}


def test_hdl64e_dual_returns_are_known_by_their_azimuths(tmp_path: Path) -> None:
    blocks: list[Block] = []
    for column in range(3):
        for raw in (3000, 4000):
            blocks.append(block(18 * column, [raw] * 32))
            blocks.append(block(18 * column, [raw + 1] * 32, flag=LOWER))
    (frame,), counters = decode(
        tmp_path, [packet(blocks)], calibration=hdl64e_calibration(two_points=False)
    )
    strongest = frame.fields["return_type"] == RETURN_TYPES.index("strongest")
    assert np.unique(np.round(frame.fields["range"][strongest] * 500)).tolist() == [3000, 3001]
    assert counters["points"] == 12 * 32


def test_hdl64e_needs_its_calibration(tmp_path: Path) -> None:
    data = hdl64e_packets(np.full((6, 64), 1000), np.arange(6) * 18)
    with pytest.raises(InputError, match="HDL-64E needs the file of its own sensor"):
        decode(tmp_path, data)
    with pytest.raises(InputError, match="expected 16 lasers for vlp16, got 64"):
        decode(tmp_path, data, model="vlp16", calibration=hdl64e_calibration(two_points=False))


def with_bytes(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


FIRST = turning("vlp16", range(0, 480, 40))
GOOD = turning("vlp16", range(480, 960, 40))


@pytest.mark.parametrize(
    ("data", "counter", "refused", "points"),
    [
        (GOOD[:-1], "bad_length", 1, 0),
        (GOOD + b"\0", "bad_length", 1, 0),
        (b"", "bad_length", 1, 0),
        (bytes(512), "position_packets", 1, 0),
        (with_bytes(GOOD, 1205, b"\x99"), "unknown_product", 1, 0),
        (with_bytes(GOOD, 1205, b"\x21"), "other_product", 1, 0),
        (with_bytes(GOOD, 1204, b"\x00"), "unknown_return_mode", 1, 0),
        (with_bytes(GOOD, 300, b"\xaa\xbb"), "bad_block_flag", 1, 11 * 32),
        (with_bytes(GOOD, 302, b"\xa0\x8c"), "bad_azimuth", 1, 11 * 32),  # 36000
        (with_bytes(GOOD, 302, b"\xff\xff"), "bad_azimuth", 1, 11 * 32),
        (with_bytes(GOOD, 302, b"\x0a\x00"), "backward_azimuth", 1, 12 * 32),
        (with_bytes(GOOD, 1200, b"\xff\xff\xff\xff"), "bad_time", 1, 12 * 32),
        (with_bytes(GOOD, 4, b"\0\0"), "no_return", 1, 12 * 32 - 1),
        (with_bytes(GOOD, 4, b"\xff\xff"), "out_of_range", 1, 12 * 32 - 1),
    ],
)
def test_what_is_refused_is_counted(
    tmp_path: Path, data: bytes, counter: str, refused: int, points: int
) -> None:
    frames, counters = decode(tmp_path, [FIRST, data], max_range=100.0)
    assert counters[counter] == refused
    assert counters["points"] == 384 + points == sum(f.num_points for f in frames)
    odd = {k for k, v in counters.items() if v} - {"packets", "points", "frames", counter}
    assert odd <= {"file_packets", "file_udp"}
    blocks = 24 if points else 12
    lost = counters["bad_block_flag"] + counters["bad_azimuth"]
    assert firings(counters) == 32 * (blocks - lost)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=100)
@given(data=st.data())
def test_damaged_packets_give_no_point_that_is_not_in_them(tmp_path: Path, data: Any) -> None:
    """Any bytes, any order: each point is a firing of a packet with both of its marks."""
    model = data.draw(st.sampled_from(sorted(PRODUCT)))
    good = [turning(model, [a + 20 * b for b in range(12)], raw=1 + a) for a in range(0, 4800, 240)]
    payloads = []
    for index in data.draw(st.lists(st.integers(0, len(good) - 1), max_size=8)):
        raw = bytearray(good[index])
        for _ in range(data.draw(st.integers(0, 6))):
            raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
        payloads.append(bytes(raw[: data.draw(st.sampled_from([1206, 1206, 1206, 1205, 600]))]))
    frames, counters = decode(tmp_path, payloads, model=model)
    unit = 0.004 if model == "vlp32c" else 0.002
    sent = {
        (int.from_bytes(p[at : at + 2], "little"), p[at + 2])
        for p in payloads
        if len(p) == 1206
        for b in range(12)
        for at in range(b * 100 + 4, b * 100 + 100, 3)
    }
    for frame in frames:
        assert frame.intensity is not None
        raw_range = np.round(frame.fields["range"] / unit).astype(int).tolist()
        assert set(zip(raw_range, frame.intensity.astype(int).tolist(), strict=True)) <= sent
        assert 0 not in raw_range
        assert frame.fields["azimuth"].min(initial=0) >= 0
        assert frame.fields["azimuth"].max(initial=0) < 360
    assert counters["points"] == sum(f.num_points for f in frames)
    good_blocks = counters["packets"] * 12 - counters["bad_block_flag"] - counters["bad_azimuth"]
    whole = counters["bad_block_flag"] + counters["bad_azimuth"] < 12
    assert not whole or firings(counters) == 32 * good_blocks


def test_azimuth_is_not_turned_on_across_gaps(tmp_path: Path) -> None:
    """Sensors with a limited field of view jump: the last sane turn is used."""
    azimuths = [8940 + 20 * b if b < 6 else 27000 + 20 * b for b in range(12)]
    (frame,), _ = decode(tmp_path, [turning("vlp32c", azimuths)])
    before_gap = frame.fields["azimuth"][5 * 32 : 6 * 32]
    assert before_gap.max() < 90.4 + 4.2 + 0.2
    plain, _ = decode(tmp_path, [turning("vlp32c", azimuths)], interpolate_azimuth=False)
    assert np.ptp(plain[0].fields["azimuth"][0:32:2]) == pytest.approx(4.2 - 1.4, abs=2e-5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"model": "vls128"},
            "model: expected hdl64e, hdl32e, vlp16, vlp16-hires or vlp32c, got 'vls128'",
        ),
        ({"cut_azimuth": 360.0}, "cut_azimuth: expected degrees in [0, 360)"),
        ({"cut_azimuth": np.nan}, "cut_azimuth: expected degrees in [0, 360)"),
        ({"min_range": 5.0, "max_range": 5.0}, "expected 0 <= min_range < max_range"),
        ({"max_bytes": -1}, "max_bytes: expected > 0"),
    ],
)
def test_options_are_checked(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=re.escape(message)):
        decode(tmp_path, [GOOD], **options)


@pytest.mark.parametrize("uri", ["sim:x", "pcap", "velodyne:x", "velodyne:70000", "", "C:\\x"])
def test_unknown_addresses(uri: str) -> None:
    with pytest.raises(InputError, match="uri: expected"):
        capture.open(uri)
