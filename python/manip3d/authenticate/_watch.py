"""Watch a drive: judge each of its moments, and combine them to one verdict."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from manip3d._util.checked import checked
from manip3d._util.extras import why_blind
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.texts import counted
from manip3d.authenticate._alert import AlertMonitor
from manip3d.authenticate._alert_tally import AlertTally, DriveVerdict
from manip3d.authenticate._alert_verdict import Alert, WitnessReport
from manip3d.authenticate._risk import is_plausible
from manip3d.authenticate._stereo import StereoRig
from manip3d.errors import BrokenExtraError, Error, InputError, MissingExtraError
from manip3d.lidar import LidarFrame

TURN_S = 0.1
"""Seconds per turn of the scanner, for moments without a time."""

_FARTHEST_BEHIND = 1.0  # seconds: longest time that a frame may wait for earlier frames
_LONGEST_WAIT = 10.0  # seconds between two frames of a drive that is played


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
        Time of the frame in seconds on the drive's clock; None: unknown, and the frame follows the
        previous one by a turn of the scanner, `TURN_S`.
    pairs : mapping of str to (left, right), or None
        Rectified pictures of a car with several stereo pairs, by the name of the pair.
    carrier : (H, W) or (H, W, 3) uint8, or None
        Picture that carries the record of the watermark in place of ``record``.
    unread : mapping of str to str
        Reasons why files of this frame could not be read: of the record (key ``watermark``) or of
        the pictures (key ``cross-modal``). These checks are then ``undecidable``.
    name : str
        Name of the scan, such as that of its file, for `Alert`; empty: its time is taken.
    blind : str
        Reason why the pictures of this frame are not read by anyone on this computer, such as a
        package that is not installed; the cameras are then ``absent``, and this is their reason.
    """

    frame: LidarFrame | str
    pictures: tuple[Any, Any] | None = None
    record: bytes | None = None
    velocity: tuple[float, float, float] | None = None
    time_s: float | None = None
    pairs: Mapping[str, tuple[Any, Any]] | None = None
    carrier: Any = None
    unread: Mapping[str, str] = MappingProxyType({})
    name: str = ""
    blind: str = ""


class WatchedDrive(NamedTuple):
    """A drive that is about to be watched.

    Attributes
    ----------
    rig : StereoRig, mapping of str to StereoRig, or None
        Cameras, as for `AlertMonitor`.
    moments : iterator of DriveMoment
        Frames of the drive.
    num_frames : int
        Number of frames. If nobody knows how long the drive is, the number that was asked for,
        which it may not reach, or 0.
    """

    rig: StereoRig | Mapping[str, StereoRig] | None
    moments: Iterator[DriveMoment]
    num_frames: int = 0


@dataclass(frozen=True)
class DriveWatch:
    """Verdict on a drive that was watched; see `watch_drive`.

    Attributes
    ----------
    verdict : 'authentic', 'no_trace', 'tampered' or 'undecidable'
    reason : str
        Reason of the verdict in words.
    num_frames : int
        Number of frames that were judged or skipped.
    stopped : BaseException or None
        Error or interruption that ended the drive; None: it ended normally.
    """

    verdict: DriveVerdict
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
    whole: bool = True,
    show: Callable[[Alert], object] | None = None,
) -> DriveWatch:
    """Judge the moments of a drive one after the other, and return the combined verdict.

    If the monitor refuses a picture or a record, the other witnesses still judge. A drive that ends
    with an error or an interruption is ``undecidable``, unless a frame before it is ``tampered``.
    Times and velocities are not signed: if they say that the car moved more than 1e6 metres between
    two frames, its motion counts as unknown, and the reason of the verdict names the first of these
    frames.

    Parameters
    ----------
    monitor : AlertMonitor
        Monitor that judges each frame.
    moments : iterable of DriveMoment
        Frames of the drive.
    speed_mps : float, m/s
        Speed of the car in moments without a velocity.
    live : bool
        Play in real time: wait for the time of each moment, and skip moments that are more than one
        second late. Times are not signed: a moment that is more than ten seconds after the one
        before, or more than a second before it, is due after ten seconds or at once.
    whole : bool
        Require one complete session of the watermark, as in `verdict_of_alerts`. Give False for a
        part of a drive, and for a stream that goes on.
    show : callable, optional
        Function that is called with each `Alert`, in order. An error that it raises is raised again
        after the forensics in the background have finished; it has no effect on the verdict.

    Returns
    -------
    DriveWatch

    Raises
    ------
    InputError
        There are no moments; or the first one is of another type, or has a time that is not finite.
    Error, OSError, KeyboardInterrupt
        The drive ends before its first frame. Later, such an error ends the drive (``stopped``).

    Examples
    --------
    >>> import math
    >>> from manip3d import simulate
    >>> from manip3d.authenticate import AlertMonitor, DriveMoment, watch_drive
    >>> drive = [DriveMoment(simulate.courtyard(x, rng=k)) for k, x in enumerate((-0.5, 0.5))]
    >>> watched = watch_drive(AlertMonitor(budget_s=math.inf), drive)
    >>> watched.verdict, watched.num_frames
    ('no_trace', 2)
    """
    tally = AlertTally()
    errors: list[BaseException] = []
    unmoved: list[int] = []
    failed: BaseException | None = None  # an error of the caller's `show`
    last = None
    try:
        judged = _judged(monitor, iter(moments), speed_mps, unmoved, live=live)
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
    if unmoved:
        reason += f"; frame {unmoved[0]}: its time or speed is wrong, the motion counts as unknown"
    return DriveWatch(verdict, reason, tally.num_frames, stopped)


