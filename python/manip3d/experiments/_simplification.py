"""Common parts of the experiments of chapter 2: models, the measured case, and claims about rows.

Tables 2.2 to 2.7 use the same simplified meshes. A case therefore belongs to no single table: it
simplifies one model by one method to one target and computes every measure of the result.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from manip3d import datasets
from manip3d.datasets import CLEANINGS, STAND_INS, StandIn
from manip3d.experiments import _published
from manip3d.experiments._model import Case, Claim, Column, Finding, Plan, Row, by_model, counted
from manip3d.experiments._notes import data_note
from manip3d.mesh import Mesh

NON_TEXTURED_METHODS = ("qem-orig", "qem-bp", "qem4vr")
TEXTURED_METHODS = ("qem-orig", "qem-bp", "qem-tp", "qem-btp", "qem4vr")
TEXTURE_PRESERVING = ("qem-tp", "qem-btp")
PUBLISHED_TARGETS = {"RockerArm": 8174, "Head": 1844}
"""Numbers of faces of the published simplified meshes. They apply to models for which every method
reached the same number; all other models are simplified to 10 %."""

# Simulated models for runs without data, made by manip3d.simulate.models with the same traits and
# the same numbers of faces as the published models.
SIMULATED = (
    (StandIn("RockerArm", "rocker"), 80_354),
    (StandIn("Car", "car", variant="as stored"), 268_630),
    (StandIn("Car", "car", "any-unwelded", variant="one-sided"), 268_630),
    (StandIn("Dragon", "lifeboat"), 37_986),
    (StandIn("Head", "head", textured=True), 17_684),
    (StandIn("Jet", "jet", textured=True), 35_095),
    (StandIn("Airplane", "airplane", textured=True), 66_496),
)

# One mesh for each published model, for quick runs of about a minute.
_QUICK = (
    "rockerArm",
    "2CylinderEngine, welded",
    "lifeboat, as stored",
    "LeePerrySmith",
    "BAe-125-uv",
    "G-164A",
    "rocker",
    "car, one-sided",
    "lifeboat",
    "head",
    "jet",
    "airplane",
)


def real_data(*, textured: bool | None = None) -> tuple[str, ...]:
    """Return the data sets of experiments on these models."""
    wanted = (model for model in STAND_INS if textured in (None, model.textured))
    return tuple(dict.fromkeys(datasets.source_of(model.mesh) for model in wanted))


def models(plan: Plan, *, textured: bool | None = None) -> list[tuple[StandIn, int]]:
    """Return the meshes of a plan, each with the number of faces to simulate; 0: a real mesh.

    With ``data='auto'`` each published model is represented by its real meshes that are present, or
    by the simulated one if none is.
    """
    real = [m for m in STAND_INS if _wanted(m, plan)]
    if plan.data == "auto":
        real = [m for m in real if datasets.is_here(datasets.get(datasets.source_of(m.mesh)))]
    elif plan.data == "simulated":
        real = []
    covered = {m.published for m in real}
    chosen = [(m, 0) for m in real]
    if plan.data != "real":
        chosen += [(m, n) for m, n in SIMULATED if m.published not in covered and _wanted(m, plan)]
    order = [*dict.fromkeys(m.published for m, _ in SIMULATED), ""]
    chosen.sort(key=lambda pair: order.index(pair[0].published))
    return [pair for pair in chosen if textured in (None, pair[0].textured)]


def _wanted(model: StandIn, plan: Plan) -> bool:
    return plan.scale == "full" or model.label in _QUICK


def model_options(model: StandIn, simulated_faces: int) -> dict[str, Any]:
    """Return the options of a case that name its mesh and the published model it stands for."""
    simulated = simulated_faces > 0
    return {
        "model": f"{model.label} (simulated)" if simulated else model.label,
        "mesh": model.mesh,
        "simulated_faces": simulated_faces,
        "stands_in_for": model.published,
        "data": "simulated" if simulated else model.data,
        "role": f"simulated {model.role}" if simulated else model.role,
    }


def simplification_case(
    model: StandIn,
    simulated_faces: int,
    method: str,
    plan: Plan,
    *,
    level: float | None = None,
    **options: Any,
) -> Case:
    """Return the case that simplifies a model by a method and computes every measure.

    Parameters
    ----------
    level : float, optional
        Target as a fraction of the faces of the original mesh. Default: the published number of
        faces, or 10 % if the model is not the published file.
    options
        Options of the method.
    """
    published_target = PUBLISHED_TARGETS[model.published] if model.same_file else None
    return Case(
        simplify_and_measure,
        model_options(model, simulated_faces)
        | {
            "cleaning": model.cleaning,
            "method": method,
            "level": level,
            "faces_target": published_target if level is None else None,
            "method_options": options,
            "samples_per_face": 10 if plan.scale == "full" else 2,
            "seed": plan.seed,
        },
        inputs=() if simulated_faces else (model.mesh,),
    )


def open_model(options: Mapping[str, Any]) -> Mesh:
    """Open the mesh of a case, read or simulated, before cleaning."""
    if not options["simulated_faces"]:
        return datasets.load_mesh(options["mesh"])
    from manip3d.simulate import models

    return models.MODELS[options["mesh"]](options["simulated_faces"])


def simplify_and_measure(case: Case) -> Row:
    """Simplify a model by one method to one target and compare the result with the original."""
    from manip3d import simplify

    options = case.options
    original = open_model(options)
    cleaned = datasets.apply_cleaning(original, options["cleaning"])
    target = options["faces_target"] or math.floor(original.num_faces * (options["level"] or 0.1))
    summary = cleaned.summary()
    started = time.perf_counter()
    result = simplify.METHODS[options["method"]](
        cleaned, target_faces=target, **options["method_options"]
    )
    seconds = time.perf_counter() - started
    row: Row = {
        "cleaning_does": CLEANINGS[options["cleaning"]],
        "faces_original": original.num_faces,
        "faces_cleaned": cleaned.num_faces,
        "boundary_edges": summary.boundary_edges,
        "faces_without_uv": summary.faces_without_uv,
        "faces_target": target,
        "faces": result.mesh.num_faces,
        "stop": str(result.stop),
        "rejected": dict(result.rejected),
        "message": result.message,
        "max_error": result.max_error,
        "seconds": seconds,
    }
    if row["stop"] == "refused":
        return row | {"faces": None, "max_error": None}
    return row | {"simplified": result.mesh} | measures(original, result.mesh, options)


def measures(original: Mesh, simplified: Mesh, options: Mapping[str, Any]) -> Row:
    """Return every measure of a simplified mesh, as flat columns."""
    from manip3d import metrics

    per_face, seed = options["samples_per_face"], options["seed"]
    row: Row = {}
    for sampling in ("vertex", "area"):
        samples = per_face * original.num_faces if sampling == "area" else None
        metro = metrics.metro(original, simplified, sampling=sampling, samples=samples, rng=seed)
        name = f"metro_{sampling}"
        row |= {name: metro.mean, f"{name}_rms": metro.rms, f"{name}_max": metro.max}
        row |= {
            f"{name}_backward": metro.backward.mean / metro.diagonal,
            f"{name}_backward_rms": metro.backward.rms / metro.diagonal,
            f"{name}_backward_max": metro.backward.max / metro.diagonal,
        }
    if original.face_texcoords is not None:
        texture = metrics.texture_error(original, simplified, rng=seed)
        row |= {f"texture_{name}": value for name, value in asdict(texture).items()}
    fmpd = metrics.fmpd(original, simplified)
    row |= {"fmpd": fmpd.value}
    row |= {f"fmpd_{k}": v for k, v in asdict(fmpd).items() if k != "value"}
    gap = metrics.boundary_gap(original, simplified)
    return row | {
        "boundary_gap": gap.forward and gap.forward.mean / gap.diagonal,
        "boundary_gap_max": gap.forward and gap.forward.max / gap.diagonal,
        "boundary_gap_backward": gap.backward and gap.backward.mean / gap.diagonal,
        "cracks": gap.cracks,
        "crack_length": gap.crack_length / gap.diagonal,
    }


# --- published values ----------------------------------------------------------------------------

_SIMPLIFIED = ("table_2_2_metro_non_textured", "table_2_3_2_4_textured")
_TABLES = {
    "metro_vertex": (_SIMPLIFIED, "metro_1e-3", 1e-3),
    "texture_mean": (("table_2_3_2_4_textured",), "texture_error_1e-2", 1e-2),
    "fmpd": (("table_2_6_2_7_fmpd",), "fmpd", 1.0),
    "faces": (_SIMPLIFIED, "faces_simplified", 1.0),
}


def complete(row: Row) -> Row:
    """Add to a row the values that the tables print for its model.

    ``published_X`` is the printed X of the model that the row's mesh is or stands in for. It can be
    compared with the measured X only if ``data`` is ``published``.
    """
    printed: Row = {}
    for name, (tables, column, unit) in _TABLES.items():
        cells = (_published.value(t, row["stands_in_for"], row["method"], column) for t in tables)
        cell = next((cell for cell in cells if cell is not None), None)
        printed[f"published_{name}"] = cell * unit if isinstance(cell, float) else cell
    return row | printed | {"reached": row.get("stop") == "target_reached"}


# --- claims over rows ----------------------------------------------------------------------------


def ran(rows: dict[str, Row]) -> dict[str, Row]:
    """Return the rows of the methods that ran."""
    return {method: row for method, row in rows.items() if ran_row(row)}


def ran_row(row: Row) -> bool:
    """Return whether a method ran."""
    return bool(row["stop"] != "refused")


def shown(value: float | None, scale: float = 1.0, digits: int = 3) -> str:
    """Format a number for a finding; ``-`` for None."""
    return "-" if value is None else f"{value * scale:.{digits}f}"


def listing(rows: dict[str, Row], name: str, scale: float = 1.0) -> str:
    """Return values by method, such as ``QEM-BP 0.158 (at 5 751 faces), QEM4VR 0.157``.

    The number of faces is added if the method missed its target.
    """
    return ", ".join(
        f"{METHOD_TITLES.get(method, method)} {shown(row.get(name), scale)}"
        + ("" if reached(row) else f" (at {counted(row['faces'], 'face')})")
        for method, row in rows.items()
    )


def reached(row: Row) -> bool:
    """Return whether a method reached the target."""
    return bool(row["stop"] == "target_reached")


def lowest(
    name: str,
    what: str,
    source: str,
    *,
    scale: float,
    among: Callable[[Row], bool],
    five: bool = False,
) -> Claim:
    """Return the claim that QEM4VR has the lowest ``name`` on every model.

    Parameters
    ----------
    among : callable
        Function from a row to whether it is compared.
    five : bool
        Judge only models for which all five methods are compared.
    """
    need = TEXTURED_METHODS if five else ("qem4vr",)

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for model, group in by_model(rows):
            field = {m: r for m, r in group.items() if among(r) and r.get(name) is not None}
            others = [row[name] for method, row in field.items() if method != "qem4vr"]
            numbers = listing(field, name, scale)
            absent = [method for method in need if method not in field]
            if absent or not others:
                names = ", ".join(METHOD_TITLES[method] for method in absent)
                reason = f"not compared: {names}" if absent else "nothing to compare"
                yield Finding(model, None, "; ".join(filter(None, (numbers, reason))))
            else:
                mine = field["qem4vr"][name]
                tie = " (a tie)" if mine == min(others) else ""
                yield Finding(model, mine <= min(others), numbers + tie)

    return Claim(what, source, judge)


def lowest_claims(
    name: str, measure: str, source: str, *, scale: float, five: bool
) -> tuple[Claim, ...]:
    """Return the claims that QEM4VR has the lowest error of three groups of methods.

    The groups are all five methods, the methods that ran, and the methods that reached the target.
    A method that stops early keeps more faces and for this reason has a lower error; the last claim
    leaves such methods out.
    """
    claims = [
        lowest(
            name,
            f"QEM4VR has the lowest {measure} of the methods that ran",
            source,
            scale=scale,
            among=ran_row,
        ),
        lowest(
            name,
            f"QEM4VR has the lowest {measure} of the methods that reached the target",
            source,
            scale=scale,
            among=reached,
        ),
    ]
    if five:
        text = f"QEM4VR has the lowest {measure} of the five methods, where five ran"
        claims.insert(0, lowest(name, text, source, scale=scale, among=ran_row, five=True))
    return tuple(claims)


def below(name: str, sampling: str, method: str, model: str, *, scale: float) -> Claim:
    """Return the claim that QEM4VR has a lower value than one baseline, on a published file.

    The result depends on the model's texture coordinates, so that no stand-in can judge it.
    """

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for label, group in by_model(rows):
            both = {m: r for m, r in ran(group).items() if m in (method, "qem4vr")}
            if len(both) == 2 and both[method]["stands_in_for"] == model:
                holds = both["qem4vr"][name] < both[method][name]
                yield Finding(label, holds, listing(both, name, scale))

    text = f"{model}: QEM4VR has a lower Metro ({sampling} sampling) than {METHOD_TITLES[method]}"
    return Claim(text, "aim", judge, data=("published",))


def reaches_target() -> Claim:
    """Return the claim that QEM4VR reaches its target on every model."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for row in rows:
            if row["method"] == "qem4vr":
                got, target = row["faces"], row["faces_target"]
                numbers = f"{counted(got, 'face')}, target {target}, {STOPS[row['stop']]}"
                yield Finding(row["model"], got <= target, numbers)

    return Claim("QEM4VR reaches its target on every model", "tables 2.2 and 2.3", judge)


