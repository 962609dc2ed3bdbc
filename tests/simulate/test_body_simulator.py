"""The simulated person: geometry, truth, noise, tracker."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from manip3d import InputError
from manip3d._util.linear import quaternions, rotations_of
from manip3d.rgbd import INFERRED, JOINTS, NO_BODY, PARENTS, TRACKED
from manip3d.simulate import BodySimulator, open_source, people
from manip3d.simulate._figure import (
    LIMBS,
    MIRROR,
    REST_JOINTS,
    about,
    opposite,
    pose_figure,
    turned_figure,
)
from manip3d.simulate._motions import MOTIONS, pose_at, walk
from manip3d.simulate._skin import build_skin, nearest_bone
from manip3d.simulate._time_of_flight import measure
from manip3d.simulate.people import DEPTH_CAMERA, NO_BONE

pytest.importorskip("open3d")

GROUND = (0.0, 0.95, 2.44)


def pixels(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    camera = DEPTH_CAMERA
    column = np.rint(camera.cx + camera.fx * points[:, 0] / points[:, 2]).astype(int)
    row = np.rint(camera.cy + camera.fy * points[:, 1] / points[:, 2]).astype(int)
    return row, column


@pytest.mark.parametrize("motion", sorted(MOTIONS))
@pytest.mark.parametrize("sitting", [False, True])
def test_bones_keep_their_lengths(motion: str, sitting: bool) -> None:
    rest = np.linalg.norm(REST_JOINTS - REST_JOINTS[list(PARENTS)], axis=1)
    for time in (0.0, 0.7, 2.0, 3.1):
        pose = pose_at(motion, time, sitting=sitting, turn=25.0, shoulder_tilt=8.0)
        joints = pose_figure(pose, GROUND).joints
        lengths = np.linalg.norm(joints - joints[list(PARENTS)], axis=1)
        np.testing.assert_allclose(lengths, rest, atol=1e-12)


def test_exercises_move_what_they_say() -> None:
    def joints(motion: str, time: float) -> np.ndarray:
        return pose_figure(pose_at(motion, time, sitting="knee" in motion), GROUND).joints

    name = JOINTS.index
    up = joints("arm-raise", 0.0)[:, 1] - joints("arm-raise", 2.0)[:, 1]
    assert up[name("WristLeft")] > 0.4 < up[name("WristRight")]
    assert up[name("AnkleLeft")] == 0.0
    waving = joints("wave", 2.0)
    assert waving[name("WristLeft"), 1] < waving[name("ElbowLeft"), 1] - 0.15  # y points down
    assert waving[name("ElbowLeft"), 0] > 0.3  # the person's left is the picture's right
    ahead = joints("reach", 0.0)[:, 2] - joints("reach", 2.0)[:, 2]
    assert ahead[name("HandLeft")] > 0.25
    knee = joints("knee-extension", 0.0) - joints("knee-extension", 2.0)
    assert knee[name("AnkleRight"), 2] > 0.25
    toe = joints("dorsiflexion", 0.0) - joints("dorsiflexion", 1.0)
    assert toe[name("FootLeft"), 1] > 0.04
    assert toe[name("AnkleLeft"), 1] == pytest.approx(0.0, abs=1e-9)


def test_orientations_point_along_their_bones() -> None:
    figure = pose_figure(pose_at("wave", 1.3, turn=30.0), GROUND)
    has = np.flatnonzero(figure.orientations.any(axis=1))
    assert set(range(25)) - set(has.tolist()) == {3, 15, 19, 21, 22, 23, 24}
    axes = rotations_of(figure.orientations[has])[:, :, 1]
    bones = figure.joints - figure.joints[list(PARENTS)]
    for joint, axis in zip(has.tolist(), axes, strict=True):
        if joint:
            np.testing.assert_allclose(axis, bones[joint] / np.linalg.norm(bones[joint]), atol=1e-9)


def test_orientations_mirror_as_quaternions_do() -> None:
    """Reflected across x, (w, x, y, z) is (w, x, -y, -z)."""
    figure = pose_figure(pose_at("arm-raise", 1.1), GROUND)
    sign = np.array([1.0, 1.0, -1.0, -1.0])
    for left, right in ((5, 9), (6, 10), (7, 11), (13, 17), (14, 18), (4, 8), (12, 16)):
        first, second = figure.orientations[left] * sign, figure.orientations[right]
        assert abs(first @ second) == pytest.approx(1.0, abs=1e-12)


def test_quaternions_and_rotations_are_inverse() -> None:
    random = np.random.default_rng(0).standard_normal((500, 4))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    found = quaternions(rotations_of(random))
    np.testing.assert_allclose(np.abs((found * random).sum(axis=1)), 1.0, atol=1e-12)
    half_turns = np.stack([np.diag(d) for d in ((1.0, -1, -1), (-1, 1, -1), (-1, -1, 1))])
    np.testing.assert_allclose(rotations_of(quaternions(half_turns)), half_turns, atol=1e-12)


def test_a_surface_is_closed_small_and_faces_outwards() -> None:
    skin = build_skin()
    assert len(skin.faces) <= 32_000
    vertices = skin.vertices(pose_figure(pose_at("still", 0.0), GROUND)).astype(float)
    corners = vertices[skin.faces]
    for limb in range(-1, 4):
        volume = np.linalg.det(corners[skin.face_limb == limb] - corners.mean((0, 1))).sum() / 6
        assert 0.002 < volume < 0.1  # cubic metres
    height = np.ptp(vertices[:, 1])
    assert 1.7 < height < 1.8


def test_a_symmetric_pose_has_a_symmetric_surface() -> None:
    skin = build_skin()
    vertices = skin.vertices(pose_figure(pose_at("arm-raise", 1.4), GROUND))
    reflected = vertices @ MIRROR.astype(np.float32)
    order = [np.lexsort(np.rint(v * 1e5).T) for v in (vertices, reflected)]
    np.testing.assert_allclose(vertices[order[0]], reflected[order[1]], atol=5e-5)


def test_a_symmetric_body_gives_a_symmetric_picture() -> None:
    truth = BodySimulator(noise=0.0, room=False).capture(1.0).truth
    there = truth.people == 0
    assert 12_000 < there.sum() < 16_000
    assert (there ^ there[:, ::-1]).sum() <= 4  # rays that graze
    both = there & there[:, ::-1]
    difference = np.abs(truth.depth - truth.depth[:, ::-1])[both]
    assert np.quantile(difference, 0.999) < 1e-4


@pytest.mark.parametrize("motion", ["arm-raise", "elbow-bent", "knee-extension"])
def test_depth_is_that_of_the_surface(motion: str) -> None:
    from manip3d.metrics import closest_points

    truth = BodySimulator(motion=motion, noise=0.0, room=False, turn=20.0).capture(1.3).truth
    row, column = np.nonzero(truth.people == 0)
    z = truth.depth[row, column].astype(float)
    camera = DEPTH_CAMERA
    x, y = (column - camera.cx) * z / camera.fx, (row - camera.cy) * z / camera.fy
    found = closest_points(truth.body(), np.column_stack([x, y, z]))
    assert found.distance.max() < 1e-4
    assert (truth.depth[truth.people == NO_BODY] == 0.0).all()


def test_labels_are_mostly_those_of_the_nearest_bone() -> None:
    truth = BodySimulator(motion="arm-raise", noise=0.0).capture(2.0).truth
    row, column = np.nonzero(truth.bones != NO_BONE)
    z = truth.depth[row, column].astype(float)
    camera = DEPTH_CAMERA
    points = np.column_stack(
        [(column - camera.cx) * z / camera.fx, (row - camera.cy) * z / camera.fy, z]
    )
    found = nearest_bone(points, range(1, 25), truth.joints)
    assert (found == truth.bones[row, column]).mean() > 0.8
    assert set(np.unique(truth.bones)) >= {3, 5, 6, 9, 10, 13, 14, 15, 17, 18, 19}


@pytest.mark.parametrize("distance", [2.0, 4.0])
def test_noise_grows_with_the_square_of_the_distance(distance: float) -> None:
    depth = np.full((424, 512), distance, np.float32)
    measured = measure(depth, np.ones_like(depth), 1.0, np.random.default_rng(0))
    seen = measured.depth > 0.0
    expected = 1.5e-3 * (distance / 2.0) ** 2
    assert measured.depth[seen].std() == pytest.approx(expected, rel=0.01)
    assert (~seen).mean() == pytest.approx(0.001, rel=0.2)
    assert not measured.flying.any()


def test_flying_pixels_lie_between_the_surfaces_of_an_edge() -> None:
    depth = np.full((40, 60), 2.0, np.float32)
    depth[:, 30:] = 3.0
    measured = measure(depth, np.ones_like(depth), 1.0, np.random.default_rng(3))
    rows, columns = np.nonzero(measured.flying)
    assert set(columns.tolist()) == {29, 30}
    assert 0.3 < len(rows) / 80 < 0.7
    between = measured.depth[rows, columns]
    assert ((between > 2.05) & (between < 2.95)).all()
    away = ~measured.flying & (measured.depth > 0)
    assert np.abs(measured.depth - depth)[away].max() < 0.02


def test_without_noise_depth_is_exact_in_millimetres() -> None:
    capture = BodySimulator(noise=0.0).capture(0.5)
    np.testing.assert_array_equal(
        capture.frame.depth, np.rint(capture.truth.depth * 1000.0).astype(np.uint16)
    )
    assert not capture.truth.flying.any()


def test_frames_depend_on_the_seed_and_the_time_only() -> None:
    first, second = BodySimulator(frames=3, jitter=0.01), BodySimulator(frames=3, jitter=0.01)
    frames = list(first)
    again = second.frame(2 / 30)  # out of order
    np.testing.assert_array_equal(frames[2].depth, again.depth)
    np.testing.assert_array_equal(frames[2].color, again.color)
    np.testing.assert_array_equal(frames[2].skeletons[0].positions, again.skeletons[0].positions)
    other = BodySimulator(frames=3, jitter=0.01, seed=1).frame(2 / 30)
    assert (other.depth != again.depth).mean() > 0.3
    assert [frame.number for frame in frames] == [0, 1, 2]
    assert [frame.time_ns for frame in frames] == [0, 33_333_333, 66_666_667]


def test_somebody_who_keeps_still_is_cast_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Frames are those of a simulator that saw nothing before, and nobody else's to write to."""
    made: list[int] = []
    build = people.RayCaster.__init__

    def counted(self: people.RayCaster, *mesh: Any) -> None:
        made.append(1)
        build(self, *mesh)

    simulator = BodySimulator(motion="still", tracker="kinect-v2", occluder=(0.09, 0.11))
    first = simulator.capture(0.0)
    monkeypatch.setattr(people.RayCaster, "__init__", counted)
    assert first.frame.color is not None
    for image in (first.frame.color, first.truth.people, first.truth.depth, first.truth.bones):
        image[:] = 7
    later = simulator.capture(0.05)
    assert not made
    hidden = simulator.capture(0.1)
    assert len(made) == 1  # the board is there
    again = simulator.capture(0.12)
    assert len(made) == 2
    for seen, time in ((later, 0.05), (hidden, 0.1), (again, 0.12)):
        alone = replace(simulator).capture(time)
        for one, other in (
            (seen.frame.depth, alone.frame.depth),
            (seen.frame.color, alone.frame.color),
            (seen.frame.body_index, alone.frame.body_index),
            (seen.frame.skeletons[0].positions, alone.frame.skeletons[0].positions),
            (seen.truth.depth, alone.truth.depth),
            (seen.truth.people, alone.truth.people),
            (seen.truth.bones, alone.truth.bones),
        ):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("limb", sorted(LIMBS))
