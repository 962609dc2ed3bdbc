"""``manip3d report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import Force, OptionalOutput, Quiet
from manip3d.cli.terminal import Terminal, check_output


def report(
    folder: Annotated[Path, typer.Argument(help="A results folder that 'reproduce' has written.")],
    output: OptionalOutput = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Turn a results folder into one page: .html, .md or .csv.

    Without -o the page is report.html in the folder.

    Example: manip3d report results -o results.html
    """
    from manip3d.cli import reproducing

    check_output(output, (".html", ".md", ".csv"), force=force)
    reproducing.write_report(folder, output, Terminal(quiet=quiet))
