"""Removal of faces across depth steps, as between a person and the wall behind."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeGuard, TypeVar

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d.camera import depth_array
from manip3d.errors import InputError
from manip3d.simplify._depth import DenseImage, DepthMesh, DepthSimplification
from manip3d.simplify._relief import OffSurface, Relief

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    from manip3d.camera import Intrinsics
    from manip3d.simplify._depth import DenseGrid

AnyDepthMesh = TypeVar("AnyDepthMesh", bound=DepthMesh)

DEPTH_STEP = 0.05
"""Relative change of depth between neighbouring pixels above which they belong to two surfaces. At
f = 525 pixels a single surface would need a slope of 87.8 degrees (arctan 0.05 f) for it."""

_TAN_78 = math.tan(math.radians(78))
_NOISE_AT_1_M = 1.425e-3  # metres, standard deviation; the same as in DepthStepOptions
_MAX_OFF = 0.25  # share of a face's pixels; the same as kMaxOff in relief/coverage.cpp
_BLOCK = 1 << 21  # samples that are processed together


@checked
def cut_depth_steps(
    found: AnyDepthMesh,
    depth: ArrayLike,
    *,
    step: float = DEPTH_STEP,
    intrinsics: Intrinsics | None = None,
) -> AnyDepthMesh:
    """Leave out the faces that span a step in depth.

    Parameters
    ----------
    found : DepthMesh
        A mesh of ``depth``, of any method.
    depth : (H, W) uint16 or float32
        The depth image. If the camera is known, uint16 is in millimetres and float32 in metres; if
        not, any unit may be used. 0 and NaN mean no measurement.
    step : float
        Relative change of depth above which neighbouring pixels are separated by a step; see Notes.
    intrinsics : Intrinsics, optional
        The camera. Default: the camera of ``found`` if ``found`` is a `DepthSimplification`;
        otherwise ``step`` alone decides.

    Returns
    -------
    DepthMesh
        A mesh of the same type and with the same vertices as ``found``, but without those faces.

    Raises
    ------
    InputError
        ``depth`` has another shape or dtype, ``step`` is not positive, or a vertex lies outside of
        the image.

    Notes
    -----
    If the camera is known, a step must also exceed the change between neighbouring pixels on a
    surface inclined by 78 degrees to the image plane plus three standard deviations of a Kinect's
    noise: z / f tan 78 degrees + 3 * 0.0014 z^2 (metres; z: depth, f: focal length in pixels).
    This matters for coarse images, in which a floor changes by more than 5 percent per pixel.

    A face is left out if the depths at the ends of one of its edges differ by a step and, on the
    line between them in the image, two consecutive measured pixels also differ by a step. An object
    in front of an edge, such as one noisy pixel, is therefore not a step.

    In a `Relief` with ``depth_step``, steps are already boundaries, and a long edge may pass behind
    an object. A face of such a relief is left out only if two conditions hold: along one of its
    edges the signed sum of the steps is more than half of the difference between the ends, and more
    than a quarter of the measured pixels over the face, without its corners, lie a step in front of
    it or behind it.

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
    image = depth_array(depth)
    if intrinsics is None and isinstance(found, DepthSimplification):
        focal = found.surface.focal
    else:
        focal = 0.0 if intrinsics is None else min(intrinsics.fx, abs(intrinsics.fy))
    known = _known_off(found, image, step, focal)
    if known is not None:
        return _without_known(found, known)
    return _without_crossing(found, image, step, focal)


def _without_known(found: AnyDepthMesh, known: OffSurface) -> AnyDepthMesh:
    """Leave out the faces that a relief has found across steps when it was made."""
    cut = found.with_faces(np.ascontiguousarray(found.faces[~known.faces]))
    return replace(cut, cover=known.cover) if isinstance(cut, DepthSimplification) else cut


def _without_crossing(
    found: AnyDepthMesh, image: NDArray[Any], step: float, focal: float
) -> AnyDepthMesh:
    """Leave out the faces of any mesh that span a step of the image."""
    metres = 1e-3 if image.dtype == np.uint16 else 1.0
    with np.errstate(over="ignore"):  # a depth too large for float32 counts as infinite
        image = np.nan_to_num(image.astype(np.float32), posinf=0.0, neginf=0.0)
    rule = StepRule.of(step, focal, metres)
    pixels = found.pixels
    if len(pixels) and (pixels.min() < 0 or (pixels.max(axis=0) >= image.shape[::-1]).any()):
        raise InputError(f"depth: expected the image of the mesh, got shape {image.shape}")
    surface = found.surface.grid if _has_boundaries(found) else None
    kept = ~across_steps(found.faces, pixels, image, rule, surface)
    cut = found.with_faces(np.ascontiguousarray(found.faces[kept]))
    if isinstance(cut, DepthSimplification) and isinstance(cut.surface, DenseImage):
        cut = replace(cut, surface=replace(cut.surface, depth_step=step))
    return cut