def _until_error(alerts: Iterator[Alert], errors: list[BaseException]) -> Iterator[Alert]:
    """The alerts of a drive up to the error that ends it, which is appended to ``errors``."""
    try:
        yield from alerts
    except (Error, OSError) as error:
        errors.append(error)


def _until(
    stopped: BaseException, count: int, verdict: DriveVerdict, reason: str
) -> tuple[DriveVerdict, str]:
    """The verdict on a drive of which only the frames before an error were judged."""
    why = "it was interrupted" if isinstance(stopped, KeyboardInterrupt) else str(stopped)
    ended = f"ended after {counted(count, 'frame')}: {why}"
    return (verdict, f"{reason}; {ended}") if verdict == "tampered" else ("undecidable", ended)


def _judged(
    monitor: AlertMonitor,
    moments: Iterator[DriveMoment],
    speed: float,
    unmoved: list[int],
    *,
    live: bool,
) -> Iterator[Alert]:
    """Yield an alert for each frame; in real time, frames over a second late are skipped.

    The numbers of frames with an implausible motion, which counts as none, are appended to
    ``unmoved``.
    """
    due, clock = time.monotonic(), _DriveClock()
    for number, moment in enumerate(moments):
        if not isinstance(moment, DriveMoment):
            raise InputError(f"moments: expected DriveMoments, got {type(moment).__name__}")
        if moment.time_s is not None and not math.isfinite(moment.time_s):
            raise InputError(f"moments: expected finite times, got {moment.time_s}")
        step, waited = clock.advance(moment.time_s), 0.0
        due += step if -_FARTHEST_BEHIND <= step < 0.0 else min(max(step, 0.0), _LONGEST_WAIT)
        if live:
            late = time.monotonic() - due
            if late < 0.0:
                time.sleep(-late)
            waited = max(late, 0.0)
        ahead, left, turn = moment.velocity or (speed, 0.0, 0.0)
        motion = (ahead * step, left * step, turn * step)
        if not is_plausible(motion):
            motion = (0.0, 0.0, 0.0)
            unmoved.append(number)
        if waited > _FARTHEST_BEHIND and number > 0:
            yield _with_scan(monitor.skip(motion=motion), moment)
            continue
        if isinstance(moment.frame, str):
            yield _with_scan(_judged_unread(monitor, moment.frame, moment, motion), moment)
            continue
        judge = partial(
            monitor.judge, moment.frame, speed_mps=abs(ahead) if math.isfinite(ahead) else speed,
            motion=motion, time_s=clock.now if moment.time_s is None else moment.time_s,
            waited_s=waited,
        )  # fmt: skip
        yield _with_scan(_judged_if_seen(judge, moment), moment)


class _DriveClock:
    """Clock of a drive: a moment without a time follows the one before it by a turn."""

    def __init__(self) -> None:
        self.now: float | None = None  # the drive's time, once a moment has told it
        self._is_running = False

    def advance(self, time_s: float | None) -> float:
        """Go on to the next moment; return the seconds since the one before.

        They are negative after a time that was wrong, which takes back the motion until then.
        """
        before, turn = self.now, TURN_S if self._is_running else 0.0
        self._is_running = True
        if time_s is None:
            self.now = None if before is None else before + turn
            return turn
        self.now = time_s
        return turn if before is None else time_s - before


def _with_scan(alert: Alert, moment: DriveMoment) -> Alert:
    """The alert with the name of its scan, or else with the scan's time."""
    time_s = "" if moment.time_s is None else f"{moment.time_s:.3f} s"
    return replace(alert, scan=moment.name or time_s)


def _judged_unread(
    monitor: AlertMonitor, why: str, moment: DriveMoment, motion: tuple[float, float, float]
) -> Alert:
    """The alert of a scan that cannot be read; its carrier is left out if it is refused."""
    judge = partial(monitor.judge_unread, record=moment.record, motion=motion)
    try:
        return judge(why, carrier=moment.carrier)
    except InputError as error:
        if moment.carrier is None:
            raise
        return judge(f"{why}; {error}")


def _judged_if_seen(judge: Callable[..., Alert], moment: DriveMoment) -> Alert:
    """The alert of a scan; without the package that compares them, its pictures are left out.

    Watermark and forensics do not need that package, so that they judge all the same.
    """
    why = moment.blind
    try:
        alert = _judged_without_refused(judge, moment)
    except (MissingExtraError, BrokenExtraError) as error:
        if moment.pictures is None and not moment.pairs:
            raise
        why = why_blind(error)
        alert = _judged_without_refused(judge, moment._replace(pictures=None, pairs=None))
    if not why:
        return alert
    told = {**alert.witnesses, "cross-modal": WitnessReport("absent", why)}
    return replace(alert, witnesses=ReadOnlyMapping(told))


def _judged_without_refused(judge: Callable[..., Alert], moment: DriveMoment) -> Alert:
    """The alert of a scan; pictures or a carrier that the monitor refuses are left out.

    The monitor checks its arguments before it judges, so that the frame can be given again.
    """
    pair = moment.pictures or (None, None)
    cameras = {"left": pair[0], "right": pair[1], "pairs": moment.pairs}
    by_cameras = by_carrier = None  # error of the last trial with each of them
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
