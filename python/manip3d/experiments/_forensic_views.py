"""Common parts of figures 6.3 to 6.7: one scan, its forgeries, and views of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import authenticate, datasets, forge, metrics
from manip3d.experiments import _forensics
from manip3d.experiments._model import Case, Column, Plan, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Points = NDArray[np.float32]

_CELLS = 160
"""Rows and columns of a view."""

_MAX_DOTS = 4000

_SCENES = {"outdoor": "outdoor-01", "indoor": "indoor-00"}

COLUMNS = (Column("points", "points"), Column("added", "pasted points"))


def cases(plan: Plan, kind: str) -> list[Case]:
    """Return the single case of a figure."""
    real = plan.data != "simulated" and all(
        datasets.is_here(datasets.get(name)) for name in _forensics.HOAXES
    )
    return [
        Case(
            view_scene,
            {
                "model": _SCENES[kind],
                "kind": kind,
                "number": 1 if kind == "outdoor" else 0,
                "hoaxes": list(_forensics.HOAXES) if real else ["ball", "knot"],
                "data": "simulated",
                "role": _forensics.role(real),
                "resolution_deg": {"full": 0.06, "quick": 0.2}[plan.scale],
                "seed": plan.seed,
            },
            inputs=_forensics.HOAXES if real else (),
        )
    ]


def view_scene(case: Case) -> Row:
    """Return range images, masks, points and signals of a scan and of its forgeries."""
    options = case.options
    kind = options["kind"]
    random = np.random.default_rng([options["seed"], options["number"]])
    points = _forensics.scan_of(options)
    vertices, _ = _forensics.open_hoax(options["hoaxes"][0])
    extent = 1.0 if kind == "outdoor" else 0.3
    scale = extent / float(np.ptp(vertices, axis=0).max())
    place = _forensics.free_place(points, kind, random)
    place[2] += scale * float(vertices[:, 2].mean() - vertices[:, 2].min())
    box = _forensics.object_box(points, kind)
    forged = {
        "original": None,
        "CTP": forge.ctp(points, vertices, position=place, scale=scale),
        "CRTP": forge.crtp(points, vertices, position=place, scale=scale),
        "subtractive": forge.subtract(points, box),
        "deforming": forge.deform(points, box, amplitude=0.1, rng=random),
    }
    views: dict[str, Any] = {}
    for name, forgery in forged.items():
        scan = points if forgery is None else forgery.points
        target = box.center if name in ("subtractive", "deforming") else tuple(place)
        size = max(box.size) if name in ("subtractive", "deforming") else extent
        views[name] = _views(scan, np.asarray(target, np.float64), float(size))
        if name in ("original", "CTP", "CRTP"):
            views[name] |= _signal(scan, np.asarray(target, np.float64))
    views["original at the object"] = _views(points, np.asarray(box.center), max(box.size))
    ctp = forged["CTP"]
    assert ctp is not None
    return {"points": len(points), "added": len(ctp.added), "views": views}


def _views(points: Points, target: NDArray[np.float64], size: float) -> dict[str, Any]:
    """Return a range image and a plan view of the points around a place."""
    near = points[np.abs(points - target).max(axis=1) < 3.0 * size].astype(np.float64)
    distance = math.sqrt(float(target @ target))
    half = math.degrees(1.5 * size / distance)
    azimuth = np.degrees(np.arctan2(points[:, 1], points[:, 0]) - math.atan2(target[1], target[0]))
    azimuth = (azimuth + 180.0) % 360.0 - 180.0
    level = np.hypot(points[:, 0], points[:, 1])
    elevation = np.degrees(np.arctan2(points[:, 2], level))
    elevation = elevation - math.degrees(math.atan2(target[2], math.hypot(*target[:2])))
    inside = (np.abs(azimuth) < half) & (np.abs(elevation) < half)
    cell = _CELLS / (2.0 * half)
    column = ((azimuth[inside] + half) * cell).astype(int)
    row = ((elevation[inside] + half) * cell).astype(int)
    image = np.full((_CELLS, _CELLS), np.inf)
    ranges = np.linalg.norm(points[inside].astype(np.float64), axis=1)
    np.minimum.at(image, (row.clip(0, _CELLS - 1), column.clip(0, _CELLS - 1)), ranges)
    step = max(1, len(near) // _MAX_DOTS)
    spacing = metrics.nearest_distances(near.astype(np.float32), origin=None)[::step]
    return {
        "half_deg": half,
        "image": np.where(np.isfinite(image), np.round(image, 3), 0.0).tolist(),
        "dots": np.round(near[::step], 3).tolist(),
        "spacing_mm": np.round(1e3 * np.minimum(spacing, 1.0), 2).tolist(),
    }


def _signal(points: Points, target: NDArray[np.float64]) -> dict[str, Any]:
    """Return MIN_ipd over range as in the printed method, and the masks of detector II."""
    raw = authenticate.density_consistency(
        points,
        parameters=authenticate.DensityParameters(
            sector=0, level_width=0.2, level_growth=0.0, deviation=3.5, fewest=10
        ),
    )
    smooth = authenticate.density_consistency(points, parameters=authenticate.PAPER_DENSITY)
    local = authenticate.density_consistency(points)
    found = authenticate.occlusion_consistency(points)
    lowest = np.where(np.isfinite(local.ratio), local.ratio, np.inf).min(axis=0)
    known = np.isfinite(raw.signal)
    return {
        "ranges": np.round(raw.ranges[known], 3).tolist(),
        "signal_mm": np.round(1e3 * raw.signal[known], 4).tolist(),
        "smooth_mm": np.round(1e3 * smooth.signal[known], 4).tolist(),
        "local_ranges": np.round(local.ranges[np.isfinite(lowest)], 3).tolist(),
        "local_ratio": np.round(lowest[np.isfinite(lowest)], 4).tolist(),
        "offending": local.offending.tolist(),
        "raw_mask": _around(found, found.raw_mask, target),
        "mask": _around(found, found.mask, target),
    }


def _around(
    found: authenticate.OcclusionResult, mask: NDArray[np.uint8], target: NDArray[np.float64]
) -> list[list[int]]:
    """Return the part of a mask around a place."""
    if not mask.size:
        return []
    elevation = math.degrees(math.atan2(target[2], math.hypot(target[0], target[1])))
    azimuth = math.degrees(math.atan2(target[1], target[0])) + 180.0
    row = int((elevation - found.lowest_deg) / found.grid.elevation_deg)
    column = int(azimuth / found.grid.azimuth_deg)
    rows = np.arange(row - _CELLS // 2, row + _CELLS // 2).clip(0, len(mask) - 1)
    columns = np.arange(column - _CELLS // 2, column + _CELLS // 2) % mask.shape[1]
    cut: list[list[int]] = mask[np.ix_(rows, columns)].tolist()
    return cut


def range_images(rows: Sequence[Row], names: Sequence[str], title: str) -> dict[str, Figure]:
    """Draw range images side by side."""
    from matplotlib.figure import Figure

    figures = {}
    for row in rows:
        figure = Figure(figsize=(3.2 * len(names), 3.4), layout="constrained")
        for number, name in enumerate(names):
            view = row["views"][name]
            image = np.asarray(view["image"])
            axes = figure.add_subplot(1, len(names), number + 1)
            shown = np.where(image > 0.0, image, np.nan)
            half = view["half_deg"]
            axes.imshow(
                shown[:, ::-1], origin="lower", cmap="viridis", extent=(-half, half, -half, half)
            )
            axes.set(title=name, xlabel="degrees")
        figures[f"{title} ({row['model']})"] = figure
    return figures


def spacing_views(rows: Sequence[Row]) -> dict[str, Figure]:
    """Draw the forged scene from the front and from above, coloured by point spacing."""
    from matplotlib.figure import Figure

    figures = {}
    for row in rows:
        view = row["views"]["CTP"]
        x, y, z = np.asarray(view["dots"]).T
        figure = Figure(figsize=(8.0, 3.6), layout="constrained")
        for number, (title, up, name) in enumerate((("front", z, "z, m"), ("top", x, "x, m"))):
            axes = figure.add_subplot(1, 2, number + 1)
            dots = axes.scatter(y, up, c=view["spacing_mm"], s=2, cmap="viridis", vmax=30.0)
            axes.set(title=title, xlabel="y, m", ylabel=name)
            axes.set_aspect("equal")
        figure.colorbar(dots, label="nearest neighbour, mm")
        figures[f"Spacing of the points of a forged scene ({row['model']})"] = figure
    return figures


def masks(rows: Sequence[Row]) -> dict[str, Figure]:
    """Draw the stages of detector II."""
    from matplotlib.figure import Figure

    figures = {}
    for row in rows:
        view = row["views"]["CTP"]
        figure = Figure(figsize=(9.6, 3.4), layout="constrained")
        image = np.asarray(view["image"])
        stages = (
            ("range image", image, "viridis"),
            ("several ranges", view["raw_mask"], "gray_r"),
            ("after closing and median", view["mask"], "gray_r"),
        )
        for number, (title, picture, colors) in enumerate(stages):
            axes = figure.add_subplot(1, 3, number + 1)
            if len(picture):
                axes.imshow(np.asarray(picture)[:, ::-1], origin="lower", cmap=colors)
            axes.set(title=title, xticks=[], yticks=[])
        figures[f"Stages of IsOcclusionConsistent, CTP ({row['model']})"] = figure
    return figures


def signals(rows: Sequence[Row]) -> dict[str, Figure]:
    """Draw MIN_ipd over range, its moving average, and sudden changes in sectors."""
    from matplotlib.figure import Figure

    figures = {}
    for row in rows:
        figure = Figure(figsize=(10.5, 3.6), layout="constrained")
        panels = (
            ("a) MIN_ipd", "ranges", "signal_mm", "mm"),
            ("b) moving average", "ranges", "smooth_mm", "mm"),
            ("c) lowest of the sectors over usual", "local_ranges", "local_ratio", "ratio"),
        )
        for number, (title, x, y, unit) in enumerate(panels):
            axes = figure.add_subplot(1, 3, number + 1)
            for name in ("original", "CTP", "CRTP"):
                view = row["views"][name]
                axes.plot(view[x], view[y], label=name, linewidth=1)
            axes.set(title=title, xlabel="range, m", ylabel=unit, xlim=(0, 30))
            axes.grid(alpha=0.3)
        axes.legend()
        figures[f"Spacing over range ({row['model']})"] = figure
    return figures
