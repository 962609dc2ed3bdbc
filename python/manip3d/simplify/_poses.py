"""Poses of cameras and scanners, as trajectories and data sets store them."""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Hashable, Sequence
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.paths import by_number, path_of
from manip3d.errors import InputError
from manip3d.io import DEPTH_SUFFIXES
from manip3d.io._poses import (
    LostPoseError,
    matrix_pose,
    poses_by_file,
    poses_of_log,
    poses_of_transforms,
    trajectory,
)
from manip3d.simplify._depth_sets import keys_of_name
from manip3d.simplify._time_stamps import MAX_SECONDS_APART, is_since_1970, seconds

if TYPE_CHECKING:
    from numpy.typing import NDArray


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
        One of five formats. (1) A trajectory file with lines ``time tx ty tz qx qy qz qw`` (camera
        to world) as in TUM's ``groundtruth.txt``, with the same lines without the time, or with the
        numbers of a 3x4 or 4x4 matrix, row by row (KITTI, Replica). If its first line or a comment
        before the numbers names the columns, they may be in any order and others may be among them
        (EuRoC's ``data.csv``, Stray Scanner's ``odometry.csv``). (2) A folder with a 4x4 matrix
        for each source: ``NAME.pose.txt`` (7-Scenes) for ``NAME.depth.png``, or ``NAME.txt``
        (ScanNet) for ``NAME.png``. (3) A ``.log`` of Redwood and Open3D: three whole numbers, of
        which the first is the frame's number, and a 4x4 matrix. (4) A Stanford ``.conf`` file,
        which names each source (`manip3d.datasets.read_poses`). (5) A ``transforms.json`` of
        nerfstudio, instant-ngp or Record3D, whose cameras have the axes of OpenGL. In texts, lines
        that begin with ``#`` are comments.

    Returns
    -------
    list of (4, 4) float64
        For each source, in their order, the rigid transform from its camera's frame to the common
        frame, in the unit of ``poses``.

    Raises
    ------
    InputError
        A file has no pose, or several frames of a ``transforms.json`` have its name.
    FormatError, OSError
        ``poses`` cannot be read, or a matrix is not finite (`simplify_camera_files` leaves out
        such files).

    Notes
    -----
    In a trajectory with times, a file's name is a time in seconds (``1305031102.160407.png``), and
    its pose is the one with the nearest time, at most 0.02 s away (the tolerance of TUM's own
    tool). Names and times that are so large that they count milliseconds or less since 1970 are
    converted. If the names are not times, the lines are assigned in order, one to each file. Names
    are not times if none is a number; if all are whole numbers below 1e9, such as ``000001.png``,
    and the times have fractions; or if names and times ascend and most names are not near any time.
    Lines without times are also assigned in order. Where columns are named, but none is a time or a
    frame, the first one is the time, unless it is a part of the pose. A file is refused if comments
    name different orders of its columns. Poses of EuRoC's and TUM-VI's ground truth are those of
    the IMU, of which a warning tells: multiply each from the right by ``T_BS`` of
    ``cam0/sensor.yaml`` to get those of the camera. In a ``.log`` a file's name is the number of
    its frame; if a name is not a number, the matrices are assigned in order. In a
    ``transforms.json`` the frame of a file is that whose ``depth_file_path``, or else
    ``file_path``, has the file's name, apart from the suffix. If no frame has the name of any file,
    the names may differ in the words depth and color (``depth_1.png``, ``rgb_1.png``), or else in
    all but their numbers, which are compared by value. If no numbers agree, the frames are assigned
    in the order of their paths. ``applied_scale`` is undone, so that poses are in the unit of
    depths.

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
    if place.is_dir():
        return [_matrix_of(file, place) for file in files]
    if place.suffix.lower() == ".conf":
        named = poses_by_file(place)
        names = [plain_name(file) for file in files]
        for name in names:
            if name not in named:
                raise InputError(f"poses: expected one of {name} in {place}, found none")
        return [named[name] for name in names]
    asked = np.array([_number_in(file) for file in files])
    if place.suffix.lower() == ".log":
        numbered = poses_of_log(place)
        if np.isnan(asked).any():
            return _in_order(files, list(numbered.values()), place)
        for number in asked:
            if number not in numbered:
                raise InputError(
                    f"poses: expected one of frame {number:.15g} in {place}, found none"
                )
        return [numbered[int(number)] for number in asked]
    if place.suffix.lower() == ".json":
        return _of_transforms(files, place)
    times, found = trajectory(place)
    if times is None or np.isnan(asked).all():
        return _in_order(files, found, place)
    if _are_frames(files, asked) and (times % 1.0 != 0.0).any():
        if len(found) != len(files) or not _ascend(asked):
            raise InputError(
                f"poses: names without a fraction, such as {files[0].name}, are numbers of frames, "
                f"as the times in {place} have fractions: expected {len(files)} ascending numbers "
                f"and as many poses, found {len(found)}"
            )
        return found
    return _by_time(files, _in_seconds(asked), _in_seconds(times), found)


