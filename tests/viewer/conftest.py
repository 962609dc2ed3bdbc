"""What can be drawn and shown on this machine."""

from __future__ import annotations

import pytest
from square import square

from manip3d import Mesh, RenderError
from manip3d.viewer import _chromium
from manip3d.viewer.page import BUNDLE


@pytest.fixture
def bundle() -> None:
    if not BUNDLE.exists():
        pytest.skip("the viewer is not built: make setup")


@pytest.fixture
def chromium(bundle: None) -> None:
    pytest.importorskip("PIL.Image")
    try:
        _chromium.program()
    except RenderError as error:
        pytest.skip(str(error))


@pytest.fixture
def quad() -> Mesh:
    return square()
