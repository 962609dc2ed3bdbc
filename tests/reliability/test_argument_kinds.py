"""Every public function refuses arguments of wrong kinds by an `InputError` that names them."""

from __future__ import annotations

import importlib
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, get_origin

import numpy as np
import pytest

import capsule_body
import kernels
import manip3d
from manip3d import authenticate, capture, diary, io, study, viewer

WRONG: dict[str, object] = {
    "object": object(),
    "word": "seven",
    "text with NUL": "a\0b",
    "bytes": b"seven",
    "number": 10.5,
    "negative": -1,
    "huge": 2**70,
    "hugest float": 1e308,
    "nan": float("nan"),
    "infinity": float("inf"),
    "complex": 1j,
    "nothing": None,
    "truth": True,
    "list": [],
    "ragged": [[1, 2], [3]],
    "mapping": {"a": 1},
    "set": {1},
    "function": len,
    "class": int,
    "words": np.array(["a", "b"]),
    "objects": np.array([object(), None]),
    "complex array": np.array([1 + 2j]),
    "nan array": np.full((2, 3), np.nan),
    "empty array": np.empty((0, 3)),
    "dates": np.array(["2020-01-01"], dtype="datetime64[D]"),
    "many axes": np.zeros((1,) * 7),
}


USELESS = ("object", "class", "set", "complex", "ragged", "objects", "complex array", "dates")
"""Kinds of values that no argument accepts."""

CHOICES = {
    name
    for module in tuple(sys.modules.values())
    if module.__name__.startswith("manip3d.")
    for name, value in vars(module).items()
    if get_origin(value) is Literal
}
"""Names of annotations that list the texts an argument may be."""


def takes_a_choice(function: Callable[..., Any], name: str) -> bool:
    parameter = inspect.signature(function).parameters.get(name)
    words = set(re.findall(r"\w+", str(parameter.annotation))) if parameter else set()
    return not words.isdisjoint(CHOICES | {"Literal"})


@contextmanager
def recorded(package: Any, name: str) -> Iterator[list[dict[str, Any]]]:
    """Record the arguments, by name, of calls of a function of a package."""
    function, calls = getattr(package, name), []
    signature = inspect.signature(function)

    def recording(*args: Any, **kwargs: Any) -> Any:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        calls.append(dict(bound.arguments))
        return function(*args, **kwargs)

    setattr(package, name, recording)
    try:
        yield calls
    finally:
        setattr(package, name, function)


def call_with(function: Callable[..., Any], arguments: dict[str, Any]) -> Any:
    positional, named = [], {}
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in arguments and parameter.kind is not parameter.VAR_KEYWORD:
            continue  # as it is by default
        if parameter.kind is parameter.POSITIONAL_ONLY:
            positional.append(arguments[name])
        elif parameter.kind is parameter.VAR_KEYWORD:
            named |= arguments.get(name, {k: v for k, v in arguments.items() if k not in named})
        else:
            named[name] = arguments[name]
    return function(*positional, **named)


@pytest.mark.parametrize("name", kernels.KERNELS)
def test_kernels(name: str) -> None:
    package_name, _, function_name = name.partition(".")
    package = importlib.import_module(f"manip3d.{package_name}")
    with recorded(package, function_name) as calls:
        kernels.KERNELS[name](1)
    drive(getattr(package, function_name), calls[0])


def drive(function: Callable[..., Any], arguments: dict[str, Any]) -> None:
    """Call a function with each argument replaced by each wrong value."""
    problems = []
    for name in arguments:
        for kind, wrong in WRONG.items():
            if name in ("progress", "show") and callable(wrong):
                continue  # right, until it is called
            try:
                call_with(function, arguments | {name: wrong})
            except manip3d.Error as error:
                if kind in USELESS and name not in str(error):
                    problems.append(f"{name}={kind}: does not name it: {error}")
            except Exception as error:
                problems.append(f"{name}={kind}: {type(error).__name__}: {str(error)[:80]!r}")
            else:
                if kind in USELESS or (kind == "word" and takes_a_choice(function, name)):
                    problems.append(f"{name}={kind}: accepted")
    assert not problems, "\n".join(problems)


