"""Values of vertices with seams, sampled on the original's surface for simplified meshes.

The values are additional sets of texture coordinates, or colours that change abruptly. A *chart* is
a set of connected faces without a seam between them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.mesh import Mesh
from manip3d.simplify._deformation import barycentric, nearest_faces

if TYPE_CHECKING:
    from numpy.typing import NDArray

_EDGES = ((0, 1), (1, 2), (2, 0))
_MAX_CUTS = 6  # times that a chart with a seam to itself is halved, to at most 64 parts


def charts(mesh: Mesh, values: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return (F,) the chart of each face, so that none of the S sets has a seam within a chart.

    Parameters
    ----------
    mesh : Mesh
    values : (V, S, N) float32
        Values of the vertices in S sets: texture coordinates (N = 2) or colours (N = 3).

    Returns
    -------
    (F,) int64
        Number of each face's chart. Faces that are connected by edges with equal values at both
        ends share a chart. A chart with a seam to itself, such as that of an unrolled pipe, is cut
        until the seam lies between two charts.
    """
    places = numbered(bits_of(mesh.vertices))
    points = numbered(np.column_stack([places, bits_of(values.reshape(len(values), -1))]))
    of_faces = _joined(points[mesh.faces], len(points))
    first, second = _seams(places[mesh.faces], points[mesh.faces])
    middles = values[mesh.faces].astype(np.float64).mean(axis=1).reshape(mesh.num_faces, -1)
    middles = np.where(np.isfinite(middles), middles, 0.0)
    for _ in range(_MAX_CUTS):
        within = of_faces[first] == of_faces[second]
        first, second = first[within], second[within]
        if len(first) == 0:
            break
        of_faces = _halved(of_faces, first, second, middles)
    return of_faces


def texcoords_of(
    values: NDArray[np.float32],
    original: Mesh,
    of_original: NDArray[np.int64],
    simplified: Mesh,
    of_simplified: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
    """Return the values of a simplified mesh, whose vertices are duplicated at seams.

    Parameters
    ----------
    values : (V, S, N) float32
        Values of the original's vertices, as for `charts`.
    original, simplified : Mesh
        Meshes in the same coordinates.
    of_original, of_simplified : (F,) int64
        Chart of each face of the original and of the simplified mesh.

    Returns
    -------
    rows : (R,) int64
        Vertex of ``simplified`` that each new vertex is a copy of.
    faces : (F, 3) int32
        Faces as rows of the new vertices.
    values : (R, S, N) float32
        Values of each new vertex: those of the original at the nearest point of the same chart.
    """
    keys = of_simplified[:, None] * simplified.num_vertices + simplified.faces
    asked, which = np.unique(keys, return_inverse=True)
    chart, vertex = np.divmod(asked, max(1, simplified.num_vertices))
    found = np.zeros((len(asked), *values.shape[1:]), dtype=np.float32)
    faces_of = _rows_by_number(of_original)
    for number, rows in _rows_by_number(chart).items():
        faces = faces_of[number]
        own = values[original.faces[faces]]
        if (own == own[:1, :1]).all():
            found[rows] = own[0, 0]
            continue
        face, points = nearest_faces(original, faces, simplified.vertices[vertex[rows]])
        corners = original.faces[face]
        shares = barycentric(original.vertices[corners], points)
        found[rows] = np.einsum("nc,ncsd->nsd", shares, values[corners].astype(np.float64))
    keys = np.column_stack([vertex, bits_of(found.reshape(len(found), -1))])
    _, kept, alike = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    faces = alike.reshape(-1)[which.reshape(-1)].reshape(-1, 3).astype(np.int32)
    return vertex[kept], faces, found[kept]


def parted(mesh: Mesh, rows: NDArray[np.int64], faces: NDArray[np.int32]) -> Mesh:
    """Return the mesh with the given rows of its vertices, and with faces that refer to them."""
    colors = None if mesh.colors is None else mesh.colors[rows]
    return mesh.replace(vertices=mesh.vertices[rows], faces=faces, colors=colors)


def bits_of(rows: NDArray[Any]) -> NDArray[np.int64]:
    """Return the bits of numbers as integers; equal numbers (-0 and 0, NaN and NaN) are equal."""
    positive = rows + 0.0
    positive = np.where(np.isnan(positive), np.nan, positive).astype(rows.dtype)
    bits = np.int64 if rows.dtype == np.float64 else np.int32
    return np.ascontiguousarray(positive).view(bits).astype(np.int64)


def numbered(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the rows in their lexicographic order; equal rows have the same number."""
    order = np.lexsort(rows.T[::-1])  # np.unique of rows takes three times as long
    is_new = np.r_[False, (rows[order[1:]] != rows[order[:-1]]).any(axis=1)][: len(rows)]
    numbers = np.empty(len(rows), dtype=np.int64)
    numbers[order] = np.cumsum(is_new)
    return numbers


def _rows_by_number(numbers: NDArray[np.int64]) -> dict[int, NDArray[np.int64]]:
    """Return the rows with each number, by number."""
    order = np.argsort(numbers, kind="stable")
    found, starts = np.unique(numbers[order], return_index=True)
    return dict(zip(found.tolist(), np.split(order, starts[1:]), strict=True))


def _joined(corners: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return (F,) the connected component of each face, named by its smallest point."""
    least = np.arange(count)
    while True:
        before = least.copy()
        lowest = least[corners].min(axis=1)
        for corner in range(3):
            np.minimum.at(least, corners[:, corner], lowest)
        least = least[least]
        if np.array_equal(least, before):
            joined: NDArray[np.int64] = least[corners[:, 0]]
            return joined


def _seams(
    places: NDArray[np.int64], points: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of faces that share an edge but differ in the values at its ends."""
    ends = np.concatenate([places[:, edge] for edge in _EDGES])
    values = np.concatenate([points[:, edge] for edge in _EDGES])
    face = np.tile(np.arange(len(places)), 3)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], values[turned] = ends[turned][:, ::-1], values[turned][:, ::-1]
    order = np.lexsort((face, ends[:, 1], ends[:, 0]))
    ends, values, face = ends[order], values[order], face[order]
    is_seam = (ends[1:] == ends[:-1]).all(axis=1) & (values[1:] != values[:-1]).any(axis=1)
    return face[:-1][is_seam], face[1:][is_seam]


def _halved(
    of_faces: NDArray[np.int64],
    first: NDArray[np.int64],
    second: NDArray[np.int64],
    middles: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Halve each chart that has a seam to itself, along the axis in which the sides differ most."""
    halves = 2 * of_faces
    faces_of = _rows_by_number(of_faces)
    for number, rows in _rows_by_number(of_faces[first]).items():
        sides = middles[first[rows]], middles[second[rows]]
        axis = int(np.abs(sides[0] - sides[1]).sum(axis=0).argmax())
        cut = np.median(0.5 * (sides[0][:, axis] + sides[1][:, axis]))
        chosen = faces_of[number]
        halves[chosen] += middles[chosen, axis] > cut
    return numbered(halves[:, None])
