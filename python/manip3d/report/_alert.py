"""The alerts of a drive as a self-contained HTML page, or as JSON."""

from __future__ import annotations

import base64
import heapq
import html
import json
import math
import os
import sys
import tempfile
import weakref
from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import __version__
from manip3d._util.checked import checked
from manip3d._util.html import html_page, wide
from manip3d._util.texts import counted
from manip3d.lidar import box_outline
from manip3d.report._evidence_files import write_page_or_record
from manip3d.simulate._surfaces import png

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from manip3d.authenticate import (
        Alert,
        AlertCounts,
        CrossModalResult,
        RiskParameters,
        SurroundResult,
    )
    from manip3d.lidar import Box, LidarFrame

_MAX_SCENES = 12  # largest number of frames with pictures
_MAX_ROWS = 200  # largest number of rows in the table of frames
_DOTS = 2500  # largest number of points in a view from above
_REACH = 45.0  # metres ahead of the car in the view from above
_SIDE = 22.0  # metres to each side of the car

_ROWS = ("verdict", "watermark", "cross-modal", "forensics")
QUIET = ("authentic", "no_trace")


@dataclass(frozen=True)
class _Scene:
    """Pictures of one frame, as HTML."""

    gravity: int
    number: int
    title: str
    maps: str
    above: str


def frame_and_scan(record: Mapping[str, Any]) -> str:
    """Return the number of a frame and the name of its scan, if it has one."""
    scan = record.get("scan")
    return f"{record['frame']} (scan {scan})" if scan else str(record["frame"])


_TAMPERED = 2  # gravity of a tampered frame


def _gravity(record: Mapping[str, Any]) -> int:
    return {"tampered": _TAMPERED, "undecidable": 1, "skipped": 1}.get(record["verdict"], 0)


class _Records:
    """The records of a drive in a temporary file of JSON lines, since an hour would fill memory."""

    def __init__(self) -> None:
        # Unbuffered: if the disk is full, buffered data would fail again at each following seek.
        self._lines = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._lines.close)
        self._ends = array("q", [0])  # offsets of the lines' ends; data after the last is invalid

    def append(self, record: Mapping[str, Any]) -> None:
        line = json.dumps(record).encode() + b"\n"
        self._lines.seek(self._ends[-1])
        written = 0
        while written < len(line):
            written += self._lines.write(line[written:])
        self._ends.append(self._ends[-1] + len(line))

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for number in range(len(self)):
            begin, end = self._ends[number : number + 2]
            self._lines.seek(begin)
            yield json.loads(self._lines.read(end - begin))

    def __len__(self) -> int:
        return len(self._ends) - 1


