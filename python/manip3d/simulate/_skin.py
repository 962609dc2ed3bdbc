"""A person's surface: tubes swept along the bones, bent smoothly at the joints.

Each part is a stack of rings. A ring belongs to two frames of `_figure` with a weight. Its centre
is the weighted mean of its positions in both frames, and its plane is rotated by the interpolated
rotation, so that a bent elbow keeps its girth; interpolated vertices alone would pinch it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from manip3d._util.linear import product, quaternions, rotations_of
from manip3d.rgbd import MIRRORED_JOINTS, PARENTS
from manip3d.simulate._figure import (
    FRAME_ORIGIN,
    FRAMES,
    LIMBS,
    REST_JOINTS,
    PosedFigure,
    mirrored_frame,
)

Array = NDArray[np.float64]
_Number = TypeVar("_Number", np.float64, np.intp)
Tile = Literal["torso", "head", "arm", "leg", "foot", "skin", "bandage"]

TILES: tuple[Tile, ...] = ("torso", "head", "arm", "leg", "foot", "skin", "bandage")

DRESSINGS = ("bare", "bandage", "sleeve")
"""Kinds of dressings of a stump: none, a bandage around its end, or an empty sleeve."""

_BEND = 0.05
"""Metres before and after a joint within which rings pass from one frame to the next."""

_TRUNK = (1, 20, 2, 4, 8, 12, 16)
"""Bones to which the faces of the trunk can belong."""

_CLOTHED = 1.1
"""Factor on the girths of the tables below for clothes."""

_CAP = 0.035
"""Length of the rounded end of a stump, metres."""

_BANDAGE = 0.008
"""Thickness of a bandage, metres."""

_SLEEVE_THICK = 0.012
"""Half the thickness of an empty sleeve, metres."""

_BREATH = (0.38, 0.10)
"""Height above the pelvis at which the chest moves most in breathing, and the extent of the motion
upwards and downwards, metres."""


@dataclass(frozen=True, eq=False)
class _Tube:
    """Rings of one part at rest.

    ``axis`` 1: rings in the plane (x, z), stacked along y; 2: rings in (x, y), stacked along z.
    """

    name: str
    tile: Tile
    segments: int
    centers: Array  # (R, 3)
    radii: Array  # (R, 4): right (-x), left (+x), back (axis 2: down), ahead (axis 2: up)
    frames: NDArray[np.intp]  # (R, 2)
    weights: Array  # (R,): weight of the second frame
    bones: NDArray[np.intp]  # (R,)
    along: Array  # (R,): texture coordinate, 0 to 1
    axis: int = 1
    exponent: float = 2.0


@dataclass(frozen=True, eq=False)
class _Sleeve:
    """Cloth beyond a joint or a stump's end, which always hangs straight down.

    Attributes
    ----------
    limp : int
        Frame of the missing part of the limb, which moves the cloth.
    bearer : int
        Frame from which it hangs.
    end : (3,) float64, metres
        Point at rest below which it hangs.
    """

    limp: int
    bearer: int
    end: Array

    def hung(self, figure: PosedFigure) -> PosedFigure:
        """Return the figure with the limp frame upright below the end of its bearer."""
        rotations, origins = figure.rotations.copy(), figure.origins.copy()
        heading = rotations[0, :, 0]  # to the person's left
        down = np.array(figure.down)
        ahead = np.cross(heading, -down)
        ahead /= np.linalg.norm(ahead, axis=-1)
        rotations[self.limp] = np.column_stack([np.cross(-down, ahead), -down, ahead])
        hangs_from = origins[self.bearer] + product(
            rotations[self.bearer], self.end - FRAME_ORIGIN[self.bearer]
        )
        reach = product(rotations[self.limp], self.end - FRAME_ORIGIN[self.limp])
        origins[self.limp] = hangs_from - reach
        return replace(figure, rotations=rotations, origins=origins)


@dataclass(frozen=True, eq=False)
class Skin:
    """A surface that follows the bones.

    Attributes
    ----------
    faces : (F, 3) int32
        Indices of the vertices of each face.
    face_bone : (F,) uint8
        Number of the bone to which each face belongs.
    face_limb : (F,) int8
        Index into `LIMBS`; -1: the trunk.
    face_tile : (F,) uint8
        Index into `TILES`.
    texcoords : (V, 2) float32
        Texture coordinates in the tile, 0 to 1: around (from the back over the left side), and
        along.
    """

    faces: NDArray[np.int32]
    face_bone: NDArray[np.uint8]
    face_limb: NDArray[np.int8]
    face_tile: NDArray[np.uint8]
    texcoords: NDArray[np.float32]
    _ring_center: Array
    _ring_frames: NDArray[np.intp]
    _ring_weight: Array
    _vertex_ring: NDArray[np.intp]
    _vertex_offset: Array
    _vertex_breath: Array  # factor on the breath for the forward motion
    _sleeve: _Sleeve | None = None

    def vertices(self, figure: PosedFigure) -> NDArray[np.float32]:
        """Return the vertices of a pose, (V, 3), metres, in the camera's frame."""
        if self._sleeve is not None:
            figure = self._sleeve.hung(figure)
        weight = self._ring_weight[:, None]
        centers = np.zeros_like(self._ring_center)
        for column, share in ((0, 1.0 - weight), (1, weight)):
            frame = self._ring_frames[:, column]
            reach = self._ring_center - FRAME_ORIGIN[frame]
            turned = np.einsum("rab,rb->ra", figure.rotations[frame], reach)
            centers += share * (figure.origins[frame] + turned)
        turns = self._ring_rotations(figure)[self._vertex_ring]
        offset = self._vertex_offset
        if figure.breath != 0.0:
            offset = offset + (figure.breath * self._vertex_breath)[:, None] * (0.0, 0.0, 1.0)
        offset = np.einsum("vab,vb->va", turns, offset)
        return np.asarray(centers[self._vertex_ring] + offset, np.float32)

    def _ring_rotations(self, figure: PosedFigure) -> Array:
        """Interpolated rotations of the rings, (R, 3, 3)."""
        of_frame = quaternions(figure.rotations)
        first, second = of_frame[self._ring_frames[:, 0]], of_frame[self._ring_frames[:, 1]]
        same = np.sign((first * second).sum(1, keepdims=True))
        same[same == 0.0] = 1.0
        weight = self._ring_weight[:, None]
        blend = (1.0 - weight) * first + weight * same * second
        return rotations_of(blend / np.linalg.norm(blend, axis=1, keepdims=True))


