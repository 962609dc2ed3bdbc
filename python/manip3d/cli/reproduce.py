"""``manip3d reproduce``: run the experiments behind published tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.data import expect_data_folder
from manip3d.cli.options import MISSED, Force, Json, Processes, Quiet, Scale, Seed, Tier
from manip3d.cli.signals import ended_like_ctrl_c
from manip3d.cli.terminal import Terminal, counted, naming_options, table
from manip3d.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.experiments import RunSummary


def reproduce(
    ids: Annotated[
        list[str] | None,
        typer.Argument(metavar="IDS...", help="Experiments, such as table-2.2; by default all."),
    ] = None,
    list_only: Annotated[
        bool,
        typer.Option("--list", help="List the experiments and the data that they need."),
    ] = False,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", help="Folder of the results."),
    ] = Path("results"),
    data: Annotated[
        Tier,
        typer.Option(
            help="Data to use; auto: real data if they are present. Experiments without such data "
            "are skipped."
        ),
    ] = Tier.auto,
    scale: Annotated[
        Scale,
        typer.Option(help="Amount of work; quick: few small cases, full: all cases."),
    ] = Scale.full,
    dask: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Address of the Dask scheduler that distributes the work; local starts one.",
        ),
    ] = "",
    force: Force = False,
    strict: Annotated[
        bool,
        typer.Option(
            "--strict",
            help="Exit with code 4 when a claim does not hold; an undecided claim has no effect.",
        ),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Processes = 0,
    seed: Seed = 0,
) -> None:
    """Run the experiments behind published tables and figures.

    An interrupted run resumes when the same command is given again; with --force it begins anew.
    Results of other experiments in the folder are kept if their options and version were the same.

    Example: manip3d reproduce table-2.2 --scale quick -o results
    """
    shell = Terminal(as_json=as_json, quiet=quiet)
    if list_only:
        records = listing(ids or [])
        shell.result(records, lambda console: show_listing(console, records))
        return
    expect_data_folder(data)
    plan = {"data": data.value, "scale": scale.value, "seed": seed}
    summary = run_experiments(ids or [], output, plan, shell, jobs=jobs, dask=dask, force=force)
    shell.result(digest(summary), lambda console: show(console, summary))
    if not as_json:
        shell.say(f"'manip3d report {summary.folder}' makes one page of it.")
    if summary.failed or summary.problems:
        raise typer.Exit(1)
    if strict and some_claim_fails(summary):
        raise typer.Exit(MISSED)


def listing(ids: list[str]) -> list[dict[str, Any]]:
    """Return a record of each experiment: id, title, its data sets, and the missing ones.

    ``simulated`` says whether simulated models stand in for missing data.
    """
    from manip3d import datasets
    from manip3d.experiments import Plan, select

    return [
        {
            "id": experiment.id,
            "title": experiment.title,
            "data": list(experiment.data),
            "missing": [n for n in experiment.data if not datasets.is_here(datasets.get(n))],
            "simulated": bool(experiment.cases(Plan(data="simulated", scale="quick"))),
        }
        for experiment in select(ids)
    ]


def show_listing(console: Console, records: list[dict[str, Any]]) -> None:
    """Print one line per experiment."""
    rows = [(r["id"], r["title"], _data_state(r)) for r in records]
    table(console, rows, ("id", "title", "real data"))


def _data_state(record: dict[str, Any]) -> str:
    missing, wanted = len(record["missing"]), len(record["data"])
    if wanted == 0:
        return "none needed"
    if missing == 0:
        return "all here"
    if missing == wanted:
        stand_in = "simulated models" if record["simulated"] else "no simulated models"
        return f"not here: {stand_in} stand in"
    return f"{missing} of {wanted} missing: {', '.join(record['missing'])}"


def run_experiments(
    ids: list[str],
    folder: Path,
    plan: Mapping[str, Any],
    terminal: Terminal,
    *,
    jobs: int,
    dask: str,
    force: bool,
) -> RunSummary:
    """Run experiments in a new results folder or in that of an earlier run."""
    from manip3d.experiments import Plan, run, select

    experiments = select(ids)
    refuse_foreign_folder(folder, force=force)
    try:
        with (
            terminal.progress("experiments") as progress,
            ended_like_ctrl_c(),
            naming_options("data"),
        ):
            summary = run(
                experiments, folder, plan=Plan(**plan), jobs=jobs, dask=dask, overwrite=force,
                progress=progress,
            )  # fmt: skip
    except KeyboardInterrupt:
        command = "the same command without --force" if force else "the same command"
        terminal.say(f"interrupted; finished parts are in {folder}, and {command} continues")
        raise
    say_what_was_done(summary, terminal)
    return summary


def say_what_was_done(summary: RunSummary, terminal: Terminal) -> None:
    terminal.say(
        f"{counted(summary.cases, 'case')} ({summary.resumed} from an earlier run, "
        f"{summary.failed} failed) in {summary.seconds:.1f} s; results in {summary.folder}"
    )
    if summary.skipped:
        kind = "simulated" if summary.results["plan"]["data"] == "simulated" else "real"
        terminal.say(f"skipped, without {kind} data: {', '.join(summary.skipped)}")
    if summary.kept:
        terminal.say(f"kept from an earlier run: {', '.join(summary.kept)}")
    if summary.dropped:
        terminal.say(
            f"replaced, because other options or another version made them: "
            f"{', '.join(summary.dropped)}"
        )
    for problem in summary.problems:
        terminal.say(problem)


def refuse_foreign_folder(folder: Path, *, force: bool | None) -> None:
    """Refuse a folder that holds no results; ``force`` is None in commands without ``--force``."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, got a file")
    ours = (folder / "cases").is_dir() or (folder / "results.json").is_file()
    if folder.is_dir() and any(folder.iterdir()) and not ours and not force:
        cure = "--force uses it all the same" if force is not None else "give another folder"
        raise InputError(f"{folder}: not empty and no results folder; {cure}")


def digest(summary: RunSummary) -> dict[str, Any]:
    """Return counts and verdicts for ``--json``; the rows are in the folder."""
    return {
        "folder": str(summary.folder),
        "cases": summary.cases,
        "resumed": summary.resumed,
        "failed": summary.failed,
        "problems": summary.problems,
        "skipped": summary.skipped,
        "kept": summary.kept,
        "dropped": summary.dropped,
        "seconds": round(summary.seconds, 3),
        "verdicts": {
            name: [
                {"claim": v["claim"], "verdict": v["word"], "data": v["judged_on"]}
                for v in record["verdicts"]
            ]
            for name, record in summary.results["experiments"].items()
        },
    }


def show(console: Console, summary: RunSummary) -> None:
    """Print every claim with its verdict and the kinds of data on which it was judged."""
    rows = [
        (name, verdict["word"], ", ".join(verdict["judged_on"]), verdict["claim"])
        for name, record in summary.results["experiments"].items()
        for verdict in record["verdicts"]
    ]
    if rows:
        table(console, rows, ("experiment", "verdict", "data", "claim"))


def some_claim_fails(summary: RunSummary) -> bool:
    """Return whether a claim does not hold; an undecided one is not refuted."""
    records = summary.results["experiments"].values()
    return any(v["word"] == "does not hold" for record in records for v in record["verdicts"])
