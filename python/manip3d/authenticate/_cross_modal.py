"""Do LiDAR and cameras see the same scene? (dissertation section 7.3.2)"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d.authenticate._risk import AttackObservation, RiskParameters
from manip3d.authenticate._stereo import Disparity, StereoRig
from manip3d.authenticate._verdict import Calibration, Verdict, WithoutRate
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame, ScanLike, placed, to_scan

if TYPE_CHECKING:
    from numpy.typing import NDArray

LEAST_JUDGED = 0.05
"""Share of the map's cells below which nothing is said: darkness, fog, a covered lens."""

NEAR_M = 5.0
"""Something added and something missing within this distance are one thing that was changed."""

SHARE = 0.65
"""Exponent by which the least areas grow with the number of stereo pairs. Of 440 views of 88 clean
frames (simulated streets of seeds 0 to 29, five pairs, three frames a street) 23 reach the areas of
a single pair, 9 reach twice and 2 three times as much; five pairs of 2.85 times the area accuse
about as many frames as a single one does."""

STILL_THERE = 0.25
"""Least share of a missing object that points at most `NEAR_M` behind it cover where it was moved
away. At 4.5 m, the nearest range judged, an object moved by 5 m covers (4.5 / 9.5)^2 = 0.22 of its
outline, at 6 m 0.30."""

COMPARABLE = 3.0
"""Ratio of areas up to which two regions in the same direction are one thing as well."""


CALIBRATION = Calibration(
    "pairs that look ahead in 88 clean frames of simulated streets (seeds 0 to 29)",
    88,
    3,
    "KITTI's cameras and scanner by day; rain, night and other baselines are not covered",
)
"""Frames on which the parameters were chosen, those at the ends of streets among them."""

CLEAN_ACCUSED = (1, 120)
"""Clean frames that are accused, and all that were judged, of streets on which no parameter was
chosen: the stated rate of false accusations of a frame (experiment ``table-7.2-cross-modal``)."""


@checked
@dataclass(frozen=True)
class CrossModalParameters:
    """Parameters of `cross_modal_consistency`.

    Attributes
    ----------
    azimuth_step, elevation_step : float, degrees
        Size of a cell of the maps.
    half_azimuth : float, degrees
        The maps reach this far to each side of the heading.
    lowest, highest : float, degrees
        Elevations of the maps: the scanner's own field of view.
    min_range, max_range : float, metres
        What is nearer or farther is not judged. Added points must also be that far along the
        cameras' axis: what is nearer to them they cannot match.
    tolerance : float, pixels of disparity
        Largest difference between the two disparities that counts as agreement. A pixel is 0.26 m
        at 10 m with KITTI's cameras, 1 m at 20 m.
    dark_level : float, grey levels
        Where the picture is darker, that the scan has no point is weak evidence: dark paint, tyres
        and glass seen at a grazing angle return nothing to a scanner either.
    dark_weight : float
        0 to 1: what the area of a dark cell without a point counts.
    min_cells : int
        Fewest cells of a region.
    min_added_area, min_missing_area : float, square metres
        Least evidence of a region: its area, each cell at its own range, dark empty cells at their
        weight.
    heading : float or None, degrees
        Azimuth of the maps' middle, counter-clockwise from straight ahead; None: where the cameras
        look (`StereoRig.heading_deg`), to the nearest 5 degrees.

    Notes
    -----
    Chosen on 275 clean frames of simulated streets (seeds 0 to 39), 120 of them attacked, and 11
    real frames (KITTI raw drive 2011_09_26_0002 and odometry 00). Of 120 clean frames of other
    streets 1 is accused, of 6 other real ones none (experiment ``table-7.2-cross-modal``). At ten
    frames a second that is a false alarm every few seconds: one contradiction in one frame is a
    reason to look, not a proof. `RiskTracker` weighs how long it lasts.
    """

    azimuth_step: float = 0.3
    elevation_step: float = 0.45
    half_azimuth: float = 45.0
    lowest: float = -24.0
    highest: float = 1.5
    min_range: float = 4.5
    max_range: float = 30.0
    tolerance: float = 2.0
    dark_level: float = 50.0
    dark_weight: float = 0.25
    min_cells: int = 25
    min_added_area: float = 0.25
    min_missing_area: float = 0.2
    heading: float | None = None

    def shared(self, pairs: int) -> CrossModalParameters:
        """Return the parameters of each of several pairs, which share a frame's false alarms.

        A frame is accused if a pair accuses it: as many pairs with the areas of a single one accuse
        as many times the clean frames.

        Parameters
        ----------
        pairs : int
            Stereo pairs that judge each frame.

        Raises
        ------
        InputError
            Fewer than one.

        Examples
        --------
        >>> from manip3d.authenticate import CrossModalParameters
        >>> round(CrossModalParameters(min_added_area=0.25).shared(5).min_added_area, 2)
        0.71
        """
        if pairs < 1:
            raise InputError(f"pairs: expected 1 or more, got {pairs}")
        factor = float(pairs) ** SHARE
        return replace(
            self,
            min_added_area=factor * self.min_added_area,
            min_missing_area=factor * self.min_missing_area,
        )

    def to_core(self) -> _core.CrossModalOptions:
        """Return the same for the core."""
        options = _core.CrossModalOptions()
        for each in fields(self):
            value = getattr(self, each.name)
            if value is not None:
                setattr(options, each.name, value)
        return options


