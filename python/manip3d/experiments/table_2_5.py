"""Table 2.5: frame rates of scenes of one to six models, original and simplified."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

from manip3d import datasets
from manip3d.errors import MissingExtraError, RenderError
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row, counted
from manip3d.experiments._published import published_rows
from manip3d.experiments._simplification import SIMULATED
from manip3d.mesh import Mesh

_TABLE = "table_2_5_frame_rate"
_SIZE = (640, 480)
_RENDERERS = {"chromium": "three.js in headless Chromium", "pyvista": "VTK off screen"}
_METHODS = {
    "original": "original",
    "QEM_ORIG": "QEM-Orig",
    "QEM_BP": "QEM-BP",
    "QEM_4VR": "QEM4VR",
}

# Models in the order in which they enter the scene. The order follows from the differences of the
# published numbers of polygons, which are the numbers in table 2.1.
_MODELS = {
    "Airplane": "G-164A",
    "RockerArm": "rockerArm",
    "Jet": "BAe-125",
    "Car": "ferrari_458",
    "Head": "LeePerrySmith",
    "Dragon": "lifeboat",
}
_SIMULATED = {m.published: (m.mesh, faces) for m, faces in reversed(SIMULATED)}


def _polygons() -> dict[str, list[int]]:
    """Return the published numbers of polygons of each method's scenes of one to six models."""
    return {
        method: [int(row["polygons"]) for row in published_rows(_TABLE) if row["method"] == method]
        for method in _METHODS
    }


def _cases(plan: Plan) -> list[Case]:
    sizes = range(1, len(_MODELS) + 1) if plan.scale == "full" else (1, len(_MODELS))
    methods = _METHODS if plan.scale == "full" else ("original", "QEM_4VR")
    return [
        _case(number, method, renderer, plan)
        for number in sizes
        for renderer in _RENDERERS
        for method in methods
    ]


def _case(number: int, method: str, renderer: str, plan: Plan) -> Case:
    totals = [0, *_polygons()[method]]
    scene: list[dict[str, Any]] = []
    for i, published in enumerate(list(_MODELS)[:number]):
        name, simulated_faces = _mesh_of(published, plan)
        faces = totals[i + 1] - totals[i]
        scene.append({"mesh": name, "simulated_faces": simulated_faces, "faces": faces})
    inputs = tuple(part["mesh"] for part in scene if not part["simulated_faces"])
    return Case(
        draw,
        {
            "model": counted(number, "model"),
            "models": number,
            "method": method,
            "renderer": renderer,
            "data": "simulated" if len(inputs) < number else "stand-in",
            "role": "a scene of stand-ins",
            "scene": scene,
            "size": list(_SIZE),
            "frames": {"full": 100, "quick": 20}[plan.scale],
            "seconds": {"full": 5.0, "quick": 2.0}[plan.scale],
        },
        inputs=inputs,
    )


def _mesh_of(published: str, plan: Plan) -> tuple[str, int]:
    """Return the name of the mesh, and the number of faces to simulate; 0: the mesh is real."""
    name = _MODELS[published]
    if plan.data == "real" or (plan.data == "auto" and datasets.is_here(datasets.get(name))):
        return name, 0
    return _SIMULATED[published]


@lru_cache(maxsize=len(_MODELS))
def _open(name: str, simulated_faces: int) -> Mesh:
    if not simulated_faces:
        return datasets.load_mesh(name)
    from manip3d.simulate import models

    return models.MODELS[name](simulated_faces)


def draw(case: Case) -> Row:
    """Measure the frame time of one scene, and record the renderer."""
    from manip3d import simplify, viewer

    options = case.options
    meshes = []
    for part in options["scene"]:
        mesh = _open(part["mesh"], part["simulated_faces"])
        if mesh.num_faces > part["faces"]:
            mesh = simplify.fast(mesh, target_faces=part["faces"]).mesh
        meshes.append(mesh)
    row: Row = {"polygons": sum(mesh.num_faces for mesh in meshes)}
    try:
        times = viewer.frame_times(
            meshes,
            options["renderer"],
            size=tuple(options["size"]),
            frames=options["frames"],
            seconds=options["seconds"],
        )
    except (RenderError, MissingExtraError) as error:
        return row | {"driver": f"none: {error}", "ms": None, "fps": None, "timed": 0}
    return row | {
        "driver": times.driver,
        "ms": times.median,
        "fps": 1000.0 / times.median,
        "timed": len(times.milliseconds),
    }


