"""Small shapes, and slow and plain reference implementations, to check the measures with."""

from __future__ import annotations

import numpy as np
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
