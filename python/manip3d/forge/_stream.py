"""Forge RGB-D streams: a recorded person before another scene, in recorded or other poses."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from itertools import count
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from manip3d import _core
from manip3d._util.arrays import vector
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d._util.texts import counted
from manip3d.camera import same_camera
from manip3d.errors import InputError
from manip3d.forge._plates import labels_of
from manip3d.forge._stream_truth import StreamTruth, check_size, write_truth
from manip3d.modify import (
    AnimationMesh,
    JointSmoother,
    PoseScope,
    Skinning,
    animate,
    animation_mesh,
)
from manip3d.rgbd import NO_BODY, RgbdCalibration, RgbdFrame, Skeleton, check_frames

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Mask = NDArray[np.bool_]

Surface = Literal["mesh", "points"]


@dataclass(frozen=True, eq=False)
class ForgedFrame:
    """One frame of a forged stream with its ground truth.

    Attributes
    ----------
    frame : RgbdFrame
        The forged frame.
    mask : (H, W) bool
        Ground truth: pixels with the depth of the forged person.
    stage_ms : dict
        Processor time of this thread in each stage, milliseconds: ``smoothing``, ``segmentation``,
        ``mesh``, ``animation``, ``drawing``, ``body index``.
    """

    frame: RgbdFrame
    mask: Mask
    stage_ms: dict[str, float] = field(default_factory=dict)

    __repr__ = short_repr


class _Stopwatch:
    """Measures the processor time of this thread in each stage."""

    def __init__(self) -> None:
        self.spent_ms: dict[str, float] = {}
        self._since = time.thread_time_ns()

    def done(self, stage: str) -> None:
        now = time.thread_time_ns()
        self.spent_ms[stage] = (now - self._since) * 1e-6
        self._since = now


@dataclass(frozen=True)
class _Options:
    method: Skinning
    scope: PoseScope
    move: NDArray[np.float64]
    surface: Surface
    fill_pinholes: bool
    blend: int
    smooths: bool
    by_label: bool


@checked
class StreamForger:
    """Forges one frame after the other, like `stream`, but for live sources.

    Parameters
    ----------
    background, kind, pose, method, scope, move, surface, fill_pinholes, blend, smoothing, by_label
        Same as for `stream`.

    Attributes
    ----------
    kind : int
        Type of the forgery, 1 or 2; see `stream`.
    calibration : RgbdCalibration
        Calibration of the background's camera.

    Raises
    ------
    InputError
        As `stream`.

    Examples
    --------
    >>> from manip3d import capture, forge
    >>> with capture.open("openni2:") as camera:  # doctest: +SKIP
    ...     scene = forge.background_plate([camera.read() for _ in range(30)])
    ...     forger = forge.StreamForger(scene, kind=1)
    ...     for frame in camera:
    ...         forged = forger.process(frame)
    """

    def __init__(
        self,
        background: RgbdFrame | Iterable[RgbdFrame],
        *,
        kind: int,
        pose: Iterable[RgbdFrame | Skeleton] | None = None,
        method: Skinning = "lbs",
        scope: PoseScope = "limbs",
        move: ArrayLike = (0.0, 0.0, 0.0),
        surface: Surface = "mesh",
        fill_pinholes: bool = True,
        blend: int = 1,
        smoothing: bool = True,
        by_label: bool = True,
    ) -> None:
        if kind not in (1, 2):
            raise InputError(f"kind: expected 1 or 2, got {kind}")
        if kind == 2 and pose is None:
            raise InputError("pose: expected a motion for type 2, got none")
        if kind == 1 and pose is not None:
            raise InputError("pose: expected none for type 1, which keeps the recorded pose")
        _check_poses(pose)
        if not 0 <= blend <= 64:
            raise InputError(f"blend: expected 0 to 64, got {blend}")
        self.kind = kind
        self._options = _Options(
            method,
            scope,
            vector(move, 3, "move"),
            surface,
            fill_pinholes,
            blend,
            smoothing,
            by_label,
        )
        self.calibration, self._background = _calibration_of(background)
        self._pose = pose
        self._lock = threading.RLock()
        self.reset()

    def __repr__(self) -> str:
        return f"<manip3d.forge.StreamForger: type {self.kind}>"

    def reset(self) -> None:
        """Restart with the first background and pose, and forget past frames for smoothing."""
        with self._lock:
            self._number = 0
            self._scenes = _endless(self._background)
            self._poses = _endless(self._pose) if self._pose is not None else None
            self._own, self._other = JointSmoother(), JointSmoother()
            self._person, self._model = _Followed(), _Followed()
            self._has_pose = self._poses is None  # whether any pose has a skeleton

    def _refuse_iterators(self, source: Iterable[RgbdFrame]) -> None:
        """Raise if a second iteration would find an iterator where the first one has left it."""
        inputs = {"source": source, "background": self._background, "pose": self._pose}
        for name, frames in inputs.items():
            if isinstance(frames, Iterator):
                raise InputError(
                    f"{name}: expected a sequence for a second iteration, got an iterator, which "
                    "yields its frames only once"
                )

    def skip(self) -> None:
        """Skip a frame: background and poses advance, and smoothing restarts."""
        with self._lock:
            self._next()
            self._own, self._other = JointSmoother(), JointSmoother()

    def _next(self) -> tuple[RgbdFrame | None, RgbdFrame | Skeleton | None]:
        """Background and pose of the next frame."""
        scene = self._scenes(self._number)
        pose = None if self._poses is None else self._poses(self._number)
        self._number += 1
        return scene, pose

    def process(self, frame: RgbdFrame) -> ForgedFrame | None:
        """Forge the next frame.

        Parameters
        ----------
        frame : RgbdFrame
            The next frame of the source.

        Returns
        -------
        ForgedFrame or None
            The forged frame; None if the background or the poses have ended.

        Raises
        ------
        InputError
            Sizes of images do not agree.
        """
        check_frames("source", [frame])
        with self._lock:
            watch = _Stopwatch()
            scene, pose = self._next()
            if scene is None or (self._poses is not None and pose is None):
                return None
            camera = self.calibration.depth
            if scene.depth.shape != (camera.height, camera.width):
                height, width = scene.depth.shape
                raise InputError(
                    f"background: expected images of {camera.width} x {camera.height} pixels, "
                    f"got {width} x {height}"
                )
            person = self._person.of(frame)
            if self._options.smooths and person is not None:
                person = self._own.add(person)
            target = self._model.of(pose) if isinstance(pose, RgbdFrame) else pose
            self._has_pose = self._has_pose or target is not None
            if self._options.smooths and target is not None:
                target = self._other.add(target)
            watch.done("smoothing")
            return _forge(frame, person, scene, target, self.kind, self._options, watch)


@dataclass
class _Tally:
    """Ground truth of the frames that one iteration has yielded so far."""

    bits: list[NDArray[np.uint8]] = field(default_factory=list)  # packed mask of each frame
    numbers: list[int] = field(default_factory=list)
    unforged_frames: int = 0
    forged_pixels: int = 0

    def add(self, forged: ForgedFrame) -> None:
        pixels = int(np.count_nonzero(forged.mask))
        self.unforged_frames += pixels == 0
        self.forged_pixels += pixels
        self.bits.append(np.packbits(forged.mask))
        self.numbers.append(forged.frame.number)


@checked
class ForgedStream:
    """Frames of a person before another scene; made by `stream`.

    Iteration yields the forged frames; `frames` yields them with their masks. The ground truth of
    the iteration that began last is kept; iterations do not disturb each other.

    Attributes
    ----------
    kind : int
        Type of the forgery, 1 or 2; see `stream`.
    calibration : RgbdCalibration
        Calibration of the background's camera.
    """

    def __init__(self, source: Iterable[RgbdFrame], forger: StreamForger) -> None:
        self.kind, self.calibration = forger.kind, forger.calibration
        self._source, self._forger = source, forger
        self._has_begun = False  # whether there was any iteration
        self._tally = _Tally()  # that of the iteration that began last

    def __repr__(self) -> str:
        frames = counted(len(self._tally.numbers), "frame")
        return f"<manip3d.forge.ForgedStream: type {self.kind}, {frames} forged>"

    def __iter__(self) -> Iterator[RgbdFrame]:
        return (forged.frame for forged in self.frames())

    def frames(self) -> Iterator[ForgedFrame]:
        """Yield each forged frame with its mask.

        Yields
        ------
        ForgedFrame

        Raises
        ------
        InputError
            Sizes of images do not agree, or a second iteration begins over an iterator, which
            yields its frames only once. After the last frame: no frame of the source has a skeleton
            or people's pixels, or no frame of ``pose`` a skeleton.
        """
        if self._has_begun:
            self._forger._refuse_iterators(self._source)
        self._has_begun = True
        tally = self._tally = _Tally()
        forger = copy(self._forger)  # with an own state, because iterations may overlap
        forger.reset()
        has_people = False
        for frame in self._source:
            forged = forger.process(frame)
            if forged is None:
                break
            has_people = has_people or bool(frame.skeletons) or frame.body_index is not None
            tally.add(forged)
            yield forged
        else:  # the source ended, and not the background
            if tally.numbers and not has_people:
                raise InputError(
                    "source: expected a skeleton or people's pixels, got frames without"
                )
        if tally.numbers and not forger._has_pose:
            raise InputError(f"pose: expected skeletons, got none in {len(tally.numbers)} frames")

    @property
    def missed(self) -> int:
        """Number of frames without a forged pixel among those that were yielded so far.

        No person was found in them, or the person is hidden behind the background or outside of its
        view.
        """
        return self._tally.unforged_frames

    @property
    def forged_pixels(self) -> int:
        """Number of forged pixels in the frames that the last iteration has yielded so far."""
        return self._tally.forged_pixels

    @property
    def truth(self) -> StreamTruth:
        """Ground truth of the frames that the last iteration has yielded so far."""
        tally, shape = self._tally, self._shape
        masks = np.empty((shape[0], shape[1] * shape[2]), np.bool_)
        for mask, bits in zip(masks, tally.bits, strict=True):
            mask.view(np.uint8)[:] = np.unpackbits(bits, count=masks.shape[1])
        return StreamTruth(self.kind, masks.reshape(shape), np.array(tally.numbers, np.int64))

    @property
    def forged_share(self) -> float:
        """Share of forged pixels in the frames that were yielded so far; 0 before the first."""
        return self.forged_pixels / max(1, math.prod(self._shape))

    @property
    def _shape(self) -> tuple[int, int, int]:
        """Number of frames yielded so far, and the height and width of each."""
        camera = self.calibration.depth
        return len(self._tally.bits), camera.height, camera.width

    def write_truth(self, path: str | os.PathLike[str]) -> None:
        """Write `truth` like `StreamTruth.write`, but without unpacking all masks.

        Parameters
        ----------
        path : path
            Path of the ``.npz`` file. `read_stream_truth` needs a larger ``max_bytes`` to read it
            if masks of more than 160 MiB have hardly any forged pixels.

        Raises
        ------
        InputError
            There are more pixels than `read_stream_truth` accepts.
        OSError
            The file cannot be written.
        """
        tally, shape = self._tally, self._shape
        check_size(math.prod(shape))
        bits = _joined_bits(tally.bits, shape[1] * shape[2])
        write_truth(path, self.kind, shape, bits, np.array(tally.numbers, np.int64))


def _joined_bits(packed: Sequence[NDArray[np.uint8]], size: int) -> NDArray[np.uint8]:
    """Join packed images of ``size`` pixels, each of which begins at a byte, to one run of bits."""
    joined = np.empty((len(packed) * size + 7) // 8, np.uint8)
    for first in range(0, len(packed), 8):  # eight images fill whole bytes
        flat = [np.unpackbits(bits, count=size) for bits in packed[first : first + 8]]
        run = np.packbits(np.concatenate(flat))
        begin = first * size // 8
        joined[begin : begin + len(run)] = run
    return joined


@checked
def stream(
    source: Iterable[RgbdFrame],
    background: RgbdFrame | Iterable[RgbdFrame],
    *,
    kind: int,
    pose: Iterable[RgbdFrame | Skeleton] | None = None,
    method: Skinning = "lbs",
    scope: PoseScope = "limbs",
    move: ArrayLike = (0.0, 0.0, 0.0),
    surface: Surface = "mesh",
    fill_pinholes: bool = True,
    blend: int = 1,
    smoothing: bool = True,
    by_label: bool = True,
) -> ForgedStream:
    """Forge a stream that shows the person of a recording before another scene (section 5.1).

    Parameters
    ----------
    source : iterable of RgbdFrame
        Recording of the person, who is found by their skeleton, else by ``body_index``. It
        determines the length of the stream.
    background : RgbdFrame or iterable of RgbdFrame
        A still frame, or several. An iterator is read into a list first, except a recording, which
        has a ``calibration``. A sequence that is shorter than ``source`` is played forwards and
        backwards; the stream ends when a recording ends.
    kind : int
        Type of the forgery. 1: the person as recorded; 2: the person in the poses of ``pose``.
    pose : iterable of RgbdFrame or Skeleton, optional
        For type 2: motion of any person, frame by frame. A sequence is played like that of
        ``background``; the stream ends when an iterator ends.
    method, scope
        Same as for `modify.animate`.
    move : (3,), metres
        Translation of the person from the recorded place to that before the background, in the axes
        of the background's camera.
    surface : {"mesh", "points"}
        ``mesh``: triangles are drawn. ``points``: vertices are drawn, and pinholes between them
        filled, as published. Images of a separate colour camera are always drawn with triangles.
    fill_pinholes : bool
        Fill pinholes between vertices; only for ``surface='points'``.
    blend : int, pixels
        Width over which the person's colours fade into the background's, 0 to 64.
    smoothing : bool
        Smooth the joints of both skeletons first, by `modify.JointSmoother`.
    by_label : bool
        Same as for `modify.animation_mesh`; without it meshes tear (figure 5.5).

    Returns
    -------
    ForgedStream

    Raises
    ------
    InputError
        An option is out of range, type 2 has no poses, or the background has no frames. During
        iteration: sizes of images do not agree, or it is the second one over an iterator; after the
        last frame: the source has no skeletons or people's pixels, or the frames of ``pose`` have
        no skeletons.

    Notes
    -----
    If the person is not moved (type 1) and both cameras have the same calibration, all measured
    depths are kept. The person hides farther surfaces and pixels without a measurement. The stream
    has colour only if both recordings have.

    Examples
    --------
    >>> from manip3d import forge, simulate
    >>> person = simulate.BodySimulator(motion="still", frames=2, color="none")
    >>> room = simulate.BodySimulator(frames=2, color="none", seed=1)
    >>> scenes = [room.background(time) for time in (0.0, 0.1)]  # doctest: +SKIP
    >>> forged = forge.stream(person, scenes, kind=1)  # doctest: +SKIP
    >>> [frame.depth.shape for frame in forged]  # doctest: +SKIP
    [(424, 512), (424, 512)]
    """
    check_frames("source", source)
    forger = StreamForger(
        background,
        kind=kind,
        pose=pose,
        method=method,
        scope=scope,
        move=move,
        surface=surface,
        fill_pinholes=fill_pinholes,
        blend=blend,
        smoothing=smoothing,
        by_label=by_label,
    )
    return ForgedStream(source, forger)


def _check_poses(pose: object) -> None:
    """Raise InputError for containers with items other than poses; sources are not checked."""
    if isinstance(pose, np.ndarray):
        raise InputError(f"pose: expected frames or skeletons, got an array of shape {pose.shape}")
    if isinstance(pose, list | tuple | set | frozenset | dict):
        for each in pose:
            if not isinstance(each, RgbdFrame | Skeleton):
                raise InputError(f"pose: expected frames or skeletons, got {type(each).__name__}")
        if len(pose) and not any(isinstance(each, Skeleton) or each.skeletons for each in pose):
            raise InputError("pose: expected skeletons, got frames without")


def _calibration_of(
    background: RgbdFrame | Iterable[RgbdFrame],
) -> tuple[RgbdCalibration, RgbdFrame | Iterable[RgbdFrame]]:
    """Calibration of a background, and the background; iterators become lists."""
    if isinstance(background, RgbdFrame):
        return background.calibration, background
    known = getattr(background, "calibration", None)
    if isinstance(known, RgbdCalibration):
        return known, background
    frames = background if isinstance(background, Sequence) else list(background)
    check_frames("background", frames)
    if not len(frames):
        raise InputError("background: expected at least one frame, got none")
    return frames[0].calibration, frames


def _endless(things: Any) -> Any:
    """A function from the number of a frame to its background or pose; None after the last."""
    if isinstance(things, RgbdFrame):
        return lambda _: things
    if isinstance(things, Sequence):
        if not len(things):
            return lambda _: None
        period = max(1, 2 * (len(things) - 1))

        def to_and_fro(number: int) -> Any:
            at = number % period
            return things[min(at, period - at)]

        return to_and_fro
    iterator = iter(things)
    return lambda _: next(iterator, None)


class _Followed:
    """Follows one person of a recording, the first, as long as they can be identified."""

    _NEAR = 0.5  # metres per frame; a tracker may lose a person and find them with another id
    _PATIENCE = 30  # number of frames without the person after which another person is followed

    def __init__(self) -> None:
        self._last: Skeleton | None = None
        self._absent = 0

    def of(self, frame: RgbdFrame) -> Skeleton | None:
        """The person's skeleton in the next frame; None if the person is not there."""
        last = self._last
        if last is None or self._absent > self._PATIENCE:
            found = frame.skeletons[0] if frame.skeletons else None
        else:
            middle = last.positions[0]
            near = {
                float(np.linalg.norm(one.positions[0] - middle, axis=-1)): one
                for one in frame.skeletons
            }
            found = next((one for one in frame.skeletons if one.id == last.id), None)
            if found is None and near and min(near) < self._NEAR:
                found = near[min(near)]
        self._absent = 0 if found is not None else self._absent + 1
        self._last = found or last
        return found


