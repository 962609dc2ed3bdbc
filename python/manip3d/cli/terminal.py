"""Output to the terminal: results on stdout, messages and progress on stderr."""

from __future__ import annotations

import json
import logging
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from manip3d._util import texts
from manip3d._util.json import finite
from manip3d.errors import FormatError, InputError

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Collected:
    """Results and warnings of a verb that ran within `collecting`."""

    results: list[Any] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


_collected: ContextVar[Collected | None] = ContextVar("collected", default=None)
_names: ContextVar[Mapping[str, str] | None] = ContextVar("names", default=None)
_of_library: list[str] = []  # the library's warnings in this process, apart from those of rows


@contextmanager
def collecting() -> Iterator[Collected]:
    """Collect the results and warnings of verbs instead of printing them."""
    found = Collected()
    token = _collected.set(found)
    try:
        yield found
    finally:
        _collected.reset(token)


def keep_warning(text: str) -> bool:
    """Keep a warning of the library for the row of a file or the result of a single verb.

    Returns
    -------
    bool
        Whether it is to be printed: it is new, and not on one file of many.
    """
    found = _collected.get()
    kept, text = (_of_library, text) if found is None else (found.warnings, shown(text))
    is_new = text not in kept
    if is_new:
        kept.append(text)
    return is_new and found is None


@contextmanager
def showing_as(names: Mapping[str, str]) -> Iterator[None]:
    """Replace names of files in all output, for example temporary copies by their URLs."""
    token = _names.set({ours: shown for ours, shown in names.items() if ours != shown})
    try:
        yield
    finally:
        _names.reset(token)


def shown(value: Any) -> Any:
    """Return a text, or a result with its texts, with the names that `showing_as` replaces."""
    if isinstance(value, dict):
        return {key: shown(item) for key, item in value.items()}
    if isinstance(value, list):
        return [shown(item) for item in value]
    if isinstance(value, str):
        for ours, name in (_names.get() or {}).items():
            value = value.replace(ours, name)
    return value


class Terminal:
    """Output of one verb, by its options ``--json`` and ``--quiet``.

    Parameters
    ----------
    as_json : bool
        Print the result as one JSON value on stdout, and nothing else there.
    quiet : bool
        Print neither messages nor progress.
    """

    has_answered: ClassVar[bool] = False
    """Whether a result was printed as JSON. An error is then not printed there, because stdout must
    hold a single value."""

    def __init__(self, *, as_json: bool = False, quiet: bool = False) -> None:
        self.as_json = as_json
        self.quiet = quiet
        self._warnings: list[str] = []

    @property
    def out(self) -> Console:
        """Console for results in readable form, on stdout.

        Brackets and colons are no markup, because they may be those of the user's names.
        """
        from rich.console import Console

        width = None if sys.stdout.isatty() else 1000
        return Console(highlight=False, markup=False, emoji=False, width=width)

    def say(self, message: str) -> None:
        """Print a message to stderr, unless ``quiet``."""
        if not self.quiet:
            print(shown(message), file=sys.stderr)

    def warn(self, message: str) -> None:
        """Print a warning to stderr, unless ``quiet``, and keep it for the result.

        While a verb runs on one file of many, the warning is only kept, because the command prints
        the warnings of all files.
        """
        found = _collected.get()
        if found is not None:
            found.warnings.append(shown(message))
            return
        self._warnings.append(message)
        self.say(f"warning: {message}")

    def result(self, value: Any, show: Callable[[Console], None] | None = None) -> None:
        """Print the verb's result: ``value`` with ``--json``, otherwise by ``show``.

        With ``--json``, a result with names gets the warnings before it, if any, as ``warnings``:
        those of the library, then the verb's own.
        """
        found = _collected.get()
        if found is not None:
            found.results.append(value)
        elif self.as_json:
            told = list(dict.fromkeys([*_of_library, *self._warnings]))
            if told and isinstance(value, dict):
                value = value | {"warnings": told}
            print(json.dumps(finite(shown(value)), indent=1))
            Terminal.has_answered = True
        elif show is not None:
            show(self.out)

    @property
    def is_collecting(self) -> bool:
        """Whether the verb runs on one file of many, so that its result becomes a row."""
        return _collected.get() is not None

    def show(self, line: str) -> None:
        """Print a line of a result immediately, except with ``--json``."""
        if not self.as_json and not self.is_collecting:
            print(shown(line), flush=True)

    def line(self, fraction: float, message: str = "") -> None:
        """Print one line of progress, for logs and pipes, which show no bar."""
        self.say(f"{fraction:5.0%}  {message}")

    @contextmanager
    def progress(self, title: str) -> Iterator[Progress | None]:
        """Yield the callback of a progress bar on stderr; None if stderr is no terminal."""
        if self.quiet or not sys.stderr.isatty():
            yield None
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[message]}", style="dim", markup=False),
        )
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(title, total=1.0, message="")

            def update(fraction: float, message: str = "") -> None:
                bar.update(task, completed=fraction, message=message)

            yield update


