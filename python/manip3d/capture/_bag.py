"""Point clouds of ROS bags: ROS 1 (.bag), ROS 2 (a folder, .db3) and MCAP, through rosbags."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import re
import sqlite3
import struct
import subprocess
import sys
import threading
import urllib.parse
import weakref
from collections.abc import Iterator, Mapping, Sequence
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError, MissingExtraError
from manip3d.io._files import check_regular, open_regular, over_max_bytes
from manip3d.io._scan_tables import Table, frame_of_table
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MEMORY = 4 << 30
"""Limit of the address space of the process that reads a bag, in bytes. A decompressed chunk of a
few hundred megabytes fits."""
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
"""Type codes of sensor_msgs/PointField, as NumPy's type names."""
_MAX_POINTS = 1 << 28  # largest number of points in a message
_FIXED_FRAMES = ("base", "map", "odom", "world", "earth", "utm")
"""Parts of the names of coordinate frames whose origin is not the scanner (REP 105)."""


_ROS1 = b"#ROSBAG V2.0\n"
_LIDARS = (
    "sensor_msgs/PointCloud2",
    "livox_ros_driver/CustomMsg",
    "livox_ros_driver2/CustomMsg",
    "livox_interfaces/CustomMsg",
)
"""Message types (ROS 1 names) that hold a LiDAR's points."""
_PACKETS = {
    "velodyne_msgs/VelodyneScan": "the package velodyne_pointcloud",
    "ouster_ros/PacketMsg": "the package ouster_ros (its launch file replay)",
    "ouster_msgs/PacketMsg": "the package ouster_ros (its launch file replay)",
    "ouster_sensor_msgs/PacketMsg": "the package ouster_ros (its launch file replay)",
    "pandar_msgs/PandarScan": "the package pandar_pointcloud",
    "hesai_lidar/PandarScan": "the package hesai_lidar",
    "hesai_ros_driver/UdpFrame": "the package hesai_ros_driver",
    "rslidar_msg/RslidarPacket": "the package rslidar_sdk (msg_source: 2 in its config.yaml)",
    "rslidar_msg/RslidarScan": "the package rslidar_sdk (msg_source: 2 in its config.yaml)",
    "rslidar_msgs/rslidarScan": "the package rslidar_pointcloud",
    "robosense_msgs/RobosenseScan": "the driver nebula",
    "nebula_msgs/NebulaPackets": "the driver nebula",
}
"""Message types (ROS 1 names) that hold a LiDAR's raw packets, with the driver that converts these
to points."""
_IMAGE = b"type=sensor_msgs/Image"
_PACKED = b"type=sensor_msgs/CompressedImage"
_IMAGES = "sensor_msgs/msg/Image"
_HEAD = 4096  # bytes; the header record of a ROS 1 bag is padded to this length
_MAX_INDEX = 1 << 24  # bytes of the index that are searched for message types
_MCAP = b"\x89MCAP0\r\n"
_MCAP_FOOTER = 9 + 20 + len(_MCAP)  # record header; two offsets and a checksum; the magic bytes
_MCAP_SCHEMA = 3  # type of the records that name types of messages
_MAX_METADATA = 1 << 22  # bytes of metadata.yaml that are searched for message types
_IMAGES_2 = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")


