"""The types that everybody shares: what they refuse, when they are equal, what they convert."""

from __future__ import annotations

import copy
import json
import pickle
import sys
import weakref
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import kernels
from manip3d import (
    Box,
    InputError,
    Intrinsics,
    LidarFrame,
    Mesh,
    Registration,
    RgbdCalibration,
    RgbdFrame,
    Skeleton,
    authenticate,
    forge,
    modify,
    simplify,
    viewer,
)

JOINTS = np.tile([0.0, 0.0, 2.0], (25, 1))
CAMERA = Intrinsics(64, 48, fx=60, fy=60, cx=31.5, cy=23.5)
DEPTH = np.full((48, 64), 2000, np.uint16)
SCAN = LidarFrame(np.eye(3), ring=np.arange(3))
ANY: Any = None

WRONG: dict[str, tuple[Callable[[], Any], str]] = {
    "states that would wrap": (lambda: Skeleton(JOINTS, states=np.full(25, 257)), "states.*257"),
    "states between": (lambda: Skeleton(JOINTS, states=np.full(25, 1.7)), "states.*1.7"),
    "states that are not": (lambda: Skeleton(JOINTS, states=np.full(25, np.nan)), "states.*nan"),
    "words for joints": (lambda: Skeleton([["a"] * 3] * 25), "positions: expected numbers"),
    "complex joints": (lambda: Skeleton(JOINTS + 1j), "positions: expected numbers"),
    "24 joints": (lambda: Skeleton(JOINTS[1:]), r"positions: expected shape \(25, 3\)"),
    "half a body": (lambda: Skeleton(JOINTS, body=1.5), "skeleton.body"),  # type: ignore[arg-type]
    "a camera for a calibration": (
        lambda: RgbdFrame(DEPTH, CAMERA),  # type: ignore[arg-type]
        r"RgbdCalibration\(camera\)",
    ),
    "no camera": (lambda: RgbdCalibration(ANY), "calibration.depth: expected Intrinsics"),
    "a camera for a registration": (
        lambda: RgbdCalibration(CAMERA, CAMERA),  # type: ignore[arg-type]
        "calibration.registration",
    ),
    "one skeleton": (
        lambda: RgbdFrame(DEPTH, RgbdCalibration(CAMERA), skeletons=Skeleton(JOINTS)),  # type: ignore[arg-type]
        "frame.skeletons",
    ),
    "words for skeletons": (
        lambda: RgbdFrame(DEPTH, RgbdCalibration(CAMERA), skeletons=("a",)),  # type: ignore[arg-type]
        "frame.skeletons",
    ),
    "words for rays": (lambda: Intrinsics(2, 2, 1, 1, 0, 0, rays=ANY or "a"), "rays"),
    "no distortion": (lambda: Intrinsics(2, 2, 1, 1, 0, 0, distortion=ANY), "distortion"),
    "words for materials": (
        lambda: Mesh(np.eye(3), [[0, 1, 2]], materials=ANY or "ab"),
        "materials",
    ),
    "no materials": (lambda: Mesh(np.eye(3), [[0, 1, 2]], materials=ANY), "materials"),
    "a word for a turn": (lambda: Box((0, 0, 0), (1, 1, 1), ANY or "a"), "yaw"),
    "no turn": (lambda: Box((0, 0, 0), (1, 1, 1), ANY), "yaw"),
    "pairs for fields": (lambda: LidarFrame(np.eye(3), fields=ANY or [("a", [1])]), "fields"),
    "numbers for names": (lambda: LidarFrame(np.eye(3), fields=ANY or {1: [1, 2, 3]}), "fields"),
    "a row too far": (lambda: SCAN.select([3]), r"rows: expected values in \[-3, 2\], got 3"),
    "a row between": (lambda: SCAN.select([0.5]), "rows: expected a mask or integers"),
    "rows of rows": (lambda: SCAN.select([[0, 1]]), "rows: expected a mask or integers"),
    "a word for depth": (lambda: CAMERA.unproject(ANY or "a", pixels=(1, 2)), "depth"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_such_thing_is_refused(name: str) -> None:
    """Values that wrapped round, or an error of NumPy's that names no argument."""
    make, message = WRONG[name]
    with pytest.raises(InputError, match=message):
        make()


def test_coordinates_beyond_float32_are_refused_without_a_warning() -> None:
    with pytest.raises(InputError, match="got inf in row 0"):  # warnings are errors here
        LidarFrame(np.full((2, 3), 1e39))


@pytest.mark.parametrize(
    ("number", "is_exact"),
    [
        (np.int64(2**53), True),
        (np.int64(2**53 + 1), False),
        (np.int64(-(2**53) - 1), False),
        (np.int64(2**60), True),
        (np.int64(-(2**63)), True),
        (np.int64(2**63 - 1), False),
        (np.uint64(2**63), True),
        (np.uint64(2**64 - 1), False),
        (np.uint64(2**64 - 2**11), True),
        (np.uint64(2**64 - 2**10), False),
    ],
)
def test_integers_that_float64_rounds_are_refused(number: np.integer[Any], is_exact: bool) -> None:
    """A Mesh promises that nothing is lost; these were rounded to the next float."""
    vertices = np.zeros((3, 3), number.dtype)
    vertices[1, 2] = number
    if is_exact:
        assert int(Mesh(vertices, [[0, 1, 2]]).vertices[1, 2]) == int(number)
        return
    with pytest.raises(InputError, match=f"vertices: expected .* float64 .* exactly, got {number}"):
        Mesh(vertices, [[0, 1, 2]])


def test_no_rows_may_be_selected() -> None:
    """An empty list has no integers."""
    assert SCAN.select([]).num_points == 0
    assert SCAN.select(np.zeros(3, np.bool_)).num_points == 0
    assert SCAN.select([-1, 0]).ring.tolist() == [2, 0]  # type: ignore[union-attr]


def test_depths_of_pixels_have_the_unit_of_their_image() -> None:
    """Millimetres as uint16, metres as floats: what is indexed out of an image keeps its unit."""
    pixels = np.array([[61.5, 23.5], [31.5, 23.5]])
    rows = np.array([[1.0, 0.0, 2.0], [0.0, 0.0, 2.0]])
    for depth in (DEPTH[0, :2], np.float32([2.0, 2.0]), 2.0, 2, DEPTH[0, 0]):
        np.testing.assert_array_equal(CAMERA.unproject(depth, pixels), rows)


RAYS = np.full((48, 64, 2), 0.25, np.float32)
VALUES: dict[str, Callable[[], Any]] = {
    "camera": lambda: Intrinsics(64, 48, fx=60, fy=60, cx=31.5, cy=23.5, distortion=[0.1] * 5),
    "ray table": lambda: replace(CAMERA, rays=RAYS.copy()),
    "registration": lambda: Registration(CAMERA, np.eye(3), np.array([0.1, 0, 0])),
    "calibration": lambda: RgbdCalibration(CAMERA, Registration(CAMERA)),
    "box": lambda: Box((1, 2, 3), (4, 5, 6), 0.5),
    "box of arrays": lambda: Box(np.array([1, 2, 3]), np.float32([4, 5, 6]), np.float64(0.5)),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("name", VALUES)
@pytest.mark.parametrize("how", [copy.copy, copy.deepcopy, lambda v: pickle.loads(pickle.dumps(v))])
def test_values_are_equal_to_their_copies(name: str, how: Callable[[Any], Any]) -> None:
    """A camera was not equal to the one that a process pool gave back."""
    value = VALUES[name]()
    assert value == how(value) == VALUES[name]()
    assert hash(value) == hash(how(value))
    assert value != CAMERA
    assert value is not None


def test_other_values_are_others() -> None:
    assert replace(CAMERA, fx=61) != CAMERA
    assert replace(CAMERA, rays=RAYS) != CAMERA
    assert replace(CAMERA, rays=RAYS) != replace(CAMERA, rays=RAYS + np.float32(1))
    assert Registration(CAMERA) != Registration(CAMERA, translation=np.ones(3))


def test_a_box_of_arrays_is_a_box_of_numbers() -> None:
    box = Box(np.float32([1, 2, 3]), np.array([4, 5, 6]))  # type: ignore[arg-type]
    assert json.loads(json.dumps(asdict(box)))["size"] == [4.0, 5.0, 6.0]


# --- coordinates of maps --------------------------------------------------------------------------


@pytest.mark.parametrize("make", [LidarFrame, authenticate.estimate_origin, forge.segment])
def test_coordinates_that_float32_rounds_raise_a_warning(make: Callable[[Any], object]) -> None:
    """Half a metre between two neighbours at UTM's northings, without a word."""
    points = np.random.default_rng(0).uniform(-30, 30, (3000, 3))
    place = np.array([500_000.0, 5_400_000.0, 200.0])
    with pytest.warns(UserWarning, match=r"rounds these coordinates by up to 0\.25 m") as warned:
        make(points + place)
    assert warned[0].filename == __file__
    make(points)  # near zero: no warning
    make(np.rint(points) + place)  # float32 holds them


def test_other_points_of_a_frame_that_float32_rounds_raise_a_warning() -> None:
    frame = LidarFrame(np.zeros((2, 3)))
    with pytest.warns(UserWarning, match=r"^points: float32 rounds .* by up to 0\.2 m") as warned:
        frame.with_points([[0, 5_400_000.2, 0], [1, 2, 3]], source_index=[0, 1])
    assert warned[0].filename == __file__


def test_coordinates_that_are_kept_raise_no_warning() -> None:
    exact = np.eye(3) / 3 + 5_400_000.0
    assert LidarFrame(exact, exact=exact).exact is exact


# --- masked arrays --------------------------------------------------------------------------------


def masked(array: Any) -> Any:
    values = np.asarray(array)
    return np.ma.masked_array(values, np.arange(values.size).reshape(values.shape) == 0)


MASKED: dict[str, Callable[[], Any]] = {
    "function": lambda: simplify.dense_mesh(masked(kernels.DEPTH), kernels.CAMERA),
    "camera": lambda: CAMERA.unproject(masked(DEPTH)),
    "pixels": lambda: CAMERA.unproject(2.0, masked([1.0, 2.0])),
    "frame": lambda: RgbdFrame(masked(DEPTH), RgbdCalibration(CAMERA)),
    "scan": lambda: LidarFrame(masked(np.eye(3))),
    "column": lambda: LidarFrame(np.eye(3), fields={"a": masked([1, 2, 3])}),
    "mesh": lambda: Mesh(masked(np.eye(3)), [[0, 1, 2]]),
    "box": lambda: SCAN.select(masked([0, 1])),
    "skeleton": lambda: Skeleton(masked(JOINTS)),
    "index": lambda: SCAN.with_points(np.eye(3), source_index=masked([0, 1, 2])),
    "confidence of a view": lambda: view_with(confidence=masked(np.ones(WIDE, np.float32))),
    "mask of a view": lambda: view_with(mask=masked(np.ones(WIDE, bool))),
    "colour of a view": lambda: view_with(color=masked(np.zeros((*WIDE, 3), np.uint8))),
    "values of points": lambda: viewer.drawn_points(np.eye(3), values={"a": masked([1, 2, 3])}),
    "suspected points": lambda: viewer.evidence(
        SCAN, verdict="tampered", suspected={"I": masked([0, 1])}
    ),
}
WIDE = kernels.DEPTH.shape


def view_with(**fields: Any) -> Any:
    view = simplify.CameraView(kernels.DEPTH, kernels.CAMERA, **fields)
    return simplify.cs3_cameras([view], 60)


@pytest.mark.parametrize("name", MASKED)
def test_masked_elements_are_no_measurements(name: str) -> None:
    """The mask was dropped, and what lies under it counted as measured."""
    with pytest.raises(InputError, match=r"1 masked elements? of \d+; fill them"):
        MASKED[name]()


def test_a_thread_that_is_importing_masked_arrays_disturbs_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The frame thread of a live session ended: "partially initialized module 'numpy.ma'"."""
    monkeypatch.setitem(sys.modules, "numpy.ma", ModuleType("numpy.ma"))
    assert simplify.dense_mesh(kernels.DEPTH, kernels.CAMERA).mesh.num_vertices > 0


def test_a_masked_array_without_masked_elements_is_an_array(tmp_path: Path) -> None:
    depth = np.ma.masked_equal(kernels.DEPTH, 0)
    assert simplify.dense_mesh(depth, kernels.CAMERA).mesh.num_vertices > 0
    with pytest.raises(InputError, match="masked"):
        simplify.dense_mesh(np.ma.masked_greater(kernels.DEPTH, 1300), kernels.CAMERA)
    filled = np.ma.masked_greater(kernels.DEPTH, 1300).filled(0)
    assert simplify.dense_mesh(filled, kernels.CAMERA).mesh.num_vertices > 0


# --- byte order -----------------------------------------------------------------------------------

SWAPPED: dict[str, Callable[[Any], Any]] = {
    "frame": lambda depth: RgbdFrame(depth, kernels.person.calibration).depth,
    "noise": authenticate.depth_noise,
    "segments": lambda depth: modify.segment_body(depth, BODY, kernels.skeleton).labels,
    "mesh": lambda depth: modify.animation_mesh(depth, BODY, kernels.LABELS).vertices,
}
BODY = kernels.person.calibration.depth


@pytest.mark.parametrize("name", SWAPPED)
def test_depth_of_either_byte_order_is_the_same(name: str) -> None:
    depth = kernels.person.depth
    found, expected = SWAPPED[name](depth.astype(">u2")), SWAPPED[name](depth)
    assert found.dtype.isnative
    np.testing.assert_array_equal(found, expected)


def test_all_that_is_shown_has_weak_references() -> None:
    mesh = Mesh(np.eye(3), [[0, 1, 2]])
    assert weakref.ref(mesh)() is mesh
    assert weakref.WeakValueDictionary(mesh=mesh)["mesh"].replace().num_faces == 1
    assert weakref.ref(SCAN)() is SCAN
