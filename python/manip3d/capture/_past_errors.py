"""Reading on past what cannot be read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import count
from typing import TypeVar

_Item = TypeVar("_Item")


def _told(error: Exception) -> str:
    """An error in words, without the number that an operating system gives it."""
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
) -> Iterator[_Item | None]:
    """Pass items on, with None for each one that cannot be read.

    Parameters
    ----------
    items : iterator
        It goes on after an error, or ends there.
    errors : dict of int to str
        Gets the reason of each None, by its place.
    reasons : tuple of exception types
        They are reasons for a None; others are raised.
    most : int, optional
        An error beyond so many is raised, as the iterator does not get on.
    needs_one : bool
        Raise the first reason at the end, if no item could be read.

    Yields
    ------
    item or None
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
            first = first or error
            errors[number] = _told(error)
            if most is not None and len(errors) > most:
                raise
            yield None
        else:
            yield item