def _complete(row: Row) -> Row:
    printed = next(
        r
        for r in published_rows(_TABLE)
        if (r["models"], r["method"]) == (str(row["models"]), row["method"])
    )
    return row | {
        "published_polygons": int(printed["polygons"]),
        "published_fps": float(printed["fps"]),
    }


def _scenes(rows: Sequence[Row]) -> Iterator[tuple[str, dict[str, Row]]]:
    """Yield each scene and renderer with its rows by method."""
    groups: dict[str, dict[str, Row]] = {}
    for row in rows:
        if row["ms"] is not None:
            name = f"{row['model']}, {_RENDERERS[row['renderer']]}"
            groups.setdefault(name, {})[row["method"]] = row
    yield from groups.items()


def _numbers(rows: Sequence[Row]) -> str:
    return ", ".join(
        f"{_METHODS[r['method']]} {r['ms']:.1f} ms ({counted(r['polygons'], 'polygon')})"
        for r in rows
    )


def _sooner_than(method: str, others: int) -> Any:
    """Return a judge of whether QEM4VR's scenes take no longer than larger ones of a method."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for name, group in _scenes(rows):
            if not {method, "QEM_4VR"} <= set(group):
                continue
            pair = [group["QEM_4VR"], group[method]]
            applies = pair[1]["polygons"] >= others * pair[0]["polygons"]
            holds = pair[0]["ms"] <= pair[1]["ms"] if applies else None
            yield Finding(name, holds, _numbers(pair))

    return judge


def _rates(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        if row["ms"] is not None and row["method"] == "QEM_4VR":
            numbers = f"{row['fps']:.1f} frames/s, published {row['published_fps']:.1f}"
            yield Finding(f"{row['model']}, {_RENDERERS[row['renderer']]}", None, numbers)


def _drivers(rows: Sequence[Row]) -> str:
    drivers = {_RENDERERS[row["renderer"]]: row["driver"] for row in rows}
    return "Drawn by " + "; ".join(f"{name}: {driver}" for name, driver in drivers.items()) + "."


EXPERIMENT = Experiment(
    id="table-2.5",
    title="Frame rates of scenes of one to six models",
    published=_TABLE,
    data=tuple(dict.fromkeys(datasets.source_of(name) for name in _MODELS.values())),
    cases=_cases,
    columns=(
        Column("renderer", "drawn by", words=_RENDERERS),
        Column("method", "method", words=_METHODS),
        Column("polygons", "polygons", published="published_polygons", ratio=False),
        Column("ms", "ms per frame", digits=2),
        Column("fps", "frames/s", digits=1, published="published_fps", ratio=False),
        Column("timed", "frames timed"),
    ),
    claims=(
        Claim(
            "A scene simplified by QEM4VR is drawn in less time than the original",
            "table 2.5",
            _sooner_than("original", 1),
        ),
        Claim(
            "Where QEM-BP stops at more than twice the polygons, its scene takes longer than "
            "QEM4VR's",
            "table 2.5",
            _sooner_than("QEM_BP", 2),
        ),
        Claim("Frame rates of scenes simplified by QEM4VR", "table 2.5", _rates, reported=True),
    ),
    complete=_complete,
    notes=(
        _drivers,
        "Polygons are those of table 2.5, model by model, as the differences of its rows have "
        "them: models with more faces are brought there by the fast mode, whatever the row's "
        "method, because the time of a frame depends on how many triangles there are; models with "
        "fewer are drawn as they are.",
        f"Pictures of {_SIZE[0]} x {_SIZE[1]} pixels, each timed until its last pixel is drawn, "
        "without waiting for a screen; the published frame rates look capped at 60 Hz. Times of "
        "one run beside others are too long: use --jobs 1. Programs that stand in for a graphics "
        "card (SwiftShader, llvmpipe) spend most of the time on pixels.",
    ),
)
