"""
C++ core of manip3d. Private: use the typed functions of the package.
"""

from __future__ import annotations

import collections.abc
import enum
import typing

import numpy
import numpy.typing

import manip3d.camera
import manip3d.mesh
import manip3d.modify._phantom
import manip3d.rgbd
import manip3d.simplify._depth

__all__: list[str] = [
    "CELL_COLUMNS",
    "AnimationMeshOptions",
    "ArrayPool",
    "BoneRule",
    "BoundaryCurvature",
    "BoundaryTerm",
    "CollapseStop",
    "ColliderTracker",
    "ComplexVertices",
    "CompositeOptions",
    "CompositeSurface",
    "CrossModalOptions",
    "Cs3BesideInvalid",
    "Cs3Importance",
    "Cs3Options",
    "Cs3Reached",
    "Cs3Reading",
    "Cs3Rounding",
    "Cs3Runner",
    "Cs3Sampling",
    "Cs3Stencil",
    "DepthNoiseOptions",
    "DepthSmoother",
    "DepthStepOptions",
    "DownSource",
    "Duplicates",
    "FastOptions",
    "JointSmoother",
    "JointSmootherOptions",
    "KeyPerson",
    "KeyPersonOptions",
    "Limb",
    "LinkCondition",
    "MirrorMode",
    "PaperSettings",
    "PersonMaskOptions",
    "PhantomMeshOptions",
    "PhantomOptions",
    "PhantomPipeline",
    "PhantomReason",
    "PhantomState",
    "PlacementEstimator",
    "PlaneRule",
    "PoseScope",
    "QemOptions",
    "QualityOptions",
    "RecordingKind",
    "RegionOptions",
    "ReliefEffort",
    "ReliefOptions",
    "ReliefSolver",
    "ReliefStop",
    "ReposeOptions",
    "RgbdRecorder",
    "RgbdSource",
    "ScanGrid",
    "ShoeCoverTracker",
    "Skinning",
    "TextureTerm",
    "Texturing",
    "VelodyneOptions",
    "VelodynePcapSource",
    "VelodyneUdpSource",
    "WatermarkEmbedder",
    "WatermarkKey",
    "WatermarkPolicy",
    "WatermarkVerifier",
    "animate",
    "animation_mesh",
    "body_mirror",
    "boundary_gap",
    "bounding_box",
    "check_intrinsics",
    "check_mesh",
    "check_points",
    "check_registration",
    "clean",
    "closest_points",
    "clothing_colors",
    "color_error",
    "compare_cross_modal",
    "compare_paper_watermark",
    "compare_reflectance",
    "compare_turns",
    "composite",
    "copy_transform_paste",
    "count_components",
    "deform",
    "density_levels",
    "depth_coverage",
    "depth_noise",
    "embed_paper_watermark",
    "encode_stream_frame",
    "estimate_scan_grid",
    "estimate_scan_origin",
    "faces_across_steps",
    "faces_left",
    "faces_off_surface",
    "fmpd",
    "generic_consistency",
    "grid_delaunay",
    "grid_mesh",
    "hausdorff_bound",
    "insert_occluding",
    "is_posable",
    "joint_names",
    "joint_parents",
    "linear_color",
    "local_spacing",
    "make_temporary_folder",
    "metro",
    "mirrored_joints",
    "move_box",
    "nearest_distances",
    "occlusion_consistency",
    "open_recorder",
    "open_rgbd",
    "point_suffixes",
    "points_in_box",
    "points_of_levels",
    "project",
    "range_image_error",
    "read_lattice",
    "read_mesh",
    "read_mesh_bytes",
    "read_points",
    "read_range_grid",
    "read_scene",
    "readable_suffixes",
    "reflectance_contrast",
    "registered_texcoords",
    "render_depth",
    "replace_folder",
    "replace_rows",
    "replay_collapses",
    "repose",
    "resample",
    "resolve_inside",
    "rgbd_schemes",
    "rotation_about_z",
    "sample_poisson_disk",
    "sample_scale_space",
    "sample_uniform",
    "segment_objects",
    "segment_person",
    "segment_region",
    "shading_normals",
    "silhouette_spans",
    "simplify_fast",
    "simplify_qem",
    "simplify_quality",
    "snap_to_lattice",
    "sparse_distances",
    "subtract",
    "summarize",
    "surface_colors",
    "texture_error",
    "triangulate_polygons",
    "unproject",
    "unproject_pixels",
    "watermark_in_picture",
    "watermark_order",
    "welded_boundary",
    "without_speckles",
    "without_watermark_record",
    "writable_suffixes",
    "write_mesh",
    "write_points",
    "write_scene",
]

class Cs3Importance(enum.Enum):
    LAPLACIAN = 0
    MIN_CURVATURE = 1

class Cs3Sampling(enum.Enum):
    NON_MAXIMUM = 0
    IMPORTANCE_ORDER = 1

class Cs3Stencil(enum.Enum):
    GRADIENT_OF_GRADIENT = 0
    COMPACT = 1
    FORWARD = 2
    SOBEL = 3

class Cs3BesideInvalid(enum.Enum):
    BACKWARD = 0
    ZERO = 1
    UNKNOWN = 2

class Cs3Rounding(enum.Enum):
    DOWN = 0
    NEAREST = 1
    UP = 2

class Cs3Reached(enum.Enum):
    FACTOR = 0
    CUT = 1
    CONTINUED = 2
    ALL_PIXELS = 3

