"""Sequences: changes of the operators' meshes between frames, and the time of a frame."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import datasets
from manip3d.experiments import _depth_pictures
from manip3d.experiments._depth import MAX_EDGE, simulated_width
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.camera import Intrinsics
    from manip3d.simplify import DepthMesh

_METHODS = {
    "cios": "CS3 (CIOS), each frame alone",
    "relief": "relief, each frame alone",
    "relief stream": "relief, stream",
    "relief moved": "relief, points moved, each frame alone",
    "relief stream moved": "relief, points moved, stream",
}
_SHARE = 0.05
_STEADY = 0.02
"""Largest range of a static pixel's depths over the sequence, as a share of their mean. It is above
the sensors' noise at 3 m and below the changes by a moving limb or camera."""
_WARM_UP = 5  # number of first frames, in which a stream settles; not counted for any method


@dataclass(frozen=True)
class _Sequence:
    label: str
    data: str = ""
    prefix: str = ""  # common beginning of the frames' names
    kind: str = "scene"
    first: int = 0

    def names(self, count: int) -> list[str]:
        names = [n for n in datasets.frame_names(self.data) if n.startswith(self.prefix)]
        return names[self.first : self.first + count]


_REAL = (
    _Sequence("turning person", "person_turning"),
    _Sequence("UTD-MHAD, waving", "person_utd_mhad", "a3_s1_t1/", "person"),
    _Sequence("UTD-MHAD, squatting", "person_utd_mhad", "a27_s1_t1/", "person"),
    _Sequence("7-Scenes kitchen", "scene_kitchen", "frame-00000"),
)
_SIMULATED = _Sequence("room (simulated), camera at rest")


def _cases(plan: Plan) -> list[Case]:
    sequences = [] if plan.data == "real" else [_SIMULATED]
    if plan.data != "simulated":
        here = [s for s in _REAL if plan.data == "real" or datasets.is_here(datasets.get(s.data))]
        sequences += here[:1] if plan.scale == "quick" else here
    count = 10 if plan.scale == "quick" else 30
    return [
        Case(
            measure,
            {
                "model": sequence.label,
                "kind": sequence.kind,
                "source": (
                    ["frame", sequence.data, sequence.names(count)[-1]]
                    if sequence.data
                    else ["simulated", "room"]
                ),
                "names": sequence.names(count) if sequence.data else count,
                "width": simulated_width(plan),
                "stands_in_for": "",
                "data": "recorded" if sequence.data else "simulated",
                "role": "recorded" if sequence.data else "simulated",
                "method": method,
                "seed": 1000 * plan.seed,  # that of the first frame; no seed has another's frames
            },
            inputs=(sequence.data,) if sequence.data else (),
        )
        for sequence in sequences
        for method in _METHODS
    ]


