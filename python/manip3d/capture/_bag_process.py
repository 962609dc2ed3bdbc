"""Script that reads a ROS bag in its own process, so that no bad bag can crash the caller.

Usage: ``python _bag_process.py PATH TOPIC BYTES MODE``. BYTES limits its address space. It imports
nothing of manip3d. For each message of the topic it writes to its standard output a line of JSON,
and then as many bytes as ``size`` in that line states; a line with ``bad`` states why a message
cannot be decoded, and no bytes follow. The last line holds ``end``, or ``error`` and, as
``unread``, the number of clouds that were not reached; or it is the only one, and states why there
are no messages: ``topics``, ``kinds`` or ``profile``.

MODE is ``clouds``, ``pictures`` or ``images``. With ``pictures`` the first line holds the bag's
``cameras``; the script then reads from its standard input one line with a JSON list of topics, and
writes the pictures of these topics in addition to the clouds. ``images`` does the same without
clouds, and its first line also holds encoding, format, number and period of the images of each
topic.
"""

from __future__ import annotations

import contextlib
import functools
import json
import re
import resource
import struct
import sys
from collections import Counter
from collections.abc import Iterator
from itertools import islice, pairwise
from pathlib import Path
from statistics import median_low
from typing import Any, BinaryIO

CLOUD = "sensor_msgs/msg/PointCloud2"
LIVOX = (
    "livox_ros_driver/msg/CustomMsg",
    "livox_ros_driver2/msg/CustomMsg",
    "livox_interfaces/msg/CustomMsg",
)
LIVOX_FIELDS = [
    ["offset_time", 0, 6, 1],
    ["x", 4, 7, 1],
    ["y", 8, 7, 1],
    ["z", 12, 7, 1],
    ["reflectivity", 16, 2, 1],
    ["tag", 17, 2, 1],
    ["line", 18, 2, 1],
]
"""Fields of a Livox CustomPoint: name, offset in bytes, type code of sensor_msgs/PointField, and
number of values."""
IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
REALSENSE_IMAGE = "/image/data"
"""End of the names of topics to which RealSense's recorder writes images."""
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TRANSFORM = "geometry_msgs/msg/Transform"
NUMBER = "std_msgs/msg/Float32"
TEXT = "std_msgs/msg/String"
REALSENSE_TEXT = r"/(camera_info|tf/[^/]+|option/Depth[ _]Units/value)$"
"""Topics of the texts in which RealSense's recorder for ROS 2 states cameras, poses and units."""
REALSENSE_PACKED = re.compile(r"(\w+); zstd; (\d{1,5})x(\d{1,5}) step=(\d{1,6})")
"""Format of the images that this recorder compresses by zstd, with width, height and step."""
ZSTD = b"\x28\xb5\x2f\xfd"
"""Magic bytes of data that zstd compressed; no message in CDR begins with them."""
MCAP_HEADER = b"\x89MCAP0\r\n\x01"
"""Magic bytes of an MCAP file, and the type of its first record, the header."""
_NUM_TIMED = 9
"""Number of pictures of a topic whose times give its period: few are read, and the median of eight
differences is right although some pictures are missing."""
PROFILES = ("", "ros1")
"""Profiles of MCAP files, besides ROS 2's, that are read: none, as Foxglove's tools write, and ROS
1's, as ``mcap convert`` makes of a ``.bag``."""


