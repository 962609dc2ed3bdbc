"""Smoothed joints, key person, mirror and segmentation, each beside its formula."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from capsule_body import SMALL, bones, frame, jittered, pixel_rays, pose, render
from manip3d import InputError, Intrinsics, Skeleton, _core
from manip3d.modify import (
    JointSmoother,
    KeyPerson,
    body_mirror,
    clothing_colors,
    segment_body,
)
from manip3d.rgbd import JOINTS, MIRRORED_JOINTS, PARENTS

# ---- smoothing ------------------------------------------------------------------------------


def smoothed_joint(
    raws: list[NDArray[np.float64]],
    inferred: list[bool],
    s: float = 0.25,
    c: float = 0.25,
    p: float = 0.25,
    jitter: float = 0.03,
    deviation: float = 0.05,
) -> list[NDArray[np.float64]]:
    """Smooth one joint by Azimi's filter, as published."""
    outputs = []
    filtered, trend = raws[0], np.zeros(3)
    for k, (raw, guessed) in enumerate(zip(raws, inferred, strict=True)):
        j, d_max = (2 * jitter, 2 * deviation) if guessed else (jitter, deviation)
        old = filtered
        if k == 1:
            filtered = (raw + raws[0]) / 2
        elif k > 1:
            d = np.linalg.norm(raw - old)
            star = raw if d > j else old + (d / j) * (raw - old)
            filtered = (1 - s) * star + s * (old + trend)
        if k > 0:
            trend = c * (filtered - old) + (1 - c) * trend
        out = filtered + p * trend
        off = np.linalg.norm(out - raw)
        outputs.append(raw + (out - raw) * (d_max / off) if off > d_max else out)
    return outputs


@pytest.mark.parametrize("preset", ["default", "seated"])
def test_smoothing_is_the_formula(preset: str) -> None:
    rng = np.random.default_rng(3)
    numbers = {} if preset == "default" else dict(s=0.5, c=0.1, p=0.5, jitter=0.1, deviation=0.1)
    frames = [jittered(pose(at=(0.02 * k, 0, 2.4)), rng, 0.04) for k in range(20)]
    guessed = rng.random((20, 25)) < 0.3
    smoother = JointSmoother(preset)  # type: ignore[arg-type]
    results = [
        smoother.add(replace(f, states=np.where(g, 1, 2).astype(np.uint8)))
        for f, g in zip(frames, guessed, strict=True)
    ]
    for joint in range(25):
        raws = [f.positions[joint].astype(float) for f in frames]
        expected = smoothed_joint(raws, list(guessed[:, joint]), **numbers)
        found = [r.positions[joint] for r in results]
        np.testing.assert_allclose(found, expected, atol=1e-6)
    # The test can tell: without the doubling for guesses it would not agree.
    wrong = smoothed_joint([f.positions[0].astype(float) for f in frames], [False] * 20, **numbers)
    assert np.abs(np.array([r.positions[0] for r in results]) - wrong).max() > 1e-3


def test_smoothing_takes_jitter_away_and_follows_movement() -> None:
    rng = np.random.default_rng(5)
    smoother = JointSmoother()
    still = [smoother.add(jittered(pose(), rng, 0.005)).positions for _ in range(60)][10:]
    assert np.std(still, axis=0).mean() < 0.5 * 0.005
    fast = [smoother.add(pose(at=(0.1 * k, 0, 2.4))).positions[0, 0] for k in range(10)]
    assert abs(fast[-1] - 0.9) <= 0.0501  # never farther from the raw joint than D


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, 1e30])
def test_a_joint_that_is_not_there_comes_back(bad: float) -> None:
    smoother = JointSmoother()
    for _ in range(5):
        smoother.add(pose())
    broken = pose().positions.copy()
    broken[7] = bad
    gone = smoother.add(replace(pose(), positions=broken))
    assert gone.states[7] == 0
    assert np.isfinite(gone.positions).all()
    back = smoother.add(pose(at=(1, 0, 2)))
    np.testing.assert_array_equal(back.positions[7], pose(at=(1, 0, 2)).positions[7])
    assert back.states[7] == 2
    assert not np.allclose(back.positions[6], pose(at=(1, 0, 2)).positions[6])


def test_not_tracked_joints_are_not_smoothed() -> None:
    smoother = JointSmoother()
    smoother.add(pose())
    assert smoother.add(pose(missing=("HandLeft",))).states[7] == 0
    smoother.reset()
    moved = pose(at=(1, 0, 3))
    np.testing.assert_array_equal(smoother.add(moved).positions, moved.positions)


