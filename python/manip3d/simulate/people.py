"""A simulated person before a simulated Kinect V2, with ground truth.

The person is a textured surface on 25 joints and does an exercise in a room. `BodySimulator` gives
the images of the sensor and the skeletons of its body tracker, with ground truth: exact depth, the
bone of each pixel, the joints, and the whole body of a person with a missing limb. Ray casting uses
code for the CPU, so that frames of different machines differ by a millimetre at a few pixels; on
one machine they only depend on the options and the time.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TypeAlias, overload

import numpy as np
from numpy.typing import NDArray

from manip3d._util.arrays import read_only
from manip3d._util.checked import checked
from manip3d._util.indexing import indexed
from manip3d._util.linear import product
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.camera import CAMERA_PRESETS, Intrinsics, Registration
from manip3d.errors import InputError
from manip3d.mesh import Mesh
from manip3d.modify import Limb
from manip3d.rgbd import (
    INFERRED,
    NO_BODY,
    PARENTS,
    TRACKED,
    RgbdCalibration,
    RgbdFrame,
    Skeleton,
)
from manip3d.simulate._clothes import SIDE, Clothes, paint
from manip3d.simulate._figure import (
    LIMBS,
    REST_JOINTS,
    PosedFigure,
    about,
    opposite,
    pose_figure,
    turned_figure,
)
from manip3d.simulate._motions import MOTIONS, PERIOD, clear_of_trunk, pose_at, walk
from manip3d.simulate._raycast import CHUNK, RayCaster
from manip3d.simulate._scenery import CHAIRS, SCENES, Box, Scenery, box_mesh, furnish
from manip3d.simulate._skin import DRESSINGS, TILES, Skin, build_skin
from manip3d.simulate._time_of_flight import MAX_DEPTH, measure

__all__ = [
    "DEPTH_CAMERA",
    "FEET",
    "LIMBS",
    "BodyCapture",
    "BodySimulator",
    "BodyTruth",
    "cast_mesh",
    "opposite",
]

Floats = NDArray[np.float32]
Interval: TypeAlias = "tuple[float, float]"

DEPTH_CAMERA = CAMERA_PRESETS["kinect-v2"].cameras[0]
"""A Kinect V2's depth camera, with the principal point in the middle for symmetric images."""

COLOR_CAMERA = Registration(
    Intrinsics(1920, 1080, 1060.0, 1060.0, 959.5, 539.5), np.eye(3), np.array([0.052, 0.0, 0.0])
)
read_only(COLOR_CAMERA.rotation)
read_only(COLOR_CAMERA.translation)
"""A Kinect V2's colour camera, 52 mm beside the depth camera."""

FEET = 0.3048
"""One foot, metres."""

NO_BONE = 255
"""Label of pixels without the person."""

CAMERA_HEIGHT = 0.95
"""Height of the camera above the floor, metres."""

_VISITOR = Clothes(shirt=(150, 62, 58), trousers=(96, 88, 70), hair=(120, 96, 60))
_SWAY_PERIOD, _BREATH_PERIOD = 2.0, 4.0  # seconds
_FLIGHT = 0.35  # metres: standard deviation of the flying joints of a missing limb
# Correlated jitter depends on as many frames before as have a weight of 0.001 or more, and at least
# on 64: those of the usual correlation of 0.9.
_MEMORY, _USUAL, _MAX_CORRELATION = 64, 0.9, 0.99
# Estimated orders of magnitude, not measured on a device.
_TRACKERS: dict[str, dict[str, float]] = {
    "kinect-v1": {"jitter": 0.010, "correlation": 0.8, "bias": 0.020},
    "kinect-v2": {"jitter": 0.006, "correlation": 0.6, "bias": 0.015},
}
_HIDDEN = 0.18  # metres: largest depth of a joint behind the body's surface that is still seen
_EYES = np.zeros(3, np.float32)


def _check_limb(limb: object, name: str) -> None:
    if not isinstance(limb, str) or limb not in LIMBS:
        raise InputError(f"{name}: expected one of {', '.join(LIMBS)}, got {limb!r}")


