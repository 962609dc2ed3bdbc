"""ALERT: all witnesses of a stream of LiDAR frames joined into one verdict per frame."""

from __future__ import annotations

import copy
import math
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.extras import opencv
from manip3d._util.mappings import ReadOnlyMapping
from manip3d.authenticate._cross_modal import (
    CLEAN_ACCUSED,
    CrossModalParameters,
    CrossModalResult,
    cross_modal_consistency,
)
from manip3d.authenticate._inspect import inspect
from manip3d.authenticate._inspection import Inspection
from manip3d.authenticate._risk import (
    ACTIONS,
    AttackObservation,
    Risk,
    RiskParameters,
    RiskTracker,
    check_movement,
    moved,
)
from manip3d.authenticate._stereo import StereoRig, checked_pair, stereo_disparity
from manip3d.authenticate._surround import SurroundResult
from manip3d.authenticate._verdict import binomial_tail
from manip3d.authenticate._watermark import Policy, Watermarker, WatermarkResult
from manip3d.authenticate._watermark_files import StreamTally
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

_FRAME_S = 0.1  # between frames of scanners that turn ten times a second

_STILL = (0.0, 0.0, 0.0)
_READ = ("watermark", "cross-modal")  # witnesses that need more files than the scan
_JUDGED = {"authentic", "no_trace", "tampered"}  # verdicts that tell something of the frame

WITNESSES = ("watermark", "cross-modal", "forensics")


@dataclass(frozen=True)
class WitnessReport:
    """Verdict of one witness (watermark, cameras or forensics) on one frame.

    Attributes
    ----------
    verdict : str
        ``authentic`` (the watermark alone), ``no_trace``, ``tampered``, ``processed``,
        ``undecidable``, ``skipped`` (no time in this frame) or ``absent`` (there is no key, or
        there are no pictures).
    reason : str
    seconds : float
        It took.
    """

    verdict: str
    reason: str
    seconds: float = 0.0

    def record(self) -> dict[str, object]:
        """Return the fields, ready for JSON."""
        return {"verdict": self.verdict, "reason": self.reason, "seconds": self.seconds}


@dataclass(frozen=True, eq=False)
class Alert:
    """The verdict on one frame.

    Attributes
    ----------
    number : int
        Index of the frame in the monitor's stream, from 0 on; skipped ones count.
    verdict : 'authentic', 'no_trace', 'tampered', 'undecidable' or 'skipped'
        ``tampered`` if watermark or forensics say so; ``undecidable`` if the cameras alone do,
        which accuse too many clean frames to decide. ``authentic`` rests on the watermark alone. A
        frame without one is at best ``no_trace``.
    reason : str
    witnesses : mapping of str to WitnessReport
        ``watermark``, ``cross-modal``, ``forensics``.
    attack : str
        Type, one of `ATTACK_TYPES`, by the witness that knows most of it: cameras, then forensics,
        then the watermark; empty where none was located.
    boxes : tuple of Box
        Where, in the LiDAR's frame, by all witnesses that accuse. The watermark knows sectors.
    risk : Risk
        By the gravest of what these witnesses saw.
    seconds : float
        From receiving the frame to this verdict.
    is_late : bool
        It took longer than the budget.
    cross_modal : CrossModalResult, SurroundResult or None
        The second of a monitor with several pairs.
    watermark : WatermarkResult or None
    forensics : Inspection or None
    """

    number: int
    verdict: str
    reason: str
    witnesses: Mapping[str, WitnessReport]
    attack: str
    boxes: tuple[Box, ...]
    risk: Risk
    seconds: float
    is_late: bool
    cross_modal: CrossModalResult | SurroundResult | None = field(default=None, repr=False)
    watermark: WatermarkResult | None = field(default=None, repr=False)
    forensics: Inspection | None = field(default=None, repr=False)

    def brief(self) -> Alert:
        """Return the alert without scans, maps and points, of which a whole drive fits in memory.

        The tiles of a watermark that holds are left out, too.

        Examples
        --------
        >>> AlertMonitor().skip("too late").brief().verdict
        'skipped'
        """
        kept = self.watermark
        if kept is not None:
            tiles = () if kept.verdict == "authentic" else kept.tiles
            kept = replace(
                kept, scan=None, tiles=tiles, regions=(), suspected=np.empty(0, np.int64)
            )
        return replace(self, cross_modal=None, watermark=kept, forensics=None)

    def record(self) -> dict[str, Any]:
        """Return the alert without maps, ready for JSON; the watermark's with its tiles."""
        return {
            "frame": self.number,
            "verdict": self.verdict,
            "reason": self.reason,
            "attack": self.attack,
            "witnesses": {name: each.record() for name, each in self.witnesses.items()},
            "boxes": [
                {"label": b.label, "center": list(b.center), "size": list(b.size), "yaw": b.yaw}
                for b in self.boxes
            ],
            "risk": self.risk.record(),
            "seconds": self.seconds,
            "is_late": self.is_late,
            "cross_modal": None if self.cross_modal is None else self.cross_modal.record(),
            "watermark": None if self.watermark is None else self.watermark.record(),
        }


