"""The verdict on a stream of frames, by the alerts of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from manip3d._util.checked import checked
from manip3d.authenticate._alert_verdict import Alert, WitnessReport, joined
from manip3d.authenticate._cross_modal import CLEAN_ACCUSED
from manip3d.authenticate._verdict import binomial_tail
from manip3d.authenticate._watermark_files import StreamTally
from manip3d.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence


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
    return joined({**told, "cross-modal": quiet}, has_key=told["watermark"].verdict != "absent")
