"""Common parts of tables 2.6 and 2.7: FMPD, whose ranks are compared instead of its values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from manip3d.experiments._model import Claim, Column, Finding, Row, by_model
from manip3d.experiments._simplification import (
    METHOD_TITLES,
    SHARED_COLUMNS,
    listing,
    ran,
)

COLUMNS = (
    *SHARED_COLUMNS,
    Column("fmpd", "FMPD", 1.0, 3, "published_fmpd", ratio=False),
    Column("boundary_gap", "boundary gap", 1e3, 3),
    Column("cracks", "cracks"),
)


def note(rows: Sequence[Row]) -> str:
    """Return the note why values are not compared, with those of a published file if measured."""
    measured = (
        f"{row['model']} by {METHOD_TITLES[row['method']]} gives {row['fmpd']:.3f} for the printed "
        f"{row['published_fmpd']:.3f}"
        for row in rows
        if row["data"] == "published" and isinstance(row.get("published_fmpd"), float)
        if row.get("fmpd") is not None and row["method"] == "qem4vr"
    )
    example = next(measured, "")
    return (
        "The published FMPD values cannot be met with the measure's definition"
        f"{f' ({example})' if example else ''}: ranks among the methods are compared, values are "
        "not."
    )


def _same_order(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, group in by_model(rows):
        present = {m: r for m, r in ran(group).items() if isinstance(r["published_fmpd"], float)}
        if len(present) < 2:
            continue
        pairs = [(a, b) for a in present for b in present if _below(present, a, b)]
        kept = sum(present[a]["fmpd"] < present[b]["fmpd"] for a, b in pairs)
        numbers = (
            f"{kept} of {len(pairs)} published orderings of two methods kept: "
            f"{listing(present, 'fmpd')}; published {listing(present, 'published_fmpd')}"
        )
        yield Finding(model, kept == len(pairs) if pairs else None, numbers)


def _below(group: dict[str, Row], first: str, second: str) -> bool:
    low, high = (float(group[method]["published_fmpd"]) for method in (first, second))
    return low < high


def _blind_to_gaps(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, group in by_model(rows):
        present = ran(group)
        if not {"qem-orig", "qem4vr"} <= set(present):
            continue
        orig, mine = present["qem-orig"], present["qem4vr"]
        if not orig["boundary_edges"]:
            yield Finding(model, None, "the model has no boundary")
            continue
        if orig["boundary_gap"] is None or mine["boundary_gap"] is None:
            yield Finding(model, None, "a result has no boundary left to measure")
            continue
        holds = orig["fmpd"] < mine["fmpd"] and orig["boundary_gap"] > mine["boundary_gap"]
        pair = {"qem-orig": orig, "qem4vr": mine}
        numbers = f"FMPD {listing(pair, 'fmpd')}; gap, 1e-3: {listing(pair, 'boundary_gap', 1e3)}"
        yield Finding(model, holds, numbers)


SAME_ORDER = Claim(
    "FMPD puts the methods in the published order",
    "tables 2.6 and 2.7",
    _same_order,
    data=("published",),
)
BLIND_TO_GAPS = Claim(
    "FMPD prefers QEM-Orig to QEM4VR although QEM-Orig leaves wider gaps at boundaries",
    "section 2.5.4",
    _blind_to_gaps,
)
