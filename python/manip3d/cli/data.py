"""``manip3d data``: list and download the registered data sets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.options import Json, Quiet, Tier
from manip3d.cli.terminal import Terminal, counted, table
from manip3d.errors import Error, InputError

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.datasets import DataSet

app = typer.Typer(
    name="data",
    help="List and fetch public data sets.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


def listing() -> list[dict[str, Any]]:
    """Return a record of each data set: name, kind, size, licence, and its path if it is here."""
    from manip3d import datasets
    from manip3d.datasets._registry import has_wrong_size

    return [
        {
            "name": data_set.name,
            "kind": data_set.kind,
            "title": data_set.title,
            "bytes": data_set.size,
            "licence": data_set.licence,
            "page": data_set.page,
            "here": datasets.is_here(data_set),
            "damaged": has_wrong_size(data_set),
            "path": str(path) if (path := datasets.locate(data_set.files[0])) else None,
            "fetchable": all(file.url or file.text for file in data_set.files),
        }
        for data_set in datasets.registry().values()
    ]


def show(console: Console, records: list[dict[str, Any]]) -> None:
    """Print one line per data set, then the folder in which data is searched."""
    from manip3d import datasets
    from manip3d.datasets._registry import chosen_folder_problem

    rows = [
        (r["name"], _state(r), r["kind"], f"{r['bytes'] / 1e6:.1f} MB", r["title"]) for r in records
    ]
    table(console, rows, ("name", "state", "kind", "size", "what"))
    root = datasets.data_root()
    here = sum(record["here"] for record in records)
    console.print(f"\n{here} of {len(records)} here; data folder: {root or 'none'}")
    if problem := chosen_folder_problem():
        console.print(f"MANIP3D_DATA: {problem}.")
    if here < len(records):
        console.print(
            "Set MANIP3D_DATA to the folder that holds them, or 'manip3d data get NAME' for those "
            f"to fetch; it goes to {datasets.cache_folder()}."
        )


def expect_data_folder(tier: Tier) -> None:
    """Refuse to measure simulated data because ``MANIP3D_DATA`` is misspelt.

    Raises
    ------
    InputError
        The variable is set, recorded data are asked for, and it names no folder with such data.
    """
    from manip3d.datasets._registry import chosen_folder_problem

    if tier is not Tier.simulated and (problem := chosen_folder_problem()):
        raise InputError(
            f"MANIP3D_DATA: {problem}; unset it, or give --data simulated, for simulated data"
        )


def _state(record: dict[str, Any]) -> str:
    if record["here"]:
        return "damaged" if record["damaged"] else "here"
    return "missing, can be fetched" if record["fetchable"] else "missing, get by hand"


def get(names: list[str], terminal: Terminal) -> None:
    """Download data sets; print the licence first, then the paths, or the steps to do by hand."""
    from manip3d import datasets

    failed = []
    for data_set in [datasets.get(name) for name in names]:
        terminal.say(f"{data_set.name}: {data_set.title}\n  from     {data_set.origin}")
        terminal.say(f"  licence  {data_set.licence}\n  page     {data_set.page}")
        reason = _fetch(data_set, terminal)
        if reason:
            failed.append(f"{data_set.name}: {reason}")
            for number, step in enumerate(datasets.steps_by_hand(data_set), 1):
                terminal.say(f"  step {number}   {step}")
    if failed:
        raise Error("; ".join(failed))


def _fetch(data_set: DataSet, terminal: Terminal) -> str:
    """Download one data set; return why that failed, or an empty string."""
    from manip3d import datasets

    if not datasets.is_fetchable(data_set):
        return "to be fetched by hand, with the steps above"
    try:
        with terminal.progress(data_set.name) as progress:
            paths = datasets.fetch(data_set, progress=progress)
    except datasets.FetchError as error:
        return str(error).removeprefix(f"{data_set.name}: ")
    more = f" and {counted(len(paths) - 1, 'more file')}" if len(paths) > 1 else ""
    terminal.say(f"  here     {paths[0]}{more}, checked")
    return ""


@app.command("list")
def data_list(as_json: Json = False) -> None:
    """List the data sets, present and missing.

    Example: manip3d data list
    """
    records = listing()
    shell = Terminal(as_json=as_json)
    shell.result(records, lambda console: show(console, records))


@app.command("get")
def data_get(
    names: Annotated[
        list[str], typer.Argument(metavar="NAME...", help="Names of data sets, from 'data list'.")
    ],
    quiet: Quiet = False,
) -> None:
    """Download data sets from their official addresses. Each licence is shown first.

    For a data set that no program may download, the steps to get it by hand are printed.

    Example: manip3d data get spot
    """
    get(names, Terminal(quiet=quiet))