@dataclass(frozen=True, eq=False)
class BodyTruth:
    """Ground truth of a simulated frame.

    Attributes
    ----------
    depth : (H, W) float32, metres
        Depth without noise; 0: beyond the range of the sensor.
    bones : (H, W) uint8
        Number of the bone of each pixel of the person; `NO_BONE` elsewhere. Limbs are divided at
        their joints, the trunk by the nearest bone at rest.
    people : (H, W) uint8
        0: the person, 1: the visitor, `NO_BODY` elsewhere.
    flying : (H, W) bool
        Pixels of the frame whose depth lies between two surfaces.
    joints : (25, 3) float64, metres
        All joints, including those of a missing limb.
    lateral : (2, 3) float64
        Unit vectors to the person's left, of pelvis and chest.
    """

    depth: Floats
    bones: NDArray[np.uint8]
    people: NDArray[np.uint8]
    flying: NDArray[np.bool_]
    joints: NDArray[np.float64]
    lateral: NDArray[np.float64]
    _figure: PosedFigure = field(repr=False)
    _skin: Skin = field(repr=False)

    __repr__ = short_repr

    def body(self) -> Mesh:
        """Return the surface of the whole person, with all limbs."""
        skin = self._skin
        return Mesh(skin.vertices(self._figure).astype(np.float64), skin.faces)

    def limb(self, name: Limb) -> Mesh:
        """Return one limb of the whole person, from inside the trunk to its end.

        Parameters
        ----------
        name : 'left_arm', 'right_arm', 'left_leg' or 'right_leg'
            Name of the limb.

        Returns
        -------
        Mesh

        Raises
        ------
        InputError
            There is no such limb.
        """
        _check_limb(name, "name")
        skin = self._skin
        faces = skin.faces[skin.face_limb == list(LIMBS).index(name)]
        used, index = np.unique(faces, return_inverse=True)
        vertices = skin.vertices(self._figure)[used].astype(np.float64)
        return Mesh(vertices, index.reshape(-1, 3).astype(np.int32))

    def mirror_plane(self, limb: Limb) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a point and the unit normal, to the person's left, of the plane of symmetry.

        For arms it is the plane of the chest, through the middle of the spine; for legs that of the
        pelvis, through the base of the spine.

        Parameters
        ----------
        limb : 'left_arm', 'right_arm', 'left_leg' or 'right_leg'
            Name of the limb.

        Returns
        -------
        point, normal : (3,) float64

        Raises
        ------
        InputError
            There is no such limb.
        """
        _check_limb(limb, "limb")
        is_arm = limb.endswith("arm")
        return self.joints[1 if is_arm else 0], self.lateral[1 if is_arm else 0]

    def phantom(self, limb: Limb) -> Mesh:
        """Return the true phantom of a limb: the limb of the other side, reflected.

        Parameters
        ----------
        limb : 'left_arm', 'right_arm', 'left_leg' or 'right_leg'
            Name of the limb.

        Returns
        -------
        Mesh

        Raises
        ------
        InputError
            There is no such limb.
        """
        _check_limb(limb, "limb")
        mesh = self.limb(opposite(limb))  # type: ignore[arg-type]
        origin, normal = self.mirror_plane(limb)
        off = product(mesh.vertices - origin, normal)
        return Mesh(mesh.vertices - 2.0 * off[:, None] * normal, mesh.faces[:, ::-1].copy())


@dataclass(frozen=True, eq=False)
class BodyCapture:
    """A frame with its ground truth.

    Attributes
    ----------
    frame : RgbdFrame
        Frame of the simulated sensor.
    truth : BodyTruth
        Ground truth of the frame.
    """

    frame: RgbdFrame
    truth: BodyTruth

    __repr__ = short_repr


@checked
@dataclass(frozen=True, kw_only=True)
class BodySimulator:
    """A person who exercises before a Kinect V2; iteration yields the frames.

    Attributes
    ----------
    motion : str
        ``still``, ``arm-raise``, ``arm-curl``, ``reach``, ``wave``, ``elbow-bent``,
        ``knee-extension``, ``dorsiflexion`` or ``stepping``.
    side : str
        Side whose limbs move: ``left``, ``right`` or ``both``; default: the intact side if a limb
        is missing, else both.
    amputated : str, optional
        Missing limb: ``left_arm``, ``right_arm``, ``left_leg`` or ``right_leg``.
    stump : float, metres
        Length of the rest of the limb, from the shoulder or the hip.
    dressing : str
        Dressing of the stump: ``bare`` (only shirt or trousers), ``bandage``, or ``sleeve`` for an
        empty sleeve or trouser leg, which hangs down. With ``sleeve``, the stump must end above the
        elbow (0.265 m) or the knee (0.4 m).
    girth : float
        Factor on the thickness of trunk, arms and legs. Above 1.2, arms hang farther from the
        trunk.
    sitting : bool, optional
        Whether the person sits; default: for ``knee-extension``, ``dorsiflexion`` and in a
        wheelchair.
    chair : str
        Seat of a sitting person: ``chair`` or ``wheelchair``.
    distance : float, metres
        Distance from the camera to the base of the spine, along the optical axis.
    tilt, roll : float, degrees
        Rotation of the camera about the point of its optical axis at ``distance``. With a positive
        ``tilt`` the camera is higher and looks down at the person; with a positive ``roll`` the
        person is turned clockwise in the image.
    turn, turning : float, degrees; degrees per second
        Rotation of the whole body to the person's left at time 0, and its angular velocity.
    sway : float, degrees
        Amplitude of a rotation of the whole body to and fro, with a period of two seconds.
    twist : float, degrees
        Amplitude of a rotation of the chest relative to the pelvis, with a period of four seconds;
        first to the person's left, or to the right if negative.
    breath : float, metres
        Extent of the forward motion of the chest by breathing, with a period of four seconds; 0.005
        is typical at rest.
    shoulder_tilt : float, degrees
        Tilt of the shoulders relative to the chest; positive: the left shoulder is higher.
    thigh_turn : float, degrees
        Rotation of a sitting person's legs relative to the pelvis, to the person's left.
    stripes : bool
        Whether the shirt has stripes.
    cover : str
        Feet with a blue shoe cover: ``none``, ``left``, ``right`` or ``both``.
    visitor : float, optional
        Time, seconds, at which another person enters from the left of the picture, behind the
        person.
    occluder : (float, float), optional
        Begin and end, seconds, of a board's presence before the intact limb (the left arm if no
        limb is missing).
    lost : (float, float), optional
        Begin and end, seconds, of a failure of the tracker: the person is visible but not
        recognised.
    swapped : (float, float), optional
        Begin and end, seconds, of a confusion of the tracker: person and visitor have exchanged
        ids.
    jitter : float, metres
        Standard deviation of each coordinate of tracked joints; five times as much for inferred
        ones.
    correlation : float
        Correlation of the jitter between successive frames, 0 (white noise) to 0.99.
    bias : float, metres
        Length of a constant error of each joint in the frame of its bone, because trackers have the
        same errors whenever they see the same pose.
    flying : bool
        Whether the tracker reports joints of a missing limb as tracked, with large errors.
    tracker : str
        ``kinect-v1`` or ``kinect-v2``: use jitter, correlation and bias of that tracker if they are
        0, and flying joints; empty: no tracker errors by default.
    noise : float
        Factor on the depth sensor's faults; 0: exact depth in whole millimetres.
    color : str
        ``depth``: colour at the depth image's pixels; ``full``: 1920 x 1080 pixels of a separate
        camera; ``none``.
    room : bool
        Whether there are floor, walls and furniture; otherwise nothing is behind the person.
    scene : str
        Scenery: ``room`` (bare), ``office`` (desk, cupboard, board) or ``hall`` (pillars, a bench,
        a wall farther away).
    rate : float
        Frames per second.
    frames : int
        Number of frames of an iteration.
    seed : int
        Seed of noise and jitter.
    threads : int
        Threads of the ray casting; 0: ``MANIP3D_THREADS``, else all cores. The frames do not depend
        on it.

    Raises
    ------
    InputError
        An option is unknown or out of range.
    MissingExtraError
        Open3D is not installed (at the first frame).

    Examples
    --------
    >>> from manip3d.simulate import BodySimulator
    >>> simulator = BodySimulator(motion="arm-raise", amputated="right_arm", frames=2)
    >>> for frame in simulator:  # doctest: +SKIP
    ...     print(frame.depth.shape, len(frame.skeletons))
    (424, 512) 1
    (424, 512) 1
    """

    motion: str = "arm-raise"
    side: str = ""
    amputated: str | None = None
    stump: float = 0.15
    dressing: str = "bare"
    girth: float = 1.0
    sitting: bool | None = None
    chair: str = "chair"
    distance: float = 8.0 * FEET
    tilt: float = 0.0
    roll: float = 0.0
    turn: float = 0.0
    turning: float = 0.0
    sway: float = 0.0
    twist: float = 0.0
    breath: float = 0.0
    shoulder_tilt: float = 0.0
    thigh_turn: float = 0.0
    stripes: bool = False
    cover: str = "none"
    visitor: float | None = None
    occluder: Interval | None = None
    lost: Interval | None = None
    swapped: Interval | None = None
    jitter: float = 0.0
    correlation: float = 0.0
    bias: float = 0.0
    flying: bool = False
    tracker: str = ""
    noise: float = 1.0
    color: str = "depth"
    room: bool = True
    scene: str = "room"
    rate: float = 30.0
    frames: int = 300
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        if self.amputated is not None:  # ``sim:`` addresses use hyphens
            object.__setattr__(self, "amputated", self.amputated.replace("-", "_"))
        self._check_choices()
        self._check_ranges()
        self._check_times()
        self._check_dressing()
        if self.chair == "wheelchair" and self.sitting is False:
            raise InputError("chair: expected chair with sitting=no, got 'wheelchair'")
        if self.tracker:  # its errors replace those that are not given
            object.__setattr__(self, "flying", True)
            for name, number in _TRACKERS[self.tracker].items():
                if not getattr(self, name):
                    object.__setattr__(self, name, number)

    def __repr__(self) -> str:
        without = f", without {self.amputated}" if self.amputated else ""
        frames = counted(self.frames, "frame")
        return f"<manip3d.simulate.BodySimulator: {self.motion}{without}, {frames}>"

    def _check_choices(self) -> None:
        for name, value, choices in (
            ("tracker", self.tracker, ["", *_TRACKERS]),
            ("motion", self.motion, list(MOTIONS)),
            ("side", self.side, ["", "left", "right", "both"]),
            ("amputated", self.amputated, [None, *LIMBS]),
            ("cover", self.cover, ["none", "left", "right", "both"]),
            ("color", self.color, ["depth", "full", "none"]),
            ("scene", self.scene, list(SCENES)),
            ("dressing", self.dressing, list(DRESSINGS)),
            ("chair", self.chair, list(CHAIRS)),
        ):
            if value not in choices:
                names = ", ".join(str(choice) for choice in choices if choice)
                raise InputError(f"{name}: expected one of {names}, got {value!r}")

    def _check_ranges(self) -> None:
        for name, low, high in (
            ("stump", 0.02, 0.6),
            ("girth", 0.6, 1.8),
            ("distance", 0.8, 4.5),
            ("jitter", 0.0, 1.0),
            ("correlation", 0.0, _MAX_CORRELATION),
            ("bias", 0.0, 1.0),
            ("sway", 0.0, 90.0),
            ("breath", 0.0, 0.05),
            ("noise", 0.0, 100.0),
            ("rate", 1.0, 1000.0),
            ("frames", 0, 1 << 31),
            ("tilt", -60.0, 60.0),
            ("roll", -60.0, 60.0),
            ("turn", -360.0, 360.0),
            ("twist", -60.0, 60.0),
            ("turning", -360.0, 360.0),
            ("shoulder_tilt", -30.0, 30.0),
            ("thigh_turn", -45.0, 45.0),
            ("seed", 0, 1 << 63),
        ):
            number = getattr(self, name)
            if not low <= number <= high:
                raise InputError(f"{name}: expected {low:g} to {high:g}, got {number!r}")
        lowest = -math.degrees(math.asin(min(1.0, CAMERA_HEIGHT / self.distance)))
        if self.room and not self.tilt > lowest:
            raise InputError(
                f"tilt: expected above {lowest:.1f}, so that the camera is above the floor, or "
                f"room=no, got {self.tilt!r}"
            )

    def _check_times(self) -> None:
        if self.visitor is not None and not self.visitor >= 0.0:
            raise InputError(f"visitor: expected seconds >= 0, got {self.visitor!r}")
        for name in ("occluder", "lost", "swapped"):
            interval = getattr(self, name)
            if interval is not None and not 0.0 <= interval[0] <= interval[1]:
                raise InputError(f"{name}: expected 0 <= begin <= end, seconds, got {interval!r}")

    def _check_dressing(self) -> None:
        if self.dressing != "bare" and self.amputated is None:
            raise InputError(f"dressing: expected bare without amputated, got {self.dressing!r}")
        if self.dressing == "sleeve" and self.amputated is not None:
            root, joint = LIMBS[self.amputated][:2]
            longest = float(np.linalg.norm(REST_JOINTS[joint] - REST_JOINTS[root]))
            if self.stump > longest:
                raise InputError(
                    "dressing: expected an empty sleeve with a stump that ends above the elbow or "
                    f"knee, at most {longest:.2f} m, got {self.stump:g} m"
                )

    @functools.cached_property
    def calibration(self) -> RgbdCalibration:
        """Calibration of the cameras."""
        return RgbdCalibration(DEPTH_CAMERA, COLOR_CAMERA if self.color == "full" else None)

    def __len__(self) -> int:
        return self.frames

    @overload
    def __getitem__(self, index: int) -> RgbdFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[RgbdFrame]: ...
    def __getitem__(self, index: int | slice) -> RgbdFrame | list[RgbdFrame]:
        return indexed(index, self.frames, lambda i: self.frame(i / self.rate), "frame")

    def __iter__(self) -> Iterator[RgbdFrame]:
        return (self[index] for index in range(self.frames))

    def frame(self, time: float) -> RgbdFrame:
        """Return the sensor's frame at a time.

        Parameters
        ----------
        time : float, seconds
            Time >= 0.

        Returns
        -------
        RgbdFrame
        """
        return self.capture(time).frame

    def capture(self, time: float) -> BodyCapture:
        """Return the sensor's frame at a time, and its ground truth.

        Parameters
        ----------
        time : float, seconds
            Time >= 0.

        Returns
        -------
        BodyCapture

        Raises
        ------
        InputError
            The time is negative or not finite.
        """
        nanoseconds = _nanoseconds(time)
        random = np.random.default_rng([self.seed, nanoseconds])
        cast = self._cast(time)
        view = cast.see(DEPTH_CAMERA, None, self._scenery, self.threads)
        measured = measure(view.depth, view.slant, self.noise, random)
        people = view.people
        lost = _within(self.lost, time)
        # Flying pixels far from the surface do not count as the person.
        away = measured.flying & (np.abs(measured.depth - view.depth) > 0.15)
        index = np.where(away, np.uint8(NO_BODY), people)
        if lost:
            index[people == 0] = NO_BODY
        frame = RgbdFrame(
            np.rint(measured.depth * 1000.0).astype(np.uint16),
            self.calibration,
            self._color(cast, view),
            index,
            self._skeletons(cast, view, time, random),
            time_ns=nanoseconds,
            number=round(time * self.rate),
        )
        figure = cast.figures[0]
        truth = BodyTruth(
            np.where(view.depth <= MAX_DEPTH, view.depth, np.float32(0.0)),
            np.where(people == 0, view.bones, np.uint8(NO_BONE)),
            people.copy(),
            measured.flying,
            figure.joints,
            figure.lateral,
            figure,
            _whole(self.girth),
        )
        return BodyCapture(frame, truth)

    def background(self, time: float) -> RgbdFrame:
        """Return the sensor's frame of the scene without people at a time.

        Parameters
        ----------
        time : float, seconds
            Time >= 0.

        Returns
        -------
        RgbdFrame

        Raises
        ------
        InputError
            The time is negative or not finite.
        """
        nanoseconds = _nanoseconds(time)
        random = np.random.default_rng([self.seed, nanoseconds, 1])
        scenery = self._scenery
        view = scenery.seen_by(DEPTH_CAMERA, _EYES)
        measured = measure(view.depth, view.slant, self.noise, random)
        color = None if self.color == "none" else view.color.copy()
        if self.color == "full":
            eye = -COLOR_CAMERA.translation.astype(np.float32)
            color = scenery.seen_by(COLOR_CAMERA.color, eye).color.copy()
        return RgbdFrame(
            np.rint(measured.depth * 1000.0).astype(np.uint16),
            self.calibration,
            color,
            np.full(view.depth.shape, NO_BODY, np.uint8),
            time_ns=nanoseconds,
            number=round(time * self.rate),
        )

    # --- The scene ----------------------------------------------------------------------------

    @functools.cached_property
    def _is_sitting(self) -> bool:
        if self.sitting is not None:
            return self.sitting
        return self.chair == "wheelchair" or self.motion in ("knee-extension", "dorsiflexion")

    @functools.cached_property
    def _moving(self) -> tuple[bool, bool]:
        side = self.side
        if not side:
            side = opposite(self.amputated).split("_")[0] if self.amputated else "both"
        return side in ("left", "both"), side in ("right", "both")

    @functools.cached_property
    def _skin(self) -> Skin:
        if self.amputated:
            return build_skin(self.amputated, self.stump, self.girth, self.dressing)
        return _whole(self.girth)

    @functools.cached_property
    def _scenery(self) -> Scenery:
        seat = self.distance if self._is_sitting else None
        scene = self.scene if self.room else ""
        level = furnish(scene, seat, self.turn, self.distance, CAMERA_HEIGHT, self.chair)
        return replace(level, vertices=self._seen_by_camera(level.vertices))

    @functools.cached_property
    def _rotation(self) -> NDArray[np.float64] | None:
        """Rotation from the axes of a level camera to the camera's; None: it is level."""
        if self.tilt == self.roll == 0.0:
            return None
        return product(about("z", self.roll), about("x", self.tilt))

    @property
    def _pivot(self) -> tuple[float, float, float]:
        return (0.0, 0.0, self.distance)

    def _seen_by_camera(self, vertices: Floats) -> Floats:
        """Transform points from the frame of a level camera to the camera's."""
        if self._rotation is None:
            return vertices
        turned = product(vertices - self._pivot, self._rotation.T) + self._pivot
        return np.asarray(turned, np.float32)

    @functools.cached_property
    def _wardrobe(self) -> tuple[_Look, ...]:
        covered = {"none": (), "both": ("left_leg", "right_leg")}.get(
            self.cover, (f"{self.cover}_leg",)
        )
        clothes = Clothes(stripes=self.stripes, long_sleeves=self.dressing == "sleeve")
        person = _Look.of(self._skin, clothes, covered)
        return (person, _Look.of(_whole(1.0), _VISITOR, ()))

    def _cast(self, time: float) -> _Cast:
        """Moving objects at a time: the person, the visitor and the board."""
        pose = pose_at(
            self.motion,
            time,
            moving=self._moving,
            sitting=self._is_sitting,
            turn=self.turn
            + self.turning * time
            + self.sway * float(np.sin(2.0 * np.pi * time / _SWAY_PERIOD)),
            twist=self.twist * float(np.sin(2.0 * np.pi * time / PERIOD)),
            shoulder_tilt=self.shoulder_tilt,
            thigh_turn=self.thigh_turn,
        )
        pose = clear_of_trunk(pose, self.girth)
        figure = pose_figure(pose, (0.0, CAMERA_HEIGHT, self.distance))
        inhaled = 0.5 - 0.5 * float(np.cos(2.0 * np.pi * time / _BREATH_PERIOD))
        figures = [replace(figure, breath=self.breath * inhaled)]
        if self.visitor is not None and time >= self.visitor:
            figures.append(self._visiting(time - self.visitor))
        board = None
        if _within(self.occluder, time):
            box = self._board(figures[0])
            corners, sides = box_mesh(box)
            board = _Board(self._seen_by_camera(corners), sides, box.color)
        if self._rotation is not None:
            figures = [turned_figure(one, self._rotation, self._pivot) for one in figures]
        return _Cast(figures, self._wardrobe, board, self._last)

    @functools.cached_property
    def _last(self) -> list[_Seen]:
        """Views of the previous frame, which are reused if nothing moves."""
        return []

    def _visiting(self, seconds: float) -> PosedFigure:
        """A visitor who walks in at 1 m/s, then stands half a metre beside and behind."""
        x = min(-2.2 + seconds, -0.62)
        z = self.distance + 0.45
        is_there = x == -0.62
        pose = pose_at("still", 0.0) if is_there else walk(seconds, turn=90.0)
        return pose_figure(pose, (x, CAMERA_HEIGHT, z))

    def _board(self, figure: PosedFigure) -> Box:
        """A board 0.45 m in front of the middle of the intact limb."""
        limb = opposite(self.amputated) if self.amputated else "left_arm"
        middle = figure.joints[list(LIMBS[limb][:4])].mean(axis=0) - (0.0, 0.0, 0.45)
        half = np.array([0.16, 0.36, 0.02])
        return Box(tuple(middle - half), tuple(middle + half), (168, 132, 84))

    def _color(self, cast: _Cast, view: _View) -> NDArray[np.uint8] | None:
        if self.color == "none":
            return None
        if self.color == "depth":
            return view.color.copy()
        color = COLOR_CAMERA.color
        return cast.see(color, COLOR_CAMERA, self._scenery, self.threads).color.copy()

    # --- The tracker --------------------------------------------------------------------------

    def _skeletons(
        self, cast: _Cast, view: _View, time: float, random: np.random.Generator
    ) -> tuple[Skeleton, ...]:
        """Return what the tracker says of the people it sees: their joints, with its errors.

        Joints that are hidden are inferred, and jitter five times as much.
        """
        found = []
        lost, swapped = _within(self.lost, time), _within(self.swapped, time)
        for number, figure in enumerate(cast.figures):
            joints = figure.joints.copy()
            is_seen = _seen(joints, view, number)
            if number == 0 and self.amputated:
                missing = self._missing
                is_seen[missing] = False
                joints[missing] = self._guess(figure, random)
            orientations = figure.orientations.astype(np.float32)
            sigma = np.where(is_seen, self.jitter, 5.0 * self.jitter)[:, None]
            white = random.standard_normal((25, 3))
            joints += sigma * (self._correlated(time, number) if self.correlation else white)
            if self.bias:
                joints += self.bias * _bone_errors(figure, number)
            if self.flying and self.amputated and number == 0:
                flight = self._correlated(time, 2, memory=0.8)[self._missing]
                joints[self._missing] += _FLIGHT * flight
                is_seen[self._missing] = True
            if (number == 0 and lost) or not (view.people == number).any():
                continue
            found.append(
                Skeleton(
                    joints.astype(np.float32),
                    orientations,
                    np.where(is_seen, TRACKED, INFERRED).astype(np.uint8),
                    id=2 - number if swapped and number < 2 else number + 1,
                    body=number,
                )
            )
        return tuple(found)

    def _correlated(
        self, time: float, stream: int, memory: float | None = None
    ) -> NDArray[np.float64]:
        """Values of a first-order autoregressive process of variance 1 at a time, (25, 3)."""
        rho = self.correlation if memory is None else memory
        last = round(time * self.rate)
        sums = np.zeros((25, 3))
        for frame in range(last - _num_remembered(rho), last + 1):
            sums = rho * sums + np.sqrt(1.0 - rho * rho) * _draws(self.seed, stream, frame)
        return sums

    @functools.cached_property
    def _missing(self) -> list[int]:
        """Joints of the missing limb, without its root."""
        return list(LIMBS[self.amputated][1:]) if self.amputated else []

    def _guess(self, figure: PosedFigure, random: np.random.Generator) -> NDArray[np.float64]:
        """Positions of inferred joints of a missing limb: around the stump's end."""
        assert self.amputated is not None
        root, first = LIMBS[self.amputated][:2]
        way = figure.joints[first] - figure.joints[root]
        end = figure.joints[root] + way * (self.stump / np.linalg.norm(way, axis=-1))
        return np.asarray(end + 0.03 * random.standard_normal((len(self._missing), 3)))


