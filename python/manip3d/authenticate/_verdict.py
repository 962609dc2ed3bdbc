"""Verdicts, regions and power, which all detectors state in the same words."""

from __future__ import annotations

import math
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
"""``no_trace``: no evidence was found by a detector that could have objected; it is not a proof of
authenticity, which only a keyed watermark gives. ``tampered``: localised evidence of an edit at a
stated false-alarm rate. ``processed``: the whole scan was changed (shuffled, rounded, cropped,
deskewed ...). ``undecidable``: the scan gives the detector nothing to judge by; never a guess."""


FALSE_ALARM_RATE = 0.01
"""Share of clean scans that `inspect` may call tampered, whichever of its detectors does."""

RATE_SHARES: Mapping[str, float] = ReadOnlyMapping(
    {"generic": 0.1, "turns": 0.7, "reflectance": 0.2}
)
"""What each detector of a spinning scanner may use up of it: the rate of all together is at most
the sum of theirs (Bonferroni), whether they agree or not. A detector that has nothing to judge by
leaves its share unused. The split was chosen on the frames that fix the thresholds, before rates
were measured on others: detector III tells clean scans by the lattice and needs least, detector V
is seldom wrong, and dark cars that swallow pulses are nearest to the edits that detector IV looks
for."""


def rate_of(detector: str, false_alarm_rate: float = FALSE_ALARM_RATE) -> float:
    """Return the share of a scan's false-alarm rate that a detector may use up.

    Parameters
    ----------
    detector : 'generic', 'turns' or 'reflectance'
    false_alarm_rate : float
        Rate for the scan as a whole.
    """
    return RATE_SHARES[detector] * false_alarm_rate


@dataclass(frozen=True)
class Calibration:
    """Source of a detector's thresholds.

    Attributes
    ----------
    scenes : str
        The clean scans on which they were fixed; never those of a report.
    num_scans : int
    false_alarms : int
        Number of those scans that the thresholds, as they are, would call tampered.
    note : str
        What they do not cover.
    """

    scenes: str
    num_scans: int
    false_alarms: int
    note: str = ""


@dataclass(frozen=True)
class Power:
    """Share of the edits of one class that a detector finds.

    Attributes
    ----------
    found, planted : int
        Edits found, of so many planted in clean frames of this scanner.
    here_found, here_planted : int
        The same in copies of the inspected scan itself, by all detectors together; 0 of 0: not
        tried. Only `Inspection.power` has them.
    source : str
        The clean frames of the first numbers.
    """

    found: int
    planted: int
    here_found: int = 0
    here_planted: int = 0
    source: str = ""

    @property
    def share(self) -> float:
        """Share found in clean frames of the scanner."""
        return self.found / self.planted if self.planted else 0.0

    def record(self) -> dict[str, Any]:
        """Return the numbers as JSON values; those of the scan itself where it was tried."""
        values = {**vars(self), "share": self.share}
        if not self.here_planted:
            del values["here_found"], values["here_planted"]
        return values


@dataclass(frozen=True, eq=False)
class Region:
    """A place with evidence of an edit.

    Attributes
    ----------
    box : Box
        The smallest box, rotated about the vertical, around its suspected points, metres.
    rows : (K,) int64
        Rows of its suspected points; none where points were removed.
    p_value : float or None
        Probability, at most, that a clean scan has a region with as much; None: not stated.
    evidence : mapping of str to float
        Strength by kind of evidence.
    """

    box: Box
    rows: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64), repr=False)
    p_value: float | None = None
    evidence: Mapping[str, float] = field(default_factory=lambda: ReadOnlyMapping({}), repr=False)

    def record(self) -> dict[str, Any]:
        """Return the region as JSON values."""
        return {
            "center": list(self.box.center),
            "size": list(self.box.size),
            "yaw": self.box.yaw,
            "points": len(self.rows),
            "p_value": self.p_value,
            "evidence": dict(self.evidence),
        }


NO_POWER: Mapping[str, Power] = ReadOnlyMapping({})
"""Power of a detector that knows nothing of the scanner: `inspect` looks it up."""


@runtime_checkable
class RegionLike(Protocol):
    """A region, whatever else its detector tells of it; see `Region`."""

    @property
    def box(self) -> Box:
        """Around its suspected points, or where removed ones stood, metres."""
        ...

    @property
    def rows(self) -> NDArray[np.int64]:
        """Rows of its suspected points; none where points were removed."""
        ...

    @property
    def p_value(self) -> float | None:
        """Probability, at most, that a clean scan shows as much; None: it is not stated."""
        ...


