"""Reads a ROS bag in a process of its own: no damaged or hostile bag takes the caller along.

A script: ``python _bag_process.py PATH TOPIC BYTES``. It imports nothing of manip3d and writes to
its standard output, for each message of the topic, a line of JSON and then as many bytes as the
line says. The last line holds ``end`` or ``error``.
"""

from __future__ import annotations

import json
import resource
import sys
from pathlib import Path
from typing import Any, BinaryIO

CLOUD = "sensor_msgs/msg/PointCloud2"


def main(path: Path, topic: str, limit: int, out: BinaryIO) -> None:
    """Write the messages of a bag's topic; with an empty name of its only topic of clouds."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)  # nobody may raise it
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    try:
        _write_messages(path, topic, out)
        _line(out, {"end": True})
    except BrokenPipeError:
        return  # nobody wants more
    except MemoryError:
        _line(out, {"error": f"reading needs more than {limit >> 20} MiB"})
    except Exception as error:  # whatever the library makes of a damaged file
        _line(out, {"error": f"{type(error).__name__}: {str(error)[:300]}"})


def _write_messages(path: Path, topic: str, out: BinaryIO) -> None:
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader
    from rosbags.typesys import Stores, get_typestore

    is_ros1 = path.is_file() and path.open("rb").read(8) == b"#ROSBAG "
    types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    read = types.deserialize_ros1 if is_ros1 else types.deserialize_cdr
    with (Ros1Reader if is_ros1 else Ros2Reader)(path) as bag:
        clouds = [each for each in bag.connections if each.msgtype == CLOUD]
        names = sorted({each.topic for each in clouds})
        if (topic and topic not in names) or (not topic and len(names) > 1):
            _line(out, {"topics": names})
            return
        if not names:
            others = sorted({each.msgtype for each in bag.connections})
            raise ValueError(f"no topic of {CLOUD}; found {', '.join(others)[:200] or 'nothing'}")
        wanted = [each for each in clouds if each.topic == (topic or names[0])]
        for connection, received, raw in bag.messages(connections=wanted):
            _cloud(out, read(raw, CLOUD), connection.topic, received)


def _cloud(out: BinaryIO, cloud: Any, topic: str, received: int) -> None:
    stamp = cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec
    data = cloud.data.tobytes()
    header = {
        "topic": topic,
        "received_ns": int(received),
        "stamp_ns": int(stamp),
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
        "size": len(data),
    }
    _line(out, header)
    out.write(data)
    out.flush()


def _line(out: BinaryIO, record: dict[str, Any]) -> None:
    out.write(json.dumps(record).encode() + b"\n")
    out.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), sys.stdout.buffer)
