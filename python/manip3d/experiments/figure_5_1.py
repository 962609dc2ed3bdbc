"""Figures 5.1 and 5.2: a person in forged poses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from manip3d.experiments import _phantom, _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_MOTIONS = ("wave", "arm-raise", "reach")


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(view_forgery, {"model": motion, "motion": motion, "seed": plan.seed})
        for motion in _MOTIONS
    ]


def view_forgery(case: Case) -> Row:
    """Draw the recorded person, forgeries of types I and II, and a person who really moves."""
    from manip3d import forge
    from manip3d.simulate import BodySimulator
    from manip3d.viewer import people

    motion, seed = case.options["motion"], case.options["seed"]
    scene: dict[str, Any] = {"stripes": True, "seed": seed}
    actor = BodySimulator(motion="still", tracker="kinect-v2", **scene)
    other = BodySimulator(motion=motion, **scene)
    time = 1.6
    frame, pose, room = actor.frame(time), other.frame(time), actor.background(time)
    one, two = (
        next(forge.stream([frame], room, kind=kind, pose=poses).frames())
        for kind, poses in ((1, None), (2, [pose]))
    )
    views = {
        "recorded": frame.color,
        "type I": one.frame.color,
        "type II": two.frame.color,
        "type II, depth": people.depth_picture(two.frame.depth, near=1500, far=5000),
        "really done": pose.color,
    }
    real = np.asarray(pose.body_index == 0)
    still = np.asarray(frame.body_index == 0)
    box = _phantom.box_of(real | still | two.mask, 30)
    return {
        "views": {
            name: _phantom.packed(np.ascontiguousarray(np.asarray(v)[box]))
            for name, v in views.items()
        },
        "overlap": _streams.overlap(two.mask, real),
        "overlap_still": _streams.overlap(still, real),
    }


def _follows(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"IoU with the pose {row['overlap']:.2f}, before {row['overlap_still']:.2f}"
        yield Finding(row["model"], row["overlap"] > row["overlap_still"], numbers)


EXPERIMENT = Experiment(
    id="figure-5.1",
    title="Forged frames of both types",
    published="",
    data=(),
    cases=_cases,
    role=_streams.ROLE,
    columns=(
        Column("overlap", "IoU with one who takes the pose", digits=2),
        Column("overlap_still", "of the recorded person", digits=2),
    ),
    claims=(Claim("The person takes the pose", "section 5.1.2", _follows),),
    figures=_phantom.panels,
    notes=(_streams.NOTE,),
)
