"""FMPD against a direct NumPy transcription of its definition."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import manip3d
from manip3d.metrics import FmpdResult, fmpd
from metrics_oracles import plane, sphere


def transcription(
    first: manip3d.Mesh, second: manip3d.Mesh, boundaries: list[NDArray[np.int64]]
) -> tuple[float, float, float]:
    """Wang, Torkhani & Montanvert 2012 as its authors' program computes it."""
    roughness, areas, means = [], [], []
    for mesh, boundary in zip((first, second), boundaries, strict=True):
        p = mesh.vertices[mesh.faces]
        num_vertices = mesh.num_vertices
        K = np.full(num_vertices, 2 * np.pi)
        K[boundary] = np.pi
        area = 0.5 * np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
        weighted, weights = np.zeros(num_vertices), np.zeros(num_vertices)
        m = np.zeros(num_vertices)
        cosines = []
        for k in range(3):
            a, b = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
            cosines.append((a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1))
            np.subtract.at(K, mesh.faces[:, k], np.arccos(cosines[k]))
            np.add.at(m, mesh.faces[:, k], area / 3)
        for k, cosine in enumerate(cosines):
            w = np.clip(cosine / np.sqrt(1 - cosine**2) / 2, 0.001, 1000)
            for i, j in ((1, 2), (2, 1)):
                at, of = mesh.faces[:, (k + i) % 3], mesh.faces[:, (k + j) % 3]
                np.add.at(weighted, at, w * np.abs(K[of]))
                np.add.at(weights, at, w)
        R = np.abs(np.abs(K) - weighted / weights)
        roughness.append(R)
        areas.append(m)
        means.append((R * m).sum() / area.sum())
    eps = 0.0005
    highest = max(0.20, 5 * min(means))
    t = max(min(means), eps)
    turn = t**0.15 - eps**0.15
    values = []
    for R, m in zip(roughness, areas, strict=True):
        g = np.clip(R, eps, highest) ** 0.15 - eps**0.15
        g = np.where(g > turn, turn + (g - turn) / 2, g)
        values.append((g * m).sum() / m.sum())
    return 8 * abs(values[0] - values[1]), values[0], values[1]


def ball(num_rings: int, noise: float = 0.0, seed: int = 0) -> manip3d.Mesh:
    mesh = sphere(num_rings)
    rng = np.random.default_rng(seed)
    return mesh.replace(
        vertices=mesh.vertices * (1 + noise * rng.normal(size=(len(mesh.vertices), 1)))
    )


def hill(size: int, noise: float, seed: int = 0) -> manip3d.Mesh:
    mesh = plane(size)
    heights = noise * np.random.default_rng(seed).normal(size=len(mesh.vertices))
    return mesh.replace(vertices=mesh.vertices + heights[:, None] * np.array([0, 0, 1.0]))


def rim(size: int) -> NDArray[np.int64]:
    grid = np.arange((size + 1) ** 2).reshape(size + 1, size + 1)
    return np.unique([grid[0], grid[-1], grid[:, 0], grid[:, -1]])


def assert_equals(result: FmpdResult, expected: tuple[float, float, float]) -> None:
    values = (result.value, result.roughness_original, result.roughness_simplified)
    assert values == pytest.approx(expected, rel=1e-9, abs=1e-9)


NOWHERE = np.empty(0, np.int64)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 0.01, 0.2])
def test_equals_the_transcription_on_closed_surfaces(noise: float) -> None:
    a, b = ball(12), ball(7, noise)
    assert_equals(fmpd(a, b), transcription(a, b, [NOWHERE, NOWHERE]))
    assert_equals(fmpd(b, a), transcription(b, a, [NOWHERE, NOWHERE]))


@pytest.mark.parametrize("noise", [1e-3, 0.1, 2.0])
def test_equals_the_transcription_on_open_surfaces(noise: float) -> None:
    a, b = hill(9, noise), hill(5, 0.3, seed=1)
    assert_equals(fmpd(a, b), transcription(a, b, [rim(9), rim(5)]))


def test_every_bound_is_reached() -> None:
    """Roughness below the smallest, above the largest, weights beyond both limits."""
    flat, spiky = hill(6, 0.0), hill(6, 5.0)
    assert_equals(fmpd(flat, spiky), transcription(flat, spiky, [rim(6), rim(6)]))
    needles = hill(6, 0.01)
    needles = needles.replace(vertices=needles.vertices * [1.0, 1e-4, 1.0])
    assert_equals(fmpd(needles, spiky), transcription(needles, spiky, [rim(6), rim(6)]))