def test_a_missing_limb_has_no_pixels_beyond_its_stump(limb: Any) -> None:
    sitting = limb.endswith("leg")
    simulator = BodySimulator(motion="still", amputated=limb, stump=0.12, sitting=sitting)
    capture = simulator.capture(0.0)
    whole = BodySimulator(motion="still", sitting=sitting).capture(0.0)
    bones = LIMBS[limb]
    for bone in bones[2:]:
        assert not (capture.truth.bones == bone).any()
        assert (whole.truth.bones == bone).any() or bone in (21, 22, 23, 24)
    assert (capture.truth.bones == bones[1]).any()  # the stump
    states = capture.frame.skeletons[0].states
    assert (states[list(bones[1:])] == INFERRED).all()
    np.testing.assert_array_equal(capture.truth.joints, whole.truth.joints)
    assert capture.truth.body().num_faces == whole.truth.body().num_faces
    for side in (limb, opposite(limb)):
        np.testing.assert_array_equal(
            capture.truth.limb(side).vertices, whole.truth.limb(side).vertices
        )


def test_the_phantom_is_the_other_limb_where_the_pose_is_symmetric() -> None:
    truth = BodySimulator(motion="arm-raise", amputated="right_arm", side="both").capture(1.0).truth
    from manip3d.metrics import closest_points

    wanted, there = truth.phantom("right_arm"), truth.limb("right_arm")
    assert closest_points(there, wanted.vertices).distance.max() < 1e-5


