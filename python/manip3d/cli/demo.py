"""``manip3d demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import Processes, Quiet, Seed, Tier
from manip3d.cli.terminal import Terminal


def demo(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Folder of the results and of the page."),
    ] = Path("demo"),
    data: Annotated[
        Tier, typer.Option(help="Data to use; auto: recorded data where MANIP3D_DATA has them.")
    ] = Tier.auto,
    quiet: Quiet = False,
    jobs: Processes = 0,
    seed: Seed = 0,
) -> None:
    """Tell four stories with pictures and their commands, then the numbers; open the page.

    Needs no data and no network. Run again, it goes on where it stopped.

    Example: manip3d demo -o demo
    """
    from manip3d._util.extras import require

    require("demo")
    from manip3d.cli import reproducing

    shell = Terminal(quiet=quiet)
    done = reproducing.demo(output, data=data.value, seed=seed, jobs=jobs, terminal=shell)
    reproducing.open_report(done.page, shell)
    if done.summary.failed or done.summary.problems:
        raise typer.Exit(1)
