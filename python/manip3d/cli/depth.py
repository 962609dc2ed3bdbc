"""``manip3d cs3``: a depth image, a range scan or a folder of frames to sparse textured meshes."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from manip3d.camera import Intrinsics
from manip3d.cli.options import (
    MISSED,
    FolderJobs,
    Force,
    Json,
    Output,
    Quiet,
    Seed,
    Strict,
)
from manip3d.cli.sources import mesh_suffix
from manip3d.cli.terminal import Terminal, count, refuse_existing
from manip3d.errors import Error, FormatError, InputError, MissingExtraError
from manip3d.io import DEPTH_SUFFIXES, read_depth, read_range_grid, write_mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.simplify import DepthMesh

_YUP_SUFFIXES = (".glb", ".gltf")
_MOST_JSON_BYTES = 1 << 20
# Nominal cameras, their image, and whether the sensor also delivers it at other sizes.
_PRESETS: dict[str, tuple[Intrinsics, bool]] = {
    "kinect-v1": (Intrinsics(640, 480, 585.0, 585.0, 319.5, 239.5), True),
    "kinect-v2": (Intrinsics(512, 424, 365.0, 365.0, 256.0, 212.0), False),
    "primesense": (Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5), True),
}


@dataclass(frozen=True)
class Order:
    """What one reduction is asked for.

    Attributes
    ----------
    points : int
    method : str
        ``cs3``, ``relief``, ``uniform``, ``poisson`` or ``ssa``.
    variant : str
        Of ``cs3``.
    intrinsics : str
        ``fx,fy,cx,cy``, a JSON file, or one of the presets; ``""``: none.
    units_per_metre : float
    max_edge : float or None
    by_distance : bool
    move_points : bool
        Of ``relief``.
    colour : str
        An image, or for a folder of frames a folder of images of the same names; ``""``: none.
    seed : int
    threads : int
    """

    points: int
    method: str = "cs3"
    variant: str = "cios"
    intrinsics: str = ""
    units_per_metre: float = 1000.0
    max_edge: float | None = None
    by_distance: bool = False
    move_points: bool = False
    colour: str = ""
    seed: int = 0
    threads: int = 1

    def __post_init__(self) -> None:
        if self.method != "cs3" and (self.variant != "cios" or self.by_distance):
            raise InputError(
                f"--variant, --by-distance: expected with --method cs3, got {self.method}"
            )
        if self.method != "relief" and self.move_points:
            raise InputError(f"--move-points: expected with --method relief, got {self.method}")


def camera(text: str, rows: int, columns: int) -> Intrinsics:
    """The depth camera that ``--intrinsics`` names, for an image of that size.

    Raises
    ------
    InputError
        No camera, or one of another image size.
    FormatError, OSError
        A JSON file that cannot be read.
    """
    if text.endswith(".json"):
        return _camera_of_file(Path(text), rows, columns)
    if text in _PRESETS:
        nominal, scales = _PRESETS[text]
        if scales and columns * nominal.height == rows * nominal.width:
            return nominal.resized(columns, rows)
        return _fitting(nominal, rows, columns, text)
    fields = text.split(",")
    try:
        fx, fy, cx, cy = (float(field) for field in fields)
    except ValueError:
        raise InputError(
            f"--intrinsics: expected fx,fy,cx,cy, a .json file or one of "
            f"{', '.join(_PRESETS)}, got {text!r}"
        ) from None
    return Intrinsics(columns, rows, fx, fy, cx, cy)


def _fitting(known: Intrinsics, rows: int, columns: int, name: str) -> Intrinsics:
    if (known.height, known.width) != (rows, columns):
        raise InputError(
            f"--intrinsics: {name} is for {known.width} x {known.height} pixels, "
            f"the image has {columns} x {rows}"
        )
    return known


def _camera_of_file(path: Path, rows: int, columns: int) -> Intrinsics:
    """Open3D's camera file, or an object with the fields of `manip3d.Intrinsics`."""
    with path.open("rb") as file:
        data = file.read(_MOST_JSON_BYTES + 1)
    try:
        if len(data) > _MOST_JSON_BYTES:
            raise ValueError("more than a mebibyte")
        fields: Any = json.loads(data)
        if not isinstance(fields, dict):
            raise TypeError("no object")
        matrix = fields.get("intrinsic_matrix")
        if matrix is not None:  # column by column
            fields = {n: fields[n] for n in ("width", "height") if n in fields}
            fields |= dict(zip(("fx", "fy", "cx", "cy"), _pinhole(matrix), strict=True))
        known = Intrinsics(**({"width": columns, "height": rows} | fields))
    except (ValueError, TypeError, RecursionError) as error:
        text = "expected an object with fx, fy, cx and cy, or with Open3D's intrinsic_matrix"
        raise FormatError(f"{text}: {error}", file=str(path)) from error
    return _fitting(known, rows, columns, str(path))


