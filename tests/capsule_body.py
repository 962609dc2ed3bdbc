"""A person of capsules for tests: the joints of a pose, and its exact depth image."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, Skeleton
from manip3d.rgbd import JOINTS, PARENTS

KINECT = Intrinsics(512, 424, 365.0, 365.0, 255.5, 211.5)
SMALL = Intrinsics(192, 160, 137.0, 137.0, 95.5, 79.5)

# Metres from SpineBase, person's left at +x, y up, towards the camera -z; it stands with arms a
# little off the body.
_MIDDLE = {
    "SpineBase": (0, 0, 0),
    "SpineMid": (0, 0.30, 0),
    "SpineShoulder": (0, 0.50, 0),
    "Neck": (0, 0.56, 0),
    "Head": (0, 0.72, 0),
}
_LEFT = {
    "Shoulder": (0.19, 0.46, 0),
    "Elbow": (0.32, 0.22, 0),
    "Wrist": (0.40, -0.01, -0.04),
    "Hand": (0.42, -0.08, -0.05),
    "HandTip": (0.44, -0.16, -0.06),
    "Thumb": (0.38, -0.07, -0.10),
    "Hip": (0.10, -0.06, 0),
    "Knee": (0.13, -0.48, -0.01),
    "Ankle": (0.14, -0.88, 0.02),
    "Foot": (0.15, -0.93, -0.13),
}
RADII = {"Shoulder": 0.07, "Elbow": 0.05, "Wrist": 0.04, "Hand": 0.04, "HandTip": 0.035,
         "Thumb": 0.015, "Hip": 0.11, "Knee": 0.08, "Ankle": 0.055, "Foot": 0.045,
         "SpineMid": 0.15, "SpineShoulder": 0.15, "Neck": 0.06, "Head": 0.09}  # fmt: skip


def pose(
    moved: dict[str, tuple[float, float, float]] | None = None,
    *,
    turn_deg: float = 0.0,
    at: tuple[float, float, float] = (0.0, 0.0, 2.44),
    missing: tuple[str, ...] = (),
    inferred: tuple[str, ...] = (),
    identity: int = 1,
    body: int = 0,
) -> Skeleton:
    """Return a standing person with some joints moved, turned about the vertical, at a place.

    It faces the camera, so that its left is at the camera's +x.
    """
    joints = {name: np.array(p, float) for name, p in _MIDDLE.items()}
    for name, p in _LEFT.items():
        joints[name + "Left"] = np.array(p, float)
        joints[name + "Right"] = np.array(p, float) * (-1, 1, 1)
    for name, p in (moved or {}).items():
        joints[name] = np.array(p, float)
    local = np.array([joints[name] for name in JOINTS]) * (1, -1, 1)
    angle = np.deg2rad(turn_deg)
    c, s = np.cos(angle), np.sin(angle)
    turned = local @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    states = np.full(25, 2, np.uint8)
    for name in inferred:
        states[JOINTS.index(name)] = 1
    for name in missing:
        states[JOINTS.index(name)] = 0
    return Skeleton(turned + at, states=states, id=identity, body=body)


def bones(skeleton: Skeleton) -> list[tuple[int, NDArray[np.float64], NDArray[np.float64], float]]:
    """Return number, ends and radius of each capsule whose two joints are known."""
    found = []
    for bone in range(25):
        parent = PARENTS[bone]
        if bone == parent or not (skeleton.states[bone] and skeleton.states[parent]):
            continue
        radius = RADII[JOINTS[bone].removesuffix("Left").removesuffix("Right")]
        ends = skeleton.positions[[parent, bone]].astype(float)
        found.append((bone, ends[0], ends[1], radius))
    return found


def hit_depth(
    rays: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64], radius: float
) -> NDArray[np.float64]:
    """Return the depth at which each ray (x, y, 1) first meets a capsule; infinite if it misses."""
    axis = b - a
    length2 = axis @ axis
    with np.errstate(invalid="ignore", divide="ignore"):

        def ball(centre: NDArray[np.float64]) -> NDArray[np.float64]:
            p = (rays**2).sum(-1)
            q = rays @ centre
            root = q * q - p * (centre @ centre - radius * radius)
            return np.where(root > 0, (q - np.sqrt(root)) / p, np.inf)

        depth = np.minimum(ball(a), ball(b))
        if length2 > 0:
            along = rays @ axis / length2
            across = rays - along[..., None] * axis
            start = a - (a @ axis / length2) * axis
            p = (across**2).sum(-1)
            q = across @ start
            root = q * q - p * (start @ start - radius * radius)
            z = np.where(root > 0, (q - np.sqrt(root)) / p, np.inf)
            t = z * along - a @ axis / length2
            depth = np.minimum(depth, np.where((t > 0) & (t < 1), z, np.inf))
    return depth


@functools.lru_cache(maxsize=4)
def pixel_rays(camera: Intrinsics) -> NDArray[np.float64]:
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
    rays = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1
    )
    rays.flags.writeable = False
    return rays


def _box(camera: Intrinsics, ends: NDArray[np.float64], radius: float) -> tuple[slice, slice]:
    """Return a box of pixels that contains the image of a capsule."""
    if (ends[:, 2] <= 2 * radius).any():
        return np.s_[:, :]
    centre = ends[:, :2] / ends[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    reach = 1.3 * camera.fx * radius / (ends[:, 2].min() - radius) + 2
    low = np.maximum(centre.min(0) - reach, 0).astype(int)
    high = np.maximum(centre.max(0) + reach, 0).astype(int)
    return np.s_[low[1] : high[1], low[0] : high[0]]


def render(
    skeleton: Skeleton, camera: Intrinsics, *, without: tuple[int, ...] = ()
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the depth in metres (0: nothing) and the true bone (0: none) of each pixel."""
    joints = skeleton.positions.tobytes(), skeleton.states.tobytes()
    depth, label = _rendered(*joints, camera, without)
    return depth.copy(), label.copy()


