"""Mesh files and range grids: reading, writing, where textures lie."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError
from manip3d.io import _collada, _three_mf
from manip3d.io._draco import decode_draco
from manip3d.io._elsewhere import mesh_advice, scan_advice
from manip3d.io._files import open_regular, refuse_pointer, regular_bytes
from manip3d.io._images import texture_path, with_common_images
from manip3d.io._limits import byte_limit, check_points, clock
from manip3d.io._remote import is_url, local_copy, local_output
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    pass

READABLE: tuple[str, ...] = (*_core.readable_suffixes(), _three_mf.SUFFIX, _collada.SUFFIX)
"""Suffixes that `read_mesh` knows; each but ``.3mf`` and ``.dae`` may be followed by ``.gz`` or
``.xz``."""
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


def _report(result: tuple[Mesh, str, int, int, list[str]], source: str | None) -> ReadReport:
    mesh, kind, num_polygons, num_skipped, warnings = result
    check_points(mesh.num_vertices, source or "")
    mesh.source = source
    for text in warnings:
        _logger.warning("%s: %s", source or "bytes", text)
    return ReadReport(mesh, kind, num_polygons, num_skipped, tuple(warnings))


@checked
def read_report(
    path: str | os.PathLike[str], *, allow_outside: bool = False, max_bytes: int | None = None
) -> ReadReport:
    r"""Read a mesh file and tell what was seen; see `read_mesh`.

    Parameters
    ----------
    path, allow_outside, max_bytes
        As for `read_mesh`.

    Returns
    -------
    ReadReport
        The mesh, and what was left out of it.

    Raises
    ------
    FormatError, OSError
        As `read_mesh`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import io
    >>> text = "mtllib none.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    >>> written = Path("a.obj").write_text(text)
    >>> len(io.read_report("a.obj").warnings)
    1
    """
    limit = byte_limit(max_bytes)
    with clock(os.fspath(path)) as look, local_copy(path, max_bytes=limit or None) as local:
        refuse_pointer(local)
        if local.suffix.lower() == _three_mf.SUFFIX:
            found = _read_three_mf(_limited(local, limit), os.fspath(path), limit, look)
        elif local.suffix.lower() == _collada.SUFFIX:
            data, place = _limited(local, limit), (os.fspath(path), local.parent, allow_outside)
            found = _read_collada(data, *place, limit, look)
        else:
            found = _read_by_core(local, allow_outside, limit, look)
        report = _report(found, os.fspath(path))
        if is_url(path):
            _take_textures(report.mesh, local)
    return report


_Found = tuple[Mesh, str, int, int, list[str]]
_Look = Callable[[float], None] | None


def _read_by_core(local: Path, allow_outside: bool, limit: int, look: _Look) -> _Found:
    try:
        return _core.read_mesh(os.fsencode(local), bool(allow_outside), limit, decode_draco, look)
    except FormatError as error:
        if not error.reason.startswith("unknown mesh format") or error.line is not None:
            raise
        if (advice := scan_advice(local)) is not None:
            raise FormatError(advice, file=error.file) from None
        reason = f"unknown mesh format; manip3d reads {' '.join(READABLE)}{mesh_advice(local)}"
        raise FormatError(reason, file=error.file) from None


def _limited(path: Path, limit: int) -> bytes:
    with open_regular(path) as file:
        data = file.read(limit + 1) if limit else file.read()
    if limit and len(data) > limit:
        raise FormatError(f"more than max_bytes = {limit}", file=str(path))
    return data


def _read_three_mf(data: bytes, file: str, limit: int, look: _Look) -> _Found:
    try:
        mesh, warnings = _three_mf.read(data, limit, look)
    except FormatError as error:
        raise FormatError(error.reason, file=error.file or file, line=error.line) from error
    return mesh, "3mf", mesh.num_faces, 0, warnings


def _read_collada(
    data: bytes, file: str, folder: Path | None, allow_outside: bool, limit: int, look: _Look
) -> _Found:
    try:
        mesh, num_polygons, warnings = _collada.read(
            data, folder, limit, look, allow_outside=allow_outside
        )
    except FormatError as error:
        raise FormatError(error.reason, file=error.file or file, line=error.line) from error
    return mesh, "dae", num_polygons, 0, warnings


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
    """Read a mesh file: one of `READABLE`, most of them also followed by ``.gz`` or ``.xz``.

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
        valid. ``source`` is ``path``: `texture_path` finds relative textures beside it. 3MF
        gives all items that are to be built and COLLADA all geometries of its scene, at their
        places; units and axes stay those of the file.

    Raises
    ------
    FormatError
        The file is damaged or hostile; names the file and the line or byte.
    MissingExtraError
        A glTF is compressed with Draco and DracoPy is not installed (extra ``draco``).
    OSError
        `FileNotFoundError` and the like.

    Notes
    -----
    What is left out (a missing material library, a texture outside of the folder) goes to the
    logger ``manip3d``; `read_report` returns it.

    Examples
    --------
    >>> from manip3d import io, simulate
    >>> simulate.models.floor(columns=2, rows=1).write("floor.ply")
    >>> io.read_mesh("floor.ply").num_faces
    4
    """
    return read_report(path, allow_outside=allow_outside, max_bytes=max_bytes).mesh


@checked
def read_mesh_bytes(
    data: bytes, format: str | None = None, *, max_bytes: int | None = None
) -> Mesh:
    r"""Read a mesh from memory, compressed or not.

    Parameters
    ----------
    data : bytes
        Content of a mesh file.
    format : str, optional
        One of `READABLE`, with or without its dot; without it the content decides.
    max_bytes : int, optional
        As for `read_mesh`.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        Unknown ``format``.
    FormatError
        As `read_mesh`, without a file name.

    Examples
    --------
    >>> from manip3d import io
    >>> text = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    >>> io.read_mesh_bytes(text, "obj").num_faces
    1
    """
    suffix = "" if format is None else "." + format.lower().lstrip(".")
    if suffix and suffix not in READABLE:
        raise InputError(f"format: expected one of {', '.join(READABLE)}, got {format!r}")
    with clock("") as look:
        if suffix == _three_mf.SUFFIX or (not suffix and data.startswith(_three_mf.START)):
            limit = byte_limit(max_bytes)
            return _report(_read_three_mf(bytes(data), "", limit, look), None).mesh
        if suffix == _collada.SUFFIX or (not suffix and b"<COLLADA" in data[:4096]):
            limit = byte_limit(max_bytes)
            return _report(_read_collada(bytes(data), "", None, False, limit, look), None).mesh
        found = _core.read_mesh_bytes(
            bytes(data), suffix, byte_limit(max_bytes), decode_draco, look
        )
    return _report(found, None).mesh


@checked
def write_mesh(
    mesh: Mesh,
    path: str | os.PathLike[str],
    *,
    max_vertices: int | None = None,
    quantize: bool = False,
) -> None:
    """Write a mesh file: one of `WRITABLE`, alone or followed by ``.gz`` or ``.xz``.

    Parameters
    ----------
    mesh : Mesh
    path : path-like
        glTF takes PNG and JPEG images only: others (TGA, BMP, ...) are converted to PNG.
    max_vertices : int, optional
        glTF: a primitive with more vertices than this is split. With 65535 every index fits in 16
        bits (65535 itself is not an index).
    quantize : bool
        glTF: positions and texture coordinates within the picture in 16 bits, normals in 8
        (``KHR_mesh_quantization``, which readers must know): 8 bytes instead of 12 for a position,
        4 instead of 8 for a texture coordinate, 4 instead of 12 for a normal. A position moves by
        at most 1.4e-5 of the longest side of the mesh's box.

    Raises
    ------
    InputError
        Unknown suffix; the mesh is not valid; ``max_vertices`` is below 3; ``max_vertices`` or
        ``quantize`` is given and the format is not glTF.
    MissingExtraError
        An image must be converted and Pillow is not installed (extra ``io``).
    OSError
        The operating system refused; the old file is whole.

    Notes
    -----
    The file appears whole or not at all: it is written under a temporary name, synced and renamed.
    Textures and the OBJ material library are put beside it first, under names that do not change
    what an existing file of that folder refers to. Positions read back as the same doubles; STL
    rounds them to 32 bits, PLY rounds texture coordinates (MeshLab's convention).

    What the format cannot hold goes to the logger ``manip3d``.

    Examples
    --------
    >>> from manip3d import io, simulate
    >>> io.write_mesh(simulate.models.floor(columns=2, rows=1), "floor.obj")
    >>> io.read_mesh("floor.obj").num_faces
    4
    """
    if _is_gltf(path):
        write_gltf([mesh], path, [], max_vertices, quantize)
    else:
        _write([mesh], path, [], max_vertices, quantize)


def write_gltf(
    levels: Sequence[Mesh],
    path: str | os.PathLike[str],
    coverages: Sequence[float],
    max_vertices: int | None,
    quantize: bool,
) -> None:
    """Write a glTF file with the levels of detail of a mesh; see `write_lods`."""
    _write([with_common_images(levels[0]), *levels[1:]], path, coverages, max_vertices, quantize)


def _is_gltf(path: str | os.PathLike[str]) -> bool:
    name = os.fspath(path_of(path)).lower().removesuffix(".gz").removesuffix(".xz")
    return name.endswith((".glb", ".gltf"))


def _write(
    levels: Sequence[Mesh],
    path: str | os.PathLike[str],
    coverages: Sequence[float],
    max_vertices: int | None,
    quantize: bool,
) -> None:
    finest = levels[0]
    inside = finest.source is None or is_url(finest.source)
    folder = "" if inside else str(Path(str(finest.source)).parent)
    with local_output(path) as local:
        warnings = _core.write_mesh(
            finest,
            os.fsencode(local),
            os.fsencode(folder),
            0 if max_vertices is None else max_vertices,
            quantize,
            list(levels[1:]),
            list(coverages),
        )
        for text in warnings:
            _logger.warning("%s: %s", os.fspath(path), text)