def reaches_where_others_stop(methods: tuple[str, ...], source: str) -> Claim:
    """Return the claim that QEM4VR reaches targets which methods with fixed boundaries miss."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for model, group in by_model(rows):
            present = ran(group)
            for method in methods:
                row, mine = present.get(method), present.get("qem4vr")
                if row is None or mine is None:
                    yield Finding(model, None, f"{METHOD_TITLES[method]} did not run")
                elif row["faces"] <= row["faces_target"]:
                    numbers = f"reaches the target, {counted(row['faces'], 'face')}"
                    yield Finding(model, None, f"{METHOD_TITLES[method]} {numbers}")
                else:
                    yield Finding(
                        model,
                        mine["faces"] <= mine["faces_target"],
                        f"target {row['faces_target']}, {METHOD_TITLES[method]} stops at "
                        f"{counted(row['faces'], 'face')}, QEM4VR at {mine['faces']}",
                    )

    names = " or ".join(METHOD_TITLES[method] for method in methods)
    text = f"QEM4VR reaches the target where {names} stops before it"
    return Claim(text, source, judge)


def refuses_faces_without_uv() -> Claim:
    """Return the claim that texture-preserving baselines fail on faces without coordinates."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for row in rows:
            if row["method"] in TEXTURE_PRESERVING:
                without = row["faces_without_uv"]
                refused = row["stop"] == "refused"
                yield Finding(
                    f"{row['model']}, {METHOD_TITLES[row['method']]}",
                    refused if without else None,
                    f"{counted(without, 'face')} without UV, {'refused' if refused else 'ran'}",
                )

    return Claim(
        "QEM-TP and QEM-BTP fail on a model with faces without texture coordinates",
        "tables 2.3 and 2.4",
        judge,
    )