def build_skin(
    amputated: str | None = None, stump: float = 0.15, girth: float = 1.0, dressing: str = "bare"
) -> Skin:
    """Build the surface of a person, whose limb may end ``stump`` metres from its root.

    ``girth`` scales the thickness of trunk, arms and legs; ``dressing`` is a name in `DRESSINGS`.
    """
    tubes = [_torso(girth), _neck_and_head(), *_nose_and_ears()]
    sleeve = None
    for side in ("left", "right"):
        for kind, whole, root in (("arm", _arm(girth), 4), ("leg", _leg(girth), 12)):
            limb = whole
            if amputated == f"{side}_{kind}":
                end = REST_JOINTS[root, 1] - stump
                limb = [_cut(whole[0], end)]
                if dressing == "bandage":
                    limb.append(_bandage(limb[0], end + 0.6 * stump))
                elif dressing == "sleeve":
                    cloth, sleeve = _empty_sleeve(whole[0], kind, side, end)
                    limb.append(cloth)
            tubes += (
                [_named(tube, f"{side}_{kind}") for tube in limb]
                if side == "left"
                else [_mirrored(_named(tube, f"{side}_{kind}")) for tube in limb]
            )
    return replace(_joined(tubes), _sleeve=sleeve)


def _bandage(stump: _Tube, top: float) -> _Tube:
    """A layer of cloth around the end of a stump, below the height ``top``."""
    below = stump.centers[:, 1] < top
    thick = np.full(int(below.sum()), _BANDAGE)
    thick[0] = thick[-1] = -0.001  # the edge is inside the limb, and the end is closed
    centers = stump.centers[below].copy()
    centers[-1, 1] -= _BANDAGE
    return replace(
        stump,
        tile="bandage",
        centers=centers,
        radii=np.maximum(stump.radii[below] + thick[:, None], 1e-3),
        frames=stump.frames[below],
        weights=stump.weights[below],
        bones=stump.bones[below],
        along=_along(centers[:, 1]),
    )


