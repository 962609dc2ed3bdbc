"""HTTPS for headsets on the local network: own certificate, nothing in the clear, same checks."""

from __future__ import annotations

import os
import socket
import ssl
import stat
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from raw_client import RawStream, cookie, get, request, trusting

from manip3d import FormatError, InputError

pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")
pytest.importorskip("cryptography", reason="the extra 'live' is not installed")

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization

from manip3d.serve import (
    Certificate,
    Limits,
    LocalServer,
    Page,
    StreamClient,
    kept_certificate,
    make_certificate,
)

PAGES = {"/": Page("text/html", b"<p>here</p>")}


def ignore(client: StreamClient, text: str) -> None:
    pass


def own_address() -> str:
    """An address of this machine that others reach."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            asked.connect(("192.0.2.1", 9))  # nothing is sent
        except OSError:
            pytest.skip("this machine has no network")
        return str(asked.getsockname()[0])


def test_a_headset_on_the_network_is_served_encrypted() -> None:
    host = own_address()
    if host.startswith("127."):
        pytest.skip("this machine has no address but loopback")
    with LocalServer(PAGES, ignore, host=host, certificate=make_certificate(host)) as server:
        assert server.new_url().startswith(f"https://{host}:{server.port}/?token=")
        status, head, body = get(server, "/", {"Cookie": cookie(server)})
        assert (status, body) == (200, b"<p>here</p>")
        assert f"connect-src 'self' wss://{host}:{server.port}/stream" in head
        with RawStream(server) as stream:
            assert stream.status == 101
            end = time.monotonic() + 60.0
            while server.num_clients < 1 and time.monotonic() < end:
                time.sleep(0.01)
            server.publish(b"a frame", sequence=1, captured_ns=0)
            assert stream.receive() == (2, b"a frame")
        for headers in ({}, {"Host": "127.0.0.1"}, {"Origin": f"http://{host}:{server.port}"}):
            assert get(server, "/", headers)[0] == 403
        with pytest.raises(ConnectionRefusedError):  # this address only
            socket.create_connection(("127.0.0.1", server.port), timeout=2)


def test_nothing_is_said_in_the_clear() -> None:
    certificate = make_certificate("127.0.0.1")
    with LocalServer(PAGES, ignore, certificate=certificate) as server:
        with socket.create_connection((server.host, server.port), timeout=5) as link:
            link.sendall(request("/", {"Host": server.origin.partition("//")[2]}))
            answer = link.recv(4096)
        assert b"HTTP" not in answer
        with pytest.raises(ssl.SSLCertVerificationError):  # who trusts somebody else
            get_with(trusting(make_certificate("127.0.0.1").pem), server)
        old = trusting(certificate.pem)
        with pytest.warns(DeprecationWarning, match="TLSv1"):
            old.maximum_version = ssl.TLSVersion.TLSv1_1
        with pytest.raises(ssl.SSLError):
            get_with(old, server)
        assert get_with(trusting(certificate.pem), server).startswith(b"HTTP/1.1 403")


def get_with(context: ssl.SSLContext, server: LocalServer) -> bytes:
    with (
        socket.create_connection((server.host, server.port), timeout=5) as plain,
        context.wrap_socket(plain, server_hostname=server.host) as link,
    ):
        link.sendall(request("/", {"Host": server.origin.partition("//")[2]}))
        return link.recv(4096)


def test_a_handshake_that_never_ends_is_cut_off() -> None:
    limits = Limits(request_seconds=0.5)
    certificate = make_certificate("127.0.0.1")
    with LocalServer(PAGES, ignore, limits=limits, certificate=certificate) as server:
        with socket.create_connection((server.host, server.port), timeout=5) as link:
            begin = time.monotonic()
            link.sendall(b"\x16\x03\x01")  # the first bytes of a greeting
            assert link.recv(1) == b""
            assert 0.3 < time.monotonic() - begin < 3.0
        assert get(server, "/")[0] == 403  # others are served


def test_a_certificate_is_for_one_address_and_for_a_year() -> None:
    made = make_certificate("::1")
    assert made.host == "::1"
    assert b"PRIVATE KEY" in made.pem
    assert "PRIVATE" not in repr(made)
    read = x509.load_pem_x509_certificate(made.pem)
    assert made.until == read.not_valid_after_utc
    assert timedelta(days=396) < made.until - datetime.now(UTC) < timedelta(days=398)
    assert len(made.fingerprint) == 95
    digest = read.fingerprint(hashes.SHA256()).hex()
    assert made.fingerprint.replace(":", "").lower() == digest
    assert make_certificate("::1").pem != made.pem
    with pytest.raises(InputError, match=r"certificate: expected one for 127\.0\.0\.1, got ::1"):
        LocalServer(PAGES, ignore, certificate=made)
    for host in ("example.org", "0.0.0.0", "224.0.0.1", "240.0.0.1", "255.255.255.255"):
        with pytest.raises(InputError, match="host: expected"):
            make_certificate(host)


def test_a_kept_certificate_is_the_same_again(tmp_path: Path) -> None:
    path = tmp_path / "own.pem"
    first = kept_certificate(path, "127.0.0.1")
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o600
    assert kept_certificate(path, "127.0.0.1") == first
    with pytest.raises(InputError, match=r"expected a certificate for 127\.0\.0\.2, got 127"):
        kept_certificate(path, "127.0.0.2")
    whole = path.read_bytes()
    for wrong in (b"", b"not a key", whole[:100], whole[: whole.index(b"-----BEGIN CERT")]):
        path.write_bytes(wrong)
        with pytest.raises(FormatError, match=r"own\.pem"):
            kept_certificate(path, "127.0.0.1")
    with pytest.raises(IsADirectoryError):
        kept_certificate(tmp_path, "127.0.0.1")
    with pytest.raises(FileNotFoundError):
        kept_certificate(tmp_path / "absent" / "own.pem", "127.0.0.1")


def test_a_certificate_of_another_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.pem"
    first, second = (make_certificate("127.0.0.1").pem for _ in range(2))
    begin = b"-----BEGIN CERTIFICATE-----"
    path.write_bytes(first[: first.index(begin)] + second[second.index(begin) :])
    with pytest.raises(FormatError, match=r"own\.pem.*expected a certificate of this private key"):
        kept_certificate(path, "127.0.0.1")


def test_a_key_with_a_password_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.pem"
    made = make_certificate("127.0.0.1").pem
    locked = serialization.load_pem_private_key(made, None).private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.BestAvailableEncryption(b"secret"),
    )
    path.write_bytes(locked + made[made.index(b"-----BEGIN CERTIFICATE-----") :])
    with pytest.raises(FormatError, match=r"own\.pem.*without a password"):
        kept_certificate(path, "127.0.0.1")


def test_two_processes_that_begin_at_once_keep_one_certificate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from manip3d.serve import _certificate

    path = tmp_path / "own.pem"
    others = make_certificate("127.0.0.1")

    def make_too_late(host: str) -> Certificate:
        path.write_bytes(others.pem)
        return make_certificate(host)

    monkeypatch.setattr(_certificate, "make_certificate", make_too_late)
    assert kept_certificate(path, "127.0.0.1") == others
    assert path.read_bytes() == others.pem


def test_a_certificate_of_tomorrow_is_said_to_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from manip3d.serve import _certificate

    class Tomorrow(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> Any:
            return datetime.now(tz) + timedelta(days=1)

    with monkeypatch.context() as ahead:
        ahead.setattr(_certificate, "datetime", Tomorrow)
        made = kept_certificate(tmp_path / "own.pem", "127.0.0.1")
    assert made.since > datetime.now(UTC)
    with pytest.raises(InputError, match="not valid before"):
        kept_certificate(tmp_path / "own.pem", "127.0.0.1")


def test_a_certificate_that_is_over_is_said_to_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from manip3d.serve import _certificate

    monkeypatch.setattr(_certificate, "DAYS", 0)
    made = make_certificate("127.0.0.1")
    (tmp_path / "old.pem").write_bytes(made.pem)
    while datetime.now(UTC) < made.until:
        time.sleep(0.2)
    with pytest.raises(InputError, match="no longer valid since"):
        kept_certificate(tmp_path / "old.pem", "127.0.0.1")


def test_a_key_of_another_algorithm_and_a_long_file_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.pem"
    made = kept_certificate(path, "127.0.0.1")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    known = made.pem.replace(b"\n", b"")
    begin = known.index(b"-----", 5) + 5
    assert known[begin:].startswith(b"MIGHAgEAMBMGByqGSM49AgEGCCqGSM49AwEH")  # P-256, by its name
    text = made.pem.replace(b"AwEH", b"AwFH", 1)
    assert text != made.pem
    path.write_bytes(text)
    with pytest.raises(FormatError, match=r"own\.pem.*expected a private key"):
        kept_certificate(path, "127.0.0.1")
    path.write_bytes(made.pem + b"\n" * 70_000)
    with pytest.raises(FormatError, match="at most 65536 bytes"):
        kept_certificate(path, "127.0.0.1")
