"""Table 2.1: the models, their faces, vertices and boundary edges."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from functools import partial

from manip3d import datasets
from manip3d.experiments import _published
from manip3d.experiments._model import (
    Case,
    Claim,
    Column,
    Experiment,
    Finding,
    Plan,
    Row,
    counted,
)
from manip3d.experiments._notes import data_note
from manip3d.experiments._simplification import model_options, models, open_model, real_data

_COUNTS = ("faces", "vertices", "boundary_edges")


# Counts that depend on the triangulation of polygons. The registered counts come from fans, which
# turn some triangles inside out; the readers of this package avoid that.
_CUT_DEPENDENT = {
    f"{count}{welded}"
    for count in ("boundary_edges", "non_manifold_edges", "duplicate_faces")
    for welded in ("", "_welded")
}


def count(case: Case) -> Row:
    """Count faces, vertices and boundary edges of one mesh as read."""
    row: Row = asdict(open_model(case.options).summary())
    if case.options["mesh"] in datasets.registry() and not case.options["simulated_faces"]:
        row["registered"] = dict(datasets.get(case.options["mesh"]).facts)
    return row


def _cases(plan: Plan) -> list[Case]:
    meshes = {model.mesh: (model, faces) for model, faces in reversed(models(plan))}
    return [
        Case(
            count,
            model_options(replace(model, variant=""), faces),
            inputs=() if faces else (model.mesh,),
        )
        for model, faces in reversed(meshes.values())
    ]


def _complete(row: Row) -> Row:
    return _published.with_counts(row, "table_2_1_datasets", _COUNTS)


def _as_registered(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        facts = row.get("registered")
        if facts:
            cut = facts["polygons"] < facts["faces"]
            names = [n for n in facts if n in row and not (cut and n in _CUT_DEPENDENT)]
            wrong = [n for n in names if row[n] != facts[n]]
            numbers = ", ".join(
                f"{n.replace('_', ' ')} {row[n]}, registered {facts[n]}" for n in wrong
            )
            agree = f"{counted(len(names), 'count')} agree"
            yield Finding(row["model"], not wrong, numbers or agree)


EXPERIMENT = Experiment(
    id="table-2.1",
    title="Attributes of the models",
    published="table_2_1_datasets",
    data=real_data(),
    cases=_cases,
    columns=(
        *(Column(n, n.replace("_", " "), published=f"published_{n}", ratio=False) for n in _COUNTS),
        Column("non_manifold_edges", "non-manifold edges"),
        Column("components_welded", "components"),
        Column("faces_without_uv", "faces without UV"),
        Column("multi_uv_vertices", "multi-UV vertices"),
    ),
    claims=(
        Claim(
            "RockerArm and Head are the published files: faces, vertices and boundary edges agree",
            "table 2.1",
            partial(_published.same_counts, models=("RockerArm", "Head"), counts=_COUNTS),
            together=True,
        ),
        Claim(
            "Every count that does not depend on how polygons are cut equals the registered one",
            "aim",
            _as_registered,
        ),
    ),
    complete=_complete,
    notes=(
        data_note("mesh"),
        "Car, Dragon, Jet and Airplane are not public; stand-ins have the same traits.",
    ),
)
