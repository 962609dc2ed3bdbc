"""Results keep copies: callers may write to their arrays after a call."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_argument_kinds import recorded

import kernels
import manip3d
from manip3d import (
    Error,
    InputError,
    LidarFrame,
    authenticate,
    datasets,
    experiments,
    modify,
    simplify,
    simulate,
)
from manip3d.simulate.lidar import lasers


def arrays_of(value: object, depth: int = 0) -> Iterator[NDArray[Any]]:
    """Arrays of a result, also those that it keeps for itself."""
    if isinstance(value, np.ndarray):
        yield value
    elif isinstance(value, list | tuple) and depth < 5:
        for item in value:
            yield from arrays_of(item, depth + 1)
    elif hasattr(value, "items") and depth < 5:
        yield from arrays_of(list(value.values()), depth + 1)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for field in dataclasses.fields(value):
            yield from arrays_of(getattr(value, field.name), depth + 1)


@pytest.mark.parametrize("name", kernels.KERNELS)
def test_no_result_keeps_an_array_that_it_was_given(name: str) -> None:
    """Those within frames and meshes are shared, as their classes say."""
    package_name, _, function_name = name.partition(".")
    package = importlib.import_module(f"manip3d.{package_name}")
    with recorded(package, function_name) as calls:
        result = kernels.KERNELS[name](1)
    given = [value for value in calls[0].values() if isinstance(value, np.ndarray)]
    kept = [array for array in arrays_of(result) if array.size]
    assert not any(np.shares_memory(one, other) for one in given for other in kept)


COLOR = np.full((*kernels.DEPTH.shape, 3), 90, np.uint8)
POSE = np.eye(4)
VALID = np.isfinite(kernels.GRID).all(axis=2)
VIEW = simplify.CameraView(kernels.DEPTH, kernels.CAMERA, color=COLOR, pose=POSE)
GRID_VIEW = simplify.CameraView(points=kernels.GRID, valid=VALID, color=COLOR, pose=POSE)
KEEPERS: dict[str, Callable[[], object]] = {
    "dense": lambda: simplify.dense_mesh(kernels.DEPTH, kernels.CAMERA, color=COLOR),
    "relief": lambda: simplify.relief(kernels.DEPTH, kernels.CAMERA, 60, color=COLOR),
    "grid": lambda: simplify.relief_grid(kernels.GRID, VALID, 60, color=COLOR),
    "cs3": lambda: simplify.cs3(kernels.DEPTH, kernels.CAMERA, 60, color=COLOR),
    "stream": lambda: simplify.ReliefStream(kernels.CAMERA, 60).simplify(
        kernels.DEPTH, color=COLOR
    ),
    "cs3 stream": lambda: simplify.Cs3Stream(60).simplify_grid(kernels.GRID, VALID, color=COLOR),
    "cameras": lambda: simplify.relief_cameras([VIEW, VIEW], 60),
    "cameras of grids": lambda: simplify.cs3_cameras([GRID_VIEW, GRID_VIEW], 60),
}


@pytest.mark.parametrize("name", KEEPERS)
def test_a_buffer_of_pictures_may_be_used_again(name: str) -> None:
    """Textures of all meshes were the last picture, where a camera's buffer was used again."""
    kept = list(arrays_of(KEEPERS[name]()))
    for given in (COLOR, POSE, VALID, kernels.GRID, kernels.DEPTH):
        assert not any(np.shares_memory(given, array) for array in kept if array.size)


def test_the_points_that_were_inspected_are_shown(tmp_path: Path) -> None:
    points = kernels.cloud.copy()
    found = authenticate.inspect(points, origin=(0, 0, 0))
    points[:] = 0  # the next scan comes
    assert found.scan is not None
    np.testing.assert_array_equal(found.scan.points, kernels.cloud)


# --- equality -------------------------------------------------------------------------------------

PACKAGES = [
    "simplify",
    "modify",
    "forge",
    "authenticate",
    "metrics",
    "io",
    "capture",
    "datasets",
    "camera",
    "rgbd",
    "lidar",
    "study",
    "diary",
    "phantom",
    "batch",
    "report",
    "viewer",
]


def dataclasses_of(package: str) -> list[type]:
    try:
        module = importlib.import_module(f"manip3d.{package}")
    except manip3d.errors.MissingExtraError as error:
        pytest.skip(str(error))
    named = (getattr(module, name) for name in getattr(module, "__all__", dir(module)))
    return [item for item in named if isinstance(item, type) and dataclasses.is_dataclass(item)]


@pytest.mark.parametrize("package", PACKAGES)
def test_what_holds_arrays_is_compared_without_an_error(package: str) -> None:
    """``==`` of tuples with arrays has no truth value, nor have they a hash."""
    wrong = [
        kind.__name__
        for kind in dataclasses_of(package)
        if kind.__dataclass_params__.eq  # type: ignore[attr-defined]
        and any("NDArray" in str(field.type) for field in dataclasses.fields(kind))
    ]
    assert wrong == []


def test_results_may_be_looked_for_in_lists() -> None:
    results = [simplify.clean(kernels.hill), simplify.quality(kernels.hill, ratio=0.5)]
    assert results.index(results[1]) == 1
    assert len(set(results)) == 2


# --- closed ---------------------------------------------------------------------------------------


def test_a_closed_watermarker_embeds_nothing(tmp_path: Path) -> None:
    """One that was closed before its first frame embedded as if it were open."""
    with authenticate.KeyFile.create(tmp_path / "sensor.key") as key:
        marker = authenticate.Watermarker(key)
        marker.close()
        with pytest.raises(Error, match="closed"):
            marker.embed(LidarFrame(kernels.on_grid))
        with pytest.raises(InputError, match="scan"):
            marker.embed(None)  # type: ignore[arg-type]


def shared_arrays() -> dict[str, NDArray[Any]]:
    """Arrays that the library computes once and returns to all callers."""
    lattice = authenticate.kitti_lattice()
    camera = simulate.BodySimulator(color="full").calibration.registration
    assert camera is not None
    textures = [surface.texture for surface in simulate.street(1).world.surfaces]
    return {
        **{f"kitti_lattice().{name}": getattr(lattice, name) for name in ("slope", "range_phase")},
        **{f"lasers().{name}": column for name, column in vars(lasers()).items()},
        "rotation": camera.rotation,
        "translation": camera.translation,
        **{f"texture {i}": texture for i, texture in enumerate(textures) if texture is not None},
    }


def test_nobody_can_change_what_all_callers_share() -> None:
    """A what-if on the lattice of KITTI's scanner changed the verdicts of the whole process."""
    shared = shared_arrays()
    assert any(name.startswith("texture") for name in shared)
    for name, array in shared.items():
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
        assert array.any(), name
    mappings: list[Any] = [
        modify.joint_layouts(),
        datasets.registry(),
        experiments.registry(),
    ]
    for mapping in mappings:
        with pytest.raises(TypeError, match="does not support item assignment"):
            mapping["mine"] = ()
