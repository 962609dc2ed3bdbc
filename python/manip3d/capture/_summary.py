"""Frames of a source counted and timed."""

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
from manip3d.camera import Intrinsics
from manip3d.capture._rgbd_source import RgbdSource
from manip3d.errors import InputError

if TYPE_CHECKING:
    from manip3d._util.options import Progress

LIVE_SECONDS = 2.0
"""Seconds that a live source is looked at, unless it is said otherwise."""


@dataclass(frozen=True, slots=True)
class SourceSummary:
    """Result of `summarize`.

    Attributes
    ----------
    source : str
        Address of the source.
    depth : Intrinsics
    color : Intrinsics or None
        None: the source names no colour camera.
    num_frames, num_color, num_body_index, num_skeletons : int
        Frames in all, and those with a colour image, with people's pixels and with skeletons.
    range_m : (float, float) or None
        Smallest and largest depth, metres; None: nothing was measured.
    times_ns : (int, int) or None
        Time of the first and of the last frame, nanoseconds; None: there is no frame.
    frames_per_second : float or None
        By the median step; None: there are fewer than two frames, or their times stand still.
    longest_gap_s : float or None
        Longest time between two frames, seconds.
    num_missing : int
        Numbers of frames that were left out.
    counters : mapping of str to int
        What the source saw and refused.
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

    def record(self) -> dict[str, Any]:
        """Return the summary as plain values, as JSON has them.

        Returns
        -------
        dict
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
    """Count and time the frames of a source: all of a recording, some of what may never end.

    Parameters
    ----------
    source : RgbdSource
        What `open_rgbd` opened; it is closed afterwards.
    seconds : float
        For so long a live source is looked at, and one without a known end, such as an iterator.
    progress : callable or bool, optional
        Called with the share that is done, where the number of frames is known; True: a bar.

    Returns
    -------
    SourceSummary

    Raises
    ------
    InputError
        ``seconds`` is not above 0.
    FormatError, OSError
        The recording cannot be read.

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
        for frame in source:
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
        num_missing=sum(b - a - 1 for a, b in pairwise(numbers)),
        counters=source.counters,
    )
