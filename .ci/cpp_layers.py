"""Check that the rooms of the C++ core include downwards only.

Usage: ``python .ci/cpp_layers.py``. It prints each include that is not allowed, and exits with 1 if
there is one.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

CPP = Path(__file__).parents[1] / "cpp"
KERNELS = ("metrics", "simplify", "modify", "forge")
ROOMS: dict[str, tuple[str, ...]] = {
    "geometry": (),
    "files": (),
    "parse": ("files",),
    "io": ("geometry", "parse", "files"),
    **dict.fromkeys(KERNELS, ("geometry",)),
    # The file of a watermark's key is made with a temporary name that nobody else can read.
    "authenticate": ("geometry", "files"),
    "capture": ("geometry", "parse", "files"),
    # A frame that is sent to a page has its colours compressed as a recording has.
    "serve": ("geometry", "capture"),
}
"""Rooms that the files of each room may include, besides their own room."""

_INCLUDE = re.compile(r'^\s*#\s*include\s*"(?:manip3d/)?(?!manip3d/)(\w+)/[\w/.]+"', re.MULTILINE)


def upward_includes(cpp: Path) -> Iterator[str]:
    """Yield the includes that the rooms do not allow, and the folders that are no room."""
    for folder in sorted(each for top in _tops(cpp) for each in top.iterdir() if each.is_dir()):
        if folder.name not in ROOMS:
            yield f"{folder.relative_to(cpp)}: expected one of the rooms {', '.join(ROOMS)}"
            continue
        allowed = {folder.name, *ROOMS[folder.name]}
        for file in sorted(folder.rglob("*.?pp")):
            text = file.read_text()
            for found in _INCLUDE.finditer(text):
                if found[1] not in allowed:
                    line = text.count("\n", 0, found.start(1)) + 1
                    yield f"{file.relative_to(cpp)}:{line}: {folder.name} includes {found[1]}"


def _tops(cpp: Path) -> tuple[Path, Path]:
    return cpp / "include" / "manip3d", cpp / "src"


def main() -> int:
    """Print the includes that are not allowed; return the exit code."""
    found = list(upward_includes(CPP))
    for each in found:
        print(each)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
