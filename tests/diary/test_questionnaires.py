"""Questionnaires: files read strictly, scores by hand, copies that say what was asked."""

from __future__ import annotations

import functools
import json
import random
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

import command_line
from manip3d import FormatError, InputError
from manip3d.phantom._touch import STATEMENTS

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("cryptography", reason="the extra 'diary' is not installed")
pytest.importorskip("scipy", reason="the extra 'diary' is not installed")

from manip3d.diary import (
    MCGILL,
    OWNERSHIP,
    Diary,
    Questionnaire,
    QuestionnaireItem,
    QuestionnaireScale,
    export_csv,
    fhir_bundle,
    load_questionnaire,
    score_mcgill,
    write_page,
    write_questionnaire,
)

START = datetime(2026, 3, 2, 9, 0, tzinfo=timezone(timedelta(hours=1)))
SLEEP: dict[str, Any] = {
    "name": "Sleep & rest",
    "items": [
        {"text": "I slept well.", "low": 0, "high": 2, "choices": ["no", "a little", "yes"]},
        {"text": "I woke up at night.", "low": 1, "high": 5},
        {"text": "I was tired.", "low": -2, "high": 2},
    ],
    "scales": [
        {"name": "quality", "items": [1, 2, 3], "reverse": [2, 3]},
        {"name": "mean", "items": [1, 2], "method": "mean"},
        {"name": "marked", "items": [1, 2, 3], "method": "count"},
    ],
}


def saved(folder: Path, **changes: Any) -> Path:
    path = folder / "form.json"
    path.write_text(json.dumps(SLEEP | changes), encoding="utf-8-sig")  # as some editors write it
    return path


def test_scores_by_hand(tmp_path: Path) -> None:
    form = load_questionnaire(saved(tmp_path))
    # 2 + (1 + 5 - 4) + (-2 + 2 - 1), (2 + 4) / 2, and three answers above the smallest ones.
    assert form.score([2, 4, 1]) == {"quality": 3, "mean": 3.0, "marked": 3}
    assert form.score([0, 1, -2]) == {"quality": 7, "mean": 0.5, "marked": 0}
    assert form.items[0].choices == ("no", "a little", "yes")
    for answers, message in (
        ([1, 2], "answers: expected 3, got 2"),
        ([1, 6, 0], "answers: expected 1 to 5 for question 2, got 6"),
        ([1, 2, -3], "answers: expected -2 to 2 for question 3, got -3"),
        ([True, 2, 0], "answers"),
    ):
        with pytest.raises(InputError, match=message):
            form.score(answers)


def test_mcgill_is_an_instance_with_the_scores_of_before() -> None:
    chance = random.Random(7)
    for _ in range(50):
        ranks = [chance.randint(0, item.high) for item in MCGILL.items[:-1]]
        ppi = chance.randint(0, 5)
        score = score_mcgill(ranks, ppi)
        assert MCGILL.score([*ranks, ppi]) == vars(score)
        parts = [sum(ranks[a:b]) for a, b in ((0, 10), (10, 15), (15, 16), (16, 20))]
        assert [score.sensory, score.affective, score.evaluative, score.miscellaneous] == parts
        assert (score.pri, score.nwc) == (sum(parts), 20 - ranks.count(0))


def test_ownership_asks_what_the_touch_cue_asks() -> None:
    assert tuple(item.text for item in OWNERSHIP.items) == tuple(STATEMENTS)
    assert OWNERSHIP.scales[0].items == (1, 2, 3)
    assert OWNERSHIP.score([3, 2, 1, -3, 0, 0]) == {"ownership": 2.0, "control": -1.0}


def test_files_are_read_as_they_were_written(tmp_path: Path) -> None:
    tricky = Questionnaire(
        "sum",
        (QuestionnaireItem("sum", 0, 1, ("\u4e0d", "\u00e9")),),
        (QuestionnaireScale("sum", (1,)),),
    )
    for number, form in enumerate((MCGILL, OWNERSHIP, tricky)):
        path = tmp_path / f"{number}.json"
        write_questionnaire(form, path)
        assert load_questionnaire(path) == form
        assert load_questionnaire(path).sha256 == form.sha256
        with pytest.raises(FileExistsError):
            write_questionnaire(form, path)
    other = replace(OWNERSHIP, items=(replace(OWNERSHIP.items[0], text="x"), *OWNERSHIP.items[1:]))
    assert other.scores_like(OWNERSHIP)
    assert other.sha256 != OWNERSHIP.sha256
    assert not MCGILL.scores_like(OWNERSHIP)


