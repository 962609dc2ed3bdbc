"""The server refuses and logs strangers, without any effect on its own clients."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import gzip
import json
import logging
import os
import re
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from raw_client import RawStream, connect, cookie, get, read_all

from landmarks import assert_accessible
from manip3d import FormatError, InputError
from manip3d.errors import DeviceError
from waiting import wait_for

pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")
from aiohttp import web

from manip3d.serve import (
    Certificate,
    Kind,
    Limits,
    LocalServer,
    Page,
    StreamClient,
    _server,
    make_certificate,
    read_message,
)
from manip3d.serve._server import _cut

PAGES = {"/": Page("text/html", b"<p>here</p>"), "/a.js": Page("text/javascript", b"1")}
ACK = {"ack": {"sequence": Kind(int, 0, 2**32 - 1)}}


def acknowledge(client: StreamClient, text: str) -> None:
    _, fields = read_message(text, ACK)
    client.acknowledge(int(fields["sequence"]))


@pytest.fixture(scope="session")
def certificate() -> Certificate:
    pytest.importorskip("cryptography", reason="the extra 'live' is not installed")
    return make_certificate("127.0.0.1")


@pytest.fixture(params=["http", "https"])
def encryption(request: pytest.FixtureRequest) -> Certificate | None:
    """Run each test with a plain and with an encrypted connection; give the certificate."""
    return request.getfixturevalue("certificate") if request.param == "https" else None


@pytest.fixture
def server(encryption: Certificate | None) -> Iterator[LocalServer]:
    limits = Limits(request_seconds=0.5, send_seconds=0.5)
    gc.freeze()  # what was there before need not be looked through
    with LocalServer(PAGES, acknowledge, limits=limits, certificate=encryption) as running:
        scheme = "http" if encryption is None else "https"
        assert running.origin.startswith(f"{scheme}://127.0.0.1:")
        yield running
    gc.collect()  # a socket that was left open is said to be, in the test that left it


def ack(sequence: int) -> bytes:
    return json.dumps({"type": "ack", "sequence": sequence}).encode()


def join(server: LocalServer, code: str) -> int:
    """Return the status of a request with a typed code."""
    return get(server, f"/?code={code}")[0]


def test_a_code_lets_one_more_screen_in_once(server: LocalServer) -> None:
    assert get(server, "/join")[0] == 403  # nobody has asked for a code
    assert join(server, "00000000") == 403
    code = server.new_code()
    assert re.fullmatch(r"[0-9]{8}", code)
    status, head, page = get(server, "/join")
    assert (status, b'name="code"' in page) == (200, True)
    assert_accessible(page.decode())
    assert "form-action 'self'" in head
    assert "script-src" not in head  # default-src 'none' holds
    status, head, _ = get(server, f"/?code={code[:4]}%20{code[4:]}")
    assert status == 303
    found = re.search(r"(?im)^set-cookie: ([^;]+);", head)
    assert found is not None
    assert get(server, "/", {"Cookie": found[1]})[0] == 200
    assert join(server, code) == 403  # used
    assert get(server, "/join")[0] == 403
    first, second = server.new_code(), server.new_code()
    assert (join(server, first), join(server, second)) == (403, 303)  # the newest one holds
    assert server.refused["wrong code, or one that is over"] == 3
    assert "form-action 'none'" in get(server, "/", {"Cookie": found[1]})[1]


def test_a_code_is_void_after_five_wrong_ones_or_two_minutes(
    server: LocalServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(code: str) -> str:
        return f"{(int(code) + 1) % 10**8:08d}"

    code = server.new_code()
    assert [join(server, wrong(code)) for _ in range(4)] == [403] * 4
    assert join(server, code) == 303
    code = server.new_code()
    assert [join(server, wrong(code)) for _ in range(5)] == [403] * 5
    assert join(server, code) == 403
    monkeypatch.setattr(_server, "CODE_SECONDS", 0.2)
    code = server.new_code()
    time.sleep(0.25)
    assert join(server, code) == 403
    assert get(server, "/join")[0] == 403


class Session:
    """A well-behaved client that gets frames throughout a test."""

    def __init__(self, server: LocalServer) -> None:
        self.server = server
        self.stream = RawStream(server)
        assert self.stream.status == 101
        wait_for(lambda: server.num_clients >= 1)
        self.sequence = 0

    def check(self) -> None:
        """Check that a frame is sent and acknowledged."""
        self.sequence += 1
        content = b"frame %d" % self.sequence
        self.server.publish(content, sequence=self.sequence, captured_ns=time.time_ns())
        assert self.stream.receive() == (2, content)
        self.stream.send(ack(self.sequence))


@pytest.fixture
def session(server: LocalServer) -> Iterator[Session]:
    """Give a session that must still work after the test."""
    found = Session(server)
    try:
        found.check()
        yield found
        found.check()
    finally:
        found.stream.close()


def refused(server: LocalServer, reason: str) -> None:
    wait_for(lambda: any(name.startswith(reason) for name in server.refused))


# --- pages ----------------------------------------------------------------------------------------


def test_the_address_lets_in_and_the_token_leaves_the_address_bar(server: LocalServer) -> None:
    url = server.new_url()
    head = get(server, url.removeprefix(server.origin))[1]
    assert "Location: /\r\n" in head
    status, head, body = get(server, "/", {"Cookie": cookie(server)})
    assert (status, body) == (200, b"<p>here</p>")
    assert "default-src 'none'; script-src 'self'" in head
    assert "X-Content-Type-Options: nosniff" in head
    assert url.partition("token=")[2] not in head


def test_an_address_lets_one_browser_in(server: LocalServer) -> None:
    path = server.new_url().removeprefix(server.origin)
    status, head, _ = get(server, path)
    assert status == 303
    found = re.search(r"(?im)^set-cookie: ([^;]+);", head)
    assert found is not None
    status, _, body = get(server, path)
    assert (status, body.startswith(b"wrong token")) == (403, True)
    assert get(server, path, {"Cookie": found[1]})[0] == 303  # the browser that is in already
    assert get(server, server.new_url().removeprefix(server.origin))[0] == 303


@pytest.mark.parametrize(
    ("path", "headers", "status", "reason"),
    [
        ("/", {}, 403, "no session"),
        ("/a.js", {}, 403, "no session"),
        ("/?token=", {}, 403, "wrong token"),
        ("/?token=" + "A" * 43, {}, 403, "wrong token"),
        ("/?token=%ff%00", {}, 403, "wrong token"),
        ("/", {"Cookie": "manip3d=1"}, 403, "no session"),
        ("/", {"Host": "evil.example"}, 403, "foreign host"),
        ("/", {"Host": "localhost"}, 403, "foreign host"),
        ("/", {"Origin": "https://evil.example"}, 403, "foreign origin"),
        ("/", {"Origin": "null"}, 403, "foreign origin"),
    ],
)
def test_strangers_are_refused_and_logged(
    path: str,
    headers: dict[str, str],
    status: int,
    reason: str,
    server: LocalServer,
    session: Session,
    caplog: pytest.LogCaptureFixture,
) -> None:
    token = server.new_url().partition("token=")[2]
    with caplog.at_level(logging.WARNING, "manip3d.serve"):
        found, _, body = get(server, path, headers)
    assert found == status
    assert body.startswith(reason.encode())
    assert f"refused: {reason}" in caplog.text
    assert token not in caplog.text


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "HEAD"])
def test_nothing_but_get(method: str, server: LocalServer, session: Session) -> None:
    assert get(server, "/", {"Cookie": cookie(server)}, method)[0] == 405


def test_other_paths_are_not_there(server: LocalServer, session: Session) -> None:
    given = {"Cookie": cookie(server)}
    for path in ("/b", "/../pyproject.toml", "/%2e%2e/etc/passwd", "//etc/passwd"):
        assert get(server, path, given)[0] == 404


def test_a_browser_that_asks_for_an_icon_is_not_counted_as_refused(server: LocalServer) -> None:
    status, _, body = get(server, "/favicon.ico", {"Cookie": cookie(server)})
    assert (status, body) == (204, b"")
    assert not server.refused


def test_too_many_requests() -> None:
    limits = Limits(requests_per_second=1.0, request_burst=3.0)
    with LocalServer(PAGES, acknowledge, limits=limits) as server:
        found = [get(server, "/")[0] for _ in range(5)]
    assert found == [403, 403, 403, 429, 429]


# --- streams --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("headers", "reason"),
    [
        ({"Origin": "https://evil.example"}, "foreign origin"),
        ({"Origin": "http://127.0.0.1"}, "foreign origin"),  # another port
        ({"Cookie": "manip3d=1"}, "no session"),
        ({"Host": "evil.example"}, "foreign host"),
    ],
)
def test_foreign_streams(
    headers: dict[str, str], reason: str, server: LocalServer, session: Session
) -> None:
    with RawStream(server, headers) as stream:
        assert stream.status == 403
    refused(server, reason)


def test_a_stream_without_an_origin_is_no_browser(server: LocalServer, session: Session) -> None:
    given = {"Cookie": cookie(server), "Upgrade": "websocket", "Connection": "Upgrade"}
    assert get(server, "/stream", given)[0] == 403


def test_a_hundred_megabytes_are_not_read(server: LocalServer, session: Session) -> None:
    with RawStream(server) as stream:
        stream.send(b"x" * 1000, length=100_000_000)
        assert stream.close_code() == 1009
    refused(server, "bad frame")


def test_a_hundred_megabytes_in_fragments_are_not_kept(
    server: LocalServer, session: Session
) -> None:
    with RawStream(server) as stream:
        code = 0
        try:
            for number in range(100_000):
                stream.link.sendall(bytes([0 if number else 1, 0xFE, 0x03, 0xE8]) + bytes(1004))
        except (ConnectionError, ssl.SSLError):
            code = -1  # the server has closed while this was still sending
        assert code == -1 or stream.close_code() == 1009
    refused(server, "bad frame")


@pytest.mark.parametrize(
    "content",
    [b"", b"garbage", b"{}", b"[]", b'{"type":"ack"}', b'{"type":"ack","sequence":77}', b"[" * 900],
)
def test_garbage_messages(content: bytes, server: LocalServer, session: Session) -> None:
    with RawStream(server) as stream:
        stream.send(content)
        assert stream.close_code() == 1008
    refused(server, "bad message")


def test_what_strangers_write_does_not_fill_the_memory(server: LocalServer) -> None:
    for number in range(200):
        server._refuse(f"bad message: {number}" + "\N{EURO SIGN}" * 1000)
    assert len(server.refused) == 65
    assert server.refused["other reasons"] == 136
    assert max(len(reason.encode()) for reason in server.refused) <= 200
    for begin in range(4):  # the close frame is whole UTF-8
        text = ("x" * begin + "\N{EURO SIGN}" * 50 + "\ud800").encode("utf-8", "surrogatepass")
        cut = _cut(text.decode("utf-8", "surrogatepass"), 100)
        assert 98 <= len(cut) <= 100
        assert cut.decode().endswith("\N{EURO SIGN}")


@pytest.mark.parametrize(
    "content", [b"\xff" * 64, b"\x83\x80\0\0\0\0", b"\x81\xff" + b"\xff" * 12, b"\x81\x02\xff\xff"]
)
def test_garbage_frames(content: bytes, server: LocalServer, session: Session) -> None:
    with RawStream(server) as stream:
        stream.link.sendall(content)
        assert stream.close_code() in (1002, 1007, 1008, 1009, -1)
    refused(server, "bad")


@pytest.mark.parametrize(
    "content", [b"GET ' HTTP/1.1\r\n\r\n", b"G\x00T / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\r\n\r\n"]
)
def test_requests_that_are_not_http_are_counted_without_a_traceback(
    content: bytes, server: LocalServer, session: Session, caplog: pytest.LogCaptureFixture
) -> None:
    """Strangers on the network must not fill the terminal with tracebacks."""
    with connect(server) as link:
        link.sendall(content)
        assert b" 400 " in read_all(link).partition(b"\r\n")[0]
    refused(server, "malformed request")
    session.check()
    assert [record.exc_info for record in caplog.records if record.exc_info] == []


def test_bytes_are_no_message(server: LocalServer, session: Session) -> None:
    with RawStream(server) as stream:
        stream.send(os.urandom(32), opcode=2)
        assert stream.close_code() == 1008


def test_a_loud_client_is_cut_off(server: LocalServer, session: Session) -> None:
    limits = Limits(messages_per_second=1.0, message_burst=2.0)
    with LocalServer(PAGES, lambda client, text: None, limits=limits) as strict:
        with RawStream(strict) as stream:
            for _ in range(4):
                stream.send(b"x")
            assert stream.close_code() == 1008
        refused(strict, "too many messages")


def test_slow_requests_are_cut_off(server: LocalServer, session: Session) -> None:
    """A client that sends single bytes without end (slow loris) is cut off."""
    links = [connect(server) for _ in range(20)]
    for link in links:
        link.sendall(b"GET / HTTP/1.1\r\nHost: ")

    def are_cut_off() -> bool:
        for link in links:
            with contextlib.suppress(OSError):  # it is cut off
                link.sendall(b"a")
        return server.refused["request too slow"] == 20

    session.check()
    wait_for(are_cut_off)
    assert [read_all(link) for link in links] == [b""] * 20
    for link in links:
        link.close()


def test_too_many_connections_are_closed_at_once(encryption: Certificate | None) -> None:
    limits = Limits(connections=6, request_seconds=60.0)  # however slow: none of them is too slow
    with LocalServer(PAGES, acknowledge, limits=limits, certificate=encryption) as server:
        session = Session(server)
        links = [connect(server) for _ in range(12)]
        refused(server, "too many connections")
        session.check()
        for link in links:
            link.close()
        wait_for(lambda: _answers(server))
        session.stream.close()


def _answers(server: LocalServer) -> bool:
    try:
        return get(server, "/")[0] == 403
    except (ConnectionError, IndexError):
        return False


def test_too_many_streams(server: LocalServer, session: Session) -> None:
    streams = [RawStream(server) for _ in range(8)]
    assert [stream.status for stream in streams] == [101] * 7 + [503]
    for stream in streams:
        stream.close()


def test_streams_that_open_at_once_are_counted(
    server: LocalServer, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare = web.WebSocketResponse.prepare

    async def slow(self: web.WebSocketResponse, request: web.BaseRequest) -> object:
        await asyncio.sleep(0.5)
        return await prepare(self, request)

    monkeypatch.setattr(web.WebSocketResponse, "prepare", slow)
    with ThreadPoolExecutor(12) as pool:
        streams = list(pool.map(lambda _: RawStream(server), range(12)))
    assert sorted(stream.status for stream in streams) == [101] * 7 + [503] * 5
    for stream in streams:
        stream.close()


def test_a_server_that_is_not_ready_in_time_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    server = LocalServer(PAGES, acknowledge)

    async def never_ready(ready: threading.Event) -> None:
        await asyncio.sleep(0.5)

    monkeypatch.setattr(server, "_serve", never_ready)
    monkeypatch.setattr("manip3d.serve._server.START_SECONDS", 0.1)
    with pytest.raises(DeviceError, match=r"not ready within 0\.1 s"):
        server.start()


# --- frames ---------------------------------------------------------------------------------------


def test_a_slow_client_gets_the_latest_frame_and_slows_nobody(
    server: LocalServer, session: Session
) -> None:
    with RawStream(server) as slow:
        wait_for(lambda: server.num_clients == 2)
        for number in (100, 101):  # two are under way, and nobody acknowledges them
            server.publish(bytes([number]) * 1000, sequence=number, captured_ns=time.time_ns())
            for stream in (slow, session.stream):
                assert stream.receive() == (2, bytes([number]) * 1000)
        begin = time.monotonic()
        for number in range(102, 150):
            server.publish(bytes([number]) * 1000, sequence=number, captured_ns=time.time_ns())
        assert time.monotonic() - begin < 0.2  # publishing never waits
        for stream in (slow, session.stream):
            wait_for(lambda: server.report()[-1]["dropped"] == 47)
            stream.send(ack(100))
            assert stream.receive() == (2, bytes([149]) * 1000)
        report = server.report()[-1]
        assert (report["sent"], report["dropped"], report["acknowledged"]) == (3, 47, 1)
        for number in (101, 149):
            session.stream.send(ack(number))


def test_a_client_that_takes_no_bytes_is_disconnected(
    server: LocalServer, session: Session
) -> None:
    with RawStream(server) as stuck:
        stuck.link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        wait_for(lambda: server.num_clients == 2)
        large = bytes(8_000_000)
        reader = threading.Thread(target=lambda: [session.stream.receive() for _ in range(2)])
        reader.start()
        # An encrypted connection buffers the first one whole.
        for sequence in (500, 501):
            sent = server.report()[-1]["sent"]
            server.publish(large, sequence=sequence, captured_ns=time.time_ns())
            wait_for(lambda: server.report()[-1]["sent"] > sent)  # noqa: B023
        refused(server, "client takes no frames")
        reader.join(10.0)
        for sequence in (500, 501):
            session.stream.send(ack(sequence))
    wait_for(lambda: server.num_clients == 1)


def test_latencies_are_those_of_acknowledged_frames(server: LocalServer) -> None:
    session = Session(server)
    for _ in range(5):
        session.check()
    wait_for(lambda: server.report()[-1]["acknowledged"] == 5)
    report = server.report()[-1]
    assert report["round_trip_ms"] is not None
    assert 0.0 < report["round_trip_ms"][0] <= report["round_trip_ms"][1] < 1000.0
    assert report["latency_ms"] is None  # this client told no times
    session.stream.close()
    wait_for(lambda: server.num_clients == 0)
    assert server.report()[-1]["sent"] == 5  # of a stream that is over


# --- beginning and end ----------------------------------------------------------------------------


def test_stop_says_goodbye_and_may_come_twice(server: LocalServer) -> None:
    stream = RawStream(server)
    wait_for(lambda: server.num_clients == 1)
    begin = time.monotonic()
    server.stop()
    server.stop()
    assert time.monotonic() - begin < 5.0
    assert stream.close_code() in (1001, -1)
    stream.close()
    server.publish(b"x", sequence=1, captured_ns=0)  # nobody is there, and nothing happens
    with pytest.raises(ConnectionError):
        connect(server)


def test_a_taken_port_is_named(server: LocalServer) -> None:
    with pytest.raises(DeviceError, match=str(server.port)):
        LocalServer(PAGES, acknowledge, port=server.port).start()


@pytest.mark.parametrize(
    ("host", "message"),
    [
        ("192.168.1.2", "needs a certificate"),
        ("0.0.0.0", "address of one network interface"),
        ("::", "address of one network interface"),
        ("fe80::1", "address that browsers can open"),
        ("fe80::1%eth0", "address that browsers can open"),
        ("::1%lo", "address that browsers can open"),
        ("example.org", "expected an address"),
        ("", "expected"),
    ],
)
def test_other_hosts_are_not_served_in_the_clear(host: str, message: str) -> None:
    with pytest.raises(InputError, match=f"host: .*{message}"):
        LocalServer(PAGES, acknowledge, host=host)


def test_tokens_differ_and_are_long(server: LocalServer) -> None:
    other = LocalServer(PAGES, acknowledge)
    tokens = {each.new_url().partition("token=")[2] for each in (server, server, other)}
    assert len(tokens) == 3
    assert all(len(token) == 43 for token in tokens)  # 256 bits
    assert all(token not in repr(other) for token in tokens)


# --- messages -------------------------------------------------------------------------------------

TYPES = {
    "ack": {"sequence": Kind(int, 0, 99), "decoded_ms": Kind(float, 0, 1e15)},
    "game": {"name": Kind(str, choices=("bubbles", "piano"))},
    "stop": {},
}


def test_messages_are_read() -> None:
    assert read_message('{"type":"stop"}', TYPES) == ("stop", {})
    assert read_message('{"name":"piano","type":"game"}', TYPES) == ("game", {"name": "piano"})
    kind, fields = read_message('{"type":"ack","sequence":0,"decoded_ms":3}', TYPES)
    assert (kind, fields) == ("ack", {"sequence": 0, "decoded_ms": 3.0})
    assert isinstance(fields["decoded_ms"], float)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "expected JSON"),
        ("[" * 1024, "expected JSON"),
        ("7", "expected an object, got int"),
        ("{}", "type: expected one of ack, game, stop"),
        ('{"type":["stop"]}', "type: expected one of"),
        ('{"type":"stop","type":"stop"}', "message: expected each key of an object once"),
        ('{"type":"stop","more":1}', "stop: expected no fields, got more"),
        ('{"type":"ack","sequence":1}', "ack: expected sequence, decoded_ms, got sequence"),
        ('{"type":"ack","sequence":true,"decoded_ms":1}', "sequence: expected int, got bool"),
        ('{"type":"ack","sequence":1.0,"decoded_ms":1}', "sequence: expected int, got float"),
        ('{"type":"ack","sequence":-1,"decoded_ms":1}', "sequence: expected 0 to 99"),
        ('{"type":"ack","sequence":1' + "0" * 400 + ',"decoded_ms":1}', "sequence: expected 0"),
        ('{"type":"ack","sequence":1,"decoded_ms":NaN}', "expected numbers, got NaN"),
        ('{"type":"ack","sequence":1,"decoded_ms":1e999}', "decoded_ms: expected 0 to"),
        ('{"type":"game","name":"chess"}', "name: expected one of bubbles, piano"),
        ('{"type":"stop"}' + " " * 2048, "at most 2048 characters"),
    ],
)
def test_other_messages_are_refused(text: str, reason: str) -> None:
    with pytest.raises(FormatError, match=reason):
        read_message(text, TYPES)


def test_texts_for_one_client_come_in_order_and_before_frames() -> None:
    def echo(client: StreamClient, text: str) -> None:
        for number in range(3):
            client.say(f"{text} {number}")

    with LocalServer(PAGES, echo) as server, RawStream(server) as one, RawStream(server) as other:
        one.send(b"here")
        assert [one.receive() for _ in range(3)] == [(1, b"here %d" % n) for n in range(3)]
        server.publish(b"frame", sequence=1, captured_ns=time.time_ns())
        assert other.receive() == (2, b"frame")  # and no text before it


def test_the_address_is_written_as_browsers_do() -> None:
    server = LocalServer(PAGES, acknowledge, host="0:0:0:0:0:0:0:1", port=8000)
    assert (server.host, server.origin) == ("::1", "http://[::1]:8000")


def test_a_page_at_an_ipv6_address_may_open_its_stream() -> None:
    """The page's policy says 'self', because browsers refuse ``ws://[::1]:8000`` in a policy."""
    policy = LocalServer(PAGES, acknowledge, host="::1")._headers()["Content-Security-Policy"]
    assert "; connect-src 'self'; base-uri" in policy