def test_the_plane_of_symmetry_stays_when_shoulders_tilt_and_turns_with_the_body() -> None:
    tilted = BodySimulator(shoulder_tilt=10.0).capture(0.0).truth
    np.testing.assert_allclose(tilted.mirror_plane("left_arm")[1], (1.0, 0.0, 0.0), atol=1e-12)
    shoulders = tilted.joints[4] - tilted.joints[8]
    assert np.rad2deg(np.arctan2(-shoulders[1], shoulders[0])) == pytest.approx(10.0)
    turned = BodySimulator(turning=30.0).capture(1.5).truth  # 45 degrees to the left
    np.testing.assert_allclose(
        turned.mirror_plane("left_leg")[1], (np.sqrt(0.5), 0.0, np.sqrt(0.5)), atol=1e-12
    )


@pytest.mark.parametrize("sitting", [False, True])
@pytest.mark.parametrize("twist", [-20.0, 20.0])
def test_the_chest_turns_against_the_pelvis(twist: float, sitting: bool) -> None:
    """The pelvis and the legs stay, and the chest has turned farthest after a second."""
    straight, turned = (
        BodySimulator(motion="still", sitting=sitting, twist=angle).capture(1.0).truth
        for angle in (0.0, twist)
    )
    legs = [*LIMBS["left_leg"], *LIMBS["right_leg"]]
    np.testing.assert_array_equal(turned.joints[legs], straight.joints[legs])
    np.testing.assert_array_equal(turned.lateral[0], straight.lateral[0])
    before, after = straight.lateral[1], turned.lateral[1]
    angle = np.arctan2(after[2], after[0]) - np.arctan2(before[2], before[0])
    assert np.rad2deg(angle) == pytest.approx(twist)
    shoulders = turned.joints[4] - turned.joints[8]
    assert shoulders @ after == pytest.approx(np.linalg.norm(shoulders))
    with pytest.raises(InputError, match=r"limb: expected one of left_arm, .*, got 'tail'"):
        turned.mirror_plane("tail")  # type: ignore[arg-type]


