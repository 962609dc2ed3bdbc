"""Lines of sight and pixels of every kind of camera: by the formulas, and there and back."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

import manip3d
from manip3d import FormatError, InputError, Intrinsics, camera
from real_data import RealData

PINHOLE = Intrinsics(64, 48, 50.0, 52.0, 30.5, 24.25)
BENT = replace(PINHOLE, distortion=(0.12, -0.05, 0.004, -0.003, 0.01))


def table_of(camera: Intrinsics) -> Intrinsics:
    """The same camera as a ray table."""
    rays = camera.unproject(np.ones((camera.height, camera.width), np.float32))[..., :2]
    plain = replace(camera, distortion=(0.0,) * 5, mirrored=False)
    return replace(plain, rays=rays)


CAMERAS = {
    "pinhole": PINHOLE,
    "upward": replace(PINHOLE, fy=-52.0),
    "mirrored": replace(BENT, mirrored=True),
    "bent": BENT,
    "bent upward": replace(BENT, fy=-52.0),
    "table": table_of(BENT),
    "table upward": table_of(replace(BENT, fy=-52.0)),
}


def brown(camera: Intrinsics, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels by OpenCV's formulas, one point at a time."""
    k1, k2, p1, p2, k3 = camera.distortion
    pixels = []
    for px, py, pz in points:
        x, y = px / pz, py / pz
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        u = camera.fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x))
        v = camera.fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)
        pixels.append((camera.cx + (-u if camera.mirrored else u), camera.cy + v))
    return np.array(pixels)


