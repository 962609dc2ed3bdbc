"""Reader of folders of LiDAR range images: a 16-bit PNG per turn, and one file with the angles.

This is the layout of KIT's Velodyne tracking data (F. Moosmann): ``data/0000000000.png`` with a row
per laser and a column per azimuth step, ``velodyne_config.txt`` and ``timestamps.txt``.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import in_order, path_of, visible
from manip3d._util.reprs import short_repr
from manip3d._util.text_files import text_of
from manip3d._util.texts import counted
from manip3d._util.times import parse_time
from manip3d.errors import FormatError
from manip3d.io import read_depth
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["RangeImageFolder", "RangeImageLayout", "open_range_images"]

_MOST_ROWS = 1 << 16
"""Largest width and height: fields of a frame hold row and column as uint16."""


@dataclass(frozen=True, eq=False)
class RangeImageLayout:
    """Unit of the ranges and directions of the pixels of a range image.

    Attributes
    ----------
    units_per_metre : float
        Stored units per metre.
    azimuth : (W,) float64
        Azimuth of each column's centre, radians, counter-clockwise from x (forward) seen from
        above.
    elevation : (H,) float64
        Elevation of each row, radians, positive above the horizon.
    """

    units_per_metre: float
    azimuth: NDArray[np.float64]
    elevation: NDArray[np.float64]

    __repr__ = short_repr

    def points(self, ranges: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (H, W, 3) from ranges (H, W), all in metres; x forward, y left, z up."""
        flat = np.cos(self.elevation)[:, None]
        directions = np.stack(
            [
                flat * np.cos(self.azimuth),
                flat * np.sin(self.azimuth),
                np.broadcast_to(np.sin(self.elevation)[:, None], ranges.shape),
            ],
            axis=-1,
        )
        placed: NDArray[np.float64] = ranges[..., None] * directions
        return placed