@dataclass(frozen=True, eq=False)
class CrossModalRegion:
    """Neighbouring directions in which LiDAR and cameras contradict each other in the same way.

    Attributes
    ----------
    kind : 'added' or 'missing'
        What the LiDAR scan has, or lacks, by the cameras.
    cells : int
    empty : int
        Cells without any point of the scan.
    solid_angle : float, steradians
    area : float, square metres
        Each cell at its own range.
    difference : float, pixels of disparity
        Mean; the LiDAR is nearer where it is positive.
    box : Box
        Around the added points, or around what the cameras see and the LiDAR does not.
    score : float
        Evidence over the least that counts.
    dark : int
        Cells without any point that are dark in the picture.
    evidence : float, square metres
        The area with those cells at their weight.
    rows : (K,) int64
        Rows of the added points; none where something is missing.
    behind : int
        Cells of something missing with a point at most 5 m behind what the cameras see.
    """

    kind: str
    cells: int
    empty: int
    solid_angle: float
    area: float
    difference: float
    box: Box
    score: float
    dark: int = 0
    evidence: float = 0.0
    rows: NDArray[np.int64] = field(
        default_factory=lambda: np.empty(0, np.int64), repr=False, compare=False
    )
    behind: int = 0

    @property
    def p_value(self) -> float | None:
        """None: the tail of clean scenes is not known well enough to state one."""
        return None

    @property
    def azimuth(self) -> tuple[float, float]:
        """Azimuths between which the box lies, radians, counter-clockwise from the first.

        The middle of the box lies within pi of straight ahead; the ends may lie beyond.
        """
        (x, y, _), (length, width, _) = self.box.center, self.box.size
        cosine, sine = math.cos(self.box.yaw), math.sin(self.box.yaw)
        middle = math.atan2(y, x)
        angles = []
        for sx, sy in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
            along, across = sx * length / 2, sy * width / 2
            corner = math.atan2(y + sine * along + cosine * across,
                                x + cosine * along - sine * across)  # fmt: skip
            angles.append(middle + math.remainder(corner - middle, 2.0 * math.pi))
        return min(angles), max(angles)

    def record(self) -> dict[str, object]:
        """Return the fields, ready for JSON."""
        return {
            "kind": self.kind,
            "cells": self.cells,
            "empty": self.empty,
            "dark": self.dark,
            "behind": self.behind,
            "area": self.area,
            "evidence": self.evidence,
            "difference": self.difference,
            "score": self.score,
            "center": list(self.box.center),
            "size": list(self.box.size),
        }


