"""Errors: what they say, and that they survive a process pool."""

from __future__ import annotations

import copy
import pickle

import pytest

from manip3d import (
    BrokenExtraError,
    DeviceError,
    Error,
    FormatError,
    InputError,
    MissingExtraError,
    RenderError,
)
from manip3d.errors import printable


@pytest.mark.parametrize(
    "error",
    [
        Error("a"),
        InputError("points: expected shape (N, 3), got (4,)"),
        FormatError("expected x", file="a.obj", line=3),
        FormatError("expected x", byte_offset=12),
        DeviceError("gone"),
        RenderError("no display"),
        MissingExtraError("laspy", "las"),
        BrokenExtraError("laspy", "las", "libz.so.1: cannot open shared object file"),
    ],
    ids=lambda error: type(error).__name__,
)
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_errors_are_copied_and_pickled(error: Error, copied) -> None:  # type: ignore[no-untyped-def]
    again = copied(error)
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain text, Größe 3 µm", "plain text, Größe 3 µm"),
        ("a\x1b[31mred\n", r"a\x1b[31mred\n"),
        (b"\xff.obj".decode("utf-8", "surrogateescape"), r"\xff.obj"),
        ("\x9b\u202e", r"\x9b\u202e"),
        ("a\ud800\udcff", r"a\ud800\xff"),
    ],
)
def test_printable(text: str, shown: str) -> None:
    assert printable(text) == shown
    assert str(FormatError(text)) == shown