def _empty_sleeve(limb: _Tube, kind: str, side: str, end: float) -> tuple[_Tube, _Sleeve]:
    """Flat cloth from the end of a left stump to the former wrist or ankle.

    A sleeve hangs from the stump of an arm. A trouser leg continues to the knee, as on a seat, and
    hangs from there.
    """
    joint, last = (5, 6) if kind == "arm" else (13, 14)
    bearer, limp = ("upper-arm", "forearm") if kind == "arm" else ("thigh", "shin")
    hangs = end if kind == "arm" else min(end, float(REST_JOINTS[joint, 1]))
    top, bottom = end + 0.02, float(REST_JOINTS[last, 1]) + 0.04
    place = np.linspace(top, bottom, 40)
    height = limb.centers[::-1, 1]  # ascending
    width, back, front = (np.interp(place, height, limb.radii[::-1, i]) for i in (0, 2, 3))
    way = np.clip((top - place) / 0.10, 0.0, 1.0)[:, None]
    round_part = np.column_stack([width, width, back, front]) + 0.006
    folds = 1.0 + 0.12 * np.sin(40.0 * place)
    flat = np.column_stack([1.15 * width * folds] * 2 + [np.full(40, _SLEEVE_THICK)] * 2)
    radii = (1.0 - way) * round_part + way * flat
    radii[[0, -1]] = 0.003  # closed
    frames, weights = _chain(place, [hangs], [f"left-{bearer}", f"left-{limp}"])
    centers = _upright(place, float(limb.centers[0, 0]))
    cloth = replace(
        limb,
        centers=centers,
        radii=radii,
        frames=frames,
        weights=weights,
        bones=np.full(40, joint),
        along=0.75 * _along(place),  # without cuffs and socks
    )
    mirror = 1.0 if side == "left" else -1.0
    from_end = np.array([mirror * centers[0, 0], hangs, 0.0])
    limp_frame, bearing_frame = (FRAMES.index(f"{side}-{frame}") for frame in (limp, bearer))
    return cloth, _Sleeve(limp_frame, bearing_frame, from_end)


def _named(tube: _Tube, name: str) -> _Tube:
    return replace(tube, name=name)


def _mirrored(tube: _Tube) -> _Tube:
    return replace(
        tube,
        centers=tube.centers * (-1.0, 1.0, 1.0),
        radii=tube.radii[:, [1, 0, 2, 3]],
        frames=np.array([[mirrored_frame(f) for f in pair] for pair in tube.frames.tolist()]),
        bones=np.array([MIRRORED_JOINTS[bone] for bone in tube.bones.tolist()]),
    )


def _cut(tube: _Tube, end: float) -> _Tube:
    """The tube down to the height ``end``, with a round end."""
    height = tube.centers[:, 1]
    kept = height >= end
    way = np.linspace(0.0, 1.0, 8)[1:]
    cap = np.sqrt(1.0 - way**2 * 0.999)
    last = np.flatnonzero(kept)[-1]
    step = np.arange(len(way))

    def extended(values: NDArray[_Number]) -> NDArray[_Number]:
        return np.concatenate([values[kept], np.repeat(values[last : last + 1], len(way), 0)])

    centers, radii = extended(tube.centers), extended(tube.radii)
    first = int(kept.sum())
    centers[first + step, 1] -= _CAP * way
    radii[first:] *= cap[:, None]
    return replace(
        tube,
        centers=centers,
        radii=radii,
        frames=extended(tube.frames),
        weights=extended(tube.weights),
        bones=extended(tube.bones),
        along=extended(tube.along),
    )


