"""The experiment of simulated observers: its cases, and claims that can fail."""

from __future__ import annotations

from manip3d.experiments import Case, Plan, jnd_simulated, registry


def test_it_is_registered() -> None:
    assert registry()["jnd-simulated"] is jnd_simulated.EXPERIMENT


def test_rows_are_measured() -> None:
    case = jnd_simulated.EXPERIMENT.cases(Plan(scale="quick"))[0]
    few = Case(case.run, {**case.options, "count": 60})
    row = jnd_simulated.observe(few)
    assert 80.0 <= row["coverage"] <= 100.0  # 95 % of 60, within five standard deviations
    assert 20 < row["trials"] < 80
    assert abs(row["bias"]) < row["rms"] < 20
    assert jnd_simulated.observe(few) == row


def test_claims_fail_where_intervals_are_too_narrow_or_too_wide() -> None:
    mixed, kinds = jnd_simulated.EXPERIMENT.claims

    def row(name: str, coverage: float, count: int = 1000) -> dict[str, object]:
        return {"model": name, "coverage": coverage, "count": count, "role": "", "error": None}

    for coverage, word in ((95.0, "holds"), (92.9, "does not hold"), (97.1, "does not hold")):
        assert mixed.verdict([row("mixed", coverage), row("slope 6", 99.0)]).word == word
        assert kinds.verdict([row("mixed", 0.0), row("slope 6", coverage)]).word == word
        quick = mixed.verdict([row("mixed", coverage, 100)])
        assert quick.word == "undecided"
        assert quick.findings[0].numbers == f"{coverage:.1f} % of 100 observers"
