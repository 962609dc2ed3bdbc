"""Forged scans with ground truth, and conversion of arguments for all attacks."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from manip3d import _core
from manip3d._util.arrays import rows
from manip3d._util.mappings import ReadOnlyMapping
from manip3d._util.options import threads_of
from manip3d._util.reprs import short_repr
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame, Scan
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Points: TypeAlias = NDArray[np.float32]
    Rows: TypeAlias = NDArray[np.int32]

ObjectLike: TypeAlias = "Mesh | LidarFrame | ArrayLike"


@dataclass(frozen=True, eq=False, repr=False)
class Forgery(Showable):
    """A forged scan with its ground truth.

    Untouched points keep their order and their exact values; added points come last. Moved points
    keep their rows, too, unless the attack sorts points (`lattice_insert`, `lattice_remove`).

    Attributes
    ----------
    points : (M, 3) float32, metres
        Points of the forged scan.
    intensity : (M,) float32 or None
        Intensities of the forged scan; None if the original has none.
    added, moved : int32 arrays
        Rows of added and of moved points in the forged scan, ascending.
    moved_from : int32 array
        Row in the original scan of each point of ``moved``.
    removed : int32 array
        Rows of the removed points in the original scan, ascending.
    box : Box
        Box around added and moved points; if there are none, around removed points.
    transform : (4, 4) float64
        Transform from the object's to the scan's frame; the identity if no object was placed.
    attack : str
        Name of the attack.
    parameters : mapping
        Parameters of the attack.
    original : LidarFrame or None
        The original scan, if it was given as a frame.
    """

    points: Points
    intensity: NDArray[np.float32] | None
    added: Rows
    moved: Rows
    moved_from: Rows
    removed: Rows
    box: Box
    transform: NDArray[np.float64]
    attack: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    original: LidarFrame | None = None

    @cached_property
    def label(self) -> NDArray[np.uint8]:
        """Label of each point of the forged scan: 0 untouched, 1 added, 2 moved."""
        label = np.zeros(len(self.points), np.uint8)
        label[self.added] = 1
        label[self.moved] = 2
        return label

    @cached_property
    def source_index(self) -> Rows:
        """Row of each point in the original scan; -1: added."""
        untouched = np.ones(len(self.points) - len(self.added) + len(self.removed), np.bool_)
        untouched[self.removed] = untouched[self.moved_from] = False
        index = np.full(len(self.points), -1, np.int32)
        index[self.moved] = self.moved_from
        index[self.label == 0] = np.flatnonzero(untouched)
        return index

    @property
    def num_touched(self) -> int:
        """Number of added, moved and removed points."""
        return len(self.added) + len(self.moved) + len(self.removed)

    @cached_property
    def frame(self) -> LidarFrame:
        """The forged scan as a frame, with the other columns of the original."""
        if self.original is None:
            return LidarFrame(self.points, self.intensity)
        return self.original.with_points(
            self.points, source_index=self.source_index, intensity=self.intensity
        )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the forged scan; see `manip3d.io.write_scan`.

        Parameters
        ----------
        path : path
            Path of the file; its suffix determines the format.
        """
        self.frame.write(path)

    def __repr__(self) -> str:
        return (
            f"<manip3d.forge.Forgery: {self.attack}; {counted(len(self.points), 'point')}, "
            f"{len(self.added)} added, {len(self.moved)} moved, {len(self.removed)} removed>"
        )


@dataclass(frozen=True, eq=False)
class Lattice:
    """The directions in which a spinning scanner measures.

    Attributes
    ----------
    rings : (K, 2) float64
        Ring k meets the points ``z = rings[k, 0] * hypot(x, y) + rings[k, 1]``, metres.
    azimuth_step, azimuth_phase : float, radians
        Azimuths are ``phase + i * step``. The step is 1e-4 to 1; 0: unknown.
    """

    rings: NDArray[np.float64]
    azimuth_step: float = 0.0
    azimuth_phase: float = 0.0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        object.__setattr__(self, "rings", rows(self.rings, 2, np.float64, "rings"))

    @classmethod
    def grid(
        cls, elevations: ArrayLike, azimuth_step: float, azimuth_phase: float = 0.0
    ) -> Lattice:
        """Make the lattice of an ideal scanner, whose lasers are at the origin.

        Parameters
        ----------
        elevations : (K,) float, radians
            Elevation of each laser.
        azimuth_step, azimuth_phase : float, radians
            Azimuths are ``phase + i * step``.

        Returns
        -------
        Lattice

        Examples
        --------
        >>> import numpy as np
        >>> from manip3d import forge
        >>> lattice = forge.Lattice.grid(np.radians([-10, 0, 10]), np.radians(0.5))
        >>> lattice.rings[:, 0].round(3).tolist()  # height by horizontal distance
        [-0.176, 0.0, 0.176]
        """
        slopes = np.tan(np.asarray(elevations, np.float64))
        return cls(np.column_stack([slopes, np.zeros_like(slopes)]), azimuth_step, azimuth_phase)

    def arguments(self) -> tuple[list[tuple[float, float]], float, float]:
        """Return the lattice as arguments of the core."""
        rings = [(float(slope), float(offset)) for slope, offset in self.rings]
        return rings, self.azimuth_step, self.azimuth_phase


