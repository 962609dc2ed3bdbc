"""ROS bags of point clouds and pictures, written by rosbags."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rosbags import rosbag1, rosbag2, typesys

CLOUD = "sensor_msgs/msg/PointCloud2"
LAYOUT = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"),
          ("time", "<f8")]  # fmt: skip
KINDS = {"<i1": 1, "<u1": 2, "<i2": 3, "<u2": 4, "<i4": 5, "<u4": 6, "<f4": 7, "<f8": 8}


def points_of(number: int, count: int = 50) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(number)
    table = np.zeros(count, LAYOUT)
    for name, kind in LAYOUT:
        table[name] = rng.integers(0, 60, count) if "u" in kind else rng.normal(size=count)
    return table


def message(
    types: Any,
    table: np.ndarray[Any, Any],
    *,
    stamp: float = 0.0,
    rows: int = 1,
    padding: int = 0,
    frame: str = "velodyne",
    ros1: bool = False,
) -> Any:
    """A cloud of so many rows; so many bytes beside each row that are no points."""
    dtype = table.dtype
    fields = [
        types.types["sensor_msgs/msg/PointField"](
            name, dtype.fields[name][1], KINDS[dtype[name].str.replace("|", "<")], 1
        )
        for name in dtype.names
    ]
    width = len(table) // rows
    lines = np.zeros((rows, width * dtype.itemsize + padding), np.uint8)
    lines[:, : width * dtype.itemsize] = table.view(np.uint8).reshape(rows, -1)
    time = types.types["builtin_interfaces/msg/Time"](int(stamp), round(stamp % 1 * 1e9))
    sequence = (0,) if ros1 else ()
    header = types.types["std_msgs/msg/Header"](*sequence, stamp=time, frame_id=frame)
    return types.types[CLOUD](
        header, rows, width, fields, False, dtype.itemsize, lines.shape[1], lines.reshape(-1), True
    )


def write_bag(
    path: Path, clouds: dict[str, Sequence[Any]], storage: str = "mcap", mode: str = "NONE"
) -> Path:
    """A ROS 2 bag of the clouds of each topic; 0.1 s lie between two of them."""
    types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    plugin = getattr(rosbag2.StoragePlugin, storage.upper())
    writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
    if mode != "NONE":
        writer.set_compression(rosbag2.CompressionMode[mode], rosbag2.CompressionFormat.ZSTD)
    with writer:
        for topic, messages in clouds.items():
            connection = writer.add_connection(topic, CLOUD, typestore=types)
            for number, each in enumerate(messages):
                raw = types.serialize_cdr(each, CLOUD)
                writer.write(connection, 10**9 + number * 10**8, raw)
    return path


TYPES = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"


def header(stamp: float, frame: str) -> Any:
    time = TYPES.types["builtin_interfaces/msg/Time"](int(stamp), round(stamp % 1 * 1e9))
    return TYPES.types["std_msgs/msg/Header"](time, frame)


def image(pixels: np.ndarray[Any, Any], encoding: str, stamp: float, **changed: Any) -> Any:
    """A picture with five bytes beside each row that are none of its pixels."""
    height, width = pixels.shape[:2]
    rows = np.pad(pixels.reshape(height, -1), ((0, 0), (0, 5)))
    fields = {"height": height, "width": width, "step": rows.shape[1], "data": rows.reshape(-1)}
    fields |= changed
    return TYPES.types[IMAGE](
        header(stamp, "camera"), fields["height"], fields["width"], encoding, 0, fields["step"],
        fields["data"],
    )  # fmt: skip


def compressed(data: bytes, kind: str, stamp: float) -> Any:
    return TYPES.types[COMPRESSED](header(stamp, "camera"), kind, np.frombuffer(data, np.uint8))


def camera_info(
    projection: np.ndarray[Any, Any], frame: str = "camera", distortion: float = 0.0
) -> Any:
    region = TYPES.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    return TYPES.types[INFO](
        header(0.0, frame), 0, 0, "plumb_bob", np.array([distortion, 0, 0, 0, 0.0]),
        projection[:, :3].reshape(-1).astype(float), np.eye(3).reshape(-1),
        projection.reshape(-1).astype(float), 0, 0, region,
    )  # fmt: skip


def transform(parent: str, child: str, matrix: np.ndarray[Any, Any]) -> Any:
    """The fixed transform from child to parent, a rotation that is no half turn."""
    m = matrix[:3, :3]
    w = np.sqrt(1.0 + np.trace(m)) / 2.0
    turn = np.array([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) / (4.0 * w)
    make = {name: TYPES.types[f"geometry_msgs/msg/{name}"]
            for name in ("Vector3", "Quaternion", "Transform", "TransformStamped")}  # fmt: skip
    moved = make["Transform"](make["Vector3"](*matrix[:3, 3]), make["Quaternion"](*turn, w))
    return make["TransformStamped"](header(0.0, parent), child, moved)


def write_mixed_bag(path: Path, messages: Sequence[tuple[float, str, str, Any]]) -> Path:
    """A ROS 2 bag of (time in seconds, topic, type, message), in this order."""
    with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP) as writer:
        made: dict[str, Any] = {}
        for time, topic, kind, each in messages:
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            raw = TYPES.serialize_cdr(each, kind)
            writer.write(made[topic], round((1 + time) * 1e9), raw)
    return path


PROJECTION = np.array([[60.0, 0, 31.5, 0], [0, 61, 23.5, 0], [0, 0, 1, 0]])
COLORS = np.array([[80.0, 0, 40.5, 0], [0, 80, 30.5, 0], [0, 0, 1, 0]])


def millimetres(number: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(number).integers(0, 9000, (48, 64), np.uint16)


def colors(number: int) -> np.ndarray[Any, Any]:
    return np.random.default_rng(100 + number).integers(0, 256, (62, 82, 3), np.uint8)


def realsense(path: Path, unit: float, appended: float | None = None) -> Path:
    """A bag as RealSense's recorder writes it; from 2.54 on it appends a unit to its images."""
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    made: dict[str, Any] = {}
    of = types.types
    stamp = of["builtin_interfaces/msg/Time"](3, 0)
    head = of["std_msgs/msg/Header"](0, stamp, "0" if appended is None else "1")
    region = of["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    stored = millimetres(0)
    images = {
        "sensor_0/Depth_0": ("mono16", stored.view(np.uint8), 128, (64, 48), PROJECTION),
        "sensor_0/Infrared_1": ("mono16", stored.view(np.uint8), 128, (64, 48), PROJECTION),
        "sensor_1/Color_0": ("rgb8", colors(0), 246, (82, 62), COLORS),
    }
    shift = of["geometry_msgs/msg/Vector3"]
    turn = of["geometry_msgs/msg/Quaternion"](0.0, np.sin(0.05), 0.0, np.cos(0.05))
    none = of["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    poses = {"sensor_0/Depth_0": (shift(0.0, 0.02, 0.0), none),
             "sensor_1/Color_0": (shift(0.015, 0.0, 0.0), turn)}  # fmt: skip
    with rosbag1.Writer(path) as writer:

        def write(topic: str, kind: str, message: Any) -> None:
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=types)
            raw = bytes(types.serialize_ros1(message, kind))
            if kind == IMAGE and appended is not None:
                raw += struct.pack("<f", appended if "Depth" in topic else 0.0)
            writer.write(made[topic], 10**9, raw)

        unit_topic = "/device_0/sensor_0/option/Depth Units/value"
        write(unit_topic, "std_msgs/msg/Float32", of["std_msgs/msg/Float32"](np.float32(unit)))
        for name, (encoding, data, step, (width, height), matrix) in images.items():
            camera = of[INFO](
                head, height, width, "Brown Conrady", np.zeros(5), matrix[:, :3].reshape(-1),
                np.zeros(9), np.zeros(12), 0, 0, region,
            )  # fmt: skip
            write(f"/device_0/{name}/info/camera_info", INFO, camera)
            pixels = of[IMAGE](head, height, width, encoding, 0, step, data.reshape(-1))
            write(f"/device_0/{name}/image/data", IMAGE, pixels)
        for name, (translation, rotation) in poses.items():
            kind = "geometry_msgs/msg/Transform"
            write(f"/device_0/{name}/tf/0", kind, of[kind](translation, rotation))
    return path


