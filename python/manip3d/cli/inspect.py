"""``manip3d inspect``: look for edits of scans, drives and RGB-D recordings."""

from __future__ import annotations

import errno
import os
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import replace
from enum import StrEnum
from itertools import compress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli import kinds
from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import (
    MISSED,
    Calibration,
    FolderIntrinsics,
    Force,
    Jobs,
    Json,
    OptionalOutput,
    Quiet,
)
from manip3d.cli.scanning import expect_packets
from manip3d.cli.terminal import (
    Terminal,
    check_output,
    count,
    counted,
    left_out,
    naming_options,
    shown,
    table,
)
from manip3d.errors import Error, FormatError, InputError
from manip3d.io import is_url
from manip3d.io._scan_files import EXPORTED_SUFFIXES, FOLDER_SUFFIXES, holds_points
from manip3d.io._scan_tables import scan_suffix

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.authenticate import DriveInspection, Inspection, KeyRing, StreamInspection
    from manip3d.batch import SourceFile
    from manip3d.lidar import LidarFrame

    Position = tuple[float, float, float]

EXIT_CODES = {"no_trace": 0, "tampered": 3, "processed": MISSED, "undecidable": MISSED}
"""Exit code of each verdict."""

_KEPT_BYTES, _KEPT_ARRAY_BYTES = 256 << 20, 32 << 20
"""Largest amount of freed memory that the process keeps at the end of its heap, and largest array
that is allocated on the heap (glibc's maximum), in bytes."""


def _check_for_many(options: Mapping[str, Any]) -> None:
    """Refuse options that are valid only for a single scan, and logs that cannot be written."""
    for name in ("previous", "following", "watermark", "rows"):
        if options[name] is not None:
            raise InputError(f"--{name}: can only be given with a single scan, got several")
    _check_plant(options["plant"], power=options["power"])
    _exit_codes(options["policy"])
    _check_log(options["log"])


def _code_of_rows(rows: Sequence[Mapping[str, Any]], options: Mapping[str, Any]) -> int:
    """Return the exit code of the gravest verdict whose code is not 0, or that of remarks.

    The code is 1 if a source, or a scan of a drive, could not be read, unless one is tampered.
    """
    from manip3d.authenticate._drives import GRAVEST_FIRST

    codes = _exit_codes(options["policy"])
    verdicts = {row.get("verdict") for row in rows}
    if any(row.get("failed") or row.get("error") for row in rows):
        return ("tampered" in verdicts and codes["tampered"]) or 1
    code = next((codes[v] for v in GRAVEST_FIRST if v in verdicts and codes[v]), 0)
    return code or (codes["remarks"] if any(row.get("remarks") for row in rows) else 0)


def _records(source: str) -> list[Path]:
    """Return the path of a scan's watermark record, which is an input if a key is given."""
    from manip3d import authenticate

    return [] if is_url(source) else [authenticate.find_record(source)]


def _stamp_of_keys(options: Mapping[str, Any]) -> str:
    from manip3d.cli.watermark import key_of

    return key_of({"key": options["key"]})


def _name_copies(rows: Sequence[dict[str, Any]]) -> None:
    """Add ``same_points_as`` to each row: the first earlier scan with nearly the same points.

    The order of the points does not matter.
    """
    from manip3d.authenticate._repeats import first_copies

    known = [row for row in rows if row.get("points_id")]
    for row, first in zip(known, first_copies([row["points_id"] for row in known]), strict=True):
        row["same_points_as"] = None if first is None else known[first]["source"]


def _find_scans(sources: Sequence[str], *, suffixes: Sequence[str]) -> list[SourceFile]:
    """Return the scans and recordings to which the sources refer.

    If a folder has no scans, its text files and arrays with points are scans.
    """
    from manip3d._util.paths import by_number
    from manip3d.batch import find_files

    found: dict[str, SourceFile] = {}
    for source in sources:
        try:
            files = find_files([source], suffixes=suffixes)
        except InputError:
            files = _exported(source)
            if not files:
                _check_no_pictures(source, files)
                raise
        if not any(scan_suffix(file.name) in FOLDER_SUFFIXES for file in files):
            files = [*files, *(each for each in _exported(source) if each not in files)]
        if files and not is_url(source) and Path(source).is_dir():
            _check_no_pictures(source, files)
        found |= {file.name: file for file in files if file.name not in found}
    return [found[name] for name in sorted(found, key=by_number(found))]


