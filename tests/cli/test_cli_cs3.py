"""``manip3d cs3`` as a user meets it."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from command_line import error_line, manip3d
from manip3d import read_mesh, simplify
from manip3d.camera import read_intrinsics
from manip3d.simulate import depth as simulated

Image = pytest.importorskip("PIL.Image")
FOCAL = "131.25,131.25,79.5,59.5"


@pytest.fixture(scope="module")
def scene() -> simulated.DepthScene:
    return simulated.person(width=160, height=120)


@pytest.fixture
def frame(scene: simulated.DepthScene, tmp_path: Path) -> Path:
    path = tmp_path / "depth.png"
    Image.fromarray(scene.capture(rng=1).depth).save(path)
    return path


def _one_pixel(depth: np.ndarray) -> np.ndarray:
    alone = np.zeros_like(depth)
    alone[5, 7] = 2000
    return alone


def _every_second_row(depth: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(depth))[:, None] % 2 == 1, depth, 0)


@pytest.mark.parametrize(
    ("make", "method", "reason"),
    [
        (lambda depth: 0 * depth, "relief", "no measured pixel"),
        (lambda depth: 0 * depth, "cs3", "no measured pixel"),
        (lambda depth: 0 * depth, "poisson", "no measured pixel"),
        (_one_pixel, "relief", "found 1 measured pixel, of which no three meet"),
        (_one_pixel, "cs3", "found 1 measured pixel, but no face"),
        (_every_second_row, "relief", "576 measured pixels, of which no three meet"),
        (_every_second_row, "relief", "most measured pixels stand alone"),
        (_every_second_row, "cs3", "most measured pixels stand alone"),
    ],
)
def test_an_image_without_a_surface_writes_nothing_and_says_why(
    make: Callable[[np.ndarray], np.ndarray], method: str, reason: str, tmp_path: Path
) -> None:
    Image.fromarray(make(np.full((24, 48), 2000, np.uint16))).save(tmp_path / "depth.png")
    output = tmp_path / "out.glb"
    options = ("--points", "100", "--intrinsics", "40,40,23.5,11.5", "--method", method)
    done = manip3d("depth", tmp_path / "depth.png", "-o", output, "--unit", "mm", *options)
    assert done.returncode == 1
    assert reason in error_line(done)
    assert ("stand alone" in error_line(done)) == (make is _every_second_row)
    assert not output.exists()


def test_a_recording_without_a_camera_takes_the_one_that_is_given(
    frame: Path, tmp_path: Path
) -> None:
    recording = tmp_path / "sequence"
    images = recording / "depth"
    images.mkdir(parents=True)
    frame.rename(images / "1311868164.5.png")
    order = ("depth", recording, "-o", tmp_path / "out", "--points", "100")
    done = manip3d(*order)
    assert done.returncode == 1
    told = "is an RGB-D recording that states no camera; --intrinsics states it for the images in "
    assert error_line(done).endswith(f"{told}{images}")
    done = manip3d(*order, "--intrinsics", FOCAL)
    assert done.returncode == 0, done.stderr
    (made,) = (tmp_path / "out").glob("*.glb")
    done = manip3d(
        "depth", images, "-o", tmp_path / "alone", "--points", "100", "--intrinsics", FOCAL
    )
    assert done.returncode == 0
    alone = read_mesh(tmp_path / "alone" / "1311868164.5.glb")
    assert np.array_equal(read_mesh(made).vertices, alone.vertices)
    assert np.array_equal(read_mesh(made).faces, alone.faces)


@pytest.mark.parametrize("name", ["intrinsic/intrinsic_depth.txt", "camera_intrinsic.json"])
def test_cameras_of_folders_of_other_tools(frame: Path, tmp_path: Path, name: str) -> None:
    recording = tmp_path / "sequence"
    (recording / "depth").mkdir(parents=True)
    frame.rename(recording / "depth" / "0.png")
    fx, fy, cx, cy = (float(number) for number in FOCAL.split(","))
    with Image.open(recording / "depth" / "0.png") as image:
        width, height = image.size
    place = recording / name
    place.parent.mkdir(exist_ok=True)
    if name.endswith(".txt"):
        place.write_text(f"{fx} 0 {cx} 0\n0 {fy} {cy} 0\n0 0 1 0\n0 0 0 1\n")
    else:
        columns = [fx, 0, 0, 0, fy, 0, cx, cy, 1]
        camera = {"width": width, "height": height, "intrinsic_matrix": columns}
        place.write_text(json.dumps(camera))
    told = json.loads(manip3d("capture", "info", recording, "--json").stdout)["depth"]
    assert [told[key] for key in ("fx", "fy", "cx", "cy")] == [fx, fy, cx, cy]
    assert manip3d("inspect", recording).returncode in (0, 3, 4)
    order = ("depth", recording, "--points", "100")
    done = manip3d(*order, "-o", tmp_path / "own")
    assert done.returncode == 0, done.stderr
    manip3d(*order, "-o", tmp_path / "given", "--intrinsics", FOCAL)
    (own,), (given,) = ((tmp_path / n).glob("*.glb") for n in ("own", "given"))
    assert np.array_equal(read_mesh(own).vertices, read_mesh(given).vertices)
    place.write_text("{")
    assert name in error_line(manip3d(*order, "-o", tmp_path / "own", "--force"))


def _folder_of_images(folder: Path, units_per_metre: int) -> Path:
    """Write three depth images of a curved wall 1.5 to 2.5 m away, and no camera."""
    (folder / "depth").mkdir(parents=True)
    v, u = np.mgrid[:48, :64]
    for number in range(3):
        metres = 2.0 + 0.3 * np.sin(u / 9) + 0.2 * np.cos(v / 7 + number)
        stored = np.round(metres * units_per_metre).astype(np.uint16)
        Image.fromarray(stored).save(folder / "depth" / f"{number}.png")
    return folder


_CAMERA = "60,60,31.5,23.5"
_CAMERA_OF_OPEN3D = '{"width": 64, "height": 48, "intrinsic_matrix": [60,0,0,0,60,0,31.5,23.5,1]}'


@pytest.mark.parametrize("has_camera", [False, True])
@pytest.mark.parametrize(
    ("stored", "unit", "told"),
    [
        (5000, (), "unit tum (1/5000 m: TUM RGB-D, ICL-NUIM), guessed; --unit overrides it\n"),
        (5000, ("--unit", "5000"), "unit tum (1/5000 m: TUM RGB-D, ICL-NUIM)\n"),
        (1000, (), "unit mm (1/1000 m: Kinect V2, Azure Kinect, RealSense and most others), "),
        (4000, ("--unit", "4000"), "unit 4000 (1/4000 m)\n"),
    ],
)
def test_a_folder_of_images_has_the_unit_of_its_images(
    stored: int, unit: tuple[str, ...], told: str, has_camera: bool, tmp_path: Path
) -> None:
    """It was taken to be in millimetres: TUM's images became meshes five times too far."""
    folder = _folder_of_images(tmp_path / "sequence", stored)
    if has_camera:
        (folder / "camera_intrinsic.json").write_text(_CAMERA_OF_OPEN3D)
    camera = () if has_camera else ("--intrinsics", _CAMERA)
    order = ("depth", folder, "--points", "99", "-o", tmp_path / "out")
    done = manip3d(*order, *camera, *unit, "--json")
    assert done.returncode == 0, done.stderr
    assert f"read 3 depth images, depth 1.50 to 2.50 m, {told}" in done.stderr
    record = json.loads(done.stdout)
    assert record["unit"] == {5000: "tum", 1000: "mm", 4000: "4000"}[stored]
    assert record["unit_guessed"] == (not unit)
    away = -read_mesh(tmp_path / "out" / "000000.glb").vertices[:, 2]
    assert 1.5 < away.min() < away.max() < 2.51


def test_options_for_images_alone_name_their_folder(tmp_path: Path) -> None:
    folder = _folder_of_images(tmp_path / "sequence", 5000)
    order = ("depth", folder, "--points", "99", "-o", tmp_path / "out", "--intrinsics", _CAMERA)
    for option, value in (("--mask", folder), ("--color", folder), ("--to", ".ply")):
        told = f"{option}: cannot be given with an RGB-D recording; {folder / 'depth'}, its depth "
        assert told in error_line(manip3d(*order, option, value))
    told = f"got sun; {folder / 'depth'}, its depth images alone, may have it"
    assert told in error_line(manip3d(*order, "--unit", "sun"))
    address = f"folder:{folder}"  # without a camera
    done = manip3d("depth", address, "--points", "99", "-o", tmp_path / "out")
    assert "expected the camera of its images (--intrinsics, or " in error_line(done)
    for image in (folder / "depth").iterdir():  # depths of 8 bits are read in millimetres
        Image.fromarray(np.full((48, 64), 200, np.uint8)).save(image)
    assert manip3d(*order).returncode == 0


def test_views_of_a_folder_have_its_camera(tmp_path: Path) -> None:
    folder = _folder_of_images(tmp_path / "sequence", 5000)
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n" * 3)
    order = ("depth", folder, "--points", "99", "--poses", tmp_path / "poses.txt", "-o")
    assert "--intrinsics: expected the camera" in error_line(manip3d(*order, tmp_path / "a.ply"))
    given = manip3d(*order, tmp_path / "given.ply", "--intrinsics", _CAMERA)
    assert given.returncode == 0, given.stderr
    (folder / "camera_intrinsic.json").write_text(_CAMERA_OF_OPEN3D)
    own = manip3d(*order, tmp_path / "own.ply")
    assert own.returncode == 0, own.stderr
    assert (tmp_path / "own.ply").read_bytes() == (tmp_path / "given.ply").read_bytes()