@dataclass(frozen=True)
class AlertCounts:
    """Counts and times of a monitor so far.

    Attributes
    ----------
    frames : int
        All that arrived.
    verdicts : mapping of str to int
        ``skipped`` counts frames that no witness saw.
    skipped : mapping of str to int
        By witness: frames in which it had no time, or was not due. Of several stereo pairs also
        each by itself, as ``cross-modal NAME``.
    late : int
        Frames whose verdict took longer than the budget.
    slowest_s : float
    mean_s : float
        Over the frames that were judged.
    """

    frames: int
    verdicts: Mapping[str, int]
    skipped: Mapping[str, int]
    late: int
    slowest_s: float
    mean_s: float

    def record(self) -> dict[str, Any]:
        """Return the fields, ready for JSON."""
        return {
            "frames": self.frames,
            "verdicts": dict(self.verdicts),
            "skipped": dict(self.skipped),
            "late": self.late,
            "slowest_s": self.slowest_s,
            "mean_s": self.mean_s,
        }


class AlertMonitor:
    """Watch a stream of LiDAR frames: watermark, cameras, forensics, risk.

    The watermark is verified in every frame. Cameras and LiDAR are compared where the budget
    allows, and at least once every ``every_s`` seconds of the stream; LiDAR forensics once in that
    time, and without a budget in every frame that neither of the others could judge. What is
    skipped is counted and said.

    Parameters
    ----------
    marker : Watermarker, optional
        Verifier with its key; without one no frame is ``authentic``.
    policy : Policy, optional
        The verifier's.
    rig : StereoRig or mapping of str to StereoRig, optional
        Cameras, or several pairs by their names; without them nothing is compared. Of several
        pairs those that were heard longest ago come first, and beyond the budget one a frame, so
        that each speaks at least once every ``every_s`` and a frame for each of the others.
    budget_s : float, seconds
        For the verdict on a frame: the time between two frames. Infinity: nothing is skipped but
        forensics of frames that another witness judged, for a drive that is looked at afterwards.
    every_s : float, seconds
        Period, on the stream's clock, in which cameras and forensics judge at least one frame,
        whatever it costs. Infinity: only within the budget, forensics never.
    cross_modal : CrossModalParameters, optional
        Parameters of a single pair; several pairs share the false alarms of a frame.
    risk : RiskParameters, optional
    background : bool
        Forensics work in a thread of their own, on one core, while further frames are judged. They
        take several times as long as a frame lasts. What they say comes with the first frame after
        they are done and names the frame that they saw; `finish` waits for the last word.
    clock : callable, optional
        Seconds that pass, for latencies; by default `time.perf_counter`.

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
    >>> import numpy as np
    >>> from manip3d import LidarFrame
    >>> monitor = AlertMonitor()
    >>> alert = monitor.judge(LidarFrame(np.zeros((0, 3), np.float32)), speed_mps=10.0)
    >>> alert.verdict
    'undecidable'
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
        self._turns = list(self._rigs)  # the pair that was heard longest ago first
        self._budget, self._every = budget_s, every_s
        self._parameters = cross_modal
        self._risk = RiskTracker(risk)
        self._latest = Risk(0.0, 0.0, "none", ACTIONS["none"])
        self._clock = clock
        self._worker = ThreadPoolExecutor(1, "forensics") if background else None
        self._running: tuple[int, Future[tuple[Inspection, float]]] | None = None
        self._lock = threading.Lock()
        self._unseen = _STILL  # motion over frames that the risk has not heard of
        self._number = 0
        self._last: dict[str, float] = {}  # time of the stream at which a witness spoke
        self._cost: dict[str, float] = {}  # seconds
        self._verdicts: dict[str, int] = {}
        self._skipped: dict[str, int] = {}
        self._late = 0
        self._slowest = self._total = 0.0

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
            As for `RiskTracker.update`.
        time_s : float, optional
            Time of the frame on the stream's clock; by default a budget after the frame before, at
            most 0.1 s.
        waited_s : float, seconds
            For which the frame has waited for those before it. It counts: a monitor that is behind
            leaves out the cameras and verifies the watermark alone until it has caught up.
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
            begin = self._clock() - waited_s
            now = self._number * min(self._budget, _FRAME_S) if time_s is None else time_s
            watermark, sworn = self._ask_watermark(frame, record, carrier)
            cross, seen = (
                self._ask_pairs(frame, pairs or {}, now, begin)
                if self._rigs
                else self._ask_cameras(frame, left, right, now, begin)
            )
            is_alone = not {sworn.verdict, seen.verdict} & _JUDGED
            forensics, looked = self._ask_forensics(frame, watermark, now, is_alone=is_alone)
            told = {"watermark": sworn, "cross-modal": seen, "forensics": looked}
            for name, why in (unread or {}).items():
                told[name] = _with_unread(told[name], why)
            verdict, reason = _joined(told, has_key=self._marker is not None)
            observed = _observations(watermark, cross, forensics, speed_mps, self._risk.parameters)
            since = moved(self._unseen, motion)
            risk = self._risk.update(None, speed_mps=speed_mps, motion=since, others=observed)
            self._unseen, self._latest = _STILL, risk
            seconds = self._clock() - begin
            alert = Alert(
                self._number,
                verdict,
                reason,
                ReadOnlyMapping(told),
                observed[0].type if observed else "",
                _boxes(watermark, cross, forensics),
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
            As for `judge`.
        motion : (float, float, float)
            As for `judge`: the next frame that is judged stands that much farther on.

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
            Why the frame is left out; it stands in the alert.
        motion : (float, float, float)
            As for `judge`: the next frame that is judged stands that much farther on.

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
            What they say of the last frame that they saw; None: nothing was left to say. It is in
            no `Alert` and is not counted.
        """
        with self._lock:
            if self._running is None:
                return None
            return self._last_word(wait=True)[1]

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
        begin = self._clock()
        found = self._marker.verify(frame, record, policy=self._policy, picture=carrier)
        return found, WitnessReport(found.verdict, found.reason, self._clock() - begin)

    def _ask_cameras(
        self,
        frame: LidarFrame,
        left: ArrayLike | None,
        right: ArrayLike | None,
        now: float,
        begin: float,
    ) -> tuple[CrossModalResult | None, WitnessReport]:
        if self._rig is None or left is None or right is None:
            return None, WitnessReport("absent", "no stereo pair")
        if not (self._is_due("cross-modal", now) or self._has_time("cross-modal", begin)):
            return None, WitnessReport("skipped", "no time left in this frame")
        start = self._clock()
        try:
            found = cross_modal_consistency(
                frame, stereo_disparity(left, right), self._rig, parameters=self._parameters
            )
        except Exception as error:  # the chain has moved on: the frame cannot be judged again
            return None, self._silent("cross-modal", error, start, now)
        return found, self._heard("cross-modal", found.verdict, found.reason, start, now)

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
            opencv()
            checked_pair(left, right)
        for name, both in (pairs or {}).items():
            opencv()
            try:
                checked_pair(*both)
            except InputError as error:
                raise InputError(f"pairs[{name!r}] {error}") from error

    def _ask_pairs(
        self,
        frame: LidarFrame,
        pairs: Mapping[str, tuple[ArrayLike, ArrayLike]],
        now: float,
        begin: float,
    ) -> tuple[SurroundResult | None, WitnessReport]:
        """Ask the pairs that there is time for, and of those that are due one beyond it."""
        if not pairs:
            return None, WitnessReport("absent", "no stereo pair")
        start = self._clock()
        found: dict[str, CrossModalResult] = {}
        failed: dict[str, str] = {}
        shared = (self._parameters or CrossModalParameters()).shared(len(self._rigs))
        left_out = []
        is_beyond = False
        for name in [each for each in self._turns if each in pairs]:
            has_time = self._has_time(_pair_label(name), begin)
            if not has_time and (is_beyond or not self._is_due(_pair_label(name), now)):
                left_out.append(name)
                continue
            asked = self._clock()
            try:
                disparity = stereo_disparity(*pairs[name])
                told = cross_modal_consistency(
                    frame, disparity, self._rigs[name], parameters=shared
                )
            except Exception as error:  # the chain has moved on: the frame cannot be judged again
                failed[name] = self._silent(_pair_label(name), error, asked, now).reason
            else:
                found[name] = told
                self._heard(_pair_label(name), told.verdict, told.reason, asked, now)
            is_beyond = self._clock() - begin > self._budget
        heard = [*found, *failed]
        self._turns = [each for each in self._turns if each not in heard] + heard
        for name in left_out:
            self._skipped[_pair_label(name)] = self._skipped.get(_pair_label(name), 0) + 1
        why = "; ".join(f"{name}: {each}" for name, each in failed.items())
        if not found and failed:
            return None, WitnessReport("undecidable", why, self._clock() - start)
        if not found:
            return None, WitnessReport("skipped", "no time left in this frame")
        joined = SurroundResult({name: found[name] for name in self._rigs if name in found})
        reason = joined.reason
        if len(found) < len(self._rigs):
            silent = ", ".join(name for name in self._rigs if name not in heard)
            reason += f" (not asked: {silent})" * bool(silent) + f" ({why})" * bool(why)
        return joined, WitnessReport(joined.verdict, reason, self._clock() - start)

    def _ask_forensics(
        self, frame: LidarFrame, watermark: WatermarkResult | None, now: float, *, is_alone: bool
    ) -> tuple[Inspection | None, WitnessReport]:
        # The displacement of a verified watermark is allowed for; its own report says the rest.
        verified = watermark if watermark is not None and watermark.content == "intact" else None
        if self._worker is not None:
            heard = self._last_word()
            if self._running is None and self._is_due("forensics", now):
                kept = copy.deepcopy(frame)  # the caller may change it after this call
                self._running = (self._number, self._worker.submit(self._looked, kept, verified))
                self._last["forensics"] = now
            return heard
        is_wanted = is_alone and self._budget == math.inf and self._every < math.inf
        if not (is_wanted or self._is_due("forensics", now)):
            return None, WitnessReport("skipped", "not due")
        start = self._clock()
        try:
            found = inspect(frame, watermark=verified, power=False)
        except Exception as error:  # the chain has moved on: the frame cannot be judged again
            return None, self._silent("forensics", error, start, now)
        return found, self._heard("forensics", found.verdict, found.reason, start, now)

    def _looked(
        self, frame: LidarFrame, verified: WatermarkResult | None
    ) -> tuple[Inspection, float]:
        start = self._clock()
        found = inspect(frame, watermark=verified, power=False, threads=1)
        return found, self._clock() - start

    def _last_word(self, *, wait: bool = False) -> tuple[Inspection | None, WitnessReport]:
        """Take the result of the forensics in the background, if there is a new one."""
        if self._running is None:
            return None, WitnessReport("skipped", "not due")
        number, future = self._running
        if not (wait or future.done()):
            return None, WitnessReport("skipped", f"still at frame {number}")
        self._running = None
        try:
            found, seconds = future.result()
        except Exception as error:  # the watermark's word on this frame stands all the same
            return None, WitnessReport("undecidable", f"frame {number}: {_failure(error)}")
        return found, WitnessReport(found.verdict, f"frame {number}: {found.reason}", seconds)

    def _is_due(self, witness: str, now: float) -> bool:
        # A time that goes backwards begins another stream.
        last = self._last.get(witness)
        return self._every < math.inf and (
            last is None or now < last or now - last >= self._every * (1.0 - 1e-9)
        )

    def _has_time(self, witness: str, begin: float) -> bool:
        return self._clock() - begin + self._cost.get(witness, 0.0) <= self._budget

    def _heard(
        self, witness: str, verdict: str, reason: str, start: float, now: float
    ) -> WitnessReport:
        seconds = self._clock() - start
        self._last[witness] = now
        # The quickest so far: the first call also loads what it needs.
        self._cost[witness] = min(seconds, self._cost.get(witness, math.inf))
        return WitnessReport(verdict, reason, seconds)

    def _silent(self, witness: str, error: Exception, start: float, now: float) -> WitnessReport:
        return self._heard(witness, "undecidable", _failure(error), start, now)


