"""ALERT: watch a stream of LiDAR frames by all witnesses at once."""

from __future__ import annotations

import copy
import logging
import math
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.texts import counted
from manip3d.authenticate._alert_observations import accused_boxes, attack_observations
from manip3d.authenticate._alert_verdict import (
    NO_PAIR,
    WITNESSES,
    Alert,
    AlertCounts,
    WitnessReport,
    joined,
)
from manip3d.authenticate._cross_modal import (
    CrossModalParameters,
    CrossModalResult,
    cross_modal_consistency,
)
from manip3d.authenticate._inspect import inspect
from manip3d.authenticate._inspection import Inspection
from manip3d.authenticate._risk import (
    ACTIONS,
    Risk,
    RiskParameters,
    RiskTracker,
    check_movement,
    is_plausible,
    moved,
)
from manip3d.authenticate._stereo import StereoRig, checked_pair, stereo_disparity
from manip3d.authenticate._surround import SurroundResult
from manip3d.authenticate._watermark import Policy, Watermarker, WatermarkResult, of_file
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_FRAME_S = 0.1  # between frames of scanners that turn ten times a second
_STILL = (0.0, 0.0, 0.0)
_READ = ("watermark", "cross-modal")  # witnesses that need more files than the scan
_JUDGED = {"authentic", "no_trace", "tampered"}  # verdicts that tell something of the frame
_RECENT = 10
"""The cost of a witness is the shortest of so many last calls, which is a second of frames. One
alone would not do, because the first also loads what it needs; all would not do, because a computer
that becomes slower would never be noticed. A call that failed counts as no shorter than the others,
because a failure may come before the work."""
_OF_ACCUSED = "forensics of accused frames"  # key of the time at which such a frame was judged

_log = logging.getLogger("manip3d")


