"""Plugin of pytest: the tests see one file of the package with one expression changed.

``MANIP3D_MUTANT`` is JSON of ``module``, ``path``, ``old`` and ``new`` for Python, or of
``module`` and ``library`` for the C++ core, which was built with the change. It is loaded by
``-p mutating``, before anything imports the package.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ExtensionFileLoader, ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType


class _Changed(SourceFileLoader):
    """Compiles the source with the change, past the cache of compiled files."""

    def __init__(self, name: str, path: str, old: str, new: str) -> None:
        super().__init__(name, path)
        self._old, self._new = old, new

    def get_code(self, fullname: str) -> CodeType:
        source = Path(self.path).read_text()
        assert source.count(self._old) == 1, f"{self.path}: expected once: {self._old}"
        code = compile(source.replace(self._old, self._new), self.path, "exec", dont_inherit=True)
        assert isinstance(code, CodeType)
        return code


class Finder(MetaPathFinder):
    """Finds the one module that is changed."""

    def __init__(self, mutant: dict[str, str]) -> None:
        self._mutant = mutant

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of the changed module, else None."""
        if fullname != self._mutant["module"]:
            return None
        if "library" in self._mutant:
            library = self._mutant["library"]
            return spec_from_file_location(
                fullname, library, loader=ExtensionFileLoader(fullname, library)
            )
        file = self._mutant["path"]
        loader = _Changed(fullname, file, self._mutant["old"], self._mutant["new"])
        places = [str(Path(file).parent)] if file.endswith("__init__.py") else None
        return spec_from_file_location(
            fullname, file, loader=loader, submodule_search_locations=places
        )


if "MANIP3D_MUTANT" in os.environ:
    sys.meta_path.insert(0, Finder(json.loads(os.environ["MANIP3D_MUTANT"])))