@pytest.mark.parametrize(
    ("given", "named"),
    [(("--method", "relief", "--max-edge", "0.01"), "--max-edge"),
     (("--method", "cs3"), "--depth-step")],
)  # fmt: skip
def test_errors_of_files_name_the_options(
    given: tuple[str, ...], named: str, tmp_path: Path
) -> None:
    """Python's names of the arguments are not what the user typed."""
    depth = np.zeros((24, 48), np.uint16)
    depth[10, 10:12], depth[11, 10:12] = (500, 4000), (4000, 500)
    Image.fromarray(depth).save(tmp_path / "depth.png")
    files = (tmp_path / "depth.png", "-o", tmp_path / "out.glb", "--unit", "mm")
    options = ("--points", "100", "--intrinsics", "40,40,23.5,11.5")
    done = manip3d("depth", *files, *options, *given)
    assert done.returncode == 1
    assert named in done.stderr
    assert "depth_step" not in done.stderr
    assert "max_edge" not in done.stderr


def test_pixels_without_a_line_of_sight_are_told_and_count_as_not_covered(tmp_path: Path) -> None:
    np.save(tmp_path / "wide.npy", np.full((120, 160), 2.0, np.float32))
    (tmp_path / "wide.json").write_text(
        '{"fx": 62.5, "fy": 62.5, "cx": 80, "cy": 60, "k1": -0.31, "k2": 0.1, "k3": -0.012}'
    )
    done = manip3d("depth", tmp_path / "wide.npy", "--intrinsics", tmp_path / "wide.json",
                   "--points", "300", "-o", tmp_path / "a.ply", "--strict", "--json")  # fmt: skip
    assert done.returncode == 4
    record = json.loads(done.stdout)
    assert record["points_before"] == 120 * 160
    assert record["without_ray"] > 1920
    assert record["outside"] == pytest.approx(record["without_ray"] / (120 * 160), abs=1e-3)
    assert record["coverage_missed"]
    assert "pixels have no line of sight (the lens model cannot be inverted there)" in done.stderr


def test_a_centre_outside_of_the_image_is_doubted(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((48, 64), 2000, np.uint16))
    for camera, is_doubted in (("60,60,31.5,23.5", False), ("60,60,31.5,480", True)):
        done = manip3d("depth", tmp_path / "a.npy", "--intrinsics", camera, "--points", "99",
                       "-o", tmp_path / "a.ply", "--force")  # fmt: skip
        assert done.returncode == 0
        assert ("(31.5, 480) lies outside of the image of 64 x 48" in done.stderr) == is_doubted


@pytest.mark.parametrize("more", [(), ("--stable",)])
def test_a_centre_outside_of_the_images_of_a_folder_is_doubted(
    more: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "d").mkdir()
    for number in range(2):
        np.save(tmp_path / "d" / f"{number}.npy", np.full((48, 64), 2000, np.uint16))
    done = manip3d("depth", tmp_path / "d", "-o", tmp_path / "o", "--points", "60", "--json",
                   "--intrinsics", "60,60,31.5,480", *more)  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = "the camera's centre (31.5, 480) lies outside of the image of 64 x 48 pixels"
    assert f"warning for 2 of them: {told}" in done.stderr
    assert all(row["unit_doubt"].startswith(told) for row in json.loads(done.stdout))


@pytest.mark.parametrize("depth_step", ["0", "0.05"])
def test_an_image_of_lone_pixels_is_said_to_be_one(depth_step: str, tmp_path: Path) -> None:
    depth = np.zeros((24, 48), np.uint16)
    depth[::4, ::3] = 2000
    depth[9:11, 10:12] = 2000  # four of 100 pixels that make a surface
    Image.fromarray(depth).save(tmp_path / "depth.png")
    given = (tmp_path / "depth.png", "-o", tmp_path / "out.glb", "--unit", "mm", "--json")
    options = ("--points", "100", "--intrinsics", "40,40,23.5,11.5", "--depth-step", depth_step)
    done = manip3d("depth", *given, *options, "--strict")
    assert done.returncode == 4
    assert "most measured pixels stand alone" in done.stderr
    assert "simplify.grid_delaunay" in done.stderr
    record = json.loads(done.stdout)
    assert record["lone_pixels"] == record["points_before"] - 4
    depth[:] = 2000
    Image.fromarray(depth).save(tmp_path / "depth.png")
    done = manip3d("depth", *given, *options, "--force")
    assert done.returncode == 0
    assert "alone" not in done.stderr
    assert json.loads(done.stdout)["lone_pixels"] == 0


@pytest.fixture
def frames(scene: simulated.DepthScene, tmp_path: Path) -> Path:
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, capture in enumerate(scene.frames(4, rng=2)):
        Image.fromarray(capture.depth).save(folder / f"{number:03}.depth.png")
    return folder


def test_a_depth_image_becomes_an_upright_mesh(frame: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.glb"
    arguments = ("cs3", frame, "-o", output, "--points", "200", "--intrinsics", FOCAL)
    done = manip3d(*arguments)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    assert "points -> " in done.stderr
    mesh = read_mesh(output)
    assert 150 <= mesh.num_vertices <= 200  # noisy pixels are left with no face
    assert mesh.texcoords is not None
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert high[1] - low[1] > 1.5  # a person, metres
    assert high[1] > 0.6  # the head is up
    assert high[2] < -1.8  # in front of a camera that looks along -z, as glTF's do
    assert "--force" in error_line(manip3d(*arguments, "-q"))


def test_other_formats_keep_the_camera_s_axes(frame: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.ply"
    done = manip3d("cs3", frame, "-o", output, "--points", "200", "--intrinsics", FOCAL, "--json")
    record = json.loads(done.stdout)
    assert record["points"] <= record["target_points"] == 200
    assert record["reached"] == "factor"
    assert record["literal_count"] > 0
    mesh = read_mesh(output)
    assert mesh.vertices[:, 2].min() > 1.8
    assert mesh.vertices[:, 1].min() < -0.6


@pytest.mark.parametrize("method", ["cs3", "relief", "uniform", "poisson", "ssa"])
def test_every_method_has_a_name(method: str, frame: Path, tmp_path: Path) -> None:
    output = tmp_path / f"{method}.glb"
    done = manip3d("cs3", frame, "-o", output, "--points", "300", "--intrinsics", FOCAL,
                   "--method", method, "--depth-step", "0", "--json")  # fmt: skip
    record = json.loads(done.stdout)
    assert record["method"] == method
    assert 250 <= record["points"] <= 300
    assert read_mesh(output).num_faces == record["faces"] > 100


def test_an_effort_of_relief(frame: Path, tmp_path: Path) -> None:
    base = ("depth", frame, "--points", "300", "--intrinsics", FOCAL, "--depth-step", "0")
    depth = np.asarray(Image.open(frame)).astype(np.uint16)
    camera = read_intrinsics(FOCAL, width=depth.shape[1], height=depth.shape[0])
    for effort in get_args(simplify.Effort):
        output = tmp_path / f"{effort}.ply"
        done = manip3d(*base, "-o", output, "--effort", effort, "--json")
        assert json.loads(done.stdout)["effort"] == effort
        alone = simplify.relief(depth, camera, 300, effort=effort)
        np.testing.assert_array_equal(read_mesh(output).faces, alone.faces)
    assert "relief (best): " in done.stderr
    assert "--effort" in error_line(manip3d(*base, "-o", tmp_path / "x.glb", "-q",
                                            "--method", "cs3", "--effort", "live"))  # fmt: skip


def test_options_of_another_method_are_refused(frame: Path, tmp_path: Path) -> None:
    base = ("cs3", frame, "-o", tmp_path / "x.glb", "--points", "99", "--intrinsics", FOCAL, "-q")
    assert "--variant" in error_line(manip3d(*base, "--method", "ssa", "--variant", "lios"))
    assert "--move-points" in error_line(manip3d(*base, "--move-points"))
    assert manip3d(*base, "--variant", "fastest").returncode == 2
    assert manip3d("cs3", frame, "-o", tmp_path / "x.glb").returncode == 2  # no --points


def test_variants_and_distance_make_other_meshes(frame: Path, tmp_path: Path) -> None:
    base = ("cs3", frame, "--points", "300", "--intrinsics", FOCAL, "-q")
    meshes = {}
    for name, options in {
        "cios": (), "lios": ("--variant", "lios"), "near": ("--by-distance",),
    }.items():  # fmt: skip
        output = tmp_path / f"{name}.ply"
        assert manip3d(*base, "-o", output, *options).returncode == 0
        meshes[name] = output.read_bytes()
    assert len(set(meshes.values())) == 3


def test_cameras_come_from_files_and_presets(
    frame: Path, scene: simulated.DepthScene, tmp_path: Path
) -> None:
    camera = tmp_path / "camera.json"
    matrix = [131.25, 0, 0, 0, 131.25, 0, 79.5, 59.5, 1]
    camera.write_text(json.dumps({"width": 160, "height": 120, "intrinsic_matrix": matrix}))
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"fx": 131.25, "fy": 131.25, "cx": 79.5, "cy": 59.5}))
    outputs = []
    for number, source in enumerate((FOCAL, camera, other, "primesense")):
        outputs.append(tmp_path / f"{number}.ply")
        done = manip3d("cs3", frame, "-o", outputs[-1], "--points", "150",
                       "--intrinsics", source, "-q")  # fmt: skip
        assert done.returncode == 0, done.stderr
    contents = {path.read_bytes() for path in outputs}
    assert len(contents) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "expected an object with fx"),
        ("[1, 2]", "no object"),
        ('{"fx": 1}', "expected an object with fx"),
        ('{"intrinsic_matrix": [1, 2]}', "of 2 numbers"),
        ('{"fx": 1, "fy": 1, "cx": 0, "cy": 0, "coeffs": [0, 1e-3, 0, 0, 0]}', "coeffs without"),
        ('{"fl_x": 1, "fl_y": 1, "cx": 0, "cy": 0, "camera_model": "OPENCV_FISHEYE"}', "fisheye"),
        ('{"fx": -1, "fy": 1, "cx": 0, "cy": 0}', "fx"),
        ("[" * 100_000, "expected an object"),
        (" " * (1 << 20) + "{}", "more than a mebibyte"),
    ],
)
def test_bad_camera_files_are_one_line(
    content: str, message: str, frame: Path, tmp_path: Path
) -> None:
    from manip3d import FormatError
    from manip3d.camera import read_intrinsics

    path = tmp_path / "camera.json"
    path.write_text(content)
    with pytest.raises(FormatError, match=message) as caught:
        read_intrinsics(path, width=160, height=120)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("name", ["npy", "npz"])
