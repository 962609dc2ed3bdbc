"""Self-signed certificates, so that a headset on the local network connects by TLS."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import ssl
import tempfile
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError, MissingExtraError
from manip3d.io._files import limited_bytes, write_new

_MAX_BYTES = 65536  # a key and a certificate take 2000

DAYS = 397
"""Days for which a new certificate is valid: one less than browsers accept.

The CA/Browser Forum allows 398 days (Baseline Requirements 1.7.1, section 6.3.2). The last day is
kept for clocks that differ.
"""


@dataclass(frozen=True)
class Certificate:
    """A certificate and its private key.

    Attributes
    ----------
    host : str
        IP address of the machine.
    fingerprint : str
        SHA-256 in pairs of hexadecimal digits, as browsers show it.
    since : datetime
        Begin of its validity.
    until : datetime
        End of its validity.
    pem : bytes
        Private key and certificate; whoever has them can pretend to be this machine.
    """

    host: str
    fingerprint: str
    since: datetime
    until: datetime
    pem: bytes = field(repr=False)

    def context(self) -> ssl.SSLContext:
        """Settings of a server that shows this certificate, TLS 1.2 or later."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        # Python's ssl reads certificates from files only. Only this user can read the temporary
        # file. It is deleted when it has been loaded; if the process is killed before, it stays.
        descriptor, name = tempfile.mkstemp(suffix=".pem")
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(self.pem)
            context.load_cert_chain(name)
        finally:
            os.unlink(name)
        return context


@checked
def make_certificate(host: str) -> Certificate:
    """Make a self-signed certificate (ECDSA, P-256).

    Parameters
    ----------
    host : str
        The address of this machine, such as 192.168.1.20.

    Returns
    -------
    Certificate

    Raises
    ------
    InputError
        ``host`` is not an address of one machine.
    MissingExtraError
        cryptography is not installed.

    Examples
    --------
    >>> from manip3d.serve import make_certificate
    >>> make_certificate("192.168.1.20").host
    '192.168.1.20'
    """
    address = address_of(host)
    try:
        from cryptography import x509
        from cryptography.hazmat.primitives import hashes, serialization
        from cryptography.hazmat.primitives.asymmetric import ec
        from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
    except ModuleNotFoundError as error:
        raise MissingExtraError("cryptography", "live") from error
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "manip3d")])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))  # allows for a headset whose clock is slow
        .not_valid_after(now + timedelta(days=DAYS))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(address)]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return _certificate(private + made.public_bytes(serialization.Encoding.PEM), "certificate")


@checked
def kept_certificate(path: str | os.PathLike[str], host: str) -> Certificate:
    """Read a certificate from a file, or make one and keep it there.

    With the same certificate as last time a headset does not ask again.

    Parameters
    ----------
    path : path
        Private key, without a password, and certificate (PEM). A new file is created so that only
        its owner can read it; the permissions of an existing file are not checked.
    host : str
        The address of this machine.

    Returns
    -------
    Certificate

    Raises
    ------
    FormatError
        The file holds no key and certificate that belong together, or the key has a password.
    InputError
        It is for another address, not yet valid or no longer valid: delete it to have a new one
        made.
    OSError
        It cannot be read or written.
    MissingExtraError
        cryptography is not installed.

    Examples
    --------
    >>> from manip3d.serve import kept_certificate
    >>> first = kept_certificate("manip3d.pem", "192.168.1.20")
    >>> kept_certificate("manip3d.pem", "192.168.1.20") == first
    True
    """
    target = path_of(path)
    with contextlib.suppress(FileNotFoundError):
        return _read_certificate(target, host)
    made = make_certificate(host)
    try:
        write_new(target, made.pem)
    except FileExistsError:  # another process has made one meanwhile
        return _read_certificate(target, host)
    return made


def _read_certificate(path: Path, host: str) -> Certificate:
    """Read a certificate; raise InputError if it is not valid for a host at this moment."""
    found = _certificate(limited_bytes(path, _MAX_BYTES), str(path))
    if found.host != str(address_of(host)):
        raise InputError(f"{path}: expected a certificate for {host}, got {found.host}")
    now = datetime.now(UTC)
    if found.since > now:
        raise InputError(f"{path}: not valid before {found.since:%Y-%m-%d %H:%M} UTC")
    if found.until <= now:
        raise InputError(f"{path}: no longer valid since {found.until:%Y-%m-%d}")
    return found


def address_of(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """Return the address of one machine; names, 0.0.0.0, 240/4 and link-local IPv6 are refused.

    The block 240.0.0.0/4, which is reserved (RFC 1112), includes the broadcast address.

    A link-local IPv6 address needs a zone (``fe80::1%eth0``), which addresses of pages cannot have.
    """
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise InputError(f"host: expected an address such as 127.0.0.1, got {host!r}") from None
    # Python calls ::1 reserved, too.
    is_reserved = isinstance(address, ipaddress.IPv4Address) and address.is_reserved
    if address.is_unspecified or address.is_multicast or is_reserved:
        raise InputError(
            f"host: expected the address of one network interface such as 192.168.1.20, got {host}"
        )
    if isinstance(address, ipaddress.IPv6Address) and (address.is_link_local or address.scope_id):
        raise InputError(
            f"host: expected an address that browsers can open, such as 192.168.1.20, got {host}, "
            "which is valid on one network interface only"
        )
    return address


def _certificate(pem: bytes, file: str) -> Certificate:
    try:
        from cryptography import x509
        from cryptography.exceptions import UnsupportedAlgorithm
        from cryptography.hazmat.primitives import hashes, serialization
    except ModuleNotFoundError as error:
        raise MissingExtraError("cryptography", "live") from error
    try:
        key = serialization.load_pem_private_key(pem, password=None)
        made = x509.load_pem_x509_certificate(pem)
        names = made.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        (address,) = names.get_values_for_type(x509.IPAddress)
        is_pair = key.public_key() == made.public_key()
    except (
        ValueError,
        TypeError,
        UnsupportedAlgorithm,
        x509.ExtensionNotFound,
        x509.DuplicateExtension,
        x509.InvalidVersion,
        x509.UnsupportedGeneralNameType,
    ):
        raise FormatError(
            "expected a private key without a password and a certificate of one address (PEM)",
            file=file,
        ) from None
    if not is_pair:
        raise FormatError("expected a certificate of this private key, got another's", file=file)
    digits = made.fingerprint(hashes.SHA256()).hex(":").upper()
    return Certificate(
        str(address), digits, made.not_valid_before_utc, made.not_valid_after_utc, pem
    )
