"""RGB-D cameras in ROS bags: depth images, the colour images taken with them, and calibrations."""

from __future__ import annotations

import re
import struct
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import astuple, dataclass
from itertools import islice, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from manip3d._util.callers import caller_level
from manip3d.camera import Intrinsics, Registration
from manip3d.capture._bag import BagMessage, BagPicture, BagRecording, UnreadPicture
from manip3d.capture._bag_pictures import (
    COLOR_ENCODINGS,
    GREY_ENCODINGS,
    decoded,
    pose_of,
    rows_of,
)
from manip3d.capture._bag_realsense import (
    camera_info,
    per_metre,
    relative_pose,
    stream_of,
    units_per_metre,
    without_transport,
)
from manip3d.capture._folder_warnings import SET_UNIT
from manip3d.errors import FormatError, InputError
from manip3d.io._depth_files import MAX_PIXELS
from manip3d.io._depth_formats import decode_depth
from manip3d.io._intrinsics_files import is_brown
from manip3d.rgbd import NO_MEASUREMENT, RgbdCalibration, RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MILLIMETRES = ("16UC1", "mono16", "Z16")
_METRES = "32FC1"
_MILLIMETRE_UNITS = 1000.0
"""Units per metre of 16UC1 (REP 118)."""
_COLOR_NAME = re.compile("colou?r|rgb(?!d)", re.IGNORECASE)
"""Part of the name of a topic that says that its images are the colour camera's; grey ones of other
topics may be infrared images."""
_NO_COLORS = ("16UC1", "mono16", "32FC1", "8UC1")
"""Encodings of compressed pictures (image_transport) that may be depth images, hence not colour."""
_LEAST_APART_NS, _MOST_APART_NS = 20_000_000, 200_000_000
"""A colour image belongs to a depth image if their stamps differ by at most half of the colour
camera's period, because the image before or after it is nearer otherwise. Half a period of 30 Hz
is less than the 20 ms that the tools of the TUM benchmark allow for unsynchronised cameras, which
are therefore allowed at any rate. Within more than 0.2 s, people move too far."""
_WAIT_NS = 1_000_000_000
_MAX_WAITING = 200
_MAX_WAITING_BYTES = 1 << 28
"""Images of one camera wait for images of the other for at most 1 s; at most 200 images and
256 MiB wait at a time."""
_PNG_HEADER = struct.Struct("<iff")
"""Header of compressedDepth: format code, then A and B of the stored value A / z + B (z in
metres)."""

_Pair: TypeAlias = tuple[BagPicture, BagPicture | None]
"""A depth image and its colour image."""
_Numbered: TypeAlias = tuple[int, _Pair | UnreadPicture]


@dataclass(frozen=True)
class _Camera:
    """A topic of images, with the geometry of its camera as far as the bag states it."""

    topic: str
    frame_id: str
    intrinsics: Intrinsics | None
    why_not: str  # reason why intrinsics is None, else empty


class _Frames(Iterator[RgbdFrame]):
    """Iterator of decoded frames, which ends with an error of the bag, but not of an image.

    It is no generator, because a generator ends with its first error.
    """

    def __init__(
        self, decoded: Callable[[_Numbered], RgbdFrame], pairs: Iterator[_Numbered]
    ) -> None:
        self._decoded, self._pairs = decoded, pairs
        self._goes_on = True

    def __next__(self) -> RgbdFrame:
        self._goes_on = False
        numbered = next(self._pairs)
        self._goes_on = True
        return self._decoded(numbered)


