"""The report as one self-contained HTML page, with embedded styles, figures and pictures."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d._util.extras import imported
from manip3d.errors import FormatError
from manip3d.experiments import counted
from manip3d.io._files import regular_bytes
from manip3d.report._tables import measured_by, number, readable, tables

if TYPE_CHECKING:
    import jinja2

_MEDIA = {".svg": "image/svg+xml", ".webp": "image/webp", ".png": "image/png"}


def html(results: Mapping[str, Any], folder: Path) -> str:
    """Return the whole page."""
    page: str = (
        environment()
        .get_template("report.html")
        .render(style=template("style.css"), command=_command(results), **numbers(results, folder))
    )
    return page


def _command(results: Mapping[str, Any]) -> str:
    plan = results["plan"]
    options = f"--data {plan['data']} --scale {plan['scale']} --seed {plan['seed']}"
    return f"manip3d reproduce {' '.join(results['experiments'])} {options}"


def environment() -> jinja2.Environment:
    """Return the environment of the templates, with the filters that they use.

    Raises
    ------
    MissingExtraError
        jinja2 is not installed.
    """
    engine = imported("jinja2", "experiments")
    made: jinja2.Environment = engine.Environment(
        loader=engine.FunctionLoader(template),
        autoescape=True,
        undefined=engine.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"readable": readable, "counted": counted}
    return made


def numbers(results: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the content of a results folder as variables for the templates."""
    return {
        "results": results,
        "environment": results["environment"],
        "machines": list(measured_by(results)),
        "experiments": list(_experiments(results, folder)),
        "headlines": list(_headlines(results)),
        "sheets": list(_sheets(results, folder)),
        "tally": _tally(results),
    }


def template(name: str) -> str:
    """Return the text of a template."""
    return files("manip3d.report").joinpath("templates", name).read_text(encoding="utf-8")


def embedded(folder: Path, name: str) -> str:
    """Return a picture of the results folder as a ``data:`` address.

    Raises
    ------
    FormatError
        The file is outside the results folder, or is no picture.
    """
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()) or path.suffix not in _MEDIA:
        raise FormatError(f"picture {name!r}: expected a picture in the results folder")
    data = base64.b64encode(regular_bytes(path)).decode("ascii")
    return f"data:{_MEDIA[path.suffix]};base64,{data}"


def _experiments(results: Mapping[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    said: set[str] = set()  # a note that several experiments share is shown once
    for name, record in results["experiments"].items():
        notes = [note for note in record["notes"] if note not in said]
        said.update(notes)
        yield {
            "id": name,
            "title": record["title"],
            "notes": notes,
            "tables": tables(record),
            "verdicts": [
                verdict
                | {
                    "tone": _TONES.get(_kind(verdict["word"]), "na"),
                    "sign": _SIGNS.get(_kind(verdict["word"]), "–"),
                    "scores": _scores(verdict),
                    "why": _why(verdict),
                }
                for verdict in record["verdicts"]
            ],
            "figures": {t: embedded(folder, file) for t, file in record["figures"].items()},
            "errors": [row for row in record["rows"] if row.get("error")],
            "problems": record["problems"],
        }


def _why(verdict: Mapping[str, Any]) -> str:
    """Return a short explanation of a verdict other than "holds" and "does not hold", or ''."""
    findings = verdict["findings"]
    if verdict["word"] != "undecided":
        return str(verdict["unjudged"])
    if any(finding["holds"] is False for finding in findings):
        confirmed = any(f["holds"] and "published" in f["data"] for f in findings)
        return "holds on the published files" if confirmed else "the published files are not here"
    return next((f"{f['subject']}: {f['unjudged']}" for f in findings if f["unjudged"]), "")


def _scores(verdict: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return, for each kind of data, the number of findings judged and of those that hold."""
    kinds: dict[str, list[bool]] = {}
    for finding in verdict["findings"]:
        if finding["holds"] is not None:
            kinds.setdefault(finding["data"], []).append(finding["holds"])
    return [
        {
            "data": kind,
            "confirmed": sum(judged),
            "judged": len(judged),
            "tone": "yes" if all(judged) else "soft" if verdict["word"] == "undecided" else "no",
        }
        for kind, judged in kinds.items()
    ]


_TONES = {"holds": "yes", "holds elsewhere": "soft", "does not hold": "no", "undecided": "soft"}
_SIGNS = {"holds": "✓", "holds elsewhere": "✓", "does not hold": "✗", "undecided": "?"}


def _kind(word: str) -> str:
    """Return the verdict's word, where "holds on ..." counts as "holds elsewhere"."""
    return "holds elsewhere" if word.startswith("holds on ") else word


def _headlines(results: Mapping[str, Any]) -> Iterator[dict[str, str]]:
    """Yield results of QEM4VR on the published files, beside the published values."""
    seen = set()
    for name, record in results["experiments"].items():
        for column in (column for column in record["columns"] if column["ratio"]):
            for row in record["rows"]:
                measured, printed = row.get(column["name"]), row.get(column["published"])
                about = (row.get("model"), column["name"])
                wanted = row.get("method") == "qem4vr" and row["data"] == "published"
                if not wanted or row.get("level") or about in seen:
                    continue
                if isinstance(measured, float) and isinstance(printed, float) and printed > 0:
                    seen.add(about)
                    yield {
                        "experiment": name,
                        "what": f"{row['stands_in_for']}: {column['title']}",
                        "measured": number(measured, column),
                        "published": number(printed, column),
                        "ratio": f"{measured / printed:.2f}",
                    }


def _sheets(results: Mapping[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    for model, sheet in results.get("pictures", {}).items():
        rows = [
            {
                "style": style,
                "items": [
                    {"label": i["label"], "faces": i["faces"], "src": embedded(folder, i[style])}
                    for i in sheet["items"]
                    if style in i
                ],
            }
            for style in ("shaded", "textured")
        ]
        yield sheet | {"model": model, "rows": [row for row in rows if row["items"]]}


def _tally(results: Mapping[str, Any]) -> dict[str, int]:
    """Return the number of claims with each verdict."""
    words = [_kind(v["word"]) for e in results["experiments"].values() for v in e["verdicts"]]
    known = (*_TONES, "not judged", "not applicable", "reported")
    return {word: words.count(word) for word in known}
