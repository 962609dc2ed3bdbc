"""The dissertation's attacks on scans (section 6.4), and two further ones."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d import _core
from manip3d._util.arrays import index_rows, rows
from manip3d._util.checked import checked
from manip3d._util.options import seed_of, threads_of
from manip3d.errors import InputError
from manip3d.forge._truth import (
    NO_LATTICE,
    Forgery,
    Hoax,
    Lattice,
    ObjectLike,
    box_arguments,
    check_chosen,
    check_finite,
    check_moved,
    rotation_matrix,
    to_forgery,
    to_hoax,
)
from manip3d.lidar import Box, Scan, ScanLike, origin_of, position_of, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Rng

NEIGHBOURHOOD = 1.0
"""Metres: radius around the position within which points determine the scene's spacing (MID)."""


@checked
def ctp(
    scan: ScanLike,
    hoax: ObjectLike,
    *,
    position: ArrayLike,
    rotation: ArrayLike = 0.0,
    scale: float = 1.0,
    translation: Literal["centroid", "paper"] = "centroid",
    intensity: ArrayLike = 0.0,
    threads: int = 0,
) -> Forgery:
    """Forge by Copy-Transform-Paste: append an object's points, scaled, rotated and translated.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Metres; a fourth column is intensity.
    hoax : Mesh, LidarFrame or (K, 3) array
        Object to paste; of a mesh, the vertices. A point at its origin is a point like others.
    position : (3,) metres
        Position of the pasted object, P_object, in the scan's frame.
    rotation : float or (3, 3)
        Rotation about the vertical in radians, or a rotation matrix.
    scale : float
        Metres per unit of the hoax; see `range_scale`.
    translation : 'centroid' or 'paper'
        ``centroid``: t = P_object - R s o_object, which moves the hoax's centroid to the position
        (R: rotation, s: scale, o: centroids). ``paper``: t = P_object - (o_scene - o_object) as
        printed, which moves it elsewhere; o_scene is the centroid of the scan's returns.
    intensity : float or (K,)
        Intensity of the appended points if the scan has intensities.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        A shape is wrong, a number is not finite, ``scale`` is not positive, the hoax is empty.

    Examples
    --------
    >>> import manip3d
    >>> forged = manip3d.forge.ctp([[5, 0, 0], [6, 0, 0]], [[0, 0, 0]], position=(3, 0, 0))
    >>> forged.points[forged.added].tolist()
    [[3.0, 0.0, 0.0]]
    """
    scene = to_scan(scan)
    paper = translation == "paper"
    return _paste(
        "ctp", scene, to_hoax(hoax, intensity, scene), position, rotation, scale, paper, threads
    )


@checked
def crtp(
    scan: ScanLike,
    hoax: ObjectLike,
    *,
    position: ArrayLike,
    rotation: ArrayLike = 0.0,
    scale: float = 1.0,
    spacing: float | None = None,
    resampling: Literal["poisson", "uniform"] = "poisson",
    translation: Literal["centroid", "paper"] = "centroid",
    intensity: float = 0.0,
    rng: Rng = 0,
    threads: int = 0,
) -> Forgery:
    """Forge by Copy-Resample-Transform-Paste: `ctp` with an object of the scene's density.

    The object is resampled by gamma = MID_object / MID_scene, where MID is the mean distance to the
    nearest neighbour: it is thinned out if gamma < 1, and interpolated on its surface if gamma > 1.

    Parameters
    ----------
    scan, hoax, position, rotation, scale, translation, threads
        Same as in `ctp`. Meshes are interpolated on their faces, points between neighbours.
    spacing : float, metres, optional
        MID_scene; default: that of the scan's points within 1 m of ``position``. Points at one
        place count once, and rows at exactly (0, 0, 0), which have no return, do not count.
    resampling : 'poisson' or 'uniform'
        Method that thins out points: with a least distance between points, or at random.
    intensity : float
        Intensity of the appended points if the scan has intensities.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.

    Returns
    -------
    Forgery
        ``parameters`` includes the ``spacing``.

    Raises
    ------
    InputError
        As `ctp`; ``spacing`` is not given, and fewer than two scene points at different places are
        within 1 m of ``position``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> forge.crtp(scan, car, position=(-5.0, 0.0, -0.5), spacing=0.4)
    <manip3d.forge.Forgery: crtp; 2175 points, 79 added, 0 moved, 0 removed>
    """
    scene = to_scan(scan)
    paper = translation == "paper"
    where = position_of(position, "position")
    workers = threads_of(threads)
    if spacing is None:
        spacing = _core.local_spacing(scene.points, where, NEIGHBOURHOOD, workers)
    _check_scale(scale)
    whole = to_hoax(hoax, 0.0, scene)
    uniform = resampling == "uniform"
    points = _core.resample(
        whole.points, whole.faces, spacing / scale, uniform, seed_of(rng), workers
    )
    sampled = to_hoax(points, intensity, scene)
    forgery = _paste("crtp", scene, sampled, where, rotation, scale, paper, threads)
    return replace(forgery, parameters={**forgery.parameters, "spacing": float(spacing)})


