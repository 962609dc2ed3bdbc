"""Simplify depth images and range scans in files to mesh files."""

from __future__ import annotations

import functools
import math
import os
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.paths import by_number, path_of
from manip3d.camera import (
    CAMERA_PRESETS,
    CAMERA_SUFFIXES,
    Intrinsics,
    camera_depth_unit,
    checked_depth,
    read_intrinsics,
)
from manip3d.errors import FormatError, InputError
from manip3d.io import (
    DEPTH_SUFFIXES,
    DepthReading,
    RangeGrid,
    read_depth_guessing,
    read_pixel_map,
    read_range_grid,
    write_mesh,
)
from manip3d.io._depth_units import depth_reading
from manip3d.io._images import read_color
from manip3d.simplify._bandwidth import MIN_POINTS, Bandwidth, fit_bytes
from manip3d.simplify._depth import DenseImage, DepthSimplification, Variant, cs3, cs3_grid
from manip3d.simplify._depth_steps import DEPTH_STEP, cut_depth_steps
from manip3d.simplify._depth_words import COMMON_GUESS, DepthFound
from manip3d.simplify._organised import (
    CloudCamera,
    far_origin,
    find_camera,
    is_cloud_file,
    rows_go_up,
    scan_rows_go_up,
)
from manip3d.simplify._parts import with_used_vertices
from manip3d.simplify._pixel_maps import confidence_of_levels, mask_image, masked_depth
from manip3d.simplify._relief import Effort, relief, relief_grid
from manip3d.simplify._sampling import sample_depth, sample_depth_grid

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.camera import Registration
    from manip3d.mesh import Mesh

DepthMethod = Literal["relief", "cs3", "uniform", "poisson", "ssa"]
_IMAGE_SUFFIXES = (*DEPTH_SUFFIXES, ".jpg", ".jpeg", ".bmp", ".ppm", ".webp")
_YUP_SUFFIXES = (".glb", ".gltf")
_FRAMES_FOR_A_GUESS = 9
_ONE_BY_ONE = 64  # `_enough_points` tries this many numbers of points before it doubles them
_BYTES_PER_POINT = 40.0  # in a .glb: a vertex with texture coordinates, and two faces
SPARSE_WORDS = (
    "most measured pixels stand alone, as in an image that a LiDAR was projected into: no method "
    "here makes a surface of them; in Python, simplify.grid_delaunay joins pixels at any distance"
)
"""Advice about an image whose result `is_sparse`."""
_MIN_PROJECTED = 50  # fewer lone pixels are noise, not a projected scan
_NO_CAMERA = (
    "an organised cloud whose points are not those of a camera's pixels: faces across depth steps "
    "stay without a max_edge"
)


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
        Put more points on near surfaces (``cs3`` of a depth image).
    move_points : bool
        Let vertices leave the measured points (``relief``).
    seed : int
        Seed of the random methods (``poisson``).
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
        A sentence on the depth range and unit that were assumed, or on why an organised cloud is
        no depth image; empty for scans.
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
        Number of faces across steps in depth (by `DEPTH_STEP`) that were kept because
        ``depth_step`` is 0 and there is no ``max_edge``.
    left_area : float
        Share of the mesh's area in these faces.
    dropped_pixels : int
        Pixels of small pieces of the surface that a ``relief`` left out.
    filled_pixels : int
        Pixels of pinholes that a ``relief`` continued the surface over.
    stop : str
        Why the run stopped, as in `DepthSimplification`.
    reached : str or None
        Which step of ``cs3`` set the number of points, as in `Cs3Result`.
    literal_count : int or None
        Points that the printed formulas give (``cs3``).
    seconds : float
        Time of the method alone, without reading, leaving out faces, and writing. With a
        bandwidth, the time of all tries.
    coverage : float
        Share of the dense mesh's pixels that lie in or on a face. The dense mesh joins all
        neighbouring measured pixels by triangles without an edge longer than ``max_edge``.
    bridges : float
        Share of the faces' area that lies over no triangle of the dense mesh.
    filled : float
        The part of ``bridges`` over pinholes that a ``relief`` filled on purpose.
    outside : float
        Share of the measured pixels that no triangle of the dense mesh uses.
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
        return self.points < 0.99 * min(self.options.points, self.points_before)


