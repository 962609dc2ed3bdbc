"""The degenerate zoo through every public function that takes a mesh.

To add a function, add a line to ``FUNCTIONS``. Each call must give a valid result or raise
``manip3d.Error``; it must not touch its input.
"""

from __future__ import annotations

import dataclasses
import math
import re
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

import manip3d
from manip3d import Mesh, read_mesh
from manip3d.io import WRITABLE, write_mesh
from manip3d.metrics import boundary_gap, closest_points, fmpd, metro, texture_error
from manip3d.simplify import METHODS, clean, fast, quality
from manip3d.viewer import html, notebook, picture
from zoo import MESHES, REFUSED, TRIANGLE, arrays_of


def written_and_read(mesh: Mesh, suffix: str) -> Mesh:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{suffix}"
        write_mesh(mesh, path)
        return read_mesh(path)


RATIOS = [
    *((name, run, 0.0) for name, run in METHODS.items()),  # one procedure with other weights
    ("qem4vr", METHODS["qem4vr"], 0.5),
    *((run.__name__, run, ratio) for run in (quality, fast) for ratio in (0.0, 0.5)),
]

FUNCTIONS: dict[str, Callable[[Mesh], object]] = {
    "basics": lambda mesh: (mesh.replace(source="x.obj"), mesh.bounds, mesh.diagonal, repr(mesh)),
    "summary": Mesh.summary,
    "clean": clean,
    "clean-any": lambda mesh: clean(mesh, duplicates="any"),
    "metro": lambda mesh: metro(mesh, clean(mesh).mesh),
    "metro-area": lambda mesh: metro(mesh, MESHES["tetrahedron"], sampling="area"),
    "closest-points": lambda mesh: closest_points(mesh, TRIANGLE),
    "texture-error": lambda mesh: texture_error(mesh, clean(mesh).mesh),
    "fmpd": lambda mesh: fmpd(mesh, MESHES["tetrahedron"]),
    "boundary-gap": lambda mesh: boundary_gap(mesh, clean(mesh).mesh),
    **{
        f"{name}-{ratio}": lambda mesh, run=run, ratio=ratio: run(mesh, ratio=ratio).mesh
        for name, run, ratio in RATIOS
    },
    "picture": lambda mesh: picture(mesh, size=(24, 16), boundary=True),
    "html": html,
    "notebook": lambda mesh: mesh._repr_mimebundle_(),
    **{
        f"write{suffix}": lambda mesh, suffix=suffix: written_and_read(mesh, suffix)
        for suffix in WRITABLE
    },
    "clean-unwelded": lambda mesh: clean(mesh, weld=False, duplicates="any"),
}


# Meshes for which a function has no answer: without area, or with a texture file that is absent.
NOTHING = {"empty", "one_vertex", "vertices_without_faces"}
NO_FACES = NOTHING | {"all_points_equal", "only_repeated_indices"}
NO_AREA = NO_FACES | {"collinear"}
ABSENT = {"materials_that_are_not_there"}
TOO_FINE = {"edges_of_double_precision"}
REFUSALS: dict[str, set[str]] = {
    # published methods know corners by their numbers, the others by their places
    **{
        f"{name}-{ratio}": NOTHING | {"only_repeated_indices"} if name in METHODS else NO_FACES
        for name, _, ratio in RATIOS
    },
    "metro": NO_FACES,
    "boundary-gap": NO_FACES,
    "metro-area": NO_AREA | TOO_FINE,
    "closest-points": NOTHING,
    "texture-error": NO_AREA,
    "fmpd": NO_AREA,
    "html": ABSENT,
    "notebook": ABSENT,
    "write.ply": ABSENT,
    "write.stl": TOO_FINE,
    "write.gltf": NOTHING | ABSENT | TOO_FINE,
    "write.glb": NOTHING | ABSENT | TOO_FINE,
}


def assert_valid(result: object, where: str = "result") -> None:
    """No NaN, and meshes whose indices are in range, at any depth of the result."""
    if isinstance(result, Mesh):
        result.validate()
    elif isinstance(result, float):
        assert not math.isnan(result), where
    elif isinstance(result, np.ndarray) and result.dtype.kind == "f":
        assert not np.isnan(result).any(), where
    elif dataclasses.is_dataclass(result):
        for field in dataclasses.fields(result):
            assert_valid(getattr(result, field.name), f"{where}.{field.name}")
    elif isinstance(result, Mapping):
        for key, value in result.items():
            assert_valid(value, f"{where}[{key!r}]")
    elif isinstance(result, tuple | list):
        for i, value in enumerate(result):
            assert_valid(value, f"{where}[{i}]")


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("function", FUNCTIONS)
def test_every_function_bears_every_mesh(
    function: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = MESHES[name]
    monkeypatch.setattr(notebook, "PICTURE_SIZE", (24, 16))  # pixels take longer than meshes
    before = {key: value.copy() for key, value in arrays_of(mesh).items()}
    if name in REFUSALS.get(function, ()):
        with pytest.raises(manip3d.Error):
            FUNCTIONS[function](mesh)
    else:
        assert_valid(FUNCTIONS[function](mesh))
    for key, value in arrays_of(mesh).items():
        np.testing.assert_array_equal(value, before[key], err_msg=f"{function} wrote to {key}")


@pytest.mark.parametrize("name", REFUSED)
def test_the_constructor_refuses(name: str) -> None:
    changes, message = REFUSED[name]
    with pytest.raises(manip3d.InputError, match=re.escape(message)):
        Mesh(**({"vertices": TRIANGLE, "faces": [[0, 1, 2]]} | changes))


def test_the_zoo_holds_what_its_names_say() -> None:
    summaries = {name: mesh.summary() for name, mesh in MESHES.items()}
    assert len(summaries) >= 40
    assert summaries["moebius_strip"].boundary_edges == 24 * 2
    assert summaries["moebius_strip"].edges == 48 * 2
    assert summaries["pillow"].duplicate_faces == 0
    assert summaries["pillow"].duplicate_faces_welded > 0
    assert summaries["unwelded"].closed
    assert summaries["all_points_equal"].degenerate_faces_welded == 4
    assert summaries["edge_with_five_faces"].non_manifold_edges == 1
    assert summaries["tetrahedra_sharing_an_edge"].non_manifold_edges == 1
    assert summaries["self_touching_boundary"].complex_vertices == 1
    assert summaries["thousands_of_triangles_apart"].components == 2000
