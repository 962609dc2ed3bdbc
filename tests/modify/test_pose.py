"""Landmarks of a picture become joints in space; MediaPipe finds the people there are."""

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
from manip3d.viewer.phantom import render_phantom

CAMERA = manip3d.Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)
NAMES = modify.joint_layouts()["mediapipe"]
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


def test_the_line_of_sight_is_that_of_the_lens() -> None:
    """Without the distortion, pixel (470, 380) of this lens is 34 mm off at 3.5 metres."""
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
    """As MediaPipe gives them: all at one place of the picture."""

    def __init__(self, x: float, y: float) -> None:
        mark = types.SimpleNamespace(x=x, y=y, z=0.0, visibility=1.0)
        self.pose_landmarks = self.pose_world_landmarks = types.SimpleNamespace(
            landmark=[mark] * 33
        )


@pytest.mark.parametrize(("width", "height"), [(64, 48), (160, 120), (40, 30)])
def test_colour_may_have_a_camera_of_its_own(
    width: int, height: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A colour camera 10 cm aside and turned by 5 degrees: joints lie where the depth camera is."""
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
    with pytest.raises(manip3d.InputError, match=r"landmarks: .* got \(3, 2\)"):
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
