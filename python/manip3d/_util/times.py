"""Times of frames in integer nanoseconds since 1970; float64 seconds resolve only 0.2 us."""

from __future__ import annotations

from datetime import UTC, datetime

SECOND_NS = 1_000_000_000  # nanoseconds per second


def parse_time(text: str) -> int:
    """Return nanoseconds since 1970 of a time such as ``2011-09-26 13:02:44.317412775`` in UTC.

    Raises
    ------
    ValueError
        The text has another form.
    """
    whole, _, fraction = text.strip().partition(".")
    if fraction and not (fraction.isascii() and fraction.isdigit()):
        raise ValueError(f"expected digits after the point, got {fraction!r}")
    moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    return int(moment.timestamp()) * SECOND_NS + int((fraction + "0" * 9)[:9])


def nanoseconds(seconds: float) -> int:
    """Return seconds as the nearest integer of nanoseconds.

    Raises
    ------
    ValueError
        The result would not fit 64 bits, or ``seconds`` is NaN.
    """
    if not abs(seconds) < 9e9:
        raise ValueError(f"expected seconds below 9e9, got {seconds!r}")
    return round(seconds * SECOND_NS)
