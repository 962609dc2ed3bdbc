"""Errors of manip3d. ``manip3d.Error`` is their base class; C++ throws the same classes."""

from __future__ import annotations

import re
import sys
from typing import Any, ClassVar

_HALVES = re.compile("[\ud800-\udc7f\udd00-\udfff]")


def printable(text: str) -> str:
    r"""Return ``text`` with control characters and bytes that are not UTF-8 as escapes.

    Names and contents of files may have control sequences, which must not reach a terminal or a
    log.

    Examples
    --------
    >>> from manip3d.errors import printable
    >>> printable("a\x1b[31m.obj")
    'a\\x1b[31m.obj'
    """
    # Unpaired surrogates that encode no byte can come from JSON.
    whole = _HALVES.sub(lambda half: half[0].encode("unicode_escape").decode(), text)
    decoded = whole.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in decoded)


class Error(Exception):
    """Base class of all errors that manip3d raises on purpose.

    Attributes
    ----------
    code : str
        Kind of error, for programs: ``input``, ``format``, ``device``, ``render``,
        ``missing-extra`` or ``broken-extra``. It does not change when messages change.
    """

    code: ClassVar[str] = "error"

    def details(self) -> dict[str, str | int | None]:
        """Return ``code``, ``message`` and the attributes of the class, ready for JSON.

        Examples
        --------
        >>> from manip3d import FormatError
        >>> FormatError("expected 3 numbers, got 2", file="a.obj", line=7).details()["line"]
        7
        """
        about = {k: v for k, v in vars(self).items() if not k.startswith("_")}
        return {"code": self.code, "message": str(self), **about}


class InputError(Error, ValueError):
    """An invalid argument. The message states its name, what was expected and what was given."""

    code = "input"


class FormatError(Error, ValueError):
    """A file that cannot be read.

    The message shows control characters and bytes that are not UTF-8 as escapes.

    Attributes
    ----------
    reason : str
        Description of what was expected and what was found.
    file : str
        Name of the file; ``""`` for bytes.
    line : int or None
        1-based line of a text file.
    byte_offset : int or None
        0-based offset into the uncompressed bytes of a binary file.
    """

    code = "format"

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
        super().__init__(printable(": ".join([*position, reason])))

    def __reduce__(self) -> tuple[Any, ...]:
        return _format_error, (self.reason, self.file, self.line, self.byte_offset)


def error_details(error: BaseException) -> dict[str, object]:
    """Return the fields of any error for programs: ``code``, ``message`` and further attributes.

    Examples
    --------
    >>> from manip3d.errors import error_details
    >>> error_details(FileNotFoundError(2, "No such file or directory", "a.obj"))["code"]
    'file'
    """
    if isinstance(error, Error):
        return dict(error.details())
    if isinstance(error, OSError):
        return {"code": "file", "message": str(error), "file": error.filename}
    return {
        "code": "memory" if isinstance(error, MemoryError) else "internal",
        "message": str(error),
    }


def _format_error(reason: str, file: str, line: int | None, byte_offset: int | None) -> FormatError:
    return FormatError(reason, file=file, line=line, byte_offset=byte_offset)


class DeviceError(Error, RuntimeError):
    """A sensor is missing, was disconnected, or does not work as expected."""

    code = "device"


class RenderError(Error, RuntimeError):
    """No renderer is available. The message states what was tried, and how to solve the problem."""

    code = "render"


def way_to_install(extra: str) -> str:
    """Words of messages on how to install one or several extras, between commas."""
    way = f"pip install 'manip3d[{extra}]'"
    if "pose" in extra.split(",") and sys.version_info >= (3, 13):
        way += " with Python 3.11 or 3.12, because MediaPipe has no package for later ones"
    return way


class MissingExtraError(Error, ImportError):
    """An optional dependency is not installed. The message states how to install it."""

    code = "missing-extra"

    def __init__(self, package: str, extra: str) -> None:
        verb = "are" if "," in package else "is"
        super().__init__(f"{package} {verb} needed here: {way_to_install(extra)}")
        self.package = package
        self.extra = extra

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.package, self.extra)


class BrokenExtraError(Error, ImportError):
    """An optional dependency is installed but cannot be imported. The message states why."""

    code = "broken-extra"

    def __init__(self, package: str, extra: str, reason: str) -> None:
        super().__init__(f"{package} is installed but cannot be imported: {reason}")
        self.package = package
        self.extra = extra
        self.reason = reason

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.package, self.extra, self.reason)
