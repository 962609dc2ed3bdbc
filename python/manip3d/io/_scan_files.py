"""Reading and writing of scans in all formats; `manip3d.io` exports the functions."""

from __future__ import annotations

import gzip
import lzma
import os
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d._util.checked import checked
from manip3d._util.linear import quaternions
from manip3d._util.paths import in_order, is_hidden, path_of
from manip3d.errors import InputError
from manip3d.io import _scan_tables as tables
from manip3d.io._elsewhere import scan_advice
from manip3d.io._files import open_regular, refuse_pointer
from manip3d.io._limits import byte_limit, clock
from manip3d.io._remote import is_url, local_copy, local_output
from manip3d.io._scan_colors import color_names, renamed
from manip3d.io._scan_tables import scan_suffix
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SCAN_SUFFIXES: tuple[str, ...] = (
    *tables.TABLE_SUFFIXES,
    *(".npy", ".npz", ".las", ".laz", ".e57", ".ptx"),
)
"""Suffixes of the formats that `read_scan` reads and `write_scan` writes; LAS, LAZ and E57 need an
extra."""

_SEVERAL = (".e57", ".ptx")
"""Suffixes of formats that may hold several scans."""

_EXPORTED = (".asc", ".pts", ".txt", ".csv", ".npy", ".npz")
FOLDER_SUFFIXES: tuple[str, ...] = tuple(
    suffix for suffix in SCAN_SUFFIXES if suffix not in _EXPORTED
)
"""Suffixes of the files that are scans of a folder. Text files and arrays are not among them,
because most of those in a folder are no scans. All scans of a watermarked drive have one of these
suffixes, so that verification finds them."""

EXPORTED_SUFFIXES: tuple[str, ...] = tuple(s for s in SCAN_SUFFIXES if s not in FOLDER_SUFFIXES)
"""Suffixes that count only in a folder without other scans: exports of other programs."""

_PLY_HEADER_BYTES = 1 << 16  # bytes of a PLY file in which the header must end
_HEAD_BYTES, _HEAD_LINES, _MAX_COLUMNS = 4096, 8, 24
"""A text file is recognised as points by its first 4096 bytes or 8 lines, with at most 24 columns;
files with poses or navigation data of a car have more columns, or other names."""