def tracked_files(
    files: Sequence[Path], place: Path
) -> tuple[list[int], list[NDArray[np.float64]]]:
    """Return the indices of the files whose pose is known, and their poses.

    In a folder of matrices, ScanNet has infinite numbers for frames whose camera was lost. These
    are left out with a warning. For errors and other formats see `poses_of_files`.
    """
    if not place.is_dir():
        return list(range(len(files))), poses_of_files(files, place)
    found: dict[int, NDArray[np.float64]] = {}
    lost: list[LostPoseError] = []
    for i, file in enumerate(files):
        try:
            found[i] = _matrix_of(file, place)
        except LostPoseError as error:
            lost.append(error)
    if lost and not found:
        raise lost[0]
    if lost:
        warnings.warn(
            f"poses: left out {len(lost)} of {len(files)} views, whose matrix is not finite, as "
            f"that of a lost camera: {lost[0].file}{', ...' if len(lost) > 1 else ''}",
            stacklevel=caller_level(),
        )
    return list(found), list(found.values())


def _matrix_of(file: Path, folder: Path) -> NDArray[np.float64]:
    """Read the matrix of a depth image from the image's own pose file."""
    stem = Path(plain_name(file)).stem
    frame = stem.removesuffix(".depth")
    for name in (f"{frame}.pose.txt", f"{frame}.txt", f"{stem}.txt"):
        path = folder / name
        if path.is_file():
            return matrix_pose(path)
    raise InputError(f"poses: expected {frame}.pose.txt or {frame}.txt in {folder}, found neither")


def _of_transforms(files: Sequence[Path], place: Path) -> list[NDArray[np.float64]]:
    """Return the pose of the frame of each file's name; in order if no frame has such a name."""
    paths, poses = poses_of_transforms(place)
    asked = [_frame_name(plain_name(file)) for file in files]
    # Paths may have the separators of Windows, and no suffix, as in NeRF's synthetic scenes.
    found = _frames_by_name(asked, [_frame_name(PureWindowsPath(path).name) for path in paths])
    if not any(found):
        if all(paths):
            key = by_number(paths)
            order = sorted(range(len(paths)), key=lambda i: key(paths[i]))
            poses = [poses[i] for i in order]
        return _in_order(files, poses, place, words="names of frames")
    _expect_one_frame_each(files, asked, found, place)
    return [poses[i] for (i,) in found]


def _expect_one_frame_each(
    files: Sequence[Path], asked: Sequence[str], found: Sequence[Sequence[int]], place: Path
) -> None:
    """Raise InputError if a file has no frame or several, or shares it with one of another name."""
    first: dict[int, int] = {}
    for i, (file, frames) in enumerate(zip(files, found, strict=True)):
        expected = f"poses: expected a frame of {file.name} in {place}, found"
        if len(frames) != 1:
            raise InputError(f"{expected} {len(frames) or 'none'}")
        other = first.setdefault(frames[0], i)
        if asked[other] != asked[i]:
            raise InputError(f"{expected} that of {files[other].name}")