def _joined(tubes: Sequence[_Tube]) -> Skin:
    """Return one skin of all tubes, whose faces look outwards, also those of mirrored tubes."""
    faces, bones, limbs, tiles, texcoords, rings, offsets = [], [], [], [], [], [], []
    breaths = []
    limb_names = list(LIMBS)
    first_vertex = first_ring = 0
    for tube in tubes:
        count, columns = len(tube.centers), tube.segments + 1
        made, ring = _strip_faces(count, tube.segments)
        offset = _offsets(tube).reshape(-1, 3)
        corners = (np.repeat(tube.centers, columns, axis=0) + offset)[made]
        if np.linalg.det(corners).sum() < 0.0:  # signed volume: fronts must face outwards
            made = made[:, ::-1]
        faces.append(made + first_vertex)
        trunk = tube.tile == "torso"
        middle = corners.mean(axis=1)
        bones.append(nearest_bone(middle, _TRUNK, REST_JOINTS) if trunk else tube.bones[ring])
        limb = limb_names.index(tube.name) if tube.name in limb_names else -1
        limbs.append(np.full(len(made), limb))
        tiles.append(np.full(len(made), TILES.index(tube.tile)))
        around = np.broadcast_to(np.linspace(0.0, 1.0, columns), (count, columns))
        along = np.broadcast_to(tube.along[:, None], (count, columns))
        texcoords.append(np.stack([around, along], 2).reshape(-1, 2))
        offsets.append(offset)
        breaths.append(_breath(tube, offset, columns) if trunk else np.zeros(len(offset)))
        rings.append(np.repeat(np.arange(count), columns) + first_ring)
        first_vertex += count * columns
        first_ring += count
    return Skin(
        np.concatenate(faces).astype(np.int32),
        np.concatenate(bones).astype(np.uint8),
        np.concatenate(limbs).astype(np.int8),
        np.concatenate(tiles).astype(np.uint8),
        np.concatenate(texcoords).astype(np.float32),
        np.concatenate([tube.centers for tube in tubes]),
        np.concatenate([tube.frames for tube in tubes]),
        np.concatenate([tube.weights for tube in tubes]),
        np.concatenate(rings),
        np.concatenate(offsets),
        np.concatenate(breaths),
    )


def _breath(tube: _Tube, offset: Array, columns: int) -> Array:
    """Factor on the chest's motion, (V,): largest at the front, 0 at the sides and the back."""
    ahead = np.maximum(offset[:, 2], 0.0) / np.repeat(tube.radii[:, 3], columns)
    height, reach = _BREATH
    from_middle = (np.repeat(tube.centers[:, 1], columns) - height) / reach
    return np.asarray(ahead * np.exp(-(from_middle**2)))


