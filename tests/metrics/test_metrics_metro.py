"""Metro distances, against known answers, Open3D and PyMeshLab."""

from __future__ import annotations

import math
import signal
from dataclasses import replace

import numpy as np
import pytest

import manip3d
from manip3d.metrics import metro
from metrics_oracles import face_distances, plane, sphere


@pytest.mark.parametrize("sampling", ["vertex", "area"])
def test_parallel_planes_are_their_distance_apart(sampling: str) -> None:
    result = metro(plane(), plane(height=0.25), sampling=sampling)
    diagonal = 8 * math.sqrt(2)
    assert result.diagonal == pytest.approx(diagonal, rel=1e-15)
    for side in (result.forward, result.backward):
        assert (side.mean, side.rms, side.max) == pytest.approx((0.25, 0.25, 0.25), rel=1e-14)
    assert result.mean == result.forward.mean / result.diagonal
    assert result.rms == result.forward.rms / result.diagonal
    assert result.max == result.forward.max / result.diagonal
    assert result.forward.samples == (81 if sampling == "vertex" else 1280)


def test_the_two_directions_differ() -> None:
    """A plane against the quarter of it: the quarter lies on the whole, not the reverse."""
    result = metro(plane(8), plane(4), sampling="area", samples=200_000)
    assert result.backward.max < 1e-15
    # the integral of the distance to [0, 4]^2 over [0, 8]^2, over the area 64: two strips where it
    # is linear, and a corner where it is the distance to a corner of a square
    corner = (math.sqrt(2) + math.asinh(1)) / 3 * 4**3
    assert result.forward.mean == pytest.approx((2 * 4 * 8 + corner) / 64, rel=2e-4)
    assert result.forward.rms == pytest.approx(
        math.sqrt((2 * 4 * 4**3 / 3 + 2 * 4**4 / 3) / 64), rel=2e-4
    )
    assert result.forward.max == pytest.approx(4 * math.sqrt(2), rel=0.01)
    by_vertex = metro(plane(8), plane(4))
    assert by_vertex.forward.max == pytest.approx(4 * math.sqrt(2), rel=1e-15)
    assert (by_vertex.forward.samples, by_vertex.backward.samples) == (81, 25)


def test_scaled_sphere() -> None:
    """Vertices of the larger sphere are nearest to the vertices below them."""
    result = metro(sphere(radius=1.5), sphere(radius=1.0))
    assert result.forward.mean == pytest.approx(0.5, rel=1e-12)
    assert result.diagonal == pytest.approx(1.5 * math.sqrt(12), rel=1e-12)


def test_a_mesh_is_at_distance_zero_from_itself_and_far_from_the_origin() -> None:
    mesh = sphere()
    far = mesh.replace(vertices=mesh.vertices + 2.0**19)
    assert metro(far, far).forward.max == metro(mesh, mesh).forward.max == 0.0
    assert metro(far, far, sampling="area").max < 1e-16 * 4


def test_unused_vertices_do_not_count() -> None:
    mesh = plane(2)
    extra = mesh.replace(vertices=np.vstack([mesh.vertices, [[1e3, 1e3, 1e3]]]))
    assert metro(extra, mesh) == metro(mesh, mesh)
    assert metro(mesh, extra) == metro(mesh, mesh)


def test_a_surface_without_area_is_named() -> None:
    surface = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    line = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    for pair, name in (((line, surface), "original"), ((surface, line), "simplified")):
        with pytest.raises(manip3d.InputError, match=f"^{name}: expected a surface with an area"):
            metro(*pair, sampling="area", rng=0)


def test_area_samples_are_uniform_by_area() -> None:
    """A tiny face among large ones: its share of the samples is its share of the area."""
    step = manip3d.Mesh(
        [[0, 0, 0], [2, 0, 0], [0, 2, 0], [5, 0, 7], [6, 0, 7], [5, 1, 7]],
        [[0, 0, 1], [0, 1, 2], [3, 4, 5], [5, 5, 5]],
    )
    ground = manip3d.Mesh([[-50, -50, 0], [50, -50, 0], [0, 90, 0]], [[0, 1, 2]])
    result = metro(step, ground, sampling="area", samples=1000)
    assert result.forward.mean == pytest.approx(7 * 0.2, rel=1e-12)  # exact: strata, not chance
    assert result.forward.rms == pytest.approx(7 * math.sqrt(0.2), rel=1e-12)
    # the points of a triangle: mean and variance of the distance to its edge x = 0
    triangle = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    wall = manip3d.Mesh([[0, -9, -9], [0, 9, -9], [0, 0, 9]], [[0, 1, 2]])
    result = metro(triangle, wall, sampling="area", samples=400_000)
    assert result.forward.mean == pytest.approx(1 / 3, rel=3e-3)
    assert result.forward.rms == pytest.approx(math.sqrt(1 / 6), rel=3e-3)


def test_same_bits_for_any_number_of_threads() -> None:
    a, b = sphere(40), sphere(9)
    for sampling in ("vertex", "area"):
        results = {metro(a, b, sampling=sampling, rng=3, threads=t) for t in (1, 2, 4)}
        assert len(results) == 1


