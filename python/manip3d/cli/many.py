"""Apply a verb (a command of ``manip3d``) to many files: several sources, folders, patterns, URLs.

`over_files` decorates a verb that takes one file. The verb's function runs on each file, in worker
processes or on Dask, and the result that it would print with ``--json`` is the file's row.
"""

from __future__ import annotations

import copy
import functools
import importlib
import inspect
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, get_type_hints

import typer

from manip3d._util.paths import by_number, is_hidden
from manip3d.cli import kinds, start_messages
from manip3d.cli.options import (
    Dask,
    FileJobs,
    FolderJobs,
    Jobs,
    Table,
    TableBesideOutputs,
    TableOfNow,
    To,
)
from manip3d.cli.signals import ended_like_ctrl_c
from manip3d.cli.terminal import (
    Terminal,
    check_folder,
    check_parent,
    collecting,
    count,
    counted,
    expect_named,
    showing_as,
)
from manip3d.cli.terminal import table as show_table
from manip3d.errors import Error, InputError
from manip3d.io import is_url, local_copy, local_output

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.batch import SourceFile, Summary

Verb = Callable[..., None]
SKIPPED = "skipped"
"""Column with the kind of a file that the verb does not take; also an option of `over_files`."""
_GRAVEST_FIRST = (3, 1, 4)  # exit codes: tampered, then failed, then undecidable


