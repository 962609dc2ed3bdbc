"""Common parts of experiments that vary one option of QEM4VR: cases, columns, the claim."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row
from manip3d.experiments._simplification import (
    DATA_NOTE,
    MEASURE_NOTE,
    METRO_COLUMNS,
    SIMULATED,
    complete,
    models,
    simplification_case,
)

MEASURES = {
    "metro_vertex": "Metro (vertex sampling)",
    "texture_mean": "mean texture error",
    "texture_rms": "RMS texture error",
}


def weight_ablation(
    *,
    id: str,
    title: str,
    option: str,
    symbol: str,
    weights: Sequence[float],
    readings: Sequence[dict[str, Any]],
    titles: dict[str, str],
    meshes: dict[str, Sequence[str]],
    measures: dict[str, float],
    source_value: float,
    note: str,
) -> Experiment:
    """Return the experiment that runs QEM4VR at several values of one weight.

    Parameters
    ----------
    option, symbol : str
        Name of the weight as an option of QEM4VR, and in the report.
    weights : sequence of float
        Values of the weight.
    readings : sequence of dict
        Values of other options; each weight is combined with each of them. These options become
        columns, too.
    titles : dict
        Column titles of these options.
    meshes : dict of str to sequence of str
        Models to simplify, by the plan's scale.
    measures : dict of str to float
        Columns in which the weight of the dissertation must have the lowest value, and the factor
        by which numbers are shown.
    """

    def cases(plan: Plan) -> list[Case]:
        return [
            simplification_case(model, faces, "qem4vr", plan, **{option: weight}, **reading)
            for model, faces in models(plan)
            if model.mesh in meshes[plan.scale] and "welded" not in model.variant
            for reading in readings
            for weight in weights
        ]

    def completed(row: Row) -> Row:
        options = row["method_options"]
        return complete(row) | {name: options[name] for name in (option, *readings[0])}

    def best(name: str, scale: float) -> Claim:
        def judge(rows: Sequence[Row]) -> Iterator[Finding]:
            groups: dict[tuple[str, ...], dict[float, float]] = {}
            for row in rows:
                if row.get(name) is not None:
                    key = (row["model"], *(f"{titles[key]}: {row[key]}" for key in readings[0]))
                    groups.setdefault(key, {})[row[option]] = row[name]
            for key, errors in groups.items():
                numbers = ", ".join(
                    f"{symbol} = {w:g}: {e * scale:.3f}" for w, e in sorted(errors.items())
                )
                mine = errors.get(source_value)
                holds = None if mine is None else mine <= min(errors.values())
                yield Finding(", ".join(key), holds, f"{numbers} (1/{scale:g})")

        listed = ", ".join(f"{weight:g}" for weight in weights)
        measure = MEASURES[name]
        text = f"{symbol} = {source_value:g} has the lowest {measure} of {listed} on every model"
        return Claim(text, "section 2.5, parameters", judge)

    simulated = {model.mesh for model, _ in SIMULATED}
    texture_columns = [
        Column(name, f"{name.replace('_', ' ')}, 1e-2", 1e2, 3, lower_is_better=True)
        for name in ("texture_mean", "texture_rms")
        if name in measures
    ]
    return Experiment(
        id=id,
        title=title,
        published="",
        data=tuple(mesh for mesh in meshes["full"] if mesh not in simulated),
        cases=cases,
        columns=(
            *(Column(name, titles[name]) for name in readings[0]),
            Column(option, symbol),
            Column("faces", "faces"),
            *(replace(column, published="") for column in METRO_COLUMNS[2:]),
            *texture_columns,
        ),
        claims=tuple(best(name, scale) for name, scale in measures.items()),
        complete=completed,
        notes=(DATA_NOTE, MEASURE_NOTE, note),
    )