def table(console: Console, rows: Sequence[Sequence[str]], header: Sequence[str] = ()) -> None:
    """Print rows in columns, with numbers right-aligned; on a terminal long texts wrap."""
    from rich.table import Table
    from rich.text import Text

    if not rows and not header:
        return
    grid = Table(box=None, show_header=bool(header), pad_edge=False, header_style="bold")
    names = list(header) or [""] * len(rows[0])
    last = len(names) - 1
    for column, name in enumerate(names):
        cells = [row[column] for row in rows]
        numeric = all(_is_number(cell) for cell in cells)
        width = max(len(cell) for cell in [name, *cells])
        if not numeric:
            width = min(width, _LEAST_WIDTH)
        grid.add_column(
            Text(name),
            justify="right" if numeric and column else "left",
            min_width=width if column < last else None,
        )
    for row in rows:
        grid.add_row(*(Text(cell) for cell in row))
    console.print(grid)


_LEAST_WIDTH = 40
"""Characters: width to which long texts wrap if the columns after them need the room."""


def _is_number(cell: str) -> bool:
    return cell.removeprefix("-")[:1].isdigit() or cell in ("", "-")


def with_force(text: str) -> str:
    """Return an error with ``--force`` for the arguments ``overwrite=True`` and ``replace=True``.

    Errors of the core have both.
    """
    return re.sub(r"--force \(overwrite=True\)|\b(overwrite|replace)=True\b", "--force", text)


def named_as_options(text: str, options: Sequence[str]) -> str:
    """Replace names of arguments by options: ``see depth_step`` becomes ``see --depth-step``.

    Only names with an underscore are replaced, because others may be ordinary words.
    """
    for option in options:
        if "-" in option:
            text = re.sub(rf"(?<![\w-]){option.replace('-', '_')}\b", f"--{option}", text)
    return text


_SHOWN_AS = {"output": "-o"}
"""Options that errors show by their short names, as `check_output` does."""


@contextmanager
def naming_options(*options: str, **others: str) -> Iterator[None]:
    """Let errors about an argument name the option of the command line instead.

    ``depth_step: expected >= 0`` becomes ``--depth-step: expected >= 0``, and so do options with a
    hyphen in the rest of the message. ``others`` maps arguments to options with another name
    (``key="diary-key"``), or to arguments of the command, in capitals as in its help
    (``uri="SOURCE"``).
    """
    try:
        yield
    except FormatError as error:
        reason = named_as_options(error.reason, options)
        if reason == error.reason:
            raise
        raise FormatError(
            reason, file=error.file, line=error.line, byte_offset=error.byte_offset
        ) from error
    except InputError as error:
        names, colon, rest = str(error).partition(":")
        given = [name.strip() for name in names.split(",")]
        found = [others.get(name, name.replace("_", "-")) for name in given]
        if not colon or not set(found) <= {*options, *others.values()}:
            raise
        shown = (_SHOWN_AS.get(name, name if name.isupper() else f"--{name}") for name in found)
        raise InputError(", ".join(shown) + ":" + named_as_options(rest, options)) from error


def expect_named(argument: str, *sources: str) -> None:
    """Refuse "" of an unset variable of a script, which would mean the current folder.

    Raises
    ------
    InputError
        A source has an empty name.
    """
    if "" in sources:
        raise InputError(f"{argument}: expected a file, a folder or an address, got ''")


def check_output(
    path: Path | None,
    suffixes: Sequence[str],
    *,
    force: bool | None,
    folder: bool = False,
    is_ours: Callable[[str], bool] | None = None,
    in_place: bool = False,
    option: str = "-o",
) -> None:
    """Check ``-o`` before any work is done.

    Parameters
    ----------
    path : Path or None
        The output; None if the option is not given.
    suffixes : sequence of str
        Suffixes of the formats that the command writes.
    folder : bool
        Whether a name without a suffix, which is a folder, is accepted, too.
    force, is_ours, in_place, option
        See `check_place`; ``is_ours`` and ``in_place`` are for folders.

    Raises
    ------
    InputError
        The suffix is none of ``suffixes``, or see `check_place`.
    """
    if path is None:
        return
    name = path.name.lower().removesuffix(".xz").removesuffix(".gz")
    is_folder = folder and not path.suffix
    if is_folder and str(path) == "-":
        raise InputError(f"{option} -: expected a folder or a file, since stdout holds no folder")
    if not is_folder and not path.is_char_device() and not name.endswith(tuple(suffixes)):
        names = [f"a name that ends in {', '.join(suffixes)}"] if suffixes else []
        names += ["a folder's name without a suffix"] if folder else []
        raise InputError(f"{option} {path}: expected {', or '.join(names)}")
    if is_folder:
        check_folder(path, option=option)
    elif path.is_dir():
        raise InputError(f"{option} {path}: expected the name of a file, got a folder")
    is_ours = is_ours if is_folder else None
    check_place(path, force=force, is_ours=is_ours, in_place=in_place, option=option)


