"""Options and arguments that several commands share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

MISSED = 4
"""Exit code if a target was missed with ``--strict``, or if the verdict is undecidable."""

Source = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="A mesh, a scan, a depth image or a recording, or - for a mesh from stdin.",
    ),
]
MeshOrScan = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="A mesh, a scan or a recording of a LiDAR, or - for a mesh from stdin.",
    ),
]
Scan = Annotated[
    str,
    typer.Argument(
        metavar="SCAN",
        help="A scan: .bin, .pcd, .ply, .3d, .las, .laz, .e57, .ptx or text (.xyz, ...).",
    ),
]
Output = Annotated[
    Path, typer.Option("-o", "--output", help="Output; its suffix chooses the format.")
]
OptionalOutput = Annotated[
    Path | None, typer.Option("-o", "--output", help="Output; its suffix chooses the format.")
]
Calibration = Annotated[
    Path | None,
    typer.Option(help="Calibration file of a Velodyne HDL-64E (db.xml or YAML), for .pcap files."),
]
RgbdPlace = Annotated[
    str,
    typer.Argument(
        metavar="SOURCE",
        help="A recording (.mkv), a folder of images, or an address that 'capture list' shows.",
    ),
]
FolderIntrinsics = Annotated[
    str,
    typer.Option(
        "--intrinsics",
        help="Depth camera of a folder of images or a bag: fx,fy,cx,cy, a file or a "
        "preset such as kinect-v2 ('manip3d depth --help' lists them).",
    ),
]


_KNOWN_UNITS = "a number of units per metre, mm, tum or m"


def _units_per_metre(text: str) -> float:
    """Return the number of depth units in a metre that a number or the name of a unit states."""
    from manip3d.io._depth_units import units_per_metre

    try:
        number = 0.0 if _is_zero(text) else units_per_metre(text)
    except ValueError:
        number = None
    if number is None:
        raise typer.BadParameter(f"expected {_KNOWN_UNITS}, got {text!r}")
    return number


def _is_zero(text: str) -> bool:
    """Return whether a text is the number 0, such as ``0.00``."""
    try:
        return float(text) == 0.0
    except ValueError:
        return False


FolderUnits = Annotated[
    float,
    typer.Option(
        "--units-per-metre",
        "--unit",
        parser=_units_per_metre,
        metavar="UNIT",
        help=f"Depth unit of a folder of images or a bag, as for 'manip3d depth': {_KNOWN_UNITS}; "
        "0: mm, or tum for a TUM sequence.",
    ),
]
FolderRate = Annotated[
    float,
    typer.Option(
        "--rate",
        min=0,
        help="Frames per second of a folder of images whose names are no times; 0: 30.",
    ),
]
DepthUnit = Annotated[
    str,
    typer.Option(
        "--unit",
        help="Unit of a depth image, as for 'manip3d depth': mm, tum, m, kinect-raw, nyu, sun, a "
        "number of units per metre, or guess.",
    ),
]
MostFrames = Annotated[
    int | None, typer.Option("--frames", min=1, help="Stop after this many frames.")
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]
Quiet = Annotated[
    bool, typer.Option("--quiet", "-q", help="Print no messages, warnings or progress.")
]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", min=0, help="Number of threads; 0: all cores."),
]
FolderJobs = Annotated[
    int,
    typer.Option(
        "--jobs",
        "-j",
        min=0,
        help="Number of threads, or of processes for several files; 0: all cores.",
    ),
]
FileJobs = Annotated[
    int,
    typer.Option(
        "--jobs", "-j", min=0, help="Number of processes for several files; 0: all cores."
    ),
]
FastJobs = Annotated[
    int,
    typer.Option(
        "--jobs",
        "-j",
        min=0,
        help="Number of threads of --mode fast, or of processes for several files; 0: all cores.",
    ),
]
Processes = Annotated[
    int, typer.Option("--jobs", "-j", min=0, help="Number of processes; 0: all cores.")
]
Dask = Annotated[
    str,
    typer.Option(
        metavar="ADDRESS",
        help="Address of the Dask scheduler that distributes the files; local starts one (extra "
        "dask).",
    ),
]
_TABLE = "Table of the results, .csv or .parquet, one row a file; a stopped run is resumed from it."
Table = Annotated[str, typer.Option(metavar="FILE", help=_TABLE)]
TableBesideOutputs = Annotated[
    str,
    typer.Option(metavar="FILE", help=f"{_TABLE} Default with -o: results.csv in that folder."),
]
TableOfNow = Annotated[
    str,
    typer.Option(
        metavar="FILE",
        help="Table of the results, .csv or .parquet, one row a file. All rows are computed anew "
        "in each run.",
    ),
]
To = Annotated[
    str,
    typer.Option(
        metavar="SUFFIX", help="Suffix of the outputs of several files; it chooses their format."
    ),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random choice.")]
Force = Annotated[bool, typer.Option("--force", help="Replace existing outputs.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit with code 4 when a target is missed.")]


class Tier(StrEnum):
    """Data that experiments use."""

    auto = "auto"
    real = "real"
    simulated = "simulated"


class Scale(StrEnum):
    """Amount of work of experiments."""

    quick = "quick"
    full = "full"
