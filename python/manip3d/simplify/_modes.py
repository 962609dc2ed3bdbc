"""`simplify`, the main function for meshes, and its modes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.simplify._collapse import SimplifyResult, qem4vr
from manip3d.simplify._memory import simplify_within
from manip3d.simplify._quality import QualityResult, fast, quality

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from manip3d._util.options import Progress
    from manip3d.mesh import Mesh

__all__ = ["Mode", "simplify"]

Mode = Literal["quality", "published", "fast"]

_MODES_WITH: dict[str, tuple[Mode, ...]] = {
    "max_distance": ("quality", "published"),
    "locked": ("quality", "fast"),
    "importance": ("quality",),
    "memory": ("quality", "fast"),
    "color_weight": ("quality", "fast"),
    "threads": ("fast",),
}


def default_mode(max_distance: float | None) -> Mode:
    """Return the default mode: 'published' if ``max_distance`` is 0, otherwise 'quality'."""
    return "published" if max_distance == 0 else "quality"


@checked
def simplify(
    mesh: Mesh,
    mode: Mode | None = None,
    *,
    target_faces: int | None = None,
    ratio: float | None = None,
    max_error: float | None = None,
    max_distance: float | None = None,
    locked: ArrayLike | None = None,
    importance: ArrayLike | None = None,
    memory: int | None = None,
    color_weight: float | None = None,
    threads: int = 0,
    progress: Progress = None,
) -> QualityResult | SimplifyResult:
    """Simplify a mesh by edge collapses, to a number of faces or within an error.

    Parameters
    ----------
    mesh : Mesh
        The input, which is not changed.
    mode : 'quality', 'published' or 'fast', optional
        'quality': the smallest error (:func:`quality`); 'published': the published method with its
        rules and constants, whose vertices are vertices of the input (:func:`qem4vr`); 'fast': the
        shortest time, with a larger error (:func:`fast`). Default: 'published' if ``max_distance``
        is 0, otherwise 'quality'.
    target_faces : int, optional
        Stop at this many faces or fewer.
    ratio : float in [0, 1], optional
        Fraction of the input's faces to keep; with ``target_faces``, the larger number of faces is
        the target.
    max_error : float, optional
        Largest error of a collapse, in the file's unit; each mode documents what it measures.
    max_distance : float, optional
        Largest two-sided Hausdorff distance between the surfaces, boundaries included, in the
        file's unit. 0 allows only collapses that leave the surface exactly as it is, which are
        those of ``mode='published'``; ``mode='fast'`` has no such limit. At least one of the four
        targets is needed; simplification stops at the first one that is reached.
    locked : (V,) bool, optional
        Vertices that must not move; for ``mode='quality'`` and ``mode='fast'``.
    importance : (V,) float > 0, optional
        Factor of the error at each vertex, 1: normal; for ``mode='quality'``.
    memory : int, bytes, optional
        Limit of the resident memory of this process, including the mesh and everything else; for
        ``mode='quality'`` and ``mode='fast'``. A mesh too large for the mode within this limit is
        first reduced by :func:`fast` to as many faces as fit (in parts, if :func:`fast` does not
        fit either), and then simplified by the mode to the target. The two stages share
        `max_error`, and the error of the result is the sum of both.
    color_weight : float, optional
        Weight of errors of vertex colours relative to those of the shape; for ``mode='quality'``
        and ``mode='fast'``, whose default is 0.01: the shape has priority.
    threads : int
        Number of threads, for ``mode='fast'``; 0: ``MANIP3D_THREADS``, else all cores.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``, at most ten times a second.

    Returns
    -------
    QualityResult or SimplifyResult

    Raises
    ------
    InputError
        No target, an option out of its range, an unknown mode, or a memory limit that is too low;
        in this case the message says how much memory is needed.

    Examples
    --------
    >>> import manip3d
    >>> square = manip3d.Mesh(
    ...     [[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 0]],
    ...     [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]],
    ... )
    >>> manip3d.simplify.simplify(square, ratio=0.5).mesh
    <manip3d.Mesh: 4 vertices, 2 faces>
    >>> manip3d.simplify.simplify(square, max_distance=0.0).mesh  # the middle is in their plane
    <manip3d.Mesh: 4 vertices, 2 faces>
    """
    if mode is None:
        mode = default_mode(max_distance)
    limits: dict[str, Any] = {
        "target_faces": target_faces,
        "ratio": ratio,
        "max_error": max_error,
    }
    more = {
        "max_distance": max_distance,
        "locked": locked,
        "importance": importance,
        "memory": memory,
        "color_weight": color_weight,
        "threads": threads or None,
    }
    for name, value in more.items():
        if value is None:
            continue
        if mode not in _MODES_WITH[name]:
            modes = " or ".join(repr(m) for m in _MODES_WITH[name])
            raise InputError(f"{name}: expected mode={modes}, got mode={mode!r}")
        limits[name] = value
    if memory is not None:
        return simplify_within(mesh, mode, progress=progress, **limits)
    methods: dict[str, Callable[..., QualityResult | SimplifyResult]] = {
        "quality": quality,
        "published": qem4vr,
        "fast": fast,
    }
    return methods[mode](mesh, progress=progress, **limits)
