"""Verdicts, regions, power and other types that the results of all detectors share."""

from __future__ import annotations

import bisect
import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.showing import Showable
from manip3d.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from manip3d.lidar import Box

Verdict: TypeAlias = Literal["no_trace", "tampered", "processed", "undecidable"]
"""``no_trace``: a detector that finds edits of this scanner found no evidence. It is not a proof of
authenticity, which only a keyed watermark gives. ``tampered``: localised evidence of an edit at a
stated false-alarm rate. ``processed``: the whole scan was changed (shuffled, rounded, cropped,
deskewed ...). ``undecidable``: the detector cannot judge the scan, and does not guess."""


FALSE_ALARM_RATE = 0.01
"""Largest share of clean scans that all detectors of `inspect` together may call tampered."""

RATE_SHARES: Mapping[str, float] = ReadOnlyMapping(
    {"generic": 0.1, "turns": 0.7, "reflectance": 0.2}
)
"""Part of that rate for each detector of a spinning scanner. The rate of all detectors together is
at most the sum of their rates (Bonferroni), also if they are correlated. The part of a detector
that cannot judge is not used. The split was chosen on the frames that fix the thresholds, before
rates were measured on others. Detector III recognises clean scans by the lattice and needs the
smallest part; detector V is seldom wrong; and dark cars that absorb pulses resemble the edits that
detector IV looks for, which therefore needs the largest."""


def rate_of(detector: str, false_alarm_rate: float = FALSE_ALARM_RATE) -> float:
    """Return the false-alarm rate of one detector, as a part of that of the whole scan.

    Parameters
    ----------
    detector : 'generic', 'turns' or 'reflectance'
    false_alarm_rate : float
        False-alarm rate of all detectors together.
    """
    return RATE_SHARES[detector] * false_alarm_rate


LOG_ROUNDING = 1e-9
"""Difference of log10 probabilities that counts as none. The last bits of libm's logarithms depend
on the processor, and a probability may equal the rate with which it is compared."""


def is_alarm(log10_p: float, false_alarm_rate: float) -> bool:
    """Return whether a p-value does not exceed a rate by more than `LOG_ROUNDING`."""
    return log10_p <= math.log10(false_alarm_rate) + LOG_ROUNDING


def verdict_repr(self: Any) -> str:
    """Return the ``repr`` of a result that has a verdict and its reason."""
    return f"<manip3d.authenticate.{type(self).__name__}: {self.verdict}; {self.reason}>"


@dataclass(frozen=True)
class Calibration:
    """Clean scans on which the thresholds of a detector were chosen or tested.

    Attributes
    ----------
    scenes : str
        Clean scans on which the thresholds were chosen, if ``chose``, else on which they were
        tested. Reported rates are measured on other scans than those that chose thresholds.
    num_scans : int
        Number of these scans.
    false_alarms : int
        Number of these scans that are called tampered with the thresholds.
    note : str
        Limits of the calibration: scanners and scenes that it does not cover.
    chose : bool
        Whether the thresholds were chosen on these scans. False: they follow from how the scanner
        measures.
    """

    scenes: str
    num_scans: int
    false_alarms: int
    note: str = ""
    chose: bool = True


PLANTED_HERE = "edits planted in this scan"
"""Source of a power that is known from copies of the inspected scan only."""


@dataclass(frozen=True)
class Power:
    """Share of the edits of one class that a detector finds.

    Attributes
    ----------
    found, planted : int
        Number of edits that were found, and that were planted, in clean frames of this scanner; in
        copies of the inspected scan alone, if ``source`` is ``edits planted in this scan``.
    here_found, here_planted : int
        The same in copies of the inspected scan itself, by all detectors together; 0 and 0: not
        tried. Only `Inspection.power` states them.
    source : str
        Frames in which ``planted`` edits were planted.
    """

    found: int
    planted: int
    here_found: int = 0
    here_planted: int = 0
    source: str = ""

    @property
    def share(self) -> float:
        """Share of the planted edits that were found in clean frames of the scanner."""
        return self.found / self.planted if self.planted else 0.0

    def record(self) -> dict[str, Any]:
        """Return the numbers as JSON values; those of the scan itself only if measured."""
        values = {**vars(self), "share": self.share}
        if not self.here_planted:
            del values["here_found"], values["here_planted"]
        return values


SEAM = "points beside a seam between firings; which side of it is foreign is not known"
"""Note on regions whose evidence is of the kinds `OF_SEAMS` only."""

