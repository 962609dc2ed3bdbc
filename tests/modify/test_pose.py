"""Landmarks of a picture become joints in space; MediaPipe finds people in pictures."""

from __future__ import annotations

import importlib.util
import sys
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import manip3d
from capsule_body import frame as body_frame
from capsule_body import pose as body_pose
from manip3d import datasets, modify, rgbd
from manip3d.modify import _pose as pose
from manip3d.viewer.phantom import render_phantom

CAMERA = manip3d.Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)
NAMES = modify.joint_layouts()["mediapipe"]
NEITHER = 200  # two people at the same distance
KNEE, NOSE, HIP = (NAMES.index(name) for name in ("KneeLeft", "Nose", "HipRight"))


def picture(depth: np.ndarray, body: np.ndarray | None = None) -> manip3d.RgbdFrame:
    return manip3d.RgbdFrame(
        depth, manip3d.RgbdCalibration(CAMERA), color=np.zeros((48, 64, 3), np.uint8),
        body_index=body,
    )  # fmt: skip


def wall(metres: float) -> np.ndarray:
    return np.full((48, 64), round(metres * 1000), np.uint16)


def lift(frame: manip3d.RgbdFrame, pixels: dict[int, tuple[float, float]] | None = None, **options):
    at = np.full((33, 2), (31.5, 23.5))
    for landmark, pixel in (pixels or {}).items():
        at[landmark] = pixel
    values = {"visibility": np.ones(33), "relative_depth": np.zeros(33)} | options
    return modify.lift_landmarks(at, values.pop("visibility"), values.pop("relative_depth"), frame,
                                 **values)  # fmt: skip


def test_a_joint_lies_behind_the_skin_on_its_line_of_sight() -> None:
    positions, states = lift(picture(wall(2.0)), {KNEE: (56.5, 23.5)})
    assert (states == rgbd.TRACKED).all()
    # 25 pixels off the axis at f = 50: sight (0.5, 0, 1), 6 cm along it behind the wall.
    skin = np.array([1.0, 0.0, 2.0])
    np.testing.assert_allclose(
        positions[KNEE], skin + 0.06 * skin / np.linalg.norm(skin), atol=1e-12
    )
    np.testing.assert_allclose(positions[HIP], [0, 0, 2.1], atol=1e-12)
    np.testing.assert_allclose(positions[NAMES.index("EarLeft")], [0, 0, 2.0], atol=1e-12)


def test_a_landmark_without_a_distance_is_not_tracked() -> None:
    """One unknown relative depth made all inferred joints NaN, although their states were fine."""
    visible, relative = np.ones(33), np.zeros(33)
    visible[[KNEE, NOSE]] = 0.0  # hidden
    relative[[KNEE, HIP]] = np.nan, np.inf
    positions, states = lift(picture(wall(2.0)), visibility=visible, relative_depth=relative)
    assert np.isfinite(positions).all()
    assert (states[HIP], states[NOSE], states[KNEE]) == (
        rgbd.TRACKED, rgbd.INFERRED, rgbd.NOT_TRACKED,
    )  # fmt: skip
    np.testing.assert_allclose(positions[HIP], [0, 0, 2.1], atol=1e-12)  # it has a depth
    assert 1.9 < positions[NOSE, 2] < 2.1
    positions, states = lift(
        picture(wall(2.0)), visibility=visible, relative_depth=np.full(33, np.nan)
    )
    assert np.isfinite(positions).all()
    assert (states[NOSE], states[HIP]) == (rgbd.NOT_TRACKED, rgbd.TRACKED)


