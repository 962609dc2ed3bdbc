"""Packages that import their modules with the first use: what they say they have, they have."""

from __future__ import annotations

import ast
import importlib
import json
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import manip3d
from manip3d._util.lazy import lazily

LAZY = ("authenticate", "batch", "capture", "forge", "io", "modify", "viewer")
ROOT = Path(manip3d.__file__).parent


def stub_of(package: str) -> ast.Module:
    return ast.parse((ROOT / package / "__init__.pyi").read_text(encoding="utf-8"))


@pytest.mark.parametrize("package", LAZY)
def test_type_checkers_see_the_names_that_are_there(package: str) -> None:
    module = importlib.import_module(f"manip3d.{package}")
    homes = {
        alias.name: node.module
        for node in stub_of(package).body
        if isinstance(node, ast.ImportFrom) and node.module != "__future__"
        for alias in node.names
    }
    stated = next(n.value for n in stub_of(package).body if isinstance(n, ast.Assign))
    assert sorted(ast.literal_eval(stated)) == module.__all__ == sorted(homes) == dir(module)
    for name, home in homes.items():
        assert getattr(module, name) is getattr(importlib.import_module(str(home)), name)


@pytest.mark.parametrize("package", LAZY)
def test_no_module_hides_what_its_package_exports(package: str) -> None:
    module = importlib.import_module(f"manip3d.{package}")
    inside = {info.name for info in pkgutil.iter_modules(module.__path__)}
    assert not inside & set(module.__all__)


def test_every_package_with_a_stub_is_looked_at() -> None:
    stubs = {path.parent.name for path in ROOT.glob("*/__init__.pyi")}
    assert stubs == set(LAZY)


def test_a_name_that_nobody_defines_is_refused_as_by_other_packages() -> None:
    get, names, exported = lazily("manip3d.io", {"_limits": "ReadLimits", "_remote": "is_url"})
    assert names() == exported == ["ReadLimits", "is_url"]
    assert get("is_url")("s3://bucket/scan.bin")
    with pytest.raises(AttributeError, match=r"module 'manip3d\.io' has no attribute 'nothing'"):
        get("nothing")


def test_what_dir_gives_may_be_changed_by_its_caller() -> None:
    _, names, exported = lazily("manip3d.io", {"_limits": "ReadLimits"})
    names().clear()
    assert names() == exported == ["ReadLimits"]


@pytest.mark.parametrize(
    ("uses", "spared"),
    [
        ("from manip3d.authenticate import inspect", ("authenticate._alert", "forge", "capture")),
        ("from manip3d.viewer import kind_of", ("viewer.pictures", "authenticate", "forge")),
        ("from manip3d.capture import open_lidar", ("capture._rgbd", "forge", "modify")),
        ("from manip3d.io import read_scan", ("io._bvh", "io._scenes", "batch")),
    ],
)
def test_what_is_not_used_is_not_imported(uses: str, spared: tuple[str, ...]) -> None:
    code = f"import json, sys; {uses}; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not {f"manip3d.{name}" for name in spared} & set(json.loads(done.stdout))
