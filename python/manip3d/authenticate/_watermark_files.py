"""Files of watermarked scans: records beside them, and drives as one chain."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.paths import in_order, is_hidden, path_of, refuse_existing
from manip3d.authenticate._picture_files import carrier_bytes, picture_path
from manip3d.authenticate._turns import MAX_APART_NS
from manip3d.authenticate._watermark import Watermarked, WatermarkResult, WatermarkVerdict
from manip3d.errors import InputError
from manip3d.io import read_scan, write_scan
from manip3d.io._files import atomic_pair, atomic_path, open_regular
from manip3d.io._frame_times import drive_times
from manip3d.io._scan_files import (
    FOLDER_SUFFIXES,
    names_left_out,
    position_losses,
    readable_scans,
    scan_paths,
)
from manip3d.io._scan_tables import (
    grid_of,
    keeps_float32_only,
    lost_grid,
    scan_stem,
    scan_suffix,
)
from manip3d.lidar import LidarFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_RECORD_BYTES = 16384  # kMaxSize of watermark.hpp
RECORD_SUFFIX = ".wm"

_SAME_M = 1e-8  # metres: rounding of float64 on a national grid, and below any grid's step
_TURN_NS = 100_000_000  # duration of a turn at 10 Hz
_COMPRESSED = (".xz", ".gz")
_EXACT = (".bin", ".pcd.bin", ".pcd", ".ply")

_WITH_INTENSITY = (".bin", ".pcd.bin")

_CALIBRATIONS = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")
_FOLDERS = (Path("velodyne_points") / "data", Path("velodyne"))


@checked
def record_path(scan: str | os.PathLike[str]) -> Path:
    """Return the path of the record beside a scan: ``scan.bin.wm`` for ``scan.bin``.

    Parameters
    ----------
    scan : path
        Path of the scan.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        ``scan`` is not a path.

    Examples
    --------
    >>> from manip3d.authenticate import record_path
    >>> record_path("drive/scan.bin").as_posix()
    'drive/scan.bin.wm'
    """
    path = path_of(scan)
    return path.with_name(path.name + RECORD_SUFFIX)


@checked
def find_record(scan: str | os.PathLike[str]) -> Path:
    """Return the path of the record of a scan that may have been compressed after embedding.

    It is `record_path` of the scan. If there is no such file, it is the record of the scan before
    it was compressed or decompressed, if that exists: ``scan.bin.wm`` for ``scan.bin.xz``.

    Parameters
    ----------
    scan : path
        Path of the scan.

    Returns
    -------
    Path
        Path of the record; that of `record_path` if there is none.

    Raises
    ------
    InputError
        ``scan`` is not a path.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate import find_record
    >>> Path("scan.bin.wm").touch()
    >>> find_record("scan.bin.xz").name, find_record("other.bin").name
    ('scan.bin.wm', 'other.bin.wm')
    """
    records = [record_path(each) for each in _same_scans(path_of(scan))]
    return next((each for each in records if each.is_file()), records[0])


@checked
def read_record(path: str | os.PathLike[str]) -> bytes | None:
    """Return the bytes of a record; None if there is no such file.

    At most 16 385 bytes are returned, one more than the longest valid record, so that a verifier
    rejects longer files.

    Parameters
    ----------
    path : path
        See `record_path`.

    Returns
    -------
    bytes or None

    Raises
    ------
    FormatError
        The file is a pipe or a device.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate import read_record
    >>> _ = Path("scan.bin.wm").write_bytes(b"MWM1")
    >>> read_record("scan.bin.wm"), read_record("other.bin.wm")
    (b'MWM1', None)
    """
    try:
        with open_regular(path_of(path)) as file:
            return file.read(MAX_RECORD_BYTES + 1)
    except FileNotFoundError:
        return None


@checked
def scan_of_record(record: str | os.PathLike[str]) -> Path | None:
    """Return the scan of a record, which may be compressed; None if the scan is missing.

    Parameters
    ----------
    record : path
        See `record_path`.

    Returns
    -------
    Path or None

    Raises
    ------
    InputError
        The name does not end in ``.wm``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate import scan_of_record
    >>> Path("scan.bin.xz").touch()
    >>> scan_of_record("scan.bin.wm").name, scan_of_record("other.bin.wm")
    ('scan.bin.xz', None)
    """
    return next(iter(scans_of_record(path_of(record))), None)


def scans_of_record(record: Path) -> list[Path]:
    """Return the scan of a record and its compressed copies, those that exist, whatever the suffix.

    Raises
    ------
    InputError
        The name does not end in ``.wm``.
    """
    if record.suffix != RECORD_SUFFIX:
        raise InputError(f"{record}: expected a record, whose name ends in {RECORD_SUFFIX}")
    return [each for each in _same_scans(record.with_suffix("")) if each.is_file()]


def _same_scans(scan: Path) -> list[Path]:
    """The scan's path, and its paths after compression or decompression."""
    plain = scan.name
    for suffix in _COMPRESSED:
        plain = plain.removesuffix(suffix)
    names = (plain, *(plain + suffix for suffix in _COMPRESSED))
    return [scan, *(scan.with_name(name) for name in names if name != scan.name)]


