"""Simplify depth images and range scans in files to mesh files."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.camera import Intrinsics, checked_depth
from manip3d.errors import InputError
from manip3d.io import DEPTH_SUFFIXES, RangeGrid, read_range_grid
from manip3d.io._depth_units import depth_reading
from manip3d.simplify._depth import DenseImage, DepthSimplification, cs3, cs3_grid
from manip3d.simplify._depth_inputs import (
    MapFiles,
    Maps,
    centre_doubt,
    expect_camera,
    planar_depth,
    read_frame,
    registration_of,
    same_view_words,
)
from manip3d.simplify._depth_options import (
    DepthFileResult,
    DepthOptions,
    check_confidence,
    expect_options_of_scan,
)
from manip3d.simplify._depth_steps import cut_depth_steps
from manip3d.simplify._depth_words import NO_CAMERA, DepthFound
from manip3d.simplify._depth_writing import LastFile, Made, Measured, result_of, write_simplified
from manip3d.simplify._organised import (
    CloudCamera,
    camera_of_scan,
    far_origin,
    find_camera,
    is_cloud_file,
    rows_go_up,
)
from manip3d.simplify._parts import with_used_vertices
from manip3d.simplify._pixel_maps import mask_image, masked_depth
from manip3d.simplify._relief import relief, relief_grid
from manip3d.simplify._sampling import sample_depth, sample_depth_grid

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.camera import Registration
    from manip3d.mesh import Mesh

_YUP_SUFFIXES = (".glb", ".gltf")


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
        Depth along the optical axis, or with ``options.ray_depth`` distance along the line of
        sight. 0 and NaN mean no measurement.
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
    if options.ray_depth:
        image = planar_depth(image, intrinsics)
    image = masked_depth(image, mask_image(mask, image.shape))
    options = options.for_pixels(int(np.count_nonzero(image > 0)))
    if options.points is None:
        raise InputError("options.points: expected a number, as nothing is written here, got None")
    uncut = _uncut(image, intrinsics, options, options.points, color, registration, confidence)
    assert isinstance(uncut.surface, DenseImage)
    image = uncut.surface.depth  # without pieces that have no confidence
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
    check_confidence(options, confidence is not None)
    if options.method == "cs3":
        asked |= {"variant": options.variant, "distance_dependent": options.by_distance}
        return cs3(depth, intrinsics, points, **asked)
    if options.method == "relief":
        asked |= {"move_points": options.move_points, "depth_step": options.depth_step or None}
        asked |= {"confidence": confidence, "effort": options.effort}
        return relief(depth, intrinsics, points, **asked)
    asked |= {"method": options.method, "rng": options.seed}
    return sample_depth(depth, intrinsics, points, **asked)


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
        If the cloud was transformed to another frame, the mesh is in that frame. So is a range scan
        whose points are those of a camera's pixels; the rows of others go upwards, as Stanford's.
        The numbers of a depth image are depths along the optical axis, or distances along the lines
        of sight with ``options.ray_depth``.
    output : path-like
        A mesh file. The mesh of a depth image is in metres, with +y up in glTF and in the camera's
        axes in other formats. Scans without a camera keep their unit and axes.
    options : DepthOptions
        Method, target and limits.
    color : path-like, optional
        Colour image with the pixels of the depth image, or with more or fewer pixels of the same
        view, used as the texture.
    mask : path-like, optional
        An image of the same size, as `manip3d.io.read_pixel_map` reads it; of several arrays or
        channels, that named ``mask``. Pixels where it is 0, NaN or transparent count as not
        measured. A JPEG or lossy WebP counts as 0 where it is darker than half of its brightest
        pixel, unless parts of it are transparent.
    confidence : path-like, optional
        An image of the same size with the confidence of each pixel (``relief``): floats from 0 to
        1, or whole numbers of any type up to ``confidence_max``; of several arrays or channels,
        that named ``confidence`` or ``conf``.
    confidence_max : int, optional
        The level that stands for confidence 1; default: the maximum that a PGM states, else the
        largest number that the file's pixels can hold, if they are unsigned and have 1, 8 or 16
        bits.

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
    files = MapFiles.of(options, color, mask, confidence, confidence_max)
    if path.suffix.lower() in DEPTH_SUFFIXES and not is_cloud_file(path):
        return from_image(path, target, options, files)
    return _from_scan(path, target, options, files)


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
    path: Path, output: Path, options: DepthOptions, files: MapFiles, take: _Take = frame_alone
) -> DepthFileResult:
    expect_camera(options.intrinsics, path)
    reading, camera, words, doubt = read_frame(path, options)
    maps = files.read(reading.depth.shape)
    if off := centre_doubt(camera):
        words += f"; warning: {off}"
        doubt = f"{doubt}; {off}" if doubt else off
    depth = masked_depth(reading.depth, mask_image(maps.mask, reading.depth.shape))
    image = DepthInput(depth, camera, maps, path, reading.unit, words)
    made = from_depth(image, output, options, take)
    return replace(made, depth_found=DepthFound.of(reading, doubt, camera))


@dataclass(frozen=True, eq=False)
class DepthInput:
    """A depth image in memory that is to become a mesh file.

    Attributes
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
    camera : Intrinsics
    maps : Maps
    source : Path
        Name of the image in errors and in the result.
    unit : str
        Unit in which the image was stored.
    note : str
        Sentence for the result, see `DepthFileResult.depth`.
    to_file : callable or None
        Transforms vertices from the camera's frame to that of the file; None: they stay in the
        camera's axes, or get +y up where the format has that.
    """

    depth: NDArray[Any]
    camera: Intrinsics
    maps: Maps
    source: Path
    unit: str
    note: str = ""
    to_file: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None

    def in_file(self, mesh: Mesh, output: Path) -> Mesh:
        """Return a mesh of the camera's frame in the axes of its file."""
        if self.to_file is not None:
            return mesh.replace(vertices=self.to_file(mesh.vertices))
        return with_y_up(mesh, self.camera) if writes_y_up(output) else mesh


