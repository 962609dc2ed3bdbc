"""Approximation of a person by simple solids for collision tests in games: `ColliderTracker`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.rgbd import Skeleton

TORSO = 0
"""Value of `Hits.bone` if the torso's box was hit."""


@dataclass(frozen=True, eq=False)
class BodyColliders:
    """The solids of one person in one frame; metres, camera frame.

    Attributes
    ----------
    start, end : (25, 3) float32
        End points of the capsule's axis, by bone. The axis of bone 3 is a single point, the centre
        of the head's sphere.
    radius : (25,) float32
        Radius of each capsule; 0 for bones without one: bone 0, bones of the torso, and bones that
        are not tracked.
    torso_centre : (3,) float32
        Centre of the torso's box.
    torso_axes : (3, 3) float32
        Unit axes of the box as columns: towards the person's left, up, and ahead.
    torso_half_size : (3,) float32
        Half the extent of the box along each axis; 0: the torso is not tracked.
    """

    start: NDArray[np.float32]
    end: NDArray[np.float32]
    radius: NDArray[np.float32]
    torso_centre: NDArray[np.float32]
    torso_axes: NDArray[np.float32]
    torso_half_size: NDArray[np.float32]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Hits:
    """First contact of each of N targets with a person.

    Attributes
    ----------
    time : (N,) float64
        Time of the contact, 0 at the previous frame and 1 at the current one; NaN: no contact.
    bone : (N,) int8
        Bone of the capsule that was touched, or `TORSO`; -1: no contact.
    point : (N, 3) float32
        Centre of the target at that time, metres; NaN: no contact.
    """

    time: NDArray[np.float64]
    bone: NDArray[np.int8]
    point: NDArray[np.float32]

    __repr__ = short_repr


def _colliders(
    capsules: NDArray[np.float32],
    centre: NDArray[np.float32],
    axes: NDArray[np.float32],
    half_size: NDArray[np.float32],
) -> BodyColliders:
    return BodyColliders(
        start=capsules[:, :3],
        end=capsules[:, 3:6],
        radius=capsules[:, 6],
        torso_centre=centre,
        torso_axes=axes,
        torso_half_size=half_size,
    )


@checked
class ColliderTracker:
    """Follows a person's colliders: a capsule per bone, a box for the torso, a sphere for the head.

    Parameters
    ----------
    percentile : float
        Share of a bone's points in one frame that lie within its radius, in (0, 1]: a share, and
        not a number up to 100. The default leaves out the tenth that is farthest from the bone,
        such as folds of clothes and points of a neighbouring limb.
    frames : int
        Number of frames over which a radius is averaged; 1 to 1000. The default is one second of a
        camera with 30 frames a second.
    min_points : int
        Smallest number of points of a bone from which a frame's radius is measured. With the
        default, the tenth that ``percentile`` leaves out has at least two points.
    min_radius, max_radius : float, metres
        Bounds that radii are clamped to; ``max_radius`` is at most 0.25. The defaults are about the
        radius of a wrist, and twice that of a thigh, for wide clothes.
    first_radius : float, metres
        Radius of a bone until points of it, or of the same bone on the other side, are seen. The
        default is about the radius of a forearm.

    Raises
    ------
    InputError
        An option out of range.
    """

    def __init__(
        self,
        *,
        percentile: float = 0.9,
        frames: int = 30,
        min_points: int = 20,
        min_radius: float = 0.03,
        max_radius: float = 0.20,
        first_radius: float = 0.05,
    ) -> None:
        self._core = _core.ColliderTracker(
            percentile=percentile,
            frames=frames,
            min_points=min_points,
            min_radius=min_radius,
            max_radius=max_radius,
            first_radius=first_radius,
        )

    def update(
        self,
        skeleton: Skeleton,
        labels: ArrayLike | None = None,
        squared_distances: ArrayLike | None = None,
    ) -> BodyColliders:
        """Return the colliders of the next frame.

        Parameters
        ----------
        skeleton : Skeleton
            The person in this frame.
        labels : (N,) uint8, optional
            Nearest bone of each of the person's points.
        squared_distances : (N,) float32, optional
            Squared distance of each point to its bone, square metres.

        Returns
        -------
        BodyColliders
            The solids in this frame; radii are averages over the last frames.

        Raises
        ------
        InputError
            One of the two arrays is missing, a label is not a byte, or the lengths differ.
        """
        if (labels is None) != (squared_distances is None):
            raise InputError("labels, squared_distances: expected both or neither")
        bones = rows([] if labels is None else labels, None, np.uint8, "labels")
        with np.errstate(over="ignore"):  # a value too large for float32 becomes infinity
            squares = rows(
                [] if squared_distances is None else squared_distances,
                None,
                np.float32,
                "squared_distances",
            )
        return _colliders(*self._core.update(skeleton, bones, squares))

    @property
    def colliders(self) -> BodyColliders:
        """The solids of the last frame."""
        return _colliders(*self._core.now())

    def hits(self, start: ArrayLike, end: ArrayLike, *, radius: ArrayLike = 0.0) -> Hits:
        """Find what moving spheres touch first between the last two frames.

        The detection is continuous in time: fast motion does not tunnel. After a single `update`
        the person stands still; before it, and after `reset`, nothing is touched.

        Parameters
        ----------
        start, end : (N, 3), metres
            Centres of the spheres at the previous and at the current frame. A centre with NaN
            touches nothing.
        radius : float or (N,), metres
            Radii of the spheres; 0: points. A sphere whose radius is NaN touches nothing.

        Returns
        -------
        Hits
            The first contact of each sphere.

        Raises
        ------
        InputError
            Wrong shapes, or a negative radius.
        """
        first = rows(start, 3, np.float32, "start")
        last = rows(end, 3, np.float32, "end")
        with np.errstate(over="ignore"):  # a value too large for float32 becomes infinity
            radii = np.asarray(radius, np.float32)
        negative = radii[radii < 0.0]
        if negative.size:
            raise InputError(f"radius: expected numbers >= 0, got {negative[0]:g}")
        if radii.ndim == 0:
            radii = np.full(len(first), radii)
        return Hits(*self._core.first_hits(first, last, np.ascontiguousarray(radii)))

    def reset(self) -> None:
        """Discard all measurements, for another person."""
        self._core.reset()
