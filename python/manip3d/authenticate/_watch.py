"""Watching a drive: each of its moments is judged, and together they have one verdict."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from manip3d._util.checked import checked
from manip3d.authenticate._alert import AlertMonitor
from manip3d.authenticate._alert_tally import AlertTally
from manip3d.authenticate._alert_verdict import Alert
from manip3d.authenticate._stereo import StereoRig
from manip3d.errors import Error, InputError
from manip3d.lidar import LidarFrame

TURN_S = 0.1
"""Seconds of a turn of the scanner, where a drive does not tell its times."""

_FARTHEST_BEHIND = 1.0  # seconds that a frame may wait for those before it


class DriveMoment(NamedTuple):
    """One frame of a drive for `watch_drive`: the scan and all that was recorded with it.

    Attributes
    ----------
    frame : LidarFrame or str
        The scan, or, if it cannot be read, the reason.
    pictures : (left, right) or None
        Rectified pictures, each (H, W) or (H, W, 3) uint8, of a car with one stereo pair.
    record : bytes or None
        Record of the watermark (`read_record`).
    velocity : (float, float, float) or None
        Velocity of the car: m/s ahead, m/s to the left, rad/s counter-clockwise. None: unknown.
    time_s : float or None
        Time of the frame in seconds on the drive's clock; None: unknown, then the frame follows
        the one before at the interval of `AlertMonitor.judge`.
    pairs : mapping of str to (left, right), or None
        Rectified pictures of a car with several stereo pairs, by the name of the pair.
    carrier : (H, W) or (H, W, 3) uint8, or None
        Picture that carries the record of the watermark in place of ``record``.
    unread : mapping of str to str
        Reasons why files of this frame could not be read: of the record (key ``watermark``) or of
        the pictures (key ``cross-modal``). These checks are then ``undecidable``.
    """

    frame: LidarFrame | str
    pictures: tuple[Any, Any] | None = None
    record: bytes | None = None
    velocity: tuple[float, float, float] | None = None
    time_s: float | None = None
    pairs: Mapping[str, tuple[Any, Any]] | None = None
    carrier: Any = None
    unread: Mapping[str, str] = MappingProxyType({})


class WatchedDrive(NamedTuple):
    """A drive that is about to be watched.

    Attributes
    ----------
    rig : StereoRig, mapping of str to StereoRig, or None
        Cameras, as `AlertMonitor` takes them.
    moments : iterator of DriveMoment
    num_frames : int
        Frames of the drive at most, as many as were asked for; 0: not known before it ends.
    """

    rig: StereoRig | Mapping[str, StereoRig] | None
    moments: Iterator[DriveMoment]
    num_frames: int = 0


@dataclass(frozen=True)
class DriveWatch:
    """Verdict of a drive that was watched; see `watch_drive`.

    Attributes
    ----------
    verdict : 'authentic', 'no_trace', 'tampered' or 'undecidable'
    reason : str
        The verdict's reason in words.
    num_frames : int
        Frames that were judged or skipped.
    stopped : BaseException or None
        The error or the interruption with which the drive ended.
    """

    verdict: str
    reason: str
    num_frames: int
    stopped: BaseException | None = None


@checked
def watch_drive(
    monitor: AlertMonitor,
    moments: Iterable[DriveMoment],
    *,
    speed_mps: float = 10.0,
    live: bool = False,
    whole: bool = False,
    show: Callable[[Alert], object] | None = None,
) -> DriveWatch:
    """Judge the moments of a drive one after the other, and return their joint verdict.

    A picture or record that the monitor refuses silences no other witness. A drive that ends in an
    error or an interruption is judged by the frames before it: it is ``undecidable`` then, unless
    one of them was tampered with.

    Parameters
    ----------
    monitor : AlertMonitor
    moments : iterable of DriveMoment
    speed_mps : float, m/s
        Speed of the car in moments without a velocity.
    live : bool
        Play in real time: wait for the time of each moment, and skip moments that come more than a
        second late.
    whole : bool
        The drive is to be one whole session of a watermark, as for `AlertTally.verdict`.
    show : callable, optional
        Called with each `Alert`, in order. An error that it raises is the caller's, and says
        nothing about the drive: it is passed on when no forensics work in the background any
        more.

    Returns
    -------
    DriveWatch

    Raises
    ------
    InputError
        There are no moments, or items of another kind.
    Error, OSError, KeyboardInterrupt
        The drive ends before its first frame.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame
    >>> from manip3d.authenticate import AlertMonitor, DriveMoment, watch_drive
    >>> empty = DriveMoment(LidarFrame(np.zeros((0, 3), np.float32)))
    >>> watched = watch_drive(AlertMonitor(), [empty, empty])
    >>> watched.verdict, watched.num_frames
    ('undecidable', 2)
    """
    tally = AlertTally()
    errors: list[BaseException] = []
    failed: BaseException | None = None  # an error of the caller's `show`
    last = None
    try:
        judged = _judged(monitor, iter(moments), speed_mps, live=live)
        for alert in _until_error(judged, errors):
            tally.add(alert)
            if show is not None:
                show(alert)
    except KeyboardInterrupt as error:
        errors.append(error)
    except BaseException as error:
        failed = error
    try:  # forensics in the background may still accuse a frame before the interruption
        last = monitor.finish()
    except KeyboardInterrupt as error:
        errors.append(error)
    if failed is not None:
        raise failed
    stopped = errors[-1] if errors else None
    if stopped is not None and not tally.num_frames:
        raise stopped
    if not tally.num_frames:
        raise InputError("moments: expected frames, found none")
    verdict, reason = tally.verdict(whole=whole and stopped is None)
    if last is not None and last.verdict == "tampered" and verdict != "tampered":
        verdict, reason = "tampered", f"forensics: {last.reason}"
    if stopped is not None:
        verdict, reason = _until(stopped, tally.num_frames, verdict, reason)
    return DriveWatch(verdict, reason, tally.num_frames, stopped)


def _until_error(alerts: Iterator[Alert], errors: list[BaseException]) -> Iterator[Alert]:
    """The alerts of a drive up to the error in which it ends; that is put into `errors`."""
    try:
        yield from alerts
    except (Error, OSError) as error:
        errors.append(error)


def _until(stopped: BaseException, count: int, verdict: str, reason: str) -> tuple[str, str]:
    """The verdict of a drive of which only the frames before an error were judged."""
    why = "it was interrupted" if isinstance(stopped, KeyboardInterrupt) else str(stopped)
    ended = f"ended after {count} {'frame' if count == 1 else 'frames'}: {why}"
    return (verdict, f"{reason}; {ended}") if verdict == "tampered" else ("undecidable", ended)


def _judged(
    monitor: AlertMonitor, moments: Iterator[DriveMoment], speed: float, *, live: bool
) -> Iterator[Alert]:
    """Yield an alert for each frame; in real time, frames over a second late are skipped."""
    begin, first, last = time.monotonic(), None, None
    for moment in moments:
        if not isinstance(moment, DriveMoment):
            raise InputError(f"moments: expected DriveMoments, got {type(moment).__name__}")
        now, waited = moment.time_s, 0.0
        if live:
            # A drive without times is played as a scanner turns.
            now = (0.0 if last is None else last + TURN_S) if now is None else now
            first = now if first is None else first
            late = time.monotonic() - begin - (now - first)
            if late < 0.0:
                time.sleep(-late)
            waited = max(late, 0.0)
        step = 0.0 if last is None or now is None else max(now - last, 0.0)
        ahead, left, turn = moment.velocity or (speed, 0.0, 0.0)
        motion = (ahead * step, left * step, turn * step)
        is_first, last = last is None, now
        if waited > _FARTHEST_BEHIND and not is_first:
            yield monitor.skip(motion=motion)
            continue
        if isinstance(moment.frame, str):
            yield _judged_unread(monitor, moment.frame, moment, motion)
            continue
        judge = partial(
            monitor.judge, moment.frame, speed_mps=abs(ahead), motion=motion, time_s=now,
            waited_s=waited,
        )  # fmt: skip
        yield _judged_without_refused(judge, moment)


def _judged_unread(
    monitor: AlertMonitor, why: str, moment: DriveMoment, motion: tuple[float, float, float]
) -> Alert:
    """The alert of a scan that cannot be read, without its carrier where that is refused."""
    judge = partial(monitor.judge_unread, record=moment.record, motion=motion)
    try:
        return judge(why, carrier=moment.carrier)
    except InputError as error:
        if moment.carrier is None:
            raise
        return judge(f"{why}; {error}")


def _judged_without_refused(judge: Callable[..., Alert], moment: DriveMoment) -> Alert:
    """The alert of a scan; pictures or a carrier that the monitor refuses silence only themselves.

    The monitor refuses before it judges, so that the same frame can be given again.
    """
    pair = moment.pictures or (None, None)
    cameras = {"left": pair[0], "right": pair[1], "pairs": moment.pairs}
    by_cameras = by_carrier = None  # what the last trial with each of them was refused for
    for shown, carrier in (
        (cameras, moment.carrier),
        ({}, moment.carrier),
        (cameras, None),
        ({}, None),
    ):
        unread = dict(moment.unread)
        if not shown and by_cameras is not None:
            unread["cross-modal"] = str(by_cameras)
        if carrier is None and by_carrier is not None:
            unread["watermark"] = str(by_carrier)
        try:
            return judge(record=moment.record, carrier=carrier, unread=unread, **shown)
        except InputError as error:
            refused = error
            by_cameras = error if shown else by_cameras
            by_carrier = error if carrier is not None else by_carrier
    raise refused
