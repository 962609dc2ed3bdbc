"""Points of scans, depth images and RGB-D frames for the viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.camera import Intrinsics, Registration
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame
from manip3d.rgbd import INFERRED, NO_BODY, PARENTS, RgbdFrame, Skeleton
from manip3d.viewer.points import (
    PALETTE,
    QUIET,
    SCAN_SPREAD,
    Classes,
    Colors,
    DrawnPoints,
    Lines,
    Scale,
    box_lines,
    least_width,
    overviews,
)
from manip3d.viewer.scene import Pose, Rgb

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.viewer.points import Column
    from manip3d.viewer.scene import Image

    Bytes = NDArray[np.uint8]

__all__ = ["DepthImage", "depth_points", "rgbd_points", "scan_points", "skeleton_lines"]

BONE: Rgb = (230, 60, 40)
GUESSED: Rgb = (240, 160, 40)

KINECT_FOCAL = 525.0 / 640.0  # focal length of a Kinect V1 divided by its image's width
FULL_COLORS = 65535.0  # LAS and E57 store colours in 16 bits


# --- scans --------------------------------------------------------------------------------------


@checked
def scan_points(
    frame: LidarFrame,
    *,
    boxes: Sequence[Box] | Mapping[str, Sequence[Box]] = (),
    classes: Classes | None = None,
) -> DrawnPoints:
    """Return a scan's points, coloured by height and, if available, intensity, ring and colour.

    Parameters
    ----------
    frame : LidarFrame
        The scan. Points at exactly (0, 0, 0), which mean no return, are left out.
    boxes : sequence of Box, or mapping of str to sequence of Box
        Same as for `box_lines`.
    classes : Classes, optional
        Class of each point of the frame, which is shown first.

    Returns
    -------
    DrawnPoints

    Raises
    ------
    InputError
        ``boxes`` or ``classes`` has a wrong type.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, viewer
    >>> scan = LidarFrame(np.mgrid[0:5, 0:2, 0:1].reshape(3, -1).T, ring=np.arange(10) % 2)
    >>> cloud = viewer.scan_points(scan)
    >>> cloud.detail, [column.name for column in cloud.columns]
    ('9 points, 1 without return', ['height', 'ring'])
    """
    returned = np.flatnonzero(frame.points.any(axis=1))
    points = frame.points[returned]
    columns: list[Column] = [] if classes is None else [classes.select(returned)]
    colors = _stored_colors(frame)
    if colors is not None:
        columns.append(Colors("colour", colors[returned]))
    columns.append(Scale("height", points[:, 2], "m"))
    for name, values in (("intensity", frame.intensity), ("ring", frame.ring)):
        if values is not None and len(points) and np.ptp(values[returned]) > 0:
            columns.append(Scale(name, values[returned], limits=_ring_limits(name, values)))
    empty = frame.num_points - len(points)
    detail = f"{len(points):,} points"
    return DrawnPoints(
        points,
        tuple(columns),
        box_lines(boxes),
        overviews(points, frame.origin, "z"),
        "z",
        frame.origin,
        SCAN_SPREAD if frame.origin is not None else 0.0,
        least_width(points) if frame.origin is None else 0.2 * least_width(points),
        detail=f"{detail}, {empty:,} without return" if empty else detail,
    )


def _ring_limits(name: str, values: NDArray[Any]) -> tuple[float, float] | None:
    return (float(values.min()), float(values.max())) if name == "ring" else None


def _stored_colors(frame: LidarFrame) -> Image | None:
    """Return (N, 3) uint8, the file's red, green and blue; None: the file has no colours."""
    for names in (("red", "green", "blue"), ("colorRed", "colorGreen", "colorBlue")):
        if all(name in frame.fields for name in names):
            stored = np.column_stack([frame.fields[name] for name in names])
            scaled = np.clip(np.rint(stored * (255.0 / _full_color(stored))), 0, 255)
            return scaled.astype(np.uint8)
    return None


def _full_color(stored: NDArray[Any]) -> float:
    """Return the value of full brightness of stored colours: 1 (fractions), 255 or 65535."""
    highest = stored.max(initial=0)
    if stored.dtype.kind == "f" and highest <= 1.0:
        return 1.0
    return 255.0 if highest <= 255 else FULL_COLORS


# --- depth images and RGB-D frames ---------------------------------------------------------------


