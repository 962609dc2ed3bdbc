"""Waiting for what other threads and processes do."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any


def wait_for(condition: Callable[[], Any], what: str = "", *, seconds: float = 60.0) -> Any:
    """Wait until a condition holds; return its value.

    The limit is long, because a busy machine is slow; ``what`` says what did not come in time.
    """
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, what
        time.sleep(0.005)
    return found
