"""Contradictions between a LiDAR scan and several stereo pairs that look in different
directions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d.authenticate._cross_modal import (
    CALIBRATION,
    CrossModalParameters,
    CrossModalRegion,
    CrossModalResult,
    attack_type,
    cross_modal_consistency,
    nearest_place,
)
from manip3d.authenticate._risk import AttackObservation, RiskParameters, gravest_place
from manip3d.authenticate._stereo import Disparity, StereoRig
from manip3d.authenticate._verdict import Calibration, Verdict, WithoutRate, verdict_repr
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame, ScanLike

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class SurroundResult(WithoutRate):
    """Joint result of several stereo pairs for one LiDAR scan.

    Attributes
    ----------
    pairs : mapping of str to CrossModalResult
        Result of each pair for its own field of view.
    verdict : 'no_trace', 'tampered' or 'undecidable'
        ``tampered`` if a pair accuses the scan; else ``undecidable`` if a pair measured too little,
        since its directions are not judged.
    reason : str
        Reason of the verdict in words.
    attack : str
        `CrossModalResult.attack` for the regions of all pairs: an object that was moved from the
        view of one pair into that of another is one modification.
    """

    pairs: Mapping[str, CrossModalResult]
    verdict: Verdict = field(init=False)
    reason: str = field(init=False)
    attack: str = field(init=False)

    def __post_init__(self) -> None:
        if not self.pairs:
            raise InputError("pairs: expected at least one, got none")
        verdict, reason = _joined(self.pairs)
        object.__setattr__(self, "pairs", ReadOnlyMapping(self.pairs))
        object.__setattr__(self, "verdict", verdict)
        object.__setattr__(self, "reason", reason)
        object.__setattr__(
            self, "attack", attack_type(self.regions) if verdict == "tampered" else ""
        )

    __repr__ = verdict_repr

    @property
    def regions(self) -> tuple[CrossModalRegion, ...]:
        """Regions of all pairs that accuse, the largest area first.

        An object in the view of two pairs is reported by both.
        """
        accusing = (found for found in self.pairs.values() if found.verdict == "tampered")
        return tuple(
            sorted((r for found in accusing for r in found.regions), key=lambda r: -r.area)
        )

    @property
    def calibration(self) -> Calibration | None:
        """Source of each pair's parameters, before the pairs share the rate of false alarms."""
        return CALIBRATION

    @property
    def suspected(self) -> NDArray[np.int32]:
        """Rows of added points, ascending, without duplicates."""
        accusing = [f.suspected for f in self.pairs.values() if f.verdict == "tampered"]
        return np.unique(np.concatenate([np.empty(0, np.int32), *accusing]))

    @property
    def score(self) -> float:
        """Largest score of a pair."""
        return max(found.score for found in self.pairs.values())

    @property
    def scan(self) -> LidarFrame | None:
        """The scan that was judged."""
        return next(iter(self.pairs.values())).scan

    def observation(
        self, *, speed_mps: float, parameters: RiskParameters | None = None
    ) -> AttackObservation | None:
        """Return the attack for `RiskTracker.update`; None if no pair accuses the scan.

        Cells that two pairs judge count for both.

        Parameters
        ----------
        speed_mps : float, m/s
            Speed of the car, which determines the length of the safety region.
        parameters : RiskParameters, optional
            The safety region.
        """
        if self.verdict != "tampered":
            return None
        region = RiskParameters() if parameters is None else parameters
        counted = [found.cells_in_region(speed_mps, region) for found in self.pairs.values()]
        return AttackObservation(
            self.attack,
            gravest_place(map(nearest_place, self.boxes), speed_mps, region),
            sum(changed for changed, _ in counted),
            sum(judged for _, judged in counted),
        )

    def record(self) -> dict[str, object]:
        """Return the result without the maps, ready for JSON."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "attack": self.attack,
            "score": self.score,
            "pairs": {name: found.record() for name, found in self.pairs.items()},
            "regions": [region.record() for region in self.regions],
        }


@checked
def surround_consistency(
    scan: ScanLike,
    disparities: Mapping[str, Disparity],
    rigs: Mapping[str, StereoRig],
    *,
    parameters: CrossModalParameters | None = None,
) -> SurroundResult:
    """Compare a LiDAR scan with the disparities of several stereo pairs from the same moment.

    Each pair judges its own field of view by `cross_modal_consistency`, in maps around its own
    heading. Results are in the LiDAR's frame.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres; x forward, y left, z up, the scanner at the origin.
    disparities : mapping of str to Disparity
        Disparities of the left images, by the names of their pairs.
    rigs : mapping of str to StereoRig
        Stereo pairs by name, at least those of ``disparities``.
    parameters : CrossModalParameters, optional
        Parameters of a single pair, without a heading, because each pair has its own. They are
        adapted to the number of rigs (`CrossModalParameters.shared`), so that the false-alarm rate
        of a frame stays the same.

    Returns
    -------
    SurroundResult

    Raises
    ------
    InputError
        There is no pair, a pair has no rig, ``parameters`` has a heading; or as
        `cross_modal_consistency`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import Disparity, StereoRig, surround_consistency
    >>> ahead = np.eye(4)[[2, 0, 1, 3]] * [[1], [-1], [-1], [1]]
    >>> behind = np.diag([-1.0, -1.0, 1.0, 1.0]) @ ahead
    >>> rigs = {
    ...     name: StereoRig(88.0, (47.5, 35.5), 0.5, pose)
    ...     for name, pose in (("front", ahead), ("rear", behind))
    ... }
    >>> [rig.heading_deg for rig in rigs.values()]
    [0.0, 180.0]
    >>> nothing = Disparity(np.zeros((72, 96), np.float32))
    >>> scan = np.zeros((1, 3), np.float32)
    >>> surround_consistency(scan, dict.fromkeys(rigs, nothing), rigs).verdict
    'undecidable'
    """
    for name in disparities:
        if name not in rigs:
            raise InputError(f"disparities: expected pairs of {sorted(rigs)}, got {name!r}")
    if parameters is not None and parameters.heading is not None:
        raise InputError(
            "parameters: expected no heading, since each pair has its own, "
            f"got {parameters.heading}"
        )
    shared = (parameters or CrossModalParameters()).shared(max(len(rigs), 1))
    return SurroundResult(
        {
            name: cross_modal_consistency(scan, disparity, rigs[name], parameters=shared)
            for name, disparity in disparities.items()
        }
    )


def _joined(pairs: Mapping[str, CrossModalResult]) -> tuple[Verdict, str]:
    verdicts: tuple[Verdict, ...] = ("tampered", "undecidable")
    for verdict in verdicts:
        told = [f"{name}: {f.reason}" for name, f in pairs.items() if f.verdict == verdict]
        if told:
            return verdict, "; ".join(told)
    return "no_trace", f"no contradiction in the fields of view of {', '.join(pairs)}"
