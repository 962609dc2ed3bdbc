"""LiDAR recordings for `manip3d.authenticate.watch_drive`, with stereo pictures of ROS bags."""

from __future__ import annotations

import itertools
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.extras import why_blind
from manip3d._util.linear import determinant, product
from manip3d._util.paths import path_of
from manip3d._util.times import SECOND_NS
from manip3d.authenticate import TURN_S, DriveMoment, StereoRig, WatchedDrive, read_rigs
from manip3d.capture._bag import (
    BagMessage,
    BagPicture,
    BagRecording,
    UnreadCloud,
    UnreadPicture,
    place_and_topic,
)
from manip3d.capture._bag_pictures import decoded, pose_of
from manip3d.capture._lidar import LidarSource, expect_scans, open_unlabelled
from manip3d.errors import BrokenExtraError, Error, FormatError, InputError, MissingExtraError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

_Item = TypeVar("_Item")

_SAME_NS = 1_000_000
"""Left and right pictures form a pair if their stamps differ by at most a millisecond."""
_MAX_WAITING = 10
"""Largest number of scans that wait for pictures recorded after them."""
_MAX_KEPT = 1 << 29
"""Largest number of bytes of pictures that wait for the other camera, or for their scan."""
_MAX_WAITING_PICTURES = 1 << 10
"""Largest number of pictures, or of pairs, that wait."""
_MAX_ASKEW = 0.01
"""Largest vertical offset between the two cameras, as a share of the baseline; KITTI's have
0.005."""


@checked
def watched_recording(
    uri: str,
    *,
    calibration: str | os.PathLike[str] | None = None,
    rigs: str | os.PathLike[str] | None = None,
    cameras: str | None = None,
    frames: int | None = None,
    note: Callable[[str], object] | None = None,
) -> WatchedDrive:
    """Open a recording of a LiDAR for `manip3d.authenticate.watch_drive`.

    The bag of a car may hold rectified pictures of a stereo pair (sensor_msgs/Image or
    CompressedImage). Their geometry comes from the CameraInfo beside each picture's topic (``P``
    and ``R``), the left camera's pose from ``/tf_static``. The two pictures of a pair have the same
    stamp to within a millisecond. A scan is compared with the pair whose stamp is nearest, if the
    difference is at most half the time to the previous or following scan, whichever is nearer.

    Parameters
    ----------
    uri : str
        Address of the recording, see `open_lidar`.
    calibration : path, optional
        See `open_lidar`.
    rigs : path, optional
        File with the geometry of the pair in a bag, as `manip3d.authenticate.write_rigs` writes it;
        its camera numbers are not used.
    cameras : str, optional
        ``LEFT,RIGHT``: topics of the pictures in a bag; ``none``: no pictures. Default: the only
        pair of topics whose names differ in ``left`` and ``right`` and whose geometry is known.
    frames : int, optional
        Largest number of scans to read; default: all.
    note : callable, optional
        Called with a sentence that states which pictures are compared, or why none are.

    Returns
    -------
    manip3d.authenticate.WatchedDrive
        The scans, each with its pair of pictures if there is one. If a picture cannot be decoded,
        its moment states the reason in ``unread``, or in ``blind`` if a package is missing. If the
        message of a picture is damaged, the scans without a pair that it may belong to state the
        reason, and a `FormatError` follows after the last scan.

    Raises
    ------
    InputError
        The bag lacks the topics or their geometry; it has several pairs and ``cameras`` selects
        none; ``rigs`` or ``cameras`` is given without a bag; ``rigs`` holds several pairs.
    FormatError, OSError
        See `open_lidar` and `manip3d.authenticate.read_rigs`.

    Examples
    --------
    >>> from manip3d import capture
    >>> capture.watched_recording("pcap:turns.pcap", cameras="/left,/right")
    Traceback (most recent call last):
        ...
    manip3d.errors.InputError: cameras: can only be given with a ROS bag, got pcap:turns.pcap
    """
    if frames is not None and frames < 1:
        raise InputError(f"frames: expected at least 1, got {frames}")
    if cameras == "none" and rigs is not None:
        raise InputError("rigs: can only be given with cameras, got cameras='none'")
    if not uri.startswith("bag:"):
        for name, value in (("rigs", rigs), ("cameras", cameras)):
            if value is not None:
                raise InputError(f"{name}: can only be given with a ROS bag, got {uri}")
    if not uri.startswith("bag:") or cameras == "none":
        scans = _scans(open_unlabelled(uri, calibration=calibration), uri)
        return WatchedDrive(None, itertools.islice(scans, frames), frames or 0)
    if calibration is not None:
        raise InputError("calibration: expected none for bag:")
    place, topic = place_and_topic(uri)
    bag = BagRecording(path_of(place, "uri"), topic, mode="pictures")
    try:
        known = None if rigs is None else _only_rig(rigs)
        pair, rig, why = _chosen(bag.cameras(), known, cameras)
    except BaseException:
        bag.close()
        raise
    if note is not None and why:
        note(why)
    moments = expect_scans(matched(bag.messages(pair), pair), uri, bag.counters)
    told = _with_unread(itertools.islice(moments, frames), bag, place)
    return WatchedDrive(rig, told, frames or 0)


