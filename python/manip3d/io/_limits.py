"""Limits of the bytes, points and seconds that reading a file may take, see `ReadLimits`."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass

from manip3d._util.checked import checked
from manip3d.errors import FormatError, InputError

_IN_FORCE: ContextVar[tuple[ReadLimits, ...]] = ContextVar("limits of readers", default=())


@checked
@dataclass(frozen=True)
class ReadLimits:
    """Limits of every reader of `manip3d.io` within a ``with`` block.

    They hold for meshes, scenes, scans, depth images and motions. A file that exceeds one of them
    is refused with a `FormatError` that names the file and the limit. Blocks may be nested: all
    their limits hold. They hold in the thread, or asyncio task, that entered the block, and in the
    worker processes of a `manip3d.batch.run` within it. For a LiDAR recording
    (`manip3d.capture.open_lidar`), which is read frame by frame, ``max_bytes`` limits the whole
    recording, and ``max_points`` has no effect.

    Parameters
    ----------
    max_bytes : int, optional
        Largest number of uncompressed bytes of a file. Like the argument ``max_bytes`` of a reader,
        it replaces the limit on the expansion of compressed files.
    max_points : int, optional
        Largest number of points of all scans of a file, of vertices of a mesh or of a scene, of
        pixels of a depth image, or of joints times frames of a motion. It is checked before reading
        if the header states the number, else after reading; until then ``max_bytes`` limits the
        memory.
    max_seconds : float, optional
        Longest time in seconds that one call of a reader may take, including the download of a URL.
        The readers in ``_core`` check the time ten times per second. For formats that other
        libraries read (LAS, LAZ, E57, images), and for downloads, it is checked at the end.

    Raises
    ------
    InputError
        A limit is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io
    >>> np.zeros((1000, 4), np.float32).tofile("scan.bin")
    >>> with io.ReadLimits(max_points=100, max_seconds=5):
    ...     io.read_scan("scan.bin")
    Traceback (most recent call last):
    manip3d.errors.FormatError: scan.bin: 1000 points, more than max_points = 100
    """

    max_bytes: int | None = None
    max_points: int | None = None
    max_seconds: float | None = None

    def __post_init__(self) -> None:
        for name in ("max_bytes", "max_points", "max_seconds"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InputError(f"{name}: expected > 0, got {value}")

    def __enter__(self) -> ReadLimits:
        """Put the limits in force."""
        _IN_FORCE.set((*_IN_FORCE.get(), self))
        return self

    def __exit__(self, *_: object) -> None:
        """Return to the limits that were in force before."""
        _IN_FORCE.set(_IN_FORCE.get()[:-1])  # nested blocks end in reverse order


def limits_in_force() -> tuple[ReadLimits, ...]:
    """Return the limits of the ``with`` blocks around the caller, the outermost first."""
    return _IN_FORCE.get()


@contextlib.contextmanager
def all_in_force(limits: Iterable[ReadLimits]) -> Iterator[None]:
    """Put several limits in force, for example those of a parent process."""
    with contextlib.ExitStack() as blocks:
        for each in limits:
            blocks.enter_context(each)
        yield


def byte_limit(max_bytes: int | None) -> int:
    """Return the largest number of uncompressed bytes of a file, as an argument for ``_core``.

    0 means no such limit; ``_core`` then limits the expansion ratio of compressed files.

    Raises
    ------
    InputError
        ``max_bytes`` is not positive.
    """
    if max_bytes is not None and not max_bytes > 0:
        raise InputError(f"max_bytes: expected > 0, got {max_bytes}")
    known = [max_bytes, *(limits.max_bytes for limits in _IN_FORCE.get())]
    return int(min((each for each in known if each is not None), default=0))


def check_points(num_points: int, file: str) -> None:
    """Refuse a file of more points than `ReadLimits` allow.

    Raises
    ------
    FormatError
        The file has more points than one of the limits in force.
    """
    for limits in _IN_FORCE.get():
        if limits.max_points is not None and num_points > limits.max_points:
            raise FormatError(
                f"{num_points} points, more than max_points = {limits.max_points}", file=file
            )


@contextlib.contextmanager
def clock(file: str) -> Iterator[Callable[[float], None] | None]:
    """Yield a progress callback that raises when one read exceeds the time limit.

    It is None if no time limit is in force. The time is also checked when the block ends.

    Raises
    ------
    FormatError
        Reading took more than ``max_seconds``.
    """
    seconds = [each.max_seconds for each in _IN_FORCE.get() if each.max_seconds is not None]
    if not seconds:
        yield None
        return
    most, start = min(seconds), time.monotonic()

    def look(_: float) -> None:
        if time.monotonic() - start > most:
            raise FormatError(f"reading takes more than max_seconds = {most:g}", file=file)

    yield look
    look(1.0)
