"""Find columns of an exact cloud whose azimuths slipped by counts finer than the scanner's steps.

A *column* is the points of all lasers that fired at one count of the encoder, a *slot* one of the
steps of azimuth of a laser.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d.authenticate._rings import MIN_EXACT

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TypeAlias

    from numpy.typing import NDArray

    Floats: TypeAlias = NDArray[np.float64]
    Slots: TypeAlias = NDArray[np.bool_]

APART = 8.0
"""Neighbouring steps are distinguished where they are at least APART tolerances apart."""

ASIDE = 20.0
"""Degrees: largest difference of the azimuths of two lasers of a column. It is at most 18 for the
scanners of `EXACT_STEPS`."""

MIN_SLIPPED, DENSE = 0.5, 0.75
"""Columns slipped if at least the share MIN_SLIPPED of the lasers is beside its steps, of those
that return at least DENSE times as many points near the slipped columns as the laser with most."""

CONTINUES, MIN_CONTINUED = 0.05, 0.2
"""CONTINUES: largest difference of neighbouring ranges on a surface, as a share of the range.
MIN_CONTINUED: least share of the ends of slipped columns at which a surface goes on. In 21
simulated clouds of three scanners with slips it is at least 0.27. In 24 simulated clouds of a
PandarXT-32 on open land into which an object was put, turned by finer steps, it is 0."""


class Placed(NamedTuple):
    """Points of an exact cloud on the steps of azimuth of their lasers, one row each."""

    rho: Floats
    """Distance from the axis, metres."""
    laser: NDArray[np.intp]
    slot: NDArray[np.intp]
    """Nearest step, from 0 to one less than the number of steps."""
    error: Floats
    """Distance from it along the arc, metres."""
    frame: NDArray[np.intp]
    """Number of the scan."""


def steps_of_slips(points: Placed, steps: int, finer: Sequence[int], tolerance: float) -> int:
    """Return the number of steps per turn on which slipped columns stand, too.

    Drivers of spinning scanners occasionally state the azimuth of a column one count of the encoder
    beside its place. An object that was turned about the scanner stands on finer steps as well, but
    other lasers of its columns do not.

    Parameters
    ----------
    points : Placed
        Points on the lines of the lattice.
    steps : int
        Number of steps per turn on which most points stand.
    finer : sequence of int
        Numbers of steps that are tried, the least first; those that are no multiple of ``steps``
        are ignored.
    tolerance : float
        Metres: largest distance of points from a step on which they stand.

    Returns
    -------
    int
        ``steps`` if no columns slipped.
    """
    off = np.abs(points.error) > tolerance
    if not off.any():
        return steps
    for number in finer:
        if number <= steps or number % steps:
            continue
        step = points.rho * (2.0 * math.pi / number)
        is_apart = step > APART * tolerance
        beside = np.round(points.error / step)
        slipped = off & is_apart & (np.abs(points.error - beside * step) < tolerance)
        fewest = MIN_EXACT * np.count_nonzero(off & is_apart)
        if slipped.any() and np.count_nonzero(slipped) >= fewest:
            ratio = number // steps
            # Points half a step beside theirs have the same slot in all lasers.
            slot = points.slot + (beside.astype(np.intp) + ratio // 2) // ratio
            placed = points._replace(slot=np.mod(slot, steps))
            columns, turn = _in_columns(placed, ~off, steps)
            moved, kept = (_slots(columns, of, turn) for of in (slipped, ~off & is_apart))
            goes_on = _continue_beside(moved, _ranges(columns, turn))
            return number if goes_on and _are_columns(moved, kept) else steps
    return steps


def _in_columns(points: Placed, kept: NDArray[np.bool_], steps: int) -> tuple[Placed, int]:
    """The points with slots numbered by columns, if these are several steps apart.

    The second item is the number of such slots per turn. A column that slipped stays nearest to
    its place, and an object that was turned to between two columns shares the slots of one.
    """
    order = np.lexsort((points.slot[kept], points.frame[kept], points.laser[kept]))
    apart = np.diff(points.slot[kept][order])
    spacing = int(np.bincount(apart[apart > 0], minlength=2).argmax())
    if spacing < 2 or steps % spacing:
        return points, steps
    lasers = int(points.laser.max()) + 1
    votes = np.zeros((lasers, spacing), np.intp)
    np.add.at(votes, (points.laser[kept], points.slot[kept] % spacing), 1)
    first = votes.argmax(axis=1)[points.laser]
    turn = steps // spacing
    column = (points.slot - first + spacing // 2) // spacing
    return points._replace(slot=np.mod(column, turn)), turn


def _slots(points: Placed, which: NDArray[np.bool_], steps: int) -> Slots:
    """Which slots have such a point; of each laser, scan and step."""
    lasers = int(points.laser.max(initial=0)) + 1
    found = np.zeros((lasers, int(points.frame.max(initial=0)) + 1, steps), np.bool_)
    found[points.laser[which], points.frame[which], points.slot[which]] = True
    return found


def _ranges(points: Placed, steps: int) -> Floats:
    """Distance from the axis in each slot; of each laser, scan and step; NaN without a point."""
    lasers = int(points.laser.max(initial=0)) + 1
    found = np.full((lasers, int(points.frame.max(initial=0)) + 1, steps), np.nan)
    found[points.laser, points.frame, points.slot] = points.rho
    return found


def _continue_beside(slipped: Slots, ranges: Floats) -> bool:
    """Whether surfaces mostly go on from slipped slots to the slots beside them that did not slip.

    A slip of the encoder changes no range. An object that was put in begins and ends with a jump,
    or beside slots without a return.
    """
    ends = going_on = 0
    for side in (-1, 1):
        is_end = slipped & ~np.roll(slipped, side, axis=-1)
        beside = np.roll(ranges, side, axis=-1)
        ends += int(np.count_nonzero(is_end))
        with np.errstate(invalid="ignore"):
            goes_on = np.abs(beside - ranges) < CONTINUES * ranges
        going_on += int(np.count_nonzero(is_end & goes_on))
    return going_on >= MIN_CONTINUED * ends


def _are_columns(slipped: Slots, kept: Slots) -> bool:
    """Whether the slots beside their steps make whole columns, which no slot contradicts.

    A slot contradicts it if its laser is on a step in a column that slipped, or beside one in a
    column that did not. None does in 21 simulated clouds of three scanners in a street, of which
    one column to a fifth of the columns slipped. Of 8 clouds of a PandarXT-32 and a QT64 with an
    object that was turned about the scanner by finer steps, 2 to 694 do in seven, and none has a
    point beside the steps in the eighth.

    The order of the lasers' azimuths within a column is unknown. Each laser is therefore turned to
    where it agrees best with those before it.
    """
    if (kept & slipped).any():
        return False
    reach = math.ceil(ASIDE / 360.0 * slipped.shape[-1])
    if not _most_lasers_slipped(slipped, kept, reach):
        return False
    leader, *others = np.argsort(-slipped.sum(axis=(1, 2)), kind="stable").tolist()
    columns, still = slipped[leader].copy(), kept[leader].copy()
    for k in others:
        own, quiet = slipped[k], kept[k]
        turn = _best_turn(own, quiet, columns, still, reach)
        own, quiet = np.roll(own, -turn, axis=-1), np.roll(quiet, -turn, axis=-1)
        if (own & still).any() or (quiet & columns).any():
            return False
        columns |= own
        still |= quiet
    return True


def _most_lasers_slipped(slipped: Slots, kept: Slots, reach: int) -> bool:
    """Whether most lasers with returns near the slipped slots have slipped slots."""
    columns = slipped.any(axis=0)
    window = np.zeros(columns.shape[-1])
    window[np.arange(-reach, reach + 1) % len(window)] = 1.0
    around = np.fft.irfft(np.fft.rfft(columns) * np.fft.rfft(window), n=len(window))
    returns = ((slipped | kept) & (around > 0.5)).sum(axis=(1, 2))
    dense = returns >= DENSE * returns.max()
    have_slips = slipped.reshape(len(slipped), -1).any(axis=1)
    return bool(np.sum(have_slips & dense) >= MIN_SLIPPED * np.sum(dense))


def _best_turn(own: Slots, quiet: Slots, columns: Slots, still: Slots, reach: int) -> int:
    """Number of slots by which a laser looks ahead of the columns, with the fewest conflicts."""
    size = own.shape[-1]
    there = np.fft.rfft(columns).conj()
    agreed = np.fft.rfft(own) * (there - np.fft.rfft(still).conj())
    score = np.fft.irfft((agreed - np.fft.rfft(quiet) * there).sum(axis=0), n=size)
    turns = np.arange(-reach, reach + 1)
    return int(turns[np.rint(score[turns % size]).argmax()])
