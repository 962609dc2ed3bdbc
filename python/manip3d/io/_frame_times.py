"""Times of a drive's frames, from KITTI's files of times."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path

from manip3d._util.callers import caller_level
from manip3d._util.text_files import text_of
from manip3d._util.times import nanoseconds, parse_time
from manip3d.errors import FormatError
from manip3d.io._scan_tables import scan_stem


def frame_times(file: Path, *, strict: bool = False) -> dict[int, int | None]:
    """Return the time in nanoseconds of each frame number; empty if the file does not exist.

    Parameters
    ----------
    file : Path
        ``timestamps.txt`` of KITTI's raw drives, with dates, or ``times.txt`` of its odometry
        sequences, with seconds. Line n, counted from 0, is frame n.
    strict : bool
        Raise an error at the first line that is not a time. Otherwise the time of its frame is
        None, and a warning names the line.

    Raises
    ------
    FormatError
        A line is not a time, if ``strict``.
    """
    if not file.is_file():
        return {}
    parse = parse_time if file.name == "timestamps.txt" else _seconds
    times: dict[int, int | None] = {}
    errors = []
    for number, line in enumerate(text_of(file).splitlines()):
        if not line.strip():
            continue
        try:
            times[number] = parse(line)
        except ValueError:
            times[number] = None
            reason = f"expected a time, got {line[:40]!r}"
            errors.append(FormatError(reason, file=str(file), line=number + 1))
            if strict:
                raise errors[0] from None
    if errors:
        others = len(errors) - 1
        more = f"; {others} more {'line is no time' if others == 1 else 'lines are no times'}"
        more = more if others else ""
        warnings.warn(
            f"{errors[0]}{more}: the times of these frames are unknown", stacklevel=caller_level()
        )
    return times


def drive_times(drive: Path, *, strict: bool = False) -> dict[int, int | None]:
    """Return the time in nanoseconds of each frame number; empty if the drive has no file of times.

    Parameters
    ----------
    drive : Path
        Folder of the drive. The times of its scans (``velodyne_points/timestamps.txt``) have
        precedence over those of the drive (``times.txt``).
    strict : bool
        See `frame_times`.

    Raises
    ------
    FormatError
        A line is not a time, if ``strict``.
    """
    of_scans = drive / "velodyne_points" / "timestamps.txt"
    return frame_times(of_scans if of_scans.is_file() else drive / "times.txt", strict=strict)


def scan_times(drive: Path, scans: Iterable[Path], *, strict: bool = False) -> dict[Path, int]:
    """Return the time in nanoseconds of each scan for which the drive states one.

    Parameters
    ----------
    drive : Path
        Folder of the drive.
    scans : iterable of Path
        Files whose names are numbers of frames; others have no time.
    strict : bool
        See `frame_times`.

    Raises
    ------
    FormatError
        A line of the file of times cannot be parsed, if ``strict``.
    """
    times = drive_times(drive, strict=strict)
    names = {scan: scan_stem(scan) for scan in scans}
    found = {scan: times.get(int(name)) for scan, name in names.items() if name.isdecimal()}
    return {scan: time_ns for scan, time_ns in found.items() if time_ns is not None}


def _seconds(line: str) -> int:
    return nanoseconds(float(line))