def _nanoseconds(time: float) -> int:
    """Return a time in nanoseconds, after a check of the argument."""
    if not 0.0 <= time < 1e9:
        raise InputError(f"time: expected seconds >= 0, got {time!r}")
    return round(time * 1e9)


def _bone_errors(figure: PosedFigure, number: int) -> NDArray[np.float64]:
    """Unit error vectors of the joints, (25, 3), constant in the frames of the bones."""
    fixed = np.random.default_rng([25, number]).standard_normal((25, 3))
    fixed /= np.linalg.norm(fixed, axis=1, keepdims=True)
    bones = figure.joints - figure.joints[list(PARENTS)]
    short = np.linalg.norm(bones, axis=1) <= 1e-6
    bones[short] = figure.joints[1] - figure.joints[0]
    along = bones / np.linalg.norm(bones, axis=1, keepdims=True)
    side = np.cross(along, np.cross(figure.lateral[0], along))
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-6)
    axes = np.stack([along, side, np.cross(along, side)], axis=1)
    return np.asarray(np.einsum("ji,jik->jk", fixed, axes))


def _num_remembered(rho: float) -> int:
    """Number of earlier frames that jitter of a correlation depends on."""
    if rho <= _USUAL:
        return _MEMORY
    return math.ceil(_MEMORY * math.log(_USUAL) / math.log(rho))