class BagImages:
    """Frames of the RGB-D camera in a bag; each iteration reads the bag from its beginning.

    Depth comes from ``topic``, or from the only topic of depth images if ``topic`` is empty. Colour
    comes from a camera whose pose relative to the depth camera is known. A frame has the colour
    image whose stamp is nearest, within half a period of the colour camera or 20 ms, whichever is
    longer, and at most 0.2 s; no two frames have the same one. If there is such a camera,
    ``without_color`` counts the frames without colour.
    """

    def __init__(
        self,
        path: Path,
        topic: str,
        camera: Intrinsics | RgbdCalibration | None = None,
        units_per_metre: float | None = None,
    ) -> None:
        self._path = path
        with closing(BagRecording(path, "", mode="images")) as bag:
            found = bag.cameras()
        self._depth = _depth_topic(found, topic, path)
        self._given_units = units_per_metre
        stated = self._stated_units(found)
        self.assumed_units = None if units_per_metre or stated else _MILLIMETRE_UNITS
        """Units per metre that are assumed because neither the bag nor the caller states them."""
        self._units = units_per_metre or stated or _MILLIMETRE_UNITS
        self._length = int(found["images"][self._depth]["count"])
        self.calibration, self._color = self._geometry(found, camera)
        self._apart_ns = _most_apart_ns(found, self._color)
        self._without_color = 0

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[RgbdFrame]:
        return self.since(0)

    def since(self, index: int) -> Iterator[RgbdFrame]:
        """Iterate from a frame on; the frames before it are not decoded.

        After the error of a damaged image the iterator continues with the next frame.
        """
        self._without_color = 0
        return _Frames(self._decoded, islice(enumerate(self._pairs()), index, None))

    @property
    def _own_counters(self) -> dict[str, int]:
        """Number of frames without colour since the last iteration began, if others may have it."""
        return {"without_color": self._without_color} if self._color else {}

    def _pairs(self) -> Iterator[_Pair | UnreadPicture]:
        topics = [self._depth] + ([self._color] if self._color else [])
        unread = _UnreadDepth(self._depth)
        with closing(BagRecording(self._path, "", mode="images")) as bag:
            bag.cameras()
            pictures = unread.left_out_of(bag.messages(topics))
            pairs = _paired(pictures, self._depth, self._color, self._apart_ns)
            yield from unread.put_between(pairs)

    def _decoded(self, numbered: _Numbered) -> RgbdFrame:
        number, pair = numbered
        if isinstance(pair, UnreadPicture):
            reason = f"frame {number}: {pair.topic}: {pair.reason}"
            raise FormatError(reason, file=str(self._path))
        depth, color = pair
        try:
            frame = RgbdFrame(
                self._millimetres(depth),
                self.calibration,
                color=None if color is None else _three_channels(color),
                time_ns=depth.header["stamp_ns"],
                number=number,
            )
        except (FormatError, InputError) as error:
            reason = f"frame {number}: {getattr(error, 'reason', error)}"
            raise FormatError(reason, file=str(self._path)) from error
        self._without_color += color is None
        return frame

    def _geometry(
        self, found: Mapping[str, Any], camera: Intrinsics | RgbdCalibration | None
    ) -> tuple[RgbdCalibration, str]:
        """Return the calibration and the topic of the colour images; empty: no colour."""
        depth = _camera_of(found, self._depth)
        colors = [_camera_of(found, topic) for topic in _color_topics(found)]
        if isinstance(camera, RgbdCalibration):
            shown = camera.registration.color if camera.registration else camera.depth

            def fit(color: _Camera) -> tuple[Any, ...]:
                own = color.intrinsics
                fits = own is None or (own.width, own.height) == (shown.width, shown.height)
                return not fits, *_remoteness(depth, color)

            nearest = min(colors, key=fit, default=None)
            self._warn_of_colors([] if nearest else _unread_colors(found))
            return camera, nearest.topic if nearest else ""
        intrinsics = camera or depth.intrinsics
        if intrinsics is None:
            reason = f"{depth.why_not}; give it if it is known (--intrinsics, or camera= in Python)"
            raise FormatError(reason, file=str(self._path))
        reasons, known = [], []
        for color in colors:
            registration = _registration(found, depth, color)
            if isinstance(registration, str):
                reasons.append(registration)
            else:
                known.append((color, registration))
        if known:
            color, registration = min(known, key=lambda each: _remoteness(depth, *each))
            return RgbdCalibration(intrinsics, registration), color.topic
        self._warn_of_colors(reasons + _unread_colors(found))
        return RgbdCalibration(intrinsics), ""

    def _warn_of_colors(self, reasons: Sequence[str]) -> None:
        if reasons:
            warnings.warn(
                f"{self._path}: frames have no colour: {'; '.join(reasons)}",
                stacklevel=caller_level(),
            )

    def _millimetres(self, picture: BagPicture) -> NDArray[np.uint16]:
        """Return the depth in millimetres; 0 if it is not measured or more than 65.535 m.

        Many cameras store 65535, the largest number of 16 bits, for "no measurement".
        """
        stored = _stored_depth(picture)
        if stored.dtype == np.uint16:
            stored = np.where(stored == NO_MEASUREMENT, np.uint16(0), stored)
        units = self._units_of(picture)
        if stored.dtype == np.uint16 and units == 1000.0:
            return np.asarray(stored, np.uint16)
        units = units if stored.dtype == np.uint16 else 1.0  # float32 is in metres (REP 118)
        with np.errstate(invalid="ignore"):
            depth = np.rint(stored.astype(np.float64) * (1000.0 / units))
            is_depth = (depth > 0.0) & (depth <= 65535.0)
        return np.where(is_depth, depth, 0.0).astype(np.uint16)

    def _stated_units(self, found: Mapping[str, Any]) -> float:
        """Return how many stored units a metre has; 0 if the bag does not state it.

        32FC1 is in metres; RealSense's recorder states the depth unit of 16UC1.
        """
        image = found["images"][self._depth]
        stream = stream_of(self._depth)
        if _METRES in (image["encoding"], image["format"].partition(";")[0].strip()):
            return 1.0
        if stream is None:
            return 0.0
        stated = units_per_metre(found, stream) or per_metre(image["unit"])
        if not stated and self._given_units is None:
            warnings.warn(
                f"{self._path}: {stream} states no depth unit; 1000 units per metre are assumed; "
                f"{SET_UNIT}",
                stacklevel=caller_level(),
            )
        return stated

    def _units_of(self, picture: BagPicture) -> float:
        """Return the stored units per metre of an image, which may state its own unit."""
        if self._given_units is not None:
            return self._given_units
        return per_metre(picture.header.get("unit", 0.0)) or self._units


