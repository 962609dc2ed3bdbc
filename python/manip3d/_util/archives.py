"""Errors by which NumPy tells that an archive of arrays (``.npz``) is damaged."""

from __future__ import annotations

import zlib
from zipfile import BadZipFile

NPZ_ERRORS = (
    ValueError,
    KeyError,
    EOFError,
    TypeError,
    OverflowError,
    MemoryError,
    OSError,
    NotImplementedError,  # unknown version or compression of zip
    RuntimeError,  # encrypted archive
    BadZipFile,
    zlib.error,
)
"""Raised while an archive is opened or its arrays are read from bytes in memory."""
