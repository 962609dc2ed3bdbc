"""The engine without a browser: what it stores, what it refuses, and what it never loses."""

from __future__ import annotations

import copy
import csv
import json
import os
import pickle
import random
import re
import signal
import subprocess
import sys
import textwrap
import threading
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from manip3d import FormatError, InputError
from manip3d.study import (
    TEMPLATES,
    Answer,
    DisplayStudy,
    Field,
    Session,
    Step,
    StudyFolder,
    px_per_degree,
    read_study,
    run_study,
    simulate_participants,
    state_of,
    study_of,
    write_results,
    write_template,
)
from manip3d.study._definition import read_table
from manip3d.study._display import _williams
from manip3d.study._engine import Conductor, _plausible


class Client:
    """Stands in for a page's connection."""

    def __init__(self) -> None:
        self.heard: list[dict[str, Any]] = []

    def say(self, text: str) -> None:
        self.heard.append(json.loads(text))


@pytest.fixture
def definition(tmp_path: Path) -> Path:
    file = write_template("display", tmp_path / "study.toml", example=True)
    file.write_text(file.read_text().replace("familiarisation_s = 1\n", "familiarisation_s = 0\n"))
    return file


@pytest.fixture
def conductor(definition: Path, tmp_path: Path) -> Iterator[Conductor]:
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "answers", content) as folder:
        yield Conductor(study, folder)


def say(conductor: Conductor, client: Client, **message: Any) -> dict[str, Any]:
    conductor.hear(client, json.dumps(message))  # type: ignore[arg-type]
    return client.heard[-1]


def reply(step: dict[str, Any], /, **values: Any) -> dict[str, Any]:
    """A right answer to a step, with some values replaced."""
    given: dict[str, Any] = {}
    for field in step["fields"]:
        value: Any = ""
        if not field["optional"]:
            value = {"choice": "", "scale": 2, "number": field["low"], "text": "x"}[field["type"]]
            if field["type"] == "choice":
                value = field["choices"][0][0]
        given[f"answer.{field['name']}"] = value
    message = {"type": "answer", "step": step["id"], "elapsed_ms": 5.5, "shown_px": 0}
    return message | given | values


def to_the_end(conductor: Conductor, client: Client, code: str) -> list[str]:
    step = say(conductor, client, type="begin", participant=code)
    seen = []
    while step["type"] == "step":
        seen.append(step["id"])
        step = say(conductor, client, **reply(step))
    assert step["type"] == "end"
    return seen


def test_a_participant_from_code_to_end(conductor: Conductor) -> None:
    client = Client()
    assert say(conductor, client, type="hello") == {"type": "who", "title": "Comparing displays"}
    assert len(to_the_end(conductor, client, "P1")) == 3 + 3 * 5 + 1
    assert state_of(conductor.study, conductor.folder.sessions["P1"]) == "finished"
    assert say(conductor, client, type="begin", participant="P1")["type"] == "end"


def test_orders_of_displays_are_counterbalanced_within_each_group(conductor: Conductor) -> None:
    study = conductor.study
    assert isinstance(study, DisplayStudy)
    for number in range(24):
        client = Client()
        step = say(conductor, client, type="begin", participant=f"P{number}")
        step = say(conductor, client, **reply(step))
        # Experts and healthy people come in no order.
        group = "expert" if number % 4 in (0, 3) else "healthy"
        say(conductor, client, **reply(step, **{"answer.group": group}))
    for group in ("expert", "healthy"):
        orders = Counter(
            tuple(study.order_of(s)) for s in conductor.folder.sessions.values() if s.group == group
        )
        assert len(orders) == 6
        assert set(orders.values()) == {2}


def test_the_place_of_who_has_withdrawn_is_taken_by_the_next(conductor: Conductor) -> None:
    study, folder = conductor.study, conductor.folder
    assert isinstance(study, DisplayStudy)

    def takes_part(code: str, *, agrees: bool = True) -> list[str]:
        client = Client()
        step = say(conductor, client, type="begin", participant=code)
        if not agrees:
            assert say(conductor, client, **reply(step, **{"answer.agree": "no"}))["type"] == "end"
            return []
        step = say(conductor, client, **reply(step))
        say(conductor, client, **reply(step, **{"answer.group": "expert"}))
        return study.order_of(folder.sessions[code])

    first, *others = (takes_part(f"P{number}") for number in range(3))
    assert takes_part("no", agrees=False) == []
    folder.withdraw("P0")
    assert first not in others
    assert takes_part("P3") == first
    rest = [takes_part(f"P{number}") for number in range(4, 7)]
    assert len({tuple(order) for order in (first, *others, *rest)}) == 6
    assert takes_part("P7") == first  # the second round


