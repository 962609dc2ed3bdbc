"""Options of ``manip3d depth`` that its ways to read the sources share."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from manip3d.simplify import DepthOptions


class DepthMethod(StrEnum):
    """Relief is manip3d's own; the others are those of chapter 3."""

    relief = "relief"
    cs3 = "cs3"
    uniform = "uniform"
    poisson = "poisson"
    ssa = "ssa"


class Effort(StrEnum):
    """Amount of work that relief does."""

    live = "live"
    fast = "fast"
    balanced = "balanced"
    fine = "fine"
    best = "best"


class Variant(StrEnum):
    """The four variants of CS3: importance (L or C), then sampling."""

    cios = "cios"
    lios = "lios"
    cnms = "cnms"
    lnms = "lnms"


OPTIONS = ("intrinsics", "unit", "variant", "effort", "by-distance", "move-points", "max-edge",
           "depth-step", "color", "mask", "confidence", "confidence-max", "points", "ratio",
           "method", "min-coverage", "max-bridges", "bandwidth", "rate", "stable",
           "ray-depth", "seed")  # fmt: skip

BUDGETS = ("points", "ratio", "bandwidth", "rate")


def expect_budget(
    *budgets: object, wanted: str = "--points or --ratio, or --bandwidth with --rate"
) -> None:
    if all(budget is None for budget in budgets):
        raise typer.BadParameter(f"give {wanted}", param_hint="--points")


def options_of(given: Mapping[str, Any]) -> DepthOptions:
    """Return the options of the method from those of the command; ``jobs`` are threads."""
    from manip3d.simplify import DepthOptions

    names = ("points", "intrinsics", "unit", "max_edge", "depth_step", "by_distance", "move_points",
             "seed", "min_coverage", "bandwidth", "rate", "max_bridges", "ratio",
             "ray_depth")  # fmt: skip
    return DepthOptions(
        method=given["method"].value,
        variant=given["variant"].value,
        effort=given["effort"].value,
        threads=given["jobs"],
        **{name: given[name] for name in names},
    )
