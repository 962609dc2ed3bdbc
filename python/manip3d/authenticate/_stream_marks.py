"""Find the constant with which depth images mark that nothing was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._silhouettes import MIN_SPECKLES, speckles_in
from manip3d.rgbd import NO_MEASUREMENT, RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MIN_SHARE = 0.02
"""Least share of the pixels of all frames that have the constant. Fewer hide no silhouettes."""

_APART = 0.05
"""Depths that are smaller by less than this share of the constant are near it. Depth cameras
resolve 3 % and better at 10 m, so that a surface has several depths within this distance."""

_MAX_OTHERS = 0.01
"""Largest number of pixels with depths near the constant or beyond it, per pixel that has it."""


_MIN_STEPS = 0.5
"""Least share of the pixels beside a constant among other depths that are not near it. Beside a
surface with this depth, hardly any is so."""

_MAX_FRAMES = 6  # whose pixels beside constants are looked at


def without_marks(frames: Sequence[RgbdFrame]) -> tuple[list[RgbdFrame], str]:
    """Return the frames with depth 0 where a constant marks that nothing was measured.

    Marks are `NO_MEASUREMENT`, and another constant if there is one; then the returned remark for
    the verdict's reason names it.
    """
    counts = np.zeros(2**16, np.int64)
    for frame in frames:
        counts += np.bincount(frame.depth.ravel(), minlength=len(counts))
    num_pixels = int(counts.sum())
    is_marked = bool(counts[[0, NO_MEASUREMENT]].any())
    counts[[0, NO_MEASUREMENT]] = 0
    mark = _mark(counts, num_pixels)
    if mark is None and not is_marked:
        mark = _mark_among_depths(frames, counts, num_pixels)
    if mark is None:
        return [_without(frame, NO_MEASUREMENT) for frame in frames], ""
    share = counts[mark] / num_pixels
    remark = f"; depths of {mark} mm, in {share:.0%} of the pixels, count as not measured"
    return [_without(_without(frame, NO_MEASUREMENT), mark) for frame in frames], remark


def _mark(counts: NDArray[np.int64], num_pixels: int) -> int | None:
    """Return the largest depth that many pixels have, if it marks that nothing was measured.

    ``counts`` are the numbers of pixels by depth.
    """
    many = np.flatnonzero(counts >= max(1.0, _MIN_SHARE * num_pixels))
    if not len(many) or np.count_nonzero(counts) == 1:  # a single depth may be of a wall
        return None
    mark = int(many[-1])
    num_others = counts[round(mark * (1.0 - _APART)) :].sum() - counts[mark]
    return mark if num_others < _MAX_OTHERS * counts[mark] else None


def _mark_among_depths(
    frames: Sequence[RgbdFrame], counts: NDArray[np.int64], num_pixels: int
) -> int | None:
    """Return a depth that many pixels have and that marks missing ones in images without others.

    Cameras lose pixels, beside objects most of all, so that the depths beside such a mark are not
    near it, and single ones within surfaces, which tells a mark from a rendered object. An example
    is 2047, the value without a measurement of the Kinect V1. ``counts`` are the numbers of pixels
    by depth.
    """
    many = np.flatnonzero(counts >= max(1.0, _MIN_SHARE * num_pixels))
    some = [frame.depth for frame in frames[:: max(1, len(frames) // _MAX_FRAMES)]]
    best = (_MIN_STEPS, -1)
    for depth in many.tolist() if np.count_nonzero(counts) > 1 else ():
        beside = np.concatenate([_beside(image, depth) for image in some]).astype(np.int64)
        is_step = np.abs(beside - depth) > _APART * depth
        speckles = [speckles_in(np.where(image == depth, np.uint16(0), image)) for image in some]
        if np.mean(speckles) < MIN_SPECKLES:
            continue
        best = max(best, (float(is_step.mean()) if len(beside) else 0.0, depth))
    return best[1] if best[1] > 0 else None


def _beside(image: NDArray[np.uint16], depth: int) -> NDArray[np.uint16]:
    """The other depths to the left and to the right of pixels with a depth."""
    left, right = image[:, :-1], image[:, 1:]
    return np.concatenate(
        [right[(left == depth) & (right != depth)], left[(right == depth) & (left != depth)]]
    )


def _without(frame: RgbdFrame, mark: int) -> RgbdFrame:
    marked = frame.depth == mark
    if not marked.any():
        return frame
    return replace(frame, depth=np.where(marked, np.uint16(0), frame.depth))
