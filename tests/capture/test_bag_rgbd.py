"""RGB-D cameras in ROS bags: what was written is read to the bit, and where the colours belong."""

from __future__ import annotations

import contextlib
import io
import json
import sqlite3
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from command_line import error_line, manip3d
from manip3d import FormatError, InputError, Intrinsics, RgbdCalibration, capture
from manip3d.cli.kinds import kind_of
from real_data import RealData

pytest.importorskip("rosbags.rosbag1", reason="the extra 'bags' is not installed")
PIL_Image = pytest.importorskip("PIL.Image", reason="the extra 'io' is not installed")

from rosbags import rosbag2  # noqa: E402

import ros_bags  # noqa: E402
from ros_bags import (  # noqa: E402
    COLORS,
    COMPRESSED,
    IMAGE,
    INFO,
    PROJECTION,
    SDK_START_NS,
    TEXT,
    TRANSFORMS,
    TYPES,
    camera_info,
    colors,
    compressed,
    header,
    image,
    message,
    millimetres,
    points_of,
    realsense,
    realsense_ros2,
    torn,
    transform,
    write_bag,
    write_mixed_bag,
)

Message = tuple[float, str, str, Any]
DEPTH, COLOR = "/camera/depth/image_raw", "/camera/color/image_raw"
POSE = np.eye(4)  # T_depth_color
POSE[:3, :3] = [[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]]
POSE[:3, 3] = 0.05, 0.01, 0.002

pytestmark = pytest.mark.usefixtures("forked_readers")


def info(matrix: NDArray[np.float64], frame: str, size: tuple[int, int], **changed: Any) -> Any:
    return replace(camera_info(matrix, frame), **{"width": size[0], "height": size[1]} | changed)


def depth_at(time: float, stored: NDArray[Any], encoding: str = "16UC1", **changed: Any) -> Message:
    rows = stored.view(np.uint8).reshape(*stored.shape, stored.dtype.itemsize)
    made = replace(image(rows, encoding, time), width=stored.shape[1], **changed)
    return time, DEPTH, IMAGE, replace(made, header=header(time, "depth"))


def color_at(time: float, number: int) -> Message:
    made = image(colors(number)[..., ::-1], "bgr8", time)
    return time, COLOR, IMAGE, replace(made, header=header(time, "color"))


def cameras(**changed: Any) -> list[Message]:
    tree = TYPES.types[TRANSFORMS]
    known = [transform("depth", "color", POSE)]
    return [
        (0.0, "/camera/depth/camera_info", INFO, info(PROJECTION, "depth", (64, 48), **changed)),
        (0.0, "/camera/color/camera_info", INFO, info(COLORS, "color", (82, 62))),
        (0.0, "/tf_static", TRANSFORMS, tree(known)),
    ]


def bag_of(path: Path, messages: Sequence[Message]) -> str:
    return f"rgbd-bag:{write_mixed_bag(path / 'bag', messages)}"


def test_depth_and_the_colours_of_the_nearest_time(tmp_path: Path) -> None:
    messages = cameras()
    for number in range(4):
        messages += [depth_at(1 + 0.1 * number, millimetres(number))]
        # Nearer to the next depth image, and to no other one.
        messages += [color_at(1.08 + 0.1 * number, number)] if number < 1 else []
    messages += [depth_at(1.5, millimetres(4))]
    source = capture.open_rgbd(bag_of(tmp_path, messages))
    assert source.num_frames == 5
    for _ in range(2):
        frames = list(source)
        assert [f.number for f in frames] == [0, 1, 2, 3, 4]
        assert [f.time_ns for f in frames] == [round(1e9 + n * 1e8) for n in (0, 1, 2, 3, 5)]
        for number, frame in enumerate(frames):
            assert np.array_equal(frame.depth, millimetres(number))
        assert [f.color is not None for f in frames] == [False, True, False, False, False]
        assert np.array_equal(frames[1].color, colors(0))  # type: ignore[arg-type]
        assert source.counters["without_color"] == 4
        source.start()
        assert source.counters["without_color"] == 0
    assert np.array_equal(source[3].depth, millimetres(3))
    later = capture.open_rgbd(source.uri, start=3)
    assert [f.number for f in later] == [3, 4]
    camera = source.calibration.depth
    assert (camera.width, camera.height) == (64, 48)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (60.0, 61.0, 31.5, 23.5)
    registration = source.calibration.registration
    assert registration is not None
    assert (registration.color.width, registration.color.fx) == (82, 80.0)
    to_color = np.linalg.inv(POSE)
    np.testing.assert_allclose(registration.rotation, to_color[:3, :3], atol=1e-12)
    np.testing.assert_allclose(registration.translation, to_color[:3, 3], atol=1e-12)


def test_each_depth_image_takes_the_nearer_one_of_two_pictures(tmp_path: Path) -> None:
    messages = [*cameras(), color_at(1.0, 0), color_at(1.1, 1)]
    messages += [depth_at(1.04, millimetres(0)), depth_at(1.06, millimetres(1))]
    frames = list(capture.open_rgbd(bag_of(tmp_path, messages)))
    for number, frame in enumerate(frames):
        assert np.array_equal(frame.color, colors(number))  # type: ignore[arg-type]


def plain(topic: str, frame: str, value: int, time: float = 1.0) -> list[Message]:
    """One picture of one colour, and its camera."""
    pixels = np.full((62, 82, 3), value, np.uint8)
    made = replace(image(pixels, "8UC3", time), header=header(time, frame))
    told = info(COLORS, frame, (82, 62))
    return [
        (0.0, f"{topic.rpartition('/')[0]}/camera_info", INFO, told),
        (time, topic, IMAGE, made),
    ]


