"""Small RGB-D frames with everything in them, for tests of sources and recorders."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from manip3d import Intrinsics, Registration, RgbdCalibration, RgbdFrame, Skeleton

ROWS, COLS = 12, 16
CAMERA = Intrinsics(COLS, ROWS, 15.0, 15.5, 7.25, 6.5)
CALIBRATION = RgbdCalibration(CAMERA)
STEP = 33_333_333  # nanoseconds


def skeleton(rng: np.random.Generator) -> Skeleton:
    """One whose numbers are hard to write down."""
    positions = rng.normal(size=(25, 3)).astype(np.float32)
    positions[3] = [np.nan, np.inf, -np.inf]
    positions[4] = [np.float32(1e-45), np.float32(3.4e38), -0.0]
    orientations = rng.normal(size=(25, 4)).astype(np.float32)
    states = rng.integers(0, 3, 25).astype(np.uint8)
    return Skeleton(positions, orientations, states, id=-(2**62) + 1, body=2)


def full_calibration() -> RgbdCalibration:
    """A ray table, and a colour camera of another size."""
    rays = np.stack(np.meshgrid(np.linspace(-1, 1, COLS), np.linspace(-1, 1, ROWS)), -1)
    rays[0, 0] = np.nan
    depth = Intrinsics(COLS, ROWS, 15.0, 15.5, 7.25, 6.5, rays=rays.astype(np.float32))
    color = Intrinsics(20, 10, 18.0, 18.5, 9.1, 5.2, distortion=(0.1, -0.02, 1e-3, 2e-3, 1 / 3))
    turn = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    return RgbdCalibration(depth, Registration(color, turn, np.array([0.05, 0.0, 1 / 3])))


def frames(
    count: int, calibration: RgbdCalibration = CALIBRATION, *, color: bool = True, seed: int = 0
) -> Iterator[RgbdFrame]:
    """Random images, two bodies, one skeleton; every third number is missing."""
    rng = np.random.default_rng(seed)
    camera = calibration.depth
    seen = calibration.registration.color if calibration.registration else camera
    for i in range(count):
        yield RgbdFrame(
            np.minimum(  # 65535 is no measurement
                rng.integers(0, 65536, (camera.height, camera.width), dtype=np.uint16), 65_534
            ),
            calibration,
            color=rng.integers(0, 256, (seen.height, seen.width, 3), dtype=np.uint8)
            if color
            else None,
            body_index=rng.choice(np.array([0, 2, 255], np.uint8), (camera.height, camera.width)),
            skeletons=(skeleton(rng),),
            time_ns=10**15 + i * STEP,
            number=i + i // 2,
        )


def assert_same(a: RgbdFrame, b: RgbdFrame, *, color: bool = True) -> None:
    """Bit for bit."""
    assert (a.time_ns, a.number) == (b.time_ns, b.number)
    images = ["depth", "body_index", *(["color"] if color else [])]
    for name in images:
        first, second = getattr(a, name), getattr(b, name)
        if first is None or second is None:
            assert first is second is None
        else:
            np.testing.assert_array_equal(first, second)
    assert len(a.skeletons) == len(b.skeletons)
    for one, other in zip(a.skeletons, b.skeletons, strict=True):
        assert (one.id, one.body) == (other.id, other.body)
        for name in ("positions", "orientations", "states"):
            first, second = getattr(one, name), getattr(other, name)
            np.testing.assert_array_equal(first, second)
            np.testing.assert_array_equal(np.signbit(first), np.signbit(second))