@dataclass(frozen=True, eq=False)
class CrossModalResult(WithoutRate):
    """Result of `cross_modal_consistency`.

    Attributes
    ----------
    verdict : 'no_trace', 'tampered' or 'undecidable'
        Verdict on the field of view that LiDAR and cameras share, and on nothing else.
    reason : str
        In words.
    attack : str
        ``additive``, ``subtractive``, ``both`` or ``modification``; empty: no region.
    regions : tuple of CrossModalRegion
        The largest area first.
    boxes : tuple of Box
        Boxes of the regions, in the LiDAR's frame.
    suspected : int32 array
        Rows of added points, ascending.
    lidar, stereo : (H, W) float32, metres
        Ranges; 0: nothing. Row 0 is the highest elevation, column 0 the leftmost azimuth.
    heading : float, degrees
        Azimuth of the maps' middle.
    difference : (H, W) float32, pixels of disparity
        LiDAR minus stereo; 0 where nothing is judged.
    mask : (H, W) int8
        Cells of regions: 1 added, -1 missing.
    judged : (H, W) bool
        Where a contradiction would have been seen.
    judged_points : float
        Share of the scan's points that lie in judged cells; nothing is said of the others.
    judged_cells : float
        Share of the map's cells.
    score : float
        Largest score of a region above the thresholds; 0: none.
    parameters : CrossModalParameters
    scan : LidarFrame or None
    """

    verdict: Verdict
    reason: str
    attack: str
    regions: tuple[CrossModalRegion, ...]
    suspected: NDArray[np.int32]
    lidar: NDArray[np.float32]
    stereo: NDArray[np.float32]
    difference: NDArray[np.float32]
    mask: NDArray[np.int8]
    judged: NDArray[np.bool_]
    judged_points: float
    judged_cells: float
    score: float
    parameters: CrossModalParameters
    scan: LidarFrame | None = field(default=None, repr=False)
    heading: float = 0.0

    @property
    def calibration(self) -> Calibration | None:
        """The clean frames that the areas and the tolerance were held against."""
        return CALIBRATION

    @property
    def judged_azimuth_deg(self) -> tuple[float, float]:
        """Leftmost and rightmost azimuth that is judged at all, degrees; (0, 0): none.

        Of cameras that look to the side or back they may lie beyond 180 degrees.
        """
        columns = np.flatnonzero(self.judged.any(axis=0))
        if not len(columns):
            return (0.0, 0.0)
        p = self.parameters
        left = self.heading + p.half_azimuth
        return (
            left - p.azimuth_step * float(columns[0]),
            left - p.azimuth_step * float(columns[-1] + 1),
        )

    def observation(
        self, *, speed_mps: float, parameters: RiskParameters | None = None
    ) -> AttackObservation | None:
        """Return the attack as `RiskTracker.update` takes it; None: no region.

        Parameters
        ----------
        speed_mps : float, m/s
            Speed of the car, which says how far the safety region reaches.
        parameters : RiskParameters, optional
            The safety region.
        """
        if not self.regions or self.verdict != "tampered":
            return None
        near = min(self.regions, key=lambda each: _nearest(each.box))
        changed, judged = self.cells_in_region(speed_mps, parameters)
        return AttackObservation(self.attack, nearest_place(near.box), changed, judged)

    def cells_in_region(
        self, speed_mps: float, parameters: RiskParameters | None = None
    ) -> tuple[int, int]:
        """Return how many cells of the safety region were changed, and how many are judged.

        Parameters
        ----------
        speed_mps : float, m/s
            Speed of the car, which says how far the safety region reaches.
        parameters : RiskParameters, optional
            The safety region.
        """
        region = RiskParameters() if parameters is None else parameters
        inside = self._in_region(region, speed_mps) & self.judged
        return int(np.count_nonzero(inside & (self.mask != 0))), int(np.count_nonzero(inside))

    def _in_region(self, region: RiskParameters, speed_mps: float) -> NDArray[np.bool_]:
        """Cells whose surface lies in the safety region: what is missing counts where it was."""
        p = self.parameters
        rows, columns = self.mask.shape
        left = self.heading + p.half_azimuth
        azimuth = np.radians(left - p.azimuth_step * (np.arange(columns) + 0.5))
        elevation = np.radians(p.highest - p.elevation_step * (np.arange(rows) + 0.5))[:, None]
        seen = np.where(self.mask < 0, self.stereo, self.lidar)
        distance = np.where(seen > 0.0, seen, self.stereo).astype(np.float64)
        over_ground = distance * np.cos(elevation)
        ahead, left = over_ground * np.cos(azimuth), over_ground * np.sin(azimuth)
        places = np.stack([ahead, left, distance * np.sin(elevation)], axis=-1)
        return np.asarray((distance > 0.0) & region.contains(places, speed_mps))

    def record(self) -> dict[str, object]:
        """Return what was found without the maps, ready for JSON."""
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "attack": self.attack,
            "score": self.score,
            "judged_points": self.judged_points,
            "judged_cells": self.judged_cells,
            "judged_azimuth_deg": list(self.judged_azimuth_deg),
            "regions": [region.record() for region in self.regions],
        }


