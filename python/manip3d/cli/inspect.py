"""``manip3d inspect``: has this scan been edited?"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import MISSED, Force, Jobs, Json, OptionalOutput, Quiet, Scan
from manip3d.cli.terminal import Terminal, check_output, counted, table
from manip3d.io import SCAN_SUFFIXES

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.authenticate import Inspection

EXIT_CODES = {"authentic": 0, "tampered": 3, "undecidable": MISSED}
"""Exit code of each verdict."""


@over_files(lambda: SCAN_SUFFIXES, writable=lambda: (".html", ".json"), otherwise=".html")
def inspect(
    source: Scan,
    output: OptionalOutput = None,
    origin: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z",
            help="Position of the scanner, metres; by default as the file states it, else as "
            "found from the scan.",
        ),
    ] = None,
    printed: Annotated[
        bool,
        typer.Option(
            "--printed", help="Use the thresholds printed in the dissertation, not calibrated ones."
        ),
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Judge whether a LiDAR scan was edited.

    The exit code is 0 for authentic, 3 for tampered and 4 for undecidable. With -o the evidence is
    written: a page with pictures and boxes (.html), or the numbers (.json).

    Example: manip3d inspect scan.bin -o evidence.html
    """
    from manip3d import authenticate, read_scan, report

    expect_kind(source, "scan", verb="inspect")
    check_output(output, report.EVIDENCE_KINDS, force=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    frame = read_scan(source)
    shell.say(f"read {source}: {counted(frame.num_points, 'point')}")
    with shell.progress("inspect") as progress:
        found = authenticate.inspect(
            frame, origin=origin, printed=printed, threads=jobs, progress=progress
        )
    if output is not None:
        report.write_evidence(found, output, source=source)
        shell.say(f"wrote {output}")
    shell.result({"source": source} | found.record(), lambda console: show(console, found))
    raise typer.Exit(EXIT_CODES[found.verdict])


def show(console: Console, found: Inspection) -> None:
    """Print the verdicts with their reasons, and the boxes."""
    from manip3d.report import place_sentence

    console.print(found.verdict)
    console.print(place_sentence(found))
    console.print()
    table(console, [(r.title, r.verdict, r.reason) for r in found.detectors])
    boxes = [(report.name, box) for report in found.detectors for box in report.boxes]
    if boxes:
        console.print()
        cells = [
            (name, *(f"{value:.2f}" for value in (*box.center, *box.size))) for name, box in boxes
        ]
        table(console, cells, ("box, metres", "x", "y", "z", "length", "width", "height"))
