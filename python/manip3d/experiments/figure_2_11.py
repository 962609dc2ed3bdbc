"""Figure 2.11: Metro against the number of faces, Dragon and Jet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from manip3d.experiments import _progressive
from manip3d.experiments._model import Claim, Experiment, Finding, Row, counted
from manip3d.experiments._simplification import (
    DATA_NOTE,
    MEASURE_NOTE,
    METHOD_TITLES,
    METRO_COLUMNS,
    complete,
)


def _lowest_everywhere(rows: Sequence[Row], name: str) -> Iterator[Finding]:
    levels: dict[tuple[str, float], dict[str, Row]] = {}
    for row in rows:
        if row["stop"] == "target_reached":
            levels.setdefault((row["model"], row["level"]), {})[row["method"]] = row
    for (model, level), group in levels.items():
        if "qem4vr" not in group or len(group) < 2:
            continue
        best = min(group, key=lambda method: (group[method][name], method != "qem4vr"))
        numbers = f"QEM4VR {group['qem4vr'][name] * 1e3:.3f}, best {METHOD_TITLES[best]} "
        numbers += f"{group[best][name] * 1e3:.3f} (1e-3)"
        yield Finding(f"{model}, {level:.0%}", best == "qem4vr", numbers)


def _ends_midway(rows: Sequence[Row]) -> Iterator[Finding]:
    for model, by_method in _progressive.curves(rows):
        for method in ("qem-bp", "qem-btp"):
            if method not in by_method:
                continue
            last = by_method[method][-1]
            mine = by_method["qem4vr"][-1]["faces"] if "qem4vr" in by_method else None
            yield Finding(
                f"{model}, {METHOD_TITLES[method]}",
                _progressive.ends_early(by_method[method])
                and mine is not None
                and mine < last["faces"],
                f"ends at {last['faces']} of {counted(last['faces_original'], 'face')}, "
                f"QEM4VR at {mine}",
            )


EXPERIMENT = Experiment(
    id="figure-2.11",
    title="Metro with respect to the number of faces",
    published="",
    data=("lifeboat", "flash2a", "BAe-125", "Cessna337"),
    cases=_progressive.cases,
    columns=METRO_COLUMNS,
    claims=(
        *(
            Claim(
                f"QEM4VR has the lowest Metro at every level ({sampling} sampling)",
                "figure 2.11",
                partial(_lowest_everywhere, name=f"metro_{sampling}"),
            )
            for sampling in ("vertex", "area")
        ),
        Claim(
            "The curves of QEM-BP and QEM-BTP end midway, that of QEM4VR goes on",
            "section 2.5.2",
            _ends_midway,
        ),
    ),
    complete=complete,
    figures=lambda rows: _progressive.plots(
        rows, "metro_vertex", "Metro (vertex), 1e-3 of the diagonal", 1e3, logarithmic=True
    ),
    notes=(
        DATA_NOTE,
        MEASURE_NOTE,
        "The figure's values are not printed anywhere; its claims are compared. A cross marks the "
        "end of a curve whose method could go no further. Levels are compared among the methods "
        "that reached them.",
    ),
)
