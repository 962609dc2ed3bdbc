"""Point clouds of ROS bags: what rosbags writes is read to the bit, and what damaged bags say."""

from __future__ import annotations

import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from command_line import manip3d
from manip3d import FormatError, InputError, capture
from manip3d.capture import _bag_process

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the extra 'bags' is not installed")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

from ros_bags import (  # noqa: E402
    CLOUD,
    LIVOX,
    TYPES,
    livox,
    livox_points,
    livox_types,
    message,
    points_of,
    write_bag,
)


@pytest.mark.parametrize(("storage", "mode"), [
    ("mcap", "NONE"), ("sqlite3", "NONE"), ("mcap", "STORAGE"), ("sqlite3", "MESSAGE"),
])  # fmt: skip
def test_clouds_of_a_bag_are_those_that_were_written(
    tmp_path: Path, storage: str, mode: str
) -> None:
    tables = [points_of(number) for number in range(3)]
    clouds = [message(TYPES, each, stamp=5.25 + i) for i, each in enumerate(tables)]
    bag = write_bag(tmp_path / "bag", {"/points": clouds}, storage, mode)
    with capture.open(f"bag:{bag}") as source:
        frames = list(source)
    assert source.counters == {"frames": 3, "points": 150, "no_return": 0, "skipped": 0}
    for number, (frame, table) in enumerate(zip(frames, tables, strict=True)):
        assert np.array_equal(frame.points, np.column_stack([table[axis] for axis in "xyz"]))
        assert np.array_equal(frame.intensity, table["intensity"])
        assert np.array_equal(frame.ring, table["ring"])
        assert np.array_equal(frame.fields["time"], table["time"])
        assert frame.time_ns == 5_250_000_000 + number * 10**9
        assert frame.origin == (0.0, 0.0, 0.0)
        assert frame.format is not None
        assert frame.format.header["frame_id"] == "velodyne"
    files = list(bag.glob("*.mcap")) + list(bag.glob("*.db3"))
    if mode in ("NONE", "STORAGE"):
        assert len(list(capture.open(f"bag:{files[0]}"))) == 3


def test_names_of_bags_may_hold_the_mark_of_a_topic(tmp_path: Path) -> None:
    folder = tmp_path / "drive #1"
    folder.mkdir()
    clouds = [message(TYPES, points_of(0), stamp=5.25)]
    bag = write_bag(folder / "bag", {"/points": clouds, "/others": clouds}, "mcap", "NONE")
    with pytest.raises(InputError, match="#TOPIC with one of the topics"):
        capture.open(f"bag:{bag}").read()
    for source in (f"{bag}#/points", f"{next(bag.glob('*.mcap'))}#/points"):
        address = capture.scan_address(source)
        assert address == f"bag:{source}"
        with capture.open(address) as frames:
            assert len(list(frames)) == 1


def test_ros1_bags(tmp_path: Path) -> None:
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    path, table = tmp_path / "a.bag", points_of(1)
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection("/points", CLOUD, typestore=types)
        raw = types.serialize_ros1(message(types, table, ros1=True), CLOUD)
        writer.write(connection, 7 * 10**9, raw)
    (frame,) = capture.open(f"bag:{path}")
    assert np.array_equal(frame.fields["time"], table["time"])
    assert frame.time_ns == 7 * 10**9  # the message has none of its own


def test_an_empty_ros1_bag_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "a.bag"
    with rosbag1.Writer(path):
        pass
    with pytest.raises(FormatError, match="without a message"):
        capture.holds_clouds(path)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(FormatError, match="expected the index of a ROS 1 bag"):
        capture.holds_clouds(path)


