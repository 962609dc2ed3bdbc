"""Find where the rows of a depth image pass from one surface to another."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]
    Places = NDArray[np.intp]

RELIEF = 0.25
"""Depth step as a share of the depth, at which a camera's shadow is several pixels wide."""

_SMOOTH = 0.05  # largest difference of neighbouring pixels of one surface, as a share of the depth
_MAX_GAP = 32  # pixels; what is missing over more of them is a surface rather than a silhouette


def passages(depth: NDArray[np.uint16]) -> tuple[Places, Places, Places]:
    """Return the passages between surfaces whose depths differ by more than `RELIEF`.

    A surface is three or more pixels that follow smoothly. Between both there may be missing pixels
    and mixed depths.

    Returns
    -------
    row, last, first : (N,) intp
        Row, last column of the surface on the left, first column of the one on the right. These are
        neighbours if the passage is sharp.
    """
    width = depth.shape[1]
    if width < 3:
        nothing = np.zeros(0, np.intp)
        return nothing, nothing, nothing
    z = depth.astype(np.int32)
    is_joined = _joined(z)
    begins, ends = _runs(is_joined)
    begin, end = (np.flatnonzero(each) for each in (begins, ends))
    following = np.searchsorted(begin, end, side="right")
    end, following = end[following < len(begin)], following[following < len(begin)]
    begin = begin[following]
    near, far = np.sort([z.ravel()[end], z.ravel()[begin]], axis=0)
    is_passage = (
        (end // width == begin // width)
        & (begin - end <= _MAX_GAP + 1)
        & (far - near > RELIEF * near)
    )
    end, begin = end[is_passage], begin[is_passage]
    return end // width, end % width, begin % width


def _joined(z: NDArray[np.int32]) -> Mask:
    """Whether each pixel is measured and continues smoothly in the next one of its row."""
    a, b = z[:, :-1], z[:, 1:]
    nearer = np.minimum(a, b)
    joined = (nearer > 0) & (np.abs(a - b) <= _SMOOTH * nearer)
    return np.pad(joined, ((0, 0), (0, 1)))


def _runs(is_joined: Mask) -> tuple[Mask, Mask]:
    """The first and the last pixels of runs of at least three joined pixels."""
    padded = np.pad(is_joined, ((0, 0), (2, 1)))
    before_last, before, here, after = (padded[:, k : k + is_joined.shape[1]] for k in range(4))
    return ~before & here & after, before_last & before & ~here
