"""`max_distance` beside CGAL's Hausdorff distance, which is proved by another code."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import Mesh
from manip3d.simplify import clean, qem4vr, quality
from zoo import grid, sphere

pytestmark = pytest.mark.slow  # g++ takes 13 s for CGAL's headers

SOURCE = Path(__file__).with_name("cgal_hausdorff.cpp")
HEADER = Path("/usr/include/CGAL/Polygon_mesh_processing/distance.h")
LIMITS = (1e-2, 1e-3, 1e-4)  # of the diagonal
TOLERANCE = 1e-6

Distances = Callable[[list[tuple[Mesh, Mesh]], float], list[float]]


@pytest.fixture(scope="module")
def cgal(tmp_path_factory: pytest.TempPathFactory) -> Distances:
    """Two-sided distances of pairs of meshes, each within an error."""
    if not HEADER.exists():
        pytest.skip("CGAL's headers are not there (libcgal-dev)")
    compiler = shutil.which("g++")
    if compiler is None:
        pytest.skip("there is no g++ to compile with")
    folder = tmp_path_factory.mktemp("cgal")
    program = folder / "cgal_hausdorff"
    options = ["-std=c++17", "-O2", "-DNDEBUG", "-I/usr/include/eigen3"]
    built = subprocess.run(
        [compiler, *options, str(SOURCE), "-o", str(program), "-lgmp", "-lmpfr"],
        capture_output=True,
        text=True,
        check=False,
    )
    if built.returncode != 0:
        pytest.skip(f"this CGAL does not compile here: {built.stderr.splitlines()[0]}")

    def distances(pairs: list[tuple[Mesh, Mesh]], error: float) -> list[float]:
        names = []
        for number, pair in enumerate(pairs):
            for side, mesh in zip("ab", pair, strict=True):
                names.append(folder / f"{number}{side}.off")
                Mesh(mesh.vertices, mesh.faces).write(names[-1])
        said = subprocess.run(
            [program, repr(error), *names], capture_output=True, text=True, check=True
        )
        return [float(line) for line in said.stdout.split()]

    return distances


def hills() -> Mesh:
    vertices, faces = grid(20, 20)
    vertices[:, 2] = np.sin(vertices[:, 0] * 0.6) + np.cos(vertices[:, 1] * 0.5)
    return Mesh(vertices, faces)


def check(cgal: Distances, mesh: Mesh, method: Callable[..., Any]) -> None:
    unit = mesh.diagonal
    results = [method(mesh, max_distance=limit * unit) for limit in LIMITS]
    changed = [
        (limit, result)
        for limit, result in zip(LIMITS, results, strict=True)
        if result.mesh.num_faces < mesh.num_faces  # of equal meshes CGAL has nothing to say
    ]
    assert changed
    found = cgal([(mesh, result.mesh) for _, result in changed], TOLERANCE * unit)
    assert len(found) == len(changed)
    for distance, (limit, result) in zip(found, changed, strict=True):
        assert distance <= result.distance_bound + TOLERANCE * unit
        assert result.distance_bound <= limit * unit
        assert distance > 0.3 * result.distance_bound  # a bound, and no guess far above


@pytest.mark.parametrize("method", [qem4vr, quality])
@pytest.mark.parametrize("shape", ["hills", "sphere"])
def test_cgal_finds_no_larger_distance(
    cgal: Distances, shape: str, method: Callable[..., Any]
) -> None:
    check(cgal, hills() if shape == "hills" else Mesh(*sphere(24, 12)), method)


def test_cgal_and_a_known_distance(cgal: Distances) -> None:
    """The program that is compared with measures what it should."""
    flat = Mesh(*grid(4, 4))
    moved = Mesh(flat.vertices + np.array([0.0, 0.0, 0.25]), flat.faces)
    assert cgal([(flat, moved)], 1e-6)[0] == pytest.approx(0.25, abs=2e-6)


@pytest.mark.realdata
@pytest.mark.parametrize("method", [qem4vr, quality])
@pytest.mark.parametrize("name", ["spot"])
def test_cgal_finds_no_larger_distance_on_real_models(
    cgal: Distances, real_mesh: Callable[[str], Mesh], name: str, method: Callable[..., Any]
) -> None:
    check(cgal, clean(real_mesh(name)).mesh, method)
