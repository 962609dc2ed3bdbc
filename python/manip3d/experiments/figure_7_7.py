"""Figure 7.7: the safety region of the risk factor, from the side and from above."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from manip3d.lidar import LidarFrame

_SPEEDS_KMH = (10, 30, 50, 80, 130)
_SHOWN_KMH = 50
_EVERY = 3  # draw every third point


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(measure, {"model": f"{speed} km/h", "speed_kmh": speed, "seed": plan.seed})
        for speed in _SPEEDS_KMH
    ]


def measure(case: Case) -> Row:
    """Count the points of a street that lie in the safety region at one speed."""
    from manip3d.authenticate import RiskParameters

    region = RiskParameters()
    speed = case.options["speed_kmh"] / 3.6
    points = _street(case.options["seed"]).points
    inside = region.contains(points, speed)
    row: Row = {
        "safe_m": region.safe_distance(speed),
        "braking_m": speed * speed / (2.0 * region.braking_mps2),
        "window": region.frames(speed),
        "points": int(inside.sum()),
    }
    if case.options["speed_kmh"] == _SHOWN_KMH:
        row["seen"] = np.round(points[::_EVERY], 2).tolist()
        row["inside"] = inside[::_EVERY].tolist()
        row["region"] = [region.nearest_m, region.half_width_m, region.bottom_m, region.top_m]
    return row


@functools.cache
def _street(seed: int) -> LidarFrame:
    from manip3d.simulate.drives import drive
    from manip3d.simulate.streets import street

    (frame,) = drive(street(seed), 1, start=0.5, rng=seed, threads=1, pictures=False)
    return frame.scan.frame


def _covers_braking(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['safe_m']:.1f} m, braking alone {row['braking_m']:.1f} m"
        yield Finding(row["model"], row["safe_m"] > row["braking_m"], numbers)


def _draw(axes: Axes, row: Row, vertical: int) -> None:
    nearest, half_width, bottom, top = row["region"]
    points, inside = np.asarray(row["seen"]), np.asarray(row["inside"])
    style: dict[str, Any] = {"s": 0.4, "linewidths": 0}
    axes.scatter(points[:, 0], points[:, vertical], color="0.6", **style)
    axes.scatter(points[inside, 0], points[inside, vertical], color="tab:red", **style)
    axes.plot(0, 0, "k^")
    low, high = (bottom, top) if vertical == 2 else (-half_width, half_width)
    far = row["safe_m"]
    axes.plot([nearest, far, far, nearest, nearest], [low, low, high, high, low], color="tab:blue")
    axes.set_aspect("equal")
    axes.set_xlim(-5, 1.3 * row["safe_m"])


def _figures(rows: Sequence[Row]) -> dict[str, Figure]:
    from matplotlib.figure import Figure

    found = [row for row in rows if "seen" in row]
    if not found:
        return {}
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    side, above = figure.subplots(2, 1)
    _draw(side, found[0], 2)
    side.set(ylim=(-3, 6), ylabel="up, m", title="from the side")
    _draw(above, found[0], 1)
    above.set(ylim=(-16, 16), xlabel="ahead, m", ylabel="to the left, m", title="from above")
    return {f"Safety region at {_SHOWN_KMH} km/h (blue), its points (red)": figure}


EXPERIMENT = Experiment(
    id="figure-7.7",
    title="Safety region of the risk factor",
    published="",
    data=(),
    cases=_cases,
    role="one simulated street of an HDL-64E",
    columns=(
        Column("safe_m", "stopping distance, m", digits=1),
        Column("braking_m", "of it braking, m", digits=1),
        Column("window", "frames of 100 m"),
        Column("points", "points inside"),
    ),
    claims=(
        Claim(
            "The region reaches beyond the way that braking alone takes",
            "figure 7.7",
            _covers_braking,
        ),
    ),
    figures=_figures,
    notes=(
        "The printed text gives neither reaction time nor deceleration; those of "
        "`authenticate.RiskParameters` are 1.5 s and 6 m/s^2.",
    ),
)