def _frames_by_name(asked: Sequence[str], names: Sequence[str]) -> list[list[int]]:
    """Return the indices of the frames of each name that is asked for.

    Names agree as those of colour images do (`keys_of_name`); the strictest rule by which any name
    has a frame holds for all.
    """
    keys = [(i, keys_of_name(name)) for i, name in enumerate(names) if name]
    found: list[list[int]] = [[] for _ in asked]
    for rule in range(3):
        frames_of: dict[Hashable, list[int]] = {}
        for i, key in keys:
            frames_of.setdefault(key[rule], []).append(i)
        found = [frames_of.get(keys_of_name(name)[rule], []) for name in asked]
        if any(found):
            break
    return found


_PICTURES = (*DEPTH_SUFFIXES, ".jpg", ".jpeg", ".webp")


def _frame_name(name: str) -> str:
    """Return a file's name without its suffix, and without the word for its kind."""
    stem, dot, suffix = name.rpartition(".")
    stem = stem if dot and f".{suffix.lower()}" in _PICTURES else name
    return stem.removesuffix(".depth").removesuffix(".color")


def _by_time(
    files: Sequence[Path],
    asked: NDArray[np.float64],
    times: NDArray[np.float64],
    found: list[NDArray[np.float64]],
) -> list[NDArray[np.float64]]:
    """Return the pose nearest in time to each file; in order where the names are only numbers."""
    nearest = _nearest(asked, times)
    apart = np.nan_to_num(np.abs(asked - times[nearest]), nan=np.inf)
    is_near = apart <= MAX_SECONDS_APART
    if is_near.all():
        return [found[i] for i in nearest]
    are_numbered = 2 * np.count_nonzero(is_near) < len(files)
    if are_numbered and len(found) == len(files) and _ascend(asked) and _ascend(times):
        return found
    worst = int(apart.argmax())
    asks = f"poses: expected a pose within {MAX_SECONDS_APART} s of {files[worst]}"
    if np.isinf(apart[worst]):
        raise InputError(f"{asks}, whose name is not a time")
    raise InputError(f"{asks}, the nearest is {apart[worst]:.3f} s away")


def _nearest(asked: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the index of the nearest time to each number; the lowest one of several as near."""
    order = np.argsort(times, kind="stable")
    ascending = times[order]
    # The first of equal times has the lowest index. Equal times lie on one side of a number.
    after = np.searchsorted(ascending, asked).clip(max=len(times) - 1)
    before = np.searchsorted(ascending, ascending[(after - 1).clip(min=0)])
    from_after, from_before = (np.abs(asked - ascending[i]) for i in (after, before))
    after, before = order[after], order[before]
    is_tie = from_before == from_after
    nearer = np.where(from_before < from_after, before, after)
    found: NDArray[np.intp] = np.where(is_tie, np.minimum(before, after), nearer)
    return found


def _number_in(file: Path) -> float:
    """Return the number that a file's name consists of; NaN if the name is not a number."""
    stem = Path(plain_name(file)).stem
    return float(stem) if re.fullmatch(r"-?[0-9]+(\.[0-9]*)?", stem) else math.nan


def _are_frames(files: Sequence[Path], numbers: NDArray[np.float64]) -> bool:
    """Return whether all names are whole numbers and too small to be times since 1970."""
    named = [Path(plain_name(file)).stem for file in files]
    return not any(
        math.isnan(number) or "." in name or is_since_1970(number)
        for name, number in zip(named, numbers, strict=True)
    )


def _in_seconds(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.array([seconds(number) for number in numbers.tolist()])


def _ascend(values: NDArray[np.float64]) -> bool:
    return bool((np.diff(values) > 0).all())


def plain_name(file: Path) -> str:
    """Return a file's name without the suffix of a compression."""
    return file.name.removesuffix(".xz").removesuffix(".gz")


def _in_order(
    files: Sequence[Path],
    found: list[NDArray[np.float64]],
    place: Path,
    words: str = "times",
) -> list[NDArray[np.float64]]:
    if len(found) != len(files):
        raise InputError(
            f"poses: expected file names that are {words}, or {len(files)} poses in {place}, found "
            f"{len(found)}"
        )
    return found
