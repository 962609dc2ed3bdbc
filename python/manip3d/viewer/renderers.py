"""Choice of the program that draws pictures: PyVista through EGL, or a headless Chromium.

A broken OpenGL driver kills the process instead of raising an error. Therefore a child process
draws the first picture, once; if it succeeds, the renderer is used.
"""

from __future__ import annotations

import contextlib
import functools
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, cast

from manip3d._util.extras import missing_modules, require
from manip3d.errors import InputError, RenderError

Renderer = Literal["pyvista", "chromium"]

_CURES = {
    "pyvista": (
        "pip install 'manip3d[viz]' and apt-get install libegl1 libgl1-mesa-dri libopengl0 "
        "libxrender1"
    ),
    "chromium": "apt-get install chromium",
}
if (Path(__file__).parent / "package.json").exists():  # a clone, in which the viewer is built
    _CURES["chromium"] += " and make setup"
_MODULES = {"pyvista": {"pyvista", "vtk", "PIL"}, "chromium": {"PIL"}}
_PROBE_SECONDS = 60.0  # time limit; with a cold disk cache the probe takes about 10 s


@contextlib.contextmanager
def egl_window() -> Iterator[None]:
    """Make VTK open its windows through EGL, which needs no display.

    VTK reads an environment variable when it creates a window. The variable is restored, so that
    interactive PyVista windows of the same process are not affected.
    """
    name = "VTK_DEFAULT_OPENGL_WINDOW"
    before = os.environ.get(name)
    os.environ[name] = before or "vtkEGLRenderWindow"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]


def _wanted() -> tuple[Renderer, ...]:
    choice = os.environ.get("MANIP3D_RENDERER", "").strip().lower()
    if choice in ("", "auto"):
        return ("pyvista", "chromium")
    if choice == "none":
        return ()
    if choice not in _CURES:
        raise InputError(
            f"MANIP3D_RENDERER: expected auto, {', '.join(_CURES)} or none, got {choice!r}"
        )
    return (cast("Renderer", choice),)


@functools.cache
def _complaint(name: Renderer) -> str | None:
    """Return why ``name`` cannot draw here; None: it can. Tested once per process."""
    try:
        child = subprocess.run(
            [sys.executable, "-m", "manip3d.viewer._probe", name],
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
            check=False,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        )
    except subprocess.TimeoutExpired:
        return f"no picture within {_PROBE_SECONDS:.0f} s"
    except OSError as error:
        return str(error)
    if child.returncode == 0:
        return None
    if child.returncode < 0:
        return f"the graphics driver crashed (signal {-child.returncode})"
    lines = child.stderr.strip().splitlines()
    if not lines:
        return f"exit code {child.returncode}"
    return re.sub(r"^[\w.]+(Error|Exception): ", "", lines[-1])


def check(name: Renderer) -> None:
    """Refuse a renderer that cannot draw here.

    Raises
    ------
    RenderError
        The renderer does not work; the message says why and what to do.
    """
    complaint = _complaint(name)
    if complaint is not None:
        raise RenderError(f"{name}: {complaint} (cure: {_CURES[name]})")


def renderer() -> Renderer:
    """Return the program that draws pictures here.

    The environment variable ``MANIP3D_RENDERER`` selects one (``pyvista`` or ``chromium``), forbids
    all (``none``), or selects the first that works (``auto``, the default).

    Returns
    -------
    'chromium' or 'pyvista'

    Raises
    ------
    MissingExtraError
        The modules of no renderer are installed.
    RenderError
        No renderer works; the message says for each one why and what to do.
    InputError
        ``MANIP3D_RENDERER`` has another value.

    Examples
    --------
    >>> from manip3d import viewer
    >>> viewer.renderer()  # doctest: +SKIP
    'pyvista'
    """
    wanted = _wanted()
    if not wanted:
        raise RenderError("pictures are switched off by MANIP3D_RENDERER=none")
    absent = set(missing_modules("viz"))
    if all(_MODULES[name] & absent for name in wanted):
        require("viz")
    complaints: list[str] = []
    for name in wanted:
        complaint = _complaint(name)
        if complaint is None:
            return name
        complaints.append(f"{name}: {complaint} (cure: {_CURES[name]})")
    raise RenderError("no picture can be drawn here: " + "; ".join(complaints))
