"""Export of a recording's joints as a table (CSV) or a motion file (BVH)."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.linear import product
from manip3d._util.paths import path_of, refuse_existing
from manip3d._util.reprs import short_repr
from manip3d.capture._rgbd import open_rgbd
from manip3d.capture._rgbd_source import RgbdSource
from manip3d.errors import InputError
from manip3d.io._files import atomic_path
from manip3d.modify import DownSource, KeyPerson, PhantomPipeline, PoseTracker
from manip3d.modify._level import differ, level_rotation
from manip3d.rgbd import JOINTS, NOT_TRACKED, PARENTS, RgbdFrame, Skeleton

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_TO_BVH = np.array([100.0, -100.0, -100.0])  # metres, y down, z ahead -> centimetres, y up
_LEVEL = np.array([0.0, 1.0, 0.0])  # the vertical of a level camera
_WATCHED = 30  # frames with a person in which a floor is looked for
_SHORTEST_STEP = 1e-3  # seconds between two poses of a motion
_USUAL_STEP = 1 / 30  # the same, of recordings without times
_LONGEST_STEP = 1.0  # seconds between two frames for which a person counts as absent
_LASTING = 30  # steps; a rate that lasts this long counts
_LIKE = 0.25  # shares of a step by which others differ at the same rate
_SURE = 0.02  # share of the duration; a larger difference means that rounding errors add up
_LATEST = 0.75  # frames between a pose and its time; half a frame, and room for jitter
_ROUNDS = 5  # of fitting the rest pose; recorded ones then move less than 0.1 degrees
_MAX_IDS = 10  # largest number of ids listed in an error message
_LONGEST_GAP = 3600.0  # longest time in seconds between two frames of a motion
_SPINE = [JOINTS.index(name) for name in ("SpineMid", "SpineShoulder", "Neck", "Head")]
_CHILDREN = [[j for j in range(1, 25) if PARENTS[j] == parent] for parent in range(25)]


@dataclass(frozen=True)
class ExportedJoints:
    """Result of `export_joints`.

    Attributes
    ----------
    path : Path
        The file that was written.
    frames : int
        Number of skeletons written, without those that are ``held``.
    people : int
        Number of people: of different ids in a table; 1 in a motion, even if the tracker gave the
        person new ids.
    held : int
        Number of frames of a motion that repeat the pose before: the person was not seen in them,
        they were dropped, or the rate was lower.
    left_out : int
        Number of skeletons that a motion lacks, because an earlier skeleton already fills the frame
        nearest to their time.
    ids : tuple of int
        Ids of the skeletons written, in the order in which they come first.
    others : mapping of int to int
        Numbers of skeletons, by their id, that a motion lacks because they are of other people.
    """

    path: Path
    frames: int
    people: int
    held: int = 0
    left_out: int = 0
    ids: tuple[int, ...] = ()
    others: Mapping[int, int] = field(default_factory=dict)

    __repr__ = short_repr


@dataclass(frozen=True, slots=True)
class _Sighting:
    """A person in a frame, without the frame's images, which a recording has too many of."""

    number: int
    time_ns: int
    skeleton: Skeleton
    is_held: bool = False  # repeats the sighting before

    @staticmethod
    def of(frame: RgbdFrame, skeleton: Skeleton) -> _Sighting:
        return _Sighting(frame.number, frame.time_ns, skeleton)


