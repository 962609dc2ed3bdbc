"""Skinning weights and morph targets of simplified meshes, sampled on the original's surface."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d.io import Deformation
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

_TARGET_WEIGHT = 0.1  # weight of each morph target in sway()


def deformation_of(deformation: Deformation, original: Mesh, simplified: Mesh) -> Deformation:
    """Return skinning weights and morph targets for the vertices of a simplified mesh.

    Parameters
    ----------
    deformation : Deformation
        Skinning weights and morph targets of the original's vertices.
    original, simplified : Mesh
        Meshes in the same coordinates, with the same materials.

    Returns
    -------
    Deformation
        Values of the original at the foot of each vertex, which is its nearest point on the
        original's surface, interpolated by the foot's barycentric coordinates. Of the joints of the
        foot's three corners those with the largest weights are kept, as many as a vertex of the
        original has.
    """
    corners, shares = _feet(original, simplified)
    joints, weights = _heaviest(
        deformation.joints[corners].reshape(len(corners), -1),
        (deformation.weights[corners] * shares[:, :, None]).reshape(len(corners), -1),
        deformation.joints.shape[1],
    )
    return Deformation(
        joints,
        weights,
        _blended(deformation.targets, corners, shares),
        _blended(deformation.target_normals, corners, shares),
    )


def rows_of(deformation: Deformation, rows: NDArray[np.int64]) -> Deformation:
    """Return the deformation of a mesh whose vertices are ``rows`` of another; rows may repeat."""
    return Deformation(
        deformation.joints[rows],
        deformation.weights[rows],
        deformation.targets[:, rows],
        deformation.target_normals[:, rows],
    )


def sway(deformation: Deformation, size: float) -> NDArray[np.float64]:
    """Return (V, 3) a small movement of the vertices that shows where a surface bends.

    A straight arm has no curvature at its elbow, and a face at rest none of its smile's, so that
    simplification in the rest pose removes vertices that other poses need. The pose returned here,
    in which each joint moves by `size` in a direction of its own and each morph target has a weight
    of a tenth, has that curvature. It is linear in weights and targets, so that the movement of
    the simplified mesh's vertices can be computed and subtracted exactly.
    """
    count, influences = deformation.joints.shape
    moved = np.zeros((count, 3))
    directions = _directions(int(deformation.joints.max(initial=0)) + 1)
    for influence in range(influences):
        weight = size * deformation.weights[:, influence, None].astype(np.float64)
        moved += weight * directions[deformation.joints[:, influence]]
    for number, target in enumerate(deformation.targets):
        share = _TARGET_WEIGHT if number % 2 == 0 else -_TARGET_WEIGHT
        moved += share * target.astype(np.float64)
    return moved


def _directions(count: int) -> NDArray[np.float64]:
    """Return (N, 3) unit vectors, each far from those before; the same bits on every machine."""
    # Steps of a low-discrepancy sequence.
    steps = np.array([0.8191725134, 0.6710436067, 0.5497004779])
    offsets = (np.arange(1, count + 1)[:, None] * steps) % 1.0 - 0.5
    directions: NDArray[np.float64] = offsets / np.sqrt(_dot(offsets, offsets))[:, None]
    return directions


def _blended(
    table: NDArray[np.float32], corners: NDArray[np.int32], shares: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Return (T, N, 3) the rows of each morph target, interpolated at the feet."""
    blended = np.zeros((len(table), len(corners), 3))
    for corner in range(3):
        blended += table[:, corners[:, corner]] * shares[:, corner, None]
    return blended.astype(np.float32)


def _heaviest(
    joints: NDArray[np.uint16], weights: NDArray[np.float64], most: int
) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    """Return the `most` joints of each row with the largest weights, normalised to a sum of 1."""
    count = len(joints)
    kept_joints = np.zeros((count, most), dtype=np.uint16)
    kept_weights = np.zeros((count, most), dtype=np.float32)
    if most == 0 or count == 0:
        return kept_joints, kept_weights
    keys = np.arange(count)[:, None] * 2**16 + joints  # a number for each pair of row and joint
    pairs, which = np.unique(keys, return_inverse=True)
    sums = np.bincount(which.reshape(-1), weights.reshape(-1))
    rows = pairs >> 16
    order = np.lexsort((pairs, -sums, rows))
    rows, sums, pairs = rows[order], sums[order], pairs[order]
    place = np.arange(len(rows)) - np.searchsorted(rows, rows)
    is_kept = (place < most) & (sums > 0.0)
    kept_joints[rows[is_kept], place[is_kept]] = pairs[is_kept] & 0xFFFF
    kept_weights[rows[is_kept], place[is_kept]] = sums[is_kept]
    total = kept_weights.sum(axis=1, keepdims=True)
    np.divide(kept_weights, total, out=kept_weights, where=total > 0.0)
    return kept_joints, kept_weights