@checked
def simplify_depth(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    options: DepthOptions,
    *,
    color: ArrayLike | None = None,
    registration: Registration | None = None,
    mask: ArrayLike | None = None,
    confidence: ArrayLike | None = None,
) -> DepthSimplification:
    """Simplify a depth image by any method, without faces across steps in depth.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        0 and NaN mean no measurement.
    intrinsics : Intrinsics
    options : DepthOptions
        ``intrinsics`` and ``unit`` are ignored, since the other arguments state them.
    color : (H', W', 3 or 4) uint8, optional
        Colour image of the depth image's size, or that of ``registration.color``.
    registration : Registration, optional
        Position of the colour camera; without it both images share their pixels.
    mask : (H, W) bool, optional
        Pixels to use; the others count as not measured.
    confidence : (H, W) float, 0 to 1, optional
        Confidence of each pixel, as for `relief`; not with the other methods.

    Returns
    -------
    DepthSimplification
        The method's own result.

    Raises
    ------
    InputError
        As `cs3`, `relief` and `sample_depth`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, simplify
    >>> camera = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)
    >>> wall = np.full((48, 64), 2000, np.uint16)
    >>> options = simplify.DepthOptions(100, method="relief")
    >>> simplify.simplify_depth(wall, camera, options).num_vertices <= 100
    True
    """
    image = checked_depth(depth, intrinsics)
    image = masked_depth(image, mask_image(mask, image.shape))
    options = options.for_pixels(int(np.count_nonzero(image > 0)))
    if options.points is None:
        raise InputError("options.points: expected a number, as nothing is written here, got None")
    uncut = _uncut(image, intrinsics, options, options.points, color, registration, confidence)
    return cut_depth_steps(uncut, image, step=options.depth_step) if options.depth_step else uncut


def _uncut(
    depth: ArrayLike,
    intrinsics: Intrinsics,
    options: DepthOptions,
    points: int,
    color: ArrayLike | None,
    registration: Registration | None = None,
    confidence: ArrayLike | None = None,
) -> DepthSimplification:
    """Apply a method to an image, without cutting faces across depth steps afterwards."""
    asked: dict[str, Any] = {
        "max_edge": options.max_edge,
        "color": color,
        "registration": registration,
        "threads": options.threads,
    }
    _check_confidence(options, confidence is not None)
    if options.method == "cs3":
        asked |= {"variant": options.variant, "distance_dependent": options.by_distance}
        return cs3(depth, intrinsics, points, **asked)
    if options.method == "relief":
        asked |= {"move_points": options.move_points, "depth_step": options.depth_step or None}
        asked |= {"confidence": confidence, "effort": options.effort}
        return relief(depth, intrinsics, points, **asked)
    asked |= {"method": options.method, "rng": options.seed}
    return sample_depth(depth, intrinsics, points, **asked)


def _check_confidence(options: DepthOptions, is_given: bool) -> None:
    if is_given and options.method != "relief":
        raise InputError(f"confidence: can only be given with method relief, got {options.method}")


