"""``manip3d diary`` as a therapist types it."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import sqlite3
from datetime import datetime
from pathlib import Path

import pytest

import command_line

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("cryptography", reason="the extra 'diary' is not installed")
pytest.importorskip("scipy", reason="the extra 'diary' is not installed")

pytest.importorskip("PIL.Image", reason="the extra 'diary' is not installed")

from PIL import Image

from manip3d.diary import Diary, DiaryGame

RANKS = ",".join(["1"] * 20)

run = functools.partial(command_line.run, "diary")


def ran(*words: str) -> str:
    done = run(*words)
    assert done.exit_code == 0, (done.output, done.exception)
    return done.stdout


@pytest.fixture
def path(tmp_path: Path) -> str:
    found = str(tmp_path / "study.diary")
    ran("enrol", found, "P01", "--limb", "left-leg")
    return found


def test_a_study_from_enrolment_to_deletion(path: str, tmp_path: Path) -> None:
    ran("rate", path, "P01", "--pain", "6")
    ran("rate", path, "P01", "--mcgill", RANKS, "--ppi", "3", "--occasion", "baseline")
    ran("rate", path, "P01", "--event", "a sore stump [red]")
    shown = ran("show", path, "P01")
    assert "P01, left leg, enrolled" in shown
    assert "PRI 20 (10 + 5 + 1 + 4), NWC 20, PPI 3" in shown
    assert "a sore stump [red]" in shown
    assert "0 of 2" in ran("list", path)
    found = json.loads(ran("show", path, "P01", "--json"))
    assert found["questionnaires"][0]["score"]["pri"] == 20
    ran("export", path, "-o", str(tmp_path / "tables"))
    assert (tmp_path / "tables" / "ratings.csv").read_text().count("\n") == 2
    ran("export", path, "-o", str(tmp_path / "P01.json"), "--participant", "P01")
    assert json.loads((tmp_path / "P01.json").read_text())["resourceType"] == "Bundle"
    assert "mixed model: none so far (expected scores at baseline and at a" in ran("analyse", path)
    as_json = json.loads(ran("analyse", path, "--json"))
    assert as_json["scores"][0][0] == 20
    assert as_json["model"] is None
    assert as_json["why_no_model"] == "expected scores at baseline and at a later occasion"
    assert run("delete", path, "P01", entered="n\n").exit_code == 1
    assert "P01" in ran("list", path)
    ran("delete", path, "P01", "--yes")
    assert "nobody is enrolled" in ran("list", path)


def test_in_mid_study_the_reason_for_which_there_is_no_model_is_true(path: str) -> None:
    ran("enrol", path, "P02", "--limb", "left-leg")
    for name in ("P01", "P02"):
        ran("rate", path, name, "--mcgill", RANKS, "--ppi", "3", "--occasion", "baseline")
    assert "(expected scores at baseline and at a later occasion)" in ran("analyse", path)
    ran("rate", path, "P01", "--mcgill", RANKS, "--ppi", "3", "--occasion", "week-4")
    ran("rate", path, "P01", "--mcgill", RANKS, "--ppi", "3", "--occasion", "week-1")
    assert "(expected two participants with two scores each)" in ran("analyse", path)
    ran("rate", path, "P02", "--mcgill", RANKS, "--ppi", "3", "--occasion", "week-1")
    assert "two participants with two" not in ran("analyse", path)


def of_index(pri: int) -> str:
    """Answers of a McGill questionnaire with a small pain rating index."""
    return ",".join("1" if group < pri else "0" for group in range(20))


def fill_in(path: str, name: str, **indices: int) -> None:
    for occasion, pri in indices.items():
        ran("rate", path, name, "--mcgill", of_index(pri), "--ppi", "3", "--occasion",
            occasion.replace("_", "-"))  # fmt: skip


def test_two_occasions_are_analysed_without_the_third(path: str) -> None:
    for name, before, after in (("P01", 20, 9), ("P02", 18, 12), ("P03", 15, 10)):
        if name != "P01":
            ran("enrol", path, name)
        fill_in(path, name, baseline=before, week_4=after)
    shown = ran("analyse", path)
    assert "change to week 4, mixed model: -7.3 (95 %" in shown
    assert "change to week 1, mixed model" not in shown
    assert "week 1, paired differences: none so far (expected two participants with both" in shown
    assert "change to week 4, paired differences of 3 participants: -7.3 (95 %" in shown
    assert "not known so far (all participants with both scores have the same adherence)" in shown
    found = json.loads(ran("analyse", path, "--json"))
    assert (found["model_occasions"], found["why_no_model"]) == (["baseline", "week-4"], "")
    assert found["model"]["changes"][0]["value"] == pytest.approx(-22 / 3)
    assert found["why_not_paired"] == ["expected two participants with both scores, got 0", ""]


def test_equal_changes_are_told_as_the_reason(path: str) -> None:
    ran("enrol", path, "P02")
    fill_in(path, "P01", baseline=20, week_4=10)
    fill_in(path, "P02", baseline=18, week_4=8)
    told = "week 4, paired differences: none so far (all 2 participants have the same change, -10"
    assert told in ran("analyse", path)


def test_who_had_no_pain_at_baseline_is_counted(path: str) -> None:
    ran("enrol", path, "P02")
    fill_in(path, "P01", baseline=20, week_4=5)
    fill_in(path, "P02", baseline=0, week_4=20)
    shown = ran("analyse", path)
    assert "PRI down by 30 % or more: 1 of 2 with both scores" in shown
    assert "of these, with PRI 0 at baseline, counted as without response: 1" in shown
    assert json.loads(ran("analyse", path, "--json"))["num_without_pain"] == 1


def test_touch_cues_and_the_felt_limb_are_shown(path: str) -> None:
    with Diary(path) as diary:
        diary.add_ownership("P01", mode="asynchronous", answers=[3, 2, 1, -1, -2, -2])
        diary.add_felt("P01", length=80, telescoping=20, raised=10, bent=30, limb="left_leg")
    shown = ran("show", path, "P01")
    assert "asynchronous touch, " in shown
    assert "ownership 2, control -1.667" in shown
    assert "felt limb (left leg), " in shown
    assert ": 80 % long, 20 % telescoped, raised 10 and bent 30 degrees" in shown
    found = json.loads(ran("show", path, "P01", "--json"))
    assert found["answers"][0]["mode"] == "asynchronous"
    assert found["felt"][0]["telescoping"] == 20


def test_a_rating_outside_of_sessions_is_shown(path: str, tmp_path: Path) -> None:
    ran("rate", path, "P01", "--pain", "6")
    with Diary(path) as diary:
        session = diary.start_session("P01")
        diary.add_rating("P01", 3, session=session)
    shown = ran("show", path, "P01")
    assert "pain 6, " in shown
    assert "pain 3, " not in shown  # it stands in the line of its session
    found = json.loads(ran("show", path, "P01", "--json"))
    assert [one["pain"] for one in found["ratings"]] == [6]
    assert [one["pain"] for one in found["sessions"][0]["ratings"]] == [3]
    ran("export", path, "-o", str(tmp_path / "pages"), "--pages")
    page = (tmp_path / "pages" / "participant-P01.html").read_text()
    apart = page.partition("Pain outside of sessions")[2].partition("<h2>")[0]
    assert "<td>6</td>" in apart
    assert "<td>3</td>" not in apart


def test_exports_are_listed_and_removed_with_a_participant(path: str, tmp_path: Path) -> None:
    ran("enrol", path, "P02")
    for words in (["-o", str(tmp_path / "tables")],
                  ["-o", str(tmp_path / "P01.json"), "--participant", "P01"],
                  ["-o", str(tmp_path / "P01.html"), "--participant", "P01"],
                  ["-o", str(tmp_path / "P02.html"), "--participant", "P02"]):  # fmt: skip
        ran("export", path, *words)
    (tmp_path / "P01.html").write_text("somebody wrote into it")
    (tmp_path / "tables" / "events.csv").unlink()
    asked = run("delete", path, "P01", entered="n\n")
    assert f"exported: {tmp_path / 'P01.html'} (changed)" in asked.stderr
    assert f"exported: {tmp_path / 'P01.json'} (unchanged)" in asked.stderr
    assert f"{tmp_path / 'tables' / 'events.csv'} (gone)" in asked.stderr
    assert (tmp_path / "P01.json").exists()
    found = json.loads(ran("delete", path, "P01", "--yes", "--exports", "--json"))
    assert found["left"] == [str(tmp_path / "P01.html")]
    assert str(tmp_path / "P01.json") in found["removed"]
    assert len(found["removed"]) == 10
    left = sorted(str(one.relative_to(tmp_path)) for one in tmp_path.rglob("*") if one.is_file())
    assert left == ["P01.html", "P02.html", "study.diary"]
    found = json.loads(ran("delete", path, "P02", "--yes", "--json"))
    assert (found["removed"], found["left"]) == ([], [str(tmp_path / "P02.html")])


def test_exports_stay_where_the_participant_cannot_be_deleted(path: str, tmp_path: Path) -> None:
    ran("export", path, "-o", str(tmp_path / "tables"))
    with contextlib.closing(sqlite3.connect(path)) as other:
        other.execute("BEGIN")
        other.execute("SELECT count(*) FROM games").fetchone()
        done = run("delete", path, "P01", "--yes", "--exports")
        assert done.exit_code == 1
        assert "nothing deleted" in str(done.exception)
        other.rollback()
    assert len(list((tmp_path / "tables").iterdir())) == 10
    assert "P01" in ran("list", path)
    assert (
        len(json.loads(ran("delete", path, "P01", "--yes", "--exports", "--json"))["removed"]) == 10
    )
    assert not (tmp_path / "tables").exists()


def test_exports_go_though_the_file_cannot_be_written_anew(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The participant is deleted by then: nobody could name these files any more."""
    ran("export", path, "-o", str(tmp_path / "tables"))
    delete, consent = Diary.delete, Diary.set_consent

    def deleted(diary: Diary, identifier: str) -> None:
        delete(diary, identifier)
        raise OSError("deleted, but the file could not be written anew")

    def changed(diary: Diary, identifier: str, *, clips: bool) -> None:
        consent(diary, identifier, clips=clips)
        raise OSError("deleted, but the file could not be written anew")

    monkeypatch.setattr(Diary, "set_consent", changed)
    ran("enrol", path, "P02", "--clips")
    with Diary(path) as diary:
        film = tmp_path / "film.webp"
        film.write_bytes(b"RIFF\0\0\0\0WEBP")
        diary.note_files("P02", [film])
    done = run("consent", path, "P02", "--no-clips")
    assert f"still shows films of P02: {film}" in done.stderr
    assert "could not be written anew" in str(done.exception)

    monkeypatch.setattr(Diary, "delete", deleted)
    done = run("delete", path, "P01", "--yes", "--exports")
    assert done.exit_code == 1
    assert "could not be written anew" in str(done.exception)
    assert "removed 10 exported files" in done.stderr
    assert not (tmp_path / "tables").exists()
    assert "P01" not in ran("list", path)


