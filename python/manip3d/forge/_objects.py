"""Find the objects of a scan by ground removal and Euclidean clustering."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError
from manip3d.lidar import Box, ScanLike, origin_of, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

CARRIER = 1.0
"""Metres: objects whose footprint is at most this far from the scanner are what carries it, such as
the roof of the car."""

NEITHER = -2
"""Label of rows that are neither ground nor an object."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Objects of a scan; see :func:`segment`.

    Attributes
    ----------
    label : (N,) int32
        Index into ``boxes``; -1: ground; -2: neither (too few points, too large, too far, or rows
        at exactly (0, 0, 0), which have no return).
    boxes : tuple of Box
        Boxes of the objects, the nearest to the scanner first.
    """

    label: NDArray[np.int32]
    boxes: tuple[Box, ...]

    __repr__ = short_repr

    def rows(self, index: int) -> NDArray[np.int32]:
        """Return the rows of the points of one object.

        Parameters
        ----------
        index : int
            Index into ``boxes``.
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
    cells. Points above it are clustered.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else (0, 0, 0).
    max_range : float, metres
        Points with a larger horizontal distance are left out.
    ground_height : float, metres
        Height above the ground from which points belong to objects.
    ground_slope : float
        Largest slope of the ground, height over distance.
    tolerance : float, metres
        Points in the same or in touching cubes of this side belong together.
    min_points : int
        Fewest points of an object.
    max_size : float, metres
        Largest length of an object; longer clusters, such as walls, are no objects.

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

    Boxes whose footprint contains the scanner or is within 1 m of it are left out: the car or the
    person that carries the scanner is no object of the scene.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else the origin of the coordinates.

    Returns
    -------
    Box

    Raises
    ------
    InputError
        There is no object that is more than 1 m away.

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
    scanner = origin_of(origin, to_scan(scan))
    for box in segment(scan, origin=origin).boxes:
        if _distance_to_footprint(box, scanner) > CARRIER:
            return box
    raise InputError(
        "scan: expected an object that stands free on the ground, more than "
        f"{CARRIER:g} m from the scanner, found none"
    )


def _distance_to_footprint(box: Box, scanner: NDArray[np.float64]) -> float:
    """Return the horizontal distance from the scanner to a box; 0: inside, above or below it."""
    x, y = scanner[:2] - np.asarray(box.center[:2])
    cosine, sine = math.cos(box.yaw), math.sin(box.yaw)
    along, across = abs(cosine * x + sine * y), abs(cosine * y - sine * x)
    length, width, _ = box.size
    return math.hypot(max(along - length / 2, 0.0), max(across - width / 2, 0.0))
