"""Table 2.7: FMPD of the textured models at roughly 10 % of their faces."""

from __future__ import annotations

from manip3d.experiments import _fmpd, _pictures
from manip3d.experiments._model import Experiment
from manip3d.experiments._simplification import DATA_NOTE, MEASURE_NOTE, complete, real_data
from manip3d.experiments.table_2_3 import cases

EXPERIMENT = Experiment(
    id="table-2.7",
    title="Perceptual distance FMPD, textured models at roughly 10 %",
    published="table_2_6_2_7_fmpd",
    data=real_data(textured=True),
    cases=cases,
    columns=_fmpd.COLUMNS,
    claims=(_fmpd.SAME_ORDER, _fmpd.BLIND_TO_GAPS),
    complete=complete,
    sheets=_pictures.sheets,
    notes=(DATA_NOTE, MEASURE_NOTE, _fmpd.note),
)
