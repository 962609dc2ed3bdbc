"""Scans as text: columns by name or by custom, and what is written back."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, LidarFrame, io
from manip3d.cli.kinds import kind_of
from manip3d.io._scan_files import readable_scans, scan_paths

EXPECTED = [[1.5, -2.0, 3.25], [4.0, 5.0, -6.0]]


def read(path: Path, text: str, name: str = "a.csv") -> LidarFrame:
    (path / name).write_bytes(text.encode())
    return io.read_scan(path / name)


@pytest.mark.parametrize(
    "text",
    [
        "1.5 -2 3.25 7\n4 5 -6 8\n",
        "1.5,-2,3.25,7\r\n4,5,-6,8",
        "1.5;-2;3.25;7;\n4;5;-6;8;\n",
        "1.5\t-2\t+3.25\t7\n\n4\t5\t-6\t8\n",
        "X;Y;Z;Intensity\r\n1,5;-2;3,25;7\r\n4;5,0;-6;8\r\n",
        "1,5 -2,0 +3,25 7\n4 5 -6,0 8\n",
        "x\ty\tz\tintensity\n1,5\t-2\t3,25\t7\n4\t5\t-6\t8,0\n",
        "2\n1.5 -2 3.25 7\n4 5 -6 8\n",
        "\ufeff1.5 -2 3.25 7\n# nobody\n// either\n4 5 -6 8\n",
        "x,y,z,intensity\n,,,0\n1.5,-2,3.25,7\n4,5,-6,8\n",
        "# Fields: x y z intensity\n1.5 -2 3.25 7\n4 5 -6 8\n",
        "//X Y Z Intensity\n1.5 -2 3.25 7\n4 5 -6 8\n",
        "# two scans\n# Z, I, X, Y\n3.25,7,1.5,-2\n-6,8,4,5\n",
        '"X [m]";"Y(m)";"Z_m";"Reflectivity"\n"1.5";"-2";"3.25";"7"\n4;5;-6;8\n',
        "X [m]\tY [m]\tZ [m]\tIntensity\n1.5\t-2\t3.25\t7\n4\t5\t-6\t8\n",
        "intensity,Points_m_XYZ:0,Points_m_XYZ:1,Points_m_XYZ:2\n7,1.5,-2,3.25\n8,4,5,-6\n",
        "Points:0,Points:1,Points:2,intensity\n1.5,-2,3.25,7\n4,5,-6,8\n",
        "# frame num: 0\n# REFLECTIVITY (%), X1 (m), Y1 (m), Z1 (m)\n7,1.5,-2,3.25\n8,4,5,-6\n",
        "x1,y1,z1,Intensity [counts]\n1.5,-2,3.25,7\n4,5,-6,8\n",
    ],
)
def test_columns_of_every_writer(text: str, tmp_path: Path) -> None:
    for name in ("a.xyz", "a.asc", "a.pts", "a.txt", "a.csv"):
        frame = read(tmp_path, text, name)
        assert frame.points.tolist() == EXPECTED
        assert frame.intensity is not None
        assert frame.intensity.tolist() == [7.0, 8.0]
        assert dict(frame.fields) == {}
        assert frame.origin is None
        assert kind_of(str(tmp_path / name)) == "scan"
        frame.write(tmp_path / "again.csv")
        again = io.read_scan(tmp_path / "again.csv")
        assert again.points.tolist() == EXPECTED
        assert again.intensity is not None
        assert again.intensity.tolist() == [7.0, 8.0]


@pytest.mark.parametrize(
    "text",
    [
        "# X Y Z in metres\n1.5 -2 3.25\n4 5 -6\n",
        "# x y z [m]\n1.5 -2 3.25\n4 5 -6\n",
        "# x, y, and, z\nx,y,z\n1.5,-2,3.25\n4,5,-6\n",
        "// z y x, as measured\n1.5,-2,3.25\n4,5,-6\n",
        "# X1, Y1, Z1, X\n1.5 -2 3.25\n4 5 -6\n",
    ],
)
def test_comments_that_only_speak_of_coordinates_name_no_columns(text: str, tmp_path: Path) -> None:
    frame = read(tmp_path, text)
    assert frame.points.tolist() == EXPECTED
    assert frame.intensity is None
    frame.write(tmp_path / "again.csv")
    assert io.read_scan(tmp_path / "again.csv").points.tolist() == EXPECTED


OUSTER_HEADER = (
    "# frame num: 0\n# TIMESTAMP (ns), ROW, DESTAGGERED IMAGE COLUMN, MEASUREMENT_ID, FLAGS, "
    "NEAR_IR (photons), RANGE (mm), REFLECTIVITY (%), {} (m), {} (m), {} (m)\n"
)


def test_tables_of_ouster_cli_have_the_first_return(tmp_path: Path) -> None:
    rows = "99168,0,1,9,0,400,4061,7,1.5,-2,3.25\n99169,1,1,9,0,368,8775,8,4,5,-6\n"
    frame = read(tmp_path, OUSTER_HEADER.format("X1", "Y1", "Z1") + rows)
    assert frame.points.tolist() == EXPECTED
    assert frame.intensity is not None
    assert frame.intensity.tolist() == [7.0, 8.0]
    assert frame.fields["timestamp (ns)"].tolist() == [99168.0, 99169.0]
    assert frame.fields["range (mm)"].tolist() == [4061.0, 8775.0]
    twice = read(tmp_path, "x1,y1,z1,x2,y2,z2\n1.5,-2,3.25,7,7,7\n4,5,-6,7,7,7\n")
    assert twice.points.tolist() == EXPECTED
    assert list(twice.fields) == ["x2", "y2", "z2"]
    beside = read(tmp_path, "x1,y1,z1,x,y,z\n7,7,7,1.5,-2,3.25\n7,7,7,4,5,-6\n")
    assert beside.points.tolist() == EXPECTED
    assert read(tmp_path, "X1 (mm),Y1 (mm),Z1 (mm)\n1500,0,0\n").points.tolist() == [[1.5, 0, 0]]


def test_a_comment_that_names_other_columns_warns(tmp_path: Path) -> None:
    rows = "99168,0,1,9,0,400,4061,7,1.5,-2,3.25\n"
    with pytest.warns(UserWarning, match=r"columns are read as x, y, z, c3.*: # TIMESTAMP"):
        frame = read(tmp_path, OUSTER_HEADER.format("A", "B", "C") + rows)
    assert list(frame.fields)[-1] == "c10"
    with pytest.warns(UserWarning, match="names others: // easting;northing;height"):
        read(tmp_path, "// easting;northing;height\n1;2;3\n")


@pytest.mark.parametrize(
    "comment",
    [
        "# of the hall, in May",
        "# one two three",
        "# 4, 5, 6",
        "# hall, 3 m high, by Anna",
        "# a, b, c\n# the last comment",
    ],
)
def test_other_comments_are_silent(comment: str, tmp_path: Path) -> None:
    assert read(tmp_path, f"{comment}\n1,2,3\n").points.tolist() == [[1.0, 2.0, 3.0]]


def test_columns_without_a_name_are_numbered(tmp_path: Path) -> None:
    """pandas writes the numbers of the rows so."""
    pytest.importorskip("laspy")
    frame = read(tmp_path, ",x,y,z\n7,1.5,-2,3.25\n8,4,5,-6\n")
    assert frame.points.tolist() == EXPECTED
    assert frame.fields["c0"].tolist() == [7.0, 8.0]
    for suffix in (".pcd", ".ply", ".las"):
        frame.write(tmp_path / f"a{suffix}")
        assert io.read_scan(tmp_path / f"a{suffix}").points.tolist() == EXPECTED


def test_numbers_too_small_for_a_double_are_zero(tmp_path: Path) -> None:
    text = "1 2 -1e-400\n3 +1e-5000 4\n"
    assert read(tmp_path, text).points.tolist() == [[1, 2, 0], [3, 0, 4]]


def test_what_files_do_not_name(tmp_path: Path) -> None:
    assert read(tmp_path, "1 2 3\n").intensity is None
    leica = read(tmp_path, "1\n1 2 3 -500 255 128 0\n", "a.pts")
    assert leica.intensity is not None
    assert leica.intensity.tolist() == [-500.0]
    assert [leica.fields[f"c{i}"].tolist() for i in (4, 5, 6)] == [[255.0], [128.0], [0.0]]
    colored = read(tmp_path, "1 2 3 255 128 0\n")
    assert colored.intensity is None
    assert list(colored.fields) == ["c3", "c4", "c5"]


def test_lasers_are_rings(tmp_path: Path) -> None:
    frame = read(tmp_path, "x,y,z,laser_id,timestamp\n1,2,3,31,1311368163000001\n")
    assert frame.ring is not None
    assert (frame.ring.tolist(), frame.ring.dtype) == ([31], np.uint16)
    assert frame.fields["timestamp"].tolist() == [1311368163000001.0]
    with pytest.raises(FormatError, match="laser_id of point 0: expected a whole number"):
        read(tmp_path, "x,y,z,laser_id\n1,2,3,0.5\n")
    with pytest.raises(FormatError, match="laser_id of point 0: expected a whole number"):
        read(tmp_path, "x,y,z,laser_id\n1,2,3,9007199254740993\n")


@pytest.mark.parametrize(
    ("cells", "kind", "values"),
    [
        (["1699999999123456789", "5"], np.int64, [1699999999123456789, 5]),
        (["5", "1699999999123456789"], np.int64, [5, 1699999999123456789]),
        (["5.0", "-9007199254740993"], np.int64, [5, -9007199254740993]),
        (["7", "18446744073709551615"], np.uint64, [7, 18446744073709551615]),
        (["9223372036854775807", "18446744073709551615"], np.uint64, [2**63 - 1, 2**64 - 1]),
        (
            ["18446744073709551615", "3", "18446744073709551614"],
            np.uint64,
            [2**64 - 1, 3, 2**64 - 2],
        ),
        (["0x17979cfe362a0015", "0XfF"], np.int64, [0x17979CFE362A0015, 255]),
        (["0x1f", "+0x20"], np.float64, [31.0, 32.0]),
        (["9007199254740991", "0"], np.float64, [9007199254740991.0, 0.0]),
        (["1699999999123456789", "0.5"], np.float64, [1699999999123456789.0, 0.5]),
        (["18446744073709551615", "-1"], np.float64, [2.0**64, -1.0]),
        (["-1", "18446744073709551615"], np.float64, [-1.0, 2.0**64]),
        (["1699999999123456789", "1e30"], np.float64, [1699999999123456789.0, 1e30]),
        (["1.7e18", "1699999999123456789"], np.float64, [1.7e18, 1699999999123456789.0]),
    ],
)
def test_integers_above_those_of_doubles_keep_their_digits(
    cells: list[str], kind: type[np.generic], values: list[float], tmp_path: Path
) -> None:
    """Nanoseconds since 1970 have 19 digits, and doubles hold 16."""
    lines = [f"{k},2,3,{cell},0.25" for k, cell in enumerate(cells)]
    frame = read(tmp_path, "\n".join(["x,y,z,time,range", *lines, ""]))
    assert frame.fields["time"].dtype == kind
    assert frame.fields["time"].tolist() == values
    assert frame.fields["range"].tolist() == [0.25] * len(cells)
    frame.write(tmp_path / "again.csv")
    again = io.read_scan(tmp_path / "again.csv")
    assert again.fields["time"].tolist() == values
    assert np.array_equal(again.points, frame.points)


def test_a_missing_time_stamp_is_no_integer(tmp_path: Path) -> None:
    frame = read(tmp_path, "x,y,z,t\n1,2,3,1699999999123456789\n4,5,6,\n")
    assert frame.fields["t"].dtype == np.float64
    assert np.isnan(frame.fields["t"][1])


@pytest.mark.parametrize("cell", ["0x", "0xg", "-0x1", "0x-1", "0x11112222333344445", "0x1.8"])
def test_what_is_no_hexadecimal_integer_is_refused(cell: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"a column: expected a number"):
        read(tmp_path, f"x,y,z,flags\n1,2,3,{cell}\n")


def test_coordinates_are_never_integers(tmp_path: Path) -> None:
    frame = read(tmp_path, "x,y,z\n9007199254740993,0,0\n9007199254740994,1,0\n")
    assert frame.exact is not None
    assert frame.exact.dtype == np.float64


def test_points_without_coordinates_are_counted(tmp_path: Path) -> None:
    frame = read(tmp_path, "x,y,z\n1,2,3\n,,\nnan,NaN,nan\n4,5,6\n")
    assert frame.points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert frame.num_dropped == 2
    assert frame.file_rows is not None
    assert frame.file_rows.tolist() == [0, 3]


def test_coordinates_of_maps_keep_their_millimetres(tmp_path: Path) -> None:
    text = "450123.457 5412345.678 110.25\n450124.457 5412346.678 111.25\n"
    frame = read(tmp_path, text, "a.xyz")
    assert np.abs(frame.points).max() < 10.0
    np.testing.assert_allclose(frame.points[1] - frame.points[0], 1.0, atol=1e-6)
    frame.write(tmp_path / "b.xyz")
    assert (tmp_path / "b.xyz").read_text() == text


@pytest.mark.parametrize(
    "text",
    [
        "X;Y;Z;class;I\n1.25;2;3;4;0.1\n",
        "2\n1.25 2 3 -4.7 255 0 1\n5 6 7 8 9 10 11\n",
        "//X Y Z\n1.25 2 3\n",
        "0.1 0.2 0.3\n",
    ],
)
def test_files_are_written_as_they_were_read(text: str, tmp_path: Path) -> None:
    frame = read(tmp_path, text)
    frame.write(tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_text() == text


def test_other_formats_become_text_and_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    points = rng.normal(scale=30.0, size=(500, 3)).astype(np.float32)
    intensity = rng.random(500).astype(np.float32)
    ring = rng.integers(0, 64, 500).astype(np.uint16)
    frame = LidarFrame(points, intensity, ring=ring)
    for name in ("a.csv", "a.csv.gz", "a.xyz", "a.pts", "a.txt.xz"):
        frame.write(tmp_path / name)
        again = io.read_scan(tmp_path / name)
        assert np.array_equal(again.points, points)
        assert np.array_equal(again.intensity, intensity)  # type: ignore[arg-type]
        if ".csv" in name:
            assert np.array_equal(again.ring, ring)  # type: ignore[arg-type]
    assert gzip.decompress((tmp_path / "a.csv.gz").read_bytes()).startswith(b"x,y,z,intensity,ring")
    assert (tmp_path / "a.pts").read_text().startswith("500\n")
    for name, options in (("a.csv", {"delimiter": ",", "skiprows": 1}), ("a.xyz", {})):
        theirs = np.loadtxt(tmp_path / name, **options)
        assert np.array_equal(theirs[:, :3].astype(np.float32), points)
    again.write(tmp_path / "b.bin")
    assert np.array_equal(io.read_scan(tmp_path / "b.bin").points, points)


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("time,class\n1,2\n", 1, "names of columns with x, y and z"),
        ("hello\n", 1, "names of columns with x, y and z"),
        ("x,y,z\nx,y,z\n1,2,3\n", 2, "names of columns"),
        ("1 2\n", 1, "expected 3 numbers, got 2"),
        ("1 2 3\n1 2\n", 2, "expected 3 numbers, got 2"),
        ("x y z\n1 2 3 4\n", 2, "expected 3 numbers, got 4"),
        ("1 2 3\n1 2 three\n", 2, "a column: expected a number, got 'three'"),
        ("1 2 3\n1 2 3e999\n", 2, "expected a number"),
        ("1 2 3\n1 2 -3e4999\n", 2, "expected a number"),
        ("1 2 3\n1 2 1e-400x\n", 2, "expected a number"),
        ("1 2 3\n1 2 +-5\n", 2, "expected a number"),
        ("1 2 3\n1 2 +-inf\n", 2, "expected a number"),
        ("1;2;3\n1;2;1.234,5\n", 2, "expected a number"),
        ("1,5 2,5 3,5\n1 2 1,234,5\n", 2, "expected a number"),
        ("1 2 3\n1 2 3," + "5" * 64 + "\n", 2, "expected a number"),
        ("1,2,3\n4,5 6,7\n", 2, "expected a number"),
        ("5\n6\n7\n", 2, "expected 3 numbers, got 1"),
        ("3\n1 2 3\n4 5 6\n", 3, "as many points as the first line says, got 2"),
        ("x,y,z\n1,5,2,25,-3,75\n", 2, "commas stand between the columns and within the numbers"),
        ("1,5,2,25,-3,75\n1,50,2,05,-3,75\n", 2, "write decimal points, or semicolons"),
        (" ".join(["1"] * 65), 1, "more than 64 numbers"),
        (",".join(["x", "y", "z", *"a" * 62]), 1, "more than 64 columns"),
    ],
)
def test_damaged_text_names_the_line(text: str, line: int, reason: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=reason) as caught:
        read(tmp_path, text)
    assert caught.value.line == line


def test_infinite_coordinates_are_refused(tmp_path: Path) -> None:
    for text in ("inf 0 0\n", "1 2 3\n0 1e300 0\n"):
        with pytest.raises(FormatError, match="expected coordinates that fit a float"):
            read(tmp_path, text)
    with pytest.raises(FormatError, match="intensity of point 1: expected a finite number"):
        read(tmp_path, "1 2 3 4\n1 2 3 1e300\n")


def test_a_scan_in_millimetres_stays_around_its_scanner(tmp_path: Path) -> None:
    around = np.random.default_rng(0).normal(0.0, 30_000.0, (500, 3)).round()
    scan = read(tmp_path, "\n".join(" ".join(f"{v:.0f}" for v in row) for row in around))
    np.testing.assert_array_equal(scan.points, around)
    in_grid = around / 1000.0 + [500_000.0, 5_000_000.0, 100.0]
    scan = read(tmp_path, "\n".join(" ".join(f"{v:.3f}" for v in row) for row in in_grid))
    assert np.abs(scan.points).max() < 1000.0


def test_one_far_return_moves_nothing(tmp_path: Path) -> None:
    frame = read(tmp_path, "1 2 3\n4 5 6\n9000 0 0\n")
    assert frame.points.tolist() == [[1, 2, 3], [4, 5, 6], [9000, 0, 0]]
    map_ = "".join(f"{500000 + k / 8} {5400000 - k / 8} 90\n" for k in range(9)) + "1e10 0 0\n"
    near = read(tmp_path, map_).points[:9]
    np.testing.assert_array_equal(near - near[0], [[k / 8, -k / 8, 0] for k in range(9)])


def test_an_empty_file_has_no_points(tmp_path: Path) -> None:
    for text in ("", "\n", "# nothing\n", "0\n", "x,y,z\n"):
        assert read(tmp_path, text).num_points == 0


def test_whole_numbers_between_commas_are_no_halves(tmp_path: Path) -> None:
    frame = read(tmp_path, "1,2,3,255,128,0\n4,5,6,10,20,30\n")
    assert frame.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert read(tmp_path, "1.5,2,3,007,1,05\n").points.tolist() == [[1.5, 2, 3]]


def test_named_columns_come_in_any_order(tmp_path: Path) -> None:
    frame = read(tmp_path, "time;ring;intensity;z;y;x\n0,5;7;0,25;3,25;-2;1,5\n0,6;8;0;-6;5;4\n")
    assert frame.points.tolist() == EXPECTED
    assert frame.ring is not None
    assert frame.ring.tolist() == [7, 8]
    assert frame.fields["time"].tolist() == [0.5, 0.6]


def test_texts_and_arrays_alone_in_a_folder_are_scans(tmp_path: Path) -> None:
    np.save(tmp_path / "c.npy", np.zeros((20, 4), np.float32))
    np.save(tmp_path / "depth.npy", np.zeros((480, 640), np.float32))
    for name, text in {
        "a.csv": "x;y;z\n1;2;3\n",
        "b.txt": "1.5 2 3 0.5\n",
        "d.pts": "1\n1 2 3 4\n",
        "table.csv": "name,count\na,3\n",
        "times.txt": "0.1\n0.2\n",
        "timestamps.txt": "2011-09-26 13:02:25.964389445\n",
        "calib.txt": "P0: 7.2e+02 0 6.1e+02\n",
        "oxts.txt": " ".join(["1.5"] * 30) + "\n",
    }.items():
        (tmp_path / name).write_text(text)
    assert [path.name for path in readable_scans(tmp_path)] == ["a.csv", "b.txt", "c.npy", "d.pts"]
    np.zeros((9, 4), np.float32).tofile(tmp_path / "e.bin")
    assert [path.name for path in readable_scans(tmp_path)] == ["e.bin"]


def test_texts_of_a_folder_are_not_taken_for_scans(tmp_path: Path) -> None:
    for name in ("a.xyz", "b.pts", "c.asc", "times.txt", "table.csv"):
        (tmp_path / name).write_text("1 2 3\n")
    assert [path.name for path in scan_paths(tmp_path)] == ["a.xyz"]


def test_texts_that_open3d_writes_name_their_columns_by_suffix(tmp_path: Path) -> None:
    frame = read(tmp_path, "1.5 -2 3.25 0 0 1\n4 5 -6 0 1 0\n", "a.xyzn")
    assert list(frame.fields) == ["nx", "ny", "nz"]
    assert frame.intensity is None
    assert kind_of(str(tmp_path / "a.xyzn")) == "scan"
    frame.write(tmp_path / "a.ply")
    assert io.read_scan(tmp_path / "a.ply").fields["nz"].tolist() == [1.0, 0.0]
    colored = read(tmp_path, "1.5 -2 3.25 0 0.2 1\n4 5 -6 1 1 0.4\n", "a.xyzrgb")
    assert colored.points.tolist() == EXPECTED
    colored.write(tmp_path / "b.ply")
    stored = io.read_scan(tmp_path / "b.ply")
    assert stored.fields["green"].tolist() == [51, 255]
    stored.write(tmp_path / "again.xyzrgb")
    assert (tmp_path / "again.xyzrgb").read_text().splitlines()[0] == "1.5 -2 3.25 0 0.2 1"
    io.read_scan(tmp_path / "a.ply").write(tmp_path / "again.xyzn")
    assert (tmp_path / "again.xyzn").read_text().splitlines()[1] == "4 5 -6 0 1 0"
    shining = read(tmp_path, "1.5 -2 3.25 7\n4 5 -6 8\n", "a.xyzi")
    assert shining.intensity is not None
    assert shining.intensity.tolist() == [7.0, 8.0]
    shining.write(tmp_path / "again.xyzn")
    assert (tmp_path / "again.xyzn").read_text().splitlines()[0] == "1.5 -2 3.25"
    assert scan_paths(tmp_path)  # folders are searched by these suffixes, too


@pytest.mark.parametrize(
    ("head", "metres"),
    [
        ("X (mm),Y (mm),Z (mm),Range (mm)", 1e-3),
        ("x[cm],y[cm],z[cm],n", 1e-2),
        ("X (m),Y (m),Z (m),n", 1),
    ],
)
def test_units_of_columns_are_converted_to_metres(head: str, metres: float, tmp_path: Path) -> None:
    """They were read as metres."""
    frame = read(tmp_path, f"{head}\n1500,-2000,3250,7\n4000,5000,-6000,8\n")
    expected = 1000.0 * metres * np.array(EXPECTED)
    np.testing.assert_allclose(frame.points, expected, rtol=1e-6)
    io.write_scan(frame, tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_text().splitlines()[0] == head
    np.testing.assert_allclose(io.read_scan(tmp_path / "again.csv").points, expected, rtol=1e-6)
    io.write_scan(frame, tmp_path / "a.ply")
    np.testing.assert_allclose(io.read_scan(tmp_path / "a.ply").points, expected, rtol=1e-6)


def test_feet_are_named_and_not_converted(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="its coordinates are in feet"):
        frame = read(tmp_path, "X (ft),Y (ft),Z (ft)\n1.5,-2,3.25\n4,5,-6\n")
    assert frame.points.tolist() == EXPECTED
    assert frame.format is not None
    assert frame.format.header["unit"] == "feet"
