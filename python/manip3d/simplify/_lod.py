"""Levels of detail of a mesh, and a budget of faces shared by several models."""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import shares, sharing
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.simplify._collapse import METHODS, SimplifyResult
from manip3d.simplify._quality import QualityResult, fast, quality

if TYPE_CHECKING:
    from manip3d._util.options import Progress
    from manip3d.mesh import Mesh

_MIN = 4  # number of faces below which no model is simplified for a shared budget

# Limits of the search for the common error: largest number of runs of each model, ratio of errors
# below which numbers of faces are interpolated, share of the budget by which the result may miss
# it, and share of the largest error that counts as zero.
_MAX_ERRORS = 7
_ALIKE = 1.2
_NEAR = 0.01
_MIN_ERROR = 1e-6


@dataclass(frozen=True)
class LodLevel:
    """One level of detail.

    Attributes
    ----------
    mesh : Mesh
    max_error : float
        Largest error of the simplification of this level, in the file's unit; 0 for the input mesh.
        `LodChain.error_measure` says what it measures.
    """

    mesh: Mesh = field(repr=False)
    max_error: float

    def __repr__(self) -> str:
        faces = counted(self.num_faces, "face")
        return f"<manip3d.simplify.LodLevel: {faces}, max_error {self.max_error:.4g}>"

    @property
    def num_faces(self) -> int:
        """Number of faces of this level."""
        return self.mesh.num_faces