def test_the_legs_of_a_sitting_person_turn_against_the_pelvis() -> None:
    straight, turned = (
        BodySimulator(motion="still", sitting=True, thigh_turn=turn).capture(0.0).truth
        for turn in (0.0, 20.0)
    )
    np.testing.assert_array_equal(turned.lateral, straight.lateral)
    for hip, knee in ((12, 13), (16, 17)):
        before, after = (t.joints[knee] - t.joints[hip] for t in (straight, turned))
        assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before))
        angle = np.arctan2(after[0], -after[2]) - np.arctan2(before[0], -before[2])
        assert np.rad2deg(angle) == pytest.approx(20.0)  # towards the person's left, +x
    standing = BodySimulator(motion="still", thigh_turn=20.0).capture(0.0).truth
    np.testing.assert_array_equal(
        standing.joints, BodySimulator(motion="still").capture(0.0).truth.joints
    )


def test_somebody_else_comes_in_with_an_index_of_their_own() -> None:
    simulator = BodySimulator(visitor=1.0, motion="still")
    assert len(simulator.frame(0.5).skeletons) == 1
    frame = simulator.frame(3.0)
    assert [(s.id, s.body) for s in frame.skeletons] == [(1, 0), (2, 1)]
    assert frame.body_index is not None
    for skeleton in frame.skeletons:
        row, column = pixels(skeleton.positions[[0, 1, 20]])
        assert (frame.body_index[row, column] == skeleton.body).all()
    ankles = [pose_figure(walk(t, turn=90.0), GROUND).joints[[14, 18], 1] for t in (0.1, 0.4)]
    assert max(ankles[0]) == pytest.approx(max(ankles[1]))  # one foot on the floor


def test_a_board_hides_the_intact_arm() -> None:
    simulator = BodySimulator(motion="still", amputated="right_arm", occluder=(1.0, 2.0))
    before, during = simulator.capture(0.5), simulator.capture(1.5)
    for bone in (6, 7):
        assert (before.truth.bones == bone).any()
        assert not (during.truth.bones == bone).any()
    assert before.frame.skeletons[0].states[5] == TRACKED
    assert during.frame.skeletons[0].states[5] == INFERRED
    row, column = pixels(before.truth.joints[[5]])
    assert during.truth.depth[row, column] < before.truth.depth[row, column] - 0.3
    assert during.truth.people[row, column] == NO_BODY


def test_a_tracker_sees_through_the_flesh_around_a_joint_and_no_more() -> None:
    seated = BodySimulator(motion="knee-extension").frame(1.2).skeletons[0].states
    assert (seated[[0, 12, 13, 14, 16, 17, 18]] == TRACKED).all()
    aside = BodySimulator(motion="still", turn=90.0).frame(0.0).skeletons[0].states
    assert (aside[[4, 5, 6, 7]] == INFERRED).all()  # beyond the trunk
    assert (aside[[3, 8, 9, 10, 11]] == TRACKED).all()


def test_a_lost_person_has_no_skeleton_and_no_index() -> None:
    simulator = BodySimulator(lost=(1.0, 2.0))
    frame = simulator.frame(1.0)
    assert frame.skeletons == ()
    assert frame.body_index is not None
    assert (frame.body_index == NO_BODY).all()
    assert len(simulator.frame(2.0).skeletons) == 1


def test_jitter_has_the_size_asked_for() -> None:
    simulator = BodySimulator(motion="still", jitter=0.01, color="none")
    truth = simulator.capture(0.0).truth.joints
    found = np.array([simulator.frame(i / 30).skeletons[0].positions for i in range(60)])
    assert (found - truth)[:, [0, 1, 4, 8, 13]].std() == pytest.approx(0.01, rel=0.1)


def test_color_has_its_own_camera_or_the_pixels_of_depth() -> None:
    full = BodySimulator(color="full", noise=0.0)
    frame = full.frame(1.0)
    registration = full.calibration.registration
    assert registration is not None
    assert frame.color is not None
    assert frame.color.shape == (1080, 1920, 3)
    small = BodySimulator(noise=0.0).frame(1.0)
    assert small.color is not None
    joints = frame.skeletons[0].positions[[1, 13]].astype(float)  # shirt, trousers
    seen = joints + registration.translation
    camera = registration.color
    column = np.rint(camera.cx + camera.fx * seen[:, 0] / seen[:, 2]).astype(int)
    row = np.rint(camera.cy + camera.fy * seen[:, 1] / seen[:, 2]).astype(int)
    expected = small.color[pixels(joints)].astype(float)
    np.testing.assert_allclose(frame.color[row, column], expected, atol=12.0)
    assert BodySimulator(color="none").frame(0.0).color is None


