"""Pictures of scans from a camera above the street, with boxes around suspected objects."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Floats = NDArray[np.float64]
    Image = NDArray[np.uint8]

_NEAR = 0.5  # metres; points nearer to the camera are not drawn
_BACKGROUND = (18, 22, 30)
_MARKED = (226, 92, 255)
_BOX = (255, 190, 60)
# Colours from low to high points: blue, green, yellow.
_RAMP = np.array([[66, 104, 190], [70, 170, 140], [222, 208, 120]], np.float64)


@dataclass(frozen=True, eq=False)
class Eye:
    """A pinhole camera.

    Attributes
    ----------
    position, target : (3,) metres
        Position of the camera and the point that it looks at; z is up.
    size : (width, height), pixels
    field_deg : float
        Horizontal field of view, degrees.
    """

    position: Floats
    target: Floats
    size: tuple[int, int]
    field_deg: float = 62.0

    def project(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Return pixels (N, 2) and distances along the optical axis (N,), metres."""
        forward = self.target - self.position
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(forward, right), forward])
        x, y, depth = axes @ (np.asarray(points, np.float64) - self.position).T
        width, height = self.size
        focal = 0.5 * width / np.tan(np.deg2rad(0.5 * self.field_deg))
        scale = focal / np.maximum(depth, _NEAR)
        return np.column_stack([0.5 * width + scale * x, 0.5 * height + scale * y]), depth


def draw_scan(
    points: NDArray[np.float32],
    eye: Eye,
    *,
    marked: NDArray[np.bool_] | None = None,
    boxes: Sequence[tuple[ArrayLike, ArrayLike]] = (),
) -> Image:
    """Draw a scan, coloured by height, far points first.

    Parameters
    ----------
    points : (N, 3) float32, metres
    eye : Eye
    marked : (N,) bool, optional
        Points to draw in a separate colour.
    boxes : sequence of (centre, size)
        Boxes whose edges are drawn over all points.
    """
    colors = _by_height(points[:, 2])
    if marked is not None:
        colors[marked] = _MARKED
    image = np.full((eye.size[1], eye.size[0], 3), _BACKGROUND, np.uint8)
    pixels, depth = eye.project(points)
    seen = np.flatnonzero((depth > _NEAR) & (np.abs(pixels) < 1e5).all(axis=1))
    seen = seen[np.argsort(-depth[seen], kind="stable")]
    column, row = np.rint(pixels[seen]).astype(np.intp).T
    for down, across in itertools.product((0, 1), repeat=2):
        r, c = row + down, column + across
        inside = (r >= 0) & (r < eye.size[1]) & (c >= 0) & (c < eye.size[0])
        image[r[inside], c[inside]] = colors[seen[inside]]
    return _with_boxes(image, eye, boxes)


def _by_height(z: NDArray[np.float32]) -> Image:
    low, high = np.percentile(z, [2, 98])
    share = np.clip((z - low) / max(float(high - low), 1e-6), 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(_RAMP))
    channels = [np.interp(share, steps, channel) for channel in _RAMP.T]
    colors: Image = np.rint(np.column_stack(channels)).astype(np.uint8)
    return colors


def _with_boxes(image: Image, eye: Eye, boxes: Sequence[tuple[ArrayLike, ArrayLike]]) -> Image:
    if not boxes:
        return image
    from PIL import Image as pillow
    from PIL import ImageDraw

    picture = pillow.fromarray(image)
    draw = ImageDraw.Draw(picture)
    signs = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    for centre, size in boxes:
        corners, depth = eye.project(np.asarray(centre) + signs * np.asarray(size))
        for a, b in itertools.combinations(range(8), 2):
            if np.count_nonzero(signs[a] != signs[b]) == 1 and min(depth[a], depth[b]) > _NEAR:
                draw.line([tuple(corners[a]), tuple(corners[b])], fill=_BOX, width=2)
    return np.asarray(picture)
