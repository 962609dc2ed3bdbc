"""Position of the scanner: every format keeps it, or `convert` warns that it is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from manip3d import LidarFrame, io
from manip3d.authenticate import inspect
from manip3d.cli import app
from manip3d.lidar import map_shift

PLACE = np.array([6.0, -4.0, 1.5])
MAP = np.array([458_000.0, 5_429_000.0, 98.0])
STATING = (".pcd", ".e57", ".ptx")
"""Suffixes of formats that hold the scanner's position."""
AT_ORIGIN = (".bin", ".pcd.bin", ".3d")
"""Suffixes of formats with the scanner at the origin of coordinates of single precision."""
OTHERS = tuple(set(io.SCAN_SUFFIXES) - {*STATING, *AT_ORIGIN})
EXPECTED: dict[str, dict[str, tuple[str, ...]]] = {
    "beside": {"kept": STATING, "lost": (*AT_ORIGIN, *OTHERS)},
    "unknown": {"doubtful": (*AT_ORIGIN, ".pcd", ".ptx"), "unknown": (".e57", *OTHERS)},
    "on a map": {"kept": STATING, "lost": (*AT_ORIGIN, *OTHERS)},
    "unknown on a map": {
        "doubtful": (*AT_ORIGIN, ".ptx"), "unknown": (".pcd", ".e57", *OTHERS)
    },
}  # fmt: skip
"""Fate of the position in each format, by what the source states: ``kept`` in the file; ``lost``,
which a warning says; ``doubtful``, because a reader takes the origin for it, which a warning says,
too; or still ``unknown``."""