@pytest.mark.parametrize("more", [(), ("--stable",)])
def test_folders_of_clouds_in_arrays_need_no_camera(
    name: str, more: tuple[str, ...], tmp_path: Path
) -> None:
    v, u = np.mgrid[:48, :64]
    cloud = np.stack([(u - 31.5) / 60, (v - 23.5) / 60, 1 + 0 * u], axis=-1).astype(np.float32)
    (tmp_path / "in").mkdir()
    for number in range(2):
        if name == "npy":
            np.save(tmp_path / "in" / f"{number}.npy", (2 + number / 100) * cloud)
        else:
            np.savez(tmp_path / "in" / f"{number}.npz", points=(2 + number / 100) * cloud)
    done = manip3d("depth", tmp_path / "in", "-o", tmp_path / "o", "--points", "60", *more)
    assert done.returncode == 0, done.stderr
    for number in range(2):
        mesh = read_mesh(tmp_path / "o" / f"{number}.glb")
        np.testing.assert_allclose(mesh.vertices[:, 2], -2, atol=0.02)


def test_a_folder_without_a_camera_is_told_once(frame: Path, tmp_path: Path) -> None:
    folder = tmp_path / "rgbd" / "depth"
    folder.mkdir(parents=True)
    for i in range(3):
        shutil.copy(frame, folder / f"{i}{frame.suffix}")
    (folder.parent / "camera.yaml").touch()
    done = manip3d("depth", folder, "-o", tmp_path / "out", "--points", "99")
    assert f"got none; {folder.parent}/camera.yaml may be it" in error_line(done)
    assert not (tmp_path / "out").exists()