def main(path: Path, topic: str, limit: int, out: BinaryIO, mode: str) -> None:
    """Write the messages of a bag's topic; if ``topic`` is empty, of its only topic of clouds."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)  # a process may not exceed its hard limit
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    unread: Counter[str] = Counter()
    try:
        _write_messages(path, topic, out, mode, unread)
        _line(out, {"end": True})
    except BrokenPipeError:
        return  # the caller has closed the pipe
    except MemoryError:
        reason = f"reading needs more than {limit >> 20} MiB"
        _line(out, {"error": reason, "unread": unread.total()})
    except Exception as error:  # rosbags raises various types for damaged files
        _line(out, {"error": _told(error), "unread": unread.total()})


def _told(error: Exception) -> str:
    return f"{type(error).__name__}: {str(error)[:300]}"


def _write_messages(path: Path, topic: str, out: BinaryIO, mode: str, unread: Counter[str]) -> None:
    """Write the messages; ``unread`` counts the clouds of each topic that are not reached yet."""
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader

    head = b""  # of a folder
    if path.is_file():
        with path.open("rb") as file:
            head = file.read(1024)
    profile = _mcap_profile(head)
    if profile not in (None, "ros2") and not (profile in PROFILES and _allows_profiles()):
        _line(out, {"profile": profile})
        return
    _allow_schemas()
    with (Ros1Reader if head.startswith(b"#ROSBAG ") else Ros2Reader)(path) as opened:
        bag = Bag(opened)
        if mode == "images":
            _write_images(bag, out)
            return
        clouds = [each for each in bag.connections if each.msgtype in (CLOUD, *LIVOX)]
        names = sorted({each.topic for each in clouds})
        if (topic and topic not in names) or (not topic and len(names) > 1):
            _line(out, {"topics": names})
            return
        if not names:
            _line(out, {"kinds": bag.kinds})
            return
        wanted = [each for each in clouds if each.topic == (topic or names[0])]
        unread[names[0]] = sum(each.msgcount for each in wanted)
        if mode == "pictures":
            found = (_decoded(bag, each)[0] for each in bag.messages(connections=wanted))
            lidar = next((header["frame_id"] for header in found if "bad" not in header), "")
            wanted += _chosen(bag, out, _cameras(bag, lidar))
        for each in bag.messages(connections=wanted):
            _message(out, *_decoded(bag, each))
            unread[names[0]] -= each[0].msgtype not in (IMAGE, COMPRESSED)


def _decoded(bag: Bag, each: tuple[Any, int, bytes]) -> tuple[dict[str, Any], bytes]:
    """Return the header and the data of a message, or a header that states why it is damaged."""
    is_picture = each[0].msgtype in (IMAGE, COMPRESSED)
    try:
        return _picture(bag, each) if is_picture else _cloud(bag, each)
    except Exception as error:  # rosbags raises various types for damaged messages
        if isinstance(error, MemoryError):
            raise
        kind = {"picture": each[0].topic} if is_picture else {}
        return kind | {"bad": _told(error), "received_ns": int(each[1])}, b""


class Bag:
    """A bag that rosbags has opened, with the messages that it can decode.

    Attributes
    ----------
    connections : list
        Connections with messages of ROS 1 or of CDR; their types have the names of ROS 2.
    kinds : list of str
        Types of all messages, sorted.
    """

    def __init__(self, bag: Any) -> None:
        named = [each._replace(msgtype=_ros2_name(each.msgtype)) for each in bag.connections]
        self.connections = [each for each in named if _encoding(each) in ("ros1", "cdr")]
        self.kinds = sorted({each.msgtype for each in named})
        self.messages = bag.messages
        self._metadata: dict[str, dict[int, dict[str, Any] | None]] = {}

    def read(self, connection: Any, raw: bytes) -> Any:
        """Return a message decoded."""
        if is_ros1(connection):
            if _is_of_realsense(connection):
                raw, _ = _without_unit(raw)
            return _types("ROS1_NOETIC").deserialize_ros1(raw, connection.msgtype)
        if raw[:4] == ZSTD:  # librealsense 2.58 compresses each message; the bag does not state it
            raw = _unpacked(raw)
        return _types("ROS2_HUMBLE").deserialize_cdr(raw, connection.msgtype)

    def read_all(self, connections: list[Any]) -> Iterator[tuple[int, Any]]:
        """Yield time and content of each message; None instead of one that cannot be decoded."""
        for connection, time, raw in self.messages(connections=connections) if connections else ():
            try:
                message = self.read(connection, raw)
            except MemoryError:
                raise
            except Exception:  # rosbags raises various types for damaged messages
                message = None
            yield int(time), message

    def metadata(self, topic: str, received: int) -> dict[str, Any]:
        """Return ``stamp_ns`` and ``unit`` of a RealSense's image in a ROS 2 bag, if it has them.

        Its recorder writes them as a text that was received at the same time as the image. The
        image's own stamp counts from the beginning of the recording.
        """
        stream, is_realsense, _ = topic.partition(REALSENSE_IMAGE)
        if not is_realsense:
            return {}
        if stream not in self._metadata:
            wanted = [
                each
                for each in self.connections
                if each.msgtype == TEXT and each.topic == f"{stream}/image/metadata"
            ]
            self._metadata[stream] = {
                time: None if text is None else _metadata(text.data)
                for time, text in self.read_all(wanted)
            }
        found = self._metadata[stream].get(int(received), {})
        if found is None:  # the image's own stamp is of another clock
            raise ValueError("the text that states its time and unit is damaged")
        return found


def _encoding(connection: Any) -> str:
    # Connections of ROS 1 bags do not have this attribute.
    return str(getattr(connection.ext, "serialization_format", "ros1"))


def is_ros1(connection: Any) -> bool:
    """Return whether the messages of a connection are encoded as those of ROS 1."""
    return _encoding(connection) == "ros1"


def _unpacked(data: bytes) -> bytes:
    """Decompress by zstd, with the package that rosbags has chosen."""
    from rosbags.rosbag2 import reader

    return bytes(getattr(reader, "zstd").decompress(bytes(data)))  # noqa: B009


def _metadata(text: str) -> dict[str, Any]:
    """Return time and depth unit of ``timestamp=MILLISECONDS;depth_units=METRES;...``."""
    values = dict(each.partition("=")[::2] for each in text.split(";"))
    found: dict[str, Any] = {}
    with contextlib.suppress(KeyError, ValueError):
        found["unit"] = float(values["depth_units"])
    with contextlib.suppress(KeyError, ValueError, OverflowError):
        stamp_ns = round(float(values["timestamp"]) * 1e6)
        if 0 < stamp_ns < 1 << 63:
            found["stamp_ns"] = stamp_ns
    return found


def _is_of_realsense(connection: Any) -> bool:
    return connection.msgtype == IMAGE and str(connection.topic).endswith(REALSENSE_IMAGE)


def _without_unit(raw: bytes) -> tuple[bytes, float]:
    """Separate an Image of ROS 1 from the depth unit in metres that follows it; 0 if none does.

    librealsense appends the unit from its version 2.54 on (a float32, 0 for colours), although the
    message definition does not have it.
    """
    try:
        end = _end_of_image(raw)
    except struct.error:
        return raw, 0.0  # rosbags states that the message is too short
    if len(raw) - end != 4:
        return raw, 0.0
    return raw[:end], float(struct.unpack_from("<f", raw, end)[0])


def _end_of_image(raw: bytes) -> int:
    """Return where an Image of ROS 1 ends by the lengths that it states."""

    def after_list(at: int) -> int:
        return at + 4 + int(struct.unpack_from("<I", raw, at)[0])

    frame_id = 12  # after the sequence number and the time stamp
    encoding = after_list(frame_id) + 8  # after height and width
    pixels = after_list(encoding) + 5  # after is_bigendian and step
    return after_list(pixels)


def _ros2_name(kind: str) -> str:
    """Return the ROS 2 name of a message type; ROS 1's, as in MCAP files, has no ``msg``."""
    package, slash, name = kind.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else kind


