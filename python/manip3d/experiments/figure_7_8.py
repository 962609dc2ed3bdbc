"""Figure 7.8: the temporal element of the risk factor for patterns of attacked frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PATTERNS = ("11100", "00111", "10101", "11111", "10000", "00001", "01010", "11000", "00000")
"""Patterns of five frames, oldest first; 1: attacked."""


def _cases(_: Plan) -> list[Case]:
    return [Case(weigh, {"model": pattern}) for pattern in _PATTERNS]


def weigh(case: Case) -> Row:
    """Compute the temporal element of one pattern."""
    from manip3d import authenticate

    attacked = [letter == "1" for letter in case.options["model"]]
    return {
        "attacked": sum(attacked),
        "factor": authenticate.temporal_factor(attacked),
        "frames": attacked,
    }


def _late_weighs_more(rows: Sequence[Row]) -> Iterator[Finding]:
    """Compare patterns with equal numbers of attacked frames: later attacks must weigh more."""
    for a in rows:
        for b in rows:
            if a["attacked"] != b["attacked"] or not a["attacked"]:
                continue
            later, earlier = a["model"].rindex("1"), b["model"].rindex("1")
            if later > earlier:
                numbers = f"{a['factor']:.2f} against {b['factor']:.2f}"
                names = f"{a['model']} against {b['model']}"
                yield Finding(names, a["factor"] > b["factor"], numbers)


def _figures(rows: Sequence[Row]) -> dict[str, Figure]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 0.45 * len(rows) + 1.0), layout="constrained")
    axes = figure.add_subplot()
    for place, row in enumerate(rows):
        for number, attacked in enumerate(row["frames"]):
            axes.scatter(number, place, s=260, marker="s", edgecolors="0.4",
                         color="tab:red" if attacked else "white")  # fmt: skip
        axes.text(len(row["frames"]), place, f"$f_t$ = {row['factor']:.2f}", va="center")
    axes.set(yticks=range(len(rows)), yticklabels=[row["model"] for row in rows],
             xticks=[0, 4], xticklabels=["oldest", "newest"], xlim=(-0.7, 6.5))  # fmt: skip
    axes.invert_yaxis()
    return {"Temporal element of patterns of attacked frames": figure}


EXPERIMENT = Experiment(
    id="figure-7.8",
    title="Temporal element of the risk factor",
    published="",
    data=(),
    cases=_cases,
    role="patterns of five frames, the oldest first; 1: attacked",
    columns=(
        Column("attacked", "attacked frames"),
        Column("factor", "temporal element", digits=2),
    ),
    claims=(
        Claim(
            "Patterns with as many attacked frames are told apart by when the last was",
            "section 7.3.5",
            _late_weighs_more,
        ),
    ),
    figures=_figures,
)
