"""Simplification within a memory limit: first in parts, then the remaining mesh as a whole."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from manip3d import _core
from manip3d._util.memory import release_unused, resident_bytes, written_size
from manip3d._util.options import reporting, sharing
from manip3d.errors import InputError
from manip3d.simplify._collapse import StoppingRules, expect_surface, has_surface
from manip3d.simplify._color_seams import has_color_seams
from manip3d.simplify._parts import (
    CROSSING,
    blocks,
    join,
    part_of_faces,
    part_of_vertices,
    take_faces,
)
from manip3d.simplify._quality import QualityResult, fast, locked_of, quality

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress
    from manip3d.mesh import Mesh

MESH_TABLES = ("vertices", "faces", "texcoords", "face_texcoords", "normals", "face_normals",
               "colors", "face_material")  # fmt: skip
"""Names of the tables of a `Mesh`."""


class _Items(NamedTuple):
    """A number for each kind of item of a mesh: bytes of memory for one, or how many there are."""

    face: float
    face_in_pieces: float  # a face of a mesh in several pieces
    vertex: float  # as stored
    excess_vertex: float  # a position in excess of a closed surface's number (F / 2)
    textured_face: float
    texcoord: float
    face_with_normals: float
    normal: float
    colored_vertex: float
    face_with_color_seams: float  # a face of a mesh with several colours at one place


# Bytes, measured on lattices with all tables, welded and not, in one piece and with each face a
# piece of its own.
_BYTES = {
    "fast": _Items(
        face=125, face_in_pieces=215, vertex=12, excess_vertex=300, textured_face=20, texcoord=45,
        face_with_normals=25, normal=10, colored_vertex=75,
        face_with_color_seams=290,
    ),
    "quality": _Items(
        face=490, face_in_pieces=200, vertex=12, excess_vertex=528, textured_face=135, texcoord=245,
        face_with_normals=30, normal=50, colored_vertex=225,
        face_with_color_seams=0,
    ),
}  # fmt: skip
_BYTES_LEFT = {"fast": 80, "quality": 210}  # additional bytes for each face of the result
_MARGIN = 1.1  # factor on measured bytes, for meshes unlike those measured
_CONSTANT = 16 << 20  # bytes that do not grow with the mesh

# Bytes of NumPy arrays, from their dtypes.
_MAP = 4  # `vertex_map` and `face_map`, int32: for each vertex and each face
_PART_NUMBER = 2  # number of the part, uint16: for each vertex and each face
_RENUMBERING = 6  # `stays`, `is_used` and int32 new rows: for each row of the longest table
_PART_FACES = 40  # a face of a part: two int64 rows, and three corners in int32 before and after

# Options that are passed on unchanged only if the whole mesh is simplified in one run.
_ONE_RUN_OPTIONS = frozenset({"max_distance", "importance", "locked"})

_SLACK = 1.25  # least number of faces that the chosen mode starts with, per face of the target
_SPARE_FACES = 1000  # in addition to these, because a share of a small target is hardly any face
_MIN = 20_000  # least faces of a part; in smaller parts too many faces lie at the borders
_DEEPEST = 12  # 4096 parts of `_MIN` faces: more than 80 million faces
_PART_EXCESS = 1.25  # size of the largest part over the mean, because parts are not equally large
_CUTS = (0.5, 0.35, 0.6)  # share below the cut in each round; borders move, so that none remains


def _storage(mesh: Mesh) -> int:
    tables = (getattr(mesh, name) for name in MESH_TABLES)
    return sum(table.nbytes for table in tables if table is not None)


def _num_places(mesh: Mesh) -> float:
    """Estimate the number of distinct positions from the vertices that hash to 0 of 64 values."""
    found = []
    factors = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
    for rows in blocks(mesh.num_vertices):
        places = mesh.vertices[rows] + 0.0  # turns -0.0 into 0.0
        hashes = (places.view(np.uint64) * factors).sum(axis=1, dtype=np.uint64)
        hashes ^= hashes >> np.uint64(29)
        found.append(places[(hashes * factors[0]) >> np.uint64(58) == 0])
    sample = np.concatenate(found)
    if len(sample) < 100:
        return float(mesh.num_vertices)
    return mesh.num_vertices * len(np.unique(sample, axis=0)) / len(sample)


def bytes_per_face(mesh: Mesh, mode: str) -> float:
    """Return the largest memory that a mode uses per face of a mesh, without the mesh itself."""
    faces = mesh.num_faces
    texcoords = 0 if mesh.texcoords is None else len(mesh.texcoords)
    normals = 0 if mesh.normals is None else len(mesh.normals)
    counts = _Items(
        face=faces,
        face_in_pieces=faces if _core.count_components(mesh) > 1 else 0,
        vertex=mesh.num_vertices,
        excess_vertex=max(0.0, _num_places(mesh) - faces / 2),
        textured_face=faces if texcoords else 0,
        texcoord=texcoords,
        face_with_normals=faces if normals else 0,
        normal=normals,
        colored_vertex=0 if mesh.colors is None else mesh.num_vertices,
        face_with_color_seams=faces if has_color_seams(mesh) else 0,
    )
    return _MARGIN * sum(a * b for a, b in zip(_BYTES[mode], counts, strict=True)) / faces


@dataclass(frozen=True)
class _Plan:
    """Way to simplify a mesh within the memory limit."""

    direct: bool  # the chosen mode can simplify the whole mesh
    faces: int = 0  # faces left by the first stage
    depth: int = 0  # the first stage has 2^depth parts; 0: the whole mesh


def _plan(mesh: Mesh, mode: str, memory: int, target: int) -> _Plan:
    """Return the stages that bring the mesh to the target within the memory limit.

    The chosen mode simplifies as many faces as fit; before that, ``fast`` brings the mesh to this
    number, in as few parts as the limit allows, because faces at the parts' borders stay.

    Raises
    ------
    InputError
        Even the smallest parts need more memory.
    """
    release_unused()
    held = resident_bytes()
    if held is None:
        raise InputError("memory: this system does not say how much memory a process holds")
    num_faces = mesh.num_faces
    sure = held + _CONSTANT + math.ceil(_MARGIN * _BYTES_LEFT[mode] * min(target, num_faces))
    free = memory - sure
    mode_bytes, fast_bytes = bytes_per_face(mesh, mode), bytes_per_face(mesh, "fast")
    if mode_bytes * num_faces <= free:
        return _Plan(direct=True)
    stored = _storage(mesh) / num_faces
    maps = _MAP * (mesh.num_vertices + num_faces)
    fewest = min(num_faces, math.ceil(_SLACK * target) + _SPARE_FACES)
    left = min(num_faces, int((free - maps) / (mode_bytes + stored)))
    rows = max(len(table) for name in MESH_TABLES if (table := getattr(mesh, name)) is not None)
    index = _PART_NUMBER * (mesh.num_vertices + num_faces) + _RENUMBERING * rows
    part_bytes = fast_bytes + stored + _PART_FACES

    def in_parts_of(size: float) -> float:
        return maps + index + part_bytes * size

    # Bytes of the first stage at each depth, without the faces that it leaves, and for each of them
    stages = [(maps + fast_bytes * num_faces, stored)]
    for depth in range(1, _DEEPEST + 1):
        size = _PART_EXCESS * num_faces / 2**depth
        if size < _MIN:
            break
        stages.append((in_parts_of(size), 2 * stored))
    for depth, (fixed, each) in enumerate(stages if left >= fewest else []):
        if fixed + each * left <= free:
            return _Plan(direct=False, faces=left, depth=depth)
    fixed, each = stages[-1]  # the smallest parts: they leave fewer faces than the mode can take
    fitting = min(left, math.floor((free - fixed) / each))
    if fitting >= fewest:
        return _Plan(direct=False, faces=fitting, depth=len(stages) - 1)
    needed = sure + max(
        maps + (mode_bytes + stored) * fewest, in_parts_of(2 * _MIN) + 2 * stored * fewest
    )
    raise InputError(
        f"memory: expected at least {written_size(math.ceil(needed))} to bring {num_faces} faces "
        f"to {target} with mode={mode!r}, got {written_size(memory)}; the process holds "
        f"{written_size(held)} already"
    )


@dataclass
class _Stage:
    """Mesh, maps and counts after the runs so far."""

    mesh: Mesh
    vertex_map: NDArray[np.int32] | None = None  # None: identity
    face_map: NDArray[np.int32] | None = None
    max_error: float = 0.0
    rejected: Counter[str] = field(default_factory=Counter)
    removed_pieces: int = 0
    relaxed_collapses: int = 0
    dropped_faces: int = 0

    def count(self, result: QualityResult) -> None:
        """Add the counts of a run."""
        self.rejected.update(result.rejected)
        self.removed_pieces += result.removed_pieces
        self.relaxed_collapses += result.relaxed_collapses
        self.dropped_faces += result.dropped_faces

    def follow(self, vertex_map: NDArray[np.int32], face_map: NDArray[np.int32]) -> None:
        """Compose the maps so far with those of a run; -1 stays -1."""
        if self.vertex_map is None or self.face_map is None:
            self.vertex_map, self.face_map = vertex_map, face_map
            return
        for own, following in ((self.vertex_map, vertex_map), (self.face_map, face_map)):
            after = np.append(following, np.int32(-1))  # index -1 reads this last row
            for rows in blocks(len(own)):
                own[rows] = after[own[rows]]


def _locked_now(stage: _Stage, locked: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Return the locked vertices as rows of the current mesh."""
    if locked is None or stage.vertex_map is None:
        return locked
    now = np.zeros(stage.mesh.num_vertices + 1, dtype=np.bool_)
    now[stage.vertex_map[locked]] = True
    return now[:-1]


