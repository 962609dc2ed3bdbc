"""``manip3d diary``: what patients played, how they felt, and whether it helps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from datetime import date, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from manip3d._util.texts import or_dash
from manip3d._util.times import dated
from manip3d.cli.options import Force, Json, Quiet
from manip3d.cli.phantom import LimbName
from manip3d.cli.terminal import Terminal, check_output, check_place, counted, naming_options, table
from manip3d.errors import FormatError, InputError, printable

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.diary import (
        AdverseEvent,
        Answers,
        Diary,
        DiaryAnalysis,
        DiarySession,
        Estimate,
        FeltRecord,
        McGill,
        Questionnaire,
    )

app = typer.Typer(
    name="diary",
    help="Keep digital diaries of studies: sessions, pain, analysis.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

File = Annotated[Path, typer.Argument(metavar="DIARY", help="The diary file.")]
Who = Annotated[str, typer.Argument(metavar="PARTICIPANT", help="The participant's pseudonym.")]
Key = Annotated[
    Path | None,
    typer.Option("--key", help="Key file of an encrypted diary, made by 'manip3d diary keygen'."),
]


class Occasion(StrEnum):
    """When a questionnaire was filled in."""

    baseline = "baseline"
    week_1 = "week-1"
    week_4 = "week-4"
    other = "other"


def _opened(path: Path, key: Path | None, *, create: bool = False) -> Diary:
    from manip3d.diary import Diary

    with naming_options("key"):
        return Diary(path, key=key, create=create)


@app.command("keygen")
def keygen(
    path: Annotated[Path, typer.Argument(metavar="KEY", help="File to make.")],
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Make a key file for an encrypted diary. Only its owner can read it.

    Keep the key apart from the diary, and keep a copy of it: without its key a diary is lost. An
    existing file is never replaced.

    Example: manip3d diary keygen study.key
    """
    from manip3d.diary import make_key

    check_place(path, force=None, option="KEY")
    make_key(path)
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"wrote {path}")
    shell.result({"key": str(path)})


@app.command("enrol")
def enrol(
    path: File,
    participant: Who,
    limb: Annotated[LimbName | None, typer.Option(help="The affected limb.")] = None,
    clips: Annotated[
        bool,
        typer.Option("--clips", help="The participant consents to short films of difficulties."),
    ] = False,
    key: Key = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Add a participant. A diary that does not exist is made, with --key an encrypted one.

    Use a pseudonym, and keep the person's name elsewhere. The days of the protocol are counted from
    today.

    Example: manip3d diary enrol study.diary P01 --limb left-leg
    """
    from manip3d.diary._records import identifier_of

    identifier_of(participant)  # no diary is made for somebody who cannot be enrolled
    with _opened(path, key, create=True) as diary:
        person = diary.enrol(
            participant, limb=limb.value.replace("-", "_") if limb else "", clips=clips
        )
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"enrolled {person.identifier} in {path}")
    shell.result(_plain(person))


@app.command("consent")
def consent(
    path: File,
    participant: Who,
    clips: Annotated[
        bool,
        typer.Option(
            "--clips/--no-clips", help="Whether the participant consents to films of difficulties."
        ),
    ],
    key: Key = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Note whether a participant consents to short films. Without consent, films are deleted.

    A film is made when the player scores no point for 10 s, and begins 5 s before. It shows the
    person before a grey background, without the room. When consent is withdrawn, the films that
    were exported before are listed: delete them.

    Example: manip3d diary consent study.diary P01 --clips
    """
    with _opened(path, key) as diary:
        failed: OSError | None = None
        try:
            diary.set_consent(participant, clips=clips)
        except OSError as error:
            if diary.participant(participant).clips != clips:
                raise
            failed = error  # deleted, but the file was not written anew
        left = [] if clips else [one.path for one in diary.exports(participant) if one.has_films]
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"{participant} {'consents' if clips else 'does not consent'} to films")
    for file in left:
        shell.say(printable(f"still shows films of {participant}: {file}"))
    shell.result({"participant": participant, "clips": clips, "left": [str(one) for one in left]})
    if failed is not None:
        raise failed


