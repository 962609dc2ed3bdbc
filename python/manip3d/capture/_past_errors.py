"""Iteration that continues after items that cannot be read."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from itertools import count
from typing import TypeVar

_Item = TypeVar("_Item")


def _told(error: Exception) -> str:
    """Return an error's message, without the error number of the operating system."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        return f"{os.fsdecode(error.filename)}: {error.strerror}"
    return str(error)


def past_errors(
    items: Iterator[_Item],
    errors: dict[int, str],
    reasons: tuple[type[Exception], ...],
    *,
    most: int | None = None,
    needs_one: bool = True,
    goes_on: Callable[[], bool] = lambda: True,
) -> Iterator[_Item | None]:
    """Yield the items, and None for each one that cannot be read.

    Parameters
    ----------
    items : iterator
        The items. After an error it may continue, or end.
    errors : dict of int to str
        Receives the index of each None, with the reason.
    reasons : tuple of exception types
        Exceptions that yield None; others are raised.
    most : int, optional
        Largest number of errors. A further error is raised, because the iterator would repeat it
        for ever.
    needs_one : bool
        Raise the first error at the end if no item could be read.
    goes_on : callable
        Called after each error, which is raised if it returns False.

    Yields
    ------
    item or None
        None if the item cannot be read.
    """
    first: Exception | None = None
    for number in count():
        try:
            item = next(items)
        except StopIteration:
            if needs_one and first is not None and len(errors) == number:
                raise first from None
            return
        except reasons as error:
            if not goes_on():
                raise
            first = first or error
            errors[number] = _told(error)
            if most is not None and len(errors) > most:
                raise
            yield None
        else:
            yield item
