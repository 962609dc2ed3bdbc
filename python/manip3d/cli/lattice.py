"""``manip3d lattice``: estimate the lattice of a scanner, and the power of ``inspect`` with it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.kinds import kind_of, path_in
from manip3d.cli.options import Force, Jobs, Json, Output, Quiet, Seed
from manip3d.cli.scanning import frames
from manip3d.cli.terminal import Terminal, check_output, expect_named, naming_options, table

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.lidar import LidarFrame


def lattice(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="SOURCE...",
            help="At least four different scans of one scanner, neither edited nor processed, or "
            "the folder, drive or recording (.pcap, .osf, .mcap) that holds them.",
        ),
    ],
    output: Output,
    planted: Annotated[
        int, typer.Option(min=1, help="Number of edits of each class to plant in a scan.")
    ] = 10,
    most: Annotated[
        int, typer.Option(min=4, help="Largest number of scans to read, evenly spread over all.")
    ] = 20,
    seed: Seed = 0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Estimate the lattice of a scanner, and its power of detection.

    The lattice is estimated from every second scan. To measure its power, the other scans are
    judged by it, unchanged and with planted edits. For other scanners than an HDL-64E, 'inspect
    --lattice' gives the verdict no_trace only with a lattice whose power was measured in this way.
    The command fails if the lattice accuses clean scans, or if 'inspect' would not judge them by
    it. A lattice without steps of the ranges cannot reveal points that were moved along their rays.

    Example: manip3d lattice clean -o lattice.json
    """
    from manip3d import authenticate

    shell = Terminal(as_json=as_json, quiet=quiet)
    expect_named("source", *sources)
    check_output(output, (".json",), force=force)
    scans: list[LidarFrame | str] = []
    for source in sources:
        path_in(source).stat()  # what is not there is no folder with too few scans
        is_recording = kind_of(source) == "packets"
        scans += frames(source, shell) if is_recording else [source]
    with shell.progress("lattice") as progress, naming_options(frames="SOURCE"):
        found = authenticate.calibrate_lattice(
            scans, most=most, planted=planted, rng=seed, threads=jobs, progress=progress
        )
    found.save(output)
    shell.say(f"wrote {output}")
    power = {name: {**vars(each), "share": each.share} for name, each in found.power.items()}
    row = {
        "output": str(output),
        "seed": seed,
        "lasers": len(found.slope),
        "steps": found.steps,
        "range_step": found.range_step,
        "power": power,
    }
    shell.result(row, lambda console: _show(console, row))


def _show(console: Console, found: dict[str, Any]) -> None:
    """Print the numbers of lasers and steps of the lattice, and its power."""
    console.print(
        f"{found['lasers']} lasers, {found['steps']} steps of the encoder a turn (0: none found), "
        f"ranges in steps of {1000 * found['range_step']:g} mm (0: none found)",
        soft_wrap=True,
    )
    rows = [
        (name, f"{each['share']:.0%}", f"{each['found']} of {each['planted']}")
        for name, each in found["power"].items()
    ]
    if rows:
        table(console, rows, ("edits of this class", "found", "planted in clean scans"))
