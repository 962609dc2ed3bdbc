"""The evidence of a whole drive as one self-contained HTML page: timeline, map and table."""

from __future__ import annotations

import html
import math
import os
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d import __version__
from manip3d._util.checked import checked
from manip3d._util.html import html_page, wide
from manip3d._util.linear import inverse, product
from manip3d._util.paths import path_of
from manip3d._util.texts import counted
from manip3d.errors import InputError
from manip3d.io._files import atomic_write
from manip3d.lidar import box_outline
from manip3d.report._evidence import PAGE_STYLE, p_text
from manip3d.report._evidence_files import page_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate import DriveEvidence, Inspection
    from manip3d.lidar import Box

    Pose = NDArray[np.float64]

COLORS = {
    "no_trace": "#7fb285",
    "tampered": "#b00020",
    "processed": "#c9a227",
    "undecidable": "#8d8d8d",
    "not read": "#dddddd",
}
"""Colours of the verdicts, which are also stated by the bars' tooltips and by the table."""

WIDTH, BAR, PLOT = 900.0, 26.0, 120.0  # pixels: width, height of bars and of the plot
HIGHEST = 600.0
"""Largest height of the map in pixels."""

DEEPEST = 12.0
"""Smaller p-values than 10 to the power of -DEEPEST are drawn at that value."""

P_VALUES = (
    ("generic", "blue", "#0072B2", 2.5, "p-value by its model of clean scans"),
    ("turns", "orange", "#D55E00", 4.0, "p-value, whose smallest is that of its calibration"),
    ("reflectance", "green", "#009E73", 5.5, "p-value, whose smallest is that of its calibration"),
)
"""Detectors whose p-values are drawn: name, colour in words and as drawn, radius of the circles in
pixels, and what the value is. That of detector III is drawn as its model states it, because the
verdict follows from that value."""

MAX_ROWS = 500
"""Largest number of rows in the table; further rows are counted."""


@checked
def write_drive_evidence(
    found: Sequence[Inspection | None],
    output: str | os.PathLike[str],
    *,
    names: Sequence[str],
    source: str = "drive",
    errors: Sequence[str] = (),
    numbers: Sequence[int] | None = None,
    times_ns: Sequence[int | None] | None = None,
) -> None:
    """Write the results of the detectors on the scans of a drive as one page.

    Parameters
    ----------
    found : sequence of (Inspection or None)
        The results of `manip3d.authenticate.inspect_drive`; None: a scan that could not be read.
    output : path
        Output file that ends in ``.html``: a self-contained page with a timeline of verdicts and
        p-values, a map of the scanner's path with the suspected places, and a table. An existing
        file is replaced.
    names : sequence of str
        Name of each scan.
    source : str
        Name of the drive, for the title.
    errors : sequence of str
        Messages about the scans that could not be read.
    numbers : sequence of int, optional
        See `manip3d.authenticate.verdict_of_drive`.
    times_ns : sequence of (int or None), optional
        See `manip3d.authenticate.judge_drive`.

    Raises
    ------
    InputError
        The suffix is another one, or the numbers of names, of ``numbers`` and of results differ.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> import numpy as np
    >>> from manip3d import LidarFrame, authenticate, report
    >>> empty = LidarFrame(np.zeros((0, 3), np.float32))
    >>> found = list(authenticate.inspect_drive([empty, empty]))
    >>> page = pathlib.Path(tempfile.mkdtemp()) / "drive.html"
    >>> report.write_drive_evidence(found, page, names=["0", "1"])
    >>> "undecidable" in page.read_text()
    True
    """
    path = path_of(output, "output")
    if path.suffix.lower() != ".html":
        raise InputError(f"output: expected a name that ends in .html, got {path.name}")
    if len(names) != len(found):
        raise InputError(f"names: expected {len(found)}, one for each scan, got {len(names)}")
    page = _drive_page(found, names, source, errors, numbers, times_ns)
    atomic_write(path, page_bytes(page))


