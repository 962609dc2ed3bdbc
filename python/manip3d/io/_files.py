"""Atomic writing of files: write to a temporary name, sync, rename, sync the folder."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from manip3d import _core
from manip3d._util.durable import folder_beside, sync_file, sync_folder
from manip3d._util.paths import path_of
from manip3d._util.regular_files import bytes_below as bytes_below
from manip3d._util.regular_files import limited_bytes as limited_bytes
from manip3d._util.regular_files import open_regular as open_regular
from manip3d._util.regular_files import over_max_bytes as over_max_bytes
from manip3d.errors import FormatError, InputError


def check_regular(path: str | os.PathLike[str]) -> None:
    """Raise as `open_regular` does (pipes, devices), for parsers that open files by name."""
    open_regular(path).close()


_POINTER = b"version https://git-lfs.github.com/spec/"
_MAX_POINTER = 1024  # a pointer file has fewer bytes, by the specification of Git LFS


def refuse_pointer(path: str | os.PathLike[str]) -> None:
    """Refuse the pointer that Git LFS leaves in place of a file that it did not fetch.

    Raises
    ------
    FormatError
        The file is such a pointer.
    OSError
        The file exists and cannot be read.
    """
    try:
        about = os.stat(path)
    except OSError:  # the caller's reader reports it, after it has checked the name
        return
    if not stat.S_ISREG(about.st_mode) or about.st_size >= _MAX_POINTER:
        return
    with open_regular(path) as file:
        is_pointer = file.read(len(_POINTER)) == _POINTER
    if is_pointer:
        raise FormatError(
            "expected the file, got a pointer to it of Git LFS: 'git lfs pull' fetches the file",
            file=str(path),
        )


def regular_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return the content of a file that `open_regular` opens."""
    with open_regular(path) as file:
        return file.read()


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Return the hexadecimal SHA-256 of a file that `open_regular` opens."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield an empty temporary file that becomes ``path`` when the block ends.

    The temporary file has the name of ``path`` and, if ``path`` exists, its mode. If the block
    raises, the temporary file is removed and ``path`` stays unchanged. Files left by a killed
    process are removed by the next write to that folder.

    Raises
    ------
    InputError
        ``path`` is no path, see `path_of`.
    OSError
        Writing failed, for example because the folder is missing or the disk is full;
        ``filename`` is ``path``.
    """
    target = Path(os.path.realpath(path_of(path)))
    with folder_beside(target, path) as folder:
        file = folder / target.name
        file.touch()
        # PermissionError: the file system has no modes.
        with contextlib.suppress(FileNotFoundError, PermissionError):
            file.chmod(stat.S_IMODE(target.stat().st_mode))
        yield file
        sync_file(file)
        file.replace(target)
        sync_folder(target.parent)


@contextlib.contextmanager
def atomic_pair(
    path: str | os.PathLike[str], companion: str | os.PathLike[str]
) -> Iterator[tuple[Path, Path]]:
    """Yield two empty temporary files that become a file and its companion, such as its record.

    If the block raises, or a rename or a sync before the last rename fails, both files stay
    unchanged. A process that is killed between the renames leaves the old or the new file without a
    companion, but never the old file with the new companion or vice versa.

    Raises
    ------
    InputError, OSError
        See `atomic_path`; `IsADirectoryError` if the companion is a folder.
    """
    target, beside = (Path(os.path.realpath(path_of(each))) for each in (path, companion))
    if beside.is_dir():  # the folder would be moved to the temporary folder and removed with it
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(companion))
    # An error without a file name gets that of the inner context: the file, which is larger.
    with folder_beside(beside, companion) as of_beside, folder_beside(target, path) as of_target:
        new = of_target / target.name, of_beside / beside.name
        for file, place in zip(new, (target, beside), strict=True):
            file.touch()
            with contextlib.suppress(FileNotFoundError, PermissionError):
                file.chmod(stat.S_IMODE(place.stat().st_mode))
        yield new
        for file in new:
            sync_file(file)
        old_target, old_beside = (
            file.with_name("old" if file.name != "old" else "older") for file in new
        )
        is_replaced = target.exists()
        try:
            with contextlib.suppress(FileNotFoundError):
                beside.rename(old_beside)
                sync_folder(beside.parent)
            if is_replaced:
                with contextlib.suppress(OSError):  # a folder, or a file system without links
                    os.link(target, old_target)
            new[0].replace(target)
            sync_folder(target.parent)
            new[1].replace(beside)
        except BaseException:
            is_old = new[0].exists()
            if not is_old and old_target.exists():
                old_target.replace(target)
                is_old = True
            elif not is_old and not is_replaced:
                target.unlink()
                is_old = True
            if is_old and old_beside.exists():
                old_beside.rename(beside)
            raise
        sync_folder(beside.parent)


@contextlib.contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield an empty temporary folder that becomes the folder ``path`` when the block ends.

    A process that is killed leaves the old folder or the new one. If the file system cannot
    exchange names, ``path`` may be missing until the next write beside it, which restores the old
    folder.

    Raises
    ------
    InputError
        ``path`` is no path, see `path_of`, or it holds the current folder, see `refuse_current`.
    OSError
        See `atomic_path`.
    """
    target = Path(os.path.realpath(path_of(path)))
    refuse_current(target, f"output: {os.fspath(path)}")
    with folder_beside(target, path) as folder:
        new = folder / "new"
        new.mkdir()
        yield new
        _core.replace_folder(os.fsencode(new), os.fsencode(target))
        sync_folder(target.parent)


