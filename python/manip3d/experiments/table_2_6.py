"""Table 2.6: FMPD of the non-textured models at roughly 10 % of their faces."""

from __future__ import annotations

from manip3d.experiments import _fmpd, _pictures
from manip3d.experiments._model import Experiment
from manip3d.experiments._simplification import (
    DATA_NOTE,
    MEASURE_NOTE,
    complete,
    equal_methods,
    real_data,
)
from manip3d.experiments.table_2_2 import cases

EXPERIMENT = Experiment(
    id="table-2.6",
    title="Perceptual distance FMPD, non-textured models at roughly 10 %",
    published="table_2_6_2_7_fmpd",
    data=real_data(textured=False),
    cases=cases,
    columns=_fmpd.COLUMNS,
    claims=(
        _fmpd.SAME_ORDER,
        _fmpd.BLIND_TO_GAPS,
        equal_methods(
            (("qem-orig", "qem-bp"), ("qem-orig", "qem4vr")),
            "fmpd",
            ("RockerArm",),
            "On RockerArm the FMPD of the three methods is similar (within 5 %)",
            "section 2.5.4",
            scale=1.0,
            within=0.05,
        ),
    ),
    complete=complete,
    sheets=_pictures.sheets,
    notes=(DATA_NOTE, MEASURE_NOTE, _fmpd.note),
)