@dataclass(frozen=True)
class Many:
    """Rules by which a verb processes many files.

    Attributes
    ----------
    suffixes : sequence of str
        Suffixes of the files of a folder that are sources.
    to : str
        Suffix of the outputs; empty: that of the source.
    writable : sequence of str
        Suffixes that the verb writes.
    otherwise : str
        Suffix of the outputs of sources whose suffix is not in ``writable``.
    noun : str
        Word for one source in messages.
    find : callable
        Function that lists the sources, such as `manip3d.batch.find_files`.
    whole : sequence of str
        Kinds of folders (`kinds.kind_of`) that are a single source, named or within a folder.
    """

    suffixes: Sequence[str]
    to: str
    writable: Sequence[str]
    otherwise: str
    noun: str
    find: Callable[..., list[SourceFile]]
    whole: Sequence[str]

    def files(self, sources: Sequence[str]) -> list[SourceFile]:
        """Return the files that the sources refer to.

        Raises
        ------
        InputError
            There are no files, or `to` is not a suffix that the verb writes.
        OSError
            A source does not exist.
        """
        if self.to and self.to not in self.writable:
            raise InputError(f"--to: expected one of {', '.join(self.writable)}, got {self.to}")
        find = functools.partial(self.find, suffixes=self.suffixes)
        if not self.whole:
            return find(sources)
        found: dict[str, SourceFile] = {}
        for source in sources:
            whole = [] if is_url(source) else list(self._whole_folders(Path(source)))
            found |= {each.name: each for each in whole}
            if any(each.is_named for each in whole):
                continue
            try:
                files = find([source])
            except InputError as error:
                if whole:
                    continue
                advice = kinds.NO_RECORDING if self.whole == kinds.RECORDING else ""
                raise InputError(f"{error}{advice}") from None
            inside = tuple(f"{each.name}/" for each in whole)
            found |= {
                f.name: f for f in files if f.name not in found and not f.name.startswith(inside)
            }
        return [found[name] for name in sorted(found, key=by_number(found))]

    def _whole_folders(self, source: Path) -> Iterator[SourceFile]:
        """Yield the folder if it is a single source, such as a recording, else those within it."""
        from manip3d.batch import SourceFile
        from manip3d.batch._stamps import stamp_of_folder

        for top, folders, _ in os.walk(source):
            folders[:] = sorted(name for name in folders if not is_hidden(name))
            folder = Path(top)
            if self._is_whole(top):
                folders.clear()
                is_named = folder == source
                name = folder.resolve().name if is_named else os.path.relpath(folder, source)
                yield SourceFile(top, name, stamp_of_folder(folder), is_named)

    def _is_whole(self, folder: str) -> bool:
        try:
            return kinds.kind_of(folder) in self.whole
        except Error:  # a damaged recording, about which the verb raises an error
            return True

    def check_folder(self, sources: Sequence[str], output: Path | str | None) -> None:
        """Refuse an output of several sources that cannot be made as a folder.

        ``output`` is a text if it is a URL, whose folders are made when files are written.

        Raises
        ------
        InputError
            The output has a suffix that the verb writes, and is not an existing folder; or see
            `manip3d.cli.terminal.check_folder`.
        """
        if output is None:
            return
        suffix = PurePosixPath(str(output)).suffix.lower()
        is_folder = isinstance(output, Path) and output.is_dir()
        if not is_folder and suffix and suffix in self.writable:
            self._refuse_name_of_file(sources, output)
        if isinstance(output, Path):
            check_folder(output)

    def _refuse_name_of_file(self, sources: Sequence[str], output: Path | str) -> NoReturn:
        more = f"several {self.noun}s" if len(sources) > 1 else f"the {self.noun}s of {sources[0]}"
        raise InputError(f"-o {output}: expected a folder for {more}, got the name of a file")

    def names(self, files: Sequence[SourceFile]) -> dict[str, str]:
        """Return the name of each output by the name of its source.

        If sources differ only in their suffix, it is kept: head.ply and head.obj become
        head.ply.glb and head.obj.glb.
        """
        named = {file.relative: self.rename(file.relative) for file in files}
        uses = Counter(named.values())
        return {
            source: f"{source}{PurePosixPath(target).suffix}" if uses[target] > 1 else target
            for source, target in named.items()
        }

    def refuse_output(self, name: str, files: Sequence[SourceFile]) -> None:
        """Refuse a source whose output has a name that the verb needs for another file.

        Raises
        ------
        InputError
            An output has that name.
        """
        for source, target in self.names(files).items():
            if target == name:
                raise InputError(
                    f"{source}: expected another name, because {name} has all {self.noun}s"
                )

    def rename(self, relative: str) -> str:
        """Return the name of an output for that of its source."""
        path = PurePosixPath(relative)
        lower = path.name.lower()
        plain = lower.removesuffix(".xz").removesuffix(".gz")
        known = sorted({*self.suffixes, *self.writable}, key=len, reverse=True)
        suffix = next((s for s in known if plain.endswith(s)), "")
        # Counted from the end, because lower-case letters before it can be longer than capitals.
        num_after = len(lower) - len(plain) + len(suffix)
        stem = path.name[:-num_after] if suffix else path.name
        new = self.to or (suffix if suffix in self.writable else self.otherwise)
        return str(path.with_name(stem + new)) if new else relative