def test_equal_meshes_are_equally_rough() -> None:
    mesh = ball(9, 0.1)
    assert fmpd(mesh, mesh).value == 0
    cube = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [f for a, b, c, d in quads for f in ([a, b, c], [a, c, d])]
    box = manip3d.Mesh(cube, faces)
    assert fmpd(box, box).roughness_original == 0  # the same deficit at each corner


def test_clip() -> None:
    smooth, rough = ball(20), ball(20, 0.3)
    value = fmpd(smooth, rough).value
    assert value > 1
    assert fmpd(smooth, rough, clip=True).value == 1
    assert fmpd(smooth, smooth, clip=True).value == 0


def test_scale_place_and_threads_change_nothing() -> None:
    a, b = ball(12), ball(7, 0.1)
    expected = fmpd(a, b, threads=1)
    for scale in (2.0**-300, 2.0**-30, 2.0**30, 2.0**300):
        assert (
            fmpd(a.replace(vertices=a.vertices * scale), b.replace(vertices=b.vertices * scale))
            == expected
        )
    for threads in (2, 4):
        assert fmpd(a, b, threads=threads) == expected
    moved = [m.replace(vertices=m.vertices + 1e4) for m in (a, b)]
    assert fmpd(*moved).value == pytest.approx(expected.value, rel=1e-6)


def test_faces_without_area_are_skipped_and_counted() -> None:
    mesh = hill(4, 0.2)
    extra = mesh.replace(faces=np.vstack([mesh.faces, [[3, 3, 9]]]))
    expected = fmpd(mesh, mesh)
    result = fmpd(extra, mesh)
    assert result.skipped_faces == 1
    assert result.value == 0
    assert result.roughness_original == expected.roughness_original
    with pytest.raises(manip3d.InputError, match="original: expected a surface with an area"):
        fmpd(manip3d.Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]]), mesh)


def test_a_vertex_on_the_side_of_a_larger_face_of_a_plane_is_flat() -> None:
    """Its gap is filled by a face without area, in which its angle is pi."""
    flat = plane(8)
    a, b, c = next(
        face
        for face in flat.faces.tolist()
        if np.abs(flat.vertices[face] - 4.0).max(axis=0)[:2].max() <= 1.0
    )
    (below,) = (
        k for k, face in enumerate(flat.faces.tolist()) if {a, b} <= {*face} and c not in face
    )
    (d,) = {*flat.faces[below].tolist()} - {a, b}
    above = flat.faces.tolist().index([a, b, c])
    t = len(flat.vertices)
    vertices = np.vstack([flat.vertices, flat.vertices[[a, b]].mean(axis=0)])
    others = np.delete(flat.faces, [above, below], axis=0)
    halves = [[b, t, d], [t, a, d]]
    whole = manip3d.Mesh(vertices, np.vstack([others, halves, [[a, t, c], [t, b, c]]]))
    with_t = manip3d.Mesh(vertices, np.vstack([others, halves, [[a, b, c], [b, a, t]]]))
    result = fmpd(with_t, whole)
    assert result.skipped_faces == 1
    assert result.value == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    "faces",
    [
        [[0, 1, 2], [0, 3, 4]],  # bow-tie: two fans at one vertex
        [[0, 1, 2], [0, 1, 3], [1, 0, 4]],  # an edge with three faces
    ],
)
def test_vertices_that_are_not_manifold_count_as_interior(faces: list[list[int]]) -> None:
    vertices = np.array([[0, 0, 0], [1, 0.2, 0], [1, 1, 0.3], [-1, 0, 0.1], [-1, -1, 0]])
    mesh = manip3d.Mesh(vertices, faces)
    counts = np.bincount(mesh.faces.ravel())
    shared = [0] if counts[0] == 2 else [0, 1]
    boundary = np.setdiff1d(np.arange(5), shared)
    result = fmpd(mesh, ball(4))
    assert result.non_manifold
    assert_equals(result, transcription(mesh, ball(4), [boundary, NOWHERE]))
    assert not fmpd(ball(4), hill(3, 0.1)).non_manifold


def test_meshes_of_very_different_sizes_are_compared() -> None:
    """Found by fuzzing: areas in the other mesh's unit overflowed, and the result was NaN."""
    mesh = sphere(6)
    large = mesh.replace(vertices=mesh.vertices * 2.0**540)
    assert fmpd(mesh, large).value == 0.0
    assert fmpd(large, mesh).value == 0.0
