"""Numbers that come out of NumPy and pandas are numbers, in every public function."""

from __future__ import annotations

import importlib
from enum import IntEnum
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_argument_kinds import call_with, recorded

import kernels
from manip3d import InputError, Intrinsics, Mesh, authenticate, capture, simplify

LAZY = ("forge.at_pace", "forge.stream")
"""Their results make frames when they are asked for."""


WITHOUT_SCALARS = {
    "authenticate.are_same_points",
    "authenticate.attack_type",
    "authenticate.combined_verdict",
    "authenticate.compare_paper",
    "authenticate.cross_modal_consistency",
    "authenticate.estimate_lattice",
    "authenticate.inspect_stream",
    "authenticate.inter_frame_noise",
    "authenticate.judge_drive",
    "authenticate.judged_frames",
    "authenticate.kitti_lattice",
    "authenticate.points_id",
    "authenticate.record_of_picture",
    "authenticate.stereo_disparity",
    "authenticate.surround_consistency",
    "authenticate.verdict_of_drive",
    "authenticate.without_record",
    "forge.background_plate",
    "forge.nearest_object",
    "forge.range_scale",
    "forge.without_people",
    "modify.animate",
    "modify.body_mirror",
    "modify.clothing_colors",
    "modify.joint_layouts",
    "modify.skeletons_from_motion",
    "simplify.boundary_vertices",
    "simplify.grid_delaunay",
    "simplify.simplify_depth",
}
"""Functions whose calls in `kernels` have no number as an argument."""


class Number(IntEnum):
    """A number of a program's own."""

    SIXTY = 60


def as_scalar(value: Any) -> Any:
    """The same value as NumPy has it; None: it is no single value."""
    if isinstance(value, bool):
        return np.bool_(value)
    if isinstance(value, int):
        return np.int64(value)
    if isinstance(value, float):
        return np.float64(value)
    if isinstance(value, tuple) and value and all(type(item) in (int, float) for item in value):
        return np.array(value)
    return None


def results(value: Any) -> Any:
    return list(value) if hasattr(value, "__next__") else value


@pytest.mark.parametrize("name", sorted(kernels.KERNELS.keys() - WITHOUT_SCALARS))
def test_kernels_take_scalars_of_numpy(name: str) -> None:
    """An np.int64 was looked for in a range of 2^64 numbers, one after the other."""
    package_name, _, function_name = name.partition(".")
    package = importlib.import_module(f"manip3d.{package_name}")
    with recorded(package, function_name) as calls:
        kernels.KERNELS[name](1)
    function, arguments = getattr(package, function_name), calls[0]
    scalars = {
        argument: scalar
        for argument, value in arguments.items()
        if (scalar := as_scalar(value)) is not None
    }
    assert scalars, "no argument is a number: add the function to WITHOUT_SCALARS"
    expected = kernels.hash_of(results(call_with(function, arguments)))
    for argument, scalar in scalars.items():
        found = results(call_with(function, arguments | {argument: scalar}))
        if name not in LAZY:
            assert kernels.hash_of(found) == expected, argument