@functools.cache
def _types(store: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores[store])


def _mcap_profile(head: bytes) -> str | None:
    """Return the profile that the first bytes of an MCAP file state; None for other bags."""
    if not head.startswith(MCAP_HEADER):
        return None
    begin = len(MCAP_HEADER) + 8  # after the length of the record
    size = int.from_bytes(head[begin : begin + 4], "little")
    return head[begin + 4 : begin + 4 + size].decode(errors="replace")


def _allows_profiles() -> bool:
    """Let rosbags open an MCAP file with one of `PROFILES`, although its profile is not ROS 2's.

    Types and encodings of the channels tell which messages it holds. rosbags has no option for
    this. Return False if it has changed.
    """
    from rosbags.rosbag2 import storage_mcap

    read_string = getattr(storage_mcap, "read_string", None)
    if read_string is None:
        return False

    def read_profile(stream: Any) -> Any:
        # The profile is the first text that rosbags reads.
        setattr(storage_mcap, "read_string", read_string)  # noqa: B010
        told = read_string(stream)
        return "ros2" if told in PROFILES else told

    setattr(storage_mcap, "read_string", read_profile)  # noqa: B010
    return True


def _allow_schemas() -> None:
    """Let rosbags open MCAP files, also of bag folders, that have channels of other schemas.

    A schema may be ros1msg, jsonschema or protobuf; `Bag` leaves out messages that it cannot
    decode.
    """
    from rosbags.rosbag2 import storage_mcap

    get_msgdef = getattr(storage_mcap, "get_msgdef", None)
    if get_msgdef is None:
        return

    def get_known(schema: Any) -> Any:
        try:
            return get_msgdef(schema)
        except KeyError:
            return get_msgdef(None)

    setattr(storage_mcap, "get_msgdef", get_known)  # noqa: B010


def _write_images(bag: Bag, out: BinaryIO) -> None:
    """Write the list of cameras, then the pictures of the topics that the caller selects."""
    wanted = _chosen(bag, out, _cameras(bag, "") | _rgbd(bag))
    for each in bag.messages(connections=wanted) if wanted else ():
        _message(out, *_decoded(bag, each))


