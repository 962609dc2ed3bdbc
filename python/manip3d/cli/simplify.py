"""``manip3d simplify``: reduce the faces of a mesh."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from manip3d._util.memory import bytes_of, most_resident_bytes, written_size
from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import (
    MISSED,
    FastJobs,
    Force,
    Json,
    Output,
    Quiet,
    Strict,
)
from manip3d.cli.sources import gone_materials, gone_meshes, open_scene_or_mesh, tell_faces
from manip3d.cli.terminal import (
    Progress,
    Terminal,
    check_output,
    count,
    counted,
    naming_options,
)
from manip3d.errors import FormatError, InputError
from manip3d.io import READABLE, WRITABLE, Scene
from manip3d.io._files import check_regular

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.mesh import Mesh
    from manip3d.simplify import QualityResult, SimplifyResult

Box = tuple[float, float, float, float, float, float]

LockBox = Annotated[
    Box | None,
    typer.Option(
        metavar="X Y Z X Y Z",
        help="Vertices between these two corners stay where they are (--mode quality or fast). In "
        "a scene, a vertex stays if it lies between them in any instance of its mesh.",
    ),
]

LockBoundary = Annotated[
    bool,
    typer.Option(
        "--lock-boundary",
        help="Boundaries stay as they are, so that tiles still meet (--mode quality or fast).",
    ),
]

ColorWeight = Annotated[
    float | None,
    typer.Option(
        "--color-weight",
        help="Weight of errors of vertex colours, relative to those of the shape (--mode quality "
        "or fast). Default: 0.01, with which the shape has priority.",
    ),
]

NoClean = Annotated[
    bool,
    typer.Option(
        "--no-clean",
        help="Do not clean the mesh first; for --mode published. The other modes always do.",
    ),
]


_TARGETS = ("faces", "ratio", "headset", "max_error", "max_distance")


def _expect_target(*targets: object) -> None:
    if all(target is None for target in targets):
        raise typer.BadParameter(
            "give --faces, --ratio, --max-error, --max-distance or --headset", param_hint="--faces"
        )


@dataclass(frozen=True)
class Order:
    """Options of one simplification: the method, its targets and its limits."""

    method: str  # "quality", "fast", or a method of chapter 2
    faces: int | None
    ratio: float | None
    max_error: float | None
    max_distance: float | None
    clean: bool
    lock_box: Box | None
    options: dict[str, Any]
    memory: int | None = None  # ceiling of the memory of the whole process, bytes
    importance: Path | None = None  # .npy file with a weight for each vertex
    lock_boundary: bool = False

    def __post_init__(self) -> None:
        _expect_target(self.faces, self.ratio, self.max_error, self.max_distance)
        if self.ratio is not None and not 0 < self.ratio <= 1:
            raise InputError(f"--ratio: expected a number in (0, 1], got {self.ratio}")
        for name, limit in (("max-error", self.max_error), ("max-distance", self.max_distance)):
            if limit is not None and not 0 <= limit < math.inf:
                raise InputError(f"--{name}: expected a finite number >= 0, got {limit}")
        expect_locks(self.method, self.lock_box, self.lock_boundary)

    @property
    def cleans_itself(self) -> bool:
        """Whether the method always cleans its input."""
        return self.method in (Mode.quality, Mode.fast)

    def target(self, num_faces: int) -> int | None:
        """Return the target number of faces for a mesh that had ``num_faces`` when it was read."""
        if self.ratio is None:
            return self.faces
        fraction = max(1, int(num_faces * self.ratio))
        return fraction if self.faces is None else max(self.faces, fraction)

    def limits(self) -> dict[str, Any]:
        """Return the largest error and the largest distance, as arguments of the method."""
        limits: dict[str, Any] = {"max_error": self.max_error}
        if self.method != "fast":
            limits["max_distance"] = self.max_distance
        elif self.max_distance is not None:
            raise InputError("--max-distance: expected --mode quality or published, got fast")
        return limits


def expect_surface(source: str, mesh: Mesh, cleaned: Mesh) -> None:
    """Refuse a mesh whose faces all have two corners at the same position."""
    from manip3d.simplify._collapse import has_surface

    if not has_surface(cleaned):
        raise InputError(
            f"{source}: none of its {counted(mesh.num_faces, 'face')} has three different corners"
        )


def _expect_room(source: str, order: Order) -> None:
    held = most_resident_bytes() or 0
    if order.memory is not None and held > order.memory:
        raise InputError(
            f"--memory: expected at least {written_size(held)}, which reading {source} took, "
            f"got {written_size(order.memory)}"
        )


def _importance(order: Order) -> NDArray[np.float64] | None:
    """Read the weights of --importance."""
    if order.importance is None:
        return None
    check_regular(order.importance)
    try:
        # A memory map refuses a file shorter than its header claims before memory is allocated.
        stored = np.lib.format.open_memmap(order.importance, mode="r")
    except OSError:
        raise
    except Exception as error:  # the header is a Python literal, so errors have various types
        raise FormatError(f"{order.importance}: {error}") from None
    if stored.ndim != 1 or stored.dtype.kind not in "iuf":
        raise FormatError(
            f"{order.importance}: expected one number for each vertex, got {stored.dtype} of shape "
            f"{stored.shape}"
        )
    return np.array(stored, dtype=np.float64)


def simplify_file(
    source: str, output: Path, order: Order, terminal: Terminal, progress: Progress | None = None
) -> dict[str, Any]:
    """Clean and simplify one mesh, write it, and return the record for ``--json``.

    Targets refer to the mesh as read, before cleaning.
    """
    from manip3d import simplify

    opened = open_scene_or_mesh(source, output, terminal)
    _expect_room(source, order)
    if isinstance(opened.thing, Scene):
        return _simplify_scene(opened.thing, source, output, order, terminal, progress)
    mesh = opened.thing
    record: dict[str, Any] = {"input": source, "output": str(output), "method": order.method}
    record["faces_before"] = mesh.num_faces
    started = time.perf_counter()
    cleans = order.clean and not order.cleans_itself
    cleaned = simplify.clean(mesh).mesh if cleans else mesh
    expect_surface(source, mesh, cleaned)
    record["faces_cleaned"] = cleaned.num_faces
    target = order.target(mesh.num_faces)
    limits: dict[str, Any] = {"target_faces": target, **order.limits()}
    limits |= locks(cleaned, order.lock_box, order.lock_boundary, terminal)
    if (weights := _importance(order)) is not None:
        limits["importance"] = weights
    result = _run(cleaned, order, limits, progress)
    seconds = time.perf_counter() - started
    # With a memory ceiling, faces are also dropped when parts are reduced, not only by cleaning.
    if order.cleans_itself and order.memory is None:
        record["faces_cleaned"] = mesh.num_faces - result.dropped_faces
    record |= _outcome(result, result, target, seconds, result.mesh.num_faces)
    if result.mesh.num_faces == 0:
        raise InputError(f"{source}: nothing is left of it at this target; {output} is not written")
    record["nodes_lost"] = opened.nodes_lost
    record["gone_meshes"] = []
    record["gone_materials"] = gone_materials([mesh], [result.mesh], terminal)
    if record["stop"] != "refused":
        result.mesh.write(output)
    terminal.say(_sentence(record))
    return record


def _run(
    mesh: Mesh, order: Order, limits: dict[str, Any], progress: Progress | None
) -> QualityResult | SimplifyResult:
    from manip3d import simplify

    if order.memory is not None:
        mode: Any = order.method
        limits |= order.options
        return simplify.simplify(mesh, mode, memory=order.memory, progress=progress, **limits)
    own: dict[str, Callable[..., QualityResult | SimplifyResult]] = {
        "quality": simplify.quality,
        "fast": simplify.fast,
    }
    method = own.get(order.method) or simplify.METHODS[order.method]
    return method(mesh, progress=progress, **limits, **order.options)


def _simplify_scene(
    scene: Scene,
    source: str,
    output: Path,
    order: Order,
    terminal: Terminal,
    progress: Progress | None,
) -> dict[str, Any]:
    """Simplify each mesh of a scene once; its faces count once for each node that draws it."""
    from manip3d import simplify

    record: dict[str, Any] = {"input": source, "output": str(output), "method": order.method}
    record |= {"faces_before": scene.num_faces, "faces_cleaned": scene.num_faces}
    target = order.target(scene.num_faces)
    locked = scene_locks(scene, order.lock_box, order.lock_boundary, terminal)
    started = time.perf_counter()
    done = simplify.simplify_scene(
        scene,
        order.method,
        target_faces=target,
        importance=_importance(order),
        memory=order.memory,
        cleaned=order.clean,
        options=order.options,
        progress=progress,
        **order.limits(),
        **locked,
    )
    seconds = time.perf_counter() - started
    record |= _outcome(done, done.result, target, seconds, done.scene.num_faces)
    record["scene"] = {
        "nodes": len(scene.nodes),
        "meshes": len(scene.meshes),
        "instances": scene.num_instances,
        "stored_faces_before": scene.num_stored_faces,
        "stored_faces_after": done.scene.num_stored_faces,
        "fixed_meshes": {i: reason for i, reason in enumerate(scene.fixed) if reason},
    }
    if done.scene.num_faces == 0:
        raise InputError(f"{source}: nothing is left of it at this target; {output} is not written")
    record["nodes_lost"] = ""
    record["gone_meshes"] = gone_meshes(scene, done.scene, terminal)
    record["gone_materials"] = gone_materials(scene.meshes, done.scene.meshes, terminal)
    if record["stop"] != "refused":
        done.scene.write(output)
        tell_faces(scene, done.scene, terminal)
    terminal.say(_sentence(record))
    return record


def _outcome(
    done: Any, run: Any, target: int | None, seconds: float, faces_after: int
) -> dict[str, Any]:
    stop = str(done.stop)
    is_short = stop not in ("target_reached", "error_limit", "distance_limit")
    return {
        "faces_after": faces_after,
        "target_faces": target,
        "max_error": done.max_error,
        "distance_bound": done.distance_bound,
        "stop": stop,
        "rejected": dict(run.rejected),
        "message": run.message,
        "seconds": round(seconds, 4),
        # Without a target number of faces, a run with no legal collapse left has missed nothing:
        # limits of the error and of the distance are kept.
        "target_missed": is_short and (target is not None or stop == "refused"),
    }


def _sentence(record: dict[str, Any]) -> str:
    if record["stop"] == "refused":
        return f"refused: {record['message']}"
    removed = record["faces_before"] - record["faces_cleaned"]
    cleaned = f" (cleaning removed {count(removed)})" if removed else ""
    # The error of a collapse is not the distance from the input, which the bound is about.
    error = f"largest error {record['max_error']:.3g}"
    if record["distance_bound"] is not None:
        error = f"at most {record['distance_bound']:.3g} from the input"
    missed = f"; target of {counted(record['target_faces'] or 0, 'face')} missed"
    return (
        f"{record['method']}: {counted(record['faces_before'], 'face')}{cleaned} -> "
        f"{count(record['faces_after'])} in {record['seconds']:.2f} s, {error} "
        f"(units of the file), {record['stop'].replace('_', ' ')}"
        f"{missed if record['target_missed'] else ''}; wrote {record['output']}"
    )


def _headset_faces(headset: tuple[float, float], faces: int | None) -> int:
    from manip3d.simplify import polygon_budget

    if faces is not None:
        raise InputError("--headset: cannot be given with --faces")
    try:
        with naming_options(ms_per_million="MS", refresh_hz="HZ"):
            budget = polygon_budget(*headset)
    except InputError as error:
        raise InputError(f"--headset: {error}") from None
    if budget < 1:
        raise InputError(
            f"--headset: {headset[0]:g} ms and {headset[1]:g} Hz leave no time for a face"
        )
    return budget


def _ceiling(memory: str) -> int:
    try:
        return bytes_of(memory)
    except InputError as error:
        raise InputError(f"--memory: {error}") from None


def expect_cleaning(method: str, no_clean: bool) -> None:
    """Refuse --no-clean for methods that always clean the mesh."""
    if no_clean and method in (Mode.quality, Mode.fast):
        raise InputError(f"--no-clean: expected --mode published, got {method}, which cleans")


def expect_locks(method: str, box: Box | None, boundary: bool) -> None:
    """Refuse locks for methods without locks, and a box whose first corner is not the lower one."""
    for name, is_given in (("--lock-box", box is not None), ("--lock-boundary", boundary)):
        if is_given and method not in (Mode.quality, Mode.fast):
            raise InputError(f"{name}: expected --mode quality or fast, got {method}")
    if box is not None and not all(a <= b for a, b in zip(box[:3], box[3:], strict=True)):
        raise InputError(
            f"--lock-box: expected the lower corner first, got {box[:3]} and {box[3:]}"
        )


def color_options(method: str, weight: float | None) -> dict[str, Any]:
    """Return the method's argument ``color_weight``, or nothing if none is given."""
    if weight is None:
        return {}
    if method not in (Mode.quality, Mode.fast):
        raise InputError(f"--color-weight: expected --mode quality or fast, got {method}")
    if not 0 <= weight < math.inf:
        raise InputError(f"--color-weight: expected a finite number >= 0, got {weight}")
    return {"color_weight": weight}


