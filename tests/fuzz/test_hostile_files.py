"""A short run of hostile_files.py: each reader on damaged files, in a process with limits."""

from __future__ import annotations

import contextlib
import importlib.util
import subprocess
import sys
from pathlib import Path

import hostile_files
import pytest

from manip3d import FormatError, InputError

CASES = 250
"""For each kind, more than 10 000 in all; a million are for the night."""
GROUPS = 4


assert CASES * len(hostile_files.KINDS) > 10_000


@pytest.mark.parametrize("kind", hostile_files.KINDS)
def test_undamaged_examples_are_read(kind: str, tmp_path: Path) -> None:
    """Damage to what is refused anyway would prove nothing."""
    for module in hostile_files.NEEDS.get(kind, ()):
        pytest.importorskip(module)
    num_read = 0
    for number, example in enumerate(hostile_files.examples_of(kind)):
        folder = tmp_path / str(number)
        hostile_files.lay_out(example, folder)
        name = max(example)  # of a.bin and a.gltf the latter
        # A corpus has damaged files too, and some of which a part has to be chosen.
        with contextlib.suppress(FormatError, InputError, OSError):
            hostile_files.KINDS[kind].read(folder, name)
            num_read += 1
    assert num_read >= 1


@pytest.mark.parametrize("first", range(GROUPS))
def test_damaged_files_end_in_errors_of_ours(first: int) -> None:
    """Several kinds in one interpreter, whose start takes longer than all cases of a kind."""
    kinds = [kind for kind in list(hostile_files.KINDS)[first::GROUPS] if can_be_read(kind)]
    # In an interpreter of its own: it forks, which a process with other threads must not.
    command = [sys.executable, hostile_files.__file__, "--cases", str(CASES * len(kinds))]
    for kind in kinds:
        command += ["--kind", kind]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    for kind in kinds:
        assert f"{kind}: {CASES} cases" in done.stdout


def can_be_read(kind: str) -> bool:
    """Whether the packages of a kind are installed; if not, the first test fails in CI."""
    return all(importlib.util.find_spec(module) for module in hostile_files.NEEDS.get(kind, ()))