@runtime_checkable
class Detection(Protocol):
    """Result that all detectors of edited LiDAR scans share.

    Attributes
    ----------
    verdict : str
        One of `Verdict`; of a keyed watermark one of `WatermarkVerdict`.
    reason : str
        The verdict's reason in words.
    score : float or None
        The detector's own measure, larger is more suspicious; None: it could not judge.
    p_value : float or None
        Probability, at most, that a clean scan shows as much; None: the detector states none.
    regions : sequence of RegionLike
        Places with evidence, each with a ``box``, ``rows`` and a ``p_value``.
    suspected : (K,) integers
        Rows of the suspected points, ascending.
    power : mapping of str to Power
        Share of the edits of each class that are found; empty: the detector alone does not know
        the scanner, and `inspect` tells.
    calibration : Calibration or None
        Where the thresholds come from; None: a publication, a user, or none are needed.

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
        """One of `Verdict`; of a keyed watermark one of `WatermarkVerdict`."""
        ...

    @property
    def reason(self) -> str:
        """The verdict's reason in words."""
        ...

    @property
    def score(self) -> float | None:
        """The detector's own measure, larger is more suspicious."""
        ...

    @property
    def p_value(self) -> float | None:
        """Probability, at most, that a clean scan shows as much; None: it is not stated."""
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
        """Around what each region found, metres."""
        return tuple(region.box for region in self.regions)

    @property
    def p_value(self) -> float | None:
        """None: the tail of clean scenes is not known well enough to state one."""
        return None

    @property
    def power(self) -> Mapping[str, Power]:
        """Empty: it depends on the sensors; `inspect` looks it up for a scanner it knows."""
        return NO_POWER


@dataclass(frozen=True, eq=False)
class BesideTurns:
    """Fields of the results of detectors IV and V, which compare a frame with the turns beside it.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
    reason : str
        In words.
    p_value : float
        Probability, at most, that a clean frame shows as much.
    score : float
        The largest strength of a region; larger is more suspicious.
    false_alarm_rate : float
        As asked for.
    regions : tuple
        Regions whose own ``p_value`` does not exceed ``false_alarm_rate``, the strongest first.
    suspected : (K,) int64
        Rows of the points in them.
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
        """Empty: it depends on the scanner, see `inspect`."""
        return NO_POWER

    def with_rows(self, rows: NDArray[np.int64]) -> Self:
        """Return the result for a scan of which only some points were judged.

        Parameters
        ----------
        rows : (N,) int64
            Row of the scan of each point that was judged.
        """
        regions = tuple(replace(region, rows=rows[region.rows]) for region in self.regions)
        return replace(self, regions=regions, suspected=rows[self.suspected])


@dataclass(frozen=True)
class Processing:
    """Something that was done to a scan as a whole.

    Attributes
    ----------
    kind : str
        ``shuffled``, ``regrouped`` (some points stand elsewhere in the file than the scanner writes
        them), ``reversed``, ``mirrored``, ``rounded``, ``float16``, ``cropped``, ``thinned``,
        ``lasers`` (some were left out), ``filtered``, ``outliers`` (points far from others were
        left out), ``turned``, ``scaled``, ``moved``, ``averaged`` (the points of each voxel became
        one), ``fused``, ``repeated``, ``padded`` (rows that are no returns), ``reflectances`` or
        ``neighbours`` (what the turns beside the scan lack hides what the scan lacks), ``foreign``
        (they show one place, and the scan another); of recordings also ``resampled`` and ``lossily
        coded``; of drives see `DriveInspection`.
    detail : str
        In words, with numbers.
    """

    kind: str
    detail: str


@checked
def likelihood_ratio(p_value: float) -> float:
    """Return how much likelier what was seen is under an edit than in a clean frame, at least.

    Parameters
    ----------
    p_value : float
        In (0, 1].

    Returns
    -------
    float
        1 / (2 sqrt(p)), a calibrator of p-values [Vovk and Wang, Annals of Statistics 2021]: its
        mean over clean frames is 1 at most, so that it is a bet that a clean frame does not win.

    Raises
    ------
    InputError
        A value out of range.

    Examples
    --------
    >>> from manip3d import authenticate
    >>> authenticate.likelihood_ratio(0.01)
    5.0
    """
    if not 0.0 <= p_value <= 1.0:
        raise InputError(f"p_value: expected a probability in [0, 1], got {p_value!r}")
    return 0.5 / math.sqrt(max(p_value, 1e-300))


def binomial_tail(least: int, frames: int, rate: float) -> float:
    """Return the probability that at least so many of independent frames alarm.

    Parameters
    ----------
    least, frames : int
    rate : float
        Probability that one frame alarms, in (0, 1).
    """

    def log_share(count: int) -> float:
        ways = math.lgamma(frames + 1) - math.lgamma(count + 1) - math.lgamma(frames - count + 1)
        return ways + count * math.log(rate) + (frames - count) * math.log1p(-rate)

    # The upper tail itself: 1 less the lower one has no digit left where it is small.
    tail = math.fsum(math.exp(log_share(count)) for count in range(max(least, 0), frames + 1))
    return min(1.0, tail)
