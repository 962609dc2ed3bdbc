"""Recordings, backgrounds, forged streams and scores shared by the experiments of chapter 5."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import datasets

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.rgbd import RgbdFrame

ROLE = "simulated people, in the place of the published recordings"
NOTE = (
    "The published recordings (six people, four actions, three backgrounds, a Kinect V2) are not "
    "public; simulated people before a simulated Kinect V2 and other recordings stand in for them."
)
TURNING, KITCHEN = "person_turning", "scene_kitchen"
WALL_MM = 2600
"""Depth of the wall behind the turning person, millimetres."""

MARGIN = 20
"""Width in pixels of the border around the turning person that is also filled with the wall's
depth, because it contains the sensor's shadow."""


def scene(name: str) -> list[RgbdFrame]:
    """Return the frames of a recorded scene without people."""
    from manip3d.rgbd import RgbdCalibration, RgbdFrame

    frames = []
    for number in range(len(datasets.frame_names(name))):
        found = datasets.load_frame(name, number)
        depth = np.asarray(found.depth)
        if depth.dtype != np.uint16:
            depth = np.rint(np.nan_to_num(depth) * 1000.0).astype(np.uint16)
        image = np.asarray(depth, np.uint16)
        frames.append(RgbdFrame(image, RgbdCalibration(found.intrinsics), number=number))
    return frames


@cache
def turning() -> tuple[RgbdFrame, ...]:
    """Return the recording of the turning person."""
    return tuple(datasets.open_people(f"people:{TURNING}"))


def walls(margin: int = MARGIN) -> list[RgbdFrame]:
    """Return the frames of the turning person with the person replaced by a wall at 2.6 m."""
    from manip3d.rgbd import NO_BODY

    frames = []
    for frame in turning():
        person = grown(np.asarray(frame.body_index != NO_BODY), margin)
        depth = np.where(person, np.uint16(WALL_MM), frame.depth)
        nobody = np.full_like(depth, NO_BODY, dtype=np.uint8)
        frames.append(replace(frame, depth=depth, body_index=nobody))
    return frames


def grown(mask: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Dilate a mask by ``pixels`` steps to the four neighbours."""
    grown = mask.copy()
    for _ in range(pixels):
        wider = grown.copy()
        wider[1:] |= grown[:-1]
        wider[:-1] |= grown[1:]
        wider[:, 1:] |= grown[:, :-1]
        wider[:, :-1] |= grown[:, 1:]
        grown = wider
    return grown


def pasted(frame: RgbdFrame, background: RgbdFrame) -> RgbdFrame:
    """Paste the person's pixels, with their holes, over a background, as in the published test."""
    from manip3d.rgbd import NO_BODY

    person = np.asarray(frame.body_index != NO_BODY)
    return replace(frame, depth=np.where(person, frame.depth, background.depth))


def windows(values: Sequence[float], size: int) -> list[float]:
    """Return the median of each window of ``size`` consecutive values."""
    data = np.asarray(values)
    return [float(np.median(data[i : i + size])) for i in range(len(data) - size + 1)]


def overlap(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Return the intersection over union of two masks."""
    return float((found & truth).sum() / max(1, (found | truth).sum()))


def runs(frames: Sequence[Any], size: int) -> Iterator[Sequence[Any]]:
    """Yield consecutive pieces of ``size`` frames."""
    for start in range(0, len(frames) - size + 1, size):
        yield frames[start : start + size]
