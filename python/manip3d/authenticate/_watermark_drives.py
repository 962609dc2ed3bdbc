"""Embed and verify watermarks of a scan's file, or of all scans of a drive as one chain."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.locks import new_folder_locked
from manip3d._util.options import reporting
from manip3d._util.paths import in_order, path_of, refuse_existing, visible
from manip3d.authenticate._picture_files import picture_path, read_carrier
from manip3d.authenticate._picture_records import record_of_picture
from manip3d.authenticate._verdict import verdict_repr
from manip3d.authenticate._watermark import (
    Policy,
    Watermarker,
    WatermarkResult,
    WatermarkVerdict,
    of_file,
)
from manip3d.authenticate._watermark_files import (
    RECORD_SUFFIX,
    all_drive_scans,
    as_stored,
    check_keeps_signed,
    copy_rest_of_drive,
    drive_records_alone,
    drive_scans,
    find_record,
    plain_name,
    read_record,
    record_path,
    refuse_existing_record,
    scan_of_record,
    verdict_of_stream,
    write_watermarked,
)
from manip3d.errors import FormatError, InputError
from manip3d.io import read_scan
from manip3d.io._frame_times import scan_times
from manip3d.io._scan_files import FOLDER_SUFFIXES
from manip3d.io._scan_tables import scan_stem, scan_suffix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress
    from manip3d.lidar import LidarFrame


@dataclass(frozen=True, slots=True)
class EmbeddedScan:
    """A scan that `embed_files` wrote.

    Attributes
    ----------
    path : Path
        Path of the file.
    number : int
        Number of the frame in its session.
    num_points, num_tiles : int
        Number of points, and of tiles that are signed separately.
    has_time : bool
        Whether the drive states the time of the scan; otherwise the record has the time of the
        clock.
    was_there : bool
        Whether an earlier, interrupted run wrote the file.
    """

    path: Path
    number: int
    num_points: int
    num_tiles: int
    has_time: bool
    was_there: bool = False


@dataclass(frozen=True, slots=True)
class VerifiedFiles:
    """Result of `verify_files`.

    Attributes
    ----------
    verdict : 'authentic', 'tampered' or 'undecidable'
        Verdict of the scan, or of the drive as one chain.
    reason : str
        Reason of the verdict in words.
    frames : sequence of (str, WatermarkResult)
        Name and result of each scan, in order, without the points.
    """

    verdict: WatermarkVerdict
    reason: str
    frames: Sequence[tuple[str, WatermarkResult]]

    __repr__ = verdict_repr

    def record(self, *, operator: bool = False) -> dict[str, Any]:
        """Return the result as JSON values.

        Parameters
        ----------
        operator : bool
            Include data that only the owner of the scans may see, such as changed points.

        Returns
        -------
        dict
        """
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "num_frames": len(self.frames),
            "verdicts": dict(Counter(found.verdict for _, found in self.frames)),
            "frames": [
                {"scan": name} | found.record(operator=operator) for name, found in self.frames
            ],
        }


@checked
def drive_pictures(drive: str | os.PathLike[str], name: str) -> Path:
    """Return the folder with the pictures of one camera of a drive.

    Parameters
    ----------
    drive : path
        Folder of the drive.
    name : str
        Folder of the camera relative to the drive, such as ``image_02``; it must lie in the drive.

    Returns
    -------
    Path
        ``DRIVE/NAME/data`` if there is such a folder, as in KITTI's raw drives, else
        ``DRIVE/NAME``.

    Raises
    ------
    InputError
        The drive has no such folder.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d.authenticate import drive_pictures
    >>> Path("drive", "image_02", "data").mkdir(parents=True)
    >>> drive_pictures("drive", "image_02").as_posix()
    'drive/image_02/data'
    """
    root = path_of(drive)
    folder = root / name
    if Path(name).is_absolute() or ".." in Path(name).parts or not folder.is_dir():
        raise InputError(f"picture: expected a folder of pictures in {root}, got {name}")
    return folder / "data" if (folder / "data").is_dir() else folder


@checked
def embed_files(
    marker: Watermarker,
    source: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    picture: str = "",
    scans_only: bool = False,
    replace: bool = False,
    again: bool = False,
    progress: Progress = None,
) -> list[EmbeddedScan]:
    """Embed a watermark into a scan's file, or into all scans of a drive as one chain.

    The record of each scan is written beside it (`record_path`), or into a picture. Other files of
    a drive are copied. The session ends with the last scan, which is written after all other files.
    If ``output`` has an unfinished session of this drive and key, because a run was interrupted or
    the disk was full, the session continues after the existing scans.

    Parameters
    ----------
    marker : Watermarker
        Watermarker with a key and an embedding, which has embedded no frame.
    source : path
        Path of a scan, or folder of a KITTI drive.
    output : path
        Path of the new scan, or folder of the new drive.
    picture : str
        Picture (.png) that carries the record, written as ``SCAN.png``; for a drive the folder of
        its pictures, such as ``image_02``. Empty: records are files beside the scans.
    scans_only : bool
        Do not copy other files of a drive.
    replace : bool
        Replace existing files. Scans and records of an earlier drive are removed from the folders
        of scans, where they would be frames of this chain.
    again : bool
        Also embed if a scan of ``source`` has a record, beside it or in its picture, as for another
        key. Points that the earlier watermark moved are moved again, and the earlier record does
        not verify the result.
    progress : callable or bool, optional
        Function that is called with the share that is done and a message; True shows a bar.

    Returns
    -------
    list of EmbeddedScan

    Raises
    ------
    InputError
        ``marker`` has embedded a frame; ``output`` exists and is no unfinished session of this
        drive, or with ``replace`` holds a scan without a watermark, or by a link the files of
        ``source``; another program is writing there; the folder has no scans, or two that would be
        written to the same file; ``picture`` is no folder of the drive; a scan is signed already;
        the format does not preserve coordinates (`write_watermarked`); or as `Watermarker.embed`.
    FormatError, OSError
        A file cannot be read or written. A note of the error states how many scans were written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from manip3d import LidarFrame, io
    >>> from manip3d.authenticate import KeyFile, Watermarker, embed_files, verify_files
    >>> points = np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8
    >>> for number in range(2):
    ...     Path("drive/velodyne").mkdir(parents=True, exist_ok=True)
    ...     io.write_scan(LidarFrame(points + number), f"drive/velodyne/{number:06}.bin")
    >>> key = KeyFile.create("sensor.key")
    >>> [scan.path.name for scan in embed_files(Watermarker(key), "drive", "signed")]
    ['000000.bin', '000001.bin']
    >>> verify_files(Watermarker(key), "signed").verdict
    'authentic'
    """
    begin, target = path_of(source), path_of(output)
    if marker.session:
        raise InputError(
            "marker: expected one that has embedded no frame, since the scans are a session of "
            "their own; a new Watermarker also goes on after an interrupted run"
        )
    if not begin.is_dir():
        begin.stat()  # a missing source is an OSError that names it
        _check_scan(target, picture, replace=replace)
        seen = Path(picture) if picture else None
        if not again:
            _refuse_signed({begin: seen})
        return [_embed(marker, begin, target, seen, None, time_ns=None, is_end=True)]
    _check_folder(begin, target)
    folder = drive_pictures(begin, picture) if picture else None
    works = _works_of(begin, target, folder)
    if not again:
        _refuse_signed({work.scan: work.picture for work in works})
    with new_folder_locked(target) as is_ours:
        if not is_ours:
            raise InputError(f"output: another program is writing to {target}")
        return _embed_drive(
            marker,
            begin,
            target,
            works,
            scans_only=scans_only,
            replace=replace,
            progress=progress,
        )


def _embed_drive(
    marker: Watermarker,
    begin: Path,
    target: Path,
    works: Sequence[_Work],
    *,
    scans_only: bool,
    replace: bool,
    progress: Progress,
) -> list[EmbeddedScan]:
    """Write all scans of a drive, or those that an earlier run has not written."""
    done = [] if replace else _go_on(marker, works)
    if not (replace or done) and _holds_files(target):
        raise InputError(f"output: {target} exists already; replace=True replaces its scans")
    _refuse_unsigned(target, works, len(done), marker.units_per_m)
    pictures = {work.shown for work in works if work.shown is not None}
    with reporting(progress, "embed") as report, _noting_what_is_done(target, works, done):
        for number, work in enumerate(works[len(done) :], len(done) + 1):
            is_end = number == len(works)
            if is_end and not scans_only:  # an ended session must be a complete drive
                copy_rest_of_drive(begin, target, written=pictures)
            done.append(
                _embed(
                    marker,
                    work.scan,
                    work.target,
                    work.picture,
                    work.shown,
                    time_ns=work.time_ns,
                    is_end=is_end,
                )
            )
            if report is not None:
                report(number / len(works))
    kept = {scan.path for scan in done}
    _remove_others(kept if pictures else kept | {record_path(path) for path in kept})
    return done


@dataclass(frozen=True)
class _Work:
    """A scan of a drive to sign, its picture, and the paths to which both are written."""

    scan: Path
    target: Path
    picture: Path | None
    shown: Path | None
    time_ns: int | None


def _works_of(drive: Path, output: Path, pictures: Path | None) -> list[_Work]:
    scans = drive_scans(drive)
    times = scan_times(drive, scans, strict=True)  # a signed time must not be that of the clock
    works = []
    for scan in scans:
        picture = None if pictures is None else _picture_of(scan, pictures)
        shown = None if picture is None else output / picture.relative_to(drive)
        target = output / plain_name(scan, drive)
        works.append(_Work(scan, target, picture, shown, times.get(scan)))
    _refuse_shared(works)
    _refuse_originals(works)
    return works


def _refuse_shared(works: Sequence[_Work]) -> None:
    """Raise InputError if two scans, or their pictures, would be written to the same file."""
    scans: dict[Path, Path] = {}
    for work in works:
        for file in (work.target, work.shown):
            if file is not None and (other := scans.setdefault(file, work.scan)) != work.scan:
                raise InputError(
                    f"{other} and {work.scan}: expected an output for each, got {file} for both"
                )


def _refuse_originals(works: Sequence[_Work]) -> None:
    """Raise InputError if a link of the output leads to a folder of the drive's own files."""
    originals = {
        file.resolve() for work in works for file in (work.scan, work.picture) if file is not None
    }
    folders = {file.parent for file in originals}
    for work in works:
        for file in (work.target, work.shown):
            if file is not None and (
                file.parent.resolve() in folders or file.resolve() in originals
            ):
                raise InputError(
                    f"output: expected another folder than the drive's, but {file} leads there by "
                    "a link"
                )