@checked
def export_joints(
    source: str | Iterable[RgbdFrame],
    path: str | os.PathLike[str],
    *,
    person: int | None = None,
    frames: int | None = None,
    pose: bool = False,
    overwrite: bool = False,
) -> ExportedJoints:
    """Write the joints of a recording as a table (``.csv``) or as a motion (``.bvh``).

    A table has a row for each joint, in the camera's frame and in metres: ``frame``, ``time_ns``,
    ``id``, ``joint``, ``name``, ``x``, ``y``, ``z``, ``state`` (0 not tracked, 1 inferred, 2
    tracked). Joints that are no finite numbers were not tracked, and frames that all have the
    number 0 are numbered by their places. A motion has one person, y up, in centimetres. If one of
    the first 30 frames with a person shows a floor, up is away from it for a camera that is tilted
    by a degree or more; otherwise the camera is taken as level. A motion is thus level: as poses
    for a tilted camera (``forge stream --pose``), give the recording itself. Bones have their
    median lengths, and each joint is rotated so that its child bones point in the measured
    directions. Where several bones share a joint (spine and hips; neck and shoulders), they turn
    together: the angles between them are the mean of the recording, and their directions fit the
    measured ones by least squares. Between the first and the last frame with the person, frames
    without the person repeat the pose before; so do frames that are inserted where the times show
    that some were dropped. The frames of a motion are evenly spaced, at the highest rate that the
    recording had for 30 frames. Each pose is in the frame nearest to its time, or in the next one
    if that has a pose already; it is left out (``ExportedJoints.left_out``) if it would be more
    than three quarters of a frame late. If most steps of the recording are shorter than a
    millisecond, as where its times have another unit, no pose is left out.

    Parameters
    ----------
    source : str or iterable of RgbdFrame
        A URI for `open`, or an iterable of frames.
    path : path-like
        Output file; its name ends in ``.csv`` or ``.bvh``.
    person : int, optional
        `Skeleton.id` of the person to write. Default: a table has all people, a motion the person
        who is seen first, and is followed by place and size if the tracker gives a new id, as by
        `manip3d.modify.KeyPerson`. ``ExportedJoints.others`` counts the skeletons of other people.
    frames : int, optional
        Number of frames to read; default: all.
    pose : bool
        Detect the joints in the colour images with `manip3d.modify.PoseTracker` (extra ``pose``).
        Frames without colour keep the joints of the source.
    overwrite : bool
        Replace a file that exists.

    Returns
    -------
    ExportedJoints
        Path of the file, and the numbers of skeletons and people in it.

    Raises
    ------
    InputError
        ``path`` has another suffix, or exists; the source has no skeleton of the person, or none of
        its joints was seen; a motion has more than an hour between two frames.
    FormatError, DeviceError
        The source cannot be read. Frames of a recording that cannot be read are left out, unless
        all are; `RgbdSource.errors` says which.
    MissingExtraError
        MediaPipe is not installed, for ``pose``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, Skeleton, capture
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> frame = RgbdFrame(depth, camera, skeletons=(Skeleton(np.full((25, 3), 2.0)),))
    >>> written = capture.export_joints([frame], "joints.csv")
    >>> written.path.read_text().splitlines()[1]
    '0,0,0,0,SpineBase,2.000000,2.000000,2.000000,2'
    """
    target = Path(path_of(path))
    suffix = target.suffix.lower()
    if suffix not in (".csv", ".bvh"):
        raise InputError(f"path: expected a name that ends in .csv or .bvh, got {target}")
    refuse_existing(target, overwrite=overwrite, name="path")
    if frames is not None and not frames > 0:
        raise InputError(f"frames: expected > 0, got {frames}")
    with ExitStack() as opened:
        stream: Iterable[RgbdFrame] = (
            source if not isinstance(source, str) else (opened.enter_context(open_rgbd(source)))
        )
        stream = _read(stream, frames)
        if pose:
            tracker = opened.enter_context(PoseTracker())
            stream = (f if f.color is None else tracker.annotate(f) for f in stream)
        ids: Counter[int] = Counter()
        others: Counter[int] = Counter()
        left_out = 0
        stream = _counting_ids(stream, ids)
        if suffix == ".csv":
            found = [
                replace(_Sighting.of(frame, skeleton), number=number)
                for number, frame in _with_numbers(stream)
                for skeleton in frame.skeletons
                if person is None or skeleton.id == person
            ]
        else:
            vertical = _Vertical()
            followed = _followed(vertical.watching(stream), person)
            found, step = _at_even_times(followed)
            left_out = _seen(followed) - _seen(found)
            others = ids - Counter(one.skeleton.id for one in followed if not one.is_held)
    if not found:
        who = "a skeleton" if person is None else f"a skeleton with id {person}"
        if ids:
            known = ", ".join(map(str, sorted(ids)[:_MAX_IDS]))
            raise InputError(f"person: expected {who} in some frame, found only ids {known}")
        cure = "" if pose else " (--pose, or pose=True in Python, looks for them in colour images)"
        raise InputError(f"source: expected {who} in some frame, found none{cure}")
    text = _table(found) if suffix == ".csv" else _motion(found, step, vertical.down)
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="ascii", newline="\n")
    written = tuple(dict.fromkeys(one.skeleton.id for one in found))
    people = len(written) if suffix == ".csv" else 1
    seen = _seen(found)
    return ExportedJoints(
        target, seen, people, len(found) - seen, left_out, written, dict(sorted(others.items()))
    )


def _seen(found: list[_Sighting]) -> int:
    """Return the number of sightings that do not repeat the one before."""
    return sum(not one.is_held for one in found)


def _read(stream: Iterable[RgbdFrame], frames: int | None) -> Iterator[RgbdFrame]:
    if isinstance(stream, RgbdSource):
        stream = stream._readable()
    for frame in islice(stream, frames):
        if not isinstance(frame, RgbdFrame):
            raise InputError(f"source: expected frames of an RGB-D camera, got {frame!r:.80}")
        yield frame


