"""Figures 7.9 and 7.10: displacement of points by the watermark, and recovery without attack."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manip3d.experiments import _alert_set
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from manip3d.lidar import LidarFrame

_FRAMES = {"quick": 2, "full": 40}
_PUBLISHED = {"lbm": 0.001732, "qim-printed": 0.00125}
"""Average Hausdorff distances of section 7.6, metres."""
_MAX = {
    "lbm": 3.0**0.5 / 1000.0, "qim-printed": 0.00125,
    "keyed lbm": 3.0**0.5 / 1000.0, "keyed qim": 0.001875, "keyed detached": 0.0,
}  # fmt: skip
"""Largest displacement of a point by an embedding, metres."""
_DRAWN = {"lbm": "LBM", "qim-printed": "QIM"}
"""Embeddings whose scans figures 7.9 and 7.10 show."""
_FLOAT = 4e-6  # metres; rounding error of two float32 coordinates of up to 128 m
_SHOWN = 20_000  # number of points in the picture


def _cases(plan: Plan) -> list[Case]:
    return _alert_set.cases_of_drives(embed, plan, "method", _MAX, frames=_FRAMES[plan.scale])


def embed(case: Case) -> Row:
    """Embed and extract the watermark of each frame of a drive, and measure the displacements."""
    options = case.options
    distances, recovered = [], 0
    row: Row = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, frame, _ in _alert_set.frames(options["seed"], 0, options["frames"]):
            sent, right = _marked(frame, options["method"], number, Path(folder))
            moved = sent.points.astype(np.float64) - frame.points
            # Points keep their rows, and each moves by less than half of the distance between two
            # points. The nearest point of each is therefore the same point before embedding, and
            # the Hausdorff distance is the largest displacement.
            distances.append(float(np.sqrt((moved**2).sum(axis=1)).max()))
            recovered += right
            if number == 0:
                step = max(1, frame.num_points // _SHOWN)
                row["before"] = frame.points[::step].ravel().tolist()
                row["after"] = sent.points[::step].ravel().tolist()
    return row | {
        "hausdorff_mm": 1e3 * float(np.mean(distances)),
        "largest_mm": 1e3 * max(distances),
        "recovered": recovered / len(distances),
    }


def _marked(frame: LidarFrame, method: str, number: int, folder: Path) -> tuple[LidarFrame, bool]:
    """Return the frame with its watermark, and whether the whole watermark is recovered."""
    from manip3d import authenticate

    if not method.startswith("keyed"):
        blocks = authenticate.noise_blocks(number)
        marked = authenticate.embed_paper(frame, blocks, embedding=method, frame=number)
        compared = authenticate.compare_paper(marked.frame, blocks, marked.metadata)
        return marked.frame, not compared.mismatches.any() and not compared.changed_tiles
    path = folder / "experiment.key"
    key = authenticate.KeyFile(path) if path.exists() else authenticate.KeyFile.create(path)
    with key, authenticate.Watermarker(key, embedding=method.removeprefix("keyed ")) as marker:
        sent = marker.embed(frame)
        return sent.frame, marker.verify(sent.frame, sent.record).verdict == "authentic"


def _complete(row: Row) -> Row:
    if row["method"] in _PUBLISHED:
        return row | {"published_mm": 1e3 * _PUBLISHED[row["method"]]}
    return row


def _imperceptible(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        most = 1e3 * (_MAX[row["method"]] + (_FLOAT if row["method"] != "keyed detached" else 0.0))
        numbers = f"{row['hausdorff_mm']:.4f} mm on average, {row['largest_mm']:.4f} mm at most"
        yield Finding(f"{row['model']}, {row['method']}", row["largest_mm"] <= most, numbers)


def _as_published(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if row["method"] in _PUBLISHED:
            printed = 1e3 * _PUBLISHED[row["method"]]
            numbers = f"{row['hausdorff_mm']:.4f} mm, published {printed:.4f} mm"
            same = abs(row["hausdorff_mm"] - printed) <= 1e3 * _FLOAT
            yield Finding(f"{row['model']}, {row['method']}", same, numbers)


def _recovered(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['recovered']:.0%} of {row['frames']} frames"
        yield Finding(f"{row['model']}, {row['method']}", row["recovered"] == 1.0, numbers)


def _figures(rows: Sequence[Row]) -> dict[str, Figure]:
    from matplotlib.figure import Figure

    figures = {}
    for row in rows:
        if row["method"] not in _DRAWN:
            continue
        figure = Figure(figsize=(11.0, 4.6), layout="constrained")
        for place, (title, name) in enumerate((("original", "before"), ("watermarked", "after"))):
            points = np.asarray(row[name]).reshape(-1, 3)
            axes = figure.add_subplot(1, 2, place + 1)
            axes.scatter(points[:, 0], points[:, 1], c=points[:, 2], s=0.3, vmin=-2.0, vmax=3.0)
            axes.set(title=title, xlabel="x, m", ylabel="y, m", xlim=(-30, 50), ylim=(-30, 30),
                     aspect="equal")  # fmt: skip
        figures[f"Before and after {_DRAWN[row['method']]} ({row['model']})"] = figure
    return figures


EXPERIMENT = Experiment(
    id="figure-7.10",
    title="How far the watermark moves points, and its recovery without an attack",
    published="",
    data=(),
    cases=_cases,
    role="simulated drives of an HDL-64E through streets",
    columns=(
        Column("frames", "frames"),
        Column("hausdorff_mm", "Hausdorff distance, mean, mm", digits=4, published="published_mm"),
        Column("largest_mm", "largest, mm", digits=4),
        Column("recovered", "recovered, share of frames", digits=3),
    ),
    claims=(
        Claim(
            "The average Hausdorff distance is 1.732 mm (LBM) and 1.25 mm (QIM)",
            "section 7.6",
            _as_published,
        ),
        Claim("No point is moved farther than its embedding may", "aim", _imperceptible),
        Claim("Without an attack every frame's watermark is recovered", "section 7.6", _recovered),
    ),
    complete=_complete,
    figures=_figures,
    notes=(
        "The distance between the scan and its watermarked copy is that of the point that moved "
        "farthest. 1.732 mm needs one point of 120 000 whose three lowest bits are all changed.",
    ),
)