def _holds_files(folder: Path) -> bool:
    """Whether there is a file in a folder or below it, also behind links to folders."""
    return any(files for _, _, files in os.walk(folder, followlinks=True))


@contextmanager
def _noting_what_is_done(
    output: Path, works: Sequence[_Work], done: Sequence[EmbeddedScan]
) -> Iterator[None]:
    """Add a note to an error that states how many scans were written."""
    try:
        yield
    except BaseException as error:
        error.add_note(
            f"{output} has {len(done)} of {len(works)} scans, each whole"
            + ("; run again without replace=True, it goes on after them" if done else "")
        )
        raise


def _go_on(marker: Watermarker, works: Sequence[_Work]) -> list[EmbeddedScan]:
    """Resume the unfinished session of an earlier run; return its scans.

    The list is empty if the first scan is missing or was not made from this drive with this key and
    embedding, or if the session has ended.
    """
    done: list[EmbeddedScan] = []
    last: WatermarkResult | None = None
    policy = Policy(
        embeddings=(marker.embedding,),
        carriers=("sidecar" if works[0].shown is None else "picture",),
        order="chain",
    )
    with marker.own_verifier() as verifier:
        for work in works:
            found = _found_at(verifier, work, policy)
            if found is None or found.number != len(done):
                break
            number, tiles, has_time = found.number, len(found.tiles), work.time_ns is not None
            points = 0 if found.scan is None else found.scan.num_points
            done.append(EmbeddedScan(work.target, number, points, tiles, has_time, was_there=True))
            last = found
    if last is None or last.is_end:
        return []
    work = works[len(done) - 1]
    try:
        if work.shown is None:
            marker.resume(read_record(find_record(work.target)) or b"")
        else:
            marker.resume(record_of_picture(read_carrier(work.shown)))
    except (FormatError, InputError):  # the record is of another sensor or grid
        return []
    return done


