"""The phantom limb is compared with the simulator's truth, the reflected intact limb."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d.metrics import closest_points
from manip3d.modify import PhantomFrame, PhantomPipeline, PhantomReason, PhantomState, PixelKind
from manip3d.rgbd import MIRRORED_JOINTS, TRACKED
from manip3d.simulate import BodySimulator, cast_mesh
from manip3d.simulate._figure import LIMBS
from manip3d.simulate.people import DEPTH_CAMERA, BodyCapture

pytest.importorskip("open3d")

CASES = [
    ("right_arm", "arm-raise"),
    ("left_arm", "arm-curl"),
    ("right_leg", "stepping"),
    ("left_leg", "knee-extension"),
]


def simulated(**options: Any) -> BodySimulator:
    return BodySimulator(color="none", room=False, **options)


def with_true_joints(capture: BodyCapture) -> BodyCapture:
    seen = capture.frame.skeletons[0]
    true = replace(seen, positions=capture.truth.joints)
    return replace(capture, frame=replace(capture.frame, skeletons=(true,)))


def points_of(result: PhantomFrame, kinds: tuple[PixelKind, ...]) -> NDArray[np.float64]:
    u, v = result.pixels[: result.num_points].T
    chosen = np.isin(result.kinds[v, u], kinds)
    return result.vertices[: result.num_points][chosen].astype(np.float64)


def errors_of(result: PhantomFrame, capture: BodyCapture, limb: str) -> NDArray[np.float64]:
    """Return the distances of the mirrored points to the true phantom limb."""
    points = points_of(result, (PixelKind.PHANTOM, PixelKind.AWAY))
    return closest_points(capture.truth.phantom(limb), points).distance  # type: ignore[arg-type]


@pytest.mark.parametrize("turn", [0.0, 10.0, 30.0, 45.0])
@pytest.mark.parametrize(("limb", "motion"), CASES)
def test_true_joints_and_depth_give_the_limb(limb: Any, motion: str, turn: float) -> None:
    capture = with_true_joints(
        simulated(motion=motion, amputated=limb, turn=turn, noise=0.0).capture(1.0)
    )
    result = PhantomPipeline(limb, smoothing=None).process(capture.frame)
    # The far leg is half hidden there, and the trunk beside the far arm is cut: degraded.
    if turn < 45.0 or limb not in ("right_leg", "right_arm"):
        assert result.state is PhantomState.TRACKING
    errors = errors_of(result, capture, limb)
    assert len(errors) > 200
    assert np.median(errors) <= 0.005  # (a)
    flat = PhantomPipeline(limb, smoothing=None, mode="2d").process(capture.frame)
    if turn >= 30:
        assert np.median(errors_of(flat, capture, limb)) > 4 * np.median(errors)
    joints = list(LIMBS[limb][:4])
    lengths = np.linalg.norm(np.diff(result.skeleton.positions[joints], axis=0), axis=1).sum()
    true = np.linalg.norm(np.diff(capture.truth.joints[joints], axis=0), axis=1).sum()
    assert lengths == pytest.approx(true, rel=0.01)


@pytest.mark.parametrize(("limb", "motion"), CASES)
def test_noise_of_the_sensor_is_all_that_is_added(limb: Any, motion: str) -> None:
    capture = with_true_joints(simulated(motion=motion, amputated=limb).capture(1.0))
    result = PhantomPipeline(limb, smoothing=None).process(capture.frame)
    errors = errors_of(result, capture, limb)
    i, j = result.source[np.isin(result.kinds, (PixelKind.PHANTOM, PixelKind.AWAY))].T
    camera = capture.frame.calibration.depth
    own = camera.unproject(capture.frame.depth)[i, j].astype(float)
    side, part = limb.split("_")
    intact = f"{'left' if side == 'right' else 'right'}_{part}"
    noise = closest_points(capture.truth.limb(intact), own).distance  # type: ignore[arg-type]
    assert np.median(errors) <= 0.005 + np.median(noise)  # (b)


@pytest.mark.parametrize("limb", ["left_arm", "right_arm", "left_leg", "right_leg"])
def test_sources_are_exact_where_nothing_is_filled(limb: Any) -> None:
    capture = simulated(motion="still", noise=0.0).capture(0.0)
    result = PhantomPipeline(limb, smoothing=None).process(capture.frame)
    drawn = result.kinds == PixelKind.PHANTOM
    i, j = result.source[drawn].T
    intact = [MIRRORED_JOINTS[bone] for bone in np.unique(result.labels[drawn])]
    labels = result.labels[i, j]
    # Points are mirrored before other body parts cover them, so nearly all come from the limb.
    assert np.isin(labels, intact).mean() > 0.99
    assert (capture.frame.body_index[i, j] == 0).all()  # type: ignore[index]


@pytest.mark.parametrize("turn", [-10.0, -5.0, 0.0, 5.0, 10.0])
def test_no_hole_over_two_pixels_up_to_ten_degrees(turn: float) -> None:
    ndimage = pytest.importorskip("scipy.ndimage")
    simulator = simulated(motion="arm-raise", amputated="right_arm", turn=turn, noise=0.0)
    for time in (1.2, 2.0):
        capture = with_true_joints(simulator.capture(time))
        result = PhantomPipeline("right_arm", smoothing=None).process(capture.frame)
        shown = result.kinds > 0
        # A gap between arm and trunk is a hole only if the true phantom or body is there.
        reflected = cast_mesh(capture.truth.phantom("right_arm"), DEPTH_CAMERA) > 0
        there = reflected | (capture.truth.people == 0)
        holes, _ = ndimage.label(ndimage.binary_fill_holes(shown) & ~shown & there)
        sizes = np.bincount(holes.ravel(), minlength=1)[1:]
        assert result.phantom.sum() > 1000
        assert sizes.max(initial=0) <= 2


@pytest.mark.parametrize("turn", [-25.0, -40.0])
def test_an_arm_whose_back_alone_is_known_hides_the_chest(turn: float) -> None:
    """A phantom arm hides the chest, although the camera sees only the intact arm's inner side."""
    simulator = simulated(motion="reach", amputated="left_arm", turn=turn, noise=0.0)
    capture = with_true_joints(simulator.capture(1.6))
    result = PhantomPipeline("left_arm", smoothing=None).process(capture.frame)
    true = cast_mesh(capture.truth.phantom("left_arm"), DEPTH_CAMERA)
    body = capture.frame.depth / 1000.0
    before = (true > 0) & (body > 0) & (true < body)  # pixels of the arm that hide the body
    assert before.sum() > 100
    drawn = result.phantom & (result.kinds != PixelKind.ROOT_FILLED)
    assert (drawn & before).sum() > 0.5 * before.sum()
    assert np.mean(result.depth[drawn & before] < body[drawn & before]) > 0.95


