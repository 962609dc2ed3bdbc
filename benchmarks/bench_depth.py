"""Simplification of range images compared with current libraries: tables 3.3 and 3.4 extended.

``python benchmarks/bench_depth.py [--models ...] [--methods ...] [--rounds N]`` writes the section
`depth` of the results. Peers (other libraries) simplify the dense mesh, and their time includes
making it. All methods keep the same number of vertices. Each runs in a process of its own, pinned
to one core; a round runs each method once.
"""

from __future__ import annotations

import argparse
import json
import math
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import tables
from measuring import environment, measure, one_thread

SHARE = 0.05
TIMEOUT_S = 300
WITHIN = 0.01  # largest relative error of the number of vertices
REPEATS = 5
MAX_RUNS = 8  # runs to reach that number, because the target of peers is a number of faces
MAX_SAMPLES = 1_000_000
OURS: dict[str, dict[str, Any]] = {
    "CS3 (CIOS)": {"method": "cios"},
    "relief, fast": {"method": "relief", "effort": "fast"},
    "relief, balanced": {"method": "relief", "effort": "balanced"},
    "relief, best": {"method": "relief", "effort": "best"},
    "relief, moving points": {"method": "relief", "effort": "balanced", "move_points": True},
    "uniform grid": {"method": "uniform"},
    "Poisson disks": {"method": "poisson"},
    "scale-space analysis": {"method": "ssa"},
}
PEERS = (
    "manip3d QEM4VR",
    "PyMeshLab subset",
    "PyMeshLab optimal",
    "CGAL Lindstrom-Turk",
    "Open3D",
    "fast-simplification",
    "meshoptimizer subset",
    "meshoptimizer attributes",
    "meshoptimizer update",
)
MODELS = ("Bunny", "Buddha", "Dragon", "Desk", "Human", "Cabinet", "Person 1", "Person 2",
          "Person 3")  # fmt: skip
Row = dict[str, Any]


def load(model: str) -> tuple[Any, int, Any]:
    """Load the range image that stands in for a published model, and 5 % of its point count."""
    from manip3d.experiments import _depth

    chosen = next(m for m in _depth.REAL if m.published == model)
    image = _depth.open_input(chosen.options)
    return image, math.floor(SHARE * int(image.measured.sum())), chosen


def without_bow_ties(mesh: Any) -> Any:
    """Remove faces at vertices where two sheets touch, because CGAL requires manifold meshes."""
    import numpy as np

    faces = mesh.faces
    while True:
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, count = np.unique(edges, axis=0, return_counts=True)
        ends = np.bincount(unique[count == 1].ravel(), minlength=mesh.num_vertices)
        touched = (ends > 2)[faces].any(axis=1)
        if not touched.any():
            return type(mesh)(mesh.vertices, faces)
        faces = faces[~touched]


def run_one(name: str, model: str, target: int, output: str) -> None:
    """Run a method on a model in this process; print its cost as JSON and write the mesh."""
    one_thread()  # must run before any library counts the cores
    from dataclasses import replace

    from manip3d import Mesh
    from manip3d.experiments import _depth
    from peers import PEERS as KNOWN
    from peers import NotInstalledError, RefusedError

    image = replace(load(model)[0], color=None)
    if name in OURS:
        options = dict(OURS[name])
        method = options.pop("method")
        work: Callable[[], Any] = lambda: _depth.reduce(image, method, target, **options)  # noqa: E731
        result, cost = measure(work)
        for _ in range(REPEATS if cost.cpu_s < 1 else 0):
            result, again = measure(work)
            cost = min(cost, again, key=lambda one: one.cpu_s)
        mesh, before = Mesh(result.vertices, result.faces), 0.0
    else:
        image.dense()
        dense, dense_cost = measure(image.dense)
        try:
            is_cgal = name.startswith("CGAL")
            given = without_bow_ties(dense.mesh) if is_cgal else dense.mesh
            mesh, cost = KNOWN[name].measured(given, target)
        except NotInstalledError as error:
            print(json.dumps({"status": "not installed", "message": str(error)}))
            return
        except RefusedError as error:
            print(json.dumps({"status": "refused", "message": str(error)}))
            return
        before = dense_cost.cpu_s
    said = asdict(cost) | {"cpu_s": cost.cpu_s + before, "vertices": mesh.num_vertices}
    Path(output).write_bytes(pickle.dumps(mesh))
    print(json.dumps({"status": "ok"} | said))


def call(name: str, model: str, target: int, output: Path) -> dict[str, Any]:
    """Call `run_one` in a process of its own."""
    command = [sys.executable, __file__, "--one", name, model, str(target), str(output)]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired:
        return {"status": "timeout", "message": f"more than {TIMEOUT_S} s"}
    if done.returncode != 0:
        last = (done.stderr.strip() or f"exit {done.returncode}").splitlines()[-1]
        return {"status": "failed", "message": last}
    said: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return said


