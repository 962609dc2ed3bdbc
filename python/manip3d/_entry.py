"""Entry of the command ``manip3d``: imports the rest where Ctrl-C ends it without a traceback."""

import sys
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line; ends the process with its exit code."""
    try:
        from manip3d import cli

        cli.main()
    except KeyboardInterrupt:  # during the imports, which take about 0.1 s
        sys.exit(130)
