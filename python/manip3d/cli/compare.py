"""``manip3d compare``: measure the distance of a mesh from its original."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import Jobs, Json, Quiet, Seed
from manip3d.cli.sources import open_mesh
from manip3d.cli.terminal import Terminal, count, expect_named, table
from manip3d.errors import InputError
from manip3d.io import READABLE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rich.console import Console

    from manip3d.batch import SourceFile
    from manip3d.metrics import Comparison


def _originals(files: list[SourceFile], options: dict[str, Any]) -> dict[str, dict[str, str]]:
    """Return the original of each file: the same for all, or by name in a folder of originals.

    A file's name may include the suffix of its original: head.obj.glb belongs to head.obj, not to
    head.ply.
    """
    from manip3d.batch import find_files, is_folder

    original = options.pop("original")
    if not is_folder(original):
        return {file.name: {"original": original} for file in files}
    known = find_files(original, suffixes=READABLE)
    return {
        file.name: {"original": _original_of(file.name, file.relative, original, known)}
        for file in files
    }


def _original_of(name: str, relative: str, folder: str, known: list[SourceFile]) -> str:
    """Return the original of the file ``name`` in a folder, with the name ``relative`` to it."""
    exact, folded = _by_name(known, str), _by_name(known, str.lower)
    stem = _stem(_plain(relative))
    named = exact.get(stem) or folded.get(stem.lower(), [])
    if len(named) != 1:
        found = " and ".join(named[:2]) or "none"
        raise InputError(f"{folder}: expected one original of {name}, by its name; found {found}")
    return named[0]


def _check_original(options: Mapping[str, Any]) -> None:
    """Refuse an original that cannot be that of several meshes."""
    expect_named("original", options["original"])
    if options["original"] == "-":
        raise InputError("original: expected a file or a folder for several meshes, got stdin")


def _by_name(files: list[SourceFile], case: Callable[[str], str]) -> dict[str, list[str]]:
    """The files by their names with and without the suffix, in the given case."""
    known: dict[str, list[str]] = {}
    for file in files:
        name = case(_plain(file.relative))
        for one in (name, _stem(name)):
            known.setdefault(one, []).append(file.name)
    return known


def _stem(relative: str) -> str:
    return relative.removesuffix(PurePosixPath(relative).suffix)


def _plain(relative: str) -> str:
    """The name without the suffix of a compressed file."""
    packed = PurePosixPath(relative).suffix.lower() in (".xz", ".gz")
    return _stem(relative) if packed else relative


@over_files(lambda: READABLE, argument="simplified", prepare=_originals, check=_check_original)
def compare(
    original: Annotated[
        str,
        typer.Argument(
            metavar="ORIGINAL",
            help="The original mesh (.obj, .ply, .off, .stl, .gltf, .glb, .3mf, .dae), or a folder "
            "with an original of the same name for each mesh.",
        ),
    ],
    simplified: Annotated[str, typer.Argument(help="The mesh that is compared with it.")],
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
    seed: Seed = 0,
) -> None:
    """Measure how far a mesh is from its original.

    Prints Metro (distances, in both directions), texture error, colour error (of vertices), FMPD
    (perceptual) and boundary gaps. Several meshes make a table: printed, or written with --table.

    Example: manip3d compare head.obj light.glb
    """
    from manip3d import metrics
    from manip3d.batch import find_files, is_folder

    if original == simplified == "-":
        raise typer.BadParameter("stdin holds one mesh: name a file for the other", param_hint="-")
    expect_named("original", original)
    if is_folder(original):
        known = find_files(original, suffixes=READABLE)
        original = _original_of(simplified, PurePosixPath(simplified).name, original, known)
    for source in (original, simplified):
        expect_kind(source, "mesh", verb="compare")
    shell = Terminal(as_json=as_json, quiet=quiet)
    first, second = open_mesh(original, shell), open_mesh(simplified, shell)
    with shell.progress("compare") as progress:
        found = metrics.compare(first, second, rng=seed, threads=jobs, progress=progress)
    shell.result(
        {"original": original, "simplified": simplified, "seed": seed} | _record(found),
        lambda console: show(console, found),
    )


def _record(found: Comparison) -> dict[str, Any]:
    """Return the measures for ``--json``."""
    record: dict[str, Any] = {
        "faces": list(found.faces),
        "metro": {"vertex": asdict(found.metro_vertex), "area": asdict(found.metro_area)},
    }
    if found.texture_error is not None:
        record["texture_error"] = asdict(found.texture_error)
    if found.color_error is not None:
        record["color_error"] = asdict(found.color_error)
    record["fmpd"] = asdict(found.fmpd)
    record["boundary_gap"] = asdict(found.boundary_gap)
    return record


_DIRECTIONS = (
    ("forward", "original to simplified"),
    ("backward", "simplified to original"),
)


def show(console: Console, found: Comparison) -> None:
    """Print the measures as two small tables."""
    diagonal = found.metro_vertex.diagonal
    rows = [
        _statistics(f"Metro, {sampling}, {words}", asdict(getattr(result, direction)), diagonal)
        for sampling, result in (
            ("vertices", found.metro_vertex),
            ("area samples", found.metro_area),
        )
        for direction, words in _DIRECTIONS
    ]
    gaps = asdict(found.boundary_gap)
    rows += [
        _statistics(f"boundary gap, {words}", gaps[direction], diagonal)
        for direction, words in _DIRECTIONS
        if gaps[direction] is not None
    ]
    table(console, rows, ("1e-3 of the original's diagonal", "mean", "RMS", "max"))
    values = [
        ("diagonal, units of the file", f"{diagonal:.6g}"),
        ("FMPD", f"{found.fmpd.value:.4f}"),
        ("cracks", count(found.boundary_gap.cracks)),
    ]
    texture = found.texture_error
    if texture is not None and texture.mean is not None:
        values += [
            (f"texture error, {name}", f"{getattr(texture, name):.6f}")
            for name in ("mean", "rms", "max")
        ]
        values.append(("material mismatches", f"{texture.material_mismatch_rate:.2%}"))
        if texture.outside_charts is not None:
            values.append(("texture outside all charts", f"{texture.outside_charts:.2%}"))
    color = found.color_error
    if color is not None:
        values += [
            (f"colour error, {name}, levels of 255", f"{getattr(color, name):.2f}")
            for name in ("mean", "rms", "max")
        ]
    console.print()
    table(console, values)
    console.print(
        "\nThe published Metro is the mean of 'vertices, original to simplified'. PyMeshLab's "
        "get_hausdorff_distance\nwith samplevert=True alone gives that row in units of the file: "
        "multiply by the diagonal / 1000."
    )


def _statistics(name: str, deviation: dict[str, float], diagonal: float) -> tuple[str, ...]:
    values = (deviation[key] / diagonal * 1e3 for key in ("mean", "rms", "max"))
    return (name, *(f"{value:.4f}" for value in values))
