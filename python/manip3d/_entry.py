"""Entry of the command ``manip3d``: imports the rest where Ctrl-C ends it without a traceback."""

import sys
from typing import NoReturn


def main() -> NoReturn:
    """Run the command line; ends the process with its exit code."""
    try:
        from manip3d import cli
    except KeyboardInterrupt:  # the imports take about 0.1 s
        sys.exit(130)
    cli.main()
