"""Files of results: answers, a row per participant, a REDCap data dictionary, and a summary."""

from __future__ import annotations

import csv
import html
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.html import html_table, wide
from manip3d._util.paths import path_of, refuse_existing
from manip3d.errors import InputError
from manip3d.io._files import atomic_folder, holds_only
from manip3d.study._engine import Study, is_screen, scale_of, screen_step, state_of
from manip3d.study._steps import ABOUT, Field, Value
from manip3d.study._store import Session, StudyFolder

REDCAP_COLUMNS = (
    "Variable / Field Name",
    "Form Name",
    "Section Header",
    "Field Type",
    "Field Label",
    "Choices, Calculations, OR Slider Labels",
    "Field Note",
    "Text Validation Type OR Show Slider Number",
    "Text Validation Min",
    "Text Validation Max",
    "Identifier?",
    "Branching Logic (Show field only if...)",
    "Required Field?",
    "Custom Alignment",
    "Question Number (surveys only)",
    "Matrix Group Name",
    "Matrix Ranking?",
    "Field Annotation",
)
"""Columns of a REDCap data dictionary."""

FILES = (
    "answers.csv",
    "participants.csv",
    "redcap_dictionary.csv",
    "summary.csv",
    "summary.html",
)
"""Files that `write_results` writes."""

_FOR_SPREADSHEETS = ("answers.csv", "summary.csv")  # with a byte order mark, which marks UTF-8


@checked
def write_results(
    study: Study,
    folder: StudyFolder,
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
) -> Path:
    """Write the results of a study as a folder of files.

    Parameters
    ----------
    study : Study
    folder : StudyFolder
        The answers. If journals were damaged (`StudyFolder.damaged`), ``summary.html`` says so.
    output : path-like
        Folder to create, with ``answers.csv`` (a row for each answer, with its truth),
        ``participants.csv`` (a row for each participant, in the variables of
        ``redcap_dictionary.csv``, ready for import), ``summary.csv`` and ``summary.html`` (with
        the published results for comparison). Participants who did not consent have no row. The two
        files for REDCap contain texts as they were typed. In ``answers.csv`` and ``summary.csv`` an
        apostrophe precedes texts that a spreadsheet would take for a formula, and a byte order
        mark tells spreadsheets that the files are UTF-8.
    overwrite : bool
        Replace the folder if it exists.

    Returns
    -------
    Path
        ``output``.

    Raises
    ------
    InputError
        ``output`` exists, or contains other files than results.
    MissingExtraError
        SciPy, which a JND needs, is not installed.
    OSError
        A file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d import study
    >>> with tempfile.TemporaryDirectory() as place:
    ...     file = study.write_template("display", Path(place) / "study.toml", example=True)
    ...     asked, definition = study.read_study(file)
    ...     with study.StudyFolder(Path(place) / "answers", definition) as folder:
    ...         _ = study.simulate_participants(asked, folder, 4)
    ...         found = study.write_results(asked, folder, Path(place) / "results")
    ...     sorted(file.name for file in found.iterdir())[:2]
    ['answers.csv', 'participants.csv']
    """
    target = path_of(output)
    refuse_existing(target, overwrite=overwrite, name="output")
    if target.exists() and not holds_only(target, FILES.__contains__):
        raise InputError(f"output: expected a folder of results, got {target}")
    sessions = [s for s in folder.sessions.values() if state_of(study, s) != "declined"]
    sessions.sort(key=lambda session: session.number)
    rows = study.summary(sessions)
    contents = {
        "answers.csv": csv_of(_ANSWER_COLUMNS, _answers(sessions)),
        "participants.csv": _wide(study, sessions),
        "redcap_dictionary.csv": csv_of(REDCAP_COLUMNS, _dictionary(study), verbatim=True),
        "summary.csv": csv_of(*_as_table(rows)),
        "summary.html": _page(study, sessions, rows, folder.damaged),
    }
    with atomic_folder(target) as new:
        for name, content in contents.items():
            encoding = "utf-8-sig" if name in _FOR_SPREADSHEETS else "utf-8"
            (new / name).write_text(content, encoding=encoding, newline="")
    return target


_ANSWER_COLUMNS = (
    "participant",
    "group",
    "step",
    "condition",
    "question",
    "answer",
    "elapsed_ms",
    "shown_px",
    "shown_deg",
    "time_ns",
)


def _answers(sessions: Sequence[Session]) -> Iterable[Sequence[object]]:
    for session in sessions:
        for answer in session.answers:
            scale = scale_of(session, answer)
            truth = "; ".join(f"{name}={value}" for name, value in answer.condition.items())
            degrees = round(answer.shown_px / scale, 3) if scale and answer.shown_px else ""
            head = (session.participant, session.group, answer.step, truth)
            tail = (round(answer.elapsed_ms, 1), round(answer.shown_px, 1), degrees, answer.time_ns)
            for name, value in (answer.values or {"": None}).items():
                yield (*head, name, "" if value is None else value, *tail)


