"""How far a mesh is from its original: geometry, texture, roughness, boundaries."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d import _core
from manip3d._arrays import rows
from manip3d._options import reporting, seed_of, threads_of
from manip3d._range_image import (
    BoundaryNoise,
    Flicker,
    RangeImageError,
    boundary_noise,
    flicker,
    range_image_error,
    range_image_error_grid,
    render_depth,
)
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._options import Progress, Rng
    from manip3d.mesh import Mesh

__all__ = [
    "BoundaryGap",
    "BoundaryNoise",
    "ClosestPoints",
    "Deviation",
    "Flicker",
    "FmpdResult",
    "MetroResult",
    "RangeImageError",
    "TextureError",
    "boundary_gap",
    "boundary_noise",
    "closest_points",
    "flicker",
    "fmpd",
    "metro",
    "range_image_error",
    "range_image_error_grid",
    "render_depth",
    "texture_error",
]


@dataclass(frozen=True)
class ClosestPoints:
    """Nearest points of a surface; see :func:`closest_points`.

    Attributes
    ----------
    distance : (N,) float64, in the mesh's units
    face : (N,) int32
        The face it lies on; the lowest index where several are equally near.
    point : (N, 3) float64
    """

    distance: NDArray[np.float64]
    face: NDArray[np.int32]
    point: NDArray[np.float64]


@dataclass(frozen=True)
class Deviation:
    """Statistics of one-sided distances, in the meshes' units.

    Attributes
    ----------
    mean, rms, max : float
    samples : int
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
        From the original's samples to the simplified surface, in the meshes' units.
    backward : Deviation
        From the simplified surface's samples to the original.
    diagonal : float
        Of the original's bounding box, in the meshes' units.
    sampling : 'vertex' or 'area'
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


@dataclass(frozen=True)
class TextureError:
    """Deviation of texture coordinates; see :func:`texture_error`.

    Attributes
    ----------
    mean, rms, mse, max : float or None
        Of the distances between texture coordinates (1 = a whole texture); ``mse`` is the square of
        ``rms``. ``None`` when no sample could be compared.
    samples : int
        Samples compared.
    skipped : int
        Samples on a face without texture coordinates, or that met only such faces.
    material_mismatch_rate : float
        Share of all samples drawn that met no face of their own material; they are not compared.
    """

    mean: float | None
    rms: float | None
    mse: float | None
    max: float | None
    samples: int
    skipped: int
    material_mismatch_rate: float


@dataclass(frozen=True)
class FmpdResult:
    """Fast mesh perceptual distance; see :func:`fmpd`.

    Attributes
    ----------
    value : float
        0 = equally rough.
    roughness_original, roughness_simplified : float
        Global roughness of each mesh. Both depend on both meshes: thresholds are shared.
    skipped_faces : int
        Faces without area in both meshes, which do not take part.
    non_manifold : bool
        Some vertex is not manifold. Its curvature is that of an interior vertex.
    """

    value: float
    roughness_original: float
    roughness_simplified: float
    skipped_faces: int
    non_manifold: bool


@dataclass(frozen=True)
class BoundaryGap:
    """Distances between boundary curves; see :func:`boundary_gap`.

    Attributes
    ----------
    forward : Deviation or None
        From the original's boundary to the simplified one, in the meshes' units. ``None`` where the
        original has no boundary; infinite where only the simplified mesh has none.
    backward : Deviation or None
        From the simplified boundary to the original's, likewise.
    cracks : int
        Simplified boundary edges with a point beyond the tolerance of every original one.
    crack_length : float
        Summed length of those edges, in the meshes' units.
    diagonal : float
        Of the original's bounding box, in the meshes' units.
    """

    forward: Deviation | None
    backward: Deviation | None
    cracks: int
    crack_length: float
    diagonal: float