def changed(place: str, number: int, **fields: Any) -> dict[str, Any]:
    parts = [dict(one) for one in SLEEP[place]]
    parts[number] |= fields
    return {place: parts}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": " "}, "name: expected a text of 1 to 200 characters"),
        ({"name": "a\x1b[31m"}, "name: expected a text"),
        ({"version": 1}, "questionnaire: expected no key 'version'"),
        ({"items": []}, "expected 1 to 500 items and at most 500 scales, got 0 and 3"),
        ({"items": {}}, "items: expected a list"),
        ({"items": [1]}, r"items\[1\]: expected an object, got 1"),
        ({"items": [{"text": "a", "low": 0}]}, r"items\[1\]: expected high, found none"),
        (changed("items", 1, unit="h"), r"items\[2\]: expected no key 'unit'"),
        (changed("items", 1, high=1), r"items\[2\]: expected whole numbers low < high"),
        (changed("items", 1, high=5.0), "expected whole numbers"),
        (changed("items", 1, high=1001), "expected whole numbers"),
        (changed("items", 1, low=False), "expected whole numbers"),
        (changed("items", 0, choices=["no", "yes"]), "each of the 3 answers, at most 101, got 2"),
        (changed("items", 0, choices="abc"), r"items\[1\].choices: expected a list"),
        (changed("items", 0, choices=["a", "b", 3]), r"choices: expected a text"),
        (changed("scales", 0, items=[1, 4]), r"scales\[1\].items: .* 1 to 3, got \[1, 4\]"),
        (changed("scales", 0, items=[0]), "numbers of questions, 1 to 3"),
        (changed("scales", 0, items=[1, 1], reverse=[]), "different numbers of questions"),
        (changed("scales", 0, items=[]), "at least one question"),
        (changed("scales", 0, items=[[]]), "different numbers of questions"),
        (changed("scales", 1, reverse=[3]), "reverse only its own"),
        (changed("scales", 1, method="median"), "method: expected sum, mean, count"),
        (changed("scales", 1, name="quality"), "scales: expected names that differ"),
    ],
)
def test_files_that_are_none(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = saved(tmp_path, **changes)
    with pytest.raises(FormatError, match=message) as refused:
        load_questionnaire(path)
    assert refused.value.file == str(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"name": "a", "name": "b"}', "each key of an object once"),
        ('{"name": NaN}', "expected numbers, got NaN"),
        ("[" * 100_000, "expected JSON"),
        ("1" * 5000, "expected JSON"),
        ("[]", "questionnaire: expected an object"),
        ("\x00", "expected JSON"),
        (" " * 1_100_000, "at most 1048576 bytes"),
    ],
)
def test_text_that_is_none(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(FormatError, match=message):
        load_questionnaire(tmp_path / "a.json")


def test_answers_are_kept_with_their_questions_and_exported(
    tmp_path: Path, key: Path | None
) -> None:
    form = load_questionnaire(saved(tmp_path))
    reworded = replace(form, items=(replace(form.items[0], text="=Well?"), *form.items[1:]))
    with Diary(tmp_path / "d", key=key, create=True) as diary:
        diary.enrol("P01", at=START)
        session = diary.start_session("P01", at=START)
        given = diary.add_answers(
            "P01", form, [2, 4, 1], occasion="baseline", session=session, at=START
        )
        assert given.scores == {"quality": 3, "mean": 3.0, "marked": 3}
        diary.add_answers("P01", reworded, [0, 1, 0], at=START + timedelta(hours=1))
        diary.add_ownership(
            "P01", "synchronous", [3, 2, 1, -3, 0, 0], at=START + timedelta(hours=2)
        )
        diary.add_mcgill("P01", [1] * 20, 3, occasion="baseline", at=START + timedelta(hours=3))
        with pytest.raises(InputError, match="P01 has a questionnaire of baseline"):
            diary.add_answers("P01", form, [0, 1, 0], occasion="baseline")
        with pytest.raises(InputError, match="occasion: expected"):
            diary.add_answers("P01", form, [0, 1, 0], occasion="noon")  # type: ignore[arg-type]
        with pytest.raises(InputError, match="session: there is no session"):
            diary.add_answers("P01", form, [0, 1, 0], session=5)
        with pytest.raises(InputError, match="answers: expected 3, got 2"):
            diary.add_answers("P01", form, [0, 1])
    with Diary(tmp_path / "d", key=key) as diary:
        found = diary.answers("P01")
        assert found[0] == given
        assert [one.questionnaire for one in found] == [form, reworded, OWNERSHIP, MCGILL]
        assert found[3].answers == (*[1] * 20, 3)
        assert len(diary.mcgill("P01")) == len(diary.ownership("P01")) == 1
        diary.check()
        write_page(diary, tmp_path / "P01.html", "P01", today=START.date())
        check_tables(diary, tmp_path, form)
        check_bundle(fhir_bundle(diary, "P01"))
    page = (tmp_path / "P01.html").read_text()
    assert page.count("<h2>Sleep &amp; rest</h2>") == 2
    assert "<th>quality</th><th>mean</th><th>marked</th>" in page
    assert "<td>baseline</td><td>2026-03-02 09:00</td><td>3</td><td>3</td><td>3</td>" in page
    assert (b"I slept well." in (tmp_path / "d").read_bytes()) == (key is None)


def test_the_questions_of_the_touch_cue_are_shown_where_they_were_asked_by_hand(
    tmp_path: Path,
) -> None:
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01", at=START)
        diary.add_answers("P01", OWNERSHIP, [3, 2, 1, -3, 0, 0], at=START)
        diary.add_ownership(
            "P01", "synchronous", [-3, -3, -3, 0, 0, 0], at=START + timedelta(hours=2)
        )
        write_page(diary, tmp_path / "P01.html", "P01", today=START.date())
    page = (tmp_path / "P01.html").read_text()
    assert page.count(f"<h2>{OWNERSHIP.name}</h2>") == 1
    assert "<td>2026-03-02 09:00</td><td>2</td><td>-1</td>" in page
    shown = command_line.run("diary", "show", tmp_path / "d", "P01").stdout
    assert [line.split(", ")[1] for line in shown.splitlines() if OWNERSHIP.name in line] == [
        "other", "synchronous touch",
    ]  # fmt: skip
    assert "ownership=2" in shown.replace(" ", "=")


def check_tables(diary: Diary, folder: Path, form: Questionnaire) -> None:
    import csv

    export_csv(diary, folder / "tables")
    with (folder / "tables" / "answers.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == (3 + 3) + (3 + 3) + (6 + 2) + (21 + 7)
    assert rows[1] == {
        "participant": "P01", "at": "2026-03-02T09:00:00+01:00", "questionnaire": "Sleep & rest",
        "sha256": form.sha256, "occasion": "baseline", "kind": "item", "name": "2",
        "text": "I woke up at night.", "value": "4",
    }  # fmt: skip
    assert (rows[3]["kind"], rows[3]["name"], rows[3]["value"]) == ("scale", "quality", "3")
    assert rows[6]["text"] == "'=Well?"  # no formula
    assert len({row["sha256"] for row in rows}) == 4


def check_bundle(bundle: dict[str, Any]) -> None:
    found = {entry["fullUrl"]: entry["resource"] for entry in bundle["entry"]}
    derived = [one for one in found.values() if "derivedFrom" in one]
    assert [one["code"]["text"] for one in derived if "component" in one] == [
        "McGill Pain Questionnaire", "Ownership of the limb after a touch cue",
        "Sleep & rest", "Sleep & rest",
    ]  # fmt: skip
    responses = [found[one["derivedFrom"][0]["reference"]] for one in derived]
    assert {one["resourceType"] for one in responses} == {"QuestionnaireResponse"}
    assert [len(one["item"]) for one in responses] == [21, 6, 3, 3]
    assert len({one["questionnaire"] for one in responses}) == 4
    assert responses[2]["item"][1] == {
        "linkId": "2", "text": "I woke up at night.", "answer": [{"valueInteger": 4}],
    }  # fmt: skip
    assert [part["valueQuantity"]["value"] for part in derived[2]["component"]] == [3, 3.0, 3]
    assert len(found) == len(bundle["entry"])
    try:
        from fhirclient.models.bundle import Bundle
    except ModuleNotFoundError:
        return
    content = json.loads(json.dumps(bundle))
    assert Bundle(content).as_json() == content


def test_mcgill_with_words_counts_as_mcgill_and_its_words_are_not_kept(tmp_path: Path) -> None:
    words = tuple(
        replace(item, choices=tuple(f"word {n}.{rank}" for rank in range(item.high + 1)))
        for n, item in enumerate(MCGILL.items)
    )
    licensed = Questionnaire("Ours", words, MCGILL.scales)
    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01")
        kept = diary.add_answers("P01", licensed, [1] * 20 + [3], occasion="week-1")
        assert kept.questionnaire == MCGILL
        (filled,) = diary.mcgill("P01")
        assert (filled.occasion, filled.score.pri, filled.score.ppi) == ("week-1", 20, 3)
        with pytest.raises(InputError, match="P01 has a questionnaire of week-1"):
            diary.add_mcgill("P01", [0] * 20, 0, occasion="week-1")
    assert b"word 1.1" not in (tmp_path / "d").read_bytes()


def test_a_questionnaire_that_was_damaged_is_said_to_be(tmp_path: Path) -> None:
    import sqlite3

    with Diary(tmp_path / "d", create=True) as diary:
        diary.enrol("P01")
        diary.add_answers("P01", load_questionnaire(saved(tmp_path)), [2, 4, 1])
        with sqlite3.connect(tmp_path / "d") as raw:
            raw.execute(
                "UPDATE questionnaires SET payload = replace(payload, '[2,4,1]', '[9,4,1]')"
            )
        raw.close()
        with pytest.raises(FormatError, match="the diary is damaged: answers: expected 0 to 2"):
            diary.answers("P01")


# --- the command line -----------------------------------------------------------------------------


run = functools.partial(command_line.run, "diary")


def test_a_therapist_asks_in_the_terminal(tmp_path: Path) -> None:
    path, form = str(tmp_path / "d"), str(saved(tmp_path))
    assert run("enrol", path, "P01").exit_code == 0
    asked = run("ask", path, "P01", "--form", form, "--json", entered="3\n2\nno\n4\n1\n")
    assert asked.exit_code == 0, asked.output
    assert json.loads(asked.stdout[asked.stdout.index("{") :])["scores"] == {
        "quality": 3,
        "mean": 3.0,
        "marked": 3,
    }
    assert "2: yes" in asked.stderr
    assert "expected 0 to 2" in asked.stderr
    assert "2 of 3. I woke up at night. (1 to 5)" in asked.stderr
    stopped = run("ask", path, "P01", "--form", form, entered="2\n")
    assert stopped.exit_code == 1
    given = run("ask", path, "P01", "--form", form, "--answers", "0,1,0", "--occasion", "week-4")
    assert given.exit_code == 0
    shown = run("show", path, "P01")
    assert "Sleep & rest, week-4, " in shown.stdout
    assert "quality 5, mean 0.5, marked 1" in shown.stdout
    found = json.loads(run("show", path, "P01", "--json").stdout)["answers"]
    assert [one["answers"] for one in found] == [[2, 4, 1], [0, 1, 0]]
    for words, message in (
        (("P02", "--form", form), "'P02' is not enrolled"),
        (("P01", "--form", form, "--answers", "1,x"), "answers: expected 3 whole numbers"),
        (("P01", "--form", form, "--answers", "1,9,0"), "expected 1 to 5 for question 2, got 9"),
    ):
        done = run("ask", path, *words)
        assert done.exit_code == 1
        assert message in str(done.exception)


def test_a_built_in_questionnaire_is_written_for_who_has_its_words(tmp_path: Path) -> None:
    path, form = str(tmp_path / "d"), str(tmp_path / "mcgill.json")
    assert run("form", "mcgill", "-o", form).exit_code == 0
    assert load_questionnaire(form) == MCGILL
    assert run("form", "mcgill", "-o", form).exit_code == 1
    assert run("enrol", path, "P01").exit_code == 0
    ranks = ",".join(["1"] * 20 + ["2"])
    words = ("--answers", ranks, "--occasion", "baseline")
    assert run("ask", path, "P01", "--form", form, *words).exit_code == 0
    assert json.loads(run("analyse", path, "--json").stdout)["scores"][0][0] == 20
