"""Keys of diaries, and encryption of payloads."""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError
from manip3d.io._files import open_regular, write_new

_HEADER = "manip3d diary key 1 "
_BYTES = 32  # of a key of AES-256
_NONCE = 12  # bytes; the length for which GCM is defined without hashing

CHECK = b"manip3d diary"  # content of the check of a diary's key


@checked
def make_key(path: str | os.PathLike[str]) -> None:
    """Make a key file for an encrypted diary; only its owner may read the file.

    Store it separately from the diary, and keep a copy: without the key the diary is lost.

    Parameters
    ----------
    path : path
        File to write. An existing file is never replaced.

    Raises
    ------
    OSError
        The file exists, or cannot be written.

    Examples
    --------
    >>> from manip3d.diary import make_key
    >>> make_key("diary.key")
    """
    write_new(path_of(path), f"{_HEADER}{secrets.token_bytes(_BYTES).hex()}\n".encode())


def read_key(path: Path) -> bytes:
    """Read the key from a file made by `make_key`."""
    with open_regular(path) as file:
        text = file.read(256).decode("latin-1")
    digits = text.removeprefix(_HEADER).strip()
    try:
        key = bytes.fromhex(digits) if text.startswith(_HEADER) else b""
    except ValueError:
        key = b""
    if len(key) != _BYTES:
        raise FormatError("expected a key of a diary, as 'manip3d diary keygen' makes it",
                          file=str(path))  # fmt: skip
    return key


def new_key() -> bytes:
    return secrets.token_bytes(_BYTES)


def seal(key: bytes | None, content: bytes, about: str) -> bytes:
    """Encrypt content by AES-256-GCM with a new nonce, which precedes the ciphertext.

    ``about`` is authenticated, so that two ciphertexts cannot be swapped. Without a key the content
    is returned unchanged.
    """
    if key is None:
        return content
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

    nonce = secrets.token_bytes(_NONCE)
    return nonce + AESGCM(key).encrypt(nonce, content, about.encode())


def unseal(key: bytes | None, sealed: bytes, about: str) -> bytes:
    """Decrypt content; raise FormatError if the key is wrong or a byte was changed."""
    if key is None:
        return sealed
    from cryptography.exceptions import InvalidTag
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

    try:
        return AESGCM(key).decrypt(sealed[:_NONCE], sealed[_NONCE:], about.encode())
    except (InvalidTag, ValueError):
        raise FormatError(f"{about}: this key does not open it, or it was changed") from None


def seal_fields(key: bytes | None, fields: Mapping[str, Any], about: str) -> bytes:
    text = json.dumps(fields, separators=(",", ":"), allow_nan=False)
    return seal(key, text.encode(), about)


def unseal_fields(key: bytes | None, sealed: bytes, about: str) -> dict[str, Any]:
    content = unseal(key, sealed, about)
    try:
        found = json.loads(content)
    except ValueError:
        raise FormatError(
            f"{about}: expected JSON; the diary is damaged; 'manip3d diary rescue' copies what can "
            "be read"
        ) from None
    if not isinstance(found, dict):
        raise FormatError(f"{about}: expected fields")
    return found


def check_key(value: bytes, key: bytes | None, path: Path) -> bool:
    """Check a diary's key against its check; return False if it is encrypted and there is no key.

    Raises InputError for a key of a diary that is not encrypted, FormatError for another key.
    """
    if value == CHECK:
        if key is not None:
            raise InputError(f"key: {path} is not encrypted; open it without a key")
        return True
    if key is None:
        return False
    try:
        unseal(key, value, "meta")
    except FormatError:
        raise FormatError("this key does not open it", file=str(path)) from None
    return True


def require_key_material(key: str | os.PathLike[str] | None) -> bytes | None:
    """Read the key file; None if no path is given."""
    if key is None:
        return None
    imported("cryptography", "diary")
    path = path_of(key, "key")
    if path.is_dir():
        raise InputError(f"key: expected a file, got the folder {path}")
    return read_key(path)
