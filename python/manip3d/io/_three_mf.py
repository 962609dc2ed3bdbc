"""Reader of meshes in 3MF files: all items of the build, transformed, with their colours.

It follows the core specification 1.3 and the materials and production extensions. A file is an
archive of XML parts, whose build items refer to objects; an object is a mesh, or composed of other
objects.
"""

from __future__ import annotations

import io
import posixpath
import zipfile
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np

from manip3d import _core
from manip3d._util.linear import product
from manip3d.errors import Error, FormatError
from manip3d.io._pieces import NONE, Piece, join
from manip3d.io._scan_tables import refuse_expansion
from manip3d.mesh import Material, Mesh, Texture, Wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

SUFFIX = ".3mf"
START = b"PK\x03\x04"
"""First bytes of a zip archive."""

_RELATIONS = "_rels/.rels"
_MODEL = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
_MAX_BYTES, _MAX_RATIO = 64 << 20, 100
"""Limits of the memory of a build, which may use a mesh many times: bytes, and ratio to the file's
size; the larger one holds, as for glTF."""
_BYTES_A_FACE, _BYTES_A_VERTEX = 50, 24
"""Memory of a face and of a vertex (three doubles), in bytes."""
_DEEPEST = 64
"""Largest depth of nested objects, in levels, which keeps the recursion over them far from Python's
limit of calls."""

_Look = Callable[[float], None] | None
_Key = tuple[str, int]
"""Name of a part of the archive, and the id of an object or resource in it."""


@dataclass
class _Object:
    vertices: array[float] = field(default_factory=lambda: array("d"))
    faces: array[int] = field(default_factory=lambda: array("q"))
    """Seven numbers per face: v1 v2 v3, id of the property group, index of each corner in it."""
    group: int = NONE
    place: int = 0
    components: list[tuple[_Key, NDArray[np.float64]]] = field(default_factory=list)


@dataclass
class _Group:
    """A property group: the materials, colours or texture coordinates of face corners."""

    materials: list[Material] = field(default_factory=list)
    colors: list[int] = field(default_factory=list)
    texcoords: list[float] = field(default_factory=list)
    texture: int = NONE


