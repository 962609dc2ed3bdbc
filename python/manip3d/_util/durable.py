"""Parts of writing a file that appears whole or not at all: a folder beside it, and syncs."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from manip3d import _core


def sync_folder(folder: Path) -> None:
    """Write to the disk which names a folder holds; a file system that cannot is left alone."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # some network file systems cannot sync a folder
            raise
    finally:
        os.close(descriptor)


def sync_file(path: Path) -> None:
    """Write to the disk what a file holds."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


@contextlib.contextmanager
def _named(target: str | os.PathLike[str], folder: Path) -> Iterator[None]:
    """Errors that name the temporary folder, or nothing, get the name of the target."""
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
    """A private folder, locked until it is removed; those of dead writers are removed at once."""
    with _named(path, target.parent):
        name, lock = _core.make_temporary_folder(os.fsencode(target.parent))
    folder = Path(os.fsdecode(name))
    try:
        with _named(path, folder):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)