def depth_size(path: Path, topic: str) -> tuple[int, int]:
    """Return width and height of the first depth image in a bag; no CameraInfo is needed.

    Raises
    ------
    FormatError, InputError, MissingExtraError, OSError
        See `manip3d.capture.open_rgbd`.
    """
    with closing(BagRecording(path, "", mode="images")) as bag:
        depth = _depth_topic(bag.cameras(), topic, path)
        for each in bag.messages([depth]):
            if isinstance(each, BagPicture):
                height, width = _stored_depth(each).shape
                return width, height
    raise FormatError(f"no image of {depth}", file=str(path))


def _depth_topic(found: Mapping[str, Any], topic: str, path: Path) -> str:
    """Return ``topic`` if it has depth images; if it is empty, the only topic that has some."""
    images: Mapping[str, Mapping[str, Any]] = found["images"]
    names = [name for name, image in images.items() if _is_depth(name, image)]
    if topic:
        if topic in names:
            return topic
    else:
        # If a topic was recorded both compressed and uncompressed, the latter is read.
        names = [name for name in names if name.rpartition("/")[0] not in names]
        if len(names) == 1:
            return names[0]
    if not names:
        others = ", ".join(sorted(images)) or "no images"
        raise FormatError(f"no depth images (16UC1, 32FC1); it holds {others}", file=str(path))
    raise InputError(
        f"uri: expected rgbd-bag:{path}#TOPIC with one of the topics of depth images: "
        f"{', '.join(sorted(names))}"
    )


def _is_depth(topic: str, image: Mapping[str, Any]) -> bool:
    """Return whether a topic has depth images.

    ``mono16`` may also be an infrared image; it counts only if the topic's name contains ``depth``.
    """
    kind = image["encoding"] or image["format"].partition(";")[0].strip()
    if "compressedDepth" in image["format"]:
        return True
    return not image["format"] and (
        kind in (_METRES, "16UC1", "Z16") or (kind == "mono16" and "depth" in topic.lower())
    )


def _color_topics(found: Mapping[str, Any]) -> list[str]:
    """Return the topics of colour images, uncompressed ones first."""
    images: Mapping[str, Mapping[str, Any]] = found["images"]
    raw = [
        name
        for name, image in images.items()
        if image["encoding"] in COLOR_ENCODINGS
        or (image["encoding"] in GREY_ENCODINGS and _is_named_color(name))
    ]
    packed = [
        name
        for name, image in images.items()
        if image["format"] and "compressedDepth" not in image["format"]
        and ("mono" not in image["format"] or _is_named_color(name))
        and image["format"].partition(";")[0].strip() not in _NO_COLORS
        and name.rpartition("/")[0] not in raw
    ]  # fmt: skip
    return sorted(raw) + sorted(packed)


def _is_named_color(topic: str) -> bool:
    return _COLOR_NAME.search(topic) is not None


def _unread_colors(found: Mapping[str, Any]) -> list[str]:
    """Return why topics whose names say that they have colours are not read."""
    images: Mapping[str, Mapping[str, Any]] = found["images"]
    read = _color_topics(found)
    return [
        f"{name} has images of {image['encoding'] or image['format']!r}, which are not read"
        for name, image in sorted(images.items())
        if _is_named_color(name) and not _is_depth(name, image) and name not in read
    ]


