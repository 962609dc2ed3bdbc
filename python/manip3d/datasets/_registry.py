"""Registry of data sets, and search for their files on this computer."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.paths import path_of
from manip3d._util.texts import counted
from manip3d.errors import Error, InputError

ENTRY_POINTS = "manip3d.datasets"
"""Group of entry points; each refers to a `DataSet` or to an iterable of them."""
_OWN = ("meshes", "scans", "rgbd", "people", "lidar")
"""Modules of this package with data sets, which are imported by name as plug-ins are."""


class DataMissingError(Error, FileNotFoundError):
    """Raised when a file of a data set is not on this computer; the message states the cure."""


class ChecksumError(Error, ValueError):
    """Raised when a data file has another SHA-256 than the registry of data sets states."""


@dataclass(frozen=True)
class DataFile:
    """One file of a data set.

    Attributes
    ----------
    path : str
        Path relative to the data root, with forward slashes. If it ends in ``.xz``, the file may
        also be stored uncompressed, without that suffix.
    size : int
        Size of the file at ``path`` in bytes.
    sha256 : str
        SHA-256 of the file at ``path``.
    content_sha256 : str
        SHA-256 of the uncompressed file, which the official address serves.
    url : str
        Official address of the uncompressed file; ``""`` if there is none.
    text : str
        Content of a file of a few lines that manip3d itself provides; ``""`` for other files.
    """

    path: str
    size: int
    sha256: str
    content_sha256: str
    url: str = ""
    text: str = ""

    @property
    def plain_path(self) -> str:
        """Path of the uncompressed file, relative to the data root."""
        return self.path.removesuffix(".xz")


@dataclass(frozen=True)
class DataSet:
    """A public data set: its files, its licence and its origin.

    Attributes
    ----------
    name : str
        Name for `get` and ``manip3d data get``.
    title : str
        Description in one line.
    kind : str
        ``mesh``, ``scan``, ``rgbd`` or ``lidar``.
    files : tuple of DataFile
        Files of the data set; loaders open the first.
    licence : str
        Licence in words.
    origin : str
        Authors, and the source of this copy.
    page : str
        Address of its web page, from which files without a `DataFile.url` are obtained by hand.
    facts : mapping of str to int
        Counts measured on the stored file.
    """

    name: str
    title: str
    kind: str
    files: tuple[DataFile, ...]
    licence: str
    origin: str
    page: str
    facts: Mapping[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        size = f"{counted(len(self.files), 'file')}, {self.size / 1e6:.1f} MB"
        return f"<manip3d.datasets.DataSet: {self.name}; {self.title}; {size}; {self.licence}>"

    @property
    def size(self) -> int:
        """Total size of all files as stored, in bytes."""
        return sum(file.size for file in self.files)


@cache
def registry() -> Mapping[str, DataSet]:
    """Return all data sets by name: manip3d's own, then those of installed plug-ins.

    Raises
    ------
    InputError
        Two data sets have the same name.
    """
    found: dict[str, DataSet] = {}
    own = (import_module(f"manip3d.datasets.{name}").DATA_SETS for name in _OWN)
    plugins = (entry.load() for entry in entry_points(group=ENTRY_POINTS))
    for group in (*own, *plugins):
        for data_set in _data_sets(group):
            if found.setdefault(data_set.name.casefold(), data_set) is not data_set:
                raise InputError(f"data set {data_set.name!r} is registered twice")
    return ReadOnlyMapping({data_set.name: data_set for data_set in found.values()})


def _data_sets(group: object) -> Iterable[DataSet]:
    items = list(group) if isinstance(group, Iterable) else [group]
    data_sets = [item for item in items if isinstance(item, DataSet)]
    if len(data_sets) < len(items):
        raise InputError(f"entry point {ENTRY_POINTS}: expected DataSet objects, got {items!r:.80}")
    return data_sets


@checked
def get(name: str) -> DataSet:
    """Return the data set with a name; upper and lower case are equivalent.

    Parameters
    ----------
    name : str
        A name that ``manip3d data list`` prints.

    Returns
    -------
    DataSet
        The data set.

    Raises
    ------
    InputError
        There is no such data set; the message names similar ones.

    Examples
    --------
    >>> from manip3d import datasets
    >>> spot = datasets.get("SPOT")
    >>> spot.name, spot.kind, len(spot.files)
    ('spot', 'mesh', 3)
    """
    import difflib

    known = {key.casefold(): value for key, value in registry().items()}
    if name.casefold() in known:
        return known[name.casefold()]
    similar = difflib.get_close_matches(name.casefold(), known, cutoff=0.5)
    names = ", ".join(known[key].name for key in similar)
    hint = f"similar: {names}" if names else "'manip3d data list' lists all"
    raise InputError(f"data set: expected a known name, got {name!r} ({hint})")


def cache_folder() -> Path:
    """Return the folder for downloaded data: in ``$MANIP3D_CACHE``, else in the user's cache.

    Returns
    -------
    Path
        The folder, which may not exist.

    Examples
    --------
    >>> from manip3d import datasets
    >>> datasets.cache_folder().name
    'data'
    """
    import platformdirs

    chosen = os.environ.get("MANIP3D_CACHE")
    return (Path(chosen) if chosen else platformdirs.user_cache_path("manip3d")) / "data"


def data_root() -> Path | None:
    """Return the folder with real data: ``$MANIP3D_DATA``, else `cache_folder`.

    Returns
    -------
    Path or None
        The first of the two that exists; None if neither does.

    Examples
    --------
    >>> from manip3d import datasets
    >>> root = datasets.data_root()
    >>> root is None or root.is_dir()
    True
    """
    roots = _roots()
    return roots[0] if roots else None


@checked
def data_folder_problem(folder: Path) -> str:
    """Return why a folder cannot be used as ``MANIP3D_DATA``; empty if it can.

    Parameters
    ----------
    folder : Path
        The folder. It should hold at least one of the folders with which the paths of registered
        files begin: ``lidar``, ``meshes``, ...

    Returns
    -------
    str
        The reason in words, or ''.

    Raises
    ------
    InputError
        ``folder`` is no path.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import datasets
    >>> datasets.data_folder_problem(Path("nowhere"))
    'nowhere does not exist'
    """
    if not folder.exists():
        return f"{folder} does not exist"
    if not folder.is_dir():
        return f"{folder} is not a folder"
    parts = {f.path.partition("/")[0] for data_set in registry().values() for f in data_set.files}
    if any((folder / part).is_dir() for part in parts):
        return ""
    return f"{folder} holds none of the folders {', '.join(sorted(parts))}"


def chosen_folder_problem() -> str:
    """Return why the folder of ``MANIP3D_DATA`` cannot be used; empty if it can or none is set."""
    chosen = os.environ.get("MANIP3D_DATA")
    return data_folder_problem(Path(chosen)) if chosen else ""


def _roots() -> list[Path]:
    chosen = os.environ.get("MANIP3D_DATA")
    candidates = [Path(chosen)] if chosen else []
    return [path for path in [*candidates, cache_folder()] if path.is_dir()]


@checked
def locate(file: DataFile) -> Path | None:
    """Return the path of a file on this computer, compressed or not; None if it is missing.

    Parameters
    ----------
    file : DataFile
        One of the files of a `DataSet`.

    Returns
    -------
    Path or None
        The path; the checksum is not verified.

    Raises
    ------
    InputError
        ``file`` is no `DataFile`.

    Examples
    --------
    >>> from manip3d import datasets
    >>> path = datasets.locate(datasets.get("spot").files[0])
    >>> path is None or path.is_file()
    True
    """
    for root in _roots():
        for relative in dict.fromkeys((file.path, file.plain_path)):
            if (root / relative).is_file():
                return root / relative
    return None


@checked
def is_here(data_set: DataSet) -> bool:
    """Return whether all files of a data set are on this computer.

    Parameters
    ----------
    data_set : DataSet
        The data set.

    Returns
    -------
    bool
        Checksums are not verified.

    Raises
    ------
    InputError
        ``data_set`` is no `DataSet`.

    Examples
    --------
    >>> from manip3d import datasets
    >>> spot = datasets.get("spot")
    >>> datasets.is_here(spot) == all(datasets.locate(file) for file in spot.files)
    True
    """
    return all(locate(file) is not None for file in data_set.files)


def has_wrong_size(data_set: DataSet) -> bool:
    """Return whether a file that is here has another size than the registered one, or none."""
    for file in data_set.files:
        path = locate(file)
        if path is None:
            continue
        size = path.stat().st_size
        if size != file.size if path.name == Path(file.path).name else not size:
            return True
    return False


@checked
def require(file: DataFile, name: str) -> Path:
    """Return the path of a file after verifying its checksum.

    Parameters
    ----------
    file : DataFile
        One of the files of a `DataSet`.
    name : str
        Name of the data set, for the error message.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    DataMissingError
        The file is not on this computer.
    ChecksumError
        The file has another SHA-256 than the registered one.

    Examples
    --------
    >>> from manip3d import datasets
    >>> spot = datasets.get("spot")
    >>> datasets.require(spot.files[0], spot.name)  # doctest: +SKIP
    """
    path = locate(file)
    if path is None:
        problem = chosen_folder_problem()
        raise DataMissingError(
            f"{name}: {file.path} is not here; set MANIP3D_DATA to the folder that holds it"
            f"{f' ({problem})' if problem else ''}, or try 'manip3d data get {name}'"
        )
    expected = file.sha256 if path.name == Path(file.path).name else file.content_sha256
    actual = file_sha256(path)
    if actual != expected:
        raise ChecksumError(
            f"{path}: expected sha256 {expected}, got {actual}: the file is damaged, or another "
            f"one; copy it again, or remove it and try 'manip3d data get {name}'"
        )
    return path


@checked
def file_sha256(path: Path) -> str:
    """Return the hexadecimal SHA-256 of a file, cached while its size and times do not change.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    OSError
        The file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import datasets
    >>> _ = Path("abc").write_bytes(b"abc")
    >>> datasets.file_sha256(Path("abc"))[:16]
    'ba7816bf8f01cfea'
    """
    absolute = path_of(path).absolute()
    status = absolute.stat()
    file = status.st_dev, status.st_ino, status.st_size
    return _sha256(absolute, *file, status.st_mtime_ns, status.st_ctime_ns)


@checked
def folder_sha256(folder: Path) -> str:
    """Return the hexadecimal SHA-256 of the output of ``sha256sum`` for all files of a folder.

    The output meant is that of
    ``find -L . -type f -print0 | LC_ALL=C sort -z | xargs -0 sha256sum``, run in the folder. The
    checksums agree if no name has a backslash or a line break.

    Parameters
    ----------
    folder : Path
        The folder; files in subfolders are included, empty folders are ignored.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    OSError
        The folder or a file in it cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import datasets
    >>> Path("walk").mkdir()
    >>> _ = Path("walk/abc").write_bytes(b"abc")
    >>> datasets.folder_sha256(Path("walk"))[:16]
    'f2ef6689488da811'
    """
    top = path_of(folder)

    def refuse(error: OSError) -> None:
        raise error

    names = []
    for place, folders, files in os.walk(top, onerror=refuse, followlinks=True):
        above = {
            os.path.realpath(one)
            for one in (Path(place), *Path(place).parents)
            if one.is_relative_to(top)
        }  # folders above; a link to one of them would be followed for ever
        folders[:] = [name for name in folders if os.path.realpath(Path(place, name)) not in above]
        found = (Path(place, name) for name in files)
        names += [os.fsencode(f"./{one.relative_to(top)}") for one in found if one.is_file()]
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(f"{file_sha256(top / os.fsdecode(name))}  ".encode() + name + b"\n")
    return digest.hexdigest()


@cache
def _sha256(path: Path, *_status: int) -> str:
    """Hash a file; its status is only a key of the cache, so that a changed file is read."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
