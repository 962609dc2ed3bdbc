"""Inspect the scans of a drive, each with its neighbours, and judge the drive as a whole."""

from __future__ import annotations

import itertools
import math
import os
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.options import threads_of
from manip3d._util.shares import binomial_tail
from manip3d._util.texts import counted
from manip3d.authenticate._extent import left_out_of_turn
from manip3d.authenticate._inspect import inspect_beside, repeating
from manip3d.authenticate._inspection import Inspection
from manip3d.authenticate._keys import KeyFile, KeyRing
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._on_lattice import LeftOut
from manip3d.authenticate._processing import STILL_COMPARED
from manip3d.authenticate._repeats import EarlierScans
from manip3d.authenticate._sequence import FRAMES_PER_SECOND, DriveEvidence, drive_evidence
from manip3d.authenticate._verdict import FALSE_ALARM_RATE, Processing, rate_of, verdict_repr
from manip3d.authenticate._watermark import Policy, Watermarker, WatermarkResult
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.authenticate._verdict import Verdict

GRAVEST_FIRST: tuple[Verdict, ...] = ("tampered", "processed", "undecidable", "no_trace")

DRIVE_RATE = 0.01
"""Largest share of clean drives that chance may make ``tampered``: by their number of episodes of
accused scans, or by their number of alarms of `drive_evidence`."""

FRAMES_PER_HOUR = 3600.0 * FRAMES_PER_SECOND

_RECURRING_DETECTORS = {"turns", "reflectance"}
"""Detectors IV and V: a false accusation by them in one turn recurs in the next."""

_MAX_NAMED = 10  # numbers of scans in a reason; further ones are only counted

_FASTER_THAN_BACKING, _MIN_MOVING, _FARTHER_THAN_BACKING = 0.5, 3, 20.0
"""A drive is ``backwards`` if it moves to the rear in all of at least _MIN_MOVING turns with
more than _FASTER_THAN_BACKING metres (18 km/h at ten turns per second), or in all turns that move
and by more than _FARTHER_THAN_BACKING metres in total: cars that reverse are slower, or stop
before."""

_MOVING = 0.05
"""Metres per turn: smaller motions may be errors of the alignment."""

_MAX_GAINED, _SAME_MOTION = 0.5, 0.2
"""Metres per turn: a larger change of motion between neighbouring turns is a jump, since it takes
five times the acceleration of gravity. Metres: largest difference between two alignments of the
same two scans (forwards and backwards)."""

_LONGER = 1.5
"""A scan is missing after an interval of more than this many median intervals. The intervals of a
scanner vary by a few hundredths."""


@checked
def inspect_drive(
    frames: Iterable[LidarFrame | None],
    *,
    lattice: SensorLattice | None = None,
    sensor: str = "auto",
    origin: ArrayLike | None = None,
    numbers: Iterable[int] | None = None,
    records: Iterable[bytes | None] | None = None,
    key: KeyFile | KeyRing | None = None,
    power: bool = True,
    printed: bool = False,
    threads: int = 0,
) -> Iterator[Inspection | None]:
    """Judge the scans of a drive, each with the previous and the following scan.

    Parameters
    ----------
    frames : iterable of LidarFrame or None
        Scans of one scanner in the order of the drive. None: a missing frame; its result is None,
        and its neighbours are judged without it.
    lattice : SensorLattice, optional
        Lattice of the scanner; default: once a scan was judged by a known lattice, that lattice is
        tried first on all later scans. A lattice that was estimated from a scan judges that scan
        alone.
    sensor, origin, power, printed, threads
        Same as for `inspect`.
    numbers : iterable of int, optional
        Number of each frame. Only frames whose numbers differ by one are neighbours, one turn
        apart; default: all frames follow each other. Differences between turns are evidence, so
        that scans of other places must not be given as neighbours.
    records : iterable of (bytes or None), optional
        Watermark record of each frame; the records are verified as one chain.
    key : KeyFile or KeyRing, optional
        Key that verifies the records.

    Yields
    ------
    Inspection or None
        One result for each frame, in their order. A frame that has nine tenths of the points of an
        earlier frame, bit for bit and in any order, is ``processed`` (repeated) unless it is
        tampered, and its ``repeats`` is the place of the earlier frame. With one thread, a result
        is yielded once the following frame was judged, because only then it is known whether that
        frame is whole; five frames are held at a time. With several threads, once the lattice is
        known, results are yielded at least as many frames later as there are threads.

    Raises
    ------
    InputError
        As `inspect`; a key is given without records; ``numbers`` or ``records`` end before the
        frames do.

    Examples
    --------
    >>> from manip3d import authenticate, forge, simulate
    >>> drive = [simulate.courtyard(x, rng=k) for k, x in enumerate((-1.0, 0.0, 1.0))]
    >>> drive[1] = forge.subtract(drive[1], forge.nearest_object(drive[1])).frame
    >>> [found.verdict for found in authenticate.inspect_drive(drive)]
    ['no_trace', 'tampered', 'no_trace']
    """
    _check_each("frames", frames, LidarFrame)
    _check_each("numbers", numbers, int, np.integer)
    _check_each("records", records, bytes)
    if lattice is not None and not isinstance(lattice, SensorLattice):
        raise InputError(f"lattice: expected a SensorLattice, got {type(lattice).__name__}")
    if key is not None and records is None:
        raise InputError("key: can only be given with the records of the frames, got none")
    return inspect_placed(
        frames, lambda _frame: origin, lattice=lattice, sensor=sensor, numbers=numbers,
        records=records, key=key, power=power, printed=printed, threads=threads,
    )  # fmt: skip


