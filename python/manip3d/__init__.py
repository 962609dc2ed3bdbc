"""manip3d: make 3D content lighter, change it, and tell whether somebody else changed it."""

from __future__ import annotations

import importlib

from manip3d._util import main_interpreter  # noqa: F401

TYPE_CHECKING = False  # importing `typing` would take ten times as long as the rest of this module
if TYPE_CHECKING:
    from manip3d import (
        authenticate,
        batch,
        camera,
        capture,
        datasets,
        errors,
        experiments,
        forge,
        io,
        metrics,
        modify,
        report,
        simplify,
        simulate,
        viewer,
    )
    from manip3d._core import __version__
    from manip3d.camera import Intrinsics, Registration
    from manip3d.errors import (
        BrokenExtraError,
        DeviceError,
        Error,
        FormatError,
        InputError,
        MissingExtraError,
        RenderError,
    )
    from manip3d.io import read_mesh
    from manip3d.lidar import Box, LidarFrame
    from manip3d.mesh import Material, Mesh, Texture
    from manip3d.rgbd import RgbdCalibration, RgbdFrame, Skeleton
    from manip3d.viewer import view

__all__ = [
    "Box",
    "BrokenExtraError",
    "DeviceError",
    "Error",
    "FormatError",
    "InputError",
    "Intrinsics",
    "LidarFrame",
    "Material",
    "Mesh",
    "MissingExtraError",
    "Registration",
    "RenderError",
    "RgbdCalibration",
    "RgbdFrame",
    "Skeleton",
    "Texture",
    "__version__",
    "authenticate",
    "batch",
    "camera",
    "capture",
    "datasets",
    "errors",
    "experiments",
    "forge",
    "io",
    "metrics",
    "modify",
    "read_mesh",
    "report",
    "simplify",
    "simulate",
    "view",
    "viewer",
]

_MODULES = frozenset(
    {
        "authenticate",
        "batch",
        "camera",
        "capture",
        "datasets",
        "errors",
        "experiments",
        "forge",
        "io",
        "metrics",
        "modify",
        "report",
        "simplify",
        "simulate",
        "viewer",
    }
)
_HOMES = {
    "Box": "lidar",
    "BrokenExtraError": "errors",
    "DeviceError": "errors",
    "Error": "errors",
    "FormatError": "errors",
    "InputError": "errors",
    "Intrinsics": "camera",
    "LidarFrame": "lidar",
    "Material": "mesh",
    "Mesh": "mesh",
    "MissingExtraError": "errors",
    "Registration": "camera",
    "RenderError": "errors",
    "RgbdCalibration": "rgbd",
    "RgbdFrame": "rgbd",
    "Skeleton": "rgbd",
    "Texture": "mesh",
    "__version__": "_core",
    "read_mesh": "io",
    "view": "viewer",
}
"""Module of each top-level name, imported at the first use of the name.

The import of this package must be quick, because the command cannot handle Ctrl-C before it ends.
"""


if not TYPE_CHECKING:  # else type checkers would accept any name

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return importlib.import_module(f"manip3d.{name}")
        if name in _HOMES:
            value = getattr(importlib.import_module(f"manip3d.{_HOMES[name]}"), name)
            globals()[name] = value
            return value
        raise AttributeError(f"module 'manip3d' has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
