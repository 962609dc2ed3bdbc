"""Names with a leading underscore stay in their module; a private module shares names without."""

from __future__ import annotations

import ast
from pathlib import Path

import manip3d

PACKAGE = Path(manip3d.__file__).parent
MODULES = frozenset(path.stem for path in PACKAGE.rglob("_*.py")) | {"_core", "_mkv"}


def test_no_module_imports_a_private_name() -> None:
    taken = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}: {alias.name}"
        for path in PACKAGE.rglob("*.py")
        if "node_modules" not in path.parts
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("manip3d")
        for alias in node.names
        if alias.name.startswith("_")
        and not alias.name.startswith("__")
        and alias.name not in MODULES
    ]
    assert taken == []
