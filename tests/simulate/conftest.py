"""One street for all tests that need one: it takes a second to build."""

from __future__ import annotations

import pytest

from manip3d.simulate import Street, street


@pytest.fixture(scope="session")
def busy_street() -> Street:
    pytest.importorskip("open3d")
    return street(3)