def colors_of(path: Path, messages: Sequence[Message]) -> list[int | None]:
    frames = capture.open_rgbd(bag_of(path, messages))
    return [None if frame.color is None else int(frame.color[0, 0, 0]) for frame in frames]


def test_of_a_robots_cameras_the_one_beside_the_depth_is_taken(tmp_path: Path) -> None:
    far = np.eye(4)
    far[:3, 3] = 3.0, 0.0, 0.0
    places = [transform("depth", "color", POSE), transform("depth", "arm", far)]
    depth = [cameras()[0], (0.0, "/tf_static", TRANSFORMS, TYPES.types[TRANSFORMS](places))]
    depth.append(depth_at(1.0, millimetres(0)))
    arm = plain("/arm/image_raw", "arm", 10)
    for name, other in (
        ("name", plain(COLOR, "color", 20)),
        ("frame", plain("/z/image_raw", "depth", 20)),
        ("place", plain("/z/image_raw", "color", 20)),
    ):
        (tmp_path / name).mkdir()
        assert colors_of(tmp_path / name, [*depth, *arm, *other]) == [20]


def numbered_colors(times: Mapping[int, float]) -> list[Message]:
    """Pictures whose levels are their numbers."""
    return [plain(COLOR, "color", number, time)[1] for number, time in times.items()]


def test_depth_images_whose_colours_were_lost_have_none(tmp_path: Path) -> None:
    """Thirty images a second; the colours come 5 ms after the depth, and five of them are lost."""
    kept = {n: 1.005 + n / 30 for n in range(12) if not 2 <= n <= 6}
    depth = [depth_at(1.0 + n / 30, millimetres(n)) for n in range(12)]
    messages = [*cameras(), *depth, *numbered_colors(kept)]
    expected = [0, 1, *[None] * 5, 7, 8, 9, 10, 11]
    ordered = sorted(messages, key=lambda each: each[0])
    assert colors_of(tmp_path, ordered) == expected
    told = json.loads(manip3d("capture", "info", tmp_path / "bag", "--json").stdout)
    assert (told["with"]["colour"], told["counters"]["without_color"]) == (7, 5)


def test_without_a_colour_camera_no_frame_lacks_its_colour(tmp_path: Path) -> None:
    """Folders of images without colour have no such counter either."""
    depth = [depth_at(1.0 + n / 30, millimetres(n)) for n in range(3)]
    source = capture.open_rgbd(bag_of(tmp_path, [*cameras(), *depth]))
    assert [frame.color for frame in source] == [None] * 3
    assert "without_color" not in source.counters


@pytest.mark.parametrize(("rate", "offset"), [(15, 0.030), (30, 0.015), (30, -0.015), (60, 0.005)])
def test_cameras_that_are_not_synchronised_have_one_colour_image_each(
    rate: int, offset: float, tmp_path: Path
) -> None:
    depth = [depth_at(1.0 + n / rate, millimetres(n)) for n in range(12)]
    taken = numbered_colors({n: 1.0 + offset + n / rate for n in range(12)})
    messages = sorted([*cameras(), *depth, *taken], key=lambda each: each[0])
    assert colors_of(tmp_path, messages) == list(range(12))