@pytest.mark.parametrize("name", ["pinhole", "upward", "mirrored", "bent", "bent upward"])
def test_pixels_are_those_of_the_formulas(name: str) -> None:
    points = np.random.default_rng(0).uniform([-1, -0.8, 1.5], [1, 0.8, 4.0], (200, 3))
    expected = brown(CAMERAS[name], points)
    np.testing.assert_allclose(CAMERAS[name].project(points), expected, rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", CAMERAS)
@given(
    u=st.floats(0, 62.99), v=st.floats(0, 46.99), depth=st.floats(0.1, 20.0)
)  # inside the outermost pixels
def test_a_point_of_a_pixel_projects_to_that_pixel(
    name: str, u: float, v: float, depth: float
) -> None:
    camera = CAMERAS[name]
    point = camera.unproject(depth, pixels=(u, v))
    assert point[2] == depth
    np.testing.assert_allclose(camera.project(point), (u, v), rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", CAMERAS)
def test_the_points_of_an_image_project_to_its_pixels(name: str) -> None:
    camera = CAMERAS[name]
    depth = np.random.default_rng(1).uniform(0.5, 4.0, (48, 64)).astype(np.float32)
    depth[3, 5], depth[7, 9] = 0.0, np.nan
    points = camera.unproject(depth)
    assert points.dtype == np.float32
    assert np.isnan(points[[3, 7], [5, 9]]).all()
    measured = depth > 0
    np.testing.assert_array_equal(points[measured][:, 2], depth[measured])
    v, u = np.mgrid[:48, :64]
    np.testing.assert_allclose(
        camera.project(points)[measured], np.stack([u, v], 2)[measured], rtol=0, atol=2e-4
    )  # single precision


@pytest.mark.parametrize("name", CAMERAS)
def test_an_image_s_points_are_those_of_its_pixels(name: str) -> None:
    camera = CAMERAS[name]
    v, u = np.mgrid[:48, :64]
    millimetres = (1000 + 10 * u + v).astype(np.uint16)
    points = camera.unproject(millimetres)
    singly = camera.unproject(millimetres / 1000.0, pixels=np.stack([u, v], 2))
    assert singly.dtype == np.float64
    np.testing.assert_allclose(points, singly, rtol=3e-7, atol=1e-9)
    for threads in (2, 4):
        np.testing.assert_array_equal(points, camera.unproject(millimetres, threads=threads))


def test_the_smallest_image() -> None:
    camera = Intrinsics(2, 1, fx=10.0, fy=-20.0, cx=0.5, cy=1.0)
    points = camera.unproject(np.array([[2000, 0]], np.uint16))
    np.testing.assert_array_equal(points, np.float32([[[-0.1, 0.1, 2.0], [np.nan] * 3]]))
    mirrored = replace(camera, mirrored=True)
    np.testing.assert_array_equal(mirrored.unproject(2.0, (0, 0)), [0.1, 0.1, 2.0])
    np.testing.assert_array_equal(mirrored.project([[0.1, 0.1, 2.0]]), [[0.0, 0.0]])


def test_what_is_behind_the_camera_or_on_no_pixel_of_a_table_has_none() -> None:
    assert np.isnan(PINHOLE.project([[0, 0, -1], [0, 0, 0], [0, 0, np.nan]])).all()
    table = CAMERAS["table"]
    assert np.isnan(table.project([[5.0, 0.0, 1.0], [0.0, -5.0, 1.0]])).all()
    assert np.isnan(table.unproject(1.0, pixels=[(-0.6, 3.0), (3.0, 47.6), (np.nan, 1.0)])).all()
    border = np.array([(-0.5, -0.5), (63.5, 47.5), (63.0, 47.0)])
    np.testing.assert_allclose(
        table.project(table.unproject(2.0, pixels=border)), border, rtol=0, atol=1e-6
    )


def test_pixels_beside_a_gap_of_a_table_keep_their_own_line_of_sight() -> None:
    rays = CAMERAS["table"].rays
    assert rays is not None
    holed = rays.copy()
    holed[10, 20] = np.nan
    camera = replace(CAMERAS["table"], rays=holed)
    assert np.isnan(camera.unproject(1.0, pixels=(20, 10))).all()
    assert np.isnan(camera.unproject(1.0, pixels=(19.5, 10))).all()
    np.testing.assert_array_equal(camera.unproject(1.0, pixels=(19, 10))[:2], rays[10, 19])
    np.testing.assert_allclose(
        camera.unproject(1.0, pixels=(30.25, 10))[:2],
        0.75 * rays[10, 30].astype(float) + 0.25 * rays[10, 31],
        rtol=1e-15,
    )


def test_shapes() -> None:
    assert PINHOLE.project(np.ones((2, 3, 4, 3))).shape == (2, 3, 4, 2)
    assert PINHOLE.project(np.ones((0, 3))).shape == (0, 2)
    assert PINHOLE.unproject(1.0, pixels=np.ones((5, 2))).shape == (5, 3)
    assert PINHOLE.unproject(np.ones(5), pixels=np.ones((5, 2))).shape == (5, 3)
    assert np.isnan(PINHOLE.unproject([0.0, np.nan], pixels=np.ones((2, 2)))).all()


def test_depths_of_pixels_in_millimetres_and_metres() -> None:
    for depth in (2, 2.0, np.float32(2.0), np.uint16(2000)):
        assert PINHOLE.unproject(depth, pixels=(1, 2))[2] == 2.0
    assert PINHOLE.unproject([2, 3], pixels=np.ones((2, 2)))[:, 2].tolist() == [2.0, 3.0]


def test_what_is_refused() -> None:
    with pytest.raises(InputError, match=r"points: expected numbers of shape \(\.\.\., 3\)"):
        PINHOLE.project(np.ones((3, 2)))
    with pytest.raises(InputError, match=r"points: .* got <U1 of \(3,\)"):
        PINHOLE.project(["a", "b", "c"])
    with pytest.raises(InputError, match=r"pixels: expected numbers of shape \(\.\.\., 2\)"):
        PINHOLE.unproject(1.0, pixels=(1, 2, 3))
    with pytest.raises(InputError, match=r"depth: expected one number or shape \(4,\), got \(3,\)"):
        PINHOLE.unproject(np.ones(3), pixels=np.ones((4, 2)))
    for depth in (-1.0, np.inf):
        with pytest.raises(InputError, match="depth: expected finite numbers >= 0"):
            PINHOLE.unproject(depth, pixels=(1, 2))
        with pytest.raises(InputError, match=r"depth: .*(negative|finite)"):
            PINHOLE.unproject(np.full((48, 64), depth, np.float32))
    with pytest.raises(InputError, match=r"depth: expected shape \(48, 64\)"):
        PINHOLE.unproject(np.ones((64, 48), np.float32))
    with pytest.raises(InputError, match="depth: expected dtype uint16"):
        PINHOLE.unproject(np.ones((48, 64)))
    for wrong in (np.int32([1500]), np.int64(1500), np.uint8(2), [np.int64(1500)]):
        with pytest.raises(InputError, match="depth: expected dtype uint16 or float, got"):
            PINHOLE.unproject(wrong, pixels=[(1, 2)])
    with pytest.raises(InputError, match="got uint16 beside other numbers"):
        PINHOLE.unproject([np.uint16(1500), 1.5], pixels=[(1, 2)] * 2)  # type: ignore[list-item]
    with pytest.raises(InputError, match="threads"):
        PINHOLE.unproject(np.ones((48, 64), np.float32), threads=-1)


def test_nobody_else_in_the_package_writes_the_pinhole_s_formula() -> None:
    package = Path(manip3d.__file__).parent
    formula = re.compile(r"[-+*/]\s*\w+\.[cf][xy]\b|\w\.[cf][xy]\s*[-+*/]")
    # A mirrored principal point, one beside the middle of an image or a crop, a pixel's size on a
    # surface, and how many pixels of one camera are one of another.
    others = {
        "authenticate/_stream_processing.py",
        "experiments/cameras_5.py",
        "io/_intrinsics_files.py",
        "datasets/people.py",
        "modify/_pose.py",
        "simulate/people.py",
    }
    allowed = {"camera.py", *others}
    found = {
        str(path.relative_to(package)): line.strip()
        for path in sorted(package.rglob("*.py"))
        for line in path.read_text().splitlines()
        if formula.search(line)
    }
    assert set(found) == allowed, found


@pytest.mark.parametrize("factor", [0.25, 0.5, 3.0])
def test_a_resized_camera_looks_along_the_same_lines(factor: float) -> None:
    """The image's edge is half a pixel beyond its first pixel's centre, at any size."""
    small = BENT.resized(round(factor * BENT.width), round(factor * BENT.height))
    points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.25, 1.4]])
    edges = BENT.project(points) + 0.5
    np.testing.assert_allclose(small.project(points) + 0.5, factor * edges, atol=1e-9)


@pytest.mark.parametrize("size", [2**31, 2**63, 2**70, -(2**63) - 1])
def test_a_size_that_the_core_cannot_be_asked_about(size: int, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"intrinsics\.width: expected 1 to 16384"):
        Intrinsics(size, 48, 50.0, 50.0, 31.0, 23.0)
    path = tmp_path / "a.json"
    path.write_text(f'{{"width": 64, "height": {size}, "fx": 50, "fy": 50, "cx": 31, "cy": 23}}')
    with pytest.raises(FormatError, match=r"a\.json.*intrinsics.height"):
        camera.read_intrinsics(path, width=64, height=48)


def test_the_same_camera_has_equal_numbers_and_rays() -> None:
    rays = np.zeros((2, 3, 2), np.float32)
    plain = Intrinsics(3, 2, 1.0, 1.0, 1.0, 0.5)
    with_rays = Intrinsics(3, 2, 1.0, 1.0, 1.0, 0.5, rays=rays)
    assert camera.same_camera(plain, Intrinsics(3, 2, 1.0, 1.0, 1.0, 0.5))
    assert not camera.same_camera(plain, Intrinsics(3, 2, 1.0, 1.0, 1.0, 0.6))
    assert camera.same_camera(with_rays, Intrinsics(3, 2, 1.0, 1.0, 1.0, 0.5, rays=rays.copy()))
    assert not camera.same_camera(with_rays, plain)
    assert not camera.same_camera(plain, with_rays)
    assert not camera.same_camera(
        with_rays, Intrinsics(3, 2, 1.0, 1.0, 1.0, 0.5, rays=rays + np.float32(0.1))
    )