def _found_at(verifier: Watermarker, work: _Work, policy: Policy) -> WatermarkResult | None:
    """The result for an existing file, if it is authentic and was made from the scan; else None."""
    if not work.target.is_file():
        return None
    record = find_record(work.target)
    try:
        found = _verified(verifier, work.target, record, work.shown, policy, in_drive=True)
        source = read_scan(work.scan)
    except (FormatError, InputError, OSError):
        return None
    is_timed = work.time_ns is None or work.time_ns == found.time_ns
    is_same = found.scan is not None and _is_made_of(found.scan, source, found.units_per_m or 1000)
    return found if found.verdict == "authentic" and is_timed and is_same else None


def _is_made_of(marked: LidarFrame, source: LidarFrame, units_per_m: int) -> bool:
    """Whether intensities are the same, and points moved by rounding and embedding at most."""
    if marked.num_points != source.num_points:
        return False
    if not np.array_equal(_intensity_of(marked), _intensity_of(source), equal_nan=True):
        return False
    if marked.exact is not None and source.exact is not None:
        moves = np.abs(marked.exact - source.exact)
    else:
        moves = np.abs(marked.points - source.points)
    return bool((moves <= 3.0 / units_per_m).all())  # two steps, and rounding of float32


def _is_made_from(marked: Path, scan: Path, units_per_m: int) -> bool:
    """Whether a file holds the points of a scan, moved by rounding and embedding at most."""
    try:
        return _is_made_of(read_scan(marked), read_scan(scan), units_per_m)
    except (FormatError, InputError, OSError):
        return False


