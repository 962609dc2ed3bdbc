"""Differences of a mesh from its original: shape, texture, colour, roughness, boundaries, depth."""

from __future__ import annotations

from manip3d.metrics._boundary_gap import BoundaryGap, boundary_gap
from manip3d.metrics._color_error import ColorError, color_error
from manip3d.metrics._compare import Comparison, compare
from manip3d.metrics._distances import (
    ClosestPoints,
    Deviation,
    HausdorffBound,
    MetroResult,
    closest_points,
    hausdorff_bound,
    metro,
    nearest_distances,
)
from manip3d.metrics._fmpd import FmpdResult, fmpd
from manip3d.metrics._range_image import (
    BoundaryNoise,
    Flicker,
    RangeImageError,
    boundary_noise,
    flicker,
    range_image_error,
    range_image_error_grid,
    render_depth,
)
from manip3d.metrics._texture_error import TextureError, texture_error

__all__ = [
    "BoundaryGap",
    "BoundaryNoise",
    "ClosestPoints",
    "ColorError",
    "Comparison",
    "Deviation",
    "Flicker",
    "FmpdResult",
    "HausdorffBound",
    "MetroResult",
    "RangeImageError",
    "TextureError",
    "boundary_gap",
    "boundary_noise",
    "closest_points",
    "color_error",
    "compare",
    "flicker",
    "fmpd",
    "hausdorff_bound",
    "metro",
    "nearest_distances",
    "range_image_error",
    "range_image_error_grid",
    "render_depth",
    "texture_error",
]
