"""The JND study in a real browser: two meshes turn round, and the better one is chosen."""

from __future__ import annotations

import csv
from collections.abc import Iterator
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


IN_A_TURN = """
    const table = manip3dStudy.turntable();
    const row = document.querySelector('#stimuli');
    const panes = [...row.querySelectorAll('.stimulus')];
    const addresses = manip3dStudy.step().stimuli.map(({ address }) => address);
    const after = (ms) => new Promise((done) => setTimeout(done, ms));
"""


@pytest.fixture(scope="module")
def turning(chromium: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_chromium.Tab]:
    """A page whose meshes have turned round."""
    pytest.importorskip("scipy")
    folder_of_test = tmp_path_factory.mktemp("turning")
    file = small(folder_of_test, turn_s=0.1)
    make_stimuli(file)
    study, content = read_study(file)
    with (
        StudyFolder(folder_of_test / "answers", content) as folder,
        served(study, folder) as server,
        _chromium.open_address(server.new_url(), (960, 700)) as tab,
    ):
        person = Participant(tab)
        person.begin("P1")
        seen = ""
        while not seen.startswith("t"):
            step = person.next_step(seen)
            assert step is not None
            seen = step["id"]
            if not seen.startswith("t"):
                person.answer(plain_answer(step))
        yield tab


def in_turn(tab: _chromium.Tab, script: str) -> Any:
    """Run a script that has the turntable and its stimuli; return what it returns."""
    return tab.evaluate(f"(async () => {{ {IN_A_TURN} {script} }})()")


def test_a_turn_that_is_stopped_ends(turning: _chromium.Tab) -> None:
    script = """
        const shown = table.show(row, panes, addresses, 600).then(() => "ended");
        while (!(table.angle > 0)) await after(5);
        table.stop();
        return await Promise.race([shown, after(5000).then(() => "waits")]);
    """
    assert in_turn(turning, script) == "ended"


def test_an_outdated_show_is_not_shown(turning: _chromium.Tab) -> None:
    script = """
        const first = table.show(row, panes, addresses, 600);
        const second = table.show(row, panes, addresses, 0);
        await Promise.all([first, second]);
        return [table.angle, table.stage.models.length];
    """
    angle, models = in_turn(turning, script)
    assert abs(angle - 6.2832) < 1e-3
    assert models == 2


def test_a_mesh_that_cannot_be_loaded_is_named(turning: _chromium.Tab) -> None:
    script = """
        return await table.show(row, panes, [addresses[0], "/stimulus/nowhere"], 0)
            .then(() => "shown", (error) => error.message);
    """
    assert in_turn(turning, script).startswith("/stimulus/nowhere: 404")


def test_what_models_share_is_released_once(turning: _chromium.Tab) -> None:
    script = """
        await table.show(row, panes, addresses, 0);
        const counts = { texture: 0, material: 0, geometry: 0 };
        const held = (name, about) => ({ dispose: () => (counts[name] += 1), ...about });
        const texture = held("texture", { isTexture: true });
        const material = held("material", { map: texture, normalMap: texture });
        const node = { geometry: held("geometry"), material: [material, material], userData: {} };
        const root = { traverse: (visit) => [node, node].forEach(visit) };
        table.stage.models = [{ root }, { root }];
        await table.show(row, panes, addresses, 0);
        return counts;
    """
    assert in_turn(turning, script) == {"texture": 1, "material": 1, "geometry": 1}


def test_a_turntable_that_is_stopped_does_not_follow_the_window(turning: _chromium.Tab) -> None:
    script = """
        await table.show(row, panes, addresses, 0);
        const resize = table.stage.resize;
        let resized = 0;
        table.stage.resize = () => (resized += 1);
        dispatchEvent(new Event("resize"));
        table.stop();
        dispatchEvent(new Event("resize"));
        table.stage.resize = resize;
        return resized;
    """
    assert in_turn(turning, script) == 1


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
