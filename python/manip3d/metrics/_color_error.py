"""Colour error: change of the colours of vertices between a mesh and its original."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting, seed_of, threads_of
from manip3d.metrics._distances import checked_samples

if TYPE_CHECKING:
    from manip3d._util.options import Progress, Rng
    from manip3d.mesh import Mesh


@dataclass(frozen=True)
class ColorError:
    """Change of colours; see :func:`color_error`.

    Attributes
    ----------
    mean, rms, max : float
        Statistics over the samples, in levels: 0 to 255, which is black beside white.
    samples : int
        Number of samples.
    """

    mean: float
    rms: float
    max: float
    samples: int


@checked
def color_error(
    original: Mesh,
    simplified: Mesh,
    *,
    samples: int | None = None,
    rng: Rng = 0,
    epsilon: float = 1e-4,
    threads: int = 0,
    progress: Progress = None,
) -> ColorError:
    """Measure how far the colours of vertices changed on the surface.

    Area-uniform samples of the original are compared with the interpolated colour at the closest
    point of the simplified surface. The difference of a sample is the root mean square of its three
    channels. If several faces are within ``epsilon`` of the closest distance, the one with the
    nearest colour counts, so that a border between two colours is not an error.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each, both with ``colors``.
    samples : int, optional
        Number of samples; default: the larger number of faces of the two meshes.
    rng : int, numpy.random.Generator or None
        Seed of the samples; None: a different one each time.
    epsilon : float
        Tolerance for equally close faces, in diagonals of the original's bounding box.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    ColorError

    Raises
    ------
    InputError
        A mesh has no faces or no colours; the original has no area; ``samples`` is below 1;
        ``epsilon`` is negative.

    Notes
    -----
    Colours are compared as they are stored, with the curve of sRGB.

    Examples
    --------
    >>> import manip3d
    >>> grey = manip3d.Mesh(
    ...     [[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], colors=[[100, 100, 100]] * 3
    ... )
    >>> darker = grey.replace(colors=grey.colors - 10)
    >>> round(manip3d.metrics.color_error(grey, darker).mean, 6)
    10.0
    """
    with reporting(progress, "colour error") as report:
        return ColorError(
            *_core.color_error(
                original,
                simplified,
                checked_samples(samples),
                seed_of(rng),
                epsilon,
                threads_of(threads),
                report,
            )
        )