def test_of_a_faster_depth_camera_the_nearest_images_have_colours(tmp_path: Path) -> None:
    """Thirty depth images a second and fifteen colours, 10 ms after each second depth image."""
    depth = [depth_at(1.0 + n / 30, millimetres(n)) for n in range(12)]
    taken = numbered_colors({n: 1.01 + n / 15 for n in range(6)})
    messages = sorted([*cameras(), *depth, *taken], key=lambda each: each[0])
    expected = [n // 2 if n % 2 == 0 else None for n in range(12)]
    assert colors_of(tmp_path, messages) == expected


def test_colours_of_a_slow_camera_are_at_most_a_fifth_of_a_second_away(tmp_path: Path) -> None:
    depth = [depth_at(float(n), millimetres(n)) for n in range(1, 5)]
    taken = numbered_colors({1: 1.19, 2: 2.21, 3: 3.3, 4: 3.9})
    messages = sorted([*cameras(), *depth, *taken], key=lambda each: each[0])
    assert colors_of(tmp_path, messages) == [1, None, None, 4]


def test_depth_images_that_come_late_still_get_the_colours_of_their_time(tmp_path: Path) -> None:
    """They were published 0.4 s after the colours, of which there are thirty a second."""
    sent = []
    for number in range(48):
        (_, topic, kind, made) = plain(COLOR, "color", number, 1.0 + number / 30)[1]
        sent.append((number / 30, topic, kind, made))
    for number in range(0, 48, 6):
        (_, topic, kind, made) = depth_at(1.0 + number / 30, millimetres(0))
        sent.append((number / 30 + 0.4, topic, kind, made))
    messages = [*cameras(), *sorted(sent, key=lambda each: each[0])]
    assert colors_of(tmp_path, messages) == list(range(0, 48, 6))


def test_metres_are_rounded_to_millimetres(tmp_path: Path) -> None:
    metres = np.full((48, 64), 1.2346, np.float32)
    metres[0, :6] = np.nan, np.inf, -1.0, 0.0, 65.5354, 65.536
    messages = [*cameras(), depth_at(1.0, metres, "32FC1")]
    messages += [depth_at(2.0, metres.astype(">f4"), "32FC1", is_bigendian=1)]
    frames = list(capture.open_rgbd(bag_of(tmp_path, messages)))
    for frame in frames:
        assert frame.depth[0, :6].tolist() == [0, 0, 0, 0, 65535, 0]
        assert (frame.depth[1:] == 1235).all()


@pytest.mark.parametrize("units", [None, 500.0])
def test_pixels_of_65535_are_not_measured(tmp_path: Path, units: float | None) -> None:
    """In units of 2 mm they would be beyond what a frame can hold; so is the pixel of 65534."""
    marked = millimetres(0)
    marked[0, :4] = 65535, 65535, 65534, 900
    uri = bag_of(tmp_path, [*cameras(), depth_at(1.0, marked)])
    (frame,) = capture.open_rgbd(uri, units_per_metre=units)
    assert frame.depth[0, :4].tolist() == ([0, 0, 65534, 900] if units is None else [0, 0, 0, 1800])


def test_the_unit_can_be_given(tmp_path: Path) -> None:
    uri = bag_of(tmp_path, [*cameras(), depth_at(1.0, millimetres(0))])
    (frame,) = capture.open_rgbd(uri, units_per_metre=5000)
    assert np.array_equal(frame.depth, np.rint(millimetres(0) / 5.0))


def test_depth_that_speaks_against_millimetres_is_told(tmp_path: Path) -> None:
    far = np.full((48, 64), 30_000, np.uint16)
    uri = bag_of(tmp_path, [*cameras(), depth_at(1.0, far)])
    with pytest.warns(UserWarning, match="the median of the depth is 30 m with the 1000 units"):
        list(capture.open_rgbd(uri))
    (frame,) = capture.open_rgbd(uri, units_per_metre=10_000)
    assert frame.depth[0, 0] == 3000


def packed(stored: NDArray[np.uint16], a: float = 0.0, b: float = 0.0) -> bytes:
    stream = io.BytesIO()
    PIL_Image.fromarray(stored).save(stream, "PNG")
    return struct.pack("<iff", 0, a, b) + stream.getvalue()


def test_compressed_depth(tmp_path: Path) -> None:
    topic = f"{DEPTH}/compressedDepth"
    metres = np.linspace(0.5, 4.0, 48 * 64).reshape(48, 64)
    inverse = np.rint(900.0 / metres + 3.0).astype(np.uint16)
    inverse[0, 0] = 0
    for kind, data, expected, within in (
        ("16UC1; compressedDepth", packed(millimetres(0)), millimetres(0), 0.0),
        ("32FC1; compressedDepth png", packed(inverse, 900.0, 3.0), 1000 * metres, 9.0),
    ):
        made = replace(compressed(data, kind, 1.0), header=header(1.0, "depth"))
        uri = bag_of(tmp_path / kind[:5], [*cameras(), (1.0, topic, COMPRESSED, made)])
        (frame,) = capture.open_rgbd(uri)
        assert np.abs(frame.depth - expected).ravel()[1:].max() <= within
    assert frame.depth[0, 0] == 0
    rvl = replace(compressed(b"12345678", "16UC1; compressedDepth rvl", 1.0))
    uri = bag_of(tmp_path / "rvl", [*cameras(), (1.0, topic, COMPRESSED, rvl)])
    with pytest.raises(FormatError, match=r"frame 0: .*expected a PNG in compressedDepth"):
        list(capture.open_rgbd(uri))
    for cut in (5, 12, 40):
        short = compressed(packed(millimetres(0))[:cut], "16UC1; compressedDepth", 1.0)
        uri = bag_of(tmp_path / f"cut{cut}", [*cameras(), (1.0, topic, COMPRESSED, short)])
        with pytest.raises(FormatError, match="frame 0"):
            list(capture.open_rgbd(uri))


def test_of_several_depth_topics_one_is_chosen(tmp_path: Path) -> None:
    other = "/aligned/depth/image_raw"
    _, _, kind, made = depth_at(1.0, millimetres(1))
    both = [*cameras(), depth_at(1.0, millimetres(0)), (1.0, other, kind, made)]
    both += [(0.0, "/aligned/depth/camera_info", INFO, info(COLORS, "depth", (64, 48)))]
    uri = bag_of(tmp_path, both)
    with pytest.raises(InputError, match=f"#TOPIC.*{other}, {DEPTH}"):
        capture.open_rgbd(uri)
    with pytest.raises(InputError, match="#TOPIC"):
        capture.open_rgbd(f"{uri}#{COLOR}")
    source = capture.open_rgbd(f"{uri}#{other}")
    assert source.calibration.depth.fx == 80.0
    assert np.array_equal(next(iter(source)).depth, millimetres(1))


def test_colours_of_the_depth_cameras_own_pixels_need_no_registration(tmp_path: Path) -> None:
    pixels = np.random.default_rng(5).integers(0, 256, (48, 64, 3), np.uint8)
    made = replace(image(pixels, "rgb8", 1.0), header=header(1.0, "depth"))
    same = (0.0, "/camera/color/camera_info", INFO, info(PROJECTION, "depth", (64, 48)))
    messages = [cameras()[0], same, depth_at(1.0, millimetres(0)), (1.0, COLOR, IMAGE, made)]
    source = capture.open_rgbd(bag_of(tmp_path, messages))
    assert source.calibration.registration is None
    assert np.array_equal(next(iter(source)).color, pixels)  # type: ignore[arg-type]


def test_colours_whose_place_is_unknown_are_left_out_with_a_warning(tmp_path: Path) -> None:
    messages = [*cameras()[:2], depth_at(1.0, millimetres(0)), color_at(1.0, 0)]
    uri = bag_of(tmp_path, messages)
    with pytest.warns(UserWarning, match=r"no colour: /tf_static does not lead from 'color'"):
        source = capture.open_rgbd(uri)
    assert next(iter(source)).color is None


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"k": np.zeros(9)}, "the camera is not calibrated"),
        ({"width": 0}, "width"),
        ({"d": np.full(4, 0.1), "distortion_model": "equidistant"}, "'equidistant' is not known"),
        ({"d": np.full(8, 0.1), "distortion_model": "rational_polynomial"}, "rational_polynomial"),
        ({"d": np.full(8, 0.1), "distortion_model": "plumb_bob"}, "more than k1, k2, p1, p2 and"),
    ],
)
def test_a_camera_that_is_not_known_can_be_given(
    tmp_path: Path, changed: dict[str, Any], reason: str
) -> None:
    uri = bag_of(tmp_path, [cameras(**changed)[0], depth_at(1.0, millimetres(0))])
    with pytest.raises(FormatError, match=reason):
        capture.open_rgbd(uri)
    camera = Intrinsics(64, 48, 70.0, 70.0, 32.0, 24.0)
    for given in (camera, RgbdCalibration(camera)):
        assert capture.open_rgbd(uri, camera=given).calibration.depth == camera
    bare = bag_of(tmp_path / "bare", [depth_at(1.0, millimetres(0))])
    with pytest.raises(FormatError, match="no CameraInfo /camera/depth/camera_info beside"):
        capture.open_rgbd(bare)
    assert len(list(capture.open_rgbd(bare, camera=camera))) == 1


