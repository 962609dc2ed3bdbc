"""The analysis against closed forms, and against simulated studies whose effect is known."""

from __future__ import annotations

import time
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from manip3d import InputError

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("cryptography", reason="the extra 'diary' is not installed")
pytest.importorskip("scipy", reason="the extra 'diary' is not installed")

from scipy import stats

from manip3d.diary import (
    MCGILL_GROUPS,
    Diary,
    DiaryGame,
    analyse,
    fit_mixed_model,
    simulate_cohort,
)
from manip3d.diary._analysis import Estimate, _paired, _satterthwaite, _share, fit_slope

EFFECTS = (-4.0, -10.0)
START = datetime(2026, 3, 2, 9, 0, tzinfo=UTC)


def test_complete_data_give_the_analysis_of_variance() -> None:
    scores = simulate_cohort(seed=3)
    model = fit_mixed_model(scores)
    people, times = scores.shape
    means = scores.mean(axis=0)
    residual = scores - scores.mean(axis=1, keepdims=True) - means + scores.mean()
    df = (people - 1) * (times - 1)
    within = float((residual**2).sum()) / df
    between = people - 1
    rows = times * float(((scores.mean(axis=1) - scores.mean()) ** 2).sum()) / between
    assert model.means == pytest.approx(tuple(means))
    assert model.sd_within == pytest.approx(np.sqrt(within), rel=1e-4)
    assert model.sd_between == pytest.approx(np.sqrt((rows - within) / times), rel=1e-3)
    half = stats.t.ppf(0.975, df) * np.sqrt(2 * within / people)
    for change, mean in zip(model.changes, means[1:] - means[0], strict=True):
        assert change.value == pytest.approx(mean)
        assert change.df == pytest.approx(df, rel=1e-3)
        assert (change.high - change.low) / 2 == pytest.approx(half, rel=1e-3)
        t = abs(mean) / np.sqrt(2 * within / people)
        assert change.p == pytest.approx(2 * stats.t.sf(t, df), rel=1e-2)


def test_a_score_that_is_missing_takes_nobody_out() -> None:
    scores = simulate_cohort(seed=5)
    scores[2, 1] = scores[7, 2] = np.nan
    model = fit_mixed_model(scores)
    assert (model.participants, model.scores) == (10, 28)
    assert 14 < model.changes[0].df < 18
    alone = np.vstack([scores, [50.0, np.nan, np.nan]])
    assert fit_mixed_model(alone).participants == 11


def test_standard_errors_are_those_of_other_programs() -> None:
    """Compared with statsmodels 0.15.0, ``mixedlm('score ~ occasion').fit(reml=True)``.

    It takes the errors of the changes from the observed information, which has no closed form, so
    that they differ by 0.2 %. That of the baseline, 1.0743, is smaller than those of changes.
    """
    nan = np.nan
    model = fit_mixed_model([
        [13, 10, 3], [20, 12, 7], [15, 7, 5], [24, 15, 10], [21, nan, 7], [19, 8, 8],
        [25, 8, 10], [18, 6, nan], [17, 12, 5],
    ])  # fmt: skip
    assert model.means[0] == pytest.approx(19.111111, abs=1e-5)
    assert (model.sd_between, model.sd_within) == pytest.approx((2.19441, 2.36031), abs=1e-4)
    changes = ((-9.273611, 1.158014), (-12.432055, 1.159385))
    for change, (value, error) in zip(model.changes, changes, strict=True):
        assert change.value == pytest.approx(value, abs=1e-4)
        half = (change.high - change.low) / 2
        assert half / stats.t.ppf(0.975, change.df) == pytest.approx(error, rel=3e-3)