def test_orders_are_counterbalanced_where_nobody_asks_about_people(
    definition: Path, tmp_path: Path
) -> None:
    text = re.sub(r"\[\[demographics\]\].*?(?=\n\[)", "", definition.read_text(), flags=re.DOTALL)
    definition.write_text(re.sub(r"^groups = .*$", "", text, flags=re.MULTILINE))
    study, content = read_study(definition)
    assert isinstance(study, DisplayStudy)
    assert "about" not in [step.id for step in study.opening()]
    with StudyFolder(tmp_path / "a", content) as folder:
        conductor = Conductor(study, folder)
        for number in range(12):  # every second one does not agree
            client = Client()
            step = say(conductor, client, type="begin", participant=f"P{number}")
            agrees = "yes" if number % 2 else "no"
            say(conductor, client, **reply(step, **{"answer.agree": agrees}))
        agreed = [folder.sessions[f"P{number}"] for number in range(1, 12, 2)]
        assert len({tuple(study.order_of(session)) for session in agreed}) == 6
    with StudyFolder(tmp_path / "b", content) as folder:
        simulate_participants(study, folder, 6)
        assert {s.assigned for s in folder.sessions.values()} == set(range(6))


def test_who_is_halfway_keeps_the_displays_that_they_have_seen(definition: Path) -> None:
    """Another release had other orders of many displays."""
    text = re.sub(r"^displays = .*$", 'displays = ["a", "b", "c", "d"]', definition.read_text(),
                  flags=re.MULTILINE)  # fmt: skip
    definition.write_text(text)
    study, _ = read_study(definition)
    assert isinstance(study, DisplayStudy)
    for number in range(4):
        session = Session("P", number)
        order = study.order_of(session)
        last = order[-1]
        for step in study.steps(session):
            if step.id.startswith("d1_"):
                session.answers.append(Answer(step.id, {"display": last, "session": 1}, {}))
        assert study.order_of(session) == [last, *order[:-1]]
        following = study.next_step(session)
        assert following is not None
        assert following.condition == {"display": order[0], "session": 2}


@pytest.mark.parametrize("count", [4, 5, 6])
def test_orders_of_many_displays_are_a_williams_square(count: int) -> None:
    rows = _williams(count)
    times = 1 if count % 2 == 0 else 2
    assert len(rows) == times * count
    for place in range(count):
        assert Counter(row[place] for row in rows) == dict.fromkeys(range(count), times)
    pairs = Counter(pair for row in rows for pair in pairwise(row))
    wanted = {(a, b) for a in range(count) for b in range(count) if a != b}
    assert pairs == dict.fromkeys(wanted, times)


def test_many_displays_are_shown_in_as_many_orders(definition: Path) -> None:
    text = re.sub(r"^displays = .*$", 'displays = ["a", "b", "c", "d"]', definition.read_text(),
                  flags=re.MULTILINE)  # fmt: skip
    definition.write_text(text)
    study, _ = read_study(definition)
    assert isinstance(study, DisplayStudy)
    assert study.num_orders == 4
    orders = {tuple(study.order_of(Session(f"P{number}", number))) for number in range(8)}
    assert len(orders) == 4
    definition.write_text(text.replace('order = "counterbalanced"', 'order = "published"'))
    assert read_study(definition)[0].num_orders == 1


def test_numbers_of_a_narrow_range_are_plausible() -> None:
    rng = np.random.default_rng(0)
    narrow = Field("ratio", "", "number", low=0.2, high=0.4)
    assert all(0.2 <= float(_plausible(narrow, rng, 0) or 0) <= 0.4 for _ in range(20))
    wide = Field("age", "", "number", low=18, high=99)
    assert {float(_plausible(wide, rng, 0) or 0) % 1 for _ in range(20)} == {0.0}


def test_spreadsheets_are_told_that_texts_are_utf_8(definition: Path, tmp_path: Path) -> None:
    ratio = '[[demographics]]\nname = "ratio"\nlabel = "Ratio"\ntype = "number"\n'
    ratio += "low = 0\nhigh = 1\n\n[display]\n"
    definition.write_text(definition.read_text().replace("[display]\n", ratio, 1))
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "a", content) as folder:
        conductor, client = Conductor(study, folder), Client()
        step = say(conductor, client, type="begin", participant="P1")
        step = say(conductor, client, **reply(step))
        say(conductor, client, **reply(step, **{"answer.ratio": "1e-05"}))
        write_results(study, folder, tmp_path / "r")
    mark = b"\xef\xbb\xbf"
    has_mark = {f.name: f.read_bytes().startswith(mark) for f in (tmp_path / "r").iterdir()}
    assert {name for name, there in has_mark.items() if there} == {"answers.csv", "summary.csv"}
    with (tmp_path / "r" / "participants.csv").open(newline="", encoding="utf-8") as stream:
        (row,) = csv.DictReader(stream)
    assert row["ratio"] == "0.00001"  # REDCap reads no exponents


