"""Texts that people typed."""

from __future__ import annotations

import unicodedata

from manip3d.errors import printable


def has_control_characters(text: str) -> bool:
    """Whether a text holds control characters other than line feeds, or lone surrogates.

    A terminal obeys the first; UTF-8 cannot hold the second, which stand for bytes that were no
    text.
    """
    return any(unicodedata.category(sign) in ("Cc", "Cs") and sign != "\n" for sign in text)


def legible(text: str) -> str:
    """Return a text of any number of lines in which control characters are escapes."""
    return "\n".join(map(printable, text.split("\n")))