def _with_unread(told: WitnessReport, why: str) -> WitnessReport:
    """Report of a witness some of whose files could not be read."""
    if told.verdict == "absent":
        return replace(told, verdict="undecidable", reason=why)
    return replace(told, reason=f"{told.reason} ({why})")


def _failure(error: Exception) -> str:
    return f"failed: {error or type(error).__name__}"


def _joined(told: Mapping[str, WitnessReport], *, has_key: bool) -> tuple[str, str]:
    """One verdict: watermark and forensics accuse, cameras doubt, the watermark alone clears."""
    for name in ("watermark", "forensics"):
        if told[name].verdict == "tampered":
            return "tampered", f"{name}: {told[name].reason}"
    if told["cross-modal"].verdict == "tampered":
        reason = f"cross-modal: {told['cross-modal'].reason}; cameras accuse clean frames too"
        return "undecidable", f"{reason}, so another witness has to agree"
    sworn = told["watermark"]
    if has_key:
        return sworn.verdict, f"watermark: {sworn.reason}"
    for name in ("cross-modal", "forensics"):
        if told[name].verdict == "no_trace":
            return "no_trace", f"{name}: {told[name].reason}"
    for name in ("cross-modal", "forensics"):
        if told[name].verdict in ("undecidable", "processed"):
            return "undecidable", f"{name}: {told[name].reason}"
    return "undecidable", "no witness has seen this frame"


