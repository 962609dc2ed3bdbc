"""RGB-D cameras and recordings: the RGB-D half of `manip3d.capture`."""

from __future__ import annotations

import math
import operator
import os
import shutil
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Sized
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Protocol, cast, overload, runtime_checkable

from manip3d import _core
from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d._util.paths import path_of
from manip3d.camera import Intrinsics, Registration
from manip3d.capture._bag import place_and_topic
from manip3d.capture._bag_rgbd import BagImages
from manip3d.capture._forged import MOST_KEPT, SwitchedForgery, motion_of, read_plan
from manip3d.capture._frame_source import FrameSource
from manip3d.capture._one_camera import with_one_camera
from manip3d.capture._past_errors import past_errors
from manip3d.errors import FormatError, InputError
from manip3d.rgbd import RgbdCalibration, RgbdFrame, Skeleton

if TYPE_CHECKING:
    from manip3d._util.options import Progress

_LONGEST_BEFORE = 60.0  # seconds
_MOST_ERRORS = 1000  # frames, where nobody knows how many there are
_PEOPLE = ("utd-mhad", "labanotation", "people")
_RECORDINGS = ("folder", "mkv", "tum")  # files that can be read again, and written


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
class RgbdSource(FrameSource[RgbdFrame]):
    """Frames of an RGB-D camera or recording one after the other; made by `open`.

    Iterating goes on where reading stopped; once a recording has ended, it begins anew, but not
    after `stop`. `start` begins anew a recording that is read as fast as it can be, whether it has
    ended or not; one that is played in real time goes on, as a camera does. Sources made by
    `from_frames` begin anew if their frames are a sequence, a simulator or a data set, not if they
    come from an iterator.

    What begins anew has an index too: ``source[10]`` is the eleventh frame, ``source[-1]`` the last
    one, ``source[10:20]`` a list; reading goes on where it was, unless `seek` moves it. ``len()``
    is `num_frames`, and a `TypeError` where nobody knows it. Folders and recordings of this library
    go to a frame at once, those of the Azure Kinect by passing over the frames before it.

    The images of a frame are its own: nothing changes in them when the next one comes, and they
    come out of the core without a copy.

    Attributes
    ----------
    uri : str
    is_live : bool
        Frames come when they come, and the latest one wins.
    errors : dict of int to str
        Why frames could not be read, by their places in `past_errors`.
    """

    def __init__(
        self,
        uri: str,
        source: Any,
        reopen: Callable[[], Any] | None = None,
        open_indexed: Callable[[], Any] | None = None,
    ) -> None:
        self.uri = uri
        self.is_live = bool(source.is_live())
        self._source = source
        self._reopen = reopen
        self._open_indexed = open_indexed or reopen
        self._indexed: Any = None
        self._is_started = self._is_stopped = False
        self._calibration: RgbdCalibration | None = None
        self.errors: dict[int, str] = {}
        self._is_color_checked = False
        self.start()

    @property
    def calibration(self) -> RgbdCalibration:
        """Calibration of all frames."""
        assert self._calibration is not None
        return self._calibration

    @property
    def counters(self) -> dict[str, int]:
        """Counts of frames given (``frames``), lost (``dropped``) and refused so far, by reason."""
        found: dict[str, int] = self._source.counters()
        return found

    @property
    def num_frames(self) -> int | None:
        """Number of frames of a recording; None: nobody knows."""
        found: int | None = self._source.num_frames()
        return found

    @property
    def begins_anew(self) -> bool:
        """Whether it can be read again from its first frame: neither camera nor iterator."""
        return not self.is_live and self._reopen is not None

    @property
    def has_known_end(self) -> bool:
        """Whether it is known to end: no camera, and no iterable's frames without a length."""
        is_iterated = isinstance(self._source, _Iterated)
        return not self.is_live and not (is_iterated and self.num_frames is None)

    def start(self) -> None:
        """Open the device again after a `DeviceError`; a recording begins anew, with its counters.

        `open` does it the first time. A recording that is played in real time goes on where an
        error stopped it, as a camera does.

        Raises
        ------
        DeviceError
            It is not there.
        FormatError, OSError
            The recording is no longer what it was.
        """
        if self._is_started and self._reopen is not None and not self.is_live:
            self._open_again(self._reopen)
        self._begin()

    def _open_again(self, reopen: Callable[[], Any]) -> None:
        self._source.stop()
        self._source = reopen()

    def seek(self, index: int) -> None:
        """Go to a frame, which is the next one that is read; the counters begin anew.

        A damaged frame is passed over in files that say which one it is, and named in others.

        Parameters
        ----------
        index : int
            0 is the first frame and -1 the last; `num_frames` is the end.

        Raises
        ------
        InputError
            A camera or an iterator, or there are not so many frames.
        """
        length = self.num_frames
        if length is None and index < 0:
            raise InputError(
                f"index: expected >= 0, because the number of frames is unknown; got {index}"
            )
        if length is not None and not -length <= index <= length:
            raise InputError(f"index: expected {-length} to {length}, got {index}")
        self._open_again(self._recorded(self._reopen))
        self._source.seek(index if index >= 0 else index + (length or 0))
        self._begin()

    def _recorded(self, reopen: Callable[[], Any] | None) -> Callable[[], Any]:
        if reopen is None:
            raise InputError(
                f"source: expected a recording, whose frames have an index, got {self.uri}"
            )
        return reopen

    @overload
    def __getitem__(self, index: int) -> RgbdFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[RgbdFrame]: ...
    def __getitem__(self, index: int | slice) -> RgbdFrame | list[RgbdFrame]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        at, length = operator.index(index), self.num_frames
        at += length if at < 0 and length is not None else 0
        if at < 0 or (length is not None and at >= length):
            raise IndexError(f"frame {index} of {length or 'an unknown number'}")
        open_indexed = self._recorded(self._open_indexed)
        indexed = self._indexed  # another thread may stop the source meanwhile
        if indexed is None:
            indexed = self._indexed = open_indexed()
        try:
            found = indexed.read_at(at)
        except InputError:
            raise IndexError(f"frame {index}: the recording ends before it") from None
        finally:
            indexed.stop()  # between two frames nobody reads
        return self._to_frame(found) if isinstance(found, Mapping) else found

    def __len__(self) -> int:
        if (length := self.num_frames) is None:
            raise TypeError(f"{self.uri}: the number of frames is unknown")
        return length

    def __bool__(self) -> bool:
        return True  # however many frames

    def _begin(self) -> None:
        self._is_started = True
        self._has_ended = self._is_stopped = False
        self._source.start()
        self._calibration = _to_calibration(self._source.calibration())

    def read(self, timeout: float | None = None) -> RgbdFrame | None:
        """The next frame; of live sources the latest.

        Parameters
        ----------
        timeout : float, optional
            Seconds to wait for a live source; without it until there is one.

        Returns
        -------
        RgbdFrame or None
            None: the recording ends, the source was stopped, or the time is over.

        Raises
        ------
        FormatError
            A file is damaged; the next call goes on behind the damaged frame.
        DeviceError
            The camera is gone; `start` tries to open it again.
        """
        frame = self._wait(timeout)
        if not self._is_color_checked and self.counters.get("unregistered_color"):
            self._is_color_checked = True
            warnings.warn(
                f"{self.uri}: the colour images are of another size than the depth images, and the "
                "calibration has no registration: frames have no colour",
                stacklevel=caller_level(),
            )
        return frame

    def past_errors(self) -> Iterator[RgbdFrame | None]:
        """Read on to the end, past frames that cannot be read; `errors` begins anew.

        Yields
        ------
        RgbdFrame or None
            None: the frame cannot be read, and `errors` says why.

        Raises
        ------
        FormatError, OSError
            The first reason, where no frame can be read.
        DeviceError
            The camera is gone.
        """
        self.errors.clear()
        frames = cast("Iterator[RgbdFrame]", iter(self.read, None))
        most = self.num_frames or _MOST_ERRORS
        yield from past_errors(frames, self.errors, (FormatError, OSError), most=most)

    def _rewind(self) -> None:
        if self._reopen is not None and not self._is_stopped:
            self._open_again(self._reopen)
            self._begin()

    def _to_frame(self, fields: Mapping[str, Any]) -> RgbdFrame:
        skeletons = tuple(Skeleton(**skeleton) for skeleton in fields["skeletons"])
        return RgbdFrame(**{**fields, "skeletons": skeletons}, calibration=self.calibration)

    def stop(self) -> None:
        """End a live source's thread; the frame that it has can still be read.

        What is no camera gives no more frames, unless `start` or `seek` is called: a loop over an
        endless iterator ends, too, with the frame that it waits for.
        """
        self._is_stopped = True
        self._source.stop()
        self._indexed = None