def test_occlusion_is_said_and_bridged() -> None:
    simulator = simulated(motion="arm-raise", amputated="right_arm", occluder=(0.5, 2.0), frames=75)
    pipeline = PhantomPipeline("right_arm")
    results = [pipeline.process(frame) for frame in simulator]
    states = [result.state for result in results]
    assert set(states[:15]) == {PhantomState.TRACKING}
    assert states[20] is PhantomState.HOLDING
    assert results[20].reason in (PhantomReason.OCCLUDED, PhantomReason.INFERRED)
    assert PhantomState.FADING in states
    assert states[50] is PhantomState.LOST
    assert states[-1] is PhantomState.TRACKING


def test_a_second_without_a_skeleton() -> None:
    simulator = simulated(motion="still", amputated="right_arm", lost=(0.5, 1.5), frames=60)
    pipeline = PhantomPipeline("right_arm")
    results = [pipeline.process(frame) for frame in simulator]
    assert all(r.state is PhantomState.TRACKING for r in (*results[:15], *results[46:]))
    lost = results[16:44]
    assert all(r.reason is PhantomReason.NO_JOINTS for r in lost)
    assert all(r.state is not PhantomState.TRACKING for r in lost)


def test_smoothing_steadies_the_hand() -> None:
    """Filters of joints reduce the jitter of the phantom hand; point (c) of the chapter's page."""
    frames = list(simulated(motion="still", jitter=0.01, frames=40))
    spread = []
    for smoothing in (None, "default", "seated"):
        pipeline = PhantomPipeline("right_arm", smoothing=smoothing)  # type: ignore[arg-type]
        hands = [pipeline.process(frame).skeleton.positions[11] for frame in frames]
        spread.append(np.std(hands[10:], axis=0).max())
    assert spread[0] > 0.03
    assert spread[2] < 0.7 * spread[1] < 0.7 * spread[0]


@pytest.mark.parametrize(
    ("limb", "motion"),
    [("left_arm", "elbow-bent"), ("right_arm", "still"), ("left_leg", "still")],
)
def test_an_empty_sleeve_goes_with_the_limb(limb: Any, motion: str) -> None:
    """Cloth that hangs beside made-up joints of a missing limb is taken out."""
    simulator = simulated(
        motion=motion,
        side="right" if limb.startswith("left") else "left",
        amputated=limb,
        dressing="sleeve",
        tracker="kinect-v2",
        frames=16,
        seed=2,
    )
    pipeline = PhantomPipeline(limb)
    left = []
    for number in range(16):
        capture = simulator.capture(number / 30.0)
        result = pipeline.process(capture.frame)
        points = DEPTH_CAMERA.unproject(capture.frame.depth)
        root = capture.truth.joints[LIMBS[limb][0]]
        cloth = np.isin(capture.truth.bones, LIMBS[limb][1:]) & (capture.frame.depth > 0)
        away = cloth & (np.linalg.norm(points - root, axis=-1) > 0.10)
        left.append((away & (result.kinds == PixelKind.BODY)).sum() / cloth.sum())
    assert np.median(left) < 0.10


