"""Reading and writing of mesh files."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError
from manip3d.io import _collada, _three_mf
from manip3d.io._draco import decode_draco
from manip3d.io._elsewhere import mesh_advice, scan_advice
from manip3d.io._files import bytes_below, refuse_pointer, regular_bytes
from manip3d.io._images import texture_path, with_common_images
from manip3d.io._limits import byte_limit, check_points, clock
from manip3d.io._remote import is_url, local_copy, local_output
from manip3d.mesh import Mesh

READABLE: tuple[str, ...] = (*_core.readable_suffixes(), _three_mf.SUFFIX, _collada.SUFFIX)
"""Suffixes of the formats that `read_mesh` reads; all except ``.3mf`` and ``.dae`` may be followed
by ``.gz`` or ``.xz``."""
WRITABLE: tuple[str, ...] = tuple(_core.writable_suffixes())
"""Suffixes of the formats that `write_mesh` writes; each may be followed by ``.gz`` or ``.xz``."""

_logger = logging.getLogger("manip3d")


@dataclass(frozen=True)
class ReadReport:
    """A mesh, with counts and warnings of its reader.

    Attributes
    ----------
    mesh : Mesh
        The mesh.
    format : str
        Format of the file: ``obj``, ``ply``, ...
    num_polygons : int
        Number of polygons before triangulation.
    num_skipped : int
        Number of unknown statements, elements and properties.
    warnings : tuple of str
        Parts of the file that were left out.
    """

    mesh: Mesh
    format: str
    num_polygons: int
    num_skipped: int
    warnings: tuple[str, ...]

    __repr__ = short_repr


def _report(
    result: tuple[Mesh, str, int, int, list[str]], source: str | None, name: str = "bytes"
) -> ReadReport:
    mesh, kind, num_polygons, num_skipped, warnings = result
    check_points(mesh.num_vertices, source or "")
    mesh.source = source
    for text in warnings:
        _logger.warning("%s: %s", source or name, text)
    return ReadReport(mesh, kind, num_polygons, num_skipped, tuple(warnings))


@checked
def read_report(
    path: str | os.PathLike[str], *, allow_outside: bool = False, max_bytes: int | None = None
) -> ReadReport:
    r"""Read a mesh file, and report what was skipped or left out; see `read_mesh`.

    Parameters
    ----------
    path, allow_outside, max_bytes
        See `read_mesh`.

    Returns
    -------
    ReadReport
        The mesh, with counts and warnings.

    Raises
    ------
    FormatError, OSError
        See `read_mesh`.

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
            found = _read_three_mf(bytes_below(local, limit), os.fspath(path), limit, look)
        elif local.suffix.lower() == _collada.SUFFIX:
            data, place = bytes_below(local, limit), (os.fspath(path), local.parent, allow_outside)
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
    """Load the textures beside the temporary copy of a remote file into the mesh."""
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
        The file. Its suffix determines the format; an unknown suffix, the content.
    allow_outside : bool
        Whether the file may name materials and textures outside of its own folder.
    max_bytes : int, optional
        Largest number of uncompressed bytes to read. Default: a compressed file may have 64 MiB or
        expand 200 times, whichever is more; a glTF, whose nodes can instance a mesh many times, may
        take 64 MiB of memory or 100 times its size on disk, whichever is more.

    Returns
    -------
    Mesh
        A triangle mesh. A polygon of n corners becomes n - 2 triangles without new vertices. A
        range scan (PLY ``range_grid``) has two triangles per 2x2 cell of valid pixels, and one if
        three of the four are valid. A 3MF file yields all items of its build, a COLLADA file all
        geometries of its scene, transformed; units and axes are those of the file. ``source`` is
        ``path``, from which `texture_path` resolves relative paths.

    Raises
    ------
    FormatError
        The file is damaged or hostile; the error names the file and the line or byte.
    MissingExtraError
        A glTF is compressed with Draco and DracoPy is not installed (extra ``draco``).
    OSError
        The file cannot be read.

    Notes
    -----
    Warnings about parts that are left out (a missing material library, a texture outside of the
    folder) go to the logger ``manip3d``; `read_report` returns them.

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
        One of `READABLE`, with or without its dot; default: recognised by the content.
    max_bytes : int, optional
        See `read_mesh`.

    Returns
    -------
    Mesh
        The mesh, see `read_mesh`; its ``source`` is None.

    Raises
    ------
    InputError
        ``format`` is unknown.
    FormatError
        The data is damaged or hostile; the error names no file.

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
    return mesh_of_bytes(bytes(data), suffix, byte_limit(max_bytes), "bytes")


def mesh_of_bytes(data: bytes, suffix: str, limit: int, name: str) -> Mesh:
    """Read a mesh from memory; ``name`` begins its warnings, and suffix "" means any format."""
    with clock("") as look:
        if suffix == _three_mf.SUFFIX or (not suffix and data.startswith(_three_mf.START)):
            found = _read_three_mf(data, "", limit, look)
        elif suffix == _collada.SUFFIX or (not suffix and b"<COLLADA" in data[:4096]):
            found = _read_collada(data, "", None, False, limit, look)
        else:
            found = _core.read_mesh_bytes(data, suffix, limit, decode_draco, look)
    return _report(found, None, name).mesh


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
        The mesh to write.
    path : path-like
        Output file. glTF allows only PNG and JPEG images; others (TGA, BMP, ...) are converted to
        PNG.
    max_vertices : int, optional
        glTF only: a primitive with more vertices than this is split. With 65535 every index fits in
        16 bits (65535 itself is not a valid index).
    quantize : bool
        glTF only: store positions, and texture coordinates within [0, 1], in 16 bits and normals in
        8 bits (``KHR_mesh_quantization``, which readers must support). A position takes 8 instead
        of 12 bytes, a texture coordinate 4 instead of 8, a normal 4 instead of 12. A position
        changes by at most 2.7e-5 of the longest side of the mesh's bounding box. The step is a
        power of two: positions at the border of two tiles stay equal if it is the same for both,
        which holds if their longest sides are about equal.

    Raises
    ------
    InputError
        The suffix is unknown; the mesh is not valid; ``max_vertices`` is below 3; ``max_vertices``
        or ``quantize`` is given and the format is not glTF.
    MissingExtraError
        An image must be converted and Pillow is not installed (extra ``io``).
    OSError
        The file cannot be written; an existing file stays unchanged.

    Notes
    -----
    The file is written atomically: under a temporary name, synced and renamed. Textures and the OBJ
    material library are written to its folder before, under names that do not change the files to
    which other files of that folder refer, not even if another process writes there at the same
    time; at a URL, all these names have a hash of the content. Positions are read back as the same
    doubles, except that STL rounds them to 32 bits; PLY rounds texture coordinates to 32 bits
    (MeshLab's convention).

    Warnings about properties that the format cannot hold go to the logger ``manip3d``.

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
            is_url(path),
        )
        for text in warnings:
            _logger.warning("%s: %s", os.fspath(path), text)