@checked
def read_scan(
    path: str | os.PathLike[str],
    *,
    origin: Sequence[float] | None = None,
    max_bytes: int | None = None,
) -> LidarFrame:
    """Read a scan: one of `SCAN_SUFFIXES`, which ``.gz`` or ``.xz`` may follow.

    LAS, LAZ, E57, PTX, ``.npy`` and ``.npz`` may not be followed by ``.gz`` or ``.xz``.

    Parameters
    ----------
    path : path-like or URL
        The file.
    origin : (3,) float, optional
        Position of the scanner in the coordinates of the points; default: as the format states, see
        Notes.
    max_bytes : int, optional
        Largest number of uncompressed bytes to read. Default: a compressed file may have 64 MiB or
        expand 200 times, whichever is more.

    Returns
    -------
    LidarFrame
        The scan. Points without coordinates (NaN, empty, marked invalid) were not measured: they
        are dropped and counted, and ``file_rows`` holds the rows of the others. In KITTI's
        ``.bin``, x, y and z of such points are NaN; other numbers that are not finite are an error,
        because rows of another layout have them.

    Raises
    ------
    FormatError
        The file is damaged or hostile; the error names the file and the line or byte.
    InputError
        The suffix is unknown, or the file holds several scan positions (see `read_scans`).
    MissingExtraError
        The package that reads LAS, LAZ or E57 is not installed.
    OSError
        The file cannot be read.

    Notes
    -----
    64-bit coordinates far from 0, such as map coordinates, are shifted near 0;
    `ScanFormat.to_file` is the transform back to the file's coordinates. Coordinates and the
    scanner's position depend on the format:

    KITTI ``.bin``
        Metres, x forward, y left, z up, the scanner at the origin. Rows usually are x, y, z and
        intensity. If the values show that rows have three, five, six or seven floats, ``fields``
        has the further columns as ``column_5`` and so on.
    nuScenes ``.pcd.bin``
        Coordinates of the file, the scanner at the origin. Rings that are all 0 are none.
    PCD
        Coordinates of the file, the scanner at the file's viewpoint.
    PLY, LAS, LAZ
        Coordinates of the file; the scanner's position is not known.
    3DTK ``.3d``
        Converted to metres, x forward, y left, z up, the scanner at the origin. If there are four
        or seven columns, the fourth is the intensity; others are ``c3`` and so on.
        ``format.header["pose"]`` is the pose of the ``.pose`` file beside it.
    E57, PTX
        Coordinates relative to the scanner, the scanner at the origin; ``format.header["pose"]`` is
        its pose. In PTX, points at (0, 0, 0) were not measured, and ``format.header["shape"]``
        holds the numbers of columns and rows of the grid. If the scanner position that a PTX file
        states contradicts its pose, the position is treated as unknown. An E57 scan that
        `write_scan` wrote without a known position has coordinates of the file, and none again.
    Text (``.xyz``, ``.xyzi``, ``.xyzn``, ``.xyzrgb``, ``.asc``, ``.pts``, ``.txt``, ``.csv``)
        One point per line; columns are separated by commas, semicolons or spaces. A line before the
        points may name the columns. Otherwise they are x, y, z, then the intensity if there are
        four or seven columns, then ``c3`` and so on; in ``.xyzn`` normals follow and in ``.xyzrgb``
        colours, as Open3D writes them. Names may state millimetres or centimetres, as in
        ``X (mm)``: coordinates are converted to metres. The scanner's position is not known.
    ``.npy``
        Rows of x, y, z, the intensity and up to four more numbers, or a structured array with
        named columns. The scanner's position is not known.
    ``.npz``
        Open3D's point clouds: arrays ``positions`` or ``points``, ``colors``, ``normals``, and
        others with the same number of rows; or one array as in ``.npy``; or an array for each
        column, ``x``, ``y`` and ``z`` among them; or A2D2's arrays, without ``pcloud_attr.`` before
        their names. The scanner's position is not known.

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
    """Read all scans of a file; E57 and PTX may hold several positions, other formats hold one.

    Parameters
    ----------
    path : path-like or URL
        The file.
    max_bytes : int, optional
        Largest number of uncompressed bytes to read.

    Returns
    -------
    list of LidarFrame
        The scans in the order of the file.

    Raises
    ------
    FormatError, InputError, MissingExtraError, OSError
        See `read_scan`.

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
    """Write a scan in the format of the suffix, which ``.gz`` or ``.xz`` may follow.

    The file is written atomically.

    Parameters
    ----------
    frame : LidarFrame
        The scan to write.
    path : path-like or URL
        Output file with one of `SCAN_SUFFIXES`; ``.gz`` or ``.xz`` may follow, except with LAS,
        LAZ, E57, PTX, ``.npy`` and ``.npz``.

    Raises
    ------
    InputError
        The suffix is unknown.
    MissingExtraError
        The package that writes LAS, LAZ or E57 is not installed.
    OSError
        The file cannot be written; an existing file stays unchanged.

    Notes
    -----
    A scan that is written to the format from which it was read keeps the file's columns, their
    types and their order, and the exact coordinates of points that were not moved. Another format
    gets x, y, z, the intensity, the ring, and those ``fields`` that it can hold:

    - ``.bin`` (KITTI) holds only the intensity, ``.pcd.bin`` (nuScenes) also the ring; they are 0
      if there is none. ``.3d`` (3DTK) holds only the intensity.
    - E57 holds rows, columns and colours. Its coordinates are 32-bit floats; map coordinates are
      shifted near 0, and the shift is in the pose.
    - PTX holds colours. ``.pts`` has colours in its last columns, ``.xyzrgb`` only colours and
      ``.xyzn`` only normals. ``.xyz``, ``.xyzi``, ``.asc`` and ``.txt`` hold only the intensity.
    - PLY has no integers of 64 bits, and leaves such columns out.
    - ``.npz`` is a point cloud that Open3D reads.
    - PCD holds the scanner's position, and E57 and PTX do in the pose: their points are relative to
      the scanner. KITTI, nuScenes and 3DTK files say that it is the origin; others do not state it.

    Colours and normals get the column names of the format. Colours have 8 bits, packed in one
    number in PCD; LAS has 16 bits.

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


def position_losses(scan: LidarFrame, suffix: str) -> Iterator[str]:
    """Yield a sentence if a file of this suffix does not hold the scanner's position or pose, or
    states a wrong position."""
    if tables.states_wrong_origin(scan, suffix):
        yield f"where the scanner stood is not known; {suffix} files say that it is the origin"
    if (place := tables.lost_origin(scan, suffix)) is not None:
        yield f"the scanner stands at {_millimetres(place)}, which {suffix} does not hold"
    if (pose := tables.lost_pose(scan, suffix)) is not None:
        (turn,) = quaternions(pose[None, :3, :3])
        turned = " ".join(f"{value:.6f}" for value in turn)
        yield (
            f"coordinates are the scanner's own, and {suffix} holds no pose; the scanner "
            f"stands at {_millimetres(pose[:3, 3])}, turned by the quaternion (w x y z) {turned}"
        )


def _millimetres(place: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.3f}" for value in place)


def names_left_out(frame: LidarFrame, suffix: str) -> list[str]:
    """Return the columns of a scan, other than zeros, that a file of this suffix cannot hold."""
    name = tables.format_name(suffix)
    # pye57 reads more than it writes.
    if frame.format is not None and frame.format.name == name != "e57":
        return []
    frame = renamed(frame, name)
    if suffix in tables.TABLE_SUFFIXES:
        held = tables.column_names(frame, suffix)
    elif name in ("las", "npz"):
        held = {"intensity", *tables.general_fields(frame)}
    elif name == "e57":
        from manip3d.io import _scan_e57

        held = {"intensity", *_scan_e57.integers_of(frame).values()}
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
    """Write several scan positions to one E57 or PTX file, each with the pose from its own file.

    Parameters
    ----------
    frames : sequence of LidarFrame
        The scans to write.
    path : path-like or URL
        Output file that ends in ``.e57`` or ``.ptx``; other formats hold exactly one scan.

    Raises
    ------
    InputError
        The suffix is another one, and there is not exactly one scan.
    MissingExtraError, OSError
        See `write_scan`.

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
    """Return the elements in the header of a PLY file, with their counts as text.

    None if the file cannot be read; the mesh reader then reports the reason.
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
    """Return whether a PLY file with these elements is a scan without a range grid."""
    # MeshLab saves scans with an element "face" of count 0.
    told = {name for name, number in elements.items() if number != b"0" or name == b"range_grid"}
    return told <= {b"vertex", b"camera"}


def holds_points(path: Path) -> bool:
    """Return whether a text file or array holds points: three numbers per row, or columns x, y, z.

    Raises
    ------
    OSError
        The file cannot be read.
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
        if len(cells) > _MAX_COLUMNS:
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
    """Return the scans of a folder: those of `FOLDER_SUFFIXES`, or else text files and arrays.

    Text files and arrays must hold points, see `holds_points`. Hidden files are ignored.

    Raises
    ------
    OSError
        A file cannot be read.
    """
    if scans := [*scan_paths(folder)]:
        return scans
    return [
        path
        for path in in_order(path_of(folder, "folder").iterdir())
        if scan_suffix(path) in EXPORTED_SUFFIXES
        and not is_hidden(path.name)
        and path.is_file()
        and holds_points(path)
    ]


def scan_paths(folder: str | os.PathLike[str], *, hidden: bool = False) -> Iterator[Path]:
    """Yield the files of `FOLDER_SUFFIXES` in a folder by name, with hidden ones if ``hidden``.

    Numbers in names are compared by value, so that 2.bin is before 10.bin.
    """
    yield from in_order(
        p
        for p in path_of(folder, "folder").iterdir()
        if scan_suffix(p) in FOLDER_SUFFIXES and (hidden or not is_hidden(p.name))
    )