class AlertMonitor:
    """Watch a stream of LiDAR frames: watermark, cameras, forensics, risk.

    The watermark is verified in every frame. Cameras and LiDAR are compared where the budget
    allows, and at least once every ``every_s`` seconds of the stream; LiDAR forensics once in that
    time, and without a budget in every frame that neither of the others could judge. The cameras
    alone decide nothing, so that forensics also judge the frames that only the cameras accuse:
    without a budget each of them, else one in every ``every_s``. What is skipped is counted and
    said.

    Parameters
    ----------
    marker : Watermarker, optional
        Verifier with its key; without one no frame is ``authentic``.
    policy : Policy, optional
        The verifier's.
    rig : StereoRig or mapping of str to StereoRig, optional
        Cameras, or several pairs by their names; without them nothing is compared. Of several
        pairs those that were asked longest ago come first, and beyond the budget one a frame, so
        that each speaks at least once every ``every_s`` and a frame for each of the others.
    budget_s : float, seconds
        For the verdict on a frame: the time between two frames. Infinity: nothing is skipped but
        forensics of frames that another witness judged, unless only the cameras accuse them, for a
        drive that is looked at afterwards.
    every_s : float, seconds
        Period, on the stream's clock, in which cameras and forensics judge at least one frame,
        whatever it costs. Infinity: only within the budget, forensics never.
    cross_modal : CrossModalParameters, optional
        Parameters of a single pair; several pairs share the false alarms of a frame.
    risk : RiskParameters, optional
    background : bool
        Forensics work in a thread of their own, on one core, while further frames are judged. They
        take several times as long as a frame lasts. What they say comes with the first frame after
        they are done and names the frame that they saw; `finish` waits for the last word. A frame
        that only the cameras accuse is judged next, and one of several such frames waits.
    clock : callable, optional
        Clock of this computer in seconds, for latencies; by default `time.perf_counter`.

    Notes
    -----
    Dissertation section 7.3. The watermark protects from the embedder to the verifier; what was
    forged before it is for the cameras and the forensics to see. Threads may share a monitor:
    frames are taken one after the other.

    The watermark knows a frame again that it has seen. Whatever can be refused is therefore refused
    before the watermark is asked, and the same frame may be judged once more. What cameras or
    forensics cannot do afterwards makes them ``undecidable``, with the error as their reason.

    Examples
    --------
    >>> import math
    >>> from manip3d import forge, simulate
    >>> from manip3d.authenticate import AlertMonitor
    >>> monitor = AlertMonitor(budget_s=math.inf)
    >>> frame = simulate.courtyard()
    >>> monitor.judge(frame, speed_mps=10.0).verdict
    'no_trace'
    >>> forged = forge.subtract(frame, forge.nearest_object(frame)).frame
    >>> alert = monitor.judge(forged, speed_mps=10.0)
    >>> alert.verdict, alert.risk.level
    ('tampered', 'low')
    """

    @checked
    def __init__(
        self,
        marker: Watermarker | None = None,
        *,
        policy: Policy | None = None,
        rig: StereoRig | Mapping[str, StereoRig] | None = None,
        budget_s: float = 0.1,
        every_s: float = 1.0,
        cross_modal: CrossModalParameters | None = None,
        risk: RiskParameters | None = None,
        background: bool = False,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        if isinstance(rig, Mapping) and not rig:
            raise InputError("rig: expected at least one stereo rig, got none")
        if isinstance(rig, Mapping) and cross_modal is not None and cross_modal.heading is not None:
            raise InputError("cross_modal: expected no heading with several rigs")
        for name, value in (("budget_s", budget_s), ("every_s", every_s)):
            if not value > 0.0:
                raise InputError(f"{name}: expected a number > 0, got {value}")
        self._marker, self._policy = marker, policy
        self._rig = rig if isinstance(rig, StereoRig) else None
        self._rigs = {} if rig is None or isinstance(rig, StereoRig) else dict(rig)
        self._turns = list(self._rigs)  # the pair that was asked longest ago first
        self._budget, self._every = budget_s, every_s
        self._parameters = cross_modal
        self._risk = RiskTracker(risk)
        self._latest = Risk(0.0, 0.0, "none", ACTIONS["none"])
        self._clock = clock
        self._worker = ThreadPoolExecutor(1, "forensics") if background else None
        self._running: list[tuple[int, Future[tuple[Inspection, float]]]] = []  # two at most
        self._lock = threading.Lock()
        self._unseen = _STILL  # motion over frames that the risk has not heard of
        self._number = 0
        self._timed = (0, 0.0)  # number and time of the last frame with a time
        self._last: dict[str, float] = {}  # time of the stream at which a witness spoke
        self._durations: dict[str, deque[float]] = {}  # of recent calls, seconds
        self._verdicts: dict[str, int] = {}
        self._skipped: dict[str, int] = {}
        self._late = 0
        self._slowest = self._total = 0.0

    def __repr__(self) -> str:
        verdicts = [f"{count} {verdict}" for verdict, count in self._verdicts.copy().items()]
        parts = [counted(self._number, "frame"), *verdicts, f"risk {self._latest.level}"]
        return f"<manip3d.authenticate.AlertMonitor: {', '.join(parts)}>"

    @checked
    def judge(
        self,
        frame: LidarFrame,
        *,
        record: bytes | None = None,
        carrier: ArrayLike | None = None,
        left: ArrayLike | None = None,
        right: ArrayLike | None = None,
        pairs: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
        speed_mps: float,
        motion: tuple[float, float, float] = (0.0, 0.0, 0.0),
        time_s: float | None = None,
        waited_s: float = 0.0,
        unread: Mapping[str, str] | None = None,
    ) -> Alert:
        """Judge the next frame.

        Parameters
        ----------
        frame : LidarFrame
        record : bytes, optional
            The watermark's record; without one a monitor with a key says ``undecidable``.
        carrier : (H, W) or (H, W, 3) uint8, optional
            Picture that carries the record in place of ``record``, and is verified with it.
        left, right : (H, W) or (H, W, 3) uint8, optional
            The rectified pair taken at the same moment.
        pairs : mapping of str to (left, right), optional
            The pictures of each rig, for a monitor with several rigs; a pair may have none.
        speed_mps : float, m/s
            Speed of the car.
        motion : (float, float, float)
            Same as for `RiskTracker.update`.
        time_s : float, optional
            Time of the frame on the stream's clock; default: one budget, at most 0.1 s, after the
            previous frame, which may have been left out.
        waited_s : float, seconds
            Time for which the frame has waited for earlier frames. It is part of the budget: a
            monitor that is behind skips the cameras and only verifies watermarks until it has
            caught up.
        unread : mapping of str to str, optional
            Why a record (``watermark``) or pictures (``cross-modal``) of this frame are not given,
            though there are some: these witnesses are ``undecidable``.

        Raises
        ------
        InputError
            One picture without the other, pictures of another kind, a pair without a rig, a speed
            that is negative, a motion or time that is not finite, a negative wait, a record beside
            a carrier. The frame is not counted then, and may be judged again.
        MissingExtraError
            There are pictures and OpenCV is not installed.
        BrokenExtraError
            There are pictures, and OpenCV is installed but cannot be imported.
        """
        if (left is None) != (right is None):
            raise InputError("left, right: expected both pictures or none")
        check_movement(speed_mps, motion)
        self._check_pairs(left, right, pairs)
        if time_s is not None and not math.isfinite(time_s):
            raise InputError(f"time_s: expected a finite number, got {time_s}")
        if not 0.0 <= waited_s < math.inf:
            raise InputError(f"waited_s: expected a number >= 0, got {waited_s}")
        for name in unread or {}:
            if name not in _READ or (name == "watermark" and self._marker is None):
                known = " or ".join(_READ if self._marker is not None else _READ[1:])
                raise InputError(f"unread: expected {known}, got {name!r}")
        with self._lock:
            started_s = self._clock() - waited_s
            watermark, sworn = self._ask_watermark(frame, record, carrier)  # may refuse the frame
            stream_s = self._time_of_next(time_s)
            cross, seen = (
                self._ask_pairs(frame, pairs or {}, stream_s, started_s)
                if self._rigs
                else self._ask_cameras(frame, left, right, stream_s, started_s)
            )
            is_alone = not {sworn.verdict, seen.verdict} & _JUDGED
            is_accused = seen.verdict == "tampered" and sworn.verdict != "tampered"
            forensics, looked = self._ask_forensics(
                frame, watermark, stream_s, is_alone=is_alone, is_accused=is_accused
            )
            told = {"watermark": sworn, "cross-modal": seen, "forensics": looked}
            for name, why in (unread or {}).items():
                told[name] = _with_unread(told[name], why)
            verdict, reason = joined(told, has_key=self._marker is not None)
            observed = attack_observations(
                watermark, cross, forensics, speed_mps, self._risk.parameters
            )
            since = moved(self._unseen, motion)
            if not is_plausible(since):  # of several frames, each of which is
                since = _STILL
            risk = self._risk.update(None, speed_mps=speed_mps, motion=since, others=observed)
            self._unseen, self._latest = _STILL, risk
            seconds = self._clock() - started_s
            alert = Alert(
                self._number,
                verdict,
                reason,
                ReadOnlyMapping(told),
                observed[0].type if observed else "",
                accused_boxes(watermark, cross, forensics),
                risk,
                seconds,
                seconds > self._budget,
                cross,
                watermark,
                forensics,
            )
            self._count(alert)
            return alert

    @checked
    def judge_unread(
        self,
        reason: str,
        *,
        record: bytes | None = None,
        carrier: ArrayLike | None = None,
        motion: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Alert:
        """Take a frame whose scan cannot be read: it is undecidable, and the stream goes on.

        Parameters
        ----------
        reason : str
        record : bytes, optional
            The watermark's record, by which the frame keeps its place in the chain.
        carrier : (H, W) or (H, W, 3) uint8, optional
            Same as for `judge`.
        motion : (float, float, float)
            Same as for `judge`: the next frame that is judged stands that much farther on.

        Raises
        ------
        InputError
            A motion that is not finite, a record beside a carrier.
        """
        check_movement(0.0, motion)
        with self._lock:
            told = {name: WitnessReport("undecidable", reason) for name in WITNESSES}
            found = None
            if self._marker is not None:
                found = self._marker.verify_without_scan(
                    record, reason, policy=self._policy, picture=carrier
                )
                told["watermark"] = WitnessReport(found.verdict, found.reason)
            verdict, why = told["watermark"].verdict, told["watermark"].reason
            self._unseen = moved(self._unseen, motion)
            risk = self._latest  # a frame that nobody saw changes nothing
            alert = Alert(
                self._number, verdict, why, ReadOnlyMapping(told), "", (), risk, 0.0, False,
                watermark=found,
            )  # fmt: skip
            self._count(alert)
            return alert

    @checked
    def skip(
        self,
        reason: str = "the frame before took too long",
        *,
        motion: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> Alert:
        """Leave out a frame that cannot be judged in time; it is counted, and is unverified.

        Parameters
        ----------
        reason : str
            Reason why the frame is left out; it is stated in the alert.
        motion : (float, float, float)
            Same as for `judge`: the next frame that is judged stands that much farther on.

        Returns
        -------
        Alert

        Raises
        ------
        InputError
            A motion that is not finite.

        Examples
        --------
        >>> from manip3d.authenticate import AlertMonitor
        >>> AlertMonitor().skip("too late").verdict
        'skipped'
        """
        check_movement(0.0, motion)
        with self._lock:
            self._unseen = moved(self._unseen, motion)
            told = {name: WitnessReport("skipped", reason) for name in WITNESSES}
            risk = self._latest  # a frame that nobody saw changes nothing
            alert = Alert(
                self._number, "skipped", reason, ReadOnlyMapping(told), "", (), risk, 0.0, False
            )
            self._count(alert)
            return alert

    @checked
    def finish(self) -> WitnessReport | None:
        """Wait for forensics that still work in the background.

        Returns
        -------
        WitnessReport or None
            Their report on the last frame that they judged, or on the one before if they accuse
            only that; None: nothing was left to say. It is in no `Alert` and is not counted.
        """
        with self._lock:
            told: WitnessReport | None = None
            while self._running:
                last = self._last_word(wait=True)[1]
                if told is None or last.verdict == "tampered" or told.verdict != "tampered":
                    told = last
            return told

    @property
    def counts(self) -> AlertCounts:
        """Numbers of frames judged, skipped and late so far."""
        with self._lock:
            judged = self._number - self._verdicts.get("skipped", 0)
            return AlertCounts(
                self._number,
                ReadOnlyMapping(self._verdicts),
                ReadOnlyMapping(self._skipped),
                self._late,
                self._slowest,
                self._total / judged if judged else 0.0,
            )

    def _count(self, alert: Alert) -> None:
        self._number += 1
        self._verdicts[alert.verdict] = self._verdicts.get(alert.verdict, 0) + 1
        for name, told in alert.witnesses.items():
            if told.verdict == "skipped":
                self._skipped[name] = self._skipped.get(name, 0) + 1
        self._late += alert.is_late
        self._slowest = max(self._slowest, alert.seconds)
        self._total += alert.seconds

    def _ask_watermark(
        self, frame: LidarFrame, record: bytes | None, carrier: ArrayLike | None
    ) -> tuple[WatermarkResult | None, WitnessReport]:
        if self._marker is None:
            return None, WitnessReport("absent", "no key")
        asked_s = self._clock()
        found = of_file(self._marker.verify(frame, record, policy=self._policy, picture=carrier))
        return found, WitnessReport(found.verdict, found.reason, self._clock() - asked_s)

    def _ask_cameras(
        self,
        frame: LidarFrame,
        left: ArrayLike | None,
        right: ArrayLike | None,
        stream_s: float,
        started_s: float,
    ) -> tuple[CrossModalResult | None, WitnessReport]:
        if self._rig is None or left is None or right is None:
            return None, WitnessReport("absent", NO_PAIR)
        if not (self._is_due("cross-modal", stream_s) or self._has_time("cross-modal", started_s)):
            return None, WitnessReport("skipped", "no time left in this frame")
        return self._compare(
            "cross-modal", frame, (left, right), self._rig, self._parameters, stream_s
        )

    def _compare(
        self,
        witness: str,
        frame: LidarFrame,
        pair: tuple[ArrayLike, ArrayLike],
        rig: StereoRig,
        parameters: CrossModalParameters | None,
        stream_s: float,
    ) -> tuple[CrossModalResult | None, WitnessReport]:
        """Compare a stereo pair with the scan; no result: this failed, as the report states."""
        asked_s = self._clock()
        try:
            found = cross_modal_consistency(
                frame, stereo_disparity(*pair), rig, parameters=parameters
            )
        # The watermark has accepted this frame, so that judging it again would fail.
        except Exception as error:
            return None, self._failed(witness, error, asked_s, stream_s)
        return found, self._heard(witness, found.verdict, found.reason, asked_s, stream_s)

    def _check_pairs(
        self,
        left: ArrayLike | None,
        right: ArrayLike | None,
        pairs: Mapping[str, tuple[ArrayLike, ArrayLike]] | None,
    ) -> None:
        if self._rigs and left is not None:
            raise InputError("left, right: expected pairs, since the monitor has several rigs")
        for name in pairs or {}:
            if name not in self._rigs:
                known = ", ".join(sorted(self._rigs)) or "none, since the monitor has no named rigs"
                raise InputError(f"pairs: expected names of rigs ({known}), got {name!r}")
        if self._rig is not None and left is not None and right is not None:
            imported("cv2", "alert")
            checked_pair(left, right)
        for name, both in (pairs or {}).items():
            imported("cv2", "alert")
            try:
                checked_pair(*both)
            except InputError as error:
                raise InputError(f"pairs[{name!r}] {error}") from error

    def _ask_pairs(
        self,
        frame: LidarFrame,
        pairs: Mapping[str, tuple[ArrayLike, ArrayLike]],
        stream_s: float,
        started_s: float,
    ) -> tuple[SurroundResult | None, WitnessReport]:
        """Ask the pairs that there is time for, and of those that are due one beyond it."""
        if not pairs:
            return None, WitnessReport("absent", NO_PAIR)
        asked_s = self._clock()
        parameters = (self._parameters or CrossModalParameters()).shared(len(self._rigs))
        results: dict[str, CrossModalResult | None] = {}  # in the order asked; None: failed
        failures: dict[str, str] = {}
        is_within_budget = True  # the first pair that is due is asked even in a frame that waited
        for name in [each for each in self._turns if each in pairs]:
            witness = _pair_label(name)
            may_exceed = is_within_budget and self._is_due(witness, stream_s)
            if not (may_exceed or self._has_time(witness, started_s)):
                self._skipped[witness] = self._skipped.get(witness, 0) + 1
                continue
            results[name], report = self._compare(
                witness, frame, pairs[name], self._rigs[name], parameters, stream_s
            )
            if results[name] is None:
                failures[name] = report.reason
            is_within_budget = self._clock() - started_s <= self._budget
        self._turns = [each for each in self._turns if each not in results] + list(results)
        return self._joined_pairs(results, failures, self._clock() - asked_s)

    def _joined_pairs(
        self,
        results: Mapping[str, CrossModalResult | None],
        failures: Mapping[str, str],
        seconds: float,
    ) -> tuple[SurroundResult | None, WitnessReport]:
        """Return the result and report of the pairs that were asked together."""
        if not results:
            return None, WitnessReport("skipped", "no time left in this frame")
        why = "; ".join(f"{name}: {each}" for name, each in failures.items())
        by_rig = {name: results.get(name) for name in self._rigs}
        found = {name: each for name, each in by_rig.items() if each is not None}
        if not found:
            return None, WitnessReport("undecidable", why, seconds)
        together = SurroundResult(found)
        reason = together.reason
        not_asked = ", ".join(name for name in self._rigs if name not in results)
        if not_asked:
            reason += f" (not asked: {not_asked})"
        if why:
            reason += f" ({why})"
        return together, WitnessReport(together.verdict, reason, seconds)

    def _ask_forensics(
        self,
        frame: LidarFrame,
        watermark: WatermarkResult | None,
        stream_s: float,
        *,
        is_alone: bool,
        is_accused: bool,
    ) -> tuple[Inspection | None, WitnessReport]:
        """Return the result and report of forensics, if they are due and the time allows for them.

        In the background, the result is that of an earlier frame, and this frame is taken up next.
        """
        # The displacement of a verified watermark is allowed for; its own report says the rest.
        verified = watermark if watermark is not None and watermark.content == "intact" else None
        is_accused = is_accused and self._every < math.inf
        is_due = self._is_due("forensics", stream_s)
        if self._worker is not None:
            heard = self._last_word()
            may_wait = is_accused and len(self._running) < 2
            if may_wait or (is_due and not self._running):
                kept = copy.deepcopy(frame)  # the caller may change it after this call
                self._running.append(
                    (self._number, self._worker.submit(self._looked, kept, verified))
                )
                self._last["forensics"] = stream_s
            return heard
        is_wanted = (is_alone or is_accused) and self._budget == math.inf and self._every < math.inf
        # Once in the period: if cameras accuse every frame, not every verdict is late.
        is_due = is_due or (is_accused and self._is_due(_OF_ACCUSED, stream_s))
        if not (is_wanted or is_due):
            return None, WitnessReport("skipped", "not due")
        if is_accused:
            self._last[_OF_ACCUSED] = stream_s
        asked_s = self._clock()
        try:
            found = inspect(frame, watermark=verified, power=False)
        # The watermark has accepted this frame, so that judging it again would fail.
        except Exception as error:
            return None, self._failed("forensics", error, asked_s, stream_s)
        return found, self._heard("forensics", found.verdict, found.reason, asked_s, stream_s)

    def _looked(
        self, frame: LidarFrame, verified: WatermarkResult | None
    ) -> tuple[Inspection, float]:
        asked_s = self._clock()
        found = inspect(frame, watermark=verified, power=False, threads=1)
        return found, self._clock() - asked_s

    def _last_word(self, *, wait: bool = False) -> tuple[Inspection | None, WitnessReport]:
        """Take the result of the forensics in the background, if there is a new one."""
        if not self._running:
            return None, WitnessReport("skipped", "not due")
        number, future = self._running[0]
        if not (wait or future.done()):
            return None, WitnessReport("skipped", f"still at frame {number}")
        del self._running[0]
        try:
            found, seconds = future.result()
        except Exception as error:  # the watermark's verdict on this frame stands all the same
            _log_traceback(error)
            return None, WitnessReport("undecidable", f"frame {number}: {_failure(error)}")
        return found, WitnessReport(found.verdict, f"frame {number}: {found.reason}", seconds)

    def _time_of_next(self, time_s: float | None) -> float:
        if time_s is not None:
            self._timed = (self._number, time_s)
        number, time_of_it = self._timed
        return time_of_it + (self._number - number) * min(self._budget, _FRAME_S)

    def _is_due(self, witness: str, stream_s: float) -> bool:
        # A time that goes backwards begins another stream.
        last = self._last.get(witness)
        return self._every < math.inf and (
            last is None or stream_s < last or stream_s - last >= self._every * (1.0 - 1e-9)
        )

    def _cost(self, witness: str) -> float:
        """Return the shortest of a witness's recent calls, seconds."""
        return min(self._durations.get(witness, ()), default=0.0)

    def _has_time(self, witness: str, started_s: float) -> bool:
        return self._clock() - started_s + self._cost(witness) <= self._budget

    def _note_duration(self, witness: str, seconds: float) -> None:
        self._durations.setdefault(witness, deque(maxlen=_RECENT)).append(seconds)

    def _heard(
        self, witness: str, verdict: str, reason: str, asked_s: float, stream_s: float
    ) -> WitnessReport:
        seconds = self._clock() - asked_s
        self._last[witness] = stream_s
        self._note_duration(witness, seconds)
        return WitnessReport(verdict, reason, seconds)

    def _failed(
        self, witness: str, error: Exception, asked_s: float, stream_s: float
    ) -> WitnessReport:
        """Report a failure."""
        seconds = self._clock() - asked_s
        _log_traceback(error)
        self._last[witness] = stream_s
        self._note_duration(witness, max(seconds, self._cost(witness)))
        return WitnessReport("undecidable", _failure(error), seconds)


def _with_unread(told: WitnessReport, why: str) -> WitnessReport:
    """Report of a witness some of whose files could not be read."""
    if told.verdict == "absent":
        return replace(told, verdict="undecidable", reason=why)
    return replace(told, reason=f"{told.reason} ({why})")


def _log_traceback(error: Exception) -> None:
    """Log where an error was raised, because a report states its message only."""
    _log.debug("%s", "".join(traceback.format_exception(error)))


def _failure(error: Exception) -> str:
    return f"failed: {error or type(error).__name__}"


def _pair_label(name: str) -> str:
    return f"cross-modal {name}"
