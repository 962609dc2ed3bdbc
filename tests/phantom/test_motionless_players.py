"""A player who does not move makes no point, and one who does can burst every bubble."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from manip3d import capture
from manip3d.modify import PhantomState
from manip3d.phantom import LiveSession
from manip3d.phantom._ends import Rest
from manip3d.phantom._play import Play
from manip3d.phantom.games import GAMES, ArmField, begin
from manip3d.rgbd import JOINTS, Skeleton

RATE = 30
SCALES = (0.6, 0.75, 1.0, 1.25)
JITTER_M, CORRELATION = 0.006, 0.6  # of a Kinect V2
LEGS = [name for name, game in GAMES.items() if game.limbs == "legs"]
PARTS = {"legs": ("Knee", ("Ankle", "Foot")),
         "arms": ("Shoulder", ("Elbow", "Wrist", "Hand", "HandTip", "Thumb"))}  # fmt: skip


@functools.cache
def still(**options: Any) -> Skeleton:
    """The simulated person."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate import BodySimulator

    simulator = BodySimulator(motion="still", color="none", threads=1, **options)
    return simulator.frame(0.0).skeletons[0]


def turned(body: Skeleton, limbs: str, degrees: float) -> Skeleton:
    """Shanks turned forwards at the knees, or arms raised sideways at the shoulders."""
    positions = body.positions.copy()
    root, parts = PARTS[limbs]
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        angle = math.radians(degrees)
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[1, 0, 0], [0, c, s], [0, -s, c]])  # from down (y) to ahead (-z)
        if limbs == "arms":
            turn = np.array([[c, sign * s, 0], [-sign * s, c, 0], [0, 0, 1]])
        start = positions[JOINTS.index(root + side)].copy()
        for part in parts:
            joint = JOINTS.index(part + side)
            positions[joint] = start + turn @ (positions[joint] - start)
    return replace(body, positions=positions)


def scaled(body: Skeleton, scale: float) -> Skeleton:
    return replace(body, positions=body.positions * np.float32(scale))


@functools.cache
def noise(jitter: float = JITTER_M, correlation: float = CORRELATION) -> NDArray[np.float32]:
    """Two seconds of a tracker's noise, (60, 25, 3), metres."""
    white = np.random.default_rng(5).normal(0.0, jitter, (2 * RATE, 25, 3))
    for number in range(1, len(white)):
        white[number] *= math.sqrt(1.0 - correlation**2)
        white[number] += correlation * white[number - 1]
    return white.astype(np.float32)


class Player:
    """Shows a session's game the skeletons of a patient without a right arm or leg."""

    def __init__(
        self, game: str, difficulty: int, *, measured: Skeleton | None = None, **noisy: float
    ) -> None:
        self.measured, self.noise = measured, noise(**noisy)
        self.play = Play((game, difficulty), 1, f"right_{GAMES[game].limbs[:-1]}", 1.0, None)
        self.number = 0

    def show(self, body: Skeleton, frames: int = 1) -> None:
        for _ in range(frames):
            self.number += 1
            seen = replace(body, positions=body.positions + self.noise[self.number % (2 * RATE)])
            shown: Any = SimpleNamespace(skeleton=seen, state=PhantomState.TRACKING)
            self.play.go_on(shown, 1 / RATE, round(self.number * 1e9 / RATE), self.measured)

    def begin(self, body: Skeleton) -> None:
        self.show(body, RATE)
        self.play.want()
        self.show(body)

    def swing(self, body: Skeleton, limbs: str, low: float, high: float, seconds: int) -> None:
        """Raise the limbs from one angle to another and lower them, once in two seconds."""
        for number in range(seconds * RATE):
            share = 0.5 - 0.5 * math.cos(math.pi * number / RATE)
            self.show(turned(body, limbs, low + share * (high - low)))


def points_of_a_motionless(body: Skeleton, game: str, difficulty: int) -> Mapping[int, int]:
    """Return the numbers of points by bone."""
    player = Player(game, difficulty)
    player.begin(body)
    assert player.play.is_playing, player.play.advice
    player.show(body, 40 * RATE)
    state = player.play.game
    assert state is not None
    assert state.game.rules == "pedal" or state.misses > 4
    return state.by_bone


