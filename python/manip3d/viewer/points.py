"""Scans for the viewer: a small solid for each point, so that meshes' renderers show them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.paths import path_of
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame
from manip3d.mesh import Mesh

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAX_POINTS = 50_000  # four triangles each: as many as the page takes

# A regular tetrahedron about 0: seen from everywhere.
_CORNERS = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
_FACES = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]], np.int32)
_SPREAD = 4e-3  # size of a solid over its distance from the scanner: some 0.2 degrees
_LEAST = 6e-4  # and at least this part of the scan's extent

# Blue, green, yellow, red: low to high.
_COLORS = np.array([[56, 88, 190], [44, 160, 120], [240, 200, 60], [214, 60, 44]], np.float64)


def scan_mesh(frame: LidarFrame, *, max_points: int = MAX_POINTS) -> Mesh:
    """A tetrahedron for each point, coloured by height, larger farther from the scanner.

    Parameters
    ----------
    frame : LidarFrame
        Points at exactly (0, 0, 0), which say that nothing came back, are left out.
    max_points : int
        Of larger scans every n-th point is taken.

    Returns
    -------
    Mesh
        Up to ``4 * max_points`` faces; z up.

    Raises
    ------
    InputError
        ``max_points`` is not positive.
    """
    if not max_points > 0:
        raise InputError(f"max_points: expected > 0, got {max_points}")
    points = frame.points[frame.points.any(axis=1)].astype(np.float64)
    points = points[:: max(1, -(-len(points) // max_points))]
    if not len(points):
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int32))
    place = frame.origin if frame.origin is not None else points.mean(axis=0)
    low, high = np.percentile(points, [1, 99], axis=0)
    size = np.maximum(
        _SPREAD * np.linalg.norm(points - place, axis=1), _LEAST * np.linalg.norm(high - low)
    )
    vertices = points[:, None, :] + size[:, None, None] * _CORNERS
    faces = 4 * np.arange(len(points), dtype=np.int32)[:, None, None] + _FACES
    span = high[2] - low[2]
    share = np.clip((points[:, 2] - low[2]) / (span if span > 0 else 1.0), 0.0, 1.0)
    colors = np.repeat(_ramp(share), 4, axis=0)
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), colors=colors)


def _ramp(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    steps = np.linspace(0.0, 1.0, len(_COLORS))
    channels = [np.interp(share, steps, channel) for channel in _COLORS.T]
    colors: NDArray[np.uint8] = np.rint(np.column_stack(channels)).astype(np.uint8)
    return colors


def view_scan(
    frame: LidarFrame,
    output: str | os.PathLike[str] | None = None,
    *,
    max_points: int = MAX_POINTS,
    **options: Any,
) -> Path:
    """Show a scan in the browser, or write a page (``.html``) or a picture (``.png``).

    Parameters
    ----------
    frame : LidarFrame
    output : path, optional
        As for `view`.
    max_points : int
        Of larger scans every n-th point is shown; the page says how many.
    **options
        Of `view`.

    Raises
    ------
    InputError, RenderError, OSError
        As `view`.
    """
    from manip3d.viewer.page import view

    mesh = scan_mesh(frame, max_points=max_points)
    options = {"up": "z", "elevation": 35.0} | options
    if output is None or path_of(output, "output").suffix.lower() == ".html":
        shown = mesh.num_faces // 4
        label = f"{frame.num_points:,} points"
        if shown < frame.num_points:
            label += f", {shown:,} shown"
        options = {"labels": [label], "max_faces": 4 * max_points} | options
        return view([mesh], output, **options)
    return view(mesh, output, **({"zoom": 2.0} | options))