def test_shirts_and_shoes() -> None:
    def shirt(stripes: bool) -> np.ndarray:
        capture = BodySimulator(stripes=stripes, motion="still").capture(0.0)
        assert capture.frame.color is not None
        return capture.frame.color[capture.truth.bones == 20].astype(int)

    assert 0.3 < (shirt(True).min(axis=1) > 120).mean() < 0.6
    assert (shirt(False).min(axis=1) > 120).mean() < 0.05
    capture = BodySimulator(cover="left", motion="dorsiflexion").capture(0.0)
    assert capture.frame.color is not None
    r, g, b = capture.frame.color[capture.truth.bones == 15].astype(int).T
    assert (b - np.maximum(r, g) > 40).mean() > 0.8
    r, g, b = capture.frame.color[capture.truth.bones == 19].astype(int).T
    assert not (b - np.maximum(r, g) > 40).any()


def test_an_address_opens_the_simulator() -> None:
    source = open_source(
        "sim:body?motion=wave&amputated=left-arm&distance=3.05&lost=1:2.5&stripes=yes&frames=7"
        "&sitting=no&seed=4",
        threads=1,
    )
    assert source == BodySimulator(
        motion="wave",
        amputated="left_arm",
        distance=3.05,
        lost=(1.0, 2.5),
        stripes=True,
        frames=7,
        sitting=False,
        seed=4,
        threads=1,
    )
    assert source.calibration.depth is DEPTH_CAMERA
    assert len(source) == 7
    assert [frame.number for frame in source[5:]] == [5, 6]


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("sim:body?motion=fly", "motion: expected one of still, arm-raise"),
        ("sim:body?distance=20", "distance: expected 0.8 to 4.5, got 20.0"),
        ("sim:body?distance=nan", "distance: expected 0.8 to 4.5, got nan"),
        ("sim:body?lost=3", "lost: expected FROM:UNTIL, got '3'"),
        ("sim:body?stripes=1", "stripes: expected yes or no, got '1'"),
        ("sim:body?frames=1.5", "frames: expected a number, got '1.5'"),
        ("sim:body?resolution=1", "unknown option resolution; expected some of amputated, "),
    ],
)
def test_bad_options_are_named(address: str, text: str) -> None:
    with pytest.raises(InputError, match="^.*" + text.replace("(", r"\(")):
        open_source(address)


def test_a_time_before_the_beginning_is_refused() -> None:
    with pytest.raises(InputError, match="time: expected seconds >= 0"):
        BodySimulator().capture(-1.0)


def test_the_front_of_the_chest_breathes() -> None:
    """In two seconds by all of it, in four back, and neither joints nor the rest of the body."""
    scene = {"motion": "still", "room": False, "color": "none", "noise": 0.0}
    still = BodySimulator(**scene).capture(2.0).truth  # type: ignore[arg-type]
    breathing = BodySimulator(**scene, breath=0.02)  # type: ignore[arg-type]
    out, back = breathing.capture(2.0).truth, breathing.capture(4.0).truth
    np.testing.assert_array_equal(out.joints, still.joints)
    moved = out.body().vertices - still.body().vertices
    np.testing.assert_allclose(moved[:, 2].min(), -0.02, atol=5e-4)  # to the camera
    np.testing.assert_allclose(moved[:, :2], 0.0, atol=5e-3)
    chest = still.body().vertices[moved[:, 2] < -0.01]
    assert 0.2 < np.ptp(chest[:, 0]) < 0.4
    assert np.ptp(chest[:, 1]) < 0.25
    assert (moved[:, 2] > -0.001).mean() > 0.8
    np.testing.assert_allclose(back.body().vertices, still.body().vertices, atol=1e-6)
    nearer = (still.depth - out.depth)[(still.depth > 0) & (out.depth > 0)]
    assert np.quantile(nearer, 0.999) == pytest.approx(0.02, abs=0.004)


def test_trackers_are_wrong_in_their_own_way() -> None:
    """Sway turns the body; jitter remembers; bias turns with its bone; missing joints fly."""
    scene = {"motion": "still", "room": False, "color": "none", "amputated": "right_arm"}
    exact = BodySimulator(**scene)
    truth = exact.capture(0.5).truth
    swayed = BodySimulator(**scene, sway=20.0).capture(0.5).truth
    cosine = float(truth.lateral[1] @ swayed.lateral[1])
    assert np.rad2deg(np.arccos(cosine)) == pytest.approx(20.0, abs=0.1)

    def errors(**options: object) -> np.ndarray:
        simulator = BodySimulator(**scene, **options)  # type: ignore[arg-type]
        captures = [simulator.capture(1.0 + k / 30.0) for k in range(3)]
        return np.array([c.frame.skeletons[0].positions - c.truth.joints for c in captures])

    seen = [0, 1, 2, 3, 4, 5, 6, 20]
    slow = errors(jitter=0.01, correlation=0.9)[:, seen]
    fast = errors(jitter=0.01)[:, seen]
    assert np.abs(np.diff(slow, axis=0)).mean() < 0.6 * np.abs(np.diff(fast, axis=0)).mean()
    biased = errors(bias=0.02)[:, seen]
    np.testing.assert_allclose(np.linalg.norm(biased, axis=2), 0.02, atol=1e-4)
    np.testing.assert_allclose(biased[0], biased[1], atol=1e-4)
    flying = BodySimulator(**scene, tracker="kinect-v1").capture(1.0).frame.skeletons[0]
    assert (flying.states[[9, 10, 11]] == 2).all()
    with pytest.raises(InputError, match="tracker"):
        BodySimulator(tracker="eyes")


