"""Scenes of glTF files: a hierarchy of nodes, and meshes that several nodes may share."""

from __future__ import annotations

import json
import logging
import lzma
import os
import tempfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array
from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.texts import counted
from manip3d.errors import FormatError, InputError
from manip3d.io._draco import decode_draco
from manip3d.io._files import refuse_pointer
from manip3d.io._limits import byte_limit, check_points, clock
from manip3d.io._remote import is_url, local_copy, local_output
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_logger = logging.getLogger("manip3d")


@dataclass(frozen=True, eq=False)
class SceneNode:
    """A node of a `Scene`.

    Attributes
    ----------
    name : str
        Name of the node; empty if the file states none.
    parent : int or None
        Index of the parent node; None for a root.
    mesh : int or None
        Index of the node's mesh; None if it has no mesh.
    transform : (4, 4) float64
        Transform from the node's coordinates to its parent's.
    drawn : bool
        Whether the node belongs to the file's default scene.
    instances : (I, 4, 4) float64 or None
        Transforms from mesh to node coordinates, one for each instance
        (``EXT_mesh_gpu_instancing``); None: the mesh is drawn once, in node coordinates.
    joint : int or None
        Index of the node that is the first joint of the mesh's skin. A mesh with a skin is placed
        by this node instead of its own. None: the mesh has no skin.
    inverse_bind : (4, 4) float64
        Transform from the coordinates of a mesh with a skin to those of ``joint``.

    Raises
    ------
    InputError
        A transform has another shape, is not finite, or its last row is not 0, 0, 0, 1.
    """

    name: str
    parent: int | None
    mesh: int | None
    transform: NDArray[np.float64] = field(repr=False)
    drawn: bool
    instances: NDArray[np.float64] | None = field(default=None, repr=False)
    joint: int | None = None
    inverse_bind: NDArray[np.float64] = field(default_factory=lambda: np.eye(4), repr=False)

    def __post_init__(self) -> None:
        for name in ("transform", "inverse_bind", "instances"):
            value = getattr(self, name)
            if name != "instances" or value is not None:
                matrices = _transforms(value, 3 if name == "instances" else 2, name)
                object.__setattr__(self, name, matrices)

    @property
    def num_instances(self) -> int:
        """Number of times that the node draws its mesh."""
        if self.mesh is None:
            return 0
        return 1 if self.instances is None else len(self.instances)


def _transforms(values: ArrayLike, ndim: int, name: str) -> NDArray[np.float64]:
    """Return one (4, 4) or several (I, 4, 4) transforms as float64."""
    given = as_array(values, name)
    if given.ndim != ndim or given.shape[-2:] != (4, 4) or given.dtype.kind not in "iuf":
        expected = "(4, 4)" if ndim == 2 else "(I, 4, 4)"
        raise InputError(
            f"{name}: expected numbers of shape {expected}, got {given.dtype} {given.shape}"
        )
    if not np.isfinite(given).all():
        raise InputError(f"{name}: expected finite numbers")
    last = given[..., 3, :].reshape(-1, 4)
    if (wrong := (last != (0, 0, 0, 1)).any(axis=1)).any():
        raise InputError(f"{name}: expected 0 0 0 1 as the last row, got {last[wrong][0].tolist()}")
    own = np.array(given, np.float64)  # a change in place would not be noticed when it is written
    own.flags.writeable = False
    return own


@dataclass(frozen=True, eq=False)
class Deformation:
    """Joints of a skin and morph targets, which move the vertices of a mesh of a `Scene`.

    Attributes
    ----------
    joints : (V, J) uint16
        Indices into the joints of the skin. J is 4 times the number of attributes ``JOINTS_0``,
        ``JOINTS_1``, ..., and 0 without a skin.
    weights : (V, J) float32
        Weight of each joint in the movement of a vertex.
    targets : (T, V, 3) float32
        Displacements of the vertices by each morph target.
    target_normals : (T, V, 3) float32
        Changes of the normals by each morph target; (0, V, 3) if no target changes them.
    """

    joints: NDArray[np.uint16] = field(repr=False)
    weights: NDArray[np.float32] = field(repr=False)
    targets: NDArray[np.float32] = field(repr=False)
    target_normals: NDArray[np.float32] = field(repr=False)


