"""Times in which a player scored nothing though they could have."""

from __future__ import annotations

from dataclasses import dataclass

from manip3d.phantom.games import GameState, can_reach

ANOMALY_S = 10.0
"""Seconds of play without a point while a target was in reach."""


@dataclass(frozen=True)
class Anomaly:
    """A time without a point; seconds of play.

    Attributes
    ----------
    start, end : float
        From the first moment with something in reach to the next point, or the end of the game.
    """

    start: float
    end: float


class AnomalyWatch:
    """Follows one game from step to step.

    Attributes
    ----------
    found : list of Anomaly
        Anomalies that are over; `finish` adds the one that still goes on.

    Examples
    --------
    >>> AnomalyWatch().found
    []
    """

    def __init__(self) -> None:
        self.found: list[Anomaly] = []
        self._clock = 0.0
        self._score = 0
        self._start: float | None = None
        self._idle = 0.0

    @property
    def since(self) -> float | None:
        """When that began which may become an anomaly; None: nothing has."""
        return self._start

    def update(self, state: GameState) -> None:
        """Take the state after a step."""
        before, self._clock = self._clock, state.clock
        if state.score > self._score:
            self._score = state.score
            self.finish()
        elif can_reach(state):
            self._start = before if self._start is None else self._start
            self._idle += state.clock - before

    def finish(self) -> None:
        """A point was made, or the game is over."""
        if self._start is not None and self._idle >= ANOMALY_S - 1e-6:
            self.found.append(Anomaly(round(self._start, 3), round(self._clock, 3)))
        self._start, self._idle = None, 0.0