@pytest.mark.parametrize(
    ("limb", "turn", "dressing"),
    [
        ("left_arm", 30.0, "sleeve"),
        ("left_leg", 30.0, "sleeve"),
        ("right_leg", -30.0, "sleeve"),
        ("left_leg", 30.0, "bare"),
        pytest.param("left_arm", 30.0, "bare", marks=pytest.mark.slow),
        pytest.param("right_leg", -30.0, "bare", marks=pytest.mark.slow),
    ],
)
def test_a_sleeve_of_a_turned_body_goes_or_is_not_tracking(
    limb: Any, turn: float, dressing: str
) -> None:
    """Cloth of a turned body is taken out, or the state is not tracking.

    The intact limb hides the places that would show that the cloth has no mirror image.
    """
    simulator = simulated(
        motion="still",
        side="right" if limb.startswith("left") else "left",
        amputated=limb,
        dressing=dressing,
        tracker="kinect-v2",
        turn=turn,
        frames=26,
        seed=2,
    )
    pipeline = PhantomPipeline(limb)
    for number in range(26):
        capture = simulator.capture(number / 30.0)
        result = pipeline.process(capture.frame)
        if number < 6 or number % 2:
            continue
        if dressing == "bare":
            assert result.reason is not PhantomReason.CLOTH
            continue
        points = DEPTH_CAMERA.unproject(capture.frame.depth)
        off = np.linalg.norm(points - capture.truth.joints[LIMBS[limb][0]], axis=-1)
        cloth = np.isin(capture.truth.bones, LIMBS[limb][1:]) & (capture.frame.depth > 0)
        left = (cloth & (off > 0.10) & (result.kinds == PixelKind.BODY)).sum()
        assert result.state is not PhantomState.TRACKING or left < 0.2 * cloth.sum()


@pytest.mark.parametrize("dressing", ["sleeve", "bare"])
def test_cloth_that_symmetry_cannot_tell_is_measured(dressing: str) -> None:
    """Cloth that stays, because joints of the missing leg lie at the stump, is measured."""
    simulator = simulated(
        motion="still",
        side="right",
        amputated="left_leg",
        dressing=dressing,
        jitter=0.006,
        correlation=0.6,
        bias=0.015,
        turn=30.0,
        frames=16,
        seed=2,
    )
    pipeline = PhantomPipeline("left_leg")
    shares = []
    for frame in simulator:
        told = frame.skeletons[0]
        states = told.states.copy()
        states[list(LIMBS["left_leg"][1:])] = TRACKED
        seen = replace(frame, skeletons=(replace(told, states=states),))
        shares.append(pipeline.process(seen).quality.cloth)
    assert (np.median(shares[6:]) > 0.02) == (dressing == "sleeve")


@pytest.mark.parametrize(("limb", "motion"), [("left_arm", "elbow-bent"), ("right_arm", "reach")])
def test_joints_that_fly_take_nothing_of_chest_and_neck(limb: Any, motion: str) -> None:
    """Joints of a missing arm that a Kinect V2 places about the person take nothing out."""
    simulator = simulated(motion=motion, amputated=limb, tracker="kinect-v2", turn=20.0, seed=7)
    pipeline = PhantomPipeline(limb)
    for number in range(16):
        capture = simulator.capture(number / 30.0)
        result = pipeline.process(capture.frame)
        points = DEPTH_CAMERA.unproject(capture.frame.depth)
        off = np.linalg.norm(points - capture.truth.joints[LIMBS[limb][0]], axis=-1)
        mine = np.isin(capture.truth.bones, LIMBS[limb][1:])
        rest = (capture.frame.body_index == 0) & (capture.truth.people == 0) & ~mine & (off > 0.12)
        assert result.state is PhantomState.TRACKING
        assert (rest & (result.kinds == PixelKind.NONE)).sum() < 0.015 * rest.sum()


def test_an_arm_that_the_camera_looks_through_is_not_mirrored() -> None:
    """An arm whose joints lie far before their pixels, as in a mirrored image, is not mirrored."""
    body = simulated(motion="reach", amputated="right_arm", tracker="kinect-v2", seed=1)
    pipeline = PhantomPipeline("right_arm")
    for number in range(20):
        frame = body.capture(1.3 + number / body.rate).frame
        assert frame.body_index is not None
        depth, index = (np.ascontiguousarray(a[:, ::-1]) for a in (frame.depth, frame.body_index))
        result = pipeline.process(replace(frame, depth=depth, body_index=index))
        assert result.state is PhantomState.LOST, number
        assert result.reason is PhantomReason.OCCLUDED
