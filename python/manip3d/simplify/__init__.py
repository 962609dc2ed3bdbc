"""Simplification of meshes, depth images and range scans: fewer points and faces, same shape."""

from manip3d.simplify._camera_files import JointFileResult, simplify_camera_files
from manip3d.simplify._camera_views import CameraView
from manip3d.simplify._cameras import JointSimplification, cs3_cameras, relief_cameras
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
    Cs3Result,
    Cs3Stream,
    DenseGrid,
    DenseImage,
    DepthMesh,
    DepthSimplification,
    Reached,
    Variant,
    cs3,
    cs3_grid,
    dense_mesh,
    dense_mesh_grid,
    grid_delaunay,
)
from manip3d.simplify._depth_files import simplify_depth, simplify_depth_file
from manip3d.simplify._depth_options import DepthFileResult, DepthMethod, DepthOptions
from manip3d.simplify._depth_sequence import DepthSequence
from manip3d.simplify._depth_sets import colors_of_frames, common_depth_unit
from manip3d.simplify._depth_steps import DEPTH_STEP, cut_depth_steps
from manip3d.simplify._lod import (
    LodChain,
    LodLevel,
    SharedBudget,
    lod_chain,
    polygon_budget,
    share_budget,
)
from manip3d.simplify._modes import Mode, simplify
from manip3d.simplify._pixel_maps import confidence_of_levels
from manip3d.simplify._poses import poses_of_files
from manip3d.simplify._quality import QualityResult, boundary_vertices, fast, quality
from manip3d.simplify._recordings import RecordingResult, simplify_recording
from manip3d.simplify._relief import (
    Effort,
    Relief,
    ReliefStream,
    relief,
    relief_grid,
)
from manip3d.simplify._sampling import SamplingMethod, sample_depth, sample_depth_grid
from manip3d.simplify._scene import (
    SceneLevel,
    SceneLods,
    SceneResult,
    scene_lods,
    simplify_scene,
)

__all__ = [
    "DEPTH_STEP",
    "METHODS",
    "Boundary",
    "CameraView",
    "CleanResult",
    "ComplexVertices",
    "Cs3Result",
    "Cs3Stream",
    "Curvature",
    "DenseGrid",
    "DenseImage",
    "DepthFileResult",
    "DepthMesh",
    "DepthMethod",
    "DepthOptions",
    "DepthSequence",
    "DepthSimplification",
    "Duplicates",
    "Effort",
    "JointFileResult",
    "JointSimplification",
    "LinkCondition",
    "LodChain",
    "LodLevel",
    "Mode",
    "QualityResult",
    "Reached",
    "RecordingResult",
    "Relief",
    "ReliefStream",
    "SamplingMethod",
    "SceneLevel",
    "SceneLods",
    "SceneResult",
    "SeamMode",
    "SharedBudget",
    "SimplifyResult",
    "StopReason",
    "Variant",
    "boundary_vertices",
    "clean",
    "colors_of_frames",
    "common_depth_unit",
    "confidence_of_levels",
    "cs3",
    "cs3_cameras",
    "cs3_grid",
    "cut_depth_steps",
    "dense_mesh",
    "dense_mesh_grid",
    "fast",
    "grid_delaunay",
    "lod_chain",
    "polygon_budget",
    "poses_of_files",
    "qem4vr",
    "qem_bp",
    "qem_btp",
    "qem_orig",
    "qem_tp",
    "quality",
    "relief",
    "relief_cameras",
    "relief_grid",
    "sample_depth",
    "sample_depth_grid",
    "scene_lods",
    "share_budget",
    "simplify",
    "simplify_camera_files",
    "simplify_depth",
    "simplify_depth_file",
    "simplify_recording",
    "simplify_scene",
]
