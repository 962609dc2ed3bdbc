"""Faces across depth steps: between a person and the wall behind there is no surface."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.simplify._depth import DenseImage, DepthMesh, DepthSimplification

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

AnyDepthMesh = TypeVar("AnyDepthMesh", bound=DepthMesh)

DEPTH_STEP = 0.05
"""Change of depth from one pixel to the next that is no slope any more, as a share of the depth. At
f = 525 pixels a surface would have to be turned by 87.8 degrees (arctan 0.05 f) to show it."""

_BLOCK = 1 << 21  # samples that are looked at together


@checked
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
        A face is left out if the depth at the ends of one of its edges differs by more than this
        share of itself, and on the way from the one to the other, through the image, changes by
        more than that from one measured pixel to the next: a step, not a slope. What only stands
        in front of an edge, such as one noisy pixel, is no step.

    Returns
    -------
    DepthMesh
        A mesh of the type of ``found``, with all its vertices.

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
    if not 0 < step <= float(np.finfo(np.float32).max):
        raise InputError(f"step: expected > 0 and finite, got {step}")
    image = np.asarray(depth)
    if image.ndim != 2:
        raise InputError(f"depth: expected shape (H, W), got {image.shape}")
    with np.errstate(over="ignore"):  # beyond float32: as infinite as beyond float64
        image = np.nan_to_num(image.astype(np.float32), posinf=0.0, neginf=0.0)
    pixels = found.pixels
    if len(pixels) and (pixels.min() < 0 or (pixels.max(axis=0) >= image.shape[::-1]).any()):
        raise InputError(f"depth: expected the image of the mesh, got shape {image.shape}")
    sides = np.sort(found.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    codes, of_side = np.unique(
        sides[:, 0].astype(np.int64) * len(pixels) + sides[:, 1], return_inverse=True
    )
    crosses = _crosses_step(pixels[codes // len(pixels)], pixels[codes % len(pixels)], image, step)
    kept = ~crosses[of_side.reshape(-1, 3)].any(axis=1)
    cut = found.with_faces(np.ascontiguousarray(found.faces[kept]))
    if isinstance(cut, DepthSimplification) and isinstance(cut.surface, DenseImage):
        cut = replace(cut, surface=replace(cut.surface, depth_step=step))
    return cut


def _crosses_step(
    begin: NDArray[Any], end: NDArray[Any], image: NDArray[np.float32], step: float
) -> NDArray[np.bool_]:
    """For each pair of pixels: whether the depth along the line between them has a step."""
    length = np.abs(end - begin).max(axis=1)
    longest_of_all = length.max(initial=0)  # without faces there are no lines
    crosses = np.zeros(len(begin), np.bool_)
    longest = 1
    while True:  # lines of about one length together
        alike = np.flatnonzero((length <= longest) & (length > longest // 2))
        for first in range(0, len(alike), _BLOCK // longest):
            block = alike[first : first + _BLOCK // longest]
            crosses[block] = _has_step(_along(begin[block], end[block], image, longest + 1), step)
        if longest >= longest_of_all:
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
    """Whether the ends of a row differ, and two of its measured samples in a row do."""
    last = np.where(depth > 0, np.arange(depth.shape[1]), 0)
    filled = np.take_along_axis(depth, np.maximum.accumulate(last, axis=1), axis=1)
    jumps = _differ(filled[:, :-1], filled[:, 1:], step).any(axis=1)
    return np.asarray(jumps & _differ(filled[:, 0], filled[:, -1], step))


def _differ(one: NDArray[np.float32], other: NDArray[np.float32], step: float) -> NDArray[np.bool_]:
    """Whether two measured depths differ by more than ``step`` of the smaller one."""
    return np.asarray((np.abs(one - other) > step * np.minimum(one, other)) & (one > 0))
