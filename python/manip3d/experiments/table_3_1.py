"""Table 3.1: attributes of the range images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

from manip3d.experiments import _published
from manip3d.experiments._depth import DATA_NOTE, NOTE, models, open_input, real_data
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_COUNTS = ("faces", "vertices")


def count(case: Case) -> Row:
    """Count faces and vertices of the dense mesh."""
    image = open_input(case.options)
    dense = image.dense()
    rows, columns = image.measured.shape
    return {
        "faces": dense.num_faces,
        "vertices": dense.num_vertices,
        "image": f"{columns} x {rows}",
        "coloured": image.color is not None,
    }


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(count, model.options, inputs=(model.data,) if model.data else ())
        for model in models(plan)
    ]


def _complete(row: Row) -> Row:
    return _published.with_counts(row, "table_3_1_datasets", _COUNTS)


def _possible(_: Sequence[Row]) -> Iterator[Finding]:
    for row in _published.published_rows("table_3_1_datasets"):
        faces, vertices = int(row["faces"]), int(row["vertices"])
        numbers = f"{faces} faces on {vertices} vertices"
        yield Finding(row["model"], faces < 2 * vertices, numbers)


EXPERIMENT = Experiment(
    id="table-3.1",
    title="Attributes of the range images",
    published="table_3_1_datasets",
    data=real_data(),
    cases=_cases,
    columns=(
        *(Column(n, n, published=f"published_{n}", ratio=False) for n in _COUNTS),
        Column("image", "pixels"),
        Column("coloured", "colour"),
    ),
    claims=(
        Claim(
            "bun000 and happyStandRight_0 are the published scans: faces and vertices agree",
            "table 3.1",
            partial(_published.same_counts, models=("Bunny", "Buddha"), counts=_COUNTS),
            together=True,
        ),
        Claim(
            "Each printed model has fewer than two faces a vertex, as the mesh of a pixel grid has",
            "aim",
            _possible,
            together=True,
        ),
    ),
    complete=_complete,
    notes=(
        DATA_NOTE,
        NOTE,
        "Desk's printed 3 042 969 faces are impossible on 155 275 vertices of a pixel grid: a "
        "misprint of about 304 000.",
    ),
)