@dataclass(frozen=True)
class StepRule:
    """Rule for the change of depth that is a step, in the unit of the image.

    A step at depth z is a change above z max(``step``, ``slope`` + ``noise`` z).
    """

    step: float
    slope: float = 0.0
    noise: float = 0.0

    @staticmethod
    def of(step: float, focal: float, metres: float = 1.0) -> StepRule:
        """Make a rule; ``focal`` 0: no camera is known; ``metres``: metres per unit of depth."""
        if focal == 0:
            return StepRule(step)
        return StepRule(step, _TAN_78 / focal, 3 * _NOISE_AT_1_M * metres)

    def differ(self, one: NDArray[np.float32], other: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Return whether two measured depths differ by a step."""
        nearest = np.minimum(one, other).astype(np.float64)
        with np.errstate(over="ignore"):  # a very large ``step`` may overflow to infinity
            limit = nearest * np.maximum(self.step, self.slope + self.noise * nearest)
        return np.asarray((np.abs(one - other) > limit) & (one > 0))


def _known_off(
    found: DepthMesh, image: NDArray[Any], step: float, focal: float
) -> OffSurface | None:
    """Return the faces across steps that a relief has stored, if image and rule are the same."""
    if not (isinstance(found, Relief) and isinstance(found.surface, DenseImage)):
        return None
    own = found.surface
    has_same_unit = (image.dtype == np.uint16) == (own.depth.dtype == np.uint16)
    is_same_rule = has_same_unit and (step, focal) == (own.depth_step, own.focal)
    has_nan = own.depth.dtype.kind == "f"
    if not is_same_rule or not np.array_equal(image, own.depth, equal_nan=has_nan):
        return None
    return found._off


def _has_boundaries(found: DepthMesh) -> TypeGuard[Relief]:
    """Return whether the mesh already has its boundaries at depth steps."""
    return isinstance(found, Relief) and math.isfinite(found.surface.depth_step)


def across_steps(
    faces: NDArray[np.int32],
    pixels: NDArray[np.int32],
    image: NDArray[np.float32],
    rule: StepRule,
    surface: DenseGrid | None,
) -> NDArray[np.bool_]:
    """Return which faces span a step.

    ``surface`` is the dense surface of a mesh whose boundaries are steps; None: another mesh.
    """
    corners = np.ascontiguousarray(faces, np.int32)
    places = np.ascontiguousarray(pixels, np.int32)
    crosses = _core.faces_across_steps(
        np.ascontiguousarray(image),
        places,
        corners,
        rule.step,
        rule.slope,
        rule.noise,
        surface is not None,
    ).view(np.bool_)
    if surface is None or not crosses.any():
        return np.asarray(crosses)
    off = share_off(np.ascontiguousarray(corners[crosses]), places, surface)
    crosses[crosses] = (off < 0) | (off > _MAX_OFF)
    return np.asarray(crosses)


def share_off(
    corners: NDArray[np.int32], pixels: NDArray[np.int32], surface: DenseGrid
) -> NDArray[np.float32]:
    """Return the share of each face's pixels, without its corners, that lie a step off the surface.

    Negative: unknown, because most of the pixels have no surface.
    """
    share: NDArray[np.float32] = _core.faces_off_surface(
        surface.points,
        surface.valid,
        np.ascontiguousarray(pixels, np.int32),
        corners,
        surface.max_edge,
        surface.depth_step,
        surface.focal,
    )
    return share


def across_gaps(
    faces: NDArray[np.int32],
    pixels: NDArray[np.int32],
    points: NDArray[np.float32],
    valid: NDArray[np.bool_],
    max_edge: float,
) -> NDArray[np.bool_]:
    """Return which faces join surfaces that no chain of dense edges up to ``max_edge`` connects.

    An object in front of an edge is ignored, because the leaps to it and back cancel out.
    """
    codes, of_side = _sides(faces, len(pixels))
    begin, end = pixels[codes // len(pixels)], pixels[codes % len(pixels)]
    joins = np.zeros(len(codes), np.bool_)
    for block, samples in _lines(begin, end):
        u, v = _on_line(begin[block], end[block], samples)
        joins[block] = _leaps(u, v, points, valid, max_edge)
    return np.asarray(joins[of_side.reshape(-1, 3)].any(axis=1))


def _leaps(
    u: NDArray[Any],
    v: NDArray[Any],
    points: NDArray[np.float32],
    valid: NDArray[np.bool_],
    max_edge: float,
) -> NDArray[np.bool_]:
    """Return whether the leaps along each row of pixels add up to more than ``max_edge``."""
    last = np.maximum.accumulate(np.where(valid[v, u], np.arange(u.shape[1]), 0), axis=1)
    u, v = np.take_along_axis(u, last, axis=1), np.take_along_axis(v, last, axis=1)
    between = np.diff(points[v, u].astype(np.float64), axis=1)
    # A diagonal step counts as two dense edges.
    edges = np.abs(np.diff(u, axis=1)) + np.abs(np.diff(v, axis=1))
    is_leap = np.linalg.norm(between, axis=2) > max_edge * edges
    leaps = np.where(is_leap[..., None], between, 0.0).sum(axis=1)
    return np.asarray(np.linalg.norm(leaps, axis=1) > max_edge)


def _sides(faces: NDArray[np.int32], num_pixels: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
    """Return each distinct edge as one number, and the index of the edge of each face's side."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(sides[:, 0].astype(np.int64) * num_pixels + sides[:, 1], return_inverse=True)


def _lines(begin: NDArray[Any], end: NDArray[Any]) -> Iterator[tuple[NDArray[np.intp], int]]:
    """Yield blocks of lines of similar length, and the number of pixels of the longest."""
    length = np.abs(end - begin).max(axis=1)
    longest_of_all = length.max(initial=0)  # a mesh without faces has no lines
    longest = 1
    while True:
        alike = np.flatnonzero((length <= longest) & (length > longest // 2))
        for first in range(0, len(alike), _BLOCK // longest):
            yield alike[first : first + _BLOCK // longest], longest + 1
        if longest >= longest_of_all:
            return
        longest *= 2


def _on_line(
    begin: NDArray[Any], end: NDArray[Any], samples: int
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return u and v of the pixels of each line; shorter lines repeat their last pixel."""
    length = np.maximum(np.abs(end - begin).max(axis=1), 1)[:, None]
    way = np.minimum(np.arange(samples), length)
    u, v = (
        begin[:, axis, None] + (2 * way * (end - begin)[:, axis, None] + length) // (2 * length)
        for axis in (0, 1)
    )
    return u, v
