"""Leaps of the phantom limb: frames with the phantom on the wrong side of the plane of symmetry.

``python benchmarks/bench_leaps.py [--frames 10000] [--seed N]`` simulates people without a limb
(all four limbs, exercises, standing and seated, swaying) and disturbs their joints like a tracker.
A frame counts as a leap if the true mirror image lies at least 5 cm from the true plane of symmetry
and the phantom lies on the other side. The same is tested for the joint at the phantom's end if the
tracker sees the intact limb's end. Nearer to the plane, jitter alone may carry a joint across.

Depth images are simulated once for each exercise and used for all disturbances: white jitter and
AR(1) jitter (rho 0.9) of 10 and 20 mm, without and with a tracker that swaps left and right for up
to ten frames. Errors of inferred joints are five times as large. ``--scenes`` selects exercises by
number, from 0.

If n frames contain no leap, the rate is below 3 / n with 95 % confidence, provided that the frames
are independent. Consecutive frames are not; ``runs`` is the number of independent sequences.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.modify import Limb, PhantomFrame
    from manip3d.rgbd import Skeleton
    from manip3d.simulate import BodyCapture

    Floats = NDArray[np.float64]

SCENES: tuple[dict[str, Any], ...] = (
    {"amputated": "right_arm", "motion": "reach"},
    {"amputated": "left_arm", "motion": "wave", "sway": 20.0},
    {"amputated": "right_arm", "motion": "arm-raise", "turn": 25.0},
    {"amputated": "left_arm", "motion": "arm-curl", "sitting": True},
    {"amputated": "right_leg", "motion": "stepping"},
    {"amputated": "left_leg", "motion": "stepping", "sway": 20.0},
    {"amputated": "left_leg", "motion": "knee-extension"},
    {"amputated": "right_leg", "motion": "dorsiflexion", "turn": -20.0},
)
JITTERS = (0.010, 0.020)  # standard deviations of joints, metres
CORRELATIONS = (0.0, 0.9)
MIN_OFF = 0.05  # smallest distance from the true plane of a tested point, metres
KNOWN = 15  # first frames without swaps; sides swapped from the start would define the patient


@dataclass(frozen=True)
class Disturbance:
    """Errors of a tracker's joints."""

    jitter: float
    correlation: float
    swaps: bool

    def __str__(self) -> str:
        kind = f"AR(1) {self.correlation:g}" if self.correlation else "white"
        return f"{self.jitter * 1e3:.0f} mm, {kind}{', swaps' if self.swaps else ''}"


def disturbed(
    skeletons: list[Skeleton], what: Disturbance, rng: np.random.Generator
) -> Iterator[Skeleton]:
    """Return the skeletons of one person, frame by frame, with the errors of a tracker."""
    from manip3d.rgbd import INFERRED, MIRRORED_JOINTS, TRACKED

    rho = what.correlation
    error = rng.normal(size=(25, 3))
    swapped = 0
    for number, skeleton in enumerate(skeletons):
        error = rho * error + np.sqrt(1.0 - rho * rho) * rng.normal(size=(25, 3))
        scale = np.where(skeleton.states == INFERRED, 5.0, 1.0)[:, None]
        off = what.jitter * scale * error * (skeleton.states != 0)[:, None]
        positions = (skeleton.positions + off).astype(np.float32)
        states = skeleton.states
        if what.swaps:
            if swapped == 0 and number >= KNOWN and rng.random() < 0.04:
                swapped = int(rng.integers(1, 11))
            if swapped > 0:
                swapped -= 1
                positions = positions[list(MIRRORED_JOINTS)]
                states = states[list(MIRRORED_JOINTS)]
        assert TRACKED in states
        yield replace(skeleton, positions=positions, states=states)


def simulated(scene: dict[str, Any], frames: int, first: float) -> list[BodyCapture]:
    """Simulate frames of a scene with exact joints."""
    from manip3d.simulate import BodySimulator

    simulator = BodySimulator(**scene, color="none", threads=1)
    return [simulator.capture(first + k / simulator.rate) for k in range(frames)]


