"""Headers of .npy files, read without trust."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from manip3d.errors import FormatError

MOST_HEADER = 1 << 16
"""Bytes in which a header must end."""


def read_npy_header(data: bytes) -> tuple[tuple[int, ...], bool, np.dtype[Any], int]:
    """Return the shape, whether the order is Fortran's, the type, and where the numbers begin.

    Raises
    ------
    FormatError
        There is no header, or one of no numbers.
    """
    stream = io.BytesIO(data[:MOST_HEADER])
    try:
        version = np.lib.format.read_magic(stream)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, is_fortran, dtype = read_header(stream, max_header_size=MOST_HEADER)
    except Exception as error:  # the header is a Python literal: it fails in many ways
        raise FormatError("expected a header of a .npy file", byte_offset=0) from error
    if any(type(side) is not int for side in shape) or dtype.hasobject:
        raise FormatError(f"expected an array of numbers, got {dtype} {shape}", byte_offset=0)
    return shape, is_fortran, dtype, stream.tell()
