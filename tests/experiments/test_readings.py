"""The study over readings of chapter 3, on the simulated scan."""

from __future__ import annotations

from manip3d.experiments import readings_3
from manip3d.experiments._model import Plan


def test_quick_simulated_run() -> None:
    cases = readings_3.EXPERIMENT.cases(Plan("simulated", "quick"))
    assert len(cases) == 1 + 3 + 2 + 2 + 1  # the kept reading, then one choice changed
    rows = [readings_3.EXPERIMENT.complete(readings_3.measure(case)) for case in cases]
    kept = next(row for row in rows if readings_3._reading(row) == readings_3.KEPT)
    assert 0 < kept["metro_area"] < 0.01
    assert len({row["metro_area"] for row in rows}) > 6  # it does depend on the reading
    assert readings_3.EXPERIMENT.claims[0].verdict(rows).holds is None  # nobody printed this scan


def test_the_kept_reading_is_the_default() -> None:
    from manip3d import _core

    reading = _core.Cs3Reading()
    kept = (reading.stencil, reading.beside_invalid, reading.rounding)
    assert tuple(choice.name.lower() for choice in kept) == readings_3.KEPT[:3]
    assert reading.outliers == readings_3.KEPT[3]


def test_the_claim_needs_the_kept_reading_to_be_near() -> None:
    names = ("stencil", "beside_invalid", "rounding", "outliers")
    about = readings_3._about("bun000")
    row = {"model": "bun000", **about, **dict(zip(names, readings_3.KEPT, strict=True))}
    claim = readings_3.EXPERIMENT.claims[0]
    for metro, holds in ((0.70e-3, True), (0.73e-3, False)):
        rows = [readings_3.EXPERIMENT.complete({**row, "metro_area": metro})]
        assert claim.verdict(rows).holds is holds
