"""Division of a mesh into parts along planes, selection of faces, and joining of parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BLOCK = 1 << 18  # rows processed together, so that temporary copies stay small
_SAMPLE = 1 << 17  # largest number of vertices from which the cuts are computed

CROSSING = 0xFFFF
"""Part number of a face whose corners lie in different parts."""

_CORNER_TABLES = (("texcoords", "face_texcoords"), ("normals", "face_normals"))


def compact_rows(
    table: NDArray[Any] | None, index: NDArray[np.int32] | None
) -> tuple[NDArray[Any] | None, NDArray[np.int32] | None]:
    """Return the rows of a table that an index uses, and the index into them; -1 stays -1."""
    if table is None or index is None or not (index >= 0).any():
        return None, None
    is_used = np.zeros(len(table) + 1, dtype=np.bool_)  # the last item stands for index -1
    is_used[index.reshape(-1)] = True
    is_used[-1] = False
    used = np.flatnonzero(is_used)
    rows = np.full(len(table) + 1, -1, dtype=np.int32)
    rows[used] = np.arange(len(used), dtype=np.int32)
    return table[used], rows[index]


def blocks(count: int) -> Iterator[slice]:
    """Yield consecutive slices that together cover ``count`` rows."""
    for start in range(0, count, _BLOCK):
        yield slice(start, min(start + _BLOCK, count))


def part_of_vertices(mesh: Mesh, depth: int, share: float) -> NDArray[np.uint16]:
    """Return the part of each vertex, 0 to 2^depth - 1, which depends on its position only.

    Each part is cut across its longest side so that `share` of its vertices lie below the cut.
    """
    step = max(1, mesh.num_vertices // _SAMPLE)
    sample = mesh.vertices[::step]
    axes = np.zeros(2**depth, dtype=np.int64)
    cuts = np.full(2**depth, np.inf)
    cells = [np.arange(len(sample))]
    for level in range(depth):
        below: list[NDArray[np.int64]] = []
        for number, cell in enumerate(cells):
            node = 2**level + number
            if len(cell) > 1:
                places = sample[cell]
                axes[node] = int(np.argmax(np.ptp(places, axis=0)))
                cuts[node] = np.quantile(places[:, axes[node]], share)
            is_above = sample[cell, axes[node]] >= cuts[node]
            below += [cell[~is_above], cell[is_above]]
        cells = below
    part = np.zeros(mesh.num_vertices, dtype=np.uint16)
    for rows in blocks(mesh.num_vertices):
        places = mesh.vertices[rows]
        node = np.ones(len(places), dtype=np.int64)
        for _ in range(depth):
            is_above = places[np.arange(len(places)), axes[node]] >= cuts[node]
            node = 2 * node + is_above
        part[rows] = node - 2**depth
    return part


def part_of_faces(mesh: Mesh, part: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return the part of each face; :data:`CROSSING` if its corners lie in different parts."""
    of_face = np.empty(mesh.num_faces, dtype=np.uint16)
    for rows in blocks(mesh.num_faces):
        corners = part[mesh.faces[rows]]
        is_whole = (corners == corners[:, :1]).all(axis=1)
        of_face[rows] = np.where(is_whole, corners[:, 0], np.uint16(CROSSING))
    return of_face


def take_faces(mesh: Mesh, chosen: NDArray[np.int64]) -> tuple[Mesh, NDArray[np.int64]]:
    """Return a mesh of the chosen faces, and the rows of its vertices in the whole mesh."""
    is_used = np.zeros(mesh.num_vertices, dtype=np.bool_)
    is_used[mesh.faces[chosen].reshape(-1)] = True
    used = np.flatnonzero(is_used)
    vertices, faces = compact_rows(mesh.vertices, mesh.faces[chosen])
    if vertices is None or faces is None:
        vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32)
    tables: dict[str, Any] = {}
    for table, corners in _CORNER_TABLES:
        of_face = getattr(mesh, corners)
        tables[table], tables[corners] = compact_rows(
            getattr(mesh, table), None if of_face is None else of_face[chosen]
        )
    if mesh.colors is not None:
        tables["colors"] = mesh.colors[used]
    if mesh.face_material is not None:
        tables["face_material"] = mesh.face_material[chosen]
    return Mesh(vertices, faces, materials=mesh.materials, source=mesh.source, **tables), used


def with_used_vertices(mesh: Mesh) -> Mesh:
    """Return the mesh without vertices that no face uses; the mesh itself if there are none."""
    taken, used = take_faces(mesh, np.arange(mesh.num_faces))
    return mesh if len(used) == mesh.num_vertices else taken


def join(parts: Sequence[Mesh], faces: NDArray[np.int32], last: Mesh | None) -> Mesh:
    """Join parts to one mesh with the given faces.

    Parameters
    ----------
    parts : sequence of Mesh
        Parts whose vertices and tables of corners and faces are concatenated; their own `faces`
        are not used.
    faces : (F, 3) int32
        Faces of all parts in order, then those of `last`, as rows of the joined vertices.
    last : Mesh or None
        Mesh with the tables of the faces between parts; its vertices are not used.
    """
    every = [*parts, *([] if last is None else [last])]
    first = every[0]
    tables: dict[str, Any] = {}
    for table, corners in _CORNER_TABLES:
        having = [mesh for mesh in every if getattr(mesh, table) is not None]
        if not having:
            continue
        shift, of_faces = 0, []
        for mesh in every:
            of_face = getattr(mesh, corners)
            if of_face is None:
                of_faces.append(np.full((mesh.num_faces, 3), -1, dtype=np.int32))
                continue
            of_faces.append(np.where(of_face >= 0, of_face + np.int32(shift), np.int32(-1)))
            shift += len(getattr(mesh, table))
        tables[table] = np.concatenate([getattr(mesh, table) for mesh in having])
        tables[corners] = np.concatenate(of_faces)
    if first.colors is not None:
        tables["colors"] = np.concatenate(
            [mesh.colors for mesh in parts if mesh.colors is not None]
        )
    if first.face_material is not None:
        tables["face_material"] = np.concatenate(
            [mesh.face_material for mesh in every if mesh.face_material is not None]
        )
    vertices = np.concatenate([mesh.vertices for mesh in parts])
    return Mesh(vertices, faces, materials=first.materials, source=first.source, **tables)
