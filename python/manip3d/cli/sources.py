"""Opening of the meshes and scenes that the user names: a file, or ``-`` for stdin."""

from __future__ import annotations

import io
import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from manip3d._util.regular_files import over_max_bytes
from manip3d.cli.terminal import Terminal, count, counted
from manip3d.errors import FormatError, InputError
from manip3d.io import Scene, read_mesh, read_report, read_scene
from manip3d.io._limits import byte_limit, clock
from manip3d.io._mesh_files import mesh_of_bytes
from manip3d.io._scenes import scene_of_bytes
from manip3d.mesh import Mesh

_STDIN = "standard input"
_CHUNK = 1 << 20  # bytes
_LOOK_S = 0.1  # between two checks of the time limit


def open_mesh(source: str, terminal: Terminal, *, may_be_empty: bool = False) -> Mesh:
    """Read a mesh from a file or, for ``-``, from stdin, and print its counts.

    Parameters
    ----------
    source : str
        The file, or ``-``.
    terminal : Terminal
        Prints the messages.
    may_be_empty : bool
        Whether a mesh without faces causes a warning instead of an error.

    Raises
    ------
    FormatError, OSError
        See `manip3d.read_mesh`.
    InputError
        The mesh has no faces, and ``may_be_empty`` is False.
    """
    with _stdin(source) as data:
        return _open_mesh(source, data, terminal, may_be_empty)


@contextmanager
def _stdin(source: str) -> Iterator[bytes | None]:
    """Yield the content of stdin if the source is ``-``, else None.

    The limits in force hold for reading and for the block together, whose errors name stdin.
    """
    if source != "-":
        yield None
        return
    with clock(_STDIN) as look:
        data = _content_of_stdin(byte_limit(None), look)
        if not data:
            raise FormatError("expected a mesh, got nothing", file=_STDIN)
        try:
            yield data
        except FormatError as error:
            if error.file:
                raise
            raise FormatError(
                error.reason, file=_STDIN, line=error.line, byte_offset=error.byte_offset
            ) from error


def _content_of_stdin(limit: int, look: Callable[[float], None] | None) -> bytes:
    """Read stdin in chunks, and refuse more than ``limit`` bytes (0: no limit), as files are."""
    descriptor = sys.stdin.fileno()
    content = io.BytesIO()
    while True:
        if look is not None:
            look(0.0)
        wait_s = None if look is None else _LOOK_S
        if not select.select([descriptor], [], [], wait_s)[0]:
            continue
        chunk = os.read(descriptor, _CHUNK)
        if not chunk:
            return content.getvalue()
        content.write(chunk)
        if limit and content.tell() > limit:
            raise FormatError(over_max_bytes(limit), file=_STDIN)


def _open_mesh(source: str, data: bytes | None, terminal: Terminal, may_be_empty: bool) -> Mesh:
    """Read a mesh from the content of stdin, or without it from a file, and print its counts."""
    if data is not None:
        mesh, kind = _mesh_from_stdin(data), "stdin"
    else:
        report = read_report(source)
        mesh, kind = report.mesh, mesh_suffix(Path(source)).lstrip(".") or report.format
    if mesh.num_faces == 0 and not may_be_empty:
        raise InputError(f"{source}: expected a mesh with faces, got none")
    terminal.say(
        f"read {source} ({kind}): {counted(mesh.num_vertices, 'vertex', 'vertices')}, "
        f"{counted(mesh.num_faces, 'face')}"
    )
    if mesh.num_faces == 0:
        terminal.say(f"warning: {source} has no faces")
    return mesh


def _mesh_from_stdin(data: bytes) -> Mesh:
    return mesh_of_bytes(data, "", byte_limit(None), _STDIN)


GLTF_SUFFIXES = (".glb", ".gltf")


def open_scene_or_mesh(source: str, output: Path, terminal: Terminal) -> Scene | Mesh:
    """Read a glTF file as a scene if the output is glTF, too, and else a mesh.

    Parameters
    ----------
    source : str
        The file, or ``-`` for stdin.
    output : Path
        The output; a name without a suffix is that of a folder of ``.glb`` files.
    terminal : Terminal
        Prints the messages.

    Returns
    -------
    Scene or Mesh
        A mesh if input or output have another format, if the file cannot be read as a scene, or if
        none of its drawn meshes can be simplified (`Scene.fixed`).

    Raises
    ------
    FormatError, InputError, OSError
        See `open_mesh`.
    """
    with _stdin(source) as data:
        scene = _open_scene(source, data, output, terminal)
        return _open_mesh(source, data, terminal, may_be_empty=False) if scene is None else scene