class Cs3Reading:
    beside_invalid: Cs3BesideInvalid
    rounding: Cs3Rounding
    stencil: Cs3Stencil
    def __init__(self) -> None: ...
    @property
    def outliers(self) -> float: ...
    @outliers.setter
    def outliers(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class Cs3Options:
    distance_dependent: bool
    importance: Cs3Importance
    reading: Cs3Reading
    sampling: Cs3Sampling
    def __init__(self) -> None: ...
    @property
    def max_edge(self) -> float: ...
    @max_edge.setter
    def max_edge(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def num_threads(self) -> int: ...
    @num_threads.setter
    def num_threads(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def target_points(self) -> int: ...
    @target_points.setter
    def target_points(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class Cs3Runner:
    def __init__(self) -> None: ...
    def run_depth(
        self,
        depth: numpy.ndarray,
        camera: manip3d.camera.Intrinsics,
        options: Cs3Options,
        registration: manip3d.camera.Registration | None,
        out: manip3d.simplify._depth._Buffers,
    ) -> dict[str, typing.Any]: ...
    def run_grid(
        self,
        points: numpy.typing.NDArray[numpy.float32],
        valid: numpy.typing.NDArray[numpy.bool],
        rows_up: bool,
        options: Cs3Options,
        out: manip3d.simplify._depth._Buffers,
    ) -> dict[str, typing.Any]: ...

class ReliefEffort(enum.Enum):
    live = 0
    fast = 1
    balanced = 2
    fine = 3
    best = 4

class ReliefStop(enum.Enum):
    target = 0
    all_points = 1
    small_pieces = 2
    few_faces = 3
    fewer_points = 4
    pinholes = 5
    smaller_level = 6

class ReliefOptions:
    effort: ReliefEffort
    from_origin: bool
    measure_coverage: bool
    move_points: bool
    def __init__(self) -> None: ...
    @property
    def focal(self) -> float: ...
    @focal.setter
    def focal(self, arg1: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def levels(self) -> list[int]: ...
    @levels.setter
    def levels(
        self, arg0: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ) -> None: ...
    @property
    def max_edge(self) -> float: ...
    @max_edge.setter
    def max_edge(self, arg1: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def max_step(self) -> float: ...
    @max_step.setter
    def max_step(self, arg1: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def num_threads(self) -> int: ...
    @num_threads.setter
    def num_threads(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def stability(self) -> float: ...
    @stability.setter
    def stability(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def target_points(self) -> int: ...
    @target_points.setter
    def target_points(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class ReliefSolver:
    def __init__(self) -> None: ...
    def reset(self) -> None: ...
    def run(
        self,
        points: numpy.typing.NDArray[numpy.float32],
        valid: numpy.typing.NDArray[numpy.bool],
        rows_up: bool,
        options: ReliefOptions,
        confidence: numpy.typing.NDArray[numpy.float32] | None = None,
    ) -> dict[str, typing.Any]: ...
    def run_depth(
        self,
        depth: numpy.ndarray,
        camera: manip3d.camera.Intrinsics,
        options: ReliefOptions,
        confidence: numpy.typing.NDArray[numpy.float32] | None = None,
    ) -> dict[str, typing.Any]: ...

class DepthSmoother:
    def __init__(
        self,
        newest_share: typing.SupportsFloat | typing.SupportsIndex,
        gate: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def add(self, depth: numpy.ndarray) -> numpy.typing.NDArray[numpy.float32]: ...
    def reset(self) -> None: ...
    def show(
        self,
        pixels: numpy.typing.NDArray[numpy.int32],
        depths: numpy.typing.NDArray[numpy.float32],
        faces: numpy.typing.NDArray[numpy.int32],
    ) -> None: ...
    def starts_anew(self) -> bool: ...

class Duplicates(enum.Enum):
    keep = 0
    same = 1
    any = 2

class BoundaryTerm(enum.Enum):
    NONE = 0
    FREEZE = 1
    WEIGHT = 2
    CURVATURE = 3

class BoundaryCurvature(enum.Enum):
    TURNING = 0
    PAPER = 1

class TextureTerm(enum.Enum):
    NONE = 0
    QUADRIC5 = 1
    SEAM_PLANES = 2
    SEAM_PAPER = 3
    SEAM_LOCK = 4

class LinkCondition(enum.Enum):
    MANIFOLD = 0
    ALWAYS = 1
    NEVER = 2

class ComplexVertices(enum.Enum):
    KEEP = 0
    FREEZE = 1

class CollapseStop(enum.Enum):
    TARGET_REACHED = 0
    ERROR_LIMIT = 1
    DISTANCE_LIMIT = 2
    NO_LEGAL_COLLAPSE = 3
    REFUSED = 4

class QemOptions:
    boundary: BoundaryTerm
    complex_vertices: ComplexVertices
    curvature: BoundaryCurvature
    link_condition: LinkCondition
    texture: TextureTerm
    def __getstate__(
        self,
    ) -> tuple[
        int,
        float,
        float,
        BoundaryTerm,
        float,
        BoundaryCurvature,
        TextureTerm,
        float,
        ComplexVertices,
        LinkCondition,
        float,
    ]: ...
    def __init__(self) -> None: ...
    def __setstate__(self, arg0: tuple[object, ...]) -> None: ...
    @property
    def boundary_weight(self) -> float: ...
    @boundary_weight.setter
    def boundary_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def max_distance(self) -> float: ...
    @max_distance.setter
    def max_distance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def max_error(self) -> float: ...
    @max_error.setter
    def max_error(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def quality_threshold(self) -> float: ...
    @quality_threshold.setter
    def quality_threshold(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def seam_weight(self) -> float: ...
    @seam_weight.setter
    def seam_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def target_faces(self) -> int: ...
    @target_faces.setter
    def target_faces(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class QualityOptions:
    texture_seen: bool
    def __init__(self) -> None: ...
    @property
    def boundary_weight(self) -> float: ...
    @boundary_weight.setter
    def boundary_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def color_weight(self) -> float: ...
    @color_weight.setter
    def color_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def importance(self) -> list[float]: ...
    @importance.setter
    def importance(
        self, arg0: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex]
    ) -> None: ...
    @property
    def locked(self) -> list[bool]: ...
    @locked.setter
    def locked(self, arg0: collections.abc.Sequence[bool]) -> None: ...
    @property
    def looks(self) -> list[int]: ...
    @looks.setter
    def looks(
        self, arg0: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ) -> None: ...
    @property
    def max_distance(self) -> float: ...
    @max_distance.setter
    def max_distance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def max_error(self) -> float: ...
    @max_error.setter
    def max_error(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def seam_weight(self) -> float: ...
    @seam_weight.setter
    def seam_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def target_faces(self) -> int: ...
    @target_faces.setter
    def target_faces(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def texture_weight(self) -> float: ...
    @texture_weight.setter
    def texture_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class FastOptions:
    def __init__(self) -> None: ...
    @property
    def boundary_weight(self) -> float: ...
    @boundary_weight.setter
    def boundary_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def color_weight(self) -> float: ...
    @color_weight.setter
    def color_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def locked(self) -> list[bool]: ...
    @locked.setter
    def locked(self, arg0: collections.abc.Sequence[bool]) -> None: ...
    @property
    def looks(self) -> list[int]: ...
    @looks.setter
    def looks(
        self, arg0: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex]
    ) -> None: ...
    @property
    def max_error(self) -> float: ...
    @max_error.setter
    def max_error(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def num_threads(self) -> int: ...
    @num_threads.setter
    def num_threads(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def seam_weight(self) -> float: ...
    @seam_weight.setter
    def seam_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def target_faces(self) -> int: ...
    @target_faces.setter
    def target_faces(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class ColliderTracker:
    def __init__(
        self,
        *,
        percentile: typing.SupportsFloat | typing.SupportsIndex,
        frames: typing.SupportsInt | typing.SupportsIndex,
        min_points: typing.SupportsInt | typing.SupportsIndex,
        min_radius: typing.SupportsFloat | typing.SupportsIndex,
        max_radius: typing.SupportsFloat | typing.SupportsIndex,
        first_radius: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def first_hits(
        self,
        start: numpy.typing.NDArray[numpy.float32],
        end: numpy.typing.NDArray[numpy.float32],
        radius: numpy.typing.NDArray[numpy.float32],
    ) -> tuple[
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.int8],
        numpy.typing.NDArray[numpy.float32],
    ]: ...
    def now(
        self,
    ) -> tuple[
        numpy.typing.NDArray[numpy.float32],
        numpy.typing.NDArray[numpy.float32],
        numpy.typing.NDArray[numpy.float32],
        numpy.typing.NDArray[numpy.float32],
    ]: ...
    def reset(self) -> None: ...
    def update(
        self,
        skeleton: manip3d.rgbd.Skeleton,
        label: numpy.typing.NDArray[numpy.uint8],
        squared_distance: numpy.typing.NDArray[numpy.float32],
    ) -> tuple[
        numpy.typing.NDArray[numpy.float32],
        numpy.typing.NDArray[numpy.float32],
        numpy.typing.NDArray[numpy.float32],
        numpy.typing.NDArray[numpy.float32],
    ]: ...

class ShoeCoverTracker:
    def __init__(
        self,
        *,
        hue: tuple[
            typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex
        ],
        min_saturation: typing.SupportsInt | typing.SupportsIndex,
        min_value: typing.SupportsInt | typing.SupportsIndex,
        reach: typing.SupportsFloat | typing.SupportsIndex,
        min_pixels: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...
    def update(
        self, frame: manip3d.rgbd.RgbdFrame, skeleton: manip3d.rgbd.Skeleton, left: bool
    ) -> dict[str, typing.Any] | None: ...
    @property
    def num_pixels(self) -> int: ...

class PlacementEstimator:
    def __init__(
        self,
        *,
        share: typing.SupportsFloat | typing.SupportsIndex,
        spread: typing.SupportsFloat | typing.SupportsIndex,
        stable_frames: typing.SupportsInt | typing.SupportsIndex,
        tolerance: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...
    def reset(self) -> None: ...
    def update(
        self, skeleton: manip3d.rgbd.Skeleton, left_is_intact: bool
    ) -> dict[str, typing.Any] | None: ...

class ReposeOptions:
    blended: bool
    def __init__(self) -> None: ...
    @property
    def band(self) -> float: ...
    @band.setter
    def band(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def gain(self) -> typing.Annotated[list[float], "FixedSize(25)"]: ...
    @gain.setter
    def gain(
        self,
        arg0: typing.Annotated[
            collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(25)"
        ],
    ) -> None: ...
    @property
    def limit(self) -> typing.Annotated[list[float], "FixedSize(25)"]: ...
    @limit.setter
    def limit(
        self,
        arg0: typing.Annotated[
            collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(25)"
        ],
    ) -> None: ...
    @property
    def num_threads(self) -> int: ...
    @num_threads.setter
    def num_threads(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class RgbdSource:
    def calibration(self) -> dict[str, typing.Any] | None: ...
    def conversions(self) -> dict[str, typing.Any]: ...
    def counters(self) -> dict[str, int]: ...
    def is_live(self) -> bool: ...
    def num_frames(self) -> int | None: ...
    def read(
        self, timeout_ms: typing.SupportsInt | typing.SupportsIndex
    ) -> dict[str, typing.Any] | bool: ...
    def read_at(
        self, index: typing.SupportsInt | typing.SupportsIndex
    ) -> dict[str, typing.Any]: ...
    def seek(self, index: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    def start(self) -> None: ...
    def stop(self) -> None: ...

class RecordingKind(enum.Enum):
    folder = 0
    mkv = 1
    tum = 2

class RgbdRecorder:
    def close(self) -> None: ...
    def counters(self) -> dict[str, int]: ...
    def write(self, frame: manip3d.rgbd.RgbdFrame) -> None: ...

class VelodyneOptions:
    def __init__(
        self,
        model: str,
        lasers: numpy.typing.NDArray[numpy.float64],
        range_unit: typing.SupportsFloat | typing.SupportsIndex,
        cut_azimuth: typing.SupportsFloat | typing.SupportsIndex,
        interpolate_azimuth: bool,
        min_range: typing.SupportsFloat | typing.SupportsIndex,
        max_range: typing.SupportsFloat | typing.SupportsIndex,
    ) -> None: ...

class VelodynePcapSource:
    def __init__(
        self,
        path: bytes,
        options: VelodyneOptions,
        port: typing.SupportsInt | typing.SupportsIndex,
        max_bytes: typing.SupportsInt | typing.SupportsIndex,
        sensor: bytes,
    ) -> None: ...
    def counters(self) -> dict[str, int]: ...
    def read(
        self, timeout_ms: typing.SupportsInt | typing.SupportsIndex
    ) -> dict[str, typing.Any] | bool: ...

class VelodyneUdpSource:
    def __init__(
        self,
        address: bytes,
        port: typing.SupportsInt | typing.SupportsIndex,
        sender: bytes,
        ring_packets: typing.SupportsInt | typing.SupportsIndex,
        options: VelodyneOptions,
    ) -> None: ...
    def counters(self) -> dict[str, int]: ...
    def port(self) -> int: ...
    def read(
        self, timeout_ms: typing.SupportsInt | typing.SupportsIndex
    ) -> dict[str, typing.Any] | bool: ...
    def start(self) -> None: ...
    def stop(self) -> None: ...

class ScanGrid:
    def __getstate__(self) -> tuple[float, float, float, float, float, float]: ...
    def __init__(self) -> None: ...
    def __setstate__(self, arg0: tuple[object, ...]) -> None: ...
    @property
    def azimuth_phase(self) -> float: ...
    @azimuth_phase.setter
    def azimuth_phase(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def azimuth_step(self) -> float: ...
    @azimuth_step.setter
    def azimuth_step(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def azimuth_strength(self) -> float: ...
    @azimuth_strength.setter
    def azimuth_strength(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def elevation_phase(self) -> float: ...
    @elevation_phase.setter
    def elevation_phase(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def elevation_step(self) -> float: ...
    @elevation_step.setter
    def elevation_step(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def elevation_strength(self) -> float: ...
    @elevation_strength.setter
    def elevation_strength(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class Limb(enum.Enum):
    LEFT_ARM = 0
    RIGHT_ARM = 1
    LEFT_LEG = 2
    RIGHT_LEG = 3

class MirrorMode(enum.Enum):
    REFLECTION = 0
    PAPER = 1
    IMAGE = 2

class PlaneRule(enum.Enum):
    TRUNK = 0
    JOINTS = 1

class BoneRule(enum.Enum):
    SKIN = 0
    PAPER = 1

class Texturing(enum.Enum):
    SOURCE = 0
    CALIBRATION = 1

class PhantomState(enum.Enum):
    TRACKING = 0
    DEGRADED = 1
    HOLDING = 2
    FADING = 3
    LOST = 4
    LATE = 5

class DownSource(enum.Enum):
    ASSUMED = 0
    POSTURE = 1
    FLOOR = 2

class PhantomReason(enum.Enum):
    NONE = 0
    NO_PERSON = 1
    NO_PLANE = 2
    OCCLUDED = 3
    INFERRED = 4
    NO_SKELETON = 5
    CALIBRATION = 6
    STOPPED = 7
    SIDES = 8
    SHAKY = 9
    LEAP = 10
    DETACHED = 11
    SHREDDED = 12
    CUT = 13
    DOUBLED = 14
    CLOTH = 15
    LATE = 16
    NO_JOINTS = 17

class JointSmootherOptions:
    @staticmethod
    def seated() -> JointSmootherOptions: ...
    def __init__(self) -> None: ...
    @property
    def correction(self) -> float: ...
    @correction.setter
    def correction(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def jitter_radius(self) -> float: ...
    @jitter_radius.setter
    def jitter_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def max_deviation(self) -> float: ...
    @max_deviation.setter
    def max_deviation(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def prediction(self) -> float: ...
    @prediction.setter
    def prediction(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def smoothing(self) -> float: ...
    @smoothing.setter
    def smoothing(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class JointSmoother:
    def __init__(self, options: JointSmootherOptions) -> None: ...
    def add(self, raw: manip3d.rgbd.Skeleton) -> dict[str, typing.Any]: ...
    def reset(self) -> None: ...

class KeyPersonOptions:
    def __init__(self) -> None: ...
    @property
    def forget(self) -> float: ...
    @forget.setter
    def forget(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def patience(self) -> float: ...
    @patience.setter
    def patience(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def reach(self) -> float: ...
    @reach.setter
    def reach(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class KeyPerson:
    def __init__(self, options: KeyPersonOptions) -> None: ...
    def find(
        self,
        people: collections.abc.Iterable[manip3d.rgbd.Skeleton],
        camera: manip3d.camera.Intrinsics,
        time: typing.SupportsFloat | typing.SupportsIndex,
        clothes: numpy.typing.NDArray[numpy.float32] | None,
    ) -> int | None: ...
    def reset(self) -> None: ...
    def select(self, id: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class PersonMaskOptions:
    def __init__(self) -> None: ...
    @property
    def far(self) -> float: ...
    @far.setter
    def far(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def margin(self) -> float: ...
    @margin.setter
    def margin(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def near(self) -> float: ...
    @near.setter
    def near(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class PhantomMeshOptions:
    texturing: Texturing
    def __init__(self) -> None: ...
    @property
    def max_depth_step(self) -> float: ...
    @max_depth_step.setter
    def max_depth_step(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class PhantomOptions:
    affected: Limb
    keep_residual: bool
    mask: PersonMaskOptions
    mesh: PhantomMeshOptions
    mode: MirrorMode
    plane: PlaneRule
    segmentation: BoneRule
    smoothing: JointSmootherOptions
    smooths: bool
    def __init__(self) -> None: ...
    @property
    def arm_radius(self) -> float: ...
    @arm_radius.setter
    def arm_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def fade_seconds(self) -> float: ...
    @fade_seconds.setter
    def fade_seconds(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def hold_seconds(self) -> float: ...
    @hold_seconds.setter
    def hold_seconds(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def inferred_seconds(self) -> float: ...
    @inferred_seconds.setter
    def inferred_seconds(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def least_visible(self) -> float: ...
    @least_visible.setter
    def least_visible(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def leg_radius(self) -> float: ...
    @leg_radius.setter
    def leg_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def root_radius(self) -> float: ...
    @root_radius.setter
    def root_radius(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class ArrayPool:
    def __init__(self) -> None: ...
    def empty(
        self,
        shape: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        dtype: numpy.typing.DTypeLike,
    ) -> numpy.ndarray: ...

class PhantomPipeline:
    def __init__(self, options: PhantomOptions) -> None: ...
    def process(
        self,
        depth: numpy.ndarray,
        body_index: numpy.typing.NDArray[numpy.uint8] | None,
        camera: manip3d.camera.Intrinsics,
        registration: manip3d.camera.Registration | None,
        color: numpy.typing.NDArray[numpy.uint8] | None,
        people: collections.abc.Iterable[manip3d.rgbd.Skeleton],
        time_ns: typing.SupportsInt | typing.SupportsIndex,
        number: typing.SupportsInt | typing.SupportsIndex,
        out: manip3d.modify._phantom._Buffers,
    ) -> dict[str, typing.Any]: ...
    def reset(self) -> None: ...
    def select(self, id: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class WatermarkKey:
    @staticmethod
    def create(
        path: bytes,
        created_ns: typing.SupportsInt | typing.SupportsIndex,
        expires_ns: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...
    def __init__(self, path: bytes) -> None: ...
    def close(self) -> None: ...
    @property
    def created_ns(self) -> int: ...
    @property
    def expires_ns(self) -> int: ...
    @property
    def id(self) -> bytes: ...
    @property
    def is_open(self) -> bool: ...

class WatermarkEmbedder:
    def __init__(
        self,
        key: WatermarkKey,
        sensor: bytes,
        session: bytes | None,
        embedding: typing.SupportsInt | typing.SupportsIndex,
        slices: typing.SupportsInt | typing.SupportsIndex,
        least_points: typing.SupportsInt | typing.SupportsIndex,
        paper_merge: bool,
        round: bool,
        units_per_m: typing.SupportsInt | typing.SupportsIndex = 1000,
        after: bytes | None = None,
    ) -> None: ...
    def close(self) -> None: ...
    def embed(
        self,
        points: numpy.typing.NDArray[numpy.float32],
        intensity: numpy.typing.NDArray[numpy.float32],
        time_ns: typing.SupportsInt | typing.SupportsIndex,
        num_dropped: typing.SupportsInt | typing.SupportsIndex,
        is_end: bool,
        context: bytes | None,
        exact: numpy.typing.NDArray[numpy.float64] | None = None,
        offset: typing.Annotated[
            collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], "FixedSize(3)"
        ] = [0, 0, 0],
        picture: numpy.typing.NDArray[numpy.uint8] | None = None,
    ) -> tuple[
        numpy.typing.NDArray[numpy.float32],
        bytes,
        int,
        int,
        numpy.typing.NDArray[numpy.float64],
        numpy.typing.NDArray[numpy.uint8],
    ]: ...
    @property
    def session(self) -> bytes: ...

class WatermarkPolicy:
    def __init__(
        self,
        embeddings: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        carriers: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
        sensors: collections.abc.Sequence[bytes],
        sessions: collections.abc.Sequence[bytes],
        max_points: typing.SupportsInt | typing.SupportsIndex,
        any_order: bool,
        max_age_ns: typing.SupportsInt | typing.SupportsIndex,
        context: bytes | None,
        units_per_m: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex] = [],
    ) -> None: ...

class WatermarkVerifier:
    def __init__(self, key: WatermarkKey) -> None: ...
    def add_older_key(
        self, key: WatermarkKey, replaced_ns: typing.SupportsInt | typing.SupportsIndex
    ) -> None: ...
    def close(self) -> None: ...
    def reset(self) -> None: ...
    def restore(self, state: bytes) -> None: ...
    def state(self) -> bytes: ...
    def verify(
        self,
        points: numpy.typing.NDArray[numpy.float32],
        intensity: numpy.typing.NDArray[numpy.float32],
        record: bytes,
        policy: WatermarkPolicy,
        num_dropped: typing.SupportsInt | typing.SupportsIndex,
        now_ns: typing.SupportsInt | typing.SupportsIndex,
        exact: numpy.typing.NDArray[numpy.float64] | None = None,
        picture: numpy.typing.NDArray[numpy.uint8] | None = None,
    ) -> dict[str, typing.Any]: ...

class PaperSettings:
    def __init__(
        self,
        embedding: typing.SupportsInt | typing.SupportsIndex,
        slices: typing.SupportsInt | typing.SupportsIndex,
        block_bits: typing.SupportsInt | typing.SupportsIndex,
        paper_merge: bool,
        key_2: typing.SupportsInt | typing.SupportsIndex,
        frame: typing.SupportsInt | typing.SupportsIndex,
    ) -> None: ...

class PoseScope(enum.Enum):
    LIMBS = 0
    BODY = 1

class Skinning(enum.Enum):
    SPHERICAL = 0
    RIGID = 1
    LBS = 2

class CompositeSurface(enum.Enum):
    MESH = 0
    POINTS = 1

class DepthStepOptions:
    def __init__(self) -> None: ...
    @property
    def max_step(self) -> float: ...
    @max_step.setter
    def max_step(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class RegionOptions:
    line_seeds: bool
    step: DepthStepOptions
    def __init__(self) -> None: ...
    @property
    def reach(self) -> float: ...
    @reach.setter
    def reach(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class AnimationMeshOptions:
    by_label: bool
    step: DepthStepOptions
    def __init__(self) -> None: ...
    @property
    def joint_reach(self) -> float: ...
    @joint_reach.setter
    def joint_reach(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class CompositeOptions:
    fill_pinholes: bool
    surface: CompositeSurface
    def __init__(self) -> None: ...
    @property
    def blend(self) -> int: ...
    @blend.setter
    def blend(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...

class DepthNoiseOptions:
    def __init__(self) -> None: ...
    @property
    def region(self) -> int: ...
    @region.setter
    def region(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def sigma(self) -> float: ...
    @sigma.setter
    def sigma(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

class CrossModalOptions:
    def __getstate__(
        self,
    ) -> tuple[
        float,
        float,
        float,
        float,
        float,
        float,
        float,
        float,
        float,
        float,
        float,
        int,
        float,
        float,
    ]: ...
    def __init__(self) -> None: ...
    def __setstate__(self, arg0: tuple[object, ...]) -> None: ...
    @property
    def azimuth_step(self) -> float: ...
    @azimuth_step.setter
    def azimuth_step(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def dark_level(self) -> float: ...
    @dark_level.setter
    def dark_level(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def dark_weight(self) -> float: ...
    @dark_weight.setter
    def dark_weight(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def elevation_step(self) -> float: ...
    @elevation_step.setter
    def elevation_step(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def half_azimuth(self) -> float: ...
    @half_azimuth.setter
    def half_azimuth(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def heading(self) -> float: ...
    @heading.setter
    def heading(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def highest(self) -> float: ...
    @highest.setter
    def highest(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def lowest(self) -> float: ...
    @lowest.setter
    def lowest(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def max_range(self) -> float: ...
    @max_range.setter
    def max_range(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def min_added_area(self) -> float: ...
    @min_added_area.setter
    def min_added_area(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def min_cells(self) -> int: ...
    @min_cells.setter
    def min_cells(self, arg0: typing.SupportsInt | typing.SupportsIndex) -> None: ...
    @property
    def min_missing_area(self) -> float: ...
    @min_missing_area.setter
    def min_missing_area(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def min_range(self) -> float: ...
    @min_range.setter
    def min_range(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...
    @property
    def tolerance(self) -> float: ...
    @tolerance.setter
    def tolerance(self, arg0: typing.SupportsFloat | typing.SupportsIndex) -> None: ...

def animate(
    vertices: numpy.typing.NDArray[numpy.float32],
    labels: numpy.typing.NDArray[numpy.uint8],
    skeleton: manip3d.rgbd.Skeleton,
    pose: manip3d.rgbd.Skeleton,
    scope: PoseScope,
    method: Skinning,
) -> tuple[numpy.ndarray, dict[str, typing.Any]] | None: ...
def animation_mesh(
    depth: numpy.ndarray,
    labels: numpy.typing.NDArray[numpy.uint8],
    camera: manip3d.camera.Intrinsics,
    skeleton: manip3d.rgbd.Skeleton | None,
    options: AnimationMeshOptions,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.uint8],
    numpy.typing.NDArray[numpy.int32],
]: ...
def body_mirror(
    skeleton: manip3d.rgbd.Skeleton, affected: Limb, mode: MirrorMode
) -> dict[str, typing.Any] | None: ...
def boundary_gap(
    original: manip3d.mesh.Mesh,
    simplified: manip3d.mesh.Mesh,
    tolerance: typing.SupportsFloat | typing.SupportsIndex,
    weld: bool,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[
    tuple[float, float, float, int] | None,
    tuple[float, float, float, int] | None,
    int,
    float,
    float,
]: ...
def bounding_box(mesh: manip3d.mesh.Mesh) -> numpy.ndarray: ...
def check_intrinsics(camera: manip3d.camera.Intrinsics) -> None: ...
def check_mesh(mesh: manip3d.mesh.Mesh) -> None: ...
def check_points(
    points: numpy.typing.NDArray[numpy.float32], intensity: numpy.typing.NDArray[numpy.float32]
) -> None: ...
def check_registration(registration: manip3d.camera.Registration) -> None: ...
def clean(mesh: manip3d.mesh.Mesh, weld: bool, duplicates: Duplicates) -> dict[str, typing.Any]: ...
def closest_points(
    mesh: manip3d.mesh.Mesh,
    points: numpy.typing.NDArray[numpy.float64],
    max_distance: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[numpy.ndarray, numpy.ndarray, numpy.ndarray]: ...
def clothing_colors(
    depth: numpy.ndarray,
    body_index: numpy.typing.NDArray[numpy.uint8] | None,
    camera: manip3d.camera.Intrinsics,
    registration: manip3d.camera.Registration | None,
    color: numpy.typing.NDArray[numpy.uint8],
    people: collections.abc.Iterable[manip3d.rgbd.Skeleton],
) -> numpy.typing.NDArray[numpy.float32]: ...
def color_error(
    original: manip3d.mesh.Mesh,
    simplified: manip3d.mesh.Mesh,
    samples: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    epsilon: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[float, float, float, int]: ...
def compare_cross_modal(
    points: numpy.typing.NDArray[numpy.float32],
    disparity: numpy.typing.NDArray[numpy.float32],
    camera: typing.Annotated[
        collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex], "FixedSize(4)"
    ],
    lidar_from_camera: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[4, 4]"],
    options: CrossModalOptions,
    grey: numpy.typing.NDArray[numpy.uint8] | None = None,
) -> dict[str, typing.Any]: ...
def compare_paper_watermark(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    blocks: numpy.typing.NDArray[numpy.uint8],
    tile_of: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    counts: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
    options: PaperSettings,
) -> tuple[numpy.ndarray, numpy.ndarray, numpy.ndarray, numpy.ndarray]: ...
def compare_reflectance(
    points: numpy.typing.NDArray[numpy.float32],
    reflectance: numpy.typing.NDArray[numpy.float32],
    rings: numpy.typing.NDArray[numpy.float64],
    turns: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float32]],
    motions: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64]],
    threads: typing.SupportsInt | typing.SupportsIndex,
    reading: tuple[
        typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
    ]
    | None = None,
    seen: collections.abc.Sequence[
        tuple[
            typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
            typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
            typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
            typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
            typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
            typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        ]
    ] = [],
) -> list[tuple[str, float, numpy.typing.NDArray[numpy.int32]]]: ...
def compare_turns(
    points: numpy.typing.NDArray[numpy.float32],
    previous: numpy.typing.NDArray[numpy.float32],
    following: numpy.typing.NDArray[numpy.float32],
    rings: numpy.typing.NDArray[numpy.float64],
    whole_turns: bool,
    threads: typing.SupportsInt | typing.SupportsIndex,
    reading: tuple[
        typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
    ]
    | None = None,
) -> dict[str, typing.Any]: ...
def composite(
    vertices: numpy.typing.NDArray[numpy.float32],
    faces: numpy.typing.NDArray[numpy.int32],
    seen: numpy.typing.NDArray[numpy.float32],
    pixels: numpy.typing.NDArray[numpy.int32],
    person_color: numpy.typing.NDArray[numpy.uint8] | None,
    person_registration: manip3d.camera.Registration | None,
    in_place: bool,
    depth: numpy.typing.NDArray[numpy.uint16],
    camera: manip3d.camera.Intrinsics,
    color: numpy.typing.NDArray[numpy.uint8] | None,
    registration: manip3d.camera.Registration | None,
    options: CompositeOptions,
) -> tuple[
    numpy.typing.NDArray[numpy.uint16],
    numpy.typing.NDArray[numpy.uint8],
    numpy.typing.NDArray[numpy.uint8] | None,
]: ...
def copy_transform_paste(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    object: numpy.typing.NDArray[numpy.float32],
    object_intensity: numpy.typing.NDArray[numpy.float32],
    position: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    rotation: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 3]"],
    scale: typing.SupportsFloat | typing.SupportsIndex,
    paper: bool,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.float32] | None,
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    tuple[list[float], list[float], float],
    numpy.typing.NDArray[numpy.float64],
]: ...
def count_components(mesh: manip3d.mesh.Mesh) -> int: ...
def deform(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    box: tuple[
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.SupportsFloat | typing.SupportsIndex,
    ],
    amplitude: typing.SupportsFloat | typing.SupportsIndex,
    along_normal: bool,
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    seed: typing.SupportsInt | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.float32] | None,
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    tuple[list[float], list[float], float],
    numpy.typing.NDArray[numpy.float64],
]: ...
def density_levels(
    points: numpy.typing.NDArray[numpy.float32],
    distances: numpy.typing.NDArray[numpy.float64],
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    sector: typing.SupportsInt | typing.SupportsIndex,
    level_width: typing.SupportsFloat | typing.SupportsIndex,
    level_growth: typing.SupportsFloat | typing.SupportsIndex,
    max_range: typing.SupportsFloat | typing.SupportsIndex,
    level_out: bool,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[int, numpy.ndarray, numpy.ndarray, numpy.ndarray]: ...
def depth_coverage(
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    pixels: numpy.typing.NDArray[numpy.int32],
    faces: numpy.typing.NDArray[numpy.int32],
    max_edge: typing.SupportsFloat | typing.SupportsIndex,
    max_step: typing.SupportsFloat | typing.SupportsIndex,
    focal: typing.SupportsFloat | typing.SupportsIndex,
    filled: numpy.typing.NDArray[numpy.int32],
) -> tuple[float, float, float, float]: ...
def depth_noise(depth: numpy.ndarray, options: DepthNoiseOptions) -> numpy.ndarray: ...
def embed_paper_watermark(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    blocks: numpy.typing.NDArray[numpy.uint8],
    options: PaperSettings,
) -> tuple[numpy.ndarray, numpy.ndarray, numpy.ndarray]: ...
def encode_stream_frame(
    vertices: numpy.typing.NDArray[numpy.float32],
    texcoords: numpy.typing.NDArray[numpy.float32],
    phantoms: numpy.typing.NDArray[numpy.uint8],
    faces: numpy.typing.NDArray[numpy.int32],
    color: numpy.typing.NDArray[numpy.uint8] | None,
    phantom_color: numpy.typing.NDArray[numpy.uint8] | None,
    opacity: typing.SupportsFloat | typing.SupportsIndex,
    sequence: typing.SupportsInt | typing.SupportsIndex,
    time_ns: typing.SupportsInt | typing.SupportsIndex,
    captured_ns: typing.SupportsInt | typing.SupportsIndex,
    status: str,
    jpeg_quality: typing.SupportsInt | typing.SupportsIndex,
) -> bytes: ...
def estimate_scan_grid(
    points: numpy.typing.NDArray[numpy.float32],
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> ScanGrid: ...
def estimate_scan_origin(
    points: numpy.typing.NDArray[numpy.float32],
    known: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] | None,
    tries_zero: bool,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> dict[str, typing.Any]: ...
def faces_across_steps(
    image: numpy.typing.NDArray[numpy.float32],
    pixels: numpy.typing.NDArray[numpy.int32],
    faces: numpy.typing.NDArray[numpy.int32],
    share: typing.SupportsFloat | typing.SupportsIndex,
    slope: typing.SupportsFloat | typing.SupportsIndex,
    noise: typing.SupportsFloat | typing.SupportsIndex,
    passing: bool,
) -> numpy.ndarray: ...
def faces_left(
    mesh: manip3d.mesh.Mesh, collapses: numpy.typing.NDArray[numpy.int32]
) -> numpy.ndarray: ...
def faces_off_surface(
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    pixels: numpy.typing.NDArray[numpy.int32],
    faces: numpy.typing.NDArray[numpy.int32],
    max_edge: typing.SupportsFloat | typing.SupportsIndex,
    max_step: typing.SupportsFloat | typing.SupportsIndex,
    focal: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.ndarray: ...
def fmpd(
    original: manip3d.mesh.Mesh,
    simplified: manip3d.mesh.Mesh,
    clip: bool,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[float, float, float, int, bool]: ...
def generic_consistency(
    points: numpy.typing.NDArray[numpy.float32],
    rings: numpy.typing.NDArray[numpy.float64],
    steps: typing.SupportsInt | typing.SupportsIndex,
    range_step: typing.SupportsFloat | typing.SupportsIndex,
    coordinate_step: typing.SupportsFloat | typing.SupportsIndex,
    tolerance: typing.SupportsFloat | typing.SupportsIndex,
    range_incoherence: typing.SupportsFloat | typing.SupportsIndex,
    azimuth_error: typing.SupportsFloat | typing.SupportsIndex,
    previous: numpy.typing.NDArray[numpy.float32],
    following: numpy.typing.NDArray[numpy.float32],
    threads: typing.SupportsInt | typing.SupportsIndex,
    reading: tuple[
        typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.int32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
    ]
    | None = None,
) -> dict[str, typing.Any]: ...
def grid_delaunay(
    pixels: numpy.typing.NDArray[numpy.int32], edges: numpy.typing.NDArray[numpy.int32]
) -> numpy.ndarray: ...
def grid_mesh(
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    rows_up: bool,
    max_edge: typing.SupportsFloat | typing.SupportsIndex,
    registration: manip3d.camera.Registration | None,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> dict[str, typing.Any]: ...
def hausdorff_bound(
    original: manip3d.mesh.Mesh,
    simplified: manip3d.mesh.Mesh,
    tolerance: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[tuple[float, float], tuple[float, float], float]: ...
def insert_occluding(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    object: numpy.typing.NDArray[numpy.float32],
    faces: numpy.typing.NDArray[numpy.int32],
    position: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    rotation: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 3]"],
    scale: typing.SupportsFloat | typing.SupportsIndex,
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    range_noise: typing.SupportsFloat | typing.SupportsIndex,
    rings: collections.abc.Sequence[
        tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ]
    ],
    azimuth_step: typing.SupportsFloat | typing.SupportsIndex,
    azimuth_phase: typing.SupportsFloat | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.float32] | None,
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    tuple[list[float], list[float], float],
    numpy.typing.NDArray[numpy.float64],
]: ...
def is_posable(joint: typing.SupportsInt | typing.SupportsIndex) -> bool: ...
def joint_names() -> list[str]: ...
def joint_parents() -> list[int]: ...
def linear_color(
    rgb: typing.SupportsInt | typing.SupportsIndex,
) -> typing.Annotated[list[float], "FixedSize(3)"]: ...
def local_spacing(
    points: numpy.typing.NDArray[numpy.float32],
    position: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    radius: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> float: ...
def make_temporary_folder(folder: bytes) -> tuple[bytes, int]: ...
def metro(
    original: manip3d.mesh.Mesh,
    simplified: manip3d.mesh.Mesh,
    area: bool,
    samples: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[tuple[float, float, float, int], tuple[float, float, float, int], float]: ...
def mirrored_joints() -> list[int]: ...
def move_box(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    box: tuple[
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.SupportsFloat | typing.SupportsIndex,
    ],
    transform: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[4, 4]"],
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.float32] | None,
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    tuple[list[float], list[float], float],
    numpy.typing.NDArray[numpy.float64],
]: ...
def nearest_distances(
    points: numpy.typing.NDArray[numpy.float32],
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] | None,
    resolution: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> numpy.ndarray: ...
def occlusion_consistency(
    points: numpy.typing.NDArray[numpy.float32],
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    grid: ScanGrid,
    min_gap: typing.SupportsFloat | typing.SupportsIndex,
    accumulate: bool,
    min_cells: typing.SupportsInt | typing.SupportsIndex,
    min_area: typing.SupportsFloat | typing.SupportsIndex,
    max_range: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> dict[str, typing.Any]: ...
def open_recorder(
    path: bytes,
    calibration: manip3d.rgbd.RgbdCalibration | None,
    lossless_color: bool,
    jpeg_quality: typing.SupportsInt | typing.SupportsIndex,
    overwrite: bool,
    kind: RecordingKind | None = None,
) -> RgbdRecorder: ...
def open_rgbd(
    uri: bytes,
    speed: typing.SupportsFloat | typing.SupportsIndex,
    units_per_metre: typing.SupportsFloat | typing.SupportsIndex,
    rate: typing.SupportsFloat | typing.SupportsIndex,
    camera: manip3d.rgbd.RgbdCalibration | None,
) -> RgbdSource: ...
def point_suffixes() -> list[str]: ...
def points_in_box(
    points: numpy.typing.NDArray[numpy.float32],
    box: tuple[
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.SupportsFloat | typing.SupportsIndex,
    ],
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.ndarray: ...
def points_of_levels(
    points: numpy.typing.NDArray[numpy.float32],
    marked: numpy.typing.NDArray[numpy.uint8],
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    sector: typing.SupportsInt | typing.SupportsIndex,
    level_width: typing.SupportsFloat | typing.SupportsIndex,
    level_growth: typing.SupportsFloat | typing.SupportsIndex,
    max_range: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.ndarray: ...
def project(
    points: numpy.typing.NDArray[numpy.float64], camera: manip3d.camera.Intrinsics
) -> numpy.ndarray: ...
def range_image_error(
    mesh: manip3d.mesh.Mesh,
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    rows_up: bool,
    intrinsics: manip3d.camera.Intrinsics | None,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[float, float, float, float, int, int]: ...
def read_lattice(
    points: numpy.typing.NDArray[numpy.float32],
    rings: numpy.typing.NDArray[numpy.float64],
    steps: typing.SupportsInt | typing.SupportsIndex,
    range_step: typing.SupportsFloat | typing.SupportsIndex,
    coordinate_step: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.ndarray, numpy.ndarray, numpy.ndarray, numpy.ndarray, numpy.ndarray, numpy.ndarray
]: ...
def read_mesh(
    path: bytes,
    allow_outside: bool,
    max_bytes: typing.SupportsInt | typing.SupportsIndex,
    draco: collections.abc.Callable[[bytes], tuple[numpy.ndarray, dict[int, numpy.ndarray]] | str],
    progress: collections.abc.Callable[[float], object] | None = None,
) -> tuple[manip3d.mesh.Mesh, str, int, int, list[str]]: ...
def read_mesh_bytes(
    data: bytes,
    suffix: str,
    max_bytes: typing.SupportsInt | typing.SupportsIndex,
    draco: collections.abc.Callable[[bytes], tuple[numpy.ndarray, dict[int, numpy.ndarray]] | str],
    progress: collections.abc.Callable[[float], object] | None = None,
) -> tuple[manip3d.mesh.Mesh, str, int, int, list[str]]: ...
def read_points(
    path: bytes,
    max_bytes: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None = None,
) -> tuple[str, list[tuple[str, str, int]], list[tuple[str, str]], int, numpy.ndarray]: ...
def read_range_grid(
    path: bytes,
    max_bytes: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None = None,
) -> tuple[int, int, numpy.ndarray, numpy.ndarray, numpy.ndarray]: ...
def read_scene(
    path: bytes,
    allow_outside: bool,
    max_bytes: typing.SupportsInt | typing.SupportsIndex,
    draco: collections.abc.Callable[[bytes], tuple[numpy.ndarray, dict[int, numpy.ndarray]] | str],
    progress: collections.abc.Callable[[float], object] | None = None,
) -> tuple[
    list[
        tuple[
            str,
            int,
            int,
            numpy.typing.NDArray[numpy.float64],
            bool,
            numpy.typing.NDArray[numpy.float64] | None,
            int,
            numpy.typing.NDArray[numpy.float64],
        ]
    ],
    list[
        tuple[
            str,
            manip3d.mesh.Mesh,
            str,
            tuple[
                numpy.typing.NDArray[numpy.uint16],
                numpy.typing.NDArray[numpy.float32],
                numpy.typing.NDArray[numpy.float32],
                numpy.typing.NDArray[numpy.float32],
            ]
            | None,
            numpy.typing.NDArray[numpy.float32] | None,
            numpy.typing.NDArray[numpy.float32] | None,
        ]
    ],
    bytes,
    bytes,
    list[str],
]: ...
def readable_suffixes() -> list[str]: ...
def reflectance_contrast(
    points: numpy.typing.NDArray[numpy.float32],
    reflectance: numpy.typing.NDArray[numpy.float32],
    rings: numpy.typing.NDArray[numpy.int32],
    azimuths: numpy.typing.NDArray[numpy.float32],
    slips: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex],
) -> tuple[int, int, list[float]]: ...
def registered_texcoords(
    vertices: numpy.typing.NDArray[numpy.float32], registration: manip3d.camera.Registration
) -> numpy.ndarray: ...
def render_depth(
    mesh: manip3d.mesh.Mesh,
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    rows_up: bool,
    intrinsics: manip3d.camera.Intrinsics | None,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> numpy.ndarray: ...
def replace_folder(made: bytes, target: bytes) -> None: ...
def replace_rows(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    removed: numpy.typing.NDArray[numpy.int32],
    added: numpy.typing.NDArray[numpy.float32],
    added_intensity: numpy.typing.NDArray[numpy.float32],
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.float32] | None,
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    tuple[list[float], list[float], float],
    numpy.typing.NDArray[numpy.float64],
]: ...
def replay_collapses(
    mesh: manip3d.mesh.Mesh,
    options: QemOptions,
    collapses: numpy.typing.NDArray[numpy.int32],
    collapse_errors: numpy.typing.NDArray[numpy.float64],
    target_faces: typing.SupportsInt | typing.SupportsIndex,
) -> dict[str, typing.Any]: ...
@typing.overload
def repose(
    vertices: numpy.typing.NDArray[numpy.float32],
    skeleton: manip3d.rgbd.Skeleton,
    rest: manip3d.rgbd.Skeleton | None,
    options: ReposeOptions,
) -> tuple[numpy.ndarray, dict[str, typing.Any]] | None: ...
@typing.overload
def repose(
    vertices: numpy.typing.NDArray[numpy.float64],
    skeleton: manip3d.rgbd.Skeleton,
    rest: manip3d.rgbd.Skeleton | None,
    options: ReposeOptions,
) -> tuple[numpy.ndarray, dict[str, typing.Any]] | None: ...
def resample(
    object: numpy.typing.NDArray[numpy.float32],
    faces: numpy.typing.NDArray[numpy.int32],
    spacing: typing.SupportsFloat | typing.SupportsIndex,
    uniform: bool,
    seed: typing.SupportsInt | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.ndarray: ...
def resolve_inside(folder: bytes, reference: bytes) -> bytes: ...
def rgbd_schemes() -> list[dict[str, str]]: ...
def rotation_about_z(
    yaw: typing.SupportsFloat | typing.SupportsIndex,
) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 3]"]: ...
def sample_poisson_disk(
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    target_points: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[numpy.ndarray, float]: ...
def sample_scale_space(
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    target_points: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[numpy.ndarray, float]: ...
def sample_uniform(
    points: numpy.typing.NDArray[numpy.float32],
    valid: numpy.typing.NDArray[numpy.bool],
    target_points: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.ndarray: ...
def segment_objects(
    points: numpy.typing.NDArray[numpy.float32],
    origin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
    max_range: typing.SupportsFloat | typing.SupportsIndex,
    ground_height: typing.SupportsFloat | typing.SupportsIndex,
    ground_slope: typing.SupportsFloat | typing.SupportsIndex,
    tolerance: typing.SupportsFloat | typing.SupportsIndex,
    min_points: typing.SupportsInt | typing.SupportsIndex,
    max_size: typing.SupportsFloat | typing.SupportsIndex,
) -> tuple[numpy.ndarray, list[tuple[list[float], list[float], float]]]: ...
def segment_person(
    depth: numpy.ndarray,
    body_index: numpy.typing.NDArray[numpy.uint8] | None,
    camera: manip3d.camera.Intrinsics,
    skeleton: manip3d.rgbd.Skeleton,
    options: PersonMaskOptions,
    rule: BoneRule,
) -> tuple[numpy.ndarray, numpy.ndarray]: ...
def segment_region(
    depth: numpy.ndarray,
    body_index: numpy.typing.NDArray[numpy.uint8] | None,
    camera: manip3d.camera.Intrinsics,
    skeleton: manip3d.rgbd.Skeleton,
    mask: PersonMaskOptions,
    options: RegionOptions,
) -> tuple[numpy.typing.NDArray[numpy.uint8], numpy.typing.NDArray[numpy.float32]]: ...
def shading_normals(
    mesh: manip3d.mesh.Mesh,
    crease_angle: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[numpy.ndarray, numpy.ndarray]: ...
def silhouette_spans(
    depth: numpy.ndarray,
    focal: typing.SupportsFloat | typing.SupportsIndex,
    min_relief: typing.SupportsFloat | typing.SupportsIndex,
) -> numpy.ndarray: ...
def simplify_fast(
    mesh: manip3d.mesh.Mesh,
    options: FastOptions,
    progress: collections.abc.Callable[[float], object] | None = None,
) -> dict[str, typing.Any]: ...
def simplify_qem(
    mesh: manip3d.mesh.Mesh,
    options: QemOptions,
    progress: collections.abc.Callable[[float], object] | None = None,
) -> dict[str, typing.Any]: ...
def simplify_quality(
    mesh: manip3d.mesh.Mesh,
    options: QualityOptions,
    progress: collections.abc.Callable[[float], object] | None = None,
) -> dict[str, typing.Any]: ...
def snap_to_lattice(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    snapped: numpy.typing.NDArray[numpy.int32],
    rings: collections.abc.Sequence[
        tuple[
            typing.SupportsFloat | typing.SupportsIndex, typing.SupportsFloat | typing.SupportsIndex
        ]
    ],
    azimuth_step: typing.SupportsFloat | typing.SupportsIndex,
    azimuth_phase: typing.SupportsFloat | typing.SupportsIndex,
    along_ray: bool,
    azimuth: bool,
    max_move: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.float32] | None,
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    tuple[list[float], list[float], float],
    numpy.typing.NDArray[numpy.float64],
]: ...
def sparse_distances(
    points: numpy.typing.NDArray[numpy.float32],
    neighbours: typing.SupportsInt | typing.SupportsIndex,
    nearest: typing.SupportsFloat | typing.SupportsIndex,
    angle: typing.SupportsFloat | typing.SupportsIndex,
    farthest: typing.SupportsFloat | typing.SupportsIndex,
    every: typing.SupportsInt | typing.SupportsIndex,
) -> list[numpy.typing.NDArray[numpy.float32]]: ...
def subtract(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    box: tuple[
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"],
        typing.SupportsFloat | typing.SupportsIndex,
    ],
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[
    numpy.typing.NDArray[numpy.float32],
    numpy.typing.NDArray[numpy.float32] | None,
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    numpy.typing.NDArray[numpy.int32],
    tuple[list[float], list[float], float],
    numpy.typing.NDArray[numpy.float64],
]: ...
def summarize(mesh: manip3d.mesh.Mesh) -> dict[str, typing.Any]: ...
def surface_colors(
    mesh: manip3d.mesh.Mesh, corner_colors: numpy.typing.NDArray[numpy.int32]
) -> tuple[
    numpy.typing.NDArray[numpy.int32],
    list[manip3d.mesh.Material],
    numpy.typing.NDArray[numpy.uint8],
    str,
]: ...
def texture_error(
    original: manip3d.mesh.Mesh,
    simplified: manip3d.mesh.Mesh,
    samples: typing.SupportsInt | typing.SupportsIndex,
    seed: typing.SupportsInt | typing.SupportsIndex,
    epsilon: typing.SupportsFloat | typing.SupportsIndex,
    threads: typing.SupportsInt | typing.SupportsIndex,
    progress: collections.abc.Callable[[float], object] | None,
) -> tuple[
    float | None, float | None, float | None, float | None, int, int, float, float | None
]: ...
def triangulate_polygons(
    vertices: numpy.typing.NDArray[numpy.float64],
    corners: numpy.typing.NDArray[numpy.int32],
    counts: numpy.typing.NDArray[numpy.int32],
) -> numpy.ndarray: ...
def unproject(
    depth: numpy.ndarray,
    camera: manip3d.camera.Intrinsics,
    threads: typing.SupportsInt | typing.SupportsIndex,
) -> tuple[numpy.ndarray, numpy.ndarray, bool]: ...
def unproject_pixels(
    pixels: numpy.typing.NDArray[numpy.float64],
    depth: numpy.typing.NDArray[numpy.float64],
    camera: manip3d.camera.Intrinsics,
) -> numpy.ndarray: ...
def watermark_in_picture(picture: numpy.typing.NDArray[numpy.uint8]) -> bytes: ...
def watermark_order(
    points: numpy.typing.NDArray[numpy.float32],
    intensity: numpy.typing.NDArray[numpy.float32],
    embedding: typing.SupportsInt | typing.SupportsIndex,
    slices: typing.SupportsInt | typing.SupportsIndex,
    least_points: typing.SupportsInt | typing.SupportsIndex,
) -> numpy.ndarray: ...
def welded_boundary(mesh: manip3d.mesh.Mesh) -> numpy.ndarray: ...
def without_speckles(
    depth: numpy.typing.NDArray[numpy.uint16], labels: numpy.typing.NDArray[numpy.uint8]
) -> tuple[numpy.typing.NDArray[numpy.uint16], numpy.typing.NDArray[numpy.uint8]]: ...
def without_watermark_record(picture: numpy.typing.NDArray[numpy.uint8]) -> numpy.ndarray: ...
def writable_suffixes() -> list[str]: ...
def write_mesh(
    mesh: manip3d.mesh.Mesh,
    path: bytes,
    texture_folder: bytes,
    max_vertices: typing.SupportsInt | typing.SupportsIndex,
    quantize: bool,
    coarser: list[manip3d.mesh.Mesh],
    coverages: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    hash_names: bool,
) -> list[str]: ...
def write_points(
    path: bytes,
    fields: list[tuple[str, str, typing.SupportsInt | typing.SupportsIndex]],
    header: list[tuple[str, str]],
    num_points: typing.SupportsInt | typing.SupportsIndex,
    bytes: numpy.typing.NDArray[numpy.int8],
) -> None: ...
def write_scene(
    path: bytes,
    document: str,
    buffer: str,
    levels: collections.abc.Sequence[
        list[
            tuple[
                manip3d.mesh.Mesh,
                tuple[
                    typing.Annotated[numpy.typing.ArrayLike, numpy.uint16],
                    typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
                    typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
                    typing.Annotated[numpy.typing.ArrayLike, numpy.float32],
                ]
                | None,
                typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None,
                typing.Annotated[numpy.typing.ArrayLike, numpy.float32] | None,
            ]
            | None
        ]
    ],
    max_vertices: typing.SupportsInt | typing.SupportsIndex,
    coverages: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex],
    quantize: bool,
    hash_names: bool,
) -> list[str]: ...

CELL_COLUMNS: int = 500
__version__: str = "0.1.0"