@checked
def refuse_existing_record(scan: str | os.PathLike[str], *, replace: bool = False) -> None:
    """Refuse to replace an existing record beside a scan.

    Parameters
    ----------
    scan : path
        Path of the scan.
    replace : bool
        Allow to replace the record; nothing is refused then.

    Raises
    ------
    InputError
        The record exists, and ``replace`` is False.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate._watermark_files import refuse_existing_record
    >>> refuse_existing_record("scan.bin")
    >>> Path("scan.bin.wm").touch()
    >>> refuse_existing_record("scan.bin")
    Traceback (most recent call last):
        ...
    manip3d.errors.InputError: scan.bin.wm: exists already; replace=True replaces it
    """
    refuse_existing(record_path(scan), overwrite=replace, option="replace")


@checked
def check_holds_float32(scan: str | os.PathLike[str]) -> None:
    """Refuse file formats that round coordinates, because no watermark survives rounding.

    Parameters
    ----------
    scan : path
        Path of the scan; only its name is used.

    Raises
    ------
    InputError
        The suffix is none of .bin, .pcd and .ply.

    Examples
    --------
    >>> from manip3d.authenticate._watermark_files import check_holds_float32
    >>> from manip3d.errors import InputError
    >>> check_holds_float32("scan.bin")
    >>> try:
    ...     check_holds_float32("scan.las")
    ... except InputError:
    ...     print("coordinates would be rounded")
    coordinates would be rounded
    """
    if scan_suffix(path_of(scan)) not in _EXACT:
        raise InputError(
            f"{os.fspath(scan)}: expected a format that keeps float32 coordinates as they are "
            f"({', '.join(_EXACT)}); others round them"
        )


@checked
def as_stored(
    frame: LidarFrame,
    path: str | os.PathLike[str],
    *,
    unchanged: str | os.PathLike[str] | None = None,
) -> LidarFrame:
    """Return a scan as it will be read from its file; the watermark must sign this scan.

    PCD keeps the grid of an organised scan and the scanner's position. Warnings state that another
    format does not, and which columns of another file a format cannot hold. In these, and for scans
    without a grid, ``num_dropped`` becomes 0 and ``file_rows`` None: points without coordinates are
    not written, so that a reader drops none.
    KITTI's and nuScenes' formats have an intensity, which is 0 if the scan has none.

    Parameters
    ----------
    frame : LidarFrame
        The scan.
    path : path
        Path to which it will be written.
    unchanged : path, optional
        File that will be copied to ``path`` if it has the same format, as `write_watermarked` does
        for detached watermarks; ``frame`` is returned then.

    Returns
    -------
    LidarFrame
        The scan as it will be read; ``frame`` itself if the file will be a copy.

    Raises
    ------
    InputError
        The suffix of ``path`` is not that of a scan.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame
    >>> from manip3d.authenticate import as_stored
    >>> organised = LidarFrame(np.ones((2, 3), np.float32), num_dropped=7)
    >>> stored = as_stored(organised, "scan.bin")
    >>> stored.num_dropped, stored.intensity.tolist()
    (0, [0.0, 0.0])
    """
    target = path_of(path)
    if unchanged is not None and _is_same_format(path_of(unchanged), target):
        return frame
    intensity = frame.intensity
    if intensity is None and scan_suffix(target) in _WITH_INTENSITY:
        intensity = np.zeros(frame.num_points, np.float32)
    suffix = scan_suffix(target)
    exact = None if keeps_float32_only(frame, suffix) else frame.exact
    stored = frame.replace(intensity=intensity, exact=exact)
    # Frames that were made in memory state no position, and nobody expects it in the file.
    for loss in position_losses(frame, suffix) if frame.format is not None else ():
        warnings.warn(loss, stacklevel=caller_level())
    if frame.format is not None and (names := names_left_out(frame, suffix)):
        warnings.warn(
            f"{', '.join(names)} left out, which {suffix} does not hold",
            stacklevel=caller_level(),
        )
    if (sides := lost_grid(frame, suffix)) is not None:
        warnings.warn(
            f"the cloud's grid of {sides[1]} x {sides[0]} pixels is not kept in {suffix}: write "
            ".pcd to keep it",
            stacklevel=caller_level(),
        )
    elif grid_of(frame) is not None:
        return stored
    return stored.replace(num_dropped=0, file_rows=None)