def _check_no_pictures(source: str, texts: Sequence[SourceFile]) -> None:
    """Refuse a folder of depth images that does not have the layout of a recording.

    The text files in such a folder are poses and cameras, and no scans.
    """
    if is_url(source) or not Path(source).is_dir() or not all(map(_is_text, texts)):
        return
    images = sum(_is_depth(path) for path in Path(source).rglob("*") if path.is_file())
    if 2 * images > len(texts):  # each image may have a pose
        raise InputError(
            f"{source}: expected scans or an RGB-D recording, got "
            f"{counted(images, 'depth image')}; a recording has them in a folder depth/ of its "
            "own, and colour images of the same names in color/ beside it (--intrinsics tells the "
            "camera)"
        )


def _is_text(file: SourceFile) -> bool:
    return scan_suffix(file.name) in EXPORTED_SUFFIXES


def _is_depth(path: Path) -> bool:
    from manip3d.io import is_color_png

    return path.suffix.lower() in (".png", ".pgm", ".tif", ".tiff") and not is_color_png(path)


def _exported(source: str) -> list[SourceFile]:
    """Return the text files and arrays with points in a folder; empty for other sources."""
    from manip3d.batch import find_files

    if is_url(source) or not Path(source).is_dir():
        return []
    try:
        files = find_files([source], suffixes=EXPORTED_SUFFIXES)
    except InputError:
        return []
    return [file for file in files if holds_points(Path(file.name))]


class SensorKind(StrEnum):
    """Kinds of scanners that ``authenticate.inspect`` takes as ``sensor``."""

    auto = "auto"
    lattice = "lattice"
    terrestrial = "terrestrial"
    other = "other"


def _logged(options: Mapping[str, Any]) -> set[str] | None:
    """Return the sources of the log's entries; None: no log is written."""
    from manip3d.report._case_log import sources_logged

    log: Path | None = options["log"]
    if log is None:
        return None
    try:
        return sources_logged(log)
    except FileNotFoundError:
        return set()


