"""Select the frames of an RGB-D stream that are judged, and pairs of successive ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice, pairwise
from typing import Protocol, runtime_checkable

import numpy as np

from manip3d._util.checked import checked
from manip3d.rgbd import RgbdFrame, check_frames, numbered

MAX_FRAMES = 60
"""Largest number of frames of a stream that are judged, in runs of six spread over it."""

MIN_PAIRS = 5
"""Fewest pairs of successive frames for judging changes."""


@checked
def judged_frames(frames: Iterable[RgbdFrame]) -> list[RgbdFrame]:
    """Return the frames of a stream that `inspect_stream` judges.

    These are all frames if there are at most `MAX_FRAMES`. Of longer sequences and recordings,
    runs of six frames spread over the whole are returned, and no others are kept in memory; of
    other iterables, the first frames. A recording whose file does not state its length is read once
    before to count its frames.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Frames of the stream; also a recording or a camera of `manip3d.capture.open_rgbd`.

    Returns
    -------
    list of RgbdFrame

    Raises
    ------
    InputError
        ``frames`` holds an item of another type.

    Examples
    --------
    >>> from manip3d import authenticate, simulate
    >>> body = simulate.BodySimulator(seed=0, color="none")
    >>> len(authenticate.judged_frames(body.frame(n / 30) for n in range(3)))
    3
    """
    return frames_to_judge(frames)[0]


def _length_of(frames: Iterable[RgbdFrame]) -> int | None:
    """Return the number of frames; None if they can be read only once, or never end."""
    if isinstance(frames, Sequence):
        return len(frames)
    length: int | None = getattr(frames, "num_frames", None)
    if length is None and isinstance(frames, _Recording) and frames.has_known_end:
        length = sum(1 for _ in frames)
        frames.start()
    return length


@runtime_checkable
class _Recording(Protocol):
    has_known_end: bool

    def start(self) -> None: ...
    def __iter__(self) -> Iterator[RgbdFrame]: ...


def frames_to_judge(frames: Iterable[RgbdFrame]) -> tuple[list[RgbdFrame], bool]:
    """Return the frames that are judged, and whether further frames were left unread.

    Frames without numbers are numbered by their places in the stream.
    """
    length = _length_of(frames)
    has_more = False
    places: Sequence[int] = range(MAX_FRAMES)
    if length is None:
        iterator = iter(frames)
        some = list(islice(iterator, MAX_FRAMES))
        has_more = len(some) == MAX_FRAMES and next(iterator, None) is not None
    elif length <= MAX_FRAMES:
        some = list(frames)
    else:
        run = 6
        starts = np.linspace(0, length - run, MAX_FRAMES // run).astype(int)
        places = sorted({int(start) + i for start in starts for i in range(run)})
        wanted = frozenset(places)
        some = [frame for number, frame in enumerate(frames) if number in wanted]
    check_frames("frames", some)
    return numbered(some, places), has_more


def following(frames: Sequence[RgbdFrame]) -> list[tuple[RgbdFrame, RgbdFrame]]:
    """Pairs of frames with successive numbers; if there are too few, all pairs of neighbours."""
    pairs = list(pairwise(frames))
    numbered = [(a, b) for a, b in pairs if b.number == a.number + 1]
    return numbered if len(numbered) >= MIN_PAIRS else pairs


def changed_shares(before: RgbdFrame, after: RgbdFrame) -> tuple[float, float]:
    """Share of pixels whose measurement disappears, and of those where one appears."""
    a, b = before.depth > 0, after.depth > 0
    return float(np.mean(a & ~b)), float(np.mean(~a & b))


def whole_pairs(frames: Sequence[RgbdFrame]) -> list[tuple[RgbdFrame, RgbdFrame]]:
    """Pairs of `following` without frames that are empty or mostly empty.

    Cameras give such frames when they start or fail.
    """
    return [(a, b) for a, b in following(frames) if max(changed_shares(a, b)) < _MAX_EMPTIED]


_MAX_EMPTIED = 0.1  # share of the pixels; at most 0.04 for a hand-held camera, 0.06 for a filter
