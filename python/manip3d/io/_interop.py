"""Conversion of meshes to and from Open3D and trimesh; the methods of `Mesh` call it."""

from __future__ import annotations

import io
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.callers import caller_level
from manip3d._util.extras import imported
from manip3d._util.linear import determinant, moved
from manip3d.errors import InputError
from manip3d.io._face_colors import with_corner_colors
from manip3d.io._images import image_bytes, with_common_images
from manip3d.mesh import AlphaMode, Material, Mesh, Texture

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ROLES = {
    "base_color": "baseColorTexture",
    "metallic_roughness": "metallicRoughnessTexture",
    "normal": "normalTexture",
    "occlusion": "occlusionTexture",
    "emissive": "emissiveTexture",
}
_ALPHA_MODES: dict[str, AlphaMode] = {"OPAQUE": "opaque", "MASK": "mask", "BLEND": "blend"}


# --- Common to both ---------------------------------------------------------------------------


def _vertex_normals(mesh: Mesh) -> NDArray[np.float64] | None:
    """Return normals (V, 3) if all corners at each vertex have the same normal, else None."""
    if mesh.normals is None or mesh.face_normals is None or (mesh.face_normals < 0).any():
        return None
    corners = mesh.normals[mesh.face_normals]
    per_vertex = np.zeros_like(mesh.vertices)
    per_vertex[mesh.faces] = corners
    return per_vertex if np.array_equal(per_vertex[mesh.faces], corners) else None


def _warn_left_out(what: str) -> None:
    warnings.warn(f"source: left out: {what}", stacklevel=caller_level())


def _texture_table(
    corners: NDArray[np.float64],
) -> tuple[NDArray[np.float64] | None, NDArray[np.int32] | None]:
    """Return the distinct rows of corner UVs (F, 3, 2), and the index (F, 3) of each corner.

    The index is -1 for corners whose UVs are not finite; both are None if all are.
    """
    known = np.isfinite(corners).all(axis=2)
    if not known.any():
        return None, None
    texcoords, index = np.unique(corners[known], axis=0, return_inverse=True)
    face_texcoords = np.full(corners.shape[:2], -1, dtype=np.int32)
    face_texcoords[known] = index.reshape(-1)
    return texcoords, face_texcoords


# --- Open3D -----------------------------------------------------------------------------------


def to_open3d(mesh: Mesh) -> Any:
    """See `Mesh.to_open3d`."""
    o3d = imported("open3d", "simulate")
    result = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces)
    )
    if mesh.texcoords is not None and mesh.face_texcoords is not None:
        with_none = np.vstack([mesh.texcoords, [np.nan, np.nan]])  # the index -1 selects NaN
        corners = with_none[mesh.face_texcoords.reshape(-1)]
        result.triangle_uvs = o3d.utility.Vector2dVector(corners)
    if mesh.face_material is not None:
        result.triangle_material_ids = o3d.utility.IntVector(mesh.face_material)
    if mesh.colors is not None:
        result.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255.0)
    normals = _vertex_normals(mesh)
    if normals is not None:
        result.vertex_normals = o3d.utility.Vector3dVector(normals)
    mesh = with_common_images(mesh)
    images = [_open3d_image(o3d, mesh, material) for material in mesh.materials]
    if any(not image.is_empty() for image in images):
        result.textures = images
    return result


def _open3d_image(o3d: Any, mesh: Mesh, material: Material) -> Any:
    texture = material.textures.get("base_color")
    data = None if texture is None else image_bytes(mesh, texture)
    if data is None:
        return o3d.geometry.Image()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("image.jpg" if data.startswith(b"\xff\xd8\xff") else "image.png")
        path.write_bytes(data)
        return o3d.io.read_image(str(path)).flip_vertical()  # v = 0 is Open3D's first image row


