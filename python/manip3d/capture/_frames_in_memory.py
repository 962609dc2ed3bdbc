"""Frames in memory, or made by a generator, that are played back as a recording is."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sized
from itertools import islice
from typing import Any, Protocol, runtime_checkable

from manip3d.errors import InputError
from manip3d.rgbd import RgbdCalibration, RgbdFrame

_LATE_S = 0.05
"""Seconds of wall-clock time; a frame that is later is left out. The limit is about the period of
cameras, 15 to 30 frames a second, so that small delays of the reader lose no frame."""
_MAX_SEARCH_S = 0.1
"""Longest time that read() looks for a frame that is not late, because users notice longer pauses
of a live picture."""


class FrameClock:
    """Clock of a playback at a given speed; 0: all frames are due at once, 1: real time.

    The clock starts with the first call of `late_s`.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._began: tuple[float, int] | None = None

    def late_s(self, time_ns: int) -> float:
        """Return how late a frame is, in seconds of the source's time; negative: it is early."""
        speed = self._speed  # read once, because another thread may stop the clock
        if not speed > 0.0:
            return 0.0
        if self._began is None:
            self.restart(time_ns)
        assert self._began is not None
        began, first = self._began
        return (time.monotonic() - began) * speed - (time_ns - first) * 1e-9

    def restart(self, time_ns: int) -> None:
        """Restart the clock, so that the frame with this time is due now."""
        self._began = time.monotonic(), time_ns

    def reset(self) -> None:
        """Let the clock start again with the next call of `late_s`; a stopped clock stays so."""
        self._began = None

    def is_due(self, time_ns: int, timeout_ms: int) -> bool:
        """Wait until a frame is due, for at most ``timeout_ms``; return whether it is due.

        A negative ``timeout_ms`` is the same as 0.
        """
        speed = self._speed
        if not speed > 0.0:
            return True
        left = max(0.0, -self.late_s(time_ns) / speed)
        timeout = max(0.0, timeout_ms / 1000.0)
        time.sleep(min(left, timeout))
        return left <= timeout

    def stop(self) -> None:
        """Make all frames due, so that `is_due` waits for none."""
        self._speed = 0.0


@runtime_checkable
class _Indexed(Protocol):
    def __getitem__(self, index: int, /) -> RgbdFrame: ...


@runtime_checkable
class _Skipping(Protocol):
    def since(self, index: int, /) -> Iterator[RgbdFrame]: ...


def _length_of(frames: Iterable[RgbdFrame]) -> int | None:
    try:
        return len(frames) if isinstance(frames, Sized) else None
    except TypeError:  # len() of a source whose length is unknown
        return None


