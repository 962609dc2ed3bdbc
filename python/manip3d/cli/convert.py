"""``manip3d convert``: another format, and on request metres and +y up."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from manip3d.cli import scanning
from manip3d.cli.options import Calibration, Force, Output, Quiet, Source
from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, refuse_existing
from manip3d.mesh import Mesh

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
# Turns +z up into +y up about x: (x, y, z) -> (x, z, -y).
_Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def write_converted(
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


class Unit(StrEnum):
    """Units of length of a file's coordinates."""

    m = "m"
    cm = "cm"
    mm = "mm"
    inch = "in"
    ft = "ft"


class Up(StrEnum):
    """The axis that points up in a file."""

    y = "y"
    z = "z"


def convert(
    source: Source,
    output: Output,
    unit: Annotated[
        Unit | None, typer.Option(help="Unit of the input; the output is in metres.")
    ] = None,
    up: Annotated[
        Up | None, typer.Option(help="Axis that is up in the input; the output has +y up.")
    ] = None,
    calibration: Calibration = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write a mesh or a scan in another format. Coordinates change only with --unit or --up.

    Recordings of LiDAR packets (.pcap) become a folder of scans in KITTI's layout.
    """
    from manip3d.viewer import kind_of

    refuse_existing(output, force=force)
    if source != "-" and kind_of(source) == "scan":
        if unit is not None or up is not None:
            raise typer.BadParameter("--unit and --up are for meshes: scans know their units")
        scanning.convert(source, output, Terminal(quiet=quiet), calibration)
        return
    write_converted(
        source,
        output,
        unit=unit.value if unit else None,
        up=up.value if up else None,
        terminal=Terminal(quiet=quiet),
    )
