"""Fewer faces for the same shape: cleaning and edge collapse."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d._util.showing import Showable
from manip3d.errors import InputError
from manip3d.simplify._parts import blocks

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from manip3d._util.options import Progress
    from manip3d.mesh import Mesh

__all__ = [
    "METHODS",
    "CleanResult",
    "Duplicates",
    "SimplifyResult",
    "StopReason",
    "clean",
    "qem4vr",
    "qem_bp",
    "qem_btp",
    "qem_orig",
    "qem_tp",
]

Duplicates = Literal["same", "any", "keep"]
Boundary = Literal["freeze", "weight"]
Curvature = Literal["turning", "paper"]
SeamMode = Literal["planes", "paper", "lock"]
ComplexVertices = Literal["keep", "freeze"]
LinkCondition = Literal["manifold", "always", "never"]

_BOUNDARIES = {"freeze": _core.BoundaryTerm.FREEZE, "weight": _core.BoundaryTerm.WEIGHT}
_CURVATURES = {
    "turning": _core.BoundaryCurvature.TURNING,
    "paper": _core.BoundaryCurvature.PAPER,
}
_SEAM_MODES = {
    "planes": _core.TextureTerm.SEAM_PLANES,
    "paper": _core.TextureTerm.SEAM_PAPER,
    "lock": _core.TextureTerm.SEAM_LOCK,
}
_COMPLEX_VERTICES = {
    "keep": _core.ComplexVertices.KEEP,
    "freeze": _core.ComplexVertices.FREEZE,
}
_LINK_CONDITIONS = {
    "manifold": _core.LinkCondition.MANIFOLD,
    "always": _core.LinkCondition.ALWAYS,
    "never": _core.LinkCondition.NEVER,
}


@dataclass(frozen=True, eq=False)
class CleanResult(Showable):
    """A cleaned mesh, what became of each vertex and face, and what was removed.

    Attributes
    ----------
    mesh : Mesh
        The remaining vertices and faces, in the input's order; no table has unused rows.
    vertex_map : (V,) int32
        Input vertex -> output vertex, or -1 if it is gone.
    face_map : (F,) int32
        Input face -> output face, or -1 if it is gone.
    merged_vertices : int
        Vertices that went into another one at the same position.
    unreferenced_vertices : int
        Vertices removed because no remaining face uses them.
    degenerate_faces : int
        Faces removed because a vertex is repeated (after welding).
    duplicate_faces : int
        Faces removed because an earlier face is their duplicate.
    changed_faces : int
        Number of those duplicate faces whose material, texture coordinates or colours differ from
        the kept face's: where the picture may change. 0 unless ``duplicates='any'``.
    changed_vertices : int
        Number of merged vertices whose colour differs from the kept vertex's.
    """

    mesh: Mesh
    vertex_map: NDArray[np.int32] = field(repr=False)
    face_map: NDArray[np.int32] = field(repr=False)
    merged_vertices: int
    unreferenced_vertices: int
    degenerate_faces: int
    duplicate_faces: int
    changed_faces: int
    changed_vertices: int


@checked
def clean(mesh: Mesh, *, weld: bool = True, duplicates: Duplicates = "same") -> CleanResult:
    """Remove what no simplification can use, and weld what belongs together.

    Parameters
    ----------
    mesh : Mesh
        Not changed.
    weld : bool
        Merge vertices at bit-identical positions (-0.0 equals 0.0). Corners keep their texture
        coordinates and normals; of several vertex colours that of the lowest vertex stays.
    duplicates : 'same', 'any' or 'keep'
        Rule for further faces on the same three positions. ``'same'`` removes exact copies
        of the first one: same orientation, material, texture coordinates, normals and
        colours, so that the picture does not change. ``'any'`` removes all others, also the back
        sides of surfaces that are stored twice. ``'keep'`` removes none.

    Returns
    -------
    CleanResult

    Raises
    ------
    InputError
        ``duplicates`` is none of the three.

    Notes
    -----
    In this order: weld, remove faces with a repeated index, remove duplicates (compared by
    positions, with or without welding), remove unreferenced vertices, texture coordinates and
    normals: the pre-cleaning of dissertation section 2.3.1. Cleaning twice changes nothing.

    Examples
    --------
    >>> import manip3d
    >>> square = manip3d.Mesh(
    ...     [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]],
    ...     [[0, 1, 2], [5, 3, 4]],
    ... )
    >>> manip3d.simplify.clean(square).mesh.faces.tolist()
    [[0, 1, 2], [0, 2, 3]]
    """
    return CleanResult(**_core.clean(mesh, weld, getattr(_core.Duplicates, duplicates)))


class StopReason(enum.StrEnum):
    """Reason why a simplification ended."""

    TARGET_REACHED = "target_reached"
    ERROR_LIMIT = "error_limit"  #: every collapse left is above ``max_error`` or not legal
    DISTANCE_LIMIT = "distance_limit"  #: no collapse left is known to keep ``max_distance``
    NO_LEGAL_COLLAPSE = "no_legal_collapse"  #: nothing left that keeps the mesh valid
    REFUSED = "refused"  #: the method cannot work on this mesh; see ``message``


@dataclass(frozen=True, eq=False)
class SimplifyResult(Showable):
    """A simplified mesh, how it came about and why it ended there.

    Attributes
    ----------
    mesh : Mesh
        Its vertices are vertices of the input, bit for bit; materials are the input's.
    stop : StopReason
        Missing the target is a result, not an error: read it here.
    max_error : float
        Largest error of a collapse made, in the file's unit: sqrt(surface quadric / its weight).
        It bounds the quadric, not the Hausdorff distance.
    distance_bound : float or None
        Upper bound of the two-sided Hausdorff distance from the input, in the file's unit; at most
        ``max_distance``. ``None`` where no ``max_distance`` was given.
    vertex_map : (V,) int32
        Input vertex -> the output vertex it became; -1 if no face of the output is left there.
    kept : (V',) int32
        Output vertex -> the input vertex it is.
    face_map : (F,) int32
        Input face -> output face, or -1 if it is gone.
    collapses : (C, 2) int32
        The record: input vertices (removed, kept), in order.
    collapse_errors : (C,) float64
    rejected : dict of str to int
        Number of candidate collapses that were rejected, by reason.
    off_seam_collapses : int
        Collapses of seam vertices that had to leave their seam to reach the target (QEM4VR).
    locked_vertices : int
        Output vertices that the method does not move.
    dropped_faces : int
        Input faces with a repeated vertex, left out.
    clamped_costs : int
        Errors that came out below zero by rounding and were taken as zero.
    message : str
        Reason why the method refused the mesh, or empty.
    """

    mesh: Mesh
    stop: StopReason
    max_error: float
    distance_bound: float | None
    vertex_map: NDArray[np.int32] = field(repr=False)
    kept: NDArray[np.int32] = field(repr=False)
    face_map: NDArray[np.int32] = field(repr=False)
    collapses: NDArray[np.int32] = field(repr=False)
    collapse_errors: NDArray[np.float64] = field(repr=False)
    rejected: dict[str, int]
    off_seam_collapses: int
    locked_vertices: int
    dropped_faces: int
    clamped_costs: int
    message: str
    _source: Mesh = field(repr=False)
    _options: _core.QemOptions = field(repr=False)

    def level_of_detail(self, target_faces: int) -> Mesh:
        """Return the mesh as it was when it first had ``target_faces`` or fewer.

        Replays the record: equal to a run of its own for that target, without its cost. The arrays
        of the mesh that was simplified must be as they were.

        Parameters
        ----------
        target_faces : int
            Most faces of the mesh.

        Returns
        -------
        Mesh

        Raises
        ------
        InputError
            ``target_faces`` is negative.

        Examples
        --------
        >>> import numpy as np
        >>> from manip3d import Mesh, simplify
        >>> x, y = np.mgrid[0:20, 0:20]
        >>> corner = np.arange(400).reshape(20, 20)
        >>> squares = ((0, 0), (1, 0), (1, 1), (0, 1))
        >>> a, b, c, d = (corner[i : 19 + i, j : 19 + j].ravel() for i, j in squares)
        >>> faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
        >>> hill = Mesh(np.stack([x, y, np.hypot(x - 9, y - 9)], 2).reshape(-1, 3), faces)
        >>> result = simplify.qem4vr(hill, target_faces=50)
        >>> len(hill.faces), len(result.level_of_detail(200).faces), len(result.mesh.faces)
        (722, 200, 50)
        """
        fields = _core.replay_collapses(
            self._source, self._options, self.collapses, self.collapse_errors, target_faces
        )
        mesh: Mesh = fields["mesh"]
        return mesh


def has_surface(mesh: Mesh) -> bool:
    """Whether some face has its corners at three different places."""
    for rows in blocks(mesh.num_faces):
        a, b, c = (mesh.vertices[mesh.faces[rows, corner]] for corner in range(3))
        if ((a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)).any():
            return True
    return False


def expect_surface(num_faces: int, of: int) -> None:
    """Refuse a mesh of `of` faces that cleaning leaves without any."""
    if num_faces == 0:
        raise InputError(
            f"mesh: expected a face with three different corners, got none of {of} faces"
        )


def faces_of_ratio(num_faces: int, ratio: float) -> int:
    """The number of faces that a fraction of them is: one at least, but for 0."""
    if not 0.0 <= ratio <= 1.0:
        raise InputError(f"ratio: expected a number in [0, 1], got {ratio}")
    return max(math.ceil(ratio), math.floor(ratio * num_faces))


@dataclass(frozen=True)
class StoppingRules:
    """Targets of a simplification as they were given; the first one reached stops it."""

    target_faces: int | None
    ratio: float | None
    max_error: float | None
    max_distance: float | None

    def limits(self, mesh: Mesh) -> tuple[int, float, float]:
        """Return the number of faces, the error and the distance at which to stop.

        Raises
        ------
        InputError
            No rule is given, one is out of its range, or the mesh has no face.
        """
        if mesh.num_faces == 0:
            raise InputError("mesh: expected at least one face, got none")
        if self == StoppingRules(None, None, None, None):
            raise InputError(
                "target_faces, ratio, max_error or max_distance: expected at least one, got none"
            )
        targets = [0]
        if self.target_faces is not None:
            if self.target_faces < 0:
                raise InputError(f"target_faces: expected >= 0, got {self.target_faces}")
            targets.append(self.target_faces)
        if self.ratio is not None:
            targets.append(faces_of_ratio(mesh.num_faces, self.ratio))
        return (
            max(targets),
            math.inf if self.max_error is None else self.max_error,
            math.inf if self.max_distance is None else self.max_distance,
        )


def _simplify(
    mesh: Mesh,
    options: _core.QemOptions,
    rules: StoppingRules,
    *,
    quality_threshold: float,
    link_condition: LinkCondition,
    progress: Progress,
) -> SimplifyResult:
    options.target_faces, options.max_error, options.max_distance = rules.limits(mesh)
    options.quality_threshold = quality_threshold
    options.link_condition = _LINK_CONDITIONS[link_condition]
    with reporting(progress, "simplify") as report:
        fields = _core.simplify_qem(mesh, options, report)
    expect_surface(mesh.num_faces - fields["dropped_faces"], mesh.num_faces)
    fields["stop"] = StopReason(fields["stop"].name.lower())
    return SimplifyResult(**fields, _source=mesh, _options=options)


@checked
def qem4vr(
    mesh: Mesh,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    boundary_weight: float = 5.0,
    seam_weight: float = 100.0,
    curvature: Curvature = "turning",
    seam_mode: SeamMode = "planes",
    complex_vertices: ComplexVertices = "keep",
    quality_threshold: float = 0.0,
    link_condition: LinkCondition = "manifold",
    progress: Progress = None,
) -> SimplifyResult:
    """Simplify by QEM4VR, which keeps boundaries, material seams and texture coordinates.

    Works on any triangle mesh: open, non-manifold, with several materials, several texture
    coordinates per vertex and faces without any. Output vertices are input vertices.

    Parameters
    ----------
    mesh : Mesh
        Not changed. Cleaning it first (:func:`clean`) is step 1 of the published method.
    target_faces : int, optional
        Stop at this many faces or fewer.
    ratio : float in [0, 1], optional
        The fraction of the input's faces that stays; with ``target_faces``, the larger number of
        faces is the target.
    max_error : float, optional
        No collapse with a larger error (see ``SimplifyResult.max_error``), in the file's unit. It
        bounds how far planes of the removed faces are from the vertex that stays, on average: not
        the distance of the surfaces, and nothing at all at boundaries.
    max_distance : float, optional
        The two-sided Hausdorff distance of the surfaces, boundaries included, stays at or below
        this, in the file's unit, by construction; see ``SimplifyResult.distance_bound``. 0 allows
        only collapses that leave the surface exactly as it is. Faces with a repeated vertex do
        not count. Slower: the distance is proved anew at each collapse.
        Targets combine; the first one reached stops. One is needed.
    boundary_weight : float
        W_b of eq. 2.6.
    seam_weight : float
        W_t: weight of the planes along seams, or of a seam vertex's quadric (``'paper'``). More
        keeps seams straighter, less keeps the surface closer. The source's 1000 is a factor of
        quadrics; the experiment ``ablation-seam-weight`` shows what it does as a weight of planes.
    curvature : 'turning' or 'paper'
        Measure of the boundary's curvature at a vertex: |r' x r''| / (2 |r'|^2), which does not
        depend on the unit, or eq. 2.5 as printed, on the mesh scaled to a unit diagonal.
    seam_mode : 'planes', 'paper' or 'lock'
        Planes perpendicular to the faces of each seam edge, and seam vertices that move along
        their seam only, as long as the target can be reached so; the quadrics of seam vertices
        times ``seam_weight``, as printed, which protects nothing where the quadric is zero; or
        seam vertices that never move.
    complex_vertices : 'keep' or 'freeze'
        Boundary vertices with other than two boundary neighbours never move; ``'freeze'`` also
        keeps others from collapsing onto them, as printed.
    quality_threshold : float in [0, 1]
        Divide a cost by min(quality of the worst new face, this); 0 is off, MeshLab's is 0.3.
    link_condition : 'manifold', 'always' or 'never'
        Edges whose collapse must not change the topology: those with a manifold neighbourhood
        at both ends, all, or none.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    SimplifyResult

    Raises
    ------
    InputError
        A mesh without a face that has three different corners, no target, or an option out of its
        range.

    Notes
    -----
    Dissertation sections 2.3 to 2.4.5, read as follows: a boundary vertex collapses only along
    a boundary edge, a boundary loop keeps three edges; the quadrics are weighted by area,
    computed once and accumulated; no face turns over, in space or in texture space. Vertices
    that collapse take the texture coordinates of their target on the same surface.

    Examples
    --------
    >>> import manip3d
    >>> square = manip3d.Mesh(
    ...     [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]],
    ...     [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
    ... )
    >>> manip3d.simplify.qem4vr(square, target_faces=2).mesh
    <manip3d.Mesh: 4 vertices, 2 faces>
    """
    options = _core.QemOptions()
    options.boundary = _core.BoundaryTerm.CURVATURE
    options.boundary_weight = boundary_weight
    options.curvature = _CURVATURES[curvature]
    options.texture = _SEAM_MODES[seam_mode]
    options.seam_weight = seam_weight
    options.complex_vertices = _COMPLEX_VERTICES[complex_vertices]
    return _simplify(
        mesh,
        options,
        StoppingRules(target_faces, ratio, max_error, max_distance),
        quality_threshold=quality_threshold,
        link_condition=link_condition,
        progress=progress,
    )


def _baseline(
    mesh: Mesh,
    boundary: _core.BoundaryTerm,
    texture: _core.TextureTerm,
    rules: StoppingRules,
    *,
    quality_threshold: float,
    link_condition: LinkCondition,
    progress: Progress,
) -> SimplifyResult:
    options = _core.QemOptions()
    options.boundary = boundary
    options.boundary_weight = 1.0
    options.texture = texture
    return _simplify(
        mesh,
        options,
        rules,
        quality_threshold=quality_threshold,
        link_condition=link_condition,
        progress=progress,
    )


@checked
def qem_orig(
    mesh: Mesh,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    quality_threshold: float = 0.0,
    link_condition: LinkCondition = "manifold",
    progress: Progress = None,
) -> SimplifyResult:
    """Simplify by QEM_ORIG: face quadrics alone [Garland & Heckbert 1997], subset placement.

    The baseline without a term for boundaries or texture. Texture coordinates are carried along and
    decide nothing.

    Parameters
    ----------
    mesh, target_faces, ratio, max_error, max_distance, quality_threshold, link_condition, progress
        Same as for :func:`qem4vr`.

    Returns
    -------
    SimplifyResult

    Raises
    ------
    InputError
        Same as for :func:`qem4vr`.

    Examples
    --------
    >>> from manip3d import simplify, simulate
    >>> head = simulate.models.head(faces=2000)
    >>> simplify.qem_orig(head, target_faces=500).mesh.num_faces
    500
    """
    return _baseline(
        mesh,
        _core.BoundaryTerm.NONE,
        _core.TextureTerm.NONE,
        StoppingRules(target_faces, ratio, max_error, max_distance),
        quality_threshold=quality_threshold,
        link_condition=link_condition,
        progress=progress,
    )


@checked
def qem_bp(
    mesh: Mesh,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    boundary: Boundary = "freeze",
    quality_threshold: float = 0.0,
    link_condition: LinkCondition = "manifold",
    progress: Progress = None,
) -> SimplifyResult:
    """Simplify by QEM_BP: :func:`qem_orig` with preserved boundaries.

    Parameters
    ----------
    mesh, target_faces, ratio, max_error, max_distance, quality_threshold, link_condition, progress
        Same as for :func:`qem4vr`.
    boundary : 'freeze' or 'weight'
        Boundary vertices never move, as in MeshLab, which is why the method stops early on open
        meshes; or planes of constant weight 1 alone, section 2.4.2's literal reading.

    Returns
    -------
    SimplifyResult

    Raises
    ------
    InputError
        Same as for :func:`qem4vr`.

    Examples
    --------
    >>> from manip3d import simplify, simulate
    >>> floor = simulate.models.floor(columns=10, rows=6)
    >>> simplify.qem_bp(floor, target_faces=60).mesh.num_faces
    60
    """
    return _baseline(
        mesh,
        _BOUNDARIES[boundary],
        _core.TextureTerm.NONE,
        StoppingRules(target_faces, ratio, max_error, max_distance),
        quality_threshold=quality_threshold,
        link_condition=link_condition,
        progress=progress,
    )


@checked
def qem_tp(
    mesh: Mesh,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    quality_threshold: float = 0.0,
    link_condition: LinkCondition = "manifold",
    progress: Progress = None,
) -> SimplifyResult:
    """Simplify by QEM_TP: quadrics over (x, y, z, u, v) for each texture coordinate (eq. 2.7).

    The texture-preserving baseline. Positions are scaled to a unit diagonal. Refuses a mesh with
    faces without texture coordinates: ``stop`` is ``refused`` and ``message`` says why, the failure
    that the source reports.

    Parameters
    ----------
    mesh, target_faces, ratio, max_error, max_distance, quality_threshold, link_condition, progress
        Same as for :func:`qem4vr`.

    Returns
    -------
    SimplifyResult

    Raises
    ------
    InputError
        Same as for :func:`qem4vr`.

    Examples
    --------
    >>> from manip3d import simplify, simulate
    >>> head = simulate.models.head(faces=2000)
    >>> simplify.qem_tp(head, target_faces=500).mesh.texcoords is not None
    True
    """
    return _baseline(
        mesh,
        _core.BoundaryTerm.NONE,
        _core.TextureTerm.QUADRIC5,
        StoppingRules(target_faces, ratio, max_error, max_distance),
        quality_threshold=quality_threshold,
        link_condition=link_condition,
        progress=progress,
    )


@checked
def qem_btp(
    mesh: Mesh,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    boundary: Boundary = "freeze",
    quality_threshold: float = 0.0,
    link_condition: LinkCondition = "manifold",
    progress: Progress = None,
) -> SimplifyResult:
    """Simplify by QEM_BTP: :func:`qem_tp` with the preserved boundaries of :func:`qem_bp`.

    Parameters
    ----------
    mesh, target_faces, ratio, max_error, max_distance, quality_threshold, link_condition, progress
        Same as for :func:`qem4vr`.
    boundary
        Same as for :func:`qem_bp`.

    Returns
    -------
    SimplifyResult

    Raises
    ------
    InputError
        Same as for :func:`qem4vr`.

    Examples
    --------
    >>> from manip3d import simplify, simulate
    >>> head = simulate.models.head(faces=2000)
    >>> simplify.qem_btp(head, target_faces=500).mesh.num_faces
    500
    """
    return _baseline(
        mesh,
        _BOUNDARIES[boundary],
        _core.TextureTerm.QUADRIC5,
        StoppingRules(target_faces, ratio, max_error, max_distance),
        quality_threshold=quality_threshold,
        link_condition=link_condition,
        progress=progress,
    )


#: The methods compared in chapter 2, by the name that the command line uses.
METHODS: dict[str, Callable[..., SimplifyResult]] = {
    "qem4vr": qem4vr,
    "qem-orig": qem_orig,
    "qem-bp": qem_bp,
    "qem-tp": qem_tp,
    "qem-btp": qem_btp,
}