@checked
def simplify_depth_file(
    source: str | os.PathLike[str],
    output: str | os.PathLike[str],
    options: DepthOptions,
    *,
    color: str | os.PathLike[str] | None = None,
    mask: str | os.PathLike[str] | None = None,
    confidence: str | os.PathLike[str] | None = None,
    confidence_max: int | None = None,
) -> DepthFileResult:
    """Turn one depth image or range scan into a sparse textured mesh in a file.

    Parameters
    ----------
    source : path-like
        A depth image (``manip3d.io.DEPTH_SUFFIXES``), or a range scan or an organised cloud, as
        `manip3d.io.read_range_grid` reads them. An organised cloud of a depth camera is treated as
        its depth image: the camera is estimated from the points, and the colours are the texture.
        If the cloud was transformed to another frame, the mesh is in that frame. The rows of a
        range scan go upwards, as Stanford's do, unless its points are those of a camera's pixels.
    output : path-like
        A mesh file. The mesh of a depth image is in metres, with +y up in glTF and in the camera's
        axes in other formats. Scans keep their unit and axes.
    options : DepthOptions
        Method, target and limits.
    color : path-like, optional
        Colour image with the pixels of the depth image, used as the texture.
    mask : path-like, optional
        An image of the same size, as `manip3d.io.read_pixel_map` reads it. Pixels where it is 0 or
        NaN count as not measured.
    confidence : path-like, optional
        An image of the same size with the confidence of each pixel (``relief``): floats from 0 to
        1, or integer levels up to ``confidence_max``.
    confidence_max : int, optional
        The level that stands for confidence 1; default: the largest number that the file's pixels
        can hold.

    Returns
    -------
    DepthFileResult

    Raises
    ------
    InputError
        A depth image without ``intrinsics``, or an option that does not go with the source.
    FormatError, OSError, MissingExtraError
        As `manip3d.io.read_depth_guessing`, `manip3d.io.read_range_grid` and `write_mesh`. A mesh
        without faces is a FormatError, too, and is not written.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import simplify
    >>> np.save("wall.npy", np.full((480, 640), 2.0, np.float32))
    >>> options = simplify.DepthOptions(500, intrinsics="tum")
    >>> found = simplify.simplify_depth_file("wall.npy", "wall.ply", options)
    >>> found.points <= 500, found.coverage > 0.99
    (True, True)
    """
    path, target = path_of(source, "source"), path_of(output, "output")
    maps = read_maps(options, color, mask, confidence, confidence_max)
    if path.suffix.lower() in DEPTH_SUFFIXES and not is_cloud_file(path):
        return from_image(path, target, options, maps)
    return _from_scan(path, target, options, maps)


@dataclass(frozen=True, eq=False)
class Maps:
    """Colours, mask and confidences that belong to a depth image."""

    color: NDArray[np.uint8] | None
    mask: NDArray[np.bool_] | None = None
    confidence: NDArray[Any] | None = None
    registration: Registration | None = None  # None: the colour image has the depth image's pixels


def read_maps(
    options: DepthOptions,
    color: str | os.PathLike[str] | None,
    mask: str | os.PathLike[str] | None,
    confidence: str | os.PathLike[str] | None,
    confidence_max: int | None,
) -> Maps:
    _check_confidence(options, confidence is not None)
    if confidence_max is not None and confidence is None:
        raise InputError("confidence_max: can only be given with confidence")
    return Maps(
        None if color is None else read_color(path_of(color, "color")),
        None if mask is None else np.nan_to_num(read_pixel_map(path_of(mask, "mask"))) != 0,
        None if confidence is None else _read_confidence(confidence, confidence_max),
    )


def _read_confidence(path: str | os.PathLike[str], highest: int | None) -> NDArray[Any]:
    found = read_pixel_map(path_of(path, "confidence"))
    if found.dtype.kind == "f":
        if highest is not None:
            raise InputError(
                "confidence_max: can only be given with whole numbers, got floats in the file"
            )
        return found
    levels = found.astype(np.uint8) if found.dtype == np.bool_ else found
    if highest is None:
        highest = 1 if found.dtype == np.bool_ else 2 ** (8 * levels.dtype.itemsize) - 1
    if highest < 1:
        raise InputError(f"confidence_max: expected at least 1, got {highest}")
    if levels.max() > highest:
        raise InputError(f"confidence_max: expected at least {levels.max()}, got {highest}")
    return confidence_of_levels(levels, highest)


_CAMERAS_BESIDE = (
    "calib.txt", "camera-intrinsics.txt", "intrinsic_depth.txt", "intrinsics.txt", "cameras.txt",
    "camera.xml", "camera.yaml", "camera.yml", "camera_info.yaml", "camera.json", "intrinsics.json",
)  # fmt: skip


