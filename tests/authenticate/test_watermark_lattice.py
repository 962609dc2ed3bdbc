"""Watermarks on stated grids: coordinates in float64 (UTM, LAS), other steps than 1 mm."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import watermark_oracle as oracle
from numpy.typing import NDArray

import manip3d
from manip3d import LidarFrame, _core
from manip3d.authenticate import KeyFile, Policy, Watermarker, write_watermarked
from manip3d.errors import InputError
from manip3d.io import read_scan, write_scan
from manip3d.lidar import ScanFormat
from watermark_scans import ROOT_KEY, grid_scan, key_file, reflectances

UTM = np.array([456_789.0, 5_428_123.0, 112.0])
ANY = Policy(order="any")
Exact = NDArray[np.float64]


def survey(units: int = 1000, count: int = 4000, *, at: Exact = UTM) -> LidarFrame:
    """A street in coordinates of a national grid, in whole steps of 1/units m."""
    steps = np.round(grid_scan(count).astype(np.float64) * 1000.0) + np.round(at * units)
    return framed(steps / units, at, reflectances(len(steps), 0))


def framed(exact: Exact, at: Exact, intensity: NDArray[np.float32] | None) -> LidarFrame:
    to_file = np.eye(4)
    to_file[:3, 3] = at
    layout = ScanFormat("las", to_file=to_file)
    points = (exact @ np.eye(3) + -at).astype(np.float32)
    return LidarFrame(points, intensity, exact=exact, format=layout)


@pytest.mark.parametrize("units", [1, 100, 1000, 4096, 10_000])
def test_coordinates_in_float64_carry_bits_on_their_own_grid(key: KeyFile, units: int) -> None:
    scan = survey(units)
    assert scan.exact is not None
    with Watermarker(key, units_per_m=units) as sender, Watermarker(key) as receiver:
        sent = sender.embed(scan)
        assert not sent.is_detached
        assert sent.frame.exact is not None
        moved = np.abs(sent.frame.exact - scan.exact)
        assert moved.max() == pytest.approx(1.0 / units, rel=1e-3)  # one step along each axis
        assert np.array_equal(np.round(sent.frame.exact * units) / units, sent.frame.exact)
        assert np.abs(sent.frame.points - scan.points).max() <= 1.01 / units + 1e-5
        shuffled = sent.frame.select(np.random.default_rng(0).permutation(scan.num_points))
        found = receiver.verify(shuffled, sent.record)
        assert (found.verdict, found.embedding) == ("authentic", "lbm")
        for allowed, verdict in ((units, "authentic"), (units + 1, "undecidable")):
            policy = Policy(order="any", units_per_m=(allowed,))
            with Watermarker(key) as other:
                assert other.verify(sent.frame, sent.record, policy=policy).verdict == verdict


def test_the_farthest_coordinates_verify(key: KeyFile) -> None:
    """A bit of 0 moves a negative odd coordinate by one step away from the origin."""
    exact = np.round(grid_scan(300).astype(np.float64) * 1000.0)
    exact[0] = -(2.0**30) + 1.0
    exact[1] = 2.0**30 - 1.0
    scan = framed(exact / 1000.0, np.zeros(3), None)
    for _ in range(4):  # sessions with other bits
        with Watermarker(key, origin=np.zeros(3)) as sender, Watermarker(key) as receiver:
            sent = sender.embed(scan)
            assert receiver.verify(sent.frame, sent.record).verdict == "authentic"


def test_the_advice_fits_the_point_that_is_refused(key: KeyFile) -> None:
    """Rounding helps a point beside the grid, and none beyond reach."""
    for metres, may_round in ((1e7, False), (0.0003, True)):
        exact = np.full((30, 3), metres)
        plain = LidarFrame(exact.astype(np.float32))
        for scan in (plain, framed(exact, np.zeros(3), None)):
            with (
                Watermarker(key, origin=np.zeros(3)) as sender,
                pytest.raises(InputError) as caught,
            ):
                sender.embed(scan)
            assert ("round the points" in str(caught.value)) == may_round


def test_an_empty_frame_of_a_drive_with_an_origin_is_signed(key: KeyFile) -> None:
    empty = framed(np.zeros((0, 3)), UTM, None)
    with Watermarker(key, origin=UTM) as sender, Watermarker(key) as receiver:
        for scan in (survey(), empty, survey()):
            sent = sender.embed(scan)
            assert receiver.verify(sent.frame, sent.record).verdict == "authentic"


def test_the_record_states_step_and_origin(key: KeyFile) -> None:
    origin = UTM + np.array([10.0, -20.0, 3.0])
    with Watermarker(key, units_per_m=100, origin=origin) as sender:
        record = sender.embed(survey(100)).record
    # header: magic 8, suite, embedding, carrier, flags, sensor 16, session 16, frame, time
    assert struct.unpack_from("<I3qIH", record, 60) == (
        100, *np.round(origin * 100).astype(int).tolist(), 0, 3,
    )  # fmt: skip


def test_an_independent_implementation_writes_the_same(tmp_path: Path) -> None:
    """Records and points byte for byte, of float64 with an origin and of float32."""
    for units, is_exact in ((100, True), (4096, True), (512, False)):
        scan = survey(units, 1500)
        steps = np.round(grid_scan(1500).astype(np.float64) * 1000.0)
        plain = (steps / units).astype(np.float32)
        given = scan.points if is_exact else plain
        offset = tuple(np.round(UTM * units).astype(int).tolist()) if is_exact else (0, 0, 0)
        assert scan.intensity is not None
        core_key = _core.WatermarkKey(os.fsencode(key_file(tmp_path / f"key-{units}", ROOT_KEY)))
        embedder = _core.WatermarkEmbedder(
            core_key, bytes(16), bytes(range(16)), 1, 36, 300, False, False, units
        )
        points, record, _, _, exact, _ = embedder.embed(
            given, scan.intensity, 7, 0, True, None, scan.exact if is_exact else None, offset
        )
        other = oracle.Embedder(
            ROOT_KEY, bytes(16), bytes(range(16)), oracle.LBM, 36, 300,
            units=units, offset=offset, is_exact=is_exact,
        )  # fmt: skip
        source = scan.exact if is_exact else plain
        assert source is not None
        rows = [(x, y, z) for x, y, z in source.tolist()]
        expected = other.embed(rows, scan.intensity.tolist(), 7, True)
        assert record == expected.record
        assert np.array_equal(exact if is_exact else points, np.array(expected.points))


def edits(scan: LidarFrame) -> Iterator[LidarFrame]:
    assert scan.exact is not None
    for row, axis, by in ((0, 0, 0.001), (7, 2, -0.002), (11, 1, 1.0), (13, 0, 1e-6), (0, 2, 1e5)):
        exact = scan.exact.copy()
        exact[row, axis] += by
        yield framed(exact, UTM, scan.intensity)
    assert scan.intensity is not None
    shine = scan.intensity.copy()
    shine[3] += 0.01
    yield scan.replace(intensity=shine)
    yield scan.select(np.arange(1, scan.num_points))
    yield scan.select(np.r_[0, np.arange(scan.num_points)])
    yield scan.replace(intensity=None)
    points = scan.points.copy()
    points[5, 0] += 1.0  # the points say something else than the exact coordinates
    yield scan.replace(points=points)
    yield framed(scan.exact + np.array([1.0, 0.0, 0.0]), UTM, scan.intensity)


def test_no_edit_is_called_authentic(key: KeyFile) -> None:
    with Watermarker(key) as sender:
        sent = sender.embed(survey())
    for number, changed in enumerate(edits(sent.frame)):
        with Watermarker(key) as receiver:
            found = receiver.verify(changed, sent.record, policy=ANY)
        expected = "undecidable" if changed.intensity is None else "tampered"
        assert found.verdict == expected, number
    with Watermarker(key) as receiver:
        narrow = LidarFrame(sent.frame.points, sent.frame.intensity)
        found = receiver.verify(narrow, sent.record, policy=ANY)
        assert (found.verdict, found.content) == ("undecidable", "unverifiable")
        assert "float64" in found.reason
    # Signed in float32, received with coordinates of somebody else beside them.
    with Watermarker(key) as sender:
        plain = sender.embed(LidarFrame(grid_scan(3000)))
    far = plain.frame.replace(exact=plain.frame.points.astype(np.float64) + 1e-9)
    with Watermarker(key) as receiver:
        assert receiver.verify(far, plain.record, policy=ANY).verdict == "undecidable"


def test_half_a_nanometre_of_rounding_is_the_same_point(key: KeyFile) -> None:
    with Watermarker(key) as sender:
        sent = sender.embed(survey())
    assert sent.frame.exact is not None
    low, high = (np.nextafter(sent.frame.exact, limit) for limit in (-math.inf, math.inf))
    for exact in (low, high):
        with Watermarker(key) as receiver:
            near = framed(exact, UTM, sent.frame.intensity)
            assert receiver.verify(near, sent.record, policy=ANY).verdict == "authentic"


@pytest.mark.parametrize("units", [200, 512, 4000])
def test_float32_on_another_grid(key: KeyFile, units: int) -> None:
    steps = np.round(grid_scan(4000).astype(np.float64) * 1000.0)
    scan = LidarFrame((steps / units).astype(np.float32))
    with Watermarker(key, units_per_m=units) as sender, Watermarker(key) as receiver:
        sent = sender.embed(scan)
        assert np.abs(sent.points.astype(float) - scan.points).max() <= 1.0 / units + 2e-5
        assert receiver.verify(sent.frame, sent.record).verdict == "authentic"
        points = sent.points.copy()
        points[9, 1] = np.nextafter(points[9, 1], np.float32(1e9))
        assert receiver.verify(points, sent.record, policy=ANY).verdict == "tampered"
    if units != 200:  # a multiple of 5 mm is a multiple of 1 mm
        with Watermarker(key) as sender, pytest.raises(InputError, match="grid of 1 mm"):
            sender.embed(scan)


def test_what_no_grid_holds_is_refused(key: KeyFile) -> None:
    scan = survey()
    assert scan.exact is not None
    with Watermarker(key, units_per_m=100) as sender, pytest.raises(InputError, match="1/100 m"):
        sender.embed(scan)
    with Watermarker(key, units_per_m=100, round_points=True) as sender:
        rounded = sender.embed(scan)
        assert rounded.frame.exact is not None
        assert np.abs(rounded.frame.exact - scan.exact).max() <= 0.015 + 1e-9
    with Watermarker(key, embedding="qim") as sender, pytest.raises(InputError, match="float64"):
        sender.embed(scan)
    with pytest.raises(InputError, match="units_per_m"):
        Watermarker(key, embedding="qim", units_per_m=100)
    for wrong in (0, -5, 2_000_000):
        with pytest.raises(InputError, match="units_per_m"):
            Watermarker(key, units_per_m=wrong)
        with pytest.raises(InputError, match="units_per_m"):
            Policy(units_per_m=(wrong,))
    with Watermarker(key, origin=(0, 0, 0)) as sender, pytest.raises(InputError, match="2\\^30"):
        sender.embed(scan)  # 5428 km from there
    with Watermarker(key, origin=(1e12, 0, 0)) as sender, pytest.raises(InputError, match="origin"):
        sender.embed(scan)
    with Watermarker(key) as sender, pytest.raises(InputError, match="in float32"):
        sender.embed(scan.replace(points=scan.points + np.float32(1.0)))


def test_a_survey_file_carries_its_watermark(key: KeyFile, tmp_path: Path) -> None:
    pytest.importorskip("laspy")
    path, out = tmp_path / "survey.las", tmp_path / "signed.las"
    frame = survey(count=3000)
    assert frame.exact is not None
    write_scan(LidarFrame(frame.exact.astype(np.float32), frame.intensity), path)
    first = read_scan(path)  # a file whose grid of 0.1 mm holds whole millimetres
    assert first.format is not None
    at = np.floor(UTM)
    exact = np.round(grid_scan(3000).astype(np.float64), 3) + at
    given = first.replace(exact=exact, points=(exact - first.format.to_file[:3, 3]).astype("f4"))
    write_scan(given, path)
    read = read_scan(path)
    with Watermarker(key) as sender:
        sent = sender.embed(read)
        write_watermarked(sent, out)
        with pytest.raises(InputError, match="does not keep the coordinates"):
            write_watermarked(sent, tmp_path / "narrow.bin")
        assert not (tmp_path / "narrow.bin").exists()
    back = read_scan(out)
    assert back.exact is not None
    record = manip3d.authenticate.read_record(manip3d.authenticate.record_path(out))
    with Watermarker(key) as receiver:
        assert receiver.verify(back, record, policy=ANY).verdict == "authentic"
    other = back.exact.copy()
    other[5, 0] += 0.001
    write_scan(back.replace(exact=other), out)
    with Watermarker(key) as receiver:
        assert receiver.verify(read_scan(out), record, policy=ANY).verdict == "tampered"


@pytest.mark.parametrize("columns", [3, 4])
def test_arrays_of_a_map_are_refused(key: KeyFile, columns: int) -> None:
    """Rounded to float32, points that moved by up to 24 cm were authentic."""
    scan = survey(count=3000)
    assert scan.exact is not None
    assert scan.intensity is not None
    array = np.column_stack([scan.exact, scan.intensity])[:, :columns]
    near = array - np.r_[scan.exact.mean(axis=0), 0.0][:columns]
    with Watermarker(key, embedding="detached") as sender:
        with pytest.raises(InputError, match=r"scan: float32 rounds these coordinates by up to 0"):
            sender.embed(array)
        record = sender.embed(near).record
        with pytest.raises(InputError, match=r"scan: float32 rounds these coordinates by up to 0"):
            sender.own_verifier().verify(array, record)
        assert sender.own_verifier().verify(near, record).verdict == "authentic"