def test_an_export_that_cannot_be_removed_is_said_to_be_left(
    path: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran("export", path, "-o", str(tmp_path / "tables"))
    games, unlink = tmp_path / "tables" / "games.csv", Path.unlink

    def unlinked(file: Path) -> None:
        if file == games:
            raise PermissionError(1, "Operation not permitted", str(file))
        unlink(file)

    monkeypatch.setattr(Path, "unlink", unlinked)
    done = run("delete", path, "P01", "--yes", "--exports", "--json")
    assert f"cannot remove {games}: Operation not permitted" in done.stderr
    found = json.loads(done.stdout)
    assert (len(found["removed"]), found["left"]) == (9, [str(games)])
    assert list((tmp_path / "tables").iterdir()) == [games]
    assert "nobody is enrolled" in ran("list", path)


def test_who_takes_back_consent_is_told_of_films_outside(path: str, tmp_path: Path) -> None:
    films, page = tmp_path / "films", str(tmp_path / "P01.html")
    ran("consent", path, "P01", "--clips")
    with Diary(path) as diary:
        session = diary.start_session("P01")
        content = io.BytesIO()
        Image.new("RGB", (32, 24)).save(content, "JPEG")
        played = DiaryGame(
            datetime.now().astimezone(), "piano", 1, 5, "time", 60.0, 0.0, 3, 1, 1, ((6.0, 19.0),)
        )
        diary.add_game(session, played, [[(1.0, content.getvalue())]])
    ran("clips", path, "P01", "-o", str(films))
    ran("export", path, "-o", page, "--participant", "P01", "--clips")
    ran("export", path, "-o", str(tmp_path / "plain.html"), "--participant", "P01")
    (film,) = films.iterdir()
    (film.parent / "gone.webp").write_bytes(film.read_bytes())
    with Diary(path) as diary:
        diary.note_files("P01", [film.parent / "gone.webp"])
    (film.parent / "gone.webp").unlink()
    done = run("consent", path, "P01", "--no-clips", "--json")
    assert json.loads(done.stdout)["left"] == [page, str(film)]
    assert f"still shows films of P01: {film}" in done.stderr
    assert json.loads(ran("consent", path, "P01", "--clips", "--json"))["left"] == []


def test_the_audit_is_shown(path: str) -> None:
    ran("rate", path, "P01", "--pain", "6")
    found = json.loads(ran("audit", path, "--json"))
    assert [(row["action"], row["participant"]) for row in found] == [
        ("enrol", "P01"), ("rating", "P01"),
    ]  # fmt: skip
    ran("delete", path, "P01", "--yes")
    assert ran("audit", path).split()[-1] == "delete"


def test_an_encrypted_diary(tmp_path: Path) -> None:
    key, path = str(tmp_path / "study.key"), str(tmp_path / "study.diary")
    ran("keygen", key)
    ran("enrol", path, "P01", "--key", key)
    assert "P01" in ran("list", path, "--key", key)
    assert "is encrypted; its key file is needed" in str(run("list", path).exception)


def test_games_of_a_simulated_person_are_left_out(path: str) -> None:
    with Diary(path) as diary:
        session = diary.start_session("P01")
        at = datetime.now().astimezone()
        played = DiaryGame(at, "pedal", 1, 5, "time", 60.0, 0.0, 3, 1, 1, source="sim:body")
        diary.add_game(session, played)
    assert "0 more in part; left out: 1 game of a simulated person" in ran("show", path, "P01")
    assert "pedal 3 (simulated)" in ran("show", path, "P01")
    assert "left out: 1 game of a simulated person" in ran("analyse", path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["show", "P02"], "'P02' is not enrolled"),
        (["rate", "P01"], "expected --pain, --mcgill or --event"),
        (["rate", "P01", "--mcgill", "1,2"], "--mcgill: expected 20, got 2"),
        (["rate", "P01", "--mcgill", "a"], "--mcgill: expected 20 whole numbers"),
        (["rate", "P01", "--mcgill", "1_0" + ",0" * 19], "--mcgill: expected 20 whole numbers"),
        (["rate", "P01", "--mcgill", "9" + ",0" * 19], "--mcgill: expected 0 to 6 in group 1"),
        (["delete", "P02", "--yes"], "'P02' is not enrolled"),
        (["enrol", "P01"], "P01 is enrolled already"),
    ],
)
def test_refusals(path: str, words: list[str], message: str) -> None:
    done = run(words[0], path, *words[1:])
    assert done.exit_code == 1
    assert message in str(done.exception)


