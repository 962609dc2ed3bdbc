"""Closest points on a surface compared with Open3D's ray casting scene (Embree), one thread.

``python benchmarks/bench_metrics.py [--rounds N]`` writes the section `closest` of the results.
"""

from __future__ import annotations

import argparse
import importlib
import statistics
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from measuring import measure, one_thread

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from manip3d import Mesh

    Distances = Callable[[Mesh, NDArray[np.float64]], NDArray[np.float64]]

MODELS = (("rockerArm", 8174), ("ferrari_458", 35878))


def by_manip3d(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances of points to the mesh; the time includes building the tree."""
    from manip3d import metrics

    return metrics.closest_points(mesh, points, threads=1).distance


def by_open3d() -> Distances | None:
    """Return Open3D's distances; None if it is not installed."""
    import numpy as np

    try:
        open3d = importlib.import_module("open3d")
    except ImportError:
        return None

    def distances(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
        scene = open3d.t.geometry.RaycastingScene(nthreads=1)
        scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
        closest = scene.compute_closest_points(points.astype(np.float32), nthreads=1)["points"]
        found: NDArray[np.float64] = np.linalg.norm(closest.numpy() - points, axis=1)
        return found

    return distances


def compare(name: str, target: int, rounds: int, other: Distances | None) -> list[str]:
    """Return a row of times for distances from a model's vertices to its simplification."""
    from manip3d import datasets, simplify

    original = datasets.load_mesh(name)
    simplified = simplify.qem4vr(original, target_faces=target).mesh
    points = original.vertices
    seconds: dict[Any, list[float]] = {by_manip3d: [], other: []}
    distance: dict[Any, NDArray[np.float64]] = {}
    for _ in range(rounds):
        for distances in filter(None, (by_manip3d, other)):
            distance[distances], cost = measure(distances, simplified, points)
            seconds[distances].append(cost.cpu_s)
    own = statistics.median(seconds[by_manip3d])
    row = [f"{name}, {len(points):,} points, {simplified.num_faces:,} faces", f"{1e3 * own:.0f}"]
    if other is None:
        return [*row, "not installed", "–", "–"]
    theirs = statistics.median(seconds[other])
    difference = abs(distance[by_manip3d] - distance[other]).max() / original.diagonal
    return [*row, f"{1e3 * theirs:.0f}", f"{theirs / own:.2f}", f"{difference:.1e}"]


def main() -> None:
    """Measure and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    one_thread()  # must run before any library counts the cores
    import tables

    other = by_open3d()
    head = [
        "closest points, tree built anew", "manip3d, ms (double)", "Open3D, ms (float)",
        "Open3D / manip3d", "largest difference / diagonal",
    ]  # fmt: skip
    body = [compare(name, target, rounds, other) for name, target in MODELS]
    tables.write_section("closest", tables.table(head, body))


if __name__ == "__main__":
    main()
