"""``manip3d watermark``: embed keyed watermarks into scans, and verify them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import MISSED, Force, Json, Quiet
from manip3d.cli.terminal import (
    Terminal,
    check_folder,
    check_output,
    check_place,
    counted,
    naming_options,
    table,
)
from manip3d.errors import InputError
from manip3d.io._scan_files import FOLDER_SUFFIXES

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.authenticate import Policy, VerifiedFiles
    from manip3d.batch import SourceFile

app = typer.Typer(
    name="watermark",
    help="Embed keyed watermarks into LiDAR scans and verify them.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

EXIT_CODES = {"authentic": 0, "tampered": 3, "undecidable": MISSED}
"""Exit code of each verdict."""


class Embedding(StrEnum):
    """Embeddings of a watermark; `authenticate.EMBEDDINGS`."""

    lbm = "lbm"
    qim = "qim"
    detached = "detached"


Source = Annotated[
    str,
    typer.Argument(metavar="SOURCE", help="A scan, or a folder of a KITTI drive."),
]
Key = Annotated[Path, typer.Option("--key", help="Key file, as 'watermark keygen' makes it.")]
Keys = Annotated[
    list[Path],
    typer.Option(
        "--key",
        help="Key file, as 'watermark keygen' makes it, or a folder of .key files. Repeat the "
        "option for earlier keys of the sensor: each verifies what it signed before the next key "
        "was made.",
    ),
]

Picture = Annotated[
    str,
    typer.Option(
        help="Picture (.png) that carries the record instead of a file beside the scan; for "
        "a drive, the folder of its pictures, such as image_02."
    ),
]

OnlyEmbedding = Annotated[
    Embedding | None, typer.Option(help="Accept records of this embedding only.")
]
OnlySensor = Annotated[str, typer.Option(help="Accept records of this sensor only.")]
OnlySession = Annotated[
    str, typer.Option(help="Accept this session only: the 32 digits that embed printed.")
]
MaxAge = Annotated[float | None, typer.Option(help="Refuse frames older than this, seconds.")]
MaxPoints = Annotated[
    int, typer.Option(min=1, max=2**31 - 1, help="Refuse scans of more points than this.")
]
State = Annotated[
    Path | None,
    typer.Option(help="File that remembers the frames seen, so that replays are noticed."),
]
MAX_POINTS = 10_000_000
"""Default of the largest number of points of a scan that is verified."""


_OPTION_OF = {"sessions": "session", "max_age_s": "max-age", "max_points": "max-points"}
"""Fields of `Policy` whose option has another name."""


def policy_of(
    *,
    embedding: Embedding | None,
    sensor: str,
    session: str,
    max_age: float | None,
    max_points: int,
    order: str,
    carrier: str = "sidecar",
) -> Policy:
    """Return the verifier's policy for the options of a command."""
    from manip3d import authenticate

    try:
        return authenticate.Policy(
            embeddings=authenticate.EMBEDDINGS if embedding is None else (embedding.value,),
            order=order,
            sensors=(sensor,) if sensor else (),
            sessions=(session,) if session else (),
            max_age_s=max_age,
            max_points=max_points,
            carriers=(carrier,),
        )
    except InputError as error:
        name, colon, rest = str(error).partition(":")
        raise InputError(f"--{_OPTION_OF.get(name, name)}{colon}{rest}") from error


