"""Render a missing limb by mirroring the intact one."""

from __future__ import annotations

import enum
import threading
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from manip3d import _core
from manip3d._util.arrays import as_array
from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.camera import Intrinsics, same_camera
from manip3d.errors import InputError
from manip3d.modify._level import level_rotation, turned_skeleton
from manip3d.modify._smoothing import Preset, smoother_options
from manip3d.rgbd import RgbdFrame, Skeleton

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.simplify import DepthMesh

Limb = Literal["left_arm", "right_arm", "left_leg", "right_leg"]
MirrorMode = Literal["reflection", "paper", "2d"]
Texturing = Literal["source", "calibration"]
Segmentation = Literal["skin", "paper"]
PlaneRule = Literal["trunk", "joints"]
_MODES = {
    "reflection": _core.MirrorMode.REFLECTION,
    "paper": _core.MirrorMode.PAPER,
    "2d": _core.MirrorMode.IMAGE,
}


class PixelKind(enum.IntEnum):
    """Content of a pixel of a `PhantomFrame`."""

    NONE = 0  #: nothing
    BODY = 1  #: the person, as measured
    PHANTOM = 2  #: a mirrored point whose surface faces the camera
    AWAY = 3  #: a mirrored point whose surface faces away from the camera
    FILLED = 4  #: a hole of the phantom, filled from its neighbours or from the affected limb
    ROOT_FILLED = 5  #: the gap at the root of the limb, filled by mirroring the intact side
    BRIDGED = 6  #: interpolated between two mirrored points that were neighbours before mirroring


class PhantomState(enum.StrEnum):
    """State of the phantom in one frame."""

    TRACKING = "tracking"  #: the intact limb is seen and mirrored
    DEGRADED = "degraded"  #: the intact limb is mirrored, but the result is implausible
    HOLDING = "holding"  #: the limb cannot be mirrored; the last phantom moves with the body
    FADING = "fading"  #: as HOLDING, with decreasing opacity
    LOST = "lost"  #: there is no phantom
    LATE = "late"  #: the frame repeats or precedes the last one, whose images are returned again


class DownSource(enum.StrEnum):
    """Evidence for the direction of the vertical."""

    ASSUMED = "assumed"  #: none yet: the camera is assumed to be level
    POSTURE = "posture"  #: spine and leg of the person; no floor has been seen
    FLOOR = "floor"  #: a floor that was seen


class PhantomReason(enum.StrEnum):
    """Reason why the state of a frame is not TRACKING."""

    NONE = "none"  #: the state is TRACKING
    NO_PERSON = "no_person"  #: the key person is not among the skeletons, or has no pixels
    NO_PLANE = "no_plane"  #: the axes of the body have not been found yet
    OCCLUDED = "occluded"  #: too little of limb or person is seen, or the phantom is not in view
    INFERRED = "inferred"  #: a joint of the intact limb is not seen and was inferred for too long
    NO_SKELETON = "no_skeleton"  #: no frame so far had a skeleton
    CALIBRATION = "calibration"  #: joints lie beside the person's pixels, or heights disagree
    STOPPED = "stopped"  #: the joints stand still while the person moves
    SIDES = "sides"  #: left and right are exchanged: the feet of the skeleton point backwards
    SHAKY = "shaky"  #: the plane of symmetry is too uncertain
    LEAP = "leap"  #: the phantom moved much farther than the intact limb
    DETACHED = "detached"  #: the phantom is not connected to the body
    SHREDDED = "shredded"  #: the phantom is in pieces
    CUT = "cut"  #: too much of the person's silhouette was removed
    DOUBLED = "doubled"  #: too much of the affected limb is still visible
    CLOTH = "cloth"  #: too many visible pixels may be an empty sleeve or trouser leg
    LATE = "late"  #: the frame repeats the last one, or is older
    NO_JOINTS = "no_joints"  #: no skeleton of the frame has a joint of a trunk

    @property
    def message(self) -> str:
        """The reason as a sentence for the operator, with advice."""
        return _MESSAGES[self]


