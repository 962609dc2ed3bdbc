"""``repr`` of results that hold arrays and other results: one short line."""

from __future__ import annotations

import dataclasses
import reprlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

_FEW = 16
"""Arrays of more numbers are told by their shapes; a pose, which is 4 x 4, is shown."""


class _Short(reprlib.Repr):
    """`reprlib`, which leaves out what is long, with NumPy's arrays."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel = 2
        self.maxtuple = self.maxlist = self.maxdict = 2
        self.maxstring = 80
        self.maxother = 60

    def repr1(self, value: Any, level: int) -> str:
        # NumPy's scalars would show their types: np.float64(0.5).
        number = value.item() if isinstance(value, np.number | np.bool_) else value
        return super().repr1(number, level)

    def repr_float(self, value: float, level: int) -> str:
        return f"{value:.6g}"

    def repr_ndarray(self, array: NDArray[Any], level: int) -> str:
        if array.size > _FEW:
            return f"<{array.shape} {array.dtype}>"
        return " ".join(np.array2string(array, precision=4, separator=", ").split())

    def repr_instance(self, value: Any, level: int) -> str:
        # Tensors of other libraries have several lines.
        return " ".join(super().repr_instance(value, level).split())


_SHORT = _Short()


def short_repr(self: Any) -> str:
    """Return the ``repr`` of a dataclass in one line, however much its fields hold."""
    values = (
        f"{field.name}={_SHORT.repr(getattr(self, field.name))}"
        for field in dataclasses.fields(self)
        if field.repr
    )
    return f"{type(self).__qualname__}({', '.join(values)})"
