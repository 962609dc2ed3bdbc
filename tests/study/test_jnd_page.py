"""The JND study in a real browser: two meshes turn round, and the better one is chosen."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")

from browser import Participant, plain_answer, served
from test_jnd import small

from manip3d.study import (
    JndStudy,
    StudyFolder,
    make_stimuli,
    px_per_degree,
    read_study,
    study_of,
    write_results,
)
from manip3d.viewer import _chromium


def test_a_turn_ends_in_a_window_that_others_cover(chromium: None, tmp_path: Path) -> None:
    """The browser draws no pictures there; the participant can answer all the same."""
    pytest.importorskip("scipy")
    file = small(tmp_path, turn_s=0.3)
    make_stimuli(file)
    study, content = read_study(file)
    with (
        StudyFolder(tmp_path / "answers", content) as folder,
        served(study, folder) as server,
        _chromium.open_address(server.new_url(), (960, 700)) as tab,
    ):
        person = Participant(tab)
        person.begin("P1")
        tab.evaluate("window.requestAnimationFrame = () => 0")
        seen = ""
        while not seen.startswith("t"):
            step = person.next_step(seen)
            assert step is not None
            seen = step["id"]
            if not seen.startswith("t"):
                person.answer(plain_answer(step))
        assert abs(tab.evaluate("manip3dStudy.turn()") - 6.2832) < 1e-3


@pytest.mark.slow
def test_from_consent_to_csv(chromium: None, tmp_path: Path) -> None:
    pytest.importorskip("scipy")
    file = small(tmp_path, turn_s=0.3)
    make_stimuli(file)
    study, content = read_study(file)
    assert isinstance(study, JndStudy)
    with StudyFolder(tmp_path / "answers", content) as folder:
        with (
            served(study, folder) as server,
            _chromium.open_address(server.new_url(), (960, 700)) as tab,
        ):
            person = Participant(tab)
            person.begin("P1")
            turned, widths = [], []

            def choose(step: dict[str, Any]) -> dict[str, str]:
                if not step["id"].startswith("t"):
                    return plain_answer(step)
                turned.append(tab.evaluate("manip3dStudy.turn()"))
                widths.append(step["width_px"])
                # Somebody who sees the larger differences alone.
                truth = study.step(folder.sessions["P1"])
                assert truth is not None
                original = str(truth.condition["original"])
                if truth.condition["difference_percent"] > 20:
                    return {"chosen": original}
                return {"chosen": {"left": "right", "right": "left"}[original]}

            seen = person.answer_all(choose)
            assert set(server.refused) <= {"not found"}
        assert seen[:4] == ["consent", "about", "introduction", "screen"]
        assert all(abs(angle - 6.2832) < 1e-3 for angle in turned)  # once round before the answer
        expected = study.size_deg * px_per_degree(330.0, 55.0)
        assert all(abs(width - expected) < 0.01 for width in widths)
        results = write_results(study_of(folder.definition), folder, tmp_path / "results")
    with (results / "answers.csv").open(newline="", encoding="utf-8-sig") as stream:
        rows = [row for row in csv.DictReader(stream) if row["question"] == "chosen"]
    assert len(rows) == len(turned)
    assert all(abs(float(row["shown_deg"]) - study.size_deg) < 0.1 for row in rows)
    assert all(float(row["elapsed_ms"]) < 60_000 for row in rows)
    with (results / "summary.csv").open(newline="", encoding="utf-8-sig") as stream:
        thresholds = [float(r["jnd_percent"]) for r in csv.DictReader(stream) if r["participant"]]
    assert len(thresholds) == 2
    assert all(10.0 < threshold < 40.0 for threshold in thresholds)
