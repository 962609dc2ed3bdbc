"""Table 3.2: time of the four variants of CS3 at a tenth of the points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from manip3d.experiments import _published
from manip3d.experiments._depth import (
    DATA_NOTE,
    METHOD_COLUMN,
    NOTE,
    TIME_NOTE,
    VARIANTS,
    listing,
    models,
    printed_time,
    real_data,
    reduction_case,
)
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row, by_model

_MODELS = ("Dragon", "Bunny", "Buddha")
_TABLE = "table_3_2_variant_time_ms"


def _cases(plan: Plan) -> list[Case]:
    wanted = _MODELS if plan.scale == "full" else ("Bunny",)
    return [
        reduction_case(model, method, plan, share=0.1)
        for model in models(plan, wanted)
        for method in VARIANTS
    ]


def _complete(row: Row) -> Row:
    printed = next(
        r for r in _published.published_rows(_TABLE) if r["model"] == row["stands_in_for"]
    )
    return row | {
        "published_time": printed_time(_TABLE, row),
        "published_points": int(printed["output_points"]),
    }


def _twice_as_fast(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, group in by_model(rows):
        slow = min(group[method]["time_ms"] for method in ("lnms", "cnms"))
        fast = max(group[method]["time_ms"] for method in ("lios", "cios"))
        yield Finding(model, slow >= 2 * fast, f"{listing(group, 'time_ms', digits=2)} ms")


def lower_than_lios(sampling: str) -> Claim:
    """Return the claim that CIOS has a lower error than LIOS (figure 3.7)."""
    name = f"metro_{sampling}"

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for row_model, group in by_model(rows):
            if {"cios", "lios"} <= set(group):
                holds = group["cios"][name] < group["lios"][name]
                yield Finding(row_model, holds, f"{listing(group, name, 1e3)} (1e-3)")

    return Claim(f"CIOS has a lower Metro ({sampling} sampling) than LIOS", "figure 3.7", judge)


EXPERIMENT = Experiment(
    id="table-3.2",
    title="Time of the four variants, a tenth of the points",
    published=_TABLE,
    data=real_data(_MODELS),
    cases=_cases,
    columns=(
        METHOD_COLUMN,
        Column("points", "vertices", published="published_points", ratio=False),
        Column("literal_count", "as printed"),
        Column("time_ms", "ms", 1.0, 2, "published_time", lower_is_better=True),
        Column("metro_area", "Metro, area, 1e-3", 1e3, 3, lower_is_better=True),
        Column("metro_vertex", "Metro, vertex, 1e-3", 1e3, 3, lower_is_better=True),
    ),
    claims=(
        Claim(
            "The importance-order variants are at least twice as fast as the suppression variants",
            "table 3.2",
            _twice_as_fast,
        ),
        lower_than_lios("area"),
        lower_than_lios("vertex"),
    ),
    complete=_complete,
    notes=(
        DATA_NOTE,
        NOTE,
        TIME_NOTE,
        "'As printed' is the number of points that the formulas give without the factor on Rd_max "
        "(or s) that brings them to the number asked for.",
    ),
)