_MESSAGES = {
    PhantomReason.NONE: "The phantom limb follows the intact limb.",
    PhantomReason.NO_PERSON: "The patient is not in view.",
    PhantomReason.NO_PLANE: "The shoulders or hips were not seen: let the patient face the camera.",
    PhantomReason.OCCLUDED: "Something hides the patient or the intact limb, it is out of the "
    "picture, or it is the one that is missing.",
    PhantomReason.INFERRED: "The tracker only guesses where the intact limb is: see to it that the "
    "camera sees all of it, and that the missing limb is the one that was chosen.",
    PhantomReason.NO_SKELETON: "There is no skeleton in this source: modify.PoseTracker finds the "
    "joints in colour images.",
    PhantomReason.CALIBRATION: "The joints do not fit the depth image: check the calibration, that "
    "both are in metres, and that the camera measures the depth of the clothes.",
    PhantomReason.STOPPED: "The joints stand still while the patient moves: start the tracker "
    "again.",
    PhantomReason.SIDES: "Left and right seem to be exchanged, as the patient's feet point "
    "backwards: check whether the joints or the pictures are mirrored.",
    PhantomReason.SHAKY: "The middle of the body is not known well: let the patient face the "
    "camera.",
    PhantomReason.LEAP: "The phantom limb jumped.",
    PhantomReason.DETACHED: "The phantom limb is not attached to the body.",
    PhantomReason.SHREDDED: "The phantom limb is in pieces.",
    PhantomReason.CUT: "Too much of the body was cut out with the limb.",
    PhantomReason.DOUBLED: "Part of the affected limb is still in the picture.",
    PhantomReason.CLOTH: "An empty sleeve or leg of trousers may still be in the picture: let the "
    "patient face the camera.",
    PhantomReason.LATE: "The camera's clock runs back, or a picture came twice: at most ten "
    "pictures in a row are passed over.",
    PhantomReason.NO_JOINTS: "The tracker has no joints in this picture: the patient is out of "
    "view, or was not recognised.",
}


@dataclass(frozen=True)
class PhantomQuality:
    """Plausibility measures of a frame with a phantom.

    Attributes
    ----------
    fit : float
        Share of the tracked joints, before smoothing, that lie on the person's pixels. Two kinds of
        joints that are more than 30 cm from all of these pixels do not count: those where the
        camera measures no depth, as on black trousers, and for an arm those of the legs that
        something nearer hides. All count if fewer than five would be left.
    hidden : float
        Share of the tracked joints that are hidden by something nearer: by at least 15 %, or by
        less if none of the person's pixels is within 30 cm of the joint.
    stature : float
        Ratio of the height of the person's pixels, from crown to sole, to the height of its joints;
        a mean over about three seconds. A value far from 1 indicates a wrong focal length. 1 if the
        head and a foot are not both tracked within the image, if there is no body index, and with
        ``segmentation="paper"``.
    offset : float, metres
        Distance of the limbs' pixels from their bones, sideways or behind; a mean over about two
        seconds. A large value indicates joints beside the person, caused for instance by a wrong
        principal point or unit of depth. Frames whose joints leap aside do not count; if the joints
        stay there, the mean starts anew. 0 if there is no body index.
    plane_deg : float, degrees
        Standard deviation of the plane of symmetry's normal. It includes the normal's deviation
        from the shoulders and hips beyond their errors (for instance if the chest twists above a
        missing leg). 0 with ``plane="joints"``.
    across : float, metres
        Uncertainty of the side on which the intact leg lies: the largest standard deviation of the
        distance from the plane among the leg's joints that are beyond the plane or within two
        standard deviations of it. 0 if there is no such joint, and for arms.
    leap : float, metres
        Excess of the movement of the phantom's end over that of the intact limb's end since the
        last frame.
    gap : float, metres
        Distance from the root of the limb to the largest connected piece of the phantom.
    largest : float
        Share of the phantom's pixels in that piece.
    lost : float
        Share of the person's pixels that are empty in the result. For legs the pixels below the
        hips are counted, for arms those where the camera should see the trunk.
    left : float
        Share of the affected limb's pixels that still show the body. Counted are pixels farther
        than 10 cm from the limb's root and not behind the phantom, as a chair is.
    cloth : float
        Number of body pixels that may be an empty sleeve or trouser leg, divided by the number of
        pixels of the intact limb. Symmetry cannot decide about these pixels, because the intact
        limb hides their mirrored places from the camera. Above 0.05 the state is not ``tracking``.
        0 if the affected limb itself is seen, with ``keep_residual``, and without a true
        reflection. Cloth is missed if something else hides its mirrored place and, for an arm,
        within 16 cm of the plane of symmetry.
    stray : float
        Number of body pixels above the hips that lie more than 8 cm from the skin of the nearest
        bone, divided by that of the intact limb: an arm at which the tracker has no joints. Where
        the nearest bone is not an arm's, the limit is 15 cm, and only pixels more than 20 cm from
        the plane of symmetry count. Above 0.2 the state is not ``tracking``. 0 for legs.
    outside : float
        Share of the mirrored points that lie outside the image, as of a patient at its border.
        Points behind the body do not count. Above 0.5 the state is not ``tracking``.
    score : float
        Largest ratio of these measures to their limits; above 1 the state is not ``tracking``.
    """

    fit: float
    hidden: float
    stature: float
    offset: float
    plane_deg: float
    across: float
    leap: float
    gap: float
    largest: float
    lost: float
    left: float
    cloth: float
    stray: float
    outside: float
    score: float