def expect_camera(intrinsics: str, image: Path) -> None:
    if intrinsics:
        return
    folders = (image.parent, image.absolute().parent.parent)
    near = (folder / name for folder in folders for name in _CAMERAS_BESIDE)
    beside = [str(path) for path in near if path.is_file()]
    raise InputError(
        f"intrinsics: expected the camera of the depth image: fx,fy,cx,cy, a file "
        f"({', '.join(CAMERA_SUFFIXES)}) or one of {', '.join(CAMERA_PRESETS)}, got none"
        + (f"; {beside[0]} may be it" if beside else "")
    )


def writes_y_up(output: Path) -> bool:
    """Return whether a mesh file has +y up: glTF does, by its standard."""
    return output.name.lower().removesuffix(".xz").removesuffix(".gz").endswith(_YUP_SUFFIXES)


def with_y_up(mesh: Mesh, camera: Intrinsics) -> Mesh:
    """Turn a mesh from a camera's axes, where it lies ahead along +z, to those of glTF, +y up.

    Half a turn about x lets y point up, or about y where it does already. Neither mirrors the mesh.
    """
    turn = [-1.0, 1.0, -1.0] if y_points_up(camera) else [1.0, -1.0, -1.0]
    return mesh.replace(vertices=mesh.vertices * np.array(turn))


def y_points_up(camera: Intrinsics) -> bool:
    if camera.rays is None:
        return camera.fy < 0
    steps = np.diff(camera.rays[..., 1], axis=0)
    return bool(np.count_nonzero(steps < 0) > np.count_nonzero(steps > 0))


@dataclass
class LastFile:
    """Points and bytes of the file before in a sequence, from which the next search starts."""

    points: int = 0  # 0: there is none
    num_bytes: int = 0


class Taken(NamedTuple):
    """An image that is prepared: what simplifies it to a number of points, and the file before."""

    simplify: Callable[[int], DepthSimplification]
    last: LastFile | None = None  # None: the image is on its own


_Take = Callable[["NDArray[Any]", Intrinsics, DepthOptions, Maps], Taken]
"""Prepares an image."""


def frame_alone(
    depth: NDArray[Any], camera: Intrinsics, options: DepthOptions, maps: Maps
) -> Taken:
    """Prepare an image on its own, without regard to previous frames (a `_Take`)."""

    def uncut(points: int) -> DepthSimplification:
        return _uncut(
            depth, camera, options, points, maps.color, maps.registration, maps.confidence
        )

    return Taken(uncut)


def from_image(
    path: Path, output: Path, options: DepthOptions, maps: Maps, take: _Take = frame_alone
) -> DepthFileResult:
    expect_camera(options.intrinsics, path)
    reading, words, doubt = read_frame(path, options)
    height, width = reading.depth.shape
    camera = read_intrinsics(options.intrinsics, width=width, height=height)
    depth = masked_depth(reading.depth, mask_image(maps.mask, reading.depth.shape))
    made = from_depth(depth, camera, path, output, options, maps, take, words, reading.unit)
    return replace(made, depth_found=DepthFound.of(reading, doubt))


