"""Description of the machine, the operating system and the package versions of a run."""

from __future__ import annotations

import datetime
import os
import platform
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from manip3d import __version__
from manip3d._util.fingerprint import code_fingerprint

_LIBRARIES = ("numpy", "scipy", "matplotlib", "open3d", "vtk", "pyvista", "trimesh")


def environment() -> dict[str, Any]:
    """Return machine, operating system, package versions and time, for the record of a run."""
    now = datetime.datetime.now(datetime.UTC)
    return {"date": now.isoformat(timespec="seconds"), **machine()}


@cache
def machine() -> dict[str, Any]:
    """Return machine, operating system and package versions, for the record of a case."""
    return {
        "manip3d": __version__,
        "code": code_fingerprint(),
        "cpu": _cpu(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1),
        "os": _os(),
        "python": platform.python_version(),
        "libraries": _versions(),
    }


def _cpu() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _os() -> str:
    try:
        name = platform.freedesktop_os_release()["PRETTY_NAME"]
    except OSError:
        name = platform.system()
    return f"{name}, Linux {platform.release()}, {platform.machine()}"


def _versions() -> dict[str, str]:
    found = {}
    for name in _LIBRARIES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found
