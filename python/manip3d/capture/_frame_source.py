"""Base class of all sources of frames: it waits for frames, iterates over them and ends."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

from manip3d.errors import InputError

Frame = TypeVar("Frame")
_POLL_MS = 100  # longest wait in compiled code; Python handles Ctrl-C between two waits


class ClosedSource:
    """Counts of a source of ``_core`` or of Python that was closed, and no frames.

    It takes the place of the source, so that this is deleted, and closes its files, as soon as no
    other thread reads it.
    """

    def __init__(self, source: Any) -> None:
        self._counters: dict[str, int] = source.counters()
        if hasattr(source, "close"):
            source.close()

    def read(self, timeout_ms: int) -> bool:
        """Return False: there are no more frames."""
        return False

    def counters(self) -> dict[str, int]:
        """Return the numbers that the source had counted when it was closed."""
        return dict(self._counters)

    def stop(self) -> None:
        """Do nothing, because nothing runs."""


class FrameSource(ABC, Generic[Frame]):
    """Base class of sources, which read frames in order from ``_source``.

    ``_source.read(milliseconds)`` returns a frame, a mapping with the fields of a frame, True for
    "not yet" or False for "no more frames", and may be called from any thread. If several threads
    read, each frame goes to one of them. `stop` may be called at any time, from any thread and
    several times: it ends a `read` that waits, and a source that is not live yields no further
    frames. A ``with`` statement closes the source, with its files, sockets and processes: a loop
    that begins afterwards is an error, because it would look like one over an empty recording.
    """

    uri: str
    is_live: bool
    _source: Any
    _has_ended = _is_stopped = _is_closed = False
    _how_to_reopen = "open it again"

    @abstractmethod
    def read(self, timeout: float | None = None) -> Frame | None:
        """Return the next frame, or None."""

    @abstractmethod
    def stop(self) -> None:
        """End a live source's thread."""

    @abstractmethod
    def _to_frame(self, fields: Mapping[str, Any]) -> Frame: ...

    def _wait(self, timeout: float | None) -> Frame | None:
        """Return the next frame; None at the end or after ``timeout`` seconds (None: no limit)."""
        if timeout is not None and not timeout >= 0.0:
            raise InputError(f"timeout: expected seconds >= 0, got {timeout}")
        end = math.inf if timeout is None else time.monotonic() + timeout
        if self._is_stopped and not self.is_live:
            self._has_ended = True
            return None
        while True:
            left_ms = 1000 * (end - time.monotonic())
            found = self._source.read(round(min(max(1, left_ms), _POLL_MS)))
            if isinstance(found, Mapping):
                return self._to_frame(found)
            if not isinstance(found, bool):
                frame: Frame = found
                return frame
            if not found:
                self._has_ended = True
                return None
            if left_ms <= _POLL_MS:
                return None

    def _rewind(self) -> None:
        """Rewind a recording to its first frame, if the source can."""

    def _check_open(self) -> None:
        if self._is_closed:
            raise InputError(f"source: {self.uri} is closed; {self._how_to_reopen}")

    def __iter__(self) -> Iterator[Frame]:
        self._check_open()
        if self._has_ended:
            self._rewind()
        while (frame := self.read()) is not None:
            yield frame

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close()

    def _close(self) -> None:
        self._is_closed = True
        self.stop()
        self._release()

    @abstractmethod
    def _release(self) -> None:
        """Close what the source keeps open; its counts can still be asked for."""

    def __repr__(self) -> str:
        return f"<manip3d.capture.{type(self).__name__}: {self.uri}>"
