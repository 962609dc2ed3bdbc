"""Reading and writing of PTX, a text format of Leica's Cyclone for terrestrial scans."""

from __future__ import annotations

import codecs
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import numpy as np

from manip3d._util.linear import determinant, inverse, product
from manip3d.errors import FormatError
from manip3d.io._files import atomic_path, open_regular, over_max_bytes
from manip3d.io._limits import check_points
from manip3d.io._scan_colors import color_names
from manip3d.io._scan_tables import (
    exact_coordinates,
    measured_points,
    near_zero,
    seen_from,
    stored_coordinates,
)
from manip3d.lidar import LidarFrame, ScanFormat, map_shift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Doubles = NDArray[np.float64]

_MIN_ROW = 6
"""Size of the shortest point in bytes: ``0 0 0`` and the end of the line."""
_LONGEST_LINE = 1000  # bytes of a line that are parsed; points have about 60
_MAX_DIGITS = 9  # largest number of digits in the number of columns or rows
_COLORS = ("red", "green", "blue")
_NO_INTENSITY = 0.5
"""Leica's programs write this value for an unknown intensity."""
_SAME_PLACE = 1e-3
"""Tolerance in metres between two statements of the same position; both are rounded to
micrometres or coarser."""


def read_all(path: Path, limit: int) -> list[LidarFrame]:
    """Read all scans in the order of the file; see `manip3d.io.read_scans`."""
    size = path.stat().st_size
    if limit and size > limit:
        raise FormatError(over_max_bytes(limit), file=str(path))
    frames: list[LidarFrame] = []
    with open_regular(path) as file:
        lines = _Lines(file, str(path))
        while not lines.is_at_end():
            frames.append(_read_one(lines, size, len(frames)))
    if not frames:
        raise FormatError("the file is empty", file=str(path))
    return frames


class _Lines:
    """Iterator over the lines of a file that knows the number of the last line, for errors."""

    def __init__(self, file: Iterator[bytes], name: str) -> None:
        self._file, self.name, self.number = file, name, 0
        self._next: bytes | None = None

    def is_at_end(self) -> bool:
        """Return whether only empty lines are left."""
        for line in self:
            if line.strip():
                self._next = line
                self.number -= 1
                return False
        return True

    def __iter__(self) -> Iterator[bytes]:
        while (line := self._take()) is not None:
            self.number += 1
            yield line

    def _take(self) -> bytes | None:
        line, self._next = self._next, None
        line = next(self._file, None) if line is None else line
        return line if self.number or line is None else line.removeprefix(codecs.BOM_UTF8)

    def numbers(self, count: int) -> Doubles:
        """Read a line of ``count`` finite numbers."""
        line = next(iter(self), b"")
        try:
            found = np.array([float(word) for word in line[:_LONGEST_LINE].split()])
        except ValueError:
            found = np.empty(0)
        if len(found) != count or not np.isfinite(found).all():
            raise self.error(f"expected {count} numbers, got {_shown(line)}")
        return found

    def whole(self) -> int:
        """Read a line with a single integer of at most nine digits."""
        line = next(iter(self), b"").strip()
        if not line.isdigit() or len(line) > _MAX_DIGITS:
            raise self.error(f"expected the number of columns or rows, got {_shown(line)}")
        return int(line)

    def error(self, reason: str) -> FormatError:
        return FormatError(reason, file=self.name, line=max(1, self.number))


def _shown(line: bytes) -> str:
    return repr(line[:40].decode("ascii", "replace").strip()) if line else "the end of the file"