def closest_points(
    mesh: Mesh, points: ArrayLike, *, threads: int = 0, progress: Progress = None
) -> ClosestPoints:
    """Find the nearest point of a surface for each of many points.

    Parameters
    ----------
    mesh : Mesh
        At least one face; faces without area count as the segments or points that they are.
    points : (N, 3) float64, in the mesh's units
        A C-contiguous float64 array is not copied. Neighbouring rows that are near each other in
        space are answered faster.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The answer does not depend on it.
    progress : None, True or callable(fraction, message)

    Returns
    -------
    ClosestPoints

    Raises
    ------
    InputError
        ``mesh`` has no faces; ``points`` has another shape or is not finite.

    Examples
    --------
    >>> import manip3d
    >>> triangle = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> manip3d.metrics.closest_points(triangle, [[0.25, 0.25, 2.0]]).distance
    array([2.])
    """
    queries = rows(points, 3, np.float64, "points")
    with reporting(progress, "closest points") as report:
        return ClosestPoints(*_core.closest_points(mesh, queries, threads_of(threads), report))


def nearest_distances(
    points: ArrayLike,
    *,
    origin: ArrayLike | None = (0.0, 0.0, 0.0),
    resolution: float = 0.0,
    threads: int = 0,
    progress: Progress = None,
) -> NDArray[np.float64]:
    """Distance of each point from its nearest other point, exactly.

    Parameters
    ----------
    points : (N, 3) float32
        In any order. A C-contiguous float32 array is not copied.
    origin : (3,), optional
        Where the scanner stood: points are searched by the direction in which it saw them, which
        takes O(N) time. ``None``: a k-d tree; slower, and the same answer.
    resolution : float, radians
        Of the search; 0: one point a cell on average. The answer does not depend on it.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The answer does not depend on it.
    progress : None, True or callable(fraction, message)

    Returns
    -------
    (N,) float64
        0 for duplicates, infinite for a lone point.

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
    cloud = rows(points, 3, np.float32, "points")
    place = None
    if origin is not None:
        place = rows(np.asarray(origin)[None], 3, np.float64, "origin")[0]
    with reporting(progress, "nearest distances") as report:
        return _core.nearest_distances(cloud, place, resolution, threads_of(threads), report)


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
        ``vertex``: every vertex that a face uses, exact and free of chance. ``area``: random
        points, one in each of ``samples`` strata of equal area.
    samples : int, optional
        Number of points per direction for ``area``; 10 x the faces of ``original`` by default.
    rng : int, numpy.random.Generator or None
        Seed for ``area``; ``None``: another one each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result is the same, bit for bit, for any number.
    progress : None, True or callable(fraction, message)

    Returns
    -------
    MetroResult
        ``mean``, ``rms`` and ``max`` are those from ``original`` to ``simplified``, divided by the
        diagonal of the original's bounding box.

    Raises
    ------
    InputError
        A mesh without faces; an original whose bounding box is a point; ``area`` on a surface
        without area; ``samples`` below 1 or given with ``vertex``.

    Notes
    -----
    P. Cignoni, C. Rocchini, R. Scopigno: Metro: measuring error on simplified surfaces, Computer
    Graphics Forum 17(2), 1998. The two samplings differ by design: ``vertex`` weighs a surface
    by where its vertices are, ``area`` by area; their orders of two methods may be opposite.
    """
    if sampling not in ("vertex", "area"):
        raise InputError(f"sampling: expected 'vertex' or 'area', got {sampling!r}")
    if samples is not None and sampling == "vertex":
        raise InputError("samples: expected none with sampling='vertex', which takes each vertex")
    with reporting(progress, "metro") as report:
        forward, backward, diagonal = _core.metro(
            original,
            simplified,
            sampling == "area",
            _checked_samples(samples),
            seed_of(rng),
            threads_of(threads),
            report,
        )
    return MetroResult(Deviation(*forward), Deviation(*backward), diagonal, sampling)


def texture_error(
    original: Mesh,
    simplified: Mesh,
    *,
    samples: int | None = None,
    rng: Rng = 0,
    epsilon: float = 1e-4,
    threads: int = 0,
    progress: Progress = None,
) -> TextureError:
    """Measure how far texture coordinates moved on the surface.

    Area-uniform samples of the original are compared with the interpolated texture coordinates at
    the closest point of the simplified surface. Where several faces are met within ``epsilon`` of
    the closest distance, the one of the sample's material counts whose texture coordinates are
    nearest, so a seam is not an error.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each.
    samples : int, optional
        The larger of the two numbers of faces by default.
    rng : int, numpy.random.Generator or None
        Seed; ``None``: another one each time.
    epsilon : float
        In diagonals of the original's bounding box.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)

    Returns
    -------
    TextureError

    Raises
    ------
    InputError
        A mesh without faces; an original without area; ``samples`` below 1; ``epsilon`` negative.

    Notes
    -----
    H. Hoppe: New quadric metric for simplifying meshes with appearance attributes, IEEE
    Visualization 1999. Materials are the same when their names are (the n-th of a name with the
    n-th of that name), or by index where a mesh has no table of materials.
    """
    with reporting(progress, "texture error") as report:
        return TextureError(
            *_core.texture_error(
                original,
                _with_materials_of(original, simplified),
                _checked_samples(samples),
                seed_of(rng),
                epsilon,
                threads_of(threads),
                report,
            )
        )


