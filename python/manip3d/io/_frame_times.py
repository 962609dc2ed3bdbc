"""The times of a drive's frames, as KITTI writes them beside its scans."""

from __future__ import annotations

from pathlib import Path

from manip3d._util.times import nanoseconds, parse_time
from manip3d.errors import FormatError
from manip3d.io._text_files import text_of


def frame_times(file: Path) -> dict[int, int]:
    """Return nanoseconds by frame number: line n of the file is frame n; empty without the file.

    Parameters
    ----------
    file : Path
        ``timestamps.txt`` with dates, of KITTI's raw drives, or ``times.txt`` with seconds, of its
        odometry sequences.

    Raises
    ------
    FormatError
        A line is no time.
    """
    if not file.is_file():
        return {}
    parse = parse_time if file.name == "timestamps.txt" else _seconds
    times = {}
    for number, line in enumerate(text_of(file).splitlines()):
        if not line.strip():
            continue
        try:
            times[number] = parse(line)
        except ValueError:
            raise FormatError(
                f"expected a time, got {line[:40]!r}", file=str(file), line=number + 1
            ) from None
    return times


def _seconds(line: str) -> int:
    return nanoseconds(float(line))
