"""Games, checks and films where the camera is not level: what is told is along the vertical."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import capsule_body
from frame_reader import read_frame
from manip3d import Skeleton
from manip3d.modify import DownSource, PhantomFrame, PhantomPipeline
from manip3d.modify._level import LEAST_DEG
from manip3d.phantom import LiveSession
from manip3d.phantom._clips import picture
from manip3d.phantom._level import Level
from manip3d.phantom._setup import placement_checks
from manip3d.phantom.games import begin, keys_of, step
from manip3d.rgbd import JOINTS
from manip3d.simulate._figure import about

PLAYER = capsule_body.pose()
MIDDLE = PLAYER.positions[0].astype(np.float64)
FEET = [JOINTS.index(f"Foot{side}") for side in ("Left", "Right")]
RATE = 16
CAMERA = capsule_body.painted(0).calibration.depth
TILTS = [(10, 0), (-10, 0), (20, 0), (-20, 0), (30, 0), (-30, 0), (0, 20), (0, -20)]


@functools.cache
def processed() -> PhantomFrame:
    return PhantomPipeline("left_leg").process(capsule_body.painted(0))


def seen(
    body: Skeleton, tilt: float, roll: float = 0.0, source: DownSource = DownSource.FLOOR
) -> PhantomFrame:
    """A result for a camera that is rotated about the player's hips; it looks down by ``tilt``."""
    rotation = about("z", roll) @ about("x", tilt)
    places = (body.positions - MIDDLE) @ rotation.T + MIDDLE
    down = rotation[:, 1] if source is not DownSource.ASSUMED else np.array([0.0, 1.0, 0.0])
    skeleton = replace(body, positions=places.astype(np.float32))
    return replace(processed(), skeleton=skeleton, down=down, down_source=source)


def moved(**by: tuple[float, float, float]) -> Skeleton:
    positions = PLAYER.positions.copy()
    for name, way in by.items():
        positions[JOINTS.index(name)] += np.float32(way)
    return replace(PLAYER, positions=positions)