@app.command("keygen")
def keygen(
    path: Annotated[Path, typer.Argument(metavar="KEY", help="Key file to create.")],
    days: Annotated[
        int,
        typer.Option(
            min=0, max=36500, help="Days after which the key cannot embed any more; 0: no limit."
        ),
    ] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a key file, which only its owner can read.

    An existing file is never replaced. Whoever can verify with the key can also embed with it.

    Example: manip3d watermark keygen sensor.key
    """
    import time

    from manip3d import authenticate

    check_place(path, force=None, option="KEY")
    expires_ns = time.time_ns() + days * 86_400 * 10**9 if days else 0
    with authenticate.KeyFile.create(path, expires_ns=expires_ns) as key:
        record = {"key": str(path), "key_id": key.key_id, "expires_ns": key.expires_ns}
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"wrote {path}")
    shell.result(record, lambda console: console.print(f"key {record['key_id']}"))


def key_of(options: Mapping[str, Any]) -> str:
    """Return a text that changes with the keys and, under --max-age, with the time.

    Results of several drives are computed again when it changes.
    """
    import time

    from manip3d import authenticate

    given = options.get("key")
    if not given:
        return ""
    paths = [Path(each) for each in (given if isinstance(given, (list, tuple)) else [given])]
    with authenticate.KeyRing.open(paths) as ring:
        is_timed = options.get("max_age") is not None
        files = [f for p in paths for f in (sorted(p.glob("*.key")) if p.is_dir() else [p])]
        names = [f"key {key.key_id}" for key in ring.keys]
        stamp = " ".join([*names, *(str(file.stat().st_mtime_ns) for file in files)])
        return f"{stamp} at {time.time_ns()}" if is_timed else stamp


def of_one_only(
    files: Sequence[SourceFile], options: Mapping[str, Any]
) -> Mapping[str, Mapping[str, Any]]:
    """Refuse options that apply to a single source only, which makes no table."""
    for name in ("record", "state", "report"):
        if options.get(name) is None:
            continue
        if len(files) > 1:
            raise InputError(f"--{name}: can only be given with one scan or drive, got several")
        raise InputError(
            f"--{name}: cannot be given with --table, --to or --dask, nor with a pattern or a "
            "folder of scans or drives"
        )
    return {}


def _without_chain(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return a sentence on scans that were signed one by one; empty if there are not several."""
    scans = sum("session" in row and not Path(str(row["source"])).is_dir() for row in rows)
    if scans < 2:
        return ""
    return (
        f"{counted(scans, 'scan')}, each a session of its own: if one is missing or two are "
        "exchanged, verify does not notice it; scans in a folder velodyne/ are signed as one drive"
    )


@app.command("embed")
@over_files(
    lambda: FOLDER_SUFFIXES,
    writable=lambda: FOLDER_SUFFIXES,
    drives=True,
    has_to=False,
    depends=key_of,
    sentence=_without_chain,
)
def embed(
    source: Source,
    key: Key,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="Scan or drive (folder) to write; for several sources, a folder for all.",
        ),
    ],
    embedding: Annotated[
        Embedding,
        typer.Option(
            help="Embedding: lbm (lowest bits), qim (cells of z), or detached (points stay as they "
            "are)."
        ),
    ] = Embedding.lbm,
    sensor: Annotated[
        str, typer.Option(help="Name of the sensor that the records are bound to.")
    ] = "",
    round_points: Annotated[
        bool,
        typer.Option("--round", help="Move points that are off the grid of --units-per-m onto it."),
    ] = False,
    units_per_m: Annotated[
        int,
        typer.Option(
            help="Steps per metre of the grid to which coordinates are rounded, for lbm, not the "
            "unit of the file, which is always metres; 1000: a step is a millimetre."
        ),
    ] = 1000,
    origin: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z",
            help="Origin of coordinates that need float64, such as UTM, metres; by default the "
            "middle of each scan.",
        ),
    ] = None,
    picture: Picture = "",
    scans_only: Annotated[
        bool,
        typer.Option("--scans-only", help="Do not copy the other files of a drive."),
    ] = False,
    again: Annotated[
        bool, typer.Option("--again", help="Sign scans again that already have a record.")
    ] = False,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Embed a watermark into a scan or a drive. All scans of a drive form one chain.

    Scans of a folder without KITTI's layout are signed one by one, without a chain.

    The record of each scan is written beside it, as SCAN.wm, or with --picture in the lowest bits
    of the picture, SCAN.png or that of the drive. Points move by at most 1.8 mm (lbm), 1.9 mm (qim)
    or not at all (detached); with --round by at most 2.6 mm (lbm) or 2.5 mm (qim). These are
    numbers for a grid of 1 mm; another one (--units-per-m) multiplies those of lbm by its step. The
    other files of a drive (pictures, positions, times, labels, calibration) are copied unchanged. A
    run that was stopped, or whose disk was full, continues when the same command is given again.
    With --force, scans and records of an earlier drive are deleted from the output's folder of
    scans. Several drives are processed in parallel; each is one session, whose frames are chained.

    Example: manip3d watermark embed drive --key sensor.key -o signed
    """
    from manip3d import authenticate

    shell = Terminal(as_json=as_json, quiet=quiet)
    expect_kind(source, "scan", "drive", verb="watermark embed")
    drive = Path(source).is_dir()
    if drive:
        check_folder(output)  # a run that was stopped is continued in its folder
    else:
        check_output(output, FOLDER_SUFFIXES, force=force)
    with (
        naming_options("output", "picture", "sensor", "units-per-m", "origin"),
        _naming_remedies(),
        authenticate.KeyFile(key) as secret,
        authenticate.Watermarker(
            secret,
            sensor=sensor,
            embedding=embedding.value,
            round_points=round_points,
            units_per_m=units_per_m,
            origin=origin,
        ) as marker,
        shell.progress("embed") as progress,
    ):
        scans = authenticate.embed_files(
            marker,
            source,
            output,
            picture=picture,
            scans_only=scans_only,
            replace=force,
            again=again,
            progress=progress,
        )
        record = {
            "source": source,
            "output": str(output),
            "session": marker.session,
            "key_id": secret.key_id,
            "embedding": embedding.value,
            "num_frames": len(scans),
            "frames": [
                {
                    "scan": str(scan.path),
                    "frame": scan.number,
                    "points": scan.num_points,
                    "tiles": scan.num_tiles,
                }
                for scan in scans
            ],
        }
    without = sum(not scan.has_time for scan in scans)
    if drive and without > 0:
        told = counted(without, "scan")
        shell.warn(f"no time of {told}; their records bear the clock's")
    carrier = ("pictures" if drive else "a picture") if picture else ""
    were_there = sum(scan.was_there for scan in scans)
    if were_there:
        shell.say(f"went on after {counted(were_there, 'scan')} of an earlier run")
    shell.say(f"wrote {_with_records(len(scans), carrier)} to {output}")
    shell.result(record, lambda console: console.print(f"session {record['session']}"))


_REMEDIES = "embed 'detached', or round the points onto the grid"
"""Advice of the error about points that are off the grid."""


@contextmanager
def _naming_remedies() -> Iterator[None]:
    """Let the error about points off the grid name the options that help."""
    try:
        yield
    except InputError as error:
        about, advice, rest = str(error).partition(_REMEDIES)
        if not advice:
            raise
        options = "give --embedding detached, which moves no point, or --round"
        raise InputError(about + options + rest) from error


def _with_records(num_scans: int, carrier: str) -> str:
    """Return a phrase with the number of scans and the place of their records."""
    records = "its record" if num_scans == 1 else "their records"
    return f"{counted(num_scans, 'scan')} with {records}{f' in {carrier}' if carrier else ''}"


def _verified_suffixes() -> tuple[str, ...]:
    """Return the suffixes of scans and of records; records without a scan are reported."""
    from manip3d import authenticate

    return (*FOLDER_SUFFIXES, authenticate.RECORD_SUFFIX)


def _with_scans_of_records(files: list[SourceFile]) -> list[SourceFile]:
    """Return the files with the scans of all records in place of these, each scan once.

    A record without a scan stays. The scans may have any suffix, such as that of a text file.
    """
    from manip3d._util.paths import by_number
    from manip3d.authenticate import RECORD_SUFFIX
    from manip3d.authenticate._watermark_files import scans_of_record
    from manip3d.batch._stamps import stamp_of_file

    found = {f.name: f for f in files if Path(f.name).suffix != RECORD_SUFFIX}
    for file in files:
        if file.name in found:
            continue
        scans = scans_of_record(Path(file.name))
        for scan in scans:
            beside = str(Path(file.relative).with_name(scan.name))
            stamp = stamp_of_file(scan)
            more = replace(file, name=str(scan), relative=beside, stamp=stamp)
            found.setdefault(more.name, more)
        if not scans:
            found[file.name] = file
    return [found[name] for name in sorted(found, key=by_number(found))]


@app.command("verify")
@over_files(
    _verified_suffixes,
    drives=True,
    prepare=of_one_only,
    depends=key_of,
    choose=_with_scans_of_records,
    skipped_code=EXIT_CODES["undecidable"],
    columns=("source", "verdict", "num_frames", "reason"),
    resumes=False,
)
def verify(
    source: Source,
    key: Keys,
    record: Annotated[
        Path | None, typer.Option(help="Record of a single scan; by default SCAN.wm beside it.")
    ] = None,
    embedding: OnlyEmbedding = None,
    sensor: OnlySensor = "",
    session: OnlySession = "",
    max_age: MaxAge = None,
    max_points: MaxPoints = MAX_POINTS,
    state: State = None,
    report: Annotated[
        Path | None,
        typer.Option(
            help="Write the operator's report (.json), which lists points: for the owner only."
        ),
    ] = None,
    picture: Picture = "",
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Verify a scan, or the scans of a drive as one chain.

    The exit code is 0 if everything is authentic, 3 if something was tampered with, and 4 if the
    verdict is undecidable. In a drive, missing frames are noticed, also at its end. A single scan
    is judged by its content alone, whatever its place in a drive. In a folder, a record without
    its scan, or a file that holds no scan, is undecidable; a scan that was removed together with
    its record is noticed in a drive only. Coordinates and intensities are verified; other columns,
    and the grid and the viewpoint of a PCD file, are not signed. Text files and arrays of a folder
    or drive (.csv, .npy) are verified if a record is beside them. With several keys, the record
    states which one made it.

    Example: manip3d watermark verify signed --key sensor.key
    """
    from manip3d import authenticate

    shell = Terminal(as_json=as_json, quiet=quiet)
    check_output(report, (".json",), force=force, option="--report")
    if source == "-":
        raise InputError("source: expected a scan or a drive, got -: stdin has no record")
    if Path(source).suffix != authenticate.RECORD_SUFFIX:
        expect_kind(source, "scan", "drive", verb="watermark verify")
    policy = policy_of(
        embedding=embedding,
        sensor=sensor,
        session=session,
        max_age=max_age,
        max_points=max_points,
        order="chain" if Path(source).is_dir() else "any",
        carrier="picture" if picture else "sidecar",
    )
    with (
        naming_options("picture", "record"),
        authenticate.KeyRing.open(key) as ring,
        authenticate.Watermarker(ring, state=state) as marker,
        shell.progress("verify") as progress,
    ):
        found = authenticate.verify_files(
            marker, source, policy=policy, record=record, picture=picture, progress=progress
        )
    shell.result({"source": source} | found.record(), lambda console: _show(console, found))
    if report is not None:  # after the verdict, which is printed even if the disk is full
        _write_private(report, {"source": source} | found.record(operator=True))
        shell.say(f"wrote {report}")
    raise typer.Exit(EXIT_CODES[found.verdict])


def _write_private(path: Path, value: dict[str, Any]) -> None:
    """Write JSON to a file that only its owner can read; pipes and devices keep their modes."""
    from manip3d.io._files import atomic_write

    if not path.exists():
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    if path.is_file():
        path.chmod(0o600)
    atomic_write(path, json.dumps(value, indent=1) + "\n")


def _show(console: Console, found: VerifiedFiles) -> None:
    console.print(f"{found.verdict}: {found.reason}", soft_wrap=True)
    bad = [(name, each) for name, each in found.frames if each.verdict != "authentic"]
    rows = list(_rows(bad[:20]))
    if rows:
        console.print()
        table(console, rows, ("scan", "verdict", "order", "sectors, degrees", "reason"))
    if len(bad) > 20:
        console.print(f"and {len(bad) - 20} more")


def _rows(results: Sequence[tuple[str, Any]]) -> Iterator[tuple[str, ...]]:
    for name, found in results:
        sectors = [
            f"{begin:.0f}-{end:.0f}"
            for number in found.changed_tiles
            for begin, end in found.tiles[number].azimuths_deg
        ]
        shown = ", ".join(sectors[:6]) + (" ..." if len(sectors) > 6 else "")
        yield name, found.verdict, found.order, shown, found.reason
