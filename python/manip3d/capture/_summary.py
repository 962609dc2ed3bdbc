"""Summary of a source: counts and times of its frames."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d._util.reprs import short_repr
from manip3d.camera import Intrinsics
from manip3d.capture._rgbd_source import RgbdSource
from manip3d.errors import InputError

if TYPE_CHECKING:
    from manip3d._util.options import Progress

LIVE_SECONDS = 2.0
"""Default time in seconds for which a live source is read."""


@dataclass(frozen=True, slots=True)
class SourceSummary:
    """Result of `summarize`.

    Attributes
    ----------
    source : str
        Address of the source.
    depth : Intrinsics
        Depth camera.
    color : Intrinsics or None
        Colour camera; None if the source states no separate one.
    num_frames, num_color, num_body_index, num_skeletons : int
        Number of all frames, and of those with a colour image, with a body index image, and with
        skeletons.
    range_m : (float, float) or None
        Smallest and largest depth, metres; None if no depth was measured.
    times_ns : (int, int) or None
        Times of the first and of the last frame, nanoseconds; None without a frame.
    frames_per_second : float or None
        Reciprocal of the median time step; None if there are fewer than two frames, or if that step
        is not above 0.
    longest_gap_s : float or None
        Longest time between two frames, seconds; None if there are fewer than two frames.
    num_missing : int
        Number of missing frames, by the gaps in the frames' numbers.
    counters : mapping of str to int
        Counters of the source: frames read, lost and refused.
    flipped : tuple of str
        Images, ``depth`` and ``color``, that are stored mirrored and flipped when they are read;
        by the calibration, so that ``color`` is named even if ``num_color`` is 0.
    assumed_rate : float or None
        Frames per second that are assumed because the source has no times; None if it has some.
    """

    source: str
    depth: Intrinsics
    color: Intrinsics | None
    num_frames: int
    num_color: int
    num_body_index: int
    num_skeletons: int
    range_m: tuple[float, float] | None
    times_ns: tuple[int, int] | None
    frames_per_second: float | None
    longest_gap_s: float | None
    num_missing: int
    counters: Mapping[str, int]
    flipped: tuple[str, ...] = ()
    assumed_rate: float | None = None

    __repr__ = short_repr

    def record(self) -> dict[str, Any]:
        """Return the summary as plain values that can be written as JSON.

        Returns
        -------
        dict
            Times end in ``_ns`` (nanoseconds) or are in seconds; ``range`` is in metres.
        """
        first, last = (None, None) if self.times_ns is None else self.times_ns
        return {
            "source": self.source,
            "depth": _camera(self.depth),
            "colour": None if self.color is None else _camera(self.color),
            "frames": self.num_frames,
            "with": {
                "colour": self.num_color,
                "body_index": self.num_body_index,
                "skeletons": self.num_skeletons,
            },
            "range": None if self.range_m is None else list(self.range_m),
            "first_time_ns": first,
            "last_time_ns": last,
            "seconds": None if first is None or last is None else (last - first) / 1e9,
            "frames_per_second": self.frames_per_second,
            "longest_gap": self.longest_gap_s,
            "missing_numbers": self.num_missing,
            "counters": dict(self.counters),
            "flipped": list(self.flipped),
            "assumed_rate": self.assumed_rate,
        }


def _camera(camera: Intrinsics) -> dict[str, Any]:
    return {
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": list(camera.distortion),
        "ray_table": camera.rays is not None,
    }


@checked
def summarize(
    source: RgbdSource, *, seconds: float = LIVE_SECONDS, progress: Progress = None
) -> SourceSummary:
    """Count and time the frames of a source.

    A recording is read to its end, without frames that cannot be read; `RgbdSource.errors` says
    which, and ``damaged`` of the counters how many. A source that may never end, for a given time.

    Parameters
    ----------
    source : RgbdSource
        A source opened by `open_rgbd`; it is closed afterwards.
    seconds : float
        Time for which a live source, or one without a known end such as an iterator, is read.
    progress : callable or bool, optional
        Called with the share of the frames that is done, if their number is known; True: a bar.

    Returns
    -------
    SourceSummary
        Counts, times and depth range of the frames that were read.

    Raises
    ------
    InputError
        ``seconds`` is not above 0.
    FormatError, OSError
        No frame of the recording can be read.

    Examples
    --------
    >>> from manip3d import capture
    >>> found = capture.summarize(capture.open_rgbd("sim:body?frames=3"))
    >>> found.num_frames, found.num_skeletons
    (3, 3)
    """
    if not (seconds > 0.0 and math.isfinite(seconds)):
        raise InputError(f"seconds: expected more than 0, got {seconds}")
    times: list[int] = []
    numbers: list[int] = []
    num_color = num_body_index = num_skeletons = 0
    nearest, farthest = math.inf, 0.0
    begin = time.monotonic()
    with source, reporting(progress, "read") as report:
        for frame in source._readable():
            times.append(frame.time_ns)
            numbers.append(frame.number)
            num_color += frame.color is not None
            num_body_index += frame.body_index is not None
            num_skeletons += bool(frame.skeletons)
            if (measured := frame.depth[frame.depth > 0]).size:
                nearest = min(nearest, measured.min() / 1000.0)
                farthest = max(farthest, measured.max() / 1000.0)
            if report is not None and source.num_frames:
                report(len(times) / source.num_frames)
            if not source.has_known_end and time.monotonic() - begin > seconds:
                break
    steps = np.diff(np.asarray(times, np.int64)).astype(np.float64) / 1e9
    step = float(np.median(steps)) if len(steps) else 0.0
    return SourceSummary(
        source=source.uri,
        depth=source.calibration.depth,
        color=source.calibration.registration.color if source.calibration.registration else None,
        num_frames=len(times),
        num_color=num_color,
        num_body_index=num_body_index,
        num_skeletons=num_skeletons,
        range_m=(float(nearest), float(farthest)) if farthest > 0.0 else None,
        times_ns=(times[0], times[-1]) if times else None,
        frames_per_second=1.0 / step if step > 0.0 else None,
        longest_gap_s=float(steps.max()) if len(steps) else None,
        num_missing=sum(max(0, b - a - 1) for a, b in pairwise(numbers)),
        counters=source._counted(),
        flipped=source.flipped,
        assumed_rate=source.assumed_rate,
    )
