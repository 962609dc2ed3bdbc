"""The report as Markdown: the same tables and verdicts, without pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from manip3d.report._tables import Cell, Table, measured_by, readable, tables


def markdown(results: Mapping[str, Any]) -> str:
    """Return the whole report as Markdown."""
    lines = ["# Measured beside published", "", results["environment"]["date"], ""]
    for machine in measured_by(results):
        lines += [_machine(machine), ""]
    for name, record in results["experiments"].items():
        lines += [f"## {name}: {_escaped(record['title'])}", ""]
        lines += [f"{_escaped(note)}\n" for note in record["notes"]]
        lines += [*_tables(record), *_verdicts(record), ""]
    return "\n".join(lines)


def _machine(machine: Mapping[str, Any]) -> str:
    whose = ", ".join(machine["experiments"])
    return f"manip3d {machine['manip3d']}, {machine['cpu']}, {machine['os']}: {whose}"


def _escaped(text: str) -> str:
    return text.replace("\\", "\\\\").replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")


def _tables(record: Mapping[str, Any]) -> Iterator[str]:
    for shown in tables(record):
        if shown.title:
            yield f"**{_escaped(shown.title)}**\n"
        yield from _table(shown)
        yield ""


def _table(shown: Table) -> Iterator[str]:
    yield "| " + " | ".join(["model", *map(_escaped, shown.headings)]) + " |"
    yield "|" + " --- |" * (len(shown.headings) + 1)
    for group in shown.groups:
        about = _escaped(f"**{group.title}** ({'; '.join(group.about)})")
        for row in group.rows:
            yield f"| {about} | " + " | ".join(_cell(cell) for cell in row) + " |"


def _cell(cell: Cell) -> str:
    text = _escaped(cell.text)
    text = f"**{text}**" if cell.kind == "best" else text
    if not cell.printed:
        return text
    whose = cell.hint or "published"
    return f"{text} ({', '.join(filter(None, (f'{whose}: {cell.printed}', cell.ratio)))})"


def _verdicts(record: Mapping[str, Any]) -> Iterator[str]:
    for verdict in record["verdicts"]:
        reason = f" ({verdict['unjudged']})" if verdict["unjudged"] else ""
        claim, source = _escaped(readable(verdict["claim"])), _escaped(verdict["source"])
        yield f"- **{verdict['word']}**{_escaped(reason)}: {claim} ({source})"
        for finding in verdict["findings"]:
            word = {True: "yes", False: "no", None: "not judged"}[finding["holds"]]
            subject, numbers = (readable(finding[name]) for name in ("subject", "numbers"))
            numbers += f"; {finding['unjudged']}" if finding["unjudged"] else ""
            data = f" [{finding['data']}]" if finding["data"] else ""
            yield f"  - {_escaped(subject + data)}: {word}; {_escaped(numbers)}"