@over_files(
    kinds.inspected_suffixes,
    find=_find_scans,
    whole=kinds.WHOLE,
    writable=lambda: (".html", ".json"),
    otherwise=".html",
    check=_check_for_many,
    exit_code=_code_of_rows,
    columns=("source", "verdict", "sensor", "p_value", "same_points_as", "reason"),
    across=_name_copies,
    logged=_logged,
    beside=_records,
    depends=_stamp_of_keys,
)
def inspect(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A scan: .bin, .pcd, .ply, .3d, .las, .laz, .e57, .ptx, .npy, .npz or text "
            "(.xyz, .asc, .pts, .txt, .csv); a drive of scans in KITTI's layout, a recording of "
            "LiDAR packets (.pcap, .osf) or of point clouds (.mcap, a ROS bag); or an RGB-D "
            "recording: a .mkv file, a ROS bag, a recorded folder or an address that 'capture "
            "list' shows.",
        ),
    ],
    output: OptionalOutput = None,
    previous: Annotated[
        Path | None, typer.Option(help="Scan of the same scanner one turn earlier.")
    ] = None,
    following: Annotated[
        Path | None, typer.Option(help="Scan of the same scanner one turn later.")
    ] = None,
    lattice: Annotated[
        Path | None,
        typer.Option(
            help="Lattice of the scanner (angles of its lasers, steps of its encoder), as "
            "'manip3d lattice' writes it (.json)."
        ),
    ] = None,
    sensor: Annotated[
        SensorKind,
        typer.Option(
            help="Kind of scanner: recognised (auto), lattice (spinning, with points on a lattice, "
            "such as an HDL-64E), terrestrial or other."
        ),
    ] = SensorKind.auto,
    origin: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z",
            help="Position of the scanner in the coordinates of the scan's file (also those of a "
            "map), metres; by default as the file states it, else estimated from the scan.",
        ),
    ] = None,
    watermark: Annotated[
        Path | None,
        typer.Option(
            help="Record of the scan's watermark; with --key by default SCAN.wm beside it."
        ),
    ] = None,
    key: Annotated[
        list[Path] | None,
        typer.Option(
            "--key",
            help="Key file that verifies the watermark, or a folder of .key files; points that "
            "the embedding moved then do not count as edits. Repeat the option for earlier keys of "
            "the sensor.",
        ),
    ] = None,
    calibration: Calibration = None,
    intrinsics: FolderIntrinsics = "",
    printed: Annotated[
        bool,
        typer.Option(
            "--printed",
            help="Use the thresholds printed in the dissertation, not calibrated ones; only "
            "terrestrial scans are judged.",
        ),
    ] = False,
    power: Annotated[
        bool,
        typer.Option(
            "--power/--no-power",
            help="State the share of edits of each class that are found on this scanner.",
        ),
    ] = True,
    plant: Annotated[
        int,
        typer.Option(
            min=0,
            help="Number of edits of each class to plant in copies of the scan, to count how many "
            "are found; each takes as long as an inspection. Edits are planted only in scans of a "
            "spinning scanner without a watermark, whose verdict is no_trace or whose lattice is "
            "exact.",
        ),
    ] = 0,
    policy: Annotated[
        str,
        typer.Option(
            metavar="VERDICT=CODE,...",
            help="Other exit codes, for example processed=0. remarks=4 is for drives with remarks, "
            "such as missing, repeated or exchanged scans, whose verdict has the code 0.",
        ),
    ] = "",
    rows: Annotated[
        Path | None, typer.Option(help="Write the rows of the suspected points to this .csv file.")
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            help="Append the result to this .jsonl file, whose lines are hash-chained. If it does "
            "not exist, sources that an earlier run judged are judged again."
        ),
    ] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Look for edits of a LiDAR scan, a drive or an RGB-D recording.

    Verdicts and exit codes: tampered (3): a part of the scan was edited. processed (4): all of the
    scan was changed (rounded, cropped, thinned out, watermarked) or lost returns to the weather,
    which can hide an edit. no_trace (0): a detector that finds edits of scans of this scanner found
    none. undecidable (4): no detector can judge this scan. The exit code is 1 if a scan could not
    be read, and 130 when interrupted. With several sources it is that of the worst verdict:
    tampered, then a scan that could not be read, then processed and undecidable. No verdict says
    that a scan is authentic: only a keyed watermark proves that.

    Each scan of a drive or of packets gets a line, or each drive if several sources are given. A
    scan is judged together with the scans before and after it, or alone if these are missing or the
    folder has no times (object and stereo benchmarks). A drive is tampered if more of its scans are
    accused than false alarms explain: one of 100 clean scans may be accused, and at most 2.1 % of
    clean drives are called tampered, however long they are. These two edits of a drive have no
    remark: its reversal if the car was slower than 18 km/h, and scans that are left out evenly if
    the rest gets new numbers and times.

    With -o the evidence is written as a page (.html) or as numbers (.json). The page of a scan has
    pictures and boxes; that of a drive a timeline and a map; that of an RGB-D recording its frames,
    the inserted parts and the curves of noise.

    Example: manip3d inspect scan.bin -o evidence.html
    """
    from manip3d import authenticate, report

    codes = _exit_codes(policy)
    _check_log(log)
    _check_plant(plant, power=power)
    _keep_freed_memory()
    with _logging_errors(log, source):
        kind = expect_kind(source, "scan", "drive", "packets", "recording", verb="inspect")
    shell = Terminal(as_json=as_json, quiet=quiet)
    if kind == "recording" or _is_rgbd(source):
        check_output(output, report.EVIDENCE_KINDS, force=force)
        _refuse(
            "a LiDAR scan or drive", "an RGB-D recording", rows=rows, previous=previous,
            following=following, lattice=lattice, key=key or None, watermark=watermark,
            calibration=calibration, origin=origin, printed=printed or None, plant=plant or None,
            sensor=None if sensor == SensorKind.auto else sensor,
        )  # fmt: skip
        raise typer.Exit(
            codes[inspect_recording(source, output, log, shell, intrinsics=intrinsics)]
        )
    if not shell.is_collecting:  # one of several files may be an RGB-D recording
        _refuse("an RGB-D recording", "scans of a LiDAR", intrinsics=intrinsics or None)
    options = {
        "lattice": None if lattice is None else authenticate.SensorLattice.load(lattice),
        "sensor": sensor.value, "power": power, "printed": printed, "threads": jobs,
    }  # fmt: skip
    if kind in ("drive", "packets", "stream"):
        check_output(output, report.EVIDENCE_KINDS, force=force)
        _refuse(
            "a single scan", "a drive", previous=previous, following=following,
            watermark=watermark, rows=rows, plant=plant or None,
        )  # fmt: skip
        with _keys_of(key) as secret, naming_options("origin"):
            together = inspect_drive(
                source, output, log, shell, calibration=calibration, key=secret, origin=origin,
                options=options,
            )  # fmt: skip
        raise typer.Exit(_code_of_drive(together, codes, shell))
    expect_packets(source, calibration)
    check_output(output, report.EVIDENCE_KINDS, force=force)
    check_output(rows, (".csv",), force=force, option="--rows")
    found = _inspect_scan(
        source, log, shell, previous=previous, following=following, watermark=watermark, keys=key,
        origin=origin, options={**options, "plant": plant},
    )  # fmt: skip
    _hand_out(found, source, shell, output=output, rows=rows, log=log)
    raise typer.Exit(codes[found.verdict])


def _inspect_scan(
    source: str,
    log: Path | None,
    shell: Terminal,
    *,
    previous: Path | None,
    following: Path | None,
    watermark: Path | None,
    keys: Sequence[Path] | None,
    origin: Position | None,
    options: Mapping[str, Any],
) -> Inspection:
    """Inspect a single scan; ``origin`` is in the coordinates of its file."""
    from manip3d import authenticate
    from manip3d.io import read_scan

    with _logging_errors(log, source):
        frame = read_scan(source)
    place = _in_scan(frame, origin)
    shell.say(f"read {source}: {counted(frame.num_points, 'point')}")
    before = None if previous is None else _scan_beside("previous", previous)
    after = None if following is None else _scan_beside("following", following)
    named = naming_options("origin")
    with shell.progress("inspect") as progress, _keys_of(keys) as secret, named:
        return authenticate.inspect(
            frame,
            watermark=_record_of(source, watermark, keys),
            key=secret,
            origin=place,
            previous=before,
            following=after,
            progress=progress,
            **options,
        )


def _in_scan(frame: LidarFrame, origin: Position | None) -> Position | None:
    """Return a position in the coordinates of a scan's file in those of the scan as it is read.

    None stays None.
    """
    from manip3d.lidar import map_shift

    if origin is None:
        return None
    x, y, z = (a - b for a, b in zip(origin, map_shift(frame).tolist(), strict=True))
    return (x, y, z)


def _scan_beside(name: str, path: Path) -> LidarFrame:
    from manip3d.io import read_scan

    with naming_options(path=name):
        return read_scan(path)


def _keep_freed_memory() -> None:
    """Let glibc keep freed memory for following arrays; do nothing with other C libraries.

    An inspection allocates some hundred arrays of a megabyte one after the other. If the operating
    system provides cleared pages for each of them, that is a fifth of the time.
    """
    trim_threshold, mmap_threshold = -1, -3  # M_TRIM_THRESHOLD, M_MMAP_THRESHOLD of malloc.h
    if sys.platform != "linux":
        return
    import ctypes

    if (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)) is not None:
        mallopt(trim_threshold, _KEPT_BYTES)
        mallopt(mmap_threshold, _KEPT_ARRAY_BYTES)


def _code_of_drive(together: DriveInspection, codes: Mapping[str, int], shell: Terminal) -> int:
    """Return the code of a drive's verdict; 1 if a scan could not be read, unless tampered."""
    if together.num_missing and not shell.is_collecting:  # for several drives, the table states it
        told = f"{count(together.num_missing)} of {counted(together.num_scans, 'scan')}"
        print(f"manip3d: error: {told} could not be read", file=sys.stderr)
    code = codes[together.verdict] or (codes["remarks"] if together.remarks else 0)
    is_whole = not together.num_missing or (together.verdict == "tampered" and codes["tampered"])
    return code if is_whole else 1


