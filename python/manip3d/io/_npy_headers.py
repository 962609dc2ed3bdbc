"""Reader of the headers of untrusted .npy files."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from manip3d.errors import FormatError

MAX_HEADER = 1 << 16
"""Largest size of a header, in bytes."""


def read_npy_header(data: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return the shape, whether the order is Fortran's, the dtype, and the offset of the data.

    Raises
    ------
    FormatError
        The header is missing or damaged, or describes Python objects.
    """
    stream = io.BytesIO(data[:MAX_HEADER])
    try:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, is_fortran, dtype = read_header(stream, max_header_size=MAX_HEADER)
    except Exception as error:  # the header is a Python literal, so errors have various types
        raise FormatError("expected a header of a .npy file", byte_offset=0) from error
    if any(type(side) is not int for side in shape) or dtype.hasobject:
        raise FormatError(f"expected an array of numbers, got {dtype} {shape}", byte_offset=0)
    return shape, is_fortran, dtype, stream.tell()