@checked
def holds_clouds(path: str | os.PathLike[str]) -> bool:
    """Return whether a ROS bag has point clouds of a LiDAR instead of images of an RGB-D camera.

    Only the list of message types is read: from the index at the end of a ROS 1 bag, the summary
    at the end of an MCAP file, the ``metadata.yaml`` of a ROS 2 bag, or the topics of a ``.db3``
    file. The result is True if there are point clouds (``PointCloud2``, or Livox's ``CustomMsg``)
    or packets of a LiDAR, with or without images. A bag with none of these is taken for a LiDAR's,
    too: its scans may have a type of their own, or a ROS 2 bag may have no list.

    Parameters
    ----------
    path : path
        A bag of ROS 1 (``.bag``), an MCAP or ``.db3`` file, or the folder of a ROS 2 bag.

    Returns
    -------
    bool
        False also for files that are not ROS bags.

    Raises
    ------
    FormatError
        The file is a pipe or a device, or a ROS 1 bag without messages or without an index,
        because it was cut off or its recorder did not close it.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> from manip3d import capture
    >>> with open("walk.bag", "wb") as bag:
    ...     _ = bag.write(b"no bag")
    >>> capture.holds_clouds("walk.bag")
    False
    """
    place = path_of(path)
    if place.is_dir():
        return _are_clouds(_types_of_folder(place))
    if place.suffix.lower() == ".db3":
        return _are_clouds(_types_of_database(place))
    with open_regular(place) as file:
        head = file.read(_HEAD)
        if head.startswith(_MCAP):
            return _are_clouds(_types_of_mcap(file))
        if head.startswith(_ROS1):
            return _are_ros1_clouds(_connections_of_ros1(file, head, path))
    return False


def _connections_of_ros1(file: BufferedReader, head: bytes, path: str | os.PathLike[str]) -> bytes:
    """Return the index at the end of a ROS 1 bag, which lists its connections with their types."""
    name = head.find(b"index_pos=")
    index = int.from_bytes(head[name + 10 : name + 18], "little") if name >= 0 else 0
    connections = b""
    if 0 < index < 1 << 62:
        file.seek(index)
        connections = file.read(_MAX_INDEX)
        if not connections and file.seek(0, os.SEEK_END) == index:
            raise FormatError("a ROS 1 bag without a message", file=str(path))
    if not connections:
        raise FormatError(
            "expected the index of a ROS 1 bag at its end, found none: it is cut off, or its "
            "recorder did not close it ('rosbag reindex' may mend it)",
            file=str(path),
        )
    return connections


def _are_ros1_clouds(connections: bytes) -> bool:
    """Return whether a ROS 1 bag with these connections is a LiDAR's."""
    if any(f"type={kind}".encode() in connections for kind in (*_LIDARS, *_PACKETS)):
        return True
    return b"type=" in connections and not any(kind in connections for kind in (_IMAGE, _PACKED))


def _are_clouds(types: bytes) -> bool:
    """Return whether a ROS 2 bag with these types of messages is a LiDAR's."""
    has_images = any(re.search(kind.encode() + rb"\b", types) for kind in _IMAGES_2)
    has_lidar = any(_in_ros2(kind).encode() in types for kind in (*_LIDARS, *_PACKETS))
    return has_lidar or not has_images


def _in_ros2(kind: str) -> str:
    """Return the ROS 2 name of a message type, from its ROS 1 name."""
    return kind.replace("/", "/msg/")


def _types_of_folder(folder: Path) -> bytes:
    with open_regular(folder / "metadata.yaml") as file:
        return file.read(_MAX_METADATA)


def _types_of_database(path: Path) -> bytes:
    open_regular(path).close()  # raises OSError, and refuses pipes
    address = f"file:{urllib.parse.quote(os.fsencode(path.resolve()))}?mode=ro&immutable=1"
    try:
        with contextlib.closing(sqlite3.connect(address, uri=True)) as database:
            rows = database.execute("SELECT type FROM topics LIMIT 10000").fetchall()
    except sqlite3.Error:  # BagRecording opens the file next and reports the error
        return b""
    return " ".join(str(kind) for (kind,) in rows).encode()


def _types_of_mcap(file: BufferedReader) -> bytes:
    """Return the names of an MCAP file's schemas, those of ROS 2; empty without a summary."""
    end = file.seek(0, os.SEEK_END)
    file.seek(max(0, end - _MCAP_FOOTER))
    footer = file.read(_MCAP_FOOTER)
    start = int.from_bytes(footer[9:17], "little")
    if not footer.endswith(_MCAP) or not 0 < start < end:
        return b""
    file.seek(start)
    summary, at, names = file.read(_MAX_INDEX), 0, []
    while at + 9 <= len(summary):
        kind, size = struct.unpack_from("<BQ", summary, at)
        if kind == _MCAP_SCHEMA and size >= 6:  # number of the schema, length of its name, name
            length = int.from_bytes(summary[at + 11 : at + 15], "little")
            package, slash, name = summary[at + 15 : at + 15 + length].partition(b"/")
            names.append(package + slash + (b"" if b"/" in name else b"msg/") + name)
        at += 9 + size
    return b" ".join(names)


