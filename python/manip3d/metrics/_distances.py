"""Distances to and between surfaces: closest points, nearest neighbours, Metro, Hausdorff."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array, rows, vector, warn_of_rounding
from manip3d._util.checked import checked
from manip3d._util.options import reporting, seed_of, threads_of
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress, Rng
    from manip3d.mesh import Mesh


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """Nearest points of a surface; see :func:`closest_points`.

    Attributes
    ----------
    distance : (N,) float64, in the mesh's units
        Distance from the surface; infinite if no face is within ``max_distance``.
    face : (N,) int32
        Face of the nearest point; the lowest index if several are equally near; -1: none.
    point : (N, 3) float64
        Nearest point of the surface; NaN if there is no face.
    """

    distance: NDArray[np.float64]
    face: NDArray[np.int32]
    point: NDArray[np.float64]

    __repr__ = short_repr


@dataclass(frozen=True)
class Deviation:
    """Statistics of one-sided distances, in the meshes' units.

    Attributes
    ----------
    mean, rms, max : float
        Mean, root mean square and largest distance.
    samples : int
        Number of samples.
    """

    mean: float
    rms: float
    max: float
    samples: int


@dataclass(frozen=True)
class MetroResult:
    """Distances between two surfaces; see :func:`metro`.

    Attributes
    ----------
    forward : Deviation
        Distances from samples of the original to the simplified surface, in the meshes' units.
    backward : Deviation
        Distances from samples of the simplified surface to the original.
    diagonal : float
        Diagonal of the original's bounding box, in the meshes' units.
    sampling : 'vertex' or 'area'
        Sampling of the surfaces.
    """

    forward: Deviation
    backward: Deviation
    diagonal: float
    sampling: Literal["vertex", "area"]

    @property
    def mean(self) -> float:
        """The published Metro: mean of ``forward`` divided by ``diagonal``."""
        return self.forward.mean / self.diagonal

    @property
    def rms(self) -> float:
        """Root mean square of ``forward`` divided by ``diagonal``."""
        return self.forward.rms / self.diagonal

    @property
    def max(self) -> float:
        """Largest distance of ``forward`` divided by ``diagonal``."""
        return self.forward.max / self.diagonal


@checked
def closest_points(
    mesh: Mesh,
    points: ArrayLike,
    *,
    max_distance: float = math.inf,
    threads: int = 0,
    progress: Progress = None,
) -> ClosestPoints:
    """Find the nearest point of a surface for each of many points.

    Parameters
    ----------
    mesh : Mesh
        Mesh with at least one face; faces without area count as segments or points.
    points : (N, 3) float64, in the mesh's units
        Query points; a C-contiguous float64 array is not copied. The search is faster if successive
        rows are near each other in space.
    max_distance : float, in the mesh's units
        Points without a face within this distance get the face -1, an infinite distance and a point
        of NaN. Small values make the search much faster.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    ClosestPoints

    Raises
    ------
    InputError
        ``mesh`` has no faces; ``points`` has another shape or is not finite; ``max_distance`` is
        negative or NaN.

    Examples
    --------
    >>> import manip3d
    >>> triangle = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> manip3d.metrics.closest_points(triangle, [[0.25, 0.25, 2.0]]).distance
    array([2.])
    """
    queries = rows(points, 3, np.float64, "points")
    with reporting(progress, "closest points") as report:
        found = _core.closest_points(mesh, queries, max_distance, threads_of(threads), report)
        return ClosestPoints(*found)


@checked
def nearest_distances(
    points: ArrayLike,
    *,
    origin: ArrayLike | None = (0.0, 0.0, 0.0),
    resolution: float = 0.0,
    threads: int = 0,
    progress: Progress = None,
) -> NDArray[np.float64]:
    """Compute the exact distance of each point from its nearest other point.

    Parameters
    ----------
    points : (N, 3) float32 or float64
        Points in any order; a C-contiguous float32 array is not copied. Others are converted to
        float32, after subtracting their middle if they lie far from 0, like those of a map.
    origin : (3,), optional
        Position of the scanner. Neighbours are searched by their direction from it, in O(N) time.
        None: a k-d tree is used, which is slower and gives the same result.
    resolution : float, radians
        Cell size of the search grid; 0: one point per cell on average. The result does not depend
        on it.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    (N,) float64
        Distance of each point from its nearest neighbour; 0 for duplicates, infinite for a single
        point.

    Raises
    ------
    InputError
        ``points`` has another shape or is not finite; ``origin`` is not three finite numbers.

    Examples
    --------
    >>> import manip3d
    >>> manip3d.metrics.nearest_distances([[1, 0, 0], [3, 0, 0], [4, 0, 0]])
    array([2., 1., 1.])
    """
    place = None if origin is None else vector(origin, 3, "origin")
    given = as_array(points, "points")
    if given.dtype != np.float32 and _is_far(given):
        # float32 would round the coordinates of a map by up to half a metre.
        middle = (given.min(axis=0).astype(np.float64) + given.max(axis=0)) / 2.0
        given = given - middle
        place = None if place is None else place - middle
    cloud = rows(given, 3, np.float32, "points")
    warn_of_rounding(given, cloud, "points")
    with reporting(progress, "nearest distances") as report:
        return _core.nearest_distances(cloud, place, resolution, threads_of(threads), report)


def _is_far(points: NDArray[Any]) -> bool:
    """Return whether points are farther from 0 along an axis than they are from each other."""
    if (
        points.ndim != 2
        or points.shape[1] != 3
        or not len(points)
        or points.dtype.kind not in "iuf"
    ):
        return False
    low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.abs(low + high).max() > 2.0 * (high - low).max())  # False for NaN


@checked
def metro(
    original: Mesh,
    simplified: Mesh,
    *,
    sampling: Literal["vertex", "area"] = "vertex",
    samples: int | None = None,
    rng: Rng = 0,
    threads: int = 0,
    progress: Progress = None,
) -> MetroResult:
    """Measure the distances between a mesh and its simplification in both directions.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each.
    sampling : 'vertex' or 'area'
        ``vertex``: every vertex that a face uses, without randomness. ``area``: random points, one
        in each of ``samples`` strata of equal area.
    samples : int, optional
        Number of points per direction for ``area``; default: 10 times the faces of ``original``.
    rng : int, numpy.random.Generator or None
        Seed for ``area``; None: a different one each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result is the same, bit for bit, for any number.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    MetroResult
        Distances in both directions; ``mean``, ``rms`` and ``max`` are those from ``original`` to
        ``simplified``, divided by the diagonal of the original's bounding box.

    Raises
    ------
    InputError
        A mesh has no faces; the original's bounding box is a point; ``area`` is used on a surface
        without area; ``samples`` is below 1 or given with ``vertex``.

    Notes
    -----
    P. Cignoni, C. Rocchini, R. Scopigno: Metro: measuring error on simplified surfaces, Computer
    Graphics Forum 17(2), 1998. The two samplings differ by design: ``vertex`` weights a surface by
    the density of its vertices, ``area`` by area. They may rank two methods in opposite order.

    Examples
    --------
    >>> from manip3d import Mesh, metrics
    >>> corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    >>> low, high = (Mesh([[x, y, z] for x, y, _ in corners], [[0, 1, 2]]) for z in (0.0, 0.5))
    >>> found = metrics.metro(low, high)
    >>> found.forward.mean, found.diagonal
    (0.5, 1.4142135623730951)
    """
    if samples is not None and sampling == "vertex":
        raise InputError("samples: cannot be given with sampling='vertex', which takes each vertex")
    with reporting(progress, "metro") as report:
        forward, backward, diagonal = _core.metro(
            original,
            simplified,
            sampling == "area",
            checked_samples(samples),
            seed_of(rng),
            threads_of(threads),
            report,
        )
    return MetroResult(Deviation(*forward), Deviation(*backward), diagonal, sampling)


@dataclass(frozen=True)
class HausdorffBound:
    """Lower and upper bounds of a Hausdorff distance; see :func:`hausdorff_bound`.

    Attributes
    ----------
    forward : (lower, upper) float
        Bounds of the largest distance of a point of the original from the simplified surface, in
        the meshes' units.
    backward : (lower, upper) float
        Bounds of the largest distance of a point of the simplified surface from the original.
    diagonal : float
        Diagonal of the original's bounding box, in the meshes' units.
    """

    forward: tuple[float, float]
    backward: tuple[float, float]
    diagonal: float

    @property
    def lower(self) -> float:
        """Lower bound of the two-sided distance, in the meshes' units."""
        return max(self.forward[0], self.backward[0])

    @property
    def upper(self) -> float:
        """Upper bound of the two-sided distance, in the meshes' units."""
        return max(self.forward[1], self.backward[1])


