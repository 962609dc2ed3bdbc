"""Text that users have typed or that files hold, and numbers with their nouns."""

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


def counted(number: int, noun: str, plural: str = "", *, separator: str = "") -> str:
    """Return a number with its noun in singular or plural: ``1 face``, ``80354 faces``.

    Parameters
    ----------
    number : int
        The count.
    noun : str
        The noun in the singular.
    plural : str
        The noun in the plural; empty: the singular with an ``s``.
    separator : str
        Sign between groups of three digits.
    """
    text = f"{number:,}".replace(",", separator)
    return f"{text} {noun if number == 1 else plural or noun + 's'}"


def float_or_nan(text: str) -> float:
    """Return the number in a text; NaN if it is none, or has Python's underscores (``1_000``)."""
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan


def or_dash(value: int | None) -> str:
    """Return a number as text, or a hyphen if there is none."""
    return "-" if value is None else str(value)
