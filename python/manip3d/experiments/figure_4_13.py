"""Figure 4.13: the steps of a phantom leg, and the second filling at its root."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from manip3d.experiments import _phantom
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_LIMB: Final = "right_leg"
_SHIFT = 0.05
"""Error of the affected hip and knee, which are detected too high, metres."""

_NARROWER = 0.15
"""Radius of the second filling, metres, that is compared with the default of 0.20 m."""

_AROUND = 0.30
"""Radius around the true hip within which missing pixels are counted, metres."""


def _cases(plan: Plan) -> list[Case]:
    scene = {"motion": "knee-extension", "side": "both", "seed": plan.seed}
    return [
        Case(view_steps, {"model": name, "scene": scene, "time": 1.2, "shift": shift})
        for name, shift in (("symmetric joints", 0.0), ("unsymmetrical joints", _SHIFT))
    ]


def view_steps(case: Case) -> Row:
    """Make pictures a to f and measure the gap at the root before and after the second filling."""
    from dataclasses import replace

    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import BodySimulator
    from manip3d.viewer import people

    options = case.options
    capture = BodySimulator(**options["scene"]).capture(options["time"])
    person = capture.frame.skeletons[0]
    joints = person.positions.copy()
    joints[[16, 17], 1] -= options["shift"]
    frame = replace(capture.frame, skeletons=(replace(person, positions=joints),))
    once = PhantomPipeline(affected=_LIMB, segmentation="paper", root_radius=0.0).process(frame)
    twice = PhantomPipeline(affected=_LIMB, segmentation="paper").process(frame)
    narrower = PhantomPipeline(affected=_LIMB, segmentation="paper", root_radius=_NARROWER).process(
        frame
    )
    mine = (frame.body_index == 0) & (frame.depth > 0)
    metres = frame.depth / 1000.0
    box = _phantom.box_of(mine | (twice.kinds > 0))
    grey = _phantom.grey_view(metres[mine], box)

    body = _phantom.drawn(once, "BODY")
    added = body | _phantom.drawn(once, "PHANTOM", "AWAY")
    around = _near_root(frame, capture.truth, mine)
    return {
        "views": {
            "a) depth": grey(np.where(mine, metres, 0.0)),
            "b) segmented": _phantom.packed(people.label_picture(_phantom.segmented(frame))[box]),
            "c) leg removed": grey(np.where(body, once.depth, 0.0)),
            "d) mirrored": grey(np.where(added, once.depth, 0.0)),
            "e) filled": grey(once.depth),
            "f) filled again": grey(twice.depth),
            f"f) within {_NARROWER:.2f} m": grey(narrower.depth),
        },
        "gap_once": int((around & (once.kinds == 0)).sum()),
        "gap_twice": int((around & (twice.kinds == 0)).sum()),
        "gap_narrower": int((around & (narrower.kinds == 0)).sum()),
        "root_filled": int(_phantom.drawn(twice, "ROOT_FILLED").sum()),
    }


def _near_root(frame: Any, truth: Any, mine: Any) -> Any:
    """Return the person's pixels around the true root, none of which should be missing."""
    points = frame.calibration.depth.unproject(frame.depth)
    return mine & (np.linalg.norm(points - truth.joints[16], axis=2) < _AROUND)


def _closed(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        before, after = row["gap_once"], row["gap_twice"]
        holds = after <= before / 2 if before else None
        numbers = f"{before} empty pixels at the root before, {after} after"
        yield Finding(row["model"], holds, numbers)


EXPERIMENT = Experiment(
    id="figure-4.13",
    title="Steps of a phantom leg, and the second filling",
    published="",
    data=(),
    cases=_cases,
    role=_phantom.ROLE,
    columns=(
        Column("gap_once", "empty at the root, one filling"),
        Column("gap_twice", "two fillings"),
        Column("gap_narrower", f"within {_NARROWER:.2f} m"),
        Column("root_filled", "pixels of the second filling"),
    ),
    claims=(
        Claim(
            "The second filling closes at least half of the gap at the root",
            "figure 4.13",
            _closed,
        ),
    ),
    figures=_phantom.panels,
    notes=(
        _phantom.NOTE,
        f"Unsymmetrical: the affected hip and knee are {_SHIFT * 100:.0f} cm too high. Gap: pixels "
        f"of the person within {_AROUND:.2f} m of the true hip that show nothing in the end. The "
        "hip of somebody who sits lies about 0.12 m below the surface, so that a radius of "
        f"{_NARROWER:.2f} m reaches little of it.",
    ),
)
