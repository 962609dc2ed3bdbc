"""Files at URLs that fsspec opens (extra ``remote``): downloaded to read, uploaded when complete.

Readers and writers work on local files and their companions, such as textures. While a URL is read
or written, these lie in a temporary folder.
"""

from __future__ import annotations

import codecs
import contextlib
import errno
import gzip
import html
import json
import lzma
import os
import re
import shutil
import struct
import sys
import tempfile
import urllib.parse
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.paths import path_of
from manip3d._util.regular_files import over_max_bytes
from manip3d.errors import Error, FormatError, InputError
from manip3d.io._packet_files import PACKETS, ouster_metadata_names

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*(://|::)")
_CODES = {FileNotFoundError: errno.ENOENT, PermissionError: errno.EACCES}
# Object stores: a folder is only a part of a name there, and creating one could create a bucket.
_OBJECT_STORES = frozenset(
    {"abfs", "abfss", "adl", "az", "gcs", "gs", "memory", "oss", "r2", "s3", "s3a"}
)
_BLOCK = 1 << 20  # bytes per read
MAX_COMPANIONS = 256  # largest number of files that are downloaded with a file
_MAX_TEXT = 64 << 20  # bytes of a compressed or remote file that are searched for names
_MAX_DOCUMENT = 1 << 30  # bytes of JSON or XML that are searched for names
_MAX_WORDS = 32  # largest number of words in an .mtl statement at which a name may begin
_CONTINUED = re.compile(rb"\\\r?\n")
_TAILS = re.compile(r"(?=\s(\S.*))")
_END_OF_HEADER = re.compile(rb"^end_header", re.MULTILINE)
_GLTF = (".gltf", ".glb")
_GLB_START = struct.Struct("<4s4I")  # magic, version, length, and length and type of the JSON
# Statements that refer to other files: material libraries and textures, buffers and images.
_NAMED: dict[str, re.Pattern[bytes]] = {
    ".obj": re.compile(rb"^[ \t]*mtllib[ \t]+((?:\\\r?\n|[^\r\n])+)", re.MULTILINE),
    ".mtl": re.compile(
        rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+((?:\\\r?\n|[^\r\n])+)",
        re.MULTILINE | re.IGNORECASE,
    ),
    **dict.fromkeys(_GLTF, re.compile(rb'"uri"\s*:\s*"((?:[^"\\]|\\.)+)"')),
    ".dae": re.compile(rb"<(?:init_from|ref)\b[^>]*>([^<]+)<"),
    ".ply": re.compile(rb"^comment[ \t]+TextureFile[ \t]+([^\r\n]+)", re.MULTILINE),
}
_SCAN, _POSE = ".3d", ".pose"  # suffixes of a scan and of its companion with the same name


@checked
def is_url(source: str | os.PathLike[str]) -> bool:
    """Return whether the source is a URL such as ``s3://bucket/scan.bin``.

    Addresses of sources (``kitti:``, ``sim:``) are no URLs, since no ``//`` follows their colon.

    Parameters
    ----------
    source : str or path
        A path, URL or address.

    Returns
    -------
    bool
        Always False for a path object.

    Examples
    --------
    >>> from manip3d import io
    >>> io.is_url("s3://bucket/scan.bin"), io.is_url("kitti:/data/drive"), io.is_url("scan.bin")
    (True, False, False)
    """
    return isinstance(source, str) and _URL.match(source) is not None


def filesystem(url: str) -> tuple[Any, str]:
    """Return fsspec's file system for a URL, and the path in it.

    Raises
    ------
    MissingExtraError
        fsspec is not installed.
    InputError
        fsspec does not know the protocol.
    Error
        The package for the protocol is not installed.
    OSError
        The server cannot be reached; ``filename`` is the URL.
    """
    url_to_fs = imported("fsspec.core", "remote").url_to_fs
    path_of(url, "url")  # raises on NUL characters and on bytes that are not UTF-8
    try:
        # Not a cached instance, because its transaction would be shared with other writers.
        system, path = url_to_fs(url, skip_instance_cache=True, use_listings_cache=False)
    except ImportError as error:
        raise Error(f"{url}: {error}") from error
    except ValueError as error:
        raise InputError(f"{url}: {error}") from error
    except Exception:  # some file systems, such as FTP, connect here
        with naming_remote(url):
            raise
    return system, str(path)


@checked
@contextlib.contextmanager
def local_copy(source: str | os.PathLike[str], *, max_bytes: int | None = None) -> Iterator[Path]:
    """Yield a local file with the content of ``source``; a local path is yielded unchanged.

    The copy of a remote file has the same name. The files to which it refers (material libraries,
    textures, buffers) are copied to the same folder. All are removed when the block ends.

    Parameters
    ----------
    source : path or URL
        The file.
    max_bytes : int, optional
        Largest size of a remote file.

    Yields
    ------
    Path
        Path of the local file.

    Raises
    ------
    InputError
        fsspec does not know the protocol of the URL.
    MissingExtraError
        fsspec is not installed (extra ``remote``).
    FormatError
        The file has more than ``max_bytes``. A `FormatError` raised within the block is changed so
        that it names the URL instead of the copy.
    OSError
        The file does not exist or cannot be downloaded; ``filename`` is the URL.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import io
    >>> written = Path("note.txt").write_text("here")
    >>> with io.local_copy("note.txt") as path:
    ...     print(path.read_text())
    here
    """
    if not is_url(source):
        yield path_of(source)
        return
    url = str(source)
    with _temporary_folder(url) as folder:
        system, remote = filesystem(url)
        copy = folder / PurePosixPath(remote).name
        with naming_remote(url):
            _fetch(system, remote, copy, max_bytes, url)
            _fetch_companions(system, PurePosixPath(remote).parent, copy, max_bytes, url)
        yield copy


@checked
@contextlib.contextmanager
def local_output(output: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a local path to write to; a remote output is uploaded when the block ends.

    A local path is yielded unchanged. For a URL, all files that were written to the folder are
    uploaded in one transaction, ``output`` last; if the block raises, none is.

    Parameters
    ----------
    output : path or URL
        The file to write.

    Yields
    ------
    Path
        Local path to which the caller writes.

    Raises
    ------
    InputError
        fsspec does not know the protocol of the URL, or cannot write to it.
    MissingExtraError
        fsspec is not installed (extra ``remote``).
    OSError
        The file cannot be written; ``filename`` is the URL.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import io
    >>> with io.local_output("note.txt") as path:
    ...     written = path.write_text("here")
    >>> Path("note.txt").read_text()
    'here'
    """
    if not is_url(output):
        yield path_of(output)
        return
    url = str(output)
    with _temporary_folder(url) as folder:
        system, remote = filesystem(url)
        local = folder / PurePosixPath(remote).name
        yield local
        files = sorted(path for path in folder.rglob("*") if path.is_file() and path != local)
        files += [local] if local.is_file() else []
        place = PurePosixPath(remote).parent
        with naming_remote(url):
            _send(system, {str(place / path.relative_to(folder)): path for path in files})


@contextlib.contextmanager
def _temporary_folder(url: str) -> Iterator[Path]:
    """Yield a temporary folder; errors that name a file in it get the name beside ``url``."""
    with tempfile.TemporaryDirectory(prefix="manip3d-") as name:
        ours, theirs = f"{name}{os.sep}", url.rpartition("/")[0] + "/"
        try:
            yield Path(name)
        except OSError as error:
            if isinstance(error.filename, str) and error.filename.startswith(ours):
                error.filename = theirs + error.filename.removeprefix(ours)
            raise
        except Error as error:
            if isinstance(error, FormatError):
                error.file = error.file.replace(ours, theirs)
            error.args = tuple(a.replace(ours, theirs) if isinstance(a, str) else a
                               for a in error.args)  # fmt: skip
            raise


@contextlib.contextmanager
def naming_remote(url: str) -> Iterator[None]:
    """Turn any exception of a remote file system into an OSError that names the URL."""
    try:
        yield
    except Error:
        raise
    except NotImplementedError as error:
        raise InputError(f"{url}: expected files that can be written, got {error}") from error
    except OSError as error:
        kind = next((code for kind, code in _CODES.items() if isinstance(error, kind)), errno.EIO)
        code = error.errno or kind
        raise OSError(code, error.strerror or os.strerror(code), url) from error
    except Exception as error:  # each file system has its own types, for example for credentials
        raise OSError(errno.EIO, f"{type(error).__name__}: {error}", url) from error


def _fetch(system: Any, remote: str, local: Path, max_bytes: int | None, url: str) -> None:
    num_bytes = 0
    with system.open(remote, "rb") as source, local.open("wb") as copy:
        while block := source.read(_BLOCK):
            num_bytes += len(block)
            if max_bytes is not None and num_bytes > max_bytes:
                raise FormatError(over_max_bytes(max_bytes), file=url)
            copy.write(block)


def _fetch_companions(
    system: Any, place: PurePosixPath, copy: Path, max_bytes: int | None, url: str
) -> None:
    """Download the files to which the copy refers; readers warn about those that are missing."""
    waiting, seen = [copy], {copy}
    while waiting:
        for name in companions(waiting.pop()):
            local = copy.parent / name
            if local in seen or len(seen) > MAX_COMPANIONS:
                continue
            seen.add(local)
            local.parent.mkdir(parents=True, exist_ok=True)
            try:
                _fetch(system, str(place / name), local, max_bytes, url)
            except FileNotFoundError:
                continue
            waiting.append(local)


def reads_beside(path: PurePosixPath) -> bool:
    """Return whether a file with this suffix can refer to other files."""
    return _plain_suffix(path) in (*_NAMED, *PACKETS, _SCAN)


def named_beside(source: str) -> Iterator[str]:
    """Yield the paths or URLs of the files to which a file or URL refers.

    Of a URL only the JSON of a glTF file is downloaded, which is small; other URLs yield nothing,
    and so does a source that cannot be read.
    """
    if is_url(source) and _plain_suffix(PurePosixPath(source)) not in _GLTF:
        return
    place = source.rpartition("/")[0]
    try:
        with _temporary_folder(source) as folder:
            path = Path(source)
            if is_url(source):
                system, remote = filesystem(source)
                path = folder / PurePosixPath(remote).name
                with naming_remote(source):
                    if path.suffix.lower() == ".glb":
                        with system.open(remote, "rb") as stream:
                            path.write_bytes(_start_of_glb(stream, _MAX_TEXT))
                    else:
                        _fetch(system, remote, path, _MAX_TEXT, source)
            for name in companions(path):
                yield f"{place}/{name}" if place else str(name)
    except (OSError, Error):
        return


def companions(path: Path) -> Iterator[PurePosixPath]:
    """Yield the paths of files to which a file refers, relative to its folder, if below it."""
    suffix = _plain_suffix(path)
    if suffix in PACKETS:
        yield from map(PurePosixPath, ouster_metadata_names(path))
    if suffix == _SCAN:
        plain = path if path.suffix.lower() == suffix else path.with_suffix("")
        yield PurePosixPath(plain.with_suffix(_POSE).name)
    if suffix not in _NAMED:
        return
    for text in _texts_of(path, suffix):
        for found in _NAMED[suffix].finditer(text):
            name = _CONTINUED.sub(b" ", found[1]).decode("utf-8", "replace")
            yield from _files_below(_unescaped(name.strip(), suffix), suffix)


def _unescaped(name: str, suffix: str) -> str:
    """Return a name without the escapes of JSON and XML, and of the URIs in them."""
    if suffix in _GLTF:
        with contextlib.suppress(ValueError):
            name = json.loads(f'"{name}"')
    elif suffix == ".dae":
        name = html.unescape(name)
    else:
        return name
    return urllib.parse.unquote(name)


def _files_below(text: str, suffix: str) -> Iterator[PurePosixPath]:
    """Yield the file names that a statement may mean, without those outside of the folder."""
    whole = text.replace("\\", "/")
    parts: list[str] = []
    if suffix == ".obj":  # a name with spaces, or several names
        parts = whole.split()
    elif suffix == ".mtl" and whole.startswith("-"):  # options before a name: -bm 0.5 my image.png
        parts = [match[1] for match in islice(_TAILS.finditer(whole), _MAX_WORDS)]
    elif suffix == ".dae":  # the folder may be one of the author's computer
        parts = [whole.rpartition("/")[2]]
    for name in dict.fromkeys([whole, *parts]):
        relative = PurePosixPath(name)
        is_below = not relative.is_absolute() and ".." not in relative.parts
        if is_below and ":" not in name and "\0" not in name and relative.name:
            yield relative


def _plain_suffix(path: PurePosixPath | Path) -> str:
    """Return the suffix in lower case, ignoring a final ``.gz`` or ``.xz``."""
    return PurePosixPath(path.name.lower().removesuffix(".gz").removesuffix(".xz")).suffix


def _texts_of(path: Path, suffix: str) -> Iterator[bytes]:
    """Yield the content of a file in blocks of whole lines, to save memory.

    A compressed file is read up to `_MAX_TEXT` bytes, so that a hostile one cannot expand without
    limit; a PLY file, up to the end of its header. JSON and XML are yielded as one block, because
    an entry may span several lines.
    """
    packing = path.suffix.lower()
    opened: Any = {".gz": gzip.open, ".xz": lzma.open}.get(packing, open)
    most = _MAX_TEXT if packing in (".gz", ".xz") else sys.maxsize
    try:
        with opened(path, "rb") as stream:
            if suffix == ".ply":
                yield _END_OF_HEADER.split(stream.read(_BLOCK), maxsplit=1)[0]
            elif suffix == ".glb":
                yield _start_of_glb(stream, min(most, _MAX_DOCUMENT))
            elif suffix in (".gltf", ".dae"):
                yield stream.read(min(most, _MAX_DOCUMENT))
            else:
                yield from _lines_of(stream, most)
    except (
        EOFError,
        zlib.error,
        lzma.LZMAError,
        gzip.BadGzipFile,
    ):  # the mesh reader reports the damage
        return


def _start_of_glb(stream: Any, most: int) -> bytes:
    """Return the start of a binary glTF file up to the end of its JSON; empty for other files."""
    start: bytes = stream.read(_GLB_START.size)
    if len(start) < _GLB_START.size or not start.startswith(b"glTF"):
        return b""
    *_, length, _ = _GLB_START.unpack(start)
    return start + bytes(stream.read(min(length, most)))


def _lines_of(stream: Any, most: int) -> Iterator[bytes]:
    """Yield blocks that end at the end of a line, of at most ``most`` bytes in all."""
    block = stream.read(min(_BLOCK, most))
    rest, line_end = b"", b"\r" if b"\r" in block and b"\n" not in block else b"\n"
    block = block.removeprefix(codecs.BOM_UTF8)
    while block:
        most -= len(block)
        lines, found, rest = (rest + block).rpartition(line_end)
        if found:
            yield lines.replace(b"\r", b"\n") if line_end == b"\r" else lines
        rest = rest[:_BLOCK]  # a statement that names a file is shorter
        block = stream.read(min(_BLOCK, most))
    yield rest


def _send(system: Any, files: dict[str, Path]) -> None:
    """Upload files in one transaction, so that all or none appear if the file system can do so."""
    if not files:
        return
    protocols = {system.protocol} if isinstance(system.protocol, str) else set(system.protocol)
    if not protocols & _OBJECT_STORES:
        for folder in {str(PurePosixPath(remote).parent) for remote in files}:
            system.makedirs(folder, exist_ok=True)
    with system.transaction:
        for remote, local in files.items():
            with local.open("rb") as content, system.open(remote, "wb") as target:
                shutil.copyfileobj(content, target, _BLOCK)
