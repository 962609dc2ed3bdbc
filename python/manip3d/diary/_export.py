"""Exports of diaries for other programs: tables (CSV) and FHIR R4."""

from __future__ import annotations

import csv
import io
import json
import os
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.paths import legible_path_of, refuse_existing
from manip3d._util.texts import legible
from manip3d.diary._diary import Diary
from manip3d.diary._protocol import STOP_RISE, is_stop_reason
from manip3d.diary._records import (
    CLOCK_WENT_BACK,
    NOT_ANSWERED,
    AdverseEvent,
    Answers,
    DiaryGame,
    DiarySession,
    FeltRecord,
    McGill,
    Ownership,
    Participant,
    Rating,
)
from manip3d.errors import InputError
from manip3d.io._files import atomic_folder, atomic_write, refuse_other_files

_NAMESPACE = uuid.UUID("6f6d1f6e-3f0b-5a52-9a7b-6d3364696172")
_SURVEY = {
    "coding": [
        {
            "system": "http://terminology.hl7.org/CodeSystem/observation-category",
            "code": "survey",
            "display": "Survey",
        }
    ]
}
_PAIN = {
    "coding": [
        {
            "system": "http://loinc.org",
            "code": "72514-3",
            "display": "Pain severity - 0-10 verbal numeric rating [Score] - Reported",
        }
    ],
    "text": "Phantom limb pain, 0 to 10",
}
_WHEN = {"before": "before play", "after": "after the start of play"}
_GAME_COLUMNS = (
    "game", "difficulty", "seed", "ending", "seconds", "paused_s", "score", "misses", "by_phantom",
    "gain", "limb", "source", "version", "latency_ms", "tracked",
)  # fmt: skip


# --- tables ---------------------------------------------------------------------------------------


@checked
def export_csv(
    diary: Diary,
    output: str | os.PathLike[str],
    *,
    participants: Sequence[str] | None = None,
    overwrite: bool = False,
) -> None:
    """Write a diary as a folder of tables.

    The tables are participants, sessions, games, anomalies, ratings, questionnaires, events,
    ownership, felt limbs, and answers, with one answer or score of a questionnaire per row.

    Parameters
    ----------
    diary : Diary
    output : path
        Folder to create.
    participants : sequence of str, optional
        Pseudonyms of the participants to export; default: all.
    overwrite : bool
        Replace a folder that contains only such tables.

    Raises
    ------
    InputError
        No such participant, the folder exists, or its path has control characters or is not UTF-8.
    OSError
        The folder cannot be written.

    Examples
    --------
    >>> import os
    >>> from manip3d.diary import Diary, export_csv
    >>> with Diary("tables.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     export_csv(diary, "tables")
    >>> "games.csv" in os.listdir("tables")
    True
    """
    target = legible_path_of(output, "output")
    refuse_existing(target, overwrite=overwrite, name="output")
    refuse_other_files(target, is_exported_table)
    chosen = _chosen(diary, participants)
    tables = _tables(diary, chosen)
    for identifier in chosen:
        diary.note_export(identifier)
    with atomic_folder(target) as folder:
        for name, (columns, rows) in tables.items():
            text = io.StringIO()
            writer = csv.writer(text)
            writer.writerow(columns)
            writer.writerows([[_cell(value) for value in row] for row in rows])
            (folder / f"{name}.csv").write_text(text.getvalue(), encoding="utf-8", newline="")
    for identifier in chosen:
        diary.note_files(identifier, [target / f"{name}.csv" for name in tables])


def _chosen(diary: Diary, participants: Sequence[str] | None) -> list[str]:
    if isinstance(participants, str):
        raise InputError("participants: expected a sequence of pseudonyms, got one text")
    if participants is None:
        return [person.identifier for person in diary.participants()]
    return [diary.participant(identifier).identifier for identifier in participants]


def _cell(value: Any) -> Any:
    """Return a cell; an apostrophe precedes texts that a spreadsheet would take for a formula."""
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, str):
        text = legible(value)
        return f"'{text}" if value[:1] in ("=", "+", "-", "@", "\t", "\r") else text
    return "" if value is None else value


