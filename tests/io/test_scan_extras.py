"""LAS, LAZ and E57: round trips, fields untouched, hostile files."""

from __future__ import annotations

import contextlib
import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import FormatError, InputError, LidarFrame, io
from manip3d.authenticate import inspect
from manip3d.io import read_scan
from manip3d.io._scan_files import names_left_out
from manip3d.lidar import ScanFormat

laspy = pytest.importorskip("laspy")
lazrs = pytest.importorskip("lazrs")


def write_las(path: Path, *, far: bool = False, num_points: int = 500) -> Any:
    """A file as a surveyor's: classes, returns, GPS time, a dimension of its own."""
    rng = np.random.default_rng(0)
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales = np.array([0.001, 0.001, 0.001])
    header.offsets = np.array([5e5, 5e6, 100.0]) if far else np.zeros(3)
    header.add_extra_dim(laspy.ExtraBytesParams("amplitude", np.int16))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(num_points, header=header)
    las.x, las.y, las.z = (rng.normal(size=(num_points, 3)) * 50 + header.offsets).T
    las.intensity = rng.integers(0, 65536, num_points)
    las.gps_time = rng.random(num_points)
    las.return_number = rng.integers(1, 4, num_points)
    las.number_of_returns = np.full(num_points, 3)
    las.classification = rng.integers(0, 32, num_points)
    las.amplitude = rng.integers(-999, 999, num_points)
    las.write(str(path))
    return las


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("far", [False, True])
def test_las_is_written_back_as_read(tmp_path: Path, suffix: str, far: bool) -> None:
    path = tmp_path / f"a.{suffix}"
    stored = write_las(path, far=far)
    frame = read_scan(path)
    assert frame.num_points == 500
    assert np.abs(frame.points).max() < 400
    assert frame.origin is None
    assert frame.format is not None
    again = frame.format.file_coordinates(frame.points)
    np.testing.assert_allclose(again, np.column_stack([stored.x, stored.y, stored.z]), atol=3e-5)
    assert frame.intensity is not None
    assert frame.intensity.tolist() == stored.intensity.tolist()
    assert frame.fields["return_number"].tolist() == np.array(stored.return_number).tolist()
    frame.write(tmp_path / f"b.{suffix}")
    back = laspy.read(tmp_path / f"b.{suffix}")
    assert np.array_equal(back.points.array, stored.points.array)
    assert back.header.scales.tolist() == stored.header.scales.tolist()
    # One point moved, one taken away, one added.
    new = np.array([frame.points[0], frame.points[1], [1, 2, 3]])
    new[1, 0] += 1.0
    changed = frame.with_points(new, source_index=[0, 1, -1])
    changed.write(tmp_path / f"c.{suffix}")
    edited = laspy.read(tmp_path / f"c.{suffix}")
    assert edited.points.array[0] == stored.points.array[0]
    assert edited.x[1] == pytest.approx(stored.x[1] + 1.0, abs=0.0011)
    assert edited.y[1] == pytest.approx(stored.y[1], abs=0.0011)
    assert edited.gps_time.tolist() == [*stored.gps_time[:2], 0.0]
    assert edited.amplitude[1] == stored.amplitude[1]


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_the_octree_of_a_copc_file_is_left_out(tmp_path: Path, suffix: str) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    info = laspy.vlrs.VLR(user_id="copc", record_id=1, record_data=bytes(160))
    header.vlrs.extend([info, laspy.vlrs.VLR(user_id="survey", record_id=7, record_data=b"kept")])
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.arange(30.0).reshape(3, 10)
    las.write(str(tmp_path / "a.copc.laz"))
    io.write_scan(read_scan(tmp_path / "a.copc.laz"), tmp_path / f"b.{suffix}")
    back = laspy.read(tmp_path / f"b.{suffix}")
    assert np.array_equal(back.xyz, las.xyz)
    assert [record.user_id for record in back.header.vlrs if "las" not in record.user_id] == [
        "survey"
    ]


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("num_points", [0, 100])
def test_other_scans_as_las(tmp_path: Path, suffix: str, num_points: int) -> None:
    rng = np.random.default_rng(1)
    frame = LidarFrame(
        rng.normal(size=(num_points, 3)) * 20,
        rng.random(num_points).astype(np.float32),
        ring=rng.integers(0, 64, num_points).astype(np.uint8),
        fields={"time": rng.random(num_points).astype(np.float32)},
    )
    frame.write(tmp_path / f"a.{suffix}")
    again = read_scan(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(again.points, frame.points, atol=6e-5)
    assert again.fields["time"].tolist() == frame.fields["time"].tolist()
    assert again.ring is not None
    assert again.ring.tolist() == frame.ring.tolist()  # type: ignore[union-attr]
    if num_points:
        assert again.intensity is not None
        assert again.intensity.tolist() == frame.intensity.tolist()  # type: ignore[union-attr]


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(
    ("given", "stored"),
    [(np.float16, np.float32), (np.float32, np.float32), (np.longdouble, np.float64)],
)
def test_decimal_numbers_of_other_widths_fit_into_las(
    tmp_path: Path, suffix: str, given: type, stored: type
) -> None:
    frame = LidarFrame(np.eye(3), fields={"score": np.array([1.5, -2.25, 0.0], given)})
    frame.write(tmp_path / f"a.{suffix}")
    score = read_scan(tmp_path / f"a.{suffix}").fields["score"]
    assert (score.dtype, score.tolist()) == (stored, [1.5, -2.25, 0.0])


@pytest.mark.parametrize("name", ["reflectance", "deviation"])
def test_dimensions_with_a_scale_or_several_numbers_are_written_back(
    tmp_path: Path, name: str
) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    scaled = laspy.ExtraBytesParams(name, np.int16, scales=np.array([0.01]), offsets=np.zeros(1))
    header.add_extra_dims([scaled, laspy.ExtraBytesParams("direction", "3f4")])
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.arange(30.0).reshape(3, 10)
    las[name] = np.linspace(-12.34, 5.67, 10)
    las["direction"] = np.arange(30.0, dtype=np.float32).reshape(10, 3)
    las.write(str(tmp_path / "a.las"))
    read_scan(tmp_path / "a.las").write(tmp_path / "b.las")
    back = laspy.read(tmp_path / "b.las")
    assert list(back.point_format.dimension_names) == list(las.point_format.dimension_names)
    np.testing.assert_allclose(np.asarray(back[name]), np.asarray(las[name]), atol=1e-6)
    np.testing.assert_array_equal(back["direction"], las["direction"])


LONG_NAME = "name_of_a_scalar_field_that_is_too_long"


@pytest.mark.parametrize(
    ("name", "values", "stored"),
    [
        ("user_data", np.array([0, 255], np.int32), "user_data"),
        ("user_data", np.array([0, 256], np.int32), "user_data_2"),
        ("point_source_id", np.array([-1, 7], np.int32), "point_source_id_2"),
        ("return_number", np.array([1, 15], np.uint8), "return_number"),
        ("return_number", np.array([1, 16], np.uint8), "return_number_2"),
        ("classification", np.array([2.0, 6.0], np.float32), "classification"),
        ("classification", np.array([2.5, 6.0], np.float32), "classification_2"),
        ("scan_angle", np.array([-15, 15], np.int16), "scan_angle"),
        ("scan_angle", np.array([-15.0, 15.0], np.float32), "scan_angle_2"),
        ("gps_time", np.array([1.5, 2.5]), "gps_time"),
        ("X", np.array([3, 4], np.int32), "X_2"),
        ("ns", np.array([1_670_000_000_000_000_001, 3], np.int64), "ns"),
        (LONG_NAME, np.array([1.0, 2.0]), LONG_NAME[:32]),
    ],
)
def test_columns_that_a_las_dimension_cannot_hold_get_their_own(
    tmp_path: Path, name: str, values: np.ndarray, stored: str
) -> None:
    """They were cut to its limits, X replaced the coordinates, and long names were an error."""
    points = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    frame = LidarFrame(points, fields={name: values})
    if stored == name:
        frame.write(tmp_path / "a.las")
    else:
        with pytest.warns(UserWarning, match=f"{name} as {stored}"):
            frame.write(tmp_path / "a.las")
    las = laspy.read(tmp_path / "a.las")
    np.testing.assert_array_equal(np.asarray(las[stored]), values)
    np.testing.assert_allclose(las.xyz, points, atol=1e-4)


@pytest.mark.parametrize("intensity", [[-1500.0, 1494.0], [3.0, 70_000.0], [0.25, 0.5]])
def test_intensities_that_las_cannot_hold_are_reflectances(
    tmp_path: Path, intensity: list[float]
) -> None:
    frame = LidarFrame(np.eye(3)[:2], np.array(intensity, np.float32))
    frame.write(tmp_path / "a.las")
    assert np.asarray(laspy.read(tmp_path / "a.las")["reflectance"]).tolist() == intensity
    again = read_scan(tmp_path / "a.las")
    assert again.intensity is not None
    assert again.intensity.tolist() == intensity
    again.write(tmp_path / "b.las")
    assert np.asarray(laspy.read(tmp_path / "b.las")["reflectance"]).tolist() == intensity


@pytest.mark.parametrize("intensity", [[0.25, 0.5], [3.0, 4.0]])
def test_a_reflectance_beside_the_intensity_is_kept_in_las(
    tmp_path: Path, intensity: list[float]
) -> None:
    fields = {"reflectance": np.float32([-10.0, -11.0])}
    frame = LidarFrame(np.eye(3)[:2], np.array(intensity, np.float32), fields=fields)
    is_named = intensity[0] < 1.0  # whole intensities leave the name to the field
    with pytest.warns(UserWarning, match="reflectance_2") if is_named else contextlib.nullcontext():
        frame.write(tmp_path / "a.las")
    las = laspy.read(tmp_path / "a.las")
    names = ("reflectance", "reflectance_2") if is_named else ("intensity", "reflectance")
    assert np.asarray(las[names[0]]).tolist() == intensity
    assert np.asarray(las[names[1]]).tolist() == [-10.0, -11.0]


def test_names_that_agree_in_32_letters_are_kept_apart_in_las(tmp_path: Path) -> None:
    fields = {"a" * 40: np.arange(2.0), "a" * 32: np.arange(2.0) + 5}
    with pytest.warns(UserWarning, match="a_2$"):
        LidarFrame(np.eye(3)[:2], fields=fields).write(tmp_path / "a.las")
    found = read_scan(tmp_path / "a.las").fields
    assert found["a" * 32].tolist() == [0.0, 1.0]
    assert found["a" * 30 + "_2"].tolist() == [5.0, 6.0]


def damaged(data: bytes, at: int, code: str, value: int) -> bytes:
    size = struct.calcsize("<" + code)
    return data[:at] + struct.pack("<" + code, value) + data[at + size :]


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda d: b"", "expected a LAS file"),
        (lambda d: b"XXXX" + d[4:], "expected a LAS file"),
        (lambda d: d[:100], "file ends within the header"),
        (lambda d: damaged(d, 107, "I", 4_000_000_000), "claimed|claim to hold"),
        (lambda d: damaged(d, 100, "I", 4_000_000_000), "4000000000 records claimed"),
        (lambda d: damaged(d, 96, "I", 4_000_000_000), "expected points at bytes"),
        (lambda d: damaged(d, 94, "H", 60000), "expected points at bytes"),
        (lambda d: damaged(d, 131, "Q", 0x7FF8000000000000), "coordinates that fit|damaged LAS"),
    ],
)
def test_hostile_las(tmp_path: Path, suffix: str, spoil: Any, reason: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write_las(path)
    path.write_bytes(spoil(path.read_bytes()))
    with pytest.raises(FormatError, match=reason) as caught:
        read_scan(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_any_damaged_byte_of_las_is_an_error_or_a_scan(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    write_las(path, num_points=20)
    whole = path.read_bytes()
    rng = np.random.default_rng(2)
    outcomes: list[int | None] = []
    for trial in range(200):
        data = bytearray(whole)
        for at in rng.integers(0, len(whole), 3):
            data[at] = rng.integers(0, 256)
        size = rng.integers(1, len(whole)) if trial % 4 == 0 else len(whole)
        path.write_bytes(bytes(data[:size]))
        try:
            frame = read_scan(path)
        except FormatError:
            outcomes.append(None)
        else:
            outcomes.append(frame.num_points + frame.num_dropped)
    assert 20 in outcomes
    assert max(n for n in outcomes if n is not None) == 20  # nothing is made up
    assert None in outcomes
    if suffix == "laz":  # a stream that is cut short cannot be decoded to the same count
        assert set(outcomes[::4]) == {None}


def pose(angle: float, place: tuple[float, float, float]) -> dict[str, Any]:
    matrix = np.eye(4)
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix[:2, :2] = [[cosine, -sine], [sine, cosine]]
    matrix[:3, 3] = place
    rotation = np.array([np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)])
    return {"pose": matrix, "rotation": rotation}


@pytest.mark.parametrize("name", ["ring", "Channel"])
def test_lasers_of_las_are_rings(tmp_path: Path, name: str) -> None:
    """They are extra dimensions; scans keep them under their name, and other formats as ring."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams(name, np.uint16))
    header.add_extra_dim(laspy.ExtraBytesParams("laser_id", np.float32))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(50, header=header)
    las.x = np.arange(50) / 10
    las[name] = np.arange(50) % 16
    las["laser_id"] = np.full(50, 0.5)
    las.write(str(tmp_path / "a.las"))
    frame = read_scan(tmp_path / "a.las")
    assert frame.ring is not None
    assert frame.ring.tolist() == [i % 16 for i in range(50)]
    assert name not in frame.fields
    frame.replace(ring=frame.ring[::-1].copy()).write(tmp_path / "b.laz")
    back = laspy.read(tmp_path / "b.laz")
    assert np.array(back[name]).tolist() == [i % 16 for i in range(50)][::-1]
    assert np.array(back["laser_id"]).tolist() == [0.5] * 50
    frame.write(tmp_path / "a.ply")
    assert np.array_equal(read_scan(tmp_path / "a.ply").ring, frame.ring)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("names", "lasers"),
    [
        (("Ring", "ring"), "ring"),
        (("channel", "ring"), "channel"),  # ring is negative
        (("ring",), ""),
    ],
)
def test_one_of_two_columns_of_lasers_is_the_ring(
    tmp_path: Path, names: tuple[str, ...], lasers: str
) -> None:
    """In text one took the place of the other, and a negative one could not be read from it."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    for name in names:
        header.add_extra_dim(laspy.ExtraBytesParams(name, np.int16))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(50, header=header)
    las.x = np.arange(50) / 10
    las[names[0]] = np.arange(50) % 16
    las[names[-1]] = np.arange(50) % 8 - (0 if lasers == names[-1] else 3)
    las.write(str(tmp_path / "a.las"))
    frame = read_scan(tmp_path / "a.las")
    frame.write(tmp_path / "b.las")
    back = laspy.read(tmp_path / "b.las")
    assert all(np.array_equal(back[name], las[name]) for name in names)
    left = next(name for name in names if name != lasers)
    for suffix in ("csv", "ply", "npz", "laz"):
        frame.replace(format=None).write(tmp_path / f"c.{suffix}")
        again = read_scan(tmp_path / f"c.{suffix}")
        if lasers:
            assert again.ring is not None
            assert np.array_equal(again.ring, las[lasers])
        else:
            assert again.ring is None
        assert np.array_equal(again.fields["other_ring"], las[left])


@pytest.mark.parametrize("standard", [False, True])
def test_angles_and_times_of_las_come_back_from_text(tmp_path: Path, standard: bool) -> None:
    """Text states no types; the angles of LAS 1.4 are counts, and its times of two kinds."""
    las = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    las.points = laspy.ScaleAwarePointRecord.zeros(50, header=las.header)
    las.x = np.arange(50) / 10
    las.scan_angle = np.arange(50) * 100 - 2500
    las.gps_time = np.arange(50) + (4e8 if standard else 604_000.0)
    kind = laspy.header.GpsTimeType(int(standard))
    las.header.global_encoding.gps_time_type = kind
    las.write(str(tmp_path / "a.las"))
    read_scan(tmp_path / "a.las").write(tmp_path / "a.csv")
    read_scan(tmp_path / "a.csv").write(tmp_path / "b.las")
    back = laspy.read(tmp_path / "b.las")
    assert not list(back.point_format.extra_dimension_names)
    assert np.array_equal(back.scan_angle, las.scan_angle)
    assert np.array_equal(back.gps_time, las.gps_time)
    assert back.header.global_encoding.gps_time_type == kind


def test_times_since_1970_are_no_gps_times(tmp_path: Path) -> None:
    LidarFrame(np.ones((3, 3)), fields={"gps_time": np.full(3, 1.7e9)}).write(tmp_path / "a.las")
    encoding = laspy.read(tmp_path / "a.las").header.global_encoding
    assert encoding.gps_time_type == laspy.header.GpsTimeType.WEEK_TIME


@pytest.mark.parametrize("kind", [4, 5, 9, 10])
def test_waveforms_of_laz_have_the_versions_that_laszip_reads(tmp_path: Path, kind: int) -> None:
    """LASzip refuses version 2 of the waveforms of formats 4 and 5, which lazrs states."""
    rng = np.random.default_rng(0)
    las = laspy.LasData(laspy.LasHeader(point_format=kind, version="1.4"))
    las.points = laspy.ScaleAwarePointRecord.zeros(500, header=las.header)
    las.x = np.arange(500) / 10
    las["wavepacket_offset"] = 60 + np.cumsum(rng.integers(80, 240, 500))
    las["x_t"] = rng.normal(size=500)
    las.write(str(tmp_path / "a.las"))
    read_scan(tmp_path / "a.las").write(tmp_path / "a.laz")
    whole = (tmp_path / "a.laz").read_bytes()
    begin = laszip_record(whole) + 32
    (count,) = struct.unpack_from("<H", whole, begin)
    items = [struct.unpack_from("<HHH", whole, begin + 2 + 6 * i) for i in range(count)]
    waves = {9: 1, 13: 3}  # version by type of item, as LASzip writes them
    assert [waves[item] == version for item, _, version in items if item in waves] == [True]
    backends = laspy.LazBackend.detect_available()  # LASzip's own among them if it is installed
    for backend in backends:
        back = laspy.read(tmp_path / "a.laz", laz_backend=backend)
        assert np.array_equal(back["wavepacket_offset"], las["wavepacket_offset"])
        assert np.array_equal(back["x_t"], las["x_t"])


def positions() -> list[LidarFrame]:
    rng = np.random.default_rng(3)
    frames = []
    for i in range(3):
        n = 200 + i
        frames.append(
            LidarFrame(
                rng.normal(size=(n, 3)) * 5,
                rng.random(n).astype(np.float32),
                origin=(0.0, 0.0, 0.0),
                fields={
                    "rowIndex": np.arange(n, dtype=np.uint16),
                    "columnIndex": rng.integers(0, 999, n).astype(np.uint16),
                    "colorRed": rng.integers(0, 256, n).astype(np.uint8),
                    "colorGreen": rng.integers(0, 256, n).astype(np.uint8),
                    "colorBlue": rng.integers(0, 256, n).astype(np.uint8),
                },
                format=ScanFormat("e57", header=pose(0.3 * i, (10.0 * i, 1.0, 2.0))),
            )
        )
    return frames


def test_e57_keeps_positions_poses_rows_and_columns(tmp_path: Path) -> None:
    pytest.importorskip("pye57")
    written = positions()
    io.write_scans(written, tmp_path / "a.e57")
    again = io.read_scans(tmp_path / "a.e57")
    assert len(again) == 3
    for old, new in zip(written, again, strict=True):
        assert np.array_equal(new.points, old.points)
        assert np.array_equal(new.intensity, old.intensity)  # type: ignore[arg-type]
        assert new.origin == (0.0, 0.0, 0.0)
        for name, values in old.fields.items():
            assert np.array_equal(new.fields[name], values), name
        assert new.format is not None
        assert old.format is not None
        np.testing.assert_allclose(new.format.header["pose"], old.format.header["pose"], atol=1e-12)
    with pytest.raises(InputError, match="expected one scan, got 3: use read_scans"):
        read_scan(tmp_path / "a.e57")
    io.write_scans([again[1]], tmp_path / "b.e57")
    assert np.array_equal(read_scan(tmp_path / "b.e57").points, written[1].points)
    with pytest.raises(InputError, match="only E57 and PTX hold several scans, got 2"):
        io.write_scans(written[:2], tmp_path / "a.pcd")
    with pytest.raises(InputError, match="E57 needs at least one"):
        io.write_scans([LidarFrame(np.empty((0, 3)))], tmp_path / "c.e57")
    assert not (tmp_path / "c.e57").exists()


def test_rows_and_columns_of_e57_come_back_from_text(tmp_path: Path) -> None:
    """Names in text are read in lower case."""
    pytest.importorskip("pye57")
    (first, *_) = positions()
    first.write(tmp_path / "a.csv")
    text = read_scan(tmp_path / "a.csv")
    assert names_left_out(text, ".e57") == []
    text.write(tmp_path / "b.e57")
    again = read_scan(tmp_path / "b.e57")
    for name, values in first.fields.items():
        assert np.array_equal(again.fields[name], values), name
    unknown = text.fields["rowindex"].copy()
    unknown[0] = np.nan
    text = text.replace(fields={**text.fields, "rowindex": unknown})
    assert names_left_out(text, ".e57") == ["rowindex", "columnindex"]


def test_points_of_e57_that_were_not_measured_are_dropped(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    x = np.arange(5.0)
    state = np.array([0, 1, 0, 2, 0], np.int8)
    data = {"cartesianX": x, "cartesianY": x, "cartesianZ": x, "cartesianInvalidState": state}
    file.write_scan_raw(data)
    file.close()
    frame = read_scan(tmp_path / "a.e57")
    assert frame.points[:, 0].tolist() == [0, 2, 4]
    assert frame.num_dropped == 2


def test_damaged_e57(tmp_path: Path) -> None:
    pytest.importorskip("pye57")
    path = tmp_path / "a.e57"
    io.write_scans(positions(), path)
    whole = path.read_bytes()
    rng = np.random.default_rng(4)
    for size in (0, 7, 8, 40, 48, 1024, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(FormatError):
            read_scan(path)
        assert path.stat().st_size == size
    for _ in range(50):
        data = bytearray(whole)
        data[rng.integers(0, len(whole))] ^= 1 << rng.integers(0, 8)
        path.write_bytes(bytes(data))
        with contextlib.suppress(FormatError):
            assert len(io.read_scans(path)) == 3
    with pytest.raises(FileNotFoundError):
        read_scan(tmp_path / "none.e57")


def write_layered(path: Path) -> bytes:
    """A LAZ 1.4 file whose one chunk consists of layers (point format 6, one extra byte pair)."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("amplitude", np.int16))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(100, header=header)
    las.x, las.y, las.z = np.random.default_rng(0).normal(size=(3, 100))
    las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("us", 1, "a note", b"12345")])
    las.write(str(path))
    return path.read_bytes()


def start_of_points(data: bytes) -> int:
    return int(struct.unpack_from("<I", data, 96)[0])


def chunk_table(data: bytes) -> int:
    return int(struct.unpack_from("<q", data, start_of_points(data))[0])


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        # Each of these made the decoder reserve gigabytes, and the first ended the process.
        (lambda d: damaged(d, chunk_table(d) + 4, "I", 0xFFFFFFFF), "4294967295 chunks claimed"),
        (lambda d: damaged(d, chunk_table(d) + 4, "I", 2), "2 chunks claimed for 100 points"),
        (lambda d: damaged(d, chunk_table(d) + 4, "I", 0), "0 chunks for 100 points, at least 1"),
        # 30 bytes of the first point, 2 of amplitude, 4 of the number of points, then the layers.
        (lambda d: damaged(d, start_of_points(d) + 8 + 36, "I", 0xFFFFFF00), "layers of 42949"),
        (lambda d: damaged(d, start_of_points(d) + 8 + 32, "I", 101), "a chunk of 101 points"),
        (lambda d: damaged(d, start_of_points(d), "q", 2**40), "expected the chunk table"),
        (lambda d: damaged(d, start_of_points(d), "q", -1), "expected the chunk table"),
        (lambda d: damaged(d, struct.unpack_from("<Q", d, 235)[0] + 20, "Q", 2**60), "a record of"),
        (lambda d: damaged(d, laszip_record(d) + 36, "H", 5), "items of 7 bytes in points of 32"),
        (lambda d: damaged(d, laszip_record(d) + 12, "I", 0), "chunks of at least one point"),
        (lambda d: damaged(d, 25, "B", 7), "expected LAS 1.0 to 1.4, got 1.7"),
        (lambda d: d[: chunk_table(d) + 4], "expected the chunk table|file ends|records claimed"),
    ],
)
def test_laz_that_claims_more_than_it_holds(tmp_path: Path, spoil: Any, reason: str) -> None:
    path = tmp_path / "a.laz"
    whole = write_layered(path)
    assert read_scan(path).num_points == 100
    path.write_bytes(spoil(whole))
    with pytest.raises(FormatError, match=reason):
        read_scan(path)


def laszip_record(data: bytes) -> int:
    return data.index(b"laszip encoded") + 52


def test_las_coordinates_beyond_float32(tmp_path: Path) -> None:
    """Their mean overflows: refused as they stand, and NumPy warns of nothing."""
    las = laspy.LasData(laspy.LasHeader(point_format=0, version="1.2"))
    las.points = laspy.ScaleAwarePointRecord.zeros(40, header=las.header)
    las.y = np.arange(40)
    las.write(str(tmp_path / "a.las"))
    whole = (tmp_path / "a.las").read_bytes()
    (tmp_path / "a.las").write_bytes(damaged(whole, 139, "d", 4e304))  # the step of y
    with pytest.raises(FormatError, match="that fit a float"):
        read_scan(tmp_path / "a.las")


@pytest.mark.parametrize("num_points", [101, 0x8000C350, 0xFFFFFF50])
def test_one_chunk_may_claim_any_size(tmp_path: Path, num_points: int) -> None:
    """The parallel decoder reserved 32 bytes for each and ended the process."""
    path = tmp_path / "a.laz"
    whole = write_layered(path)
    expected = read_scan(path).points
    path.write_bytes(damaged(whole, laszip_record(whole) + 12, "I", num_points))
    np.testing.assert_array_equal(read_scan(path).points, expected)


@pytest.mark.parametrize(("version", "kind"), [("1.2", 3), ("1.4", 6)])
def test_chunks_of_varying_sizes(tmp_path: Path, version: str, kind: int) -> None:
    """Such a file's chunk table also says how many points each chunk has: never more than all."""
    las = laspy.LasData(laspy.LasHeader(point_format=kind, version=version))
    las.points = laspy.ScaleAwarePointRecord.zeros(300, header=las.header)
    las.x = np.arange(300) / 100
    path = tmp_path / "a.laz"
    las.write(str(path))
    whole = path.read_bytes()
    record = lazrs.LazVlr.new_for_compression(kind, 0, True)
    data, place = bytes(record.record_data()), laszip_record(whole)
    stream = BytesIO()
    stream.write(whole[:place] + data + whole[place + len(data) : start_of_points(whole)])
    writer = lazrs.LasZipCompressor(stream, record)
    rows = np.frombuffer(las.points.array.tobytes(), np.uint8).reshape(300, -1)
    writer.compress_many(rows[:100].reshape(-1))
    writer.finish_current_chunk()
    writer.compress_many(rows[100:].reshape(-1))
    writer.done()
    path.write_bytes(stream.getvalue())
    np.testing.assert_allclose(read_scan(path).points[:, 0], np.arange(300) / 100, atol=0.005)

    stream.seek(start_of_points(whole))
    table = lazrs.read_chunk_table(stream, record)
    assert [points for points, _ in table] == [100, 200]
    stream.seek(chunk_table(stream.getvalue()))
    lazrs.write_chunk_table(stream, [(2**30, table[0][1]), table[1]], record)
    path.write_bytes(stream.getvalue())
    with pytest.raises(FormatError, match="a chunk of 1073741824 points in a file of 300"):
        read_scan(path)
    stream.seek(chunk_table(stream.getvalue()))
    lazrs.write_chunk_table(stream, [(0, table[0][1]), table[1]], record)
    path.write_bytes(stream.getvalue())
    with pytest.raises(FormatError, match="chunks of 200 points in a file of 300"):
        read_scan(path)


def test_chunks_of_any_size(tmp_path: Path) -> None:
    """LASzip's default is 50 000 points a chunk: several chunks, the last not full."""
    frame = LidarFrame(np.random.default_rng(0).normal(size=(120_000, 3)))
    frame.write(tmp_path / "a.laz")
    np.testing.assert_allclose(read_scan(tmp_path / "a.laz").points, frame.points, atol=6e-5)


@pytest.mark.parametrize("source", ["las", "csv", "ply", "npy"])
@pytest.mark.parametrize(
    "name", ["a.csv", "a.xyz", "a.pts", "a.npy", "a.las", "a.laz", "a.ply", "a.pcd"]
)
def test_another_format_keeps_coordinates_of_a_map(tmp_path: Path, source: str, name: str) -> None:
    pytest.importorskip("laspy", reason="the extra 'las' is not installed")
    random = np.random.default_rng(0)
    place = np.array([458_000.0, 5_428_000.0, 110.0])
    stored = (place + random.uniform(0.0, 80.0, (200, 3))).round(3)
    np.save(tmp_path / "first.npy", stored)
    first = tmp_path / f"first.{source}"
    if source == "csv":
        np.savetxt(first, stored, fmt="%.3f", delimiter=",", header="x,y,z", comments="")
    elif source != "npy":
        io.read_scan(tmp_path / "first.npy").write(first)
    written = tmp_path / name
    io.read_scan(first).write(written)
    again = io.read_scan(written)
    assert again.exact is not None
    assert np.abs(again.exact - stored).max() < 1e-6
    if name == "a.csv":
        assert np.abs(np.loadtxt(written, delimiter=",", skiprows=1)[:, :3] - stored).max() < 1e-6
    if name == "a.csv" and source == "las":
        rows = written.read_text().splitlines()[1:]
        assert all(len(x.partition(".")[2]) <= 4 for row in rows for x in row.split(",")[:3])
    assert np.abs(again.points).max() < 100.0  # where float32 has steps of less than 0.01 mm


def test_e57_holds_coordinates_of_a_map_in_the_pose(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57", reason="the extra 'e57' is not installed")
    pytest.importorskip("laspy", reason="the extra 'las' is not installed")
    place = np.array([458_000.0, 5_428_000.0, 110.0])
    stored = (place + np.random.default_rng(0).uniform(0.0, 80.0, (200, 3))).round(3)
    np.save(tmp_path / "a.npy", stored)
    io.read_scan(tmp_path / "a.npy").write(tmp_path / "a.e57")
    again = io.read_scan(tmp_path / "a.e57")
    assert again.format is not None
    assert again.origin is None
    assert np.abs(again.format.file_coordinates(again.points) - stored).max() < 1e-4
    again.write(tmp_path / "b.e57")
    other = pye57.E57(str(tmp_path / "b.e57"))
    theirs = other.read_scan(0, ignore_missing_fields=True)  # by the pose
    other.close()
    assert np.abs(theirs["cartesianX"] - stored[:, 0]).max() < 1e-4


def test_e57_far_from_its_own_scanner_is_read_near_0(tmp_path: Path) -> None:
    """Others write coordinates of maps into E57 without a pose."""
    pye57 = pytest.importorskip("pye57", reason="the extra 'e57' is not installed")
    place = np.array([458_000.0, 5_428_000.0, 110.0])
    stored = place + np.random.default_rng(0).uniform(0.0, 80.0, (200, 3)).astype(np.float32)
    axes = ("cartesianX", "cartesianY", "cartesianZ")
    stored = stored.astype(np.float32).astype(np.float64)  # what pye57 writes
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    file.write_scan_raw({axis: stored[:, i] for i, axis in enumerate(axes)})
    file.close()
    frame = io.read_scan(tmp_path / "a.e57")
    assert np.abs(frame.points).max() < 100.0
    assert frame.origin is None
    frame.write(tmp_path / "a.csv")
    assert (
        np.abs(np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)[:, :3] - stored).max()
        < 1e-6
    )
    frame.write(tmp_path / "b.e57")
    other = pye57.E57(str(tmp_path / "b.e57"))
    theirs = other.read_scan(0, ignore_missing_fields=True)
    other.close()
    assert np.abs(theirs["cartesianX"] - stored[:, 0]).max() < 1e-6


def test_the_viewpoint_of_a_map_moves_with_its_points(tmp_path: Path) -> None:
    """One of 0 is what a writer puts that knows none."""
    place = np.array([458_000.0, 5_428_000.0, 110.0])
    stored = place + np.random.default_rng(0).uniform(0.0, 80.0, (200, 3)).round(3)
    head = "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\n"
    head += "SIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 200\nHEIGHT 1\n"
    for viewpoint, expected in (("458010 5428010 112", [10.0, 10.0, 2.0]), ("0 0 0", None)):
        text = head + f"VIEWPOINT {viewpoint} 1 0 0 0\nPOINTS 200\nDATA binary\n"
        (tmp_path / "a.pcd").write_bytes(text.encode() + stored.astype("<f8").tobytes())
        frame = io.read_scan(tmp_path / "a.pcd")
        assert frame.format is not None
        shift = frame.format.to_file[:3, 3]
        assert shift.any()
        if expected is None:
            assert frame.origin is None
        else:
            np.testing.assert_array_equal(frame.origin + shift - place, expected)
        frame.write(tmp_path / "b.pcd")
        assert (tmp_path / "b.pcd").read_bytes() == (tmp_path / "a.pcd").read_bytes()


@pytest.mark.parametrize("suffix", [".bin", ".pcd", ".ply", ".csv", ".npy", ".npz", ".xyz"])
def test_intensities_between_0_and_1_come_back_from_las(tmp_path: Path, suffix: str) -> None:
    """LAS has whole intensities only: others stand beside them as the reflectance."""
    rng = np.random.default_rng(2)
    intensity = (rng.integers(0, 100, 40) / 100).astype(np.float32)
    points = np.float32(rng.integers(-999, 999, (40, 3)) / 10)
    LidarFrame(points, intensity).write(tmp_path / "a.las")
    read_scan(tmp_path / "a.las").write(tmp_path / f"b{suffix}")
    back = read_scan(tmp_path / f"b{suffix}")
    np.testing.assert_allclose(back.intensity, intensity, atol=1e-6)
    assert "las_intensity" not in back.fields  # they were all 0


def test_both_intensities_of_las_are_kept(tmp_path: Path) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("reflectance", np.float32))
    las = laspy.LasData(header)
    las.points = laspy.ScaleAwarePointRecord.zeros(3, header=header)
    las.intensity, las.reflectance = [7, 8, 9], [-1.5, -2.5, -3.5]
    las.write(str(tmp_path / "a.las"))
    read_scan(tmp_path / "a.las").write(tmp_path / "b.csv")
    back = read_scan(tmp_path / "b.csv")
    assert back.intensity is not None
    assert back.intensity.tolist() == [-1.5, -2.5, -3.5]
    assert back.fields["las_intensity"].tolist() == [7, 8, 9]


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_new_names_of_columns_replace_no_others(suffix: str, tmp_path: Path) -> None:
    numbers = np.arange(1, 9, dtype=np.int32)
    names = ("las_intensity", "intensity", "other_ring", "ring", "Ring", "a_b", "a b", "a  b")
    fields = dict(zip(names, (np.full(3, number) for number in numbers), strict=True))
    ring = np.zeros(3, np.uint16)
    LidarFrame(np.ones((3, 3), np.float32), np.ones(3, np.float32), ring=ring, fields=fields).write(
        tmp_path / f"a{suffix}"
    )
    found = read_scan(tmp_path / f"a{suffix}").fields
    assert {name: values.tolist()[0] for name, values in found.items()} == {
        "las_intensity": 1, "las_intensity_2": 2, "other_ring": 3, "other_ring_2": 4,
        "other_ring_3": 5, "a_b": 6, "a_b_2": 7, "a_b_3": 8,
    }  # fmt: skip


def _in_system(path: Path, *records: tuple[int, bytes]) -> Path:
    las = laspy.read(path)
    las.header.vlrs.extend(
        laspy.vlrs.VLR(user_id="LASF_Projection", record_id=number, record_data=data)
        for number, data in records
    )
    las.write(str(path))
    return path


def _geo_keys(*units: tuple[int, int]) -> tuple[int, bytes]:
    keys = [number for key, unit in units for number in (key, 0, 1, unit)]
    return 34735, struct.pack(f"<{4 + len(keys)}H", 1, 1, 0, len(units), *keys)


def _wkt(*units: str) -> tuple[int, bytes]:
    inner = ",".join(units)
    text = f'PROJCS["p",GEOGCS["g",UNIT["degree",0.0174532925199433]],{inner}]'
    return 2112, text.encode() + bytes(1)


def _wkt2(unit: str, kind: str = "Cartesian") -> tuple[int, bytes]:
    """A system of ISO 19162, where ellipsoids and parameters have units of their own."""
    datum = 'DATUM["d",ELLIPSOID["e",6378137,298.2,LENGTHUNIT["metre",1,ID["EPSG",9001]]]]'
    system = f'CS[{kind},2],AXIS["x",east,ORDER[1],{unit}],AXIS["y",north,ORDER[2],{unit}]'
    if kind == "ellipsoidal":
        return 2112, f'GEODCRS["g",{datum},{system}]'.encode() + bytes(1)
    easting = 'PARAMETER["False easting",5e5,LENGTHUNIT["metre",1]]'
    conversion = f'CONVERSION["c",METHOD["m"],{easting}]'
    plane = f'PROJCRS["p",BASEGEOGCRS["g",{datum}],{conversion},{system}]'
    height = f'VERTCRS["v",VDATUM["v"],CS[vertical,1],AXIS["up",up],{unit}]'
    return 2112, f'COMPOUNDCRS["c",{plane},{height}]'.encode() + bytes(1)


FEET = 'UNIT["US survey foot",0.3048006096012192,AUTHORITY["EPSG","9003"]]'
METRES = 'UNIT["metre",1,AUTHORITY["EPSG","9001"]]'


@pytest.mark.parametrize(
    "records",
    [
        [_geo_keys((3076, 9003))],
        [_geo_keys((1024, 1), (3076, 9002), (4099, 9003))],
        [_wkt(FEET)],
        [_wkt('LENGTHUNIT["foot", .3048]')],
        [_geo_keys((3076, 9002)), _wkt(FEET)],
        [_wkt2("LENGTH" + FEET)],
    ],
)
def test_coordinates_in_feet_are_said_to_be(
    tmp_path: Path, records: list[tuple[int, bytes]]
) -> None:
    """Surveys in feet were measured and judged as if in metres."""
    write_las(tmp_path / "a.las")
    plain = read_scan(tmp_path / "a.las")
    with pytest.warns(UserWarning, match="coordinate system is in feet"):
        scan = read_scan(_in_system(tmp_path / "a.las", *records))
    np.testing.assert_array_equal(scan.points, plain.points)  # nothing is converted
    assert scan.format is not None
    assert scan.format.header["unit"] == "feet"
    found = inspect(scan, origin=(0.0, 0.0, 0.0))
    assert (found.verdict, "in feet" in found.reason) == ("undecidable", True)


@pytest.mark.parametrize(
    "record",
    [
        _geo_keys((1024, 2), (2048, 4326), (4099, 9001)),
        (2112, b'GEOGCS["g",DATUM["d"],UNIT["degree",0.0174532925199433]]\0'),
        _wkt2('ANGLEUNIT["degree",0.0174532925199433]', "ellipsoidal"),
        (2112, b'COMPD_CS["c",GEOGCS["g",UNIT["degree",0.017]],VERT_CS["v",UNIT["metre",1]]]\0'),
    ],
)
def test_longitudes_and_latitudes_are_said_to_be_degrees(
    tmp_path: Path, record: tuple[int, bytes]
) -> None:
    """They were measured and judged as if in metres."""
    write_las(tmp_path / "a.las")
    with pytest.warns(UserWarning, match="coordinate system is in degrees"):
        scan = read_scan(_in_system(tmp_path / "a.las", record))
    assert scan.format is not None
    assert scan.format.header["unit"] == "degrees"
    found = inspect(scan, origin=(0.0, 0.0, 0.0))
    assert (found.verdict, "in degrees" in found.reason) == ("undecidable", True)


@pytest.mark.parametrize(
    "records",
    [
        [],
        [_geo_keys((3076, 9001))],
        [_geo_keys((1024, 1), (2048, 4326), (3076, 9001))],
        [_geo_keys((3072, 2994))],  # a system in feet by its number, which tables would tell
        [_geo_keys((3076, 9001), (4099, 9003))],
        [_wkt(METRES)],
        [_wkt(FEET, METRES)],
        [_wkt2("LENGTH" + METRES)],
        [(34735, b"cut")],
        [(2112, bytes(range(128, 250)))],
    ],
)
def test_no_other_unit_is_named(tmp_path: Path, records: list[tuple[int, bytes]]) -> None:
    write_las(tmp_path / "a.las")
    scan = read_scan(_in_system(tmp_path / "a.las", *records))
    assert scan.format is not None
    assert "unit" not in scan.format.header


def _e57_with(path: Path, added: dict[str, np.ndarray]) -> np.ndarray:
    """Write an E57 of five points with columns that pye57 does not write; return the points."""
    pye57 = pytest.importorskip("pye57")
    e57 = pye57.libe57
    points = np.arange(15.0).reshape(5, 3)
    file = pye57.E57(str(path), mode="w")
    image = file.image_file
    prototype, empty = e57.StructureNode(image), e57.VectorNode(image, True)
    columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), points.T.copy(), strict=True))
    for name in columns:
        prototype.set(name, e57.FloatNode(image, 0.0, e57.E57_DOUBLE, -100.0, 100.0))
    for name, values in added.items():
        node = e57.FloatNode(image, 0.0, e57.E57_DOUBLE, 0.0, 1e6)
        prototype.set(name, node if values.dtype.kind == "f" else e57.IntegerNode(image, 0, 0, 3))
    rows, scan = e57.CompressedVectorNode(image, prototype, empty), e57.StructureNode(image)
    scan.set("guid", e57.StringNode(image, "{1}"))
    scan.set("points", rows)
    file.data3d.append(scan)
    buffers = e57.VectorSourceDestBuffer()
    for name, values in {**columns, **added}.items():
        buffers.append(e57.SourceDestBuffer(image, name, values, 5, True, True))
    writer = rows.writer(buffers)
    writer.write(5)
    writer.close()
    file.close()
    return points