def locks(mesh: Mesh, box: Box | None, boundary: bool, terminal: Terminal) -> dict[str, Any]:
    """Return the method's argument ``locked``, (V,) bool, or nothing if no vertex is locked."""
    from manip3d import simplify
    from manip3d.simplify._scene import inside_box

    held: dict[str, NDArray[np.bool_]] = {}
    if box is not None:
        held["--lock-box"] = inside_box(mesh.vertices, np.reshape(box, (2, 3)))
    if boundary:
        held["--lock-boundary"] = simplify.boundary_vertices(mesh)
    for name, vertices in held.items():
        _tell_lock(name, int(vertices.sum()), terminal)
    return {"locked": np.any(list(held.values()), axis=0)} if held else {}


def scene_locks(
    scene: Scene, box: Box | None, boundary: bool, terminal: Terminal
) -> dict[str, Any]:
    """Return the arguments ``lock_box`` and ``lock_boundary`` for a scene."""
    from manip3d.simplify._scene import num_boundary_vertices, vertices_in_box

    given: dict[str, Any] = {"lock_boundary": boundary}
    if box is not None:
        given["lock_box"] = np.reshape(box, (2, 3))
        held = vertices_in_box(scene, given["lock_box"])
        _tell_lock("--lock-box", sum(int(own.sum()) for own in held.values()), terminal)
    if boundary:
        _tell_lock("--lock-boundary", num_boundary_vertices(scene), terminal)
    return given


