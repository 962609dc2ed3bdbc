"""Fixtures of the commands' tests."""

from __future__ import annotations

from pathlib import Path

import pytest

import rgbd_frames
from manip3d import capture


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A recording of nine frames."""
    folder = tmp_path / "walk"
    capture.record(rgbd_frames.frames(9), folder, lossless_color=True)
    return folder