def _camera_of(found: Mapping[str, Any], topic: str) -> _Camera:
    base, stream = without_transport(topic), stream_of(topic)
    name = base.rpartition("/")[0] + "/camera_info"
    info = found["infos"].get(name)
    if stream:
        name, info = camera_info(found, stream)
    frame_id = found["images"][topic]["frame_id"].lstrip("/")
    if info is None:
        return _Camera(topic, frame_id, None, f"no CameraInfo {name} beside {topic}")
    intrinsics = _intrinsics(info, "rect" in base.rpartition("/")[2])
    if isinstance(intrinsics, str):
        return _Camera(topic, frame_id, None, f"{name}: {intrinsics}")
    return _Camera(topic, frame_id or info["frame_id"].lstrip("/"), intrinsics, "")


def _remoteness(
    depth: _Camera, color: _Camera, registration: Registration | None = None
) -> tuple[bool, bool, int, float]:
    """Return a sort key of colour cameras: the smallest most likely belongs to the depth camera.

    A robot may have several cameras. The key prefers, in this order: topics in another namespace
    than the depth images (those in the same one may be depth drawn in colours), the same coordinate
    frame, the longest common beginning of the topic's name, and the shortest distance.
    """
    is_own = depth.topic.rpartition("/")[0] == color.topic.rpartition("/")[0]
    baseline = (
        0.0 if registration is None else float(np.linalg.norm(registration.translation, axis=-1))
    )
    both = zip(depth.topic.split("/"), color.topic.split("/"), strict=False)
    common = sum(1 for _ in takewhile(lambda names: names[0] == names[1], both))
    return is_own, depth.frame_id != color.frame_id, -common, baseline


