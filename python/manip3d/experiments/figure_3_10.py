"""Figure 3.10: error maps of each method, Dragon at 5 %."""

from __future__ import annotations

from manip3d.experiments import _depth_pictures
from manip3d.experiments._depth import (
    DATA_NOTE,
    METHODS,
    NOTE,
    QEM_NOTE,
    QUALITY_COLUMNS,
    complete_quality,
    models,
    real_data,
    reduction_case,
)
from manip3d.experiments._depth_claims import cs3_below_others
from manip3d.experiments._model import Case, Experiment, Plan

_MODELS = ("Dragon",)


def _cases(plan: Plan) -> list[Case]:
    return [
        reduction_case(model, method, plan, share=0.05)
        for model in models(plan, _MODELS)
        for method in METHODS
    ]


EXPERIMENT = Experiment(
    id="figure-3.10",
    title="Where the error is, 5 %",
    published="",
    data=real_data(_MODELS),
    cases=_cases,
    columns=QUALITY_COLUMNS,
    claims=(
        cs3_below_others(
            ("uniform", "poisson", "ssa"),
            "metro_vertex",
            "Metro (at every vertex of the dense mesh)",
            "figure 3.10",
        ),
    ),
    complete=complete_quality,
    sheets=_depth_pictures.error_sheets,
    notes=(DATA_NOTE, NOTE, QEM_NOTE),
)
