"""Detector II: points that lie behind other points in the same direction
(IsOcclusionConsistent)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import threads_of
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.authenticate._angular_cells import angular_cells
from manip3d.authenticate._echoes import are_echoes
from manip3d.authenticate._origin import NO_ORIGIN, scanner_position
from manip3d.authenticate._verdict import Calibration, Verdict, WithoutRate, verdict_repr
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame, Scan, ScanLike, origin_of, placed, to_scan

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


MIN_POINTS = 1000
"""A scan with fewer points covers too little of the sphere."""

MIN_CELLS = 500
"""Fewest cells with points of a scan that can be judged; copies of a few points cannot."""


@dataclass(frozen=True)
class AngularGrid:
    """Cells of azimuth and elevation; see :func:`estimate_grid`.

    Attributes
    ----------
    azimuth_deg, elevation_deg : float
        Size of a cell, degrees.
    azimuth_phase_deg, elevation_phase_deg : float
        Centre of any one column and of any one row, degrees.
    azimuth_strength, elevation_strength : float
        Coherence of the scan's angles with the grid, 0 to 1; 0: no period was found, and the size
        follows from the density of points.
    """

    azimuth_deg: float
    elevation_deg: float
    azimuth_phase_deg: float = 0.0
    elevation_phase_deg: float = 0.0
    azimuth_strength: float = 0.0
    elevation_strength: float = 0.0


@checked
@dataclass(frozen=True)
class OcclusionParameters:
    """Parameters of `occlusion_consistency`.

    Attributes
    ----------
    min_gap : float, metres
        Least difference of the nearest and the farthest range of a cell with a gap; ``max(0.1, 5
        sigma)``, with the standard deviation ``sigma`` of the scanner's ranges.
    accumulate : bool
        Sum the gaps between a cell's successive points, as printed in the dissertation.
    min_cells : int
        Least size A_th of a region in cells; smaller regions can arise from noise by closing and
        median.
    min_area : float, square metres
        Least size A_th of a region as the silhouette of the smallest object to find: solid angle
        times squared range.
    max_range : float, metres
        Regions farther away are ignored.
    fused : float
        If more than this share of the occupied cells has a gap, no single position explains the
        scan.
    """

    min_gap: float = 0.1
    accumulate: bool = False
    min_cells: int = 40
    min_area: float = 0.01
    max_range: float = math.inf
    fused: float = 0.2

    def __post_init__(self) -> None:
        if not self.min_area >= 0.0:
            raise InputError(f"min_area: expected >= 0, got {self.min_area}")
        if not self.max_range > 0.0:
            raise InputError(f"max_range: expected > 0, got {self.max_range}")
        if not 0.0 < self.fused <= 1.0:
            raise InputError(f"fused: expected 0 < share <= 1, got {self.fused}")


PAPER_OCCLUSION = OcclusionParameters(accumulate=True, min_cells=200, min_area=0.0)
"""Parameters of the dissertation, whose A_th is "empirical" and not printed."""

CALIBRATED_OCCLUSION = OcclusionParameters()
"""Parameters for scanners whose points lie on a grid of azimuth and elevation."""

RINGS_OCCLUSION = OcclusionParameters(min_gap=1.0, min_cells=60, min_area=2.0, max_range=25.0)
"""Parameters for scanners whose rows are not lines of equal elevation (HDL-64E): neighbouring rows
share cells, so that only larger gaps and objects count. With an area of 0.5 m2, three of 332 clean
frames of KITTI that chose no parameter were accused, because of areas of 0.54 to 0.97 m2; 2 m2 is
twice the largest."""

RING_ROW = 0.6
"""Height of a cell divided by the mean spacing of rings. Rings of KITTI's HDL-64E are as close as
0.59 of that spacing. Higher cells contain two rings, and their different ranges at edges can form
regions, depending on where the cells happen to lie. With 0.75, three of 53 clean frames of KITTI
were accused."""

UNNUMBERED = (
    "later echoes of pulses lie behind the first ones, and the file does not number echoes: give "
    "return numbers"
)
"""Reason of a verdict on a scan in which later echoes alone are seen behind something."""

GRID_CALIBRATION = Calibration(
    scenes="calibration-indoor-00..05, calibration-outdoor-00..05 of manip3d.simulate.scenes",
    num_scans=12,
    false_alarms=0,
    note="simulated terrestrial scans of 0.06 degrees",
)
RINGS_CALIBRATION = Calibration(
    scenes="KITTI raw drive 2011_09_26_0002 (4 frames) and two unidentified drives (5 frames)",
    num_scans=9,
    false_alarms=0,
    note="HDL-64E; objects within 25 m",
)


@dataclass(frozen=True, eq=False)
class OcclusionRegion:
    """A connected region of cells in which points lie behind other points.

    Attributes
    ----------
    cells : int
        Number of cells.
    solid_angle : float, steradians
        Solid angle of the cells.
    range : float, metres
        Median range of the points in front.
    area : float, square metres
        Solid angle times squared range.
    mask_rows, mask_columns : (int, int)
        First and last row and column in `OcclusionResult.mask`; ``mask_columns[0] >
        mask_columns[1]``: the region crosses azimuth 180 degrees.
    box : Box
        Box around the suspected points.
    rows : (K,) int64
        Rows of the suspected points, ascending.
    """

    cells: int
    solid_angle: float
    range: float
    area: float
    mask_rows: tuple[int, int]
    mask_columns: tuple[int, int]
    box: Box
    rows: NDArray[np.int64]

    __repr__ = short_repr

    @property
    def p_value(self) -> float | None:
        """None, because the detector states no p-values."""
        return None


@dataclass(frozen=True, eq=False)
class OcclusionResult(WithoutRate):
    """Result of `occlusion_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
    reason : str
        Reason of the verdict in words.
    mask : (H, W) uint8
        Cells with gaps after closing and median; row 0 is the lowest elevation, column 0 azimuth
        -180 degrees.
    raw_mask : (H, W) uint8
        Cells with gaps before closing and median.
    regions : tuple of OcclusionRegion
        Regions above A_th, the largest first.
    suspected : int32 array
        Rows of the points in front, ascending.
    multiple : float
        Share of the occupied cells with a gap.
    score : float
        Area of the largest region with enough cells that is near enough, square metres, divided by
        ``min_area``; if that is 0, its number of cells divided by ``min_cells``.
    grid : AngularGrid
        Cells of the masks.
    lowest_deg : float
        Elevation of the lower border of the mask's row 0.
    parameters : OcclusionParameters
        Parameters of the detector.
    calibration : Calibration or None
        Clean scans on which the thresholds were chosen; None: they come from a publication or a
        user.
    scan : LidarFrame or None
        The scan that was judged; the viewer shows it.
    echoes : int
        Number of regions that later echoes of pulses explain, which the scan does not number; they
        are not among ``regions``. If no other region is left, the verdict is ``undecidable``.
    """

    verdict: Verdict
    reason: str
    mask: NDArray[np.uint8]
    raw_mask: NDArray[np.uint8]
    regions: tuple[OcclusionRegion, ...]
    suspected: NDArray[np.int32]
    multiple: float
    score: float
    grid: AngularGrid
    lowest_deg: float
    parameters: OcclusionParameters
    calibration: Calibration | None
    scan: LidarFrame | None = field(default=None, repr=False)
    echoes: int = 0

    __repr__ = verdict_repr


@checked
def estimate_grid(
    scan: ScanLike, *, origin: ArrayLike | None = None, threads: int = 0
) -> AngularGrid:
    """Find the angular grid of a scan: the periods of its azimuths and of its elevations.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        A scan taken from one position.
    origin : (3,), optional
        Position of the scanner, metres; default: that of the frame, else (0, 0, 0).
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    AngularGrid
        The grid; a strength is 0 if azimuths or elevations have no period. Periods from 0.016 to 2
        degrees are found; of a finer grid the result is a multiple of its step.

    Raises
    ------
    InputError
        A shape is wrong, a coordinate is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import estimate_grid
    >>> a, e = np.radians(np.mgrid[0:360:2, -40:60:2]).reshape(2, -1)
    >>> rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    >>> walls = (np.array([6, 4, 2]) / np.maximum(abs(rays), 1e-9)).min(axis=1, keepdims=True)
    >>> room = (rays * walls).astype(np.float32)
    >>> grid = estimate_grid(room)
    >>> grid.azimuth_deg, grid.elevation_deg
    (2.0, 2.0)
    """
    scene = to_scan(scan)
    grid = _core.estimate_scan_grid(scene.points, origin_of(origin, scene), threads_of(threads))
    return AngularGrid(
        azimuth_deg=math.degrees(grid.azimuth_step),
        elevation_deg=math.degrees(grid.elevation_step),
        azimuth_phase_deg=math.degrees(grid.azimuth_phase),
        elevation_phase_deg=math.degrees(grid.elevation_phase),
        azimuth_strength=grid.azimuth_strength,
        elevation_strength=grid.elevation_strength,
    )


@checked
def occlusion_consistency(
    scan: ScanLike,
    *,
    parameters: OcclusionParameters | None = None,
    grid: AngularGrid | None = None,
    origin: ArrayLike | None = None,
    threads: int = 0,
) -> OcclusionResult:
    """Find points that lie behind other points in the same direction: detector II.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        A scan taken from one position. If one of the fields ``target_index``, ``return_number``
        and ``returnIndex`` numbers the echoes of a pulse, later echoes behind the first echo of
        their cell are not judged.
    parameters : OcclusionParameters, optional
        Default: `CALIBRATED_OCCLUSION`, or `RINGS_OCCLUSION` if elevations have no period.
        `PAPER_OCCLUSION` has the dissertation's parameters.
    grid : AngularGrid, optional
        Cells of the image; default: estimated from the scan.
    origin : (3,), optional
        Position of the scanner, metres; default: that of the frame, else the result of
        `estimate_origin`; (0, 0, 0) for an array.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    OcclusionResult
        ``undecidable`` if no single position explains the scan: scans of several positions were
        fused, or ``origin`` is wrong; or if only later echoes of pulses, which the scan does not
        number, are seen behind something.

    Raises
    ------
    InputError
        A shape is wrong, a coordinate is not finite, a grid has too many cells.

    Notes
    -----
    Dissertation section 6.5.2, but with the farthest minus the nearest range of a cell instead of a
    sum that depends on the order of points. An added object is not found if the points behind it
    were removed.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import occlusion_consistency
    >>> a, e = np.radians(np.mgrid[0:360:1, -40:60:1]).reshape(2, -1)
    >>> rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
    >>> walls = (np.array([6, 4, 2]) / np.maximum(abs(rays), 1e-9)).min(axis=1, keepdims=True)
    >>> room = (rays * walls).astype(np.float32)
    >>> occlusion_consistency(room).verdict
    'no_trace'
    >>> ball = rays[(abs(a - 0.5) < 0.3) & (abs(e) < 0.3)] * 9  # behind the wall
    >>> found = occlusion_consistency(np.vstack([room, ball]).astype(np.float32))
    >>> found.verdict, found.reason
    ('tampered', '1 region in which something is seen behind something else')
    """
    scene = to_scan(scan)
    if len(scene.points) < MIN_POINTS:
        return _undecidable(f"fewer than {MIN_POINTS} points", grid, parameters)
    place = scanner_position(origin, scene, threads)
    if place is None:
        return _undecidable(NO_ORIGIN, grid, parameters)
    is_first = _first_echoes(scene)
    grid = grid or _grid_of(
        scene.points if is_first is None else scene.points[is_first], place, threads
    )
    judged = None if is_first is None else _not_behind(scene.points, is_first, place, grid)
    points = scene.points if judged is None else scene.points[judged]
    calibration = None
    if parameters is None:
        parameters, calibration = _parameters_for(grid)
    found = _core.occlusion_consistency(
        points=points,
        origin=place,
        grid=_core_grid(grid),
        min_gap=parameters.min_gap,
        accumulate=parameters.accumulate,
        min_cells=parameters.min_cells,
        min_area=0.0,
        max_range=min(parameters.max_range, 1e9),
        threads=threads_of(threads),
    )
    every = _regions_of(found, judged)
    regions = tuple(region for region in every if region.area >= parameters.min_area)
    echoes = 0
    if regions and is_first is None and grid.elevation_strength > 0.0 and not parameters.accumulate:
        explained = are_echoes(points, place, grid, [region.rows for region in regions])
        echoes = sum(explained)
        regions = tuple(
            each for each, is_echo in zip(regions, explained, strict=True) if not is_echo
        )
    share = found["multiple_cells"] / max(found["occupied_cells"], 1)
    verdict, reason = _judged(len(regions), found["occupied_cells"], share, parameters)
    if echoes and verdict == "no_trace":
        verdict, reason = "undecidable", UNNUMBERED
    shape = (found["rows"], found["columns"])
    return OcclusionResult(
        verdict=verdict,
        reason=reason,
        mask=found["mask"].reshape(shape),
        raw_mask=found["raw_mask"].reshape(shape),
        regions=regions,
        suspected=_rows_of(regions if verdict == "tampered" else ()),
        multiple=share,
        score=_score(every, parameters),
        grid=grid,
        lowest_deg=_lowest(grid) + found["first_row"] * grid.elevation_deg,
        parameters=parameters,
        calibration=calibration,
        scan=placed(scene, np.asarray(place, np.float64)),
        echoes=echoes,
    )


def _first_echoes(scan: Scan) -> NDArray[np.bool_] | None:
    """Mask of first echoes of pulses; None if the file does not number echoes."""
    if scan.frame is None:
        return None
    for name in ("target_index", "return_number", "returnIndex"):
        if name in scan.frame.fields:
            number = np.asarray(scan.frame.fields[name])
            lowest = number.min() if number.size else 0  # files number echoes from 0 or from 1
            return np.asarray(number == lowest)
    return None


def _not_behind(
    points: NDArray[np.float32],
    is_first: NDArray[np.bool_],
    place: NDArray[np.float64],
    grid: AngularGrid,
) -> NDArray[np.int64]:
    """Rows of the first echoes, and of others without a nearer first echo in their cell.

    The file alone says that a point is a later echo; a real one is behind the first of its pulse.
    """
    row, column, distance, columns = angular_cells(points.astype(np.float64) - place, grid)
    of_point = np.unique(row * columns + column, return_inverse=True)[1]
    nearest = np.full(len(points), np.inf)
    np.minimum.at(nearest, of_point[is_first], distance[is_first])
    return np.flatnonzero(is_first | (distance < nearest[of_point]))


def _grid_of(points: NDArray[np.float32], place: NDArray[np.float64], threads: int) -> AngularGrid:
    """Grid estimated from the scan; if elevations have no period, its rows follow the rings."""
    grid = estimate_grid(points, origin=place, threads=threads)
    return grid if grid.elevation_strength > 0.0 else _ring_cells(grid)


def _parameters_for(grid: AngularGrid) -> tuple[OcclusionParameters, Calibration]:
    """Calibrated parameters for elevations on a grid, or for rings."""
    if grid.elevation_strength > 0.0:
        return CALIBRATED_OCCLUSION, GRID_CALIBRATION
    return RINGS_OCCLUSION, RINGS_CALIBRATION


def _judged(
    num_regions: int, occupied: int, share: float, parameters: OcclusionParameters
) -> tuple[Verdict, str]:
    """Verdict and reason; ``share`` of the ``occupied`` cells has a gap."""
    if occupied < MIN_CELLS:
        return "undecidable", f"all points lie in {counted(occupied, 'direction')}"
    if share > parameters.fused:
        reason = f"{share:.0%} of the directions hold several ranges: no single position"
        return "undecidable", reason
    if num_regions:
        places = counted(num_regions, "region")
        return "tampered", f"{places} in which something is seen behind something else"
    return "no_trace", "nothing is seen behind anything"


def _ring_cells(grid: AngularGrid) -> AngularGrid:
    return replace(grid, elevation_deg=RING_ROW * grid.elevation_deg, elevation_phase_deg=0.0)


def _lowest(grid: AngularGrid) -> float:
    """Lower border of the first row, at or below -90 degrees; rows are centred on the phase."""
    periods = (grid.elevation_phase_deg + 90.0) / grid.elevation_deg
    border = periods - math.floor(periods) - 0.5
    return -90.0 + (border if border <= 0.0 else border - 1.0) * grid.elevation_deg


def _core_grid(grid: AngularGrid) -> _core.ScanGrid:
    """Return the grid for the core."""
    result = _core.ScanGrid()
    result.azimuth_step = math.radians(grid.azimuth_deg)
    result.elevation_step = math.radians(grid.elevation_deg)
    result.azimuth_phase = math.radians(grid.azimuth_phase_deg)
    result.elevation_phase = math.radians(grid.elevation_phase_deg)
    result.azimuth_strength = grid.azimuth_strength
    result.elevation_strength = grid.elevation_strength
    return result


def _regions_of(
    found: Mapping[str, Any], judged: NDArray[np.int64] | None
) -> tuple[OcclusionRegion, ...]:
    """Return all regions that the core found, the largest area first.

    ``judged`` are the rows of the scan that the core was given; None: all.
    """
    rows = found["suspected"].astype(np.int64)
    if judged is not None:
        rows = judged[rows]
    return tuple(
        _region(values, found["first_row"], rows[found["suspected_component"] == number])
        for number, values in enumerate(found["components"])
    )


def _region(
    values: Mapping[str, Any], first_row: int, members: NDArray[np.int64]
) -> OcclusionRegion:
    """Return a region; the mask's row 0 is row ``first_row`` of the core's grid."""
    center, size, yaw = values["box"]
    return OcclusionRegion(
        cells=values["cells"],
        solid_angle=values["solid_angle"],
        range=values["range"],
        area=values["area"],
        mask_rows=(values["first_row"] - first_row, values["last_row"] - first_row),
        mask_columns=(values["first_column"], values["last_column"]),
        box=Box(tuple(center), tuple(size), yaw),
        rows=members,
    )


def _rows_of(regions: Sequence[OcclusionRegion]) -> NDArray[np.int32]:
    """Return the rows of the regions' points, ascending; each point is in one region."""
    rows = [np.empty(0, np.int64), *(region.rows for region in regions)]
    return np.sort(np.concatenate(rows)).astype(np.int32)


def _score(regions: tuple[OcclusionRegion, ...], parameters: OcclusionParameters) -> float:
    if not regions:
        return 0.0
    if parameters.min_area > 0.0:
        return regions[0].area / parameters.min_area
    return max(region.cells for region in regions) / parameters.min_cells


def _undecidable(
    reason: str, grid: AngularGrid | None, parameters: OcclusionParameters | None
) -> OcclusionResult:
    nothing = np.empty((0, 0), np.uint8)
    return OcclusionResult(
        verdict="undecidable",
        reason=reason,
        mask=nothing,
        raw_mask=nothing,
        regions=(),
        suspected=np.empty(0, np.int32),
        multiple=0.0,
        score=0.0,
        grid=grid or AngularGrid(0.0, 0.0),
        lowest_deg=-90.0,
        parameters=parameters or CALIBRATED_OCCLUSION,
        calibration=None,
    )
