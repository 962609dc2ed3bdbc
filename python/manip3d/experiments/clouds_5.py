"""Detectors I and II, made for laser scanners, on point clouds of RGB-D cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import datasets
from manip3d.experiments import _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.rgbd import RgbdFrame

_RECORDED = (_streams.TURNING, _streams.KITCHEN, "scene_kinect2_desk")
_KINDS = ("clean", "pasted", "composited")
_ASIDE = (0.3, 0.5, 0.0)  # metres ahead, left, up: shift of the pasted person


def _cases(plan: Plan) -> list[Case]:
    cases = []
    if plan.data != "real":
        for scene in ("room", "office", "hall"):
            for motion in ("wave", "reach")[: 1 if plan.scale == "quick" else 2]:
                name = f"{scene}, {motion}"
                options = {"model": name, "scene": scene, "motion": motion, "seed": plan.seed}
                cases.append(Case(judge_simulated, options | {"data": "simulated"}))
    if plan.data != "simulated":
        for name in _RECORDED:
            if plan.data == "real" or datasets.is_here(datasets.get(name)):
                count = 3 if plan.scale == "quick" else 10
                options = {"model": name, "frames": count, "seed": plan.seed, "data": "recorded"}
                cases.append(Case(judge_recorded, options, (name,)))
    return cases


def judge_simulated(case: Case) -> Row:
    """Judge a simulated person in a scene, clean and with a second person inserted."""
    frame = _person(case.options["scene"], case.options["motion"], case.options["seed"] + 50)
    return _judged([frame], case.options["seed"])


def judge_recorded(case: Case) -> Row:
    """Judge evenly spaced frames of a recording, clean and with a person inserted."""
    name = case.options["model"]
    frames = list(_streams.turning()) if name == _streams.TURNING else _streams.scene(name)
    step = max(1, len(frames) // case.options["frames"])
    return _judged(frames[::step][: case.options["frames"]], case.options["seed"])


def _person(scene: str, motion: str, seed: int) -> RgbdFrame:
    from manip3d.simulate import BodySimulator

    simulator = BodySimulator(
        scene=scene, motion=motion, tracker="kinect-v2", color="none", seed=seed
    )
    return simulator.frame(1.0)


def _judged(frames: Sequence[RgbdFrame], seed: int) -> Row:
    from manip3d import forge
    from manip3d.authenticate import density_consistency, occlusion_consistency

    actor = _person("room", "wave", seed + 60)
    hoax = points_of(actor, np.asarray(actor.body_index == 0)) + np.array(_ASIDE, np.float32)
    row: Row = {"frames": len(frames)}
    for kind in _KINDS:
        density, occlusion = [], []
        for frame in frames:
            points = points_of(frame)
            if kind == "pasted":
                points = np.concatenate([points, hoax.astype(np.float32)])
            elif kind == "composited":
                moved = forge.stream([actor], frame, kind=1, move=(-_ASIDE[1], 0.0, _ASIDE[0]))
                points = points_of(next(iter(moved)))
            where: dict[str, Any] = {"origin": (0.0, 0.0, 0.0)}
            density.append(density_consistency(points, **where).verdict)
            occlusion.append(occlusion_consistency(points, **where).verdict)
        row[f"I {kind}"] = density.count("tampered")
        row[f"II {kind}"] = occlusion.count("tampered")
        row[f"judged by I {kind}"] = len(density) - density.count("undecidable")
    return row


def points_of(frame: RgbdFrame, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
    """Return the points of a depth image, metres; x ahead, y left, z up."""
    depth = frame.depth if mask is None else np.where(mask, frame.depth, 0)
    rays = frame.calibration.depth.unproject(depth.astype(np.float32) / np.float32(1000.0))
    seen = rays.reshape(-1, 3)[(depth > 0).ravel()]
    return np.ascontiguousarray(np.stack([seen[:, 2], -seen[:, 0], -seen[:, 1]], axis=1))


def _counts(rows: Sequence[Row], detector: str, kind: str) -> tuple[int, int]:
    return sum(r[f"{detector} {kind}"] for r in rows), sum(r["frames"] for r in rows)


def _clean(rows: Sequence[Row]) -> Iterator[Finding]:
    for detector in ("I", "II"):
        accused, total = _counts(rows, detector, "clean")
        judged = sum(r["judged by I clean"] for r in rows)
        more = f", {judged} judged" if detector == "I" else ""
        numbers = f"{accused} of {total} accused{more}"
        yield Finding(f"detector {detector}", accused == 0, numbers)


def _found(kind: str, detectors: Sequence[str], must: bool) -> Callable[..., Iterator[Finding]]:
    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for detector in detectors:
            found, total = _counts(rows, detector, kind)
            yield Finding(
                f"detector {detector}",
                found == total if must else None,
                f"{found} of {total} found",
            )

    return judge


EXPERIMENT = Experiment(
    id="clouds-5",
    title="Detectors I and II on clouds of RGB-D cameras, frames found",
    published="",
    data=_RECORDED,
    cases=_cases,
    role=_streams.ROLE,
    columns=(
        Column("frames", "frames"),
        *(Column(f"{d} {kind}", f"{d}, {kind}") for kind in _KINDS for d in ("I", "II")),
    ),
    claims=(
        Claim("No clean cloud is accused", "section 8.2", _clean),
        Claim(
            "A person pasted into the cloud is found by detector II",
            "section 8.2",
            _found("pasted", ("II",), True),
        ),
        Claim(
            "A person pasted into the cloud, by detector I",
            "section 8.2",
            _found("pasted", ("I",), False),
            reported=True,
        ),
        Claim(
            "A person composited into the depth image",
            "section 8.2",
            _found("composited", ("I", "II"), False),
            reported=True,
        ),
    ),
    notes=(
        "Points are those of a simulated person, 0.3 m farther and 0.5 m to the side. Pasted: "
        "added to the cloud, where the scene behind them stays. Composited: drawn into the depth "
        "image, which has one point a pixel, so that nothing is seen behind anything: detector II "
        "cannot see it by construction, and silhouettes and noise are for that (figure-5.8).",
        "Calibrations of both detectors are those of terrestrial laser scanners.",
    ),
)
