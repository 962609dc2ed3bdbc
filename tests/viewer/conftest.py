"""Fixtures of the viewer's tests, which are skipped if the viewer is not built."""

from __future__ import annotations

import pytest
from square import square

from manip3d import Mesh
from manip3d.viewer.page import BUNDLE


@pytest.fixture
def bundle() -> None:
    if not BUNDLE.exists():
        pytest.skip("the viewer is not built: make setup")


@pytest.fixture
def quad() -> Mesh:
    return square()