def camera_poses(camera: Intrinsics, middle: float) -> tuple[Pose, ...]:
    """Return the pose of the camera, and poses that view its image obliquely.

    Parameters
    ----------
    camera : Intrinsics
    middle : float, metres
        Typical depth of the image.
    """
    tall = camera.height / abs(camera.fy)
    wide = camera.width / abs(camera.fx)
    # The middle of the image, which can differ from the principal point.
    pixel = (0.5 * (camera.width - 1), 0.5 * (camera.height - 1))
    target = camera.unproject(middle, pixels=pixel)
    if not np.isfinite(target).all():  # a table of rays may have no ray at this pixel
        target = np.array([0.0, 0.0, middle])
    angle = 2.0 * float(np.degrees(np.arctan(0.5 * tall)))
    shape = wide / tall
    side = middle * np.array([-0.75, -0.25, 0.15])
    return (
        Pose("Camera", np.zeros(3), target, "-y", angle, shape),
        Pose("Side", side, target, "-y", angle, shape),
        Pose("Above", middle * np.array([0.0, -1.2, 0.35]), target, "-y", angle, shape),
    )


@dataclass(frozen=True, eq=False)
class DepthImage(Showable):
    """A depth image to show, with its camera if known.

    Attributes
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        0 and NaN mean no measurement.
    intrinsics : Intrinsics, optional
        The camera. Default: a camera with the field of view of a Kinect V1.
    color : (H, W, 3) uint8, optional
        Colours of the same pixels.
    """

    depth: NDArray[Any]
    intrinsics: Intrinsics | None = None
    color: NDArray[np.uint8] | None = None

    @property
    def camera(self) -> Intrinsics:
        """The camera, or the assumed one."""
        if self.intrinsics is not None:
            return self.intrinsics
        height, width = self.depth.shape
        focal = KINECT_FOCAL * max(width, height)
        return Intrinsics(width, height, focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    @property
    def note(self) -> str:
        """Sentence about assumptions; empty: there were none."""
        if self.intrinsics is not None:
            return ""
        return f"camera assumed: focal length {self.camera.fx:.0f} pixels"

    def drawn(self) -> DrawnPoints:
        """Return the points of the image, first seen from its camera."""
        cloud = depth_points(self.depth, self.camera, color=self.color)
        return replace(cloud, detail=", ".join(filter(None, (cloud.detail, self.note))))

    def __repr__(self) -> str:
        height, width = self.depth.shape
        return f"<manip3d.viewer.DepthImage: {width} x {height} pixels, {self.depth.dtype}>"


@checked
def depth_points(
    depth: NDArray[Any],
    intrinsics: Intrinsics,
    *,
    color: NDArray[np.uint8] | None = None,
    registration: Registration | None = None,
) -> DrawnPoints:
    """Return the points of a depth image, first seen from its camera.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
        0 and NaN mean no measurement.
    intrinsics : Intrinsics
    color : (H', W', 3) uint8, optional
        Colour image with the depth image's pixels, or from the colour camera of ``registration``.
    registration : Registration, optional
        Colour camera, and its pose relative to the depth camera.

    Returns
    -------
    DrawnPoints
        A point for each pixel with a measurement.

    Raises
    ------
    InputError
        The shape of an image differs from its camera's size.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, viewer
    >>> camera = Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48)
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> depth[:, :10] = 0  # nothing was measured there
    >>> cloud = viewer.depth_points(depth, camera)
    >>> cloud.detail, [column.name for column in cloud.columns]
    ('2,592 points', ['depth'])
    """
    cloud, _ = _depth_points(depth, intrinsics, color, registration)
    return cloud


def _depth_points(
    depth: NDArray[Any],
    intrinsics: Intrinsics,
    color: NDArray[np.uint8] | None,
    registration: Registration | None,
) -> tuple[DrawnPoints, NDArray[np.intp]]:
    """Return the points of a depth image, and the number of each point's pixel, row by row."""
    if depth.shape != (intrinsics.height, intrinsics.width):
        raise InputError(
            f"depth: expected shape ({intrinsics.height}, {intrinsics.width}) as the intrinsics "
            f"say, got {depth.shape}"
        )
    grid, valid, _ = _core.unproject(np.ascontiguousarray(depth), intrinsics, threads_of(0))
    seen = np.flatnonzero(np.asarray(valid).ravel())
    points = np.asarray(grid).reshape(-1, 3)[seen]
    columns: list[Column] = []
    if color is not None:
        columns.append(Colors("colour", _pixel_colors(color, points, seen, depth, registration)))
    columns.append(Scale("depth", points[:, 2], "m"))
    middle = float(np.median(points[:, 2])) if len(points) else 1.0
    cloud = DrawnPoints(
        points,
        tuple(columns),
        poses=camera_poses(intrinsics, middle),
        up="-y",
        origin=(0.0, 0.0, 0.0),
        spread=1.3 / abs(intrinsics.fx),  # without gaps on surfaces that face the camera
        detail=f"{len(points):,} points",
    )
    return cloud, seen


def _pixel_colors(
    color: NDArray[np.uint8],
    points: NDArray[np.float32],
    seen: NDArray[np.intp],
    depth: NDArray[Any],
    registration: Registration | None,
) -> Image:
    if registration is None:
        if color.shape[:2] != depth.shape:
            raise InputError(
                f"color: expected the depth image's {depth.shape} pixels, got {color.shape[:2]}"
            )
        return np.ascontiguousarray(color[..., :3].reshape(-1, 3)[seen])
    texcoords = _core.registered_texcoords(np.ascontiguousarray(points, np.float32), registration)
    height, width = color.shape[:2]
    known = np.isfinite(texcoords[:, 0])
    at = np.where(known[:, None], texcoords, np.float32(0.0))
    column = np.clip((at[:, 0] * width).astype(np.int64), 0, width - 1)
    row = np.clip(((1.0 - at[:, 1]) * height).astype(np.int64), 0, height - 1)
    return np.where(known[:, None], color[row, column, :3], np.array(QUIET, np.uint8))


@checked
def rgbd_points(frame: RgbdFrame) -> DrawnPoints:
    """Return an RGB-D frame's points, coloured by colour, depth or person, and people's bones.

    Parameters
    ----------
    frame : RgbdFrame

    Returns
    -------
    DrawnPoints

    Raises
    ------
    InputError
        ``frame`` is not an RGB-D frame.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, Skeleton, viewer
    >>> camera = Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48)
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> depth[:, :10] = 0  # nothing was measured there
    >>> person = Skeleton(np.full((25, 3), 2.0))
    >>> frame = RgbdFrame(depth, RgbdCalibration(camera), skeletons=(person,))
    >>> viewer.rgbd_points(frame).detail
    '2,592 points, 1 skeleton'
    """
    calibration = frame.calibration
    cloud, seen = _depth_points(
        frame.depth, calibration.depth, frame.color, calibration.registration
    )
    columns = cloud.columns
    if frame.body_index is not None and (frame.body_index != NO_BODY).any():
        columns = (*columns, _people(frame.body_index.ravel()[seen]))
    lines = skeleton_lines(frame.skeletons)
    poses = cloud.poses
    told = [cloud.detail] if cloud.num_points else []
    if frame.skeletons:
        told.append(counted(len(frame.skeletons), "skeleton"))
    if lines and not cloud.num_points:  # only the bones tell the distance of people
        middle = float(np.median(np.concatenate([line.ends for line in lines])[..., 2]))
        poses = camera_poses(calibration.depth, middle)
        columns = ()
    return replace(cloud, columns=columns, lines=lines, poses=poses, detail=", ".join(told))


def _people(bodies: Bytes) -> Classes:
    """Return the person of each point; ``bodies`` are the points' values of the body index."""
    numbers, values = np.unique(bodies, return_inverse=True)
    labels = ["nobody" if n == NO_BODY else f"person {n}" for n in numbers]
    palette = [QUIET if n == NO_BODY else PALETTE[i % len(PALETTE)] for i, n in enumerate(numbers)]
    return Classes("person", values.astype(np.uint8), labels, palette)


@checked
def skeleton_lines(skeletons: Sequence[Skeleton]) -> tuple[Lines, ...]:
    """Return the bones of people: bones between tracked joints, and bones with an inferred end.

    Parameters
    ----------
    skeletons : sequence of Skeleton

    Returns
    -------
    tuple of Lines
        At most two groups, ``bones`` and ``inferred bones``; bones with an end that is not tracked
        are left out.

    Raises
    ------
    InputError
        An item of ``skeletons`` is not a skeleton.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Skeleton, viewer
    >>> states = np.full(25, 2)
    >>> states[6] = 1  # the left wrist is guessed
    >>> lines = viewer.skeleton_lines([Skeleton(np.full((25, 3), 2.0), states=states)])
    >>> [(line.name, len(line.ends)) for line in lines]
    [('bones', 21), ('inferred bones', 3)]
    """
    bones = np.array([(parent, joint) for joint, parent in enumerate(PARENTS) if joint != parent])
    sure, guessed = np.empty((0, 2, 3)), np.empty((0, 2, 3))
    for skeleton in skeletons:
        states = skeleton.states[bones].min(axis=1)
        ends = skeleton.positions[bones].astype(np.float64)
        known = np.isfinite(ends).all(axis=(1, 2))
        states, ends = states[known], ends[known]
        sure = np.concatenate([sure, ends[states > INFERRED]])
        guessed = np.concatenate([guessed, ends[states == INFERRED]])
    groups = (("bones", sure, BONE), ("inferred bones", guessed, GUESSED))
    return tuple(
        Lines(name, ends, color, in_front=True) for name, ends, color in groups if len(ends)
    )
