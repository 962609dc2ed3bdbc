"""One mesh file of several depth images or range scans with known camera poses."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.memory import available_bytes
from manip3d._util.options import reporting
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError
from manip3d.io import DEPTH_SUFFIXES, RangeGrid, read_range_grid, write_mesh
from manip3d.io._depth_units import depth_reading
from manip3d.io._images import read_color
from manip3d.simplify._camera_views import CameraView
from manip3d.simplify._cameras import (
    Join,
    JointSimplification,
    Report,
    cs3_joiner,
    relief_joiner,
    silent,
)
from manip3d.simplify._depth_files import writes_y_up, y_points_up
from manip3d.simplify._depth_inputs import (
    centre_doubt,
    expect_camera,
    read_frame,
    registration_of,
    same_view_words,
)
from manip3d.simplify._depth_options import (
    SPARSE_WORDS,
    DepthOptions,
    expect_options_of_scan,
    is_sparse,
)
from manip3d.simplify._depth_sets import common_guess
from manip3d.simplify._depth_words import (
    COMMON_GUESS,
    NO_CAMERA,
    DepthFound,
    sentence_of_images,
    size_warning,
)
from manip3d.simplify._depth_writing import Measured
from manip3d.simplify._organised import (
    CloudCamera,
    far_origin,
    find_camera,
    is_cloud_file,
    rows_go_up,
    scan_rows_go_up,
)
from manip3d.simplify._parts import with_used_vertices
from manip3d.simplify._poses import plain_name, tracked_files

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress

_MAX_TRIES = 4  # of `_filled`; each one joins all views anew
_READ, _PREPARED, _JOINED = 0.1, 0.5, 0.9  # shares of the work after three of its stages
_BYTES_PER_PIXEL = 130  # memory of a view for each measured pixel


@dataclass(frozen=True)
class JointFileResult:
    """Result of `simplify_camera_files`: one mesh of several depth images or scans.

    Attributes
    ----------
    sources : tuple of Path
        Files that were joined.
    output : Path
    options : DepthOptions
    points_before : int
        Number of measured points of all sources together.
    points, faces : int
        Number of vertices and faces of the mesh.
    seconds : float
        Time of the simplification without reading and writing. Where joining the views drops more
        than one per cent of the vertices, it is repeated with more points, up to three times; the
        time is that of all runs.
    coverage, bridges : float
        Same as for `JointSimplification`.
    lone_pixels : int
        Same as for `DepthFileResult`, summed over all sources.
    depth : str
        A sentence on the depth range of all images, or organised clouds of depth cameras, and on
        their unit, with doubts about it and about the camera; empty for scans.
    unit : str
        The unit that was used; empty for scans, and if the images state several.
    unit_guessed : bool
        Whether it was guessed from the numbers.
    without_ray : int
        Measured pixels without a line of sight, as for `JointSimplification`.
    """

    sources: tuple[Path, ...]
    output: Path
    options: DepthOptions
    points_before: int
    points: int
    faces: int
    seconds: float
    coverage: float
    bridges: float
    lone_pixels: int = 0
    depth: str = ""
    unit: str = ""
    unit_guessed: bool = False
    without_ray: int = 0

    __repr__ = short_repr

    @property
    def is_sparse(self) -> bool:
        """Whether the measured pixels are too sparse for a surface; as `DepthFileResult`."""
        return is_sparse(self.lone_pixels, self.points_before)

    @property
    def target_missed(self) -> bool:
        """Whether the mesh has fewer than 99 % of the wanted points.

        The wanted number is at most the number of measured points; a place that several views
        measured counts several times.
        """
        if self.options.points is None:
            return False
        return self.points < 0.99 * min(self.options.points, self.points_before)

    @property
    def coverage_missed(self) -> bool:
        """Whether less than ``options.min_coverage`` of the measured pixels is covered."""
        return not self.coverage >= self.options.min_coverage

    @property
    def bridges_missed(self) -> bool:
        """Whether more than ``options.max_bridges`` of the area is bridges."""
        return not self.bridges <= self.options.max_bridges


@checked
def simplify_camera_files(
    sources: Sequence[str | os.PathLike[str]],
    poses: str | os.PathLike[str],
    output: str | os.PathLike[str],
    options: DepthOptions,
    *,
    colors: Sequence[str | os.PathLike[str]] = (),
    num_frames: int | None = None,
    progress: Progress = None,
) -> JointFileResult:
    r"""Simplify several depth images, or several range scans, to one mesh and write it to a file.

    Parameters
    ----------
    sources : sequence of path-like
        Depth images or range scans, as for `simplify_depth_file`, but not both. Where several see
        the same surface, the earlier ones are preferred.
    poses : path-like
        File or folder with the pose of each source, as for `poses_of_files`, in metres for depth
        images and in their own unit for scans and clouds. Sources whose matrix
        in a folder is not finite, as ScanNet has it for lost frames, are left out with a warning.
    output : path-like
        Mesh file to write. Its vertices are in the coordinate frame of the poses, except that a
        glTF file of depth images, or of organised clouds of depth cameras, has +y up: the axis of
        the poses nearest to the mean direction that is up in the images becomes y. If that is y,
        nothing is rotated; -y (as where the first camera is the frame of the poses) by half a turn
        about x, z by a quarter turn about x. If cameras look down by more than 45 degrees on
        average, this may be the wrong axis.
    options : DepthOptions
        ``points`` is needed, and the method is ``relief`` or ``cs3``. If the unit is to be
        guessed, one unit is guessed for all sources (`common_depth_unit`).
    colors : sequence of path-like
        One colour image for each source; empty: no texture.
    num_frames : int, optional
        Only this many sources, the first ones, are joined.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``.

    Returns
    -------
    JointFileResult

    Raises
    ------
    InputError
        As `poses_of_files`, `relief_cameras` and `simplify_depth_file`; or an option cannot be used
        with several sources. Or there are more views than fit into the memory that is available,
        at about 40 MB for 640 x 480 measured pixels; the error says how many do.
    FormatError, OSError
        As `simplify_depth_file`. If the mesh has no face, nothing is written.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from manip3d import simplify
    >>> for name in ("1.00.npy", "1.05.npy"):
    ...     np.save(name, np.full((240, 320), 2.0, np.float32))
    >>> _ = Path("truth.txt").write_text("1.00 0 0 0 0 0 0 1\n1.05 0.5 0 0 0 0 0 1")
    >>> options = simplify.DepthOptions(100, intrinsics="tum")
    >>> found = simplify.simplify_camera_files(
    ...     ["1.00.npy", "1.05.npy"], "truth.txt", "wall.ply", options
    ... )
    >>> found.points <= 100, found.coverage > 0.99, found.bridges
    (True, True, 0.0)
    """
    files = tuple(path_of(source, "sources") for source in sources)
    target, place = path_of(output, "output"), path_of(poses, "poses")
    _expect_options_of_views(options)
    if colors and len(colors) != len(files):
        raise InputError(f"colors: expected {len(files)} or none, got {len(colors)}")
    if num_frames is not None and num_frames < 1:
        raise InputError(f"num_frames: expected at least 1, got {num_frames}")
    pictures: list[Path | None] = [None] * len(files)
    if colors:
        pictures = [path_of(color, "colors") for color in colors]
    known, placed = tracked_files(files, place)
    known, placed = known[:num_frames], placed[:num_frames]
    files, pictures = tuple(files[i] for i in known), [pictures[i] for i in known]
    are_images = _are_images(files)
    if are_images:  # one unit for all, because guesses for single images could differ
        unit = common_guess(files, options.unit, options.intrinsics)
        options = replace(options, unit=unit)
    with reporting(progress, "join views") as report:
        report = report or silent
        read = _read_views(files, placed, pictures, options, are_images, _part(report, 0.0, _READ))
        views, depths, per_metre = read.views, read.depths, read.per_metre
        depth_step = options.depth_step if options.depth_step and depths else None
        options = options.for_pixels(read.measured)
        started = time.perf_counter()
        assert options.points is not None
        in_metres = options
        if options.max_edge is not None:
            in_metres = replace(options, max_edge=options.max_edge / per_metre)
        prepared = _joiner(views, in_metres, depth_step, _part(report, _READ, _PREPARED))
        joint = _filled(prepared, options.points, _part(report, _PREPARED, _JOINED))
        seconds = time.perf_counter() - started
        joint.coverage, joint.bridges  # noqa: B018 - computed on the first access
        report(1.0)
    if not joint.num_faces:
        note = f"; {SPARSE_WORDS}" if is_sparse(read.lone, joint.num_measured) else ""
        raise FormatError(
            f"expected a surface in {len(files)} views, found none{note}", file=str(place)
        )
    mesh = with_used_vertices(joint.mesh)
    if writes_y_up(target) and depths:
        mesh = mesh.replace(vertices=mesh.vertices @ _turn_to_y_up(views).T)
    if per_metre != 1.0:
        mesh = mesh.replace(vertices=mesh.vertices * per_metre)
    write_mesh(mesh, target)
    units = {found.unit for found in depths}
    return JointFileResult(
        sources=files,
        output=target,
        options=replace(options, unit=options.unit.removeprefix(COMMON_GUESS)),
        points_before=joint.num_measured,
        points=_num_used(joint),
        faces=joint.num_faces,
        seconds=seconds,
        coverage=joint.coverage,
        bridges=joint.bridges,
        lone_pixels=read.lone,
        depth=_words(depths, views, are_images, read.no_camera if options.max_edge is None else 0),
        unit=units.pop() if len(units) == 1 else "",
        unit_guessed=any(found.is_guess for found in depths),
        without_ray=joint.without_ray,
    )


@dataclass
class _Views:
    """Views in metres, and what was found in them when they were read."""

    views: list[CameraView] = field(default_factory=list)
    depths: list[DepthFound] = field(default_factory=list)
    """The depth of images and of clouds that show a camera."""
    per_metre: float = 1.0
    """Units of the clouds per metre."""
    measured: int = 0
    """Number of measured pixels."""
    lone: int = 0
    """Number of those without a measured neighbour."""
    no_camera: int = 0
    """Number of clouds that show no camera."""


def _read_views(
    files: Sequence[Path],
    poses: Sequence[NDArray[np.float64]],
    pictures: Sequence[Path | None],
    options: DepthOptions,
    are_images: bool,
    report: Report,
) -> _Views:
    """Read the views, as long as they fit into the memory that is available."""
    read, memory = _Views(), available_bytes()
    for file, pose, picture in zip(files, poses, pictures, strict=True):
        if are_images:
            view, depth = _image_view(file, options, pose, picture)
            read.depths.append(depth)
        else:
            view = _read_grid_view(file, options, pose, picture, read)
        read.views.append(view)
        found = Measured.of(_valid_pixels(view))
        read.measured, read.lone = read.measured + found.pixels, read.lone + found.lone
        _expect_memory(read.measured, len(read.views), len(files), memory)
        report(len(read.views) / len(files))
    read.views = [_in_metres(view, read.per_metre) for view in read.views]
    return read


def _read_grid_view(
    file: Path,
    options: DepthOptions,
    pose: NDArray[np.float64],
    picture: Path | None,
    read: _Views,
) -> CameraView:
    """Read a range scan or a cloud, and add to ``read`` whether it shows a camera."""
    grid, is_cloud = read_range_grid(file), is_cloud_file(file)
    camera = find_camera(grid) if is_cloud else None
    if camera is None:
        read.no_camera += is_cloud
        return _scan_view(grid, options, pose, picture, is_cloud)
    unit = read.depths[0].unit if read.depths else ""  # clouds of one instrument have one unit
    view, depth, read.per_metre = _cloud_view(file, grid, camera, options, pose, picture, unit)
    read.depths.append(depth)
    return view


_TO_Y_UP = (
    ([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], np.eye(3)),
    ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
)
"""Rotations that let an axis point along y: of x, y and z, first of their negative directions."""


def _turn_to_y_up(views: Sequence[CameraView]) -> NDArray[np.float64]:
    """Return the rotation of the poses' frame by which its axis that is up in the images is y."""
    up = np.zeros(3)
    for view in views:
        if view.intrinsics is None:
            continue
        up += np.asarray(view.pose)[:3, 1] * (1.0 if y_points_up(view.intrinsics) else -1.0)
    axis = int(np.argmax(np.abs(up)))
    return np.array(_TO_Y_UP[axis][int(up[axis] > 0)], np.float64)