@dataclass(frozen=True, eq=False)
class Scene:
    """A glTF file with its hierarchy of nodes; see :func:`read_scene`.

    Attributes
    ----------
    nodes : tuple of SceneNode
        All nodes of the file. Their transforms may be replaced by others, except those of joints
        and of animated nodes; `write_scene` refuses other changes.
    meshes : tuple of Mesh
        Each mesh once, in its own coordinates, even if several nodes share it. Skin and morph
        targets are not applied, except that a fixed mesh has the shape of the default weights of
        its morph targets.
    names : tuple of str
        Names of the meshes.
    fixed : tuple of str
        For each mesh, the reason why it is always written unchanged, such as ``"it has no
        triangles"``; empty for a mesh that :meth:`with_meshes` may replace.
    deformations : tuple of Deformation or None
        For each mesh that may be replaced, its skin and morph targets; None if it has neither.
    more_texcoords : tuple of (V, S, 2) float32 or None
        For each mesh that may be replaced, ``TEXCOORD_1`` and the S - 1 following sets in glTF's
        convention (v downwards). NaN: a vertex lacks the set. None: the mesh has no further sets,
        or no texture uses them.
    alphas : tuple of (V,) float32 or None
        For each mesh that may be replaced, alpha of the colours of its vertices, 0 to 1. None: all
        are opaque, or no material shows alpha.
    warnings : tuple of str
        Parts of the file that were left out.
    source : str or None
        The file from which the scene was read.
    """

    nodes: tuple[SceneNode, ...]
    meshes: tuple[Mesh, ...]
    names: tuple[str, ...]
    fixed: tuple[str, ...]
    deformations: tuple[Deformation | None, ...]
    more_texcoords: tuple[NDArray[np.float32] | None, ...] = field(repr=False)
    alphas: tuple[NDArray[np.float32] | None, ...] = field(repr=False)
    warnings: tuple[str, ...]
    source: str | None
    _document: bytes = field(repr=False)
    _buffer: bytes = field(repr=False)
    _nodes_of_file: tuple[SceneNode, ...] = field(repr=False)

    def __repr__(self) -> str:
        faces = counted(self.num_stored_faces, "face")
        return f"<manip3d.io.Scene: {len(self.nodes)} nodes, {len(self.meshes)} meshes, {faces}>"

    @property
    def num_uses(self) -> NDArray[np.int64]:
        """Number of times that each mesh is drawn, (M,): once per drawn node or instance."""
        uses = np.zeros(len(self.meshes), dtype=np.int64)
        for node in self.nodes:
            if node.drawn and node.mesh is not None:
                uses[node.mesh] += node.num_instances
        return uses

    @property
    def num_instances(self) -> int:
        """Number of times that meshes are drawn: once per drawn node or instance."""
        return int(self.num_uses.sum())

    @property
    def num_faces(self) -> int:
        """Number of drawn faces; those of a mesh count once for each node or instance."""
        return int(self.num_uses @ self._face_counts())

    @property
    def num_stored_faces(self) -> int:
        """Number of stored faces; those of a mesh count once, even if several nodes share it."""
        return int(self._face_counts()[self.num_uses > 0].sum())

    @property
    def num_hidden_faces(self) -> int:
        """Number of the faces in `num_faces` whose nodes are hidden (``KHR_node_visibility``).

        A hidden node hides its children, too. An animation may show them again.
        """
        counts = self._face_counts()
        return sum(
            node.num_instances * int(counts[node.mesh])
            for node, is_hidden in zip(self.nodes, self._hidden(), strict=True)
            if is_hidden and node.drawn and node.mesh is not None
        )

    def _hidden(self) -> NDArray[np.bool_]:
        """Return whether each node, or a node above it, is hidden."""
        entries = json.loads(self._document).get("nodes", ())
        hidden = np.array([_is_hidden(entry) for entry in entries], dtype=bool)
        if hidden.any():
            for path in self._paths_from_roots():
                for i in path:
                    parent = self.nodes[i].parent
                    hidden[i] |= parent is not None and hidden[parent]
        return hidden

    @property
    def has_textures(self) -> bool:
        """Whether the file has textures, including images in formats that are not read."""
        return bool(json.loads(self._document).get("textures"))

    @property
    def num_vertices(self) -> int:
        """Number of vertices of all meshes, each mesh counted once."""
        return sum(mesh.num_vertices for mesh in self.meshes)

    def _face_counts(self) -> NDArray[np.int64]:
        return np.array([mesh.num_faces for mesh in self.meshes], dtype=np.int64)

    def world_transforms(self) -> NDArray[np.float64]:
        """Return the transform of each node to scene coordinates, (N, 4, 4)."""
        world = np.empty((len(self.nodes), 4, 4))
        for path in self._paths_from_roots():
            for i in path:
                parent = self.nodes[i].parent
                local = self.nodes[i].transform
                world[i] = local if parent is None else product(world[parent], local)
        return world

    def _paths_from_roots(self) -> Iterator[list[int]]:
        """Yield paths of nodes downwards that hold each node once, after its parent."""
        known: set[int] = set()
        for start in range(len(self.nodes)):
            path: list[int] = []
            node: int | None = start
            while node is not None and node not in known:
                path.append(node)
                node = self.nodes[node].parent
            known.update(path)
            yield path[::-1]

    def with_meshes(
        self,
        meshes: Mapping[int, Mesh],
        deformations: Mapping[int, Deformation] | None = None,
        more_texcoords: Mapping[int, NDArray[np.float32]] | None = None,
        alphas: Mapping[int, NDArray[np.float32]] | None = None,
    ) -> Scene:
        """Return the scene with some of its meshes replaced.

        Parameters
        ----------
        meshes : mapping of int to Mesh
            New meshes by the index of the mesh that they replace. They have the coordinates of that
            mesh, and refer to materials by the index in its ``materials``. A mesh without faces is
            not written with the scene, while its nodes are.
        deformations : mapping of int to Deformation, optional
            Skins and morph targets of the new meshes; required for each mesh that replaces one in
            which ``Scene.deformations`` is not None.
        more_texcoords : mapping of int to (V, S, 2) float32, optional
            Further texture coordinates of the new meshes; required for each mesh that replaces one
            in which ``Scene.more_texcoords`` is not None.
        alphas : mapping of int to (V,) float32, optional
            Alpha of the colours of the new meshes; required for each mesh with colours that
            replaces one in which ``Scene.alphas`` is not None.

        Returns
        -------
        Scene
            A new scene.

        Raises
        ------
        InputError
            The index is out of range, or the mesh is fixed; deformations, texture coordinates or
            alphas are missing, or do not have one row per vertex.
        """
        changed = list(self.meshes)
        moved = list(self.deformations)
        placed = list(self.more_texcoords)
        clear = list(self.alphas)
        for index, mesh in meshes.items():
            if not 0 <= index < len(changed):
                raise InputError(
                    f"meshes: expected indices below {len(changed)} (the scene's meshes), "
                    f"got {index}"
                )
            if self.fixed[index]:
                raise InputError(f"meshes: mesh {index} is fixed: {self.fixed[index]}")
            changed[index] = mesh
            if moved[index] is not None and mesh.num_faces > 0:
                moved[index] = _fitting((deformations or {}).get(index), mesh, index)
            if (before := placed[index]) is not None:
                given = (more_texcoords or {}).get(index)
                placed[index] = (
                    _fitting_texcoords(given, mesh, index) if mesh.num_faces > 0 else before[:0]
                )
            if mesh.colors is None and mesh.num_faces:
                clear[index] = None
            elif (alpha := clear[index]) is not None:
                own = (alphas or {}).get(index)
                clear[index] = _fitting_alphas(own, mesh, index) if mesh.num_faces else alpha[:0]
        return replace(
            self,
            meshes=tuple(changed),
            deformations=tuple(moved),
            more_texcoords=tuple(placed),
            alphas=tuple(clear),
        )

    def write(
        self,
        path: str | os.PathLike[str],
        *,
        max_vertices: int | None = None,
        quantize: bool = False,
    ) -> None:
        """Write the scene; see :func:`manip3d.io.write_scene`.

        Parameters
        ----------
        path : path
            File to write.
        max_vertices : int, optional
        quantize : bool
            See `manip3d.io.write_scene`.
        """
        write_scene(self, path, max_vertices=max_vertices, quantize=quantize)


