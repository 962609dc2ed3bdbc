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
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from manip3d._util.json import finite
from manip3d.errors import FormatError, InputError

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[float, str], None]

_collected: ContextVar[list[Any] | None] = ContextVar("collected", default=None)
_names: ContextVar[Mapping[str, str] | None] = ContextVar("names", default=None)


@contextmanager
def collecting() -> Iterator[list[Any]]:
    """Gather the results of verbs in a list instead of printing them."""
    found: list[Any] = []
    token = _collected.set(found)
    try:
        yield found
    finally:
        _collected.reset(token)


@contextmanager
def showing_as(names: Mapping[str, str]) -> Iterator[None]:
    """Show other names for some files: the URLs of temporary copies."""
    token = _names.set({ours: shown for ours, shown in names.items() if ours != shown})
    try:
        yield
    finally:
        _names.reset(token)


def shown(value: Any) -> Any:
    """Return a text, or a result with its texts, as it is shown or written down for others.

    See `showing_as`.
    """
    if isinstance(value, dict):
        return {key: shown(item) for key, item in value.items()}
    if isinstance(value, str):
        for ours, name in (_names.get() or {}).items():
            value = value.replace(ours, name)
    return value


class Terminal:
    """Prints for one verb, as its ``--json`` and ``--quiet`` say.

    Parameters
    ----------
    as_json : bool
        Results are one JSON value on stdout; nothing else goes there.
    quiet : bool
        No messages and no progress.
    """

    has_answered: ClassVar[bool] = False
    """Whether a result was printed as JSON: stdout holds one value, never an error after it."""

    def __init__(self, *, as_json: bool = False, quiet: bool = False) -> None:
        self.as_json = as_json
        self.quiet = quiet

    @property
    def out(self) -> Console:
        """Console for results that people read."""
        from rich.console import Console

        return Console(highlight=False, width=None if sys.stdout.isatty() else 1000)

    def say(self, message: str) -> None:
        """A message about what is being done."""
        if not self.quiet:
            print(shown(message), file=sys.stderr)

    def result(self, value: Any, show: Callable[[Console], None] | None = None) -> None:
        """The verb's result: ``value`` under ``--json``, else what ``show`` prints."""
        found = _collected.get()
        if found is not None:
            found.append(value)
        elif self.as_json:
            print(json.dumps(finite(shown(value)), indent=1))
            Terminal.has_answered = True
        elif show is not None:
            show(self.out)

    @property
    def is_collecting(self) -> bool:
        """Whether the verb runs on one file of many, whose row its result becomes."""
        return _collected.get() is not None

    def show(self, line: str) -> None:
        """A line of a result for people, as soon as it is known."""
        if not self.as_json and not self.is_collecting:
            print(shown(line), flush=True)

    def line(self, fraction: float, message: str = "") -> None:
        """One line of progress, for logs and pipes that show no bar."""
        self.say(f"{fraction:5.0%}  {message}")

    @contextmanager
    def progress(self, title: str) -> Iterator[Progress | None]:
        """A progress bar on stderr; None where nobody would see it."""
        if self.quiet or not sys.stderr.isatty():
            yield None
            return
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
            TextColumn("[dim]{task.fields[message]}"),
        )
        with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
            task = bar.add_task(title, total=1.0, message="")

            def update(fraction: float, message: str = "") -> None:
                bar.update(task, completed=fraction, message=message)

            yield update


def table(console: Console, rows: Sequence[Sequence[str]], header: Sequence[str] = ()) -> None:
    """Rows in columns, numbers to the right; on a terminal the last column wraps."""
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=None, show_header=bool(header), pad_edge=False, header_style="bold")
    names = list(header) or [""] * len(rows[0])
    last = len(names) - 1
    for column, name in enumerate(names):
        cells = [row[column] for row in rows]
        numeric = all(_is_number(cell) for cell in cells)
        width = max(len(cell) for cell in [name, *cells])
        grid.add_column(
            name,
            justify="right" if numeric and column else "left",
            min_width=width if column < last else None,
        )
    for row in rows:
        grid.add_row(*(Text(cell) for cell in row))
    console.print(grid)


def _is_number(cell: str) -> bool:
    return cell[:1].isdigit() or cell in ("", "-")


def refuse_existing(path: Path | None, *, force: bool) -> None:
    """Refuse to replace a file that is there.

    Raises
    ------
    InputError
        It exists and ``--force`` was not given.
    """
    if path is not None and not force and path.exists() and not path.is_char_device():
        raise InputError(f"{path}: exists already; --force replaces it")


def named_as_options(text: str, options: Sequence[str]) -> str:
    """Return ``text`` with options for arguments: ``see depth_step`` becomes ``see --depth-step``.

    Only names with an underscore are found; others are words of the language as well.
    """
    for option in options:
        if "-" in option:
            text = re.sub(rf"(?<![\w-]){option.replace('-', '_')}\b", f"--{option}", text)
    return text


@contextmanager
def naming_options(*options: str, **others: str) -> Iterator[None]:
    """Turn an error about an argument into one about the option of that name.

    ``depth_step: expected >= 0`` becomes ``--depth-step: expected >= 0``. ``others`` are arguments
    whose options have another name: ``key="diary-key"``; or that are no options, in capitals as
    the help has them: ``uri="SOURCE"``.
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
        shown = (name if name.isupper() else f"--{name}" for name in found)
        raise InputError(", ".join(shown) + ":" + rest) from error


def check_output(
    path: Path | None,
    suffixes: Sequence[str],
    *,
    force: bool,
    folder: bool = False,
    option: str = "-o",
) -> None:
    """Check ``-o`` before any work is done.

    Parameters
    ----------
    path : Path or None
        None: the command has no output.
    suffixes : sequence of str
        The kinds that the command writes.
    force : bool
        An existing output may be replaced.
    folder : bool
        A name without a suffix is a folder and is accepted too.
    option : str
        Name of the option that an error is about.

    Raises
    ------
    InputError
        The suffix is none of them, the folder of the output is absent, or the output exists.
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
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}")
    refuse_existing(path, force=force)


_LEFT_OUT = {
    "out_of_order": "no later than the frame before",
    "damaged": "damaged",
    "lost": "missing in the file",
    "lost_by_camera": "lost by the camera",
}
"""Counters of a source of RGB-D frames, by what becomes of so many frames."""


def left_out(counters: Mapping[str, int]) -> list[str]:
    """Return what a source has not given of a recording, in words for an operator."""
    told = [
        f"{counted(number, 'frame')} left out: {words}"
        for name, words in _LEFT_OUT.items()
        if (number := counters.get(name, 0))
    ]
    if counters.get("cut_short") or counters.get("incomplete"):
        told.append("the recording ends in the middle of a frame: its end is missing")
    return told


def configure_logging() -> None:
    """Send the package's log to stderr, from the level that ``MANIP3D_LOG`` names."""
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
    """A number with its groups of thousands separated: ``80 354``.

    The separator is an ordinary space, unlike on pages: terminals show it, and it can be typed into
    a search.
    """
    return f"{number:,}".replace(",", " ")


def counted(number: int, noun: str, plural: str = "") -> str:
    """A number with its noun in the right form: ``1 face``, ``80 354 faces``."""
    return f"{count(number)} {noun if number == 1 else plural or noun + 's'}"