@pytest.mark.parametrize(
    "code", ["", "-a", "../P1", "a/b", "a" * 33, "ä", "P 1", "P1\n", ".", "P1.jsonl"]
)
def test_codes_that_are_none_are_refused(conductor: Conductor, code: str) -> None:
    client = Client()
    try:
        answer = say(conductor, client, type="begin", participant=code)
    except FormatError:
        return
    assert answer["type"] == "who"
    assert "participant" in answer["problem"]
    assert conductor.folder.sessions == {}


def test_codes_that_differ_in_case_alone_are_refused(conductor: Conductor) -> None:
    say(conductor, Client(), type="begin", participant="P1")
    answer = say(conductor, Client(), type="begin", participant="p1")
    assert "differs from another code only in case" in answer["problem"]


@pytest.mark.parametrize("code", ["sim-001", "SIM-001", "sim-P1"])
def test_people_get_no_codes_of_simulated_participants(conductor: Conductor, code: str) -> None:
    answer = say(conductor, Client(), type="begin", participant=code)
    assert "participant: expected a code that does not begin with sim-" in answer["problem"]
    assert conductor.folder.sessions == {}


def test_simulated_participants_and_people_do_not_mix(definition: Path, tmp_path: Path) -> None:
    study, content = read_study(definition)
    for code in ("P1", "sim-001"):  # codes like the latter were taken once
        with StudyFolder(tmp_path / code, content) as folder:
            folder.begin(code)
            folder.store(code, Answer("consent", {}, {"agree": "yes"}, elapsed_ms=900.0))
            with pytest.raises(InputError, match=f"but simulated ones, found {code}; simulate"):
                simulate_participants(study, folder, 3)
            assert list(folder.sessions) == [code]
            assert [a.step for a in folder.sessions[code].answers] == ["consent"]
    with StudyFolder(tmp_path / "trial", content) as folder:
        simulate_participants(study, folder, 2)
        simulate_participants(study, folder, 3)  # more of them
        assert len(folder.sessions) == 3
        with pytest.raises(InputError, match="found sim-000; people need another folder"):
            run_study(study, folder, seconds=0.1)


def test_a_negative_seed_begins_nobody(definition: Path, tmp_path: Path) -> None:
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "answers", content) as folder:
        with pytest.raises(InputError, match="seed: expected 0 or more, got -1"):
            simulate_participants(study, folder, 1, seed=-1)
        assert not folder.sessions


def test_simulated_answers_do_not_depend_on_the_calls_that_gave_them(
    definition: Path, tmp_path: Path
) -> None:
    """Participants who were added later must not repeat the answers of earlier ones."""
    study, content = read_study(definition)

    def answers(folder: StudyFolder) -> dict[str, list[Any]]:
        return {code: [dict(a.values) for a in s.answers] for code, s in folder.sessions.items()}

    with StudyFolder(tmp_path / "once", content) as folder:
        simulate_participants(study, folder, 6)
        once = answers(folder)
    assert len({str(values) for values in once.values()}) == 6
    with StudyFolder(tmp_path / "twice", content) as folder:
        simulate_participants(study, folder, 3)
        simulate_participants(study, folder, 6)
        assert answers(folder) == once
    journal = tmp_path / "twice" / "participants" / "sim-005.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[: len(lines) // 2]))  # interrupted
    with StudyFolder(tmp_path / "twice", content) as folder:
        assert answers(folder)["sim-005"] != once["sim-005"]
        simulate_participants(study, folder, 6)
        assert answers(folder) == once


def test_one_participant_alone_where_one_is_named(conductor: Conductor) -> None:
    conductor.participant = "P7"
    client = Client()
    assert say(conductor, client, type="hello")["participant"] == "P7"
    with pytest.raises(FormatError, match="participant: expected P7"):
        say(conductor, client, type="begin", participant="P8")


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"step": "about"}, "step: expected one of consent"),
    ({"answer.agree": "perhaps"}, "answer.agree: expected one of yes, no"),
    ({"answer.agree": 1}, "answer.agree: expected one of"),
    ({"elapsed_ms": -1}, "elapsed_ms: expected 0 to"),
    ({"elapsed_ms": 1e999}, "expected"),
    ({"elapsed_ms": True}, "elapsed_ms: expected float, got bool"),
    ({"shown_px": "wide"}, "shown_px: expected float"),
    ({"answer.other": "x"}, "answer: expected"),
    ({"truth": "real"}, "answer: expected"),
]


