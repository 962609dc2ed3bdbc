"""``manip3d report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import Force, OptionalOutput, Quiet
from manip3d.cli.terminal import Terminal, refuse_existing


def report(
    folder: Annotated[Path, typer.Argument(help="A results folder of 'reproduce'.")],
    output: OptionalOutput = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Turn a results folder into one page: .html (default), .md or .csv."""
    from manip3d.cli import reproducing

    refuse_existing(output, force=force)
    reproducing.write_report(folder, output, Terminal(quiet=quiet))