@pytest.mark.parametrize(
    "model",
    ["", "plumb_bob", "Brown Conrady", "brown_conrady", "radtan", "rational_polynomial"],
)
def test_lenses_with_five_coefficients_of_brown(model: str, tmp_path: Path) -> None:
    lens = np.array([0.1, 0.02, 0.0, 0.01, 0.003, 0.0, 0.0, 0.0])
    told = cameras(d=lens, distortion_model=model)
    camera = capture.open_rgbd(bag_of(tmp_path, [*told, depth_at(1.0, millimetres(0))]))
    assert tuple(camera.calibration.depth.distortion) == tuple(lens[:5])


def test_rectified_images_have_the_camera_of_their_projection(tmp_path: Path) -> None:
    distorted = info(PROJECTION, "depth", (64, 48), d=np.full(5, 0.1), k=np.eye(3).reshape(-1))
    time, _, kind, made = depth_at(1.0, millimetres(0))
    messages = [
        (0.0, "/camera/depth/camera_info", INFO, distorted),
        (time, "/camera/depth/image_rect", kind, made),
    ]
    camera = capture.open_rgbd(bag_of(tmp_path, messages)).calibration.depth
    assert (camera.fx, camera.fy, tuple(camera.distortion)) == (60.0, 61.0, (0.0,) * 5)


def test_images_that_do_not_fit_name_the_frame_and_the_file(tmp_path: Path) -> None:
    for name, changed, reason in (
        ("cut", {"data": np.zeros(10, np.uint8)}, "do not fit 10 bytes"),
        ("step", {"step": 100}, "rows of 100"),
        ("large", {"height": 1 << 30}, "do not fit"),
        ("kind", {"encoding": "8UC1"}, "expected 16UC1, mono16 or 32FC1, got '8UC1'"),
        ("size", {"width": 32}, "frame 1"),
    ):
        damaged = depth_at(2.0, millimetres(1), **changed) if name != "size" else None
        damaged = damaged or depth_at(2.0, millimetres(1)[:, :32].copy())
        uri = bag_of(tmp_path / name, [*cameras(), depth_at(1.0, millimetres(0)), damaged])
        source = iter(capture.open_rgbd(uri))
        assert np.array_equal(next(source).depth, millimetres(0))
        with pytest.raises(FormatError, match=reason) as caught:
            next(source)
        assert "frame 1" in str(caught.value)
        assert str(tmp_path / name) in str(caught.value)


def test_reading_continues_after_a_damaged_image(tmp_path: Path) -> None:
    messages = cameras()
    for number in range(6):
        changed = {"data": np.zeros(100, np.uint8)} if number == 2 else {}
        messages.append(depth_at(1 + 0.1 * number, millimetres(number), **changed))
    uri = bag_of(tmp_path, messages)
    source = capture.open_rgbd(uri)
    assert [f and f.number for f in source.past_errors()] == [0, 1, None, 3, 4, 5]
    assert list(source.errors) == [2]
    # Images before a frame are not decoded.
    assert np.array_equal(source[4].depth, millimetres(4))
    with pytest.raises(FormatError, match="frame 2"):
        source[2]
    assert [f.number for f in capture.open_rgbd(uri, start=3)] == [3, 4, 5]
    source.seek(2)
    with pytest.raises(FormatError, match="frame 2"):
        source.read()
    assert [f.number for f in source] == [3, 4, 5]
    assert capture.record(uri, tmp_path / "copy").frames == 5
    summary = capture.summarize(capture.open_rgbd(uri))
    assert (summary.num_frames, summary.num_missing, summary.counters["damaged"]) == (5, 1, 1)