def _pinhole(matrix: Any) -> tuple[float, float, float, float]:
    values = np.asarray(matrix, dtype=np.float64)
    if values.shape != (9,):
        raise ValueError(f"an intrinsic_matrix of shape {values.shape}")
    return float(values[0]), float(values[4]), float(values[6]), float(values[7])


def reduce_file(source: Path, output: Path, order: Order, terminal: Terminal) -> dict[str, Any]:
    """Reduce one depth image or scan, write it, and return what was done."""
    reduce = _reduce_depth if source.suffix.lower() in DEPTH_SUFFIXES else _reduce_scan
    result, measured, is_image, seconds = reduce(source, order, terminal)
    mesh = result.mesh
    if is_image and mesh_suffix(output) in _YUP_SUFFIXES:  # cameras look along +z, y down
        mesh = mesh.replace(vertices=mesh.vertices * np.array([1.0, -1.0, -1.0]))
    write_mesh(mesh, output)
    reached = getattr(result, "reached", None)
    record = {
        "input": str(source),
        "output": str(output),
        "method": order.method,
        "variant": order.variant if order.method == "cs3" else None,
        "points_before": measured,
        "target_points": order.points,
        "points": result.num_vertices,
        "faces": result.num_faces,
        "reached": None if reached is None else str(reached),
        "literal_count": getattr(result, "literal_count", None),
        "seconds": round(seconds, 4),
        "target_missed": result.num_vertices < 0.99 * min(order.points, measured),
    }
    terminal.say(_sentence(record))
    return record


def _reduce_depth(
    source: Path, order: Order, terminal: Terminal
) -> tuple[DepthMesh, int, bool, float]:
    from manip3d import simplify

    depth = read_depth(source, units_per_metre=order.units_per_metre)
    if not order.intrinsics:
        raise InputError("--intrinsics: needed for a depth image, got none")
    intrinsics = camera(order.intrinsics, *depth.shape)
    colour = _colour(order.colour)
    measured = int((depth > 0).sum())
    terminal.say(f"read {source}: {depth.shape[1]} x {depth.shape[0]}, {count(measured)} points")
    options: dict[str, Any] = {"max_edge": order.max_edge, "colour": colour}
    options["threads"] = order.threads
    function: Any
    if order.method == "cs3":
        function = simplify.cs3
        options |= {"variant": order.variant, "distance_dependent": order.by_distance}
    elif order.method == "relief":
        function, options["move_points"] = simplify.relief, order.move_points
    else:
        function = simplify.sample_depth
        options |= {"method": order.method, "rng": order.seed}
    arguments = (depth, intrinsics, order.points)
    return _timed(function, arguments, options, measured, is_image=True)


