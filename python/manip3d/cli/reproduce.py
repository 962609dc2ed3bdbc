"""``manip3d reproduce``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import MISSED, Force, Json, Processes, Quiet, Scale, Seed, Tier
from manip3d.cli.terminal import Terminal


def reproduce(
    ids: Annotated[
        list[str] | None,
        typer.Argument(help="Experiments, such as table-2.2; by default all."),
    ] = None,
    list_only: Annotated[
        bool,
        typer.Option("--list", help="List the experiments and the data they want."),
    ] = False,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Folder of the results."),
    ] = Path("results"),
    data: Annotated[
        Tier,
        typer.Option(help="Data to use; auto: real data where it is here."),
    ] = Tier.auto,
    scale: Annotated[
        Scale,
        typer.Option(help="Amount of work; quick: about a minute, full: many minutes."),
    ] = Scale.full,
    dask: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Dask scheduler that distributes the work; local: start one."
        ),
    ] = "",
    force: Force = False,
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Exit with code 4 when a claim does not hold."),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Processes = 0,
    seed: Seed = 0,
) -> None:
    """Run the experiments behind published tables and figures.

    An interrupted run resumes when the same command is given again.

    Example: manip3d reproduce table-2.2 --scale quick -o results
    """
    from manip3d.cli import reproducing

    shell = Terminal(as_json=as_json, quiet=quiet)
    if list_only:
        records = reproducing.listing(ids or [])
        shell.result(records, lambda console: reproducing.show_listing(console, records))
        return
    plan = {"data": data.value, "scale": scale.value, "seed": seed}
    summary = reproducing.reproduce(
        ids or [], output, plan, shell, jobs=jobs, dask=dask, force=force
    )
    shell.result(reproducing.digest(summary), lambda console: reproducing.show(console, summary))
    if summary.failed or summary.problems:
        raise typer.Exit(1)
    if strict and reproducing.some_claim_fails(summary):
        raise typer.Exit(MISSED)
