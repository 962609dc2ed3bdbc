"""The rating in a real browser: images and animated clips, verdict and reason, to CSV."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")

from browser import Participant, plain_answer, served
from test_rating import folder_of, template

from manip3d import FormatError
from manip3d.study import Field, StudyFolder, read_study, study_of, write_results
from manip3d.viewer import _chromium
from waiting import wait_for


def test_from_consent_to_csv(chromium: None, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    items = [
        ("real", "color", "image", "full", "", "1"),
        ("real", "depth", "image", "full", "", "0"),
        ("type1", "color", "image", "full", "", "0"),
        ("type2", "rendered", "image", "full", "", "0"),
        ("type2", "color", "clip", "low", "still", "0"),
    ]
    folder = folder_of(tmp_path / "stimuli", items)
    clip = [image.new("RGB", (160, 90), (60 * n, 0, 0)) for n in range(3)]
    (folder / "s004.png").unlink()
    clip[0].save(folder / "s004.webp", save_all=True, append_images=clip[1:], duration=100, loop=0)
    listed = folder / "stimuli.csv"
    listed.write_text(listed.read_text().replace("s004.png", "s004.webp"))
    study, content = read_study(template(tmp_path, "any"))
    with StudyFolder(tmp_path / "answers", content) as answers:
        with (
            served(study, answers) as server,
            _chromium.open_address(server.new_url(), (1000, 900)) as tab,
        ):
            person = Participant(tab)
            person.begin("P1")
            sizes = []

            def choose(step: dict[str, Any]) -> dict[str, str]:
                if step["stimuli"]:
                    sizes.append(
                        tab.evaluate("document.querySelector('.stimulus img').naturalWidth")
                    )
                if any(f["name"] == "verdict" for f in step["fields"]):
                    return {"verdict": "undecidable", "reason": "=HYPERLINK(1)"}
                return plain_answer(step)

            seen = person.answer_all(choose)
            assert set(server.refused) <= {"not found"}
        assert seen[3] == "i000_example"
        assert sorted(seen[4:]) == ["i001", "i002", "i003", "i004"]
        assert sorted(sizes) == [40, 40, 40, 40, 160]
        results = write_results(study_of(answers.definition), answers, tmp_path / "results")
    with (results / "answers.csv").open(newline="", encoding="utf-8-sig") as stream:
        rows = list(csv.DictReader(stream))
    verdicts = [row for row in rows if row["question"] == "verdict"]
    assert [row["answer"] for row in verdicts] == ["undecidable"] * 4
    assert sum("truth=type2" in row["condition"] for row in verdicts) == 2
    # Typed text must not become a formula in a spreadsheet.
    assert {row["answer"] for row in rows if row["question"] == "reason"} == {"'=HYPERLINK(1)"}
    with (results / "summary.csv").open(newline="", encoding="utf-8-sig") as stream:
        low = [row for row in csv.DictReader(stream) if row["resolution"] == "low"]
    assert low[-1]["undecidable_percent"] == "100.0"
    assert low[-1]["published_unable_percent"] == "76.0"


def at_the_first_rating(person: Participant) -> str:
    """Go on to the first question of the study's own; return its id."""
    person.begin("P1")
    seen = ""
    while (step := person.next_step(seen)) is not None:
        if any(field["name"] == "verdict" for field in step["fields"]):
            return str(step["id"])
        person.answer(plain_answer(step))
        seen = step["id"]
    raise AssertionError("expected a rating")


def rating_with_reasons(place: Path) -> Path:
    folder_of(place / "stimuli", [("real", "color", "image", "full", "", "0")] * 2)
    file = template(place, "any")
    file.write_text(file.read_text().replace('reason = "optional"', 'reason = "required"'))
    return file


def test_spaces_are_no_reason_and_tabs_lock_nobody_out(chromium: None, tmp_path: Path) -> None:
    study, content = read_study(rating_with_reasons(tmp_path))
    with (
        StudyFolder(tmp_path / "answers", content) as answers,
        served(study, answers) as server,
        _chromium.open_address(server.new_url(), (1000, 900)) as tab,
    ):
        person = Participant(tab)
        first = at_the_first_rating(person)
        person.answer({"verdict": "real", "reason": "  \t\n "})
        assert not tab.evaluate("manip3dStudy.pending()")
        assert person.step() is not None
        # Copied from a table, with a line end of another system and an invisible sign.
        person.answer({"verdict": "real", "reason": "edges\tof\r\nthe\x1b person\ud83d"})
        second = person.next_step(first)
        assert second is not None
        long = "\U0001f600" * 1000  # 4000 bytes, with the rest more than most servers' messages
        person.answer({"verdict": "real", "reason": long})
        assert person.next_step(second["id"]) is None
        stored = [answers.sessions["P1"].answer(name) for name in (first, second["id"])]
        assert [a.values["reason"] for a in stored if a] == ["edges of\nthe  person", long]
        assert set(server.refused) <= {"not found"}


def test_a_refused_answer_can_be_mended(
    chromium: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, content = read_study(rating_with_reasons(tmp_path))
    read = Field.read

    def strict(field: Field, value: int | float | str) -> int | float | str | None:
        if value == "no reason":
            raise FormatError("reason: expected a reason")
        return read(field, value)

    monkeypatch.setattr(Field, "read", strict)
    with (
        StudyFolder(tmp_path / "answers", content) as answers,
        served(study, answers) as server,
        _chromium.open_address(server.new_url(), (1000, 900)) as tab,
    ):
        person = Participant(tab)
        first = at_the_first_rating(person)
        person.answer({"verdict": "real", "reason": "no reason"})
        said = "document.querySelector('#banner').innerText"
        wait_for(lambda: "reason: expected a reason" in tab.evaluate(said), "a refusal")
        step = wait_for(person.step, "the step, unlocked")
        assert step["id"] == first
        assert "not taken" in tab.evaluate(said)  # also after the page has connected again
        assert tab.evaluate("document.querySelector('textarea').value") == "no reason"
        person.answer({"reason": "its edges"})
        assert person.next_step(first) is not None
        assert tab.evaluate(said) == ""
        assert server.refused["bad message: reason: expected a reason"] == 1  # sent once