def test_a_page_may_be_a_file_that_is_written_later(tmp_path: Path) -> None:
    file = tmp_path / "clip.webm"
    pages = PAGES | {"/clip": Page("video/webm", file)}
    with LocalServer(pages, acknowledge) as server:
        visitor = {"Cookie": cookie(server)}
        assert get(server, "/clip", visitor)[0] == 404
        file.write_bytes(b"0123456789")
        status, head, body = get(server, "/clip", visitor)
        assert (status, body) == (200, b"0123456789")
        assert "Content-Type: video/webm" in head
        assert "Content-Security-Policy" in head
        status, _, body = get(server, "/clip", visitor | {"Range": "bytes=2-4"})
        assert (status, body) == (206, b"234")
        assert get(server, "/clip")[0] == 403  # without a session
        file.unlink()
        file.mkdir()
        assert get(server, "/clip", visitor)[0] == 404


def test_a_compressed_file_of_the_same_name_is_not_sent_in_place_of_a_page(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"0123456789")
    (tmp_path / "a.png.gz").write_bytes(gzip.compress(b"something else"))
    pages = PAGES | {"/a.png": Page("image/png", tmp_path / "a.png")}
    with LocalServer(pages, acknowledge) as server:
        visitor = {"Cookie": cookie(server), "Accept-Encoding": "gzip, br"}
        status, head, body = get(server, "/a.png", visitor)
        assert (status, body) == (200, b"0123456789")
        assert "Content-Encoding" not in head
        status, _, body = get(server, "/a.png", visitor | {"Range": "bytes=2-4"})
        assert (status, body) == (206, b"234")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("message_bytes", 0),  # aiohttp takes it for no limit
        ("request_seconds", float("nan")),
        ("send_seconds", float("inf")),
        ("requests_per_second", 0.0),
        ("message_burst", 0.5),  # nothing would ever be let through
        ("streams", -1),
        ("frames_in_flight", 0),
    ],
)
def test_limits_that_are_none_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"{name}: expected a finite number"):
        Limits(**{name: value})  # type: ignore[arg-type]


