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

__all__ = [
    "METHODS",
    "Boundary",
    "CleanResult",
    "ComplexVertices",
    "Curvature",
    "Duplicates",
    "LinkCondition",
    "SeamMode",
    "SimplifyResult",
    "StopReason",
    "clean",
    "qem4vr",
    "qem_bp",
    "qem_btp",
    "qem_orig",
    "qem_tp",
]
