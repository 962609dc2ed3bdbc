"""Check two guarantees of every simplification on all meshes of the data folder.

``python benchmarks/bench_promises.py [--meshes ...] [--runs N] -o promises.json``

Meshes with stored results are not run again, so that an interrupted run continues. Use another file
after a change of the code.

Guarantee 1, identical bytes: each mode simplifies to a tenth of the faces, N times with one thread
and N times with two; each number of threads runs in a process of its own.

Guarantee 2, the distance: runs with a `max_distance` of 1e-2, 1e-3 and 1e-4 of the diagonal. The
distance is bounded from below by the vertices, the midpoints of edges and random points of both
meshes. A violation is a promised bound above the limit, or a point whose distance exceeds the
promised bound by more than 1e-6 of the diagonal.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

import models
import tables
from manip3d import Mesh, metrics, simplify

RATIO = 0.1
LIMITS = (1e-2, 1e-3, 1e-4)
MAX_SAMPLES = 10_000_000  # largest number of samples; 100 per face below 100 000 faces
TOLERANCE = 1e-6
PROVED: tuple[simplify.Mode, ...] = ("published", "quality")  # `fast` has no max_distance


def digest(mesh: Mesh) -> str:
    """Return a hash of all arrays of a mesh."""
    state = hashlib.sha256()
    for name in ("vertices", "faces", "texcoords", "face_texcoords", "normals", "face_normals",
                 "colors", "face_material"):  # fmt: skip
        array = getattr(mesh, name)
        state.update(name.encode() if array is None else np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def digests(mesh: Mesh, runs: int) -> dict[str, list[str]]:
    """Return the different results of ``runs`` runs, by mode."""
    return {
        mode: sorted({digest(simplify.simplify(mesh, mode, ratio=RATIO).mesh) for _ in range(runs)})
        for mode in get_args(simplify.Mode)
    }


def points_of(mesh: Mesh, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return vertices, midpoints of edges, and random points of each face."""
    corners = mesh.vertices[mesh.faces]
    per_face = max(1, min(100, MAX_SAMPLES // max(1, len(corners))))
    weights = rng.dirichlet([1, 1, 1], size=(len(corners), per_face))
    inside = np.einsum("fsk,fkd->fsd", weights, corners).reshape(-1, 3)
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3)
    return np.concatenate([corners.reshape(-1, 3), middles, inside])


def distance(mesh: Mesh, mode: simplify.Mode, limit: float) -> dict[str, float]:
    """Return faces left, and promised bound and largest sampled distance divided by the limit."""
    start = time.process_time()
    result = simplify.simplify(mesh, mode, max_distance=limit * mesh.diagonal)
    seconds = time.process_time() - start
    rng = np.random.default_rng(1)
    there = metrics.closest_points(result.mesh, points_of(mesh, rng)).distance.max()
    back = metrics.closest_points(mesh, points_of(result.mesh, rng)).distance.max()
    unit = limit * mesh.diagonal
    return {
        "faces": result.mesh.num_faces,
        "bound": float(result.distance_bound or 0.0) / unit,
        "sampled": float(max(there, back)) / unit,
        "cpu_s": seconds,
    }


def is_violated(row: dict[str, float], limit: float) -> bool:
    """Return whether the bound is above the limit, or a sampled distance above the bound."""
    return row["bound"] > 1.0 or row["sampled"] > row["bound"] + TOLERANCE / limit


def with_threads(name: str, runs: int, threads: int) -> dict[str, list[str]]:
    """Return the digests of a process that uses ``threads`` threads."""
    done = subprocess.run(
        [sys.executable, __file__, "--digests", name, "--runs", str(runs)],
        env=os.environ | {"MANIP3D_THREADS": str(threads)},
        check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    found: dict[str, list[str]] = json.loads(done.stdout)
    return found


def different_results(name: str, runs: int) -> dict[str, int]:
    """Count the different results of each mode, over all runs with one and with two threads."""
    one, two = (with_threads(name, runs, threads) for threads in (1, 2))
    return {mode: len({*one[mode], *two[mode]}) for mode in one}


def print_tables(results: dict[str, Any]) -> None:
    """Print both tables of all stored results."""
    same = [
        (
            name,
            f"{found['faces']:,}",
            *(str(found["different"][mode]) for mode in get_args(simplify.Mode)),
        )
        for name, found in results.items()
        if "different" in found
    ]
    print(tables.table(("mesh: different results", "faces", *get_args(simplify.Mode)), same), "\n")
    cases = [
        (name, mode, limit, row)
        for name, found in results.items()
        for mode in PROVED
        for limit in LIMITS
        if (row := found["distance"].get(f"{mode} {limit:g}"))
    ]
    head = ("mesh", "mode", "limit", "faces: before / after", "bound / limit", "sampled / limit",
            "s")  # fmt: skip
    rows = [
        (name, mode, f"{limit:g}", f"{results[name]['faces']:,} / {row['faces']:,}",
         f"{row['bound']:.3f}", f"{row['sampled']:.3f}", f"{row['cpu_s']:.1f}")
        for name, mode, limit, row in cases
    ]  # fmt: skip
    print(tables.table(head, rows))
    violations = sum(is_violated(row, limit) for _, _, limit, row in cases)
    print(f"\n{len(rows)} cases, {violations} violations")


def main() -> None:
    """Run the meshes without stored results, store each result, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--meshes", nargs="+", default=list(models.every_mesh()), metavar="MESH")
    parser.add_argument("--runs", type=int, default=20, metavar="N", help="0: distances only")
    parser.add_argument("--limits", type=float, nargs="*", default=LIMITS, metavar="SHARE")
    parser.add_argument("-o", "--output", type=Path, default=Path("promises.json"))
    parser.add_argument("--digests", metavar="MESH", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.digests:
        mesh = simplify.clean(models.every_mesh()[options.digests]()).mesh
        print(json.dumps(digests(mesh, options.runs)))
        return
    results: dict[str, Any] = {}
    if options.output.exists():
        results = json.loads(options.output.read_text())

    def store() -> None:
        options.output.write_text(json.dumps(results, indent=1) + "\n")

    for name in options.meshes:
        mesh = simplify.clean(models.every_mesh()[name]()).mesh
        found = results.setdefault(name, {"faces": mesh.num_faces, "distance": {}})
        if options.runs > 0 and "different" not in found:
            found["different"] = different_results(name, options.runs)
            store()
        for limit in options.limits:
            for mode in PROVED:
                key = f"{mode} {limit:g}"
                if key in found["distance"]:
                    continue
                found["distance"][key] = row = distance(mesh, mode, limit)
                store()
                said = "violated" if is_violated(row, limit) else ""
                print(name, key, row, said, file=sys.stderr, flush=True)
    print_tables(results)


if __name__ == "__main__":
    main()
