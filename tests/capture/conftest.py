"""Fixtures of recordings."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace

import pytest

from bag_readers import ForkedReader
from manip3d.capture import _bag


@pytest.fixture
def forked_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start no Python for each reading of a bag; ``test_capture_bag.py`` does."""
    start = SimpleNamespace(Popen=ForkedReader, PIPE=subprocess.PIPE, DEVNULL=subprocess.DEVNULL)
    monkeypatch.setattr(_bag, "subprocess", start)