@pytest.mark.parametrize(("values", "message"), WRONG)
def test_answers_that_are_none_are_refused(
    conductor: Conductor, values: dict[str, Any], message: str
) -> None:
    client = Client()
    step = say(conductor, client, type="begin", participant="P1")
    with pytest.raises(FormatError, match=message):
        say(conductor, client, **reply(step, **values))
    assert conductor.folder.sessions["P1"].answers == []
    assert say(conductor, client, **reply(step))["id"] == "about"


def test_nobody_answers_before_they_have_begun_or_twice(conductor: Conductor) -> None:
    client = Client()
    step = say(conductor, Client(), type="begin", participant="P1")
    with pytest.raises(FormatError, match="type: expected one of hello, begin"):
        say(conductor, client, **reply(step))
    say(conductor, client, type="begin", participant="P1")
    say(conductor, client, **reply(step))
    with pytest.raises(FormatError, match="answer: expected step"):
        say(conductor, client, **reply(step))  # from a second window


def test_familiarisation_cannot_be_cut_short(definition: Path, tmp_path: Path) -> None:
    definition.write_text(
        definition.read_text().replace("familiarisation_s = 0\n", "familiarisation_s = 60\n")
    )
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "a", content) as folder:
        conductor, client = Conductor(study, folder), Client()
        step = say(conductor, client, type="begin", participant="P1")
        while step["id"] != "d1_familiarisation":
            step = say(conductor, client, **reply(step))
        assert step["minimum_s"] == 60
        with pytest.raises(FormatError, match="expected an answer after 60 s"):
            say(conductor, client, **reply(step))


def test_the_published_order_and_familiarisation(tmp_path: Path) -> None:
    file = write_template("display", tmp_path / "study.toml", example=True)
    text = file.read_text().replace('order = "counterbalanced"', 'order = "published"')
    file.write_text(text)
    study, _ = read_study(file)
    assert isinstance(study, DisplayStudy)
    for number in range(6):
        order = study.order_of(Session("P", number))
        assert order == ["3D TV", "Oculus Rift", "Gear VR"]
    assert sum(len(part.questions) for part in study.parts) == 13
    empty = read_table(write_template("display", tmp_path / "empty.toml"))
    assert empty["display"]["familiarisation_s"] == 180


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=6,
)
KEYS = st.sampled_from(["type", "step", "elapsed_ms", "shown_px", "answer.agree", "participant"])
WORDS = st.sampled_from(["answer", "begin", "hello", "consent", "yes", "P1", "about"])


@pytest.fixture(scope="module")
def fuzzed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Conductor]:
    place = tmp_path_factory.mktemp("fuzz")
    study, content = read_study(write_template("display", place / "study.toml", example=True))
    with StudyFolder(place / "answers", content) as folder:
        yield Conductor(study, folder)


@settings(max_examples=400)
@given(st.dictionaries(KEYS | st.text(max_size=4), WORDS | JSON, max_size=6) | JSON, st.data())
def test_whatever_a_page_says_is_an_answer_or_a_format_error(
    fuzzed: Conductor, message: Any, data: st.DataObject
) -> None:
    client = Client()
    fuzzed.hear(client, '{"type": "begin", "participant": "P1"}')  # type: ignore[arg-type]
    text = json.dumps(message)
    cut = data.draw(st.integers(0, len(text)))
    for said in (text, text[:cut], text[:cut] + "\x00\ud800" + text[cut:]):
        told = ""
        try:
            fuzzed.hear(client, said)  # type: ignore[arg-type]
        except FormatError as error:
            told = str(error)
        assert told.isprintable()
    for session in fuzzed.folder.sessions.values():
        assert {a.step for a in session.answers} <= {"consent"}


def test_long_texts_are_refused_and_long_reasons_are_kept(conductor: Conductor) -> None:
    client = Client()
    step = say(conductor, client, type="begin", participant="P1")
    while step["id"] != "comments":
        step = say(conductor, client, **reply(step))
    with pytest.raises(FormatError, match="at most 2000 characters"):
        say(conductor, client, **reply(step, **{"answer.positive": "ä" * 2001}))
    with pytest.raises(FormatError, match="message: expected at most"):
        say(conductor, client, **reply(step, **{"answer.positive": "ä" * 50_000}))
    with pytest.raises(FormatError, match="control characters"):
        say(conductor, client, **reply(step, **{"answer.positive": "\x1b[2J"}))
    text = ("a 😀\n" * 500)[:2000].strip()
    assert say(conductor, client, **reply(step, **{"answer.positive": text}))["type"] == "end"
    found = conductor.folder.sessions["P1"].answer("comments")
    assert found is not None
    assert found.values == {"positive": text, "negative": None}


