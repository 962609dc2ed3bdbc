"""``manip3d report``: write a results folder as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import Force, OptionalOutput, Quiet
from manip3d.cli.terminal import Terminal, check_output


def report(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Results folder that 'reproduce' wrote.")
    ],
    output: OptionalOutput = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Turn a results folder into one page: .html, .md or .csv.

    Without -o the page is report.html in the folder.

    Example: manip3d report results -o results.html
    """
    check_output(output, (".html", ".md", ".csv"), force=force)
    write_page(folder, output, Terminal(quiet=quiet))


def write_page(folder: Path, output: Path | None, terminal: Terminal) -> Path:
    """Write the report of a results folder, and print its path."""
    from manip3d import report

    path = output or folder / "report.html"
    report.write_report(folder, path)
    terminal.say(f"report: {path.resolve()}")
    return path
