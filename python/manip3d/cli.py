"""The command ``manip3d``: its verbs and their options. What they do is in `manip3d._cli`.

Heavy modules are imported by the verb that needs them, so that ``manip3d --help`` is quick.
"""

from __future__ import annotations

import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, NoReturn

import typer

MISSED = 4
"""Exit code: target missed, or undecidable, under ``--strict``."""

app = typer.Typer(
    name="manip3d",
    help="Make 3D content lighter, change it, and tell whether somebody else changed it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
data_app = typer.Typer(
    help="Public data sets: what is here, and fetching more.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
app.add_typer(data_app, name="data")

Source = Annotated[str, typer.Argument(metavar="SOURCE", help="A mesh file, or - for stdin.")]
Output = Annotated[
    Path, typer.Option("-o", "--output", help="Where to; the suffix tells the kind.")
]
OptionalOutput = Annotated[
    Path | None, typer.Option("-o", "--output", help="Where to; the suffix tells the kind.")
]
Json = Annotated[bool, typer.Option("--json", help="The result as JSON on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No messages, no progress.")]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", min=0, help="Threads; processes for folders. 0: all cores."),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of every random choice.")]
Force = Annotated[bool, typer.Option("--force", help="Replace existing outputs.")]
Strict = Annotated[bool, typer.Option("--strict", help="Exit 4 when a target is missed.")]


class Tier(StrEnum):
    """Which data experiments use."""

    auto = "auto"
    real = "real"
    simulated = "simulated"


class Scale(StrEnum):
    """How much experiments do."""

    quick = "quick"
    full = "full"


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from manip3d import __version__

        print(f"manip3d {__version__}")
        raise typer.Exit


@app.command()
def doctor(as_json: Json = False) -> None:
    """Say what is here, what is missing, why, and the cure."""
    from manip3d._cli import doctoring, terminal

    checks = doctoring.examine()
    shell = terminal.Terminal(as_json=as_json)
    shell.result(checks, lambda console: doctoring.show(console, checks))
    if any(check["state"] == "broken" for check in checks):
        raise typer.Exit(1)


@app.command()
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
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Run the experiments behind published tables and figures; an interrupted run resumes."""
    from manip3d._cli import reproducing, terminal

    shell = terminal.Terminal(as_json=as_json, quiet=quiet)
    if list_only:
        records = reproducing.listing(ids or [])
        shell.result(records, lambda console: reproducing.show_listing(console, records))
        return
    plan = {"data": data.value, "scale": scale.value, "seed": seed}
    summary = reproducing.reproduce(
        ids or [], output, plan, shell, jobs=jobs, dask=dask, force=force
    )
    shell.result(reproducing.digest(summary), lambda console: reproducing.show(console, summary))
    if summary.failed:
        raise typer.Exit(1)
    if strict and reproducing.some_claim_fails(summary):
        raise typer.Exit(MISSED)


@data_app.command("list")
def data_list(as_json: Json = False) -> None:
    """List the data sets: which are here, which are missing."""
    from manip3d._cli import data, terminal

    records = data.listing()
    shell = terminal.Terminal(as_json=as_json)
    shell.result(records, lambda console: data.show(console, records))


@data_app.command("get")
def data_get(
    names: Annotated[list[str], typer.Argument(help="Data sets, as 'data list' names them.")],
    quiet: Quiet = False,
) -> None:
    """Fetch data sets from their official homes; shows each licence first."""
    from manip3d._cli import data, terminal

    data.get(names, terminal.Terminal(quiet=quiet))


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line; ends the process with its exit code."""
    from manip3d.errors import Error

    try:
        _start_logging(sys.argv[1:] if arguments is None else arguments)
        app(arguments, prog_name="manip3d")
    except KeyboardInterrupt:
        sys.exit(130)
    except (Error, OSError) as error:
        _fail(error, _one_line(error))
    except MemoryError as error:
        _fail(error, "out of memory")
    except Exception as error:  # a bug of ours: say so in one line too
        _fail(error, f"internal error: {type(error).__name__}: {error} (MANIP3D_LOG=debug: where)")
    sys.exit(0)


def _start_logging(arguments: list[str]) -> None:
    if os.environ.get("MANIP3D_LOG"):
        from manip3d._cli.terminal import configure_logging

        configure_logging(quiet="--quiet" in arguments or "-q" in arguments)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _fail(error: BaseException, message: str) -> NoReturn:
    """One clear line on stderr; the traceback only for ``MANIP3D_LOG=debug``."""
    if os.environ.get("MANIP3D_LOG", "").lower() == "debug":
        import traceback

        traceback.print_exception(error)
    print("manip3d: error: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(1)