# --- what is stored -------------------------------------------------------------------------------


def test_a_folder_is_for_one_process_and_one_definition(definition: Path, tmp_path: Path) -> None:
    _, content = read_study(definition)
    first = StudyFolder(tmp_path / "a", content)
    with pytest.raises(InputError, match="another process is using this study"):
        StudyFolder(tmp_path / "a", content)
    first.close()
    first.close()
    changed = copy.deepcopy(content)
    changed["title"] = "Another"
    with pytest.raises(InputError, match="holds answers to another definition"):
        StudyFolder(tmp_path / "a", changed)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o700
    with StudyFolder(tmp_path / "a") as folder:
        assert folder.definition == content
    with pytest.raises(InputError, match="found no study"):
        StudyFolder(tmp_path / "none")


def test_every_cut_of_a_journal_leaves_whole_answers(conductor: Conductor) -> None:
    to_the_end(conductor, Client(), "P1")
    folder = conductor.folder
    folder.close()
    file = folder.path / "participants" / "P1.jsonl"
    content = file.read_bytes()
    first = content.index(b"\n") + 1
    for cut in sorted({*range(first, len(content), 97), len(content) - 1}):
        file.write_bytes(content[:cut])
        with StudyFolder(folder.path) as again:
            assert len(again.sessions["P1"].answers) == content[:cut].count(b"\n") - 1
        assert file.read_bytes() == content[: content[:cut].rfind(b"\n") + 1]


def test_a_damaged_journal_is_told_by_its_line(conductor: Conductor) -> None:
    to_the_end(conductor, Client(), "P1")
    folder = conductor.folder
    folder.close()
    file = folder.path / "participants" / "P1.jsonl"
    lines = file.read_bytes().split(b"\n")
    lines[3] = lines[3].replace(b"e", b"f", 1)
    file.write_bytes(b"\n".join(lines))
    with pytest.raises(FormatError, match="line 4: damaged"):
        StudyFolder(folder.path)
    with pytest.raises(FormatError, match="line 4: damaged"):
        StudyFolder(folder.path)  # the lock was given back


def test_a_folder_that_was_closed_is_not_written_to(definition: Path, tmp_path: Path) -> None:
    """Another process may hold it by then."""
    _, content = read_study(definition)
    with StudyFolder(tmp_path / "a", content) as folder:
        folder.begin("p1")
    with StudyFolder(tmp_path / "a") as other:
        for write in (lambda: folder.begin("p2"), lambda: folder.withdraw("p1")):
            with pytest.raises(InputError, match="this study was closed"):
                write()
        assert list(other.sessions) == ["p1"]
    assert list(StudyFolder(tmp_path / "a", read_only=True).sessions) == ["p1"]


def test_a_damaged_journal_keeps_nobody_else_from_the_results(
    definition: Path, tmp_path: Path
) -> None:
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "a", content) as folder:
        simulate_participants(study, folder, 3)
    file = tmp_path / "a" / "participants" / "sim-001.jsonl"
    damaged = file.read_bytes().replace(b"consent", b"consenu", 1)
    file.write_bytes(damaged)
    with StudyFolder(tmp_path / "a", read_only=True) as folder:
        assert sorted(folder.sessions) == ["sim-000", "sim-002"]
        assert list(folder.damaged) == ["sim-001"]
        assert "sim-001.jsonl: line 2: damaged" in folder.damaged["sim-001"]
        write_results(study, folder, tmp_path / "r")
    rows = (tmp_path / "r" / "participants.csv").read_text().splitlines()
    assert [row[:7] for row in rows[1:]] == ["sim-000", "sim-002"]
    told = (tmp_path / "r" / "summary.html").read_text()
    assert "Without those whose journals are damaged: sim-001." in told
    assert file.read_bytes() == damaged


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("a b", "participant: expected letters, digits"),
        ("", "participant: expected letters, digits"),
        ("p1", "participant: p1 differs from another code only in case"),
        ("sim-7", "participant: expected a code that does not begin with sim-"),
    ],
)
def test_no_study_is_run_for_somebody_who_cannot_begin(
    code: str, message: str, conductor: Conductor
) -> None:
    conductor.folder.begin("P1")
    with pytest.raises(InputError, match=message):
        run_study(conductor.study, conductor.folder, participant=code, seconds=0.1)


