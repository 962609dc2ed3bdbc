"""The default mode and all peers on all meshes of the data folder, at four numbers of faces.

``python benchmarks/bench_every_mesh.py [--meshes ...] [--peers ...] -o every_mesh.json``

All methods get the mesh welded and without exact duplicates; targets are fractions of the number
of faces as read. Each peer runs in one process per mesh, pinned to one core. Stored results of
other meshes and peers are kept, so that after a change of manip3d only its own rows need to run. As
long as some mesh or peer has no row in them, the tables are printed and the page stays as it is.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import models
import tables
from manip3d import Mesh, metrics, simplify
from measuring import environment, one_thread
from peers import PEERS
from running import run_peer

RATIOS = (0.5, 0.1, 0.02, 0.005)
MAX_SAMPLES = 300_000  # largest number of area samples; 10 per face below 30 000 faces
Row = dict[str, Any]


def errors(original: Mesh, simplified: Mesh, *, has_uv: bool) -> Row:
    """Return Metro of area samples in both directions, texture error and boundary gap."""
    if simplified.num_faces == 0:
        return {"faces": 0}
    samples = min(10 * original.num_faces, MAX_SAMPLES)
    metro = metrics.metro(original, simplified, sampling="area", samples=samples)
    measured: Row = {
        "faces": simplified.num_faces,
        "area": metro.mean,
        "area_max": metro.max,
        "area_back": metro.backward.mean / metro.diagonal,
    }
    if has_uv and simplified.texcoords is not None:
        measured["texture"] = metrics.texture_error(original, simplified, samples=samples).mean
    gap = metrics.boundary_gap(original, simplified)
    if gap.forward is not None:
        measured["boundary_gap"] = gap.forward.mean / gap.diagonal
    return measured


def compare(name: str, peers: list[str], timeout_s: float) -> list[Row]:
    """Return a row for each peer and number of faces."""
    read = models.every_mesh()[name]()
    mesh = simplify.clean(read).mesh
    has_uv = mesh.texcoords is not None
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder, "mesh.pickle")
        source.write_bytes(pickle.dumps(mesh))
        for peer in peers:
            targets = {ratio: int(ratio * read.num_faces) for ratio in RATIOS}
            outputs = {target: Path(folder, f"{target}.pickle") for target in targets.values()}
            said = run_peer(peer, source, outputs, timeout_s)
            for (ratio, target), row in zip(targets.items(), said, strict=True):
                row |= {"mesh": name, "input_faces": read.num_faces, "has_uv": has_uv}
                row |= {"ratio": ratio, "target": target, "peer": peer}
                row |= {"keeps_uv": PEERS[peer].texture}
                if row["status"] == "ok":
                    result = pickle.loads(outputs[target].read_bytes())
                    row |= errors(mesh, result, has_uv=has_uv and PEERS[peer].texture)
                rows.append(row)
            print(f"{time.strftime('%H:%M:%S')} {name}: {peer}", file=sys.stderr, flush=True)
    return rows


def main() -> None:
    """Run, store, and write the section `every_mesh` of the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--meshes",
        nargs="*",
        metavar="MESH",
        help="none: write the tables of the stored results anew",
    )
    parser.add_argument("--peers", nargs="+", default=list(tables.EVERY_MESH_PEERS), choices=PEERS)
    parser.add_argument("--timeout", type=float, default=600.0, metavar="S")
    parser.add_argument("-o", "--output", type=Path, default=Path("every_mesh.json"))
    options = parser.parse_args()
    names = list(models.every_mesh()) if options.meshes is None else options.meshes

    results: dict[str, Any] = {"environment": environment(), "rows": []}
    if options.output.exists():
        results = json.loads(options.output.read_text())
    one_thread()
    for name in names:
        rows = compare(name, options.peers, options.timeout)
        new = {(row["mesh"], row["peer"]) for row in rows}
        kept = [row for row in results["rows"] if (row["mesh"], row["peer"]) not in new]
        results = {"environment": environment(), "rows": kept + rows}
        options.output.write_text(json.dumps(results, indent=1) + "\n")
    if missing := tables.missing_of_every_mesh(results, models.names_of_every_mesh()):
        print(tables.every_mesh(results))
        print(f"not written to the page: no complete rows of {', '.join(missing)}", file=sys.stderr)
        return
    tables.write_every_mesh(results)


if __name__ == "__main__":
    main()
