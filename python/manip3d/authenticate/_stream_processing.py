"""Recognise processing of all depth images: cropped, rounded, coded, filtered, resampled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._stream_frames import MIN_PAIRS, changed_shares, following, whole_pairs
from manip3d.authenticate._verdict import Processing
from manip3d.rgbd import RgbdFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics

    Depth = NDArray[np.uint16]

_MAX_TINY = 5e-4  # largest share of pixels nearer than any camera measures
# largest distance of the optical axis from the middle, as a share of the image's side
_MAX_OFF_CENTRE = 0.1

_AZURE_NARROW = {(640, 576), (320, 288)}
"""Image sizes of the Azure Kinect's narrow field of view, which is not centred on the sensor."""

_MAX_OFF_CENTRE_AZURE = 0.15  # the recorded device has 0.11
_MIN_VIEW_DEG = 50.0  # along the longer side; the narrowest recorded camera has 57
_SIZES = {
    (160, 120), (320, 240), (640, 480), (512, 424), (1280, 720), (848, 480), (640, 360),
    (480, 270), (424, 240), (1280, 800), (640, 400), (640, 576), (320, 288), (512, 512),
    (1024, 1024), (1280, 1024), (1280, 960), (1920, 1080), (2048, 1536), (3840, 2160),
    (1024, 768), (256, 192), (256, 144), (672, 376), (2208, 1242), (224, 172), (2560, 1440),
    (1920, 1440),
}  # fmt: skip


def processing_of(frames: Sequence[RgbdFrame]) -> tuple[Processing, ...]:
    """The processing that all images went through."""
    found = []
    height, width = frames[0].depth.shape
    if (width, height) not in _SIZES and (height, width) not in _SIZES:
        detail = (
            f"{width} x {height} pixels are the size of no known camera: perhaps an unknown one"
        )
        found.append(Processing("cropped", detail))
    camera = frames[0].calibration.depth
    off = max(abs(camera.cx / width - 0.5), abs(camera.cy / height - 0.5))
    is_azure = not _AZURE_NARROW.isdisjoint({(width, height), (height, width)})
    if not found and off > (_MAX_OFF_CENTRE_AZURE if is_azure else _MAX_OFF_CENTRE):
        detail = f"the optical axis meets the image {off:.0%} of its side beside the middle"
        found.append(Processing("cropped", detail))
    view = _field_of_view(camera)
    if not found and view < _MIN_VIEW_DEG:
        detail = f"it shows {view:.0f} degrees of the scene, less than any known depth camera"
        found.append(Processing("cropped", detail))
    some = frames[:: max(1, len(frames) // 6)]
    values = np.unique(np.concatenate([np.unique(frame.depth) for frame in some]))
    values = values[values > 0]
    step = int(np.gcd.reduce(values)) if len(values) > 2 else 1
    if step > 1:
        found.append(Processing("rounded", f"all depths are multiples of {step} mm"))
    tiny = np.mean([np.mean((f.depth > 0) & (f.depth < _MIN_DEPTH)) for f in some])
    if tiny > _MAX_TINY:
        detail = f"{tiny:.2%} of the pixels are nearer than {_MIN_DEPTH} mm: holes were smeared"
        found.append(Processing("lossily coded", detail))
    if _is_held(frames):
        detail = f"no pixel changes by less than {_SMALL} mm from frame to frame, and many by more"
        found.append(Processing("filtered", detail))
    lost, gained, num_pairs = _lost_and_gained(frames)
    if num_pairs >= MIN_PAIRS and gained > _MIN_GAINED and lost < _MIN_LOST * gained:
        detail = f"{gained:.2%} of the pixels appear from frame to frame, {lost:.2%} disappear"
        found.append(Processing("filtered", f"{detail}: missing ones kept their depth"))
    doubled = max(float(np.mean([_doubled(image) for image in pair])) for pair in zip(
        *((f.depth, f.depth.T) for f in some), strict=True
    ))  # fmt: skip
    if doubled > _MAX_DOUBLED:
        found.append(Processing("resampled", f"{doubled:.0%} of neighbouring lines are the same"))
    return tuple(found)


def _field_of_view(camera: Intrinsics) -> float:
    """Field of view along the longer side of the image, degrees."""
    sides = ((camera.width, camera.fx), (camera.height, camera.fy))
    side, focal = max(sides, key=lambda each: each[0])
    return math.degrees(2.0 * math.atan(0.5 * side / abs(focal)))  # fy of renderings may be < 0


def _is_held(frames: Sequence[RgbdFrame]) -> bool:
    """Whether pixels keep their depth until it changes by much, as after a temporal filter.

    If neighbouring pixels of a camera differ by small amounts, its pixels also change by small
    amounts from frame to frame.
    """
    pairs = [(a.depth, b.depth) for a, b in following(frames)]
    over_time = np.array([_changes(a, b) for a, b in pairs[:: max(1, len(pairs) // 6)]])
    in_space = np.array([_changes(f.depth[:, 1:], f.depth[:, :-1]) for f in frames[::10]])
    if not len(over_time):
        return False
    (small, all_), (small_beside, all_beside) = over_time.sum(axis=0), in_space.sum(axis=0)
    is_much = all_ >= _MIN_CHANGED * over_time.shape[0] * frames[0].depth.size
    return bool(is_much and small < 0.02 * all_ and small_beside > 0.2 * all_beside)


def _changes(one: Depth, other: Depth) -> tuple[int, int]:
    """Number of pixels that differ by less than `_SMALL`, and by less than ten times `_SMALL`."""
    change = np.abs(one.astype(np.int32) - other)[(one > 0) & (other > 0)]
    change = change[(change > 0) & (change < 10 * _SMALL)]
    return int((change < _SMALL).sum()), len(change)


def _lost_and_gained(frames: Sequence[RgbdFrame]) -> tuple[float, float, int]:
    """Mean shares of pixels that disappear and appear between frames, and the number of pairs.

    A camera loses as many pixels as it gains, except at the borders of its field of view.
    """
    shares = np.array([changed_shares(a, b) for a, b in whole_pairs(frames)]).reshape(-1, 2)
    lost, gained = shares.mean(axis=0) if len(shares) else (0.0, 0.0)
    return float(lost), float(gained), len(shares)


# of the gained share; clean recordings with at least five pairs have 0.65 or more
_MIN_LOST = 0.2
_MIN_GAINED = 2e-4  # share of the pixels
_SMALL = 15  # mm
_MIN_CHANGED = 0.001  # share of the pixels that change from frame to frame
_MIN_DEPTH = 150  # mm; no depth camera measures nearer
_MAX_DOUBLED = 0.2  # share of equal neighbouring lines; a camera's noise makes lines differ


def _doubled(image: Depth) -> float:
    """Share of pairs of neighbouring rows with relief that are equal where both are measured."""
    above, below = image[:-1], image[1:]
    both = (above > 0) & (below > 0)
    num_both = both.sum(axis=1)
    differ = (both & (above != below)).sum(axis=1)
    relief = (both[:, 1:] & both[:, :-1] & (np.diff(above.astype(np.int32), axis=1) != 0)).sum(1)
    told = (num_both > 50) & (relief > 20)
    same = told & (differ <= 0.01 * num_both)
    return float(same.sum() / max(1, told.sum()))
