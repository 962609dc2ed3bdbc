"""Meshes that a file composes of pieces, each of which may be instanced several times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.linear import determinant, product
from manip3d.errors import FormatError
from manip3d.io._face_colors import with_corner_colors
from manip3d.mesh import Material, Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

NONE = -1  # index that means no texture coordinate, normal, colour or material


def _no_rows(width: int) -> Callable[[], NDArray[np.float64]]:
    return lambda: np.empty((0, width))


@dataclass
class Piece:
    """A mesh with properties of its faces and of their corners; `NONE` means no property."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    material: NDArray[np.int64]
    corners: NDArray[np.int64]
    """(F, 3) row numbers in ``texcoords``."""
    normal_corners: NDArray[np.int64]
    """(F, 3) row numbers in ``normals``."""
    colors: NDArray[np.int64]
    """(F, 3) colours of the corners, 0xRRGGBB."""
    texcoords: NDArray[np.float64] = field(default_factory=_no_rows(2))
    normals: NDArray[np.float64] = field(default_factory=_no_rows(3))

    @classmethod
    def plain(cls, vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Piece:
        """Return a piece without properties."""
        none = np.full(faces.shape, NONE, dtype=np.int64)
        return cls(vertices, faces, none[:, 0].copy(), none.copy(), none.copy(), none.copy())

    def placed(self, matrix: NDArray[np.float64]) -> Piece:
        """Return the piece transformed by a (4, 4) matrix: (x, y, z, 1) @ matrix.

        If the matrix mirrors, the corners of the faces are reversed, so that faces still point
        outwards.
        """
        turn = matrix[:3, :3]
        mirrors = determinant(turn) < 0.0
        order = [0, 2, 1] if mirrors else [0, 1, 2]
        return Piece(
            product(self.vertices, turn) + matrix[3, :3],
            self.faces[:, order],
            self.material,
            self.corners[:, order],
            self.normal_corners[:, order],
            self.colors[:, order],
            self.texcoords,
            _turned_normals(self.normals, turn) * (-1.0 if mirrors else 1.0),
        )


def _turned_normals(normals: NDArray[np.float64], turn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return transformed normals of unit length.

    They are transformed by the cofactor matrix, which unlike the inverse transpose also exists for
    singular matrices. It turns normals inwards if the matrix mirrors.
    """
    cofactors = np.cross(turn[[1, 2, 0]], turn[[2, 0, 1]])
    turned = product(normals, cofactors)
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    unit: NDArray[np.float64] = np.zeros_like(turned)
    np.divide(turned, length, out=unit, where=length > 0.0)
    return unit


def join(
    pieces: Sequence[Piece], materials: Sequence[Material], warn: Callable[[str], None]
) -> Mesh:
    """Return the mesh of one or more pieces.

    Raises
    ------
    FormatError
        A vertex position is not finite.
    """
    vertices = np.concatenate([piece.vertices for piece in pieces])
    if not np.isfinite(vertices).all():
        raise FormatError("vertices: expected finite numbers after the transforms")
    faces = _shifted([(piece.faces, len(piece.vertices)) for piece in pieces])
    face_texcoords = _shifted([(piece.corners, len(piece.texcoords)) for piece in pieces])
    face_normals = _shifted([(piece.normal_corners, len(piece.normals)) for piece in pieces])
    texcoords = np.concatenate([piece.texcoords for piece in pieces])
    normals = np.concatenate([piece.normals for piece in pieces])
    mesh = Mesh(
        vertices,
        faces,
        texcoords=texcoords if len(texcoords) else None,
        face_texcoords=face_texcoords if len(texcoords) else None,
        normals=normals if len(normals) else None,
        face_normals=face_normals if len(normals) else None,
        face_material=np.concatenate([piece.material for piece in pieces]) if materials else None,
        materials=materials,
    )
    return with_corner_colors(mesh, np.concatenate([piece.colors for piece in pieces]), warn)


def _shifted(tables: Sequence[tuple[NDArray[np.int64], int]]) -> NDArray[np.int64]:
    """Return the indices into several tables as indices into their concatenation.

    Each item of ``tables`` is an array of indices, with the number of rows of its table.
    """
    shifted, first = [], 0
    for indices, num_rows in tables:
        shifted.append(np.where(indices < 0, NONE, indices + first))
        first += num_rows
    return np.concatenate(shifted)
