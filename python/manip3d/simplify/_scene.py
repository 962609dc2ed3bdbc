"""Simplify the meshes of a scene together, each mesh once, by one measure of error."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.arrays import as_array
from manip3d._util.checked import checked
from manip3d._util.linear import determinant, eigen, inverse, moved, product
from manip3d._util.options import shares, sharing
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.io import Deformation, Scene
from manip3d.mesh import Material, Mesh, Texture
from manip3d.simplify._collapse import (
    SimplifyResult,
    StopReason,
    clean,
    faces_of_ratio,
    has_surface,
)
from manip3d.simplify._deformation import deformation_of, rows_of, sway
from manip3d.simplify._lod import LodChain, check_options, lod_chain, runner, targets_of
from manip3d.simplify._memory import MESH_TABLES, simplify_within
from manip3d.simplify._parts import compact_rows
from manip3d.simplify._quality import QualityResult, boundary_vertices
from manip3d.simplify._texcoords import charts, parted, texcoords_of

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress

_Result = SimplifyResult | QualityResult

# `_search` makes at most this many runs to meet a number of drawn faces, and stops earlier when it
# is below the target by no more than this share.
_MAX_RUNS = 6
_NEAR = 0.01

# A mesh drawn smaller than this share of the scene's diagonal counts as hidden: its faces would be
# near the rounding of single precision, in which the fast mode computes.
_TINY = 1e-5

# Distance by which `sway` moves a mesh with a skin while it is simplified, as a share of its
# diagonal. From 0.005 on, curved characters lose more in the rest pose than they gain in other
# poses.
_SWAY = 0.002

# Meshes of several instances are shifted by multiples of this share of the scene's diagonal, so
# that a mesh that touches the largest instance is not welded to it: the other instances are
# elsewhere.
_SHIFT = 1e-9

# A mesh that vanished gets back as many corners as a tetrahedron has, as long as the corners of all
# such meshes are no more than this share of the target.
_CORNERS = 4
_SHARE_OF_CORNERS = 0.1


@dataclass(frozen=True)
class SceneResult:
    """A simplified scene; see :func:`simplify_scene`.

    Attributes
    ----------
    scene : Scene
        The simplified scene.
    max_error : float
        Largest error of a collapse (``QualityResult.max_error``), in the unit of the scene.
    distance_bound : float or None
        With ``max_distance``: upper bound of the two-sided Hausdorff distance of each instance of
        each mesh, in the unit of the scene.
    stop : StopReason
        Why the last run stopped.
    result : QualityResult or SimplifyResult
        Result of the run over all visible meshes, each at the place of its largest instance.
    """

    scene: Scene
    max_error: float
    distance_bound: float | None
    stop: StopReason
    result: _Result = field(repr=False)

    def __repr__(self) -> str:
        faces, error = counted(self.scene.num_faces, "face"), f"max_error {self.max_error:.4g}"
        return f"<manip3d.simplify.SceneResult: {faces}, {error}; {self.stop}>"


@dataclass(frozen=True)
class SceneLevel:
    """A level of detail of a scene.

    Attributes
    ----------
    scene : Scene
        The scene at this level.
    max_error : float
        Largest error of the collapses that led to this level, in the unit of the scene.
    """

    scene: Scene = field(repr=False)
    max_error: float

    def __repr__(self) -> str:
        faces = counted(self.num_faces, "face")
        return f"<manip3d.simplify.SceneLevel: {faces}, max_error {self.max_error:.4g}>"

    @property
    def num_faces(self) -> int:
        """Number of drawn faces; those of a mesh count once for each instance."""
        return self.scene.num_faces


@dataclass(frozen=True)
class SceneLods:
    """Levels of detail of a scene, finest first; see :func:`scene_lods`.

    Attributes
    ----------
    levels : tuple of SceneLevel
        The first is the scene itself.
    result : QualityResult or SimplifyResult
        Result of the run that made the levels, or of the run for the coarsest level.
    error_measure : str
        Description of what the ``max_error`` of a level measures; it is written to manifests.
    """

    levels: tuple[SceneLevel, ...]
    result: _Result = field(repr=False)
    error_measure: str = ""

    def __repr__(self) -> str:
        faces = ", ".join(str(level.num_faces) for level in self.levels)
        return f"<manip3d.simplify.SceneLods: {faces} faces>"

    def write(
        self,
        path: str | os.PathLike[str],
        *,
        max_vertices: int | None = None,
        quantize: bool = False,
    ) -> None:
        """Write all levels; see :func:`manip3d.io.write_lods`.

        Parameters
        ----------
        path : path
            File to write.
        max_vertices : int, optional
        quantize : bool
            Same as for `manip3d.io.write_lods`.
        """
        from manip3d.io import write_lods

        write_lods(
            [level.scene for level in self.levels],
            path,
            errors=[level.max_error for level in self.levels],
            error_measure=self.error_measure,
            max_vertices=max_vertices,
            quantize=quantize,
        )


@dataclass(frozen=True)
class _Instances:
    """The drawn instances of a mesh that may be simplified."""

    index: int  # of the mesh in the scene
    transforms: NDArray[np.float64]  # (N, 4, 4) into the coordinates of the scene
    largest: int  # row of the largest invertible transform, or of the largest if none is
    is_flat: bool  # no transform is invertible: each instance is flattened or has scale 0

    @classmethod
    def of(cls, index: int, transforms: NDArray[np.float64]) -> _Instances:
        linear = transforms[:, :3, :3]
        singular = np.linalg.svd(linear, compute_uv=False)
        flat = ~(singular[:, -1] > 1e-9 * singular[:, 0])
        sizes = np.where(flat, -1.0, (linear**2).sum(axis=(1, 2)))
        is_flat = bool(flat.all())
        # In single precision, singular values that only a BLAS made different are equal.
        largest = int(np.argmax(singular[:, 0].astype(np.float32) if is_flat else sizes))
        return cls(index, transforms, largest, is_flat)

    @property
    def place(self) -> NDArray[np.float64]:
        """The (4, 4) transform of the largest instance."""
        place: NDArray[np.float64] = self.transforms[self.largest]
        return place

    def placed(self, mesh: Mesh) -> NDArray[np.float64]:
        """Return the (V, 3) vertices of the largest instance in the scene."""
        return moved(mesh.vertices, self.place)

    def inside(
        self, vertices: NDArray[np.float64], box: NDArray[np.float64], least: float
    ) -> NDArray[np.bool_]:
        """Return which vertices an instance with a diagonal above ``least`` has in a box."""
        sides = np.array([vertices.min(axis=0), vertices.max(axis=0)])
        corners = np.array(list(itertools.product(*sides.T)))
        linear, shift = self.transforms[:, :3, :3], self.transforms[:, None, :3, 3]
        around = product(corners, linear.transpose(0, 2, 1)) + shift  # (N, 8, 3)
        low, high = around.min(axis=1), around.max(axis=1)
        room = 1e-9 * np.abs(around).max(axis=(1, 2))[:, None]  # the vertices are rounded, too
        meets = ((low <= box[1] + room) & (high >= box[0] - room)).all(axis=1)
        is_seen = np.linalg.norm(high - low, axis=1) > least
        chosen = np.zeros(len(vertices), dtype=np.bool_)
        for place in self.transforms[meets & is_seen]:
            chosen |= inside_box(moved(vertices, place), box)
        return chosen


def _instances(scene: Scene) -> list[_Instances]:
    """Return the instances of each mesh that may be simplified."""
    uses = scene.num_uses
    transforms: dict[int, list[NDArray[np.float64]]] = {
        i: []
        for i, mesh in enumerate(scene.meshes)
        if uses[i] > 0 and not scene.fixed[i] and mesh.num_faces > 0
    }
    if not transforms:
        reasons = sorted({reason for reason in scene.fixed if reason})
        raise InputError(f"scene: no mesh can be simplified: {', '.join(reasons) or 'no faces'}")
    world = scene.world_transforms()
    for node, place in zip(scene.nodes, world, strict=True):
        if node.drawn and node.mesh in transforms:
            if node.joint is not None:
                place = product(world[node.joint], node.inverse_bind)
            every = [place] if node.instances is None else product(place, node.instances)
            transforms[node.mesh].extend(every)
    return [_Instances.of(i, np.array(own)) for i, own in transforms.items()]


def _largest_stretch(linear: NDArray[np.float64]) -> float:
    """Return the largest factor by which one of (N, 3, 3) linear maps lengthens a vector."""
    size = float(np.abs(linear).max()) or 1.0  # squares of what is divided by it do not overflow
    scaled = linear / size
    squares, _ = eigen(product(scaled.transpose(0, 2, 1), scaled))
    return size * math.sqrt(squares.max())


def _diagonal(vertices: NDArray[np.float64]) -> float:
    sides = np.ptp(vertices, axis=0)
    length = float(np.linalg.norm(sides, axis=-1))
    # Beyond these limits the squares of the sides overflow or lose digits; hypot scales them.
    return length if 1e-150 < length < 1e150 else math.hypot(*sides)


def _hidden_size(placed: Sequence[NDArray[np.float64]]) -> float:
    """Return the diagonal up to which an instance is hidden; ``placed``: the largest instances."""
    return _TINY * _diagonal(np.concatenate(placed))


def vertices_in_box(scene: Scene, lock_box: ArrayLike) -> dict[int, NDArray[np.bool_]]:
    """Return for each mesh that may be simplified which vertices an instance has in a box.

    Hidden instances do not count.
    """
    box = checked_box(lock_box)
    every = _instances(scene)
    least = _hidden_size([own.placed(scene.meshes[own.index]) for own in every])
    return {own.index: own.inside(scene.meshes[own.index].vertices, box, least) for own in every}


def _groups(scene: Scene, sways: bool) -> tuple[_Placed | None, list[_Placed]]:
    """Return the visible meshes as one group, and each hidden or flattened mesh as its own group.

    ``sways``: deform meshes with a skin or morph targets by `sway`.
    """
    every = _instances(scene)
    corners = [own.placed(scene.meshes[own.index]) for own in every]
    least = _hidden_size(corners)
    seen: list[_Instances] = []
    aside: list[_Placed] = []
    for own, points in zip(every, corners, strict=True):
        is_hidden = not _diagonal(points) > least
        if is_hidden or own.is_flat:
            hidden = _Placed(scene, [own], is_aside=True, is_hidden=is_hidden, sways=sways)
            aside.append(hidden)
        else:
            seen.append(own)
    return (_Placed(scene, seen, sways=sways) if seen else None), aside


def num_boundary_vertices(scene: Scene) -> int:
    """Return how many vertices ``lock_boundary`` holds in the meshes that may be simplified.

    Where two meshes meet there is no boundary. Vertices of a mesh count once for all its instances.
    """
    seen, aside = _groups(scene, sways=False)
    groups = aside if seen is None else [seen, *aside]
    return sum(int(boundary_vertices(placed.mesh).sum()) for placed in groups)


def _with_surface(scene: Scene, groups: Sequence[_Placed]) -> tuple[list[_Placed], Scene]:
    """Return the groups that have a surface, and the scene without the faces of the others."""
    free: list[_Placed] = []
    left = scene
    for placed in groups:
        if has_surface(placed.mesh):
            free.append(placed)
        else:
            left = placed.split(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), left)
    if not free:
        count = sum(placed.mesh.num_faces for placed in groups)
        raise InputError(
            f"scene: expected a face with three different corners, got none of {count} faces"
        )
    return free, left


def _far_apart(points: NDArray[np.float64], count: int) -> NDArray[np.int64]:
    """Return ``count`` rows of points by farthest point sampling.

    The first is the farthest from the centre of the bounding box.
    """
    nearest = ((points - 0.5 * (points.min(axis=0) + points.max(axis=0))) ** 2).sum(axis=1)
    rows: list[int] = []
    for number in range(min(count, len(points))):
        rows.append(int(np.argmax(nearest)))
        squares = ((points - points[rows[-1]]) ** 2).sum(axis=1)
        nearest = squares if number == 0 else np.minimum(nearest, squares)
    return np.array(rows)


def _turned(normals: NDArray[Any], linear: NDArray[Any]) -> NDArray[np.float64]:
    """Return the unit normals of a surface after a linear map; a mirror does not reverse them."""
    turned = product(normals, inverse(linear))
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    unit: NDArray[np.float64] = np.divide(turned, lengths, out=turned, where=lengths > 0.0)
    return unit


def _values_with_seams(scene: Scene, index: int) -> NDArray[np.float32] | None:
    """Return (V, S, 2) the values of a mesh's vertices whose seams stay; None if there are none.

    They are the further texture coordinates and, as (alpha, 0), the alpha of colours.
    """
    more, alphas = scene.more_texcoords[index], scene.alphas[index]
    if alphas is None:
        return more
    last = np.stack([alphas, np.zeros_like(alphas)], axis=1)[:, None]
    return last if more is None else np.concatenate([more, last], axis=1)


def _sampled_values(scene: Scene, index: int) -> NDArray[np.float32] | None:
    """Return (V, S, 2) the values that are sampled on the original; None if there are none.

    They are the further texture coordinates and, if colours have alpha, two pairs of their four
    channels, because the merged mesh has other colours (`_seen_through`).
    """
    more, alphas, colors = (
        scene.more_texcoords[index], scene.alphas[index], scene.meshes[index].colors,
    )  # fmt: skip
    if alphas is None or colors is None:
        return more
    channels = np.column_stack([colors.astype(np.float32), alphas]).reshape(-1, 2, 2)
    return channels if more is None else np.concatenate([more, channels], axis=1)


def _without_colors(
    values: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.float32]]:
    """Split `_sampled_values` into texture coordinates, colours and alphas."""
    channels = values[:, -2:].reshape(-1, 4)
    colors = np.clip(np.rint(channels[:, :3]), 0.0, 255.0).astype(np.uint8)
    return values[:, :-2], colors, np.clip(channels[:, 3], 0.0, 1.0)


def _seen_through(colors: NDArray[np.uint8], alphas: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return colours over a background, so that a change of alpha has the price of one of colour.

    The background is black or white, whichever differs more from the mean of the colours.
    """
    back = 0.0 if colors.mean() > 127.5 else 255.0
    seen: NDArray[np.uint8] = np.rint(
        back + alphas[:, None] * (colors.astype(np.float32) - back)
    ).astype(np.uint8)
    return seen