@dataclass(frozen=True)
class over_files:  # a decorator: lower case, like functools.cached_property
    """Make a verb for one file (and ``output``) a verb for many files.

    Attributes
    ----------
    suffixes, writable : callable
        Return the attributes of `Many`; they are called when a command runs.
    argument : str
        The verb's argument that takes several files.
    otherwise : str
        See `Many`.
    prepare : callable(files, options)
        Returns options of single files by their names; it may also change the common options. The
        option `SKIPPED` names the kind of a file that is left out.
    drives : bool
        Whether each source is a whole drive, found by `manip3d.batch.find_drives`.
    whole : sequence of str
        See `Many`.
    has_to : bool
        Whether the command gets the option ``--to``, if it has outputs.
    depends : callable(options) -> str
        Returns a text that changes if anything else changes on which results depend, such as the
        content of a key file. Stored rows are used again only if the text is the same.
    finish : callable(summary, output)
        Called at the end of a run with an output.
    finished : str
        Name of the file in the output folder that ``finish`` writes.
    choose : callable(files) -> files
        Returns the files that are sources themselves, without files that belong to another source.
    skipped_code : int
        Exit code of a file that is skipped because the verb does not take its kind.
    exit_code : callable(rows, options) -> int
        Exit code of all rows together; default: the most serious one. Rows of files that failed
        have an ``error``, and count as 1.
    columns : sequence of str
        Columns that are printed for people, if any row has them; the table and ``--json`` hold all
        columns. Empty: all columns are printed, as CSV.
    check : callable(options)
        Refuses options that are wrong for every file, before files are searched.
    beside : callable(source) -> sequence of Path
        Files that the verb reads with a source, other than those to which a mesh or a scan refers
        and those of `kinds.beside`. They are inputs, as are all options that are files or folders:
        a row is made again when an input changes.
    resumes : bool
        Whether rows of an earlier run are used again; False if results must be current.
    together : callable(sources, options) -> bool
        Makes one result of all files if the options ask for it, and returns whether it did;
        ``options["shared"]`` names those of ``--table``, ``--dask`` and ``--to`` that are given.
    in_order : callable(options) -> verb or None
        Returns the verb to run in place of this one if each file depends on earlier ones: all files
        are then processed anew, in order and in this process. None: files are independent. Options
        are those of ``together``, as ``prepare`` left them.
    across : callable(rows)
        Adds values to rows that result from comparing them, before they are printed.
    find : callable, optional
        See `Many`; default: `manip3d.batch.find_files`.
    logged : callable(options) -> set of str or None
        Returns the sources in a log to which the verb appends; None: no log is given. If the log is
        empty, all files are processed again. Rows of an earlier run that a log with other entries
        does not have are mentioned.
    sentence : callable(rows) -> str
        Returns a sentence on all files together, which is printed for people; empty: none.
    may_be_frames : bool
        Whether the outputs may be frames of a sequence, which are shown together: those of an
        earlier run that stay in the folder are mentioned. With ``in_order`` they are refused, or
        removed with ``--force``.
    """

    suffixes: Callable[[], Sequence[str]]
    _: KW_ONLY
    argument: str = "source"
    writable: Callable[[], Sequence[str]] = tuple
    otherwise: str = ""
    prepare: Callable[[list[SourceFile], dict[str, Any]], Mapping[str, Mapping[str, Any]]] = (
        lambda files, options: {}
    )
    drives: bool = False
    whole: Sequence[str] = ()
    has_to: bool = True
    depends: Callable[[Mapping[str, Any]], str] = lambda options: ""
    finish: Callable[[Summary, str], object] = lambda summary, output: None
    finished: str = ""
    choose: Callable[[list[SourceFile]], list[SourceFile]] = list
    skipped_code: int = 0
    exit_code: Callable[[Sequence[Mapping[str, Any]], Mapping[str, Any]], int] = (
        lambda rows, options: _gravest(rows)
    )
    columns: Sequence[str] = ()
    check: Callable[[Mapping[str, Any]], object] = lambda options: None
    beside: Callable[[str], Sequence[Path]] = lambda source: ()
    resumes: bool = True
    together: Callable[[list[str], dict[str, Any]], bool] = lambda sources, options: False
    in_order: Callable[[Mapping[str, Any]], Verb | None] = lambda options: None
    across: Callable[[list[dict[str, Any]]], object] = lambda rows: None
    find: Callable[..., list[SourceFile]] | None = None
    logged: Callable[[Mapping[str, Any]], set[str] | None] = lambda options: None
    sentence: Callable[[Sequence[Mapping[str, Any]]], str] = lambda rows: ""
    may_be_frames: bool = False

    def __call__(self, verb: Verb) -> Verb:
        """Return the command: the verb for one file or for many, with the options of many files."""
        signature = _signature(verb, self)

        @functools.wraps(verb)
        def command(**given: Any) -> None:
            self._command(verb, given)

        command.__signature__ = signature  # type: ignore[attr-defined]
        command.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
        return command

    def _command(self, verb: Verb, given: dict[str, Any]) -> None:
        """Run the verb on the one file, or on each of the many files, that the command names."""
        sources: list[str] = given.pop(self.argument)
        expect_named(self.argument, *sources)
        has_jobs = "jobs" in inspect.signature(verb).parameters
        batch = _BatchOptions(
            to=given.pop("to", ""),
            table=given.pop("table"),
            dask=given.pop("dask"),
            jobs=given["jobs"] if has_jobs else given.pop("jobs"),
        )
        if self.together(sources, given | batch.asked):
            return
        if not batch.asked["shared"] and _is_one(sources):
            _one(verb, self.argument, sources[0], given)
            return
        _Run(self, verb, sources, given, batch).run()

    def many(self, to: str) -> Many:
        """Return the rules of files, with the suffix of ``--to``."""
        from manip3d.batch import find_drives, find_files

        return Many(
            suffixes=self.suffixes(),
            to=to,
            writable=self.writable(),
            otherwise=self.otherwise,
            noun="source" if self.drives else "file",
            find=self.find or (find_drives if self.drives else find_files),
            whole=self.whole,
        )


