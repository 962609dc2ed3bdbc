"""Conversion of values to and from JSON, and records with a checksum."""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any, NoReturn

from manip3d.errors import FormatError


def finite(value: Any) -> Any:
    """Return the value with NaN and infinities replaced by None, since JSON has neither."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def read_json(text: str) -> Any:
    """Return the value of a JSON text that a stranger may have written.

    Raises
    ------
    FormatError
        An object has a key twice, or a number is NaN or infinite.
    ValueError, RecursionError
        The text is no JSON, or nests too deeply.
    """
    return json.loads(text, object_pairs_hook=_unique, parse_constant=_no_constant)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise FormatError("expected each key of an object once")
    return found


def _no_constant(name: str) -> NoReturn:
    raise FormatError(f"expected numbers, got {name}")


def canonical_json(value: Any) -> bytes:
    """Return the canonical JSON text of a value, of which hashes are computed; NaN stays NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """Return the record with its own checksum added, which `unsealed` verifies."""
    return record | {"sha256": hashlib.sha256(canonical_json(record)).hexdigest()}


def unsealed(text: bytes) -> dict[str, Any] | None:
    """Return the record in the JSON text of a `sealed` one; None if it fails its checksum."""
    try:
        record: dict[str, Any] = json.loads(text)
        claimed = record.pop("sha256")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None  # damaged, cut off, or not such a record
    is_whole = claimed == hashlib.sha256(canonical_json(record)).hexdigest()
    return record if is_whole else None