class _Placed:
    """Meshes of a scene merged to one mesh, each at the place of its largest instance.

    Each combination of a mesh, a material and a chart of values with seams has its own material in
    the merged mesh (a row of ``_looks``). The simplifier therefore keeps borders between meshes,
    and these seams, as it keeps borders between materials.
    """

    def __init__(
        self,
        scene: Scene,
        every: Sequence[_Instances],
        *,
        is_aside: bool = False,
        is_hidden: bool = False,
        sways: bool = False,
    ) -> None:
        self.scene = scene
        self._shapes = {own.index: scene.meshes[own.index].vertices for own in every}
        for i in self._shapes if sways else ():
            if (deformation := scene.deformations[i]) is not None:
                self._shapes[i] = self._shapes[i] + sway(deformation, self._sway_of(i))
        self.is_hidden = is_hidden
        self._sways = sways
        self._uses = scene.num_uses
        self._instances = {own.index: own for own in every}
        self.indices = list(self._instances)
        # A hidden or flattened mesh is simplified in its own coordinates.
        self._places = {
            i: np.eye(4) if is_aside else own.place.copy() for i, own in self._instances.items()
        }
        self._part_shared()
        self.stretch = max(
            _largest_stretch(product(own.transforms[:, :3, :3], inverse(self._places[i][:3, :3])))
            for i, own in self._instances.items()
        )
        # Scene units per unit of the merged mesh. `stretch` is the largest one over all instances.
        self.unit = self.stretch if is_aside else 1.0
        if not is_aside and self.stretch < 1.0 + 1e-9:
            self.stretch = 1.0
        self._charts = {
            i: charts(scene.meshes[i], values)
            for i in self.indices
            if (values := _values_with_seams(scene, i)) is not None
        }
        self._looks: list[tuple[int, int, int]] = []  # mesh, material and chart
        self.mesh = self._merge()

    def _part_shared(self) -> None:
        """Shift meshes of several instances by `_SHIFT`, so that nothing is welded to them."""
        shared = [i for i in self.indices if self._uses[i] > 1]
        if not shared or len(self.indices) == 1:
            return
        corners = np.concatenate([self._vertices(i) for i in self.indices])
        diagonal = _diagonal(corners)
        for number, i in enumerate(shared):
            self._places[i][:3, 3] += _SHIFT * diagonal * (number + 1)

    def _vertices(self, index: int) -> NDArray[np.float64]:
        place = self._places[index]
        return moved(self._shapes[index], place)

    def _sway_of(self, index: int) -> float:
        return _SWAY * _diagonal(self.scene.meshes[index].vertices)

    def _mirrors(self, index: int) -> bool:
        return bool(determinant(self._places[index][:3, :3]) < 0.0)

    def _merge(self) -> Mesh:
        """Concatenate the meshes; corners of a mesh without an attribute get the index -1."""
        chosen = [self.scene.meshes[i] for i in self.indices]
        has_colors = any(mesh.colors is not None for mesh in chosen)
        tables: dict[str, list[NDArray[Any]]] = {name: [] for name in MESH_TABLES}
        counts = {"vertices": 0, "texcoords": 0, "normals": 0}
        for index, mesh in zip(self.indices, chosen, strict=True):
            turn = slice(None, None, -1 if self._mirrors(index) else 1)
            tables["vertices"].append(self._vertices(index))
            tables["faces"].append(mesh.faces[:, turn] + np.int32(counts["vertices"]))
            for table, corners in (("texcoords", "face_texcoords"), ("normals", "face_normals")):
                rows, of_face = getattr(mesh, table), getattr(mesh, corners)
                if rows is None or of_face is None:
                    tables[corners].append(np.full((mesh.num_faces, 3), -1, dtype=np.int32))
                    continue
                if table == "normals":
                    rows = _turned(rows, self._places[index][:3, :3])
                shifted = np.where(of_face >= 0, of_face + np.int32(counts[table]), np.int32(-1))
                tables[table].append(rows)
                tables[corners].append(shifted[:, turn].astype(np.int32))
                counts[table] += len(rows)
            if has_colors:
                white = np.full((mesh.num_vertices, 3), 255, dtype=np.uint8)
                colors = white if mesh.colors is None else mesh.colors
                if (alphas := self.scene.alphas[index]) is not None:
                    colors = _seen_through(colors, alphas)
                tables["colors"].append(colors)
            tables["face_material"].append(self._look_rows(index, mesh))
            counts["vertices"] += mesh.num_vertices
        joined: dict[str, Any] = {
            name: np.concatenate(parts) for name, parts in tables.items() if parts
        }
        for table, corners in (("texcoords", "face_texcoords"), ("normals", "face_normals")):
            if table not in joined:
                joined.pop(corners, None)
        return Mesh(**joined, materials=[self._material(i, row) for i, row, _ in self._looks])

    def _material(self, index: int, row: int) -> Material:
        """Return a material without its name, which does not change its look.

        The simplifier also asks whether any texture is shown: one in a format that is not read
        counts, too.
        """
        pictures = {"base_color": Texture()} if self.scene.has_textures else {}
        own = self.scene.meshes[index].materials
        material = own[row] if 0 <= row < len(own) else Material()
        return replace(material, name="", textures={**pictures, **material.textures})

    def corners_of_vanished(self, left: Mesh, drawn: int) -> NDArray[np.bool_] | None:
        """Choose corners to keep of meshes that have no face left, the largest meshes first.

        Returns a mask over the vertices of the merged mesh, or None if no mesh vanished. The
        corners are at most `_SHARE_OF_CORNERS` of ``drawn`` faces.
        """
        has_faces = set(self._owners()[self._rows_of(left)].tolist())
        first, vanished = 0, []
        for index in self.indices:
            mesh = self.scene.meshes[index]
            if index not in has_faces and has_surface(mesh):
                vanished.append((-_diagonal(self._vertices(index)), first, index))
            first += mesh.num_vertices
        chosen = np.zeros(first, dtype=np.bool_)
        budget = _SHARE_OF_CORNERS * drawn
        for _, start, index in sorted(vanished):
            budget -= _CORNERS * self._uses[index]
            if budget < 0.0:
                break
            used = np.unique(self.scene.meshes[index].faces)
            chosen[start + used[_far_apart(self._vertices(index)[used], _CORNERS)]] = True
        return chosen if chosen.any() else None

    def _owners(self) -> NDArray[np.int64]:
        """Return the mesh of each row of `_looks`."""
        return np.array([i for i, _, _ in self._looks])

    def _look_rows(self, index: int, mesh: Mesh) -> NDArray[np.int32]:
        """Return for each face the row of its mesh, material and chart in `_looks`."""
        given = mesh.face_material
        materials = np.full(mesh.num_faces, -1, dtype=np.int32) if given is None else given
        own = self._charts.get(index, np.zeros(mesh.num_faces, dtype=np.int64))
        pairs = np.column_stack([materials, own])
        values, rows = np.unique(pairs, axis=0, return_inverse=True)
        first = len(self._looks)
        self._looks += [(index, int(material), int(chart)) for material, chart in values]
        return (rows.reshape(-1) + first).astype(np.int32)

    def split(self, mesh: Mesh, scene: Scene) -> Scene:
        """Return the scene with the meshes that a simplified merged mesh consists of."""
        owner = self._owners()[self._rows_of(mesh)]
        parts = {i: self._part(mesh, np.flatnonzero(owner == i), i) for i in self.indices}
        moved: dict[int, Deformation] = {}
        placed: dict[int, NDArray[np.float32]] = {}
        clear: dict[int, NDArray[np.float32]] = {}
        of_looks = np.array([chart for _, _, chart in self._looks])
        for i, part in parts.items():
            deformation, original = self.scene.deformations[i], self.scene.meshes[i]
            values = _sampled_values(self.scene, i)
            if part.num_faces == 0 or (deformation is None and values is None):
                continue
            shape = original.replace(vertices=self._shapes[i])
            if deformation is not None:
                moved[i] = deformation_of(deformation, shape, part)
                if self._sways:
                    rest = part.vertices - sway(moved[i], self._sway_of(i))
                    parts[i] = part.replace(vertices=rest)
            if values is not None:
                of_faces = of_looks[self._rows_of(mesh)[owner == i]]
                rows, faces, found = texcoords_of(values, shape, self._charts[i], part, of_faces)
                parts[i] = parted(parts[i], rows, faces)
                if deformation is not None:
                    moved[i] = rows_of(moved[i], rows)
                if self.scene.alphas[i] is not None:
                    found, colors, clear[i] = _without_colors(found)
                    parts[i] = parts[i].replace(colors=colors)
                if self.scene.more_texcoords[i] is not None:
                    placed[i] = found
        return scene.with_meshes(parts, moved, placed, clear)

    def _part(self, mesh: Mesh, chosen: NDArray[np.int64], index: int) -> Mesh:
        """Return the chosen faces as the mesh with this index, in its own coordinates."""
        original = self.scene.meshes[index]
        if len(chosen) == 0:
            return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32), materials=original.materials)
        place = self._places[index]
        turn = slice(None, None, -1 if self._mirrors(index) else 1)

        def corners(table: NDArray[np.int32] | None) -> NDArray[np.int32] | None:
            return None if table is None else np.ascontiguousarray(table[chosen][:, turn])

        used, faces = compact_rows(np.arange(mesh.num_vertices), corners(mesh.faces))
        assert used is not None
        assert faces is not None
        assert mesh.face_material is not None
        vertices = product(mesh.vertices[used] - place[:3, 3], inverse(place[:3, :3]).T)
        texcoords, face_texcoords = compact_rows(mesh.texcoords, corners(mesh.face_texcoords))
        normals, face_normals = compact_rows(mesh.normals, corners(mesh.face_normals))
        if normals is not None:
            normals = _turned(normals, inverse(place[:3, :3]))
        materials = np.array([m for _, m, _ in self._looks], dtype=np.int32)[
            mesh.face_material[chosen]
        ]
        has_colors = original.colors is not None and mesh.colors is not None
        return Mesh(
            vertices,
            faces,
            texcoords=texcoords,
            face_texcoords=face_texcoords,
            normals=normals,
            face_normals=face_normals,
            colors=mesh.colors[used] if has_colors and mesh.colors is not None else None,
            face_material=None if original.face_material is None else materials,
            materials=original.materials,
            source=original.source,
        )

    def num_drawn(self, mesh: Mesh) -> int:
        """Return the number of drawn faces when a simplified mesh replaces these meshes."""
        each = np.array([self._uses[i] for i, _, _ in self._looks])
        return int(each[self._rows_of(mesh)].sum())

    @staticmethod
    def _rows_of(mesh: Mesh) -> NDArray[np.int32]:
        """Return the row in `_looks` of each face of a simplified mesh."""
        if mesh.num_faces == 0:
            return np.zeros(0, dtype=np.int32)
        assert mesh.face_material is not None
        return mesh.face_material


