"""Figure 3.7: Metro of LIOS and CIOS against the number of vertices, Buddha."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from manip3d.experiments import _depth_pictures
from manip3d.experiments._depth import (
    DATA_NOTE,
    ERROR_COLUMNS,
    NOTE,
    SHORT,
    models,
    real_data,
    reduction_case,
)
from manip3d.experiments._model import Case, Claim, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MODELS = ("Buddha",)
_SHARES = {"full": (0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2), "quick": (0.05, 0.1)}
_COLORS = {"lios": "#E69F00", "cios": "#0072B2"}


def _cases(plan: Plan) -> list[Case]:
    return [
        reduction_case(model, method, plan, share=share)
        for model in models(plan, _MODELS)
        for method in ("lios", "cios")
        for share in _SHARES[plan.scale]
    ]


def _curves(rows: Sequence[Row]) -> dict[str, dict[str, list[Row]]]:
    curves: dict[str, dict[str, list[Row]]] = {}
    for row in sorted(rows, key=lambda row: float(row["share"])):
        curves.setdefault(row["model"], {}).setdefault(row["method"], []).append(row)
    return curves


def _lower_everywhere(sampling: str) -> Claim:
    name = f"metro_{sampling}"

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for model, by_method in _curves(rows).items():
            lios, cios = by_method.get("lios", []), by_method.get("cios", [])
            for other, mine in zip(lios, cios, strict=False):
                numbers = f"LIOS {other[name] * 1e3:.3f}, CIOS {mine[name] * 1e3:.3f} (1e-3)"
                yield Finding(f"{model}, {mine['points']}", mine[name] < other[name], numbers)

    text = f"CIOS has a lower Metro ({sampling} sampling) than LIOS at every number of vertices"
    return Claim(text, "figure 3.7", judge)


def _plots(rows: Sequence[Row]) -> dict[str, Figure]:
    from matplotlib.figure import Figure

    figures = {}
    for model, by_method in _curves(rows).items():
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.add_subplot()
        for method, curve in by_method.items():
            axes.plot(
                [row["points"] for row in curve],
                [row["metro_area"] * 1e3 for row in curve],
                marker="o",
                color=_COLORS[method],
                label=SHORT[method],
            )
        axes.set(
            title=f"{model}: {next(iter(by_method.values()))[0]['role']}",
            xlabel="vertices",
            ylabel="Metro (area), 1e-3 of the diagonal",
        )
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
        axes.legend()
        figures[model] = figure
    return figures


def _tenth(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if row["share"] == 0.1]


EXPERIMENT = Experiment(
    id="figure-3.7",
    title="Metro of LIOS and CIOS against the number of vertices",
    published="",
    data=real_data(_MODELS),
    cases=_cases,
    columns=ERROR_COLUMNS,
    claims=(_lower_everywhere("area"), _lower_everywhere("vertex")),
    figures=_plots,
    sheets=lambda rows: _depth_pictures.sheets(_tenth(rows)),
    notes=(DATA_NOTE, NOTE, "The figure's values are not printed anywhere; its claim is compared."),
)