def _hand_out(
    found: Inspection,
    source: str,
    shell: Terminal,
    *,
    output: Path | None,
    rows: Path | None,
    log: Path | None,
) -> None:
    """Write the output files that are given, then print the result."""
    from manip3d import report

    if output is not None:
        report.write_evidence(found, output, source=source)
        shell.say(f"wrote {output}")
    if rows is not None:
        report.write_suspected_rows(found, rows)
        shell.say(f"wrote {rows}")
    if log is not None:
        _append(log, found, source, shell)
    whole = {"source": source} | found.record()
    shell.result(whole, lambda console: show(console, found))


def _refuse(expected: str, got: str, **options: object) -> None:
    """Refuse options that have no meaning for this kind of source."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name}: can only be given with {expected}, got {got}")


def _check_plant(plant: int, *, power: bool) -> None:
    if plant and not power:
        raise InputError("--plant: can only be given with --power, got --no-power")


def _check_log(log: Path | None) -> None:
    """Refuse a log to which nothing can be appended, before any scan is read."""
    if log is not None:
        from manip3d.report._case_log import check_log

        check_log(log)


@contextmanager
def _logging_errors(log: Path | None, source: str) -> Iterator[None]:
    """Append the error to the log if the source cannot be read; a wrong option is no such error."""
    try:
        yield
    except (kinds.OtherKindError, InputError):
        raise
    except (Error, OSError) as error:
        if log is not None:
            from manip3d.report._case_log import append_error
            from manip3d.report._evidence_files import sha256_of_source

            sha256 = ""
            with suppress(OSError, FormatError):  # those of a file that cannot be opened
                sha256, _ = sha256_of_source(source)
            append_error(log, shown(str(error)), source=shown(source), source_sha256=sha256)
        raise


def _sha256_of_frame(path: Path | None, whole: str) -> str:
    """Return the hash of a scan's file, or ``whole`` for a frame of a recording."""
    from manip3d import datasets

    if path is None:
        return whole
    try:
        return datasets.file_sha256(path)
    except OSError:
        return ""


