"""Triangle meshes with per-corner attributes, their materials, and summaries of defects."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from manip3d import _core
from manip3d._util.arrays import index_rows, rows
from manip3d._util.checked import checked
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

AlphaMode = Literal["opaque", "mask", "blend"]
Wrap = Literal["repeat", "mirror", "clamp"]

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
# Rotation about x from +z up to +y up: (x, y, z) -> (x, z, -y).
_Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Texture:
    """A texture image: a path, the bytes of an image file, or both.

    Attributes
    ----------
    path : str or None
        Path of the image; a relative path starts in the folder of the mesh file.
    data : bytes or None
        Content of a PNG or JPEG file (glTF embeds images); None if only the path is known.
    wrap : (u, v) of 'repeat', 'mirror' or 'clamp'
        Content of the texture outside of [0, 1] along u and v: the image again, its mirror image,
        or its border. OBJ holds 'clamp' along both, PLY holds neither.
    smooth : bool
        Whether the pixels of an enlarged image are blended; False in pixel art. Only glTF holds it.

    Raises
    ------
    InputError
        ``wrap`` is not a pair of these words.

    Examples
    --------
    >>> from manip3d import Texture
    >>> Texture("leaf.png", wrap=("clamp", "clamp")).wrap
    ('clamp', 'clamp')
    """

    path: str | None = None
    data: bytes | None = field(default=None, repr=False)
    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    smooth: bool = True

    def __post_init__(self) -> None:
        words = get_args(Wrap)
        given = self.wrap
        is_pair = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == 2
        if not is_pair or any(each not in words for each in given):
            raise InputError(f"wrap: expected two of {', '.join(words)}, got {given!r}")
        object.__setattr__(self, "wrap", tuple(given))


@dataclass(frozen=True)
class Material:
    """Surface appearance, the metallic-roughness model of glTF 2.0.

    Attributes
    ----------
    name : str
        Name of the material.
    base_color : (r, g, b, a) float in [0, 1]
        Base colour in linear space; it multiplies the base colour texture.
    metallic, roughness : float in [0, 1]
        Metalness and roughness; they multiply the metallic-roughness texture.
    alpha_mode : 'opaque', 'mask' or 'blend'
        Use of alpha: ignore it, compare it with ``alpha_cutoff``, or blend.
    alpha_cutoff : float
        In mode ``mask``, points with a smaller alpha are not drawn.
    double_sided : bool
        Whether faces are visible from behind. Only glTF files state it; with all other formats it
        is True.
    textures : dict of str to Texture
        Textures by role: ``base_color``, ``metallic_roughness``, ``normal``, ``occlusion``,
        ``emissive``.
    emissive : (r, g, b) float, at least 0
        Emitted light in linear space; it multiplies the emissive texture. If there is such a
        texture, (0, 0, 0) is treated as (1, 1, 1).

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Material, Mesh, read_mesh
    >>> lamp = Material("lamp", emissive=(1.0, 0.5, 0.0))
    >>> mesh = Mesh(np.eye(3), [[0, 1, 2]], face_material=[0], materials=[lamp])
    >>> mesh.write("lamp.glb")
    >>> read_mesh("lamp.glb").materials[0].emissive
    (1.0, 0.5, 0.0)
    """

    name: str = ""
    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    metallic: float = 0.0
    roughness: float = 1.0
    alpha_mode: AlphaMode = "opaque"
    alpha_cutoff: float = 0.5
    double_sided: bool = True
    textures: dict[str, Texture] = field(default_factory=dict)
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)


def _interop() -> ModuleType:
    from manip3d.io import _interop as module  # imported late, since few programs convert meshes

    return module


class Mesh(Showable):
    """Triangle mesh with per-corner texture coordinates and normals, and per-face materials.

    Corner ``c`` of face ``f`` lies at ``vertices[faces[f, c]]`` and carries
    ``texcoords[face_texcoords[f, c]]`` and ``normals[face_normals[f, c]]``; an index of -1 means
    that the corner has no such attribute.

    Parameters
    ----------
    vertices : (V, 3) float64
        Coordinates in the file's own units and axes.
    faces : (F, 3) int32
        Indices into ``vertices``.
    texcoords : (T, 2) float64, optional
        Texture coordinates, v up (OBJ's convention).
    face_texcoords : (F, 3) int32, optional
        Indices of the corners into ``texcoords``.
    normals : (K, 3) float64, optional
        Normals of corners.
    face_normals : (F, 3) int32, optional
        Indices of the corners into ``normals``.
    colors : (V, 3) uint8, optional
        Colours of the vertices, sRGB.
    face_material : (F,) int32, optional
        Indices of the faces into ``materials``; -1 = none.
    materials : sequence of Material
        Materials of the faces.
    source : str, optional
        The file from which the mesh was read; relative texture paths start in its folder.

    Raises
    ------
    InputError
        An array has another shape, cannot be converted without loss, or has an index out of range.

    Notes
    -----
    C-contiguous arrays of these dtypes are not copied; others are converted.
    """

    __slots__ = (
        "colors",
        "face_material",
        "face_normals",
        "face_texcoords",
        "faces",
        "materials",
        "normals",
        "source",
        "texcoords",
        "vertices",
    )

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    texcoords: NDArray[np.float64] | None
    face_texcoords: NDArray[np.int32] | None
    normals: NDArray[np.float64] | None
    face_normals: NDArray[np.int32] | None
    colors: NDArray[np.uint8] | None
    face_material: NDArray[np.int32] | None
    materials: tuple[Material, ...]
    source: str | None

    def __init__(
        self,
        vertices: ArrayLike,
        faces: ArrayLike,
        *,
        texcoords: ArrayLike | None = None,
        face_texcoords: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        face_normals: ArrayLike | None = None,
        colors: ArrayLike | None = None,
        face_material: ArrayLike | None = None,
        materials: Sequence[Material] = (),
        source: str | None = None,
    ) -> None:
        self.vertices = rows(vertices, 3, np.float64, "vertices")
        self.faces = index_rows(faces, 3, "faces")
        self.texcoords = None if texcoords is None else rows(texcoords, 2, np.float64, "texcoords")
        self.face_texcoords = (
            None if face_texcoords is None else index_rows(face_texcoords, 3, "face_texcoords")
        )
        self.normals = None if normals is None else rows(normals, 3, np.float64, "normals")
        self.face_normals = (
            None if face_normals is None else index_rows(face_normals, 3, "face_normals")
        )
        self.colors = None if colors is None else rows(colors, 3, np.uint8, "colors")
        self.face_material = (
            None if face_material is None else index_rows(face_material, None, "face_material")
        )
        if not isinstance(materials, Sequence) or not all(
            isinstance(material, Material) for material in materials
        ):
            raise InputError(f"materials: expected a sequence of Material, got {materials!r}")
        self.materials = tuple(materials)
        self.source = source
        self.validate()

    def validate(self) -> None:
        """Check indices, lengths and finiteness, for example after an array was changed in place.

        Raises
        ------
        InputError
            An array is invalid; the error names the array, the row, and the expected values.
        """
        _core.check_mesh(self)

    @property
    def num_vertices(self) -> int:
        """Number of vertices, including unreferenced ones."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner, (2, 3), of the bounding box of the vertices used by faces.

        Both corners of a mesh without faces are (0, 0, 0), wherever its vertices are.
        """
        box: NDArray[np.float64] = _core.bounding_box(self)
        return box

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal, in the mesh's units; 0 without faces."""
        low, high = self.bounds
        return float(np.linalg.norm(high - low, axis=-1))

    def summary(self) -> MeshSummary:
        """Return counts of vertices, edges, defects and attributes, as stored and welded."""
        return summarize(self)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the mesh to a file atomically; see `manip3d.io.write_mesh`."""
        from manip3d.io import write_mesh

        write_mesh(self, path)

    def to_open3d(self) -> Any:
        """Convert to an ``open3d.geometry.TriangleMesh`` (legacy).

        Vertices and faces are unchanged. UVs become ``triangle_uvs`` (NaN if a corner has none),
        materials ``triangle_material_ids`` (-1 = none), base colour images ``textures`` (an empty
        image if a material has none or its file is missing). Normals are kept if each vertex has a
        single normal; other properties of materials are lost.

        Raises
        ------
        MissingExtraError
            Open3D is not installed.
        """
        return _interop().to_open3d(self)

    @staticmethod
    def from_open3d(source: Any) -> Mesh:
        """Convert from an Open3D ``TriangleMesh``, legacy or tensor; the inverse of `to_open3d`.

        Corners with equal UVs share one texture coordinate; NaN means none. Materials are named
        ``material_0`` and so on, since Open3D's have no names; textures become PNG. A single
        texture without ``triangle_material_ids`` is used for all faces. Of a tensor mesh's material
        the maps ``albedo``, ``normal`` and ``ao``, base colour, metallic and roughness are kept. A
        warning names the properties that are lost, such as colours of faces.

        Raises
        ------
        InputError
            ``source`` is not a triangle mesh.
        """
        mesh: Mesh = _interop().from_open3d(source)
        return mesh

    def to_trimesh(self, *, geometry_only: bool = False) -> Any:
        """Convert to a ``trimesh.Trimesh``, or to a ``trimesh.Scene`` if one cannot hold the mesh.

        A ``Trimesh`` has one UV per vertex and one material. Therefore vertices are split at
        texture seams, and faces of different materials, or with and without UVs, become separate
        geometries of a ``Scene`` (``part_0000`` and so on, by material, those without UVs first).
        Materials become ``PBRMaterial``; normals are kept if each vertex has a single normal.

        Parameters
        ----------
        geometry_only : bool
            Return a single ``Trimesh`` with unchanged vertices and faces, without UVs and
            materials.

        Raises
        ------
        MissingExtraError
            trimesh is not installed, or the mesh has textures and Pillow is not installed.
        """
        return _interop().to_trimesh(self, geometry_only=geometry_only)

    @staticmethod
    def from_trimesh(source: Any) -> Mesh:
        """Convert from a ``trimesh.Trimesh`` or ``Scene``; the inverse of `to_trimesh`.

        Meshes of a scene are transformed by its graph and concatenated; vertices stay split at
        texture seams. If only some meshes have vertex colours, the vertices of the others are
        white. Colours of faces become materials or vertex colours. Normals are not kept, because
        trimesh does not distinguish stored from computed ones. A warning names the other losses:
        colours of faces beside those of vertices, transparency of colours, geometries that are no
        meshes.

        Raises
        ------
        InputError
            ``source`` is neither a ``Trimesh`` nor a ``Scene``.
        """
        mesh: Mesh = _interop().from_trimesh(source)
        return mesh

    @checked
    def oriented(
        self, *, unit: Literal["m", "cm", "mm", "in", "ft"] = "m", up: Literal["y", "z"] = "y"
    ) -> Mesh:
        """Return the mesh in metres with +y up, the convention of glTF.

        Parameters
        ----------
        unit : 'm', 'cm', 'mm', 'in' or 'ft'
            Unit of this mesh's coordinates.
        up : 'y' or 'z'
            Axis that points up in this mesh.

        Raises
        ------
        InputError
            ``unit`` or ``up`` has another value.

        Examples
        --------
        >>> from manip3d import Mesh
        >>> mesh = Mesh([[0, 0, 0], [0, 0, 500], [1, 0, 0]], [[0, 1, 2]])
        >>> mesh.oriented(unit="mm", up="z").vertices[1].tolist()
        [0.0, 0.5, 0.0]
        """
        vertices = self.vertices * _METRES[unit]
        if up == "y":
            return self.replace(vertices=vertices)
        normals = None if self.normals is None else self.normals @ _Z_UP_TO_Y_UP.T
        return self.replace(vertices=vertices @ _Z_UP_TO_Y_UP.T + 0.0, normals=normals)

    def replace(self, **changes: Any) -> Mesh:
        """Return a mesh with some constructor arguments changed; the other arrays are shared."""
        unknown = set(changes) - set(self.__slots__)
        if unknown:
            raise InputError(f"replace: no such array: {', '.join(sorted(unknown))}")
        return Mesh(**{name: changes.get(name, getattr(self, name)) for name in self.__slots__})

    def __repr__(self) -> str:
        parts = [
            counted(self.num_vertices, "vertex", "vertices"),
            counted(self.num_faces, "face"),
        ]
        if self.texcoords is not None:
            parts.append(counted(len(self.texcoords), "texture coordinate"))
        if self.materials:
            parts.append(counted(len(self.materials), "material"))
        return f"<manip3d.Mesh: {', '.join(parts)}>"


Corner = tuple[float, float, float]

# Rows of the printed table with two counts: as stored, and welded.
_PAIRED = {
    "vertices": "vertices",
    "edges": "edges",
    "boundary_edges": "boundary edges",
    "non_manifold_edges": "non-manifold edges",
    "complex_vertices": "complex vertices",
    "degenerate_faces": "degenerate faces",
    "duplicate_faces": "duplicate faces",
    "components": "components",
}
_SINGLE = {
    "zero_area_faces": "zero-area faces",
    "unreferenced_vertices": "unreferenced vertices",
    "materials_used": "materials used",
    "texcoords": "texture coordinates",
    "faces_without_uv": "faces without UV",
    "multi_uv_vertices": "multi-UV vertices",
}


@dataclass(frozen=True)
class MeshSummary:
    """Counts of a mesh: as stored, and (``..._welded``) with equal positions merged.

    Attributes
    ----------
    vertices, vertices_welded : int
        Number of stored vertices, including unreferenced ones; number of distinct positions of
        vertices that faces use.
    faces : int
        Number of triangles.
    edges, edges_welded : int
        Number of distinct edges.
    boundary_edges, boundary_edges_welded : int
        Edges of exactly one face.
    non_manifold_edges, non_manifold_edges_welded : int
        Edges of more than two faces.
    complex_vertices, complex_vertices_welded : int
        Vertices of a boundary edge whose number of boundary neighbours is not 2.
    degenerate_faces, degenerate_faces_welded : int
        Faces with a repeated vertex. All other counts except `faces` and `faces_without_uv` exclude
        them.
    duplicate_faces, duplicate_faces_welded : int
        Faces with the three vertices of an earlier face, in any orientation.
    components, components_welded : int
        Sets of faces that are connected through shared vertices.
    zero_area_faces : int
        Faces of area 0 that are not degenerate as stored.
    unreferenced_vertices : int
        Vertices that no face uses.
    materials_used : int
        Number of distinct materials of the faces.
    texcoords : int
        Number of rows of the table of texture coordinates.
    faces_without_uv : int
        Faces with at least one corner that has no texture coordinate.
    multi_uv_vertices : int
        Welded vertices with more than one distinct texture coordinate.
    closed : bool
        Whether there are faces and, after welding, no boundary edges.
    has_normals, has_colors : bool
        Whether the mesh has normals, and vertex colours.
    bounds : ((x, y, z), (x, y, z)) float
        Lowest and highest corner of the bounding box of the vertices that faces use.
    """

    vertices: int
    vertices_welded: int
    faces: int
    edges: int
    edges_welded: int
    boundary_edges: int
    boundary_edges_welded: int
    non_manifold_edges: int
    non_manifold_edges_welded: int
    complex_vertices: int
    complex_vertices_welded: int
    degenerate_faces: int
    degenerate_faces_welded: int
    duplicate_faces: int
    duplicate_faces_welded: int
    components: int
    components_welded: int
    zero_area_faces: int
    unreferenced_vertices: int
    materials_used: int
    texcoords: int
    faces_without_uv: int
    multi_uv_vertices: int
    closed: bool
    has_normals: bool
    has_colors: bool
    bounds: tuple[Corner, Corner]

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, as values that can be written as JSON."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        """Return a table for a terminal, with one row per count, as stored and welded."""
        lines = [f"{'':24}{'stored':>14}{'welded':>14}", f"{'faces':24}{self.faces:>14}"]
        for name, title in _PAIRED.items():
            stored, welded = getattr(self, name), getattr(self, f"{name}_welded")
            lines.append(f"{title:24}{stored:>14}{welded:>14}")
        for name, title in _SINGLE.items():
            lines.append(f"{title:24}{getattr(self, name):>14}")
        for name in ("closed", "has_normals", "has_colors"):
            answer = "yes" if getattr(self, name) else "no"
            lines.append(f"{name.removeprefix('has_'):24}{answer:>14}")
        for title, corner in zip(("lowest corner", "highest corner"), self.bounds, strict=True):
            lines.append(f"{title:24}" + "".join(f"{x:>14.6g}" for x in corner))
        return "\n".join(lines)


def summarize(mesh: Mesh) -> MeshSummary:
    """Count vertices, edges, defects and attributes; see :meth:`manip3d.Mesh.summary`."""
    fields = _core.summarize(mesh)
    low, high = fields.pop("bounds").tolist()
    return MeshSummary(**fields, bounds=(tuple(low), tuple(high)))
