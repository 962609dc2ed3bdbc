"""The evidence of one inspected scan as a self-contained HTML page, or as JSON."""

from __future__ import annotations

import base64
import html
import io
import itertools
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d import __version__, viewer
from manip3d._util.checked import checked
from manip3d._util.html import html_page, wide
from manip3d.authenticate._edits import EDIT_MEANINGS
from manip3d.authenticate._power import NOT_FOUND
from manip3d.authenticate._verdict import FALSE_ALARM_RATE, PLANTED_HERE, Calibration, Power
from manip3d.datasets import file_sha256
from manip3d.report._evidence_files import write_page_or_record
from manip3d.report._suspected import place_sentence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from manip3d.authenticate import (
        DensityResult,
        DetectorReport,
        Inspection,
        OcclusionResult,
        Region,
    )

_MAX_ROWS, _MAX_COLUMNS = 600, 1600  # largest size of the occlusion map, pixels
_MAX_REGIONS = 24  # largest number of regions that are drawn


@checked
def write_evidence(
    inspection: Inspection, output: str | os.PathLike[str], *, source: str = "scan"
) -> None:
    """Write the results of the detectors on a scan as one file.

    Parameters
    ----------
    inspection : Inspection
        The result of `manip3d.authenticate.inspect`.
    output : path
        Output file. ``.html``: a self-contained page with the scan as points, and with pictures if
        matplotlib is installed; ``.json``: the numbers. An existing file is replaced.
    source : str
        Name of the scan, for the title.

    Raises
    ------
    InputError
        The suffix is neither of the two.

    Examples
    --------
    >>> import json
    >>> from pathlib import Path
    >>> from manip3d import authenticate, forge, report, simulate
    >>> scan = simulate.courtyard()
    >>> forged = forge.subtract(scan, forge.nearest_object(scan))
    >>> found = authenticate.inspect(forged.frame)
    >>> report.write_evidence(found, "scan.json", source="scan.bin")
    >>> record = json.loads(Path("scan.json").read_text())
    >>> record["source"], record["verdict"]
    ('scan.bin', 'tampered')
    """
    write_page_or_record(
        output,
        page=lambda: _page(inspection, source),
        record=lambda: {"source": source} | inspection.record(),
    )


# --- pictures -------------------------------------------------------------------------------------


