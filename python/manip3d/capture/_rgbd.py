"""Opening of RGB-D cameras and recordings by their addresses."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from manip3d import _core
from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.camera import Intrinsics
from manip3d.capture._addresses import rgbd_address
from manip3d.capture._bag import place_and_topic
from manip3d.capture._bag_rgbd import BagImages
from manip3d.capture._folder_camera import camera_of_folder
from manip3d.capture._folder_warnings import SET_UNIT, pictures_left_out
from manip3d.capture._forged import SwitchedForgery, motion_of, read_plan
from manip3d.capture._joined_joints import JoinedJoints, source_and_file
from manip3d.capture._rgbd_source import ForgedSource, RgbdSource, source_of
from manip3d.errors import InputError
from manip3d.forge import MAX_KEPT
from manip3d.rgbd import RgbdCalibration, RgbdFrame

_PEOPLE = ("utd-mhad", "labanotation", "people")
RECORDINGS = ("folder", "mkv", "tum")  # schemes of files that can be read again and written


@dataclass(frozen=True)
class Scheme:
    """A kind of source that `sources` lists.

    Attributes
    ----------
    name : str
        The part of a URI before the colon.
    location : str
        The part of a URI after the colon, with optional parts in brackets.
    description : str
        The sources of this kind, in words.
    frames : str
        Kind of the frames, ``rgbd`` or ``lidar``.
    reason, cure : str
        Reason why such sources cannot be opened on this computer, and how to change that; empty if
        they can be opened.
    """

    name: str
    location: str
    description: str
    frames: str
    reason: str = ""
    cure: str = ""

    @property
    def is_available(self) -> bool:
        """Whether such sources can be opened on this computer."""
        return not self.reason


def core_schemes() -> list[Scheme]:
    """Return the kinds of RGB-D sources in ``_core``; this looks for connected devices."""
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
    rate: float | None = None,
    start: int = 0,
) -> RgbdSource:
    """Open an RGB-D camera, a recording, a folder of images or a simulated person.

    Parameters
    ----------
    uri : str
        ``folder:FOLDER``, ``mkv:FILE``, ``tum:FOLDER``, ``openni2:``, ...: `sources` lists them.
        ``sim:body...`` is opened by `manip3d.simulate.sources.open_source`; ``utd-mhad:``,
        ``labanotation:`` and ``people:`` by `manip3d.datasets.open_people`.
        ``rgbd-bag:PATH[#TOPIC]`` reads the images of an RGB-D camera in a ROS bag, for example in
        RealSense's recordings. ``joints:SOURCE#FILE`` is a recording with the joints of a file.
        ``forged:SOURCE#OPTIONS`` is a `ForgedSource` of any of these. `Notes` describes the last
        three.
    speed : float
        Playback speed of recordings, simulated people and data sets. 0: every frame, as fast as
        read. 1: real time, by the frames' times; frames that a slow reader misses are counted as
        ``dropped``. 2: twice as fast.
    camera : Intrinsics or RgbdCalibration, optional
        Camera of a folder of images that has no ``calibration.json``; for other files it replaces
        the camera that they state. With a mirrored camera the images are flipped. A
        registration is ignored for cameras whose SDK registers colour to depth. Default for a
        folder without ``calibration.json``: the camera in ``intrinsic/intrinsic_depth.txt``
        (ScanNet) or ``camera_intrinsic.json`` (Open3D), if there is one. Default for such a
        ``tum:`` sequence: the camera that its folder's name states (``freiburg1`` to ``3``), or
        else an approximate one, with a warning.
    units_per_metre : float, optional
        Stored units per metre of depth images. Default: 1000 for folders, 5000 for ``tum:``. In a
        bag, images of floating-point numbers are in metres; those of integers have 1000 units per
        metre, unless a RealSense's recording states another unit.
    rate : float, optional
        Frames per second of a folder of images whose names are no times, 0.01 to 1000. Default: 30.
    start : int
        Index of the first frame to read, for recordings, simulated people and data sets. The source
        begins at this frame each time it is read again. It does not shift indices: ``source[0]``
        is the first frame of the recording.

    Returns
    -------
    RgbdSource
        An iterator of frames; use it in a ``with`` statement to close the camera at the end.

    Raises
    ------
    InputError
        The scheme is unknown, an option is out of range, or the camera of a folder is not known.
    FormatError
        The recording is damaged.
    DeviceError
        This build lacks the driver, or the device is not connected.
    MissingExtraError
        rosbags is not installed (``rgbd-bag:``): ``pip install 'manip3d[bags]'``.
    OSError
        The file cannot be read.

    Notes
    -----
    The options of ``forged:`` are joined by ``&``; write ``%26`` for an ``&`` in a value, and
    ``%25`` for a ``%``.

    - ``type``: type of the forgery, 1 or 2. Type 2 needs ``pose``.
    - ``pose``: the motion, a source with skeletons or a ``.bvh`` file.
    - ``background``: a source of the same camera; default: the scene behind the person, learnt from
      the first 30 frames, which stay real.
    - ``still``: ``yes`` uses only the first frame of ``background``.
    - ``move`` (X,Y,Z in metres) and ``blend`` (pixels): see `forge.stream`.
    - ``show``: ``real``, ``forged``, or the seconds after which real and forged frames alternate,
      beginning with real ones.
    - ``switch``: a file with the word ``real`` or ``forged``, which is read before each frame.

    At most 300 frames of a background or motion are kept; they are played forwards and backwards in
    turn. If the background has no colour, no frame has.

    A folder of images has depth images in ``depth`` (PNG) and, optionally, colour images (PNG or
    JPEG) in ``color``, ``colour``, ``rgb``, ``image`` or ``images``. The last two names may stand
    for any pictures, so that those that cannot be paired with depth images are left out. Colour
    pictures that are left out, also those in other folders, are warned of if no frame has colour.

    - Names that are times (in seconds with a fraction, or in smaller units since 1970) are the
      times of the frames, and images at most 0.02 s apart are paired, as in a TUM sequence; it is
      an error if there are none. Numbers with a point are such times if one has five digits before
      it or three after it, as in 7.125; in 1.9, 1.10, 1.11 they are two whole numbers.
    - Other images are evenly spaced, with gaps in `RgbdFrame.number` and ``time_ns`` where numbers
      are missing. They are paired by the numbers in their names, or by equal names. Lists of equal
      length are paired in order if no names agree; if at most one in ten does, and the numbers are
      no frame numbers (milliseconds, say); or if both are counted from the same number, or one from
      0, the other from 1, and no number is missing. The number that counts is the last one that
      changes from name to name, or the first.
    - It is an error if both are counted from the same number, none is missing, and there are more
      than ten colour images for nine depth images: they may have counters of their own.
    - It is an error if less than two thirds of the depth images have a colour image of their number
      (nine of ten if no number is missing), or if lists of equal length differ although one of them
      lacks no number.
    - Depth images without a colour image are counted (``counters["without_color"]``), and colour
      images without a depth image are left out.

    If the unit of depth images is assumed, a warning is given if they have 8 bits, or if the median
    depth of the first frame is not within 0.2 to 12 m.

    Pixels of 65535 in depth images of other programs (folders of images, TUM, bags) are not
    measured, whatever the unit: many cameras and data sets mark missing pixels so. Folders count
    them (``counters["pixels_of_65535"]``).

    In ``rgbd-bag:PATH#TOPIC``, ``TOPIC`` is a topic of depth images (sensor_msgs/Image with 16UC1,
    mono16 or 32FC1, or compressedDepth); it is needed if there are several. Intrinsics come from
    the CameraInfo beside each topic, the pose of the colour camera from ``/tf_static`` or from the
    messages of RealSense's recorder. If that pose is not known, frames have no colour, and a
    warning is given. Depths beyond 65.535 m are treated as not measured.

    ``joints:SOURCE#FILE`` replaces the skeletons of a recording. ``FILE`` is

    - a ``.skeleton`` of NTU RGB+D, or a folder of OpenPose's ``*_keypoints.json`` (``--write_json``
      with its model BODY_25), with as many frames as the recording, in its order;
    - a ``.json`` with results in the format of COCO (17 joints) or COCO-WholeBody: ``image_id`` is
      `RgbdFrame.number`;
    - a ``.json`` of Azure Kinect's sample ``offline_processor``: by the times of the frames;
    - a ``.csv`` as written by `export_joints`, by `RgbdFrame.number`, for any other tracker. If its
      ``time_ns`` contradict the times of the frames by more than half a frame, a warning is given.

    Joints of OpenPose and COCO are pixels of the colour image, or of the depth image of a recording
    without colour. The depth image lifts them to 3D, and an adult's distance from skin to joint is
    added as by `manip3d.modify.lift_landmarks`. Joints of confidence 0, without depth, or at whose
    pixel the depth is farther than 1.2 m from that of most joints are not tracked; those of a
    confidence below 0.5 are inferred.

    These pixels belong to the images that the tracker saw. If the source stores its images mirrored
    (`RgbdSource.flipped`), the pixels are flipped with the images. A tracker that saw mirrored
    images took the left limbs for right ones, unless it knew of it. People who face the camera tell
    which is the case: where a nose is seen in an image that is not mirrored, the left shoulder is
    to the right. If no nose is seen, or frames disagree, the address must say it. Options after
    ``?``, joined by ``&``:

    - ``FILE?sides=exchanged`` exchanges left and right of the file, ``FILE?sides=named`` keeps
      them. By default those of mirrored images are exchanged if the tracker did not know of it;
      of other images, sides that seem to be exchanged are only warned of.
    - ``FILE?mirrored=yes`` or ``no`` says whether the tracker's images were mirrored. It is ``yes``
      for joints that were found in mirrored images before these were recorded, since `record`
      writes them flipped.

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
    if makes_frames and any(given is not None for given in (camera, units_per_metre, rate)):
        raise InputError(f"camera, units_per_metre, rate: expected none of them for {scheme}:")
    if scheme == "forged":
        if start:
            raise InputError(
                "start: expected 0 for forged:, as its frames depend on earlier frames"
            )
        return _open_forged(uri, speed)
    if scheme == "joints":
        if not 0.0 <= speed < math.inf:
            raise InputError(f"speed: expected a finite number >= 0, got {speed}")
        place, file = source_and_file(uri)
        address = rgbd_address(place) or place

        def opened() -> RgbdSource:
            return open_rgbd(address, camera=camera, units_per_metre=units_per_metre, rate=rate)

        joined = JoinedJoints(uri, opened, file)
        return _checked_start(source_of(joined, uri, speed, start), start)
    if units_per_metre is not None and not units_per_metre > 0:
        raise InputError(f"units_per_metre: expected > 0, got {units_per_metre}")
    if units_per_metre is not None and scheme not in ("folder", "tum", "rgbd-bag"):
        raise InputError(
            f"units_per_metre: can only be given with a folder of images or a bag, got {uri}"
        )
    if rate is not None and not rate > 0:
        raise InputError(f"rate: expected > 0, got {rate}")
    if rate is not None and scheme != "folder":
        raise InputError(f"rate: can only be given with a folder of images, got {uri}")
    if makes_frames or scheme == "rgbd-bag":
        if not 0.0 <= speed < math.inf:
            raise InputError(f"speed: expected a finite number >= 0, got {speed}")
        if makes_frames:
            return _checked_start(source_of(_frames_of(uri, scheme), uri, speed, start), start)
        place, topic = place_and_topic(uri)
        images = BagImages(path_of(place, "uri"), topic, camera, units_per_metre)
        return _checked_start(source_of(images, uri, speed, start, images.assumed_units), start)
    if scheme == "folder" and camera is None:
        camera = camera_of_folder(Path(uri.partition(":")[2]))
    return _checked_start(_open_in_core(uri, camera, units_per_metre, rate, speed, start), start)