def read_layout(path: Path) -> RangeImageLayout:
    """Read ``velodyne_config.txt``.

    Its first line that is no comment has an optional multiplier (units per metre), width and
    height, azimuths of the left and right border, and then either one elevation per row, positive
    downwards, or the elevations of the upper and lower border. Angles are in degrees.

    Raises
    ------
    FormatError
        There is no such line, or its numbers do not fit together.
    """
    for number, text in enumerate(text_of(path).splitlines(), 1):
        words = text.replace(";", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = np.array(words, np.float64)
        except ValueError:
            values = np.empty(0)
        found = _layout_of(values)
        if found is None:
            raise FormatError("expected sizes and angles", file=str(path), line=number)
        return found
    raise FormatError("expected a line with sizes and angles", file=str(path))


def _layout_of(values: NDArray[np.float64]) -> RangeImageLayout | None:
    if not np.isfinite(values).all():
        return None
    for num_prefix in (1, 0):  # numbers before the width: the multiplier or none
        if len(values) < num_prefix + 6:
            continue
        width, height, left, right = values[num_prefix : num_prefix + 4]
        elevations = values[num_prefix + 4 :]
        sizes_fit = all(0 < size <= _MOST_ROWS and size % 1 == 0 for size in (width, height))
        has_unit = num_prefix == 0 or values[0] > 0
        if not sizes_fit or not has_unit or len(elevations) not in (2, height):
            continue
        if len(elevations) == 2 and height != 2:  # two rows have one elevation each, not borders
            elevations = _centres(elevations[0], elevations[1], int(height))
        scale = float(values[0]) if num_prefix else 1.0
        azimuths = _centres(left, right, int(width))
        return RangeImageLayout(scale, np.radians(azimuths), -np.radians(elevations))
    return None


def _centres(first: float, last: float, count: int) -> NDArray[np.float64]:
    """Return the centres of equal cells between two borders, of which either may be larger."""
    return first + (last - first) * (np.arange(count) + 0.5) / count


@checked
class RangeImageFolder(Sequence[LidarFrame]):
    """Sequence of the scanner's turns in a folder, each read on demand; see `open_range_images`.

    Parameters
    ----------
    path : Path
        Folder of the recording.

    Attributes
    ----------
    path : Path
        Folder of the recording.
    layout : RangeImageLayout
        Unit of the stored ranges, and the directions of the pixels in radians.
    images : tuple of Path
        File of each turn, in the order of the numbers in their names.

    Raises
    ------
    FormatError
        The file of angles is damaged. Reading a turn raises it if its image or time is damaged.
    OSError
        The folder or the file of angles is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.layout = read_layout(path / "velodyne_config.txt")
        self.images = tuple(in_order(visible((path / "data").glob("*.png"))))
        times = path / "timestamps.txt"
        lines = text_of(times).splitlines() if times.is_file() else None
        while lines and len(lines) > len(self.images) and not lines[-1].strip():
            lines.pop()  # else a blank line at the end would count as that of an image
        self._time_lines = lines
        self._lines_of_images = _lines_of(self.images, len(lines or ()))

    def __len__(self) -> int:
        return len(self.images)

    @overload
    def __getitem__(self, index: int) -> LidarFrame: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[LidarFrame]: ...
    def __getitem__(self, index: int | slice) -> LidarFrame | Sequence[LidarFrame]:
        if isinstance(index, slice):
            return [self._read(i) for i in range(*index.indices(len(self)))]
        return self._read(range(len(self))[index])

    def __iter__(self) -> Iterator[LidarFrame]:
        return (self._read(i) for i in range(len(self)))

    def _read(self, index: int) -> LidarFrame:
        path, layout = self.images[index], self.layout
        ranges = read_depth(path, units_per_metre=layout.units_per_metre).astype(np.float64)
        expected = (len(layout.elevation), len(layout.azimuth))
        if ranges.shape != expected:
            raise FormatError(f"expected {expected} pixels, got {ranges.shape}", file=str(path))
        row, column = np.nonzero(ranges)
        return LidarFrame(
            points=layout.points(ranges)[row, column].astype(np.float32),
            time_ns=self._time(index),
            ring=row.astype(np.uint16),
            origin=(0.0, 0.0, 0.0),  # the layout states directions only, as if from one point
            source=str(path),
            fields={
                "column": column.astype(np.uint16),
                "range": ranges[row, column].astype(np.float32),
            },
            format=ScanFormat("range-image", header={"shape": expected}),
        )

    def _time(self, index: int) -> int | None:
        """Return the time of an image; None if it is not known, with a warning if it should be."""
        if self._time_lines is None:
            return None
        number = self._lines_of_images[index] if self._lines_of_images else len(self._time_lines)
        path = self.path / "timestamps.txt"
        file = str(path)
        if number >= len(self._time_lines):
            name, found = self.images[index].name, counted(len(self._time_lines), "line")
            warnings.warn(f"{path}: no line is surely that of {name}, got {found}", stacklevel=4)
            return None
        line = self._time_lines[number]
        if not line.strip():
            return None
        try:
            return parse_time(line)
        except ValueError:
            reason = f"expected a time, got {line[:40]!r}"
            raise FormatError(reason, file=file, line=number + 1) from None

    def __repr__(self) -> str:
        return f"<manip3d.datasets.RangeImageFolder: {self.path}, {counted(len(self), 'turn')}>"


def _lines_of(images: Sequence[Path], num_lines: int) -> Sequence[int]:
    """Return the line of times of each image, from 0; none if neither place nor number tells it."""
    places = range(len(images))
    if num_lines == len(images):
        return places
    found = [re.findall("[0-9]+", image.stem) for image in images]
    numbers = [int(each[-1]) if each else -1 for each in found]
    if not numbers or min(numbers) < 0 or any(a >= b for a, b in pairwise(numbers)):
        return ()
    # A missing image would shift the times of all later ones if their places counted.
    if numbers[-1] < num_lines:
        return numbers
    is_whole = numbers[-1] - numbers[0] == len(images) - 1
    return places if is_whole else ()


@checked
def open_range_images(path: str | os.PathLike[str]) -> RangeImageFolder:
    """Open a folder with ``velodyne_config.txt`` and ``data/*.png``.

    Parameters
    ----------
    path : path
        Folder of the recording.

    Returns
    -------
    RangeImageFolder
        A sequence of `manip3d.LidarFrame`, in the order of the numbers in the images' names. Each
        has a point per pixel that is not 0; ``ring`` is the row (0: the highest laser), ``fields``
        are ``column`` and ``range`` (metres). All lasers are at the origin, because the format
        states no offsets. ``time_ns`` is the time in ``timestamps.txt``. If that has a line per
        image, they are in the same order; if not, image n has line n, both counted from 0, as long
        as there are lines of all numbers. It is None where there is no such file, or the line is
        empty, and also, with a warning, where a line is missing.

    Raises
    ------
    FormatError
        The file of angles is damaged. Reading a turn raises it if its image or time is damaged.
    OSError
        The folder or the file of angles is missing.

    Examples
    --------
    >>> from manip3d import datasets
    >>> [scan.num_points for scan in datasets.open_range_images("recording")]  # doctest: +SKIP
    """
    return RangeImageFolder(path_of(path))