def _without_end(path: Path) -> Path | None:
    """Return the first MCAP file of a bag without magic bytes at its end; None if all have them."""
    for each in sorted(path.glob("*.mcap")) if path.is_dir() else (path,):
        with contextlib.suppress(OSError, FormatError), open_regular(each) as file:
            start = file.read(len(_MCAP))
            end = file.seek(0, os.SEEK_END)
            file.seek(max(0, end - len(_MCAP)))
            is_whole = end > len(_MCAP) and file.read() == _MCAP
            if start and _MCAP.startswith(start) and not is_whole:
                return each
    return None


def place_and_topic(uri: str) -> tuple[str, str]:
    """Return path and topic of ``bag:PATH#TOPIC``; the topic is empty if the address has none.

    File names may contain ``#``, topic names may not.
    """
    place = uri.partition(":")[2]
    path, mark, topic = place.rpartition("#")
    return (path, topic) if mark and not os.path.exists(place) else (place, "")


class BagPicture(NamedTuple):
    """An image message of a bag: its header fields, and the pixels still encoded."""

    header: Mapping[str, Any]
    data: bytes


class UnreadPicture(NamedTuple):
    """An image message of a bag that cannot be decoded: its topic, and the reason."""

    topic: str
    reason: str


class UnreadCloud(NamedTuple):
    """A cloud of a bag that cannot be read: the reason, and the time if it is known."""

    reason: str
    time_ns: int | None


BagMessage: TypeAlias = LidarFrame | UnreadCloud | BagPicture | UnreadPicture


