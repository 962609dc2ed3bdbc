"""The results of experiments beside the published values, as one file."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import Error, FormatError, InputError
from manip3d.experiments import RESULTS_FORMAT
from manip3d.io._files import atomic_write, regular_bytes

_KINDS = (".html", ".md", ".csv")


@checked
def write_report(results_dir: str | os.PathLike[str], output: str | os.PathLike[str]) -> None:
    """Write the report of a results folder as one file.

    Parameters
    ----------
    results_dir : path
        A folder that `manip3d.experiments.run` has filled.
    output : path
        ``.html``: a self-contained page with figures and pictures; ``.md``: the tables and
        verdicts as Markdown; ``.csv``: the rows. An existing file is replaced.

    Raises
    ------
    InputError
        The folder holds no results, or the suffix is none of the three.
    FormatError
        ``results.json`` is not a result of a run.
    MissingExtraError
        jinja2 is not installed (``.html`` only).

    Examples
    --------
    >>> from manip3d import report
    >>> report.write_report("results", "results.html")  # doctest: +SKIP
    """
    path = path_of(output, "output")
    if path.suffix.lower() not in _KINDS:
        raise InputError(f"output: expected a name ending in {', '.join(_KINDS)}, got {path.name}")
    folder = path_of(results_dir, "results_dir")
    results = _load(folder)
    try:
        text = _text(results, folder, path.suffix.lower())
    except (Error, OSError, MemoryError):
        raise
    except Exception as error:  # templates raise various types for damaged results
        raise FormatError(
            f"damaged results: {type(error).__name__}: {error}", file=str(folder)
        ) from error
    atomic_write(path, text)


def _text(results: dict[str, Any], folder: Path, kind: str) -> str:
    if kind == ".csv":
        return regular_bytes(folder / "results.csv").decode("utf-8")
    if kind == ".md":
        from manip3d.report._markdown import markdown

        return markdown(results)
    from manip3d.report._html import html

    return html(results, folder)


def _load(folder: Path) -> dict[str, Any]:
    path = folder / "results.json"
    if not path.is_file():
        raise InputError(f"{folder}: expected a results folder, found no results.json in it")
    try:
        results = json.loads(regular_bytes(path))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"not JSON: {error}", file=str(path)) from error
    if not isinstance(results, dict) or results.get("format") != RESULTS_FORMAT:
        raise FormatError(
            f"expected results of 'manip3d reproduce' in format {RESULTS_FORMAT}; "
            "running it again brings them up to date",
            file=str(path),
        )
    return results
