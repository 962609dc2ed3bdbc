"""Estimate the position of the scanner from the angular grid of its scan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting, threads_of
from manip3d.authenticate._generic import generic_consistency
from manip3d.lidar import LidarFrame, ScanLike, map_shift, position_of, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d._util.options import Progress
    from manip3d.lidar import Scan

MIN_EXPLAINED = 0.94
"""Least share of a scan that one grid explains; with less, scans of several positions were fused.
In the scenes ``calibration-indoor-03``, ``-05``, ``-outdoor-03`` and ``-05`` of
`manip3d.simulate.scenes` it is at least 0.99 for a single position, with or without a pasted
object, and at most 0.92 with a fifth of a second scan; with all of the second scan, no grid is
found. It is 0.966 in a forest scanned by a Riegl VZ-400i."""

MIN_OF_SOURCE = 0.01
"""A flight line or position counts if it has at least this share of the points."""

NO_ORIGIN = "no single position explains the scan; give it (origin, --origin) if it is known"


@dataclass(frozen=True)
class OriginEstimate:
    """Result of `estimate_origin`.

    Attributes
    ----------
    position : (float, float, float) or None
        Position of the scanner in the frame of the scan, metres; None: no single position explains
        the scan.
    axis : 'x', 'y' or 'z'
        Axis of the azimuth; z for all upright scanners.
    azimuth_deg, elevation_deg : float
        Steps of the grid, degrees; 0: no grid was found.
    azimuth_coherence, elevation_coherence : float
        Coherence of neighbouring points about the places of columns and rows, 0 to 1.
    explained : float
        Share of the scan that lies on the grid, 0 to 1.
    reason : str
        Description of the way in which the position was found, or reason why not.
    """

    position: tuple[float, float, float] | None
    axis: str
    azimuth_deg: float
    elevation_deg: float
    azimuth_coherence: float
    elevation_coherence: float
    explained: float
    reason: str


@checked
def estimate_origin(
    scan: ScanLike, *, known: ArrayLike | None = None, threads: int = 0, progress: Progress = None
) -> OriginEstimate:
    """Find the position around which a scan's points lie on a grid of azimuth and elevation.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan with points in any order; the position that its file states is not used.
    known : (3,), optional
        Only test whether the scan lies on a grid around this position.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable(fraction, message)
        True shows a bar.

    Returns
    -------
    OriginEstimate
        It has no position if scans of several positions were fused, if the scan has no such grid,
        or if it was tilted. Scanners like the HDL-64E have no grid of elevations, or none for all
        lasers (in a VLP-32C, five of 32 lasers are off it): the position then is (0, 0, 0) if
        detector III finds a lattice around it, else None. That test is skipped if coordinates of a
        map were moved near 0.

    Raises
    ------
    InputError
        A shape is wrong, a coordinate is not finite.

    Notes
    -----
    The error is at most 0.1 mm for simulated scans of 0.12 degrees that were moved by tens of
    metres. For real scans, the distance from the published position is 0.1 mm in 3DTK's and PCL's
    rooms, 6 mm for a pump and 11 mm in a forest.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import estimate_origin
    >>> a, e = np.radians(np.mgrid[0:360:1, -40:60:1]).reshape(2, -1)
    >>> rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    >>> walls = (np.array([6, 4, 2]) / np.maximum(abs(rays), 1e-9)).min(axis=1, keepdims=True)
    >>> room = (rays * walls).astype(np.float32)
    >>> moved = room + np.float32([10, 20, 0])
    >>> found = estimate_origin(moved, known=(10, 20, 0))
    >>> found.position, round(found.azimuth_deg, 3), found.reason
    ((10.0, 20.0, 0.0), 1.0, 'the angular grid')
    """
    scene = to_scan(scan)
    around = None if known is None else position_of(known, "known")
    # If coordinates of a map were moved near 0, the scanner is not at 0.
    is_own = around is None and not is_on_map(scene.frame)
    with reporting(progress, "origin") as report:
        grid = _core.estimate_scan_origin(scene.points, around, is_own, threads_of(threads), report)
        found, position, explained = grid["found"], grid["position"], grid["explained"]
        reason = "the angular grid"
        fused = found and explained < MIN_EXPLAINED
        if is_own and (fused or not found) and _stands_on_lattice(scene, threads):
            found, position, explained = True, (0.0, 0.0, 0.0), 1.0
            reason = "the lattice of a spinning scanner"
        elif not found:
            reason = NO_ORIGIN
        elif around is None and fused:
            found = False
            share = f"the grid explains {explained:.0%} of the scan"
            reason = f"{share}: several positions fused, or a spinning scanner"
        if report is not None:
            report(1.0)  # the search may end before it reports 1
    return OriginEstimate(
        position if found else None,
        "xyz"[grid["axis"]],
        math.degrees(grid["azimuth_step"]),
        math.degrees(grid["elevation_step"]),
        grid["azimuth_coherence"],
        grid["elevation_coherence"],
        explained,
        reason,
    )


def scanner_position(
    origin: ArrayLike | None, scan: Scan, threads: int
) -> NDArray[np.float64] | None:
    """Position of the scanner: as given, else from the frame, else estimated from the grid.

    None: no single position explains the scan. For an array of points it is (0, 0, 0).
    """
    if origin is not None:
        return position_of(origin, "origin")
    if scan.frame is None:
        return np.zeros(3)
    if scan.frame.origin is not None:
        return position_of(scan.frame.origin, "origin")
    if several_sources(scan.frame) is not None:
        return None
    found = estimate_origin(scan.frame, threads=threads).position
    return None if found is None else np.asarray(found)


def is_on_map(frame: LidarFrame | None) -> bool:
    """Whether the points were moved near 0 from coordinates of a map."""
    return bool(map_shift(frame).any())


def several_sources(frame: LidarFrame) -> str | None:
    """Reason why a scan on a map has no single position: its points have several sources.

    ``point_source_id`` of LAS names the flight line or position of each point. None: the points
    name at most one, or the scan is not on a map.
    """
    if not is_on_map(frame):
        return None
    names = {name.lower().replace("_", ""): name for name in frame.fields}
    source = frame.fields.get(names.get("pointsourceid", ""))
    if source is None or source.ndim != 1 or not len(source):
        return None
    shares = np.unique(source, return_counts=True)[1] / len(source)
    number = int(np.count_nonzero(shares >= MIN_OF_SOURCE))
    if number < 2:
        return None
    return (
        f"the file names {number} flight lines or positions; if one explains the scan, give it "
        "(origin, --origin)"
    )


def _stands_on_lattice(scene: Scan, threads: int) -> bool:
    """Whether the points lie on the lattice of a spinning scanner at (0, 0, 0)."""
    judged = scene.points if scene.frame is None else scene.frame
    return generic_consistency(judged, threads=threads).verdict != "undecidable"