@dataclass(frozen=True)
class _BatchOptions:
    """Options of every command for many files. An empty text is an option that is not given."""

    to: str
    table: str
    dask: str
    jobs: int

    @property
    def asked(self) -> dict[str, list[str]]:
        """The option ``shared`` of `over_files`: names of the options that are given."""
        return {"shared": [name for name in ("table", "dask", "to") if getattr(self, name)]}


class _Run:
    """One run of a verb over many files.

    Parameters
    ----------
    rules : over_files
    verb : callable
    sources : sequence of str
        Sources as they were given.
    given : dict
        All other options; changed by ``rules.prepare`` only.
    batch : _BatchOptions
    """

    def __init__(
        self,
        rules: over_files,
        verb: Verb,
        sources: Sequence[str],
        given: dict[str, Any],
        batch: _BatchOptions,
    ) -> None:
        self._rules, self._verb, self._sources = rules, verb, sources
        self._given, self._batch = given, batch
        self._output = given.get("output")
        self._shell = Terminal(as_json=given.get("as_json", False), quiet=given.get("quiet", False))

    def run(self) -> None:
        """Process the files, print their rows, and exit with the code of all of them.

        Raises
        ------
        InputError
            An option is wrong for every file, or there are no files.
        Error
            A file failed.
        typer.Exit
            The exit code is neither 0 nor that of a failure.
        """
        rules, given = self._rules, self._given
        rules.check(given)
        many = rules.many(self._batch.to)
        files = self._files(many)
        each = rules.prepare(files, given)
        next_one = rules.in_order(given | self._batch.asked)
        files = self._stamped(files)
        earlier = self._earlier(many, files, each, in_order=next_one is not None)
        with ended_like_ctrl_c():
            summary = self._rows(many, files, each, next_one)
        if earlier:
            self._clear(_not_written(earlier, summary.rows), in_order=next_one is not None)
        if self._output is not None:
            rules.finish(summary, str(self._output))
        code = rules.exit_code(summary.rows, given)
        _tell_failed(summary, many.noun, code)
        if code:
            raise typer.Exit(code)

    def _files(self, many: Many) -> list[SourceFile]:
        found = many.files(self._sources)  # first, so that an empty folder is reported first
        many.check_folder(self._sources, self._output)
        self._check_table()
        files = self._rules.choose(found)
        if not files:
            raise InputError(f"{', '.join(self._sources)}: expected {many.noun}s, found none")
        if self._output is not None:
            many.refuse_output(self._rules.finished, files)
        return files

    def _check_table(self) -> None:
        """Refuse a table in a folder that does not exist, unless the outputs make the folder."""
        if not self._batch.table or is_url(self._batch.table):
            return
        table = Path(self._batch.table)
        output = None if self._output is None else Path(self._output).absolute()
        if output is None or not table.absolute().is_relative_to(output):
            check_parent(table, option="--table")

    def _stamped(self, files: Sequence[SourceFile]) -> list[SourceFile]:
        """Return the files with stamps that also change with what else decides on the rows."""
        from manip3d._util.fingerprint import presentation_fingerprint

        also = self._rules.depends(self._given)
        also = f"{also} {presentation_fingerprint()}".lstrip()  # rows depend on cli code, too
        return [replace(file, stamp=f"{file.stamp} {also}") for file in files]

    def _earlier(
        self,
        many: Many,
        files: Sequence[SourceFile],
        each: Mapping[str, Mapping[str, Any]],
        *,
        in_order: bool,
    ) -> list[Path]:
        """Return the frames that an earlier run left in the output folder.

        Frames of a sequence (``in_order``) that this run does not replace are refused without
        ``--force``.
        """
        if self._output is None or not self._rules.may_be_frames:
            return []
        from manip3d.batch._earlier import earlier_outputs, store_outputs

        output, table = str(self._output), self._batch.table
        earlier = earlier_outputs(output, table)
        if in_order and not self._given["force"]:
            skipped = {f.relative for f in files if SKIPPED in each.get(f.name, {})}
            names = [new for old, new in many.names(files).items() if old not in skipped]
            _refuse_others(earlier, Path(output), names)
        if earlier:
            store_outputs(earlier, output, table)
        return earlier

    def _rows(
        self,
        many: Many,
        files: Sequence[SourceFile],
        each: Mapping[str, Mapping[str, Any]],
        next_one: Verb | None,
    ) -> Summary:
        """Run the verb, or what ``in_order`` returned, on each file and print the rows."""
        from manip3d import batch

        rules, given, shell = self._rules, self._given, self._shell
        work = {
            "module": self._verb.__module__,
            "verb": self._verb.__name__,
            "argument": rules.argument,
            "skipped_code": rules.skipped_code,
        }
        options = {n: value for n, value in given.items() if n not in ("output", *_SHARED)}
        failures = _Failures(shell, many.noun)
        logged = rules.logged(given)
        is_empty = logged is not None and not logged
        with shell.progress(self._verb.__name__) as progress:
            summary = batch.run(
                on_file if next_one is None else _in_this_process(next_one),
                files,
                None if self._output is None else str(self._output),
                options={**work, "options": options},
                options_of=lambda file: {
                    "named": file.is_named,
                    "more": each.get(file.name, {}),
                    "shown_as": file.name,
                },
                rename=many.names(files).__getitem__,
                table=self._batch.table or None,
                jobs=1 if next_one is not None else self._batch.jobs,
                dask=self._batch.dask,
                overwrite=given.get("force", False),
                resume=rules.resumes and next_one is None and not is_empty,
                inputs_of=lambda file: self._inputs(file, each.get(file.name, {})),
                progress=progress,
                on_error=failures.tell,
            )
        failures.tell_rest()
        _tell_warnings(shell, summary.rows, many.noun)
        rules.across(summary.rows)
        if words := rules.sentence(summary.rows):
            shell.say(words)
        _tell(shell, summary, many.noun, rules.columns)
        if logged is not None:
            self._tell_not_logged(summary, many.noun)
        return summary

    def _tell_not_logged(self, summary: Summary, noun: str) -> None:
        """Mention rows of an earlier run that the log does not have."""
        logged = self._rules.logged(self._given) or set()
        rows = (row for row in summary.rows if not row.get("error") and not row.get(SKIPPED))
        missing = sum(row["source"] not in logged for row in rows)
        if summary.resumed and missing:
            told = counted(missing, noun)
            self._shell.warn(
                f"{self._given['log']} has no entry of {told} from an earlier run; --force judges "
                "all again"
            )

    def _inputs(self, file: SourceFile, more: Mapping[str, Any]) -> list[str]:
        """Return the files and folders that the verb reads in addition to the source.

        ``more`` are the options of this file alone.
        """
        read = {name: value for name, value in self._given.items() if name not in _WRITTEN}
        named = set(_texts([*read.values(), *more.values()]))
        there = {name for name in named if is_url(name) or _is_there(name)}
        found = [
            *self._rules.beside(file.name),
            *(path for name in (file.name, *there) for path in kinds.beside(name)),
        ]
        return sorted(there | {str(path) for path in found})

    def _clear(self, left: Sequence[Path], *, in_order: bool) -> None:
        """Remove the frames of an earlier run that are left, if this run may, else mention them."""
        if in_order and self._given["force"]:
            for path in left:
                path.unlink(missing_ok=True)
        elif left:
            self._shell.say(
                f"{self._output}: keeps {_of_earlier(left)}, which this one did not make"
            )


