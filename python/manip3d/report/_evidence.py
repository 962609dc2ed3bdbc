"""The evidence of one inspected scan as a page that loads nothing, or as JSON."""

from __future__ import annotations

import base64
import html
import io
import json
import os
from typing import TYPE_CHECKING

import numpy as np

from manip3d import viewer
from manip3d._util.checked import checked
from manip3d._util.json import finite
from manip3d._util.paths import path_of
from manip3d.errors import InputError
from manip3d.io._files import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from manip3d.authenticate import DensityResult, DetectorReport, Inspection, OcclusionResult

EVIDENCE_KINDS = (".html", ".json")
"""Suffixes that `write_evidence` knows."""

_MOST_ROWS, _MOST_COLUMNS = 600, 1600


@checked
def write_evidence(
    inspection: Inspection, output: str | os.PathLike[str], *, source: str = "scan"
) -> None:
    """Write what the detectors found in a scan as one file.

    Parameters
    ----------
    inspection : Inspection
        The result of `manip3d.authenticate.inspect`.
    output : path
        ``.html``: a self-contained page with the scan as points, and with pictures where
        matplotlib is installed;
        ``.json``: the numbers. An existing file is replaced.
    source : str
        Name of the scan, for the title.

    Raises
    ------
    InputError
        The suffix is neither of the two.
    """
    path = path_of(output, "output")
    kind = path.suffix.lower()
    if kind not in EVIDENCE_KINDS:
        raise InputError(f"output: expected a name that ends in .html or .json, got {path.name}")
    if kind == ".json":
        record = {"source": source} | inspection.record()
        text = json.dumps(finite(record), indent=1) + "\n"
    else:
        text = _page(inspection, source)
    atomic_write(path, text.encode())


# --- pictures -------------------------------------------------------------------------------------


def _pictures(inspection: Inspection) -> dict[str, str]:
    """PNG data by caption; none without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return {}
    pictures = {}
    if inspection.density is not None and len(inspection.density.ranges):
        caption = "Spacing of points over range; ranges that are off are marked"
        pictures[caption] = _png(_density_figure(Figure, inspection.density))
    if inspection.occlusion is not None and inspection.occlusion.mask.size:
        caption = "Directions in which something is seen behind something else"
        pictures[caption] = _png(_occlusion_figure(Figure, inspection.occlusion))
    return pictures


def _density_figure(figure_type: type[Figure], density: DensityResult) -> Figure:
    figure = figure_type(figsize=(8, 3), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(density.ranges, 1e3 * density.signal, label="spacing", color="#0072B2")
    axes.plot(density.ranges, 1e3 * density.fit, label="usual at this range", color="#999999")
    for low, high in density.offending:
        axes.axvspan(low, high, color="#D55E00", alpha=0.3)
    axes.set(xlabel="range, m", ylabel="nearest neighbour, mm")
    measured = np.flatnonzero(np.isfinite(density.signal))
    if measured.size:  # beyond the last point only the fit goes on
        last = measured[-1]
        axes.set_xlim(0.0, 1.05 * density.ranges[last])
        axes.set_ylim(0.0, 1.5e3 * max(density.fit[last], np.nanmax(density.signal)))
    axes.legend()
    return figure


def _occlusion_figure(figure_type: type[Figure], occlusion: OcclusionResult) -> Figure:
    figure = figure_type(figsize=(8, 3), layout="constrained")
    axes = figure.add_subplot()
    top = occlusion.lowest_deg + occlusion.mask.shape[0] * occlusion.grid.elevation_deg
    axes.imshow(
        _shrunk(occlusion.mask),
        origin="lower",
        aspect="auto",
        cmap="gray_r",
        extent=(-180.0, 180.0, occlusion.lowest_deg, top),
    )
    axes.set(xlabel="azimuth, degrees", ylabel="elevation, degrees")
    return figure


def _shrunk(mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The mask in at most 1600 columns and 600 rows; a marked cell stays visible."""
    down, across = (
        max(1, -(-size // most))
        for size, most in zip(mask.shape, (_MOST_ROWS, _MOST_COLUMNS), strict=True)
    )
    rows, columns = (
        -(-size // step) for size, step in zip(mask.shape, (down, across), strict=True)
    )
    padded = np.zeros((rows * down, columns * across), mask.dtype)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    blocks = padded.reshape(rows, down, columns, across)
    return np.asarray(blocks.max(axis=(1, 3)))


def _png(figure: Figure) -> str:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return base64.b64encode(stream.getvalue()).decode()


# --- the page -------------------------------------------------------------------------------------

_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}"
    ".wide{overflow-x:auto}table{border-collapse:collapse}td,th{padding:.2rem .8rem;"
    "text-align:left;border-bottom:1px solid #ccc}img{max-width:100%}"
    "@media(max-width:40rem){body{margin:1rem auto}td,th{padding:.2rem .4rem}}"
    ".tampered{color:#b00020}.authentic{color:#1b5e20}.undecidable{color:#7a5c00}"
)


def _page(inspection: Inspection, source: str) -> str:
    pictures = _pictures(inspection)
    verdict = inspection.verdict
    points = f"{inspection.num_points:,}".replace(",", " ")
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        '<meta name=viewport content="width=device-width">'
        f"<title>{html.escape(source)}: {verdict}</title><style>{_STYLE}</style>"
        f"<h1 class={verdict}>{verdict}</h1>"
        f"<p>{html.escape(source)}, {points} points; {html.escape(place_sentence(inspection))}</p>"
        + _verdicts(inspection)
        + _scene(inspection)
        + _boxes(inspection)
        + "".join(
            f'<h2>{html.escape(caption)}</h2><img alt="{html.escape(caption)}" '
            f'src="data:image/png;base64,{data}">'
            for caption, data in pictures.items()
        )
        + _calibrations(inspection)
        + "</html>\n"
    )