@pytest.mark.parametrize(("degrees", "difficulty"), [(0.0, 1), (6.0, 2), (15.0, 3)])
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("game", LEGS)
def test_feet_that_rest_score_nothing(
    game: str, scale: float, degrees: float, difficulty: int
) -> None:
    body = scaled(turned(still(sitting=True), "legs", degrees), scale)
    assert points_of_a_motionless(body, game, difficulty) == {}


@pytest.mark.parametrize("girth", [1.0, 1.5])
@pytest.mark.parametrize("scale", SCALES)
def test_hands_that_rest_score_nothing(scale: float, girth: float) -> None:
    for sitting, difficulty in ((False, 1), (True, 2), (False, 3)):
        body = scaled(still(sitting=sitting, girth=girth), scale)
        assert points_of_a_motionless(body, "bubbles", difficulty) == {}


@pytest.mark.parametrize("rest", [0.0, 15.0])
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize(("game", "raised"), [("bubbles", 110.0), ("bubbles-legs", 75.0)])
def test_limbs_that_move_burst_the_bubbles(
    game: str, raised: float, scale: float, rest: float
) -> None:
    """Arms swing past the shoulders and shanks nearly to the horizontal, once in two seconds."""
    limbs = GAMES[game].limbs
    body = still(sitting=limbs == "legs")
    for difficulty in (1, 3):
        player = Player(game, difficulty)
        player.begin(scaled(turned(body, limbs, rest), scale))
        burst = set[tuple[float, float]]()
        for number in range(40 * RATE):
            share = 0.5 - 0.5 * math.cos(math.pi * number / RATE)
            player.show(scaled(turned(body, limbs, rest + share * (raised - rest)), scale))
            state = player.play.game
            assert state is not None
            burst |= {(e.place[0], e.place[2]) for e in state.events if e.kind == "burst"}
        assert burst == {(x, z) for x, _, z in (*state.field.lefts, *state.field.rights)}
        assert state.score > 0.6 * (state.score + state.misses)


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize(
    ("game", "in_the_way", "free", "advice"),
    [("bubbles", 75.0, 0.0, "Let your arms hang"), ("bubbles-legs", 40.0, 5.0, "Put your feet")],
)
def test_limbs_that_rest_too_far_out_are_asked_back(
    game: str, in_the_way: float, free: float, advice: str, scale: float
) -> None:
    limbs = GAMES[game].limbs
    body = still(sitting=limbs == "legs")
    player = Player(game, 1)
    player.begin(scaled(turned(body, limbs, in_the_way), scale))
    assert player.play.advice.startswith(advice)
    assert not player.play.is_playing
    player.show(scaled(turned(body, limbs, free), scale), RATE)
    assert (player.play.is_playing, player.play.advice) == (True, "")


@pytest.mark.parametrize("scale", [0.6, 1.25])
@pytest.mark.parametrize(
    ("game", "rest", "raised"), [("bubbles", 75.0, 110.0), ("bubbles-legs", 40.0, 75.0)]
)
def test_limbs_that_can_only_rest_far_out_can_play(
    game: str, rest: float, raised: float, scale: float
) -> None:
    """A stiff knee, a splint, or foot rests that are far ahead of the chair."""
    limbs = GAMES[game].limbs
    body = scaled(still(sitting=limbs == "legs"), scale)
    player = Player(game, 1)
    player.begin(turned(body, limbs, rest))
    player.show(turned(body, limbs, rest), 14 * RATE)
    assert not player.play.is_playing
    player.show(turned(body, limbs, rest), 15 * RATE)
    idle = player.play.game
    assert idle is not None
    assert (idle.score, idle.misses > 4) == (0, True)
    player.swing(body, limbs, rest, raised, 10)
    state = player.play.game
    assert state is not None
    assert state.score > state.misses - idle.misses


def test_feet_that_move_need_not_go_where_the_measured_ones_were_in_the_way() -> None:
    body = still(sitting=True)
    ahead = turned(body, "legs", 40.0)
    player = Player("bubbles-legs", 1, measured=ahead)
    player.begin(ahead)
    player.show(ahead, RATE)
    assert not player.play.is_playing
    player.swing(body, "legs", 40.0, 75.0, 1)
    assert player.play.is_playing


NOISES = list(itertools.product((0.02, 0.03), (0.0, CORRELATION)))