def test_a_folder_says_what_its_meshes_cover_and_that_a_camera_has_one_size(
    frame: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "depth"
    folder.mkdir()
    shutil.copy(frame, folder / "1.png")
    with Image.open(frame) as image:
        image.crop((0, 0, 120, 90)).save(folder / "2.png")
    base = ("depth", folder, "-o", tmp_path / "out", "--intrinsics", "131.25,131.25,70,50")
    done = manip3d(*base, "--points", "60", "--min-coverage", "0.9999", "--strict", "--json")
    assert done.returncode == 4
    least = min(json.loads(done.stdout), key=lambda row: row["coverage"])
    least_covered = f"{100 * least['coverage']:.1f} %"
    assert f"{least['source']} covers least of its surface's pixels, {least_covered}" in done.stderr
    assert "; 2 covered less than --min-coverage of the measured pixels" in done.stderr
    assert "images of 2 sizes (160 x 120, 120 x 90 pixels) have the same numbers" in done.stderr
    assert least["camera"] == "131.25,131.25,70,50"


def test_colors_may_have_other_pixels_of_the_same_view(frame: Path, tmp_path: Path) -> None:
    with Image.open(frame) as image:
        width, height = image.size
    places = {}
    for factor in (1, 4):
        color = tmp_path / f"{factor}.png"
        Image.new("RGB", (factor * width, factor * height), (200, 100, 50)).save(color)
        mesh = tmp_path / f"{factor}.ply"
        base = ("depth", frame, "-o", mesh, "--intrinsics", FOCAL, "--points", "300")
        done = manip3d(*base, "--color", color)
        assert done.returncode == 0, done.stderr
        assert ("colours of 640 x 480 pixels" in done.stdout + done.stderr) == (factor == 4)
        read = read_mesh(mesh)
        assert read.texcoords is not None
        assert read.face_texcoords is not None
        places[factor] = read.texcoords[read.face_texcoords], read.vertices[read.faces]
    np.testing.assert_array_equal(places[4][1], places[1][1])
    np.testing.assert_allclose(places[4][0], places[1][0], atol=0.01 / width)
    Image.new("RGB", (640, 360)).save(color)
    assert "images of another camera need its registration" in error_line(
        manip3d(*base, "--color", color, "--force")
    )


def test_disparities_of_8_bits(tmp_path: Path) -> None:
    path = tmp_path / "disp1.png"
    Image.fromarray(np.full((48, 64), 40, np.uint8)).save(path)
    base = ("depth", path, "-o", tmp_path / "x.ply", "--points", "9", "--intrinsics", "50,50,32,24")
    assert "is a picture; depth takes a depth image" in error_line(manip3d(*base))
    done = manip3d(*base, "--unit", "disparity:80")
    assert done.returncode == 0, done.stderr
    assert "depth 2.00 to 2.00 m, unit disparity:80" in done.stderr + done.stdout


def test_info_and_view_take_the_depths_of_8_bits_that_depth_takes(tmp_path: Path) -> None:
    path = tmp_path / "disp1.png"
    Image.fromarray(np.full((48, 64), 40, np.uint8)).save(path)
    Image.fromarray(np.full((48, 64, 3), 40, np.uint8)).save(tmp_path / "color.png")
    (tmp_path / "calib.txt").write_text(
        "cam0=[50 0 32; 0 50 24; 0 0 1]\ncam1=[50 0 32; 0 50 24; 0 0 1]\ndoffs=0\n"
        "baseline=1600\nwidth=64\nheight=48\n"
    )
    for more in (("--unit", "disparity:80"), ("--intrinsics", tmp_path / "calib.txt")):
        done = manip3d("info", path, *more, "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["range"] == [2.0, 2.0]
        done = manip3d("view", path, *more, "-o", tmp_path / "x.html", "--force")
        assert "depth 2.00 to 2.00 m, unit disparity:80" in done.stderr  # the page needs npm
    for verb in ("info", "view"):
        assert "disparity:FB of a stereo pair" in error_line(manip3d(verb, path))
        wrong = manip3d(verb, tmp_path / "color.png", "--unit", "disparity:80")
        assert "is a picture" in error_line(wrong)


def test_wrong_cameras_are_refused(frame: Path, tmp_path: Path) -> None:
    from manip3d import InputError
    from manip3d.camera import read_intrinsics

    base = ("cs3", frame, "-o", tmp_path / "x.glb", "--points", "99", "-q")
    assert "--intrinsics: expected the camera" in error_line(manip3d(*base))
    (frame.parent / "calib.txt").touch()
    assert f"got none; {frame.parent}/calib.txt may be it" in error_line(manip3d(*base))
    (frame.parent / "calib.txt").unlink()
    for text in ("1,2,3", "a,b,c,d", "kinect-v9"):
        with pytest.raises(InputError, match=f"got '{text}'"):
            read_intrinsics(text, width=160, height=120)
    with pytest.raises(InputError, match="kinect-v2 is for 512 x 424 pixels, the image has 160"):
        read_intrinsics("kinect-v2", width=160, height=120)
    with pytest.raises(InputError, match="fx"):
        read_intrinsics("nan,1,1,1", width=160, height=120)
    assert read_intrinsics("kinect-v1", width=320, height=240).fx == 292.5


SCAN = """ply
format ascii 1.0
obj_info num_cols 12
obj_info num_rows 10
element vertex 120
property float x
property float y
property float z
element range_grid 120
property list uchar int vertex_indices
end_header
"""


def test_only_sampling_by_order_depends_on_the_distance(tmp_path: Path) -> None:
    np.save(tmp_path / "wall.npy", np.full((48, 64), 2.0, np.float32))
    base = ("cs3", tmp_path / "wall.npy", "-o", tmp_path / "wall.ply", "--points", "60")
    base += ("--intrinsics", "60,60,31.5,23.5", "--by-distance")
    error = error_line(manip3d(*base, "--variant", "cnms"))
    assert "--by-distance, --variant: expected the variant cios or lios, got cnms" in error


def test_scans_need_no_camera(tmp_path: Path) -> None:
    v, u = np.mgrid[:10, :12]
    z = 0.2 * np.sin(u) * np.cos(v)
    points = "".join(f"{x} {y} {h:.6f}\n" for x, y, h in zip(u.flat, v.flat, z.flat, strict=True))
    source = tmp_path / "scan.ply"
    source.write_text(SCAN + points + "".join(f"1 {i}\n" for i in range(120)))
    output = tmp_path / "out.glb"
    done = manip3d("cs3", source, "-o", output, "--points", "60", "--json")
    record = json.loads(done.stdout)
    assert record["points_before"] == 120
    assert record["points"] <= 60
    assert read_mesh(output).vertices[:, 1].min() >= 0  # a scan's axes are its own
    again = manip3d("cs3", source, "-o", output, "--points", "60", "--by-distance", "-q", "--force")
    assert "--by-distance" in error_line(again)


def test_color_becomes_the_texture(
    frame: Path, scene: simulated.DepthScene, tmp_path: Path
) -> None:
    color = tmp_path / "colour.png"
    Image.fromarray(scene.color).save(color)
    output = tmp_path / "out.glb"
    base = ("cs3", frame, "-o", output, "--points", "200", "--intrinsics", FOCAL, "-q", "--force")
    assert manip3d(*base, "--color", color).returncode == 0
    (material,) = read_mesh(output).materials
    assert material.textures["base_color"].data.startswith(b"\x89PNG")
    color.write_bytes(b"nothing")
    assert "expected a colour image" in error_line(manip3d(*base, "--color", color))


def test_a_missed_target_is_exit_4_under_strict(tmp_path: Path) -> None:
    scene = simulated.person(width=160, height=120)
    path = tmp_path / "depth.npy"
    np.save(path, np.nan_to_num(scene.depth).astype(np.float32))
    base = ("cs3", path, "--points", "3", "--intrinsics", FOCAL, "-q", "--force")
    done = manip3d(*base, "-o", tmp_path / "x.ply", "--json", "--strict")
    record = json.loads(done.stdout)
    assert record["coverage_missed"]  # three points cover next to nothing
    assert done.returncode == 4
    everything = ("cs3", path, "--points", "999999", "--intrinsics", FOCAL, "-q", "--json")
    done = manip3d(*everything, "-o", tmp_path / "y.ply", "--strict")
    assert done.returncode == 0  # all points there are: nothing is missed
    assert json.loads(done.stdout)["points"] == np.isfinite(scene.depth).sum()


def test_a_missed_target_is_told_with_its_reason(tmp_path: Path) -> None:
    v, u = np.mgrid[0:24, 0:30]
    tiles, holes = tmp_path / "tiles.npy", tmp_path / "holes.npy"
    np.save(tiles, np.where((u // 4 + v // 4) % 2 == 0, 1.0, 2.0).astype(np.float32))
    measured = np.random.default_rng(0).random((24, 30)) < 0.5
    np.save(holes, np.where(measured, 2.0 + 0.1 * np.sin(u / 7) * np.cos(v / 5), 0.0))
    base = ("--intrinsics", "30,30,14.5,11.5", "--unit", "1", "-o", tmp_path / "x.ply", "--force")
    few = manip3d("depth", tiles, "--points", "5", *base)
    assert "pixels of triangles left out" in few.stderr
    assert "target of 5 points missed, as only a few triangles of a larger mesh" in few.stderr
    pinholes = manip3d("depth", holes, "--points", "20", "--effort", "live", *base)
    assert "target of 20 points missed, as points at pinholes were merged" in pinholes.stderr


def test_low_coverage_is_exit_4_under_strict(frame: Path, tmp_path: Path) -> None:
    base = ("depth", frame, "--points", "300", "--intrinsics", FOCAL, "--json", "--strict")
    shares = {}
    for method in ("relief", "cs3"):
        asked = (*base, "--method", method, "--depth-step", "0", "--force", "-o")
        done = manip3d(*asked, tmp_path / "x.ply", "--min-coverage", "0")
        record = json.loads(done.stdout)
        assert not record["coverage_missed"]
        assert f"covers {100 * record['coverage']:.1f} %" in done.stderr
        assert 0 <= record["bridges"] < 1
        faces = read_mesh(tmp_path / "x.ply").faces
        assert record["points"] == len(np.unique(faces))
        shares[method] = record["coverage"]
        done = manip3d(*asked, tmp_path / "x.ply", "--min-coverage", "0.9999")
        assert done.returncode == 4
        assert json.loads(done.stdout)["coverage_missed"]
    assert 0.5 < shares["relief"] < 0.9999
    bad = manip3d(*base, "-o", tmp_path / "y.ply", "--min-coverage", "1.5")
    assert bad.returncode == 2


def test_many_bridges_are_exit_4_under_strict(frame: Path, tmp_path: Path) -> None:
    base = ("cs3", frame, "--points", "300", "--intrinsics", FOCAL, "--json", "--strict", "--force",
            "--min-coverage", "0", "-o", tmp_path / "x.ply")  # fmt: skip
    done = manip3d(*base, "--depth-step", "0")
    record = json.loads(done.stdout)
    assert done.returncode == 4
    assert record["bridges_missed"]
    assert record["bridges"] + record["left_area"] > 0.1
    together = 100 * (record["bridges"] + record["left_area"])
    assert (
        f"{100 * record['bridges']:.2f} % of its area bridges gaps ({together:.2f} % with faces "
        "across depth steps, more than 10 %)" in done.stderr
    )
    assert f"{100 * record['left_area']:.2f} % of the area, stayed, as --depth-step" in done.stderr
    done = manip3d(*base, "--depth-step", "0", "--max-bridges", "1")
    assert done.returncode == (4 if json.loads(done.stdout)["target_missed"] else 0)
    assert manip3d(*base, "--max-bridges", "-1").returncode == 2


def test_a_folder_becomes_a_folder_and_goes_on_where_it_stopped(
    frames: Path, tmp_path: Path
) -> None:
    (frames / "notes.txt").write_text("no frame")
    (frames / "002.depth.png").write_bytes(b"torn")
    output = tmp_path / "out"
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(frames / "000.color.png")
    arguments = ("cs3", frames, "-o", output, "--points", "150", "--intrinsics", FOCAL,
                 "--jobs", "2")  # fmt: skip
    done = manip3d(*arguments, "--json")
    assert done.returncode == 1  # one frame is torn, and the others are there
    records = json.loads(done.stdout)
    assert [bool(record["error"]) for record in records] == [False, False, False, True, False]
    assert records[0]["skipped"] == "a picture"
    assert "FormatError" in records[3]["error"]
    meshes = {path.name: path.stat().st_mtime_ns for path in output.glob("*.glb")}
    assert sorted(meshes) == ["000.depth.glb", "001.depth.glb", "003.depth.glb"]
    whole = (frames / "001.depth.png").read_bytes()
    (frames / "002.depth.png").write_bytes(whole)
    done = manip3d(*arguments)
    assert done.returncode == 0
    assert "5 files (4 from an earlier run, 1 skipped, of another kind)" in done.stderr
    after = {path.name: path.stat().st_mtime_ns for path in output.glob("*.glb")}
    assert {name: after[name] for name in meshes} == meshes
    assert (output / "002.depth.glb").read_bytes() == (output / "001.depth.glb").read_bytes()
    assert manip3d(*arguments, "--force", "-q").returncode == 0
    assert (output / "000.depth.glb").stat().st_mtime_ns > meshes["000.depth.glb"]


def test_folders_without_frames_and_with_too_few_colors(frames: Path, tmp_path: Path) -> None:
    base = ("-o", tmp_path / "out", "--points", "9", "--intrinsics", FOCAL, "-q")
    assert "found none" in error_line(manip3d("cs3", frames / "*.tif", *base))
    colors = tmp_path / "colours"
    colors.mkdir()
    done = manip3d("cs3", frames, *base, "--color", colors)
    assert "--color: expected 4 images in" in error_line(done)


def test_ctrl_c_leaves_whole_files(scene: simulated.DepthScene, tmp_path: Path) -> None:
    folder, output = tmp_path / "many", tmp_path / "out"
    folder.mkdir()
    depth = scene.capture(rng=1).depth
    for number in range(300):
        np.save(folder / f"{number:04}.npy", depth)
    process = subprocess.Popen(
        [sys.executable, "-m", "manip3d", "cs3", str(folder), "-o", str(output), "--points", "400",
         "--intrinsics", FOCAL, "--method", "poisson", "-q", "--jobs", "1"],
        env=os.environ, stderr=subprocess.PIPE,
    )  # fmt: skip
    while process.poll() is None and len(list(output.glob("*.glb"))) < 3:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert b"Traceback" not in errors
    written = sorted(path for path in output.iterdir() if path.name != "results.rows")
    assert 3 <= len(written) < 300
    assert all(path.suffix == ".glb" and path.name[0] != "." for path in written)
    for path in written[-2:]:
        read_mesh(path)


@pytest.mark.parametrize(("verb", "method"), [("depth", "relief"), ("cs3", "cs3")])
def test_default_method_of_both_names(verb: str, method: str, frame: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.ply"
    asked = (verb, frame, "-o", output, "--points", "300", "--intrinsics", FOCAL, "--json")
    record = json.loads(manip3d(*asked).stdout)
    assert record["method"] == method
    assert record["stop"] in ("target", "small_pieces")  # noisy pixels are pieces
    assert 0.5 < record["coverage"] <= 1.0  # noisy, at 2 % of the points
    assert f"[default: {method}]" in " ".join(manip3d(verb, "--help").stdout.split())


def test_a_mask_and_confidences_come_from_files(frame: Path, tmp_path: Path) -> None:
    left = np.tile(np.arange(160) < 80, (120, 1))
    masks = [tmp_path / "mask.png", tmp_path / "mask.npy"]
    Image.fromarray(left).save(masks[0])  # of one bit
    np.save(masks[1], left)
    outputs = []
    base = ("depth", frame, "--points", "300", "--intrinsics", FOCAL, "--force")
    for number, mask in enumerate(masks):
        outputs.append(tmp_path / f"{number}.ply")
        done = manip3d(*base, "-o", outputs[-1], "--mask", mask, "--json")
        depth = np.array(Image.open(frame))
        assert json.loads(done.stdout)["points_before"] == np.count_nonzero(depth[left])
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    assert read_mesh(outputs[0]).vertices[:, 0].max() < 0.05
    levels = tmp_path / "levels.png"
    Image.fromarray(np.where(left, 2, 0).astype(np.uint8)).save(levels)
    shares = tmp_path / "shares.npy"
    np.save(shares, left.astype(np.float32))
    np.save(tmp_path / "floats.npy", np.where(left, 2.0, 0.0))  # levels
    np.save(tmp_path / "wide.npy", np.where(left, 2, 0))
    asked = {
        "floats": ("--confidence", tmp_path / "floats.npy", "--confidence-max", "2"),
        "wide": ("--confidence", tmp_path / "wide.npy", "--confidence-max", "2"),
        "levels": ("--confidence", levels, "--confidence-max", "2"),
        "shares": ("--confidence", shares),
        "plain": (),
    }
    meshes = {}
    for name, options in asked.items():
        assert manip3d(*base, "-q", "-o", tmp_path / "x.ply", *options).returncode == 0
        meshes[name] = (tmp_path / "x.ply").read_bytes()
    assert meshes["levels"] == meshes["shares"] != meshes["plain"]
    assert meshes["levels"] == meshes["floats"] == meshes["wide"]


def test_pixels_without_confidence_that_are_left_out_are_counted(tmp_path: Path) -> None:
    """A reflection at 1.8 m in a wall at 3 m, which has confidence 0."""
    v, u = np.mgrid[0:120, 0:160]
    wrong = np.hypot(u - 60, v - 50) < 15
    image, levels, output = tmp_path / "a.png", tmp_path / "levels.png", tmp_path / "a.ply"
    Image.fromarray(np.where(wrong, 1800, 3000).astype(np.uint16)).save(image)
    Image.fromarray(np.where(wrong, 0, 2).astype(np.uint8)).save(levels)
    base = ("depth", image, "--points", "200", "--intrinsics", FOCAL, "--unit", "mm", "-o", output)
    done = manip3d(*base, "--confidence", levels, "--confidence-max", "2")
    left = np.count_nonzero(wrong)
    assert f", {left} pixels without confidence left out" in done.stderr
    np.testing.assert_allclose(read_mesh(output).vertices[:, 2], 3.0)
    asked = ("--confidence", levels, "--confidence-max", "2", "--json", "--force")
    record = json.loads(manip3d(*base, *asked).stdout)
    assert (record["unsure_pixels"], record["points_before"]) == (left, wrong.size)
    assert record["outside"] == 0
    everything = json.loads(manip3d(*base[:3], str(wrong.size), *base[4:], *asked).stdout)
    assert everything["points"] == wrong.size - left
    assert not everything["target_missed"]
    plain = manip3d(*base, "--force")
    assert "without confidence" not in plain.stderr


def test_a_cut_out_is_a_mask(frame: Path, tmp_path: Path) -> None:
    """Its shape is in the alpha; the colours around it are those of the picture."""
    left = np.tile(np.arange(160) < 80, (120, 1))
    colors = np.random.default_rng(0).integers(1, 256, (120, 160, 3))
    cutout, mask = tmp_path / "cutout.png", tmp_path / "mask.png"
    rgba = np.dstack([colors, 255 * left])
    Image.fromarray(rgba.astype(np.uint8)).save(cutout)
    Image.fromarray(left).save(mask)
    base = ("depth", frame, "--points", "300", "--intrinsics", FOCAL, "-q", "-o")
    outputs = [tmp_path / "0.ply", tmp_path / "1.ply"]
    for output, path in zip(outputs, (cutout, mask), strict=True):
        assert manip3d(*base, output, "--mask", path).returncode == 0
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


@pytest.mark.parametrize("shape", [(1, 80), (80, 1)])
def test_one_row_or_column_has_no_surface(shape: tuple[int, int], tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full(shape, 2000, np.uint16))
    done = manip3d("depth", tmp_path / "a.npy", "--points", "9", "--intrinsics", "60,60,4,4", "-q",
                   "-o", tmp_path / "a.ply")  # fmt: skip
    line = error_line(done)
    assert "an image of one row or one column has no surface" in line
    assert "LiDAR" not in line


def test_an_image_without_depth_names_a_mask_only_where_there_is_one(tmp_path: Path) -> None:
    empty, mask = tmp_path / "empty.png", tmp_path / "mask.npy"
    Image.fromarray(np.zeros((120, 160), np.uint16)).save(empty)
    np.save(mask, np.ones((120, 160), bool))
    base = ("depth", empty, "--points", "99", "--intrinsics", FOCAL, "--unit", "mm", "-q")
    base += ("-o", tmp_path / "x.ply")
    alone = error_line(manip3d(*base))
    assert "found no measured pixel" in alone
    assert "mask" not in alone
    assert "of those that the mask leaves" in error_line(manip3d(*base, "--mask", mask))


def test_wrong_maps_are_one_line(frame: Path, tmp_path: Path) -> None:
    small, levels, color = (tmp_path / name for name in ("small.npy", "levels.npy", "rgb.png"))
    np.save(small, np.ones((9, 8), bool))
    shares, wide = tmp_path / "shares.npy", tmp_path / "wide.npy"
    np.save(shares, np.full((120, 160), 1.5))
    np.save(wide, np.full((120, 160), 2, np.int64))
    np.save(levels, np.full((120, 160), 7, np.uint8))
    Image.fromarray(np.zeros((120, 160, 3), np.uint8)).save(color)
    base = ("depth", frame, "--points", "99", "--intrinsics", FOCAL, "-q", "-o", tmp_path / "x.ply")
    for options, message in (
        (("--mask", small), "--mask: expected shape (120, 160), got (9, 8) (rows, columns)"),
        (("--confidence", small), "--confidence: expected shape (120, 160), got (9, 8)"),
        (
            ("--confidence", shares),
            "--confidence-max: expected the highest level, as the file has float64 up to 1.5",
        ),
        (
            ("--confidence", shares, "--confidence-max", "2"),
            "--confidence: expected whole numbers from 0 to 2, got 1.5",
        ),
        (
            ("--confidence", wide),
            "--confidence-max: expected the highest level, as the file has int64",
        ),
        (("--confidence", wide, "--confidence-max", "0"), "--confidence-max: expected at least 1"),
        (("--mask", color), "found no measured pixel of those that the mask leaves"),
        (("--mask", frame.with_name("none.png")), "none.png"),
        (
            ("--confidence", levels, "--confidence-max", "2"),
            "--confidence: expected whole numbers from 0 to 2, got 7",
        ),
        (("--confidence-max", "2"), "--confidence-max: can only be given with confidence"),
        (("--seed", "2"), "--seed: can only be given with method poisson, got relief"),
        (
            ("--confidence", levels, "--method", "ssa"),
            "--confidence: can only be given with method relief",
        ),
    ):
        assert message in error_line(manip3d(*base, *options))
    assert not (tmp_path / "x.ply").exists()


def test_it_says_of_which_pixels_too_few_are_covered(tmp_path: Path) -> None:
    """The surface is covered, but more than a tenth of the measured pixels lie on none."""
    depth = np.full((40, 40), 1500, np.uint16)
    depth[:, 20:] = 0
    depth[::2, 22::2] = 1500  # single pixels: 180 beside the 800 of the surface
    image = tmp_path / "half.png"
    Image.fromarray(depth).save(image)
    done = manip3d("depth", image, "--points", "99", "--intrinsics", FOCAL, "--strict",
                   "-o", tmp_path / "x.ply")  # fmt: skip
    assert done.returncode == 4
    assert (
        "covers 100.0 % of the surface's pixels, 18.4 % of the measured pixels lie on no "
        "surface (less than 90 % of them are covered)" in done.stderr
    )
    done = manip3d("depth", image, "--points", "99", "--intrinsics", FOCAL, "--force",
                   "--min-coverage", "0.995", "-o", tmp_path / "x.ply")  # fmt: skip
    assert "(less than 99.5 % of them are covered)" in done.stderr


def test_masks_of_many_frames(frames: Path, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    for number in range(4):
        np.save(masks / f"{number}.npy", np.tile(np.arange(160) < 60 + 20 * number, (120, 1)))
    base = ("depth", frames, "--points", "150", "--intrinsics", FOCAL, "--jobs", "1", "--json")
    rows = json.loads(manip3d(*base, "-o", tmp_path / "each", "--mask", masks).stdout)
    counts = [row["points_before"] for row in rows]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]
    one = manip3d(*base, "-o", tmp_path / "all", "--mask", masks / "0.npy")
    assert max(row["points_before"] for row in json.loads(one.stdout)) < 1.2 * counts[0]
    (masks / "0.npy").unlink()
    done = manip3d(*base, "-q", "-o", tmp_path / "few", "--mask", masks)
    assert "found 3 of 4, none for 000.depth.png" in error_line(done)


def test_disparities_of_8_bits_have_colours_masks_and_confidences(tmp_path: Path) -> None:
    folders = {name: tmp_path / name for name in ("depth", "color", "mask", "confidence")}
    for folder in folders.values():
        folder.mkdir()
    v, u = np.mgrid[:48, :64]
    for number in range(2):
        name = f"{number}.png"
        Image.fromarray((60 + u // 16).astype(np.uint8)).save(folders["depth"] / name)
        Image.fromarray(np.stack([u, v, 90 + 0 * u], -1).astype(np.uint8)).save(
            folders["color"] / name
        )
        mask = Image.fromarray((255 * (u < 40 + number)).astype(np.uint8))
        mask.save(folders["mask"] / name)
        mask.save(folders["confidence"] / name)
    base = ("depth", folders["depth"], "--unit", "disparity:120", "--intrinsics", "60,60,31.5,23.5",
            "--points", "60", "--jobs", "1", "--json", "-o", tmp_path / "out")  # fmt: skip
    more = [word for name in ("color", "mask", "confidence") for word in (f"--{name}",
            folders[name])]  # fmt: skip
    rows = json.loads(manip3d(*base, *more).stdout)
    assert [row["points_before"] for row in rows] == [48 * 40, 48 * 41]
    mesh = read_mesh(tmp_path / "out" / "0.glb")
    assert mesh.materials[0].textures["base_color"].data is not None
    (folders["confidence"] / "1.png").unlink()
    wrong = manip3d(*base, "--force", "--confidence", folders["confidence"])
    assert "--confidence: expected an image in" in error_line(wrong)


def test_clouds_beside_depth_images_keep_their_unit(tmp_path: Path) -> None:
    """A folder with a camera file for neither: the clouds bring theirs, the images fail."""
    v, u = np.mgrid[:48, :64]
    depth = 2000 + 9 * ((u // 8 + v // 8) % 2)
    folder = tmp_path / "in"
    folder.mkdir()
    np.save(folder / "depth.npy", depth.astype(np.uint16))
    cloud = np.stack([(u - 31.5) / 60, (v - 23.5) / 60, 1 + 0 * u], axis=-1) * depth[..., None]
    points = (cloud / 1000).astype(np.float32)
    np.save(folder / "cloud.npy", points)
    header = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 64\nHEIGHT 48\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3072\nDATA binary\n"
    )
    (folder / "cloud.pcd").write_bytes(header.encode() + points.tobytes())
    base = ("depth", folder, "--points", "60", "--jobs", "1", "--json")
    rows = json.loads(manip3d(*base, "-o", tmp_path / "out").stdout)
    units = {Path(row["source"]).name: row["unit"] for row in rows if not row["error"]}
    assert units == {"cloud.npy": "m", "cloud.pcd": "m"}
    for name in ("cloud.npy.glb", "cloud.pcd.glb"):
        np.testing.assert_allclose(read_mesh(tmp_path / "out" / name).vertices[:, 2], -2, atol=0.01)
    rows = json.loads(manip3d(*base, "-o", tmp_path / "cm", "--unit", "100").stdout)
    assert {row["unit"] for row in rows if not row["error"]} == {"100"}  # what is given holds


def test_points_by_bandwidth(frames: Path, tmp_path: Path) -> None:
    base = ("depth", frames, "--intrinsics", FOCAL, "--jobs", "1", "--force")
    asked = ("--bandwidth", "80000", "--rate", "10", "-o", tmp_path / "out")
    rows = json.loads(manip3d(*base, *asked, "--json").stdout)
    sizes = [path.stat().st_size for path in sorted((tmp_path / "out").glob("*.glb"))]
    assert [row["bytes"] for row in rows] == sizes
    assert all(
        7000 < size <= 8000 == row["max_bytes"] for size, row in zip(sizes, rows, strict=True)
    )
    one = ("depth", frames / "000.depth.png", "--intrinsics", FOCAL, "-o", tmp_path / "x.glb")
    done = manip3d(*one, *asked[:4])
    assert " of 8,000 bytes" in done.stderr or " of 8 000 bytes" in done.stderr
    none = manip3d(*one, "-q", "--force")
    assert none.returncode == 2
    assert "--points: give --points or --ratio, or --bandwidth with --rate" in none.stderr
    few = manip3d(*one, "-q", "--force", "--bandwidth", "5000", "--rate", "10")
    assert "--bandwidth: expected at least" in error_line(few)
    assert "--bandwidth, --rate: expected both" in error_line(
        manip3d(*one, "-q", "--force", "--rate", "10")
    )


def test_points_by_the_share_of_measured_pixels(frames: Path, tmp_path: Path) -> None:
    """Each image has its own share: masks leave them different numbers of pixels."""
    masks = tmp_path / "masks"
    masks.mkdir()
    for number in range(4):
        np.save(masks / f"{number}.npy", np.tile(np.arange(160) < 60 + 20 * number, (120, 1)))
    base = ("depth", frames, "--ratio", "0.02", "--intrinsics", FOCAL, "--json", "--mask", masks)
    for way in (("--jobs", "1"), ("--stable",)):
        rows = json.loads(manip3d(*base, *way, "--force", "-o", tmp_path / "out").stdout)
        assert len({row["points_before"] for row in rows}) == 4
        for row in rows:
            assert row["target_points"] == max(3, int(0.02 * row["points_before"]))
            assert 0.99 * row["target_points"] <= row["points"] <= row["target_points"]
    one = ("depth", frames / "000.depth.png", "--intrinsics", FOCAL, "-q", "-o", tmp_path / "x.glb")
    least = json.loads(manip3d(*one, "--ratio", "1e-9", "--json").stdout)
    assert (least["target_points"], least["faces"]) == (3, 1)
    both = error_line(manip3d(*one, "--force", "--ratio", "0.1", "--points", "9"))
    assert "--points, --ratio: expected one of them" in both
    for wrong in ("0", "1.01", "nan"):
        done = manip3d(*one, "--force", "--ratio", wrong)
        assert "--ratio: expected more than 0 to 1" in error_line(done)


def still_pixels(folder: Path) -> float:
    """Share of the vertices' lines of sight that a mesh has in common with the one before."""
    seen = []
    for path in sorted(folder.glob("*.glb")):
        vertices = np.asarray(read_mesh(path).vertices)
        seen.append(set(map(tuple, np.rint(1e3 * vertices[:, :2] / vertices[:, 2:]).astype(int))))
    shares = [len(one & two) / len(two) for one, two in itertools.pairwise(seen)]
    assert len(shares) == 3
    return float(np.mean(shares))


def test_a_stable_folder_is_what_a_stream_makes_of_it(frames: Path, tmp_path: Path) -> None:
    base = ("depth", frames, "--points", "150", "--intrinsics", FOCAL, "--json")
    rows = json.loads(manip3d(*base, "--stable", "-o", tmp_path / "stable").stdout)
    assert all(148 <= row["points"] <= 150 for row in rows)  # less those that a cut step frees
    assert all(row["coverage"] > 0.9 and row["unit"] == "mm" for row in rows)
    manip3d(*base, "-o", tmp_path / "alone", "--jobs", "1")
    kept, kept_alone = still_pixels(tmp_path / "stable"), still_pixels(tmp_path / "alone")
    assert kept > 0.45 > 0.2 > kept_alone

    sources = sorted(frames.iterdir())
    depths = [np.array(Image.open(path), np.uint16) for path in sources]
    camera = read_intrinsics(FOCAL, width=depths[0].shape[1], height=depths[0].shape[0])
    stream = simplify.ReliefStream(camera, 150, depth_step=simplify.DEPTH_STEP)
    for source, depth in zip(sources, depths, strict=True):
        found = stream.simplify(depth)
        found = simplify.cut_depth_steps(found, found.surface.depth)  # type: ignore[union-attr]
        written = read_mesh(tmp_path / "stable" / f"{source.stem}.glb")
        used = np.unique(found.faces)  # a cut frees some
        expected = found.mesh.vertices[used] * [1, -1, -1]
        np.testing.assert_allclose(
            np.sort(written.vertices, axis=0), np.sort(expected, axis=0), atol=1e-6
        )


def test_a_stable_folder_never_goes_on_in_the_middle(frames: Path, tmp_path: Path) -> None:
    whole = (frames / "001.depth.png").read_bytes()
    (frames / "001.depth.png").write_bytes(b"torn")
    base = ("depth", frames, "--points", "150", "--intrinsics", FOCAL, "--stable")
    output = tmp_path / "out"
    done = manip3d(*base, "-o", output, "--json")
    assert done.returncode == 1
    assert [bool(row["error"]) for row in json.loads(done.stdout)] == [False, True, False, False]
    (frames / "001.depth.png").write_bytes(whole)
    done = manip3d(*base, "-o", output)
    assert done.returncode == 0
    assert "earlier run" not in done.stderr
    manip3d(*base, "-o", tmp_path / "anew", "--jobs", "2", "-q")  # threads
    for path in sorted((tmp_path / "anew").glob("*.glb")):
        assert (output / path.name).read_bytes() == path.read_bytes()


def test_a_shorter_sequence_does_not_leave_frames_of_a_longer_one(
    frames: Path, tmp_path: Path
) -> None:
    """The player would show the frames of both."""
    sources, output = sorted(frames.iterdir()), tmp_path / "out"
    options = ("--points", "99", "--intrinsics", FOCAL, "-o", output, "--stable")
    assert manip3d("depth", *sources, *options).returncode == 0
    (output / "009.depth.glb").write_bytes(b"of another program")
    done = manip3d("depth", *sources[:2], *options)
    assert done.returncode == 1
    assert "holds 002.depth.glb and 1 more file of an earlier run" in error_line(done)
    assert "--force removes them" in error_line(done)
    np.save(tmp_path / "small.npy", np.ones((3, 4), bool))
    none = manip3d("depth", *sources[:2], *options, "--force", "--mask", tmp_path / "small.npy")
    assert none.returncode == 1
    assert "2 of 2 files failed" in none.stderr
    assert len(list(output.glob("*.glb"))) == 5  # a run that makes nothing removes nothing
    sources[1].write_bytes(b"torn")
    done = manip3d("depth", *sources[:2], *options, "--force")
    assert done.returncode == 1
    kept = sorted(path.name for path in output.glob("*.glb"))
    assert kept == ["000.depth.glb", "009.depth.glb"]


def test_files_of_a_copied_folder_are_not_those_of_the_run(frames: Path, tmp_path: Path) -> None:
    sources, output, copy = sorted(frames.iterdir()), tmp_path / "out", tmp_path / "copy"
    options = ("--points", "99", "--intrinsics", FOCAL, "--stable", "--table", tmp_path / "t.csv")
    assert manip3d("depth", *sources[:3], *options, "-o", output).returncode == 0
    shutil.copytree(output, copy)
    done = manip3d("depth", *sources[:2], *options, "-o", copy, "--force")
    assert done.returncode == 0
    assert (copy / "002.depth.glb").exists()


def test_a_stable_folder_removes_meshes_only_with_force(frames: Path, tmp_path: Path) -> None:
    """A frame that has become unreadable may be mended later."""
    output = tmp_path / "out"
    base = ("depth", frames, "--points", "99", "--intrinsics", FOCAL, "-o", output, "--stable")
    assert manip3d(*base).returncode == 0
    sorted(frames.iterdir())[3].write_bytes(b"torn")
    done = manip3d(*base)
    assert done.returncode == 1
    assert "keeps 003.depth.glb of an earlier run, which this one did not make" in done.stderr
    assert len(list(output.glob("*.glb"))) == 4
    assert "keeps" not in manip3d(*base, "--force").stderr
    assert len(list(output.glob("*.glb"))) == 3


def test_the_mesh_of_a_file_that_is_now_a_mask_is_none_of_the_sequence(
    frames: Path, tmp_path: Path
) -> None:
    """A file that is read as a mask since another one is named depth has no mesh any more."""
    sources, folder, output = sorted(frames.iterdir()), tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    for source, name in zip(sources, ("0.png", "1_mask.png"), strict=False):
        source.rename(folder / name)
    base = ("depth", folder, "--points", "99", "--intrinsics", FOCAL, "-o", output, "--stable")
    assert manip3d(*base).returncode == 0
    sources[2].rename(folder / "0_depth.png")
    done = manip3d(*base)
    assert done.returncode == 1
    assert "holds 1_mask.glb of an earlier run, which this one does not make" in error_line(done)
    assert manip3d(*base, "--force").returncode == 0
    assert sorted(path.name for path in output.glob("*.glb")) == ["0.glb", "0_depth.glb"]


def test_meshes_of_an_earlier_run_that_stay_are_told(frames: Path, tmp_path: Path) -> None:
    sources, output = sorted(frames.iterdir()), tmp_path / "out"
    options = ("--points", "99", "--intrinsics", FOCAL, "--method", "uniform", "-o", output)
    for some, words in (
        (sources, ""),
        (sources[:2], "002.depth.glb and 1 more file of an earlier run"),
        (sources, ""),
    ):
        done = manip3d("depth", *some, *options)
        assert done.returncode == 0
        assert ("which this one did not make" in done.stderr) == bool(words)
        assert words in done.stderr
    assert len(list(output.glob("*.glb"))) == 4


def test_a_stable_folder_with_colors_masks_and_bandwidth(frames: Path, tmp_path: Path) -> None:
    colors = tmp_path / "colors"
    colors.mkdir()
    for number in range(4):
        image = np.full((120, 160, 3), 60 * number, np.uint8)
        Image.fromarray(image).save(colors / f"{number}.png")
    mask = tmp_path / "mask.npy"
    np.save(mask, np.tile(np.arange(160) < 90, (120, 1)))
    base = ("depth", frames, "--intrinsics", FOCAL, "--stable", "--json", "--color", colors)
    asked = ("--bandwidth", "80000", "--rate", "10", "--mask", mask, "-o", tmp_path / "out")
    rows = json.loads(manip3d(*base, *asked).stdout)
    sizes = [path.stat().st_size for path in sorted((tmp_path / "out").glob("*.glb"))]
    assert [row["bytes"] for row in rows] == sizes
    assert all(7000 < size <= 8000 for size in sizes)
    depths = [np.array(Image.open(path), np.uint16) for path in sorted(frames.iterdir())]
    assert [row["points_before"] for row in rows] == [np.count_nonzero(d[:, :90]) for d in depths]
    last = read_mesh(tmp_path / "out" / "003.depth.glb")
    assert "base_color" in last.materials[0].textures


def test_what_a_stable_folder_cannot_follow_is_refused(frames: Path, tmp_path: Path) -> None:
    base = ("--points", "99", "--intrinsics", FOCAL, "-q", "--stable", "-o")
    folder = ("depth", frames, *base, tmp_path / "out")
    for options, message in (
        (("--method", "cs3"), "--method: expected relief for a sequence, got cs3"),
        (("--dask", "local"), "--dask: cannot be given with stable"),
        (("--poses", "poses.txt"), "--stable: cannot be given with poses"),
    ):
        done = manip3d(*folder, *options)
        assert done.returncode == 1
        assert message in done.stderr
    one = manip3d("depth", frames / "000.depth.png", *base, tmp_path / "x.glb")
    assert "--stable: can only be given with several depth images, got one" in error_line(one)
    Image.fromarray(np.full((60, 80), 2000, np.uint16)).save(frames / "004.depth.png")
    done = manip3d(*(word for word in folder if word != "-q"))
    assert "expected an image of 160 x 120 pixels as the first of the sequence" in done.stderr


def _patch_among_lone_pixels() -> np.ndarray:
    """A surface of 100 pixels, and 775 pixels that lie on none."""
    depth = np.zeros((120, 160), np.uint16)
    depth[20::4, 4::5] = 1000
    depth[5:15, 5:15] = 1000
    return depth


@pytest.mark.parametrize(
    ("missed", "arguments"),
    [
        ("target", ("--points", "500", "--min-coverage", "0")),
        ("coverage", ("--points", "300", "--min-coverage", "0.99999")),
        ("bridges", ("--points", "30", "--min-coverage", "0", "--max-bridges", "0")),
        ("", ("--points", "300", "--min-coverage", "0.8")),
    ],
)
@pytest.mark.parametrize("strict", [False, True])
def test_each_shortfall_alone_is_exit_4_under_strict(
    missed: str, arguments: tuple[str, ...], strict: bool, frame: Path, tmp_path: Path
) -> None:
    if missed == "target":
        Image.fromarray(_patch_among_lone_pixels()).save(frame)
    options = ("--intrinsics", FOCAL, "--json", "-o", tmp_path / "x.ply")
    done = manip3d("depth", frame, *arguments, *options, *(["--strict"] if strict else []))
    record = json.loads(done.stdout)
    kinds = ("target", "coverage", "bridges")
    assert [kind for kind in kinds if record[f"{kind}_missed"]] == ([missed] if missed else [])
    assert done.returncode == (4 if strict and missed else 0)
    assert (tmp_path / "x.ply").exists()  # what was found is written all the same


@pytest.mark.parametrize("effort", ["live", "balanced"])
def test_filled_pinholes_are_no_shortfall(effort: str, frame: Path, tmp_path: Path) -> None:
    depth = np.array(Image.open(frame))
    depth[np.random.default_rng(5).random(depth.shape) < 0.12] = 0
    Image.fromarray(depth).save(frame)
    base = ("depth", frame, "--points", "300", "--intrinsics", FOCAL, "--effort", effort)
    output = tmp_path / "x.ply"
    # Slivers along the contour of the person are 0.04 of the area without missing pixels.
    limits = ("--max-bridges", "0.08", "--min-coverage", "0.8")
    done = manip3d(*base, *limits, "--strict", "--json", "-o", output)
    record = json.loads(done.stdout)
    assert (done.returncode, record["bridges_missed"]) == (0, False), record
    assert record["bridges"] > 0.08
    done = manip3d(*base, "--force", "-o", output)
    assert re.search(r"bridges gaps and \d+\.\d\d % fills pinholes", done.stderr)


def test_a_missing_image_of_a_folder_fails_alone(tmp_path: Path) -> None:
    folder = tmp_path / "images"
    folder.mkdir()
    np.save(folder / "a.npy", np.full((120, 160), 2.0, np.float32))
    (folder / "b.png").symlink_to(tmp_path / "gone.png")
    (folder / "._a.npy").write_bytes(b"\0\5\x16\7" + bytes(60))
    order = ("depth", folder, "--intrinsics", FOCAL, "--points", "50", "-o", tmp_path / "out")
    done = manip3d(*order, "--jobs", "1", "--json")
    assert done.returncode == 1
    rows = json.loads(done.stdout)
    assert [Path(row["source"]).name for row in rows] == ["a.npy", "b.png"]
    assert [bool(row["error"]) for row in rows] == [False, True]
    assert (tmp_path / "out" / "a.glb").is_file()


def test_a_camera_of_another_size_is_told_once(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for name in ("a", "b", "c"):
        np.save(tmp_path / "in" / f"{name}.npy", np.full((24, 32), 2000, np.uint16))
    np.save(tmp_path / "in" / "d.npy", np.zeros(7, np.float64))
    arguments = ("-o", tmp_path / "out", "--points", "20", "--jobs", "1")
    done = manip3d("depth", tmp_path / "in", *arguments, "--intrinsics", "kinect-v2")
    assert done.returncode == 1
    assert done.stderr.count("the image has 32 x 24") == 1
    assert f"{tmp_path / 'in' / 'a.npy'}: InputError: --intrinsics: kinect-v2 is" in done.stderr
    assert f"2 more files failed for the same reason as {tmp_path / 'in' / 'a.npy'}" in done.stderr
    assert f"{tmp_path / 'in' / 'd.npy'}: " in done.stderr
    assert "error: 4 of 4 files failed" in done.stderr


def test_depths_of_8_bits_need_their_unit(tmp_path: Path) -> None:
    path, target = tmp_path / "a.png", tmp_path / "a.ply"
    Image.fromarray(np.full((24, 32), 170, np.uint8)).save(path)
    arguments = ("depth", path, "-o", target, "--points", "8", "--intrinsics", "30,30,15.5,11.5")
    advice = "give their number in a metre as --unit, or disparity:FB of a stereo pair"
    assert advice in error_line(manip3d(*arguments))
    assert manip3d(*arguments, "--unit", "85").returncode == 0
    np.testing.assert_allclose(read_mesh(target).vertices[:, 2], 2.0)


def test_disparities_of_8_bits_have_the_unit_of_the_pair(tmp_path: Path) -> None:
    """A stereo pair's calibration states it, also for a folder with the pair's colours."""
    (tmp_path / "in").mkdir()
    path, calibration = tmp_path / "in" / "disp0.png", tmp_path / "calib.txt"
    Image.fromarray(np.full((24, 32), 40, np.uint8)).save(path)
    Image.fromarray(np.full((24, 32, 3), 90, np.uint8)).save(tmp_path / "in" / "im0.png")
    calibration.write_text(
        "cam0=[30 0 15.5; 0 30 11.5; 0 0 1]\ncam1=[30 0 15.5; 0 30 11.5; 0 0 1]\ndoffs=0\n"
        "baseline=2000\nwidth=32\nheight=24\nndisp=64\n"
    )
    asked = ("--points", "8", "--intrinsics", calibration, "--json")
    target = tmp_path / "a.ply"
    record = json.loads(manip3d("depth", path, "-o", target, *asked).stdout)
    assert record["unit"] == "disparity:60"
    np.testing.assert_allclose(read_mesh(target).vertices[:, 2], 1.5)
    rows = json.loads(
        manip3d("depth", tmp_path / "in", "-o", tmp_path / "out", "--jobs", "1", *asked).stdout
    )
    units = {Path(row["source"]).name: row.get("unit") for row in rows}
    assert units == {"disp0.png": "disparity:60", "im0.png": None}
    assert not any(row.get("error") for row in rows)
    poses = tmp_path / "poses.txt"
    poses.write_text("0 0 0 0 0 0 1\n")
    joint = ("depth", path, "--poses", poses, "-o", tmp_path / "all.ply", *asked)
    assert json.loads(manip3d(*joint).stdout)["unit"] == "disparity:60"


@pytest.mark.parametrize("more", [(), ("--stable",)])
def test_a_guess_for_a_folder_is_told(more: tuple[str, ...], tmp_path: Path) -> None:
    """Two walls 7 and 8 m away, stored in millimetres, look like units of 1/5000 m."""
    (tmp_path / "d").mkdir()
    for number in (7, 8):
        np.save(tmp_path / "d" / f"{number}.npy", np.full((48, 64), 1000 * number, np.uint16))
    base = ("depth", tmp_path / "d", "-o", tmp_path / "o", "--points", "60", "--json",
            "--intrinsics", "60,60,31.5,23.5", *more)  # fmt: skip
    told = "read 2 depth images, depth 1.40 to 1.60 m, unit tum (1/5000 m: TUM RGB-D, ICL-NUIM)"
    for _ in range(2):  # the rows of the second run are those of the first
        done = manip3d(*base)
        assert done.returncode == 0, done.stderr
        assert f"{told}, guessed; --unit overrides it" in done.stderr
        for row in json.loads(done.stdout):
            assert (row["unit"], row["unit_guessed"]) == ("tum", True)
            assert ", guessed: most of the images look like it" in row["depth"]
    done = manip3d(*base, "--unit", "mm", "--force")
    assert "depth 7.00 to 8.00 m, unit mm (" in done.stderr
    assert "guessed" not in done.stderr + str([row["depth"] for row in json.loads(done.stdout)])
    assert not any(row["unit_guessed"] for row in json.loads(done.stdout))


def test_masks_beside_depth_images_are_no_depth_images(frame: Path, tmp_path: Path) -> None:
    """Names as those of DIODE, whose masks are arrays of floats."""
    folder, output = tmp_path / "scans", tmp_path / "out"
    folder.mkdir()
    depth = np.array(Image.open(frame)) / np.float32(1000)
    left = np.tile(np.arange(160) < 80, (120, 1))
    for number in range(2):
        np.save(folder / f"{number}_depth.npy", depth[..., None])
        np.save(folder / f"{number}_depth_mask.npy", left.astype(np.float64))
    arguments = ("depth", folder, "-o", output, "--points", "100", "--intrinsics", FOCAL)
    done = manip3d(*arguments, "--mask", folder)
    assert done.returncode == 0
    assert "4 files (2 skipped, of another kind)" in done.stderr
    assert sorted(path.name for path in output.glob("*.glb")) == ["0_depth.glb", "1_depth.glb"]
    assert read_mesh(output / "0_depth.glb").vertices[:, 0].max() < 0.05
    # A mask that is named, or that lies beside no depth image, is read as it is.
    named = manip3d(*arguments[:1], folder / "0_depth_mask.npy", *arguments[2:3],
                    tmp_path / "mask.glb", *arguments[4:])  # fmt: skip
    assert "depth 1.00 to 1.00 m" in named.stderr
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n0 0 0 0 0 0 1\n")
    joined = manip3d(*arguments[:2], "-o", tmp_path / "one.ply", *arguments[4:],
                     "--poses", tmp_path / "poses.txt")  # fmt: skip
    assert joined.returncode == 0
    assert "2 files skipped, of another kind (mask or confidences)" in joined.stderr
    (tmp_path / "a.mkv").write_bytes(b"\x1aE\xdf\xa3")
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    for name, told in (("a.mkv", "is an RGB-D recording"), ("a.obj", "is a mesh; depth takes a")):
        other = manip3d(arguments[0], tmp_path / name, "-o", tmp_path / "one.ply", "--force",
                        *arguments[4:], "--poses", tmp_path / "poses.txt")  # fmt: skip
        assert f"{tmp_path / name} {told}" in error_line(other)


def test_distances_along_the_rays_are_an_option(frame: Path, tmp_path: Path) -> None:
    camera = read_intrinsics(FOCAL, width=160, height=120)
    wall = np.full((120, 160), 2.0, np.float32)
    np.save(tmp_path / "a.npy", np.linalg.norm(camera.unproject(wall), axis=2))
    output = tmp_path / "a.ply"
    given = ("depth", tmp_path / "a.npy", "-o", output, "--points", "50")
    done = manip3d(*given, "--intrinsics", FOCAL, "--ray-depth")
    assert done.returncode == 0
    assert "converted from distances along the lines of sight" in done.stderr
    np.testing.assert_allclose(read_mesh(output).vertices[:, 2], 2.0, rtol=3e-7)
    np.save(tmp_path / "a.npy", camera.unproject(wall))  # a cloud
    done = manip3d(*given, "--ray-depth", "--force")
    assert "--ray-depth: can only be given with a depth image" in error_line(done)


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("a.hdf5", "h5py.File(FILE)[NAME][()] reads it (for Hypersim, whose distances are those"),
        ("a.h5", "write its array as .npy with numpy.save"),
        ("a.MAT", "scipy.io.loadmat(FILE)[NAME] reads it"),
        ("0.png.geometric.bin", "COLMAP's scripts/python/read_write_dense.py reads it"),
        (
            "0.png.photometric.bin",
            "manip3d does not read .photometric.bin; write its array as .npy",
        ),
    ],
)
def test_other_formats_of_depths_have_a_cure(name: str, cure: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"160&120&1&" + bytes(160 * 120 * 4))
    given = ("--points", "50", "--intrinsics", FOCAL, "-o", tmp_path / "a.ply")
    done = manip3d("depth", tmp_path / name, *given)
    assert done.returncode == 1
    assert cure in error_line(done)