@checked
def resample(
    hoax: ObjectLike,
    *,
    spacing: float,
    resampling: Literal["poisson", "uniform"] = "poisson",
    rng: Rng = 0,
    threads: int = 0,
) -> NDArray[np.float32]:
    """Resample an object to a mean nearest-neighbour distance of ``spacing``; see `crtp`.

    Parameters
    ----------
    hoax : Mesh, LidarFrame or (K, 3) array
        Object to resample. Meshes are interpolated on their faces, points between neighbours.
        Points at one place count once.
    spacing : float
        Wanted mean distance to the nearest neighbour, in the hoax's unit.
    resampling : 'poisson' or 'uniform'
        Method that thins out points: with a least distance between points, or at random.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    (M, 3) float32
        No points if the object is interpolated on faces that have no area.

    Raises
    ------
    InputError
        The object has fewer than two points, or all at one place, ``spacing`` is not positive, or
        more than 2^24 points would have to be made to choose from.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import forge
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> len(forge.resample(car, spacing=0.5)) < len(car)
    True
    """
    whole = to_hoax(hoax, 0.0, to_scan(np.empty((0, 3), np.float32)))
    uniform = resampling == "uniform"
    return _core.resample(
        whole.points, whole.faces, spacing, uniform, seed_of(rng), threads_of(threads)
    )


@checked
def range_scale(scan: ScanLike, hoax: ObjectLike) -> float:
    """Return the scale that gives the hoax the largest extent of the scan.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        The scan.
    hoax : Mesh, LidarFrame or (K, 3) array
        The object to scale.

    Returns
    -------
    float

    Raises
    ------
    InputError
        One of them is empty or has a coordinate that is not finite, or all points of the hoax are
        at one place.

    Examples
    --------
    >>> from manip3d import forge
    >>> forge.range_scale([[0, 0, 0], [6, 0, 0]], [[0, 0, 0], [0, 3, 0]])
    2.0
    """
    scene = to_scan(scan)
    points = to_hoax(hoax, 0.0, scene).points
    if not (len(points) and len(scene.points)):
        raise InputError("hoax: expected points in the scan and in the hoax")
    check_finite(scene.points, "scan")
    check_finite(points, "hoax")
    extent = _extent(points)
    if not extent > 0.0:
        raise InputError("hoax: expected points at different places")
    return _extent(scene.points) / extent


def _extent(points: NDArray[np.float32]) -> float:
    """Largest extent of points along an axis, which may exceed float32."""
    return float(np.ptp(points.astype(np.float64), axis=0).max())


@checked
def subtract(
    scan: ScanLike, box: Box | None = None, *, rows: ArrayLike | None = None, threads: int = 0
) -> Forgery:
    """Remove the points in a box, or given rows of the scan (of a segmented object).

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        The scan.
    box : Box, optional
        Box whose points are removed, also those on its faces. Rows at exactly (0, 0, 0) have no
        return and stay.
    rows : (K,) integers, optional
        Rows to remove, instead of a box; a row that is given twice counts once.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        Neither or both of ``box`` and ``rows`` are given; a row is out of range; a box is not
        finite; no point of the scan is in the box, or there are no ``rows``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    >>> forge.subtract(scan, box)
    <manip3d.forge.Forgery: subtract; 1296 points, 0 added, 0 moved, 800 removed>
    """
    scene = to_scan(scan)
    if (box is None) == (rows is None):
        raise InputError("subtract: expected either a box or rows")
    if box is not None:
        parts = _core.subtract(
            scene.points, scene.intensity, box_arguments(box), threads_of(threads)
        )
        forgery = to_forgery(parts, scene, "subtract", {"box": box})
        check_chosen(forgery.removed)
        return forgery
    gone = index_rows(rows if rows is not None else (), None, "rows")
    if not len(gone):
        raise InputError("rows: expected rows to remove, got none")
    nothing = np.empty((0, 3), np.float32)
    parts = _core.replace_rows(
        scene.points, scene.intensity, gone, nothing, np.empty(0, np.float32), threads_of(threads)
    )
    return to_forgery(parts, scene, "subtract", {"rows": len(np.unique(gone))})