def _refuse_others(earlier: Sequence[Path], folder: Path, names: Iterable[str]) -> None:
    """Refuse a folder with frames of an earlier sequence that this one does not replace.

    Raises
    ------
    InputError
        There are such frames.
    """
    own = {(folder / name).resolve() for name in names}
    if others := [path for path in earlier if path not in own]:
        raise InputError(
            f"{folder}: holds {_of_earlier(others)}, which this one does not make; --force removes "
            f"{'it' if len(others) == 1 else 'them'}"
        )


def _of_earlier(paths: Sequence[Path]) -> str:
    more = "" if len(paths) == 1 else f" and {counted(len(paths) - 1, 'more file')}"
    return f"{paths[0].name}{more} of an earlier run"


def _not_written(earlier: Sequence[Path], rows: Sequence[Mapping[str, Any]]) -> list[Path]:
    """Return the outputs of an earlier run that this run did not write; none if it wrote nothing.

    A run that fails altogether thus leaves the folder as it was.
    """
    made = [row for row in rows if not row.get("error") and not row.get(SKIPPED)]
    written = {Path(row["output"]).resolve() for row in made}
    return [path for path in earlier if path not in written] if written else []


_SEVERAL_FILES = "Several of them, folders, patterns and URLs are accepted, too."
_SEVERAL_DRIVES = "Several of them, folders of drives, and patterns are accepted, too."


