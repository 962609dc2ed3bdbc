"""Levels of detail from one run, and a budget of faces shared over several models."""

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
from manip3d.errors import InputError
from manip3d.simplify._collapse import METHODS, SimplifyResult
from manip3d.simplify._quality import QualityResult, fast, quality

if TYPE_CHECKING:
    from manip3d._util.options import Progress
    from manip3d.mesh import Mesh

_FEWEST = 4  # faces that a shared budget leaves to each model


@dataclass(frozen=True)
class LodLevel:
    """One level of detail.

    Attributes
    ----------
    mesh : Mesh
    max_error : float
        Largest error of the collapses that led here (`SimplifyResult.max_error`), in the file's
        unit; 0 for a mesh as it was read.
    """

    mesh: Mesh = field(repr=False)
    max_error: float

    @property
    def num_faces(self) -> int:
        """Faces of this level."""
        return self.mesh.num_faces


@dataclass(frozen=True)
class LodChain:
    """Levels of detail of one mesh, finest first; see :func:`lod_chain`.

    Attributes
    ----------
    levels : tuple of LodLevel
        The first is the mesh itself.
    result : SimplifyResult or QualityResult
        The run that all levels come from; with ``method="quality"`` or ``"fast"`` that of the
        coarsest one tried.
    """

    levels: tuple[LodLevel, ...]
    result: SimplifyResult | QualityResult = field(repr=False)

    def write(self, path: str | os.PathLike[str], *, max_vertices: int | None = None) -> None:
        """Write all levels; see :func:`manip3d.io.write_lods`.

        Parameters
        ----------
        path : path
            As for `manip3d.io.write_lods`.
        max_vertices : int, optional
            As for `manip3d.io.write_lods`.
        """
        from manip3d.io import write_lods

        write_lods(
            [level.mesh for level in self.levels],
            path,
            errors=[level.max_error for level in self.levels],
            max_vertices=max_vertices,
        )


@checked
def lod_chain(
    mesh: Mesh,
    levels: int | Sequence[int] = 4,
    *,
    ratio: float = 0.5,
    method: str = "qem4vr",
    options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> LodChain:
    """Make levels of detail of a mesh: each from the record of one run, or each at its best.

    Parameters
    ----------
    mesh : Mesh
        The finest level; not changed.
    levels : int or sequence of int
        How many levels there are in all, or the numbers of faces of the coarser ones, descending.
    ratio : float in (0, 1)
        Faces of a level over those of the one before, where ``levels`` is a number.
    method : str
        One of `METHODS`: one run, whose vertices all levels share. Or ``"quality"``: a run of its
        own from the input for each level, with vertices where the error is least (:func:`quality`);
        or ``"fast"``, the same with :func:`fast`.
    options : dict of str, optional
        Arguments of the method, such as ``{"max_distance": 0.1}``.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    LodChain
        Levels that the simplifier cannot reach are left out: see ``result.stop``.

    Raises
    ------
    InputError
        Fewer than two levels, counts that do not descend, ``ratio`` out of its range, and what
        the simplifier refuses.

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
    targets = _targets(mesh.num_faces, levels, ratio)
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
    return LodChain(tuple(found), result)


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
    for target in targets:
        result = run(mesh, target_faces=target, progress=progress, **(options or {}))
        if not 0 < result.mesh.num_faces <= target:
            break
        found.append(LodLevel(result.mesh, result.max_error))
    return LodChain(tuple(found), result)


def check_options(method: str, run: Callable[..., Any], options: Mapping[str, Any] | None) -> None:
    """Refuse options that are no arguments of the method."""
    known = set(inspect.signature(run).parameters) - {"mesh", "target_faces", "progress"}
    if unknown := sorted(str(name) for name in set(options or {}) - known):
        raise InputError(f"options: expected arguments of {method}, got {', '.join(unknown)}")


def _run(
    mesh: Mesh,
    target_faces: int,
    method: str,
    options: Mapping[str, Any] | None,
    progress: Progress,
) -> SimplifyResult:
    if method not in METHODS:
        raise InputError(f"method: expected one of {', '.join(METHODS)}, got {method!r}")
    run = METHODS[method]
    check_options(method, run, options)
    return run(mesh, target_faces=target_faces, progress=progress, **(options or {}))


def _targets(num_faces: int, levels: int | Sequence[int], ratio: float) -> list[int]:
    """Numbers of faces of the coarser levels."""
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
    """(C,) number of faces after each collapse of the record."""
    return np.asarray(_core.faces_left(mesh, result.collapses), dtype=np.int64)


@dataclass(frozen=True)
class SharedBudget:
    """Models that share a budget of faces; see :func:`share_budget`.

    Attributes
    ----------
    levels : tuple of LodLevel
        One for each model, in order.
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


@checked
def polygon_budget(
    ms_per_million: float,
    refresh_hz: float,
    *,
    views: int = 2,
    share: float = 0.8,
    other_ms: float = 0.0,
) -> int:
    """How many triangles a headset draws in time.

    Parameters
    ----------
    ms_per_million : float
        Milliseconds for each million triangles, measured on that device with a scene like one's
        own: `FrameTimes.ms_per_million` of `manip3d.viewer.frame_times`.
    refresh_hz : float
        Refresh rate of the display, such as 72 or 90.
    views : int
        How often the scene is drawn for each picture: 2 for two eyes one after the other, 1 where
        the device draws both at once.
    share : float in (0, 1]
        Part of the time between two pictures that may be used: frames differ, and a late one is
        seen.
    other_ms : float
        What else each picture takes, whatever is in it.

    Returns
    -------
    int
        For `share_budget`, or ``target_faces`` of a single model; 0 where the other work alone
        takes too long.

    Raises
    ------
    InputError
        An argument out of its range.

    Notes
    -----
    The time is taken as proportional to the triangles, which holds for scenes that are large
    enough: small ones wait for their pixels, and the budget is then too small.

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
    method: str = "qem4vr",
    options: Mapping[str, Any] | None = None,
    progress: Progress = None,
) -> SharedBudget:
    """Simplify several models to a number of faces in all, every one up to the same error.

    Parameters
    ----------
    meshes : sequence of Mesh
        In one unit: their errors are compared. Models seen from farther away may be scaled down.
    faces : int
        The budget.
    method : str
        One of `METHODS`.
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
        No model, a budget below 1, and what the simplifier refuses.

    Notes
    -----
    Each model is simplified once. The collapses of all records are made in the order of the largest
    error so far, until the budget is met; each model keeps at least four faces (or what it has).

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
    [96, 4]
    """
    if len(meshes) == 0:
        raise InputError("meshes: expected at least one, got none")
    if faces < 1:
        raise InputError(f"faces: expected >= 1, got {faces}")
    results = [_run(mesh, _FEWEST, method, options, progress) for mesh in meshes]
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
    levels = tuple(
        LodLevel(mesh, 0.0)
        if count == 0
        else LodLevel(r.level_of_detail(int(f[count - 1])), float(e[count - 1]))
        for mesh, r, f, e, count in zip(meshes, results, left, errors, counts, strict=True)
    )
    num_faces = sum(level.num_faces for level in levels)
    return SharedBudget(
        levels, num_faces, max(level.max_error for level in levels), num_faces <= faces
    )
