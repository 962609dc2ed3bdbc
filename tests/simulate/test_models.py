"""Procedural models: each has the traits that its documentation promises, at any size."""

from __future__ import annotations

import io
from dataclasses import asdict
from functools import cache

import numpy as np
import pytest

from manip3d import InputError, Mesh
from manip3d.simulate import models
from manip3d.simulate._surfaces import box, join, png, surface_of
from zoo import volume


@cache
def small(name: str) -> Mesh:
    """A model of about 6 000 faces."""
    return models.MODELS[name](6_000)


def euler(mesh: Mesh) -> int:
    summary = mesh.summary()
    return summary.vertices - summary.edges + summary.faces


@pytest.mark.parametrize("name", models.MODELS)
@pytest.mark.parametrize("faces", [5_000, 20_000])
def test_size_is_about_what_was_asked_for(name: str, faces: int) -> None:
    assert models.MODELS[name](faces).num_faces == pytest.approx(faces, rel=0.25)


@pytest.mark.parametrize("name", models.MODELS)
def test_same_arguments_same_mesh(name: str) -> None:
    again = models.MODELS[name](6_000)
    for slot in Mesh.__slots__:
        np.testing.assert_array_equal(getattr(again, slot), getattr(small(name), slot))


@pytest.mark.parametrize("name", models.MODELS)
def test_faces_are_sound(name: str) -> None:
    summary = small(name).summary()
    assert summary.degenerate_faces == summary.degenerate_faces_welded == 0
    assert summary.zero_area_faces == 0
    assert summary.unreferenced_vertices == 0


@pytest.mark.parametrize("name", models.MODELS)
def test_too_small_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="faces: expected at least"):
        models.MODELS[name](10)


def test_rocker_is_closed_with_four_holes() -> None:
    mesh = small("rocker")
    summary = mesh.summary()
    assert summary.closed
    assert summary.non_manifold_edges == 0
    assert summary.components == 1
    assert euler(mesh) == 2 - 2 * 4
    assert volume(mesh) > 0
    other = models.rocker(6_000, rng=1)
    assert (other.vertices != mesh.vertices).any()


def test_head_is_closed_and_textured_with_seams() -> None:
    mesh = small("head")
    summary = mesh.summary()
    assert summary.closed
    assert summary.non_manifold_edges == 0
    assert euler(mesh) == 2
    assert volume(mesh) > 0
    assert summary.faces_without_uv == 0
    assert summary.multi_uv_vertices > 50
    assert mesh.texcoords is not None
    assert ((mesh.texcoords >= 0) & (mesh.texcoords <= 1)).all()


def test_car_is_unwelded_and_stored_twice() -> None:
    summary = small("car").summary()
    assert summary.duplicate_faces == 0
    assert summary.duplicate_faces_welded == summary.faces // 2
    assert summary.boundary_edges > 0
    assert summary.vertices > 1.5 * summary.vertices_welded
    assert summary.materials_used == 8
    assert summary.components > 20


def test_lifeboat_is_non_manifold_with_boundaries() -> None:
    summary = small("lifeboat").summary()
    assert summary.non_manifold_edges > 100
    assert summary.boundary_edges > 100
    assert summary.complex_vertices > 10
    assert summary.materials_used == 4


def test_jet_is_open_textured_and_manifold() -> None:
    summary = small("jet").summary()
    assert summary.non_manifold_edges == 0
    assert summary.boundary_edges > 0
    assert summary.faces_without_uv == 0
    assert summary.multi_uv_vertices > 100


def test_airplane_mixes_everything() -> None:
    summary = small("airplane").summary()
    assert summary.non_manifold_edges > 20
    assert summary.boundary_edges > 100
    assert 0 < summary.faces_without_uv < summary.faces
    assert summary.multi_uv_vertices > 100
    assert summary.materials_used == 6


@pytest.mark.parametrize("name", ["airplane", "head", "jet"])
def test_textures_are_png_files(name: str) -> None:
    image = pytest.importorskip("PIL.Image")
    textures = [t for m in small(name).materials for t in m.textures.values()]
    assert textures
    for texture in textures:
        with image.open(io.BytesIO(texture.data)) as picture:
            picture.load()
            assert picture.format == "PNG"


def test_png_keeps_every_pixel() -> None:
    image = pytest.importorskip("PIL.Image")
    for channels in (3, 4):
        pixels = np.random.default_rng(0).integers(0, 256, (5, 7, channels), np.uint8)
        with image.open(io.BytesIO(png(pixels))) as picture:
            np.testing.assert_array_equal(np.asarray(picture), pixels)


def test_surface_of_a_ball_is_a_sphere_turned_outwards() -> None:
    patch = surface_of(lambda p: np.linalg.norm(p, axis=-1) - 1.0, (-1.3,) * 3, (1.3,) * 3, 0.1)
    mesh = join([patch])
    assert mesh.summary().closed
    assert euler(mesh) == 2
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1.0, atol=1e-6)
    assert volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.02)


def test_box_is_turned_outwards() -> None:
    assert volume(join(box((0, 0, 0), (1, 2, 3), 2))) == pytest.approx(6.0)


def test_strip_and_disc_lie_flat_and_face_up() -> None:
    for mesh, area in ((models.strip(5, 2), 10.0), (models.disc(4, 3), 2.0)):
        a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
        normal = np.cross(b - a, c - a) / 2.0
        assert (normal[:, 1] > 0).all()
        assert normal[:, 1].sum() == pytest.approx(area)
        assert (mesh.vertices[:, 1] == 0).all()


def test_small_models_count_as_documented() -> None:
    strip, disc = models.strip(20, 1).summary(), models.disc(48, 8).summary()
    assert (strip.faces, strip.boundary_edges) == (40, 42)
    assert (disc.boundary_edges, disc.complex_vertices, disc.components) == (48, 0, 1)
    floor = models.floor(10, 6)
    assert floor.summary().materials_used == 2
    assert floor.summary().multi_uv_vertices == 0
    assert np.bincount(floor.face_material).tolist() == [60, 60]
    tube = models.tube(32, 12).summary()
    assert (tube.boundary_edges, tube.multi_uv_vertices, tube.components) == (64, 13, 1)
    assert volume(models.tube()) > 0


def test_small_models_refuse_nothing_to_draw() -> None:
    for make in (models.strip, models.tube, models.disc, models.floor):
        with pytest.raises(InputError, match="expected at least"):
            make(0, 0)


@pytest.mark.parametrize("rng", [-1, "seed", 1.5])
def test_seeds_are_checked(rng: object) -> None:
    for build in (models.rocker, models.lifeboat):
        with pytest.raises(InputError, match="rng: expected a seed >= 0"):
            build(5000, rng=rng)


def test_materials_are_described() -> None:
    assert len({m.name for m in small("airplane").materials}) == 6
    assert asdict(small("car").materials[1])["alpha_mode"] == "blend"
