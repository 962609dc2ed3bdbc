"""The phantom is steady, stays with its patient, and its state tells when it is unreliable."""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from capsule_body import KINECT, SMALL, frame, jittered, pose, render
from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, Skeleton, datasets
from manip3d.errors import InputError
from manip3d.modify import (
    Limb,
    PhantomFrame,
    PhantomPipeline,
    PhantomReason,
    PhantomState,
    PixelKind,
)
from manip3d.rgbd import INFERRED, JOINTS, MIRRORED_JOINTS
from manip3d.simulate import LIMBS, BodySimulator
from manip3d.simulate.people import DEPTH_CAMERA
from real_data import RealData

ARM = (9, 10, 11, 23, 24)  # bones of the right arm
HAND = JOINTS.index("HandLeft")
BODY = [JOINTS.index(name) for name in ("SpineBase", "SpineMid", "SpineShoulder", "Neck")]


def seen(
    skeleton: Skeleton, number: int, *, told: Skeleton | None = None, camera: Intrinsics = SMALL
) -> RgbdFrame:
    """Return a frame of a person without a right arm, with the skeleton ``told`` by the tracker."""
    image = frame(skeleton, camera, without=ARM, number=number)
    return replace(image, skeletons=(told or skeleton,))


def crowd(patient: Skeleton, visitor: Skeleton, number: int) -> RgbdFrame:
    """Return a frame of two people whose pixels are labelled by body, not by id."""
    a, b = frame(patient, without=ARM), frame(visitor)
    assert a.body_index is not None
    assert b.body_index is not None
    behind = (a.depth == 0) & (b.depth > 0)
    return replace(
        a,
        depth=np.where(behind, b.depth, a.depth),
        body_index=np.where(behind, b.body_index, a.body_index),
        skeletons=(patient, visitor),
        time_ns=(number + 1) * 33_333_333,
        number=number,
    )


# ---- the plane ------------------------------------------------------------------------------


def reflected_steps(sigma: float, turns: NDArray[np.float64], limb: Limb) -> NDArray[np.float64]:
    """Return metres per frame that the true hand's reflection moves beyond its true motion."""
    rng = np.random.default_rng(5)
    pipeline = PhantomPipeline(limb)
    extra, last = [], None
    for number, turn in enumerate(turns):
        truth = pose(turn_deg=float(turn))
        told = jittered(truth, rng, sigma)
        result = pipeline.process(seen(truth, number, told=told, camera=KINECT))
        assert result.plane is not None
        mine = result.plane(truth.positions[HAND].astype(float))
        true = truth.positions[MIRRORED_JOINTS[HAND]].astype(float)
        if last is not None:
            extra.append(np.linalg.norm(mine - last[0]) - np.linalg.norm(true - last[1]))
        last = mine, true
    return np.array(extra)


@pytest.mark.parametrize("sigma", [0.01, 0.02])
def test_the_plane_does_not_shake_with_the_joints(sigma: float) -> None:
    extra = reflected_steps(sigma, np.zeros(45), "right_arm")
    assert np.median(extra) < 0.005
    assert np.quantile(extra[10:], 0.95) < 0.015


@pytest.mark.parametrize("shift", [-0.02, 0.02])
def test_the_plane_is_that_of_the_flesh_where_all_joints_are_beside_it(shift: float) -> None:
    pipeline = PhantomPipeline("right_arm")
    truth = pose()
    told = replace(truth, positions=truth.positions + np.float32([shift, 0.0, 0.0]))
    for number in range(20):
        result = pipeline.process(seen(truth, number, told=told, camera=KINECT))
    assert result.plane is not None
    middle = truth.positions[[4, 8]].mean(axis=0).astype(float)
    assert abs(float(result.plane.normal @ (middle - result.plane.origin))) < 0.005


def test_the_plane_turns_with_the_body() -> None:
    """The plane has no lag at the end of a turn of 1 degree per frame."""
    rng = np.random.default_rng(1)
    pipeline = PhantomPipeline("right_arm")
    off = []
    for number in range(50):
        truth = pose(turn_deg=min(25.0, max(0.0, number - 15.0)))
        result = pipeline.process(
            seen(truth, number, told=jittered(truth, rng, 0.01), camera=KINECT)
        )
        assert result.plane is not None
        true = truth.positions[4].astype(float) - truth.positions[8]
        cosine = result.plane.normal @ true / np.linalg.norm(true)
        off.append(np.rad2deg(np.arccos(min(1.0, float(cosine)))))
    # 40 ms at 30 degrees a second are 1.2 degrees; the joints' mean is off by another one.
    assert np.median(off[20:40]) < 2.5


def degrees_off(result: PhantomFrame, truth: Skeleton) -> float:
    """Return the angle between the plane's normal and the true direction from right to left."""
    assert result.plane is not None
    true = truth.positions[4].astype(float) - truth.positions[8]
    cosine = abs(result.plane.normal @ true) / np.linalg.norm(true)
    return float(np.rad2deg(np.arccos(min(1.0, cosine))))


@functools.lru_cache(maxsize=1)
def turned(turn: float, camera: Intrinsics) -> list[tuple[Skeleton, RgbdFrame]]:
    """Return truth and frames of a body that turns suddenly after 0.8 seconds."""
    rng = np.random.default_rng(1)
    frames = []
    for number in range(36):
        truth = pose(turn_deg=turn if number >= 24 else 0.0)
        told = jittered(truth, rng, 0.01)
        frames.append((truth, seen(truth, number, told=told, camera=camera)))
    return frames


def turned_after(gap: float, turn: float, camera: Intrinsics) -> list[tuple[PhantomState, float]]:
    """Process a body that turned during a gap in the stream."""
    pipeline = PhantomPipeline("right_arm")
    rows = []
    for number, (truth, image) in enumerate(turned(turn, camera)):
        is_after = number >= 24
        time = image.time_ns + (round(1e9 * gap) if is_after else 0)
        result = pipeline.process(replace(image, time_ns=time))
        if is_after:
            rows.append((result.state, degrees_off(result, truth)))
    return rows


GAPS = [
    *((turn, 0.0) for turn in (20.0, 32.0, 36.0, 50.0)),  # from one frame to the next
    (40.0, 0.0),
    *((turn, gap) for turn in (40.0, 15.0, 25.0, 60.0) for gap in (0.1, 0.5, 2.0, 60.0)),
]


@pytest.mark.parametrize(
    ("camera", "turn", "gap"),
    [
        *(pytest.param(SMALL, *each, id=f"small-{each}") for each in GAPS),
        # The shortest and the longest gap; the others are those of the small image.
        *(pytest.param(KINECT, *each, id=f"kinect-{each}") for each in GAPS
          if each[1] not in (0.5, 2.0)),
    ],
)  # fmt: skip
def test_a_body_that_turned_during_a_gap(turn: float, gap: float, camera: Intrinsics) -> None:
    rows = turned_after(gap, turn, camera)
    wrong = [off for state, off in rows if state is PhantomState.TRACKING and off > 8.0]
    assert wrong == []
    assert rows[-1][1] < 8.0
    # At 60 degrees the intact shoulder is half hidden, and the phantom may be called detached.
    assert rows[-1][0] is PhantomState.TRACKING or turn > 40.0


def test_a_body_that_turned_while_it_was_not_seen() -> None:
    rng = np.random.default_rng(1)
    pipeline = PhantomPipeline("right_arm")
    for number in range(60):
        truth = pose(turn_deg=0.0 if number < 24 else 40.0)
        image = seen(truth, number, told=jittered(truth, rng, 0.01))
        if 24 <= number < 48:
            nobody = np.full(image.depth.shape, 255, np.uint8)
            image = replace(image, skeletons=(), depth=0 * image.depth, body_index=nobody)
        result = pipeline.process(image)
        if number >= 48 and result.state is PhantomState.TRACKING:
            assert degrees_off(result, truth) < 8.0, number
    assert result.state is PhantomState.TRACKING


@pytest.mark.parametrize("every", [1, 2])
def test_a_plane_that_the_joints_speak_against_is_not_believed(every: int) -> None:
    """A turn too fast for a body makes the plane shaky until it follows the joints.

    This also holds for a tracker that is slower than the camera.
    """
    pipeline = PhantomPipeline("right_arm")
    states = []
    for number in range(60):
        truth = pose(turn_deg=0.0 if number < 24 else 90.0)
        image = seen(truth, number)
        if number % every:
            image = replace(image, skeletons=())
        result = pipeline.process(image)
        if number > 24 and degrees_off(result, truth) > 15.0:
            assert result.quality.plane_deg > 15.0 or result.state is PhantomState.HOLDING
            states.append(result.state)
    assert PhantomState.TRACKING not in states
    assert 0 < len(states) < 12 * every
    assert degrees_off(result, truth) < 5.0


def with_a_shoulder_forward(truth: Skeleton, metres: float) -> Skeleton:
    positions = truth.positions.copy()
    positions[JOINTS.index("ShoulderRight"), 2] += metres
    return replace(truth, positions=positions)


