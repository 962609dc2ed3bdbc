"""Skeletons for sensors that deliver none: MediaPipe's landmarks, lifted to 3D by depth."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.closing import Closing
from manip3d._util.extras import imported
from manip3d._util.linear import product
from manip3d.errors import InputError
from manip3d.modify._joints import JointLayout, joint_layouts, skeleton_from
from manip3d.rgbd import (
    INFERRED,
    NO_BODY,
    NOT_TRACKED,
    TRACKED,
    RgbdCalibration,
    RgbdFrame,
    Skeleton,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

_RADIUS = {  # metres from the visible skin to the joint inside, for an adult
    "Nose": 0.10,
    "Shoulder": 0.06,
    "Elbow": 0.04,
    "Wrist": 0.025,
    "Pinky": 0.015,
    "Index": 0.015,
    "Thumb": 0.015,
    "Middle": 0.015,
    "Ring": 0.015,
    "Hip": 0.10,
    "Knee": 0.06,
    "Ankle": 0.04,
    "Heel": 0.03,
    "FootIndex": 0.03,
    "BigToe": 0.03,
    "SmallToe": 0.03,
}

_REACH = 1.2
"""Largest distance in metres, along the camera's axis, of a joint from most of the person's joints:
that of the toes of a tall person who sits with the legs towards the camera."""


@checked
def lift_landmarks(
    pixels: ArrayLike,
    visibility: ArrayLike,
    relative_depth: ArrayLike,
    frame: RgbdFrame,
    *,
    window: int = 5,
    min_visibility: float = 0.5,
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Lift MediaPipe's landmarks from the image to 3D joints by the depth at their pixels.

    Parameters
    ----------
    pixels : (33, 2)
        Column and row of each landmark in the depth image.
    visibility : (33,)
        MediaPipe's estimate, 0 to 1, that nothing hides the landmark.
    relative_depth : (33,), metres
        Position along the camera's axis, from any common origin (in MediaPipe's world landmarks,
        the hips); NaN: unknown.
    frame : RgbdFrame
        Frame with depth. If it has a ``body_index``, only depths of people's pixels are used.
    window : int, pixels
        Side of the square around a landmark over which the median depth is taken; odd.
    min_visibility : float
        Landmarks with a lower visibility are `INFERRED`.

    Returns
    -------
    positions : (33, 3) float64, metres
        Camera axes: x right, y down, z ahead.
    states : (33,) uint8
        `TRACKED`: visible and with depth. `INFERRED`: hidden or without depth; its distance is the
        tracked landmarks' median offset from ``relative_depth``. `NOT_TRACKED`: outside the
        picture, without any distance, or nothing is tracked.

    Raises
    ------
    InputError
        Wrong shapes, or an even window.

    Notes
    -----
    A depth image shows the skin, and joints lie below it. Each joint is therefore moved along its
    line of sight by an adult's distance from skin to joint (6 cm at shoulder and knee, 10 cm at the
    hip, 2.5 cm at the wrist, ...).

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, modify
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> frame = RgbdFrame(np.full((48, 64), 2000, np.uint16), camera)
    >>> pixels = np.tile([31.5, 23.5], (33, 1))
    >>> pixels[1] = 99  # outside
    >>> positions, states = modify.lift_landmarks(pixels, np.ones(33), np.zeros(33), frame)
    >>> positions[0].round(2).tolist(), states[:2].tolist()
    ([0.0, 0.0, 2.1], [2, 0])
    """
    at = np.asarray(pixels, np.float64)
    visible = np.asarray(visibility, np.float64)
    relative = np.asarray(relative_depth, np.float64)
    names = joint_layouts()["mediapipe"]
    if at.shape != (len(names), 2) or not visible.shape == relative.shape == (len(names),):
        raise InputError(
            "pixels, visibility, relative_depth: expected shapes (33, 2), (33,), (33,), got "
            f"{at.shape}, {visible.shape}, {relative.shape}"
        )
    if window < 1 or window % 2 == 0:
        raise InputError(f"window: expected an odd number of pixels, got {window}")
    sight, inner, inside = _measured(at, names, frame, window)
    tracked = inside & (inner > 0) & (visible >= min_visibility)
    if not tracked.any():
        return np.zeros((33, 3)), np.zeros(33, np.uint8)
    is_known = np.isfinite(relative)
    told = tracked & is_known
    guess = relative + np.median(inner[told] - relative[told]) if told.any() else np.zeros(33)
    inferred = inside & is_known & told.any()
    states = np.where(tracked, TRACKED, np.where(inferred, INFERRED, NOT_TRACKED)).astype(np.uint8)
    distance = np.where(tracked, inner, np.where(is_known, guess, 0.0))
    return sight * distance[:, None], states


