"""Failures of the browser that draws pictures are errors of rendering, and leave nothing open."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from manip3d import RenderError
from manip3d.viewer import _chromium


@pytest.fixture
def tab() -> Iterator[_chromium.Tab]:
    """A tab of a browser that answers nothing; ``_theirs`` is where it reads its commands."""
    theirs_in, ours_out = os.pipe()
    ours_in, theirs_out = os.pipe()
    tab = _chromium.Tab.__new__(_chromium.Tab)
    tab._commands, tab._answers, tab._buffer = ours_out, ours_in, b""
    tab._numbers, tab._session, tab.patience = itertools.count(1), None, 1.0
    tab._theirs = theirs_in  # type: ignore[attr-defined]
    yield tab
    for end in {ours_out, ours_in, theirs_out, tab._theirs} - {-1}:  # type: ignore[attr-defined]
        os.close(end)


def test_an_answer_that_is_late_is_an_error_of_rendering(tab: _chromium.Tab) -> None:
    """The time may be up when another message has just been read."""
    tab.patience = -1.0
    with pytest.raises(RenderError, match="no answer within"):
        tab.send("Page.enable")


def test_a_browser_that_ended_is_an_error_of_rendering(tab: _chromium.Tab) -> None:
    os.close(tab._theirs)  # type: ignore[attr-defined]
    tab._theirs = -1  # type: ignore[attr-defined]
    with pytest.raises(RenderError, match="ended before it answered"):
        tab.send("Page.enable")


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="descriptors are listed in /proc")
def test_without_a_browser_no_pipe_stays_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(RenderError, match="is installed"), _chromium._browser(tmp_path, (10, 10)):
        pass
    assert len(os.listdir("/proc/self/fd")) == before
