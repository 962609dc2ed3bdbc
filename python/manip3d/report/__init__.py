"""Reports: results of experiments beside published values, evidence of scans, drives, streams."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from manip3d.report._alert import AlertTimeline
    from manip3d.report._alert_overview import write_alert_overview
    from manip3d.report._case_log import append_log, read_log
    from manip3d.report._drive_evidence import write_drive_evidence
    from manip3d.report._evidence import write_evidence
    from manip3d.report._evidence_files import EVIDENCE_KINDS
    from manip3d.report._results import write_report
    from manip3d.report._stream_evidence import write_stream_evidence
    from manip3d.report._suspected import place_sentence, write_suspected_rows

__all__ = [
    "EVIDENCE_KINDS",
    "AlertTimeline",
    "append_log",
    "place_sentence",
    "read_log",
    "write_alert_overview",
    "write_drive_evidence",
    "write_evidence",
    "write_report",
    "write_stream_evidence",
    "write_suspected_rows",
]

_HOMES = {
    "AlertTimeline": "_alert",
    "EVIDENCE_KINDS": "_evidence_files",
    "append_log": "_case_log",
    "place_sentence": "_suspected",
    "read_log": "_case_log",
    "write_alert_overview": "_alert_overview",
    "write_drive_evidence": "_drive_evidence",
    "write_evidence": "_evidence",
    "write_report": "_results",
    "write_stream_evidence": "_stream_evidence",
    "write_suspected_rows": "_suspected",
}
"""Module of each name, imported on first use, so that a verdict on the terminal loads neither
viewer nor simulator."""


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'manip3d.report' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"manip3d.report.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
