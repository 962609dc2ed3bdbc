"""Region growing and skeletal animation on people whose surface is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from capsule_body import SMALL, frame, pose
from manip3d import InputError, Skeleton, modify
from manip3d.rgbd import MIRRORED_JOINTS, PARENTS

ARM = [5, 6, 7, 21, 22]


def labels_of(person: Skeleton, **options: object) -> NDArray[np.uint8]:
    seen = frame(person, SMALL)
    return modify.segment_body(
        seen.depth,
        SMALL,
        person,
        segmentation="region",
        body_index=seen.body_index,
        **options,  # type: ignore[arg-type]
    ).labels


def bone_lengths(skeleton: Skeleton) -> NDArray[np.float64]:
    joints = skeleton.positions.astype(np.float64)
    return np.asarray(np.linalg.norm(joints - joints[list(PARENTS)], axis=1))


def raised(elbow: tuple[float, float, float], wrist: tuple[float, float, float]) -> Skeleton:
    hand = np.array(wrist) + (np.array(wrist) - np.array(elbow)) * 0.3
    names = {"ElbowLeft": elbow, "WristLeft": wrist, "HandLeft": tuple(hand)}
    return pose(names)  # type: ignore[arg-type]


def test_regions_do_not_depend_on_the_order_of_pixels() -> None:
    person = pose()
    seen = frame(person, SMALL)
    labels = labels_of(person)
    swap = np.array([0, *MIRRORED_JOINTS[1:]], np.uint8)
    positions = person.positions[list(MIRRORED_JOINTS)] * np.float32([-1, 1, 1])
    mirrored = modify.segment_body(
        np.ascontiguousarray(seen.depth[:, ::-1]),
        SMALL,
        Skeleton(positions, body=0),
        segmentation="region",
        body_index=np.ascontiguousarray(seen.body_index[:, ::-1]),  # type: ignore[index]
    ).labels
    differs = swap[mirrored[:, ::-1]] != labels
    assert differs.sum() <= 0.005 * (labels > 0).sum()  # ties in the middle of the body


def test_an_arm_before_the_trunk_keeps_to_its_contour() -> None:
    crossing = raised((0.25, 0.20, -0.15), (0.0, 0.22, -0.33))
    seen = frame(crossing, SMALL)
    labels = labels_of(crossing)
    metres = seen.depth / 1000.0
    on_arm = (metres > 0) & (metres < 2.44 - 0.24) & (np.arange(160)[:, None] < 90)
    assert on_arm.sum() > 50
    assert np.isin(labels[on_arm], ARM).mean() > 0.97


def test_seeds_along_the_bone_cover_more_than_its_middle() -> None:
    person = pose()
    assert (labels_of(person) > 0).sum() >= (labels_of(person, seeds="middle") > 0).sum() > 0


def test_what_nothing_reaches_is_not_the_person() -> None:
    person = pose()
    seen = frame(person, SMALL)
    depth = seen.depth.copy()
    index = np.array(seen.body_index)
    depth[5:9, 5:9], index[5:9, 5:9] = 2440, 0
    found = modify.segment_body(depth, SMALL, person, segmentation="region", body_index=index)
    assert (found.labels[5:9, 5:9] == 0).all()
    assert np.isinf(found.distances[5:9, 5:9]).all()


def test_triangles_join_bones_that_meet() -> None:
    person = pose()
    seen = frame(person, SMALL)
    labels = labels_of(person)
    strict = modify.animation_mesh(seen.depth, SMALL, labels, person, joint_reach=0.0)
    loose = modify.animation_mesh(seen.depth, SMALL, labels, person, by_label=False)
    bones = strict.labels[strict.faces]
    for one, other in ((0, 1), (1, 2), (2, 0)):
        for a, b in {tuple(pair) for pair in bones[:, [one, other]].tolist()}:
            assert a == b or PARENTS[a] in (b, PARENTS[b]) or PARENTS[b] == a
    assert 0 < len(strict.faces) < len(loose.faces)
    column, row = strict.pixels.T
    np.testing.assert_array_equal(
        strict.vertices[:, 2], (seen.depth[row, column] / 1000.0).astype(np.float32)
    )


@pytest.mark.parametrize("method", ["spherical", "rigid", "lbs"])
@pytest.mark.parametrize("scope", ["limbs", "body"])
def test_the_same_pose_moves_nothing_and_bones_keep_their_lengths(method: str, scope: str) -> None:
    person = pose(turn_deg=10.0)
    rng = np.random.default_rng(1)
    labels = rng.integers(1, 25, 500).astype(np.uint8)
    vertices = (person.positions[labels] + rng.normal(0, 0.05, (500, 3))).astype(np.float32)
    same = modify.animate(vertices, labels, person, person, method=method, scope=scope)  # type: ignore[arg-type]
    assert same is not None
    np.testing.assert_allclose(same.vertices, vertices, atol=2e-6)
    other = raised((0.45, 0.50, 0.1), (0.40, 0.80, -0.1))
    moved = modify.animate(vertices, labels, person, other, method=method, scope=scope)  # type: ignore[arg-type]
    assert moved is not None
    np.testing.assert_allclose(bone_lengths(moved.skeleton), bone_lengths(person), atol=2e-6)
    assert np.abs(moved.vertices - vertices).max() > 0.1


def test_limbs_take_their_direction_against_the_trunk() -> None:
    person, turned = pose(), pose(turn_deg=40.0)
    result = modify.animate(np.zeros((0, 3)), np.zeros(0, np.uint8), person, turned)
    assert result is not None
    np.testing.assert_allclose(result.skeleton.positions, person.positions, atol=1e-5)
    whole = modify.animate(np.zeros((0, 3)), np.zeros(0, np.uint8), person, turned, scope="body")
    assert whole is not None
    np.testing.assert_allclose(
        whole.skeleton.positions - whole.skeleton.positions[0],
        turned.positions - turned.positions[0],
        atol=1e-5,
    )


def swung(angle_deg: float, towards_camera: bool) -> float:
    """Largest relative change of distances within an upper arm that swings out by an angle."""
    angle = np.deg2rad(angle_deg)
    hanging = raised((0.19, 0.16, 0.0), (0.19, -0.14, 0.0))
    out = np.array([0, 0, -1.0]) if towards_camera else np.array([1.0, 0, 0])
    way = 0.3 * (np.cos(angle) * np.array([0, -1.0, 0]) + np.sin(angle) * out)
    elbow = np.array([0.19, 0.46, 0.0]) + way
    other = raised(tuple(elbow), tuple(elbow + way))
    rng = np.random.default_rng(2)
    around = rng.uniform([-0.05, 0.05, -0.06], [0.05, 0.25, 0.0], (200, 3))
    vertices = (hanging.positions[4] + around).astype(np.float32)
    labels = np.full(200, 5, np.uint8)
    moved = modify.animate(vertices, labels, hanging, other, method="spherical")
    assert moved is not None
    before = np.linalg.norm(vertices[:, None] - vertices[None], axis=2)
    after = np.linalg.norm(moved.vertices[:, None] - moved.vertices[None], axis=2)
    far = before > 0.02
    return float(np.abs(after[far] / before[far] - 1.0).max())


def test_the_spherical_method_is_rigid_in_the_image_plane_alone() -> None:
    assert swung(60.0, towards_camera=False) < 0.02
    assert swung(60.0, towards_camera=True) > 0.2


def test_blending_ends_a_fifth_of_the_bone_from_the_joint() -> None:
    person, other = pose(), raised((0.45, 0.40, 0.0), (0.70, 0.40, 0.0))
    along = np.linspace(0.0, 1.0, 11)[:, None]
    start, end = person.positions[[4, 5]]
    vertices = (start + along * (end - start) + [0.04, 0, -0.03]).astype(np.float32)
    labels = np.full(11, 5, np.uint8)
    rigid, lbs = (
        modify.animate(vertices, labels, person, other, method=method)  # type: ignore[arg-type]
        for method in ("rigid", "lbs")
    )
    assert rigid is not None
    assert lbs is not None
    apart = np.linalg.norm(rigid.vertices - lbs.vertices, axis=1)
    assert (apart[3:8] < 1e-6).all()
    assert apart[0] > 1e-3


def test_wrong_arguments_are_named() -> None:
    person = pose()
    bones = np.ones(1, np.uint8)
    point = np.zeros((1, 3), np.float32)
    with pytest.raises(InputError, match="method: expected 'spherical', 'rigid' or 'lbs'"):
        modify.animate(point, bones, person, person, method="dual")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="labels: expected 1 to 24, got 0"):
        modify.animate(point, np.zeros(1, np.uint8), person, person)
    with pytest.raises(InputError, match=r"labels: expected shape \(1,\)"):
        modify.animate(point, np.ones(2, np.uint8), person, person)
    with pytest.raises(InputError, match="seeds: expected 'line' or 'middle'"):
        labels_of(person, seeds="none")
    with pytest.raises(InputError, match="reach"):
        labels_of(person, reach=-1.0)
    image = np.ones((160, 192), np.uint16)
    with pytest.raises(InputError, match="max_step: expected a finite number >= 0"):
        modify.animation_mesh(image, SMALL, np.ones((160, 192), np.uint8), max_step=-1.0)
    with pytest.raises(InputError, match="labels: expected 0 to 24, got 25"):
        modify.animation_mesh(image, SMALL, np.full((160, 192), 25, np.uint8))
    lost = Skeleton(person.positions, states=np.zeros(25, np.uint8))
    assert modify.animate(point, bones, person, lost) is None
