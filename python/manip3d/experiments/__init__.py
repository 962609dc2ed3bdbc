"""Experiments that reproduce published tables and figures: one module for each, run by `run`.

Other packages add experiments through entry points of the group ``manip3d.experiments``.
"""

from __future__ import annotations

from manip3d.experiments._model import (
    Case,
    Claim,
    Column,
    DataTier,
    Experiment,
    Finding,
    Plan,
    Row,
    Verdict,
    counted,
)
from manip3d.experiments._published import published_rows
from manip3d.experiments._registry import ENTRY_POINTS, registry, select
from manip3d.experiments._runner import RESULTS_FORMAT, RunSummary, run
from manip3d.experiments._store import Store, pack_mesh, unpack_mesh

__all__ = [
    "ENTRY_POINTS",
    "RESULTS_FORMAT",
    "Case",
    "Claim",
    "Column",
    "DataTier",
    "Experiment",
    "Finding",
    "Plan",
    "Row",
    "RunSummary",
    "Store",
    "Verdict",
    "counted",
    "pack_mesh",
    "published_rows",
    "registry",
    "run",
    "select",
    "unpack_mesh",
]
