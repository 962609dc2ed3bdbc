"""The demo page: five stories with pictures and commands, followed by tables of experiments."""

from __future__ import annotations

import base64
import importlib.util
import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from manip3d.errors import FormatError, MissingExtraError
from manip3d.experiments import DataTier, Plan, RunSummary, run, select
from manip3d.experiments.stories import STORIES
from manip3d.io._files import atomic_write, regular_bytes

__all__ = ["NUMBERS", "Demo", "run_demo"]

NUMBERS = ("table-2.2", "table-2.3", "table-2.4", "table-3.4", "table-4.1", "table-6.1")
"""Experiments whose tables follow the stories. Their models are as large as the published ones."""

_LEADS = {
    "model": (
        "Edge collapse that keeps what a viewer sees: open borders, seams of the texture, thin "
        "parts. Beside it the plain quadric error metric, with as many faces."
    ),
    "depth": (
        "One frame of a depth camera, made so light that it can be sent for every frame: few "
        "points, chosen where the surface bends, with the picture as their texture."
    ),
    "phantom": (
        "For people who feel pain in a limb that is gone: the limb that is there is mirrored into "
        "the picture, as fast as the camera delivers."
    ),
    "scan": (
        "Somebody pastes a car into the scan of a street. The detectors know how a scanner "
        "measures: what it would have hidden, and how its points spread with distance."
    ),
    "proof": (
        "Forensics can miss an edit; a key cannot be guessed. The scanner's owner embeds a keyed "
        "watermark in the lowest bits of the points, somebody moves an object, and the verifier "
        "says in which sectors. The key is drawn anew each time, so these files differ in their "
        "lowest bits."
    ),
}

_MODULES = {"jinja2": "jinja2", "PIL": "pillow", "open3d": "open3d"}
_DRAWING = ("pyvista", "vtkmodules")


@dataclass(frozen=True)
class Demo:
    """A finished demo.

    Attributes
    ----------
    page : Path
        The self-contained page.
    summary : RunSummary
        Summary of the run of all stories and tables.
    """

    page: Path
    summary: RunSummary


def run_demo(
    folder: str | os.PathLike[str],
    *,
    data: DataTier = "auto",
    seed: int = 0,
    jobs: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Demo:
    """Run the stories and the tables of the demo and write its page.

    Parameters
    ----------
    folder : path
        Output folder, created if it does not exist. Results of an interrupted or finished demo in
        it are reused.
    data : 'auto', 'real' or 'simulated'
        ``auto``: recorded data if they are found under ``MANIP3D_DATA``, else simulated data.
    seed : int
        Seed of the random choices of the tables.
    jobs : int
        Number of processes; 0: one per core.
    progress : callable, optional
        Called with the fraction done and the name of the part that was just finished.

    Returns
    -------
    Demo
        The page and the summary of the run.

    Raises
    ------
    MissingExtraError
        A package of the extra ``demo`` is not installed.
    DataMissingError, KeyboardInterrupt
        See `manip3d.experiments.run`.
    """
    _require_packages()
    tables = [replace(experiment, sheets=None) for experiment in select(list(NUMBERS))]
    place = Path(folder)
    plan = Plan(data=data, scale="quick", seed=seed)
    summary = run([*STORIES, *tables], place, plan=plan, jobs=jobs, progress=progress)
    page = place / "demo.html"
    atomic_write(page, _page(summary.results, place))
    return Demo(page, summary)


def _require_packages() -> None:
    """Check that all packages of the demo are installed, before the work.

    Raises
    ------
    MissingExtraError
        Packages are not installed; the error names all of them.
    """
    missing = [
        name for module, name in _MODULES.items() if importlib.util.find_spec(module) is None
    ]
    draws = all(importlib.util.find_spec(module) is not None for module in _DRAWING)
    if not draws and shutil.which("chromium") is None:
        missing.append("pyvista")
    if missing:
        raise MissingExtraError(", ".join(missing), "demo")


def _page(results: Mapping[str, Any], folder: Path) -> str:
    from manip3d.report import _html

    tables = {n: e for n, e in results["experiments"].items() if n in NUMBERS}
    plan = results["plan"]
    page: str = (
        _html.environment()
        .get_template("demo.html")
        .render(
            style=_html.template("style.css") + _html.template("demo.css"),
            stories=[
                _story(e, folder) for n, e in results["experiments"].items() if n not in tables
            ],
            command=f"manip3d demo --data {plan['data']} --seed {plan['seed']}",
            **_html.numbers({**results, "experiments": tables}, folder),
        )
    )
    return page


def _story(record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    (row,) = record["rows"]
    captions = row.get("captions", [])
    return {
        "name": row["story"],
        "title": record["title"],
        "lead": _LEADS[row["story"]],
        "data": row["data"],
        "role": row["role"],
        "commands": row["commands"],
        "facts": row.get("facts", []),
        "error": row["error"],
        "pictures": [
            {"caption": caption, "src": _picture(folder, row[f"picture_{number}"])}
            for number, caption in enumerate(captions)
        ],
    }


def _picture(folder: Path, name: str) -> str:
    """Return a story's picture as a ``data:`` address.

    Raises
    ------
    FormatError
        The file is outside the results folder.
    """
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise FormatError(f"picture {name!r}: expected a picture in the results folder")
    return f"data:image/webp;base64,{base64.b64encode(regular_bytes(path)).decode('ascii')}"
