"""Building blocks of the procedural models: grids of points, implicit surfaces, textures."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip3d._util.linear import product
from manip3d.mesh import Material, Mesh

Points = NDArray[np.float64]
Field = Callable[[Points], NDArray[np.float64]]


@dataclass(frozen=True)
class Patch:
    """A piece of surface with its own vertices and one material.

    Attributes
    ----------
    vertices : (V, 3) float64
        Vertices.
    faces : (F, 3) int
        Indices of the vertices of each face.
    texcoords : (V, 2) float64 or None
        Texture coordinates of the vertices; None: the faces have no texture coordinates.
    material : int
        Index of the material; -1: none.
    """

    vertices: Points
    faces: NDArray[np.int64]
    texcoords: NDArray[np.float64] | None = None
    material: int = -1

    def moved(
        self,
        offset: ArrayLike = (0, 0, 0),
        *,
        scale: ArrayLike = 1.0,
        axes: Sequence[int] = (0, 1, 2),
    ) -> Patch:
        """Return the patch scaled, with axes exchanged, then shifted; faces keep their front."""
        factors = np.broadcast_to(np.asarray(scale, float), 3)
        mirrored = np.prod(factors) * np.linalg.det(np.eye(3)[list(axes)]) < 0
        return replace(
            self,
            vertices=(self.vertices * factors)[:, list(axes)] + np.asarray(offset, float),
            faces=self.faces[:, ::-1] if mirrored else self.faces,
        )

    def reversed(self) -> Patch:
        """Return the other side of the same surface."""
        return replace(self, faces=self.faces[:, ::-1])

    def where(self, keep: NDArray[np.bool_]) -> Patch:
        """Return the patch with some of its faces, and with the vertices that they use."""
        used, faces = np.unique(self.faces[keep], return_inverse=True)
        texcoords = None if self.texcoords is None else self.texcoords[used]
        return Patch(self.vertices[used], faces.reshape(-1, 3), texcoords, self.material)

    @property
    def centers(self) -> Points:
        """Means of the corners of the faces, (F, 3)."""
        return np.asarray(self.vertices[self.faces].mean(axis=1))


def grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Two triangles for each cell of a (rows, columns) grid of points."""
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 1, corner + columns
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def sheet(
    points: Points,
    material: int = -1,
    *,
    uv_box: tuple[float, float, float, float] | None = None,
) -> Patch:
    """Make a patch over a (rows, columns, 3) grid, whose front faces along columns x rows.

    Parameters
    ----------
    points : (rows, columns, 3) float64
        Vertices on the grid.
    material : int
        Index of the material.
    uv_box : (u0, v0, u1, v1), optional
        Texture coordinates of the first and of the last corner; u increases along columns.
    """
    rows, columns = points.shape[:2]
    texcoords = None
    if uv_box is not None:
        u, v = np.meshgrid(
            np.linspace(uv_box[0], uv_box[2], columns), np.linspace(uv_box[1], uv_box[3], rows)
        )
        texcoords = np.column_stack([u.ravel(), v.ravel()])
    return Patch(points.reshape(-1, 3), grid_faces(rows, columns), texcoords, material)