def inspect_placed(
    frames: Iterable[LidarFrame | None],
    origin_in: Callable[[LidarFrame], ArrayLike | None],
    *,
    lattice: SensorLattice | None,
    sensor: str,
    numbers: Iterable[int] | None,
    records: Iterable[bytes | None] | None,
    key: KeyFile | KeyRing | None,
    power: bool,
    printed: bool,
    threads: int,
) -> Iterator[Inspection | None]:
    """Judge a drive as `inspect_drive` does, with ``origin_in`` to tell each frame's origin.

    Frames from a map are each shifted near 0 by an amount of their own, so that one place of the
    map has other coordinates in each of them.
    """
    scans = _scans(
        _with_following(_numbered(frames, itertools.count() if numbers is None else numbers)),
        itertools.repeat(None) if records is None or key is None else iter(records),
        key,
    )
    return _each(
        scans,
        lambda frame, before, after, known, signed, left_out, cores: inspect_beside(
            frame, left_out, previous=before, following=after, lattice=known, sensor=sensor,
            origin=origin_in(frame), watermark=signed, key=None, power=power, printed=printed,
            threads=cores,
        ),
        lattice,
        threads_of(threads),
    )  # fmt: skip


def _numbered(
    frames: Iterable[LidarFrame | None], numbers: Iterable[int]
) -> Iterator[tuple[LidarFrame | None, int]]:
    """Frames with their numbers; there may be more numbers than frames, but not fewer."""
    following = iter(numbers)
    for count, frame in enumerate(frames):
        number = next(following, None)
        if number is None:
            raise InputError(f"numbers: expected one for each frame, got {count}, and more frames")
        yield frame, number


def _check_each(name: str, values: object, *kinds: type) -> None:
    """Raise InputError for unordered collections, and for lists with items of another type."""
    if isinstance(values, set | frozenset | dict | str | bytes):
        raise InputError(f"{name}: expected a sequence, got {type(values).__name__}")
    if isinstance(values, list | tuple | np.ndarray):
        for item in values:
            if item is not None and not isinstance(item, kinds):
                raise InputError(
                    f"{name}: expected {kinds[0].__name__}s, got {type(item).__name__}"
                )