PERSON = capsule_body.painted(0)
IN_COLOR = replace(PERSON, color=np.zeros((*PERSON.depth.shape, 3), np.uint8))
POSE = PERSON.skeletons[0]

Methods = dict[str, dict[str, Any]]
OBJECTS: dict[str, tuple[dict[str, Any], Methods]] = {
    "simplify.Cs3Stream": (
        {"target_points": 60, "variant": "cios", "max_edge": 0.2, "distance_dependent": False,
         "threads": 1, "reading": None, "frames": 2},
        {"simplify": {"depth": kernels.DEPTH, "intrinsics": kernels.CAMERA},
         "simplify_grid": {"points": kernels.GRID, "valid": None, "rows_up": True}},
    ),
    "simplify.ReliefStream": (
        {"intrinsics": kernels.CAMERA, "target_points": 60, "registration": None,
         "move_points": False, "effort": "live", "max_edge": 0.2, "stability": 30.0,
         "newest_share": 0.2, "gate": 0.03, "threads": 1, "bandwidth": 1e5, "rate": 30.0},
        {"simplify": {"depth": kernels.DEPTH, "color": None, "mask": None, "confidence": None,
                      "time_ns": 0}},
    ),
    "modify.ColliderTracker": (
        {"percentile": 0.9, "frames": 30, "min_points": 20, "min_radius": 0.03,
         "max_radius": 0.2, "first_radius": 0.05},
        {"update": {"skeleton": POSE, "labels": np.zeros(9, np.uint8),
                    "squared_distances": np.zeros(9, np.float32)},
         "hits": {"start": np.zeros((2, 3)), "end": np.ones((2, 3)), "radius": 0.1}},
    ),
    "modify.ShoeCoverTracker": (
        {"hue": (100, 130), "min_saturation": 90, "min_value": 40, "reach": 0.35},
        {"update": {"frame": IN_COLOR, "skeleton": POSE, "side": "left"}},
    ),
    "modify.PlacementEstimator": (
        {"share": 0.9, "spread": 0.35, "stable_frames": 60, "tolerance": 0.02},
        {"update": {"skeleton": POSE, "intact": "left"}},
    ),
    "modify.PhantomPipeline": (
        {"affected": "right_arm", "mode": "reflection", "plane": None, "smoothing": "default",
         "segmentation": "skin", "arm_radius": 0.13, "keep_residual": False, "near": 0.3,
         "hold_seconds": 0.5, "texturing": "source"},
        {"process": {"frame": PERSON}, "select": {"person": 1}},
    ),
    "forge.StreamForger": (
        {"background": PERSON, "kind": 2, "pose": [POSE], "method": "lbs", "scope": "limbs",
         "move": (0.0, 0.0, 0.1), "surface": "mesh", "fill_pinholes": True, "blend": 1,
         "smoothing": True, "by_label": True},
        {"process": {"frame": PERSON}},
    ),
    "modify.JointSmoother": (
        {"preset": "default", "smoothing": 0.2, "jitter_radius": None},
        {"add": {"skeleton": POSE}},
    ),
    "modify.KeyPerson": (
        {"patience": 1.0, "reach": 0.5, "forget": 10.0},
        {"find": {"people": [POSE], "camera": capsule_body.SMALL, "time": 0.0,
                  "clothes": np.zeros((1, 15), np.float32)},
         "select": {"person": 1}},
    ),
}  # fmt: skip
"""Objects that hold a state: arguments of the constructor, and of the methods."""


@pytest.mark.parametrize("name", OBJECTS)
def test_objects_with_state(name: str) -> None:
    package, _, class_name = name.partition(".")
    kind = getattr(importlib.import_module(f"manip3d.{package}"), class_name)
    options, methods = OBJECTS[name]
    drive(kind, options)
    for method, arguments in methods.items():
        drive(lambda method=method, **given: getattr(kind(**options), method)(**given), arguments)


