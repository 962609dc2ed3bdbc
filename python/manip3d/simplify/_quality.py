"""Fewer faces for the same shape, on any real mesh: with the least error, or fast."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array
from manip3d._util.checked import checked
from manip3d._util.options import reporting, threads_of
from manip3d._util.showing import Showable
from manip3d.errors import InputError
from manip3d.mesh import Material, Mesh
from manip3d.simplify._collapse import StoppingRules, StopReason, clean, expect_surface
from manip3d.simplify._color_seams import color_seams

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress

__all__ = ["QualityResult", "fast", "quality"]


@dataclass(frozen=True, eq=False)
class QualityResult(Showable):
    """A simplified mesh whose vertices lie where the error is least, and why it ended there.

    Attributes
    ----------
    mesh : Mesh
        Compact; materials are the input's, also those that no face uses any more.
    stop : StopReason
        Missing the target is a result, not an error: read it here.
    max_error : float
        Largest error of a step, in the file's unit. Of a collapse: the root mean square distance
        of its vertex to the planes of the original faces that it stands for, or to those of the
        boundaries and seams, whichever is larger (:func:`fast`: to all of these planes together).
        For a removed piece, it is the mean distance to the rest. The fit at the end is not
        included, and it is not a bound of the Hausdorff distance.
    vertex_map : (V,) int32
        Input vertex -> the output vertex it went into; -1 if no face of the output is left there.
    face_map : (F,) int32
        Input face -> output face, or -1 if it is gone.
    rejected : dict of str to int
        Number of candidate collapses that were rejected, by reason.
    removed_pieces : int
        Connected pieces that were removed as a whole, because that cost less than collapses.
    relaxed_collapses : int
        Collapses that made an edge of three faces, turned a face over or put two back to back,
        because the target was out of reach otherwise, or only at the price of the shape: many
        holes leave hardly any other collapse, and closed pieces of four faces none.
    dropped_faces : int
        Input faces left out by cleaning: with a repeated vertex, or copies of another.
    message : str
        Empty; other methods say here why they refuse a mesh.
    distance_bound : float or None
        Upper bound of the two-sided Hausdorff distance between the two surfaces, boundaries
        included, in the file's unit: computed, not sampled, and at most ``max_distance``. ``None``
        where no ``max_distance`` was given.
    """

    mesh: Mesh
    stop: StopReason
    max_error: float
    vertex_map: NDArray[np.int32] = field(repr=False)
    face_map: NDArray[np.int32] = field(repr=False)
    rejected: dict[str, int]
    removed_pieces: int
    relaxed_collapses: int
    dropped_faces: int
    message: str = ""
    distance_bound: float | None = None


def _follow(first: NDArray[np.int32], second: NDArray[np.int32]) -> NDArray[np.int32]:
    """One map after another; -1 stays -1."""
    gone = np.int32(-1)
    if len(second) == 0:
        return np.full_like(first, gone)
    return np.where(first < 0, gone, second[first])


@checked
def boundary_vertices(mesh: Mesh) -> NDArray[np.bool_]:
    """Return which vertices lie on a boundary: those of edges that exactly one face uses.

    Locked, they keep the boundary as it is: tiles that are simplified one by one still meet.

    Parameters
    ----------
    mesh : Mesh
        Vertices at equal positions count as one, so that a seam of a texture is no boundary.

    Returns
    -------
    (V,) bool
        One vertex at least of each place on the boundary, for the ``locked`` of `quality`, `fast`
        and `simplify`, by which one that is locked locks all at its place.

    Raises
    ------
    InputError
        ``mesh`` is not a mesh.

    Examples
    --------
    >>> import manip3d
    >>> from manip3d import simplify
    >>> tile = manip3d.simulate.models.floor(columns=6, rows=6)
    >>> border = simplify.boundary_vertices(tile)
    >>> int(border.sum()), tile.num_vertices
    (24, 49)
    >>> small = simplify.quality(tile, target_faces=24, locked=border).mesh
    >>> small.num_vertices, small.summary().boundary_edges
    (25, 24)
    """
    found = np.zeros(mesh.num_vertices, np.bool_)
    found[_core.welded_boundary(mesh).reshape(-1)] = True
    return found


def locked_of(mesh: Mesh, locked: ArrayLike | None) -> NDArray[np.bool_] | None:
    """One of each vertex."""
    if locked is None:
        return None
    chosen = as_array(locked, "locked")
    if chosen.dtype != np.bool_ or chosen.shape != (mesh.num_vertices,):
        raise InputError(
            f"locked: expected bool of shape ({mesh.num_vertices},), got {chosen.dtype} of "
            f"shape {chosen.shape}"
        )
    return chosen


def _importance(mesh: Mesh, importance: ArrayLike | None) -> NDArray[np.float64] | None:
    """One of each vertex, all above 0."""
    if importance is None:
        return None
    weights = np.asarray(importance)
    if weights.dtype.kind not in "iuf" or weights.shape != (mesh.num_vertices,):
        raise InputError(
            f"importance: expected numbers of shape ({mesh.num_vertices},), got {weights.dtype} of "
            f"shape {weights.shape}"
        )
    weights = weights.astype(np.float64)
    wrong = np.flatnonzero(~(np.isfinite(weights) & (weights > 0)))
    if len(wrong):
        raise InputError(
            f"importance: expected numbers > 0, got {weights[wrong[0]]} at vertex {wrong[0]}"
        )
    return weights


def _shows_texture(mesh: Mesh) -> bool:
    """Whether its materials have pictures. They may be anywhere without materials, and where only
    the names of materials are known, as beside an MTL file that is missing."""
    return not mesh.materials or any(
        material.textures or (material.name and material == Material(material.name))
        for material in mesh.materials
    )


def _looks(mesh: Mesh) -> list[int]:
    """Return a number for each material, the same for materials that look the same."""
    numbers: dict[object, int] = {}

    def look(material: Material) -> object:
        if material == Material(material.name):  # nothing but its name is known
            return material.name
        pictures = tuple(sorted(material.textures.items(), key=lambda item: item[0]))
        return repr(replace(material, name="", textures={})), pictures

    of_object = {id(material): material for material in mesh.materials}  # one may have many rows
    found = {i: numbers.setdefault(look(one), len(numbers)) for i, one in of_object.items()}
    return [found[id(material)] for material in mesh.materials]


@checked
def quality(
    mesh: Mesh,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    boundary_weight: float = 1.0,
    seam_weight: float = 3.0,
    texture_weight: float = 0.2,
    texture_seen: bool | None = None,
    color_weight: float = 0.01,
    locked: ArrayLike | None = None,
    importance: ArrayLike | None = None,
    progress: Progress = None,
) -> QualityResult:
    """Simplify any mesh, textured or not, by edge collapse to the vertices of least error.

    Parameters
    ----------
    mesh : Mesh
        Not changed. It may be open, non-manifold, in many pieces, with several materials, several
        texture coordinates per vertex and faces without any. It is cleaned first (:func:`clean`):
        vertices at one place are welded, corners keep their texture coordinates. Vertices of
        different colours at one place stay apart, but the surface keeps no gap between them.
    target_faces : int, optional
        Stop at this many faces or fewer.
    ratio : float in [0, 1], optional
        The fraction of the input's faces that stays; with ``target_faces``, the larger number of
        faces is the target.
    max_error : float, optional
        No step with a larger error (see ``QualityResult.max_error``), in the file's unit.
    max_distance : float > 0, optional
        The two-sided Hausdorff distance between the surfaces, boundaries included, in the file's
        unit, does not exceed it: by construction (see ``QualityResult.distance_bound``). No piece
        vanishes then. Targets combine; the first one reached stops. One is needed.
    boundary_weight, seam_weight : float
        Weight of a shifted boundary, or of a shifted border between materials or texture charts,
        relative to a shifted surface.
    texture_weight : float
        Weight of a shifted texture relative to a shifted surface, each on average over the area
        that has one; 0: texture coordinates are carried along and cost nothing.
    texture_seen : bool, optional
        Whether a picture is shown. If not, textures and their seams within a material count a
        tenth: texture coordinates stay for later, but the shape is what is seen. By default they
        count in full, unless the mesh has materials, of which more than names is known, and none of
        them has a texture image.
    color_weight : float
        Weight of errors of vertex colours relative to a shifted surface, each on average over the
        surface. By default the shape comes first: colours decide where it is flat. With 0,
        colours are only interpolated, and decide whether a part that vanishes is missed.
        ``max_error`` and ``max_distance`` limit the shape alone.
    locked : (V,) bool, optional
        Vertices that stay where they are, with their texture coordinates; a piece with one of
        them does not vanish. Where several share a place, one locks all.
    importance : (V,) float > 0, optional
        Factor on the cost of changes of the surface at a vertex. At one place,
        and for what becomes one vertex, the largest counts.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    QualityResult

    Raises
    ------
    InputError
        No target, an option out of its range, or a mesh without a face that has three different
        corners.

    Notes
    -----
    Each step is priced by the volume between the original surface and what it becomes: the area
    that a vertex stands for times its root mean square distance to the planes there [1]_, plus
    the strips that boundaries and seams sweep, plus the same for the texture [2]_. The price per
    face removed decides what comes next. A vertex goes where its faces as they are now have the
    least squared distance, with their volume kept [3]_. A piece may vanish as a whole for its area
    times its mean distance to the rest, and its borders times the same; where it can be seen and
    the surface behind it has another material or colour, it counts as 2 % of the mesh's diagonal
    away. Materials that differ only in their names look the same, unless nothing but the names
    is known. Seams that show another
    chart where they move cost together at most as much as the whole surface that moves as far. At
    the end the vertices are fitted to the original surface, and their texture coordinates to the
    original ones, within their charts.

    No face turns over, and edges get no third face, unless the input has it, the target is out of
    reach otherwise, or, for edges, all else costs 1.5 times as much and can be seen
    (``relaxed_collapses``). No other vertices than those of ``locked`` are fixed.

    References
    ----------
    .. [1] M. Garland and P. Heckbert, "Surface simplification using quadric error metrics", 1997.
    .. [2] H. Hoppe, "New quadric metric for simplifying meshes with appearance attributes", 1999.
    .. [3] P. Lindstrom and G. Turk, "Fast and memory efficient polygonal simplification", 1998.

    Examples
    --------
    >>> import manip3d
    >>> square = manip3d.Mesh(
    ...     [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]],
    ...     [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
    ... )
    >>> manip3d.simplify.quality(square, target_faces=2).mesh
    <manip3d.Mesh: 4 vertices, 2 faces>
    """
    options = _core.QualityOptions()
    rules = StoppingRules(target_faces, ratio, max_error, max_distance)
    options.target_faces, options.max_error, options.max_distance = rules.limits(mesh)
    options.boundary_weight = boundary_weight
    options.seam_weight = seam_weight
    options.texture_weight = texture_weight
    options.texture_seen = _shows_texture(mesh) if texture_seen is None else texture_seen
    seams = color_seams(mesh)
    options.color_weight = 0.0 if seams is not None and seams.is_flat else color_weight
    if seams is not None:
        mesh = seams.mesh
    options.looks = _looks(mesh)
    chosen = locked_of(mesh, locked)
    weights = _importance(mesh, importance)
    cleaned = clean(mesh)
    expect_surface(cleaned.mesh.num_faces, mesh.num_faces)
    stays = cleaned.vertex_map >= 0
    if chosen is not None:
        options.locked = np.isin(
            np.arange(cleaned.mesh.num_vertices), cleaned.vertex_map[chosen & stays]
        ).tolist()
    if weights is not None:
        largest = np.zeros(cleaned.mesh.num_vertices)
        np.maximum.at(largest, cleaned.vertex_map[stays], weights[stays])
        options.importance = largest.tolist()
    with reporting(progress, "simplify") as report:
        fields = _core.simplify_quality(cleaned.mesh, options, report)
    fields["stop"] = StopReason(fields["stop"].name.lower())
    fields["vertex_map"] = _follow(cleaned.vertex_map, fields["vertex_map"])
    fields["face_map"] = _follow(cleaned.face_map, fields["face_map"])
    fields["dropped_faces"] += mesh.num_faces - cleaned.mesh.num_faces
    result = QualityResult(**fields)
    return result if seams is None else seams.restored(result)


@checked
def fast(
    mesh: Mesh,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    boundary_weight: float = 1.0,
    seam_weight: float = 1.0,
    color_weight: float = 0.01,
    locked: ArrayLike | None = None,
    threads: int = 0,
    progress: Progress = None,
) -> QualityResult:
    """Simplify any mesh, textured or not, by edge collapse in batches, for speed.

    Parameters
    ----------
    mesh : Mesh
        Not changed. It may be open, non-manifold, in many pieces, with several materials, several
        texture coordinates per vertex and faces without any. Vertices at one place, also those
        that only rounding keeps apart, are welded, corners keep their texture coordinates.
        Vertices of different colours at one place stay apart, but the surface keeps no gap between
        them.
    target_faces : int, optional
        Stop at this many faces or fewer.
    ratio : float in [0, 1], optional
        The fraction of the input's faces that stays; with ``target_faces``, the larger number of
        faces is the target.
    max_error : float, optional
        No step with a larger error (see ``QualityResult.max_error``), in the file's unit. Targets
        combine; the first one reached stops. One is needed.
    boundary_weight, seam_weight : float
        Weight of the planes along boundaries and rims of thin shells, or along borders between
        materials or texture charts, relative to the surface. Where a texture is cut at nearly
        every edge (at more than half of the edges of more than half of the vertices, sharp edges
        aside), such borders have no planes, which would outweigh the surface.
    color_weight : float
        Weight of errors of vertex colours relative to a shifted surface: where colours do not
        change linearly, lines of equal colour are held in place, also by ``max_error``. By
        default the shape comes first. With 0, colours are only interpolated, and decide
        whether a part that vanishes is missed.
    locked : (V,) bool, optional
        Vertices that stay where they are, with one face at least. At one place, one that is
        locked locks all.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result is the same, bit for bit, for any number.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    QualityResult
        Its vertices and faces are in an order in space, not in that of the input.

    Raises
    ------
    InputError
        No target, an option out of its range, or a mesh without a face that has three different
        corners.

    Notes
    -----
    In each pass all edges are priced by the sum of their ends' quadrics [1]_, and the cheapest
    ones collapse, each vertex at most once. Blocks of faces work at the same time; edges between
    blocks follow. A quadric is kept about its own vertex, so that single precision is enough. The
    rules are those of :func:`quality`: nothing but `locked` is locked, no face turns over, and
    pieces vanish where that costs least. Holes and handles close, with edges of three faces, where
    all else would move the surface three times as far and can be seen (``relaxed_collapses``).

    References
    ----------
    .. [1] M. Garland and P. Heckbert, "Surface simplification using quadric error metrics", 1997.

    Examples
    --------
    >>> import manip3d
    >>> square = manip3d.Mesh(
    ...     [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]],
    ...     [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
    ... )
    >>> manip3d.simplify.fast(square, target_faces=2).mesh
    <manip3d.Mesh: 4 vertices, 2 faces>
    """
    options = _core.FastOptions()
    rules = StoppingRules(target_faces, ratio, max_error, max_distance=None)
    options.target_faces, options.max_error, _ = rules.limits(mesh)
    options.boundary_weight = boundary_weight
    options.seam_weight = seam_weight
    seams = color_seams(mesh)
    options.color_weight = 0.0 if seams is not None and seams.is_flat else color_weight
    if seams is not None:
        mesh = seams.mesh
    options.looks = _looks(mesh)
    options.num_threads = threads_of(threads)
    chosen = locked_of(mesh, locked)
    if chosen is not None:
        options.locked = chosen.tolist()
    with reporting(progress, "simplify") as report:
        fields = _core.simplify_fast(mesh, options, report)
    expect_surface(mesh.num_faces - fields["dropped_faces"], mesh.num_faces)
    fields["stop"] = StopReason(fields["stop"].name.lower())
    result = QualityResult(**fields)
    return result if seams is None else seams.restored(result)
