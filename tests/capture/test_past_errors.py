"""Reading on past what cannot be read: of cameras and of drives."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from manip3d.capture._past_errors import past_errors
from manip3d.errors import DeviceError, FormatError

DAMAGED = FormatError("damaged", file="a.bin")


def items(*what: int | Exception) -> Iterator[int]:
    """An iterator that goes on after an error."""

    def read(item: int | Exception) -> int:
        if isinstance(item, Exception):
            raise item
        return item

    return map(read, what)


def test_an_item_that_cannot_be_read_is_none_and_the_others_go_on() -> None:
    errors: dict[int, str] = {}
    read = past_errors(items(DAMAGED, 1, OSError("gone"), 2), errors, (FormatError, OSError))
    assert list(read) == [None, 1, None, 2]
    assert errors == {0: str(DAMAGED), 2: "gone"}


def test_where_nothing_can_be_read_the_first_reason_is_raised() -> None:
    def ask(**options: bool) -> list[int | None]:
        what = items(DAMAGED, FormatError("empty", file="b.bin"))
        return list(past_errors(what, {}, (FormatError,), **options))

    with pytest.raises(FormatError, match=r"a\.bin"):
        ask()
    assert ask(needs_one=False) == [None, None]


def test_other_errors_and_a_source_that_does_not_get_on_end_it() -> None:
    with pytest.raises(DeviceError):
        list(past_errors(items(1, DeviceError("unplugged")), {}, (FormatError,)))
    calls = []

    def stuck() -> int:
        calls.append(1)
        raise DAMAGED

    read: Callable[[], int | None] = stuck
    with pytest.raises(FormatError):
        list(past_errors(iter(read, None), {}, (FormatError,), most=5))
    assert len(calls) == 6


def test_a_recording_that_ends_with_an_error_keeps_what_came_before() -> None:
    def recorded() -> Iterator[int]:
        yield 1
        raise DAMAGED

    errors: dict[int, str] = {}
    assert list(past_errors(recorded(), errors, (FormatError,))) == [1, None]
    assert list(errors) == [1]


def test_an_error_after_which_nothing_follows_is_raised_on_request() -> None:
    errors: dict[int, str] = {}
    read = past_errors(items(DAMAGED, 1), errors, (FormatError,), goes_on=lambda: False)
    with pytest.raises(FormatError, match=r"a\.bin"):
        next(read)
    assert not errors
