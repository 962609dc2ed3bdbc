"""Control characters in text that users have typed."""

from __future__ import annotations

import unicodedata

from manip3d.errors import printable


def has_control_characters(text: str) -> bool:
    """Return whether a text has control characters other than line feeds, or lone surrogates.

    A terminal executes control characters. Lone surrogates, which stand for undecodable bytes,
    cannot be encoded as UTF-8.
    """
    return any(unicodedata.category(sign) in ("Cc", "Cs") and sign != "\n" for sign in text)


def legible(text: str) -> str:
    """Return a text, which may have several lines, with control characters escaped."""
    return "\n".join(map(printable, text.split("\n")))