def test_a_tracker_may_swap_ids() -> None:
    simulator = BodySimulator(
        motion="still", room=False, color="none", visitor=0.0, swapped=(2.5, 3.0)
    )
    before = {s.body: s.id for s in simulator.frame(2.4).skeletons}
    during = {s.body: s.id for s in simulator.frame(2.7).skeletons}
    assert before == {0: 1, 1: 2}
    assert during == {0: 2, 1: 1}


def stump_pixels(limb: str, dressing: str, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Points and colours of the bones of a stump."""
    simulator = BodySimulator(amputated=limb, dressing=dressing, noise=0.0, room=False, **options)
    capture = simulator.capture(0.5)
    there = np.isin(capture.truth.bones, LIMBS[limb][1:])
    assert capture.frame.color is not None
    points = DEPTH_CAMERA.unproject(capture.truth.depth)
    return points[there], capture.frame.color[there].astype(int)


def test_a_bandage_is_white_and_makes_the_stump_thicker() -> None:
    options = {"motion": "still", "stump": 0.2}
    (bare, blue), (bound, white) = (
        stump_pixels("right_arm", name, **options) for name in ("bare", "bandage")
    )
    assert (white.min(axis=1) > 90).mean() > 0.4
    assert (blue.min(axis=1) > 90).mean() < 0.2
    above_end = bare[:, 1].max() - np.array([0.07, 0.05])
    widths = [
        np.ptp(points[(points[:, 1] > above_end[0]) & (points[:, 1] < above_end[1]), 0])
        for points in (bare, bound)
    ]
    assert widths[1] - widths[0] == pytest.approx(0.016, abs=0.008)
    assert bound[:, 1].max() - bare[:, 1].max() < 0.02


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_empty_sleeve_hangs_down_whatever_the_stump_does(side: str) -> None:
    """The stump is raised sideways; below its end flat cloth hangs, of the shirt's colour."""
    limb = f"{side}_arm"
    options = {"motion": "elbow-bent", "side": "both", "stump": 0.15}
    bare, _ = stump_pixels(limb, "bare", **options)
    points, colors = stump_pixels(limb, "sleeve", **options)
    hanging = points[:, 1] > bare[:, 1].max() + 0.05
    # From the wrist to the stump's end, less what the bare end reaches beyond it.
    assert points[:, 1].max() - bare[:, 1].max() == pytest.approx(0.285, abs=0.015)
    cloth = points[hanging]
    is_low = cloth[:, 1] > np.median(cloth[:, 1])
    high, low = cloth[~is_low], cloth[is_low]
    assert abs(high[:, 0].mean() - low[:, 0].mean()) < 0.005  # upright
    assert np.ptp(cloth[:, 2]) < 0.03  # flat
    r, g, b = colors[hanging].T
    assert ((b > r) & (b > g)).all()


@pytest.mark.parametrize(("limb", "most"), [("left_arm", 0.26), ("right_leg", 0.39)])
def test_a_sleeve_needs_a_stump_that_ends_above_the_joint(limb: str, most: float) -> None:
    BodySimulator(amputated=limb, dressing="sleeve", stump=most)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"dressing: .* above the elbow or knee, at most 0"):
        BodySimulator(amputated=limb, dressing="sleeve", stump=most + 0.02)  # type: ignore[arg-type]


def test_an_empty_leg_of_trousers_lies_on_the_seat_and_hangs_from_the_knee() -> None:
    options = {"motion": "knee-extension", "stump": 0.15}
    truth = BodySimulator(amputated="left_leg", noise=0.0, **options).capture(0.5).truth  # type: ignore[arg-type]
    bare, _ = stump_pixels("left_leg", "bare", **options)
    points, _ = stump_pixels("left_leg", "sleeve", **options)
    knee, ankle = truth.joints[[13, 14]]
    assert bare[:, 1].max() < knee[1] + 0.1
    assert points[:, 1].max() == pytest.approx(knee[1] + 0.355, abs=0.03)
    below = points[points[:, 1] > knee[1] + 0.08]
    assert abs(below[:, 2] - knee[2]).max() < 0.05
    assert ankle[2] < knee[2] + 0.1  # the person has all joints, the truth's too


