"""Chapter 2's experiments: which meshes they look at, what is printed, and honest claims."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from manip3d import datasets
from manip3d.experiments import Plan, Row, registry, run, select
from manip3d.experiments import _progressive as progressive
from manip3d.experiments import _published as published
from manip3d.experiments._simplification import (
    SIMULATED,
    TEXTURED_METHODS,
    at_most,
    complete,
    lowest_claims,
    models,
    reaches_target,
    reaches_where_others_stop,
    refuses_faces_without_uv,
)
from real_data import RealData

TABLES = ("table-2.1", "table-2.2", "table-2.3", "table-2.4", "table-2.6", "table-2.7")


def row(method: str, error: float | None, **changes: Any) -> Row:
    """A measured row of a textured model that reached its target."""
    return {
        "model": "BAe-125-uv",
        "stands_in_for": "Jet",
        "data": "published",
        "method": method,
        "faces": 100,
        "faces_target": 100,
        "faces_without_uv": 0,
        "stop": "target_reached",
        "metro_vertex": error,
        "error": "",
    } | changes


def five(**errors: float) -> list[Row]:
    """Rows of all five methods; an error of 1 unless another is given."""
    return [row(method, errors.get(method.replace("-", "_"), 1.0)) for method in TEXTURED_METHODS]


def words(claims: Any, rows: list[Row]) -> list[str]:
    return [claim.verdict(rows).word for claim in claims]


@pytest.fixture
def no_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MANIP3D_DATA", str(tmp_path))
    monkeypatch.setenv("MANIP3D_CACHE", str(tmp_path / "cache"))


def test_the_registry_has_the_issue_s_experiments() -> None:
    assert set(TABLES) | {"figure-2.11", "figure-2.17"} <= set(registry())
    for experiment in registry().values():
        for name in experiment.data:
            datasets.get(name)


@pytest.mark.usefixtures("no_data")
def test_without_data_simulated_models_stand_in_for_all_six() -> None:
    chosen = models(Plan(data="auto"))
    assert chosen == list(SIMULATED)
    assert {model.published for model, _ in chosen} == {
        "RockerArm", "Car", "Dragon", "Head", "Jet", "Airplane",
    }  # fmt: skip
    assert not any(model.same_file for model, _ in chosen)


def test_real_plans_name_every_stand_in() -> None:
    assert [model for model, _ in models(Plan(data="real"))] == [
        *sorted(
            datasets.STAND_INS,
            key=lambda m: ["RockerArm", "Car", "Dragon", "Head", "Jet", "Airplane", ""].index(
                m.published
            ),
        )
    ]
    assert all(faces == 0 for _, faces in models(Plan(data="real")))


@pytest.mark.usefixtures("no_data")
def test_cases_are_shared_among_tables() -> None:
    plan = Plan(data="simulated")
    cases = {name: registry()[name].cases(plan) for name in TABLES}
    assert cases["table-2.2"] == cases["table-2.6"]
    assert cases["table-2.3"] == cases["table-2.4"] == cases["table-2.7"]
    assert registry()["figure-2.11"].cases(plan) == registry()["figure-2.17"].cases(plan)


def test_published_targets_are_those_of_the_published_files() -> None:
    cases = registry()["table-2.2"].cases(Plan(data="real"))
    targets = {case.options["model"]: case.options["faces_target"] for case in cases}
    assert targets.pop("rockerArm") == 8174
    assert set(targets.values()) == {None}


@pytest.mark.parametrize(
    ("model", "method", "expected"),
    [
        ("RockerArm", "qem4vr", (0.180e-3, None, 0.413, 8174)),
        ("Head", "qem4vr", (None, 0.34e-2, 0.523, 1844)),
        ("Airplane", "qem-tp", ("fail", "fail", "fail", "fail")),
        ("", "qem4vr", (None, None, None, None)),
    ],
)
def test_printed_values_stand_in_the_row(model: str, method: str, expected: tuple) -> None:
    done = complete(row(method, 1.0, stands_in_for=model))
    names = ("metro_vertex", "texture_mean", "fmpd", "faces")
    for name, value in zip(names, expected, strict=True):
        got = done[f"published_{name}"]
        assert got == (pytest.approx(value) if isinstance(value, float) else value)


def test_published_tables_are_read_as_printed() -> None:
    assert published.value("table_2_2_metro_non_textured", "Car", "qem-bp", "metro_1e-3") == 1.018
    assert published.value("table_2_3_2_4_textured", "Jet", "qem4vr", "metro_1e-3") is None


def claims(five_methods: bool = True):
    return lowest_claims("metro_vertex", "Metro", "table", scale=1e3, five=five_methods)


def test_the_lowest_error_holds_for_five_for_runners_and_at_the_target() -> None:
    assert words(claims(), five(qem4vr=0.5)) == ["holds"] * 3


def test_a_tie_counts_and_is_said() -> None:
    verdict = claims()[0].verdict(five())
    assert verdict.word == "holds"
    assert "(a tie)" in verdict.findings[0].numbers


def test_a_lower_error_of_another_method_is_reported() -> None:
    verdict = claims()[0].verdict(five(qem4vr=0.5, qem_tp=0.4))
    assert verdict.word == "does not hold"
    assert "QEM-TP 400.000" in verdict.findings[0].numbers


def test_a_claim_about_five_methods_needs_five() -> None:
    rows = [r for r in five(qem4vr=0.5) if r["method"] not in ("qem-tp", "qem-btp")]
    rows += [row(m, None, stop="refused", faces=None) for m in ("qem-tp", "qem-btp")]
    first, second, third = (claim.verdict(rows) for claim in claims())
    assert first.word == "not applicable"
    assert "QEM-TP, QEM-BTP" in first.findings[0].numbers
    assert second.word == third.word == "holds"


def test_methods_that_stopped_early_are_left_out_of_one_claim_only() -> None:
    rows = five(qem4vr=0.5)
    rows[1] |= {"metro_vertex": 0.1, "faces": 900, "stop": "no_legal_collapse"}
    assert words(claims(), rows) == ["does not hold", "does not hold", "holds"]
    assert "(at 900 faces)" in claims()[1].verdict(rows).findings[0].numbers


def test_missing_the_target_is_reported() -> None:
    missed = row("qem4vr", 1.0, faces=120, stop="no_legal_collapse")
    assert reaches_target().verdict([missed]).word == "does not hold"
    assert reaches_target().verdict([row("qem4vr", 1.0)]).word == "holds"
    early = row("qem-bp", 1.0, faces=300, stop="no_legal_collapse")
    claim = reaches_where_others_stop(("qem-bp",), "table")
    assert claim.verdict([early, row("qem4vr", 1.0)]).word == "holds"
    assert claim.verdict([early, missed]).word == "does not hold"
    assert claim.verdict([row("qem-bp", 1.0), row("qem4vr", 1.0)]).word == "not applicable"


def test_faces_without_uv_must_be_refused() -> None:
    claim = refuses_faces_without_uv()
    refused = row("qem-tp", None, faces_without_uv=7, stop="refused")
    assert claim.verdict([refused]).word == "holds"
    assert claim.verdict([row("qem-tp", 1.0, faces_without_uv=7)]).word == "does not hold"
    assert claim.verdict([row("qem-tp", 1.0)]).word == "not applicable"


def test_an_aim_is_judged_on_the_published_file_only() -> None:
    claim = at_most("metro_vertex", 0.5, "Jet", "aim", scale=1.0)
    verdict = claim.verdict([row("qem4vr", 0.4, data="stand-in")])
    assert verdict.word == "undecided"
    assert verdict.findings[0].unjudged == "only the published file can judge this"
    assert claim.verdict([row("qem4vr", 0.4, data="published")]).word == "holds"
    assert claim.verdict([row("qem4vr", 0.6, data="published")]).word == "does not hold"
    nothing = row("qem4vr", math.nan, data="published")
    assert claim.verdict([nothing]).word == "does not hold"


def test_curves_end_where_their_method_stops() -> None:
    levels = [(0.5, 500, "target_reached"), (0.2, 300, "no_legal_collapse"),
              (0.1, 300, "no_legal_collapse")]  # fmt: skip
    rows = [row("qem-bp", 1.0, level=l, faces=f, stop=s) for l, f, s in levels]  # noqa: E741
    ((model, by_method),) = progressive.curves(rows)
    assert model == "BAe-125-uv"
    assert [r["faces"] for r in by_method["qem-bp"]] == [500, 300]
    assert progressive.ends_early(by_method["qem-bp"])


@pytest.mark.usefixtures("no_data")
def test_a_small_run_measures_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # The modules of all experiments are loaded before a list that they copy is replaced.
    experiments = select(["table-2.3", "table-2.4", "table-2.7"])
    monkeypatch.setenv("MANIP3D_RENDERER", "none")
    monkeypatch.setattr(
        "manip3d.experiments._simplification.SIMULATED",
        tuple((m, 8000) for m, _ in SIMULATED if m.mesh == "head"),
    )
    summary = run(experiments, tmp_path / "out", plan=Plan(scale="quick"), jobs=1)
    assert (summary.cases, summary.failed) == (5, 0)
    for record in summary.results["experiments"].values():
        for measured in record["rows"]:
            assert measured["faces"] <= measured["faces_target"]
            for name in ("metro_vertex", "metro_area", "texture_mean", "fmpd"):
                assert 0 <= measured[name] < 2
            assert measured["metro_area"] > 0
            assert measured["cracks"] == 0
            assert (tmp_path / "out" / measured["simplified"]).exists()
    sheet = summary.results["pictures"]["head (simulated)"]
    assert "MANIP3D_RENDERER" in sheet["error"]


@pytest.mark.published("table 2.1")
def test_counts_of_the_published_files(realdata: RealData, tmp_path: Path) -> None:
    results = run(select(["table-2.1"]), tmp_path, plan=Plan(scale="quick"), jobs=1).results
    verdicts = results["experiments"]["table-2.1"]["verdicts"]
    assert [verdict["word"] for verdict in verdicts] == ["holds", "holds"]


def counts_row(model: str, data: str, faces: int = 4) -> Row:
    """A counted row of table 2.1 or 3.1."""
    counts = {"faces": faces, "vertices": 4, "boundary_edges": 0}
    printed = {f"published_{name}": value for name, value in (counts | {"faces": 4}).items()}
    return {"model": f"file of {model}", "stands_in_for": model, "data": data, **counts, **printed}


@pytest.mark.parametrize(
    ("table", "first", "second"),
    [("table-2.1", "RockerArm", "Head"), ("table-3.1", "Bunny", "Buddha")],
)
def test_a_claim_about_two_files_does_not_hold_for_one_of_them(
    table: str, first: str, second: str
) -> None:
    """With RockerArm alone it held that RockerArm and Head are the published files."""
    claim = registry()[table].claims[0]
    both = [counts_row(first, "published"), counts_row(second, "published")]
    assert claim.verdict(both).word == "holds"
    for rows in (both[:1], [both[0], counts_row(second, "simulated")]):
        verdict = claim.verdict(rows)
        assert (verdict.word, verdict.holds) == ("undecided", None)
        found = {finding.subject: finding.unjudged for finding in verdict.findings}
        assert found == {
            f"file of {first}": "", second: "the published file is not in this run",
        }  # fmt: skip
    wrong = [*both[:1], counts_row(second, "published", faces=5)]
    assert claim.verdict(wrong).word == "does not hold"
    none = [counts_row(first, "simulated"), counts_row(second, "stand-in")]
    assert claim.verdict(none).word == "undecided"


def frame_row(models: int, method: str, polygons: int, ms: float | None) -> Row:
    """A measured row of table 2.5."""
    return {
        "model": f"{models} models",
        "models": models,
        "method": method,
        "renderer": "pyvista",
        "data": "simulated",
        "polygons": polygons,
        "driver": "a test",
        "ms": ms,
        "fps": None if ms is None else 1000.0 / ms,
        "published_fps": 57.0,
        "error": "",
    }


def test_table_2_5_has_the_published_scenes() -> None:
    experiment = registry()["table-2.5"]
    cases = experiment.cases(Plan(data="simulated"))
    assert len(cases) == 48
    whole = {c.options["method"]: c for c in cases if c.options["models"] == 6}
    assert [part["faces"] for part in whole["original"].options["scene"]] == [
        66_496, 80_354, 35_095, 268_630, 17_684, 37_986,
    ]  # fmt: skip
    assert sum(part["faces"] for part in whole["QEM_BP"].options["scene"]) == 130_886
    assert {case.options["data"] for case in cases} == {"simulated"}


def test_table_2_5_judges_time_against_polygons() -> None:
    claims = registry()["table-2.5"].claims
    rows = [
        frame_row(6, "original", 500_000, 30.0),
        frame_row(6, "QEM_BP", 130_000, 17.0),
        frame_row(6, "QEM_4VR", 48_000, 16.0),
    ]
    simulated = "holds on simulated data"
    assert words(claims, rows) == [simulated, simulated, "reported"]
    rows[2]["ms"] = 18.0
    assert words(claims, rows) == [simulated, "undecided", "reported"]
    nobody = [row | {"ms": None} for row in rows]
    assert words(claims, nobody) == ["not applicable", "not applicable", "not applicable"]


def test_table_2_5_without_a_renderer_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    from manip3d import RenderError, viewer
    from manip3d.experiments import table_2_5

    def fail(*_: Any, **__: Any) -> None:
        raise RenderError("no browser")

    monkeypatch.setattr(viewer, "frame_times", fail)
    case = table_2_5._case(1, "QEM_4VR", "chromium", Plan(data="simulated", scale="quick"))
    case.options["scene"][0].update({"mesh": "airplane", "simulated_faces": 9000})
    row = table_2_5.draw(case)
    assert row["ms"] is None
    assert row["driver"] == "none: no browser"
    assert row["polygons"] in (6796, 6797, 6795, 6794)
