"""Reading and writing of mesh and scan files."""

from __future__ import annotations

import os

from manip3d.mesh import Mesh

__all__ = ["read_mesh"]


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """Read a mesh file."""
    raise NotImplementedError