def _intensity_of(frame: LidarFrame) -> NDArray[np.float32]:
    """Intensities; 0 without any, as formats that always have them are written."""
    if frame.intensity is None:
        return np.zeros(frame.num_points, np.float32)
    return frame.intensity


def _embed(
    marker: Watermarker,
    scan: Path,
    target: Path,
    picture: Path | None,
    shown: Path | None,
    *,
    time_ns: int | None,
    is_end: bool,
) -> EmbeddedScan:
    frame = read_scan(scan)
    is_detached = marker.embedding == "detached" or not frame.num_points
    check_keeps_signed(frame, scan, target, is_detached=is_detached)  # before warnings of losses
    sent = marker.embed(
        as_stored(frame, target, unchanged=scan if marker.embedding == "detached" else None),
        time_ns=time_ns,
        is_end=is_end,
        picture=None if picture is None else read_carrier(picture),
    )
    write_watermarked(sent, target, unchanged=scan, picture=shown)
    return EmbeddedScan(target, sent.number, len(sent.points), sent.num_tiles, time_ns is not None)


def _refuse_signed(pictures: Mapping[Path, Path | None]) -> None:
    """Raise InputError for signed scans, with a record beside them or in a picture."""
    signed = [scan for scan, picture in pictures.items() if _record_of(scan, picture) is not None]
    if not signed:
        return
    others = f", and {len(signed) - 1} more" if len(signed) > 1 else ""
    raise InputError(
        f"{signed[0]}: is signed already ({_record_of(signed[0], pictures[signed[0]])}){others}; "
        "--again (again=True) signs it anew, and what was signed before is lost in the result"
    )