def _reduce_scan(
    source: Path, order: Order, terminal: Terminal
) -> tuple[DepthMesh, int, bool, float]:
    from manip3d import simplify

    if order.by_distance:
        raise InputError("--by-distance: expected with a depth image, got a scan")
    grid = read_range_grid(source)
    rows, columns = grid.valid.shape
    measured = int(grid.valid.sum())
    terminal.say(f"read {source}: range grid of {columns} x {rows}, {count(measured)} points")
    options: dict[str, Any] = {"max_edge": order.max_edge, "colour": _colour(order.colour)}
    function: Any
    if order.method == "cs3":
        function = simplify.cs3_grid
        options |= {"variant": order.variant, "threads": order.threads}
    elif order.method == "relief":
        function = simplify.relief_grid
        options |= {"move_points": order.move_points, "threads": order.threads}
    else:
        function = simplify.sample_depth_grid
        options |= {"method": order.method, "rng": order.seed}
    return _timed(
        function, (grid.points, grid.valid, order.points), options, measured, is_image=False
    )


def _timed(
    function: Any,
    arguments: tuple[Any, ...],
    options: Mapping[str, Any],
    measured: int,
    *,
    is_image: bool,
) -> tuple[DepthMesh, int, bool, float]:
    started = time.perf_counter()
    result: DepthMesh = function(*arguments, **options)
    return result, measured, is_image, time.perf_counter() - started


