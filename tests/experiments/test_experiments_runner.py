"""The runner: every case stored once, resumed only while nothing it depends on has changed."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from manip3d import InputError, datasets
from manip3d.experiments import (
    Case,
    Claim,
    Finding,
    Plan,
    Store,
    Verdict,
    counted,
    pack_mesh,
    published_rows,
    run,
    unpack_mesh,
)
from manip3d.experiments import _environment as environment_module
from manip3d.experiments._runner import _strict
from manip3d.report import write_report
from toy_experiments import TRIANGLE, all_below, count_faces, experiment

TESTS = Path(__file__).parents[1]


def runs(log: Path) -> list[int]:
    return sorted(map(int, log.read_text().split())) if log.exists() else []


def rows(folder: Path, name: str = "toy") -> list[dict]:
    return json.loads((folder / "results.json").read_text())["experiments"][name]["rows"]


def test_results_hold_rows_environment_and_plan(tmp_path: Path) -> None:
    summary = run([experiment(2, 3)], tmp_path, plan=Plan(seed=7), jobs=1)

    results = json.loads((tmp_path / "results.json").read_text())
    assert [row["square"] for row in rows(tmp_path)] == [4, 9]
    assert results["plan"] == {"data": "auto", "scale": "full", "seed": 7}
    environment = results["environment"]
    assert environment["jobs"] == 1
    assert {"manip3d", "code", "date", "cpu", "cores", "os", "python", "libraries"} <= set(
        environment
    )
    assert results["wall_time_s"] >= 0
    assert (summary.cases, summary.resumed, summary.failed) == (2, 0, 0)
    header, *lines = (tmp_path / "results.csv").read_text().splitlines()
    assert "square" in header.split(",")
    assert len(lines) == 2


def test_meshes_are_stored_beside_the_row(tmp_path: Path) -> None:
    run([experiment(2)], tmp_path, jobs=1)
    stored = (tmp_path / rows(tmp_path)[0]["simplified"]).read_bytes()
    mesh = unpack_mesh(stored, like=TRIANGLE)
    assert np.array_equal(mesh.vertices, TRIANGLE.vertices)
    assert np.array_equal(mesh.faces, TRIANGLE.faces)


def npz_of(**arrays: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def npy_of(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"garbage",
        pack_mesh(TRIANGLE)[:-30],
        npz_of(vertices=np.eye(3)).replace(b"NUMPY", b"NOMPY"),
        npy_of(np.eye(3)),
        npz_of(vertices=np.eye(3)),
    ],
)
def test_bytes_of_no_mesh_are_refused(data: bytes) -> None:
    with pytest.raises(InputError, match="data: expected"):
        unpack_mesh(data, like=TRIANGLE)


def test_a_single_array_is_refused_by_its_name() -> None:
    with pytest.raises(InputError, match=r"^data: expected .*, got others: a single array$"):
        unpack_mesh(npy_of(np.eye(3)), like=TRIANGLE)


def test_an_archive_gives_the_arrays_of_a_mesh_only() -> None:
    data = npz_of(vertices=TRIANGLE.vertices, faces=TRIANGLE.faces, source=np.array("other"))
    found = unpack_mesh(data, like=TRIANGLE)
    assert (found.num_faces, found.source) == (TRIANGLE.num_faces, TRIANGLE.source)


def test_published_rows_cannot_be_changed() -> None:
    first = published_rows("table_6_1_lidar_forensics")[0]
    with pytest.raises(TypeError):
        first["II_forged"] = "99"  # type: ignore[index]


def test_parallel_equals_serial_bit_for_bit(tmp_path: Path) -> None:
    toy = experiment(1, 2, 3, 4, 5)
    run([toy], tmp_path / "serial", jobs=1)
    run([toy], tmp_path / "parallel", jobs=2)
    assert rows(tmp_path / "serial") == rows(tmp_path / "parallel")
    for name in ("cases", "files"):
        serial = {p.name: p.read_bytes() for p in (tmp_path / "serial" / name).iterdir()}
        parallel = {p.name: p.read_bytes() for p in (tmp_path / "parallel" / name).iterdir()}
        assert serial == parallel


def test_resuming_runs_only_what_is_absent(tmp_path: Path) -> None:
    log = tmp_path / "log"
    run([experiment(1, 2, log=str(log))], tmp_path / "out", jobs=1)
    summary = run([experiment(1, 2, 3, log=str(log))], tmp_path / "out", jobs=1)
    assert runs(log) == [1, 2, 3]
    assert summary.resumed == 2
    assert rows(tmp_path / "out")[0]["pair"] == [1, 1]


def test_overwriting_runs_all_again_and_replaces_them(tmp_path: Path) -> None:
    log = tmp_path / "log"
    toy = experiment(1, 2, log=str(log))
    run([toy], tmp_path / "out", jobs=1)
    stored = sorted((tmp_path / "out" / "cases").iterdir())
    before = [path.stat().st_ino for path in stored]
    assert run([toy], tmp_path / "out", jobs=1, overwrite=True).resumed == 0
    assert log.read_text().split() == ["1", "2", "1", "2"]
    assert sorted((tmp_path / "out" / "cases").iterdir()) == stored
    assert all(path.stat().st_ino != old for path, old in zip(stored, before, strict=True))
    assert run([toy], tmp_path / "out", jobs=1).resumed == 2


def test_changed_options_run_again(tmp_path: Path) -> None:
    log = tmp_path / "log"
    toy = experiment(1, 2, log=str(log))
    run([toy], tmp_path / "out", plan=Plan(seed=0), jobs=1)
    run([toy], tmp_path / "out", plan=Plan(seed=1), jobs=1)
    assert runs(log) == [1, 1, 2, 2]


def test_changed_code_runs_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log"
    toy = experiment(1, log=str(log))
    run([toy], tmp_path / "out", jobs=1)
    monkeypatch.setattr("manip3d.experiments._runner.code_fingerprint", lambda: "another build")
    run([toy], tmp_path / "out", jobs=1)
    assert runs(log) == [1, 1]


def test_code_fingerprint_covers_the_binary_and_the_sources() -> None:
    first = environment_module.code_fingerprint()
    assert first.startswith("0.")
    assert first == environment_module.code_fingerprint()


@pytest.mark.parametrize("victim", ["cases", "files"])
@pytest.mark.parametrize("damage", ["truncate", "flip", "empty"])
def test_damaged_results_are_not_resumed(tmp_path: Path, victim: str, damage: str) -> None:
    log = tmp_path / "log"
    toy = experiment(5, log=str(log))
    run([toy], tmp_path / "out", jobs=1)
    before = rows(tmp_path / "out")
    path = next((tmp_path / "out" / victim).iterdir())
    data = bytearray(path.read_bytes())
    if damage == "truncate":
        del data[len(data) // 2 :]
    elif damage == "empty":
        data.clear()
    else:
        at = data.index(b"25") if victim == "cases" else len(data) // 2
        data[at] ^= 1
    path.write_bytes(data)

    assert run([toy], tmp_path / "out", jobs=1).resumed == 0
    assert runs(log) == [5, 5]
    assert rows(tmp_path / "out") == before


def test_shared_cases_run_once(tmp_path: Path) -> None:
    log = tmp_path / "log"
    first = experiment(1, 2, name="first", log=str(log))
    second = experiment(2, 3, name="second", log=str(log))
    assert run([first, second], tmp_path / "out", jobs=1).cases == 3
    assert runs(log) == [1, 2, 3]
    assert [row["experiment"] for row in rows(tmp_path / "out", "second")] == ["second"] * 2


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_failing_case_is_recorded_and_tried_again(tmp_path: Path, jobs: int) -> None:
    toy = experiment(1, 2, 3, fail=2, claims=[all_below(100)])
    summary = run([toy], tmp_path, jobs=jobs)
    assert summary.failed == 1
    errors = [row["error"] for row in rows(tmp_path)]
    assert errors == ["", "ValueError: no square for 2 today", ""]
    assert run([toy], tmp_path, jobs=1).resumed == 2
    verdict = summary.results["experiments"]["toy"]["verdicts"][0]
    assert (verdict["word"], verdict["unjudged"]) == ("not judged", "1 case failed")
    told = {finding["subject"]: finding["holds"] for finding in verdict["findings"]}
    assert told == {"n1": True, "n3": True, "n2 square": None}


def test_a_damaged_file_of_data_fails_only_the_cases_that_read_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MANIP3D_DATA", str(tmp_path / "data"))
    path = tmp_path / "data" / datasets.get("rockerArm").files[0].path
    path.parent.mkdir(parents=True)
    path.touch()
    reads = Case(count_faces, {"model": "rockerArm"}, inputs=("rockerArm",))
    both = dataclasses.replace(
        experiment(2), cases=lambda plan: [reads, *experiment(2).cases(plan)]
    )
    summary = run([both], tmp_path / "results", jobs=1)
    assert (summary.cases, summary.failed) == (2, 1)
    damaged, sound = rows(tmp_path / "results")
    assert "the file is damaged" in damaged["error"]
    assert sound["square"] == 4


def test_a_case_that_kills_its_process_fails_alone(tmp_path: Path) -> None:
    summary = run([experiment(1, 2, 3, die=2)], tmp_path, jobs=2)
    assert summary.failed == 1
    errors = [row["error"] for row in rows(tmp_path)]
    assert errors[0] == errors[2] == ""
    assert "process" in errors[1]


def test_progress_ends_at_one(tmp_path: Path) -> None:
    seen: list[tuple[float, str]] = []
    run([experiment(1, 2)], tmp_path, jobs=1, progress=lambda f, m: seen.append((f, m)))
    assert seen == [(0.5, "n1 square"), (1.0, "n2 square")]


def test_interruption_keeps_finished_cases_and_is_quick(tmp_path: Path) -> None:
    code = f"""
