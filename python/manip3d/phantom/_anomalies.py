"""Times in which a player scored nothing although a target was in reach."""

from __future__ import annotations

from dataclasses import dataclass

from manip3d.phantom.games import GameState, can_reach

ANOMALY_S = 10.0
"""Shortest anomaly: seconds of play without a point despite a target in reach."""


@dataclass(frozen=True)
class Anomaly:
    """A time without a point although a target was in reach, in seconds of play.

    Attributes
    ----------
    start, end : float
        Start, when a target came into reach, and end, at the next point or the end of the game.
    """

    start: float
    end: float


class AnomalyWatch:
    """Finds the anomalies of a game, step by step.

    Attributes
    ----------
    found : list of Anomaly
        Anomalies that have ended; `finish` adds the current one.

    Examples
    --------
    >>> from manip3d.phantom._anomalies import AnomalyWatch
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
        """Start of the current time without a point, which may become an anomaly, or None."""
        return self._start

    def update(self, state: GameState) -> None:
        """Add the state after a step."""
        before, self._clock = self._clock, state.clock
        if state.score > self._score:
            self._score = state.score
            self.finish()
        elif can_reach(state):
            self._start = before if self._start is None else self._start
            self._idle += state.clock - before

    def finish(self) -> None:
        """End the current time without a point, by a point or the end of the game."""
        if self._start is not None and self._idle >= ANOMALY_S - 1e-6:
            self.found.append(Anomaly(round(self._start, 3), round(self._clock, 3)))
        self._start, self._idle = None, 0.0