def from_depth(
    image: DepthInput, output: Path, options: DepthOptions, take: _Take = frame_alone
) -> DepthFileResult:
    """Simplify an image in memory and write the mesh."""
    camera, maps, note = image.camera, image.maps, image.note
    if registration := registration_of(maps.color, camera) if maps.registration is None else None:
        maps = replace(maps, registration=registration)
        note += f"; {same_view_words(registration)}"
    measured = Measured.of(image.depth > 0, is_masked=maps.mask is not None)
    options = options.for_pixels(measured.pixels)
    started = time.perf_counter()
    uncut_of, last = take(image.depth, camera, options, maps)
    preparation = time.perf_counter() - started

    def make(points: int) -> Made:
        started = time.perf_counter()
        uncut = uncut_of(points)
        seconds = time.perf_counter() - started
        found = uncut
        assert isinstance(uncut.surface, DenseImage)
        simplified = uncut.surface.depth  # the image, or its mean over time
        if options.depth_step:
            found = cut_depth_steps(uncut, simplified, step=options.depth_step)
        across, area = 0, 0.0
        if not options.depth_step and options.max_edge is None:
            across, area = _across_steps(uncut, simplified)
        mesh = image.in_file(with_used_vertices(found.mesh), output)
        cut = max(0, uncut.num_faces - found.num_faces)
        return Made(found, mesh, cut, seconds, faces_across=across, area_across=area)

    made = write_simplified(
        make, image.source, output, options, measured, has_steps=options.depth_step > 0, last=last
    )
    made = replace(made, seconds=made.seconds + preparation)
    return result_of(image.source, output, options, made, measured, depth=note, unit=image.unit)


def _across_steps(uncut: DepthSimplification, depth: NDArray[Any]) -> tuple[int, float]:
    """Return the number of faces across depth steps, and their share of the area."""
    without = cut_depth_steps(uncut, depth)
    across = uncut.num_faces - without.num_faces
    return across, 1.0 - _area(without) / (_area(uncut) or 1.0) if across else 0.0


def _area(found: DepthSimplification) -> float:
    p, q, r = (found.vertices[found.faces[:, i]].astype(np.float64) for i in range(3))
    return float(np.linalg.norm(np.cross(q - p, r - p), axis=1).sum()) / 2


def _from_scan(path: Path, output: Path, options: DepthOptions, files: MapFiles) -> DepthFileResult:
    """Simplify a range scan or an organised cloud, by its camera if its points show one.

    Without a camera the grid itself says which points are neighbours.
    """
    grid = read_range_grid(path)
    is_cloud = is_cloud_file(path)
    camera = find_camera(grid) if is_cloud else camera_of_scan(grid)
    if camera is not None:
        return from_cloud(grid, camera, path, output, options, files)
    expect_options_of_scan(options)
    maps = files.read(grid.valid.shape)
    maps = maps if maps.color is not None else replace(maps, color=grid.color)
    mask = mask_image(maps.mask, grid.valid.shape)
    valid = grid.valid if mask is None else grid.valid & mask
    measured = Measured.of(valid, is_masked=mask is not None)
    options = options.for_pixels(measured.pixels)
    asked: dict[str, Any] = {"max_edge": options.max_edge, "color": maps.color}
    origin = far_origin(grid)
    asked |= {"rows_up": rows_go_up(grid, origin) if is_cloud else True}  # as Stanford's do
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

    def make(points: int) -> Made:
        started = time.perf_counter()
        found = function(grid.points - origin, valid, points, **asked)
        seconds = time.perf_counter() - started
        mesh = with_used_vertices(found.mesh)
        return Made(found, mesh.replace(vertices=mesh.vertices + origin), 0, seconds)

    made = write_simplified(make, path, output, options, measured, has_steps=False)
    words = NO_CAMERA if is_cloud and options.max_edge is None else ""
    return result_of(path, output, options, made, measured, depth=words)


def from_cloud(
    grid: RangeGrid,
    camera: CloudCamera,
    path: Path,
    output: Path,
    options: DepthOptions,
    files: MapFiles,
    take: _Take = frame_alone,
) -> DepthFileResult:
    """Simplify an organised cloud as a depth image with the cloud's camera and colours.

    Colours in ``files`` replace those of the cloud.
    """
    if options.intrinsics:
        raise InputError(
            "intrinsics: can only be given with a depth image; a cloud's points give its camera"
        )
    if options.ray_depth:
        raise InputError("ray_depth: can only be given with a depth image, got a cloud")
    maps = files.read(grid.valid.shape)
    maps = maps if maps.color is not None else replace(maps, color=grid.color)
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
    image = DepthInput(depth, camera.intrinsics, maps, path, reading.unit, words, to_file)
    made = from_depth(image, output, options, take)
    return replace(made, depth_found=DepthFound.of(reading, reading.doubt))