def _pair_label(name: str) -> str:
    return f"cross-modal {name}"


def _boxes(
    watermark: WatermarkResult | None,
    cross: CrossModalResult | SurroundResult | None,
    forensics: Inspection | None,
) -> tuple[Box, ...]:
    """Boxes of all witnesses that accuse, narrowest first: the watermark knows sectors only."""
    boxes: tuple[Box, ...] = ()
    if cross is not None and cross.verdict == "tampered":
        boxes += cross.boxes
    if forensics is not None and forensics.verdict == "tampered":
        boxes += tuple(region.box for region in forensics.regions)
    if watermark is not None and watermark.verdict == "tampered":
        boxes += tuple(region.box for region in watermark.regions)
    return boxes


def _observations(
    watermark: WatermarkResult | None,
    cross: CrossModalResult | SurroundResult | None,
    forensics: Inspection | None,
    speed_mps: float,
    region: RiskParameters,
) -> list[AttackObservation]:
    """The attack as each witness that accuses saw it; the one that knows most of it first."""
    observed = []
    if cross is not None:
        by_cameras = cross.observation(speed_mps=speed_mps, parameters=region)
        observed += [] if by_cameras is None else [by_cameras]
    if forensics is not None and forensics.verdict == "tampered":
        observed.append(_by_forensics(forensics, region, speed_mps))
    if watermark is not None and watermark.verdict == "tampered":
        observed.append(_by_tiles(watermark, region))
    return observed


