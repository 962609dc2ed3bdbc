"""Reading and writing of scans; `manip3d.io` shows the functions."""

from __future__ import annotations

import gzip
import lzma
import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.paths import is_hidden, path_of
from manip3d.errors import InputError
from manip3d.io import _scan_tables as tables
from manip3d.io._elsewhere import scan_advice
from manip3d.io._files import open_regular, refuse_pointer
from manip3d.io._limits import byte_limit, clock
from manip3d.io._remote import is_url, local_copy, local_output
from manip3d.io._scan_colors import color_names, renamed
from manip3d.io._scan_tables import scan_suffix
from manip3d.lidar import LidarFrame

SCAN_SUFFIXES: tuple[str, ...] = (
    *tables.TABLE_SUFFIXES,
    *(".npy", ".npz", ".las", ".laz", ".e57", ".ptx"),
)
"""Suffixes that `read_scan` and `write_scan` know; LAS, LAZ and E57 need an extra."""

_SEVERAL = (".e57", ".ptx")
"""Suffixes of files that hold several scans."""

_EXPORTED = (".asc", ".pts", ".txt", ".csv", ".npy", ".npz")
FOLDER_SUFFIXES: tuple[str, ...] = tuple(
    suffix for suffix in SCAN_SUFFIXES if suffix not in _EXPORTED
)
"""Suffixes by which folders are searched: most texts and arrays in a folder are not scans, and a
watermarked drive consists of no other files, since what verifies it must find them."""

EXPORTED_SUFFIXES: tuple[str, ...] = tuple(s for s in SCAN_SUFFIXES if s not in FOLDER_SUFFIXES)
"""Suffixes by which a folder without other scans is searched: exports of other programs."""

_PLY_HEADER_BYTES = 1 << 16
_HEAD_BYTES, _HEAD_LINES, _MOST_COLUMNS = 4096, 8, 24
"""Bytes and lines that tell a text of points, and the most columns of one: poses of a car and its
navigation have more, or are named."""


@checked
def read_scan(
    path: str | os.PathLike[str],
    *,
    origin: Sequence[float] | None = None,
    max_bytes: int | None = None,
) -> LidarFrame:
    """Read a scan: one of `SCAN_SUFFIXES`, which ``.gz`` or ``.xz`` may follow.

    LAS, LAZ, E57, PTX, ``.npy`` and ``.npz`` are not compressed further.

    Parameters
    ----------
    path : path-like or URL
    origin : (3,) float, optional
        Where the scanner stood, if the file does not say.
    max_bytes : int, optional
        The most uncompressed bytes to read. Without it compressed files are refused past 64 MiB
        where they expand more than 200 times.

    Returns
    -------
    LidarFrame
        The notes say where its scanner stands and what its coordinates are, format by format.
        Points without coordinates (NaN, empty, marked invalid) were not measured: they are dropped
        and counted, and ``file_rows`` has the rows of the others. KITTI's ``.bin`` has no such
        points: NaN there is damage.

    Raises
    ------
    FormatError
        The file is damaged or hostile; names the file and the line or byte.
    InputError
        No format has that suffix, or the file holds several positions (see `read_scans`).
    MissingExtraError
        LAS, LAZ and E57: the package that reads them is not installed.
    OSError
        `FileNotFoundError` and the like.

    Notes
    -----
    Coordinates of 64 bits that lie far from 0, as those of maps do, are moved near it:
    `ScanFormat.to_file` leads back.

    KITTI ``.bin``
        Metres, x forward, y left, z up, the scanner at the origin. Where the values say that rows
        have three, five, six or seven floats instead of x, y, z and intensity, ``fields`` has the
        others as ``column_5`` and so on.
    nuScenes ``.pcd.bin``
        Coordinates as they are, the scanner at the origin.
    PCD
        Coordinates as they are, the scanner at the file's viewpoint.
    PLY, LAS, LAZ
        Coordinates as they are; the scanner's position is not known.
    3DTK ``.3d``
        Converted to metres, x forward, y left, z up, the scanner at the origin.
        ``format.header["pose"]`` is the pose of the ``.pose`` file beside it.
    E57, PTX
        The scanner's own frame, the scanner at the origin; ``format.header["pose"]`` is its pose.
        Points of PTX at (0, 0, 0) were not measured; ``format.header["shape"]`` has the columns
        and rows of its grid. Where it states another position than the pose, that is not known.
    Text (``.xyz``, ``.xyzi``, ``.xyzn``, ``.xyzrgb``, ``.asc``, ``.pts``, ``.txt``, ``.csv``)
        A point a line; commas, semicolons or blanks between columns. A line before the points names
        the columns; without one they are x, y, z, the intensity where there are four or seven, and
        ``c3`` and so on; normals in ``.xyzn`` and colours in ``.xyzrgb``, as Open3D writes them.
        The scanner's position is not known.
    ``.npy``
        Rows of x, y, z, the intensity and up to four more numbers, or a structured array with
        named columns; otherwise as text.
    ``.npz``
        Open3D's point clouds: arrays ``positions`` or ``points``, ``colors``, ``normals``, and
        others of as many rows; or one array as in ``.npy``. Otherwise as text.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io
    >>> np.float32([[1, 2, 3, 0.5], [4, 5, 6, 0.25]]).tofile("scan.bin")
    >>> io.read_scan("scan.bin").points.tolist()
    [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    """
    frames = read_scans(path, max_bytes=max_bytes)
    if len(frames) != 1:
        more = ": use read_scans, or 'manip3d convert' to a folder for a file of each"
        raise InputError(
            f"{os.fspath(path)}: expected one scan, got {len(frames)}{more if frames else ''}"
        )
    return frames[0] if origin is None else frames[0].replace(origin=tuple(origin))


