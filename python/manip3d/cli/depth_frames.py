"""Folders of depth images: their common unit, and the images that belong to each of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d.cli.kinds import expect_kind, is_picture, narrow_depth
from manip3d.cli.many import SKIPPED
from manip3d.cli.terminal import naming_options
from manip3d.errors import FormatError
from manip3d.io._scan_tables import scan_suffix

if TYPE_CHECKING:
    from manip3d.batch import SourceFile

SCANS = (".ply", ".pcd")
"""Suffixes of range scans and organised clouds, beside those of depth images."""


def frame_options(files: list[SourceFile], options: dict[str, Any]) -> dict[str, dict[str, str]]:
    """One unit for all depth images, and the colour image, mask and confidence of each frame."""
    from manip3d import simplify
    from manip3d.simplify._depth_inputs import may_have_8_bits
    from manip3d.simplify._depth_sets import common_guess

    with naming_options("unit", "intrinsics"):
        may_be_8_bits = may_have_8_bits(options["unit"], options["intrinsics"])
    maps = maps_in_folders(files)
    names = [f.name for f in files if not is_picture(f.name, may_be_8_bits) and f.name not in maps]
    clouds = {name for name in names if _is_cloud(name)}
    if not clouds:
        _expect_camera(names, options["intrinsics"])
    each: dict[str, dict[str, str]] = {file.name: {"color": ""} for file in files}
    each |= {name: {SKIPPED: "a mask or confidences"} for name in maps}
    with naming_options("color", "mask", "confidence", "unit"):
        for name in clouds:  # the unit of another instrument; each cloud keeps its own guess
            each[name]["unit"] = options["unit"]
        images = [name for name in names if name not in clouds]
        options["unit"] = common_guess(images, options["unit"], options["intrinsics"])
        colors = options.pop("color")
        folders = {"color": colors} if colors else {}
        for name in ("mask", "confidence"):  # a file is that of all frames
            if options[name] and Path(options[name]).is_dir():
                folders[name] = options.pop(name)
        for name, folder in folders.items():
            for frame, image in simplify.colors_of_frames(names, folder, name=name).items():
                each[frame][name] = image
    return each


def expect_image(source: str, given: Mapping[str, Any]) -> None:
    """Refuse a source that is neither a depth image nor a range scan or an organised cloud."""
    # Whether a cloud is an organised one is decided by its reader.
    clouds = ("scan",) if scan_suffix(source) in (".pcd", ".npy", ".npz") else ()
    pictures = narrow_depth(source, given["unit"], given["intrinsics"])
    expect_kind(source, "depth", "range grid", *clouds, *pictures, verb="depth")


def maps_in_folders(files: list[SourceFile]) -> set[str]:
    """Return the names of masks and confidences that lie beside depth images in folders."""
    from manip3d.simplify._depth_sets import maps_by_name

    maps = maps_by_name([file.name for file in files])
    return {file.name for file in files if file.name in maps and not file.is_named}


def _expect_camera(names: list[str], intrinsics: str) -> None:
    """Raise InputError if no camera of depth images is given."""
    from manip3d.simplify._depth_inputs import expect_camera

    if names:
        with naming_options("intrinsics"):
            expect_camera(intrinsics, Path(names[0]))


def _is_cloud(name: str) -> bool:
    from manip3d.io import is_url
    from manip3d.simplify._organised import is_cloud_file

    try:
        return scan_suffix(name) in SCANS or (not is_url(name) and is_cloud_file(Path(name)))
    except (OSError, FormatError):  # the frame's own turn reports it
        return False
