"""The command ``manip3d``. Each verb parses its arguments, calls public functions, and prints.

Each verb has a module with its options and the output of its result. The module is imported when
the verb is used, so that ``manip3d --help`` is quick.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import logging
import os
import sys
import warnings
from collections.abc import Iterator
from contextvars import ContextVar
from typing import Annotated, Any, NoReturn, TextIO

import typer
from typer.core import TyperCommand, TyperGroup

__all__ = ["app", "main"]

_VERBS = {
    "simplify": "Reduce the faces of a mesh.",
    "lod": "Write levels of detail of a mesh.",
    "depth": "Turn a depth image or a range scan into a sparse textured mesh.",
    "compare": "Measure how far a mesh is from its original.",
    "info": "Print counts and properties of a mesh, a scan or a recording.",
    "view": "Show a mesh or a scan, or write a page or a picture.",
    "play": "Play a sequence of meshes on one page, with a time bar.",
    "convert": "Write a mesh or a scan in another format.",
    "simulate": "Make drives, scans and meshes with known truth.",
    "inspect": "Look for edits of a LiDAR scan, a drive or an RGB-D recording.",
    "lattice": "Estimate the lattice of a scanner, and its power of detection.",
    "demo": "Show what manip3d does, on one page with pictures.",
    "doctor": "Print what is installed, what is missing, and how to mend it.",
    "reproduce": "Run the experiments behind published tables and figures.",
    "report": "Turn a results folder into one page: .html, .md or .csv.",
    "cs3": "Same as 'depth' with --method cs3.",
    "data": "List and fetch public data sets.",
    "forge": "Forge LiDAR scans and RGB-D streams, with their truth.",
    "watermark": "Embed keyed watermarks into LiDAR scans and verify them.",
    "alert": "Watch the LiDAR of a drive by watermark, cameras and forensics.",
    "phantom": "Render a missing limb by mirroring the intact one.",
    "diary": "Keep digital diaries of studies: sessions, pain, analysis.",
    "study": "Run studies with people: rating of forgeries, JND, displays.",
    "capture": "List, record, play and export RGB-D cameras and recordings.",
}
"""Verbs and their help, in the order of the help text."""


_as_json: ContextVar[bool] = ContextVar("as_json", default=False)


@contextlib.contextmanager
def _telling_of_usage() -> Iterator[None]:
    """With ``--json``, print usage errors as JSON to stdout; Typer prints its text to stderr."""
    try:
        yield
    except Exception as error:
        # Usage errors are recognised by this method, since their class is Click's or Typer's copy.
        message = getattr(error, "format_message", None)
        if message is not None and _as_json.get() and not _has_answered():
            line = " ".join(message().split())
            with contextlib.suppress(OSError):  # a closed stdout must not hide the text on stderr
                print(json.dumps({"error": {"code": "usage", "message": line}}), flush=True)
        raise


@contextlib.contextmanager
def _telling_what_is_done() -> Iterator[None]:
    """Print that a verb was interrupted, with the error's notes on its output; Typer does not."""
    try:
        yield
    except KeyboardInterrupt as error:
        with contextlib.suppress(OSError):
            for words in [f": {note}" for note in getattr(error, "__notes__", ())] or [""]:
                print(f"manip3d: interrupted{words}", file=sys.stderr)
        raise