def test_a_shoulder_that_is_told_wrong_once_does_not_turn_the_plane() -> None:
    rng = np.random.default_rng(1)
    pipeline = PhantomPipeline("right_arm")
    for number in range(40):
        truth = pose()
        told = jittered(with_a_shoulder_forward(truth, 0.2 if number == 24 else 0.0), rng, 0.005)
        assert degrees_off(pipeline.process(seen(truth, number, told=told)), truth) < 5.0


# A Kinect V1 told this of a person who sat down, leaning over the knees: for four frames its
# skeleton collapsed, and neck and shoulders sank to the hips. Centimetres in the trunk (to the
# left, up the spine, forward), of these joints.
COLLAPSING = (
    "SpineBase", "SpineMid", "SpineShoulder", "Neck", "ShoulderLeft", "ShoulderRight", "HipLeft",
    "HipRight",
)  # fmt: skip
COLLAPSE = (
    ((-7, -4, -1), (-8, -8, -1), (-13, -33, -2), (-9, -28, -5), (3, -22, -9), (-1, -5, 0),
     (-2, -5, 4), (-3, 3, 2)),
    ((-10, -6, -1), (-10, -12, -2), (-10, -39, -4), (-7, -35, -7), (4, -29, -11), (-2, -14, -2),
     (-4, -6, 4), (-7, 2, 8)),
    ((0, -10, -3), (-2, -15, -3), (-11, -42, -3), (-8, -37, -7), (-20, -22, 0), (-2, -26, -8),
     (-2, -5, -4), (9, 1, 3)),
    ((5, -1, -3), (5, -7, -2), (4, -35, -2), (4, -30, -5), (10, -21, -11), (-3, -31, -11),
     (4, -3, -6), (6, 1, 5)),
)  # fmt: skip


def collapsed(truth: Skeleton, step: int) -> Skeleton:
    """Return the skeleton in a frame of the collapse."""
    positions = truth.positions.astype(float)
    up = positions[JOINTS.index("SpineShoulder")] - positions[JOINTS.index("SpineBase")]
    up /= np.linalg.norm(up)
    left = positions[JOINTS.index("ShoulderLeft")] - positions[JOINTS.index("ShoulderRight")]
    left -= (left @ up) * up
    left /= np.linalg.norm(left)
    axes = np.stack([left, up, np.cross(left, up)])
    joints = [JOINTS.index(name) for name in COLLAPSING]
    positions[joints] += np.array(COLLAPSE[step]) / 100.0 @ axes
    return replace(truth, positions=positions.astype(np.float32))


def test_frames_without_depth_do_not_turn_the_plane() -> None:
    """Black depth images, as a full bus delivers them, do not turn the plane under joint errors."""
    rng = np.random.default_rng(3)
    whole, dropping = PhantomPipeline("left_leg"), PhantomPipeline("left_leg")
    angles = []
    for number in range(90):
        truth = pose(turn_deg=15.0 * np.sin(0.2 * number))
        image = seen(truth, number, told=jittered(truth, rng, 0.03), camera=KINECT)
        expected = whole.process(image)
        is_black = number % 7 == 3
        result = dropping.process(
            replace(image, depth=0 * image.depth if is_black else image.depth)
        )
        if is_black:
            assert result.reason is PhantomReason.NO_PERSON
            continue
        assert expected.plane is not None
        assert result.plane is not None
        angles.append(np.degrees(np.arccos(min(1.0, expected.plane.normal @ result.plane.normal))))
    assert max(angles[20:]) < 0.5


def test_a_skeleton_that_collapses_for_some_frames_does_not_turn_the_plane() -> None:
    """A skeleton of another shape than before is no turn of the body."""
    rng = np.random.default_rng(1)
    pipeline = PhantomPipeline("right_arm")
    for number in range(36):
        truth = pose()
        is_whole = not 24 <= number < 24 + len(COLLAPSE)
        told = jittered(truth if is_whole else collapsed(truth, number - 24), rng, 0.005)
        result = pipeline.process(seen(truth, number, told=told, camera=KINECT))
        assert degrees_off(result, truth) < 3.0, number


def test_five_frames_a_second_are_enough_for_a_swaying_body() -> None:
    rng = np.random.default_rng(1)
    pipeline = PhantomPipeline("right_arm")
    off = []
    for number in range(20):
        truth = pose(turn_deg=30.0 * np.sin(2.0 * np.pi * 0.8 * 0.2 * number))
        image = seen(truth, number, told=jittered(truth, rng, 0.01))
        result = pipeline.process(replace(image, time_ns=(number + 1) * 200_000_000))
        off.append(degrees_off(result, truth))
    assert max(off) < 5.0


def test_sides_that_a_tracker_swaps_do_not_move_the_phantom() -> None:
    truth = pose()
    swapped = replace(truth, positions=truth.positions[list(MIRRORED_JOINTS)])
    pipeline = PhantomPipeline("right_arm")
    normals = []
    for number in range(20):
        told = swapped if 10 <= number < 13 else truth
        result = pipeline.process(seen(truth, number, told=told))
        assert result.plane is not None
        normals.append(result.plane.normal)
    np.testing.assert_allclose(np.array(normals)[:, 0], 1.0, atol=0.02)


def test_sides_that_a_tracker_swaps_do_not_move_the_limb() -> None:
    """The phantom hand stays in place while joints of both sides are swapped for a moment."""
    # Without feet nothing but the tracker says which side is left.
    truth = pose({"HandLeft": (0.3, 0.2, -0.1)}, missing=("FootLeft", "FootRight"))
    swapped = replace(truth, positions=truth.positions[list(MIRRORED_JOINTS)])
    pipeline = PhantomPipeline("right_arm")
    hands = []
    for number in range(45):
        told = swapped if 10 <= number < 20 or number >= 25 else truth
        result = pipeline.process(seen(truth, number, told=told))
        hands.append(result.skeleton.positions[11])
    wanted = truth.positions[7] * (-1, 1, 1)
    np.testing.assert_allclose(hands[5:25], np.tile(wanted, (20, 1)), atol=0.04)
    # A tracker that keeps to it is believed after half a second.
    assert result.plane is not None
    assert result.plane.normal[0] < -0.9


def test_a_guessed_hip_does_not_hide_that_sides_are_swapped() -> None:
    """Swapped sides are recognised although a tracker guesses one hip of a seated person."""
    truth = pose({"HandLeft": (0.3, 0.2, -0.1)})
    left, right = JOINTS.index("HipLeft"), JOINTS.index("HipRight")
    told = replace(truth, positions=truth.positions.copy(), states=truth.states.copy())
    told.positions[left] = told.positions[right] + np.float32([0.0, 0.0, 0.05])
    told.states[left] = INFERRED
    other = list(MIRRORED_JOINTS)
    swapped = replace(told, positions=told.positions[other], states=told.states[other])
    pipeline = PhantomPipeline("right_arm")
    hands = []
    for number in range(20):
        joints = swapped if 10 <= number < 13 else told
        result = pipeline.process(seen(truth, number, told=joints))
        hands.append(result.skeleton.positions[11])
    wanted = truth.positions[7] * (-1, 1, 1)
    np.testing.assert_allclose(hands[5:], np.tile(wanted, (15, 1)), atol=0.04)


FLIGHTS = {
    "beside the person": {
        "ElbowRight": (0.40, 0.60, -0.15),
        "WristRight": (0.70, 0.30, -0.10),
        "HandRight": (-0.30, 0.75, -0.10),
    },
    "before the trunk": {
        "ElbowRight": (0.06, 0.00, -0.12),
        "WristRight": (0.05, 0.45, -0.14),
        "HandRight": (0.02, 0.12, -0.14),
    },
}


@pytest.mark.parametrize("flight", FLIGHTS)
def test_invented_joints_of_a_missing_arm_take_nothing_of_the_body(flight: str) -> None:
    """Bones to made-up joints of a missing arm run across chest and neck, which must stay."""
    truth = pose()
    told = pose(FLIGHTS[flight])
    pipeline = PhantomPipeline("right_arm")
    for number in range(12):
        image = seen(truth, number, told=told, camera=KINECT)
        result = pipeline.process(image)
    points = KINECT.unproject(image.depth)
    far = np.linalg.norm(points - truth.positions[8], axis=-1) > 0.13  # from the shoulder
    body = (image.body_index == 0) & far
    assert (result.kinds[body] == PixelKind.NONE).sum() < 0.002 * body.sum()
    assert result.state is PhantomState.TRACKING
    assert result.phantom.sum() > 500


def test_an_arm_is_taken_out_though_its_joints_fly_for_a_moment() -> None:
    """An arm that exists is taken out within six frames after its joints are right again."""
    truth = pose()
    told = pose(FLIGHTS["beside the person"])
    pipeline = PhantomPipeline("right_arm")
    arm = np.isin(render(truth, KINECT)[1], (10, 11, 23))
    for number in range(20):
        image = replace(
            frame(truth, KINECT, number=number),
            skeletons=(told if number in (0, 1, 2, 12) else truth,),
        )
        result = pipeline.process(image)
        if number in (8, 18):
            assert (result.kinds[arm] == PixelKind.BODY).mean() < 0.02