@functools.lru_cache(maxsize=4 * (_num_remembered(_MAX_CORRELATION) + 1))
def _draws(seed: int, stream: int, frame: int) -> NDArray[np.float64]:
    """Standard normal numbers of one frame, (25, 3); successive sums share all but one."""
    number = frame + _MEMORY
    words = [seed, stream, number] if number >= 0 else [seed, stream, -number, 1]
    return np.random.default_rng(words).standard_normal((25, 3))


@functools.cache
def _whole(girth: float) -> Skin:
    return build_skin(girth=girth)


def _within(interval: Interval | None, time: float) -> bool:
    return interval is not None and interval[0] <= time < interval[1]


def _seen(joints: NDArray[np.float64], view: _View, number: int) -> NDArray[np.bool_]:
    """Joints inside the image with nothing in front of them except the bones that meet there.

    Other parts of the person also hide a joint if they are far in front of it, such as an arm
    behind the back.
    """
    camera = DEPTH_CAMERA
    ahead = np.column_stack([joints[:, :2], np.maximum(joints[:, 2], 0.1)])
    column, row = np.rint(camera.project(ahead)).astype(int).T
    inside = (row >= 0) & (row < camera.height) & (column >= 0) & (column < camera.width)
    row, column = row.clip(0, camera.height - 1), column.clip(0, camera.width - 1)
    surface = view.depth[row, column]
    before = (surface > 0.0) & (surface < joints[:, 2] - 0.01)
    own = view.people[row, column] == number
    bone = np.where(own, view.bones[row, column], 0)
    meets = (bone == np.arange(25)) | (np.asarray(PARENTS)[bone] == np.arange(25))
    hidden = before & (~own | (~meets & (surface < joints[:, 2] - _HIDDEN)))
    return np.asarray(inside & ~hidden)


