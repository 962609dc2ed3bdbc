"""Conversion of colours of face corners, 0xRRGGBB in sRGB, to materials or vertex colours."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray


def with_corner_colors(mesh: Mesh, colors: NDArray[np.int64], warn: Callable[[str], None]) -> Mesh:
    """Return the mesh with the colours (F, 3) of its face corners; -1 means no colour.

    If the faces without a material have a single colour each, and these are few, the colours become
    materials. Otherwise a vertex gets the mean colour of its corners. Faces with a material keep
    it: their colours go to vertices, unless all are white. ``_core`` uses the same rule for its
    formats.
    """
    face_material, materials, vertex_colors, warning = _core.surface_colors(
        mesh, np.ascontiguousarray(colors, dtype=np.int32)
    )
    if warning:
        warn(warning)
    if materials:
        added = [*mesh.materials, *materials]
        mesh = mesh.replace(face_material=face_material, materials=added)
    return mesh.replace(colors=vertex_colors) if len(vertex_colors) else mesh
