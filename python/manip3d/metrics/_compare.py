"""Compare a mesh with its original by all measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d.metrics._boundary_gap import BoundaryGap, boundary_gap
from manip3d.metrics._color_error import ColorError, color_error
from manip3d.metrics._distances import MetroResult, metro
from manip3d.metrics._fmpd import FmpdResult, fmpd
from manip3d.metrics._texture_error import TextureError, texture_error

if TYPE_CHECKING:
    from manip3d._util.options import Progress, Rng
    from manip3d.mesh import Mesh

_Found = TypeVar("_Found")
_STAGES = 6  # number of measures in a `Comparison`


@dataclass(frozen=True)
class Comparison:
    """Result of `compare`.

    Attributes
    ----------
    faces : (int, int)
        Numbers of faces of the original and of the other mesh.
    metro_vertex, metro_area : MetroResult
        Distances in both directions, sampled at the vertices and uniformly by area.
    texture_error : TextureError or None
        Differences of texture coordinates; None: one of the meshes has none.
    color_error : ColorError or None
        Differences of the colours of vertices; None: one of the meshes has none.
    fmpd : FmpdResult
        Perceptual distance.
    boundary_gap : BoundaryGap
        Cracks and moved boundaries.
    """

    faces: tuple[int, int]
    metro_vertex: MetroResult
    metro_area: MetroResult
    texture_error: TextureError | None
    color_error: ColorError | None
    fmpd: FmpdResult
    boundary_gap: BoundaryGap

    def __repr__(self) -> str:
        faces = f"{self.faces[1]} of {self.faces[0]} faces"
        distance = f"distance {self.metro_area.rms:.3g} rms, {self.metro_area.max:.3g} at most"
        return f"<manip3d.metrics.Comparison: {faces}; {distance}, of the bounding box's diagonal>"


@checked
def compare(
    original: Mesh,
    simplified: Mesh,
    *,
    rng: Rng = 0,
    threads: int = 0,
    progress: Progress = None,
) -> Comparison:
    """Compare a mesh with its original by every measure that the two meshes allow.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each.
    rng : int, numpy.random.Generator or None
        Seed of the samples by area.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        A mesh has no faces, or the original has no area.

    Examples
    --------
    >>> import manip3d
    >>> mesh = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> manip3d.metrics.compare(mesh, mesh).metro_vertex.max
    0.0
    """
    stage = 0
    with reporting(progress, "compare") as report:

        def measured(function: Callable[[Callable[[float, str], object]], _Found]) -> _Found:
            """Run one measure, and report its progress as a part of the whole."""
            nonlocal stage
            begin = stage

            def told(fraction: float, _: str = "") -> None:
                if report is not None:
                    report((begin + fraction) / _STAGES)

            found = function(told)
            stage += 1
            told(1.0)
            return found

        has_uv = original.face_texcoords is not None and simplified.face_texcoords is not None
        has_colors = original.colors is not None and simplified.colors is not None
        return Comparison(
            faces=(original.num_faces, simplified.num_faces),
            metro_vertex=measured(
                lambda told: metro(original, simplified, threads=threads, progress=told)
            ),
            metro_area=measured(
                lambda told: metro(
                    original, simplified, sampling="area", rng=rng, threads=threads, progress=told
                )
            ),
            texture_error=measured(
                lambda told: (
                    texture_error(original, simplified, rng=rng, threads=threads, progress=told)
                    if has_uv
                    else None
                )
            ),
            color_error=measured(
                lambda told: (
                    color_error(original, simplified, rng=rng, threads=threads, progress=told)
                    if has_colors
                    else None
                )
            ),
            fmpd=measured(lambda told: fmpd(original, simplified, threads=threads, progress=told)),
            boundary_gap=measured(
                lambda told: boundary_gap(original, simplified, threads=threads, progress=told)
            ),
        )
