"""``manip3d reproduce``, ``report`` and ``demo``."""

from __future__ import annotations

import os
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d import datasets
from manip3d.cli.terminal import Terminal, table
from manip3d.errors import InputError
from manip3d.experiments import Plan, RunSummary, counted, run, select

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.report.demo import Demo


def listing(ids: list[str]) -> list[dict[str, Any]]:
    """The experiments: id, title, the data they want, and what of it is missing."""
    return [
        {
            "id": experiment.id,
            "title": experiment.title,
            "data": list(experiment.data),
            "missing": [n for n in experiment.data if not datasets.is_here(datasets.get(n))],
        }
        for experiment in select(ids)
    ]


def show_listing(console: Console, records: list[dict[str, Any]]) -> None:
    """One line per experiment."""
    rows = [(r["id"], r["title"], _data_state(r)) for r in records]
    table(console, rows, ("id", "title", "real data"))


def _data_state(record: dict[str, Any]) -> str:
    missing, wanted = len(record["missing"]), len(record["data"])
    if missing == 0:
        return "all here"
    if missing == wanted:
        return "not here: simulated models stand in"
    return f"{missing} of {wanted} missing: {', '.join(record['missing'])}"


def demo(folder: Path, *, data: Any, seed: int, jobs: int, terminal: Terminal) -> Demo:
    """Run the demo into a folder, new or of an earlier demo; say where its page is."""
    from manip3d.report.demo import run_demo

    _refuse_foreign_folder(folder, force=False)
    terminal.say("four stories, then the tables; about two minutes on two cores")
    try:
        with terminal.progress("demo") as bar:
            done = run_demo(folder, data=data, seed=seed, jobs=jobs, progress=bar or terminal.line)
    except KeyboardInterrupt:
        terminal.say(f"interrupted; what had finished is in {folder}, the same command goes on")
        raise
    _say_what_was_done(done.summary, terminal)
    terminal.say(f"page: {done.page.resolve()}")
    return done


def reproduce(
    ids: list[str],
    folder: Path,
    plan: Mapping[str, Any],
    terminal: Terminal,
    *,
    jobs: int,
    dask: str,
    force: bool,
) -> RunSummary:
    """Run experiments into a results folder, new or of an earlier run."""
    experiments = select(ids)
    _refuse_foreign_folder(folder, force=force)
    try:
        with terminal.progress("experiments") as progress:
            summary = run(
                experiments, folder, plan=Plan(**plan), jobs=jobs, dask=dask, progress=progress
            )
    except KeyboardInterrupt:
        terminal.say(f"interrupted; what had finished is in {folder}, the same command goes on")
        raise
    _say_what_was_done(summary, terminal)
    return summary


def _say_what_was_done(summary: RunSummary, terminal: Terminal) -> None:
    terminal.say(
        f"{counted(summary.cases, 'case')} ({summary.resumed} from an earlier run, "
        f"{summary.failed} failed) in {summary.seconds:.1f} s; results in {summary.folder}"
    )
    for problem in summary.problems:
        terminal.say(problem)


def _refuse_foreign_folder(folder: Path, *, force: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, got a file")
    ours = (folder / "cases").is_dir() or (folder / "results.json").is_file()
    if folder.is_dir() and any(folder.iterdir()) and not ours and not force:
        raise InputError(f"{folder}: not empty and no results folder; --force uses it all the same")


def digest(summary: RunSummary) -> dict[str, Any]:
    """What ``--json`` prints: counts and verdicts; the rows are in the folder."""
    return {
        "folder": str(summary.folder),
        "cases": summary.cases,
        "resumed": summary.resumed,
        "failed": summary.failed,
        "problems": summary.problems,
        "seconds": round(summary.seconds, 3),
        "verdicts": {
            name: [{"claim": v["claim"], "verdict": v["word"]} for v in record["verdicts"]]
            for name, record in summary.results["experiments"].items()
        },
    }


def show(console: Console, summary: RunSummary) -> None:
    """Every claim with its verdict."""
    rows = [
        (name, verdict["word"], verdict["claim"])
        for name, record in summary.results["experiments"].items()
        for verdict in record["verdicts"]
    ]
    if rows:
        table(console, rows, ("experiment", "verdict", "claim"))
    console.print(f"\n'manip3d report {summary.folder}' makes one page of it.")


def some_claim_fails(summary: RunSummary) -> bool:
    """Whether a claim does not hold, on the published files or on what stands in for them."""
    records = summary.results["experiments"].values()
    failing = ("does not hold", "undecided")
    return any(v["word"] in failing for record in records for v in record["verdicts"])


def write_report(folder: Path, output: Path | None, terminal: Terminal) -> Path:
    """Write the report of a results folder; say where it is."""
    from manip3d import report

    path = output or folder / "report.html"
    report.write_report(folder, path)
    terminal.say(f"report: {path.resolve()}")
    return path


def open_report(path: Path, terminal: Terminal) -> None:
    """Open the report where there is a screen and a browser."""
    if terminal.quiet or not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return
    if not webbrowser.open(path.resolve().as_uri()):
        terminal.say("no browser found to open it with")