def test_a_wheelchair_stands_around_who_sits_in_it() -> None:
    options = {"motion": "still", "noise": 0.0, "color": "none"}
    sitting = BodySimulator(chair="wheelchair", **options)  # type: ignore[arg-type]
    seated, truth = sitting.background(0.0).depth, sitting.capture(0.0).truth
    chair = BodySimulator(sitting=True, **options).background(0.0).depth  # type: ignore[arg-type]
    np.testing.assert_array_equal(
        truth.joints,
        BodySimulator(sitting=True, **options).capture(0.0).truth.joints,  # type: ignore[arg-type]
    )
    points = DEPTH_CAMERA.unproject(seated.astype(np.float32) / 1000)[seated < chair]
    wheels = points[np.abs(np.abs(points[:, 0]) - 0.315) < 0.014]
    assert len(wheels) > 300
    reach = np.hypot(wheels[:, 1] - (0.95 - 0.30), wheels[:, 2] - (2.4384 + 0.12))
    assert np.quantile(reach, 0.95) == pytest.approx(0.30, abs=0.01)
    feet = truth.joints[[15, 19]]
    rests = points[(points[:, 1] > 0.90) & (np.abs(points[:, 0]) < 0.21)]
    for foot in feet:
        assert np.linalg.norm((rests - foot)[:, [0, 2]], axis=1).min() < 0.10


@pytest.mark.parametrize(
    ("address", "text"),
    [
        ("sim:body?dressing=bandage", "dressing: expected bare without amputated, got 'bandage'"),
        ("sim:body?dressing=gold", "dressing: expected one of bare, bandage, sleeve, got 'gold'"),
        ("sim:body?chair=sofa", "chair: expected one of chair, wheelchair, got 'sofa'"),
        ("sim:body?chair=wheelchair&sitting=no", "chair: expected chair with sitting=no"),
    ],
)
def test_a_stump_and_a_chair_that_cannot_be(address: str, text: str) -> None:
    with pytest.raises(InputError, match=text):
        open_source(address)


@pytest.mark.parametrize("girth", [1.0, 1.2, 1.4, 1.6, 1.8])
def test_the_arms_of_stout_people_hang_beside_their_trunks(girth: float) -> None:
    """Between each elbow and the spine, the skin of the arm begins where the trunk ends."""
    simulator = BodySimulator(motion="still", girth=girth, color="none", noise=0.0, frames=1)
    joints = dict(zip(JOINTS, simulator.capture(0.0).truth.joints, strict=True))
    for side in ("Left", "Right"):
        elbow = joints[f"Elbow{side}"]
        away = abs(elbow[0] - joints["SpineMid"][0])
        waist, arm = 0.141 * 1.1 * girth, 0.04 * 1.1 * girth  # as the skin is built
        assert away > waist + arm - 0.03  # clothes touch


