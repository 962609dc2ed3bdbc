"""Figure 3.12: Person 3 at 10 % by all methods."""

from __future__ import annotations

from manip3d.experiments import _depth_pictures
from manip3d.experiments._depth import (
    DATA_NOTE,
    ERROR_COLUMNS,
    METHODS,
    NOTE,
    QEM_NOTE,
    models,
    real_data,
    reduction_case,
)
from manip3d.experiments._depth_claims import cs3_below_others
from manip3d.experiments._model import Case, Experiment, Plan

_MODELS = ("Person 3",)


def _cases(plan: Plan) -> list[Case]:
    return [
        reduction_case(model, method, plan, share=0.1)
        for model in models(plan, _MODELS)
        for method in METHODS
    ]


EXPERIMENT = Experiment(
    id="figure-3.12",
    title="A person at 10 %, all methods",
    published="",
    data=real_data(_MODELS),
    cases=_cases,
    columns=ERROR_COLUMNS,
    claims=(
        cs3_below_others(
            ("uniform", "poisson", "ssa"),
            "metro_area",
            "Metro (area sampling)",
            "figure 3.12",
        ),
    ),
    sheets=_depth_pictures.sheets,
    notes=(
        DATA_NOTE,
        NOTE,
        QEM_NOTE,
        "Poisson disks are spread over the surface, by distances in space.",
    ),
)
