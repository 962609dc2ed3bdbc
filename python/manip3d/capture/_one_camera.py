"""Colour images resampled to the depth camera, for file layouts that describe one camera only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from manip3d._util.linear import product
from manip3d.rgbd import RgbdCalibration, RgbdFrame

_BEHIND = 0.03  # metres: 7 times the noise of a time-of-flight camera at 3 m


def with_one_camera(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame with the colour of each depth pixel, and only the depth camera.

    A pixel is black if its depth was not measured, if it lies outside the colour image, or if a
    nearer surface hides it from the colour camera, so that its colour is unknown.
    """
    registration = frame.calibration.registration
    if registration is None:
        return frame
    calibration = RgbdCalibration(frame.calibration.depth)
    if frame.color is None:
        return replace(frame, calibration=calibration)
    measured = frame.depth > 0
    points = product(calibration.depth.unproject(frame.depth)[measured], registration.rotation.T)
    points += registration.translation
    pixels = np.nan_to_num(registration.color.project(points), nan=-1.0)
    height, width = frame.color.shape[:2]
    u, v = np.clip(np.rint(pixels), -1, max(height, width)).astype(np.intp).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    u, v, z = u[inside], v[inside], points[inside, 2]
    # Cells of the colour image for the test of visibility, in pixels. Each is larger than the
    # spacing of projected depth pixels, so that it has one of every surface seen in it.
    cell = 1 + -(-width // frame.depth.shape[1])
    nearest = np.full((-(-height // cell), -(-width // cell)), np.inf)
    np.minimum.at(nearest, (v // cell, u // cell), z)
    shown = z <= nearest[v // cell, u // cell] + _BEHIND
    color = np.zeros((*frame.depth.shape, 3), np.uint8)
    rows, columns = (axis[inside][shown] for axis in np.nonzero(measured))
    color[rows, columns] = frame.color[v[shown], u[shown]]
    return replace(frame, color=color, calibration=calibration)
