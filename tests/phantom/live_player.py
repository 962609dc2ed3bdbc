"""A client of `manip3d phantom live` without a browser: takes frames, acknowledges, plays."""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "serve"))

from raw_client import RawStream


class Player:
    """Reads frames in a thread of its own until the connection ends.

    ``acknowledges``: a client that does not is one that hangs. ``cookie``: of another client, as a
    page has that is loaded again.
    """

    def __init__(self, url: str, *, acknowledges: bool = True, cookie: str | None = None) -> None:
        origin, _, query = url.partition("/?")
        host, _, port = origin.partition("://")[2].rpartition(":")
        server = SimpleNamespace(
            host=host, port=int(port), origin=origin, certificate=None,
            new_url=lambda: f"{origin}/?{query}",
        )  # fmt: skip
        self.stream = RawStream(server, {"Cookie": cookie} if cookie else None)  # type: ignore[arg-type]
        assert self.stream.status == 101, self.stream.status
        self.stream.link.settimeout(60.0)
        self.status: dict[str, Any] = {}
        self.messages: list[str] = []
        self.sequences: list[int] = []
        self.latency_ms: list[float] = []
        self.captured_ms = 0.0  # time of the last frame
        self.is_open = True
        self._acknowledges = acknowledges
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def say(self, name: str, **fields: Any) -> None:
        self.stream.send(json.dumps({"type": name, **fields}).encode())

    def wait(self, condition: Any, seconds: float = 60.0) -> None:
        """Wait until a condition on the status holds."""
        end = time.monotonic() + seconds
        while not (self.status and condition(self.status)):
            assert time.monotonic() < end, self.status.get("message")
            assert self.is_open, "the connection ended"
            time.sleep(0.01)

    def close(self) -> None:
        self.stream.close()
        self._thread.join(10.0)

    def _read(self) -> None:
        try:
            while True:
                opcode, content = self.stream.receive()
                if opcode == 2:
                    self._take(content)
                elif opcode == 9:
                    self.stream.send(content, opcode=10)
                elif opcode in (8, -1):
                    break
        except OSError:
            pass
        self.is_open = False

    def _take(self, content: bytes) -> None:
        sequence = int.from_bytes(content[8:12], "little")
        self.captured_ms = int.from_bytes(content[24:32], "little") / 1e6
        size = int.from_bytes(content[80:84], "little")
        self.status = json.loads(content[-size:])
        self.sequences.append(sequence)
        if self.messages[-1:] != [self.status["message"]]:
            self.messages.append(self.status["message"])
        now = time.time_ns() / 1e6
        self.latency_ms.append(now - self.captured_ms)
        del self.sequences[:-2000], self.latency_ms[:-2000], self.messages[:-200]
        if self._acknowledges:
            self.say("ack", sequence=sequence, decoded_ms=now)
