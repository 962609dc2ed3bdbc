"""Figure 6.5: an indoor scan, forged by CTP, CRTP and subtraction."""

from __future__ import annotations

from functools import partial

from manip3d.experiments import _forensic_views, _forensics
from manip3d.experiments._model import Experiment

EXPERIMENT = Experiment(
    id="figure-6.5",
    title="Forgeries of an indoor scan",
    published="",
    data=_forensics.HOAXES,
    cases=partial(_forensic_views.cases, kind="indoor"),
    columns=_forensic_views.COLUMNS,
    figures=partial(
        _forensic_views.range_images,
        names=("original", "CTP", "CRTP", "original at the object", "subtractive"),
        title="Range images, nearest point of each cell",
    ),
    notes=(_forensics.resolution_note, _forensics.NOTE),
)