def reach(name: str, model: str, points: int, output: Path) -> tuple[int, dict[str, Any]]:
    """Find the target with which a method keeps ``points`` vertices; also return the last cost."""
    if name in OURS:
        return points, call(name, model, points, output)
    target, low, high = 2 * points, 0, 16 * points
    for _ in range(MAX_RUNS):
        said = call(name, model, target, output)
        if said["status"] != "ok" or abs(said["vertices"] / points - 1) <= WITHIN:
            break
        low, high = (target, high) if said["vertices"] < points else (low, target)
        guess = round(target * points / max(said["vertices"], 1))
        target = guess if low < guess < high else (low + high) // 2
    return target, said


def quality(model: str, output: Path) -> Row:
    """Compute every measure of chapter 3."""
    from manip3d.experiments import _depth

    mesh = pickle.loads(output.read_bytes())
    image = load(model)[0]
    options = {"most_samples": MAX_SAMPLES, "seed": 0}
    return {"faces": mesh.num_faces} | _depth.measures(image, mesh, options)


def compare(model: str, methods: list[str], rounds: int) -> list[Row]:
    """Return one row for each method."""
    image, points, chosen = load(model)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as folder:
        targets: dict[str, int] = {}
        for name in methods:
            if name == "scale-space analysis" and chosen.kind == "scene":
                continue
            output = Path(folder, f"{len(rows)}.pickle")
            targets[name], said = reach(name, model, points, output)
            row = {"model": model, "label": chosen.label, "name": name, "points": points} | said
            if said["status"] == "ok":
                row |= {"cpu_ms": [1000 * said["cpu_s"]]} | quality(model, output)
            rows.append(row)
            print(model, name, row.get("vertices"), said["status"], flush=True)
        for _ in range(rounds - 1):
            for row in rows:
                if row["status"] != "ok" or min(row["cpu_ms"]) > 20_000:
                    continue
                said = call(row["name"], model, targets[row["name"]], Path(folder, "again"))
                if said["status"] == "ok":
                    row["cpu_ms"].append(1000 * said["cpu_s"])
    for row in rows:
        row["measured"] = int(image.measured.sum())
    return rows


HEAD = ("", "vertices", "ms", "x CS3", "area Metro, 1e-3", "vertex Metro, 1e-3", "MSE, 1e-6", "mm²",
        "coverage", "FMPD")  # fmt: skip


def section(rows: list[Row]) -> str:
    """Return the tables, one for each model."""
    text = [tables.environment_line(environment())]
    for model in MODELS:
        mine = [row for row in rows if row["model"] == model]
        if not mine:
            continue
        reference = next((min(r["cpu_ms"]) for r in mine if r["name"] == "CS3 (CIOS)"), None)
        first = mine[0]
        text.append(
            f"### {model}: {first['label']}, {first['measured']:,} points to {first['points']:,}\n"
        )
        text.append(tables.table(HEAD, (_cells(row, reference) for row in mine)))
    return "\n".join(text)


def _cells(row: Row, reference: float | None) -> list[str]:
    if row["status"] != "ok":
        return [row["name"], row["status"], *["–"] * (len(HEAD) - 2)]
    milliseconds = min(row["cpu_ms"])
    missed = "" if abs(row["vertices"] / row["points"] - 1) <= WITHIN + 1e-3 else "*"
    return [
        row["name"],
        f"{row['vertices']:,}{missed}",
        tables.number(milliseconds),
        tables.number(milliseconds / reference if reference else None, 2),
        tables.number(1e3 * row["metro_area"]),
        tables.number(1e3 * row["metro_vertex"]),
        tables.number(1e6 * row["mse"]),
        tables.number(row["mse_mm2"]),
        f"{row['coverage']:.3f}",
        tables.number(row["fmpd"]),
    ]


def main() -> None:
    """Measure and write."""
    if sys.argv[1:2] == ["--one"]:
        name, model, target, output = sys.argv[2:]
        run_one(name, model, int(target), output)
        return
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", nargs="*", default=list(MODELS), choices=MODELS)
    parser.add_argument("--methods", nargs="*", default=[*OURS, *PEERS])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        help="also write the rows as JSON; those of other models in it are kept",
    )
    arguments = parser.parse_args()
    rows: list[Row] = []
    if arguments.output and arguments.output.exists():
        earlier = json.loads(arguments.output.read_text())
        rows = [row for row in earlier if row["model"] not in arguments.models]
    for model in arguments.models:  # write after each model, because all of them take an hour
        rows += compare(model, arguments.methods, arguments.rounds)
        if arguments.output:
            arguments.output.write_text(json.dumps(rows, indent=1))
        tables.write_section("depth", section(rows))


if __name__ == "__main__":
    main()
