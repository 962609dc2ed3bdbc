"""The package as a whole: versions agree, names are documented, importing it is light."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import pickle
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from enum import Enum
from pathlib import Path

import pytest

import manip3d
from manip3d import _core

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
    "yaml",
}


def test_versions_agree() -> None:
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    cmake = re.search(r"project\(manip3d VERSION (\S+)", (ROOT / "CMakeLists.txt").read_text())
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cmake is not None
    assert cited is not None
    assert manip3d.__version__ == cmake[1] == pyproject == cited[1]


def public_names() -> Iterator[tuple[str, str, object]]:
    """Yield module, name and object of everything in the ``__all__`` of the modules."""
    for info in pkgutil.iter_modules(manip3d.__path__, "manip3d."):
        if not info.name.startswith("manip3d._"):
            module = importlib.import_module(info.name)
            for name in getattr(module, "__all__", ()):
                yield info.name, name, getattr(module, name)


def test_type_checkers_know_the_public_names_and_no_others() -> None:
    """``if TYPE_CHECKING`` imports all public names; a ``__getattr__`` would accept any name."""
    tree = ast.parse(Path(manip3d.__file__).read_text())
    for_checkers = next(node for node in tree.body if isinstance(node, ast.If))
    imported = {name.name for line in for_checkers.body if isinstance(line, ast.ImportFrom)
                for name in line.names}  # fmt: skip
    assert imported >= set(manip3d.__all__)
    defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert defined == {"__dir__"}


def test_enumerations_of_the_core_are_those_of_python() -> None:
    """Enumerations are Python's; pybind11's ``py::enum_`` takes a second each to compile."""
    found = [item for item in vars(_core).values() if hasattr(item, "__members__")]
    assert len(found) > 20
    for enumeration in found:
        assert issubclass(enumeration, Enum), enumeration
        assert list(pickle.loads(pickle.dumps(list(enumeration)))) == list(enumeration)


def test_test_files_have_names_of_their_own() -> None:
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))  # else pytest collects only one of two


def test_every_name_of_the_package_is_there() -> None:
    for name in manip3d.__all__:
        assert getattr(manip3d, name) is not None


def test_every_public_name_is_documented() -> None:
    def undocumented(value: object) -> bool:
        return (inspect.isroutine(value) or inspect.isclass(value)) and not value.__doc__

    names = list(public_names())
    assert ("manip3d.io", "read_mesh", manip3d.read_mesh) in names
    assert [f"{module}.{name}" for module, name, value in names if undocumented(value)] == []


def test_every_public_method_and_property_is_documented() -> None:
    missing = [
        f"{module}.{cls.__name__}.{name}"
        for module, _, cls in public_names()
        if inspect.isclass(cls)
        for name, value in vars(cls).items()
        if not name.startswith("_")
        and (inspect.isroutine(value) or isinstance(value, property))
        and not inspect.getdoc(value)
    ]
    assert missing == []


def test_tracked_files_name_no_path_of_somebodys_machine() -> None:
    command = [
        "git",
        "grep",
        "-nIE",
        r"(^|[^A-Za-z0-9_.$}<])/(home|root|Users|work|mnt)/",
        "--",
        ".",
    ]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if found.returncode not in (0, 1):
        pytest.skip("not a git checkout")
    lines = [line for line in found.stdout.splitlines() if "package-lock.json" not in line]
    assert [line for line in lines if not line.startswith("tests/test_package.py")] == []


def test_importing_loads_no_heavy_package() -> None:
    code = "import json, sys, manip3d; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in json.loads(done.stdout)}
    assert not loaded & HEAVY


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        manip3d.nonsense  # noqa: B018
