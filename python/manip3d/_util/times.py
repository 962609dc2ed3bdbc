"""Times of frames: nanoseconds since 1970, as integers, since float64 seconds hold only 0.2 us."""

from __future__ import annotations

from datetime import UTC, datetime

SECOND_NS = 1_000_000_000


def parse_time(text: str) -> int:
    """Nanoseconds since 1970 of ``2011-09-26 13:02:44.317412775``, which names no time zone: UTC.

    Raises
    ------
    ValueError
        The text is no such time.
    """
    whole, _, fraction = text.strip().partition(".")
    if fraction and not (fraction.isascii() and fraction.isdigit()):
        raise ValueError(f"expected digits after the point, got {fraction!r}")
    moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    return int(moment.timestamp()) * SECOND_NS + int((fraction + "0" * 9)[:9])


def nanoseconds(seconds: float) -> int:
    """The nearest whole number of nanoseconds.

    Raises
    ------
    ValueError
        More than 64 bits hold, infinity or NaN.
    """
    if not abs(seconds) < 9e9:
        raise ValueError(f"expected seconds below 9e9, got {seconds!r}")
    return round(seconds * SECOND_NS)
