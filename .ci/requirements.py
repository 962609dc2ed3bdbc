"""Print what pyproject.toml wants for building the package and for some of its extras.

Usage: ``python .ci/requirements.py EXTRA...``; pip reads the output (``-r /dev/stdin``).
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

TABLE = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())


def of_extra(name: str) -> Iterator[str]:
    """Requirements of an extra, and of the package's own extras that it names."""
    for requirement in TABLE["project"]["optional-dependencies"][name]:
        own = re.fullmatch(r"manip3d\[(.+)\]", requirement)
        if own:
            for other in own[1].split(","):
                yield from of_extra(other.strip())
        else:
            yield requirement


if __name__ == "__main__":
    wanted = [*TABLE["build-system"]["requires"], *TABLE["project"]["dependencies"]]
    for extra in sys.argv[1:]:
        wanted += of_extra(extra)
    print(*dict.fromkeys(wanted), sep="\n")
