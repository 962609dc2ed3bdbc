"""Figure 5.6: the person drawn as points, with and without interpolation, and as triangles."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from manip3d.experiments import _phantom, _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_WAYS: dict[str, dict[str, Any]] = {
    "points": {"surface": "points", "fill_pinholes": False, "blend": 0},
    "interpolated": {"surface": "points", "blend": 0},
    "triangles": {"surface": "mesh", "blend": 0},
    "blended": {"surface": "mesh", "blend": 1},
}


def _cases(plan: Plan) -> list[Case]:
    return [Case(view_holes, {"model": "nearer by 0.6 m", "seed": plan.seed})]


def view_holes(case: Case) -> Row:
    """Count holes: pixels of the person drawn as triangles that show the background otherwise."""
    from manip3d import forge
    from manip3d.simulate import BodySimulator

    seed = case.options["seed"]
    actor = BodySimulator(motion="still", tracker="kinect-v2", stripes=True, seed=seed)
    pose = BodySimulator(motion="wave", seed=seed).frame(1.6)
    frame, room = actor.frame(0.5), actor.background(0.5)
    row: Row = {"views": {}}
    masks = {}
    for name, options in _WAYS.items():
        forged = forge.stream([frame], room, kind=2, pose=[pose], move=(0.0, 0.0, -0.6), **options)
        shown = next(forged.frames())
        box = _phantom.box_of(shown.mask, 16)
        row["views"][name] = _phantom.packed(
            np.ascontiguousarray(np.asarray(shown.frame.color)[box])
        )
        masks[name] = shown.mask
    for name, mask in masks.items():
        row[name] = int((masks["triangles"] & ~mask).sum())
    row["person"] = int(masks["triangles"].sum())
    return row


def _filled(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = ", ".join(f"{name} {row[name]}" for name in _WAYS) + f" of {row['person']}"
        yield Finding(row["model"], row["interpolated"] < 0.5 * row["points"], numbers)


EXPERIMENT = Experiment(
    id="figure-5.6",
    title="Holes of the drawn person with and without interpolation",
    published="",
    data=(),
    cases=_cases,
    role=_streams.ROLE,
    columns=tuple(Column(name, f"{name}: pixels in holes") for name in _WAYS),
    claims=(Claim("Interpolation closes most holes", "section 5.1.2", _filled),),
    figures=_phantom.panels,
    notes=(
        _streams.NOTE,
        "The person is drawn 0.6 m nearer, so that points are farther apart than pixels.",
    ),
)