def test_a_full_disk_loses_nothing_that_was_acknowledged(
    conductor: Conductor, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = Client()
    step = say(conductor, client, type="begin", participant="P1")
    step = say(conductor, client, **reply(step))
    file = conductor.folder.path / "participants" / "P1.jsonl"
    before = file.read_bytes()
    write = os.write

    def full(descriptor: int, content: Any) -> int:
        write(descriptor, bytes(content)[:7])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    answer = say(conductor, client, **reply(step))
    monkeypatch.undo()
    assert answer == {
        "type": "problem",
        "text": "The answer could not be stored. Call the researcher.",
    }
    assert file.read_bytes() == before
    assert say(conductor, client, **reply(step))["id"] == "introduction"


KILLED = """
import json, sys
from manip3d.study import Answer, StudyFolder, read_study
study, content = read_study(sys.argv[1])
with StudyFolder(sys.argv[2], content) as folder:
    session = folder.begin("P1")
    for number in range(len(session.answers), 100_000):
        folder.store("P1", Answer(f"s{number}", {}, {"text": "x" * 300}))
        print(number, flush=True)
"""


def test_whoever_is_killed_has_stored_all_that_was_acknowledged(
    definition: Path, tmp_path: Path
) -> None:
    _, content = read_study(definition)
    rng = random.Random(3)
    stored = 0
    for _ in range(4):
        process = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(KILLED), str(definition), str(tmp_path / "a")],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert process.stdout is not None
        acknowledged = stored - 1
        for _ in range(rng.randrange(1, 40)):
            acknowledged = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        for line in process.stdout:
            acknowledged = int(line)
        process.wait()
        process.stdout.close()
        with StudyFolder(tmp_path / "a", content) as folder:
            answers = folder.sessions["P1"].answers
        assert len(answers) > acknowledged
        assert [a.step for a in answers] == [f"s{n}" for n in range(len(answers))]
        stored = len(answers)


def test_who_withdraws_leaves_nothing(definition: Path, tmp_path: Path) -> None:
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "a", content) as folder:
        simulate_participants(study, folder, 3)
        folder.withdraw("sim-001")
        with pytest.raises(InputError, match="participant: expected one of this study"):
            folder.withdraw("sim-001")
        with pytest.raises(InputError, match="participant: expected one of this study"):
            folder.store("sim-001", Answer("late", {}, {}))
        assert folder.begin("new").number == 3  # no number twice
        folder.withdraw("new")
        assert folder.begin("new").number == 3  # nothing is left of who had it
    names = [path.name for path in (tmp_path / "a").rglob("*.jsonl")]
    assert sorted(names) == ["new.jsonl", "sim-000.jsonl", "sim-002.jsonl"]
    for path in (tmp_path / "a").rglob("*"):
        assert path.is_dir() or b"sim-001" not in path.read_bytes()


def test_results_replace_nothing_that_is_not_theirs(definition: Path, tmp_path: Path) -> None:
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "a", content) as folder:
        simulate_participants(study, folder, 2)
        write_results(study_of(folder.definition), folder, tmp_path / "r")
        with pytest.raises(InputError, match=r"exists already; overwrite=True"):
            write_results(study, folder, tmp_path / "r")
        write_results(study, folder, tmp_path / "r", overwrite=True)
        (tmp_path / "r" / "mine.txt").write_text("kept")
        with pytest.raises(InputError, match="expected a folder of results"):
            write_results(study, folder, tmp_path / "r", overwrite=True)
        assert (tmp_path / "r" / "mine.txt").read_text() == "kept"


ABOUT = """
[[demographics]]
name = "hand"
label = "Your hand"
type = "choice"
choices = ["left | both", "right, mostly"]

[[demographics]]
name = "height"
label = "Height above the ground in micrometres"
type = "number"
low = -1234567.125
high = 0

[[demographics]]
name = "tiny"
label = "A small number"
type = "number"
low = 0.0000001
high = 100000000
"""


def test_redcap_gets_what_was_typed_and_what_may_be(definition: Path, tmp_path: Path) -> None:
    definition.write_text(definition.read_text().replace("[display]\n", f"{ABOUT}\n[display]\n", 1))
    study, content = read_study(definition)
    with StudyFolder(tmp_path / "a", content) as folder:
        conductor, client = Conductor(study, folder), Client()
        step = say(conductor, client, type="begin", participant="P1")
        while step["type"] == "step":
            told = reply(step)
            if step["id"] == "about":
                told["answer.hand"] = "left | both"
            if step["id"] == "comments":
                told |= {"answer.positive": "- none", "answer.negative": "=1+1"}
            step = say(conductor, client, **told)
        write_results(study, folder, tmp_path / "r")

    def rows(name: str) -> list[dict[str, str]]:
        with (tmp_path / "r" / name).open(newline="", encoding="utf-8-sig") as stream:
            return list(csv.DictReader(stream))

    entries = {row["Variable / Field Name"]: row for row in rows("redcap_dictionary.csv")}
    choices = entries["hand"]["Choices, Calculations, OR Slider Labels"]
    assert choices == "1, left / both | 2, right, mostly"
    ends = ("Text Validation Min", "Text Validation Max")
    assert [entries["height"][end] for end in ends] == ["-1234567.125", "0"]
    assert [entries["tiny"][end] for end in ends] == ["0.0000001", "100000000"]
    assert [entries["age"][end] for end in ends] == ["18", "120"]
    (person,) = rows("participants.csv")
    assert (person["hand"], person["positive"], person["negative"]) == ("1", "- none", "=1+1")
    given = {row["question"]: row["answer"] for row in rows("answers.csv")}
    assert (given["positive"], given["negative"]) == ("'- none", "'=1+1")  # for spreadsheets


