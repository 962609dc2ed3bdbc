"""`LocalServer`: a web server with a stream of frames, for this machine or (by HTTPS) its network.

A *stranger* is a client without the server's cookie, a *stream* a WebSocket connection to
``/stream``.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import functools
import hashlib
import hmac
import logging
import math
import secrets
import threading
import time
import weakref
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.texts import counted
from manip3d.errors import DeviceError, FormatError, InputError
from manip3d.serve._certificate import Certificate, address_of

if TYPE_CHECKING:
    from aiohttp import web

    _Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

LOG = logging.getLogger("manip3d.serve")

START_SECONDS = 10.0
"""Seconds within which a server must be ready, or have stopped."""
GOODBYE_SECONDS = 0.5
"""Seconds for which a closing encrypted connection waits for the client's closing message."""
_HISTORY = 1000  # latencies kept per client: half a minute at 30 frames a second
_MAX_REASONS = 64  # different reasons in `LocalServer.refused`; further ones are "other reasons"
_MAX_REASON_BYTES = 200  # a reason may quote a client, who can send long texts
_HANDSHAKE_LOOKS = 100
"""Number of times that a connection is looked at during its TLS handshake, within the time limit of
a request. One too many thus stays for at most a hundredth of that limit after its handshake."""
CODE_SECONDS = 120.0
"""Seconds for which a code of `LocalServer.new_code` is valid."""
_CODE_ATTEMPTS = 5  # wrong codes, from all strangers together, after which a code is void
_ICON = "/favicon.ico"  # browsers ask for it unless the page names an icon
_MAX_CLOCK_SKEW_MS = 60_000.0  # a page whose clock is farther off is on another machine


class _RequestLog(logging.Handler):
    """Counts malformed requests, and passes aiohttp's other warnings to this module's log."""

    def __init__(self, refuse: Callable[[str], None]) -> None:
        super().__init__()
        self._refuse = refuse

    def emit(self, record: logging.LogRecord) -> None:
        from aiohttp.http_exceptions import HttpProcessingError

        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, HttpProcessingError):
            self._refuse("malformed request")
        elif record.levelno >= logging.WARNING:
            LOG.handle(record)


def _request_log(refuse: Callable[[str], None]) -> logging.Logger:
    """Return a logger for aiohttp that prints no traceback for each malformed request."""
    log = logging.Logger("manip3d.serve.requests", logging.DEBUG)
    log.addHandler(_RequestLog(refuse))
    return log


@checked
@dataclass(frozen=True)
class Limits:
    """Limits on the resources of one client: rates and times above 0, all others at least 1.

    Attributes
    ----------
    message_bytes : int
        Largest message of a client. A client that sends a larger one is disconnected before the
        message is read.
    messages_per_second, message_burst : float
        Messages of one client: average rate, and number at once.
    requests_per_second, request_burst : float
        Requests of all clients together: average rate, and number at once.
    connections, streams : int
        Largest numbers of connections and streams that are open at the same time.
    request_seconds : float
        Time within which a connection must have sent a complete request.
    send_seconds : float
        Time after which a client that accepts no bytes is disconnected.
    frames_in_flight : int
        Largest number of frames that are sent to a client without an acknowledgement. Until one
        arrives, each new frame replaces the one that waits to be sent.

    Raises
    ------
    InputError
        A number is out of range.
    """

    message_bytes: int = 4096
    messages_per_second: float = 120.0
    message_burst: float = 240.0
    requests_per_second: float = 50.0
    request_burst: float = 100.0
    connections: int = 64
    streams: int = 8
    request_seconds: float = 5.0
    send_seconds: float = 10.0
    frames_in_flight: int = 2

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            is_of_time = name.endswith(("_second", "_seconds"))
            if not (math.isfinite(value) and (value > 0 if is_of_time else value >= 1)):
                expected = "> 0" if is_of_time else ">= 1"
                raise InputError(f"{name}: expected a finite number {expected}, got {value}")


@dataclass(frozen=True)
class Page:
    """A resource of the server.

    Attributes
    ----------
    type : str
        Media type, such as ``text/html; charset=utf-8``.
    content : bytes or Path
        The content, or a file that is read at each request; it may be written while the server
        runs.
    """

    type: str
    content: bytes | Path = field(repr=False)


