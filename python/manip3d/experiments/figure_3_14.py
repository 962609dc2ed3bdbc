"""Figure 3.14: texture error of Cabinet at 5 %."""

from __future__ import annotations

from manip3d.experiments._texture_figures import texture_figure

EXPERIMENT = texture_figure("3.14", "Cabinet", 0.05)