def fmpd(
    original: Mesh,
    simplified: Mesh,
    *,
    clip: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> FmpdResult:
    """Measure the perceptual distance of two meshes as the difference of their roughness.

    Parameters
    ----------
    original, simplified : Mesh
        Connectivity is taken as stored; weld seams before where they should not count as boundary.
    clip : bool
        Limit the value to 1, as chapter 3 of the dissertation does and chapter 2 does not.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)

    Returns
    -------
    FmpdResult

    Raises
    ------
    InputError
        A mesh without faces or without area.

    Notes
    -----
    K. Wang, F. Torkhani, A. Montanvert: A fast roughness-based approach to the assessment of 3D
    mesh visual quality, Computers & Graphics 36(7), 2012. Local roughness is the Laplacian, with
    cotangent weights clamped to [0.001, 1000], of the absolute angle deficit. The values published
    in the dissertation cannot be met with it: compare ranks.
    """
    with reporting(progress, "fmpd") as report:
        return FmpdResult(*_core.fmpd(original, simplified, clip, threads_of(threads), report))


def boundary_gap(
    original: Mesh,
    simplified: Mesh,
    *,
    tolerance: float = 1e-3,
    weld: bool = True,
    threads: int = 0,
    progress: Progress = None,
) -> BoundaryGap:
    """Measure the distances between the boundary curves of two meshes, and find cracks.

    A boundary edge is used by exactly one face (faces with a repeated index apart). Mean and RMS
    are by length, sampled in the middles of equal pieces of each edge, none longer than 1e-3
    diagonals; the maximum looks at the ends of the edges as well.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each.
    tolerance : float
        Of a crack, in diagonals of the original's bounding box; 1e-6 to 1.
    weld : bool
        Count vertices with bit-identical positions as one, in both meshes. Without it each seam of
        a file that stores one vertex per texture coordinate (glTF always) is a boundary, and a
        crack along it is found only where it is wider than the tolerance.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)

    Returns
    -------
    BoundaryGap

    Raises
    ------
    InputError
        A mesh without faces; an original whose bounding box is a point; ``tolerance`` out of range.
    """
    with reporting(progress, "boundary gap") as report:
        forward, backward, cracks, crack_length, diagonal = _core.boundary_gap(
            original, simplified, tolerance, weld, threads_of(threads), report
        )
    return BoundaryGap(
        None if forward is None else Deviation(*forward),
        None if backward is None else Deviation(*backward),
        cracks,
        crack_length,
        diagonal,
    )


def _with_materials_of(original: Mesh, simplified: Mesh) -> Mesh:
    """``simplified`` with its materials numbered as in ``original``; new ones come after those."""
    face_material = simplified.face_material
    if face_material is None or not original.materials or not simplified.materials:
        return simplified
    known = {key: index for index, key in enumerate(_keys(original))}
    numbers = np.arange(-1, max(len(simplified.materials), face_material.max(initial=-1) + 1))
    numbers[numbers >= 0] += len(known)  # a material that the original does not have
    for index, key in enumerate(_keys(simplified)):
        numbers[index + 1] = known.get(key, numbers[index + 1])
    return simplified.replace(face_material=numbers[face_material + 1])


def _keys(mesh: Mesh) -> list[tuple[str, int]]:
    """Name of each material, and how many of that name came before it."""
    seen: Counter[str] = Counter()
    keys = []
    for material in mesh.materials:
        keys.append((material.name, seen[material.name]))
        seen[material.name] += 1
    return keys


def _checked_samples(samples: int | None) -> int:
    """The core's number of samples: 0 stands for its default."""
    if samples is None:
        return 0
    if not 1 <= samples < 2**40:
        raise InputError(f"samples: expected 1 to 2^40, got {samples}")
    return samples
