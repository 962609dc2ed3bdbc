"""Messages that a page sends: small JSON objects, read strictly."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.json import read_json
from manip3d._util.texts import has_control_characters
from manip3d.errors import FormatError, InputError

MAX_LENGTH = 2048
"""Characters of a message; a free text of 500 quotes is twice as long in JSON."""


@dataclass(frozen=True)
class Kind:
    """Accepted values of a message's field.

    Attributes
    ----------
    type : type
        ``int``, ``float`` (whole numbers count as such) or ``str``.
    low, high : float
        Bounds of a number.
    choices : sequence of str
        Permitted texts.
    length : int
        Characters of a free text, if it has no choices; control characters other than line feeds
        and lone surrogates are refused.
    optional : bool
        A message may lack the field.
    """

    type: type
    low: float = 0.0
    high: float = 0.0
    choices: Sequence[str] = ()
    length: int = 0
    optional: bool = False

    def read(self, name: str, value: Any) -> int | float | str:
        """Return the value of a field.

        Parameters
        ----------
        name : str
            Name of the field, for errors.
        value : object
            Its value in the message.

        Raises
        ------
        FormatError
            Another type, or out of bounds.
        """
        if self.type is str:
            if isinstance(value, str) and value in self.choices:
                return value
            if self.length and not self.choices:
                return self._free_text(name, value)
            raise FormatError(f"{name}: expected one of {', '.join(self.choices)}")
        accepted = (int,) if self.type is int else (int, float)
        if isinstance(value, bool) or not isinstance(value, accepted):
            raise FormatError(f"{name}: expected {self.type.__name__}, got {type(value).__name__}")
        # The comparison comes before float(), which fails on huge whole numbers.
        if not self.low <= value <= self.high:
            raise FormatError(f"{name}: expected {self.low:g} to {self.high:g}")
        number: int | float = self.type(value)
        return number

    def _free_text(self, name: str, value: Any) -> str:
        if not isinstance(value, str):
            raise FormatError(f"{name}: expected a text, got {type(value).__name__}")
        if len(value) > self.length:
            raise FormatError(
                f"{name}: expected at most {self.length} characters, got {len(value)}"
            )
        if has_control_characters(value):
            raise FormatError(f"{name}: expected a text without control characters")
        return value


@checked
def read_message(
    text: str, types: Mapping[str, Mapping[str, Kind]], *, max_length: int = MAX_LENGTH
) -> tuple[str, dict[str, int | float | str]]:
    """Read one message: a flat JSON object with a ``type`` and the fields of that type.

    Parameters
    ----------
    text : str
        The received text.
    types : mapping of str to mapping of str to Kind
        The fields of each type of message.
    max_length : int
        Characters of a message.

    Returns
    -------
    type : str
    fields : dict

    Raises
    ------
    FormatError
        No JSON object, too long, a key twice, an unknown type, a field too many or too few, or a
        value out of range.

    Examples
    --------
    >>> from manip3d.serve import Kind, read_message
    >>> read_message('{"type": "ack", "sequence": 7}', {"ack": {"sequence": Kind(int, 0, 9)}})
    ('ack', {'sequence': 7})
    """
    if len(text) > max_length:
        raise FormatError(f"message: expected at most {max_length} characters, got {len(text)}")
    try:
        found = read_json(text)
    except FormatError as error:
        raise FormatError(f"message: {error}") from None
    except (ValueError, RecursionError):
        raise FormatError("message: expected JSON") from None
    if not isinstance(found, dict):
        raise FormatError(f"message: expected an object, got {type(found).__name__}")
    name = found.pop("type", None)
    if not isinstance(name, str) or name not in types:
        raise FormatError(f"type: expected one of {', '.join(types)}")
    fields = types[name]
    if not isinstance(fields, Mapping):
        raise InputError(f"types: expected a mapping for {name!r}, got {type(fields).__name__}")
    needed = {field for field, kind in fields.items() if not kind.optional}
    if not needed <= found.keys() <= fields.keys():
        expected = ", ".join(fields) or "no fields"
        raise FormatError(f"{name}: expected {expected}, got {', '.join(found) or 'no fields'}")
    values = {field: fields[field].read(field, value) for field, value in found.items()}
    if not all(math.isfinite(v) for v in values.values() if not isinstance(v, str)):
        raise FormatError(f"{name}: expected finite numbers")  # 1e999
    return name, values
