"""Results print themselves in a short line: what a notebook shows, and a failed assertion."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import manip3d
from manip3d import (
    Intrinsics,
    LidarFrame,
    Mesh,
    authenticate,
    metrics,
    modify,
    simplify,
    simulate,
    study,
)
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted

WITHOUT_REPR = {
    "manip3d.modify.ColliderTracker",
    "manip3d.modify.JointSmoother",
    "manip3d.modify.KeyPerson",
    "manip3d.modify.PlacementEstimator",
    "manip3d.modify.PoseTracker",
    "manip3d.modify.ShoeCoverTracker",
    "manip3d.phantom.LiveSession",
    "manip3d.serve.StreamClient",
    "manip3d.study.Study",
}
"""Filters, and objects that users do not make: nothing about them is worth a line."""

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


@dataclass
class Holder:
    small: Any
    large: Any
    hidden: int = field(default=0, repr=False)

    __repr__ = short_repr


ESTIMATE = study.Estimate(np.float64(2 / 3), 1 / 3, 1.0)
SHORT = "Estimate(threshold=0.666667, low=0.333333, high=1)"


@pytest.mark.parametrize(
    ("small", "large", "shown"),
    [
        (np.eye(2), np.zeros((9, 3)), "small=[[1., 0.], [0., 1.]], large=<(9, 3) float64>"),
        (1 / 3, (1, 2, 3), "small=0.333333, large=(1, 2, ...)"),
        (None, [np.zeros(99)] * 3, "small=None, large=[<(99,) float64>, <(99,) float64>, ...]"),
        (np.float64(1 / 3), np.float32(1 / 3), "small=0.333333, large=0.333333"),
        (np.int64(3), [np.bool_(True), 0.1 + 0.2], "small=3, large=[True, 0.3]"),
        (ESTIMATE, {"a": ESTIMATE}, f"small={SHORT}, large={{'a': {SHORT}}}"),
        (Holder(1, 2), {"a": 1}, "small=Holder(small=1, large=2), large={'a': 1}"),
    ],
)
def test_short_repr_leaves_out_what_is_long(small: object, large: object, shown: str) -> None:
    assert repr(Holder(small, large)) == f"Holder({shown})"


def test_an_estimate_of_a_diary_prints_six_digits() -> None:
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Estimate

    found = repr(Estimate(np.float64(1 / 3), 0.0, 1.0, 0.1 + 0.2, 12.0))
    assert found == "Estimate(value=0.333333, low=0, high=1, p=0.3, df=12)"


def test_a_number_has_its_noun_in_singular_or_plural() -> None:
    told = counted(0, "face"), counted(1, "face"), counted(12345, "box", "boxes", separator=",")
    assert told == ("0 faces", "1 face", "12,345 boxes")
    assert repr(Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])) == (
        "<manip3d.Mesh: 3 vertices, 1 face>"
    )


def test_short_repr_of_nested_results_is_cut() -> None:
    assert len(repr(Holder(Holder("a" * 99, "b" * 99), ("c" * 99,) * 9))) < 300


@functools.cache
def street() -> simulate.Street:
    return simulate.street(1)


@functools.cache
def levels() -> simplify.LodChain:
    return simplify.lod_chain(simulate.models.disc(), [500, 100])


HILL = 2.0 - 0.1 * np.hypot(*np.mgrid[-1:1:48j, -1:1:64j]).astype(np.float32)
VIEW = simplify.CameraView(HILL, CAMERA)
FLOOR = simulate.models.floor(2, 2)
NOTHING = LidarFrame(np.zeros((0, 3), np.float32))


def drive_frame() -> simulate.drives.DriveFrame:
    points = np.zeros((5, 3), np.float32)
    scan = simulate.lidar.LidarScan(points, *(np.zeros(5, np.uint8) for _ in range(7)))
    return simulate.drives.DriveFrame(0.5, scan, None, ())


def monitor() -> authenticate.AlertMonitor:
    made = authenticate.AlertMonitor()
    made.skip("too late")
    return made


SHOWN: dict[str, Callable[[], object]] = {
    r"simulate.Street: \d+ faces, 18 movers; car at 4.8 m/s for 62.2 s": street,
    "simulate.streets.Mover: Car, 5.2 m/s": lambda: street().movers[0],
    "simulate.DriveFrame: 5 points, 0 boxes; t = 0.500 s": drive_frame,
    "simulate.BodySimulator: arm-raise, 300 frames": simulate.BodySimulator,
    r"simplify.JointSimplification: \d+ vertices, \d+ faces, 2 views": lambda: (
        simplify.relief_cameras([VIEW, VIEW], 100)
    ),
    "simplify.LodChain: 720, 500, 100 faces": levels,
    "simplify.LodLevel: 500 faces, max_error .*": lambda: levels().levels[1],
    "simplify.ReliefStream: 99 points of 64 x 48 pixels": lambda: simplify.ReliefStream(CAMERA, 99),
    "simplify.Cs3Stream: 99 points a frame": lambda: simplify.Cs3Stream(99),
    "metrics.Comparison: 8 of 8 faces; distance .* rms, .* at most, of the .* diagonal": lambda: (
        metrics.compare(FLOOR, FLOOR)
    ),
    "authenticate.SensorLattice: 64 lasers, 4000 counts per turn, ranges in 2 mm": (
        authenticate.kitti_lattice
    ),
    "authenticate.Inspection: undecidable; the scan has no points; 0 points, unknown scanner": (
        lambda: authenticate.inspect(NOTHING)
    ),
    "authenticate.OcclusionResult: undecidable; .*": lambda: authenticate.occlusion_consistency(
        NOTHING
    ),
    "authenticate.AlertMonitor: 1 frame, 1 skipped, risk none": monitor,
    "authenticate.Alert: skipped; too late; frame 0, risk none": lambda: (
        authenticate.AlertMonitor().skip("too late")
    ),
    "modify.PhantomPipeline: left_leg, reflection": lambda: modify.PhantomPipeline("left_leg"),
}


@pytest.mark.parametrize("shown", SHOWN)
def test_results_say_what_they_are(shown: str) -> None:
    assert re.fullmatch(f"<manip3d.{shown}>", repr(SHOWN[shown]()))


@functools.cache
def public_types() -> dict[str, type]:
    modules = [info.name for info in pkgutil.walk_packages(manip3d.__path__, "manip3d.")]
    found = {
        f"{module}.{name}": getattr(importlib.import_module(module), name)
        for module in ["manip3d", *modules]
        if "._" not in module and module != "manip3d.__main__"
        for name in getattr(importlib.import_module(module), "__all__", ())
    }
    return {name: thing for name, thing in found.items() if inspect.isclass(thing)}


def test_no_result_prints_its_arrays() -> None:
    printed = [
        f"{name}.{each.name}"
        for name, kind in public_types().items()
        if dataclasses.is_dataclass(kind)
        if hasattr(kind.__repr__, "__wrapped__")  # made by `dataclass`
        for each in dataclasses.fields(kind)
        if each.repr and re.search("NDArray|ArrayLike|Floats|Mask", str(each.type))
    ]
    assert printed == []


def test_public_objects_say_more_than_their_address() -> None:
    silent = {
        name
        for name, kind in public_types().items()
        if kind.__repr__ is object.__repr__ and not getattr(kind, "_is_protocol", False)
    }
    assert silent == WITHOUT_REPR
