"""`run`: one function over many files."""

from __future__ import annotations

import functools
import hashlib
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.fingerprint import code_fingerprint
from manip3d._util.json import canonical_json, finite
from manip3d._util.options import fraction_only, reporting
from manip3d._util.parallel import check_function
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.batch._owners import Owners
from manip3d.batch._places import Place
from manip3d.batch._rows import Rows
from manip3d.batch._sources import SourceFile, each_once, find_files
from manip3d.batch._stamps import BESIDE, Stamps, named_by
from manip3d.batch._stored import Row, run_stored
from manip3d.batch._table import check_table, write_table
from manip3d.errors import FormatError, InputError
from manip3d.io._limits import ReadLimits, all_in_force, limits_in_force
from manip3d.io._remote import is_url, local_copy, local_output

if TYPE_CHECKING:
    from manip3d._util.options import Progress

Work = Callable[..., Mapping[str, Any]]


@dataclass(frozen=True)
class Summary:
    """Result of `run`.

    Attributes
    ----------
    rows : list of dict
        One row for each file, in the order of their names: ``source``, ``output``, ``error`` (empty
        without an error), ``output_bytes`` (including records and truths beside the output, and,
        without a URL, the files that it names), ``task_seconds``, and the columns that the function
        returned under other names. A file that failed has ``error_details`` instead of these
        columns: ``code``, ``message``, and, if known, ``file``, ``line`` and ``byte_offset``.
    resumed : int
        Rows that an earlier run had made.
    failed : int
        Rows with an error.
    seconds : float
        Wall time.
    table : str or None
        Where the table was written.
    """

    rows: list[Row]
    resumed: int
    failed: int
    seconds: float
    table: str | None

    __repr__ = short_repr


