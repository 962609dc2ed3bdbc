"""Text that users have typed or that files hold: control characters and numbers."""

from __future__ import annotations

import math
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


def float_or_nan(text: str) -> float:
    """Return the number in a text; NaN if it is none, or has Python's underscores (``1_000``)."""
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan
