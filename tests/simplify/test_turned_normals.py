"""Normals of simplified meshes lie near their surface, on both sides of hard edges."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

import manip3d
from manip3d import simplify

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

MODES = [simplify.quality, simplify.fast]


def meshed_box(num: int = 8) -> manip3d.Mesh:
    """A cuboid of 4 x 2 x 1 of ``12 * num ** 2`` faces, each side with its own normal."""
    u, v = (a.ravel() for a in np.meshgrid(np.arange(num + 1) / num, np.arange(num + 1) / num))
    row = np.arange(num * (num + 1)).reshape(num, num + 1)[:, :-1].ravel()
    quads = np.stack([row, row + 1, row + num + 2, row + num + 1], axis=1)
    halves = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    face_normals: list[NDArray[np.int64]] = []
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    for side, normal in enumerate(normals):
        axis = side % 3
        points = np.empty((len(u), 3))
        points[:, axis] = float(side < 3)
        points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = u, v
        corners = halves + side * len(u)
        faces.append(corners if normal[axis] > 0 else corners[:, ::-1])
        vertices.append(points * [4.0, 2.0, 1.0])
        face_normals.append(np.full((len(halves), 3), side))
    return manip3d.Mesh(
        np.concatenate(vertices),
        np.concatenate(faces),
        normals=normals,
        face_normals=np.concatenate(face_normals),
    )


def cosines(mesh: manip3d.Mesh) -> NDArray[np.float64]:
    """(F, 3): each corner's normal with the direction of its face."""
    p = mesh.vertices[mesh.faces]
    direction = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    assert mesh.normals is not None
    assert mesh.face_normals is not None
    found: NDArray[np.float64] = (mesh.normals[mesh.face_normals] * direction[:, None]).sum(axis=2)
    return found


@pytest.mark.parametrize("method", MODES)
@pytest.mark.parametrize("target", [300, 60, 12])
def test_flat_sides_stay_flat(method: Callable[..., simplify.QualityResult], target: int) -> None:
    result = method(meshed_box(), target_faces=target)
    assert result.mesh.num_faces <= target
    assert cosines(result.mesh).min() > 0.75
    assert cosines(result.mesh).mean() > 0.97


@pytest.mark.parametrize("method", MODES)
def test_the_side_that_normals_are_on_is_kept(
    method: Callable[..., simplify.QualityResult],
) -> None:
    box = meshed_box()
    assert box.normals is not None
    inverted = manip3d.Mesh(
        box.vertices, box.faces, normals=-box.normals, face_normals=box.face_normals
    )
    assert cosines(method(inverted, target_faces=12).mesh).max() < -0.75


@pytest.mark.parametrize("method", [*MODES, simplify.qem4vr])
def test_normals_that_were_far_from_their_faces_stay_so(
    method: Callable[..., simplify.QualityResult],
) -> None:
    """A program gave leaves the normal of their crown."""
    box = meshed_box()
    up = manip3d.Mesh(
        box.vertices,
        box.faces,
        normals=[[0.0, 0.0, 1.0]],
        face_normals=np.zeros_like(box.faces),
    )
    found = method(up, target_faces=100).mesh
    np.testing.assert_array_equal(found.normals, [[0.0, 0.0, 1.0]])


@pytest.mark.parametrize("method", [*MODES, simplify.qem4vr])
def test_unchanged_faces_keep_their_normals(
    method: Callable[..., simplify.QualityResult],
) -> None:
    """Normals 45 degrees off, as bevels have that are shaded like the large side beside them."""
    tilted = np.array([[0.0, 1.0, 1.0]]) / np.sqrt(2.0)
    faces = [[0, 1, 2], [0, 2, 3]]
    mesh = manip3d.Mesh(
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.25], [0.0, 1.0, 0.0]],
        faces,
        normals=tilted,
        face_normals=np.zeros_like(faces),
    )
    found = method(mesh, target_faces=2).mesh
    np.testing.assert_array_equal(found.normals, tilted)