def _strip_faces(rings: int, segments: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Faces between rings, and the ring of each; diagonals are symmetric about the middle."""
    ring, column = np.mgrid[: rings - 1, :segments]
    a = ring * (segments + 1) + column
    b, c = a + 1, a + segments + 1
    d = c + 1
    left = column < segments // 2
    first = np.where(left[..., None], np.stack([a, b, c], 2), np.stack([a, b, d], 2))
    second = np.where(left[..., None], np.stack([b, d, c], 2), np.stack([a, d, c], 2))
    faces = np.stack([first, second], 2).reshape(-1, 3)
    return faces, np.repeat(ring.ravel(), 2)


def _offsets(tube: _Tube) -> Array:
    """Offsets from the ring's centre, (R, segments + 1, 3): from behind (or below) to the left."""
    half = np.linspace(0.0, np.pi, tube.segments // 2 + 1)
    power = 2.0 / tube.exponent
    s = np.sin(half) ** power
    s[-1] = 0.0
    c = np.cos(half)
    c = np.sign(c) * np.abs(c) ** power
    s = np.concatenate([s, -s[-2::-1]])
    c = np.concatenate([c, c[-2::-1]])
    to_right, to_left, to_back, to_front = (tube.radii[:, i, None] for i in range(4))
    aside = np.where(s >= 0.0, to_left, to_right) * s
    ahead = np.where(c <= 0.0, to_front, to_back) * -c
    nothing = np.zeros_like(aside)
    parts = [aside, nothing, ahead] if tube.axis == 1 else [aside, ahead, nothing]
    return np.stack(parts, 2)


# --- Parts ------------------------------------------------------------------------------------


def _rings(table: Sequence[tuple[float, ...]], spacing: float) -> Array:
    """Interpolate a table about every ``spacing`` metres, and smooth it; the ends are kept.

    Columns, in metres: position along the axis, half width, extent ahead, extent back. Those of
    `_shoe` differ.
    """
    keys = np.array(table)
    steps = max(4, round(abs(keys[-1, 0] - keys[0, 0]) / spacing))
    place = np.linspace(0.0, 1.0, 4 * steps + 1)
    key_place = (keys[:, 0] - keys[0, 0]) / (keys[-1, 0] - keys[0, 0])
    rows = np.column_stack([np.interp(place, key_place, keys[:, i]) for i in range(keys.shape[1])])
    for _ in range(6):
        rows[1:-1] = 0.25 * rows[:-2] + 0.5 * rows[1:-1] + 0.25 * rows[2:]
    # Ends are round, so that they need more rings.
    where = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, steps + 1))
    where = 0.6 * np.linspace(0.0, 1.0, steps + 1) + 0.4 * where
    return np.column_stack([np.interp(where, place, column) for column in rows.T])


def _radii(rings: Array, *, right: float = 1.0, left: float = 1.0) -> Array:
    """Return the radii of a `_Tube`, which names the back before the front, unlike `_rings`.

    ``right`` and ``left`` are factors on the half width at each side.
    """
    half_width, ahead, back = rings[:, 1:].T
    return np.column_stack([right * half_width, left * half_width, back, ahead])


def _blend(place: Array, joint: float, sign: float = -1.0, width: float = _BEND) -> Array:
    """Weight of the frame beyond a joint: 0 to 1, smooth."""
    way = np.clip((sign * (place - joint) / width + 1.0) / 2.0, 0.0, 1.0)
    weight: Array = way**2 * (3.0 - 2.0 * way)
    return weight


def _chain(
    place: Array, joints: Sequence[float], frames: Sequence[str], *, sign: float = -1.0
) -> tuple[NDArray[np.intp], Array]:
    """The two frames and the weight of each ring along a chain of frames."""
    numbers = [FRAMES.index(frame) for frame in frames]
    pairs = np.tile(numbers[:2], (len(place), 1))
    weights = np.zeros(len(place))
    for i, joint in enumerate(joints):
        weight = _blend(place, joint, sign)
        begun = weight > 0.0
        pairs[begun] = numbers[i : i + 2]
        weights[begun] = weight[begun]
    return pairs, weights