def test_e57_states_the_echo_of_each_point(tmp_path: Path) -> None:
    """pye57 writes no column of echoes; scanners with several returns a pulse do."""
    echo = np.array([0, 1, 0, 2, 1], np.uint16)
    points = _e57_with(tmp_path / "a.e57", {"returnIndex": echo})
    frame = io.read_scan(tmp_path / "a.e57")
    assert frame.points.tolist() == points.tolist()
    assert frame.fields["returnIndex"].tolist() == echo.tolist()


@pytest.mark.parametrize("invalid", [[0, 1, 0, 1, 1], [0] * 5, [1] * 5])
def test_e57_states_times_and_invalid_intensities(tmp_path: Path, invalid: list[int]) -> None:
    times = np.array([0.0, 0.25, 0.5, 0.75, 12345.000001])
    shine = np.array([1.0, 0.0, 3.0, 0.0, 0.0])
    flags = np.array(invalid, np.uint8)
    added = {"intensity": shine, "timeStamp": times, "isIntensityInvalid": flags}
    _e57_with(tmp_path / "a.e57", added)
    frame = io.read_scan(tmp_path / "a.e57")
    assert frame.fields["timeStamp"].tolist() == times.tolist()
    assert frame.fields["isIntensityInvalid"].tolist() == invalid
    if all(invalid):
        assert frame.intensity is None
    else:
        assert frame.intensity is not None
        assert frame.intensity.tolist() == shine.tolist()
    assert "timeStamp" in io._scan_files.names_left_out(frame, ".e57")