STEREO = """cam0=[96.5 0 31.25; 0 96.5 23.5; 0 0 1]
cam1=[96.5 0 34.35; 0 96.5 23.5; 0 0 1]
doffs=3.1
baseline=193.001
width=64
height=48
ndisp=20
isint=0
"""


@pytest.mark.parametrize(
    "content",
    [
        "50 0 31.5\n0 51 23.5\n0 0 1\n",
        "5.0e+01 1e-9 31.5 0\r\n0 51 23.5 0\r\n0 0 1 0\r\n",
        "# a comment of numbers: 1 2 3\n50 0 31.5 0\n0 51 23.5 0\n0 0 1 0\n0 0 0 1",
        "[[50, 0, 31.5],\n [0, 51, 23.5],\n [0, 0, 1]]",
        "50, 51, 31.5, 23.5\n",
    ],
)
def test_cameras_of_numbers_in_a_text(content: str, tmp_path: Path) -> None:
    path = tmp_path / "intrinsics.txt"
    path.write_bytes(content.encode())
    found = camera.read_intrinsics(path, width=64, height=48)
    assert (found.fx, found.fy, found.cx, found.cy) == (50.0, 51.0, 31.5, 23.5)
    assert (found.width, found.height) == (64, 48)
    assert camera.camera_depth_unit(path) == "guess"


def test_the_calibration_of_a_stereo_pair(tmp_path: Path) -> None:
    path = tmp_path / "calib.txt"
    path.write_text(STEREO)
    found = camera.read_intrinsics(path, width=64, height=48)
    assert (found.fx, found.fy, found.cx, found.cy) == (96.5, 96.5, 31.25, 23.5)
    assert camera.camera_depth_unit(path) == "disparity:18.6245965,3.1"
    with pytest.raises(InputError, match="is for 64 x 48 pixels, the image has 32 x 24"):
        camera.read_intrinsics(path, width=32, height=24)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "could not convert"),
        ("1 2 3", "3 numbers"),
        ("1 " * 17, "more than 16 numbers"),
        ("fx fy cx cy", "could not convert"),
        ("0 -1 0\n1 0 0\n0 0 1", "not .fx, 0, cx"),  # a rotation
        ("1 0 0 2\n0 1 0 3\n0 0 1 4\n0 0 0 1", "not .fx, 0, cx"),  # a pose
        ("50 0 31\n0 nan 23\n0 0 1", "fy"),
        (STEREO.replace("doffs", "offset"), "no doffs"),
        (STEREO.replace("baseline=193.001", "baseline=0"), "baseline=0"),
        (STEREO.replace("193.001", "inf"), "baseline=inf"),
        (STEREO.replace("64", "64.5"), "64.5"),
        (" " * (1 << 20) + "1", "more than a mebibyte"),
    ],
)
def test_texts_that_are_no_camera(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.txt"
    path.write_text(content)
    with pytest.raises((FormatError, InputError), match=message):
        camera.read_intrinsics(path, width=64, height=48)


def test_a_camera_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "camera.txt"
    path.write_bytes(b"50 \xff")
    with pytest.raises(FormatError, match="expected a camera as text") as caught:
        camera.read_intrinsics(path, width=64, height=48)
    assert caught.value.byte_offset == 3


@pytest.mark.realdata
def test_the_camera_of_7_scenes(realdata: RealData) -> None:
    path = realdata("rgbd/scene_7scenes_redkitchen/camera-intrinsics.txt")
    found = camera.read_intrinsics(path, width=640, height=480)
    assert (found.fx, found.fy, found.cx, found.cy) == (585.0, 585.0, 320.0, 240.0)


def test_cameras_by_other_names_in_json(tmp_path: Path) -> None:
    """Nerfstudio counts from the first pixel's corner, as COLMAP does; librealsense does not."""
    path = tmp_path / "camera.json"
    path.write_text(
        '{"w": 64, "h": 48, "fl_x": 50, "fl_y": 51, "cx": 32, "cy": 24, "k1": 0.1, "p2": 0.02}'
    )
    found = camera.read_intrinsics(path, width=64, height=48)
    assert (found.fx, found.fy, found.cx, found.cy) == (50.0, 51.0, 31.5, 23.5)
    assert tuple(found.distortion) == (0.1, 0.0, 0.0, 0.02, 0.0)
    path.write_text('{"fx": 50, "fy": 51, "ppx": 31.5, "ppy": 23.5, "coeffs": [0, 0, 0, 0, 0]}')
    found = camera.read_intrinsics(path, width=64, height=48)
    assert (found.cx, found.cy) == (31.5, 23.5)
    assert not any(found.distortion)


@pytest.mark.parametrize(
    "model", ["", "plumb_bob", "rational_polynomial", "radtan", "Brown-Conrady", "OPENCV", "RADIAL"]
)
def test_lenses_of_known_models(model: str, tmp_path: Path) -> None:
    path = tmp_path / "transforms.json"
    camera_of = '"fl_x": 50, "fl_y": 51, "cx": 32, "cy": 24, "k1": 0.1'
    path.write_text(f'{{{camera_of}, "camera_model": "{model}"}}')
    found = camera.read_intrinsics(path, width=64, height=48)
    assert tuple(found.distortion) == (0.1, 0.0, 0.0, 0.0, 0.0)


def test_the_camera_of_instant_ngp(tmp_path: Path) -> None:
    """Its sizes are floats; names of images say nothing about the lens."""
    path = tmp_path / "transforms.json"
    path.write_text(
        '{"fl_x": 50.0, "fl_y": 51.0, "cx": 32.0, "cy": 24.0, "w": 64.0, "h": 48.0, "k1": 0.1, '
        '"k4": 0, "is_fisheye": false, "frames": [{"file_path": "fisheye_room/1.png"}]}'
    )
    with pytest.warns(UserWarning, match="are left out: 'frames'$"):
        found = camera.read_intrinsics(path, width=64, height=48)
    lens = (0.1, 0.0, 0.0, 0.0, 0.0)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5, lens))
    path.write_text('{"fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5, "width": 64.5}')
    with pytest.raises(FormatError, match=r"a size of 64\.5 pixels"):
        camera.read_intrinsics(path, width=64, height=48)