@dataclass(frozen=True)
class _Entries:
    """All records of a participant; each kind is read once."""

    person: Participant
    sessions: Sequence[DiarySession]
    ratings: Sequence[Rating]
    mcgill: Sequence[McGill]
    events: Sequence[AdverseEvent]
    ownership: Sequence[Ownership]
    felt: Sequence[FeltRecord]
    answers: Sequence[Answers]

    @classmethod
    def of(cls, diary: Diary, name: str) -> _Entries:
        return cls(
            diary.participant(name),
            diary.sessions(name),
            diary.ratings(name),
            diary.mcgill(name),
            diary.events(name),
            diary.ownership(name),
            diary.felt(name),
            diary.answers(name),
        )


_Rows = Iterator[Sequence[Any]]
"""Rows of a table without their first column, the participant's pseudonym."""


def _participant_rows(entries: _Entries) -> _Rows:
    person = entries.person
    yield person.limb, person.enrolled, person.clips


def _session_rows(entries: _Entries) -> _Rows:
    for count, session in enumerate(entries.sessions, 1):
        pain = session.pain_before, session.pain_after
        about = session.answered, session.clock_went_back
        yield count, session.started, session.ended, len(session.games), *pain, *about


def _games(entries: _Entries) -> Iterator[tuple[int, int, DiaryGame]]:
    """Yield the number of the session, the number of the game within it, and the game."""
    for count, session in enumerate(entries.sessions, 1):
        for number, game in enumerate(session.games, 1):
            yield count, number, game


def _game_rows(entries: _Entries) -> _Rows:
    for count, number, game in _games(entries):
        yield count, number, game.at, *(getattr(game, column) for column in _GAME_COLUMNS)


def _anomaly_rows(entries: _Entries) -> _Rows:
    for count, number, game in _games(entries):
        for start, end in game.anomalies:
            yield count, number, start, end


def _rating_rows(entries: _Entries) -> _Rows:
    for rating in entries.ratings:
        yield rating.at, rating.when, rating.pain


def _mcgill_rows(entries: _Entries) -> _Rows:
    for filled in entries.mcgill:
        yield filled.at, filled.occasion, *asdict(filled.score).values(), *filled.ranks


def _event_rows(entries: _Entries) -> _Rows:
    for event in entries.events:
        yield event.at, event.kind, event.text


def _ownership_rows(entries: _Entries) -> _Rows:
    for one in entries.ownership:
        yield one.at, one.mode, round(one.ownership, 3), round(one.control, 3), *one.answers


def _felt_rows(entries: _Entries) -> _Rows:
    for felt in entries.felt:
        yield felt.at, felt.limb, felt.length, felt.telescoping, felt.raised, felt.bent


def _answer_rows(entries: _Entries) -> _Rows:
    for filled in entries.answers:
        asked = filled.questionnaire
        about = filled.at, asked.name, asked.sha256, filled.occasion
        given = zip(asked.items, filled.answers, strict=True)
        for number, (item, answer) in enumerate(given, 1):
            yield *about, "item", number, item.text, answer
        for name, value in filled.scores.items():
            yield *about, "scale", name, "", value


def is_exported_table(name: str) -> bool:
    """Return whether `export_csv` writes a file of this name into its folder."""
    return name in {f"{table}.csv" for table in _TABLES}


_TABLES: Mapping[str, tuple[Sequence[str], Callable[[_Entries], _Rows]]] = {
    "participants": (("limb", "enrolled", "clips"), _participant_rows),
    "sessions": (("session", "started", "ended", "games", "pain_before", "pain_after", "answered",
                  "clock_went_back"), _session_rows),
    "games": (("session", "number", "at", *_GAME_COLUMNS), _game_rows),
    "anomalies": (("session", "game", "start_s", "end_s"), _anomaly_rows),
    "ratings": (("at", "when", "pain"), _rating_rows),
    "questionnaires": (("at", "occasion", "sensory", "affective", "evaluative", "miscellaneous",
                        "pri", "nwc", "ppi", *(f"rank_{n}" for n in range(1, 21))), _mcgill_rows),
    "events": (("at", "kind", "text"), _event_rows),
    "ownership": (("at", "mode", "ownership", "control", *(f"q{n}" for n in range(1, 7))),
                  _ownership_rows),
    "felt": (("at", "limb", "length", "telescoping", "raised", "bent"), _felt_rows),
    "answers": (("at", "questionnaire", "sha256", "occasion", "kind", "name", "text", "value"),
                _answer_rows),
}  # fmt: skip
"""Columns of each table after the participant's, and the function that yields its rows."""

