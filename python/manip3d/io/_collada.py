"""Reader of meshes in COLLADA files (1.4 and 1.5): all geometries of the scene, transformed.

Robot descriptions (URDF), SketchUp, Blender and old game assets use ``.dae``. Skins are read in
their bind pose, morphs in their base shape; animations, cameras and lights are ignored.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote

import numpy as np

from manip3d import _core
from manip3d._util.linear import product
from manip3d._util.text_files import parse_xml_bytes
from manip3d.errors import FormatError, InputError
from manip3d.io._pieces import NONE, Piece, join
from manip3d.mesh import Material, Mesh, Texture, Wrap

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

SUFFIX = ".dae"

_MAX_BYTES, _MAX_RATIO = 64 << 20, 100
"""Limits of the memory of a scene, which may instance a geometry many times: bytes, and ratio to
the file's size; the larger one holds, as for glTF."""
_BYTES_A_CORNER, _BYTES_A_VERTEX, _BYTES_A_PLACE = 25, 24, 2048
"""Memory of an index of a corner, of a vertex (three doubles) and of an instance, in bytes."""
_DEEPEST = 192
"""Largest depth of nested nodes. Each bone is nested in the one before, and tails and ropes have
many bones."""
# Largest depth of XML elements: that of nodes and of their content.
_DEEPEST_ELEMENT = _DEEPEST + 64
_POLYGONS = ("triangles", "polylist", "polygons", "tristrips", "trifans")
_LINES = ("lines", "linestrips")

_Look = Callable[[float], None] | None


@dataclass
class _Input:
    """An attribute of corners: the table ``source``, and the offset of its index in each corner."""

    source: str
    offset: int
    set: int


@dataclass
class _Shape:
    """Polygons with one material symbol; ``table`` has a row of indices for each corner."""

    symbol: str
    inputs: dict[str, _Input]
    table: NDArray[np.int64]
    counts: NDArray[np.int32]
    """Number of corners of each polygon."""


@dataclass
class _Placed:
    geometry: Element
    matrix: NDArray[np.float64]
    materials: dict[str, str] = field(default_factory=dict)
    """Material id of each symbol."""


def read(
    data: bytes, folder: Path | None, limit: int, look: _Look = None, *, allow_outside: bool = False
) -> tuple[Mesh, int, list[str]]:
    """Return the mesh of a file, the number of its polygons, and warnings about parts left out.

    Raises
    ------
    FormatError
        The file is damaged, or its instances would take more than the limit of memory. The error
        does not name the file.
    """
    text = _up_to_end(data)
    document = _Document(parse_xml_bytes(text, "", look, max_depth=_DEEPEST_ELEMENT))
    if data[len(text) :].strip(b"\0"):
        document.warn("bytes behind the end of the document are left out")
    looks = _Materials(document, folder, allow_outside=allow_outside)
    geometries: dict[int, _Geometry] = {}
    pieces, num_polygons = [], 0
    with np.errstate(over="ignore", invalid="ignore"):  # join() refuses values that are not finite
        for each in _Scene(document, limit or max(_MAX_BYTES, _MAX_RATIO * len(data))).placed():
            geometry = geometries.get(id(each.geometry))
            if geometry is None:
                geometry = _Geometry(document, each.geometry)
                geometries[id(each.geometry)] = geometry
            num_polygons += geometry.num_polygons
            numbers = [looks.number(symbol, each.materials) for symbol in geometry.symbols]
            pieces.append(geometry.piece(numbers).placed(each.matrix))
    if not any(len(piece.faces) for piece in pieces):
        raise FormatError("expected polygons in the geometries of the scene, got none")
    return join(pieces, looks.materials, document.warn), num_polygons, document.warnings


def _up_to_end(data: bytes) -> bytes:
    """Return the file without what follows the last tag and a NUL.

    Some files were written over longer ones.
    """
    text = data[: data.find(b"\0")] if b"\0" in data else data
    return text if text.rstrip().endswith(b"COLLADA>") else data


# --- The document -----------------------------------------------------------------------------


