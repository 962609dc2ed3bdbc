"""Entry point of the command ``manip3d``; it handles Ctrl-C during the imports, too."""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn


def main() -> NoReturn:
    """Run the command line, and end the process with its exit code."""
    try:
        from manip3d import cli

        cli.main()
    except KeyboardInterrupt:  # during the imports, which take about 0.1 s
        print("manip3d: interrupted", file=sys.stderr)
        sys.exit(130)