@pytest.mark.parametrize(("jitter", "correlation"), NOISES)
def test_a_noisy_tracker_does_not_play_for_a_child(jitter: float, correlation: float) -> None:
    """Places that lie beyond the margin of 4 cm in single frames still burst a few bubbles."""
    player = Player("bubbles-legs", 1, jitter=jitter, correlation=correlation)
    body = scaled(still(sitting=True), 0.6)
    player.begin(body)
    player.show(body, 20 * RATE)
    state = player.play.game
    assert state is not None
    assert state.misses > 4
    assert state.score < 0.5 * state.misses


@pytest.mark.parametrize("limbs", ["arms", "legs"])
@pytest.mark.parametrize(("jitter", "correlation"), NOISES)
def test_noise_is_no_movement(jitter: float, correlation: float, limbs: Any) -> None:
    body, rest = still(sitting=True), Rest()
    is_known = []
    for number, off in enumerate(noise(jitter, correlation)):
        rest.add(replace(body, positions=body.positions + off), round(number * 1e9 / RATE))
        is_known.append(rest.skeleton(limbs) is not None)
    assert np.mean(is_known[RATE:]) > 0.9


@pytest.mark.parametrize(("period", "share"), [(1.0, 0.95), (2.0, 0.95), (4.0, 0.8)])
@pytest.mark.parametrize(("limbs", "raised"), [("arms", 110.0), ("legs", 75.0)])
def test_swings_are_movements(limbs: Any, raised: float, period: float, share: float) -> None:
    body, rest = still(sitting=limbs == "legs"), Rest()
    is_known = []
    for number in range(5 * RATE):
        angle = raised * (0.5 - 0.5 * math.cos(2.0 * math.pi * number / RATE / period))
        seen = turned(body, limbs, angle)
        seen = replace(seen, positions=seen.positions + noise()[number % (2 * RATE)])
        rest.add(seen, round(number * 1e9 / RATE))
        is_known.append(rest.skeleton(limbs) is not None)
    assert np.mean(is_known[RATE:]) < 1.0 - share


def test_bubbles_of_a_child_are_smaller() -> None:
    for game in ("bubbles", "bubbles-legs"):
        adult, child = (begin(game, scaled(still(sitting=True), scale)) for scale in (1.25, 0.6))
        assert adult is not None
        assert child is not None
        assert adult.radius == GAMES[game].radius
        assert 0.5 * adult.radius < child.radius < 0.65 * adult.radius
        for state in (adult, child):
            assert isinstance(state.field, ArmField)
            assert state.field.end_radius == pytest.approx(5 / 9 * state.radius)


def test_the_page_draws_the_bubbles_of_the_game() -> None:
    player = Player("bubbles-legs", 1)
    player.begin(scaled(still(sitting=True), 0.6))
    assert player.play.game is not None
    shown = player.play.shown(0, playing=True)
    assert shown["radius"] == player.play.game.radius < GAMES["bubbles-legs"].radius


def test_hands_that_move_when_the_game_begins_move_no_line() -> None:
    """A hand on its way is at no place of rest."""
    body = still(sitting=False)
    player = Player("bubbles", 1)
    for number in range(2 * RATE):
        if number == RATE:
            player.play.want()
        player.show(turned(body, "arms", 90.0 * number / RATE))
    assert player.play.game is not None
    field, plain = player.play.game.field, begin("bubbles", body)
    assert plain is not None
    for lines, wanted in ((field.lefts, plain.field.lefts), (field.rights, plain.field.rights)):
        assert lines[0][0] == pytest.approx(wanted[0][0], abs=0.03)


def test_a_small_patient_who_sits_still_scores_nothing_in_a_session() -> None:
    """From the depth image to the score; two of three points were those of the phantom foot."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    address = "sim:body?motion=still&sitting=yes&amputated=right-leg&frames=15&color=none"
    frames = [
        replace(
            frame,
            depth=np.rint(0.75 * frame.depth).astype(np.uint16),
            skeletons=tuple(scaled(body, 0.75) for body in frame.skeletons),
        )
        for frame in capture.open_rgbd(address)
    ]
    session = LiveSession("right_leg", game="bubbles-legs", seed=1)
    for number in range(15 * RATE):
        if number == RATE:
            session.command("ready")
        session.process(replace(frames[number % len(frames)], time_ns=round(number * 1e9 / RATE)))
    game = session._play.game
    assert game is not None
    assert game.misses > 4
    assert (game.score, game.by_bone) == (0, {})
