"""Table 7.2, columns of the watermark: detected attacks, and clean frames judged as forged."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d._util.shares import wilson
from manip3d.experiments import _alert_set
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from manip3d.lidar import Box, LidarFrame

_ATTACKS = _alert_set.ATTACKS

_KINDS = ("paper lbm", "paper qim", "keyed lbm", "keyed qim", "keyed detached")

_QUICK_FRAMES = 3

_PIECE = 5
"""Number of frames of a case; a stopped run loses at most this number in each process."""


def _cases(plan: Plan) -> list[Case]:
    """Return pieces of drives as cases; each embeds a frame once and attacks it in every way."""
    cases = []
    for drive in _alert_set.DRIVES:
        frames = {
            attack: _QUICK_FRAMES
            if plan.scale == "quick"
            else _alert_set.published_frames(drive, attack)
            for attack in _ATTACKS
        }
        for first in range(0, max(frames.values()), _PIECE):
            inside = {name: min(max(of - first, 0), _PIECE) for name, of in frames.items()}
            options = {
                "model": f"drive {drive}",
                "seed": _alert_set.seed_of(drive, plan.seed),
                "scale": plan.scale,
                "first": first,
                "frames": inside,
            }
            cases.append(Case(detect, options))
    return cases


def detect(case: Case) -> Row:
    """Embed each frame, attack it in every way, and count the frames that verifiers call forged."""
    options = case.options
    counts = {f"{attack} {kind}": 0 for attack in _ATTACKS for kind in (*_KINDS, "attacked")}
    with tempfile.TemporaryDirectory() as folder:
        first, frames = options["first"], options["frames"]
        for number, frame, boxes in _alert_set.frames(options["seed"], first, max(frames.values())):
            attacks = [attack for attack in _ATTACKS if number < first + frames[attack]]
            for attack, told in _verdicts(frame, boxes, attacks, number, Path(folder)).items():
                counts[f"{attack} attacked"] += 1
                for kind in _KINDS:
                    counts[f"{attack} {kind}"] += told[kind]
    return counts


def _verdicts(
    frame: LidarFrame, boxes: Sequence[Box], attacks: Sequence[str], number: int, folder: Path
) -> dict[str, dict[str, bool]]:
    """Return by attack whether each verifier calls the frame forged.

    Attacks without a possible target are left out.
    """
    from manip3d import authenticate

    found: dict[str, dict[str, bool]] = {}
    blocks = authenticate.noise_blocks(number)

    def ask(kind: str, sent: LidarFrame, is_forged: Callable[[LidarFrame], bool]) -> None:
        for attack in attacks:
            received = _received(sent, boxes, attack)
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
    # Embeddings move points by millimetres, so that a place can be free in only some of the frames.
    return {attack: told for attack, told in found.items() if len(told) == len(_KINDS)}


def _received(frame: LidarFrame, boxes: Sequence[Box], attack: str) -> LidarFrame | None:
    if attack == "original":
        return frame
    made = _alert_set.attacked(frame, boxes, attack)
    return None if made is None else made.frame


def _gathered(rows: Sequence[Row]) -> list[Row]:
    """Add up the rows of pieces to rows of the table, one for each drive and attack."""
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
    for line in _alert_set.published_lines():
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
            low, high = wilson(mine, of)
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
    published=_alert_set.TABLE,
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
        "alternative of section 7.6), not made of stereo depth. An attack takes the nearest object "
        "of 20 points that it can put into a free place; frames without one are left out. The "
        "attackers of this table know nothing of the watermark: one who reads the printed bits and "
        "writes them back passes it, and only the keyed one notices. The published columns of the "
        "cross-modal check are not measured here.",
    ),
)