# --- definitions ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_is_refused_until_it_is_filled_in(name: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="consent: expected a list of"):
        read_study(write_template(name, tmp_path / "study.toml"))


def test_each_empty_wording_is_named(tmp_path: Path) -> None:
    file = write_template("display", tmp_path / "study.toml")
    file.write_text(file.read_text().replace('consent = [""]', 'consent = ["yes"]'))
    message = (
        r"display\.parts\[0\]\.questions\[0\]\.text: expected a text that is not empty, got ''"
    )
    with pytest.raises(FormatError, match=message):
        read_study(file)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('kind = "display"', 'kind = "other"', "kind: expected one of rating, jnd, display"),
        ("seed = 1", "seed = -1", "seed: expected a whole number from 0"),
        ("seed = 1", "seed = true", "seed: expected a whole number"),
        ("seed = 1", "seeds = 1", "seeds: expected no such key"),
        (
            "familiarisation_s = 0",
            "familiarisation_s = nan",
            "familiarisation_s: expected a number",
        ),
        (
            'name = "age"',
            'name = "group"',
            r"demographics\[0\].name: expected a name that no other",
        ),
        ('name = "age"', 'name = "Age"', r"demographics\[0\].name: expected a small letter"),
        ('topic = "finding"', 'topic = "x"', "topic: expected one of finding, realistic, no_delay"),
        ('name = "finding"', 'name = "easy"', "easy is there twice"),
        ("high = 120", "high = 3", r"demographics\[0\].high: expected a number from 18"),
        (
            '["3D TV", "Oculus Rift", "Gear VR"]',
            '["a", "a"]',
            "displays: expected a list of 1 to 6",
        ),
        (
            '["3D TV", "Oculus Rift", "Gear VR"]',
            '["TV", "TV "]',
            "displays: expected a list of 1 to 6 different texts",
        ),
        ('["expert", "healthy"]', '["All", "healthy"]', "groups: expected no group named all"),
        ("seed = 1", "seed = 1979-05-27", "seed: expected a whole number"),
        ("seed = 1", "seed = ", "expected TOML or JSON"),
    ],
)
def test_definitions_are_read_strictly(old: str, new: str, message: str, definition: Path) -> None:
    text = definition.read_text()
    assert old in text
    definition.write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError, match=message):
        read_study(definition)


def test_stored_answers_of_a_group_named_all_stay_readable(definition: Path) -> None:
    _, content = read_study(definition)
    stored = content | {"groups": ["All", "healthy"]}
    assert study_of(stored).common.groups == ("All", "healthy")


def test_only_display_studies_call_all_participants_a_group(tmp_path: Path) -> None:
    file = write_template("jnd-textured", tmp_path / "study.toml", example=True)
    text = re.sub(r"^groups = .*\n", "", file.read_text(), flags=re.MULTILINE)
    file.write_text('groups = ["All", "healthy"]\n' + text)
    assert read_study(file)[0].common.groups == ("All", "healthy")


@pytest.mark.parametrize(
    "name",
    [
        "record_id",
        "state",
        "card_px",
        "distance_cm",
        "positive",
        "d1_session",
        "d2_finding",
        "agree",
    ],
)
def test_no_two_columns_of_the_results_have_one_name(name: str, definition: Path) -> None:
    text = definition.read_text()
    definition.write_text(text.replace('name = "age"', f'name = "{name}"', 1))
    message = rf"demographics\[0\].name: expected a name that no other column .* got '{name}'"
    with pytest.raises(FormatError, match=message):
        read_study(definition)
    definition.write_text(text.replace('name = "finding"', 'name = "session"', 1))
    with pytest.raises(FormatError, match="names that differ in the results, got d1_session twice"):
        read_study(definition)


