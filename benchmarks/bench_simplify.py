"""Simplification compared with peers: time, memory and all measures, same inputs and targets.

``python benchmarks/bench_simplify.py [--models ...] [--peers ...] [--rounds N] -o results.json``

Each run is a process of its own, pinned to one core. A round runs every peer once, so that a slower
phase of the machine affects all peers; ratios compare times of the same rounds.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import models
import tables
from manip3d import Mesh, metrics
from measuring import environment
from peers import PEERS
from running import run_peer

TIMEOUT_S = 600
MAX_SAMPLES = 1_000_000  # largest number of area samples; 10 per face below 100 000 faces
COSTS = ("cpu_s", "wall_s", "base_bytes", "peak_bytes")
Row = dict[str, Any]


def quality(original: Mesh, simplified: Mesh) -> dict[str, Any]:
    """Return all measures of a result; texture measures if both meshes have coordinates."""
    measured: dict[str, Any] = {
        "faces": simplified.num_faces,
        "vertices": simplified.num_vertices,
    }
    for sampling in ("vertex", "area"):
        samples = min(10 * original.num_faces, MAX_SAMPLES) if sampling == "area" else None
        metro = metrics.metro(original, simplified, sampling=sampling, samples=samples)
        measured[f"metro_{sampling}"] = {
            "mean": metro.mean,
            "rms": metro.rms,
            "max": metro.max,
            "backward_mean": metro.backward.mean / metro.diagonal,
        }
    measured["fmpd"] = metrics.fmpd(original, simplified).value
    gap = metrics.boundary_gap(original, simplified)
    if gap.forward is not None:
        measured["boundary_gap"] = gap.forward.mean / gap.diagonal
    measured["cracks"] = gap.cracks
    if original.texcoords is not None and simplified.texcoords is not None:
        measured["texture"] = asdict(metrics.texture_error(original, simplified))
    return measured


def new_row(model: str, mesh: Mesh, target: int, peer: str) -> Row:
    """Return a row without results."""
    return {
        "model": model,
        "input_faces": mesh.num_faces,
        "textured": mesh.texcoords is not None,
        "target": target,
        "peer": peer,
        "keeps_texture": PEERS[peer].texture,
        "placement": PEERS[peer].placement,
        "status": "",
        "load": os.getloadavg()[0],
        **{cost: [] for cost in COSTS},
    }


def compare(model: models.Model, peers: list[str], rounds: int, folder: Path) -> list[Row]:
    """Return one row for each peer on a model."""
    mesh = model.load()
    target = model.target(mesh)
    source = folder / "mesh.pickle"
    source.write_bytes(pickle.dumps(mesh))
    rows = [new_row(model.name, mesh, target, peer) for peer in peers]
    for number in range(rounds):
        for row in rows:
            if row["status"] not in ("", "ok"):
                continue  # a peer that failed once is not run again
            output = folder / f"{row['peer']}.pickle"
            said = run_peer(row["peer"], source, {target: output}, TIMEOUT_S)[0]
            row |= {key: said[key] for key in ("status", "message") if key in said}
            if said["status"] == "ok":
                for cost in COSTS:
                    row[cost].append(said[cost])
        print(f"{time.strftime('%H:%M:%S')} {model.name}: round {number + 1}", file=sys.stderr)
    for row in rows:
        if row["status"] == "ok":
            output = folder / f"{row['peer']}.pickle"
            row |= quality(mesh, pickle.loads(output.read_bytes()))
    return rows


def main() -> None:
    """Run, store, and write the tables of the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--models",
        nargs="*",
        default=list(models.MODELS),
        metavar="MODEL",
        help="none: write the tables of the stored results anew",
    )
    parser.add_argument("--peers", nargs="+", default=list(PEERS), choices=PEERS, metavar="PEER")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, default=Path("results.json"))
    options = parser.parse_args()

    results: dict[str, Any] = {"rows": []}
    if options.output.exists():  # keep the results of models that are not run now
        results = json.loads(options.output.read_text())
    order = list(models.MODELS)
    for name in options.models:
        with tempfile.TemporaryDirectory() as folder:
            rows = compare(models.get(name), options.peers, options.rounds, Path(folder))
        rows += (row for row in results["rows"] if row["model"] != name)
        rows.sort(key=lambda row: order.index(row["model"]))
        results = {"environment": environment(), "rows": rows}
        options.output.write_text(json.dumps(results, indent=1) + "\n")
    tables.write_simplify(results)


if __name__ == "__main__":
    main()