TEXT = "std_msgs/msg/String"
SDK_START_NS = 1_700_000_000_000_000_000


def realsense_ros2(
    path: Path,
    *,
    is_packed: bool,
    options: Sequence[float] = (0.0001,),
    units: Sequence[float] = (0.0001,),
    lens: str = "Brown Conrady",
    raw_color: tuple[str, np.ndarray[Any, Any]] | None = None,
) -> Path:
    """A ``.db3`` as RealSense's recorder writes it, with one frame for each of ``units``.

    librealsense 2.58 compresses each message by zstd (``is_packed``), 2.59 the images. A unit of 0
    is not stated.
    """
    stamp = TYPES.types["builtin_interfaces/msg/Time"]
    of_stream = {
        "/device_0/sensor_0/Depth_0": ("Depth", (64, 48), PROJECTION, "0,0,0"),
        "/device_0/sensor_1/Color_0": ("Color", (82, 62), COLORS, "0.015,-0.02,0"),
    }
    turns = {
        "Depth": "1,0,0,0,1,0,0,0,1",
        "Color": "0.995004,0,0.099833,0,1,0,-0.099833,0,0.995004",
    }
    with rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer:
        made: dict[str, Any] = {}

        def write(topic: str, kind: str, message: Any, time: int = 0) -> None:
            if topic not in made:
                made[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            raw = bytes(TYPES.serialize_cdr(message, kind))
            writer.write(made[topic], time, packed(raw) if is_packed else raw)

        def text(topic: str, value: str, time: int = 0) -> None:
            write(topic, TEXT, TYPES.types[TEXT](value), time)

        for unit in options:
            text("/device_0/sensor_0/option/Depth_Units/value", f"{unit:.6f}")
        for stream, (name, (width, height), matrix, shift) in of_stream.items():
            fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
            size = f"width={width};height={height};fx={fx:g};ppx={cx:g};fy={fy:g};ppy={cy:g}"
            text(f"{stream}/camera_info", f"{size};model={lens};coeffs=0.1,0,0,0,0")
            text(f"{stream}/tf/ref_1", f"rotation={turns[name]};translation={shift}")
            for number, unit in enumerate(units):
                time = 4086 + number * 33_000_000
                head = TYPES.types["std_msgs/msg/Header"](stamp(0, time), name)
                told = f"Frame number={number};timestamp={1.7e12 + 100 * number:.6f};"
                told += f"depth_units={unit:.6f};" if unit else ""
                text(f"{stream}/image/metadata", told, time)
                kind, each = _realsense_image(name, number, is_packed, raw_color)
                topic = f"{stream}/image/data" + ("" if is_packed else _TRANSPORTS[name])
                write(topic, kind, replace(each, header=head), time)
                if not is_packed:
                    info = replace(camera_info(matrix), width=width, height=height, header=head)
                    info = replace(info, d=np.array([0.1, 0, 0, 0, 0]))
                    write(f"{stream}/image/camera_info", INFO, info, time)
    (file,) = path.glob("*.db3")
    return file


_TRANSPORTS = {"Depth": "/compressedDepth", "Color": "/compressed"}


def _realsense_image(
    name: str, number: int, is_packed: bool, raw_color: tuple[str, np.ndarray[Any, Any]] | None
) -> tuple[str, Any]:
    encoding, pixels = ("rgb8", colors(number)) if raw_color is None else raw_color
    if name == "Depth":
        encoding, pixels = "mono16", millimetres(number)
    if is_packed:
        data = pixels.view(np.uint8).reshape(len(pixels), -1)
        return IMAGE, TYPES.types[IMAGE](
            header(0.0, ""), len(pixels), pixels.shape[1], encoding, 0, data.shape[1],
            data.reshape(-1),
        )  # fmt: skip
    if name == "Color" and raw_color is not None:
        data = pixels.view(np.uint8).reshape(len(pixels), -1)
        size = f"{pixels.shape[1]}x{len(pixels)} step={data.shape[1]}"
        return COMPRESSED, compressed(packed(data.tobytes()), f"{encoding}; zstd; {size}", 0.0)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "PNG")
    kind = "16UC1; compressedDepth png" if name == "Depth" else "rgb8; png compressed bgr8"
    start = bytes(12) if name == "Depth" else b""
    return COMPRESSED, compressed(start + stream.getvalue(), kind, 0.0)


