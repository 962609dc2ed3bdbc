"""``manip3d compare``: how far one mesh is from another."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.options import Jobs, Json, Quiet, Seed
from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, table

if TYPE_CHECKING:
    from rich.console import Console


def measure(
    original: str, simplified: str, terminal: Terminal, *, threads: int, seed: int
) -> dict[str, Any]:
    """Every measure of ``simplified`` against ``original``."""
    from manip3d import metrics

    first, second = open_mesh(original, terminal), open_mesh(simplified, terminal)
    record: dict[str, Any] = {"original": original, "simplified": simplified}
    record["faces"] = [first.num_faces, second.num_faces]
    record["metro"] = {
        sampling: asdict(metrics.metro(first, second, sampling=sampling, rng=seed, threads=threads))
        for sampling in ("vertex", "area")
    }
    if first.face_texcoords is not None and second.face_texcoords is not None:
        texture = metrics.texture_error(first, second, rng=seed, threads=threads)
        record["texture_error"] = asdict(texture)
    record["fmpd"] = asdict(metrics.fmpd(first, second, threads=threads))
    record["boundary_gap"] = asdict(metrics.boundary_gap(first, second))
    return record


def show(console: Console, record: dict[str, Any]) -> None:
    """The measures as two small tables."""
    gap = record["boundary_gap"]
    rows = [
        _statistics(f"Metro, {sampling} samples, {arrow}", metro[direction], gap["diagonal"])
        for sampling, metro in record["metro"].items()
        for direction, arrow in _DIRECTIONS
    ]
    rows += [
        _statistics(f"boundary gap, {arrow}", gap[direction], gap["diagonal"])
        for direction, arrow in _DIRECTIONS
        if gap[direction] is not None
    ]
    table(console, rows, ("1e-3 of the original's diagonal", "mean", "RMS", "max"))
    values = [("FMPD", f"{record['fmpd']['value']:.4f}"), ("cracks", str(gap["cracks"]))]
    texture = record.get("texture_error")
    if texture and texture["mean"] is not None:
        values += [(f"texture error, {n}", f"{texture[n]:.6f}") for n in ("mean", "rms", "max")]
        values.append(("material mismatches", f"{texture['material_mismatch_rate']:.2%}"))
    console.print()
    table(console, values)


_DIRECTIONS = (("forward", "->"), ("backward", "<-"))


def _statistics(name: str, deviation: dict[str, float], diagonal: float) -> tuple[str, ...]:
    values = (deviation[key] / diagonal * 1e3 for key in ("mean", "rms", "max"))
    return (name, *(f"{value:.4f}" for value in values))


def compare(
    original: Annotated[str, typer.Argument(help="The original mesh.")],
    simplified: Annotated[str, typer.Argument(help="The mesh that is compared with it.")],
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Measure how far a mesh is from the original: Metro, texture error, FMPD, boundary gap."""
    shell = Terminal(as_json=as_json, quiet=quiet)
    record = measure(original, simplified, shell, threads=jobs, seed=seed)
    shell.result(record, lambda console: show(console, record))
