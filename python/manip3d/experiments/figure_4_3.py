"""Figure 4.3: the steps of a phantom arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from manip3d.experiments import _phantom
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_LIMB = "right_arm"
_TRUNK = (1, 20, 4, 8, 12, 16)


def _cases(plan: Plan) -> list[Case]:
    scene = {"motion": "arm-raise", "side": "both", "seed": plan.seed}
    return [Case(view_steps, {"model": "right arm, 8 feet", "scene": scene, "time": 1.3})]


def view_steps(case: Case) -> Row:
    """Make pictures a to e and count the pixels that each step changes."""
    from manip3d.simulate import LIMBS
    from manip3d.viewer import people

    scene, time = case.options["scene"], case.options["time"]
    (outcome,) = _phantom.outcomes(scene, {"affected": _LIMB}, [time])
    frame, phantom = outcome.frame, outcome.phantom
    labels, printed = (_phantom.segmented(frame, rule) for rule in ("skin", "paper"))
    mine = (frame.body_index == 0) & (frame.depth > 0)
    of_trunk = mine & np.isin(outcome.truth.bones, _TRUNK)
    limbs = np.concatenate([chain[1:] for chain in LIMBS.values()])
    removed = _phantom.drawn(phantom, "BODY")
    added = removed | _phantom.drawn(phantom, "PHANTOM", "AWAY")
    box = _phantom.box_of(mine | (phantom.kinds > 0))
    metres = frame.depth / 1000.0
    grey = _phantom.grey_view(metres[mine], box)

    wanted = mine | _phantom.true_cover(outcome, _LIMB)
    limb = np.isin(outcome.truth.bones, LIMBS[_LIMB][1:]) & mine
    return {
        "views": {
            "a) depth": grey(np.where(mine, metres, 0.0)),
            "b) segmented": _phantom.packed(people.label_picture(labels)[box]),
            "b) by eq. 4.1": _phantom.packed(people.label_picture(printed)[box]),
            "c) arm removed": grey(np.where(removed, phantom.depth, 0.0)),
            "d) mirrored": grey(np.where(added, phantom.depth, 0.0)),
            "e) holes filled": grey(phantom.depth),
        },
        "person": int(mine.sum()),
        "limb": int(limb.sum()),
        "left": int((limb & removed).sum()),
        "trunk": int(of_trunk.sum()),
        "taken": int((of_trunk & np.isin(labels, limbs)).sum()),
        "taken_paper": int((of_trunk & np.isin(printed, limbs)).sum()),
        "mirrored": int((added & ~removed).sum()),
        "filled": int(_phantom.drawn(phantom, "FILLED").sum()),
        "holes_before": sum(_phantom.hole_sizes(added, wanted)),
        "holes_after": sum(_phantom.hole_sizes(phantom.kinds > 0, wanted)),
    }


def _removed(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        share = row["left"] / row["limb"]
        yield Finding(row["model"], share < 0.05, f"{row['left']} of {row['limb']} pixels are left")


def _trunk(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = (
            f"{row['taken']} of {row['trunk']} pixels told to be a limb's, by eq. 4.1 "
            f"{row['taken_paper']}"
        )
        yield Finding(row["model"], row["taken"] < row["taken_paper"], numbers)


def _filled(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['holes_before']} pixels enclosed before, {row['holes_after']} after"
        yield Finding(row["model"], row["holes_after"] < row["holes_before"], numbers)


EXPERIMENT = Experiment(
    id="figure-4.3",
    title="Steps of a phantom arm",
    published="",
    data=(),
    cases=_cases,
    role=_phantom.ROLE,
    columns=(
        Column("person", "pixels of the person"),
        Column("limb", "of the arm, in truth"),
        Column("left", "of these, left"),
        Column("trunk", "of the trunk"),
        Column("taken", "of these, told to be limbs"),
        Column("taken_paper", "by eq. 4.1"),
        Column("mirrored", "mirrored"),
        Column("filled", "filled"),
    ),
    claims=(
        Claim("The affected arm is removed", "section 4.3.1", _removed),
        Claim("A trunk keeps its flanks where bones have thickness", "aim", _trunk),
        Claim("Rounding leaves holes, and filling closes them", "section 4.3.1", _filled),
    ),
    figures=_phantom.panels,
    notes=(_phantom.NOTE,),
)