def with_defaults(verb: Verb, **defaults: Any) -> Verb:
    """Return a verb whose options have other defaults."""
    known = inspect.signature(verb)
    parameters = [
        p.replace(default=defaults.get(name, p.default)) for name, p in known.parameters.items()
    ]

    @functools.wraps(verb)
    def command(**given: Any) -> None:
        verb(**given)

    command.__signature__ = known.replace(parameters=parameters)  # type: ignore[attr-defined]
    return command


def _signature(verb: Verb, rules: over_files) -> inspect.Signature:
    """Return the verb's signature with several sources and the options of many files."""
    name = rules.argument
    more_of_them = _SEVERAL_DRIVES if rules.drives else _SEVERAL_FILES
    hints = get_type_hints(verb, include_extras=True)
    parameters = {
        n: parameter.replace(annotation=hints[n])
        for n, parameter in inspect.signature(verb).parameters.items()
    }
    one_file = parameters[name].annotation.__metadata__[0].help
    several = typer.Argument(metavar=name.upper(), help=f"{one_file} {more_of_them}")
    parameters[name] = parameters[name].replace(annotation=Annotated[list[str], several])
    own_jobs = hints.get("jobs", FileJobs)
    more: dict[str, tuple[Any, Any]] = {"jobs": (FolderJobs if own_jobs == Jobs else own_jobs, 0)}
    table: Any = Table
    if "output" in parameters:
        table = TableBesideOutputs
        more |= {"to": (To, "")} if rules.has_to else {}
        output = copy.copy(parameters["output"].annotation.__metadata__[0])
        output.parser, output.metavar = _path_or_url, output.metavar or "PATH"
        # Any, because typer would convert the parser's result to a Path.
        parameters["output"] = parameters["output"].replace(annotation=Annotated[Any, output])
    more |= {"table": (table if rules.resumes else TableOfNow, ""), "dask": (Dask, "")}
    for option, (annotation, default) in more.items():
        if option in parameters:
            parameters[option] = parameters[option].replace(annotation=annotation)
        else:
            parameters[option] = inspect.Parameter(
                option, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation
            )
    parameters = {n: p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for n, p in parameters.items()}
    return inspect.Signature(list(parameters.values()), return_annotation=None)


