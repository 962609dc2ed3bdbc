"""Triangle meshes with per-corner attributes, and their materials."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from manip3d import _core
from manip3d._util.arrays import index_rows, rows
from manip3d._util.checked import checked
from manip3d._util.showing import Showable
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

AlphaMode = Literal["opaque", "mask", "blend"]

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
# Turns +z up into +y up about x: (x, y, z) -> (x, z, -y).
_Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Texture:
    """A texture image: a path, the bytes of an image file, or both.

    Attributes
    ----------
    path : str or None
        Where the image lies; relative to the mesh file it was named by unless absolute.
    data : bytes or None
        Content of a PNG or JPEG file (glTF embeds images); ``None`` when only the path is known.
    """

    path: str | None = None
    data: bytes | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Material:
    """Surface appearance, the metallic-roughness model of glTF 2.0.

    Attributes
    ----------
    name : str
    base_color : (r, g, b, a) float in [0, 1]
        Factor of the base colour texture, linear.
    metallic, roughness : float in [0, 1]
    alpha_mode : 'opaque', 'mask' or 'blend'
    alpha_cutoff : float
        Alpha below it is not drawn in mode ``mask``.
    double_sided : bool
        Whether faces are seen from behind. Only glTF files say; all others mean both sides.
    textures : dict of str to Texture
        By role: ``base_color``, ``metallic_roughness``, ``normal``, ``occlusion``, ``emissive``.
    emissive : (r, g, b) float, at least 0
        Light that the surface sends out, linear: the factor of the emissive texture where there is
        one, and (0, 0, 0) then counts as (1, 1, 1).

    Examples
    --------
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
    from manip3d.io import _interop as module  # only who converts pays for the import

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
    texcoords : (T, 2) float64, optional
        Texture coordinates, v up (OBJ's convention).
    face_texcoords : (F, 3) int32, optional
    normals : (K, 3) float64, optional
    face_normals : (F, 3) int32, optional
    colors : (V, 3) uint8, optional
        sRGB.
    face_material : (F,) int32, optional
        Index into ``materials``; -1 = none.
    materials : sequence of Material
    source : str, optional
        The file it was read from: relative texture paths start in its folder.

    Raises
    ------
    InputError
        An array has another shape, cannot be converted without loss, or indexes out of range.

    Notes
    -----
    C-contiguous arrays of the dtypes above are kept as they are, without a copy; others are
    converted.
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
        """Check indices, lengths and finiteness; arrays may have been written to since.

        Raises
        ------
        InputError
            Naming the array, the row, what was expected and what came.
        """
        _core.check_mesh(self)

    @property
    def num_vertices(self) -> int:
        """Number of vertices, unreferenced ones included."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """Number of triangles."""
        return len(self.faces)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """(2, 3) corners of the bounding box of the vertices that some face uses."""
        box: NDArray[np.float64] = _core.bounding_box(self)
        return box

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal, in the mesh's units."""
        low, high = self.bounds
        return float(np.linalg.norm(high - low, axis=-1))

    def summary(self) -> MeshSummary:
        """Counts of vertices, edges, defects and attributes, as stored and welded."""
        return summarize(self)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the mesh to a file, whole or not at all; see `manip3d.io.write_mesh`."""
        from manip3d.io import write_mesh

        write_mesh(self, path)

    def to_open3d(self) -> Any:
        """Convert to an ``open3d.geometry.TriangleMesh`` (legacy).

        Vertices and faces stay as they are, one for one. UVs become ``triangle_uvs`` (NaN where a
        corner has none), materials ``triangle_material_ids`` (-1 = none), base colour images
        ``textures`` (an empty image where a material has none or its file is missing). Normals are
        kept where each vertex has a single one; other traits of materials are lost.

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
        texture without ``triangle_material_ids`` is that of all faces. Of a tensor mesh's material
        the maps ``albedo``, ``normal`` and ``ao``, base colour, metallic and roughness are taken. A
        warning names what is left out, such as colours of faces.

        Raises
        ------
        InputError
            ``source`` is not a triangle mesh.
        """
        mesh: Mesh = _interop().from_open3d(source)
        return mesh

    def to_trimesh(self, *, geometry_only: bool = False) -> Any:
        """Convert to a ``trimesh.Trimesh``, or to a ``trimesh.Scene`` where one cannot hold it.

        A ``Trimesh`` has one UV per vertex and one material: vertices are split at seams, and
        faces of different materials, or with and without UVs, become geometries of a ``Scene``
        (``part_0000`` and so on, by material, those without UVs first). Materials become
        ``PBRMaterial``; normals are kept where each vertex has a single one.

        Parameters
        ----------
        geometry_only : bool
            Always a single ``Trimesh`` with the very vertices and faces; no UVs, no materials.

        Raises
        ------
        MissingExtraError
            trimesh is not installed, or Pillow, which its textures need.
        """
        return _interop().to_trimesh(self, geometry_only=geometry_only)

    @staticmethod
    def from_trimesh(source: Any) -> Mesh:
        """Convert from a ``trimesh.Trimesh`` or ``Scene``; the inverse of `to_trimesh`.

        Meshes of a scene are placed by its graph and put one after the other; vertices stay split
        at seams. Where some have vertex colours, the vertices of others are white. Normals are not
        taken: trimesh does not tell stored from computed ones. A warning names what else is left
        out: colours of faces, transparency of vertices, what is no mesh.

        Raises
        ------
        InputError
            ``source`` is neither.
        """
        mesh: Mesh = _interop().from_trimesh(source)
        return mesh

    @checked
    def oriented(
        self, *, unit: Literal["m", "cm", "mm", "in", "ft"] = "m", up: Literal["y", "z"] = "y"
    ) -> Mesh:
        """Return the mesh in metres with +y up, as glTF wants it.

        Parameters
        ----------
        unit : 'm', 'cm', 'mm', 'in' or 'ft'
            Unit of this mesh's coordinates.
        up : 'y' or 'z'
            Axis that points up in this mesh.

        Raises
        ------
        InputError
            Another unit or axis.

        Examples
        --------
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
        """A mesh with some of the constructor's arguments changed; the other arrays are shared."""
        unknown = set(changes) - set(self.__slots__)
        if unknown:
            raise InputError(f"replace: no such array: {', '.join(sorted(unknown))}")
        return Mesh(**{name: changes.get(name, getattr(self, name)) for name in self.__slots__})

    def __repr__(self) -> str:
        parts = [f"{self.num_vertices} vertices", f"{self.num_faces} faces"]
        if self.texcoords is not None:
            parts.append(f"{len(self.texcoords)} texture coordinates")
        if self.materials:
            parts.append(f"{len(self.materials)} materials")
        return f"<manip3d.Mesh: {', '.join(parts)}>"


Corner = tuple[float, float, float]

# Rows of the printed table that have a count as stored and a count welded.
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
    """Counts of a mesh, as stored and (``..._welded``) with equal positions taken as one vertex.

    Attributes
    ----------
    vertices, vertices_welded : int
        As stored, unreferenced ones included; distinct positions that some face uses.
    faces : int
    edges, edges_welded : int
    boundary_edges, boundary_edges_welded : int
        Edges of exactly one face.
    non_manifold_edges, non_manifold_edges_welded : int
        Edges of more than two faces.
    complex_vertices, complex_vertices_welded : int
        Vertices of a boundary edge whose number of boundary neighbours is not 2.
    degenerate_faces, degenerate_faces_welded : int
        Faces with a repeated vertex. All other counts but `faces` and `faces_without_uv` leave
        them out.
    duplicate_faces, duplicate_faces_welded : int
        Faces with the three vertices of an earlier face, in any orientation.
    components, components_welded : int
        Sets of faces that hang together through shared vertices.
    zero_area_faces : int
        Faces that are not degenerate as stored and have no area.
    unreferenced_vertices : int
        Vertices that no face uses.
    materials_used : int
        Distinct materials of the faces.
    texcoords : int
        Rows of the table of texture coordinates.
    faces_without_uv : int
        Faces with at least one corner that has no texture coordinate.
    multi_uv_vertices : int
        Welded vertices with more than one distinct texture coordinate.
    closed : bool
        There are faces and, when welded, no boundary edge.
    has_normals, has_colors : bool
    bounds : ((x, y, z), (x, y, z)) float
        Corners of the bounding box of the vertices that some face uses.
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
        """The fields by name, ready for JSON."""
        return dataclasses.asdict(self)

    def __str__(self) -> str:
        """A table for a terminal: one row per count, as stored and welded."""
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
    """Count what ``mesh`` consists of; see :meth:`manip3d.Mesh.summary`."""
    fields = _core.summarize(mesh)
    low, high = fields.pop("bounds").tolist()
    return MeshSummary(**fields, bounds=(tuple(low), tuple(high)))
