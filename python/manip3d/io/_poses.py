"""Files that say where scanners stood."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.text_files import text_of
from manip3d.errors import FormatError

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def poses_by_file(path: Path) -> dict[str, NDArray[np.float64]]:
    """The poses of a Stanford ``.conf`` file; see `manip3d.datasets.read_poses`."""
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
    """The transform of ``tx ty tz qx qy qz qw``, its rotation the inverse of the quaternion's.

    Raises
    ------
    ValueError
        Other than seven finite numbers, or a quaternion of zeros.
    """
    if values.shape != (7,) or not np.isfinite(values).all() or not np.any(values[3:]):
        raise ValueError(values)
    x, y, z, w = values[3:] / np.linalg.norm(values[3:])
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    pose = np.eye(4)
    pose[:3, :3] = (np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross).T
    pose[:3, 3] = values[:3]
    return pose
