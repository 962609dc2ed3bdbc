"""Mesh files and range grids: reading, writing, where textures lie."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import InputError
from manip3d.io._files import regular_bytes
from manip3d.io._remote import is_url, local_copy, local_output
from manip3d.mesh import Mesh, Texture

if TYPE_CHECKING:
    from numpy.typing import NDArray

READABLE: tuple[str, ...] = tuple(_core.readable_suffixes())
"""Suffixes that `read_mesh` knows; each may be followed by ``.gz`` or ``.xz``."""
WRITABLE: tuple[str, ...] = tuple(_core.writable_suffixes())
"""Suffixes that `write_mesh` knows; each may be followed by ``.gz`` or ``.xz``."""

_logger = logging.getLogger("manip3d")


@dataclass(frozen=True)
class ReadReport:
    """A mesh and what its reader saw.

    Attributes
    ----------
    mesh : Mesh
    format : str
        ``obj``, ``ply``, ...
    num_polygons : int
        Before they were cut into triangles.
    num_skipped : int
        Statements, elements and properties that were not understood.
    warnings : tuple of str
        What was left out.
    """

    mesh: Mesh
    format: str
    num_polygons: int
    num_skipped: int
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class RangeGrid:
    """A range image: one point per pixel, or none.

    Attributes
    ----------
    points : (H, W, 3) float64
        In the file's own units and axes; NaN where nothing was measured.
    valid : (H, W) bool
    """

    points: NDArray[np.float64]
    valid: NDArray[np.bool_]


def _limit(max_bytes: int | None) -> int:
    if max_bytes is None:
        return 0
    if not max_bytes > 0:
        raise InputError(f"max_bytes: expected > 0, got {max_bytes}")
    return int(max_bytes)


def _report(result: tuple[Mesh, str, int, int, list[str]], source: str | None) -> ReadReport:
    mesh, kind, num_polygons, num_skipped, warnings = result
    mesh.source = source
    for text in warnings:
        _logger.warning("%s: %s", source or "bytes", text)
    return ReadReport(mesh, kind, num_polygons, num_skipped, tuple(warnings))


@checked
def read_report(
    path: str | os.PathLike[str], *, allow_outside: bool = False, max_bytes: int | None = None
) -> ReadReport:
    """Read a mesh file and tell what was seen; see `read_mesh`."""
    with local_copy(path, max_bytes=max_bytes) as local:
        found = _core.read_mesh(os.fsencode(local), bool(allow_outside), _limit(max_bytes))
        report = _report(found, os.fspath(path))
        if is_url(path):
            _take_textures(report.mesh, local)
    return report


def _take_textures(mesh: Mesh, local: Path) -> None:
    """Put the textures beside the copy of a remote file into the mesh, before the copy goes."""
    beside = mesh.replace(source=os.fspath(local))
    for material in mesh.materials:
        for role, texture in material.textures.items():
            path = texture_path(beside, texture) if texture.data is None else None
            if path is not None:
                material.textures[role] = replace(texture, data=regular_bytes(path))


@checked
def read_mesh(
    path: str | os.PathLike[str], *, allow_outside: bool = False, max_bytes: int | None = None
) -> Mesh:
    """Read a mesh file: one of `READABLE`, alone or followed by ``.gz`` or ``.xz``.

    Parameters
    ----------
    path : path-like or URL
        The format is what the suffix says, else what the content shows.
    allow_outside : bool
        Let an OBJ or glTF file name materials and textures outside of its own folder.
    max_bytes : int, optional
        The most uncompressed bytes to read. Without it compressed files are refused past 64 MiB
        where they expand more than 200 times. glTF, whose nodes can name one mesh many times,
        may take 64 MiB of memory or 100 times its size on disk, whichever is more.

    Returns
    -------
    Mesh
        Triangles; polygons of n corners are cut into n - 2 without new vertices. A range scan
        (PLY ``range_grid``) gives two triangles per full 2x2 cell of pixels, one where three are
        valid. ``source`` is ``path``: `texture_path` finds relative textures beside it.

    Raises
    ------
    FormatError
        The file is damaged or hostile; names the file and the line or byte.
    OSError
        `FileNotFoundError` and the like.

    Notes
    -----
    What is left out (a missing material library, a texture outside of the folder) goes to the
    logger ``manip3d``; `read_report` returns it.
    """
    return read_report(path, allow_outside=allow_outside, max_bytes=max_bytes).mesh


@checked
def read_mesh_bytes(
    data: bytes, format: str | None = None, *, max_bytes: int | None = None
) -> Mesh:
    """Read a mesh from memory, compressed or not.

    Parameters
    ----------
    data : bytes
        Content of a mesh file.
    format : str, optional
        One of `READABLE`, with or without its dot; without it the content decides.
    max_bytes : int, optional
        As for `read_mesh`.

    Raises
    ------
    InputError
        Unknown ``format``.
    FormatError
        As `read_mesh`, without a file name.
    """
    suffix = "" if format is None else "." + format.lower().lstrip(".")
    if suffix and suffix not in READABLE:
        raise InputError(f"format: expected one of {', '.join(READABLE)}, got {format!r}")
    return _report(_core.read_mesh_bytes(bytes(data), suffix, _limit(max_bytes)), None).mesh


@checked
def write_mesh(mesh: Mesh, path: str | os.PathLike[str]) -> None:
    """Write a mesh file: one of `WRITABLE`, alone or followed by ``.gz`` or ``.xz``.

    The file appears whole or not at all: it is written under a temporary name, synced and renamed.
    Textures and the OBJ material library are put beside it first, under names that do not change
    what an existing file of that folder refers to. Positions read back as the same doubles; STL
    rounds them to 32 bits, PLY rounds texture coordinates (MeshLab's convention).

    Raises
    ------
    InputError
        Unknown suffix, or the mesh is not valid.
    OSError
        The operating system refused; the old file is whole.

    Notes
    -----
    What the format cannot hold goes to the logger ``manip3d``.
    """
    inside = mesh.source is None or is_url(mesh.source)
    folder = "" if inside else str(Path(str(mesh.source)).parent)
    with local_output(path) as local:
        for text in _core.write_mesh(mesh, os.fsencode(local), os.fsencode(folder)):
            _logger.warning("%s: %s", os.fspath(path), text)


@checked
def texture_path(mesh: Mesh, texture: Texture) -> Path | None:
    """Where the image of a texture lies.

    A relative path starts in the folder of ``mesh.source`` and never leaves it, not even through
    symbolic links; an absolute one is taken as it is (files cannot bring one in, unless read with
    ``allow_outside=True``).

    Returns
    -------
    Path or None
        ``None`` when the texture has no path, or there is no such file.

    Raises
    ------
    InputError
        A relative path leads out of the folder.
    """
    if texture.path is None:
        return None
    path = path_of(texture.path, "texture.path")
    if not path.is_absolute():
        if mesh.source is None or is_url(mesh.source):
            return None
        folder = Path(mesh.source).parent
        inside = _core.resolve_inside(os.fsencode(folder), os.fsencode(texture.path))
        path = Path(os.fsdecode(inside))
    return path if path.is_file() else None


@checked
def read_range_grid(path: str | os.PathLike[str], *, max_bytes: int | None = None) -> RangeGrid:
    """Read the pixels of a range scan (PLY with a ``range_grid``, as Stanford's single scans).

    Raises
    ------
    FormatError
        As `read_mesh`, and when the file holds no range grid.
    OSError
        `FileNotFoundError` and the like.
    """
    with local_copy(path, max_bytes=max_bytes) as local:
        rows, cols, vertex, vertices = _core.read_range_grid(os.fsencode(local), _limit(max_bytes))
    valid = vertex >= 0
    points = np.full((rows * cols, 3), np.nan)
    points[valid] = vertices[vertex[valid]]
    return RangeGrid(points.reshape(rows, cols, 3), valid.reshape(rows, cols))