def _with_numbers(stream: Iterable[RgbdFrame]) -> Iterator[tuple[int, RgbdFrame]]:
    """Yield each frame after its number, or after its place as long as all have the number 0."""
    are_numbered = False
    for place, frame in enumerate(stream):
        are_numbered = are_numbered or frame.number != 0
        yield frame.number if are_numbered else place, frame


def _counting_ids(stream: Iterable[RgbdFrame], ids: Counter[int]) -> Iterator[RgbdFrame]:
    for frame in stream:
        ids.update(skeleton.id for skeleton in frame.skeletons)
        yield frame


def _followed(stream: Iterable[RgbdFrame], person: int | None) -> list[_Sighting]:
    """Return a person's skeletons from its first frame to its last.

    A frame in which the person is not seen repeats the skeleton before.
    """
    find = _FirstPerson().find if person is None else partial(_with_id, person)
    found: list[_Sighting] = []
    missing = 0
    for frame in stream:
        here = find(frame)
        if here is not None:
            missing = 0
            found.append(_Sighting.of(frame, here))
        elif found:
            missing += 1
            found.append(replace(_Sighting.of(frame, found[-1].skeleton), is_held=True))
    return found[: len(found) - missing]


def _with_id(person: int, frame: RgbdFrame) -> Skeleton | None:
    return next((one for one in frame.skeletons if one.id == person), None)


class _FirstPerson:
    """Follows the person who is seen first, also if the tracker gives them new ids."""

    def __init__(self) -> None:
        self._key = KeyPerson()
        self._id: int | None = None
        self._is_followed = False  # `KeyPerson` goes by the spine; until it is seen, the id counts
        self._is_by_id = True  # so does it while the spine is hidden
        self._time_s = 0.0  # without the time in which the person was in view without a spine
        self._last_ns: int | None = None

    def find(self, frame: RgbdFrame) -> Skeleton | None:
        """Return the person in a frame; None: they are not seen."""
        step = self._step_to(frame.time_ns)
        if self._id is None and frame.skeletons:
            self._id = frame.skeletons[0].id
        same = None if self._id is None else _with_id(self._id, frame)
        if same is not None and not _has_spine(same):
            self._is_by_id = True
            return same
        self._time_s += step
        if same is not None and self._is_by_id:
            self._key.select(same.id)  # somebody else may stand where the spine was last seen
            self._is_by_id, self._is_followed = False, True
        if not self._is_followed:
            return None
        found = self._key.find(frame.skeletons, frame.calibration.depth, self._time_s)
        self._id = self._id if found is None else found.id
        return found

    def _step_to(self, time_ns: int) -> float:
        """Return the time since the last frame, or a usual step if a clock began again.

        A long one counts as a second: during a pause of the recording, nobody was absent.
        """
        step = 0.0 if self._last_ns is None else (time_ns - self._last_ns) * 1e-9
        self._last_ns = time_ns
        return min(step, _LONGEST_STEP) if step > 0.0 else _USUAL_STEP


def _has_spine(skeleton: Skeleton) -> bool:
    """Return whether `KeyPerson` can tell where the base of the spine is."""
    spine = [0, *_SPINE[:-1]]  # without the head
    places = skeleton.positions[spine]
    is_seen = (skeleton.states[spine] != NOT_TRACKED) & places.any(axis=1)
    return bool((is_seen & np.isfinite(places).all(axis=1)).any())


def _at_even_times(found: list[_Sighting]) -> tuple[list[_Sighting], float]:
    """Return the pose of each frame of a motion, and the seconds between two frames.

    Frames are counted from the beginning, so that no error adds up where frames were dropped or
    their rate changed. Those up to the next pose repeat the pose before.
    """
    first = found[0].time_ns if found else 0
    steps = np.diff([float(one.time_ns - first) for one in found]) * 1e-9
    if len(steps) == 0 or not np.median(steps) > 0:
        mean = float(steps.mean()) if len(steps) else 0.0
        return found, mean if mean > 0 else _USUAL_STEP
    steps[steps < 0] = np.median(steps)  # a clock that began again goes on
    longest = float(steps.max())
    if longest > _LONGEST_GAP:
        raise InputError(
            f"source: expected at most {_LONGEST_GAP:.0f} s between two frames of a motion, got "
            f"{longest:.0f} s"
        )
    times = np.cumsum(steps)
    seconds = float(times[-1])
    are_real = np.median(steps) >= _SHORTEST_STEP  # no camera is faster
    usual = max(_usual_step(steps), _SHORTEST_STEP)
    step = _whole_step(steps, seconds, usual) if are_real else usual
    poses: list[_Sighting] = []
    for one, time in zip(found, (0.0, *times.tolist()), strict=True):
        slot = max(round(time / step), len(poses))
        if are_real and slot - time / step > _LATEST:
            continue  # the frame has a pose already
        held = [replace(poses[-1], is_held=True)] if poses else []
        poses += [*(held * (slot - len(poses))), one]
    return poses, step if are_real else seconds / (len(poses) - 1)


