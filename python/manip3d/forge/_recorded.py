"""Recordings as material of a forged stream: gone through once, at one pace, few frames kept."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import overload

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.forge._plates import background_plate
from manip3d.rgbd import RgbdFrame, check_frames

MOST_KEPT = 300
"""Frames of a background that are kept, and of a recording whose background is learnt."""

_MOST_POSES = 30 * MOST_KEPT  # skeletons are small: five minutes at 30 frames a second
_TIMED = 60  # first frames of a source, whose times tell its rate


@dataclass(frozen=True, eq=False)
class RecordedPeople:
    """Result of `recorded_people`.

    Attributes
    ----------
    frames : iterable of RgbdFrame
        For `stream`; of a recording each is gone when the next one is asked for.
    step_ns : float
        Nanoseconds between two of them; 0 of a single one.
    plate : RgbdFrame or None
        The scene behind the people, where it was asked for.
    """

    frames: Iterable[RgbdFrame]
    step_ns: float
    plate: RgbdFrame | None


@checked
def recorded_people(
    source: Iterable[RgbdFrame], *, num_frames: int | None = None, with_plate: bool = False
) -> RecordedPeople:
    """Look through a recording once, so that `stream` can forge it the second time.

    Parameters
    ----------
    source : iterable of RgbdFrame
        A sequence, or what `manip3d.capture.open_rgbd` opened. The frames of a camera or of an
        iterator, which come once, are kept.
    num_frames : int, optional
        The first ones only; a camera has no end without, nor have some iterators.
    with_plate : bool
        Learn the scene behind the people, from frames that are spread over the recording; else its
        first frames are enough.

    Returns
    -------
    RecordedPeople

    Raises
    ------
    InputError
        ``num_frames`` is below 1; there is no frame; a plate is asked for, and no frame tells where
        people are.

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
def recorded_poses(
    source: Iterable[RgbdFrame], *, num_frames: int | None = None
) -> list[RgbdFrame]:
    """Return frames with their skeletons alone, which take little memory: at most 9000.

    Parameters
    ----------
    source : iterable of RgbdFrame
    num_frames : int, optional
        The first ones only. None, or more than 9000: the first 9000, five minutes at 30 a second.

    Returns
    -------
    list of RgbdFrame
        Without colour and body index, and with images without measurements.

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
    found = [
        _skeletons_only(f) for f in islice(source, min(num_frames or _MOST_POSES, _MOST_POSES))
    ]
    if not found:
        raise InputError(f"{getattr(source, 'uri', 'source')}: expected a frame, found none")
    return found


def _check_frames_wanted(num_frames: int | None) -> None:
    if num_frames is not None and num_frames < 1:
        raise InputError(f"num_frames: expected at least 1, got {num_frames}")


@checked
def at_pace(frames: Sequence[RgbdFrame], step_ns: float) -> Sequence[RgbdFrame]:
    """Return frames, repeated or left out so that they keep the pace of their recording.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        Their times tell their own pace.
    step_ns : float
        Nanoseconds between two frames of what they are played with; 0: unknown, as they are.

    Returns
    -------
    sequence of RgbdFrame
        No frame is copied.

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
    check_frames("frames", frames[:1])
    if not len(frames):
        raise InputError("frames: expected one at least, got none")
    if not 0.0 <= step_ns < math.inf:
        raise InputError(f"step_ns: expected a finite number >= 0, got {step_ns}")
    return _AtStep(frames, _step_of([frame.time_ns for frame in frames[:_TIMED]]), step_ns)


@dataclass(frozen=True)
class _First:
    """The first frames of a source, however often it is gone through."""

    source: Iterable[RgbdFrame]
    num_frames: int | None

    def __iter__(self) -> Iterator[RgbdFrame]:
        return islice(self.source, self.num_frames)


class _Spread:
    """At most `MOST_KEPT` frames, spread evenly over however many there are."""

    def __init__(self) -> None:
        self.kept: list[RgbdFrame] = []
        self._every, self._seen = 1, 0

    def add(self, frame: RgbdFrame) -> None:
        if self._seen % self._every == 0:
            if len(self.kept) == MOST_KEPT:
                self.kept = self.kept[::2]
                self._every *= 2
            if self._seen % self._every == 0:
                self.kept.append(_for_plate(frame))
        self._seen += 1


def _for_plate(frame: RgbdFrame) -> RgbdFrame:
    """The frame without the colour that a plate cannot have: that of a camera of its own."""
    return frame if frame.calibration.registration is None else replace(frame, color=None)


def _skeletons_only(frame: RgbdFrame) -> RgbdFrame:
    """The frame with an image without measurements, which takes no memory."""
    check_frames("source", [frame])
    nothing = np.broadcast_to(np.uint16(0), frame.depth.shape)
    return replace(frame, depth=nothing, color=None, body_index=None)


def _step_of(times: Sequence[int]) -> float:
    """Time between two frames, nanoseconds; 0: there is one alone."""
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


class _AtStep(Sequence[RgbdFrame]):
    """Frames at another rate, at the pace at which they were recorded.

    Parameters
    ----------
    frames : sequence of RgbdFrame
    own, step : float
        Times between two frames, as they are and as wanted; where one is unknown they are equal.
    """

    def __init__(self, frames: Sequence[RgbdFrame], own: float, step: float) -> None:
        self.calibration = frames[0].calibration
        self._frames = frames
        self._ratio = step / own if own > 0 and step > 0 else 1.0
        most = (len(frames) - 0.5) / self._ratio  # steps before the time of the last frame ends
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