_Tables = Mapping[str, tuple[Sequence[str], list[list[Any]]]]


def _tables(diary: Diary, identifiers: Iterable[str]) -> _Tables:
    people = {name: _Entries.of(diary, name) for name in identifiers}
    return {
        table: (
            ("participant", *columns),
            [[name, *row] for name, entries in people.items() for row in rows_of(entries)],
        )
        for table, (columns, rows_of) in _TABLES.items()
    }


# --- FHIR -----------------------------------------------------------------------------------------


@checked
def export_fhir(
    diary: Diary, output: str | os.PathLike[str], identifier: str, *, overwrite: bool = False
) -> None:
    """Write `fhir_bundle` as JSON.

    Parameters
    ----------
    diary : Diary
    output : path
        File to write.
    identifier : str
        Pseudonym of the participant.
    overwrite : bool
        Replace the file if it exists.

    Raises
    ------
    InputError
        No such participant, the file exists, or its path has control characters or is not UTF-8.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> from manip3d.diary import Diary, export_fhir
    >>> with Diary("export.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     export_fhir(diary, "P01.json", "P01")
    """
    target = legible_path_of(output, "output")
    refuse_existing(target, overwrite=overwrite, name="output")
    diary.expect_other_file(target)
    bundle = fhir_bundle(diary, identifier)
    diary.note_export(identifier)
    atomic_write(target, json.dumps(bundle, indent=1) + "\n")
    diary.note_files(identifier, [target])


@checked
def fhir_bundle(diary: Diary, identifier: str) -> dict[str, Any]:
    """Make a FHIR R4 Bundle (a collection) of a participant.

    It contains a Patient, Observations, AdverseEvents and QuestionnaireResponses.

    Ratings have LOINC's code 72514-3. Sessions, games, the McGill indices, answers after touch cues
    and the felt limb, for which no code exists, are named in words. Each resource has the same
    ``fullUrl`` in every export, which is unique across studies. The system of the patient's
    identifier is `Diary.study`.

    Parameters
    ----------
    diary : Diary
    identifier : str
        Pseudonym of the participant.

    Returns
    -------
    dict
        The bundle, as JSON values.

    Raises
    ------
    InputError
        No such participant.

    Examples
    --------
    >>> from manip3d.diary import Diary, fhir_bundle
    >>> with Diary("bundle.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     fhir_bundle(diary, "P01")["entry"][0]["resource"]["resourceType"]
    'Patient'
    """
    person = diary.participant(identifier)
    found: dict[str, dict[str, Any]] = {}  # resources by their full URLs
    about = {"reference": _url("participants", person.number)}
    found[about["reference"]] = {
        "resourceType": "Patient",
        "identifier": [{"system": f"urn:uuid:{diary.study}", "value": person.identifier}],
    }
    for rating in diary.ratings(identifier):
        pain = found[_url("ratings", rating.number)] = _observation(_PAIN, about, rating.at)
        pain["valueInteger"] = rating.pain
        if rating.when != "other":
            pain["note"] = [{"text": _WHEN[rating.when]}]
    for one in diary.mcgill(identifier):
        found[_url("questionnaires", one.number)] = _questionnaire(one, about)
    for cue in diary.ownership(identifier):
        found[_url("questionnaires", cue.number)] = _ownership(cue, about)
    for felt in diary.felt(identifier):
        found[_url("questionnaires", felt.number)] = _felt(felt, about)
    for filled in diary.answers(identifier):
        found |= _answered(filled, found, about)
    for session in diary.sessions(identifier):
        games = {_url("games", game.number): _game(game, about) for game in session.games}
        found |= games
        members = [{"reference": url} for url in games]
        found[_url("sessions", session.number)] = _session(session, about, members)
    for event in diary.events(identifier):
        found[_url("events", event.number)] = _event(event, about)
    return {
        "resourceType": "Bundle",
        "type": "collection",
        "timestamp": datetime.now().astimezone().isoformat(),
        "entry": [
            {"fullUrl": url, "resource": _legible(resource)} for url, resource in found.items()
        ],
    }


