"""The six attacks on LiDAR scans by which ALERT is tested (dissertation section 7.4).

Boxes of objects come from labels or from `segment`. Rows at exactly (0, 0, 0) have no return: they
are in no box, and occupy no place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import vector
from manip3d._util.checked import checked
from manip3d._util.linear import moved, product
from manip3d._util.options import threads_of
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.forge._objects import nearest_object
from manip3d.forge._truth import (
    Forgery,
    box_arguments,
    check_chosen,
    check_finite,
    check_moved,
    renamed,
    to_forgery,
)
from manip3d.lidar import Box, LidarFrame, Scan, ScanLike, origin_of, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


CLEARANCE = 0.3
"""Metres: scene points count as a collision only this far above an object's lowest point, so that
the ground below it does not."""


@checked
def additive(
    scan: ScanLike,
    object_points: ArrayLike | LidarFrame,
    *,
    offset: ArrayLike = (0.0, 0.0, 0.0),
    allow_collision: bool = False,
    threads: int = 0,
) -> Forgery:
    """Append the points of an object that was cut from another frame: attack 1 of section 7.4.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    object_points : LidarFrame, (K, 3) or (K, 4)
        Points of the object at their place in their own frame. A point at its origin is a point
        like others.
    offset : (3,), metres
        Vector by which they are shifted.
    allow_collision : bool
        If False, scene points in the object's box, more than 0.3 m above its foot, raise an error.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        The object has no points, or one that is not finite, or it collides with scene points.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> forge.additive(scan, car, offset=(0.0, 6.0, 0.0))
    <manip3d.forge.Forgery: additive; 2896 points, 800 added, 0 moved, 0 removed>
    """
    scene = to_scan(scan)
    added = _shifted(_object_of(object_points), offset)
    if not allow_collision:
        _check_free(scene, added.points, threads)
    return _edited("additive", scene, np.empty(0, np.int32), added, threads)


@checked
def subtractive(
    scan: ScanLike, box: Box | None = None, *, origin: ArrayLike | None = None, threads: int = 0
) -> Forgery:
    """Delete the points of an object, the nearest by default: attack 2 of section 7.4.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    box : Box, optional
        Box around the object; default: that of `nearest_object`.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else the origin of the coordinates.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        No ``box`` is given and no object is found, or no point of the scan is in the box.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    >>> forge.subtractive(scan, box)
    <manip3d.forge.Forgery: subtractive; 1296 points, 0 added, 0 moved, 800 removed>
    """
    scene, target = _target(scan, box, origin)
    parts = _core.subtract(
        scene.points, scene.intensity, box_arguments(target), threads_of(threads)
    )
    forgery = to_forgery(parts, scene, "subtractive", {"box": target})
    check_chosen(forgery.removed)
    return forgery


@checked
def additive_subtractive(
    scan: ScanLike,
    object_points: ArrayLike | LidarFrame,
    box: Box | None = None,
    *,
    offset: ArrayLike = (0.0, 0.0, 0.0),
    origin: ArrayLike | None = None,
    allow_collision: bool = False,
    threads: int = 0,
) -> Forgery:
    """Append one object and delete another one: attack 3 of section 7.4.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    object_points : LidarFrame, (K, 3) or (K, 4)
        Points of the object to append, at their place in their own frame. A point at its origin is
        a point like others.
    box : Box, optional
        Box around the object to delete; default: that of `nearest_object`.
    offset : (3,), metres
        Vector by which the appended object is shifted.
    allow_collision : bool
        If False, scene points in the appended object's box, more than 0.3 m above its foot, raise
        an error; deleted points do not count.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else the origin of the coordinates.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        As `additive`; no ``box`` is given and no object is found, or no point of the scan is in the
        box.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    >>> forge.additive_subtractive(scan, car, box, offset=(0.0, 6.0, 0.0))
    <manip3d.forge.Forgery: additive_subtractive; 2096 points, 800 added, 0 moved, 800 removed>
    """
    scene, target = _target(scan, box, origin)
    added = _shifted(_object_of(object_points), offset)
    gone = _core.points_in_box(scene.points, box_arguments(target), threads_of(threads))
    check_chosen(gone)
    if not allow_collision:
        _check_free(scene, added.points, threads, leaving=gone)
    return _edited("additive_subtractive", scene, gone, added, threads)


@checked
def replacement(
    scan: ScanLike,
    object_points: ArrayLike | LidarFrame,
    box: Box | None = None,
    *,
    origin: ArrayLike | None = None,
    allow_collision: bool = False,
    threads: int = 0,
) -> Forgery:
    """Delete an object and put another one in its place: attack 4 of section 7.4.

    The centroid of the new object's points is moved to the centroid of the deleted points.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    object_points : LidarFrame, (K, 3) or (K, 4)
        The new object; its place in its own frame does not matter. A point at its origin is a point
        like others.
    box : Box, optional
        Box around the object to delete; default: that of `nearest_object`.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else the origin of the coordinates.
    allow_collision : bool
        If False, scene points in the new object's box, more than 0.3 m above its foot, raise an
        error; replaced points do not count.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        The new object has no points, or one that is not finite, or would collide with scene points;
        no object is found, or no point of the scan is in the box.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    >>> forge.replacement(scan, car[::2], box)
    <manip3d.forge.Forgery: replacement; 1696 points, 400 added, 0 moved, 800 removed>
    """
    scene, target = _target(scan, box, origin)
    gone = _core.points_in_box(scene.points, box_arguments(target), threads_of(threads))
    check_chosen(gone)
    pasted = _object_of(object_points)
    center = scene.points[gone].mean(axis=0, dtype=np.float64)
    offset = center - pasted.points.mean(axis=0, dtype=np.float64)
    added = _shifted(pasted, offset)
    if not allow_collision:
        _check_free(scene, added.points, threads, argument="object_points", leaving=gone)
    return _edited("replacement", scene, gone, added, threads)


def _expect_finite(**numbers: float) -> None:
    for name, number in numbers.items():
        if not math.isfinite(number):
            raise InputError(f"{name}: expected a finite number, got {number}")


@checked
def translation(
    scan: ScanLike,
    box: Box | None = None,
    *,
    distance: float = 3.0,
    origin: ArrayLike | None = None,
    allow_collision: bool = False,
    threads: int = 0,
) -> Forgery:
    """Move an object, the nearest by default, away from the scanner: attack 5 of section 7.4.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    box : Box, optional
        Box around the object; default: that of `nearest_object`.
    distance : float, metres
        Length of the horizontal motion along the line from the scanner to the centre of the box;
        negative: towards the scanner.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else the origin of the coordinates.
    allow_collision : bool
        If False, scene points in the moved object's box, more than 0.3 m above its foot, raise an
        error; moved points do not count.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        ``distance`` is not finite; no object is found, no point of the scan is in the box, or no
        point would change, as with a ``distance`` of 0; the centre of the box is straight above or
        below the scanner, so that the direction is undefined; the object would collide with scene
        points.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    >>> forge.translation(scan, box, distance=2.0).box.center[0] > 6.0
    True
    """
    _expect_finite(distance=distance)
    scene, target = _target(scan, box, origin)
    away = _away(target, origin_of(origin, scene))
    transform = np.eye(4)
    transform[:2, 3] = distance * away
    if not allow_collision:
        _check_destination(scene, target, transform, "distance", threads)
    forgery = _moved("translation", scene, target, transform, threads, {"distance": distance})
    check_moved(forgery, target, scene, threads, "distance")
    return forgery


@checked
def rotation(
    scan: ScanLike,
    box: Box | None = None,
    *,
    angle: float = math.radians(-10.0),
    sideways: float = 0.0,
    origin: ArrayLike | None = None,
    allow_collision: bool = False,
    threads: int = 0,
) -> Forgery:
    """Turn an object, the nearest by default, about its own vertical axis: attack 6.

    The axis goes through the centroid of the object's points; section 7.4 of the dissertation.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres, z up.
    box : Box, optional
        Box around the object; default: that of `nearest_object`.
    angle : float, radians
        Angle of rotation, counter-clockwise seen from above.
    sideways : float, metres
        Additional shift to the left, seen from the scanner. The tool of the dissertation's authors
        shifts by 2 m; its text does not mention it.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else the origin of the coordinates.
    allow_collision : bool
        If False, scene points in the rotated object's box, more than 0.3 m above its foot, raise an
        error; rotated points do not count.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        ``angle`` or ``sideways`` is not finite; no object is found, no point of the scan is in the
        box, or no point would change, as with an ``angle`` of 0; the object would collide with
        scene points; or ``sideways`` is not 0, and the centre of the box is straight above or below
        the scanner, so that no side is left.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    >>> forge.rotation(scan, box)
    <manip3d.forge.Forgery: rotation; 2096 points, 0 added, 800 moved, 0 removed>
    """
    _expect_finite(angle=angle, sideways=sideways)
    scene, target = _target(scan, box, origin)
    inside = _core.points_in_box(scene.points, box_arguments(target), threads_of(threads))
    check_chosen(inside)
    center = scene.points[inside].mean(axis=0, dtype=np.float64)
    transform = np.eye(4)
    transform[:3, :3] = _core.rotation_about_z(angle)
    transform[:3, 3] = center - product(transform[:3, :3], center)
    scanner = origin_of(origin, scene)
    if sideways:  # a turn alone needs no direction from the scanner
        away = _away(target, scanner)
        transform[:2, 3] += sideways * np.array([-away[1], away[0]])
    if not allow_collision:
        moved_by = "angle, sideways" if sideways else "angle"
        _check_destination(scene, target, transform, moved_by, threads, yaw=angle)
    forgery = _moved(
        "rotation", scene, target, transform, threads, {"angle": angle, "sideways": sideways}
    )
    check_moved(forgery, target, scene, threads, "angle")
    return forgery


ALERT_ATTACKS: Mapping[str, Callable[..., Forgery]] = MappingProxyType(
    {
        "additive": additive,
        "subtractive": subtractive,
        "additive_subtractive": additive_subtractive,
        "replacement": replacement,
        "translation": translation,
        "rotation": rotation,
    }
)
"""The six attacks by name, in the dissertation's order."""