def _frames(options: Any) -> tuple[list[NDArray[Any]], Intrinsics, NDArray[np.uint8] | None]:
    """Return the depth images, their camera, and the colour image of the last frame."""
    kind, *source = options["source"]
    if kind == "simulated":
        from manip3d import simulate

        scene = simulate.depth.room(width=options["width"], height=options["width"] * 3 // 4)
        seeds = range(options["seed"], options["seed"] + options["names"])
        return [scene.capture(rng=i).depth for i in seeds], scene.intrinsics, scene.color
    frames = [datasets.load_frame(source[0], name) for name in options["names"]]
    depths = [f.person if options["kind"] == "person" else f.depth for f in frames]
    return list(depths), frames[0].intrinsics, frames[-1].color


def _steady(depths: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """Return (H, W) bool: static pixels, which are measured in every frame."""
    stack = np.stack(depths).astype(np.float64)
    still: NDArray[np.bool_] = np.ptp(stack, axis=0) <= _STEADY * stack.mean(axis=0)
    return still & (stack > 0).all(axis=0)


def _slow(depths: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return moving averages over nine frames; fewer at the ends of the sequence."""
    last = len(depths) - 1
    means = [depths[max(0, i - 4) : min(i + 4, last) + 1].mean(axis=0) for i in range(last + 1)]
    return np.stack(means)


def _operator(
    method: str, camera: Intrinsics, points: int, max_edge: float | None
) -> Callable[[NDArray[Any]], DepthMesh]:
    from manip3d import simplify

    if method == "cios":
        return lambda depth: simplify.cs3(depth, camera, points, max_edge=max_edge, threads=1)
    moved = method.endswith("moved")
    if "stream" in method:
        stream = simplify.ReliefStream(camera, points, move_points=moved, max_edge=max_edge)
        return stream.simplify
    return lambda depth: simplify.relief(
        depth, camera, points, move_points=moved, max_edge=max_edge, threads=1
    )


def measure(case: Case) -> Row:
    """Simplify one sequence by one method, on one thread."""
    from manip3d import metrics

    options = case.options
    depths, camera, color = _frames(options)
    max_edge = MAX_EDGE if options["kind"] == "scene" else None
    points = math.floor(_SHARE * int((depths[0] > 0).sum()))
    operator = _operator(options["method"], camera, points, max_edge)
    meshes, seconds = [], []
    for depth in depths:
        started = time.process_time()
        meshes.append(operator(depth))
        seconds.append(time.process_time() - started)
    still = _steady(depths)
    counted = slice(min(_WARM_UP, len(depths) // 2), None)
    restless = metrics.flicker(meshes[counted], camera, within=still)
    steady = np.stack(depths[counted]).astype(np.float64)[:, still]
    millimetres = 1.0 if depths[0].dtype == np.uint16 else 1000.0
    errors = [
        metrics.range_image_error(depth, camera, mesh).mean_square_mm2
        for depth, mesh in zip(depths[counted], meshes[counted], strict=True)
    ]
    last = replace(meshes[-1], color=color)
    return {
        "frames": restless.frames,
        "points": meshes[-1].num_vertices,
        "steady": float(still.sum() / (depths[0] > 0).sum()),
        "sensor_mm": millimetres * float(steady.std(axis=0).mean()),
        "sway_mm": millimetres * float(_slow(steady).std(axis=0).mean()),
        "flicker_mm": restless.mean_std_mm,
        "step_mm": restless.mean_step_mm,
        "changed": restless.changed,
        "rms_mm": math.sqrt(float(np.mean(errors))),
        "frame_ms": 1000.0 * float(np.median(seconds[counted])),
        "slowest_ms": 1000.0 * max(seconds[counted]),
        "reduced": last.mesh,
    }


def _half(measure: str, unit: str, factor: float) -> Any:
    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        found = {(row["model"], row["method"]): row for row in rows}
        for (model, method), row in found.items():
            alone = found.get((model, method.replace(" stream", "")))
            if "stream" in method and alone is not None and row[measure] is not None:
                mine, theirs = factor * row[measure], factor * alone[measure]
                numbers = f"{mine:.2f} against {theirs:.2f} {unit}"
                yield Finding(f"{model}, {_METHODS[method]}", mine <= theirs / 2, numbers)

    return judge


EXPERIMENT = Experiment(
    id="sequences-3",
    title="Sequences, 5 % of the points: flicker and time",
    published="",
    data=tuple(dict.fromkeys(sequence.data for sequence in _REAL)),
    cases=_cases,
    columns=(
        Column("method", "method", words=_METHODS),
        Column("frames", "frames"),
        Column("points", "vertices"),
        Column("steady", "steady pixels, %", 1e2, 1),
        Column("sensor_mm", "sensor's deviation, mm", 1.0, 2),
        Column("sway_mm", "its slow part, mm", 1.0, 2),
        Column("flicker_mm", "flicker, mm", 1.0, 2, lower_is_better=True),
        Column("step_mm", "from frame to frame, mm", 1.0, 2, lower_is_better=True),
        Column("changed", "vertices changed, %", 1e2, 1, lower_is_better=True),
        Column("rms_mm", "error of depth, RMS mm", 1.0, 1, lower_is_better=True),
        Column("frame_ms", "frame, ms", 1.0, 2, lower_is_better=True),
        Column("slowest_ms", "slowest, ms", 1.0, 2),
    ),
    claims=(
        Claim("The stream flickers at most half as much as frames taken alone", "aim",
              _half("flicker_mm", "mm", 1.0)),
        Claim("From one frame to the next it flickers at most half as much", "aim",
              _half("step_mm", "mm", 1.0)),
        Claim("At most half as many of its vertices change from frame to frame", "aim",
              _half("changed", "%", 100.0)),
    ),
    sheets=_depth_pictures.sheets,
    notes=(
        "Flicker: the standard deviation over time of the depth that a pixel sees of the meshes, "
        f"mean over the pixels that stand still (depths differ by at most {_STEADY:.0%} over the "
        "sequence) and that all meshes cover. The sensor's own is given beside it, and that of the "
        "mean of nine frames around each, its slow part: people breathe and sway by less than what "
        "counts as still, and a stream that follows them flickers by no less. The deviation from "
        "frame to frame (Allan's), which slow motion does not raise, is given too. The error of "
        "depth is taken over all pixels of each frame, so that a stream that lagged behind what "
        "moves would show it. Kitchen: the camera moves. Times are one thread's processor time.",
    ),
)  # fmt: skip