def _torso(girth: float) -> _Tube:
    """Return trunk and neck, which bend at the waist and rise at the shoulders, with folds."""
    rows = _rings(
        [
            (-0.118, 0.012, 0.012, 0.012),
            (-0.112, 0.070, 0.050, 0.060),
            (-0.085, 0.120, 0.074, 0.100),
            (-0.04, 0.156, 0.092, 0.122),
            (0.01, 0.166, 0.102, 0.122),
            (0.07, 0.158, 0.106, 0.105),
            (0.14, 0.146, 0.106, 0.095),
            (0.20, 0.141, 0.106, 0.093),
            (0.28, 0.148, 0.110, 0.098),
            (0.36, 0.160, 0.117, 0.108),
            (0.42, 0.168, 0.114, 0.112),
            (0.465, 0.176, 0.100, 0.106),
            (0.50, 0.178, 0.084, 0.092),
            (0.522, 0.162, 0.070, 0.080),
            (0.540, 0.118, 0.060, 0.072),
            (0.556, 0.080, 0.054, 0.066),
            (0.575, 0.064, 0.052, 0.062),
            (0.60, 0.056, 0.050, 0.058),
            (0.64, 0.050, 0.046, 0.054),
            (0.66, 0.010, 0.010, 0.010),
        ],
        0.0115,
    )
    rows[:, 1:] *= _CLOTHED * girth
    place = rows[:, 0]
    frames, weights = _chain(
        place, [0.31, 0.49, 0.60], ["pelvis", "chest", "chest", "head"], sign=1.0
    )
    bend = _blend(place, 0.27, 1.0, 0.12)  # a back bends over a longer part than a joint
    bends = place < 0.40
    frames[bends], weights[bends] = (0, 1), bend[bends]
    # Shoulders move up and down: rings at the roots of the arms follow the girdle.
    girdle = np.exp(-(((place - 0.48) / 0.045) ** 2))
    shoulders = (place >= 0.40) & (place < 0.56)
    frames[shoulders], weights[shoulders] = (1, FRAMES.index("girdle")), girdle[shoulders]
    fold = 0.0025 * np.sin(55.0 * place) * (place > 0.02) * (place < 0.45)
    return _Tube(
        "trunk",
        "torso",
        56,
        _upright(place, 0.0),
        _radii(rows) + fold[:, None],
        frames,
        weights,
        np.zeros(len(rows), np.intp),  # bones of the faces differ around a ring
        _along(place),
        exponent=2.3,
    )


def _upright(place: Array, x: float, z: Array | float = 0.0) -> Array:
    return np.column_stack([np.full(len(place), x), place, np.broadcast_to(z, place.shape)])


def _along(place: Array) -> Array:
    """Texture coordinate along a part: 0 at the top, 1 at the bottom."""
    return np.asarray((place.max() - place) / np.ptp(place))


def _neck_and_head() -> _Tube:
    rows = _rings(
        [
            (0.870, 0.010, 0.010, 0.010),
            (0.866, 0.034, 0.036, 0.042),
            (0.850, 0.056, 0.060, 0.068),
            (0.825, 0.070, 0.082, 0.090),
            (0.79, 0.076, 0.094, 0.101),
            (0.755, 0.076, 0.093, 0.102),
            (0.72, 0.071, 0.094, 0.096),
            (0.69, 0.064, 0.094, 0.083),
            (0.665, 0.055, 0.090, 0.066),
            (0.648, 0.046, 0.082, 0.050),
            (0.636, 0.034, 0.066, 0.032),
            (0.632, 0.010, 0.020, 0.010),
        ],
        0.008,
    )
    frame = np.full((len(rows), 2), FRAMES.index("head"))
    return _Tube(
        "trunk",
        "head",
        40,
        _upright(rows[:, 0], 0.0),
        _radii(rows),
        frame,
        np.zeros(len(rows)),
        np.full(len(rows), 3),
        _along(rows[:, 0]),
        exponent=2.1,
    )


def _ball(center: tuple[float, float, float], radii: tuple[float, float, float]) -> _Tube:
    """An ellipsoid on the head."""
    angle = np.linspace(0.02, np.pi - 0.02, 9)
    place = center[1] + radii[1] * np.cos(angle)
    girth = np.sin(angle)[:, None] * (radii[0], radii[0], radii[2], radii[2])
    return _Tube(
        "trunk",
        "skin",
        12,
        _upright(place, center[0], center[2]),
        girth,
        np.full((9, 2), FRAMES.index("head")),
        np.zeros(9),
        np.full(9, 3),
        np.full(9, 0.5),
    )