def _read_one(lines: _Lines, size: int, index: int) -> LidarFrame:
    """Read one scan: numbers of columns and rows, scanner position and axes, matrix, points."""
    shape = lines.whole(), lines.whole()
    count = shape[0] * shape[1]
    if count * _MIN_ROW > size:
        raise lines.error(f"{shape[0]} x {shape[1]} points are more than the file holds")
    check_points(count, lines.name)
    position = lines.numbers(3)
    axes = np.array([lines.numbers(3) for _ in range(3)])
    pose = np.array([lines.numbers(4) for _ in range(4)]).T  # PTX's matrix acts on row vectors
    if not np.array_equal(pose[3], (0.0, 0.0, 0.0, 1.0)) or not abs(determinant(pose)) > 0.0:
        raise lines.error("expected a matrix that moves and turns")
    table = _read_points(lines, count)
    stored = np.ascontiguousarray(table[:, :3])
    # If the stated position is not the origin of the points, they are not relative to the scanner.
    stands = product(inverse(pose), [*position, 1.0])[:3]
    is_own = not position.any() or bool(np.abs(stands).max() < _SAME_PLACE)
    about = {"pose": pose, "position": position, "axes": axes, "shape": shape, "index": index}
    layout = ScanFormat("ptx", header=about, to_file=near_zero(stored))
    points = measured_points(stored, layout, lines.name)
    origin = (0.0, 0.0, 0.0) if is_own and not layout.to_file[:3, 3].any() else None
    is_known = table.shape[1] > 3 and not (table[:, 3] == _NO_INTENSITY).all()
    colors = dict(zip(_COLORS, table[:, 4:].astype(np.uint8).T, strict=False))
    return LidarFrame(
        points=points,
        intensity=table[:, 3].astype(np.float32) if is_known else None,
        origin=origin,
        source=lines.name,
        fields={name: np.ascontiguousarray(values) for name, values in colors.items()},
        exact=exact_coordinates(stored, points),
        format=layout,
    )


def _read_points(lines: _Lines, count: int) -> Doubles:
    """Read points: (N, 3), (N, 4) with the intensity, or (N, 7) also with colours."""
    begin = lines.number
    if not count:
        return np.empty((0, 4))
    try:
        text = (line[:_LONGEST_LINE].decode("ascii") for line in itertools.islice(lines, count))
        table: Doubles = np.loadtxt(text, np.float64, comments=None, ndmin=2)
    except ValueError as error:
        reason = str(error).partition(";")[0][:100]
        raise FormatError(
            f"damaged point from here on: {reason}", file=lines.name, line=begin + 1
        ) from None
    if len(table) != count or table.shape[1] not in (3, 4, 7):
        raise lines.error(
            f"expected {count} points of 3, 4 or 7 numbers, got {len(table)} of {table.shape[1]}"
        )
    if table.shape[1] == 7 and not bool(((table[:, 4:] >= 0.0) & (table[:, 4:] < 256.0)).all()):
        raise lines.error("expected colours from 0 to 255")
    return table


def write_all(frames: Sequence[LidarFrame], path: Path) -> None:
    """Write all scans; those that were read from PTX or E57 keep their poses.

    Points are relative to the scanner, whose position is written in the matrix. If points were
    added or removed, the scan is no grid any more, and is written as one column. An unknown
    position of the scanner is written as the origin, because PTX cannot express it.
    """
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as out:
        for frame in frames:
            _write_one(frame, out)


def _write_one(frame: LidarFrame, out: TextIO) -> None:
    known = {} if frame.format is None else dict(frame.format.header)
    is_own = frame.format is not None and frame.format.name == "ptx"
    shape = known["shape"] if is_own else (1, frame.num_points)
    if shape[0] * shape[1] != frame.num_points:
        shape = (1, frame.num_points)
    given = known.get("pose")  # None for a .3d file without its .pose file
    pose = np.eye(4) if given is None else np.array(given, np.float64)
    stands = np.zeros(3) if frame.origin is None else np.array(frame.origin) + map_shift(frame)
    pose[:, 3] = product(pose, np.append(stands, 1.0))
    position = known["position"] if is_own and not stands.any() else pose[:3, 3]
    axes = known["axes"] if is_own else pose[:3, :3].T
    out.write(f"{shape[0]}\n{shape[1]}\n")
    np.savetxt(out, np.vstack([position, axes]), "%.17g")
    np.savetxt(out, pose.T, "%.17g")
    np.savetxt(out, _table_of(frame, stands), _row_of(frame))


def _table_of(frame: LidarFrame, stands: Doubles) -> Doubles:
    if frame.intensity is None:
        intensity = np.full(frame.num_points, _NO_INTENSITY)
    else:
        intensity = frame.intensity.astype(np.float64)
    colors = [frame.fields[name] for name in color_names(frame, "ptx")]
    stored = stored_coordinates(frame, "ptx")
    seen = seen_from(stored, stands).astype(stored.dtype)
    return np.column_stack([seen, intensity, *colors])


def _row_of(frame: LidarFrame) -> str:
    """Return the format of a row, with digits that preserve float32, or float64 coordinates."""
    digits = "%.9g" if stored_coordinates(frame, "ptx").dtype == np.float32 else "%.17g"
    return " ".join([digits] * 3 + ["%.9g"] + ["%d"] * len(color_names(frame, "ptx")))