@dataclass(frozen=True, eq=False)
class BodyPlane:
    """The plane of symmetry at which a limb was mirrored.

    Attributes
    ----------
    origin : (3,) float64, metres
        A point of the plane, in the trunk.
    normal : (3,) float64
        Unit normal, towards the person's left.
    """

    origin: NDArray[np.float64]
    normal: NDArray[np.float64]

    __repr__ = short_repr

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Reflect points (..., 3)."""
        off = product(points - self.origin, self.normal)
        return np.asarray(points - 2.0 * off[..., None] * self.normal)


@dataclass(frozen=True, eq=False)
class PhantomFrame:
    """The key person with a phantom limb.

    Attributes
    ----------
    depth : (H, W) float32
        Depth of person and phantom in metres; 0 elsewhere.
    labels : (H, W) uint8
        Bone of each pixel, 1 to 24, numbered by its far joint; 0: none. A remaining part of the
        affected limb has the number of that limb's first bone, the phantom those of all its bones.
    kinds : (H, W) uint8
        `PixelKind` of each pixel.
    source : (H, W, 2) int32
        Row and column of the depth pixel whose texture is shown; -1: none.
    vertices : (n, 3) float32
        Positions in metres: one vertex for each pixel of person and phantom, in row-major order,
        then ``n - num_points`` duplicates with the phantom's texture, where body and phantom meet.
    pixels : (n, 2) int32
        Column and row of each vertex.
    texcoords : (n, 2) float32
        Texture coordinates in the colour image, v up; NaN for points that the colour camera does
        not see.
    faces : (m, 3) int32
        Triangles, whose front faces the camera.
    num_points : int
        Number of pixels of person and phantom.
    skeleton : Skeleton
        Smoothed skeleton of the key person, with the phantom's joints.
    state : PhantomState
    reason : PhantomReason
    opacity : float
        Opacity to draw the phantom with; less than 1 while it fades.
    visible : float
        Share of the intact limb, by length, that the camera sees.
    quality : PhantomQuality
    plane : BodyPlane or None
        The plane of symmetry; None until it is known for the first time.
    down : (3,) float64
        The vertical, downwards, as a unit vector in the camera's frame (x right, y down, z ahead);
        (0, 1, 0) for a level camera.
    down_source : DownSource
        Evidence for ``down``; ``assumed`` until it is known.
    texture_number : int
        `RgbdFrame.number` of the frame with the phantom's colours; while the phantom is held, this
        is an older frame.
    num_person, num_removed, num_mirrored, num_away, num_filled : int
        Numbers of pixels: of the person, removed, mirrored, mirrored with a surface that then faces
        away from the camera, and filled as holes.
    late_frames : int
        Number of frames that were older than the previous one, or had the same time and no later
        number. At most ten in a row are skipped.
    color : (H', W', 3) uint8 or None
        Colour image of this frame, for the body.
    phantom_color : (H', W', 3) uint8 or None
        Colour image of frame ``texture_number``, for the phantom.
    seconds : dict of str to float
        Wall time of each stage, in the order of table 4.1.
    """

    depth: NDArray[np.float32] = field(repr=False)
    labels: NDArray[np.uint8] = field(repr=False)
    kinds: NDArray[np.uint8] = field(repr=False)
    source: NDArray[np.int32] = field(repr=False)
    vertices: NDArray[np.float32] = field(repr=False)
    pixels: NDArray[np.int32] = field(repr=False)
    texcoords: NDArray[np.float32] = field(repr=False)
    faces: NDArray[np.int32] = field(repr=False)
    num_points: int
    skeleton: Skeleton = field(repr=False)
    state: PhantomState
    reason: PhantomReason
    opacity: float
    visible: float
    quality: PhantomQuality
    plane: BodyPlane | None
    down: NDArray[np.float64]
    down_source: DownSource
    texture_number: int
    num_person: int
    num_removed: int
    num_mirrored: int
    num_away: int
    num_filled: int
    late_frames: int
    seconds: dict[str, float] = field(repr=False)
    color: NDArray[np.uint8] | None = field(default=None, repr=False)
    phantom_color: NDArray[np.uint8] | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        vertices = counted(len(self.vertices), "vertex", "vertices")
        faces = counted(len(self.faces), "face")
        return f"<manip3d.modify.PhantomFrame: {self.state}; {vertices}, {faces}>"

    @property
    def phantom(self) -> NDArray[np.bool_]:
        """(H, W) bool: pixels that show the phantom."""
        return self.kinds >= PixelKind.PHANTOM

    @property
    def message(self) -> str:
        """`reason` as a sentence for the operator."""
        return self.reason.message

    @property
    def phantom_faces(self) -> NDArray[np.bool_]:
        """(m,) bool: triangles that show the phantom, with its texture and opacity."""
        column, row = self.pixels.T
        is_phantom = self.phantom[row, column]
        is_phantom[self.num_points :] = True  # duplicated vertices have the phantom's texture
        return np.asarray(is_phantom[self.faces].any(axis=1))

    def levelled(self, down: ArrayLike | None = None) -> PhantomFrame:
        """Return the frame in level axes: y down along the vertical, the camera at the origin.

        Vertices, skeleton, plane and ``down`` are rotated; z is then the horizontal part of the
        optical axis. Images and pixels stay those of the camera.

        Parameters
        ----------
        down : (3,) array_like, optional
            The vertical in the camera's frame; default: that of the frame.

        Returns
        -------
        PhantomFrame

        Raises
        ------
        InputError
            ``down`` is not three finite numbers, is 0, or is parallel to the optical axis.
        """
        rotation = level_rotation(self.down if down is None else down)
        plane = self.plane
        if plane is not None:
            plane = BodyPlane(product(rotation, plane.origin), product(rotation, plane.normal))
        return replace(
            self,
            vertices=product(self.vertices, rotation.T).astype(np.float32),
            skeleton=turned_skeleton(self.skeleton, rotation),
            plane=plane,
            down=product(rotation, self.down),
        )

    def parts(self) -> tuple[DepthMesh, DepthMesh]:
        """Return body and phantom as two meshes with the same vertices, each with its colour image.

        Draw the body opaque and the phantom with ``opacity``. While the phantom is held, its
        texture is that of the frame in which the intact limb was last seen.
        """
        from manip3d.simplify import DepthMesh

        chosen = self.phantom_faces
        body, phantom = (
            DepthMesh(self.vertices, self.faces[which], self.pixels, self.texcoords, color)
            for which, color in ((~chosen, self.color), (chosen, self.phantom_color))
        )
        return body, phantom

    def mesh(self, color: NDArray[np.uint8] | None = None) -> DepthMesh:
        """Return body and phantom as one textured `manip3d.simplify.DepthMesh`.

        One mesh has only one texture. While the phantom is held, body and phantom need different
        textures: use `parts`.

        Parameters
        ----------
        color : (H, W, 3) uint8, optional
            Texture. Default: the colour image of the processed frame, if it had one.

        Returns
        -------
        DepthMesh
        """
        from manip3d.simplify import DepthMesh

        texture = self.color if color is None else color
        return DepthMesh(self.vertices, self.faces, self.pixels, self.texcoords, texture)


@dataclass(frozen=True, eq=False)
class _Buffers:
    """Arrays that the core writes the results of a frame into."""

    depth: NDArray[np.float32]
    labels: NDArray[np.uint8]
    kinds: NDArray[np.uint8]
    source: NDArray[np.int32]
    vertices: NDArray[np.float32]
    pixels: NDArray[np.int32]
    texcoords: NDArray[np.float32]
    faces: NDArray[np.int32]

    @staticmethod
    def of_size(rows: int, cols: int, pool: _core.ArrayPool | None = None) -> _Buffers:
        """Take arrays from a pool, to which each returns when its last view is deleted."""
        empty = (pool or _core.ArrayPool()).empty
        capacity = rows * cols  # unused pages take no memory, because nothing writes to them
        return _Buffers(
            empty((rows, cols), np.float32),
            empty((rows, cols), np.uint8),
            empty((rows, cols), np.uint8),
            empty((rows, cols, 2), np.int32),
            empty((capacity, 3), np.float32),
            empty((capacity, 2), np.int32),
            empty((capacity, 2), np.float32),
            empty((2 * capacity, 3), np.int32),
        )


def _limb(limb: Limb) -> _core.Limb:
    return _core.Limb.__members__[limb.upper()]


def _plane_rule(plane: PlaneRule | None, smooths: bool) -> _core.PlaneRule:
    name = plane or ("trunk" if smooths else "joints")
    return _core.PlaneRule.__members__[name.upper()]


def _bone_rule(segmentation: Segmentation) -> _core.BoneRule:
    return _core.BoneRule.__members__[segmentation.upper()]


def _mask(near: float, far: float, margin: float) -> _core.PersonMaskOptions:
    mask = _core.PersonMaskOptions()
    mask.near, mask.far, mask.margin = near, far, margin
    return mask


@checked
class PhantomPipeline:
    """Mirror a person's intact limb onto the missing one, frame by frame.

    The steps are those of the dissertation's sections 4.3.1 and 4.7: mask of the key person,
    smoothed joints, segmentation, removal of the affected limb, mirroring of the intact one, hole
    filling, phantom skeleton, points and textured mesh.

    While the intact limb cannot be mirrored, the last phantom moves with the body for
    ``hold_seconds`` and then fades within ``fade_seconds``. The limb cannot be mirrored if less
    than ``least_visible`` of it is seen, if the skeleton is missing, or if a joint beyond the
    limb's root is inferred for more than ``inferred_seconds`` on a stump or at a place where the
    depth image does not show the limb. A frame that is not newer than the last one is counted and
    skipped, unless it is more than a second older: then a new recording begins. If all times are 0,
    frames count as 30 a second. A frame whose phantom is implausible is ``degraded``: see
    `PhantomQuality`.

    Trackers invent joints of a missing limb. Until the person has shown the affected limb, two
    kinds of its joints count as not tracked (``segmentation="skin"``): joints at which the depth
    image shows something farther away, and those at the ends of bones longer by more than 5 cm than
    1.5 times the intact limb's.

    The camera may be tilted in any direction. Beyond 45 degrees the floor is not recognised: frames
    without a body index then show pieces of it, and rotating their images by quarter turns helps.

    A seated person's thighs may be turned relative to the trunk by ten degrees or more. If the
    person has the affected leg, this angle is measured from both legs, averaged over 3 seconds, and
    ``plane`` of the result is the legs' plane; if the leg is missing, the angle is unknown. Empty
    pixels beside the phantom that showed it in the previous frame are filled, so that its border
    does not flicker.

    Parameters
    ----------
    affected : {"left_arm", "right_arm", "left_leg", "right_leg"}
        The limb to replace; left is the person's own left.
    mode : {"reflection", "paper", "2d"}
        ``reflection``: reflect at the person's plane of symmetry; ``paper``: as printed (oblique if
        shoulders or hips tilt against the spine); ``2d``: left to right in the image, for
        comparison.
    plane : {"trunk", "joints"}, optional
        Source of the plane of symmetry for ``reflection``. ``trunk``: surface and joints of the
        trunk, tracked from frame to frame; ``joints``: four joints of each frame alone, as in the
        dissertation. Default: ``trunk``, but ``joints`` without smoothing. Modes other than
        ``reflection`` use the joints.
    smoothing : {"default", "seated"} or None
        Preset of `JointSmoother`; None: joints are not smoothed.
    segmentation : {"skin", "paper"}
        Same as for `segment_body`.
    arm_radius, leg_radius : float, metres
        Points within this distance of a limb's bones belong to the limb.
    root_radius : float, metres
        Radius around the shoulder or hip within which the second filling mirrors the intact side
        (in the dissertation, for legs only); 0: no second filling.
    keep_residual : bool
        Keep the remaining part of the affected limb instead of removing it.
    near, far, margin : float, metres
        ``near`` and ``far`` bound the depth. If there is no body index, the person's pixels are
        those within ``margin`` of the depths of its joints, near the skin of its bones and above
        the floor, if the floor is seen (with ``segmentation="paper"``, only the depths count).
    least_visible : float
        Smallest visible share of the intact limb, by length, at which it is mirrored.
    inferred_seconds, hold_seconds, fade_seconds : float, seconds
        Times used if the limb cannot be mirrored, see above; 0 to 3600.
    max_depth_step : float, metres
        Triangles whose corners differ more in depth are left out.
    texturing : {"source", "calibration"}
        ``source``: texture of the pixel that was mirrored; ``calibration``: texture at the
        projection of the phantom's own points into the colour camera, which is wrong (figure 4.4).

    Raises
    ------
    InputError
        An option is out of range.
    """

    def __init__(
        self,
        affected: Limb = "right_arm",
        *,
        mode: MirrorMode = "reflection",
        plane: PlaneRule | None = None,
        smoothing: Preset | None = "default",
        segmentation: Segmentation = "skin",
        arm_radius: float = 0.13,
        leg_radius: float = 0.18,
        root_radius: float = 0.20,
        keep_residual: bool = False,
        near: float = 0.3,
        far: float = 8.0,
        margin: float = 0.35,
        least_visible: float = 0.5,
        inferred_seconds: float = 0.2,
        hold_seconds: float = 0.5,
        fade_seconds: float = 0.5,
        max_depth_step: float = 0.05,
        texturing: Texturing = "source",
    ) -> None:
        self._affected, self._mode = affected, mode
        options = _core.PhantomOptions()
        options.affected = _limb(affected)
        options.mode = _MODES[mode]
        options.smooths = smoothing is not None
        options.plane = _plane_rule(plane, options.smooths)
        if smoothing is not None:
            options.smoothing = smoother_options(smoothing)
        options.mask = _mask(near, far, margin)
        options.segmentation = _bone_rule(segmentation)
        options.arm_radius, options.leg_radius = arm_radius, leg_radius
        options.root_radius = root_radius
        options.keep_residual = bool(keep_residual)
        options.least_visible = least_visible
        options.inferred_seconds = inferred_seconds
        options.hold_seconds, options.fade_seconds = hold_seconds, fade_seconds
        options.mesh = _core.PhantomMeshOptions()
        options.mesh.max_depth_step = max_depth_step
        options.mesh.texturing = _core.Texturing.__members__[texturing.upper()]
        self._core = _core.PhantomPipeline(options)
        self._pool = _core.ArrayPool()
        self._last: PhantomFrame | None = None
        self._phantom_color: NDArray[np.uint8] | None = None
        self._camera: Intrinsics | None = None  # the one that the core knows
        self._newest: Intrinsics | None = None  # an equal one of the last frame
        self._lock = threading.RLock()

    def __repr__(self) -> str:
        return f"<manip3d.modify.PhantomPipeline: {self._affected}, {self._mode}>"

    def process(self, frame: RgbdFrame) -> PhantomFrame:
        """Process the next frame.

        Parameters
        ----------
        frame : RgbdFrame
            The next frame; a phantom needs skeletons. Frames with equal times and growing numbers
            count as a thirtieth of a second apart or less.

        Returns
        -------
        PhantomFrame
            The result, whose arrays later frames do not overwrite.

        Raises
        ------
        InputError
            Depth or colour does not have the size given by the calibration, or a calibration is out
            of range. Later frames can be processed.
        """
        rows, cols = frame.depth.shape
        buffers = _Buffers.of_size(rows, cols, self._pool)
        calibration = frame.calibration
        depth = np.ascontiguousarray(frame.depth)
        body_index = None if frame.body_index is None else np.ascontiguousarray(frame.body_index)
        color = None if frame.color is None else np.ascontiguousarray(frame.color)
        with self._lock:
            report = self._core.process(
                depth,
                body_index,
                self._known(calibration.depth),
                calibration.registration,
                color,
                frame.skeletons,
                frame.time_ns,
                frame.number,
                buffers,
            )
            if report["state"] == _core.PhantomState.LATE and self._last is not None:
                late = report["late_frames"]
                return replace(
                    self._last,
                    state=PhantomState.LATE,
                    reason=PhantomReason.LATE,
                    late_frames=late,
                )
            if report["state"] in (_core.PhantomState.TRACKING, _core.PhantomState.DEGRADED):
                self._phantom_color = frame.color
            self._last = replace(
                _frame(report, buffers), color=frame.color, phantom_color=self._phantom_color
            )
            return self._last

    def _known(self, camera: Intrinsics) -> Intrinsics:
        """Return the camera that the core knows if the frame's is equal.

        The core compares ray tables by address, and begins anew with another camera.
        """
        if camera is not self._newest:
            if self._camera is None or not same_camera(camera, self._camera):
                self._camera = camera
            self._newest = camera
        assert self._camera is not None
        return self._camera

    def select(self, person: int) -> Self:
        """Make the person with this `Skeleton.id` the patient as soon as the id is in view.

        Until then the current patient is kept. If no person is selected, the pipeline chooses the
        patient by the rules of `KeyPerson`.

        Parameters
        ----------
        person : int
            `Skeleton.id` of the patient.

        Returns
        -------
        PhantomPipeline
            Itself.
        """
        with self._lock:
            self._core.select(int(person))
        return self

    def reset(self) -> Self:
        """Discard all frames, for another person or another recording."""
        with self._lock:
            self._core.reset()
            self._last = self._phantom_color = None
        return self


def _frame(report: dict[str, Any], buffers: _Buffers) -> PhantomFrame:
    vertices, faces = report.pop("num_vertices"), report.pop("num_faces")
    plane = report.pop("plane")
    return PhantomFrame(
        depth=buffers.depth,
        labels=buffers.labels,
        kinds=buffers.kinds,
        source=buffers.source,
        vertices=buffers.vertices[:vertices],
        pixels=buffers.pixels[:vertices],
        texcoords=buffers.texcoords[:vertices],
        faces=buffers.faces[:faces],
        skeleton=Skeleton(**report.pop("skeleton")),
        state=PhantomState(report.pop("state").name.lower()),
        reason=PhantomReason(report.pop("reason").name.lower()),
        quality=PhantomQuality(**report.pop("quality")),
        plane=None if plane is None else BodyPlane(**plane),
        down_source=DownSource(report.pop("down_source").name.lower()),
        **report,
    )


@dataclass(frozen=True, eq=False)
class BodyMirror:
    """Affine map from one side of a person to the other, p -> ``linear`` p + ``offset``.

    Attributes
    ----------
    linear : (3, 3) float64
        Linear part, which is its own inverse.
    offset : (3,) float64, metres
        Translation.
    normal : (3,) float64
        Normal n = y_s x z_s, towards the person's left.
    origin : (3,) float64, metres
        A point of the plane: SpineMid for arms, SpineBase for legs.
    skeleton : Skeleton
        The person's skeleton with the mirrored joints of the intact limb in place of the affected
        limb's.
    """

    linear: NDArray[np.float64]
    offset: NDArray[np.float64]
    normal: NDArray[np.float64]
    origin: NDArray[np.float64]
    skeleton: Skeleton

    __repr__ = short_repr

    def __call__(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mirror points (..., 3)."""
        return product(points, self.linear.T) + self.offset