def test_the_matrix_of_stray_scanner(tmp_path: Path) -> None:
    """It is that of the colour images, whose size is nowhere, and the depths have fewer pixels."""
    path = tmp_path / "camera_matrix.csv"
    path.write_text("1450.0, 0.0, 960.0\n0.0, 1450.0, 720.0\n0.0, 0.0, 1.0\n")
    found = camera.read_intrinsics(path, width=1920, height=1440)
    assert camera.same_camera(found, Intrinsics(1920, 1440, 1450.0, 1450.0, 960.0, 720.0))
    told = r"a larger image than 256 x 192 pixels; if that has 1920 x 1440 of .* (193\.333,.*)$"
    with pytest.raises(InputError, match=told) as caught:
        camera.read_intrinsics(path, width=256, height=192)
    numbers = str(caught.value).rpartition(" ")[2]
    at = camera.read_intrinsics(numbers, width=256, height=192)
    assert at.cx == pytest.approx(found.resized(256, 192).cx, abs=1e-3)
    with pytest.raises(InputError, match=r"larger image than 1024 x 768 .* camera is 773\.333,"):
        camera.read_intrinsics(path, width=1024, height=768)  # its centre is within this image
    for width, height in ((192, 256), (1280, 720)):  # no size of the same view
        with pytest.raises(InputError, match=rf"image than {width} x {height} pixels$"):
            camera.read_intrinsics(path, width=width, height=height)
    path.write_text("773.0, 0.0, 512.0\n0.0, 773.0, 384.0\n0.0, 0.0, 1.0\n")
    assert camera.read_intrinsics(path, width=1024, height=768).cx == 512.0  # of another program
    assert camera.camera_depth_unit(path) == "guess"
    path.write_text("timestamp, frame\n0.0, 1\n")
    with pytest.raises(FormatError, match="expected a matrix of 3 x 3, 3 x 4 or 4 x 4 numbers: "):
        camera.read_intrinsics(path, width=256, height=192)


@pytest.mark.parametrize(
    "model", ["NFOV 2x2", "iPhone 13", "D435", "Kinect v1.3", "OmniVision OV9281", "Sphere cam"]
)
def test_the_product_of_a_pinhole_camera_is_no_lens(model: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    for lens in (0.0, 0.1):
        path.write_text(
            f'{{"fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5, "k1": {lens}, "model": "{model}"}}'
        )
        assert camera.read_intrinsics(path, width=64, height=48).distortion[0] == lens


MATRIX = "[[50, 0, 32], [0, 51, 24], [0, 0, 1]]"


@pytest.mark.parametrize(
    "camera_fields",
    [f'"{name}": {MATRIX}' for name in ("intrinsic_matrix", "camera_matrix", "K")]
    + ['"fx": 50, "fy": 51, "cx": 32, "cy": 24'],
)
@pytest.mark.parametrize(
    ("lens", "expected"),
    [
        *((f'"{name}": [0.1, 0, 0, 0.02]', (0.1, 0.0, 0.0, 0.02, 0.0))
          for name in ("D", "dist_coeffs", "distortion", "distortion_coeffs")),
        ('"k1": 0.1, "p2": 0.02', (0.1, 0.0, 0.0, 0.02, 0.0)),
        ('"distortion": {"k1": 0.1, "k3": 0.5}', (0.1, 0.0, 0.0, 0.0, 0.5)),
        ('"coeffs": [0.1, 0, 0, 0, 0], "model": "Brown Conrady"', (0.1, 0.0, 0.0, 0.0, 0.0)),
        ('"distortion": null', (0.0,) * 5),
        ('"distortion": "none", "D": []', (0.0,) * 5),
    ],
)  # fmt: skip
def test_a_lens_is_known_by_all_its_names_beside_any_camera(
    camera_fields: str, lens: str, expected: tuple[float, ...], tmp_path: Path
) -> None:
    path = tmp_path / "camera.json"
    path.write_text(f"{{{camera_fields}, {lens}}}")
    found = camera.read_intrinsics(path, width=64, height=48)
    assert (found.fx, found.cy, found.distortion) == (50.0, 24.0, expected)


@pytest.mark.parametrize(
    "lens",
    ['"k4": 0.1', '"coeffs": [0.1, 0, 0, 0, 0], "model": 2', '"k1": 0.1, "model": "division"'],
)
def test_a_lens_of_another_model_beside_a_matrix_is_refused(lens: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(f'{{"intrinsic_matrix": {MATRIX}, {lens}}}')
    with pytest.raises(FormatError, match=r"distortion|coeffs"):
        camera.read_intrinsics(path, width=64, height=48)


@pytest.mark.parametrize("model", ['"distortion.brown_conrady"', '"Brown Conrady"', "4"])
def test_the_lens_of_librealsense(model: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    lens = (0.1, -0.2, 0.001, 0.0005, 0.05)
    fields = '"fx": 50, "fy": 51, "ppx": 31.5, "ppy": 23.5'
    path.write_text(f'{{{fields}, "coeffs": {[*lens]}, "model": {model}}}')
    assert tuple(camera.read_intrinsics(path, width=64, height=48).distortion) == lens
    inverse = '"distortion.inverse_brown_conrady"'
    path.write_text(f'{{{fields}, "coeffs": [0, 0, 0, 0, 0], "model": {inverse}}}')
    assert not any(camera.read_intrinsics(path, width=64, height=48).distortion)


def test_the_camera_of_replica(tmp_path: Path) -> None:
    path = tmp_path / "cam_params.json"
    fields = '"w": 1200, "h": 680, "fx": 600.0, "fy": 601.0, "cx": 599.5, "cy": 339.5'
    path.write_text(f'{{"camera": {{{fields}, "scale": 6553.5}}}}')
    found = camera.read_intrinsics(path, width=1200, height=680)
    assert camera.same_camera(found, Intrinsics(1200, 680, 600.0, 601.0, 599.5, 339.5))
    assert camera.camera_depth_unit(path) == "6553.5"
    path.write_text(f'{{"camera": {{{fields}, "scale": "large"}}}}')
    with pytest.warns(UserWarning, match="left out: 'depth_scale'"):
        camera.read_intrinsics(path, width=1200, height=680)
    assert camera.camera_depth_unit(path) == "guess"


@pytest.mark.parametrize(
    "size", ["", '"width": 64, "height": 48, ', '"width": 64.0, "height": 48.0, ']
)
def test_the_camera_of_open3d(size: str, tmp_path: Path) -> None:
    """Its matrix is stored column by column."""
    path = tmp_path / "camera.json"
    path.write_text(f'{{{size}"intrinsic_matrix": [50, 0, 0, 0, 51, 0, 31.5, 23.5, 1]}}')
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))
    if size:
        with pytest.raises(InputError, match="is for 64 x 48 pixels, the image has 63 x 48"):
            camera.read_intrinsics(path, width=63, height=48)


@pytest.mark.parametrize(
    "matrix",
    [
        "[50, 0, 31.5, 0, 51, 23.5, 0, 0, 1]",
        "[[50, 0, 31.5], [0, 51, 23.5], [0, 0, 1]]",
        "[[50, 0, 0], [0, 51, 0], [31.5, 23.5, 1]]",
    ],
)
def test_a_matrix_of_open3d_row_by_row_is_read_alike(matrix: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(f'{{"intrinsic_matrix": {matrix}}}')
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))


OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<calibration_time>"Fri 27 Nov"</calibration_time>
<image_width>64</image_width>
<image_height>48</image_height>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    50. 0. 31.5 0. 51. 23.5 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>5</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    0.10000000000000001 -0.20000000000000001 0.001 0.002
    5.0000000000000003e-02</data></distortion_coefficients>
</opencv_storage>
"""
OPENCV_YAML = """%YAML:1.0
---
calibration_time: "Fri 27 Nov"
image_width: 64
image_height: 48
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 50., 0., 31.5, 0., 51., 23.5, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.10000000000000001, -0.20000000000000001, 0.001, 0.002,
       5.0000000000000003e-02 ]
"""
OPENCV_JSON = """{
    "image_width": 64,
    "image_height": 48,
    "camera_matrix": {
        "type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d",
        "data": [ 50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0 ]
    },
    "distortion_coefficients": {
        "type_id": "opencv-matrix", "rows": 1, "cols": 5, "dt": "d",
        "data": [ 0.1, -0.2, 0.001, 0.002, 0.05 ]
    }
}"""
ROS_TOPIC = """header:
  frame_id: camera_depth_optical_frame
height: 48
width: 64
distortion_model: plumb_bob
d:
- 0.1
- -0.2
- 0.001
- 0.002
- 0.05
k: [50.0, 0.0, 31.5, 0.0, 51.0, 23.5, 0.0, 0.0, 1.0]
p: [50.0, 0.0, 31.5, 0.0, 0.0, 51.0, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]
---
"""
BROWN = (0.1, -0.2, 0.001, 0.002, 0.05)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("camera.xml", OPENCV_XML),
        ("camera.yaml", OPENCV_YAML),
        ("camera.yml", OPENCV_YAML.replace("%YAML:1.0", "%YAML 1.2")),
        ("camera.json", OPENCV_JSON),
        ("camera_info.yaml", ROS_TOPIC),
        ("upper.YAML", OPENCV_YAML.replace("camera_matrix", "cameraMatrix")),
    ],
)
def test_cameras_as_opencv_and_ros_store_them(name: str, content: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_text(content)
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5, BROWN))
    with pytest.raises(InputError, match="is for 64 x 48 pixels, the image has 32 x 24"):
        camera.read_intrinsics(path, width=32, height=24)
    assert camera.camera_depth_unit(path) == "guess"


def test_other_names_in_a_calibration(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text("cameraMatrix: [[50, 0, 31.5], [0, 51, 23.5], [0, 0, 1]]\nimageSize: [64, 48]")
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))
    with pytest.raises(InputError, match="is for 64 x 48 pixels"):
        camera.read_intrinsics(path, width=64, height=47)
    path = tmp_path / "metadata.json"  # Record3D's
    path.write_text('{"K": [50, 0, 0, 0, 51, 0, 31.5, 23.5, 1], "w": 64, "h": 48, "fps": 60}')
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))
    with pytest.raises(InputError, match="is for 64 x 48 pixels"):
        camera.read_intrinsics(path, width=48, height=64)
    path = tmp_path / "frame_camera.xml"  # a matrix and a pose, as OpenCV's course programs write
    matrix = "<rows>3</rows><cols>3</cols><dt>f</dt><data>50. 0. 31.5 0. 51. 23.5 0. 0. 1.</data>"
    path.write_text(
        f'<?xml version="1.0"?><opencv_storage><intrinsic type_id="opencv-matrix">{matrix}'
        "</intrinsic><t><rows>3</rows><cols>1</cols><data>0. 0. 1.</data></t></opencv_storage>"
    )
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))
    for other in ('"intrinsics": [[90, 0, 9], [0, 90, 9], [0, 0, 1]]', '"camera": {"fx": 9}'):
        path = tmp_path / "both.json"
        path.write_text(f'{{"fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5, {other}}}')
        with pytest.warns(UserWarning, match="left out"):
            found = camera.read_intrinsics(path, width=64, height=48)
        assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))
    path = tmp_path / "view.json"  # Open3D's PinholeCameraParameters
    matrix = "[50.0, 0.0, 0.0, 0.0, 51.0, 0.0, 31.5, 23.5, 1.0]"
    size = '"height": 48, "width": 64'
    path.write_text(
        f'{{"class_name": "PinholeCameraParameters", "extrinsic": [1.0], "version_major": 1, '
        f'"intrinsic": {{{size}, "intrinsic_matrix": {matrix}}}}}'
    )
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))


def _matrix(name: str, rows: int, cols: int, numbers: str) -> str:
    shape = f"   rows: {rows}\n   cols: {cols}\n   dt: d\n"
    return f"{name}: !!opencv-matrix\n{shape}   data: [{numbers}]\n"


LEFT = "50., 0., 31.5, 0., 51., 23.5, 0., 0., 1."
LENS = "0.1, -0.2, 0.001, 0.002, 0.05"


@pytest.mark.parametrize(
    "names", ["M D", "K D", "cameraMatrix distCoeffs", "camera_matrix_ dist_coeffs_"]
)
def test_the_left_camera_of_a_stereo_pair_is_taken(names: str, tmp_path: Path) -> None:
    matrix, lens = names.split()
    sides = ("left", "right") if matrix.endswith("_") else ("1", "2")
    text = "%YAML:1.0\n---\n"
    for side, numbers in zip(sides, (LEFT, LEFT.replace("50.", "52.")), strict=True):
        text += _matrix(matrix + side, 3, 3, numbers) + _matrix(lens + side, 1, 5, LENS)
    path = tmp_path / "stereo.yml"
    path.write_text(text + "R: [1, 0, 0]\n")
    with pytest.warns(UserWarning, match="stereo pair; the camera is that of its left") as caught:
        found = camera.read_intrinsics(path, width=64, height=48)
    assert [Path(warning.filename).name for warning in caught] == [Path(__file__).name]
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5, BROWN))
    path.write_text(text + "image_width: 32\nimage_height: 24\n")
    with pytest.warns(match="stereo"), pytest.raises(InputError, match="is for 32 x 24 pixels"):
        camera.read_intrinsics(path, width=64, height=48)


@pytest.mark.parametrize("whole", [False, True])
def test_depth_of_a_stereo_pair_is_that_of_rectified_images(whole: bool, tmp_path: Path) -> None:
    path = tmp_path / "extrinsics.yml"
    planar = "48., 0., 30.5, 0., 0., 48., 22.5, 0., 0., 0., 1., 0."
    text = "%YAML:1.0\n---\n" + _matrix("P1", 3, 4, planar)
    text += _matrix("P2", 3, 4, planar.replace("30.5, 0.", "30.5, -90."))
    path.write_text(text + whole * (_matrix("M1", 3, 3, LEFT) + _matrix("D1", 1, 5, LENS)))
    with pytest.warns(UserWarning, match="that of its rectified left image, P1"):
        found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 48.0, 48.0, 30.5, 22.5))


def test_the_camera_of_rectified_images_is_told(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_text(ROS_TOPIC.replace("p: [50.0", "p: [48.5"))
    with pytest.warns(UserWarning, match=r"of a rectified one is 48\.5,51,31\.5,23\.5") as caught:
        found = camera.read_intrinsics(path, width=64, height=48)
    assert [Path(warning.filename).name for warning in caught] == [Path(__file__).name]
    assert (found.fx, found.distortion) == (50.0, BROWN)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.yaml", ROS_TOPIC.replace("plumb_bob", "equidistant"), "a fisheye camera"),
        ("a.yaml", ROS_TOPIC.replace("plumb_bob", "fisheyePolynomial"), "a fisheye camera"),
        ("a.yaml", ROS_TOPIC.replace("plumb_bob", "kannala_brandt4"), "a fisheye camera"),
        ("a.yaml", ROS_TOPIC.replace("plumb_bob", "fov"), "a fisheye camera .fov"),
        ("a.yaml", ROS_TOPIC.replace("plumb_bob", "thin_prism_fisheye"), "a fisheye camera"),
        ("a.yaml", ROS_TOPIC.replace("plumb_bob", "other"), "a distortion of the model 'other'"),
        ("a.yaml", OPENCV_YAML + "fisheye_model: 1\n", "a fisheye camera"),
        ("a.yaml", ROS_TOPIC.replace("- 0.05", "- 0.05\n- 0.1"), "a distortion of more than k1"),
        ("a.xml", OPENCV_XML.replace("e-02", "e-02 0.1"), "a distortion of more than k1"),
        ("a.yaml", OPENCV_YAML.replace("50., 0.", "50., 9."), "not .fx, 0, cx"),
        ("a.yaml", OPENCV_YAML.replace("50., ", ""), "a camera_matrix of 8 numbers"),
        ("a.yaml", OPENCV_YAML.replace("[ 50.", "[ .nan"), "fx"),
        ("a.yaml", OPENCV_YAML.replace("64", ".inf"), "a size of inf pixels"),
        ("a.yaml", OPENCV_YAML.replace("64", "64.5"), "a size of 64.5 pixels"),
        ("a.yaml", OPENCV_YAML.replace("64", "[64]"), "float"),
        ("a.yaml", "k: {data: {data: 1}}", "camera_matrix of|expected"),
        ("a.yaml", "camera_matrix: text", "could not convert"),
        ("a.yaml", "1: 2", "no fx and no fy and no cx and no cy"),
        ("a.yaml", "", "no object"),
        ("a.yaml", "a: &a [1]\nb: *a", "aliases are refused"),
        ("a.yaml", "a: !!python/object/apply:os.getcwd []", "not YAML"),
        ("a.yaml", "[" * 5000, "not YAML|nested too deep"),
        ("a.yaml", "a: " + " " * (128 << 10), "expected at most"),
        ("a.xml", '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "external DTDs are refused"),
        ("a.xml", "<a>" * 100, "nested deeper"),
        ("a.xml", "<a/>", "no object"),
        ("a.json", "{}", "no fx and no fy and no cx and no cy"),
        ("a.json", '{"k": 1e999}', "camera_matrix of 1 numbers"),
        ("a.json", '{"intrinsic_matrix": [50, 0, 9, 0, 51, 0, 9, 9, 1]}', "a matrix that is not"),
    ],
)
def test_files_that_are_no_calibration(
    name: str, content: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(FormatError, match=message) as caught:
        camera.read_intrinsics(path, width=64, height=48)
    assert caught.value.file == str(path)


COLMAP = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 2
1 PINHOLE 64 48 50 51 32 24
2 SIMPLE_RADIAL 128 96 100 64 48 0.01
"""


