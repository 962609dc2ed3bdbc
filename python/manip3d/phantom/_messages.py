"""Queue of messages from pages, which arrive in any thread and are handled with the next frame."""

from __future__ import annotations

import functools
import queue
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from manip3d.errors import InputError
from manip3d.modify import Limb
from manip3d.phantom._felt import LIMITS
from manip3d.phantom._touch import MODES, STATEMENTS
from manip3d.phantom.games import GAMES
from manip3d.serve import Kind

MAX_GAIN = 2
"""Largest gain of virtual enhancement."""

LIMBS: Sequence[Limb] = ("left_arm", "right_arm", "left_leg", "right_leg")

_KEPT: dict[str, Kind] = {
    "page": Kind(int, 0, 2**32 - 1, optional=True),
    "number": Kind(int, 1, 2**31, optional=True),
}
"""Fields that a page adds to a message that must not be lost. The page repeats the message until
the answer ``heard`` arrives, and the session handles each number of a page once."""

MESSAGES: Mapping[str, Mapping[str, Kind]] = {
    "ack": {"sequence": Kind(int, 0, 2**32 - 1), "decoded_ms": Kind(float, 0, 1e15, optional=True)},
    "bad": {},
    "clock": {"sent_ms": Kind(float, 0, 1e15)},
    "screen": {},
    "choose": {"game": Kind(str, choices=tuple(GAMES)), "difficulty": Kind(int, 1, 3)},
    "ready": {},
    "stop": {},
    "enough": _KEPT,
    "unanswered": _KEPT,
    "again": {},
    "pain": {"value": Kind(int, 0, 10), **_KEPT},
    "unwell": _KEPT,
    "event": {"text": Kind(str, length=500), **_KEPT},
    "consent": {"clips": Kind(int, 0, 1), **_KEPT},
    "limb": {"limb": Kind(str, choices=LIMBS)},
    "patient": {"which": Kind(int, 1, 2**31)},
    "calibrate": {},
    "gain": {"value": Kind(float, 1, MAX_GAIN)},
    "touch": {"mode": Kind(str, choices=(*MODES, "off"))},
    "ownership": {"mode": Kind(str, choices=MODES)}
    | {f"q{number}": Kind(int, -3, 3) for number in range(1, len(STATEMENTS) + 1)}
    | _KEPT,
    "felt": {name: Kind(int, low, high) for name, (low, high) in LIMITS.items()} | _KEPT,
}
"""Names and fields of the messages that a page may send."""

NOT_LOST = tuple(name for name, fields in MESSAGES.items() if "number" in fields)
"""Messages that are handled even if the session ends before the next frame."""

CONNECTION_MESSAGES = ("ack", "bad", "clock", "screen")
"""Messages that `hear` handles itself; all others go to the session."""

Command = tuple[str, dict[str, Any], Callable[[], object] | None]
"""Name, fields, and a function to call when the message is written to the diary."""

_PAGES = 64  # pages whose last number is remembered


class Inbox:
    """Queue of messages; a message that a page repeats with the same number is queued once."""

    def __init__(self) -> None:
        self._commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self._entry = threading.Lock()
        self._is_closed = False
        self._heard: dict[int, int] = {}  # last number of each page, the page heard last at the end
        # Functions to call, by page and number, until the message is written; lost ones stay.
        self._waiting: dict[tuple[int, int], list[Callable[[], object]]] = {}

    def put(
        self, name: str, fields: Mapping[str, Any] | None, done: Callable[[], object] | None
    ) -> None:
        """Queue a message, from any thread; see `LiveSession.command`."""
        if name not in MESSAGES or name in CONNECTION_MESSAGES:
            expected = ", ".join(known for known in MESSAGES if known not in CONNECTION_MESSAGES)
            raise InputError(f"name: expected one of {expected}, got {name!r}")
        found = dict(fields or {})
        page, number = found.pop("page", 0), found.pop("number", None)
        with self._entry:
            if self._is_closed:
                return
            if number is None:
                self._commands.put((name, found, done))
                return
            is_new = number > self._heard.get(page, 0)
            if is_new:
                self._expect(page, number)
                kept = functools.partial(self._answer, page, number)
                self._commands.put((name, found, kept))
            waiting = self._waiting.get((page, number))
            if waiting is not None and done is not None:
                waiting.append(done)
        if waiting is None and done is not None:  # a repetition, because the answer was lost
            done()

    def close(self) -> None:
        """Refuse further messages."""
        with self._entry:
            self._is_closed = True

    def taken(self) -> Iterator[Command]:
        """Remove and return the queued messages, in order."""
        while not self._commands.empty():
            yield self._commands.get()

    def _expect(self, page: int, number: int) -> None:
        """Note that a message of a page is not written yet; forget the page silent longest."""
        self._heard.pop(page, None)  # else the page would keep its place in the order
        self._heard[page] = number
        self._waiting[page, number] = []
        while len(self._heard) > _PAGES:
            gone = next(iter(self._heard))
            del self._heard[gone]
            self._waiting = {key: told for key, told in self._waiting.items() if key[0] != gone}

    def _answer(self, page: int, number: int) -> None:
        """Call the functions that wait for a message to be written."""
        with self._entry:
            waiting = self._waiting.pop((page, number), ())
        for done in waiting:
            done()