def _is_same_format(one: Path, other: Path) -> bool:
    def packed(path: Path) -> str:
        return path.suffix if path.suffix in _COMPRESSED else ""

    return scan_suffix(one) == scan_suffix(other) and packed(one) == packed(other)


@checked
def write_watermarked(
    sent: Watermarked,
    path: str | os.PathLike[str],
    *,
    unchanged: str | os.PathLike[str] | None = None,
    picture: str | os.PathLike[str] | None = None,
) -> None:
    """Write a watermarked scan, and beside it the record or the picture that carries it.

    Either both files replace existing ones, or neither does. If the process is killed in between,
    the old or the new scan remains without a record, which is ``undecidable``; a scan never remains
    beside the record of the other.

    Parameters
    ----------
    sent : Watermarked
        Scan with its record.
    path : path
        Path of the scan; its suffix determines the format.
    unchanged : path, optional
        File from which the scan was read. If the watermark is detached and the format is the same,
        this file is copied byte for byte.
    picture : path, optional
        Path of the picture that carries the record (.png); default: ``SCAN.png``. Only allowed for
        a watermark with a picture.

    Raises
    ------
    InputError, FormatError, OSError
        As `manip3d.io.write_scan`; or the file does not preserve the points: it is read and
        compared before it gets its name (see `as_stored`).

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, io
    >>> from manip3d.authenticate import KeyFile, Watermarker, read_record, write_watermarked
    >>> points = np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8
    >>> scan = LidarFrame(points, intensity=np.zeros(3000, np.float32))
    >>> marker = Watermarker(KeyFile.create("sensor.key"))
    >>> write_watermarked(marker.embed(scan), "scan.bin")
    >>> marker.verify(io.read_scan("scan.bin"), read_record("scan.bin.wm")).verdict
    'authentic'
    """
    target = path_of(path)
    source = None if unchanged is None else path_of(unchanged)
    shown = picture_path(target) if picture is None else path_of(picture)
    if picture is not None and sent.picture is None:
        raise InputError("picture: expected none for a watermark whose record no picture carries")
    check_keeps_signed(sent.frame, source, target, is_detached=sent.is_detached)
    companion = record_path(target) if sent.picture is None else shown
    told = sent.record if sent.picture is None else carrier_bytes(sent.picture)
    for file in (target, companion):
        file.parent.mkdir(parents=True, exist_ok=True)
    with atomic_pair(target, companion) as (temporary, beside):
        if source is not None and sent.is_detached and _is_same_format(source, target):
            shutil.copyfile(source, temporary)
        else:
            write_scan(sent.frame, temporary)
        _check_reads_back(read_scan(temporary), sent, target)
        beside.write_bytes(told)


def check_keeps_signed(
    frame: LidarFrame, source: Path | None, target: Path, *, is_detached: bool
) -> None:
    """Refuse a format of ``target`` that rounds the coordinates that a watermark signs.

    A detached watermark signs a copy of ``source`` if that has the same format. Other watermarks
    sign float64 coordinates as steps, which formats such as LAS keep.
    """
    copies = source is not None and is_detached and _is_same_format(source, target)
    if not copies and (is_detached or frame.exact is None):
        check_holds_float32(target)