def test_strong_correlation_keeps_the_size_of_the_jitter() -> None:
    """A sum over 65 frames had 85 % of it at a correlation of 0.99."""
    scene = {"motion": "still", "room": False, "color": "none"}
    simulator = BodySimulator(**scene, jitter=0.01, correlation=0.99)  # type: ignore[arg-type]
    exact = simulator.capture(0.0).truth.joints
    seen = [0, 1, 2, 3, 4, 5, 6, 20]
    frames = [simulator.frame(k * 20.0) for k in range(60)]
    off = np.array([f.skeletons[0].positions[seen] - exact[seen] for f in frames])
    # 1440 independent values: four standard errors of their deviation are 7.5 %.
    assert np.sqrt(np.mean(off**2)) == pytest.approx(0.01, rel=0.075)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"girth": "1"}, "girth: expected a number"),
        ({"amputated": 3}, "amputated: expected a text"),
        ({"frames": 2.5}, "frames: expected a whole number"),
        ({"lost": (1.0,)}, "lost: expected 2 values"),
        ({"occluder": 5}, "occluder: expected 2 values"),
        ({"lost": (2.0, 1.0)}, "lost: expected 0 <= begin <= end"),
        ({"swapped": (-1.0, 1.0)}, "swapped: expected 0 <= begin <= end"),
        ({"occluder": (np.nan, 1.0)}, "occluder: expected 0 <= begin <= end"),
        ({"visitor": "a"}, "visitor: expected a number"),
        ({"visitor": np.nan}, "visitor: expected seconds >= 0"),
    ],
)
def test_options_of_other_types_and_times_are_refused(option: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        BodySimulator(**option)


def test_limbs_that_do_not_exist_are_refused() -> None:
    truth = BodySimulator(room=False, color="none").capture(0.0).truth
    for ask in (truth.limb, truth.phantom, truth.mirror_plane):
        with pytest.raises(InputError, match="expected one of left_arm"):
            ask("arm")  # type: ignore[arg-type]


# --- A camera that is not level -------------------------------------------------------------------

TURNED = about("z", 10.0) @ about("x", 20.0)
PIVOT = np.array([0.0, 0.0, 2.44])


def level(points: np.ndarray) -> np.ndarray:
    """Points before the camera was rotated."""
    return np.asarray((points - PIVOT) @ TURNED + PIVOT)


def test_a_tilted_camera_sees_the_same_person_and_floor() -> None:
    options: dict[str, Any] = {"motion": "stepping", "noise": 0.0, "distance": 2.44}
    plain = BodySimulator(**options).capture(0.7)
    seen = BodySimulator(**options, tilt=20.0, roll=10.0).capture(0.7)
    np.testing.assert_allclose(level(seen.truth.joints), plain.truth.joints, atol=1e-9)
    told, before = (one.frame.skeletons[0].positions for one in (seen, plain))
    np.testing.assert_allclose(level(told), before, atol=1e-5)
    np.testing.assert_allclose(seen.truth.lateral, plain.truth.lateral @ TURNED.T, atol=1e-12)
    turned, bones = (
        rotations_of(one.frame.skeletons[0].orientations[[1, 5, 17]].astype(float))
        for one in (seen, plain)
    )
    np.testing.assert_allclose(turned, TURNED @ bones, atol=1e-5)
    # The floor is level and nothing is below it.
    points = level(DEPTH_CAMERA.unproject(seen.truth.depth).astype(float))
    height = points[seen.truth.depth > 0][:, 1]
    assert height.max() < people.CAMERA_HEIGHT + 1e-3
    assert (np.abs(height - people.CAMERA_HEIGHT) < 1e-3).mean() > 0.1
    # The picture is that of the surface that the truth tells.
    surface = people.cast_mesh(seen.truth.body(), DEPTH_CAMERA)
    shown = seen.truth.people == 0
    np.testing.assert_allclose(surface[shown], seen.truth.depth[shown], atol=1e-4)


def test_a_positive_tilt_looks_down_and_a_positive_roll_turns_clockwise() -> None:
    still = BodySimulator(motion="still", noise=0.0, room=False)
    head, base = (still.capture(0.0).truth.joints[j] for j in (JOINTS.index("Head"), 0))
    high = replace(still, tilt=20.0).capture(0.0).truth.joints
    assert high[JOINTS.index("Head"), 2] - high[0, 2] < head[2] - base[2] - 0.1  # nearer
    right = replace(still, roll=20.0).capture(0.0).truth.joints
    assert right[JOINTS.index("Head"), 0] > right[0, 0] + 0.1


def test_an_empty_sleeve_hangs_down_before_a_tilted_camera() -> None:
    skin = build_skin("right_arm", 0.15, 1.0, "sleeve")
    figure = replace(pose_figure(pose_at("arm-raise", 1.1), GROUND), breath=0.01)
    turned = turned_figure(figure, TURNED, (0.0, 0.0, 2.44))
    found = level(skin.vertices(turned).astype(float))
    np.testing.assert_allclose(found, skin.vertices(figure), atol=1e-5)


def level_things(tilt: float, **options: Any) -> np.ndarray:
    """Measured points of what is not the person, as a level camera would see them."""
    still: dict[str, Any] = {"motion": "knee-extension", "noise": 0.0, "color": "none"}
    truth = BodySimulator(**still, distance=PIVOT[2], tilt=tilt, **options).capture(0.0).truth
    is_thing = (truth.depth > 0) & (truth.people != 0)
    points = DEPTH_CAMERA.unproject(truth.depth)[is_thing].astype(float)
    return np.asarray((points - PIVOT) @ about("x", tilt) + PIVOT)


@pytest.mark.parametrize("tilt", [12.0, -12.0])
def test_an_occluder_before_a_tilted_camera_stands_upright(tilt: float) -> None:
    board, plain = (level_things(each, occluder=(0.0, 1.0), room=False) for each in (tilt, 0.0))
    assert np.ptp(board[:, 2]) < 0.05  # its thickness of 0.04 m
    for end in (np.min, np.max):  # an edge is known to a pixel, 5 mm
        np.testing.assert_allclose(end(board, 0)[:2], end(plain, 0)[:2], atol=0.01)
    assert board[:, 2].min() == pytest.approx(plain[:, 2].min(), abs=2e-3)


@pytest.mark.parametrize("tilt", [12.0, -12.0])
def test_a_chair_before_a_tilted_camera_stands_on_the_floor(tilt: float) -> None:
    def chair(tilt: float) -> np.ndarray:
        """Points between the floor and the wall behind."""
        points = level_things(tilt)
        is_above = points[:, 1] < people.CAMERA_HEIGHT - 0.02
        is_before = (np.abs(points[:, 0]) < 1.0) & (points[:, 2] < PIVOT[2] + 1.0)
        return points[is_above & is_before]

    seen, plain = chair(tilt), chair(0.0)
    # Legs and seat in front, legs and back behind: which share is seen depends on the tilt.
    for share in (5, 95):
        np.testing.assert_allclose(
            np.percentile(seen[:, ::2], share, axis=0),
            np.percentile(plain[:, ::2], share, axis=0),
            atol=0.01,
        )
    assert seen[:, 1].max() == pytest.approx(plain[:, 1].max(), abs=0.01)


def test_a_camera_below_the_floor_is_refused() -> None:
    with pytest.raises(InputError, match=r"tilt: expected above -22\.9, .* or room=no, got -30"):
        BodySimulator(tilt=-30.0)
    simulator = open_source("sim:body?tilt=-30&roll=5&room=no")
    assert isinstance(simulator, BodySimulator)
    assert (simulator.tilt, simulator.roll) == (-30.0, 5.0)
    with pytest.raises(InputError, match="roll: expected -60 to 60"):
        BodySimulator(roll=90.0)
