"""Figure 3.6: plain Delaunay triangulation, and the modified one of section 3.4."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from manip3d.experiments import _depth_pictures
from manip3d.experiments._depth import DATA_NOTE, NOTE, models, open_input, real_data, reduce
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.simplify import DepthMesh

_MODELS = ("Person 1", "Desk")
_TITLES = {"plain": "plain Delaunay", "modified": "modified (section 3.4)"}


def triangulate(case: Case) -> Row:
    """Triangulate a choice of points with or without the checks of section 3.4."""
    from manip3d import metrics, simplify

    image = open_input(case.options)
    measured = image.measured
    target = math.floor(0.1 * int(measured.sum()))
    chosen = reduce(image, "cios", target)
    assert isinstance(chosen, simplify.DepthMesh)
    mesh = chosen.mesh
    if case.options["method"] == "plain":
        faces = simplify.grid_delaunay(chosen.pixels)
        material = np.zeros(len(faces), np.int32) if mesh.materials else None
        mesh = mesh.replace(faces=faces, face_texcoords=faces, face_material=material)
    dense = image.dense().mesh
    metro = metrics.metro(dense, mesh, sampling="area", samples=5 * dense.num_faces)
    corners = mesh.vertices[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    return {
        "points": mesh.num_vertices,
        "faces": mesh.num_faces,
        "over_nothing": int((~_over_depth(chosen, mesh.faces, measured)).sum()),
        "longest_edge": float(edges.max(initial=0.0)),
        "metro_area_backward": metro.backward.mean / metro.diagonal,
        "reduced": mesh,
    }


def _over_depth(
    chosen: DepthMesh, faces: NDArray[np.int32], measured: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return whether the pixel at each triangle's centroid has a measurement."""
    u, v = np.rint(chosen.pixels[faces].mean(axis=1)).astype(np.intp).T
    over: NDArray[np.bool_] = measured[v, u]
    return over


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(
            triangulate,
            model.options | {"method": method},
            inputs=(model.data,) if model.data else (),
        )
        for model in models(plan, _MODELS)
        for method in ("plain", "modified")
    ]


def _nothing_over_nothing(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if row["method"] == "modified":
            numbers = f"{row['over_nothing']} of {row['faces']} triangles"
            yield Finding(row["model"], row["over_nothing"] == 0, numbers)


def _invents_less(rows: Sequence[Row]) -> Iterator[Finding]:
    groups: dict[str, dict[str, float]] = {}
    for row in rows:
        groups.setdefault(row["model"], {})[row["method"]] = row["metro_area_backward"]
    for model, errors in groups.items():
        numbers = ", ".join(f"{name} {error * 1e3:.3f}" for name, error in errors.items())
        if len(errors) == 2:
            holds = errors["modified"] < errors["plain"]
            yield Finding(model, holds, f"{numbers} (1e-3)")


EXPERIMENT = Experiment(
    id="figure-3.6",
    title="Plain and modified triangulation of the same points, 10 %",
    published="",
    data=real_data(_MODELS),
    cases=_cases,
    columns=(
        Column("method", "triangulation", words=_TITLES),
        Column("points", "vertices"),
        Column("faces", "faces"),
        Column("over_nothing", "over no depth"),
        Column("longest_edge", "longest edge, m", 1.0, 3),
        Column("metro_area_backward", "Metro back, area, 1e-3", 1e3, 3, lower_is_better=True),
    ),
    claims=(
        Claim(
            "The modified triangulation has no triangle whose centroid lies where nothing was "
            "measured",
            "section 3.4",
            _nothing_over_nothing,
        ),
        Claim(
            "The modified triangulation shows less that is not there (Metro from the result to "
            "the original)",
            "figure 3.6",
            _invents_less,
        ),
    ),
    complete=lambda row: row | {"label": _TITLES[row["method"]]},
    sheets=_depth_pictures.sheets,
    notes=(
        DATA_NOTE,
        NOTE,
    ),
)