@checked
def run(
    function: Work,
    sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str] | SourceFile],
    output: str | os.PathLike[str] | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    options_of: Callable[[SourceFile], Mapping[str, Any]] | None = None,
    rename: Callable[[str], str] | None = None,
    suffixes: Sequence[str] | None = None,
    table: str | os.PathLike[str] | None = None,
    jobs: int = 0,
    dask: str = "",
    overwrite: bool = False,
    resume: bool = True,
    inputs_of: Callable[[SourceFile], Sequence[str | os.PathLike[str]]] | None = None,
    progress: Progress = None,
    on_error: Callable[[str, str], object] = lambda source, error: None,
) -> Summary:
    """Call a function for each of many files, in parallel, and gather its results in one table.

    Parameters
    ----------
    function : callable(source, output, **options) -> mapping
        Processes one file: reads the path ``source``, writes the path ``output`` (a file or a
        folder; None without outputs) and returns the columns of its row. Workers import it by its
        name from a module or a script, not from a cell of a notebook: there give ``jobs=1`` or
        ``dask="local"``, or define it in a module.
    sources : path, URL, or sequence of them
        Files, folders and patterns, as for `find_files`, or its result.
    output : path or URL, optional
        Folder of the outputs, with the same subfolders as the sources.
    options : mapping, optional
        Keyword arguments of the function; values must be representable in JSON.
    options_of : callable(SourceFile) -> mapping, optional
        Further keyword arguments for each file.
    rename : callable(str) -> str, optional
        Name of an output from the relative name of its source; default: the same.
    suffixes : sequence of str, optional
        Files of a folder that are taken, as for `find_files`.
    table : path or URL, optional
        ``.csv`` or ``.parquet``; default: ``results.csv`` in ``output``. Rows are stored beside it
        as they come, in a folder that ends in ``.rows``; a run without a table cannot be resumed.
        The table has the files of the last run; stored rows of other files are kept beside it.
    jobs : int
        Processes; 0: one per core; 1: in this process. They import the script that calls this, so
        that the call must be below ``if __name__ == "__main__":``.
    dask : str
        Address of a Dask scheduler whose workers see the same files; ``"local"`` starts one here.
    overwrite : bool
        Replace existing rows and outputs.
    resume : bool
        False: make all rows anew and replace stored ones, for results that must be current.
    inputs_of : callable(SourceFile) -> sequence of path or URL, optional
        Files and folders that the function reads besides the source: a row is made again if one of
        them has changed. Files to which a mesh or a scan refers (material libraries, textures,
        buffers, poses) need not be listed.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.
    on_error : callable(source, error)
        Called for each file that fails.

    Returns
    -------
    Summary

    Raises
    ------
    InputError
        No file is found; two files have the same output; an output exists that no earlier run with
        this table has made of the same source, or a table that no run of this call has made; the
        table has another suffix. Worker processes cannot import the function, or the script calls
        this while they import it.
    MissingExtraError
        The table is Parquet, and pyarrow is not installed; no file is processed.
    OSError
        A source, the table or the output folder cannot be reached.
    KeyboardInterrupt
        Raised after the workers were stopped; finished rows are stored.

    Notes
    -----
    A stored row is used again if all that it depends on is unchanged: the function and its options,
    the library, the size of the output with what it names, and the sizes and times of its inputs
    (the source, the files to which the source refers, and those of ``inputs_of``). The times are
    those of modification (mtime) and of status change (ctime), which programs cannot set.

    Examples
    --------
    >>> import manip3d
    >>> from manip3d import batch
    >>> def count(source, output):
    ...     return {"points": manip3d.io.read_scan(source).num_points}
    >>> summary = batch.run(count, "scans", table="points.csv", jobs=4)  # doctest: +SKIP
    """
    if jobs < 0:
        raise InputError(f"jobs: expected >= 0, got {jobs}")
    jobs = jobs or len(os.sched_getaffinity(0))
    check_function(function, jobs, dask)
    started = time.perf_counter()
    folder = None if output is None else Place(os.fspath(output))
    files = _listed(sources, suffixes, folder)
    targets = _targets(files, folder, rename or (lambda name: name))
    place = table_of(table, folder)
    asked = _asked(function, options or {})
    stamps_of = _stamps_of(inputs_of, place, folder, targets)
    limits = limits_in_force()
    tasks, names = {}, {}
    for file in files:
        own = dict(options_of(file) if options_of else {})
        arguments = (function, file.name, targets[file.name], dict(options or {}) | own, limits)
        key = _key([file.name, targets[file.name], asked, _json_of(own), stamps_of(file)])
        tasks[key], names[key] = (one_file, arguments), file.name
    rows_of = functools.partial(Rows, overwrite=overwrite, resume=resume)
    store = _store(asked, place, folder, targets, overwrite, rows_of)
    try:
        with reporting(progress, "files") as told:
            found = run_stored(
                tasks,
                store,
                jobs,
                dask=dask,
                progress=progress if callable(progress) else fraction_only(told),
                describe=names.__getitem__,
                on_error=lambda key, error: on_error(names[key], error),
            )
    finally:
        store.flush()
    rows = [
        found.done[key]
        if key in found.done
        else {
            "source": name,
            "output": targets[name],
            "error": found.failed[key],
            "error_details": dict(found.details[key]),
        }
        for key, name in names.items()
    ]
    if place is not None:
        write_table(rows, place)
    seconds = time.perf_counter() - started
    return Summary(rows, found.resumed, len(found.failed), seconds, place)