def _drawn(
    frame: RgbdFrame,
    scene: RgbdFrame,
    mesh: AnimationMesh,
    vertices: NDArray[np.float32],
    options: _Options,
    *,
    in_place: bool,
) -> tuple[NDArray[np.uint16], NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Depth, mask of the person and colours of the scene, with the person drawn in front of it."""
    has_color = frame.color is not None and scene.color is not None
    core = _core.CompositeOptions()
    core.surface = _core.CompositeSurface.__members__[options.surface.upper()]
    core.fill_pinholes, core.blend = options.fill_pinholes, options.blend
    return _core.composite(
        vertices,
        mesh.faces,
        mesh.vertices,
        mesh.pixels,
        frame.color if has_color else None,
        frame.calibration.registration,
        in_place,
        np.ascontiguousarray(scene.depth),
        scene.calibration.depth,
        np.ascontiguousarray(scene.color) if has_color and scene.color is not None else None,
        scene.calibration.registration,
        core,
    )


def _forge(
    frame: RgbdFrame,
    person: Skeleton | None,
    scene: RgbdFrame,
    pose: Skeleton | None,
    kind: int,
    options: _Options,
    watch: _Stopwatch,
) -> ForgedFrame:
    """Draw the person of a frame before a scene."""
    camera = frame.calibration.depth
    by_label = kind == 2 and options.by_label
    labels = np.zeros(frame.depth.shape, np.uint8)
    moved = person
    if kind == 1 or (person is not None and pose is not None):
        labels = labels_of(frame, person)
    watch.done("segmentation")
    stays = not options.move.any()
    in_place = kind == 1 and stays and same_camera(camera, scene.calibration.depth)
    seen = frame.depth
    if not in_place:  # single lost pixels would leave holes
        seen, labels = _core.without_speckles(
            np.ascontiguousarray(seen), np.ascontiguousarray(labels)
        )
    mesh = animation_mesh(seen, camera, labels, person, by_label=by_label)
    watch.done("mesh")
    vertices = mesh.vertices
    if kind == 2 and person is not None and pose is not None:
        animated = animate(
            vertices, mesh.labels, person, pose, method=options.method, scope=options.scope
        )
        if animated is None:  # without a torso, limbs cannot be rotated
            mesh = animation_mesh(frame.depth, camera, np.zeros_like(labels))
            vertices, moved = mesh.vertices, None
        else:
            vertices, moved = animated.vertices, animated.skeleton
    if not stays:
        vertices = (vertices + options.move).astype(np.float32)
    watch.done("animation")
    depth, mask, color = _drawn(frame, scene, mesh, vertices, options, in_place=in_place)
    watch.done("drawing")
    drawn = mask.view(np.bool_)
    index, skeletons = _people(scene, drawn, moved, options.move)
    forged = replace(
        scene,
        depth=depth,
        color=color,
        body_index=index,
        skeletons=skeletons,
        time_ns=frame.time_ns,
        number=frame.number,
    )
    watch.done("body index")
    return ForgedFrame(forged, drawn, watch.spent_ms)


def _people(
    scene: RgbdFrame, drawn: Mask, moved: Skeleton | None, move: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], tuple[Skeleton, ...]]:
    """Body index and skeletons of the forged scene, as from a sensor."""
    index = (
        np.full(drawn.shape, NO_BODY, np.uint8)
        if scene.body_index is None
        else scene.body_index.copy()
    )
    taken = {skeleton.body for skeleton in scene.skeletons}
    body = next(number for number in count() if number not in taken and not (index == number).any())
    np.copyto(index, np.uint8(body), where=drawn)
    if moved is None or not drawn.any():
        return index, scene.skeletons
    taken_ids = {skeleton.id for skeleton in scene.skeletons}
    own = next(number for number in count(1) if number not in taken_ids)
    positions = (moved.positions + move).astype(np.float32)
    return index, (replace(moved, positions=positions, body=body, id=own), *scene.skeletons)
