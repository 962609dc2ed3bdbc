"""Table 7.1, steps of the watermark: milliseconds per frame."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manip3d.experiments import _alert_set, _published
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from manip3d.lidar import LidarFrame

_TABLE = "table_7_1_alert_time_ms"

_ROUNDS = {"quick": 5, "full": 60}
_AIM_MS = 6.0

STEPS: Mapping[str, tuple[str, ...]] = {
    "ordering points": ("ordering points (a)",),
    "LBM embedding": ("LBM embedding (b)",),
    "QIM embedding": ("QIM embedding (c)",),
    "transmit with LBM": ("transmit with LBM (a+b)",),
    "transmit with QIM": ("transmit with QIM (a+c)",),
    "LBM extraction and comparison": ("LBM extraction (d)", "watermark comparison (f)"),
    "QIM extraction and comparison": ("QIM extraction (e)", "watermark comparison (f)"),
    "receive with LBM": ("receive with LBM (a+d+f)",),
    "receive with QIM": ("receive with QIM (a+e+f)",),
}
"""Lines of the published table whose times add up to a step of this package."""

_WHOLE = tuple(step for step in STEPS if step.split()[0] in ("transmit", "receive"))


def _cases(plan: Plan) -> list[Case]:
    return _alert_set.cases_of_drives(time_step, plan, "step", STEPS, rounds=_ROUNDS[plan.scale])


def time_step(case: Case) -> Row:
    """Measure processor time of one thread, the median over rounds, milliseconds."""
    return time_frame(_frame(case.options["seed"]), case.options["step"], case.options["rounds"])


@cache
def _frame(seed: int) -> LidarFrame:
    _, frame, _ = next(_alert_set.frames(seed, 0, 1))
    return frame


def time_frame(frame: LidarFrame, step: str, rounds: int) -> Row:
    """Measure a step on a frame, for the printed and for the keyed watermark."""
    kind = "qim" if "QIM" in step else "lbm"
    row: Row = {"points": frame.num_points}
    with tempfile.TemporaryDirectory() as folder:
        for mode, tasks in _tasks(frame, kind, Path(folder)).items():
            spent = {name: _median(task, rounds) for name, task in tasks.items()}
            if step == "ordering points":
                row[mode] = spent["order"]
            else:
                whole = spent["embed" if "embedding" in step or "transmit" in step else "verify"]
                row[mode] = whole if step in _WHOLE else whole - spent["order"]
    return row


def _tasks(
    frame: LidarFrame, kind: str, folder: Path
) -> dict[str, dict[str, Callable[[], object]]]:
    """Return the calls to time, by mode and name."""
    from manip3d import _core, authenticate

    number = authenticate.EMBEDDINGS.index(kind)
    intensity = np.empty(0, np.float32) if frame.intensity is None else frame.intensity

    def order() -> object:
        return _core.watermark_order(frame.points, intensity, number, 36, 1000)

    blocks = authenticate.noise_blocks(1)
    printed = "qim-printed" if kind == "qim" else "lbm"
    marked = authenticate.embed_paper(frame, blocks, embedding=printed)
    key = authenticate.KeyFile.create(folder / "experiment.key")
    marker = authenticate.Watermarker(key, embedding=kind)
    sent, verifier = marker.embed(frame), authenticate.Watermarker(key)
    policy = authenticate.Policy(order="any")

    def verify() -> object:
        verifier.reset()
        return verifier.verify(sent.frame, sent.record, policy=policy)

    return {
        "paper": {
            "order": order,
            "embed": lambda: authenticate.embed_paper(frame, blocks, embedding=printed),
            "verify": lambda: authenticate.compare_paper(marked.frame, blocks, marked.metadata),
        },
        "keyed": {"order": order, "embed": lambda: marker.embed(frame), "verify": verify},
    }


def _median(task: Callable[[], object], rounds: int) -> float:
    task()  # caches and memory are warm after the first round
    spent = []
    for _ in range(rounds):
        begun = time.thread_time_ns()
        task()
        spent.append((time.thread_time_ns() - begun) * 1e-6)
    return float(np.median(spent))


def _complete(row: Row) -> Row:
    lines = {line["step"]: line for line in _published.published_rows(_TABLE)}
    drive = row["model"].replace(" ", "_")
    return row | {"published": sum(float(lines[name][drive]) for name in STEPS[row["step"]])}


def _faster(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['paper']:.2f} and {row['keyed']:.2f} ms, published {row['published']:.1f}"
        yield Finding(
            f"{row['model']}, {row['step']}",
            max(row["paper"], row["keyed"]) < row["published"],
            numbers,
        )


def _within(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if row["step"] in _WHOLE:
            yield Finding(
                f"{row['model']}, {row['step']}", row["keyed"] <= _AIM_MS, f"{row['keyed']:.2f} ms"
            )


EXPERIMENT = Experiment(
    id="table-7.1",
    title="Time of the watermark's steps, milliseconds a frame",
    published=_TABLE,
    data=(),
    cases=_cases,
    role="one frame of each of three simulated drives of an HDL-64E",
    columns=(
        Column("step", "step"),
        Column("points", "points"),
        Column("paper", "as printed", digits=2, published="published", lower_is_better=True),
        Column("keyed", "keyed", digits=2, published="published", lower_is_better=True),
    ),
    claims=(
        Claim("Every step takes less than was published", "table 7.1", _faster),
        Claim(f"A frame is embedded or verified in at most {_AIM_MS:g} ms", "aim", _within),
    ),
    complete=_complete,
    notes=(
        "Processor time of one thread, called from Python, the median of the rounds. Embedding and "
        "extraction are the whole less the ordering, which is timed by itself. The keyed watermark "
        "hashes all points besides. The published times are of the authors' computer, and their "
        "QIM the printed one; the keyed one's is that of cells. The steps of the cross-modal check "
        "are not measured here.",
    ),
)