def _refuse_unsigned(target: Path, works: Sequence[_Work], num_done: int, units_per_m: int) -> None:
    """Raise InputError if a scan that would be lost is not signed, since it may be an original.

    A run that was killed may have left its last scan without the record. It is the first one after
    those of the session that goes on, or the first unsigned one if it was made of the same scan.
    """
    folders = {work.target.parent for work in works}
    files = [p for f in folders if f.is_dir() for p in sorted(f.iterdir()) if p.is_file()]
    next_one = {work.target for work in works[num_done : num_done + 1] if num_done}
    scans = [p for p in files if scan_suffix(p) in FOLDER_SUFFIXES and p not in next_one]
    bare = [scan for scan in scans if not find_record(scan).is_file()]
    if not bare:
        return
    carriers = _carrier_folders(target)
    unsigned = [
        scan
        for scan in bare
        if not any(_carries_record(_picture_of(scan, folder)) for folder in carriers)
    ]
    torn = next((work for work in works if work.target in unsigned), None)
    if torn is not None and _is_made_from(torn.target, torn.scan, units_per_m):
        unsigned.remove(torn.target)
    if unsigned:
        raise InputError(
            f"output: {target} holds scans that nobody signed, which would be lost, such as "
            f"{unsigned[0].name}; expected a new folder or a signed drive"
        )


def _carrier_folders(drive: Path) -> list[Path]:
    """Folders of a drive whose first picture carries a record."""
    firsts = {
        picture.parent: picture for picture in sorted(visible(drive.rglob("*.png")), reverse=True)
    }
    return [folder for folder, first in firsts.items() if _carries_record(first)]


def _record_of(scan: Path, picture: Path | None) -> Path | None:
    """The file that carries the record of a scan; None if there is none."""
    beside = find_record(scan)
    if beside.is_file():
        return beside
    return picture if picture is not None and _carries_record(picture) else None


def _carries_record(picture: Path) -> bool:
    try:
        return bool(record_of_picture(read_carrier(picture)))
    # no record, or no picture: reported later if it is needed
    except (FormatError, InputError, OSError):
        return False


def _check_scan(target: Path, picture: str, *, replace: bool) -> None:
    files = [target] if not picture else [target, picture_path(target)]
    for file in files:
        refuse_existing(file, overwrite=replace, option="replace")
    refuse_existing_record(target, replace=replace)


def _check_folder(source: Path, output: Path) -> None:
    if not output.parent.is_dir():
        raise InputError(f"output: there is no folder {output.parent}")
    if output.exists() and not output.is_dir():
        raise InputError(f"output: expected a folder's name, got a file's: {output}")
    if output.resolve() == source.resolve():
        raise InputError(f"output: expected another folder than the drive's, got {output}")


def _picture_of(scan: Path, folder: Path) -> Path:
    return folder / f"{scan_stem(scan)}.png"


def _remove_others(kept: set[Path]) -> None:
    """Remove scans and records of an earlier drive from the folders of the new scans."""
    for folder in {path.parent for path in kept}:
        for path in sorted(folder.iterdir()):
            is_ours = path.suffix == RECORD_SUFFIX or scan_suffix(path) in FOLDER_SUFFIXES
            if is_ours and path not in kept and path.is_file():
                path.unlink()