def _check_reads_back(read: LidarFrame, sent: Watermarked, target: Path) -> None:
    """Raise InputError if the scan that was read from a file does not match its record."""
    frame = sent.frame
    if not _are_same(read.exact, frame.exact):
        remedy = "write the format that they were read from"
        if not sent.is_detached:
            remedy += (
                ", with steps as fine as the watermark's (those of LAS files are often 10 mm), or "
                "use a detached watermark, which moves no point"
            )
        raise InputError(
            f"{target}: the file does not keep the coordinates that were signed; {remedy}"
        )
    is_float32 = frame.exact is None
    pairs = {
        "coordinates": not is_float32 or np.array_equal(read.points, frame.points),
        "intensities": _are_equal(read.intensity, frame.intensity),
        "number of points without coordinates": read.num_dropped == frame.num_dropped,
    }
    for name, is_kept in pairs.items():
        if not is_kept:
            raise InputError(
                f"{target}: the format does not give the {name} back that were signed; sign the "
                "scan that manip3d.authenticate.as_stored returns"
            )


def _are_equal(read: NDArray[np.float32] | None, sent: NDArray[np.float32] | None) -> bool:
    if read is None or sent is None:
        return read is sent
    return np.array_equal(read, sent)


def _are_same(read: NDArray[np.float64] | None, written: NDArray[np.float64] | None) -> bool:
    if read is None or written is None:
        return read is written
    return read.shape == written.shape and bool((np.abs(read - written) <= _SAME_M).all())


