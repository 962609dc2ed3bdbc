"""Which program draws pictures here: PyVista through EGL, a headless Chromium, or none.

A broken OpenGL driver does not raise, it kills the process. So the first picture is drawn by a
child process, once; what it does decides.
"""

from __future__ import annotations

import contextlib
import functools
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Literal, cast

from manip3d.errors import InputError, RenderError

Renderer = Literal["pyvista", "chromium"]

_CURES = {
    "pyvista": (
        "pip install 'manip3d[viz]' and apt-get install libegl1 libgl1-mesa-dri libopengl0 "
        "libxrender1"
    ),
    "chromium": "apt-get install chromium and make setup",
}
_PROBE_SECONDS = 60.0  # a cold disk needs about 10


@contextlib.contextmanager
def egl_window() -> Iterator[None]:
    """Makes VTK open its windows through EGL, which needs no display.

    VTK reads the variable when it makes a window. It is put back, so that interactive PyVista
    windows of the same process stay what they were.
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
    """Why ``name`` does not draw here; ``None`` if it does. Tried once per process."""
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
    return lines[-1] if lines else f"exit code {child.returncode}"


def check(name: Renderer) -> None:
    """Refuse a renderer that does not draw here.

    Raises
    ------
    RenderError
        The message gives its complaint and the cure.
    """
    complaint = _complaint(name)
    if complaint is not None:
        raise RenderError(f"{name}: {complaint} (cure: {_CURES[name]})")


def renderer() -> Renderer:
    """Return the program that draws pictures here.

    The environment variable ``MANIP3D_RENDERER`` chooses one (``pyvista``), forbids all
    (``none``), or leaves it to the first that works (``auto``).

    Returns
    -------
    'chromium' or 'pyvista'

    Raises
    ------
    RenderError
        None works; the message gives each one's complaint and cure.
    InputError
        ``MANIP3D_RENDERER`` is not one of these words.

    Examples
    --------
    >>> from manip3d import viewer
    >>> viewer.renderer()  # doctest: +SKIP
    'pyvista'
    """
    wanted = _wanted()
    if not wanted:
        raise RenderError("pictures are switched off by MANIP3D_RENDERER=none")
    complaints: list[str] = []
    for name in wanted:
        complaint = _complaint(name)
        if complaint is None:
            return name
        complaints.append(f"{name}: {complaint} (cure: {_CURES[name]})")
    raise RenderError("no picture can be drawn here: " + "; ".join(complaints))