_JOIN_STYLE = (
    "body{font:1.5rem system-ui,sans-serif;max-width:30rem;margin:3rem auto;padding:0 1rem;"
    "background:#171b22;color:#f1f4f8}input,button{font:inherit;padding:.4rem}"
)
_JOIN_PAGE = f"""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Add a screen</title>
<style>{_JOIN_STYLE}</style>
</head>
<body>
<main>
<h1>Add a screen</h1>
<form action="/" method="get">
<p><label for="code">The 8 digits that the first screen shows</label></p>
<p><input id="code" name="code" required autofocus inputmode="numeric" autocomplete="off"
 maxlength="9" pattern="[0-9]{{4}} ?[0-9]{{4}}"> <button>Open</button></p>
</form>
</main>
</body>
</html>
"""
_JOIN_HASH = base64.b64encode(hashlib.sha256(_JOIN_STYLE.encode()).digest()).decode()


@dataclass
class _Code:
    digits: str
    due: float
    attempts: int = _CODE_ATTEMPTS


class _Bucket:
    """A token bucket: a rate with a burst."""

    def __init__(self, rate: float, burst: float) -> None:
        self._rate, self._burst = rate, burst
        self._left, self._time = burst, time.monotonic()

    def take(self) -> bool:
        """Take a token; return False if there is none, which means that the rate is exceeded."""
        now = time.monotonic()
        self._left = min(self._burst, self._left + (now - self._time) * self._rate)
        self._time = now
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


@dataclass(frozen=True)
class _Frame:
    content: bytes
    sequence: int
    captured_ns: int


class StreamClient:
    """One open stream. Only the newest frame waits to be sent; older ones are dropped and counted.

    Attributes
    ----------
    number : int
        Number of the stream among those of the server, from 1.
    sent, dropped, acknowledged, unreadable : int
        Numbers of frames; unreadable ones could not be decoded by the client.
    """

    def __init__(self, number: int, frames_in_flight: int) -> None:
        self.number = number
        self.sent = 0
        self.dropped = 0
        self.acknowledged = 0
        self.unreadable = 0
        self._window = frames_in_flight
        self._next: _Frame | None = None
        self._loop = asyncio.get_running_loop()
        self._texts: deque[str] = deque()
        self._in_flight: dict[int, int] = {}  # sequence number -> time of capture, nanoseconds
        self._changed = asyncio.Event()
        self._latencies: deque[float] = deque(maxlen=_HISTORY)
        self._round_trips: deque[float] = deque(maxlen=_HISTORY)

    def acknowledge(self, sequence: int, decoded_ms: float | None = None) -> None:
        """Note that the client has decoded a frame.

        Parameters
        ----------
        sequence : int
            Number of the frame.
        decoded_ms : float, optional
            Time of decoding in milliseconds since 1970, by the client's clock. If client and server
            are on one machine, this gives the latency without the way back of the acknowledgement.

        Raises
        ------
        FormatError
            The frame was never sent, or is acknowledged already.
        """
        captured_ns = self._in_flight.pop(sequence, None)
        if captured_ns is None:
            raise FormatError(f"sequence: expected a frame in flight, got {sequence}")
        self.acknowledged += 1
        self._round_trips.append((time.time_ns() - captured_ns) / 1e6)
        if decoded_ms is not None and abs(decoded_ms - captured_ns / 1e6) < _MAX_CLOCK_SKEW_MS:
            self._latencies.append(decoded_ms - captured_ns / 1e6)
        self._changed.set()

    def fail(self) -> None:
        """Note that the client could not decode the oldest frame in flight; it gets further ones.

        Raises
        ------
        FormatError
            No frame is in flight.
        """
        if not self._in_flight:
            raise FormatError("bad: expected a frame in flight, but there is none")
        del self._in_flight[next(iter(self._in_flight))]
        self.unreadable += 1
        self._changed.set()

    def say(self, text: str) -> None:
        """Send a text message to this client; may be called from any thread.

        Parameters
        ----------
        text : str
            Content of the message.

        Notes
        -----
        Texts are sent in order, before waiting frames, and are never dropped. A client that accepts
        no bytes is disconnected, and texts that wait for it are lost.
        """
        with contextlib.suppress(RuntimeError):  # the server has stopped in the meantime
            self._loop.call_soon_threadsafe(self._add, text)

    def _add(self, text: str) -> None:
        self._texts.append(text)
        self._changed.set()

    def report(self) -> dict[str, Any]:
        """Return numbers of frames, and percentiles 50 and 95 of latencies in milliseconds.

        Both latencies start when the frame was captured. ``latency_ms`` ends when the page had
        decoded it, by the page's clock; ``round_trip_ms`` ends when the acknowledgement arrived.
        """
        return {
            "sent": self.sent,
            "dropped": self.dropped,
            "acknowledged": self.acknowledged,
            "unreadable": self.unreadable,
            "latency_ms": _percentiles(self._latencies),
            "round_trip_ms": _percentiles(self._round_trips),
        }

    def _offer(self, frame: _Frame) -> None:
        self.dropped += self._next is not None
        self._next = frame
        self._changed.set()

    async def _take(self) -> _Frame | str:
        while not self._texts and (self._next is None or len(self._in_flight) >= self._window):
            self._changed.clear()
            await self._changed.wait()
        if self._texts:
            return self._texts.popleft()
        assert self._next is not None
        frame, self._next = self._next, None
        self._in_flight[frame.sequence] = frame.captured_ns
        self.sent += 1
        return frame


