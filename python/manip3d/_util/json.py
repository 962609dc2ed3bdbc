"""Values as JSON knows them."""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any


def finite(value: Any) -> Any:
    """Return the value with NaN and infinities as None, which JSON can write."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def canonical_json(value: Any) -> bytes:
    """Return the one spelling of a JSON value that hashes are taken of; NaN stays NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """Return the record with a checksum of itself, for `unsealed`."""
    return record | {"sha256": hashlib.sha256(canonical_json(record)).hexdigest()}


def unsealed(text: bytes) -> dict[str, Any] | None:
    """Return the record that `sealed` made, or None where a byte of its JSON has changed."""
    try:
        record: dict[str, Any] = json.loads(text)
        claimed = record.pop("sha256")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None  # torn, truncated or foreign
    is_whole = claimed == hashlib.sha256(canonical_json(record)).hexdigest()
    return record if is_whole else None