def from_open3d(source: Any) -> Mesh:
    """See `Mesh.from_open3d`."""
    tensor = source if hasattr(source, "to_legacy") else None
    if tensor is not None:
        source = tensor.to_legacy()
    if not hasattr(source, "has_triangle_uvs"):  # trimesh's meshes have triangles, too
        raise InputError(f"source: expected an Open3D TriangleMesh, got {type(source)}")
    if tensor is not None and "colors" in tensor.triangle:
        _warn_left_out(_FACE_COLORS)
    faces = np.array(source.triangles, dtype=np.int32)  # a copy: Open3D changes and frees its own
    texcoords, face_texcoords = None, None
    if source.has_triangle_uvs():
        texcoords, face_texcoords = _texture_table(
            np.asarray(source.triangle_uvs).reshape(len(faces), 3, 2)
        )
    has_normals = source.has_vertex_normals()
    face_material = (
        np.array(source.triangle_material_ids, dtype=np.int32)
        if source.has_triangle_material_ids()
        else None
    )
    materials = _open3d_materials(source, face_material)
    if tensor is not None and tensor.has_valid_material() and not materials:
        materials = [_open3d_tensor_material(tensor.material)]
    if face_material is None and len(materials) == 1:  # a single material belongs to all faces
        face_material = np.zeros(len(faces), np.int32)
    elif face_material is None and materials:
        _warn_left_out(f"which face has which of the {len(materials)} textures: no face says so")
    colors = None
    if source.has_vertex_colors():
        colors = np.rint(255 * np.clip(np.asarray(source.vertex_colors), 0, 1)).astype(np.uint8)
    return Mesh(
        np.array(source.vertices),
        faces,
        texcoords=texcoords,
        face_texcoords=face_texcoords,
        normals=np.array(source.vertex_normals) if has_normals else None,
        face_normals=faces.copy() if has_normals else None,
        colors=colors,
        face_material=face_material,
        materials=materials,
    )


def _open3d_materials(source: Any, face_material: NDArray[np.int32] | None) -> list[Material]:
    images = list(source.textures)
    used = 0 if face_material is None or not face_material.size else int(face_material.max()) + 1
    return [
        Material(
            f"material_{i}",
            textures={"base_color": Texture(data=_open3d_png(images[i]))}
            if i < len(images) and not images[i].is_empty()
            else {},
        )
        for i in range(max(used, len(images)))
    ]


_OPEN3D_MAPS = {"albedo": "base_color", "normal": "normal", "ao": "occlusion"}
"""Names of texture maps in Open3D's tensor meshes, with the role in `Material.textures`."""


def _open3d_tensor_material(material: Any) -> Material:
    maps, scalars, vectors = (
        dict(material.texture_maps),
        dict(material.scalar_properties),
        dict(material.vector_properties),
    )
    if others := sorted(set(maps) - set(_OPEN3D_MAPS)):
        _warn_left_out(f"texture maps of the material: {', '.join(others)}")
    red, green, blue, alpha = np.asarray(vectors.get("base_color", (1.0,) * 4), float).tolist()
    return Material(
        "material_0",
        base_color=(red, green, blue, alpha),
        metallic=float(scalars.get("metallic", 0.0)),
        roughness=float(scalars.get("roughness", 1.0)),
        textures={
            role: Texture(data=_open3d_png(maps[name].to_legacy()))
            for name, role in _OPEN3D_MAPS.items()
            if name in maps
        },
    )


def _open3d_png(image: Any) -> bytes:
    o3d = imported("open3d", "simulate")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "image.png"
        if not o3d.io.write_image(str(path), image.flip_vertical()):
            raise InputError("source: Open3D cannot write one of its textures as PNG")
        return path.read_bytes()


# --- trimesh ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """Faces that trimesh can hold in one mesh: one material, all with UVs or all without."""

    material: int
    vertices: NDArray[np.int32]  # (N,) row numbers in Mesh.vertices, repeated at texture seams
    texcoords: NDArray[np.int32] | None  # (N,) row numbers in Mesh.texcoords
    faces: NDArray[np.int64]  # (M, 3) indices into `vertices` and `texcoords`