def _part(report: Report, begin: float, end: float) -> Report:
    """Return a report of a stage, whose share of the work is between ``begin`` and ``end``."""
    return lambda fraction: report(begin + (end - begin) * fraction)


def _expect_memory(measured: int, taken: int, total: int, memory: int | None) -> None:
    """Refuse more views than fit into the memory, as far as the views that were read show it."""
    if memory is None or measured * _BYTES_PER_PIXEL <= memory:
        return
    fitting = max(1, taken - 1)
    raise InputError(
        f"sources: expected at most {fitting} views for the {memory / 1e9:.1f} GB of memory that "
        f"are available, got {total}: give every {-(-total // fitting)}th of them"
    )


def _expect_options_of_views(options: DepthOptions) -> None:
    """Refuse options that cannot be used with several views."""
    if options.method not in ("relief", "cs3"):
        raise InputError(f"method: expected relief or cs3 with poses, got {options.method}")
    if options.bandwidth is not None or options.by_distance or options.move_points:
        raise InputError(
            "points: needed with poses, without bandwidth, by_distance and move_points"
        )


def _are_images(files: Sequence[Path]) -> bool:
    """Return whether files are depth images (True) or range scans (False); refuse a mixture."""
    are_images = {
        plain_name(file).lower().endswith(DEPTH_SUFFIXES) and not is_cloud_file(file)
        for file in files
    }
    if len(are_images) > 1:
        raise InputError("sources: expected depth images or scans with poses, got both")
    return are_images != {False}


