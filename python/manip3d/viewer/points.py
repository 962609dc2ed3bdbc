"""Points for the viewer: their colours, lines, and camera poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.arrays import as_array, rows
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d._util.showing import Showable
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.lidar import Box, box_corners
from manip3d.viewer.scene import Direction, Pose, Rgb, Up

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.viewer.scene import Image, Points

    Bytes = NDArray[np.uint8]

__all__ = [
    "Classes",
    "Colors",
    "DrawnPoints",
    "Lines",
    "Scale",
    "box_lines",
    "drawn_points",
]

RAMP: tuple[Rgb, ...] = (
    (48, 62, 158), (38, 118, 190), (34, 152, 132), (116, 178, 66), (232, 178, 36), (226, 104, 36),
    (178, 24, 43),
)  # fmt: skip
"""Colours from low to high values, all visible on light and on dark pages."""

PALETTE: tuple[Rgb, ...] = (
    (38, 118, 190), (214, 96, 20), (34, 140, 100), (160, 60, 160), (200, 150, 0), (90, 90, 200),
)  # fmt: skip
"""Colours of people and other classes without an order."""

QUIET: Rgb = (128, 138, 152)
"""Colour of ordinary points."""

ALARM: Rgb = (214, 40, 40)
"""Colour of suspected, added or moved points."""

CLEAR: Rgb = (34, 140, 100)
"""Colour of points that were found to be authentic."""

DOUBT: Rgb = (200, 140, 0)
"""Colour of points whose verdict is undecidable."""

SCAN_SPREAD = 4e-3  # ratio of a point's width to its distance from the scanner; about 0.2 degrees
MIN_SHARE = 5e-4  # smallest width of a point as a share of the scene's extent
EMPHASIS = 2.5  # ratio of the widths of emphasised and other points
# Smallest number of points whose outermost 1 % along an axis are whole points, one at each end. A
# percentile leaves out both ends of fewer points, too, which may be most of them in three axes.
MIN_TRIMMED = 200


@dataclass(frozen=True, eq=False)
class Scale:
    """A number for each point, shown by colours from blue (low) to red (high).

    Attributes
    ----------
    name : str
        Name such as ``height`` or ``intensity``.
    values : (N,) numbers
        Value of each point.
    unit : str
        Unit, written after the numbers of the colour bar.
    limits : (float, float), optional
        Values of the first and the last colour; default: 1st and 99th percentile.
    """

    name: str
    values: NDArray[Any]
    unit: str = ""
    limits: tuple[float, float] | None = None

    __repr__ = short_repr

    @cached_property
    def ends(self) -> tuple[float, float]:
        """Return the values of the first and of the last colour."""
        if self.limits is not None:
            return self.limits
        if not len(self.values):
            return 0.0, 1.0
        low, high = (float(value) for value in np.percentile(self.values, [1.0, 99.0]))
        return low, high

    def levels(self) -> Bytes:
        """Return (N,) uint8: 0 at the first colour, 255 at the last."""
        low, high = self.ends
        span = high - low
        share = (np.asarray(self.values, np.float64) - low) / (span if span > 0.0 else 1.0)
        levels: Bytes = np.rint(255.0 * np.clip(share, 0.0, 1.0)).astype(np.uint8)
        return levels

    def colors(self) -> Image:
        """Return (N, 3) uint8: the colour of each point."""
        return ramp()[self.levels()]

    def select(self, index: NDArray[Any]) -> Scale:
        """Return the column for some of the points; the limits of the colours stay the same.

        Parameters
        ----------
        index : (M,) int or bool
            Rows of the points that are kept, or a mask.
        """
        return Scale(self.name, self.values[index], self.unit, self.ends)


@dataclass(frozen=True, eq=False)
class Classes:
    """Class of each point.

    Attributes
    ----------
    name : str
        Name such as ``verdict`` or ``truth``.
    values : (N,) uint8
        Index of each point's class in ``labels``.
    labels : sequence of str
        Names of the classes.
    palette : sequence of (r, g, b) of 0 to 255
        Colour of each class.
    emphasis : sequence of int
        Indices of the classes whose points are drawn larger.
    """

    name: str
    values: Bytes
    labels: Sequence[str]
    palette: Sequence[Rgb]
    emphasis: Sequence[int] = ()

    __repr__ = short_repr

    def colors(self) -> Image:
        """Return (N, 3) uint8: the colour of each point."""
        table = np.array(self.palette, np.uint8).reshape(-1, 3)
        colors: Image = table[self.values]
        return colors

    def counts(self) -> list[int]:
        """Return the number of points of each label."""
        return [int(n) for n in np.bincount(self.values, minlength=len(self.labels))]

    def is_emphasized(self) -> NDArray[np.bool_]:
        """Return (N,) bool: whether a point is drawn larger."""
        return np.isin(self.values, np.asarray(self.emphasis, np.uint8))

    def select(self, index: NDArray[Any]) -> Classes:
        """Return the column of some of the points.

        Parameters
        ----------
        index : (M,) int or bool
            Rows of the points that are kept, or a mask.
        """
        return replace(self, values=self.values[index])


@dataclass(frozen=True, eq=False)
class Colors:
    """A colour for each point.

    Attributes
    ----------
    name : str
    values : (N, 3) uint8
        R, G, B.
    """

    name: str
    values: Image

    def colors(self) -> Image:
        """Return (N, 3) uint8: the colour of each point."""
        return self.values

    def select(self, index: NDArray[Any]) -> Colors:
        """Return the column of some of the points.

        Parameters
        ----------
        index : (M,) int or bool
            Rows of the points that are kept, or a mask.
        """
        return Colors(self.name, self.values[index])


Column = Scale | Classes | Colors


@dataclass(frozen=True, eq=False)
class Lines:
    """Straight lines of one kind: the edges of boxes, the bones of a person.

    Attributes
    ----------
    name : str
        Name in the legend.
    ends : (E, 2, 3) float64
        End points of each line.
    color : (r, g, b) of 0 to 255
    in_front : bool
        Whether the lines are drawn over the points, like bones, which lie inside a person.
    """

    name: str
    ends: Points
    color: Rgb
    in_front: bool = False

    __repr__ = short_repr


@checked
@dataclass(frozen=True, eq=False)
class DrawnPoints(Showable):
    """Points with colours, lines and camera poses, for `manip3d.viewer.view` and `picture`.

    Attributes
    ----------
    points : (N, 3) float32 or float64, metres
    columns : tuple of Scale, Classes or Colors
        Columns by which the points can be coloured; the first one is used first.
    lines : tuple of Lines
    poses : tuple of Pose
        Poses of the camera; the first one is used first. Empty: all points are seen obliquely.
    up : 'y', 'z' or '-y'
        The upward axis; ``-y`` is that of a camera (x right, y down, z ahead).
    origin : (float, float, float), optional
        Position of the sensor. Points farther from it are drawn larger, by ``spread``.
    spread : float
        Ratio of a point's width to its distance from ``origin``.
    least : float, metres
        Smallest width of a point.
    name, detail : str
        Texts below the points: their name, and their number.

    Raises
    ------
    InputError
        The points are not finite; a column has another length, or a value without a label.
    """

    points: NDArray[Any]
    columns: tuple[Scale | Classes | Colors, ...] = ()
    lines: tuple[Lines, ...] = ()
    poses: tuple[Pose, ...] = ()
    up: Up = "z"
    origin: tuple[float, float, float] | None = None
    spread: float = 0.0
    least: float = 0.0
    name: str = ""
    detail: str = ""

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] != 3 or self.points.dtype.kind != "f":
            raise InputError(
                f"points: expected (N, 3) floats, got {self.points.dtype} {self.points.shape}"
            )
        _check_finite(self.points)
        for column in self.columns:
            if len(column.values) != len(self.points):
                raise InputError(
                    f"{column.name}: expected {len(self.points)} values, as many as points, "
                    f"got {len(column.values)}"
                )
            if isinstance(column, Classes):
                _check_classes(column)

    @property
    def num_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @cached_property
    def bounds(self) -> Points:
        """Return (2, 3) float64: lowest and highest coordinates of points and lines."""
        ends = [line.ends.reshape(-1, 3) for line in self.lines]
        every = np.concatenate([self.points, *ends]) if ends else self.points
        if not len(every):
            return np.zeros((2, 3))
        return np.array([every.min(axis=0), every.max(axis=0)], np.float64)

    def column(self, name: str | None) -> Column | None:
        """Return the column with a name.

        Parameters
        ----------
        name : str or None
            Name of a column; None: the first one.

        Returns
        -------
        Column or None
            None: ``name`` is None and there is no column.

        Raises
        ------
        InputError
            There is no column of that name; the message lists the names.
        """
        if name is None:
            return self.columns[0] if self.columns else None
        for column in self.columns:
            if column.name == name:
                return column
        known = ", ".join(column.name for column in self.columns) or "no column at all"
        raise InputError(f"color_by: expected {known}, got {name!r}")

    def pose(self, name: str | None) -> Pose | None:
        """Return the pose with a name.

        Parameters
        ----------
        name : str or None
            Name of a pose; None: the first one.

        Returns
        -------
        Pose or None
            None: ``name`` is None and there is no pose.

        Raises
        ------
        InputError
            There is no pose of that name; the message lists the names.
        """
        if name is None:
            return self.poses[0] if self.poses else None
        for pose in self.poses:
            if pose.name == name:
                return pose
        known = ", ".join(pose.name for pose in self.poses) or "no place at all"
        raise InputError(f"place: expected {known}, got {name!r}")

    def bulk(self) -> Points:
        """Return (M, 3) float64, M > 0: the points that fill a picture, and the ends of lines.

        Of `MIN_TRIMMED` points or more, the outermost 1 % along each axis are left out. Without
        points and lines the origin is returned.
        """
        points = self.points.astype(np.float64)
        if len(points) >= MIN_TRIMMED:
            low, high = np.percentile(points, [0.5, 99.5], axis=0)
            points = points[((points >= low) & (points <= high)).all(axis=1)]
        ends = [line.ends.reshape(-1, 3) for line in self.lines]
        every = np.concatenate([points, *ends])
        return every if len(every) else np.zeros((1, 3))

    @property
    def direction(self) -> Direction:
        """Return the direction of view if the camera is in none of ``poses``."""
        return Direction(-60.0, 30.0, self.up)

    def colored_by(self, name: str | None) -> DrawnPoints:
        """Return the same points with another column first.

        Parameters
        ----------
        name : str or None
            Name of a column; None: the first one.

        Returns
        -------
        DrawnPoints

        Raises
        ------
        InputError
            As `column`.
        """
        first = self.column(name)
        if first is None or first is self.columns[0]:
            return self
        others = tuple(column for column in self.columns if column is not first)
        return replace(self, columns=(first, *others))

    def colors(self) -> Image:
        """Return (N, 3) uint8: colours by the first column; without columns, grey."""
        if not self.columns:
            return np.full((self.num_points, 3), QUIET, np.uint8)
        return self.columns[0].colors()

    def widths(self) -> Points:
        """Return (N,) float64: widths of the points, in the unit of their coordinates."""
        width = np.full(self.num_points, self.least)
        if self.origin is not None:
            away = np.linalg.norm(self.points - np.asarray(self.origin), axis=1)
            width = np.maximum(width, self.spread * away)
        return width

    def emphasis(self) -> Points:
        """Return (N,) float64: factors of the widths, which emphasise some classes of points."""
        first = self.columns[0] if self.columns else None
        if not isinstance(first, Classes):
            return np.ones(self.num_points)
        return np.where(first.is_emphasized(), EMPHASIS, 1.0)

    def thinned(self, max_points: int) -> DrawnPoints:
        """Return a random sample of at most ``max_points`` points, the same at each call.

        Emphasised points are preferred, but make up at most half of the sample if there are enough
        other points, so that their surroundings stay visible. ``detail`` states the number of
        shown points.

        Parameters
        ----------
        max_points : int
            Largest number of points to keep.

        Raises
        ------
        InputError
            ``max_points`` is not positive.
        """
        if not max_points > 0:
            raise InputError(f"max_points: expected > 0, got {max_points}")
        if self.num_points <= max_points:
            return self
        order = np.random.default_rng(0).permutation(self.num_points)
        special = np.zeros(self.num_points, np.bool_)
        for column in self.columns:
            if isinstance(column, Classes):
                special |= column.is_emphasized()
        emphasized, others = order[special[order]], order[~special[order]]
        num_emphasized = min(len(emphasized), max(max_points // 2, max_points - len(others)))
        kept = np.sort(
            np.concatenate([emphasized[:num_emphasized], others[: max_points - num_emphasized]])
        )
        fewer = self.points[kept]
        wider = float(np.sqrt(self.num_points / max_points))  # fewer points cover the same area
        # At this width max_points points cover the full sphere around a scanner without gaps; wider
        # points would hide each other.
        enough = float(np.sqrt(4.0 * np.pi / max_points))
        return replace(
            self,
            points=fewer,
            columns=tuple(column.select(kept) for column in self.columns),
            spread=max(self.spread, min(self.spread * wider, enough)),
            least=self.least * wider,
            detail=f"{self.detail or f'{self.num_points:,} points'}, {max_points:,} shown",
        )

    def __repr__(self) -> str:
        parts = [counted(self.num_points, "point"), *(column.name for column in self.columns)]
        return f"<manip3d.viewer.DrawnPoints: {', '.join(parts)}>"


def _check_finite(points: NDArray[Any]) -> None:
    if not np.isfinite(points).all():
        raise InputError("points: expected finite coordinates")


def _check_classes(column: Classes) -> None:
    if len(column.labels) != len(column.palette):
        raise InputError(
            f"{column.name}: expected a colour for each of {len(column.labels)} labels, "
            f"got {len(column.palette)}"
        )
    if len(column.values) and int(column.values.max()) >= len(column.labels):
        raise InputError(
            f"{column.name}: expected values below {len(column.labels)}, "
            f"got {int(column.values.max())}"
        )


def ramp() -> Image:
    """Return (256, 3) uint8: the colours from low to high."""
    steps = np.linspace(0.0, 255.0, len(RAMP))
    channels = [np.interp(np.arange(256), steps, channel) for channel in np.array(RAMP).T]
    colors: Image = np.rint(np.column_stack(channels)).astype(np.uint8)
    return colors


# --- points of any kind -------------------------------------------------------------------------


@checked
def drawn_points(
    points: ArrayLike,
    *,
    colors: ArrayLike | None = None,
    values: Mapping[str, ArrayLike] | None = None,
    boxes: Sequence[Box] | Mapping[str, Sequence[Box]] = (),
    up: Up = "z",
    origin: Sequence[float] | None = None,
    name: str = "",
) -> DrawnPoints:
    """Return points with colours, numbers and boxes, for `manip3d.viewer.view` and `picture`.

    Parameters
    ----------
    points : (N, 3) numbers, metres
    colors : (N, 3) uint8, optional
        R, G, B of each point.
    values : mapping of str to (N,) numbers, optional
        Values by which the points can be coloured, by name. Without ``colors`` the first values are
        shown first; without both, the height.
    boxes : sequence of Box, or mapping of str to sequence of Box
        Boxes, drawn as lines with a colour for each name.
    up : 'y', 'z' or '-y'
        The upward axis.
    origin : (x, y, z), optional
        Position of the sensor. With it the points are seen from behind and above the sensor, and
        far points are drawn larger.
    name : str
        Text below the points.

    Returns
    -------
    DrawnPoints

    Raises
    ------
    InputError
        An array has another shape, or coordinates are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import viewer
    >>> points = np.random.default_rng(0).normal(size=(1000, 3))
    >>> cloud = viewer.drawn_points(points, values={"distance": np.linalg.norm(points, axis=1)})
    >>> cloud.detail, [column.name for column in cloud.columns]
    ('1,000 points', ['distance'])
    """
    array = as_array(points, "points")
    place = rows(points, 3, np.float32 if array.dtype == np.float32 else np.float64, "points")
    _check_finite(place)
    columns: list[Column] = []
    if colors is not None:
        columns.append(Colors("colour", checked_colors(colors, len(place))))
    for key, numbers in (values or {}).items():
        columns.append(Scale(key, _numbers(numbers, key)))
    if not columns:
        axis = 2 if up == "z" else 1
        upwards = place[:, axis].astype(np.float64) * (-1.0 if up == "-y" else 1.0)
        columns.append(Scale("height", upwards, "m"))
    stood = None if origin is None else _place(origin)
    return DrawnPoints(
        place,
        tuple(columns),
        box_lines(boxes),
        overviews(place, stood, up),
        up,
        stood,
        SCAN_SPREAD if stood is not None else 0.0,
        least_width(place),
        name,
        f"{len(place):,} points",
    )


def _place(origin: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in origin)
    return x, y, z


def checked_colors(colors: ArrayLike, count: int) -> Image:
    array = as_array(colors, "colors")
    if array.dtype != np.uint8 or array.shape != (count, 3):
        raise InputError(
            f"colors: expected uint8 of shape ({count}, 3), got {array.dtype} {array.shape}"
        )
    return array


def _numbers(values: ArrayLike, name: str) -> NDArray[Any]:
    array = as_array(values, name)
    if array.ndim != 1 or array.dtype.kind not in "iufb":
        raise InputError(
            f"{name}: expected a number for each point, got {array.dtype} {array.shape}"
        )
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers")
    return array


def least_width(points: NDArray[Any]) -> float:
    if not len(points):
        return 0.0
    # In float64, because float32 cannot hold differences of its largest numbers.
    low, high = np.percentile(points.astype(np.float64), [1.0, 99.0], axis=0)
    return MIN_SHARE * float(np.linalg.norm(high - low, axis=-1))


_EDGES = np.array(
    [[0, 1], [1, 3], [3, 2], [2, 0], [4, 5], [5, 7], [7, 6], [6, 4], [0, 4], [1, 5], [2, 6], [3, 7]]
)


@checked
def box_lines(
    boxes: Sequence[Box] | Mapping[str, Sequence[Box]], colors: Mapping[str, Rgb] | None = None
) -> tuple[Lines, ...]:
    """Return the edges of boxes as lines, in one colour for each label or key of a mapping.

    Parameters
    ----------
    boxes : sequence of Box, or mapping of str to sequence of Box
    colors : mapping of str to (r, g, b), optional
        Colours by label or key; all others get the colours of a palette in turn.

    Returns
    -------
    tuple of Lines
        Lines for each label or key that has boxes.

    Raises
    ------
    InputError
        ``boxes`` or ``colors`` has a wrong type.

    Examples
    --------
    >>> from manip3d import Box, viewer
    >>> car, other = (Box((x, 0, 0), (4, 2, 2), label="car") for x in (8, 20))
    >>> lines = viewer.box_lines([car, other, Box((5, 3, 0), (1, 1, 2), label="person")])
    >>> [(line.name, line.ends.shape) for line in lines]
    [('car', (24, 2, 3)), ('person', (12, 2, 3))]
    """
    groups: dict[str, list[Box]] = {}
    if isinstance(boxes, Mapping):
        for name, some in boxes.items():
            if not isinstance(some, Sequence):
                raise InputError(f"boxes: expected a sequence of boxes for {name!r}, got {some!r}")
        groups = {name: list(some) for name, some in boxes.items()}
    else:
        for box in boxes:
            groups.setdefault(box.label or "box", []).append(box)
    groups = {name: some for name, some in groups.items() if some}
    return tuple(
        Lines(
            name,
            np.concatenate([box_corners(box)[_EDGES] for box in some]),
            (colors or {}).get(name, PALETTE[(i + 1) % len(PALETTE)]),
        )
        for i, (name, some) in enumerate(groups.items())
    )


# --- where to look from -------------------------------------------------------------------------


def overviews(
    points: NDArray[Any], origin: tuple[float, float, float] | None, up: Up
) -> tuple[Pose, ...]:
    """Return camera poses behind and above the sensor, above it, and at it.

    Without a sensor position, and if z is not the upward axis, there are none.
    """
    if origin is None or up != "z" or not len(points):
        return ()
    place = np.asarray(origin, np.float64)
    offset = points[:, :2] - place[:2]
    near = float(np.percentile(np.hypot(offset[:, 0], offset[:, 1]), 75.0)) or 1.0
    ahead = np.array([near, 0.0, 0.0])
    right = np.array([0.0, -0.25 * near, 0.0])
    above = np.array([0.0, 0.0, near])
    behind = place - 1.5 * ahead + right + 0.8 * above
    return (
        Pose("Behind", behind, place + 0.25 * ahead, "z", 40.0, 1.4),
        Pose("Above", place - 0.01 * ahead + 3.2 * above, place, "z", 40.0, 1.0),
        Pose("Sensor", place, place + ahead - 0.06 * above, "z", 60.0, 1.4),
    )