def test_bags_without_depth_images_say_so(tmp_path: Path) -> None:
    uri = bag_of(tmp_path, [*cameras(), color_at(1.0, 0)])
    with pytest.raises(FormatError, match=f"no depth images .*holds {COLOR}"):
        capture.open_rgbd(uri)
    with pytest.raises(FormatError, match=r"no point clouds .* rgbd-bag:.* may open it"):
        list(capture.open(uri.replace("rgbd-bag:", "bag:")))
    with pytest.raises(FileNotFoundError):
        capture.open_rgbd(f"rgbd-bag:{tmp_path}/missing.bag")
    (tmp_path / "no.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(5000))
    with pytest.raises(FormatError, match="cannot be read"):
        capture.open_rgbd(f"rgbd-bag:{tmp_path}/no.bag")


def test_a_bag_without_camera_takes_intrinsics(tmp_path: Path) -> None:
    uri = bag_of(tmp_path, [depth_at(1.0, millimetres(0))])
    with pytest.raises(FormatError, match="no CameraInfo"):
        capture.open_rgbd(uri)
    place = uri.partition(":")[2]
    done = manip3d(
        "capture", "record", place, "-o", tmp_path / "out", "--intrinsics", "60,60,31.5,23.5"
    )
    assert done.returncode == 0, done.stderr
    (frame,) = capture.open_rgbd(f"folder:{tmp_path / 'out'}")
    assert np.array_equal(frame.depth, millimetres(0))
    camera = frame.calibration.depth
    assert (camera.width, camera.height, camera.fx) == (64, 48, 60.0)


def test_info_and_inspect_take_the_camera_of_a_bag_without_one(tmp_path: Path) -> None:
    place = bag_of(tmp_path, [depth_at(1.0, millimetres(0))]).partition(":")[2]
    camera = ("--intrinsics", "60,60,31.5,23.5")
    done = manip3d("info", place, *camera, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["depth"]["fx"] == 60.0
    done = manip3d("inspect", place, *camera, "--json")
    assert done.returncode == 4, done.stderr
    assert json.loads(done.stdout)["verdict"] == "processed"
    np.ones((9, 4), np.float32).tofile(tmp_path / "a.bin")
    done = manip3d("inspect", tmp_path / "a.bin", *camera)
    assert done.returncode == 1
    assert (
        "--intrinsics: can only be given with an RGB-D recording, got scans of a LiDAR"
        in done.stderr
    )


def test_a_folder_of_recordings_is_inspected(tmp_path: Path) -> None:
    """Scans beside them too, and texts with points where there is no scan."""
    folder = tmp_path / "data"
    (folder / "below").mkdir(parents=True)
    bag = realsense(tmp_path / "mm.bag", 0.001)
    bag.rename(folder / "below" / "mm.bag")
    (folder / "cloud.csv").write_text("x,y,z\n" + "1,2,3\n" * 9)
    for names in ({"mm.bag", "cloud.csv"}, {"mm.bag", "a.bin"}):
        done = manip3d("inspect", folder, "--json", "--jobs", "1")
        assert done.returncode == 4, done.stderr
        rows = json.loads(done.stdout)
        assert {Path(row["source"]).name for row in rows} == names
        assert {row["verdict"] for row in rows} == {"processed", "undecidable"}
        np.ones((9, 4), np.float32).tofile(folder / "a.bin")


def test_recordings_of_a_realsense(tmp_path: Path) -> None:
    for name, unit in (("mm", 0.001), ("tenths", 0.0001)):
        path = realsense(tmp_path / f"{name}.bag", unit)
        uri = capture.rgbd_address(str(path))
        assert uri == f"rgbd-bag:{path}"
        assert capture.scan_address(str(path)) is None
        source = capture.open_rgbd(uri)
        (frame,) = source
        assert np.array_equal(frame.depth, np.rint(millimetres(0) * (1000 * unit)))
        assert np.array_equal(frame.color, colors(0))  # type: ignore[arg-type]
        registration = source.calibration.registration
        assert registration is not None
        # p_color = R p_depth0 + t, and p_depth = p_depth0 + (0, 0.02, 0).
        c, s = np.cos(0.1), np.sin(0.1)
        turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        np.testing.assert_allclose(registration.rotation, turn, atol=1e-12)
        np.testing.assert_allclose(registration.translation, [0.015, -0.02, 0.0], atol=1e-12)
    one = f"{path}#/device_0/sensor_0/Depth_0/image/data"
    assert capture.rgbd_address(one) == f"rgbd-bag:{one}"
    assert len(list(capture.open_rgbd(f"rgbd-bag:{one}"))) == 1


@pytest.mark.parametrize(
    ("option", "appended", "unit"),
    [(0.001, 0.001, 0.001), (0.001, 0.0001, 0.0001), (0.0001, 0.0, 0.0001), (0.001, np.nan, 0.001)],
)
def test_images_of_a_realsense_may_end_with_their_depth_unit(
    option: float, appended: float, unit: float, tmp_path: Path
) -> None:
    """librealsense 2.54 to 2.57 appends it to each image; it may be 0."""
    (frame,) = capture.open_rgbd(f"rgbd-bag:{realsense(tmp_path / 'a.bag', option, appended)}")
    assert np.array_equal(frame.depth, np.rint(millimetres(0) * (1000 * unit)))
    assert np.array_equal(frame.color, colors(0))  # type: ignore[arg-type]
    given = capture.open_rgbd(f"rgbd-bag:{tmp_path / 'a.bag'}", units_per_metre=500.0)
    assert np.array_equal(given[0].depth, 2 * millimetres(0))


@pytest.mark.parametrize("is_packed", [True, False])
def test_recordings_of_a_realsense_for_ros_2(is_packed: bool, tmp_path: Path) -> None:
    """librealsense 2.58 compresses each message by zstd, 2.59 the images."""
    path = realsense_ros2(tmp_path / "a", is_packed=is_packed, units=(0.0001, 0.001, 0.0))
    assert capture.rgbd_address(str(path)) == f"rgbd-bag:{path}"
    source = capture.open_rgbd(f"rgbd-bag:{path}")
    for number, (frame, unit) in enumerate(zip(source, (0.0001, 0.001, 0.0001), strict=True)):
        assert np.array_equal(frame.depth, np.rint(millimetres(number) * (1000 * unit)))
        assert np.array_equal(frame.color, colors(number))  # type: ignore[arg-type]
        assert frame.time_ns == SDK_START_NS + number * 100_000_000
    camera = source.calibration.depth
    assert (camera.width, camera.height) == (64, 48)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (60.0, 61.0, 31.5, 23.5)
    assert tuple(camera.distortion) == (0.1, 0.0, 0.0, 0.0, 0.0)
    registration = source.calibration.registration
    assert registration is not None
    # The texts have the columns of the rotation.
    c, s = 0.995004, 0.099833
    turn = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
    np.testing.assert_allclose(registration.rotation, turn, atol=1e-12)
    np.testing.assert_allclose(registration.translation, [0.015, -0.02, 0.0], atol=1e-12)


def altered(path: Path, topic: str, number: int, alter: Callable[[bytes], bytes]) -> str:
    """Alter a message of a ``.db3``; return the recording's address."""
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        find = (
            "SELECT messages.id, data FROM messages JOIN topics ON topic_id = topics.id "
            "WHERE name = ? ORDER BY timestamp LIMIT 1 OFFSET ?"
        )
        row, data = database.execute(find, (topic, number)).fetchone()
        database.execute("UPDATE messages SET data = ? WHERE id = ?", (alter(data), row))
    return f"rgbd-bag:{path}"


REALSENSE_DEPTH = "/device_0/sensor_0/Depth_0/image"


@pytest.mark.parametrize("number", [0, 1, 2])
@pytest.mark.parametrize("is_packed", [True, False])
def test_a_torn_image_of_a_realsense_is_one_lost_frame(
    is_packed: bool, number: int, tmp_path: Path
) -> None:
    path = realsense_ros2(tmp_path / "a", is_packed=is_packed, units=(0.0001,) * 3)
    topic = f"{REALSENSE_DEPTH}/data" + ("" if is_packed else "/compressedDepth")
    source = capture.open_rgbd(altered(path, topic, number, torn))
    whole = [each for each in range(3) if each != number]
    frames = [frame for frame in source.past_errors() if frame]
    assert [frame.number for frame in frames] == whole
    assert [frame.time_ns for frame in frames] == [SDK_START_NS + each * 10**8 for each in whole]
    for frame in frames:
        assert np.array_equal(frame.color, colors(frame.number))  # type: ignore[arg-type]
    assert list(source.errors) == [number]
    with pytest.raises(FormatError, match=f"frame {number}: {topic}: it cannot be decoded"):
        source[number]


def test_a_torn_colour_image_of_a_realsense_leaves_the_depth(tmp_path: Path) -> None:
    path = realsense_ros2(tmp_path / "a", is_packed=True, units=(0.0001,) * 3)
    source = capture.open_rgbd(altered(path, "/device_0/sensor_1/Color_0/image/data", 1, torn))
    assert [frame.color is None for frame in source] == [False, True, False]
    assert source.counters["without_color"] == 1


def test_a_torn_text_of_a_realsense_is_one_lost_frame(tmp_path: Path) -> None:
    """Without the text, the time of its image would be that of another clock."""
    path = realsense_ros2(tmp_path / "a", is_packed=True, units=(0.0001,) * 3)
    source = capture.open_rgbd(altered(path, f"{REALSENSE_DEPTH}/metadata", 1, torn))
    assert [frame and frame.time_ns for frame in source.past_errors()] == [
        SDK_START_NS,
        None,
        SDK_START_NS + 200_000_000,
    ]
    assert "the text that states its time and unit is damaged" in source.errors[1]


@pytest.mark.parametrize("unit", ["1e-320", "1e-7", "2", "inf", "nan", "-0.001"])
def test_a_depth_unit_that_no_camera_has_is_not_taken(unit: str, tmp_path: Path) -> None:
    def stating(_: bytes) -> bytes:
        text = TYPES.types[TEXT](f"timestamp=1.7e12;depth_units={unit};")
        return ros_bags.packed(bytes(TYPES.serialize_cdr(text, TEXT)))

    path = realsense_ros2(tmp_path / "a", is_packed=True)
    (frame,) = capture.open_rgbd(altered(path, f"{REALSENSE_DEPTH}/metadata", 0, stating))
    assert np.array_equal(frame.depth, np.rint(millimetres(0) / 10.0))


@pytest.mark.parametrize("is_packed", [True, False])
def test_the_lens_of_a_realsense_is_that_of_its_text(is_packed: bool, tmp_path: Path) -> None:
    """The CameraInfo says plumb_bob of every lens."""
    path = realsense_ros2(tmp_path / "a", is_packed=is_packed, lens="Inverse Brown Conrady")
    with pytest.raises(FormatError, match="'Inverse Brown Conrady' is not known"):
        capture.open_rgbd(f"rgbd-bag:{path}")


BLACK_TO_RED = {"y": [16, 235, 81, 81], "u": [128, 90], "v": [128, 240]}
"""Black, white and two red pixels by the tables of ITU-R BT.601."""
YUV = {
    "yuv422": "u0 y0 v0 y1 u1 y2 v1 y3",
    "UYVY": "u0 y0 v0 y1 u1 y2 v1 y3",
    "yuv422_yuy2": "y0 u0 y1 v0 y2 u1 y3 v1",
    "YUYV": "y0 u0 y1 v0 y2 u1 y3 v1",
}


@pytest.mark.parametrize("encoding", YUV)
def test_colours_of_yuv_422(encoding: str, tmp_path: Path) -> None:
    row = [BLACK_TO_RED[name][int(number)] for name, number in YUV[encoding].split()]
    pixels = np.tile(np.array(row, np.uint8).reshape(4, 2), (62, 20, 1))
    made = replace(image(pixels, encoding, 1.0), width=80, header=header(1.0, "color"))
    messages = [*cameras(), depth_at(1.0, millimetres(0)), (1.0, COLOR, IMAGE, made)]
    messages[1] = (0.0, "/camera/color/camera_info", INFO, info(COLORS, "color", (80, 62)))
    (frame,) = capture.open_rgbd(bag_of(tmp_path, messages))
    assert frame.color is not None
    expected = [[0, 0, 0], [255, 255, 255], [255, 0, 0], [255, 0, 0]]
    assert np.abs(frame.color[9, 40:44].astype(int) - expected).max() <= 1
    odd = replace(made, width=79)
    messages[-1] = (1.0, COLOR, IMAGE, odd)
    with pytest.raises(FormatError, match="expected an even width"):
        list(capture.open_rgbd(bag_of(tmp_path / "odd", messages)))


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "Y8"])
def test_grey_images_of_a_topic_of_colours_are_colours(encoding: str, tmp_path: Path) -> None:
    """Grey images of other topics are infrared ones."""
    grey = colors(0)[..., 0]
    made = replace(image(grey, encoding, 1.0), header=header(1.0, "color"))
    camera = cameras()[1][3]
    for topic, is_color in (("/camera/color", True), ("/rgbd_camera/ir", False)):
        messages = [*cameras(), depth_at(1.0, millimetres(0))]
        messages[1] = (0.0, f"{topic}/camera_info", INFO, camera)
        messages.append((1.0, f"{topic}/image_raw", IMAGE, made))
        (frame,) = capture.open_rgbd(bag_of(tmp_path / topic[1:5], messages))
        assert (frame.color is not None) == is_color
        if frame.color is not None:
            assert np.array_equal(frame.color, np.repeat(grey[..., None], 3, axis=2))