def _valid_pixels(view: CameraView) -> NDArray[np.bool_]:
    """Return the measured pixels of a view made by `_image_view` or `_scan_view`."""
    return np.asarray(view.valid if view.depth is None else np.asarray(view.depth) > 0, bool)


def _filled(join: Join, points: int, report: Report) -> JointSimplification:
    """Join views to at most ``points`` vertices and, if possible, only a few less.

    Joining drops points of surfaces that several views share. Each further try, up to `_MAX_TRIES`
    in all, asks for as many additional points as were dropped.
    """
    best = join(points, report=_part(report, 0.0, 1 / _MAX_TRIES))
    asked = points + (missing := points - _num_used(best))
    for number in range(1, _MAX_TRIES):
        if not 0.01 * points < missing or asked > best.num_measured:
            break
        part = _part(report, number / _MAX_TRIES, (number + 1) / _MAX_TRIES)
        found = join(asked, report=part)
        if _num_used(best) < _num_used(found) <= points:
            best, missing = found, points - _num_used(found)
        asked += points - _num_used(found)
    return best


def _num_used(joint: JointSimplification) -> int:
    return len(np.unique(joint.faces))


def _joiner(
    views: Sequence[CameraView], options: DepthOptions, depth_step: float | None, report: Report
) -> Join:
    given: dict[str, Any] = {
        "max_edge": options.max_edge,
        "depth_step": depth_step,
        "threads": options.threads,
        "report": report,
    }
    if options.method == "relief":
        return relief_joiner(views, effort=options.effort, **given)
    return cs3_joiner(views, variant=options.variant, **given)


