"""Pedal and Piano by feet that go where the test says; and times without a point."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from begun_games import PLAYER, no_touch, started

from manip3d import InputError, Skeleton, datasets
from manip3d.modify import JointSmoother, PhantomState
from manip3d.phantom import LiveSession
from manip3d.phantom._anomalies import ANOMALY_S, Anomaly, AnomalyWatch
from manip3d.phantom._pedal import advise_pedal
from manip3d.phantom._play import Play
from manip3d.phantom.games import (
    GAMES,
    GameState,
    PianoField,
    ankle_angle,
    begin,
    can_reach,
    keys_of,
    step,
)
from manip3d.rgbd import INFERRED, JOINTS, NOT_TRACKED, TRACKED
from real_data import RealData

RATE = 32
STEADY = [(0.0, 0.0)] * (5 * RATE)  # the noise of the feet is measured


def player(
    *,
    left: float = 0.0,
    right: float = 0.0,
    moved: dict[str, tuple[float, float, float]] | None = None,
) -> Skeleton:
    """Feet turned by degrees at the ankles, toes up; then joints moved by metres."""
    positions = PLAYER.positions.copy()
    for side, degrees in (("Left", left), ("Right", right)):
        ankle, foot = JOINTS.index(f"Ankle{side}"), JOINTS.index(f"Foot{side}")
        way = positions[foot] - positions[ankle]
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        # About the x axis; y is down and the toes point to -z.
        way = np.array([way[0], c * way[1] + s * way[2], -s * way[1] + c * way[2]], np.float32)
        positions[foot] = positions[ankle] + way
    for name, by in (moved or {}).items():
        positions[JOINTS.index(name)] += np.float32(by)
    return Skeleton(positions, states=PLAYER.states)


def moves(*held: tuple[float, float]) -> list[tuple[float, float]]:
    """Degrees of both feet per frame: a pose is reached in 0.25 s and held for 0.4 s."""
    angles, now = list[tuple[float, float]](), (0.0, 0.0)
    for goal in held:
        for number in range(1, 9):
            angles.append(
                (now[0] + (goal[0] - now[0]) * number / 8, now[1] + (goal[1] - now[1]) * number / 8)
            )
        angles += [goal] * 12
        now = goal
    return angles


def pedalled(state: GameState, degrees: list[tuple[float, float]]) -> tuple[GameState, list[str]]:
    events = []
    for left, right in degrees:
        state = step(state, 1 / RATE, no_touch, player(left=left, right=right))
        events += [f"{event.kind} {event.side}" for event in state.events]
    return state, events


# --- Pedal ----------------------------------------------------------------------------------------


def test_the_angle_at_the_ankle_is_smaller_with_toes_up() -> None:
    flat = ankle_angle(player(), "left")
    up = ankle_angle(player(left=20), "left")
    assert flat is not None
    assert up is not None
    assert flat - up == pytest.approx(20.0, abs=1.0)


def test_toes_up_and_down_is_one_stroke_and_lifts_that_ball() -> None:
    state, events = pedalled(started("pedal"), STEADY + moves((0, 8), (0, 16)))
    assert events == []
    half = state.targets[1].place[1]
    state, events = pedalled(state, moves((0, 16), (0, 8), (0, 0))[8:])
    assert events == ["stroke right"]
    left, right = state.targets
    field = state.field
    assert left.place == field.lefts[0]
    way = field.rights[0][1] - right.place[1]
    assert field.rights[0][1] - half == pytest.approx(way / 2)
    assert way == pytest.approx(1.6 / 8 * 0.402, rel=0.02)  # the shank's length
    assert (state.score, state.by_bone) == (1, {JOINTS.index("FootRight"): 1})


def test_shaking_counts_nothing() -> None:
    random = np.random.default_rng(0)
    shaking = [tuple(random.uniform(-5, 5, 2)) for _ in range(60 * RATE)]
    state, events = pedalled(started("pedal"), shaking)
    assert (events, state.score) == ([], 0)


def test_moving_the_whole_leg_counts_nothing() -> None:
    state = started("pedal")
    for number in range(10 * RATE):
        lift = -0.2 * abs(math.sin(number / 5))
        by = {f"{joint}Left": (0.0, lift, 0.5 * lift) for joint in ("Knee", "Ankle", "Foot")}
        state = step(state, 1 / RATE, no_touch, player(moved=by))
    assert state.score == 0


def test_both_balls_at_their_disks_end_the_game() -> None:
    state, events = pedalled(started("pedal"), STEADY + moves(*[(20, 0), (0, 0)] * 9))
    assert events == ["stroke left"] * 7 + ["stroke left", "arrived left"]
    assert (state.phase, state.score) == ("playing", 8)
    state, events = pedalled(state, moves(*[(0, 20), (0, 0)] * 9))
    assert events == ["stroke right"] * 7 + ["stroke right", "arrived right"]
    assert (state.phase, state.ending, state.score, state.misses) == ("over", "done", 16, 0)
    assert state.targets[0].place[1] == pytest.approx(state.field.lefts[0][1] - state.field.rise)  # type: ignore[union-attr]
    assert step(state, 1.0, no_touch, player()) == replace(state, events=())


@pytest.mark.parametrize(
    ("difficulty", "strokes", "degrees"), [(1, 8, 13), (2, 12, 16), (3, 16, 19)]
)
def test_a_harder_pedal_wants_more_and_larger_strokes(
    difficulty: int, strokes: int, degrees: float
) -> None:
    angles = STEADY + moves(*[(degrees, degrees), (0, 0)] * 20)
    state, _ = pedalled(started("pedal", difficulty=difficulty), angles)
    assert (state.ending, state.score) == ("done", 2 * strokes)
    angles = STEADY + moves(*[(degrees - 2, degrees - 2), (0, 0)] * 20)
    state, _ = pedalled(started("pedal", difficulty=difficulty), angles)
    assert state.score == 0


def test_a_foot_that_the_tracker_turns_between_two_frames_counts_nothing() -> None:
    """Ankles turn by less than 300 degrees a second."""
    flicker = [*STEADY, *([(0.0, 40.0)] * 16 + [(0.0, 0.0)] * 16) * 20]
    state, events = pedalled(started("pedal"), flicker)
    assert (events, state.feet[1].moves) == ([], 0)


@pytest.mark.parametrize("joint", ["KneeRight", "AnkleRight", "FootRight"])
def test_inferred_joints_move_no_pedal(joint: str) -> None:
    state = started("pedal")
    for degrees in STEADY + moves(*[(20, 20), (0, 0)] * 3):
        seen = player(left=degrees[0], right=degrees[1])
        states = seen.states.copy()
        states[JOINTS.index(joint)] = INFERRED
        state = step(state, 1 / RATE, no_touch, Skeleton(seen.positions, states=states))
    assert [foot.moves for foot in state.feet] == [6, 0]


def pedalled_unsteadily(share: float, degrees: float, gain: float = 1.0) -> GameState:
    """Both feet turn, and the right foot's length changes by a share."""
    random = np.random.default_rng(5)
    ankle, foot = JOINTS.index("AnkleRight"), JOINTS.index("FootRight")
    state = replace(started("pedal"), gain=gain)
    angles = STEADY * 2 + moves(*[(degrees, degrees), (0, 0)] * 8)
    noises = np.repeat(random.choice([-share, share], len(angles) // 8 + 1), 8)
    for noise, (left, right) in zip(noises, angles, strict=False):
        seen = player(left=left, right=right)
        seen.positions[foot] += np.float32(noise) * (seen.positions[foot] - seen.positions[ankle])
        state = step(state, 1 / RATE, no_touch, seen)
    return state


def test_a_foot_that_changes_its_length_needs_larger_moves() -> None:
    """The length of a bone is constant, so that its changes are the tracker's noise."""
    steady, unsteady, wild = (pedalled_unsteadily(share, 16) for share in (0.0, 0.08, 0.16))
    assert [foot.moves for foot in steady.feet] == [16, 16]
    assert advise_pedal(steady) == ""
    assert [foot.moves for foot in unsteady.feet] == [16, 0]
    told = "The camera sees your feet unsteadily, so that "
    assert advise_pedal(unsteady).startswith(f"{told}only movements of")
    assert advise_pedal(wild) == f"{told}their movements cannot be counted."


def test_enlarged_angles_have_enlarged_noise() -> None:
    assert pedalled_unsteadily(0.03, 16).feet[1].moves == 16
    assert pedalled_unsteadily(0.03, 16, gain=2.0).feet[1].moves == 0


@functools.cache
def simulated_feet(motion: str, tracker: str, rate: int, seconds: float) -> list[Skeleton]:
    """Smoothed joints of a seated person with the errors of a tracker, without images."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate import BodySimulator
    from manip3d.simulate.people import _bone_errors

    simulator = BodySimulator(motion=motion, sitting=True, tracker=tracker, rate=rate, seed=6)
    smoother, found = JointSmoother(), []
    figures = [simulator._cast(i / rate).figures[0] for i in range(4 * rate)]  # the period
    for number in range(round(seconds * rate)):
        figure = figures[number % len(figures)]
        places = figure.joints + simulator.bias * _bone_errors(figure, 0)
        if tracker:
            places = places + simulator.jitter * simulator._correlated(number / rate, 0)
        states = np.full(25, TRACKED, np.uint8)
        found.append(smoother.add(Skeleton(places.astype(np.float32), states=states)))
    return found


def pedalled_by(skeletons: list[Skeleton], rate: float) -> GameState:
    state = begin("pedal", skeletons[0])
    assert state is not None
    for skeleton in skeletons[1:]:
        state = step(state, 1 / rate, no_touch, skeleton)
    return state


@pytest.mark.parametrize("rate", [10, 15, 30, 60])
@pytest.mark.parametrize("tracker", ["", "kinect-v2"])
def test_three_simulated_dorsiflexions_are_three_strokes(tracker: str, rate: int) -> None:
    state = pedalled_by(simulated_feet("dorsiflexion", tracker, rate, 7.0), rate)
    assert [foot.moves // 2 for foot in state.feet] == [3, 3]


@pytest.mark.parametrize("rate", [10, 15, 30, 60])
@pytest.mark.parametrize("motion", ["still", "knee-extension"])
@pytest.mark.parametrize("tracker", ["", "kinect-v2"])
def test_simulated_feet_that_do_not_turn_count_nothing(
    tracker: str, motion: str, rate: int
) -> None:
    state = pedalled_by(simulated_feet(motion, tracker, rate, 12.0), rate)
    assert state.score == 0


def test_feet_that_shake_as_much_as_they_move_are_told() -> None:
    """The joints of the simulated Kinect V1 turn resting feet by more than 20 degrees."""
    state = pedalled_by(simulated_feet("still", "kinect-v1", 30, 20.0), 30)
    assert state.score == 0
    assert "only movements of" in advise_pedal(state)


@pytest.mark.realdata
@pytest.mark.parametrize(
    "name",
    [
        "Ges01_wavehand",
        "Ges02_balancinghands",
        "Ges03_drawlines",
        "Ges04_comehere",
        "Ges05_demopoint",
        "Ges06_chickenwing",
        "joints_close_range",
    ],
)
def test_people_who_move_their_arms_do_not_pedal(realdata: RealData, name: str) -> None:
    realdata.needs("skeletons_labanotation")
    smoother, state, before = JointSmoother(), None, 0
    for frame in datasets.open_people(f"labanotation:{name}"):
        skeleton = smoother.add(frame.skeletons[0])
        if state is None:
            state = begin("pedal", skeleton)
        else:
            state = step(state, (frame.time_ns - before) / 1e9, no_touch, skeleton)
        before = frame.time_ns
    assert state is not None
    assert state.clock > 5.0
    assert state.score == 0


def test_pedalling_ends_with_the_time() -> None:
    state = replace(started("pedal"), clock=119.9)
    state, _ = pedalled(state, [(0, 0)] * 10)
    assert (state.phase, state.ending) == ("over", "time")


@pytest.mark.realdata
@pytest.mark.parametrize("action", [1, 3, 4, 6, 9, 10])
def test_people_before_a_kinect_v1_who_move_their_arms_do_not_pedal(
    realdata: RealData, action: int
) -> None:
    realdata.needs("people_utd_mhad")
    session = LiveSession("left_leg", game="pedal")
    session.command("ready")
    for frame in datasets.open_people(f"utd-mhad:a{action}_s1"):
        session.process(frame)
    session.end()
    (summary,) = session.summaries
    assert summary.seconds > 1.0
    assert summary.score == 0


# --- Piano ----------------------------------------------------------------------------------------


def stomp(state: GameState, place: tuple[float, float, float]) -> GameState:
    """Lifts the foot of that side, brings it over a place and down."""
    assert isinstance(state.field, PianoField)
    side = "Left" if place in state.field.lefts else "Right"
    foot = PLAYER.positions[JOINTS.index(f"Foot{side}")]
    aside = float(place[0] - foot[0]), 0.0, float(place[2] - foot[2])
    floor = state.field.floor - float(foot[1])
    for height in (0.0, 0.15, 0.15, 0.02):
        by = (aside[0], floor - height, aside[2]) if height != 0.0 else (0.0, 0.0, 0.0)
        state = step(state, 1 / RATE, no_touch, player(moved={f"Foot{side}": by}))
        if state.events:
            return state
    return state


def test_keys_lie_from_left_to_right_and_one_is_up() -> None:
    state = step(started("piano", difficulty=3), 0.0, no_touch, player())
    assert isinstance(state.field, PianoField)
    keys = keys_of(state.field)
    assert len(keys) == 6
    xs = [place[0] for _, place in keys]
    assert xs == sorted(xs) or xs == sorted(xs, reverse=True)
    assert [side for side, _ in keys] == ["left"] * 3 + ["right"] * 3
    (key,) = state.targets
    assert key.place == keys[key.key][1]


def test_stomping_on_the_key_plays_its_note() -> None:
    state = step(started("piano"), 0.0, no_touch, player())
    key = state.targets[0]
    state = stomp(state, key.place)
    (event,) = state.events
    assert (event.kind, event.key, event.side) == ("note", key.key, key.side)
    assert event.bone == JOINTS.index(f"Foot{key.side.title()}")
    assert (state.score, state.misses, state.targets) == (1, 0, ())


@pytest.mark.parametrize(("size", "radius"), [(1.0, 0.11), (1.2, 0.11), (0.62, 0.0693)])
def test_a_foot_on_the_key_beside_it_plays_nothing_whatever_the_size_of_the_player(
    size: float, radius: float
) -> None:
    body = Skeleton(PLAYER.positions * np.float32(size), states=PLAYER.states)
    state = begin("piano", body, difficulty=3)
    assert state is not None
    state = step(state, 0.0, no_touch, body)
    assert isinstance(state.field, PianoField)
    assert state.radius == pytest.approx(radius, abs=1e-4)
    (key,) = state.targets
    others = [place for side, place in keys_of(state.field) if side == key.side]
    others.remove(key.place)
    nearest = min(others, key=lambda place: abs(place[0] - key.place[0]))
    notes = []
    for place in (nearest, key.place):
        for height in (0.15, 0.02):
            positions = body.positions.copy()
            foot = place[0], state.field.floor - height, place[2]
            positions[JOINTS.index(f"Foot{key.side.title()}")] = foot
            state = step(state, 1 / RATE, no_touch, Skeleton(positions, states=body.states))
        notes.append([event.kind for event in state.events])
    assert notes == [[], ["note"]]


def test_a_foot_that_rests_on_the_key_plays_nothing() -> None:
    state = step(started("piano"), 0.0, no_touch, player())
    for _ in range(5 * RATE):
        state = step(state, 1 / RATE, no_touch, player())
    assert state.score == 0


def test_stomping_beside_the_key_plays_nothing_and_wants_a_new_lift() -> None:
    state = step(started("piano", difficulty=3), 0.0, no_touch, player())
    key = state.targets[0]
    x = key.place[0]
    sign = 1.0 if key.place in state.field.lefts else -1.0
    foot = f"Foot{key.side.title()}"
    start = PLAYER.positions[JOINTS.index(foot)]
    off = float(x - start[0]) + 0.2 * sign
    for by in ((off, -0.2, 0.0), (off, 0.0, 0.0), (off - 0.2 * sign, 0.0, 0.0)):
        state = step(state, 1 / RATE, no_touch, player(moved={foot: by}))
    assert state.score == 0


@pytest.mark.parametrize("name", ["pedal", "piano"])
def test_a_foot_that_came_down_in_a_pause_counts_nothing(name: str) -> None:
    play, time_s = Play((name, 1), 0, "left_leg", 1.0, None), 0.0

    def frames(count: int, up: float, state: PhantomState = PhantomState.TRACKING) -> None:
        nonlocal time_s
        moved = {f"Foot{side}": (0.0, -up, 0.0) for side in ("Left", "Right")}
        skeleton = player(left=100 * up, right=100 * up, moved=moved if name == "piano" else None)
        shown: Any = SimpleNamespace(skeleton=skeleton, state=state)
        for _ in range(count):
            time_s += 1 / RATE
            play.go_on(shown, 1 / RATE, round(time_s * 1e9), None)

    def lift(ups: list[float]) -> None:
        for up in ups:
            frames(1, up)

    way = np.linspace(0.0, 0.2, 8).tolist()
    play.want()
    frames(5 * RATE, 0.0)
    lift(way + [0.2] * 16)
    assert play.game is not None
    assert [foot.is_up for foot in play.game.feet] == [True, True]
    frames(RATE, 0.0, PhantomState.LOST)
    frames(RATE, 0.0)
    assert (play.game.score, play.game.phase) == (0, "playing")
    lift(way + [0.2] * 16 + way[::-1] + [0.0] * 16)
    assert play.game.score > 0


@pytest.mark.parametrize("state_of_foot", [NOT_TRACKED, INFERRED])
def test_a_foot_that_came_down_unseen_plays_nothing(state_of_foot: int) -> None:
    state = step(started("piano"), 0.0, no_touch, player())
    key = state.targets[0]
    foot = JOINTS.index(f"Foot{key.side.title()}")
    aside = float(key.place[0] - PLAYER.positions[foot][0])
    lifted = player(moved={JOINTS[foot]: (aside, -0.2, 0.0)})
    stands = player(moved={JOINTS[foot]: (aside, 0.0, 0.0)})
    for _ in range(10):
        state = step(state, 1 / RATE, no_touch, lifted)
    states = stands.states.copy()
    states[foot] = state_of_foot
    for _ in range(RATE):
        state = step(state, 1 / RATE, no_touch, Skeleton(stands.positions, states=states))
        assert state.score == 0
    state = step(state, 1 / RATE, no_touch, stands)
    assert (state.score, state.targets[0].number) == (0, key.number)
    for seen in (lifted, stands):
        state = step(state, 1 / RATE, no_touch, seen)
    assert state.score == 1


def test_a_missed_key_leaves_the_score_and_never_ends_the_game() -> None:
    state = step(started("piano", difficulty=3), 0.0, no_touch, player())
    missed = 0
    for _ in range(59 * RATE):
        state = step(state, 1 / RATE, no_touch, player())
        missed += sum(event.kind == "missed" for event in state.events)
    assert state.phase == "playing"
    assert missed == state.misses > 15
    assert state.score == 0
    state = step(state, 2.0, no_touch, player())
    assert (state.phase, state.ending) == ("over", "time")


def test_the_floor_may_be_known_from_before() -> None:
    lifted = player(moved={"FootLeft": (0, -0.2, 0), "FootRight": (0, -0.2, 0)})
    floor = float(PLAYER.positions[JOINTS.index("FootLeft")][1])
    state = begin("piano", lifted, floor=floor)
    assert state is not None
    assert isinstance(state.field, PianoField)
    assert state.field.floor == floor
    with pytest.raises(InputError, match="floor: expected a finite number"):
        begin("piano", lifted, floor=math.nan)


def stomped_by(lifts: list[float], ready_at: int = 0) -> GameState:
    """A session of piano in which both feet are lifted by metres, then stand on the next key."""
    play = Play(("piano", 1), 0, "left_leg", 1.0, None)
    for number, lift in enumerate(lifts):
        if number == ready_at:
            play.want()
        aside = 0.0
        if play.game is not None and play.game.targets:
            key = play.game.targets[0]
            foot = PLAYER.positions[JOINTS.index(f"Foot{key.side.title()}")]
            aside = float(key.place[0] - foot[0])
        moved = {f"Foot{side}": (aside, -lift, 0.0) for side in ("Left", "Right")}
        shown: Any = SimpleNamespace(skeleton=player(moved=moved), state=PhantomState.TRACKING)
        play.go_on(shown, 1 / RATE, round(number / RATE * 1e9), None)
    assert play.game is not None
    return play.game


STOMPS = [0.14 * abs(math.sin(math.pi * number / RATE)) ** 0.5 for number in range(RATE)]
STOMPS = (STOMPS + [0.0] * (RATE // 2)) * 20


@pytest.mark.parametrize(
    ("before", "ready_at"),
    [([], 0), ([0.0] * 64, 64), ([0.14] * 5, 0), ([0.14] * 64, 5), ([0.14] * 64, 64)],
)
def test_the_score_of_a_piano_is_the_same_wherever_the_feet_were_before(
    before: list[float], ready_at: int
) -> None:
    """The floor comes down to the feet, and the keys with it."""
    game = stomped_by(before + STOMPS, ready_at)
    assert isinstance(game.field, PianoField)
    floor = float(PLAYER.positions[JOINTS.index("FootLeft")][1])
    assert game.field.floor == pytest.approx(floor, abs=0.015)
    assert {place[1] for _, place in keys_of(game.field)} == {game.field.floor}
    usual = stomped_by(STOMPS)
    assert usual.score >= 10
    assert abs(game.score - usual.score) <= 2


def test_feet_that_are_seen_too_low_for_a_moment_do_not_move_the_floor() -> None:
    low = [0.0] * 60 + [-0.3] * 3 + [0.0]
    assert abs(stomped_by(low + STOMPS, 63).score - stomped_by(STOMPS).score) <= 1


@pytest.mark.parametrize("tracker", ["kinect-v1", "kinect-v2"])
def test_noisy_feet_play_as_well_as_exact_ones(tracker: str) -> None:
    """The score does not depend on when the game begins either."""

    def score(tracker: str, ready_at: int) -> int:
        play = Play(("piano", 1), 0, "left_leg", 1.0, None)
        for number, skeleton in enumerate(simulated_feet("stepping", tracker, 15, 40.0)):
            if number == ready_at:
                play.want()
            shown: Any = SimpleNamespace(skeleton=skeleton, state=PhantomState.TRACKING)
            play.go_on(shown, 1 / 15, round(number / 15 * 1e9), None)
        assert play.game is not None
        return play.game.score

    exact = score("", 0)
    assert exact >= 5
    for ready_at in (3, 33):
        assert abs(score(tracker, ready_at) - exact) <= 2


@pytest.mark.parametrize("name", ["pedal", "piano"])
def test_untracked_feet_are_waited_for(name: str) -> None:
    states = PLAYER.states.copy()
    states[JOINTS.index("FootLeft")] = 0
    unseen = Skeleton(PLAYER.positions, states=states)
    assert begin(name, unseen) is None
    state = started(name)
    for _ in range(RATE):
        state = step(state, 1 / RATE, no_touch, unseen)
    assert state.score == 0
    assert begin(name, Skeleton(np.zeros((25, 3), np.float32))) is None


@pytest.mark.parametrize("name", ["pedal", "piano"])
def test_the_same_feet_and_seed_are_the_same_game(name: str) -> None:
    def play(seed: int) -> list[GameState]:
        random = np.random.default_rng(1)
        state, seen = started(name, seed=seed), []
        for _ in range(20 * RATE):
            a, b = random.uniform(0, 25, 2)
            lift = float(random.uniform(-0.3, 0.0))
            moved = {"FootLeft": (0.0, lift, 0.0), "FootRight": (0.0, lift, 0.0)}
            state = step(state, 1 / RATE, no_touch, player(left=a, right=b, moved=moved))
            seen.append(state)
        return seen

    assert play(3) == play(3)
    if name == "piano":
        assert play(3) != play(4)


# --- times without a point ------------------------------------------------------------------------


def watched(states: list[GameState]) -> list[Anomaly]:
    watch = AnomalyWatch()
    for state in states:
        watch.update(state)
    watch.finish()
    return watch.found


def test_ten_seconds_without_a_point_are_an_anomaly() -> None:
    state, states = step(started("pedal"), 0.0, no_touch, player()), []
    stroke, rest = moves((20, 0), (0, 0)), [(0.0, 0.0)]
    angles = (rest * (6 * RATE) + stroke + rest * (12 * RATE) + stroke + rest * (30 * RATE))[
        : 34 * RATE
    ]
    points = []
    for left, right in angles:
        state = step(state, 1 / RATE, no_touch, player(left=left, right=right))
        states.append(state)
        points += [state.clock for event in state.events if event.kind == "stroke"]
    assert can_reach(state)
    assert state.score == 2
    (first, second) = watched(states)
    assert (first.start, first.end) == pytest.approx(tuple(points), abs=0.1)
    assert (second.start, second.end) == pytest.approx((points[1], 34.0), abs=0.1)


def test_nothing_in_reach_is_nobodys_fault() -> None:
    piano = started("piano")
    piano = replace(piano, wait=30.0)
    states = []
    for _ in range(20 * RATE):
        piano = step(piano, 1 / RATE, no_touch, player())
        states.append(piano)
    assert not can_reach(piano)
    assert watched(states) == []


def test_just_under_the_limit_is_none() -> None:
    state, states = started("pedal"), []
    for _ in range(round((ANOMALY_S - 0.1) * RATE)):
        state = step(state, 1 / RATE, no_touch, player())
        states.append(state)
    assert watched(states) == []
    assert GAMES["pedal"].seconds > ANOMALY_S
