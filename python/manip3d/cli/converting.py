"""``manip3d convert``: another format, and on request metres and +y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal
from manip3d.mesh import Mesh

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
# Turns +z up into +y up about x: (x, y, z) -> (x, z, -y).
_Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def convert(
    source: str, output: Path, *, unit: str | None, up: str | None, terminal: Terminal
) -> None:
    """Read, bring to metres and +y up where asked, write."""
    mesh = to_metres_y_up(open_mesh(source, terminal), unit=unit, up=up)
    mesh.write(output)
    terminal.say(f"wrote {output}")


def to_metres_y_up(mesh: Mesh, *, unit: str | None, up: str | None) -> Mesh:
    """The mesh in metres if its ``unit`` is given, with +y up if its ``up`` axis is."""
    vertices, normals = mesh.vertices, mesh.normals
    if unit is not None:
        vertices = vertices * METRES[unit]
    if up == "z":
        vertices = vertices @ _Z_UP_TO_Y_UP.T
        normals = None if normals is None else normals @ _Z_UP_TO_Y_UP.T
    return mesh.replace(vertices=vertices, normals=normals)