def write_pcd(path: Path, points: NDArray[np.float64], viewpoint: NDArray[np.float64]) -> Path:
    """Write a PCD file with a viewpoint and coordinates of 64 bits."""
    place = " ".join(f"{value:g}" for value in viewpoint)
    size = len(points)
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {size}\nHEIGHT 1\nVIEWPOINT {place} 0 1 0 0\nPOINTS {size}\nDATA ascii\n"
    )
    rows = "".join(f"{x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in points)
    path.write_text(f"# .PCD v0.7\n{head}{rows}")
    return path


def room(middle: NDArray[np.float64]) -> NDArray[np.float64]:
    return (middle + np.random.default_rng(0).uniform(-20.0, 20.0, (300, 3))).round(3)


def in_file(frame: LidarFrame, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of a frame in the coordinates that all scans of its file share."""
    assert frame.format is not None
    pose = frame.format.header.get("pose")
    shifted = points + map_shift(frame)
    return shifted if pose is None else shifted @ pose[:3, :3].T + pose[:3, 3]


def coordinates(frame: LidarFrame) -> NDArray[np.float64]:
    return in_file(frame, frame.points.astype(np.float64))


@pytest.mark.parametrize("suffix", io.SCAN_SUFFIXES)
@pytest.mark.parametrize("known", EXPECTED)
def test_the_position_is_kept_or_its_loss_is_told(tmp_path: Path, suffix: str, known: str) -> None:
    for package in {".las": ["laspy"], ".laz": ["lazrs"], ".e57": ["pye57"]}.get(suffix, []):
        pytest.importorskip(package)
    (fate,) = [fate for fate, suffixes in EXPECTED[known].items() if suffix in suffixes]
    on_map = known.endswith("on a map")
    middle = MAP if on_map else PLACE
    source = tmp_path / ("a.csv" if known.startswith("unknown") else "a.pcd")
    if source.suffix == ".csv":
        np.savetxt(source, room(middle), "%.3f", delimiter=",", header="x,y,z", comments="")
    else:
        write_pcd(source, room(middle), middle)
    output = tmp_path / f"b{suffix}"
    done = CliRunner().invoke(app, ["convert", str(source), "-o", str(output)])
    assert done.exit_code == 0, done.output
    again = io.read_scan(output)
    is_shifted = on_map and suffix in AT_ORIGIN
    assert ("coordinates are written near 0" in done.output) == is_shifted
    assert (np.abs(coordinates(again) - room(middle)).max() < 1e-4) == (not is_shifted)
    assert ("the scanner stands at " in done.output) == (fate == "lost")
    assert (f"which {suffix} does not hold" in done.output) == (fate == "lost")
    assert ("where the scanner stood is not known" in done.output) == (fate == "doubtful")
    if fate == "kept":
        assert again.origin is not None
        assert in_file(again, np.array(again.origin)) == pytest.approx(middle, abs=1e-9)
    elif fate == "unknown":
        assert again.origin is None


@pytest.mark.parametrize("suffix", [".e57", ".ptx"])
def test_ranges_are_those_from_the_scanner(tmp_path: Path, suffix: str) -> None:
    """A detector that trusts the stated position must see the scan as it was taken."""
    if suffix == ".e57":
        pytest.importorskip("pye57")
    frame = io.read_scan(write_pcd(tmp_path / "a.pcd", room(PLACE), PLACE))
    frame.write(tmp_path / f"b{suffix}")
    again = io.read_scan(tmp_path / f"b{suffix}")
    assert again.origin == (0.0, 0.0, 0.0)
    expected = np.linalg.norm(room(PLACE) - PLACE, axis=1)
    assert np.linalg.norm(again.points, axis=1) == pytest.approx(expected, abs=1e-5)
    assert inspect(again).origin_from == "file"


def test_another_reader_of_e57_finds_the_same_points(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    write_pcd(tmp_path / "known.pcd", room(MAP), MAP)
    np.save(tmp_path / "unknown.npy", room(MAP))
    for source in ("known.pcd", "unknown.npy"):
        path = tmp_path / "a.e57"
        io.read_scan(tmp_path / source).write(path)
        file = pye57.E57(str(path))
        found = file.read_scan(0, ignore_missing_fields=True)
        stands = file.get_header(0).translation
        file.close()
        theirs = np.column_stack([found[f"cartesian{axis}"] for axis in "XYZ"])
        assert np.abs(theirs - room(MAP)).max() < 1e-5
        assert (np.abs(stands - MAP).max() < 1e-9) == (source == "known.pcd")


def test_a_map_survives_e57(tmp_path: Path) -> None:
    """The pose of an E57 without a known scanner is no position, and LAS needs its coordinates."""
    pytest.importorskip("laspy")
    pytest.importorskip("pye57")
    np.save(tmp_path / "a.npy", room(MAP))
    io.read_scan(tmp_path / "a.npy").write(tmp_path / "a.las")
    for source, output in (("a.las", "b.e57"), ("b.e57", "c.e57"), ("c.e57", "d.las")):
        done = CliRunner().invoke(
            app, ["convert", str(tmp_path / source), "-o", str(tmp_path / output)]
        )
        assert done.exit_code == 0, done.output
        assert "the scanner stands" not in done.output
    again = io.read_scan(tmp_path / "d.las")
    assert again.origin is None
    assert again.exact is not None
    assert np.abs(again.exact - room(MAP)).max() < 1e-6


def test_a_new_position_is_written_to_the_scans_own_format(tmp_path: Path) -> None:
    pcd = write_pcd(tmp_path / "a.pcd", room(PLACE), PLACE)
    io.read_scan(pcd).write(tmp_path / "b.pcd")
    assert "VIEWPOINT 6 -4 1.5 0 1 0 0" in (tmp_path / "b.pcd").read_text()  # as it was told
    io.read_scan(pcd, origin=(1, 2, 3)).write(tmp_path / "b.pcd")
    assert "VIEWPOINT 1.0 2.0 3.0 0 1 0 0" in (tmp_path / "b.pcd").read_text()
    io.read_scan(pcd).write(tmp_path / "a.ptx")
    io.read_scan(tmp_path / "a.ptx", origin=(1, 2, 3)).write(tmp_path / "b.ptx")
    again = io.read_scan(tmp_path / "b.ptx")
    assert again.origin == (0.0, 0.0, 0.0)
    assert in_file(again, np.zeros(3)) == pytest.approx(PLACE + np.array([1.0, 2.0, 3.0]))
    assert np.abs(coordinates(again) - room(PLACE)).max() < 1e-5


@pytest.mark.parametrize("suffix", [".e57", ".ptx"])
def test_points_that_were_not_measured_stay_where_they_are(tmp_path: Path, suffix: str) -> None:
    if suffix == ".e57":
        pytest.importorskip("pye57")
    points = room(PLACE).astype(np.float32)
    points[7] = 0.0
    LidarFrame(points, origin=tuple(PLACE)).write(tmp_path / f"a{suffix}")
    again = io.read_scan(tmp_path / f"a{suffix}")
    assert again.num_empty == 1
    assert np.flatnonzero(~again.points.any(axis=1)).tolist() == [7]