def _colour(path: str) -> NDArray[np.uint8] | None:
    if not path:
        return None
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError:
        raise MissingExtraError("pillow", "io") from None
    try:
        with Image.open(path) as image:
            return np.array(image.convert("RGB"))
    except (UnidentifiedImageError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FormatError(f"expected a colour image: {error}", file=path) from error


def _sentence(record: Mapping[str, Any]) -> str:
    variant = f" ({record['variant']})" if record["variant"] else ""
    missed = f"; target {count(record['target_points'])} missed" if record["target_missed"] else ""
    return (
        f"{record['method']}{variant}: {count(record['points_before'])} points -> "
        f"{count(record['points'])}, {count(record['faces'])} faces in "
        f"{record['seconds'] * 1000:.1f} ms{missed}; wrote {record['output']}"
    )


def reduce_folder(
    folder: Path, output: Path, order: Order, pattern: str, terminal: Terminal, *, jobs: int,
    force: bool,
) -> list[dict[str, Any]]:  # fmt: skip
    """Reduce every frame of a folder into another one, in parallel processes.

    Frames whose mesh is there already are kept as they are, so an interrupted run goes on where it
    stopped; ``force`` makes them anew. A frame that fails is reported and the others go on.
    """
    from manip3d._util.parallel import run_tasks

    frames = sorted(p for p in folder.glob(pattern) if p.suffix.lower() in DEPTH_SUFFIXES)
    if not frames:
        raise InputError(
            f"{folder}: expected frames {pattern} ({', '.join(DEPTH_SUFFIXES)}), found none"
        )
    colours = _colours(order.colour, frames)
    output.mkdir(parents=True, exist_ok=True)
    targets = {frame: output / f"{frame.stem}.glb" for frame in frames}
    if len(set(targets.values())) < len(frames):
        raise InputError(f"{folder}: two frames of the same name but for their suffix")
    waiting = [frame for frame in frames if force or not targets[frame].exists()]
    kept = [
        {"input": str(f), "output": str(targets[f]), "kept": True, "target_missed": False}
        for f in frames
        if f not in waiting
    ]
    if kept:
        terminal.say(f"{len(kept)} of {len(frames)} frames are there already (--force: anew)")
    tasks = {
        str(frame): (_one_of_many, (frame, targets[frame], order, colours.get(frame, "")))
        for frame in waiting
    }
    records: list[dict[str, Any]] = []
    with terminal.progress("cs3") as progress:
        for source, outcome in run_tasks(tasks, jobs or len(os.sched_getaffinity(0))):
            record = (
                outcome.value if not outcome.error else {"input": source, "error": outcome.error}
            )
            records.append(record)
            terminal.say(f"{source}: {outcome.error}" if outcome.error else _sentence(record))
            if progress is not None:
                progress(len(records) / len(waiting), source)
    return sorted([*kept, *records], key=lambda record: str(record["input"]))


def _one_of_many(source: Path, target: Path, order: Order, colour: str) -> dict[str, Any]:
    alone = replace(order, colour=colour, threads=1)
    return reduce_file(source, target, alone, Terminal(quiet=True))


def _colours(colour: str, frames: list[Path]) -> dict[Path, str]:
    """The image of each frame: those of a folder, in the order of their names."""
    if not colour:
        return {}
    images = sorted(p for p in Path(colour).iterdir() if p.is_file())
    if len(images) != len(frames):
        raise InputError(f"--colour: expected {len(frames)} images, found {len(images)}")
    return {frame: str(image) for frame, image in zip(frames, images, strict=True)}


def fail_if_any(records: list[dict[str, Any]]) -> None:
    """Raise when a frame of a folder failed, after all were tried."""
    failed = [record for record in records if record.get("error")]
    if failed:
        raise Error(f"{len(failed)} of {len(records)} frames failed")


class DepthMethod(StrEnum):
    """The methods of chapter 3, and manip3d's own."""

    cs3 = "cs3"
    relief = "relief"
    uniform = "uniform"
    poisson = "poisson"
    ssa = "ssa"


class Variant(StrEnum):
    """The four variants of CS3: importance (L or C), then sampling."""

    cios = "cios"
    lios = "lios"
    cnms = "cnms"
    lnms = "lnms"


def cs3(
    source: Annotated[
        str, typer.Argument(help="A depth image, a scan (PLY range_grid), or a folder of frames.")
    ],
    output: Output,
    points: Annotated[int, typer.Option(min=1, help="At most so many vertices.")],
    intrinsics: Annotated[
        str,
        typer.Option(help="fx,fy,cx,cy, FILE.json, kinect-v1, kinect-v2 or primesense."),
    ] = "",
    method: Annotated[DepthMethod, typer.Option(help="How.")] = DepthMethod.cs3,
    variant: Annotated[Variant, typer.Option(help="Of --method cs3.")] = Variant.cios,
    units_per_metre: Annotated[
        float, typer.Option(help="Of whole-number images: 1000, or 5000 for TUM and ICL-NUIM.")
    ] = 1000.0,
    max_edge: Annotated[
        float | None, typer.Option(help="Leave out triangles with a longer edge: for scenes.")
    ] = None,
    by_distance: Annotated[
        bool, typer.Option("--by-distance", help="More points where it is near (--method cs3).")
    ] = False,
    move_points: Annotated[
        bool, typer.Option("--move-points", help="Points may leave the input (--method relief).")
    ] = False,
    colour: Annotated[
        str, typer.Option(help="Colour image of the same size; for a folder, a folder of them.")
    ] = "",
    frames: Annotated[
        str, typer.Option(metavar="PATTERN", help="Which files of a folder are depth images.")
    ] = "*",
    force: Force = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: FolderJobs = 0,
    seed: Seed = 0,
) -> None:
    """Turn a depth image or a range scan into a sparse textured mesh.

    A folder becomes a folder of .glb files, in parallel processes; run again, it goes on where it
    stopped. Depth images become metres, in glTF with +y up, else in the camera's axes.
    """
    shell = Terminal(as_json=as_json, quiet=quiet)
    order = Order(
        points,
        method.value,
        variant.value,
        intrinsics,
        units_per_metre,
        max_edge,
        by_distance,
        move_points,
        colour,
        seed,
        threads=jobs,
    )
    if Path(source).is_dir():
        records = reduce_folder(Path(source), output, order, frames, shell, jobs=jobs, force=force)
        shell.result(records)
        fail_if_any(records)
    else:
        refuse_existing(output, force=force)
        records = [reduce_file(Path(source), output, order, shell)]
        shell.result(records[0])
    if strict and any(record["target_missed"] for record in records):
        raise typer.Exit(MISSED)