@checked
def read_scans(path: str | os.PathLike[str], *, max_bytes: int | None = None) -> list[LidarFrame]:
    """Read all scans of a file: E57 and PTX may hold many positions, other formats hold one.

    Parameters
    ----------
    path : path-like or URL
    max_bytes : int, optional
        The most uncompressed bytes to read.

    Returns
    -------
    list of LidarFrame

    Raises
    ------
    FormatError, InputError, MissingExtraError, OSError
        As `read_scan`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import io
    >>> np.float32([[1, 2, 3, 0.5]]).tofile("scan.bin")
    >>> len(io.read_scans("scan.bin"))
    1
    """
    limit = byte_limit(max_bytes)
    with clock(os.fspath(path)) as look, local_copy(path, max_bytes=limit or None) as local:
        refuse_pointer(local)
        frames = _read_local(local, limit, look)
    return [frame.replace(source=path) for frame in frames] if is_url(path) else frames


def _read_local(path: Path, limit: int, look: Callable[[float], None] | None) -> list[LidarFrame]:
    suffix = scan_suffix(path)
    if (advice := scan_advice(path)) is not None:
        raise InputError(f"path: {path.name}: {advice}")
    if suffix in (".las", ".laz"):
        from manip3d.io import _scan_las

        return [_scan_las.read(path, limit)]
    if suffix == ".e57":
        from manip3d.io import _scan_e57

        return _scan_e57.read_all(path, limit)
    if suffix == ".ptx":
        from manip3d.io import _scan_ptx

        return _scan_ptx.read_all(path, limit)
    if suffix == ".npy":
        from manip3d.io import _scan_npy

        return [_scan_npy.read(path, limit)]
    if suffix == ".npz":
        from manip3d.io import _scan_npz

        return [_scan_npz.read(path, limit)]
    return [tables.read_table(path, limit, look)]