def _parts(mesh: Mesh) -> Iterator[_Part]:
    material = mesh.face_material
    if material is None:
        material = np.full(mesh.num_faces, -1, dtype=np.int32)
    if mesh.face_texcoords is None:
        has_uv = np.zeros(mesh.num_faces, dtype=np.bool_)
    else:
        has_uv = np.all(mesh.face_texcoords >= 0, axis=1)
    for index, uv in np.unique(np.column_stack([material, has_uv]), axis=0):
        selected = (material == index) & (has_uv == bool(uv))
        vertex = mesh.faces[selected].reshape(-1)
        if uv and mesh.face_texcoords is not None:
            corners = np.column_stack([vertex, mesh.face_texcoords[selected].reshape(-1)])
            rows, inverse = np.unique(corners, axis=0, return_inverse=True)
            yield _Part(int(index), rows[:, 0], rows[:, 1], inverse.reshape(-1, 3))
        else:
            used, inverse = np.unique(vertex, return_inverse=True)
            yield _Part(int(index), used, None, inverse.reshape(-1, 3))


def to_trimesh(mesh: Mesh, *, geometry_only: bool = False) -> Any:
    """See `Mesh.to_trimesh`."""
    trimesh = imported("trimesh", "io")
    if geometry_only:
        return trimesh.Trimesh(
            vertices=mesh.vertices.copy(),  # trimesh changes its arrays in place
            faces=mesh.faces,
            vertex_normals=_vertex_normals(mesh),
            vertex_colors=mesh.colors,
            process=False,
        )
    normals = _vertex_normals(mesh)
    materials = [_trimesh_material(trimesh, mesh, m) for m in mesh.materials]
    parts = [_trimesh_part(trimesh, mesh, part, materials, normals) for part in _parts(mesh)]
    if not parts:
        return trimesh.Trimesh(vertices=mesh.vertices.copy(), process=False)
    if len(parts) == 1:
        return parts[0]
    scene = trimesh.Scene()
    for i, part in enumerate(parts):
        scene.add_geometry(part, geom_name=f"part_{i:04d}", node_name=f"part_{i:04d}")
    return scene


def _trimesh_part(
    trimesh: Any,
    mesh: Mesh,
    part: _Part,
    materials: list[Any],
    normals: NDArray[np.float64] | None,
) -> Any:
    """Return a trimesh.Trimesh of one part; ``normals`` (V, 3) belong to the mesh's vertices.

    If the part has a material or UVs, its vertex colours become the vertex attribute ``color``,
    because a visual of trimesh has either a texture or colours.
    """
    colors = None if mesh.colors is None else mesh.colors[part.vertices]
    result = trimesh.Trimesh(
        vertices=mesh.vertices[part.vertices],
        faces=part.faces,
        vertex_normals=None if normals is None else normals[part.vertices],
        process=False,
    )
    has_material = 0 <= part.material < len(materials)
    uv = None
    if part.texcoords is not None and mesh.texcoords is not None:
        uv = mesh.texcoords[part.texcoords]
    if has_material or uv is not None:
        material = (
            materials[part.material] if has_material else trimesh.visual.material.PBRMaterial()
        )
        result.visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
        if colors is not None:
            result.vertex_attributes["color"] = colors
    elif colors is not None:
        result.visual = trimesh.visual.ColorVisuals(result, vertex_colors=colors)
    return result


def _trimesh_material(trimesh: Any, mesh: Mesh, material: Material) -> Any:
    images = {}
    for role, texture in material.textures.items():
        data = image_bytes(mesh, texture)
        if data is not None:
            image = imported("PIL.Image", "io").open(io.BytesIO(data))
            image.load()
            images[_ROLES[role]] = image
    light = material.emissive
    if _ROLES["emissive"] in images and not any(light):
        light = (1.0, 1.0, 1.0)
    return trimesh.visual.material.PBRMaterial(
        name=material.name,
        emissiveFactor=light if any(light) else None,
        baseColorFactor=np.rint(255 * np.asarray(material.base_color)).astype(np.uint8),
        metallicFactor=material.metallic,
        roughnessFactor=material.roughness,
        alphaMode=material.alpha_mode.upper(),
        alphaCutoff=material.alpha_cutoff if material.alpha_mode == "mask" else None,
        doubleSided=material.double_sided,
        **images,
    )


