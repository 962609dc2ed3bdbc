"""Figure 3.5: 4 % of the Dragon's points, by a uniform grid and by CS3."""

from __future__ import annotations

from manip3d.experiments import _depth_pictures
from manip3d.experiments._depth import (
    DATA_NOTE,
    ERROR_COLUMNS,
    NOTE,
    models,
    real_data,
    reduction_case,
)
from manip3d.experiments._depth_claims import cs3_below_others
from manip3d.experiments._model import Case, Experiment, Plan

_MODELS = ("Dragon",)


def _cases(plan: Plan) -> list[Case]:
    return [
        reduction_case(model, method, plan, share=0.04)
        for model in models(plan, _MODELS)
        for method in ("uniform", "cios", "relief")
    ]


EXPERIMENT = Experiment(
    id="figure-3.5",
    title="Chosen points, 4 %: uniform grid and CS3",
    published="",
    data=real_data(_MODELS),
    cases=_cases,
    columns=ERROR_COLUMNS,
    claims=(cs3_below_others(("uniform",), "metro_area", "Metro (area sampling)", "figure 3.5"),),
    sheets=_depth_pictures.point_sheets,
    notes=(
        DATA_NOTE,
        NOTE,
        "The figure shows the points; the claim on the error is this package's.",
    ),
)