def _pictures(inspection: Inspection) -> dict[str, str]:
    """Return PNG data by caption; empty if matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return {}
    pictures = {}
    if inspection.density is not None and len(inspection.density.ranges):
        caption = "Spacing of points over range; ranges that are off are marked"
        pictures[caption] = _png(_density_figure(Figure, inspection.density))
    if inspection.occlusion is not None and inspection.occlusion.mask.any():
        caption = "Directions in which something is seen behind something else"
        pictures[caption] = _png(_occlusion_figure(Figure, inspection.occlusion))
    regions = _region_figure(Figure, inspection)
    if regions is not None:
        accusing = inspection.all_accusing
        noun = "detector" if len(accusing) == 1 else "detectors"
        caption = f"Regions of the accusing {noun}: suspected points in orange"
        if any(report.name == "turns" for report in accusing):
            caption += ", what the turn before saw there in blue"
        pictures[caption + _how_many(inspection)] = _png(regions)
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
    if measured.size:  # the axes end at the last measurement; the fit continues beyond it
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
    """Return the mask reduced to at most 1600 columns and 600 rows, by the maximum of blocks."""
    down, across = (
        max(1, -(-size // most))
        for size, most in zip(mask.shape, (_MAX_ROWS, _MAX_COLUMNS), strict=True)
    )
    rows, columns = (
        -(-size // step) for size, step in zip(mask.shape, (down, across), strict=True)
    )
    padded = np.zeros((rows * down, columns * across), mask.dtype)
    padded[: mask.shape[0], : mask.shape[1]] = mask
    blocks = padded.reshape(rows, down, columns, across)
    return np.asarray(blocks.max(axis=(1, 3)))


class _Drawn(NamedTuple):
    """A region to be drawn, with its row in the detector's table (from 0).

    ``before``: points (N, 3) of the previous frame in the region (detector IV only, else empty).
    """

    report: DetectorReport
    place: int
    region: Region
    before: NDArray[np.float64]


def _drawn_regions(inspection: Inspection) -> list[_Drawn]:
    """Return the regions of all accusing detectors that have points.

    The most significant region of each detector comes first, then the second one of each.
    """
    columns = [_drawn_of(report, inspection) for report in inspection.all_accusing]
    rows = itertools.zip_longest(*columns)
    return [each for row in rows for each in row if each is not None]


def _drawn_of(report: DetectorReport, inspection: Inspection) -> list[_Drawn]:
    """Return the regions of a detector that have points, the most significant first."""
    stood: Sequence[NDArray[np.float32]] = [np.empty((0, 3), np.float32)] * len(report.regions)
    if report.name == "turns" and inspection.turns is not None:
        stood = [region.stood for region in inspection.turns.regions]
    drawn = [
        _Drawn(report, place, region, before.astype(np.float64))
        for place, (region, before) in enumerate(zip(report.regions, stood, strict=True))
        if len(region.rows) or len(before)
    ]
    return sorted(drawn, key=lambda each: _insignificance(each.region))


def _insignificance(region: Region) -> tuple[float, float]:
    """Return a sort key: by p-value, then by the strongest evidence, most significant first."""
    p_value = 1.0 if region.p_value is None else region.p_value
    return p_value, -max(region.evidence.values(), default=0.0)


def _how_many(inspection: Inspection) -> str:
    """Return a phrase with the number of drawn regions; empty if all are drawn."""
    count = len(_drawn_regions(inspection))
    if count <= _MAX_REGIONS:
        return ""
    return f"; the {_MAX_REGIONS} most significant of {count}, the table has all"


def _region_figure(figure_type: type[Figure], inspection: Inspection) -> Figure | None:
    """Return crops of the range image around the regions of the accusing detectors."""
    scan = inspection.scan
    shown = _drawn_regions(inspection)[:_MAX_REGIONS]
    if scan is None or not shown:
        return None
    figure = figure_type(figsize=(8, 2.6 * len(shown)), layout="constrained")
    seen = scan.points.astype(np.float64) - np.asarray(inspection.origin or (0.0, 0.0, 0.0))
    rho, azimuth, height = _directions(seen)
    pairs = figure.subplots(len(shown), 2, squeeze=False)
    for (report, place, region, before), (across, along) in zip(shown, pairs, strict=True):
        there = np.concatenate([seen[region.rows], before])
        far, around, above = _directions(there)
        middle = float(np.angle(np.exp(1j * around).mean()))
        turned = np.angle(np.exp(1j * (azimuth - middle)))
        wide = np.angle(np.exp(1j * (around - middle)))
        half = 1.5 * float(np.abs(wide).max()) + np.radians(1.0)
        near = (np.abs(turned) < half) & (height > above.min() - 0.02)
        near &= height < above.max() + 0.02
        suspected = np.zeros(len(rho), np.bool_)
        suspected[region.rows] = True
        for rows, color, size in ((near & ~suspected, "#999999", 2), (suspected, "#D55E00", 5)):
            degrees = np.degrees(middle + turned[rows])
            across.scatter(degrees, np.degrees(height[rows]), s=size, color=color, linewidths=0)
            along.scatter(rho[rows], seen[rows, 2], s=size, color=color, linewidths=0)
        old = slice(len(region.rows), None)
        degrees = np.degrees(middle + wide[old])
        across.scatter(degrees, np.degrees(above[old]), s=2, color="#0072B2", linewidths=0)
        along.scatter(far[old], there[old, 2], s=2, color="#0072B2", linewidths=0)
        _draw_lattice(along, inspection, far, there[:, 2])
        said = "" if region.p_value is None else f", p-value {p_text(region.p_value)}"
        across.set(
            title=f"detector {report.number}, region {place + 1}{said}",
            xlabel="azimuth, deg",
            ylabel="elevation, deg",
        )
        along.set(title="points against the lattice", xlabel="distance, m", ylabel="height, m")
    return figure


def _directions(
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return horizontal distance (metres), azimuth and elevation (radians) of points."""
    rho = np.hypot(points[:, 0], points[:, 1])
    return rho, np.arctan2(points[:, 1], points[:, 0]), np.arctan2(points[:, 2], rho)


def _draw_lattice(
    axes: Axes, inspection: Inspection, rho: NDArray[np.float64], z: NDArray[np.float64]
) -> None:
    """Draw the lines of the lattice, on which points of this scanner lie, around a region."""
    low, high = float(rho.min()) - 0.5, float(rho.max()) + 0.5
    bottom, top = float(z.min()) - 0.2, float(z.max()) + 0.2
    axes.set(xlim=(low, high), ylim=(bottom, top))
    lattice = None if inspection.generic is None else inspection.generic.lattice
    if lattice is None:
        return
    for slope, offset in zip(lattice.slope, lattice.offset, strict=True):
        axes.plot([low, high], [slope * low + offset, slope * high + offset], "b-", lw=0.4)