def _feet(original: Mesh, simplified: Mesh) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return (N, 3) corners of the face under each vertex's foot, and barycentric coordinates.

    If possible, a foot lies on a face of the vertex's own material with a similar normal, because
    surfaces that touch, such as lips, may move differently.
    """
    faces, looks = _faces_of_vertices(simplified)
    materials = _materials(simplified)[faces]
    of_original = _materials(original)
    own_looks = _looks(original)
    found = np.zeros(simplified.num_vertices, dtype=np.int64)
    points = simplified.vertices.copy()
    for material in np.unique(materials):
        asked = np.flatnonzero(materials == material)
        chosen = np.flatnonzero(of_original == material)
        if len(chosen) == 0:
            chosen = np.arange(original.num_faces)
        found[asked], points[asked] = nearest_faces(original, chosen, simplified.vertices[asked])
        facing = _dot(own_looks[found[asked]], looks[asked])
        behind = asked[facing < 0.0]
        axes = np.abs(looks[behind]).argmax(axis=1)
        signs = np.sign(looks[behind, axes])
        for axis in range(3):
            for sign in (-1.0, 1.0):
                turned = behind[(axes == axis) & (signs == sign)]
                alike = chosen[sign * own_looks[chosen, axis] > 0.0]
                if len(turned) > 0 and len(alike) > 0:
                    nearest = nearest_faces(original, alike, simplified.vertices[turned])
                    found[turned], points[turned] = nearest
    corners = original.faces[found]
    return corners, barycentric(original.vertices[corners], points)


def nearest_faces(
    mesh: Mesh, chosen: NDArray[np.int64], points: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the nearest of the given faces to each point, and the nearest point on it."""
    used, faces = np.unique(mesh.faces[chosen], return_inverse=True)
    some = Mesh(mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32))
    _, face, foot = _core.closest_points(some, np.ascontiguousarray(points), math.inf, 0, None)
    return chosen[face], foot


def _materials(mesh: Mesh) -> NDArray[Any]:
    if mesh.face_material is None:
        return np.full(mesh.num_faces, -1)
    return mesh.face_material


def _looks(mesh: Mesh) -> NDArray[np.float64]:
    """Return (F, 3) face normals whose length is twice the area."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    looks: NDArray[np.float64] = np.cross(b - a, c - a)
    return looks


def _faces_of_vertices(mesh: Mesh) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return one face of each vertex, and (N, 3) the sum of the normals of all its faces."""
    face = np.zeros(mesh.num_vertices, dtype=np.int64)
    looks = np.zeros((mesh.num_vertices, 3))
    of_faces = _looks(mesh)
    for corner in range(3):
        face[mesh.faces[:, corner]] = np.arange(mesh.num_faces)
        np.add.at(looks, mesh.faces[:, corner], of_faces)
    return face, looks


def barycentric(triangles: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, 3) barycentric coordinates of points on (N, 3, 3) triangles."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    offset = points - triangles[:, 0]
    aa, ab, bb = _dot(first, first), _dot(first, second), _dot(second, second)
    ap, bp = _dot(first, offset), _dot(second, offset)
    area = aa * bb - ab * ab
    # A triangle without area is treated as the longer of its two edges.
    is_flat = ~(area > 1e-12 * aa * bb)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(is_flat, np.where(aa >= bb, ap / aa, 0.0), (bb * ap - ab * bp) / area)
        v = np.where(is_flat, np.where(aa < bb, bp / bb, 0.0), (aa * bp - ab * ap) / area)
    u, v = (np.where(np.isfinite(share), share, 0.0) for share in (u, v))
    shares = np.stack([1.0 - u - v, u, v], axis=1)
    shares = np.clip(shares, 0.0, 1.0)
    normalised: NDArray[np.float64] = shares / shares.sum(axis=1, keepdims=True)
    return normalised


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) the dot products of corresponding rows."""
    products = a * b
    return np.asarray(products[:, 0] + products[:, 1] + products[:, 2])