def _append(log: Path, found: Inspection | StreamInspection, source: str, shell: Terminal) -> None:
    from manip3d import report
    from manip3d.report._evidence_files import sha256_of_source

    sha256, _ = sha256_of_source(source)
    digest = report.append_log(log, found, source=shown(source), source_sha256=sha256)
    shell.say(f"appended to {log}: {digest}")


def _keys_of(paths: Sequence[Path] | None) -> AbstractContextManager[KeyRing | None]:
    from manip3d import authenticate

    return authenticate.KeyRing.open(paths) if paths else nullcontext()


def _record_of(source: str, record: Path | None, key: Sequence[Path] | None) -> bytes | None:
    """Return the given record, or with a key the one beside the scan (b'' if that is missing)."""
    from manip3d import authenticate

    if record is None and not key:
        return None
    if record is None:
        return authenticate.read_record(authenticate.find_record(source)) or b""
    found = authenticate.read_record(record)
    if found is None:
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(record))
    return found


def inspect_drive(
    source: str,
    output: Path | None,
    log: Path | None,
    shell: Terminal,
    *,
    calibration: Path | None,
    key: KeyRing | None,
    origin: Position | None,
    options: Mapping[str, Any],
) -> DriveInspection:
    """Inspect the scans of a drive, print a line for each, and return the joint verdict.

    ``origin`` is in the coordinates of the scans' files.
    """
    import json

    from manip3d import authenticate, capture, report
    from manip3d._util.json import finite
    from manip3d.authenticate._drives import inspect_placed
    from manip3d.io._files import atomic_write
    from manip3d.report._case_log import append_error
    from manip3d.report._evidence_files import sha256_of_source

    with naming_options("calibration"), _logging_errors(log, source):
        drive = capture.open_drive(source, calibration=calibration)
    found: list[Inspection | None] = []
    records: list[dict[str, Any]] = []
    places = drive.numbers
    whole_sha256 = "" if log is None else sha256_of_source(source)[0]
    judged = inspect_placed(
        drive,
        lambda frame: _in_scan(frame, origin),
        numbers=places,
        records=None if key is None else drive.records(),
        key=key,
        **options,
    )
    with _logging_errors(log, source):
        for number, each in enumerate(judged):
            name, error = drive.names[number], drive.errors.get(number, "")
            found.append(None if each is None else replace(each, **_WITHOUT_MAPS))
            about = {"error": error} if each is None else each.record()
            records.append({"frame": name} | about)
            said = f"error  {error}" if each is None else f"{each.verdict}  {each.reason}"
            shell.show(f"{name}  {said}")
            if log is not None:
                digest = _sha256_of_frame(drive.paths.get(number), whole_sha256)
                entry = {"source": f"{shown(source)}: {name}", "source_sha256": digest}
                if each is None:
                    append_error(log, error, **entry)
                else:
                    report.append_log(log, each, **entry)
    times_ns = [drive.times_ns.get(number) for number in range(len(found))]
    together = authenticate.judge_drive(found, places, times_ns=times_ns)
    row = together.record()
    if log is not None:
        report.append_log(log, together, source=shown(source), source_sha256=whole_sha256)
    whole = row | {"frames": records}
    if output is not None:
        if output.suffix.lower() == ".html":
            report.write_drive_evidence(
                found, output, names=drive.names, source=source,
                errors=list(drive.errors.values()), numbers=places, times_ns=times_ns,
            )  # fmt: skip
        else:
            atomic_write(output, (json.dumps(finite(whole), indent=1) + "\n").encode())
        shell.say(f"wrote {output}")
    shell.result(
        row if shell.is_collecting else whole,
        lambda console: show_drive(console, together, found),
    )
    return together


