"""The rules of games, by hand-made touches: nothing is drawn and no clock is asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from begun_games import PLAYER, no_touch, started
from numpy.typing import NDArray

from manip3d import InputError
from manip3d.modify import ColliderTracker
from manip3d.phantom._ends import ends_of
from manip3d.phantom.games import (
    GAMES,
    ArmField,
    GameState,
    Touch,
    begin,
    bones_of,
    can_reach,
    step,
)
from manip3d.rgbd import JOINTS, Skeleton


def hand(place: tuple[float, float, float], bone: int) -> Touch:
    """A point that stands still."""

    def touch(
        start: NDArray[np.float32], end: NDArray[np.float32], radius: NDArray[np.float32]
    ) -> NDArray[np.int8]:
        # The nearest point of the way from start to end.
        way = end - start
        length = np.maximum((way * way).sum(axis=1), 1e-12)
        share = np.clip(((np.float32(place) - start) * way).sum(axis=1) / length, 0, 1)
        off = start + share[:, None] * way - np.float32(place)
        near = (off * off).sum(axis=1) <= radius * radius
        return np.where(near, bone, -1).astype(np.int8)

    return touch


def played(state: GameState, seconds: float, touch: Touch = no_touch, rate: int = 32) -> GameState:
    for _ in range(round(seconds * rate)):
        state = step(state, 1 / rate, touch)
    return state


def test_hands_and_feet_by_their_joints() -> None:
    names = {s: [JOINTS[j] for j in bones_of("arms", s)] for s in ("left", "right")}
    assert names["left"] == ["WristLeft", "HandLeft", "HandTipLeft", "ThumbLeft"]
    assert names["right"] == ["WristRight", "HandRight", "HandTipRight", "ThumbRight"]
    assert [JOINTS[j] for j in bones_of("legs", "left")] == ["AnkleLeft", "FootLeft"]


@pytest.mark.parametrize("name", [name for name in GAMES if GAMES[name].rules == "bubbles"])
@pytest.mark.parametrize("difficulty", [1, 2, 3])
def test_generators_are_symmetric_pairs(name: str, difficulty: int) -> None:
    field = started(name, difficulty=difficulty).field
    assert len(field.lefts) == len(field.rights) == len(GAMES[name].reaches[difficulty - 1])
    arms = ("ShoulderLeft", "ShoulderRight")
    roots = arms if GAMES[name].limbs == "arms" else ("KneeLeft", "KneeRight")
    left, right = (PLAYER.positions[JOINTS.index(root)] for root in roots)
    for a, b in zip(field.lefts, field.rights, strict=True):
        off_left, off_right = a[0] - left[0], b[0] - right[0]
        # Outwards for arms; for legs both ahead, wherever the hips face.
        outwards = -1.0 if GAMES[name].limbs == "arms" else 1.0
        assert off_left == pytest.approx(outwards * off_right, abs=1e-6)
        assert a[1] == b[1]
    assert isinstance(field, ArmField)
    assert field.rise > 0.1


def test_bubbles_come_in_pairs_at_the_intervals_and_rise_in_straight_lines() -> None:
    state = step(started(), 0.0, no_touch)
    assert [(t.number, t.side) for t in state.targets] == [(0, "left"), (1, "right")]
    assert [t.place for t in state.targets] == [state.field.lefts[0], state.field.rights[0]]
    later = played(state, 2.0)
    for before, after in zip(state.targets, later.targets, strict=True):
        assert after.place[0] == before.place[0]
        assert after.place[2] == before.place[2]
        assert after.place[1] == pytest.approx(before.place[1] - 2.0 * 0.25)
    assert played(state, 2.4688).spawned == 1
    assert played(state, 2.5).spawned == 2
    assert [t.number for t in played(state, 2.5).targets] == [0, 1, 2, 3]


def test_a_missed_bubble_stains_the_ceiling_and_counts() -> None:
    state = step(started(), 0.0, no_touch)
    field = state.field
    assert isinstance(field, ArmField)
    seconds = field.rise / 0.25
    before = played(state, seconds - 0.1)
    assert (before.misses, before.stains) == (0, ())
    after = played(state, seconds + 0.1)
    assert (after.misses, after.score) == (2, 0)
    assert after.stains == tuple(
        (x, pytest.approx(y - field.rise), z) for x, y, z in (field.lefts[0], field.rights[0])
    )


def test_a_hand_in_the_way_bursts_once_and_says_which_bone() -> None:
    state = step(started(), 0.0, no_touch)
    x, y, z = state.field.rights[0]
    touch = hand((x + 0.05, y - 0.3, z), 11)
    moments = []
    for number in range(64):
        state = step(state, 1 / 32, touch)
        moments += [(number, event) for event in state.events]
    assert len(moments) == 1
    number, event = moments[0]
    assert (event.kind, event.side, event.bone, event.number) == ("burst", "right", 11, 1)
    # The centre is within the radius when it is sqrt(0.09^2 - 0.05^2) = 0.0748 m below the hand.
    assert (number + 1) / 32 * 0.25 == pytest.approx(0.3 - 0.0748, abs=0.25 / 32)
    assert (state.score, state.misses, state.by_bone) == (1, 0, {11: 1})
    assert [t.side for t in state.targets] == ["left"]


def test_fast_bubbles_are_not_missed_between_frames() -> None:
    state = step(started(difficulty=3), 0.0, no_touch)
    place = state.targets[0].place
    touch = hand((place[0], place[1] - 0.3, place[2]), 7)
    assert step(state, 1.0, touch).score == 1  # 0.6 m in one step


def test_the_time_limit_ends_the_game() -> None:
    over = played(replace(started(), clock=59.0), 2.0)
    assert (over.phase, over.ending, over.clock, over.targets) == ("over", "time", 60.0, ())
    assert played(over, 5.0) == replace(over, events=())


def test_too_many_misses_end_the_game() -> None:
    over = played(started(difficulty=3), 59.0)
    assert (over.phase, over.ending, over.misses) == ("over", "misses", 20)
    assert over.clock < 59.0


def test_a_clock_that_stands_still_punishes_nobody() -> None:
    """While the phantom limb is degraded the session calls nothing, or steps of no time."""
    state = played(started(), 3.0)
    paused = played(state, 0.0)
    for _ in range(1000):
        paused = step(paused, 0.0, no_touch)
    assert replace(paused, events=()) == replace(state, events=())


@pytest.mark.parametrize("name", [name for name in GAMES if GAMES[name].rules != "pedal"])
def test_the_same_seed_is_the_same_game_and_another_is_not(name: str) -> None:
    def places(seed: int, rate: int = 32) -> list[tuple[int, float]]:
        state, seen = started(name, difficulty=3, seed=seed), {}
        for _ in range(9 * rate):
            state = step(state, 1 / rate, no_touch)
            seen |= {t.number: t.place[0] for t in state.targets}
        return sorted(seen.items())

    assert places(4) == places(4) == places(4, rate=64)
    if len(GAMES[name].reaches[2]) > 1:
        assert places(4) != places(5)


def test_a_bubble_is_in_reach_only_near_the_shoulder() -> None:
    assert not can_reach(started())  # there is none yet
    state = step(started(), 0.0, no_touch)
    assert can_reach(state)
    assert isinstance(state.field, ArmField)
    # Half as long an arm reaches it only while it passes the shoulder.
    state = replace(state, field=replace(state.field, reach=0.75 * state.field.reach / 1.2))
    moments = []
    while state.spawned == 1:
        state = step(state, 1 / 32, no_touch)
        moments.append(can_reach(state))
    assert not moments[0]
    assert any(moments)
    assert not can_reach(replace(state, phase="over"))


def test_without_shoulders_there_is_no_field() -> None:
    states = PLAYER.states.copy()
    states[JOINTS.index("ShoulderLeft")] = 0
    assert begin("bubbles", Skeleton(PLAYER.positions, states=states)) is None
    assert begin("bubbles-legs", Skeleton(PLAYER.positions, states=states)) is not None
    zero = Skeleton(np.zeros((25, 3), np.float32))
    assert begin("bubbles", zero) is None
    assert begin("bubbles-legs", zero) is None


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("chess", {}, "name: expected one of bubbles"),
        ("bubbles", {"difficulty": 0}, "difficulty: expected 1 to 3, got 0"),
        ("bubbles", {"difficulty": 4}, "difficulty: expected 1 to 3, got 4"),
        ("bubbles", {"seed": -1}, "seed: expected >= 0, got -1"),
    ],
)
def test_bad_choices(name: str, options: dict[str, int], message: str) -> None:
    with pytest.raises(InputError, match=message):
        begin(name, PLAYER, **options)


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf")])
def test_bad_times(seconds: float) -> None:
    with pytest.raises(InputError, match="seconds: expected >= 0"):
        step(started(), seconds, no_touch)


@pytest.mark.parametrize(("game", "touching"), [("bubbles", (6, 10)), ("bubbles-legs", (14, 18))])
def test_without_hands_and_feet_the_end_of_the_forearm_or_shank_touches(
    game: str, touching: tuple[int, int]
) -> None:
    body = PLAYER
    states = body.states.copy()
    states[[JOINTS.index(f"{n}{s}") for n in ("Hand", "HandTip", "Thumb", "Foot") for s in
            ("Left", "Right")]] = 0  # fmt: skip
    seen = Skeleton(body.positions, body.orientations, states, body.id, body.body)
    state = begin(game, seen)
    assert state is not None
    colliders = ColliderTracker()
    for _ in range(2):
        colliders.update(ends_of(seen, state.game.limbs))
    ends = seen.positions[list(touching)]
    inner = seen.positions[[joint - 1 for joint in touching]]
    radii = np.full(2, 0.03, np.float32)
    assert tuple(colliders.hits(ends, ends, radius=radii).bone.tolist()) == touching
    assert tuple(colliders.hits(inner, inner, radius=radii).bone.tolist()) == (
        -1,
        -1,
    )  # elbow or knee
