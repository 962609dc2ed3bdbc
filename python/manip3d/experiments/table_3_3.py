"""Table 3.3: time of the methods at 5 % of the points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from manip3d.experiments._depth import (
    DATA_NOTE,
    METHOD_COLUMN,
    METHODS,
    NOTE,
    QEM_NOTE,
    REAL_TIME,
    TIME_NOTE,
    listing,
    models,
    printed_time,
    real_data,
    reduction_case,
)
from manip3d.experiments._depth_claims import cs3_twenty_times_faster
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row, by_model

_TABLE = "table_3_3_time_ms"


def cases(plan: Plan) -> list[Case]:
    """Return the cases of each range image by each method at 5 %, shared with table 3.4.

    SSA is used for single objects only.
    """
    return [
        reduction_case(model, method, plan, share=0.05)
        for model in models(plan)
        for method in METHODS
        if method != "ssa" or model.kind != "scene"
    ]


def _complete(row: Row) -> Row:
    return row | {"published_time": printed_time(_TABLE, row)}


def _faster_than_qem(rows: Sequence[Row]) -> Iterator[Finding]:
    yield from cs3_twenty_times_faster(rows, "qem4vr")


def _faster_than_fmeps(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, _ in by_model(rows):
        yield Finding(model, None, "Lindstrom-Turk is measured in benchmarks/RESULTS.md")


def _real_time(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if row["method"] == "cios":
            yield Finding(row["model"], row["time_ms"] < 100, f"{row['time_ms']:.2f} ms")


def _uniform_is_quickest(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, group in by_model(rows):
        present = {m: group[m] for m in REAL_TIME if m in group}
        quickest = min(present, key=lambda method: float(present[method]["time_ms"]))
        yield Finding(model, quickest == "uniform", f"{listing(present, 'time_ms', digits=2)} ms")


EXPERIMENT = Experiment(
    id="table-3.3",
    title="Time of the methods, 5 % of the points",
    published=_TABLE,
    data=real_data(),
    cases=cases,
    columns=(
        METHOD_COLUMN,
        Column("points", "vertices"),
        Column("faces", "faces"),
        Column("time_ms", "ms", 1.0, 2, "published_time", lower_is_better=True),
    ),
    claims=(
        Claim("CS3 is at least 20 times faster than QEM", "table 3.3", _faster_than_qem),
        Claim(
            "CS3 is thousands of times faster than Lindstrom-Turk (FMEPS)",
            "table 3.3",
            _faster_than_fmeps,
            reported=True,
        ),
        Claim("CS3 works in real time: less than 100 ms an image", "section 3.6", _real_time),
        Claim("The uniform grid takes the least time", "section 3.6", _uniform_is_quickest),
    ),
    complete=_complete,
    notes=(
        DATA_NOTE,
        NOTE,
        QEM_NOTE,
        TIME_NOTE,
        "The uniform grid is cheap to choose; most of its time here is the check of its triangles, "
        "which the baselines do in NumPy and CS3 in the core.",
    ),
)
