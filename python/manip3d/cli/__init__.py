"""The command ``manip3d``: each verb parses its arguments, calls a public function and prints.

One module for each verb: its options, and how its result is printed. Heavy packages are imported by
the verb that needs them, so that ``manip3d --help`` is quick.
"""

from __future__ import annotations

import contextlib
import io
import os
import sys
from typing import Annotated, NoReturn, TextIO

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
    watermark,
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
for group in (data, forge, watermark, phantom, capture):
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

    _prepare_streams()
    try:
        try:
            _start_logging(sys.argv[1:] if arguments is None else arguments)
            app(arguments, prog_name="manip3d")
        finally:
            _flush(sys.stdout)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # who read the output has read enough
        sys.exit(1)
    except (Error, OSError) as error:
        _fail(error, _one_line(error))
    except MemoryError as error:
        _fail(error, "out of memory")
    except Exception as error:  # a bug of ours: say so in one line too
        _fail(error, f"internal error: {type(error).__name__}: {error} (MANIP3D_LOG=debug: where)")
    sys.exit(0)


def _prepare_streams() -> None:
    """Make the standard streams print any file name, and stand in for those that are closed.

    What is printed to a closed stdout is lost, which is an error; a closed stdin is empty. The
    numbers of closed streams are taken, lest an output file gets one and is printed into.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            flags = os.O_WRONLY if name == "stderr" else os.O_RDONLY
            opened = os.open(os.devnull, flags)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            setattr(sys, name, os.fdopen(number, "r" if name == "stdin" else "w", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _flush(stream: TextIO) -> None:
    """Write out what is buffered; after a failure forget it: Python would try again at exit."""
    try:
        stream.flush()
    except OSError:
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, stream.fileno())
        os.close(devnull)
        raise


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
    with contextlib.suppress(OSError):
        print("manip3d: error: " + " ".join(message.split()), file=sys.stderr)
        _flush(sys.stderr)
    sys.exit(1)
