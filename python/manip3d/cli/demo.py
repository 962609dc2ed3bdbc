"""``manip3d demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import Processes, Quiet, Scale, Seed, Tier
from manip3d.cli.terminal import Terminal


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder.")] = Path("demo"),
    scale: Annotated[Scale, typer.Option(help="quick: a minute; full: some more.")] = Scale.quick,
    data: Annotated[Tier, typer.Option(help="Which data.")] = Tier.auto,
    quiet: Quiet = False,
    jobs: Processes = 0,
    seed: Seed = 0,
) -> None:
    """Run experiments on meshes and depth images and open their report; needs no data."""
    from manip3d.cli import reproducing

    shell = Terminal(quiet=quiet)
    plan = {"data": data.value, "scale": scale.value, "seed": seed}
    reproducing.reproduce(
        reproducing.demo_ids(), output, plan, shell, jobs=jobs, dask="", force=False
    )
    reproducing.open_report(reproducing.write_report(output, None, shell), shell)