def _with_unread(
    moments: Iterable[DriveMoment], bag: BagRecording, place: str
) -> Iterator[DriveMoment]:
    """Yield the moments, and raise `FormatError` after the last if pictures were damaged."""
    yield from moments
    if (first := bag.first_unread_picture) is not None:
        told = f"the first of {first.topic}: {first.reason}"
        raise FormatError(f"damaged pictures: {bag.num_unread_pictures}, {told}", file=place)


def _scans(recording: LidarSource, uri: str) -> Iterator[DriveMoment]:
    with recording:
        yield from expect_scans(_moments(recording), uri, lambda: recording.counters)


def _moments(recording: LidarSource) -> Iterator[DriveMoment]:
    """Yield the scans; a frame that cannot be read is a moment of its own if others follow."""
    while True:
        try:
            scan = recording.read()
        except FormatError as error:
            if not recording.goes_on:
                raise
            yield DriveMoment(f"unreadable: {error}")
        else:
            if scan is None:
                return
            yield _moment(scan)


def _only_rig(path: str | os.PathLike[str]) -> StereoRig:
    rigs = read_rigs(path)
    if len(rigs) != 1:
        raise InputError(f"rigs: expected one pair for a ROS bag, got {', '.join(sorted(rigs))}")
    return next(iter(rigs.values())).rig


def _chosen(
    found: Mapping[str, Any], known: StereoRig | None, cameras: str | None
) -> tuple[tuple[str, ...], StereoRig | None, str]:
    """Return the topics of the pair, its geometry, and a sentence for the caller's ``note``.

    Without a pair, the sentence states why; it is empty if there is nothing to report.
    """
    topics: list[str] = found["pictures"]
    if cameras is not None:
        left, comma, right = cameras.partition(",")
        if not comma or not {left, right} <= set(topics) or left == right:
            raise InputError(
                f"cameras: expected none or LEFT,RIGHT of {', '.join(topics) or 'no topics'}, "
                f"got {cameras!r}"
            )
        rig = known or _rig_of(found, left, right)
        if isinstance(rig, str):
            raise InputError(f"cameras: {rig}")
        return (left, right), rig, ""
    pairs = [(name, name.replace("left", "right")) for name in topics if "left" in name]
    pairs = [pair for pair in pairs if pair[1] in topics]
    rigs = {pair: known or _rig_of(found, *pair) for pair in pairs}
    usable = [(pair, rig) for pair, rig in rigs.items() if isinstance(rig, StereoRig)]
    if len(usable) > 1:
        names = "; ".join(",".join(pair) for pair, _ in usable)
        raise InputError(f"cameras: expected none or one of {names}")
    if usable:
        ((left, right), rig) = usable[0]
        return (left, right), rig, f"the LiDAR is compared with {left} and {right}"
    reasons = "; ".join(str(reason) for reason in rigs.values())
    return (), None, f"no pictures are compared: {reasons}" if reasons else ""


def _rig_of(found: Mapping[str, Any], left: str, right: str) -> StereoRig | str:
    """Return the geometry of a pair from CameraInfo and fixed transforms, or why it is unknown.

    ``P`` of sensor_msgs/CameraInfo is the projection matrix of the rectified picture; the first
    element of its fourth column is -focal * baseline for the right camera. ``R`` rotates the
    camera's coordinates into those of the rectified camera.
    """
    infos = []
    for topic in (left, right):
        name = topic.removesuffix("/compressed").rpartition("/")[0] + "/camera_info"
        info = found["infos"].get(name)
        if info is None:
            return f"no CameraInfo {name} beside {topic}"
        matrices = _matrices(info, name)
        if isinstance(matrices, str):
            return matrices
        is_raw = "rect" not in topic.removesuffix("/compressed").rpartition("/")[2]
        if is_raw and (any(info["d"]) or not np.allclose(matrices[1], np.eye(3))):
            return f"the pictures of {topic} are not rectified (image_proc makes image_rect)"
        infos.append((*matrices, info["frame_id"]))
    (p, rotation, frame), (other, _, _) = infos
    shift = p[:, 3] - other[:, 3]
    if not np.allclose(p[:, :3], other[:, :3]) or abs(shift[1]) > _MAX_ASKEW * abs(shift[0]):
        return f"{left} and {right} are not a rectified pair: their P differ"
    lidar = found["lidar"]
    pose = pose_of(found["transforms"], lidar, frame)
    if pose is None:
        return f"/tf_static does not lead from {lidar!r} to {frame!r}"
    pose[:3, :3] = product(pose[:3, :3], rotation.T)
    try:
        baseline = float(shift[0] / p[0, 0])
        return StereoRig(float(p[0, 0]), (float(p[0, 2]), float(p[1, 2])), baseline, pose)
    except InputError as error:
        return f"{left} and {right}: {error}"


