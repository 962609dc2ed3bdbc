"""A page with the verdicts of ``alert run`` on the drives of several vehicles."""

from __future__ import annotations

import html
import os
import posixpath
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any
from urllib.parse import quote

from manip3d import __version__
from manip3d._util.checked import checked
from manip3d._util.html import html_page
from manip3d._util.paths import path_of
from manip3d._util.texts import counted
from manip3d.authenticate import RiskParameters
from manip3d.errors import InputError
from manip3d.io._files import atomic_write
from manip3d.report._alert import QUIET, STYLE, frame_and_scan, strip_of, timeline_html
from manip3d.report._evidence_files import page_bytes

_GRAVEST_FIRST = ("failed", "tampered", "undecidable", "no_trace", "authentic")


@checked
def write_alert_overview(
    drives: Sequence[Mapping[str, Any]], output: str | os.PathLike[str]
) -> None:
    """Write an HTML page with the verdicts on the drives of several vehicles.

    Drives are ordered by verdict, the gravest first: failed, tampered, undecidable, no trace,
    authentic. Each has its reason, its verdicts and its risk over time, and its worst frame. It is
    named by the last part of its path, and if another drive has the same name, by the path below
    the folder that they have in common.

    Parameters
    ----------
    drives : sequence of mappings
        For each vehicle the result of `AlertTimeline.summary`, optionally with ``page``, the
        address of the vehicle's own page relative to this one. For a drive that failed, ``source``
        (its path) and ``error`` (a message).
    output : path
        Output file that ends in ``.html``; an existing file is replaced.

    Raises
    ------
    InputError
        ``drives`` is empty, a drive has another verdict or lacks a field, or ``output`` has another
        suffix.
    OSError
        The page cannot be written; an existing file stays unchanged.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d.report import write_alert_overview
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     page = Path(folder) / "overview.html"
    ...     write_alert_overview([{"source": "car 1", "error": "no such drive"}], page)
    ...     print("car 1" in page.read_text())
    True
    """
    path = path_of(output, "output")
    if path.suffix.lower() != ".html":
        raise InputError(f"output: expected a name that ends in .html, got {path.name}")
    if len(drives) == 0:
        raise InputError("drives: expected at least one, got none")
    for number, drive in enumerate(drives):
        _check_drive(f"drives[{number}]", drive)
    ranked = sorted(drives, key=lambda drive: _GRAVEST_FIRST.index(_verdict_of(drive)))
    counts = {name: sum(_verdict_of(drive) == name for drive in drives) for name in _GRAVEST_FIRST}
    told = ", ".join(f"{count} {_word(name)}" for name, count in counts.items() if count)
    names = _names_of([str(drive["source"]) for drive in drives])
    title = counted(len(drives), "vehicle")
    content = (
        f"<h1>{title}</h1><p>{told}</p>"
        + "".join(_vehicle(drive, names[str(drive["source"])]) for drive in ranked)
        + f"<p class=fine>The gravest first. manip3d {html.escape(__version__)}</p>"
    )
    atomic_write(path, page_bytes(html_page(f"{title}: {told}", STYLE, content)))


def _check_drive(name: str, drive: Mapping[str, Any]) -> None:
    verdict = _verdict_of(drive)
    if verdict not in _GRAVEST_FIRST:
        known = ", ".join(_GRAVEST_FIRST)
        raise InputError(f"{name}: expected one of the verdicts {known}, got {verdict!r}")
    for field in ("source",) if verdict == "failed" else ("source", "reason", "frames"):
        if field not in drive:
            raise InputError(f"{name}: expected the field {field!r}, got {', '.join(drive)}")


def _verdict_of(drive: Mapping[str, Any]) -> str:
    return "failed" if drive.get("error") else str(drive.get("verdict") or "failed")


def _word(verdict: str) -> str:
    return verdict.replace("_", " ")


def _vehicle(drive: Mapping[str, Any], name: str) -> str:
    """Return the section of a drive: name, verdict, reason, timeline with risk, worst frame."""
    name = html.escape(name)
    if drive.get("page"):
        name = f"<a href='{quote(os.fsencode(drive['page']))}'>{name}</a>"
    verdict = _verdict_of(drive)
    shown = f"<h2>{name}: <span class={verdict}>{_word(verdict)}</span></h2>"
    if verdict == "failed":
        return f"<section>{shown}<p>{html.escape(str(drive.get('error', '')))}</p></section>"
    frames, region = drive["frames"], RiskParameters()
    given = drive.get("risk_levels", {"low": region.low, "high": region.high})
    levels = (float(given["low"]), float(given["high"]))
    loud = [frame for frame in frames if frame["verdict"] not in QUIET]
    worst = max(loud, key=lambda frame: frame["risk"]["score"], default=None)
    facts = [f"{counted(len(frames), 'frame')}, {len(loud)} of them to look at"]
    if worst is not None:
        attack = f", {worst['attack']}" if worst["attack"] else ""
        facts.append(
            f"worst: frame {frame_and_scan(worst)}{attack}, risk {worst['risk']['level']} "
            f"({worst['risk']['score']:.2f}); recommended: {worst['risk']['action']}"
        )
    lines = "".join(f"<li>{html.escape(fact)}" for fact in facts)
    return (
        f"<section>{shown}<p>{html.escape(str(drive['reason']))}</p>"
        f"{timeline_html(strip_of(frames), levels)}<ul>{lines}</ul></section>"
    )


def _names_of(sources: Sequence[str]) -> dict[str, str]:
    """Return the name of each source: as much of the end of its path as tells it from the others.

    Addresses are returned unchanged.
    """
    alike: dict[str, set[str]] = {}
    for source in sources:
        alike.setdefault(_last_part(source), set()).add(source)
    names: dict[str, str] = {}
    for name, group in alike.items():
        names |= {source: name for source in group} if len(group) == 1 else _below_common(group)
    return names


def _last_part(source: str) -> str:
    return source if ":" in source else PurePosixPath(source).name or source


def _below_common(sources: set[str]) -> dict[str, str]:
    """Return paths relative to the folder that they have in common, and unchanged if none is."""
    paths = {source: PurePosixPath(source) for source in sources}
    try:
        common = posixpath.commonpath([path.parent for path in paths.values()])
    except ValueError:  # some are absolute, others relative
        return {source: source for source in sources}
    return {source: str(path.relative_to(common)) for source, path in paths.items()}