@checked
def verify_files(
    marker: Watermarker,
    source: str | os.PathLike[str],
    *,
    policy: Policy | None = None,
    record: str | os.PathLike[str] | None = None,
    picture: str = "",
    progress: Progress = None,
) -> VerifiedFiles:
    """Verify a scan's file, or the scans of a drive as one chain.

    Missing frames of a drive, also at its end, are noticed. Scans of which only the record is left,
    and unreadable scans, are undecidable, and the frames after them are still judged. A single
    unreadable file raises an error.

    Parameters
    ----------
    marker : Watermarker
        Watermarker with a key or keys, and with a state file if replays of earlier verified frames
        must be noticed.
    source : path
        Path of a scan, of the record of a missing scan, or of the folder of a KITTI drive.
    policy : Policy, optional
        Policy of the verifier; default: any embedding and sensor, and the order ``chain`` for a
        drive, ``any`` for a scan.
    record : path, optional
        Record of a single scan; default: that of `find_record`.
    picture : str
        Picture that carries the record; for a drive the folder of its pictures.
    progress : callable or bool, optional
        Function that is called with the share that is done; True shows a bar.

    Returns
    -------
    VerifiedFiles

    Raises
    ------
    InputError
        The folder has no scans, the source is the record of a scan that is there, ``record`` is
        given with a drive or a picture, or ``picture`` is no folder of the drive.
    FormatError, OSError
        A single file cannot be read, or there is neither a scan nor a record of it.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, io
    >>> from manip3d.authenticate import KeyFile, Watermarker, embed_files, verify_files
    >>> io.write_scan(LidarFrame(np.arange(9000, dtype=np.float32).reshape(3000, 3) / 8), "a.bin")
    >>> key = KeyFile.create("sensor.key")
    >>> _ = embed_files(Watermarker(key), "a.bin", "signed.bin")
    >>> found = verify_files(Watermarker(key), "signed.bin")
    >>> found.verdict, [name for name, _ in found.frames]
    ('authentic', ['signed.bin'])
    """
    path = path_of(source)
    is_drive = path.is_dir()
    if record is not None and is_drive:
        raise InputError("record: can only be given with a single scan, got a drive")
    if record is not None and picture:
        raise InputError("record: cannot be given with a picture, which carries its own")
    if policy is None:
        policy = Policy(
            order="chain" if is_drive else "any", carriers=("picture" if picture else "sidecar",)
        )
    folder = drive_pictures(path, picture) if is_drive and picture else None
    scans = _verified_scans(path, has_pictures=bool(picture))
    frames = []
    with reporting(progress, "verify") as report:
        for number, scan in enumerate(scans):
            seen = Path(picture) if picture else None
            if folder is not None:
                seen = _picture_of(scan, folder)
            beside = find_record(scan) if record is None else path_of(record)
            found = _verified(marker, scan, beside, seen, policy, in_drive=is_drive)
            frames.append((scan.name, replace(found, scan=None)))  # all scans would fill the memory
            if report is not None:
                report((number + 1) / len(scans))
    verdict, reason = verdict_of_stream([found for _, found in frames], whole=is_drive)
    return VerifiedFiles(verdict, reason, tuple(frames))


def _verified_scans(source: Path, *, has_pictures: bool) -> list[Path]:
    """The scans to verify, including missing scans of which only the record is left."""
    if source.suffix == RECORD_SUFFIX and source.is_file():
        if scan_of_record(source) is not None:
            raise InputError(f"{source}: expected the scan, got its record")
        return [source.with_suffix("")]
    if not source.is_dir():
        return [source]
    scans = all_drive_scans(source)
    if not has_pictures:
        scans += [record.with_suffix("") for record in drive_records_alone(source)]
    return in_order(scans)


def _verified(
    marker: Watermarker,
    scan: Path,
    record: Path,
    picture: Path | None,
    policy: Policy,
    *,
    in_drive: bool,
) -> WatermarkResult:
    """Verify a scan, or the record of a scan that is missing."""
    shown, told = None, None
    try:
        if picture is None:
            told = read_record(record)
        elif picture.is_file():
            shown = read_carrier(picture)
        read = read_scan(scan) if scan.exists() else None
    except (FormatError, InputError, OSError) as error:
        if not in_drive:
            raise
        why = f"unreadable: {error}"
        return marker.verify_without_scan(told, why, policy=policy, picture=shown)
    if read is None:
        if told is None and shown is None and not in_drive:
            scan.stat()  # a missing source is an OSError that names it
        why = "the record's scan is missing"
        return marker.verify_without_scan(told, why, policy=policy, picture=shown)
    return of_file(marker.verify(read, told, policy=policy, picture=shown))