class _Document:
    """The elements of a file by their ids, and the warnings."""

    def __init__(self, root: Element) -> None:
        for element in root.iter():
            element.tag = element.tag.rpartition(":")[2]
        if root.tag != "COLLADA":
            raise FormatError(f"expected the element COLLADA, got {root.tag[:40]}")
        self.root = root
        self.ids = _ids_in(root)
        self.warnings: list[str] = []

    def warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)

    def named(
        self, reference: str | None, *tags: str, first: Mapping[str, Element] | None = None
    ) -> Element:
        """Return the element with the id in ``#id``, which must have one of these tags.

        The ids in ``first`` have precedence, because some exporters use the same ids in each
        geometry.
        """
        name = (reference or "").removeprefix("#")
        found = first.get(name) if first is not None else None
        if found is None:
            found = self.ids.get(name)
        if found is None or found.tag not in tags:
            raise FormatError(f"expected the id of a {' or '.join(tags)}, got {reference!r:.60}")
        return found


def _ids_in(root: Element) -> dict[str, Element]:
    found: dict[str, Element] = {}
    for element in root.iter():
        if "id" in element.attrib:
            found.setdefault(element.attrib["id"], element)
    return found


def _numbers(element: Element | None) -> NDArray[np.float64]:
    text = (element.text or "") if element is not None else ""
    # Old exporters write 1,5 for 1.5 if the computer's language uses a decimal comma.
    words = text.replace(",", ".").split()
    try:
        return np.fromiter(map(float, words), np.float64, len(words))
    except ValueError as error:
        assert element is not None
        raise FormatError(f"{element.tag}: {error}") from None


def _whole_numbers(element: Element) -> NDArray[np.int64]:
    words = (element.text or "").split()
    try:
        return np.fromiter(map(int, words), np.int64, len(words))
    except (ValueError, OverflowError) as error:
        raise FormatError(f"{element.tag}: {error}") from None


def _whole(element: Element, name: str, default: int) -> int:
    text = element.get(name, str(default))
    if not re.fullmatch(r"\s*\d{1,9}\s*", text):
        raise FormatError(f"{element.tag}: {name}: expected a whole number, got {text!r:.40}")
    return int(text)


# --- The scene --------------------------------------------------------------------------------


class _Scene:
    """The scene graph, which instances geometries."""

    def __init__(self, document: _Document, most_bytes: int) -> None:
        self.document, self.most_bytes = document, most_bytes
        self.sizes: dict[int, int] = {}

    def placed(self) -> list[_Placed]:
        """Return each instance of each geometry; without a scene, each geometry once."""
        roots = self.root_nodes()
        if roots is None:
            return [_Placed(each, np.eye(4)) for each in self.document.root.iter("geometry")]
        total = sum(self.size(node, 0) for node in roots)
        if total > self.most_bytes:
            raise FormatError(
                f"the scene takes {total} bytes, more than {self.most_bytes}; "
                "set max_bytes to read it"
            )
        return [each for node in roots for each in self.below(node, np.eye(4))]

    def root_nodes(self) -> list[Element] | None:
        named = self.document.root.find("scene/instance_visual_scene")
        if named is not None:
            scene: Element | None = self.document.named(named.get("url"), "visual_scene")
        else:
            scene = self.document.root.find("library_visual_scenes/visual_scene")
        return None if scene is None else scene.findall("node")

    def size(self, node: Element, depth: int) -> int:
        """Return an upper bound of the memory of a node and all nodes below it, in bytes."""
        if depth > _DEEPEST:
            raise FormatError(f"nodes within nodes, more than {_DEEPEST} deep")
        if id(node) not in self.sizes:
            own = sum(self.size_of_geometry(self.geometry(each)) for each in _instances(node))
            below = sum(self.size(each, depth + 1) for each in self.children(node))
            self.sizes[id(node)] = own + below
        return self.sizes[id(node)]

    def size_of_geometry(self, geometry: Element) -> int:
        """Return an upper bound of a geometry's memory, in bytes.

        A number takes at least two characters, a digit and a space.
        """
        if id(geometry) not in self.sizes:
            lengths = {"p": 0, "float_array": 0}
            for element in geometry.iter():
                if element.tag in lengths:
                    lengths[element.tag] += len(element.text or "") // 2
            corners, vertices = lengths["p"], lengths["float_array"] // 3
            self.sizes[id(geometry)] = (
                _BYTES_A_PLACE + corners * _BYTES_A_CORNER + vertices * _BYTES_A_VERTEX
            )
        return self.sizes[id(geometry)]

    def children(self, node: Element) -> Iterator[Element]:
        yield from node.findall("node")
        for each in node.findall("instance_node"):
            if each.get("url", "").startswith("#"):
                yield self.document.named(each.get("url"), "node")
            else:
                self.document.warn("nodes of other files are left out")

    def geometry(self, instance: Element) -> Element:
        """Return the geometry of an instance, through its controllers if it has any."""
        element = self.document.named(instance.get("url"), "geometry", "controller")
        for _ in range(_DEEPEST):
            if element.tag == "geometry":
                return element
            deformer = next((each for each in element if each.tag in ("skin", "morph")), element)
            self.document.warn(f"the {deformer.tag} of a geometry is left out")
            element = self.document.named(deformer.get("source"), "geometry", "controller")
        raise FormatError(f"controllers of controllers, more than {_DEEPEST} deep")

    def below(self, node: Element, above: NDArray[np.float64]) -> Iterator[_Placed]:
        """Yield the geometries below a node. Matrices act on row vectors: (x, y, z, 1) @ matrix."""
        if self.sizes[id(node)] == 0:
            return
        matrix = product(_transform(node), above)
        for instance in _instances(node):
            bound = self.bind_shape(instance)
            at = matrix if bound is None else bound
            yield _Placed(self.geometry(instance), at, _bindings(instance))
        for child in self.children(node):
            yield from self.below(child, matrix)

    def bind_shape(self, instance: Element) -> NDArray[np.float64] | None:
        """Return the bind shape matrix of a skin; None for other instances.

        It replaces the matrix of the node, because a skin is placed by its bones.
        """
        if instance.tag != "instance_controller":
            return None
        skin = self.document.named(instance.get("url"), "controller").find("skin")
        if skin is None:
            return None
        matrix = skin.find("bind_shape_matrix")
        return np.eye(4) if matrix is None else _matrix(matrix)


