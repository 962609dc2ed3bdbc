"""Small meshes whose coordinates are the same bits on every machine.

Only +, -, *, / and square roots make them: sines, also NumPy's, differ between CPUs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from manip3d import Material, Mesh


def _grid_faces(rows: int, columns: int) -> NDArray[np.int32]:
    """Two triangles for each cell of a grid of ``rows`` x ``columns`` vertices."""
    corner = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = (
        s.ravel() for s in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1])
    )
    return np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3)


def _unit_grid(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    x, y = np.meshgrid(np.arange(n) / (n - 1), np.arange(n) / (n - 1))
    return x.ravel(), y.ravel()


def hill(n: int = 25) -> Mesh:
    """An open height field: a smooth hill with four borders."""
    x, y = _unit_grid(n)
    z = 8 * x * (1 - x) * y * (1 - y) / (1 + 3 * x * x)
    return Mesh(np.stack([x, y, z], axis=1), _grid_faces(n, n))


def ball(n: int = 13) -> Mesh:
    """A closed sphere: the six sides of a cube, normalised; sides share no vertices."""
    x, y = _unit_grid(n)
    u, v, w = 2 * x - 1, 2 * y - 1, np.ones_like(x)
    sides = [(u, v, w), (v, u, -w), (v, w, u), (u, -w, v), (w, u, v), (-w, v, u)]
    vertices = np.concatenate([np.stack(side, axis=1) for side in sides])
    vertices /= np.sqrt(vertices[:, 0] ** 2 + vertices[:, 1] ** 2 + vertices[:, 2] ** 2)[:, None]
    faces = [_grid_faces(n, n) + i * n * n for i in range(6)]
    return Mesh(vertices, np.concatenate(faces))


def pipe(n: int = 32, m: int = 12) -> Mesh:
    """An open textured tube: two curved rims, and a seam where each vertex has two UVs."""
    t = np.arange(n) / n * 4 - 2  # the circle, by its rational parametrization in two halves
    s = np.where(t < 0, t + 1, t - 1)
    sign = np.where(t < 0, -1.0, 1.0)
    x, y = sign * (1 - s * s) / (1 + s * s), sign * 2 * s / (1 + s * s)
    vertices = [np.stack([x, y, np.full(n, 0.25 * j)], axis=1) for j in range(m)]
    u, v = np.meshgrid(np.arange(n + 1) / n, np.arange(m) / (m - 1))
    face_texcoords = _grid_faces(m, n + 1)
    faces = face_texcoords // (n + 1) * n + face_texcoords % (n + 1) % n
    return Mesh(
        np.concatenate(vertices),
        faces,
        texcoords=np.stack([u.ravel(), v.ravel()], axis=1),
        face_texcoords=face_texcoords,
        face_material=np.zeros(len(faces), dtype=np.int32),
        materials=[Material(name="paint")],
    )


def floor(n: int = 17) -> Mesh:
    """A flat floor of two materials; a strip of it has no texture coordinates."""
    x, y = _unit_grid(n)
    faces = _grid_faces(n, n)
    column = faces.min(axis=1) % n
    face_texcoords = np.where((column < 3)[:, None], -1, faces)
    return Mesh(
        np.stack([x, y, np.zeros_like(x)], axis=1),
        faces,
        texcoords=np.stack([x, y], axis=1),
        face_texcoords=face_texcoords,
        face_material=(2 * column >= n).astype(np.int32),
        materials=[Material(name="wood"), Material(name="stone")],
    )


def soup(num_vertices: int = 60, num_faces: int = 400) -> Mesh:
    """Random triangles on few vertices: non-manifold edges, duplicates, degenerate faces."""
    rng = np.random.default_rng(2)
    vertices = rng.integers(0, 5, (num_vertices, 3)) / 4
    faces = rng.integers(0, num_vertices, (num_faces, 3), dtype=np.int32)
    return Mesh(vertices, np.concatenate([faces, faces[::7, ::-1], faces[::5]]))


def perforated_shell(holes: int = 4, cells: int = 5, thickness: float = 0.02) -> Mesh:
    """A closed thin piece of a unit ball's shell with holes x holes square holes through it."""
    n = holes * cells
    solid = np.ones((n, n, 1), bool)
    solid[cells // 2 :: cells, cells // 2 :: cells] = False
    solid = np.pad(solid, 1)
    sides = []
    for axis in range(3):
        along, u, v = (np.eye(3, dtype=int)[(axis + k) % 3] for k in range(3))
        for sign in (1, -1):
            at = np.argwhere(solid & ~np.roll(solid, -sign, axis)) + (along if sign > 0 else 0)
            side = np.stack([at, at + u, at + u + v, at + v], axis=1)
            sides.append(side if sign > 0 else side[:, ::-1])
    quads = np.concatenate(sides)
    points, corners = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    corners = corners.reshape(-1, 4)
    a, b = 2.8 * ((points[:, :2] - 1) / n - 0.5).T
    r = 1 + thickness * (points[:, 2] - 1)
    xyz = np.column_stack([r * np.sin(a) * np.cos(b), r * np.sin(b), r * np.cos(a) * np.cos(b)])
    return Mesh(xyz, np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]]))
