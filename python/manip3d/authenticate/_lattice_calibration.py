"""Calibrate a scanner: estimate its lattice from clean scans, and measure the power on others."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d._util.checked import checked
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import reporting, shares, sharing
from manip3d._util.paths import path_of
from manip3d._util.shares import binomial_tail
from manip3d.authenticate._edits import EDITS, REFLECTANCE_EDITS
from manip3d.authenticate._generic import generic_consistency
from manip3d.authenticate._lattice import SensorLattice
from manip3d.authenticate._lattice_estimate import estimate_lattice
from manip3d.authenticate._power import measure_power
from manip3d.authenticate._repeats import first_copies, points_id
from manip3d.authenticate._sensors import why_off_lattice
from manip3d.authenticate._verdict import rate_of
from manip3d.errors import InputError
from manip3d.io import read_scan
from manip3d.io._scan_files import scan_paths
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from manip3d._util.options import Progress

MIN_CALIBRATED = 4
"""Fewest scans for `calibrate_lattice`; the lattice is estimated from every second one."""

CHANCE = 0.01
"""Largest share of correct lattices that may be refused because detector III accuses too many clean
scans by chance."""


@checked
def calibrate_lattice(
    frames: Iterable[LidarFrame | str | os.PathLike[str]],
    *,
    most: int | None = None,
    planted: int = 10,
    source: str = "",
    rng: int = 0,
    threads: int = 0,
    progress: Progress = None,
) -> SensorLattice:
    """Estimate the lattice of a scanner and measure the power of detector III on its scans.

    The lattice is estimated from every second scan. The other scans are judged by it, first
    unedited, then with planted edits of each class. With this lattice, `inspect` can return
    ``no_trace`` for scans of this scanner if half of the edits of some class are found. Ranges of
    exact clouds need no steps then; without them edits along the rays and turned copies stay
    hidden, as the power of their classes shows.

    Parameters
    ----------
    frames : iterable of LidarFrame or path
        At least four clean scans as the scanner recorded them, with the scanner at the origin. A
        path of a folder stands for all scans in it, or for all scans of that drive (`drive_scans`).
    most : int, optional
        Largest number of scans to read, evenly spread over all; at least four. Default: all.
    planted : int
        Number of edits of each class in each scan that is judged.
    source : str
        Name of the scans, for ``SensorLattice.power``; default: their number, and their file's or
        folder's name.
    rng : int
        Seed of the edits.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    SensorLattice
        Lattice with ``power``, which is empty if no edits could be planted.

    Raises
    ------
    InputError
        There are fewer than four scans, or two with the same points, so that a lattice would be
        judged by what it is estimated from; they have no rings that can be distinguished;
        ``planted`` is not positive or ``most`` is below 4; detector III accuses more of the clean
        scans than chance explains at its rate, so that it cannot judge this scanner; `inspect`
        would not judge one of them by the lattice, so that a measured power would not hold.
    FormatError, OSError
        A file cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame
    >>> from manip3d.authenticate import calibrate_lattice, kitti_lattice
    >>> lattice = kitti_lattice()
    >>> ring, count = np.divmod(np.arange(64 * 2000), 2000)  # every second step of the encoder
    >>> def spiral_wall(radius):
    ...     distance = radius + 0.004 * count + lattice.range_phase[ring]
    ...     scan = lattice.points_at(ring, 2 * count, distance).round(3)
    ...     azimuth = np.arctan2(scan[:, 1], scan[:, 0]) % (2 * np.pi)
    ...     return LidarFrame(scan[np.lexsort((azimuth, ring))].astype(np.float32))
    >>> walls = [spiral_wall(radius) for radius in (8, 10, 12, 14)]
    >>> calibrate_lattice(walls, planted=1).power["moved"].share
    1.0
    """
    if most is not None and most < MIN_CALIBRATED:
        raise InputError(f"most: expected at least {MIN_CALIBRATED}, got {most}")
    given = list(frames)
    chosen = _spread([scan for each in given for scan in _scans_of(each)], most)
    if len(chosen) < MIN_CALIBRATED:
        raise InputError(f"frames: expected at least {MIN_CALIBRATED} scans, got {len(chosen)}")
    listed = [scan if isinstance(scan, LidarFrame) else read_scan(scan) for scan in chosen]
    _refuse_copies(listed, chosen)
    lattice = estimate_lattice(listed[::2])
    others = [frame.replace(intensity=None) for frame in listed[1::2]]
    rate = rate_of("generic")
    classes = [name for name in EDITS if name not in REFLECTANCE_EDITS]
    clean, forged = shares([1.0, planted * len(classes)])
    with sharing(progress, "calibrate") as part:
        accused = 0
        with reporting(part(*clean), "clean scans") as report:
            for number, frame in enumerate(others, 1):
                found = generic_consistency(
                    frame, lattice=lattice, false_alarm_rate=rate, threads=threads
                )
                accused += found.verdict == "tampered"
                if report is not None:
                    report(number / len(others))
        if accused and binomial_tail(accused, len(others), rate) <= CHANCE:
            raise InputError(
                f"frames: expected clean scans that stand on a lattice; detector III accuses "
                f"{accused} of {len(others)} as they are"
            )
        _refuse_off_lattice(others, lattice, threads)
        measured = measure_power(
            others, lattice, planted=planted, classes=classes, rng=rng, threads=threads,
            progress=part(*forged),
        )  # fmt: skip
    told = source or f"{len(others)} clean scans{_places_in_words(given)}"
    power = {name: replace(each, source=told) for name, each in measured.items()}
    return replace(lattice, power=ReadOnlyMapping(power))


def _refuse_copies(scans: Sequence[LidarFrame], given: Sequence[LidarFrame | Path]) -> None:
    """Raise `InputError` if two of the scans have the same points."""
    for number, first in enumerate(first_copies([points_id(scan.points) for scan in scans])):
        if first is not None:
            names = [
                f"number {place + 1}" if isinstance(given[place], LidarFrame) else given[place]
                for place in (number, first)
            ]
            raise InputError(
                f"frames: expected different scans; {names[0]} has the points of {names[1]}"
            )


def _refuse_off_lattice(scans: Sequence[LidarFrame], lattice: SensorLattice, threads: int) -> None:
    """Raise `InputError` if `inspect` would not judge some of the scans by the lattice."""
    reasons = [why_off_lattice(scan, lattice, threads=threads) for scan in scans]
    told = [why for why in reasons if why is not None]
    if told:
        raise InputError(
            f"frames: expected clean scans that are judged by a lattice of others; {len(told)} of "
            f"{len(scans)} are not: {told[0]}"
        )


def _scans_of(given: LidarFrame | str | os.PathLike[str]) -> list[LidarFrame | Path]:
    """The given scan, or the scans of a folder, which may be a drive."""
    if isinstance(given, LidarFrame):
        return [given]
    path = path_of(given, "frames")
    if not path.is_dir():
        return [path]
    from manip3d.authenticate._watermark_files import drive_scans

    return [*scan_paths(path)] or [*drive_scans(path)]


def _spread(scans: Sequence[LidarFrame | Path], most: int | None) -> list[LidarFrame | Path]:
    """At most ``most`` of the scans, evenly spread over all."""
    if most is None or len(scans) <= most:
        return list(scans)
    return [scans[k * len(scans) // most] for k in range(most)]


def _places_in_words(given: Sequence[LidarFrame | str | os.PathLike[str]]) -> str:
    """Name of the first file or folder, and the number of further ones, in words."""
    names = [Path(each).name for each in given if not isinstance(each, LidarFrame)]
    if not names:
        return ""
    return f" of {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1 else "")