@checked
def read_scene(
    path: str | os.PathLike[str], *, allow_outside: bool = False, max_bytes: int | None = None
) -> Scene:
    """Read a ``.gltf`` or ``.glb`` file with its hierarchy of nodes.

    Each mesh is read once, in its own coordinates. `read_mesh` instead reads the file as one mesh
    in scene coordinates.

    Parameters
    ----------
    path, allow_outside, max_bytes
        See `read_mesh`.

    Returns
    -------
    Scene
        Nodes and meshes of the file.

    Raises
    ------
    FormatError
        The file is damaged or hostile, or has another format.
    OSError
        The file cannot be read.

    Notes
    -----
    `write_scene` writes nodes with their names, parents and transforms, materials, textures,
    cameras, lights, animations, skins and ``extras`` unchanged, and also meshes that are not plain
    triangles (``Scene.fixed`` states the reason). Other meshes keep positions, normals, texture
    coordinates, ``COLOR_0``, joints, weights and morph targets; ``warnings`` names their other
    attributes, which are lost. ``TANGENT`` is left out, because viewers then compute the tangents
    for which normal maps are made (MikkTSpace) from the texture coordinates, as glTF demands.

    Examples
    --------
    >>> from manip3d import io, simulate
    >>> simulate.models.floor(columns=2, rows=1).write("floor.glb")
    >>> scene = io.read_scene("floor.glb")
    >>> scene.num_instances, scene.num_faces
    (1, 4)
    """
    limit = byte_limit(max_bytes)
    with clock(os.fspath(path)) as look, local_copy(path, max_bytes=limit or None) as local:
        refuse_pointer(local)
        return _read_local(local, bool(allow_outside), limit, look, os.fspath(path))


