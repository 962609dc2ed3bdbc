"""The vertical of a session: games and page use axes in which it is the y axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import product
from manip3d.modify import DownSource
from manip3d.modify._level import differ, level_rotation, turned_skeleton

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.modify import PhantomFrame
    from manip3d.rgbd import Skeleton

_TRUST = {DownSource.ASSUMED: 0, DownSource.POSTURE: 1, DownSource.FLOOR: 2}


class Level:
    """The vertical in use: along the image's columns until another one is measured.

    Attributes
    ----------
    down : (3,) float64
        The vertical as a unit vector in the camera's frame.
    """

    def __init__(self) -> None:
        self.down: NDArray[np.float64] = np.array([0.0, 1.0, 0.0])
        self._source = DownSource.ASSUMED
        self._rotation: NDArray[np.float64] | None = None  # None: that of a level camera

    def follow(self, shown: PhantomFrame) -> bool:
        """Take over the vertical of a frame if it differs; return whether it was taken over.

        The vertical of a floor is kept where a later frame has only a posture, which is less exact,
        as after a recording is repeated or another limb is chosen.
        """
        if _TRUST[shown.down_source] < max(1, _TRUST[self._source]):
            return False
        self._source = shown.down_source
        if not differ(shown.down, self.down):
            return False
        self.down, self._rotation = shown.down, level_rotation(shown.down)
        return True

    def frame(self, shown: PhantomFrame) -> PhantomFrame:
        """Return a frame in level axes."""
        return shown if self._rotation is None else shown.levelled(self.down)

    def skeleton(self, skeleton: Skeleton) -> Skeleton:
        """Return a skeleton in level axes."""
        return skeleton if self._rotation is None else turned_skeleton(skeleton, self._rotation)

    def in_camera(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places, (N, 3), of the level axes in the camera's frame."""
        return places if self._rotation is None else product(places, self._rotation)