def test_organised_clouds_with_padded_rows_and_points_without_a_return(tmp_path: Path) -> None:
    table = points_of(2, 60)
    table["x"][[3, 7, 59]] = np.nan
    cloud = message(TYPES, table, rows=4, padding=13, frame="base_link")
    bag = write_bag(tmp_path / "bag", {"/points": [cloud]})
    (frame,) = capture.open(f"bag:{bag}")
    kept = ~np.isnan(table["x"])
    assert np.array_equal(frame.points[:, 0], table["x"][kept])
    assert np.array_equal(frame.ring, table["ring"][kept])
    assert frame.num_dropped == 3
    assert frame.origin is None  # the scanner is not where the vehicle is


def test_points_at_infinity_have_no_return(tmp_path: Path) -> None:
    table = points_of(2)
    for axis in ("x", "y", "z"):
        table[axis][[3, 7, 49]] = (np.inf, -np.inf, np.inf)
    table["y"][5] = np.nan
    bag = write_bag(tmp_path / "bag", {"/points": [message(TYPES, table)]})
    (frame,) = capture.open(f"bag:{bag}")
    assert (frame.num_points, frame.num_dropped) == (46, 4)
    assert np.array_equal(frame.ring, np.delete(table["ring"], [3, 5, 7, 49]))
    table["x"][9] = np.inf  # y and z are there: no missing return, but damage
    bag = write_bag(tmp_path / "other", {"/points": [message(TYPES, table)]})
    with pytest.raises(FormatError, match="expected coordinates that fit a float"):
        list(capture.open(f"bag:{bag}"))