def _path_or_url(text: str) -> Any:
    """Return a `Path`, or the text of a URL, whose two slashes a `Path` would merge."""
    return text if is_url(text) else Path(text)


def _is_one(sources: Sequence[str]) -> bool:
    """Return whether the sources are one file, or a folder that is one recording."""
    from manip3d.batch import is_folder, is_pattern

    if len(sources) > 1 or is_pattern(sources[0]):
        return False
    (source,) = sources
    if is_url(source):
        return not is_folder(source)
    return not Path(source).is_dir() or kinds.kind_of(source) != "folder"


def _one(verb: Verb, argument: str, source: str, given: dict[str, Any]) -> None:
    """Run the verb on one file; download a remote source, upload a complete remote output."""
    output = given.get("output")
    opened = local_copy(source) if is_url(source) else nullcontext(source)
    target = local_output(str(output)) if is_url(str(output)) else nullcontext(output)
    with opened as local, target as written:
        names = {str(local): source} | ({} if output is None else {str(written): str(output)})
        more = {} if "output" not in given else {"output": written and Path(written)}
        code = 0
        with showing_as(names):
            try:
                verb(**(given | more | {argument: str(local)}))
            except typer.Exit as done:  # the output is still uploaded
                code = done.exit_code
    if code:
        raise typer.Exit(code)


class _Failures:
    """Prints why files failed, each reason once, and counts files with the same reason.

    A wrong option, for example, is the same reason for every file of a folder.
    """

    def __init__(self, shell: Terminal, noun: str) -> None:
        self._shell, self._noun = shell, noun
        self._first: dict[str, str] = {}  # the first source with each reason
        self._more: Counter[str] = Counter()

    def tell(self, source: str, error: str) -> None:
        """Print a reason if it is new."""
        if error in self._first:
            self._more[error] += 1
            return
        self._first[error] = source
        self._shell.say(f"{source}: {error}")

    def tell_rest(self) -> None:
        """Print how many more files failed for each reason."""
        for error, number in self._more.items():
            more = counted(number, f"more {self._noun}")
            self._shell.say(f"{more} failed for the same reason as {self._first[error]}")


def _tell_warnings(shell: Terminal, rows: Sequence[Mapping[str, Any]], noun: str) -> None:
    """Print the warnings of all files, each text once, also those of rows of an earlier run."""
    sources_of: dict[str, list[str]] = {}
    for row in rows:
        for text in row.get("warnings", ()):
            sources_of.setdefault(text, []).append(row["source"])
    for text, (first, *others) in sources_of.items():
        more = f" and {counted(len(others), f'more {noun}')}" if others else ""
        shell.say(f"{first}{more}: warning: {text}")


_SHARED = ("as_json", "quiet", "force", "jobs")
"""Options of a verb that hold for the whole run; `on_file` gives them values of its own."""
_WRITTEN = ("output", "log", "report", "rows", "state")
"""Options that are files which a verb writes. They are no inputs of its rows."""


def _texts(values: Iterable[Any]) -> Iterator[str]:
    """Yield all texts that may name a file, and paths of addresses (``folder:PATH?rate=30``)."""
    for value in values:
        if isinstance(value, str | Path):
            text = str(value)
            yield from (text, text.partition(":")[2].partition("?")[0])
        elif isinstance(value, list | tuple):
            yield from _texts(value)


def _is_there(name: str) -> bool:
    try:
        return bool(name) and Path(name).exists()
    except (OSError, ValueError):  # the text cannot be a file name
        return False