@checked
def deform(
    scan: ScanLike,
    box: Box,
    *,
    amplitude: float,
    direction: Literal["random", "normal"] = "random",
    origin: ArrayLike | None = None,
    rng: Rng = 0,
    threads: int = 0,
) -> Forgery:
    """Displace the points in a box at random, or as a dent or bulge of their surface.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        The scan.
    box : Box
        Box whose points are displaced. Rows at exactly (0, 0, 0) have no return and stay.
    amplitude : float, metres
        Largest displacement.
    direction : 'random' or 'normal'
        ``random``: uniform in a ball. ``normal``: a dent, against the surface normal that faces
        the scanner (a bulge for a negative amplitude), deepest in the middle of the box and 0 at
        its border.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else (0, 0, 0).
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        ``direction`` is unknown, or a number is not finite, also of a displaced point; no point of
        the scan is in the box, or no point would change, as with an ``amplitude`` of 0.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> box = Box((5.0, 0.0, -0.3), (2.4, 2.4, 2.2))
    >>> forge.deform(scan, box, amplitude=0.05, rng=0)
    <manip3d.forge.Forgery: deform; 2096 points, 0 added, 800 moved, 0 removed>
    """
    scene = to_scan(scan)
    along_normal = direction == "normal"
    parts = _core.deform(
        scene.points,
        scene.intensity,
        box_arguments(box),
        amplitude,
        along_normal,
        origin_of(origin, scene),
        seed_of(rng),
        threads_of(threads),
    )
    forgery = to_forgery(
        parts, scene, "deform", {"box": box, "amplitude": amplitude, "direction": direction}
    )
    check_moved(forgery, box, scene, threads, "amplitude")
    return forgery


@checked
def insert_occluding(
    scan: ScanLike,
    hoax: ObjectLike,
    *,
    position: ArrayLike,
    rotation: ArrayLike = 0.0,
    scale: float = 1.0,
    origin: ArrayLike | None = None,
    range_noise: float = 0.0,
    lattice: Lattice | None = None,
    rng: Rng = 0,
    threads: int = 0,
) -> Forgery:
    """Insert an object as the scanner would have measured it: on its rays, and with a shadow.

    Each ray that meets the object before its own point ends on the object instead. With a
    ``lattice``, rays without a return (sky) can end on the object as well.

    Parameters
    ----------
    scan, hoax, position, rotation, scale, threads
        Same as in `ctp`. Rays meet the faces of a mesh; each point of a cloud represents a disc of
        the size of its spacing.
    origin : (3,), optional
        Position of the scanner; default: that of the frame, else (0, 0, 0).
    range_noise : float, metres
        Standard deviation of ranges on the object.
    lattice : Lattice, optional
        Directions of the scanner, in its own frame.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.

    Returns
    -------
    Forgery
        ``moved`` are points of rays that now end on the object; ``added`` are points of rays that
        had no return.

    Raises
    ------
    InputError
        As `ctp`; the object surrounds the scanner; no ray meets the object before its own point, so
        that no point would change.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Box, forge
    >>> ground = np.mgrid[-9:9:0.5, -9:9:0.5, -1.5:-1:1].reshape(3, -1).T
    >>> car = np.mgrid[4:6:0.2, -1:1:0.2, -1.2:0.4:0.2].reshape(3, -1).T
    >>> scan = np.vstack([ground, car]).astype(np.float32)
    >>> forge.insert_occluding(scan, car, position=(-5.0, 0.0, -0.5))
    <manip3d.forge.Forgery: insert_occluding; 2096 points, 0 added, 68 moved, 0 removed>
    """
    scene = to_scan(scan)
    whole = to_hoax(hoax, 0.0, scene)
    where = position_of(position, "position")
    parts = _core.insert_occluding(
        scene.points,
        scene.intensity,
        whole.points,
        whole.faces,
        where,
        rotation_matrix(rotation),
        scale,
        origin_of(origin, scene),
        range_noise,
        *(NO_LATTICE if lattice is None else lattice.arguments()),
        seed_of(rng),
        threads_of(threads),
    )
    forgery = to_forgery(
        parts,
        scene,
        "insert_occluding",
        {"position": tuple(where.tolist()), "scale": scale, "range_noise": range_noise},
    )
    if not forgery.num_touched:
        raise InputError(
            "position: expected a place before scan points, but no ray meets the object there, so "
            "that no point would change"
        )
    return forgery


