"""Stamps of files and of what they name beside them: other text where the content may be other."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from manip3d.io._remote import companions, filesystem, is_url, naming_remote, reads_beside

_GONE = "gone"
_STAMPS = ("ETag", "etag", "md5Hash", "checksum", "LastModified", "mtime", "modified", "created")
_MOST_COMPANIONS = 256


def stamp_of_file(path: Path) -> str:
    """Return size and times of a file; one that cannot be asked is gone, which is a stamp, too.

    The time of change is among them: unlike that of modification, no program can set it back.
    """
    try:
        status = path.stat()
    except (OSError, ValueError):  # a dangling link; a file removed meanwhile; no name of a file
        return _GONE
    return f"{status.st_size} {status.st_mtime_ns} {status.st_ctime_ns}"


def stamp_of_files(files: Iterable[tuple[str, Path]]) -> str:
    """Return a stamp of files under their names."""
    lines = [f"{name}\0{stamp_of_file(path)}\n" for name, path in files]
    return f"{len(lines)} {_hash(lines)}"


def _hash(lines: Iterable[str]) -> str:
    return hashlib.sha256("".join(lines).encode("utf-8", "surrogateescape")).hexdigest()[:32]


def stamp_of_folder(folder: Path) -> str:
    """Return a stamp that changes when a file in the folder does, comes or goes."""
    files = sorted(_files_below(folder))
    return stamp_of_files((str(file.relative_to(folder)), file) for file in files)


def _files_below(folder: Path) -> Iterator[Path]:
    """All files of a folder, those of linked folders included; links may lead in circles."""
    for top, folders, names in os.walk(folder, followlinks=True):
        here = Path(top)
        above = {one.resolve() for one in (here, *here.parents) if one.is_relative_to(folder)}
        folders[:] = [name for name in folders if (here / name).resolve() not in above]
        yield from (here / name for name in names)


def stamp_of_info(info: dict[str, Any]) -> str:
    """Return the size and the first thing that a store says of the content or the time."""
    told = next((str(info[name]) for name in _STAMPS if info.get(name)), "")
    return f"{info.get('size')} {told}"


def stamp_of_companions(name: str) -> str:
    """Return a stamp of what a file or URL names beside it; empty where it can name nothing."""
    if not reads_beside(PurePosixPath(name)):
        return ""
    if is_url(name):
        return _stamp_of_remote_folder(name)
    files = sorted(set(_named_by(Path(name))))
    return stamp_of_files((str(file), file) for file in files)


def _named_by(path: Path) -> Iterator[Path]:
    """The files that a file names, and those that they name."""
    waiting, seen = [path], {path}
    while waiting and len(seen) <= _MOST_COMPANIONS:
        one = waiting.pop()
        try:
            found = [path.parent / name for name in companions(one)]
        except OSError:  # the file that names them is gone
            continue
        for file in found:
            if file not in seen:
                seen.add(file)
                waiting.append(file)
                yield file


def _stamp_of_remote_folder(url: str) -> str:
    """A stamp of all that lies beside a URL: to know what it names, it would have to be fetched."""
    system, path = filesystem(url)
    with naming_remote(url):
        infos = system.find(str(PurePosixPath(path).parent), detail=True)
    return _stamp_of_infos(infos)


def _stamp_of_infos(infos: Mapping[str, dict[str, Any]]) -> str:
    return _hash(f"{name}\0{stamp_of_info(infos[name])}\n" for name in sorted(infos))


def stamp_of_input(name: str) -> str:
    """Return a stamp of a file, a folder or a URL with all that it names beside it."""
    if is_url(name):
        return f"{_stamp_of_url(name)} {stamp_of_companions(name)}".rstrip()
    path = Path(name)
    if path.is_dir():
        return stamp_of_folder(path)
    return f"{stamp_of_file(path)} {stamp_of_companions(name)}".rstrip()


def _stamp_of_url(url: str) -> str:
    system, path = filesystem(url)
    with naming_remote(url):
        is_folder = system.isdir(path)
        infos = system.find(path, detail=True) if is_folder else {path: system.info(path)}
    return _stamp_of_infos(infos)
