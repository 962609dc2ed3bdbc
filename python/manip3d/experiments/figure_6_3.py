"""Figure 6.3: a forged scene from the front and from above, coloured by point spacing."""

from __future__ import annotations

from functools import partial

from manip3d.experiments import _forensic_views, _forensics
from manip3d.experiments._model import Experiment

EXPERIMENT = Experiment(
    id="figure-6.3",
    title="Spacing of points against distance in a forged scene",
    published="",
    data=_forensics.HOAXES,
    cases=partial(_forensic_views.cases, kind="outdoor"),
    columns=_forensic_views.COLUMNS,
    figures=_forensic_views.spacing_views,
    notes=(_forensics.resolution_note, _forensics.NOTE),
)
