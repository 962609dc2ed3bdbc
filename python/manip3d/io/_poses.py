"""Readers of files with poses of scanners and cameras."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.callers import caller_level
from manip3d._util.linear import determinant, product
from manip3d._util.text_files import text_of
from manip3d.errors import FormatError
from manip3d.io._pose_columns import (
    POSE,
    columns_of,
    fields_of,
    filled,
    names_another_order,
    names_in,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_UNIT_TOLERANCE = 1e-3  # largest error of a quaternion's length and of R R^T


def poses_by_file(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read the poses of a Stanford ``.conf`` file; see `manip3d.datasets.read_poses`."""
    poses = {}
    for number, line in enumerate(text_of(path).splitlines(), start=1):
        kind, *fields = line.split() or [""]
        if kind != "bmesh":
            continue
        try:
            file, values = fields[0], np.array(fields[1:], dtype=np.float64)
            poses[file] = rigid(values)
        except (IndexError, ValueError) as error:
            text = "expected 'bmesh FILE' and seven numbers, a quaternion among them"
            raise FormatError(text, file=str(path), line=number) from error
    return poses


def rigid(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (4, 4) transform of ``tx ty tz qx qy qz qw`` in Stanford's convention.

    Its rotation is the inverse of the quaternion's rotation.

    Raises
    ------
    ValueError
        The values are not seven finite numbers, or the quaternion is 0.
    """
    if values.shape != (7,) or not np.isfinite(values).all() or not np.any(values[3:]):
        raise ValueError(values)
    x, y, z, w = values[3:] / np.linalg.norm(values[3:], axis=-1)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] = (np.eye(3) + 2.0 * w * cross + 2.0 * product(cross, cross)).T
    pose[:3, 3] = values[:3]
    return pose


class LostPoseError(FormatError):
    """Raised for a matrix with numbers that are not finite, as ScanNet has it for lost frames."""


def matrix_pose(place: Path) -> NDArray[np.float64]:
    """Read a pose from a file of four lines of four numbers.

    Raises
    ------
    LostPoseError
        There are sixteen numbers, of which one or more are infinite or NaN.
    FormatError
        The file holds anything else.
    """
    try:
        lines = _numbers_of_lines(place)
    except FormatError as error:
        if _is_lost(place):
            raise LostPoseError(error.reason, file=error.file, line=error.line) from None
        raise
    return _checked_matrix([values for _, values in lines], place, 1)


def poses_of_log(place: Path) -> dict[int, NDArray[np.float64]]:
    """Read the poses by frame number from a log file in the format of Redwood and Open3D."""
    lines = _numbers_of_lines(place)
    found: dict[int, NDArray[np.float64]] = {}
    for first in range(0, len(lines), 5):
        number, head = lines[first]
        if len(head) != 3 or not head[0].is_integer():
            text = "expected three whole numbers before each matrix"
            raise FormatError(text, file=str(place), line=number)
        rows = [values for _, values in lines[first + 1 : first + 5]]
        found[int(head[0])] = _checked_matrix(rows, place, number + 1)
    return found


def trajectory(
    place: Path,
) -> tuple[NDArray[np.float64] | None, list[NDArray[np.float64]]]:
    """Read times and poses (camera to world) from lines of 8, 7, 12 or 16 numbers.

    Eight numbers are a time and a translation with a quaternion, as in the TUM RGB-D benchmark;
    seven lack the time; twelve are the upper rows of a matrix, as in KITTI; sixteen are all of its
    rows, as in Replica. Times are None unless a line has 8 numbers. The first line or a comment
    before it may name the columns, of which time and pose are then taken in any order, as in EuRoC
    and Stray Scanner; the number of a frame replaces the time. All lines that name them must agree.
    """
    lines = _lines_in_order(place)
    if not lines:
        raise FormatError("expected lines 'time tx ty tz qx qy qz qw', found none", file=str(place))
    width = len(lines[0][1])
    poses = []
    for number, values in lines:
        if len(values) != width or width not in (7, 8, 12, 16):
            text = (
                "expected eight numbers (time tx ty tz qx qy qz qw), seven without the time, or "
                "twelve or sixteen of a matrix, as in the lines before"
            )
            raise FormatError(text, file=str(place), line=number)
        if width in (12, 16):
            last = [np.array([0.0, 0.0, 0.0, 1.0])] if width == 12 else []
            poses.append(_checked_matrix([*values.reshape(-1, 4), *last], place, number))
            continue
        if not abs(np.linalg.norm(values[-4:], axis=-1) - 1) <= _UNIT_TOLERANCE:
            text = "expected a quaternion of length 1 in qx, qy, qz and qw, the last four numbers"
            raise FormatError(text, file=str(place), line=number)
        pose = rigid(values[-7:])
        pose[:3, :3] = pose[:3, :3].T  # undoes the inversion by rigid()
        poses.append(pose)
    return np.array([values[0] for _, values in lines]) if width == 8 else None, poses


_CV_OF_GL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Turns the axes of a camera of OpenGL (y up, z backwards) into ours (y down, z forward)."""
_MAX_PATH = 4096  # characters; longer ones are no paths of files


def poses_of_transforms(place: Path) -> tuple[list[str], list[NDArray[np.float64]]]:
    """Read names and poses (camera to world) from a ``transforms.json``, as of nerfstudio.

    A name is the path of the frame's depth image, else that of its colour image; empty if the file
    states neither. ``transform_matrix`` has the axes of OpenGL's cameras. Its translation is
    divided by the file's ``applied_scale``, by which nerfstudio multiplies it, but no depths.
    """
    try:
        fields = json.loads(text_of(place))
    except (ValueError, RecursionError):  # among them numbers with too many digits
        raise FormatError("expected JSON", file=str(place)) from None
    frames = fields.get("frames") if isinstance(fields, dict) else None
    if not isinstance(frames, list) or not frames:
        text = "expected 'frames' with a 'transform_matrix' each, as in transforms.json"
        raise FormatError(text, file=str(place))
    scale = _scale_of(fields.get("applied_scale", 1.0), place)
    names, poses = [], []
    for number, frame in enumerate(frames):
        if not isinstance(frame, dict):
            raise FormatError(f"frames[{number}]: expected an object", file=str(place))
        name = f"frames[{number}].transform_matrix"
        poses.append(_pose_of_frame(frame, scale, name, place) @ _CV_OF_GL)
        paths = (frame.get("depth_file_path"), frame.get("file_path"))
        names.append(next((str(path) for path in paths if _is_path(path)), ""))
    return names, poses


def _is_path(value: Any) -> bool:
    return isinstance(value, str) and 0 < len(value) <= _MAX_PATH


def _scale_of(value: Any, place: Path) -> float:
    scale = _numbers_in(value)
    if scale.shape != () or not 0 < scale < math.inf:
        raise FormatError("applied_scale: expected a number above 0", file=str(place))
    return float(scale)


def _pose_of_frame(
    frame: Mapping[str, Any], scale: float, name: str, place: Path
) -> NDArray[np.float64]:
    matrix = frame.get("transform_matrix")
    if matrix is None:
        raise FormatError(f"{name}: expected a matrix, found none", file=str(place))
    pose = _numbers_in(matrix)
    if pose.shape == (4, 4):
        with np.errstate(over="ignore", invalid="ignore"):
            pose[:3, 3] /= scale
    if not _is_rigid(pose):
        text = f"{name}: expected a rigid transform, 4 x 4 finite numbers, the last row 0 0 0 1"
        raise FormatError(text, file=str(place))
    return pose


def _numbers_in(value: Any) -> NDArray[np.float64]:
    """Return a number or nested lists of numbers as an array; NaN if they are anything else."""
    try:
        numbers = np.array(value)
        if numbers.dtype.kind not in "iuf":
            return np.array(math.nan)
        return numbers.astype(np.float64)
    except (ValueError, OverflowError, RecursionError):  # lists of different lengths
        return np.array(math.nan)


def _lines_in_order(place: Path) -> list[tuple[int, NDArray[np.float64]]]:
    """Return the numbers of each line; where columns are named, those of time, if any, and pose.

    Raises
    ------
    FormatError
        Names of columns are not understood, or a line has other columns or no finite numbers.
    """
    lines = _filled_lines(place)
    headings = [each for each in lines if _is_comment(each[1])]
    rows = [each for each in lines if not _is_comment(each[1])]
    if rows and _holds_words(rows[0][1]):
        headings.append(rows.pop(0))
    if not rows:
        return []
    columns = _columns_named_in(headings, rows[0], place)
    width = len(fields_of(rows[0][1]))
    found = []
    for number, line in rows:
        fields = fields_of(line)
        if columns and len(fields) != width:
            text = f"expected {width} fields, as in the lines before, got {len(fields)}"
            raise FormatError(text, file=str(place), line=number)
        chosen = [fields[column] for column in columns] or filled(fields)
        found.append((number, _numbers(chosen, place, number)))
    return found


def _columns_named_in(
    headings: Sequence[tuple[int, str]], first: tuple[int, str], place: Path
) -> tuple[int, ...]:
    """Return the columns of time, if any, and pose; empty if no line before the first names them.

    ``first`` is the first line of numbers. A comment that is not understood is refused only if it
    names a quaternion in another order than the usual one.
    """
    start, fields = first[0], fields_of(first[1])
    named = {number: columns_of(names_in(line), fields) for number, line in headings}
    columns = next((found for number, found in named.items() if found and number < start), ())
    order = columns or tuple(range(len(filled(fields))))
    for number, line in headings:
        if named[number] not in ((), order):
            text = f"expected one order of the columns in all of the file, got {line[:60]!r}"
            raise FormatError(text, file=str(place), line=number)
        is_harmless = len(order) in (12, 16) or not names_another_order(names_in(line))
        if not (columns or (_is_comment(line) and is_harmless)):
            text = (
                f"expected names of the {len(fields)} columns below, {' '.join(POSE)} among them "
                f"in any order, got {line[:60]!r}"
            )
            raise FormatError(text, file=str(place), line=number)
    if any("_RS_" in line for number, line in headings if named[number]):
        warnings.warn(
            f"poses: those of EuRoC and TUM-VI, whose columns {place.name} has, are of the IMU; "
            "multiply each from the right by T_BS of cam0/sensor.yaml for those of the camera",
            stacklevel=caller_level(),
        )
    return columns


def _numbers_of_lines(place: Path) -> list[tuple[int, NDArray[np.float64]]]:
    """Return line number and values of each line that is neither empty nor a comment."""
    return [
        (number, _numbers(filled(fields_of(line)), place, number))
        for number, line in _filled_lines(place)
        if not _is_comment(line)
    ]


def _filled_lines(place: Path) -> list[tuple[int, str]]:
    lines = enumerate(map(str.strip, text_of(place).splitlines()), start=1)
    return [(number, line) for number, line in lines if line]


def _is_comment(line: str) -> bool:
    return line.startswith("#")


def _holds_words(line: str) -> bool:
    """Return whether a line holds words only, and neither numbers nor what begins like them."""
    numbers = (re.match(r"[-+.]?\d|[-+]?(nan|inf)\b", field, re.I) for field in fields_of(line))
    return not any(numbers)


def _numbers(fields: Sequence[str], place: Path, line: int) -> NDArray[np.float64]:
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError:
        values = np.array([math.nan])
    if not np.isfinite(values).all():
        text = "expected finite numbers with spaces or commas between them"
        raise FormatError(text, file=str(place), line=line)
    return values


def _is_lost(place: Path) -> bool:
    rows = [filled(fields_of(line)) for _, line in _filled_lines(place) if not _is_comment(line)]
    try:
        return [len([float(word) for word in row]) for row in rows] == [4, 4, 4, 4]
    except ValueError:
        return False


def _checked_matrix(
    rows: Sequence[NDArray[np.float64]], place: Path, line: int
) -> NDArray[np.float64]:
    """Return the rows as a (4, 4) matrix, and raise if it is no rigid transform."""
    if [len(row) for row in rows] == [4, 4, 4, 4] and _is_rigid(pose := np.array(rows)):
        return pose
    text = "expected a rigid transform: four lines of four numbers, the last 0 0 0 1"
    raise FormatError(text, file=str(place), line=line)


def _is_rigid(pose: NDArray[np.float64]) -> bool:
    """Return whether an array is a (4, 4) rigid transform of finite numbers."""
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        return False
    turn = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        is_turn = np.abs(product(turn, turn.T) - np.eye(3)).max() <= _UNIT_TOLERANCE
    return bool(is_turn and determinant(turn) > 0 and (pose[3] == (0, 0, 0, 1)).all())
