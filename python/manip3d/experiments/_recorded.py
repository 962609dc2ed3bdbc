"""Recorded files that cases open by path: their hashes for the options, and their origins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from manip3d import datasets

UNREGISTERED = "other files"
"""Name of the record of files that belong to no registered data set."""


def sums(paths: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of each file, for the option ``files`` of a case.

    Parameters
    ----------
    paths : iterable of str
        Paths relative to the data root. All files are here, compressed or not.

    Returns
    -------
    dict of str to str
        The hash by path; ``unreadable`` for a file that cannot be read. The case that reads it
        fails, and no other.
    """
    return {path: _sum(path) for path in paths}


def _sum(path: str) -> str:
    try:
        return datasets.file_sha256(located(path))
    except OSError:
        return "unreadable"


def are_here(paths: Iterable[str]) -> bool:
    """Return whether all these registered files are on this computer."""
    return all(datasets.locate(_registered()[path][1]) is not None for path in paths)


def located(path: str) -> Path:
    """Return the place of a file below the data root.

    A registered file may also be stored uncompressed; it is then its plain name that exists.

    Raises
    ------
    DataMissingError
        The file is not on this computer.
    """
    root = datasets.data_root()
    if root is not None and (root / path).is_file():
        return root / path
    data_set, file = _registered().get(path, (None, None))
    found = None if file is None else datasets.locate(file)
    if found is None:
        name = UNREGISTERED if data_set is None else data_set.name
        raise datasets.DataMissingError(
            f"{name}: {path} is not here; set MANIP3D_DATA to the folder that holds it"
        )
    return found


def provenance(files: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return a record of origin and licence for each data set to which files belong.

    A file that differs from the registered one with its path is listed as `UNREGISTERED`, because
    its origin is unknown.

    Parameters
    ----------
    files : mapping of str to str
        SHA-256 of each file by its path, as `sums` returns them.

    Returns
    -------
    list of dict
        Records as of `datasets.provenance`, with the paths and hashes of these files.
    """
    known: dict[str, dict[str, Any]] = {}
    for path, digest in files.items():
        data_set, file = _registered().get(path, (None, None))
        if file is None or digest not in (file.sha256, file.content_sha256):
            data_set = None
        record = _record(data_set)
        known.setdefault(record["name"], record)["files"][path] = digest
    return list(known.values())


def _record(data_set: datasets.DataSet | None) -> dict[str, Any]:
    if data_set is None:
        return {
            "name": UNREGISTERED,
            "title": "files that are not those of a registered data set",
            "origin": "unknown",
            "page": "",
            "licence": "unknown",
            "files": {},
        }
    names = ("name", "title", "origin", "page", "licence")
    return {name: getattr(data_set, name) for name in names} | {"files": {}}


@cache
def _registered() -> dict[str, tuple[datasets.DataSet, datasets.DataFile]]:
    """Return data set and file of each registered path."""
    return {
        path: (data_set, file)
        for data_set in datasets.registry().values()
        for file in data_set.files
        for path in (file.path, file.plain_path)
    }