class AlertTimeline:
    """Verdicts of a monitor on the frames of a drive, which can be written as a page or as JSON.

    The numbers of all frames are kept in a temporary file. Pictures are kept of a few frames only:
    the gravest of the frames that are tampered or at which the verdict changes.

    Parameters
    ----------
    source : str
        Name of the drive, for the title.
    risk : RiskParameters, optional
        Parameters of the monitor; the page shows their levels.
    """

    @checked
    def __init__(self, source: str, *, risk: RiskParameters | None = None) -> None:
        from manip3d.authenticate import RiskParameters

        self.source = source
        levels = RiskParameters() if risk is None else risk
        self._levels = (levels.low, levels.high)
        self._records = _Records()
        self._num_loud = 0
        self._scenes: list[_Scene] = []
        self._last = ""

    def __repr__(self) -> str:
        frames = counted(len(self._records), "frame")
        return f"<manip3d.report.AlertTimeline: {self.source}, {frames}>"

    @checked
    def add(self, alert: Alert) -> None:
        """Add the next frame.

        Parameters
        ----------
        alert : manip3d.authenticate.Alert
            The monitor's result for this frame.
        """
        record = alert.record()
        self._records.append(record)
        self._num_loud += alert.verdict not in QUIET
        is_new = alert.verdict != self._last
        self._last = alert.verdict
        if _scan_of(alert) is None or not (is_new or alert.verdict == "tampered"):
            return
        # The first frame of an attack is graver by 1, so that its pictures are kept.
        gravity = _gravity(record) + (is_new and alert.verdict == "tampered")
        if len(self._scenes) == _MAX_SCENES:
            least = min(self._scenes, key=lambda scene: (scene.gravity, -scene.number))
            if least.gravity >= gravity:
                return
            self._scenes.remove(least)
        maps = "" if alert.cross_modal is None else _all_maps(alert.cross_modal)
        title = f"Frame {frame_and_scan(record)}: {alert.reason}"
        self._scenes.append(_Scene(gravity, alert.number, title, maps, _from_above(alert)))

    @property
    def records(self) -> list[dict[str, Any]]:
        """Records of all alerts so far, as values that can be written as JSON."""
        return list(self._records)

    def gravest(self, count: int) -> tuple[list[dict[str, Any]], int]:
        """Return the gravest records that are not quiet, and the number of all such records.

        Tampered frames come first, then undecidable and skipped ones, each in their order.

        Parameters
        ----------
        count : int
            Largest number of records to return.
        """
        loud = (record for record in self._records if record["verdict"] not in QUIET)
        first = heapq.nsmallest(count, loud, key=lambda each: (-_gravity(each), each["frame"]))
        return first, self._num_loud

    @checked
    def write(
        self,
        output: str | os.PathLike[str],
        *,
        verdict: str,
        reason: str,
        counts: AlertCounts,
    ) -> None:
        """Write the timeline as one file.

        Parameters
        ----------
        output : path
            ``.html``: a self-contained page; ``.json``: the numbers. An existing file is replaced.
        verdict, reason : str
            Verdict on the whole drive and its reason, see `manip3d.authenticate.verdict_of_alerts`.
        counts : AlertCounts
            Numbers of frames by verdict, and times.

        Raises
        ------
        InputError
            The suffix is neither of the two.
        """
        write_page_or_record(
            output,
            page=lambda: self._page(verdict, reason, counts),
            record=lambda: self.summary(verdict, reason, counts),
        )

    def summary(self, verdict: str, reason: str, counts: AlertCounts) -> dict[str, Any]:
        """Return everything except the pictures, as values that can be written as JSON.

        Parameters
        ----------
        verdict, reason : str
            Verdict on the whole drive and its reason.
        counts : AlertCounts
            Numbers of frames by verdict.
        """
        return {
            "source": self.source,
            "verdict": verdict,
            "reason": reason,
            "counts": counts.record(),
            "risk_levels": {"low": self._levels[0], "high": self._levels[1]},
            "frames": self.records,
        }

    def _page(self, verdict: str, reason: str, counts: AlertCounts) -> str:
        scenes = "".join(
            f"<h3>{html.escape(scene.title)}</h3><div class=scene>{scene.maps}{scene.above}</div>"
            for scene in sorted(self._scenes, key=lambda scene: scene.number)
        )
        strip = strip_of(self._records, _ROWS)
        content = (
            f"<h1 class={verdict}>{verdict}</h1><p>{html.escape(reason)}</p>"
            + _facts(self.source, counts)
            + "<h2>Timeline</h2>"
            + _timeline(strip, self._levels)
            + (f"<h2>What was seen</h2>{_legend(self._scenes)}{scenes}" if scenes else "")
            + _table(*self.gravest(_MAX_ROWS))
            + "<p class=fine>A watermark protects a scan from where it is embedded to where it is "
            "verified. Cameras judge only what both they and the LiDAR see; where they contradict "
            f"each other, either may be wrong. manip3d {html.escape(__version__)}</p>"
        )
        return html_page(f"{self.source}: {verdict}", STYLE, content)


STYLE = (
    ":root{color-scheme:light}"
    "body{font:16px/1.5 system-ui,sans-serif;max-width:64rem;margin:2rem auto;padding:0 1rem;"
    "background:#fff;color:#1c1e21;overflow-wrap:break-word}"
    ".wide{overflow-x:auto}table{border-collapse:collapse;font-size:.9rem}"
    "td,th{padding:.2rem .8rem;text-align:left;border-bottom:1px solid #ccc;vertical-align:top}"
    "svg{display:block;max-width:100%}figure{margin:0}figcaption,.fine{font-size:.84rem;"
    "color:#5d636b}.scene{display:grid;gap:1rem;grid-template-columns:2fr 1fr;align-items:start}"
    "img{width:100%;image-rendering:pixelated;display:block;border:1px solid #ccc;"
    "margin-bottom:.15rem}ul.legend{list-style:none;padding:0;display:flex;flex-wrap:wrap;"
    "gap:.2rem 1.2rem;font-size:.9rem}.legend b{display:inline-block;width:.8em;height:.8em;"
    "margin-right:.4em}.time{display:grid;grid-template-columns:auto 1fr;gap:2px .6rem;"
    "font-size:.84rem;align-items:center}.time svg{width:100%}"
    "@media(max-width:40rem){body{margin:1rem auto}td,th{padding:.2rem .4rem}"
    ".scene{grid-template-columns:1fr}}"
    ".tampered{color:#b00020}.no_trace,.authentic{color:#1b5e20}.undecidable{color:#7a5c00}"
)

