"""Figure 5.5: meshes with and without segmentation, moved by the three methods of skinning."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from manip3d.experiments import _phantom, _streams
from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row

_WAYS: dict[str, dict[str, Any]] = {
    "no segments": {"method": "rigid", "by_label": False},
    "spherical": {"method": "spherical"},
    "rigid": {"method": "rigid"},
    "lbs": {"method": "lbs"},
}


def _cases(plan: Plan) -> list[Case]:
    return [
        Case(view_meshes, {"model": name, "motion": motion, "time": time, "seed": plan.seed})
        for name, motion, time in (
            ("arms up, in the image plane", "arm-raise", 2.0),
            ("arms ahead, towards the camera", "reach", 1.55),
        )
    ]


def view_meshes(case: Case) -> Row:
    """Measure the change of the mesh's edge lengths, and draw pictures."""
    from manip3d import forge, modify
    from manip3d.simulate import BodySimulator

    seed = case.options["seed"]
    actor = BodySimulator(motion="still", tracker="kinect-v2", stripes=True, seed=seed)
    frame, room = actor.frame(0.5), actor.background(0.5)
    pose = BodySimulator(motion=case.options["motion"], seed=seed).frame(case.options["time"])
    row: Row = {"views": {}}
    skeleton, camera = frame.skeletons[0], frame.calibration.depth
    labels = modify.segment_body(
        frame.depth, camera, skeleton, segmentation="region", body_index=frame.body_index
    ).labels
    pictures, masks = {}, np.zeros(frame.depth.shape, bool)
    for name, options in _WAYS.items():
        forged = forge.stream([frame], room, kind=2, pose=[pose], smoothing=False, **options)
        shown = next(forged.frames())
        pictures[name], masks = shown.frame.color, masks | shown.mask
        by_label = options.get("by_label", True)
        mesh = modify.animation_mesh(frame.depth, camera, labels, skeleton, by_label=by_label)
        moved = modify.animate(
            mesh.vertices, mesh.labels, skeleton, pose.skeletons[0], method=options["method"]
        )
        assert moved is not None
        row[name] = _stretch(mesh.vertices, moved.vertices, mesh.faces, mesh.labels)
        row[f"torn {name}"] = _torn(mesh.vertices, moved.vertices, mesh.faces)
    box = _phantom.box_of(masks | np.asarray(pose.body_index == 0), 20)
    for name, picture in {**pictures, "really done": pose.color}.items():
        row["views"][name] = _phantom.packed(np.ascontiguousarray(np.asarray(picture)[box]))
    return row


def _edges(vertices: Any, faces: Any) -> Any:
    return np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2)


def _stretch(before: Any, after: Any, faces: Any, labels: Any) -> float:
    """Return the mean relative change of edge lengths within the upper arms."""
    arm = np.isin(labels[faces], (5, 9)).all(axis=1) & (np.ptp(labels[faces], axis=1) == 0)
    old, new = _edges(before, faces[arm]), _edges(after, faces[arm])
    return float(np.abs(new / old - 1.0).mean())


def _torn(before: Any, after: Any, faces: Any) -> int:
    """Count the triangles with an edge that became longer than 10 cm."""
    return int(((_edges(after, faces) > 0.1) & (_edges(before, faces) < 0.1)).any(axis=1).sum())


def _segments_help(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"{row['torn rigid']} torn triangles, {row['torn no segments']} without segments"
        yield Finding(row["model"], row["torn rigid"] < row["torn no segments"], numbers)


def _plane(rows: Sequence[Row]) -> Iterator[Finding]:
    for row in rows:
        numbers = f"spherical {row['spherical']:.1%}, rigid {row['rigid']:.1%}"
        if "image plane" in row["model"]:
            yield Finding(row["model"], row["spherical"] < 0.05, numbers)
        else:
            yield Finding(row["model"], row["spherical"] > row["rigid"] + 0.02, numbers)


EXPERIMENT = Experiment(
    id="figure-5.5",
    title="Deformed meshes with and without segments, by three methods",
    published="",
    data=(),
    cases=_cases,
    role=_streams.ROLE,
    columns=tuple(Column(name, f"{name}: edges change, %", scale=100.0, digits=1) for name in _WAYS)
    + tuple(Column(f"torn {name}", f"{name}: torn triangles") for name in _WAYS),
    claims=(
        Claim("Fewer triangles are torn with segments", "section 5.1.2", _segments_help),
        Claim(
            "Spherical angles are rigid in the image plane and fail towards the camera",
            "section 5.3",
            _plane,
        ),
    ),
    figures=_phantom.panels,
    notes=(_streams.NOTE, "Edges are those within the upper arms."),
)
