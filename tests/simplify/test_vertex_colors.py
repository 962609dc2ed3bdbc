"""Colours of vertices: what simplification keeps of their picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from manip3d import InputError, Material, Mesh, simplify
from manip3d.metrics import color_error
from manip3d.simplify._color_seams import color_seams

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from manip3d.simplify import QualityResult

MODES = ["quality", "fast"]
RED, WHITE = (220, 30, 30), (240, 240, 240)
ASIDE = np.array([1.0, 0.0, 0.0])


def run(mode: str, mesh: Mesh, **options: object) -> QualityResult:
    result: QualityResult = getattr(simplify, mode)(mesh, **options)
    return result


def plate(size: int, color: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> Mesh:
    """A square of side 1 with ``2 size ** 2`` faces."""
    steps = np.linspace(0.0, 1.0, size + 1)
    x, y = np.meshgrid(steps, steps, indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(size + 1, size + 1)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate(
        [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    )
    return Mesh(vertices, faces, colors=np.rint(color(vertices)).astype(np.uint8))


def disc(points: NDArray[np.float64]) -> NDArray[np.float64]:
    inside = np.hypot(points[:, 0] - 0.5, points[:, 1] - 0.5) < 0.3
    return np.where(inside[:, None], RED, WHITE).astype(np.float64)


def slope(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([200 * points[:, 0], 10 + 200 * points[:, 1], 100 + 0 * points[:, 0]], axis=1)


def shown(mesh: Mesh, count: int = 20_000) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Random points of a mesh, uniform over its area, and the colours there."""
    assert mesh.colors is not None
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    face = rng.choice(len(corners), count, p=area / area.sum())
    share = rng.dirichlet([1.0, 1.0, 1.0], count)[:, :, None]
    colors = mesh.colors[mesh.faces[face]].astype(np.float64)
    return (corners[face] * share).sum(axis=1), (colors * share).sum(axis=1)


def wrong_share(mesh: Mesh) -> float:
    """Share of the area of a plate where a channel differs from the disc's by more than 64."""
    points, colors = shown(mesh)
    return float((np.abs(colors - disc(points)).max(axis=1) > 64).mean())


@pytest.mark.parametrize("mode", MODES)
def test_a_picture_painted_on_a_flat_surface_stays(mode: str) -> None:
    mesh = plate(60, disc)
    kept = run(mode, mesh, ratio=0.04).mesh
    lost = run(mode, mesh, ratio=0.04, color_weight=0.0).mesh
    assert wrong_share(kept) < 0.025  # the original: 0.012, as its border has the width of a face
    assert wrong_share(lost) > 2 * wrong_share(kept)


def test_colors_that_change_linearly_cost_nothing() -> None:
    """The linear continuation of each face's colours is that of its neighbours."""
    result = run("quality", plate(20, slope), target_faces=8)
    assert result.mesh.num_faces <= 8
    points, colors = shown(result.mesh)
    assert np.abs(colors - slope(points)).max() <= 4.0


@pytest.mark.parametrize("mode", MODES)
def test_the_price_of_colors_has_no_unit_of_length(mode: str) -> None:
    """The same mesh in another unit is simplified in the same way."""
    mesh = plate(30, disc)
    factor = 2.0**20  # rounds nothing
    small = run(mode, mesh, ratio=0.05).mesh
    large = run(mode, mesh.replace(vertices=factor * mesh.vertices), ratio=0.05).mesh
    assert wrong_share(large.replace(vertices=large.vertices / factor)) == pytest.approx(
        wrong_share(small), abs=0.005
    )


def test_an_almost_uniform_color_does_not_cost_the_shape() -> None:
    """Noise of a level or two must not count as much as a bump."""
    rng = np.random.default_rng(1)
    flat = plate(40, lambda points: np.full((len(points), 3), 128.0))
    bumps = 0.02 * np.sin(9 * flat.vertices[:, 0]) * np.sin(7 * flat.vertices[:, 1])
    vertices = np.column_stack([flat.vertices[:, :2], bumps])
    noisy = flat.replace(
        vertices=vertices, colors=rng.integers(127, 130, (flat.num_vertices, 3), dtype=np.uint8)
    )
    plain = noisy.replace(colors=None)
    with_colors = run("quality", noisy, ratio=0.05)
    without = run("quality", plain, ratio=0.05)
    assert with_colors.max_error < 1.5 * without.max_error


