"""Files that appear whole or not at all: temporary name, sync, rename, sync of the folder."""

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
from manip3d._util.regular_files import limited_bytes as limited_bytes
from manip3d._util.regular_files import open_regular as open_regular
from manip3d.errors import FormatError, InputError


def check_regular(path: str | os.PathLike[str]) -> None:
    """Refuse what `open_regular` does, for parsers that open files by their names."""
    open_regular(path).close()


_POINTER = b"version https://git-lfs.github.com/spec/"
_MOST_POINTER = 1024  # bytes, by the specification of Git LFS


def refuse_pointer(path: str | os.PathLike[str]) -> None:
    """Refuse the text that Git LFS leaves in the place of a file that it did not fetch.

    Raises
    ------
    FormatError
        The file is such a pointer.
    OSError
        It is there and cannot be read.
    """
    try:
        about = os.stat(path)
    except OSError:  # the reader says so, after what is wrong with the name
        return
    if not stat.S_ISREG(about.st_mode) or about.st_size >= _MOST_POINTER:
        return
    with open_regular(path) as file:
        is_pointer = file.read(len(_POINTER)) == _POINTER
    if is_pointer:
        raise FormatError(
            "expected the file, got a pointer to it of Git LFS: 'git lfs pull' fetches the file",
            file=str(path),
        )


def regular_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return the content of what `open_regular` opens."""
    with open_regular(path) as file:
        return file.read()


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256, hexadecimal, of what `open_regular` opens."""
    with open_regular(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield an empty temporary file that becomes ``path`` when the block ends.

    It has the name of ``path``, and its mode if that is there. When the block raises, it is
    removed and ``path`` stays as it was; what a killed process leaves is removed by the next write
    to that folder.

    Raises
    ------
    InputError
        As `path_of`.
    OSError
        The folder is missing, the disk is full, and the like; ``filename`` is ``path``.
    """
    target = Path(os.path.realpath(path_of(path)))
    with folder_beside(target, path) as folder:
        file = folder / target.name
        file.touch()
        with contextlib.suppress(FileNotFoundError, PermissionError):  # a file system without modes
            file.chmod(stat.S_IMODE(target.stat().st_mode))
        yield file
        sync_file(file)
        file.replace(target)
        sync_folder(target.parent)


@contextlib.contextmanager
def atomic_pair(
    path: str | os.PathLike[str], companion: str | os.PathLike[str]
) -> Iterator[tuple[Path, Path]]:
    """Yield empty temporary files that become a file and what tells about it, such as its record.

    When the block raises, or a rename or a sync before the last rename fails, both stay as they
    were. A process that is killed between the renames leaves the old or the new file without a
    companion, never the one beside that of the other.

    Raises
    ------
    InputError, OSError
        As `atomic_path`; `IsADirectoryError` where the companion is a folder.
    """
    target, beside = (Path(os.path.realpath(path_of(each))) for each in (path, companion))
    if beside.is_dir():  # it would be moved away, and removed with the temporary folder
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), os.fspath(companion))
    # An error without a name gets that of the inner context: the file, which is the larger one.
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

    Raises
    ------
    InputError
        As `path_of`.
    OSError
        As `atomic_path`.
    """
    target = Path(os.path.realpath(path_of(path)))
    with folder_beside(target, path) as folder:
        new = folder / "new"
        new.mkdir()
        yield new
        _core.replace_folder(os.fsencode(new), os.fsencode(target))
        sync_folder(target.parent)


def refuse_other_files(folder: Path, is_ours: Callable[[str], bool]) -> None:
    """Refuse to replace a folder that holds more than what was written there before.

    A folder is replaced as a whole: whatever else it holds would be lost.

    Parameters
    ----------
    folder : Path
        May be absent.
    is_ours : callable(str)
        Whether a file of this name may be lost.

    Raises
    ------
    InputError
        Names some of the other files.
    """
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise InputError(f"output: expected a folder, {folder} is a file")
    others = sorted(name for name in os.listdir(folder) if not is_ours(name))
    if others:
        raise InputError(f"output: {folder} holds other files: {', '.join(others[:3])}")


def write_new(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file that was not there, for its owner only, whole or not at all.

    Raises
    ------
    OSError
        `FileExistsError`, and as `atomic_path`.
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
            os.link(file, target)  # which fails where somebody was quicker
        except FileExistsError:
            raise is_there from None
        except OSError:  # a file system without links: an empty file claims the name
            os.close(os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
            try:
                file.replace(target)
            except BaseException:
                target.unlink()
                raise
        sync_folder(target.parent)


def atomic_write(path: str | os.PathLike[str], data: bytes | str) -> None:
    """Write ``data`` (text as UTF-8) to ``path``, whole or not at all.

    A target that is not a regular file (a pipe, ``/dev/stdout``) is written in place.

    Raises
    ------
    InputError, OSError
        As `atomic_path`.
    """
    content = data.encode() if isinstance(data, str) else data
    target = path_of(path)
    if target.exists() and not target.is_file():
        target.write_bytes(content)
        return
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)
