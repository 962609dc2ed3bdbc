"""The errors of manip3d. ``manip3d.Error`` is the root; C++ throws the same classes."""

from __future__ import annotations


class Error(Exception):
    """Root of all errors that manip3d raises on purpose."""


class InputError(Error, ValueError):
    """A bad argument. The message names it, says what was expected and what came."""


class FormatError(Error, ValueError):
    """An unreadable file.

    Attributes
    ----------
    reason : str
        What was expected and what came.
    file : str
        The file, or ``""`` for bytes.
    line : int or None
        1-based line of a text file.
    byte_offset : int or None
        0-based offset into the uncompressed bytes of a binary file.
    """

    def __init__(
        self,
        reason: str,
        *,
        file: str = "",
        line: int | None = None,
        byte_offset: int | None = None,
    ) -> None:
        self.reason = reason
        self.file = file
        self.line = line
        self.byte_offset = byte_offset
        position = [file] if file else []
        if line is not None:
            position.append(f"line {line}")
        if byte_offset is not None:
            position.append(f"byte {byte_offset}")
        super().__init__(": ".join([*position, reason]))


class DeviceError(Error, RuntimeError):
    """A sensor that is absent, lost or misbehaves."""


class RenderError(Error, RuntimeError):
    """Nothing here can draw a picture. The message says what was tried, and names the cure."""


class MissingExtraError(Error, ImportError):
    """An optional dependency is not installed. The message names the cure."""

    def __init__(self, package: str, extra: str) -> None:
        verb = "are" if "," in package else "is"
        super().__init__(f"{package} {verb} needed here: pip install 'manip3d[{extra}]'")
