"""Simplification of depth images, compared with the dense mesh and an edge collapse.

``python benchmarks/bench_relief.py [--parts ...] [--cases ...] [--shares ...] [--rounds N]
[-o results.json]``

All methods run on one core, in the same run, with equal numbers of vertices. The peers' time is
that of making the dense mesh plus the library's own call. A round runs each method once; times are
the minimum of the rounds. Errors are mean one-sided distances from the dense mesh (`area` samples),
divided by the bounding box's diagonal.

Prefix meshes (`levels`) are made at 4, 2, 1, 1/2 and 1/4 times the points of a share, all in one
run and each in a run of its own.

Buffers: the time of `gpu_buffers` for a frame of 640 x 480 pixels, for the dense mesh and at each
share; unused memory is returned to the system before each call. Sequences: flicker of recorded and
simulated sequences, with each frame alone and with `ReliefStream`, measured as by
`manip3d reproduce sequences-3`.

Missing pixels: a random share of the scenes' pixels has no measurement. Meshes have 5 % of the
remaining points and are cut at depth steps. Coverage and error refer to the surface of the complete
image. This part writes its section of the results.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import tables
from manip3d import Intrinsics, Mesh, datasets, metrics, simplify
from manip3d.experiments import sequences_3
from manip3d.experiments._model import Plan
from measuring import environment, measure, one_thread
from peers import PEERS, NotInstalledError

EFFORTS = get_args(simplify.Effort)
COLLAPSES = ("meshoptimizer subset", "meshoptimizer attributes", "meshoptimizer update")
MAX_SAMPLES = 400_000
PARTS = ("buffers", "sequences", "missing", "cases")
FLICKER = ("flicker_mm", "step_mm", "changed")
PUBLISHED_SHARE = 0.05  # share of the points in the published tables
SHARES = (PUBLISHED_SHARE, 0.01, 0.005)
PREFIXES = (4.0, 2.0, 1.0, 0.5, 0.25)  # sizes of prefix meshes, relative to a share's points
MISSING = (0.0, 0.01, 0.03, 0.1, 0.3, 0.5)  # shares of missing pixels of a scene
MISSING_SEED = 1
SCENE_EDGE = 0.1  # metres; triangles of scenes with longer edges are no surface
SCANS = {"bun000": 2012, "happyStandRight_0": 3902, "dragonStandRight_0": None}
PEOPLE = ("person_turning", "person_ddrnet", "person_normalgan", "person_frontsurfaces",
          "person_utd_mhad")  # fmt: skip
SCENES = ("scene_kitchen", "scene_redwood", "scene_livingroom", "scene_tum_desk",
          "scene_kinect2_desk", "wall_realsense")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """An input, with functions that make its dense mesh and simplify it to n points."""

    points: int
    dense: Callable[[], simplify.DepthMesh]
    ours: Callable[..., simplify.Relief]  # function of a number of points
    height: NDArray[np.float32]  # (H, W) depth; NaN = none


def greedy_insertion(case: Case) -> Callable[[], tuple[Mesh, float]]:
    """Return Garland and Heckbert's greedy insertion into the depth image (pydelatin).

    The library does not support gaps: they are filled from the nearest measurement, and triangles
    over them are dropped afterwards. Runs are repeated with more points until the wanted number is
    left; only the last run is timed.
    """
    try:
        from pydelatin import Delatin
        from scipy.ndimage import distance_transform_edt
    except ImportError as error:
        raise NotInstalledError("pydelatin") from error
    dense, height = case.dense(), case.height
    hollow = np.isnan(height)
    nearest = distance_transform_edt(hollow, return_distances=False, return_indices=True)
    filled = np.ascontiguousarray(height[tuple(nearest)])
    points = np.full((*height.shape, 3), np.nan)
    points[dense.pixels[:, 1], dense.pixels[:, 0]] = dense.vertices

    def run(wanted: int) -> tuple[Mesh, float]:
        tin, cost = measure(Delatin, filled, max_error=0.0, max_points=wanted)
        u = tin.vertices[:, 0].astype(int)
        v = len(height) - 1 - tin.vertices[:, 1].astype(int)
        faces = tin.triangles[(~hollow[v, u])[tin.triangles].all(axis=1)]
        middle = np.rint([u[faces].mean(axis=1), v[faces].mean(axis=1)]).astype(int)
        faces = faces[~hollow[middle[1], middle[0]]]
        kept, faces = np.unique(faces, return_inverse=True)
        return Mesh(points[v[kept], u[kept]], faces.reshape(-1, 3)), cost.cpu_s

    wanted = case.points
    for _ in range(10):
        left = run(wanted)[0].num_vertices
        if abs(left - case.points) <= 0.005 * case.points:
            break
        wanted = round(wanted * case.points / max(left, 1))
    return lambda: run(wanted)


def case_of(name: str, share: float) -> Case:
    """Return a scan, a person (only its pixels) or a scene, with a target share of its points."""
    if name in SCANS:
        scan = datasets.load_scan(name)
        points = np.ascontiguousarray(scan.points, np.float32)
        published = SCANS[name] if share == PUBLISHED_SHARE else None
        count = published or math.ceil(share * int(scan.valid.sum()))
        return Case(
            count,
            lambda: simplify.dense_mesh_grid(points, scan.valid),
            lambda wanted, **options: simplify.relief_grid(points, scan.valid, wanted, **options),
            np.where(scan.valid, points[..., 2], np.float32(np.nan)),
        )
    frame = datasets.load_frame(name)
    depth: NDArray[Any] = np.ascontiguousarray(frame.person)
    edge = None if name in PEOPLE else SCENE_EDGE
    count = math.ceil(share * np.count_nonzero(depth))
    return Case(
        count,
        lambda: simplify.dense_mesh(depth, frame.intrinsics, max_edge=edge),
        lambda wanted, **options: simplify.relief(
            depth, frame.intrinsics, wanted, max_edge=edge, **options
        ),
        np.where(depth > 0, depth, np.nan).astype(np.float32),
    )


def faces_for(peer: Any, mesh: Mesh, points: int) -> int:
    """Find the number of faces at which the peer leaves about ``points`` vertices, never more."""
    faces, best = 2 * points, 0
    for _ in range(6):
        left = peer(mesh, faces)
        used = len(np.unique(left.faces))
        if used <= points:
            best = max(best, faces)
        if 0 <= points - used <= 0.002 * points:
            break
        faces += 2 * (points - used)
    return best or faces


def mean_of(dense: Mesh, mesh: Mesh) -> float:
    """Return the mean distance."""
    samples = min(10 * dense.num_faces, MAX_SAMPLES)
    return metrics.metro(dense, mesh, sampling="area", samples=samples, threads=1).mean


def error_of(dense: Mesh, mesh: Mesh) -> dict[str, float | None]:
    """Return the mean distance and the mean deviation of texture coordinates."""
    row: dict[str, float | None] = {"mean": mean_of(dense, mesh)}
    samples = min(10 * dense.num_faces, MAX_SAMPLES)
    if mesh.texcoords is not None:
        row["texture"] = metrics.texture_error(dense, mesh, samples=samples, threads=1).mean
    return row


def run_case(case: Case, rounds: int) -> list[dict[str, Any]]:
    """Return a row for each peer and for this package with fixed and with moved points."""
    dense = case.dense().mesh
    calls: dict[str, Callable[[], tuple[Mesh, float]]] = {}
    for name in COLLAPSES:
        peer = PEERS[name]
        try:
            faces = faces_for(peer, dense, case.points)
        except NotInstalledError:
            continue

        def collapse(peer: Any = peer, faces: int = faces) -> tuple[Mesh, float]:
            meshing = measure(case.dense)[1].cpu_s
            mesh, cost = peer.measured(dense, faces)
            return mesh, meshing + cost.cpu_s

        calls[f"dense + {name}"] = collapse
    with contextlib.suppress(NotInstalledError):
        calls["greedy insertion"] = greedy_insertion(case)
    for move in (False, True):
        for effort in EFFORTS:

            def ours(effort: str = effort, move: bool = move) -> tuple[Mesh, float]:
                result, cost = measure(case.ours, case.points, effort=effort, move_points=move)
                return result.mesh, cost.cpu_s

            calls[f"relief {effort}{' moved' if move else ''}"] = ours
    times: dict[str, list[float]] = {name: [] for name in calls}
    meshes: dict[str, Mesh] = {}
    for _ in range(rounds):
        for name, call in calls.items():
            meshes[name], seconds = call()
            times[name].append(seconds)
    return [
        {"method": name, "vertices": len(np.unique(mesh.faces)), "cpu_s": min(times[name])}
        | error_of(dense, mesh)
        for name, mesh in meshes.items()
    ]


def run_prefixes(case: Case, rounds: int) -> list[dict[str, Any]]:
    """Return for each effort the ratios of errors of prefix meshes to those of separate runs."""
    dense = case.dense().mesh
    sizes = [max(3, round(factor * case.points)) for factor in PREFIXES]
    rows = []
    for effort in EFFORTS:
        together, alone = math.inf, dict.fromkeys(sizes, math.inf)
        for _ in range(rounds):
            levels, cost = measure(case.ours, sizes[0], effort=effort, levels=sizes[1:])
            together = min(together, cost.cpu_s)
            own = {}
            for size in sizes:
                own[size], cost = measure(case.ours, size, effort=effort)
                alone[size] = min(alone[size], cost.cpu_s)
        meshes = [(levels.prefix(size).mesh, own[size].mesh) for size in sizes]
        errors = [[mean_of(dense, mesh) for mesh in pair] for pair in meshes]
        rows.append({
            "effort": effort,
            "sizes": sizes,
            "vertices": [levels.prefix(size).num_vertices for size in sizes],
            "error_ratios": [prefix / single for prefix, single in errors],
            "time_ratio": together / sum(alone.values()),
        })  # fmt: skip
    return rows


def show_prefixes(name: str, rows: list[dict[str, Any]]) -> None:
    """Print the ratios of errors, the largest mesh first."""
    table = Table(title=f"{name}: prefix meshes, error and time over runs of their own")
    for head in ("effort", *(str(size) for size in rows[0]["sizes"]), "time ratio"):
        table.add_column(head, justify="left" if head == "effort" else "right")
    for row in rows:
        ratios = [f"{ratio:.2f}" for ratio in row["error_ratios"]]
        table.add_row(row["effort"], *ratios, f"{row['time_ratio']:.2f}")
    Console(width=110).print(table)


def show(name: str, rows: list[dict[str, Any]]) -> None:
    """Print a table with ratios to the edge collapse of the same kind."""
    base = {row["method"]: row for row in rows}
    table = Table(title=name)
    for head in ("method", "vertices", "ms", "time ratio", "error 1e-3", "error ratio", "uv 1e-3"):
        table.add_column(head, justify="left" if head == "method" else "right")
    for row in rows:
        moved = row["method"].endswith(("moved", "update"))
        peer = base.get(f"dense + meshoptimizer {'update' if moved else 'subset'}")
        ratios = [f"{row[key] / peer[key]:.2f}" if peer else "" for key in ("cpu_s", "mean")]
        uv = row.get("texture")
        table.add_row(row["method"], str(row["vertices"]), f"{1e3 * row['cpu_s']:.2f}", ratios[0],
                      f"{1e3 * row['mean']:.3f}", ratios[1],
                      "" if uv is None else f"{1e3 * uv:.3f}")  # fmt: skip
    Console(width=110).print(table)


def run_buffers(shares: Sequence[float], rounds: int) -> list[dict[str, Any]]:
    """Measure the conversion to render buffers on an image that is completely filled by a bowl."""
    v, u = np.mgrid[0:480, 0:640]
    depth = (1500 + 400 * np.sin(u / 60) * np.cos(v / 50)).astype(np.uint16)
    camera = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
    meshes = {"dense": simplify.dense_mesh(depth, camera)}
    meshes |= {f"{100 * s:g} %": simplify.relief(depth, camera, round(s * depth.size))
               for s in shares}  # fmt: skip
    rows = []
    for name, mesh in meshes.items():
        seconds = [measure(mesh.gpu_buffers)[1].cpu_s for _ in range(max(rounds, 20))]
        rows.append({
            "mesh": name,
            "vertices": mesh.num_vertices,
            "median_ms": 1e3 * statistics.median(seconds),
            "slowest_ms": 1e3 * max(seconds),
        })  # fmt: skip
    return rows


def run_missing(name: str, rounds: int) -> list[dict[str, Any]]:
    """Simplify a scene with increasing shares of missing pixels; return time, coverage, error."""
    frame = datasets.load_frame(name)
    whole: NDArray[Any] = np.ascontiguousarray(frame.person)
    dense = simplify.dense_mesh(whole, frame.intrinsics)
    dense = simplify.cut_depth_steps(dense, whole, intrinsics=frame.intrinsics)
    order = np.random.default_rng(MISSING_SEED).permutation(whole.size)
    rows = []
    for share in MISSING:
        depth = whole.copy()
        depth.flat[order[: round(share * whole.size)]] = 0
        points = math.ceil(PUBLISHED_SHARE * np.count_nonzero(depth))
        for effort in ("live", "balanced"):

            def ours(depth: Any = depth, n: int = points, effort: Any = effort) -> simplify.Relief:
                step = simplify.DEPTH_STEP
                found = simplify.relief(depth, frame.intrinsics, n, depth_step=step, effort=effort)
                return simplify.cut_depth_steps(found, depth)

            runs = [measure(ours) for _ in range(rounds)]
            found = runs[0][0]
            assert isinstance(found.surface, simplify.DenseImage)
            of_whole = replace(found, surface=replace(found.surface, depth=whole), cover=None)
            rows.append({
                "missing": share,
                "effort": effort,
                "points": points,
                "vertices": found.num_used,
                "filled_pixels": found.filled_pixels,
                "cpu_s": min(cost.cpu_s for _, cost in runs),
                "coverage": of_whole.coverage,
                "bridges": of_whole.bridges,
                "reported": found.coverage * (1 - found.outside),
                "mean": mean_of(dense.mesh, found.mesh),
            })  # fmt: skip
    return rows


def show_rows(title: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """Print a table of all columns."""
    table = Table(title=title)
    for head in rows[0]:
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(*(f"{x:.3g}" if isinstance(x, float) else str(x) for x in row.values()))
    Console(width=140).print(table)


def run_sequences(named: str) -> list[dict[str, Any]]:
    """Measure flicker of available sequences, frames alone and as stream, and the ratio."""
    found: dict[tuple[str, str], Mapping[str, Any]] = {}
    for case in sequences_3.EXPERIMENT.cases(Plan()):
        model, method = case.options["model"], case.options["method"]
        if method.startswith("relief") and named in model:
            found[model, method] = case.run(case)
    return [
        {
            "sequence": model,
            "method": method,
            "measure": measure,
            "frames": row["frames"],
            "alone": alone[measure],
            "stream": row[measure],
            "ratio": row[measure] / alone[measure],
        }
        for (model, method), row in found.items()
        if "stream" in method and (alone := found[model, method.replace(" stream", "")])
        for measure in FLICKER
    ]


def main() -> None:
    """Run the available cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", nargs="*", default=[*SCANS, *PEOPLE, *SCENES])
    parser.add_argument("--shares", nargs="*", type=float, default=SHARES)
    parser.add_argument("--parts", nargs="*", choices=PARTS, default=PARTS)
    parser.add_argument("--sequence", default="", help="only those with this in their name")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    one_thread()
    results: dict[str, Any] = {"environment": environment(), "cases": {}}
    if "buffers" in arguments.parts:
        results["buffers"] = run_buffers(arguments.shares, arguments.rounds)
        show_rows("gpu_buffers, 640 x 480", results["buffers"])
    if "sequences" in arguments.parts:
        results["sequences"] = run_sequences(arguments.sequence)
        show_rows("flicker, 5 % of the points", results["sequences"])
    if "missing" in arguments.parts:
        scenes = [name for name in arguments.cases if name in SCENES]
        scenes = [name for name in scenes if datasets.is_here(datasets.get(name))]
        results["missing"] = {name: run_missing(name, arguments.rounds) for name in scenes}
        if scenes:
            tables.write_missing_pixels(results)
    if arguments.output:
        arguments.output.write_text(json.dumps(results, indent=1) + "\n")
    for name in arguments.cases if "cases" in arguments.parts else ():
        for share in arguments.shares:
            try:
                case = case_of(name, share)
            except datasets.DataMissingError:
                print(f"{name}: not here")
                break
            title = f"{name}, {100 * share:g} %"
            methods = run_case(case, arguments.rounds)
            show(title, methods)
            prefixes = run_prefixes(case, arguments.rounds)
            show_prefixes(title, prefixes)
            results["cases"].setdefault(name, {})[f"{share:g}"] = {
                "methods": methods,
                "prefixes": prefixes,
            }
            if arguments.output:
                arguments.output.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
