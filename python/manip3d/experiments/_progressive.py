"""Common parts of figures 2.11 and 2.17: Dragon and Jet at decreasing numbers of faces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from manip3d.experiments._model import Case, Plan, Row
from manip3d.experiments._simplification import (
    METHOD_TITLES,
    NON_TEXTURED_METHODS,
    TEXTURED_METHODS,
    models,
    simplification_case,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MODELS = ("Dragon", "Jet")
_LEVELS = {
    "full": (0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.02),
    "quick": (0.5, 0.2, 0.1),
}
# Okabe and Ito's colours, which people with colour blindness can distinguish. The style of QEM4VR
# is the most prominent.
_STYLES: dict[str, dict[str, Any]] = {
    "qem-orig": {"color": "#999999", "marker": "o"},
    "qem-bp": {"color": "#E69F00", "marker": "s"},
    "qem-tp": {"color": "#009E73", "marker": "^"},
    "qem-btp": {"color": "#CC79A7", "marker": "D"},
    "qem4vr": {"color": "#0072B2", "marker": "*", "linewidth": 2.2, "zorder": 5},
}


def cases(plan: Plan) -> list[Case]:
    """Return the cases of Dragon and Jet by each method at each level, shared by both figures."""
    return [
        simplification_case(model, faces, method, plan, level=level)
        for model, faces in models(plan)
        if model.published in MODELS
        for method in (TEXTURED_METHODS if model.textured else NON_TEXTURED_METHODS)
        for level in _LEVELS[plan.scale]
    ]


def curves(rows: Sequence[Row]) -> Iterator[tuple[str, dict[str, list[Row]]]]:
    """Yield each model with its rows by method, in descending order of faces.

    A curve ends at the last level that its method reached. At further levels the method returns the
    same mesh again, and these rows are left out.
    """
    by_model: dict[str, dict[str, list[Row]]] = {}
    for row in sorted(rows, key=lambda row: -row["level"]):
        if row["stop"] == "refused":
            continue
        curve = by_model.setdefault(row["model"], {}).setdefault(row["method"], [])
        if not curve or row["faces"] < curve[-1]["faces"]:
            curve.append(row)
    yield from by_model.items()


def ends_early(curve: list[Row]) -> bool:
    """Return whether a method stopped above the last target."""
    return bool(curve[-1]["stop"] == "no_legal_collapse")


def plots(
    rows: Sequence[Row], name: str, label: str, scale: float, *, logarithmic: bool = False
) -> dict[str, Figure]:
    """Draw a figure for each model: the measure over the number of faces, a line per method."""
    from matplotlib.figure import Figure

    figures = {}
    for model, by_method in curves(rows):
        figure = Figure(figsize=(6.4, 4.0), layout="constrained")
        axes = figure.add_subplot()
        for method, curve in by_method.items():
            x = [row["faces"] for row in curve]
            y = [row[name] * scale for row in curve]
            axes.plot(x, y, label=METHOD_TITLES[method], markersize=6, **_STYLES[method])
            if ends_early(curve):
                axes.plot(x[-1:], y[-1:], "x", color="black", markersize=10, zorder=6)
        some = next(iter(by_method.values()))[0]
        axes.set(
            title=f"{model}: {some['role']}", xlabel="faces of the simplified mesh", ylabel=label
        )
        if logarithmic:
            axes.set_yscale("log")
            highest = max(row[name] * scale for curve in by_method.values() for row in curve)
            # Smaller values are rounding errors.
            axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-4 * highest))
        axes.invert_xaxis()
        axes.grid(alpha=0.3)
        axes.legend()
        figures[model] = figure
    return figures
