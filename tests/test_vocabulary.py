"""Public identifiers say one thing by one word."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

import manip3d

# Words of which no public identifier is made any more, and what is said instead. The list grows
# with each name that is retired, and never shrinks.
RETIRED = {
    "bbox": "box",
    "callback": "progress",
    "cloud": "points",
    "colour": "color",
    "colours": "colors",
    "fname": "path",
    "filename": "path",
    "flag": "is_..., has_...",
    "gray": "the colour's name",
    "img": "depth, color",
    "nfaces": "num_faces",
    "nthreads": "threads",
    "pc": "points",
    "pcd": "points",
    "pts": "points",
    "tri": "face",
    "triangles": "faces",
    "tris": "faces",
    "uvs": "texcoords",
    "vert": "vertex",
    "verts": "vertices",
    "workers": "jobs",
}
RETIRED_NAMES = {
    "lift": "Intrinsics.unproject",
    "num_threads": "threads",
    "num_triangles": "num_faces",
    "n_faces": "num_faces",
    "n_points": "num_points",
    "random_state": "rng",
    "timestamp": "time_ns",
    "uv_coords": "texcoords",
    "verbose": "progress",
}


def public_modules() -> Iterator[ModuleType]:
    yield manip3d
    for found in pkgutil.walk_packages(manip3d.__path__, "manip3d."):
        if not any(part.startswith("_") for part in found.name.split(".")):
            yield importlib.import_module(found.name)


def identifiers() -> dict[str, set[str]]:
    """Every public name, method, field and parameter of the package, and where it stands."""
    found: dict[str, set[str]] = {}

    def note(name: str, where: str) -> None:
        if not name.startswith("_"):
            found.setdefault(name, set()).add(where)

    def parameters(function: Any, where: str) -> None:
        try:
            signature = inspect.signature(function)
        except (TypeError, ValueError):
            return
        for name in signature.parameters:
            note(name, f"{where}()")

    for module in public_modules():
        for name, value in vars(module).items():
            if name.startswith("_") or isinstance(value, ModuleType):
                continue
            if not getattr(value, "__module__", "manip3d").startswith("manip3d"):
                continue
            where = f"{module.__name__}.{name}"
            note(name, module.__name__)
            if callable(value):
                parameters(value, where)
            if inspect.isclass(value):
                for member, content in vars(value).items():
                    note(member, where)
                    if not member.startswith("_") and callable(content):
                        parameters(content, f"{where}.{member}")
                for member in getattr(value, "__annotations__", {}):
                    note(member, where)
    return found


def retired(found: dict[str, set[str]]) -> dict[str, list[str]]:
    """Those of the identifiers that are, or are made of, a retired word; and where they stand."""
    return {
        name: sorted(where)
        for name, where in found.items()
        if name in RETIRED_NAMES or RETIRED.keys() & set(name.lower().split("_"))
    }


def test_no_public_identifier_is_retired() -> None:
    assert retired(identifiers()) == {}


def test_the_walk_sees_functions_parameters_members_and_fields() -> None:
    found = identifiers()
    assert "manip3d.simplify" in found["qem4vr"]
    assert "manip3d.simplify.qem4vr()" in found["seam_weight"]
    assert "manip3d.camera.Intrinsics" in found["unproject"]
    assert "manip3d.camera.Intrinsics.unproject()" in found["pixels"]
    assert "manip3d.camera.Intrinsics" in found["distortion"]


def test_a_retired_name_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    def triangles_of(num_tris: int) -> int:
        return num_tris

    triangles_of.__module__ = "manip3d.metrics"
    monkeypatch.setattr(manip3d.metrics, "num_triangles", triangles_of, raising=False)
    found = retired(identifiers())
    assert found == {
        "num_triangles": ["manip3d.metrics"],
        "num_tris": ["manip3d.metrics.num_triangles()"],
    }


SHARED_NAMES = {
    "film": "diary.film shows a clip of a diary, viewer.film a row of meshes",
    "open_drive": "capture opens a recorded drive, simulate a simulated one",
    "run": "batch.run runs a task on many files, experiments.run experiments",
}
"""Functions of one name in two rooms, and why: they do the same for different inputs."""


def test_functions_of_two_rooms_have_different_names() -> None:
    rooms: dict[str, set[str]] = {}
    for module in public_modules():
        for name in getattr(module, "__all__", ()):
            function = getattr(module, name)
            if inspect.isfunction(function):
                rooms.setdefault(name, set()).add(inspect.unwrap(function).__module__)
    assert {name for name, where in rooms.items() if len(where) > 1} == set(SHARED_NAMES)
