"""Table 2.2: Metro of the non-textured models at roughly 10 % of their faces."""

from __future__ import annotations

from manip3d.experiments import _pictures
from manip3d.experiments._model import Case, Experiment, Plan
from manip3d.experiments._simplification import (
    DATA_NOTE,
    MEASURE_NOTE,
    METRO_COLUMNS,
    NON_TEXTURED_METHODS,
    at_most,
    complete,
    equal_methods,
    lowest_claims,
    models,
    reaches_target,
    reaches_where_others_stop,
    real_data,
    simplification_case,
)


def cases(plan: Plan) -> list[Case]:
    """Return the cases of each non-textured model by each method, shared with table 2.6."""
    return [
        simplification_case(model, faces, method, plan)
        for model, faces in models(plan, textured=False)
        for method in NON_TEXTURED_METHODS
    ]


EXPERIMENT = Experiment(
    id="table-2.2",
    title="Mean approximation error, non-textured models at roughly 10 %",
    published="table_2_2_metro_non_textured",
    data=real_data(textured=False),
    cases=cases,
    columns=METRO_COLUMNS,
    claims=(
        *lowest_claims(
            "metro_vertex", "Metro (vertex sampling)", "table 2.2", scale=1e3, five=False
        ),
        *lowest_claims("metro_area", "Metro (area sampling)", "table 2.2", scale=1e3, five=False),
        reaches_target(),
        reaches_where_others_stop(("qem-bp",), "table 2.2"),
        equal_methods(
            (("qem-orig", "qem-bp"), ("qem-orig", "qem4vr")),
            "metro_vertex",
            ("RockerArm",),
            "On RockerArm, which has no boundary and no texture, the three methods agree",
            "table 2.2",
            scale=1e3,
        ),
        at_most(
            "metro_vertex",
            0.160e-3,
            "RockerArm",
            "RockerArm at 8 174 faces: Metro (vertex) of at most 0.160e-3",
            scale=1e3,
        ),
        at_most(
            "metro_area",
            0.142e-3,
            "RockerArm",
            "RockerArm at 8 174 faces: Metro (area) of at most 0.142e-3",
            scale=1e3,
        ),
    ),
    complete=complete,
    sheets=_pictures.sheets,
    notes=(
        DATA_NOTE,
        MEASURE_NOTE,
    ),
)
