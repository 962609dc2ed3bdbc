"""``manip3d reproduce``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from manip3d.cli.options import MISSED, Force, Json, Processes, Quiet, Scale, Seed, Tier
from manip3d.cli.terminal import Terminal


def reproduce(
    ids: Annotated[list[str] | None, typer.Argument(help="table-2.2 ...; none: all.")] = None,
    list_only: Annotated[bool, typer.Option("--list", help="List the experiments.")] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder.")] = Path("results"),
    data: Annotated[Tier, typer.Option(help="auto: real data where it is here.")] = Tier.auto,
    scale: Annotated[Scale, typer.Option(help="quick: a minute; full: minutes.")] = Scale.full,
    dask: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Dask scheduler to use; 'local' starts one.")
    ] = "",
    force: Force = False,
    strict: Annotated[bool, typer.Option("--strict", help="Exit 4 when a claim fails.")] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Processes = 0,
    seed: Seed = 0,
) -> None:
    """Run the experiments behind published tables and figures; an interrupted run resumes."""
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
