"""Objects of a scan, for those who have no boxes: ground removal and Euclidean clustering."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.lidar import Box, ScanLike, origin_of, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

NEITHER = -2
"""Label of rows that are neither ground nor an object."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Objects of a scan; see :func:`segment`.

    Attributes
    ----------
    label : (N,) int32
        Index of ``boxes``; -1: ground; -2: neither (too few points, too large, too far, or rows at
        exactly (0, 0, 0), which nothing came back for).
    boxes : tuple of Box
        The nearest to the scanner first.
    """

    label: NDArray[np.int32]
    boxes: tuple[Box, ...]

    def rows(self, index: int) -> NDArray[np.int32]:
        """Return the rows of the points of one object.

        Parameters
        ----------
        index : int
            Index of ``boxes``.
        """
        return np.flatnonzero(self.label == index).astype(np.int32)


@checked
def segment(
    scan: ScanLike,
    *,
    origin: ArrayLike | None = None,
    max_range: float = 80.0,
    ground_height: float = 0.3,
    ground_slope: float = 0.3,
    tolerance: float = 0.5,
    min_points: int = 30,
    max_size: float = 8.0,
) -> Segmentation:
    """Find the objects that stand on the ground.

    The ground is the lower envelope, no steeper than ``ground_slope``, of the lowest points of 1 m
    cells; what rises above it is clustered.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Metres, z up.
    origin : (3,), optional
        Where the scanner stands; by default as the frame says, else (0, 0, 0).
    max_range : float, metres
        Points farther away, over the ground, are left out.
    ground_height : float, metres
        Above the ground, where objects begin.
    ground_slope : float
        Height over distance.
    tolerance : float, metres
        Points in the same or in touching cubes of this side belong together.
    min_points : int
        Smaller clusters are not objects.
    max_size : float, metres
        Longer ones (walls) are not objects either.

    Returns
    -------
    Segmentation

    Raises
    ------
    InputError
        An option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> len(forge.segment(scan).boxes)
    1
    """
    scene = to_scan(scan)
    measured = scene.points.any(axis=1)
    found_label, boxes = _core.segment_objects(
        scene.points if measured.all() else scene.points[measured],
        origin_of(origin, scene),
        max_range,
        ground_height,
        ground_slope,
        tolerance,
        min_points,
        max_size,
    )
    found = tuple(
        Box((x, y, z), (length, width, height), yaw)
        for (x, y, z), (length, width, height), yaw in boxes
    )
    label = np.full(len(scene.points), NEITHER, np.int32)
    label[measured] = found_label
    return Segmentation(label, found)


@checked
def nearest_object(scan: ScanLike, *, origin: ArrayLike | None = None) -> Box:
    """Return the box of the object nearest to the scanner, as `segment` finds it.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
    origin : (3,), optional
        Where the scanner stood; default: the frame's own, else the origin of the coordinates.

    Returns
    -------
    Box

    Raises
    ------
    InputError
        There is none.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> forge.nearest_object(scan).center[0] > 4.0
    True
    """
    boxes = segment(scan, origin=origin).boxes
    if not boxes:
        raise InputError("scan: expected an object that stands free on the ground, found none")
    return boxes[0]
