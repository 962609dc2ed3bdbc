"""Table 7.2, its columns of the watermark: attacks detected, and clean frames called forged."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.errors import InputError
from manip3d.experiments import _published
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


def _cases(plan: Plan) -> list[Case]:
    printed = {(line["drive"], line["attack"]): line for line in _published_lines()}
    return [
        Case(
            detect,
            {
                "model": f"drive {drive}",
                "attack": attack,
                "seed": plan.seed + 100 * drive,
                "scale": plan.scale,
                "frames": _QUICK_FRAMES
                if plan.scale == "quick"
                else int(printed[str(drive), number]["frames"]),
            },
        )
        for drive in _DRIVES
        for attack, number in _ATTACKS.items()
    ]


def _published_lines() -> tuple[dict[str, str], ...]:
    return _published.published_rows(_TABLE)


def detect(case: Case) -> Row:
    """Embed each frame, attack it, and count the frames that each verifier calls forged."""
    options = case.options
    counts = dict.fromkeys(_KINDS, 0)
    attacked = 0
    with tempfile.TemporaryDirectory() as folder:
        for number, (frame, boxes) in enumerate(_frames(options["seed"], options["frames"])):
            told = _verdicts(frame, boxes, options["attack"], number, Path(folder))
            if told is None:
                continue
            attacked += 1
            for kind in _KINDS:
                counts[kind] += told[kind]
    return {**counts, "attacked": attacked}


def _frames(seed: int, count: int) -> Iterator[tuple[LidarFrame, tuple[Box, ...]]]:
    """Frames of simulated streets; a street is as long as its drive."""
    from manip3d.simulate.drives import drive
    from manip3d.simulate.streets import street

    done = 0
    while done < count:
        place, some = street(seed), min(100, count - done)
        try:
            for frame in drive(place, some, pictures=False, rng=seed, threads=1):
                yield _as_frame(frame.scan), frame.boxes
                done += 1
        except InputError:  # the street is shorter: the next one goes on
            if not done:
                raise
        seed += 1


def _as_frame(scan: Any) -> LidarFrame:
    from manip3d.lidar import LidarFrame

    return LidarFrame(scan.points, scan.intensity)


def _verdicts(
    frame: LidarFrame, boxes: Sequence[Box], attack: str, number: int, folder: Path
) -> dict[str, bool] | None:
    """Whether each verifier calls the attacked frame forged; None: nothing can be attacked."""
    from manip3d import authenticate

    found: dict[str, bool] = {}
    blocks = authenticate.noise_blocks(number)
    for kind in _KINDS:
        family, embedding = kind.split()
        if family == "paper":
            name = "qim-printed" if embedding == "qim" else embedding
            marked = authenticate.embed_paper(frame, blocks, embedding=name, frame=number)
            received = _attacked(marked.frame, boxes, attack)
            if received is None:
                return None
            compared = authenticate.compare_paper(received, blocks, marked.metadata)
            found[kind] = compared.verdict == "inconsistent"
            continue
        path = folder / "experiment.key"
        key = authenticate.KeyFile(path) if path.exists() else authenticate.KeyFile.create(path)
        with key, authenticate.Watermarker(key, embedding=embedding) as marker:
            sent = marker.embed(frame)
            received = _attacked(sent.frame, boxes, attack)
            if received is None:
                return None
            found[kind] = marker.verify(received, sent.record).verdict == "tampered"
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
    for kind in (kind for kind in _KINDS if kind.startswith(family)):
        forged = [row for row in rows if row["attack"] != "original"]
        if forged:
            mine, all_of = sum(r[kind] for r in forged), sum(r["attacked"] for r in forged)
            yield Finding(kind, mine == all_of > 0, f"{mine} of {all_of} attacks detected")


def _clean(rows: Sequence[Row], family: str) -> Iterator[Finding]:
    for kind in (kind for kind in _KINDS if kind.startswith(family)):
        clean = [row for row in rows if row["attack"] == "original"]
        if clean:
            mine, all_of = sum(r[kind] for r in clean), sum(r["attacked"] for r in clean)
            yield Finding(kind, mine == 0 < all_of, f"{mine} of {all_of} clean frames accused")


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
    notes=(
        "Columns are frames that were called forged. The watermark image is pseudo-random (the "
        "alternative of section 7.6), not made of stereo depth. Frames without an object of 20 "
        "points cannot be attacked and are left out. The attackers of this table know nothing of "
        "the watermark: one who reads the printed bits and writes them back passes it, and only "
        "the keyed one notices. The published columns of the cross-modal check are not measured "
        "here.",
    ),
)
