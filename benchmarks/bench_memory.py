"""Simplification with and without a memory limit.

``python benchmarks/bench_memory.py [--faces N] [--modes MODE ...] [--ceilings MIB ...]``

Each run is a process of its own on one core, which simplifies a relief lattice (`bench_growth.py`)
to 10 % of its faces. The peak is that of the whole process during the call, including the mesh
(making the mesh needs more). Errors are measured in another process, by area samples against the
original.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import tables
from bench_growth import RATIO, relief_lattice
from manip3d import metrics, read_mesh, simplify
from measuring import measure, one_thread

SAMPLES = 200_000


def run(mode: simplify.Mode, num_faces: int, mebibytes: int, output: Path) -> dict[str, Any]:
    """Simplify in this process; 0 MiB: without a limit."""
    mesh = relief_lattice(num_faces)
    memory = mebibytes * tables.MIB if mebibytes else None
    target = int(RATIO * mesh.num_faces)
    result, cost = measure(simplify.simplify, mesh, mode, target_faces=target, memory=memory)
    result.mesh.write(output)
    left = result.mesh.num_faces
    return {"target": target, "left": left, "cpu_s": cost.cpu_s, "peak": cost.peak_bytes}


def errors(num_faces: int, output: Path) -> dict[str, Any]:
    """Return the distances of the original from the result."""
    metro = metrics.metro(
        relief_lattice(num_faces), read_mesh(output), sampling="area", samples=SAMPLES
    )
    return {"mean": metro.mean, "max": metro.max}


def main() -> None:
    """Run, and print a row for each mode and memory limit."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--faces", type=int, default=5_000_000)
    parser.add_argument("--modes", nargs="+", default=["fast", "quality"])
    parser.add_argument("--ceilings", nargs="+", type=int, default=[0, 1024, 512], metavar="MIB")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--errors", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    one_thread()
    if options.one:
        print(json.dumps(run(options.modes[0], options.faces, options.ceilings[0], options.one)))
        return
    if options.errors:
        print(json.dumps(errors(options.faces, options.errors)))
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        output = str(Path(folder, "few.ply"))
        for mode in options.modes:
            for ceiling in options.ceilings:
                command = [sys.executable, __file__, "--faces", str(options.faces)]
                task = ["--modes", mode, "--ceilings", str(ceiling), "--one", output]
                row: dict[str, Any] = {}
                for extra in (task, ["--errors", output]):
                    done = subprocess.run(
                        [*command, *extra], check=True, stdout=subprocess.PIPE, text=True
                    )
                    row |= json.loads(done.stdout)
                rows.append(
                    (mode, f"{ceiling or '–'}", f"{row['peak'] / tables.MIB:,.0f}",
                     f"{row['left']:,} / {row['target']:,}", f"{row['cpu_s']:.0f}",
                     f"{1e3 * row['mean']:.4f}", f"{1e3 * row['max']:.3f}")
                )  # fmt: skip
                print(rows[-1], file=sys.stderr)
    head = ("mode", "ceiling, MiB", "peak, MiB", "faces / target", "s", "`area`, 1e-3", "max, 1e-3")
    print(tables.table(head, rows))


if __name__ == "__main__":
    main()
