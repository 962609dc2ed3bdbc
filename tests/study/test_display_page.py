"""The displays study in a real browser, from consent to CSV; and the engine's promises there."""

from __future__ import annotations

import asyncio
import csv
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")

from browser import Participant, plain_answer, served

from manip3d.study import (
    Answer,
    DisplayStudy,
    Session,
    StudyFolder,
    read_study,
    study_of,
    write_results,
    write_template,
)
from manip3d.viewer import _chromium
from waiting import wait_for


@pytest.fixture
def definition(tmp_path: Path) -> Path:
    file = write_template("display", tmp_path / "study.toml", example=True)
    text = file.read_text().replace("familiarisation_s = 1\n", "familiarisation_s = 0.3\n")
    file.write_text(text)
    return file


def rows_of(file: Path) -> list[dict[str, str]]:
    with file.open(newline="", encoding="utf-8-sig") as stream:
        return list(csv.DictReader(stream))


def test_from_consent_to_csv(chromium: None, definition: Path, tmp_path: Path) -> None:
    study, content = read_study(definition)
    assert isinstance(study, DisplayStudy)
    with StudyFolder(tmp_path / "answers", content) as folder:
        with (
            served(study, folder) as server,
            _chromium.open_address(server.new_url(), (1280, 900)) as tab,
        ):
            person = Participant(tab)
            person.begin("P1")
            person.next_step()
            # Screen readers say what is new, and the tabulator key does not begin at the address.
            assert tab.evaluate("document.activeElement.textContent") == "Consent"
            seen = person.answer_all(plain_answer)
            assert seen[:3] == ["consent", "about", "introduction"]
            assert seen[3:8] == [
                "d1_familiarisation",
                "d1_task",
                "d1_part1",
                "d1_part2",
                "d1_part3",
            ]
            assert len(seen) == 3 + 3 * 5 + 1
            assert dict(server.refused) == {}
        results = write_results(study_of(folder.definition), folder, tmp_path / "results")

    (row,) = rows_of(results / "participants.csv")
    assert (row["record_id"], row["state"], row["group"], row["age"]) == (
        "P1",
        "finished",
        "1",
        "30.0",
    )
    scales = [name for name in row if name.startswith("d1_") and name != "d1_session"]
    assert len(scales) == 13
    assert {row[name] for name in scales} == {"2"}
    assert sorted(row[f"d{n}_session"] for n in (1, 2, 3)) == ["1", "2", "3"]
    assert row["positive"] == 'edges of the person, "quoted"\nand ä'
    dictionary = rows_of(results / "redcap_dictionary.csv")
    assert [entry["Variable / Field Name"] for entry in dictionary] == list(row)
    answers = rows_of(results / "answers.csv")
    assert len([a for a in answers if a["step"].startswith("d2_part")]) == 13
    waited = next(a for a in answers if a["step"] == "d1_familiarisation")
    assert float(waited["elapsed_ms"]) >= 300
    assert "100.0 % agreed; published 92.59 %" in (results / "summary.html").read_text()


def test_a_killed_server_and_a_reloaded_page_lose_nothing(
    chromium: None, definition: Path, tmp_path: Path
) -> None:
    study, content = read_study(definition)
    answers = tmp_path / "answers"
    with StudyFolder(answers, content) as folder, served(study, folder) as server:
        with _chromium.open_address(server.new_url(), (420, 900)) as tab:
            person = Participant(tab)
            person.begin("P1")
            for step in ("consent", "about"):
                found = person.next_step()
                assert found is not None
                assert found["id"] == step
                person.answer(plain_answer(found))
                wait_for(lambda step=step: folder.sessions["P1"].answer(step))
            tab.send("Page.reload")
            found = person.next_step("about")
            assert found is not None
            assert found["id"] == "introduction"
        port = server.port
    kept = (answers / "participants" / "P1.jsonl").read_bytes()
    # The last answer was cut off in the middle, as by a loss of power: it was never acknowledged.
    (answers / "participants" / "P1.jsonl").write_bytes(kept + b'00000000 {"step": "introd')
    with StudyFolder(answers, content) as folder, served(study, folder, port) as server:
        assert [a.step for a in folder.sessions["P1"].answers] == ["consent", "about"]
        with _chromium.open_address(server.new_url(), (420, 900)) as tab:
            narrow = {"width": 420, "height": 900, "deviceScaleFactor": 1, "mobile": False}
            tab.send("Emulation.setDeviceMetricsOverride", **narrow)
            person = Participant(tab)
            person.begin("P1")
            found = person.next_step()
            assert found is not None
            assert found["id"] == "introduction"
            assert tab.evaluate("document.documentElement.scrollWidth") <= 420
    assert (answers / "participants" / "P1.jsonl").read_bytes() == kept


