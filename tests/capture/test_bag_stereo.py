"""Bags with the pictures of a stereo pair: which pictures belong to a scan, and what they show."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import FormatError, InputError, LidarFrame, capture, datasets, forge, simulate
from manip3d.authenticate import CameraPair, DriveMoment, StereoRig, write_rigs
from manip3d.capture import _bag_stereo
from manip3d.capture._bag import BagPicture, BagRecording
from manip3d.io._images import decoded_picture
from manip3d.simulate import cameras

pytest.importorskip("rosbags.rosbag2", reason="the extra 'bags' is not installed")
pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
PIL_Image = pytest.importorskip("PIL.Image", reason="the extra 'alert' is not installed")

from ros_bags import (  # noqa: E402
    CLOUD,
    COMPRESSED,
    IMAGE,
    INFO,
    TRANSFORMS,
    TYPES,
    camera_info,
    compressed,
    image,
    message,
    points_of,
    torn,
    transform,
    write_mixed_bag,
)
from velodyne_packets import pcap  # noqa: E402

PROJECTION = np.array([[360.0, 0, 320, 0], [0, 360, 80, 0], [0, 0, 1, 0]])
RIGHT = PROJECTION + np.array([[0, 0, 0, -360 * 0.5], [0, 0, 0, 0], [0, 0, 0, 0]])
POSE = np.array([[0.0, 0, 1, 0.25], [-1, 0, 0, 0.5], [0, -1, 0, 1.0], [0, 0, 0, 1]])
LEFT_TOPIC, RIGHT_TOPIC = "/stereo/left/image_rect", "/stereo/right/image_rect"

Messages = list[tuple[float, str, str, Any]]

pytestmark = pytest.mark.usefixtures("forked_readers")


def calibration(side: str = "stereo") -> Messages:
    tree = TYPES.types[TRANSFORMS]
    base = np.eye(4)
    base[:3, 3] = 1.0, 2.0, 3.0
    edges = [
        transform("base_link", "velodyne", base),
        transform("base_link", "camera", base @ POSE),
    ]
    return [
        (0.0, f"/{side}/left/camera_info", INFO, camera_info(PROJECTION)),
        (0.0, f"/{side}/right/camera_info", INFO, camera_info(RIGHT)),
        (0.0, "/tf_static", TRANSFORMS, tree(edges)),
    ]


def scan(time: float) -> tuple[float, str, str, Any]:
    return time, "/points", CLOUD, message(TYPES, points_of(int(time * 10)), stamp=time)


def both(time: float, grey: int, *, recorded: float | None = None) -> Messages:
    pixels = np.full((160, 640), grey, np.uint8)
    when = time if recorded is None else recorded
    return [
        (when, topic, IMAGE, image(pixels, "mono8", time)) for topic in (LEFT_TOPIC, RIGHT_TOPIC)
    ]


def moments(path: Path, **options: Any) -> list[DriveMoment]:
    return list(capture.watched_recording(f"bag:{path}", **options).moments)


def greys(found: list[DriveMoment]) -> list[int | None]:
    return [None if each.pictures is None else int(each.pictures[0][0, 0]) for each in found]


def test_each_scan_gets_the_pair_of_the_nearest_stamp(tmp_path: Path) -> None:
    made = calibration()
    for number in range(6):
        made.append(scan(1.0 + 0.1 * number))
    for time, grey in ((0.98, 10), (1.03, 11), (1.11, 12), (1.26, 13), (1.46, 15)):
        made += both(time, grey)
    made.sort(key=lambda each: each[0])
    bag = write_mixed_bag(tmp_path / "bag", made)
    notes: list[str] = []
    drive = capture.watched_recording(f"bag:{bag}", note=notes.append)
    assert notes == [f"the LiDAR is compared with {LEFT_TOPIC} and {RIGHT_TOPIC}"]
    assert isinstance(drive.rig, StereoRig)
    assert (drive.rig.focal, drive.rig.center, drive.rig.baseline) == (360.0, (320.0, 80.0), 0.5)
    np.testing.assert_allclose(drive.rig.T_lidar_camera, POSE, atol=1e-12)
    found = list(drive.moments)
    # Between 1.2 and 1.26 s, and 1.4 and 1.46, are more than half of the 100 ms between scans.
    assert greys(found) == [10, 12, None, 13, None, 15]
    assert [each.time_s for each in found] == pytest.approx([1.0, 1.1, 1.2, 1.3, 1.4, 1.5])
    assert not any(each.unread for each in found)


def test_pictures_may_be_recorded_later_than_their_scans(tmp_path: Path) -> None:
    made = calibration()
    for number in range(6):
        made.append(scan(1.0 + 0.1 * number))
        made += both(1.0 + 0.1 * number, 10 + number, recorded=1.35 + 0.1 * number)
    bag = write_mixed_bag(tmp_path / "bag", sorted(made, key=lambda each: each[0]))
    assert greys(moments(bag)) == [10, 11, 12, 13, 14, 15]
    assert greys(moments(bag, frames=2)) == [10, 11]
    assert greys(moments(bag, cameras="none")) == [None] * 6


def test_a_picture_without_the_other_camera_is_no_pair(tmp_path: Path) -> None:
    made = calibration()
    for number in range(3):
        made += [scan(1.0 + 0.1 * number), *both(1.0 + 0.1 * number, number)]
    made = [each for each in made if not (each[0] == 1.1 and each[1] == RIGHT_TOPIC)]
    assert greys(moments(write_mixed_bag(tmp_path / "bag", made))) == [0, None, 2]


def test_encodings_show_the_same_picture(tmp_path: Path) -> None:
    """One colour, so that what a mosaic leaves out is known."""
    rgb = np.full((160, 640, 3), (200, 100, 50), np.uint8)
    made = calibration()
    names = {"r": 200, "g": 100, "b": 50}
    cases = [("rgb8", rgb), ("bgr8", rgb[..., ::-1]), ("mono8", rgb[..., 1])]
    for pattern in ("rggb", "bggr", "gbrg", "grbg"):
        mosaic = np.array([names[letter] for letter in pattern], np.uint8).reshape(2, 2)
        cases.append((f"bayer_{pattern}8", np.tile(mosaic, (80, 320))))
    for number, (encoding, pixels) in enumerate(cases):
        time = 1.0 + number / 10
        made += [scan(time)] + [
            (time, topic, IMAGE, image(pixels, encoding, time))
            for topic in (LEFT_TOPIC, RIGHT_TOPIC)
        ]
    found = moments(write_mixed_bag(tmp_path / "bag", made))
    for (encoding, _), moment in zip(cases, found, strict=True):
        assert moment.pictures is not None, moment.unread
        for seen in moment.pictures:
            assert np.array_equal(seen, rgb[..., 1] if encoding == "mono8" else rgb), encoding


@pytest.mark.parametrize(("kind", "format"), [("PNG", "png"), ("JPEG", "bgr8; jpeg compressed")])
def test_compressed_pictures(tmp_path: Path, kind: str, format: str) -> None:
    rgb = np.full((160, 640, 3), (200, 100, 50), np.uint8)
    file = io.BytesIO()
    PIL_Image.fromarray(rgb).save(file, kind)
    made = [scan(1.0)]
    for side, projection in (("left", PROJECTION), ("right", RIGHT)):
        topic = f"/{side}/image_rect/compressed"
        made += [(1.0, topic, COMPRESSED, compressed(file.getvalue(), format, 1.0)),
                 (1.0, f"/{side}/camera_info", INFO, camera_info(projection))]  # fmt: skip
    made += calibration()[2:]
    (found,) = moments(write_mixed_bag(tmp_path / "bag", made))
    assert found.pictures is not None
    assert np.abs(found.pictures[0].astype(int) - rgb).max() <= (0 if kind == "PNG" else 3)


def _png(mode: str = "L") -> bytes:
    file = io.BytesIO()
    PIL_Image.new(mode, (640, 160)).save(file, "PNG")
    return file.getvalue()


GREY = np.zeros((160, 640), np.uint8)
BAD_PICTURES = {
    "16 bits": (image(GREY, "mono16", 1.0), "expected one of the encodings mono8, .* got 'mono16'"),
    "a depth": (image(GREY, "32FC1", 1.0), "got '32FC1'"),
    "cut off": (image(GREY, "mono8", 1.0, data=np.zeros(1000, np.uint8)), "do not fit 1000 bytes"),
    "a short step": (image(GREY, "rgb8", 1.0), "do not fit"),
    "no step": (image(GREY, "mono8", 1.0, step=0), "do not fit"),
    "no rows": (image(GREY, "mono8", 1.0, height=0), "0 rows"),
    "enormous": (image(GREY, "mono8", 1.0, height=2**31, width=2**31, step=2**31), "do not fit"),
    "a cut JPEG": (compressed(b"\xff\xd8\xff\xe0" + bytes(40), "jpeg", 1.0), "unreadable picture"),
    "a cut PNG": (compressed(torn(_png()), "png", 1.0), "unreadable picture"),
    "a PNG of 16 bits": (compressed(_png("I;16"), "png", 1.0), "expected a picture of 8 bits"),
    "nothing": (compressed(b"", "png", 1.0), "unreadable picture"),
    "a depth image": (compressed(bytes(12) + _png(), "16UC1; compressedDepth", 1.0), "unreadable"),
}


def test_the_refusal_of_16_bits_is_told_once() -> None:
    with pytest.raises(FormatError, match=r"^expected a picture of 8 bits, got the mode I(;16)?"):
        decoded_picture(_png("I;16"))


@pytest.mark.parametrize("name", BAD_PICTURES)
def test_a_picture_that_cannot_be_decoded_silences_the_cameras_only(
    tmp_path: Path, name: str
) -> None:
    picture, reason = BAD_PICTURES[name]
    kind = COMPRESSED if hasattr(picture, "format") else IMAGE
    made = [*calibration(), (1.0, LEFT_TOPIC, kind, picture), (1.0, RIGHT_TOPIC, kind, picture)]
    made += [scan(1.0), scan(1.1)]
    first, second = moments(write_mixed_bag(tmp_path / "bag", made))
    assert first.pictures is None
    with pytest.raises(FormatError, match=f"{LEFT_TOPIC}: .*{reason}"):
        raise FormatError(first.unread["cross-modal"])
    assert not isinstance(first.frame, str)
    assert not second.unread


def write_damaged_bag(
    path: Path, made: Messages, damaged: Collection[tuple[float, str]], kept: int
) -> Path:
    """A bag whose pictures of these times and topics keep only so many bytes of their messages."""
    from rosbags import rosbag2

    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(path, version=8, storage_plugin=plugin) as writer:
        opened: dict[str, Any] = {}
        for time, topic, kind, each in made:
            if topic not in opened:
                opened[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            raw = bytes(TYPES.serialize_cdr(each, kind))
            raw = raw[:kept] if (time, topic) in damaged else raw
            writer.write(opened[topic], round((1 + time) * 1e9), raw)
    return path


def until_error(path: Path, **options: Any) -> tuple[list[DriveMoment], str]:
    """The moments before the error that ends a bag, and the error; empty: none."""
    found: list[DriveMoment] = []
    told = ""
    try:
        found.extend(capture.watched_recording(f"bag:{path}", **options).moments)
    except FormatError as error:
        told = str(error)
    return found, told


TIMES = (1.0, 1.1, 1.2, 1.3)
NO_STAMP, WITH_STAMP = 0, 20
BROKEN = {
    "left": {(1.1, LEFT_TOPIC)},
    "right": {(1.1, RIGHT_TOPIC)},
    "the first": {(1.0, LEFT_TOPIC), (1.0, RIGHT_TOPIC)},
    "the last": {(1.3, LEFT_TOPIC), (1.3, RIGHT_TOPIC)},
    "the other in the next": {(1.1, LEFT_TOPIC), (1.2, RIGHT_TOPIC)},
    "all": {(time, topic) for time in TIMES for topic in (LEFT_TOPIC, RIGHT_TOPIC)},
}


@pytest.mark.parametrize("kept", [NO_STAMP, WITH_STAMP])
@pytest.mark.parametrize("name", BROKEN)
@pytest.mark.parametrize("late", [0.0, 0.35])
def test_damaged_pictures_are_told_by_the_scans_that_lack_them(
    tmp_path: Path, name: str, kept: int, late: float
) -> None:
    """The stamps of damaged pictures are unknown, and cameras may be recorded late."""
    made = calibration()
    for number, time in enumerate(TIMES):
        made += [scan(time), *both(time, 10 + number, recorded=time + late)]
    made.sort(key=lambda each: each[0])
    damaged = {(time + late, topic) for time, topic in BROKEN[name]}
    bag = write_damaged_bag(tmp_path / "bag", made, damaged, kept)
    found, error = until_error(bag)
    hurt = {time for time, _ in BROKEN[name]}
    assert greys(found) == [
        None if time in hurt else 10 + number for number, time in enumerate(TIMES)
    ]
    for time, moment in zip(TIMES, found, strict=True):
        assert isinstance(moment.frame, LidarFrame)
        told = moment.unread.get("cross-modal", "")
        for topic in (LEFT_TOPIC, RIGHT_TOPIC):
            if (time, topic) in BROKEN[name]:
                assert f"{topic}: it cannot be decoded: " in told
        assert told.startswith("unreadable: ") == (time in hurt)
    assert error.startswith(f"{bag}: damaged pictures: {len(damaged)}, the first of /stereo/")


def test_damaged_pictures_of_other_topics_and_of_later_scans_are_not_told(tmp_path: Path) -> None:
    made = calibration()
    for number, time in enumerate(TIMES):
        made += [scan(time), *both(time, number)]
        made.append((time, "/rear", IMAGE, image(GREY, "mono8", time)))
    damaged = {(1.0, "/rear"), (1.3, LEFT_TOPIC)}
    bag = write_damaged_bag(tmp_path / "bag", made, damaged, WITH_STAMP)
    found, error = until_error(bag, frames=2)
    assert greys(found) == [0, 1]
    assert not any(each.unread for each in found)
    assert not error
    assert until_error(bag, cameras="none")[1] == ""
    found, error = until_error(bag, frames=4)
    assert [bool(each.unread) for each in found] == [False, False, False, True]
    assert error.startswith(f"{bag}: damaged pictures: 1, the first of {LEFT_TOPIC}: ")


@pytest.mark.parametrize("limit", [(), ("--frames", "2")])
def test_a_drive_of_damaged_pictures_is_not_found_clean(
    tmp_path: Path, limit: tuple[str, ...]
) -> None:
    from typer.testing import CliRunner

    from manip3d.cli import app

    made = calibration()
    for time in TIMES:
        made += [scan(time), *both(time, 7)]
    bag = write_damaged_bag(tmp_path / "bag", made, BROKEN["all"], WITH_STAMP)
    done = CliRunner().invoke(app, ["alert", "run", str(bag), "--json", "-q", *limit])
    assert done.exit_code == 4, done.output
    told = json.loads(done.stdout)
    number = 2 if limit else len(TIMES)
    assert len(told["frames"]) == number
    for frame in told["frames"]:
        assert frame["witnesses"]["cross-modal"]["verdict"] == "undecidable"
    assert told["verdict"] == "undecidable"
    assert f"ended after {number} frames: " in told["reason"]
    assert "damaged pictures: " in told["reason"]


def test_pairs_are_chosen_where_there_are_several(tmp_path: Path) -> None:
    made = [scan(1.0), *both(1.0, 7), *calibration(), *calibration("gray")[:2]]
    for side in ("left", "right"):
        raw, rect = (f"/gray/{side}/image_{name}" for name in ("raw", "rect"))
        made += [(1.0, topic, IMAGE, image(GREY + 9, "mono8", 1.0)) for topic in (raw, rect)]
    bag = write_mixed_bag(tmp_path / "bag", made)
    with pytest.raises(InputError, match=f"one of /gray/left/image_raw,.*{LEFT_TOPIC},"):
        moments(bag)
    assert greys(moments(bag, cameras=f"{LEFT_TOPIC},{RIGHT_TOPIC}")) == [7]
    assert greys(moments(bag, cameras="/gray/left/image_raw,/gray/right/image_raw")) == [9]
    for cameras_ in ("/gray/left/image_raw", f"{LEFT_TOPIC},{LEFT_TOPIC}", f"{LEFT_TOPIC},/x", ""):
        with pytest.raises(InputError, match="cameras: expected none or LEFT,RIGHT of /gray/"):
            moments(bag, cameras=cameras_)


@pytest.mark.parametrize(("changed", "reason"), [
    ("no info", "no CameraInfo /stereo/left/camera_info beside"),
    ("no tf", "/tf_static does not lead from 'velodyne' to 'camera'"),
    ("other P", "are not a rectified pair"),
    ("same P", "baseline: expected a number > 0"),
    ("NaN", "expected finite matrices P"),
    ("distorted", "are not rectified"),
    ("zero P", "/stereo/right/camera_info: the camera is not calibrated"),
    ("two focal lengths", "expected one focal length, got 360 and 720"),
    ("askew", "are not a rectified pair"),
    ("no rotation", "expected a rotation R"),
])  # fmt: skip
def test_pictures_without_geometry_are_named_and_not_compared(
    tmp_path: Path, changed: str, reason: str
) -> None:
    made = [scan(1.0), *both(1.0, 7), *calibration()]
    if changed == "no info":
        made = [each for each in made if each[1] != "/stereo/left/camera_info"]
    if changed == "no tf":
        made = [each for each in made if each[1] != "/tf_static"]
    other = {
        "other P": PROJECTION * 2,
        "same P": PROJECTION,
        "NaN": PROJECTION * np.nan,
        "zero P": PROJECTION * 0,
        "two focal lengths": RIGHT * [[1], [2], [1]],
        "askew": np.add(RIGHT, [[0, 0, 0, 0], [0, 0, 0, 20], [0, 0, 0, 0]]),
        "no rotation": RIGHT,
    }
    if changed in other:
        made = [each for each in made if each[1] != "/stereo/right/camera_info"]
        info = camera_info(other[changed])
        if changed == "no rotation":
            info.r[:] = np.arange(9.0)
        made.append((0.0, "/stereo/right/camera_info", INFO, info))
    topics = LEFT_TOPIC, RIGHT_TOPIC
    if changed == "distorted":
        topics = topics[0].replace("rect", "raw"), topics[1].replace("rect", "raw")
        made = [(t, name.replace("rect", "raw"), k, m) for t, name, k, m in made if k != INFO]
        for side, projection in (("left", PROJECTION), ("right", RIGHT)):
            info = camera_info(projection, distortion=0.1)
            made.append((0.0, f"/stereo/{side}/camera_info", INFO, info))
    bag = write_mixed_bag(tmp_path / "bag", made)
    notes: list[str] = []
    drive = capture.watched_recording(f"bag:{bag}", note=notes.append)
    assert drive.rig is None
    assert greys(list(drive.moments)) == [None]
    assert len(notes) == 1
    assert notes[0].startswith("no pictures are compared: ")
    assert reason in notes[0]
    with pytest.raises(InputError, match="cameras: "):
        moments(bag, cameras=",".join(topics))
    if changed not in ("no info", "distorted"):
        return  # each reading starts a process
    rig = StereoRig(360.0, (320.0, 80.0), 0.5, POSE)
    write_rigs({"front": CameraPair(rig, 2, 3)}, tmp_path / "rigs.json")
    assert greys(moments(bag, rigs=tmp_path / "rigs.json")) == [7]
    write_rigs({n: CameraPair(rig, 2, 3) for n in ("front", "left")}, tmp_path / "two.json")
    with pytest.raises(InputError, match="rigs: expected one pair for a ROS bag, got front, left"):
        moments(bag, rigs=tmp_path / "two.json")


def test_raw_pictures_of_a_folder_with_rect_in_its_name_are_raw(tmp_path: Path) -> None:
    made = [scan(1.0), calibration()[2]]
    for side, projection in (("left", PROJECTION), ("right", RIGHT)):
        info = camera_info(projection, distortion=0.1)
        made += [(1.0, f"/direct/{side}/image_raw", IMAGE, image(GREY, "mono8", 1.0)),
                 (1.0, f"/direct/{side}/camera_info", INFO, info)]  # fmt: skip
    notes: list[str] = []
    bag = write_mixed_bag(tmp_path / "bag", made)
    assert capture.watched_recording(f"bag:{bag}", note=notes.append).rig is None
    assert "are not rectified" in notes[0]


@pytest.mark.parametrize(("key", "values"), [("r", [0.5] * 4), ("r", []), ("p", [1.0] * 9)])
def test_matrices_of_another_size_are_named(key: str, values: list[float]) -> None:
    info = {"p": PROJECTION.ravel().tolist(), "r": [0.0] * 9, "d": [], "frame_id": "camera"}
    infos = {"/left/camera_info": {**info, key: values}, "/right/camera_info": info}
    found = {"infos": infos, "transforms": [], "lidar": "velodyne"}
    reason = _bag_stereo._rig_of(found, "/left/image_raw", "/right/image_raw")
    assert reason == "/left/camera_info: expected finite matrices P (3, 4) and R (3, 3)"


def _picture(side: str, stamp_ns: int) -> BagPicture:
    header = {"picture": side, "stamp_ns": stamp_ns, "encoding": "mono8"}
    return BagPicture({**header, "height": 1, "width": 1, "step": 1}, b"7")


@pytest.mark.parametrize(("others", "is_joined"), [(100, True), (2000, False)])
def test_only_so_many_pictures_wait_for_the_other_camera(others: int, is_joined: bool) -> None:
    waiting = [_picture("left", 10_000_000 * number) for number in range(others)]
    at_begin = LidarFrame(np.zeros((1, 3), np.float32), time_ns=0)
    messages = [*waiting, _picture("right", 0), at_begin]
    (found,) = _bag_stereo.matched(messages, ("left", "right"))
    assert (found.pictures is not None) == is_joined


def test_scans_before_an_error_are_not_lost() -> None:
    scans = [LidarFrame(np.full((1, 3), n, np.float32), time_ns=n * 10**8) for n in range(5)]

    def damaged() -> Iterator[LidarFrame]:
        yield from scans
        raise FormatError("damaged bag")

    seen = []
    with pytest.raises(FormatError, match="damaged bag"):
        seen.extend(each.frame for each in _bag_stereo.matched(damaged(), ("left", "right")))
    assert seen == scans


def test_a_reader_that_ends_before_it_is_asked_is_a_typed_error(tmp_path: Path) -> None:
    bag = write_mixed_bag(tmp_path / "bag", [*calibration(), scan(1.0)])
    recording = BagRecording(bag, "", mode="pictures")
    recording.cameras()
    recording._process.kill()
    recording._process.wait()
    with pytest.raises(FormatError, match="damaged bag: its reader ended"):
        next(recording.messages([]))


def test_options_of_bags_are_refused_elsewhere(tmp_path: Path) -> None:
    for options in ({"cameras": "/a,/b"}, {"rigs": tmp_path / "rigs.json"}):
        with pytest.raises(
            InputError, match=f"{next(iter(options))}: can only be given with a ROS bag"
        ):
            capture.watched_recording("pcap:a.pcap", **options)
    with pytest.raises(InputError, match="calibration: expected none for bag:"):
        capture.watched_recording(f"bag:{tmp_path}", calibration="db.xml")


def test_damaged_bags_with_pictures_are_typed_errors_or_moments(tmp_path: Path) -> None:
    made = [*calibration(), scan(1.0), *both(1.0, 7), scan(1.1), *both(1.1, 8)]
    bag = write_mixed_bag(tmp_path / "bag", made)
    (path,) = bag.glob("*.mcap")
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    cases = [whole[: len(whole) * part // 4] for part in range(4)]
    for _ in range(4):
        data = bytearray(whole)
        at = rng.integers(len(data) - 8)
        data[at : at + 8] = rng.bytes(8)
        cases.append(bytes(data))
    refused = 0
    for data in cases:
        path.write_bytes(data)
        try:
            moments(path)
        except FormatError as error:
            refused += error.file == str(path)
    assert refused >= 4


def test_scans_before_the_damage_are_intact(tmp_path: Path) -> None:
    bag = write_mixed_bag(
        tmp_path / "bag", [*calibration(), *(scan(1.0 + n / 10) for n in range(3))]
    )
    (path,) = bag.glob("*.mcap")
    whole, before = path.read_bytes(), moments(path)
    third = whole.index(points_of(12).tobytes())
    ended = 0
    for back in range(0, 200, 20):  # the header of the third cloud, which lies before its points
        path.write_bytes(whole[: third - back] + b"\xff" * 8 + whole[third - back + 8 :])
        seen: list[DriveMoment] = []
        try:
            seen.extend(capture.watched_recording(f"bag:{path}").moments)
        except FormatError as error:
            ended += error.file == str(path)
        ended += any(isinstance(each.frame, str) for each in seen)
        assert len(seen) >= 2
        for found, wanted in zip(seen[:2], before, strict=False):
            assert isinstance(found.frame, LidarFrame)
            assert isinstance(wanted.frame, LidarFrame)
            assert found.time_s == wanted.time_s
            assert found.frame.points.tobytes() == wanted.frame.points.tobytes()
    assert ended >= 4


def test_a_recording_without_scans_is_named(tmp_path: Path) -> None:
    empty, bag = tmp_path / "empty.pcap", write_mixed_bag(tmp_path / "bag", [*both(1.0, 7)])
    empty.write_bytes(pcap([]))
    with pytest.raises(FormatError, match=r"empty\.pcap: expected scans, found none"):
        list(capture.watched_recording(f"pcap:{empty}").moments)
    with pytest.raises(FormatError, match="no point clouds"):
        moments(bag)


def _bag_of(drive: Path, target: Path) -> Path:
    """The drive as a bag: clouds, colour pictures, calibration."""
    matrices, lidar_to_rect = cameras.projections()
    pose = np.linalg.inv(lidar_to_rect)  # camera 2 is shifted from the rectified frame
    pose[:3, 3] -= pose[:3, :3] @ np.linalg.solve(matrices[2][:, :3], matrices[2][:, 3])
    made: Messages = [
        (0.0, f"/{side}/camera_info", INFO, camera_info(matrices[number]))
        for side, number in (("left", 2), ("right", 3))
    ]
    tree = TYPES.types[TRANSFORMS]([transform("velodyne", "camera", pose)])
    made.append((0.0, "/tf_static", TRANSFORMS, tree))
    for number, frame in enumerate(datasets.open_kitti(drive)):
        time = 1.0 + number / 10
        read = frame.scan()
        assert read.intensity is not None
        table = np.zeros(read.num_points, [(name, "<f4") for name in ("x", "y", "z", "intensity")])
        for column, name in enumerate("xyz"):
            table[name] = read.points[:, column]
        table["intensity"] = read.intensity
        made.append((time, "/points", CLOUD, message(TYPES, table, stamp=time)))
        pictures = frame.pictures()
        assert pictures is not None
        for side, pixels in zip(("left", "right"), pictures, strict=True):
            encoding = "mono8" if pixels.ndim == 2 else "rgb8"
            made.append((time, f"/{side}/image_rect", IMAGE, image(pixels, encoding, time)))
    return write_mixed_bag(target, made)


def test_a_bag_of_a_drive_gets_the_verdicts_of_its_folder(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from manip3d.cli import app
    from manip3d.io import read_scan, write_scan

    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    drive = simulate.write_drive(simulate.street(1), tmp_path / "street", 3, rng=1)
    second = datasets.open_kitti(drive)[1]
    before = read_scan(second.scan_path)
    ahead = [box for box in second.boxes() if 6 < box.center[0] < 25 and abs(box.center[1]) < 8]
    seen = max(ahead, key=lambda box: np.count_nonzero(box.contains(before.points)))
    forged = forge.subtractive(before, seen)
    write_scan(forged.frame, second.scan_path)
    shutil.rmtree(drive / "velodyne_points" / "labels")  # they no longer fit
    verdicts = []
    for source in (drive, _bag_of(drive, tmp_path / "bag")):
        done = CliRunner().invoke(app, ["alert", "run", str(source), "--json", "-q"])
        assert done.exit_code == 3, (done.output, done.exception)
        verdicts.append([
            {name: (told["verdict"], told["reason"]) for name, told in frame["witnesses"].items()}
            for frame in json.loads(done.stdout)["frames"]
        ])  # fmt: skip
    assert verdicts[0] == verdicts[1]
    assert [frame["cross-modal"][0] for frame in verdicts[0]] == [
        "no_trace", "tampered", "no_trace",
    ]  # fmt: skip


def test_options_that_contradict_are_refused(tmp_path: Path) -> None:
    bag = f"bag:{tmp_path / 'drive.bag'}"
    with pytest.raises(InputError, match="rigs: can only be given with cameras"):
        capture.watched_recording(bag, cameras="none", rigs=tmp_path / "rigs.json")
    for watched in (capture.watched_recording, simulate.watched_street, datasets.watched_kitti):
        with pytest.raises(InputError, match="frames: expected at least 1, got 0"):
            watched(bag, frames=0)
    with pytest.raises(InputError, match="carriers: expected a folder"):
        datasets.watched_kitti(tmp_path, carriers=tmp_path / "pictures")


@pytest.mark.parametrize("cameras", [None, "none"])
def test_a_topic_without_scans_is_named_by_its_file(cameras: str | None, tmp_path: Path) -> None:
    from rosbags import rosbag2

    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(tmp_path / "bag", version=8, storage_plugin=plugin) as writer:
        writer.add_connection("/top", CLOUD, typestore=TYPES)
        writer.add_connection("/side", CLOUD, typestore=TYPES)
    drive = capture.watched_recording(f"bag:{tmp_path / 'bag'}#/top", cameras=cameras)
    with pytest.raises(FormatError, match="expected scans, found none") as caught:
        list(drive.moments)
    assert caught.value.file == str(tmp_path / "bag")
