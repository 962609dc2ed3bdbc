"""``max_distance`` is a promise: it is held against samples, and against the proof of a metric."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import pytest

from manip3d import InputError, Mesh, read_mesh
from manip3d.metrics import closest_points, hausdorff_bound
from manip3d.simplify import (
    METHODS,
    boundary_vertices,
    clean,
    qem4vr,
    qem_orig,
    quality,
    simplify,
)
from real_data import RealData
from zoo import MESHES, grid, sphere

WILD = [
    "alligator.obj.xz",
    "woody.obj.xz",
    "beast.obj.xz",
    "igl_truck.obj.xz",
    "ExplodingBarrel.glb",
    "clothFolds.glb",
    "HarleyDavidson/Harley-Davidson.obj.xz",
    "panel/panel.obj.xz",
    "m2000/m2000.obj.xz",
    "interior/interior.obj.xz",
]


def samples(mesh: Mesh, per_face: int, rng: np.random.Generator) -> np.ndarray:
    """All vertices and edge midpoints, and random points of every face."""
    corners = mesh.vertices[mesh.faces]
    weights = rng.dirichlet([1, 1, 1], size=(len(corners), per_face))
    inside = np.einsum("fsk,fkd->fsd", weights, corners).reshape(-1, 3)
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3)
    return np.concatenate([corners.reshape(-1, 3), middles, inside])


def sampled_distance(a: Mesh, b: Mesh, per_face: int = 20) -> float:
    """The two-sided Hausdorff distance of samples: a lower bound of the true one."""
    rng = np.random.default_rng(1)
    there = closest_points(b, samples(a, per_face, rng)).distance.max()
    back = closest_points(a, samples(b, per_face, rng)).distance.max()
    return float(max(there, back))


@pytest.mark.parametrize("height", [0.125, 0.25, 0.5])
def test_a_bump_of_just_the_limit_is_no_reason_to_exceed_it(height: float) -> None:
    """The proof has an error of rounding, which counts towards the limit."""
    vertices, faces = grid(8, 8)  # vertex 40 is in the middle
    vertices[40, 2] = height
    result = qem4vr(Mesh(vertices, faces), target_faces=2, max_distance=height)
    assert result.distance_bound is not None
    assert 0.5 * height < result.distance_bound <= height


def textured(vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    """A mesh whose texture is projected along z, for methods that need texture coordinates."""
    return Mesh(vertices, faces, texcoords=vertices[:, :2], face_texcoords=faces)


def hills(columns: int = 20) -> Mesh:
    vertices, faces = grid(columns, columns)
    vertices[:, 2] = np.sin(vertices[:, 0] * 0.6) + np.cos(vertices[:, 1] * 0.5)
    return textured(vertices, faces)


@pytest.mark.parametrize("fraction", [1e-1, 1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("method", [*METHODS, "quality"])
@pytest.mark.parametrize("name", ["hills", "sphere", "open_strip"])
def test_the_distance_keeps_its_limit(name: str, method: str, fraction: float) -> None:
    if name == "open_strip":  # a rim that QEM_ORIG eats for nothing
        mesh = textured(*grid(30, 3))
    else:
        mesh = hills() if name == "hills" else textured(*sphere(24, 12))
    limit = fraction * mesh.diagonal
    result = (METHODS | {"quality": quality})[method](mesh, max_distance=limit)
    assert result.distance_bound is not None
    assert result.distance_bound <= limit
    assert sampled_distance(mesh, result.mesh) <= result.distance_bound + 1e-12 * mesh.diagonal
    proved = hausdorff_bound(mesh, result.mesh, tolerance=1e-2 * fraction)
    assert proved.lower <= result.distance_bound + 1e-12 * mesh.diagonal
    assert proved.upper <= limit * 1.01
    if fraction >= 1e-2:
        assert result.mesh.num_faces < 0.6 * mesh.num_faces


CLEANED = {name: clean(mesh).mesh for name, mesh in MESHES.items()}


@pytest.mark.parametrize("method", [qem4vr, quality])
@pytest.mark.parametrize("name", [name for name, mesh in CLEANED.items() if mesh.diagonal > 0])
def test_every_mesh_of_the_zoo_keeps_its_limit(name: str, method: Callable[..., Any]) -> None:
    mesh = CLEANED[name]
    result = method(mesh, max_distance=0.05 * mesh.diagonal)
    assert result.distance_bound is not None
    assert result.distance_bound <= 0.05 * mesh.diagonal
    assert sampled_distance(mesh, result.mesh) <= result.distance_bound + 1e-9 * mesh.diagonal


def test_a_rim_that_costs_nothing_counts() -> None:
    """Without a boundary term a flat strip is eaten from its ends, and no quadric sees it."""
    mesh = Mesh(*grid(30, 3))
    eaten = qem_orig(mesh, target_faces=4, max_error=1e-9)
    assert eaten.max_error <= 1e-9
    assert sampled_distance(mesh, eaten.mesh) > 1.0
    kept = qem_orig(mesh, max_distance=0.01)
    assert sampled_distance(mesh, kept.mesh) <= 0.01
    assert kept.mesh.num_faces < 10


def test_targets_combine() -> None:
    mesh = hills()
    both = qem4vr(mesh, target_faces=600, max_distance=mesh.diagonal)
    assert both.stop == "target_reached"
    assert both.mesh.num_faces in (599, 600)
    assert both.distance_bound is not None
    assert 0.0 < both.distance_bound < 0.1 * mesh.diagonal
    assert qem4vr(mesh, target_faces=600).distance_bound is None


# Flat in a plane that is exact in binary, turned so that no axis is in it: z = x + y / 2.
def slanted(vertices: np.ndarray) -> np.ndarray:
    return np.column_stack([vertices[:, :2], vertices[:, 0] + vertices[:, 1] / 2])


@pytest.mark.parametrize("turn", [lambda v: v, slanted])
def test_zero_leaves_the_corners_of_a_flat_shape(turn: object) -> None:
    """An L: six corners, whatever is between them."""
    vertices, faces = grid(4, 4)
    middle = vertices[faces].mean(axis=1)
    assert callable(turn)
    mesh = clean(Mesh(turn(vertices), faces[~(middle[:, :2] > 2).all(axis=1)])).mesh
    result = qem4vr(mesh, max_distance=0.0)
    assert result.distance_bound == 0.0
    assert result.mesh.num_vertices == 6
    assert result.mesh.num_faces == 4
    corners = result.mesh.vertices[result.mesh.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    before = mesh.vertices[mesh.faces]
    was = np.linalg.norm(np.cross(before[:, 1] - before[:, 0], before[:, 2] - before[:, 0]), axis=1)
    assert math.isclose(area.sum(), was.sum(), rel_tol=1e-14)


def test_zero_leaves_a_cube_with_its_corners_and_a_sphere_as_it_is() -> None:
    vertices, faces = grid(3, 3)
    sides = []
    for axis in range(3):
        for level in (0.0, 3.0):
            side = np.insert(vertices[:, :2], axis, level, axis=1)
            sides.append(side)
    points = np.concatenate(sides)
    all_faces = np.concatenate([faces + i * len(vertices) for i in range(6)])
    cube = clean(Mesh(points, all_faces)).mesh
    assert qem_orig(cube, max_distance=0.0).mesh.num_vertices == 8
    ball = Mesh(*sphere(12, 6))
    assert qem_orig(ball, max_distance=0.0).mesh.num_faces == ball.num_faces


def test_one_ulp_off_is_not_coplanar() -> None:
    vertices, faces = grid(2, 2)
    flat = Mesh(vertices, faces)
    assert qem4vr(flat, max_distance=0.0).mesh.num_faces == 2
    vertices[4, 2] = 5e-324  # outside of what is decided exactly: nothing is allowed there
    assert 4 in qem4vr(Mesh(vertices, faces), max_distance=0.0).kept
    vertices[4, 2] = 1e-60
    assert 4 in qem4vr(Mesh(vertices, faces), max_distance=0.0).kept


@pytest.mark.parametrize("limit", [-1.0, math.nan])
def test_a_limit_is_a_distance(limit: float) -> None:
    with pytest.raises(InputError, match="max_distance"):
        qem4vr(hills(4), max_distance=limit)
    with pytest.raises(InputError, match="max_distance"):
        quality(hills(4), max_distance=limit)


def test_zero_is_for_methods_that_leave_vertices_where_they_are() -> None:
    with pytest.raises(InputError, match="max_distance: expected a number > 0"):
        simplify(hills(4), "quality", max_distance=0.0)
    assert simplify(hills(4), "published", max_distance=0.0).distance_bound == 0.0
    assert simplify(hills(4), max_distance=0.0).distance_bound == 0.0  # published by default


def test_quality_says_that_the_distance_stopped_it_and_the_fit_keeps_it() -> None:
    """The vertices that the fit moves at the end are held to the limit as well."""
    mesh = hills()
    limit = 1e-3 * mesh.diagonal
    kept = quality(mesh, target_faces=4, max_distance=limit)
    assert kept.stop == "distance_limit"
    assert kept.rejected["distance_limit"] > 0
    assert kept.mesh.num_faces > 4
    assert sampled_distance(mesh, kept.mesh) <= limit
    free = quality(mesh, target_faces=kept.mesh.num_faces // 2)
    assert sampled_distance(mesh, free.mesh) > limit
    assert free.distance_bound is None


@pytest.mark.parametrize("locks", ["boundary", "box", "random"])
@pytest.mark.parametrize("name", ["hills", "sphere"])
def test_locked_vertices_count_where_they_stay(name: str, locks: str) -> None:
    """A collapse onto a locked vertex is proved for the place of that vertex, not another one."""
    mesh = hills(30) if name == "hills" else Mesh(*sphere(48, 32))
    if locks == "boundary":
        locked = boundary_vertices(mesh)
    elif locks == "box":
        locked = mesh.vertices[:, 2] >= 0
    else:
        locked = np.random.default_rng(0).random(mesh.num_vertices) < 0.1
    for limit in (2e-2, 5e-3):
        result = quality(mesh, max_distance=limit * mesh.diagonal, locked=locked)
        assert result.mesh.num_faces < mesh.num_faces
        assert result.distance_bound is not None
        assert result.distance_bound <= limit * mesh.diagonal
        assert sampled_distance(mesh, result.mesh) <= result.distance_bound
        np.testing.assert_array_equal(
            result.mesh.vertices[result.vertex_map[locked]], mesh.vertices[locked]
        )


@pytest.mark.realdata
@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "fraction"),
    [  # quality refuses a limit of 0: see above
        *itertools.product(("published", "quality"), (1e-2, 1e-3, 1e-4)),
        ("published", 0.0),
    ],
)
@pytest.mark.parametrize("name", WILD)
def test_wild_meshes_keep_the_limit(
    realdata: RealData, name: str, fraction: float, mode: Literal["published", "quality"]
) -> None:
    mesh = clean(read_mesh(realdata(f"meshes/wild/{name}"))).mesh
    limit = fraction * mesh.diagonal
    result = simplify(mesh, mode, max_distance=limit)
    assert result.distance_bound is not None
    assert result.distance_bound <= limit
    assert sampled_distance(mesh, result.mesh) <= limit + 1e-6 * mesh.diagonal
    if name in ("alligator.obj.xz", "woody.obj.xz"):  # flat: the outline is all that stays
        assert result.mesh.num_faces < mesh.num_faces


def test_a_slow_proof_tells_of_its_progress() -> None:
    """A vertex of this soup has tens of faces: a step can take as long as hundreds elsewhere."""
    rng = np.random.default_rng(1)
    soup = Mesh(rng.random((150, 3)), rng.integers(0, 150, (300, 3)).astype(np.int32))
    told: list[tuple[float, float]] = []
    before = time.process_time()
    quality(
        soup,
        max_distance=0.1,
        progress=lambda fraction, _: told.append((fraction, time.process_time())),
    )
    fractions, times = zip(*told, strict=True)
    assert list(fractions) == sorted(fractions)
    assert max(fractions) < 1.0 or fractions.count(1.0) == 1
    gaps = np.diff([before, *times, time.process_time()])
    assert gaps.max() < 0.1 * gaps.sum()  # a quarter of the whole when steps alone were told