def _chosen(bag: Bag, out: BinaryIO, cameras: dict[str, Any]) -> list[Any]:
    """Write the list of cameras, and return the connections of the topics the caller selects."""
    _line(out, {"cameras": cameras})
    chosen = json.loads(sys.stdin.readline() or "[]")
    return [
        each
        for each in bag.connections
        if each.topic in chosen and each.msgtype in (IMAGE, COMPRESSED)
    ]


def _cameras(bag: Bag, lidar: str) -> dict[str, Any]:
    """Return the topics of pictures, each camera's first calibration, and the fixed transforms.

    ``lidar`` is the name of the coordinate frame of the clouds.
    """
    infos = {topic: _camera_info(info) for topic, info in _first_ones(bag, CAMERA_INFO)}
    fixed = [
        each
        for each in bag.connections
        if each.msgtype == TRANSFORMS and each.topic.endswith("tf_static")
    ]
    transforms = [
        _transform(each)
        for connection, _, raw in (bag.messages(connections=fixed) if fixed else ())
        for each in bag.read(connection, raw).transforms
    ]
    names = {each.topic for each in bag.connections if each.msgtype in (IMAGE, COMPRESSED)}
    return {"pictures": sorted(names), "infos": infos, "transforms": transforms, "lidar": lidar}


def _first_ones(bag: Bag, *kinds: str, topics: str = "") -> Iterator[tuple[str, Any]]:
    """Yield topic and first readable message of each connection of one of the message types.

    The topics match the regular expression ``topics``: others are not read.
    """
    for connection in bag.connections:
        if connection.msgtype in kinds and re.search(topics, connection.topic):
            for _, message in bag.read_all([connection]):
                if message is not None:
                    yield connection.topic, message
                    break


def _rgbd(bag: Bag) -> dict[str, Any]:
    """Return the properties of each topic of pictures, and what RealSense's recorder adds.

    RealSense's recorder writes camera poses (``poses``) and options such as the depth unit
    (``numbers``) as messages; in bags of ROS 2 both are ``texts``, and cameras, too.
    """
    images = {}
    for topic, first in _first_ones(bag, IMAGE, COMPRESSED):
        connections = [each for each in bag.connections if each.topic == topic]
        headers = _first_headers(bag, connections)
        layout = headers[0] if headers else {}
        images[topic] = {
            "frame_id": first.header.frame_id,
            **{name: layout.get(name, "") for name in ("encoding", "format")},
            "unit": layout.get("unit", 0.0),
            "count": sum(each.msgcount for each in connections),
            "period_ns": _period_ns(headers),
        }
    numbers = {topic: float(first.data) for topic, first in _first_ones(bag, NUMBER)}
    poses = {topic: _pose(first) for topic, first in _first_ones(bag, TRANSFORM)}
    texts = {
        topic: str(first.data) for topic, first in _first_ones(bag, TEXT, topics=REALSENSE_TEXT)
    }
    return {"images": images, "numbers": numbers, "poses": poses, "texts": texts}


def _first_headers(bag: Bag, connections: list[Any]) -> list[dict[str, Any]]:
    """Return the headers of the first pictures of a topic, without those of damaged ones."""
    first = islice(bag.messages(connections=connections), _NUM_TIMED)
    headers = [header for header, _ in (_decoded(bag, each) for each in first)]
    return [header for header in headers if "bad" not in header]


def _period_ns(headers: list[dict[str, Any]]) -> int:
    """Return the median time between pictures; 0 if there are no two."""
    between = [b - a for a, b in pairwise(sorted(header["stamp_ns"] for header in headers))]
    return median_low(between) if between else 0


def _camera_info(info: Any) -> dict[str, Any]:
    """Return size, distortion and matrices of a CameraInfo; ROS 1 has the names in capitals."""
    values = {
        name: [float(v) for v in getattr(info, name, getattr(info, name.upper(), ()))]
        for name in ("d", "k", "r", "p")
    }
    size = {"width": int(info.width), "height": int(info.height)}
    model = {"model": info.distortion_model}
    return {"frame_id": info.header.frame_id, **size, **model, **values}


def _transform(each: Any) -> dict[str, Any]:
    return {
        "parent": each.header.frame_id,
        "child": each.child_frame_id,
        **_pose(each.transform),
    }


def _pose(transform: Any) -> dict[str, Any]:
    shift, turn = transform.translation, transform.rotation
    return {
        "translation": [float(v) for v in (shift.x, shift.y, shift.z)],
        "rotation": [float(v) for v in (turn.x, turn.y, turn.z, turn.w)],
    }