def test_fhir_is_of_one_participant(path: str, tmp_path: Path) -> None:
    done = run("export", path, "-o", str(tmp_path / "a.json"))
    assert "--participant: expected one, for .json and .html" in str(done.exception)
    assert not (tmp_path / "a.json").exists()


def test_a_diary_that_is_not_there_is_not_made_by_reading(tmp_path: Path) -> None:
    assert run("list", str(tmp_path / "none")).exit_code == 1
    assert not (tmp_path / "none").exists()


def test_texts_of_an_older_diary_cannot_steer_a_terminal_and_can_be_exported(
    path: str, tmp_path: Path
) -> None:
    """Earlier versions took bytes that are no text, and control characters."""
    ran("rate", path, "P01", "--event", "caf?")
    ran("rate", path, "P01", "--event", "&31mred")
    with contextlib.closing(sqlite3.connect(path)) as raw:
        for row, payload in raw.execute("SELECT id, payload FROM events").fetchall():
            fields = json.loads(payload)
            fields["text"] = {"caf?": "caf\udce9", "&31mred": "\x1b[31mred\x07"}[fields["text"]]
            raw.execute(
                "UPDATE events SET payload = ? WHERE id = ?", (json.dumps(fields).encode(), row)
            )
        raw.commit()
    shown = ran("show", path, "P01")
    assert "\x1b" not in shown
    assert "\x07" not in shown
    assert r": \x1b[31mred\x07" in shown
    assert r": caf\xe9" in shown
    ran("export", path, "-o", str(tmp_path / "tables"))
    assert r"caf\xe9" in (tmp_path / "tables" / "events.csv").read_text("utf-8")
    for name in ("P01.html", "P01.json"):
        ran("export", path, "-o", str(tmp_path / name), "--participant", "P01")
    page = (tmp_path / "P01.html").read_text("utf-8")
    assert r"caf\xe9" in page
    assert "\x1b" not in page
    bundle = json.loads((tmp_path / "P01.json").read_text("utf-8"))
    told = {e["resource"].get("event", {}).get("text") for e in bundle["entry"]}
    assert {r"caf\xe9", r"\x1b[31mred\x07"} <= told
    ran("export", path, "-o", str(tmp_path / "pages"), "--pages")


