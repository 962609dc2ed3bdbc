"""The package as a whole: versions agree, names are documented, importing it is light."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import manip3d

ROOT = Path(__file__).parents[1]

HEAVY = {
    "IPython",
    "jinja2",
    "matplotlib",
    "open3d",
    "pandas",
    "pooch",
    "pyvista",
    "rich",
    "scipy",
    "trimesh",
    "typer",
    "vtkmodules",
}


def test_versions_agree() -> None:
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    cmake = re.search(r"project\(manip3d VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())
    assert cmake is not None
    assert manip3d.__version__ == cmake[1] == pyproject


def test_importing_loads_no_heavy_package() -> None:
    code = "import json, sys, manip3d; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in json.loads(done.stdout)}
    assert not loaded & HEAVY


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        manip3d.nonsense  # noqa: B018
