"""Growth of time and memory of simplification from 10 thousand to 10 million faces.

``python benchmarks/bench_growth.py [--faces N ...] [--modes MODE ...] [-o growth.json]``

Each run is a process of its own on one core. The mesh is a relief lattice (eight octaves of smooth
waves, whose amplitude is halved with the wavelength), simplified to 10 % of its faces. Stored
results of other sizes and modes are kept.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import tables
from manip3d import Mesh, simplify
from measuring import environment, measure, one_thread

SIZES = (10_000, 100_000, 1_000_000, 10_000_000)
MODES = ("fast", "quality", "published")
RATIO = 0.1
Row = dict[str, Any]


def relief_lattice(num_faces: int) -> Mesh:
    """Return an open relief of about ``num_faces`` faces, equally rough at all scales."""
    side = round(math.sqrt(num_faces / 2))
    place = np.linspace(0.0, 1.0, side + 1)
    x, y = np.meshgrid(place, place)
    height = np.zeros_like(x)
    rng = np.random.default_rng(20_26)
    for octave in range(8):
        for angle, phase in rng.uniform(0.0, 2.0 * np.pi, (4, 2)):
            wave = 2.0 * np.pi * 2**octave * (x * np.cos(angle) + y * np.sin(angle)) + phase
            height += 0.03 * 0.5**octave * np.sin(wave)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1)
    quads = np.stack([corner, corner + 1, corner + side + 2, corner + side + 1], axis=1)
    faces = quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)
    return Mesh(np.stack([x, y, height], axis=-1).reshape(-1, 3), faces)


def run(mode: simplify.Mode, num_faces: int) -> Row:
    """Simplify in this process, and return the cost."""
    mesh = relief_lattice(num_faces)
    target = int(RATIO * mesh.num_faces)
    result, cost = measure(simplify.simplify, mesh, mode, target_faces=target)
    return {
        "mode": mode,
        "faces": mesh.num_faces,
        "vertices": mesh.num_vertices,
        "target": target,
        "reached": result.mesh.num_faces,
        "input_bytes": mesh.vertices.nbytes + mesh.faces.nbytes,
        **asdict(cost),
    }


def growth(rows: list[Row]) -> str:
    """Return the table of times and memory, and of their growth."""
    lines = []
    for mode in MODES:
        own = sorted((row for row in rows if row["mode"] == mode), key=lambda row: row["faces"])
        for before, row in zip([None, *own], own, strict=False):
            bytes_each = (row["peak_bytes"] - row["base_bytes"]) / row["faces"]
            power = "–"
            if before is not None:
                larger = math.log(row["faces"] / before["faces"])
                power = f"{math.log(row['cpu_s'] / before['cpu_s']) / larger:.2f}"
            unit = row["cpu_s"] / (row["faces"] * math.log2(row["faces"]))
            lines.append(
                (
                    mode,
                    f"{row['faces']:,}",
                    f"{row['reached']:,}",
                    tables.number(row["cpu_s"]),
                    f"{1e9 * unit:.1f}",
                    power,
                    f"{row['peak_bytes'] / tables.MIB:,.0f}",
                    f"{bytes_each:.0f}",
                )
            )
    head = ("mode", "faces", "left", "s", "ns / (n log2 n)", "power of n", "MiB of the process",
            "bytes a face for the call")  # fmt: skip
    return tables.table(head, lines)


def figure(rows: list[Row], path: Path) -> None:
    """Draw time and memory over the number of faces n, with n log n for comparison."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(9.0, 3.6), layout="constrained")
    time_axes, memory_axes = drawn.subplots(1, 2)
    for mode in MODES:
        own = sorted((row for row in rows if row["mode"] == mode), key=lambda row: row["faces"])
        if not own:
            continue
        n = np.array([row["faces"] for row in own], dtype=float)
        (line,) = time_axes.loglog(n, [row["cpu_s"] for row in own], "o-", label=mode)
        bound = own[0]["cpu_s"] * n * np.log2(n) / (n[0] * np.log2(n[0]))
        time_axes.loglog(n, bound, ":", color=line.get_color())
        used = [(row["peak_bytes"] - row["base_bytes"]) / 2**30 for row in own]
        memory_axes.loglog(n, used, "o-", label=mode)
    time_axes.set(xlabel="faces", ylabel="processor time, s", title="dotted: n log n")
    memory_axes.set(xlabel="faces", ylabel="memory of the call, GiB")
    time_axes.legend()
    drawn.savefig(path, dpi=120)


def main() -> None:
    """Run, store, and write the section `growth` of the results."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--faces", nargs="*", type=int, default=list(SIZES), metavar="N")
    parser.add_argument("--modes", nargs="+", default=list(MODES), choices=MODES)
    parser.add_argument("-o", "--output", type=Path, default=Path("growth.json"))
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    one_thread()
    if options.one:
        print(json.dumps(run(options.modes[0], options.faces[0])))
        return
    results: dict[str, Any] = {"rows": []}
    if options.output.exists():
        results = json.loads(options.output.read_text())
    for num_faces in options.faces:
        for mode in options.modes:
            command = [sys.executable, __file__, "--one", "--faces", str(num_faces)]
            done = subprocess.run([*command, "--modes", mode], check=True, stdout=subprocess.PIPE)
            row = json.loads(done.stdout)
            kept = [
                old
                for old in results["rows"]
                if (old["mode"], old["faces"]) != (mode, row["faces"])
            ]
            results = {"environment": environment(), "rows": [*kept, row]}
            options.output.write_text(json.dumps(results, indent=1) + "\n")
            print(f"{mode}, {row['faces']:,} faces: {row['cpu_s']:.1f} s", file=sys.stderr)
    figure(results["rows"], options.output.with_suffix(".png"))
    text = growth(results["rows"]) + "\n" + tables.environment_line(results["environment"])
    tables.write_section("growth", text)


if __name__ == "__main__":
    main()