def _legible(value: Any) -> Any:
    """Replace characters that FHIR or UTF-8 refuses; texts of older diaries may contain some."""
    if isinstance(value, dict):
        return {name: _legible(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_legible(part) for part in value]
    return legible(value) if isinstance(value, str) else value


def _url(table: str, row: int) -> str:
    """Return the URL of a row, the same in every export because row numbers are permanent."""
    return f"urn:uuid:{uuid.uuid5(_NAMESPACE, f'{table}/{row}')}"


def _event(event: AdverseEvent, patient: Mapping[str, str]) -> dict[str, Any]:
    told = {"pain": "Pain", "sickness": "Sickness"}.get(event.kind, "")
    if event.kind == "pain" and is_stop_reason(event.text):  # a therapist may report any pain
        told = f"Pain rose by {STOP_RISE} or more during a session"
    words = ": ".join(part for part in (told, event.text.strip()) if part)
    return {
        "resourceType": "AdverseEvent",
        "actuality": "actual",
        "event": {"text": words or "Adverse event"},
        "subject": patient,
        "date": event.at.isoformat(),
    }


def _observation(
    code: Mapping[str, Any], patient: Mapping[str, str], at: datetime
) -> dict[str, Any]:
    return {
        "resourceType": "Observation",
        "status": "final",
        "category": [_SURVEY],
        "code": code,
        "subject": patient,
        "effectiveDateTime": at.isoformat(),
    }


def _seconds(value: float) -> dict[str, Any]:
    return _quantity(value, "s")


def _quantity(value: float, unit: str) -> dict[str, Any]:
    return {"value": value, "unit": unit, "system": "http://unitsofmeasure.org", "code": unit}


def _questionnaire(filled: McGill, patient: Mapping[str, str]) -> dict[str, Any]:
    names = {
        "sensory": "Pain rating index, sensory (0 to 42)",
        "affective": "Pain rating index, affective (0 to 14)",
        "evaluative": "Pain rating index, evaluative (0 to 5)",
        "miscellaneous": "Pain rating index, miscellaneous (0 to 17)",
        "pri": "Pain rating index (0 to 78)",
        "nwc": "Number of words chosen (0 to 20)",
        "ppi": "Present pain intensity (0 to 5)",
    }
    found = _observation({"text": "McGill Pain Questionnaire"}, patient, filled.at)
    found["note"] = [{"text": filled.occasion}]
    found["component"] = [
        {"code": {"text": names[name]}, "valueInteger": value}
        for name, value in asdict(filled.score).items()
    ]
    return found


def _answered(
    filled: Answers, found: Mapping[str, dict[str, Any]], patient: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Return the response, and the observation of its scores, which is derived from it."""
    response, url = _url("responses", filled.number), _url("questionnaires", filled.number)
    scores = found.get(url) or _scores(filled, patient)
    return {
        response: _response(filled, patient),
        url: scores | {"derivedFrom": [{"reference": response}]},
    }


def _response(filled: Answers, patient: Mapping[str, str]) -> dict[str, Any]:
    asked = filled.questionnaire
    return {
        "resourceType": "QuestionnaireResponse",
        "questionnaire": f"urn:uuid:{uuid.uuid5(_NAMESPACE, f'questionnaire/{asked.sha256}')}",
        "status": "completed",
        "subject": patient,
        "authored": filled.at.isoformat(),
        "item": [
            {"linkId": str(number), "text": item.text, "answer": [{"valueInteger": answer}]}
            for number, (item, answer) in enumerate(
                zip(asked.items, filled.answers, strict=True), 1
            )
        ],
    }


def _scores(filled: Answers, patient: Mapping[str, str]) -> dict[str, Any]:
    found = _observation({"text": filled.questionnaire.name}, patient, filled.at)
    found["note"] = [{"text": filled.occasion}]
    scores = filled.scores
    if scores:
        found["component"] = [
            {"code": {"text": name}, "valueQuantity": {"value": round(value, 3)}}
            for name, value in scores.items()
        ]
    return found


def _ownership(cue: Ownership, patient: Mapping[str, str]) -> dict[str, Any]:
    found = _observation({"text": "Ownership of the limb after a touch cue"}, patient, cue.at)
    parts: list[dict[str, Any]] = [{"code": {"text": "Touch"}, "valueString": cue.mode}]
    parts += [
        {"code": {"text": f"{told} (-3 to 3)"}, "valueQuantity": {"value": round(value, 3)}}
        for told, value in (
            ("Ownership, mean of questions 1 to 3", cue.ownership),
            ("Control questions, mean of 4 to 6", cue.control),
        )
    ]
    parts += [
        {"code": {"text": f"Question {number} (-3 to 3)"}, "valueInteger": answer}
        for number, answer in enumerate(cue.answers, 1)
    ]
    found["component"] = parts
    return found


def _felt(felt: FeltRecord, patient: Mapping[str, str]) -> dict[str, Any]:
    found = _observation({"text": "Phantom limb as it is felt"}, patient, felt.at)
    if felt.limb:
        found["bodySite"] = {"text": felt.limb.replace("_", " ")}
    found["component"] = [
        {"code": {"text": told}, "valueQuantity": _quantity(value, unit)}
        for told, value, unit in (
            ("Length, of the intact limb's", felt.length, "%"),
            ("Telescoping: how far the end has moved up into the stump", felt.telescoping, "%"),
            ("Raised sideways from hanging down", felt.raised, "deg"),
            ("Bent at elbow or knee", felt.bent, "deg"),
        )
    ]
    return found


def _game(game: DiaryGame, patient: Mapping[str, str]) -> dict[str, Any]:
    """Return a game as a FHIR observation, whose components are its scores and circumstances."""
    found = _observation({"text": f"Exercise game {game.game}"}, patient, game.at)
    if game.ending == "interrupted":
        found["status"] = "preliminary"
    parts: list[dict[str, Any]] = [
        {"code": {"text": text}, "valueInteger": value}
        for text, value in (
            ("Score", game.score),
            ("Of these with the phantom limb", game.by_phantom),
            ("Misses", game.misses),
            ("Difficulty (1 to 3)", game.difficulty),
        )
    ]
    parts += [
        {"code": {"text": text}, "valueQuantity": _seconds(value)}
        for text, value in (("Played", game.seconds), ("Paused", game.paused_s))
    ]
    parts.append({"code": {"text": "Ending"}, "valueString": game.ending})
    if game.gain != 1.0:
        told = "Gain of movements (virtual enhancement)"
        parts.append({"code": {"text": told}, "valueQuantity": {"value": game.gain}})
    parts += [
        {"code": {"text": text}, "valueString": value}
        for text, value in (
            ("Limb", game.limb.replace("_", " ")),
            ("Source of the frames", game.source),
            ("Version of manip3d", game.version),
        )
        if value
    ]
    if game.latency_ms is not None:
        told = "Latency, 95th percentile"
        parts.append({"code": {"text": told}, "valueQuantity": _quantity(game.latency_ms, "ms")})
    if game.tracked is not None:
        told = "Share of frames in which the phantom limb was followed"
        parts.append({"code": {"text": told}, "valueQuantity": {"value": game.tracked}})
    parts += [
        {
            "code": {"text": "Seconds of play without a point though a target was in reach"},
            "valueRange": {"low": _seconds(start), "high": _seconds(end)},
        }
        for start, end in game.anomalies
    ]
    found["component"] = parts
    return found


def _session(
    session: DiarySession, patient: Mapping[str, str], members: list[dict[str, str]]
) -> dict[str, Any]:
    found = _observation({"text": "Phantom limb exercise session"}, patient, session.started)
    del found["effectiveDateTime"]
    period = {"start": session.started.isoformat()}
    if session.ended is not None:
        period["end"] = session.ended.isoformat()
    found["effectivePeriod"] = period
    found["valueInteger"] = len(session.games)  # number of games
    facts = (not session.answered, NOT_ANSWERED), (session.clock_went_back, CLOCK_WENT_BACK)
    if notes := [{"text": text} for is_so, text in facts if is_so]:
        found["note"] = notes
    if members:
        found["hasMember"] = members
    return found
