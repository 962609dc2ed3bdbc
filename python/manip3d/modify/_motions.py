"""Conversion of motion capture to skeletons with the Kinect V2's 25 joints.

``bvh_layouts.csv`` lists, for each naming convention, the possible names of the Kinect V1's joints;
the first name that the file contains is used. `skeleton_from` then makes the 25 joints.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.io import Motion
from manip3d.modify._joints import joint_layouts, skeleton_from
from manip3d.rgbd import JOINTS, NOT_TRACKED, TRACKED, Skeleton

if TYPE_CHECKING:
    from numpy.typing import NDArray

_UNITS = (1.0, 0.01, 0.001, 0.0254, 0.3048, 0.0254 / 0.45)
"""Metres per unit of each unit that is tried; the last is the unit of Carnegie Mellon's data."""

_LEG = 0.85
"""Distance from hip to ankle of an adult in metres, from which the unit is inferred."""

_OPTIONAL = {"HandLeft", "HandRight", "FootLeft", "FootRight", "Spine"}
"""Joints that a file may lack."""
_AWAY = 2.5  # metres from the camera to the base of the spine in the first frame
_MAX_SKELETONS = 1 << 20
"""Largest number of skeletons, which bounds the memory that a wrong rate can ask for."""


@cache
def _layouts() -> dict[str, dict[str, tuple[str, ...]]]:
    """Return the possible names of each Kinect V1 joint, by naming convention."""
    text = files("manip3d.modify").joinpath("bvh_layouts.csv").read_text(encoding="utf-8")
    found = {}
    for row in csv.DictReader(text.splitlines()):
        layout = row.pop("layout")
        found[layout] = {joint: tuple(names.split()) for joint, names in row.items()}
    return found


@checked
def skeletons_from_motion(
    motion: Motion, *, metres_per_unit: float | None = None, rate: float | None = None
) -> tuple[Skeleton, ...]:
    """Return the poses of a motion as skeletons in front of a camera.

    Parameters
    ----------
    motion : Motion
        Motion with y up, as read by `io.read_bvh`. Joints are identified by their names: those of
        `rgbd.JOINTS` (as `capture.export_joints` writes them), of Carnegie Mellon's and Mixamo's
        files (``Hips``, ``LeftArm``, ``LeftForeArm``, with any prefix up to a colon), of
        Biovision's (``Hips``, ``LeftShoulder``, ``LeftElbow``) and of Poser's (``hip``,
        ``lShldr``, ``lForeArm``).
    metres_per_unit : float, optional
        Unit of the positions. Default: metres, centimetres, millimetres, inches, feet or Carnegie
        Mellon's unit, whichever brings the length of the legs nearest to an adult's.
    rate : float, optional
        Skeletons per second, each from the frame nearest in time; default: one for every frame.

    Returns
    -------
    tuple of Skeleton
        Skeletons in camera axes. The whole motion is rotated about the vertical and moved so that
        in the first frame the person faces the camera from 2.5 m. Joints that the file lacks are
        `NOT_TRACKED`, or inferred by `skeleton_from`.

    Raises
    ------
    InputError
        The names of the joints follow no known convention, or an option is out of range.

    Examples
    --------
    >>> from manip3d import io, modify
    >>> poses = modify.skeletons_from_motion(io.read_bvh("walk.bvh"))  # doctest: +SKIP
    """
    if metres_per_unit is not None and not 1e-6 <= metres_per_unit <= 1e6:
        raise InputError(f"metres_per_unit: expected 1e-6 to 1e6, got {metres_per_unit}")
    if rate is not None and not 1e-3 <= rate <= 1e4:
        raise InputError(f"rate: expected 0.001 to 10000, got {rate}")
    chosen = _frames_at(len(motion), motion.frame_s, rate)
    layout, columns = _columns(motion.names)
    seen = np.array([column is not None for column in columns])
    taken = np.array([0 if column is None else column for column in columns])
    places = motion.positions[np.ix_(chosen, taken)]
    names = joint_layouts()["kinect-v2" if layout == "kinect-v2" else "kinect-v1"]
    unit = metres_per_unit or _unit(places[0], names)
    faced = _before_the_camera(places * unit, names)
    states = np.where(seen, np.uint8(TRACKED), np.uint8(NOT_TRACKED))
    kind = "kinect-v2" if layout == "kinect-v2" else "kinect-v1"
    return tuple(skeleton_from(each, states, layout=kind) for each in faced)  # type: ignore[arg-type]


