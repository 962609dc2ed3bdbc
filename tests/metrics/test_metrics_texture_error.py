"""Texture error: known shifts and stretches, seams, materials, faces without UV, Open3D."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

import manip3d
from manip3d.metrics import TextureError, texture_error
from metrics_oracles import plane, sphere, texture_error_by_open3d

MEAN_NORM = (math.sqrt(2) + math.asinh(1)) / 3  # mean of |(u, v)| over the unit square


def textured(size: int = 8, *, scale: float = 1.0, shift: ArrayLike = 0.0) -> manip3d.Mesh:
    """A square of 8 x 8 units with texture coordinates 0 to 1, scaled and shifted."""
    mesh = plane(size)
    unit = mesh.vertices / size
    uv = unit[:, :2] * scale + np.asarray(shift)
    return mesh.replace(vertices=8 * unit, texcoords=uv, face_texcoords=mesh.faces)


def joined(*meshes: manip3d.Mesh) -> manip3d.Mesh:
    """One mesh of several that all have texture coordinates."""
    offsets = np.cumsum([0] + [m.num_vertices for m in meshes])
    texcoords = [m.texcoords for m in meshes if m.texcoords is not None]
    uv_offsets = np.cumsum([0] + [len(uv) for uv in texcoords])
    corners = [m.face_texcoords for m in meshes if m.face_texcoords is not None]
    return manip3d.Mesh(
        np.vstack([m.vertices for m in meshes]),
        np.vstack([m.faces + offset for m, offset in zip(meshes, offsets, strict=False)]),
        texcoords=np.vstack(texcoords),
        face_texcoords=np.vstack(
            [c + offset for c, offset in zip(corners, uv_offsets, strict=False)]
        ),
    )


def assert_compared_nothing(error: TextureError) -> None:
    assert error.samples == 0
    assert (error.mean, error.rms, error.mse, error.max) == (None,) * 4


def test_nothing_moved() -> None:
    error = texture_error(textured(8), textured(3))
    assert error.max < 1e-14
    assert (error.samples, error.skipped, error.material_mismatch_rate) == (128, 0, 0)


def test_number_of_samples_is_the_larger_number_of_faces() -> None:
    assert texture_error(textured(3), textured(8)).samples == 128
    assert texture_error(textured(3), textured(8), samples=7).samples == 7


def test_known_shift() -> None:
    error = texture_error(textured(), textured(shift=[0.03, -0.04]))
    assert (error.mean, error.rms, error.max) == pytest.approx((0.05, 0.05, 0.05), rel=1e-12)
    assert error.mse == pytest.approx(0.0025, rel=1e-12)


def test_texture_coordinates_between_the_charts_are_counted() -> None:
    """A quarter of the shifted square shows what is beside the original's only chart."""
    original = textured()
    assert texture_error(original, textured(3)).outside_charts == 0.0
    shifted = textured(shift=[0.25, 0.0])
    assert texture_error(original, shifted, samples=20_000).outside_charts == pytest.approx(
        0.25, abs=0.005
    )


def test_charts_of_other_materials_do_not_count() -> None:
    original = textured().replace(
        face_material=np.zeros(128, np.int32),
        materials=[manip3d.Material("a"), manip3d.Material("b")],
    )
    other = original.replace(face_material=np.ones(128, np.int32))
    assert texture_error(original, other).outside_charts == 1.0


def test_nothing_textured_is_outside_no_chart() -> None:
    bare = plane(8)
    assert texture_error(textured(), bare).outside_charts is None
    assert texture_error(bare, textured()).outside_charts == 1.0


def test_a_palette_of_one_colour_is_a_chart() -> None:
    uniform = textured(scale=0.0, shift=[0.3, 0.7])
    assert texture_error(uniform, uniform).outside_charts == 0.0
    assert texture_error(uniform, textured(scale=0.0, shift=[0.3, 0.6])).outside_charts == 1.0