def _map_cloud(number: int, easting: float) -> np.ndarray:
    """Points in 64 bits around a place that moves with the vehicle, as in a UTM zone."""
    rng = np.random.default_rng(number)
    table = np.zeros(40 if number else 0, [("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    for axis, middle in zip("xyz", (easting, 5_428_000.0, 110.0), strict=True):
        table[axis] = middle + np.round(rng.uniform(-50, 50, len(table)), 3)
    return table


def test_map_coordinates_are_shifted_by_the_same_in_all_frames(tmp_path: Path) -> None:
    """The first frame has no points, and so no place."""
    tables = [_map_cloud(i, 458_000.0 + 700.0 * i) for i in range(4)]
    clouds = [message(TYPES, table, frame="utm") for table in tables]
    bag = write_bag(tmp_path / "bag", {"/points": clouds})
    empty, *frames = capture.open(f"bag:{bag}")
    assert empty.num_points == 0
    shift = frames[0].format.to_file[:3, 3]
    assert np.abs(shift - [458_700.0, 5_428_000.0, 110.0]).max() < 60.0
    for frame, table in zip(frames, tables[1:], strict=True):
        assert np.array_equal(frame.format.to_file[:3, 3], shift)
        stored = np.column_stack([table[axis] for axis in "xyz"])
        assert np.abs(frame.points + shift - stored).max() < 2e-4
        assert np.array_equal(frame.exact, stored)
    written = manip3d("convert", bag, "-o", tmp_path / "drive")
    assert written.returncode == 0
    assert written.stderr.count("coordinates are written near 0") == 1
    steps = [
        np.median(np.fromfile(tmp_path / "drive" / "velodyne" / f"00000{i}.bin", np.float32)[::4])
        for i in (1, 2, 3)
    ]
    assert np.abs(np.diff(steps) - 700.0).max() < 40.0
    cloud = message(TYPES, tables[1].astype([(axis, "<f4") for axis in "xyz"]))
    (single,) = capture.open(f"bag:{write_bag(tmp_path / 'single', {'/points': [cloud]})}")
    assert not single.format.to_file[:3, 3].any()  # float32 has no more to give


def _mcap(
    profile: str,
    kind: str,
    schema: str,
    encoding: str,
    data: bytes,
    definition: str = "",
    beside: str = "",
) -> bytes:
    """An MCAP file with one message, without an index, as the specification describes it.

    With a definition of the message's type, its summary repeats the schema. ``beside`` is the
    encoding of a second channel's schema, and of its empty message.
    """

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value)) + value.encode()

    def record(number: int, body: bytes) -> bytes:
        return struct.pack("<BQ", number, len(body)) + body

    magic = b"\x89MCAP0\r\n"
    named = record(3, struct.pack("<H", 1) + text(kind) + text(schema) + text(definition or "..."))
    other = record(3, struct.pack("<H", 2) + text("Status") + text(beside) + text("{}"))
    other += record(4, struct.pack("<HH", 2, 2) + text("/status") + text(beside) + text(""))
    other += record(5, struct.pack("<HIQQ", 2, 0, 10**18, 10**18))
    body = b"".join(
        (
            magic,
            record(1, text(profile) + text("a recorder")),
            named,
            record(4, struct.pack("<HH", 1, 1) + text("/top") + text(encoding) + text("")),
            record(5, struct.pack("<HIQQ", 1, 0, 10**18, 10**18) + data),
            other if beside else b"",
            record(15, struct.pack("<I", 0)),
        )
    )
    summary = named if definition else b""
    footer = struct.pack("<QQI", len(body) if definition else 0, 0, 0)
    return body + summary + record(2, footer) + magic


def test_mcap_files_without_a_profile(tmp_path: Path) -> None:
    """Foxglove's tools state none; types and encodings tell that the messages are ROS 2's."""
    path = tmp_path / "a.mcap"
    cloud = TYPES.serialize_cdr(message(TYPES, points_of(3)), CLOUD)
    for profile in ("ros2", ""):
        path.write_bytes(_mcap(profile, CLOUD, "ros2msg", "cdr", bytes(cloud)))
        (frame,) = capture.open(f"bag:{path}")
        assert np.array_equal(frame.ring, points_of(3)["ring"])
    for schema, encoding in (("protobuf", "protobuf"), ("jsonschema", "json")):
        path.write_bytes(_mcap("", "foxglove.PointCloud", schema, encoding, b"{}"))
        with pytest.raises(FormatError, match=r"no point clouds .* it holds foxglove\.PointCloud"):
            list(capture.open(f"bag:{path}"))
    path.write_bytes(_mcap("", CLOUD, "ros2msg", "json", b"{}"))
    with pytest.raises(FormatError, match="no point clouds"):
        list(capture.open(f"bag:{path}"))


@pytest.mark.parametrize("profile", ["ros2", ""])
@pytest.mark.parametrize("schema", ["jsonschema", "protobuf"])
def test_a_channel_of_another_schema_does_not_hide_the_clouds(
    tmp_path: Path, profile: str, schema: str
) -> None:
    """Foxglove's bridge records its own channels beside those of ROS 2."""
    cloud = TYPES.serialize_cdr(message(TYPES, points_of(3)), CLOUD)
    folder = write_bag(tmp_path / "bag", {"/top": [message(TYPES, points_of(3))]})
    (path,) = folder.glob("*.mcap")
    path.write_bytes(_mcap(profile, CLOUD, "ros2msg", "cdr", bytes(cloud), beside=schema))
    for source in (path, folder) if profile else (path,):
        (frame,) = capture.open(f"bag:{source}")
        assert np.array_equal(frame.ring, points_of(3)["ring"])


@pytest.mark.parametrize("profile", ["ros1", ""])
def test_mcap_files_with_messages_of_ros1(tmp_path: Path, profile: str) -> None:
    """``mcap convert`` makes them of ROS 1 bags, without decoding the messages."""
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    raw = types.serialize_ros1(message(types, points_of(3), ros1=True), CLOUD)
    path = tmp_path / "a.mcap"
    path.write_bytes(_mcap(profile, "sensor_msgs/PointCloud2", "ros1msg", "ros1", bytes(raw)))
    (frame,) = capture.open(f"bag:{path}")
    assert np.array_equal(frame.ring, points_of(3)["ring"])
    types, table = livox_types(typesys.Stores.ROS1_NOETIC), livox_points(0)
    raw = types.serialize_ros1(livox(types, table, stamp=9, ros1=True), LIVOX)
    kind = "livox_ros_driver2/CustomMsg"
    path.write_bytes(_mcap(profile, kind, "ros1msg", "ros1", bytes(raw)))
    (frame,) = capture.open(f"bag:{path}")
    assert np.array_equal(frame.intensity, table["reflectivity"])
    path.write_bytes(_mcap(profile, "std_msgs/String", "ros1msg", "ros1", bytes(4)))
    with pytest.raises(FormatError, match=r"no point clouds .* it holds std_msgs/msg/String"):
        list(capture.open(f"bag:{path}"))


@pytest.mark.parametrize(
    ("kind", "is_cloud"),
    [
        ("sensor_msgs/PointCloud2", True),
        ("sensor_msgs/msg/PointCloud2", True),
        ("velodyne_msgs/VelodyneScan", True),
        ("sensor_msgs/Image", False),
        ("sensor_msgs/msg/CompressedImage", False),
    ],
)
def test_schemas_of_an_mcap_file_tell_its_sensor(tmp_path: Path, kind: str, is_cloud: bool) -> None:
    """The text of a definition may name other types: the message of another sensor nests one."""
    path = tmp_path / "a.mcap"
    text = "MSG: sensor_msgs/PointCloud2\nMSG: sensor_msgs/msg/PointCloud2\n"
    path.write_bytes(_mcap("ros1", kind, "ros1msg", "ros1", bytes(9), text))
    assert capture.holds_clouds(path) == is_cloud


@pytest.mark.parametrize("profile", ["px4", "x" * 2000, "\x1b[31m"])
def test_mcap_files_of_another_profile_say_so(tmp_path: Path, profile: str) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(_mcap(profile, "sensor_msgs/PointCloud2", "ros1msg", "ros1", bytes(90)))
    with pytest.raises(FormatError, match="an MCAP file with the profile") as caught:
        list(capture.open(f"bag:{path}"))
    assert "\x1b" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_topic_is_named_where_there_are_several(tmp_path: Path) -> None:
    clouds = {
        f"/{side}": [message(TYPES, points_of(i))] for i, side in enumerate(("left", "right"))
    }
    bag = write_bag(tmp_path / "bag", clouds)
    with pytest.raises(InputError, match="with one of the topics of point clouds: /left, /right"):
        list(capture.open(f"bag:{bag}"))
    with pytest.raises(InputError, match="/left, /right"):
        list(capture.open(f"bag:{bag}#/middle"))
    (frame,) = capture.open(f"bag:{bag}#/right")
    assert np.array_equal(frame.ring, points_of(1)["ring"])


def test_refusals(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        capture.open(f"bag:{tmp_path / 'a.mcap'}")
    with pytest.raises(FormatError, match=r"metadata\.yaml"):
        capture.open(f"bag:{tmp_path}")
    with pytest.raises(InputError, match="model: expected none for bag:"):
        capture.open(f"bag:{tmp_path}", model="vlp16")
    bag = write_bag(tmp_path / "bag", {"/points": [message(TYPES, points_of(1))]})
    with pytest.raises(FormatError, match="at most max_bytes = "):
        list(capture.open(f"bag:{bag}", max_bytes=10))
    again = message(TYPES, points_of(1))
    again.fields[3].name = "x"
    with pytest.raises(FormatError, match="field x is named twice"):
        list(capture.open(f"bag:{write_bag(tmp_path / 'again', {'/points': [again]})}"))
    for changed, reason in (
        ({"point_step": 20}, "does not fit a point's bytes"),
        ({"width": 51}, "do not fit"),
        ({"height": 2**31, "width": 2**31}, "at most"),
        ({"row_step": 1, "height": 2, "width": 25}, "do not fit"),
    ):
        cloud = message(TYPES, points_of(1))
        for name, value in changed.items():
            setattr(cloud, name, value)
        other = write_bag(tmp_path / f"{reason[:3]}{len(changed)}", {"/points": [cloud]})
        with pytest.raises(FormatError, match=reason):
            list(capture.open(f"bag:{other}"))


def with_bad_messages(path: Path) -> Path:
    """A bag of five clouds: the second holds too few bytes, the third ends within its header."""
    clouds = [message(TYPES, points_of(i), stamp=1.0 + i) for i in range(5)]
    clouds[1].data = clouds[1].data[:100]
    plugin = rosbag2.StoragePlugin.MCAP
    with rosbag2.Writer(path, version=8, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/top", CLOUD, typestore=TYPES)
        for number, each in enumerate(clouds):
            raw = bytes(TYPES.serialize_cdr(each, CLOUD))
            writer.write(connection, 10**9 * (1 + number), raw[:9] if number == 2 else raw)
    return path


def test_a_bag_goes_on_after_messages_that_cannot_be_read(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from manip3d.cli import app

    bag = with_bad_messages(tmp_path / "bag")
    with capture.open_lidar(f"bag:{bag}") as source:
        scans = list(source.past_errors())
        assert [scan is None for scan in scans] == [False, True, True, False, False]
        assert list(source.errors) == [1, 2]
        assert "message 1: 1 rows of 50 points of 26 bytes do not fit 100" in source.errors[1]
        assert "message 2: it cannot be decoded: " in source.errors[2]
        assert (source.counters["frames"], source.counters["damaged"]) == (3, 2)
        assert not source.goes_on
    expected = [points_of(i)["x"] for i in (0, 3, 4)]
    found = [scan.points[:, 0] for scan in scans if scan is not None]
    assert all(map(np.array_equal, found, expected))
    drive = capture.open_drive(bag)
    assert [scan is None for scan in drive] == [False, True, True, False, False]
    assert list(drive.errors) == [1, 2]
    for cameras in (None, "none"):
        moments = [*capture.watched_recording(f"bag:{bag}", cameras=cameras).moments]
        unread = [each.frame for each in moments if isinstance(each.frame, str)]
        assert [isinstance(each.frame, str) for each in moments] == [
            False,
            True,
            True,
            False,
            False,
        ]
        assert "message 1: 1 rows" in unread[0]
        assert "message 2: it" in unread[1]
    done = CliRunner().invoke(app, ["convert", str(bag), "-o", str(tmp_path / "out")])
    assert done.exit_code == 1
    assert "; 1 more error" in str(done.exception)
    assert len(list((tmp_path / "out" / "velodyne").iterdir())) == 3
    assert len((tmp_path / "out" / "times.txt").read_text().splitlines()) == 3


def test_a_bag_without_a_message_that_can_be_read_is_an_error(tmp_path: Path) -> None:
    clouds = [message(TYPES, points_of(i)) for i in range(2)]
    for each in clouds:
        each.point_step = 20
    bag = write_bag(tmp_path / "bag", {"/top": clouds})
    with pytest.raises(FormatError, match=r"message 0: .* does not fit a point's bytes"):
        next(iter(capture.open_drive(bag)))


def test_an_error_between_messages_tells_how_many_are_not_reached(tmp_path: Path) -> None:
    import sqlite3

    pytest.importorskip("backports.zstd")
    clouds = [message(TYPES, points_of(i)) for i in range(5)]
    bag = write_bag(tmp_path / "bag", {"/top": clouds}, "sqlite3", "MESSAGE")
    (database,) = bag.glob("*.db3")
    with sqlite3.connect(database) as connection:
        connection.execute("update messages set data = ? where id = 3", (b"no zstd",))
    drive = capture.open_drive(bag)
    assert [scan is None for scan in drive] == [False, False, True]
    assert "cannot be read after message 1: " in drive.errors[2]
    assert drive.errors[2].endswith("; 3 of its messages were not reached")


def test_damaged_bags_are_typed_errors_or_frames(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", {"/points": [message(TYPES, points_of(i)) for i in range(3)]})
    (path,) = bag.glob("*.mcap")
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    cases = [b"", b"abc", whole[:100], whole[: len(whole) // 2], bytes(5000)]
    for _ in range(5):
        data = bytearray(whole)
        at = rng.integers(len(data) - 8)
        data[at : at + 8] = rng.bytes(8)
        cases.append(bytes(data))
    refused = 0
    for data in cases:
        path.write_bytes(data)
        try:
            list(capture.open(f"bag:{path}"))
        except FormatError as error:
            refused += error.file == str(path)
    assert refused >= 5


def test_what_expands_without_end_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A message of a few kilobytes that holds more zeros than the reader may have memory."""
    monkeypatch.setattr("manip3d.capture._bag._MEMORY", 1 << 30)
    zstd = pytest.importorskip("backports.zstd")
    folder = write_bag(
        tmp_path / "bag", {"/points": [message(TYPES, points_of(1))]}, "sqlite3", "MESSAGE"
    )
    compressor = zstd.ZstdCompressor()
    block = bytes(1 << 24)
    bomb = b"".join(compressor.compress(block) for _ in range(80)) + compressor.flush()
    import sqlite3

    (database,) = folder.glob("*.db3")
    with sqlite3.connect(database) as connection:
        connection.execute("update messages set data = ?", (bomb,))
    with pytest.raises(FormatError, match="needs more than 1024 MiB"):
        list(capture.open(f"bag:{folder}"))


def test_the_reader_ends_with_the_source(tmp_path: Path) -> None:
    clouds = [message(TYPES, points_of(i, 20000)) for i in range(5)]
    source = capture.open(f"bag:{write_bag(tmp_path / 'bag', {'/points': clouds})}")
    assert source.read() is not None
    process: subprocess.Popen[bytes] = source._source._process
    assert process.poll() is None
    del source
    assert process.wait(10) is not None


def test_commands_take_bags(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from manip3d.cli import app

    clouds = [message(TYPES, points_of(i), stamp=1.0 + i) for i in range(2)]
    bag = write_bag(tmp_path / "bag", {"/points": clouds})
    (file,) = bag.glob("*.mcap")
    for source in (bag, file):
        told = CliRunner().invoke(app, ["info", str(source), "--json"])
        assert told.exit_code == 0
        assert told.output.count('"points": 50') == 2
        judged = CliRunner().invoke(app, ["inspect", str(source), "--no-power", "-q"])
        assert judged.exit_code == 4
        assert "undecidable: 2 of 2 scans" in judged.output
    watched = CliRunner().invoke(app, ["alert", "run", str(file), "-q"])
    assert watched.exit_code == 4


def test_a_process_that_is_limited_itself_reads_bags(tmp_path: Path) -> None:
    """Nobody may raise a hard limit: the reader's own is then that one."""
    bag = write_bag(tmp_path / "bag", {"/points": [message(TYPES, points_of(1))]})
    script = "import resource; resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))\n"
    script += f"from manip3d import capture; print(len(list(capture.open('bag:{bag}'))))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("1\n", "")


@pytest.mark.parametrize("kept", [6, 20, -4, -200])
def test_a_recording_of_mcap_without_its_end_is_called_so(tmp_path: Path, kept: int) -> None:
    folder = write_bag(tmp_path / "bag", {"/top": [message(TYPES, points_of(1))]})
    (file,) = folder.glob("*.mcap")
    file.write_bytes(file.read_bytes()[:kept])
    for place in (file, folder):
        with pytest.raises(
            FormatError, match=rf"{file.name} has no end: .*'mcap recover {file.name}"
        ):
            list(capture.open(f"bag:{place}"))


def _livox_bag(path: Path, messages: list[bytes], kind: str = LIVOX) -> Path:
    types = livox_types(typesys.Stores.ROS2_HUMBLE)
    with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/livox/lidar", kind, typestore=types)
        for number, raw in enumerate(messages):
            writer.write(connection, 10**9 + number * 10**8, raw)
    return path


@pytest.mark.parametrize("frame", ["livox_frame", "l", "map", ""])
def test_clouds_of_livox_drivers_are_read_to_the_bit(tmp_path: Path, frame: str) -> None:
    """Names of every length: CDR puts what follows them at multiples of eight."""
    types, tables = livox_types(typesys.Stores.ROS2_HUMBLE), [livox_points(n) for n in range(2)]
    raw = [types.serialize_cdr(livox(types, each, stamp=3 + n, frame=frame), LIVOX)
           for n, each in enumerate(tables)]  # fmt: skip
    big = types.serialize_cdr(
        livox(types, tables[0], timebase=77, frame=frame), LIVOX, little_endian=False
    )
    bag = _livox_bag(tmp_path / "bag", [*raw, big])
    assert capture.holds_clouds(bag)
    assert all(capture.holds_clouds(file) for file in bag.glob("*.mcap"))
    with capture.open(f"bag:{bag}") as source:
        frames = list(source)
    assert source.counters["points"] == 90
    assert [each.time_ns for each in frames] == [3 * 10**9, 4 * 10**9, 77]
    for found, table in zip(frames, [*tables, tables[0]], strict=True):
        assert np.array_equal(found.points, np.column_stack([table[axis] for axis in "xyz"]))
        assert np.array_equal(found.intensity, table["reflectivity"])
        for name in ("offset_time", "tag", "line"):
            assert np.array_equal(found.fields[name], table[name])
        assert found.origin == (None if frame == "map" else (0.0, 0.0, 0.0))
        assert found.format is not None
        assert found.format.header["frame_id"] == frame


@pytest.mark.parametrize("package", ["livox_ros_driver", "livox_ros_driver2"])
def test_ros1_bags_of_livox(tmp_path: Path, package: str) -> None:
    types = livox_types(typesys.Stores.ROS1_NOETIC, package)
    path, table, kind = tmp_path / "a.bag", livox_points(1), f"{package}/msg/CustomMsg"
    made = livox(types, table, stamp=9, package=package, ros1=True)
    with rosbag1.Writer(path) as writer:
        camera = writer.add_connection("/camera", "sensor_msgs/msg/Image", typestore=types)
        assert camera.topic == "/camera"
        connection = writer.add_connection("/livox/lidar", kind, typestore=types)
        writer.write(connection, 10**9, types.serialize_ros1(made, kind))
    assert capture.holds_clouds(path)
    (frame,) = capture.open(f"bag:{path}")
    assert np.array_equal(frame.points, np.column_stack([table[axis] for axis in "xyz"]))
    assert np.array_equal(frame.fields["line"], table["line"])
    assert frame.time_ns == 9 * 10**9


def _livox_message(points: int) -> bytes:
    types = livox_types(typesys.Stores.ROS2_HUMBLE)
    return bytes(types.serialize_cdr(livox(types, livox_points(1, points), stamp=1), LIVOX))


def _with_count(message: bytes, points: int, count: int) -> bytes:
    """The message with another count before its points."""
    at = len(message) + 1 - 20 * points - 4
    assert message[at : at + 4] == points.to_bytes(4, "little")
    return message[:at] + count.to_bytes(4, "little") + message[at + 4 :]


@pytest.mark.parametrize(("changed", "reason"), [
    (lambda whole: _with_count(whole, 3, 4), "do not fit"),
    (lambda whole: _with_count(whole, 3, 2**32 - 1), "at most"),
    (lambda whole: whole[:12] + b"\xff" * 4 + whole[16:], "ends before its points"),
    (lambda whole: b"\x00\x07" + whole[2:], "another encoding"),
    (lambda whole: whole[:-5], "do not fit"),
])  # fmt: skip
def test_messages_of_livox_that_claim_what_they_do_not_hold_are_refused(
    tmp_path: Path, changed: Callable[[bytes], bytes], reason: str
) -> None:
    bag = _livox_bag(tmp_path / "bag", [changed(_livox_message(3))])
    with pytest.raises(FormatError, match=reason):
        list(capture.open(f"bag:{bag}"))


@pytest.mark.parametrize("is_ros1", [False, True])
def test_damaged_messages_of_livox_are_refused_or_have_bytes_for_what_they_say(
    is_ros1: bool,
) -> None:
    """Every cut, and bytes exchanged by chance, within the process that reads the bag."""
    whole, rng = _livox_message(3), np.random.default_rng(0)
    cases = [whole[:kept] for kept in range(len(whole))]
    for _ in range(2000):
        data = bytearray(whole)
        for at in rng.integers(len(data), size=rng.integers(1, 4)):
            data[at] = rng.integers(256)
        cases.append(bytes(data))
    refused = 0
    for data in cases:
        try:
            layout, points = _bag_process._livox(data, is_ros1=is_ros1)
        except ValueError:
            refused += 1
            continue
        assert len(points) <= len(data)
        assert 0 <= layout["width"] < 2**32
        assert layout["row_step"] == layout["width"] * layout["point_step"]
    assert 0 < refused < len(cases)


@pytest.mark.parametrize(("kind", "driver"), [
    ("velodyne_msgs/msg/VelodyneScan", "velodyne_pointcloud"),
    ("ouster_sensor_msgs/msg/PacketMsg", ""),
    ("hesai_lidar/msg/PandarScan", "hesai_lidar"),  # General_ROS; Swift_ROS has pandar_msgs
    ("pandar_msgs/msg/PandarScan", "pandar_pointcloud"),
    ("rslidar_msg/msg/RslidarScan", r"rslidar_sdk \(msg_source: 2 in its config.yaml\)"),
    ("robosense_msgs/msg/RobosenseScan", "nebula"),
])  # fmt: skip
def test_bags_of_packets_say_what_makes_clouds_of_them(
    tmp_path: Path, kind: str, driver: str
) -> None:
    path = tmp_path / "bag"
    with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/packets", kind, msgdef="uint8 x", rihs01="a" * 71)
        writer.write(connection, 10**9, b"\x00\x01\x00\x00\x00")
        camera = writer.add_connection("/camera", "sensor_msgs/msg/Image", typestore=TYPES)
        assert camera.topic == "/camera"
    assert capture.holds_clouds(path)
    cure = f"{driver} makes clouds of these packets"
    if kind.startswith("ouster"):
        (file,) = path.glob("*.mcap")
        cure = f"ouster:{path} reads these packets"
        with pytest.raises(FormatError, match=f"ouster:{file} reads these packets"):
            list(capture.open(f"bag:{file}"))
    with pytest.raises(FormatError, match=f"it holds .*{cure}"):
        list(capture.open(f"bag:{path}"))


def test_ros2_folders_reach_the_software_of_ousters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = []

    class Frames(list[object]):
        sensor_info = (SimpleNamespace(prod_line="OS-1-128"),)

    def open_source(path: str) -> Frames:
        opened.append(path)
        return Frames()

    fakes = {
        "ouster": ModuleType("ouster"),
        "ouster.sdk": SimpleNamespace(open_source=open_source),
        "ouster.sdk.core": SimpleNamespace(),
    }
    for name, module in fakes.items():
        monkeypatch.setitem(sys.modules, name, module)
    folder = tmp_path / "drive.bag"
    folder.mkdir()
    with pytest.raises(OSError, match=r"drive\.bag"):
        capture.open(f"ouster:{folder}")
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}")
    assert list(capture.open(f"ouster:{folder}")) == []
    assert opened == [str(folder)]