_COLORS = {
    "authentic": "#1b7042",
    "no_trace": "#9ccc9c",
    "tampered": "#c62828",
    "undecidable": "#e0a800",
    "processed": "#8d6e63",
    "skipped": "#9aa0a6",
    "absent": "#eceff1",
}
_MEANING = {
    "authentic": "authentic, by the watermark",
    "no_trace": "no contradiction",
    "tampered": "tampered",
    "undecidable": "undecidable",
    "processed": "processed after the scanner",
    "skipped": "skipped: no time, or not due",
    "absent": "not checked: no key or no pictures",
}
_MAP_LEGEND = (
    "<li><b style='background:#c62828'></b>added: only the LiDAR sees it"
    "<li><b style='background:#1565c0'></b>missing: only the cameras see it"
    "<li><b style='background:#b7e1b7'></b>judged, no contradiction"
)
_SECTOR_LEGEND = "<li><b style='background:#f0b8b8'></b>sectors that the watermark finds tampered"


def _legend(scenes: Sequence[_Scene]) -> str:
    """Return the legend of the colours that occur in the pictures."""
    items = _MAP_LEGEND if any(scene.maps for scene in scenes) else ""
    items += _SECTOR_LEGEND if any(_SECTOR in scene.above for scene in scenes) else ""
    return f"<ul class=legend>{items}</ul>" if items else ""


def _facts(source: str, counts: AlertCounts) -> str:
    verdicts = ", ".join(f"{count} {name}" for name, count in sorted(counts.verdicts.items()))
    skipped = ", ".join(f"{name} {count}" for name, count in counts.skipped.items()) or "none"
    facts = (
        f"{source}: {counted(counts.frames, 'frame')} ({verdicts})",
        f"time for a verdict: mean {1e3 * counts.mean_s:.0f} ms, slowest "
        f"{1e3 * counts.slowest_s:.0f} ms, {counts.late} later than the budget",
        f"frames in which a check was skipped: {skipped}",
    )
    return "<ul>" + "".join(f"<li>{html.escape(fact)}</li>" for fact in facts) + "</ul>"


@dataclass(frozen=True)
class Strip:
    """Verdicts and risk scores of all frames for the timeline; ``verdicts`` by row name."""

    verdicts: Mapping[str, Sequence[str]]
    scores: Sequence[float]


def strip_of(records: Iterable[Mapping[str, Any]], names: Sequence[str] = _ROWS[:1]) -> Strip:
    """Return the rows of the timeline with these names."""
    verdicts: dict[str, list[str]] = {name: [] for name in names}
    scores = array("d")
    for record in records:
        for name in names:
            verdicts[name].append(sys.intern(_verdict(record, name)))
        scores.append(float(record["risk"]["score"]))
    return Strip(verdicts, scores)


def _timeline(strip: Strip, levels: tuple[float, float]) -> str:
    """Return a row of cells for each witness, the risk below, and the legend of the colours."""
    used = {verdict for row in strip.verdicts.values() for verdict in row}
    legend = "".join(
        f"<li><b style='background:{_COLORS[name]}'></b>{meaning}"
        for name, meaning in _MEANING.items()
        if name in used
    )
    return timeline_html(strip, levels) + f"<ul class=legend>{legend}</ul>"


