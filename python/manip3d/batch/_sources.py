"""Find the files and drives that paths, folders, patterns and URLs refer to."""

from __future__ import annotations

import functools
import glob
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.paths import by_number, is_hidden, path_of
from manip3d.batch._stamps import (
    stamp_of_file,
    stamp_of_files,
    stamp_of_folder,
    stamp_of_info,
)
from manip3d.errors import InputError
from manip3d.io._remote import filesystem, is_url, naming_remote

_ADDRESSES = ("sim:", "forged:")
_MAGIC = re.compile(r"[*?\[]")


@dataclass(frozen=True)
class SourceFile:
    """One file of a batch.

    Attributes
    ----------
    name : str
        Path or URL.
    relative : str
        Path below the named folder, or below the fixed part of the pattern.
    stamp : str
        A text that changes with the content: size and times of modification and status change, or
        the version in a remote store. ``gone`` for a file without them, such as a dangling link,
        whose row then has an error.
    is_named : bool
        Whether the file was named itself or by a pattern; False if it was found in a folder.
    """

    name: str
    relative: str
    stamp: str
    is_named: bool = True


@checked
def is_pattern(source: str) -> bool:
    """Return whether a source is a pattern such as ``scans/*.bin``.

    A name with ``*``, ``?`` or ``[`` is not a pattern if there is a file of that name.

    The ``?`` of an address such as ``sim:body?motion=wave`` begins its options.

    Parameters
    ----------
    source : str
        A path, a URL or an address such as ``sim:body``.

    Returns
    -------
    bool

    Raises
    ------
    InputError
        ``source`` is not a str.

    Examples
    --------
    >>> from manip3d import batch
    >>> [batch.is_pattern(source) for source in ("scans/*.bin", "scan.bin", "sim:body?motion=wave")]
    [True, False, False]
    """
    if source.startswith(_ADDRESSES):
        return False
    return _MAGIC.search(source) is not None and (is_url(source) or not Path(source).exists())


@checked
def is_folder(source: str) -> bool:
    """Return whether the source is a folder, here or behind a URL.

    Parameters
    ----------
    source : str
        A path or a URL.

    Returns
    -------
    bool

    Raises
    ------
    OSError
        It is a URL that cannot be asked.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import batch
    >>> Path("scans").mkdir()
    >>> batch.is_folder("scans"), batch.is_folder("scan.bin")
    (True, False)
    """
    if not is_url(source):
        return Path(source).is_dir()
    system, path = filesystem(source)
    with naming_remote(source):
        return source.endswith("/") or bool(system.isdir(path))


@checked
def find_files(
    sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    suffixes: Sequence[str] | None = None,
) -> list[SourceFile]:
    """Return the files that sources stand for, each once, sorted by name: 2.png before 10.png.

    Parameters
    ----------
    sources : path, URL or sequence of them
        Files, folders (all files below them but hidden ones), and patterns (``*``, ``?``,
        ``[...]``, ``**``). Pipes, sockets and devices in folders are left out.
    suffixes : sequence of str, optional
        Suffixes of the files that are taken from a folder, alone or followed by ``.gz`` or ``.xz``,
        in capitals or not. Files that are named, or that a pattern matches, are taken in any case.

    Returns
    -------
    list of SourceFile
        ``relative`` is the path below the folder that was named.

    Raises
    ------
    InputError
        A folder or a pattern stands for no file.
    OSError
        There is no such file.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import batch
    >>> for name in ("a.bin", "b.bin.xz", "notes.txt"):
    ...     path = Path("scans", "day", name)
    ...     path.parent.mkdir(parents=True, exist_ok=True)
    ...     path.touch()
    >>> [file.relative for file in batch.find_files("scans", suffixes=[".bin"])]
    ['day/a.bin', 'day/b.bin.xz']
    """
    named = [sources] if isinstance(sources, str | os.PathLike) else list(sources)
    found: list[SourceFile] = []
    for source in named:
        name = source if is_url(source) else os.fspath(path_of(source, "sources"))
        found += _remote(str(name), suffixes) if is_url(source) else _local(str(name), suffixes)
    return _sorted(each_once(found))