def test_json_is_as_good_as_toml(definition: Path, tmp_path: Path) -> None:
    _, content = read_study(definition)
    file = tmp_path / "study.json"
    file.write_text(json.dumps(content))
    assert read_study(file)[1] == content
    for wrong in (b"[1]", b"\xff", b"[" * 100_000, b" " * ((1 << 20) + 1)):
        file.write_bytes(wrong)
        with pytest.raises(FormatError):
            read_study(file)


@settings(max_examples=300)
@given(st.data())
def test_whatever_stands_in_a_definition_is_read_or_a_format_error(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(["display", "jnd-textured", "rating"]))
    file = Path(sys.modules["manip3d.study"].__file__ or "").parent / "templates" / f"{name}.toml"
    table = read_table(file)
    table["consent"] = ["yes"]
    for _ in range(data.draw(st.integers(1, 3))):
        place: Any = table
        while isinstance(place, dict | list) and place:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            key = data.draw(st.sampled_from(keys))
            if not isinstance(place[key], dict | list) or data.draw(st.booleans()):
                place[key] = data.draw(JSON)
                break
            place = place[key]
    told = ""
    try:
        study_of(table)
    except FormatError as error:
        told = str(error)
    assert told.isprintable()


def test_things_can_be_pickled(definition: Path) -> None:
    study, _ = read_study(definition)
    step = Step("a", "A", fields=(Field("b", "B", "choice", (("c", "C"),)),))
    for thing in (study, step, Answer("a", {}, {"b": "c"}), Session("P1", 0)):
        assert pickle.loads(pickle.dumps(thing)) == thing


def test_a_visual_degree() -> None:
    # A screen of 96 dots per inch: a card of 85.6 mm is 323.5 pixels; at 57.3 cm a degree is 1 cm.
    assert abs(px_per_degree(323.53, 57.29) - 37.8) < 0.05


def test_missing_stimuli_and_wrong_times_are_told(tmp_path: Path) -> None:
    study, content = read_study(write_template("jnd-textured", tmp_path / "s.toml", example=True))
    with StudyFolder(tmp_path / "a", content) as folder:
        with pytest.raises(InputError, match=r"head\.glb: expected a stimulus, found none"):
            run_study(study, folder)
        with pytest.raises(InputError, match="'manip3d study stimuli' makes them"):
            run_study(study, folder)
        with pytest.raises(InputError, match="seconds: expected > 0"):
            run_study(study, folder, seconds=0.0)
        for endless in (1e300, float("inf"), float("nan")):
            with pytest.raises(InputError, match="seconds: expected > 0 and <= "):
                run_study(study, folder, seconds=endless)
    assert not (tmp_path / "stimuli-textured").exists()


@pytest.mark.parametrize("method", ["begin", "store", "withdraw"])
def test_nothing_is_written_after_another_thread_has_closed_the_folder(
    tmp_path: Path, method: str
) -> None:
    """Another process may have the folder then."""
    with StudyFolder(tmp_path / "answers", {}) as folder:
        folder.begin("P1")
        own = folder._mutex

        class ClosedMeanwhile:
            def __enter__(self) -> None:
                folder._mutex = own
                folder.close()

            def __exit__(self, *_: object) -> None:
                pass

        folder._mutex = ClosedMeanwhile()  # type: ignore[assignment]
        given: tuple[Any, ...] = ("P2",) if method == "begin" else ("P1",)
        if method == "store":
            given = ("P1", Answer("late", {}, {}))
        with pytest.raises(InputError, match="this study was closed"):
            getattr(folder, method)(*given)
    assert len(list((tmp_path / "answers").rglob("P1.jsonl"))) == 1


def test_threads_begin_with_different_numbers(tmp_path: Path) -> None:
    with StudyFolder(tmp_path / "answers", {"kind": "rating"}) as folder:
        barrier = threading.Barrier(8)

        def begin(first: int) -> None:
            barrier.wait()
            for number in range(6):
                session = folder.begin(f"p{first}-{number}")
                folder.store(session.participant, Answer("about", {}, {}))

        threads = [threading.Thread(target=begin, args=(first,)) for first in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(each.number for each in folder.sessions.values()) == list(range(48))
        assert all(len(each.answers) == 1 for each in folder.sessions.values())


@pytest.mark.parametrize("content", ["[" * 100_000, '{"a":' * 100_000, "x" * (17 << 20)])
def test_hostile_definitions_beside_answers(tmp_path: Path, content: str) -> None:
    (tmp_path / "study.json").write_text(content)
    with pytest.raises(FormatError, match=r"study\.json"):
        StudyFolder(tmp_path)


def test_a_long_definition_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(FormatError, match=r"study\.toml.*at most 1048576 bytes"):
        read_study(path)