def _image_view(
    file: Path, options: DepthOptions, pose: NDArray[np.float64], picture: Path | None
) -> tuple[CameraView, DepthFound]:
    expect_camera(options.intrinsics, file)
    reading, camera, _, doubt = read_frame(file, options)
    color = None if picture is None else read_color(picture, reading.depth.shape)
    registration = registration_of(color, camera)
    view = CameraView(reading.depth, camera, pose=pose, color=color, registration=registration)
    doubts = [each for each in (doubt, centre_doubt(camera)) if each]
    return view, DepthFound.of(reading, "; ".join(doubts), camera)


def _cloud_view(
    file: Path,
    grid: RangeGrid,
    camera: CloudCamera,
    options: DepthOptions,
    pose: NDArray[np.float64],
    picture: Path | None,
    unit: str,
) -> tuple[CameraView, DepthFound, float]:
    """Return a cloud as a depth image in metres, and the cloud's units per metre.

    ``pose`` is in the cloud's unit, ``unit`` that of the clouds before; empty: this is the first.
    """
    if options.intrinsics:
        raise InputError(
            "intrinsics: can only be given with a depth image; a cloud's points give its camera"
        )
    if options.ray_depth:
        raise InputError("ray_depth: can only be given with a depth image, got a cloud")
    stored = np.where(grid.valid, camera.depth, 0.0).astype(np.float32)
    asked = "guess" if options.is_unit_guessed else options.unit
    reading = depth_reading(stored, unit or asked, str(file))
    found = DepthFound.of(reading, reading.doubt)
    metres = reading.depth / (1000.0 if reading.depth.dtype == np.uint16 else 1.0)
    known = metres > 0
    per_metre = float(np.median(stored[known] / metres[known])) if known.any() else 1.0
    placed = pose.copy()
    placed[:3, 3] = (pose[:3, 3] + product(pose[:3, :3], camera.centre)) / per_metre
    if camera.rotation is not None:
        placed[:3, :3] = product(pose[:3, :3], camera.rotation.T)
    color = grid.color if picture is None else read_color(picture, grid.valid.shape)
    return CameraView(reading.depth, camera.intrinsics, pose=placed, color=color), found, per_metre


