"""One sitting of a patient: whether play may begin, and the ratings that are asked for."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any, Literal

from manip3d.phantom._recorder import Recorder

_REST = timedelta(hours=1)  # without a word: who goes on at midnight is in the same sitting


def goes_on(since: datetime, now: datetime) -> bool:
    """Whether what was said then holds: on the same day, or where no rest lies between."""
    return since.astimezone().date() == now.date() or now - since <= _REST


class Sitting:
    """From the first rating of the pain to the last one, and what stops the play for today.

    Attributes
    ----------
    state : {"open", "ending", "over"}
        ``ending`` waits for the last rating of the pain.
    ask : str
        What is to be done before a game may begin, in words for the patient.
    """

    def __init__(self, recorder: Recorder | None) -> None:
        self._recorder = recorder
        self.state: Literal["open", "ending", "over"] = "open"
        self.ask = ""
        self._pain: int | None = None
        self._halt = "", _now().date()
        self._last_said = _now()

    def hear(self) -> bool:
        """Note that a page said something; whether that is after a rest, on another day.

        What was said before, such as why nothing more is played, holds no longer then.
        """
        now, (halt, day) = _now(), self._halt
        is_another_day = now.date() != (day if halt else self._last_said.date())
        is_rested = is_another_day and now - self._last_said > _REST
        if is_rested:
            self._halt = "", now.date()
        self._last_said = now
        return is_rested

    def halt(self, reason: str) -> None:
        """Let nothing begin any more today; an empty reason changes nothing."""
        if reason:
            self._halt = reason, _now().date()

    @property
    def halted(self) -> str:
        """Why nothing more is played today, or nothing; no midnight within a sitting ends it."""
        reason, day = self._halt
        now = _now()
        return reason if day == now.date() or now - self._last_said <= _REST else ""

    def may_begin(self) -> bool:
        """Whether a game or a touch cue may begin; the page says why not."""
        if self.halted or self.state != "open":
            return False
        self.ask = "" if self._recorder is None else self._recorder.may_play()
        return not self.ask

    def note_play(self) -> None:
        """A game or a touch cue begins."""
        if self._recorder is not None:
            self._recorder.play_begins()

    def rate(self, pain: int) -> str:
        """Keep a rating; return why the session must stop, or nothing."""
        assert self._recorder is not None
        self._pain, self.ask = pain, ""
        halt = self._recorder.pain(pain)
        if self.state == "ending":
            self._close(answered=True)
        return halt

    def begin(self) -> None:
        """Another sitting begins, with a first rating of its own."""
        self.state, self._pain, self.ask = "open", None, ""
        if self._recorder is not None:
            self._recorder.open_session()

    def end(self) -> None:
        """The patient has had enough; a last rating is asked for, where it is kept."""
        self.ask = ""
        self.state = "over" if self._recorder is None else "ending"

    def note_unanswered(self) -> None:
        """The rating that was asked for at the end comes no more."""
        if self.state == "ending":
            self._close(answered=False)

    def shown(self) -> dict[str, Any]:
        """The sitting as the page shows it."""
        return {"halt": self.halted, "ask": self.ask, "pain": self._pain, "sitting": self.state}

    def _close(self, *, answered: bool) -> None:
        assert self._recorder is not None
        self.state = "over"
        self._recorder.close_session(answered=answered)


def _now() -> datetime:
    return datetime.now().astimezone()