def _percentiles(values: deque[float]) -> tuple[float, float] | None:
    if not values:
        return None
    middle, high = np.percentile(list(values), [50.0, 95.0])
    return round(float(middle), 2), round(float(high), 2)


@checked
class LocalServer:
    """Serve pages and a stream of frames to browsers on this machine or, by HTTPS, on its network.

    A browser that opens an address of `new_url`, or enters a code of `new_code`, gets a cookie and
    is admitted. All others, also pages of other origins in the same browser, are refused, counted
    in `refused` and logged. A client that reads slowly, sends nothing, sends too much or sends
    invalid data affects neither the other clients nor the publisher of frames.

    Parameters
    ----------
    pages : mapping of str to Page
        Resources by path; ``/`` is the page that a browser opens.
    on_message : callable(StreamClient, str)
        Is called with each message of a client, in the server's thread. If it raises `FormatError`,
        the client is disconnected.
    host : str
        A loopback address; with a certificate also another address of this machine, which other
        machines can reach.
    port : int
        Port to listen on; 0: a free one.
    limits : Limits
        Limits on the resources of clients.
    certificate : Certificate, optional
        Certificate for ``host``; with it the server speaks HTTPS.

    Raises
    ------
    InputError
        ``host`` is not a loopback address and there is no certificate; the certificate is for
        another host; ``port`` is out of range.
    MissingExtraError
        aiohttp is not installed.

    Notes
    -----
    Each connection serves one request, which must be complete within ``limits.request_seconds``, so
    that slow clients cannot occupy all connections. A request for ``/stream`` must name the
    server's own origin. GET is the only method, and request bodies are not read.
    """

    def __init__(
        self,
        pages: Mapping[str, Page],
        on_message: Callable[[StreamClient, str], None],
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        limits: Limits | None = None,
        certificate: Certificate | None = None,
    ) -> None:
        imported("aiohttp", "live")
        address = address_of(host)
        if certificate is None and not address.is_loopback:
            raise InputError(
                f"host: expected a loopback address such as 127.0.0.1, got {host!r}; another one "
                "needs a certificate, so that the connection is encrypted"
            )
        if certificate is not None and certificate.host != str(address):
            raise InputError(f"certificate: expected one for {host}, got {certificate.host}")
        if not 0 <= port <= 65535:
            raise InputError(f"port: expected 0 to 65535, got {port}")
        self.limits = limits or Limits()
        self.host, self.port = str(address), port  # as browsers write it in the Host header
        self.certificate = certificate
        self.refused: Counter[str] = Counter()
        self._pages = dict(pages)
        self._on_message = on_message
        self._tokens: set[str] = set()  # unused ones; each admits one browser, once
        self._code: _Code | None = None
        self._cookie = secrets.token_urlsafe(32)
        self._clients: dict[int, tuple[StreamClient, web.WebSocketResponse]] = {}
        self._finished: list[dict[str, Any]] = []
        self._opened = 0
        self._opening = 0  # streams whose handshake is under way
        self._transports: weakref.WeakSet[asyncio.BaseTransport] = weakref.WeakSet()
        # Connections that have sent a complete request.
        self._heard: weakref.WeakSet[asyncio.BaseTransport] = weakref.WeakSet()
        # Two rates, so that strangers cannot use up the requests of admitted browsers.
        self._requests, self._strangers = (
            _Bucket(self.limits.requests_per_second, self.limits.request_burst) for _ in range(2)
        )
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stopping: asyncio.Event | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        streams = counted(self.num_clients, "stream")
        return f"<manip3d.serve.LocalServer: {self.host}:{self.port}, {streams}>"

    # --- from any thread -------------------------------------------------------------------------

    def new_url(self) -> str:
        """Make an address that admits one browser, once; whoever opens it may watch and steer."""
        token = secrets.token_urlsafe(32)
        with self._lock:
            self._tokens.add(token)
        return f"{self.origin}/?token={token}"

    def new_code(self) -> str:
        """Make a short code that admits one more browser, for people to type on another screen.

        It is entered at ``/join``, and is valid once and for `CODE_SECONDS`. It replaces the
        previous code, and is void after five wrong attempts.

        Returns
        -------
        str
            Eight digits.
        """
        digits = f"{secrets.randbelow(10**8):08d}"
        with self._lock:
            self._code = _Code(digits, time.monotonic() + CODE_SECONDS)
        return digits

    @property
    def origin(self) -> str:
        """Scheme, host and port."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        scheme, usual = ("https", 443) if self.certificate else ("http", 80)
        return f"{scheme}://{host}" + ("" if self.port == usual else f":{self.port}")

    def start(self) -> Self:
        """Start the server in a thread of its own; return when it accepts connections.

        Returns
        -------
        LocalServer
            This server.

        Raises
        ------
        InputError
            The server was started before.
        DeviceError
            The port is in use; the server is not ready within ten seconds.
        """
        ready = threading.Event()
        failed: list[BaseException] = []

        def run() -> None:
            try:
                asyncio.run(self._serve(ready))
            except BaseException as error:
                failed.append(error)
            finally:
                ready.set()

        with self._lock:
            if self._thread is not None:
                raise InputError("server: expected a server that was not started yet")
            self._thread = threading.Thread(target=run, name="manip3d-serve", daemon=True)
            self._thread.start()
        is_ready = ready.wait(START_SECONDS)
        if failed:
            raise DeviceError(f"{self.origin}: {failed[0]}") from failed[0]
        if not is_ready:
            self.stop()
            raise DeviceError(f"{self.origin}: not ready within {START_SECONDS:g} s")
        return self

    def stop(self) -> None:
        """Close all streams and stop listening; may be called twice."""
        loop, stopping, thread = self._loop, self._stopping, self._thread
        if loop is not None and stopping is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(stopping.set)
        if thread is not None and thread is not threading.current_thread():
            thread.join(START_SECONDS)

    def publish(self, content: bytes, *, sequence: int, captured_ns: int) -> None:
        """Offer a frame to all clients, without waiting for any of them.

        Parameters
        ----------
        content : bytes
            Content of the binary message.
        sequence : int
            Number of the frame, by which clients acknowledge it.
        captured_ns : int
            Time at which the frame was captured, by `time.time_ns`.
        """
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(self._broadcast, _Frame(content, sequence, captured_ns))

    @property
    def num_clients(self) -> int:
        """Number of open streams."""
        return len(self._clients)

    def report(self) -> list[dict[str, Any]]:
        """Return `StreamClient.report` of each stream so far, the open ones last."""
        with self._lock:
            open_now = [client.report() for client, _ in tuple(self._clients.values())]
            return [*self._finished, *open_now]

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    # --- in the server's thread ------------------------------------------------------------------

    def _broadcast(self, frame: _Frame) -> None:
        for client, _ in self._clients.values():
            client._offer(frame)

    async def _serve(self, ready: threading.Event) -> None:
        """Serve pages and streams until the session is told to stop, then close all connections."""
        from aiohttp import web

        @web.middleware
        async def guard(request: web.Request, handler: _Handler) -> web.StreamResponse:
            return await self._guard(request, handler)

        app = web.Application(middlewares=[guard])
        for path in self._pages:
            app.router.add_get(path, self._page, allow_head=False)
        app.router.add_get("/stream", self._stream, allow_head=False)
        app.router.add_get("/join", self._join, allow_head=False)
        if _ICON not in self._pages:
            app.router.add_get(_ICON, self._no_icon, allow_head=False)
        runner = web.AppRunner(
            app, access_log=None, logger=_request_log(self._refuse), handle_signals=False,
            lingering_time=1.0, shutdown_timeout=1.0,
        )  # fmt: skip
        await runner.setup()
        loop = asyncio.get_running_loop()
        accept = runner.server
        assert accept is not None

        def connected() -> asyncio.Protocol:
            protocol = accept()
            # asyncio sets the transport after this call; it is available two loop iterations later.
            loop.call_soon(lambda: loop.call_soon(self._admit, protocol))
            loop.call_later(self.limits.request_seconds, self._drop_if_silent, protocol)
            return protocol

        encryption: dict[str, Any] = {}
        if self.certificate is not None:
            encryption = {
                "ssl": self.certificate.context(),
                "ssl_handshake_timeout": self.limits.request_seconds,
                "ssl_shutdown_timeout": GOODBYE_SECONDS,
            }
        try:
            listener = await loop.create_server(
                connected, self.host, self.port, backlog=64, **encryption
            )
            self.port = listener.sockets[0].getsockname()[1]
            self._loop, self._stopping = loop, asyncio.Event()
            ready.set()
            await self._stopping.wait()
            listener.close()
            for _, stream in tuple(self._clients.values()):
                with contextlib.suppress(Exception):
                    await asyncio.wait_for(stream.close(code=1001, message=b"session ended"), 1.0)
        finally:
            self._loop = None
            await runner.cleanup()
            if encryption:
                # Encrypted connections wait this long for the client's closing message before they
                # close their sockets, for which the loop must still run.
                await asyncio.sleep(GOODBYE_SECONDS + 0.1)

    def _admit(self, protocol: Any, looks: int = _HANDSHAKE_LOOKS) -> None:
        """Close a new connection at once if there are too many."""
        transport = protocol.transport
        if transport is None:
            if self.certificate is not None and looks > 0:  # set after the TLS handshake
                later = self.limits.request_seconds / _HANDSHAKE_LOOKS
                asyncio.get_running_loop().call_later(later, self._admit, protocol, looks - 1)
            return
        self._transports.add(transport)
        if sum(not t.is_closing() for t in self._transports) > self.limits.connections:
            self._refuse("too many connections")
            transport.abort()

    def _drop_if_silent(self, protocol: Any) -> None:
        """Close a connection that has not sent a complete request within the time limit."""
        transport = protocol.transport
        if transport is not None and transport not in self._heard:
            self._refuse("request too slow")
            transport.abort()

    def _refuse(self, reason: str) -> None:
        counted = _cut(reason, _MAX_REASON_BYTES).decode()
        if counted not in self.refused and len(self.refused) >= _MAX_REASONS:
            counted = "other reasons"  # some reasons quote clients, who could fill the memory
        self.refused[counted] += 1
        LOG.warning("refused: %s", counted)

    async def _guard(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        from aiohttp import web

        if request.transport is not None:
            self._heard.add(request.transport)
        refusal = self._refusal(request)
        if refusal is not None:
            status, reason = refusal
            self._refuse(reason)
            response: web.StreamResponse = web.Response(status=status, text=f"{reason}\n")
        else:
            try:
                response = await handler(request)
            except web.HTTPException as error:  # no such path, or another method
                self._refuse(error.reason.lower())
                response = web.Response(status=error.status, text=f"{error.reason.lower()}\n")
        if not response.prepared:
            for name, value in self._headers().items():
                response.headers.setdefault(name, value)
            response.force_close()
        return response

    async def _no_icon(self, request: web.Request) -> web.StreamResponse:
        from aiohttp import web

        return web.Response(status=204)

    def _headers(self) -> dict[str, str]:
        # 'self' includes the stream, except in Safari before 15.4. A policy cannot name an IPv6
        # address.
        is_ipv6 = ":" in self.host
        stream = "" if is_ipv6 else " " + self.origin.replace("http", "ws", 1) + "/stream"
        kinds = {page.type.partition("/")[0] for page in self._pages.values()}
        images = "'self' blob:" if "image" in kinds else "blob:"
        videos = "media-src 'self'; " if "video" in kinds else ""
        files = " blob:" if "model" in kinds else ""
        return {
            "Content-Security-Policy": (
                f"default-src 'none'; script-src 'self'; style-src 'self'; img-src {images}; "
                f"{videos}connect-src 'self'{files}{stream}; base-uri 'none'; "
                "form-action 'none'; frame-ancestors 'none'"
            ),
            "Cache-Control": "no-store",
            "Cross-Origin-Opener-Policy": "same-origin",
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }

    def _refusal(self, request: web.Request) -> tuple[int, str] | None:
        """Return status and reason if a request is refused, else None."""
        is_known = _equal_in_constant_time(request.cookies.get(self._cookie_name, ""), self._cookie)
        if not (self._requests if is_known else self._strangers).take():
            return 429, "too many requests"
        own = self.origin.partition("//")[2]
        if request.headers.getall("Host", []) != [own]:  # DNS rebinding
            return 403, "foreign host"
        if any(origin != self.origin for origin in request.headers.getall("Origin", [])):
            return 403, "foreign origin"
        if request.method != "GET":
            return 405, "method not allowed"
        if not is_known and request.path == "/join" and self._open_code() is not None:
            return None
        code = request.query.get("code")
        if not is_known and request.path == "/" and code is not None:
            return None if self._redeem_code(code) else (403, "wrong code, or one that is over")
        token = request.query.get("token")
        if request.path == "/" and token is not None:
            if self._redeem_token(token) or is_known:
                return None
            return 403, (
                "wrong token: an address lets in one browser, once. Go on in that browser, or "
                "start 'manip3d' anew"
            )
        return None if is_known else (403, "no session: open the address that 'manip3d' printed")

    def _redeem_token(self, token: str) -> bool:
        """Return whether a token is valid; it is not valid again."""
        with self._lock:
            found = [kept for kept in self._tokens if _equal_in_constant_time(token, kept)]
            self._tokens.difference_update(found)
        return bool(found)

    def _open_code(self) -> _Code | None:
        """Return the code that is valid now, if any."""
        code = self._code
        return code if code is not None and time.monotonic() < code.due else None

    def _redeem_code(self, given: str) -> bool:
        """Return whether a code is valid; it is not valid again, nor after too many wrong ones."""
        with self._lock:
            code = self._open_code()
            if code is None:
                return False
            is_right = _equal_in_constant_time(given.replace(" ", ""), code.digits)
            code.attempts -= 1
            if is_right or code.attempts <= 0:
                self._code = None
        return is_right

    async def _join(self, request: web.Request) -> web.StreamResponse:
        """Return the page for entering a code: a single file, as strangers may load no other."""
        from aiohttp import web

        policy = (
            f"default-src 'none'; style-src 'sha256-{_JOIN_HASH}'; base-uri 'none'; "
            "form-action 'self'; frame-ancestors 'none'"
        )
        headers = {"Content-Security-Policy": policy}
        return web.Response(text=_JOIN_PAGE, content_type="text/html", headers=headers)

    @property
    def _cookie_name(self) -> str:
        return f"manip3d-{self.port}"  # browsers share cookies among all ports of a host

    async def _page(self, request: web.Request) -> web.StreamResponse:
        from aiohttp import web

        if request.path == "/" and not {"token", "code"}.isdisjoint(request.query):
            # A redirect, so that the token or code is not in the address bar and the history.
            moved = web.Response(status=303, headers={"Location": "/"})
            moved.set_cookie(
                self._cookie_name,
                self._cookie,
                httponly=True,
                samesite="Strict",
                secure=self.certificate is not None,
            )
            return moved
        page = self._pages[request.path]
        headers = {"Content-Type": page.type}
        if isinstance(page.content, bytes):
            return web.Response(body=page.content, headers=headers)
        if not page.content.is_file():
            raise web.HTTPNotFound
        return _whole_file()(page.content, headers=headers)

    async def _stream(self, request: web.Request) -> web.StreamResponse:
        from aiohttp import web

        if "Origin" not in request.headers:  # a browser always names it
            self._refuse("foreign origin")
            return web.Response(status=403, text="foreign origin\n")
        if len(self._clients) + self._opening >= self.limits.streams:
            self._refuse("too many streams")
            return web.Response(status=503, text="too many streams\n")
        stream = web.WebSocketResponse(
            max_msg_size=self.limits.message_bytes, compress=False, heartbeat=15.0, timeout=2.0
        )
        self._opening += 1  # counts for the limit of other streams during the handshake
        try:
            await stream.prepare(request)
        finally:
            self._opening -= 1
        self._opened += 1
        client = StreamClient(self._opened, self.limits.frames_in_flight)
        self._clients[client.number] = client, stream
        sender = asyncio.create_task(self._send(client, stream, request.transport))
        try:
            await self._receive(client, stream)
        finally:
            sender.cancel()
            with self._lock:  # report() must see the stream either as open or as finished
                del self._clients[client.number]
                self._finished = [*self._finished, client.report()][-100:]
            with contextlib.suppress(asyncio.CancelledError):
                await sender
        return stream

    async def _send(
        self,
        client: StreamClient,
        stream: web.WebSocketResponse,
        transport: asyncio.Transport | None,
    ) -> None:
        while True:
            taken = await client._take()
            sending: Coroutine[Any, Any, None]
            if isinstance(taken, str):
                sending = stream.send_str(taken)
            else:
                sending = stream.send_bytes(taken.content)
            try:
                await asyncio.wait_for(sending, self.limits.send_seconds)
            except TimeoutError:
                self._refuse("client takes no frames")
                if transport is not None:
                    transport.abort()
                return
            except ConnectionError:
                return

    async def _receive(self, client: StreamClient, stream: web.WebSocketResponse) -> None:
        from aiohttp import WebSocketError, WSMsgType

        bucket = _Bucket(self.limits.messages_per_second, self.limits.message_burst)
        async for message in stream:
            if message.type == WSMsgType.ERROR:
                continue  # closed by aiohttp; counted below
            reason = ""
            if not bucket.take():
                reason = "too many messages"
            elif message.type != WSMsgType.TEXT:
                reason = "message is not text"
            else:
                try:
                    self._on_message(client, message.data)
                except FormatError as error:
                    reason = f"bad message: {error}"
            if reason:
                self._refuse(reason)
                await stream.close(code=1008, message=_cut(reason, 100))
                return
        failure = stream.exception()
        if isinstance(failure, WebSocketError):  # others: the client has left
            self._refuse(f"bad frame: {failure}")


@functools.cache
def _whole_file() -> type[web.FileResponse]:
    """Return a response class that sends the file itself.

    `aiohttp.web.FileResponse` would send ``a.png.gz`` in place of ``a.png`` if it exists, whatever
    it holds.
    """
    from aiohttp import hdrs, web

    class WholeFile(web.FileResponse):
        async def prepare(self, request: web.BaseRequest) -> Any:
            headers = request.headers.copy()
            headers.popall(hdrs.ACCEPT_ENCODING, None)
            return await super().prepare(request.clone(headers=headers))

    return WholeFile


def _cut(text: str, most: int) -> bytes:
    """Return at most ``most`` bytes of UTF-8 that end between two characters."""
    whole = text.encode(errors="replace")[:most]
    return whole.decode(errors="ignore").encode()


def _equal_in_constant_time(given: str, kept: str) -> bool:
    return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), kept.encode())