import sys
from pathlib import Path
from manip3d.experiments import run
from toy_experiments import experiment
if __name__ == "__main__":
    try:
        slow = experiment(2, name="slow", seconds=60)
        run([experiment(1), slow], Path({str(tmp_path)!r}), jobs=2)
    except KeyboardInterrupt:
        sys.exit(130)
"""
    script = tmp_path / "interrupted.py"
    script.write_text(code)
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(TESTS)])}
    process = subprocess.Popen([sys.executable, str(script)], env=environment)
    deadline = time.monotonic() + 60
    while not list((tmp_path / "cases").glob("[!.]*.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=30) == 130  # the slow case would take twice as long
    assert len(list((tmp_path / "cases").glob("[!.]*.json"))) == 1
    assert run([experiment(1)], tmp_path, jobs=1).resumed == 1


def test_dask_gives_the_same_rows(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra 'dask' is not installed")
    toy = experiment(1, 2)
    run([toy], tmp_path / "serial", jobs=1)
    run([toy], tmp_path / "dask", jobs=2, dask="local")
    assert rows(tmp_path / "serial") == rows(tmp_path / "dask")


def test_negative_jobs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="jobs: expected >= 0, got -1"):
        run([experiment(1)], tmp_path, jobs=-1)


def test_a_false_claim_is_reported_false(tmp_path: Path) -> None:
    toy = experiment(1, 2, 3, claims=[all_below(10), all_below(9)])
    first, second = run([toy], tmp_path, jobs=1).results["experiments"]["toy"]["verdicts"]
    assert first["word"] == "holds"
    assert second["word"] == "does not hold"
    assert [f["holds"] for f in second["findings"]] == [True, True, False]
    assert second["findings"][2]["numbers"] == "9"


@pytest.mark.parametrize(
    ("holds", "word"),
    [
        ([], "not applicable"),
        ([None], "not applicable"),
        ([None, True], "holds"),
        ([True, False, None], "does not hold"),
    ],
)
def test_verdict_is_the_worst_applicable_finding(holds: list[bool | None], word: str) -> None:
    findings = tuple(Finding(str(i), value, "") for i, value in enumerate(holds))
    assert Verdict("claim", "source", findings).word == word


def test_rows_say_what_they_were_measured_on(tmp_path: Path) -> None:
    run([experiment(1, data="stand-in", role="a triangle"), experiment(2, name="other")], tmp_path,
        jobs=1)  # fmt: skip
    (first,), (second,) = rows(tmp_path), rows(tmp_path, "other")
    assert (first["data"], first["role"]) == ("stand-in", "a triangle")
    assert (second["data"], second["role"]) == ("simulated", "simulated")


def test_each_kind_of_data_is_judged_apart() -> None:
    def judge(rows):
        yield Finding("least", min(row["x"] for row in rows) < 2, "")

    rows = [
        {"model": "a", "data": "published", "x": 3},
        {"model": "b", "data": "simulated", "x": 1},
    ]
    verdict = Claim("text", "source", judge).verdict(rows)
    assert [(f.data, f.holds) for f in verdict.findings] == [
        ("published", False),
        ("simulated", True),
    ]
    together = Claim("text", "source", judge, together=True).verdict(rows)
    assert [(f.data, f.holds) for f in together.findings] == [("published, simulated", True)]
    only = Claim("text", "source", judge, data=("published",)).verdict(rows[1:])
    assert only.word == "undecided"
    assert "only the published file can judge this" in only.findings[0].unjudged


@pytest.mark.parametrize(
    ("source", "data", "word"),
    [
        ("table 1", "published", "does not hold"),
        ("table 1", "stand-in", "undecided"),
        ("table 1", "simulated", "undecided"),
        ("aim", "simulated", "does not hold"),
        ("aim", "recorded", "does not hold"),
    ],
)
def test_a_stand_in_cannot_refute_what_was_said_of_another_file(
    source: str, data: str, word: str
) -> None:
    claim = dataclasses.replace(all_below(2), source=source)
    rows = [
        {"model": "a", "data": data, "square": 4, "error": ""},
        {"model": "b", "data": "published", "square": 1, "error": ""},
    ]
    assert claim.verdict(rows).word == word
    assert claim.verdict(rows).holds is False
    assert claim.verdict(rows[1:]).word == "holds"


@pytest.mark.parametrize(
    ("source", "data", "word"),
    [
        ("table 1", ["published"], "holds"),
        ("table 1", ["published", "simulated"], "holds"),
        ("table 1", ["simulated"], "holds on simulated data"),
        ("table 1", ["stand-in"], "holds on stand-ins"),
        ("table 1", ["simulated", "recorded"], "holds on recorded data and simulated data"),
        ("aim", ["simulated"], "holds"),
    ],
)
def test_a_published_claim_says_on_which_other_data_it_holds(
    source: str, data: list[str], word: str
) -> None:
    claim = dataclasses.replace(all_below(9), source=source)
    rows = [{"model": kind, "data": kind, "square": 4, "error": ""} for kind in data]
    assert claim.verdict(rows).word == word
    assert claim.verdict(rows).holds is True


def test_what_could_not_be_judged_does_not_hold() -> None:
    def found(*holds: bool | None, data: str = "published") -> tuple[Finding, ...]:
        return tuple(
            Finding("", each, "", data, unjudged="too few" if each is None else "")
            for each in holds
        )

    def verdict(*findings: Finding) -> Verdict:
        return Verdict("claim", "table 1", findings)

    assert verdict(*found(True, None)).word == "undecided"
    assert verdict(*found(True, None)).holds is None
    assert verdict(*found(False, None)).word == "does not hold"
    assert verdict(*found(None)).word == "undecided"
    assert dataclasses.replace(verdict(*found(None)), reported=True).word == "reported"
    # Another kind of data that cannot judge takes nothing away from the published files.
    assert verdict(*found(True), *found(None, data="simulated")).word == "holds"
    some = verdict(*found(None), *found(True, data="simulated"))
    assert (some.word, some.judged_on) == ("holds on simulated data", ("simulated",))


def test_each_kind_of_data_is_named_once() -> None:
    """Several kinds of one finding were one name, "published, stand-in"."""
    findings = [Finding("", True, "", data) for data in ("published, stand-in", "published")]
    verdict = Verdict("claim", "table 1", tuple(findings))
    assert (verdict.word, verdict.judged_on) == ("holds", ("published", "stand-in"))
    worse = Verdict("claim", "table 1", (*findings, Finding("", False, "", "published")))
    assert (worse.word, worse.judged_on) == ("does not hold", ("published", "stand-in"))


def test_a_judge_may_name_a_kind_of_data_of_its_own() -> None:
    """It was a KeyError, after which the run wrote no results."""
    findings = (Finding("", True, "", "simulated, phantoms"),)
    assert Verdict("claim", "table 1", findings).word == "holds on simulated data and phantoms"


def test_a_claim_is_not_judged_for_failures_of_others() -> None:
    claim = all_below(10)
    mine = dataclasses.replace(claim, about=lambda row: row["kind"] == "a")
    rows = [
        {"model": "a", "kind": "a", "square": 1, "error": ""},
        {"model": "b", "kind": "b", "error": "broken"},
    ]
    assert mine.verdict(rows).word == "holds"
    assert claim.verdict(rows).word == "not judged"


def test_a_broken_judge_figure_or_note_does_not_end_the_run(tmp_path: Path) -> None:
    def fail(rows):
        raise KeyError("nothing here")

    toy = dataclasses.replace(
        experiment(1, claims=[Claim("broken", "test", fail), all_below(9)]),
        figures=fail,
        notes=("a note", fail),
    )
    summary = run([toy], tmp_path, jobs=1)
    record = summary.results["experiments"]["toy"]
    assert [v["word"] for v in record["verdicts"]] == ["not judged", "holds"]
    assert record["notes"] == ["a note"]
    assert record["figures"] == {}
    assert summary.failed == 0
    assert len(summary.problems) == 3
    assert all("KeyError" in problem for problem in summary.problems)


def test_notes_are_functions_of_the_rows(tmp_path: Path) -> None:
    toy = dataclasses.replace(
        experiment(1, 2, fail=2), notes=(lambda rows: f"{len(rows)} measured", lambda rows: "")
    )
    assert run([toy], tmp_path, jobs=1).results["experiments"]["toy"]["notes"] == ["1 measured"]


def test_csv_has_one_value_a_cell(tmp_path: Path) -> None:
    run([experiment(1, 2)], tmp_path, jobs=1)
    header, *lines = csv.reader((tmp_path / "results.csv").read_text().splitlines())
    assert "square" in header
    assert "pair" not in header
    assert not any(cell.startswith(("[", "{")) for line in lines for cell in line)


@pytest.mark.parametrize(
    ("number", "text"), [(0, "0 faces"), (1, "1 face"), (2, "2 faces"), (1234, "1\u202f234 faces")]
)
def test_a_number_with_its_noun(number: int, text: str) -> None:
    assert counted(number, "face") == text
    assert counted(1, "entry", "entries") == "1 entry"
    assert counted(3, "entry", "entries") == "3 entries"


def test_store_ignores_foreign_files(tmp_path: Path) -> None:
    (tmp_path / "cases").mkdir()
    (tmp_path / "cases" / "abc.json").write_text('{"key": "abc", "row": {}, "files": {}}')
    (tmp_path / "cases" / "list.json").write_text("[]")
    store = Store(tmp_path)
    assert store.load("abc") is None
    assert store.load("list") is None
    assert store.load("absent") is None


def test_what_numpy_computes_in_a_claim_is_stored() -> None:
    found = _strict({"holds": np.bool_(True), "numbers": [np.float64("nan"), np.int32(3)]})
    assert json.loads(json.dumps(found, allow_nan=False)) == {"holds": True, "numbers": ["nan", 3]}


def test_results_of_other_experiments_are_kept(tmp_path: Path) -> None:
    """They were replaced without a word."""
    first = run([experiment(1, 2, name="first")], tmp_path, jobs=1)
    second = run([experiment(3, name="second")], tmp_path, jobs=1)
    assert (first.kept, second.kept, second.dropped) == ([], ["first"], [])
    assert list(second.results["experiments"]) == ["second"]
    results = json.loads((tmp_path / "results.json").read_text())
    assert list(results["experiments"]) == ["first", "second"]
    assert [row["square"] for row in rows(tmp_path, "first")] == [1, 4]
    with (tmp_path / "results.csv").open(newline="", encoding="utf-8-sig") as stream:
        assert [row["square"] for row in csv.DictReader(stream)] == ["1", "4", "9"]
    write_report(tmp_path, tmp_path / "page.md")
    assert {"## first", "## second"} <= {
        line.partition(":")[0] for line in (tmp_path / "page.md").read_text().splitlines()
    }


def test_results_of_another_plan_are_named_when_they_are_replaced(tmp_path: Path) -> None:
    run([experiment(1, name="first")], tmp_path, jobs=1)
    other = run([experiment(3, name="second")], tmp_path, plan=Plan(seed=5), jobs=1)
    assert (other.kept, other.dropped) == ([], ["first"])
    assert list(json.loads((tmp_path / "results.json").read_text())["experiments"]) == ["second"]


def test_results_of_the_previous_format_are_named_when_they_are_replaced(tmp_path: Path) -> None:
    """They have no environments, and were replaced without a word."""
    run([experiment(1, name="first")], tmp_path, jobs=1)
    summary = tmp_path / "results.json"
    results = json.loads(summary.read_text())
    del results["environments"], results["experiments"]["first"]["environments"]
    summary.write_text(json.dumps(results | {"format": 2}))
    other = run([experiment(3, name="second")], tmp_path, jobs=1)
    assert (other.kept, other.dropped) == ([], ["first"])
    assert list(json.loads(summary.read_text())["experiments"]) == ["second"]


@pytest.mark.parametrize("damage", ["{", "[]", '{"experiments": {"a": {"rows": [1]}}, "data": []}'])
def test_a_damaged_summary_of_results_is_replaced(tmp_path: Path, damage: str) -> None:
    (tmp_path / "results.json").write_text(damage)
    run([experiment(3)], tmp_path, jobs=1)
    assert [row["square"] for row in rows(tmp_path)] == [9]


def test_simulations_are_no_real_data(tmp_path: Path) -> None:
    simulated, recorded = experiment(1), experiment(2, name="recorded", data="recorded")
    done = run([simulated, recorded], tmp_path, plan=Plan(data="real"), jobs=1)
    assert (done.skipped, done.experiments) == (["toy"], ["recorded"])
    with pytest.raises(InputError, match="data: expected an experiment with real data, got toy"):
        run([simulated], tmp_path, plan=Plan(data="real"), jobs=1)
    real = experiment(name="real only")  # has no cases without data
    claim = Claim("some", "aim", lambda rows: [Finding("all", True, "")])
    real = replace(real, claims=(claim,))
    done = run([recorded, real], tmp_path, jobs=1)
    assert (done.skipped, done.experiments, done.problems) == (["real only"], ["recorded"], [])
    with pytest.raises(InputError, match="data: expected an experiment with simulated data, got r"):
        run([real], tmp_path, plan=Plan(data="simulated"), jobs=1)
    assert list(json.loads((tmp_path / "results.json").read_text())["experiments"]) == ["recorded"]
