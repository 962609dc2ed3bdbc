"""Colours of faces and their corners, 0xRRGGBB in sRGB, in meshes that have none of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray


def with_corner_colors(mesh: Mesh, colors: NDArray[np.int64], warn: Callable[[str], None]) -> Mesh:
    """Return the mesh with colours of corners, (F, 3), -1 where there is none.

    Few colours of whole faces become materials; others become colours of vertices, the mean of
    the corners there: the rule of the formats that the core reads.
    """
    face_material, materials, vertex_colors, warning = _core.surface_colors(
        mesh, np.ascontiguousarray(colors, dtype=np.int32)
    )
    if warning:
        warn(warning)
    if materials:
        added = [*mesh.materials, *materials]
        return mesh.replace(face_material=face_material, materials=added)
    return mesh.replace(colors=vertex_colors) if len(vertex_colors) else mesh
