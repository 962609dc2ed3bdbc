from __future__ import annotations

import pytest

from manip3d import RenderError
from manip3d.viewer import _chromium
from manip3d.viewer.page import BUNDLE


@pytest.fixture
def chromium() -> None:
    pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")
    pytest.importorskip("PIL.Image")
    if not (BUNDLE.parent / "live.js").exists():
        pytest.skip("the page is not built: make setup")
    try:
        _chromium.program()
    except RenderError as error:
        pytest.skip(str(error))
