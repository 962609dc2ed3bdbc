"""Options for simplifying a depth image or a range scan in a file, and the result."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.simplify._bandwidth import MIN_POINTS, Bandwidth
from manip3d.simplify._depth import Variant, expect_radii
from manip3d.simplify._depth_steps import DEPTH_STEP
from manip3d.simplify._depth_words import COMMON_GUESS, DepthFound
from manip3d.simplify._relief import Effort

DepthMethod = Literal["relief", "cs3", "uniform", "poisson", "ssa"]
SPARSE_WORDS = (
    "most measured pixels stand alone, as in an image that a LiDAR was projected into: no method "
    "here makes a surface of them; in Python, simplify.grid_delaunay joins pixels at any distance"
)
"""Advice about an image whose result `is_sparse`."""
NO_RAY_WORDS = "no line of sight (the lens model cannot be inverted there)"
_MIN_PROJECTED = 50  # fewer lone pixels are noise, not a projected scan


def is_sparse(lone: int, measured: int) -> bool:
    """Return whether most measured pixels stand alone, as in a projected LiDAR scan.

    `Measured` defines lone pixels.
    """
    return 2 * lone > measured and lone >= _MIN_PROJECTED


@checked
@dataclass(frozen=True)
class DepthOptions:
    """Options for making sparse meshes of depth images or range scans.

    Attributes
    ----------
    points : int or None
        Largest number of vertices; None: ``ratio`` or ``bandwidth`` sets it.
    method : 'relief', 'cs3', 'uniform', 'poisson' or 'ssa'
        Simplification method: `relief`, `cs3`, or a baseline of `sample_depth`.
    variant : 'cios', 'lios', 'cnms' or 'lnms'
        Variant of ``cs3``.
    intrinsics : str
        Camera of a depth image, as `manip3d.camera.read_intrinsics` takes it; not for a scan.
    unit : str
        Unit of a depth image, as `manip3d.io.read_depth_guessing` takes it; not for a scan. Of a
        unit as ``guess:mm``, one guessed for several images (`common_depth_unit`), results say that
        it is a guess.
    max_edge : float or None, metres, or the unit of the scan
        Faces with a longer edge are left out. With method ``relief`` the limit holds for edges
        between neighbouring pixels.
    depth_step : float
        Faces across a larger step in depth are left out, see `cut_depth_steps`; 0: all faces stay.
        A scan, which has no depth, takes only the default.
    by_distance : bool
        Put more points on near surfaces (``cs3`` of a depth image, variants ``cios`` and ``lios``).
    move_points : bool
        Let vertices leave the measured points (``relief``).
    seed : int
        Seed of ``poisson``.
    threads : int
        0: all cores.
    min_coverage : float
        Share of the measured pixels, 0 to 1; a result that covers less sets ``coverage_missed``.
    bandwidth, rate : float or None, bytes and frames a second
        Give both or neither: the files of a result have at most ``bandwidth / rate`` bytes.
    max_bridges : float
        Share of the mesh's area, 0 to 1; a result with more bridges sets ``bridges_missed``. Filled
        pinholes do not count.
    effort : 'live', 'fast', 'balanced', 'fine' or 'best'
        Slower efforts have a smaller error (``relief``).
    ratio : float or None
        Largest number of vertices as a share of the measured pixels, above 0 and up to 1, in place
        of ``points``. At least three vertices are allowed.
    ray_depth : bool
        The numbers of a depth image are distances from the camera along the lines of sight, as
        those of Hypersim and SceneNet, and no depths along the optical axis. They are converted
        with the camera's lens. Not for a scan.

    Raises
    ------
    InputError
        A value of another type or out of range, an option that does not go with the method, or
        no number of points: neither ``points`` nor ``ratio`` nor ``bandwidth`` with ``rate``.
    """

    points: int | None = None
    method: DepthMethod = "relief"
    variant: Variant = "cios"
    intrinsics: str = ""
    unit: str = "guess"
    max_edge: float | None = None
    depth_step: float = DEPTH_STEP
    by_distance: bool = False
    move_points: bool = False
    seed: int = 0
    threads: int = 0
    min_coverage: float = 0.9
    bandwidth: float | None = None
    rate: float | None = None
    max_bridges: float = 0.1
    effort: Effort = "balanced"
    ratio: float | None = None
    ray_depth: bool = False

    @property
    def is_unit_guessed(self) -> bool:
        """Whether the unit is to be guessed, or was guessed for several images."""
        return self.unit == "guess" or self.unit.startswith(COMMON_GUESS)

    @property
    def max_bytes(self) -> int | None:
        """Largest number of bytes of a frame, or None without a bandwidth."""
        if self.bandwidth is None or self.rate is None:
            return None
        return Bandwidth(self.bandwidth, self.rate).share

    def __post_init__(self) -> None:
        if self.method != "cs3" and (self.variant != "cios" or self.by_distance):
            raise InputError(
                f"variant, by_distance: can only be given with method cs3, got {self.method}"
            )
        expect_radii(self.variant, self.by_distance, "by_distance")
        if self.method != "relief" and self.move_points:
            raise InputError(
                f"move_points: can only be given with method relief, got {self.method}"
            )
        if self.method != "relief" and self.effort != "balanced":
            raise InputError(f"effort: can only be given with method relief, got {self.method}")
        if self.points is not None and self.points < MIN_POINTS:
            raise InputError(f"points: expected at least {MIN_POINTS}, got {self.points}")
        if self.max_edge is not None and not self.max_edge > 0:
            raise InputError(f"max_edge: expected > 0, got {self.max_edge}")
        threads_of(self.threads)
        if self.seed < 0:
            raise InputError(f"seed: expected >= 0, got {self.seed}")
        if self.method != "poisson" and self.seed != 0:
            raise InputError(f"seed: can only be given with method poisson, got {self.method}")
        if not 0 <= self.depth_step <= float(np.finfo(np.float32).max):
            raise InputError(f"depth_step: expected >= 0 and finite, got {self.depth_step}")
        for name in ("min_coverage", "max_bridges"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name}: expected 0 to 1, got {getattr(self, name)}")
        if (self.bandwidth is None) != (self.rate is None):
            raise InputError("bandwidth, rate: expected both or none of them")
        has_bytes = self.max_bytes is not None  # checks both
        if self.ratio is not None:
            if self.points is not None:
                raise InputError("points, ratio: expected one of them, got both")
            if not 0 < self.ratio <= 1:
                raise InputError(f"ratio: expected more than 0 to 1, got {self.ratio}")
        elif not has_bytes and self.points is None:
            raise InputError(
                "points: expected a number, or ratio, or bandwidth and rate, got none of them"
            )

    def for_pixels(self, measured: int) -> DepthOptions:
        """Return the options with ``points`` in place of ``ratio``.

        Parameters
        ----------
        measured : int
            Number of measured pixels of all views.
        """
        if self.ratio is None:
            return self
        return replace(self, points=max(MIN_POINTS, int(self.ratio * measured)), ratio=None)


@dataclass(frozen=True)
class DepthFileResult:
    """Result for one depth image or scan.

    Attributes
    ----------
    source, output : Path
    options : DepthOptions
    depth : str
        No image but a sentence, on the depth range and unit that were assumed, or on why an
        organised cloud is no depth image; empty for scans.
    unit : str
        The unit that was used; empty for scans.
    depth_found : DepthFound
        Unit and range in single values: ``unit``, ``is_guess``, ``doubt``, ``near`` and ``far`` in
        metres, and ``num_marked``. Empty for scans.
    points_before, points : int
        Number of measured points, and of vertices that a face uses.
    faces : int
        Number of faces.
    faces_cut : int
        Number of faces that were left out because they spanned a step in depth.
    faces_left : int
        Number of faces across steps in depth (by `DEPTH_STEP`) that were left in the mesh, because
        ``depth_step`` is 0 and there is no ``max_edge``.
    left_area : float
        Share of the mesh's area in these faces.
    dropped_pixels : int
        Pixels of the surface that a ``relief`` left out: of small pieces, or with the ``stop``
        ``few_faces`` those of most triangles.
    filled_pixels : int
        Pixels of pinholes that a ``relief`` continued the surface over.
    unsure_pixels : int
        Measured pixels that a ``relief`` left out, as pieces of the surface without confidence.
    stop : str
        Reason why the run stopped, as in `DepthSimplification` and `Relief`.
    reached : str or None
        Step of ``cs3`` that set the number of points, as in `Cs3Result`.
    literal_count : int or None
        Points that the printed formulas give (``cs3``).
    seconds : float
        Time of the method alone, without reading, leaving out faces, and writing. With a
        bandwidth, the time of all tries.
    coverage : float
        Share of the dense mesh's pixels that lie in or on a face. The dense mesh joins all
        neighbouring measured pixels by triangles without an edge longer than ``max_edge``.
    bridges : float
        Share of the faces' area that lies over no triangle of the dense mesh, slivers along
        contours included.
    filled : float
        The part of ``bridges`` over pinholes that a ``relief`` filled on purpose.
    outside : float
        Share of the measured pixels that no triangle of the dense mesh uses.
    without_ray : int
        Measured pixels without a line of sight, because the lens model cannot be inverted there;
        they count as ``outside``.
    num_bytes : int or None
        Bytes of all written files, if ``options`` have a bandwidth.
    lone_pixels : int
        Number of measured pixels that stand alone: no square of two by two pixels holds the pixel
        and two other measured ones.
    """

    source: Path
    output: Path
    options: DepthOptions
    depth: str = ""
    unit: str = ""
    points_before: int = 0
    points: int = 0
    faces: int = 0
    faces_cut: int = 0
    faces_left: int = 0
    left_area: float = 0.0
    dropped_pixels: int = 0
    filled_pixels: int = 0
    stop: str = "target"
    reached: str | None = None
    literal_count: int | None = None
    seconds: float = 0.0
    coverage: float = 1.0
    bridges: float = 0.0
    filled: float = 0.0
    outside: float = 0.0
    num_bytes: int | None = None
    lone_pixels: int = 0
    depth_found: DepthFound = field(default_factory=DepthFound)
    without_ray: int = 0
    unsure_pixels: int = 0

    def __repr__(self) -> str:
        sizes = f"{counted(self.points, 'point')}, {counted(self.faces, 'face')}"
        return f"<manip3d.simplify.DepthFileResult: {self.output}, {sizes}; {self.stop}>"

    @property
    def is_sparse(self) -> bool:
        """Whether most measured pixels stand alone, as in a LiDAR scan projected into an image.

        No method of this module makes a surface of such pixels.
        """
        return is_sparse(self.lone_pixels, self.points_before)

    @property
    def coverage_missed(self) -> bool:
        """Whether less than ``options.min_coverage`` of the measured pixels are covered.

        Measured pixels outside the dense mesh count as not covered.
        """
        return not self.coverage * (1.0 - self.outside) >= self.options.min_coverage

    @property
    def bridges_missed(self) -> bool:
        """Whether more than ``options.max_bridges`` of the area are bridges or across steps.

        Filled pinholes do not count.
        """
        return not self.unwanted_bridges <= self.options.max_bridges

    @property
    def unwanted_bridges(self) -> float:
        """Share of the area in bridges and in faces across steps, without filled pinholes."""
        return self.bridges - self.filled + self.left_area

    @property
    def target_missed(self) -> bool:
        """Whether the mesh has fewer than 99 % of the requested (or of all measured) points.

        Always False if the bandwidth sets the number of points.
        """
        if self.options.points is None or self.num_bytes is not None:
            return False
        most = self.points_before - self.unsure_pixels
        return self.points < 0.99 * min(self.options.points, most)


def check_confidence(options: DepthOptions, is_given: bool) -> None:
    if is_given and options.method != "relief":
        raise InputError(f"confidence: can only be given with method relief, got {options.method}")


def expect_options_of_scan(options: DepthOptions) -> None:
    """Raise an InputError for options that a scan cannot obey."""
    given = {
        "by_distance": options.by_distance,
        "intrinsics": options.intrinsics != "",
        "unit": options.unit != "guess",
        "ray_depth": options.ray_depth,
        "depth_step": options.depth_step != DEPTH_STEP,
    }
    for name, is_given in given.items():
        if is_given:
            raise InputError(f"{name}: can only be given with a depth image, got a scan")
