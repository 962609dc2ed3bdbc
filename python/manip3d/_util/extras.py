"""Optional packages: the modules of each extra, and checks that they are installed."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping
from typing import Any

from manip3d._util.held_signals import signals_held
from manip3d.errors import BrokenExtraError, MissingExtraError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "io": ("trimesh", "PIL", "yaml"),
    "viz": ("pyvista", "vtk", "PIL"),
    "simulate": ("open3d", "PIL"),
    "experiments": ("matplotlib", "jinja2", "scipy", "pooch", "PIL"),
    "demo": ("pyvista", "vtk", "PIL", "open3d", "jinja2"),
    "notebook": ("ipykernel", "nbclient", "pandas"),
    "velodyne": ("yaml",),
    "las": ("laspy", "lazrs"),
    "e57": ("pye57",),
    "draco": ("DracoPy",),
    "exr": ("OpenEXR",),
    "ouster": ("ouster",),
    "bags": ("rosbags",),
    "pose": ("mediapipe",),
    "video": ("av",),
    "dask": ("distributed",),
    "remote": ("fsspec", "s3fs", "aiohttp"),
    "parquet": ("pyarrow",),
    "alert": ("cv2", "PIL"),
    "live": ("aiohttp", "cryptography", "scipy", "open3d", "PIL"),
    "diary": ("sqlalchemy", "cryptography", "scipy", "PIL"),
}
"""Modules that each extra installs."""

DISTRIBUTIONS: Mapping[str, tuple[str, ...]] = {
    "PIL": ("pillow",),
    "cv2": ("opencv-python-headless",),
    "open3d": ("open3d-cpu", "open3d"),
    "ouster": ("ouster-sdk",),
    "yaml": ("pyyaml",),
}
"""Distributions of modules whose distribution has another name."""

_COMPILED: Mapping[str, str] = {
    "PIL": "PIL.Image",
    "ouster": "ouster.sdk.core",
    "scipy": "scipy.special",
}
"""Module with compiled code of packages that load none when they are imported themselves."""


def missing_modules(extra: str) -> list[str]:
    """Return the modules of an extra that are not installed."""
    return [name for name in EXTRAS[extra] if not _is_installed(name)]


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def require(*extras: str) -> None:
    """Check that all modules of one or several extras are installed.

    Raises
    ------
    MissingExtraError
        A module is not installed; the error names all of them, and their extras.
    """
    absent = {extra: found for extra in extras if (found := missing_modules(extra))}
    if absent:
        modules = dict.fromkeys(module for found in absent.values() for module in found)
        raise MissingExtraError(", ".join(map(_distribution, modules)), ",".join(absent))


def load(extra: str) -> None:
    """Import all modules of an extra with their compiled code.

    Raises
    ------
    MissingExtraError
        A module is not installed.
    BrokenExtraError
        A module is installed but cannot be imported.
    """
    for module in EXTRAS[extra]:
        imported(_COMPILED.get(module, module), extra)


def _distribution(module: str) -> str:
    return DISTRIBUTIONS.get(module, (module,))[0]


def imported(module: str, extra: str) -> Any:
    """Import a module that one of manip3d's extras installs.

    Ctrl-C takes effect when the module is whole, and a second one at once: compiled packages that
    are imported in part cannot be imported again, and Open3D then prints to stdout at exit and
    changes the exit code.

    Parameters
    ----------
    module : str
        Name of the module, such as ``PIL.Image``.
    extra : str
        The extra, for the error.

    Raises
    ------
    MissingExtraError
        The module is not installed.
    BrokenExtraError
        It is installed but cannot be imported, for example because a shared library is missing.

    Examples
    --------
    >>> from manip3d._util.extras import imported
    >>> imported("PIL.Image", "io").new("L", (4, 3)).size
    (4, 3)
    """
    package = module.partition(".")[0]
    try:
        with signals_held():
            return importlib.import_module(module)
    except ImportError as error:
        if _was_interrupted(error):
            raise KeyboardInterrupt from None
        if isinstance(error, ModuleNotFoundError) and f"{module}.".startswith(f"{error.name}."):
            raise MissingExtraError(_distribution(package), extra) from error
        raise BrokenExtraError(_distribution(package), extra, str(error)) from error


def _was_interrupted(error: BaseException) -> bool:
    """Whether an exception comes from Ctrl-C; extension modules turn it into an ImportError."""
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__ or cause.__context__
    return cause is not None


def why_blind(error: MissingExtraError | BrokenExtraError) -> str:
    """Return why cameras are absent that only an extra can compare with the LiDAR."""
    if isinstance(error, BrokenExtraError):
        return str(error)
    return f"needs the extra {error.extra} (pip install 'manip3d[{error.extra}]')"
