"""Figure 5.3: the stages of segmentation by region growing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from manip3d.experiments import _phantom, _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row


def _cases(plan: Plan) -> list[Case]:
    return [Case(view_stages, {"model": "a standing person", "seed": plan.seed})]


def view_stages(case: Case) -> Row:
    """Draw depth filter, contours, the skeleton's lines and regions, without a body index."""
    from manip3d.modify import segment_body
    from manip3d.simulate import BodySimulator
    from manip3d.viewer import people

    capture = BodySimulator(tracker="kinect-v2", seed=case.options["seed"]).capture(1.2)
    frame, person = capture.frame, capture.frame.skeletons[0]
    camera = frame.calibration.depth
    joints = person.positions[:, 2]
    metres = frame.depth / 1000.0
    inside = (metres >= joints.min() - 0.35) & (metres <= joints.max() + 0.35)
    regions = segment_body(frame.depth, camera, person, segmentation="region").labels
    filtered = people.depth_picture(np.where(inside, frame.depth, 0))
    contours = np.zeros((*frame.depth.shape, 3), np.uint8)
    contours[contour_pixels(metres, camera.fx) & inside] = 255
    seeds = contours.copy()
    for column, row in seed_pixels(person.positions, camera):
        seeds[row, column] = (255, 60, 60)
    views = {
        "depth": people.depth_picture(frame.depth),
        "depth filter": filtered,
        "contours": contours,
        "skeleton": seeds,
        "regions": people.label_picture(regions),
    }
    mine = np.asarray(capture.truth.people == 0) & (frame.depth > 0)
    return {
        "views": {name: _phantom.packed(view) for name, view in views.items()},
        "filtered": int(inside.sum()),
        "person": int(mine.sum()),
        "covered": float((regions > 0)[mine].mean()),
        "beside": float(((regions > 0) & ~mine).sum() / mine.sum()),
    }


def contour_pixels(metres: np.ndarray, focal: float) -> np.ndarray:
    """Return the pixels next to a depth step, by the rule of region growing, for the picture."""
    contour = np.zeros(metres.shape, bool)
    for axis in (0, 1):
        one = metres[:-1] if axis == 0 else metres[:, :-1]
        other = metres[1:] if axis == 0 else metres[:, 1:]
        near = np.minimum(one, other)
        step = np.abs(one - other) > near * (np.tan(np.deg2rad(78)) / focal + 3 * 1.425e-3 * near)
        if axis == 0:
            contour[1:] |= step
        else:
            contour[:, 1:] |= step
    return contour


def seed_pixels(joints: np.ndarray, camera: object) -> list[tuple[int, int]]:
    """Return column and row of points along each bone."""
    from manip3d.camera import Intrinsics
    from manip3d.rgbd import PARENTS

    assert isinstance(camera, Intrinsics)
    way = np.linspace(0.0, 1.0, 60)[:, None]
    points = np.concatenate(
        [joints[PARENTS[b]] + way * (joints[b] - joints[PARENTS[b]]) for b in range(1, 25)]
    )
    pixels = np.rint(camera.project(points.astype(np.float64))).astype(int)
    inside = np.all((pixels >= 0) & (pixels < (camera.width, camera.height)), axis=1)
    return [(int(column), int(row)) for column, row in pixels[inside]]


def _extracted(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['covered']:.1%} of the person; {row['beside']:.1%} as much beside"
        yield Finding(row["model"], row["covered"] > 0.9 and row["beside"] < 0.1, numbers)


EXPERIMENT = Experiment(
    id="figure-5.3",
    title="Stages of segmentation by region growing",
    published="",
    data=(),
    cases=_cases,
    role=_streams.ROLE,
    columns=(
        Column("filtered", "pixels within the depth filter"),
        Column("person", "of the person"),
        Column("covered", "of these, found", scale=100.0, digits=1),
        Column("beside", "found beside, % of the person", scale=100.0, digits=1),
    ),
    claims=(Claim("The person is extracted cleanly", "section 5.1.1", _extracted),),
    figures=_phantom.panels,
    notes=(_streams.NOTE, "Without a body index, as published. Contours are steps of the depth."),
)
