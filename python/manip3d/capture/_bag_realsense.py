"""Cameras, depth units and poses that RealSense's recorder states beside the images of a ROS bag.

It writes the images of a stream to ``STREAM/image/data``. In bags of ROS 1 (librealsense up to
2.57) it states the rest as messages of numbers and transforms, in those of ROS 2 as texts such as
``rotation=1,0,0,0,1,0,0,0,1;translation=0,0,0``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.linear import inverse, product
from manip3d.capture._bag_pictures import rigid

if TYPE_CHECKING:
    from numpy.typing import NDArray

_IMAGES = "/image/data"
_MOST_SKEW = 1e-4
"""Largest deviation of a rotation's product with its transpose from the identity; texts have six
digits after the point."""

_FEWEST_UNITS, _MOST_UNITS = 1.0, 1e6
"""Limits of the depth units of a metre: 16 bits of smaller or larger ones hold no distances of
rooms and people, so that another unit is damage."""


def without_transport(topic: str) -> str:
    """Return a topic of pictures without the name of the transport that compressed them."""
    return topic.removesuffix("/compressedDepth").removesuffix("/compressed")


def stream_of(topic: str) -> str | None:
    """Return the stream whose images a topic has; None if RealSense's recorder has not named it."""
    base = without_transport(topic)
    return base.removesuffix(_IMAGES) if base.endswith(_IMAGES) else None


def camera_info(found: Mapping[str, Any], stream: str) -> tuple[str, Mapping[str, Any] | None]:
    """Return the name and the content of a stream's CameraInfo; None if the bag has none.

    librealsense 2.58 states it only as a text. From 2.59 on there is a CameraInfo, too, but it
    names each lens ``plumb_bob``.
    """
    infos = found["infos"]
    text = _info_of_text(found["texts"].get(f"{stream}/camera_info", ""))
    for name in (f"{stream}/info/camera_info", f"{stream}/image/camera_info"):
        if name in infos:
            return name, infos[name] | ({"model": text["model"]} if text else {})
    if text:
        return f"{stream}/camera_info", text
    return f"{stream}/info/camera_info", None


def units_per_metre(found: Mapping[str, Any], stream: str) -> float:
    """Return how many stored units a metre has by the option of the depth sensor; 0 if unknown."""
    sensor = stream.rpartition("/")[0]
    for name in ("Depth Units", "Depth_Units"):
        option = f"{sensor}/option/{name}/value"
        unit = found["numbers"].get(option) or _number(found["texts"].get(option, ""))
        if units := per_metre(unit):
            return units
    return 0.0


def per_metre(unit: float) -> float:
    """Return how many depth units, each of ``unit`` metres, a metre has; 0 if ``unit`` is none.

    The result is rounded because the unit is stored as a float32.
    """
    if not unit > 0.0:
        return 0.0
    units = float(np.rint(1.0 / unit * 1000.0) / 1000.0)
    return units if _FEWEST_UNITS <= units <= _MOST_UNITS else 0.0


def relative_pose(found: Mapping[str, Any], color: str, depth: str) -> NDArray[np.float64] | None:
    """Return T_color_depth of two topics of images; None if the bag does not state it.

    The recorder stores the pose of each stream relative to a common reference stream.
    """
    streams = [stream_of(topic) for topic in (color, depth)]
    of_color, of_depth = (_poses(found, stream) if stream else {} for stream in streams)
    both = sorted(of_color.keys() & of_depth.keys())
    if not both:
        return None
    to_color, to_depth = of_color[both[0]], of_depth[both[0]]
    if to_color is None or to_depth is None:
        return None
    return product(to_color, inverse(to_depth))


def _poses(found: Mapping[str, Any], stream: str) -> dict[str, NDArray[np.float64] | None]:
    """Return a stream's poses by the names of their reference streams."""
    start = f"{stream}/tf/"  # the rest of the topic's name is the number of the reference stream
    numbers = {
        name.removeprefix(start): rigid(pose)
        for name, pose in found["poses"].items()
        if name.startswith(start)
    }
    texts = {
        name.removeprefix(start): _pose_of_text(text)
        for name, text in found["texts"].items()
        if name.startswith(start)
    }
    return numbers | texts


def _pose_of_text(text: str) -> NDArray[np.float64] | None:
    """Return the (4, 4) pose of a text, whose rotation is stored column by column."""
    values = _values(text)
    columns, shift = _numbers(values.get("rotation", "")), _numbers(values.get("translation", ""))
    if len(columns) != 9 or len(shift) != 3:
        return None
    rotation = np.array(columns).reshape(3, 3).T
    skew = np.abs(product(rotation, rotation.T) - np.eye(3)).max()
    if not skew < _MOST_SKEW or not np.isfinite(shift).all():
        return None
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, shift
    return matrix


def _info_of_text(text: str) -> dict[str, Any]:
    """Return the fields of a CameraInfo that a text has; empty if one is missing."""
    values = _values(text)
    size = [_number(values.get(name, "")) for name in ("width", "height")]
    fx, fy, cx, cy = (_number(values.get(name, "")) for name in ("fx", "fy", "ppx", "ppy"))
    if not all(number.is_integer() for number in size) or not np.isfinite([fx, fy, cx, cy]).all():
        return {}
    return {
        "frame_id": "",
        "width": int(size[0]),
        "height": int(size[1]),
        "model": values.get("model", ""),
        "d": _numbers(values.get("coeffs", "")),
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "p": [],
    }


def _values(text: str) -> dict[str, str]:
    """Return the values of ``name=value;name=value``."""
    return dict(each.partition("=")[::2] for each in text.split(";"))


def _numbers(text: str) -> list[float]:
    return [_number(each) for each in text.split(",")]


def _number(text: str) -> float:
    """Return a number; NaN if the text is none."""
    try:
        return float(text)
    except ValueError:
        return math.nan