def scanner_poses(found: Sequence[Inspection | None]) -> list[Pose | None]:
    """Return the scanner's pose at each scan, in the frame of the first scan.

    Parameters
    ----------
    found : sequence of (Inspection or None)
        The results of `manip3d.authenticate.inspect_drive`.

    Returns
    -------
    list of ((4, 4) float64 or None)
        Products of the alignments of detector IV; None from the first scan that is not aligned.
    """
    poses: list[Pose | None] = []
    for number, each in enumerate(found):
        if number == 0:
            poses.append(np.eye(4))
            continue
        last, before = poses[-1], found[number - 1]
        pose = None
        if last is not None and each is not None and _aligned(each):
            assert each.turns is not None
            pose = product(last, inverse(each.turns.previous))
        elif last is not None and before is not None and _aligned(before):
            assert before.turns is not None
            pose = product(last, before.turns.following)
        poses.append(pose)
    return poses


def _aligned(found: Inspection) -> bool:
    return found.turns is not None and found.turns.aligned


def _drive_page(
    found: Sequence[Inspection | None],
    names: Sequence[str],
    source: str,
    errors: Sequence[str],
    numbers: Sequence[int] | None,
    times_ns: Sequence[int | None] | None,
) -> str:
    from manip3d.authenticate import judge_drive

    together = judge_drive(found, numbers, times_ns=times_ns)
    verdict, reason = together.verdict, together.reason
    counts = Counter(_word(each) for each in found)
    summary = ", ".join(f"{number} {word}" for word, number in sorted(counts.items()))
    content = (
        f"<h1 class={verdict}>{verdict}</h1><p>{html.escape(reason)}</p>"
        f"<p>{html.escape(source)}: {counted(len(found), 'scan')}; {html.escape(summary)}</p>"
        + _limits(found)
        + "<h2>Timeline</h2>"
        + _timeline(found, names)
        + _added_up(together.evidence)
        + _map(found, names)
        + _table(found, names)
        + "".join(f"<p>{html.escape(error)}</p>" for error in errors)
    )
    return html_page(f"{source}: {verdict}", PAGE_STYLE, content)


def _word(found: Inspection | None) -> str:
    return "not read" if found is None else found.verdict


def _limits(found: Sequence[Inspection | None]) -> str:
    """Return a list of facts: version, scanners, and the scans that fixed the thresholds."""
    facts = [
        f"manip3d {__version__}",
        "No verdict says that a scan is authentic: only a keyed watermark does.",
    ]
    scanners = Counter(each.sensor.name for each in found if each is not None and each.sensor)
    facts += [f"scanner of {counted(number, 'scan')}: {name}" for name, number in scanners.items()]
    told = {}
    for each in found:
        for report in () if each is None else each.detectors:
            if report.calibration is not None:
                known = report.calibration
                told[report.title] = (
                    f"{report.title}: thresholds of {known.num_scans} clean scans "
                    f"({known.scenes}), of which {known.false_alarms} alarm. {known.note}"
                )
    facts += list(told.values())
    return "<ul>" + "".join(f"<li>{html.escape(fact)}</li>" for fact in facts) + "</ul>"


