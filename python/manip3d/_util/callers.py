"""Level of the caller whose line a warning names."""

from __future__ import annotations

import sys

_PACKAGE = __name__.partition(".")[0]


def caller_level() -> int:
    """Return the ``stacklevel`` with which a warning names the line that called this package.

    It skips all functions of the package on the stack, since these call each other
    (`manip3d.capture.open` calls `open_rgbd`).
    """
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None:
        if frame.f_globals.get("__name__", "").partition(".")[0] != _PACKAGE:
            return level
        level, frame = level + 1, frame.f_back
    return level