def _intrinsics(info: Mapping[str, Any], is_rectified: bool) -> Intrinsics | str:
    """Return the intrinsics of a CameraInfo, or the reason why it has none.

    Rectified images have the left (3, 3) part of ``P`` and no distortion, others ``K`` and ``D``.
    """
    k = info["k"]
    distortion = list(info["d"])
    if is_rectified and len(info["p"]) == 12 and info["p"][0] > 0.0:
        p = info["p"]
        k, distortion = [*p[:3], *p[4:7], *p[8:11]], []
    if len(k) != 9 or not k[0] > 0.0:
        return "the camera is not calibrated"
    if any(distortion) and not is_brown(info["model"]):
        return f"distortion of the model {info['model']!r} is not known"
    if any(distortion[5:]):
        return f"distortion of more than k1, k2, p1, p2 and k3 (of the model {info['model']!r})"
    five = (*distortion[:5], 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    try:
        return Intrinsics(info["width"], info["height"], k[0], k[4], k[2], k[5], five)
    except InputError as error:
        return str(error)


def _registration(
    found: Mapping[str, Any], depth: _Camera, color: _Camera
) -> Registration | str | None:
    """Return the colour camera's registration to the depth camera, or why it is not known.

    None: both have the same pose and the same intrinsics.
    """
    if color.intrinsics is None:
        return color.why_not
    pose = relative_pose(found, color.topic, depth.topic)
    if pose is None and depth.frame_id == color.frame_id:
        pose = np.eye(4)
    if pose is None:
        pose = pose_of(found["transforms"], color.frame_id, depth.frame_id)
    if pose is None:
        return f"/tf_static does not lead from {color.frame_id!r} to {depth.frame_id!r}"
    is_same = depth.intrinsics is not None and astuple(depth.intrinsics) == astuple(
        color.intrinsics
    )
    if is_same and np.array_equal(pose, np.eye(4)):
        return None
    return Registration(color.intrinsics, pose[:3, :3], pose[:3, 3])


def _most_apart_ns(found: Mapping[str, Any], color: str) -> int:
    """Return the largest difference of the stamps of a depth image and its colour image."""
    period = found["images"][color]["period_ns"] if color else 0
    if not period:  # there is one colour image, and no other that could be nearer
        return _MOST_APART_NS
    return min(max(period // 2, _LEAST_APART_NS), _MOST_APART_NS)


class _UnreadDepth:
    """Depth images that cannot be decoded: frames without an image, so that no loss is silent.

    Attributes
    ----------
    unread : deque of (int, UnreadPicture)
        The images that have arrived, with their numbers among all depth images of the recording.
    """

    def __init__(self, depth: str) -> None:
        self._depth = depth
        self.unread: deque[tuple[int, UnreadPicture]] = deque()

    def left_out_of(self, messages: Iterator[BagMessage]) -> Iterator[BagPicture]:
        """Yield the other pictures, and note the unread depth images."""
        number = 0
        for each in messages:
            if isinstance(each, UnreadPicture) and each.topic == self._depth:
                self.unread.append((number, each))
                number += 1
            elif isinstance(each, BagPicture):
                number += each.header["picture"] == self._depth
                yield each

    def put_between(self, pairs: Iterator[_Pair]) -> Iterator[_Pair | UnreadPicture]:
        """Yield the pairs of the other depth images, and each noted image at its number."""
        number = 0
        for pair in pairs:
            while self.unread and self.unread[0][0] == number:
                yield self.unread.popleft()[1]
                number += 1
            yield pair
            number += 1
        for _, each in self.unread:
            yield each


def _paired(
    pictures: Iterator[BagPicture], depth: str, color: str, apart_ns: int
) -> Iterator[_Pair]:
    """Yield each depth image with the colour image of the nearest stamp, which no other one gets.

    A depth image waits until a colour image of the same time or later and the next depth image have
    arrived: a colour image that is nearer to the next one belongs to that one.
    """
    waiting: deque[BagPicture] = deque()
    colors: deque[BagPicture] = deque()

    def matched() -> _Pair:
        image = waiting.popleft()
        now = _stamp(image)
        following = _stamp(waiting[0]) if waiting else now
        own = [
            each
            for each in colors
            if abs(_stamp(each) - now) <= apart_ns
            and not (following > now and abs(_stamp(each) - following) < abs(_stamp(each) - now))
        ]
        if not own:
            return image, None
        nearest = min(own, key=lambda each: abs(_stamp(each) - now))
        while colors.popleft() is not nearest:  # earlier ones are farther from later images
            pass
        return image, nearest

    for picture in pictures:
        (waiting if picture.header["picture"] == depth else colors).append(picture)
        while waiting and (
            not color
            or _is_too_much(waiting)
            or _is_too_much(colors)
            or (len(waiting) > 1 and colors and _stamp(colors[-1]) >= _stamp(waiting[0]))
        ):
            yield matched()
            _shorten(colors)
        _shorten(colors)
    while waiting:
        yield matched()


def _stamp(picture: BagPicture) -> int:
    return int(picture.header["stamp_ns"])


def _shorten(pictures: deque[BagPicture]) -> None:
    while _is_too_much(pictures):
        pictures.popleft()


def _is_too_much(pictures: deque[BagPicture]) -> bool:
    """Return whether the first picture has waited too long, or the queue is too long or large."""
    if len(pictures) < 2:
        return False
    waited = pictures[-1].header["stamp_ns"] - pictures[0].header["stamp_ns"]
    size = sum(len(picture.data) for picture in pictures)
    return waited > _WAIT_NS or len(pictures) > _MAX_WAITING or size > _MAX_WAITING_BYTES


def _stored_depth(picture: BagPicture) -> NDArray[np.uint16] | NDArray[np.float32]:
    header = picture.header
    if "format" in header:
        return _unpacked_depth(picture)
    is_whole = header["encoding"] in _MILLIMETRES
    if not is_whole and header["encoding"] != _METRES:
        raise FormatError(
            f"{header['picture']}: expected 16UC1, mono16 or 32FC1, got {header['encoding']!r}"
        )
    kind = np.dtype("u2" if is_whole else "f4")
    rows = np.ascontiguousarray(rows_of(picture, kind.itemsize))
    as_stored = kind.newbyteorder(">" if header["is_bigendian"] else "<")
    return np.asarray(rows.view(as_stored), kind)


def _unpacked_depth(picture: BagPicture) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Decode depth of the transport compressedDepth: a header of 12 bytes, and a PNG of 16 bits.

    For 32FC1 the PNG stores A / z + B, with z in metres; A and B are in the header.
    """
    header, data = picture.header, picture.data
    if "rvl" in header["format"].lower() or not data[12:].startswith(b"\x89PNG"):
        raise FormatError(
            f"{header['picture']}: expected a PNG in compressedDepth, got {header['format']!r}"
        )
    _, a, b = _PNG_HEADER.unpack_from(data)
    try:
        stored = decode_depth(data[12:], MAX_PIXELS)
    except FormatError as error:
        raise FormatError(f"{header['picture']}: {error.reason}") from error
    if not header["format"].startswith(_METRES):
        return stored
    with np.errstate(divide="ignore", invalid="ignore"):
        metres = np.float32(a) / (stored - np.float32(b))
    return np.where(stored > 0, metres, np.float32(0.0))


def _three_channels(picture: BagPicture) -> NDArray[np.uint8]:
    pixels = decoded(picture)
    return np.repeat(pixels[..., None], 3, axis=2) if pixels.ndim == 2 else pixels
