"""The examples in the docstrings are true, also where a reader copies one into a new notebook."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import manip3d

MODULES = sorted(
    info.name
    for info in pkgutil.walk_packages(manip3d.__path__, "manip3d.")
    if info.name not in ("manip3d._core", "manip3d.__main__")
)


def is_long(value: object) -> bool:
    """Whether a result, which a notebook shows by its ``repr``, fills the screen or is an array."""
    is_ours = type(value).__module__.startswith("manip3d.")
    return is_ours and (len(repr(value)) > 500 or "array(" in repr(value))


def shows_types(value: object) -> bool:
    """Whether the ``repr`` of a result has types of NumPy's scalars: ``np.float64(0.5)``."""
    is_ours = type(value).__module__.startswith("manip3d.")
    return is_ours and re.search(r"\bnp\.\w+", repr(value)) is not None


@pytest.mark.parametrize("name", MODULES)
def test_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    # No names: an example imports what it uses.
    examples = doctest.DocTestFinder().find(importlib.import_module(name), globs={})
    for number, example in enumerate(examples):
        folder = tmp_path / str(number)  # each example makes the files that it reads
        folder.mkdir()
        monkeypatch.chdir(folder)
        runner.run(example, clear_globs=False)
        assert [value for value in example.globs.values() if is_long(value)] == []
        assert [value for value in example.globs.values() if shows_types(value)] == []
    assert runner.summarize().failed == 0