def revolved(
    x: ArrayLike,
    radius: ArrayLike,
    sectors: int,
    material: int = -1,
    *,
    uv_box: tuple[float, float, float, float] | None = None,
) -> Patch:
    """Revolve a profile (x, radius) about the x axis; the front is outside if x increases.

    The first and the last column have equal positions, which is a seam unless it is welded.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, sectors + 1)
    cosine, sine = np.cos(angle), np.sin(angle)
    cosine[-1], sine[-1] = cosine[0], sine[0]  # exactly closed
    along, r = np.asarray(x, float)[:, None], np.asarray(radius, float)[:, None]
    points = np.stack([along + 0.0 * cosine, r * cosine, r * sine], axis=-1)
    return sheet(points, material, uv_box=uv_box)


def box(low: ArrayLike, high: ArrayLike, cells: int, material: int = -1) -> list[Patch]:
    """Six unwelded sides of a box, each a grid of ``cells`` x ``cells`` squares."""
    start, size = np.asarray(low, float), np.asarray(high, float) - np.asarray(low, float)
    s = np.linspace(0.0, 1.0, cells + 1)
    u, v = np.meshgrid(s, s)
    sides = []
    for axis in range(3):
        for side in (0.0, 1.0):
            local = np.empty((*u.shape, 3))
            local[..., axis] = side
            first, second = (u, v) if side else (v, u)
            local[..., (axis + 1) % 3], local[..., (axis + 2) % 3] = first, second
            sides.append(sheet(start + local * size, material))
    return sides


def join(patches: Sequence[Patch], materials: Sequence[Material] = ()) -> Mesh:
    """Join patches to one mesh without welding."""
    starts = np.cumsum([0] + [len(p.vertices) for p in patches])
    faces = np.concatenate([p.faces + s for p, s in zip(patches, starts, strict=False)])
    rows = np.cumsum([0] + [0 if p.texcoords is None else len(p.texcoords) for p in patches])
    corners = [
        np.full_like(p.faces, -1) if p.texcoords is None else p.faces + r
        for p, r in zip(patches, rows, strict=False)
    ]
    texcoords = [p.texcoords for p in patches if p.texcoords is not None]
    return Mesh(
        np.concatenate([p.vertices for p in patches]),
        faces,
        texcoords=np.concatenate(texcoords) if texcoords else None,
        face_texcoords=np.concatenate(corners) if texcoords else None,
        face_material=np.repeat([p.material for p in patches], [len(p.faces) for p in patches])
        if materials
        else None,
        materials=materials,
    )


def smooth_union(a: NDArray[np.float64], b: NDArray[np.float64], k: float) -> NDArray[np.float64]:
    """Union of two distance fields, rounded with the length ``k`` (I. Quilez's polynomial)."""
    h = np.maximum(k - abs(a - b), 0.0) / k
    return np.asarray(np.minimum(a, b) - h * h * k / 4.0)


def smooth_cut(a: NDArray[np.float64], b: NDArray[np.float64], k: float) -> NDArray[np.float64]:
    """Difference of two distance fields, ``a`` without ``b``, rounded with the length ``k``."""
    return -smooth_union(-a, b, k)


_CUBE = tuple(itertools.product((0, 1), repeat=3))


def surface_of(field: Field, low: ArrayLike, high: ArrayLike, cell: float) -> Patch:
    """Triangulate the zero set of a field (negative inside) on a grid of cubes: surface nets.

    S. Gibson, Constrained elastic surface nets, MICCAI 1998: one vertex in each cube that the
    surface crosses, here moved onto the surface by Newton steps, and one quad for each crossed grid
    edge. The mesh is closed if the surface does not reach the border of the grid.
    """
    corners_of_grid = zip(np.asarray(low), np.asarray(high), strict=True)
    axes = [np.arange(start, end + cell, cell) for start, end in corners_of_grid]
    values = field(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    inside = values < 0.0
    filled = np.sum(
        [inside[i : i - 1 or None, j : j - 1 or None, k : k - 1 or None] for i, j, k in _CUBE],
        axis=0,
    )
    crossed = (filled > 0) & (filled < 8)
    number = np.full(crossed.shape, -1)
    number[crossed] = np.arange(np.count_nonzero(crossed))
    centers = np.argwhere(crossed) + 0.5
    vertices = on_surface(field, centers * cell + [a[0] for a in axes], cell)
    quads = np.concatenate([_quads_across(inside, number, axis) for axis in range(3)])
    return Patch(vertices, _split_quads(vertices, quads))


def on_surface(field: Field, points: Points, cell: float) -> Points:
    """Move points to the zero set of ``field`` along its gradient, at most half a cell per step."""
    for _ in range(4):
        gradient = np.stack(
            [
                (field(points + offset) - field(points - offset)) / (2e-3 * cell)
                for offset in np.eye(3) * 1e-3 * cell
            ],
            axis=-1,
        )
        squared = np.maximum((gradient**2).sum(axis=-1), 1e-12)
        step = np.clip(field(points) / np.sqrt(squared), -0.5 * cell, 0.5 * cell)
        points = points - gradient * (step / np.sqrt(squared))[..., None]
    return points


def _quads_across(
    inside: NDArray[np.bool_], number: NDArray[np.int64], axis: int
) -> NDArray[np.int64]:
    """Quads across the grid edges along ``axis`` whose ends lie on different sides."""
    starts = np.moveaxis(inside, axis, 0)[:-1, 1:-1, 1:-1]
    ends = np.moveaxis(inside, axis, 0)[1:, 1:-1, 1:-1]
    cells = np.moveaxis(number, axis, 0)
    # moveaxis keeps the order of the other two axes: for y they form a left-handed frame.
    around = [cells[:, :-1, :-1], cells[:, 1:, :-1], cells[:, 1:, 1:], cells[:, :-1, 1:]]
    if axis == 1:
        around.reverse()
    leaving, entering = starts & ~ends, ends & ~starts
    return np.concatenate(
        [
            np.stack([c[leaving] for c in around], axis=-1),
            np.stack([c[entering] for c in around[::-1]], axis=-1),
        ]
    )


def _split_quads(vertices: Points, quads: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles of quads, split at their shorter diagonals."""
    a, b, c, d = quads.T
    first = np.linalg.norm(vertices[a] - vertices[c], axis=1)
    second = np.linalg.norm(vertices[b] - vertices[d], axis=1)
    turned = np.where((first <= second)[:, None], quads, np.roll(quads, -1, axis=1))
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])


def waves(points: Points, count: int, wavelength: float, random: np.random.Generator) -> Points:
    """Smooth noise of about unit amplitude: a sum of plane waves."""
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    lengths = wavelength * random.uniform(0.7, 1.5, count)
    phases = random.uniform(0.0, 2.0 * np.pi, count)
    angle = product(points, (directions * (2.0 * np.pi / lengths)[:, None]).T) + phases
    return np.asarray(np.sin(angle).sum(axis=-1) / np.sqrt(count / 2.0))


def vertex_normals(patch: Patch) -> Points:
    """Area-weighted unit normals of the vertices, (V, 3)."""
    a, b, c = (patch.vertices[patch.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    total = np.zeros_like(patch.vertices)
    for corner in range(3):
        np.add.at(total, patch.faces[:, corner], normal)
    return np.asarray(total / np.linalg.norm(total, axis=1)[:, None])


def png(pixels: NDArray[np.uint8]) -> bytes:
    """Encode (H, W, 3) or (H, W, 4) pixels, the top row first, as a PNG file."""
    height, width, channels = pixels.shape
    kind = {3: 2, 4: 6}[channels]  # true colour, without and with alpha
    lines = np.zeros((height, 1 + width * channels), np.uint8)  # each line: filter 0, samples
    lines[:, 1:] = pixels.reshape(height, -1)

    def chunk(name: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, kind, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", header)
        + chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
        + chunk(b"IEND", b"")
    )