def test_free_texts_are_bounded_and_plain() -> None:
    types = {"note": {"text": Kind(str, length=5)}}

    def read(text: str) -> object:
        return read_message(json.dumps({"type": "note", "text": text}), types)[1]["text"]

    assert read("a\nö😀") == "a\nö😀"
    for wrong in ("sixsix", "a\x00", "\x1b[1m", "\ud800"):
        with pytest.raises(FormatError, match="text: expected"):
            read(wrong)
    with pytest.raises(FormatError, match="expected a text, got int"):
        read_message('{"type": "note", "text": 7}', types)
    with pytest.raises(FormatError, match="at most 9 characters"):
        read_message('{"type": "note", "text": ""}', types, max_length=9)


def test_a_page_may_load_what_its_server_has_and_nothing_else() -> None:
    def policy(*types: str) -> str:
        pages = PAGES | {f"/{n}": Page(kind, b"") for n, kind in enumerate(types)}
        with LocalServer(pages, acknowledge) as server:
            _, head, _ = get(server, "/", {"Cookie": cookie(server)})
        (line,) = (line for line in head.splitlines() if line.startswith("Content-Security"))
        return line

    plain = policy()
    assert "default-src 'none'; script-src 'self'; style-src 'self'; img-src blob:; conn" in plain
    assert "connect-src 'self' ws://127.0.0.1:" in plain
    rich = policy("image/png", "video/webm", "model/gltf-binary")
    assert "img-src 'self' blob:; media-src 'self'; connect-src 'self' blob: ws://" in rich
    for wide in ("*", "unsafe", "data:", "https:"):
        assert wide not in plain + rich