def _tell_lock(option: str, num_vertices: int, terminal: Terminal) -> None:
    terminal.say(f"{option} holds {counted(num_vertices, 'vertex', 'vertices')}")


class Mode(StrEnum):
    """Modes of simplification, by priority: error, published method, or speed."""

    quality = "quality"
    published = "published"
    fast = "fast"


class Method(StrEnum):
    """The five methods of chapter 2."""

    qem4vr = "qem4vr"
    qem_orig = "qem-orig"
    qem_bp = "qem-bp"
    qem_tp = "qem-tp"
    qem_btp = "qem-btp"


class SeamMode(StrEnum):
    """Methods that hold texture seams in place."""

    planes = "planes"
    paper = "paper"
    lock = "lock"


@over_files(
    lambda: READABLE, writable=lambda: WRITABLE, otherwise=".glb",
    check=lambda given: _expect_target(*(given[name] for name in _TARGETS)),
)  # fmt: skip
def simplify(
    source: Annotated[
        str,
        typer.Argument(
            help="A mesh (.obj, .ply, .off, .stl, .gltf, .glb, .3mf, .dae; .gz), or - for stdin."
        ),
    ],
    output: Output,
    faces: Annotated[int | None, typer.Option(min=1, help="Stop at this many faces.")] = None,
    ratio: Annotated[
        float | None, typer.Option(help="Stop at this fraction of the faces as read, 0 to 1.")
    ] = None,
    headset: Annotated[
        tuple[float, float] | None,
        typer.Option(
            metavar="MS HZ",
            help="Stop at the number of faces that a headset can draw for both eyes in the time of "
            "one picture. MS: its milliseconds for a million triangles; HZ: its refresh rate.",
        ),
    ] = None,
    max_error: Annotated[
        float | None,
        typer.Option(
            help="Largest quadric error of a collapse, in the file's units; it bounds no distance."
        ),
    ] = None,
    max_distance: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="Largest distance between the surfaces, boundaries included, in the file's units; "
            "0 allows only collapses that leave the surface exactly as it is (--mode published).",
        ),
    ] = None,
    mode: Annotated[
        Mode | None,
        typer.Option(
            help="Priority: quality (least error, vertices move; the default), published (the "
            "dissertation's method, vertices of the input) or fast (speed before error)."
        ),
    ] = None,
    method: Annotated[
        Method | None,
        typer.Option(
            help="Method of the dissertation, chapter 2; implies --mode published. Without it that "
            "mode uses qem4vr."
        ),
    ] = None,
    seam_mode: Annotated[
        SeamMode | None,
        typer.Option(
            help="Protection of texture seams, for --method qem4vr: by planes along each "
            "seam (the default), by heavier quadrics as printed (paper), or by vertices that "
            "never move (lock)."
        ),
    ] = None,
    lock_box: LockBox = None,
    lock_boundary: LockBoundary = False,
    importance: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.npy",
            help="Weights of the surface's error, for --mode quality: a number above "
            "0 for each vertex as read (those of a scene's meshes one after the other).",
        ),
    ] = None,
    color_weight: ColorWeight = None,
    memory: Annotated[
        str | None,
        typer.Option(
            metavar="SIZE",
            help="Limit of the memory of the process, such as 2GiB, for --mode quality and fast: "
            "a larger mesh is first reduced in parts. It includes the memory for reading the file.",
        ),
    ] = None,
    no_clean: NoClean = False,
    force: Force = False,
    strict: Strict = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: FastJobs = 0,
) -> None:
    """Reduce the faces of a mesh.

    The mesh is cleaned first. The first target that is reached ends the run: --faces, --ratio,
    --headset, --max-error or --max-distance. Several files are simplified one by one into a folder,
    in parallel processes.

    If input and output are glTF, the nodes and the appearance of the materials are kept: each mesh
    is simplified once, and its faces count once for each node that draws it.

    Example: manip3d simplify head.obj -o light.glb --faces 5000
    """
    shell = Terminal(as_json=as_json, quiet=quiet)
    if max_distance == 0 and mode is None:
        mode = Mode.published  # as simplify.simplify does
        shell.say("--max-distance 0: --mode published, whose vertices stay where they are")
    if method is not None and mode not in (None, Mode.published):
        raise InputError(f"--method {method}: expected --mode published, got {mode}")
    name: str = method or (Method.qem4vr if mode == Mode.published else mode or Mode.quality)
    options: dict[str, Any] = {}
    if seam_mode is not None:
        if name != Method.qem4vr:
            raise InputError(f"--seam-mode: expected --method qem4vr, got {name}")
        options["seam_mode"] = str(seam_mode)
    if name == Mode.fast:
        options["threads"] = jobs
    options |= color_options(name, color_weight)
    expect_cleaning(name, no_clean)
    if importance is not None and name != Mode.quality:
        raise InputError(f"--importance: expected --mode quality, got {name}")
    if memory is not None and name not in (Mode.quality, Mode.fast):
        raise InputError(f"--memory: expected --mode quality or fast, got {name}")
    if headset is not None:
        faces = _headset_faces(headset, faces)
        shell.say(f"--headset: {counted(faces, 'face')}")
    order = Order(
        str(name),
        faces,
        ratio,
        max_error,
        max_distance,
        not no_clean,
        lock_box,
        options,
        memory=None if memory is None else _ceiling(memory),
        importance=importance,
        lock_boundary=lock_boundary,
    )
    expect_kind(source, "mesh", verb="simplify")
    check_output(output, WRITABLE, force=force)
    with shell.progress("simplify") as progress:
        record = simplify_file(source, output, order, shell, progress)
    shell.result(record)
    if record["stop"] == "refused":
        raise typer.Exit(MISSED if strict else 1)
    if strict and record["target_missed"]:
        raise typer.Exit(MISSED)