def test_feet_tell_that_a_tracker_keeps_to_the_wrong_sides() -> None:
    truth = pose()
    swapped = replace(truth, positions=truth.positions[list(MIRRORED_JOINTS)])
    pipeline = PhantomPipeline("right_arm")
    for number in range(120):
        result = pipeline.process(seen(truth, number, told=swapped if number >= 15 else truth))
        assert result.plane is not None
        assert result.plane.normal[0] > 0.95, number
        assert result.state is PhantomState.TRACKING, number


def test_a_recording_whose_sides_are_exchanged_is_named() -> None:
    truth = pose()
    swapped = replace(truth, positions=truth.positions[list(MIRRORED_JOINTS)])
    pipeline = PhantomPipeline("right_arm")
    results = [pipeline.process(frame(truth, SMALL, number=n)) for n in range(12)]
    assert all(result.state is PhantomState.TRACKING for result in results)
    pipeline = PhantomPipeline("right_arm")
    for number in range(60):
        told = swapped if number < 40 else truth
        image = replace(frame(truth, SMALL, number=number), skeletons=(told,))
        result = pipeline.process(image)
        if 8 <= number < 40:
            assert result.state is PhantomState.DEGRADED, number
            assert result.reason is PhantomReason.SIDES, number
    assert "exchanged" in PhantomReason.SIDES.message
    assert result.state is PhantomState.TRACKING  # believed as soon as the feet agree
    assert result.plane is not None
    assert result.plane.normal[0] > 0.95


def test_feet_of_one_who_kneels_say_nothing_of_sides() -> None:
    kneeling = {
        "KneeLeft": (0.13, -0.48, -0.01),
        "AnkleLeft": (0.14, -0.46, 0.38),
        "FootLeft": (0.14, -0.50, 0.50),
    }
    kneeling |= {name.replace("Left", "Right"): (-x, y, z) for name, (x, y, z) in kneeling.items()}
    truth = pose(kneeling)
    pipeline = PhantomPipeline("right_arm")
    for number in range(20):
        result = pipeline.process(seen(truth, number))
        assert result.reason is not PhantomReason.SIDES


def test_sides_told_for_long_are_kept_for_longer() -> None:
    """Sides that were right for two seconds are kept when they are wrong for 0.7 seconds."""
    truth = pose(missing=("FootLeft", "FootRight"))
    swapped = replace(truth, positions=truth.positions[list(MIRRORED_JOINTS)])
    pipeline = PhantomPipeline("right_arm")
    for number in range(90):
        told = swapped if 60 <= number < 80 else truth
        result = pipeline.process(seen(truth, number, told=told))
        assert result.plane is not None
        assert result.plane.normal[0] > 0.95, number


def drifting(limb: Limb, guessed: tuple[str, ...]) -> list[PhantomFrame]:
    """Process two seconds of a still person; joints drift by 2 cm, guessed ones by 10 cm."""
    rng = np.random.default_rng(3)
    truth = pose(inferred=guessed)
    scale = np.where(truth.states == 1, 0.10, 0.02)[:, None]
    error = rng.normal(size=(25, 3))
    pipeline = PhantomPipeline(limb)
    results = []
    for number in range(60):
        error = 0.9 * error + np.sqrt(1.0 - 0.81) * rng.normal(size=(25, 3))
        told = replace(truth, positions=(truth.positions + scale * error).astype(np.float32))
        results.append(pipeline.process(seen(truth, number, told=told, camera=KINECT)))
    return results


def yaws(results: list[PhantomFrame]) -> NDArray[np.float64]:
    """Return the angles of the planes about the vertical, degrees."""
    normals = np.array([result.plane.normal for result in results if result.plane is not None])
    return np.asarray(np.rad2deg(np.arctan2(normals[:, 2], normals[:, 0])), np.float64)


def test_joints_that_are_guessed_turn_the_plane_little() -> None:
    guessed = yaws(drifting("left_leg", ("HipLeft", "HipRight", "SpineBase")))
    assert np.sqrt(np.mean(guessed**2)) < 10.0


def test_a_plane_is_no_surer_than_joints_that_drift() -> None:
    results = drifting("left_leg", ())
    said = np.array([result.quality.plane_deg for result in results])
    off = np.abs(yaws(results))
    assert (off < 3.0 * said).mean() > 0.95
    assert said[-1] < said[1]


def test_a_leg_at_the_plane_is_believed_where_the_plane_is_known() -> None:
    """A leg across a plane that is well known is not called shaky."""
    crossed = {"KneeLeft": (0.03, -0.48, -0.15), "AnkleLeft": (-0.02, -0.85, -0.15),
               "FootLeft": (-0.03, -0.90, -0.30)}  # fmt: skip
    apart, near = (
        once_leg(frame(pose(moved), KINECT, without=(17, 18, 19))) for moved in (None, crossed)
    )
    assert apart.quality.across == 0.0
    assert 0.0 < near.quality.across < 0.03
    assert near.reason is not PhantomReason.SHAKY


def once_leg(image: RgbdFrame) -> PhantomFrame:
    return PhantomPipeline("right_leg").process(image)


def test_a_limb_at_a_wrong_place_is_not_held_there() -> None:
    pipeline = PhantomPipeline("right_arm")
    image = hidden_at(pose(), (5,))  # without the intact upper arm
    assert pipeline.process(image).reason is PhantomReason.DETACHED
    gone = replace(image, skeletons=(), time_ns=image.time_ns + 33_333_333, number=1)
    assert pipeline.process(gone).state is PhantomState.LOST


def test_the_plane_of_the_joints_is_still_there() -> None:
    told = jittered(pose(), np.random.default_rng(0), 0.02)
    first = PhantomPipeline("right_arm", plane="joints", smoothing="default").process(frame(told))
    again = PhantomPipeline("right_arm", smoothing=None).process(frame(told))
    assert first.plane is not None
    assert again.plane is not None
    np.testing.assert_array_equal(first.plane.normal, again.plane.normal)


# ---- whose phantom it is --------------------------------------------------------------------


def test_swapped_ids_leave_the_phantom_with_the_patient() -> None:
    patient, visitor = pose(identity=1), pose(at=(1.0, 0, 3.2), identity=2, body=1)
    pipeline = PhantomPipeline("right_arm")
    for number in range(12):
        swap = number >= 6
        people = (
            replace(patient, id=2 if swap else 1),
            replace(visitor, id=1 if swap else 2),
        )
        image = crowd(*people, number)
        result = pipeline.process(image)
        assert result.state is PhantomState.TRACKING, number
        assert result.num_person == ((image.body_index == 0) & (image.depth > 0)).sum()
        assert abs(result.skeleton.positions[0][0]) < 0.1


def test_the_phantom_stays_with_the_patients_shirt() -> None:
    """The phantom follows the shirt when ids are swapped while a visitor passes 25 cm behind."""
    followed = []
    for in_color in (True, False):
        pipeline = PhantomPipeline("right_arm")
        for number in range(40):
            x = 0.02 * (number - 20)
            swap = number >= 20
            patient = pose(at=(0, 0, 2.44), identity=1 + swap)
            visitor = pose(at=(0.12 + x if x > 0 else x - 0.12, 0, 2.60), identity=2 - swap, body=1)
            image = crowd(patient, visitor, number)
            assert image.body_index is not None
            color = np.zeros((*image.depth.shape, 3), np.uint8)
            color[image.body_index == 0] = (190, 40, 30)
            color[image.body_index == 1] = (30, 60, 190)
            image = replace(image, color=color if in_color else None)
            result = pipeline.process(image)
        followed.append(result.skeleton.id)
    assert followed == [2, 1]  # the patient's, and the visitor's who took over the id


def test_an_id_that_somebody_else_has_got_is_not_followed() -> None:
    """A far visitor in another shirt who gets the lost patient's id does not get the phantom."""
    pipeline = PhantomPipeline("right_arm")
    found = []
    for number in range(70):
        is_lost = 20 <= number < 50
        patient = pose(identity=1)
        visitor = pose(at=(1.2, 0, 3.2), identity=1 if is_lost else 2, body=1)
        image = crowd(patient, visitor, number)
        assert image.body_index is not None
        color = np.zeros((*image.depth.shape, 3), np.uint8)
        color[image.body_index == 0] = (190, 40, 30)
        color[image.body_index == 1] = (30, 60, 190)
        told = (visitor,) if is_lost else (patient, visitor)
        result = pipeline.process(replace(image, color=color, skeletons=told))
        found.append((result.state, result.reason))
        assert result.skeleton.positions[0][0] < 0.5, number
    assert {reason for _, reason in found[20:50]} == {PhantomReason.NO_PERSON}
    assert {state for state, _ in found[51:]} == {PhantomState.TRACKING}