def one_file(
    function: Work,
    source: str,
    output: str | None,
    options: Mapping[str, Any],
    limits: Sequence[ReadLimits] = (),
) -> Row:
    """Download a source, process it, upload the output, and return the row; runs on a worker."""
    started = time.perf_counter()
    target = nullcontext() if output is None else local_output(output)
    with all_in_force(limits), local_copy(source) as local, target as written:
        if written is not None:
            written.parent.mkdir(parents=True, exist_ok=True)
        try:
            columns = dict(function(local, written, **options))
        except Exception as error:  # messages must name the source, not its local copy
            error.args = tuple(
                part.replace(str(local), source) if isinstance(part, str) else part
                for part in error.args
            )
            if isinstance(error, FormatError) and error.file == str(local):
                error.file = source
            raise
        num_bytes, names = None, {str(local): source}
        if written is not None and output is not None:
            num_bytes = bytes_of(written, is_remote=is_url(output))
            names[str(written)] = output
    fixed = {
        "source": source,
        "output": output,
        "error": "",
        "output_bytes": num_bytes,
        "task_seconds": round(time.perf_counter() - started, 4),
    }
    plain: Row = finite(json.loads(json.dumps(columns, default=_plain)))
    own = {
        key: names.get(value, value) if isinstance(value, str) else value
        for key, value in plain.items()
    }
    return fixed | own | fixed


def bytes_of(output: Path, *, is_remote: bool = False) -> int | None:
    """Return the size of an output, file or folder, with the files beside it; None: missing.

    Files that a remote output names are not counted: to know them again, it would be fetched.
    """
    if not output.exists():
        return None
    sizes = Place(str(output)).sizes().values() if output.is_dir() else [output.stat().st_size]
    beside = {output.with_name(f"{output.name}{suffix}") for suffix in BESIDE}
    if output.is_file() and not is_remote:
        beside |= set(named_by(output))
    return sum(sizes) + sum(path.stat().st_size for path in beside if path.is_file())


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)


def _listed(sources: Any, suffixes: Sequence[str] | None, output: Place | None) -> list[SourceFile]:
    """List the source files, without outputs of an earlier run that lie below the sources."""
    several = [sources] if isinstance(sources, str | os.PathLike) else list(sources)
    listed = [file for file in several if isinstance(file, SourceFile)]
    rest = [source for source in several if not isinstance(source, SourceFile)]
    found = each_once([*listed, *(find_files(rest, suffixes=suffixes) if rest else [])])
    if not found:
        raise InputError("sources: expected files, found none")
    if output is None:
        return found
    lies_in_output = _lies_in(output)
    kept = [file for file in found if file.is_named or not lies_in_output(file.name)]
    if not kept:
        raise InputError("sources: expected files, found only those in the output folder")
    return kept


def _lies_in(output: Place) -> Callable[[str], bool]:
    """Return whether a file lies in a folder, however the paths of both are written."""
    if is_url(output.folder):
        within = output.of("")
        return lambda name: name.startswith(within)
    folder = Path(output.folder).resolve()

    @functools.cache
    def is_within(parent: Path) -> bool:
        return parent.resolve().is_relative_to(folder)

    return lambda name: not is_url(name) and is_within(Path(name).parent)


def _targets(
    files: Sequence[SourceFile], output: Place | None, rename: Callable[[str], str]
) -> dict[str, str | None]:
    if output is None:
        return {file.name: None for file in files}
    targets: dict[str, str | None] = {}
    taken: dict[str, str] = {}
    for file in files:
        if file.relative.startswith(".."):
            raise InputError(f"{file.name}: expected a file below the folder it was found by")
        target = output.of(rename(file.relative))
        if target in taken:
            raise InputError(
                f"{target}: two inputs would be written there: {taken[target]} and {file.name}; "
                "name a folder above both, or give each an output folder of its own"
            )
        taken[target] = file.name
        targets[file.name] = target
    return targets


def _stamps_of(
    inputs_of: Callable[[SourceFile], Sequence[str | os.PathLike[str]]] | None,
    table: str | None,
    output: Place | None,
    targets: Mapping[str, str | None],
) -> Callable[[SourceFile], Any]:
    """Return the function that stamps a file and all other inputs of its row."""
    if table is None:
        return lambda file: file.stamp
    stamps = Stamps(
        None if output is None else output.folder,
        (table, rows_folder(table)),
        [target for target in targets.values() if target is not None],
    )

    def stamps_of(file: SourceFile) -> Any:
        inputs = [os.fspath(name) for name in (inputs_of(file) if inputs_of else ())]
        named = [[name, stamps.stamp_of_input(name)] for name in inputs]
        return [file.stamp, stamps.stamp_of_companions(file.name), named]

    return stamps_of


