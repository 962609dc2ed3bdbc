"""Figure 6.4: the stages of IsOcclusionConsistent."""

from __future__ import annotations

from functools import partial

from manip3d.experiments import _forensic_views, _forensics
from manip3d.experiments._model import Experiment

EXPERIMENT = Experiment(
    id="figure-6.4",
    title="Stages of detector II",
    published="",
    data=_forensics.HOAXES,
    cases=partial(_forensic_views.cases, kind="outdoor"),
    columns=_forensic_views.COLUMNS,
    figures=_forensic_views.masks,
    notes=(_forensics.resolution_note, _forensics.NOTE),
)
