"""``info`` and ``convert`` for scans and for recordings of LiDARs."""

from __future__ import annotations

import itertools
import os
import re
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.times import SECOND_NS
from manip3d.cli.terminal import Terminal, count, counted, table
from manip3d.errors import FormatError, InputError
from manip3d.io._scan_tables import scan_suffix
from manip3d.lidar import map_shift

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rich.console import Console

    from manip3d.capture import LidarSource
    from manip3d.lidar import LidarFrame

_MAX_TOLD = 8
"""Largest number of column names in a message."""

_SCANS, _TIMES = "velodyne", "times.txt"
"""Names in KITTI's layout of the folder of scans and of the file of their times."""

_ON_MAP = 1e5
"""Coordinates from this on are those of a map, and six digits of them are no centimetres."""


def expect_packets(source: str, calibration: Path | None) -> None:
    """Refuse ``--calibration`` for a source that is no recording of packets.

    Raises
    ------
    InputError
        A calibration is given, and the source is no recording of packets, no bag and no drive.
    """
    if calibration is None:
        return
    from manip3d import capture

    if source == "-" or capture.scan_address(source) is None:
        raise InputError(
            f"--calibration: can only be given with a recording of packets, got {source}"
        )


def frames(
    source: str, terminal: Terminal, calibration: Path | None = None
) -> Iterator[LidarFrame]:
    """Yield the scans of a file or the frames of a recording.

    Raises
    ------
    FormatError
        A frame of a recording cannot be read; it is raised after the frames that can be read.
    """
    from manip3d import capture, io
    from manip3d.capture._lidar import expect_scans

    uri = capture.scan_address(source)
    if uri is not None:
        with capture.open_lidar(uri, calibration=calibration) as recording:
            read = expect_scans(recording.past_errors(), uri, lambda: recording.counters)
            yield from (frame for frame in read if frame is not None)
            refused = {k: v for k, v in recording.counters.items() if v and k in _REFUSED}
            if lost := recording.counters.get("lost_packets", 0):
                were = "was" if lost == 1 else "were"
                terminal.warn(
                    f"{uri}: scans have gaps, because {counted(lost, 'packet')} {were} lost"
                )
            if (damage := _damage(recording)) is not None:
                raise damage
        terminal.say(f"refused: {refused}" if refused else "nothing was refused")
        return
    scans = io.read_scans(source)
    terminal.say(f"read {source}: {counted(sum(scan.num_points for scan in scans), 'point')}")
    yield from scans


_REFUSED = ("bad_length", "unknown_product", "other_product", "unknown_return_mode",
            "bad_block_flag", "bad_azimuth", "overlong_frames", "file_fragments",
            "file_cut_short", "repeated_packets")  # fmt: skip


def _damage(recording: LidarSource) -> FormatError | None:
    """Return the first error of a recording, with the number of the others; None: all was read."""
    if not recording.errors:
        return None
    first, *more = recording.errors.values()
    return FormatError(f"{first}; {counted(len(more), 'more error')}" if more else first)


def summary(
    source: str, terminal: Terminal, calibration: Path | None = None
) -> tuple[dict[str, Any], FormatError | None]:
    """Return counts and extents of the scans of a source, and the error of unreadable frames."""
    from manip3d import capture
    from manip3d.capture._lidar import expect_scans

    uri = capture.scan_address(source)
    if uri is None:
        return _told(source, [frame.summary().record() for frame in frames(source, terminal)]), None
    recording = capture.open_lidar(uri, calibration=calibration)
    scans: list[dict[str, Any]] = []
    for frame in expect_scans(recording.past_errors(), uri, lambda: recording.counters):
        if frame is not None:
            scans.append(frame.summary().record())
    damage = _damage(recording)
    record = _told(source, scans) | {"counters": recording.counters}
    return (record if damage is None else record | {"error": str(damage)}), damage


