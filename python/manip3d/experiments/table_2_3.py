"""Table 2.3: Metro of the textured models at roughly 10 % of their faces."""

from __future__ import annotations

from manip3d.experiments import _pictures
from manip3d.experiments._model import Case, Experiment, Plan
from manip3d.experiments._simplification import (
    DATA_NOTE,
    MEASURE_NOTE,
    METRO_COLUMNS,
    TEXTURED_METHODS,
    below,
    complete,
    equal_methods,
    lowest_claims,
    models,
    reaches_target,
    reaches_where_others_stop,
    real_data,
    refuses_faces_without_uv,
    simplification_case,
)


def cases(plan: Plan) -> list[Case]:
    """Return the cases of each textured model by each method, shared with tables 2.4 and 2.7."""
    return [
        simplification_case(model, faces, method, plan)
        for model, faces in models(plan, textured=True)
        for method in TEXTURED_METHODS
    ]


EXPERIMENT = Experiment(
    id="table-2.3",
    title="Mean approximation error, textured models at roughly 10 %",
    published="table_2_3_2_4_textured",
    data=real_data(textured=True),
    cases=cases,
    columns=METRO_COLUMNS,
    claims=(
        *lowest_claims(
            "metro_vertex", "Metro (vertex sampling)", "table 2.3", scale=1e3, five=True
        ),
        *lowest_claims("metro_area", "Metro (area sampling)", "table 2.3", scale=1e3, five=True),
        *(
            below(name, sampling, method, "Head", scale=1e3)
            for name, sampling in (("metro_vertex", "vertex"), ("metro_area", "area"))
            for method in ("qem-tp", "qem-btp")
        ),
        reaches_target(),
        reaches_where_others_stop(("qem-bp", "qem-btp"), "table 2.3"),
        refuses_faces_without_uv(),
        equal_methods(
            (("qem-orig", "qem-bp"), ("qem-tp", "qem-btp")),
            "metro_vertex",
            ("Head",),
            "On Head, which has no boundary, preserving boundaries changes nothing",
            "table 2.3",
            scale=1e3,
        ),
    ),
    complete=complete,
    sheets=_pictures.sheets,
    notes=(
        DATA_NOTE,
        MEASURE_NOTE,
        "The published QEM4VR values of Head and Jet are not legible in table 2.3.",
    ),
)
