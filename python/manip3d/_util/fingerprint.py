"""Fingerprint of the code that computes results, so that stale results are not reused."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

from manip3d import __version__, _core

# Modules that show results but do not compute them; after a change there, stored results are valid.
_PRESENTATION = {"cli", "report", "viewer", "_environment.py"}


@cache
def code_fingerprint() -> str:
    """Return the version, and a hash of the binary and the sources that compute results."""
    core = Path(_core.__file__).read_bytes()
    return f"{__version__}+{_fingerprint(core, lambda parts: not _PRESENTATION & parts)}"


@cache
def presentation_fingerprint() -> str:
    """Return a hash of the command line, reports and viewer, which `code_fingerprint` omits."""
    return _fingerprint(b"", lambda parts: bool({"cli", "report", "viewer"} & parts))


def _fingerprint(start: bytes, wanted: Callable[[set[str]], bool]) -> str:
    package = Path(__file__).parents[1]
    digest = hashlib.sha256(start)
    for path in sorted(package.rglob("*.py")):
        relative = path.relative_to(package)
        if wanted(set(relative.parts)):
            digest.update(relative.as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]
