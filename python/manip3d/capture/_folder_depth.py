"""Camera and unit of folders of depth images, which no file of a recording states."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.capture._first_image import depth_images_of
from manip3d.capture._folder_camera import camera_file_of, images_alone
from manip3d.errors import InputError
from manip3d.io._depth_units import units_per_metre
from manip3d.simplify._depth_options import DepthOptions
from manip3d.simplify._depth_sets import depths_of_some
from manip3d.simplify._depth_words import sentence_of_images


@dataclass(frozen=True)
class FolderDepth:
    """Camera and unit of the depth images of a folder; see `folder_depth`.

    Attributes
    ----------
    images : Path
        Folder of the depth images.
    intrinsics : str
        Camera as `manip3d.camera.read_intrinsics` takes it: the one that was given, or a file.
    unit : str
        Unit as `manip3d.io.read_depth_guessing` takes it.
    is_guess : bool
        Whether the unit was guessed from the numbers.
    sentence : str
        The depth range and the unit in words, for people to check.
    """

    images: Path
    intrinsics: str
    unit: str
    is_guess: bool
    sentence: str

    __repr__ = short_repr

    @property
    def units_per_metre(self) -> float:
        """The number of units in a metre, as `open_rgbd` takes it.

        Raises
        ------
        InputError
            The unit is no part of a metre, but a disparity, say.
        """
        number = units_per_metre(self.unit)
        if number is None:
            unit = f"{self.unit}, which was guessed" if self.is_guess else self.unit
            raise InputError(
                f"unit: expected a number of units per metre for the frames of a recording, got "
                f"{unit}; {self.images}, its depth images alone, may have it"
            )
        return number


@checked
def folder_depth(
    folder: str | os.PathLike[str], *, intrinsics: str = "", unit: str = "guess"
) -> FolderDepth | None:
    """Return camera and unit of a folder of images, for `open_rgbd`, which guesses no unit.

    Parameters
    ----------
    folder : path-like
        Folder with depth images (``.png``) in ``depth``.
    intrinsics : str
        Camera of the depth images, as the text that `manip3d.camera.read_intrinsics` takes.
        Default: the camera in ``intrinsic/intrinsic_depth.txt`` (ScanNet) or
        ``camera_intrinsic.json`` (Open3D), if there is one.
    unit : str
        Unit of the depth images, as `manip3d.io.read_depth_guessing` takes it. ``"guess"``: the
        unit that the camera states, or else the one that most images look like. Up to nine of
        them, evenly spaced, are read.

    Returns
    -------
    FolderDepth or None
        None if a file of a recording states the unit (``calibration.json``, ``frames.jsonl``, the
        lists of a TUM sequence, a ROS 2 bag), no camera is known, or no image can be read.

    Raises
    ------
    InputError
        The folder is none, the camera is none, or one of images of another size; or the unit is
        unknown.
    FormatError, OSError
        The file of the camera cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from PIL import Image
    >>> from manip3d import capture
    >>> Path("walk/depth").mkdir(parents=True)
    >>> for number in range(2):
    ...     depth = np.full((48, 64), 10_000 + number, np.uint16)
    ...     Image.fromarray(depth).save(f"walk/depth/{number}.png")
    >>> found = capture.folder_depth("walk", intrinsics="60,60,31.5,23.5", unit="tum")
    >>> found.sentence
    '2 depth images, depth 2.00 to 2.00 m, unit tum (1/5000 m: TUM RGB-D, ICL-NUIM)'
    >>> found.units_per_metre
    5000.0
    """
    place = path_of(folder, "folder")
    if not place.is_dir():
        raise InputError(f"folder: expected a folder with depth images in depth/, got {place}")
    images = depth_images_of(place) if images_alone(place) else []
    camera = intrinsics or str(camera_file_of(place) or "")
    if not images or not camera:
        return None
    # The number of points is without effect on how images are read.
    options = DepthOptions(ratio=1.0, intrinsics=camera, unit=unit)
    found = depths_of_some(images, options)
    if not found:
        return None
    return FolderDepth(
        images=images[0].parent,
        intrinsics=camera,
        unit=found[0].unit,
        is_guess=any(each.is_guess for each in found),
        sentence=sentence_of_images(found),
    )
