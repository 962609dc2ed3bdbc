"""The degenerate zoo: small meshes with every defect that real files have, by name.

``MESHES`` go through every public function (``test_zoo.py``); each call must give a valid result
or raise ``manip3d.Error``. ``REFUSED`` are arguments that the constructor of ``Mesh`` refuses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip3d import Material, Mesh

MESHES: dict[str, Mesh] = {}


def animal(make: Callable[[], Mesh]) -> Callable[[], Mesh]:
    MESHES[make.__name__] = make()
    return make


TRIANGLE = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
TETRAHEDRON_FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])


def grid(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """A flat grid of squares of side 1, each cut into two triangles."""
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    vertices = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return vertices, faces


def wrapped_grid(columns: int, rows: int) -> np.ndarray:
    """Faces of a grid whose last column is its first; vertices are numbered row by row."""
    i, j = (index.ravel() for index in np.meshgrid(np.arange(columns), np.arange(rows)))
    after = (i + 1) % columns
    a, b, c, d = (
        row * columns + column for row, column in ((j, i), (j, after), (j + 1, after), (j + 1, i))
    )
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def sphere(columns: int = 12, rows: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """A closed unit sphere: rings of vertices and two poles."""
    longitude, latitude = np.meshgrid(
        np.arange(columns) * 2 * np.pi / columns, np.pi * (np.arange(rows) + 1) / (rows + 1)
    )
    ring = np.column_stack(
        [
            (np.sin(latitude) * np.cos(longitude)).ravel(),
            (np.sin(latitude) * np.sin(longitude)).ravel(),
            np.cos(latitude).ravel(),
        ]
    )
    north, south = len(ring), len(ring) + 1
    around = np.arange(columns)
    after = (around + 1) % columns
    last = (rows - 1) * columns
    faces = np.concatenate(
        [
            wrapped_grid(columns, rows - 1)[:, ::-1],
            np.column_stack([np.full(columns, north), around, after]),
            np.column_stack([np.full(columns, south), last + after, last + around]),
        ]
    )
    return np.vstack([ring, [[0, 0, 1], [0, 0, -1]]]), faces


def textured_grid(columns: int, rows: int) -> dict[str, Any]:
    vertices, faces = grid(columns, rows)
    return {
        "vertices": vertices,
        "faces": faces,
        "texcoords": vertices[:, :2] / (columns, rows),
        "face_texcoords": faces,
    }


# --- Little or nothing --------------------------------------------------------------------------
@animal
def empty() -> Mesh:
    return Mesh([], [])


@animal
def one_vertex() -> Mesh:
    return Mesh([[1, 2, 3]], [])


@animal
def vertices_without_faces() -> Mesh:
    return Mesh(TETRAHEDRON, [], texcoords=[[0, 0]], materials=[Material("unused")])


@animal
def one_face() -> Mesh:
    return Mesh(TRIANGLE, [[0, 1, 2]])


@animal
def tetrahedron() -> Mesh:
    return Mesh(TETRAHEDRON, TETRAHEDRON_FACES)


@animal
def isolated_vertices() -> Mesh:
    vertices = np.vstack([[[9, 9, 9]], TETRAHEDRON, [[-9e9, 0, 0], [0, 0, 0]]])
    return Mesh(vertices, TETRAHEDRON_FACES + 1)


# --- Faces without area -------------------------------------------------------------------------
@animal
def repeated_index() -> Mesh:
    return Mesh(TETRAHEDRON, [[0, 1, 1], [0, 1, 2], [3, 3, 3]])


@animal
def only_repeated_indices() -> Mesh:
    return Mesh(TRIANGLE, [[0, 0, 1], [2, 1, 2], [1, 1, 1]])


@animal
def collinear() -> Mesh:
    return Mesh([[0, 0, 0], [1, 1, 1], [2, 2, 2], [5, 5, 5]], [[0, 1, 2], [1, 2, 3], [0, 1, 3]])


@animal
def all_points_equal() -> Mesh:
    return Mesh(np.full((4, 3), 0.1), TETRAHEDRON_FACES)


@animal
def needles() -> Mesh:
    vertices, faces = grid(6, 4)
    return Mesh(vertices * (1, 1e-9, 1), faces)


@animal
def caps() -> Mesh:
    """Apexes a rounding error away from the opposite side: angles of almost 180 degrees."""
    x = np.arange(9.0)
    y = np.where(x % 2 == 1, 1e-15, 0.0)
    faces = np.column_stack([np.arange(7), np.arange(1, 8), np.arange(2, 9)])
    return Mesh(np.column_stack([x, y, 0 * x]), faces)


@animal
def zero_area_among_good_faces() -> Mesh:
    vertices, faces = grid(3, 3)
    return Mesh(vertices, np.vstack([faces, [[0, 1, 2], [0, 4, 8], [4, 8, 12]]]))


# --- The same thing twice -----------------------------------------------------------------------
@animal
def duplicate_faces() -> Mesh:
    vertices, faces = grid(3, 3)
    return Mesh(vertices, np.vstack([faces, faces, np.roll(faces, 1, axis=1), faces[:, ::-1]]))


@animal
def two_triangles_back_to_back() -> Mesh:
    return Mesh(TRIANGLE, [[0, 1, 2], [2, 1, 0]])


@animal
def pillow() -> Mesh:
    """A sphere pressed flat: front and back coincide, without a common face."""
    vertices, faces = sphere(12, 5)
    return Mesh(vertices * (1, 1, 0), faces)


@animal
def unwelded() -> Mesh:
    vertices, faces = sphere()
    return Mesh(vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3))


@animal
def signed_zeros() -> Mesh:
    return Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, -0.0, -0.0], [1, 0, -0.0], [0, 0, 1]],
        [[0, 1, 2], [3, 5, 4]],
    )


# --- Non-manifold -------------------------------------------------------------------------------
@animal
def bow_tie() -> Mesh:
    return Mesh([[0, 1, 0], [0, 0, 0], [1, 0.5, 0], [2, 1, 0], [2, 0, 0]], [[0, 1, 2], [2, 4, 3]])


@animal
def edge_with_five_faces() -> Mesh:
    angle = np.arange(5) * 2 * np.pi / 5
    wings = np.column_stack([np.cos(angle), np.sin(angle), np.full(5, 0.5)])
    return Mesh(np.vstack([[[0, 0, 0], [0, 0, 1]], wings]), [[0, 1, 2 + i] for i in range(5)])


@animal
def tetrahedra_sharing_an_edge() -> Mesh:
    other = TETRAHEDRON * (-1, -1, 1)
    shared = np.array([0, 4, 5, 3])
    return Mesh(
        np.vstack([TETRAHEDRON, other[1:3]]),
        np.vstack([TETRAHEDRON_FACES, shared[TETRAHEDRON_FACES]]),
    )


@animal
def tetrahedra_sharing_a_vertex() -> Mesh:
    others_vertex = np.array([0, 4, 5, 6])
    return Mesh(
        np.vstack([TETRAHEDRON, -TETRAHEDRON[1:]]),
        np.vstack([TETRAHEDRON_FACES, others_vertex[TETRAHEDRON_FACES][:, ::-1]]),
    )


@animal
def self_touching_boundary() -> Mesh:
    """Two holes of a grid meet in one vertex, whose boundary neighbours are four."""
    vertices, faces = grid(6, 6)
    center = vertices[faces].mean(axis=1)[:, :2]
    hole = ((center > 1) & (center < 3)).all(axis=1) | ((center > 3) & (center < 5)).all(axis=1)
    return Mesh(vertices, faces[~hole])


@animal
def t_junctions() -> Mesh:
    coarse = Mesh([[0, 0, 0], [4, 0, 0], [0, -4, 0]], [[0, 2, 1]])
    vertices, faces = grid(4, 1)
    return Mesh(np.vstack([coarse.vertices, vertices]), np.vstack([coarse.faces, faces + 3]))


@animal
def inconsistent_orientation() -> Mesh:
    vertices, faces = sphere()
    return Mesh(vertices, np.where(np.arange(len(faces))[:, None] % 3 == 0, faces[:, ::-1], faces))


@animal
def moebius_strip() -> Mesh:
    columns = 24
    angle = np.arange(columns) * 2 * np.pi / columns
    across = np.array([-0.3, 0.3])[:, None]
    radius = 1 + across * np.cos(angle / 2)
    vertices = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), across * np.sin(angle / 2)], axis=-1
    )
    faces = wrapped_grid(columns, 1)
    # After one turn the two rims change places.
    crossing = (faces % columns == 0) & ((faces % columns == columns - 1).any(axis=1))[:, None]
    return Mesh(
        vertices.reshape(-1, 3), np.where(crossing, (faces + columns) % (2 * columns), faces)
    )


@animal
def self_intersecting() -> Mesh:
    vertices, faces = sphere()
    return Mesh(
        np.vstack([vertices, vertices + np.array([0.5, 0, 0])]),
        np.vstack([faces, faces + len(vertices)]),
    )


@animal
def non_manifold_soup() -> Mesh:
    random = np.random.default_rng(7)
    return Mesh(random.random((20, 3)), random.integers(0, 20, (200, 3)))


# --- Extreme sizes ------------------------------------------------------------------------------
@animal
def huge() -> Mesh:
    vertices, faces = sphere()
    return Mesh(vertices * 1e9, faces)


@animal
def tiny() -> Mesh:
    vertices, faces = sphere()
    return Mesh(vertices * 1e-9, faces)


@animal
def far_from_the_origin() -> Mesh:
    vertices, faces = sphere()
    return Mesh(vertices + np.array([5e8, -5e8, 5e8]), faces)  # a metre-sized thing, 5e5 km away


@animal
def edges_of_double_precision() -> Mesh:
    vertices, faces = sphere()
    return Mesh(np.vstack([vertices * 1e-160, vertices * 1e150]), np.vstack([faces, faces + 74]))


@animal
def mixed_magnitudes() -> Mesh:
    vertices, faces = grid(4, 4)
    return Mesh(np.vstack([vertices * 1e-6, vertices * 1e6 + 10]), np.vstack([faces, faces + 25]))


@animal
def high_valence_fan() -> Mesh:
    angle = np.linspace(0, 6, 2001)
    rim = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    i = np.arange(1, 2001)
    return Mesh(np.vstack([[[0, 0, 0]], rim]), np.column_stack([0 * i, i, i + 1]))


@animal
def high_valence_closed() -> Mesh:
    vertices, faces = sphere(500, 1)
    return Mesh(vertices, faces)


@animal
def thousands_of_triangles_apart() -> Mesh:
    offsets = np.repeat(np.arange(2000.0)[:, None] * (3, 0, 0), 3, axis=0)
    return Mesh(np.tile(TRIANGLE, (2000, 1)) + offsets, np.arange(6000).reshape(-1, 3))


# --- Flat and regular: every collapse costs the same --------------------------------------------
@animal
def flat_grid() -> Mesh:
    return Mesh(*grid(8, 8))


@animal
def strip() -> Mesh:
    return Mesh(*grid(20, 1))


# --- Attributes ---------------------------------------------------------------------------------
@animal
def equal_texture_coordinates() -> Mesh:
    return Mesh(**(textured_grid(4, 4) | {"texcoords": np.full((25, 2), 0.5)}))


@animal
def mirrored_texture_coordinates() -> Mesh:
    """The texture folds along the middle: UV triangles of both signs."""
    arrays = textured_grid(4, 4)
    u, v = arrays["texcoords"].T
    return Mesh(**(arrays | {"texcoords": np.column_stack([abs(u - 0.5), v])}))


@animal
def huge_texture_coordinates() -> Mesh:
    arrays = textured_grid(4, 4)
    return Mesh(**(arrays | {"texcoords": arrays["texcoords"] * 1e30 - 1e29}))


@animal
def corners_without_texture_coordinates() -> Mesh:
    arrays = textured_grid(4, 4)
    corners = arrays["face_texcoords"].copy()
    corners[::3, 1] = -1
    corners[1::3] = -1
    return Mesh(**(arrays | {"face_texcoords": corners}))


@animal
def no_corner_has_texture_coordinates() -> Mesh:
    return Mesh(*grid(2, 2), texcoords=[], face_texcoords=np.full((8, 3), -1))


@animal
def own_texture_coordinates_for_each_corner() -> Mesh:
    vertices, faces = sphere()
    uv = np.random.default_rng(3).random((faces.size, 2))
    return Mesh(vertices, faces, texcoords=uv, face_texcoords=np.arange(faces.size).reshape(-1, 3))


@animal
def some_faces_without_material() -> Mesh:
    arrays = textured_grid(6, 6)
    faces = np.arange(len(arrays["faces"]))
    uv = np.where((faces % 4 < 3)[:, None], arrays["face_texcoords"], -1)
    return Mesh(
        **(arrays | {"face_texcoords": uv}),
        face_material=faces % 4 - 1,
        materials=[Material("a"), Material("b"), Material("c")],
    )


@animal
def materials_that_are_not_there() -> Mesh:
    return Mesh(*grid(2, 2), face_material=[0, 7, -1, 2**31 - 2, 0, 0, 7, 7])


@animal
def zero_normals() -> Mesh:
    vertices, faces = grid(2, 2)
    corners = np.zeros_like(faces)
    corners[0] = -1
    return Mesh(vertices, faces, normals=[[0, 0, 0]], face_normals=corners)


@animal
def colors_that_differ_at_one_position() -> Mesh:
    vertices, faces = sphere(6, 2)
    colors = np.random.default_rng(5).integers(0, 256, (faces.size, 3))
    return Mesh(vertices[faces.ravel()], np.arange(faces.size).reshape(-1, 3), colors=colors)


_UV = {"texcoords": [[0, 0], [1, 0], [0, 1]], "face_texcoords": [[0, 1, 2]]}

# Changes to a good triangle that make the constructor raise InputError, with a part of its text.
REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "nan_vertex": (
        {"vertices": [[0, 0, 0], [1, np.nan, 0], [0, 1, 0]]},
        "vertices: expected finite",
    ),
    "infinite_vertex": ({"vertices": [[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]}, "vertices"),
    "nan_uv": (_UV | {"texcoords": [[0, 0], [np.nan, 0], [0, 1]]}, "texcoords: expected finite"),
    "infinite_uv": (_UV | {"texcoords": [[0, 0], [-np.inf, 0], [0, 1]]}, "texcoords"),
    "nan_normal": ({"normals": [[0, 0, np.nan]], "face_normals": [[0, 0, 0]]}, "normals"),
    "index_past_the_end": ({"faces": [[0, 1, 3]]}, "faces: expected indices in [0, 3), got 3"),
    "negative_index": ({"faces": [[0, -1, 2]]}, "faces: expected indices in [0, 3), got -1"),
    "index_beyond_int32": ({"faces": [[0, 1, 2**40]]}, "faces"),
    "fractional_index": ({"faces": [[0, 1, 1.5]]}, "faces: expected integers"),
    "faces_without_vertices": ({"vertices": []}, "faces"),
    "four_corners": ({"faces": [[0, 1, 2, 0]]}, "faces: expected shape (N, 3), got (1, 4)"),
    "flat_vertices": ({"vertices": [[0, 0], [1, 0], [0, 1]]}, "expected shape (N, 3)"),
    "words": ({"vertices": [["a", "b", "c"]] * 3}, "vertices: expected numbers"),
    "uv_index_past_the_end": (_UV | {"face_texcoords": [[0, 1, 3]]}, "face_texcoords"),
    "uv_index_below_minus_one": (_UV | {"face_texcoords": [[0, 1, -2]]}, "face_texcoords"),
    "uv_corners_of_another_mesh": (_UV | {"face_texcoords": [[0, 1, 2]] * 2}, "per face (1)"),
    "uv_corners_without_table": ({"face_texcoords": [[0, 0, 0]]}, "face_texcoords"),
    "material_below_minus_one": ({"face_material": [-2]}, "face_material"),
    "too_many_materials": ({"face_material": [0, 0]}, "per face (1)"),
    "color_out_of_range": ({"colors": [[0, 0, 256]] * 3}, "colors"),
    "too_few_colors": ({"colors": [[0, 0, 0]]}, "per vertex (3)"),
}


def volume(mesh: Mesh) -> float:
    """Return the signed volume of a closed mesh."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def arrays_of(mesh: Mesh) -> dict[str, NDArray[Any]]:
    """Return the arrays of a mesh by name."""
    values = {name: getattr(mesh, name) for name in Mesh.__slots__}
    return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
