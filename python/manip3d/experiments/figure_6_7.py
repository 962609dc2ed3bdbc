"""Figure 6.7: an outdoor scan, forged by CTP, CRTP and deformation."""

from __future__ import annotations

from functools import partial

from manip3d.experiments import _forensic_views, _forensics
from manip3d.experiments._model import Experiment

EXPERIMENT = Experiment(
    id="figure-6.7",
    title="Forgeries of an outdoor scan",
    published="",
    data=_forensics.HOAXES,
    cases=partial(_forensic_views.cases, kind="outdoor"),
    columns=_forensic_views.COLUMNS,
    figures=partial(
        _forensic_views.range_images,
        names=("original", "CTP", "CRTP", "original at the object", "deforming"),
        title="Range images, nearest point of each cell",
    ),
    notes=(_forensics.resolution_note, _forensics.NOTE),
)