def _open_in_core(
    uri: str,
    camera: RgbdCalibration | Intrinsics | None,
    units_per_metre: float | None,
    rate: float | None,
    speed: float,
    start: int,
) -> RgbdSource:
    """Open a camera, a folder of images or a Matroska file, which C++ reads."""
    scheme = uri.partition(":")[0]
    # RgbdCalibration refuses mirrored cameras; the core takes them and flips the images.
    given: Any = SimpleNamespace(depth=camera, registration=None)
    calibration = given if isinstance(camera, Intrinsics) else camera

    def opened(speed: float = 0.0) -> Any:
        return _core.open_rgbd(
            os.fsencode(uri), speed, units_per_metre or 0.0, rate or 0.0, calibration
        )

    def begun() -> Any:
        source = opened(speed)
        if start:
            source.seek(start)
        return source

    first = begun()
    again = scheme in RECORDINGS or not first.is_live()
    source = RgbdSource(
        uri,
        first,
        begun if again else None,
        opened if again else None,
        None if units_per_metre else _assumed_units(uri),
    )
    _warn_of_folder(source, units_per_metre)
    if source.counters.get("nominal_camera"):
        warnings.warn(
            "camera: expected a calibration.json, or freiburg1, freiburg2 or freiburg3 in the name "
            f"of a TUM sequence, got {uri}: the pixels of the camera that is taken (fx = fy = 525, "
            "cx = 319.5, cy = 239.5) are up to 3 % off",
            stacklevel=caller_level(),
        )
    return source


