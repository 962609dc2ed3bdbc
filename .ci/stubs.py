"""Write python/manip3d/_core.pyi from the compiled module, or check that it is up to date.

Usage: ``python .ci/stubs.py [--check]``, in an environment where ``import manip3d`` works.
"""

from __future__ import annotations

import difflib
import importlib
import re
import subprocess
import sys
import tempfile
from pathlib import Path

STUB = Path(__file__).parents[1] / "python" / "manip3d" / "_core.pyi"
MODULE = "manip3d._core"


def enumeration(stub: re.Match[str]) -> str:
    """Members with values: mypy takes none of the annotated names that pybind11-stubgen writes."""
    members = getattr(importlib.import_module(MODULE), stub[1])
    values = "".join(f"    {member.name} = {member.value!r}\n" for member in members)
    return f"class {stub[1]}(enum.Enum):\n{values}"


def generate() -> str:
    """The stub of the module as it is now, formatted."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pybind11_stubgen", MODULE, "-o", folder]
        subprocess.run([*command, "--exit-code"], check=True)
        text = (Path(folder) / "manip3d" / "_core.pyi").read_text()
    # py::tuple and the like come without their type arguments, which mypy --strict wants.
    for bare, full in (("tuple", "tuple[typing.Any, ...]"), ("list", "list[typing.Any]")):
        text = re.sub(rf"(?<=[\[ ]){bare}(?=[],:)])", full, text)
    text = re.sub(
        r"^class (\w+)\(enum\.Enum\):\n(?:    .*\n|\n(?=    ))+", enumeration, text, flags=re.M
    )
    # A pickled state is checked when it is read. Nothing looks at the result of a callback.
    text = text.replace("Callable[[float], typing.Any]", "Callable[[float], object]")
    text = text.replace(
        "__setstate__(self, arg0: tuple[typing.Any", "__setstate__(self, arg0: tuple[object"
    )
    for action in (["check", "--quiet", "--fix-only"], ["format", "--quiet"]):
        command = [sys.executable, "-m", "ruff", *action, "--stdin-filename", str(STUB), "-"]
        text = subprocess.run(
            command, input=text, text=True, check=True, stdout=subprocess.PIPE
        ).stdout
    return text


def main() -> int:
    new = generate()
    if "--check" not in sys.argv[1:]:
        STUB.write_text(new)
        return 0
    old = STUB.read_text() if STUB.exists() else ""
    sys.stdout.writelines(
        difflib.unified_diff(
            old.splitlines(keepends=True), new.splitlines(keepends=True), STUB.name, MODULE
        )
    )
    if old != new:
        print(f"{STUB.name} is out of date: run 'make stubs'", file=sys.stderr)
    return int(old != new)


if __name__ == "__main__":
    sys.exit(main())