@pytest.mark.parametrize("count", [np.int64(60), np.uint8(60), np.int32(60), Number.SIXTY])
def test_whole_numbers_of_all_kinds(count: Any) -> None:
    mesh = simplify.relief(kernels.DEPTH, kernels.CAMERA, count, effort="live", threads=1)
    assert kernels.hash_of(mesh) == kernels.hash_of(
        simplify.relief(kernels.DEPTH, kernels.CAMERA, 60, effort="live", threads=1)
    )
    with pytest.raises(InputError, match="target_points: expected a whole number of 64 bits"):
        simplify.relief(kernels.DEPTH, kernels.CAMERA, np.uint64(2**63))
    assert capture.from_frames(kernels.walk)[np.int64(2)] is kernels.walk[2]
    assert Intrinsics(count, count, 9, 9, 5, 5).width == 60


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        (RuntimeError("Use\ntensor.detach()"), r"Use tensor\.detach\(\)$"),  # needs its gradient
        (TypeError("Please use `.get()`"), r"Please use `\.get\(\)`$"),  # CuPy
        (NotImplementedError("Cannot copy out of meta tensor"), "Cannot copy out of meta tensor$"),
        (
            TypeError("Got unsupported ScalarType BFloat16"),
            "BFloat16; .* to float32 first$",
        ),
    ],
)
def test_a_tensor_that_is_no_array_is_refused_with_its_own_advice(
    error: Exception, advice: str
) -> None:
    """PyTorch says by its error that ``detach()`` or ``cpu()`` makes an array."""

    class Tensor:
        def __array__(self, *_: Any, **__: Any) -> NDArray[Any]:
            raise error

        def __repr__(self) -> str:
            return "tensor([[1.],\n        [2.]])"

    told = "got an object of type Tensor, which NumPy cannot read: .*" + advice
    with pytest.raises(InputError, match=f"vertices: expected an array, {told}"):
        Mesh(Tensor(), np.zeros((0, 3), int))  # type: ignore[arg-type]
    camera = kernels.CAMERA
    with pytest.raises(InputError, match=f"depth: expected an array of numbers, {told}"):
        simplify.relief(Tensor(), camera, 60)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=f"confidence: expected an array .* or None, {told}"):
        simplify.relief(kernels.DEPTH, camera, 60, confidence=Tensor())  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"points: .*, got tensor\(\[\[1\.\], \[2\.\]\]\)$"):
        simplify.relief(kernels.DEPTH, camera, Numbers())  # type: ignore[arg-type]
    for name in ("registration", "effort"):  # they take no array, so that its advice is none here
        with pytest.raises(InputError, match=rf"{name}: .*, got tensor\(\[\[1\.\], \[2\.\]\]\)$"):
            simplify.relief(kernels.DEPTH, camera, 60, **{name: Tensor()})  # type: ignore[arg-type]
    view = simplify.CameraView(Numbers(), camera)  # type: ignore[arg-type]
    assert "depth=tensor([[1.], [2.]])," in repr(view)


def test_tables_of_objects_are_refused_with_a_cure() -> None:
    """Columns of pandas that may have missing numbers are objects for NumPy."""
    table = pytest.importorskip("pandas").DataFrame(kernels.cloud, columns=list("xyz"))
    told = r"points: expected an array of numbers, got a DataFrame that NumPy reads as objects; "
    with pytest.raises(InputError, match=told + r"make it numbers first \(\.to_numpy\(float\)\)$"):
        authenticate.points_id(table.convert_dtypes())
    assert authenticate.points_id(table.convert_dtypes().to_numpy(float)) == (
        authenticate.points_id(table)
    )


def test_numbers_of_a_camera_may_need_their_gradient() -> None:
    """They are numbers for Python, while NumPy makes no arrays of them."""

    class Scalar:
        def __array__(self, *_: Any, **__: Any) -> NDArray[Any]:
            raise RuntimeError("Use tensor.detach()")

        def __float__(self) -> float:
            return 50.0

    class Complex(Scalar):
        def __float__(self) -> float:
            raise RuntimeError("value cannot be converted to type double")

        def __repr__(self) -> str:
            return "tensor(\n50.j)"

    lens = [Scalar()] * 5
    camera = Intrinsics(64, 48, Scalar(), 50, 32, 24, lens)  # type: ignore[arg-type]
    assert (camera.fx, camera.distortion) == (50.0, (50.0,) * 5)
    for number in (Complex(), np.complex128(50), 50j):
        with pytest.raises(InputError, match=r"intrinsics\.fx: expected a number, got .*50.*j"):
            Intrinsics(64, 48, number, 50, 32, 24)  # type: ignore[arg-type]


class Numbers:
    """An array of another library, which NumPy can read."""

    def __array__(self, *_: Any, **__: Any) -> NDArray[Any]:
        return np.array([[1.0], [2.0]])

    def __repr__(self) -> str:
        return "tensor([[1.],\n        [2.]])"
