"""Importing this module raises ImportError in subinterpreters, where ``_core`` would deadlock."""

from __future__ import annotations

import importlib


def _is_main() -> bool:
    for name in ("_interpreters", "_xxsubinterpreters"):  # Python 3.13 and later; earlier versions
        try:
            interpreters = importlib.import_module(name)
        except ImportError:
            continue
        return bool(interpreters.get_current() == interpreters.get_main())
    return True


if not _is_main():
    raise ImportError(
        "manip3d cannot be imported in a subinterpreter: NumPy and its own core need the main one. "
        "For mod_wsgi, set WSGIApplicationGroup to %{GLOBAL}."
    )