def test_a_patient_who_comes_back_aside_is_known_at_once() -> None:
    pipeline = PhantomPipeline("right_arm")
    for number in range(5):
        assert pipeline.process(seen(pose(), number)).state is PhantomState.TRACKING
    gone = replace(frame(pose()), skeletons=(), body_index=np.full((160, 192), 255, np.uint8))
    for number in range(5, 30):
        pipeline.process(replace(gone, time_ns=number * 33_333_333, number=number))
    back = pose(at=(-0.5, 0, 2.9), identity=4)
    assert pipeline.process(seen(back, 30)).state is PhantomState.TRACKING


def test_an_arm_without_hips_in_the_picture_has_a_phantom() -> None:
    names = ("Hip", "Knee", "Ankle", "Foot")
    legs = tuple(f"{name}{side}" for name in names for side in ("Left", "Right"))
    pipeline = PhantomPipeline("right_arm")
    below = (12, 13, 14, 15, 16, 17, 18, 19)  # bones that are out of the picture as well
    told = pose(missing=("SpineBase", *legs))
    for number in range(5):
        image = frame(pose(), without=(*ARM, *below), number=number)
        result = pipeline.process(replace(image, skeletons=(told,)))
        assert result.state is PhantomState.TRACKING, result.message
    truth = pose()
    wanted = truth.positions[HAND] * (-1, 1, 1)
    np.testing.assert_allclose(result.skeleton.positions[11], wanted, atol=0.03)


def test_a_visitor_never_gets_the_phantom() -> None:
    """A patient who comes back a metre aside under a new id gets the phantom, not a visitor."""
    visitor = pose(at=(1.0, 0, 3.2), identity=2, body=1)
    pipeline = PhantomPipeline("right_arm")
    states = []
    for number in range(60):
        image = crowd(pose(at=(0 if number < 10 else -1.0, 0, 2.6), identity=1), visitor, number)
        if number < 10:
            pass
        elif number < 40:
            patient = image.body_index == 0
            image = replace(
                image,
                skeletons=(visitor,),
                depth=np.where(patient, 0, image.depth).astype(np.uint16),
                body_index=np.where(patient, 255, image.body_index).astype(np.uint8),
            )
        else:
            image = replace(image, skeletons=(replace(image.skeletons[0], id=3), visitor))
        result = pipeline.process(image)
        states.append(result.state)
        assert result.skeleton.positions[0][0] < 0.5
    assert states[40:] == [PhantomState.TRACKING] * 20


@pytest.mark.parametrize("step", [0, -1_000_000])
def test_a_clock_that_stands_or_runs_back_does_not_freeze_the_picture(step: int) -> None:
    pipeline = PhantomPipeline("right_arm")
    results = []
    for number in range(40):
        at = (0.01 * number, 0, 2.44)
        image = replace(seen(pose(at=at), number), time_ns=7_000_000_000 + step * number)
        results.append(pipeline.process(replace(image, number=7 if step == 0 else number)))
    assert [r.state for r in results[1:11]] == [PhantomState.LATE] * 10
    assert "clock" in results[5].message
    assert {r.state for r in results[11:]} == {PhantomState.TRACKING}
    np.testing.assert_allclose(results[-1].skeleton.positions[0][0], 0.39, atol=0.03)
    # A clock that runs again is believed again.
    image = replace(seen(pose(at=(0.4, 0, 2.44)), 40), time_ns=7_100_000_000)
    assert pipeline.process(image).state is PhantomState.TRACKING
    hidden = replace(image, skeletons=(), time_ns=7_900_000_000)
    assert pipeline.process(hidden).state is PhantomState.FADING