def timeline_html(strip: Strip, levels: tuple[float, float]) -> str:
    """Return a row of cells for each name, and the risk below with its levels medium and high."""
    count = max(len(strip.scores), 1)
    parts = ["<div class=time>"]
    for name, verdicts in strip.verdicts.items():
        cells = "".join(_cells(verdicts))
        parts.append(
            f"<span>{name}</span><svg viewBox='0 0 {count} 1' height=22 "
            f"preserveAspectRatio=none role=img aria-label='{name}'>{cells}</svg>"
        )
    lines = "".join(
        f"<path d='M0 {1 - level}H{count}' stroke='#9aa0a6' stroke-dasharray='4' fill=none "
        "vector-effect=non-scaling-stroke></path>"
        for level in levels
    )
    frames = f"frame 0 to {len(strip.scores) - 1}" if strip.scores else "no frames"
    parts.append(
        f"<span>risk<br>0 to 1</span><svg viewBox='0 0 {count} 1' height=80 "
        "preserveAspectRatio=none role=img aria-label='risk score'>"
        f"<path d='M0 1{_steps(strip.scores)}L{count} 1Z' fill='#c6282855'></path>{lines}</svg>"
        f"<span></span><span>{frames}; lines at {levels[0]:g} (medium) "
        f"and {levels[1]:g} (high)</span></div>"
    )
    return "".join(parts)


def _steps(scores: Sequence[float]) -> str:
    """Return the SVG path of the risk, with one step for each run of frames of equal score."""
    parts = []
    for end in range(1, len(scores) + 1):
        shown = f"{1 - scores[end - 1]:.4f}"
        if end < len(scores) and f"{1 - scores[end]:.4f}" == shown:
            continue
        parts.append(f"V{shown}H{end}")
    return "".join(parts)


def _verdict(record: Mapping[str, Any], row: str) -> str:
    told = record["verdict"] if row == "verdict" else record["witnesses"][row]["verdict"]
    return str(told)


def _cells(verdicts: Sequence[str]) -> list[str]:
    """Return a rectangle for each run of frames with the same verdict."""
    cells = []
    begin = 0
    for end in range(1, len(verdicts) + 1):
        if end < len(verdicts) and verdicts[end] == verdicts[begin]:
            continue
        name = verdicts[begin]
        frames = f"frame {begin}" if end - begin == 1 else f"frames {begin} to {end - 1}"
        cells.append(
            f"<rect x={begin} y=0 width={end - begin} height=1 fill='{_COLORS[name]}'>"
            f"<title>{frames}: {name}</title></rect>"
        )
        begin = end
    return cells


def _table(shown: Sequence[dict[str, Any]], count: int) -> str:
    """Return the table of the gravest frames; ``count`` is the number of all that are not quiet."""
    if not shown:
        return "<h2>Frames</h2><p>Every frame is quiet.</p>"
    rows = "".join(
        f"<tr><td>{record['frame']}</td><td>{html.escape(record['scan'])}</td>"
        f"<td class={record['verdict']}>{record['verdict']}</td>"
        f"<td>{html.escape(record['attack'])}</td>"
        f"<td>{html.escape(record['risk']['level'])} ({record['risk']['score']:.2f})</td>"
        f"<td>{html.escape(record['risk']['action'])}</td>"
        f"<td>{html.escape(record['reason'])}</td></tr>"
        for record in shown
    )
    more = f"<p>and {count - len(shown)} more</p>" if count > len(shown) else ""
    header = "<tr><th>frame<th>scan<th>verdict<th>attack<th>risk<th>recommended<th>why</tr>"
    title = "Frames to look at"
    return f"<h2>{title}</h2>{wide(title, f'<table>{header}{rows}</table>')}{more}"


# --- pictures -------------------------------------------------------------------------------------


def _all_maps(result: CrossModalResult | SurroundResult) -> str:
    """Return the maps of all accusing camera pairs, or of the first pair if none accuses."""
    pairs = getattr(result, "pairs", {"": result})
    accusing = {name: found for name, found in pairs.items() if found.verdict == "tampered"}
    shown = accusing or dict([next(iter(pairs.items()))])
    return "".join(_maps(found, name) for name, found in shown.items())


def _maps(result: CrossModalResult, name: str) -> str:
    """Return range maps of LiDAR and cameras, and the map of their contradictions."""
    of_pair = f"{name}: " if name else ""
    rows = np.flatnonzero(result.judged.any(axis=1))
    window = slice(rows[0], rows[-1] + 1) if len(rows) else slice(None)
    pictures = (
        (f"{of_pair}LiDAR, range", _in_colors(result.lidar[window], result.parameters.max_range)),
        (
            f"{of_pair}cameras, range",
            _in_colors(result.stereo[window], result.parameters.max_range),
        ),
        (f"{of_pair}contradictions", _marked(result.mask[window], result.judged[window])),
    )
    return (
        "<div>"
        + "".join(
            f"<figure><img alt='{html.escape(caption)}' src='data:image/png;base64,{_png(pixels)}'>"
            f"<figcaption>{html.escape(caption)}</figcaption></figure>"
            for caption, pixels in pictures
        )
        + "</div>"
    )


