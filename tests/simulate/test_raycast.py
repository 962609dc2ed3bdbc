"""Rays: Open3D must prove that it works before anything is built on it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from manip3d import Error, MissingExtraError
from manip3d.simulate import _raycast
from manip3d.simulate._raycast import RayCaster

TRIANGLE = np.array([[1, -1, -1], [1, 1, -1], [1, 0, 1]], float)


@pytest.fixture
def fresh() -> Iterator[None]:
    """The self-test runs anew, before and after."""
    _raycast._open3d.cache_clear()
    yield
    _raycast._open3d.cache_clear()


def blind_open3d(distance: float) -> Any:
    """An Open3D whose rays all come back with ``distance``."""

    class Scene:
        def add_triangles(self, vertices: Any, faces: Any) -> None:
            pass

        def cast_rays(self, rays: Any) -> Any:
            return {"t_hit": SimpleNamespace(numpy=lambda: np.array([distance, np.inf]))}

    return SimpleNamespace(
        __version__="0.0",
        core=SimpleNamespace(Tensor=SimpleNamespace(from_numpy=lambda array: array)),
        t=SimpleNamespace(geometry=SimpleNamespace(RaycastingScene=Scene)),
    )


@pytest.mark.parametrize("distance", [np.inf, np.nan, 1.9])
def test_a_library_without_hits_is_refused(
    fresh: None, monkeypatch: pytest.MonkeyPatch, distance: float
) -> None:
    monkeypatch.setitem(sys.modules, "open3d", blind_open3d(distance))
    with pytest.raises(Error, match="a ray at a triangle 2 m ahead came back with"):
        RayCaster(TRIANGLE, [[0, 1, 2]])


def test_a_missing_library_names_the_cure(fresh: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'manip3d\[simulate\]'"):
        RayCaster(TRIANGLE, [[0, 1, 2]])


def test_hits_have_distance_face_normal_and_weights() -> None:
    pytest.importorskip("open3d")
    aim = np.array([[1, 0, -0.5], [1, 0.25, 0], [-1, 0, 0]], np.float32)
    hits = RayCaster(TRIANGLE, [[0, 1, 2]]).cast(np.zeros(3, np.float32), aim)
    np.testing.assert_allclose(hits.distance, [1, 1, np.inf], rtol=1e-6)
    assert hits.face.tolist() == [0, 0, _raycast.NO_FACE]
    np.testing.assert_allclose(abs(hits.normal[:2]), [[1, 0, 0]] * 2, atol=1e-6)
    weights = np.column_stack([1 - hits.uv.sum(axis=1), hits.uv])[:2]
    np.testing.assert_allclose(weights @ TRIANGLE, aim[:2], atol=1e-6)
