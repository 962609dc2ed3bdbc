"""``manip3d forge alert-set``: write the frames of table 7.2, original and attacked, as files."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from manip3d.cli.terminal import Terminal, counted
from manip3d.cli.truth import truth_of
from manip3d.errors import InputError
from manip3d.io._files import atomic_pair, atomic_write, regular_bytes

if TYPE_CHECKING:
    from manip3d.forge import Forgery
    from manip3d.lidar import LidarFrame

MANIFEST = "manifest.csv"
_COLUMNS = ("file", "drive", "frame", "attack", "points", "added", "moved", "removed")
_SIZES = ("scan_bytes", "truth_bytes")
"""Further columns of a piece, by which a resumed run checks that its files are complete."""
_SETTINGS = "set.json"
_PIECES = "pieces"
_PIECE = 5
"""Number of frames in a piece; a run that is stopped loses at most one piece."""


class _Piece(NamedTuple):
    """Consecutive frames of a drive, and the number of frames for each attack."""

    drive: int
    first: int
    frames: Mapping[str, int]


def write_set(
    output: Path, frames: int | None, seed: int, shell: Terminal, *, force: bool
) -> dict[str, Any]:
    """Write the set, or the pieces that an earlier run did not finish, and its manifest.

    Raises
    ------
    InputError
        Without ``force``: the folder holds other files, or a set with other settings.
    """
    _begin(output, {"seed": seed, "frames": frames}, force=force)
    pieces = list(_pieces(frames))
    rows: list[dict[str, Any]] = []
    with shell.progress("alert-set") as bar:
        progress = bar or shell.line  # without a terminal, a line is printed for each piece
        for number, piece in enumerate(pieces):
            done = output / _PIECES / f"drive_{piece.drive}-{piece.first:05d}.csv"
            found = _whole_rows(done, output)
            if found is None:
                found = list(_written(piece, output, seed))
                atomic_write(done, _csv(found, (*_COLUMNS, *_SIZES)))
            rows += found
            progress((number + 1) / len(pieces), done.stem)
    atomic_write(output / MANIFEST, _csv(rows, _COLUMNS))
    written = Counter(str(row["attack"]) for row in rows)
    wanted: Counter[str] = Counter()
    for piece in pieces:
        wanted.update(piece.frames)
    missing = wanted.total() - written.total()
    if missing:
        shell.say(f"{counted(missing, 'attack')} left out: no object of those frames can be "
                  "attacked so and stand in a free place")  # fmt: skip
    shell.say(f"wrote {counted(len(rows), 'scan')} to {output}")
    return {
        "output": str(output),
        "seed": seed,
        "scans": len(rows),
        "attacks": {name: {"wanted": wanted[name], "written": written[name]} for name in wanted},
    }


def _told(settings: object) -> str:
    if not isinstance(settings, Mapping):
        return str(settings)
    told = (f"--{name} {'all' if v is None else v}" for name, v in settings.items())
    return " ".join(told) or "no options"


def _begin(output: Path, settings: Mapping[str, Any], *, force: bool) -> None:
    """Create the folder, or check that it holds a part of the same set."""
    path = output / _SETTINGS
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: expected a folder's name, got a file's")
    if not force and path.is_file():
        try:
            found = json.loads(regular_bytes(path))
        except ValueError:
            found = "no JSON"
        if found != settings:
            raise InputError(
                f"{output}: expected a part of the set of {_told(settings)}; it is of "
                f"{_told(found)}; --force begins anew"
            )
        return
    if not force and output.is_dir() and any(output.iterdir()):
        raise InputError(f"{output}: expected an empty folder or a part of the set; --force "
                         "writes into it all the same")  # fmt: skip
    for old in _files_of_set(output):
        old.unlink()
    (output / _PIECES).mkdir(parents=True, exist_ok=True)
    atomic_write(path, json.dumps(dict(settings)) + "\n")


def _files_of_set(output: Path) -> list[Path]:
    """Return the files of an earlier set, pieces first: without these, their frames are remade."""
    from manip3d.experiments import _alert_set

    scan = f"{'[0-9]' * 6}.bin.xz"
    patterns = [f"{_PIECES}/drive_*.csv", MANIFEST]
    for attack in _alert_set.ATTACKS:
        patterns += [f"drive_*/{attack}/{scan}", f"drive_*/{attack}/{scan}.truth.json"]
    return [path for pattern in patterns for path in output.glob(pattern)]


def _pieces(frames: int | None) -> Iterator[_Piece]:
    from manip3d.experiments import _alert_set

    for drive in _alert_set.DRIVES:
        wanted = {name: _alert_set.published_frames(drive, name) for name in _alert_set.ATTACKS}
        if frames is not None:
            wanted = {name: min(count, frames) for name, count in wanted.items()}
        for first in range(0, max(wanted.values()), _PIECE):
            inside = {name: min(max(of - first, 0), _PIECE) for name, of in wanted.items()}
            yield _Piece(drive, first, inside)


def _written(piece: _Piece, output: Path, seed: int) -> Iterator[dict[str, Any]]:
    """Write the scans of a piece with their truth, and yield their rows of the manifest."""
    from manip3d.experiments import _alert_set

    street = _alert_set.seed_of(piece.drive, seed)
    made = _alert_set.frames(street, piece.first, max(piece.frames.values()))
    for number, frame, boxes in made:
        for attack, count in piece.frames.items():
            if number >= piece.first + count:
                continue
            name = f"drive_{piece.drive}/{attack}/{number:06d}.bin.xz"
            place = {"file": name, "drive": piece.drive, "frame": number, "attack": attack}
            if attack == "original":
                counts = _whole(frame, output / name)
                yield place | counts | _sizes(output / name)
                continue
            forged = _alert_set.attacked(frame, boxes, attack)
            if forged is not None:
                counts = _forged(forged, output / name, place)
                yield place | counts | _sizes(output / name)


def _whole(frame: LidarFrame, path: Path) -> dict[str, int]:
    path.parent.mkdir(parents=True, exist_ok=True)
    frame.write(path)
    return {"points": frame.num_points, "added": 0, "moved": 0, "removed": 0}


def _forged(forged: Forgery, path: Path, place: Mapping[str, Any]) -> dict[str, int]:
    path.parent.mkdir(parents=True, exist_ok=True)
    truth = path.with_name(f"{path.name}.truth.json")
    with atomic_pair(path, truth) as (scan, told):
        forged.write(scan)
        told.write_text(json.dumps(truth_of(forged, path) | dict(place)) + "\n", encoding="utf-8")
    counts = {name: len(getattr(forged, name)) for name in ("added", "moved", "removed")}
    return {"points": len(forged.points), **counts}


def _whole_rows(piece: Path, output: Path) -> list[dict[str, Any]] | None:
    """Return the rows of a piece if all its files exist with their recorded sizes, else None."""
    if not piece.is_file():
        return None
    rows: list[dict[str, Any]] = list(csv.DictReader(io.StringIO(regular_bytes(piece).decode())))
    for row in rows:
        sizes = _sizes(output / row["file"])
        if any(row.get(name) != str(size) for name, size in sizes.items()):
            return None
    return rows


def _sizes(path: Path) -> dict[str, int]:
    """Return the sizes of a scan and of its truth in bytes; 0 for a missing file."""
    files = (path, path.with_name(f"{path.name}.truth.json"))
    return {
        name: file.stat().st_size if file.is_file() else 0
        for name, file in zip(_SIZES, files, strict=True)
    }


def _csv(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> str:
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns, lineterminator="\n", extrasaction="ignore")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()
