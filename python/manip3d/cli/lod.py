"""``manip3d lod``: write levels of detail of a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import MISSED, Force, Json, Output, Quiet, Strict
from manip3d.cli.simplify import (
    ColorWeight,
    LockBoundary,
    LockBox,
    Method,
    Mode,
    NoClean,
    color_options,
    expect_cleaning,
    expect_locks,
    expect_surface,
    locks,
    scene_locks,
)
from manip3d.cli.sources import open_scene_or_mesh
from manip3d.cli.terminal import Terminal, check_output, counted, naming_options, table
from manip3d.errors import InputError
from manip3d.io import READABLE, Scene
from manip3d.io._lods import is_file_of_lods

SUFFIXES = (".glb", ".gltf")


@over_files(lambda: READABLE, writable=lambda: SUFFIXES, otherwise=".glb")
def lod(
    source: Annotated[
        str,
        typer.Argument(
            help="A mesh (.obj, .ply, .off, .stl, .gltf, .glb, .3mf, .dae), or - for stdin."
        ),
    ],
    output: Output,
    levels: Annotated[
        int, typer.Option(min=2, help="Number of levels, the mesh itself included.")
    ] = 4,
    ratio: Annotated[
        float,
        typer.Option(help="Faces of a level divided by those of the level before, 0 to 1."),
    ] = 0.5,
    max_vertices: Annotated[
        int | None,
        typer.Option(
            min=3,
            help="Largest number of vertices of a primitive; with 65535, indices fit in 16 bits.",
        ),
    ] = None,
    quantize: Annotated[
        bool,
        typer.Option(
            "--quantize",
            help="Store positions and texture coordinates in 16 bits and normals in 8, for readers "
            "that support KHR_mesh_quantization. The step of positions is a power of two, at most "
            "1/32767 of the longest side; tiles with the same step still meet.",
        ),
    ] = False,
    mode: Annotated[
        Mode | None,
        typer.Option(
            help="Method: quality (a run for each level, with the least error), fast (a quick run "
            "for each level) or published (all levels from one run, with vertices of the input).",
            show_default="quality",
        ),
    ] = None,
    method: Annotated[
        Method | None,
        typer.Option(
            help="Method of the dissertation, chapter 2; implies --mode published. Without it that "
            "mode uses qem4vr."
        ),
    ] = None,
    lock_box: LockBox = None,
    lock_boundary: LockBoundary = False,
    color_weight: ColorWeight = None,
    no_clean: NoClean = False,
    force: Force = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write levels of detail of a mesh.

    An output that ends in .glb or .gltf holds all levels (MSFT_lod); a folder's name without a
    suffix gives one .glb for each, and lods.json. Several meshes become one .glb each in a folder.
    A glTF file keeps its nodes and the appearance of its materials: each mesh has its own levels.

    Example: manip3d lod head.obj -o head.glb --levels 4
    """
    from manip3d import simplify

    shell = Terminal(as_json=as_json, quiet=quiet)
    if mode not in (None, Mode.published) and method is not None:
        raise InputError(f"--method {method}: expected --mode published, got {mode}")
    expect_kind(source, "mesh", verb="lod")
    check_output(output, SUFFIXES, force=force, folder=True, is_ours=is_file_of_lods)
    chosen = str(method or (Method.qem4vr if mode == Mode.published else mode or Mode.quality))
    expect_cleaning(chosen, no_clean)
    expect_locks(chosen, lock_box, lock_boundary)
    options = color_options(chosen, color_weight)
    opened = open_scene_or_mesh(source, output, shell)
    chain: simplify.SceneLods | simplify.LodChain
    if isinstance(opened.thing, Scene):
        scene = opened.thing
        locked = scene_locks(scene, lock_box, lock_boundary, shell)
        with shell.progress("lod") as progress, naming_options("levels", "ratio"):
            chain = simplify.scene_lods(
                scene,
                levels,
                ratio=ratio,
                method=chosen,
                cleaned=not no_clean,
                options=options,
                progress=progress,
                **locked,
            )
    else:
        mesh = opened.thing
        cleaned = mesh if no_clean else simplify.clean(mesh).mesh
        expect_surface(source, mesh, cleaned)
        options |= locks(cleaned, lock_box, lock_boundary, shell)
        with shell.progress("lod") as progress, naming_options("levels", "ratio"):
            chain = simplify.lod_chain(
                cleaned, levels, ratio=ratio, method=chosen, options=options, progress=progress
            )
    with naming_options("output", path="output"):
        chain.write(output, max_vertices=max_vertices, quantize=quantize)
    record = _record(source, output, chain) | {"nodes_lost": opened.nodes_lost}
    rows = [
        (str(i), str(level["faces"]), f"{level['max_error']:.3g}")
        for i, level in enumerate(record["levels"])
    ]
    if len(chain.levels) < levels:
        shell.warn(f"no more than {counted(len(chain.levels), 'level')} could be made")
    shell.result(record, lambda console: table(console, rows, ("level", "faces", "largest error")))
    shell.say(f"wrote {output}")
    if strict and len(chain.levels) < levels:
        raise typer.Exit(MISSED)


def _record(source: str, output: Path, chain: Any) -> dict[str, Any]:
    return {
        "input": source,
        "output": str(output),
        "stop": str(chain.result.stop),
        "error_measure": chain.error_measure,
        "levels": [
            {"faces": level.num_faces, "max_error": level.max_error} for level in chain.levels
        ],
    }