OF_COPY = "one of two places with the same ranges; which of them is the copy is not known"
"""Note on regions whose evidence is a copy within the scan."""

OF_OCCLUSION = "something is seen behind these points; which of the two was inserted is not known"
"""Note on regions whose evidence is that they occlude other points."""

OF_SEAMS = frozenset(("firing", "duplicate"))
"""Kinds of evidence that arise where parts of two turns meet: on either side of the seam, points
contradict the firings of the other side. Of two regions of such kinds, one may be as it was
measured."""


@dataclass(frozen=True, eq=False)
class Region:
    """A place with evidence of an edit.

    Attributes
    ----------
    box : Box
        The smallest box, rotated about the vertical, around the suspected points, metres.
    rows : (K,) int64
        Rows of the suspected points; empty if points were removed.
    p_value : float or None
        Upper bound of the probability that a clean scan has a region with as much evidence; None:
        not stated.
    evidence : mapping of str to float
        Strength of each kind of evidence; of ``occluding``, the kind of detector II, the area of
        the points in front, square metres.
    """

    box: Box
    rows: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64), repr=False)
    p_value: float | None = None
    evidence: Mapping[str, float] = field(default_factory=lambda: ReadOnlyMapping({}), repr=False)

    @property
    def note(self) -> str:
        """Limits of what ``rows`` tell, in words; empty if they are the points of an edit."""
        if "copied" in self.evidence:
            return OF_COPY
        if "occluding" in self.evidence:
            return OF_OCCLUSION
        return SEAM if "firing" in self.evidence and OF_SEAMS.issuperset(self.evidence) else ""

    def record(self) -> dict[str, Any]:
        """Return the region as JSON values."""
        return {
            "center": list(self.box.center),
            "size": list(self.box.size),
            "yaw": self.box.yaw,
            "points": len(self.rows),
            "p_value": self.p_value,
            "evidence": dict(self.evidence),
            "note": self.note,
        }


NO_POWER: Mapping[str, Power] = ReadOnlyMapping({})
"""No power: a detector's own result states none, because it depends on the scanner; `inspect` looks
it up."""


@runtime_checkable
class RegionLike(Protocol):
    """Attributes that the regions of all detectors share; see `Region`."""

    @property
    def box(self) -> Box:
        """Box around the suspected points, or the former places of removed points, metres."""
        ...

    @property
    def rows(self) -> NDArray[np.int64]:
        """Rows of the suspected points; empty if points were removed."""
        ...

    @property
    def p_value(self) -> float | None:
        """Upper bound of the probability that a clean scan shows as much; None: not stated."""
        ...


@runtime_checkable
class Detection(Protocol):
    """Attributes that the results of all detectors of edited LiDAR scans share.

    Attributes
    ----------
    verdict : str
        One of `Verdict`; for a keyed watermark one of `WatermarkVerdict`.
    reason : str
        Reason of the verdict in words.
    score : float or None
        The detector's own measure of suspicion, larger is more suspicious; None: it could not
        judge.
    p_value : float or None
        Upper bound of the probability that a clean scan shows as much evidence; None: the detector
        states none.
    regions : sequence of RegionLike
        Places with evidence, each with a ``box``, ``rows`` and a ``p_value``.
    suspected : (K,) integers
        Rows of the suspected points, ascending.
    power : mapping of str to Power
        Share of the edits of each class that are found; empty: it depends on the scanner, and
        `inspect` states it.
    calibration : Calibration or None
        Clean scans on which the thresholds were chosen; None: the thresholds come from a
        publication or a user, or none are needed.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate
    >>> empty = np.zeros((0, 3), np.float32)
    >>> isinstance(authenticate.density_consistency(empty), authenticate.Detection)
    True
    """

    @property
    def verdict(self) -> str:
        """One of `Verdict`; for a keyed watermark one of `WatermarkVerdict`."""
        ...

    @property
    def reason(self) -> str:
        """Reason of the verdict in words."""
        ...

    @property
    def score(self) -> float | None:
        """The detector's own measure of suspicion, larger is more suspicious."""
        ...

    @property
    def p_value(self) -> float | None:
        """Upper bound of the probability that a clean scan shows as much; None: not stated."""
        ...

    @property
    def regions(self) -> Sequence[RegionLike]:
        """Places with evidence."""
        ...

    @property
    def suspected(self) -> NDArray[np.integer[Any]]:
        """Rows of the suspected points, ascending."""
        ...

    @property
    def power(self) -> Mapping[str, Power]:
        """Share of the edits of each class that are found."""
        ...

    @property
    def calibration(self) -> Calibration | None:
        """Source of the thresholds."""
        ...