def on_file(
    source: Path,
    output: Path | None,
    *,
    module: str,
    verb: str,
    argument: str,
    options: Mapping[str, Any],
    named: bool,
    more: Mapping[str, Any],
    shown_as: str,
    skipped_code: int = 0,
    in_place: Verb | None = None,
) -> dict[str, Any]:
    """Run a verb on one file of many, and return its result for ``--json`` with its exit code.

    ``in_place`` is called in place of the verb, with the same arguments.
    The row has the verb's warnings, if any, as ``warnings``.
    A file of a folder whose kind the verb does not accept is no error: its row has ``skipped``.
    """
    import multiprocessing

    if SKIPPED in more:
        return {SKIPPED: more[SKIPPED], "exit_code": skipped_code}

    if multiprocessing.parent_process() is not None:  # this is a worker process
        start_messages()
    function = inspect.unwrap(getattr(importlib.import_module(module), verb))
    parameters = inspect.signature(function).parameters
    fixed = {"as_json": True, "quiet": True, "force": True, "jobs": 0}
    given: dict[str, Any] = {n: value for n, value in fixed.items() if n in parameters}
    given |= {**options, **more}
    if "output" in parameters:
        given["output"] = output
    code = 0
    names = {str(source): shown_as} if is_url(shown_as) else {}
    with collecting() as found, showing_as(names):
        try:
            (in_place or function)(**given, **{argument: str(source)})
        except typer.Exit as done:
            code = done.exit_code
        except kinds.OtherKindError as error:
            if named:
                raise
            return {SKIPPED: error.kind, "exit_code": skipped_code}
    record = found.results[0] if found.results else {}
    paths = (str(source), str(output))
    row = {k: v for k, v in record.items() if v not in paths} | {"exit_code": code}
    return row | ({"warnings": list(dict.fromkeys(found.warnings))} if found.warnings else {})


def _in_this_process(verb: Verb) -> Callable[..., dict[str, Any]]:
    """Return `on_file` for a verb that no worker can import, since it has a state."""
    return functools.wraps(on_file)(functools.partial(on_file, in_place=verb))


def _tell(shell: Terminal, summary: Summary, noun: str, columns: Sequence[str]) -> None:
    skipped = sum(bool(row.get(SKIPPED)) for row in summary.rows)
    parts = {
        "from an earlier run": summary.resumed,
        "skipped, of another kind": skipped,
        "failed": summary.failed,
    }
    told = ", ".join(f"{count(number)} {words}" for words, number in parts.items() if number)
    written = f"; table in {summary.table}" if summary.table else ""
    shell.say(
        f"{counted(len(summary.rows), noun)}{f' ({told})' if told else ''} in "
        f"{summary.seconds:.1f} s{written}"
    )
    shell.result(
        summary.rows,
        None if summary.table else functools.partial(_print_rows, summary.rows, columns),
    )


def _print_rows(
    rows: Sequence[Mapping[str, Any]], columns: Sequence[str], console: Console
) -> None:
    """Print some columns as a table, with errors of failed files; without columns, all as CSV."""
    from manip3d.batch._table import table_text

    if not columns:
        print(table_text(rows), end="")
        return
    had = [name for name in columns if any(row.get(name) is not None for row in rows)]
    heads = [*had, *(name for name in (SKIPPED, "error") if any(r.get(name) for r in rows))]
    show_table(console, [[_cell(row.get(name)) for name in heads] for row in rows], heads)


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return "..".join(map(_cell, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _tell_failed(summary: Summary, noun: str, code: int) -> None:
    """Exit with 1 if a file failed, unless another file has a more serious code."""
    if not summary.failed:
        return
    told = f"{count(summary.failed)} of {counted(len(summary.rows), noun)} failed"
    if code in (0, 1):
        raise Error(told)
    print(f"manip3d: error: {told}", file=sys.stderr)


def _gravest(rows: Sequence[Mapping[str, Any]]) -> int:
    """Return the most serious exit code of the files; an unknown code is not treated as success."""
    codes = {1 if row.get("error") else int(row["exit_code"]) for row in rows}
    known = (code for code in _GRAVEST_FIRST if code in codes)
    return next(known, max(codes, default=0))