def _measured(
    at: NDArray[np.float64], names: Sequence[str], frame: RgbdFrame, window: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return each joint's line of sight (x/z, y/z, 1), its distance along z, and if it is inside.

    The distance is that of the skin, and the joint's distance from it; 0: there is no depth.
    """
    camera = frame.calibration.depth
    parts = (name.removesuffix("Left").removesuffix("Right").rstrip("1234") for name in names)
    radius = np.array([_RADIUS.get(part, 0.0) for part in parts])
    size = np.array([camera.width, camera.height])
    inside = np.all((at > -0.5) & (at < size - 0.5), axis=1)
    depth = _median_depth(np.where(inside[:, None], at, 0.0), frame, window)
    # The line of sight is (x/z, y/z, 1). A joint lies its radius farther along it than the skin.
    sight = camera.unproject(1.0, pixels=at)
    inside &= np.isfinite(sight).all(axis=1)
    sight = np.where(inside[:, None], sight, (0.0, 0.0, 1.0))
    inner = np.where(depth > 0, depth + radius / np.linalg.norm(sight, axis=1), 0.0)
    return sight, inner, inside


def lifted_joints(
    frame: RgbdFrame,
    under: RgbdFrame,
    pixels: NDArray[np.float64],
    confidence: NDArray[np.float64],
    layout: JointLayout,
    *,
    id: int,
    window: int = 5,
    min_confidence: float = 0.5,
) -> Skeleton | None:
    """Lift joints (J, 2) in pixels of the colour image to a skeleton, or return None.

    ``under`` is `depth_under_color` of the frame; without a colour image, the pixels are those of
    the depth image. Joints of confidence 0, outside of the image or without depth are not tracked,
    nor are those whose pixel shows something else, as its distance tells; those below
    ``min_confidence`` are inferred. None: no joint is tracked.
    """
    color = frame.color.shape[:2] if frame.color is not None else under.depth.shape
    scale = np.array(under.depth.shape[::-1]) / np.array(color[::-1])
    at = (pixels + 0.5) * scale - 0.5
    sight, inner, inside = _measured(at, joint_layouts()[layout], under, window)
    is_found = inside & (inner > 0) & (confidence > 0)
    if is_found.any():
        is_found &= np.abs(inner - np.median(inner[is_found])) <= _REACH
    is_sure = is_found & (confidence >= min_confidence)
    states = np.where(is_sure, TRACKED, np.where(is_found, INFERRED, NOT_TRACKED)).astype(np.uint8)
    if not is_sure.any():
        return None
    return _in_depth_camera(frame, under, sight * inner[:, None], states, layout, id)


def _in_depth_camera(
    frame: RgbdFrame,
    under: RgbdFrame,
    positions: NDArray[np.float64],
    states: NDArray[np.uint8],
    layout: JointLayout,
    id: int = 0,
) -> Skeleton:
    """Return the skeleton of joints in the axes of the camera of `depth_under_color`."""
    body = body_under(positions, states, under)
    registration = frame.calibration.registration
    if registration is not None and under is not frame:
        back = product(positions - registration.translation, registration.rotation)
        positions = np.where(states[:, None] != NOT_TRACKED, back, 0.0)
    return skeleton_from(positions, states, layout=layout, id=id, body=body)


def _median_depth(
    pixels: NDArray[np.float64], frame: RgbdFrame, window: int
) -> NDArray[np.float64]:
    """Return the median depth of people's pixels around each pixel, metres; 0: no depth there."""
    reach = np.arange(window) - window // 2
    column, row = np.rint(pixels).astype(np.intp).T
    height, width = frame.depth.shape
    rows = row[:, None, None] + reach[:, None]
    columns = column[:, None, None] + reach
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    where = np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)
    valid = inside & (frame.depth[where] > 0)
    if frame.body_index is not None:
        valid &= frame.body_index[where] != NO_BODY
    values = np.where(valid, frame.depth[where], np.inf).reshape(len(pixels), -1)
    values.sort(axis=1)
    count = valid.reshape(len(pixels), -1).sum(axis=1)
    middle = values[np.arange(len(pixels)), np.maximum(count - 1, 0) // 2]
    return np.where(count > 0, middle / 1000.0, 0.0)


@checked
class PoseTracker(Closing):
    """Finds one person's skeleton in frames with colour, by MediaPipe's 33 landmarks.

    The landmarks are lifted to 3D by depth and converted to the Kinect V2's 25 joints. The colour
    image may have the depth image's pixels or, with ``calibration.registration``, a camera of its
    own; in the second case the depth image is first reprojected into that camera. Call `close`, or
    use the tracker in a ``with`` statement.

    Parameters
    ----------
    static : bool
        The frames are unrelated pictures, and no person is tracked from one to the next.
    min_confidence : float
        Smallest confidence of MediaPipe's detector and tracker, 0 to 1.
    min_visibility : float
        Landmarks with a lower visibility are `INFERRED`, as for `lift_landmarks`.

    Raises
    ------
    MissingExtraError
        MediaPipe is not installed: ``pip install 'manip3d[pose]'``.
    InputError
        An option out of range.

    Notes
    -----
    The model (BlazePose, Bazarevsky et al. 2020) comes with MediaPipe 0.10.21, which requires
    numpy < 2. MediaPipe writes a few log lines to the standard error output.
    """

    def __init__(
        self, *, static: bool = False, min_confidence: float = 0.5, min_visibility: float = 0.5
    ) -> None:
        for name, value in (("confidence", min_confidence), ("visibility", min_visibility)):
            if not 0 <= value <= 1:
                raise InputError(f"min_{name}: expected 0 to 1, got {value}")
        self._min_visibility = min_visibility
        self._options = {
            "static_image_mode": static,
            "min_detection_confidence": min_confidence,
            "min_tracking_confidence": min_confidence,
        }
        self._is_closed = False
        self._pose: Any = self._start()

    def _start(self) -> Any:
        return imported("mediapipe.python.solutions.pose", "pose").Pose(**self._options)

    def find(self, frame: RgbdFrame) -> Skeleton | None:
        """Find the person's skeleton.

        Parameters
        ----------
        frame : RgbdFrame
            Frame with colour, in the depth image's pixels or those of ``calibration.registration``.

        Returns
        -------
        Skeleton or None
            None: no person is found, or none of the person's landmarks has depth.

        Raises
        ------
        InputError
            The frame has no colour, or the tracker was closed.
        """
        if self._is_closed:
            raise InputError("the pose tracker was closed")
        if frame.color is None:
            raise InputError("frame.color: expected a colour image, got None")
        landmarks = self._pose.process(frame.color)
        if landmarks.pose_landmarks is None:
            return None
        under = depth_under_color(frame)
        height, width = under.depth.shape
        in_picture = landmarks.pose_landmarks.landmark
        positions, states = lift_landmarks(
            [(mark.x * width - 0.5, mark.y * height - 0.5) for mark in in_picture],
            [mark.visibility for mark in in_picture],
            [mark.z for mark in landmarks.pose_world_landmarks.landmark],
            under,
            min_visibility=self._min_visibility,
        )
        if not (states == TRACKED).any():
            return None
        return _in_depth_camera(frame, under, positions, states, "mediapipe")

    def annotate(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame with the found skeleton as its only one.

        Parameters
        ----------
        frame : RgbdFrame
            Frame with colour, in the depth image's pixels or those of ``calibration.registration``.

        Returns
        -------
        RgbdFrame
            The frame has no skeleton if nobody is found.
        """
        skeleton = self.find(frame)
        return replace(frame, skeletons=() if skeleton is None else (skeleton,))

    def reset(self) -> None:
        """Discard what was tracked in the frames so far."""
        self._pose.reset()

    def close(self) -> None:
        """Free the model; may be called twice."""
        if not self._is_closed:
            self._is_closed = True
            self._pose.close()


def depth_under_color(frame: RgbdFrame) -> RgbdFrame:
    """Reproject depth and body index into the colour camera, at the depth camera's pixel size.

    If several points fall into one pixel, the nearest to the colour camera is kept. Without a
    registration the frame is returned unchanged, because its colour image already has the depth
    image's pixels.
    """
    registration = frame.calibration.registration
    if registration is None:
        return frame
    camera = frame.calibration.depth
    share = min(1.0, camera.fx / registration.color.fx)
    width, height = (
        max(1, round(share * side))
        for side in (registration.color.width, registration.color.height)
    )
    seen = registration.color.resized(width, height)
    points = camera.unproject(frame.depth)[frame.depth > 0].astype(np.float64)
    has_ray = np.isfinite(points).all(axis=1)
    points = product(points[has_ray], registration.rotation.T) + registration.translation
    at = seen.project(points)
    last = np.array([width, height]) - 0.5
    inside = (at >= -0.5).all(axis=1) & (at < last).all(axis=1)  # false for NaN
    column, row = np.rint(at[inside]).astype(np.intp).T
    millimetres = np.clip(np.rint(1000.0 * points[inside, 2]), 1, 65535).astype(np.uint16)
    # Sort from far to near, so that the nearest point of a pixel is written last.
    order = np.argsort(-millimetres.astype(np.int64), kind="stable")
    column, row = column[order], row[order]
    depth = np.zeros((height, width), np.uint16)
    depth[row, column] = millimetres[order]
    body = None
    if frame.body_index is not None:
        body = np.full((height, width), NO_BODY, np.uint8)
        body[row, column] = frame.body_index[frame.depth > 0][has_ray][inside][order]
    return RgbdFrame(depth, RgbdCalibration(seen), body_index=body)


def body_under(positions: NDArray[np.float64], states: NDArray[np.uint8], frame: RgbdFrame) -> int:
    """Return the value of the body index that most tracked joints lie on."""
    if frame.body_index is None or not (states == TRACKED).any():
        return NO_BODY
    camera = frame.calibration.depth
    pixels = np.rint(camera.project(positions[states == TRACKED]))
    pixels = pixels[np.isfinite(pixels).all(axis=1)]  # others are outside of a lens's reach
    if len(pixels) == 0:
        return NO_BODY
    last = camera.width - 1, camera.height - 1
    column, row = np.clip(pixels, 0, last).astype(np.intp).T
    return int(np.bincount(frame.body_index[row, column]).argmax())