def test_the_line_of_sight_is_that_of_the_lens() -> None:
    """Lifting undoes lens distortion, by which pixel (470, 380) is 34 mm off at 3.5 metres."""
    lens = manip3d.Intrinsics(
        512, 424, 365.0, 365.0, 256.0, 210.0, distortion=(0.1, -0.27, 0.0, 0.0, 0.1)
    )
    depth = np.full((424, 512), 3500, np.uint16)
    frame = manip3d.RgbdFrame(depth, manip3d.RgbdCalibration(lens))
    positions, states = lift(frame, {NAMES.index("EarLeft"): (470, 380)})  # an ear has no radius
    assert (states == rgbd.TRACKED).all()
    ear = positions[NAMES.index("EarLeft")]
    ideal = np.array([(470 - 256) / 365, (380 - 210) / 365, 1.0]) * 3.5
    assert np.linalg.norm(ear - ideal) == pytest.approx(0.034, abs=1e-3)
    x, y = ear[:2] / ear[2]
    r2 = x * x + y * y
    radial = 1 + 0.1 * r2 - 0.27 * r2**2 + 0.1 * r2**3
    seen = (256 + 365 * x * radial, 210 + 365 * y * radial)
    np.testing.assert_allclose(seen, (470, 380), atol=1e-6)


class Landmarks:
    """A result of MediaPipe with all landmarks at one place of the picture."""

    def __init__(self, x: float, y: float) -> None:
        mark = types.SimpleNamespace(x=x, y=y, z=0.0, visibility=1.0)
        self.pose_landmarks = self.pose_world_landmarks = types.SimpleNamespace(
            landmark=[mark] * 33
        )