def _by_forensics(found: Inspection, region: RiskParameters, speed_mps: float) -> AttackObservation:
    """Suspected points say where; of what kind the attack is they do not tell."""
    places = [each.box.center[:2] for each in found.regions] or [(region.nearest_m, 0.0)]
    x, y = min(places, key=lambda place: math.hypot(*place))
    if found.scan is None:
        return AttackObservation("modification", (x, y), 0, 0)
    inside = region.contains(found.scan.points, speed_mps)
    suspected = {int(row) for each in found.regions for row in each.rows}
    changed = sum(bool(inside[row]) for row in suspected)
    return AttackObservation("modification", (float(x), float(y)), changed, int(inside.sum()))


def _by_tiles(found: WatermarkResult, region: RiskParameters) -> AttackObservation:
    """The watermark knows sectors only: the worst place in them is assumed."""
    azimuths = [
        azimuth for number in found.changed_tiles for azimuth in found.tiles[number].azimuths_deg
    ]
    angle = min((_to_ahead(begin, end) for begin, end in azimuths), default=0.0)
    place = (region.nearest_m * math.cos(angle), region.nearest_m * math.sin(angle))
    count = len(found.tiles)
    return AttackObservation("modification", place, len(found.changed_tiles) or count, count)


def _to_ahead(begin_deg: float, end_deg: float) -> float:
    """Radians from straight ahead to the nearest place of a sector."""
    if (end_deg - begin_deg) >= 360.0 or (-begin_deg) % 360.0 <= (end_deg - begin_deg) % 360.0:
        return 0.0
    return min(abs(math.radians(math.remainder(a, 360.0))) for a in (begin_deg, end_deg))