def _png(figure: Figure) -> str:
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return base64.b64encode(stream.getvalue()).decode()


# --- the page -------------------------------------------------------------------------------------

PAGE_STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;"
    # break-word, because paths and hashes are long words
    "overflow-wrap:break-word}small{display:block;color:#5d636b}"
    ".wide{overflow-x:auto;font-size:.9rem}table{border-collapse:collapse}"
    "td,th{padding:.2rem .6rem;text-align:left;border-bottom:1px solid #ccc}"
    "img{max-width:100%}.long{min-width:12rem}"
    "@media(max-width:40rem){body{margin:1rem auto}td,th{padding:.2rem .4rem}}"
    ".tampered{color:#b00020}.no_trace{color:#1b5e20}.undecidable,.processed{color:#7a5c00}"
)


def _page(inspection: Inspection, source: str) -> str:
    pictures = _pictures(inspection)
    verdict = inspection.verdict
    points = f"{inspection.num_points:,}".replace(",", " ")
    content = (
        f"<h1 class={verdict}>{verdict}</h1>"
        f"<p>{html.escape(inspection.reason)}</p>"
        + _ratio(inspection)
        + f"<p>{html.escape(source)}, {points} points; "
        + f"{html.escape(place_sentence(inspection))}</p>"
        + _facts(inspection, source)
        + _verdicts(inspection)
        + _scene(inspection)
        + _regions(inspection)
        + _power(inspection)
        + "".join(
            f'<h2>{html.escape(caption)}</h2><img alt="{html.escape(caption)}" '
            f'src="data:image/png;base64,{data}">'
            for caption, data in pictures.items()
        )
        + _calibrations(inspection)
    )
    return html_page(f"{source}: {verdict}", PAGE_STYLE, content)


def _verdicts(inspection: Inspection) -> str:
    rows = "".join(_verdict_row(report) for report in inspection.detectors)
    header = "<tr><th>detector<th>verdict<th>why<th>suspected points</tr>"
    return wide("Verdicts of the detectors", f"<table>{header}{rows}</table>")


def _verdict_row(report: DetectorReport) -> str:
    return (
        f"<tr><td>{html.escape(report.title)}</td>"
        f"<td class={report.verdict}>{report.verdict}</td>"
        f"<td>{html.escape(report.reason)}</td><td>{len(report.suspected)}</td></tr>"
    )


def _scene(inspection: Inspection) -> str:
    """Return a 3D view of the scan, with suspected points and boxes coloured by detector."""
    if inspection.scan is None or not inspection.scan.num_points:
        return ""
    return viewer.figure(inspection, "The scan, with suspected points and boxes by detector")


def _ratio(inspection: Inspection) -> str:
    """Return a paragraph on the likelihood ratio; empty if there is none."""
    ratio = inspection.likelihood_ratio
    if ratio is None:
        return ""
    favoured = "an edit" if ratio > 1.0 else "a clean scan"
    return (
        f"<p>Likelihood ratio of an edit over a clean scan: {ratio:.3g}. It favours {favoured}; "
        "over many clean scans its mean is at most 1.</p>"
    )


def _facts(inspection: Inspection, source: str) -> str:
    """Return a list of facts: file, scanner, processing, limits and smallest p-values."""
    facts = [f"manip3d {__version__}"]
    if os.path.isfile(source):  # False also for a text that is too long for a path
        facts.append(f"SHA-256 of the file: {file_sha256(Path(source))}")
    if inspection.sensor is not None:
        facts.append(f"scanner: {inspection.sensor.name}; {inspection.sensor.reason}")
    facts += [f"{step.kind}: {step.detail}" for step in inspection.processing]
    generic = inspection.generic
    if generic is not None:
        facts.append(
            f"limit of false alarms: all detectors together may call {FALSE_ALARM_RATE:.0%} of "
            "clean scans tampered; each detector has a share of that"
        )
        facts.append(_p_values("III", generic.false_alarm_rate, generic.p_value))
        facts += [
            f"detector III: where p-values are listed, {bound:.2g} stands for all smaller ones, "
            f"which rest on its model of clean scans alone: {known.num_scans} scans tested it"
            for known in (r.calibration for r in inspection.detectors if r.name == "generic")
            if known is not None and generic.p_value < (bound := 1.0 / (1 + known.num_scans))
        ]
        used = [kind for kind, said in generic.evidence.items() if said.used]
        facts.append(f"kinds of evidence that were used: {', '.join(used) or 'none'}")
    if inspection.turns is not None:
        turns = inspection.turns
        facts.append(_p_values("IV", turns.false_alarm_rate, turns.p_value))
    if inspection.reflectance is not None:
        reflectance = inspection.reflectance
        facts.append(_p_values("V", reflectance.false_alarm_rate, reflectance.p_value))
    return "<ul>" + "".join(f"<li>{html.escape(fact)}</li>" for fact in facts) + "</ul>"