def test_bytes_that_are_no_text_are_refused(path: str) -> None:
    for text in ("caf\udce9", "\x1b[31mred"):
        done = run("rate", path, "P01", "--event", text)
        assert done.exit_code == 1
        assert "text: expected a text without control characters" in str(done.exception)
    assert json.loads(ran("show", path, "P01", "--json"))["events"] == []


@pytest.mark.parametrize("event", ["x" * 2001, "\x1b[31mred"])
def test_of_several_notes_all_are_stored_or_none(path: str, event: str) -> None:
    rest = ("--pain", "4", "--mcgill", RANKS, "--occasion", "baseline")
    assert run("rate", path, "P01", *rest, "--event", event).exit_code == 1
    ran("rate", path, "P01", *rest, "--event", "a sore stump")  # baseline is still free
    assert run("rate", path, "P01", *rest, "--event", "again").exit_code == 1
    found = json.loads(ran("show", path, "P01", "--json"))
    assert [len(found[name]) for name in ("ratings", "events", "questionnaires")] == [1, 1, 1]


def test_a_changed_audit_is_shown_and_then_named(path: str) -> None:
    ran("rate", path, "P01", "--pain", "6")
    assert json.loads(ran("check", path, "--json")) == {"diary": path, "participants": 1}
    line = ran("audit", path).splitlines()[-1]
    assert datetime.fromisoformat(" ".join(line.split()[:2])).tzinfo is not None
    with contextlib.closing(sqlite3.connect(path)) as raw:
        raw.execute("UPDATE audit SET action = 'consent' WHERE number = 2")
        raw.commit()
    done = run("audit", path)
    assert done.exit_code == 1
    assert "consent" in done.stdout
    assert "the audit is damaged: row 2 is not what was written" in str(done.exception)
    assert run("check", path).exit_code == 1


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--pain", "4", "--ppi", "3"), "--ppi: can only be given with --mcgill"),
        (("--pain", "4", "--occasion", "baseline"), "--occasion: can only be given with --mcgill"),
        (("--event", " "), "--event: expected words"),
    ],
)
def test_a_rating_with_an_option_that_would_be_lost_is_refused(
    path: str, words: tuple[str, ...], told: str
) -> None:
    done = run("rate", path, "P01", *words)
    assert done.exit_code == 1
    assert told in str(done.exception)
    found = json.loads(ran("show", path, "P01", "--json"))
    assert (found["ratings"], found["events"]) == ([], [])


