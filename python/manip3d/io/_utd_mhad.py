"""Trials of UTD-MHAD: depth images of a Kinect V1 and the joints of the person in them."""

from __future__ import annotations

import io
import math
import os
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.errors import FormatError, MissingExtraError
from manip3d.io._depth_files import read_depth
from manip3d.io._files import limited_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

DEPTH_ENDING = "_depth.mat"
"""What the names of the data set's depth files end with."""

_SIZE = (240, 320)
_JOINTS = 20
_MOST_BYTES = 1 << 28  # a trial of 4 s has 0.2 MB, one of an hour would have 200
_UNCOMPRESSED = 1 << 26  # bytes of a variable that may be compressed by any factor
_MOST_RATIO = 200  # of compression, beyond that: trials have 60
_TABLE = "joints.csv"


def trial_at(place: str | os.PathLike[str]) -> Path | None:
    """Return the trial that a file, or a folder that holds one trial, is; None for anything else.

    A trial is a depth file of the data set, or a folder with ``depth_0000.png`` and so on, and
    ``joints.csv``. A folder with the depth files of several trials is none.
    """
    path = Path(place)
    if path.name.endswith(DEPTH_ENDING):
        return path
    if (path / _TABLE).is_file() and (path / "depth_0000.png").is_file():
        return path
    found = list(islice(path.glob(f"*{DEPTH_ENDING}"), 2)) if path.is_dir() else []
    return found[0] if len(found) == 1 else None


def read_trial(
    trial: Path, skeleton: Path | None = None
) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Return depth images (N, 240, 320) in millimetres and joints (N, 20, 3) in metres.

    Images are mirrored, as the Kinect delivers them, and joints are in its axes and in the data
    set's own order. Without ``skeleton`` they are in ``..._skeleton.mat`` beside the depth file, or
    in the folder ``Skeleton`` beside the folder of depth files, as the data set is distributed.

    Raises
    ------
    FormatError
        A file is damaged, or there are no joints.
    OSError
        `FileNotFoundError` and the like.
    MissingExtraError
        scipy or Pillow is not installed.
    """
    images, joints = _png_trial(trial) if trial.is_dir() else _mat_trial(trial, skeleton)
    if len(images) != len(joints):
        raise FormatError(f"expected {len(images)} skeletons, got {len(joints)}", file=str(trial))
    return images, joints


def _mat_trial(
    trial: Path, skeleton: Path | None
) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    depth = _variable(trial, "d_depth", _SIZE)
    if not (depth.dtype.kind in "iuf" and ((depth >= 0) & (depth <= 65535)).all()):
        raise FormatError("expected depths of 0 to 65535 mm", file=str(trial))
    joints = _variable(skeleton or _skeleton_beside(trial), "d_skel", (_JOINTS, 3))
    if joints.dtype.kind not in "iuf":
        raise FormatError("expected joints that are real numbers", file=str(trial))
    return depth.astype(np.uint16), joints.astype(np.float64)


def _skeleton_beside(trial: Path) -> Path:
    name = f"{trial.name.removesuffix(DEPTH_ENDING)}_skeleton.mat"
    places = (trial.parent, trial.parent.parent / "Skeleton")
    for place in places:
        if (place / name).is_file():
            return place / name
    trial.stat()  # a missing trial is an OSError that names it
    raise FormatError(f"expected the joints of this trial in {places[0] / name}", file=str(trial))


def _variable(path: Path, name: str, shape: tuple[int, int]) -> NDArray[Any]:
    """A variable of a MATLAB 5 file whose last axis is time, with time first."""
    try:
        from scipy.io import loadmat, whosmat
    except ImportError:
        raise MissingExtraError("scipy", "experiments") from None
    content = limited_bytes(path, _MOST_BYTES)
    try:
        listed = {found: (size, kind) for found, size, kind in whosmat(io.BytesIO(content))}
        size, kind = listed.get(name, ((), "double"))
        if len(size) != 3 or size[:2] != shape:
            told = f"expected {name} of shape {(*shape, 'frames')}, got {size or 'none'}"
            raise FormatError(told, file=str(path))
        num_bytes = math.prod(size) * np.dtype(kind).itemsize
        if num_bytes > max(_UNCOMPRESSED, _MOST_RATIO * len(content)):
            told = f"expected a compression by at most {_MOST_RATIO}, got more"
            raise FormatError(told, file=str(path))
        values = loadmat(io.BytesIO(content), variable_names=[name])[name]
    except FormatError:
        raise
    except Exception as error:  # scipy raises whatever its parser runs into
        told = f"damaged, or no MATLAB 5 file: {error or type(error).__name__}"
        raise FormatError(told, file=str(path)) from None
    if values.shape != size:
        raise FormatError(f"expected {name} of shape {size}, got {values.shape}", file=str(path))
    return np.moveaxis(values, 2, 0)


def _png_trial(folder: Path) -> tuple[NDArray[np.uint16], NDArray[np.float64]]:
    """Images of a folder, and its table with a row for each joint: frame, joint, name, x, y, z."""
    images = [read_depth(path) for path in sorted(folder.glob("depth_*.png"))]
    if any(image.shape != _SIZE for image in images):
        raise FormatError(f"expected depth images of {_SIZE[1]} x {_SIZE[0]}", file=str(folder))
    table = folder / _TABLE
    text = limited_bytes(table, _MOST_BYTES).decode("utf-8", "replace").splitlines()
    try:
        rows = np.loadtxt(text, np.float64, delimiter=",", skiprows=1, usecols=(0, 1, 3, 4, 5))
    except ValueError as error:
        raise FormatError(str(error), file=str(table)) from None
    number = np.arange(len(images) * _JOINTS)
    order = np.stack([number // _JOINTS, number % _JOINTS], axis=1)
    if not np.array_equal(rows[..., :2], order):
        told = f"expected the {_JOINTS} joints of {len(images)} frames, frame by frame"
        raise FormatError(told, file=str(table))
    return np.stack(images).astype(np.uint16), rows[:, 2:].reshape(-1, _JOINTS, 3)