def _scan_view(
    grid: RangeGrid,
    options: DepthOptions,
    pose: NDArray[np.float64],
    picture: Path | None,
    is_cloud: bool,
) -> CameraView:
    expect_options_of_scan(options)
    color = grid.color if picture is None else read_color(picture, grid.valid.shape)
    origin = far_origin(grid)
    rows_up = rows_go_up(grid, origin) if is_cloud else scan_rows_go_up(grid)
    placed = pose.copy()
    placed[:3, 3] += product(pose[:3, :3], origin)
    return CameraView(
        points=grid.points - origin, valid=grid.valid, pose=placed, color=color, rows_up=rows_up
    )


def _in_metres(view: CameraView, per_metre: float) -> CameraView:
    """Return a view of points, which are in the file's unit, in metres, and others as they are."""
    if view.points is None or per_metre == 1.0:
        return view
    placed = np.array(view.pose, np.float64)
    placed[:3, 3] /= per_metre
    return replace(view, points=np.asarray(view.points) / per_metre, pose=placed)


def _words(
    depths: Sequence[DepthFound], views: Sequence[CameraView], are_images: bool, no_camera: int
) -> str:
    """Return a sentence on the depth of all views; ``no_camera``: clouds that show no camera."""
    words = sentence_of_images(depths) if depths else ""
    if depths and not are_images:
        words = f"organised clouds of cameras, as {words}"
    words += size_warning(depths)
    if of_one_view := [view.registration for view in views if view.registration is not None]:
        words += f"; {same_view_words(of_one_view[0])}"
    if no_camera:
        of_some = f"; {no_camera} of {len(views)} views: " if depths else ""
        words += f"{of_some}{NO_CAMERA}"
    return words
