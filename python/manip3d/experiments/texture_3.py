"""Texture error of every range image at 5 %."""

from __future__ import annotations

from manip3d.experiments._texture_figures import texture_table

EXPERIMENT = texture_table(0.05)
