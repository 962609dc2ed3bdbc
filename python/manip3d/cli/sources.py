"""Opening what the user names: a file, ``-`` for stdin, or the files of a folder."""

from __future__ import annotations

import sys
from pathlib import Path

from manip3d.cli.terminal import Terminal, count, counted
from manip3d.errors import FormatError, InputError
from manip3d.io import Scene, read_mesh, read_mesh_bytes, read_scene
from manip3d.mesh import Mesh


def open_mesh(source: str, terminal: Terminal, *, may_be_empty: bool = False) -> Mesh:
    """Read a mesh from a file or, for ``-``, from stdin, and say what was read.

    Parameters
    ----------
    source : str
    terminal : Terminal
    may_be_empty : bool
        A mesh without faces is worth a warning; else it is an error.

    Raises
    ------
    FormatError, OSError
        As `manip3d.read_mesh`.
    InputError
        The mesh has no faces and that is not allowed.
    """
    if source == "-":
        mesh, kind = read_mesh_bytes(sys.stdin.buffer.read()), "stdin"
    else:
        mesh, kind = read_mesh(source), mesh_suffix(Path(source)).lstrip(".")
    if mesh.num_faces == 0 and not may_be_empty:
        raise InputError(f"{source}: expected a mesh with faces, got none")
    terminal.say(
        f"read {source} ({kind}): {counted(mesh.num_vertices, 'vertex', 'vertices')}, "
        f"{counted(mesh.num_faces, 'face')}"
    )
    if mesh.num_faces == 0:
        terminal.say(f"warning: {source} has no faces")
    return mesh


GLTF_SUFFIXES = (".glb", ".gltf")


def open_scene(source: str, output: Path, terminal: Terminal) -> Scene | None:
    """Read a glTF file that becomes one, with all that a mesh has no place for; say what was read.

    Parameters
    ----------
    source : str
    output : Path
    terminal : Terminal

    Returns
    -------
    Scene or None
        ``None`` for another format, an output of another format, and a scene whose meshes can all
        not be simplified without what a mesh lacks.
    """
    kinds = {mesh_suffix(Path(source)), mesh_suffix(output) or ".glb"}
    if source == "-" or not kinds <= set(GLTF_SUFFIXES):
        return None
    try:
        scene = read_scene(source)
    except FormatError as error:
        read_mesh(source)  # raises what is wrong with the triangles, which then is told once
        terminal.say(f"warning: nodes are not kept: {error}")
        return None
    if scene.num_instances == 0:
        return None
    uses = scene.num_uses
    reasons = [reason for reason, n in zip(scene.fixed, uses, strict=True) if n > 0]
    if all(reasons):
        listed = ", ".join(sorted(set(reasons)))
        terminal.say(f"warning: nodes are not kept, all becomes one mesh: {listed}")
        return None
    terminal.say(
        f"read {source} ({mesh_suffix(Path(source)).lstrip('.')}): "
        f"{counted(len(scene.nodes), 'node')}, "
        f"{counted(len(scene.meshes), 'mesh', 'meshes')} "
        f"shown {counted(scene.num_instances, 'time')}, "
        f"{counted(scene.num_faces, 'face')} drawn, {count(scene.num_stored_faces)} stored"
    )
    for name, reason, n in zip(scene.names, scene.fixed, uses, strict=True):
        if reason and n > 0:
            terminal.say(f"warning: mesh '{name}' stays as it is: {reason}")
    return scene


def tell_scene(before: Scene, after: Scene, terminal: Terminal) -> None:
    """Say what became of a scene."""
    if before.num_faces != before.num_stored_faces:  # else the sentence about the run says it all
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
    """The suffix that tells the format: ``.obj`` for ``head.obj.xz``."""
    name = path.name.lower().removesuffix(".xz").removesuffix(".gz")
    return Path(name).suffix
