"""Boundary gap: cracks that simplification opened along boundaries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting, threads_of
from manip3d.metrics._distances import Deviation

if TYPE_CHECKING:
    from manip3d._util.options import Progress
    from manip3d.mesh import Mesh


@dataclass(frozen=True)
class BoundaryGap:
    """Distances between boundary curves; see :func:`boundary_gap`.

    Attributes
    ----------
    forward : Deviation or None
        Distances from the original's boundary to the simplified one, in the meshes' units. None:
        the original has no boundary; infinite: only the simplified mesh has none.
    backward : Deviation or None
        Distances from the simplified boundary to the original's, likewise.
    cracks : int
        Number of simplified boundary edges with a point farther than the tolerance from every
        original boundary edge.
    crack_length : float
        Total length of these edges, in the meshes' units.
    diagonal : float
        Diagonal of the original's bounding box, in the meshes' units.
    """

    forward: Deviation | None
    backward: Deviation | None
    cracks: int
    crack_length: float
    diagonal: float


@checked
def boundary_gap(
    original: Mesh,
    simplified: Mesh,
    *,
    tolerance: float = 1e-3,
    weld: bool = True,
    threads: int = 0,
    progress: Progress = None,
) -> BoundaryGap:
    """Measure the distances between the boundary curves of two meshes, and find cracks.

    A boundary edge is used by exactly one face; faces with a repeated index do not count. Mean and
    RMS are weighted by length: each edge is divided into equal pieces of at most 1e-3 diagonals and
    sampled in their middles. The maximum also includes the ends of the edges.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each.
    tolerance : float
        Least width of a crack, in diagonals of the original's bounding box; 1e-6 to 1.
    weld : bool
        Count vertices with bit-identical positions as one, in both meshes. Without it, each seam of
        a file that stores one vertex per texture coordinate (glTF always does) is a boundary, and a
        crack along it is only found where it is wider than the tolerance.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    BoundaryGap

    Raises
    ------
    InputError
        A mesh has no faces; the original's bounding box is a point; ``tolerance`` is out of range.

    Examples
    --------
    >>> from manip3d import metrics, simplify, simulate
    >>> floor = simulate.models.floor(columns=10, rows=6)
    >>> small = simplify.qem4vr(floor, target_faces=40).mesh
    >>> metrics.boundary_gap(floor, small).cracks
    0
    """
    with reporting(progress, "boundary gap") as report:
        forward, backward, cracks, crack_length, diagonal = _core.boundary_gap(
            original, simplified, tolerance, weld, threads_of(threads), report
        )
    return BoundaryGap(
        None if forward is None else Deviation(*forward),
        None if backward is None else Deviation(*backward),
        cracks,
        crack_length,
        diagonal,
    )