def _told(source: str, scans: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a record of all scans, with their duration and rate if all have times."""
    unit = scans[0].get("unit", "m") if scans else "m"
    record: dict[str, Any] = {"file": source, "unit": unit, "scans": scans} | _together(scans)
    times = [scan["time_ns"] for scan in scans]
    if len(times) < 2 or None in times:
        return record
    return record | {
        "seconds": (times[-1] - times[0]) / SECOND_NS,
        "frames_per_second": SECOND_NS / float(np.median(np.diff(times)))
        if np.all(np.diff(times) > 0)
        else None,
    }


def _together(scans: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the columns of a table of several sources: counts and extents of all scans."""
    formats = [scan["format"] for scan in scans if scan["format"] is not None]
    bounds = np.array([scan["bounds"] for scan in scans if scan["bounds"] is not None])
    ranges = np.array([scan["range"] for scan in scans if scan["range"] is not None])
    return {
        "format": "+".join(dict.fromkeys(formats)) or None,
        "frames": len(scans),
        "points": sum(scan["points"] for scan in scans),
        "bounds": [bounds[:, 0].min(0).tolist(), bounds[:, 1].max(0).tolist()]
        if bounds.size
        else None,
        "range": [ranges[:, 0].min().item(), ranges[:, 1].max().item()] if ranges.size else None,
    }


def show(console: Console, record: dict[str, Any]) -> None:
    """Print a row for each scan, extents of the first, and the counters of a recording."""
    rows = []
    for number, scan in enumerate(record["scans"]):
        about = scan.get("model") or scan["format"] or ""
        reach = scan["range"]
        rows.append(
            (
                str(number),
                about,
                count(scan["points"]),
                count(scan["no_return"] + scan["dropped"]),
                "" if reach is None else f"{reach[0]:.2f}..{reach[1]:.2f} m",
                "" if scan["rings"] is None else count(scan["rings"]),
                " ".join(scan["fields"]),
            )
        )
    header = (
        PurePath(record["file"]).name,
        "",
        "points",
        "without return",
        "range",
        "rings",
        "fields",
    )
    table(console, rows, header)
    for scan in itertools.islice(record["scans"], 1):
        if scan["bounds"] is not None:
            low, high = scan["bounds"]
            pairs = zip(low, high, strict=True)
            text = "  ".join(f"{_length(a)}..{_length(b)}" for a, b in pairs)
            unit = "metres" if record["unit"] == "m" else record["unit"]
            console.print(f"bounds  {text}  {unit}")
        if scan["intensity"] is not None:
            console.print("intensity  {:.6g}..{:.6g}".format(*scan["intensity"]))
    if record.get("frames_per_second"):
        console.print(
            f"times   {record['seconds']:.3f} s, {record['frames_per_second']:.2f} frames/s"
        )
    counters = record.get("counters", {})
    told = [f"{name.replace('_', ' ')} {count(value)}" for name, value in counters.items() if value]
    if told:
        console.print("counted  " + ", ".join(told))


def _length(value: float) -> str:
    """Return a coordinate as text; one of a map to the centimetre."""
    return f"{value:.6g}" if abs(value) < _ON_MAP else f"{value:.2f}"


def convert(source: str, output: Path, terminal: Terminal, calibration: Path | None = None) -> None:
    """Convert scans to a file, or to a folder in KITTI's layout if ``output`` has no suffix.

    Raises
    ------
    InputError
        There are several scans, and the format of ``output`` holds only one; the scans lie
        where they would be replaced; or other scans lie there.
    """
    from manip3d import io

    scans = frames(source, terminal, calibration)
    suffix = scan_suffix(output)
    if not suffix:
        _expect_other_folder(source, output)
        _expect_own_scans(output)
        _write_folder(scans, output, terminal)
        return
    found = [_measured(scan, suffix, terminal) for scan in scans]
    if len(found) > 1 and suffix not in (".e57", ".ptx"):
        raise InputError(
            f"-o {output}: {source} holds {len(found)} scans, and {suffix} one: name a folder "
            "without --to, or a file that ends in .e57 or .ptx"
        )
    io.write_scans(found, output)
    tell_losses(found, suffix, terminal)
    terminal.say(f"wrote {output}")


def _expect_other_folder(source: str, output: Path) -> None:
    """Raise InputError if the scans are read from the folder in which they would be replaced."""
    place, folder = Path(source.removeprefix("kitti:")).resolve(), (output / _SCANS).resolve()
    is_drive = place == output.resolve() and folder.is_dir()
    is_scan = place.parent == folder and place.suffix == ".bin"
    if is_drive or is_scan or place == folder:
        raise InputError(
            f"-o {output}: expected another folder, because the scans would be replaced"
        )


def _expect_own_scans(output: Path) -> None:
    """Raise InputError if scans lie in the folder that no run wrote: they would join the drive."""
    others = sorted(path.name for path in (output / _SCANS).glob("*.bin") if not _is_own(path))
    if others:
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        raise InputError(
            f"-o {output}: expected no scans in {_SCANS} with names other than 000000.bin and so "
            f"on, which would be read as a part of the drive, found {others[0]}{more}"
        )


def _is_own(path: Path) -> bool:
    """Return whether a scan is named as `_write_folder` names it.

    More digits are those of KITTI's raw data or a time; 10 million scans are a drive of days.
    """
    return re.fullmatch("[0-9]{6}|[1-9][0-9]{6}", path.stem) is not None


def _measured(scan: LidarFrame, suffix: str, terminal: Terminal) -> LidarFrame:
    """Return a scan without the cells of a PTX grid that hold no point, which only PTX can tell."""
    if suffix == ".ptx" or scan.format is None or scan.format.name != "ptx" or not scan.num_empty:
        return scan
    terminal.warn(f"{counted(scan.num_empty, 'cell')} of the grid without a point left out")
    return scan.select(scan.points.any(axis=1))


def tell_losses(scans: Sequence[LidarFrame], suffix: str, terminal: Terminal) -> None:
    """Warn of what files of this suffix do not hold of the scans that were written to one."""
    from manip3d.io._scan_files import names_left_out

    for scan in scans:
        _tell_of_map(scan, suffix, terminal)
        _tell_of_grid(scan, suffix, terminal)
    left_out = [name for scan in scans for name in names_left_out(scan, suffix)]
    _tell_left_out(left_out, suffix, terminal)


def _tell_of_grid(scan: LidarFrame, suffix: str, terminal: Terminal) -> None:
    """Warn if the scan is an organised cloud, and a format does not hold its grid."""
    from manip3d.io._scan_tables import lost_grid

    if (sides := lost_grid(scan, suffix)) is not None:
        terminal.warn(
            f"the cloud's grid of {sides[1]} x {sides[0]} pixels is not kept in {suffix}: "
            "write .pcd or .npy to keep it"
        )


def _tell_left_out(names: list[str], suffix: str, terminal: Terminal) -> None:
    """Warn of columns without a place in a format, in words that are the same for all files."""
    told = list(dict.fromkeys(names))
    more = f" and {len(told) - _MAX_TOLD} more" if len(told) > _MAX_TOLD else ""
    if told:
        terminal.warn(f"{', '.join(told[:_MAX_TOLD])}{more} left out, which {suffix} does not hold")


def _tell_of_map(scan: LidarFrame, suffix: str, terminal: Terminal, name: str = "") -> None:
    """Warn if coordinates or the scanner's position are lost or are rarely read by programs.

    A name of one file of many precedes each warning.
    """
    from manip3d.io._scan_files import position_losses

    losses = (position_losses, _map_losses, _rounding_losses)
    for loss in (told for of in losses for told in of(scan, suffix)):
        terminal.warn(f"{name}: {loss}" if name else loss)


def _map_losses(scan: LidarFrame, suffix: str) -> Iterator[str]:
    """Yield a sentence if coordinates of a map are lost or are rarely read by programs."""
    from manip3d.io._scan_tables import loses_map_coordinates, map_coordinates

    is_new = scan.format is not None and scan.format.name != "pcd"
    if suffix == ".pcd" and is_new and map_coordinates(scan, "pcd") is not None:
        yield (
            "coordinates of 64 bits, which PCL and Open3D do not read in .pcd files: for these "
            "write .ply or .las"
        )
    if scan.format is not None and loses_map_coordinates(scan, suffix):
        shift = scan.format.to_file[:3, 3]
        place = " ".join(f"{value:.0f}" for value in shift)
        yield f"coordinates are written near 0: those of the map are {place} more"


def _rounding_losses(scan: LidarFrame, suffix: str) -> Iterator[str]:
    """Yield a sentence if a file of this suffix gets other coordinates than those of the scan."""
    from manip3d.io._scan_las import is_rounded

    if suffix in (".las", ".laz") and is_rounded(scan):
        yield f"coordinates are rounded to 0.1 mm, the step of new {suffix} files"


def _write_folder(scans: Iterator[LidarFrame], output: Path, terminal: Terminal) -> None:
    """Write ``velodyne/000000.bin`` and so on, and ``times.txt`` if all scans have times.

    What an earlier run wrote there beyond these files is removed.
    """
    from manip3d.io._files import atomic_write
    from manip3d.io._scan_files import names_left_out
    from manip3d.io._scan_tables import lost_pose

    folder = output / _SCANS
    count_written, times = 0, []
    left_out: dict[str, None] = {}
    told: set[tuple[Any, ...]] = set()
    damage: FormatError | None = None
    try:
        for number, scan in enumerate(scans):
            folder.mkdir(parents=True, exist_ok=True)  # not before there is a scan
            path = folder / f"{number:06d}.bin"
            _measured(scan, ".bin", terminal).write(path)
            # All scans of a recording usually have the same shift, position and pose.
            pose = lost_pose(scan, ".bin")
            turn = None if pose is None else pose.tobytes()
            about = (*map_shift(scan).tolist(), scan.origin, turn)
            if about not in told:
                _tell_of_map(scan, ".bin", terminal, path.name)
            told.add(about)
            left_out |= dict.fromkeys(names_left_out(scan, ".bin"))
            count_written += 1
            if scan.time_ns is not None:
                times.append(f"{scan.time_ns // SECOND_NS}.{scan.time_ns % SECOND_NS:09d}\n")
    except FormatError as error:  # the recording is damaged: the scans before that stay
        damage = error
    if count_written:
        _remove_later(folder, count_written, terminal)
        if len(times) == count_written:
            atomic_write(output / _TIMES, "".join(times))
        else:
            (output / _TIMES).unlink(missing_ok=True)
    _tell_left_out(list(left_out), ".bin", terminal)
    if count_written or damage is None:
        terminal.say(f"wrote {counted(count_written, 'scan')} to {output}{os.sep}")
    if damage is not None:
        raise damage


def _remove_later(folder: Path, count_written: int, terminal: Terminal) -> None:
    """Remove the scans of an earlier run with more scans, which would seem to be of this one."""
    old = [p for p in folder.glob("*.bin") if _is_own(p) and int(p.stem) >= count_written]
    for path in old:
        path.unlink()
    if old:
        terminal.say(f"removed {counted(len(old), 'scan')} of an earlier run")
