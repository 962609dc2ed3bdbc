"""Files beside a drive that describe its stereo pairs."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.authenticate._stereo import StereoRig
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_write, open_regular

RIGS_FILE = "rigs.json"
"""Name of the file in a drive's folder."""

_FORMAT = "manip3d stereo rigs 1"
_MAX_BYTES = 1 << 20  # a rig has a few hundred
_LAST_CAMERA = 99  # KITTI numbers cameras by two digits: image_02


class CameraPair(NamedTuple):
    """A stereo pair of a drive.

    Attributes
    ----------
    rig : StereoRig
        Geometry of the pair.
    left, right : int
        Numbers of the cameras, 0 to 99; the pictures of camera NN are in ``image_NN`` of the drive.
    """

    rig: StereoRig
    left: int
    right: int


@checked
def write_rigs(pairs: Mapping[str, CameraPair], path: str | os.PathLike[str]) -> None:
    """Write the stereo pairs of a drive.

    Parameters
    ----------
    pairs : mapping of str to CameraPair
        Stereo pairs by name.
    path : path
        Path of the file; commands find ``rigs.json`` in the drive's folder by default.

    Raises
    ------
    InputError
        There is no pair, or the number of a camera is out of range.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import CameraPair, StereoRig, read_rigs, write_rigs
    >>> rig = StereoRig(700.0, (600.0, 180.0), 0.5, np.eye(4))
    >>> write_rigs({"front": CameraPair(rig, 2, 3), "left": CameraPair(rig, 4, 5)}, "rigs.json")
    >>> sorted(read_rigs("rigs.json"))
    ['front', 'left']
    """
    if not pairs:
        raise InputError("pairs: expected at least one, got none")
    values = {}
    for name, (rig, left, right) in pairs.items():
        if not (0 <= left <= _LAST_CAMERA and 0 <= right <= _LAST_CAMERA and left != right):
            raise InputError(f"pairs: expected two cameras from 0 to 99, got {left} and {right}")
        values[name] = {
            "left": left,
            "right": right,
            "focal": rig.focal,
            "center": list(rig.center),
            "baseline": rig.baseline,
            "T_lidar_camera": rig.T_lidar_camera.tolist(),
        }
    text = json.dumps({"format": _FORMAT, "pairs": values}, indent=1) + "\n"
    atomic_write(path_of(path), text)


@checked
def read_rigs(path: str | os.PathLike[str]) -> dict[str, CameraPair]:
    """Read the stereo pairs of a drive.

    Parameters
    ----------
    path : path
        JSON file of `write_rigs`. For each pair it has the name, the numbers of the cameras, focal
        length and principal point in pixels, the baseline in metres, and the left camera's pose in
        the LiDAR's frame, a (4, 4) matrix.

    Returns
    -------
    dict of str to CameraPair
        The pairs by their names.

    Raises
    ------
    FormatError
        The file is not a file of stereo pairs.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from manip3d.authenticate import CameraPair, StereoRig, read_rigs, write_rigs
    >>> rig = StereoRig(700.0, (600.0, 180.0), 0.5, np.eye(4))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_rigs({"front": CameraPair(rig, 2, 3)}, Path(folder) / "rigs.json")
    ...     read_rigs(Path(folder) / "rigs.json")["front"].rig.baseline
    0.5
    """
    name = str(path_of(path))
    with open_regular(path_of(path)) as file:
        raw = file.read(_MAX_BYTES + 1)
    if len(raw) > _MAX_BYTES:
        raise FormatError(f"expected at most {_MAX_BYTES} bytes", file=name)
    try:
        values = json.loads(raw)
        if values["format"] != _FORMAT or not values["pairs"]:
            raise ValueError(f"expected the format {_FORMAT!r} and pairs")
        return {str(pair): _pair(value) for pair, value in values["pairs"].items()}
    except (
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        OverflowError,  # of a whole number beyond all floats
        RecursionError,
    ) as error:
        why = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise FormatError(f"expected stereo rigs: {why}", file=name) from error


def _pair(value: Mapping[str, Any]) -> CameraPair:
    left, right = value["left"], value["right"]
    for camera in (left, right):
        if type(camera) is not int or not 0 <= camera <= _LAST_CAMERA:
            raise ValueError(f"expected cameras from 0 to 99, got {camera!r}")
    if left == right:
        raise ValueError(f"expected two cameras, got {left} twice")
    u, v = (float(number) for number in value["center"])
    rig = StereoRig(
        float(value["focal"]),
        (u, v),
        float(value["baseline"]),
        np.array(value["T_lidar_camera"], np.float64),
    )
    return CameraPair(rig, left, right)