@checked
def write_scan(frame: LidarFrame, path: str | os.PathLike[str]) -> None:
    """Write a scan in the format that the suffix says, then ``.gz`` or ``.xz`` if wanted.

    The file appears whole or not at all. A scan written to the format that it was read from keeps
    the file's columns, their types and their order, and the coordinates of points that were not
    moved. Another format gets x, y, z, the intensity (`.bin`: 0 where there is none), the ring and
    what of ``fields`` it can hold; KITTI's ``.bin`` holds nothing else, 3DTK's ``.3d`` the
    intensity, E57 rows, columns and colours (coordinates as 32-bit floats, those of a map near 0
    with the rest in the pose), PTX colours. Colours get the names that the other format has for
    them (PCD: one number), with 8 bits, in LAS with 16; normals those of PLY and PCD. ``.pts`` has
    colours
    as its last columns, ``.xyzrgb`` and ``.xyzn`` colours or normals only; ``.xyz``, ``.xyzi``,
    ``.asc`` and ``.txt`` hold no more than the intensity. ``.npz`` is as Open3D reads it.

    Parameters
    ----------
    frame : LidarFrame
    path : path-like or URL
        One of `SCAN_SUFFIXES`, which ``.gz`` or ``.xz`` may follow; not LAS, LAZ, E57, PTX,
        ``.npy`` and ``.npz``.

    Raises
    ------
    InputError
        Unknown suffix.
    MissingExtraError
        LAS, LAZ and E57: the package that writes them is not installed.
    OSError
        The operating system refused; the old file is whole.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, io
    >>> io.write_scan(LidarFrame(np.float32([[1, 2, 3]])), "scan.pcd")
    >>> io.read_scan("scan.pcd").points.tolist()
    [[1.0, 2.0, 3.0]]
    """
    _refuse_compression(path)
    if scan_suffix(path_of(path)) in _SEVERAL:
        return write_scans([frame], path)
    frame = renamed(frame, scan_suffix(path_of(path)).lstrip(".").replace("laz", "las"))
    with local_output(path) as local:
        if scan_suffix(local) in (".las", ".laz"):
            from manip3d.io import _scan_las

            return _scan_las.write(frame, local)
        if scan_suffix(local) == ".npy":
            from manip3d.io import _scan_npy

            return _scan_npy.write(frame, local)
        if scan_suffix(local) == ".npz":
            from manip3d.io import _scan_npz

            return _scan_npz.write(frame, local)
        return tables.write_table(frame, os.fspath(local))


def names_left_out(frame: LidarFrame, suffix: str) -> list[str]:
    """The columns of a scan that a file of another format does not hold, if not all are 0."""
    name = suffix.lstrip(".").replace("laz", "las")
    if suffix in tables.TABLE_SUFFIXES:
        name = tables.format_name(suffix)
    if frame.format is not None and frame.format.name == name:
        return []
    frame = renamed(frame, name)
    if suffix in tables.TABLE_SUFFIXES:
        held = tables.column_names(frame, suffix)
    elif name in ("las", "npz"):
        held = {"intensity", *tables.general_fields(frame)}
    elif name == "e57":
        from manip3d.io import _scan_e57

        held = {"intensity", *_scan_e57.INTEGERS}
    elif name == "ptx":
        held = {"intensity", *color_names(frame, name)}
    else:
        held = {"intensity"}
    columns = {"intensity": frame.intensity, "ring": frame.ring, **frame.fields}
    return [
        key
        for key, values in columns.items()
        if key not in held and values is not None and values.any()
    ]


def _refuse_compression(path: str | os.PathLike[str]) -> None:
    name = path_of(path)
    if scan_suffix(name) not in tables.TABLE_SUFFIXES and name.suffix.lower() in (".gz", ".xz"):
        raise InputError(f"path: {scan_suffix(name)} is not written compressed, got {name.name!r}")


