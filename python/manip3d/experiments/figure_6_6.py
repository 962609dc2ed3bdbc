"""Figure 6.6: MIN_ipd over range, its moving average, and sudden changes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np

from manip3d.experiments import _forensic_views, _forensics
from manip3d.experiments._model import Claim, Experiment, Finding, Row


def _falls(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        off = {name: len(row["views"][name]["offending"]) for name in ("original", "CTP", "CRTP")}
        holds = off["CTP"] > 0 and off["original"] == off["CRTP"] == 0
        numbers = ", ".join(f"{name}: {count} ranges" for name, count in off.items())
        yield Finding(row["model"], holds, numbers)


def _grows(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        view = row["views"]["original"]
        r, d = np.asarray(view["ranges"]), np.asarray(view["smooth_mm"])
        near, far = d[(r > 4) & (r < 8)], d[(r > 16) & (r < 24)]
        if len(near) and len(far):
            a, b = float(np.median(near)), float(np.median(far))
            yield Finding(row["model"], b > a, f"{a:.1f} mm at 4 to 8 m, {b:.1f} mm at 16 to 24 m")


EXPERIMENT = Experiment(
    id="figure-6.6",
    title="Spacing over range: original, CTP and CRTP",
    published="",
    data=_forensics.HOAXES,
    cases=partial(_forensic_views.cases, kind="outdoor"),
    columns=_forensic_views.COLUMNS,
    claims=(
        Claim("Spacing grows with distance in original scans", "figure 6.6", _grows),
        Claim(
            "A dense hoax makes a sudden, persistent drop, a resampled one does not",
            "figure 6.6",
            _falls,
        ),
    ),
    figures=_forensic_views.signals,
    notes=(_forensics.resolution_note, _forensics.NOTE),
)