def test_colours_of_a_realsense_that_zstd_compressed(tmp_path: Path) -> None:
    uyvy = np.tile(np.array([128, 235], np.uint8), (62, 82, 1)).view(np.uint16)[..., 0]
    for is_packed in (True, False):
        place = tmp_path / str(is_packed)
        path = realsense_ros2(place, is_packed=is_packed, raw_color=("UYVY", uyvy))
        (frame,) = capture.open_rgbd(f"rgbd-bag:{path}")
        assert frame.color is not None
        assert (frame.color == 255).all()


def test_colours_of_another_encoding_are_told(tmp_path: Path) -> None:
    made = replace(color_at(1.0, 0)[3], encoding="nv12")
    uri = bag_of(tmp_path, [*cameras(), depth_at(1.0, millimetres(0)), (1.0, COLOR, IMAGE, made)])
    reason = f"frames have no colour: {COLOR} has images of 'nv12', which are not read"
    camera = Intrinsics(64, 48, 70.0, 70.0, 32.0, 24.0)
    for given in (None, camera, RgbdCalibration(camera)):
        with pytest.warns(UserWarning, match=reason):
            source = capture.open_rgbd(uri, camera=given)
        assert source[0].color is None


def test_a_realsense_without_a_depth_unit_is_told(tmp_path: Path) -> None:
    path = realsense_ros2(tmp_path / "a", is_packed=True, options=(), units=(0.0,))
    with pytest.warns(UserWarning, match="Depth_0 states no depth unit; 1000 units per metre"):
        source = capture.open_rgbd(f"rgbd-bag:{path}")
    assert np.array_equal(source[0].depth, millimetres(0))
    (frame,) = capture.open_rgbd(f"rgbd-bag:{path}", units_per_metre=10000)
    assert np.array_equal(frame.depth, np.rint(millimetres(0) / 10.0))
    for place, options, units in (("b", (0.0001,), (0.0,)), ("c", (), (0.0001,))):
        path = realsense_ros2(tmp_path / place, is_packed=True, options=options, units=units)
        (frame,) = capture.open_rgbd(f"rgbd-bag:{path}")
        assert np.array_equal(frame.depth, np.rint(millimetres(0) / 10.0))