@dataclass(frozen=True)
class LodChain:
    """Levels of detail of one mesh, finest first; see :func:`lod_chain`.

    Attributes
    ----------
    levels : tuple of LodLevel
        Levels; the first is the input mesh.
    result : SimplifyResult or QualityResult
        The run that all levels come from; with ``method="quality"`` or ``"fast"``, which run once
        for each level, the run of the coarsest level tried.
    error_measure : str
        Name of the error measured by ``max_error`` of a level; manifests contain it.
    """

    levels: tuple[LodLevel, ...]
    result: SimplifyResult | QualityResult = field(repr=False)
    error_measure: str = ""

    def __repr__(self) -> str:
        faces = ", ".join(str(level.num_faces) for level in self.levels)
        return f"<manip3d.simplify.LodChain: {faces} faces>"

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
            Path of the files, as for `manip3d.io.write_lods`.
        max_vertices : int, optional
            Largest number of vertices of a primitive, as for `manip3d.io.write_lods`.
        quantize : bool
            Write 16-bit positions and texture coordinates, as for `manip3d.io.write_lods`.
        """
        from manip3d.io import write_lods

        write_lods(
            [level.mesh for level in self.levels],
            path,
            errors=[level.max_error for level in self.levels],
            error_measure=self.error_measure,
            max_vertices=max_vertices,
            quantize=quantize,
        )


@checked
def lod_chain(
    mesh: Mesh,
    levels: int | Sequence[int] = 4,
    *,
    ratio: float = 0.5,
    method: str = "quality",
    options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> LodChain:
    """Make levels of detail of a mesh, by a run for each level or from the record of one run.

    Parameters
    ----------
    mesh : Mesh
        The finest level; not changed.
    levels : int or sequence of int
        Total number of levels, or the numbers of faces of the coarser levels in descending order.
    ratio : float in (0, 1)
        Number of faces of a level divided by that of the next finer one, if ``levels`` is a number.
    method : str
        ``"quality"`` or ``"fast"``: each level is simplified independently from ``mesh``, by
        :func:`quality` or :func:`fast`. One of `METHODS`: one run down to the coarsest level, whose
        collapses are replayed up to each level, so that all levels use vertices of that run.
    options : dict of str, optional
        Arguments of the method, such as ``{"max_distance": 0.1}``.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    LodChain
        The levels. Those that the simplifier cannot reach are left out; ``result.stop`` says why.

    Raises
    ------
    InputError
        Fewer than two levels, counts that do not descend, ``ratio`` out of its range, or an input
        that the simplifier refuses.

    Examples
    --------
    >>> import manip3d
    >>> square = manip3d.Mesh(
    ...     [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]],
    ...     [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
    ... )
    >>> chain = manip3d.simplify.lod_chain(square, [2])
    >>> [level.num_faces for level in chain.levels]
    [4, 2]
    """
    targets = targets_of(mesh.num_faces, levels, ratio)
    if method in _OWN_RUNS:
        return _chain_of_runs(mesh, targets, method, options, progress)
    result = _run(mesh, targets[-1], method, options, progress)
    left = _faces_left(mesh, result)
    found = [LodLevel(mesh, 0.0)]
    for target in targets:
        reached = np.flatnonzero(left <= target)
        if not reached.size:
            break
        level = result.level_of_detail(target)
        if level.num_faces == 0:
            break
        if level.num_faces < found[-1].num_faces:
            found.append(LodLevel(level, float(result.collapse_errors[: reached[0] + 1].max())))
    return LodChain(tuple(found), result, measure_of(method))


_MEASURES: Mapping[str, str] = {
    "quality": "largest root mean square distance of a vertex to the planes of the original faces "
    "that it stands for, or of the boundaries and seams there; no bound of the Hausdorff distance",
    "fast": "largest root mean square distance of a vertex to the planes of the original faces, "
    "boundaries and seams that it stands for; no bound of the Hausdorff distance",
}
_SURFACE_MEASURE = (
    "largest surface quadric error of a collapse, in which boundaries, seams and vertices that "
    "move within a plane do not count; no bound of the Hausdorff distance"
)


def measure_of(method: str) -> str:
    """Return the name of the error that a method measures."""
    return _MEASURES.get(method, _SURFACE_MEASURE)


_OWN_RUNS: Mapping[str, Callable[..., QualityResult]] = {"quality": quality, "fast": fast}


def _chain_of_runs(
    mesh: Mesh,
    targets: Sequence[int],
    method: str,
    options: Mapping[str, Any] | None,
    progress: Progress,
) -> LodChain:
    run = _OWN_RUNS[method]
    check_options(method, run, options)
    found = [LodLevel(mesh, 0.0)]
    distinct = list(dict.fromkeys(targets))
    with sharing(progress, "lod") as part:
        for target, own in zip(distinct, shares([1.0] * len(distinct)), strict=True):
            result = run(mesh, target_faces=target, progress=part(*own), **(options or {}))
            if not 0 < result.mesh.num_faces <= target:
                break
            if result.mesh.num_faces < found[-1].num_faces:
                found.append(LodLevel(result.mesh, result.max_error))
    return LodChain(tuple(found), result, measure_of(method))


def check_options(method: str, run: Callable[..., Any], options: Mapping[str, Any] | None) -> None:
    """Refuse options that are not arguments of the method."""
    known = set(inspect.signature(run).parameters) - {"mesh", "target_faces", "progress"}
    if unknown := sorted(str(name) for name in set(options or {}) - known):
        raise InputError(f"options: expected arguments of {method}, got {', '.join(unknown)}")


def runner(method: str) -> Callable[..., Any]:
    """Return the function of a method."""
    own: Mapping[str, Callable[..., Any]] = {**_OWN_RUNS, **METHODS}
    if method not in own:
        raise InputError(f"method: expected one of {', '.join(own)}, got {method!r}")
    return own[method]


def _run(
    mesh: Mesh,
    target_faces: int,
    method: str,
    options: Mapping[str, Any] | None,
    progress: Progress,
) -> SimplifyResult:
    run = runner(method)
    check_options(method, run, options)
    result: SimplifyResult = run(
        mesh, target_faces=target_faces, progress=progress, **(options or {})
    )
    return result


def targets_of(num_faces: int, levels: int | Sequence[int], ratio: float) -> list[int]:
    """Return the target numbers of faces of the coarser levels."""
    if isinstance(levels, int):
        if levels < 2:
            raise InputError(f"levels: expected at least 2, got {levels}")
        if not 0.0 < ratio < 1.0:
            raise InputError(f"ratio: expected a number in (0, 1), got {ratio}")
        return [max(1, int(num_faces * ratio**i)) for i in range(1, levels)]
    targets = [int(count) for count in levels]
    if not targets or targets[-1] < 1 or targets != sorted(set(targets), reverse=True):
        raise InputError(f"levels: expected descending numbers of faces >= 1, got {targets}")
    return targets


def _faces_left(mesh: Mesh, result: SimplifyResult) -> np.ndarray:
    """Return (C,) the number of faces after each collapse of the record."""
    return np.asarray(_core.faces_left(mesh, result.collapses), dtype=np.int64)


@dataclass(frozen=True)
class SharedBudget:
    """Models that share a budget of faces; see :func:`share_budget`.

    Attributes
    ----------
    levels : tuple of LodLevel
        One level for each model, in the order of the models.
    num_faces : int
        Number of faces of all models together.
    max_error : float
        The error up to which each model was simplified, in the unit of the models.
    reached : bool
        Whether ``num_faces`` is within the budget.
    """

    levels: tuple[LodLevel, ...]
    num_faces: int
    max_error: float
    reached: bool

    __repr__ = short_repr


@checked
def polygon_budget(
    ms_per_million: float,
    refresh_hz: float,
    *,
    views: int = 2,
    share: float = 0.8,
    other_ms: float = 0.0,
) -> int:
    """Compute the number of triangles that a headset can draw within one refresh interval.

    Parameters
    ----------
    ms_per_million : float
        Milliseconds per million triangles, measured on the target device with a similar scene:
        `FrameTimes.ms_per_million` of `manip3d.viewer.frame_times`.
    refresh_hz : float
        Refresh rate of the display in hertz, such as 72 or 90.
    views : int
        Number of times the scene is drawn for each picture: 2 if the two eyes are drawn one after
        the other, 1 if the device draws both at once.
    share : float in (0, 1]
        Share of the refresh interval that may be used; below 1 because frame times vary and a late
        frame is visible.
    other_ms : float
        Milliseconds per picture of work that does not depend on the scene.

    Returns
    -------
    int
        Budget for `share_budget`, or ``target_faces`` of a single model; 0 if the other work alone
        takes too long.

    Raises
    ------
    InputError
        An argument out of its range.

    Notes
    -----
    The time is assumed to be proportional to the number of triangles, which holds for large scenes.
    The time of small scenes is dominated by their pixels, and the budget is then too small.

    Examples
    --------
    >>> from manip3d import simplify
    >>> simplify.polygon_budget(50.0, 60)
    133333
    """
    for name, value in {"ms_per_million": ms_per_million, "refresh_hz": refresh_hz}.items():
        if not (value > 0.0 and math.isfinite(value)):
            raise InputError(f"{name}: expected a number > 0, got {value}")
    if views < 1:
        raise InputError(f"views: expected >= 1, got {views}")
    if not 0.0 < share <= 1.0:
        raise InputError(f"share: expected a number in (0, 1], got {share}")
    if not (other_ms >= 0.0 and math.isfinite(other_ms)):
        raise InputError(f"other_ms: expected a number >= 0, got {other_ms}")
    left_ms = share * (1000.0 / refresh_hz) - other_ms
    budget = 1e6 * max(left_ms, 0.0) / (views * ms_per_million)
    if not math.isfinite(budget):
        raise InputError(f"ms_per_million: {ms_per_million} gives no number of triangles")
    return int(budget)


@checked
def share_budget(
    meshes: Sequence[Mesh],
    faces: int,
    *,
    method: str = "quality",
    options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> SharedBudget:
    """Simplify several models to a total number of faces, each model up to the same error.

    Parameters
    ----------
    meshes : sequence of Mesh
        The models, all in the same unit, because their errors are compared. Scale down models that
        are seen from farther away.
    faces : int
        Largest number of faces of all models together.
    method : str
        ``"quality"``, ``"fast"`` or one of `METHODS`.
    options : dict of str, optional
        Arguments of the method, such as ``{"max_distance": 0.1}``.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    SharedBudget

    Raises
    ------
    InputError
        No model, a budget below 1, or an input that the simplifier refuses.

    Notes
    -----
    Each model keeps four faces, or slightly fewer. With ``"quality"`` and ``"fast"`` the common
    error is found for which all models together have as many faces as the budget. This takes at
    most eight runs of each model and a last run to its number of faces. The error of these methods
    includes boundaries and seams.

    With `METHODS` each model is simplified once, and the collapses of all records are made in the
    order of the largest error so far. That error measures only the distance from the surface. It is
    0 for every change within a plane, so that a flat open model loses its outline before the other
    models lose a face.

    Examples
    --------
    >>> import manip3d
    >>> hill = manip3d.Mesh(
    ...     [[x, y, (x - 4) * (y - 4) / 9] for y in range(9) for x in range(9)],
    ...     [[i, i + d, i + 10 + c]
    ...      for i in range(71) if i % 9 < 8 for d, c in ((1, 0), (10, -1))],
    ... )
    >>> plain = hill.replace(vertices=hill.vertices * [1, 1, 0])
    >>> shared = manip3d.simplify.share_budget([hill, plain], 100)
    >>> [level.num_faces for level in shared.levels]
    [96, 3]
    """
    if len(meshes) == 0:
        raise InputError("meshes: expected at least one, got none")
    if faces < 1:
        raise InputError(f"faces: expected >= 1, got {faces}")
    check_options(method, runner(method), options)
    by = _share_by_runs if method in _OWN_RUNS else _share_by_records
    with sharing(progress, "simplify") as part:
        if sum(mesh.num_faces for mesh in meshes) <= faces:
            levels = tuple(LodLevel(mesh, 0.0) for mesh in meshes)
        else:
            levels = by(meshes, faces, method, options, part)
    num_faces = sum(level.num_faces for level in levels)
    return SharedBudget(
        levels, num_faces, max(level.max_error for level in levels), num_faces <= faces
    )


def _share_by_runs(
    meshes: Sequence[Mesh],
    faces: int,
    method: str,
    options: Mapping[str, Any] | None,
    part: Callable[[float, float], Progress],
) -> tuple[LodLevel, ...]:
    """Find each mesh's number of faces at the common error, then simplify each mesh to it."""
    run = _OWN_RUNS[method]
    given = dict(options or {})
    limit = given.pop("max_error", None)
    share = faces / sum(mesh.num_faces for mesh in meshes)

    rounds = iter(shares([1.0] * (_MAX_ERRORS + 2)))
    parts = shares([mesh.num_faces for mesh in meshes])

    def runs(targets: Sequence[int], error: float | None) -> list[QualityResult]:
        errors = [e for e in (error, limit) if e is not None]
        begin, end = next(rounds)
        return [
            run(
                mesh,
                target_faces=max(min(_MIN, mesh.num_faces), target),
                max_error=min(errors, default=None),
                progress=part(begin + (end - begin) * low, begin + (end - begin) * high),
                **given,
            )
            for mesh, target, (low, high) in zip(meshes, targets, parts, strict=True)
        ]

    alike = runs([int(share * mesh.num_faces) for mesh in meshes], None)
    most = max(result.max_error for result in alike)
    least = max(min(result.max_error for result in alike), _MIN_ERROR * most)
    many = np.array([mesh.num_faces for mesh in meshes])
    few = np.array([min(_MIN, mesh.num_faces) for mesh in meshes])
    for _ in range(_MAX_ERRORS):
        if most <= _ALIKE * least or few.sum() >= (1.0 - _NEAR) * faces:
            break
        error = math.sqrt(least * most)
        counts = np.array([result.mesh.num_faces for result in runs([0] * len(meshes), error)])
        if counts.sum() > faces:
            least, many = error, np.minimum(many, counts)
        else:
            most, few = error, np.maximum(few, counts)
    # Between the two errors the models' numbers of faces are interpolated by one common share.
    spare = max(0, faces - int(few.sum())) / max(1, int((many - few).sum()))
    targets = few + np.floor(min(1.0, spare) * (many - few)).astype(np.int64)
    return tuple(
        LodLevel(mesh, 0.0)
        if target >= mesh.num_faces
        else LodLevel(result.mesh, float(result.max_error))
        for mesh, target, result in zip(
            meshes, targets, runs([int(n) for n in targets], None), strict=True
        )
    )