def _instances(node: Element) -> list[Element]:
    return [each for each in node if each.tag in ("instance_geometry", "instance_controller")]


def _bindings(instance: Element) -> dict[str, str]:
    return {
        each.get("symbol", ""): each.get("target", "").removeprefix("#")
        for each in instance.iter("instance_material")
    }


def _transform(node: Element) -> NDArray[np.float64]:
    """Return the product of a node's transforms for row vectors; the last transform acts first."""
    matrix = np.eye(4)
    for element in node:
        make = _TRANSFORMS.get(element.tag)
        if make is not None:
            matrix = product(make(element), matrix)
    return matrix


def _values(element: Element, count: int) -> NDArray[np.float64]:
    values = _numbers(element)
    if len(values) != count or not np.isfinite(values).all():
        raise FormatError(f"{element.tag}: expected {count} finite numbers, got {len(values)}")
    return values


def _matrix(element: Element) -> NDArray[np.float64]:
    return _values(element, 16).reshape(4, 4).T


def _translate(element: Element) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[3, :3] = _values(element, 3)
    return matrix


def _scale(element: Element) -> NDArray[np.float64]:
    return np.diag([*_values(element, 3), 1.0])


def _rotate(element: Element) -> NDArray[np.float64]:
    """Return a rotation by Rodrigues' formula; the identity if the axis has length 0."""
    *axis, degrees = _values(element, 4)
    length = float(np.linalg.norm(axis, axis=-1))
    matrix = np.eye(4)
    if not 0.0 < length < np.inf:
        return matrix
    x, y, z = np.asarray(axis) / length
    cross = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    angle = np.deg2rad(degrees)
    matrix[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * product(cross, cross)
    return matrix


def _lookat(element: Element) -> NDArray[np.float64]:
    """Return the place of a node that looks along its -z axis; not turned if it looks nowhere."""
    eye, target, up = _values(element, 9).reshape(3, 3)
    matrix = np.eye(4)
    matrix[3, :3] = eye
    back, right = eye - target, np.cross(up, eye - target)
    lengths = float(np.linalg.norm(back, axis=-1)), float(np.linalg.norm(right, axis=-1))
    if min(lengths) > 0.0 and max(lengths) < np.inf:
        back, right = back / lengths[0], right / lengths[1]
        matrix[:3, :3] = right, np.cross(back, right), back
    return matrix


def _skew(element: Element) -> NDArray[np.float64]:
    """Return RenderMan's skew, a shift along one axis by the tangent of the place on another."""
    degrees, *axes = _values(element, 7)
    along, shifted = np.reshape(axes, (2, 3))
    lengths = float(np.linalg.norm(along, axis=-1)) * float(np.linalg.norm(shifted, axis=-1))
    matrix = np.eye(4)
    if 0.0 < lengths < np.inf:
        matrix[:3, :3] += np.tan(np.deg2rad(degrees)) * np.outer(along, shifted) / lengths
    return matrix


_TRANSFORMS: dict[str, Callable[[Element], NDArray[np.float64]]] = {
    "matrix": _matrix,
    "translate": _translate,
    "rotate": _rotate,
    "scale": _scale,
    "lookat": _lookat,
    "skew": _skew,
}


# --- Geometries -------------------------------------------------------------------------------


class _Geometry:
    """The polygons of a geometry, triangulated."""

    def __init__(self, document: _Document, geometry: Element) -> None:
        self.document = document
        self.ids = _ids_in(geometry)
        self.name = geometry.get("name") or geometry.get("id", "")
        self.sources: dict[str, NDArray[np.float64]] = {}
        self.symbols: list[str] = []
        self.num_polygons = 0
        mesh = geometry.find("mesh")
        if mesh is None:
            document.warn(f"geometry '{self.name}' is no mesh and is left out")
            self.plain = Piece.plain(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
            return
        shapes = [self.shape(each) for each in mesh if each.tag in _POLYGONS]
        if any(mesh.find(tag) is not None for tag in _LINES):
            document.warn("lines are left out")
        self.plain = self.joined([shape for shape in shapes if len(shape.table)])

    def piece(self, materials: list[int]) -> Piece:
        """Return the mesh with the given material number for each symbol."""
        return replace(self.plain, material=np.array([*materials, NONE])[self.plain.material])

    def fail(self, reason: str) -> FormatError:
        return FormatError(f"geometry '{self.name}': {reason}")

    def named(self, reference: str, tag: str) -> Element:
        return self.document.named(reference, tag, first=self.ids)

    def shape(self, element: Element) -> _Shape:
        inputs, stride = self.inputs(element)
        lists = [_whole_numbers(each) for each in element.findall("p")]
        if element.find("ph") is not None:
            self.document.warn("polygons with holes are left out")
        if any(len(each) % stride for each in lists):
            raise self.fail(f"{element.tag}: expected {stride} numbers for each corner")
        tables = [each.reshape(-1, stride) for each in lists]
        if element.tag in ("tristrips", "trifans"):
            tables = [_triangles_of(element.tag, each) for each in tables]
        table = np.concatenate(tables) if tables else np.empty((0, stride), dtype=np.int64)
        if element.tag == "polylist":
            vcount = element.find("vcount")
            counts = np.empty(0, np.int64) if vcount is None else _whole_numbers(vcount)
        elif element.tag == "polygons":
            counts = np.array([len(each) for each in tables], dtype=np.int64)
        else:
            counts = np.full(len(table) // 3, 3)
        is_possible = (counts >= 0) & (counts <= len(table))  # the sum of other counts may overflow
        if not is_possible.all() or counts.sum() != len(table):
            raise self.fail(f"{element.tag}: got {len(table)} corners for {counts.sum()}")
        self.num_polygons += len(counts)
        return _Shape(element.get("material", ""), inputs, table, counts.astype(np.int32))

    def inputs(self, element: Element) -> tuple[dict[str, _Input], int]:
        """Return a shape's inputs by semantic, and the number of indices per corner."""
        found: dict[str, _Input] = {}
        stride = 1
        for each in element.findall("input"):
            offset, number = _whole(each, "offset", 0), _whole(each, "set", 0)
            stride = max(stride, offset + 1)
            semantic, source = each.get("semantic", ""), each.get("source", "")
            tables = [(semantic, source)]
            if semantic == "VERTEX":
                vertices = self.named(source, "vertices").findall("input")
                tables = [(v.get("semantic", ""), v.get("source", "")) for v in vertices]
            for name, table in tables:
                if name in found and name == "TEXCOORD":
                    self.document.warn("only the first set of texture coordinates is read")
                if name not in found or number < found[name].set:
                    found[name] = _Input(table, offset, number)
        return found, stride

    def source(self, reference: str, width: int) -> NDArray[np.float64]:
        """Return the rows of a source, (N, width); columns that it lacks are 0."""
        if reference not in self.sources:
            self.sources[reference] = self.rows(self.named(reference, "source"))
        rows = self.sources[reference]
        missing = np.zeros((len(rows), max(0, width - rows.shape[1])))
        return np.ascontiguousarray(np.concatenate([rows[:, :width], missing], axis=1))

    def rows(self, source: Element) -> NDArray[np.float64]:
        accessor = source.find("technique_common/accessor")
        array = source.find("float_array")
        if accessor is None or array is None:
            raise self.fail("source: expected a float_array and an accessor")
        values = _numbers(array)
        count, offset = _whole(accessor, "count", 0), _whole(accessor, "offset", 0)
        stride = max(1, _whole(accessor, "stride", 1))
        if offset + count * stride > len(values):
            raise self.fail(
                f"source: expected {offset + count * stride} numbers, got {len(values)}"
            )
        rows = values[offset : offset + count * stride].reshape(count, stride)
        parameters = accessor.findall("param")[:stride]
        has_name = ["name" in each.attrib for each in parameters]
        # A parameter without a name is skipped; but some exporters name none of them.
        return rows[:, np.flatnonzero(has_name)] if any(has_name) else rows

    def joined(self, shapes: list[_Shape]) -> Piece:
        """Return one mesh of all shapes; its material numbers index ``symbols``."""
        if not shapes:
            return Piece.plain(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
        places = {shape.inputs["POSITION"].source for shape in shapes if "POSITION" in shape.inputs}
        if len(places) != 1 or any("POSITION" not in shape.inputs for shape in shapes):
            raise self.fail("expected one source of positions")
        vertices = self.source(places.pop(), 3)
        cut = [self.triangles(shape, vertices) for shape in shapes]
        piece = Piece.plain(vertices, np.concatenate([self.table(*s, "POSITION") for s in cut]))
        piece.corners, piece.texcoords = self.property(cut, "TEXCOORD", 2)
        piece.normal_corners, piece.normals = self.property(cut, "NORMAL", 3)
        corners, colors = self.property(cut, "COLOR", 3)
        if len(colors):
            levels = np.rint(255.0 * np.clip(np.nan_to_num(colors), 0.0, 1.0)).astype(np.int64)
            packed = levels @ [1 << 16, 1 << 8, 1]
            piece.colors = np.where(corners < 0, NONE, packed[corners])
        self.symbols = list(dict.fromkeys(shape.symbol for shape in shapes))
        number_of = {symbol: number for number, symbol in enumerate(self.symbols)}
        numbers = [np.full(len(rows), number_of[shape.symbol]) for shape, rows in cut]
        piece.material = np.concatenate(numbers)
        return piece

    def triangles(
        self, shape: _Shape, vertices: NDArray[np.float64]
    ) -> tuple[_Shape, NDArray[np.int64]]:
        """Triangulate a shape; return it with the rows (T, 3) of its table at the corners."""
        if (shape.counts == 3).all():
            return shape, np.arange(len(shape.table)).reshape(-1, 3)
        numbers = shape.table[:, shape.inputs["POSITION"].offset]
        self.check(numbers, len(vertices), "POSITION")
        corners = numbers.astype(np.int32)
        return shape, _core.triangulate_polygons(vertices, corners, shape.counts).astype(np.int64)

    def table(self, shape: _Shape, rows: NDArray[np.int64], semantic: str) -> NDArray[np.int64]:
        """Return the indices (T, 3) of the triangles' corners in the table of one semantic."""
        given = shape.inputs[semantic]
        numbers = shape.table[:, given.offset][rows]
        self.check(numbers, len(self.source(given.source, 1)), semantic)
        return numbers

    def check(self, numbers: NDArray[np.int64], size: int, semantic: str) -> None:
        if len(numbers) and not 0 <= numbers.min() <= numbers.max() < size:
            wrong = numbers[(numbers < 0) | (numbers >= size)].flat[0]
            raise self.fail(f"{semantic}: expected 0 to {size - 1}, got {wrong}")

    def property(
        self, cut: list[tuple[_Shape, NDArray[np.int64]]], semantic: str, width: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the row of each triangle corner in the values of a semantic, and these values.

        The row is `NONE` for shapes without that semantic.
        """
        tables: dict[str, int] = {}
        rows_of_tables, corners, first = [np.empty((0, width))], [], 0
        for shape, rows in cut:
            given = shape.inputs.get(semantic)
            if given is None:
                corners.append(np.full(rows.shape, NONE))
                continue
            if given.source not in tables:
                tables[given.source] = first
                rows_of_tables.append(self.source(given.source, width))
                first += len(rows_of_tables[-1])
            corners.append(self.table(shape, rows, semantic) + tables[given.source])
        return np.concatenate(corners), np.concatenate(rows_of_tables)


def _triangles_of(kind: str, strip: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the corners of the triangles of a strip or of a fan, three rows each."""
    first = np.arange(max(0, len(strip) - 2))
    if kind == "trifans":
        corners = np.stack([np.zeros_like(first), first + 1, first + 2], axis=1)
    else:
        odd = first % 2
        corners = np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)
    return strip[corners.ravel()]


# --- Materials --------------------------------------------------------------------------------


class _Materials:
    """Materials of the faces, in the order of their first use."""

    def __init__(self, document: _Document, folder: Path | None, *, allow_outside: bool) -> None:
        self.document, self.folder, self.allow_outside = document, folder, allow_outside
        self.materials: list[Material] = []
        self.numbers: dict[str, int] = {}

    def number(self, symbol: str, bound: dict[str, str]) -> int:
        """Return the number of the material bound to a symbol, or else of that id; or `NONE`."""
        name = bound.get(symbol, symbol)
        element = self.document.ids.get(name)
        if element is None or element.tag != "material":
            return NONE
        if name not in self.numbers:
            self.numbers[name] = len(self.materials)
            self.materials.append(self.material(element))
        return self.numbers[name]

    def material(self, element: Element) -> Material:
        name = element.get("name") or element.get("id") or ""
        instance = element.find("instance_effect")
        url = "" if instance is None else instance.get("url", "")
        effect = self.document.ids.get(url.removeprefix("#"))
        profile = None if effect is None else effect.find("profile_COMMON")
        shader = None if profile is None else _shader(profile)
        if profile is None or shader is None:
            return Material(name=name)
        alpha = _alpha(shader)
        red, green, blue, _ = _color(shader.find("diffuse/color")) or (1.0, 1.0, 1.0, 1.0)
        textures = {}
        for role, place in (("base_color", "diffuse"), ("emissive", "emission")):
            image = self.image_of(profile, shader, place)
            if image is not None:
                textures[role] = image
        holes = self.image_of(profile, shader, "transparent")
        shares_image = holes is not None and holes == textures.get("base_color")
        has_holes = shares_image and _opaque_mode(shader) == "A_ONE"
        if holes is not None and not has_holes:
            self.document.warn(f"the texture of the transparency of material '{name}' is left out")
        emission = _color(shader.find("emission/color")) or (0.0, 0.0, 0.0, 1.0)
        return Material(
            name=name,
            base_color=(red, green, blue, alpha),
            alpha_mode="blend" if alpha < 1.0 or has_holes else "opaque",
            textures=textures,
            emissive=emission[:3],
        )

    def image_of(self, profile: Element, shader: Element, place: str) -> Texture | None:
        named = shader.find(f"{place}/texture")
        return None if named is None else self.image(profile, named.get("texture", ""))

    def image(self, profile: Element, reference: str) -> Texture | None:
        """Return the image of a texture, named by a sampler (COLLADA 1.4, 1.5) or directly."""
        sampler: Element | None = None
        for _ in range(3):  # sampler, surface, image
            parameter = next(
                (p for p in profile.iter("newparam") if p.get("sid") == reference), None
            )
            if parameter is None:
                break
            sampler = parameter.find("sampler2D") if sampler is None else sampler
            following = [
                *parameter.findall("sampler2D/source"),
                *parameter.findall("surface/init_from"),
            ]
            named = parameter.find("sampler2D/instance_image")
            if named is not None:
                reference = named.get("url", "").removeprefix("#")
            elif following:
                reference = (following[0].text or "").strip()
        image = self.document.ids.get(reference)
        if image is None or image.tag != "image":
            return None
        path = image.findtext("init_from/ref") or image.findtext("init_from") or ""
        texture = self.texture(path.strip())
        return texture if texture is None or sampler is None else _sampled(texture, sampler)

    def texture(self, uri: str) -> Texture | None:
        path = re.sub(r"^file:/*(?=[A-Za-z]:|/)", "", unquote(uri)).replace("\\", "/")
        if not path:
            return None
        if self.folder is None:
            return Texture(path=path)
        if re.match(r"/|[A-Za-z]:", path):  # absolute path on the author's computer
            path = posixpath.basename(path)
        name = posixpath.basename(path)
        is_beside = name != path and not self.is_file(path) and self.is_file(name)
        if is_beside and not self.allow_outside:  # the folder that the file names is not here
            self.document.warn(f"texture '{path}' not found, '{name}' is used")
            path = name
        try:
            _core.resolve_inside(os.fsencode(self.folder), os.fsencode(path))
        except InputError as error:
            if self.allow_outside:
                return Texture(path=str((self.folder / path).absolute()))
            self.document.warn(f"texture left out: {error}")
            return None
        return Texture(path=path)

    def is_file(self, path: str) -> bool:
        """Return whether a path leads to a file in the folder of the document."""
        assert self.folder is not None
        try:
            inside = _core.resolve_inside(os.fsencode(self.folder), os.fsencode(path))
        except InputError:
            return False
        return Path(os.fsdecode(inside)).is_file()


def _sampled(texture: Texture, sampler: Element) -> Texture:
    """Return a texture with the wrap modes and the filter of a sampler."""
    words: dict[str, Wrap] = {"MIRROR": "mirror", "CLAMP": "clamp"}
    u, v = (words.get((sampler.findtext(f"wrap_{side}") or "").strip(), "repeat") for side in "st")
    nearest = (sampler.findtext("magfilter") or "").strip() == "NEAREST"
    return replace(texture, wrap=(u, v), smooth=not nearest)


def _shader(profile: Element) -> Element | None:
    technique = profile.find("technique")
    kinds = ("phong", "blinn", "lambert", "constant")
    if technique is None:
        return None
    return next((each for each in technique if each.tag in kinds), None)


def _color(element: Element | None) -> tuple[float, float, float, float] | None:
    if element is None:
        return None
    values = [*_numbers(element)[:4], 1.0]
    if len(values) < 4 or not np.isfinite(values).all():
        return None
    red, green, blue, alpha = np.clip(values[:4], 0.0, 1.0).tolist()
    return red, green, blue, alpha


def _opaque_mode(shader: Element) -> str:
    """Return how opacity follows from the ``transparent`` colour.

    A_ONE: alpha; RGB_ZERO: 1 - luminance; A_ZERO: 1 - alpha; RGB_ONE: luminance.
    """
    transparent = shader.find("transparent")
    return "A_ONE" if transparent is None else transparent.get("opaque", "A_ONE")


def _alpha(shader: Element) -> float:
    """Return the opacity of a shader, 0 to 1 (COLLADA 1.4.1, "Determining Transparency").

    Without ``transparent`` the shader is opaque, since exporters disagree on what ``transparency``
    alone means. An opacity of 0 becomes 1, since exporters that write it do not mean an invisible
    surface.
    """
    transparent = shader.find("transparent")
    color = None if transparent is None else _color(transparent.find("color"))
    amount = _numbers(shader.find("transparency/float"))
    share = float(np.clip(amount[0], 0.0, 1.0)) if len(amount) and np.isfinite(amount[0]) else 1.0
    if transparent is None or color is None:
        return 1.0
    red, green, blue, alpha = color
    luminance = 0.212671 * red + 0.715160 * green + 0.072169 * blue
    opaque = {
        "A_ONE": alpha * share,
        "RGB_ZERO": 1.0 - luminance * share,
        "A_ZERO": 1.0 - alpha * share,
        "RGB_ONE": luminance * share,
    }.get(_opaque_mode(shader), 1.0)
    return opaque if opaque > 0.0 else 1.0
