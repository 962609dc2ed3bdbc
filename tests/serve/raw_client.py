"""A client of `LocalServer` that sends exactly the given bytes, valid or not."""

from __future__ import annotations

import base64
import contextlib
import os
import re
import socket
import ssl
import struct
from collections.abc import Mapping

from manip3d.serve import LocalServer

SECONDS = 10.0


def connect(server: LocalServer) -> socket.socket:
    link = socket.create_connection((server.host, server.port), timeout=SECONDS)
    if server.certificate is None:
        return link
    return trusting(server.certificate.pem).wrap_socket(link, server_hostname=server.host)


def trusting(pem: bytes) -> ssl.SSLContext:
    """Return a context that trusts this certificate alone, for the address that it names."""
    certificate = pem[pem.index(b"-----BEGIN CERTIFICATE-----") :].decode()
    return ssl.create_default_context(cadata=certificate)


def read_all(link: socket.socket) -> bytes:
    """Read until the other end closes."""
    received = b""
    with contextlib.suppress(ConnectionError):
        while chunk := link.recv(1 << 16):
            received += chunk
    return received


def request(path: str, headers: Mapping[str, str], method: str = "GET") -> bytes:
    lines = [f"{method} {path} HTTP/1.1", *(f"{k}: {v}" for k, v in headers.items()), "", ""]
    return "\r\n".join(lines).encode()


def get(
    server: LocalServer, path: str, headers: Mapping[str, str] | None = None, method: str = "GET"
) -> tuple[int, str, bytes]:
    """Return status, head and body; ``headers`` replace those of a well-behaved client."""
    own = {"Host": server.origin.partition("//")[2]} | dict(headers or {})
    with connect(server) as link:
        link.sendall(request(path, own, method))
        head, _, body = read_all(link).partition(b"\r\n\r\n")
    return int(head.split()[1]), head.decode(), body


def cookie(server: LocalServer) -> str:
    """Return the cookie that the server sets for a client with its secret address."""
    status, head, _ = get(server, "/" + server.new_url().partition("/?")[2].join(["?", ""]))
    assert status == 303, head
    found = re.search(r"(?im)^set-cookie: ([^;]+); ([^\r]+)", head)
    assert found is not None
    marks = {"HttpOnly", "SameSite=Strict"} | ({"Secure"} if server.certificate else set())
    assert marks <= set(found[2].split("; "))
    return found[1]


class RawStream:
    """An open WebSocket, read and written frame by frame [RFC 6455]."""

    def __init__(self, server: LocalServer, headers: Mapping[str, str] | None = None) -> None:
        given = dict(headers or {})
        self.cookie = given.get("Cookie") or cookie(server)
        own = {
            "Host": server.origin.partition("//")[2],
            "Origin": server.origin,
            "Cookie": self.cookie,
            "Upgrade": "websocket",
            "Connection": "Upgrade",
            "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": base64.b64encode(bytes(16)).decode(),
        } | given
        self.link = connect(server)
        self.link.sendall(request("/stream", own))
        head = b""
        while b"\r\n\r\n" not in head and (chunk := self.link.recv(1)):
            head += chunk
        self.status = int(head.split()[1])

    def send(self, content: bytes, opcode: int = 1, length: int | None = None) -> None:
        """Send one masked frame; ``length`` is the length that its header claims."""
        size = len(content) if length is None else length
        head = bytes([0x80 | opcode])
        if size < 126:
            head += bytes([0x80 | size])
        elif size < 1 << 16:
            head += bytes([0x80 | 126]) + struct.pack(">H", size)
        else:
            head += bytes([0x80 | 127]) + struct.pack(">Q", size)
        mask = os.urandom(4)
        masked = bytes(b ^ mask[i % 4] for i, b in enumerate(content))
        self.link.sendall(head + mask + masked)

    def receive(self) -> tuple[int, bytes]:
        """Return opcode and content of the next frame; 8 is a close, -1 a lost connection."""
        try:
            first, second = self._take(2)
            size = second & 0x7F
            if size == 126:
                (size,) = struct.unpack(">H", self._take(2))
            elif size == 127:
                (size,) = struct.unpack(">Q", self._take(8))
            return first & 0xF, self._take(size)
        except ConnectionError:
            return -1, b""

    def close_code(self) -> int:
        """Return the code with which the server closed the stream; -1: it sent none."""
        while True:
            opcode, content = self.receive()
            if opcode == 8:
                return int(struct.unpack(">H", content[:2])[0])
            if opcode == -1:
                return -1

    def _take(self, count: int) -> bytes:
        content = bytearray(count)
        rest = memoryview(content)
        while rest:
            received = self.link.recv_into(rest)
            if not received:
                raise ConnectionError("closed")
            rest = rest[received:]
        return bytes(content)

    def close(self) -> None:
        self.link.close()

    def __enter__(self) -> RawStream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