def _p_values(detector: str, limit: float, smallest: float) -> str:
    return (
        f"detector {detector}: p-values up to {limit:g} raise an alarm; the smallest of this scan "
        f"is {p_text(smallest)}"
    )


def _evidence_text(evidence: Mapping[str, float]) -> str:
    return ", ".join(f"{kind} {strength:.3g}" for kind, strength in evidence.items())


def p_text(value: float | None) -> str:
    """Return a p-value as text; 0 means that it is below the range of double precision."""
    if value is None:
        return ""
    return f"{value:.2g}" if value > 0.0 else "below 1e-300"


def _regions(inspection: Inspection) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(report.number)}</td><td>{number}</td>"
        + "".join(f"<td>{v:.2f}</td>" for v in (*region.box.center, *region.box.size))
        + f"<td>{math.degrees(region.box.yaw):.0f}</td><td>{len(region.rows)}</td>"
        + f"<td>{p_text(region.p_value)}</td>"
        + f"<td class=long>{html.escape(_evidence_text(region.evidence))}"
        + f"{_small(region.note)}</td>"
        + "</tr>"
        for report in inspection.detectors
        for number, region in enumerate(map(inspection.in_file, report.regions), 1)
    )
    if not rows:
        return ""
    header = (
        "<tr><th>detector<th>region<th>x<th>y<th>z<th>length<th>width<th>height<th>yaw, deg"
        "<th>points<th>p at most<th>evidence</tr>"
    )
    table = wide("Regions, metres", f"<table>{header}{rows}</table>")
    return f"<h2>Regions, metres</h2>{table}"


def _power(inspection: Inspection) -> str:
    if not inspection.power:
        return ""
    # EDIT_MEANINGS describes the edits of detectors III to V; those of I and II differ.
    meanings = EDIT_MEANINGS if inspection.generic is not None else {}
    rows = "".join(
        f"<tr><td>{html.escape(name)}{_small(meanings.get(name, ''))}</td>"
        f"<td>{power.share:.0%}</td>"
        f"<td>{_counts(power)}</td></tr>"
        for name, power in inspection.power.items()
    )
    rows += "".join(
        f"<tr><td>{html.escape(name)}</td><td>0%</td><td>{NOT_FOUND}</td></tr>"
        for name in inspection.blind
    )
    sources = {power.source for power in inspection.power.values() if power.source}
    notes = "".join(f"<p>{html.escape(note)}</p>" for note in inspection.power_notes)
    header = "<tr><th>edits of this class<th>found<th>edits found and planted</tr>"
    title = "What would have been found"
    return (
        f"<h2>{title}</h2>{wide(title, f'<table>{header}{rows}</table>')}{notes}"
        f"<p>{html.escape('; '.join(sorted(sources)))}</p>"
    )


def _counts(power: Power) -> str:
    """Numbers of edits found and planted, in clean scans and in copies of the inspected one."""
    counts = [] if power.source == PLANTED_HERE else [f"{power.found} of {power.planted}"]
    if power.here_planted:
        counts.append(f"{power.here_found} of {power.here_planted} in this scan")
    return "; ".join(counts)


def _small(text: str) -> str:
    return f"<small>{html.escape(text)}</small>" if text else ""


def _calibrations(inspection: Inspection) -> str:
    items = "".join(
        f"<li>{html.escape(f'{report.title}: {_calibration(report.calibration)}')}</li>"
        for report in inspection.detectors
        if report.calibration is not None
    )
    return f"<h2>Where the thresholds come from</h2><ul>{items}</ul>" if items else ""


def _calibration(known: Calibration) -> str:
    if known.chose:
        sentence = (
            f"{known.scenes}; the thresholds were chosen on these {known.num_scans} clean scans so "
            f"that {known.false_alarms} of them alarm, which says nothing about how often other "
            "clean scans do."
        )
    else:
        sentence = (
            f"tested on {known.scenes}: {known.false_alarms} of {known.num_scans} clean scans "
            "alarm. The thresholds were not chosen on these scans; they follow from how the "
            "scanner measures."
        )
    return f"{sentence} {known.note}"