@checked
def body_mirror(
    skeleton: Skeleton, affected: Limb, *, mode: MirrorMode = "reflection"
) -> BodyMirror | None:
    """Compute the mirror map of `PhantomPipeline` from one skeleton, without filtering over time.

    Parameters
    ----------
    skeleton : Skeleton
        The person's skeleton from the tracker.
    affected : 'left_arm', 'right_arm', 'left_leg' or 'right_leg'
        The missing limb, which the mirrored limb of the other side replaces.
    mode : 'reflection', 'paper' or '2d'
        Kind of the map, see `Notes`.

    Returns
    -------
    BodyMirror or None
        None if the axes of the body (eq. 4.2 for arms, 4.8 for legs) are undefined, because a joint
        is missing or the axes are nearly parallel.

    Raises
    ------
    InputError
        An unknown limb or mode.

    Notes
    -----
    ``reflection``: linear = I - 2 n n^T. ``paper``: eq. 4.3 to 4.7, M^-1 diag(-1, 1, 1) M, where
    x_s, y_s and z_s are the rows of M; equal to the reflection if x_s is perpendicular to y_s.
    ``2d``: u' = 2 u_s - u at constant depth, where u_s is the column of the axis.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import modify
    >>> sides = [(20, 45), (25, 15), (28, -10), (12, 0), (13, -45), (14, -90)]  # centimetres
    >>> rows = [(0, 70), (3, 73), (-3, 73), (7, 70), (-7, 70)]  # nose, eyes, ears; then
    >>> rows += [(side * x, y) for x, y in sides for side in (1, -1)]
    >>> joints = np.array([(x, -y, 200) for x, y in rows]) / 100  # 2 m before the camera
    >>> person = modify.skeleton_from(joints, layout="coco")
    >>> mirror = modify.body_mirror(person, "left_arm")
    >>> np.round(mirror.normal, 2).tolist()
    [1.0, 0.0, 0.0]
    >>> right, left = person.positions[[10, 6]]  # wrists
    >>> np.round(mirror.linear @ right + mirror.offset - left, 2).tolist()
    [0.0, 0.0, 0.0]
    """
    fields = _core.body_mirror(skeleton, _limb(affected), _MODES[mode])
    if fields is None:
        return None
    return BodyMirror(**fields | {"skeleton": Skeleton(**fields["skeleton"])})


