"""Cast rays at triangles with Open3D (Embree), after checking that its rays work."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip3d._util.extras import imported
from manip3d._util.options import threads_of
from manip3d.errors import Error

Floats = NDArray[np.float32]

CHUNK = 1 << 20
"""Rays per call: they take about 0.15 s on two cores, so that Ctrl-C takes effect quickly."""

NO_FACE = np.uint32(0xFFFFFFFF)
"""Open3D's index of the face for rays without a hit."""


@dataclass(frozen=True)
class Hits:
    """First points at which rays meet a surface.

    Attributes
    ----------
    distance : (N,) float32
        Distance in lengths of the ray's direction; infinite: no hit.
    face : (N,) uint32
        Index of the face; `NO_FACE`: no hit.
    normal : (N, 3) float32
        Unit normal of the face, on its front side; zero: no hit.
    uv : (N, 2) float32
        Barycentric weights of the second and the third corner of the face.
    """

    distance: Floats
    face: NDArray[np.uint32]
    normal: Floats
    uv: Floats


class RayCaster:
    """Casts rays at triangles; the search structure is built once.

    Parameters
    ----------
    vertices : (V, 3) float
        Vertices of the triangles.
    faces : (F, 3) int
        Indices of the vertices of each triangle.
    """

    def __init__(self, vertices: ArrayLike, faces: ArrayLike) -> None:
        o3d = _open3d()
        self._scene = o3d.t.geometry.RaycastingScene()
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices, np.float32)),
            self._tensor(np.ascontiguousarray(faces, np.uint32)),
        )
        # builds the search structure
        self._scene.cast_rays(self._tensor(np.zeros((1, 6), np.float32)))

    def cast(self, origins: Floats, directions: Floats, *, threads: int = 0) -> Hits:
        """Return the first hits of N rays; at most `CHUNK` rays let Ctrl-C take effect quickly.

        Parameters
        ----------
        origins : (N, 3) or (3,) float32
            Origins of the rays.
        directions : (N, 3) float32
            Directions of the rays, of any length.
        threads : int
            0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.
        """
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3], rays[:, 3:] = origins, directions
        found = self._scene.cast_rays(self._tensor(rays), nthreads=threads_of(threads))
        return Hits(
            found["t_hit"].numpy(),
            found["primitive_ids"].numpy(),
            found["primitive_normals"].numpy(),
            found["primitive_uvs"].numpy(),
        )


@contextmanager
def _without_web_visualizer() -> Iterator[None]:
    """Set the variable without which importing Open3D in a notebook starts a server."""
    name = "OPEN3D_DISABLE_WEB_VISUALIZER"
    before = os.environ.get(name)
    os.environ[name] = "true"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


@functools.cache
def _open3d() -> Any:
    """Import Open3D, and check that its rays hit a triangle.

    Raises
    ------
    MissingExtraError
        Open3D is not installed.
    Error
        Rays do not hit triangles, as with Debian's package.
    """
    with _without_web_visualizer():
        o3d = imported("open3d", "simulate")
    scene = o3d.t.geometry.RaycastingScene()
    corners = np.array([[-1, -1, 2], [3, -1, 2], [-1, 3, 2]], np.float32)
    scene.add_triangles(
        o3d.core.Tensor.from_numpy(corners),
        o3d.core.Tensor.from_numpy(np.array([[0, 1, 2]], np.uint32)),
    )
    rays = np.array([[0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, -1]], np.float32)
    distance = scene.cast_rays(o3d.core.Tensor.from_numpy(rays))["t_hit"].numpy()
    if not (abs(distance[0] - 2.0) < 1e-5 and np.isinf(distance[1])):
        raise Error(
            f"open3d {o3d.__version__}: a ray at a triangle 2 m ahead came back with "
            f"{distance[0]}; Debian's package does that: pip install 'manip3d[simulate]'"
        )
    return o3d