def _in_colors(ranges: NDArray[np.float32], most: float) -> NDArray[np.uint8]:
    """Return ranges in colours: near is dark, far is pale, white is no measurement."""
    share = np.clip(np.sqrt(ranges / most), 0.0, 1.0)[..., None]
    near, far = np.array([38.0, 24.0, 74.0]), np.array([236.0, 226.0, 150.0])
    colors = near + share * (far - near)
    colors[ranges <= 0.0] = 255.0
    return np.asarray(colors.round(), np.uint8)


def _marked(mask: NDArray[np.int8], judged: NDArray[np.bool_]) -> NDArray[np.uint8]:
    colors = np.full((*mask.shape, 3), 255, np.uint8)
    colors[judged] = (183, 225, 183)
    colors[mask > 0] = (198, 40, 40)
    colors[mask < 0] = (21, 101, 192)
    return colors


def _png(pixels: NDArray[np.uint8]) -> str:
    return base64.b64encode(png(pixels)).decode()


def _scan_of(alert: Alert) -> LidarFrame | None:
    """Return the scan from any of the witnesses' results, or None."""
    witnesses = (alert.cross_modal, alert.watermark, alert.forensics)
    return next(
        (each.scan for each in witnesses if each is not None and each.scan is not None), None
    )


def _from_above(alert: Alert) -> str:
    """Return a view from above with points, tampered sectors and boxes; the car drives upwards.

    With a single camera pair it shows only the area ahead of the car.
    """
    dots = ""
    ahead_only = alert.cross_modal is not None and not hasattr(alert.cross_modal, "pairs")
    behind = 0.0 if ahead_only else _REACH
    scan = _scan_of(alert)
    if scan is not None:
        points = scan.points
        x, y, z = points[:, 0], points[:, 1], points[:, 2]
        ahead = (x >= -behind) & (x < _REACH) & (abs(y) < _SIDE) & (z > -1.4) & (z < 2.5)
        some = points[ahead][:: max(1, -(-int(ahead.sum()) // _DOTS))]
        dots = "".join(f"M{-y:.1f} {-x:.1f}h.01" for x, y, _ in some.tolist())
    shapes = "".join(
        f"<polygon points='{_outline(box)}' fill=none stroke="
        f"'{'#1565c0' if box.label == 'missing' else '#c62828'}' stroke-width=.35></polygon>"
        for box in alert.boxes
    )
    return (
        f"<figure><svg viewBox='{-_SIDE} {-_REACH} {2 * _SIDE} {_REACH + max(behind, 3)}' "
        "role=img "
        "aria-label='view from above'>"
        f"{_sectors(alert)}"
        f"<path d='{dots}' stroke='#78909c' stroke-width=.22 stroke-linecap=round fill=none>"
        "</path><path d='M-.9 2L0 -2L.9 2Z' fill='#263238'></path>"
        f"{shapes}</svg><figcaption>from above, {_REACH:.0f} m ahead{' and behind' * (behind > 0)}"
        "</figcaption></figure>"
    )


_SECTOR = "class=sector"


def _sectors(alert: Alert) -> str:
    """Return wedges for the tiles that the watermark finds tampered, up to the picture's edge."""
    found = alert.watermark
    if found is None:
        return ""
    reach = 2.0 * _REACH
    wedges = []
    for number in found.changed_tiles:
        for begin, end in found.tiles[number].azimuths_deg:
            steps = np.radians(np.linspace(begin, end, 2 + int((end - begin) // 10)))
            edge = "".join(
                f"L{-reach * math.sin(angle):.1f} {-reach * math.cos(angle):.1f}"
                for angle in steps.tolist()
            )
            wedges.append(f"<path {_SECTOR} d='M0 0{edge}Z' fill='#c62828' opacity=.3></path>")
    return "".join(wedges)


def _outline(box: Box) -> str:
    return " ".join(f"{-y:.2f},{-x:.2f}" for x, y, _ in box_outline(box, 0.4).tolist())
