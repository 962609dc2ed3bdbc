"""The report as Markdown: the same tables and verdicts, without pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from manip3d.report._tables import Cell, table


def markdown(results: Mapping[str, Any]) -> str:
    """The whole report."""
    environment = results["environment"]
    lines = [
        "# Measured beside published",
        "",
        f"manip3d {environment['manip3d']}, {environment['date']}, {environment['cpu']}, "
        f"{environment['os']}",
        "",
    ]
    for name, record in results["experiments"].items():
        lines += [f"## {name}: {_escaped(record['title'])}", ""]
        lines += [f"{_escaped(note)}\n" for note in record["notes"]]
        lines += [*_table(record), "", *_verdicts(record), ""]
    return "\n".join(lines)


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def _table(record: Mapping[str, Any]) -> Iterator[str]:
    shown = table(record)
    yield "| " + " | ".join(["model", *map(_escaped, shown.headings)]) + " |"
    yield "|" + " --- |" * (len(shown.headings) + 1)
    for group in shown.groups:
        about = _escaped(f"**{group.title}** ({'; '.join(group.about)})")
        for row in group.rows:
            yield f"| {about} | " + " | ".join(_cell(cell) for cell in row) + " |"


def _cell(cell: Cell) -> str:
    text = _escaped(cell.text)
    return {"best": f"**{text}**", "beside": f"*({text})*"}.get(cell.kind, text)


def _verdicts(record: Mapping[str, Any]) -> Iterator[str]:
    for verdict in record["verdicts"]:
        yield f"- **{verdict['word']}**: {_escaped(verdict['claim'])} ({verdict['source']})"
        for finding in verdict["findings"]:
            word = {True: "yes", False: "no", None: "not applicable"}[finding["holds"]]
            yield f"  - {_escaped(finding['subject'])}: {word}; {_escaped(finding['numbers'])}"
