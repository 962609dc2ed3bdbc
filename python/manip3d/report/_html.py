"""The report as one HTML page that loads nothing: styles, figures and pictures are inside."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from manip3d.errors import FormatError, MissingExtraError
from manip3d.report._tables import number, table

_MEDIA = {".svg": "image/svg+xml", ".webp": "image/webp", ".png": "image/png"}


def html(results: Mapping[str, Any], folder: Path) -> str:
    """The whole page."""
    try:
        import jinja2
    except ImportError:
        raise MissingExtraError("jinja2", "experiments") from None
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_template),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page: str = environment.get_template("report.html").render(
        style=_template("style.css"),
        results=results,
        environment=results["environment"],
        experiments=list(_experiments(results, folder)),
        headlines=list(_headlines(results)),
        sheets=list(_sheets(results, folder)),
        tally=_tally(results),
    )
    return page


def _template(name: str) -> str:
    return files("manip3d.report").joinpath("templates", name).read_text(encoding="utf-8")


def _embedded(folder: Path, name: str) -> str:
    """A file of the results folder as a ``data:`` address.

    Raises
    ------
    FormatError
        The results name a file outside their folder, or of another kind.
    """
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()) or path.suffix not in _MEDIA:
        raise FormatError(f"picture {name!r}: expected a picture in the results folder")
    data = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{_MEDIA[path.suffix]};base64,{data}"


def _experiments(results: Mapping[str, Any], folder: Path) -> Iterator[dict[str, Any]]:
    said: set[str] = set()  # a note that several experiments share is read once
    for name, record in results["experiments"].items():
        notes = [note for note in record["notes"] if note not in said]
        said.update(notes)
        yield {
            "id": name,
            "title": record["title"],
            "notes": notes,
            "table": table(record),
            "verdicts": [verdict | _score(verdict) for verdict in record["verdicts"]],
            "figures": {t: _embedded(folder, file) for t, file in record["figures"].items()},
            "errors": [row for row in record["rows"] if row.get("error")],
        }


def _score(verdict: Mapping[str, Any]) -> dict[str, int]:
    """In how many of the parts that could be judged a claim holds."""
    judged = [f["holds"] for f in verdict["findings"] if f["holds"] is not None]
    return {"confirmed": sum(judged), "judged": len(judged)}


def _headlines(results: Mapping[str, Any]) -> Iterator[dict[str, str]]:
    """What QEM4VR reaches on the published files, beside what is printed."""
    seen = set()
    for name, record in results["experiments"].items():
        for column in (column for column in record["columns"] if column["ratio"]):
            for row in record["rows"]:
                measured, printed = row.get(column["name"]), row.get(column["published"])
                about = (row.get("model"), column["name"])
                wanted = row.get("method") == "qem4vr" and row.get("same_file")
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
                    {"label": i["label"], "faces": i["faces"], "src": _embedded(folder, i[style])}
                    for i in sheet["items"]
                    if style in i
                ],
            }
            for style in ("shaded", "textured")
        ]
        yield sheet | {"model": model, "rows": [row for row in rows if row["items"]]}


def _tally(results: Mapping[str, Any]) -> dict[str, int]:
    """How many claims hold, do not hold, do not apply."""
    words = [v["word"] for e in results["experiments"].values() for v in e["verdicts"]]
    return {word: words.count(word) for word in ("holds", "does not hold", "not applicable")}
