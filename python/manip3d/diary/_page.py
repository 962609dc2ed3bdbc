"""A page about one participant for the clinician: one HTML file that loads nothing."""

from __future__ import annotations

import base64
import html
import os
from collections.abc import Sequence
from datetime import date, datetime

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.diary._clips import film
from manip3d.diary._diary import Diary
from manip3d.diary._protocol import Protocol, adherence
from manip3d.diary._records import FILM_IN_PAGE, DiaryGame, DiarySession
from manip3d.errors import InputError
from manip3d.io._files import atomic_write

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1c2430; max-width: 60rem; margin: 2rem auto;
  padding: 0 1rem; }
h1 { margin-bottom: 0; } h2 { margin-top: 2rem; }
table { border-collapse: collapse; width: 100%; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #d5dbe3; text-align: left; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
.quiet { color: #5a6675; } .warning { color: #a02b1d; font-weight: 600; }
figure { display: inline-block; margin: 0 1rem 1rem 0; max-width: 20rem; }
figure img { width: 100%; } figcaption { font-size: .85rem; color: #5a6675; }
svg { width: 100%; height: auto; } svg text { font-size: 12px; fill: #5a6675; }
"""
_WIDE, _HIGH, _LEFT, _TOP = 860, 220, 30, 12
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
    """Write a page about one participant: adherence, pain before and after, games, difficulties.

    Parameters
    ----------
    diary : Diary
    output : path
        An HTML file; it is not encrypted.
    identifier : str
    today : date, optional
        Last day on which sessions were due; by default today.
    clips : bool
        With the films of difficulties.
    overwrite : bool
        Replace the file.

    Raises
    ------
    InputError
        No such participant, or the file exists.
    OSError
        It cannot be written.

    Examples
    --------
    >>> with Diary("page.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     write_page(diary, "P01.html", "P01")
    """
    target = path_of(output, "output")
    if target.exists() and not overwrite:
        raise InputError(f"output: {target} exists")
    person = diary.participant(identifier)
    sessions = diary.sessions(identifier)
    plan = Protocol()
    last = max(today or date.today(), person.enrolled.date())
    done = adherence(sessions, person.enrolled, last, protocol=plan)
    limb = f", {person.limb.replace('_', ' ')}" if person.limb else ""
    parts = [
        f"<h1>{html.escape(person.identifier + limb)}</h1>",
        f'<p class="quiet">Enrolled {_day(person.enrolled)}. {_INTENDED_USE}</p>',
        "<h2>Sessions done</h2>",
        f"<p>{done.complete} of {done.expected} sessions with all {plan.games_a_session} games "
        f"({done.share:.0%}) up to day {done.days}, {done.partial} more in part. Days with a game: "
        f"{done.days_played}.{_left_out(done.simulated)}</p>",
        "<h2>Pain before and after each session</h2>",
        _chart(sessions),
        "<h2>Adverse events</h2>",
        _events(diary, identifier),
        "<h2>McGill Pain Questionnaire</h2>",
        _mcgill(diary, identifier),
        "<h2>Touch cues and the limb as it feels</h2>",
        _felt(diary, identifier),
        "<h2>Sessions</h2>",
        _sessions(sessions),
        *(["<h2>Films of difficulties</h2>", _films(diary, identifier)] if clips else []),
    ]
    text = (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Diary of {html.escape(person.identifier)}</title>\n<style>{_STYLE}</style>\n"
        "</head>\n<body>\n" + "\n".join(parts) + "\n</body>\n</html>\n"
    )
    diary.note_export(identifier)
    atomic_write(target, text)
    diary.note_files(identifier, [target])


def _day(moment: datetime) -> str:
    return moment.strftime("%Y-%m-%d %H:%M")


def _left_out(simulated: int) -> str:
    return f" Left out: {simulated} of a simulated person." if simulated else ""


def _chart(sessions: Sequence[DiarySession]) -> str:
    """Each session a line from before (hollow) to after (filled), red where the pain rose by 2."""
    rated = [s for s in sessions if s.pain_before is not None or s.pain_after is not None]
    if not rated:
        return "<p>Nobody has said how strong the pain is yet.</p>"
    step = (_WIDE - 2 * _LEFT) / len(rated)

    def height(pain: int) -> float:
        return _TOP + (_HIGH - 2 * _TOP) * (1 - pain / 10)

    drawn = []
    for mark in (0, 5, 10):
        y = height(mark)
        drawn.append(f'<line x1="{_LEFT}" x2="{_WIDE}" y1="{y}" y2="{y}" stroke="#d5dbe3"/>')
        drawn.append(f'<text x="4" y="{y + 4}">{mark}</text>')
    for number, session in enumerate(rated):
        x = _LEFT + step * (number + 0.5)
        before, after = session.pain_before, session.pain_after
        color = "#1d6fb8"
        if before is not None and after is not None:
            color = "#a02b1d" if after >= before + 2 else color
            drawn.append(
                f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{height(before)}" y2="{height(after)}" '
                f'stroke="{color}" stroke-width="3"/>'
            )
        title = f"<title>{_day(session.started)}: {_dash(before)} to {_dash(after)}</title>"
        for pain, fill in ((before, "#ffffff"), (after, color)):
            if pain is not None:
                drawn.append(
                    f'<circle cx="{x:.1f}" cy="{height(pain)}" r="5" fill="{fill}" '
                    f'stroke="{color}" stroke-width="2">{title}</circle>'
                )
    return (
        f'<svg viewBox="0 0 {_WIDE} {_HIGH}" role="img" aria-label="Pain from 0 to 10">'
        + "".join(drawn)
        + '</svg>\n<p class="quiet">One mark a session, from 0 (none) to 10 (the worst): hollow '
        "before it, filled after it; red where the pain rose by 2 or more.</p>"
    )


def _events(diary: Diary, identifier: str) -> str:
    events = diary.events(identifier)
    if not events:
        return "<p>None.</p>"
    rows = [(_day(e.at), e.kind, e.text) for e in events]
    return _table(("When", "Kind", "In words"), rows)


def _mcgill(diary: Diary, identifier: str) -> str:
    filled = diary.questionnaires(identifier)
    if not filled:
        return "<p>None yet.</p>"
    rows = [
        (one.occasion, _day(one.at), str(one.score.pri), str(one.score.nwc), str(one.score.ppi))
        for one in filled
    ]
    names = ("Occasion", "When", "Pain rating index, of 78", "Words chosen, of 20",
             "Present pain, of 5")  # fmt: skip
    return _table(names, rows)


def _felt(diary: Diary, identifier: str) -> str:
    cues = [
        (_day(one.at), one.mode, f"{one.ownership:+.1f}", f"{one.control:+.1f}")
        for one in diary.ownership(identifier)
    ]
    limbs = [
        (_day(one.at), f"{one.length} %", f"{one.telescoping} %", f"{one.raised}°", f"{one.bent}°")
        for one in diary.felt(identifier)
    ]
    names = ("When", "Touch", "Ownership, -3 to 3", "Controls, -3 to 3")
    parts = [_table(names, cues)] if cues else []
    if limbs:
        parts.append(_table(("When", "Length", "Drawn up", "Raised", "Bent"), limbs))
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
        pain = f"{_dash(session.pain_before)} to {_dash(session.pain_after)}"
        rows.append((_day(session.started), games, pain, ", ".join(stuck) or "-"))
    return _table(("Begun", "Games and scores", "Pain", "No point though in reach"), rows)


def _game(game: DiaryGame) -> str:
    return f"{game.game} {game.score}{' (simulated person)' if game.is_simulated else ''}"


def _films(diary: Diary, identifier: str) -> str:
    found = diary.clips(identifier)
    if not found:
        return "<p>None.</p>"
    return "\n".join(
        f'<figure><img alt="" src="{FILM_IN_PAGE.decode()}'
        f'{base64.b64encode(film(clip)).decode()}">'
        f"<figcaption>{_day(clip.at)}, {html.escape(clip.game)}: no point from {clip.start:.0f} to "
        f"{clip.end:.0f} s of play, though something was in reach. The phantom limb is bluish."
        "</figcaption></figure>"
        for clip in found
    )


def _table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    body = "\n".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table>\n<tr>{head}</tr>\n{body}\n</table>"


def _dash(value: int | None) -> str:
    return "-" if value is None else str(value)