def _key(identity: Sequence[Any]) -> str:
    return hashlib.sha256(canonical_json([*identity, code_fingerprint()])).hexdigest()[:32]


def _asked(function: Work, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of the key that all rows of a run share: function and options."""
    if not hasattr(function, "__qualname__"):  # for example a functools.partial
        raise InputError(f"function: expected one with a name, got {function!r}")
    name = f"{function.__module__}:{function.__qualname__}"
    return {"function": name, "options": _json_of(options)}


def _json_of(options: Mapping[str, Any]) -> Any:
    return json.loads(json.dumps(dict(options), default=_plain))


def table_of(table: str | os.PathLike[str] | None, output: Place | None) -> str | None:
    """Return the path or URL of a run's table, by default in the folder of its outputs."""
    if table is None:
        return None if output is None else output.of("results.csv")
    name = os.fspath(table) if is_url(table) else str(path_of(table, "table"))
    check_table(name)
    return name


class _Memory:
    """A store that keeps nothing, for a run without a table, which cannot be resumed."""

    def load(self, key: str) -> Row | None:
        return None

    def save(self, key: str, row: Row) -> Row:
        return row

    def flush(self) -> None:
        """Do nothing."""


class _Checked:
    """Stored rows, without those whose output is missing, of another size or of a later row."""

    def __init__(self, rows: Rows, output: Place | None, sizes: Mapping[str, int]) -> None:
        self._rows, self._output, self._sizes = rows, output, sizes
        self._last = {row["output"]: key for key, row in rows.items()}

    def load(self, key: str) -> Row | None:
        row = self._rows.load(key)
        if row is None or self._output is None or row["output_bytes"] is None:
            return row
        if self._last[row["output"]] != key:
            return None
        if not is_url(row["output"]):
            return row if bytes_of(Path(row["output"])) == row["output_bytes"] else None
        name = str(row["output"]).removeprefix(self._output.of(""))
        if name not in self._sizes:
            return None
        there = sum(self._sizes.get(f"{name}{suffix}", 0) for suffix in ("", *BESIDE))
        return row if there == row["output_bytes"] else None

    def save(self, key: str, row: Row) -> Row:
        return self._rows.save(key, row)

    def flush(self) -> None:
        self._rows.flush()


def _store(
    asked: dict[str, Any],
    table: str | None,
    output: Place | None,
    targets: Mapping[str, str | None],
    overwrite: bool,
    rows_of: Callable[..., Rows],
) -> _Checked | _Memory:
    """Return the store of rows of earlier runs; refuse to replace files that are not theirs."""
    sizes = {} if output is None else _with_folders(output.sizes())
    if table is None:
        return _Memory()
    folder = Place(rows_folder(table))
    names = folder.names()
    owners = Owners(folder, names)
    if not overwrite:
        if output is not None:
            owners.refuse_others(output, sizes, targets)
        if not names and _is_there(table, output, sizes):
            raise InputError(f"{table}: exists already; overwrite=True replaces it")
    rows = rows_of(str(folder), asked)
    if output is not None:
        owners.add(output, targets)
    return _Checked(rows, output, sizes)


def _is_there(table: str, output: Place | None, sizes: Mapping[str, int]) -> bool:
    if not is_url(table):
        return Path(table).exists()
    return output is not None and table in map(output.of, sizes)


def rows_folder(table: str) -> str:
    """Return the folder in which the rows of a table are stored during the run."""
    return f"{table.removesuffix(PurePosixPath(table).suffix)}.rows"


def _with_folders(sizes: Mapping[str, int]) -> dict[str, int]:
    """Return the sizes of files and of the folders that they are in, by relative name."""
    totals = dict(sizes)
    for name, size in sizes.items():
        for folder in PurePosixPath(name).parents[:-1]:
            totals[str(folder)] = totals.get(str(folder), 0) + size
    return totals
