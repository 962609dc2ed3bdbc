"""Figures 7.9, 7.11 and 7.12: six attacks on one frame, and what the cross-modal check finds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d.experiments import _alert_attacks, cross_modal_7
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from manip3d.lidar import Box

_ATTACKS = ("original", *_alert_attacks.ATTACKS[:6])
_STREETS = {"quick": (100,), "full": (100, 200, 300)}


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(locate, {"model": f"street {street}", "attack": attack, "seed": plan.street(street)})
        for street in _STREETS[plan.scale]
        for attack in _ATTACKS
    ]


def locate(case: Case) -> Row:
    """Judge the first frame of a street that contains an object, clean or attacked."""
    from manip3d import authenticate

    options = case.options
    for moment in cross_modal_7._simulated(options["seed"], 20):
        targets = _alert_attacks.targets(moment.frame, moment.boxes)
        if targets:
            break
    frame = moment.frame
    wanted: list[Box] = []
    if options["attack"] != "original":
        random = np.random.default_rng([options["seed"], _ATTACKS.index(options["attack"])])
        made = _alert_attacks.attacked(frame, targets[0], options["attack"], random)
        if made is None:
            return {"verdict": "no free place"}
        frame, wanted = made
    found = authenticate.cross_modal_consistency(frame, moment.disparity, moment.rig)
    return {
        "verdict": found.verdict,
        "type": found.attack,
        "regions": len(found.regions),
        "placed": any(cross_modal_7._touch(a, b) for a in found.boxes for b in wanted),
        "lidar": np.round(found.lidar, 2).tolist(),
        "stereo": np.round(found.stereo, 2).tolist(),
        "mask": found.mask.tolist(),
    }


def _located(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        original = row["attack"] == "original"
        if row["verdict"] == "no free place":
            continue
        holds = row["verdict"] == "no_trace" if original else bool(row["placed"])
        told = f"{row['verdict']} {row['type']}".strip()
        yield Finding(f"{row['model']}, {row['attack']}", holds, told)


def _figures(rows: Sequence[Row]) -> dict[str, Figure]:
    from matplotlib.figure import Figure

    figures = {}
    for model in dict.fromkeys(row["model"] for row in rows):
        some = [row for row in rows if row["model"] == model and "mask" in row]
        figure = Figure(figsize=(11.0, 1.15 * len(some) + 0.4), layout="constrained")
        for place, row in enumerate(some):
            for column, name in enumerate(("lidar", "stereo", "mask")):
                axes = figure.add_subplot(len(some), 3, 3 * place + column + 1)
                values = np.asarray(row[name], float)
                if name == "mask":
                    axes.imshow(values, cmap="coolwarm", vmin=-1, vmax=1, aspect="auto")
                else:
                    far = np.where(values > 0.0, values, np.nan)
                    axes.imshow(far, cmap="viridis_r", vmin=4, vmax=40, aspect="auto")
                axes.set(xticks=[], yticks=[])
                if place == 0:
                    axes.set_title({"lidar": "LiDAR, depth", "stereo": "cameras, depth",
                                    "mask": "added (red), missing (blue)"}[name])  # fmt: skip
                if column == 0:
                    axes.set_ylabel(row["attack"].replace("_", "\n"), rotation=0, ha="right")
        figures[f"Attacks as LiDAR and cameras see them ({model})"] = figure
    return figures


EXPERIMENT = Experiment(
    id="figure-7.12",
    title="Where cameras and LiDAR contradict each other, attack by attack",
    published="",
    data=(),
    cases=_cases,
    role="simulated streets of an HDL-64E with a stereo pair, labelled",
    columns=(
        Column("attack", "attack"),
        Column("verdict", "verdict"),
        Column("type", "type"),
        Column("regions", "regions"),
        Column("placed", "at the right place"),
    ),
    claims=(
        Claim(
            "Each attack is found where it was made, and the original shows none",
            "figure 7.12",
            _located,
        ),
    ),
    figures=_figures,
    notes=(
        "One frame a street, the attack on its nearest object in view; rates are those of "
        "`table-7.2-cross-modal`. The maps are equirectangular, 90 degrees wide. What is white in "
        "the cameras' map was not measured: no texture, or seen by one camera alone.",
    ),
)