@checked
def place_sentence(inspection: Inspection) -> str:
    """Say where the scanner stood and who states it."""
    if inspection.origin is None:
        return "the scanner's position is not known"
    x, y, z = inspection.origin
    source = {"argument": "given", "file": "stated by the file"}.get(
        inspection.origin_from, f"found from {inspection.origin_from}"
    )
    return f"scanner at ({x:.3f}, {y:.3f}, {z:.3f}) m, {source}"


def _verdicts(inspection: Inspection) -> str:
    rows = "".join(_verdict_row(report) for report in inspection.detectors)
    header = "<tr><th>detector<th>verdict<th>why<th>suspected points</tr>"
    return f"<div class=wide><table>{header}{rows}</table></div>"


def _verdict_row(report: DetectorReport) -> str:
    return (
        f"<tr><td>{html.escape(report.title)}</td>"
        f"<td class={report.verdict}>{report.verdict}</td>"
        f"<td>{html.escape(report.reason)}</td><td>{len(report.suspected)}</td></tr>"
    )


def _scene(inspection: Inspection) -> str:
    """The scan as points, with suspected ones and boxes coloured by detector."""
    if inspection.scan is None or not inspection.scan.num_points:
        return ""
    return viewer.figure(inspection, "The scan, with suspected points and boxes by detector")


def _boxes(inspection: Inspection) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(report.title)}</td>"
        + "".join(f"<td>{value:.2f}</td>" for value in (*box.center, *box.size))
        + "</tr>"
        for report in inspection.detectors
        for box in report.boxes
    )
    if not rows:
        return ""
    header = "<tr><th>detector<th>x<th>y<th>z<th>length<th>width<th>height</tr>"
    return f"<h2>Boxes, metres</h2><div class=wide><table>{header}{rows}</table></div>"


def _calibrations(inspection: Inspection) -> str:
    items = "".join(
        f"<li>{html.escape(report.title)}: {html.escape(report.calibration.scenes)}; the "
        f"thresholds were chosen on these {report.calibration.num_scans} clean scans so that "
        f"{report.calibration.false_alarms} of them alarm, which says nothing about how often "
        f"other clean scans do. {html.escape(report.calibration.note)}</li>"
        for report in inspection.detectors
        if report.calibration is not None
    )
    return f"<h2>Where the thresholds come from</h2><ul>{items}</ul>" if items else ""