@checked
def verdict_of_alerts(alerts: Sequence[Alert], *, whole: bool = False) -> tuple[str, str]:
    """Return the verdict of several frames, and its reason.

    Parameters
    ----------
    alerts : sequence of Alert
        In the order of the stream; also those of `Alert.brief`.
    whole : bool
        The frames are to be one whole session of the watermark, from its first frame to the one
        that says that it is the last, as for `verdict_of_stream`.

    Returns
    -------
    (verdict, reason)
        ``tampered`` if a frame is; else ``undecidable`` if a frame is, or was skipped, or if a
        whole session is not there; else ``authentic`` if every frame is, else ``no_trace``.

    Raises
    ------
    InputError
        No frames.

    Notes
    -----
    Cameras accuse one clean frame in 120, so that a drive of some minutes always has frames that
    they alone doubt. The drive is doubted for these where there are more of them than clean drives
    of as many frames have in 99 of 100 cases (binomial); else the reason names them, and they count
    by what the other witnesses say. Neighbouring frames see the same street: false accusations come
    several in a row, so that more than one clean drive in 100 is doubted.

    Examples
    --------
    >>> verdict_of_alerts([AlertMonitor().skip("too late")])
    ('undecidable', 'too late (1 of 1 frames)')
    """
    if len(alerts) == 0:
        raise InputError("alerts: expected at least one, got none")
    tally = AlertTally()
    for alert in alerts:
        tally.add(alert)
    return tally.verdict(whole=whole)


