"""Reader of UTD-MHAD's trials: depth images of a Kinect V1, and the joints of the person."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.csv_tables import csv_rows
from manip3d._util.paths import visible
from manip3d.errors import FormatError
from manip3d.io._files import limited_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

DEPTH_ENDING = "_depth.mat"
"""Ending of the data set's depth file names."""

_SIZE = (240, 320)  # rows and columns of the depth images
_JOINTS = 20  # joints of a Kinect V1 skeleton
_FARTHEST_M = 1000.0  # largest plausible coordinate of a joint; others are errors of unit
_MAX_BYTES = 1 << 28  # a trial of 4 s has 0.2 MB, so that one of an hour would have 200 MB
_UNCOMPRESSED = 1 << 26  # up to this number of bytes, a variable may have any compression ratio
_MAX_RATIO = 200  # largest compression ratio of a larger variable; the data set's trials have 60
_TABLE = "joints.csv"
# Codes of the MATLAB 5 format: types of data elements, of numbers, and classes of numeric arrays.
_MATRIX, _COMPRESSED = 14, 15
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
_NUMERIC = range(6, 16)


def trial_at(place: str | os.PathLike[str]) -> Path | None:
    """Return the path of the trial at a file or folder; None if it is no trial.

    A trial is a depth file of the data set, or a folder with ``depth_0000.png`` and so on, and
    ``joints.csv``. A folder with a single depth file stands for that file; one with several depth
    files is no trial.
    """
    path = Path(place)
    if path.name.endswith(DEPTH_ENDING):
        return path
    if (path / _TABLE).is_file() and (path / "depth_0000.png").is_file():
        return path
    found = list(islice(visible(path.glob(f"*{DEPTH_ENDING}")), 2)) if path.is_dir() else []
    return found[0] if len(found) == 1 else None


def read_trial(
    trial: Path, skeleton: Path | None = None
) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Return depth images (N, 240, 320) in millimetres and joints (N, 20, 3) in metres.

    Images are mirrored, as the Kinect delivers them. Joints are in the Kinect's axes and in the
    data set's own order. If a table lacks a joint of a frame, all joints of that frame are NaN.

    ``skeleton`` is the file of joints for a depth file. Default: ``..._skeleton.mat`` in the same
    folder, or in the folder ``Skeleton`` beside that folder, as the data set is distributed.

    Raises
    ------
    FormatError
        A file is damaged, there are no joints, or a joint is not finite or farther than 1000 m.
    OSError
        A file cannot be read.
    MissingExtraError
        Pillow is not installed, which reads PNG.
    """
    if trial.is_dir():
        images, joints, is_whole = _png_trial(trial)
    else:
        images, joints = _mat_trial(trial, skeleton)
        is_whole = np.ones(len(joints), np.bool_)
    if len(images) != len(joints):
        raise FormatError(f"expected {len(images)} skeletons, got {len(joints)}", file=str(trial))
    is_told = (np.abs(joints) <= _FARTHEST_M) | ~is_whole[:, None, None]
    if not is_told.all():
        frame, joint, axis = np.argwhere(~is_told)[0]
        told = (
            f"joint {joint} of frame {frame}: expected metres within {_FARTHEST_M:g} of the "
            f"camera, got {joints[frame, joint, axis]:g}"
        )
        raise FormatError(told, file=str(trial / _TABLE if trial.is_dir() else trial))
    return images, joints


def _mat_trial(
    trial: Path, skeleton: Path | None
) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    depth = _variable(trial, "d_depth", _SIZE)
    if not ((depth >= 0) & (depth <= 65535)).all():
        raise FormatError("expected depths of 0 to 65535 mm", file=str(trial))
    joints = _variable(skeleton or _skeleton_beside(trial), "d_skel", (_JOINTS, 3))
    return depth.astype(np.uint16), joints.astype(np.float64)


def joints_of(trial: Path) -> tuple[Path, Path]:
    """Return the two paths at which the file of a depth file's joints may be; the first wins."""
    name = f"{trial.name.removesuffix(DEPTH_ENDING)}_skeleton.mat"
    return trial.parent / name, trial.absolute().parent.parent / "Skeleton" / name


def _skeleton_beside(trial: Path) -> Path:
    places = joints_of(trial)
    for place in places:
        if place.is_file():
            return place
    trial.stat()  # raises OSError, which names the trial, if that is missing
    raise FormatError(f"expected the joints of this trial in {places[0]}", file=str(trial))


def _variable(path: Path, name: str, shape: tuple[int, int]) -> NDArray[Any]:
    """Read a variable of a MATLAB 5 file, and move its last axis, time, to the front."""
    content = limited_bytes(path, _MAX_BYTES)
    try:
        found = _matlab_arrays(content)
    except (ValueError, struct.error, zlib.error, LookupError) as error:
        raise FormatError(f"damaged, or no MATLAB 5 file: {error}", file=str(path)) from None
    values = found.get(name)
    if values is None or values.ndim != 3 or values.shape[:2] != shape:
        raise FormatError(f"expected {name} of shape {(*shape, 'frames')}", file=str(path))
    return np.moveaxis(values, 2, 0)