def test_a_bag_is_recorded_again(tmp_path: Path) -> None:
    messages = cameras()
    for number in range(3):
        messages += [depth_at(1 + number, millimetres(number)), color_at(1 + number, number)]
    written = capture.record(bag_of(tmp_path, messages), tmp_path / "copy", lossless_color=True)
    assert written.frames == 3
    for number, frame in enumerate(capture.open_rgbd(f"folder:{tmp_path / 'copy'}")):
        assert np.array_equal(frame.depth, millimetres(number))
        assert np.array_equal(frame.color, colors(number))  # type: ignore[arg-type]


@pytest.mark.realdata
def test_a_recording_of_a_d435_is_that_of_its_extracted_images(realdata: RealData) -> None:
    folder = realdata("rgbd/recording_realsense_d435")
    source = capture.open_rgbd(f"rgbd-bag:{folder / 'single_depth_color_640x480.bag'}")
    frames = list(source)
    assert len(frames) == 2
    for number, frame in enumerate(frames, 1):
        stored = np.asarray(PIL_Image.open(folder / f"extracted_depth_{number}.png"))
        assert np.array_equal(frame.depth, stored)
    color = np.asarray(PIL_Image.open(folder / "extracted_color.png"))
    assert np.array_equal(frames[0].color, color)  # type: ignore[arg-type]
    assert frames[1].color is None  # 0.27 s lie between them
    assert source.calibration.depth.fx == pytest.approx(390.431, abs=1e-3)
    assert source.calibration.registration is not None
    assert source.calibration.registration.translation[0] == pytest.approx(0.0143, abs=1e-4)