@checked
class ForgedSource(RgbdSource):
    """A source whose person stands before another scene, or does not: ``forged:SOURCE``.

    Attributes
    ----------
    forged : bool
        Whether the next frames are forged; may be set at any time, from any thread. A file that
        the address names as its ``switch``, or a time after which they alternate, has precedence.
    """

    @property
    def forged(self) -> bool:
        """Whether the next frames are forged."""
        return bool(self._source.is_forged)

    @forged.setter
    def forged(self, value: bool) -> None:
        if not isinstance(value, bool):
            raise InputError(f"forged: expected True or False, got {value!r}")
        self._source.is_forged = value

    @property
    def begins_anew(self) -> bool:
        """Whether the source that is forged can be read again from its first frame."""
        return not self.is_live

    def _rewind(self) -> None:
        if not self.is_live and not self._is_stopped:
            self.start()


_LATE_S = 0.05  # of the reader's time, behind which a frame is not shown
_MOST_SEARCH_S = 0.1  # in a read(), for a frame that is not late


class FrameClock:
    """Tells when frames are due at a playback speed; 0: at once, 1: in real time.

    It begins with the first frame that it is asked for.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._began: tuple[float, int] | None = None

    def late_s(self, time_ns: int) -> float:
        """Return by how much the time of a frame is over, in seconds of the source."""
        speed = self._speed  # another thread may stop the clock meanwhile
        if not speed > 0.0:
            return 0.0
        if self._began is None:
            self.restart(time_ns)
        assert self._began is not None
        began, first = self._began
        return (time.monotonic() - began) * speed - (time_ns - first) * 1e-9

    def restart(self, time_ns: int) -> None:
        """Make a frame due now, and those after it by their times."""
        self._began = time.monotonic(), time_ns

    def is_due(self, time_ns: int, timeout_ms: int) -> bool:
        """Wait for the time of a frame, at most so long."""
        speed = self._speed
        if not speed > 0.0:
            return True
        left = -self.late_s(time_ns) / speed
        time.sleep(min(max(left, 0.0), timeout_ms / 1000.0))
        return left <= timeout_ms / 1000.0

    def stop(self) -> None:
        """No frame is waited for any more."""
        self._speed = 0.0


@runtime_checkable
class _Indexed(Protocol):
    def __getitem__(self, index: int, /) -> RgbdFrame: ...


def _length_of(frames: Iterable[RgbdFrame]) -> int | None:
    try:
        return len(frames) if isinstance(frames, Sized) else None
    except TypeError:  # a source whose length nobody knows
        return None


class _Iterated:
    """Any iterable of frames; the same face as the core's sources.

    Played by their times, frames whose time is over are left out, as of recordings. A simulator
    says its ``rate``, and such frames of it are not even made.
    """

    def __init__(
        self,
        frames: Iterable[RgbdFrame],
        calibration: RgbdCalibration | None,
        speed: float = 0.0,
    ) -> None:
        self._all = frames
        self._length = _length_of(frames)
        self._rate: float = getattr(frames, "rate", 0.0)
        self._clock = FrameClock(speed)
        self._late_s = _LATE_S * max(1.0, speed)  # in seconds of the source, as the clock's
        self._given = self._dropped = 0
        self._index = 0
        self._frames = iter(frames)
        self._first: RgbdFrame | None = None
        if calibration is None:
            self._first = self._made()
            if not isinstance(self._first, RgbdFrame):
                raise InputError(f"source: expected frames of an RGB-D camera, got {self._first!r}")
            calibration = self._first.calibration
        self._calibration = calibration
        self._lock = threading.RLock()

    def read(self, timeout_ms: int) -> RgbdFrame | bool:
        """The next frame; True: it is not its time yet; False: there is none."""
        with self._lock:
            frame = self._first or self._made()
            if frame is None:
                return False
            if not self._rate:
                frame = self._in_time(frame)
            if not self._clock.is_due(frame.time_ns, timeout_ms):
                self._first = frame
                return True
            self._first = None
            self._given += 1
            return frame

    def _made(self) -> RgbdFrame | None:
        """The next frame; of a simulator the latest one that is due, if its reader is late."""
        if self._rate and self._given and self._length is not None:
            late = self._clock.late_s(round(self._index / self._rate * 1e9))
            missed = min(int(late * self._rate), self._length - 1 - self._index)
            if missed > 0:
                self._go_to(self._index + missed)
                self._dropped += missed
        self._index += 1
        return next(self._frames, None)

    def _in_time(self, frame: RgbdFrame) -> RgbdFrame:
        """The frame, or the first one after it whose time is not over, or else the last one.

        After a tenth of a second the frame at hand is given, late as it is: the reader waits, and
        where frames are made hardly faster than they are played nothing else would end this soon.
        """
        until = time.monotonic() + _MOST_SEARCH_S
        late = self._clock.late_s(frame.time_ns)
        while (
            late > self._late_s and time.monotonic() < until and (after := self._made()) is not None
        ):
            self._dropped += 1
            frame, before = after, late
            late = self._clock.late_s(frame.time_ns)
            if late >= before:  # frames are made more slowly than they are played
                self._clock.restart(frame.time_ns)
                break
        return frame

    def seek(self, index: int) -> None:
        """Go to a frame; those before it are made where they cannot be left out."""
        with self._lock:
            self._first = None
            self._go_to(index)

    def _go_to(self, index: int) -> None:
        self._index = index
        if self._length is not None and isinstance(self._all, _Indexed):
            self._frames = map(self._all.__getitem__, range(index, self._length))
        else:
            self._frames = islice(iter(self._all), index, None)

    def read_at(self, index: int) -> RgbdFrame:
        """The frame of an index."""
        self.seek(index)
        if (frame := next(self._frames, None)) is None:
            raise InputError(f"index: expected that of a frame, got {index}")
        return frame

    def calibration(self) -> RgbdCalibration:
        """Return the calibration of the source, else of its first frame."""
        return self._calibration

    def counters(self) -> dict[str, int]:
        """Frames given, and frames left out because their time was over."""
        return {"frames": self._given, "dropped": self._dropped}

    def num_frames(self) -> int | None:
        """The length of a sequence."""
        return self._length

    def is_live(self) -> bool:
        """Frames are made when they are asked for."""
        return False

    def start(self) -> None:
        """There is nothing to open."""

    def stop(self) -> None:
        """End the wait for the time of a frame; there is no thread."""
        self._clock.stop()


def _to_calibration(found: Any) -> RgbdCalibration:
    if isinstance(found, RgbdCalibration):
        return found
    registration = None
    if "color" in found:
        registration = Registration(
            Intrinsics(**found["color"]), found["rotation"], found["translation"]
        )
    return RgbdCalibration(Intrinsics(**found["depth"]), registration)


@checked
def from_frames(frames: Iterable[RgbdFrame], *, uri: str = "frames") -> RgbdSource:
    """Make a source of frames that are there already, or that a generator makes.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Frames of one camera. The first is read at once, unless ``frames`` has a ``calibration``.
        They may never end: `RgbdSource.stop` ends a loop over them then. `read` waits for the
        iterator, whatever its ``timeout``.
    uri : str
        Name of the source in messages.

    Returns
    -------
    RgbdSource
        It ends with the last frame.

    Raises
    ------
    InputError
        There is no frame, and ``frames`` has no ``calibration``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, capture
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> frames = [RgbdFrame(depth, camera, time_ns=n * 33_000_000, number=n) for n in range(3)]
    >>> source = capture.from_frames(frames)
    >>> source.read().number, [frame.number for frame in source]
    (0, [1, 2])
    """

    return _source_of(frames, uri)


def _source_of(
    frames: Iterable[RgbdFrame], uri: str, speed: float = 0.0, start: int = 0
) -> RgbdSource:
    def opened() -> _Iterated:
        source = _Iterated(frames, getattr(frames, "calibration", None), speed)
        if start:
            source.seek(start)
        return source

    # An iterator can only be gone through once.
    return RgbdSource(uri, opened(), None if isinstance(frames, Iterator) else opened)


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
        return _checked_start(_source_of(frames, uri, speed, start), start)
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
    again = scheme in _RECORDINGS or not first.is_live()
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


@dataclass(frozen=True)
class Recording:
    """Result of `record`.

    Attributes
    ----------
    path : Path
    frames : int
    frames_with_skeleton : int
        Frames in which the source has a person's skeleton; the phantom limb needs one.
    seconds : float
        From the first frame's time to the last's.
    stop : str
        ``end`` (of the source), ``frames`` or ``seconds`` (as many as were asked for).
    counters : dict of str to int
        What the recorder counted.
    source_counters : dict of str to int
        What the source counted, lost frames among it.
    """

    path: Path
    frames: int
    frames_with_skeleton: int
    seconds: float
    stop: str
    counters: dict[str, int]
    source_counters: dict[str, int]


@checked
def record(
    source: str | Iterable[RgbdFrame],
    path: str | os.PathLike[str],
    *,
    frames: int | None = None,
    seconds: float | None = None,
    trigger: Callable[[RgbdFrame], bool] | None = None,
    before: float = 0.0,
    lossless_color: bool = False,
    jpeg_quality: int = 90,
    overwrite: bool = False,
    progress: Progress = None,
) -> Recording:
    """Write frames to a recording: a folder, Matroska for ``.mkv``, or a TUM sequence.

    What was written is whole if this is stopped by Ctrl-C, by an error or by a kill.

    Parameters
    ----------
    source : str or iterable of RgbdFrame
        A URI for `open`, or what gives frames: a source, a simulator, a list.
    path : path-like
        A new folder, or a file that ends in ``.mkv``. ``folder:``, ``mkv:`` or ``tum:`` before it
        says the kind. ``tum:FOLDER`` is a sequence for programs that read those of the TUM RGB-D
        benchmark: see `Notes`.
    frames : int, optional
        Stop after so many.
    seconds : float, optional
        Stop at the first frame that is so much later than the first one.
    trigger : callable(RgbdFrame) -> bool, optional
        Begin with the first frame for which it is true; ``frames`` and ``seconds`` count from
        there.
    before : float
        Seconds before the trigger's frame that are written, too: 0 to 60. They wait in memory,
        some 200 MB a second with colour of 1920 x 1080 pixels.
    lossless_color : bool
        Instead of JPEG.
    jpeg_quality : int
        1 to 100.
    overwrite : bool
        Replace a recording of the same kind that nobody reads or records.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    Recording
        Its path, how many frames were written, and how many were lost.

    Raises
    ------
    InputError
        A path that exists, that is being read or recorded, or with an unknown suffix; frames that
        do not fit the calibration or each other, or whose times and numbers do not grow.
    OSError
        The disk is full, and the like; the frames before are good, and a note of the error says how
        many they are. If there are none, nothing is left of a new recording.
    FormatError, DeviceError
        The source raised it.

    Notes
    -----
    A TUM sequence has ``depth.txt`` and ``rgb.txt`` with a time in seconds and a file in each line,
    16-bit depth of 5000 units a metre, colour as PNG, ``associations.txt`` with the pairs, and
    ``calibration.json``, by which `open` knows the camera; times are exact. It has one camera, so
    colour of another one is looked up for each depth pixel. Skeletons, body indices and frame
    numbers are left out; depths beyond 13.107 m become 0 and are counted as ``too_far``. There is
    no ``groundtruth.txt``, because frames do not tell where their camera was.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, Skeleton, capture
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> frames = [RgbdFrame(depth, camera, time_ns=n * 33_000_000, number=n) for n in range(3)]
    >>> recording = capture.record(frames, "walk.mkv", frames=2)
    >>> recording.path.name, recording.frames
    ('walk.mkv', 2)

    The last second before somebody comes into the picture, and all that follows:

    >>> frames[2] = replace(frames[2], skeletons=(Skeleton(np.full((25, 3), 2.0)),))
    >>> capture.record(frames, "visit", trigger=lambda f: bool(f.skeletons), before=1.0).frames
    3

    A sequence for other programs:

    >>> capture.record(frames, "tum:sequence").path.name
    'sequence'
    >>> with capture.open("tum:sequence") as source:
    ...     len(source), source[-1].time_ns
    (3, 66000000)
    """
    for name, value in (("frames", frames), ("seconds", seconds)):
        if value is not None and not value > 0:
            raise InputError(f"{name}: expected > 0, got {value}")
    if not 0.0 <= before <= _LONGEST_BEFORE:
        raise InputError(f"before: expected 0 to {_LONGEST_BEFORE:g} seconds, got {before}")
    if before and trigger is None:
        raise InputError("before: expected a trigger with it, got None")
    place, kind = _place_of(path)
    if isinstance(source, RgbdSource):
        opened = source
    elif isinstance(source, str):
        opened = open_rgbd(source)
    else:
        opened = from_frames(source)
    is_tum = kind == _core.RecordingKind.tum
    was_there = place.exists()
    try:
        recorder = _core.open_recorder(
            os.fsencode(place),
            RgbdCalibration(opened.calibration.depth) if is_tum else opened.calibration,
            lossless_color,
            jpeg_quality,
            overwrite,
            kind,
        )
    except OSError:
        if not was_there:
            with suppress(OSError):
                place.rmdir()  # if it is empty
        raise

    def write(frame: RgbdFrame) -> None:
        recorder.write(with_one_camera(frame) if is_tum else frame)

    with _noting_frames(place, recorder, is_new=not was_there), ExitStack() as ends:
        if isinstance(source, str):
            ends.callback(opened.stop)
        ends.callback(recorder.close)
        with reporting(progress, "record") as report:
            copied = _copy(opened, write, frames, seconds, _since(trigger, before, opened), report)
    return Recording(place, *copied, recorder.counters(), opened.counters)


@contextmanager
def _noting_frames(place: Path, recorder: Any, *, is_new: bool) -> Iterator[None]:
    """Note at an error how many frames there are; a new recording without any is removed."""
    try:
        yield
    except BaseException as error:
        if written := recorder.counters()["frames"]:
            told = "1 frame, which is" if written == 1 else f"{written} frames, which are"
            error.add_note(f"{place} has {told} whole")
        elif is_new:
            remove_recording(place)
        raise


def remove_recording(place: Path) -> None:
    """Remove a recording that is a folder or a file."""
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    else:
        place.unlink(missing_ok=True)


def _place_of(path: str | os.PathLike[str]) -> tuple[Path, Any]:
    """The path of a recording to be written, and its kind where the address says it."""
    whole = path_of(path)
    scheme, colon, rest = str(whole).partition(":")
    if not colon or scheme not in _RECORDINGS:
        return whole, None
    if not rest:
        raise InputError(f"path: expected a place after {scheme}:, got none")
    return Path(rest), getattr(_core.RecordingKind, scheme)


def _copy(
    source: RgbdSource,
    write: Callable[[RgbdFrame], None],
    frames: int | None,
    seconds: float | None,
    wanted: Iterator[tuple[Sequence[RgbdFrame], RgbdFrame]],
    report: Any,
) -> tuple[int, int, float, str]:
    """Write frame after frame; counts of all and of those with a skeleton, seconds, the end."""
    written = with_skeleton = count = 0
    first = since = last = 0
    stop = "end"
    expected = min((n for n in (frames, source.num_frames) if n), default=None)
    for earlier, frame in wanted:
        if count == 0:
            first, since = (earlier[0] if earlier else frame).time_ns, frame.time_ns
        if seconds is not None and frame.time_ns - since >= seconds * 1e9:
            stop = "seconds"
            break
        for one in (*earlier, frame):
            write(one)
            written, with_skeleton = written + 1, with_skeleton + bool(one.skeletons)
        count, last = count + 1, frame.time_ns
        if report is not None:
            done = count / expected if expected else 0.0
            if seconds is not None:
                done = max(done, (last - since) / 1e9 / seconds)
            report(min(done, 1.0))
        if count == frames:
            stop = "frames"
            break
    return written, with_skeleton, (last - first) / 1e9, stop


def _since(
    trigger: Callable[[RgbdFrame], bool] | None, before: float, source: RgbdSource
) -> Iterator[tuple[Sequence[RgbdFrame], RgbdFrame]]:
    """Each frame from the trigger's on; with the first one, those of the seconds before it."""
    earlier: deque[RgbdFrame] = deque()
    is_on = trigger is None
    for frame in source:
        if not is_on and trigger is not None and not trigger(frame):
            earlier.append(frame)
            while frame.time_ns - earlier[0].time_ns > before * 1e9:
                earlier.popleft()
            continue
        while earlier and frame.time_ns - earlier[0].time_ns > before * 1e9:
            earlier.popleft()
        is_on = True
        yield tuple(earlier), frame
        earlier.clear()