@pytest.mark.parametrize(("width", "height"), [(64, 48), (160, 120), (40, 30)])
def test_colour_may_have_a_camera_of_its_own(
    width: int, height: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Joints are in the depth camera's axes; the colour camera is 10 cm aside and turned."""
    angle = np.deg2rad(5.0)
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    color = CAMERA.resized(width, height)
    registration = manip3d.Registration(color, turn, np.array([0.1, 0.02, 0.01]))
    depth = wall(3.0)
    depth[:, 32:] = 2000
    body = np.where(depth == 2000, 4, rgbd.NO_BODY).astype(np.uint8)
    frame = manip3d.RgbdFrame(
        depth, manip3d.RgbdCalibration(CAMERA, registration),
        color=np.zeros((height, width, 3), np.uint8), body_index=body,
    )  # fmt: skip
    wanted = np.array([0.3, -0.2, 2.0])
    u, v = color.project(turn @ wanted + registration.translation)
    found = Landmarks((u + 0.5) / width, (v + 0.5) / height)
    model = types.SimpleNamespace(process=lambda _: found, close=lambda: None)
    monkeypatch.setattr(modify.PoseTracker, "_start", lambda _: model)
    with modify.PoseTracker() as tracker:
        skeleton = tracker.find(frame)
        assert skeleton is not None
        # Behind the skin by the joint's radius; a pixel is 4 cm (5 cm of the small picture).
        np.testing.assert_allclose(skeleton.positions[6], np.add(wanted, (0, 0, 0.025)), atol=0.05)
        assert skeleton.body == 4
        with pytest.raises(manip3d.InputError, match=r"frame\.color"):
            tracker.find(replace(frame, color=None))


def test_the_colour_camera_s_depth_by_brute_force() -> None:
    """Each measured pixel is projected by itself, and the nearest one at each pixel is kept."""
    random = np.random.default_rng(5)
    depth = random.integers(1500, 2500, (48, 64)).astype(np.uint16)
    depth[random.random((48, 64)) < 0.2] = 0
    depth[3, 4] = 1
    body = random.integers(0, 5, (48, 64)).astype(np.uint8)
    angle = 0.1
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    color = manip3d.Intrinsics(100, 80, 40.0, 42.0, 50.0, 39.0)  # its pixels are wider
    registration = manip3d.Registration(color, turn, np.array([0.15, -0.08, 0.3]))
    frame = manip3d.RgbdFrame(
        depth, manip3d.RgbdCalibration(CAMERA, registration),
        color=np.zeros((80, 100, 3), np.uint8), body_index=body,
    )  # fmt: skip
    seen = pose.depth_under_color(frame)
    expected = np.zeros((80, 100), np.uint16)
    people = np.full((80, 100), rgbd.NO_BODY, np.uint8)
    for v, u in np.argwhere(depth):
        z = depth[v, u] / 1000.0
        at_depth = np.array([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z])
        x, y, z = turn @ at_depth + registration.translation
        column, row = round(40.0 * x / z + 50.0), round(42.0 * y / z + 39.0)
        millimetres = round(1000.0 * z)
        if 0 <= column < 100 and 0 <= row < 80:
            before = expected[row, column]
            if before == 0 or millimetres < before:
                expected[row, column], people[row, column] = millimetres, body[v, u]
            elif millimetres == before:
                people[row, column] = NEITHER
    assert (seen.calibration.depth.width, seen.calibration.depth.height) == (100, 80)
    assert (expected > 0).sum() > 1000
    # Points are of single precision: a millimetre, and few that lie between two pixels.
    same = (seen.depth > 0) == (expected > 0)
    assert same.mean() > 0.999
    both = (seen.depth > 0) & (expected > 0)
    assert (np.abs(seen.depth[both].astype(int) - expected[both].astype(int)) <= 1).mean() > 0.995
    known = both & (people != NEITHER)
    assert (seen.body_index[known] == people[known]).mean() > 0.995
    assert (seen.body_index[~both & same] == rgbd.NO_BODY).all()
    bare = replace(frame, body_index=None, calibration=manip3d.RgbdCalibration(CAMERA), color=None)
    assert pose.depth_under_color(bare) is bare


def test_a_small_picture_is_not_blown_up() -> None:
    """The depth under a larger colour image keeps the resolution of the depth camera."""
    color = manip3d.Intrinsics(640, 400, 500.0, 500.0, 319.5, 199.5)
    registration = manip3d.Registration(color, np.eye(3), np.zeros(3))
    frame = manip3d.RgbdFrame(
        wall(2.0), manip3d.RgbdCalibration(CAMERA, registration),
        color=np.zeros((400, 640, 3), np.uint8),
    )  # fmt: skip
    seen = pose.depth_under_color(frame)
    assert seen.depth.shape == (40, 64)
    assert (seen.depth == 2000).all()
    assert seen.body_index is None


class Found:
    """A result of MediaPipe with each landmark at a place of its own."""

    def __init__(self, pixels: np.ndarray, visibility: np.ndarray) -> None:
        at = (pixels + 0.5) / (64, 48)
        marks = [
            types.SimpleNamespace(x=x, y=y, z=0.0, visibility=seen)
            for (x, y), seen in zip(at, visibility, strict=True)
        ]
        self.pose_landmarks = self.pose_world_landmarks = types.SimpleNamespace(landmark=marks)


def test_a_skeleton_has_the_states_and_the_person_of_its_landmarks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pixels = np.tile([40.0, 20.0], (33, 1))
    left_ankle, right_ankle = NAMES.index("AnkleLeft"), NAMES.index("AnkleRight")
    pixels[left_ankle] = (40.0, 60.0)  # below the picture
    visibility = np.ones(33)
    visibility[right_ankle] = 0.65
    body = np.full((48, 64), rgbd.NO_BODY, np.uint8)
    body[:, 32:] = 3
    body[:, 62:] = 1
    frame = picture(wall(2.0), body)
    model = types.SimpleNamespace(
        process=lambda color: Found(pixels, visibility) if color is frame.color else None
    )
    monkeypatch.setattr(modify.PoseTracker, "_start", lambda _: model)
    names = list(rgbd.JOINTS)
    for least, state in ((0.6, rgbd.TRACKED), (0.7, rgbd.INFERRED)):
        (skeleton,) = modify.PoseTracker(min_visibility=least).annotate(frame).skeletons
        assert skeleton.body == 3
        assert skeleton.states[names.index("AnkleRight")] == state
        assert skeleton.states[names.index("AnkleLeft")] == rgbd.NOT_TRACKED
        assert not skeleton.positions[names.index("AnkleLeft")].any()
    at_the_edge = np.tile([63.4, 47.4], (33, 1))
    model.process = lambda _: Found(at_the_edge, np.ones(33))
    (skeleton,) = modify.PoseTracker().annotate(frame).skeletons
    assert skeleton.body == 1
    model.process = lambda _: Found(pixels + 100, np.ones(33))
    assert modify.PoseTracker().annotate(frame).skeletons == ()
    for least in (0.0, 1.0):
        modify.PoseTracker(min_confidence=least)
    with pytest.raises(manip3d.InputError, match=r"min_confidence: expected 0 to 1, got 1\.5"):
        modify.PoseTracker(min_confidence=1.5)


def test_a_film_begins_before_there_is_colour(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = body_frame(body_pose(), number=0)
    second = replace(
        body_frame(body_pose(), number=1),
        color=np.zeros((*first.depth.shape, 3), np.uint8),
        skeletons=(),
    )
    nobody = types.SimpleNamespace(pose_landmarks=None)
    model = types.SimpleNamespace(process=lambda _: nobody, close=lambda: None)
    monkeypatch.setattr(modify.PoseTracker, "_start", lambda _: model)
    film = render_phantom([replace(first, color=None), second], tmp_path / "film", pose=True)
    assert film.frames == 2
    assert film.frames_with_skeleton == 1


def test_a_tracker_that_was_closed_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    nobody = types.SimpleNamespace(pose_landmarks=None)
    closed = []
    model = types.SimpleNamespace(process=lambda _: nobody, close=lambda: closed.append(1))
    monkeypatch.setattr(modify.PoseTracker, "_start", lambda _: model)
    with modify.PoseTracker() as tracker:
        pass
    tracker.close()
    assert closed == [1]
    with pytest.raises(manip3d.InputError, match="pose tracker was closed"):
        tracker.find(picture(wall(2.0)))


def test_depth_is_the_median_of_the_person_s_pixels_in_the_window() -> None:
    depth = wall(3.0)
    body = np.full((48, 64), rgbd.NO_BODY, np.uint8)
    depth[10:15, 20:25] = 0
    depth[10, 20:23] = (1900, 2000, 2500)  # three of the 25 are the person's and measured
    body[10:12, 20:25] = 0
    positions, states = lift(picture(depth, body), {KNEE: (22, 12)})
    assert states[KNEE] == rgbd.TRACKED
    radius = 0.06 / np.linalg.norm([(22 - 31.5) / 50, (12 - 23.5) / 50, 1])
    assert positions[KNEE, 2] == pytest.approx(2.0 + radius)


@pytest.mark.parametrize("window", [1, 3, 7])
def test_depth_under_each_pixel_by_brute_force(window: int) -> None:
    random = np.random.default_rng(window)
    depth = random.integers(1, 4000, (48, 64)).astype(np.uint16)
    depth[random.random((48, 64)) < 0.5] = 0
    body = np.where(random.random((48, 64)) < 0.5, rgbd.NO_BODY, 0).astype(np.uint8)
    pixels = [(0, 0), (63, 0), (0, 47), (63, 47), (1, 46), (62, 1), (31, 20), (63, 24), (7, 47)]
    pixels += [tuple(pixel) for pixel in random.integers(0, (64, 48), (40, 2))]
    for people in (None, body):
        frame = picture(depth, people)
        found = pose._median_depth(np.array(pixels, np.float64), frame, window)
        for (u, v), metres in zip(pixels, found, strict=True):
            reach = window // 2
            square = (
                slice(max(v - reach, 0), v + reach + 1),
                slice(max(u - reach, 0), u + reach + 1),
            )
            values = depth[square][(depth[square] > 0) & (people is None or body[square] == 0)]
            middle = np.sort(values)[(len(values) - 1) // 2] if len(values) else 0
            assert metres == middle / 1000.0


def test_a_corner_s_window_ends_at_the_picture() -> None:
    depth = wall(2.0)
    depth[-1, :] = depth[:, -1] = 9000  # what a window that wraps round would take
    positions, _ = lift(picture(depth), {NOSE: (0, 0)}, window=3)
    assert positions[NOSE, 2] == pytest.approx(2.0, abs=0.1)


def test_hidden_landmarks_take_their_distance_from_the_others() -> None:
    depth = wall(2.0)
    depth[:, 50:] = 0
    visibility = np.ones(33)
    visibility[NOSE] = 0.2
    relative = np.zeros(33)
    relative[[NOSE, KNEE]] = (-0.3, 0.4)
    pixels = {KNEE: (60.0, 23.5), NAMES.index("FootIndexLeft"): (31.5, 48.0)}
    positions, states = lift(picture(depth), pixels, visibility=visibility, relative_depth=relative)
    assert states[[NOSE, KNEE]].tolist() == [rgbd.INFERRED, rgbd.INFERRED]
    assert states[NAMES.index("FootIndexLeft")] == rgbd.NOT_TRACKED  # below the picture
    others = np.median(positions[states == rgbd.TRACKED, 2])
    assert positions[NOSE, 2] == pytest.approx(others - 0.3)
    assert positions[KNEE, 2] == pytest.approx(others + 0.4)
    assert positions[KNEE, 0] / positions[KNEE, 2] == pytest.approx((60 - 31.5) / 50)


def test_without_depth_nothing_is_made_up() -> None:
    positions, states = lift(picture(wall(0.0)))
    assert not states.any()
    assert not positions.any()


def test_wrong_arguments_are_named() -> None:
    frame = picture(wall(2.0))
    with pytest.raises(
        manip3d.InputError, match=r"pixels, visibility, relative_depth: .* got \(3, 2\)"
    ):
        modify.lift_landmarks(np.zeros((3, 2)), np.ones(33), np.ones(33), frame)
    with pytest.raises(manip3d.InputError, match="window: expected an odd number of pixels, got 4"):
        lift(frame, window=4)
    with pytest.raises(manip3d.InputError, match="min_visibility: expected 0 to 1, got nan"):
        modify.PoseTracker(min_visibility=float("nan"))


def test_a_missing_mediapipe_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in ("mediapipe", "mediapipe.python.solutions.pose"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(manip3d.MissingExtraError, match=r"pip install 'manip3d\[pose\]'"):
        modify.PoseTracker()


@pytest.mark.realdata
@pytest.mark.skipif(
    importlib.util.find_spec("mediapipe") is None, reason="the extra 'pose' is not installed"
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.filterwarnings("ignore::UserWarning")
class TestMediaPipe:
    def test_it_finds_all_six_people_of_kinect_v2_geometry(self) -> None:
        with modify.PoseTracker(static=True) as tracker:
            for name in ("normalgan", "frontsurfaces"):
                for frame in datasets.open_people(f"people:person_{name}"):
                    self.check(tracker.find(frame), frame)
                    assert len(tracker.annotate(frame).skeletons) == 1

    def check(self, skeleton: manip3d.Skeleton | None, frame: manip3d.RgbdFrame) -> None:
        assert skeleton is not None
        assert skeleton.body == 0
        assert (skeleton.states != rgbd.NOT_TRACKED).all()
        assert np.mean(skeleton.states == rgbd.TRACKED) > 0.6
        joints = dict(zip(rgbd.JOINTS, skeleton.positions, strict=True))
        # All six face the camera, head up.
        assert joints["ShoulderRight"][0] < joints["ShoulderLeft"][0]
        assert joints["Head"][1] < joints["SpineBase"][1] < joints["KneeLeft"][1]
        for side in ("Left", "Right"):
            thigh = np.linalg.norm(joints[f"Knee{side}"] - joints[f"Hip{side}"])
            upper_arm = np.linalg.norm(joints[f"Elbow{side}"] - joints[f"Shoulder{side}"])
            assert 0.28 < thigh < 0.5
            assert 0.17 < upper_arm < 0.4
        tracked = skeleton.positions[skeleton.states == rgbd.TRACKED]
        u, v = frame.calibration.depth.project(tracked).T
        on_body = frame.body_index[np.rint(v).astype(int), np.rint(u).astype(int)] == 0
        assert on_body.mean() > 0.85

    def test_an_empty_picture_has_nobody(self) -> None:
        with modify.PoseTracker() as tracker:
            frame = picture(wall(2.0))
            assert tracker.find(frame) is None
            assert tracker.annotate(frame).skeletons == ()
            tracker.reset()
            with pytest.raises(manip3d.InputError, match=r"frame\.color: expected colour"):
                tracker.find(manip3d.RgbdFrame(wall(2.0), manip3d.RgbdCalibration(CAMERA)))
