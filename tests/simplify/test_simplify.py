"""Edge collapse: known answers, oracles and invariants."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import exact_models as models
import manip3d
from manip3d import InputError, Mesh, metrics, simplify
from manip3d.simplify import METHODS, SimplifyResult, StopReason
from soups import soups


def bumpy_grid(columns: int, rows: int, seed: int) -> Mesh:
    """Return an open height field of random heights, so that no two collapses cost the same."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(columns + 1.0), np.arange(rows + 1.0))
    z = rng.normal(scale=0.3, size=x.size)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return Mesh(np.column_stack([x.ravel(), y.ravel(), z]), faces)


def normals(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return twice the area times the unit normal of each face."""
    p, q, r = (points[faces[:, i]] for i in range(3))
    return np.cross(q - p, r - p)


def edge_counts(mesh: Mesh) -> dict[tuple[int, int], int]:
    counts: dict[tuple[int, int], int] = {}
    for face in mesh.faces.tolist():
        for a, b in ((0, 1), (1, 2), (2, 0)):
            edge = (min(face[a], face[b]), max(face[a], face[b]))
            counts[edge] = counts.get(edge, 0) + 1
    return counts


# --- An oracle: plain quadrics, every candidate priced anew in every step ------------------------


class BruteForce:
    """QEM_ORIG as in section 2.3.1, with homogeneous 4 x 4 quadrics and without a queue."""

    def __init__(self, mesh: Mesh) -> None:
        low, high = mesh.bounds
        self.scale = float(np.linalg.norm(high - low))
        self.points = (mesh.vertices - (low + high) / 2) / self.scale
        self.faces = mesh.faces.tolist()
        self.quadrics = np.zeros((mesh.num_vertices, 4, 4))
        self.weights = np.zeros(mesh.num_vertices)
        for face in self.faces:
            p, q, r = self.points[face]
            area_vector = np.cross(q - p, r - p)
            area = np.linalg.norm(area_vector) / 2
            n = area_vector / (2 * area)
            plane = np.append(n, -n @ p)
            for v in face:
                self.quadrics[v] += area * np.outer(plane, plane)
                self.weights[v] += area

    def neighbours(self, v: int) -> set[int]:
        return {w for face in self.faces if v in face for w in face} - {v}

    def on_boundary(self, v: int) -> bool:
        return any(self.edge_faces(v, w) == 1 for w in self.neighbours(v))

    def edge_faces(self, v: int, w: int) -> int:
        return sum(v in face and w in face for face in self.faces)

    def squared_cost(self, v: int, t: int) -> float:
        x = np.append(self.points[t], 1.0)
        return max(0.0, float(x @ (self.quadrics[v] + self.quadrics[t]) @ x))

    def is_legal(self, v: int, t: int) -> bool:
        third = {w for face in self.faces if v in face and t in face for w in face} - {v, t}
        if self.neighbours(v) & self.neighbours(t) != third:
            return False
        if self.on_boundary(v) and self.on_boundary(t) and self.edge_faces(v, t) != 1:
            return False
        kept = {frozenset(face) for face in self.faces if v not in face}
        for face in self.faces:
            if v not in face or t in face:
                continue
            moved = [t if w == v else w for w in face]
            before, after = normals(self.points, np.array([face, moved]))
            cosine = before @ after / (np.linalg.norm(before) * np.linalg.norm(after))
            if cosine <= 0.2 or frozenset(moved) in kept:
                return False
        return True

    def run(self, target_faces: int) -> list[tuple[int, int, float]]:
        record = []
        while len(self.faces) > target_faces:
            candidates = [
                (self.squared_cost(v, t) + 1e-9 * self.weights[v] * self.length(v, t) ** 2, v, t)
                for v in range(len(self.points))
                for t in self.neighbours(v)
                if self.is_legal(v, t)
            ]
            if not candidates:
                break
            _, v, t = min(candidates)
            weight = self.weights[v] + self.weights[t]
            record.append((v, t, self.scale * np.sqrt(self.squared_cost(v, t) / weight)))
            self.quadrics[t] += self.quadrics[v]
            self.weights[t] += self.weights[v]
            self.faces = [
                [t if w == v else w for w in face]
                for face in self.faces
                if not (v in face and t in face)
            ]
        return record

    def length(self, v: int, t: int) -> float:
        return float(np.linalg.norm(self.points[v] - self.points[t]))


@pytest.mark.parametrize("seed", range(4))
def test_plain_quadrics_equal_a_brute_force_search(seed: int) -> None:
    mesh = bumpy_grid(6, 5, seed)
    expected = BruteForce(mesh).run(target_faces=12)
    result = simplify.qem_orig(mesh, target_faces=12)
    assert result.collapses.tolist() == [[v, t] for v, t, _ in expected]
    # Zero comes out as the square root of rounding noise, 1e-8 of the diagonal.
    np.testing.assert_allclose(
        result.collapse_errors, [e for *_, e in expected], rtol=1e-9, atol=1e-7
    )
    assert result.max_error == max(result.collapse_errors)


# --- Boundaries ------------------------------------------------------------------------------


def strip(columns: int = 20) -> Mesh:
    """Return a flat strip, 2 squares high, whose straight boundary costs nothing to simplify.

    y 2  o--o--o- ... -o
         | /| /|       |
      1  o--o--o- ... -o
         | /| /|       |
      0  o--o--o- ... -o
    """
    flat = bumpy_grid(columns, 2, seed=0)
    return flat.replace(vertices=flat.vertices * [1, 1, 0])


def test_a_flat_strip_becomes_its_rectangle() -> None:
    result = simplify.qem4vr(strip(20), target_faces=2)
    assert result.stop == StopReason.TARGET_REACHED
    corners = {tuple(p) for p in result.mesh.vertices.tolist()}
    assert corners == {(0, 0, 0), (20, 0, 0), (20, 2, 0), (0, 2, 0)}
    assert np.linalg.norm(normals(result.mesh.vertices, result.mesh.faces), axis=1).sum() == 80
    assert result.max_error == 0.0


def test_without_a_boundary_term_the_strip_erodes() -> None:
    result = simplify.qem_orig(strip(20), target_faces=2)
    area = np.linalg.norm(normals(result.mesh.vertices, result.mesh.faces), axis=1).sum() / 2
    assert area < 0.9 * 40


def test_frozen_boundaries_stop_early_and_weighted_ones_do_not() -> None:
    frozen = simplify.qem_bp(strip(20), target_faces=4)
    assert frozen.stop == StopReason.NO_LEGAL_COLLAPSE
    assert frozen.locked_vertices == 44  # every vertex of the outline is still there
    assert frozen.mesh.num_faces == 42  # a polygon of 44 corners
    weighted = simplify.qem_bp(strip(20), target_faces=4, boundary="weight")
    assert weighted.stop == StopReason.TARGET_REACHED


def disc(rim: int = 64, rings: int = 8) -> Mesh:
    """Return a flat disc of radius 1: a vertex in the centre, then rings of ``rim`` vertices."""
    angle = np.arange(rim) * 2 * np.pi / rim
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(rim)])
    radii = np.arange(1, rings + 1) / rings
    vertices = np.concatenate([np.zeros((1, 3)), *(r * circle for r in radii)])
    after = (np.arange(rim) + 1) % rim
    fan = np.column_stack([np.zeros(rim, int), 1 + np.arange(rim), 1 + after])
    faces = [fan]
    for ring in range(rings - 1):
        a, b = 1 + ring * rim + np.arange(rim), 1 + ring * rim + after
        faces += [np.column_stack([a, a + rim, b + rim]), np.column_stack([a, b + rim, b])]
    return Mesh(vertices, np.concatenate(faces))


def test_a_curved_rim_keeps_its_shape() -> None:
    mesh = disc()
    result = simplify.qem4vr(mesh, target_faces=30)
    assert result.stop == StopReason.TARGET_REACHED
    boundary = {v for edge, n in edge_counts(result.mesh).items() if n == 1 for v in edge}
    on_rim = np.linalg.norm(result.mesh.vertices[sorted(boundary)], axis=1)
    np.testing.assert_allclose(on_rim, 1.0)  # the rim is still made of vertices of the rim
    # A regular polygon of as many corners has the least gap that any choice can have.
    gap = metrics.boundary_gap(mesh, result.mesh).forward.max
    regular = 1 - np.cos(np.pi / len(boundary))
    assert regular * 0.99 <= gap <= 4 * regular
    plain = simplify.qem_orig(mesh, target_faces=30).mesh
    assert metrics.boundary_gap(mesh, plain).forward.max > 4 * gap


def test_more_boundary_weight_means_less_boundary_gap() -> None:
    mesh = models.hill()
    gaps = [
        metrics.boundary_gap(
            mesh, simplify.qem4vr(mesh, ratio=0.1, boundary_weight=weight).mesh
        ).forward.mean
        for weight in (0.0, 5.0, 1000.0)
    ]
    assert gaps[2] <= gaps[1] <= gaps[0]
    assert gaps[2] < gaps[0]


def test_boundary_loops_keep_three_edges() -> None:
    """A lone triangle is not collapsed."""
    triangle = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    result = simplify.qem4vr(triangle, target_faces=0)
    assert result.stop == StopReason.NO_LEGAL_COLLAPSE
    assert result.rejected["boundary_loop"] > 0
    assert result.mesh.num_faces == 1


def test_complex_vertices_stay() -> None:
    """A vertex in which two strips touch, with four boundary neighbours, stays in place."""
    one = strip(6)
    other = one.vertices + np.array([6, 2, 0])
    both = simplify.clean(
        Mesh(np.concatenate([one.vertices, other]), np.concatenate([one.faces, one.faces + 21]))
    ).mesh
    result = simplify.qem4vr(both, target_faces=4)
    assert result.stop == StopReason.TARGET_REACHED
    assert (result.mesh.vertices == [6, 2, 0]).all(axis=1).sum() == 1
    assert result.locked_vertices == 1
    frozen = simplify.qem4vr(both, target_faces=4, complex_vertices="freeze")
    assert frozen.rejected["complex_vertex"] > 0


# --- Seams -----------------------------------------------------------------------------------


def floor(cells: int = 12) -> Mesh:
    """Return a flat floor of two materials that meet in a wavy line around x = cells / 2."""
    flat = strip_grid(cells)
    centre = flat.vertices[flat.faces].mean(axis=1)
    wave = cells / 2 + 2 * np.round(np.sin(centre[:, 1] * np.pi / 6))
    return flat.replace(
        face_material=(centre[:, 0] > wave).astype(np.int32),
        materials=[manip3d.Material("oak"), manip3d.Material("stone")],
    )


def strip_grid(cells: int) -> Mesh:
    flat = bumpy_grid(cells, cells, seed=0)
    return flat.replace(vertices=flat.vertices * [1, 1, 0])


def material_areas(mesh: Mesh) -> list[float]:
    assert mesh.face_material is not None
    areas = np.linalg.norm(normals(mesh.vertices, mesh.faces), axis=1) / 2
    return [float(areas[mesh.face_material == m].sum()) for m in (0, 1)]


@pytest.mark.parametrize("mode", ["planes", "lock"])
def test_a_flat_floor_of_two_materials_keeps_its_seam(mode: simplify.SeamMode) -> None:
    mesh = floor()
    result = simplify.qem4vr(mesh, ratio=0.25, seam_mode=mode)
    assert result.stop == StopReason.TARGET_REACHED
    np.testing.assert_allclose(material_areas(result.mesh), material_areas(mesh), rtol=1e-12)


def test_where_the_quadric_is_zero_a_multiplier_protects_nothing() -> None:
    """W_t as printed and plain quadrics move the seam of a flat floor, where quadrics are 0."""
    mesh = floor()
    for result in (
        simplify.qem4vr(mesh, ratio=0.25, seam_mode="paper"),
        simplify.qem_orig(mesh, ratio=0.25),
    ):
        assert abs(material_areas(result.mesh)[0] - material_areas(mesh)[0]) > 0.1


def pairs_of(mesh: Mesh) -> set[tuple[float, ...]]:
    """Return the set of (x, y, z, u, v) of all corners."""
    assert mesh.texcoords is not None
    assert mesh.face_texcoords is not None
    corners = np.concatenate(
        [mesh.vertices[mesh.faces], mesh.texcoords[mesh.face_texcoords]], axis=2
    )
    return {tuple(corner) for corner in corners.reshape(-1, 5).tolist()}


def test_a_seam_with_two_texture_coordinates_stays_closed() -> None:
    """The seam of a pipe stays closed, and each vertex keeps its texture coordinates."""
    mesh = models.pipe()
    result = simplify.qem4vr(mesh, ratio=0.2)
    assert result.stop == StopReason.TARGET_REACHED
    assert pairs_of(result.mesh) <= pairs_of(mesh)
    assert result.mesh.texcoords is not None
    u = result.mesh.texcoords[result.mesh.face_texcoords][:, :, 0]
    assert (np.ptp(u, axis=1) <= 0.5).all()
    assert metrics.boundary_gap(mesh, result.mesh).cracks == 0
    error = metrics.texture_error(mesh, result.mesh)
    assert error.mean < metrics.texture_error(mesh, simplify.qem_orig(mesh, ratio=0.2).mesh).mean


def test_texture_quadrics_refuse_faces_without_texture_coordinates() -> None:
    mesh = models.floor()
    assert mesh.face_texcoords is not None
    untextured = int((mesh.face_texcoords < 0).any(axis=1).sum())
    for method in (simplify.qem_tp, simplify.qem_btp):
        result = method(mesh, ratio=0.5)
        assert result.stop == StopReason.REFUSED
        assert f"{untextured} of {mesh.num_faces}" in result.message
        np.testing.assert_array_equal(result.mesh.faces, mesh.faces)


def test_texture_quadrics_price_texture_coordinates() -> None:
    """Quadrics with texture coordinates lower the texture error, and raise that of the shape."""
    ball = simplify.clean(models.ball()).mesh
    u = np.abs(ball.vertices[:, 0]) ** 3 + 0.2 * ball.vertices[:, 1]
    mesh = ball.replace(
        texcoords=np.column_stack([u, ball.vertices[:, 2]]), face_texcoords=ball.faces
    )
    textured, plain = (run(mesh, ratio=0.2).mesh for run in (simplify.qem_tp, simplify.qem_orig))
    error, without = (metrics.texture_error(mesh, m).rms for m in (textured, plain))
    assert error < 0.9 * without
    assert metrics.metro(mesh, textured).mean > metrics.metro(mesh, plain).mean  # its price


def test_normals_and_colors_follow_their_vertices() -> None:
    mesh = models.ball()
    unit = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    colors = np.arange(3 * mesh.num_vertices).reshape(-1, 3) % 251
    mesh = mesh.replace(normals=unit, face_normals=mesh.faces, colors=colors)
    result = simplify.qem4vr(mesh, ratio=0.3)
    out = result.mesh
    assert out.normals is not None
    assert out.face_normals is not None
    assert out.colors is not None
    np.testing.assert_array_equal(out.colors, colors[result.kept])
    np.testing.assert_array_equal(out.normals[out.face_normals], unit[result.kept][out.faces])


# --- Results that hold for every method ---------------------------------------------------------


@pytest.fixture(params=METHODS)
def method(request: pytest.FixtureRequest) -> Callable[..., SimplifyResult]:
    return METHODS[request.param]


MESHES = {"hill": models.hill(), "ball": models.ball(), "pipe": models.pipe()}


@pytest.fixture(params=MESHES)
def mesh(request: pytest.FixtureRequest) -> Mesh:
    return MESHES[request.param]


def test_vertices_are_input_vertices_and_the_maps_agree(
    mesh: Mesh, method: Callable[..., SimplifyResult]
) -> None:
    result = method(mesh, ratio=0.3)
    np.testing.assert_array_equal(result.mesh.vertices, mesh.vertices[result.kept])
    np.testing.assert_array_equal(result.vertex_map[result.kept], np.arange(len(result.kept)))
    for removed, kept in result.collapses.tolist():
        assert result.vertex_map[removed] == result.vertex_map[kept]
    gone = result.face_map < 0
    assert (~gone).sum() == result.mesh.num_faces
    np.testing.assert_array_equal(
        result.vertex_map[mesh.faces[~gone]], result.mesh.faces[result.face_map[~gone]]
    )


def test_a_level_of_detail_equals_a_run_of_its_own(
    mesh: Mesh, method: Callable[..., SimplifyResult]
) -> None:
    result = method(mesh, ratio=0.1)
    for target in (mesh.num_faces // 2, mesh.num_faces // 4):
        direct = method(mesh, target_faces=target).mesh
        replayed = result.level_of_detail(target)
        for name in Mesh.__slots__:
            np.testing.assert_array_equal(getattr(replayed, name), getattr(direct, name))


def test_a_foreign_record_is_refused() -> None:
    result = simplify.qem4vr(models.hill(), ratio=0.5)
    result.collapses[0] = [0, len(models.hill().vertices) - 1]
    with pytest.raises(InputError, match="expected the record of this mesh"):
        result.level_of_detail(10)


def test_the_closed_surface_stays_a_closed_surface() -> None:
    ball = simplify.clean(models.ball()).mesh
    result = simplify.qem4vr(ball, ratio=0.05)
    assert set(edge_counts(result.mesh).values()) == {2}
    euler = result.mesh.num_vertices - len(edge_counts(result.mesh)) + result.mesh.num_faces
    assert euler == 2


@pytest.mark.parametrize(("scale", "shift"), [(1e9, 0.0), (1e-9, 0.0), (1.0, 1e6), (1000.0, -3e8)])
def test_the_unit_and_the_origin_do_not_matter(scale: float, shift: float) -> None:
    """Scale and shift hardly change the error; factors that round change the bits."""
    mesh = models.hill()
    moved = mesh.replace(vertices=scale * mesh.vertices + shift)
    one, two = (simplify.qem4vr(m, ratio=0.2) for m in (mesh, moved))
    assert abs(one.mesh.num_faces - two.mesh.num_faces) <= 1  # ties fall by rounding
    first = metrics.metro(mesh, one.mesh).mean
    second = metrics.metro(moved, two.mesh).mean
    assert second == pytest.approx(first, rel=0.1)


def test_a_power_of_two_in_scale_changes_no_collapse() -> None:
    mesh = models.hill()
    one = simplify.qem4vr(mesh, ratio=0.2)
    two = simplify.qem4vr(mesh.replace(vertices=1024.0 * mesh.vertices), ratio=0.2)
    np.testing.assert_array_equal(one.collapses, two.collapses)
    assert two.max_error == 1024 * one.max_error


def test_a_far_away_speck_changes_the_curvature_of_the_paper_only() -> None:
    """A far speck changes the unit of eq. 2.5 as printed, the diagonal, and no other curvature."""
    mesh = bumpy_grid(12, 10, seed=1)
    v = mesh.num_vertices
    speck = Mesh(
        np.concatenate([mesh.vertices, np.array([[0, 0, 99.0], [0.1, 0, 99], [0, 0.1, 99]])]),
        np.concatenate([mesh.faces, [[v, v + 1, v + 2]]]),
    )
    same = {}
    for curvature in get_args(simplify.Curvature):
        alone = simplify.qem4vr(mesh, target_faces=60, curvature=curvature)
        beside = simplify.qem4vr(speck, target_faces=61, curvature=curvature)
        same[curvature] = alone.collapses.tolist() == beside.collapses.tolist()
    assert same == {"turning": True, "paper": False}


def test_max_error_is_never_exceeded_and_all_below_it_is_used() -> None:
    mesh = models.hill()
    full = simplify.qem4vr(mesh, target_faces=0)
    limit = float(np.median(full.collapse_errors))
    result = simplify.qem4vr(mesh, max_error=limit)
    assert result.stop == StopReason.ERROR_LIMIT
    assert 0 < result.max_error <= limit
    assert result.rejected["error_limit"] > 0
    both = simplify.qem4vr(mesh, max_error=limit, target_faces=result.mesh.num_faces + 50)
    assert both.stop == StopReason.TARGET_REACHED


def test_targets_combine_to_the_first_reached() -> None:
    mesh = models.ball()
    result = simplify.qem4vr(mesh, target_faces=100, ratio=0.5)
    assert mesh.num_faces // 2 - 1 <= result.mesh.num_faces <= mesh.num_faces // 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "target_faces, ratio, max_error or max_distance: expected at least one, got none"),
        ({"ratio": 1.5}, r"ratio: expected a number in \[0, 1\], got 1.5"),
        ({"ratio": float("nan")}, "ratio: expected a number"),
        ({"target_faces": -1}, "target_faces: expected >= 0, got -1"),
        ({"max_error": float("nan")}, "max_error: expected >= 0, got nan"),
        ({"ratio": 0.5, "boundary_weight": -1.0}, "boundary_weight: expected a finite number"),
        ({"ratio": 0.5, "seam_weight": float("inf")}, "seam_weight: expected a finite number"),
        ({"ratio": 0.5, "quality_threshold": 2.0}, "quality_threshold: expected a number"),
        ({"ratio": 0.5, "quality_threshold": 1e300}, r"\[0, 1\], got 1e\+300$"),
        ({"ratio": 0.5, "curvature": "round"}, "curvature: expected 'turning' or 'paper'"),
        ({"ratio": 0.5, "seam_mode": "x"}, "seam_mode: expected 'planes', 'paper' or"),
        ({"ratio": 0.5, "link_condition": "x"}, "link_condition: expected 'manifold'"),
    ],
)
def test_bad_options_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simplify.qem4vr(models.hill(), **options)  # type: ignore[arg-type]


def test_progress_is_reported_and_cancels() -> None:
    seen: list[float] = []
    simplify.qem4vr(
        models.hill(101), ratio=0.01, progress=lambda fraction, _: seen.append(fraction)
    )
    assert all(0 <= a <= b <= 1 for a, b in itertools.pairwise(seen))

    def cancel(_: float, message: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simplify.qem4vr(models.hill(301), ratio=0.0, progress=cancel)


@settings(max_examples=200, deadline=None)
@given(soups(max_vertices=12, max_faces=30), st.sampled_from(sorted(METHODS)), st.floats(0, 1))
def test_soups_stay_valid(mesh: Mesh, name: str, ratio: float) -> None:
    if mesh.num_faces == 0:
        with pytest.raises(InputError, match="at least one face"):
            METHODS[name](mesh, ratio=ratio)
        return
    if not (np.diff(np.sort(mesh.faces, axis=1), axis=1) > 0).all(axis=1).any():
        with pytest.raises(InputError, match="three different corners"):
            METHODS[name](mesh, ratio=ratio)
        return
    result = METHODS[name](mesh, ratio=ratio)
    assert_simplified(mesh, result, ratio)


def assert_simplified(mesh: Mesh, result: SimplifyResult, ratio: float) -> None:
    """Check that a result is valid, without new degenerate or duplicate faces, at its target."""
    out = result.mesh
    out.validate()
    if result.stop == StopReason.TARGET_REACHED:
        assert out.num_faces <= max(
            1 if ratio > 0 else 0, ratio * mesh.num_faces
        )  # a face at least
    triples = np.sort(out.faces, axis=1)
    assert (np.diff(triples, axis=1) > 0).all()
    before = {tuple(face) for face in np.sort(mesh.faces, axis=1).tolist()}
    duplicates_before = mesh.num_faces - len(before)
    duplicates = len(triples) - len({tuple(face) for face in triples.tolist()})
    assert duplicates <= duplicates_before
    if mesh.face_material is not None and out.num_faces > 0:
        assert out.face_material is not None
        np.testing.assert_array_equal(out.face_material, mesh.face_material[result.face_map >= 0])


@pytest.mark.parametrize("mode", ["quality", "fast", "published"])
def test_a_mesh_that_cleaning_empties_is_refused(mode: Any) -> None:
    mesh = Mesh(np.eye(3), [[0, 0, 1], [1, 1, 2]])
    refusal = "mesh: expected a face with three different corners, got none of 2 faces"
    with pytest.raises(InputError, match=refusal):
        simplify.simplify(mesh, mode, target_faces=1)
    if mode != "published":
        with pytest.raises(InputError, match=refusal):
            simplify.simplify(mesh, mode, target_faces=1, memory=64 << 30)
    with pytest.raises(InputError, match=refusal):
        simplify.lod_chain(mesh, [1], method="qem4vr" if mode == "published" else mode)


@pytest.mark.parametrize("mode", ["quality", "fast", "published"])
def test_a_small_ratio_is_a_face_at_least(mode: Any) -> None:
    corners = np.array([[x, y, np.sin(x)] for x in range(10) for y in range(10)], dtype=float)
    faces = [[i, i + 10, i + 11 - k] if k else [i, i + 11, i + 1]
             for i in range(89) if i % 10 != 9 for k in (0, 1)]  # fmt: skip
    sheet = Mesh(corners, faces)
    assert sheet.num_faces == 162
    assert simplify.simplify(sheet, mode, ratio=0.001).mesh.num_faces >= 1


def hilly(n: int = 14) -> Mesh:
    """Return a sheet with waves and texture coordinates, and a small piece beside it."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.arange(n) - 5.25, np.arange(n) + 3.5))
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n + 1], 1), np.stack([i, i + n + 1, i + n], 1)])
    corners = np.stack([x, y, np.sin(x) + np.cos(0.7 * y)], 1)
    corners = np.concatenate([corners, [[30, 30, 30], [31, 30, 30], [30, 31, 30.5]]])
    faces = np.concatenate([faces, [[n * n, n * n + 1, n * n + 2]]])
    return Mesh(corners, faces, texcoords=corners[:, :2] / n, face_texcoords=faces)


