"""Copies for other programs: tables that a spreadsheet reads, and bundles that are FHIR."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

from manip3d import FormatError, InputError

pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
pytest.importorskip("cryptography", reason="the extra 'diary' is not installed")

pytest.importorskip("scipy", reason="the extra 'diary' is not installed")
pytest.importorskip("PIL.Image", reason="the extra 'diary' is not installed")

from PIL import Image

from manip3d.diary import (
    Diary,
    DiaryGame,
    export_clips,
    export_csv,
    export_fhir,
    fhir_bundle,
    film,
    write_page,
)

START = datetime(2026, 3, 2, 9, 0, tzinfo=timezone(timedelta(hours=1)))


@pytest.fixture
def diary(tmp_path: Path) -> Iterator[Diary]:
    with Diary(tmp_path / "study.diary", create=True) as found:
        for name in ("P01", "P02"):
            found.enrol(name, limb="right_leg", at=START)
            session = found.start_session(name, at=START)
            found.add_rating(name, 5, session=session, at=START)
            for number, title in enumerate(("pedal", "piano")):
                found.add_game(
                    session,
                    DiaryGame(
                        START + timedelta(minutes=number + 1), title, 1, number, "time", 60.0, 1.25,
                        12, 3, 6, ((2.0, 14.5),) if number else (),
                    ),
                )  # fmt: skip
            found.add_rating(name, 7, session=session, at=START + timedelta(minutes=4))
            found.add_event(name, "sickness", at=START)
            found.add_event(name, "other", '=HYPERLINK(1)\nfell, "slowly"', at=START)
            found.add_mcgill(name, [1] * 20, 3, occasion="week-1", at=START)
            if name == "P01":
                found.add_ownership(name, "synchronous", [3, 2, 2, -3, 0, 0], at=START)
                found.add_felt(
                    name, length=60, telescoping=25, raised=-10, bent=90, limb="left_leg", at=START
                )
        found.start_session("P01", at=START + timedelta(hours=8))  # goes on
        yield found


def rows(folder: Path, name: str) -> list[dict[str, str]]:
    with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_tables_hold_everything(diary: Diary, tmp_path: Path) -> None:
    folder = tmp_path / "tables"
    export_csv(diary, folder)
    assert [row["participant"] for row in rows(folder, "participants")] == ["P01", "P02"]
    sessions = rows(folder, "sessions")
    assert [(row["games"], row["pain_before"], row["pain_after"]) for row in sessions] == [
        ("2", "5", "7"), ("0", "", ""), ("2", "5", "7"),
    ]  # fmt: skip
    games = rows(folder, "games")
    assert [row["game"] for row in games] == ["pedal", "piano"] * 2
    assert (games[1]["score"], games[1]["by_phantom"], games[1]["seconds"]) == ("12", "6", "60.0")
    assert rows(folder, "anomalies")[0] == {
        "participant": "P01", "session": "1", "game": "2", "start_s": "2.0", "end_s": "14.5",
    }  # fmt: skip
    assert [row["pain"] for row in rows(folder, "ratings")] == ["5", "7", "5", "7"]
    (first, _) = rows(folder, "questionnaires")
    assert (first["pri"], first["nwc"], first["ppi"], first["rank_20"]) == ("20", "20", "3", "1")
    told = {row["kind"]: row["text"] for row in rows(folder, "events")}
    assert told["other"] == '\'=HYPERLINK(1)\nfell, "slowly"'  # no formula
    assert "rose from 5 to 7" in told["pain"]
    assert [a for _, a, _ in diary.audit()].count("export") == 2


def test_answers_after_touch_and_felt_limbs_are_exported(diary: Diary, tmp_path: Path) -> None:
    given = diary.add_ownership("P02", "synchronous", [3, 2, 1, -3, 0, 0], at=START)
    assert (given.ownership, given.control) == (2.0, -1.0)
    assert len(diary.mcgill("P01")) == 1  # McGill's alone
    export_csv(diary, tmp_path / "tables")
    first, answers = rows(tmp_path / "tables", "ownership")
    assert (first["participant"], answers["participant"]) == ("P01", "P02")
    assert (answers["mode"], answers["ownership"], answers["q4"]) == ("synchronous", "2.0", "-3")
    (felt,) = rows(tmp_path / "tables", "felt")
    assert [felt[n] for n in ("limb", "length", "telescoping", "raised", "bent")] == [
        "left_leg",
        "60",
        "25",
        "-10",
        "90",
    ]
    write_page(diary, tmp_path / "P01.html", "P01")
    page = (tmp_path / "P01.html").read_text()
    assert "+2.3" in page
    assert "25 %" in page
    for wrong in ([3] * 5, [4, 0, 0, 0, 0, 0]):
        with pytest.raises(InputError, match="answers: expected 6 from -3 to 3"):
            diary.add_ownership("P01", "synchronous", wrong)
    with pytest.raises(InputError, match="mode: expected 'synchronous' or 'asynchronous'"):
        diary.add_ownership("P01", "both", [0] * 6)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="bent: expected 0 to 150, got 151"):
        diary.add_felt("P01", length=60, telescoping=0, raised=0, bent=151)
    diary.check()


def test_some_participants_and_existing_folders(diary: Diary, tmp_path: Path) -> None:
    folder = tmp_path / "tables"
    export_csv(diary, folder, participants=["P02"])
    assert {row["participant"] for row in rows(folder, "games")} == {"P02"}
    with pytest.raises(InputError, match="exists already; overwrite=True replaces it"):
        export_csv(diary, folder)
    export_csv(diary, folder, overwrite=True)
    assert {row["participant"] for row in rows(folder, "games")} == {"P01", "P02"}
    (folder / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match=r"holds other files: thesis.txt"):
        export_csv(diary, folder, overwrite=True)
    assert (folder / "thesis.txt").exists()
    with pytest.raises(InputError, match="'P7' is not enrolled"):
        export_csv(diary, tmp_path / "more", participants=["P7"])
    assert not (tmp_path / "more").exists()


def test_the_page_says_what_the_diary_says_and_runs_nothing(diary: Diary, tmp_path: Path) -> None:
    diary.add_event("P01", "other", "<script>alert(1)</script>", at=START)
    write_page(diary, tmp_path / "P01.html", "P01", today=START.date())
    text = (tmp_path / "P01.html").read_text()
    assert "0 of 2 sessions with all 3 games (0%) up to day 1, 1 more in part" in text
    assert "pedal 12, piano 12" in text
    assert "piano 2 to 14 s" in text
    assert "The pain rose from 5 to 7." in text
    assert "not a medical device" in text
    assert text.count('r="5"') == 2
    assert 'stroke="#a02b1d"' in text
    assert "<script" not in text
    assert "http" not in text
    with pytest.raises(InputError, match="exists already; overwrite=True replaces it"):
        write_page(diary, tmp_path / "P01.html", "P01")


def test_games_of_a_simulated_person_are_said_to_be_left_out(diary: Diary, tmp_path: Path) -> None:
    session = diary.sessions("P01")[0].number
    for number, source in enumerate(("sim:body?motion=reach", "openni2:")):
        played = DiaryGame(
            START + timedelta(minutes=20 + number), "bubbles", 1, 5, "time", 60.0, 0.0, 3, 1, 1,
            limb="right_arm", source=source, version="9.9", latency_ms=28.5, tracked=0.875,
        )  # fmt: skip
        diary.add_game(session, played)
    write_page(diary, tmp_path / "P01.html", "P01", today=START.date())
    text = (tmp_path / "P01.html").read_text()
    assert "1 of 2 sessions with all 3 games" in text
    assert "Left out: 1 of a simulated person." in text
    assert "piano 12, bubbles 3 (simulated person), bubbles 3<" in text
    export_csv(diary, tmp_path / "tables", participants=["P01"])
    row = rows(tmp_path / "tables", "games")[-1]
    assert (row["limb"], row["source"], row["version"]) == ("right_arm", "openni2:", "9.9")
    assert (row["latency_ms"], row["tracked"]) == ("28.5", "0.875")
    resources = [entry["resource"] for entry in fhir_bundle(diary, "P01")["entry"]]
    (parts,) = [
        {c["code"]["text"]: c for c in one["component"]}
        for one in resources
        if "openni2:" in json.dumps(one)
    ]
    assert parts["Latency, 95th percentile"]["valueQuantity"]["value"] == 28.5
    assert parts["Limb"]["valueString"] == "right arm"


def test_the_bundle_is_fhir(diary: Diary, tmp_path: Path) -> None:
    """The bundle fits strict models that were generated from FHIR 4.0.1, which is R4."""
    base = pytest.importorskip("fhirclient.models.fhirabstractbase")
    bundles = pytest.importorskip("fhirclient.models.bundle")
    export_fhir(diary, tmp_path / "P01.json", "P01")
    content = json.loads((tmp_path / "P01.json").read_text())
    bundle = bundles.Bundle(content)  # strict: unknown, absent and wrong elements are errors
    assert bundle.as_json() == content
    broken = json.loads(json.dumps(content))
    broken["entry"][1]["resource"]["status"] = None
    broken["entry"][1]["resource"]["code"] = {"txt": "pain"}
    with pytest.raises(base.FHIRValidationError) as refused:
        bundles.Bundle(broken)
    assert all(f'"{name}"' in str(refused.value) for name in ("status", "code", "txt"))


def test_the_bundle_says_what_the_diary_says(diary: Diary) -> None:
    bundle = fhir_bundle(diary, "P01")
    resources: list[dict[str, Any]] = [entry["resource"] for entry in bundle["entry"]]
    kinds = [resource["resourceType"] for resource in resources]
    assert (kinds[0], kinds.count("Patient"), kinds.count("AdverseEvent")) == ("Patient", 1, 3)
    urls = [entry["fullUrl"] for entry in bundle["entry"]]
    assert len(set(urls)) == len(urls)
    assert {r["subject"]["reference"] for r in resources[1:]} == {urls[0]}
    pain = [r for r in resources if "coding" in r.get("code", {})]
    assert {r["code"]["coding"][0]["code"] for r in pain} == {"72514-3"}
    assert [r["valueInteger"] for r in pain] == [5, 7]
    assert pain[0]["effectiveDateTime"] == "2026-03-02T09:00:00+01:00"
    (mcgill,) = [r for r in resources if r.get("code", {}).get("text", "").startswith("McGill")]
    assert {c["code"]["text"]: c["valueInteger"] for c in mcgill["component"]}[
        "Pain rating index (0 to 78)"
    ] == 20
    touch, felt = (
        {c["code"]["text"]: c for c in r["component"]}
        for told in ("Ownership of the limb after a touch cue", "Phantom limb as it is felt")
        for r in resources
        if r.get("code", {}).get("text") == told
    )
    assert touch["Touch"]["valueString"] == "synchronous"
    assert touch["Question 4 (-3 to 3)"]["valueInteger"] == -3
    means = [one["valueQuantity"]["value"] for one in touch.values() if "valueQuantity" in one]
    assert means == [2.333, -1.0]
    quantities = [one["valueQuantity"] for one in felt.values()]
    assert [(one["value"], one["code"]) for one in quantities] == [
        (60, "%"), (25, "%"), (-10, "deg"), (90, "deg"),
    ]  # fmt: skip
    session = next(r for r in resources if "effectivePeriod" in r)
    assert "end" not in session["effectivePeriod"]
    members = [urls.index(member["reference"]) for member in session["hasMember"]]
    texts = [resources[member]["code"]["text"] for member in members]
    assert texts == ["Exercise game pedal", "Exercise game piano"]
    ranges = [c["valueRange"] for c in resources[members[1]]["component"] if "valueRange" in c]
    assert [(r["low"]["value"], r["high"]["value"]) for r in ranges] == [(2.0, 14.5)]
    with pytest.raises(InputError, match="'P7' is not enrolled"):
        fhir_bundle(diary, "P7")


def test_resources_keep_their_names_and_share_them_with_no_other_study(
    diary: Diary, tmp_path: Path
) -> None:
    def names(of: Diary) -> dict[str, dict[str, Any]]:
        return {e["fullUrl"]: e["resource"] for e in fhir_bundle(of, "P01")["entry"]}

    before = names(diary)
    diary.add_rating("P01", 9, at=START - timedelta(days=1))
    diary.add_event("P01", "sickness", "after a turn", at=START - timedelta(days=1))
    after = names(diary)
    assert len(after) == len(before) + 2
    assert {name: after[name] for name in before} == before
    with Diary(tmp_path / "other.diary", create=True) as other:
        other.enrol("P01", limb="right_leg", at=START)
        other.add_rating("P01", 5)
        assert not set(names(other)) & set(after)
        patients = [
            next(one for one in found.values() if one["resourceType"] == "Patient")
            for found in (names(other), after)
        ]
        assert [one["identifier"][0] for one in patients] == [
            {"system": f"urn:uuid:{study.study}", "value": "P01"} for study in (other, diary)
        ]
        assert other.study != diary.study
    with Diary(diary.path) as again:
        assert names(again) == after


def test_an_adverse_event_keeps_its_words(diary: Diary) -> None:
    diary.add_event("P01", "sickness", "after a turn", at=START)
    texts = [
        entry["resource"]["event"]["text"]
        for entry in fhir_bundle(diary, "P01")["entry"]
        if entry["resource"]["resourceType"] == "AdverseEvent"
    ]
    assert "Sickness: after a turn" in texts
    assert "Sickness" in texts
    assert any("session: The pain rose from 5 to 7." in text for text in texts)


def test_a_pain_that_a_therapist_reports_is_not_said_to_have_risen(diary: Diary) -> None:
    diary.add_event("P01", "pain", "the stump burns", at=START)
    texts = [
        entry["resource"]["event"]["text"]
        for entry in fhir_bundle(diary, "P01")["entry"]
        if entry["resource"]["resourceType"] == "AdverseEvent"
    ]
    assert "Pain: the stump burns" in texts
    assert sum("rose by 2 or more" in text for text in texts) == 1  # the stop rule's


def test_a_rating_in_play_is_not_said_to_be_after_the_session(diary: Diary) -> None:
    diary.enrol("P03", at=START)
    session = diary.start_session("P03", at=START)
    diary.add_rating("P03", 2, session=session, at=START)
    diary.begin_play(session, at=START)
    diary.add_rating("P03", 3, session=session, at=START + timedelta(seconds=50))
    diary.add_rating("P03", 4, at=START + timedelta(hours=1))
    notes = {
        resource["valueInteger"]: resource.get("note")
        for resource in (entry["resource"] for entry in fhir_bundle(diary, "P03")["entry"])
        if "coding" in resource.get("code", {})
    }
    before, after = "before play", "after the start of play"
    assert notes == {2: [{"text": before}], 3: [{"text": after}], 4: None}


def photo(shade: int) -> bytes:
    content = io.BytesIO()
    Image.new("RGB", (64, 48), (shade, 90, 40)).save(content, "JPEG")
    return content.getvalue()


def test_films_of_any_game_have_names_for_every_system(diary: Diary, tmp_path: Path) -> None:
    diary.set_consent("P01", clips=True)
    session = diary.sessions("P01")[0].number
    name = 'Jeu: "niveau" 2?'
    played = DiaryGame(START, name, 1, 5, "time", 60.0, 0.0, 3, 1, 1, ((6.0, 19.0),))
    diary.add_game(session, played, [[(1.0, photo(60)), (1.1, photo(70))]])
    assert diary.clips("P01")[0].game == name
    (path,) = export_clips(diary, tmp_path / "films", "P01")
    assert path.name == f"P01-{START:%Y-%m-%d-%H%M}-Jeu_ _niveau_ 2_-001.webp"
    assert export_clips(diary, tmp_path / "films", "P01", overwrite=True) == [path]


def test_films_of_difficulties(diary: Diary, tmp_path: Path) -> None:
    diary.set_consent("P01", clips=True)
    session = diary.sessions("P01")[0].number
    when = START + timedelta(minutes=30)
    played = DiaryGame(when, "bubbles", 1, 5, "time", 60.0, 0.0, 3, 1, 1, ((6.0, 19.0),))
    pictures = [(1.0 + 0.1 * number, photo(60 + 10 * number)) for number in range(12)]
    diary.add_game(session, played, [pictures])
    (clip,) = diary.clips("P01")
    with Image.open(io.BytesIO(film(clip))) as moving:
        assert (moving.format, moving.n_frames, moving.size) == ("WEBP", 12, (64, 48))
        moving.seek(11)
        assert moving.convert("RGB").getpixel((9, 9))[0] == pytest.approx(170, abs=6)
    (path,) = export_clips(diary, tmp_path / "films", "P01")
    assert path.read_bytes() == film(clip)
    assert path.name == f"P01-{when:%Y-%m-%d-%H%M}-bubbles-001.webp"
    with pytest.raises(InputError, match="exists already; overwrite=True replaces it"):
        export_clips(diary, tmp_path / "films", "P01")
    export_clips(diary, tmp_path / "films", "P01", overwrite=True)
    for others in ("letter.txt", path.name.replace("P01", "P02")):  # films of somebody else, too
        other = tmp_path / "films" / others
        other.write_text("mine")
        with pytest.raises(InputError, match=f"holds other files: {others}"):
            export_clips(diary, tmp_path / "films", "P01", overwrite=True)
        other.unlink()
    write_page(diary, tmp_path / "with.html", "P01", clips=True)
    page = (tmp_path / "with.html").read_text()
    assert "no point from 6 to 19 s" in page
    assert page.count("data:image/webp;base64,") == 1
    write_page(diary, tmp_path / "without.html", "P01")
    assert "data:image/webp" not in (tmp_path / "without.html").read_text()
    with pytest.raises(FormatError, match="expected JPEG images"):
        film(replace(clip, pictures=((0.0, b"\xff\xd8 and no more"),)))
    with pytest.raises(InputError, match="expected pictures"):
        film(replace(clip, pictures=()))


def test_a_session_does_not_end_before_it_started(diary: Diary, tmp_path: Path) -> None:
    """The computer's clock was set back by an hour in the middle of a session."""
    session = diary.start_session("P02", at=START + timedelta(days=1))
    diary.end_session(session, at=START + timedelta(hours=23))
    found = diary.sessions("P02")
    assert [one.clock_went_back for one in found] == [False, True]
    assert found[-1].ended == found[-1].started == START + timedelta(days=1)
    resources = [entry["resource"] for entry in fhir_bundle(diary, "P02")["entry"]]
    ended = [one for one in resources if "end" in one.get("effectivePeriod", {})]
    assert [one["note"] for one in ended] == [
        [{"text": "The clock was set back during the session: its duration is unknown."}]
    ]
    period = ended[0]["effectivePeriod"]
    assert datetime.fromisoformat(period["start"]) <= datetime.fromisoformat(period["end"])
    export_csv(diary, tmp_path / "tables")
    told = [
        (row["ended"] != "", row["clock_went_back"])
        for row in rows(tmp_path / "tables", "sessions")
    ]
    assert told == [(False, "False"), (False, "False"), (False, "False"), (True, "True")]
    write_page(diary, tmp_path / "page.html", "P02")
    page = (tmp_path / "page.html").read_text()
    assert page.count("The clock was set back during the session: its duration is unknown.") == 1


def test_ratings_before_and_after_keep_their_order_if_the_clock_is_set_back(diary: Diary) -> None:
    session = diary.start_session("P02", at=START + timedelta(days=1))
    diary.add_rating("P02", 3, session=session, at=START + timedelta(days=1))
    diary.begin_play(session, at=START + timedelta(days=1, minutes=1))
    diary.add_rating("P02", 4, session=session, at=START)
    found = diary.sessions("P02")[-1]
    assert [(one.pain, one.when) for one in found.ratings] == [(3, "before"), (4, "after")]
    assert "rose from 3" in diary.add_rating("P02", 5, session=session, at=START)