def _usual_step(steps: Floats) -> float:
    """Return the step of the highest rate that lasted, but at least a quarter of the median."""
    usual = float(np.median(steps))
    spans = np.lib.stride_tricks.sliding_window_view(steps, min(_LASTING, len(steps)))
    lasting = np.maximum(spans.mean(axis=1), np.median(spans, axis=1))  # neither jitter nor a burst
    shortest = float(lasting.min())
    if shortest < (1.0 - _LIKE) * usual:
        usual = max(shortest, usual / 4.0)
    like = np.abs(steps - usual) < _LIKE * usual
    return float(steps[like].mean()) if like.any() else usual


def _whole_step(steps: Floats, seconds: float, usual: float) -> float:
    """Return the step by which a motion has as many frames as there were with the dropped ones.

    Rounding each step tells their number exactly at one rate, but errors add up at several rates.
    """
    number = float(np.maximum(1.0, np.rint(steps / usual)).sum())
    is_sure = abs(number * usual - seconds) < _SURE * seconds
    return seconds / number if is_sure else usual


def _table(found: Sequence[_Sighting]) -> str:
    lines = ["frame,time_ns,id,joint,name,x,y,z,state"]
    for one in found:
        seen = one.skeleton
        for joint, (name, place) in enumerate(zip(JOINTS, seen.positions, strict=True)):
            x, y, z = (f"{value:.6f}" for value in place)
            state = seen.states[joint] if np.isfinite(place).all() else NOT_TRACKED
            lines.append(f"{one.number},{one.time_ns},{seen.id},{joint},{name},{x},{y},{z},{state}")
    return "\n".join(lines) + "\n"


# --- BVH ------------------------------------------------------------------------------------------


class _Vertical:
    """The vertical of a camera that may be tilted, by the floor that it sees."""

    def __init__(self) -> None:
        self.down: Floats = _LEVEL
        self._pipeline = PhantomPipeline()

    def watching(self, stream: Iterable[RgbdFrame]) -> Iterator[RgbdFrame]:
        """Pass frames on, and look for the floor in the first ones with a person."""
        left = _WATCHED
        for frame in stream:
            if left > 0 and frame.skeletons:
                left -= 1
                result = self._pipeline.process(replace(frame, color=None))
                if result.down_source is DownSource.FLOOR:
                    self.down = result.down if differ(result.down, _LEVEL) else _LEVEL
            yield frame


def _motion(found: Sequence[_Sighting], step: float, down: Floats) -> str:
    places = product(_without_gaps(found), level_rotation(down).T) * _TO_BVH
    bones = places[:, 1:] - places[:, list(PARENTS)[1:]]
    lengths = np.median(np.linalg.norm(bones, axis=2), axis=0)
    offsets = np.concatenate([np.zeros((1, 3)), _rest(places) * lengths[:, None]])
    lines = ["HIERARCHY", *_hierarchy(0, offsets, "", "ROOT")]
    lines += ["MOTION", f"Frames: {len(found)}", f"Frame Time: {max(step, 1e-7):.7f}"]
    order = _depth_first(0)
    for now in places:
        angles = _angles(now, offsets)
        numbers = [*now[0], *(value for joint in order for value in angles[joint])]
        lines.append(" ".join(f"{value:.5f}" for value in numbers))
    return "\n".join(lines) + "\n"


def _without_gaps(found: Sequence[_Sighting]) -> Floats:
    """Fill gaps in joint positions, (F, 25, 3): an untracked joint keeps its last seen position.

    Before its first sighting it has its first seen position. A joint that was never seen is put at
    its parent; the root, at the nearest spine joint that was seen.
    """
    places = np.array([one.skeleton.positions for one in found], np.float64)
    seen = np.array([one.skeleton.states != NOT_TRACKED for one in found])
    seen &= np.isfinite(places).all(axis=2)
    if not seen.any():
        raise InputError("source: expected joints of the person that were seen, found none")
    is_known = [bool(seen[:, joint].any()) for joint in range(25)]
    for joint in range(25):
        if not is_known[joint]:
            continue
        known = np.flatnonzero(seen[:, joint])
        last = np.searchsorted(known, np.arange(len(found)), side="right") - 1
        places[:, joint] = places[known[np.maximum(last, 0)], joint]
    if not is_known[0]:
        nearest = next(joint for joint in (*_SPINE, *range(25)) if is_known[joint])
        places[:, 0] = places[:, nearest]
    for joint in _depth_first(0)[1:]:
        if not is_known[joint]:
            places[:, joint] = places[:, PARENTS[joint]]  # a bone of length 0
    return places


