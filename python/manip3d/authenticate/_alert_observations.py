"""Attack observations for the risk of a frame, made from the regions that its witnesses accuse."""

from __future__ import annotations

import math

from manip3d.authenticate._cross_modal import CrossModalResult, nearest_place
from manip3d.authenticate._inspection import Inspection
from manip3d.authenticate._risk import AttackObservation, RiskParameters, gravest_place
from manip3d.authenticate._surround import SurroundResult
from manip3d.authenticate._watermark import WatermarkResult
from manip3d.lidar import Box


def accused_boxes(
    watermark: WatermarkResult | None,
    cross: CrossModalResult | SurroundResult | None,
    forensics: Inspection | None,
) -> tuple[Box, ...]:
    """Boxes of all accusing witnesses, narrowest first: the watermark only locates sectors."""
    boxes: tuple[Box, ...] = ()
    if cross is not None and cross.verdict == "tampered":
        boxes += cross.boxes
    if forensics is not None and forensics.verdict == "tampered":
        boxes += tuple(region.box for region in forensics.regions)
    if watermark is not None and watermark.verdict == "tampered":
        boxes += tuple(region.box for region in watermark.regions)
    return boxes


def attack_observations(
    watermark: WatermarkResult | None,
    cross: CrossModalResult | SurroundResult | None,
    forensics: Inspection | None,
    speed_mps: float,
    region: RiskParameters,
) -> list[AttackObservation]:
    """One observation per accusing witness, most specific first: cameras, forensics, watermark."""
    observed = []
    if cross is not None:
        by_cameras = cross.observation(speed_mps=speed_mps, parameters=region)
        observed += [] if by_cameras is None else [by_cameras]
    if forensics is not None and forensics.verdict == "tampered":
        observed.append(_by_forensics(forensics, region, speed_mps))
    if watermark is not None and watermark.verdict == "tampered":
        observed.append(_by_tiles(watermark, region))
    return observed


def _by_forensics(found: Inspection, region: RiskParameters, speed_mps: float) -> AttackObservation:
    """The place is that of the gravest region; forensics do not tell the type of an attack."""
    changed = cells = 0
    if found.scan is not None:
        inside = region.contains(found.scan.points, speed_mps)
        suspected = {int(row) for each in found.regions for row in each.rows}
        changed, cells = sum(bool(inside[row]) for row in suspected), int(inside.sum())
    places = [nearest_place(each.box) for each in found.regions] or [(region.nearest_m, 0.0)]
    place = gravest_place(places, speed_mps, region)
    return AttackObservation("modification", place, changed, cells)


def _by_tiles(found: WatermarkResult, region: RiskParameters) -> AttackObservation:
    """The watermark only locates sectors, so that the most dangerous place in them is assumed."""
    azimuths = [
        azimuth for number in found.changed_tiles for azimuth in found.tiles[number].azimuths_deg
    ]
    angle = min((_to_ahead(begin, end) for begin, end in azimuths), default=0.0)
    place = (region.nearest_m * math.cos(angle), region.nearest_m * math.sin(angle))
    count = len(found.tiles)
    return AttackObservation("modification", place, len(found.changed_tiles) or count, count)


def _to_ahead(begin_deg: float, end_deg: float) -> float:
    """Smallest angle between straight ahead and a direction in the sector, radians."""
    if (end_deg - begin_deg) >= 360.0 or (-begin_deg) % 360.0 <= (end_deg - begin_deg) % 360.0:
        return 0.0
    return min(abs(math.radians(math.remainder(a, 360.0))) for a in (begin_deg, end_deg))