@dataclass(frozen=True, eq=False)
class DriveInspection:
    """Verdict on a drive from all of its scans; see `judge_drive`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered', 'processed' or 'undecidable'
        Verdict of `verdict_of_drive`.
    reason : str
        Reason of the verdict in words, followed by the remarks.
    accused : tuple of int
        Places of the tampered scans in the drive, from 0.
    evidence : DriveEvidence
        Combined evidence of the scans.
    num_scans, num_missing : int
        Number of scans, and of scans that could not be read.
    remarks : tuple of Processing
        Findings from comparing the scans with each other. ``repeated``: scans have the points of
        earlier scans. ``missing``: the time between two scans is too long, or numbers of files are
        left out. Somebody may have removed scans, or the recorder lost them, so that this alone
        changes no verdict. ``unordered``: times go back. ``jumps``: between two turns the scanner
        moves as no car can. ``unaligned``: scans show another place than their neighbours, as in a
        drive whose order was changed, or nothing that could be aligned. ``foreign``: scans show
        another place than the scans before and after them, which show the same place; such scans
        are ``processed``. ``backwards``: the scanner moves to the rear, faster or farther than cars
        reverse; the scans may be in reverse order. Drives in reverse order without such motion, and
        drives of which scans were left out evenly and the others got new numbers and times, have no
        remark.
    """

    verdict: Verdict
    reason: str
    accused: tuple[int, ...]
    evidence: DriveEvidence
    num_scans: int
    num_missing: int
    remarks: tuple[Processing, ...] = ()

    __repr__ = verdict_repr

    def record(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "scans": self.num_scans,
            "failed": self.num_missing,
            "accused_scans": len(self.accused),
            "accused": list(self.accused),
            "remarks": [vars(remark) for remark in self.remarks],
            "evidence": {
                "judged": self.evidence.judged,
                "log10_evidence": float(self.evidence.evidence.max(initial=0.0)),
                "log10_threshold": self.evidence.threshold,
                "alarms": list(self.evidence.alarms),
                "alarms_per_hour": self.evidence.alarms_per_hour,
                "statement": self.evidence.statement,
            },
        }


@checked
def judge_drive(
    found: Sequence[Inspection | None],
    numbers: Iterable[int] | None = None,
    *,
    times_ns: Sequence[int | None] | None = None,
) -> DriveInspection:
    """Return the verdict on a drive with its accused scans, combined evidence and remarks.

    Parameters
    ----------
    found, numbers
        Same as for `verdict_of_drive`.
    times_ns : sequence of (int or None), optional
        Time of each scan, nanoseconds; None: unknown.

    Returns
    -------
    DriveInspection

    Raises
    ------
    InputError
        As `verdict_of_drive`; ``times_ns`` has another length.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate
    >>> empty = authenticate.inspect(np.zeros((0, 3), np.float32))
    >>> told = authenticate.judge_drive([empty, None])
    >>> told.verdict, told.accused, told.record()["failed"]
    ('undecidable', (), 1)
    """
    _check_each("numbers", numbers, int, np.integer)
    places = None if numbers is None else list(numbers)
    verdict, reason = verdict_of_drive(found, places)
    _check_each("times_ns", () if times_ns is None else times_ns, int, np.integer)
    if times_ns is not None and len(times_ns) != len(found):
        raise InputError(f"times_ns: expected {len(found)}, one for each scan, got {len(times_ns)}")
    times = [None if time is None else int(time) for time in (() if times_ns is None else times_ns)]
    remarks = (*_repeated(found), *_remarks_of_times(times), *_remarks_of_motion(found))
    if all(time is None for time in times):
        remarks += _remarks_of_numbers(places or ())
    return DriveInspection(
        verdict,
        "; ".join([reason, *(f"{remark.kind}: {remark.detail}" for remark in remarks)]),
        tuple(k for k, each in enumerate(found) if each and each.verdict == "tampered"),
        drive_evidence(found),
        len(found),
        sum(each is None for each in found),
        remarks,
    )


def _repeated(found: Sequence[Inspection | None]) -> tuple[Processing, ...]:
    """Remark on the scans that have the points of an earlier scan."""
    copies = [k for k, each in enumerate(found) if each is not None and each.repeats is not None]
    if not copies:
        return ()
    of = "has the points of an earlier one"
    if len(copies) > 1:
        of = "have the points of earlier ones"
    return (Processing("repeated", f"{_listed(copies)} {of}"),)


