"""Texture error: displacement of texture coordinates between a mesh and its original."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting, seed_of, threads_of
from manip3d.metrics._distances import checked_samples

if TYPE_CHECKING:
    from manip3d._util.options import Progress, Rng
    from manip3d.mesh import Mesh


@dataclass(frozen=True)
class TextureError:
    """Deviation of texture coordinates; see :func:`texture_error`.

    Attributes
    ----------
    mean, rms, mse, max : float or None
        Statistics of the distances between texture coordinates (1 = a whole texture); ``mse`` is
        the square of ``rms``. ``None`` when no sample could be compared.
    samples : int
        Number of compared samples.
    skipped : int
        Number of samples on a face without texture coordinates, or whose closest faces have none.
    material_mismatch_rate : float
        Share of all samples whose closest faces have another material; they are not compared.
    outside_charts : float or None
        Share of the textured part of the simplified surface, by as many area-uniform samples of
        its own, whose texture coordinates no face of the original with the same material has. It
        shows what is between the charts of an atlas: the background, or the margin around charts.
        ``None`` when no sample is textured.
    """

    mean: float | None
    rms: float | None
    mse: float | None
    max: float | None
    samples: int
    skipped: int
    material_mismatch_rate: float
    outside_charts: float | None


@checked
def texture_error(
    original: Mesh,
    simplified: Mesh,
    *,
    samples: int | None = None,
    rng: Rng = 0,
    epsilon: float = 1e-4,
    threads: int = 0,
    progress: Progress = None,
) -> TextureError:
    """Measure how far texture coordinates moved on the surface.

    Area-uniform samples of the original are compared with the interpolated texture coordinates at
    the closest point of the simplified surface. If several faces are within ``epsilon`` of the
    closest distance, the one of the sample's material with the nearest texture coordinates counts,
    so that a seam is not an error.

    Parameters
    ----------
    original, simplified : Mesh
        In the same units and place; at least one face each.
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
    TextureError

    Raises
    ------
    InputError
        A mesh has no faces; the original has no area; ``samples`` is below 1; ``epsilon`` is
        negative.

    Notes
    -----
    H. Hoppe: New quadric metric for simplifying meshes with appearance attributes, IEEE
    Visualization 1999. Materials are equal if their names are (the n-th material of a name
    corresponds to the n-th one of that name), or by index if a mesh has no table of materials.

    Examples
    --------
    >>> from manip3d import metrics, simulate
    >>> head = simulate.models.head(faces=2000)
    >>> shifted = head.replace(texcoords=head.texcoords + [0.25, 0.0])
    >>> round(metrics.texture_error(head, shifted).mean, 3)
    0.25
    """
    with reporting(progress, "texture error") as report:
        return TextureError(
            *_core.texture_error(
                original,
                _with_materials_of(original, simplified),
                checked_samples(samples),
                seed_of(rng),
                epsilon,
                threads_of(threads),
                report,
            )
        )


def _with_materials_of(original: Mesh, simplified: Mesh) -> Mesh:
    """``simplified`` with its materials numbered as in ``original``; new ones come after those."""
    face_material = simplified.face_material
    if face_material is None or not original.materials or not simplified.materials:
        return simplified
    known = {key: index for index, key in enumerate(_keys(original))}
    numbers = np.arange(-1, max(len(simplified.materials), face_material.max(initial=-1) + 1))
    numbers[numbers >= 0] += len(known)  # a material that the original does not have
    for index, key in enumerate(_keys(simplified)):
        numbers[index + 1] = known.get(key, numbers[index + 1])
    return simplified.replace(face_material=numbers[face_material + 1])


def _keys(mesh: Mesh) -> list[tuple[str, int]]:
    """Name of each material, and the number of earlier materials with this name."""
    seen: Counter[str] = Counter()
    keys = []
    for material in mesh.materials:
        keys.append((material.name, seen[material.name]))
        seen[material.name] += 1
    return keys
