"""One case of each experiment fails: the report is written and claims nothing of it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from manip3d import cli
from manip3d.experiments import Case, Experiment, Plan, Row, registry
from manip3d.experiments.table_3_4 import EXPERIMENT as ERRORS

SABOTAGE = "the first case was sabotaged"
# Experiments on recordings have no case without them.
ONLY_RECORDED = {
    "cameras-5": [{"model": name, "camera": name} for name in ("azure", "realsense")],
    "real-people-4": [
        {"model": f"recording of {kind}", "kind": kind}
        for kind in ("sequence", "skeletons", "image")
    ],
    "real-scans-6": [{"model": "scan"}, {"model": "another scan"}],
}


def unreachable(case: Case) -> Row:
    """Stands for the work of a case; the tests run none."""
    raise AssertionError(case)


def cases_of(experiment: Experiment) -> list[Case]:
    """The cases of a quick run without data."""
    made = list(experiment.cases(Plan("simulated", "quick")))
    return made or [Case(unreachable, options) for options in ONLY_RECORDED[experiment.id]]


@pytest.mark.parametrize("name", registry())
def test_a_sabotaged_case_is_reported_and_claims_nothing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment = registry()[name]
    first, *_ = cases = cases_of(experiment)

    def run_case(case: Case) -> Row:
        if case == first:
            raise RuntimeError(SABOTAGE)
        return {}  # no judge knows what to do with it: that must not matter

    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    monkeypatch.setattr("manip3d.experiments._runner._run_case", run_case)
    monkeypatch.setattr(
        "manip3d.experiments.select",
        lambda _: [dataclasses.replace(experiment, cases=lambda _: cases)],
    )
    results, page = tmp_path / "results", tmp_path / "report.html"
    with pytest.raises(SystemExit) as stopped:
        cli.main(["reproduce", name, "--jobs", "1", "-q", "-o", str(results)])
    assert stopped.value.code == 1

    with pytest.raises(SystemExit) as stopped:
        cli.main(["report", str(results), "-q", "-o", str(page)])
    assert stopped.value.code == 0
    assert SABOTAGE in page.read_text()

    record = json.loads((results / "results.json").read_text())["experiments"][name]
    failed = [row for row in record["rows"] if SABOTAGE in row["error"]]
    # Gathered cases are parts of rows: one that fails takes all of its rows with it.
    assert len(failed) == 1 or (failed and experiment.gather is not None)
    assert len({row["model"] for row in failed}) == 1
    needed = {claim.text for claim in experiment.claims if claim.about(failed[0])}
    verdicts = {verdict["claim"]: verdict["word"] for verdict in record["verdicts"]}
    assert needed or not experiment.claims
    assert {verdicts[text] for text in needed} <= {"not judged"}
    assert "holds" not in verdicts.values()


def row(model: str, method: str, error: float, **more: object) -> Row:
    """A measured row of table 3.4."""
    measures = dict.fromkeys(("metro_area", "metro_vertex", "mse"), error)
    measures["fmpd"] = 2.0 if method == "qem4vr" else error  # so that every claim holds
    return {
        "model": model, "stands_in_for": "Bunny", "data": "published", "method": method,
        "published_metro": 1.0, "error": "", **measures, **more,
    }  # fmt: skip


METHODS = {"qem4vr": 0.3, "uniform": 0.9, "poisson": 0.8, "ssa": 4.0, "cios": 0.5, "relief": 0.2}


@pytest.mark.parametrize("broken", METHODS)
def test_a_failed_method_of_table_3_4_takes_its_model_out_and_no_other(broken: str) -> None:
    """One failed method once ended the run: judges look for each method of a model."""
    whole = [row("whole", method, error) for method, error in METHODS.items()]
    torn = [
        {"model": "torn", "method": m, "data": "published", "error": "torn"}
        if m == broken
        else row("torn", m, error)
        for m, error in METHODS.items()
    ]
    for claim in ERRORS.claims:
        assert claim.verdict(whole).word == "holds"
        verdict = claim.verdict([*torn, *whole])
        assert verdict.word == "not judged"
        judged = [finding for finding in verdict.findings if finding.holds is not None]
        assert judged
        assert not any("torn" in finding.subject for finding in judged)
        assert any(finding.subject == f"torn {broken}" for finding in verdict.findings)