def check_parent(path: Path, *, option: str = "-o") -> None:
    """Check that the folder exists in which an output would be made.

    Raises
    ------
    InputError
        It does not exist.
    """
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}")


def check_folder(
    path: Path, is_ours: Callable[[str], bool] | None = None, *, option: str = "-o"
) -> None:
    """Check the place of a folder, which may exist, before any work is done.

    Parameters
    ----------
    path : Path
        The folder.
    is_ours : callable(str), optional
        Returns whether a file of this name in the folder was written by an earlier run. Other files
        are refused, because the command could not replace the folder without them.
    option : str
        Name of the option or argument in errors.

    Raises
    ------
    InputError
        The folder in which it would be made does not exist, there is a file in its place, or it
        holds other files.
    """
    from manip3d.io._files import other_files

    check_parent(path, option=option)
    if path.exists() and not path.is_dir():
        raise InputError(f"{option} {path}: expected a folder, got a file")
    others = [] if is_ours is None else other_files(path, is_ours)
    if others:
        named = ", ".join([*others[:3], *(["..."] if others[3:] else [])])
        raise InputError(f"{option} {path}: holds other files ({named}); give another folder")


def check_place(
    path: Path,
    *,
    force: bool | None,
    is_ours: Callable[[str], bool] | None = None,
    in_place: bool = False,
    option: str = "-o",
) -> None:
    """Check the place of an output of any name before any work is done.

    Parameters
    ----------
    path : Path
        The output, a file or a folder.
    force : bool or None
        Whether an existing output may be replaced; None: the command never replaces a file.
    is_ours : callable(str), optional
        The output is a folder, see `check_folder`.
    in_place : bool
        Whether the folder stays and its files are replaced. Otherwise it is replaced as a whole,
        and may not be the current one.
    option : str
        Name of the option or argument in errors.

    Raises
    ------
    InputError
        The folder of the output does not exist, the output exists, or it is the current folder; or
        see `check_folder`.
    """
    from manip3d.io._files import refuse_current

    if is_ours is None:
        check_parent(path, option=option)
    else:
        check_folder(path, is_ours, option=option)
        if not in_place:
            refuse_current(path, f"{option} {path}")
    if path.exists() and not force and not path.is_char_device():
        cure = "--force replaces it" if force is not None else "give another name"
        raise InputError(f"{option} {path}: exists already; {cure}")


_GROUPS = " "
"""Sign between groups of three digits: an ordinary space, unlike on HTML pages, because all
terminals show it and users can type it in a search."""
_MOST_REASONS = 10  # shown of frames that cannot be read
_LEFT_OUT = {
    "out_of_order": "no later than the frame before",
    "damaged": "damaged",
    "lost": "missing in the file",
    "lost_by_camera": "lost by the camera",
}
"""Counters of frames that an RGB-D source leaves out, with the reason in words."""


def left_out(counters: Mapping[str, int]) -> list[str]:
    """Return messages about frames of a recording that a source left out, or their colour."""
    told = [
        f"{counted(number, 'frame')} left out: {words}"
        for name, words in _LEFT_OUT.items()
        if (number := counters.get(name, 0))
    ]
    without = counters.get("without_color", 0)
    if 0 < without < counters.get("frames", 0):  # all: a source without colour
        told.append(f"{counted(without, 'frame')} without a colour image")
    if counters.get("cut_short") or counters.get("incomplete"):
        told.append("the recording ends in the middle of a frame: its end is missing")
    return told


def warn_of_left_out(
    terminal: Terminal, counters: Mapping[str, int], errors: Mapping[int, str]
) -> None:
    """Warn of the frames of a source that were left out, with the reasons."""
    for reason in list(errors.values())[:_MOST_REASONS]:
        terminal.warn(f"a frame cannot be read: {reason}")
    for line in left_out(counters):
        terminal.warn(line)


def say_page(path: Path, output: Path | None, terminal: Terminal) -> None:
    """Say where a page was written; print its path if there is no display to open it on."""
    from manip3d import viewer

    if output is not None:
        terminal.say(f"wrote {output}")
    elif not viewer.has_display():
        print(path)  # on stdout, since the page can be opened on another computer
        terminal.say("There is no display here: open this page in a browser.")


def configure_logging() -> None:
    """Send the package's log to stderr, from the level in ``MANIP3D_LOG`` on."""
    level = os.environ.get("MANIP3D_LOG", "warning").upper()
    names = logging.getLevelNamesMapping()
    if level not in names:
        known = ", ".join(name.lower() for name in names)
        raise InputError(f"MANIP3D_LOG: expected one of {known}, got {level.lower()!r}")
    logger = logging.getLogger("manip3d")
    if not logger.handlers:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
        logger.addHandler(handler)
    logger.setLevel(names[level])


def count(number: int) -> str:
    """Return a number in groups of three digits: ``80 354``."""
    return f"{number:,}".replace(",", _GROUPS)


def counted(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun in singular or plural: ``1 face``, ``80 354 faces``."""
    return texts.counted(number, noun, plural, separator=_GROUPS)
