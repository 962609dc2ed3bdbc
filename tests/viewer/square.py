"""The mesh of most tests here."""

from __future__ import annotations

from manip3d import Material, Mesh


def square(*, materials: tuple[Material, ...] = (), face_material: object = None) -> Mesh:
    """A square with its texture upright, seen from +z.

    (0,1) 3---2 (1,1)
          | / |          faces 0 1 2 (lower right), 0 2 3 (upper left)
    (0,0) 0---1 (1,0)
    """
    corners = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    triangles = [[0, 1, 2], [0, 2, 3]]
    return Mesh(
        corners,
        triangles,
        texcoords=[c[:2] for c in corners],
        face_texcoords=triangles,
        face_material=face_material,
        materials=materials,
    )
