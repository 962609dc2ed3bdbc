"""Open RGB-D cameras and recordings by their addresses."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from types import SimpleNamespace
from typing import Any

from manip3d import _core
from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.camera import Intrinsics
from manip3d.capture._bag import place_and_topic
from manip3d.capture._bag_rgbd import BagImages
from manip3d.capture._forged import MOST_KEPT, SwitchedForgery, motion_of, read_plan
from manip3d.capture._rgbd_source import ForgedSource, RgbdSource, source_of
from manip3d.errors import InputError
from manip3d.rgbd import RgbdCalibration, RgbdFrame

_PEOPLE = ("utd-mhad", "labanotation", "people")
RECORDINGS = ("folder", "mkv", "tum")  # files that can be read again, and written


@dataclass(frozen=True)
class Scheme:
    """A kind of source, as `sources` lists it.

    Attributes
    ----------
    name : str
        What stands before the colon of a URI.
    location : str
        What stands after it; in brackets if it may be left out.
    description : str
    frames : str
        ``rgbd`` or ``lidar``: what it gives.
    reason, cure : str
        Why it cannot be opened here and now, and what to do about it; empty if it can.
    """

    name: str
    location: str
    description: str
    frames: str
    reason: str = ""
    cure: str = ""

    @property
    def is_available(self) -> bool:
        """Whether it can be opened here and now."""
        return not self.reason


def core_schemes() -> list[Scheme]:
    """The kinds of RGB-D sources that the core knows; looks for devices."""
    names = ("name", "location", "description", "reason", "cure")
    return [
        Scheme(frames="rgbd", **{name: fields[name] for name in names})
        for fields in _core.rgbd_schemes()
    ]


@checked
def open_rgbd(
    uri: str,
    *,
    speed: float = 0.0,
    camera: Intrinsics | RgbdCalibration | None = None,
    units_per_metre: float | None = None,
    start: int = 0,
) -> RgbdSource:
    """Open an RGB-D camera, a recording, a folder of images or a simulated person.

    Parameters
    ----------
    uri : str
        ``folder:FOLDER``, ``mkv:FILE``, ``tum:FOLDER``, ``openni2:``, ...: `sources` lists them.
        ``sim:body...`` is `manip3d.simulate.sources.open_source`; ``utd-mhad:``, ``labanotation:``
        and ``people:`` are `manip3d.datasets.open_people`. ``rgbd-bag:PATH[#TOPIC]`` are the
        images of an RGB-D camera in a ROS bag, RealSense's recordings among them.
        ``forged:SOURCE#OPTIONS`` is a `ForgedSource` of any of these. `Notes` describes the options
        of both.
    speed : float
        Playback speed of recordings. 0: every frame, as fast as read. 1: real time, by the frames'
        times; frames that a slow reader misses are counted as ``dropped``. 2: twice as fast.
        Simulated people and data sets are played in the same way.
    camera : Intrinsics or RgbdCalibration, optional
        Camera of a folder of images that has no ``calibration.json``; for other files it replaces
        their own. A mirrored camera has its images flipped. That of a ``tum:`` sequence
        without a ``calibration.json`` follows from its folder's name (``freiburg1`` to ``3``); of
        others, one is taken that is nearly right, with a warning.
    units_per_metre : float, optional
        Stored units per metre of depth images. By default 1000 for folders and 5000 for ``tum:``;
        of a bag what its images say: 1000 for whole numbers, unless a RealSense says another unit;
        fractions are metres.
    start : int
        Index of the first frame that is read, of recordings, simulated people and data sets; the
        source begins there again each time. ``source[0]`` is the first frame of all even so.

    Returns
    -------
    RgbdSource
        An iterator of frames; use it in a ``with`` statement to close the camera at the end.

    Raises
    ------
    InputError
        An unknown scheme, an option out of range, a folder without a camera.
    FormatError
        The recording is damaged.
    DeviceError
        The scheme is not built in, or there is no such device.
    MissingExtraError
        rosbags is not installed (``rgbd-bag:``): ``pip install 'manip3d[bags]'``.
    OSError
        `FileNotFoundError` and the like.

    Notes
    -----
    Options of ``forged:`` are joined by ``&``; write ``%26`` for one in a value. ``type``: 1, or 2
    for the poses of ``pose`` (a source with skeletons, or a .bvh file). ``background``: a source of
    the same camera, of which ``still=yes`` takes the first frame only; without it the scene behind
    the person, learnt from the first 30 frames, which stay real. ``move`` (X,Y,Z in metres) and
    ``blend`` as of `forge.stream`. ``show``: ``real``, ``forged``, or a number of seconds after
    which they alternate, first real. ``switch``: a file that says ``real`` or ``forged``, looked at
    before each frame. At most 300 frames of a background or motion are kept, and played to and fro.
    Colour is left out of all frames where the background has none.

    Of a bag ``TOPIC`` is one of depth images (sensor_msgs/Image of 16UC1, mono16 or 32FC1, or
    compressedDepth), needed where there are several. Cameras are those of the CameraInfo beside
    each topic; the colours' place comes from ``/tf_static``, or as RealSense's recorder states it.
    Where it is not known frames have no colour, with a warning. Depths beyond 65.535 m are missing.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, capture
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> frames = [RgbdFrame(depth, camera, time_ns=n * 33_000_000, number=n) for n in range(3)]
    >>> _ = capture.record(frames, "recording")
    >>> with capture.open_rgbd("folder:recording") as source:
    ...     print([frame.number for frame in source])
    [0, 1, 2]
    """
    scheme = uri.partition(":")[0]
    if start < 0:
        raise InputError(f"start: expected >= 0, got {start}")
    makes_frames = scheme in ("forged", "sim", *_PEOPLE)
    if makes_frames and (camera is not None or units_per_metre is not None):
        raise InputError(f"camera, units_per_metre: expected none of them for {scheme}:")
    if scheme == "forged":
        if start:
            raise InputError(
                "start: expected 0 for forged:, as its frames depend on earlier frames"
            )
        return _open_forged(uri, speed)
    if units_per_metre is not None and not units_per_metre > 0:
        raise InputError(f"units_per_metre: expected > 0, got {units_per_metre}")
    if units_per_metre is not None and scheme not in ("folder", "tum", "rgbd-bag"):
        raise InputError(
            f"units_per_metre: can only be given with a folder of images or a bag, got {uri}"
        )
    if makes_frames or scheme == "rgbd-bag":
        if not 0.0 <= speed < math.inf:
            raise InputError(f"speed: expected a finite number >= 0, got {speed}")
        if makes_frames:
            frames = _frames_of(uri, scheme)
        else:
            place, topic = place_and_topic(uri)
            frames = BagImages(path_of(place, "uri"), topic, camera, units_per_metre)
        return _checked_start(source_of(frames, uri, speed, start), start)
    return _checked_start(_open_in_core(uri, camera, units_per_metre, speed, start), start)


def _open_in_core(
    uri: str,
    camera: RgbdCalibration | Intrinsics | None,
    units_per_metre: float | None,
    speed: float,
    start: int,
) -> RgbdSource:
    """Open a camera, a folder of images or a Matroska file, which C++ reads."""
    scheme = uri.partition(":")[0]
    # Not a RgbdCalibration, which takes no mirrored camera: the core turns the images round.
    given: Any = SimpleNamespace(depth=camera, registration=None)
    calibration = given if isinstance(camera, Intrinsics) else camera

    def opened(speed: float = 0.0) -> Any:
        return _core.open_rgbd(os.fsencode(uri), speed, units_per_metre or 0.0, calibration)

    def begun() -> Any:
        source = opened(speed)
        if start:
            source.seek(start)
        return source

    first = begun()
    again = scheme in RECORDINGS or not first.is_live()
    source = RgbdSource(uri, first, begun if again else None, opened if again else None)
    if source.counters.get("nominal_camera"):
        warnings.warn(
            "camera: expected a calibration.json, or freiburg1, freiburg2 or freiburg3 in the name "
            f"of a TUM sequence, got {uri}: the pixels of the camera that is taken (fx = fy = 525, "
            "cx = 319.5, cy = 239.5) are up to 3 % off",
            stacklevel=caller_level(),
        )
    return source


def _checked_start(source: RgbdSource, start: int) -> RgbdSource:
    length = source.num_frames
    if start and length is not None and start >= length:
        source.stop()
        raise InputError(f"start: expected less than the {length} frames of {source.uri}: {start}")
    return source


def _open_forged(uri: str, speed: float) -> ForgedSource:
    if not 0.0 <= speed < math.inf:
        raise InputError(f"speed: expected >= 0, got {speed}")
    plan = read_plan(uri)
    if plan.source.startswith("forged:"):
        raise InputError("uri: expected a source that is not forged itself")

    def kept(place: str) -> list[RgbdFrame]:
        with open_rgbd(place) as source:
            frames = list(islice(source, MOST_KEPT))
        if not frames:
            raise InputError(f"{place}: expected a frame, found none")
        return frames

    pose = (motion_of(plan.pose) or kept(plan.pose)) if plan.pose else None
    background = kept(plan.background) if plan.background else []
    inner = open_rgbd(plan.source, speed=speed)
    try:
        switched = SwitchedForgery(plan, inner, background, pose)
    except BaseException:
        inner.stop()
        raise
    return ForgedSource(uri, switched)


def _frames_of(uri: str, scheme: str) -> Iterable[RgbdFrame]:
    if scheme == "sim":
        from manip3d.simulate.sources import open_source

        if not uri.startswith("sim:body"):
            raise InputError(f"uri: expected sim:body... of simulated people, got {uri!r}")

        frames: Iterable[Any] = open_source(uri)
        return frames
    from manip3d.datasets import open_people

    return open_people(uri)
