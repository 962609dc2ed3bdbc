"""Recognise that whole depth images went through a filter, by the shape and duration of holes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._stream_frames import whole_pairs
from manip3d.rgbd import RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]

_MAX_FRAMES = 12  # whose holes are looked at
_NARROW, _WIDE = 3, 9  # pixels
_MIN_STRIPS = 500  # pixels of strips between holes; fewer are no evidence
_MIN_EVENTS = 100  # pixels that appear or disappear from frame to frame; fewer are no evidence
_MIN_STEPS = 3  # of three or four successive frames

_MIN_NARROW = 0.03
"""Least number of measured pixels in strips between holes that are narrower than three pixels, per
pixel of strips that are three to eight pixels wide. It is 0.052 and more on the recordings on which
it was chosen (the first ten frames of the red kitchen of 7-Scenes, the first half of the turning
person, TUM's desk), 0.083 and more on forged streams before the first two (UTD-MHAD's subjects 1 to
4) and on simulated ones. Filters that fill holes from windows of 3 x 3 pixels or more leave no
narrow strip: 0.018 at most if pixels are lost afterwards."""

_MIN_FINE = 0.18
"""Least sum of this number for strips and for holes, in which measured and missing pixels change
places. Medians that take missing pixels for depth 0 smooth the outlines of both. It is 0.235 and
more in frames that were measured one by one (the red kitchen, the turning person and the wall
behind, TUM's desk, single frames of NYU, SUN and TUM, UTD-MHAD, a RealSense D435), and 0.148 at
most after medians of 5 x 5 to 9 x 9 pixels; those of 3 x 3 leave 0.11 to 0.32."""

_LOST_SOON, _LOST_SHORTLY = 0.01, 0.8
"""Share of the pixels that are missing again one frame after they appeared, or two, and share of
the lost pixels that are back in the next frame. The lesser of the first two is at least 0.028 on
the same streams; it is 0.005 at most after a filter that keeps the depth of missing pixels if one
of the last frames measured them, or two of the last three or eight. The third share is 0.65 at most
after these filters. A camera that seldom loses pixels, and at random, has small first shares, but
gets nearly all of the lost pixels back."""


def filter_trace(frames: Sequence[RgbdFrame], accused: Mask) -> str | None:
    """Return what a filter left in the images away from the accused objects; None: nothing.

    Parameters
    ----------
    frames : sequence of RgbdFrame
        Judged frames.
    accused : (T, H, W) bool
        Pixels of objects with sharp silhouettes, which are not looked at: a filter of the whole
        image shows elsewhere, too.
    """
    step = max(1, len(frames) // _MAX_FRAMES)
    looked_at = [
        (_measured(frame), ~mask)
        for frame, mask in zip(frames[::step], accused[::step], strict=True)
    ]
    narrow, strips = np.sum([_strips(seen, elsewhere) for seen, elsewhere in looked_at], axis=0)
    if strips >= _MIN_STRIPS and narrow < _MIN_NARROW * strips:
        return (
            "hardly a strip of measured pixels between holes is narrower than three pixels: holes"
            " were filled from windows"
        )
    small, holes = np.sum([_strips(~seen, elsewhere) for seen, elsewhere in looked_at], axis=0)
    if min(strips, holes) >= _MIN_STRIPS and narrow / strips + small / holes < _MIN_FINE:
        return (
            "hardly a hole, or a strip between holes, is narrower than three pixels: outlines were"
            " smoothed by a median"
        )
    return _slow_changes(frames, np.asarray(accused.any(axis=0)))


def _measured(frame: RgbdFrame) -> Mask:
    """The measured pixels, and missing ones that stand alone, which may be lost after a filter."""
    measured = frame.depth > 0
    inner = measured[1:-1, 1:-1]
    inner |= _around(measured) == 8
    return measured


def _strips(measured: Mask, elsewhere: Mask) -> tuple[int, int]:
    """Count measured pixels of strips between holes, without a margin at the image's border.

    Returned are those of strips narrower than `_NARROW` pixels, and of others narrower than
    `_WIDE`.
    """
    if min(measured.shape) <= 2 * _WIDE:
        return 0, 0
    counted = _cropped(measured & elsewhere, _WIDE)
    in_wide, in_narrow = (
        _cropped(_opened(measured, side), _WIDE - side + 1) for side in (_WIDE, _NARROW)
    )
    return int((counted & ~in_narrow).sum()), int((counted & in_narrow & ~in_wide).sum())


def _opened(mask: Mask, side: int) -> Mask:
    """The pixels that lie in a square of ``side`` true pixels.

    The image returned is smaller by ``side - 1`` pixels at each border.
    """
    squares = _over_rows(_over_rows(mask, side, np.logical_and).T, side, np.logical_and)
    return _over_rows(_over_rows(squares, side, np.logical_or).T, side, np.logical_or)


def _over_rows(mask: Mask, side: int, combine: np.ufunc) -> Mask:
    """All or any of each ``side`` successive rows."""
    num_rows = len(mask) - side + 1
    return np.asarray(combine.reduce([mask[k : k + num_rows] for k in range(side)]))


def _cropped(mask: Mask, margin: int) -> Mask:
    return mask[margin : mask.shape[0] - margin, margin : mask.shape[1] - margin]


def _around(mask: Mask) -> NDArray[np.uint8]:
    """Number of true pixels in each 3 x 3 neighbourhood, without the pixels at the border."""
    height, width = mask.shape
    count = np.zeros((max(height - 2, 0), max(width - 2, 0)), np.uint8)
    for v, u in np.ndindex(3, 3):
        count += mask[v : v + count.shape[0], u : u + count.shape[1]]
    return count


def _slow_changes(frames: Sequence[RgbdFrame], accused: Mask) -> str | None:
    """Whether pixels that appear stay, and pixels that are lost stay lost, as filters in time do.

    At the rims of holes, a camera measures pixels in one frame and loses them in the next. Medians
    over time leave out what happens once, as when a scene or a forgery begins.
    """
    steps = [_changes(*masks) for masks in _successive(frames, accused)]
    soon, later, back = (_typical_share([step[k] for step in steps]) for k in range(3))
    if back is not None and back >= _LOST_SHORTLY:
        return None
    for share, when in ((soon, "in the next frame"), (later, "two frames later")):
        if share is not None and share < _LOST_SOON:
            told = f"{share:.1%} of the pixels that appear are lost {when}"
            return f"{told}: missing ones kept their depth"
    return None


def _changes(a: Mask, b: Mask, c: Mask, d: Mask | None = None) -> NDArray[np.int64]:
    """Count pixels in three or four successive frames; each row holds a part and its whole.

    The rows: of pixels that appear, those lost in the next frame; of those that are measured twice,
    those lost then; of pixels that are lost, those that are back in the next frame.
    """
    appears, is_lost = ~a & b, a & ~b
    stays = appears & c
    nothing = np.zeros((1, 1), np.bool_)
    later = (nothing, nothing) if d is None else (stays & ~d, stays)
    rows = ((appears & ~c, appears), later, (is_lost & c, is_lost))
    return np.array([[np.count_nonzero(each) for each in row] for row in rows])


def _typical_share(steps: Sequence[NDArray[np.int64]]) -> float | None:
    """The median of the shares over steps; None if there are too few pixels or steps."""
    told = np.array([step for step in steps if step[1] > 0]).reshape(-1, 2)
    if len(told) < _MIN_STEPS or np.median(told[:, 1]) < _MIN_EVENTS:
        return None
    return float(np.median(told[:, 0] / told[:, 1]))


def _successive(frames: Sequence[RgbdFrame], accused: Mask) -> list[list[Mask]]:
    """Masks of measured pixels of three or four successive frames, from each frame on.

    Frames that are shown again are left out.
    """
    runs: list[list[Mask]] = []
    last = None
    for before, after in whole_pairs(frames):
        if last is None or before is not last:
            runs.append([_measured(before) & ~accused])
        if not np.array_equal(before.depth, after.depth):
            runs[-1].append(_measured(after) & ~accused)
        last = after
    return [run[k : k + 4] for run in runs for k in range(len(run) - 2)]