def _remarks_of_times(times_ns: Sequence[int | None]) -> tuple[Processing, ...]:
    """Remarks from the times of the scans: ``unordered`` and ``missing``."""
    timed = [(k, time) for k, time in enumerate(times_ns) if time is not None]
    steps = [(a, b, late - early) for (a, early), (b, late) in itertools.pairwise(timed)]
    back = [b for _, b, step in steps if step < 0]
    found = []
    if back:
        found.append(Processing("unordered", f"times go back at {_listed(back)}"))
    usual = sorted(step for a, b, step in steps if step > 0 and b == a + 1)
    if not usual:
        return tuple(found)
    period = usual[len(usual) // 2]
    gaps = [
        (k, more)
        for k, b, step in steps
        if (more := round(step / period) - (b - k)) > 0 and step > _LONGER * (b - k) * period
    ]
    return (*found, *_missing(gaps, f"scans are {period * 1e-9:.2f} s apart"))


def _remarks_of_motion(found: Sequence[Inspection | None]) -> tuple[Processing, ...]:
    """Remarks from the scanner's motion: ``jumps``, ``foreign``, ``unaligned``, ``backwards``."""
    steps = _steps(found)
    foreign = [k for k, each in enumerate(found) if each and each.turns and each.turns.foreign]
    remarks = (
        _jumps(steps),
        _foreign(foreign),
        _unaligned(found, foreign),
        _backwards(np.array([step[0] for step in steps.values()])),
    )
    return tuple(remark for remark in remarks if remark is not None)


def _jumps(steps: Mapping[int, NDArray[np.float64]]) -> Processing | None:
    """Remark on steps that differ from both neighbouring steps as no car can accelerate."""
    lengths = {k: float(np.linalg.norm(step, axis=-1)) for k, step in steps.items()}
    jumps = []
    for k, step in steps.items():
        beside = [other for other in (k - 1, k + 1) if other in steps]
        gained = min(
            (float(np.linalg.norm(step - steps[other], axis=-1)) for other in beside), default=0.0
        )
        if gained > _MAX_GAINED and lengths[k] >= max(lengths[other] for other in beside):
            jumps.append(k)
    if not jumps:
        return None
    farthest = max(lengths[k] for k in jumps)
    detail = (
        f"the scanner moves by up to {farthest:.1f} m in a turn (after {_listed(jumps)}), and "
        "in the turns beside as no car can: scans are missing there, or in another order"
    )
    return Processing("jumps", detail)


def _foreign(foreign: Sequence[int]) -> Processing | None:
    """Remark on the scans that show another place than the scans before and after them."""
    if not foreign:
        return None
    detail = (
        f"{_listed(foreign)} {'shows' if len(foreign) == 1 else 'show'} another place than the "
        "scans before and after, which show the same: put in between, or of another scanner"
    )
    return Processing("foreign", detail)


def _unaligned(found: Sequence[Inspection | None], foreign: Sequence[int]) -> Processing | None:
    """Remark on scans that cannot be aligned with their neighbours; foreign ones excuse these."""
    explained = {k + beside for k in foreign for beside in (-1, 0, 1)}
    apart = [
        k
        for k, each in enumerate(found)
        if each and each.turns and not each.turns.aligned and k not in explained
    ]
    if not apart:
        return None
    detail = (
        f"{_listed(apart)} cannot be aligned with the scans before and after: they are in "
        "another order there, of another place, or show nothing to align them by"
    )
    return Processing("unaligned", detail)


def _backwards(ahead: NDArray[np.float64]) -> Processing | None:
    """Remark on a scanner that moves backwards; ``ahead``: its steps forwards, metres per turn."""
    fast = ahead[np.abs(ahead) > _FASTER_THAN_BACKING]
    moving = ahead[np.abs(ahead) > _MOVING]
    is_fast = len(fast) >= _MIN_MOVING and bool((fast < 0.0).all())
    is_far = bool((moving < 0.0).all()) and float(-moving.sum()) > _FARTHER_THAN_BACKING
    if not is_fast and not is_far:
        return None
    of = fast if is_fast else moving
    detail = (
        f"the scanner moves backwards by {-np.median(of):.1f} m a turn wherever it moves "
        f"({len(of)} turns): the scans are in the reverse order, or it looks to the rear"
    )
    return Processing("backwards", detail)


def _steps(found: Sequence[Inspection | None]) -> dict[int, NDArray[np.float64]]:
    """Motion to the next scan, in each scan's coordinates, if both scans' alignments agree."""
    steps = {}
    for k, (each, after) in enumerate(itertools.pairwise(found)):
        if each is None or after is None or each.turns is None or after.turns is None:
            continue
        there_and_back = product(each.turns.following, after.turns.previous)
        if np.linalg.norm(there_and_back[:3, 3], axis=-1) < _SAME_MOTION:
            steps[k] = each.turns.following[:3, 3]
    return steps


def _remarks_of_numbers(numbers: Sequence[int]) -> tuple[Processing, ...]:
    """Remark on missing scans from gaps in numbers that are otherwise consecutive."""
    steps = [b - a for a, b in itertools.pairwise(numbers)]
    if 1 not in steps:
        return ()  # no sequence: `drive_numbers` then makes no scans neighbours
    gaps = [(k, step - 1) for k, step in enumerate(steps) if step > 1]
    return _missing(gaps, "by the numbers in the names of their files")


def _missing(gaps: Sequence[tuple[int, int]], told_by: str) -> tuple[Processing, ...]:
    if not gaps:
        return ()
    total = sum(number for _, number in gaps)
    places = _listed([k for k, _ in gaps])
    scans = "scan is" if total == 1 else "scans are"
    return (Processing("missing", f"{total} {scans} missing after {places} ({told_by})"),)


@checked
def verdict_of_drive(
    found: Sequence[Inspection | None], numbers: Iterable[int] | None = None
) -> tuple[Verdict, str]:
    """Return the verdict on a drive from all of its scans, and the reason.

    Parameters
    ----------
    found : sequence of Inspection or None
        Inspections in the order of the drive. None: a missing frame, which counts as undecidable.
    numbers : iterable of int, optional
        Number of each scan, as in `inspect_drive`: scans whose numbers differ by one are one turn
        apart; default: all follow each other.

    Returns
    -------
    (verdict, reason)
        ``tampered`` if scans are accused and chance does not explain it; else ``processed`` if a
        scan is; else ``undecidable`` if a scan is accused or undecidable, or if there is no scan;
        else ``no_trace``. The reason names the places of accused scans in ``found``, from 0.

    Raises
    ------
    InputError
        ``found`` holds something else than inspections and None; ``numbers`` has another length.

    Notes
    -----
    One clean scan in 100 may be accused by chance. Only scans that a detector judged count: the
    others cannot be accused by chance, and must not excuse accused scans. Detectors I and II state
    no p-value; for each scan that they judge, the rate of 1 % is assumed that `inspect` states for
    all detectors together. Chance does not explain

    - a watermark that accuses a scan;
    - a scan with so much evidence of detector III, by its ``model_p_value``, that only one clean
      drive in a thousand has such a scan (Bonferroni over the judged scans);
    - as many episodes of accused scans as at most one clean drive in a hundred has (binomial law).
      A scan that only detectors IV and V accuse belongs to the episode of the previous turn if that
      is accused as well, because a false accusation by them recurs in the next turn. Every other
      accused scan begins an episode;
    - as many alarms of `drive_evidence` as at most one clean drive in a hundred has, at one alarm
      per hour: one within 36 s, or five within an hour.

    If episodes are independent, at most 2.1 % of clean drives of any length are called tampered; if
    N < 360 scans were judged, at most 1.1 % + N / 36000. If only detectors IV and V see the edit of
    a single scan, a long drive becomes undecidable: look at that scan.

    Examples
    --------
    >>> from manip3d import authenticate, simulate
    >>> drive = [simulate.courtyard(x, rng=k) for k, x in enumerate((-0.5, 0.5))]
    >>> found = list(authenticate.inspect_drive(drive))
    >>> authenticate.verdict_of_drive(found)
    ('no_trace', '2 of 2 scans')
    >>> authenticate.verdict_of_drive([*found, None])  # a missing frame
    ('undecidable', '1 of 3 scans')
    """
    _check_each("numbers", numbers, int, np.integer)
    places = list(range(len(found)) if numbers is None else numbers)
    if len(places) != len(found):
        raise InputError(f"numbers: expected {len(found)}, one for each scan, got {len(places)}")
    verdicts: Counter[str] = Counter(
        "undecidable" if each is None else each.verdict for each in found
    )
    verdict: Verdict = next((each for each in GRAVEST_FIRST if verdicts[each]), "undecidable")
    if len(found) == 0:
        return verdict, "there are no scans"
    if verdict != "tampered":
        return verdict, f"{verdicts[verdict]} of {len(found)} scans"
    accused = {
        k: each for k, each in enumerate(found) if each is not None and each.verdict == verdict
    }
    told = f"{len(accused)} of {len(found)} scans accused ({_listed(list(accused))})"
    for number, each in accused.items():
        if "watermark" in _accusers(each):
            return verdict, f"{told}: the watermark of number {number} does not hold"
    if (why := _why_no_chance(found, accused, places)) is not None:
        expected = drive_evidence(found).judged / FRAMES_PER_HOUR
        share = DRIVE_RATE + rate_of("generic") + min(DRIVE_RATE, expected)
        return verdict, f"{told}: {why}; of clean drives as long {share:.1%} at most are called so"
    judged = sum(_could_be_accused(each) for each in found)
    return (
        "processed" if verdicts["processed"] else "undecidable",
        f"{told}, which chance explains: the detectors together may accuse {FALSE_ALARM_RATE:.0%} "
        f"of clean scans, {FALSE_ALARM_RATE * judged:.1f} of the {judged} that were judged; look "
        "at each of them",
    )


def _listed(numbers: Sequence[int]) -> str:
    named = ", ".join(str(number) for number in numbers[:_MAX_NAMED])
    more = f" and {len(numbers) - _MAX_NAMED} more" if len(numbers) > _MAX_NAMED else ""
    return f"number {named}{more}" if len(numbers) == 1 else f"numbers {named}{more}"


def _accusers(found: Inspection) -> set[str]:
    """Names of the detectors that call a scan tampered."""
    return {report.name for report in found.detectors if report.verdict == "tampered"}


def _why_no_chance(
    found: Sequence[Inspection | None], accused: Mapping[int, Inspection], places: Sequence[int]
) -> str | None:
    """The reason why chance does not explain the accused scans; None if chance explains them."""
    judged = sum(_could_be_accused(each) for each in found)
    for number, each in accused.items():
        for report in each.detectors:
            is_of_lattice = report.name == "generic" and report.verdict == "tampered"
            p_value = report.least_p_value if is_of_lattice else None
            if p_value is not None and p_value * judged <= rate_of("generic"):
                return f"in number {number}, {report.reason}"
    together = drive_evidence(found)
    alarms = together.alarms
    if alarms and share_with_alarms(len(alarms), together.judged) <= DRIVE_RATE:
        told = f"an alarm at number {alarms[0]}"
        if len(alarms) > 1:
            told = f"{len(alarms)} alarms, the first at number {alarms[0]}"
        return f"the evidence of successive scans adds up to {told}"
    episodes = sum(
        number - 1 not in accused
        or places[number] != places[number - 1] + 1
        or not _accusers(each) <= _RECURRING_DETECTORS
        for number, each in accused.items()
    )
    if binomial_tail(episodes, judged, FALSE_ALARM_RATE) <= DRIVE_RATE * (1.0 + 1e-9):
        return f"{counted(episodes, 'episode')} are more than chance has"
    return None


def share_with_alarms(alarms: int, judged: int) -> float:
    """Return an upper bound of the share of clean drives with this many alarms of `drive_evidence`.

    Clean drives have at most one alarm per hour (36000 scans). The time to the next alarm is below
    ``n`` scans no more often than a time that is uniform over one hour, whatever happened before.
    The sum of ``k`` such times is therefore below ``N`` scans with a probability of at most ``(N /
    36000)**k / k!``.

    Parameters
    ----------
    alarms, judged : int
        Number of alarms, and of scans that were judged.
    """
    expected = judged / FRAMES_PER_HOUR
    if alarms == 0 or expected == 0.0:
        return 1.0 if alarms == 0 else 0.0
    return min(1.0, math.exp(alarms * math.log(expected) - math.lgamma(alarms + 1)))


def _could_be_accused(found: Inspection | None) -> bool:
    """Whether a detector that may accuse a clean scan judged this one.

    A scan that no detector judged cannot be accused by chance; if it counted, it would excuse
    accused scans. A watermark never accuses a clean scan.
    """
    return found is not None and any(
        report.p_value is not None or report.verdict in ("no_trace", "tampered")
        for report in found.detectors
        if report.name != "watermark"
    )


_Numbered = tuple["LidarFrame | None", int]


def _with_following(
    frames: Iterator[_Numbered],
) -> Iterator[tuple[_Numbered, _Numbered | None]]:
    """Each frame with its number, and the following frame with its number."""
    ahead, behind = itertools.tee(frames)
    next(behind, None)
    return zip(ahead, itertools.chain(behind, [None]), strict=False)


@dataclass
class _Scan:
    """A scan of a drive while it is judged; ``turns`` is empty if it could not be read."""

    turns: tuple[LidarFrame | None, ...] = ()  # this frame, previous, following
    signed: WatermarkResult | None = None
    repeat: tuple[int, str] | None = None
    lattice: SensorLattice | None = None
    found: Future[Inspection] | Inspection | None = None

    def result(self) -> Inspection | None:
        """The frame's inspection, made as if the neighbouring turns were whole."""
        if isinstance(self.found, Future):
            self.found = self.found.result()
        return self.found


def _scans(
    pairs: Iterator[tuple[_Numbered, _Numbered | None]],
    records: Iterator[bytes | None],
    key: KeyFile | KeyRing | None,
) -> Generator[_Scan, None, None]:
    """Each scan with its neighbours, the result of its watermark, and the earlier scan it repeats.

    Watermarks are verified in the order of the scans.
    """

    def beside(other: _Numbered | None, number: int) -> LidarFrame | None:
        return None if other is None or other[1] != number else other[0]

    earlier = EarlierScans()
    before: _Numbered | None = None
    with ExitStack() as stack:
        verifier = None if key is None else stack.enter_context(closing(Watermarker(key)))
        for place, ((frame, number), after) in enumerate(pairs):
            try:
                record = next(records)
            except StopIteration:
                raise InputError(
                    f"records: expected one for each frame, got {place}, and more frames"
                ) from None
            scan = _Scan()
            if frame is not None:
                if not isinstance(frame, LidarFrame):
                    raise InputError(f"frames: expected LidarFrames, got {type(frame).__name__}")
                scan.turns = frame, beside(before, number - 1), beside(after, number + 1)
                if verifier is not None and record is not None:
                    scan.signed = verifier.verify(frame, record, policy=Policy(order="any"))
                scan.repeat = earlier.repeated(frame.points, place)
            yield scan
            before = frame, number


class _Judges:
    """Judges a drive: frame by frame until the lattice is known, then one frame per thread."""

    def __init__(
        self, judge: Callable[..., Inspection], lattice: SensorLattice | None, threads: int
    ) -> None:
        self._judge, self._lattice, self._threads = judge, lattice, threads
        self.number = threads or len(os.sched_getaffinity(0))
        self._pool = ThreadPoolExecutor(self.number)  # starts threads when they are first needed

    def begin(self, scan: _Scan) -> None:
        """Judge a scan as if its neighbours were whole, here or on another thread."""
        if not scan.turns:
            return
        scan.lattice = self._lattice
        if self.number > 1 and self._lattice is not None:
            scan.found = self._pool.submit(self._judged, scan, _taken_for_whole, 1)
            return
        found = self._judged(scan, _taken_for_whole, self._threads)
        if self._lattice is None and found.sensor is not None and not found.sensor.is_own:
            self._lattice = found.sensor.lattice
        scan.found = found

    def settled(self, scan: _Scan, *beside: _Scan | None) -> Inspection | None:
        """The inspection of a scan, repeated with regard to cuts if a neighbour is not whole."""
        found = scan.result()
        results = [None if other is None else other.result() for other in beside]
        if found is None or found.turns is None or all(map(_is_whole, results)):
            return found
        return self._judged(scan, left_out_of_turn, self._threads)

    def _judged(self, scan: _Scan, left_out: LeftOut, threads: int) -> Inspection:
        found = self._judge(*scan.turns, scan.lattice, scan.signed, left_out, threads)
        return repeating(found, scan.repeat)

    def close(self) -> None:
        """Cancel the inspections that have not begun."""
        self._pool.shutdown(cancel_futures=True)


def _each(
    scans: Generator[_Scan, None, None],
    judge: Callable[..., Inspection],
    lattice: SensorLattice | None,
    threads: int,
) -> Iterator[Inspection | None]:
    """Yield each inspection once the following scan was judged, as that may be cut."""
    last: _Scan | None = None
    waiting: deque[_Scan] = deque()

    def first_settled() -> Inspection | None:
        nonlocal last
        now = waiting.popleft()
        found = judges.settled(now, last, waiting[0] if waiting else None)
        now.turns, last = (), now
        return found

    with closing(scans), closing(_Judges(judge, lattice, threads)) as judges:
        for scan in scans:
            judges.begin(scan)
            waiting.append(scan)
            while len(waiting) > 1 and (
                len(waiting) > judges.number + 1 or not isinstance(waiting[1].found, Future)
            ):
                yield first_settled()
        while waiting:
            yield first_settled()


def _taken_for_whole(_turn: LidarFrame, _lattice: SensorLattice) -> None:
    """Stand in for `left_out_of_turn`: take a turn to be whole until its own inspection is done."""


def _is_whole(turn: Inspection | None) -> bool:
    """Whether nothing shows that points were removed from a turn; also true if there is no turn."""
    return turn is None or (
        turn.verdict in ("no_trace", "tampered", "processed")
        and all(step.kind in (*STILL_COMPARED, "neighbours", "foreign") for step in turn.processing)
    )
