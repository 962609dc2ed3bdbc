"""Times of frames in integer nanoseconds since 1970, and of what people do.

Float64 seconds since 1970 resolve only 0.2 us.
"""

from __future__ import annotations

from datetime import UTC, datetime

SECOND_NS = 1_000_000_000  # nanoseconds per second

NOMINAL_PERIOD_NS = 33_333_333
"""Between frames of recordings and sources without times: 30 frames per second."""


def parse_time(text: str) -> int:
    """Return nanoseconds since 1970 of a time such as ``2011-09-26 13:02:44.317412775`` in UTC.

    Instead of the space there may be a ``T``, as ISO 8601 has it.

    Raises
    ------
    ValueError
        The text has another form, or its nanoseconds do not fit 64 bits (years before 1678 and
        after 2262).
    """
    whole, _, fraction = text.strip().partition(".")
    if fraction and not (fraction.isascii() and fraction.isdigit()):
        raise ValueError(f"expected digits after the point, got {fraction!r}")
    form = "%Y-%m-%dT%H:%M:%S" if "T" in whole else "%Y-%m-%d %H:%M:%S"
    moment = datetime.strptime(whole, form).replace(tzinfo=UTC)
    time_ns = int(moment.timestamp()) * SECOND_NS + int((fraction + "0" * 9)[:9])
    if not -(2**63) <= time_ns < 2**63:
        raise ValueError(f"expected a year from 1678 to 2262, got {text.strip()!r}")
    return time_ns


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


def local_now() -> datetime:
    """Return the time with this machine's offset from UTC."""
    return datetime.now().astimezone()


def dated(moment: datetime) -> str:
    """Return a time as people read it, such as ``2026-03-02 09:05``."""
    return moment.strftime("%Y-%m-%d %H:%M")