def offs(capture: BodyCapture, result: PhantomFrame, limb: Limb) -> list[tuple[float, float]]:
    """Return signed distances from the true plane, metres: of phantom and true mirror image.

    The first pair is that of the drawn pixels, the second that of the joint at the limb's end, if
    the tracker sees the intact limb's end. Pairs nearer to the plane than `MIN_OFF` are left out.
    """
    from manip3d.modify import PixelKind
    from manip3d.rgbd import TRACKED
    from manip3d.simulate import LIMBS, opposite

    origin, normal = capture.truth.mirror_plane(limb)
    mine, intact = LIMBS[limb], LIMBS[opposite(limb)]
    true = -((capture.truth.joints[list(intact)] - origin) @ normal)
    pairs = []
    drawn = result.phantom & (result.kinds != PixelKind.ROOT_FILLED)
    if drawn.any():
        points = capture.frame.calibration.depth.unproject(result.depth)[drawn].astype(float)
        pairs.append((float(np.median((points - origin) @ normal)), float(true[1:4].mean())))
    if capture.frame.skeletons[0].states[intact[3]] == TRACKED:
        end = result.skeleton.positions[mine[3]].astype(float)
        pairs.append((float((end - origin) @ normal), float(true[3])))
    return [(off, wanted) for off, wanted in pairs if abs(wanted) >= MIN_OFF]


def run(captures: list[BodyCapture], limb: Limb, what: Disturbance, seed: int) -> Counter[str]:
    """Process one sequence and count frames: by state, shown, tested ("asked"), and with leaps."""
    from manip3d.modify import PhantomPipeline, PhantomState

    pipeline = PhantomPipeline(limb)
    told = disturbed([c.frame.skeletons[0] for c in captures], what, np.random.default_rng(seed))
    counts: Counter[str] = Counter(runs=1)
    for capture, skeleton in zip(captures, told, strict=True):
        result = pipeline.process(replace(capture.frame, skeletons=(skeleton,)))
        counts["frames"] += 1
        counts[result.state.value] += 1
        if result.state is PhantomState.LOST:
            continue
        counts["shown"] += 1
        pairs = offs(capture, result, limb)
        counts["asked"] += bool(pairs)
        if any(off * wanted < 0.0 for off, wanted in pairs):
            counts["leaps"] += 1
            counts["leaps, tracking"] += result.state is PhantomState.TRACKING
    return counts


def main() -> None:
    """Run all scenes and print one table."""
    import tables

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000, help="in all, at least")
    parser.add_argument("--seed", type=int, default=0, help="of the errors of the joints")
    parser.add_argument("--scenes", type=int, nargs="*", default=range(len(SCENES)))
    options = parser.parse_args()
    disturbances = [
        Disturbance(*each) for each in itertools.product(JITTERS, CORRELATIONS, (False, True))
    ]
    length = -(-options.frames // (len(SCENES) * len(disturbances)))
    rows: dict[str, Counter[str]] = {}
    for number in options.scenes:
        scene = SCENES[number]
        captures = simulated(scene, length, first=0.37 * number)
        name = ", ".join(f"{key} {value}" for key, value in scene.items())
        for k, what in enumerate(disturbances):
            counts = run(
                captures, scene["amputated"], what, seed=1000 * options.seed + 100 * number + k
            )
            for row in ("all", str(what), name):
                rows.setdefault(row, Counter()).update(counts)
        done = rows["all"]
        print(
            f"scene {number}: {done['frames']} frames, {done['leaps']} leaps",
            file=sys.stderr,
            flush=True,
        )
    head = ["frames", "runs", "shown", "asked", "tracking", "leaps", "leaps, tracking"]
    print(
        tables.table(
            ["simulated", *head], [[r, *(str(n[h]) for h in head)] for r, n in rows.items()]
        )
    )
    total = rows["all"]
    if not total["leaps"]:
        print(f"none in {total['asked']}: below {3e2 / total['asked']:.3f} % (95 %)")


if __name__ == "__main__":
    main()