class Sitting:
    """A session whose pipeline gives the results that the test wants."""

    def __init__(self, game: str) -> None:
        self.session = LiveSession("left_leg", game=game)
        self._numbers = itertools.count()

    def show(self, shown: PhantomFrame) -> dict[str, Any]:
        self.session._pipeline = SimpleNamespace(process=lambda frame: shown)  # type: ignore[assignment]
        number = next(self._numbers)
        frame = replace(capsule_body.painted(0), time_ns=1 + number * 10**9 // RATE, number=number)
        message = self.session.process(frame, captured_ns=1)
        assert message is not None
        return dict(read_frame(message).status)


@functools.cache
def stomped(tilt: float, roll: float, source: DownSource = DownSource.FLOOR) -> tuple[int, int]:
    """Score and misses of a player who stomps on the key that is up, for 15 seconds.

    A foot is 14 cm high and 15 cm ahead before it comes down.
    """
    sitting, up = Sitting("piano"), -1
    sitting.session.command("ready")
    field = getattr(begin("piano", PLAYER), "field", None)
    keys = keys_of(field)  # type: ignore[arg-type]
    game: dict[str, Any] = {}
    for number in range(15 * RATE):
        lift, ahead = np.array([-0.14, -0.15]) * (number % RATE < RATE // 2)
        body = PLAYER
        if up >= 0:
            side, place = keys[up]
            foot = f"Foot{side.title()}"
            aside = float(place[0] - PLAYER.positions[JOINTS.index(foot)][0])
            body = moved(**{foot: (aside, lift, ahead)})
        game = sitting.show(seen(body, tilt, roll, source))["game"]
        up = game["up"]
    return game["score"], game["misses"]


@pytest.mark.parametrize(("tilt", "roll"), [(20, 0), (30, 0), (-30, 0), (0, 20), (0, -20)])
def test_a_tilted_camera_hears_all_notes_of_the_piano(tilt: float, roll: float) -> None:
    """Heights were along the columns: 30 degrees down or rolled by 20, no note counted."""
    assert stomped(tilt, roll) == stomped(0, 0)
    assert stomped(0, 0)[0] >= 10


@pytest.mark.parametrize(("tilt", "roll"), [(30, 0), (0, 20)])
def test_along_the_columns_of_the_image_half_of_the_notes_are_lost(
    tilt: float, roll: float
) -> None:
    assert stomped(tilt, roll, DownSource.ASSUMED)[0] < 0.6 * stomped(0, 0)[0]


@pytest.mark.parametrize(("tilt", "roll"), TILTS)
def test_keys_lie_on_the_floor_under_the_feet(tilt: float, roll: float) -> None:
    sitting = Sitting("piano")
    sitting.session.command("ready")
    status = sitting.show(seen(PLAYER, tilt, roll))
    keys, joints = np.array(status["game"]["keys"]), np.array(status["joints"])
    # The page draws level keys on a level floor, along y.
    assert np.ptp(keys[:, 1]) < 1e-3
    assert keys[0, 1] == pytest.approx(joints[FEET, 1].max(), abs=0.01)
    assert np.ptp(joints[FEET, 1]) < 1e-3
    hips = [JOINTS.index(f"Hip{side}") for side in ("Left", "Right")]
    level = PLAYER.positions[FEET, 1].mean() - PLAYER.positions[hips, 1].mean()
    assert joints[FEET, 1].mean() - joints[hips, 1].mean() == pytest.approx(level, abs=1e-3)
    assert status["down"] == pytest.approx((about("z", roll) @ about("x", tilt))[:, 1], abs=1e-4)


@pytest.mark.parametrize("game", ["bubbles-legs", "pedal"])
def test_bubbles_and_balls_rise_along_the_vertical(game: str) -> None:
    def ways(tilt: float, roll: float) -> NDArray[np.float64]:
        """Places of the targets from the middle of the hips, in level axes."""
        sitting = Sitting(game)
        sitting.session.command("ready")
        status: dict[str, Any] = {}
        for _ in range(RATE):
            status = sitting.show(seen(PLAYER, tilt, roll))
        targets = np.array(status["game"]["targets"])[:, 1:]
        return np.asarray(targets - status["joints"][0])

    for tilt, roll in ((20.0, 0.0), (-30.0, 0.0), (0.0, 20.0)):
        np.testing.assert_allclose(ways(tilt, roll), ways(0.0, 0.0), atol=1e-3)


def test_a_camera_that_is_almost_level_changes_nothing() -> None:
    shown = seen(PLAYER, 0.9 * LEAST_DEG)
    level = Level()
    assert not level.follow(shown)
    assert level.frame(shown) is shown
    assert level.follow(seen(PLAYER, 1.1 * LEAST_DEG))
    assert not level.follow(seen(PLAYER, 1.9 * LEAST_DEG))


def test_a_posture_does_not_replace_a_floor() -> None:
    level = Level()
    assert level.follow(seen(PLAYER, 10, source=DownSource.POSTURE))
    assert level.follow(seen(PLAYER, 20))
    for source in (DownSource.POSTURE, DownSource.ASSUMED):
        assert not level.follow(seen(PLAYER, 12, source=source))
    assert level.down[2] == pytest.approx(np.sin(np.radians(20)))
    flat = Level()
    assert not flat.follow(seen(PLAYER, 0))  # a floor, and the camera is level
    assert not flat.follow(seen(PLAYER, 12, source=DownSource.POSTURE))


def test_the_vertical_stays_during_a_game() -> None:
    sitting = Sitting("piano")
    for _ in range(3):  # nothing has told the vertical yet
        status = sitting.show(seen(PLAYER, 20, source=DownSource.ASSUMED))
        assert status["down"] == [0.0, 1.0, 0.0]
    sitting.session.command("ready")
    status = sitting.show(seen(PLAYER, 20, source=DownSource.ASSUMED))
    assert status["game"]["phase"] == "playing"
    assert sitting.show(seen(PLAYER, 20))["down"] == [0.0, 1.0, 0.0]
    sitting.session.command("stop")
    sitting.show(seen(PLAYER, 20))
    assert sitting.show(seen(PLAYER, 20))["down"][2] == pytest.approx(
        np.sin(np.radians(20)), abs=1e-3
    )
    # Without evidence, as after the start of another recording, the last one is kept.
    assert sitting.show(seen(PLAYER, 20, source=DownSource.ASSUMED))["down"][2] > 0.3


def test_a_measured_body_is_levelled_for_the_game() -> None:
    """The body was measured before the vertical was known."""
    sitting = Sitting("piano")
    sitting.session.command("calibrate")
    for _ in range(3 * RATE):
        status = sitting.show(seen(PLAYER, 20, source=DownSource.ASSUMED))
    assert status["calibrated"] == 1.0
    sitting.session.command("ready")
    status = sitting.show(seen(PLAYER, 20))
    keys, joints = np.array(status["game"]["keys"]), np.array(status["joints"])
    assert keys[:, 1] == pytest.approx(joints[FEET, 1].max(), abs=0.01)
    np.testing.assert_allclose(keys[:, 2], joints[FEET, 2].mean(), atol=0.03)


def unmet(shown: PhantomFrame) -> dict[str, str]:
    level = Level()
    level.follow(shown)
    checks = placement_checks(
        replace(shown, visible=1.0),
        level.skeleton(shown.skeleton),
        CAMERA,
        people=1,
        is_chosen=False,
        rate=30.0,
    )
    return {check.name: check.advice for check in checks if not check.is_met}


def turned(degrees: float, tilt: float, roll: float) -> PhantomFrame:
    return seen(capsule_body.pose(turn_deg=degrees), tilt, roll)


@pytest.mark.parametrize(("tilt", "roll"), [(0, 0), (30, 0), (-30, 0), (0, 30), (20, 20)])
def test_turns_are_told_about_the_vertical(tilt: float, roll: float) -> None:
    told = "Turn to the camera: 28 degrees away now."
    assert unmet(turned(28.0, tilt, roll)).get("Facing the camera") == told
    assert "Facing the camera" not in unmet(turned(22.0, tilt, roll))


def test_the_distance_is_that_along_the_floor() -> None:
    """The line of sight of a camera overhead is longer."""
    # The point below the middle of the image, 3.8 m along a line of sight that is 30 degrees down.
    far = seen(PLAYER, 30)
    places = far.skeleton.positions + np.float32([0, 0, 3.8 - far.skeleton.positions[0][2]])
    far = replace(far, skeleton=replace(far.skeleton, positions=places))
    assert "Distance" not in unmet(far)
    level = replace(far, down=np.array([0.0, 1.0, 0.0]))
    assert "Come nearer: 3.8 m now" in unmet(level)["Distance"]


def test_checks_have_the_vertical_of_the_page() -> None:
    """A floor still tells it where a later frame has only a posture, or nothing."""
    sitting = Sitting("piano")
    body = capsule_body.pose(turn_deg=28.0)
    told = ["Facing the camera", False, "Turn to the camera: 28 degrees away now."]
    assert told in sitting.show(seen(body, 30))["checks"]
    tilted = seen(body, 30)
    for source, down in ((DownSource.ASSUMED, 0.0), (DownSource.POSTURE, -20.0)):
        other = replace(tilted, down=about("x", down)[:, 1], down_source=source)
        assert told in sitting.show(other)["checks"]


def test_films_show_targets_where_the_camera_sees_them() -> None:
    level, shown = Level(), seen(PLAYER, 20, 10)
    assert level.follow(shown)
    state = begin("bubbles-legs", level.frame(shown).skeleton)
    assert state is not None
    state = step(state, 0.0, lambda start, end, radius: np.full(len(start), -1, np.int8))
    places = np.array([target.place for target in state.targets])
    rotation = about("z", 10) @ about("x", 20)
    down = rotation[:, 1]
    np.testing.assert_allclose(places @ (0, 1, 0), level.in_camera(places) @ down, atol=1e-9)
    in_camera = [
        replace(target, place=tuple(place))
        for target, place in zip(state.targets, level.in_camera(places).tolist(), strict=True)
    ]
    wanted = picture(shown, replace(state, targets=tuple(in_camera)), CAMERA, Level())
    np.testing.assert_array_equal(picture(shown, state, CAMERA, level), wanted)
    assert (picture(shown, state, CAMERA, Level()) != wanted).any()
