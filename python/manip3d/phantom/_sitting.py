"""State of a patient's sitting: ratings of the pain, and whether a game may begin."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any, Literal

from manip3d._util.times import local_now
from manip3d.errors import InputError
from manip3d.phantom._recorder import Recorder

_REST = timedelta(hours=1)
"""A sitting that passes midnight goes on until there was no message for longer than this."""


def goes_on(since: datetime, now: datetime) -> bool:
    """Return whether a rating is compared with those of a sitting that ended at ``since``.

    It is compared if both are on one day, or if there was no rest between them. ``since`` may lie
    ahead of ``now``, if the computer's clock was set back.
    """
    return since.astimezone().date() == now.date() or abs(now - since) <= _REST


class Sitting:
    """State of a sitting, from the first rating of the pain to the last one.

    Attributes
    ----------
    state : {"open", "ending", "over"}
        ``ending`` waits for the last rating of the pain.
    ask : str
        Instruction for the patient: what must be done before a game may begin. `may_begin` sets it.
    """

    def __init__(self, recorder: Recorder | None) -> None:
        self._recorder = recorder
        self.state: Literal["open", "ending", "over"] = "open"
        self.ask = ""
        self._pain: int | None = None
        self._begun_on = local_now().date()
        self._halt = "", local_now().date()
        self._last_said = local_now()

    def hear(self) -> bool:
        """Note a message of a page; return whether the sitting is over because of a rest.

        A rest ends a sitting that began on an earlier day, so that the patient rates the pain of
        this day before playing, also if the last message came after midnight. Ratings are still
        compared with those of the earlier sitting where `goes_on` says so. While a halt lasts, the
        sitting does, too.
        """
        now = local_now()
        is_halted = bool(self.halted)
        if not is_halted:
            self._halt = "", now.date()  # this message must not prolong a halt that has ended
        is_rested = now.date() != self._begun_on and now - self._last_said > _REST
        self._last_said = now
        return is_rested and not is_halted

    def halt(self, reason: str) -> None:
        """Prevent further games today; an empty reason changes nothing."""
        if reason:
            self._halt = reason, local_now().date()

    @property
    def halted(self) -> str:
        """Reason why no game may begin today, or empty; it stays if a sitting passes midnight."""
        reason, day = self._halt
        now = local_now()
        return reason if day == now.date() or now - self._last_said <= _REST else ""

    def may_begin(self) -> bool:
        """Return whether a game or a touch cue may begin, and set `ask`.

        `halted`, `ask` or `state` tells why not.
        """
        if self.halted or self.state != "open":
            return False
        self.ask = "" if self._recorder is None else self._recorder.may_play()
        return not self.ask

    def note_play(self) -> None:
        """Note that a game or a touch cue begins."""
        if self._recorder is not None:
            self._recorder.play_begins()

    def rate(self, pain: int) -> str:
        """Pass on a rating; return why the session must stop, or an empty text."""
        if self._recorder is None:
            raise InputError("pain: expected a session with a diary")
        self._pain, self.ask = pain, ""
        halt = self._recorder.pain(pain)
        if self.state == "ending":
            self._close(answered=True)
        return halt

    def begin(self) -> None:
        """Begin another sitting, with a first rating of its own."""
        self.state, self._pain, self.ask = "open", None, ""
        self._begun_on = local_now().date()
        if self._recorder is not None:
            self._recorder.open_session()

    def end(self) -> None:
        """End the sitting at the patient's wish; with a diary, ask for a last rating first.

        A sitting that is ending or over stays as it is.
        """
        if self.state != "open":
            return
        self.ask = ""
        self.state = "over" if self._recorder is None else "ending"

    def note_unanswered(self) -> None:
        """End the sitting without the last rating that was asked for."""
        if self.state == "ending":
            self._close(answered=False)

    def shown(self) -> dict[str, Any]:
        """Return the state of the sitting for the page."""
        return {"halt": self.halted, "ask": self.ask, "pain": self._pain, "sitting": self.state}

    def _close(self, *, answered: bool) -> None:
        self.state = "over"
        if self._recorder is not None:
            self._recorder.close_session(answered=answered)