def _assumed_units(uri: str) -> float | None:
    """Return the units per metre of images that do not state them; None of other sources."""
    scheme, _, place = uri.partition(":")
    return None if _is_ours(Path(place)) else {"folder": 1000.0, "tum": 5000.0}.get(scheme)


def _is_ours(folder: Path) -> bool:
    """Return whether a folder is a recording of this library."""
    return any((folder / name).is_file() for name in ("frames.jsonl", "calibration.json"))


def _warn_of_folder(source: RgbdSource, units_per_metre: float | None) -> None:
    """Warn of pictures beside depth images that are not read, and of a unit that is assumed."""
    scheme, _, place = source.uri.partition(":")
    folder, told = Path(place), ""
    if scheme not in ("folder", "tum") or _is_ours(folder):
        return
    if scheme == "folder" and "without_color" not in source.counters:
        told = pictures_left_out(folder)
    elif scheme == "tum" and not units_per_metre and not (folder / "rgb.txt").exists():
        told = (
            f"{source.uri}: no rgb.txt as in the sequences of the TUM benchmark; 5000 units per "
            f"metre are assumed as in these; {SET_UNIT}"
        )
    if told:
        warnings.warn(told, stacklevel=caller_level())


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
            frames = list(islice(source, MAX_KEPT))
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
