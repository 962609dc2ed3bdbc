"""Scans of a drive or a recording in order; unreadable scans do not end a drive."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d._util.checked import checked
from manip3d._util.texts import counted
from manip3d.authenticate import drive_numbers, find_record, read_record
from manip3d.authenticate._watermark_files import scans_to_read
from manip3d.capture._addresses import scan_address
from manip3d.capture._lidar import expect_scans, open_unlabelled
from manip3d.capture._past_errors import past_errors
from manip3d.errors import Error, InputError
from manip3d.io import read_scan
from manip3d.io._frame_times import scan_times

if TYPE_CHECKING:
    from manip3d.lidar import LidarFrame

_REASONS = (Error, OSError)
_SCHEMES = ("pcap", "ouster", "kitti", "bag")


class LidarDrive:
    """Result of `open_drive`: an iterable of scans for `manip3d.authenticate.inspect_drive`.

    Attributes
    ----------
    names : list of str
        Names of the scans that were read so far.
    errors : dict of int to str
        Index of each scan that could not be read, with the reason.
    paths : dict of int to Path
        Index of each scan with its file; empty for recordings, whose scans share one file.
    times_ns : dict of int to int
        Index of each scan with its time in nanoseconds; scans of unknown time are left out.
    """

    def __init__(self, source: str, calibration: str | os.PathLike[str] | None) -> None:
        self.names: list[str] = []
        self.errors: dict[int, str] = {}
        self.paths: dict[int, Path] = {}
        self.times_ns: dict[int, int] = {}
        self._source, self._calibration = source, calibration
        address = scan_address(source) or ""
        self._is_folder = Path(source).is_dir() and not address.startswith("bag:")
        self._address = address
        if self._is_folder and calibration is not None:
            raise InputError(
                "calibration: can only be given with a recording of packets, got scans"
            )
        if not self._is_folder and address.partition(":")[0] not in _SCHEMES:
            known = ", ".join(f"{name}:PATH" for name in _SCHEMES)
            raise InputError(f"{source}: expected a file, a folder or one of {known}")

    def __repr__(self) -> str:
        scans = counted(len(self.names), "scan")
        return f"<manip3d.capture.LidarDrive: {self._source}, {scans} read>"

    @property
    def numbers(self) -> list[int] | None:
        """Numbers of the scans, with gaps where scans are missing; None: no scan is missing."""
        return drive_numbers(self._source) if self._is_folder else None

    def __iter__(self) -> Iterator[LidarFrame | None]:
        """Yield the scans; None for an unreadable one, see `LidarSource.past_errors`."""
        for known in (self.names, self.errors, self.paths, self.times_ns):
            known.clear()
        return self._files() if self._is_folder else self._recorded()

    def records(self) -> Iterator[bytes | None]:
        """Yield the watermark record beside each scan, in the order of the scans.

        Yields
        ------
        bytes or None
            b'' if the record is missing or unreadable; None for a scan without its own file.
        """
        for number in itertools.count():
            path = self.paths.get(number)
            yield None if path is None else _record_beside(path)

    def _files(self) -> Iterator[LidarFrame | None]:
        scans = scans_to_read(self._source)
        times = scan_times(Path(self._source), scans)
        read = past_errors(map(read_scan, scans), self.errors, _REASONS, needs_one=False)
        for number, (path, scan) in enumerate(zip(scans, read, strict=True)):
            self.names.append(path.name)
            if path in times:
                self.times_ns[number] = times[path]
            self.paths[number] = path
            yield scan

    def _recorded(self) -> Iterator[LidarFrame | None]:
        with open_unlabelled(self._address, calibration=self._calibration) as opened:
            opened.errors = self.errors
            read = expect_scans(opened.past_errors(), self._address, lambda: opened.counters)
            for number, scan in enumerate(read):
                self.names.append(f"frame {number}")
                if scan is not None and scan.time_ns is not None:
                    self.times_ns[number] = scan.time_ns
                yield scan


def _record_beside(scan: Path) -> bytes:
    """Return the watermark record of a scan; an unreadable one counts as missing (b'')."""
    try:
        return read_record(find_record(scan)) or b""
    except (Error, OSError):
        return b""


@checked
def open_drive(
    source: str | os.PathLike[str], *, calibration: str | os.PathLike[str] | None = None
) -> LidarDrive:
    """Open the scans of a drive, or of a recording of a LiDAR, to inspect them in order.

    A scan that cannot be read is None. A drive and a bag continue after it, a recording of packets
    ends.

    Parameters
    ----------
    source : path or str
        Folder in KITTI's layout (text files and NumPy arrays count as scans only if the folder has
        no other scans), a file of packets (``.pcap``), a bag, or an address of `open_lidar`.
    calibration : path, optional
        Calibration of a Velodyne HDL-64E, for packets.

    Returns
    -------
    LidarDrive
        An iterable of the scans; its attributes are filled while it is iterated.

    Raises
    ------
    InputError
        The source is neither a drive nor a recording; a calibration is given for files of scans.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from manip3d import authenticate, capture
    >>> folder = Path("drive", "velodyne")
    >>> folder.mkdir(parents=True)
    >>> for name in ("000004.bin", "000005.bin"):
    ...     np.zeros((100, 4), np.float32).tofile(folder / name)
    >>> drive = capture.open_drive("drive")
    >>> found = list(authenticate.inspect_drive(drive, numbers=drive.numbers))
    >>> drive.names, [each.verdict for each in found]
    (['000004.bin', '000005.bin'], ['undecidable', 'undecidable'])
    """
    return LidarDrive(os.fspath(source), calibration)
