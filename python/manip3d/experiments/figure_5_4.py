"""Figure 5.4: seeds along the bones or one seed per bone, for a skeleton displaced sideways."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from manip3d.experiments import _phantom, _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(view_seeds, {"model": f"joints {cm} cm beside", "shift": cm / 100, "seed": plan.seed})
        for cm in (0, 4, 8)
    ]


def view_seeds(case: Case) -> Row:
    """Measure the share of the person's pixels with the right bone, for both kinds of seeds."""
    from dataclasses import replace

    from manip3d.modify import segment_body
    from manip3d.simulate import BodySimulator
    from manip3d.viewer import people

    capture = BodySimulator(motion="wave", seed=case.options["seed"]).capture(1.6)
    frame = capture.frame
    person = frame.skeletons[0]
    aside = (person.positions + np.array([case.options["shift"], 0.0, 0.0])).astype(np.float32)
    mine = np.asarray(capture.truth.people == 0) & (frame.depth > 0)
    mine &= np.asarray(frame.body_index == 0)
    box = _phantom.box_of(mine)
    row: Row = {"views": {"true bones": _phantom.packed(people.label_picture(_true(capture))[box])}}
    for seeds in ("middle", "line"):
        labels = segment_body(
            frame.depth,
            frame.calibration.depth,
            replace(person, positions=aside),
            segmentation="region",
            body_index=frame.body_index,
            seeds="line" if seeds == "line" else "middle",
        ).labels
        name = "many seeds" if seeds == "line" else "one seed"
        row["views"][name] = _phantom.packed(people.label_picture(labels)[box])
        row[seeds] = float((labels == capture.truth.bones)[mine].mean())
    return row


def _true(capture: object) -> np.ndarray:
    from manip3d.simulate import BodyCapture

    assert isinstance(capture, BodyCapture)
    return np.where(capture.truth.bones < 25, capture.truth.bones, 0).astype(np.uint8)


def _better(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['line']:.1%} right with many seeds, {row['middle']:.1%} with one"
        yield Finding(row["model"], row["line"] >= row["middle"], numbers)


EXPERIMENT = Experiment(
    id="figure-5.4",
    title="Many seeds and one for region growing",
    published="",
    data=(),
    cases=_cases,
    role=_streams.ROLE,
    columns=(
        Column("middle", "% right, one seed", scale=100.0, digits=1),
        Column("line", "% right, many seeds", scale=100.0, digits=1),
    ),
    claims=(Claim("Many seeds are better than one", "section 5.1.1", _better),),
    figures=_phantom.panels,
    notes=(_streams.NOTE, "True bones divide limbs at joints and the trunk by the nearest bone."),
)
