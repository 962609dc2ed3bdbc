"""Fingerprint of the code that computes results, so that stale results are not reused."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

from manip3d import __version__, _core

# Modules that show results but do not compute them; after a change there, stored results are valid.
_PRESENTATION = {"cli", "report", "viewer", "_environment.py"}
# Programs, tables, templates and bundles: what the package reads of itself.
_SUFFIXES = (".py", ".csv", ".json", ".toml", ".html", ".css", ".js")
_NOT_READ = {"node_modules", "src", "__pycache__"}
"""Folders that are only there for developers of the viewer, or that Python makes itself."""


@cache
def code_fingerprint() -> str:
    """Return the version, and a hash of the binaries, sources and tables that compute results."""
    binaries = sorted(Path(_core.__file__).parent.glob("*.so"))
    core = b"".join(path.read_bytes() for path in binaries)
    return f"{__version__}+{_fingerprint(core, lambda parts: not _PRESENTATION & parts)}"


@cache
def presentation_fingerprint() -> str:
    """Return a hash of the command line, reports and viewer, which `code_fingerprint` omits."""
    return _fingerprint(b"", lambda parts: bool({"cli", "report", "viewer"} & parts))


def _fingerprint(start: bytes, wanted: Callable[[set[str]], bool]) -> str:
    package = Path(__file__).parents[1]
    digest = hashlib.sha256(start)
    for path in sorted(_files_of(package)):
        relative = path.relative_to(package)
        if wanted(set(relative.parts)):
            digest.update(relative.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def _files_of(package: Path) -> Iterator[Path]:
    for top, folders, names in os.walk(package):
        folders[:] = [name for name in folders if name not in _NOT_READ]
        yield from (Path(top, name) for name in names if name.endswith(_SUFFIXES))