@pytest.mark.parametrize(
    ("option", "short", "value"),
    [("smoothing", "s", 0.6), ("correction", "c", 0.9), ("prediction", "p", 1.5),
     ("jitter_radius", "jitter", 0.1), ("max_deviation", "deviation", 0.005)],
)  # fmt: skip
def test_each_number_of_the_smoother_does_its_part(option: str, short: str, value: float) -> None:
    rng = np.random.default_rng(4)
    frames = [jittered(pose(at=(0.02 * k, 0, 2.4)), rng, 0.04) for k in range(20)]
    smoother = JointSmoother(**{option: value})
    found = [smoother.add(frame).positions[7] for frame in frames]
    raws = [frame.positions[7].astype(float) for frame in frames]
    expected = smoothed_joint(raws, [False] * 20, **{short: value})
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.abs(np.array(found) - smoothed_joint(raws, [False] * 20)).max() > 1e-3


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_deviation", -0.1),
        ("smoothing", 1.0),
        ("correction", 1.1),
        ("prediction", -1),
        ("jitter_radius", np.nan),
    ],
)
def test_smoother_refuses(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        JointSmoother(**{name: value})
    with pytest.raises(InputError, match="smoothing: expected at least 0 and below 1, got 1"):
        JointSmoother(smoothing=1.0)
    with pytest.raises(InputError, match="preset"):
        JointSmoother("standing")  # type: ignore[arg-type]


def test_without_jitter_radius_nothing_is_damped() -> None:
    smoother = JointSmoother(jitter_radius=0, smoothing=0, correction=0)
    for k in range(4):
        frame = pose(at=(0.001 * k, 0, 2))
        result = smoother.add(frame)
    np.testing.assert_allclose(result.positions, frame.positions, atol=1e-6)


# ---- key person -----------------------------------------------------------------------------


def person(identity: int, x: float, z: float = 2.5) -> Skeleton:
    return pose(at=(x, 0, z), identity=identity)


def found(key: KeyPerson, people: list[Skeleton], time: float) -> int | None:
    one = key.find(people, SMALL, time)
    return None if one is None else one.id


def test_key_person_is_the_one_in_the_middle() -> None:
    key = KeyPerson()
    assert found(key, [person(4, 0.8), person(9, 0.1), person(2, -0.6)], 0.0) == 9
    assert found(key, [person(4, 0.9), person(9, 0.3)], 0.1) == 9  # and stays so
    assert found(key, [person(4, 0.0), person(9, 0.9)], 1.0) == 9
    assert found(KeyPerson(), [person(7, 0.3), person(3, -0.3)], 0.0) == 3  # ties: the lower id


def test_a_lost_key_person_is_waited_for() -> None:
    key = KeyPerson()
    helper = person(5, 0.2)
    assert found(key, [person(1, 0.0), helper], 0.0) == 1
    assert found(key, [helper], 0.9) is None
    assert found(key, [person(1, 0.1), helper], 0.95) == 1
    assert found(key, [helper], 1.9) is None
    assert found(key, [person(6, 0.45), helper], 1.96) == 6  # the helper is known
    assert found(key, [person(6, 0.4), helper], 2.0) == 6


def test_of_several_newcomers_the_nearest_is_taken_after_a_while() -> None:
    key = KeyPerson()
    assert found(key, [person(1, 0.0)], 0.0) == 1
    assert found(key, [person(2, 0.4), person(3, -0.2)], 0.9) is None
    assert found(key, [person(2, 0.4), person(3, -0.2)], 1.1) == 3


def test_a_patient_who_comes_back_aside_is_not_taken_for_a_visitor() -> None:
    key = KeyPerson()
    visitor = person(2, 1.0, 3.2)
    assert found(key, [person(1, 0.0), visitor], 0.0) == 1
    for k in range(1, 21):
        assert found(key, [visitor], 0.05 * k) is None
    assert found(key, [person(3, -1.0), visitor], 1.05) == 3
    # The visitor is never taken while in view, even after all is forgotten, unless selected.
    for k in range(1, 200):
        assert found(key, [visitor], 1.05 + 0.1 * k) is None
    assert found(key, [person(4, -0.5), visitor], 21.1) == 4
    key.select(2)
    assert found(key, [person(4, -0.5), visitor], 21.2) == 2


def test_ids_that_nobody_had_for_long_are_free_again() -> None:
    key = KeyPerson()
    assert found(key, [person(1, 0.0), person(2, 0.9)], 0.0) == 1
    assert found(key, [person(2, 0.0)], 11.0) == 2


def test_a_person_whose_hips_are_out_of_the_picture_is_found() -> None:
    hips = ("SpineBase", "HipLeft", "HipRight")
    key = KeyPerson()
    assert found(key, [pose(missing=hips, identity=1), person(2, 0.9)], 0.0) == 1
    # Hips that come back move nobody.
    assert found(key, [pose(identity=8), person(2, 0.9)], 0.033) == 8
    low = (*hips, "SpineMid")
    assert found(key, [pose(missing=low, identity=9), person(2, 0.9)], 0.067) == 9


def test_ids_that_are_swapped_move_nobody() -> None:
    key = KeyPerson()
    assert found(key, [person(1, 0.0), person(2, 0.7)], 0.0) == 1
    assert found(key, [person(2, 0.02), person(1, 0.72)], 0.033) == 2
    assert found(key, [person(2, 0.04), person(1, 0.74)], 0.067) == 2
    # A new id at the same place is the same person, somebody else's is not.
    assert found(key, [person(8, 0.05), person(1, 0.74)], 0.1) == 8
    assert found(key, [person(1, 0.2)], 0.133) is None


def test_who_comes_back_alone_is_known_at_once() -> None:
    key = KeyPerson()
    assert found(key, [person(1, 0.0)], 0.0) == 1
    assert found(key, [], 0.5) is None
    assert found(key, [person(2, 1.0)], 0.6) == 2
    small = person(3, 0.0)
    child = replace(small, positions=small.positions * np.float32(0.6))
    assert found(key, [child], 1.2) is None


def test_nobody_known_takes_over_until_all_is_forgotten() -> None:
    key = KeyPerson()
    assert found(key, [person(1, 0.0), person(2, 0.9)], 0.0) == 1
    assert found(key, [person(2, 0.6)], 5.0) is None
    assert found(key, [person(2, 0.6)], 10.0) is None  # still in view, and still known
    assert found(key, [person(2, 0.6)], 25.0) == 2
    key.reset()
    assert found(key, [person(3, 0.0), person(2, 0.6)], 10.1) == 3


def test_the_therapist_selects() -> None:
    key = KeyPerson()
    both = [person(1, 0.0), person(2, 0.9)]
    assert found(key, both, 0.0) == 1
    key.select(2)
    assert found(key, both[:1], 0.1) == 1  # until then
    assert found(key, both, 0.2) == 2
    assert found(key, both, 0.3) == 2


def test_people_without_a_place_are_not_chosen() -> None:
    key = KeyPerson()
    lost = pose(missing=("SpineBase", "SpineMid", "SpineShoulder", "Neck"), identity=1)
    behind = pose(at=(0, 0, -2), identity=2)
    assert found(key, [lost, behind], 0.0) is None
    assert found(key, [lost, behind, person(3, 0.5)], 0.1) == 3
    with pytest.raises(InputError, match="patience"):
        KeyPerson(patience=float("nan"))


RED, BLUE = np.eye(15, dtype=np.float32)[[0, 8]]
REDDISH = 0.8 * RED + 0.2 * np.eye(15, dtype=np.float32)[1]  # Hellinger distance 0.32 from RED


def dressed(
    key: KeyPerson, people: list[tuple[Skeleton, NDArray[np.float32]]], time: float
) -> int | None:
    """Return the id of the key person among people with these clothes."""
    one = key.find([p for p, _ in people], SMALL, time, clothes=[c for _, c in people])
    return None if one is None else one.id


def test_ids_swapped_while_two_people_cross_are_told_by_their_clothes() -> None:
    """The patient is followed by the clothes, since both people pass within 20 cm."""
    key = KeyPerson()
    for k in range(60):
        x = 0.02 * (k - 30)  # of the patient, in red; the visitor comes the other way
        swap = k >= 30
        patient, visitor = person(1 + swap, x), person(2 - swap, -1.3 * x, 2.7)
        assert dressed(key, [(visitor, BLUE), (patient, REDDISH)], k / 30) == patient.id, k


def test_without_colours_people_who_cross_are_told_by_ids() -> None:
    """Without clothes, the person who has the id of the patient is followed."""
    key, unseen = KeyPerson(), np.zeros(15, np.float32)
    for k in range(60):
        x = 0.02 * (k - 30)
        swap = k >= 30
        both = [(person(2 - swap, -1.3 * x, 2.7), unseen), (person(1 + swap, x), unseen)]
        assert dressed(key, both, k / 30) == 1, k


def test_a_patient_hidden_by_a_visitor_comes_back_under_the_visitors_id() -> None:
    key = KeyPerson()
    assert dressed(key, [(person(1, 0.0), RED), (person(2, 0.6), BLUE)], 0.0) == 1
    assert dressed(key, [], 0.4) is None
    assert dressed(key, [(person(2, 0.2), REDDISH), (person(1, -0.5), BLUE)], 0.5) == 2


def test_of_two_newcomers_of_one_size_the_one_in_the_patients_clothes_is_taken() -> None:
    key = KeyPerson()
    assert dressed(key, [(person(1, 0.0), RED)], 0.0) == 1
    assert dressed(key, [], 0.4) is None
    both = [(person(5, 0.1), BLUE), (person(6, -0.8), REDDISH)]
    assert dressed(key, both, 0.5) == 6
    key = KeyPerson()  # without colours both may be it
    assert found(key, [person(1, 0.0)], 0.0) == 1
    assert found(key, [p for p, _ in both], 0.5) is None


def test_who_comes_after_the_key_person_is_forgotten_is_known_by_new_clothes() -> None:
    key = KeyPerson(forget=5.0)
    assert dressed(key, [(person(1, 0.0), RED)], 0.0) == 1
    for k in range(60):
        assert dressed(key, [(person(9, 0.0), BLUE)], 6.0 + k / 30) == 9
    both = [(person(9, 0.0), BLUE), (person(12, 0.25), RED)]
    assert dressed(key, both, 8.1) == 9
    assert dressed(key, [(person(10, 0.0), BLUE)], 9.0) == 10


def test_somebody_of_another_size_in_the_patients_colours_is_not_the_patient() -> None:
    """A child in the patient's colours is not followed while the patient's shirt is covered."""
    patient, child = pose(identity=1), pose(identity=2)
    base = child.positions[0]
    small = (base + 0.5 * (child.positions - base) + (0.2, 0.0, 0.0)).astype(np.float32)
    for other, wanted in ((replace(child, positions=small), 1), (person(2, 0.2), 2)):
        key = KeyPerson()
        assert dressed(key, [(patient, RED)], 0.0) == 1
        assert dressed(key, [(patient, BLUE), (other, RED)], 0.1) == wanted


def test_a_newcomer_in_other_clothes_is_not_taken() -> None:
    key = KeyPerson()
    assert dressed(key, [(person(1, 0.0), RED)], 0.0) == 1
    for k in range(1, 50):
        assert dressed(key, [(person(7, 0.1), BLUE)], 0.2 * k) is None  # not after patience either
    assert dressed(key, [(person(8, 0.3), RED)], 9.9) == 8


def test_an_id_is_believed_while_nobody_else_wears_the_clothes() -> None:
    """Changed or hidden clothes do not make another person the patient."""
    key = KeyPerson()
    assert dressed(key, [(person(1, 0.0), RED), (person(2, 0.7), RED)], 0.0) == 1
    assert dressed(key, [(person(1, 0.0), BLUE), (person(2, 0.7), BLUE)], 0.1) == 1
    far = [(person(1, 0.0), BLUE), (person(2, 1.9), RED)]
    assert dressed(key, far, 0.2) == 1


def without_spine(skeleton: Skeleton) -> Skeleton:
    states = skeleton.states.copy()
    states[[JOINTS.index(name) for name in ("SpineBase", "SpineMid", "SpineShoulder", "Neck")]] = 0
    return replace(skeleton, states=states)


@pytest.mark.parametrize("has_spine", [True, False])
@pytest.mark.parametrize(("visitor_at", "comes_back_as"), [(2.0, 5), (0.8, 6)])
def test_a_jacket_that_is_put_on_is_learnt_while_nobody_is_near(
    visitor_at: float, comes_back_as: int, has_spine: bool
) -> None:
    """New clothes are learnt if no visitor is near; the patient then comes back under a new id.

    Without a spine, the visitor's distance is measured from shoulders and hips.
    """
    key = KeyPerson()
    found = person(2, visitor_at)
    visitor = found if has_spine else without_spine(found), REDDISH
    assert dressed(key, [(person(1, 0.0), RED), visitor], 0.0) == 1
    for k in range(1, 151):
        assert dressed(key, [(person(1, 0.0), BLUE), visitor], k / 30) == 1
    assert dressed(key, [], 5.4) is None
    both = [(person(5, 0.2), BLUE), (person(6, -0.2), RED)]
    assert dressed(key, both, 5.5) == comes_back_as


def test_clothes_that_are_hidden_for_a_moment_are_not_forgotten() -> None:
    """The patient's red shirt is remembered while an arm hides it for a second."""
    key = KeyPerson()
    assert dressed(key, [(person(1, 0.0), RED)], 0.0) == 1
    for k in range(1, 31):
        assert dressed(key, [(person(1, 0.0), BLUE)], k / 30) == 1
    assert dressed(key, [], 1.4) is None
    assert dressed(key, [(person(5, 0.2), BLUE), (person(6, -0.2), RED)], 1.5) == 6


def test_clothes_are_one_row_for_each_person() -> None:
    for clothes, got in (
        ([RED, BLUE], "2, 15"),
        ([RED[:3]], "1, 3"),
        ([[]], "1, 0"),
        ([], "0, 15"),
    ):
        with pytest.raises(InputError, match=rf"expected shape \(1, 15\), got \({got}\)"):
            KeyPerson().find([person(1, 0.0)], SMALL, 0.0, clothes=clothes)
    assert KeyPerson().find([], SMALL, 0.0, clothes=[]) is None
    for factor in (np.nan, -0.5, 1.5):
        with pytest.raises(InputError, match="clothes: expected shares from 0 to 1"):
            KeyPerson().find([person(1, 0.0)], SMALL, 0.0, clothes=[RED * np.float32(factor)])


@pytest.mark.parametrize(
    ("rgb", "row"),
    [
        ((200, 0, 0), {0: 1.0}),
        ((100, 0, 0), {0: 1.0}),  # half the light
        ((0, 0, 180), {8: 1.0}),
        ((200, 50, 0), {0: 0.5, 1: 0.5}),  # hue 15 degrees
        ((0, 0, 0), {12: 1.0}),
        ((80, 80, 80), {12: 0.5, 13: 0.5}),
        ((255, 255, 255), {14: 1.0}),
        ((120, 90, 90), {0: 0.5, 13: 0.5}),  # saturation 0.25
    ],
)
def test_colours_of_clothes(rgb: tuple[int, int, int], row: dict[int, float]) -> None:
    image = frame(pose())
    color = np.broadcast_to(np.array(rgb, np.uint8), (*image.depth.shape, 3)).copy()
    expected = np.zeros(15)
    expected[list(row)] = list(row.values())
    measured = clothing_colors(replace(image, color=color))
    np.testing.assert_allclose(measured, [expected], atol=1e-5)


def test_clothes_are_those_of_the_trunk_alone() -> None:
    """Clothes do not include an arm before the chest, the background or pixels of no person."""
    both = pose(), pose(at=(0.0, 0, 2.44), identity=2, body=1)
    image = frame(both[0], people=both)
    there = image.depth > 0
    color = np.where(there[..., None], (200, 0, 0), (0, 0, 200)).astype(np.uint8)
    image = replace(image, color=color)
    rows = clothing_colors(image)
    assert rows[0, 0] > 0.999
    assert not rows[1].any()  # none of the pixels has its index
    arm = image.depth.copy()
    arm[:, 90:100] = np.where(there[:, 90:100], 2000, 0)
    color = color.copy()
    color[:, 90:100] = (0, 200, 0)
    assert clothing_colors(replace(image, depth=arm, color=color))[0, 0] > 0.999
    with pytest.raises(InputError, match="frame: expected a colour image, got none"):
        clothing_colors(replace(image, color=None))


def test_the_core_checks_the_pictures_of_clothes() -> None:
    """The core refuses images that do not fit, as it must not read beyond their ends."""
    image = frame(pose())
    color = np.zeros((*image.depth.shape, 3), np.uint8)
    index = np.zeros(image.depth.shape, np.uint8)
    camera = image.calibration.depth

    def colors(depth: Any, body_index: Any, color: Any) -> Any:
        return _core.clothing_colors(depth, body_index, camera, None, color, image.skeletons)

    assert colors(image.depth, index, color).shape == (1, 15)
    for name, wrong in (
        ("depth: expected the size of its camera", (image.depth[:-1].copy(), None, color)),
        ("depth: expected", (image.depth.astype(np.float64), None, color)),
        ("body_index: expected the shape of depth", (image.depth, index[:, :-1].copy(), color)),
        ("color: expected the size of depth", (image.depth, None, color[:-1].copy())),
        ("color", (image.depth, None, index)),
    ):
        with pytest.raises(InputError, match=name):
            colors(*wrong)


# ---- mirror ---------------------------------------------------------------------------------


def axes(s: Skeleton, arm: bool) -> tuple[NDArray[np.float64], ...]:
    """Return x_s, y_s, z_s and O_s of eq. 4.2 and 4.8."""
    names = ("ShoulderLeft", "ShoulderRight", "SpineMid", "SpineShoulder")
    names = names if arm else ("HipLeft", "HipRight", "SpineBase", "SpineMid")
    left, right, low, high = (s.positions[JOINTS.index(n)].astype(float) for n in names)
    x = (left - right) / np.linalg.norm(left - right)
    y = (high - low) / np.linalg.norm(high - low)
    z = np.cross(x, y)
    return x, y, z / np.linalg.norm(z), low


@given(st.integers(0, 2**32), st.sampled_from(["left_arm", "left_leg"]))
def test_reflection_is_an_isometry_and_undoes_itself(seed: int, limb: str) -> None:
    rng = np.random.default_rng(seed)
    s = jittered(pose(turn_deg=rng.uniform(-60, 60)), rng, 0.03)
    _, y, z, origin = axes(s, limb == "left_arm")
    mirror = body_mirror(s, limb)  # type: ignore[arg-type]
    assert mirror is not None
    points = rng.normal(0, 2, (50, 3))
    image = mirror(points)
    n = np.cross(y, z)
    expected = points - 2 * ((points - origin) @ n)[:, None] * n
    np.testing.assert_allclose(image, expected, atol=1e-6)
    np.testing.assert_allclose(mirror(image), points, atol=1e-9)
    np.testing.assert_allclose(mirror.linear @ mirror.linear.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(mirror.linear) < 0


@given(st.integers(0, 2**32))
def test_paper_is_equations_4_3_to_4_7(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = jittered(pose(turn_deg=rng.uniform(-60, 60)), rng, 0.03)
    x, y, z, origin = axes(s, arm=True)
    m = np.stack([x, y, z])
    points = rng.normal(0, 2, (50, 3))
    local = (points - origin) @ m.T
    expected = np.linalg.solve(m, (local * (-1, 1, 1)).T).T + origin
    mirror = body_mirror(s, "right_arm", mode="paper")
    assert mirror is not None
    np.testing.assert_allclose(mirror(points), expected, atol=1e-6)
    np.testing.assert_allclose(mirror(mirror(points)), points, atol=1e-8)
    columns = np.linalg.solve(m.T, ((points - origin) @ m * (-1, 1, 1)).T).T + origin
    assert np.abs(columns - expected).max() > 1e-3  # the other reading is another map


@pytest.mark.parametrize(("tilt", "error", "columns"), [(5, 0.017, 0.11), (10, 0.035, 0.23)])
def test_tilted_shoulders_bend_the_printed_map(tilt: float, error: float, columns: float) -> None:
    hand = np.array([0.65, 0.10, 0.0])  # from SpineMid, arm out to the side
    s = pose()
    positions = s.positions.copy()
    angle = np.deg2rad(tilt)
    for name, sign in (("ShoulderLeft", 1), ("ShoulderRight", -1)):
        offset = 0.19 * sign * np.array([np.cos(angle), -np.sin(angle), 0])
        positions[JOINTS.index(name)] = positions[JOINTS.index("SpineShoulder")] + offset
    tilted = replace(s, positions=positions)
    place = tilted.positions[1] + hand * (1, -1, 1)
    true, paper = body_mirror(tilted, "right_arm"), body_mirror(tilted, "right_arm", mode="paper")
    assert true is not None
    assert paper is not None
    assert np.linalg.norm(paper(place) - true(place)) == pytest.approx(error, abs=0.001)
    x, y, z, origin = axes(tilted, arm=True)
    m = np.stack([x, y, z], axis=1)
    wrong = np.linalg.solve(m, (m @ (place - origin)) * (-1, 1, 1)) + origin
    assert np.linalg.norm(wrong - true(place)) == pytest.approx(columns, abs=0.01)


def test_2d_exchanges_left_and_right_in_the_image() -> None:
    s = pose(turn_deg=30, at=(0.4, 0, 2.5))
    mirror = body_mirror(s, "right_arm", mode="2d")
    assert mirror is not None
    rng = np.random.default_rng(0)
    points = rng.uniform((-1, -1, 1), (1, 1, 3), (20, 3))
    image = mirror(points)
    spine = s.positions[1].astype(float)
    np.testing.assert_allclose(
        image[:, 0] / image[:, 2], 2 * spine[0] / spine[2] - points[:, 0] / points[:, 2], atol=1e-6
    )
    np.testing.assert_array_equal(image[:, 1:], points[:, 1:])


def rotation(q: NDArray[np.float32]) -> NDArray[np.float64]:
    w, x, y, z = q.astype(float)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.parametrize("limb", ["left_arm", "right_leg"])
def test_mirrored_joints_and_orientations(limb: str) -> None:
    rng = np.random.default_rng(1)
    q = rng.normal(size=(25, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    states = np.full(25, 2, np.uint8)
    states[[11, 15]] = 1
    s = replace(jittered(pose(turn_deg=25), rng, 0.02), orientations=q, states=states)
    mirror = body_mirror(s, limb)  # type: ignore[arg-type]
    assert mirror is not None
    changed = {"left_arm": [4, 5, 6, 7, 21, 22], "right_leg": [16, 17, 18, 19]}[limb]
    for joint in range(25):
        other = MIRRORED_JOINTS[joint] if joint in changed else joint
        if joint not in changed:
            np.testing.assert_array_equal(mirror.skeleton.positions[joint], s.positions[joint])
            np.testing.assert_array_equal(mirror.skeleton.orientations[joint], q[joint].astype("f"))
            continue
        expected = mirror(s.positions[other].astype(float))
        np.testing.assert_allclose(mirror.skeleton.positions[joint], expected, atol=1e-6)
        # The mirror image of a bone with rotation R has rotation (mirror) R diag(-1, 1, 1).
        turned = mirror.linear @ rotation(s.orientations[other]) @ np.diag([-1.0, 1, 1])
        found = rotation(mirror.skeleton.orientations[joint])
        np.testing.assert_allclose(found, turned, atol=1e-5)
        assert mirror.skeleton.states[joint] == states[other]


def test_no_mirror_without_axes() -> None:
    assert body_mirror(pose(missing=("ShoulderLeft",)), "left_arm") is None
    assert body_mirror(pose(missing=("ShoulderLeft",)), "left_leg") is not None
    # Shoulders above each other: x_s along the spine.
    lying = pose({"ShoulderLeft": (0, 0.7, 0), "ShoulderRight": (0, 0.3, 0)})
    assert body_mirror(lying, "left_arm") is None
    close = pose({"HipLeft": (0.01, 0, 0), "HipRight": (-0.01, 0, 0)})
    assert body_mirror(close, "left_leg") is None
    with pytest.raises(InputError, match="mode"):
        body_mirror(pose(), "left_arm", mode="4d")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="affected"):
        body_mirror(pose(), "tail")  # type: ignore[arg-type]


# ---- segmentation ---------------------------------------------------------------------------


def distance_4_1(
    p: NDArray[np.float64], pc: NDArray[np.float64], pr: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the distance of eq. 4.1 in its three cases."""
    axis = pr - pc
    if not axis.any():
        return np.linalg.norm(p - pc, axis=-1)
    t = (p - pc) @ axis / (axis @ axis)
    line = np.linalg.norm(np.cross(p - pc, p - pr), axis=-1) / np.linalg.norm(axis)
    ends = np.where(t >= 1, np.linalg.norm(p - pr, axis=-1), np.linalg.norm(p - pc, axis=-1))
    return np.where((t > 0) & (t < 1), line, ends)


def all_distances(
    points: NDArray[np.float64], skeleton: Skeleton
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    pairs = [(n, distance_4_1(points, a, b)) for n, a, b, _ in bones(skeleton)]
    return np.array([n for n, _ in pairs]), np.stack([d for _, d in pairs])


@pytest.mark.parametrize("seed", range(4))
def test_segmentation_is_equation_4_1(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = jittered(pose(turn_deg=rng.uniform(-80, 80)), rng, 0.02)
    if seed == 1:
        s = replace(s, positions=np.where(np.arange(25)[:, None] == 7, s.positions[6], s.positions))
    if seed == 2:
        s = replace(s, states=np.where(rng.random(25) < 0.3, 0, 2).astype(np.uint8))
    depth, _ = render(pose(), SMALL)
    result = segment_body(depth.astype(np.float32), SMALL, s, segmentation="paper", margin=5)
    points = (pixel_rays(SMALL) * depth[..., None])[depth > 0]
    numbers, distances = all_distances(points, s)
    labels = result.labels[depth > 0]
    np.testing.assert_allclose(result.distances[depth > 0], distances.min(0), atol=2e-6)
    order = np.sort(distances, axis=0)
    clear = order[1] - order[0] > 1e-5
    assert clear.mean() > 0.6
    np.testing.assert_array_equal(labels[clear], numbers[distances.argmin(0)][clear])
    near = distances[[list(numbers).index(n) for n in labels], np.arange(len(labels))]
    assert (near <= distances.min(0) + 1e-5).all()
    assert (result.labels[depth == 0] == 0).all()
    # An infinite line in place of a segment would give other labels.
    assert (np.isfinite(result.distances) == (depth > 0)).all()


def girth(metres: float) -> float:
    return metres / (2 * np.pi)


# Radii at the start and at the end of each bone of the mean adult, 1.69 m tall.
ARM, ELBOW, WRIST, HAND = girth(0.33), girth(0.29), girth(0.17), girth(0.2)
THIGH, KNEE, ANKLE = girth(0.62), girth(0.41), girth(0.22)
SKIN = {"Neck": (girth(0.36), girth(0.36)), "Head": (girth(0.36), girth(0.57)),
        "Shoulder": (ARM, ARM), "Elbow": (ARM, ELBOW), "Wrist": (ELBOW, WRIST),
        "Hand": (WRIST, HAND), "HandTip": (HAND, HAND), "Thumb": (0, 0.011),
        "Hip": (THIGH, THIGH), "Knee": (THIGH, KNEE), "Ankle": (KNEE, ANKLE),
        "Foot": (ANKLE, girth(0.24)),
        "SpineMid": (0.135, 0.135), "SpineShoulder": (0.135, 0.1325)}  # fmt: skip
LENGTHS = {"Elbow": 0.186, "Wrist": 0.146, "Knee": 0.245, "Ankle": 0.246}  # of the stature

Rod = tuple[int, NDArray[np.float64], NDArray[np.float64], float, float]


def unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    return vector / np.linalg.norm(vector)


def fleshed(skeleton: Skeleton) -> list[Rod]:
    """Return number, ends and radii of each bone with its flesh; trunk bones may be two rods."""
    joints = {n: p for n, p in zip(JOINTS, skeleton.positions.astype(float), strict=True)}
    usable = [JOINTS[j] for j in range(25) if skeleton.states[j]]
    names = {number: JOINTS[number] for number, *_ in bones(skeleton)}
    plain = {
        number: name.removesuffix("Left").removesuffix("Right") for number, name in names.items()
    }
    ratios = sorted(
        np.linalg.norm(b - a) / (1.69 * LENGTHS[plain[number]])
        for number, a, b, _ in bones(skeleton)
        if plain[number] in LENGTHS
    )
    size = ratios[len(ratios) // 2] if ratios else 0.0
    found: list[Rod] = []
    trunk = {"SpineMid", "SpineShoulder", "ShoulderLeft", "ShoulderRight", "HipLeft", "HipRight"}
    for number, a, b, _ in bones(skeleton):
        if not (size > 0 and trunk <= set(usable) and plain[number].startswith("Spine")):
            start, end = SKIN[plain[number]]
            found.append((number, a, b, size * start, size * end))
            continue
        chest = unit(joints["ShoulderLeft"] - joints["ShoulderRight"])
        across = unit(chest + unit(joints["HipLeft"] - joints["HipRight"]))
        up = unit(joints["SpineShoulder"] - joints["SpineMid"])
        for sign, hip in ((1, "HipLeft"), (-1, "HipRight")):
            waist = joints["SpineMid"] + sign * size * 0.04 * across
            top = joints["SpineShoulder"] - size * 0.095 * up + sign * size * 0.015 * chest
            if number == 1:
                found.append((number, joints[hip], waist, size * THIGH, size * 0.115))
            else:
                found.append((number, waist, top, size * 0.115, size * 0.125))
    return found


@pytest.mark.parametrize("seed", range(7))
def test_segmentation_is_by_the_nearest_skin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = jittered(pose(turn_deg=rng.uniform(-80, 80)), rng, 0.02 if seed < 6 else 0.2)
    if seed == 1:
        s = replace(s, positions=np.where(np.arange(25)[:, None] == 7, s.positions[6], s.positions))
    if seed in (2, 3):
        s = replace(s, states=np.where(rng.random(25) < 0.15, 0, 2).astype(np.uint8))
    if seed == 4:  # no bone tells how large the person is
        s = replace(
            s, states=np.where(np.isin(np.arange(25), (5, 9, 13, 17)), 0, 2).astype(np.uint8)
        )
        s = replace(s, states=np.where(np.isin(np.arange(25), (6, 10, 14, 18)), 0, s.states))
    depth, _ = render(pose(), SMALL)
    result = segment_body(depth.astype(np.float32), SMALL, s, margin=5)
    points = (pixel_rays(SMALL) * depth[..., None])[depth > 0]
    rods = fleshed(s)
    bare, skin = np.empty((2, len(rods), len(points)))
    for k, (_, a, b, start, end) in enumerate(rods):
        bare[k] = distance_4_1(points, a, b)
        length2 = max((b - a) @ (b - a), 1e-12)
        taper = np.clip(end - start, -np.sqrt(length2), np.sqrt(length2))
        along = np.clip((points - a) @ (b - a) / length2, 0, 1)
        spreads = np.hypot(0.1 * np.array([start, start + taper]), 0.01)
        ends = np.stack([1 - along, along], 1)
        outside = bare[k] - (start + along * taper)
        skin[k] = np.maximum(
            outside * (ends @ (0.01 / spreads)), outside - 3 * (ends @ spreads - 0.01)
        )
    numbers = np.array([number for number, *_ in rods])
    order = np.sort(skin, axis=0)
    clear = order[1] - order[0] > 1e-5
    assert clear.mean() > 0.5
    nearest = skin.argmin(0)
    np.testing.assert_array_equal(result.labels[depth > 0][clear], numbers[nearest][clear])
    np.testing.assert_allclose(
        result.distances[depth > 0][clear],
        bare[nearest, np.arange(len(points))][clear],
        atol=2e-6,
    )


def test_ties_go_to_the_lower_bone() -> None:
    camera = Intrinsics(9, 9, 10, 10, 4, 4)  # pixel 4 looks along x = 0, between left and right
    s = pose()
    s = replace(s, positions=s.positions * (1, 0, 0) + (0, 0, 2))
    states = np.zeros(25, np.uint8)
    states[[4, 5, 8, 9]] = 2
    s = replace(s, states=states)
    result = segment_body(np.full((9, 9), 2000, np.uint16), camera, s)
    assert set(result.labels[:, 4]) == {5}
    assert set(result.labels[:, 3]) == {9}
    assert set(result.labels[:, 5]) == {5}


def test_a_point_without_bones_has_no_label() -> None:
    s = pose(missing=JOINTS)
    result = segment_body(np.full((160, 192), 2000, np.uint16), SMALL, s, body_index=np.zeros(
        (160, 192), np.uint8))  # fmt: skip
    assert (result.labels == 0).all()


def test_mask_is_body_index_or_depths_of_the_joints() -> None:
    depth = np.full((160, 192), 2440, np.uint16)
    depth[:, 96:] = 4000
    depth[0] = 0
    s = pose(body=3)
    inside = segment_body(depth, SMALL, s).labels > 0
    np.testing.assert_array_equal(inside, depth == 2440)
    index = np.full(depth.shape, 255, np.uint8)
    index[80:, 90:100] = 3
    index[80:, 100:] = 2
    inside = segment_body(depth, SMALL, s, body_index=index).labels > 0
    np.testing.assert_array_equal(inside, index == 3)
    anybody = segment_body(depth, SMALL, pose(body=255), body_index=index).labels > 0
    np.testing.assert_array_equal(anybody, (index != 255) & (depth == 2440))
    far = segment_body(depth, SMALL, s, body_index=index, far=3).labels > 0
    np.testing.assert_array_equal(far, (index == 3) & (depth == 2440))
    metres = depth.astype(np.float32) / 1000
    metres[1] = (np.nan, np.inf, -1) * 64
    inside = segment_body(metres, SMALL, s).labels > 0
    np.testing.assert_array_equal(inside[2:], (depth == 2440)[2:])
    assert not inside[:2].any()


@pytest.mark.parametrize("metres", [70.0, 1e6, 3e38])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_joints_out_of_reach_have_no_pixels(metres: float, dtype: type) -> None:
    """Joints beyond the range of 16 bits in millimetres get no pixels; they once got all."""
    s = pose()
    far = replace(s, positions=s.positions * np.float32((1, 1, 0)) + np.float32((0, 0, metres)))
    depth = np.full((48, 64), 5000 if dtype is np.uint16 else 5.0, dtype)
    camera = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)
    assert not segment_body(depth, camera, far).labels.any()


def test_segmentation_refuses() -> None:
    depth = np.full((160, 192), 2440, np.uint16)
    with pytest.raises(InputError, match="depth"):
        segment_body(depth[1:], SMALL, pose())
    with pytest.raises(InputError, match="body_index"):
        segment_body(depth, SMALL, pose(), body_index=np.zeros((2, 2), np.uint8))
    with pytest.raises(InputError, match="near"):
        segment_body(depth, SMALL, pose(), near=float("nan"))
    with pytest.raises(InputError, match="segmentation: expected 'skin' or 'paper'"):
        segment_body(depth, SMALL, pose(), segmentation="bone")  # type: ignore[arg-type]


PARTS = {1: (5, 6, 7, 21, 22), 2: (9, 10, 11, 23, 24), 3: (13, 14, 15), 4: (17, 18, 19)}


def part_of(labels: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the number of the limb of each label; 0 for trunk and head."""
    return sum(number * np.isin(labels, limb) for number, limb in PARTS.items())


def test_bone_labels_of_capsules() -> None:
    """Most pixels get the label of their bone; near joints either bone is right."""
    s = pose()
    depth, truth = render(s, SMALL)
    for segmentation in ("skin", "paper"):
        labels = segment_body(depth.astype(np.float32), SMALL, s, segmentation=segmentation).labels
        assert (labels == truth)[depth > 0].mean() > 0.75
        limb = lambda image: np.isin(image, PARTS[1])  # noqa: E731
        assert (limb(labels) == limb(truth))[depth > 0].mean() > 0.97
    assert PARENTS[5] == 4


@pytest.mark.parametrize("turn", [-45.0, -20.0, 0.0, 20.0, 45.0])
def test_an_arm_that_hangs_takes_no_flank_along(turn: float) -> None:
    """A flank is not labelled as the arm beside it, although the trunk's axis is farther away."""
    hanging = {"Elbow": (0.22, 0.19), "Wrist": (0.23, -0.06), "Hand": (0.23, -0.13),
               "HandTip": (0.23, -0.21)}  # fmt: skip
    moved = {n + "Left": (x, y, 0.0) for n, (x, y) in hanging.items()}
    moved |= {n + "Right": (-x, y, 0.0) for n, (x, y) in hanging.items()}
    s = pose(moved | {"ThumbLeft": (0.23, -0.1, -0.05), "ThumbRight": (-0.23, -0.1, -0.05)},
             turn_deg=turn)  # fmt: skip
    depth, truth = render(s, SMALL)
    taken, wrong = {}, {}
    for segmentation in ("skin", "paper"):
        labels = segment_body(depth.astype(np.float32), SMALL, s, segmentation=segmentation).labels
        arms = np.isin(labels, (*PARTS[1], *PARTS[2]))
        taken[segmentation] = (arms & np.isin(truth, (1, 20))).sum()
        wrong[segmentation] = (part_of(labels) != part_of(truth))[depth > 0].sum()
    assert taken["skin"] < 0.1 * taken["paper"]
    assert wrong["skin"] < 0.55 * wrong["paper"]


def test_what_is_far_from_every_skin_is_of_the_nearest_in_metres() -> None:
    """A forearm whose joints are 40 cm off is still labelled as an arm."""
    whole = pose({"WristLeft": (0.75, 0.25, 0), "HandLeft": (0.83, 0.26, 0),
                  "HandTipLeft": (0.9, 0.26, 0), "ThumbLeft": (0.83, 0.29, 0)})  # fmt: skip
    depth, truth = render(whole, SMALL)
    tracked = pose({"WristLeft": (0.5, 0.3, 0), "HandLeft": (0.5, 0.3, 0),
                    "HandTipLeft": (0.5, 0.3, 0), "ThumbLeft": (0.5, 0.3, 0)})  # fmt: skip
    labels = segment_body(depth.astype(np.float32), SMALL, tracked).labels
    assert np.isin(labels[np.isin(truth, (6, 7, 21))], PARTS[1]).all()


def test_a_palm_is_no_thumb() -> None:
    """A palm is not labelled as thumb, although the bone of the thumb lies beside it."""
    s = pose({"HandLeft": (0.42, -0.08, -0.05), "ThumbLeft": (0.40, -0.09, -0.09)})
    depth, truth = render(s, SMALL)
    palm = truth == 7
    named = {
        segmentation: segment_body(
            depth.astype(np.float32), SMALL, s, segmentation=segmentation
        ).labels[palm]
        for segmentation in ("skin", "paper")
    }
    assert (named["skin"] == 22).sum() < 0.5 * (named["paper"] == 22).sum()