def scene_of_bytes(data: bytes, name: str) -> Scene | None:
    """Read a scene from the content of a glTF file, compressed or not.

    ``name`` begins warnings and errors. None if the content is that of another format.
    """
    suffix, head = _start(data)
    if not (head.startswith(b"glTF") or head.lstrip().startswith(b"{")):
        return None
    limit = byte_limit(None)
    with clock(name) as look, tempfile.TemporaryDirectory() as folder:
        local = Path(folder) / f"scene.glb{suffix}"  # the content tells whether it is a .gltf
        local.write_bytes(data)
        try:
            return replace(_read_local(local, False, limit, look, name), source=None)
        except FormatError as error:
            raise FormatError(
                error.reason, file=name, line=error.line, byte_offset=error.byte_offset
            ) from None


_MAX_XZ = 80 << 20  # bytes of memory for an .xz, as for files


def _start(data: bytes) -> tuple[str, bytes]:
    """Return the suffix of the compression of a file, and its first uncompressed bytes."""
    length = 64
    try:
        if data.startswith(b"\x1f\x8b"):
            return ".gz", zlib.decompressobj(31).decompress(data, length)
        if data.startswith(b"\xfd7zXZ"):
            return ".xz", lzma.LZMADecompressor(memlimit=_MAX_XZ).decompress(data, length)
    except (zlib.error, lzma.LZMAError):
        return "", b""
    return "", data[:length]


def _read_local(
    local: Path, allow_outside: bool, limit: int, look: Callable[[float], None] | None, name: str
) -> Scene:
    """Return the scene of a local file; ``name`` stands for it in errors and in the result."""
    nodes, meshes, document, buffer, warnings = _core.read_scene(
        os.fsencode(local), allow_outside, limit, decode_draco, look
    )
    check_points(sum(entry[1].num_vertices for entry in meshes), name)
    for text in warnings:
        _logger.warning("%s: %s", name, text)
    try:
        read = tuple(
            SceneNode(
                name, _index(parent), _index(mesh), transform, drawn, instances, _index(joint), bind
            )
            for name, parent, mesh, transform, drawn, instances, joint, bind in nodes
        )
    except InputError as error:  # the product of a node's rotation and scale overflows
        raise FormatError(f"nodes: {error}", file=name) from error
    return Scene(
        nodes=read,
        meshes=tuple(entry[1] for entry in meshes),
        names=tuple(entry[0] for entry in meshes),
        fixed=tuple(entry[2] for entry in meshes),
        deformations=tuple(
            None if entry[3] is None else Deformation(*entry[3]) for entry in meshes
        ),
        more_texcoords=tuple(entry[4] for entry in meshes),
        alphas=tuple(entry[5] for entry in meshes),
        warnings=tuple(warnings),
        source=name,
        _document=document,
        _buffer=buffer,
        _nodes_of_file=read,
    )