class IteratedFrames:
    """Source made of any iterable of frames, with the interface of the sources in ``_core``.

    If frames are played by their times (``speed`` above 0), late ones are left out, as in
    recordings. A simulator has a ``rate`` in Hz; its late frames are not generated at all.
    """

    def __init__(
        self,
        frames: Iterable[RgbdFrame],
        calibration: RgbdCalibration | None,
        speed: float = 0.0,
    ) -> None:
        self._source = frames
        self._length = _length_of(frames)
        self._rate: float = getattr(frames, "rate", 0.0)
        self._clock = FrameClock(speed)
        self._late_s = _LATE_S * max(1.0, speed)  # in seconds of the source's time
        self._given = self._dropped = 0
        self._index = 0
        self._frames = iter(frames)
        self._pending: RgbdFrame | None = None  # generated already, but not returned by `read`
        if calibration is None:
            self._pending = self._next_frame()
            if self._pending is None:
                raise InputError("source: expected at least one frame, got none")
            calibration = self._pending.calibration
        self._calibration = calibration
        self._lock = threading.RLock()

    def read(self, timeout_ms: int) -> RgbdFrame | bool:
        """Return the next frame; True: it is not due yet; False: no more frames."""
        with self._lock:
            frame = self._pending or self._next_frame()
            if frame is None:
                return False
            if not self._rate:
                frame = self._in_time(frame)
            if not self._clock.is_due(frame.time_ns, timeout_ms):
                self._pending = frame
                return True
            self._pending = None
            self._given += 1
            return frame

    def _next_frame(self) -> RgbdFrame | None:
        """Return the next frame; if the reader is late, a simulator skips to the last due frame."""
        if self._rate and self._given and self._length is not None:
            late = self._clock.late_s(round(self._index / self._rate * 1e9))
            missed = min(int(late * self._rate), self._length - 1 - self._index)
            if missed > 0:
                self._go_to(self._index + missed)
                self._dropped += missed
        return self._advance()

    def _advance(self) -> RgbdFrame | None:
        self._index += 1
        for frame in self._frames:
            if not isinstance(frame, RgbdFrame):
                raise InputError(f"source: expected frames of an RGB-D camera, got {frame!r:.80}")
            return frame
        return None

    def _in_time(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame, or if it is late the first following frame that is not, or the last.

        The search ends after `_MAX_SEARCH_S` with the frame it has reached, even if that is late:
        if frames are made hardly faster than they are played, it would not end soon otherwise.
        """
        until = time.monotonic() + _MAX_SEARCH_S
        late = self._clock.late_s(frame.time_ns)
        while (
            late > self._late_s
            and time.monotonic() < until
            and (after := self._next_frame()) is not None
        ):
            self._dropped += 1
            frame, before = after, late
            late = self._clock.late_s(frame.time_ns)
            if late >= before:  # frames take longer to make than to play: skipping gains nothing
                self._clock.restart(frame.time_ns)
                break
        return frame

    def seek(self, index: int) -> None:
        """Go to a frame, which is due at once.

        A source without random access generates all frames before it.

        Raises
        ------
        InputError
            The index is negative, or the frames are from an iterator, which does not go back.
        """
        if index < 0:
            raise InputError(f"index: expected >= 0, got {index}")
        if isinstance(self._source, Iterator):
            raise InputError("source: expected frames with an index, got an iterator")
        with self._lock:
            self._pending = None
            self._clock.reset()
            self._go_to(index)

    def _go_to(self, index: int) -> None:
        self._index = index
        if self._length is not None and isinstance(self._source, _Indexed):
            self._frames = map(self._source.__getitem__, range(index, self._length))
        elif isinstance(self._source, _Skipping):
            self._frames = self._source.since(index)
        else:
            self._frames = islice(iter(self._source), index, None)

    def read_at(self, index: int) -> RgbdFrame:
        """Return the frame with this index; the one after it is the next to be read.

        Raises
        ------
        InputError
            There is no such frame; see `seek`, too.
        """
        with self._lock:
            self.seek(index)
            if (frame := self._advance()) is None:
                raise InputError(f"index: expected that of a frame, got {index}")
            return frame

    def calibration(self) -> RgbdCalibration:
        """Return the calibration that was given, or else that of the first frame."""
        return self._calibration

    def counters(self) -> dict[str, int]:
        """Return the number of frames read, of those left out because they were late, and more.

        Counters of the frames' own source have a private name, as in `conversions`.
        """
        own: Mapping[str, int] = getattr(self._source, "_own_counters", {})
        return {"frames": self._given, "dropped": self._dropped, **own}

    def conversions(self) -> Mapping[str, Any]:
        """Return how the frames differ from what files hold, which `JoinedJoints` states.

        The name is private, because a user's iterable may use any other name for something else.
        """
        found: Mapping[str, Any] = getattr(self._source, "_conversions", {})
        return found

    def num_frames(self) -> int | None:
        """Return the number of frames; None if it is not known."""
        return self._length

    def goes_on(self) -> bool:
        """Return whether frames may follow after an error; a generator ends with its first one.

        The name of the iterator's attribute is private, as in `conversions`.
        """
        return bool(getattr(self._frames, "_goes_on", False))

    def is_live(self) -> bool:
        """Return False: frames are made on demand."""
        return False

    def start(self) -> None:
        """Do nothing, because there is no device to open."""

    def stop(self) -> None:
        """End the wait for the time of a frame; there is no thread."""
        self._clock.stop()

    def close(self) -> None:
        """Drop the iteration, and the files that it keeps open; an iterator stays the caller's."""
        if not isinstance(self._source, Iterator):
            self._frames = iter(())
