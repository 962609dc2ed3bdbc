"""Colours of faces and their corners, 0xRRGGBB in sRGB, in meshes that have none of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from manip3d.mesh import Material, Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_MATERIALS = 256
"""The same number as for the formats that the core reads."""


def linear_color(rgb: int) -> tuple[float, float, float]:
    """Linear light of a colour (IEC 61966-2-1), in the steps of 1 / 65535 of the core."""
    red, green, blue = (_linear(rgb >> shift & 0xFF) for shift in (16, 8, 0))
    return red, green, blue


def _linear(byte: int) -> float:
    y = byte / 255.0
    x = y / 12.92 if y <= 0.04045 else ((y + 0.055) / 1.055) ** 2.4
    return round(65535.0 * x) / 65535.0


def with_corner_colors(mesh: Mesh, colors: NDArray[np.int64], warn: Callable[[str], None]) -> Mesh:
    """Return the mesh with colours of corners, (F, 3), -1 where there is none.

    Few colours of whole faces become materials; others become colours of vertices, the mean of
    the corners there.
    """
    known = colors[:, 0] >= 0
    if not known.any():
        return mesh
    is_flat = bool((colors[:, :1] == colors).all())
    distinct = np.unique(colors[known, 0]) if is_flat else np.empty(0)
    if is_flat and len(distinct) <= _MOST_MATERIALS:
        given = mesh.face_material
        chosen = np.full(len(colors), -1, dtype=np.int32) if given is None else given.copy()
        chosen[known] = len(mesh.materials) + np.searchsorted(distinct, colors[known, 0])
        added = [
            Material(name=f"color_{rgb:06X}", base_color=(*linear_color(int(rgb)), 1.0))
            for rgb in distinct
        ]
        return mesh.replace(face_material=chosen, materials=[*mesh.materials, *added])
    if is_flat:
        warn(
            f"faces have more than {_MOST_MATERIALS} colors: each vertex takes the mean of its "
            "faces"
        )
    corners = mesh.faces[known].reshape(-1)
    counts = np.bincount(corners, minlength=mesh.num_vertices)
    mean = np.full((mesh.num_vertices, 3), 255.0)
    for k, shift in enumerate((16, 8, 0)):
        channel = (colors[known].reshape(-1) >> shift) & 0xFF
        sums = np.bincount(corners, weights=channel, minlength=mesh.num_vertices)
        np.divide(sums, counts, out=mean[:, k], where=counts > 0)
    return mesh.replace(colors=np.rint(mean).astype(np.uint8))
