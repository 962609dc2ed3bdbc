"""HTML pages for the clinician: one for each participant and an overview; they load no files."""

from __future__ import annotations

import base64
import html
import os
import re
from collections.abc import Mapping, Sequence
from datetime import date, timedelta

from manip3d._util.checked import checked
from manip3d._util.html import Html, as_html, html_table, wide
from manip3d._util.paths import legible_path_of, refuse_existing
from manip3d._util.texts import legible, or_dash
from manip3d._util.times import dated
from manip3d.diary._clips import film
from manip3d.diary._diary import Diary
from manip3d.diary._protocol import Protocol, adherence
from manip3d.diary._questionnaires import Questionnaire
from manip3d.diary._records import (
    CLOCK_WENT_BACK,
    FILM_IN_PAGE,
    NOT_ANSWERED,
    Answers,
    DiaryGame,
    DiarySession,
    Participant,
    day_of,
    local_day,
)
from manip3d.diary._trends import Point, change_a_week, pain_chart, require_scipy, trend
from manip3d.io._files import atomic_folder, atomic_write, refuse_other_files

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1c2430; max-width: 60rem; margin: 2rem auto;
  padding: 0 1rem; overflow-wrap: break-word; }
h1 { margin-bottom: 0; } h2 { margin-top: 2rem; }
table { border-collapse: collapse; width: 100%; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #d5dbe3; text-align: left; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
.quiet { color: #5a6675; } .warning { color: #a02b1d; font-weight: 600; }
figure { display: inline-block; margin: 0 1rem 1rem 0; max-width: 20rem; }
figure.trend { max-width: 27rem; width: 100%; }
figure img { width: 100%; } figcaption { font-size: .85rem; color: #5a6675; }
.wide { overflow-x: auto; } .wide svg { min-width: 36rem; }
svg { width: 100%; height: auto; } svg text { font-size: 12px; fill: #5a6675; }
"""
_INTENDED_USE = (
    "Research software. It is not a medical device and is not meant for diagnosis or treatment."
)


@checked
def write_page(
    diary: Diary,
    output: str | os.PathLike[str],
    identifier: str,
    *,
    today: date | None = None,
    clips: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a page about one participant: adherence, pain before and after, trends, difficulties.

    Trends of pain, scores, the phantom limb's share of the points, tracking and the McGill index
    are shown with a least-squares line and its 95 % interval, which assumes independent errors of
    equal variance. Games of a simulated person are left out of the trends.

    Parameters
    ----------
    diary : Diary
    output : path
        HTML file to write; it is not encrypted.
    identifier : str
        Pseudonym of the participant.
    today : date, optional
        Last day on which sessions were due; default: today.
    clips : bool
        Include the films of difficulties.
    overwrite : bool
        Replace the file if it exists.

    Raises
    ------
    InputError
        No such participant, the file exists, or its path has control characters or is not UTF-8.
    OSError
        The file cannot be written.
    MissingExtraError
        scipy is not installed.

    Examples
    --------
    >>> from manip3d.diary import Diary, write_page
    >>> with Diary("page.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     write_page(diary, "P01.html", "P01")
    """
    target = legible_path_of(output, "output")
    refuse_existing(target, overwrite=overwrite, name="output")
    diary.expect_other_file(target)
    text = _page(diary, identifier, day_of(today), clips)
    diary.note_export(identifier)
    atomic_write(target, text)
    diary.note_files(identifier, [target])


@checked
def write_overview(
    diary: Diary,
    output: str | os.PathLike[str],
    *,
    today: date | None = None,
    clips: bool = False,
    overwrite: bool = False,
) -> None:
    """Write a folder of pages: ``index.html`` with all participants, and a page for each.

    The overview shows adherence, the last visit, the trend of the pain, and alarms: games stopped
    for today, adverse events of the last 7 days, growing pain (the 95 % interval of its trend is
    above 0), and no session for 3 days or more during the protocol.

    Parameters
    ----------
    diary : Diary
    output : path
        Folder to create; its files are not encrypted.
    today : date, optional
        Last day on which sessions were due; default: today.
    clips : bool
        Include the films of difficulties.
    overwrite : bool
        Replace a folder that contains only such pages.

    Raises
    ------
    InputError
        The folder exists; with ``overwrite``, it contains other files. Or its path
        has control characters or is not UTF-8.
    OSError
        The folder cannot be written.
    MissingExtraError
        scipy is not installed.

    Examples
    --------
    >>> import os
    >>> from manip3d.diary import Diary, write_overview
    >>> with Diary("overview.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     write_overview(diary, "pages")
    >>> sorted(os.listdir("pages"))
    ['index.html', 'participant-P01.html']
    """
    require_scipy()
    target = legible_path_of(output, "output")
    refuse_existing(target, overwrite=overwrite, name="output")
    refuse_other_files(target, is_page_of_overview)
    day = day_of(today)
    people = diary.participants()
    names = _names_of_pages([person.identifier for person in people])
    for identifier in names:
        diary.note_export(identifier)
    with atomic_folder(target) as folder:
        for identifier, name in names.items():
            text = _page(diary, identifier, day, clips, is_linked=True)
            (folder / name).write_text(text, encoding="utf-8")
        (folder / _INDEX).write_text(_overview(diary, day, people, names), encoding="utf-8")
    for identifier, name in names.items():
        diary.note_files(identifier, [target / name, target / _INDEX])


_INDEX = "index.html"
_OWN_PAGE = re.compile(r"index\.html|participant-.*\.html")
_SILENT_DAYS = 3  # days without a session that raise an alarm; two sessions a day are due
_RECENT_DAYS = 7  # adverse events of these days are shown in the overview


def is_page_of_overview(name: str) -> bool:
    """Return whether `write_overview` writes a file of this name into its folder."""
    return bool(_OWN_PAGE.fullmatch(name))


def _names_of_pages(people: Sequence[str]) -> dict[str, str]:
    """Return the file name of a participant's page.

    It differs from the overview's, and no two names differ only in case, which many file systems
    ignore.
    """
    names: dict[str, str] = {}
    taken = set[str]()
    for identifier in people:
        name, number = f"participant-{identifier}.html", 2
        while name.casefold() in taken:
            name, number = f"participant-{identifier}-{number}.html", number + 1
        taken.add(name.casefold())
        names[identifier] = name
    return names


def _overview(
    diary: Diary, today: date, people: Sequence[Participant], names: Mapping[str, str]
) -> str:
    """Return the page of all ``people``, who are not those enrolled meanwhile.

    Each links to the page of its name.
    """
    rows = [_overview_row(diary, person, today, names[person.identifier]) for person in people]
    heads = ("Participant", "Limb", "Sessions done", "Last visit", "Pain", "Pain in a week",
             "Alarms")  # fmt: skip
    parts = [
        "<h1>Participants</h1>",
        f'<p class="quiet">{len(people)} enrolled; as of {today}. {_INTENDED_USE}</p>',
        html_table(heads, rows) if rows else "<p>Nobody is enrolled.</p>",
        '<p class="quiet">Sessions done: with all games, of those that were due so far. '
        "Pain: before and after the last session with a rating. Pain in a week: slope of the "
        "least-squares line of the pain before sessions, with its 95 % interval. Games of a "
        "simulated person are left out.</p>",
    ]
    return _document("Overview of the diaries", parts)


def _overview_row(diary: Diary, person: Participant, today: date, name: str) -> list[str | Html]:
    sessions = diary.sessions(person.identifier)
    real = [session for session in sessions if not _is_simulated(session)]
    rated = [s for s in real if s.pain_before is not None or s.pain_after is not None]
    done = adherence(sessions, person.enrolled, max(today, local_day(person.enrolled)))
    change = change_a_week(_pain_before(real, person))
    pain = f"{or_dash(rated[-1].pain_before)} to {or_dash(rated[-1].pain_after)}" if rated else "-"
    found = _alarms(diary, person, real, today)
    link = f'<a href="{name}">{html.escape(person.identifier)}</a>'
    told = "<br>".join(f'<span class="warning">{html.escape(one)}</span>' for one in found)
    return [
        Html(link),
        person.limb.replace("_", " ") or "-",
        f"{done.complete} of {done.expected} ({done.share:.0%})",
        dated(real[-1].started) if real else "-",
        pain,
        "-" if change is None else f"{change.value:+.1f} ({change.low:+.1f} to {change.high:+.1f})",
        Html(told or "-"),
    ]


def _alarms(
    diary: Diary, person: Participant, sessions: Sequence[DiarySession], today: date
) -> list[str]:
    found = []
    halt = diary.halt_reason(person.identifier, today=today)
    if halt:
        found.append(f"No more games today; the patient was told: {halt}")
    since = today - timedelta(days=_RECENT_DAYS)
    recent = [e for e in diary.events(person.identifier) if since < e.local_date <= today]
    if recent:
        kinds = ", ".join(sorted({event.kind for event in recent}))
        found.append(
            f"{len(recent)} adverse event{'s' * (len(recent) > 1)} in {_RECENT_DAYS} days ({kinds})"
        )
    change = change_a_week(_pain_before(sessions, person))
    if change is not None and change.low > 0:
        found.append("The pain before sessions grows")
    enrolled = local_day(person.enrolled)
    last = local_day(sessions[-1].started) if sessions else enrolled
    in_protocol = (today - enrolled).days < 7 * Protocol().weeks
    if in_protocol and (today - last).days >= _SILENT_DAYS:
        found.append(f"No session for {(today - last).days} days")
    return found


def _page(
    diary: Diary, identifier: str, today: date, clips: bool, *, is_linked: bool = False
) -> str:
    """Return the page of a participant; sessions of simulated people count nowhere."""
    require_scipy()
    person = diary.participant(identifier)
    sessions = diary.sessions(identifier)
    real = [session for session in sessions if not _is_simulated(session)]
    plan = Protocol()
    last = max(today, local_day(person.enrolled))
    done = adherence(sessions, person.enrolled, last, protocol=plan)
    limb = f", {person.limb.replace('_', ' ')}" if person.limb else ""
    parts = [
        *([f'<p><a href="{_INDEX}">All participants</a></p>'] if is_linked else []),
        f"<h1>{html.escape(legible(person.identifier + limb))}</h1>",
        f'<p class="quiet">Enrolled {dated(person.enrolled)}. {_INTENDED_USE}</p>',
        "<h2>Sessions done</h2>",
        f"<p>{done.complete} of {done.expected} sessions with all {plan.games_a_session} games "
        f"({done.share:.0%}) up to day {done.days}, {done.partial} more in part. Days with a game: "
        f"{done.days_played}.{_left_out(done.simulated)}</p>",
        "<h2>Pain before and after each session</h2>",
        wide("Pain before and after each session", pain_chart(real, person.enrolled)),
        *_ratings_apart(diary, identifier, sessions),
        "<h2>Trends</h2>",
        _trends(diary, person, real),
        "<h2>Adverse events</h2>",
        _events(diary, identifier),
        "<h2>McGill Pain Questionnaire</h2>",
        _mcgill(diary, identifier),
        *_forms(diary, identifier),
        "<h2>Touch cues and the limb as it feels</h2>",
        _felt(diary, identifier),
        "<h2>Sessions</h2>",
        _sessions(sessions),
        *(["<h2>Films of difficulties</h2>", _films(diary, identifier)] if clips else []),
    ]
    return _document(f"Diary of {person.identifier}", parts)


def _document(title: str, parts: Sequence[str]) -> str:
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n"
        "</head>\n<body>\n<main>\n" + "\n".join(parts) + "\n</main>\n</body>\n</html>\n"
    )


def _left_out(simulated: int) -> str:
    return f" Left out: {simulated} of a simulated person." if simulated else ""


def _is_simulated(session: DiarySession) -> bool:
    """Return whether all games of a session are those of a simulated person."""
    return bool(session.games) and all(game.is_simulated for game in session.games)


def _ratings_apart(diary: Diary, identifier: str, sessions: Sequence[DiarySession]) -> list[str]:
    """Return the table of ratings without a session, with its heading; empty: there are none."""
    within = {rating.number for session in sessions for rating in session.ratings}
    rows = [
        [dated(rating.at), str(rating.pain)]
        for rating in diary.ratings(identifier)
        if rating.number not in within
    ]
    return ["<h2>Pain outside of sessions</h2>", html_table(("When", "Pain"), rows)] if rows else []


def _pain_before(sessions: Sequence[DiarySession], person: Participant) -> list[Point]:
    return [
        Point.of(session.started, person.enrolled, session.pain_before)
        for session in sessions
        if session.pain_before is not None
    ]


def _charts(
    diary: Diary, person: Participant, sessions: Sequence[DiarySession]
) -> list[tuple[str, list[Point], float | None]]:
    """Return title, points and upper end of the axis of each chart; None: the largest point."""
    start = person.enrolled
    games = [game for session in sessions for game in session.games if game.counts]
    kinds = sorted({(game.game, game.difficulty) for game in games})
    after = [
        Point.of(session.started, start, session.pain_after)
        for session in sessions
        if session.pain_after is not None
    ]
    shares = [Point.of(g.at, start, 100 * g.by_phantom / g.score) for g in games if g.score > 0]
    tracked = [Point.of(g.at, start, 100 * g.tracked) for g in games if g.tracked is not None]
    filled = [Point.of(one.at, start, one.score.pri) for one in diary.mcgill(person.identifier)]
    scores = [
        (
            f"Score of {name}, difficulty {difficulty}",
            [
                Point.of(game.at, start, game.score)
                for game in games
                if (game.game, game.difficulty) == (name, difficulty)
            ],
            None,
        )
        for name, difficulty in kinds
    ]
    return [
        ("Pain before sessions, 0 to 10", _pain_before(sessions, person), 10.0),
        ("Pain after sessions, 0 to 10", after, 10.0),
        *scores,
        ("Share of the points by the phantom limb, %", shares, 100.0),
        ("Frames in which the phantom limb was followed, %", tracked, 100.0),
        ("McGill pain rating index, 0 to 78", filled, 78.0),
    ]


def _trends(diary: Diary, person: Participant, sessions: Sequence[DiarySession]) -> str:
    """Return the charts that have points, all over the same days."""
    charts = _charts(diary, person, sessions)
    days = [point.day for _, points, _ in charts for point in points]
    drawn = [
        trend(title, points, first=min([0.0, *days]), last=max([7.0, *days]), top=top)
        for title, points, top in charts
        if points
    ]
    if not drawn:
        return "<p>None yet.</p>"
    return "\n".join(drawn) + (
        '\n<p class="quiet">Days since the enrolment. The line is that of least squares, the '
        "shaded band its 95 % interval, which takes the points to scatter evenly and independently "
        "about a straight line; it needs three points. Games that were stopped or interrupted, and "
        "those of a simulated person, are left out.</p>"
    )


def _events(diary: Diary, identifier: str) -> str:
    events = diary.events(identifier)
    if not events:
        return "<p>None.</p>"
    rows = [(dated(e.at), e.kind, e.text) for e in events]
    return html_table(("When", "Kind", "In words"), rows)


def _mcgill(diary: Diary, identifier: str) -> str:
    filled = diary.mcgill(identifier)
    if not filled:
        return "<p>None yet.</p>"
    rows = [
        (one.occasion, dated(one.at), str(one.score.pri), str(one.score.nwc), str(one.score.ppi))
        for one in filled
    ]
    names = ("Occasion", "When", "Pain rating index, of 78", "Words chosen, of 20",
             "Present pain, of 5")  # fmt: skip
    return html_table(names, rows)


def _forms(diary: Diary, identifier: str) -> list[str]:
    """Return a table of scores for each other questionnaire and each wording of it."""
    filled: dict[Questionnaire, list[Answers]] = {}
    # Compare by row, because the same questions, if filled in by hand, belong here.
    elsewhere = {one.number for one in diary.ownership(identifier)}
    elsewhere |= {one.number for one in diary.mcgill(identifier)}
    for one in diary.answers(identifier):
        if one.number not in elsewhere:
            filled.setdefault(one.questionnaire, []).append(one)
    parts = []
    for asked, answers in filled.items():
        rows = [
            (one.occasion, dated(one.at), *(f"{score:.4g}" for score in one.scores.values()))
            for one in answers
        ]
        names = ("Occasion", "When", *(scale.name for scale in asked.scales))
        parts += [f"<h2>{html.escape(asked.name)}</h2>", html_table(names, rows)]
    return parts


def _felt(diary: Diary, identifier: str) -> str:
    cues = [
        (dated(one.at), one.mode, f"{one.ownership:+.1f}", f"{one.control:+.1f}")
        for one in diary.ownership(identifier)
    ]
    limbs = [
        (dated(one.at), one.limb.replace("_", " ") or "-", f"{one.length} %",
         f"{one.telescoping} %", f"{one.raised}°", f"{one.bent}°")
        for one in diary.felt(identifier)
    ]  # fmt: skip
    names = ("When", "Touch", "Ownership, -3 to 3", "Controls, -3 to 3")
    parts = [html_table(names, cues)] if cues else []
    if limbs:
        parts.append(html_table(("When", "Limb", "Length", "Drawn up", "Raised", "Bent"), limbs))
    return "\n".join(parts) or "<p>None yet.</p>"


def _sessions(sessions: Sequence[DiarySession]) -> str:
    if not sessions:
        return "<p>None yet.</p>"
    rows = []
    for session in sessions:
        games = ", ".join(_game(game) for game in session.games) or "none"
        stuck = [
            f"{game.game} {start:.0f} to {end:.0f} s"
            for game in session.games
            for start, end in game.anomalies
        ]
        pain = f"{or_dash(session.pain_before)} to {or_dash(session.pain_after)}"
        pain += "" if session.answered else f". {NOT_ANSWERED}"
        begun = dated(session.started)
        begun += f". {CLOCK_WENT_BACK}" if session.clock_went_back else ""
        rows.append((begun, games, pain, ", ".join(stuck) or "-"))
    return html_table(("Begun", "Games and scores", "Pain", "No point though in reach"), rows)


def _game(game: DiaryGame) -> str:
    return f"{game.game} {game.score}{' (simulated person)' if game.is_simulated else ''}"


def _films(diary: Diary, identifier: str) -> str:
    found = diary.clips(identifier)
    if not found:
        return "<p>None.</p>"
    return "\n".join(
        f'<figure><img alt="" src="{FILM_IN_PAGE.decode()}'
        f'{base64.b64encode(film(clip)).decode()}">'
        f"<figcaption>{dated(clip.at)}, {as_html(clip.game)}: no point from {clip.start:.0f} to "
        f"{clip.end:.0f} s of play, though something was in reach. The phantom limb is bluish."
        "</figcaption></figure>"
        for clip in found
    )