@pytest.mark.parametrize(("group", "rate"), [(2, 30.0), (2, 60.0), (2, 15.0), (30, 30.0)])
def test_frames_that_are_stamped_together_are_shown(group: int, rate: float) -> None:
    """Equal times of frame pairs, or of a clock of whole seconds, do not make frames late."""
    pipeline = PhantomPipeline("right_arm")
    for number in range(45):
        image = seen(pose(at=(0.3 * number / rate, 0, 2.44)), number)
        time = 7_000_000_000 + round(1e9 / rate) * (number // group * group)
        result = pipeline.process(replace(image, time_ns=time, number=number))
        assert result.state is PhantomState.TRACKING, number
        np.testing.assert_allclose(result.skeleton.positions[0][0], 0.3 * number / rate, atol=0.03)
    assert result.late_frames == 0
    later = 7_000_000_000 + round(1e9 * (44 / rate + 0.75))
    hidden = replace(image, skeletons=(), time_ns=later, number=45)
    assert pipeline.process(hidden).state is PhantomState.FADING


def test_times_at_both_ends_of_the_range() -> None:
    pipeline = PhantomPipeline("right_arm")
    for time in (2**63 - 1, -(2**63), 2**63 - 1, -1, 0):
        result = pipeline.process(replace(seen(pose(), 0), time_ns=time))
        assert result.state is not PhantomState.LATE, time


@pytest.mark.parametrize("name", ["time_ns", "number"])
@pytest.mark.parametrize("value", [2**63, -(2**63) - 1, 1.5, None, "now"])
def test_times_and_numbers_are_whole_and_of_64_bits(name: str, value: object) -> None:
    with pytest.raises(InputError, match=rf"frame\.{name}: expected a whole number"):
        replace(seen(pose(), 0), **{name: value})


def test_a_therapist_selects_the_patient() -> None:
    near, aside = pose(identity=1), pose(at=(1.0, 0, 3.2), identity=2, body=1)
    pipeline = PhantomPipeline("right_arm")
    assert pipeline.process(crowd(near, aside, 0)).skeleton.positions[0][0] < 0.5
    pipeline.select(2)
    for number in range(1, 4):
        assert pipeline.process(crowd(near, aside, number)).skeleton.positions[0][0] > 0.5


def test_a_stump_side_without_any_joint_has_a_plane() -> None:
    names = ("Shoulder", "Elbow", "Wrist", "Hand", "HandTip", "Thumb")
    told = pose(missing=tuple(f"{name}Right" for name in names))
    truth = pose()
    pipeline = PhantomPipeline("right_arm")
    for number in range(5):
        result = pipeline.process(seen(truth, number, told=told))
        assert result.state is PhantomState.TRACKING
        assert result.plane is not None
        mine = result.plane(truth.positions[HAND].astype(float))
        assert np.linalg.norm(mine - truth.positions[MIRRORED_JOINTS[HAND]]) < 0.01


def test_a_source_without_a_clock_runs_at_30_frames_a_second() -> None:
    pipeline = PhantomPipeline("right_arm")
    states = []
    for number in range(50):
        image = seen(pose(), number)
        hidden = replace(image, skeletons=()) if number >= 10 else image
        states.append(pipeline.process(replace(hidden, time_ns=0, number=0)).state)
    assert states[:10] == [PhantomState.TRACKING] * 10
    assert states[20] is PhantomState.HOLDING
    assert states[30] is PhantomState.FADING
    assert states[45] is PhantomState.LOST


# ---- what an operator is told ---------------------------------------------------------------


def test_a_source_without_skeletons_is_named() -> None:
    pipeline = PhantomPipeline("right_arm")
    nobody = replace(frame(pose()), skeletons=())
    reasons = [
        pipeline.process(replace(nobody, time_ns=k * 100_000_000, number=k)).reason
        for k in range(12)
    ]
    assert reasons[0] is PhantomReason.NO_JOINTS
    assert reasons[-1] is PhantomReason.NO_SKELETON
    assert "no skeleton" in reasons[-1].message
    assert not any("--" in reason.message for reason in PhantomReason)  # options of the commands


def without_joints(whole: Skeleton) -> Skeleton:
    """Return a skeleton whose tracker found nothing."""
    return replace(whole, positions=0 * whole.positions, states=0 * whole.states)


@pytest.mark.parametrize("has_skeleton", [False, True])
def test_pictures_without_joints_are_not_said_to_be_without_the_patient(has_skeleton: bool) -> None:
    pipeline = PhantomPipeline("right_arm")
    truth = pose()
    reasons = []
    for number in range(12):
        image = seen(truth, number)
        if 5 <= number < 10:
            people = (without_joints(truth),) if has_skeleton else ()
            image = replace(image, skeletons=people)
        reasons.append(pipeline.process(image).reason)
    assert (
        reasons
        == [PhantomReason.NONE] * 5 + [PhantomReason.NO_JOINTS] * 5 + [PhantomReason.NONE] * 2
    )
    assert "no joints" in PhantomReason.NO_JOINTS.message


def test_joints_of_a_visitor_only_are_a_picture_without_the_patient() -> None:
    pipeline = PhantomPipeline("right_arm")
    visitor = pose(at=(1.2, 0, 3.2), identity=2, body=1)
    for number in range(8):
        image = crowd(pose(identity=1), visitor, number)
        told = image.skeletons if number < 5 else (visitor,)
        result = pipeline.process(replace(image, skeletons=told))
    assert result.reason is PhantomReason.NO_PERSON
    assert result.message == "The patient is not in view."


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_a_wrong_focal_length_is_named(factor: float) -> None:
    right = frame(pose(at=(0.15, 0, 2.44)), KINECT, without=ARM)
    wrong = replace(KINECT, fx=KINECT.fx * factor, fy=KINECT.fy * factor)
    pipeline = PhantomPipeline("right_arm")
    for number in range(5):
        result = pipeline.process(
            replace(
                right,
                calibration=RgbdCalibration(wrong),
                time_ns=(number + 1) * 33_333_333,
                number=number,
            )
        )
        assert result.state is not PhantomState.TRACKING
        assert result.reason is PhantomReason.CALIBRATION
        assert "calibration" in result.message


@dataclass(frozen=True, eq=False)
class Person:
    """Thirty frames of a simulated person for the tests of focal lengths."""

    limb: Limb
    is_sitting: bool
    frames: list[RgbdFrame]

    def told_with(self, factor: float) -> list[PhantomFrame]:
        """Process the frames with a focal length that is wrong by a factor."""
        pipeline = PhantomPipeline(self.limb)
        wrong = replace(DEPTH_CAMERA, fx=factor * DEPTH_CAMERA.fx, fy=factor * DEPTH_CAMERA.fy)
        calibration = RgbdCalibration(wrong)
        return [pipeline.process(replace(f, calibration=calibration)) for f in self.frames]


@pytest.fixture(
    scope="module",
    params=[
        ("right_arm", {"motion": "reach"}),
        ("left_leg", {"motion": "stepping"}),
        ("right_leg", {"motion": "knee-extension", "sitting": True}),
    ],
    ids=lambda body: body[0],
)
def person(request: pytest.FixtureRequest) -> Person:
    limb, body = request.param
    people = BodySimulator(
        amputated=limb, color="none", room=False, frames=30, rate=15.0, seed=2, **body
    )
    return Person(limb, "sitting" in body, list(people))


@pytest.mark.parametrize("factor", [0.7, 0.9, 1.1])
def test_a_focal_length_off_by_a_tenth_is_named(factor: float, person: Person) -> None:
    if person.is_sitting and factor == 1.1:
        factor = 1.15  # a leg that points at the camera tells less
    results = person.told_with(factor)
    first = 0 if factor == 0.7 else 20  # a mean over frames tells a small factor
    for result in results[first:]:
        assert result.state is not PhantomState.TRACKING
        assert result.reason is PhantomReason.CALIBRATION


@pytest.mark.parametrize("factor", [1.0, 1.03])
def test_a_focal_length_that_is_right_is_not_doubted(factor: float, person: Person) -> None:
    results = person.told_with(factor)
    assert all(result.state is PhantomState.TRACKING for result in results[2:])
    assert results[-1].quality.stature * factor == pytest.approx(1.025, abs=0.03)


def with_a_hat(image: RgbdFrame, height: float) -> RgbdFrame:
    """Put a box of 22 cm in width on the head of the first person."""
    person = image.skeletons[0]
    x, _, z = person.positions[JOINTS.index("Head")]
    camera = DEPTH_CAMERA
    middle, half = camera.cx + camera.fx * x / z, 0.11 * camera.fx / z
    columns = slice(int(middle - half), int(middle + half) + 1)
    depth, bodies = np.array(image.depth), np.array(image.body_index)
    crown = int(np.flatnonzero((bodies[:, columns] == person.body).any(axis=1)).min())
    rows = slice(crown - round(height * camera.fy / z), crown + round(0.06 * camera.fy / z))
    free = bodies[rows, columns] != person.body
    depth[rows, columns][free] = round(1000.0 * z) if depth.dtype == np.uint16 else z
    bodies[rows, columns] = person.body
    return replace(image, depth=depth, body_index=bodies)


def test_a_hat_is_no_wrong_focal_length(person: Person) -> None:
    pipeline = PhantomPipeline(person.limb)
    results = [pipeline.process(with_a_hat(image, 0.15)) for image in person.frames]
    assert all(result.state is PhantomState.TRACKING for result in results[2:])


def test_a_rolled_camera_tells_a_wrong_focal_length_too() -> None:
    """A wrong focal length is recognised with a camera rolled by 90 degrees."""
    people = BodySimulator(
        motion="reach", amputated="right_arm", color="none", room=False, frames=20, seed=2
    )
    images = list(people)
    for factor, reason in ((1.0, PhantomReason.NONE), (1.15, PhantomReason.CALIBRATION)):
        pipeline = PhantomPipeline("right_arm")
        for image in images:
            result = pipeline.process(rolled(image, factor))
        assert result.reason is reason


def rolled(image: RgbdFrame, factor: float) -> RgbdFrame:
    """Return the view of a camera rolled by 90 degrees, with a focal length wrong by a factor."""
    c = image.calibration.depth
    focal = factor * c.fx
    camera = Intrinsics(c.height, c.width, focal, focal, c.cy, c.width - 1 - c.cx)
    person = image.skeletons[0]
    assert image.body_index is not None
    across = person.positions[:, [1, 0, 2]] * np.float32([1, -1, 1])
    return replace(
        image,
        depth=np.ascontiguousarray(np.rot90(image.depth)),
        body_index=np.ascontiguousarray(np.rot90(image.body_index)),
        calibration=RgbdCalibration(camera),
        skeletons=(
            replace(person, positions=across, orientations=np.zeros_like(person.orientations)),
        ),
    )


@pytest.mark.parametrize(
    ("missing", "chosen", "motion"),
    [("right_arm", "left_arm", "reach"), ("left_leg", "right_leg", "stepping")],
)
def test_a_stump_is_not_mirrored_if_the_wrong_limb_is_chosen(
    missing: Limb, chosen: Limb, motion: str
) -> None:
    """A stump is not mirrored, although its guessed joints lie on flesh as those of a limb do."""
    pipeline = PhantomPipeline(chosen)
    people = BodySimulator(
        motion=motion, amputated=missing, color="none", room=False, frames=30, rate=20.0, seed=3
    )
    results = [pipeline.process(image) for image in people]
    assert all(result.reason is PhantomReason.INFERRED for result in results[10:])
    assert all(result.state is not PhantomState.TRACKING for result in results[10:])
    assert "chosen" in results[-1].message


@pytest.mark.parametrize("stump", [0.15, 0.3])
@pytest.mark.parametrize(
    ("missing", "chosen", "motion"),
    [("right_arm", "left_arm", "wave"), ("left_leg", "right_leg", "stepping")],
)
def test_a_limb_that_was_chosen_though_it_exists_is_taken_out(
    missing: Limb, chosen: Limb, motion: str, stump: float
) -> None:
    """No part of the limb floats without the rest of it, which its mirrored stump replaces."""
    pipeline = PhantomPipeline(chosen)
    simulator = BodySimulator(
        motion=motion, amputated=missing, stump=stump, color="none", room=False, seed=3
    )
    root, *bones = LIMBS[chosen]
    for number in range(8):
        seen_now = simulator.capture(number / 30.0)
        result = pipeline.process(seen_now.frame)
        points = DEPTH_CAMERA.unproject(seen_now.frame.depth)
        beyond_root = np.linalg.norm(points - seen_now.truth.joints[root], axis=-1) > 0.12
        limb = np.isin(seen_now.truth.bones, bones) & beyond_root
        assert (result.kinds[limb] == PixelKind.BODY).mean() < 0.05, number


def test_joints_in_millimetres_are_named() -> None:
    pipeline = PhantomPipeline("right_arm")
    whole = pose()
    told = replace(whole, positions=1000 * whole.positions)
    for number in range(40):
        result = pipeline.process(seen(whole, number, told=told))
        assert result.state is PhantomState.LOST
        assert result.reason is PhantomReason.CALIBRATION
    assert "metres" in result.message


def test_pixels_at_another_depth_than_their_joints_are_named() -> None:
    """Depth in a wrong unit, with no pixel near a joint, is a reason of calibration."""
    pipeline = PhantomPipeline("right_arm")
    for number in range(5):
        image = seen(pose(), number)
        result = pipeline.process(replace(image, depth=(5 * image.depth).astype(np.uint16)))
        assert result.state is PhantomState.LOST
        assert result.reason is PhantomReason.CALIBRATION
        result = PhantomPipeline("right_arm").process(replace(image, depth=0 * image.depth))
        assert result.reason is PhantomReason.NO_PERSON


@pytest.mark.parametrize(
    ("limb", "body"),
    [
        ("left_leg", {"motion": "stepping"}),
        ("left_arm", {"motion": "wave"}),
        ("right_leg", {"motion": "knee-extension", "sitting": True}),
    ],
)
def test_joints_that_stop_are_named(limb: Limb, body: dict[str, Any]) -> None:
    """A tracker that hangs while the person moves is named until it is started again."""
    simulator = BodySimulator(
        amputated=limb, tracker="kinect-v2", color="none", room=False, seed=3, **body
    )
    images = [simulator.capture(1.0 + number / 30.0).frame for number in range(55)]
    pipeline = PhantomPipeline(limb)
    results = []
    for number, image in enumerate(images):
        told = images[10] if 10 <= number < 45 else image
        results.append(pipeline.process(replace(image, skeletons=told.skeletons)))
    assert {r.reason for r in results[:10]} == {PhantomReason.NONE}
    assert {r.reason for r in results[30:45]} == {PhantomReason.STOPPED}
    assert PhantomState.TRACKING not in {r.state for r in results[30:45]}
    assert "stand still" in results[40].message
    assert PhantomReason.STOPPED not in {r.reason for r in results[45:]}
    assert results[-1].state is PhantomState.TRACKING


@pytest.mark.parametrize("period", [1, 2, 3, 40])
def test_joints_that_come_rarely_or_of_a_person_at_rest_have_not_stopped(period: int) -> None:
    """Joints that repeat are accepted if they come rarely or the person stands still."""
    motion = "still" if period == 40 else "stepping"
    simulator = BodySimulator(
        amputated="left_leg", motion=motion, tracker="kinect-v2", color="none", room=False, seed=3
    )
    images = [simulator.capture(1.0 + number / 30.0).frame for number in range(40)]
    pipeline = PhantomPipeline("left_leg")
    for number, image in enumerate(images):
        told = images[number // period * period]
        result = pipeline.process(replace(image, skeletons=told.skeletons))
        assert result.state is PhantomState.TRACKING, number


@pytest.mark.parametrize(
    ("limb", "body"),
    [
        ("right_arm", {"motion": "reach"}),
        ("left_arm", {"motion": "wave"}),
        ("left_leg", {"motion": "stepping"}),
    ],
)
def test_a_depth_image_beside_its_joints_does_not_turn_the_plane(
    limb: Limb, body: dict[str, Any]
) -> None:
    """Depth that is shifted by 8 pixels does not turn the plane, which follows the flesh.

    A plane through the joints turned by 6 to 8 degrees.
    """
    simulator = BodySimulator(
        amputated=limb, tracker="kinect-v2", color="none", room=False, rate=15.0, seed=4, **body
    )
    pipeline = PhantomPipeline(limb)
    for number in range(30):
        capture = simulator.capture(1.0 + number / 15.0)
        image = capture.frame
        assert image.body_index is not None
        aside = replace(
            image,
            depth=np.roll(image.depth, 8, axis=1),
            body_index=np.roll(image.body_index, 8, axis=1),
        )
        result = pipeline.process(aside)
        _, normal = capture.truth.mirror_plane(limb)
        assert result.plane is not None
        cosine = abs(float(np.dot(result.plane.normal, normal)))
        if number >= 5:  # the flesh has told where it is
            assert np.degrees(np.arccos(min(1.0, cosine))) < 4.0, number


def beside(skeleton: Skeleton, by: tuple[float, float, float]) -> Skeleton:
    """Move all joints, in metres."""
    return replace(skeleton, positions=skeleton.positions + np.array(by, np.float32))


@pytest.mark.parametrize("by", [(0.08, 0.0, 0.0), (-0.08, 0.0, 0.0), (0.0, 0.0, -0.25)])
@pytest.mark.parametrize("limb", ["left_arm", "right_leg"])
def test_joints_beside_the_flesh_are_named(limb: Limb, by: tuple[float, float, float]) -> None:
    """A principal point off by 12 pixels, and depth a tenth too large, are named."""
    pipeline = PhantomPipeline(limb)
    for number in range(20):
        image = frame(pose(), KINECT, number=number)
        result = pipeline.process(replace(image, skeletons=(beside(pose(), by),)))
    assert result.state is not PhantomState.TRACKING
    assert result.reason is PhantomReason.CALIBRATION
    assert result.quality.offset > 0.03


@pytest.mark.parametrize(
    ("limb", "body", "aside"),
    [
        ("left_arm", {"motion": "wave"}, 0.25),
        ("right_arm", {"motion": "reach"}, 0.15),
        ("left_leg", {"motion": "stepping"}, 0.25),
    ],
)
def test_joints_that_were_beside_the_person_for_a_while_leave_nothing_behind(
    limb: Limb, body: dict[str, Any], aside: float
) -> None:
    """Joints that were shifted for 0.7 seconds have no effect soon after they are right again.

    Their offset was once remembered for two seconds. Planes were up to 4 (arm) and 12 degrees (leg)
    off, and right joints had the reason `calibration` for as long.
    """
    people = BodySimulator(
        amputated=limb, tracker="kinect-v2", color="none", room=False, seed=4, **body
    )
    pipeline = PhantomPipeline(limb)
    for number in range(60):
        capture = people.capture(1.0 + number / 30.0)
        image = capture.frame
        if 20 <= number < 40:
            told = tuple(beside(person, (aside, 0.0, 0.0)) for person in image.skeletons)
            image = replace(image, skeletons=told)
        result = pipeline.process(image)
        if number >= 40 and result.state is PhantomState.TRACKING:
            _, normal = capture.truth.mirror_plane(limb)
            assert result.plane is not None
            cosine = abs(float(np.dot(result.plane.normal, normal)))
            assert np.degrees(np.arccos(min(1.0, cosine))) < 2.0, number
        if number >= 53:  # 0.3 seconds until joints are believed, and the first planes
            assert result.state is PhantomState.TRACKING, number
            assert result.quality.offset < 0.02


def test_a_real_person_s_joints_that_were_beside_it_leave_nothing_behind(
    realdata: RealData,
) -> None:
    """After one second of shifted joints, a recorded trial has nearly the phantom as without.

    It is played to and fro. The leap of the joints must not count as jitter.
    """
    realdata.needs("people_utd_mhad")
    trial = list(datasets.open_people("utd-mhad:a3_s5"))
    there_and_back = trial + trial[-2:0:-1]
    right, wrong = PhantomPipeline("left_arm"), PhantomPipeline("left_arm")
    arm = [JOINTS.index(f"{part}Left") for part in ("Elbow", "Wrist", "Hand")]
    off = []
    for number in range(150):
        image = there_and_back[number % len(there_and_back)]
        image = replace(image, time_ns=number * 33_333_333, number=number)
        told = image
        if 60 <= number < 90:
            aside = tuple(beside(person, (0.25, 0.0, 0.0)) for person in image.skeletons)
            told = replace(image, skeletons=aside)
        a, b = right.process(image), wrong.process(told)
        if number >= 90 and a.state is b.state is PhantomState.TRACKING:
            assert a.skeleton is not None
            assert b.skeleton is not None
            leaps = a.skeleton.positions[arm] - b.skeleton.positions[arm]
            off.append(float(np.linalg.norm(leaps, axis=1).max()))
    assert len(off) > 40
    assert max(off) < 0.15


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("at", [(0.0, 0.0, 2.44), (1.0, 0.1, 2.44)])
def test_flesh_lies_around_its_bones(at: tuple[float, float, float], turn_deg: float) -> None:
    pipeline = PhantomPipeline("left_arm")
    truth = pose(turn_deg=turn_deg, at=at)
    for number in range(20):
        result = pipeline.process(frame(truth, KINECT, number=number))
        assert result.quality.offset < 0.02
    assert result.reason is not PhantomReason.CALIBRATION


def test_joints_that_are_not_told_are_no_wrong_calibration() -> None:
    pipeline = PhantomPipeline("right_arm")
    whole = pose()
    states = whole.states.copy()
    states[[0, 1, 12, 13, 14, 15, 16, 17, 18, 19]] = 0  # from the chest down
    for number in range(10):
        told = replace(whole, states=states)
        result = pipeline.process(seen(whole, number, told=told, camera=KINECT))
        assert result.reason is not PhantomReason.CALIBRATION
        assert result.quality.fit == 1.0


def behind(image: RgbdFrame, rows: slice, columns: slice, depth: float) -> RgbdFrame:
    """Return a frame with a part hidden by something that belongs to no person."""
    assert image.body_index is not None
    images = image.depth.copy(), image.body_index.copy()
    images[0][rows, columns] = round(1000 * depth)
    images[1][rows, columns] = 255
    return replace(image, depth=images[0], body_index=images[1])


def test_who_is_behind_something_is_not_told_to_check_the_calibration() -> None:
    pipeline = PhantomPipeline("right_arm")
    for number in range(8):
        image = seen(pose(at=(0, 0, 2.44)), number, camera=KINECT)
        if number < 4:
            assert pipeline.process(image).state is PhantomState.TRACKING
            continue
        result = pipeline.process(behind(image, slice(None), slice(236, 290), 1.5))
        assert result.quality.hidden > 0.3
        assert result.reason is PhantomReason.OCCLUDED


def behind_a_counter(image: RgbdFrame, before: float = 0.3) -> RgbdFrame:
    """Return the frame with a board before the legs, ``before`` metres nearer than the hips."""
    hips = image.skeletons[0].positions[[12, 16]].mean(axis=0)
    row = round(KINECT.cy + KINECT.fy * float(hips[1] / hips[2]))
    return behind(image, slice(row, None), slice(None), float(hips[2]) - before)


def without_depth_below(image: RgbdFrame, row: int) -> RgbdFrame:
    """Return the frame without depth below a row, as on black trousers."""
    assert image.body_index is not None
    depth, index = image.depth.copy(), image.body_index.copy()
    depth[row:], index[row:] = 0, 255
    return replace(image, depth=depth, body_index=index)


def test_trousers_without_depth_leave_an_arm_as_it_is() -> None:
    """Tracked joints of legs that lie on no pixel are no reason of calibration."""
    pipeline, whole = PhantomPipeline("right_arm"), PhantomPipeline("right_arm")
    for number in range(8):
        image = seen(pose(), number, camera=KINECT)
        expected = whole.process(image)
        row = round(KINECT.cy + KINECT.fy * 0.12 / 2.0)
        result = pipeline.process(without_depth_below(image, row))
        assert result.quality.fit > 0.9  # a hip lies at the border
        assert result.state is PhantomState.TRACKING
        assert result.skeleton is not None
        assert expected.skeleton is not None
        hand = MIRRORED_JOINTS[HAND]
        off = result.skeleton.positions[hand] - expected.skeleton.positions[hand]
        assert np.linalg.norm(off) < 0.02


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_a_wrong_focal_length_is_named_without_the_legs(factor: float) -> None:
    wrong = replace(KINECT, fx=KINECT.fx * factor, fy=KINECT.fy * factor)
    pipeline = PhantomPipeline("right_arm")
    for number in range(5):
        right = seen(pose(at=(0.15, 0, 2.44)), number, camera=KINECT)
        image = without_depth_below(right, round(KINECT.cy + KINECT.fy * 0.12 / 2.44))
        result = pipeline.process(replace(image, calibration=RgbdCalibration(wrong)))
        assert result.state is not PhantomState.TRACKING
        assert result.reason is PhantomReason.CALIBRATION


def test_an_arm_is_as_it_is_behind_a_counter() -> None:
    """A counter 0.3 m before legs that are called tracked does not affect an arm."""
    pipeline = PhantomPipeline("right_arm")
    for number in range(8):
        image = behind_a_counter(seen(pose(), number, camera=KINECT))
        result = pipeline.process(image)
        assert result.state is PhantomState.TRACKING
        assert result.quality.hidden == 0.0


@pytest.mark.parametrize("trial", ["a10_s1", "a11_s1"])
def test_a_real_person_s_trousers_without_depth(trial: str, realdata: RealData) -> None:
    realdata.needs("people_utd_mhad")
    pipeline, whole = PhantomPipeline("left_arm"), PhantomPipeline("left_arm")
    states: list[tuple[PhantomState, PhantomState]] = []
    off = []
    for image in datasets.open_people(f"utd-mhad:{trial}"):
        rows = np.flatnonzero((image.depth > 0).any(axis=1))
        hips = int(rows[0] + 0.52 * (rows[-1] - rows[0]))
        a, b = whole.process(image), pipeline.process(without_depth_below(image, hips))
        states.append((a.state, b.state))
        if a.state is b.state is PhantomState.TRACKING:
            assert a.skeleton is not None
            assert b.skeleton is not None
            step = a.skeleton.positions[HAND] - b.skeleton.positions[HAND]
            off.append(float(np.linalg.norm(step)))
    tracked = [[state is PhantomState.TRACKING for state in pair] for pair in states]
    before, after = np.mean(tracked, axis=0)
    assert after > before - 0.03
    assert np.median(off) < 0.02


def test_a_fast_hand_lies_on_its_pixels_at_few_frames_a_second() -> None:
    """The fit is measured with unsmoothed joints; smoothed ones lag, with fits down to 0.79."""
    people = BodySimulator(
        motion="arm-raise", amputated="right_arm", color="none", room=False, seed=3
    )
    pipeline = PhantomPipeline("right_arm")
    fits = [pipeline.process(people.capture(k * 7 / 30).frame).quality.fit for k in range(16)]
    assert min(fits) > 0.9


def test_a_foot_behind_something_tells_no_height() -> None:
    pipeline = PhantomPipeline("left_leg")
    people = BodySimulator(
        motion="stepping", amputated="left_leg", tracker="kinect-v2", color="none", room=False,
        frames=40, seed=2,
    )  # fmt: skip
    foot = JOINTS.index("FootRight")
    for number, image in enumerate(people):
        if number >= 10:
            x, y, z = image.skeletons[0].positions[foot]
            u, v = (
                DEPTH_CAMERA.fx * x / z + DEPTH_CAMERA.cx,
                DEPTH_CAMERA.fy * y / z + DEPTH_CAMERA.cy,
            )
            box = slice(int(v) - 30, int(v) + 15), slice(int(u) - 15, int(u) + 15)
            image = behind(image, *box, z - 0.12)
        result = pipeline.process(image)
        assert result.reason is not PhantomReason.CALIBRATION
        assert result.quality.stature == pytest.approx(1.02, abs=0.015)


def hidden_at(skeleton: Skeleton, bones: tuple[int, ...]) -> RgbdFrame:
    """Return a frame in which the pixels of some bones belong to nobody, as behind a bar."""
    image = frame(skeleton, KINECT, without=ARM)
    _, label = render(skeleton, KINECT, without=ARM)
    assert image.body_index is not None
    index = np.where(np.isin(label, bones), 255, image.body_index).astype(np.uint8)
    return replace(image, body_index=index)


def once(image: RgbdFrame) -> PhantomFrame:
    return PhantomPipeline("right_arm").process(image)


def test_a_forearm_that_floats_is_not_tracking() -> None:
    whole = once(frame(pose(), KINECT, without=ARM))
    assert whole.state is PhantomState.TRACKING
    assert whole.quality.score < 1
    assert 0.9 < whole.quality.largest <= 1.0
    result = once(hidden_at(pose(), (5,)))  # without the intact upper arm
    assert result.visible > 0.5
    assert result.quality.gap > 0.10
    assert result.state is PhantomState.DEGRADED
    assert result.reason is PhantomReason.DETACHED


def test_an_arm_that_its_joints_miss_is_not_tracking() -> None:
    """A raised forearm whose joints lie folded on the upper arm is not in the state tracking."""
    up = {"ElbowLeft": (0.42, 0.42, 0.0), "WristLeft": (0.45, 0.67, 0.0)}
    up |= {"HandLeft": (0.45, 0.75, 0.0), "HandTipLeft": (0.45, 0.83, 0.0)}
    up |= {"ThumbLeft": (0.42, 0.75, 0.0)}
    folded = {"WristLeft": (0.22, 0.44, -0.05), "HandLeft": (0.19, 0.44, -0.05)}
    folded |= {"HandTipLeft": (0.17, 0.44, -0.05), "ThumbLeft": (0.19, 0.44, -0.05)}
    whole = once(frame(pose(up), KINECT, without=ARM))
    assert whole.state is PhantomState.TRACKING
    assert whole.quality.stray < 0.05
    image = frame(pose(up), KINECT, without=ARM)
    result = once(replace(image, skeletons=(pose(up | folded),)))
    assert result.visible > 0.5
    assert result.quality.stray > 0.25
    assert result.state is PhantomState.DEGRADED
    assert result.reason is PhantomReason.INFERRED
    # A leg does not depend on it.
    assert PhantomPipeline("right_leg").process(image).quality.stray == 0.0


def test_a_phantom_beyond_the_border_of_the_image_is_not_tracking() -> None:
    """A phantom outside of the image, of a patient at its border, is not in the state tracking."""
    near = once(frame(pose(at=(-1.0, 0.0, 2.44)), KINECT, without=ARM))
    assert near.state is PhantomState.TRACKING
    assert near.quality.outside == 0.0
    image = frame(pose(at=(-1.6, 0.0, 2.44)), KINECT, without=ARM)
    result = once(image)
    assert result.visible > 0.9
    assert result.num_mirrored > 1000
    assert result.quality.outside > 0.9
    assert result.quality.score > 1.8
    assert result.state is PhantomState.DEGRADED
    assert result.reason is PhantomReason.OCCLUDED
    # Points of an arm that the body hides are not outside.
    hidden = once(frame(pose(turn_deg=50.0), KINECT, without=ARM))
    assert hidden.phantom.sum() < 0.5 * hidden.num_mirrored
    assert hidden.quality.outside == 0.0


@pytest.mark.parametrize(
    ("limb", "parts"), [("right_arm", ("Hand", "HandTip", "Thumb")), ("right_leg", ("Foot",))]
)
def test_trackers_without_joints_of_hands_and_feet(limb: Limb, parts: tuple[str, ...]) -> None:
    """A tracker without these joints gives a phantom; joints that are lost later do not."""
    none = tuple(part + side for part in parts for side in ("Left", "Right"))
    pipeline = PhantomPipeline(limb)
    known = PhantomPipeline(limb)
    image = frame(pose(), KINECT)
    known.process(image)
    for number in range(1, 20):
        image = replace(image, number=number, time_ns=number * 33_000_000)
        bare = replace(image, skeletons=(pose(missing=none),))
        result, later = pipeline.process(bare), known.process(bare)
        assert result.state is PhantomState.TRACKING, number
    assert later.reason is PhantomReason.INFERRED


def test_every_reason_has_a_sentence() -> None:
    for reason in PhantomReason:
        assert reason.message.endswith(".")


def test_textures_belong_to_their_frames() -> None:
    """While the phantom is held, its colours are those of the frame that it was made from."""
    pipeline = PhantomPipeline("right_arm")
    for number in range(6):
        image = seen(pose(), number)
        color = np.full((*image.depth.shape, 3), 10 * number, np.uint8)
        skeletons = image.skeletons if number < 4 else ()
        result = pipeline.process(replace(image, color=color, skeletons=skeletons))
    assert result.state is PhantomState.HOLDING
    body, phantom = result.parts()
    assert body.color is not None
    assert phantom.color is not None
    assert (body.color == 50).all()
    assert (phantom.color == 30).all()
    assert len(body.faces) + len(phantom.faces) == len(result.faces)
    assert len(phantom.faces) > 100
    shown = result.phantom[tuple(result.pixels[body.faces].reshape(-1, 2).T[::-1])]
    assert not shown.any()


# ---- limbs found in the depth image ---------------------------------------------------------


def test_a_knee_told_beside_the_leg_does_not_cut_the_other_one() -> None:
    """The intact leg stays whole if both knees are told 8 cm to its side."""
    moved = {}
    for side, sign in (("Left", 1), ("Right", -1)):
        moved[f"Knee{side}"] = (0.085 * sign, -0.48, -0.01)
        moved[f"Ankle{side}"] = (0.085 * sign, -0.88, 0.02)
        moved[f"Foot{side}"] = (0.085 * sign, -0.93, -0.13)
    truth = pose(moved)
    told = {name: (x + 0.08, y, z) for name, (x, y, z) in moved.items()}
    image = replace(frame(truth, KINECT), skeletons=(pose(told),))
    _, bone = render(truth, KINECT)
    result = PhantomPipeline("right_leg", smoothing=None).process(image)
    assert (result.kinds[np.isin(bone, (13, 14))] == PixelKind.BODY).mean() > 0.95


def test_a_seat_between_the_thighs_stays() -> None:
    """A seat stays, although it is nearest to the leg that is taken out."""
    seated = {}
    for side, sign in (("Left", 1), ("Right", -1)):
        seated[f"Knee{side}"] = (0.24 * sign, -0.10, -0.42)
        seated[f"Ankle{side}"] = (0.24 * sign, -0.52, -0.40)
        seated[f"Foot{side}"] = (0.24 * sign, -0.56, -0.52)
    truth = pose(seated, at=(0, 0, 2.6))
    image = frame(truth, KINECT)
    v, u = np.mgrid[: KINECT.height, : KINECT.width]
    x, y = (u - KINECT.cx) / KINECT.fx * 2.35, (v - KINECT.cy) / KINECT.fy * 2.35
    seat = (np.abs(x) < 0.1) & (y > 0.24) & (y < 0.34) & (image.depth == 0)
    assert seat.sum() > 100
    depth = np.where(seat, np.uint16(2350), image.depth)
    index = np.where(seat, 0, image.body_index).astype(np.uint8)
    result = once(replace(image, depth=depth, body_index=index))
    leg = PhantomPipeline("right_leg").process(replace(image, depth=depth, body_index=index))
    assert (result.kinds[seat] > 0).all()
    assert (leg.kinds[seat] > 0).mean() > 0.9
    assert leg.state is PhantomState.TRACKING


def test_a_forearm_that_the_tracker_does_not_see_goes_with_the_arm() -> None:
    """A forearm without joints is taken out, because it is attached to nothing but the arm."""
    aside = {"ElbowRight": (-0.42, 0.42, 0.0), "WristRight": (-0.66, 0.42, 0.0),
             "HandRight": (-0.74, 0.42, 0.0), "HandTipRight": (-0.80, 0.42, 0.0),
             "ThumbRight": (-0.74, 0.45, 0.0)}  # fmt: skip
    truth = pose(aside)
    told = pose(aside, missing=("WristRight", "HandRight", "HandTipRight", "ThumbRight"))
    image = replace(frame(truth, KINECT), skeletons=(told,))
    _, bone = render(truth, KINECT)
    forearm = np.isin(bone, (10, 11, 23, 24))
    assert forearm.sum() > 300
    assert (once(image).kinds[forearm] == PixelKind.BODY).mean() < 0.01
    kept = PhantomPipeline("right_arm", keep_residual=True).process(image)
    assert (kept.kinds[forearm] == PixelKind.BODY).mean() > 0.99


def test_an_arm_before_the_chest_leaves_no_slot() -> None:
    """The part of the chest behind the arm is filled from the trunk's other side, at its depth."""
    before = {"ElbowRight": (-0.24, 0.22, -0.10), "WristRight": (-0.13, 0.16, -0.24),
              "HandRight": (-0.10, 0.14, -0.25), "HandTipRight": (-0.08, 0.12, -0.25),
              "ThumbRight": (-0.10, 0.16, -0.25)}  # fmt: skip
    truth = pose(before)
    image = frame(truth, KINECT)
    trunk = frame(truth, KINECT, without=ARM)
    _, bone = render(truth, KINECT)
    hidden = np.isin(bone, ARM) & (trunk.depth > 0)
    assert hidden.sum() > 250
    result = once(image)
    shown = hidden & (result.kinds > 0)
    assert shown.sum() > 0.95 * hidden.sum()
    off = np.abs(result.depth[shown] - trunk.depth[shown] / 1000)
    assert np.median(off) < 0.02
    assert result.state is PhantomState.TRACKING


# ---- memory ---------------------------------------------------------------------------------


def test_memory_of_results_comes_back_when_nobody_looks_at_it() -> None:
    pipeline = PhantomPipeline("right_arm")
    kept = pipeline.process(seen(pose(), 0))
    part = kept.vertices[5:50:3]
    depth, vertices = kept.depth.copy(), part.copy()
    places = []
    del kept.__dict__["faces"]  # of the frame that is kept in part
    for number in range(1, 12):
        result = pipeline.process(seen(pose(at=(0.01 * number, 0, 2.44)), number))
        places.append(result.faces.ctypes.data)
    assert len(set(places)) <= 3
    np.testing.assert_array_equal(kept.depth, depth)
    np.testing.assert_array_equal(part, vertices)
    del kept
    for number in range(12, 20):
        pipeline.process(seen(pose(at=(0.01 * number, 0, 2.44)), number))
    np.testing.assert_array_equal(part, vertices)  # a view keeps what it is a view of


def test_results_outlive_their_pipeline() -> None:
    results = [PhantomPipeline("right_arm").process(seen(pose(), 0)) for _ in range(3)]
    for result in results[1:]:
        np.testing.assert_array_equal(result.vertices, results[0].vertices)
        np.testing.assert_array_equal(result.depth, results[0].depth)


def test_the_border_of_the_phantom_does_not_flicker() -> None:
    """Less than 2 % of the phantom's pixels vanish for a single frame; 3.9 % once did.

    The joints of a Kinect V2 jitter while the person stands still.
    """
    pipeline = PhantomPipeline("right_arm")
    simulator = BodySimulator(
        motion="still",
        amputated="right_arm",
        tracker="kinect-v2",
        color="none",
        room=False,
        seed=5,
    )
    shown = [pipeline.process(simulator.capture(k / 30.0).frame).phantom for k in range(30)]
    gone = [
        (before & after & ~now).sum() / now.sum()
        for before, now, after in zip(shown[4:], shown[5:], shown[6:], strict=False)
    ]
    assert np.median(gone) < 0.02


# ---- stout people ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limb", "motion"),
    [
        ("right_arm", "arm-raise"),
        ("left_leg", "stepping"),
        pytest.param("left_arm", "wave", marks=pytest.mark.slow),
    ],
)
def test_a_stout_person_is_no_person_with_a_limb_too_many(limb: Limb, motion: str) -> None:
    """The flank of a thick trunk is not taken for the arm that was taken out."""
    people = BodySimulator(
        motion=motion, amputated=limb, girth=1.5, color="none", frames=40, rate=10.0, seed=3,
        jitter=0.01,
    )  # fmt: skip
    pipeline = PhantomPipeline(limb)
    results = [pipeline.process(image) for image in people][10:]  # once the trunk is measured
    tracked = [result.state is PhantomState.TRACKING for result in results]
    assert np.mean(tracked) >= 0.75, [result.reason for result in results]
    assert np.median([result.quality.left for result in results]) < 0.05


def test_a_new_patient_is_measured_anew() -> None:
    """After a reset, a slim person has the same labels as with a new pipeline."""

    def first(girth: float) -> RgbdFrame:
        return next(iter(BodySimulator(amputated="right_arm", girth=girth, color="none", frames=1)))

    used, new = PhantomPipeline("right_arm"), PhantomPipeline("right_arm")
    used.process(first(1.6))
    used.reset()
    slim = first(0.9)
    np.testing.assert_array_equal(used.process(slim).labels, new.process(slim).labels)