@checked
def cross_modal_consistency(
    scan: ScanLike,
    disparity: Disparity,
    rig: StereoRig,
    *,
    parameters: CrossModalParameters | None = None,
) -> CrossModalResult:
    """Compare a LiDAR scan with what a stereo pair saw at the same moment.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Metres; x forward, y left, z up, the scanner at the origin.
    disparity : Disparity
        Disparity of the left image, see `stereo_disparity`.
    rig : StereoRig
    parameters : CrossModalParameters, optional

    Returns
    -------
    CrossModalResult
        ``undecidable`` where the cameras measured too little to say anything.

    Raises
    ------
    InputError
        A coordinate is not finite, a parameter is out of range.

    Notes
    -----
    Both become equirectangular maps of inverse range, in which the error of stereo is the same
    near and far. Something is added where a point is nearer than all that the cameras see in the
    3 x 3 cells around, missing where all that the cameras see there is nearer than every point.
    Where a dark surface returns nothing at all, that counts a quarter (`CrossModalParameters`).
    The cameras must be trustworthy themselves, by a watermark of their own.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import Disparity, StereoRig, cross_modal_consistency
    >>> ahead = np.eye(4)[[2, 0, 1, 3]] * [[1], [-1], [-1], [1]]  # the camera looks along x
    >>> rig = StereoRig(360.0, (309.5, 86.0), 0.54, ahead)
    >>> wall = Disparity(np.full((188, 620), 360 * 0.54 / 20, np.float32))  # 20 m away
    >>> y, z = np.mgrid[-18:18:0.05, -6:6:0.05].reshape(2, -1)
    >>> scan = np.stack([np.full_like(y, 20), y, z], axis=1).astype(np.float32)
    >>> cross_modal_consistency(scan, wall, rig).verdict
    'no_trace'
    >>> scan[(abs(y) < 2) & (abs(z) < 1.5)] *= 0.5  # halfway stands what the cameras do not see
    >>> found = cross_modal_consistency(scan, wall, rig)
    >>> found.verdict, found.attack
    ('tampered', 'additive')
    """
    scene = to_scan(scan)
    chosen = CrossModalParameters() if parameters is None else parameters
    heading = _to_five_degrees(rig.heading_deg) if chosen.heading is None else chosen.heading
    in_pixels_of_map = replace(chosen, tolerance=chosen.tolerance / disparity.step, heading=heading)
    found, components = _core.compare_cross_modal(
        scene.points,
        disparity.values,
        disparity.camera(rig),
        rig.T_lidar_camera,
        in_pixels_of_map.to_core(),
        disparity.grey,
    )
    shape = (found["rows"], found["columns"])
    judged = found["judged"].reshape(shape).astype(bool)
    cells = float(np.mean(judged))
    suspected = found["suspected"]
    component = found["suspected_component"]
    if cells < LEAST_JUDGED:  # nothing is said, so nobody is suspected
        suspected, component = suspected[:0], component[:0]
    regions = tuple(
        _region(values, chosen, disparity.step, heading, suspected[component == number])
        for number, values in enumerate(components)
    )
    points = found["judged_points"] / max(len(scene.points), 1)
    verdict: Verdict = "no_trace"
    reason = f"no contradiction in the shared field of view ({points:.0%} of the points)"
    if cells < LEAST_JUDGED:
        verdict = "undecidable"
        reason = f"the cameras measured too little: {cells:.1%} of the map can be judged"
    elif regions:
        verdict = "tampered"
        reason = _in_words(regions)
    return CrossModalResult(
        verdict,
        reason,
        attack_type(regions) if verdict == "tampered" else "",
        regions,
        suspected,
        found["lidar"].reshape(shape),
        found["stereo"].reshape(shape),
        found["difference"].reshape(shape) * np.float32(disparity.step),
        found["mask"].reshape(shape),
        judged,
        points,
        cells,
        max((region.score for region in regions), default=0.0),
        chosen,
        placed(scene, np.zeros(3)),
        heading,
    )


def _to_five_degrees(heading: float) -> float:
    """Cameras that look ahead but for their mounting are compared in the LiDAR's own axes."""
    return 5.0 * round(heading / 5.0) + 0.0  # never -0


