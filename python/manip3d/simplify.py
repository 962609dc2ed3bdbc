"""Fewer faces for the same shape: cleaning and edge collapse."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, get_args

from manip3d import _core
from manip3d.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from manip3d.mesh import Mesh

__all__ = ["CleanResult", "Duplicates", "clean"]

Duplicates = Literal["same", "any", "keep"]


@dataclass(frozen=True)
class CleanResult:
    """A cleaned mesh, what became of each vertex and face, and what was removed.

    Attributes
    ----------
    mesh : Mesh
        What remains, in the input's order; no table has unused rows.
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
        Of those, faces whose material, texture coordinates or colours differ from the kept
        face's: where the picture may change. 0 unless ``duplicates='any'``.
    changed_vertices : int
        Of the merged vertices, those whose colour differs from the kept vertex's.
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
        Of faces on the same three positions the first one stays. ``'same'`` removes the exact
        copies of it: same orientation, material, texture coordinates, normals and colours, so
        that the picture does not change. ``'any'`` removes all others, also the back sides of
        surfaces that are stored twice. ``'keep'`` removes none.

    Returns
    -------
    CleanResult

    Raises
    ------
    InputError
        ``duplicates`` is none of the three.

    Notes
    -----
    In this order: weld, remove faces with a repeated index, remove duplicates (told by
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
    if duplicates not in get_args(Duplicates):
        raise InputError(f"duplicates: expected 'same', 'any' or 'keep', got {duplicates!r}")
    return CleanResult(**_core.clean(mesh, weld, getattr(_core.Duplicates, duplicates)))