# In many tests people keep still, and to render them takes most of the time.
@functools.lru_cache(maxsize=16)
def _rendered(
    positions: bytes, states: bytes, camera: Intrinsics, without: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    skeleton = Skeleton(
        np.frombuffer(positions, np.float32).reshape(25, 3),
        states=np.frombuffer(states, np.uint8),
    )
    rays = pixel_rays(camera)
    depth = np.full(rays.shape[:2], np.inf)
    label = np.zeros(rays.shape[:2], np.uint8)
    for bone, a, b, radius in bones(skeleton):
        if bone in without:
            continue
        box = _box(camera, np.stack([a, b]), radius)
        hit = hit_depth(rays[box], a, b, radius)
        label[box][hit < depth[box]] = bone
        depth[box] = np.minimum(depth[box], hit)
    depth[~np.isfinite(depth)] = 0
    return depth, label


def surface_distance(
    points: NDArray[np.float64], skeleton: Skeleton, only: tuple[int, ...] | None = None
) -> NDArray[np.float64]:
    """Return the distance of points to the surface of the union of all or some capsules."""
    best = np.full(len(points), np.inf)
    for bone, a, b, radius in bones(skeleton):
        if only is not None and bone not in only:
            continue
        axis = b - a
        t = np.clip((points - a) @ axis / max(axis @ axis, 1e-30), 0, 1)
        best = np.minimum(best, np.linalg.norm(points - a - t[:, None] * axis, axis=1) - radius)
    return np.abs(best)


def frame(
    skeleton: Skeleton,
    camera: Intrinsics = SMALL,
    *,
    without: tuple[int, ...] = (),
    number: int = 0,
    people: tuple[Skeleton, ...] | None = None,
) -> RgbdFrame:
    """Return a frame of a camera at 30 Hz: depth in millimetres, body index and skeleton."""
    depth, _ = render(skeleton, camera, without=without)
    index = np.where(depth > 0, skeleton.body, 255).astype(np.uint8)
    return RgbdFrame(
        np.round(1000 * depth).astype(np.uint16),
        RgbdCalibration(camera),
        body_index=index,
        skeletons=(skeleton,) if people is None else people,
        time_ns=number * 33_333_333,
        number=number,
    )


def jittered(skeleton: Skeleton, rng: np.random.Generator, sigma: float) -> Skeleton:
    """Return the same pose with noise in every coordinate."""
    noise = rng.normal(0, sigma, (25, 3))
    return replace(skeleton, positions=skeleton.positions + noise)


def painted(number: int, *, hidden: bool = False) -> RgbdFrame:
    """Return a frame that is bit-identical on every machine, with bones painted as squares.

    Only sums and products are used, which round alike everywhere. If ``hidden``, the pixels of the
    left arm and the right leg belong to nobody.
    """
    stands = pose(at=(0.01 * number, 0.0, 2.44))  # not turned: no rounding that differs
    shift = np.arange(75).reshape(25, 3) * 7 % 11 * 0.002
    skeleton = replace(stands, positions=stands.positions.astype(float) + shift)
    depth = np.zeros((SMALL.height, SMALL.width), np.uint16)
    index = np.full(depth.shape, 255, np.uint8)
    steps = np.arange(25) / 24.0
    for bone in range(1, 25):
        a, b = skeleton.positions[[PARENTS[bone], bone]].astype(float)
        x, y, z = (a[i] + steps * (b[i] - a[i]) for i in range(3))
        us = np.rint(SMALL.fx * x / z + SMALL.cx).astype(int)
        vs = np.rint(SMALL.fy * y / z + SMALL.cy).astype(int)
        for u, v, mm in zip(us, vs, np.rint(1000 * z).astype(int) - 40, strict=True):
            square = np.s_[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4]
            depth[square] = mm + np.add.outer(np.arange(7), np.arange(7))[: len(depth[square])]
            is_arm = hidden and bone in (5, 6, 7, 21, 22, 17, 18, 19)
            index[square] = 255 if is_arm else 0
    return RgbdFrame(
        depth,
        RgbdCalibration(SMALL),
        body_index=index,
        skeletons=(skeleton,),
        time_ns=number * 33_333_333,
        number=number,
    )