def from_depth(
    depth: NDArray[Any],
    camera: Intrinsics,
    path: Path,
    output: Path,
    options: DepthOptions,
    maps: Maps,
    take: _Take,
    words: str,
    unit: str,
    to_file: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
) -> DepthFileResult:
    """Simplify an image in memory and write the mesh.

    ``path`` names the image in errors and in the result. ``words`` is the ``depth`` of the result.
    ``to_file`` transforms vertices from the camera's frame to that of the file; by default they
    stay in the camera's axes, or get +y up where the format has that.
    """
    is_y_up = writes_y_up(output)
    measured = Measured.of(depth > 0, is_masked=maps.mask is not None)
    options = options.for_pixels(measured.pixels)
    started = time.perf_counter()
    uncut_of, last = take(depth, camera, options, maps)
    preparation = time.perf_counter() - started

    def make(points: int) -> _Made:
        started = time.perf_counter()
        uncut = uncut_of(points)
        seconds = time.perf_counter() - started
        found = uncut
        assert isinstance(uncut.surface, DenseImage)
        simplified = uncut.surface.depth  # the image, or its mean over time
        if options.depth_step:
            found = cut_depth_steps(uncut, simplified, step=options.depth_step)
        left, left_area = 0, 0.0
        if not options.depth_step and options.max_edge is None:
            without = cut_depth_steps(uncut, simplified)
            left = uncut.num_faces - without.num_faces
            left_area = 1.0 - _area(without) / (_area(uncut) or 1.0) if left else 0.0
        mesh = with_used_vertices(found.mesh)
        if to_file is not None:
            mesh = mesh.replace(vertices=to_file(mesh.vertices))
        elif is_y_up:
            mesh = with_y_up(mesh, camera)
        cut = max(0, uncut.num_faces - found.num_faces)
        return _Made(found, mesh, cut, seconds, faces_left=left, left_area=left_area)

    made = _write(
        make, path, output, options, measured, has_steps=options.depth_step > 0, last=last
    )
    made = replace(made, seconds=made.seconds + preparation)
    return _result(path, output, options, made, measured, depth=words, unit=unit)


@dataclass(frozen=True)
class Measured:
    """Number of measured pixels, and how many of them stand alone."""

    pixels: int
    lone: int
    is_masked: bool = False  # whether a mask was applied before they were counted

    @staticmethod
    def of(valid: NDArray[np.bool_], *, is_masked: bool = False) -> Measured:
        """Count the pixels; one of three measured pixels in a 2 x 2 square does not stand alone."""
        padded = np.pad(valid, 1).astype(np.uint8)
        square = padded[:-1, :-1] + padded[:-1, 1:] + padded[1:, :-1] + padded[1:, 1:]
        full = square >= 3
        joined = full[:-1, :-1] | full[:-1, 1:] | full[1:, :-1] | full[1:, 1:]
        lone = int(np.count_nonzero(valid & ~joined))
        return Measured(int(np.count_nonzero(valid)), lone, is_masked)


@dataclass(frozen=True, eq=False)
class _Made:
    """Result of a method, and the mesh to write; `DepthFileResult` explains the other fields."""

    found: DepthSimplification
    mesh: Mesh
    faces_cut: int
    seconds: float
    num_bytes: int | None = None
    faces_left: int = 0
    left_area: float = 0.0


def _area(found: DepthSimplification) -> float:
    p, q, r = (found.vertices[found.faces[:, i]].astype(np.float64) for i in range(3))
    return float(np.linalg.norm(np.cross(q - p, r - p), axis=1).sum()) / 2


def _write(
    make: Callable[[int], _Made],
    source: Path,
    output: Path,
    options: DepthOptions,
    measured: Measured,
    *,
    has_steps: bool,
    last: LastFile | None = None,
) -> _Made:
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

        def written(points: int) -> tuple[_Made, int, int] | None:
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


def _enough_points(make: Callable[[int], _Made], points: int, most: int) -> int | None:
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
    make: Callable[[int], _Made],
    points: int,
    source: Path,
    options: DepthOptions,
    measured: Measured,
    *,
    has_steps: bool,
) -> _Made:
    """Return the mesh of ``make``; raise a FormatError with the reason if it has no face."""
    made = make(points)
    if made.mesh.num_faces > 0:
        return made
    pixels = "1 measured pixel" if measured.pixels == 1 else f"{measured.pixels} measured pixels"
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
    if is_sparse(measured.lone, measured.pixels):
        found += f"; {SPARSE_WORDS}"
    if measured.pixels > 0 and options.method != "relief":  # relief leaves a face for any number
        enough = _enough_points(make, points, measured.pixels)
        found += f"; {points} points are too few, {enough} leave one" if enough else ""
    raise FormatError(f"expected a surface, {found}", file=str(source))


