"""``manip3d view`` and ``info`` take everything that manip3d reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from command_line import error_line, manip3d
from manip3d import Intrinsics, LidarFrame, Mesh, RgbdCalibration, RgbdFrame, Skeleton, capture
from manip3d.viewer import png_bytes

CAMERA = Intrinsics(32, 24, 30.0, 30.0, 15.5, 11.5)


@pytest.fixture
def depth(tmp_path: Path) -> Path:
    image = np.full((24, 32), 5000, np.uint16)
    image[0] = 0
    image[1] = 10000
    np.save(tmp_path / "depth.npy", image)
    return tmp_path / "depth.npy"


def walk(folder: Path) -> Path:
    body = Skeleton(np.ones((25, 3), np.float32))
    frames = [
        RgbdFrame(
            np.full((24, 32), 1000 + 100 * n, np.uint16),
            RgbdCalibration(CAMERA),
            skeletons=(body,) if n else (),
            number=n,
            time_ns=n * 50_000_000,
        )
        for n in range(3)
    ]
    capture.record(frames, folder)
    return folder


def test_info_tells_the_distances_of_a_depth_image(depth: Path) -> None:
    done = manip3d("info", depth, "--unit", "tum", "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert record["range"] == [1.0, 2.0]
    assert (record["unit"], record["unit_guessed"]) == ("tum", False)
    assert (record["measured"], record["pixels"]) == (23 * 32, 24 * 32)
    text = manip3d("info", depth, "--unit", "mm").stdout
    assert "32 x 24 pixels, 96% of them measured" in text
    assert "depth 5.00 to 10.00 m, unit mm" in text


def test_info_tells_what_a_recording_holds(tmp_path: Path) -> None:
    folder = walk(tmp_path / "walk")
    record = json.loads(manip3d("info", folder, "--json").stdout)
    assert record["frames"] == 3
    assert record["with"]["skeletons"] == 2
    assert record["range"] == [1.0, 1.2]
    assert record["seconds"] == pytest.approx(0.1)
    assert record["frames_per_second"] == pytest.approx(20.0)
    assert "range   1.000..1.200 m" in manip3d("info", folder).stdout


def test_info_counts_the_rings_of_a_scan(tmp_path: Path) -> None:
    rings = np.arange(12, dtype=np.uint16) // 4
    LidarFrame(np.eye(3)[rings], ring=rings).write(tmp_path / "a.pcd")
    record = json.loads(manip3d("info", tmp_path / "a.pcd", "--json").stdout)
    assert record["scans"][0]["rings"] == 3
    assert record["unit"] == "m"


def test_view_takes_every_kind(bundle: None, tmp_path: Path, depth: Path) -> None:
    LidarFrame(np.eye(3)).write(tmp_path / "scan.bin")
    sources = [(tmp_path / "scan.bin", "3 points"), (depth, "camera assumed"),
               (walk(tmp_path / "walk"), "rgbd, frame 0 of 3")]  # fmt: skip
    for number, (source, said) in enumerate(sources):
        page = tmp_path / f"{number}.html"
        done = manip3d("view", source, "-o", page)
        assert done.returncode == 0, done.stderr
        assert said in done.stderr
        assert f'"title": "{source.name}"' in page.read_text()


def test_several_files_are_shown_side_by_side(bundle: None, tmp_path: Path, depth: Path) -> None:
    LidarFrame(np.eye(3)).write(tmp_path / "scan.bin")
    Mesh(np.eye(3), [[0, 1, 2]]).write(tmp_path / "face.ply")
    page = tmp_path / "both.html"
    done = manip3d("view", tmp_path / "scan.bin", tmp_path / "face.ply", "-o", page)
    assert done.returncode == 0, done.stderr
    assert page.is_file()
    assert '"title": "scan.bin, face.ply"' in page.read_text()
    assert all(f'"label": "{name}"' in page.read_text() for name in ("scan.bin", "face.ply"))
    again = manip3d("view", tmp_path / "scan.bin", depth, "-o", page)
    assert "exists already" in error_line(again)
    folder = tmp_path / "pages"
    assert manip3d("view", tmp_path / "scan.bin", depth, "-o", folder).returncode == 0
    assert sorted(path.name for path in folder.glob("*.html")) == ["depth.html", "scan.html"]


def test_a_file_that_cannot_be_shown_spoils_no_page(bundle: None, tmp_path: Path) -> None:
    Mesh(np.eye(3), [[0, 1, 2]]).write(tmp_path / "face.ply")
    (tmp_path / "bad.ply").write_text("no mesh")
    page = tmp_path / "both.html"
    done = manip3d("view", tmp_path / "face.ply", tmp_path / "bad.ply", "-o", page)
    assert done.returncode == 1
    assert "bad.ply: line 1: expected 'ply'" in done.stderr
    assert not page.exists()


def test_view_takes_a_frame_by_its_number(bundle: None, tmp_path: Path) -> None:
    folder = walk(tmp_path / "walk")
    done = manip3d("view", folder, "--frame", 2, "-o", tmp_path / "a.html")
    assert "frame 2 of 3" in done.stderr
    assert "1 skeleton" in (tmp_path / "a.html").read_text()
    assert "frame: expected at most 2" in error_line(manip3d("view", folder, "--frame", 3))


def test_view_takes_the_camera_of_a_depth_image(bundle: None, tmp_path: Path, depth: Path) -> None:
    done = manip3d("view", depth, "--intrinsics", "30,30,15.5,11.5", "-o", tmp_path / "a.html")
    assert done.returncode == 0, done.stderr
    assert "assumed" not in done.stderr


def test_play_takes_a_folder_in_the_order_of_its_names(bundle: None, tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for frame in (1, 0):
        Mesh(np.eye(3), [[0, 1, 2]]).write(tmp_path / f"frames/{frame}.glb")
    page = tmp_path / "film.html"
    done = manip3d("play", tmp_path / "frames", "-o", page, "--rate", 25)
    assert done.returncode == 0, done.stderr
    assert "2 frames" in done.stderr
    text = page.read_text()
    assert text.index("0.glb") < text.index("1.glb")
    assert '"film": {"rate": 25.0}' in text
    assert "--force" in error_line(manip3d("play", tmp_path / "frames", "-o", page))
    assert "expected a name" in error_line(manip3d("play", tmp_path / "frames", "-o", "a.png"))


def test_play_says_what_is_no_mesh(bundle: None, tmp_path: Path, depth: Path) -> None:
    assert "depth" in error_line(manip3d("play", depth, "-o", tmp_path / "a.html"))
    (tmp_path / "none").mkdir()
    assert "none" in error_line(manip3d("play", tmp_path / "none", "-o", tmp_path / "a.html"))


def test_without_a_display_view_says_where_the_page_is(bundle: None, depth: Path) -> None:
    done = manip3d("view", depth, DISPLAY="", WAYLAND_DISPLAY="", BROWSER="")
    assert done.returncode == 0, done.stderr
    page = Path(done.stdout.strip())
    assert "There is no display here" in done.stderr
    assert page.read_text().startswith("<!DOCTYPE html>")
    page.unlink()


def test_other_outputs_are_refused_before_anything_is_read(tmp_path: Path) -> None:
    done = manip3d("view", tmp_path / "not there.bin", "-o", tmp_path / "a.pdf")
    assert ".html" in error_line(done)
    assert ".png" in error_line(done)


@pytest.mark.parametrize(
    ("option", "value", "kind"),
    [
        ("--unit", "mm", "a depth image"),
        ("--intrinsics", "kinect-v2", "a depth image or a recording"),
        ("--color", "a.png", "a depth image"),
        ("--calibration", "db.xml", "a scan"),
        ("--color-by", "height", "a scan or a depth image or a recording"),
    ],
)
def test_view_refuses_what_a_mesh_has_not(
    tmp_path: Path, option: str, value: str, kind: str
) -> None:
    mesh = tmp_path / "a.ply"
    Mesh(np.eye(3), [[0, 1, 2]]).write(mesh)
    told = f"{option}: can only be given with {kind}, got "
    done = manip3d("view", mesh, option, value, "-o", tmp_path / "a.html")
    assert told in error_line(done)
    assert not (tmp_path / "a.html").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [("--unit", "foo"), ("--intrinsics", "kinect-v2"), ("--calibration", "db.xml")],
)
def test_info_and_view_refuse_what_has_no_effect(tmp_path: Path, option: str, value: str) -> None:
    """A recording, an address and several files are told apart as a single file is."""
    mesh, scan, folder = tmp_path / "a.ply", tmp_path / "s.pcd", walk(tmp_path / "walk")
    Mesh(np.eye(3), [[0, 1, 2]]).write(mesh)
    LidarFrame(np.eye(3, dtype=np.float32)).write(scan)
    recordings = () if option == "--intrinsics" else (folder, f"folder:{folder}")
    scans = () if option == "--calibration" else (scan,)
    page = tmp_path / "pages"
    for sources in ((mesh,), (mesh, mesh), *((each,) for each in (*recordings, *scans))):
        for words in (("info",), ("view", "-o", page if len(sources) > 1 else tmp_path / "a.html")):
            done = manip3d(*words, *sources, option, value)
            assert done.returncode == 1, (words, sources)
            assert f"{option}: can only be given with a" in error_line(done)
    assert not page.exists()


@pytest.mark.parametrize("option", ["--intrinsics", "--color", "--unit"])
def test_options_of_an_image_do_not_matter_to_the_scan_beside_it(
    bundle: None, tmp_path: Path, depth: Path, option: str
) -> None:
    LidarFrame(np.eye(3, dtype=np.float32)).write(tmp_path / "s.pcd")
    (tmp_path / "color.png").write_bytes(png_bytes(np.zeros((24, 32, 3), np.uint8)))
    value = {"--intrinsics": "30,30,15.5,11.5", "--color": tmp_path / "color.png", "--unit": "mm"}
    both = (depth, tmp_path / "s.pcd", "-o", tmp_path / "a.html")
    done = manip3d("view", *both, option, value[option])
    assert done.returncode == 0, done.stderr
    refused = manip3d("view", depth, "--frame", 1, "-o", tmp_path / "b.html")
    assert "--frame: expected none for a depth image, got 1" in error_line(refused)


def test_options_that_apply_to_one_of_several_files_are_taken(tmp_path: Path, depth: Path) -> None:
    Mesh(np.eye(3), [[0, 1, 2]]).write(tmp_path / "a.ply")
    done = manip3d("info", tmp_path / "a.ply", depth, "--unit", "tum", "--json")
    assert done.returncode == 0, done.stderr
    assert '"unit": "tum"' in done.stdout
