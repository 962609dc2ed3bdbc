"""SVG charts over the days of a study: points, a least-squares line and its 95 % interval."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Self

import numpy as np

from manip3d._util.extras import imported
from manip3d.diary._analysis import Estimate, fit_slope
from manip3d.diary._records import DiarySession, local_day

_GRID, _BLUE, _RED = "#d5dbe3", "#1d6fb8", "#a02b1d"
_LEFT, _TOP, _BOTTOM = 34.0, 12.0, 26.0
_STEPS = (1, 2, 7, 14, 28, 56, 91, 182, 364)  # days between marks; whole weeks if possible


@dataclass(frozen=True)
class Point:
    """A value at a time in days since the enrolment, which may be fractional."""

    day: float
    value: float
    at: datetime

    @classmethod
    def of(cls, at: datetime, start: datetime, value: float) -> Self:
        return cls((at - start).total_seconds() / 86400, value, at)


def require_scipy() -> None:
    """Raise MissingExtraError if SciPy, which computes the intervals, is not installed."""
    imported("scipy.special", "diary")


def change_a_week(points: Sequence[Point]) -> Estimate | None:
    """Return the slope of the least-squares line in units per week.

    None: there are fewer than three points, or all are of the same day.
    """
    slope = _slope(points)
    if slope is None:
        return None
    return replace(slope, value=7 * slope.value, low=7 * slope.low, high=7 * slope.high)


def _slope(points: Sequence[Point]) -> Estimate | None:
    if len({local_day(point.at) for point in points}) < 2:  # one day has no trend over weeks
        return None
    days, values = np.array([[p.day, p.value] for p in points]).reshape(-1, 2).T
    return fit_slope(days, values)


@dataclass(frozen=True)
class _Axes:
    """Axes of a chart, which map days and values to image coordinates."""

    wide: float
    high: float
    first: float
    last: float
    top: float

    def x(self, day: float) -> float:
        share = (day - self.first) / (self.last - self.first)
        return _LEFT + 8 + share * (self.wide - _LEFT - 20)

    def y(self, value: float) -> float:
        inside = min(max(value / self.top, 0.0), 1.0)
        return _TOP + (self.high - _TOP - _BOTTOM) * (1 - inside)

    def grid(self) -> list[str]:
        drawn = []
        for value in (0.0, self.top / 2, self.top):
            y = self.y(value)
            drawn.append(
                f'<line x1="{_LEFT}" x2="{self.wide}" y1="{y:.1f}" y2="{y:.1f}" stroke="{_GRID}"/>'
                f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{value:g}</text>'
            )
        step = next((s for s in _STEPS if (self.last - self.first) / s <= 8), _STEPS[-1])
        for day in range(step * math.ceil(self.first / step), math.floor(self.last) + 1, step):
            x, low = self.x(day), self.high - _BOTTOM
            drawn.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{low}" y2="{low + 4}" stroke="{_GRID}"/>'
                f'<text x="{x:.1f}" y="{low + 17}" text-anchor="middle">{day}</text>'
            )
        return drawn

    def svg(self, label: str, drawn: Sequence[str]) -> str:
        return (
            f'<svg viewBox="0 0 {self.wide:g} {self.high:g}" role="img" '
            f'aria-label="{html.escape(label)}">' + "".join([*self.grid(), *drawn]) + "</svg>"
        )


def trend(
    title: str, points: Sequence[Point], *, first: float, last: float, top: float | None
) -> str:
    """Draw points over the days ``first`` to ``last``, with their line if there are three.

    ``top``: upper end of the axis; None: the largest value of the points.
    """
    most = max(point.value for point in points)
    axes = _Axes(420.0, 190.0, first, last, top or _round_up(most))
    slope = _slope(points)
    told = "Fewer than three points, or all of one day: no line."
    drawn = []
    if slope is not None:
        drawn = _line(axes, points, slope)
        value, low, high = (_signed(7 * one) for one in (slope.value, slope.low, slope.high))
        told = f"In a week {value} (95 %: {low} to {high})."
    drawn += [
        f'<circle cx="{axes.x(p.day):.1f}" cy="{axes.y(p.value):.1f}" r="3.5" fill="{_BLUE}">'
        f"<title>{p.at:%Y-%m-%d %H:%M}: {p.value:.3g}</title></circle>"
        for p in points
    ]
    label = f"{title}, over days. {told}"
    return (
        f'<figure class="trend"><figcaption><b>{html.escape(title)}</b></figcaption>'
        f"{axes.svg(label, drawn)}<figcaption>{told}</figcaption></figure>"
    )


def _signed(value: float) -> str:
    """Format a number with its sign and two significant digits, or as an integer; no exponent."""
    if abs(value) < 1e-4:
        return "+0"
    return f"{value:+.0f}" if abs(value) >= 10 else f"{value:+.2g}"


def _round_up(value: float) -> float:
    """Round up to 1, 2, 4, 6 or 10 times a power of ten, whose half is round, too; at least 1."""
    if value <= 1:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1, 2, 4, 6, 10) if value <= m * power)


def _line(axes: _Axes, points: Sequence[Point], slope: Estimate) -> list[str]:
    """Draw the line and its confidence band.

    The half width of the band is t s sqrt(1/n + (x - mean)^2 / Sxx), where t s / sqrt(Sxx) is half
    the width of the slope's interval.
    """
    days = np.array([point.day for point in points])
    middle, level = float(days.mean()), float(np.mean([point.value for point in points]))
    spread = float(np.sum((days - middle) ** 2)) / len(days)  # Sxx / n
    at = np.linspace(days.min(), days.max(), 25)
    value = level + slope.value * (at - middle)
    half = (slope.high - slope.value) * np.sqrt(spread + (at - middle) ** 2)
    upper = [f"{axes.x(d):.1f},{axes.y(v):.1f}" for d, v in zip(at, value + half, strict=True)]
    lower = [f"{axes.x(d):.1f},{axes.y(v):.1f}" for d, v in zip(at, value - half, strict=True)]
    ends = (axes.x(at[0]), axes.y(value[0]), axes.x(at[-1]), axes.y(value[-1]))
    x1, y1, x2, y2 = (f"{end:.1f}" for end in ends)
    return [
        f'<polygon points="{" ".join([*upper, *reversed(lower)])}" fill="{_BLUE}" opacity="0.15"/>',
        f'<line x1="{x1}" x2="{x2}" y1="{y1}" y2="{y2}" stroke="{_BLUE}" stroke-width="2"/>',
    ]


def pain_chart(sessions: Sequence[DiarySession], start: datetime) -> str:
    """Draw each session as a line from the rating before (hollow) to after (filled).

    The line is red if the pain rose by 2 or more.
    """
    rated = [s for s in sessions if s.pain_before is not None or s.pain_after is not None]
    if not rated:
        return "<p>No session has a rating of the pain yet.</p>"
    days = [Point.of(session.started, start, 0).day for session in rated]
    axes = _Axes(860.0, 230.0, min([0.0, *days]), max([7.0, *days]), 10.0)
    drawn = [_pain_of(axes, session, day) for session, day in zip(rated, days, strict=True)]
    return (
        axes.svg("Pain from 0 to 10, before and after each session, over days", drawn)
        + '\n<p class="quiet">One mark a session, by days since the enrolment, from 0 (none) to 10 '
        "(the worst): hollow before it, filled after it; red where the pain rose by 2 or more.</p>"
    )


def _pain_of(axes: _Axes, session: DiarySession, day: float) -> str:
    x, before, after = axes.x(day), session.pain_before, session.pain_after
    color, drawn = _BLUE, []
    if before is not None and after is not None:
        color = _RED if after >= before + 2 else _BLUE
        drawn.append(
            f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{axes.y(before):.1f}" y2="{axes.y(after):.1f}" '
            f'stroke="{color}" stroke-width="3"/>'
        )
    words = [str(pain) if pain is not None else "-" for pain in (before, after)]
    title = f"<title>{session.started:%Y-%m-%d %H:%M}: {words[0]} to {words[1]}</title>"
    drawn += [
        f'<circle cx="{x:.1f}" cy="{axes.y(pain):.1f}" r="5" fill="{fill}" stroke="{color}" '
        f'stroke-width="2">{title}</circle>'
        for pain, fill in ((before, "#ffffff"), (after, color))
        if pain is not None
    ]
    return "".join(drawn)