def equal_methods(
    pairs: tuple[tuple[str, str], ...],
    name: str,
    models: tuple[str, ...],
    text: str,
    source: str,
    *,
    scale: float,
    within: float = 0.02,
) -> Claim:
    """Return the claim that two methods give equal results on a published model without border."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for model, group in by_model(rows):
            present = ran(group)
            if next(iter(group.values()))["stands_in_for"] not in models:
                continue
            for first, second in pairs:
                if first in present and second in present:
                    a, b = present[first][name], present[second][name]
                    both = {m: present[m] for m in (first, second)}
                    yield Finding(
                        model, abs(a - b) <= within * max(a, b), listing(both, name, scale)
                    )

    return Claim(text, source, judge)


STOPS = {
    "target_reached": "target reached",
    "error_limit": "error limit",
    "no_legal_collapse": "no legal collapse left",
    "refused": "refused",
}
METHOD_TITLES = {
    "qem-orig": "QEM-Orig",
    "qem-bp": "QEM-BP",
    "qem-tp": "QEM-TP",
    "qem-btp": "QEM-BTP",
    "qem4vr": "QEM4VR",
}


def at_most(
    name: str, limit: float, model: str, what: str, *, scale: float, method: str = "qem4vr"
) -> Claim:
    """Return the aim that ``name`` of QEM4VR is at most ``limit`` on a published file."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for row in rows:
            if row["stands_in_for"] == model and row["method"] == method:
                numbers = f"{shown(row[name], scale)}, aim {shown(limit, scale)}"
                yield Finding(row["model"], row[name] <= limit, numbers)

    return Claim(what, "aim", judge, data=("published",))