@checked
def find_drives(
    sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    suffixes: Sequence[str] | None = None,
) -> list[SourceFile]:
    """Return the drives that sources stand for, sorted by name, each once.

    A drive is one piece of work, whatever the number of its scans: what is said of a frame depends
    on the frames before it.

    Parameters
    ----------
    sources : path or sequence of them
        Drives in KITTI's layout, folders (all drives below them), patterns, files that are taken
        as they are, and ``sim:`` addresses.
    suffixes : sequence of str, optional
        Suffixes of single files that are taken from a folder, too, as `find_files` does. Files
        within a drive are not: they are its own.

    Returns
    -------
    list of SourceFile
        ``relative`` is the path below the folder that was named.

    Raises
    ------
    InputError
        A folder or a pattern stands for nothing; a source is a URL.
    OSError
        There is no such source.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d.batch import find_drives
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("a", "b"):
    ...         (Path(folder) / "day" / name / "velodyne").mkdir(parents=True)
    ...     print([drive.relative for drive in find_drives(folder)])
    ['day/a', 'day/b']
    """
    named = [sources] if isinstance(sources, str | os.PathLike) else list(sources)
    found: list[SourceFile] = []
    for source in named:
        if is_url(source):
            raise InputError(f"{source}: expected a drive on this machine, got a URL")
        name = os.fspath(source)
        if name.startswith(_ADDRESSES):
            found.append(SourceFile(name, _plain_name(name), name))
        else:
            found += _drives_of(str(path_of(source, "sources")), suffixes)
    return _sorted(each_once(found))


def each_once(files: Sequence[SourceFile]) -> list[SourceFile]:
    """Return the files without those that an earlier one is, however their paths are written.

    Links are files of their own.
    """
    found: dict[str, SourceFile] = {}
    for name, file in zip(absolute_names([file.name for file in files]), files, strict=True):
        found.setdefault(name, file)
    return list(found.values())


def absolute_names(names: Iterable[str]) -> list[str]:
    """Return paths as absolute ones, through no links of folders; URLs and addresses unchanged."""

    @functools.cache
    def folder_of(name: str) -> str:
        return os.path.realpath(name)

    def absolute(name: str) -> str:
        if is_url(name) or name.startswith(_ADDRESSES):
            return name
        folder, own = os.path.split(name)
        if own in ("", os.curdir, os.pardir):
            return folder_of(name)
        return os.path.join(folder_of(folder), own)

    return [absolute(name) for name in names]


def _sorted(files: Sequence[SourceFile]) -> list[SourceFile]:
    key = by_number([file.name for file in files])
    return sorted(files, key=lambda file: key(file.name))


def _plain_name(address: str) -> str:
    """A name for the outputs of an address: ``sim:street?seed=1`` becomes ``sim-street-seed-1``."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", address).strip("-")


def _drives_of(source: str, suffixes: Sequence[str] | None) -> Iterator[SourceFile]:
    if is_pattern(source):
        places, root = [Path(p) for p in glob.glob(source, recursive=True)], _fixed_part(source)
        taken = [place for place in places if not place.is_dir() or _is_drive(place)]
    elif Path(source).is_dir() and not _is_drive(Path(source)):
        taken, root = list(_below(Path(source), suffixes)), source
    else:
        Path(source).stat()  # a missing source is an OSError that names it
        taken, root = [Path(source)], os.path.dirname(os.path.abspath(source))  # source may be "."
    if not taken:
        files = f", or files ({', '.join(suffixes)})" if suffixes else ""
        raise InputError(f"{source}: expected drives in KITTI's layout{files}, found none")
    is_named = is_pattern(source) or not Path(source).is_dir() or _is_drive(Path(source))
    for place in taken:
        stamp = _stamp_of_drive(place) if place.is_dir() else stamp_of_file(place)
        yield SourceFile(str(place), os.path.relpath(place, root), stamp, is_named)


def _stamp_of_drive(folder: Path) -> str:
    """Changes with the drive's files, and with the calibrations of its day, which lie beside it."""
    beside = sorted(folder.resolve().parent.glob("calib_*.txt"))
    return f"{stamp_of_folder(folder)} {stamp_of_files((file.name, file) for file in beside)}"


