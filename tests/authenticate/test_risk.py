"""The risk factor, against the dissertation's figure 7.8 and a plain oracle."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import pytest

from manip3d.authenticate import (
    ATTACK_TYPES,
    AttackObservation,
    Risk,
    RiskParameters,
    RiskTracker,
    temporal_factor,
)
from manip3d.authenticate._risk import _level
from manip3d.errors import InputError


def attack(x: float = 8.0, y: float = 0.0, kind: str = "additive") -> AttackObservation:
    return AttackObservation(kind, (x, y), changed=40, cells=100)


@pytest.mark.published("figure 7.8")
@pytest.mark.parametrize(
    ("pattern", "expected"),
    [("11100", 0.36), ("00111", 0.60), ("10101", 0.60), ("11111", 1.0), ("10000", 0.04),
     ("00001", 0.2), ("01010", 0.32), ("11000", 0.16), ("00000", 0.0)],
)  # fmt: skip
def test_f_t_tells_apart_how_attacks_are_spread(pattern: str, expected: float) -> None:
    assert temporal_factor([c == "1" for c in pattern]) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("limit", ["low", "high"])
def test_the_last_bit_of_a_factor_does_not_decide_the_level(limit: str) -> None:
    """Cosines and exponentials of libm depend on the processor; their true value may be a limit."""
    p = RiskParameters()
    reached = {"low": "medium", "high": "high"}[limit]
    share = getattr(p, limit) ** 2
    for off in (math.nextafter(1.0, 0.0), 1.0, math.nextafter(1.0, 2.0)):
        assert _level((share, off), p) == reached
        assert _level((getattr(p, limit),) * 5 + (getattr(p, limit) * off,), p) == reached
    assert _level((share, 1.0 - 1e-9), p) != reached


def test_no_frames_are_refused_with_the_least_number_that_is_accepted() -> None:
    with pytest.raises(InputError, match=r"attacked: expected 1 or more frames, got 0"):
        temporal_factor([])


def test_the_tracker_computes_the_same_f_t_over_its_window() -> None:
    tracker = RiskTracker(RiskParameters(fps=1.0))  # X_n = 5 at 20 m/s
    for seen in "0000011100":
        risk = tracker.update(attack() if seen == "1" else None, speed_mps=20.0)
    assert risk.frames == 5
    assert risk.attacked_frames == 3
    assert risk.factors["time"] == pytest.approx(0.36)


def oracle(
    seen: Sequence[tuple[float, float] | None], count: int, speed: float, kind: str
) -> tuple[float, float]:
    """R_f and f_s by the printed formulas, for the last of the frames, standing still."""
    sigma, fraction = 2.0, 40 / 100
    last = [None] * (count + 1) + list(seen)
    last = last[-(count + 1) :]
    f_s = 0.0
    for i in range(1, count + 1):
        a, b = last[i - 1], last[i]
        if a is not None and b is not None:
            f_s += math.exp(-((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) / (2 * sigma**2)) / count
    x_n = sum(place is not None for place in last[1:])
    c_n = 0
    for place in last[1:]:
        c_n = count if place is not None else max(0, c_n - 1)
    f_t = x_n / count * c_n / count
    here = last[-1]
    if here is None:
        return f_s * f_t, f_s
    safe = 1.5 * speed + speed**2 / 12.0
    distance = math.hypot(*here)
    f_d = max(0.0, (safe - distance) / safe)
    f_theta = max(0.0, here[0] / distance)
    return f_d * fraction * f_theta * ATTACK_TYPES[kind] * f_s * f_t, f_s


def test_equals_the_printed_formulas_on_random_streams() -> None:
    random = np.random.default_rng(0)
    for _ in range(50):
        speed = float(random.uniform(5.0, 40.0))
        kind = str(random.choice(list(ATTACK_TYPES)))
        tracker = RiskTracker()
        seen: list[tuple[float, float] | None] = []
        for _ in range(int(random.integers(1, 60))):
            place = (float(random.uniform(-5, 30)), float(random.uniform(-8, 8)))
            seen.append(place if random.random() < 0.6 else None)
            now = None if seen[-1] is None else attack(*seen[-1], kind)
            risk = tracker.update(now, speed_mps=speed)
        expected, f_s = oracle(seen, RiskParameters().frames(speed), speed, kind)
        assert risk.factor == pytest.approx(expected, rel=1e-9, abs=1e-15)
        assert risk.factors["space"] == pytest.approx(f_s, rel=1e-9, abs=1e-15)
        assert risk.score == pytest.approx(expected ** (1 / len(risk.factors)), rel=1e-9, abs=1e-9)


def test_the_same_place_in_the_world_stays_the_same_place_while_the_car_moves() -> None:
    """The car drives 2 m and turns a quarter to the left; a post 10 m ahead is to its right."""
    still, moved, unknown = RiskTracker(), RiskTracker(), RiskTracker()
    for tracker in (still, moved, unknown):
        tracker.update(attack(10.0, 0.0), speed_mps=20.0)
    same = still.update(attack(10.0, 0.0), speed_mps=20.0)
    turned = moved.update(attack(0.0, -8.0), speed_mps=20.0, motion=(2.0, 0.0, math.pi / 2))
    lost = unknown.update(attack(0.0, -8.0), speed_mps=20.0)
    assert turned.factors["space"] == pytest.approx(same.factors["space"], rel=1e-12)
    assert lost.factors["space"] < 1e-3 * same.factors["space"]


def test_a_car_that_drives_about_sees_the_same_as_one_that_stands() -> None:
    """Places of the world, told in the frame of a car that turns and slips at each step."""
    random = np.random.default_rng(2)
    still, driving = RiskTracker(), RiskTracker()
    position, yaw = np.zeros(2), 0.0
    for _ in range(30):
        motion = (*random.uniform(-3.0, 3.0, 2), random.uniform(-1.0, 1.0))
        axes = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        position, yaw = position + motion[:2] @ axes, yaw + motion[2]
        place = random.uniform(-2.0, 2.0, 2)
        axes = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        ahead, left = axes @ (place - position)
        risks = [
            still.update(attack(*place), speed_mps=20.0),
            driving.update(attack(ahead, left), speed_mps=20.0, motion=motion),
        ]
        spaces = [risk.factors["space"] for risk in risks]
        assert spaces[1] == pytest.approx(spaces[0], rel=1e-9)
    assert spaces[0] > 0.05


def test_a_tracker_that_was_reset_is_a_new_one() -> None:
    used = RiskTracker()
    used.update(attack(), speed_mps=20.0, motion=(3.0, 4.0, 0.5))
    used.reset()
    new = RiskTracker()
    for place in ((8.0, 0.0), (9.0, 1.0)):
        motion = (1.0, 0.2, 0.1)
        risks = [t.update(attack(*place), speed_mps=20.0, motion=motion) for t in (used, new)]
        assert risks[0] == risks[1]


def test_the_gravest_of_several_witnesses_counts() -> None:
    near, far = attack(8.0, 0.0), attack(25.0, 0.0)
    alone = RiskTracker().update(near, speed_mps=20.0)
    for first, second in ((near, far), (far, near)):
        both = RiskTracker().update(first, speed_mps=20.0, others=[second])
        assert both.factors["distance"] == alone.factors["distance"]
    # The product is 0 for both; the rest decides.
    mild, grave = attack(-8.0, 0.0, "replacement"), attack(-8.0, 0.0, "additive")
    for first, second in ((mild, grave), (grave, mild)):
        both = RiskTracker().update(first, speed_mps=20.0, others=[second])
        assert both.factors["type"] == 1.0


def test_the_window_is_the_way_of_a_hundred_metres() -> None:
    speeds = [1.0, 100 / 72, 1.5, 10.0, 33.0, 500.0]
    assert [RiskParameters().frames(speed) for speed in speeds] == [720, 720, 667, 100, 31, 5]
    assert RiskParameters(fps=20.0).frames(10.0) == 200


def test_the_region_and_the_limits_include_their_ends() -> None:
    p = RiskParameters()
    end = p.safe_distance(10.0)
    assert end == pytest.approx(1.5 * 10.0 + 100.0 / 12.0, rel=1e-15)
    places = [(p.nearest_m, -10.0, 0.0), (end, 10.0, -1.5), (5.0, 10.001, 0.0), (4.999, 0.0, 0.0)]
    assert p.contains(places, 10.0).tolist() == [True, True, False, False]
    grid = np.tile(np.array([20.0, 0.0, 0.0]), (2, 4, 1))
    grid[1, 2] = (20.0, 0.0, 9.0)
    expected = np.ones((2, 4), bool)
    expected[1, 2] = False
    np.testing.assert_array_equal(p.contains(grid, 20.0), expected)
    far_aside = np.array([[8, -128, 0], [8, 127, 0], [8, 0, 0]], np.int8)
    assert p.contains(far_aside, 10.0).tolist() == [False, False, True]
    for points in (5.0, [1.0, 2.0], np.ones(3, bool), np.ones((3, 2))):
        with pytest.raises(InputError, match=r"points: expected numbers of shape"):
            p.contains(points, 10.0)
    for limits in ((0.0, 0.0), (1.0, 1.0), (0.5, 0.5)):
        RiskParameters(low=limits[0], high=limits[1])
    RiskParameters(reaction_s=0.0, nearest_m=0.5)
    for bad in (
        {"low": -0.1}, {"high": 1.1}, {"reaction_s": math.inf}, {"bottom_m": 2.0},
        {"bottom_m": -math.inf}, {"top_m": math.inf},
    ):  # fmt: skip
        with pytest.raises(InputError, match="expected"):
            RiskParameters(**bad)


def test_a_score_on_a_limit_is_of_the_level_above() -> None:
    def after_two_frames(parameters: RiskParameters) -> Risk:
        tracker = RiskTracker(parameters)
        return [tracker.update(attack(), speed_mps=20.0) for _ in range(2)][1]

    score = after_two_frames(RiskParameters()).score
    assert score > 0.0
    assert after_two_frames(RiskParameters(low=score, high=1.0)).level == "medium"
    assert after_two_frames(RiskParameters(low=score, high=score)).level == "high"


def test_a_region_without_cells_or_without_length_is_no_risk() -> None:
    none = AttackObservation("both", (8.0, 0.0), changed=0, cells=0)
    assert RiskTracker().update(none, speed_mps=20.0).factors["number"] == 0.0
    whole = AttackObservation("both", (0.25, 0.0), changed=3, cells=3)
    risk = RiskTracker().update(whole, speed_mps=0.5)  # stops within 0.77 m
    assert risk.factors["number"] == 1.0
    assert risk.factors["distance"] == pytest.approx(1.0 - 0.25 / (0.75 + 0.25 / 12.0))


def test_the_printed_correlation_on_random_streams() -> None:
    random = np.random.default_rng(3)
    tracker = RiskTracker(RiskParameters(fps=1.0, paper_literal=True))
    polars: list[tuple[float, float] | None] = []
    for _ in range(60):
        place = random.uniform((2.0, -8.0), (30.0, 8.0))
        polars.append((math.hypot(*place), math.atan2(place[1], place[0])))
        if random.random() < 0.2:
            polars[-1] = None
        now = None if polars[-1] is None else attack(*place)
        risk = tracker.update(now, speed_mps=10.0)  # X_n = 10
        pairs = list(itertools.pairwise(polars[-11:]))
        # Two numbers each have a correlation of +1 or -1 in numpy.
        expected = sum(np.corrcoef(a, b)[0, 1] for a, b in pairs if a and b) / 10
        assert risk.factors["space"] == pytest.approx(expected, abs=1e-12)


def test_the_printed_correlation_is_plus_or_minus_one() -> None:
    tracker = RiskTracker(RiskParameters(fps=1.0, paper_literal=True))
    tracker.update(attack(8.0, 1.0), speed_mps=20.0)
    risk = tracker.update(attack(30.0, -9.0), speed_mps=20.0)
    theta = [math.atan2(1.0, 8.0), math.atan2(-9.0, 30.0)]
    d = [math.hypot(8.0, 1.0), math.hypot(30.0, 9.0)]
    printed = np.corrcoef([d[1], theta[1]], [d[0], theta[0]])[0, 1]
    assert risk.factors["space"] == pytest.approx(printed / 5)


def test_levels_begin_where_the_parameters_say() -> None:
    tracker = RiskTracker(RiskParameters(fps=1.0))
    assert tracker.update(None, speed_mps=20.0).level == "none"
    levels = [tracker.update(attack(), speed_mps=20.0) for _ in range(6)]
    assert levels[0].level == "low"  # one frame alone has no f_s
    assert levels[-1].level == "high"
    assert levels[-1].score >= 0.6
    calm = [tracker.update(None, speed_mps=20.0).level for _ in range(6)]
    assert calm[0] in ("medium", "high")
    assert calm[-1] == "none"
    tracker.reset()
    assert tracker.update(None, speed_mps=20.0).attacked_frames == 0


def test_behind_beyond_or_standing_is_no_risk() -> None:
    for place, speed in (((-5.0, 0.0), 20.0), ((500.0, 0.0), 20.0), ((8.0, 0.0), 0.0)):
        tracker = RiskTracker()
        for _ in range(3):
            risk = tracker.update(attack(*place), speed_mps=speed)
        assert risk.factor == 0.0
        assert risk.level == "low"  # it is an attack all the same


@pytest.mark.parametrize("speed", [0.0, 1e-300, 1e-9, 1.3, 1e6, 1e300])
def test_any_speed_has_a_window(speed: float) -> None:
    assert 5 <= RiskParameters().frames(speed) <= 720
    assert 0.0 <= RiskTracker().update(attack(), speed_mps=speed).factor <= 1.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: attack(kind="arson"), "type: expected one of additive"),
        (lambda: attack(x=math.nan), "position: expected finite"),
        (lambda: AttackObservation("both", (1.0, 0.0), 5, 4), "changed: expected 0 to cells"),
        (lambda: RiskParameters(sigma_m=0.0), "sigma_m: expected a number > 0"),
        (lambda: RiskParameters(fps=math.nan), "fps: expected a number > 0"),
        (lambda: RiskParameters(low=0.7), "low, high: expected"),
        (lambda: RiskParameters(bottom_m=3.0), "bottom_m, top_m"),
        (lambda: RiskTracker().update(None, speed_mps=-1.0), "speed_mps: expected a number >= 0"),
        (lambda: RiskTracker().update(None, speed_mps=math.inf), "speed_mps"),
        (
            lambda: RiskTracker().update(None, speed_mps=1.0, motion=(0.0, math.nan, 0.0)),
            "motion: expected finite",
        ),
        (
            lambda: RiskTracker().update(None, speed_mps=1.0, motion=(1e200, 0.0, 0.0)),
            "motion: expected at most",
        ),
        (lambda: temporal_factor([]), "attacked: expected 1"),
        (lambda: temporal_factor([True] * 6, frames=5), "attacked: expected 1 to 5"),
    ],
)
def test_bad_input_is_named(make: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        make()  # type: ignore[operator]


def test_the_height_of_a_roof_is_still_ahead() -> None:
    parameters = RiskParameters()
    heights = [parameters.top_m, parameters.top_m + 1e-6, parameters.bottom_m]
    places = [(20.0, 0.0, height) for height in heights]
    assert parameters.contains(places, 50 / 3.6).tolist() == [True, False, True]


def test_the_oldest_frame_of_the_longest_window_is_compared_with_the_one_before() -> None:
    """The longest window, 720 frames, gives 720 pairs together with the frame before it."""
    tracker = RiskTracker()
    for _ in range(730):
        risk = tracker.update(attack(), speed_mps=1.0)
    assert risk.frames == 720
    assert risk.factors["space"] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("sigma_m", "space"), [(1e-200, 0.0), (1e200, 2 / 100)])
def test_places_far_beyond_any_sigma_are_others(sigma_m: float, space: float) -> None:
    """Squares of such numbers are no floats: each of these was an error of Python's."""
    tracker = RiskTracker(RiskParameters(sigma_m=sigma_m))
    for place in (8.0, 9.0, 10.0):
        risk = tracker.update(attack(x=place), speed_mps=10.0)
    assert risk.factors["space"] == space
    for place in (1e200, -1e200):
        assert RiskTracker().update(attack(x=place), speed_mps=10.0).level == "low"
    tracker = RiskTracker()
    for place in (1e200, -1e200):
        risk = tracker.update(attack(x=place), speed_mps=10.0)
    assert risk.factors["space"] == 0.0