SHARED_COLUMNS = (
    Column("method", "method", words=METHOD_TITLES),
    Column("faces", "faces", published="published_faces", ratio=False),
    Column("stop", "stopped because", words=STOPS),
)
METRO_COLUMNS = (
    *SHARED_COLUMNS,
    Column(
        "metro_vertex",
        "Metro, vertex, 1e-3",
        1e3,
        3,
        "published_metro_vertex",
        lower_is_better=True,
    ),
    Column("metro_area", "Metro, area, 1e-3", 1e3, 3, lower_is_better=True),
    Column("metro_vertex_rms", "RMS, vertex", 1e3, 3),
    Column("metro_area_backward", "Metro back, area", 1e3, 3),
    Column("boundary_gap", "boundary gap", 1e3, 3),
    Column("cracks", "cracks"),
    Column("seconds", "seconds", 1.0, 2),
)
DATA_NOTE = data_note("mesh")
MEASURE_NOTE = (
    "Targets and errors refer to the mesh as read; every row names its cleaning. "
    "Metro is the mean distance from original to simplified, and the boundary gap that from the "
    "original's boundary to the simplified one's, both in thousandths of the diagonal of the "
    "original's bounding box; 'back' measures from simplified to original. Seconds are those of "
    "one run beside the others."
)