class WithoutRate(Showable):
    """Properties of a `Detection` that states neither p-values nor power of its own."""

    __slots__ = ()

    if TYPE_CHECKING:

        @property
        def regions(self) -> Sequence[RegionLike]: ...

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Boxes of the regions, metres."""
        return tuple(region.box for region in self.regions)

    @property
    def p_value(self) -> float | None:
        """None, because the scores of clean scenes are not known well enough for a p-value."""
        return None

    @property
    def power(self) -> Mapping[str, Power]:
        """Empty, because it depends on the scanner; `inspect` looks it up."""
        return NO_POWER


@dataclass(frozen=True, eq=False)
class BesideTurns:
    """Fields of the results of detectors IV and V, which compare a frame with its neighbours.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
    reason : str
        Reason of the verdict in words.
    p_value : float
        Upper bound of the probability that a clean frame shows as much evidence.
    score : float
        Largest strength of a region; larger is more suspicious.
    false_alarm_rate : float
        The argument of this name.
    regions : tuple
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the strongest first.
    suspected : (K,) int64
        Rows of the points in these regions.
    """

    verdict: Verdict
    reason: str
    p_value: float
    score: float
    false_alarm_rate: float
    regions: tuple[Any, ...]
    suspected: NDArray[np.int64]

    @property
    def power(self) -> Mapping[str, Power]:
        """Empty, because it depends on the scanner; see `inspect`."""
        return NO_POWER

    def with_rows(self, rows: NDArray[np.int64]) -> Self:
        """Return the result in terms of a whole scan of which only some points were judged.

        Parameters
        ----------
        rows : (N,) int64
            Row of the scan of each point that was judged.
        """
        regions = tuple(replace(region, rows=rows[region.rows]) for region in self.regions)
        return replace(self, regions=regions, suspected=rows[self.suspected])


@dataclass(frozen=True)
class Processing:
    """A processing step that was applied to a whole scan.

    Attributes
    ----------
    kind : str
        ``shuffled``, ``regrouped`` (some points are at another place in the file than the scanner
        writes them), ``reversed``, ``mirrored``, ``rounded``, ``float16``, ``cropped``, ``sector``
        (some lasers have no returns in a sector), ``thinned``, ``lasers`` (some lasers are
        missing), ``filtered``, ``outliers`` (isolated points were removed), ``turned``, ``scaled``,
        ``moved``, ``averaged`` (the points of each voxel were replaced by their mean), ``fused``,
        ``repeated``, ``padded`` (rows that are no returns), ``reflectances``, ``echoes`` (the scan
        has later echoes of pulses without their numbers), ``neighbours`` (points are missing from a
        neighbouring turn, so that points missing from the scan may go unnoticed) or ``foreign``
        (the neighbouring turns show one place, the scan another one). Recordings of depth can also
        be ``resampled`` and ``lossily coded``. Kinds of drives: see `DriveInspection`.
    detail : str
        Description with numbers.
    """

    kind: str
    detail: str


@checked
def likelihood_ratio(p_value: float) -> float:
    """Return a lower bound of the likelihood ratio of evidence, edited against clean.

    Parameters
    ----------
    p_value : float
        Probability in [0, 1].

    Returns
    -------
    float
        1 / (2 sqrt(p)), a calibrator of p-values [Vovk and Wang, Annals of Statistics 2021]. Its
        mean over clean frames is at most 1 (it is an e-value).

    Raises
    ------
    InputError
        ``p_value`` is out of range.

    Examples
    --------
    >>> from manip3d import authenticate
    >>> authenticate.likelihood_ratio(0.01)
    5.0
    """
    if not 0.0 <= p_value <= 1.0:
        raise InputError(f"p_value: expected a probability in [0, 1], got {p_value!r}")
    return 0.5 / math.sqrt(max(p_value, 1e-300))


def tail_p_value(strength: float, tail: Sequence[float], frames: int) -> float:
    """Return an upper bound of the probability that a clean frame has a region as strong.

    Parameters
    ----------
    strength : float
        Strength of the strongest region of a frame.
    tail : sequence of float
        The largest strengths among clean frames, one for a frame, in descending order.
    frames : int
        Number of clean frames. The bound is 1 for a strength that the whole tail reaches, because
        weaker regions of clean frames were not counted.
    """
    as_strong = bisect.bisect_right(tail, -strength, key=operator.neg)
    return (1 + as_strong) / (1 + frames) if as_strong < len(tail) else 1.0