def _is_hidden(entry: Mapping[str, Any]) -> bool:
    """Return whether a node of a document has ``KHR_node_visibility`` with ``visible`` false."""
    extensions = entry.get("extensions")
    own = extensions.get("KHR_node_visibility") if isinstance(extensions, dict) else None
    return isinstance(own, dict) and own.get("visible") is False


def _index(value: int) -> int | None:
    return None if value < 0 else value


def _fitting(deformation: Deformation | None, mesh: Mesh, index: int) -> Deformation:
    """Return the deformation of a new mesh; raise if it does not have one row per vertex."""
    if deformation is None:
        raise InputError(f"deformations: expected one for mesh {index}, which is moved, got none")
    rows = {len(deformation.joints), len(deformation.weights), deformation.targets.shape[1]}
    if rows != {mesh.num_vertices}:
        raise InputError(
            f"deformations: expected {mesh.num_vertices} rows (the vertices of mesh {index}), got "
            f"{sorted(rows)}"
        )
    return deformation


def _fitting_texcoords(
    values: NDArray[np.float32] | None, mesh: Mesh, index: int
) -> NDArray[np.float32]:
    """Return further texture coordinates of a new mesh; raise if they have another shape."""
    if values is None:
        raise InputError(
            f"more_texcoords: expected those of mesh {index}, which has several sets, got none"
        )
    rows = np.asarray(values, dtype=np.float32)
    if rows.ndim != 3 or rows.shape[0] != mesh.num_vertices or rows.shape[2] != 2:
        raise InputError(
            f"more_texcoords: expected shape ({mesh.num_vertices}, S, 2) (the vertices of mesh "
            f"{index}), got {rows.shape}"
        )
    return rows


def _fitting_alphas(
    values: NDArray[np.float32] | None, mesh: Mesh, index: int
) -> NDArray[np.float32]:
    """Return alphas of a new mesh; raise if they have another shape or are not from 0 to 1."""
    if values is None:
        raise InputError(
            f"alphas: expected those of mesh {index}, whose colors have them, got none"
        )
    rows = np.asarray(values, dtype=np.float32)
    if rows.shape != (mesh.num_vertices,):
        raise InputError(
            f"alphas: expected shape ({mesh.num_vertices},) (the vertices of mesh {index}), got "
            f"{rows.shape}"
        )
    if not ((rows >= 0.0) & (rows <= 1.0)).all():
        raise InputError(f"alphas: expected numbers from 0 to 1 for mesh {index}")
    return rows


@checked
def write_scene(
    scene: Scene,
    path: str | os.PathLike[str],
    *,
    coarser: Sequence[Scene] = (),
    coverages: Sequence[float] = (),
    max_vertices: int | None = None,
    quantize: bool = False,
) -> None:
    """Write a scene as ``.glb`` or ``.gltf``.

    Parameters
    ----------
    scene : Scene
        The scene to write; with ``coarser``, its finest level.
    path : path-like
        Output file. Images are stored in the file (``.glb``) or in the ``.bin`` beside it.
    coarser : sequence of Scene
        Coarser levels of detail of the same scene, finest first (the extension ``MSFT_lod``). A
        level replaces a node with all its children. Therefore the mesh of a node that has children,
        a camera or an animation is moved to a new child node.
    coverages : sequence of float
        Smallest share of the screen at which each level is shown, beginning with ``scene``.
    max_vertices : int, optional
        See `write_mesh`.
    quantize : bool
        Quantize each mesh that may be replaced, relative to its own bounding box, see `write_mesh`.
        Its nodes get a child that moves and scales it. Instanced meshes
        (``EXT_mesh_gpu_instancing``) and meshes with a skin or morph targets are not quantized.

    Raises
    ------
    InputError
        The suffix is another one, ``coarser`` holds levels of another scene, a mesh is invalid (see
        `write_mesh`), or nodes differ from those of the file by more than the transforms of nodes
        that are neither joints nor animated.
    OSError
        The file cannot be written; an existing file stays unchanged.

    Examples
    --------
    >>> from manip3d import io, simulate
    >>> simulate.models.floor(columns=2, rows=1).write("floor.glb")
    >>> io.write_scene(io.read_scene("floor.glb"), "copy.glb")
    >>> io.read_mesh("copy.glb").num_faces
    4
    """
    levels = [scene, *coarser]
    if any(level.fixed != scene.fixed for level in coarser):
        raise InputError("coarser: expected levels of the same scene, got another")
    moved = _moved_nodes(scene)
    if any(_moved_nodes(level) != moved for level in coarser):
        raise InputError("coarser: expected nodes with the transforms of the finest level")
    with local_output(path) as local:
        warnings = _core.write_scene(
            os.fsencode(local),
            _with_transforms(scene._document, moved),  # type: ignore[arg-type]  # bytes are a std::string, too
            scene._buffer,  # type: ignore[arg-type]
            [_replaced(level) for level in levels],
            0 if max_vertices is None else max_vertices,
            list(coverages),
            quantize,
            is_url(path),
        )
        for text in warnings:
            _logger.warning("%s: %s", os.fspath(path), text)