def read_frame(path: Path, options: DepthOptions) -> tuple[DepthReading, str, str]:
    """Read a depth image; describe its unit in words, and state a reason to doubt it, or none.

    The unit of the camera preset, if it has one, overrides the guess.
    """
    reading = read_depth_guessing(path, unit=options.unit.removeprefix(COMMON_GUESS))
    if options.unit.startswith(COMMON_GUESS):
        reading = replace(reading, guessed=True, reason="most of the images look like it")
        return reading, reading.sentence, reading.doubt
    unit = camera_depth_unit(options.intrinsics) if reading.guessed else "guess"
    of_stereo = unit.startswith("disparity:")
    if unit == "guess" or (reading.unit == "m" and not of_stereo):
        return reading, reading.sentence, reading.doubt
    known = read_depth_guessing(path, unit=unit)
    words = f"{known.sentence}, as intrinsics {options.intrinsics} has it"
    doubt = known.doubt
    if known.unit != reading.unit and not of_stereo:
        doubt = f"the numbers look like {reading.unit}: {reading.reason}"
        words += f"; but {doubt}"
    return known, words, doubt


def _from_scan(path: Path, output: Path, options: DepthOptions, maps: Maps) -> DepthFileResult:
    grid = read_range_grid(path)
    is_cloud = is_cloud_file(path)
    camera = find_camera(grid) if is_cloud else None
    if camera is not None:
        return from_cloud(grid, camera, path, output, options, maps)
    expect_options_of_scan(options)
    maps = maps if maps.color is not None else replace(maps, color=grid.color)
    mask = mask_image(maps.mask, grid.valid.shape)
    valid = grid.valid if mask is None else grid.valid & mask
    measured = Measured.of(valid, is_masked=mask is not None)
    options = options.for_pixels(measured.pixels)
    asked: dict[str, Any] = {"max_edge": options.max_edge, "color": maps.color}
    origin = far_origin(grid)
    asked |= {"rows_up": rows_go_up(grid, origin) if is_cloud else scan_rows_go_up(grid)}
    function: Callable[..., DepthSimplification]
    if options.method == "cs3":
        function = cs3_grid
        asked |= {"variant": options.variant, "threads": options.threads}
    elif options.method == "relief":
        function = relief_grid
        asked |= {"move_points": options.move_points, "threads": options.threads}
        asked |= {"confidence": maps.confidence, "effort": options.effort}
    else:
        function = sample_depth_grid
        asked |= {"method": options.method, "rng": options.seed}

    def make(points: int) -> _Made:
        started = time.perf_counter()
        found = function(grid.points - origin, valid, points, **asked)
        seconds = time.perf_counter() - started
        mesh = with_used_vertices(found.mesh)
        return _Made(found, mesh.replace(vertices=mesh.vertices + origin), 0, seconds)

    made = _write(make, path, output, options, measured, has_steps=False)
    words = _NO_CAMERA if is_cloud and options.max_edge is None else ""
    return _result(path, output, options, made, measured, depth=words)


def from_cloud(
    grid: RangeGrid,
    camera: CloudCamera,
    path: Path,
    output: Path,
    options: DepthOptions,
    maps: Maps,
    take: _Take = frame_alone,
) -> DepthFileResult:
    """Simplify an organised cloud as a depth image with the cloud's camera and colours.

    Colours in ``maps`` replace those of the cloud.
    """
    maps = maps if maps.color is not None else replace(maps, color=grid.color)
    if options.intrinsics:
        raise InputError(
            "intrinsics: can only be given with a depth image; a cloud's points tell its camera"
        )
    stored = np.where(grid.valid, camera.depth, 0.0).astype(np.float32)
    # The common guess is that of depth images, of another instrument.
    unit = "guess" if options.is_unit_guessed else options.unit
    reading = depth_reading(stored, unit, str(path))
    depth = masked_depth(reading.depth, mask_image(maps.mask, grid.valid.shape))
    words = (
        f"an organised cloud of a camera ({camera.intrinsics.fx:.1f} pixels), {reading.sentence}"
    )
    to_file = None
    if camera.rotation is not None:
        words += "; the mesh is in the cloud's own axes"
        metres = reading.depth / (1000.0 if reading.depth.dtype == np.uint16 else 1.0)
        scale = float(np.median(stored[metres > 0] / metres[metres > 0]))  # file units per metre
        to_file = functools.partial(camera.to_file, unit=scale)
    made = from_depth(
        depth, camera.intrinsics, path, output, options, maps, take, words, reading.unit, to_file
    )
    return replace(made, depth_found=DepthFound.of(reading, reading.doubt))


