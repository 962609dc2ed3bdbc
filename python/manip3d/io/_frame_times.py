"""Times of a drive's frames, from KITTI's files of times."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from manip3d._util.text_files import text_of
from manip3d._util.times import nanoseconds, parse_time
from manip3d.errors import FormatError


def frame_times(file: Path) -> dict[int, int]:
    """Return the time in nanoseconds of each frame number; empty if the file does not exist.

    Parameters
    ----------
    file : Path
        ``timestamps.txt`` of KITTI's raw drives, with dates, or ``times.txt`` of its odometry
        sequences, with seconds. Line n, counted from 0, is frame n.

    Raises
    ------
    FormatError
        A line is not a time.
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


def drive_times(drive: Path) -> dict[int, int]:
    """Return the time in nanoseconds of each frame number; empty if the drive has no file of times.

    Parameters
    ----------
    drive : Path
        Folder of the drive. The times of its scans (``velodyne_points/timestamps.txt``) have
        precedence over those of the drive (``times.txt``).

    Raises
    ------
    FormatError
        A line is not a time.
    """
    of_scans = drive / "velodyne_points" / "timestamps.txt"
    return frame_times(of_scans if of_scans.is_file() else drive / "times.txt")


def scan_times(drive: Path, scans: Iterable[Path]) -> dict[Path, int]:
    """Return the time in nanoseconds of each scan for which the drive states one.

    Parameters
    ----------
    drive : Path
        Folder of the drive.
    scans : iterable of Path
        Files whose names are numbers of frames; others have no time.

    Raises
    ------
    FormatError
        A line of the file of times cannot be parsed.
    """
    times = drive_times(drive)
    names = {scan: scan.name.split(".")[0] for scan in scans}
    return {
        scan: times[int(name)]
        for scan, name in names.items()
        if name.isdecimal() and int(name) in times
    }


def _seconds(line: str) -> int:
    return nanoseconds(float(line))