@checked
def cast_mesh(mesh: Mesh, camera: Intrinsics, *, threads: int = 0) -> Floats:
    """Render the depth of a mesh for an ideal camera at the origin.

    Parameters
    ----------
    mesh : Mesh
        Mesh in the camera's frame, metres.
    camera : Intrinsics
        The camera.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores. The result does not depend on it.

    Returns
    -------
    (H, W) float32, metres
        Depth; 0: no surface.

    Raises
    ------
    InputError
        The mesh is not valid.

    Examples
    --------
    >>> from manip3d import Intrinsics, Mesh, simulate
    >>> camera = Intrinsics(3, 3, 1.0, 1.0, 1.0, 1.0)
    >>> wall = Mesh([[-9, -9, 2], [9, -9, 2], [0, 9, 2]], [[0, 2, 1]])
    >>> round(float(simulate.cast_mesh(wall, camera)[1, 1]), 6)
    2.0
    """
    shape = camera.height, camera.width
    rays = camera.unproject(np.ones(shape, np.float32)).reshape(-1, 3)
    caster = RayCaster(mesh.vertices, mesh.faces)
    depth = np.concatenate(
        [
            caster.cast(_EYES, rays[start : start + CHUNK], threads=threads).distance
            for start in range(0, len(rays), CHUNK)
        ]
    )
    return np.where(np.isfinite(depth), depth, np.float32(0.0)).reshape(shape)