def _timeline(found: Sequence[Inspection | None], names: Sequence[str]) -> str:
    """Return a bar for each scan, and below it the p-values of the detectors in `P_VALUES`."""
    if not found:
        return "<p>There are no scans.</p>"
    width = WIDTH / len(found)
    bars = "".join(
        f'<rect x="{scan * width:.2f}" y="0" width="{max(width - 0.5, 0.5):.2f}" height="{BAR:g}" '
        f'fill="{COLORS[_word(each)]}"><title>{html.escape(name)}: {_word(each)}</title></rect>'
        for scan, (each, name) in enumerate(zip(found, names, strict=True))
    )
    top = BAR + 12.0
    lines = "".join(
        f'<line x1="0" x2="{WIDTH:g}" y1="{top + _down(p_value):.1f}" '
        f'y2="{top + _down(p_value):.1f}" stroke="#ccc"/>'
        f'<text x="4" y="{top + _down(p_value) - 3:.1f}" font-size="11">{label}</text>'
        for p_value, label in (
            (0.01, "p = 0.01"),
            (1e-6, "1e-6"),
            (10.0**-DEEPEST, f"1e-{DEEPEST:g} and below"),
        )
    )
    circles = "".join(
        f'<circle cx="{(scan + 0.5) * width:.2f}" cy="{top + _down(p_value):.2f}" '
        f'r="{radius}" fill="none" stroke="{color}"/>'
        for detector, _, color, radius, _ in P_VALUES
        for scan, p_value in _p_values(found, detector)
    )
    drawing = (
        f'<svg viewBox="0 0 {WIDTH:g} {top + PLOT + 8:g}" width="{WIDTH:g}" '
        f'role="img" aria-label="Verdict and p-values of each scan">{bars}{lines}{circles}</svg>'
    )
    return f"{wide('Timeline', drawing)}<p>{_timeline_legend()}</p>"


def _down(p_value: float) -> float:
    """Return how far below the top of the plot a p-value is drawn, in pixels."""
    return PLOT * -math.log10(max(p_value, 10.0**-DEEPEST)) / DEEPEST


def _p_values(found: Sequence[Inspection | None], detector: str) -> list[tuple[int, float]]:
    """Return the indices of the scans of which a detector states a p-value, with that value.

    NaN is no p-value, and must not be drawn as evidence.
    """
    from_scans = ((scan, each) for scan, each in enumerate(found) if each is not None)
    stated = ((scan, _p_of(each, detector)) for scan, each in from_scans)
    return [(scan, p) for scan, p in stated if p is not None and not math.isnan(p)]


def _timeline_legend() -> str:
    from manip3d.authenticate._inspection import TITLES

    verdicts = ", ".join(
        f'<span style="border-left:1em solid {color}"> {word}</span>'
        for word, color in COLORS.items()
    )
    circles = "; ".join(
        f"{color} for detector {TITLES[detector].partition(':')[0]} ({meaning})"
        for detector, color, _, _, meaning in P_VALUES
    )
    return f"A bar for each scan: {verdicts}. Circles, the larger the later named: {circles}."


def _added_up(together: DriveEvidence) -> str:
    """Return the curve of the evidence accumulated over all frames, and the threshold.

    Both are base-10 logarithms of likelihood ratios.
    """
    if len(together.evidence) < 2:
        return ""
    lowest = min(0.0, float(together.evidence.min()))
    highest = 1.2 * max(together.threshold, float(together.evidence.max()), 1.0)
    high = PLOT / (highest - lowest)
    width = WIDTH / len(together.evidence)

    def level(value: float) -> str:
        return f"{high * (highest - value):.1f}"

    curve = " L".join(
        f"{(scan + 0.5) * width:.1f},{level(value)}"
        for scan, value in enumerate(together.evidence.tolist())
    )
    lines = "".join(
        f'<line x1="0" x2="{WIDTH:g}" y1="{level(value)}" y2="{level(value)}" stroke="{color}"/>'
        f'<text x="4" y="{high * (highest - value) - 3:.1f}" font-size="11">{label}</text>'
        for value, color, label in (
            (0.0, "#ccc", "ratio 1"),
            (together.threshold, "#b00020", f"alarm: 10^{together.threshold:.1f}"),
        )
    )
    drawing = (
        f'<svg viewBox="0 0 {WIDTH:g} {PLOT:g}" width="{WIDTH:g}" role="img" '
        f'aria-label="Base-10 logarithm of the likelihood ratio, which adds up over the scans">'
        f'{lines}<path d="M{curve}" fill="none" stroke="#0072B2" stroke-width="2"/></svg>'
    )
    title = "Evidence that adds up"
    return f"<h2>{title}</h2>{wide(title, drawing)}<p>{html.escape(together.statement)}</p>"