def test_known_stretch() -> None:
    """The difference grows from 0 at one corner to 0.1 sqrt(2) at the other."""
    error = texture_error(textured(), textured(5, scale=1.1), samples=100_000)
    assert error.mean == pytest.approx(0.1 * MEAN_NORM, rel=2e-3)
    assert error.mse == pytest.approx(0.01 * 2 / 3, rel=2e-3)
    assert error.rms == math.sqrt(error.mse)
    assert error.max == pytest.approx(0.1 * math.sqrt(2), rel=1e-2)


def test_coordinates_of_a_corner_belong_to_that_corner() -> None:
    """Corners numbered differently on the two sides, on faces of every shape and rotation."""
    rng = np.random.default_rng(0)
    vertices = np.array([[0, 0, 0], [3, 0, 0], [1, 2, 0]], float)
    uv = rng.random((3, 2))
    a = manip3d.Mesh(vertices, [[0, 1, 2]], texcoords=uv, face_texcoords=[[0, 1, 2]])
    for order in ([0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]):
        b = manip3d.Mesh(
            vertices[order],
            [[0, 1, 2]],
            texcoords=uv[::-1],
            face_texcoords=[[2 - i for i in order]],
        )
        assert texture_error(a, b, samples=100).max < 1e-14


def test_of_coincident_faces_the_nearest_coordinates_count() -> None:
    """Both sides of a sheet, each with its own part of the texture."""
    sheet = joined(textured(4), textured(4, shift=[5, 0]))
    assert texture_error(sheet, sheet, samples=1000).max < 1e-14
    moved = joined(textured(4, shift=[5, 0.25]), textured(4, shift=[0, 0.25]))
    error = texture_error(sheet, moved, samples=1000)
    assert error.max == pytest.approx(0.25, rel=1e-12)


def test_faces_within_epsilon_count_as_met() -> None:
    ground = textured(4)
    below = textured(4, shift=[5, 0])
    two = joined(ground.replace(vertices=ground.vertices + np.array([0, 0, 3e-4])), below)
    diagonal = ground.diagonal
    assert texture_error(ground, two, epsilon=2.9e-4 / diagonal).mean == pytest.approx(5, abs=1e-3)
    assert texture_error(ground, two, epsilon=3.1e-4 / diagonal).mean == pytest.approx(0, abs=1e-3)
    assert texture_error(ground, two, epsilon=0.0).mean == pytest.approx(5, abs=1e-3)
    near = two.replace(vertices=two.vertices * [1, 1, 0.1])  # 3e-5 over the diagonal 11.3
    assert texture_error(ground, near).mean == pytest.approx(0, abs=1e-3)


def test_seam_with_two_coordinates_per_vertex() -> None:
    left, right = textured(4), textured(4, shift=[0.0, 7.0])
    right = right.replace(vertices=right.vertices + np.array([8.0, 0, 0]))
    seam = joined(left, right)
    assert texture_error(seam, seam, epsilon=0.01, samples=20_000).max < 0.02


def material_names(*names: str) -> list[manip3d.Material]:
    return [manip3d.Material(name) for name in names]


def test_materials_swapped() -> None:
    mesh = textured(8)
    half = (mesh.vertices[mesh.faces][:, :, 0].mean(axis=1) < 4).astype(np.int32)
    a = mesh.replace(face_material=half)
    swapped = texture_error(a, mesh.replace(face_material=1 - half), samples=10_000)
    assert swapped.material_mismatch_rate == pytest.approx(1.0, abs=2e-3)  # but for the border
    b = mesh.replace(
        face_material=np.zeros_like(half), texcoords=textured(shift=[0.5, 0]).texcoords
    )
    error = texture_error(a, b, samples=10_000)
    assert error.material_mismatch_rate == pytest.approx(0.5, abs=2e-3)
    assert error.samples == pytest.approx(5000, abs=20)
    assert error.skipped == 0
    assert error.mean == pytest.approx(0.5, abs=1e-4)
    none = texture_error(a, mesh)
    assert none.material_mismatch_rate == 1.0
    assert_compared_nothing(none)


