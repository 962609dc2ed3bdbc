"""Opening of the meshes and scenes that the user names: a file, or ``-`` for stdin."""

from __future__ import annotations

import io
import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
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
        terminal.warn(f"{source} has no faces")
    return mesh


def _mesh_from_stdin(data: bytes) -> Mesh:
    return mesh_of_bytes(data, "", byte_limit(None), _STDIN)


GLTF_SUFFIXES = (".glb", ".gltf")


@dataclass(frozen=True)
class Opened:
    """A scene or a mesh that was read.

    Attributes
    ----------
    thing : Scene or Mesh
        The scene or mesh.
    nodes_lost : str
        Reason why the nodes of a glTF file are not kept in an output that could hold them; empty if
        they are, or if there are none.
    """

    thing: Scene | Mesh
    nodes_lost: str = ""


def open_scene_or_mesh(source: str, output: Path, terminal: Terminal) -> Opened:
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
    Opened
        With a mesh if input or output have another format, if the file cannot be read as a scene,
        or if none of its drawn meshes can be simplified (`Scene.fixed`).

    Raises
    ------
    FormatError, InputError, OSError
        See `open_mesh`.
    """
    with _stdin(source) as data:
        scene = _open_scene(source, data, output, terminal)
        if isinstance(scene, Scene):
            return Opened(scene)
        return Opened(_open_mesh(source, data, terminal, may_be_empty=False), nodes_lost=scene)


def _open_scene(source: str, data: bytes | None, output: Path, terminal: Terminal) -> Scene | str:
    """Read a scene from the content of stdin, or without it from a file, and print its counts.

    Otherwise return why the nodes of a scene are lost; empty if there are none to keep.
    """
    if (mesh_suffix(output) or ".glb") not in GLTF_SUFFIXES:
        return ""
    if data is None and mesh_suffix(Path(source)) not in GLTF_SUFFIXES:
        return ""
    try:
        scene = read_scene(source) if data is None else scene_of_bytes(data, _STDIN)
    except FormatError as error:
        # If the triangles are damaged, too, this raises a single error.
        read_mesh(source) if data is None else _mesh_from_stdin(data)
        terminal.warn(f"nodes are not kept: {error}")
        return str(error)
    if scene is None or scene.num_instances == 0:
        return ""
    reasons = [reason for reason, n in zip(scene.fixed, scene.num_uses, strict=True) if n > 0]
    if all(reasons):
        listed = ", ".join(sorted(set(reasons)))
        terminal.warn(f"nodes are not kept, all becomes one mesh: {listed}")
        return listed
    terminal.say(
        f"read {source} ({mesh_suffix(Path(source)).lstrip('.') or 'stdin'}): "
        f"{counted(len(scene.nodes), 'node')}, "
        f"{counted(len(scene.meshes), 'mesh', 'meshes')} "
        f"shown {counted(scene.num_instances, 'time')}, "
        f"{counted(scene.num_faces, 'face')} drawn, {count(scene.num_stored_faces)} stored"
    )
    _warn_of_fixed(scene, terminal)
    _warn_of_hidden(scene, terminal)
    return scene


def _warn_of_fixed(scene: Scene, terminal: Terminal) -> None:
    """Warn of the drawn meshes that stay as they are, all of one reason together."""
    names_of: dict[str, list[str]] = {}
    for name, reason, n in zip(scene.names, scene.fixed, scene.num_uses, strict=True):
        if reason and n > 0:
            names_of.setdefault(reason, []).append(name)
    for reason, names in names_of.items():
        if len(names) == 1:
            terminal.warn(f"mesh '{names[0]}' stays as it is: {reason}")
        else:
            terminal.warn(
                f"{count(len(names))} meshes ({_listed(names)}) stay as they are: {reason}"
            )


def _warn_of_hidden(scene: Scene, terminal: Terminal) -> None:
    if hidden := scene.num_hidden_faces:
        terminal.warn(
            "meshes of hidden nodes (KHR_node_visibility) count, too, with "
            f"{count(hidden)} of the {counted(scene.num_faces, 'face')} drawn"
        )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (", ..." if len(names) > 5 else "")


def gone_materials(before: Sequence[Mesh], after: Sequence[Mesh], terminal: Terminal) -> list[str]:
    """Return and print the names of which no material has faces any more.

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
        terminal.warn(f"nothing is left of {counted(len(gone), 'material')} ({_listed(gone)})")
    return gone


def _shown_materials(meshes: Sequence[Mesh]) -> set[str]:
    shown: set[str] = set()
    for mesh in meshes:
        of_faces = mesh.face_material
        for i in np.unique(of_faces[of_faces >= 0]) if of_faces is not None else ():
            name = mesh.materials[i].name if i < len(mesh.materials) else ""
            shown.add(name or str(i))
    return shown


def tell_faces(before: Scene, after: Scene, terminal: Terminal) -> None:
    """Print how the faces of a scene have changed."""
    if before.num_faces != before.num_stored_faces:  # otherwise the message on the run states this
        terminal.say(
            f"faces drawn: {count(before.num_faces)} -> {count(after.num_faces)}, stored: "
            f"{count(before.num_stored_faces)} -> {count(after.num_stored_faces)}"
        )


def gone_meshes(before: Scene, after: Scene, terminal: Terminal) -> list[str]:
    """Return and print the names of meshes that had faces and have none any more.

    Parameters
    ----------
    before, after : Scene
        The scene before and after simplification.
    terminal : Terminal
        Prints the message.

    Returns
    -------
    list of str
        Names, or numbers of meshes without a name.
    """
    gone = [
        name or str(i)
        for i, (name, mesh, old) in enumerate(
            zip(after.names, after.meshes, before.meshes, strict=True)
        )
        if mesh.num_faces == 0 and old.num_faces > 0
    ]
    if gone:
        number = counted(len(gone), "mesh", "meshes")
        terminal.warn(f"nothing is left of {number} ({_listed(gone)}); nodes stay")
    return gone


def mesh_suffix(path: Path) -> str:
    """Return the suffix of the format, ``.obj`` for ``head.obj.xz``."""
    name = path.name.lower().removesuffix(".xz").removesuffix(".gz")
    return Path(name).suffix