_WITHOUT_MAPS: Mapping[str, Any] = {
    "density": None, "occlusion": None, "generic": None, "scan": None, "watermark": None,
}  # fmt: skip
"""Large parts that are removed from the results of a drive's scans to save memory. Results of
detector IV, regions and motion of the scanner, are kept."""


def show_drive(
    console: Console, together: DriveInspection, found: Sequence[Inspection | None]
) -> None:
    """Print how many scans have each verdict, and that of the drive with its reason."""
    verdict = f"{together.verdict}: {together.reason}"
    if not found:
        console.print(verdict)
        return
    counts = Counter("not read" if each is None else each.verdict for each in found)
    console.print()
    rows = [(word, str(number), f"{number / len(found):.0%}") for word, number in counts.items()]
    table(console, sorted(rows), ("verdict", "scans", "share"))
    console.print()
    if len(found) > 1:
        console.print(together.evidence.statement, soft_wrap=True)
    console.print(verdict, soft_wrap=True)


def _is_rgbd(source: str) -> bool:
    """Return whether an address has a scheme of RGB-D sources."""
    scheme, colon, _ = source.partition(":")
    if not colon or Path(source).exists():
        return False
    from manip3d import capture

    known = {kind.name for kind in capture.sources() if kind.frames == "rgbd"}
    return scheme in known and not (scheme == "sim" and not source.startswith("sim:body"))


def inspect_recording(
    source: str, output: Path | None, log: Path | None, shell: Terminal, *, intrinsics: str = ""
) -> str:
    """Inspect an RGB-D recording, print and write the results, and return the verdict."""
    from manip3d import authenticate, report
    from manip3d.cli.capture import open_source

    with (
        _logging_errors(log, source),
        open_source(source, shell, intrinsics=intrinsics) as opened,
    ):
        frames = authenticate.judged_frames(opened)
    for line in left_out(opened.counters):
        shell.warn(line)
    if not frames:
        raise InputError(f"{source}: expected a frame, found none")
    with shell.progress("inspect") as progress:
        found = authenticate.inspect_stream(frames, progress=progress)
    if output is not None:
        report.write_stream_evidence(found, frames, output, source=source)
        shell.say(f"wrote {output}")
    if log is not None:
        _append(log, found, source, shell)
    shell.result({"source": source} | found.record(), lambda console: show_stream(console, found))
    return found.verdict


