"""Reader of folders of LiDAR range images: a 16-bit PNG per turn, and one file with the angles.

This is the layout of KIT's Velodyne tracking data (F. Moosmann): ``data/0000000000.png`` with a row
per laser and a column per azimuth step, ``velodyne_config.txt`` and ``timestamps.txt``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
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
    for head in (1, 0):  # numbers before the width: the multiplier or none
        if len(values) < head + 6:
            continue
        width, height, left, right = values[head : head + 4]
        angles = values[head + 4 :]
        sizes_fit = 0 < width <= 1 << 16 and 0 < height <= 1 << 16 and width % 1 == height % 1 == 0
        if not sizes_fit or len(angles) not in (2, height) or (head and not values[0] > 0):
            continue
        columns = left + (right - left) * (np.arange(width) + 0.5) / width
        if len(angles) == 2 != height:
            angles = angles[0] + np.ptp(angles) * (np.arange(height) + 0.5) / height
        scale = float(values[0]) if head else 1.0
        return RangeImageLayout(scale, np.radians(columns), -np.radians(angles))
    return None


@checked
class RangeImageFolder(Sequence[LidarFrame]):
    """Sequence of the scanner's turns in a folder, each read on demand."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.layout = read_layout(path / "velodyne_config.txt")
        self.images = tuple(sorted((path / "data").glob("*.png")))
        times = path / "timestamps.txt"
        lines = text_of(times).splitlines() if times.is_file() else []
        self._times = [line for line in lines if line.strip()]

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
            origin=(0.0, 0.0, 0.0),
            source=str(path),
            fields={
                "column": column.astype(np.uint16),
                "range": ranges[row, column].astype(np.float32),
            },
            format=ScanFormat("range-image", header={"shape": expected}),
        )

    def _time(self, index: int) -> int | None:
        if index >= len(self._times):
            return None
        try:
            return parse_time(self._times[index])
        except ValueError:
            reason = f"expected a time, got {self._times[index][:40]!r}"
            file = str(self.path / "timestamps.txt")
            raise FormatError(reason, file=file, line=index + 1) from None

    def __repr__(self) -> str:
        return f"<manip3d.datasets.RangeImageFolder: {self.path}, {counted(len(self), 'turn')}>"


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
        A sequence of `manip3d.LidarFrame`. Each has a point per pixel that is not 0; ``ring`` is
        the row (0: the highest laser), ``fields`` are ``column`` and ``range`` (metres). All lasers
        are at the origin, because the format states no offsets.

    Raises
    ------
    FormatError
        The file of angles is damaged. A damaged image or time raises it when that turn is read.
    OSError
        The folder or the file of angles is missing.

    Examples
    --------
    >>> from manip3d import datasets
    >>> [scan.num_points for scan in datasets.open_range_images("recording")]  # doctest: +SKIP
    """
    return RangeImageFolder(path_of(path))
