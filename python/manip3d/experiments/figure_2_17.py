"""Figure 2.17: FMPD against the number of faces, Dragon and Jet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from manip3d.experiments import _fmpd, _progressive
from manip3d.experiments._model import Claim, Experiment, Finding, Row, counted
from manip3d.experiments._simplification import DATA_NOTE, MEASURE_NOTE, METHOD_TITLES, complete


def _not_monotone(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, by_method in _progressive.curves(rows):
        falls = {
            method: sum(b["fmpd"] < a["fmpd"] for a, b in pairwise(curve))
            for method, curve in by_method.items()
        }
        numbers = ", ".join(
            f"{METHOD_TITLES[method]} falls at {counted(count, 'level')}"
            for method, count in falls.items()
        )
        yield Finding(model, any(falls.values()), numbers)


EXPERIMENT = Experiment(
    id="figure-2.17",
    title="FMPD with respect to the number of faces",
    published="",
    data=("lifeboat", "flash2a", "BAe-125", "Cessna337"),
    cases=_progressive.cases,
    columns=_fmpd.COLUMNS,
    claims=(
        Claim(
            "FMPD does not grow steadily as faces are removed, with some method on each model",
            "section 2.5.4",
            _not_monotone,
        ),
        _fmpd.BLIND_TO_GAPS,
    ),
    complete=complete,
    figures=lambda rows: _progressive.plots(rows, "fmpd", "FMPD, not clipped", 1.0),
    notes=(DATA_NOTE, MEASURE_NOTE, _fmpd.note),
)
