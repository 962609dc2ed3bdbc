"""Table 7.2, its columns of the watermark: attacks detected, and clean frames called forged."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.experiments import _published
from manip3d.experiments._counting import interval
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from manip3d.lidar import Box, LidarFrame

_TABLE = "table_7_2_alert_detection"

_DRIVES = (1, 2, 3)

_ATTACKS = {
    "original": "original",
    "additive": "1",
    "subtractive": "2",
    "additive_subtractive": "3",
    "replacement": "4",
    "translation": "5",
    "rotation": "6",
}
"""This package's names of the attacks, and the table's."""

_KINDS = ("paper lbm", "paper qim", "keyed lbm", "keyed qim", "keyed detached")

_QUICK_FRAMES = 3

_MOST_TURNS = 100
"""Frames of a street; the next one goes on."""

_PIECE = 5
"""Frames of a case: a run that was stopped loses at most so many of each process."""


def _cases(plan: Plan) -> list[Case]:
    """Pieces of drives; each embeds a frame once and attacks it in every way."""
    cases = []
    for drive in _DRIVES:
        frames = {
            attack: _QUICK_FRAMES if plan.scale == "quick" else _published_frames(drive, attack)
            for attack in _ATTACKS
        }
        for first in range(0, max(frames.values()), _PIECE):
            inside = {name: min(max(of - first, 0), _PIECE) for name, of in frames.items()}
            options = {
                "model": f"drive {drive}",
                "seed": plan.seed + 100 * drive,
                "scale": plan.scale,
                "first": first,
                "frames": inside,
            }
            cases.append(Case(detect, options))
    return cases


def _published_frames(drive: int, attack: str) -> int:
    wanted = (str(drive), _ATTACKS[attack])
    return next(
        int(line["frames"])
        for line in _published_lines()
        if (line["drive"], line["attack"]) == wanted
    )


def _published_lines() -> tuple[dict[str, str], ...]:
    return _published.published_rows(_TABLE)


def detect(case: Case) -> Row:
    """Embed each frame, attack it in every way, and count what each verifier calls forged."""
    options = case.options
    counts = {f"{attack} {kind}": 0 for attack in _ATTACKS for kind in (*_KINDS, "attacked")}
    with tempfile.TemporaryDirectory() as folder:
        first, frames = options["first"], options["frames"]
        for number, frame, boxes in _frames(options["seed"], first, max(frames.values())):
            attacks = [attack for attack in _ATTACKS if number < first + frames[attack]]
            for attack, told in _verdicts(frame, boxes, attacks, number, Path(folder)).items():
                counts[f"{attack} attacked"] += 1
                for kind in _KINDS:
                    counts[f"{attack} {kind}"] += told[kind]
    return counts


def _frames(seed: int, first: int, count: int) -> Iterator[tuple[int, LidarFrame, tuple[Box, ...]]]:
    """Frames of simulated streets by their numbers; a street is as long as its drive.

    Each piece of a street draws its own noise, so that it needs none of those before it.
    """
    from manip3d.simulate.drives import drive
    from manip3d.simulate.lidar import TURN_PERIOD
    from manip3d.simulate.streets import street

    number, wanted = 0, range(first, first + count)
    while number < wanted.stop:
        place = street(seed)
        turns = min(_MOST_TURNS, int(min(place.duration, 1e3) / TURN_PERIOD))
        inside = range(max(wanted.start - number, 0), min(wanted.stop - number, turns))
        if inside:
            source = drive(
                place, len(inside), start=inside.start * TURN_PERIOD, pictures=False,
                rng=np.random.default_rng([seed, inside.start]), threads=1,
            )  # fmt: skip
            for turn, frame in zip(inside, source, strict=True):
                yield number + turn, _as_frame(frame.scan), frame.boxes
        number += turns
        seed += 1


def _as_frame(scan: Any) -> LidarFrame:
    from manip3d.lidar import LidarFrame

    return LidarFrame(scan.points, scan.intensity)


def _verdicts(
    frame: LidarFrame, boxes: Sequence[Box], attacks: Sequence[str], number: int, folder: Path
) -> dict[str, dict[str, bool]]:
    """By attack, whether each verifier calls the frame forged; attacks without a target are left
    out."""
    from manip3d import authenticate

    found: dict[str, dict[str, bool]] = {}
    blocks = authenticate.noise_blocks(number)

    def ask(kind: str, sent: LidarFrame, is_forged: Callable[[LidarFrame], bool]) -> None:
        for attack in attacks:
            received = _attacked(sent, boxes, attack)
            if received is not None:
                found.setdefault(attack, {})[kind] = is_forged(received)

    path = folder / "experiment.key"
    key = authenticate.KeyFile(path) if path.exists() else authenticate.KeyFile.create(path)
    with key:
        for kind in _KINDS:
            family, embedding = kind.split()
            if family == "paper":
                name = "qim-printed" if embedding == "qim" else embedding
                marked = authenticate.embed_paper(frame, blocks, embedding=name, frame=number)

                def is_inconsistent(
                    received: LidarFrame, marked: authenticate.PaperMarked = marked
                ) -> bool:
                    compared = authenticate.compare_paper(received, blocks, marked.metadata)
                    return compared.verdict == "inconsistent"

                ask(kind, marked.frame, is_inconsistent)
                continue
            with authenticate.Watermarker(key, embedding=embedding) as marker:
                sent = marker.embed(frame)

                def is_tampered(
                    received: LidarFrame,
                    marker: authenticate.Watermarker = marker,
                    sent: authenticate.Watermarked = sent,
                ) -> bool:
                    marker.reset()
                    return marker.verify(received, sent.record).verdict == "tampered"

                ask(kind, sent.frame, is_tampered)
    return found


def _attacked(frame: LidarFrame, boxes: Sequence[Box], attack: str) -> LidarFrame | None:
    """The frame after an attack on its nearest labelled object."""
    from manip3d import forge

    if attack == "original":
        return frame
    target = _nearest(frame, boxes)
    if target is None:
        return None
    if attack in ("subtractive", "translation", "rotation"):
        return forge.ALERT_ATTACKS[attack](frame, target, threads=1).frame
    inside = frame.select(target.contains(frame.points))
    center = np.asarray(target.center)
    elsewhere = np.array([-center[0], -center[1], 0.0]) - np.array([center[0], center[1], 0.0])
    if attack == "additive":
        made = forge.additive(frame, inside, offset=elsewhere, allow_collision=True, threads=1)
    elif attack == "additive_subtractive":
        made = forge.additive_subtractive(
            frame, inside, target, offset=elsewhere, allow_collision=True, threads=1
        )
    else:
        turned = inside.points * np.array(
            [-1, -1, 1], np.float32
        )  # the same object, seen from behind
        made = forge.replacement(frame, inside.replace(points=turned), target, threads=1)
    return made.frame


def _nearest(frame: LidarFrame, boxes: Sequence[Box]) -> Box | None:
    near = sorted(boxes, key=lambda box: float(np.hypot(*box.center[:2])))
    return next((b for b in near if np.count_nonzero(b.contains(frame.points)) >= 20), None)


def _gathered(rows: Sequence[Row]) -> list[Row]:
    """Rows of pieces as those of the table: a drive, an attack, its frames added up."""
    gathered = []
    for name in dict.fromkeys(row["model"] for row in rows):
        pieces = [row for row in rows if row["model"] == name]
        failed = [row["error"] for row in pieces if row["error"]]
        kept = {n: pieces[0][n] for n in pieces[0] if n not in ("first", "frames", "key", "error")}
        kept = {n: value for n, value in kept.items() if n.split()[0] not in _ATTACKS}
        error = f"{len(failed)} of {len(pieces)} pieces failed: {failed[0]}" if failed else ""
        for attack in _ATTACKS:
            sums = {
                kind: sum(row.get(f"{attack} {kind}", 0) for row in pieces)
                for kind in (*_KINDS, "attacked")
            }
            key = f"{pieces[0]['key']} {attack}"
            gathered.append(kept | {"attack": attack} | sums | {"error": error, "key": key})
    return gathered


def _complete(row: Row) -> Row:
    drive = row["model"].removeprefix("drive ")
    for line in _published_lines():
        if (line["drive"], line["attack"]) == (drive, _ATTACKS[row["attack"]]):
            return row | {
                "published frames": int(line["frames"]),
                "published lbm": int(line["lbm_detected_forged"]),
                "published qim": int(line["qim_detected_forged"]),
            }
    return row


def _detected(rows: Sequence[Row], family: str) -> Iterator[Finding]:
    forged = [row for row in rows if row["attack"] != "original"]
    yield from _counted(forged, family, "attacks detected", all_of_them=True)


def _clean(rows: Sequence[Row], family: str) -> Iterator[Finding]:
    clean = [row for row in rows if row["attack"] == "original"]
    yield from _counted(clean, family, "clean frames accused", all_of_them=False)


def _counted(
    rows: Sequence[Row], family: str, what: str, *, all_of_them: bool
) -> Iterator[Finding]:
    for kind in (kind for kind in _KINDS if kind.startswith(family)):
        if rows:
            mine, of = sum(r[kind] for r in rows), sum(r["attacked"] for r in rows)
            low, high = interval(mine, of)
            numbers = f"{mine} of {of} {what} ({low:.2%} to {high:.2%})"
            yield Finding(kind, of > 0 and mine == (of if all_of_them else 0), numbers)


def _claims(family: str, source: str) -> tuple[Claim, Claim]:
    return (
        Claim(f"Every attack is detected ({family})", source, lambda rows: _detected(rows, family)),
        Claim(f"No clean frame is accused ({family})", source, lambda rows: _clean(rows, family)),
    )


EXPERIMENT = Experiment(
    id="table-7.2",
    title="Attacks that the watermark detects, and clean frames that it accuses",
    published=_TABLE,
    data=(),
    cases=_cases,
    role="simulated drives of an HDL-64E through streets, labelled",
    columns=(
        Column("attack", "attack"),
        Column("attacked", "frames", published="published frames", ratio=False),
        Column("paper lbm", "as printed, LBM", published="published lbm", ratio=False),
        Column("paper qim", "as printed, QIM", published="published qim", ratio=False),
        Column("keyed lbm", "keyed, LBM"),
        Column("keyed qim", "keyed, QIM"),
        Column("keyed detached", "keyed, detached"),
    ),
    claims=(*_claims("paper", "table 7.2"), *_claims("keyed", "aim")),
    complete=_complete,
    gather=_gathered,
    notes=(
        "Columns are frames that were called forged. The watermark image is pseudo-random (the "
        "alternative of section 7.6), not made of stereo depth. Frames without an object of 20 "
        "points cannot be attacked and are left out. The attackers of this table know nothing of "
        "the watermark: one who reads the printed bits and writes them back passes it, and only "
        "the keyed one notices. The published columns of the cross-modal check are not measured "
        "here.",
    ),
)