@app.command("clips")
def write_clips(
    path: File,
    participant: Who,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to make for the films.")],
    key: Key = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write the films of a participant into a folder. They are animated WebP, and not encrypted.

    Example: manip3d diary clips study.diary P01 -o clips
    """
    from manip3d.diary import export_clips
    from manip3d.diary._clips import is_film_of

    check_output(
        output,
        (),
        force=force,
        folder=True,
        is_ours=lambda name: is_film_of(participant, name),
    )
    with _opened(path, key) as diary, naming_options("output"):
        written = export_clips(diary, output, participant, overwrite=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"wrote {output}: {counted(len(written), 'film')}")
    shell.result({"participant": participant, "films": [str(one) for one in written]})


@app.command("list")
def list_participants(path: File, key: Key = None, as_json: Json = False) -> None:
    """List the participants.

    For each of them it prints the number of sessions, the last one, and the share of the protocol
    that was done.

    Example: manip3d diary list study.diary
    """
    from manip3d.diary import adherence

    rows: list[dict[str, Any]] = []
    with _opened(path, key) as diary:
        for person in diary.participants():
            sessions = diary.sessions(person.identifier)
            done = adherence(sessions, person.enrolled, _today(person.enrolled))
            rows.append(
                {
                    "participant": person.identifier,
                    "limb": person.limb,
                    "enrolled": person.enrolled.isoformat(),
                    "sessions": len(sessions),
                    "last": sessions[-1].started.isoformat() if sessions else None,
                    "complete": done.complete,
                    "expected": done.expected,
                    "events": len(diary.events(person.identifier)),
                }
            )

    def show(console: Console) -> None:
        names = ("participant", "limb", "enrolled", "sessions", "last", "complete", "events")
        cells = [
            [row["participant"], printable(row["limb"].replace("_", " ")), row["enrolled"][:10],
             str(row["sessions"]), (row["last"] or "-")[:16].replace("T", " "),
             f"{row['complete']} of {row['expected']}", str(row["events"])]
            for row in rows
        ]  # fmt: skip
        if cells:
            table(console, cells, names)
        else:
            console.print("nobody is enrolled")

    Terminal(as_json=as_json).result(rows, show)


def _session_row(session: DiarySession) -> list[str]:
    """One line of the table of a participant's sessions."""
    stuck = sum(len(game.anomalies) for game in session.games)
    pain = f"{or_dash(session.pain_before)} -> {or_dash(session.pain_after)}"
    pain += "" if session.answered else " (not answered at the end)"
    games = [
        f"{game.game} {game.score}{' (simulated)' if game.is_simulated else ''}"
        for game in session.games
    ]
    return [dated(session.started), printable(", ".join(games) or "none"), pain, str(stuck)]


@app.command("show")
def show_participant(path: File, participant: Who, key: Key = None, as_json: Json = False) -> None:
    """Show what a diary holds of a participant.

    It prints sessions, games, ratings, questionnaires, the felt limb and adverse events. With
    --json, ratings of a session are with it, and "ratings" holds those outside of sessions.

    Example: manip3d diary show study.diary P01
    """
    from manip3d.diary import adherence

    with _opened(path, key) as diary:
        person = diary.participant(participant)
        sessions = diary.sessions(participant)
        filled, events = diary.mcgill(participant), diary.events(participant)
        answers = diary.answers(participant)
        within = {rating.number for session in sessions for rating in session.ratings}
        apart = [one for one in diary.ratings(participant) if one.number not in within]
        touched = {one.number: one.mode for one in diary.ownership(participant)}
        felt = diary.felt(participant)
    done = adherence(sessions, person.enrolled, _today(person.enrolled))
    record = {
        **_plain(person),
        "adherence": vars(done),
        "sessions": [
            {**_plain(session), "games": [_plain(game) for game in session.games],
             "ratings": [_plain(rating) for rating in session.ratings]}
            for session in sessions
        ],
        "ratings": [_plain(rating) for rating in apart],
        "questionnaires": [{**_plain(one), "score": vars(one.score)} for one in filled],
        "answers": [_answers(one) | ({"mode": touched[one.number]} if one.number in touched else {})
                    for one in answers],
        "felt": [_plain(one) for one in felt],
        "events": [_plain(event) for event in events],
    }  # fmt: skip

    def show(console: Console) -> None:
        limb = printable(f", {person.limb.replace('_', ' ')}") if person.limb else ""
        told = f"{person.identifier}{limb}, enrolled {dated(person.enrolled)}"
        console.print(told)
        console.print(
            f"{done.complete} of {done.expected} sessions complete in {counted(done.days, 'day')}, "
            f"{done.partial} more in part{_left_out(done.simulated)}"
        )
        rows = [_session_row(session) for session in sessions]
        if rows:
            table(console, rows, ("session", "games and scores", "pain", "anomalies"))
        for rating in apart:
            console.print(f"pain {rating.pain}, {dated(rating.at)}, outside of sessions")
        for one in filled:
            _show_mcgill(console, one)
        for form in answers:
            if form.number not in {one.number for one in filled}:
                _show_answers(console, form, touched.get(form.number, ""))
        for description in felt:
            _show_felt(console, description)
        for event in events:
            _show_event(console, event)

    Terminal(as_json=as_json).result(record, show)


def _show_mcgill(console: Console, filled: McGill) -> None:
    score = filled.score
    console.print(
        f"McGill, {filled.occasion}, {dated(filled.at)}: PRI {score.pri} ({score.sensory} + "
        f"{score.affective} + {score.evaluative} + {score.miscellaneous}), "
        f"NWC {score.nwc}, PPI {score.ppi}"
    )


def _show_answers(console: Console, answers: Answers, mode: str) -> None:
    told = ", ".join(f"{name} {score:.4g}" for name, score in answers.scores.items())
    occasion = f"{mode} touch" if mode else answers.occasion
    title = f"{answers.questionnaire.name}, {occasion}, {dated(answers.at)}"
    console.print(printable(f"{title}: {told}"))


def _show_felt(console: Console, felt: FeltRecord) -> None:
    limb = f" ({felt.limb.replace('_', ' ')})" if felt.limb else ""
    told = (
        f"felt limb{limb}, {dated(felt.at)}: {felt.length} % long, "
        f"{felt.telescoping} % telescoped, raised {felt.raised} and bent {felt.bent} degrees"
    )
    console.print(printable(told))


def _show_event(console: Console, event: AdverseEvent) -> None:
    kind = "" if event.kind == "other" else f" ({event.kind})"
    told = f"adverse event, {dated(event.at)}{kind}: {event.text}"
    console.print(printable(told))


@app.command("rate")
def rate(
    path: File,
    participant: Who,
    pain: Annotated[
        int | None, typer.Option(min=0, max=10, help="Pain now, 0 (none) to 10 (the worst).")
    ] = None,
    mcgill: Annotated[
        str | None,
        typer.Option(
            metavar="RANKS",
            help="McGill questionnaire: for each of the 20 groups the rank of the chosen word, 0 "
            "for none, separated by commas.",
        ),
    ] = None,
    ppi: Annotated[
        int | None,
        typer.Option(
            min=0, max=5, help="Present pain intensity of that questionnaire; by default 0."
        ),
    ] = None,
    occasion: Annotated[
        Occasion | None,
        typer.Option(help="When the questionnaire was filled in; by default other."),
    ] = None,
    event: Annotated[str | None, typer.Option(help="An adverse event, in words.")] = None,
    key: Key = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Note a rating of pain, a McGill questionnaire or an event.

    The questionnaire's words are protected and not part of this program.

    Example: manip3d diary rate study.diary P01 --pain 4
    """
    from manip3d.diary._diary import check_event_text

    if pain is None and mcgill is None and event is None:
        raise InputError("expected --pain, --mcgill or --event")
    if mcgill is None and (ppi is not None or occasion is not None):
        name = "--ppi" if ppi is not None else "--occasion"
        raise InputError(f"{name}: can only be given with --mcgill")
    if event is not None and not event.strip():
        raise InputError("--event: expected words, got none")
    if event is not None:
        check_event_text(event)  # first, so that all is stored or nothing
    when = occasion or Occasion.other
    ranks = None if mcgill is None else _numbers(mcgill, 20, "--mcgill")
    shell = Terminal(as_json=as_json, quiet=quiet)
    record: dict[str, Any] = {"participant": participant}
    with _opened(path, key) as diary:
        if ranks is not None:
            with naming_options(ranks="mcgill"):
                found = diary.add_mcgill(participant, ranks, ppi or 0, occasion=when.value)
            record["mcgill"] = vars(found.score)
            shell.say(f"McGill, {when.value}: PRI {found.score.pri}, NWC {found.score.nwc}")
        if pain is not None:
            diary.add_rating(participant, pain)
            record["pain"] = pain
            shell.say(f"pain {pain} noted for {participant}")
        if event is not None:
            diary.add_event(participant, "other", event)
            record["event"] = event
            shell.say(f"adverse event noted for {participant}")
    shell.result(record)


class BuiltIn(StrEnum):
    """Questionnaires that need no file."""

    mcgill = "mcgill"
    ownership = "ownership"


@app.command("form")
def form(
    questionnaire: Annotated[
        BuiltIn, typer.Argument(metavar="mcgill|ownership", help="A built-in questionnaire.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="JSON file to write.")],
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a built-in questionnaire as a file. Its words can be changed for 'manip3d diary ask'.

    The words of McGill's groups are protected and left out; with a licence, add them as "choices",
    beginning with the text of answer 0. If ranges and scales are not changed, the answers count as
    McGill's. An existing file is never replaced.

    Example: manip3d diary form mcgill -o mcgill.json
    """
    from manip3d import diary

    check_output(output, (".json",), force=None)
    built_in = {"mcgill": diary.MCGILL, "ownership": diary.OWNERSHIP}
    diary.write_questionnaire(built_in[questionnaire.value], output)
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"wrote {output}")
    shell.result({"form": str(output)})


@app.command("ask")
def ask(
    path: File,
    participant: Who,
    form: Annotated[Path, typer.Option("--form", help="Questionnaire: a JSON file.")],
    answers: Annotated[
        str | None,
        typer.Option(
            metavar="NUMBERS",
            help="The answers, separated by commas; by default they are asked for one by one.",
        ),
    ] = None,
    occasion: Annotated[
        Occasion, typer.Option(help="When the questionnaire was filled in.")
    ] = Occasion.other,
    key: Key = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Ask a questionnaire, and keep the answers and their scores.

    The file has a name, items (text, low, high, choices) and scales (name, items, reverse, method);
    'manip3d diary form' writes examples. Nothing is kept before the last answer.

    Example: manip3d diary ask study.diary P01 --form form.json --answers=3,2,2,-1,0,0
    """
    from manip3d.diary import load_questionnaire

    asked = load_questionnaire(form)
    with _opened(path, key) as diary:
        diary.participant(participant)  # who is not there is said before asking
        with naming_options("answers"):
            if answers is None:
                given = _asked(asked)
            else:
                given = _numbers(answers, len(asked.items), "answers")
            filled = diary.add_answers(participant, asked, given, occasion=occasion.value)
    shell = Terminal(as_json=as_json, quiet=quiet)
    told = ", ".join(f"{name} {score:.4g}" for name, score in filled.scores.items())
    shell.say(f"{asked.name}, {occasion.value}: {told or 'noted'}")
    shell.result(_answers(filled))


def _asked(questionnaire: Questionnaire) -> list[int]:
    """Ask until each answer is one."""
    typer.echo(questionnaire.name, err=True)
    given = []
    for number, item in enumerate(questionnaire.items, 1):
        for answer, choice in enumerate(item.choices, item.low):
            typer.echo(f"  {answer}: {choice}", err=True)
        question = f"{number} of {len(questionnaire.items)}. {item.text}"
        given.append(_asked_until(f"{question} ({item.low} to {item.high})", item.low, item.high))
    return given


def _asked_until(question: str, low: int, high: int) -> int:
    while True:
        answer = int(typer.prompt(question, type=int, err=True))
        if low <= answer <= high:
            return answer
        typer.echo(f"expected {low} to {high}", err=True)


def _answers(filled: Answers) -> dict[str, Any]:
    return {
        "questionnaire": filled.questionnaire.name,
        "sha256": filled.questionnaire.sha256,
        "at": filled.at.isoformat(),
        "occasion": filled.occasion,
        "answers": list(filled.answers),
        "scores": filled.scores,
    }


@app.command("export")
def export(
    path: File,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help="Folder to write: tables (CSV), or pages with --pages. With --participant it can "
            "be a file: NAME.json (FHIR R4) or NAME.html (a page for the clinician).",
        ),
    ],
    participant: Annotated[
        str | None, typer.Option(help="Export this participant only; needed for .json and .html.")
    ] = None,
    pages: Annotated[
        bool,
        typer.Option(
            "--pages",
            help="Write pages for the clinician into the folder: an overview (index.html) and a "
            "page for each participant.",
        ),
    ] = False,
    clips: Annotated[
        bool, typer.Option("--clips", help="Show the films of difficulties on the pages, too.")
    ] = False,
    key: Key = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a copy of a diary for other programs. The copy is not encrypted.

    Example: manip3d diary export study.diary -o export
    """
    from manip3d.diary import export_csv, export_fhir, write_overview, write_page
    from manip3d.diary._export import is_exported_table
    from manip3d.diary._page import is_page_of_overview

    suffixes = () if pages else (".json", ".html")
    is_ours = is_page_of_overview if pages else is_exported_table
    check_output(output, suffixes, force=force, folder=True, is_ours=is_ours)
    if pages and participant is not None:
        raise InputError("--pages: expected no --participant; the page of one is -o NAME.html")
    suffix = output.suffix.lower()
    if clips and not pages and suffix != ".html":
        raise InputError("--clips: expected --pages or -o NAME.html; 'diary clips' writes films")
    with _opened(path, key) as diary, naming_options("output"):
        if pages:
            write_overview(diary, output, clips=clips, overwrite=force)
        elif suffix in (".json", ".html"):
            if participant is None:
                raise InputError("--participant: expected one, for .json and .html")
            if suffix == ".json":
                export_fhir(diary, output, participant, overwrite=force)
            else:
                write_page(diary, output, participant, clips=clips, overwrite=force)
        else:
            chosen = None if participant is None else [participant]
            export_csv(diary, output, participants=chosen, overwrite=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"wrote {output}")
    shell.result({"diary": str(path), "output": str(output)})


@app.command("delete")
def delete(
    path: File,
    participant: Who,
    is_sure: Annotated[
        bool, typer.Option("--yes", help="Delete without asking; this cannot be undone.")
    ] = False,
    with_exports: Annotated[
        bool,
        typer.Option("--exports", help="Also remove the exported files that were not changed."),
    ] = False,
    key: Key = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Delete a participant. No byte of their data remains in the diary.

    Exported files are listed, also tables of several participants; --exports removes those that
    were not changed. Other copies are not deleted, nor old data that the disk itself keeps of
    overwritten files.

    Example: manip3d diary delete study.diary P01 --yes
    """
    shell = Terminal(as_json=as_json, quiet=quiet)
    with _opened(path, key) as diary:
        exports = diary.exports(participant)  # who is not there is said before asking
        for one in exports:
            shell.say(printable(f"exported: {one.path} ({one.state})"))
        if not is_sure and not typer.confirm(f"Delete all of {participant} from {path}?", err=True):
            raise InputError("nothing deleted")
        chosen = [one.path for one in exports if with_exports and one.state == "unchanged"]
        failed: OSError | None = None
        try:
            diary.delete(participant)  # first: files stay where nobody was deleted
        except OSError as error:
            if any(one.identifier == participant for one in diary.participants()):
                raise
            failed = error  # deleted, but the file was not written anew
        removed = _remove(shell, chosen)
        left = [one.path for one in exports if one.path not in removed and one.state != "gone"]
    shell.say(f"deleted {participant} from {path}")
    if removed:
        shell.say(f"removed {counted(len(removed), 'exported file')}")
    for file in left:
        shell.say(printable(f"still holds data of {participant}: {file}"))
    shell.result(
        {
            "diary": str(path),
            "deleted": participant,
            "removed": [str(file) for file in removed],
            "left": [str(file) for file in left],
        }
    )
    if failed is not None:
        raise failed


def _is_of_folder(file: Path) -> bool:
    """Whether an export wrote it into a folder of its own."""
    return file.suffix in (".csv", ".webp") or file.name.startswith(("index.", "participant-"))


def _remove(shell: Terminal, files: Sequence[Path]) -> list[Path]:
    """Remove files and the folders of exports that are empty then; return the removed files."""
    removed = []
    for file in files:
        try:
            file.unlink()
        except OSError as error:
            shell.say(printable(f"cannot remove {file}: {error.strerror}"))
        else:
            removed.append(file)
    for folder in {file.parent for file in removed if _is_of_folder(file)}:
        with suppress(OSError):  # it holds other files
            folder.rmdir()
    return removed


@app.command("audit")
def audit(path: File, key: Key = None, as_json: Json = False) -> None:
    """List what was done to a diary, and when.

    The list has enrolments, sessions, exports and deletions. Times are those of the computer on
    which it was done, with their offset from UTC. Entries about deleted participants are deleted,
    too. Each row is bound to those before it by a keyed hash; if
    a row was changed or is missing, the first such row is named and the exit code is 1.

    Example: manip3d diary audit study.diary
    """
    broken: FormatError | None = None
    with _opened(path, key) as diary:
        rows = diary.audit()
        try:
            diary.check_audit()
        except FormatError as error:
            broken = error  # said after the list, which may still show what happened

    def show(console: Console) -> None:
        cells = [
            [at.isoformat(" ", "seconds"), printable(action), whose] for at, action, whose in rows
        ]
        table(console, cells, ("when", "what", "whose"))

    Terminal(as_json=as_json).result(
        [{"at": at.isoformat(), "action": action, "participant": whose}
         for at, action, whose in rows],
        show,
    )  # fmt: skip
    if broken is not None:
        raise broken


@app.command("check")
def check(path: File, key: Key = None, as_json: Json = False, quiet: Quiet = False) -> None:
    """Read the whole diary and report damage.

    The pages of the file, each entry, the films and the chain of the audit are read. The first
    damage is named, and the exit code is then 1.

    Example: manip3d diary check study.diary
    """
    with _opened(path, key) as diary:
        diary.check()
        people = len(diary.participants())
    shell = Terminal(as_json=as_json, quiet=quiet)
    shell.say(f"{path}: nothing is damaged ({counted(people, 'participant')})")
    shell.result({"diary": str(path), "participants": people})


@app.command("rescue")
def rescue(
    path: File,
    output: Annotated[Path, typer.Option("--output", "-o", help="The new diary.")],
    key: Key = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Copy what can be read of a damaged diary into a new one. It opens with the same key.

    What is missing is listed, and the exit code is then 1. The damaged file stays as it is. Without
    --key, the contents of an encrypted diary are copied without checks.

    Example: manip3d diary rescue study.diary -o rescued.diary
    """
    from manip3d.diary import rescue_diary

    check_place(output, force=force if output.is_file() else None)  # a file alone is replaced
    with naming_options("key", "output"):
        found = rescue_diary(path, output, key=key, overwrite=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    for line in found.missing:
        shell.say(line)
    whole = "nothing is missing" if not found.missing else "the rest is missing"
    shell.say(f"wrote {output}: {counted(found.num_rows, 'row')}, {whole}")
    shell.result({"diary": str(output), "rows": found.num_rows, "missing": list(found.missing)})
    if found.missing:
        raise typer.Exit(1)


@app.command("analyse")
def analyse(path: File, key: Key = None, as_json: Json = False) -> None:
    """Analyse a study. It prints McGill scores over time, responders and adherence.

    Scores are those of baseline, week 1 and week 4. Their changes are estimated by a mixed model
    with a random intercept, with 95 % intervals. Research software: this is not advice on anybody's
    treatment.

    Example: manip3d diary analyse study.diary
    """
    from manip3d.diary import analyse as analyse_diary

    with _opened(path, key) as diary:
        found = analyse_diary(diary)
    Terminal(as_json=as_json).result(
        {
            "participants": list(found.identifiers),
            "scores": found.scores.tolist(),
            "model": None if found.model is None else _model(found),
            "model_occasions": list(found.model_occasions),
            "why_no_model": found.why_no_model,
            "paired": [None if one is None else vars(one) for one in found.paired],
            "why_not_paired": list(found.why_not_paired),
            "responders_30": vars(found.responders_30),
            "responders_50": vars(found.responders_50),
            "num_without_pain": found.num_without_pain,
            "adherence": {name: vars(one) for name, one in found.adherence.items()},
            "adherence_slope": found.adherence_slope and vars(found.adherence_slope),
            "why_no_slope": found.why_no_slope,
        },
        lambda console: _show_analysis(console, found),
    )


def _model(found: DiaryAnalysis) -> dict[str, Any]:
    assert found.model is not None
    return {**vars(found.model), "changes": [vars(one) for one in found.model.changes]}


def _show_analysis(console: Console, found: DiaryAnalysis) -> None:
    names = ("baseline", "week 1", "week 4")
    rows = [
        [name, *("-" if math.isnan(value) else f"{value:.0f}" for value in scores),
         f"{found.adherence[name].share:.0%}"]
        for name, scores in zip(found.identifiers, found.scores.tolist(), strict=True)
    ]  # fmt: skip
    table(console, rows, ("PRI of", *names, "sessions done"))
    simulated = sum(one.simulated for one in found.adherence.values())
    if simulated:
        console.print(f"sessions done{_left_out(simulated)}")
    _show_changes(console, found)
    _show_responders(console, found)
    slope = found.adherence_slope
    name = "change to week 4 with all sessions against none"
    if slope is None:
        console.print(f"{name}: not known so far ({found.why_no_slope})")
    else:
        console.print(f"{name}: {_interval(slope)}")


def _show_changes(console: Console, found: DiaryAnalysis) -> None:
    if found.model is None:
        console.print(f"mixed model: none so far ({found.why_no_model})")
    else:
        for name, change in zip(found.model_occasions[1:], found.model.changes, strict=True):
            told = name.replace("-", " ")
            console.print(f"change to {told}, mixed model: {_interval(change)}")
    for told, paired, why in zip(
        ("week 1", "week 4"), found.paired, found.why_not_paired, strict=True
    ):
        name = f"change to {told}, paired differences"
        if paired is None:
            console.print(f"{name}: none so far ({why})")
        else:
            people = counted(round(paired.df) + 1, "participant")
            console.print(f"{name} of {people}: {_interval(paired)}")


def _show_responders(console: Console, found: DiaryAnalysis) -> None:
    for least, share in ((30, found.responders_30), (50, found.responders_50)):
        if share.of:
            console.print(
                f"PRI down by {least} % or more: {share.number} of {share.of} with both scores "
                f"(95 %: {share.low:.0%} to {share.high:.0%})"
            )
    if found.num_without_pain:
        console.print(
            "of these, with PRI 0 at baseline, counted as without response: "
            f"{found.num_without_pain}"
        )


def _interval(one: Estimate) -> str:
    return f"{one.value:+.1f} (95 %: {one.low:+.1f} to {one.high:+.1f}; p = {one.p:.3g})"


def _left_out(simulated: int) -> str:
    return f"; left out: {counted(simulated, 'game')} of a simulated person" if simulated else ""


def _numbers(text: str, count: int, name: str) -> list[int]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.removeprefix("-").isdecimal() for part in parts):
        expected = counted(count, "whole number")
        raise InputError(f"{name}: expected {expected} with commas, got {text!r}")
    return list(map(int, parts))


def _plain(thing: Any) -> dict[str, Any]:
    """Fields of a record that JSON can hold; parts that are records themselves are left out."""
    found: dict[str, Any] = {}
    for name, value in vars(thing).items():
        if isinstance(value, datetime):
            found[name] = value.isoformat()
        elif isinstance(value, tuple) and not (value and hasattr(value[0], "__dict__")):
            found[name] = list(value)
        elif not isinstance(value, tuple) and not hasattr(value, "__dict__"):
            found[name] = value
    return found


def _today(enrolled: datetime) -> date:
    from manip3d.diary._records import local_day

    return max(date.today(), local_day(enrolled))
