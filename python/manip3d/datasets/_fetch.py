"""Download of data sets from their official addresses to the user's cache."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.texts import counted
from manip3d.datasets._registry import DataFile, DataSet, cache_folder, locate, require
from manip3d.errors import Error
from manip3d.io._files import atomic_write

if TYPE_CHECKING:
    from collections.abc import Callable


class FetchError(Error, OSError):
    """Raised when a data set cannot be downloaded; the message states the reason and its page."""


@checked
def fetch(data_set: DataSet, *, progress: Callable[[float, str], None] | None = None) -> list[Path]:
    """Bring all files of a data set to this computer, and verify their checksums.

    Files that exist already are verified. Others are downloaded, uncompressed, from their official
    addresses to the user's cache.

    Parameters
    ----------
    data_set : DataSet
        The data set.
    progress : callable, optional
        Called with the fraction done and the file's path.

    Returns
    -------
    list of Path
        Path of each file, in the order of the data set.

    Raises
    ------
    FetchError
        ``MANIP3D_OFFLINE`` is set, a file has no stable official address, its server does not
        answer, or a downloaded file has another SHA-256 than the registered one.
    ChecksumError
        A file that exists already has another SHA-256 than the registered one.
    MissingExtraError
        pooch is not installed.

    Examples
    --------
    >>> from manip3d import datasets
    >>> datasets.fetch(datasets.get("spot"))  # doctest: +SKIP
    """
    absent = [file for file in data_set.files if locate(file) is None]
    _refuse_what_has_no_home(data_set, absent)
    for number, file in enumerate(absent):
        if progress is not None:
            progress(number / len(absent), file.plain_path)
        if file.text:
            atomic_write(_target(file), file.text)
        else:
            _download(data_set, file)
    return [require(file, data_set.name) for file in data_set.files]


@checked
def is_fetchable(data_set: DataSet) -> bool:
    """Return whether `fetch` can download all missing files of a data set.

    Parameters
    ----------
    data_set : DataSet
        The data set.

    Returns
    -------
    bool
        False if a missing file has no stable official address.

    Raises
    ------
    InputError
        ``data_set`` is no `DataSet`.

    Examples
    --------
    >>> from manip3d import datasets
    >>> isinstance(datasets.is_fetchable(datasets.get("spot")), bool)
    True
    """
    return all(file.url or file.text or locate(file) is not None for file in data_set.files)


@checked
def steps_by_hand(data_set: DataSet) -> list[str]:
    """Return the steps by which a user obtains a data set without `fetch`.

    Parameters
    ----------
    data_set : DataSet
        The data set.

    Returns
    -------
    list of str
        One sentence per step; empty if no file is missing.

    Raises
    ------
    InputError
        ``data_set`` is no `DataSet`.

    Examples
    --------
    >>> from manip3d import datasets
    >>> spot = datasets.get("spot")
    >>> datasets.is_here(spot) or "again" in datasets.steps_by_hand(spot)[-1]
    True
    """
    absent = [file for file in data_set.files if locate(file) is None]
    if not absent:
        return []
    root = Path(os.environ.get("MANIP3D_DATA") or cache_folder())
    homeless = [file for file in absent if not (file.url or file.text)]
    steps = [f"download {file.url} to {root / file.plain_path}" for file in absent if file.url]
    if homeless:
        shown = ", ".join(file.path for file in homeless[:3])
        more = f" and {len(homeless) - 3} more" if homeless[3:] else ""
        steps += [
            f"open {data_set.page} and accept the licence: {data_set.licence}",
            f"get the files of {data_set.origin}",
            f"put {counted(len(homeless), 'file')} under {root}: {shown}{more}",
        ]
    return [*steps, f"run 'manip3d data get {data_set.name}' again: it checks every byte"]


def _refuse_what_has_no_home(data_set: DataSet, absent: list[DataFile]) -> None:
    homeless = [file.path for file in absent if not (file.url or file.text)]
    if homeless:
        raise FetchError(
            f"{data_set.name}: no stable official address serves {', '.join(homeless)} as it is "
            f"registered here; its source is {data_set.page} ({data_set.origin}). Put the files "
            f"under $MANIP3D_DATA."
        )
    if absent and os.environ.get("MANIP3D_OFFLINE", "") not in ("", "0"):
        raise FetchError(f"{data_set.name}: not here, and MANIP3D_OFFLINE is set")


def _target(file: DataFile) -> Path:
    path = cache_folder() / file.plain_path
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def _download(data_set: DataSet, file: DataFile) -> None:
    pooch = imported("pooch", "experiments")
    target = _target(file)
    pooch.get_logger().setLevel("WARNING")
    try:
        pooch.retrieve(
            file.url, f"sha256:{file.content_sha256}", fname=target.name, path=target.parent
        )
    except (OSError, ValueError) as error:  # pooch raises ValueError for a wrong checksum
        raise FetchError(
            f"{data_set.name}: {file.url} could not be fetched ({error}); "
            f"its source is {data_set.page}"
        ) from error