@pytest.mark.parametrize(
    ("scores", "message"),
    [
        ([1.0, 2.0], r"expected \(N, T\) with T >= 2"),
        ([[1.0], [2.0]], "with T >= 2"),
        ([[1.0, 2.0]], "two participants with two scores"),
        ([[1.0, np.inf], [1.0, 2.0]], "finite numbers or NaN"),
        ([[1.0, np.nan], [1.0, np.nan]], "somebody at each occasion"),
        ([[1.0, 2.0], [2.0, 3.0]], "scores that vary"),
        ([[0.0, 0.0], [0.0, 0.0]], "scores that vary"),
    ],
)
def test_scores_that_say_nothing(scores: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fit_mixed_model(scores)


@pytest.mark.parametrize(
    "scores",
    [
        [[1, 2, np.nan, np.nan], [np.nan, np.nan, 3, 4]],
        [[1, 2, np.nan, np.nan], [np.nan, np.nan, 3, 4], [5, np.nan, np.nan, np.nan]],
    ],
)
def test_scores_that_leave_nothing_to_noise_have_no_model(scores: list[list[float]]) -> None:
    with pytest.raises(InputError, match="scores: expected more of them to tell the noise"):
        fit_mixed_model(scores)


@pytest.mark.parametrize(
    ("name", "value"), [("sd_between", np.nan), ("baseline", np.inf), ("effects", [np.nan])]
)
def test_cohorts_are_drawn_from_finite_numbers(name: str, value: object) -> None:
    with pytest.raises(InputError, match=f"{name}.*: expected"):
        simulate_cohort(**{name: value})  # type: ignore[arg-type]


def coverage(cohorts: int, **options: float) -> list[float]:
    """Shares of studies whose intervals hold the true changes."""
    hits = np.zeros(len(EFFECTS))
    for seed in range(cohorts):
        model = fit_mixed_model(simulate_cohort(EFFECTS, seed=seed, **options))  # type: ignore[arg-type]
        hits += [c.low <= true <= c.high for c, true in zip(model.changes, EFFECTS, strict=True)]
    return [float(share) for share in hits / cohorts]


def check_coverage(shares: list[float], cohorts: int) -> None:
    """Within 93 to 97 %, but for what so many studies leave to chance (four standard errors)."""
    slack = 4.0 * np.sqrt(0.95 * 0.05 / cohorts)
    for share in shares:
        assert 0.95 - max(slack, 0.02) <= share <= 0.95 + max(slack, 0.02)


@pytest.mark.parametrize("missing", [0.0, 0.15])
def test_intervals_hold_the_truth(missing: float) -> None:
    check_coverage(coverage(400, missing=missing), 400)


def test_paired_intervals_hold_the_truth_where_participants_respond_differently() -> None:
    hits = np.zeros(len(EFFECTS))
    for seed in range(1000):
        scores = simulate_cohort(EFFECTS, sd_response=8.0, seed=seed)
        for which, true in enumerate(EFFECTS):
            found, _ = _paired(scores[:, which + 1] - scores[:, 0])
            assert found is not None
            hits[which] += found.low <= true <= found.high
    check_coverage((hits / 1000).tolist(), 1000)


@pytest.mark.slow
@pytest.mark.parametrize("missing", [0.0, 0.15])
def test_intervals_hold_the_truth_in_93_to_97_percent(missing: float) -> None:
    shares = coverage(5000, missing=missing)
    assert all(0.93 <= share <= 0.97 for share in shares), shares


def test_shares_have_exact_intervals() -> None:
    for number, of in ((0, 10), (3, 10), (10, 10)):
        share = _share(number, of)
        interval = stats.binomtest(number, of).proportion_ci(method="exact")
        assert (share.low, share.high) == pytest.approx((interval.low, interval.high))


def ranks(pri: int) -> list[int]:
    """Some answers with this sum."""
    found = []
    for most in MCGILL_GROUPS:
        found.append(min(most, pri))
        pri -= found[-1]
    assert pri == 0
    return found


def test_equal_changes_do_not_show_how_changes_vary() -> None:
    found, why = _paired(np.array([-7.0, -7.0]))
    assert found is None
    assert "all 2 participants have the same change, -7" in why
    found, why = _paired(np.array([-7.0, -8.0]))
    assert found is not None
    assert why == ""
    assert found.low < found.value == -7.5 < found.high


def test_a_study_from_its_diary(tmp_path: Path) -> None:
    scores = {
        "P01": (40, 30, 18),
        "P02": (30, 28, 20),
        "P03": (50, 52, 45),
        "P04": (20, None, None),
    }
    played = {"P01": 14, "P02": 10, "P03": 2, "P04": 0}
    with Diary(tmp_path / "d", create=True) as diary:
        for name, found in scores.items():
            diary.enrol(name, at=START)
            for occasion, pri in zip(("baseline", "week-1", "week-4"), found, strict=True):
                if pri is not None:
                    diary.add_mcgill(name, ranks(pri), 2, occasion=occasion, at=START)  # type: ignore[arg-type]
            for number in range(played[name]):
                at = START + timedelta(days=number // 2, hours=5 * (number % 2))
                session = diary.start_session(name, at=at)
                for title in ("pedal", "piano", "bubbles-legs"):
                    diary.add_game(session, DiaryGame(at, title, 1, 0, "time", 60, 0, 5, 0, 2))
        found = analyse(diary, today=date(2026, 3, 8))
    assert found.identifiers == tuple(scores)
    assert found.scores[0].tolist() == [40, 30, 18]
    assert np.isnan(found.scores[3, 1:]).all()
    assert found.model is not None
    assert found.model.scores == 10
    # 40 -> 18 is 55 %, 30 -> 20 is 33 %, 50 -> 45 is 10 %.
    assert (found.responders_30.number, found.responders_30.of) == (2, 3)
    assert (found.responders_50.number, found.responders_50.of) == (1, 3)
    assert found.paired[1] is not None
    assert found.paired[1].value == pytest.approx((-22 - 10 - 5) / 3)
    t = stats.ttest_rel([18, 20, 45], [40, 30, 50]).confidence_interval()
    assert (found.paired[1].low, found.paired[1].high) == pytest.approx((t.low, t.high))
    assert [found.adherence[name].share for name in scores] == [1.0, 10 / 14, 2 / 14, 0.0]
    line = stats.linregress([1.0, 10 / 14, 2 / 14], [-22.0, -10.0, -5.0])
    assert found.adherence_slope is not None
    assert found.adherence_slope.value == pytest.approx(line.slope)
    assert found.adherence_slope.p == pytest.approx(line.pvalue)


def test_who_got_worse_from_zero_stays_among_the_participants(tmp_path: Path) -> None:
    """Nothing falls from 0; without this participant all would have responded."""
    scores = {"P01": (40, 10), "P02": (30, 10), "P03": (20, 5), "P04": (0, 40), "P05": (0, 0)}
    with Diary(tmp_path / "d", create=True) as diary:
        for name, (first, last) in scores.items():
            diary.enrol(name, at=START)
            diary.add_mcgill(name, ranks(first), 2, occasion="baseline", at=START)
            diary.add_mcgill(name, ranks(last), 2, occasion="week-4", at=START)
        found = analyse(diary, today=date(2026, 3, 8))
    assert (found.responders_30.number, found.responders_30.of) == (3, 5)
    assert (found.responders_50.number, found.responders_50.of) == (3, 5)
    assert found.num_without_pain == 2


def test_without_a_baseline_the_occasions_are_the_later_ones(tmp_path: Path) -> None:
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01", at=START)
        diary.add_mcgill("P01", ranks(20), 2, occasion="week-1", at=START)
        diary.enrol("P02", at=START)  # without pain, and without a score at week 4
        diary.add_mcgill("P02", ranks(0), 2, occasion="baseline", at=START)
        assert analyse(diary).num_without_pain == 0
        diary.delete("P02")
        found = analyse(diary)
    assert (found.model, found.model_occasions) == (None, ("week-1",))


def test_the_model_is_of_the_occasions_with_scores(tmp_path: Path) -> None:
    scores = np.array([[40.0, 18.0], [30.0, 20.0], [50.0, 45.0]])
    with Diary(tmp_path / "d", create=True) as diary:
        for number, (first, last) in enumerate(scores.astype(int).tolist()):
            diary.enrol(f"P{number}", at=START)
            diary.add_mcgill(f"P{number}", ranks(last), 2, occasion="week-4", at=START)
            assert analyse(diary).why_no_model == (
                "expected scores at baseline and at a later occasion" if number == 0
                else "expected two participants with two scores each" if number == 1
                else ""
            )  # fmt: skip
            diary.add_mcgill(f"P{number}", ranks(first), 2, occasion="baseline", at=START)
        found = analyse(diary)
    assert found.model_occasions == ("baseline", "week-4")
    assert found.model is not None
    assert found.model.changes[0].value == pytest.approx(fit_mixed_model(scores).changes[0].value)
    assert found.why_not_paired == ("expected two participants with both scores, got 0", "")


def test_a_study_that_has_just_begun(tmp_path: Path) -> None:
    with Diary(tmp_path / "d", create=True) as diary:
        with pytest.raises(InputError, match="expected participants, got none"):
            analyse(diary)
        diary.enrol("P01")
        found = analyse(diary)
    assert (found.model, found.paired, found.adherence_slope) == (None, (None, None), None)
    assert found.why_no_slope == "expected three participants with both scores, got 0"
    assert (found.responders_30.of, found.responders_30.low, found.responders_30.high) == (0, 0, 1)


def test_days_are_those_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Evenings of the first two days of March in a zone eight hours behind UTC, stamped in UTC."""
    evening = datetime(2026, 3, 2, 2, 0, tzinfo=UTC)
    monkeypatch.setenv("TZ", "XST8")
    time.tzset()
    try:
        with Diary(tmp_path / "d", create=True) as diary:
            diary.enrol("P01", at=evening)
            for day in range(2):
                at = evening + timedelta(days=day, minutes=30)
                session = diary.start_session("P01", at=at)
                for title in ("pedal", "piano", "bubbles-legs"):
                    diary.add_game(session, DiaryGame(at, title, 1, 0, "time", 60, 0, 5, 0, 2))
            first, second = (
                analyse(diary, today=date(2026, 3, day)).adherence["P01"] for day in (1, 2)
            )
            with pytest.raises(InputError, match="today: expected a date without a time"):
                analyse(diary, today=datetime(2026, 3, 2))
            with pytest.raises(InputError, match="today: expected 2026-03-01 or later"):
                analyse(diary, today=date(2026, 2, 28))
    finally:
        monkeypatch.undo()
        time.tzset()
    assert (first.days, first.expected, first.complete) == (1, 2, 1)
    assert (second.days, second.expected, second.complete) == (2, 4, 2)


def test_somebody_enrolled_with_a_later_time_is_in_the_analysis(tmp_path: Path) -> None:
    later = datetime.now(UTC) + timedelta(days=2)
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01", at=later)
        assert analyse(diary).adherence["P01"].days == 1
        with pytest.raises(InputError, match="today: expected"):
            analyse(diary, today=date.today())


def test_degrees_of_freedom_of_a_balanced_design() -> None:
    """The mean of k groups alike has k - 1, whatever the two variances are."""
    for groups, size, within, between in ((5, 4, 1.0, 0.3), (9, 3, 0.2, 2.0), (4, 6, 1.0, 1.0)):
        together = np.kron(np.eye(groups), np.ones((size, size)))
        design = np.ones((groups * size, 1))
        df = _satterthwaite(design, together, within, between, np.ones(1))
        assert df == pytest.approx(groups - 1)


def test_slopes_against_scipy_and_without_residual() -> None:
    rng = np.random.default_rng(2)
    for count in (3, 4, 20):
        x, y = rng.normal(size=(2, count))
        found, expected = fit_slope(x, y), stats.linregress(x, y)
        assert found is not None
        half = expected.stderr * stats.t.ppf(0.975, count - 2)
        assert (found.value, found.p, found.df) == pytest.approx(
            (expected.slope, expected.pvalue, count - 2)
        )
        assert (found.low, found.high) == pytest.approx(
            (expected.slope - half, expected.slope + half)
        )
    days = np.arange(4.0)
    for slope, p in ((2.0, 0.0), (0.0, 1.0)):  # all values on a line: nothing is left to chance
        exact = fit_slope(days, 8 + slope * days)
        assert exact == Estimate(slope, slope, slope, p, 2.0)
