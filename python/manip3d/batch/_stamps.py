"""Stamps of files and of what they name beside them: other text where the content may be other."""

from __future__ import annotations

import functools
import hashlib
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from manip3d.errors import InputError
from manip3d.io._remote import (
    MAX_COMPANIONS,
    companions,
    filesystem,
    is_url,
    naming_remote,
    reads_beside,
)

_GONE = "gone"
_STAMPS = (
    "ETag", "etag", "e_tag", "Content-MD5", "content_md5", "md5Hash", "md5", "crc32c", "Digest",
    "checksum", "generation", "sha", "CRC", "LastModified", "Last-Modified", "last_modified",
    "updated", "modify", "modified", "modificationTime", "mtime", "ctime", "created", "date_time",
)  # fmt: skip
"""Names that file systems of fsspec give to times and hashes that change with the content."""
BESIDE = (".wm", ".truth.json", ".truth.npz")
"""Suffixes of what verbs write beside an output: records of watermarks, and truths of forgeries."""


def stamp_of_file(path: Path) -> str:
    """Return size and times of a file; one that cannot be asked is gone, which is a stamp, too.

    The time of change is among them: unlike that of modification, no ordinary call sets it back.
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
    """Return the size and all that a store says of the content and its times."""
    told = " ".join(str(info[name]) for name in _STAMPS if info.get(name))
    return f"{info.get('size')} {told}"


class Stamps:
    """Stamps of the inputs of a run, each of which is asked for once.

    Parameters
    ----------
    output : str, optional
        Folder of the run's outputs: what lies in it is not an input, unless a source does, too.
    written : sequence of str
        Further files and folders that the run writes, such as its table.
    targets : sequence of str
        The outputs.
    """

    def __init__(
        self, output: str | None = None, written: Iterable[str] = (), targets: Iterable[str] = ()
    ) -> None:
        self._output = _plain_url(output) if output is not None and is_url(output) else None
        self._written = tuple(_plain_url(name) for name in written if is_url(name))
        self._targets: set[str] = set()
        if output is not None and self._output is not None:  # one look at the address for all
            start = len(output)
            self._targets = {f"{self._output}{target[start:]}" for target in targets}
        self._remote_folder = functools.cache(self._stamp_of_remote_folder)
        self.stamp_of_input = functools.cache(self._stamp_of_input)

    def stamp_of_companions(self, name: str) -> str:
        """Return a stamp of what a file or URL names beside it; empty where it can name nothing."""
        if not reads_beside(PurePosixPath(name)):
            return ""
        if is_url(name):
            first, chain, others = name.partition("::")  # zip://mesh.obj::s3://bucket/a.zip
            return self._remote_folder(f"{first.rpartition('/')[0]}/{chain}{others}")
        files = sorted(set(named_by(Path(name))))
        return stamp_of_files((str(file), file) for file in files)

    def _stamp_of_input(self, name: str) -> str:
        """Return a stamp of a file, a folder or a URL with all that it names beside it."""
        if is_url(name):
            return f"{self._stamp_of_url(name)} {self.stamp_of_companions(name)}".rstrip()
        path = Path(name)
        if path.is_dir():
            return stamp_of_folder(path)
        return f"{stamp_of_file(path)} {self.stamp_of_companions(name)}".rstrip()

    def _stamp_of_remote_folder(self, url: str) -> str:
        """A stamp of all that is below a URL: to know what a file names, it would be fetched.

        What cannot be listed may have changed: the stamp is another one each time.
        """
        try:
            system, path = filesystem(url)
            with naming_remote(url):
                infos = system.find(path, detail=True)
        except (OSError, InputError):
            return str(time.time_ns())
        return _stamp_of_infos(self._inputs_of(system, path, infos))

    def _stamp_of_url(self, url: str) -> str:
        system, path = filesystem(url)
        with naming_remote(url):
            if not system.isdir(path):
                return _stamp_of_infos({path: system.info(path)})
            infos = system.find(path, detail=True)
        return _stamp_of_infos(self._inputs_of(system, path, infos))

    def _inputs_of(
        self, system: Any, folder: str, infos: Mapping[str, dict[str, Any]]
    ) -> dict[str, dict[str, Any]]:
        """The files of a folder, without those that the run writes."""
        place = str(system.unstrip_protocol(folder)).rstrip("/")
        left_out = list(self._written)
        if self._output is not None and not _is_within(place, (self._output,)):
            left_out.append(self._output)
        kept = {}
        for name, info in infos.items():
            whole = str(system.unstrip_protocol(name))
            plain = next((whole.removesuffix(s) for s in BESIDE if whole.endswith(s)), whole)
            if plain not in self._targets and not _is_within(whole, left_out):
                kept[name] = info
        return kept


def _plain_url(url: str) -> str:
    """The one way in which its file system writes a URL: ``s3a://b/x/`` becomes ``s3://b/x``."""
    system, path = filesystem(url)
    return str(system.unstrip_protocol(path)).rstrip("/")


def _is_within(name: str, places: Iterable[str]) -> bool:
    return any(name == place or name.startswith(f"{place}/") for place in places)


def named_by(path: Path) -> Iterator[Path]:
    """Yield the files that a file names, and those that they name."""
    waiting, seen = [path], {path}
    while waiting and len(seen) <= MAX_COMPANIONS:
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


def _stamp_of_infos(infos: Mapping[str, dict[str, Any]]) -> str:
    return _hash(f"{name}\0{stamp_of_info(infos[name])}\n" for name in sorted(infos))