class AlertTally:
    """The verdict of a stream so far, in memory that does not grow with its frames.

    `verdict_of_alerts` says the same of alerts that were kept.

    Examples
    --------
    >>> from manip3d.authenticate import AlertMonitor, AlertTally
    >>> tally = AlertTally()
    >>> for _ in range(3):
    ...     tally.add(AlertMonitor().skip("too late"))
    >>> tally.verdict()
    ('undecidable', 'too late (3 of 3 frames)')
    """

    def __init__(self) -> None:
        self._told = _Gravest()
        self._without_cameras = _Gravest()  # where chance explains how often the cameras accuse
        self._accused = self._seen = 0  # frames, by the cameras
        self._stream = StreamTally()

    @property
    def num_frames(self) -> int:
        """Frames so far."""
        return self._told.count

    @checked
    def add(self, alert: Alert) -> None:
        """Take the next frame.

        Parameters
        ----------
        alert : Alert
            Also one of `Alert.brief`.
        """
        self._told.add(alert.verdict, alert.reason)
        self._without_cameras.add(*_without_cameras(alert))
        seen = alert.witnesses["cross-modal"].verdict
        self._accused += seen == "tampered"
        self._seen += seen not in _UNHEARD
        if alert.watermark is not None:
            self._stream.add(alert.watermark)

    @checked
    def verdict(self, *, whole: bool = False) -> tuple[str, str]:
        """Return the verdict of the frames so far, and its reason.

        Parameters
        ----------
        whole : bool
            As for `verdict_of_alerts`.

        Returns
        -------
        (verdict, reason)

        Raises
        ------
        InputError
            There was no frame.
        """
        if not self.num_frames:
            raise InputError("alerts: expected at least one, got none")
        is_chance, note = _accused_by_cameras(self._accused, self._seen)
        told = self._without_cameras if is_chance else self._told
        verdict, reason = told.verdict()
        if verdict == "authentic" and whole:
            stream, why = self._stream.verdict()
            if stream != "authentic":
                verdict, reason = stream, f"watermark: {why}"
        return verdict, reason + note


class _Gravest:
    """The gravest verdict of frames, the first reason for it, and of how many frames it is."""

    def __init__(self) -> None:
        self.count = 0
        self._first = ""
        self._every_authentic = True
        self._loud: dict[str, tuple[str, int]] = {}  # the first reason, and frames

    def add(self, verdict: str, reason: str) -> None:
        self._first = self._first if self.count else reason
        self.count += 1
        self._every_authentic = self._every_authentic and verdict == "authentic"
        name = "undecidable" if verdict == "skipped" else verdict
        if name in ("tampered", "undecidable"):
            first, frames = self._loud.get(name, (reason, 0))
            self._loud[name] = first, frames + 1

    def verdict(self) -> tuple[str, str]:
        for name in ("tampered", "undecidable"):
            if name in self._loud:
                reason, frames = self._loud[name]
                return name, f"{reason} ({frames} of {self.count} frames)"
        verdict = "authentic" if self._every_authentic else "no_trace"
        noun = "frame" if self.count == 1 else "frames"
        return verdict, f"{self._first} ({self.count} {noun})"


LEAST_CHANCE = 0.01
"""Share of clean drives, at most, that are doubted because of the cameras alone."""


def _accused_by_cameras(accused: int, judged: int) -> tuple[bool, str]:
    """Whether chance explains how many frames the cameras accuse, and a note of these frames."""
    if not accused:
        return True, ""
    of_clean, clean = CLEAN_ACCUSED
    is_chance = binomial_tail(accused, judged, of_clean / clean) > LEAST_CHANCE
    than = "not more than by chance" if is_chance else "more than by chance"
    return is_chance, (
        f"; cameras accuse {accused} of {judged} frames, {than} ({of_clean} of {clean} clean ones)"
    )


_UNHEARD = ("absent", "skipped", "undecidable")


def _without_cameras(alert: Alert) -> tuple[str, str]:
    """The verdict as if the cameras had found nothing where they alone accuse, and its reason."""
    told = alert.witnesses
    if alert.verdict != "undecidable" or told["cross-modal"].verdict != "tampered":
        return alert.verdict, alert.reason
    quiet = WitnessReport("no_trace", "as often as in clean frames")
    return _joined({**told, "cross-modal": quiet}, has_key=told["watermark"].verdict != "absent")
