"""Figure 4.11: mirroring in the image and in space, errors of the skeleton, occlusion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from manip3d.experiments import _phantom
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_LIMB: Final = "right_arm"
_SHIFT = 0.08
"""Error of the shoulder in figure 4.11 c, metres."""


def _cases(plan: Plan) -> list[Case]:
    turned = {
        "motion": "arm-raise",
        "amputated": _LIMB,
        "turn": 45.0,
        "side": "both",
        "seed": plan.seed,
    }
    facing = turned | {"turn": 0.0}
    return [
        Case(view_turned, {"model": "a, b) turned by 45 degrees", "scene": turned, "time": 1.2}),
        Case(view_wrong_joint, {"model": "c) a wrong joint", "scene": facing, "time": 1.4}),
        Case(
            view_occluded,
            {
                "model": "d) occlusion",
                "scene": facing | {"occluder": [1.4, 60.0], "motion": "still"},
                "rate": 30.0,
            },
        ),
    ]


def view_turned(case: Case) -> Row:
    """Mirror the limb of a turned person in the image (2D) and in space (3D)."""
    row: Row = {"views": {}}
    for mode, name in (("2d", "a) 2D"), ("reflection", "b) 3D")):
        (outcome,) = _phantom.outcomes(
            case.options["scene"], {"affected": _LIMB, "mode": mode}, [case.options["time"]]
        )
        box = _phantom.box_of(outcome.phantom.kinds > 0)
        row["views"][name] = _phantom.packed(_textured(outcome)[box])
        row[f"error_{mode}"] = float(np.median(_phantom.errors(outcome, _LIMB)))
        row[f"skeleton_{mode}"] = _skeleton_error(outcome)
    return row


def _textured(outcome: _phantom.Outcome, older: Any = None) -> Any:
    from manip3d.viewer import people

    return people.textured_picture(outcome.phantom, outcome.frame.color, phantom_color=older)


def _skeleton_error(outcome: _phantom.Outcome) -> float:
    """Return the error of the phantom's joints, metres.

    The true joints are those of the intact limb, reflected in the true plane.
    """
    from manip3d.simulate import LIMBS, opposite

    limb: Any = _LIMB
    origin, normal = outcome.truth.mirror_plane(limb)
    intact = outcome.truth.joints[list(LIMBS[opposite(_LIMB)])]
    wanted = intact - 2.0 * ((intact - origin) @ normal)[:, None] * normal
    found = outcome.phantom.skeleton.positions[list(LIMBS[_LIMB])]
    return float(np.linalg.norm(found - wanted, axis=1)[1:].max())


def view_wrong_joint(case: Case) -> Row:
    """Measure the effect of a wrong shoulder on the plane and thereby on the phantom."""
    from dataclasses import replace

    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import BodySimulator

    capture = BodySimulator(**case.options["scene"]).capture(case.options["time"])
    row: Row = {"views": {}}
    for name, shift in (("as it is", 0.0), ("c) wrong shoulder", _SHIFT)):
        person = capture.frame.skeletons[0]
        joints = person.positions.copy()
        joints[8, 2] += shift  # the right shoulder appears farther away, which turns the plane
        frame = replace(capture.frame, skeletons=(replace(person, positions=joints),))
        outcome = _phantom.Outcome(
            capture, PhantomPipeline(affected=_LIMB, plane="joints").process(frame)
        )
        box = _phantom.box_of(outcome.phantom.kinds > 0)
        row["views"][name] = _phantom.packed(_textured(outcome)[box])
        row["error_wrong" if shift else "error_right"] = float(
            np.median(_phantom.errors(outcome, _LIMB))
        )
    return row


def view_occluded(case: Case) -> Row:
    """Record states and pixels of the phantom before and while a board hides the intact arm."""
    rate = case.options["rate"]
    times = [1.0 + i / rate for i in range(round(2.0 * rate))]
    scene = case.options["scene"]
    scene = scene | {"occluder": tuple(scene["occluder"])}
    states, pixels, opacity = [], [], []
    views, colors = {}, {}
    for time, outcome in zip(
        times, _phantom.outcomes(scene, {"affected": _LIMB}, times), strict=True
    ):
        assert outcome.frame.color is not None
        colors[outcome.frame.number] = outcome.frame.color
        states.append(outcome.phantom.state.value)
        pixels.append(int(_phantom.covered(outcome.phantom).sum()))
        opacity.append(outcome.phantom.opacity)
        for name, moment in (("before", 1.3), ("hidden for 0.3 s", 1.7), ("for 1.4 s", 2.8)):
            if abs(time - moment) < 0.5 / rate:
                box = _phantom.box_of(outcome.truth.people == 0, 40)
                older = colors.get(outcome.phantom.texture_number)
                picture = _textured(outcome, older)
                views[name] = _phantom.packed(picture[box])
    return {"views": views, "times": times, "states": states, "pixels": pixels, "opacity": opacity}


def _space_is_right(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if "error_reflection" in row:
            numbers = (
                f"3D {row['error_reflection'] * 1e3:.1f} mm, joints {_mm(row, 'reflection')}; "
                f"2D {row['error_2d'] * 1e3:.0f} mm, joints {_mm(row, '2d')}"
            )
            right = row["error_reflection"] <= 5e-3 and row["skeleton_reflection"] <= 0.02
            wrong = row["error_2d"] > 0.05
            yield Finding(row["model"], right and wrong, numbers)


def _mm(row: Row, mode: str) -> str:
    return f"{row[f'skeleton_{mode}'] * 1e3:.0f} mm"


def _skeleton_matters(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if "error_wrong" in row:
            right, wrong = row["error_right"], row["error_wrong"]
            numbers = f"median {right * 1e3:.1f} mm; with a wrong shoulder {wrong * 1e3:.1f} mm"
            yield Finding(row["model"], wrong > 5.0 * right, numbers)


def _occlusion_is_said(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if "states" in row:
            # While the board enters, the mirrored arm is in pieces and the state is "degraded".
            order = [state for state in dict.fromkeys(row["states"]) if state != "degraded"]
            numbers = " -> ".join(order) + f"; {row['pixels'][-1]} pixels at the end"
            holds = order == ["tracking", "holding", "fading", "lost"] and row["pixels"][-1] == 0
            yield Finding(row["model"], holds, numbers)


EXPERIMENT = Experiment(
    id="figure-4.11",
    title="Mirroring in the image and in space, errors of the skeleton, occlusion",
    published="",
    data=(),
    cases=_cases,
    role=_phantom.ROLE,
    columns=(
        Column("error_2d", "2D, median error, mm", 1e3, 1),
        Column("error_reflection", "3D, mm", 1e3, 2),
        Column("skeleton_2d", "2D, worst joint, mm", 1e3, 1),
        Column("skeleton_reflection", "3D, mm", 1e3, 2),
        Column("error_right", "right joints, mm", 1e3, 2),
        Column("error_wrong", "a wrong joint, mm", 1e3, 2),
    ),
    claims=(
        Claim(
            "When the person has turned, 3D mirroring is right and 2D mirroring wrong",
            "section 4.6",
            _space_is_right,
            about=lambda row: row["model"].startswith("a"),
        ),
        Claim(
            "Errors of the skeleton spoil the phantom",
            "figure 4.11 c",
            _skeleton_matters,
            about=lambda row: row["model"].startswith("c"),
        ),
        Claim(
            "Without the intact limb in sight the phantom is held, fades and goes",
            "figure 4.11 d",
            _occlusion_is_said,
            about=lambda row: row["model"].startswith("d"),
        ),
    ),
    figures=_phantom.panels,
    notes=(
        _phantom.NOTE,
        f"c: the affected shoulder is {_SHIFT * 100:.0f} cm too far away. d: published without a "
        "phantom; here the last one is held for half a second in the body's frame, then fades.",
    ),
)
