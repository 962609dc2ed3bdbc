"""Contradictions between a LiDAR scan and a stereo pair of cameras (dissertation section 7.3.2)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.authenticate._risk import AttackObservation, RiskParameters, gravest_place
from manip3d.authenticate._stereo import Disparity, StereoRig
from manip3d.authenticate._verdict import Calibration, Verdict, WithoutRate, verdict_repr
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame, ScanLike, placed, to_scan

if TYPE_CHECKING:
    from numpy.typing import NDArray

MIN_JUDGED = 0.05
"""Least share of the map's cells that must be judged; with less, as in darkness, in fog or with a
covered lens, the result is undecidable."""

NEAR_M = 5.0
"""An added and a missing region within this distance, metres, are one object that was modified."""

SHARE = 0.65
"""The least areas of regions grow with this power of the number of stereo pairs. Of 440 views of 88
clean frames (simulated streets of seeds 0 to 29, five pairs, three frames per street) 23 reach the
areas of a single pair, 9 reach twice and 2 three times these areas. Five pairs with 2.85 times the
areas accuse about as many frames as a single pair does."""

STILL_THERE = 0.25
"""A missing object was moved away if points at most `NEAR_M` behind it cover at least this share of
it. An object at 4.5 m, the nearest range that is judged, that is moved by 5 m covers (4.5 / 9.5)^2
= 0.22 of its former outline; one at 6 m covers 0.30."""

COMPARABLE = 3.0
"""An added and a missing region in the same direction are one object, too, if the ratio of their
areas is at most this."""


CALIBRATION = Calibration(
    "pairs that look ahead in 88 clean frames of simulated streets (seeds 0 to 29)",
    88,
    3,
    "KITTI's cameras and scanner by day; rain, night and other baselines are not covered",
)
"""Frames on which the parameters were chosen, including those at the ends of streets."""

CLEAN_ACCUSED = (1, 120)
"""Number of accused and of judged clean frames, of streets on which no parameter was chosen. Their
ratio is the stated rate of false accusations per frame (experiment ``table-7.2-cross-modal``)."""


@checked
@dataclass(frozen=True)
class CrossModalParameters:
    """Parameters of `cross_modal_consistency`.

    Attributes
    ----------
    azimuth_step, elevation_step : float, degrees
        Size of a cell of the maps.
    half_azimuth : float, degrees
        Extent of the maps to each side of the heading.
    lowest, highest : float, degrees
        Extent of the maps in elevation: the scanner's field of view.
    min_range, max_range : float, metres
        Nearer and farther surfaces are not judged. Added points must also be at least ``min_range``
        away along the cameras' axis, because the cameras cannot match nearer points.
    tolerance : float, pixels of disparity
        LiDAR and cameras agree if their disparities differ by at most this. With KITTI's cameras a
        pixel corresponds to 0.26 m at 10 m, and to 1 m at 20 m.
    dark_level : float, grey levels
        If the picture is darker than this, a missing point of the scan is weak evidence, because
        dark paint, tyres and glass at a grazing angle return nothing to a scanner.
    dark_weight : float
        Weight, 0 to 1, of the area of a dark cell without a point.
    min_cells : int
        Fewest cells of a region.
    min_added_area, min_missing_area : float, square metres
        Least evidence of a region: the sum of its cells' areas, each at its own range; dark cells
        without a point have ``dark_weight``.
    heading : float or None, degrees
        Azimuth of the maps' middle, counter-clockwise from straight ahead; None: the direction of
        the cameras (`StereoRig.heading_deg`), rounded to 5 degrees.

    Notes
    -----
    The defaults were chosen on 275 clean frames of simulated streets (seeds 0 to 39), 120 of them
    also with attacks, and on 11 real frames (KITTI raw drive 2011_09_26_0002 and odometry 00). Of
    120 clean frames of other streets one is accused, of 6 other real frames none (experiment
    ``table-7.2-cross-modal``). At ten frames per second this is a false alarm every few seconds, so
    that a contradiction in a single frame is a reason to look, not a proof. `RiskTracker` takes
    into account how long an attack lasts.
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
        """Return the parameters for each of several pairs, at the false-alarm rate of a single one.

        A frame is accused if any pair accuses it. With the areas of a single pair, several pairs
        would accuse several times as many clean frames; the areas are therefore larger.

        Parameters
        ----------
        pairs : int
            Number of stereo pairs that judge each frame.

        Raises
        ------
        InputError
            ``pairs`` is less than 1.

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
        """Return the parameters as options of the core."""
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
        Whether the LiDAR scan shows, or lacks, an object that the cameras do not, or do, show.
    cells : int
        Number of cells of the map.
    empty : int
        Number of cells without any point of the scan.
    solid_angle : float, steradians
        Solid angle of the cells.
    area : float, square metres
        Sum of the cells' areas, each at its own range.
    difference : float, pixels of disparity
        Mean disparity of the LiDAR minus that of the cameras; positive: the LiDAR is nearer.
    box : Box
        Box around the added points, or around the missing surface that the cameras see.
    score : float
        Evidence divided by the least evidence of a region of its kind.
    dark : int
        Number of empty cells that are dark in the picture.
    evidence : float, square metres
        Area in which dark empty cells have the weight `CrossModalParameters.dark_weight`.
    rows : (K,) int64
        Rows of the added points; empty for a missing region.
    behind : int
        Number of cells of a missing region with a point at most 5 m behind the surface that the
        cameras see.
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

    __repr__ = short_repr

    @property
    def p_value(self) -> float | None:
        """None, because the scores of clean scenes are not known well enough for a p-value."""
        return None

    @property
    def azimuth(self) -> tuple[float, float]:
        """Right and left end of the box in azimuth, radians, counter-clockwise.

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
        Reason of the verdict in words.
    attack : str
        ``additive``, ``subtractive``, ``both`` or ``modification``; empty: no region.
    regions : tuple of CrossModalRegion
        Contradictions, the largest area first.
    boxes : tuple of Box
        Boxes of the regions, in the LiDAR's frame.
    suspected : int32 array
        Rows of added points, ascending.
    lidar, stereo : (H, W) float32, metres
        Maps of ranges; 0: no measurement. Row 0 is the highest elevation, column 0 the leftmost
        azimuth.
    heading : float, degrees
        Azimuth of the maps' middle.
    difference : (H, W) float32, pixels of disparity
        Disparity of the LiDAR minus that of stereo; 0 in cells that are not judged.
    mask : (H, W) int8
        Cells of the regions: 1 added, -1 missing, 0 none.
    judged : (H, W) bool
        Cells in which a contradiction would have been found.
    judged_points : float
        Share of the scan's points that lie in judged cells; the verdict does not concern the
        others.
    judged_cells : float
        Share of the map's cells that are judged.
    score : float
        Largest score of a region; 0: no region.
    parameters : CrossModalParameters
        Parameters of the comparison.
    scan : LidarFrame or None
        The scan that was judged; the viewer shows it.
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

    __repr__ = verdict_repr

    @property
    def calibration(self) -> Calibration | None:
        """Clean frames on which the areas and the tolerance were chosen."""
        return CALIBRATION

    @property
    def judged_azimuth_deg(self) -> tuple[float, float]:
        """Leftmost and rightmost azimuth of the judged cells, degrees; (0, 0): none.

        If cameras look to the side or to the rear, azimuths may lie beyond 180 degrees.
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
        """Return the attack for `RiskTracker.update`; None if the frame is not accused.

        Parameters
        ----------
        speed_mps : float, m/s
            Speed of the car, which determines the length of the safety region.
        parameters : RiskParameters, optional
            The safety region.
        """
        if not self.regions or self.verdict != "tampered":
            return None
        region = RiskParameters() if parameters is None else parameters
        changed, judged = self.cells_in_region(speed_mps, region)
        place = gravest_place(map(nearest_place, self.boxes), speed_mps, region)
        return AttackObservation(self.attack, place, changed, judged)

    def cells_in_region(
        self, speed_mps: float, parameters: RiskParameters | None = None
    ) -> tuple[int, int]:
        """Return the number of changed and of judged cells in the safety region.

        Parameters
        ----------
        speed_mps : float, m/s
            Speed of the car, which determines the length of the safety region.
        parameters : RiskParameters, optional
            The safety region.
        """
        region = RiskParameters() if parameters is None else parameters
        inside = self._in_region(region, speed_mps) & self.judged
        return int(np.count_nonzero(inside & (self.mask != 0))), int(np.count_nonzero(inside))

    def _in_region(self, region: RiskParameters, speed_mps: float) -> NDArray[np.bool_]:
        """Cells whose surface lies in the safety region; missing surfaces by the cameras' range."""
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
        """Return the result without the maps, ready for JSON."""
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
    """Compare a LiDAR scan with the disparity of a stereo pair from the same moment.

    Parameters
    ----------
    scan : LidarFrame, (N, 3) or (N, 4) float32
        Scan in metres; x forward, y left, z up, the scanner at the origin.
    disparity : Disparity
        Disparity of the left image, see `stereo_disparity`.
    rig : StereoRig
        The stereo pair, and its pose in the LiDAR's frame.
    parameters : CrossModalParameters, optional
        Default: ``CrossModalParameters()``.

    Returns
    -------
    CrossModalResult
        ``undecidable`` if the cameras measured too little to judge the scan.

    Raises
    ------
    InputError
        A coordinate is not finite, or a parameter is out of range.

    Notes
    -----
    Both are projected to equirectangular maps of inverse range, in which the error of stereo is the
    same near and far. A cell is added if its point is nearer than all surfaces that the cameras see
    in the 3 x 3 cells around it, and missing if all these surfaces are nearer than every point of
    the scan there. A dark surface without any return counts a quarter (`CrossModalParameters`). The
    pictures must be trustworthy, which a watermark of their own can ensure.

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
    >>> scan[(abs(y) < 2) & (abs(z) < 1.5)] *= 0.5  # an object halfway that the cameras do not see
    >>> found = cross_modal_consistency(scan, wall, rig)
    >>> found.verdict, found.attack
    ('tampered', 'additive')
    """
    scene = to_scan(scan)
    chosen = CrossModalParameters() if parameters is None else parameters
    heading = _to_five_degrees(rig.heading_deg) if chosen.heading is None else chosen.heading
    in_pixels_of_map = replace(chosen, tolerance=chosen.tolerance / disparity.step, heading=heading)
    found = _core.compare_cross_modal(
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
    if cells < MIN_JUDGED:  # undecidable: no points are suspected
        suspected, component = suspected[:0], component[:0]
    regions = tuple(
        _region(values, chosen, disparity.step, heading, suspected[component == number])
        for number, values in enumerate(found["components"])
    )
    points = found["judged_points"] / max(len(scene.points), 1)
    verdict: Verdict = "no_trace"
    reason = f"no contradiction in the shared field of view ({points:.0%} of the points)"
    if cells < MIN_JUDGED:
        verdict = "undecidable"
        reason = f"the cameras measured too little: {cells:.1%} of the map can be judged"
    elif regions:
        verdict = "tampered"
        reason = _in_words(regions)
    return CrossModalResult(
        verdict=verdict,
        reason=reason,
        attack=attack_type(regions) if verdict == "tampered" else "",
        regions=regions,
        suspected=suspected,
        lidar=found["lidar"].reshape(shape),
        stereo=found["stereo"].reshape(shape),
        difference=found["difference"].reshape(shape) * np.float32(disparity.step),
        mask=found["mask"].reshape(shape),
        judged=judged,
        judged_points=points,
        judged_cells=cells,
        score=max((region.score for region in regions), default=0.0),
        parameters=chosen,
        scan=placed(scene, np.zeros(3)),
        heading=heading,
    )


def _to_five_degrees(heading: float) -> float:
    """Round, so that cameras that look ahead are compared in the LiDAR's own axes."""
    return 5.0 * round(heading / 5.0) + 0.0  # never -0


@checked
def attack_type(regions: Sequence[CrossModalRegion]) -> str:
    """Return the type of an attack from its regions (section 7.4).

    An added and a missing region within 5 m of each other, or of comparable area in the same
    direction, are one object that was moved, turned or replaced: a modification. An object that was
    moved away from the scanner is behind the place where the cameras see it, so that no region is
    added. A missing region alone is therefore a modification if most points of the scan there lie
    at most 5 m behind it and cover at least a quarter of it. A removed object is also taken for a
    modification if the ground is that near behind it, as behind an object 0.8 m high at 8 m, or if
    a wall was filled in that near behind it.

    Parameters
    ----------
    regions : sequence of CrossModalRegion
        Regions of a `CrossModalResult`.

    Returns
    -------
    str
        ``additive``, ``subtractive``, ``both`` or ``modification``; empty: no region.

    Raises
    ------
    InputError
        ``regions`` holds an item of another type.

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
    """Whether the points behind a missing object may be the object itself.

    Walls behind a removed object, and the ground behind objects taller than a metre, are usually
    farther away.
    """
    points = missing.cells - missing.empty
    return missing.behind >= max(STILL_THERE * missing.cells, points / 2)


def _is_one_object(added: CrossModalRegion, missing: CrossModalRegion) -> bool:
    if math.dist(added.box.center[:2], missing.box.center[:2]) <= NEAR_M:
        return True
    small, large = sorted((added.area, missing.area))
    return _overlap(added.azimuth, missing.azimuth) and large <= COMPARABLE * small


def _overlap(a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether two ranges of azimuths overlap, modulo a full turn."""
    turn = 2.0 * math.pi
    return any(a[0] <= b[1] + shift and b[0] + shift <= a[1] for shift in (-turn, 0.0, turn))


def _region(
    values: Mapping[str, Any],
    parameters: CrossModalParameters,
    step: int,
    heading: float,
    rows: NDArray[np.int32],
) -> CrossModalRegion:
    """Return a region of the kernel's answer, whose score is its evidence per least evidence."""
    kind = "added" if values["added"] else "missing"
    least = parameters.min_added_area if values["added"] else parameters.min_missing_area
    length, width, height = (b - a for a, b in zip(values["lower"], values["upper"], strict=True))
    return CrossModalRegion(
        kind=kind,
        cells=values["cells"],
        empty=values["empty"],
        solid_angle=values["solid_angle"],
        area=values["area"],
        difference=values["difference"] * step,
        box=Box(values["center"], (length, width, height), math.radians(heading), kind),
        score=values["evidence"] / least if least > 0.0 else math.inf,
        dark=values["dark"],
        evidence=values["evidence"],
        rows=rows.astype(np.int64),
        behind=values["behind"],
    )


def nearest_place(box: Box) -> tuple[float, float]:
    """Point of a box's outline on the ground that is nearest to the scanner, metres."""
    cosine, sine = math.cos(box.yaw), math.sin(box.yaw)
    x, y, _ = box.center
    own = (cosine * x + sine * y, cosine * y - sine * x)  # along the sides of the box
    along, across = (
        math.copysign(max(abs(at) - size / 2, 0.0), at)
        for at, size in zip(own, box.size[:2], strict=True)
    )
    # + 0.0 makes 0.0 of -0.0: a box around the scanner is not behind it, as (-0.0, 0.0) is.
    return cosine * along - sine * across + 0.0, sine * along + cosine * across + 0.0


def _nearest(box: Box) -> float:
    return math.hypot(*nearest_place(box))


def _in_words(regions: Sequence[CrossModalRegion]) -> str:
    parts = []
    for kind, words in (("added", "that the cameras do not see"),
                        ("missing", "that the LiDAR does not see")):  # fmt: skip
        some = [region for region in regions if region.kind == kind]
        if some:
            near = min(some, key=lambda region: _nearest(region.box))
            count = counted(len(some), "region")
            parts.append(f"{count} {words}, the nearest at {_nearest(near.box):.1f} m")
    return "; ".join(parts)
