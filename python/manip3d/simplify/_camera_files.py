"""One mesh file of several depth images or range scans with known camera poses."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.text_files import text_of
from manip3d.camera import read_intrinsics
from manip3d.errors import FormatError, InputError
from manip3d.io import DEPTH_SUFFIXES, read_range_grid, write_mesh
from manip3d.io._images import read_color
from manip3d.io._poses import poses_by_file, rigid
from manip3d.simplify._cameras import CameraView, JointSimplification, cs3_cameras, relief_cameras
from manip3d.simplify._depth_files import (
    SPARSE_WORDS,
    DepthOptions,
    Measured,
    common_depth_unit,
    expect_camera,
    expect_options_of_scan,
    is_sparse,
    read_frame,
    writes_y_up,
)
from manip3d.simplify._parts import with_used_vertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["JointFileResult", "poses_of_files", "simplify_camera_files"]

_MOST_SECONDS_APART = 0.02  # as TUM's own tool associates depth images and poses
_MOST_TRIES = 4
_UNIT_TOLERANCE = 1e-3  # how far a quaternion's length may be from 1


@dataclass(frozen=True)
class JointFileResult:
    """Result of `simplify_camera_files`: one mesh of several depth images or scans.

    Attributes
    ----------
    sources : tuple of Path
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
        As for `JointSimplification`.
    lone_pixels : int
        As for `DepthFileResult`, summed over all sources.
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

    @property
    def is_sparse(self) -> bool:
        """Whether the measured pixels are too sparse for a surface; as `DepthFileResult`."""
        return is_sparse(self.lone_pixels, self.points_before)

    @property
    def target_missed(self) -> bool:
        """Whether the mesh has fewer than 99 % of the wanted points.

        No more are wanted than were measured; a place that several views see counts several times.
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
def poses_of_files(
    sources: Sequence[str | os.PathLike[str]], poses: str | os.PathLike[str]
) -> list[NDArray[np.float64]]:
    r"""Return the pose of the camera or scanner of each file, from a file of poses.

    Parameters
    ----------
    sources : sequence of path-like
        Depth images or range scans. Only their names are used.
    poses : path-like
        Either a Stanford ``.conf`` file, which names each source (`manip3d.datasets.read_poses`),
        or a trajectory: lines ``time tx ty tz qx qy qz qw`` (camera to world) as in TUM's
        ``groundtruth.txt``, where lines that begin with ``#`` are comments.

    Returns
    -------
    list of (4, 4) float64
        For each source, in their order, the rigid transform from its camera's frame to the common
        frame, in the unit of ``poses``.

    Raises
    ------
    InputError
        A file has no pose.
    FormatError, OSError
        ``poses`` cannot be read.

    Notes
    -----
    In a trajectory, a file's name is a time in seconds (``1305031102.160407.png``), and its pose is
    the one with the nearest time, at most 0.02 s away (the tolerance of TUM's own tool). If the
    names are not times, the lines are taken in order, one for each file. Names are not times if
    none is a number, or if names and times ascend and most names, such as ``000001.png``, are not
    near any time.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import simplify
    >>> _ = Path("truth.txt").write_text("# time x y z q\n1.00 1 2 3 0 0 0 1\n1.05 4 5 6 0 0 0 1")
    >>> (pose,) = simplify.poses_of_files(["depth/1.04.png"], "truth.txt")
    >>> pose[:3, 3].tolist()
    [4.0, 5.0, 6.0]
    """
    files = [path_of(source, "sources") for source in sources]
    place = path_of(poses, "poses")
    if place.suffix.lower() == ".conf":
        named = poses_by_file(place)
        for file in files:
            if _plain(file) not in named:
                raise InputError(f"poses: expected one of {_plain(file)} in {place}, found none")
        return [named[_plain(file)] for file in files]
    times, found = _trajectory(place)
    asked = np.array([_number_in(file) for file in files])
    if np.isnan(asked).all():
        return _in_order(files, found, place)
    if not len(times):
        raise FormatError("expected lines 'time tx ty tz qx qy qz qw', found none", file=str(place))
    return _by_time(files, asked, times, found)


def _by_time(
    files: Sequence[Path],
    asked: NDArray[np.float64],
    times: NDArray[np.float64],
    found: list[NDArray[np.float64]],
) -> list[NDArray[np.float64]]:
    """Return the pose nearest in time to each file; in order where the names are only numbers."""
    off = np.nan_to_num(np.abs(asked[:, None] - times), nan=np.inf)
    nearest, apart = off.argmin(axis=1), off.min(axis=1)
    is_near = apart <= _MOST_SECONDS_APART
    if is_near.all():
        return [found[i] for i in nearest]
    are_numbered = 2 * np.count_nonzero(is_near) < len(files)
    if are_numbered and len(found) == len(files) and _ascend(asked) and _ascend(times):
        return found
    worst = int(apart.argmax())
    asks = f"poses: expected a pose within {_MOST_SECONDS_APART} s of {files[worst]}"
    if np.isinf(apart[worst]):
        raise InputError(f"{asks}, whose name is not a time")
    raise InputError(f"{asks}, the nearest is {apart[worst]:.3f} s away")


def _number_in(file: Path) -> float:
    """The number that is a file's name; NaN where the name is not a number."""
    stem = Path(_plain(file)).stem
    return float(stem) if re.fullmatch(r"-?[0-9]+(\.[0-9]*)?", stem) else math.nan


def _ascend(values: NDArray[np.float64]) -> bool:
    return bool((np.diff(values) > 0).all())


def _plain(file: Path) -> str:
    """Return a file's name without the suffix of a compression."""
    return file.name.removesuffix(".xz").removesuffix(".gz")


def _in_order(
    files: Sequence[Path], found: list[NDArray[np.float64]], place: Path
) -> list[NDArray[np.float64]]:
    if len(found) != len(files):
        raise InputError(
            f"poses: expected file names that are times, or {len(files)} poses in {place}, found "
            f"{len(found)}"
        )
    return found


def _trajectory(place: Path) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
    """Read times and poses (camera to world) from a trajectory as TUM writes it."""
    times, poses = [], []
    for number, line in enumerate(text_of(place).splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = np.array(words, dtype=np.float64)
        except ValueError:
            values = np.empty(0)
        is_pose = values.shape == (8,) and np.isfinite(values).all()
        if not is_pose or not abs(np.linalg.norm(values[4:]) - 1) <= _UNIT_TOLERANCE:
            text = "expected eight numbers: time tx ty tz qx qy qz qw, a quaternion of length 1"
            raise FormatError(text, file=str(place), line=number)
        times.append(values[0])
        pose = rigid(values[1:])
        pose[:3, :3] = pose[:3, :3].T  # here the quaternion is that of the rotation itself
        poses.append(pose)
    return np.array(times), poses


@checked
def simplify_camera_files(
    sources: Sequence[str | os.PathLike[str]],
    poses: str | os.PathLike[str],
    output: str | os.PathLike[str],
    options: DepthOptions,
    *,
    colors: Sequence[str | os.PathLike[str]] = (),
) -> JointFileResult:
    r"""Simplify several depth images, or several range scans, to one mesh and write it to a file.

    Parameters
    ----------
    sources : sequence of path-like
        Depth images or range scans, as for `simplify_depth_file`, but not both. Where several see
        the same surface, the earlier ones are preferred.
    poses : path-like
        File with the pose of each source, as for `poses_of_files`.
    output : path-like
        Mesh file to write. Its vertices are in the coordinate frame of the poses, except that a
        glTF file of depth images is rotated by half a turn about x, because y points up there.
    options : DepthOptions
        ``points`` is needed, and the method is ``relief`` or ``cs3``. If the unit is to be
        guessed, one unit is guessed for all sources (`common_depth_unit`).
    colors : sequence of path-like
        One colour image for each source; empty: no texture.

    Returns
    -------
    JointFileResult

    Raises
    ------
    InputError
        As `poses_of_files`, `relief_cameras` and `simplify_depth_file`; or an option cannot be used
        with several sources.
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
    pictures = [path_of(color, "colors") for color in colors] if colors else [None] * len(files)
    placed = poses_of_files(files, place)
    are_images = _are_images(files)
    if are_images:  # guessed for each alone, units could differ
        options = replace(options, unit=common_depth_unit(files, options.unit, options.intrinsics))
    view_of = _image_view if are_images else _scan_view
    views = [
        view_of(file, options, pose, picture)
        for file, pose, picture in zip(files, placed, pictures, strict=True)
    ]
    options = options.for_pixels(sum(int(np.count_nonzero(_valid_pixels(view))) for view in views))
    depth_step = options.depth_step if options.depth_step and are_images else None
    started = time.perf_counter()
    joint = _filled(views, options, depth_step)
    seconds = time.perf_counter() - started
    lone = sum(Measured.of(_valid_pixels(view)).lone for view in views)
    if not joint.num_faces:
        note = f"; {SPARSE_WORDS}" if is_sparse(lone, joint.num_measured) else ""
        raise FormatError(
            f"expected a surface in {len(files)} views, found none{note}", file=str(place)
        )
    _write(joint, target, turned=are_images and writes_y_up(target))
    return JointFileResult(
        files,
        target,
        options,
        joint.num_measured,
        _num_used(joint),
        joint.num_faces,
        seconds,
        joint.coverage,
        joint.bridges,
        lone,
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
    """Whether files are depth images (True) or range scans (False); both together are refused."""
    are_images = {_plain(file).lower().endswith(DEPTH_SUFFIXES) for file in files}
    if len(are_images) > 1:
        raise InputError("sources: expected depth images or scans with poses, got both")
    return are_images != {False}


def _valid_pixels(view: CameraView) -> NDArray[np.bool_]:
    """Measured pixels of a view as `_image_view` and `_scan_view` make it."""
    return np.asarray(view.valid if view.depth is None else np.asarray(view.depth) > 0, bool)


def _filled(
    views: Sequence[CameraView], options: DepthOptions, depth_step: float | None
) -> JointSimplification:
    """Simplify views to at most ``options.points`` vertices and, if possible, to not many fewer.

    Points that several views have in common are dropped where the views are joined. As many as were
    dropped are asked for in addition, up to `_MOST_TRIES` times.
    """
    assert options.points is not None
    points = options.points
    best = _joined(views, options, points, depth_step)
    asked = points + (missing := points - _num_used(best))
    for _ in range(_MOST_TRIES - 1):
        if not 0.01 * points < missing or asked > best.num_measured:
            break
        found = _joined(views, options, asked, depth_step)
        if _num_used(best) < _num_used(found) <= points:
            best, missing = found, points - _num_used(found)
        asked += points - _num_used(found)
    return best


def _num_used(joint: JointSimplification) -> int:
    return len(np.unique(joint.faces))


def _joined(
    views: Sequence[CameraView], options: DepthOptions, points: int, depth_step: float | None
) -> JointSimplification:
    edge, threads = options.max_edge, options.threads
    if options.method == "relief":
        return relief_cameras(
            views,
            points,
            effort=options.effort,
            max_edge=edge,
            depth_step=depth_step,
            threads=threads,
        )
    return cs3_cameras(
        views,
        points,
        variant=options.variant,
        max_edge=edge,
        depth_step=depth_step,
        threads=threads,
    )


def _image_view(
    file: Path, options: DepthOptions, pose: NDArray[np.float64], picture: Path | None
) -> CameraView:
    expect_camera(options.intrinsics, file)
    reading, _ = read_frame(file, options)
    height, width = reading.depth.shape
    return CameraView(
        reading.depth,
        read_intrinsics(options.intrinsics, width=width, height=height),
        pose=pose,
        color=None if picture is None else read_color(picture),
    )


def _scan_view(
    file: Path, options: DepthOptions, pose: NDArray[np.float64], picture: Path | None
) -> CameraView:
    expect_options_of_scan(options)
    grid = read_range_grid(file)
    color = None if picture is None else read_color(picture)
    return CameraView(points=grid.points, valid=grid.valid, pose=pose, color=color)


def _write(joint: JointSimplification, target: Path, *, turned: bool) -> None:
    mesh = with_used_vertices(joint.mesh)
    if turned:  # cameras look along +z, y down; glTF has +y up
        mesh = mesh.replace(vertices=mesh.vertices * np.array([1.0, -1.0, -1.0]))
    write_mesh(mesh, target)
