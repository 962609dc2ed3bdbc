"""The relief on all range scans and RGB-D recordings of the data folder, and an edge collapse.

``python benchmarks/bench_every_depth.py [--inputs ...] [--shares ...]
[--efforts ...] [--frames N] [--alone] [-o every_depth.json]``

Frames of a recording are taken at equal intervals. Faces across depth steps are left out as by
`manip3d depth`, in this package's meshes and in the dense mesh. The peer, an edge collapse,
simplifies the dense mesh to the same number of vertices; its time includes making that mesh.
Everything runs on one core; times are processor times, the minimum of the rounds. Results are
stored after each image and added to those of other images, shares and efforts; `--inputs` without a
name writes the tables of the stored results.

`--alone` runs no peer and measures no errors, only coverage and bridges of all inputs, in half a
minute. These results are not stored but written to a section of their own.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import tables
from bench_relief import error_of, faces_for
from manip3d import InputError, datasets, simplify
from measuring import environment, measure, one_thread
from peers import PEERS

SHARES = (0.1, 0.05, 0.01, 0.005, 0.001)
OURS: dict[str, tuple[dict[str, Any], str]] = {  # options, and name of the peer to compare with
    "live": ({"effort": "live"}, "meshoptimizer subset"),
    "balanced": ({"effort": "balanced"}, "meshoptimizer subset"),
    "balanced, moved": ({"effort": "balanced", "move_points": True}, "meshoptimizer update"),
}
Row = dict[str, Any]


@dataclass(frozen=True)
class Surface:
    """One depth image or scan."""

    name: str
    points: int
    pixels: int
    dense: Callable[[], simplify.DepthMesh]
    relief: Callable[..., simplify.Relief]


def inputs() -> list[str]:
    """Return the available scans and recordings."""
    here = [one.name for one in datasets.registry().values() if datasets.is_here(one)]
    recordings = [name for name in here if _has_frames(name)]
    return [name for name in datasets.scan_names() if datasets.scan_is_here(name)] + recordings


def _has_frames(name: str) -> bool:
    try:
        return bool(datasets.frame_names(name))
    except InputError:
        return False


def surfaces(name: str, frames: int) -> Iterator[Surface]:
    """Yield a scan, or the frames of a recording."""
    if name in datasets.scan_names():
        yield _scan(name)
        return
    names = datasets.frame_names(name)
    for index in np.unique(np.linspace(0, len(names) - 1, min(frames, len(names))).astype(int)):
        yield _image(name, names[index])


def _scan(name: str) -> Surface:
    scan = datasets.load_scan(name)
    points = np.ascontiguousarray(scan.points, np.float32)
    return Surface(
        name,
        int(scan.valid.sum()),
        scan.valid.size,
        lambda: simplify.dense_mesh_grid(points, scan.valid),
        lambda count, **options: simplify.relief_grid(points, scan.valid, count, **options),
    )


def _image(name: str, frame_name: str) -> Surface:
    frame = datasets.load_frame(name, frame_name)
    depth, camera = np.ascontiguousarray(frame.person), frame.intrinsics

    def dense() -> simplify.DepthMesh:
        mesh = simplify.dense_mesh(depth, camera)
        return simplify.cut_depth_steps(mesh, depth, intrinsics=camera)

    def relief(count: int, **options: Any) -> simplify.Relief:
        step = simplify.DEPTH_STEP
        found = simplify.relief(depth, camera, count, depth_step=step, **options)
        return simplify.cut_depth_steps(found, depth)

    return Surface(f"{name} {frame_name}", int(np.count_nonzero(depth)), depth.size, dense, relief)


def compare(
    surface: Surface, shares: Sequence[float], efforts: Sequence[str], rounds: int
) -> list[Row]:
    """Return a row for each share of the points and each set of options."""
    dense = surface.dense().mesh
    meshing = min(measure(surface.dense)[1].cpu_s for _ in range(rounds))
    rows = []
    for share in shares:
        points = max(3, math.ceil(share * surface.points))
        peers: dict[str, Row] = {}
        for how in efforts:
            options, peer_name = OURS[how]
            if peer_name not in peers:
                peers[peer_name] = _peer_row(dense, peer_name, points, meshing, rounds)
            runs = [measure(surface.relief, points, **options) for _ in range(rounds)]
            found, seconds = runs[0][0], min(cost.cpu_s for _, cost in runs)
            row: Row = {"input": surface.name, "share": share, "points": points, "how": how}
            row |= {"pixels": surface.pixels, "vertices": found.num_used, "stop": found.stop}
            row |= {"faces": found.num_faces, "cpu_s": seconds, "peer": peers[peer_name]}
            row |= {"coverage": found.coverage, "bridges": found.bridges}
            rows.append(row | (error_of(dense, found.mesh) if found.num_faces else {}))
    return rows


def alone(surface: Surface, shares: Sequence[float], efforts: Sequence[str]) -> Iterator[Row]:
    """Yield coverage and bridges of this package's meshes, at each share of the points."""
    for share in shares:
        for how in efforts:
            found = surface.relief(max(3, math.ceil(share * surface.points)), **OURS[how][0])
            row: Row = {"input": surface.name, "share": share, "how": how, "faces": found.num_faces}
            yield row | {"coverage": found.coverage, "bridges": found.bridges}


def _peer_row(dense: Any, name: str, points: int, meshing: float, rounds: int) -> Row:
    peer = PEERS[name]
    faces = faces_for(peer, dense, points)
    runs = [peer.measured(dense, faces) for _ in range(rounds)]
    mesh, seconds = runs[0][0], min(cost.cpu_s for _, cost in runs)
    row: Row = {"vertices": len(np.unique(mesh.faces)), "faces": mesh.num_faces}
    row |= {"cpu_s": meshing + seconds}
    return row | (error_of(dense, mesh) if mesh.num_faces else {})


def _key(row: Row) -> tuple[str, float, str]:
    return row["input"], row["share"], row["how"]


def main() -> None:
    """Run, store, and write the section `every_depth` of the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    known = inputs()
    parser.add_argument("--inputs", nargs="*", default=known, choices=known, metavar="INPUT")
    parser.add_argument("--shares", nargs="*", type=float, default=SHARES, choices=SHARES)
    parser.add_argument("--efforts", nargs="*", default=list(OURS), choices=OURS)
    parser.add_argument("--frames", type=int, default=2, help="of each recording")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--alone", action="store_true", help="without peers and errors")
    parser.add_argument("-o", "--output", type=Path, default=Path("every_depth.json"))
    arguments = parser.parse_args()
    if arguments.alone:
        images = [image for name in arguments.inputs for image in surfaces(name, arguments.frames)]
        efforts = [how for how in arguments.efforts if how != "balanced, moved"]  # as without moves
        tables.write_every_coverage(
            [row for image in images for row in alone(image, arguments.shares, efforts)]
        )
        return
    results: dict[str, Any] = {"environment": environment(), "rows": []}
    if arguments.output.exists():
        results = json.loads(arguments.output.read_text())
    one_thread()
    for name in arguments.inputs:
        for surface in surfaces(name, arguments.frames):
            rows = compare(surface, arguments.shares, arguments.efforts, arguments.rounds)
            again = {_key(row) for row in rows}
            kept = [row for row in results["rows"] if _key(row) not in again]
            results = {"environment": environment(), "rows": kept + rows}
            arguments.output.write_text(json.dumps(results, indent=1) + "\n")
            print(f"{time.strftime('%H:%M:%S')} {surface.name}", file=sys.stderr, flush=True)
    tables.write_every_depth(results)


if __name__ == "__main__":
    main()
