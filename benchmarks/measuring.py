"""Cost of a call (processor time, wall time, peak memory), and a description of the machine."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

PACKAGES = ("manip3d", "numpy", "pymeshlab", "meshlib", "open3d-cpu", "open3d", "vtk",
            "fast-simplification", "trimesh")  # fmt: skip


@dataclass(frozen=True)
class Cost:
    """Cost of one call.

    Attributes
    ----------
    cpu_s : float
        Processor time of all threads of the process, the most repeatable time on a shared machine.
    wall_s : float
        Wall time.
    base_bytes : int
        Resident memory before the call: interpreter, libraries, input.
    peak_bytes : int
        Largest resident memory during the call. It is Linux's VmHWM, which is reset before the
        call; ``ru_maxrss`` would contain the peak of loading.
    """

    cpu_s: float
    wall_s: float
    base_bytes: int
    peak_bytes: int


def _status_bytes(field: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(field + ":"):
            return 1024 * int(line.split()[1])
    raise OSError(f"/proc/self/status has no {field}")


def measure(call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> tuple[T, Cost]:
    """Return the call's result and its cost."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # so that the call cannot reuse memory freed by loading
    Path("/proc/self/clear_refs").write_text("5")  # resets VmHWM to VmRSS
    base = _status_bytes("VmRSS")
    cpu, wall = time.process_time(), time.perf_counter()
    result = call(*args, **kwargs)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return result, Cost(cpu, wall, base, _status_bytes("VmHWM"))


def one_thread() -> None:
    """Pin this process and its children to one core; call this before libraries are imported."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    os.environ["OMP_NUM_THREADS"] = os.environ["MANIP3D_THREADS"] = "1"


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def environment() -> dict[str, Any]:
    """Return a description of the machine, and versions of packages."""
    model = next(
        line.partition(":")[2].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    )
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "memory_gib": round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30),
        "system": f"{platform.freedesktop_os_release()['PRETTY_NAME']}, {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: found for name in PACKAGES if (found := _version(name))},
    }
