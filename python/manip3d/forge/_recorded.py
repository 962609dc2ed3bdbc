"""Prepare recordings for forged streams: one pass, adapted frame rate, few frames in memory."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import overload

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError
from manip3d.forge._plates import background_plate
from manip3d.rgbd import RgbdFrame, check_frames

MAX_KEPT = 300
"""Largest number of frames of a background or a motion in memory, and for estimating a background
plate."""

NUM_POSES = 30 * MAX_KEPT
"""Default largest number of poses: five minutes at 30 frames per second."""
_TIMED = 60  # number of first frames whose times determine the frame rate


@dataclass(frozen=True, eq=False)
class RecordedPeople:
    """Result of `recorded_people`.

    Attributes
    ----------
    frames : iterable of RgbdFrame
        Frames for `stream`; frames of a recording are not kept in memory.
    step_ns : float
        Nanoseconds between two frames; 0 for a single frame.
    plate : RgbdFrame or None
        The scene behind the people; None if it was not requested.
    """

    frames: Iterable[RgbdFrame]
    step_ns: float
    plate: RgbdFrame | None

    __repr__ = short_repr


@checked
def recorded_people(
    source: Iterable[RgbdFrame], *, num_frames: int | None = None, with_plate: bool = False
) -> RecordedPeople:
    """Read a recording once to prepare it for `stream`, which reads it again.

    Parameters
    ----------
    source : iterable of RgbdFrame
        A sequence, or a source of `manip3d.capture.open_rgbd`. Frames of a camera or of an
        iterator, which can be read only once, are kept in memory.
    num_frames : int, optional
        Largest number of frames; needed for a camera and for endless iterators.
    with_plate : bool
        Estimate the scene behind the people from frames that are spread over the recording; without
        it, only the first frames are read.

    Returns
    -------
    RecordedPeople

    Raises
    ------
    InputError
        ``num_frames`` is below 1; there is no frame; ``with_plate`` is set and no frame has
        skeletons or a body index.

    Examples
    --------
    >>> from manip3d import forge, simulate
    >>> body = simulate.BodySimulator(seed=0, color="none")
    >>> people = forge.recorded_people([body.frame(n / 30) for n in range(3)], with_plate=True)
    >>> round(people.step_ns / 1e6, 1), people.plate.depth.shape
    (33.3, (424, 512))
    """
    _check_frames_wanted(num_frames)
    name = getattr(source, "uri", "source")
    kept = None
    if isinstance(source, Iterator) or not getattr(source, "begins_anew", True):
        kept = list(islice(source, num_frames))
    every = source if kept is None else kept
    spread, is_told = _Spread(), False
    times: list[int] = []
    most = num_frames if with_plate else min(num_frames or _TIMED, _TIMED)
    for frame in islice(every, most):
        check_frames("source", [frame])
        if len(times) < _TIMED:
            times.append(frame.time_ns)
        if with_plate:
            is_told = is_told or bool(frame.skeletons) or frame.body_index is not None
            spread.add(frame)
    if not times:
        raise InputError(f"{name}: expected a frame, found none")
    if with_plate and not is_told:
        raise InputError(
            f"{name}: expected pixels or skeletons that separate people from the scene; got "
            "neither, and no background"
        )
    if kept is None and hasattr(source, "start"):
        source.start()
    plate = background_plate(spread.kept) if with_plate else None
    frames = _First(source, num_frames) if kept is None else kept
    return RecordedPeople(frames, _step_of(times), plate)


@checked
def recorded_poses(source: Iterable[RgbdFrame], *, num_frames: int = NUM_POSES) -> list[RgbdFrame]:
    """Return the first frames with their skeletons only, which take little memory.

    Parameters
    ----------
    source : iterable of RgbdFrame
        A sequence, or a source of `manip3d.capture.open_rgbd`.
    num_frames : int
        Largest number of frames; the default is five minutes at 30 frames per second.

    Returns
    -------
    list of RgbdFrame
        Frames without colour and body index, with empty depth images.

    Raises
    ------
    InputError
        ``num_frames`` is below 1, or there is no frame.

    Examples
    --------
    >>> from manip3d import forge, simulate
    >>> body = simulate.BodySimulator(seed=0, color="none")
    >>> (pose,) = forge.recorded_poses([body.frame(0.0)])
    >>> len(pose.skeletons), int(pose.depth.max())
    (1, 0)
    """
    _check_frames_wanted(num_frames)
    found = [_skeletons_only(frame) for frame in islice(source, num_frames)]
    if not found:
        raise InputError(f"{getattr(source, 'uri', 'source')}: expected a frame, found none")
    return found


def _check_frames_wanted(num_frames: int | None) -> None:
    if num_frames is not None and num_frames < 1:
        raise InputError(f"num_frames: expected at least 1, got {num_frames}")


@checked
def at_pace(frames: Sequence[RgbdFrame], step_ns: float) -> Sequence[RgbdFrame]:
    """Return frames repeated or left out so that they keep their speed at another frame rate.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        Frames, whose times determine their frame rate.
    step_ns : float
        Nanoseconds between two frames of the new frame rate; 0: unknown, the frames are unchanged.

    Returns
    -------
    sequence of RgbdFrame
        The frames at the new rate; no frame is copied.

    Raises
    ------
    InputError
        There is no frame, or ``step_ns`` is negative or not finite.

    Examples
    --------
    >>> from manip3d import forge, simulate
    >>> body = simulate.BodySimulator(seed=0, color="none")
    >>> slow = [body.frame(n / 10) for n in range(2)]
    >>> [slow.index(frame) for frame in forge.at_pace(slow, 1e9 / 30)]
    [0, 0, 1, 1, 1]
    """
    if not len(frames):
        raise InputError("frames: expected at least one, got none")
    first = [frames[i] for i in range(min(_TIMED, len(frames)))]  # a deque has no slices
    check_frames("frames", first[:1])
    if not 0.0 <= step_ns < math.inf:
        raise InputError(f"step_ns: expected a finite number >= 0, got {step_ns}")
    return _AtStep(frames, _step_of([frame.time_ns for frame in first]), step_ns)


@dataclass(frozen=True)
class _First:
    """The first frames of a source, each time it is iterated."""

    source: Iterable[RgbdFrame]
    num_frames: int | None

    def __iter__(self) -> Iterator[RgbdFrame]:
        return islice(self.source, self.num_frames)


class _Spread:
    """Keeps at most `MAX_KEPT` frames, evenly spread over all that are added."""

    def __init__(self) -> None:
        self.kept: list[RgbdFrame] = []
        self._every, self._seen = 1, 0

    def add(self, frame: RgbdFrame) -> None:
        if self._seen % self._every == 0:
            if len(self.kept) == MAX_KEPT:
                self.kept = self.kept[::2]
                self._every *= 2
            if self._seen % self._every == 0:
                self.kept.append(_for_plate(frame))
        self._seen += 1


def _for_plate(frame: RgbdFrame) -> RgbdFrame:
    """The frame; colour of a separate, unregistered camera is removed, as plates cannot use it."""
    return frame if frame.calibration.registration is None else replace(frame, color=None)


def _skeletons_only(frame: RgbdFrame) -> RgbdFrame:
    """The frame with skeletons only; its empty depth image takes no memory."""
    check_frames("source", [frame])
    nothing = np.broadcast_to(np.uint16(0), frame.depth.shape)
    return replace(frame, depth=nothing, color=None, body_index=None)


def _step_of(times: Sequence[int]) -> float:
    """Median time between two frames, nanoseconds; 0 for a single frame."""
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


class _AtStep(Sequence[RgbdFrame]):
    """Frames at another frame rate with unchanged speed.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        The recorded frames.
    own, step : float
        Time between two recorded frames, and between two new frames, in one unit; if one is
        unknown (0), the frames are unchanged.
    """

    def __init__(self, frames: Sequence[RgbdFrame], own: float, step: float) -> None:
        self.calibration = frames[0].calibration
        self._frames = frames
        self._ratio = step / own if own > 0 and step > 0 else 1.0
        most = (len(frames) - 0.5) / self._ratio  # number of steps until the last frame ends
        self._length = int(min(np.ceil(most), sys.maxsize // 4))

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, at: int) -> RgbdFrame: ...
    @overload
    def __getitem__(self, at: slice) -> list[RgbdFrame]: ...
    def __getitem__(self, at: int | slice) -> RgbdFrame | list[RgbdFrame]:
        if isinstance(at, slice):
            return [self[number] for number in range(*at.indices(self._length))]
        if not -self._length <= at < self._length:
            raise IndexError(at)
        at %= self._length
        return self._frames[min(int(at * self._ratio + 0.5), len(self._frames) - 1)]