class _Verbs(TyperGroup):
    """The verbs by name and one line of help; a verb's module is imported when it is used."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for name, line in _VERBS.items():
            self.add_command(TyperCommand(name, help=line))

    def make_context(self, *arguments: Any, **named: Any) -> Any:
        with _telling_of_usage():
            return super().make_context(*arguments, **named)

    def invoke(self, ctx: Any) -> Any:
        with _telling_of_usage(), _telling_what_is_done():
            return super().invoke(ctx)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args[0] in _VERBS:
            self.add_command(load(args[0]), args[0])
        return super().resolve_command(ctx, args)


def load(verb: str) -> Any:
    """Import the module of a verb, and return its command or its group of commands."""
    module = importlib.import_module(f"manip3d.cli.{'depth' if verb == 'cs3' else verb}")
    if hasattr(module, "app"):
        return typer.main.get_group(module.app)
    single = typer.Typer(rich_markup_mode=None, add_completion=False)
    single.command(verb, help=_VERBS[verb] if verb == "cs3" else None)(getattr(module, verb))
    return typer.main.get_command(single)


app = typer.Typer(
    name="manip3d",
    cls=_Verbs,
    help="Make 3D content lighter, change it, and tell whether somebody else changed it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def _root(
    context: typer.Context,
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    max_bytes: Annotated[
        int | None, typer.Option(min=1, help="Refuse files of more uncompressed bytes.")
    ] = None,
    max_points: Annotated[
        int | None, typer.Option(min=1, help="Refuse files of more points, vertices or pixels.")
    ] = None,
    max_seconds: Annotated[
        float | None, typer.Option(help="Refuse files that take longer to read, seconds.")
    ] = None,
) -> None:
    if version:
        from manip3d import __version__

        print(f"manip3d {__version__}")
        raise typer.Exit
    limits = {"max_bytes": max_bytes, "max_points": max_points, "max_seconds": max_seconds}
    if any(limit is not None for limit in limits.values()):
        from manip3d.cli.terminal import naming_options
        from manip3d.io import ReadLimits

        with naming_options("max-seconds"):
            context.with_resource(ReadLimits(**limits))  # type: ignore[arg-type]


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line, and end the process with its exit code."""
    from manip3d.errors import Error

    words = sys.argv[1:] if arguments is None else arguments
    as_json = "--json" in words
    _as_json.set(as_json)
    _prepare_streams()
    try:
        try:
            if {"--quiet", "-q"} & set(words) and not os.environ.get("MANIP3D_LOG"):
                os.environ["MANIP3D_LOG"] = "error"  # worker processes inherit it
            start_messages()
            app(arguments, prog_name="manip3d")
        finally:
            _flush(sys.stdout)
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # the reader of the output has closed the pipe
        sys.exit(1)
    except (Error, OSError) as error:
        _fail(error, _one_line(error), as_json)
    except MemoryError as error:
        _fail(error, "out of memory", as_json)
    except Exception as error:  # a bug in manip3d is reported in one line, too
        if isinstance(error.__cause__, KeyboardInterrupt):  # Ctrl-C during a compiled import
            print("manip3d: interrupted", file=sys.stderr)
            sys.exit(130)
        if isinstance(error, ImportError) and "failed to map segment" in str(error):
            cause = "too little memory, or a file system that is mounted with noexec"
            _fail(error, f"{error} ({cause})", as_json)
        message = f"internal error: {type(error).__name__}: {error} (MANIP3D_LOG=debug: where)"
        _fail(error, message, as_json)
    sys.exit(0)


def start_messages() -> None:
    """Configure the log, with the level in ``MANIP3D_LOG``, and the output of warnings."""
    if os.environ.get("MANIP3D_LOG"):
        from manip3d.cli.terminal import configure_logging

        configure_logging()
    _show_warnings_in_lines()


def _show_warnings_in_lines() -> None:
    """Print the library's warnings in one line each, and let them be in rows and results.

    Python would add the place in the code, and would give equal warnings on several files only once
    in each process, so that rows would depend on the number of processes. Options of Python on
    warnings are heeded.
    """
    from manip3d.cli.terminal import keep_warning

    if not sys.warnoptions:
        warnings.simplefilter("always", UserWarning)

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        text = " ".join(str(message).split())
        is_to_be_told = keep_warning(text)
        if is_to_be_told and logging.getLogger("manip3d").isEnabledFor(logging.WARNING):
            with contextlib.suppress(OSError):
                print(f"warning: {text}", file=file or sys.stderr)

    warnings.showwarning = show


def _prepare_streams() -> None:
    """Let the standard streams print any file name, and replace closed ones.

    A closed stdin is replaced by an empty one. A closed stdout is replaced by a read-only
    descriptor, so that printing to it is an error. The descriptors 0 to 2 are always opened,
    because an output file could get one of them otherwise, and would receive printed text.
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
    """Flush a stream; if that fails, redirect it, because Python would try again at exit."""
    try:
        stream.flush()
    except OSError:
        devnull = os.open(os.devnull, os.O_WRONLY)
        os.dup2(devnull, stream.fileno())
        os.close(devnull)
        raise


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def _fail(error: BaseException, message: str, as_json: bool) -> NoReturn:
    """Print an error in one line to stderr, and exit with 1.

    ``MANIP3D_LOG=debug`` adds the traceback. With ``--json``, code and details go to stdout.
    """
    if os.environ.get("MANIP3D_LOG", "").lower() == "debug":
        import traceback

        traceback.print_exception(error)
    from manip3d.cli.terminal import with_force
    from manip3d.errors import Error, error_details

    line = " ".join("; ".join([message, *getattr(error, "__notes__", ())]).split())
    line = with_force(line)
    with contextlib.suppress(OSError):
        if as_json and not _has_answered():
            details = error_details(error)
            own = with_force(str(error)) if isinstance(error, Error) else line
            print(json.dumps({"error": details | {"message": own}}))
            _flush(sys.stdout)
    with contextlib.suppress(OSError):  # separate, because stdout may have failed
        print("manip3d: error: " + line, file=sys.stderr)
        _flush(sys.stderr)
    sys.exit(1)


def _has_answered() -> bool:
    """Return whether a result was printed to stdout already (that of files that succeeded)."""
    from manip3d.cli.terminal import Terminal

    return Terminal.has_answered