@dataclass(frozen=True, eq=False)
class BodySegmentation:
    """Bone of each pixel of a person.

    Attributes
    ----------
    labels : (H, W) uint8
        Bone of each pixel, 1 to 24, numbered by its far joint (`manip3d.rgbd.PARENTS`); 0: not the
        person.
    distances : (H, W) float32, metres
        Distance of the pixel's point to the axis of that bone (for the trunk, to the nearer of its
        two rods); infinite for pixels without a bone.
    """

    labels: NDArray[np.uint8]
    distances: NDArray[np.float32]

    __repr__ = short_repr


@checked
def segment_body(
    depth: NDArray[np.uint16 | np.float32],
    intrinsics: Intrinsics,
    skeleton: Skeleton,
    *,
    segmentation: Segmentation | Literal["region"] = "skin",
    body_index: NDArray[np.uint8] | None = None,
    near: float = 0.3,
    far: float = 8.0,
    margin: float = 0.35,
    seeds: Literal["line", "middle"] = "line",
    reach: float = 0.1,
) -> BodySegmentation:
    """Segment a person: assign each pixel to its nearest bone.

    Parameters
    ----------
    depth : (H, W) uint16 in millimetres or float32 in metres
    intrinsics : Intrinsics
    skeleton : Skeleton
        Bones whose joints are both tracked or inferred are used. If two bones are equally near, the
        lower number wins; a bone of length 0 is a point.
    segmentation : {"skin", "paper", "region"}
        ``skin``: the bone whose skin is nearest, that is, the distance to the bone's axis less the
        thickness of the flesh around it; ``paper``: the bone whose axis is nearest, as printed
        (eq. 4.1), which treats the trunk as no thicker than an arm; ``region``: labels grow from
        the pixels under the bones and stop at depth steps (section 5.1.1).
    body_index : (H, W) uint8, optional
        Same as for `RgbdFrame`.
    near, far, margin : float, metres
        Same as for `PhantomPipeline`.
    seeds : {"line", "middle"}
        For ``region`` only: a label starts from all pixels under a bone, or from the pixel under
        its middle (figure 5.4).
    reach : float, metres
        For ``region`` only: pixels beyond a contour count up to this distance from the bone's skin.

    Returns
    -------
    BodySegmentation
        Bone of each pixel, and the pixel's distance to it.

    Raises
    ------
    InputError
        A wrong shape or dtype, or an option out of range.

    Notes
    -----
    ``skin``: thicknesses come from girths, breadths and depths of the mean adult [Gordon et al.,
    "2012 Anthropometric Survey of U.S. Army Personnel", Natick/TR-15/007], scaled by the lengths of
    the person's own arms and legs. The trunk, broader than deep, is a pair of rods from hips to
    chest. Distances to skins are compared in units of their standard deviation, which combines the
    spread of girths among people (a tenth) and the error of joints (1 cm); beyond three standard
    deviations they are compared in metres.

    ``region``: of all pixels that a label may spread to, the one nearest to its bone's skin is
    taken first, so that the result does not depend on the order of the pixels. A depth step is a
    change of depth above z / f tan 78 degrees plus three standard deviations of a Kinect's noise;
    labels spread over steps last. Pixels that no label reaches are not the person.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, modify
    >>> sides = [(20, 45), (25, 15), (28, -10), (12, 0), (13, -45), (14, -90)]  # centimetres
    >>> rows = [(0, 70), (3, 73), (-3, 73), (7, 70), (-7, 70)]  # nose, eyes, ears; then
    >>> rows += [(side * x, y) for x, y in sides for side in (1, -1)]
    >>> joints = np.array([(x, -y, 200) for x, y in rows]) / 100  # 2 m before the camera
    >>> person = modify.skeleton_from(joints, layout="coco")
    >>> camera = Intrinsics(fx=100, fy=100, cx=79.5, cy=99.5, width=160, height=200)
    >>> depth = np.zeros((200, 160), np.uint16)
    >>> depth[60:150, 65:95] = 2000  # millimetres
    >>> found = modify.segment_body(depth, camera, person)
    >>> int((found.labels > 0).sum()), int((depth > 0).sum())
    (2700, 2700)
    >>> int(found.labels[130, 73]), int(found.labels[130, 86])  # shins: bones end at the ankles
    (18, 14)
    """
    image = np.ascontiguousarray(as_array(depth, "depth"))
    index = None if body_index is None else np.ascontiguousarray(body_index)
    if index is not None and (index.shape != image.shape or index.dtype != np.uint8):
        raise InputError(
            f"body_index: expected uint8 of shape {image.shape}, got {index.dtype} {index.shape}"
        )
    mask = _mask(near, far, margin)
    if segmentation == "region":
        options = _core.RegionOptions()
        options.line_seeds, options.reach = seeds == "line", reach
        labels, distances = _core.segment_region(image, index, intrinsics, skeleton, mask, options)
    else:
        rule = _bone_rule(segmentation)
        labels, distances = _core.segment_person(image, index, intrinsics, skeleton, mask, rule)
    return BodySegmentation(labels.reshape(image.shape), distances.reshape(image.shape))
