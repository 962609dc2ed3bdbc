"""Figure 4.4: texture of the phantom by calibration and by the source pixel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from manip3d.experiments import _phantom
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_LIMB = "right_arm"


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(
            view_textures,
            {
                "model": name,
                "scene": {
                    "motion": "arm-raise",
                    "amputated": _LIMB,
                    "side": "both",
                    "stripes": stripes,
                    "seed": plan.seed,
                },
                "time": 1.4,
            },
        )
        for name, stripes in (("plain shirt", False), ("striped shirt", True))
    ]


def view_textures(case: Case) -> Row:
    """Draw both textures and measure whether their colours come from the intact limb."""
    scene, time = case.options["scene"], case.options["time"]
    from manip3d.viewer import people

    views = {}
    for name, texturing in (("calibration", "calibration"), ("source pixel", "source")):
        options = {"affected": _LIMB, "texturing": texturing}
        (outcome,) = _phantom.outcomes(scene, options, [time])
        box = _phantom.box_of(outcome.phantom.kinds > 0)
        picture = people.textured_picture(outcome.phantom, outcome.frame.color)
        views[name] = _phantom.packed(picture[box])
    return {"views": views} | _origin_of_colors(outcome)


def _origin_of_colors(outcome: _phantom.Outcome) -> dict[str, Any]:
    """Return the share of the phantom's pixels whose colour truly comes from the intact limb."""
    from manip3d.simulate import LIMBS, opposite

    phantom = _phantom.drawn(outcome.phantom, "PHANTOM", "AWAY")
    row, column = np.nonzero(phantom)
    arm = np.isin(outcome.truth.bones, LIMBS[opposite(_LIMB)])
    source = outcome.phantom.source[row, column].T
    return {
        "phantom": int(phantom.sum()),
        "by_source": float(arm[source[0], source[1]].mean()),
        "by_calibration": float(arm[row, column].mean()),
    }


def _right(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['by_source']:.1%} of its pixels show the intact arm"
        yield Finding(row["model"], row["by_source"] > 0.95, numbers)


def _wrong(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['by_calibration']:.1%} of its pixels show the intact arm"
        yield Finding(row["model"], row["by_calibration"] < 0.05, numbers)


EXPERIMENT = Experiment(
    id="figure-4.4",
    title="Texture of the phantom by calibration and by the source pixel",
    published="",
    data=(),
    cases=_cases,
    role=_phantom.ROLE,
    columns=(
        Column("phantom", "pixels of the phantom"),
        Column("by_source", "intact arm's colour, by source pixel, %", 1e2, 1),
        Column("by_calibration", "by calibration, %", 1e2, 1),
    ),
    claims=(
        Claim("Texture by the source pixel is right", "figure 4.4", _right),
        Claim("Texture by calibration is wrong", "figure 4.4", _wrong),
    ),
    figures=_phantom.panels,
    notes=(
        _phantom.NOTE,
        "By calibration, the phantom gets what the camera sees at its place: the wall behind.",
    ),
)