# --- Rendering ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Look:
    """A surface with its textures."""

    skin: Skin
    texels: tuple[NDArray[np.uint8], ...]  # levels, (N, 3)
    face_tile: NDArray[np.int64]
    corners: Floats  # (F, 3, 2)

    @classmethod
    def of(cls, skin: Skin, clothes: Clothes, covered: tuple[str, ...]) -> _Look:
        tiles = paint(clothes)
        levels = [tiles]
        for _ in range(3):
            image = levels[-1].astype(np.float32)
            side = image.shape[1] // 2
            small = image.reshape(len(image), side, 2, side, 2, 3).mean(axis=(2, 4))
            levels.append(np.rint(small).astype(np.uint8))
        face_tile = skin.face_tile.astype(np.int64)
        for limb in covered:
            feet = (face_tile == TILES.index("foot")) & (skin.face_limb == list(LIMBS).index(limb))
            face_tile[feet] = len(TILES)
        texels = tuple(level.reshape(-1, 3) for level in levels)
        return cls(skin, texels, face_tile, skin.texcoords[skin.faces])

    def colors(
        self, face: NDArray[np.int64], uv: Floats, light: Floats, footprint: float
    ) -> NDArray[np.uint8]:
        """Return the colours of hits, (N, 3); ``footprint``: size of a pixel, metres."""
        level = int(np.clip(np.rint(np.log2(max(footprint, 1e-6) / 0.0025)), 0, 3))
        side = SIDE >> level
        corners = self.corners[face]
        at = corners[:, 0] + uv[:, :1] * (corners[:, 1] - corners[:, 0])
        at += uv[:, 1:] * (corners[:, 2] - corners[:, 0])
        texel = np.minimum((at * side).astype(np.int64), side - 1)
        flat = (self.face_tile[face] * side + texel[:, 1]) * side + texel[:, 0]
        return np.asarray(np.minimum(self.texels[level][flat] * light[:, None], 255.0), np.uint8)