def show_stream(console: Console, found: StreamInspection) -> None:
    """Print the verdicts with their reasons, the power, and the boxes of inserted parts."""
    from manip3d.authenticate._stream_verdict import NO_POWER_HERE

    console.print(f"{found.verdict}: {found.reason}", soft_wrap=True)
    console.print()
    rows = [
        (r.name, r.verdict, "" if r.score is None else f"{r.score:.3f}", r.reason)
        for r in found.detectors
    ]
    table(console, rows, ("detector", "verdict", "score", "reason"))
    console.print()
    if found.power:
        cells = [
            (name, f"{power.share:.0%}", f"{power.found} of {power.planted}")
            for name, power in found.power.items()
        ]
        table(console, cells, ("cut out, by forge stream", "found", "of which"))
    else:
        console.print(NO_POWER_HERE, soft_wrap=True)
    if found.regions:
        console.print()
        boxes = [(str(r.frame), *(str(side) for side in r.box)) for r in found.regions[:20]]
        table(console, boxes, ("frame", "column", "row", "width", "height"))
        if len(found.regions) > len(boxes):
            console.print(f"and {count(len(found.regions) - len(boxes))} more")


def _exit_codes(policy: str) -> dict[str, int]:
    """Return the exit codes, changed by a policy such as ``processed=0,undecidable=0``."""
    codes = {**EXIT_CODES, "remarks": 0}
    for part in filter(None, policy.split(",")):
        verdict, _, code = part.partition("=")
        if verdict not in codes or not code.isdecimal() or int(code) > 255:
            raise typer.BadParameter(
                f"expected VERDICT=CODE with one of {', '.join(codes)} and 0 to 255, got {part!r}",
                param_hint="--policy",
            )
        codes[verdict] = int(code)
    return codes


def show(console: Console, found: Inspection) -> None:
    """Print the verdicts with their reasons, the power, and the boxes."""
    from manip3d.authenticate._power import NOT_FOUND
    from manip3d.authenticate._verdict import PLANTED_HERE
    from manip3d.report import place_sentence

    console.print(f"{found.verdict}: {found.reason}", soft_wrap=True)
    console.print(place_sentence(found))
    if found.sensor is not None:
        console.print(f"scanner: {found.sensor.name}; {found.sensor.reason}", soft_wrap=True)
    console.print()
    table(console, [(r.title, r.verdict, r.reason) for r in found.detectors])
    if found.power:
        console.print()
        powers = found.power.values()
        kept = [True, True, any(power.source != PLANTED_HERE for power in powers)]
        kept.append(any(power.here_planted for power in powers))
        cells = [
            (
                name,
                f"{power.share:.0%}",
                f"{power.found} of {power.planted}",
                f"{power.here_found} of {power.here_planted}" if power.here_planted else "",
            )
            for name, power in found.power.items()
        ]
        unseen = (NOT_FOUND, "") if kept[2] else ("", NOT_FOUND)
        cells += [(name, "0%", *unseen) for name in found.blind]
        titles = ("edits of this class", "found", "planted in clean scans", "planted in this scan")
        table(console, [tuple(compress(cell, kept)) for cell in cells], (*compress(titles, kept),))
        for note in found.power_notes:
            console.print(note, soft_wrap=True)
    boxes = [
        (report.name, found.in_file(region).box)
        for report in found.detectors
        for region in report.regions
    ]
    if boxes:
        console.print()
        rows = [
            (name, *(f"{value:.2f}" for value in (*box.center, *box.size, box.yaw)))
            for name, box in boxes
        ]
        heads = ("box, metres", "x", "y", "z", "length", "width", "height", "yaw, rad")
        table(console, rows, heads)
    notes = {region.note: report.name for report in found.detectors for region in report.regions}
    for note, name in notes.items():
        if note:
            console.print(f"{name}: {note}", soft_wrap=True)
