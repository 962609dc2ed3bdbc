"""Simulate a terrestrial laser scanner on its tripod: a full angular grid from one position."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from manip3d._util.checked import checked
from manip3d._util.options import generator_of, reporting
from manip3d._util.reprs import short_repr
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame
from manip3d.simulate._glass import lost
from manip3d.simulate._raycast import CHUNK, Hits
from manip3d.simulate.scenes import Scene

if TYPE_CHECKING:
    from manip3d._util.options import Progress, Rng

__all__ = ["TerrestrialScan", "terrestrial_scan"]

Floats = NDArray[np.float32]

EDGE = 0.1
"""Metres: if ranges of neighbouring rays differ by more, a beam may hit two surfaces at once."""
MIXED_SHARE = 0.02
"""Largest share of points with a mixed range."""
SUB_RAYS = 6
"""Number of rays over the footprint of a beam that may hit two surfaces."""
_FARTHEST_M = float(np.finfo(np.float32).max)  # of a return; the range of the sky is infinite
_SKY_M = 1e4  # metres: range of rays without a hit, so that they differ from all others
_STEPS_PER_M = np.float32(1000.0)  # ranges are rounded to 1 mm
_ROUNDING = 1e-9
"""Steps by which a whole number of them may fall short: 0.3 / 0.1 is 2.9999999999999996."""
_LEAST_WEIGHT = np.float32(2.0**-24)
"""Smallest number above 0 that ``Generator.random`` draws in float32."""
_LEAST_COSINE = 1e-3  # keeps the azimuth of beams finite that point straight up or down


@dataclass(frozen=True, eq=False)
class TerrestrialScan:
    """Points of one scanner position, in the scanner's frame, with ground truth.

    Points are in the order of the scanner: column by column, counter-clockwise, each column
    upwards.

    Attributes
    ----------
    points : (N, 3) float32, metres
        Points with the scanner at the origin; z up.
    intensity : (N,) float32
        Reflectance times the cosine of the angle of incidence, 0 to 1.
    label : (N,) uint8
        Truth: kind of object (`manip3d.simulate.scenes.Label`).
    object : (N,) int32
        Truth: number of the object in the scene's world; -1: background.
    mixed : (N,) bool
        Truth: the beam hit two surfaces, and the range lies between them.
    row, column : (N,) uint16
        Cell in the angular grid; row 0 is the lowest.
    shape : (rows, columns)
        Shape of the whole grid.
    resolution_deg : float
        Step of the grid, degrees.
    first_azimuth_deg, first_elevation_deg : float
        Centre of column 0 and of row 0, degrees.
    """

    points: Floats
    intensity: Floats
    label: NDArray[np.uint8]
    object: NDArray[np.int32]
    mixed: NDArray[np.bool_]
    row: NDArray[np.uint16]
    column: NDArray[np.uint16]
    shape: tuple[int, int]
    resolution_deg: float
    first_azimuth_deg: float
    first_elevation_deg: float

    __repr__ = short_repr

    @property
    def frame(self) -> LidarFrame:
        """The scan as a `LidarFrame` with the truth in ``label``, ``object`` and ``mixed``."""
        return LidarFrame(
            self.points,
            self.intensity,
            origin=(0.0, 0.0, 0.0),
            source="simulate.terrestrial_scan",
            fields={"label": self.label, "object": self.object, "mixed": self.mixed},
        )


@checked
def terrestrial_scan(
    scene: Scene,
    *,
    resolution_deg: float = 0.06,
    field_of_view: tuple[tuple[float, float], tuple[float, float]] = (
        (-180.0, 180.0),
        (-40.0, 60.0),
    ),
    range_noise: float = 0.003,
    angle_noise_deg: float = 0.0005,
    beam_divergence: float = 0.3e-3,
    min_range: float = 0.5,
    max_range: float = 350.0,
    rng: Rng = 0,
    threads: int = 0,
    progress: Progress = None,
) -> TerrestrialScan:
    """Scan a scene from its tripod; the defaults are those of a Riegl VZ-400.

    One ray is cast through the centre of each cell of the angular grid. If neighbouring ranges
    differ by more than 0.1 m, further rays over the footprint of the beam show whether it hits two
    surfaces; the range then is a random mixture of their ranges, for at most 2 % of the points.

    Parameters
    ----------
    scene : Scene
        Scene with the position of the scanner.
    resolution_deg : float
        Step of the grid in azimuth and in elevation, degrees.
    field_of_view : ((azimuth, azimuth), (elevation, elevation)), degrees
        Begin and end of the grid.
    range_noise : float, metres
        Standard deviation of a range (the VZ-400's data sheet: precision 3 mm).
    angle_noise_deg : float
        Standard deviation of the beam's direction, degrees (the data sheet: 0.0005).
    beam_divergence : float, radians
        Full angle of the beam.
    min_range, max_range : float, metres
        Nearer and farther surfaces give no point.
    rng : int, numpy.random.Generator or None
        Seed or generator; None: a different result each time.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
    progress : None, True or callable
        True draws a bar; a callable gets the fraction done and a message.

    Returns
    -------
    TerrestrialScan
        The scan; ranges are rounded to 1 mm.

    Raises
    ------
    InputError
        An option is out of range.
    MissingExtraError
        Open3D is not installed.
    """
    grid = _Grid(resolution_deg, field_of_view)
    for name, value in (
        ("range_noise", range_noise),
        ("angle_noise_deg", angle_noise_deg),
        ("beam_divergence", beam_divergence),
        ("min_range", min_range),
    ):
        if not (0.0 <= value < math.inf):
            raise InputError(f"{name}: expected a finite number >= 0, got {value}")
    if not max_range > min_range:
        raise InputError(f"max_range: expected more than {min_range}, got {max_range}")
    max_range = min(max_range, _FARTHEST_M)
    random = generator_of(rng)
    with reporting(progress, "scan") as report:
        scanner = _Scanner(scene, grid, math.radians(angle_noise_deg), random, threads)
        ranges, face, cosine = scanner.first_hits(report or (lambda fraction: None))
    world = scene.world
    surface = world.face_surface[np.where(np.isinf(ranges), 0, face)]
    returned = (ranges >= min_range) & (ranges <= max_range)
    glassy = np.flatnonzero(returned & (world.transmission[surface] > 0))
    at = scanner.origin + scanner.aim(glassy) * ranges[glassy, None]
    returned[glassy] = ~lost(at, world.transmission[surface[glassy]], random)

    mixed = np.zeros(len(ranges), np.bool_)
    if beam_divergence > 0.0:
        at_edge = grid.edges(ranges, returned)
        most = int(MIXED_SHARE * np.count_nonzero(returned))
        chosen, mixture = scanner.mixed_ranges(
            at_edge, beam_divergence, most, (min_range, max_range)
        )
        mixed[chosen] = True
        ranges[chosen] = mixture

    kept = np.flatnonzero(returned)
    noise = random.standard_normal(len(kept), np.float32) * np.float32(range_noise)
    measured = np.round((ranges[kept] + noise) * _STEPS_PER_M) / _STEPS_PER_M
    points = scanner.aim(kept) * measured[:, None]
    return TerrestrialScan(
        points,
        world.reflectance[surface[kept]] * cosine[kept],
        world.face_label[face[kept]],
        world.face_object[face[kept]],
        mixed[kept],
        (kept % grid.rows).astype(np.uint16),
        (kept // grid.rows).astype(np.uint16),
        (grid.rows, grid.columns),
        resolution_deg,
        grid.first_azimuth,
        grid.first_elevation,
    )


class _Grid:
    """The angular grid; its cells are ordered column by column."""

    def __init__(self, resolution: float, field_of_view: Any) -> None:
        if not (1e-4 <= resolution <= 10.0):
            raise InputError(f"resolution_deg: expected 1e-4 to 10 degrees, got {resolution}")
        ((left, right), (low, high)) = field_of_view
        if not (-360.0 <= left < right <= left + 360.0 and -90.0 <= low < high <= 90.0):
            raise InputError(
                "field_of_view: expected ((azimuth, azimuth), (elevation, elevation)) in degrees, "
                f"ascending, at most a full turn, got {field_of_view}"
            )
        self.columns = max(1, math.floor((right - left) / resolution + _ROUNDING))
        self.rows = max(1, math.floor((high - low) / resolution + _ROUNDING))
        if max(self.columns, self.rows) > np.iinfo(np.uint16).max:
            raise InputError(f"resolution_deg: {resolution} makes more than 65 535 columns or rows")
        self.first_azimuth = left + resolution / 2
        self.first_elevation = low + resolution / 2
        self.resolution = resolution
        # The first and the last column are neighbours if the step between them is at most one and a
        # half steps of the grid; the field of view may be wider than its whole columns.
        self.full_turn = 360.0 - self.columns * resolution < resolution / 2

    def angles(self) -> tuple[Floats, Floats]:
        """Return azimuth and elevation of the centres of all cells, radians."""
        step = math.radians(self.resolution)
        across = math.radians(self.first_azimuth) + step * np.arange(self.columns)
        up = math.radians(self.first_elevation) + step * np.arange(self.rows)
        azimuth = np.repeat(across.astype(np.float32), self.rows)
        return azimuth, np.tile(up.astype(np.float32), self.columns)

    def edges(self, ranges: Floats, returned: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the cells whose range differs from a neighbour's by more than `EDGE`."""
        image = np.where(np.isinf(ranges), np.float32(_SKY_M), ranges)
        image = image.reshape(self.columns, self.rows)
        edge = np.zeros(image.shape, np.bool_)
        upwards = abs(np.diff(image, axis=1)) > EDGE
        edge[:, 1:] |= upwards
        edge[:, :-1] |= upwards
        across = abs(np.diff(image, axis=0)) > EDGE
        edge[1:] |= across
        edge[:-1] |= across
        if self.full_turn:
            seam = abs(image[0] - image[-1]) > EDGE
            edge[0] |= seam
            edge[-1] |= seam
        return np.flatnonzero(edge.ravel() & returned)


class _Scanner:
    """The beams of a scan: their directions, and the surfaces that they meet.

    `angle_noise` is the standard deviation of azimuth and elevation in radians.
    """

    def __init__(
        self,
        scene: Scene,
        grid: _Grid,
        angle_noise: float,
        random: np.random.Generator,
        threads: int,
    ) -> None:
        self.origin = np.array(scene.scanner, np.float32)
        self._caster = scene.world.caster()
        self._random = random
        self._threads = threads
        self._azimuth, self._elevation = grid.angles()
        for angle in (self._azimuth, self._elevation):
            angle += np.float32(angle_noise) * random.standard_normal(angle.size, np.float32)

    def aim(self, cells: NDArray[np.int64] | slice) -> Floats:
        """Return unit directions of the beams of some cells, (N, 3)."""
        return _directions(self._azimuth[cells], self._elevation[cells])

    def first_hits(
        self, report: Callable[[float], object]
    ) -> tuple[Floats, NDArray[np.uint32], Floats]:
        """Return range, face and cosine of the angle of incidence of the centre of each beam."""
        count = self._azimuth.size
        ranges, cosine = np.empty(count, np.float32), np.empty(count, np.float32)
        face = np.empty(count, np.uint32)
        for start in range(0, count, CHUNK):
            report(start / count)
            part = slice(start, start + CHUNK)
            direction = self.aim(part)
            hits = self._caster.cast(self.origin, direction, threads=self._threads)
            ranges[part], face[part] = hits.distance, hits.face
            cosine[part] = abs(np.einsum("ij,ij->i", direction, hits.normal))
        report(1.0)
        return ranges, face, cosine

    def mixed_ranges(
        self, cells: NDArray[np.int64], divergence: float, most: int, limits: tuple[float, float]
    ) -> tuple[NDArray[np.int64], Floats]:
        """Return the cells whose beam meets two surfaces, at most ``most``, and their ranges.

        ``divergence`` is the full angle of the beam in radians. Surfaces nearer or farther than
        ``limits``, in metres, return nothing.
        """
        nearest, farthest = limits
        direction = self.aim(cells)
        center = self._cast(direction)
        plane = center.distance * np.einsum("ij,ij->i", center.normal, direction)
        spread = [center.distance]
        straddling = np.zeros(cells.size, np.bool_)
        for _ in range(SUB_RAYS):
            direction = self._within_beams(cells, divergence)
            distance = self._cast(direction).distance
            # A slanted plane spreads ranges too, but is one surface.
            cosine = np.einsum("ij,ij->i", center.normal, direction)
            with np.errstate(divide="ignore", invalid="ignore"):
                off_plane = abs(distance - plane / cosine)
            returns = (distance >= nearest) & (distance <= farthest)
            straddling |= returns & ~(off_plane <= EDGE)
            spread.append(distance)
        chosen = np.sort(self._random.permutation(np.flatnonzero(straddling))[:most])
        values = np.stack(spread)[:, chosen]
        returns = (values >= nearest) & (values <= farthest)
        weight = self._random.random(values.shape, np.float32)
        return cells[chosen], _mixture(values, returns, weight)

    def _within_beams(self, cells: NDArray[np.int64], divergence: float) -> Floats:
        """A random direction within each beam, uniform over its disc, (N, 3).

        ``divergence`` is the full angle of the beam in radians.
        """
        radius = 0.5 * divergence * np.sqrt(self._random.random(cells.size, np.float32))
        angle = np.float32(2.0 * np.pi) * self._random.random(cells.size, np.float32)
        up = self._elevation[cells] + radius * np.sin(angle)
        across = radius * np.cos(angle) / np.maximum(np.cos(up), _LEAST_COSINE)
        return _directions(self._azimuth[cells] + across, up)

    def _cast(self, directions: Floats) -> Hits:
        """Hits of any number of rays, cast in chunks."""
        parts = [
            self._caster.cast(self.origin, directions[start : start + CHUNK], threads=self._threads)
            for start in range(0, max(1, len(directions)), CHUNK)
        ]
        names = [field.name for field in fields(Hits)]
        return Hits(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _mixture(ranges: Floats, returns: NDArray[np.bool_], weight: Floats) -> Floats:
    """Return the weighted mean of each column of ranges (K, N) over the rays that return.

    At least one ray of each column returns. A weight of 0 counts as the smallest one above 0, so
    that the weights of a column with a single return do not vanish.
    """
    weight = np.where(returns, np.maximum(weight, _LEAST_WEIGHT), np.float32(0.0))
    total = (weight * np.where(returns, ranges, np.float32(0.0))).sum(axis=0)
    mean: Floats = total / weight.sum(axis=0)
    return mean


def _directions(azimuth: Floats, elevation: Floats) -> Floats:
    """Unit vectors, (N, 3)."""
    level = np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