def _nose_and_ears() -> list[_Tube]:
    ear = _ball((0.077, 0.735, -0.008), (0.010, 0.030, 0.018))
    return [_ball((0.0, 0.722, 0.093), (0.013, 0.024, 0.019)), ear, _mirrored(ear)]


def _arm(girth: float) -> list[_Tube]:
    """Return the left arm down to the palm, and its fingers; the right arm is its mirror image."""
    x, top = REST_JOINTS[4, 0], REST_JOINTS[4, 1]
    rows = _rings(
        [
            (0.040, 0.010, 0.010, 0.010),
            (0.036, 0.026, 0.030, 0.030),
            (0.022, 0.042, 0.047, 0.050),
            (-0.01, 0.051, 0.056, 0.059),
            (-0.06, 0.051, 0.056, 0.057),
            (-0.15, 0.046, 0.051, 0.048),
            (-0.23, 0.040, 0.043, 0.042),
            (-0.27, 0.039, 0.042, 0.042),
            (-0.32, 0.041, 0.045, 0.043),
            (-0.40, 0.035, 0.038, 0.037),
            (-0.48, 0.026, 0.030, 0.030),
            (-0.52, 0.022, 0.032, 0.029),
            (-0.55, 0.017, 0.042, 0.036),
            (-0.585, 0.015, 0.042, 0.040),
            (-0.605, 0.012, 0.038, 0.038),
            (-0.612, 0.006, 0.015, 0.015),
        ],
        0.0105,
    )
    rows[:, 1:] *= _CLOTHED * girth
    place = top + rows[:, 0]
    joints = REST_JOINTS[[4, 5, 6], 1].tolist()
    frames, weights = _chain(
        place, joints, ["girdle", "left-upper-arm", "left-forearm", "left-hand"]
    )
    bones = np.select(
        [place > joints[0], place > joints[1], place > joints[2]], [4, 5, 6], default=7
    )
    palm = _Tube(
        "left_arm",
        "arm",
        28,
        _upright(place, x),
        _radii(rows),
        frames,
        weights,
        bones,
        _along(place),
    )
    return [palm, *_fingers(x, top)]


def _fingers(x: float, top: float) -> Iterable[_Tube]:
    """Four fingers below the palm, and the thumb ahead of it."""
    for z, length, girth in (
        (0.029, 0.076, 0.0085),
        (0.010, 0.085, 0.009),
        (-0.010, 0.079, 0.0088),
        (-0.028, 0.064, 0.0078),
    ):
        yield _finger((x, top - 0.598, z), (0.0, -length, 0.12 * z), girth, 21)
    yield _finger((x, top - 0.535, 0.026), (-0.008, -0.062, 0.042), 0.0115, 22)


def _finger(
    start: tuple[float, float, float], way: tuple[float, float, float], girth: float, bone: int
) -> _Tube:
    place = np.array([0.0, 0.1, 0.4, 0.7, 0.88, 0.96, 1.0])
    size = girth * np.array([0.8, 1.0, 1.0, 0.95, 0.8, 0.55, 0.1])
    centers = np.asarray(start) + place[:, None] * way
    return _Tube(
        "left_arm",
        "skin",
        10,
        centers,
        np.repeat(size[:, None], 4, axis=1),
        np.full((len(place), 2), FRAMES.index("left-hand")),
        np.zeros(len(place)),
        np.full(len(place), bone),
        np.full(len(place), 0.5),
    )


