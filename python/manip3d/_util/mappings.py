"""Read-only mappings for results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypeVar

_Value = TypeVar("_Value")


class ReadOnlyMapping(Mapping[str, _Value]):
    """A read-only mapping; unlike ``MappingProxyType`` it can be pickled.

    Parameters
    ----------
    items : mapping
        Keys and values, which are copied.
    """

    __slots__ = ("_items",)

    def __init__(self, items: Mapping[str, _Value]) -> None:
        self._items = dict(items)

    def __getitem__(self, key: str) -> _Value:
        return self._items[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __repr__(self) -> str:
        return repr(self._items)
