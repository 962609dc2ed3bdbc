"""Figure 5.7: segmentation by Voronoi regions and by region growing, compared with true bones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d.experiments import _phantom, _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row
from manip3d.rgbd import JOINTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_METHODS: dict[Literal["paper", "skin", "region"], str] = {
    "paper": "Voronoi",
    "skin": "skin",
    "region": "region growing",
}
_CLOSE = 8  # pixels: about 5 cm at the person
_HEAD_AND_SHOULDERS = (2, 3, 4, 8, 20)
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
    """Segment a person at several times, by each method.

    Returns
    -------
    dict
        ``views``: packed pictures of the last time; ``bones``: the share of each bone's pixels with
        the right label, by method and bone; and the same share for each method and part of
        `_PARTS`. All shares are means over the times.
    """
    from manip3d.modify import segment_body
    from manip3d.simulate import BodySimulator
    from manip3d.viewer import people

    simulator = BodySimulator(
        motion=case.options["motion"], tracker="kinect-v2", seed=case.options["seed"]
    )
    by_part: dict[str, list[float]] = {}
    by_bone: dict[str, list[float]] = {}
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
                segmentation=name,
                body_index=frame.body_index,
            ).labels
            views[title] = _phantom.packed(people.label_picture(labels)[box])
            for bone in np.unique(truth[mine]).tolist():
                share = float((labels == truth)[mine & (truth == bone)].mean())
                by_bone.setdefault(f"{name} {JOINTS[bone]}", []).append(share)
            for part, share in _right_shares(labels, truth, mine).items():
                by_part.setdefault(f"{name} {part}", []).append(share)
    return {
        "views": views,
        "bones": {name: float(np.mean(values)) for name, values in by_bone.items()},
        **{name: float(np.mean(values)) for name, values in by_part.items()},
    }


def _right_shares(
    labels: NDArray[np.uint8], truth: NDArray[np.uint8], mine: NDArray[np.bool_]
) -> dict[str, float]:
    """Return the shares of the person's pixels with a right label, by part of `_PARTS`.

    For arms and trunk a label is right if it is any of their bones. ``arms on trunk`` is the share
    among pixels where an arm and the trunk meet in the image.
    """
    same = labels == truth
    shares = {}
    arm, trunk = (mine & np.isin(truth, bones) for bones in (_ARMS, _TRUNK))
    on_arm, on_trunk = np.isin(labels, _ARMS), np.isin(labels, _TRUNK)
    meet = (arm & _streams.grown(trunk, _CLOSE)) | (trunk & _streams.grown(arm, _CLOSE))
    if meet.any():
        shares["arms on trunk"] = float(((arm & on_arm) | (trunk & on_trunk))[meet].mean())
    near = mine & np.isin(truth, _HEAD_AND_SHOULDERS)
    shares["head and shoulders"] = float(same[near].mean())
    shares["head"] = float(same[mine & np.isin(truth, _HEAD)].mean())
    shares["trunk"] = float(on_trunk[trunk].mean())
    shares["arms"] = float(on_arm[arm].mean())
    shares["all"] = float(same[mine].mean())
    return shares


_PARTS = ("all", "head", "trunk", "arms", "head and shoulders", "arms on trunk")


def _draw(rows: Sequence[Row]) -> dict[str, Figure]:
    """Draw the pictures, and the share of right pixels of each bone over all motions."""
    from matplotlib.figure import Figure

    figures = dict(_phantom.panels(rows))
    names = [n for n in JOINTS if any(f"region {n}" in row["bones"] for row in rows)]
    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(names))
    for number, (method, title) in enumerate(_METHODS.items()):
        shares = [
            float(
                np.mean(
                    [
                        row["bones"][f"{method} {n}"]
                        for row in rows
                        if f"{method} {n}" in row["bones"]
                    ]
                )
            )
            for n in names
        ]
        axes.bar(place + 0.27 * (number - 1), 100.0 * np.array(shares), 0.27, label=title)
    axes.set_xticks(place, names, rotation=75)
    axes.set(ylabel="pixels with their true bone, %", ylim=(0.0, 100.0))
    axes.legend()
    figures["by bone"] = figure
    return figures


def _by_bone(rows: Sequence[Row]) -> Iterator[Finding]:
    for name in JOINTS:
        shares = {
            method: [
                r["bones"][f"{method} {name}"] for r in rows if f"{method} {name}" in r["bones"]
            ]
            for method in _METHODS
        }
        if shares["region"]:
            numbers = ", ".join(f"{_METHODS[m]} {np.mean(v):.1%}" for m, v in shares.items())
            yield Finding(name, None, numbers)


def _mean(rows: Sequence[Row], name: str) -> float:
    return float(np.mean([row[name] for row in rows if name in row]))


def _better(rows: Sequence[Row]) -> Iterator[Finding]:
    for part in _PARTS:
        mine, theirs, skin = (_mean(rows, f"{m} {part}") for m in ("region", "paper", "skin"))
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
    claims=(
        Claim("Region growing is better than Voronoi regions", "figure 5.7", _better),
        Claim("Share of each bone's pixels", "figure 5.7", _by_bone, reported=True),
    ),
    figures=_draw,
    notes=(
        _streams.NOTE,
        "Head and shoulders: pixels of the head, the neck and the bones of the shoulders, with "
        "their exact bone. Arms on trunk: pixels of either within 8 pixels of the other.",
        "A pixel of trunk or arm is right if its bone is of the same part. True bones of the "
        "trunk are those nearest at rest, which favours Voronoi regions there.",
    ),
)
