"""Fixtures of the viewer's tests."""

from __future__ import annotations

import pytest
from square import square

from manip3d import Mesh, RenderError
from manip3d.viewer import renderer


@pytest.fixture(scope="session")
def needs_renderer() -> None:
    """Skip where nothing can be drawn; to find that out takes seconds."""
    try:
        renderer()
    except RenderError as error:
        pytest.skip(str(error))


@pytest.fixture
def quad() -> Mesh:
    return square()
