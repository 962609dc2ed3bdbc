"""Measurements for games of the legs: the foot by its shoe cover, and places for targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from manip3d import _core
from manip3d._util.checked import checked
from manip3d.rgbd import RgbdFrame, Skeleton

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Side = Literal["left", "right"]


@checked
class ShoeCoverTracker:
    """Finds a foot by the blue cover of its shoe, whose small movements no sensor's joints show.

    The pixels within reach of the ankle whose colour is blue, the largest 8-connected patch of
    them, and its median by coordinate. Nothing else that is blue should be near by.

    Parameters
    ----------
    hue : pair of int
        Least and largest, 0 to 179 (OpenCV's units).
    min_saturation, min_value : int
        0 to 255.
    reach : float, metres
        Around the ankle.
    min_pixels : int
        A smaller patch is not a foot.

    Raises
    ------
    InputError
        An option out of range.
    """

    def __init__(
        self,
        *,
        hue: tuple[int, int] = (100, 130),
        min_saturation: int = 90,
        min_value: int = 40,
        reach: float = 0.35,
        min_pixels: int = 40,
    ) -> None:
        self._core = _core.ShoeCoverTracker(
            hue=hue,
            min_saturation=min_saturation,
            min_value=min_value,
            reach=reach,
            min_pixels=min_pixels,
        )

    def update(self, frame: RgbdFrame, skeleton: Skeleton, side: Side) -> Skeleton | None:
        """The skeleton with its foot where the cover is, tracked; None: no ankle, or no cover.

        Parameters
        ----------
        frame : RgbdFrame
            With colour, in the depth image's pixels or registered.
        skeleton : Skeleton
        side : {'left', 'right'}
            Side of the foot.

        Raises
        ------
        InputError
            The frame has no colour; another side.
        """
        fields = self._core.update(frame, skeleton, side == "left")
        return None if fields is None else Skeleton(**fields)

    @property
    def num_pixels(self) -> int:
        """Size of the largest patch found last."""
        return int(self._core.num_pixels)


@dataclass(frozen=True, eq=False)
class Placement:
    """Positions of two targets that a seated person's feet can reach.

    Attributes
    ----------
    knee_height : float, metres
        From ankle to knee.
    reach : float, metres
        From the hip centre to where a foot gets.
    left, right : (3,) float32, metres
        The targets, camera frame.
    stable_frames : int
        For which the person has kept still.
    frozen : bool
        It does not change any more.
    """

    knee_height: float
    reach: float
    left: NDArray[np.float32]
    right: NDArray[np.float32]
    stable_frames: int
    frozen: bool


@checked
class PlacementEstimator:
    """Places targets by the person's knee height, while it is being estimated.

    Knee height alone is measured, on the intact leg: a thigh that points at the camera is not.
    From the hip to the sole legs measure 0.491 / 0.246 times as much (Drillis & Contini, "Body
    segment parameters", 1966). All is a mean since the person last moved.

    Parameters
    ----------
    share : float
        Share of the reach at which targets stand; (0, 1].
    spread : float
        Sine of the angle between straight ahead and each target; [0, 1).
    stable_frames : int
        Number of frames in a row within ``tolerance`` after which the placement is frozen.
    tolerance : float, metres
        How far knee height and hip centre may be from their running means; beyond, the means start
        anew.

    Raises
    ------
    InputError
        An option out of range.
    """

    def __init__(
        self,
        *,
        share: float = 0.9,
        spread: float = 0.35,
        stable_frames: int = 60,
        tolerance: float = 0.02,
    ) -> None:
        self._core = _core.PlacementEstimator(
            share=share, spread=spread, stable_frames=stable_frames, tolerance=tolerance
        )

    def update(self, skeleton: Skeleton, intact: Side) -> Placement | None:
        """Return the placement after one more frame; None: knee, ankle or torso were never tracked.

        Parameters
        ----------
        skeleton : Skeleton
            The person in this frame.
        intact : {'left', 'right'}
            Side of the intact leg.

        Raises
        ------
        InputError
            ``intact`` is not ``left`` or ``right``.
        """
        fields = self._core.update(skeleton, intact == "left")
        return None if fields is None else Placement(**fields)

    def reset(self) -> None:
        """Start anew."""
        self._core.reset()
