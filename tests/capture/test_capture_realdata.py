"""Real packets: the manifest's counts, reference decodings, and another decoder."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import LidarFrame, capture
from manip3d.capture import RETURN_TYPES
from real_data import RealData


def decoded(path: Path, **options: Any) -> tuple[list[LidarFrame], dict[str, int]]:
    source = capture.open(f"pcap:{path}", **options)
    return list(source), source.counters


def column(frames: list[LidarFrame], name: str) -> np.ndarray:
    return np.concatenate(
        [f.fields[name] if name in f.fields else getattr(f, name) for f in frames]
    )


def read_reference(path: Path) -> np.ndarray:
    """A binary PCD as a structured array."""
    data = path.read_bytes()
    start = data.index(b"DATA binary\n") + len(b"DATA binary\n")
    header = {line.split()[0]: line.split()[1:] for line in data[:start].decode().splitlines()[1:]}
    kinds = {"F": "f", "U": "u", "I": "i"}
    fields = zip(header["FIELDS"], header["TYPE"], header["SIZE"], strict=True)
    return np.frombuffer(data[start:], [(name, kinds[k] + size) for name, k, size in fields])


@pytest.mark.parametrize(
    ("name", "model", "packets", "firings", "returns", "position_packets"),
    [
        ("sample_velodyne_hdl32.pcap", "hdl32e", 500, 192000, 146705, 0),
        ("sample_velodyne_vlp16_gps.pcap", "vlp16", 293, 112512, 73486, 57),
        ("velodyne_vlp16_84packets.pcap", "vlp16", 84, 32256, 31630, 0),
        ("reference/vlp16.pcap", "vlp16", 603, 231552, 116827, 0),
        ("reference/vlp32.pcap", "vlp32c", 379, 145536, 131305, 0),
    ],
)
def test_counts_of_the_manifest(
    realdata: RealData,
    name: str,
    model: str,
    packets: int,
    firings: int,
    returns: int,
    position_packets: int,
) -> None:
    frames, counters = decoded(realdata(f"lidar/packets/{name}"))
    assert {f.format.header["model"] for f in frames if f.format} == {model}
    assert counters["packets"] == packets
    assert counters["position_packets"] == position_packets
    assert counters["points"] + counters["duplicates"] == returns
    assert returns + counters["no_return"] == firings
    refused = ("bad_length", "unknown_product", "other_product", "unknown_return_mode", "bad_time",
               "bad_block_flag", "bad_azimuth", "backward_azimuth", "out_of_range", "file_other",
               "file_cut_short", "file_fragments", "overlong_frames", "lost_packets")  # fmt: skip
    assert {key: counters[key] for key in refused if counters[key]} == {}


@pytest.mark.parametrize(
    "name",
    ["sample_velodyne_hdl32.pcap", "sample_velodyne_vlp16_gps.pcap", "reference/vlp16.pcap"],
)
def test_packets_that_are_taken_out_are_counted(
    realdata: RealData, tmp_path: Path, name: str
) -> None:
    """One packet, five in a row and forty in a row, after the first turns."""
    data = realdata(f"lidar/packets/{name}").read_bytes()
    records, at = [], 24
    while at < len(data):
        size = 16 + struct.unpack_from("<I", data, at + 8)[0]
        records.append(data[at : at + size])
        at += size
    sent = [number for number, each in enumerate(records) if len(each) == 16 + 42 + 1206]
    first = len(sent) * 7 // 10
    for places in ([first], [first, *range(first + 9, first + 14)], range(first, first + 40)):
        lost = {sent[place] for place in places}
        left = (each for number, each in enumerate(records) if number not in lost)
        (tmp_path / "cut.pcap").write_bytes(data[:24] + b"".join(left))
        assert decoded(tmp_path / "cut.pcap")[1]["lost_packets"] == len(lost)


def test_reference_of_a_vlp32c(realdata: RealData) -> None:
    """All 26 216 ranges are exact; positions agree where the reference's azimuth is used.

    The reference turns the azimuth on by 2.304 us for each of the 32 lasers, and rounds to 0.01
    degrees. The manual has two lasers fire at once, hence 16 steps: azimuths differ by up to 0.13
    degrees. It leaves 114 points out, behind the end of its field of view.
    """
    path = realdata("lidar/packets/reference")
    reference = read_reference(path / "vlp32_scan_1713492677464078412.pcd")
    theirs = np.column_stack([reference[axis] for axis in "xyz"]).astype(np.float64)
    frames, _ = decoded(path / "vlp32.pcap", interpolate_azimuth=False)
    rows = np.r_[0:26089, 26203 : 26203 + 127]
    ranges = column(frames, "range")[rows].astype(np.float64)
    assert len(theirs) == len(rows)
    np.testing.assert_allclose(np.linalg.norm(theirs, axis=1), ranges, rtol=1e-6)
    assert np.all(np.round(ranges / 0.004) * 0.004 == pytest.approx(ranges, abs=1e-5))

    points = column(frames, "points")[rows].astype(np.float64)
    laser = column(frames, "laser")[rows]
    azimuth = column(frames, "azimuth")[rows].astype(np.float64)
    step = 2.304 / 55.296 * laser
    their_azimuth = np.degrees(np.arctan2(-theirs[:, 1], theirs[:, 0]))
    turn = (their_azimuth - azimuth + 180.0) % 360.0 - 180.0
    # A column turns by 0.2 degrees, give or take 0.02 as the rotor's speed varies.
    as_said = np.abs(turn - 0.2 * step) <= 0.005 + 0.0205 * step + 1e-4
    # Except for a packet's last block, and the one next to the gap: not turned on at all.
    assert np.mean(as_said) == pytest.approx(11 / 12, abs=0.01)
    assert np.all(np.abs(turn[~as_said]) < 1e-4)
    # Turned as the reference has them, points agree within 1 mm (here: 0.01 mm).
    flat = np.hypot(points[:, 0], points[:, 1])
    turned = np.radians(their_azimuth)
    again = np.column_stack([flat * np.cos(turned), -flat * np.sin(turned), points[:, 2]])
    assert np.abs(again - theirs).max() < 1e-5

    # With the manual's firing times we differ from the reference by no more than those azimuths.
    ours = column(decoded(path / "vlp32.pcap")[0], "points")[rows]
    assert np.all(np.linalg.norm(ours - theirs, axis=1) <= 0.15 / 57.3 * ranges + 1e-5)


def test_reference_of_a_vlp16_with_two_returns(realdata: RealData) -> None:
    """All 14 831 points with exact ranges and reflectivities, in the same order.

    Three things differ: the reference leaves out the manual's vertical corrections (up to 11.2
    mm); it rounds azimuths to 0.01 degrees (up to 1.3 mm at 14.6 m); and with two returns it does
    not turn on the last column of a packet and the second block of each.
    """
    path = realdata("lidar/packets/reference")
    reference = read_reference(path / "vlp16_scan_1673400472138016708.pcd")
    theirs = np.column_stack([reference[axis] for axis in "xyz"]).astype(np.float64)
    frames, _ = decoded(path / "vlp16.pcap")
    rows = np.arange(len(reference)) + 44503  # three revolutions before
    ranges = column(frames, "range")[rows].astype(np.float64)
    np.testing.assert_allclose(ranges, reference["distance"], rtol=1e-6)
    assert np.array_equal(column(frames, "intensity")[rows], reference["intensity"])
    laser = column(frames, "laser")[rows]
    assert np.array_equal(np.where(laser % 2, 8 + laser // 2, laser // 2), reference["channel"])
    # Elevation: that of the manual; the vertical correction is what z differs by.
    correction = np.array([11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2,
                           -9.7, 0.7, -11.2]) / 1000.0  # fmt: skip
    points = column(frames, "points")[rows].astype(np.float64)
    np.testing.assert_allclose(points[:, 2] - correction[laser], theirs[:, 2], atol=2e-5)

    azimuth = column(frames, "azimuth")[rows]
    turn = (np.degrees(reference["azimuth"]) - azimuth + 180.0) % 360.0 - 180.0
    kind = column(frames, "return_type")[rows]
    first_block = kind != RETURN_TYPES.index("strongest")
    rounded = np.abs(turn) <= 0.0051
    assert np.all(np.abs(turn) < 0.42)
    # Five of six columns of a packet, first blocks: nearly all points here.
    assert np.mean(rounded[first_block]) > 0.83
    same = points.copy()
    same[:, 2] -= correction[laser]
    error = np.linalg.norm(same - theirs, axis=1)[rounded]
    assert np.all(error <= ranges[rounded] * np.radians(0.0051) + 1e-5)
    assert np.mean(error < 1e-3) > 0.999
    # Turned as the reference has them, all agree.
    flat, turned = np.hypot(points[:, 0], points[:, 1]), reference["azimuth"].astype(np.float64)
    again = np.column_stack([flat * np.cos(turned), -flat * np.sin(turned), same[:, 2]])
    assert np.abs(again - theirs).max() < 2e-5


def test_hdl32e_against_velodyne_decoder(realdata: RealData) -> None:
    """Same points in the same order; two of its choices differ from the manual's.

    velodyne-decoder rounds azimuths to 0.01 degrees and turns at the packet's mean speed (together
    up to 0.02 degrees), and raises points by -28.95 mm times the tangent of the elevation, which
    the manual does not.
    """
    theirs = pytest.importorskip(
        "velodyne_decoder", reason="velodyne-decoder is not installed (peers)"
    )
    path = realdata("lidar/packets/sample_velodyne_hdl32.pcap")
    scans = theirs.read_pcap(str(path), theirs.Config(), as_pcl_structs=True)
    table = np.concatenate([points for _, points in scans])
    other = np.column_stack([table[axis] for axis in "xyz"]).astype(np.float64)
    frames, _ = decoded(path)
    points = column(frames, "points").astype(np.float64)
    ranges = column(frames, "range")
    assert len(points) == len(other) == 146705
    assert np.array_equal(column(frames, "intensity"), table["intensity"])
    assert np.array_equal(31 - column(frames, "ring"), table["ring"])
    flat, other_flat = (np.hypot(p[:, 0], p[:, 1]) for p in (points, other))
    np.testing.assert_allclose(flat, other_flat, atol=2e-5)
    lift = other[:, 2] - points[:, 2]
    np.testing.assert_allclose(lift, -0.02895 * points[:, 2] / flat, atol=1e-4)
    turn = np.degrees(np.arctan2(other[:, 1], other[:, 0]) - np.arctan2(points[:, 1], points[:, 0]))
    assert np.abs((turn + 180.0) % 360.0 - 180.0).max() < 0.021
    other[:, 2] -= lift
    distance = np.linalg.norm(points - other, axis=1)
    assert np.all(distance <= ranges * np.radians(0.021) + 2e-5)
    assert np.mean(distance < 1e-3) > 0.85


def test_order_of_packets_changes_no_point(realdata: RealData, tmp_path: Path) -> None:
    """Shuffled packets give the same points, whatever the frames."""
    data = realdata("lidar/packets/sample_velodyne_vlp16_gps.pcap").read_bytes()
    records, at = [], 24
    while at < len(data):
        size = 16 + struct.unpack_from("<I", data, at + 8)[0]
        records.append(data[at : at + size])
        at += size
    order = np.random.default_rng(0).permutation(len(records))
    path = tmp_path / "shuffled.pcap"
    path.write_bytes(data[:24] + b"".join(records[i] for i in order))
    results = []
    for source in (realdata("lidar/packets/sample_velodyne_vlp16_gps.pcap"), path):
        frames, counters = decoded(source, interpolate_azimuth=False)
        points = column(frames, "points")
        results.append((points[np.lexsort(points.T)], counters["points"]))
    assert results[0][1] == results[1][1] == 73486
    assert np.array_equal(results[0][0], results[1][0])