@checked
def drive_scans(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the scans of a KITTI drive in order, without hidden files.

    Parameters
    ----------
    folder : path
        Folder of the drive.

    Returns
    -------
    list of Path
        Paths of the scans, sorted by the numbers in their names: 2.bin is before 10.bin.

    Raises
    ------
    InputError
        The folder has neither ``velodyne_points/data`` nor ``velodyne``, or no scans.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate import drive_scans
    >>> folder = Path("drive", "velodyne")
    >>> folder.mkdir(parents=True)
    >>> for name in ("000004.bin", "000005.bin.wm"):
    ...     _ = (folder / name).write_bytes(bytes(16))
    >>> [path.name for path in drive_scans("drive")]
    ['000004.bin']
    """
    place = _scan_folder(folder)
    return list(scan_paths(place)) or _refuse_none(folder, place, "cannot carry a watermark")


def all_drive_scans(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the scans of a KITTI drive that a verifier must look at.

    These are all scans of `drive_scans`, hidden ones, which some programs read, too, and files in
    any other format beside which there is a record.

    Raises
    ------
    InputError
        As `drive_scans`.
    """
    place = _scan_folder(folder)
    scans = {*scan_paths(place, hidden=True), *_scans_with_records(place)}
    return in_order(scans) or _refuse_none(folder, place, "count only with a record beside them")


def scans_to_watch(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the scans of `scans_to_read`, and files in any format beside which there is a record.

    Raises
    ------
    InputError
        As `drive_scans`.
    """
    signed = [path for path in _scans_with_records(_scan_folder(folder)) if _is_shown(path)]
    return in_order({*scans_to_read(folder), *signed})


def _scans_with_records(place: Path) -> list[Path]:
    records = place.glob(f"*{RECORD_SUFFIX}")
    return [scan for record in records for scan in scans_of_record(record)]


def _is_shown(path: Path) -> bool:
    return not is_hidden(path.name)


def _refuse_none(folder: str | os.PathLike[str], place: Path, why_not: str) -> NoReturn:
    advice = ""
    for exported in readable_scans(place)[:1]:
        advice = (
            f"; text files and arrays such as {exported.name} {why_not}; 'manip3d convert' writes "
            "them as .bin, .pcd or .ply, which can be signed"
        )
    raise InputError(f"{os.fspath(folder)}: expected scans, found none{advice}")


@checked
def drive_records_alone(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the records of a drive whose scans are missing, in order.

    Parameters
    ----------
    folder : path
        Folder of the drive.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        The folder has neither ``velodyne_points/data`` nor ``velodyne``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate._watermark_files import drive_records_alone
    >>> folder = Path("drive", "velodyne")
    >>> folder.mkdir(parents=True)
    >>> for name in ("000004.bin", "000005.bin.wm"):
    ...     _ = (folder / name).write_bytes(bytes(16))
    >>> [path.name for path in drive_records_alone("drive")]
    ['000005.bin.wm']
    """
    records = _scan_folder(folder).glob(f"*{RECORD_SUFFIX}")
    return in_order(path for path in records if not scans_of_record(path))


def scans_to_read(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the scans of a drive, or files in other formats that programs converted them to.

    KITTI publishes its unsynchronised drives as text, and users export clouds as ``.csv`` and
    ``.npy``. Watermarks are only embedded in the scans of `drive_scans`.

    Raises
    ------
    InputError
        As `drive_scans`.
    """
    return readable_scans(_scan_folder(folder)) or drive_scans(folder)


@checked
def drive_numbers(folder: str | os.PathLike[str]) -> list[int]:
    """Return a number for each scan of a drive; numbers of consecutive turns differ by one.

    `inspect_drive` only compares scans whose numbers differ by one. In a sequence (KITTI's raw
    drives, and its odometry sequences with ``times.txt``) the numbers are those in the file names.
    Elsewhere (KITTI's object and stereo benchmarks) each scan shows another place, and the numbers
    are 0, 2, 4, ..., as in a drive in which the name of a file is no number. If the drive has times
    (``timestamps.txt`` beside the scans, or ``times.txt``), a gap of more than 0.15 s, 1.5 turns at
    10 Hz, also makes a gap in the numbers, whatever the file names are, because somebody may have
    kept every second scan and renamed the files. The time of a line that cannot be read is unknown,
    and a warning names the line.

    Parameters
    ----------
    folder : path
        Folder of the drive.

    Returns
    -------
    list of int
        One number for each scan, in the order of `drive_scans`; in a drive without such scans, for
        each text file or array (``.csv``, ``.npy``, ...) that holds points.

    Raises
    ------
    InputError
        The folder has neither ``velodyne_points/data`` nor ``velodyne``, or no scans.
    FormatError, OSError
        The file of times cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate import drive_numbers
    >>> folder = Path("drive", "velodyne")
    >>> folder.mkdir(parents=True)
    >>> for name in ("000004.bin", "000005.bin"):
    ...     _ = (folder / name).write_bytes(bytes(16))
    >>> drive_numbers("drive")
    [0, 2]
    >>> Path("drive", "times.txt").touch()
    >>> drive_numbers("drive")
    [4, 5]
    """
    root, scans = path_of(folder), scans_to_read(folder)
    names = [scan_stem(path) for path in scans]
    is_sequence = (root / "velodyne_points").is_dir() or (root / "times.txt").is_file()
    if not is_sequence or not all(name.isdecimal() for name in names):
        return [2 * number for number in range(len(scans))]
    numbers = [int(name) for name in names]
    gaps = np.zeros(len(numbers), np.int64)  # gaps just before each scan
    last = 0  # the last scan of known time
    last_ns: int | None = None
    for k, time_ns in enumerate(_times_of(root, numbers)):
        if time_ns is None:
            continue
        most_ns = MAX_APART_NS + _TURN_NS * (k - last - 1)
        if last_ns is not None and abs(time_ns - last_ns) > most_ns:
            gaps[last + 1 : k + 1] = 1  # between scans of unknown time it may be anywhere
        last, last_ns = k, time_ns
    return [n + gap for n, gap in zip(numbers, np.cumsum(gaps).tolist(), strict=True)]


def _times_of(drive: Path, numbers: Sequence[int]) -> list[int | None]:
    """Time of each scan, nanoseconds; None if it is unknown."""
    times = drive_times(drive)
    if all(number in times for number in numbers):
        return [times[number] for number in numbers]
    return list(times.values()) if len(times) == len(numbers) else [None] * len(numbers)


@checked
def plain_name(scan: str | os.PathLike[str], drive: str | os.PathLike[str]) -> Path:
    """Return the path of a scan relative to its drive, without the suffix of a compression.

    Parameters
    ----------
    scan : path
        A scan of the drive.
    drive : path
        Folder of the drive.

    Returns
    -------
    Path
        Path relative to the drive.

    Raises
    ------
    InputError
        An argument is not a path.
    ValueError
        The scan is not in the drive.

    Examples
    --------
    >>> from manip3d.authenticate._watermark_files import plain_name
    >>> plain_name("drive/velodyne/000000.bin.xz", "drive").as_posix()
    'velodyne/000000.bin'
    """
    relative = path_of(scan).relative_to(path_of(drive))
    name = relative.name
    for suffix in _COMPRESSED:
        name = name.removesuffix(suffix)
    return relative.with_name(name)


@checked
def copy_rest_of_drive(
    drive: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    written: Collection[Path] = (),
) -> list[Path]:
    """Copy all files of a drive except scans and their records, byte for byte.

    These are pictures, positions, times, labels and calibrations, also the calibration of the day
    that KITTI stores beside its raw drives, if the drive holds none of its own. Without them a
    signed drive would have no speeds and no cameras.

    Parameters
    ----------
    drive, output : path
        Folders of the drive and of its copy. ``output`` may lie in the drive; its files are
        replaced.
    written : collection of Path
        Files of ``output`` that must not be replaced, such as pictures that carry records.

    Returns
    -------
    list of Path
        Paths of the copies.

    Raises
    ------
    InputError
        The drive has neither ``velodyne_points/data`` nor ``velodyne``.
    OSError
        A file cannot be read or written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate._watermark_files import copy_rest_of_drive
    >>> for name in ("velodyne/000000.bin", "calib.txt"):
    ...     Path("drive", name).parent.mkdir(parents=True, exist_ok=True)
    ...     _ = Path("drive", name).write_bytes(bytes(16))
    >>> [path.as_posix() for path in copy_rest_of_drive("drive", "signed")]
    ['signed/calib.txt']
    """
    source, target = path_of(drive), path_of(output)
    copies = {file: file.relative_to(source) for file in _rest_of_drive(source, target)}
    if not any((source / name).exists() for name in (_CALIBRATIONS[0], "calib.txt", "calib")):
        day = source.resolve().parent
        copies |= {day / name: Path(name) for name in _CALIBRATIONS if (day / name).is_file()}
    done = [(file, target / name) for file, name in copies.items() if target / name not in written]
    for file, copy in done:
        copy.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(copy) as temporary:
            shutil.copyfile(file, temporary)
    return [copy for _, copy in done]


def _rest_of_drive(drive: Path, output: Path) -> list[Path]:
    """Regular files of a drive that are neither scans nor records, and not in the output folder."""
    scans, left_out = _scan_folder(drive).resolve(), output.resolve()
    found: list[Path] = []
    for top, folders, names in os.walk(drive, followlinks=True):
        here = Path(top)
        above = [here, *(p for p in here.parents if p.is_relative_to(drive))]
        # symbolic links may form cycles
        closed = {left_out, *(folder.resolve() for folder in above)}
        folders[:] = sorted(name for name in folders if (here / name).resolve() not in closed)
        is_signed = here.resolve() == scans
        found += [
            here / name
            for name in sorted(names)
            if (here / name).is_file() and not (is_signed and _is_scan_or_record(Path(name)))
        ]
    return found


def _is_scan_or_record(path: Path) -> bool:
    return path.suffix == RECORD_SUFFIX or scan_suffix(path) in FOLDER_SUFFIXES


def _scan_folder(folder: str | os.PathLike[str]) -> Path:
    for each in _FOLDERS:
        found = path_of(folder) / each
        if found.is_dir():
            return found
    raise InputError(
        f"{os.fspath(folder)}: expected a folder with velodyne_points/data or velodyne"
    )


@checked
def verdict_of_stream(
    results: Sequence[WatermarkResult], *, whole: bool = True
) -> tuple[WatermarkVerdict, str]:
    """Return the verdict on several frames, and its reason.

    Parameters
    ----------
    results : sequence of WatermarkResult
        Results in the order of the stream.
    whole : bool
        Require one complete session, from its first frame to the frame that is marked as its last.

    Returns
    -------
    (verdict, reason)
        ``tampered`` if a frame is, or if frames of another session lie between frames of one; else
        ``undecidable`` if a frame is, or, with ``whole``, if the frames are of several sessions
        (frames between these may be missing) or the beginning or the end is missing; else
        ``authentic``.

    Raises
    ------
    InputError
        ``results`` is empty, or holds an item of another type.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import KeyFile, Watermarker, verdict_of_stream
    >>> scan = np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8
    >>> marker = Watermarker(KeyFile.create("sensor.key"))
    >>> sent = marker.embed(scan)
    >>> results = [marker.verify(sent.frame, sent.record)]
    >>> verdict_of_stream(results, whole=False)
    ('authentic', 'every point is the one that was signed')
    >>> verdict_of_stream(results)[0]  # the last frame is not marked as the end
    'undecidable'
    """
    if len(results) == 0:
        raise InputError("results: expected at least one, got none")
    tally = StreamTally()
    for result in results:
        tally.add(result)
    return tally.verdict(whole=whole)


class StreamTally:
    """Verdict of a stream so far, in memory that grows with the number of sessions only."""

    def __init__(self) -> None:
        self._count = 0
        self._loud: dict[str, tuple[str, int]] = {}  # by verdict: first reason, number of frames
        self._sessions: set[str] = set()
        self._left: dict[str, int] = {}  # by session: number of frames until the stream left it
        self._session = ""  # of the last frame
        self._place = 0  # number of frames so far, with those that have no result
        self._last_known = 0  # place of the last frame whose session is known
        self._first: int | None = None  # number of the first frame
        self._ends = False
        self._reason = ""
        self._foreign: tuple[int, int] | None = None  # first and last of the frames put in between

    def add(self, result: WatermarkResult) -> None:
        """Add the result of the next frame."""
        if not self._count:
            self._first = result.number
        self._place += 1
        self._find_foreign(result)
        self._count += 1
        self._sessions.add(result.session)
        self._ends, self._reason = result.is_end, result.reason
        if result.verdict != "authentic":
            first, frames = self._loud.get(result.verdict, (result.reason, 0))
            self._loud[result.verdict] = first, frames + 1

    def skip(self) -> None:
        """Count a frame without a result."""
        self._place += 1

    def _find_foreign(self, result: WatermarkResult) -> None:
        """Notice a session that continues after frames of another one."""
        if not result.session or result.order == "replay":
            return
        if result.session != self._session:
            if result.order == "gap" and result.session in self._left and self._foreign is None:
                self._foreign = self._left[result.session] + 1, self._last_known
            self._left[self._session] = self._last_known
            self._session = result.session
        self._last_known = self._place

    @property
    def splice(self) -> str:
        """Names frames of another session between frames of one; empty: there are none."""
        if self._foreign is None:
            return ""
        first, last = self._foreign
        which = f"frame {first}" if first == last else f"frames {first} to {last}"
        verb = "is" if first == last else "are"
        return f"{which} (counted from 1) {verb} of another session than those before and after"

    def verdict(self, *, whole: bool = True) -> tuple[WatermarkVerdict, str]:
        """Return the verdict and its reason; see `verdict_of_stream`."""
        verdicts: tuple[WatermarkVerdict, ...] = ("tampered", "undecidable")
        for verdict in verdicts:
            if verdict == "undecidable" and self.splice:
                return "tampered", self.splice
            if verdict in self._loud:
                reason, frames = self._loud[verdict]
                one = f" ({frames} of {self._count} frames)" if self._count > 1 else ""
                return verdict, reason + one
        missing = self._missing_of_whole() if whole else ""
        if missing:
            return "undecidable", f"every frame holds, but {missing}"
        return "authentic", self._reason if self._count == 1 else (
            f"every point of {self._count} frames is the one that was signed"
        )

    def _missing_of_whole(self) -> str:
        """Reason why authentic frames are not one complete session; empty: they are.

        A verifier accepts the first frame of any session after the end of another one, so that
        several sessions look like a chain in any order, and if some are missing.
        """
        if len(self._sessions) > 1:
            return (
                f"they are of {len(self._sessions)} sessions, and none says which belong together, "
                "or how many"
            )
        if self._first != 0:
            return "the frames at the beginning are missing"
        return "" if self._ends else "the frames at the end are missing"