def test_no_diary_is_made_for_a_pseudonym_that_is_none(tmp_path: Path) -> None:
    assert run("enrol", str(tmp_path / "new.diary"), "Jane Doe").exit_code == 1
    assert list(tmp_path.iterdir()) == []


def test_an_export_goes_by_its_suffix_in_capital_letters_too(path: str, tmp_path: Path) -> None:
    ran("export", path, "-o", str(tmp_path / "P01.JSON"), "--participant", "P01")
    assert json.loads((tmp_path / "P01.JSON").read_text())["resourceType"] == "Bundle"


@pytest.mark.parametrize("output", ["tables", "P01.json"])
def test_films_are_asked_for_only_where_they_are_shown(
    path: str, tmp_path: Path, output: str
) -> None:
    done = run("export", path, "-o", str(tmp_path / output), "--participant", "P01", "--clips")
    assert "--clips: expected --pages or -o NAME.html" in str(done.exception)
    assert not (tmp_path / output).exists()


@pytest.mark.parametrize(
    "words", [("export",), ("export", "--pages"), ("clips", "P01")], ids=lambda words: words[-1]
)
def test_files_of_others_are_told_before_force_is_offered(
    path: str, words: tuple[str, ...], tmp_path: Path
) -> None:
    verb, *more = words
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    for force in ([], ["--force"]):
        done = run(verb, path, *more, "-o", str(folder), *force)
        assert "holds other files (notes.txt); give another folder" in str(done.exception)
    (folder / "notes.txt").unlink()
    assert "--force replaces it" in str(run(verb, path, *more, "-o", str(folder)).exception)


def test_an_edited_questionnaire_or_a_key_is_never_replaced(tmp_path: Path) -> None:
    """The error offers no --force, which these commands do not have."""
    for words in (("form", "ownership", "-o"), ("keygen",)):
        place = tmp_path / "mine.json"
        place.write_text("edited")
        done = run(*words, str(place))
        assert str(done.exception).endswith(f"{place}: exists already; give another name")
        assert place.read_text() == "edited"