@dataclass
class _Model:
    """The content of all parts of an archive."""

    objects: dict[_Key, _Object] = field(default_factory=dict)
    groups: dict[_Key, _Group] = field(default_factory=dict)
    textures: dict[_Key, Texture] = field(default_factory=dict)
    items: list[tuple[_Key, NDArray[np.float64]]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def warn(self, text: str) -> None:
        if text not in self.warnings:
            self.warnings.append(text)


def read(data: bytes, limit: int, look: _Look = None) -> tuple[Mesh, list[str]]:
    """Return the mesh of an archive, and warnings about parts left out.

    Raises
    ------
    FormatError
        The archive is damaged, or takes more memory than the limit. The error does not name the
        file.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            refuse_expansion(
                sum(entry.file_size for entry in archive.infolist()), len(data), limit, ""
            )
            model = _read_parts(archive, look)
            most = limit or max(_MAX_BYTES, _MAX_RATIO * len(data))
            return _Assembly(model, archive, most).mesh(), model.warnings
    except (Error, MemoryError):
        raise
    except Exception as error:  # zipfile and zlib raise various types for damaged files
        raise FormatError(f"damaged 3MF: {str(error) or type(error).__name__}") from error


# --- Parts of the archive ---------------------------------------------------------------------


def _read_parts(archive: zipfile.ZipFile, look: _Look) -> _Model:
    model = _Model()
    waiting = [_root_part(archive)]
    known = set(waiting)
    names = {name.lower(): name for name in archive.namelist()}
    while waiting:
        part = waiting.pop()
        stored = names.get(part.lower())
        if stored is None:
            raise FormatError(f"expected the part {part} in the archive")
        reader = _PartReader(part, model, look, is_root=len(known) == 1)
        try:
            reader.read(archive.read(stored))
        except expat.ExpatError as error:
            raise FormatError(f"{part}: {error}") from error
        for named in reader.parts - known:
            known.add(named)
            waiting.append(named)
    return model


def _root_part(archive: zipfile.ZipFile) -> str:
    """Return the root part that the archive's relationships name, or else the customary name."""
    found = []

    def start(name: str, attributes: dict[str, str]) -> None:
        if _local(name) == "Relationship" and attributes.get("Type") == _MODEL:
            found.append(attributes.get("Target", ""))

    if _RELATIONS in archive.namelist():
        _parser(start).Parse(archive.read(_RELATIONS), True)
    return _part_name(found[0] if found else "3D/3dmodel.model")


def _part_name(path: str) -> str:
    return posixpath.normpath(path.replace("\\", "/")).lstrip("/")


def _local(name: str) -> str:
    return name.rpartition(" ")[2]


def _parser(start: Callable[[str, dict[str, str]], None]) -> expat.XMLParserType:
    def refuse(*_: object) -> None:
        raise FormatError("expected XML without a document type")

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartElementHandler = start
    parser.StartDoctypeDeclHandler = refuse  # 3MF forbids DTDs, whose entities could be bombs
    return parser


class _PartReader:
    """Reads a part into the model."""

    def __init__(self, part: str, model: _Model, look: _Look, *, is_root: bool) -> None:
        self.part, self.model, self.is_root = part, model, is_root
        self.parts: set[str] = set()
        self.look = look
        self.object, self.group = _Object(), _Group()
        self.attributes: dict[str, str] = {}
        self.num_elements = 0
        self.parser = _parser(self.start)
        self.elements = {
            "vertex": self.vertex,
            "triangle": self.triangle,
            "object": self.start_object,
            "component": self.component,
            "item": self.item,
            "basematerials": self.start_group,
            "colorgroup": self.start_group,
            "texture2dgroup": self.start_group,
            "base": self.base,
            "color": self.color,
            "tex2coord": self.texcoord,
            "texture2d": self.texture,
        }

    def read(self, content: bytes) -> None:
        self.parser.Parse(content, True)

    def start(self, name: str, attributes: dict[str, str]) -> None:
        self.num_elements += 1
        if self.look is not None and self.num_elements % 65536 == 0:
            self.look(0.0)
        kind = _local(name)
        self.attributes = attributes
        handler = self.elements.get(kind)
        if handler is not None:
            handler()
        elif kind in ("compositematerials", "multiproperties"):
            self.model.warn(f"{kind} are left out")
        elif kind in ("beamlattice", "slicestack", "implicitfunction", "levelset"):
            self.model.warn(f"the {kind} of an object is left out")

    def fail(self, reason: str) -> FormatError:
        return FormatError(f"{self.part}: {reason}", line=self.parser.CurrentLineNumber)

    def whole(self, name: str, default: int | None = None) -> int:
        text = self.attributes.get(name)
        if text is None and default is not None:
            return default
        try:
            value = int(text or "")
        except ValueError:
            value = -1
        if not 0 <= value < 1 << 31:
            raise self.fail(f"{name}: expected a whole number from 0 to 2147483647, got {text!r}")
        return value

    def number(self, name: str) -> float:
        text = self.attributes.get(name, "")
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not abs(value) < np.inf:
            raise self.fail(f"{name}: expected a finite number, got {text!r}")
        return value

    def vertex(self) -> None:
        self.object.vertices.extend((self.number("x"), self.number("y"), self.number("z")))

    def triangle(self) -> None:
        given = self.attributes
        corners = self.whole("v1"), self.whole("v2"), self.whole("v3")
        group = self.object.group
        first = second = third = self.object.place
        if "pid" in given or "p1" in given:
            group = self.whole("pid", group) if group >= 0 else self.whole("pid")
            first = self.whole("p1", first)
            second, third = self.whole("p2", first), self.whole("p3", first)
        if any(name.endswith(("mmu_segmentation", "paint_color")) for name in given):
            self.model.warn("what was painted in a slicer is left out")
        self.object.faces.extend((*corners, group, first, second, third))

    def start_object(self) -> None:
        has_group = "pid" in self.attributes
        self.object = _Object(
            group=self.whole("pid") if has_group else NONE, place=self.whole("pindex", 0)
        )
        self.model.objects[self.part, self.whole("id")] = self.object

    def named_object(self) -> tuple[_Key, NDArray[np.float64]]:
        path = next((v for k, v in self.attributes.items() if _local(k) == "path"), None)
        part = self.part if path is None else _part_name(path)
        self.parts.add(part)
        return (part, self.whole("objectid")), self.transform()

    def transform(self) -> NDArray[np.float64]:
        """Return the transform, (4, 3), which acts on row vectors: (x, y, z, 1) @ transform."""
        text = self.attributes.get("transform")
        if text is None:
            return np.eye(4, 3)
        try:
            values = np.array([float(word) for word in text.split()])
        except ValueError:
            values = np.empty(0)
        if values.shape != (12,) or not np.isfinite(values).all():
            raise self.fail(f"transform: expected 12 finite numbers, got {text[:40]!r}")
        return values.reshape(4, 3)

    def component(self) -> None:
        self.object.components.append(self.named_object())

    def item(self) -> None:
        if self.is_root:  # only the build of the root part counts
            self.model.items.append(self.named_object())

    def start_group(self) -> None:
        self.group = _Group(texture=self.whole("texid", 0))
        self.model.groups[self.part, self.whole("id")] = self.group

    def base(self) -> None:
        text = self.attributes.get("displaycolor", "#FFFFFF")
        rgb, alpha = self.packed(text)
        red, green, blue = _core.linear_color(rgb)
        self.group.materials.append(
            Material(
                name=self.attributes.get("name", ""),
                base_color=(red, green, blue, alpha),
                alpha_mode="blend" if alpha < 1.0 else "opaque",
            )
        )

    def color(self) -> None:
        rgb, alpha = self.packed(self.attributes.get("color", ""))
        if alpha < 1.0:
            self.model.warn("alpha of colors is left out")
        self.group.colors.append(rgb)

    def packed(self, text: str) -> tuple[int, float]:
        """Parse ``#RRGGBB`` or ``#RRGGBBAA`` to 0xRRGGBB and alpha, 0 to 1."""
        try:
            value = int(text[1:], 16)
        except ValueError:
            value = NONE
        if value < 0 or text[0] != "#" or len(text) not in (7, 9):
            raise self.fail(f"color: expected #RRGGBB or #RRGGBBAA, got {text[:40]!r}")
        return (value, 1.0) if len(text) == 7 else (value >> 8, (value & 0xFF) / 255.0)

    def texcoord(self) -> None:
        self.group.texcoords.extend((self.number("u"), self.number("v")))

    def texture(self) -> None:
        path = _part_name(self.attributes.get("path", ""))
        given = self.attributes
        self.model.textures[self.part, self.whole("id")] = Texture(
            path,
            wrap=(_wrap(given.get("tilestyleu")), _wrap(given.get("tilestylev"))),
            smooth=given.get("filter") != "nearest",
        )


def _wrap(style: str | None) -> Wrap:
    if style == "mirror":
        return "mirror"
    return "clamp" if style == "clamp" else "repeat"


# --- Putting them together --------------------------------------------------------------------


class _Assembly:
    """Assembles one mesh from the items of the build."""

    def __init__(self, model: _Model, archive: zipfile.ZipFile, most_bytes: int) -> None:
        self.model, self.archive, self.most_bytes = model, archive, most_bytes
        self.names = {name.lower(): name for name in archive.namelist()}
        self.sizes: dict[_Key, int] = {}
        self.materials: list[Material] = []
        self.first_material: dict[_Key | Texture, int] = {}  # of each group

    def mesh(self) -> Mesh:
        if not self.model.items:
            raise FormatError("expected an item to build, got none")
        total = sum(self.size(key, 0) for key, _ in self.model.items)
        if total > self.most_bytes:
            raise FormatError(
                f"what is to be built takes {total} bytes, more than {self.most_bytes}; "
                "set max_bytes to read it"
            )
        if not any(self.model.objects[key].faces for key in self.sizes):
            raise FormatError("expected triangles in what is to be built, got none")
        with np.errstate(over="ignore", invalid="ignore"):  # join() refuses infinite coordinates
            return self.join(
                [each for key, at in self.model.items for each in self.placed(key, _square(at))]
            )

    def join(self, placed: list[tuple[_Key, NDArray[np.float64]]]) -> Mesh:
        pieces = {key: self.piece(key) for key in dict.fromkeys(key for key, _ in placed)}
        there = [pieces[key].placed(matrix) for key, matrix in placed]
        return join(there, self.materials, self.model.warn)

    def object(self, key: _Key) -> _Object:
        found = self.model.objects.get(key)
        if found is None:
            raise FormatError(f"{key[0]}: expected an object with the id {key[1]}, got none")
        return found

    def size(self, key: _Key, depth: int) -> int:
        """Return the memory in bytes of an object with all its components."""
        if key not in self.sizes:
            if depth > _DEEPEST:
                raise FormatError(f"{key[0]}: objects within objects, more than {_DEEPEST} deep")
            each = self.object(key)
            own = len(each.faces) // 7 * _BYTES_A_FACE + len(each.vertices) // 3 * _BYTES_A_VERTEX
            children = sum(self.size(child, depth + 1) for child, _ in each.components)
            self.sizes[key] = own + children
        return self.sizes[key]

    def placed(
        self, key: _Key, matrix: NDArray[np.float64]
    ) -> Iterator[tuple[_Key, NDArray[np.float64]]]:
        each = self.object(key)
        if each.faces:
            yield key, matrix
        for child, transform in each.components:
            if self.sizes[child] > 0:
                yield from self.placed(child, product(_square(transform), matrix))

    def piece(self, key: _Key) -> Piece:
        each = self.object(key)
        vertices = np.array(each.vertices, dtype=np.float64).reshape(-1, 3)
        rows = np.array(each.faces, dtype=np.int64).reshape(-1, 7)
        faces = rows[:, :3]
        if faces.max() >= len(vertices):
            raise FormatError(
                f"{key[0]}: object {key[1]}: vertex index: expected 0 to {len(vertices) - 1}, "
                f"got {faces.max()}"
            )
        piece = Piece.plain(vertices, faces)
        for number in np.unique(rows[:, 3]):
            if number != NONE:
                self.give_properties(piece, (key[0], int(number)), rows)
        return piece

    def give_properties(self, piece: Piece, key: _Key, rows: NDArray[np.int64]) -> None:
        group = self.model.groups.get(key)
        if group is None:  # a kind of group that start() has warned about
            return
        chosen = rows[:, 3] == key[1]
        places = rows[chosen, 4:]
        size = max(len(group.materials), len(group.colors), len(group.texcoords) // 2)
        if places.max() >= size:
            raise FormatError(
                f"{key[0]}: properties {key[1]}: expected a place from 0 to {size - 1}, "
                f"got {places.max()}"
            )
        if group.materials:
            piece.material[chosen] = self.first_of(key, group.materials) + places[:, 0]
        elif group.colors:
            piece.colors[chosen] = np.array(group.colors, dtype=np.int64)[places]
        else:
            texture = self.model.textures.get((key[0], group.texture), Texture(""))
            material = self.textured(texture)
            piece.material[chosen] = self.first_of(texture, [material])
            used, corners = np.unique(places, return_inverse=True)
            piece.corners[chosen] = corners.reshape(places.shape) + len(piece.texcoords)
            coords = np.array(group.texcoords, dtype=np.float64).reshape(-1, 2)[used]
            piece.texcoords = np.concatenate([piece.texcoords, coords])

    def first_of(self, key: _Key | Texture, materials: list[Material]) -> int:
        if key not in self.first_material:
            self.first_material[key] = len(self.materials)
            self.materials += materials
        return self.first_material[key]

    def textured(self, texture: Texture) -> Material:
        path = texture.path or ""
        stored = self.names.get(path.lower())
        name = posixpath.basename(path)
        if stored is None:
            self.model.warn(f"texture '{path}' is not in the archive and is left out")
            return Material(name=name)
        image = replace(texture, path=name, data=self.archive.read(stored))
        return Material(name=name, textures={"base_color": image})


def _square(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    square = np.eye(4)
    square[:, :3] = matrix
    return square