def test_rng() -> None:
    def mean(rng: int | np.random.Generator | None) -> float:
        return metro(sphere(8), sphere(5), sampling="area", rng=rng).mean

    assert mean(1) == mean(1) == mean(np.random.default_rng(1))
    assert mean(1) != mean(2)
    assert mean(None) != mean(None)
    assert mean(1) == pytest.approx(mean(2), rel=0.05)
    with pytest.raises(manip3d.InputError, match="rng"):
        mean(-1)


def test_equals_all_pairs() -> None:
    a, b = sphere(12), sphere(5, radius=1.1)
    distances = face_distances(b.vertices, b.faces, a.vertices[np.unique(a.faces)]).min(axis=1)
    result = metro(a, b)
    assert result.mean == pytest.approx(distances.mean() / a.diagonal, rel=1e-12)
    assert result.rms == pytest.approx(math.sqrt((distances**2).mean()) / a.diagonal, rel=1e-12)
    assert result.max == pytest.approx(distances.max() / a.diagonal, rel=1e-12)


def test_equals_pymeshlab() -> None:
    pymeshlab = pytest.importorskip("pymeshlab", reason="PyMeshLab is not installed (peers)")
    a, b = sphere(30), sphere(7, radius=1.05)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(a.vertices, a.faces))
    meshes.add_mesh(pymeshlab.Mesh(b.vertices, b.faces))
    theirs = meshes.get_hausdorff_distance(
        sampledmesh=0,
        targetmesh=1,
        savesample=False,
        samplevert=True,
        sampleedge=False,
        sampleface=False,
        samplenum=a.num_vertices,
        maxdist=pymeshlab.PercentageValue(100),
    )
    used = np.unique(a.faces)
    ours = metro(a, b)
    assert ours.forward.samples == len(used)
    assert theirs["n_samples"] == len(used)
    assert ours.forward.max == pytest.approx(theirs["max"], rel=1e-4)
    assert ours.forward.mean == pytest.approx(theirs["mean"], rel=1e-4)
    assert ours.forward.rms == pytest.approx(theirs["RMS"], rel=1e-4)
    assert ours.mean == pytest.approx(theirs["mean"] / theirs["diag_mesh_0"], rel=1e-4)
    sampled = meshes.get_hausdorff_distance(
        sampledmesh=0,
        targetmesh=1,
        savesample=False,
        samplevert=False,
        sampleedge=False,
        sampleface=True,
        samplenum=200_000,
        maxdist=pymeshlab.PercentageValue(100),
    )
    by_area = metro(a, b, sampling="area", samples=200_000)
    assert by_area.forward.mean == pytest.approx(sampled["mean"], rel=1e-2)
    assert by_area.forward.rms == pytest.approx(sampled["RMS"], rel=1e-2)


def test_refuses_bad_input() -> None:
    mesh = plane(2)
    with pytest.raises(manip3d.InputError, match="sampling: expected 'vertex' or 'area'"):
        metro(mesh, mesh, sampling="edge")  # type: ignore[arg-type]
    with pytest.raises(manip3d.InputError, match="samples"):
        metro(mesh, mesh, samples=10)
    for samples in (0, -1, 2**41):
        with pytest.raises(manip3d.InputError, match="samples: expected 1"):
            metro(mesh, mesh, sampling="area", samples=samples)
    with pytest.raises(manip3d.InputError, match="threads: expected 0"):
        metro(mesh, mesh, threads=-1)
    empty = manip3d.Mesh(mesh.vertices, [])
    with pytest.raises(manip3d.InputError, match="original: expected at least one face"):
        metro(empty, mesh)
    with pytest.raises(manip3d.InputError, match="simplified: expected at least one face"):
        metro(mesh, empty)
    point = manip3d.Mesh(np.ones((3, 3)), [[0, 1, 2]])
    with pytest.raises(manip3d.InputError, match="diagonal > 0"):
        metro(point, mesh)
    segment = manip3d.Mesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]])
    with pytest.raises(manip3d.InputError, match="area"):
        metro(segment, mesh, sampling="area")
    assert metro(segment, mesh).forward.max == 0.0


def test_progress_grows_to_one() -> None:
    seen: list[float] = []
    metro(sphere(80), sphere(60), sampling="area", progress=lambda done, _: seen.append(done))
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_a_signal_interrupts() -> None:
    """Ctrl-C while the tree is built and while it is asked: the handler's error comes through."""

    class InterruptedByTest(Exception):
        pass

    def interrupt(number: int, frame: object) -> None:
        raise InterruptedByTest

    mesh = sphere(150)
    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.1)
        with pytest.raises(InterruptedByTest):
            metro(mesh, mesh, sampling="area", samples=10**9)  # hours, if not interrupted
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_results_are_frozen() -> None:
    result = metro(plane(1), plane(1))
    with pytest.raises(AttributeError):
        result.diagonal = 1.0  # type: ignore[misc]
    assert replace(result, sampling="area") != result


def test_threads_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_THREADS", "1")
    expected = metro(plane(2), plane(3))
    monkeypatch.setenv("MANIP3D_THREADS", "many")
    assert metro(plane(2), plane(3), threads=2) == expected
    with pytest.raises(manip3d.InputError, match="MANIP3D_THREADS"):
        metro(plane(2), plane(3))
