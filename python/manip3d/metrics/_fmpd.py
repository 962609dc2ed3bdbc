"""Fast mesh perceptual distance (FMPD): differences in roughness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting, threads_of

if TYPE_CHECKING:
    from manip3d._util.options import Progress
    from manip3d.mesh import Mesh


@dataclass(frozen=True)
class FmpdResult:
    """Fast mesh perceptual distance; see :func:`fmpd`.

    Attributes
    ----------
    value : float
        The distance; 0: equally rough.
    roughness_original, roughness_simplified : float
        Global roughness of each mesh. Both values depend on both meshes, which share thresholds.
    skipped_faces : int
        Number of faces without area in both meshes, which are ignored.
    non_manifold : bool
        Whether a vertex is not manifold; its curvature is computed as for an interior vertex.
    """

    value: float
    roughness_original: float
    roughness_simplified: float
    skipped_faces: int
    non_manifold: bool


@checked
def fmpd(
    original: Mesh,
    simplified: Mesh,
    *,
    clip: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> FmpdResult:
    """Measure the perceptual distance of two meshes as the difference of their roughness.

    Parameters
    ----------
    original, simplified : Mesh
        Meshes with connectivity as stored; weld seams before if they should not be boundaries.
    clip : bool
        Limit the value to 1, as chapter 3 of the dissertation does and chapter 2 does not.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    FmpdResult

    Raises
    ------
    InputError
        A mesh has no faces or no area.

    Notes
    -----
    K. Wang, F. Torkhani, A. Montanvert: A fast roughness-based approach to the assessment of 3D
    mesh visual quality, Computers & Graphics 36(7), 2012. Local roughness is the Laplacian, with
    cotangent weights clamped to [0.001, 1000], of the absolute angle deficit. The values published
    in the dissertation cannot be reproduced with it; compare ranks.

    Examples
    --------
    >>> from manip3d import metrics, simplify, simulate
    >>> head = simulate.models.head(faces=2000)
    >>> metrics.fmpd(head, head).value
    0.0
    >>> half = simplify.qem4vr(head, ratio=0.5).mesh
    >>> metrics.fmpd(head, half).value > 0
    True
    """
    with reporting(progress, "fmpd") as report:
        return FmpdResult(*_core.fmpd(original, simplified, clip, threads_of(threads), report))
