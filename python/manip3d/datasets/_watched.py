"""Drives in KITTI's layout, prepared for `manip3d.authenticate.watch_drive`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from manip3d._util.checked import checked
from manip3d._util.extras import load, why_blind
from manip3d._util.paths import path_of
from manip3d._util.times import SECOND_NS
from manip3d.authenticate import (
    RIGS_FILE,
    DriveMoment,
    StereoRig,
    WatchedDrive,
    find_record,
    read_carrier,
    read_record,
    read_rigs,
)
from manip3d.authenticate._stereo import checked_pair
from manip3d.authenticate._watermark_files import scans_to_read, scans_to_watch
from manip3d.datasets.kitti import KittiFrame, open_kitti
from manip3d.errors import BrokenExtraError, FormatError, InputError, MissingExtraError
from manip3d.io._scan_tables import scan_stem

_FRONT_PAIRS = ((2, 3), (0, 1))
"""Camera numbers of KITTI's colour pair and of its grey pair."""


class _Wanted(NamedTuple):
    """Selection of the files that are read for each frame in addition to its scan."""

    records: bool
    carriers: Path | None
    front: tuple[int, int] | None
    has_rig: bool
    size: tuple[int, int] | None
    """Width and height of the pictures for which the calibration is valid; None: not stated."""
    around: Mapping[str, tuple[int, int]]
    note: Callable[[str], object] | None
    blind: str
    """Why no pictures can be compared on this computer; empty: they can."""


@checked
def watched_kitti(
    folder: str | os.PathLike[str],
    *,
    calibration: str | os.PathLike[str] | None = None,
    rigs: str | os.PathLike[str] | None = None,
    records: bool = False,
    carriers: str | os.PathLike[str] | None = None,
    frames: int | None = None,
    note: Callable[[str], object] | None = None,
) -> WatchedDrive:
    """Open a drive in KITTI's layout with its cameras and the records of its watermark.

    Parameters
    ----------
    folder : path
        Folder of the drive, see `open_kitti`. If it has no scans, its text files and arrays with
        points are scans. With records beside the scans, so are files in any format that have one.
    calibration : path, optional
        See `open_kitti`.
    rigs : path, optional
        File with stereo pairs, as `manip3d.authenticate.write_rigs` writes it; default:
        ``rigs.json`` in the folder, else KITTI's colour pair, else its grey pair.
    records : bool
        Read the watermark's record of each scan.
    carriers : path, optional
        Folder of the pictures that carry the records; if it is given, records are read from these.
        Default: the records are files beside the scans.
    frames : int, optional
        Largest number of frames to read; default: all.
    note : callable, optional
        Called with a sentence for each frame whose velocity cannot be read.

    Returns
    -------
    manip3d.authenticate.WatchedDrive
        The drive. If a part of a frame cannot be read, only its own moment lacks that part, and
        states the reason. Without the extra ``alert``, or if it cannot be imported, no pictures are
        read.

    Raises
    ------
    InputError
        There are no scans; ``carriers`` is not a folder; ``frames`` is below 1.
    FormatError, OSError
        The calibration or the file of rigs cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from manip3d import LidarFrame, datasets, io
    >>> Path("drive/velodyne").mkdir(parents=True)
    >>> io.write_scan(LidarFrame(np.ones((5, 3), np.float32)), "drive/velodyne/000000.bin")
    >>> [moment.frame.num_points for moment in datasets.watched_kitti("drive").moments]
    [5]
    """
    if frames is not None and frames < 1:
        raise InputError(f"frames: expected at least 1, got {frames}")
    pictures = None if carriers is None else path_of(carriers, "carriers")
    if pictures is not None and not pictures.is_dir():
        raise InputError(f"carriers: expected a folder, got {pictures}")
    source = path_of(folder, "folder")
    drive = open_kitti(source, calibration=calibration)
    drive = drive.with_scans(
        scans_to_watch(source) if records and pictures is None else scans_to_read(source)
    )
    chosen = drive[: len(drive) if frames is None else frames]
    beside = source / RIGS_FILE
    path = rigs if rigs is not None or not beside.is_file() else beside
    around = {} if path is None else read_rigs(path)
    front = None if around else _front_pair(chosen)
    cameras: StereoRig | Mapping[str, StereoRig] | None
    cameras = {name: each.rig for name, each in around.items()} or None
    size = None
    if front is not None and drive.calibration_path is not None:
        known = chosen[0].calibration()
        cameras = StereoRig.from_calibration(known, left=front[0], right=front[1])
        size = known.sizes.get(front[0])
    wanted = _Wanted(
        records or pictures is not None,
        pictures,
        front,
        cameras is not None,
        size,
        {name: (left, right) for name, (_, left, right) in around.items()},
        note,
        _why_none_is_compared() if front is not None or around else "",
    )
    return WatchedDrive(cameras, (_moment(frame, wanted) for frame in chosen), len(chosen))