def expect_options_of_scan(options: DepthOptions) -> None:
    """Raise an InputError for options that a scan cannot obey."""
    given = {
        "by_distance": options.by_distance,
        "intrinsics": options.intrinsics != "",
        "unit": options.unit != "guess",
        "depth_step": options.depth_step != DEPTH_STEP,
    }
    for name, is_given in given.items():
        if is_given:
            raise InputError(f"{name}: can only be given with a depth image, got a scan")


def _result(
    path: Path,
    output: Path,
    options: DepthOptions,
    made: _Made,
    measured: Measured,
    **more: Any,
) -> DepthFileResult:
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
        faces_left=made.faces_left,
        left_area=made.left_area,
        dropped_pixels=getattr(found, "dropped_pixels", 0),
        filled_pixels=getattr(found, "filled_pixels", 0),
        **more,
    )


@checked
def colors_of_frames(
    frames: Sequence[str | os.PathLike[str]],
    colors: str | os.PathLike[str],
    *,
    name: str = "color",
) -> dict[str, str]:
    """Return the colour image of each depth image.

    If each depth image has a colour image of the same name (without suffix), they are matched by
    name, and other colour images are ignored. Names are also the same if they differ only in the
    words depth and color: ``1.depth.png``, ``1.color.png``; ``depth_1.png``, ``rgb_1.png``;
    ``1_depth.png``, ``1.jpg``. If less than half of the depth images have such a colour image, both
    are sorted by name (numbers in names by their value) and matched in order; if half or more have,
    but not all, it is an error, as the order would be shifted. Hidden files and files whose suffix
    is not that of an image are ignored.

    If ``colors`` also holds the depth images, these are left out, and only images with such a word
    in their names are matched in order. Masks and confidences then need their word in any case.

    Parameters
    ----------
    frames : sequence of path-like
    colors : path-like
        Folder of the colour images; or masks, or confidences.
    name : str
        What the images are, and the argument's name in errors: ``color`` (words in names: color,
        colour, rgb), ``mask`` (mask) or ``confidence`` (confidence, conf).

    Returns
    -------
    dict of str to str
        The colour image of each depth image.

    Raises
    ------
    InputError
        Half or more of the depth images have a colour image of their name and others have not; less
        than half have, and there are not as many colour images as depth images; or ``name`` is
        unknown.
    OSError
        The folder cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import simplify
    >>> Path("colors").mkdir()
    >>> Path("colors", "a.jpg").touch()
    >>> Path("colors", "b.jpg").touch()
    >>> simplify.colors_of_frames(["d1.png", "d2.png"], "colors")
    {'d1.png': 'colors/a.jpg', 'd2.png': 'colors/b.jpg'}
    """
    if name not in _KINDS:
        raise InputError(f"name: expected one of {', '.join(_KINDS)}, got {name!r}")
    found = [path for path in path_of(colors, name).iterdir() if _is_image(path)]
    found.sort(key=lambda path: by_number(path.name))
    own = {os.path.realpath(path_of(frame, "frames")) for frame in frames}
    images = [path for path in found if os.path.realpath(path) not in own]
    shares_folder = len(images) < len(found)
    named = [path for path in images if _without(path.stem, name) != _words(path.stem)]
    names = sorted((os.fspath(frame) for frame in frames), key=by_number)
    keys = [_without(Path(frame).stem, "depth") for frame in names]
    tries = [_by_key(keys, named, [_without(path.stem, name) for path in named])]
    if name == "color" or not shares_folder:
        # Beside the depth images, a file without the word for a mask would be a colour image.
        stems = [Path(frame).stem for frame in names]
        tries.append(_by_key(stems, images, [path.stem for path in images]))
        tries.append(_by_key(keys, images, [_words(path.stem) for path in images]))
    best = max(tries, key=lambda pairs: sum(image is not None for image in pairs))
    chosen = [image for image in best if image is not None]
    if 2 * len(chosen) < len(frames):
        chosen = []  # time stamps agree by chance
    if 0 < len(chosen) < len(frames):
        absent = [Path(names[i]).name for i, image in enumerate(best) if image is None]
        listed = ", ".join(absent[:5]) + (", ..." if len(absent) > 5 else "")
        raise InputError(
            f"{name}: expected an image in {os.fspath(colors)} by the name of each depth image, "
            f"found {len(chosen)} of {len(frames)}, none for {listed}"
        )
    if not chosen:
        chosen = named if shares_folder else images
    if len(chosen) != len(frames):
        raise InputError(
            f"{name}: expected {len(frames)} images in {os.fspath(colors)}, found {len(chosen)}"
            f"{' beside the depth images' if shares_folder else ''}, "
            "not one of each depth image's name"
        )
    return dict(zip(names, map(str, chosen), strict=True))