def _about(study: Study) -> list[tuple[str, Field]]:
    """Return the questions that all studies ask, each with the title of its part."""
    found = [
        ("Person", each) for step in study.opening() if step.id == ABOUT for each in step.fields
    ]
    if study.common.kind == "jnd":
        found += [("Screen", each) for each in screen_step().fields]
    return found


def _wide(study: Study, sessions: Sequence[Session]) -> str:
    names = [field.name for _, field in _about(study)]
    own = [field.name for _, field in study.variables()]
    columns = ["record_id", "state", *names, *own]
    rows = []
    for session in sessions:
        values: dict[str, Value] = {}
        for answer in session.answers:  # of several measurements of the screen, the last counts
            if answer.step == ABOUT or is_screen(answer.step):
                values |= answer.values
        values |= study.wide(session)
        row: list[object] = [session.participant, state_of(study, session)]
        fields = {f.name: f for _, f in (*_about(study), *study.variables())}
        for name in (*names, *own):
            row.append(_coded(fields[name], values.get(name)))
        rows.append(row)
    return csv_of(columns, rows, verbatim=True)


def _coded(field: Field, value: Value) -> object:
    """Return an answer as REDCap stores it: choices by their codes."""
    if value is None:
        return ""
    if isinstance(value, float) and "e" in repr(value):
        return _exact(value)
    if field.type != "choice":
        return value
    return [code for code, _ in field.choices].index(str(value)) + 1


def _dictionary(study: Study) -> Iterable[Sequence[str]]:
    form = f"study_{study.common.kind}"
    yield _entry("record_id", form, "", "text", "Participant code")
    choices = "unfinished, Unfinished | finished, Finished"
    yield _entry("state", form, "", "radio", "State", choices=choices)
    last = ""
    for part, field in (*_about(study), *study.variables()):
        header = part if part != last else ""
        last = part
        if field.type == "choice":
            labels = (_choice_label(label) for _, label in field.choices)
            coded = " | ".join(f"{n}, {label}" for n, label in enumerate(labels, 1))
            yield _entry(field.name, form, header, "radio", field.label, choices=coded)
        elif field.type == "scale":
            scores = range(int(field.low), int(field.high) + 1)
            ends = {int(field.low): field.ends[0], int(field.high): field.ends[1]}
            coded = " | ".join(f"{n}, {n} {ends.get(n, '')}".strip() for n in scores)
            yield _entry(field.name, form, header, "radio", field.label, choices=coded)
        elif field.type == "text":
            yield _entry(field.name, form, header, "notes", field.label)
        else:
            has_bounds = (field.low, field.high) != (0.0, 0.0)
            low, high = (_exact(field.low), _exact(field.high)) if has_bounds else ("", "")
            yield _entry(
                field.name, form, header, "text", field.label,
                validation="number", low=low, high=high,
            )  # fmt: skip


def _choice_label(label: str) -> str:
    """Return a label for REDCap, without bars and line ends, which separate its choices."""
    return " ".join(label.replace("|", "/").split())


def _exact(number: float) -> str:
    """Return all digits of a number, without an exponent, which REDCap does not read."""
    text = format(Decimal(repr(number + 0.0)), "f")  # adding 0.0 turns -0 into 0
    return text.rstrip("0").rstrip(".") if "." in text else text


def _entry(
    name: str,
    form: str,
    header: str,
    kind: str,
    label: str,
    *,
    choices: str = "",
    validation: str = "",
    low: str = "",
    high: str = "",
) -> Sequence[str]:
    row = [name, form, header, kind, label, choices, "", validation, low, high]
    return row + [""] * (len(REDCAP_COLUMNS) - len(row))