def _why_none_is_compared() -> str:
    """Return why no pictures can be compared on this computer; empty: they can."""
    try:
        load("alert")
    except (MissingExtraError, BrokenExtraError) as error:
        return why_blind(error)
    return ""


def _front_pair(frames: Sequence[KittiFrame]) -> tuple[int, int] | None:
    """Return the first of KITTI's pairs for which some frame has pictures, or None."""
    return next((p for p in _FRONT_PAIRS for frame in frames if set(p) <= set(frame.images)), None)


def _moment(frame: KittiFrame, wanted: _Wanted) -> DriveMoment:
    """Return a frame with the content of its files, and the reasons why some cannot be read."""
    pairs_wanted = filter(None, (wanted.front, *wanted.around.values()))
    if wanted.blind and any(set(pair) <= set(frame.images) for pair in pairs_wanted):
        blindfold = wanted._replace(front=None, around={}, blind="")
        return _moment(frame, blindfold)._replace(blind=wanted.blind)
    unread: dict[str, str] = {}
    record, carrier, why = None, None, ""
    if wanted.records:
        (record, carrier), why = _or_why((None, None), partial(_record_of, frame, wanted.carriers))
    if why:
        unread["watermark"] = why
    pictures, why = None, ""
    if wanted.front is not None:
        pictures, why = _or_why(None, partial(_front_pictures, frame, wanted))
    seen = {
        name: _or_why(None, partial(_pair_of, frame, each)) for name, each in wanted.around.items()
    }
    reasons = [why, *(f"{name}: {why}" for name, (_, why) in seen.items() if why)]
    if any(reasons):
        unread["cross-modal"] = "; ".join(filter(None, reasons))
    pairs = {name: both for name, (both, _) in seen.items() if both is not None}
    velocity, why = _or_why(None, frame.velocity)
    if why and wanted.note is not None:
        wanted.note(f"frame {frame.name} has no speed of its own: {why}")
    # Labels are no evidence, and do not fit a scan that lost or gained points.
    scan, why = _or_why(None, partial(frame.scan, labels=False))
    time_s = None if frame.time_ns is None else frame.time_ns / SECOND_NS
    return DriveMoment(
        why if scan is None else scan,
        pictures,
        record,
        velocity,
        time_s,
        pairs or None,
        carrier,
        unread,
        frame.name,
    )


def _front_pictures(frame: KittiFrame, wanted: _Wanted) -> tuple[Any, Any] | None:
    """Read the pictures of the front pair, and check that they have the calibration's size."""
    if wanted.front is None:
        return None
    if not wanted.has_rig:
        raise FormatError("the cameras have no calibration, which KITTI keeps beside its drives")
    pictures = frame.pictures(*wanted.front)
    if pictures is not None and wanted.size is not None:
        height, width = pictures[0].shape[:2]
        if (width, height) != wanted.size:
            raise FormatError(
                f"expected {wanted.size[0]} x {wanted.size[1]} pixels, as the calibration says, "
                f"got {width} x {height}",
                file=str(frame.images[wanted.front[0]]),
            )
    return pictures


def _pair_of(frame: KittiFrame, cameras: tuple[int, int]) -> tuple[Any, Any] | None:
    """Read the pictures of one of several pairs; check them here, so that an invalid pair does not
    invalidate the others."""
    pictures = frame.pictures(*cameras)
    if pictures is not None:
        try:
            checked_pair(*pictures)
        except InputError as error:
            raise FormatError(str(error)) from error
    return pictures


def _or_why(otherwise: Any, read: Callable[[], Any]) -> tuple[Any, str]:
    """Return the result of ``read`` and '', or ``otherwise`` and the reason why it failed."""
    try:
        return read(), ""
    except (FormatError, OSError) as error:
        return otherwise, f"unreadable: {error}"


def _record_of(frame: KittiFrame, carriers: Path | None) -> tuple[bytes | None, Any]:
    """Return the record beside a scan, or else the picture that carries it; one is None."""
    if carriers is None:
        return read_record(find_record(frame.scan_path)), None
    seen = carriers / f"{scan_stem(frame.scan_path)}.png"
    return None, read_carrier(seen) if seen.is_file() else None