def _target(scan: ScanLike, box: Box | None, origin: ArrayLike | None) -> tuple[Scan, Box]:
    return to_scan(scan), nearest_object(scan, origin=origin) if box is None else box


def _object_of(object_points: ArrayLike | LidarFrame) -> Scan:
    given = to_scan(object_points)
    if not len(given.points):
        raise InputError("object_points: expected points, got none")
    check_finite(given.points, "object_points")
    return given


def _shifted(added: Scan, offset: ArrayLike) -> Scan:
    shift = vector(offset, 3, "offset")
    shifted = added.points + shift
    if np.abs(shifted).max() > np.finfo(np.float32).max:
        raise InputError("offset: takes points beyond the finite floats")
    return added._replace(points=shifted.astype(np.float32))


def _check_free(
    scene: Scan,
    points: NDArray[np.float32] | NDArray[np.float64],
    threads: int,
    *,
    argument: str = "offset",
    leaving: NDArray[np.int32] | None = None,
    yaw: float = 0.0,
) -> None:
    """Raise `InputError` if scene points, other than those ``leaving``, are inside an object.

    The inside of the object is the box around its points, rotated by ``yaw``, from `CLEARANCE`
    above its lowest point on, so that the ground does not count.
    """
    turn = _core.rotation_about_z(yaw)
    upright = product(points.astype(np.float64), turn)  # rotated back: rows times the inverse
    low, high = upright.min(axis=0), upright.max(axis=0)
    low[2] = min(low[2] + CLEARANCE, high[2])
    center, size = product(turn, (low + high) / 2), high - low
    box = (tuple(center.tolist()), tuple(size.tolist()), yaw)
    found = _core.points_in_box(scene.points, box, threads_of(threads))
    inside = len(found if leaving is None else np.setdiff1d(found, leaving, assume_unique=True))
    if inside:
        raise InputError(
            f"{argument}: expected a free place, got one with {counted(inside, 'point')} of the "
            "scan in it (allow_collision puts the object there all the same)"
        )