def _picture(bag: Bag, each: tuple[Any, int, bytes]) -> tuple[dict[str, Any], bytes]:
    connection, received, raw = each
    picture = bag.read(connection, raw)
    header = {"picture": connection.topic, "stamp_ns": _stamp(picture) or int(received)}
    if is_ros1(connection):
        header |= {"unit": _without_unit(raw)[1]} if _is_of_realsense(connection) else {}
    else:
        header |= bag.metadata(connection.topic, received)
    layout, data = _pixels(picture)
    return header | layout, data


def _pixels(picture: Any) -> tuple[dict[str, Any], bytes]:
    """Return the layout of a picture and its bytes."""
    data = picture.data.tobytes()
    if not hasattr(picture, "format"):
        size = {name: int(getattr(picture, name)) for name in ("height", "width", "step")}
        is_bigendian = bool(picture.is_bigendian)
        return {"encoding": picture.encoding, "is_bigendian": is_bigendian, **size}, data
    packed = REALSENSE_PACKED.fullmatch(picture.format)
    if packed is None:
        return {"format": picture.format}, data
    width, height, step = map(int, packed.groups()[1:])
    size = {"height": height, "width": width, "step": step}
    return {"encoding": packed[1], "is_bigendian": False, **size}, _unpacked(data)


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def _cloud(bag: Bag, each: tuple[Any, int, bytes]) -> tuple[dict[str, Any], bytes]:
    """Return the layout of a message's points, and their bytes."""
    connection, received, raw = each
    header = {"topic": connection.topic, "received_ns": int(received)}
    if connection.msgtype in LIVOX:
        layout, data = _livox(bytes(raw), is_ros1=is_ros1(connection))
        return header | layout, data
    cloud = bag.read(connection, raw)
    layout = {
        "stamp_ns": _stamp(cloud),
        "frame_id": cloud.header.frame_id,
        "height": int(cloud.height),
        "width": int(cloud.width),
        "point_step": int(cloud.point_step),
        "row_step": int(cloud.row_step),
        "is_bigendian": bool(cloud.is_bigendian),
        "fields": [
            [each.name, int(each.offset), int(each.datatype), int(each.count)]
            for each in cloud.fields
        ],
    }
    return header | layout, cloud.data.tobytes()


def _livox(raw: bytes, *, is_ros1: bool) -> tuple[dict[str, Any], bytes]:
    """Read a Livox CustomMsg, whose points have 19 bytes each; CDR pads them to 20.

    Four bytes come before the time stamp: the sequence number in ROS 1, the encapsulation header in
    CDR (OMG DDSI-RTPS). CDR aligns numbers of eight bytes to eight bytes, counted from the end of
    that header.
    """
    if not is_ros1 and raw[:2] not in (b"\0\0", b"\0\1"):
        raise ValueError(f"a CustomMsg in another encoding than plain CDR ({raw[:2].hex()})")
    order = "<" if is_ros1 or raw[1] else ">"
    try:
        seconds, nanoseconds, length = struct.unpack_from(f"{order}III", raw, 4)
        at = 16 + length
        at += 0 if is_ros1 else -(at - 4) % 8
        timebase_ns, _, _, count = struct.unpack_from(f"{order}QI4sI", raw, at)
    except struct.error:
        raise ValueError("a CustomMsg that ends before its points") from None
    step = 19 if is_ros1 else 20
    layout = {
        "stamp_ns": seconds * 1_000_000_000 + nanoseconds or timebase_ns,
        "frame_id": raw[16 : 16 + length].rstrip(b"\0").decode(errors="replace"),
        "height": 1,
        "width": count,
        "point_step": step,
        "row_step": count * step,
        "is_bigendian": order == ">",
        "fields": LIVOX_FIELDS,
    }
    return layout, raw[at + 20 :] + b"\0" * (step - 19)  # CDR does not pad the last point


def _message(out: BinaryIO, header: dict[str, Any], data: bytes) -> None:
    _line(out, header | {"size": len(data)})
    out.write(data)
    out.flush()


def _line(out: BinaryIO, record: dict[str, Any]) -> None:
    out.write(json.dumps(record).encode() + b"\n")
    out.flush()


if __name__ == "__main__":
    main(
        Path(sys.argv[1]),
        sys.argv[2],
        int(sys.argv[3]),
        sys.stdout.buffer,
        sys.argv[4],
    )
