"""Steadiness of the phantom limb: its plane, lag and steps, on simulated and recorded people.

``python benchmarks/bench_steadiness.py [--parts plane|rest]`` prints three tables.

The first two tables are of simulated people without the limb, whose ground truth is known, with
white jitter and with AR(1) jitter (rho 0.9) on every joint. A *step* is the movement from one frame
to the next.

- `plane`: the true intact hand or foot is reflected through the plane of each frame. The value is
  the length of the difference between its step and that of the true mirror image, millimetres,
  median and 95th percentile.
- `steps`: the step of the phantom's hand or foot divided by that of the intact one as tracked, for
  the medians and for the 95th percentiles.
- `shown`: the same, divided by the step of the intact one as shown, which is smoothed.
- `lag` (second table, in which the body turns by 20 degrees to and fro, once in two seconds): delay
  of the plane's direction behind the body's, milliseconds; the shift with the smallest difference.

The third table is of the reporting half of the trials of UTD-MHAD (``MANIP3D_DATA``; options were
chosen on the other half), with each leg as the affected one: the step of the phantom foot,
centimetres, in frames in which the recorded intact foot moves by less than 1 cm. It covers frames
in which the phantom is shown, and those in which the state is `tracking` before and after the step.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

import numpy as np

from bench_people import is_tuning

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SCENES: tuple[dict[str, Any], ...] = (
    {"amputated": "right_arm", "motion": "still"},
    {"amputated": "left_arm", "motion": "arm-curl"},
    {"amputated": "right_arm", "motion": "still", "sitting": True},
    {"amputated": "left_leg", "motion": "still"},
    {"amputated": "right_leg", "motion": "knee-extension"},
)
JITTERS = (0.010, 0.020)  # standard deviations of joints, metres
CORRELATIONS = (0.0, 0.9)
SETTLED = 15  # number of first frames, in which smoother and plane settle; not counted
AT_REST = 0.01  # metres per frame; smaller steps count as rest
RATE = 30.0  # frames per second


def quantiles(values: Sequence[float], scale: float, *at: float) -> list[str]:
    """Quantiles as text; a dash where there is no value."""
    if not len(values):
        return ["-"] * len(at)
    return [f"{scale * np.quantile(values, q):.1f}" for q in at]


def lag(turns: Floats, true: Floats) -> float:
    """Return the delay in seconds of angles behind the true ones, both given for each frame."""
    times = np.arange(len(turns)) / RATE
    asked = slice(SETTLED, len(turns) - SETTLED)
    shifts = np.linspace(-0.1, 0.4, 501)
    left = []
    for shift in shifts:
        off = turns[asked] - np.interp(times[asked] - shift, times, true)
        left.append(float(np.var(off)))
    return float(shifts[int(np.argmin(left))])


def run_simulated(scene: dict[str, Any]) -> dict[str, Any]:
    """Measure steps of the plane, the phantom and the intact limb, and the plane's lag."""
    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import LIMBS, BodySimulator, opposite

    limb = scene["amputated"]
    mine, intact = LIMBS[limb][3], LIMBS[opposite(limb)][3]
    simulator = BodySimulator(**scene, color="none", threads=1, rate=RATE)
    pipeline = PhantomPipeline(limb)
    ends: list[tuple[Floats, ...]] = []
    turns: list[tuple[float, float]] = []
    states: list[str] = []
    for number in range(simulator.frames):
        capture = simulator.capture(0.5 + number / RATE)
        result = pipeline.process(capture.frame)
        states.append(result.state.value)
        if result.plane is None:
            continue
        origin, normal = capture.truth.mirror_plane(limb)
        end = np.asarray(capture.truth.joints[intact], dtype=np.float64)
        estimated = result.plane.normal * np.sign(result.plane.normal @ normal)
        turns.append((np.arctan2(estimated[2], estimated[0]), np.arctan2(normal[2], normal[0])))
        ends.append(
            (
                result.plane(end),
                end - 2.0 * ((end - origin) @ normal) * normal,
                result.skeleton.positions[mine].astype(np.float64),
                capture.frame.skeletons[0].positions[intact].astype(np.float64),
                result.skeleton.positions[intact].astype(np.float64),
            )
        )
    steps = np.linalg.norm(np.diff(np.array(ends), axis=0), axis=2)[SETTLED:]
    estimated_turn, true_turn = np.unwrap(np.array(turns), axis=0).T
    return {
        "plane": np.abs(steps[:, 0] - steps[:, 1]),
        "phantom": steps[:, 2],
        "told": steps[:, 3],
        "shown": steps[:, 4],
        "lag": lag(estimated_turn, true_turn),
        "tracking": states.count("tracking") / len(states),
    }