@pytest.mark.parametrize("mode", MODES)
def test_locked_vertices_keep_their_colors(mode: str) -> None:
    mesh = plate(20, disc)
    locked = mesh.vertices[:, 0] < 0.4
    result = run(mode, mesh, ratio=0.6, locked=locked)
    assert mesh.colors is not None
    assert result.mesh.colors is not None
    into = result.vertex_map[locked]
    assert (into >= 0).all()
    assert np.array_equal(result.mesh.vertices[into], mesh.vertices[locked])
    assert np.array_equal(result.mesh.colors[into], mesh.colors[locked])


SIDES = np.array(
    [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [0, 255, 255], [255, 0, 255]]
)


def cube(size: int) -> Mesh:
    """A cube whose sides have their own vertices and one colour each, like a block of voxels."""
    side = plate(size, disc)
    vertices, faces, colors = [], [], []
    for number, color in enumerate(SIDES):
        axis, is_far = divmod(number, 2)
        here = np.roll(side.vertices + np.array([0.0, 0.0, is_far]), axis, axis=1)
        vertices.append(here)
        turned = side.faces if is_far else side.faces[:, ::-1]
        faces.append(turned + number * side.num_vertices)
        colors.append(np.broadcast_to(color, (side.num_vertices, 3)))
    return Mesh(
        np.concatenate(vertices),
        np.concatenate(faces),
        colors=np.concatenate(colors).astype(np.uint8),
    )


def side_of(mesh: Mesh) -> NDArray[np.int64]:
    """The side of a unit cube on which each face lies, as in `SIDES`."""
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    distances = np.abs(np.stack([middles, middles - 1.0], axis=2)).reshape(len(middles), 6)
    # plate() is rolled: its z axis becomes the axis (2 + number) % 3.
    axes = [(2 + axis) % 3 for axis in range(3)]
    order = [2 * axes.index(axis) + far for axis in range(3) for far in range(2)]
    sides: NDArray[np.int64] = np.array(order)[distances.argmin(axis=1)]
    return sides


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("target", [12, 60, 1200])
def test_sides_with_a_color_each_keep_it(mode: str, target: int) -> None:
    mesh = cube(10)
    result = run(mode, mesh, target_faces=target)
    simplified = result.mesh
    assert simplified.colors is not None
    assert mesh.colors is not None
    assert simplified.num_faces <= target
    corners = simplified.colors[simplified.faces]
    assert np.array_equal(corners, np.repeat(SIDES[side_of(simplified)][:, None], 3, axis=1))
    assert simplified.materials == ()
    assert simplified.face_material is None
    stays = result.vertex_map >= 0
    assert np.array_equal(simplified.colors[result.vertex_map[stays]], mesh.colors[stays])
    assert len(np.unique(simplified.vertices, axis=0)) < simplified.num_vertices  # still split


@pytest.mark.parametrize("mode", MODES)
def test_meshes_of_different_colors_that_touch_keep_them_and_their_materials(mode: str) -> None:
    left = plate(10, lambda points: np.broadcast_to([255.0, 0, 0], points.shape))
    right = plate(10, lambda points: np.broadcast_to([0, 0, 255.0], points.shape))
    mesh = Mesh(
        np.concatenate([left.vertices, right.vertices + ASIDE]),
        np.concatenate([left.faces, right.faces + left.num_vertices]),
        colors=np.concatenate([left.colors, right.colors]),
        face_material=np.repeat(np.array([1, 0], np.int32), left.num_faces),
        materials=[Material("right"), Material("left")],
    )
    simplified = run(mode, mesh, ratio=0.1).mesh
    assert simplified.colors is not None
    assert simplified.face_material is not None
    is_left = simplified.vertices[simplified.faces].mean(axis=1)[:, 0] < 1.0
    wanted = np.where(is_left[:, None, None], [255, 0, 0], [0, 0, 255])
    assert np.array_equal(
        simplified.colors[simplified.faces], np.broadcast_to(wanted, (len(wanted), 3, 3))
    )
    assert np.array_equal(simplified.face_material, np.where(is_left, 1, 0))
    assert [material.name for material in simplified.materials] == ["right", "left"]