def _from(
    report: Callable[[float], object], low: float, high: float
) -> Callable[[float, str], object]:
    """Return a callback that reports the fractions of one part of the work to `report`."""
    return lambda fraction, _: report(low + (high - low) * fraction)


def _reduce_whole(
    stage: _Stage,
    faces: int,
    max_error: float,
    locked: NDArray[np.bool_] | None,
    report: Callable[[float], object],
) -> None:
    result = fast(
        stage.mesh, target_faces=faces, max_error=max_error, locked=_locked_now(stage, locked),
        progress=_from(report, 0.0, 1.0),
    )  # fmt: skip
    stage.count(result)
    stage.max_error += result.max_error
    stage.follow(result.vertex_map, result.face_map)
    stage.mesh = result.mesh


class _Reduced:
    """Collects the simplified parts of a mesh: `add` for each of them, and then `joined` once.

    `joined` numbers the faces between parts after those of all parts, so that no part can follow;
    `face_map` is complete only then.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.vertex_map = np.full(mesh.num_vertices, -1, dtype=np.int32)
        self.face_map = np.full(mesh.num_faces, -1, dtype=np.int32)
        self.error = 0.0
        self._parts: list[Mesh] = []
        self._faces: list[NDArray[np.int32]] = []
        self._num_vertices = self._num_faces = 0

    def add(
        self,
        done: QualityResult,
        own: NDArray[np.intp],
        used: NDArray[np.int64],
        inside: NDArray[np.bool_],
    ) -> None:
        """Add a simplified part.

        Parameters
        ----------
        done : QualityResult
            The simplified part. Before, it consisted of its own faces, followed by the faces that
            cross its border.
        own : (F,) intp
            Rows of its own faces in the whole mesh.
        used : (V,) int64
            Rows of its vertices in the whole mesh.
        inside : (V,) bool
            Whether each of these vertices belongs to this part, and not to a neighbour.
        """
        self.error = max(self.error, done.max_error)
        to = done.vertex_map[inside]
        self.vertex_map[used[inside]] = np.where(to < 0, to, to + np.int32(self._num_vertices))
        is_own = np.ones(done.mesh.num_faces + 1, dtype=np.bool_)
        is_own[done.face_map[len(own) :]] = False
        is_own[-1] = False  # index -1: faces that were removed
        row_of = np.where(is_own, np.cumsum(is_own) - 1 + self._num_faces, -1).astype(np.int32)
        self.face_map[own] = row_of[done.face_map[: len(own)]]
        part = _with_faces(done.mesh, is_own[:-1])
        self._parts.append(part)
        self._faces.append(part.faces + np.int32(self._num_vertices))
        self._num_vertices += part.num_vertices
        self._num_faces += part.num_faces

    def joined(self, mesh: Mesh, crossing: NDArray[np.intp]) -> tuple[Mesh, int]:
        """Return the joined parts and faces between them, and how many of the latter vanished.

        `crossing` are the rows (C,) of the faces between parts in the whole `mesh`.
        """
        between = self.vertex_map[mesh.faces[crossing]]
        # A corner without a vertex was removed, because it coincided with another one, or is in a
        # part whose faces have no area, those across its border included.
        has_area = (between >= 0).all(axis=1)
        kept = crossing[has_area]
        self.face_map[kept] = self._num_faces + np.arange(len(kept), dtype=np.int32)
        last = take_faces(mesh, kept)[0] if len(kept) else None
        faces = np.concatenate([*self._faces, between[has_area]])
        return join(self._parts, faces, last), len(crossing) - len(kept)


def _reduce_in_parts(
    stage: _Stage,
    faces: int,
    depth: int,
    share: float,
    max_error: float,
    locked: NDArray[np.bool_] | None,
    report: Callable[[float], object],
) -> None:
    """Simplify each part independently; faces between parts are unchanged."""
    mesh = stage.mesh
    fixed = _locked_now(stage, locked)
    part = part_of_vertices(mesh, depth, share)
    of_face = part_of_faces(mesh, part)
    crossing = np.flatnonzero(of_face == CROSSING)
    corners = mesh.faces[crossing]
    stays = np.zeros(mesh.num_vertices, dtype=np.bool_) if fixed is None else fixed.copy()
    stays[corners.reshape(-1)] = True
    share_left = max(0.0, (faces - len(crossing)) / max(1, mesh.num_faces - len(crossing)))
    reduced = _Reduced(mesh)
    for number in range(2**depth):
        own = np.flatnonzero(of_face == number)
        beside = crossing[(part[corners] == number).any(axis=1)]
        if len(own) + len(beside) == 0:
            continue
        here, used = take_faces(mesh, np.concatenate([own, beside]))
        if not has_surface(here):
            stage.dropped_faces += len(own)
            continue
        done = fast(
            here,
            target_faces=round(share_left * len(own)) + len(beside),
            max_error=max_error,
            locked=stays[used],
            progress=_from(report, number / 2**depth, (number + 1) / 2**depth),
        )
        del here
        stage.count(done)
        reduced.add(done, own, used, part[used] == number)
        del done
    stage.mesh, vanished = reduced.joined(mesh, crossing)
    stage.dropped_faces += vanished
    stage.max_error += reduced.error
    stage.follow(reduced.vertex_map, reduced.face_map)


def _with_faces(mesh: Mesh, chosen: NDArray[np.bool_]) -> Mesh:
    """Return the mesh with the chosen faces only; vertices and other tables are complete."""
    names = ("faces", "face_texcoords", "face_normals", "face_material")
    tables = {name: table for name in names if (table := getattr(mesh, name)) is not None}
    return mesh.replace(**{name: table[chosen] for name, table in tables.items()})


def simplify_within(
    mesh: Mesh,
    mode: str,
    memory: int,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    progress: Progress = None,
    **options: Any,
) -> QualityResult:
    """Simplify while the process uses at most `memory` bytes; see :func:`simplify`."""
    run: Callable[..., QualityResult] = quality if mode == "quality" else fast
    rules = StoppingRules(target_faces, ratio, max_error, options.get("max_distance"))
    target, error_limit, _ = rules.limits(mesh)
    if not has_surface(mesh):
        expect_surface(0, mesh.num_faces)
    plan = _plan(mesh, mode, memory, target)
    if plan.direct:
        return run(
            mesh, target_faces=target_faces, ratio=ratio, max_error=max_error, progress=progress,
            **options,
        )  # fmt: skip
    for name in ("max_distance", "importance"):
        if options.get(name) is not None:
            raise InputError(
                f"{name}: the whole mesh has to be simplified in one run, which takes about "
                f"{written_size(math.ceil(bytes_per_face(mesh, mode) * mesh.num_faces))} more than "
                f"the process holds; got memory={memory}"
            )
    locked = locked_of(mesh, options.get("locked"))
    stage = _Stage(mesh)
    with sharing(progress, "simplify") as part:
        with reporting(part(0.0, 0.5), "simplify") as report:  # each round reports from 0 again
            _reduce(stage, plan, 0.5 * error_limit, locked, report or (lambda _: None))
        if stage.mesh.num_faces > plan.faces:
            raise InputError(
                f"memory: expected more than {written_size(memory)}: {stage.mesh.num_faces} faces "
                f"are left in parts, where {plan.faces} would fit"
            )
        release_unused()
        done = run(
            stage.mesh,
            target_faces=target,
            max_error=max(0.0, error_limit - stage.max_error),
            locked=_locked_now(stage, locked),
            progress=part(0.5, 1.0),
            **{name: value for name, value in options.items() if name not in _ONE_RUN_OPTIONS},
        )
    stage.count(done)
    stage.follow(done.vertex_map, done.face_map)
    assert stage.vertex_map is not None
    assert stage.face_map is not None
    return replace(
        done,
        max_error=stage.max_error + done.max_error,
        vertex_map=stage.vertex_map,
        face_map=stage.face_map,
        rejected=dict(stage.rejected),
        removed_pieces=stage.removed_pieces,
        relaxed_collapses=stage.relaxed_collapses,
        dropped_faces=stage.dropped_faces,
    )


def _reduce(
    stage: _Stage,
    plan: _Plan,
    max_error: float,
    locked: NDArray[np.bool_] | None,
    report: Callable[[float], object],
) -> None:
    """Run the first stage: rounds of the fast mode until the mesh fits the chosen mode."""
    if plan.depth == 0:
        _reduce_whole(stage, plan.faces, max_error, locked, report)
        return
    for share in _CUTS:
        if stage.mesh.num_faces <= plan.faces:
            return
        limit = max(0.0, max_error - stage.max_error)
        # A collapse removes two faces, so that each part may keep one more than its share.
        goal = max(1, plan.faces - 2**plan.depth)
        _reduce_in_parts(stage, goal, plan.depth, share, limit, locked, report)
