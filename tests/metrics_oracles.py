"""Small shapes, and slow and plain reference implementations, to check the measures with."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import manip3d

Array = NDArray[np.float64]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))


def _segment_distances(p: Array, a: Array, b: Array) -> Array:
    ab = b - a
    length2 = _dot(ab, ab)
    t = np.clip(_dot(p - a, ab) / np.where(length2 > 0, length2, 1.0), 0.0, 1.0)
    return np.asarray(np.linalg.norm(p - (a + t[..., None] * ab), axis=-1))


def face_distances(vertices: Array, faces: NDArray[np.int32], points: Array) -> Array:
    """(N, F) distance of each point to each face: all pairs, edges and interiors apart."""
    p = points[:, None, :]
    a, b, c = (vertices[faces[:, k]][None] for k in range(3))
    edges = [_segment_distances(p, *pair) for pair in ((a, b), (b, c), (c, a))]
    distances = np.minimum.reduce(edges)
    normal = np.cross(b - a, c - a)
    inside = np.broadcast_to(_dot(normal, normal) > 0, distances.shape)
    for start, end in ((a, b), (b, c), (c, a)):
        inside = inside & (_dot(np.cross(end - start, p - start), normal) >= 0)
    unit = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-300)
    return np.where(inside, np.minimum(distances, np.abs(_dot(p - a, unit))), distances)


def texture_error_by_open3d(
    original: manip3d.Mesh, simplified: manip3d.Mesh, num_samples: int
) -> tuple[float, float]:
    """Mean and RMS over random samples of the original, by Open3D's closest points."""
    o3d = pytest.importorskip("open3d")
    rng = np.random.default_rng(0)
    corners = original.vertices[original.faces]
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    faces = rng.choice(original.num_faces, num_samples, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), num_samples)
    points = (weights[:, :, None] * corners[faces]).sum(axis=1)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(simplified.vertices.astype(np.float32), simplified.faces.astype(np.uint32))
    answer = scene.compute_closest_points(o3d.core.Tensor(points.astype(np.float32)))
    last_two = answer["primitive_uvs"].numpy()
    there_weights = np.column_stack([1 - last_two.sum(axis=1), last_two])

    def texcoords(mesh: manip3d.Mesh, at: NDArray[np.integer[Any]], by: Array) -> Array:
        assert mesh.texcoords is not None
        assert mesh.face_texcoords is not None
        return np.asarray((by[:, :, None] * mesh.texcoords[mesh.face_texcoords[at]]).sum(axis=1))

    here = texcoords(original, faces, weights)
    there = texcoords(simplified, answer["primitive_ids"].numpy(), there_weights)
    differences = np.linalg.norm(here - there, axis=1)
    return float(differences.mean()), float(np.sqrt((differences**2).mean()))


def sphere(num_rings: int = 24, radius: float = 1.0) -> manip3d.Mesh:
    """Rings of quads, cut in two, between two poles: closed, without degenerate faces."""
    theta = np.linspace(0, np.pi, num_rings + 1)[1:-1, None]
    phi = np.linspace(0, 2 * np.pi, 2 * num_rings, endpoint=False)
    rings = np.stack(
        np.broadcast_arrays(
            np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
        ),
        axis=-1,
    )
    vertices = np.vstack([rings.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    index = np.arange(rings.shape[0] * rings.shape[1]).reshape(rings.shape[:2])
    turned = np.roll(index, -1, axis=1)
    north, south = np.full_like(index[0], index.size), np.full_like(index[0], index.size + 1)
    corners = [
        (north, index[0], turned[0]),
        (index[-1], south, turned[-1]),
        (index[:-1].ravel(), index[1:].ravel(), turned[1:].ravel()),
        (index[:-1].ravel(), turned[1:].ravel(), turned[:-1].ravel()),
    ]
    return manip3d.Mesh(radius * vertices, np.vstack([np.stack(c, axis=-1) for c in corners]))


def plane(size: int = 8, height: float = 0.0) -> manip3d.Mesh:
    """``size`` x ``size`` unit squares."""
    x, y = np.meshgrid(np.arange(size + 1.0), np.arange(size + 1.0))
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, height)], -1)
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(size), np.arange(size)))
    a = j * (size + 1) + i
    b, c, d = a + 1, a + size + 2, a + size + 1
    return manip3d.Mesh(vertices, np.vstack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]))