def _matrices(
    info: Mapping[str, Any], name: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | str:
    """Return P (3, 4) and R (3, 3) of a CameraInfo, or why they fit no rectified camera."""
    numbers = [*info["p"], *info["r"]]
    if len(info["p"]) != 12 or len(info["r"]) != 9 or not np.isfinite(numbers).all():
        return f"{name}: expected finite matrices P (3, 4) and R (3, 3)"
    p = np.array(info["p"], np.float64).reshape(3, 4)
    if not p[0, 0] > 0.0:
        return f"{name}: the camera is not calibrated"
    if not np.isclose(p[0, 0], p[1, 1], rtol=1e-3):
        return f"{name}: expected one focal length, got {p[0, 0]:g} and {p[1, 1]:g}"
    turn = np.array(info["r"], np.float64).reshape(3, 3)
    if not turn.any():
        return p, np.eye(3)  # in ROS all zeros mean that R is not given
    if not np.allclose(product(turn, turn.T), np.eye(3), atol=1e-4) or determinant(turn) < 0.0:
        return f"{name}: expected a rotation R"
    return p, turn


class _Pair(NamedTuple):
    left: BagPicture
    right: BagPicture


class _Waiting(Generic[_Item]):
    """Queue of pictures or pairs with their stamps; the first are dropped if it grows too long."""

    def __init__(self) -> None:
        self.items: deque[tuple[int, int, _Item]] = deque()
        self._bytes = 0

    def add(self, stamp_ns: int, size: int, item: _Item) -> None:
        self.items.append((stamp_ns, size, item))
        self._bytes += size
        while self._bytes > _MAX_KEPT or len(self.items) > _MAX_WAITING_PICTURES:
            self._bytes -= self.items.popleft()[1]

    def take(self, stamp_ns: int) -> _Item | None:
        """Remove and return the item with this stamp, to within a millisecond, or None."""
        for number, (stamp, size, item) in enumerate(self.items):
            if abs(stamp - stamp_ns) <= _SAME_NS:
                del self.items[number]
                self._bytes -= size
                return item
        return None

    def forget_until(self, stamp_ns: int) -> None:
        self.items = deque(item for item in self.items if item[0] > stamp_ns)
        self._bytes = sum(size for _, size, _ in self.items)


class _Gap(NamedTuple):
    """Pictures of one camera that cannot be read, before its next one that can.

    Their own stamps are unknown.
    """

    side: int
    reason: str
    end_ns: float
    """Stamp of the next picture that can be read; infinite as long as there is none."""


class _Pairs:
    """Pictures of two cameras, joined to pairs; pictures too old for any later scan are dropped."""

    def __init__(self, topics: tuple[str, ...]) -> None:
        self._topics = topics
        self._single = (_Waiting[BagPicture](), _Waiting[BagPicture]())
        self._joined = _Waiting[_Pair]()
        self._gaps: deque[_Gap] = deque(maxlen=_MAX_WAITING_PICTURES)

    def add(self, picture: BagPicture) -> None:
        """Join a picture with the other camera's of the same stamp, or keep it until that comes."""
        side = self._topics.index(picture.header["picture"])
        stamp = picture.header["stamp_ns"]
        for number, gap in enumerate(self._gaps):
            if gap.side == side and gap.end_ns == np.inf:
                self._gaps[number] = gap._replace(end_ns=stamp)
        other = self._single[1 - side].take(stamp)
        if other is None:
            self._single[side].add(stamp, len(picture.data), picture)
            return
        pair = _Pair(picture, other) if side == 0 else _Pair(other, picture)
        size = len(picture.data) + len(other.data)
        self._joined.add(pair.left.header["stamp_ns"], size, pair)

    def add_unread(self, picture: UnreadPicture) -> None:
        """Keep the reason; a picture that follows another unread one of its camera adds none."""
        side = self._topics.index(picture.topic)
        if not any(gap.side == side and gap.end_ns == np.inf for gap in self._gaps):
            self._gaps.append(_Gap(side, f"{picture.topic}: {picture.reason}", np.inf))

    def why_none(self, scan: LidarFrame) -> str:
        """Return why pictures that may belong to a scan without a pair cannot be read, or ''."""
        while self._gaps and self._gaps[0].end_ns < (scan.time_ns or 0):
            self._gaps.popleft()
        found = (gap for gap in self._gaps if gap.end_ns >= (scan.time_ns or 0))
        return "; ".join({gap.side: gap.reason for gap in found}.values())

    def is_past(self, scan: LidarFrame | UnreadCloud) -> bool:
        """Return whether a pair that is not older than the scan has arrived."""
        return any(stamp >= (scan.time_ns or 0) for stamp, _, _ in self._joined.items)

    def take_nearest(self, scan: LidarFrame, before: int | None, after: int | None) -> _Pair | None:
        """Return the pair of the nearest stamp, and drop pictures too old for any later scan.

        None if it differs by more than half the time to the nearer of the scans before and after
        (half a turn of the scanner if their times are not known).
        """
        now = scan.time_ns or 0
        gaps = [abs(other - now) for other in (before, after) if other not in (None, now)]
        farthest = min(gaps, default=round(TURN_S * SECOND_NS)) / 2
        near = min(self._joined.items, key=lambda item: abs(item[0] - now), default=None)
        self._joined.forget_until(now)
        for kept in self._single:
            kept.forget_until(now - _SAME_NS)
        return near[2] if near is not None and abs(near[0] - now) <= farthest else None


def matched(messages: Iterable[BagMessage], topics: tuple[str, ...]) -> Iterator[DriveMoment]:
    """Yield each scan with the pair of the nearest stamp, see `_Pairs.take_nearest`.

    A scan waits for the following scan and for a pair that is not older than itself, but for at
    most `_MAX_WAITING` further scans; without ``topics`` it does not wait. A cloud that cannot be
    read is a moment with the reason; a scan without a pair states why pictures that may belong to
    it cannot be read. If ``messages`` raises, the scans before the error are yielded first.
    """
    scans: deque[LidarFrame | UnreadCloud] = deque()
    pairs = _Pairs(topics)
    before: int | None = None
    for message in _with_end(messages):
        if isinstance(message, BagPicture):
            pairs.add(message)
        elif isinstance(message, UnreadPicture):
            pairs.add_unread(message)
        elif isinstance(message, LidarFrame | UnreadCloud):
            scans.append(message)
        while scans and (
            message is None
            or isinstance(message, Exception)
            or not topics
            or len(scans) > _MAX_WAITING
            or (len(scans) > 1 and pairs.is_past(scans[0]))
            or isinstance(scans[0], UnreadCloud)
        ):
            scan = scans.popleft()
            if isinstance(scan, UnreadCloud):
                yield DriveMoment(f"unreadable: {scan.reason}", time_s=_seconds(scan))
                continue
            after = scans[0].time_ns if scans else None
            pair = pairs.take_nearest(scan, before, after)
            yield _moment(scan, pair, "" if pair else pairs.why_none(scan))
            before = scan.time_ns
        if isinstance(message, Exception):
            raise message


def _with_end(
    messages: Iterable[BagMessage],
) -> Iterator[BagMessage | Exception | None]:
    """Yield the messages, and then None or the error that ended them."""
    try:
        yield from messages
    except (Error, OSError) as error:
        yield error
    else:
        yield None


def _seconds(scan: LidarFrame | UnreadCloud) -> float | None:
    return None if scan.time_ns is None else scan.time_ns / SECOND_NS


def _moment(scan: LidarFrame, pair: _Pair | None = None, why_none: str = "") -> DriveMoment:
    """Return a scan with its decoded pictures, or with the reason why they cannot be read."""
    time_s, pictures, blind = _seconds(scan), None, ""
    if pair is not None:
        try:
            pictures = (decoded(pair.left), decoded(pair.right))
        except FormatError as error:
            why_none = str(error)
        except (MissingExtraError, BrokenExtraError) as error:
            blind = why_blind(error)
    unread = {"cross-modal": f"unreadable: {why_none}"} if why_none else {}
    return DriveMoment(scan, pictures, time_s=time_s, unread=unread, blind=blind)
