"""A short run of hostile_files.py: each reader on damaged files, in a process with limits."""

from __future__ import annotations

import hostile_files
import pytest

CASES = 400
"""For each kind: 8 400 in all; the long run is for the night."""


@pytest.mark.parametrize("kind", hostile_files.KINDS)
def test_damaged_files_end_in_errors_of_ours(kind: str) -> None:
    for module in hostile_files.NEEDS.get(kind, ()):
        pytest.importorskip(module)
    assert list(hostile_files.run(kind, 0, CASES)) == []