def packed(data: bytes) -> bytes:
    """Data compressed by zstd, with the package that rosbags has chosen."""
    from rosbags.rosbag2 import writer

    return bytes(getattr(writer, "zstd").compress(data))  # noqa: B009


LIVOX = "livox_ros_driver2/msg/CustomMsg"
_POINT = """uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
_CUSTOM = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
{}/CustomPoint[] points
"""


def livox_types(store: typesys.Stores, package: str = "livox_ros_driver2") -> Any:
    """The types of a kind of bags, with those that Livox's driver publishes."""
    types = typesys.get_typestore(store)
    for name, text in (("CustomPoint", _POINT), ("CustomMsg", _CUSTOM.format(package))):
        types.register(typesys.get_types_from_msg(text, f"{package}/msg/{name}"))
    return types


def livox(
    types: Any,
    table: np.ndarray[Any, Any],
    *,
    stamp: int = 0,
    timebase: int = 0,
    frame: str = "livox_frame",
    package: str = "livox_ros_driver2",
    ros1: bool = False,
) -> Any:
    """The points of a table as Livox's driver publishes them."""
    of = types.types
    sequence = (0,) if ros1 else ()
    time = of["builtin_interfaces/msg/Time"](stamp, 0)
    head = of["std_msgs/msg/Header"](*sequence, stamp=time, frame_id=frame)
    make = of[f"{package}/msg/CustomPoint"]
    points = [make(*(value.item() for value in row)) for row in table]
    return of[f"{package}/msg/CustomMsg"](
        head, timebase, len(points), 192, np.zeros(3, np.uint8), points
    )


def livox_points(number: int, count: int = 30) -> np.ndarray[Any, Any]:
    rng = np.random.default_rng(number)
    kinds = [("offset_time", "<u4"), *((axis, "<f4") for axis in "xyz"), ("reflectivity", "u1"),
             ("tag", "u1"), ("line", "u1")]  # fmt: skip
    table = np.zeros(count, kinds)
    for name, kind in kinds:
        table[name] = rng.normal(size=count) if "f" in kind else rng.integers(0, 200, count)
    return table


def torn(data: bytes) -> bytes:
    """Return the first half of a message or file."""
    return data[: len(data) // 2]