def from_trimesh(source: Any) -> Mesh:
    """See `Mesh.from_trimesh`."""
    trimesh = imported("trimesh", "io")
    if isinstance(source, trimesh.Trimesh):
        placed = [(source, np.eye(4))]
    elif isinstance(source, trimesh.Scene):
        geometries = [
            (source.geometry[geometry], transform)
            for transform, geometry in (source.graph[n] for n in source.graph.nodes_geometry)
        ]
        placed = [pair for pair in geometries if isinstance(pair[0], trimesh.Trimesh)]
        if others := len(geometries) - len(placed):
            _warn_left_out(f"{others} of {len(geometries)} geometries, which are no meshes")
    else:
        raise InputError(f"source: expected a trimesh.Trimesh or Scene, got {type(source)}")
    sources = [m for m, _ in placed]
    materials, face_material = _trimesh_materials(sources)
    starts = np.cumsum([0, *(len(m.vertices) for m in sources)])
    corners = [_trimesh_corners(m) for m in sources]
    faces = [
        _outward(np.asarray(m.faces), t) + start
        for (m, t), start in zip(placed, starts, strict=False)
    ]
    uvs = [
        _outward(corner, transform) for corner, (_, transform) in zip(corners, placed, strict=True)
    ]
    texcoords, face_texcoords = _texture_table(np.concatenate([np.empty((0, 3, 2)), *uvs]))
    result = Mesh(
        np.concatenate([np.empty((0, 3)), *(moved(m.vertices, t) for m, t in placed)]),
        np.concatenate([np.empty((0, 3), dtype=np.int64), *faces]),
        texcoords=texcoords,
        face_texcoords=face_texcoords,
        colors=_trimesh_colors(sources),
        face_material=face_material if materials else None,
        materials=materials,
    )
    return _with_face_colors(result, sources)


def _with_face_colors(mesh: Mesh, sources: list[Any]) -> Mesh:
    """Return the mesh with the sources' face colours as materials or vertex colours."""
    colors = [_trimesh_face_colors(each) for each in sources]
    packed = np.concatenate([np.empty(0, dtype=np.int64), *colors])
    if (packed < 0).all():
        return mesh
    if mesh.colors is not None:
        _warn_left_out("colours of faces: there are those of vertices")
        return mesh

    def tell(text: str) -> None:
        warnings.warn(f"source: {text}", stacklevel=caller_level())

    return with_corner_colors(mesh, np.repeat(packed[:, None], 3, axis=1), tell)


def _trimesh_face_colors(mesh: Any) -> NDArray[np.int64]:
    """Return the colours of faces, (F,) 0xRRGGBB; -1 if the mesh has no face colours."""
    if mesh.visual.kind != "face":
        return np.full(len(mesh.faces), -1, dtype=np.int64)
    colors = np.asarray(mesh.visual.face_colors, dtype=np.int64)
    if (colors[:, 3] < 255).any():
        _warn_left_out("transparency of colours of faces")
    packed: NDArray[np.int64] = colors[:, 0] << 16 | colors[:, 1] << 8 | colors[:, 2]
    return packed


def _outward(corners: NDArray[Any], transform: NDArray[np.float64]) -> NDArray[Any]:
    """Return corners of faces, in reverse order if the transform mirrors the mesh."""
    return corners[:, ::-1] if determinant(transform[:3, :3]) < 0 else corners


def _trimesh_corners(mesh: Any) -> NDArray[np.float64]:
    """Return the UVs (F, 3, 2) of the corners; NaN if the mesh has none."""
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or len(uv) != len(mesh.vertices):
        return np.full((len(mesh.faces), 3, 2), np.nan)
    corners: NDArray[np.float64] = np.asarray(uv, dtype=np.float64)[:, :2][mesh.faces]
    return corners


_FACE_COLORS = "colours of faces: a Mesh has them by vertex"


def _trimesh_colors(meshes: list[Any]) -> NDArray[np.uint8] | None:
    """Return vertex colours (V, 3), or None if no mesh has any.

    Meshes without them get white, which is neutral where colours are multiplied.
    """
    found = []
    is_any = False
    for mesh in meshes:
        colors = mesh.vertex_attributes.get("color")
        if colors is None and mesh.visual.kind == "vertex":
            colors = mesh.visual.vertex_colors
        if colors is None:
            found.append(np.full((len(mesh.vertices), 3), 255, np.uint8))
            continue
        is_any = True
        colors = np.asarray(colors)
        if colors.ndim != 2 or colors.shape[1] < 3:
            raise InputError(
                'source: expected (V, 3) or (V, 4) for vertex_attributes["color"], got '
                f"{colors.shape}"
            )
        if colors.shape[1] > 3 and (colors[:, 3] < 255).any():
            _warn_left_out("transparency of vertex colours")
        found.append(colors[:, :3])
    return np.concatenate(found) if is_any else None