@dataclass(frozen=True, eq=False)
class _View:
    """Exact images of an ideal camera with (H, W) pixels."""

    depth: Floats
    slant: Floats
    people: NDArray[np.uint8]
    bones: NDArray[np.uint8]
    color: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class _Seen:
    """Views of the scene by camera, valid while the vertices of moving objects are unchanged."""

    vertices: Floats
    views: dict[tuple[Intrinsics, bytes], _View] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Board:
    """A board in the camera's frame."""

    vertices: Floats
    faces: NDArray[np.int32]
    color: tuple[int, int, int]


class _Cast:
    """Moving objects of the scene at one moment."""

    def __init__(
        self,
        figures: list[PosedFigure],
        looks: tuple[_Look, ...],
        board: _Board | None,
        last: list[_Seen],
    ) -> None:
        self.figures = figures
        self._looks = looks[: len(figures)]
        self._board = board
        vertices = [
            look.skin.vertices(figure) for look, figure in zip(self._looks, figures, strict=True)
        ]
        faces = [look.skin.faces for look in self._looks]
        if board is not None:
            vertices.append(board.vertices)
            faces.append(board.faces)
        starts = np.cumsum([0] + [len(v) for v in vertices])
        self._first_face = np.cumsum([0] + [len(f) for f in faces])
        self._vertices = np.concatenate(vertices)
        self._faces = np.concatenate([f + start for f, start in zip(faces, starts, strict=False)])
        seen = last[0] if last else None
        if seen is None or not np.array_equal(seen.vertices, self._vertices):
            seen = _Seen(self._vertices)
            last[:] = [seen]
        self._views = seen.views

    @functools.cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self._vertices, self._faces)

    def see(
        self,
        camera: Intrinsics,
        registration: Registration | None,
        scenery: Scenery,
        threads: int,
    ) -> _View:
        """Return the view of a camera that looks ahead; it is cached and must not be changed."""
        eye = _EYES if registration is None else -registration.translation.astype(np.float32)
        key = (camera, eye.tobytes())
        if key not in self._views:
            self._views[key] = self._look(camera, eye, scenery, threads)
        return self._views[key]

    def _look(self, camera: Intrinsics, eye: Floats, scenery: Scenery, threads: int) -> _View:
        """Return what a camera sees: the nearest surface of scenery, people and board."""
        back = scenery.seen_by(camera, eye)
        depth, slant, color = back.depth.copy(), back.slant.copy(), back.color.copy()
        people = np.full(depth.shape, NO_BODY, np.uint8)
        bones = np.full(depth.shape, NO_BONE, np.uint8)
        top, bottom, left, right = self._window(camera, eye)
        rays = back.rays[top:bottom, left:right].reshape(-1, 3)
        for start in range(0, len(rays), CHUNK):
            part = rays[start : start + CHUNK]
            hits = self._caster.cast(eye, part, threads=threads)
            row, column = np.divmod(np.arange(start, start + len(part)), max(1, right - left))
            row, column = row + top, column + left
            behind = back.depth[row, column]
            hit = np.flatnonzero(
                (hits.distance < behind) | (np.isfinite(hits.distance) & (behind == 0.0))
            )
            row, column = row[hit], column[hit]
            face, distance = hits.face[hit].astype(np.int64), hits.distance[hit]
            cosine = np.abs((hits.normal[hit] * part[hit]).sum(1))
            cosine /= np.linalg.norm(part[hit], axis=1)
            depth[row, column], slant[row, column] = distance, cosine
            light = (0.42 + 0.68 * cosine).astype(np.float32)
            whose = np.searchsorted(self._first_face, face, side="right") - 1
            for number, look in enumerate(self._looks):
                mine = np.flatnonzero(whose == number)
                own = face[mine] - self._first_face[number]
                at = row[mine], column[mine]
                people[at] = number
                bones[at] = look.skin.face_bone[own]
                size = float(distance[mine].mean()) / camera.fx if len(mine) else 1.0
                color[at] = look.colors(own, hits.uv[hit[mine]], light[mine], size)
            if self._board is not None:
                mine = np.flatnonzero(whose == len(self._looks))
                tone = np.array(self._board.color) * light[mine][:, None]
                color[row[mine], column[mine]] = np.minimum(tone, 255).astype(np.uint8)
        return _View(depth, slant, people, bones, color)

    def _window(self, camera: Intrinsics, eye: Floats) -> tuple[int, int, int, int]:
        """Range of rows and columns in which moving objects can be visible."""
        points = self._vertices - eye
        points = points[points[:, 2] > 0.05]
        if not len(points):
            return 0, 0, 0, 0
        u, v = camera.project(points).T
        left, right = np.clip([u.min(), u.max() + 2.0], 0, camera.width).astype(int).tolist()
        top, bottom = np.clip([v.min(), v.max() + 2.0], 0, camera.height).astype(int).tolist()
        return top, bottom, left, right