def test_the_cameras_of_colmap(tmp_path: Path) -> None:
    """Its pixels have their corners at integers, not their centres."""
    path = tmp_path / "cameras.txt"
    path.write_text(COLMAP)
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5))
    found = camera.read_intrinsics(path, width=128, height=96)
    bent = (0.01, 0.0, 0.0, 0.0, 0.0)
    assert camera.same_camera(found, Intrinsics(128, 96, 100.0, 100.0, 63.5, 47.5, bent))
    with pytest.raises(InputError, match="is for 64 x 48 pixels, the image has 32 x 24"):
        camera.read_intrinsics(path, width=32, height=24)
    path.write_text("7 FULL_OPENCV 64 48 50 51 32 24 .1 -.2 .001 .002 .05 0 0 0\r\n")
    found = camera.read_intrinsics(path, width=64, height=48)
    assert camera.same_camera(found, Intrinsics(64, 48, 50.0, 51.0, 31.5, 23.5, BROWN))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("1 OPENCV_FISHEYE 64 48 50 51 32 24 0 0 0 0", "OPENCV_FISHEYE with 8 numbers; known"),
        ("1 PINHOLE 64 48 50 51 32", "PINHOLE with 3 numbers; known"),
        ("1 FULL_OPENCV 64 48 50 51 32 24 0 0 0 0 0 .1 0 0", "a distortion of more than k1"),
        ("1 PINHOLE 64 48 50 51 32 24\n2 PINHOLE 64 48 50 51 32 25", "2 different cameras of 64"),
        ("1 PINHOLE 64 48 50 51 x 24", "could not convert"),
    ],
)
def test_cameras_of_colmap_that_are_refused(content: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "cameras.txt"
    path.write_text(content)
    with pytest.raises(FormatError, match=message):
        camera.read_intrinsics(path, width=64, height=48)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ('"coeffs": [0, 0, 0, 0.1, 0]', "coeffs without a model; the one that can be read is"),
        (
            '"coeffs": [0, 0, 0, 0.1, 0], "model": "distortion.inverse_brown_conrady"',
            "coeffs of the model 'inverse_brown_conrady'; the one",
        ),
        ('"coeffs": [0.1, 0, 0, 0, 0], "model": "Modified Brown Conrady"', "model 'Modified Brown"),
        ('"coeffs": [0.1, 0, 0, 0, 0], "model": 2', "coeffs of the model '2'; the one"),
        ('"coeffs": [0, 0, 0, 0, 0], "model": "F-Theta"', "a fisheye camera .F-Theta"),
        ('"coeffs": [0.1, 0, 0, 0, 0, 0.1], "model": "brown_conrady"', "a distortion of more than"),
        ('"k4": 0.1', "a distortion of more than k1"),
        ('"camera_model": "OPENCV_FISHEYE"', "a fisheye camera .OPENCV_FISHEYE"),
        ('"camera_model": "equidistant", "k1": 0.1', "a fisheye camera .equidistant"),
        ('"camera_model": "EQUIRECTANGULAR"', "no pinhole camera .EQUIRECTANGULAR"),
        ('"camera_model": "ORTHOPHOTO"', "no pinhole camera .ORTHOPHOTO"),
        ('"camera_model": "SPHERICAL"', "no pinhole camera .SPHERICAL"),
        ('"camera_model": "omnidir"', "a fisheye camera .omnidir"),
        ('"camera_model": "Omni"', "a fisheye camera .Omni"),
        ('"camera_model": "double_sphere"', "a fisheye camera .double_sphere"),
        ('"camera_model": "D435", "k1": 0.1', "a distortion of the model 'D435'"),
        ('"model": "distortion.ftheta"', "a fisheye camera .distortion.ftheta"),
        (
            '"model": "RS2_DISTORTION_INVERSE_BROWN_CONRADY", "k1": 0.1',
            "a distortion of the model",
        ),
        ('"coeffs": [0.1, 0, 0, 0, 0], "model": "Azure v1.4"', "coeffs of the model 'Azure v1.4'"),
        ('"is_fisheye": true, "k1": 0.1', "a fisheye camera"),
        ('"coeffs": [0, 0, 0, 0, 0], "model": 5', "a fisheye camera .5"),
        ('"model": "FOV", "k1": 0.9', "a fisheye camera .FOV"),
        ('"model": "DIVISION", "k1": 0.1', "a distortion of the model 'DIVISION'; those that can"),
    ],
)
def test_lenses_that_the_formula_does_not_have(fields: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text(f'{{"fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5, {fields}}}')
    with pytest.raises(FormatError, match=message):
        camera.read_intrinsics(path, width=64, height=48)


@pytest.mark.parametrize(
    ("scale", "unit"),
    [
        (0.001, "1000"),  # librealsense
        (0.00025, "4000"),
        (0.1, "10000"),  # BOP
        (1.0, "1000"),
        (5000.0, "5000"),  # Open3D
    ],
)
def test_the_scale_of_depths_beside_a_camera_is_their_unit(
    scale: float, unit: str, tmp_path: Path
) -> None:
    path = scaled_camera(tmp_path, str(scale))
    assert camera.camera_depth_unit(path) == unit
    assert camera.read_intrinsics(path, width=64, height=48).fx == 50.0  # and no warning
    np.save(tmp_path / "a.npy", np.full((48, 64), 12_000, np.uint16))
    options = manip3d.simplify.DepthOptions(9, intrinsics=str(path))
    found = manip3d.simplify.simplify_depth_file(tmp_path / "a.npy", tmp_path / "a.ply", options)
    assert found.depth_found.near == pytest.approx(12_000 / float(unit), rel=1e-6)


@pytest.mark.parametrize("scale", ["50.0", "NaN", "1" + 400 * "0"])
def test_a_scale_of_depths_that_is_none_is_left_out(scale: str, tmp_path: Path) -> None:
    path = scaled_camera(tmp_path, scale)
    assert camera.camera_depth_unit(path) == "guess"
    with pytest.warns(UserWarning, match="left out: 'depth_scale'"):
        assert camera.read_intrinsics(path, width=64, height=48).fx == 50.0


def scaled_camera(folder: Path, scale: str) -> Path:
    path = folder / "camera.json"
    path.write_text(f'{{"fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5, "depth_scale": {scale}}}')
    return path


def test_the_fields_that_are_left_out_are_named(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    known = '"fx": 50, "fy": 51, "cx": 31.5, "cy": 23.5, "k1": 0.1, "k4": 0'
    path.write_text(f'{{{known}, "a": 0, "b": 0, "c": 0, "d": 0}}')
    with pytest.warns(UserWarning, match="left out: 'a', 'b', 'c', 'd'$") as caught:
        found = camera.read_intrinsics(path, width=64, height=48)
    assert found.distortion == (0.1, 0.0, 0.0, 0.0, 0.0)
    assert [Path(warning.filename).name for warning in caught] == [Path(__file__).name]
    path.write_text(f'{{{known}, "a": 0, "b": 0, "c": 0, "d": 0, "e": 0, "f": 0}}')
    with pytest.warns(UserWarning, match="left out: 'a', 'b', 'c', 'd', 'e', ...$"):
        camera.read_intrinsics(path, width=64, height=48)


def test_a_skew_is_what_rounding_left_or_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.txt"
    for skew in (0.05, -0.05):
        path.write_text(f"50 {skew} 31.5\n0 51 23.5\n0 0 1\n")
        assert camera.read_intrinsics(path, width=64, height=48).fx == 50.0
    for matrix in (
        "50 0.0501 31.5\n0 51 23.5\n0 0 1\n",
        "50 0 31.5\n0.1 51 23.5\n0 0 1\n",
        "50 0 31.5\n0 51 23.5\n0.1 0 1\n",
        "50 0 31.5\n0 51 23.5\n0 0.1 1\n",
        "50 0 31.5 0\n0 51 23.5 0\n0 0 1 0\n0 0.1 0 1\n",
    ):
        path.write_text(matrix)
        with pytest.raises(FormatError, match=r"not \(fx, 0, cx"):
            camera.read_intrinsics(path, width=64, height=48)


def test_what_is_told_of_a_bad_camera() -> None:
    for name in ("fx", "fy", "cx", "cy"):
        numbers = {"fx": 1.0, "fy": 1.0, "cx": 0.5, "cy": 0.5, name: "wide"}
        with pytest.raises(InputError, match=rf"intrinsics\.{name}: expected a number, got 'wide'"):
            Intrinsics(4, 3, **numbers)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"intrinsics\.distortion: expected a number"):
        Intrinsics(4, 3, 1.0, 1.0, 0.5, 0.5, (0.0, 0.0, 0.0, 0.0, None))  # type: ignore[arg-type]
    for width in (True, 4.0):
        with pytest.raises(InputError, match=r"intrinsics\.width: expected a whole number"):
            Intrinsics(width, 3, 1.0, 1.0, 0.5, 0.5)  # type: ignore[arg-type]
    rays = np.zeros((3, 4, 2), np.float64)
    assert Intrinsics(4, 3, 1.0, 1.0, 0.5, 0.5, rays=rays).rays.dtype == np.float32  # type: ignore[union-attr]


def test_a_camera_of_another_size_tells_what_it_would_be(tmp_path: Path) -> None:
    path = tmp_path / "camera.json"
    path.write_text('{"width": 128, "height": 96, "fx": 100, "fy": 102, "cx": 63.5, "cy": 47.5}')
    with pytest.raises(InputError, match=r"the same view, its camera is 50,51,31\.5,23\.5"):
        camera.read_intrinsics(path, width=64, height=48)
    with pytest.raises(InputError, match=r"the image has 64 x 64$"):
        camera.read_intrinsics(path, width=64, height=64)


@pytest.mark.parametrize("dtype", [">u2", "<u2", ">f4", "<f4"])
def test_depth_images_may_have_either_byte_order(dtype: str) -> None:
    """16-bit PGM and PNG files are big-endian, and so are the arrays that are views of them."""
    depth = np.arange(1, 64 * 48 + 1).reshape(48, 64)
    native = depth.astype(np.dtype(dtype).newbyteorder("="))
    np.testing.assert_array_equal(PINHOLE.unproject(depth.astype(dtype)), PINHOLE.unproject(native))


@pytest.mark.parametrize(
    "name", ["tum", "kinect-v1", "kinect-v2", "azure", "realsense", "primesense"]
)
def test_nominal_cameras_look_through_the_middle_of_their_pixels(name: str) -> None:
    for each in camera.CAMERA_PRESETS[name].cameras:
        assert (each.cx, each.cy) == ((each.width - 1) / 2, (each.height - 1) / 2)