def _is_drive(folder: Path) -> bool:
    return (folder / "velodyne_points").is_dir() or (folder / "velodyne").is_dir()


def _below(folder: Path, suffixes: Sequence[str] | None) -> Iterator[Path]:
    """Drives below a folder, and the wanted files that belong to none."""
    for top, folders, names in _walk(folder):
        if _is_drive(Path(top)):
            folders.clear()
            yield Path(top)
        elif suffixes is not None:
            files = (Path(top) / name for name in names if _is_wanted(name, suffixes))
            yield from (file for file in files if not _may_be_endless(file))


def _walk(folder: Path) -> Iterator[tuple[str, list[str], list[str]]]:
    """Walk a folder as `os.walk` does, in the order of names and without hidden ones."""
    for top, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not is_hidden(name))
        yield top, folders, [name for name in names if not is_hidden(name)]


def _local(source: str, suffixes: Sequence[str] | None) -> Iterator[SourceFile]:
    path = Path(source)
    if is_pattern(source):
        matched = [Path(p) for p in glob.glob(source, recursive=True)]
        files = [p for p in matched if not p.is_dir() and not _may_be_endless(p)]
        root = _fixed_part(source)
    elif path.is_dir():
        walked = (Path(top) / name for top, _, names in _walk(path) for name in names)
        files = [p for p in walked if _is_wanted(p.name, suffixes) and not _may_be_endless(p)]
        root = str(path)
    else:
        path.stat()  # a missing file is an OSError that names it
        files, root = [path], str(path.parent)
    _refuse_none(files, source, suffixes)
    for file in files:
        stamp = stamp_of_file(file)
        yield SourceFile(str(file), os.path.relpath(file, root), stamp, not path.is_dir())


def _remote(source: str, suffixes: Sequence[str] | None) -> Iterator[SourceFile]:
    system, path = filesystem(source)
    in_folder = takes_hidden = False
    with naming_remote(source):
        if _MAGIC.search(path):
            infos, root = system.glob(path, detail=True), _fixed_part(path)
            takes_hidden = any(map(is_hidden, PurePosixPath(path.removeprefix(root)).parts))
        elif source.endswith("/") or system.isdir(path):
            infos, root, in_folder = system.find(path, detail=True), path, True
        else:
            infos, root = {path: system.info(path)}, str(PurePosixPath(path).parent)
    files = {
        str(name): info
        for name, info in infos.items()
        if info.get("type") == "file"
        and (not in_folder or _is_wanted(str(name), suffixes))
        and (takes_hidden or name == path or not _is_below_hidden(name, root))
    }
    _refuse_none(files, source, suffixes)
    for name, info in files.items():
        relative = str(PurePosixPath(name).relative_to(root)) if root else name
        yield SourceFile(
            str(system.unstrip_protocol(name)), relative, stamp_of_info(info), not in_folder
        )


def _is_below_hidden(name: str, root: str) -> bool:
    return any(map(is_hidden, PurePosixPath(str(name)).relative_to(root).parts))


def _may_be_endless(path: Path) -> bool:
    """Return whether it is a pipe, a socket or a device, for which a reader may wait for ever.

    A file that is gone, such as a dangling link, is none: its row has an error.
    """
    return path.exists() and not path.is_file()


def _is_wanted(name: str, suffixes: Sequence[str] | None) -> bool:
    plain = name.lower().removesuffix(".xz").removesuffix(".gz")
    return suffixes is None or plain.endswith(tuple(suffix.lower() for suffix in suffixes))


def _fixed_part(pattern: str) -> str:
    """The folder that all matches of a pattern lie below."""
    parts = PurePosixPath(pattern).parts
    fixed = [part for part in parts[: next(i for i, p in enumerate(parts) if _MAGIC.search(p))]]
    return str(PurePosixPath(*fixed)) if fixed else ""


def _refuse_none(files: Iterable[Any], source: str, suffixes: Sequence[str] | None) -> None:
    if not list(files):
        wanted = f" ({', '.join(suffixes)})" if suffixes and not is_pattern(source) else ""
        raise InputError(f"{source}: expected files{wanted}, found none")