def _moved_nodes(scene: Scene) -> dict[int, list[float]]:
    """Return the new transforms of nodes that were moved, column by column, by their index."""
    nodes, given = scene.nodes, scene._nodes_of_file
    if len(nodes) != len(given):
        raise InputError(f"nodes: expected the {len(given)} nodes of the file, got {len(nodes)}")
    return {
        i: node.transform.T.ravel().tolist()
        for i, (node, own) in enumerate(zip(nodes, given, strict=True))
        if node is not own and _has_moved(node, own, i)
    }


def _with_transforms(document: bytes, moved: Mapping[int, list[float]]) -> bytes:
    """Return the document of a scene with other transforms of some nodes."""
    if not moved:
        return document
    parsed = json.loads(document)
    fixed = {joint for skin in parsed.get("skins") or () for joint in skin.get("joints", ())}
    for animation in parsed.get("animations") or ():
        for channel in animation.get("channels", ()):
            fixed.add(_animated_node(channel.get("target") or {}))
    for i, columns in moved.items():
        if i in fixed:
            raise InputError(f"nodes[{i}].transform: the node is animated or a joint of a skin")
        entry = parsed["nodes"][i]
        for name in ("translation", "rotation", "scale"):
            entry.pop(name, None)
        entry["matrix"] = columns
    return json.dumps(parsed).encode()


def _animated_node(target: Mapping[str, Any]) -> int | None:
    """Return the node that a channel of an animation moves, by its index or by a JSON pointer."""
    extension = (target.get("extensions") or {}).get("KHR_animation_pointer") or {}
    _, _, rest = str(extension.get("pointer", "")).partition("/nodes/")
    index = rest.partition("/")[0]
    return int(index) if index.isdecimal() else target.get("node")


def _has_moved(node: SceneNode, own: SceneNode, index: int) -> bool:
    """Return whether the transform of a node was changed; refuse other changes."""
    for each in fields(SceneNode):
        if each.name == "transform":
            continue
        value, before = getattr(node, each.name), getattr(own, each.name)
        if not (np.array_equal(value, before) if before is not None else value is None):
            raise InputError(f"nodes[{index}].{each.name}: only transforms of nodes can be changed")
    return not np.array_equal(node.transform, own.transform)


_Tables = tuple["ArrayLike", "ArrayLike", "ArrayLike", "ArrayLike"]


_Replaced = tuple[Mesh, _Tables | None, "ArrayLike | None", "ArrayLike | None"]


def _replaced(scene: Scene) -> list[_Replaced | None]:
    """Return the replaceable meshes with what a `Mesh` does not hold; None: fixed."""
    return [
        None if reason else (mesh, None if moves is None else _tables(moves), more, alphas)
        for mesh, reason, moves, more, alphas in zip(
            scene.meshes,
            scene.fixed,
            scene.deformations,
            scene.more_texcoords,
            scene.alphas,
            strict=True,
        )
    ]


def _tables(moves: Deformation) -> _Tables:
    weights = np.asarray(moves.weights, dtype=np.float32)
    sums = weights.sum(axis=-1, dtype=np.float64, keepdims=True)
    # glTF requires that weights sum to 1. In quantised files (Draco) the sum is off by the rounding
    # of each weight, at most 8 times half of 1/255. Larger errors have another cause and are kept.
    off = np.abs(sums - 1.0)
    is_off = (off > 1e-6) & (off < 0.02)
    weights = np.divide(weights, sums, out=weights.astype(np.float64), where=is_off)
    return moves.joints, weights.astype(np.float32), moves.targets, moves.target_normals