@pytest.mark.parametrize(
    ("name", "values", "limits", "read"),
    [
        ("colorRed", [0.0, 257.0, 65535.0], (0, 65535), [0, 1, 255]),
        ("colorRed", [0.0, 7.0, 255.0], (0, 255), [0, 7, 255]),
        ("rowIndex", [0.0, 70_000.0, 200_000.0], (0, 200_000), [0, 70_000, 200_000]),
        ("columnIndex", [-1000.0, 0.0, 5.0], (-1000, 1000), [-1000, 0, 5]),
    ],
)
def test_e57_with_numbers_beyond_those_of_pye57_is_read(
    tmp_path: Path, name: str, values: list[float], limits: tuple[int, int], read: list[int]
) -> None:
    """Such files were "damaged"."""
    pye57 = pytest.importorskip("pye57")
    e57 = pye57.libe57
    file = pye57.E57(str(tmp_path / "a.e57"), mode="w")
    image = file.image_file
    prototype, empty = e57.StructureNode(image), e57.VectorNode(image, True)
    columns = {f"cartesian{axis}": np.arange(3.0) + 1.0 for axis in "XYZ"}
    for column in columns:
        prototype.set(column, e57.FloatNode(image, 0.0, e57.E57_DOUBLE, -100.0, 100.0))
    prototype.set(name, e57.IntegerNode(image, limits[0], *limits))
    rows, scan = e57.CompressedVectorNode(image, prototype, empty), e57.StructureNode(image)
    scan.set("guid", e57.StringNode(image, "{1}"))
    scan.set("points", rows)
    file.data3d.append(scan)
    buffers = e57.VectorSourceDestBuffer()
    columns[name] = np.array(values)
    for column, numbers in columns.items():
        buffers.append(e57.SourceDestBuffer(image, column, numbers, 3, True, True))
    writer = rows.writer(buffers)
    writer.write(3)
    writer.close()
    file.close()
    frame = io.read_scan(tmp_path / "a.e57")
    assert frame.fields[name].tolist() == read
    io.write_scan(frame, tmp_path / "b.e57")
    assert not io.read_scan(tmp_path / "b.e57").fields  # it writes all colours, or rows and columns
    assert names_left_out(frame, ".e57") == [name]