def _trimesh_materials(meshes: list[Any]) -> tuple[list[Material], NDArray[np.int32]]:
    """Return the distinct materials (by object identity), and the material index of each face."""
    index: dict[int, int] = {}
    materials: list[Material] = []
    per_face: list[NDArray[np.int32]] = []

    def row_of(material: Any) -> int:
        if material is None or _says_nothing(material):
            return -1
        if id(material) not in index:
            index[id(material)] = len(materials)
            materials.append(_from_trimesh_material(material))
        return index[id(material)]

    for mesh in meshes:
        material = getattr(mesh.visual, "material", None)
        several = getattr(material, "materials", None)  # only a MultiMaterial has them
        of_faces = getattr(mesh.visual, "face_materials", None)
        if several and of_faces is not None and len(of_faces) == len(mesh.faces):
            rows = np.array([row_of(each) for each in several], np.int32)
            per_face.append(rows[np.asarray(of_faces, np.int64)])
        else:
            per_face.append(np.full(len(mesh.faces), row_of(material), dtype=np.int32))
    return materials, np.concatenate([np.empty(0, dtype=np.int32), *per_face])


def _has_default_colors(material: Any) -> bool:
    """Return whether the colours of a SimpleMaterial are the grey that stands for absent ones.

    Multiplied, it would darken textures and colours of vertices.
    """
    default = imported("trimesh", "io").visual.color.DEFAULT_COLOR
    colors = [getattr(material, name, None) for name in ("ambient", "diffuse", "specular")]
    return all(color is not None and np.array_equal(color, default) for color in colors)


def _says_nothing(material: Any) -> bool:
    """Return whether all properties of the material are absent, which means no material."""
    if hasattr(material, "to_pbr"):
        is_named = getattr(material, "_name", None) is not None
        return material.image is None and not is_named and _has_default_colors(material)
    factors = ("baseColorFactor", "metallicFactor", "roughnessFactor", "emissiveFactor")
    keys = ("name", *factors, *_ROLES.values())
    return all(getattr(material, key, 0) is None for key in keys)


def _from_trimesh_material(material: Any) -> Material:
    name, metallic = material.name or "", 1.0
    if hasattr(material, "to_pbr"):  # without name and metalness, whose default is that of glTF
        is_grey, material, metallic = _has_default_colors(material), material.to_pbr(), 0.0
        if is_grey:
            material.baseColorFactor = None
    textures = {
        role: Texture(data=_png(image))
        for role, key in _ROLES.items()
        if (image := getattr(material, key, None)) is not None
    }
    color = material.baseColorFactor
    red, green, blue, alpha = (1.0, 1.0, 1.0, 1.0) if color is None else np.asarray(color) / 255.0

    def factor(value: float | None, default: float) -> float:
        return default if value is None else float(value)

    return Material(
        name=name,
        base_color=(float(red), float(green), float(blue), float(alpha)),
        metallic=factor(material.metallicFactor, metallic),
        roughness=factor(material.roughnessFactor, 1.0),
        alpha_mode=_ALPHA_MODES.get(material.alphaMode or "OPAQUE", "opaque"),
        alpha_cutoff=factor(material.alphaCutoff, 0.5),
        double_sided=bool(material.doubleSided),
        textures=textures,
        emissive=_three(material.emissiveFactor),
    )


def _three(values: Any) -> tuple[float, float, float]:
    red, green, blue = (0.0, 0.0, 0.0) if values is None else np.asarray(values).tolist()
    return red, green, blue


_PNG_MODES = ("1", "I", "I;16", "L", "LA", "P", "RGB", "RGBA")


def _png(image: Any) -> bytes:
    stream = io.BytesIO()
    if image.mode not in _PNG_MODES:  # for example CMYK and YCbCr
        image = image.convert("RGB")
    image.save(stream, format="PNG")
    return stream.getvalue()