def test_fractions_are_metres_whatever_the_unit_and_names_may_hold_a_number_sign(
    tmp_path: Path,
) -> None:
    metres = np.full((48, 64), 1.5, np.float32)
    folder = write_mixed_bag(tmp_path / "a#1", [*cameras(), depth_at(1.0, metres, "32FC1")])
    (frame,) = capture.open_rgbd(f"rgbd-bag:{folder}", units_per_metre=1000)
    assert (frame.depth == 1500).all()


def test_depth_takes_a_bag_with_a_topic(tmp_path: Path) -> None:
    folder = write_mixed_bag(tmp_path / "bag", [*cameras(), depth_at(1.0, millimetres(0))])
    given = ("-o", tmp_path / "out", "--points", 50)
    done = manip3d("depth", f"{folder}#{DEPTH}", *given)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in (tmp_path / "out").glob("*.glb")] == ["000000.glb"]


@pytest.mark.parametrize("kind", ["16UC1; png compressed ", "16UC1; jpeg compressed ", "rgb8"])
def test_depth_shown_as_a_picture_is_not_taken_for_colours(kind: str, tmp_path: Path) -> None:
    stored = io.BytesIO()
    if "png" in kind:
        PIL_Image.fromarray(millimetres(0)).save(stored, "PNG")
    else:
        PIL_Image.fromarray((millimetres(0) >> 8).astype(np.uint8)).save(stored, "JPEG")
    if kind == "rgb8":  # a depth image as colours, in the folder of the depth camera
        preview = replace(
            image(np.full((48, 64, 3), 77, np.uint8), kind, 1.0), header=header(1.0, "depth")
        )
        extra = (1.0, "/camera/depth/image_colormap", IMAGE, preview)
    else:
        data = np.frombuffer(stored.getvalue(), np.uint8)
        preview = TYPES.types[COMPRESSED](header(1.0, "depth"), kind, data)
        extra = (1.0, DEPTH + "/compressed", COMPRESSED, preview)
    messages = [*cameras(), depth_at(1.0, millimetres(0)), color_at(1.0, 0)]
    (plain,) = capture.open_rgbd(bag_of(tmp_path / "plain", messages))
    (frame,) = capture.open_rgbd(bag_of(tmp_path / "with", [*messages, extra]))
    assert frame.color is not None
    assert plain.color is not None
    np.testing.assert_array_equal(frame.color, plain.color)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_bags_of_ros_2_are_told_by_their_types(storage: str, tmp_path: Path) -> None:
    """Files and folders of images are recordings of a camera, those of clouds a LiDAR's."""
    images = tmp_path / "images"
    plugin = getattr(rosbag2.StoragePlugin, storage.upper())
    with rosbag2.Writer(images, version=8, storage_plugin=plugin) as writer:
        made: dict[str, Any] = {}
        for time, topic, kind, each in [*cameras(), depth_at(1.0, millimetres(0))]:
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(made[topic], round(time * 1e9), TYPES.serialize_cdr(each, kind))
    clouds = write_bag(tmp_path / "clouds", {"/top": [message(TYPES, points_of(1))]}, storage)
    for folder, is_lidar in ((images, False), (clouds, True)):
        (file,) = (path for path in folder.iterdir() if path.suffix != ".yaml")
        for place in (folder, file):
            assert capture.holds_clouds(place) == is_lidar
            assert kind_of(str(place)) == ("packets" if is_lidar else "recording")
            assert (capture.scan_address(str(place)) is not None) == is_lidar
            assert (capture.rgbd_address(str(place)) is not None) != is_lidar
    done = manip3d("depth", images, "--points", "50", "-o", tmp_path / "meshes", "--json")
    assert done.returncode == 0, done.stderr
    assert len(json.loads(done.stdout)["frames"]) == 1
    whole = next(images.glob("*.mcap"), None)
    if whole is not None:  # without its end a file does not tell
        (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[:-20])
        assert capture.holds_clouds(tmp_path / "cut.mcap")
    (tmp_path / "no.db3").write_bytes(b"no database")
    assert capture.holds_clouds(tmp_path / "no.db3")
    done = manip3d("depth", images, "--points", "50", "-o", tmp_path / "a.glb")
    assert error_line(done).endswith("a.glb: expected a folder's name without a suffix")
