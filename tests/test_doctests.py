"""The examples in the docstrings of the public functions are true."""

from __future__ import annotations

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import manip3d

MODULES = sorted(
    info.name
    for info in pkgutil.walk_packages(manip3d.__path__, "manip3d.")
    if info.name not in ("manip3d._core", "manip3d.__main__")
)


@pytest.mark.parametrize("name", MODULES)
def test_examples(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    assert doctest.testmod(importlib.import_module(name), optionflags=flags).failed == 0