_WORDS = {
    "depth": {"depth"},
    "color": {"color", "colour", "rgb"},
    "mask": {"mask"},
    "confidence": {"confidence", "conf"},
}
"""Words by which names of files say what an image holds."""
_KINDS = ("color", "mask", "confidence")


def _words(stem: str) -> tuple[str, ...]:
    return tuple(re.findall(r"[^\W\d_]+|\d+", stem.lower()))


def _without(stem: str, kind: str) -> tuple[str, ...]:
    """Return the words of a name without the last one that says what kind the image is of."""
    words = _words(stem)
    places = [i for i, word in enumerate(words) if word in _WORDS[kind]]
    return words[: places[-1]] + words[places[-1] + 1 :] if places else words


def _by_key(
    wanted: Sequence[Hashable], images: Sequence[Path], keys: Sequence[Hashable]
) -> list[Path | None]:
    """Return the image of each key; None for a key that is wanted twice or has not one image."""
    image_of, times, uses = dict(zip(keys, images, strict=True)), Counter(keys), Counter(wanted)
    return [image_of[key] if times[key] == uses[key] == 1 else None for key in wanted]


def _is_image(path: Path) -> bool:
    return (
        path.suffix.lower() in _IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()
    )


@checked
def common_depth_unit(
    frames: Sequence[str | os.PathLike[str]], unit: str = "guess", intrinsics: str = ""
) -> str:
    """Return the unit that most depth images seem to have, to use for all of them.

    Parameters
    ----------
    frames : sequence of path-like or URL
        Depth images of one camera. Up to nine of them, evenly spaced, are read.
    unit : str
        Returned as it is unless it is ``"guess"``.
    intrinsics : str
        If this camera preset states a unit, ``"guess"`` is returned: each image is then read with
        the preset's unit.

    Returns
    -------
    str
        A unit as `manip3d.io.read_depth_guessing` takes it.

    Raises
    ------
    OSError
        A file cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import simplify
    >>> np.save("a.npy", np.full((48, 64), 2000, np.uint16))
    >>> simplify.common_depth_unit(["a.npy"])
    'mm'
    """
    if unit != "guess" or camera_depth_unit(intrinsics) != "guess":
        return unit
    guesses: Counter[str] = Counter()
    for number in np.linspace(0, len(frames) - 1, min(len(frames), _FRAMES_FOR_A_GUESS)):
        try:
            guesses[read_depth_guessing(frames[int(number)]).unit] += 1
        except (FormatError, OSError):  # reported when that frame is simplified
            continue
    return guesses.most_common(1)[0][0] if guesses else "guess"


def common_guess(
    frames: Sequence[str | os.PathLike[str]], unit: str = "guess", intrinsics: str = ""
) -> str:
    """Return `common_depth_unit`, marked as a guess (`COMMON_GUESS`) if it is one."""
    found = common_depth_unit(frames, unit, intrinsics)
    return f"{COMMON_GUESS}{found}" if unit == "guess" != found else found