def test_materials_are_told_apart_by_name() -> None:
    mesh = textured(2)
    index = np.arange(8) % 3
    a = mesh.replace(face_material=index, materials=material_names("paint", "glass", "paint"))
    b = mesh.replace(
        face_material=np.array([1, 0, 2])[index],
        materials=material_names("glass", "paint", "paint"),
    )
    assert texture_error(a, b, samples=999, epsilon=0).material_mismatch_rate == 0
    c = b.replace(materials=material_names("glass", "paint", "wood"))
    rate = texture_error(a, c, samples=800, epsilon=0).material_mismatch_rate
    assert rate == pytest.approx(2 / 8, abs=2e-3)
    many = a.replace(face_material=np.arange(8) % 4, materials=material_names(*["paint"] * 4))
    assert texture_error(many, many, samples=800, epsilon=0).material_mismatch_rate == 0
    d = b.replace(materials=())  # by index
    rate = texture_error(a, d, samples=800, epsilon=0).material_mismatch_rate
    assert rate == pytest.approx(6 / 8, abs=2e-3)


def test_faces_without_texture_coordinates_are_skipped() -> None:
    mesh = textured(2)
    assert mesh.face_texcoords is not None
    partly = mesh.face_texcoords.copy()
    partly[[0, 3]] = -1
    partly[5, 1] = -1
    for a, b in (
        (mesh, mesh.replace(face_texcoords=partly)),
        (mesh.replace(face_texcoords=partly), mesh),
    ):
        error = texture_error(a, b, samples=8000, epsilon=0)
        assert error.skipped == pytest.approx(3000, abs=2)
        assert error.samples + error.skipped == 8000
        assert error.max < 1e-14
        assert error.material_mismatch_rate == 0
    bare = texture_error(plane(2), mesh)
    assert bare.skipped == 8
    assert_compared_nothing(bare)
    assert_compared_nothing(texture_error(mesh, plane(2)))


def test_equals_open3d_closest_points() -> None:
    def mapped(mesh: manip3d.Mesh) -> manip3d.Mesh:
        return mesh.replace(
            texcoords=mesh.vertices[:, :2] ** 2 + mesh.vertices[:, 1:], face_texcoords=mesh.faces
        )

    a, b = mapped(sphere(30)), mapped(sphere(6))
    mean, rms = texture_error_by_open3d(a, b, 200_000)
    error = texture_error(a, b, samples=200_000)
    assert error.mean == pytest.approx(mean, rel=5e-3)
    assert error.rms == pytest.approx(rms, rel=5e-3)


def test_same_bits_for_any_number_of_threads_scale_and_place() -> None:
    a, b = textured(), textured(5, scale=1.1)
    expected = texture_error(a, b, samples=5000, threads=1)
    assert {texture_error(a, b, samples=5000, threads=t) for t in (1, 2, 4)} == {expected}
    small = [m.replace(vertices=m.vertices * 2.0**-400) for m in (a, b)]
    assert texture_error(*small, samples=5000) == expected
    far = [m.replace(vertices=m.vertices + 1e6) for m in (a, b)]
    assert texture_error(*far, samples=5000).mean == pytest.approx(expected.mean, rel=1e-6)
    assert texture_error(a, b, samples=5000, rng=1) != expected


def test_refuses_bad_input() -> None:
    mesh = textured(1)
    for epsilon in (-1.0, math.nan, math.inf):
        with pytest.raises(manip3d.InputError, match="epsilon"):
            texture_error(mesh, mesh, epsilon=epsilon)
    with pytest.raises(manip3d.InputError, match="samples"):
        texture_error(mesh, mesh, samples=0)
    with pytest.raises(manip3d.InputError, match="simplified: expected at least one face"):
        texture_error(mesh, manip3d.Mesh(mesh.vertices, []))
