"""Files that a process holds open."""

from __future__ import annotations

import os


def descriptors() -> int:
    """Return the number of files, sockets and pipes that this process has open."""
    return len(os.listdir("/proc/self/fd"))
