"""Combine the evidence of the frames of a drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d._util.shares import upper_rate
from manip3d.authenticate._inspection import Inspection
from manip3d.authenticate._verdict import LOG_ROUNDING
from manip3d.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

FRAMES_PER_SECOND = 10.0
"""Turns of KITTI's scanner per second."""

MEASURED_FRAMES, MEASURED_ALARMS = 5300, 0
"""Clean simulated frames on which `drive_evidence` was tested by `benchmarks/bench_alarms.py` (310
drives of ten frames, on the streets 93000 to 93269 and 96000 to 96039, and 22 drives of a hundred
frames, on 110000 to 110021), and its number of alarms at a rate of one alarm per hour."""


@dataclass(frozen=True, eq=False)
class DriveEvidence:
    """Joint evidence of the frames of a drive; see :func:`drive_evidence`.

    Attributes
    ----------
    log10_ratio : (N,) float64
        log10 of each frame's likelihood ratio; 0 if the frame was not judged.
    evidence : (N,) float64
        log10 of the accumulated evidence after each frame.
    threshold : float
        log10 of the evidence that raises an alarm.
    alarms : tuple of int
        Frames at which the threshold was reached; the evidence restarts at 1 after each.
    alarms_per_hour : float
        The argument of this name: largest mean rate of alarms in clean drives.
    judged : int
        Number of frames that were judged.
    """

    log10_ratio: NDArray[np.float64] = field(repr=False)
    evidence: NDArray[np.float64] = field(repr=False)
    threshold: float
    alarms: tuple[int, ...]
    alarms_per_hour: float
    judged: int

    __repr__ = short_repr

    @property
    def statement(self) -> str:
        """The result in words, with the measured rate of false alarms."""
        found = "no alarm"
        if len(self.alarms) == 1:
            found = f"an alarm at frame {self.alarms[0]}"
        elif self.alarms:
            found = f"{len(self.alarms)} alarms, the first at frame {self.alarms[0]}"
        most = float(self.evidence.max(initial=0.0))
        hour = 3600.0 * FRAMES_PER_SECOND
        bound = upper_rate(MEASURED_ALARMS, MEASURED_FRAMES) * hour
        rate = f"{self.alarms_per_hour:g} an hour"
        return (
            f"evidence over {self.judged} frames: {found}. The likelihood ratios of successive "
            f"frames multiply to 10^{most:.1f} at most; 10^{self.threshold:.1f} raises an alarm, "
            f"of which clean drives would have at most {rate} if frames did not depend on each "
            f"other. Measured: {MEASURED_ALARMS} alarms in {MEASURED_FRAMES} clean simulated "
            f"frames, so few that they only bound the rate by {bound:.0f} an hour (95 %)."
        )


@checked
def drive_evidence(
    found: Sequence[Inspection | None],
    *,
    alarms_per_hour: float = 1.0,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> DriveEvidence:
    """Combine the evidence of the frames of a drive.

    Parameters
    ----------
    found : sequence of Inspection or None
        Inspections in the order of the drive, as `inspect_drive` yields them.
    alarms_per_hour : float
        Largest mean number of false alarms per hour of clean driving; positive, and less than the
        number of frames.
    frames_per_second : float
        Turns of the scanner per second; positive.

    Returns
    -------
    DriveEvidence

    Raises
    ------
    InputError
        A rate is not positive, or there would be an alarm in every frame.

    Notes
    -----
    The evidence is the running product of the likelihood ratios of the inspections
    (`Inspection.likelihood_ratio`), which is raised to 1 before each frame if it is less: a CUSUM
    [Page, Biometrika 1954] of e-values. If a clean frame's ratio has a mean of at most 1, whatever
    came before, the mean number of frames to a false alarm is at least the threshold [Shin, Ramdas
    and Rinaldo, New England Journal of Statistics in Data Science 2023]. Frames of one place are
    not independent, because a misleading scene remains misleading in the next frame; therefore the
    rate is also measured.

    Examples
    --------
    >>> from manip3d import authenticate
    >>> authenticate.drive_evidence([None, None]).alarms
    ()
    """
    for name, value in (
        ("alarms_per_hour", alarms_per_hour),
        ("frames_per_second", frames_per_second),
    ):
        if not (value > 0.0 and math.isfinite(value)):
            raise InputError(f"{name}: expected a number > 0, got {value!r}")
    frames_per_hour = 3600.0 * frames_per_second
    if not alarms_per_hour < frames_per_hour:
        raise InputError(
            f"alarms_per_hour: expected fewer than the {frames_per_hour:g} frames of an hour, got "
            f"{alarms_per_hour:g}"
        )
    threshold = math.log10(frames_per_hour / alarms_per_hour)
    ratios = np.array([_log10_ratio(each) for each in found], np.float64)
    evidence = np.zeros(len(found))
    alarms = []
    sum_ = 0.0
    for number, ratio in enumerate(ratios.tolist()):
        sum_ = max(sum_, 0.0) + ratio
        evidence[number] = sum_
        if sum_ >= threshold - LOG_ROUNDING:
            alarms.append(number)
            sum_ = 0.0
    judged = sum(each is not None and each.likelihood_ratio is not None for each in found)
    return DriveEvidence(ratios, evidence, threshold, tuple(alarms), alarms_per_hour, judged)


def _log10_ratio(found: Inspection | None) -> float:
    ratio = None if found is None else found.likelihood_ratio
    return 0.0 if ratio is None else math.log10(ratio)