def _rest(places: Floats) -> Floats:
    """Return the unit directions (24, 3) of the bones at rest, which are those of the first frame.

    Bones that share a joint cannot turn against each other. The angles between them are the mean of
    all frames [generalised Procrustes analysis, Gower, Psychometrika 40, 1975].
    """
    directions = _unit(places[:, 1:] - places[:, list(PARENTS)[1:]])
    rest = np.array(directions[0])
    for children in _CHILDREN:
        if len(children) < 2:
            continue
        bones = np.array(children) - 1
        for _ in range(_ROUNDS):
            turned = [product(seen, _rotation(rest[bones], seen)) for seen in directions[:, bones]]
            rest[bones] = _unit(np.mean(turned, axis=0))
    return rest


def _hierarchy(joint: int, offsets: Floats, indent: str, kind: str) -> list[str]:
    channels = "Zrotation Xrotation Yrotation"
    channels = f"6 Xposition Yposition Zposition {channels}" if joint == 0 else f"3 {channels}"
    inner = indent + "  "
    offset = "OFFSET {:.5f} {:.5f} {:.5f}".format(*offsets[joint])
    lines = [f"{indent}{kind} {JOINTS[joint]}", indent + "{", inner + offset]
    lines.append(f"{inner}CHANNELS {channels}")
    for child in _CHILDREN[joint]:
        lines += _hierarchy(child, offsets, inner, "JOINT")
    if not _CHILDREN[joint]:
        lines += [f"{inner}End Site", inner + "{", f"{inner}  OFFSET 0 0 0", inner + "}"]
    return [*lines, indent + "}"]


def _depth_first(joint: int) -> list[int]:
    return [joint, *(j for child in _CHILDREN[joint] for j in _depth_first(child))]


def _angles(places: Floats, offsets: Floats) -> Floats:
    """Return Euler angles (25, 3) about z, x, y in degrees, relative to the parent joint."""
    turned = np.tile(np.eye(3), (25, 1, 1))
    angles = np.zeros((25, 3))
    for joint in _depth_first(0):
        before = turned[PARENTS[joint]] if joint else np.eye(3)
        children = _CHILDREN[joint]
        rest = product(offsets[children], before.T)
        seen = places[children] - places[joint]
        turned[joint] = product(_rotation(rest, seen), before)
        angles[joint] = _zxy(product(before.T, turned[joint]))
    return angles


def _rotation(rest: Floats, seen: Floats) -> Floats:
    """Return the rotation that best maps the directions of ``rest`` onto ``seen``, both (n, 3).

    For one vector this is the rotation along the shortest arc, for several the least-squares
    rotation [Kabsch, Acta Crystallographica A32, 1976], and for none the identity. Vectors of
    length 0, whose joints were never seen, do not count.
    """
    known = rest.any(axis=1) & seen.any(axis=1)
    rest, seen = _unit(rest[known]), _unit(seen[known])
    if len(rest) == 0:
        return np.eye(3)
    if len(rest) == 1:
        return _shortest_arc(rest[0], seen[0])
    left, _, right = np.linalg.svd(product(seen.T, rest))
    sign = np.sign(np.linalg.det(product(left, right)))
    return np.asarray(product(left * (1.0, 1.0, sign), right))


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-9))


def _shortest_arc(a: Floats, b: Floats) -> Floats:
    axis, cosine = np.cross(a, b), float(product(a, b))
    if cosine < -1.0 + 1e-9 or not (a.any() and b.any()):
        return np.eye(3)  # opposite directions have no shortest arc
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + cross + product(cross, cross) / (1.0 + cosine))


def _zxy(rotation: Floats) -> Floats:
    """Return the angles (z, x, y) in degrees for which Rz Rx Ry = rotation."""
    x = np.arcsin(np.clip(rotation[2, 1], -1.0, 1.0))
    z = np.arctan2(-rotation[0, 1], rotation[1, 1])
    y = np.arctan2(-rotation[2, 0], rotation[2, 2])
    return np.degrees([z, x, y])
