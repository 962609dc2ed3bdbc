"""Figure 3.13: texture error of Person 3 at 10 %."""

from __future__ import annotations

from manip3d.experiments._texture_figures import texture_figure

EXPERIMENT = texture_figure("3.13", "Person 3", 0.1)
