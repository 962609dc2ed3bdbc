"""Opening of the meshes and scenes that the user names: a file, or ``-`` for stdin."""

from __future__ import annotations

import sys
from pathlib import Path

from manip3d.cli.terminal import Terminal, count, counted
from manip3d.errors import FormatError, InputError
from manip3d.io import Scene, read_mesh, read_mesh_bytes, read_scene
from manip3d.mesh import Mesh


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
    """Read a glTF file as a scene if the output is glTF, too, so that its nodes are kept.

    Parameters
    ----------
    source : str
        The file.
    output : Path
        The output; a name without a suffix is that of a folder of ``.glb`` files.
    terminal : Terminal
        Prints the messages.

    Returns
    -------
    Scene or None
        None if input or output have another format, if the file cannot be read as a scene, or if
        none of its drawn meshes can be simplified (`Scene.fixed`).
    """
    kinds = {mesh_suffix(Path(source)), mesh_suffix(output) or ".glb"}
    if source == "-" or not kinds <= set(GLTF_SUFFIXES):
        return None
    try:
        scene = read_scene(source)
    except FormatError as error:
        read_mesh(source)  # if the triangles are damaged, too, this raises a single error
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