@checked
def hausdorff_bound(
    original: Mesh,
    simplified: Mesh,
    *,
    tolerance: float = 1e-4,
    threads: int = 0,
    progress: Progress = None,
) -> HausdorffBound:
    """Enclose the two-sided Hausdorff distance of two surfaces between two bounds.

    Any number of samples only gives a lower bound; the upper bound here is proved.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each.
    tolerance : float
        Largest difference of the bounds, in diagonals of the original's bounding box. Smaller
        values take more time. At least 1e-12, more if ``simplified`` is larger than the original.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result is the same, bit for bit, for any number.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    HausdorffBound

    Raises
    ------
    InputError
        A mesh has no faces; the original's bounding box is a point; ``tolerance`` is not above 0
        or too small for the size of the meshes.

    Notes
    -----
    Branch and bound over the triangles of each surface: M. Tang, M. Lee, Y. J. Kim: Interactive
    Hausdorff distance computation for general polygonal models, SIGGRAPH 2009. The distance from a
    triangle is a convex function, so over a part of another triangle it is largest at a corner.

    Examples
    --------
    >>> import manip3d
    >>> large = manip3d.Mesh([[0, 0, 0], [4, 0, 0], [0, 3, 0]], [[0, 1, 2]])
    >>> small = manip3d.Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0]], [[0, 1, 2]])
    >>> bound = manip3d.metrics.hausdorff_bound(large, small, tolerance=1e-3)
    >>> bound.lower <= 2.0 <= bound.upper <= bound.lower + 1e-3 * bound.diagonal
    True
    """
    with reporting(progress, "hausdorff") as report:
        return HausdorffBound(
            *_core.hausdorff_bound(original, simplified, tolerance, threads_of(threads), report)
        )


def checked_samples(samples: int | None) -> int:
    """The number of samples for the core, where 0 stands for its default."""
    if samples is None:
        return 0
    if not 1 <= samples < 2**40:
        raise InputError(f"samples: expected 1 to 2^40, got {samples}")
    return samples
