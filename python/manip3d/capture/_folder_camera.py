"""Cameras of folders of images, in the files that other tools write."""

from __future__ import annotations

from pathlib import Path

from manip3d.camera import Intrinsics, read_intrinsics
from manip3d.capture._first_image import depth_images_of, first_depth_size

_CAMERAS = ("intrinsic/intrinsic_depth.txt", "camera_intrinsic.json")
"""Files of ScanNet's exports and of Open3D's recordings."""
_OF_RECORDINGS = ("calibration.json", "depth.txt", "metadata.yaml")
"""Files of recordings that know their camera; the last is that of a ROS 2 bag."""


def camera_file_of(folder: Path) -> Path | None:
    """Return the file of another tool that states the camera of a folder of images, if any.

    A ``calibration.json`` of our own comes first; then the result is None, too.
    """
    if (folder / "calibration.json").is_file():
        return None
    return next((path for name in _CAMERAS if (path := folder / name).is_file()), None)


def camera_of_folder(folder: Path) -> Intrinsics | None:
    """Read the camera from the file of `camera_file_of`, for the size of the first depth image.

    Returns
    -------
    Intrinsics or None
        None if there is no such file, or no depth image.

    Raises
    ------
    InputError
        The camera is that of images of another size.
    FormatError, OSError
        The file or the first image cannot be read.
    """
    file = camera_file_of(folder)
    size = None if file is None else first_depth_size(folder, is_tum=False)
    if file is None or size is None:
        return None
    width, height = size
    return read_intrinsics(file, width=width, height=height)


def knows_camera(folder: Path, *, is_given: bool) -> bool:
    """Return whether the camera of a folder's images is known; ``is_given``: by other means."""
    if any((folder / name).is_file() for name in _OF_RECORDINGS):
        return True
    return bool(depth_images_of(folder)) and (is_given or camera_file_of(folder) is not None)


def images_alone(folder: Path) -> bool:
    """Return whether a folder has depth images whose unit no file of a recording states."""
    if any((folder / name).exists() for name in (*_OF_RECORDINGS, "frames.jsonl")):
        return False
    return bool(depth_images_of(folder))