class BagRecording:
    """Frames of one topic of a bag, with the interface of the sources in ``_core``.

    A message that cannot be read raises a `FormatError`, and the next one can be read after it.
    """

    def __init__(
        self,
        path: Path,
        topic: str,
        max_bytes: int | None = None,
        *,
        mode: Literal["clouds", "pictures", "images"] = "clouds",
    ) -> None:
        if importlib.util.find_spec("rosbags") is None:
            raise MissingExtraError("rosbags", "bags")
        if not path.is_dir():
            check_regular(path)  # raises an OSError before the parser runs
        elif not (path / "metadata.yaml").is_file():
            raise FormatError("a folder of a ROS 2 bag has a metadata.yaml", file=str(path))
        self._path = path
        self._uri = f"bag:{path}"
        self._max_bytes = self._left = max_bytes
        self._counters = {"frames": 0, "points": 0, "no_return": 0}
        self._number = 0  # of clouds, with those that cannot be read
        self.num_unread_pictures = 0
        self.first_unread_picture: UnreadPicture | None = None
        self._lock = threading.RLock()
        self._ended = False
        # The first frame that has points determines it. With pictures, the clouds stay in the frame
        # that the bag's transforms lead from.
        self._to_file: NDArray[np.float64] | None = None if mode == "clouds" else np.eye(4)
        script = Path(__file__).with_name("_bag_process.py")
        # -P keeps the script's folder out of sys.path, since its module names may shadow others.
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-P", str(script), str(path.absolute()), topic, str(_MEMORY)),
                mode,
            ],
            stdin=subprocess.DEVNULL if mode == "clouds" else subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # so that Ctrl-C interrupts only the calling process
        )
        weakref.finalize(self, _end, self._process)

    def read(self, timeout_ms: int) -> LidarFrame | bool:
        """Return the next frame, or False at the end."""
        with self._lock:
            if self._ended:
                return False
            header = self._header()
            if "end" in header:
                self._close()
                return False
            return self._cloud(header, self._data(header))

    @property
    def goes_on(self) -> bool:
        """Whether another frame may follow after an error."""
        return not self._ended

    def cameras(self) -> dict[str, Any]:
        """Return the bag's image topics, CameraInfos and fixed transforms; call it first and once.

        Only the modes ``pictures`` and ``images`` have them.
        """
        cameras: dict[str, Any] = self._header()["cameras"]
        return cameras

    def messages(self, topics: Sequence[str]) -> Iterator[BagMessage]:
        """Yield the clouds and the pictures of these topics in the order of the recording."""
        assert self._process.stdin is not None
        # If the reading process has ended, _header() below raises the reason.
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(json.dumps(list(topics)).encode() + b"\n")
            self._process.stdin.close()
        while "end" not in (header := self._header()):
            data = self._data(header)
            if "picture" not in header:
                yield self._cloud_or_why(header, data)
            elif "bad" in header:
                unread = UnreadPicture(header["picture"], f"it cannot be decoded: {header['bad']}")
                self.num_unread_pictures += 1
                self.first_unread_picture = self.first_unread_picture or unread
                yield unread
            else:
                yield BagPicture(header, data)
        self._close()

    def _cloud_or_why(self, header: dict[str, Any], data: bytes) -> LidarFrame | UnreadCloud:
        try:
            return self._cloud(header, data)
        except FormatError as error:
            return UnreadCloud(str(error), header.get("stamp_ns") or header["received_ns"])

    def close(self) -> None:
        """End the process that reads the bag; may be called twice."""
        with self._lock:
            self._close()

    def _cloud(self, header: dict[str, Any], data: bytes) -> LidarFrame:
        number = self._number
        self._number += 1
        try:
            if "bad" in header:
                raise FormatError(f"it cannot be decoded: {header['bad']}")
            frame = self._frame(header, data)
        except FormatError as error:
            self._counters["damaged"] = self._counters.get("damaged", 0) + 1
            reason = f"message {number}: {error.reason}"
            raise FormatError(reason, file=str(self._path)) from error
        self._counters["frames"] += 1
        self._counters["points"] += frame.num_points
        self._counters["no_return"] += frame.num_dropped
        return frame

    def counters(self) -> dict[str, int]:
        """Return the numbers of frames, of points, of points without coordinates, and of damage."""
        return dict(self._counters)

    def _header(self) -> dict[str, Any]:
        """Return the next header that the reader of the bag sends: a cloud's, or the end.

        Its other headers are reasons for which the bag cannot be read, and raise errors.

        Raises
        ------
        FormatError
            The bag is damaged, of another kind, or has no point clouds.
        InputError
            The bag has several topics of point clouds, or not the one that was asked for.
        """
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith(b"\n"):
            raise self._refuse("damaged bag: its reader ended")
        header: dict[str, Any] = json.loads(line)
        if "error" in header:
            if (cut := _without_end(self._path)) is not None:
                raise self._refuse(
                    f"{cut.name} has no end: it is cut off, or its recorder did not close it "
                    f"('mcap recover {cut.name} -o whole.mcap' copies the messages that are whole)"
                )
            after = f" after message {self._number - 1}" if self._number else ""
            unread = header.get("unread", 0)
            left = f"; {unread} of its messages were not reached" if unread > 0 else ""
            raise self._refuse(f"the bag cannot be read{after}: {header['error']}{left}")
        if "kinds" in header:
            found = ", ".join(header["kinds"])[:200] or "no topic"
            hint = f"; rgbd-bag:{self._path} may open it" if _IMAGES in header["kinds"] else ""
            for kind, driver in _PACKETS.items():
                if _in_ros2(kind) in header["kinds"]:
                    hint = (
                        f"; {driver} makes clouds of these packets: play the bag to it and record "
                        "its topic of clouds ('rosbag record', 'ros2 bag record')"
                    )
                    if kind.startswith("ouster"):
                        hint = f"; ouster:{self._path} reads these packets"
            raise self._refuse(
                "no point clouds (sensor_msgs/msg/PointCloud2, livox_ros_driver2/msg/CustomMsg); "
                f"it holds {found}{hint}"
            )
        if "profile" in header:
            raise self._refuse(
                f"an MCAP file with the profile {header['profile'][:40]!r}; those of ROS 2 "
                "('ros2') and of ROS 1 ('ros1') are read, and those without a profile"
            )
        if "topics" in header:
            self._close()
            names = ", ".join(header["topics"]) or "none"
            raise InputError(
                f"uri: expected {self._uri}#TOPIC with one of the topics of point clouds: {names}"
            )
        return header

    def _data(self, header: dict[str, Any]) -> bytes:
        assert self._process.stdout is not None
        if self._left is not None and self._max_bytes is not None:
            self._left -= header["size"]
            if self._left < 0:
                raise self._refuse(over_max_bytes(self._max_bytes))
        data = self._process.stdout.read(header["size"])
        if len(data) != header["size"]:
            raise self._refuse("damaged bag: its reader ended")
        return data

    def _frame(self, header: dict[str, Any], data: bytes) -> LidarFrame:
        rows, columns = header["height"], header["width"]
        step, row_step = header["point_step"], header["row_step"]
        if rows * columns > _MAX_POINTS:
            raise FormatError(f"{rows} x {columns} points; at most {_MAX_POINTS}")
        # Some drivers leave row_step at 0 in clouds of one row.
        if rows <= 1 and row_step < columns * step:
            row_step = columns * step
        if row_step < columns * step or rows * row_step > len(data):
            raise FormatError(
                f"{rows} rows of {columns} points of {step} bytes do not fit {len(data)} bytes "
                f"with rows of {row_step}"
            )
        dtype, names = _dtype(header)
        lines = np.frombuffer(data, np.uint8, rows * row_step).reshape(rows, row_step)
        packed = np.ascontiguousarray(lines[:, : columns * step])
        values = packed.reshape(-1).view(dtype) if packed.size else np.empty(0, dtype)
        table = Table("ros", {name: values[key] for name, key in names.items()}, self._uri)
        table.header = {key: header[key] for key in ("topic", "frame_id", "height", "width")}
        lowered = header["frame_id"].lower()
        at_sensor = not any(name in lowered for name in _FIXED_FRAMES)
        stamp = header["stamp_ns"] or header["received_ns"]
        frame = frame_of_table(
            table,
            origin=(0.0, 0.0, 0.0) if at_sensor else None,
            time_ns=stamp,
            to_file=self._to_file,
        )
        if self._to_file is None and frame.num_points and frame.format is not None:
            self._to_file = frame.format.to_file
        return frame

    def _refuse(self, reason: str) -> FormatError:
        self._close()
        return FormatError(reason, file=str(self._path))

    def _close(self) -> None:
        self._ended = True
        _end(self._process)


def _dtype(header: dict[str, Any]) -> tuple[np.dtype[Any], dict[str, str]]:
    """Return the layout of a point, and the key in that layout of each field name.

    If several fields have the same name, the first counts. A coordinate that is named twice is
    refused, because nothing tells which field is the right one.
    """
    order = ">" if header["is_bigendian"] else "<"
    keys, formats, offsets, names = [], [], [], dict[str, str]()
    for number, (name, offset, kind, count) in enumerate(header["fields"]):
        if kind not in _KINDS:
            raise FormatError(f"field {name!r} has the unknown type {kind}")
        one = np.dtype(order + _KINDS[kind])
        count = count or 1  # some drivers write 0
        if offset + count * one.itemsize > header["point_step"]:
            raise FormatError(f"field {name!r} does not fit a point's bytes")
        keys.append(f"{number} {name}")
        formats.append((one, (count,)) if count != 1 else one)
        offsets.append(offset)
        if name in ("x", "y", "z") and name in names:
            raise FormatError(f"field {name} is named twice")
        names.setdefault(name, keys[-1])
    layout = {"names": keys, "formats": formats, "offsets": offsets,
              "itemsize": header["point_step"]}  # fmt: skip
    return np.dtype(layout), names  # type: ignore[call-overload]


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