def _p_of(found: Inspection, detector: str) -> float | None:
    return next((r.least_p_value for r in found.detectors if r.name == detector), None)


def _map(found: Sequence[Inspection | None], names: Sequence[str]) -> str:
    """Return a map of the scanner's path from above, with boxes of regions in tampered scans."""
    poses = scanner_poses(found)
    way = [pose[:2, 3] for pose in poses if pose is not None]
    outlines = [
        (name, _outline(region.box, pose))
        for each, name, pose in zip(found, names, poses, strict=True)
        if each is not None and each.verdict == "tampered" and pose is not None
        for region in each.regions
    ]
    if len(way) < 2 and not outlines:
        return ""
    everything = np.concatenate([np.array(way), *(corners for _, corners in outlines)])
    low, high = everything.min(axis=0) - 5.0, everything.max(axis=0) + 5.0
    scale = WIDTH / float(max(high[0] - low[0], 1.0))
    height = scale * float(high[1] - low[1])
    if height > HIGHEST:
        scale, height = scale * HIGHEST / height, HIGHEST
    low[0] -= 0.5 * (WIDTH / scale - (high[0] - low[0]))  # centres the map

    def at(points: NDArray[np.float64]) -> str:
        return " ".join(
            f"{scale * (x - low[0]):.1f},{height - scale * (y - low[1]):.1f}"
            for x, y in points.tolist()
        )

    boxes = "".join(
        f'<polygon points="{at(corners)}" fill="#b0002033" stroke="#b00020">'
        f"<title>{html.escape(name)}</title></polygon>"
        for name, corners in outlines
    )
    path = f'<polyline points="{at(np.array(way))}" fill="none" stroke="#0072B2" stroke-width="2"/>'
    start = at(np.array(way[:1])).split(",")
    drawing = (
        f'<svg viewBox="0 0 {WIDTH:g} {height:.1f}" width="{WIDTH:g}" role="img" '
        f'aria-label="Way of the scanner and suspected places from above">{path}'
        f'<circle cx="{start[0]}" cy="{start[1]}" r="5" fill="#0072B2"/>{boxes}</svg>'
    )
    return (
        f"<h2>Map</h2>{wide('Map', drawing)}"
        f"<p>The way of the scanner as detector IV aligned the scans, from the dot on; "
        f"{WIDTH / scale:.0f} m from left to right. Boxes: suspected places.</p>"
    )


def _outline(box: Box, pose: Pose) -> NDArray[np.float64]:
    """Return the corners (4, 2) of a box from above, in the drive's coordinates."""
    places = np.column_stack([box_outline(box, 0.3), np.ones(4)])
    outline: NDArray[np.float64] = product(places, pose.T)[:, :2]
    return outline


def _table(found: Sequence[Inspection | None], names: Sequence[str]) -> str:
    """Return a table of the scans whose verdict is not ``no_trace``, tampered ones first."""
    said = [
        (each, name)
        for each, name in zip(found, names, strict=True)
        if each is not None and each.verdict != "no_trace"
    ]
    said.sort(key=lambda row: row[0].verdict != "tampered")  # stable: others keep their order
    rows = [
        f"<tr><td>{html.escape(name)}</td><td class={each.verdict}>{each.verdict}</td>"
        f"<td>{html.escape(each.reason)}</td>"
        f"<td>{p_text(each.p_value)}</td><td>{p_text(each.model_p_value)}</td>"
        f"<td>{len(each.regions)}</td></tr>"
        for each, name in said
    ]
    if not rows:
        return ""
    header = (
        "<tr><th>scan<th>verdict<th>why<th>p at most<th>p by the detectors' models<th>regions</tr>"
    )
    more = "" if len(rows) <= MAX_ROWS else f"<p>and {len(rows) - MAX_ROWS} more</p>"
    title = "Scans of which something is said"
    table = wide(title, f"<table>{header}{''.join(rows[:MAX_ROWS])}</table>")
    return f"<h2>{title}</h2>{table}{more}"