def _check_destination(
    scene: Scan,
    box: Box,
    transform: NDArray[np.float64],
    argument: str,
    threads: int,
    *,
    yaw: float = 0.0,
) -> None:
    """Raise `InputError` if other scene points are where a motion takes the points of a box."""
    leaving = _core.points_in_box(scene.points, box_arguments(box), threads_of(threads))
    if not len(leaving):
        return
    arriving = moved(scene.points[leaving].astype(np.float64), transform)
    _check_free(scene, arriving, threads, argument=argument, leaving=leaving, yaw=box.yaw + yaw)


def _edited(
    attack: str, scene: Scan, removed: NDArray[np.int32], added: Scan, threads: int
) -> Forgery:
    intensity = added.intensity
    if not len(scene.intensity):
        intensity = np.empty(0, np.float32)
    parts = _core.replace_rows(
        scene.points, scene.intensity, removed, added.points, intensity, threads_of(threads)
    )
    return to_forgery(parts, scene, attack, {"added": len(added.points), "removed": len(removed)})


def _moved(
    attack: str,
    scene: Scan,
    box: Box,
    transform: NDArray[np.float64],
    threads: int,
    parameters: Mapping[str, float],
) -> Forgery:
    parts = _core.move_box(
        scene.points, scene.intensity, box_arguments(box), transform, threads_of(threads)
    )
    forgery = to_forgery(parts, scene, attack, {})
    return renamed(forgery, attack, {"box": box, **parameters})


def _away(box: Box, origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Horizontal unit vector from the scanner to the box."""
    line = np.asarray(box.center, np.float64)[:2] - origin[:2]
    length = float(np.linalg.norm(line, axis=-1))
    if not length > 0.0:
        raise InputError("box: expected a centre beside the scanner's vertical axis, got one on it")
    return line / length
