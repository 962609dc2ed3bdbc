"""Verdict on a stream of frames from the alerts of its frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, TypeAlias

from manip3d._util.checked import checked
from manip3d._util.shares import binomial_tail
from manip3d._util.texts import counted
from manip3d.authenticate._alert_verdict import NO_PAIR, Alert, WitnessReport, joined
from manip3d.authenticate._cross_modal import CLEAN_ACCUSED
from manip3d.authenticate._watermark_files import StreamTally
from manip3d.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

DriveVerdict: TypeAlias = Literal["authentic", "no_trace", "tampered", "undecidable"]
_LOUD: tuple[DriveVerdict, ...] = ("tampered", "undecidable")
"""Verdicts of single frames that decide on the drive, the gravest first."""


@checked
def verdict_of_alerts(alerts: Sequence[Alert], *, whole: bool = True) -> tuple[DriveVerdict, str]:
    """Return the verdict of several frames, and its reason.

    Parameters
    ----------
    alerts : sequence of Alert
        Alerts in the order of the stream. Results of `Alert.brief` are accepted, too.
    whole : bool
        Require one complete session of the watermark, from its first frame to the frame that is
        marked as its last, as in `verdict_of_stream`. Without a watermark it has no effect.

    Returns
    -------
    (verdict, reason)
        ``tampered`` if a frame is, or if frames of another session of the watermark lie between
        frames of one; else ``undecidable`` if a frame is undecidable or was skipped, or if
        ``whole`` is set and the session is incomplete; else ``authentic`` if every frame is; else
        ``no_trace``.

    Raises
    ------
    InputError
        ``alerts`` is empty, or holds an item of another type.

    Notes
    -----
    Cameras accuse one clean frame in 120, so that every drive of some minutes has frames that the
    cameras alone accuse. Such frames make the drive ``undecidable`` only if there are more of them
    than 99 of 100 clean drives with as many frames have (binomial). Otherwise they count by the
    verdicts of the other witnesses, and the reason states their number. Neighbouring frames show
    the same street, so that false accusations come in runs, and more than one clean drive in 100
    becomes undecidable.

    Examples
    --------
    >>> from manip3d.authenticate import AlertMonitor, verdict_of_alerts
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
    """Verdict of a stream so far, in memory that grows with the watermark's sessions only.

    `verdict_of_alerts` returns the same verdict for a list of alerts.

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
        self._without_cameras = _Gravest()  # used if chance explains the cameras' accusations
        self._accused = self._seen = 0  # frames that the cameras accused and judged
        self._why_blind = ""  # first reason why nothing on this computer reads pictures
        self._stream = StreamTally()

    def __repr__(self) -> str:
        return f"<manip3d.authenticate.AlertTally: {counted(self.num_frames, 'frame')}>"

    @property
    def num_frames(self) -> int:
        """Number of frames so far."""
        return self._told.count

    @checked
    def add(self, alert: Alert) -> None:
        """Add the alert of the next frame.

        Parameters
        ----------
        alert : Alert
            Alert of the next frame; results of `Alert.brief` are accepted, too.
        """
        self._told.add(alert.verdict, alert.reason)
        self._without_cameras.add(*_without_cameras(alert))
        cameras = alert.witnesses["cross-modal"]
        self._accused += cameras.verdict == "tampered"
        self._seen += cameras.verdict not in _UNHEARD
        if cameras.verdict == "absent" and cameras.reason != NO_PAIR and not self._why_blind:
            self._why_blind = cameras.reason
        if alert.watermark is None:
            self._stream.skip()
        else:
            self._stream.add(alert.watermark)

    @checked
    def verdict(self, *, whole: bool = True) -> tuple[DriveVerdict, str]:
        """Return the verdict of the frames so far, and its reason.

        Parameters
        ----------
        whole : bool
            Same as for `verdict_of_alerts`; False while the stream goes on.

        Returns
        -------
        (verdict, reason)

        Raises
        ------
        InputError
            No frame was added.
        """
        if not self.num_frames:
            raise InputError("alerts: expected at least one, got none")
        is_chance, note = _accused_by_cameras(self._accused, self._seen)
        told = self._without_cameras if is_chance else self._told
        verdict, reason = told.verdict()
        if verdict != "tampered" and self._stream.splice:
            verdict, reason = "tampered", f"watermark: {self._stream.splice}"
        if verdict == "authentic" and whole:
            stream, why = self._stream.verdict()
            if stream != "authentic":
                verdict, reason = stream, f"watermark: {why}"
        if self._why_blind and not self._seen:
            note = f"; the cameras judged no frame: {self._why_blind}"
        return verdict, reason + note


class _Gravest:
    """The gravest verdict of the frames so far, its first reason, and the number of such frames."""

    def __init__(self) -> None:
        self.count = 0
        self._first = ""
        self._every_authentic = True
        self._loud: dict[DriveVerdict, tuple[str, int]] = {}  # first reason, number of frames

    def add(self, verdict: str, reason: str) -> None:
        self._first = self._first if self.count else reason
        self.count += 1
        self._every_authentic = self._every_authentic and verdict == "authentic"
        for name in _LOUD:
            if name == ("undecidable" if verdict == "skipped" else verdict):
                first, frames = self._loud.get(name, (reason, 0))
                self._loud[name] = first, frames + 1

    def verdict(self) -> tuple[DriveVerdict, str]:
        for name in _LOUD:
            if name in self._loud:
                reason, frames = self._loud[name]
                return name, f"{reason} ({frames} of {self.count} frames)"
        verdict: DriveVerdict = "authentic" if self._every_authentic else "no_trace"
        return verdict, f"{self._first} ({counted(self.count, 'frame')})"


MIN_CHANCE = 0.01
"""Largest share of clean drives that may become undecidable because of the cameras alone."""


def _accused_by_cameras(accused: int, judged: int) -> tuple[bool, str]:
    """Whether chance explains the number of frames that the cameras accuse, and a note about it."""
    if not accused:
        return True, ""
    of_clean, clean = CLEAN_ACCUSED
    is_chance = binomial_tail(accused, judged, of_clean / clean) > MIN_CHANCE
    than = "not more than by chance" if is_chance else "more than by chance"
    return is_chance, (
        f"; cameras accuse {accused} of {judged} frames, {than} ({of_clean} of {clean} clean ones)"
    )


_UNHEARD = ("absent", "skipped", "undecidable")


def _without_cameras(alert: Alert) -> tuple[str, str]:
    """The alert's verdict and reason; if the cameras alone accuse, as if they had found nothing."""
    told = alert.witnesses
    if alert.verdict != "undecidable" or told["cross-modal"].verdict != "tampered":
        return alert.verdict, alert.reason
    quiet = WitnessReport("no_trace", "as often as in clean frames")
    return joined({**told, "cross-modal": quiet}, has_key=told["watermark"].verdict != "absent")
