"""Measurements for leg games: the position of a foot in a shoe cover, and positions of targets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.rgbd import RgbdFrame, Skeleton

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Side = Literal["left", "right"]


@checked
class ShoeCoverTracker:
    """Finds a foot by the blue cover of its shoe, because trackers miss small foot movements.

    The foot is the median, coordinate by coordinate, of the largest 8-connected patch of blue
    pixels within ``reach`` of the ankle. Other blue objects must be farther away.

    Parameters
    ----------
    hue : pair of int
        Smallest and largest hue of the cover, both included, 0 to 179 (OpenCV's units).
    min_saturation, min_value : int
        Smallest saturation and value (HSV) of the cover, 0 to 255.
    reach : float, metres
        Largest distance of a pixel's point from the ankle.
    min_pixels : int
        Smallest number of pixels of a patch that counts as a foot.

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
        """Return the skeleton with the foot, as tracked, at the shoe cover.

        The result is None if the ankle is not tracked or no cover is found.

        Parameters
        ----------
        frame : RgbdFrame
            Frame with a colour image, in the depth image's pixels or with a registration.
        skeleton : Skeleton
            The person in this frame.
        side : {'left', 'right'}
            Side of the foot.

        Raises
        ------
        InputError
            The frame has no colour, or ``side`` is not ``left`` or ``right``.
        """
        fields = self._core.update(frame, skeleton, side == "left")
        return None if fields is None else Skeleton(**fields)

    @property
    def num_pixels(self) -> int:
        """Number of pixels of the largest patch in the last frame."""
        return int(self._core.num_pixels)


@dataclass(frozen=True, eq=False)
class Placement:
    """Positions of two targets that a seated person's feet can reach.

    Attributes
    ----------
    knee_height : float, metres
        Distance from ankle to knee.
    reach : float, metres
        Largest distance of a foot from the hip centre.
    left, right : (3,) float32, metres
        Positions of the two targets, camera frame.
    stable_frames : int
        Number of frames since the person last moved.
    frozen : bool
        The placement is final: later frames do not change it.
    """

    knee_height: float
    reach: float
    left: NDArray[np.float32]
    right: NDArray[np.float32]
    stable_frames: int
    frozen: bool

    __repr__ = short_repr


@checked
class PlacementEstimator:
    """Places targets within reach of a person's feet, from the measured knee height.

    Only the knee height of the intact leg is measured, because a thigh that points at the camera
    cannot be. The reach from hip to sole is 0.491 / 0.246 times the knee height (Drillis & Contini,
    "Body segment parameters", 1966). All values are means over the frames since the person last
    moved.

    Parameters
    ----------
    share : float
        Distance of the targets from the hip centre as a share of the reach; (0, 1].
    spread : float
        Sine of the angle between straight ahead and each target; [0, 1).
    stable_frames : int
        Number of frames in a row within ``tolerance`` after which the placement is frozen.
    tolerance : float, metres
        Largest distance of knee height and hip centre from their running means. If it is exceeded,
        the person has moved and the means start anew.

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
        """Discard the placement and all means."""
        self._core.reset()