@checked
def attack_type(regions: Sequence[CrossModalRegion]) -> str:
    """Return the type of an attack from its regions (section 7.4).

    Something added and something missing within 5 m of each other, or of comparable area in the
    same direction, are one object that was moved, turned or replaced: a modification. An object
    that was moved away stands behind what the cameras see, and is added nowhere: something missing
    is a modification where most points of the scan there lie at most 5 m behind it and cover a
    quarter of it. A removed object passes as one, too, where the ground behind it is so near, as
    behind something 0.8 m high at 8 m, or where a wall was filled in so near behind it.

    Parameters
    ----------
    regions : sequence of CrossModalRegion

    Returns
    -------
    str
        ``additive``, ``subtractive``, ``both`` or ``modification``; empty: no region.

    Raises
    ------
    InputError
        ``regions`` holds something else than regions.

    Examples
    --------
    >>> from manip3d import Box
    >>> from manip3d.authenticate import CrossModalRegion, attack_type
    >>> here, there = Box((8, 0, 0), (2, 2, 2)), Box((8, 4, 0), (2, 2, 2))
    >>> added = CrossModalRegion("added", 40, 0, 0.05, 3.0, 5.0, here, 2.0)
    >>> missing = CrossModalRegion("missing", 40, 12, 0.05, 3.0, -5.0, there, 2.0)
    >>> attack_type([added]), attack_type([missing]), attack_type([added, missing])
    ('additive', 'subtractive', 'modification')
    >>> moved_away = CrossModalRegion("missing", 40, 2, 0.05, 3.0, -5.0, there, 2.0, behind=35)
    >>> attack_type([moved_away])
    'modification'
    """
    added = [region for region in regions if region.kind == "added"]
    missing = [region for region in regions if region.kind == "missing"]
    if any(_is_moved_away(m) for m in missing):
        return "modification"
    if any(_is_one_object(a, m) for a in added for m in missing):
        return "modification"
    if added and missing:
        return "both"
    return "additive" if added else "subtractive" if missing else ""


def _is_moved_away(missing: CrossModalRegion) -> bool:
    """Whether the points that the scan has in place of an object may be the object itself.

    Walls that a removed object hid lie farther behind it, as a rule, and so does the ground behind
    most of what is taller than a metre.
    """
    points = missing.cells - missing.empty
    return missing.behind >= max(STILL_THERE * missing.cells, points / 2)


def _is_one_object(added: CrossModalRegion, missing: CrossModalRegion) -> bool:
    if math.dist(added.box.center[:2], missing.box.center[:2]) <= NEAR_M:
        return True
    ratio = max(added.area, missing.area) / min(added.area, missing.area)
    return _overlap(added.azimuth, missing.azimuth) and ratio <= COMPARABLE


def _overlap(a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether two ranges of azimuths have one in common, also across straight behind."""
    turn = 2.0 * math.pi
    return any(a[0] <= b[1] + shift and b[0] + shift <= a[1] for shift in (-turn, 0.0, turn))


def _region(
    values: tuple[Any, ...],
    parameters: CrossModalParameters,
    step: int,
    heading: float,
    rows: NDArray[np.int32],
) -> CrossModalRegion:
    (
        added,
        cells,
        empty,
        dark,
        behind,
        solid_angle,
        area,
        evidence,
        difference,
        lower,
        upper,
        center,
    ) = values
    least = parameters.min_added_area if added else parameters.min_missing_area
    x, y, z = center
    length, width, height = (b - a for a, b in zip(lower, upper, strict=True))
    return CrossModalRegion(
        "added" if added else "missing",
        cells,
        empty,
        solid_angle,
        area,
        difference * step,
        Box(
            (x, y, z),
            (length, width, height),
            math.radians(heading),
            "added" if added else "missing",
        ),
        evidence / least if least > 0.0 else math.inf,
        dark,
        evidence,
        rows.astype(np.int64),
        behind,
    )


def nearest_place(box: Box) -> tuple[float, float]:
    """Place of a box over the ground that is nearest to the scanner."""
    cosine, sine = math.cos(box.yaw), math.sin(box.yaw)
    x, y, _ = box.center
    own = (cosine * x + sine * y, cosine * y - sine * x)  # along the sides of the box
    along, across = (
        math.copysign(max(abs(at) - size / 2, 0.0), at)
        for at, size in zip(own, box.size[:2], strict=True)
    )
    return cosine * along - sine * across, sine * along + cosine * across


def _nearest(box: Box) -> float:
    return math.hypot(*nearest_place(box))


def _in_words(regions: Sequence[CrossModalRegion]) -> str:
    parts = []
    for kind, words in (("added", "that the cameras do not see"),
                        ("missing", "that the LiDAR does not see")):  # fmt: skip
        some = [region for region in regions if region.kind == kind]
        if some:
            near = min(some, key=lambda region: _nearest(region.box))
            count = "1 region" if len(some) == 1 else f"{len(some)} regions"
            parts.append(f"{count} {words}, the nearest at {_nearest(near.box):.1f} m")
    return "; ".join(parts)
