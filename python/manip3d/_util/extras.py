"""Optional packages: the modules of each extra, and checks that they are installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from typing import Any

from manip3d.errors import MissingExtraError

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


def missing_modules(extra: str) -> list[str]:
    """Return the modules of an extra that are not installed."""
    return [name for name in EXTRAS[extra] if not _is_installed(name)]


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:
        return False


def require(extra: str) -> None:
    """Check that all modules of an extra are installed.

    Raises
    ------
    MissingExtraError
        A module is not installed.
    """
    absent = missing_modules(extra)
    if absent:
        names = [DISTRIBUTIONS.get(name, (name,))[0] for name in absent]
        raise MissingExtraError(", ".join(names), extra)


def scipy_stats() -> Any:
    """Import ``scipy.stats``.

    Raises
    ------
    MissingExtraError
        SciPy is not installed.
    """
    try:
        from scipy import stats
    except ImportError as error:
        raise MissingExtraError("scipy", "live") from error
    return stats


def opencv() -> Any:
    """Import OpenCV.

    Raises
    ------
    MissingExtraError
        OpenCV is not installed.
    """
    try:
        import cv2
    except ImportError as error:
        raise MissingExtraError("opencv-python-headless", "alert") from error
    return cv2
