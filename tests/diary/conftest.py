"""Fixtures of the diary's tests."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(params=["plain", "encrypted"])
def key(request: pytest.FixtureRequest, tmp_path: Path) -> Path | None:
    """The key file of a diary; None: the diary is not encrypted."""
    from manip3d.diary import make_key  # needs the extra 'diary'

    if request.param == "plain":
        return None
    make_key(tmp_path / "study.key")
    return tmp_path / "study.key"