def test_an_answer_waits_for_the_server_to_come_back(
    chromium: None, definition: Path, tmp_path: Path
) -> None:
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "answers", content) as folder, served(study, folder) as server:
        url = server.new_url()
        with _chromium.open_address(url, (800, 900)) as tab:
            person = Participant(tab)
            person.begin("P1")
            found = person.next_step()
            assert found is not None
            # The connection breaks before the answer arrives.
            tab.send("Network.enable")
            tab.evaluate(
                "window.kept = WebSocket.prototype.send; WebSocket.prototype.send = () => 0"
            )
            person.answer(plain_answer(found))
            assert tab.evaluate("manip3dStudy.pending()")
            assert folder.sessions["P1"].answers == []
            tab.evaluate("WebSocket.prototype.send = window.kept")
            loop = server._loop
            assert loop is not None
            for _, stream in tuple(server._clients.values()):
                asyncio.run_coroutine_threadsafe(stream.close(), loop)
            found = person.next_step("consent")
            assert found is not None
            assert found["id"] == "about"
            assert [a.step for a in folder.sessions["P1"].answers] == ["consent"]


def test_a_lost_connection_does_not_shorten_the_time_of_a_step(
    chromium: None, definition: Path, tmp_path: Path
) -> None:
    text = definition.read_text().replace("familiarisation_s = 0.3\n", "familiarisation_s = 4\n")
    definition.write_text(text)
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "answers", content) as folder, served(study, folder) as server:
        with _chromium.open_address(server.new_url(), (800, 900)) as tab:
            person = Participant(tab)
            person.begin("P1")
            last = ""
            for _ in range(3):  # consent, the person, the introduction
                found = person.next_step(last)
                assert found is not None
                last = found["id"]
                person.answer(plain_answer(found))
            shown = "manip3dStudy.step()?.id === 'd1_familiarisation'"
            wait_for(lambda: tab.evaluate(shown))
            loop = server._loop
            assert loop is not None
            for _, stream in tuple(server._clients.values()):
                asyncio.run_coroutine_threadsafe(stream.close(), loop)
            found = person.next_step(last)
            assert found is not None
            assert found["id"] == "d1_familiarisation"
            person.answer(plain_answer(found))
            answered = wait_for(lambda: folder.sessions["P1"].answer("d1_familiarisation"))
        assert answered.elapsed_ms >= 4000
        assert dict(server.refused) == {}


def test_who_could_not_be_stored_goes_on_when_the_disk_has_room(
    chromium: None, definition: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, content = read_study(definition)
    store, begin = StudyFolder.store, StudyFolder.begin
    refused: list[str] = []

    def full(self: StudyFolder, participant: str, answer: Answer) -> Answer:
        if "store" not in refused:
            refused.append("store")
            raise OSError(28, "No space left on device")
        return store(self, participant, answer)

    def full_at_first(self: StudyFolder, participant: str) -> Session:
        if "begin" not in refused:
            refused.append("begin")
            raise OSError(28, "No space left on device")
        return begin(self, participant)

    monkeypatch.setattr(StudyFolder, "store", full)
    monkeypatch.setattr(StudyFolder, "begin", full_at_first)
    with StudyFolder(tmp_path / "answers", content) as folder, served(study, folder) as server:
        with _chromium.open_address(server.new_url(), (800, 900)) as tab:
            person = Participant(tab)
            person.begin("P1")
            found = person.next_step()  # the page asks again by itself
            assert found is not None
            assert found["id"] == "consent"
            person.answer(plain_answer(found))
            told = "document.querySelector('#banner').innerText"
            wait_for(lambda: "could not be stored" in tab.evaluate(told), "the reason")
            found = person.next_step("consent")
            assert found is not None
            assert found["id"] == "about"
            assert tab.evaluate(told) == ""
        assert refused == ["begin", "store"]
        assert [a.step for a in folder.sessions["P1"].answers] == ["consent"]


def test_who_does_not_agree_is_asked_nothing(
    chromium: None, definition: Path, tmp_path: Path
) -> None:
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "answers", content) as folder:
        with (
            served(study, folder) as server,
            _chromium.open_address(server.new_url(), (420, 700)) as tab,
        ):
            person = Participant(tab)
            person.begin("../P1")  # the page's own check refuses it
            assert tab.evaluate("!!document.querySelector('[name=participant]')")
            person.begin("P1")
            assert person.next_step() is not None
            person.answer({"agree": "no"})
            assert person.next_step("consent") is None
            assert "did not agree" in tab.evaluate("document.querySelector('#end').innerText")
        results = write_results(study, folder, tmp_path / "results")
    assert rows_of(results / "participants.csv") == []
    assert rows_of(results / "answers.csv") == []


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(1, "1 second."), (30, "30 seconds."), (60, "1 minute."), (90, "1.5 minutes.")],
)
def test_a_time_is_said_in_words(definition: Path, seconds: int, text: str) -> None:
    file = definition.read_text().replace(
        "familiarisation_s = 0.3\n", f"familiarisation_s = {seconds}\n"
    )
    definition.write_text(file)
    study, _ = read_study(definition)
    assert isinstance(study, DisplayStudy)
    step = study.steps(Session("P1", 0))[0]
    assert step.text[0].endswith(text)
