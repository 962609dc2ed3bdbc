"""Position and kind of the scanner that took a scan."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from manip3d.authenticate._lattice import LatticeReading, SensorLattice
from manip3d.authenticate._origin import (
    MIN_EXPLAINED,
    estimate_origin,
    is_on_map,
    several_sources,
)
from manip3d.authenticate._sensors import (
    NOT_IN_METRES,
    Sensor,
    height_above_origin,
    identify_and_read,
    is_in_metres,
    nothing_to_tell,
)
from manip3d.lidar import LidarFrame, position_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    Position = tuple[float, float, float]


ON_LATTICE = "the lattice of a spinning scanner"
"""Source of a position that follows from a scanner's lattice."""

Identified = tuple[Sensor, "LatticeReading | None"]
"""The scanner, and the places of the scan's points on its lattice if they were computed."""


def scanner_of(
    frame: LidarFrame, origin: ArrayLike | None, lattice: SensorLattice | None, threads: int
) -> tuple[Position | None, str, Identified | None]:
    """The scanner's position and its source; or None and why the scan cannot be judged.

    The third item is the scanner if it was identified: if its lattice determines the position, or
    if it is at the origin of the coordinates.
    """
    stated = origin if origin is not None else frame.origin
    if stated is None:
        if frame.num_points == 0:
            return None, "the scan has no points", None
        if (why := several_sources(frame)) is not None:
            return None, why, None
        if lattice is None and is_on_map(frame):  # a lattice has the scanner at 0
            found = estimate_origin(frame, threads=threads)
            return found.position, found.reason, None
        identified = identify_and_read(frame, lattice=lattice, threads=threads)
        if _tells_position(identified[0]):
            return (0.0, 0.0, 0.0), ON_LATTICE, identified
        found = estimate_origin(frame, threads=threads)
        stands_there = found.position is not None and not any(found.position)
        return found.position, found.reason, identified if stands_there else None
    x, y, z = (float(value) for value in position_of(stated, "origin"))
    return (x, y, z), "argument" if origin is not None else "file", None


def identify(
    scan: LidarFrame,
    sensor: str,
    lattice: SensorLattice | None,
    threads: int,
    known: Identified | None,
) -> Identified:
    """The scanner; the kind that a caller states is accepted if the scan is consistent with it.

    The second item has the places of the points on its lattice, if they were computed. ``known``:
    the result, if the scanner was identified before.
    """
    if sensor in ("auto", "lattice"):
        found = known or identify_and_read(scan, lattice=lattice, threads=threads)
        if sensor == "auto" or _tells_position(found[0]):
            return found
    return _stated(scan, sensor, threads), None


def _stated(scan: LidarFrame, sensor: str, threads: int) -> Sensor:
    """The scanner of the kind that a caller stated, if the scan does not contradict it."""
    if (why := nothing_to_tell(scan.points)) is not None:
        return Sensor("unknown", "unknown", why)
    if sensor == "terrestrial" and not is_in_metres(scan.points):
        return Sensor("unknown", "unknown", NOT_IN_METRES)
    if sensor == "terrestrial":
        found = estimate_origin(scan, known=(0.0, 0.0, 0.0), threads=threads)
        if found.position is not None and found.explained >= MIN_EXPLAINED:
            return Sensor("terrestrial scanner", "terrestrial", "stated by the caller")
        return Sensor(
            "unknown", "unknown", "the scan does not stand on the grid of a terrestrial scanner"
        )
    if sensor == "other":
        return Sensor("another scanner", "unknown", "stated by the caller")
    return Sensor("unknown", "unknown", "the scan does not stand on the lattice that was stated")


def _tells_position(sensor: Sensor) -> bool:
    """Whether the scanner was recognised by its lattice, which has the scanner at the origin."""
    return sensor.kind == "lattice" or bool(sensor.turned or sensor.unit)


def lifted(
    scan: LidarFrame, position: Position, found: Sensor, threads: int
) -> tuple[Position, Identified] | None:
    """KITTI's scanner and its position, if it is above or below the given position; else None."""
    if not (height := height_above_origin(found, scan.points)):
        return None
    raised = (position[0], position[1], position[2] + height)
    other = identify_and_read(at_origin(scan, raised), threads=threads)
    is_there = other[0].kind == "lattice" and not other[0].is_own and other[0].off_lattice == 0.0
    return (raised, other) if is_there else None


def at_origin(frame: LidarFrame, position: Position) -> LidarFrame:
    """The frame with the scanner at (0, 0, 0), as detector III expects it."""
    if not any(position):
        return frame
    moved = (frame.points - np.asarray(position)).astype(np.float32)
    return frame.replace(points=moved, exact=None, format=None, origin=(0.0, 0.0, 0.0))
