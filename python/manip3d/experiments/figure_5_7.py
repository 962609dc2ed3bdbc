"""Figure 5.7: segmentation by Voronoi regions and by region growing, against true bones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np

from manip3d.experiments import _phantom, _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_METHODS: dict[Literal["paper", "skin", "region"], str] = {
    "paper": "Voronoi",
    "skin": "skin",
    "region": "region growing",
}
_HEAD, _TRUNK, _ARMS = (3,), (1, 20, 2, 4, 8, 12, 16), (5, 6, 7, 9, 10, 11, 21, 22, 23, 24)


def _cases(plan: Plan) -> list[Case]:
    times = {"full": (0.4, 1.2, 2.0), "quick": (1.2,)}[plan.scale]
    return [
        Case(
            compare_methods,
            {"model": motion, "motion": motion, "times": list(times), "seed": plan.seed},
        )
        for motion in ("still", "arm-curl", "reach", "wave")
    ]


def compare_methods(case: Case) -> Row:
    """Share of pixels with their true bone: all, of the head, of arms, of the trunk."""
    from manip3d.modify import segment_body
    from manip3d.simulate import BodySimulator
    from manip3d.viewer import people

    simulator = BodySimulator(
        motion=case.options["motion"], tracker="kinect-v2", seed=case.options["seed"]
    )
    right: dict[str, list[float]] = {}
    views = {}
    for time in case.options["times"]:
        capture = simulator.capture(time)
        frame, truth = capture.frame, capture.truth.bones
        mine = (truth < 25) & (frame.depth > 0) & np.asarray(frame.body_index == 0)
        box = _phantom.box_of(mine)
        shown = np.where(truth < 25, truth, 0).astype(np.uint8)
        views["true bones"] = _phantom.packed(people.label_picture(shown)[box])
        for name, title in _METHODS.items():
            labels = segment_body(
                frame.depth,
                frame.calibration.depth,
                frame.skeletons[0],
                segmentation="region"
                if name == "region"
                else "skin"
                if name == "skin"
                else "paper",
                body_index=frame.body_index,
            ).labels
            views[title] = _phantom.packed(people.label_picture(labels)[box])
            same = labels == truth
            for part, bones in (("head", _HEAD), ("trunk", _TRUNK), ("arms", _ARMS)):
                own = mine & np.isin(truth, bones)
                kept = np.isin(labels, bones) if part != "head" else same
                right.setdefault(f"{name} {part}", []).append(float(kept[own].mean()))
            right.setdefault(f"{name} all", []).append(float(same[mine].mean()))
    return {"views": views, **{name: float(np.mean(values)) for name, values in right.items()}}


_PARTS = ("all", "head", "trunk", "arms")


def _better(rows: Sequence[Row]) -> Iterator[Finding]:
    for part in _PARTS:
        mine, theirs = (
            float(np.mean([r[f"{m} {part}"] for r in rows])) for m in ("region", "paper")
        )
        skin = float(np.mean([row[f"skin {part}"] for row in rows]))
        numbers = f"region growing {mine:.1%}, Voronoi {theirs:.1%}, skin {skin:.1%}"
        yield Finding(part, mine >= theirs, numbers)


EXPERIMENT = Experiment(
    id="figure-5.7",
    title="Voronoi regions and region growing against true bones",
    published="",
    data=(),
    cases=_cases,
    role=_streams.ROLE,
    columns=tuple(
        Column(f"{name} {part}", f"{title}, {part}, %", scale=100.0, digits=1)
        for part in _PARTS
        for name, title in _METHODS.items()
    ),
    claims=(Claim("Region growing is better than Voronoi regions", "figure 5.7", _better),),
    figures=_phantom.panels,
    notes=(
        _streams.NOTE,
        "Of trunk and arms, a pixel is right if its bone is one of the same part. True bones of "
        "the trunk are those nearest at rest, which favours Voronoi regions there.",
    ),
)
