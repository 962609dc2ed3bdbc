"""Fewer points and faces for the same shape."""

from manip3d.simplify._collapse import (
    METHODS,
    Boundary,
    CleanResult,
    ComplexVertices,
    Curvature,
    Duplicates,
    LinkCondition,
    SeamMode,
    SimplifyResult,
    StopReason,
    clean,
    qem4vr,
    qem_bp,
    qem_btp,
    qem_orig,
    qem_tp,
)
from manip3d.simplify._depth import (
    DepthMesh,
    dense_mesh,
    dense_mesh_grid,
    grid_delaunay,
)
from manip3d.simplify._sampling import SamplingMethod, sample_depth, sample_depth_grid

__all__ = [
    "METHODS",
    "Boundary",
    "CleanResult",
    "ComplexVertices",
    "Curvature",
    "DepthMesh",
    "Duplicates",
    "LinkCondition",
    "SamplingMethod",
    "SeamMode",
    "SimplifyResult",
    "StopReason",
    "clean",
    "dense_mesh",
    "dense_mesh_grid",
    "grid_delaunay",
    "qem4vr",
    "qem_bp",
    "qem_btp",
    "qem_orig",
    "qem_tp",
    "sample_depth",
    "sample_depth_grid",
]