def _leg(girth: float) -> list[_Tube]:
    """Return the left leg, which is wider outwards than inwards, and its shoe."""
    x, top = REST_JOINTS[12, 0], REST_JOINTS[12, 1]
    rows = _rings(
        [
            (0.075, 0.010, 0.010, 0.010),
            (0.065, 0.045, 0.045, 0.050),
            (0.03, 0.074, 0.080, 0.090),
            (-0.02, 0.084, 0.092, 0.102),
            (-0.08, 0.084, 0.092, 0.098),
            (-0.16, 0.078, 0.086, 0.086),
            (-0.26, 0.068, 0.075, 0.072),
            (-0.35, 0.058, 0.064, 0.058),
            (-0.40, 0.056, 0.062, 0.054),
            (-0.45, 0.053, 0.054, 0.060),
            (-0.52, 0.053, 0.050, 0.072),
            (-0.60, 0.046, 0.046, 0.062),
            (-0.70, 0.039, 0.042, 0.046),
            (-0.765, 0.038, 0.043, 0.044),
            (-0.80, 0.036, 0.045, 0.046),
            (-0.825, 0.030, 0.040, 0.040),
            (-0.835, 0.010, 0.015, 0.015),
        ],
        0.0145,
    )
    rows[:, 1:] *= _CLOTHED * girth
    place = top + rows[:, 0]
    joints = REST_JOINTS[[12, 13, 14], 1].tolist()
    frames, weights = _chain(place, joints, ["pelvis", "left-thigh", "left-shin", "left-foot"])
    bones = np.select(
        [place > joints[0], place > joints[1], place > joints[2]], [12, 13, 14], default=15
    )
    trouser = _Tube(
        "left_leg",
        "leg",
        32,
        _upright(place, x),
        _radii(rows, right=0.9, left=1.05),
        frames,
        weights,
        bones,
        _along(place),
    )
    return [trouser, _shoe(x)]


def _shoe(x: float) -> _Tube:
    """Return the left shoe, whose rings stand one behind the other from heel to toe."""
    ankle = REST_JOINTS[14, 1]
    rows = _rings(  # position along z, half width, heights of the upper side and of the sole
        [
            (-0.072, 0.008, -0.045, -0.060),
            (-0.068, 0.024, -0.015, -0.073),
            (-0.045, 0.036, 0.010, -0.075),
            (0.0, 0.040, 0.014, -0.075),
            (0.05, 0.041, -0.012, -0.075),
            (0.10, 0.046, -0.030, -0.075),
            (0.15, 0.046, -0.038, -0.075),
            (0.18, 0.036, -0.044, -0.074),
            (0.193, 0.022, -0.050, -0.072),
            (0.198, 0.006, -0.058, -0.066),
        ],
        0.0125,
    )
    middle, half = (rows[:, 2] + rows[:, 3]) / 2.0, (rows[:, 2] - rows[:, 3]) / 2.0
    centers = np.column_stack([np.full(len(rows), x), ankle + middle, rows[:, 0]])
    return _Tube(
        "left_leg",
        "foot",
        24,
        centers,
        np.column_stack([rows[:, 1], rows[:, 1], half, half]),
        np.full((len(rows), 2), FRAMES.index("left-foot")),
        np.zeros(len(rows)),
        np.full(len(rows), 15),
        _along(-rows[:, 0]),
        axis=2,
        exponent=2.6,
    )


def nearest_bone(points: Array, bones: Sequence[int], joints: Array) -> NDArray[np.intp]:
    """The bone nearest to each point [eq. 4.1]; ties go to the first.

    Parameters
    ----------
    points : (N, 3) float64
        Points, metres.
    bones : numbers of bones
        Candidates.
    joints : (25, 3) float64
        Joints in the frame of the points.
    """
    distances = []
    for bone in bones:
        start, end = joints[PARENTS[bone]], joints[bone]
        along = end - start
        way = np.clip(product(points - start, along) / product(along, along), 0.0, 1.0)
        distances.append(np.linalg.norm(points - start - way[:, None] * along, axis=1))
    return np.asarray(np.asarray(bones)[np.argmin(distances, axis=0)])
