"""Faces across depth steps: between a person and the wall behind there is no surface."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from manip3d.errors import InputError
from manip3d.simplify._depth import DepthMesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    AnyDepthMesh = TypeVar("AnyDepthMesh", bound=DepthMesh)

DEPTH_STEP = 0.05
"""Change of depth from one pixel to the next that is no slope any more, as a share of the depth. At
f = 525 pixels a surface would have to be turned by 87.8 degrees (arctan 0.05 f) to show it."""

_BLOCK = 1 << 21  # samples that are looked at together


def cut_depth_steps(
    found: AnyDepthMesh, depth: ArrayLike, *, step: float = DEPTH_STEP
) -> AnyDepthMesh:
    """Leave out the faces that span a step in depth.

    Parameters
    ----------
    found : DepthMesh
        A mesh of ``depth``, of any method.
    depth : (H, W) uint16 or float32
        The image in any unit; 0 and NaN mean no measurement.
    step : float
        A face is left out if, on the way along one of its edges through the image, depth changes
        by more than this share of itself from one measured pixel to the next.

    Returns
    -------
    DepthMesh
        Of the type of ``found``, with all its vertices.

    Raises
    ------
    InputError
        ``step`` is not positive, or a vertex lies outside of the image.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, simplify
    >>> depth = np.full((4, 6), 1000, np.uint16)
    >>> depth[:, 3:] = 2000
    >>> mesh = simplify.dense_mesh(depth, Intrinsics(6, 4, 5.0, 5.0, 2.5, 1.5))
    >>> mesh.num_faces, simplify.cut_depth_steps(mesh, depth).num_faces
    (30, 24)
    """
    if not step > 0:
        raise InputError(f"step: expected > 0, got {step}")
    image = np.nan_to_num(np.asarray(depth, np.float32), posinf=0.0, neginf=0.0)
    pixels = found.pixels
    if len(pixels) and (pixels.min() < 0 or (pixels.max(axis=0) >= image.shape[::-1]).any()):
        raise InputError(f"depth: expected the image of the mesh, got shape {image.shape}")
    if not len(found.triangles):
        return found
    sides = np.sort(found.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    codes, of_side = np.unique(
        sides[:, 0].astype(np.int64) * len(pixels) + sides[:, 1], return_inverse=True
    )
    crosses = _crosses_step(pixels[codes // len(pixels)], pixels[codes % len(pixels)], image, step)
    kept = ~crosses[of_side.reshape(-1, 3)].any(axis=1)
    return replace(found, triangles=np.ascontiguousarray(found.triangles[kept]))


def _crosses_step(
    begin: NDArray[Any], end: NDArray[Any], image: NDArray[np.float32], step: float
) -> NDArray[np.bool_]:
    """For each pair of pixels: whether the depth along the line between them has a step."""
    length = np.abs(end - begin).max(axis=1)
    crosses = np.zeros(len(begin), np.bool_)
    longest = 1
    while True:  # lines of about one length together
        alike = np.flatnonzero((length <= longest) & (length > longest // 2))
        for first in range(0, len(alike), _BLOCK // longest):
            block = alike[first : first + _BLOCK // longest]
            crosses[block] = _has_step(_along(begin[block], end[block], image, longest + 1), step)
        if longest >= length.max():
            return crosses
        longest *= 2


def _along(
    begin: NDArray[Any], end: NDArray[Any], image: NDArray[np.float32], samples: int
) -> NDArray[np.float32]:
    """Depth at each pixel of the lines; shorter ones repeat their last pixel."""
    length = np.maximum(np.abs(end - begin).max(axis=1), 1)[:, None]
    way = np.minimum(np.arange(samples), length)
    u, v = (
        begin[:, axis, None] + (2 * way * (end - begin)[:, axis, None] + length) // (2 * length)
        for axis in (0, 1)
    )
    depths: NDArray[np.float32] = image[v, u]
    return depths


def _has_step(depth: NDArray[np.float32], step: float) -> NDArray[np.bool_]:
    """Whether a row changes by more than ``step`` of itself between two measured samples."""
    last = np.where(depth > 0, np.arange(depth.shape[1]), 0)
    filled = np.take_along_axis(depth, np.maximum.accumulate(last, axis=1), axis=1)
    before, after = filled[:, :-1], filled[:, 1:]
    jump = np.abs(after - before) > step * np.minimum(before, after)
    return np.asarray((jump & (before > 0)).any(axis=1))
