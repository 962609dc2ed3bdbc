"""Fixtures of the detectors' and watermark's tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from manip3d.authenticate import KeyFile
from watermark_scans import key_file


@pytest.fixture
def key(tmp_path: Path) -> Iterator[KeyFile]:
    """The key of a sensor, in the file ``sensor.key``."""
    with KeyFile(key_file(tmp_path / "sensor.key")) as opened:
        yield opened
