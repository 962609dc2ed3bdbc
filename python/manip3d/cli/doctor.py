"""``manip3d doctor``: report what is installed, what is missing, and how to mend it."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from manip3d._util.extras import DISTRIBUTIONS, EXTRAS, load, missing_modules
from manip3d.cli.options import Json
from manip3d.cli.terminal import Progress, Terminal, table
from manip3d.errors import Error, way_to_install

if TYPE_CHECKING:
    from rich.console import Console


def examine(progress: Progress | None = None) -> list[dict[str, Any]]:
    """Return the results of all checks, in the order of the output.

    Each has ``what``, ``state`` ('ok', 'missing' or 'broken'), ``detail`` and ``cure``. The
    packages of the extras take the time: they are imported.
    """
    extras = _extras(progress)
    return [_core(), *extras, _recordings(), _pictures(), _viewer(), *_data(), *_settings()]


def _check(what: str, state: str, detail: str, cure: str = "") -> dict[str, Any]:
    return {"what": what, "state": state, "detail": detail, "cure": cure}


def _core() -> dict[str, Any]:
    from manip3d import Mesh, __version__

    detail = f"manip3d {__version__}, Python {platform.python_version()}, {platform.machine()}"
    try:
        Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).validate()
    except Exception as error:  # the report states any error
        return _check("core", "broken", f"{detail}: {error}", "install manip3d again")
    return _check("core", "ok", f"{detail}, {len(os.sched_getaffinity(0))} cores")


def _extras(progress: Progress | None) -> list[dict[str, Any]]:
    checks = []
    for number, (extra, modules) in enumerate(EXTRAS.items()):
        if progress is not None:
            progress(number / len(EXTRAS), extra)
        absent = missing_modules(extra)
        if absent:
            detail = f"no {', '.join(absent)}"
            checks.append(_check(f"extra {extra}", "missing", detail, way_to_install(extra)))
        else:
            checks.append(_loaded(extra, modules))
    return checks


def _loaded(extra: str, modules: Sequence[str]) -> dict[str, Any]:
    """Check that the modules of an extra can be imported, which a missing library can prevent."""
    try:
        load(extra)
    except Exception as error:  # packages raise any error when they do not fit each other
        cure = "install what the message names, or the package again"
        return _check(f"extra {extra}", "broken", str(error) or type(error).__name__, cure)
    versions = ", ".join(f"{name} {_version(name)}" for name in modules)
    return _check(f"extra {extra}", "ok", versions)


def _version(module: str) -> str:
    from importlib import metadata

    for name in DISTRIBUTIONS.get(module, (module,)):
        try:
            return metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return "of unknown version"


def _recordings() -> dict[str, Any]:
    from manip3d import capture

    mkv = next(scheme for scheme in capture.sources() if scheme.name == "mkv")
    state = "ok" if mkv.is_available else "missing"
    return _check("recordings (mkv:)", state, mkv.reason or mkv.description, mkv.cure)


def _pictures() -> dict[str, Any]:
    from manip3d.viewer import renderer

    try:
        return _check("off-screen pictures", "ok", f"drawn by {renderer()}")
    except Error as error:  # its message names the cure
        return _check("off-screen pictures", "missing", str(error))


def _viewer() -> dict[str, Any]:
    dist = Path(__file__).parents[1] / "viewer" / "dist"
    if any(dist.glob("*.js")):
        return _check("interactive viewer", "ok", "the bundle is here")
    return _check("interactive viewer", "missing", f"no bundle in {dist}", "make setup")


def _data() -> list[dict[str, Any]]:
    from manip3d import datasets
    from manip3d.datasets._registry import chosen_folder_problem

    checks = []
    problem = chosen_folder_problem()
    if problem:
        checks.append(_check("MANIP3D_DATA", "broken", problem, "set it to the data folder"))
    known = datasets.registry().values()
    absent = [data_set.name for data_set in known if not datasets.is_here(data_set)]
    if absent:
        detail = f"{len(absent)} of {len(known)} data sets are not here; simulated models stand in"
        cure = "set MANIP3D_DATA, or see 'manip3d data list'"
        checks.append(_check("real data", "missing", detail, cure))
    else:
        checks.append(_check("real data", "ok", f"{len(known)} in {datasets.data_root()}"))
    return checks


def _settings() -> list[dict[str, Any]]:
    names = sorted(name for name in os.environ if name.startswith("MANIP3D_"))
    set_ = ", ".join(f"{name}={os.environ[name]}" for name in names) or "none set"
    return [_check("settings", "ok", f"{set_}; {sys.executable}")]


def show(console: Console, checks: list[dict[str, Any]]) -> None:
    """Print one line per check, then the cures."""
    signs = {"ok": "ok", "missing": "missing", "broken": "BROKEN"}
    rows = [(signs[c["state"]], c["what"], c["detail"]) for c in checks]
    table(console, rows, ("state", "what", "detail"))
    cures = [(check["what"], check["cure"]) for check in checks if check["cure"]]
    if cures:
        console.print("\nCures")
        table(console, cures)


def doctor(as_json: Json = False) -> None:
    """Print what is installed, what is missing, and how to mend it.

    The reason is printed with each missing part. The exit code is 1 if something is broken.

    Example: manip3d doctor
    """
    shell = Terminal(as_json=as_json)
    with shell.progress("doctor") as progress:
        checks = examine(progress)
    shell.result(checks, lambda console: show(console, checks))
    if any(check["state"] == "broken" for check in checks):
        raise typer.Exit(1)
