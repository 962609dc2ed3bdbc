"""``manip3d convert``: write another format, optionally in metres with +y up."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from manip3d.cli import kinds, scanning
from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import Calibration, Force, MeshOrScan, Output, Quiet
from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, check_output
from manip3d.io import SCAN_SUFFIXES, WRITABLE


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


@over_files(
    kinds.converted_suffixes,
    writable=lambda: (*WRITABLE, *SCAN_SUFFIXES),
    choose=kinds.own_sources,
)
def convert(
    source: MeshOrScan,
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
    """Write a mesh or a scan in another format.

    Meshes: .obj, .ply, .off, .stl, .gltf, .glb; .3mf, .dae to read. Scans: .bin, .pcd, .ply, .3d,
    .las, .laz, .e57, .ptx, .xyz (.xyzi, .xyzn, .xyzrgb), .asc, .pts, .txt, .csv, .npy, .npz. A
    recording of a LiDAR (.pcap, .osf, .mcap) becomes a folder of scans in KITTI's layout; # chooses
    one of several sensors or topics (drive.pcap#1). Several files go to a folder, in the format of
    --to.

    Coordinates of meshes change only with --unit or --up. Those of scans stay, but .e57 and .ptx
    hold points relative to the scanner where its position is known, and this position in the pose;
    what is read from them stays relative in other formats, and a warning states the pose.

    Example: manip3d convert head.obj -o head.glb --unit mm --up z
    """
    from manip3d.io import SCAN_SUFFIXES, WRITABLE
    from manip3d.viewer import kind_of

    shell = Terminal(quiet=quiet)
    expect_kind(source, "mesh", "scan", "range grid", "packets", "drive", verb="convert")
    scanning.expect_packets(source, calibration)
    if source != "-" and kind_of(source) == "scan":
        if unit is not None or up is not None:
            raise typer.BadParameter("--unit and --up are for meshes: scans know their units")
        check_output(output, SCAN_SUFFIXES, force=force, folder=True)
        scanning.convert(source, output, shell, calibration)
        return
    check_output(output, WRITABLE, force=force)
    mesh = open_mesh(source, shell)
    if unit is not None or up is not None:
        mesh = mesh.oriented(unit=unit.value if unit else "m", up=up.value if up else "y")
    mesh.write(output)
    shell.say(f"wrote {output}")