def test_regions_that_are_shaded_keep_their_borders_and_shades() -> None:
    """Two halves whose colours change linearly, with a jump between them."""

    def halves(points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([100 * points[:, 0], 50 + 0 * points[:, 0], 100 * points[:, 1]], axis=1)

    left = plate(12, halves)
    jump = plate(12, lambda points: 255.0 - halves(points))
    mesh = Mesh(
        np.concatenate([left.vertices, jump.vertices + ASIDE]),
        np.concatenate([left.faces, jump.faces + left.num_vertices]),
        colors=np.concatenate([left.colors, jump.colors]),
    )
    for mode in MODES:
        points, colors = shown(run(mode, mesh, ratio=0.1).mesh)
        inner = points - np.where(points[:, :1] > 1.0, [1.0, 0.0, 0.0], 0.0)
        wanted = np.where(points[:, :1] > 1.0, 255.0 - halves(inner), halves(inner))
        assert np.abs(colors - wanted).max() <= 3.0


@pytest.mark.parametrize("mode", MODES)
def test_colored_points_without_faces_are_no_surface(mode: str) -> None:
    points = Mesh(np.zeros((2, 3)), np.zeros((0, 3), np.int32), colors=[[0, 0, 0], [9, 9, 9]])
    with pytest.raises(InputError, match="at least one face"):
        run(mode, points, ratio=0.5)


def test_places_that_mirror_each_other_are_not_one() -> None:
    corners = np.array([[1.0, 2.0, 3.0], [-1.0, -2.0, 3.0], [1.0, -2.0, -3.0], [-1.0, 2.0, -3.0]])
    colors = 60 * np.arange(12, dtype=np.uint8).reshape(4, 3) % 251
    assert color_seams(Mesh(corners, [[0, 1, 2], [0, 2, 3]], colors=colors)) is None
    twice, same = np.repeat(corners, 2, axis=0), np.repeat(colors, 2, axis=0)
    assert color_seams(Mesh(twice, [[0, 2, 4]], colors=same)) is None
    assert color_seams(Mesh(twice, [[0, 2, 4]], colors=np.roll(same, 1, axis=0))) is not None


@pytest.mark.parametrize("mode", MODES)
def test_colors_at_one_place_that_hardly_differ_are_one_color(mode: str) -> None:
    """Scans whose faces were coloured one by one: each has three vertices of its own."""
    mesh = plate(30, slope)
    assert mesh.colors is not None
    rng = np.random.default_rng(0)
    rows = mesh.faces.reshape(-1)
    noise = rng.integers(-1, 2, (len(rows), 3))
    soup = Mesh(
        mesh.vertices[rows],
        np.arange(len(rows), dtype=np.int32).reshape(-1, 3),
        colors=np.clip(mesh.colors[rows].astype(int) + noise, 0, 255).astype(np.uint8),
    )
    light = run(mode, soup, ratio=0.1).mesh
    assert light.num_vertices < 0.8 * light.num_faces  # connected, not face by face
    assert color_error(soup, light).mean < 4


def test_hardly_different_colors_do_not_cut_beside_real_borders() -> None:
    """Two squares side by side, red and white, each with colours of its own at every corner."""
    square = plate(8, lambda points: np.full((len(points), 3), 100.0))
    rows = square.faces.reshape(-1)
    rng = np.random.default_rng(0)
    near = rng.integers(-2, 3, (2, len(rows), 3))
    both = Mesh(
        np.concatenate([square.vertices[rows], square.vertices[rows] + ASIDE]),
        np.arange(2 * len(rows), dtype=np.int32).reshape(-1, 3),
        colors=np.concatenate([near[0] + RED, near[1] + WHITE]).astype(np.uint8),
    )
    seams = color_seams(both)
    assert seams is not None
    assert seams.mesh.face_material is not None
    assert len(np.unique(seams.mesh.face_material)) == 2
