"""Check the promises of every simplification on all meshes of the data folder.

``python benchmarks/bench_promises.py [--meshes ...] [--runs N]``

The same bytes: each mode simplifies to a tenth, N times with one thread and N times with two, each
number of threads in a process of its own. The distance: `max_distance` of 1e-2, 1e-3 and 1e-4 of
the diagonal, held against the vertices, the middles of the edges and random points of both meshes,
which bound it from below; a violation is a bound above the limit, or a point farther away than the
bound by more than 1e-6 of the diagonal.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import time
from typing import get_args

import numpy as np
from numpy.typing import NDArray

import models
import tables
from manip3d import Mesh, metrics, simplify

RATIO = 0.1
LIMITS = (1e-2, 1e-3, 1e-4)
MOST_SAMPLES = 10_000_000  # 100 a face below 100 000 faces
TOLERANCE = 1e-6
PROVED: tuple[simplify.Mode, ...] = ("published", "quality")  # `fast` takes no max_distance


def digest(mesh: Mesh) -> str:
    """A hash of all arrays of a mesh."""
    state = hashlib.sha256()
    for name in ("vertices", "faces", "texcoords", "face_texcoords", "normals", "face_normals",
                 "colors", "face_material"):  # fmt: skip
        array = getattr(mesh, name)
        state.update(name.encode() if array is None else np.ascontiguousarray(array).tobytes())
    return state.hexdigest()


def digests(mesh: Mesh, runs: int) -> dict[str, list[str]]:
    """Return for each mode the different results of so many runs."""
    return {
        mode: sorted({digest(simplify.simplify(mesh, mode, ratio=RATIO).mesh) for _ in range(runs)})
        for mode in get_args(simplify.Mode)
    }


def points_of(mesh: Mesh, rng: np.random.Generator) -> NDArray[np.float64]:
    """Vertices, middles of edges, and random points of each face."""
    corners = mesh.vertices[mesh.faces]
    per_face = max(1, min(100, MOST_SAMPLES // max(1, len(corners))))
    weights = rng.dirichlet([1, 1, 1], size=(len(corners), per_face))
    inside = np.einsum("fsk,fkd->fsd", weights, corners).reshape(-1, 3)
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3)
    return np.concatenate([corners.reshape(-1, 3), middles, inside])


def distances(mesh: Mesh, mode: simplify.Mode) -> list[dict[str, float]]:
    """For each limit: faces left, the bound that was promised and the largest sampled distance."""
    rows = []
    for limit in LIMITS:
        start = time.process_time()
        result = simplify.simplify(mesh, mode, max_distance=limit * mesh.diagonal)
        seconds = time.process_time() - start
        rng = np.random.default_rng(1)
        there = metrics.closest_points(result.mesh, points_of(mesh, rng)).distance.max()
        back = metrics.closest_points(mesh, points_of(result.mesh, rng)).distance.max()
        rows.append(
            {
                "limit": limit,
                "faces": result.mesh.num_faces,
                "bound": float(result.distance_bound or 0.0) / mesh.diagonal,
                "sampled": float(max(there, back)) / mesh.diagonal,
                "cpu_s": seconds,
            }
        )
    return rows


def with_threads(name: str, runs: int, threads: int) -> dict[str, list[str]]:
    """The digests of a process that uses so many threads."""
    done = subprocess.run(
        [sys.executable, __file__, "--digests", name, "--runs", str(runs)],
        env=os.environ | {"MANIP3D_THREADS": str(threads)},
        check=True, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    found: dict[str, list[str]] = json.loads(done.stdout)
    return found


def main() -> None:
    """Run, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--meshes", nargs="+", default=list(models.every_mesh()), metavar="MESH")
    parser.add_argument("--runs", type=int, default=20, metavar="N")
    parser.add_argument("--digests", metavar="MESH", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.digests:
        mesh = simplify.clean(models.every_mesh()[options.digests]()).mesh
        print(json.dumps(digests(mesh, options.runs)))
        return
    same: list[tuple[str, ...]] = []
    rows: list[tuple[str, ...]] = []
    num_violations = 0
    for name in options.meshes:
        mesh = simplify.clean(models.every_mesh()[name]()).mesh
        if options.runs > 0:
            one, two = (with_threads(name, options.runs, threads) for threads in (1, 2))
            same.append((name, *(str(len({*one[mode], *two[mode]})) for mode in one)))
        for mode in PROVED:
            for row in distances(mesh, mode):
                bad = row["bound"] > row["limit"] or row["sampled"] > row["bound"] + TOLERANCE
                num_violations += bad
                rows.append(
                    (name, mode, f"{row['limit']:g}", f"{mesh.num_faces:,} / {row['faces']:,}",
                     f"{row['bound'] / row['limit']:.3f}", f"{row['sampled'] / row['limit']:.3f}",
                     f"{row['cpu_s']:.1f}")
                )  # fmt: skip
                print(rows[-1], "violated" if bad else "", file=sys.stderr, flush=True)
    if same:
        print(tables.table(("mesh: different results", *get_args(simplify.Mode)), same), "\n")
    head = ("mesh", "mode", "limit", "faces: before / after", "bound / limit", "sampled / limit",
            "s")  # fmt: skip
    print(tables.table(head, rows))
    print(f"\n{len(rows)} cases, {num_violations} violations")


if __name__ == "__main__":
    main()