def refuse_current(folder: Path, shown: str) -> None:
    """Raise if a folder that is to be replaced as a whole is the current one, or one above it.

    The user's shell, and relative paths of this process, would refer to the deleted folder.

    Raises
    ------
    InputError
        It is; the error begins with ``shown``.
    """
    try:
        is_current = Path.cwd().is_relative_to(os.path.realpath(folder))
    except FileNotFoundError:  # the current folder has been deleted
        return
    if is_current:
        raise InputError(f"{shown}: expected another folder than the current one or one above it")


def refuse_other_files(folder: Path, is_ours: Callable[[str], bool]) -> None:
    """Raise if a folder that is to be replaced holds files other than those of a former run.

    A folder is replaced as a whole, so that such files would be lost.

    Parameters
    ----------
    folder : Path
        The folder; it may not exist.
    is_ours : callable(str)
        Returns whether a file of this name was written by a former run.

    Raises
    ------
    InputError
        The folder holds other files, of which the error names some, or see `refuse_current`.
    """
    refuse_current(folder, f"output: {folder}")
    if os.path.lexists(folder) and not folder.is_dir():
        raise InputError(f"output: expected a folder, {folder} is a file")
    others = other_files(folder, is_ours)
    if others:
        raise InputError(f"output: {folder} holds other files: {', '.join(others[:3])}")


def holds_only(folder: Path, is_ours: Callable[[str], bool]) -> bool:
    """Return whether a path is a folder that holds no `other_files`.

    Raises
    ------
    OSError
        The folder cannot be read.
    """
    return folder.is_dir() and not other_files(folder, is_ours)


def other_files(folder: Path, is_ours: Callable[[str], bool]) -> list[str]:
    """Return the sorted names in a folder for which ``is_ours`` is False; the folder may be absent.

    Raises
    ------
    OSError
        The folder cannot be read.
    """
    if not folder.is_dir():
        return []
    return sorted(name for name in os.listdir(folder) if not is_ours(name))


def write_new(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a new file atomically, readable and writable only by its owner.

    Raises
    ------
    OSError
        `FileExistsError` if the file exists; see also `atomic_path`.
    """
    target = path_of(path)
    is_there = FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), os.fspath(target))
    if os.path.lexists(target):
        raise is_there
    with folder_beside(target, path) as folder:
        file = folder / target.name
        with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        try:
            os.link(file, target)  # fails if another process has created the file meanwhile
        except FileExistsError:
            raise is_there from None
        except OSError:  # no hard links in this file system: an empty file claims the name
            os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
            try:
                file.replace(target)
            except BaseException:
                target.unlink()
                raise
        sync_folder(target.parent)


def atomic_write(path: str | os.PathLike[str], data: bytes | str) -> None:
    """Write ``data`` (text as UTF-8) to ``path`` atomically.

    A target that is not a regular file (a pipe, ``/dev/stdout``) is written in place.

    Raises
    ------
    InputError, OSError
        See `atomic_path`.
    """
    content = data.encode() if isinstance(data, str) else data
    target = path_of(path)
    if target.exists() and not target.is_file():
        target.write_bytes(content)
        return
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)