# A reader of our own, because scipy.io.loadmat crashes the process on some damaged files.
def _matlab_arrays(content: bytes) -> dict[str, NDArray[Any]]:
    """Return the real numeric arrays of a MATLAB 5 file (MathWorks, "MAT-File Format")."""
    order = {b"IM": "<", b"MI": ">"}[content[126:128]]
    most = max(_UNCOMPRESSED, _MAX_RATIO * len(content))
    arrays = {}
    for kind, data in _elements(content[128:], order):
        if kind == _COMPRESSED:
            unpacking = zlib.decompressobj()
            unpacked = unpacking.decompress(data, most)
            if unpacking.unconsumed_tail:
                raise ValueError(f"expected a compression by at most {_MAX_RATIO}, got more")
            kind, data = next(_elements(unpacked, order), (0, b""))
        if kind != _MATRIX:
            continue
        flags, dimensions, name, *numbers = islice(_elements(data, order), 5)
        array_class, is_complex = flags[1][0 if order == "<" else 3], len(numbers) > 1
        if array_class not in _NUMERIC or is_complex:
            continue  # text, a structure, or another kind of variable
        sizes = np.frombuffer(dimensions[1], f"{order}i4")
        values = np.frombuffer(numbers[0][1], f"{order}{_TYPES[numbers[0][0]]}")
        arrays[name[1].decode("latin-1")] = values.reshape(sizes, order="F")
    return arrays


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and content of consecutive data elements."""
    at = 0
    while at + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        begin = at + 8
        if kind >> 16:  # small data element: up to four bytes of data within the tag
            kind, size, begin = kind & 0xFFFF, kind >> 16, at + 4
        if begin + size > len(data) or (begin == at + 4 and size > 4):
            raise ValueError("a data element is cut off")
        yield kind, data[begin : begin + size]
        at = max(at + 8, begin + size)
        at += 0 if kind == _COMPRESSED else -at % 8


def _png_trial(
    folder: Path,
) -> tuple[NDArray[np.uint16], NDArray[np.float64], NDArray[np.bool_]]:
    """Read images and joints of a folder, and whether the table has all joints of each frame.

    The table has a row for each joint: frame, joint, name, x, y, z (metres).
    """
    from manip3d.io._depth_files import read_depth

    paths = sorted(folder.glob("depth_*.png"))
    for index, path in enumerate(paths):
        if path.name != f"depth_{index:04d}.png":
            raise FormatError(f"expected depth_{index:04d}.png before it", file=str(path))
    images = [read_depth(path) for path in paths]
    for path, image in zip(paths, images, strict=True):
        if image.shape != _SIZE:
            told = f"expected {_SIZE[1]} x {_SIZE[0]} pixels, as UTD-MHAD has, got "
            raise FormatError(told + f"{image.shape[1]} x {image.shape[0]}", file=str(path))
    table = folder / _TABLE
    lines, rows = _rows_of(table)
    joints = np.full((len(images), _JOINTS, 3), np.nan)
    at = _places_of(rows[:, :2], lines, len(images), table)
    joints.reshape(-1, 3)[at] = rows[:, 2:]
    is_whole = np.bincount(at // _JOINTS, minlength=len(images)) == _JOINTS
    if not is_whole.any():
        told = f"expected the {_JOINTS} joints of {len(images)} frames, got those of none"
        raise FormatError(told, file=str(table))
    joints[~is_whole] = np.nan
    return np.stack(images).astype(np.uint16), joints, is_whole


def _rows_of(table: Path) -> tuple[list[int], NDArray[np.float64]]:
    """Return the lines of a table after its heading, and their frames, joints, x, y and z."""
    lines, rows = list[int](), list[list[float]]()
    table_rows = csv_rows(table, most_bytes=_MAX_BYTES, errors="replace")
    for line, row in islice(table_rows, 1, None):
        try:
            rows.append([float(row[column]) for column in (0, 1, 3, 4, 5)])
        except (ValueError, IndexError) as error:
            told = "expected frame, joint, name, x, y, z after a heading, with commas between them"
            raise FormatError(f"{told}: {error}", file=str(table), line=line) from None
        lines.append(line)
    return lines, np.array(rows, np.float64).reshape(-1, 5)


def _places_of(
    told: NDArray[np.float64], lines: list[int], num_frames: int, table: Path
) -> NDArray[np.intp]:
    """Return the index of each row among all joints of all frames.

    Rows may be missing, but must be in order.
    """
    frame, joint = told[:, 0], told[:, 1]
    place: NDArray[np.float64] = frame * _JOINTS + joint
    is_right = (frame == np.floor(frame)) & (joint == np.floor(joint)) & (frame >= 0) & (joint >= 0)
    is_right &= (frame < num_frames) & (joint < _JOINTS)
    is_right[1:] &= place[1:] > place[:-1]
    if not is_right.all():
        at = int(np.flatnonzero(~is_right)[0])
        raise FormatError(
            f"expected joints 0 to {_JOINTS - 1} of frames 0 to {num_frames - 1}, frame by frame, "
            f"got joint {joint[at]:g} of frame {frame[at]:g} in its place",
            file=str(table),
            line=lines[at],
        )
    return place.astype(np.intp)