NO_LATTICE: tuple[list[tuple[float, float]], float, float] = ([], 0.0, 0.0)


class Hoax(NamedTuple):
    """An object as arguments of the core; ``faces`` and ``intensity`` may have no rows."""

    points: Points
    faces: NDArray[np.int32]
    intensity: NDArray[np.float32]


def to_hoax(values: ObjectLike, intensity: ArrayLike, scan: Scan) -> Hoax:
    """An object from a mesh, a frame or points; with intensities if the scan has some."""
    faces = np.empty((0, 3), np.int32)
    if isinstance(values, Mesh):
        points = rows(values.vertices, 3, np.float32, "hoax")
        faces = values.faces
    elif isinstance(values, LidarFrame):
        points = values.points
    else:
        points = rows(values, 3, np.float32, "hoax")
    if not len(scan.intensity):
        return Hoax(points, faces, np.empty(0, np.float32))
    given = np.asarray(intensity, np.float32)
    if given.ndim > 0 and given.shape != (len(points),):
        raise InputError(f"intensity: expected one value or {len(points)}, got {given.shape}")
    return Hoax(points, faces, np.ascontiguousarray(np.broadcast_to(given, len(points))))


def to_forgery(
    parts: tuple[Any, ...], scan: Scan, attack: str, parameters: Mapping[str, Any]
) -> Forgery:
    """Convert the core's tuple to a `Forgery`."""
    points, intensity, added, moved, moved_from, removed, box, transform = parts
    center, size, yaw = box
    return Forgery(
        points,
        intensity,
        added,
        moved,
        moved_from,
        removed,
        Box(tuple(center), tuple(size), yaw),
        transform,
        attack,
        ReadOnlyMapping(parameters),
        scan.frame,
    )


def check_moved(forgery: Forgery, box: Box, scan: Scan, threads: int, motion: str) -> None:
    """Raise `InputError` if a motion of the points in a box changed no point.

    ``motion`` is the argument that is to blame if there are points in the box.
    """
    if forgery.num_touched:
        return
    inside = _core.points_in_box(scan.points, box_arguments(box), threads_of(threads))
    check_chosen(inside)
    raise InputError(f"{motion}: expected a motion of the points, but no point would change")


def check_chosen(inside: Rows) -> None:
    """Raise `InputError` if there are no rows of points in a box, ``inside``."""
    if not len(inside):
        raise InputError("box: expected scene points in it, got none")


def renamed(forgery: Forgery, attack: str, parameters: Mapping[str, Any]) -> Forgery:
    """The forgery with another attack's name and parameters."""
    return replace(forgery, attack=attack, parameters=ReadOnlyMapping(parameters))


def check_finite(points: Points, name: str) -> None:
    """Raise InputError for a coordinate that is not finite."""
    wrong = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(wrong):
        raise InputError(f"{name}: expected finite numbers, got others in row {wrong[0]}")


def box_arguments(box: Box) -> tuple[tuple[float, float, float], tuple[float, float, float], float]:
    """A box as arguments of the core."""
    return box.center, box.size, box.yaw


def rotation_matrix(rotation: ArrayLike) -> NDArray[np.float64]:
    """A rotation matrix from an angle about the vertical, radians, or from a (3, 3) matrix."""
    array = np.asarray(rotation, np.float64)
    if array.ndim == 0:
        matrix: NDArray[np.float64] = _core.rotation_about_z(float(array))
        return matrix
    if array.shape != (3, 3):
        raise InputError(f"rotation: expected an angle or a (3, 3) matrix, got {array.shape}")
    return array
