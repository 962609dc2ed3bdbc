"""Elements of a sequence that is computed or read when it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

_Element = TypeVar("_Element")


def indexed(
    index: int | slice, length: int, element: Callable[[int], _Element], noun: str
) -> _Element | list[_Element]:
    """Return the element at an index, or a list of those of a slice, as a list does.

    Parameters
    ----------
    index : int or slice
        A negative index counts from the end.
    length : int
        Number of elements.
    element : callable(i) -> element
        Returns the element at i, 0 <= i < ``length``.
    noun : str
        Word for an element in the message.

    Raises
    ------
    IndexError
        There is no such element.
    """
    if isinstance(index, slice):
        return [element(i) for i in range(*index.indices(length))]
    if not -length <= index < length:
        raise IndexError(f"{noun} {index} of {length}")
    return element(index % length)
