"""The command ``manip3d``: each verb parses its arguments, calls a public function and prints.

One module for each verb: its options, and how its result is printed. Heavy packages are imported by
the verb that needs them, so that ``manip3d --help`` is quick.
"""

from __future__ import annotations

import os
import sys
from typing import Annotated, NoReturn

import typer

from manip3d.cli import (
    capture,
    compare,
    convert,
    data,
    demo,
    depth,
    doctor,
    forge,
    info,
    inspect,
    lod,
    phantom,
    report,
    reproduce,
    simplify,
    simulate,
    view,
)

__all__ = ["app", "main"]

app = typer.Typer(
    name="manip3d",
    help="Make 3D content lighter, change it, and tell whether somebody else changed it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_SHORT = {
    "info": "Count what a mesh, a scan or a recording is made of.",
    "view": "Show a mesh or a scan, or write a page or a picture.",
}
"""Help that fits the list of commands, where the first line does not."""

for verb in (
    simplify.simplify,
    lod.lod,
    depth.depth,
    compare.compare,
    info.info,
    view.view,
    convert.convert,
    simulate.simulate,
    inspect.inspect,
    demo.demo,
    doctor.doctor,
    reproduce.reproduce,
    report.report,
):
    app.command(short_help=_SHORT.get(verb.__name__))(verb)
app.command("cs3", help="Same as 'depth', whose default method is CS3.")(depth.depth)
for group in (data, forge, phantom, capture):
    app.add_typer(group.app)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from manip3d import __version__

        print(f"manip3d {__version__}")
        raise typer.Exit


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
        from manip3d.cli.terminal import configure_logging

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
