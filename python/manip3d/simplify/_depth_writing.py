"""Search for the number of points whose mesh has faces and fits the bytes, and its writing."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.texts import counted
from manip3d.errors import FormatError, InputError
from manip3d.io import write_mesh
from manip3d.simplify._bandwidth import MIN_POINTS, fit_bytes
from manip3d.simplify._depth import DepthSimplification
from manip3d.simplify._depth_options import (
    NO_RAY_WORDS,
    SPARSE_WORDS,
    DepthFileResult,
    DepthOptions,
    is_sparse,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.mesh import Mesh

_ONE_BY_ONE = 64  # `_enough_points` tries this many numbers of points before it doubles them
_BYTES_PER_POINT = 40.0  # in a .glb: a vertex with texture coordinates, and two faces


@dataclass
class LastFile:
    """Points and bytes of the file before in a sequence, from which the next search starts."""

    points: int = 0  # 0: there is none
    num_bytes: int = 0


@dataclass(frozen=True)
class Measured:
    """Number of measured pixels, and how many of them stand alone."""

    pixels: int
    lone: int
    is_masked: bool = False  # whether a mask was applied before they were counted
    is_line: bool = False  # whether the image has a single row or column

    @staticmethod
    def of(valid: NDArray[np.bool_], *, is_masked: bool = False) -> Measured:
        """Count the pixels; one of three measured pixels in a 2 x 2 square does not stand alone."""
        padded = np.pad(valid, 1).astype(np.uint8)
        square = padded[:-1, :-1] + padded[:-1, 1:] + padded[1:, :-1] + padded[1:, 1:]
        full = square >= 3
        joined = full[:-1, :-1] | full[:-1, 1:] | full[1:, :-1] | full[1:, 1:]
        lone = int(np.count_nonzero(valid & ~joined))
        return Measured(int(np.count_nonzero(valid)), lone, is_masked, min(valid.shape) == 1)


@dataclass(frozen=True, eq=False)
class Made:
    """Result of a method, and the mesh to write.

    ``faces_across`` and ``area_across`` are ``faces_left`` and ``left_area`` of `DepthFileResult`,
    which explains the other fields, too.
    """

    found: DepthSimplification
    mesh: Mesh
    faces_cut: int
    seconds: float
    num_bytes: int | None = None
    faces_across: int = 0
    area_across: float = 0.0


def write_simplified(
    make: Callable[[int], Made],
    source: Path,
    output: Path,
    options: DepthOptions,
    measured: Measured,
    *,
    has_steps: bool,
    last: LastFile | None = None,
) -> Made:
    """Simplify to the requested points, or to as many as the bytes allow, and write the mesh.

    ``make`` simplifies to a number of points. ``has_steps``: faces across depth steps are left out.
    In a sequence each further try would unsettle the mesh, so that a frame starts with the points
    of the one before, and need not use up its bytes.
    """
    allowance = options.max_bytes
    if allowance is None:
        assert options.points is not None
        made = _with_faces(make, options.points, source, options, measured, has_steps=has_steps)
        write_mesh(made.mesh, output)
        return made
    seconds = 0.0
    least: tuple[int, str] | None = None  # bytes of the smallest try, and what they hold
    guess, least_share = allowance / _BYTES_PER_POINT, 0.95
    if last is not None and last.points > 0:
        guess = last.points + (0.97 * allowance - last.num_bytes) / _BYTES_PER_POINT
        least_share = 0.7
    with tempfile.TemporaryDirectory() as folder:

        def written(points: int) -> tuple[Made, int, int] | None:
            nonlocal seconds, least
            trial = Path(folder, str(points), output.name)
            trial.parent.mkdir(exist_ok=True)
            made = make(points)
            seconds += made.seconds
            if made.mesh.num_faces == 0:
                return None
            write_mesh(made.mesh, trial)
            size = sum(path.stat().st_size for path in trial.parent.iterdir())
            if least is None or size < least[0]:
                pictured = any(material.textures for material in made.mesh.materials)
                least = size, f"{made.found.num_used} points{' with their picture' * pictured}"
            return replace(made, num_bytes=size), made.found.num_vertices, size

        fitting = fit_bytes(
            written,
            most_points=max(MIN_POINTS, min(options.points or measured.pixels, measured.pixels)),
            allowance=allowance,
            guess=guess,
            bytes_per_point=_BYTES_PER_POINT,
            least_share=least_share,
        )
        if fitting is None and options.method != "relief":  # three points may make no face
            enough = _enough_points(make, MIN_POINTS - 1, measured.pixels)
            fewest = None if enough is None else written(enough)
            if fewest is not None and fewest[2] <= allowance:
                fitting = fewest[0]
    if fitting is None:
        if least is None:
            _with_faces(make, MIN_POINTS, source, options, measured, has_steps=has_steps)
        assert least is not None
        assert options.rate is not None
        raise InputError(
            f"bandwidth: expected at least {least[0] * math.ceil(options.rate)} bytes a second: "
            f"{least[1]} are {least[0]} bytes, and a frame may have {allowance}"
        )
    write_mesh(fitting.mesh, output)
    if last is not None:
        last.points, last.num_bytes = fitting.found.num_vertices, fitting.num_bytes or 0
    return replace(fitting, seconds=seconds)


def _enough_points(make: Callable[[int], Made], points: int, most: int) -> int | None:
    """Return the smallest number above ``points`` that leaves a face, or None.

    Beyond the first `_ONE_BY_ONE` numbers only doubled ones are tried.
    """
    one_by_one = points + _ONE_BY_ONE
    more = points + 1
    while more <= most:
        if make(more).mesh.num_faces > 0:
            return more
        more = more + 1 if more < one_by_one else 2 * more
    return None


def _with_faces(
    make: Callable[[int], Made],
    points: int,
    source: Path,
    options: DepthOptions,
    measured: Measured,
    *,
    has_steps: bool,
) -> Made:
    """Return the mesh of ``make``; raise a FormatError with the reason if it has no face."""
    made = make(points)
    if made.mesh.num_faces > 0:
        return made
    pixels = counted(measured.pixels, "measured pixel")
    if measured.pixels == 0:
        found = "found no measured pixel"
        found += " of those that the mask leaves" if measured.is_masked else ""
    elif made.faces_cut > 0:
        faces = "the only face" if made.faces_cut == 1 else f"all {made.faces_cut} faces"
        found = f"found depth steps across {faces}: see depth_step"
    elif options.method == "relief":
        rules = ["a longer edge than max_edge"] if options.max_edge is not None else []
        rules += ["a depth step"] if has_steps else []
        without = f" without {' or '.join(rules)}" if rules else ""
        found = f"found {pixels}, of which no three meet in a square of two by two{without}"
    else:
        found = f"found {pixels}, but no face between those that were chosen"
    if without_ray := made.found.surface.without_ray:
        have = "has" if without_ray == 1 else "have"
        found += f"; {without_ray} of them {have} {NO_RAY_WORDS}"
    if measured.is_line:
        found += "; an image of one row or one column has no surface"
    elif is_sparse(measured.lone, measured.pixels):
        found += f"; {SPARSE_WORDS}"
    if measured.pixels > 0 and options.method != "relief":  # relief leaves a face for any number
        enough = _enough_points(make, points, measured.pixels)
        found += f"; {points} points are too few, {enough} leave one" if enough else ""
    raise FormatError(f"expected a surface, {found}", file=str(source))


def result_of(
    path: Path,
    output: Path,
    options: DepthOptions,
    made: Made,
    measured: Measured,
    **more: Any,
) -> DepthFileResult:
    """Return the result for one image; measures that a method lacks keep their defaults."""
    found = made.found
    reached = getattr(found, "reached", None)
    return DepthFileResult(
        source=path,
        output=output,
        options=options,
        points_before=measured.pixels,
        lone_pixels=measured.lone,
        points=found.num_used,
        faces=found.num_faces,
        stop=found.stop,
        reached=None if reached is None else str(reached),
        literal_count=getattr(found, "literal_count", None),
        seconds=made.seconds,
        faces_cut=made.faces_cut,
        num_bytes=made.num_bytes,
        coverage=found.coverage,
        bridges=found.bridges,
        filled=found.filled,
        outside=found.outside,
        without_ray=found.surface.without_ray,
        faces_left=made.faces_across,
        left_area=made.area_across,
        dropped_pixels=getattr(found, "dropped_pixels", 0),
        filled_pixels=getattr(found, "filled_pixels", 0),
        unsure_pixels=getattr(found, "unsure_pixels", 0),
        **more,
    )