def _open_scene(source: str, data: bytes | None, output: Path, terminal: Terminal) -> Scene | None:
    """Read a scene from the content of stdin, or without it from a file, and print its counts."""
    if (mesh_suffix(output) or ".glb") not in GLTF_SUFFIXES:
        return None
    if data is None and mesh_suffix(Path(source)) not in GLTF_SUFFIXES:
        return None
    try:
        scene = read_scene(source) if data is None else scene_of_bytes(data, _STDIN)
    except FormatError as error:
        # If the triangles are damaged, too, this raises a single error.
        read_mesh(source) if data is None else _mesh_from_stdin(data)
        terminal.say(f"warning: nodes are not kept: {error}")
        return None
    if scene is None or scene.num_instances == 0:
        return None
    uses = scene.num_uses
    reasons = [reason for reason, n in zip(scene.fixed, uses, strict=True) if n > 0]
    if all(reasons):
        listed = ", ".join(sorted(set(reasons)))
        terminal.say(f"warning: nodes are not kept, all becomes one mesh: {listed}")
        return None
    terminal.say(
        f"read {source} ({mesh_suffix(Path(source)).lstrip('.') or 'stdin'}): "
        f"{counted(len(scene.nodes), 'node')}, "
        f"{counted(len(scene.meshes), 'mesh', 'meshes')} "
        f"shown {counted(scene.num_instances, 'time')}, "
        f"{counted(scene.num_faces, 'face')} drawn, {count(scene.num_stored_faces)} stored"
    )
    for name, reason, n in zip(scene.names, scene.fixed, uses, strict=True):
        if reason and n > 0:
            terminal.say(f"warning: mesh '{name}' stays as it is: {reason}")
    return scene


def gone_materials(before: Sequence[Mesh], after: Sequence[Mesh], terminal: Terminal) -> list[str]:
    """Return and print the names of materials that had faces and have none any more.

    Parameters
    ----------
    before, after : sequence of Mesh
        The meshes of a scene, or a single one, before and after simplification.
    terminal : Terminal
        Prints the message.

    Returns
    -------
    list of str
        Names, or numbers of materials without a name.
    """
    gone = sorted(_shown_materials(before) - _shown_materials(after))
    if gone:
        names = ", ".join(gone[:5]) + (", ..." if len(gone) > 5 else "")
        terminal.say(f"warning: nothing is left of {counted(len(gone), 'material')} ({names})")
    return gone


def _shown_materials(meshes: Sequence[Mesh]) -> set[str]:
    shown: set[str] = set()
    for mesh in meshes:
        of_faces = mesh.face_material
        for i in np.unique(of_faces[of_faces >= 0]) if of_faces is not None else ():
            name = mesh.materials[i].name if i < len(mesh.materials) else ""
            shown.add(name or str(i))
    return shown


def tell_scene(before: Scene, after: Scene, terminal: Terminal) -> None:
    """Print how the faces of a scene have changed, and which meshes have none left."""
    if before.num_faces != before.num_stored_faces:  # otherwise the message on the run states this
        terminal.say(
            f"faces drawn: {count(before.num_faces)} -> {count(after.num_faces)}, stored: "
            f"{count(before.num_stored_faces)} -> {count(after.num_stored_faces)}"
        )
    gone = [
        name or str(i)
        for i, (name, mesh, old) in enumerate(
            zip(after.names, after.meshes, before.meshes, strict=True)
        )
        if mesh.num_faces == 0 and old.num_faces > 0
    ]
    if gone:
        names = ", ".join(gone[:5]) + (", ..." if len(gone) > 5 else "")
        terminal.say(
            f"nothing is left of {counted(len(gone), 'mesh', 'meshes')} ({names}); nodes stay"
        )


def mesh_suffix(path: Path) -> str:
    """Return the suffix of the format, ``.obj`` for ``head.obj.xz``."""
    name = path.name.lower().removesuffix(".xz").removesuffix(".gz")
    return Path(name).suffix