@checked
def simplify_scene(
    scene: Scene,
    method: str = "quality",
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    lock_box: ArrayLike | None = None,
    lock_boundary: bool = False,
    importance: ArrayLike | None = None,
    memory: int | None = None,
    cleaned: bool = True,
    options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> SceneResult:
    """Simplify the meshes of a scene, each once, and keep its nodes and instances.

    Parameters
    ----------
    scene : Scene
        Scene to simplify; it is not changed.
    method : str
        ``"quality"``, ``"fast"`` or one of `METHODS`.
    target_faces : int, optional
        Largest number of drawn faces. The faces of a mesh count once for each node that shows it
        (``Scene.num_faces``).
    ratio : float in [0, 1], optional
        Target as a fraction of the drawn faces. If ``target_faces`` is given too, the larger number
        is the target.
    max_error, max_distance : float, optional
        As for the method, in the unit of the scene, at the largest instance of each mesh. A mesh
        whose instances are all hidden (scale 0, or smaller than 1e-5 of the scene's diagonal) is
        not simplified unless a number of faces is given.
    lock_box : (2, 3) float, optional
        Lower and upper corner of a box in the coordinates of the scene. Vertices in it stay (for
        ``"quality"`` and ``"fast"``). If a mesh has several instances, those vertices stay that lie
        in the box in any of them; hidden ones do not count.
    lock_boundary : bool
        The boundaries of the meshes stay as they are (for ``"quality"`` and ``"fast"``), see
        :func:`boundary_vertices`.
    importance : (V,) float > 0, optional
        Factor on the price of changing the surface at each vertex; the vertices of all
        ``scene.meshes`` are concatenated (for ``"quality"``).
    memory : int, bytes, optional
        Ceiling of the resident memory of this process, as for :func:`simplify` (for ``"quality"``
        and ``"fast"``).
    cleaned : bool
        Clean the meshes first (:func:`clean`), where the method does not do it itself.
    options : dict of str, optional
        Further arguments of the method, such as ``{"seam_weight": 1.0}``, without those above.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    SceneResult
        Meshes that are fixed (``Scene.fixed``) count for the target and stay as they are.

    Raises
    ------
    InputError
        No target, no mesh that may be simplified or none with a face that has three different
        corners, ``importance``, ``memory``, a lock or ``max_distance`` for another method,
        ``importance`` of another shape, a ``lock_box`` of another shape or whose lower corner is
        not first, one of these arguments in ``options``, and what the method refuses.

    Notes
    -----
    The meshes are simplified in one run, each at the place of its largest instance, so that all
    faces compete by the same error in the unit of the scene. A collapse in a mesh that n nodes show
    adds n times the error and removes n times the faces; n cancels in the error per face, and
    matters only for the number of drawn faces. If meshes have several instances, the run is
    repeated up to six times until the number of drawn faces is at most 1 % below the target, and
    more often only while it is above the target. Where the vertices of two meshes with one instance
    coincide, the meshes stay connected. A border between two meshes is treated like a border
    between two materials.

    Meshes with a skin or morph targets are simplified in the pose in which the skin was bound, with
    all target weights 0. For ``"quality"`` and ``"fast"`` each joint moves the mesh by 0.2 % of its
    diagonal, and each target by a tenth of its displacement, so that parts which are straight in
    this pose keep the vertices that they need to bend. This is not done with ``max_distance`` or
    ``lock_box``, which hold in the rest pose. A new vertex gets the joints, weights, target
    displacements and further texture coordinates (``TEXCOORD_1``, ...) of the nearest point of the
    original. Seams of the further texture coordinates are kept like borders between materials.

    If whole meshes vanish, ``"quality"`` and ``"fast"`` run again with four corners of each such
    mesh locked, the largest meshes first, up to a tenth of the target's faces: a viewer would miss
    a small part that moves by itself.

    Hidden meshes, and meshes whose instances are all flattened, are simplified one by one in their
    own coordinates, because their error cannot be compared with that of the others. Each keeps the
    same share of its faces as the whole scene.

    Examples
    --------
    >>> from manip3d import io, simplify, simulate
    >>> simulate.models.head(faces=2000).write("head.glb")
    >>> done = simplify.simplify_scene(io.read_scene("head.glb"), target_faces=500)
    >>> done.scene.num_faces
    500
    """
    target = _drawn_target(scene, target_faces, ratio)
    if target is None and max_error is None and max_distance is None:
        raise InputError(
            "target_faces, ratio, max_error or max_distance: expected at least one, got none"
        )
    held = None if lock_box is None else vertices_in_box(scene, lock_box)
    run: Callable[..., _Result] = runner(method)
    _check_locks(method, lock_box, lock_boundary)
    if max_distance is not None and method == "fast":
        raise InputError("max_distance: expected method='quality' or a published one, got 'fast'")
    if own := sorted(_OWN_ARGUMENTS.intersection(options or {})):
        raise InputError(
            f"options: expected none that simplify_scene itself takes, got {', '.join(own)}"
        )
    check_options(method, run, options)
    weights = _importance_of(scene, method, importance)
    cleans = cleaned and method not in ("quality", "fast")
    if memory is not None:
        if method not in ("quality", "fast"):
            raise InputError(f"memory: expected method='quality' or 'fast', got {method!r}")

        def run(mesh: Mesh, **limits: Any) -> _Result:
            return simplify_within(mesh, method, memory, **limits)

    def simplified(placed: _Placed, drawn: int | None, progress: Progress) -> _Result:
        mesh = clean(placed.mesh).mesh if cleans else placed.mesh
        limits: dict[str, Any] = dict(options or {})
        limits["max_error"] = _scaled(max_error, placed.unit)
        if max_distance is not None:
            limits["max_distance"] = _scaled(max_distance, placed.stretch)
        limits = _with_locks(limits, placed, mesh, held, lock_boundary)
        if weights is not None:
            limits["importance"] = np.concatenate([weights[i] for i in placed.indices])

        def at(stored: int | None, own: Progress) -> _Result:
            return run(mesh, target_faces=stored, progress=own, **limits)

        if drawn is None:
            return at(None, progress)
        result = _meet(placed, drawn, at, progress)
        if method not in ("quality", "fast") or result.stop != StopReason.TARGET_REACHED:
            return result
        corners = placed.corners_of_vanished(result.mesh, drawn)
        if corners is None:
            return result
        limits = _with_locked(limits, corners)
        again = _meet(placed, drawn, at, None)
        return again if again.stop == StopReason.TARGET_REACHED else result

    bounded = max_distance is not None and math.isfinite(max_distance)
    sways = method in ("quality", "fast") and not bounded and held is None
    return _simplified_groups(scene, target, simplified, progress, bounded=bounded, sways=sways)


_OWN_ARGUMENTS = frozenset({"ratio", "max_error", "max_distance", "importance"})
"""Arguments of a method that `simplify_scene` converts to the units of the meshes."""


def _check_locks(method: str, lock_box: ArrayLike | None, lock_boundary: bool) -> None:
    for name, is_given in (("lock_box", lock_box is not None), ("lock_boundary", lock_boundary)):
        if is_given and method not in ("quality", "fast"):
            raise InputError(f"{name}: expected method='quality' or 'fast', got {method!r}")


def _with_locks(
    limits: Mapping[str, Any],
    placed: _Placed,
    mesh: Mesh,
    held: Mapping[int, NDArray[np.bool_]] | None,
    lock_boundary: bool,
) -> dict[str, Any]:
    """Return arguments of a method by which vertices of `vertices_in_box` and boundaries stay."""
    if held is not None:
        limits = _with_locked(limits, np.concatenate([held[i] for i in placed.indices]))
    if lock_boundary:
        limits = _with_locked(limits, boundary_vertices(mesh))
    return dict(limits)


def _with_locked(limits: Mapping[str, Any], corners: NDArray[np.bool_]) -> dict[str, Any]:
    """Return arguments of a method with these vertices added to the locked ones."""
    locked = limits.get("locked")
    return {**limits, "locked": corners if locked is None else corners | as_array(locked, "locked")}


def _importance_of(
    scene: Scene, method: str, importance: ArrayLike | None
) -> list[NDArray[Any]] | None:
    """Split the importance of a scene's vertices by mesh."""
    if importance is None:
        return None
    if method != "quality":
        raise InputError(f"importance: expected method='quality', got {method!r}")
    weights = np.asarray(importance)
    counts = [mesh.num_vertices for mesh in scene.meshes]
    if weights.shape != (sum(counts),):
        raise InputError(
            f"importance: expected shape ({sum(counts)},), one for each vertex of the scene's "
            f"{len(counts)} meshes, got {weights.shape}"
        )
    return np.split(weights, np.cumsum(counts)[:-1])


def _scaled(limit: float | None, unit: float) -> float | None:
    """Return a limit in the merged mesh's unit; None if every instance has scale 0."""
    return None if limit is None or unit == 0.0 else limit / unit


def _simplified_groups(
    scene: Scene,
    target: int | None,
    simplified: Callable[[_Placed, int | None, Progress], _Result],
    progress: Progress,
    *,
    bounded: bool,
    sways: bool,
) -> SceneResult:
    """Simplify the visible meshes together, and each other mesh to the same share of its faces.

    ``simplified(placed, drawn, progress)`` simplifies a group to a number of drawn faces.
    """
    seen, aside = _groups(scene, sways)
    if target is None:
        aside = [placed for placed in aside if not placed.is_hidden]
        if seen is None and not aside:
            raise InputError("scene: every instance has scale 0, so that only faces can be counted")
    free, made = _with_surface(scene, [*aside, *([seen] if seen is not None else [])])
    counts = [placed.num_drawn(placed.mesh) for placed in free]
    fixed = made.num_faces - sum(counts)
    share = 1.0 if target is None else max(0, target - fixed) / sum(counts)
    errors, bounds = [], []
    result: _Result | None = None
    parts = shares([placed.mesh.num_faces for placed in free])
    with sharing(progress, "simplify") as part:
        for placed, before, own in zip(free, counts, parts, strict=True):
            wanted = None
            if target is not None:
                left = target - (made.num_faces - before)
                wanted = max(0, left) if placed is free[-1] else math.floor(share * before)
                wanted = min(wanted, before)
            result = simplified(placed, wanted, part(*own))
            if result.stop == StopReason.REFUSED:
                return SceneResult(scene, result.max_error, None, result.stop, result)
            made = placed.split(result.mesh, made)
            errors.append(result.max_error * placed.unit)
            bounds.append((result.distance_bound or 0.0) * placed.stretch)
    assert result is not None
    stop = result.stop
    if target is not None and made.num_faces <= target:
        stop = StopReason.TARGET_REACHED
    elif target is not None and stop == StopReason.TARGET_REACHED:
        stop = StopReason.NO_LEGAL_COLLAPSE
    return SceneResult(made, max(errors), max(bounds) if bounded else None, stop, result)


def _drawn_target(scene: Scene, target_faces: int | None, ratio: float | None) -> int | None:
    targets = []
    if target_faces is not None:
        if target_faces < 0:
            raise InputError(f"target_faces: expected >= 0, got {target_faces}")
        targets.append(target_faces)
    if ratio is not None:
        targets.append(faces_of_ratio(scene.num_faces, ratio))
    return max(targets, default=None)


def checked_box(box: ArrayLike) -> NDArray[np.float64]:
    """Check the (2, 3) lower and upper corner of a box."""
    corners = np.asarray(box, dtype=np.float64)
    if corners.shape != (2, 3):
        raise InputError(f"lock_box: expected shape (2, 3), got {corners.shape}")
    if not (corners[0] <= corners[1]).all():
        raise InputError(
            f"lock_box: expected the lower corner first, got {corners[0].tolist()} and "
            f"{corners[1].tolist()}"
        )
    return corners


def inside_box(vertices: NDArray[np.float64], box: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which vertices lie in a box."""
    chosen: NDArray[np.bool_] = ((vertices >= box[0]) & (vertices <= box[1])).all(axis=1)
    return chosen


def _meet(
    placed: _Placed,
    wanted: int,
    at: Callable[[int | None, Progress], _Result],
    progress: Progress,
) -> _Result:
    """Return the run with the most drawn faces that are not above the target ``wanted``.

    ``at(stored, progress)`` simplifies to a number of stored faces, which count once per mesh.
    """
    before = placed.mesh.num_faces
    drawn_before = placed.num_drawn(placed.mesh)
    if drawn_before == before:
        return at(wanted, progress)
    with sharing(progress, "simplify") as part:
        return _search(placed, wanted, at, part)


def _search(
    placed: _Placed,
    wanted: int,
    at: Callable[[int | None, Progress], _Result],
    part: Callable[[float, float], Progress],
) -> _Result:
    """Search for the number of stored faces: interpolate for `_MAX_RUNS` runs, then bisect.

    Bisection goes on only while no run is within the target.
    """
    met: tuple[int, int] = (-1, 0)  # the most stored and drawn faces within the target so far
    above = (placed.mesh.num_faces, placed.num_drawn(placed.mesh))
    if wanted >= above[1]:
        return at(above[0], part(0.0, 1.0))
    best: _Result | None = None
    parts = shares([1.0] * _MAX_RUNS)
    for number in itertools.count():
        low, high = max(met[0], 0), above[0]
        if number < _MAX_RUNS:
            share = (wanted - met[1]) / max(1, above[1] - met[1])
            # Rounded down, because one more stored face can exceed the target.
            stored = low + math.floor(share * (high - low))
        else:
            stored = (low + high) // 2
        stored = min(max(stored, met[0] + 1), high - 1)
        result = at(stored, part(*parts[min(number, _MAX_RUNS - 1)]))
        if result.stop == StopReason.REFUSED:
            return result
        left = result.mesh.num_faces
        drawn = placed.num_drawn(result.mesh)
        if drawn > wanted:
            if result.stop != StopReason.TARGET_REACHED:
                if stored > 0 or wanted == 0:
                    return result
                # Even one face of a mesh with many instances exceeds the target, and the method
                # does not go down to none: one face is the nearest.
                one = at(1, part(1.0, 1.0))
                return one if placed.num_drawn(one.mesh) < drawn else result
            above = (min(stored, left), drawn)
        else:
            best = result
            if drawn >= (1.0 - _NEAR) * wanted:
                return result
            met = (max(stored, left), drawn)
        del result  # frees its memory before the next run, unless it is the best
        if above[0] - met[0] <= 1 or (best is not None and number + 1 >= _MAX_RUNS):
            break
    assert best is not None  # 0 stored faces are within every target
    return best


@checked
def scene_lods(
    scene: Scene,
    levels: int | Sequence[int] = 4,
    *,
    ratio: float = 0.5,
    method: str = "quality",
    lock_box: ArrayLike | None = None,
    lock_boundary: bool = False,
    cleaned: bool = True,
    options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> SceneLods:
    """Make levels of detail of a scene, with its nodes and instances.

    If whole meshes vanish in a level, ``"quality"`` and ``"fast"`` keep four corners of each, as
    :func:`simplify_scene` does.

    Parameters
    ----------
    scene : Scene
        The finest level; it is not changed.
    levels : int or sequence of int
        Number of levels including the finest, or the numbers of stored faces of the coarser levels,
        descending. A stored face counts once, however many nodes show it. Hidden and flattened
        meshes are simplified one by one, each to its share of these numbers.
    ratio : float in (0, 1)
        Stored faces of a level divided by those of the level before it, if ``levels`` is a number.
    method, options, progress
        Same as for :func:`lod_chain`.
    lock_box, lock_boundary
        Same as for :func:`simplify_scene`: what is locked stays in every level.
    cleaned : bool
        Clean the meshes first (:func:`clean`), where the method does not do it itself.

    Returns
    -------
    SceneLods
        Levels that the simplifier cannot reach are missing; ``result.stop`` states why.

    Raises
    ------
    InputError
        No mesh that may be simplified or none with a face that has three different corners, a lock
        for another method, a ``lock_box`` of another shape or whose lower corner is not first, and
        what :func:`lod_chain` refuses.

    Examples
    --------
    >>> from manip3d import io, simplify, simulate
    >>> simulate.models.head(faces=2000).write("head.glb")
    >>> chain = simplify.scene_lods(io.read_scene("head.glb"), 3)
    >>> [level.num_faces for level in chain.levels]
    [1932, 966, 482]
    """
    _check_locks(method, lock_box, lock_boundary)
    held = None if lock_box is None else vertices_in_box(scene, lock_box)
    seen, aside = _groups(scene, sways=method in ("quality", "fast") and held is None)
    cleans = cleaned and method not in ("quality", "fast")
    free, cleared = _with_surface(scene, [*([seen] if seen is not None else []), *aside])
    meshes = [clean(placed.mesh).mesh if cleans else placed.mesh for placed in free]
    total = sum(mesh.num_faces for mesh in meshes)
    first = meshes[0].num_faces
    if not isinstance(levels, int) and first < total:
        of_first = (max(1, level * first // total) for level in targets_of(total, levels, ratio))
        levels = list(dict.fromkeys(of_first))

    def chain_of(placed: _Placed, mesh: Mesh, levels: Any, progress: Progress) -> LodChain:
        limits = _with_locks(options or {}, placed, mesh, held, lock_boundary)
        chain = lod_chain(
            mesh, levels, ratio=ratio, method=method, options=limits, progress=progress
        )
        return _with_small_meshes(placed, chain, method, limits)

    with sharing(progress, "lod") as part:
        parts = [part(*own) for own in shares([mesh.num_faces for mesh in meshes])]
        chain = chain_of(free[0], meshes[0], levels, parts[0])
        found = [free[0].split(level.mesh, cleared) for level in chain.levels[1:]]
        errors = [level.max_error * free[0].unit for level in chain.levels[1:]]
        others = list(zip(free, meshes, parts, strict=True))[1:] if found else []
        for placed, mesh, own_part in others:
            # Each mesh keeps the share of its faces that the first group keeps.
            own = [max(1, lv.num_faces * mesh.num_faces // first) for lv in chain.levels[1:]]
            coarser = chain_of(placed, mesh, list(dict.fromkeys(own)), own_part).levels
            for i, target in enumerate(own):
                level = next((lv for lv in coarser if lv.num_faces <= target), coarser[-1])
                found[i] = placed.split(level.mesh, found[i])
                errors[i] = max(errors[i], level.max_error * placed.unit)
    made = [SceneLevel(own, error) for own, error in zip(found, errors, strict=True)]
    return SceneLods((SceneLevel(scene, 0.0), *made), chain.result, chain.error_measure)


def _with_small_meshes(
    placed: _Placed, chain: LodChain, method: str, options: Mapping[str, Any]
) -> LodChain:
    """Recompute the levels in which whole meshes vanished, with corners of these meshes locked."""
    if method not in ("quality", "fast"):
        return chain
    finest, *coarser = chain.levels
    made = [finest]
    for level in coarser:
        corners = placed.corners_of_vanished(level.mesh, placed.num_drawn(level.mesh))
        if corners is not None:
            limits = _with_locked(options, corners)
            again = lod_chain(finest.mesh, [level.num_faces], method=method, options=limits)
            level = again.levels[-1] if len(again.levels) > 1 else level
        made.append(level)
    return replace(chain, levels=tuple(made))