@checked
def write_scans(frames: Sequence[LidarFrame], path: str | os.PathLike[str]) -> None:
    """Write several scan positions to one E57 or PTX file, each with the pose it was read with.

    Parameters
    ----------
    frames : sequence of LidarFrame
    path : path-like or URL
        ``.e57`` or ``.ptx``; any other suffix takes exactly one scan.

    Raises
    ------
    InputError
        Another suffix and not exactly one scan.
    MissingExtraError, OSError
        As `write_scan`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, io
    >>> scans = [LidarFrame(np.full((5, 3), place, np.float32)) for place in (1, 2)]
    >>> io.write_scans(scans, "both.e57")
    >>> len(io.read_scans("both.e57"))
    2
    """
    _refuse_compression(path)
    if scan_suffix(path_of(path)) == ".e57":
        from manip3d.io import _scan_e57

        with local_output(path) as local:
            return _scan_e57.write_all([renamed(frame, "e57") for frame in frames], local)
    if scan_suffix(path_of(path)) == ".ptx":
        from manip3d.io import _scan_ptx

        with local_output(path) as local:
            return _scan_ptx.write_all([renamed(frame, "ptx") for frame in frames], local)
    if len(frames) != 1:
        raise InputError(f"frames: only E57 and PTX hold several scans, got {len(frames)}")
    return write_scan(frames[0], path)


def ply_elements(path: Path) -> dict[bytes, bytes] | None:
    """The elements that the header of a PLY file names, with their numbers as it writes them.

    None: the file cannot be read; the reader of meshes says what is wrong.
    """
    openers: dict[str, Any] = {".gz": gzip.open, ".xz": lzma.open}
    try:
        with openers.get(path.suffix.lower(), open)(path, "rb") as stream:
            header = stream.read(_PLY_HEADER_BYTES).partition(b"end_header")[0]
    except (OSError, EOFError, lzma.LZMAError):
        return None
    words = [line.split() for line in header.splitlines()]
    return {line[1]: b" ".join(line[2:]) for line in words if line[:1] == [b"element"] and line[1:]}


def are_points_only(elements: dict[bytes, bytes]) -> bool:
    """Whether `ply_elements` are those of a scan without a grid."""
    # MeshLab writes the scans that it opens with no faces, and says so.
    told = {name for name, number in elements.items() if number != b"0" or name == b"range_grid"}
    return told <= {b"vertex", b"camera"}


def holds_points(path: Path) -> bool:
    """Return whether a text or an array holds points: three numbers a line, or names of x, y, z.

    Raises
    ------
    OSError
        It cannot be read.
    """
    if scan_suffix(path) == ".npy":
        from manip3d.io._scan_npy import is_npy_scan

        return is_npy_scan(path)
    if scan_suffix(path) == ".npz":
        from manip3d.io._scan_npz import is_npz_scan

        return is_npz_scan(path)
    with open_regular(path) as file:
        head = file.read(_HEAD_BYTES).decode("utf-8", "replace")
    for line in head.splitlines()[:_HEAD_LINES]:
        cells = [cell.strip('"').lower() for cell in re.split(r"[;,\s]+", line.strip("\ufeff#/ "))]
        if len(cells) > _MOST_COLUMNS:
            return False
        if {"x", "y", "z"} <= set(cells) or any(cell.startswith("points") for cell in cells):
            return True
        if len(cells) >= 3 and all(map(_is_number, cells[:3])):
            return True
    return False


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def readable_scans(folder: str | os.PathLike[str]) -> list[Path]:
    """The scans of a folder: those of `FOLDER_SUFFIXES`, else the texts and arrays with points.

    Hidden files do not count.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    if scans := [*scan_paths(folder)]:
        return scans
    return [
        path
        for path in sorted(path_of(folder, "folder").iterdir())
        if scan_suffix(path) in EXPORTED_SUFFIXES
        and not is_hidden(path.name)
        and path.is_file()
        and holds_points(path)
    ]


def scan_paths(folder: str | os.PathLike[str], *, hidden: bool = False) -> Iterator[Path]:
    """The scans of a folder, in the order of their names; hidden ones only where they are asked."""
    yield from sorted(
        p
        for p in path_of(folder, "folder").iterdir()
        if scan_suffix(p) in FOLDER_SUFFIXES and (hidden or not is_hidden(p.name))
    )
