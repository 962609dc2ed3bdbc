"""``manip3d inspect``: has this scan or RGB-D recording been edited?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import MISSED, Force, Jobs, Json, OptionalOutput, Quiet
from manip3d.cli.terminal import Terminal, check_output, counted, table
from manip3d.io import SCAN_SUFFIXES

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.authenticate import Inspection, StreamInspection

EXIT_CODES = {"no_trace": 0, "tampered": 3, "processed": MISSED, "undecidable": MISSED}
"""Exit code of each verdict."""


@over_files(lambda: SCAN_SUFFIXES, writable=lambda: (".html", ".json"), otherwise=".html")
def inspect(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A scan: .bin, .pcd, .ply, .3d, .las, .laz or .e57 file; or an RGB-D recording: a "
            ".mkv file, a recorded folder or an address that 'capture list' shows.",
        ),
    ],
    output: OptionalOutput = None,
    previous: Annotated[
        Path | None, typer.Option(help="Scan of the same scanner a turn earlier.")
    ] = None,
    following: Annotated[
        Path | None, typer.Option(help="Scan of the same scanner a turn later.")
    ] = None,
    lattice: Annotated[
        Path | None,
        typer.Option(help="Lattice of the scanner, as SensorLattice.save writes it (.json)."),
    ] = None,
    sensor: Annotated[
        str, typer.Option(help="Scanner: auto, lattice (HDL-64E), terrestrial or other.")
    ] = "auto",
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
    power: Annotated[
        bool,
        typer.Option(
            "--power/--no-power",
            help="State the share of edits of each class that are found on this scanner.",
        ),
    ] = True,
    policy: Annotated[
        str,
        typer.Option(metavar="VERDICT=CODE,...", help="Other exit codes, for example processed=0."),
    ] = "",
    rows: Annotated[
        Path | None, typer.Option(help="Write the rows of the suspected points to this .csv file.")
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(help="Append the result to this .jsonl file, whose lines are hash-chained."),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Look for edits of a LiDAR scan or an RGB-D recording.

    The exit code is 0 for no_trace, 3 for tampered, 4 for processed and undecidable. No verdict
    says that a scan is authentic: only a keyed watermark does. With -o the evidence is written: a
    page with pictures and boxes (.html), or the numbers (.json; of recordings only these).

    Example: manip3d inspect scan.bin -o evidence.html
    """
    from manip3d import authenticate, datasets, report
    from manip3d.io import read_scan

    codes = _exit_codes(policy)
    if expect_kind(source, "scan", "recording", verb="inspect") == "recording" or _is_rgbd(source):
        check_output(output, (".json",), force=force)
        shell = Terminal(as_json=as_json, quiet=quiet)
        raise typer.Exit(codes[inspect_recording(source, output, shell)])
    check_output(output, report.EVIDENCE_KINDS, force=force)
    check_output(rows, (".csv",), force=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    frame = read_scan(source)
    shell.say(f"read {source}: {counted(frame.num_points, 'point')}")
    with shell.progress("inspect") as progress:
        found = authenticate.inspect(
            frame,
            previous=None if previous is None else read_scan(previous),
            following=None if following is None else read_scan(following),
            lattice=None if lattice is None else authenticate.SensorLattice.load(lattice),
            sensor=sensor,
            origin=origin,
            power=power,
            printed=printed,
            threads=jobs,
            progress=progress,
        )
    if output is not None:
        report.write_evidence(found, output, source=source)
        shell.say(f"wrote {output}")
    if rows is not None:
        report.write_suspected_rows(found, rows)
        shell.say(f"wrote {rows}")
    if log is not None:
        digest = report.append_log(
            log, found, source=source, source_sha256=datasets.file_sha256(Path(source))
        )
        shell.say(f"appended to {log}: {digest}")
    shell.result({"source": source} | found.record(), lambda console: show(console, found))
    raise typer.Exit(codes[found.verdict])


def _is_rgbd(source: str) -> bool:
    """Whether an address is one of RGB-D frames."""
    from manip3d import capture

    scheme = source.partition(":")[0]
    known = {kind.name for kind in capture.sources() if kind.frames == "rgbd"}
    return (
        not Path(source).exists()
        and scheme in known
        and not (scheme == "sim" and not source.startswith("sim:body"))
    )


def inspect_recording(source: str, output: Path | None, shell: Terminal) -> str:
    """Inspect an RGB-D recording, print and write what was found, and return the verdict."""
    import json

    from manip3d import authenticate
    from manip3d.cli.capture import open_source
    from manip3d.io._files import atomic_write

    with open_source(source, shell) as opened:
        frames = list(opened) if not opened.is_live else opened
        with shell.progress("inspect") as progress:
            found = authenticate.inspect_stream(frames, progress=progress)
    record = {"source": source} | found.record()
    if output is not None:
        atomic_write(output, (json.dumps(record, indent=1) + "\n").encode())
        shell.say(f"wrote {output}")
    shell.result(record, lambda console: show_stream(console, found))
    return found.verdict


def show_stream(console: Console, found: StreamInspection) -> None:
    """Print the verdicts with their reasons and where something was inserted."""
    console.print(f"{found.verdict}: {found.reason}", soft_wrap=True)
    console.print()
    rows = [
        (r.name, r.verdict, "" if r.score is None else f"{r.score:.3f}", r.reason)
        for r in found.detectors
    ]
    table(console, rows, ("detector", "verdict", "score", "reason"))
    if found.power:
        console.print()
        cells = [
            (name, f"{power.share:.0%}", f"{power.found} of {power.planted}")
            for name, power in found.power.items()
        ]
        table(console, cells, ("forged streams", "found", "of which"))
    if found.regions:
        console.print()
        boxes = [(str(r.frame), *(str(side) for side in r.box)) for r in found.regions[:20]]
        table(console, boxes, ("frame", "column", "row", "width", "height"))


def _exit_codes(policy: str) -> dict[str, int]:
    """The exit codes, with those of a policy such as ``processed=0,undecidable=0``."""
    codes = dict(EXIT_CODES)
    for part in filter(None, policy.split(",")):
        verdict, _, code = part.partition("=")
        if verdict not in codes or not code.isdecimal() or int(code) > 255:
            raise typer.BadParameter(
                f"expected VERDICT=CODE with one of {', '.join(codes)} and 0 to 255, got {part!r}",
                param_hint="--policy",
            )
        codes[verdict] = int(code)
    return codes


def show(console: Console, found: Inspection) -> None:
    """Print the verdicts with their reasons, the power, and the boxes."""
    from manip3d.report import place_sentence

    console.print(f"{found.verdict}: {found.reason}", soft_wrap=True)
    console.print(place_sentence(found))
    if found.sensor is not None:
        console.print(f"scanner: {found.sensor.name}; {found.sensor.reason}", soft_wrap=True)
    console.print()
    table(console, [(r.title, r.verdict, r.reason) for r in found.detectors])
    if found.power:
        console.print()
        cells = [
            (name, f"{power.share:.0%}", f"{power.found} of {power.planted}")
            for name, power in found.power.items()
        ]
        cells += [(name, "0%", "not looked for") for name in found.blind]
        table(console, cells, ("edits of this class", "found", "planted in clean scans"))
    boxes = [(report.name, box) for report in found.detectors for box in report.boxes]
    if boxes:
        console.print()
        rows = [
            (name, *(f"{value:.2f}" for value in (*box.center, *box.size, box.yaw)))
            for name, box in boxes
        ]
        heads = ("box, metres", "x", "y", "z", "length", "width", "height", "yaw, rad")
        table(console, rows, heads)
