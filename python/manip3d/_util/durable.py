"""Building blocks of atomic file writing: temporary folders and syncs to disk."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from manip3d import _core


def sync_folder(folder: Path) -> None:
    """Sync the directory entries of a folder to disk, if its file system can."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot sync a folder
            raise
    finally:
        os.close(descriptor)


def sync_file(path: Path) -> None:
    """Sync the content of a file to disk."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


@contextlib.contextmanager
def _named(target: str | os.PathLike[str], folder: Path) -> Iterator[None]:
    """Give errors that name the temporary folder, or no file, the name of the target."""
    try:
        yield
    except OSError as error:
        named = error.filename
        ours = named is None or Path(os.fsdecode(named)).is_relative_to(folder)
        if ours and error.errno is not None:
            raise OSError(error.errno, error.strerror, os.fspath(target)) from error
        raise


@contextlib.contextmanager
def folder_beside(target: Path, path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a private temporary folder beside ``target``, locked until it is removed.

    Temporary folders whose writers have died are removed first.
    """
    with _named(path, target.parent):
        name, lock = _core.make_temporary_folder(os.fsencode(target.parent))
    folder = Path(os.fsdecode(name))
    try:
        with _named(path, folder):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)
