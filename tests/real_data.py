"""Access to the real data under ``MANIP3D_DATA`` for tests that are marked ``realdata``."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from manip3d import datasets

ROOT = Path(os.environ["MANIP3D_DATA"]) if os.environ.get("MANIP3D_DATA") else None


class RealData:
    """Value of the fixture ``realdata``: gives existing paths, or skips the test."""

    def __call__(self, relative: str = "") -> Path:
        """Return the file or folder ``relative`` to ``MANIP3D_DATA``."""
        if ROOT is None:
            pytest.skip("MANIP3D_DATA is not set")
        path = ROOT / relative
        if not path.exists():
            pytest.skip(f"MANIP3D_DATA has no {relative}")
        return path

    def needs(self, *names: str) -> None:
        """Require data sets or range scans by their names in the registry."""
        self()
        for name in names:
            is_scan = name in datasets.scan_names()
            here = datasets.scan_is_here(name) if is_scan else datasets.is_here(datasets.get(name))
            if not here:
                pytest.skip(f"MANIP3D_DATA has no {name}")