MODES_AND_LIMITS = [
    (mode, limit)
    for mode in ("quality", "fast", "published")
    for limit in ("ratio", "max_error", "max_distance")
    if (mode, limit) != ("fast", "max_distance")  # the fast mode has no such limit
]


@pytest.mark.parametrize(("mode", "limit"), MODES_AND_LIMITS)
@pytest.mark.parametrize("exponent", [-1000, -660, -210, 210, 660, 1015])
def test_no_unit_is_too_small_or_too_large(exponent: int, mode: Any, limit: str) -> None:
    """The result is the same at any scale by a power of two, which rounds nothing."""
    mesh, unit = hilly(), 2.0**exponent
    scaled = mesh.replace(vertices=mesh.vertices * unit)
    here, there = (0.2, 0.2) if limit == "ratio" else (0.05, 0.05 * unit)
    expected = simplify.simplify(mesh, mode, **{limit: here})
    result = simplify.simplify(scaled, mode, **{limit: there})
    assert expected.mesh.num_faces < 0.8 * mesh.num_faces
    assert result.stop == expected.stop
    np.testing.assert_array_equal(result.mesh.faces, expected.mesh.faces)
    np.testing.assert_array_equal(result.mesh.vertices, expected.mesh.vertices * unit)
    np.testing.assert_array_equal(result.mesh.texcoords, expected.mesh.texcoords)
    assert result.max_error == expected.max_error * unit
    if expected.distance_bound is not None:
        assert result.distance_bound == expected.distance_bound * unit
    if isinstance(result, SimplifyResult):
        coarser = result.level_of_detail(result.mesh.num_faces)
        np.testing.assert_array_equal(coarser.vertices, result.mesh.vertices)


@pytest.mark.parametrize("mode", ["quality", "fast", "published"])
def test_a_size_beyond_all_numbers_is_refused(mode: Any) -> None:
    mesh = hilly()
    largest = mesh.vertices / np.abs(mesh.vertices).max() * 1.7e308
    with pytest.raises(InputError, match="vertices: expected a bounding box whose diagonal"):
        simplify.simplify(mesh.replace(vertices=largest * [1, -1, 1]), mode, ratio=0.5)