def _share_by_records(
    meshes: Sequence[Mesh],
    faces: int,
    method: str,
    options: Mapping[str, Any] | None,
    part: Callable[[float, float], Progress],
) -> tuple[LodLevel, ...]:
    """Apply the collapses of all records in the order of their errors."""
    parts = shares([mesh.num_faces for mesh in meshes])
    results = [
        _run(mesh, _MIN, method, options, part(*own))
        for mesh, own in zip(meshes, parts, strict=True)
    ]
    left = [_faces_left(mesh, r) for mesh, r in zip(meshes, results, strict=True)]
    errors = [np.maximum.accumulate(r.collapse_errors) for r in results]
    model = np.repeat(np.arange(len(meshes)), [len(e) for e in errors])
    order = np.lexsort((np.arange(len(model)), np.concatenate(errors)))
    gone = np.concatenate(
        [
            -np.diff(counts, prepend=mesh.num_faces)
            for mesh, counts in zip(meshes, left, strict=True)
        ]
    )
    total = sum(mesh.num_faces for mesh in meshes)
    excess = total - faces
    made = 0 if excess <= 0 else int(np.searchsorted(np.cumsum(gone[order]), excess)) + 1
    counts = np.bincount(model[order[:made]], minlength=len(meshes))
    return tuple(
        LodLevel(mesh, 0.0)
        if count == 0
        else LodLevel(r.level_of_detail(int(f[count - 1])), float(e[count - 1]))
        for mesh, r, f, e, count in zip(meshes, results, left, errors, counts, strict=True)
    )
