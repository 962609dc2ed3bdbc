"""PTX: grids, poses, several scans, what is damaged, and what is written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from manip3d import FormatError, InputError, LidarFrame, authenticate, capture, io
from manip3d.cli import app

HEAD = "2\n3\n10 20 2\n0 1 0\n-1 0 0\n0 0 1\n0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 2 1\n"
"""Two columns of three points; the scanner is turned by 90 degrees."""
POINTS = "1 2 3 0.25\n1 2 4 0.5\n0 0 0 0.5\n2 2 3 0.75\n2 2 4 1\n2 2 5 0\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "a.ptx"
    path.write_text(text)
    return path


def test_a_scan_with_its_grid_and_its_pose(tmp_path: Path) -> None:
    scan = io.read_scan(written(tmp_path, HEAD + POINTS))
    assert scan.points.tolist()[1] == [1.0, 2.0, 4.0]
    assert (scan.num_points, scan.num_empty) == (6, 1)
    assert scan.intensity is not None
    assert scan.intensity.tolist() == [0.25, 0.5, 0.5, 0.75, 1.0, 0.0]
    assert scan.origin == (0.0, 0.0, 0.0)
    assert scan.format is not None
    assert scan.format.header["shape"] == (2, 3)
    pose = scan.format.header["pose"]
    assert (pose @ [1.0, 0.0, 0.0, 1.0]).tolist() == [10.0, 21.0, 2.0, 1.0]


def test_a_byte_order_mark_begins_a_file(tmp_path: Path) -> None:
    plain, marked = (io.read_scan(written(tmp_path, m + HEAD + POINTS)) for m in ("", "\ufeff"))
    assert marked.points.tolist() == plain.points.tolist()
    with pytest.raises(FormatError, match="line 2: expected the number of columns or rows"):
        io.read_scan(written(tmp_path, (HEAD + POINTS).replace("\n", "\n\ufeff", 1)))


def test_points_of_a_map_have_no_known_scanner(tmp_path: Path) -> None:
    """Some programs write points that are moved already, with a matrix that does nothing."""
    matrix = "0 1 0 0\n-1 0 0 0\n0 0 1 0\n10 20 2 1"
    head = HEAD.replace(matrix, "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1")
    assert io.read_scan(written(tmp_path, head + POINTS)).origin is None
    at_zero = head.replace("10 20 2\n", "0 0 0\n")
    assert io.read_scan(written(tmp_path, at_zero + POINTS)).origin == (0.0, 0.0, 0.0)


def test_several_scans_and_colours(tmp_path: Path) -> None:
    colored = "".join(f"{line} {10 * k} 20 30\n" for k, line in enumerate(POINTS.splitlines()))
    path = written(tmp_path, HEAD + POINTS + "\n" + HEAD + colored + "\n\n")
    first, second = io.read_scans(path)
    assert not first.fields
    assert second.fields["red"].tolist() == [0, 10, 20, 30, 40, 50]
    with pytest.raises(InputError, match="expected one scan, got 2"):
        io.read_scan(path)
    again = tmp_path / "b.ptx"
    io.write_scans([first, second], again)
    for one, other in zip((first, second), io.read_scans(again), strict=True):
        np.testing.assert_array_equal(one.points, other.points)
        np.testing.assert_array_equal(one.intensity, other.intensity)
        assert one.fields.keys() == other.fields.keys()
        assert one.format is not None
        assert other.format is not None
        assert one.format.header["shape"] == other.format.header["shape"]
        np.testing.assert_array_equal(one.format.header["pose"], other.format.header["pose"])


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("", None, "the file is empty"),
        ("two\n", 1, "expected the number of columns or rows, got 'two'"),
        ("-2\n3\n", 1, "expected the number of columns"),
        ("2\n", 1, "got the end of the file"),
        ("999999999\n999999999\n", 2, "are more than the file holds"),
        (HEAD.replace("10 20 2\n", "10 20\n", 1) + POINTS, 3, "expected 3 numbers, got '10 20'"),
        (HEAD.replace("10 20 2\n", "10 20 nan\n", 1) + POINTS, 3, "expected 3 numbers"),
        (HEAD.replace("10 20 2 1", "0 0 0 0") + POINTS, 10, "expected a matrix"),
        (HEAD.replace("0 0 1 0", "0 0 0 0") + POINTS, 10, "expected a matrix"),
        (HEAD + POINTS.replace("1 2 4", "1 2 x"), 11, "damaged point from here on"),
        (HEAD + POINTS.replace("1 2 4", "1 2 4 5"), 11, "damaged point from here on"),
        (HEAD + POINTS.replace("2 2 5 0\n", ""), 15, "expected 6 points of 3, 4 or 7 numbers"),
        (HEAD + POINTS.replace(" 0.", " 0. 0."), 11, "damaged point from here on"),
        (HEAD + "".join(f"{line} 0 0 256\n" for line in POINTS.splitlines()), 16, "colours"),
        (HEAD + POINTS.replace("1 2 4", "1 2 nan"), None, "expected coordinates that fit a float"),
        (HEAD + POINTS + "more\n", 17, "expected the number of columns or rows, got 'more'"),
    ],
)
def test_damaged_files_are_told_by_their_lines(
    tmp_path: Path, text: str, line: int | None, reason: str
) -> None:
    with pytest.raises(FormatError, match=reason) as caught:
        io.read_scans(written(tmp_path, text))
    assert caught.value.line == line


def test_a_file_may_not_be_larger_than_it_is_allowed(tmp_path: Path) -> None:
    path = written(tmp_path, HEAD + POINTS)
    size = path.stat().st_size
    assert io.read_scan(path, max_bytes=size).num_points == 6
    with pytest.raises(FormatError, match="at most max_bytes = "):
        io.read_scan(path, max_bytes=size - 1)


def test_other_scans_are_written(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    scan = LidarFrame(
        random.normal(size=(50, 3)).astype(np.float32),
        intensity=random.random(50).astype(np.float32),
        origin=(0.0, 0.0, 0.0),
        fields={"colorRed": np.arange(50, dtype=np.uint8), "colorGreen": np.zeros(50, np.uint8),
                "colorBlue": np.zeros(50, np.uint8)},
    )  # fmt: skip
    path = tmp_path / "a.ptx"
    scan.write(path)
    found = io.read_scan(path)
    np.testing.assert_array_equal(found.points, scan.points)
    np.testing.assert_array_equal(found.intensity, scan.intensity)
    assert found.fields["red"].tolist() == list(range(50))
    scan.replace(origin=(1.0, 2.0, 3.0)).write(path)
    moved = io.read_scan(path)
    assert moved.origin == (0.0, 0.0, 0.0)  # PTX promises points relative to the scanner
    assert moved.format is not None
    assert moved.format.header["pose"][:3, 3].tolist() == [1.0, 2.0, 3.0]
    scan.write(path)
    few = io.read_scan(path).select(np.arange(20))
    few.write(path)  # no grid any more
    assert io.read_scan(path).num_points == 20
    LidarFrame(scan.points).write(path)
    assert path.read_text().splitlines()[-1].endswith(" 0.5")  # Leica's word for none
    assert io.read_scan(path).intensity is None


def test_commands_take_it(tmp_path: Path) -> None:
    path = written(tmp_path, HEAD + POINTS + HEAD + POINTS)
    assert CliRunner().invoke(app, ["info", str(path)]).exit_code == 0
    done = CliRunner().invoke(app, ["convert", str(path), "-o", str(tmp_path / "drive")])
    assert done.exit_code == 0, done.output
    assert len(list((tmp_path / "drive" / "velodyne").iterdir())) == 2
    points = tmp_path / "a.ply"
    io.read_scans(path)[0].write(points)  # PLY does not say where the scanner stood
    done = CliRunner().invoke(app, ["convert", str(points), "-o", str(tmp_path / "b.ptx")])
    assert "warning: where the scanner stood is not known" in done.output
    scan = io.read_scans(path)[0]
    assert authenticate.inspect(scan, power=False).verdict == "undecidable"
    assert capture.scan_address(str(path)) is None


@pytest.mark.parametrize("name", ["b.ptx", "b.e57"])
def test_a_scan_of_3dtk_without_a_pose_is_written(tmp_path: Path, name: str) -> None:
    if name == "b.e57":
        pytest.importorskip("pye57")
    (tmp_path / "a.3d").write_text("-200 300 100\n-500 600 400\n")
    io.read_scan(tmp_path / "a.3d").write(tmp_path / name)
    assert io.read_scan(tmp_path / name).points.tolist() == [[1, 2, 3], [4, 5, 6]]


def test_a_folder_of_scans_loses_no_pose_without_a_word(tmp_path: Path) -> None:
    """Only the first of several poses was told, and not of which scan it is."""
    other = HEAD.replace("10 20 2 1", "-7 3 1 1").replace("10 20 2\n", "-7 3 1\n")
    source = written(tmp_path, 2 * (HEAD + POINTS) + other + POINTS)
    done = CliRunner().invoke(app, ["convert", str(source), "-o", str(tmp_path / "drive")])
    assert done.exit_code == 0, done.output
    told = [line for line in done.stderr.splitlines() if "the scanner stands at" in line]
    assert [line.partition(".bin: ")[0] for line in told] == ["warning: 000000", "warning: 000002"]
    assert "10.000 20.000 2.000" in told[0]
    assert "-7.000 3.000 1.000" in told[1]


def test_poses_are_kept_in_e57(tmp_path: Path) -> None:
    """All scans lay on each other: the poses of other formats were left out."""
    pye57 = pytest.importorskip("pye57")
    other = HEAD.replace("10 20 2 1", "-7 3 1 1").replace("10 20 2\n", "-7 3 1\n")
    scans = io.read_scans(written(tmp_path, HEAD + POINTS + other + POINTS))
    io.write_scans(scans, tmp_path / "a.e57")
    file = pye57.E57(str(tmp_path / "a.e57"))
    for i, scan in enumerate(scans):
        assert scan.format is not None
        pose = scan.format.header["pose"]
        x, y, z = (
            file.read_scan(i, ignore_missing_fields=True)[f"cartesian{axis}"] for axis in "XYZ"
        )
        world = scan.points @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(np.column_stack([x, y, z]), world, atol=1e-5)
        header = io.read_scans(tmp_path / "a.e57")[i].format.header  # type: ignore[union-attr]
        np.testing.assert_allclose(header["pose"], pose, atol=1e-12)
    stretched = written(tmp_path, HEAD.replace("0 0 1 0", "0 0 2 0") + POINTS)
    with pytest.raises(InputError, match="got one that scales"):
        io.write_scans(io.read_scans(stretched), tmp_path / "b.e57")


@pytest.mark.parametrize("suffix", ["ply", "csv", "las", "e57"])
def test_convert_leaves_out_empty_cells_and_names_a_lost_pose(suffix: str, tmp_path: Path) -> None:
    """Cells without a return became points at the scanner, and small poses were lost unsaid."""
    pytest.importorskip({"las": "laspy", "e57": "pye57"}.get(suffix, "numpy"))
    output = tmp_path / f"a.{suffix}"
    done = CliRunner().invoke(
        app, ["convert", str(written(tmp_path, HEAD + POINTS)), "-o", str(output)]
    )
    assert done.exit_code == 0
    assert io.read_scan(output).num_points == 5
    said = " ".join(done.output.split())
    assert "1 cell of the grid without a point left out" in said
    pose = "the scanner stands at 10.000 20.000 2.000, turned by the quaternion (w x y z) 0.707107"
    assert (pose in said) == (suffix != "e57")