@checked
def snap_to_lattice(
    forgery: Forgery,
    lattice: Lattice,
    *,
    along: Literal["height", "ray"] = "height",
    azimuth: bool = True,
    max_move: float = 1.0,
    threads: int = 0,
) -> Forgery:
    """Move the added and moved points of a forgery to the sensor's ring lines.

    A `Lattice` has one azimuth phase and beams through the axis, so that the points lie between the
    firings of a scanner whose lasers have their own. `lattice_insert` knows these.

    Parameters
    ----------
    forgery : Forgery
        Forgery with the scanner at (0, 0, 0).
    lattice : Lattice
        Directions of the scanner.
    along : 'height' or 'ray'
        ``height``: only z changes. ``ray``: points move along their ray to the nearest crossing
        with a line, if there is one within ``max_move``; else only z changes.
    azimuth : bool
        First turn points to the nearest azimuth step, if the lattice has steps.
    max_move : float, metres
        Largest motion of points along their ray; see ``along``.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    Forgery

    Raises
    ------
    InputError
        The lattice has no rings.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import forge
    >>> lattice = forge.Lattice.grid(np.radians([-2, 0, 2]), np.radians(0.5))
    >>> forged = forge.ctp([[5, 0, 0], [9, 0, 0]], [[0, 0, 0]], position=(5, 0, 0.1))
    >>> snapped = forge.snap_to_lattice(forged, lattice)
    >>> x, y, z = snapped.points[snapped.added][0]
    >>> round(float(np.degrees(np.arctan2(z, np.hypot(x, y)))), 3)  # elevation
    2.0
    """
    along_ray = along == "ray"
    touched = np.concatenate([forgery.added, forgery.moved])
    none = np.empty(0, np.float32)
    parts = _core.snap_to_lattice(
        rows(forgery.points, 3, np.float32, "forgery.points"),
        none
        if forgery.intensity is None
        else rows(forgery.intensity, None, np.float32, "forgery.intensity"),
        touched,
        *lattice.arguments(),
        along_ray,
        azimuth,
        max_move,
        threads_of(threads),
    )
    return replace(
        forgery,
        points=parts[0],
        intensity=parts[1],
        box=box_around(parts[0][touched]) if len(touched) else forgery.box,
        attack=f"{forgery.attack}+snap",
        parameters={**forgery.parameters, "snapped": along},
    )


def box_around(points: NDArray[np.float32]) -> Box:
    """The axis-parallel box around points, metres."""
    low, high = (side.astype(np.float64) for side in (points.min(axis=0), points.max(axis=0)))
    return Box(tuple((0.5 * (low + high)).tolist()), tuple((high - low).tolist()))


def _paste(
    attack: str,
    scene: Scan,
    hoax: Hoax,
    position: ArrayLike,
    rotation: ArrayLike,
    scale: float,
    paper: bool,
    threads: int,
) -> Forgery:
    where = position_of(position, "position")
    _check_scale(scale)
    parts = _core.copy_transform_paste(
        scene.points,
        scene.intensity,
        hoax.points,
        hoax.intensity,
        where,
        rotation_matrix(rotation),
        scale,
        paper,
        threads_of(threads),
    )
    return to_forgery(
        parts,
        scene,
        attack,
        {
            "position": tuple(where.tolist()),
            "scale": scale,
            "translation": "paper" if paper else "centroid",
        },
    )


def _check_scale(scale: float) -> None:
    if not (scale > 0.0 and np.isfinite(scale)):
        raise InputError(f"scale: expected > 0, got {scale}")