def _frames_at(count: int, frame_s: float, rate: float | None) -> NDArray[np.intp]:
    """Return the indices of the frames nearest in time to samples at ``rate`` per second."""
    if rate is None:
        return np.arange(count)
    wanted = int((count - 1) * frame_s * rate + 1e-6) + 1
    if wanted > _MAX_SKELETONS:
        raise InputError(f"rate: expected at most {_MAX_SKELETONS} skeletons, got {wanted}")
    nearest = np.rint(np.arange(wanted) / (rate * frame_s)).astype(np.intp)
    return np.asarray(np.minimum(nearest, count - 1))


def _columns(names: Sequence[str]) -> tuple[str, list[int | None]]:
    """Return a file's naming convention and each joint's column; None: joint not in the file."""
    plain = {name.rpartition(":")[2].lower(): column for column, name in enumerate(names)}
    if all(joint.lower() in plain for joint in JOINTS):
        return "kinect-v2", [plain[joint.lower()] for joint in JOINTS]
    for layout, joints in _layouts().items():
        found = {
            joint: next((plain[n.lower()] for n in words if n.lower() in plain), None)
            for joint, words in joints.items()
        }
        if all(column is not None for joint, column in found.items() if joint not in _OPTIONAL):
            return layout, [found[joint] for joint in joint_layouts()["kinect-v1"]]
    known = "Kinect's, Carnegie Mellon's or Mixamo's, Biovision's or Poser's"
    shown = ", ".join(names[:8]) + (", ..." if len(names) > 8 else "")
    raise InputError(f"motion: expected names of joints such as {known}, got {shown}")


def _joint(places: NDArray[np.float64], names: Sequence[str], name: str) -> NDArray[np.float64]:
    return np.asarray(places[..., names.index(name), :])


def _unit(places: NDArray[np.float64], names: Sequence[str]) -> float:
    """Return the metres per unit that bring the length of the legs nearest to an adult's."""
    length = 0.0
    for side in ("Left", "Right"):
        hip, knee, ankle = (_joint(places, names, f"{part}{side}") for part in _LEG_PARTS)
        length += 0.5 * float(np.linalg.norm([knee - hip, ankle - knee], axis=1).sum())
    if not length > 0.0:
        raise InputError("motion: expected legs that have a length, to tell the unit by")
    return min(_UNITS, key=lambda unit: abs(np.log(length * unit / _LEG)))


_LEG_PARTS = ("Hip", "Knee", "Ankle")


def _before_the_camera(places: NDArray[np.float64], names: Sequence[str]) -> NDArray[np.float64]:
    """Convert metres, y up, to camera axes; the person faces the camera in the first frame."""
    first = places[0]
    left = sum(
        _joint(first, names, f"{part}Left") - _joint(first, names, f"{part}Right")
        for part in ("Shoulder", "Hip")
    )
    base = _joint(first, names, "SpineBase" if "SpineBase" in names else "HipCenter")
    across = np.array([left[0], 0.0, left[2]])  # type: ignore[index]
    length = float(np.linalg.norm(across, axis=-1))
    cosine, sine = (across[0] / length, across[2] / length) if length > 1e-9 else (1.0, 0.0)
    # A rotation about y brings the person's left to +x; half a turn about x makes y point down and
    # z ahead.
    turn = np.array([[cosine, 0.0, sine], [0.0, -1.0, 0.0], [sine, 0.0, -cosine]])
    moved = np.einsum("ij,tkj->tki", turn, places - base)
    return np.asarray(moved + np.array([0.0, 0.0, _AWAY]))
