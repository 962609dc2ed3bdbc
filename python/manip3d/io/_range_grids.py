"""Readers of range images whose pixels are points: Stanford's scans, clouds of depth cameras."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError
from manip3d.io._files import refuse_pointer
from manip3d.io._limits import byte_limit, check_points, clock
from manip3d.io._remote import local_copy
from manip3d.io._scan_colors import find_colors, is_packed, with_8_bits
from manip3d.io._scan_tables import Table, measured_points, read_columns, scan_suffix
from manip3d.lidar import ScanFormat

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray


_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class RangeGrid:
    """A range image, in which a pixel has one point or no measurement.

    Attributes
    ----------
    points : (H, W, 3) float64
        Points in the file's own units and axes; NaN without a measurement.
    valid : (H, W) bool
        Whether the pixel has a measurement.
    color : (H, W, 3) uint8 or None
        Red, green and blue of each pixel; None if the file has no colours.
    """

    points: NDArray[np.float64]
    valid: NDArray[np.bool_]
    color: NDArray[np.uint8] | None = None

    __repr__ = short_repr


@checked
def read_range_grid(path: str | os.PathLike[str], *, max_bytes: int | None = None) -> RangeGrid:
    """Read the pixels of a range scan or of an organised point cloud.

    Parameters
    ----------
    path : path-like or URL
        A PLY file with a ``range_grid``, such as Stanford's single scans; a PCD file with a
        ``HEIGHT`` of 2 or more, as depth cameras produce; or a ``.npy`` or ``.npz`` file with an
        array (H, W, C), C from 3 to 8, or a structured array (H, W). In PCD and NumPy files NaN,
        (0, 0, 0) and three infinite coordinates mean no measurement. Colours are read from columns
        or arrays with usual names (red, r, rgb, rgba, color, colors), as numbers to 255 or
        fractions to 1; in an array without names from columns 4 to 6, or 5 to 7 behind an
        intensity, or from the packed column 4 of a ZED.
    max_bytes : int, optional
        See `read_mesh`.

    Returns
    -------
    RangeGrid
        Points of the pixels, with colours if the file has some.

    Raises
    ------
    FormatError
        The file is damaged or hostile, or holds no range grid.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import io
    >>> lines = ["ply", "format ascii 1.0", "obj_info num_cols 2", "obj_info num_rows 1"]
    >>> lines += ["element vertex 1", "property float x", "property float y", "property float z"]
    >>> lines += ["element range_grid 2", "property list uchar int vertex_indices", "end_header"]
    >>> _ = Path("scan.ply").write_text(chr(10).join([*lines, "1 2 3", "0", "1 0", ""]))
    >>> grid = io.read_range_grid("scan.ply")
    >>> grid.valid.tolist(), grid.points[0, 1].tolist()
    ([[False, True]], [1.0, 2.0, 3.0])
    """
    limit = byte_limit(max_bytes)
    with clock(os.fspath(path)) as look, local_copy(path, max_bytes=limit or None) as local:
        refuse_pointer(local)
        if scan_suffix(path) in (".pcd", ".npy", ".npz"):
            return _grid_of_cloud(_cloud(local, limit, look), os.fspath(path))
        found = _core.read_range_grid(os.fsencode(local), limit, look)
    rows, cols, vertex, vertices, colors = found
    check_points(len(vertices), os.fspath(path))
    valid = vertex >= 0
    points = np.full((rows * cols, 3), np.nan)
    points[valid] = vertices[vertex[valid]]
    color = np.zeros((rows * cols, 3), np.uint8)
    if len(colors):
        color[valid] = colors[vertex[valid]]
    return RangeGrid(
        points.reshape(rows, cols, 3),
        valid.reshape(rows, cols),
        color.reshape(rows, cols, 3) if len(colors) else None,
    )


def _cloud(path: Path, limit: int, look: Callable[[float], None] | None) -> Table:
    suffix = scan_suffix(path)
    if suffix == ".npz":
        from manip3d.io import _scan_npz

        return _scan_npz.read_table(path, limit)
    if suffix == ".npy":
        from manip3d.io import _scan_npy

        return _scan_npy.read_table(path, limit)
    return read_columns(path, limit, look)


def _grid_of_cloud(table: Table, file: str) -> RangeGrid:
    sizes = dict(table.header["pairs"])
    columns = table.columns
    rows, cols = int(sizes.get("height", 1)), int(sizes.get("width", len(columns.get("x", ()))))
    missing = [axis for axis in _AXES if axis not in columns or columns[axis].ndim != 1]
    if missing:
        raise FormatError(f"a cloud has x, y and z; {', '.join(missing)} not found", file=file)
    with np.errstate(invalid="ignore"):  # signalling NaN
        points = np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)
    if rows < 2 or cols < 2 or rows * cols != len(points):
        raise FormatError(
            "expected an organised cloud, whose points are the pixels of an image (HEIGHT of 2 or "
            f"more, an array of shape (H, W, 3)), got WIDTH {cols} and HEIGHT {rows} for "
            f"{len(points)} points",
            file=file,
        )
    infinite = np.isinf(points).all(axis=1)
    valid = np.asarray(~np.isnan(points).any(axis=1) & points.any(axis=1) & ~infinite)
    points[~valid] = 0.0
    measured_points(points, ScanFormat("pcd"), file)  # raises on infinite coordinates
    points[~valid] = np.nan
    color = _colors(table, valid)
    return RangeGrid(
        points.reshape(rows, cols, 3),
        valid.reshape(rows, cols),
        None if color is None else color.reshape(rows, cols, 3),
    )


def _colors(table: Table, valid: NDArray[np.bool_]) -> NDArray[np.uint8] | None:
    """Return red, green and blue of each point; None if the cloud has no colours."""
    unnamed = table.header.get("unnamed", ())
    columns = {
        name: values
        for name, values in table.columns.items()
        if name not in _AXES and name not in unnamed
    }
    if unnamed and find_colors(columns) is None:
        columns = _columns_of_plain([table.columns[name] for name in unnamed], valid)
    for name, values in columns.items():
        if values.dtype.kind == "f" and not is_packed(name, values):  # NaN where nothing was seen
            use = np.isfinite(values) | valid.reshape(-1, *[1] * (values.ndim - 1))
            columns[name] = np.where(use, values, values.dtype.type(0))
    found = find_colors(columns)
    return None if found is None else with_8_bits(found[1])


_OPAQUE = 0xFF
_NAN, _MINUS_INFINITY = 0xFFC00000, 0xFF800000
"""Bits of the NaN that processors compute, and of the infinity below zero."""


def _columns_of_plain(
    rest: list[NDArray[Any]], valid: NDArray[np.bool_]
) -> dict[str, NDArray[Any]]:
    """Return the columns of an array (H, W, C) behind x, y and z that may be colours, by names.

    Three columns are colours unless they are normals, also before an opaque alpha. Behind another
    column, such as an intensity, they are if two of them have numbers from 128 to 255: lasers and
    returns are counted in smaller ones. A single one of floats is an intensity unless its bits are
    those of packed colours: with alpha, no number that a sensor measures has them.
    """
    if len(rest) == 4:
        last = np.column_stack(rest[1:])[valid]
        if len(last) and last[0, 2] in (1, _OPAQUE) and (last[:, 2] == last[0, 2]).all():
            return _columns_of_plain(rest[:3], valid)
        may_be = len(last) > 0 and np.count_nonzero(last.max(axis=0) > _OPAQUE // 2) > 1
        return dict(zip("rgb", rest[1:], strict=True)) if may_be else {}
    if len(rest) == 3:
        values = np.column_stack(rest)[valid].astype(np.float64)
        values = values[values.any(axis=1)]  # zeros are black, and no normals
        if not len(values) or not np.isfinite(values).all():
            return {}
        if np.allclose(np.linalg.norm(values, axis=1), 1.0, atol=1e-3):
            return {}
        # Whole numbers above 255 may be anything, so that only fractions take the longer names.
        are_shares = rest[0].dtype.kind == "f" and values.max(initial=0.0) <= 1.0
        names = ("red", "green", "blue") if are_shares else ("r", "g", "b")
        return dict(zip(names, rest, strict=True))
    if len(rest) != 1 or rest[0].dtype != np.float32:
        return {}
    bits = np.ascontiguousarray(rest[0]).view(np.uint32)
    alpha = bits[valid] >> 24
    if (alpha == _OPAQUE).all() and not np.isin(bits[valid], (_NAN, _MINUS_INFINITY)).all():
        # ZED's XYZRGBA: red is the first byte, where PCL's has blue.
        return {"rgba": (bits & 0xFF) << 16 | (bits & 0xFF00) | (bits >> 16 & 0xFF)}
    return {"rgb": rest[0]} if bits[valid].any() and not alpha.any() else {}