VALUES = (
    PERSON,
    POSE,
    PERSON.calibration,
    capsule_body.SMALL,
    manip3d.Registration(capsule_body.SMALL),
    manip3d.LidarFrame(np.zeros((3, 3), np.float32)),
    manip3d.lidar.Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    authenticate.DensityParameters(),
    authenticate.OcclusionParameters(),
    authenticate.Disparity(np.ones((2, 2), np.float32)),
    diary.MCGILL,
    io.Motion(("hip",), (-1,), np.zeros((2, 1, 3)), 0.1),
    study.SimulatedObserver(20.0),
    viewer.DrawnPoints(np.zeros((3, 3), np.float32)),
)
"""Objects without a state, which are their arguments."""


@pytest.mark.parametrize("value", VALUES, ids=lambda value: type(value).__name__)
def test_objects_without_state(value: Any) -> None:
    drive(type(value), {one.name: getattr(value, one.name) for one in fields(value)})


OTHERS: dict[str, dict[str, Any]] = {
    "study.px_per_degree": {"card_px": 320.0, "distance_cm": 60.0},
    "study.estimate_threshold": {"trials": [(20, True), (15, False)]},
    "study.required_participants": {"effect": 1.0, "power": 0.8, "alpha": 0.05, "comparisons": 1},
    "study.reversal_mean": {"stairs": None},
    "study.state_of": {"study": None, "session": None},
    "study.simulate_participants": {"study": None, "folder": None, "count": 1, "seed": 0},
    "report.place_sentence": {"inspection": None},
    "serve.bundled_pages": {"name": "live", "title": "a", "body": "b"},
    "serve.read_message": {"text": '{"type": "a"}', "types": {"a": {}}, "max_length": 99},
    "phantom.simulated_patient": {"limb": "left_leg", "game": None},
    "batch.run_stored": {"tasks": {}, "store": None, "jobs": 1},
    "experiments.select": {"ids": []},
    "viewer.rgbd_picture": {"frame": PERSON},
    "viewer.sheet": {"images": [np.zeros((4, 4, 3), np.uint8)]},
    "viewer.png_bytes": {"image": np.zeros((4, 4, 3), np.uint8)},
    "viewer.forgery_points": {"forgery": None},
    "viewer.frame_times": {"meshes": [], "drawn_by": "chromium"},
    "viewer.box_lines": {"boxes": []},
    "datasets.RangeImageFolder": {"path": None},
    "datasets.KittiDrive": {"path": None, "calibration": None},
    "io.is_url": {"source": "a.ply"},
    "io.local_copy": {"source": "a.ply", "max_bytes": None},
    "io.local_output": {"output": "a.ply"},
    "forge.ForgedStream": {"source": [], "forger": None},
}
"""Functions that are no kernels, with their arguments; None where no right one is needed."""


@pytest.mark.parametrize("name", OTHERS)
def test_other_functions(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrong values give a result, an error of ours, or an OSError, and no other exception."""
    monkeypatch.chdir(tmp_path)
    package, _, function_name = name.partition(".")
    function = getattr(importlib.import_module(f"manip3d.{package}"), function_name)
    problems = []
    for argument in OTHERS[name]:
        for kind, wrong in WRONG.items():
            try:
                call_with(function, OTHERS[name] | {argument: wrong})
            except (manip3d.Error, OSError):
                continue
            except Exception as error:
                problems.append(f"{argument}={kind}: {type(error).__name__}: {str(error)[:80]!r}")
            else:
                if kind in USELESS:
                    problems.append(f"{argument}={kind}: accepted")
    assert not problems, "\n".join(problems)


def test_sources() -> None:
    """A wrong timeout is refused before the source waits for anything."""
    live = capture.open_lidar("velodyne:0")
    try:
        for read in (live.read, live.read_latest, capture.from_frames([PERSON]).read):
            for wrong in ("soon", object(), [1.0], True, -1.0, float("nan")):
                with pytest.raises(manip3d.InputError, match="timeout"):
                    read(wrong)  # type: ignore[arg-type]
    finally:
        live.stop()