def print_simulated(frames: int, scenes: Sequence[int]) -> None:
    """Print the tables of simulated people."""
    import tables

    still, moving = [], []
    for scene in (SCENES[k] for k in scenes):
        for jitter in JITTERS:
            for rho in CORRELATIONS:
                noise = {"jitter": jitter, "correlation": rho, "frames": frames, "seed": 3}
                found = run_simulated({**scene, **noise})
                name = f"{scene['amputated']}, {scene['motion']}"
                name += ", seated" if scene.get("sitting") else ""
                kind = f"{1e3 * jitter:.0f} mm, {f'AR(1) {rho:g}' if rho else 'white'}"
                ratios = [
                    f"{np.quantile(found['phantom'], q) / np.quantile(found[whose], q):.2f}"
                    for whose in ("told", "shown")
                    for q in (0.5, 0.95)
                ]
                plane = quantiles(found["plane"], 1e3, 0.5, 0.95)
                still.append([name, kind, f"{100 * found['tracking']:.0f}", *plane, *ratios])
                swayed = run_simulated({**scene, **noise, "sway": 20.0})
                share = f"{100 * swayed['tracking']:.0f}"
                moving.append([name, kind, share, f"{1e3 * swayed['lag']:.0f}"])
    head = [
        "simulated",
        "jitter",
        "tracking",
        "plane, mm",
        "95 %",
        "steps",
        "95 %",
        "shown",
        "95 %",
    ]
    print(tables.table(head, still))
    print(tables.table(["simulated, swaying", "jitter", "tracking", "lag, ms"], moving))


def print_rest(trials: str) -> None:
    """Print the table of recorded people at rest."""
    import re

    import tables
    from manip3d import datasets
    from manip3d.modify import PhantomPipeline
    from manip3d.simulate import LIMBS, opposite

    steps: dict[str, list[float]] = {}
    for uri in datasets.people_uris():
        if not uri.startswith("utd") or is_tuning(uri) or not re.search(trials, uri):
            continue
        frames = list(datasets.open_people(uri))
        for limb in ("left_leg", "right_leg"):
            mine, intact = LIMBS[limb][3], LIMBS[opposite(limb)][3]
            pipeline = PhantomPipeline(limb)
            last: tuple[Floats, Floats, bool, bool] | None = None
            for frame in frames:
                result = pipeline.process(frame)
                now = (
                    frame.skeletons[0].positions[intact].astype(np.float64),
                    result.skeleton.positions[mine].astype(np.float64),
                    result.state.value != "lost",
                    result.state.value == "tracking",
                )
                if last is not None and np.linalg.norm(now[0] - last[0]) < AT_REST:
                    step = float(np.linalg.norm(now[1] - last[1]))
                    if now[2] and last[2]:
                        steps.setdefault(f"{limb}, shown", []).append(step)
                    if now[3] and last[3]:
                        steps.setdefault(f"{limb}, tracking", []).append(step)
                last = now
    for which in ("shown", "tracking"):
        steps[f"both, {which}"] = [
            step for leg in ("left_leg", "right_leg") for step in steps[f"{leg}, {which}"]
        ]
    head = ["recorded, at rest", "frames", "median, cm", "95 %", "99 %"]
    rows = [
        [name, str(len(each)), *quantiles(each, 1e2, 0.5, 0.95, 0.99)]
        for name, each in steps.items()
    ]
    print(tables.table(head, rows))


PARTS = ("plane", "rest")


def main() -> None:
    """Print the selected tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", nargs="*", default=PARTS, choices=PARTS)
    parser.add_argument("--frames", type=int, default=120, help="of each simulated sequence")
    parser.add_argument("--scenes", type=int, nargs="*", default=range(len(SCENES)))
    parser.add_argument("--trials", default="", help="a pattern of names, such as a2[45]")
    options = parser.parse_args()
    if "plane" in options.parts:
        print_simulated(options.frames, options.scenes)
    if "rest" in options.parts:
        print_rest(options.trials)


if __name__ == "__main__":
    main()
