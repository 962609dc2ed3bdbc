"""Boundary noise: share of flying pixels, which float between two surfaces, that each method keeps.

Section 3.6 says that importance order, the repulsion of chosen points and the check on long edges
remove sensor noise at the boundaries of objects. Flying pixels are known only in simulated images.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from manip3d.experiments._depth import MAX_EDGE, TITLES, RangeInput, reduce, simulated_width
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_SCENES = ("person", "person before a wall", "room")
_METHODS = ("dense", "uniform", "poisson", "cios", "relief")
_SHARE = 0.05


def measure(case: Case) -> Row:
    """Reduce a simulated image by one method and measure the flying pixels that remain."""
    from manip3d import metrics, simulate

    options = case.options
    size = {"width": options["width"], "height": options["width"] * 3 // 4}
    if options["model"] == "room":
        scene = simulate.depth.room(**size)
    else:
        scene = simulate.depth.person(**size, wall=options["model"] != "person")
    capture = scene.capture(rng=options["seed"])
    image = RangeInput(capture.depth, scene.intrinsics, max_edge=options["max_edge"])
    points = math.floor(_SHARE * int(image.measured.sum()))
    mesh = (
        image.dense() if options["method"] == "dense" else reduce(image, options["method"], points)
    )
    noise = metrics.boundary_noise(
        capture.depth, scene.intrinsics, mesh, flying=capture.flying, truth=scene.depth
    )
    return {
        "points": mesh.num_vertices,
        "faces": mesh.num_faces,
        "flying": noise.flying,
        "survived": noise.survived,
        "chosen": noise.chosen,
        "density": noise.density,
    }  # fmt: skip


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(
            measure,
            {
                "model": scene,
                "role": "simulated, with the true mask of flying pixels",
                "stands_in_for": "",
                "data": "simulated",
                "method": method,
                "max_edge": max_edge,
                "width": simulated_width(plan),
                "seed": plan.seed,
            },
        )
        for scene in _SCENES
        for method in _METHODS
        for max_edge in (None, MAX_EDGE)
    ]


def _complete(row: Row) -> Row:
    return row | {"cut": "none" if row["max_edge"] is None else f"{row['max_edge']} m"}


def _groups(rows: Sequence[Row]) -> dict[tuple[str, str], dict[str, Row]]:
    groups: dict[tuple[str, str], dict[str, Row]] = {}
    for row in rows:
        groups.setdefault((row["model"], row["cut"]), {})[row["method"]] = row
    return groups


def _fewer_than(other: str) -> Any:
    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for (model, cut), group in _groups(rows).items():
            if {"cios", other} <= set(group):
                mine, theirs = group["cios"]["survived"], group[other]["survived"]
                numbers = f"CS3 {mine:.1%}, {other} {theirs:.1%}"
                yield Finding(f"{model}, longest edge {cut}", mine < theirs, numbers)

    return judge


def _seldom_chosen(rows: Sequence[Row]) -> Iterator[Finding]:
    for (model, cut), group in _groups(rows).items():
        if "cios" in group and cut == "none":
            row = group["cios"]
            numbers = f"{row['chosen']:.1%} of the flying, {row['density']:.1%} of all pixels"
            yield Finding(model, row["chosen"] < row["density"], numbers)


def _cut_helps(rows: Sequence[Row]) -> Iterator[Finding]:
    groups = _groups(rows)
    for model in _SCENES:
        pair = [groups.get((model, cut), {}).get("cios") for cut in ("none", f"{MAX_EDGE} m")]
        if pair[0] is not None and pair[1] is not None:
            without, cut = pair[0]["survived"], pair[1]["survived"]
            yield Finding(model, cut < without, f"{without:.1%} without, {cut:.1%} with")


EXPERIMENT = Experiment(
    id="boundary-noise",
    title="Flying pixels that survive, 5 % of the points",
    published="",
    data=(),
    cases=_cases,
    columns=(
        Column("method", "method", words=TITLES | {"dense": "dense mesh"}),
        Column("cut", "longest edge"),
        Column("points", "vertices"),
        Column("flying", "flying pixels"),
        Column("survived", "survived, %", 1e2, 1, lower_is_better=True),
        Column("chosen", "chosen, %", 1e2, 1),
        Column("density", "of all pixels, %", 1e2, 1),
    ),
    claims=(
        Claim("CS3 leaves fewer flying pixels than the dense mesh", "section 3.6",
              _fewer_than("dense")),
        Claim("CS3 leaves fewer flying pixels than a uniform grid", "aim",
              _fewer_than("uniform")),
        Claim("CS3 chooses flying pixels more seldom than others", "section 3.6", _seldom_chosen),
        Claim("The check on long edges removes more of them", "section 3.6", _cut_helps),
    ),
    complete=_complete,
    notes=(
        "A flying pixel survives if the mesh shows a surface there that is more than 3 cm from "
        "each true surface that the pixel or one of the eight around it sees; bridges between two "
        "things count. 'Chosen' is the share of the flying pixels that became vertices, beside "
        "the share of all measured pixels. Without a limit on "
        "edges, triangles bridge what is between two things, whatever pixels they end in.",
    ),
)  # fmt: skip
