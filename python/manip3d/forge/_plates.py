"""Background plates: the scene behind the people of a recording."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.modify import segment_body
from manip3d.rgbd import NO_BODY, RgbdFrame, Skeleton, check_frames

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Mask = NDArray[np.bool_]

_EVERYBODY = 1  # label of all pixels of a person without a skeleton


@checked
def background_plate(frames: Iterable[RgbdFrame]) -> RgbdFrame:
    """Return the scene behind the people of a recording with a static camera.

    Each depth is the median of the frames in which no person covers the pixel; colour is that of
    the first such frame. A pixel that is always covered gets the depth and colour of the farther
    one of the nearest known pixels to the left and right in its row. Times, number and calibration
    are those of the first frame.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Frames with ``body_index`` or skeletons of people. Colour is kept if it is registered to the
        depth image.

    Returns
    -------
    RgbdFrame

    Raises
    ------
    InputError
        There is no frame; frames differ in size.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, forge
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> frames = []
    >>> for n in range(3):  # a person walks by
    ...     body = np.full((48, 64), 255, np.uint8)
    ...     body[10:, 20 * n : 20 * n + 10] = 0
    ...     depth = np.where(body == 0, 1500, 3000).astype(np.uint16)
    ...     frames.append(RgbdFrame(depth, camera, body_index=body, number=n))
    >>> plate = forge.background_plate(frames)
    >>> int(frames[0].depth.min()), int(plate.depth.min())
    (1500, 3000)
    """
    some = list(frames)
    check_frames("frames", some)
    if not some:
        raise InputError("frames: expected at least one, got none")
    if any(frame.depth.shape != some[0].depth.shape for frame in some):
        raise InputError("frames: expected images of one size")
    first = some[0]
    free = np.stack([_nobody(frame) for frame in some])
    depth = _median_seen(np.where(free, np.stack([frame.depth for frame in some]), 0))
    with_color = first.calibration.registration is None and all(f.color is not None for f in some)
    color = None
    if with_color:
        best = free.argmax(axis=0)  # the first frame in which no person is there
        colors = np.stack([frame.color for frame in some if frame.color is not None])
        chosen = np.take_along_axis(colors, best[None, ..., None], axis=0)[0]
        source = _nearest_seen(np.asarray(free.any(axis=0)), depth)
        color = np.ascontiguousarray(np.take_along_axis(chosen, source[..., None], axis=1))
    filled = np.take_along_axis(depth, _nearest_seen(np.asarray(depth > 0), depth), axis=1)
    # Pixels that most frames show without a person, but without a measurement, stay unmeasured.
    is_mostly_free = 2 * free.sum(axis=0) > len(some)
    depth = np.where((depth == 0) & is_mostly_free, np.uint16(0), filled)
    nobody = np.full(depth.shape, NO_BODY, np.uint8)
    calibration = first.calibration
    if not with_color and calibration.registration is not None:
        calibration = replace(calibration, registration=None)
    return replace(
        first, depth=depth, color=color, body_index=nobody, skeletons=(), calibration=calibration
    )


_MARGIN = 3
"""Pixels: margin around people in which pixels may still show them, because depth is missing there
and colours blur across the silhouette."""


def _nobody(frame: RgbdFrame) -> Mask:
    """Pixels that certainly show the scene: no person is within `_MARGIN` of them."""
    if frame.body_index is not None:
        somebody = np.asarray(frame.body_index != NO_BODY)
    else:  # pixels around the skeletons
        somebody = np.zeros(frame.depth.shape, np.bool_)
        for person in frame.skeletons:
            somebody |= labels_of(frame, person) > 0
    for axis in (0, 1):
        padding = [(_MARGIN, _MARGIN) if a == axis else (0, 0) for a in (0, 1)]
        windows = sliding_window_view(np.pad(somebody, padding), 2 * _MARGIN + 1, axis)
        somebody = np.asarray(windows.any(axis=-1))
    return ~somebody


def _median_seen(depths: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """The lower median over time of the measured depths; 0 if there are none."""
    ordered = np.sort(depths, axis=0)
    num_seen = (depths > 0).sum(axis=0)
    at = len(depths) - num_seen + np.maximum(num_seen - 1, 0) // 2
    middle = np.take_along_axis(ordered, np.minimum(at, len(depths) - 1)[None], axis=0)[0]
    return np.where(num_seen > 0, middle, 0).astype(np.uint16)


def _nearest_seen(seen: Mask, depth: NDArray[np.uint16]) -> NDArray[np.intp]:
    """For each pixel its own column if seen, else that of the farther nearest seen neighbour."""
    column = np.arange(seen.shape[1])
    left = np.maximum.accumulate(np.where(seen, column, -1), axis=1)
    right = np.minimum.accumulate(np.where(seen, column, len(column))[:, ::-1], axis=1)[:, ::-1]
    has_left, has_right = left >= 0, right < len(column)
    left, right = np.maximum(left, 0), np.minimum(right, len(column) - 1)
    farther = np.take_along_axis(depth, left, 1) >= np.take_along_axis(depth, right, 1)
    take_left = has_left & (farther | ~has_right)
    return np.where(seen | ~(has_left | has_right), column, np.where(take_left, left, right))


@checked
def without_people(frame: RgbdFrame, plate: RgbdFrame) -> RgbdFrame:
    """Return a frame whose people are replaced by the scene behind them.

    Parameters
    ----------
    frame : RgbdFrame
        Frame with ``body_index`` or skeletons; without them nothing is replaced.
    plate : RgbdFrame
        The scene from `background_plate`, of the same camera and size.

    Returns
    -------
    RgbdFrame
        The frame without people, also without skeletons. It has no colour if the plate has none, or
        if colour is not registered to the depth image, since people would stay in it.

    Raises
    ------
    InputError
        The two differ in size.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, forge
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> frames = []
    >>> for n in range(3):  # a person walks by
    ...     body = np.full((48, 64), 255, np.uint8)
    ...     body[10:, 20 * n : 20 * n + 10] = 0
    ...     depth = np.where(body == 0, 1500, 3000).astype(np.uint16)
    ...     frames.append(RgbdFrame(depth, camera, body_index=body, number=n))
    >>> plate = forge.background_plate(frames)
    >>> empty = forge.without_people(frames[1], plate)
    >>> int(frames[1].depth.min()), int(empty.depth.min())
    (1500, 3000)
    """
    if frame.depth.shape != plate.depth.shape:
        raise InputError("plate: expected the size of the frame")
    nobody = _nobody(frame)
    color = None
    aligned = frame.calibration.registration is None
    if frame.color is not None and plate.color is not None and aligned:
        color = np.where(nobody[..., None], frame.color, plate.color)
    return replace(
        frame,
        depth=np.where(nobody, frame.depth, plate.depth),
        color=color,
        body_index=np.full(nobody.shape, NO_BODY, np.uint8),
        skeletons=(),
        calibration=replace(frame.calibration, registration=None),
    )


def labels_of(frame: RgbdFrame, person: Skeleton | None) -> NDArray[np.uint8]:
    """Bone of each pixel of the person; without a skeleton, one label for all people."""
    if person is not None:
        found = segment_body(
            frame.depth,
            frame.calibration.depth,
            person,
            segmentation="region",
            body_index=frame.body_index,
        )
        return found.labels
    if frame.body_index is None:  # no person is known
        return np.zeros(frame.depth.shape, np.uint8)
    return np.where(frame.body_index != NO_BODY, np.uint8(_EVERYBODY), np.uint8(0))