def csv_of(
    columns: Sequence[str], rows: Iterable[Sequence[object]], *, verbatim: bool = False
) -> str:
    """Return a table as CSV [RFC 4180].

    Unless ``verbatim``, an apostrophe precedes texts that a spreadsheet would take for a formula,
    because researchers open what participants have typed. Use ``verbatim`` for files that another
    program imports.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\r\n")
    writer.writerow(columns)
    for row in rows:
        cells = ["" if cell is None else cell for cell in row]
        writer.writerow(cells if verbatim else [_harmless(cell) for cell in cells])
    return stream.getvalue()


def _harmless(cell: object) -> object:
    if isinstance(cell, str) and cell[:1] in ("=", "+", "-", "@", "\t", "\r"):
        return f"'{cell}"
    return cell


def _as_table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[object]]]:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    return columns, [[_rounded(row.get(name)) for name in columns] for row in rows]


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value


_STYLE = """\
body{font:16px/1.45 system-ui,sans-serif;color:#1a2230}
body{margin:1.5rem auto;max-width:72rem;padding:0 1rem}
h1{font-size:1.4rem}h2{font-size:1.1rem;margin:1.6rem 0 .4rem}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.86rem}
th,td{padding:.25rem .6rem;border-bottom:1px solid #d5dae2;text-align:right;white-space:nowrap}
th:first-child,td:first-child,td.words{text-align:left}td.words{white-space:normal;min-width:9rem}
svg{display:block}.shares th,.shares td{text-align:left}
rect{fill:#1c62b9}text{font:9px sans-serif;fill:#566274}.quiet{color:#566274}
"""


def _page(
    study: Study,
    sessions: Sequence[Session],
    rows: Sequence[Mapping[str, Any]],
    damaged: Iterable[str],
) -> str:
    states = [state_of(study, session) for session in sessions]
    told = f"{len(sessions)} participants, {states.count('finished')} of them to the end."
    simulated = sum(session.is_simulated for session in sessions)
    if simulated:
        told += f" {simulated} of them are simulated: their numbers say nothing about people."
    if lost := ", ".join(sorted(damaged)):
        told += f" Without those whose journals are damaged: {html.escape(lost)}."
    body = _histograms(rows) if study.common.kind == "display" else _table(rows)
    title = html.escape(study.common.title)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{title}</title><style>{_STYLE}</style></head><body><main>"
        f"<h1>{title}</h1><p>{told}</p>{body}"
        f'<p class="quiet">{_NOTES[study.common.kind]}</p></main></body></html>\n'
    )


_NOTES = {
    "display": (
        "Agreed: scores 1 to 3 of 7, where 1 is strongly agree; the published text does not say "
        "which scores it counts. Published: 27 participants, section 4.5.1; only these percentages "
        "are in the text."
    ),
    "rating": (
        "Unable: undecidable or wrong. Published, for low-resolution colour videos: unable to "
        "identify the difference 76 % of the time, by six people; the text does not say whether "
        "wrong answers count, so compare both undecidable and unable. Intervals are Wilson's, for "
        "independent answers; those of one person are not. Kappa is of those who have rated every "
        "stimulus of the study."
    ),
    "jnd": (
        "JND: difference in polygon counts, percent of the original, of which 70.7 % of the "
        "answers are right. Rows without a participant: means over participants, whose number "
        "stands under comparisons, with Student's interval. Nothing is published: the studies were "
        "planned."
    ),
}


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    columns, lines = _as_table(rows)
    heads = [name.replace("_", " ") for name in columns]
    return html_table(heads, [[_cell(cell) for cell in line] for line in lines])


def _cell(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _histograms(rows: Sequence[Mapping[str, Any]]) -> str:
    """Draw figures 4.7 to 4.9: for each part a table of questions and displays."""
    found = []
    for group in dict.fromkeys(row["group"] for row in rows):
        for part in dict.fromkeys(row["part"] for row in rows):
            own = [row for row in rows if row["part"] == part and row["group"] == group]
            if not own:
                continue
            displays = list(dict.fromkeys(row["display"] for row in own))
            head = "".join(f"<th>{html.escape(display)}</th>" for display in displays)
            lines = []
            for question in dict.fromkeys(row["question"] for row in own):
                cells = [row for row in own if row["question"] == question]
                wording = html.escape(cells[0]["wording"])
                lines.append(
                    f'<tr><td class="words">{wording}</td>'
                    + "".join(f"<td>{_histogram(cell)}</td>" for cell in cells)
                    + "</tr>"
                )
            title = f"{part} ({group})"
            table = (
                f'<table class="shares"><tr><th>Question</th>{head}</tr>{"".join(lines)}</table>'
            )
            found.append(f"<h2>{html.escape(title)}</h2>{wide(title, table)}")
    return "".join(found)


def _histogram(row: Mapping[str, Any]) -> str:
    counts = [row[f"score_{n}"] for n in range(1, 8)]
    most = max(*counts, 1)
    bars = "".join(
        f'<rect x="{18 * n + 2}" y="{40 - 36 * count / most:.1f}" width="14" '
        f'height="{36 * count / most:.1f}"/><text x="{18 * n + 6}" y="51">{n + 1}</text>'
        for n, count in enumerate(counts)
    )
    told = "no answers" if row["agree_percent"] is None else f"{row['agree_percent']:.1f} % agreed"
    if row["published_percent"] is not None:
        told += f"; published {row['published_percent']:g} %"
    return f'<svg width="130" height="54" role="img" aria-label="{told}">{bars}</svg>{told}'
