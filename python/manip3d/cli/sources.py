"""Opening what the user names: a file, ``-`` for stdin, or the files of a folder."""

from __future__ import annotations

import sys
from pathlib import Path

from manip3d.cli.terminal import Terminal, counted
from manip3d.io import read_mesh, read_mesh_bytes
from manip3d.mesh import Mesh


def open_mesh(source: str, terminal: Terminal) -> Mesh:
    """Read a mesh from a file or, for ``-``, from stdin, and say what was read.

    Raises
    ------
    FormatError, OSError
        As `manip3d.read_mesh`.
    """
    if source == "-":
        mesh, kind = read_mesh_bytes(sys.stdin.buffer.read()), "stdin"
    else:
        mesh, kind = read_mesh(source), mesh_suffix(Path(source)).lstrip(".")
    terminal.say(
        f"read {source} ({kind}): {counted(mesh.num_vertices, 'vertex', 'vertices')}, "
        f"{counted(mesh.num_faces, 'face')}"
    )
    return mesh


def mesh_suffix(path: Path) -> str:
    """The suffix that tells the format: ``.obj`` for ``head.obj.xz``."""
    name = path.name.lower().removesuffix(".xz").removesuffix(".gz")
    return Path(name).suffix
