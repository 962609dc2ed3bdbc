"""Frames that are there already, or that a generator makes, read as a recording is."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Sized
from itertools import islice
from typing import Protocol, runtime_checkable

from manip3d.errors import InputError
from manip3d.rgbd import RgbdCalibration, RgbdFrame

_LATE_S = 0.05  # seconds of real time by which a frame may be late and is still given
_MOST_SEARCH_S = 0.1  # seconds that one read() searches for a frame that is not late


class FrameClock:
    """Tells when frames are due at a playback speed; 0: at once, 1: in real time.

    The clock starts with the first frame.
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._began: tuple[float, int] | None = None

    def late_s(self, time_ns: int) -> float:
        """Return by how much a frame is late, in seconds of the source."""
        speed = self._speed  # another thread may stop the clock in the meantime
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
        """Wait until a frame is due, for at most ``timeout_ms``; return whether it is due."""
        speed = self._speed
        if not speed > 0.0:
            return True
        left = -self.late_s(time_ns) / speed
        time.sleep(min(max(left, 0.0), timeout_ms / 1000.0))
        return left <= timeout_ms / 1000.0

    def stop(self) -> None:
        """Stop the clock: all frames are due at once."""
        self._speed = 0.0


@runtime_checkable
class _Indexed(Protocol):
    def __getitem__(self, index: int, /) -> RgbdFrame: ...


def _length_of(frames: Iterable[RgbdFrame]) -> int | None:
    try:
        return len(frames) if isinstance(frames, Sized) else None
    except TypeError:  # a source whose length nobody knows
        return None


class IteratedFrames:
    """Any iterable of frames; the same interface as the core's sources.

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
