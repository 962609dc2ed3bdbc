"""Figure 4.6: the phantom leg of a seated person."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from manip3d.experiments import _phantom
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(
            view_leg,
            {
                "model": f"{limb.replace('_', ' ')}, {motion.replace('-', ' ')}",
                "limb": limb,
                "scene": {
                    "motion": motion,
                    "amputated": limb,
                    "cover": "both",
                    "seed": plan.seed,
                },
                "time": 1.0,
            },
        )
        for limb, motion in (("right_leg", "knee-extension"), ("left_leg", "dorsiflexion"))
    ]


def view_leg(case: Case) -> Row:
    """Draw the scene, the person, and the person with the phantom leg."""
    from manip3d.viewer import people

    options = case.options
    (outcome,) = _phantom.outcomes(
        options["scene"], {"affected": options["limb"]}, [options["time"]]
    )
    box = _phantom.box_of(outcome.phantom.kinds > 0)
    color = outcome.frame.color
    assert color is not None
    truth = _phantom.true_cover(outcome, options["limb"])
    shown = _phantom.covered(outcome.phantom)
    return {
        "views": {
            "a) scene": _phantom.packed(np.ascontiguousarray(color[box])),
            "b) as captured": _phantom.packed(
                people.textured_picture(outcome.phantom, color, with_phantom=False)[box]
            ),
            "c) with the phantom": _phantom.packed(
                people.textured_picture(outcome.phantom, color)[box]
            ),
        },
        "phantom": int(shown.sum()),
        "coverage": float((shown & truth).sum() / truth.sum()),
        "median_error": float(np.median(_phantom.errors(outcome, options["limb"]))),
    }


def _there(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        error = row["median_error"] * 1e3
        numbers = f"{row['coverage']:.1%} of what a leg would show, median {error:.1f} mm"
        yield Finding(row["model"], row["coverage"] > 0.8, numbers)


EXPERIMENT = Experiment(
    id="figure-4.6",
    title="A phantom leg of somebody who sits",
    published="",
    data=(),
    cases=_cases,
    role=_phantom.ROLE,
    columns=(
        Column("phantom", "pixels of the phantom"),
        Column("coverage", "of the true view, %", 1e2, 1),
        Column("median_error", "median error, mm", 1e3, 2),
    ),
    claims=(Claim("The phantom leg is there", "figure 4.6", _there),),
    figures=_phantom.panels,
    notes=(_phantom.NOTE,),
)
