"""A thread that writes, so that nobody who plays waits for a disk."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

_AGAIN_S = 1.0  # between attempts to write what could not be written
_LOOK_S = 0.1  # between looks at whether somebody is in a hurry
_HURRY_S = 1.0  # a disk that works writes all in this time, and nothing is reported as lost


@dataclass(eq=False)
class _Task:
    what: str
    write: Callable[[], object]
    holds: bool
    due: float = 0.0


@dataclass(eq=False)
class _Waiter:
    tasks: set[_Task]
    then: Callable[[], object]


class OrderedWriter:
    """Writes one thing after the other, in the order in which they were given.

    What an OSError keeps from being written, as a locked file or a full disk, is tried again every
    second; all that came after it waits, so that the order holds. What fails otherwise would fail
    again: it is lost, and told.
    """

    def __init__(self) -> None:
        self._tasks: list[_Task] = []
        self._given: set[_Task] = set()  # since `begin`, and not written
        self._waiters: list[_Waiter] = []
        self._lost: list[str] = []
        self._trouble = ""
        self._is_over = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="diary", daemon=True)
        self._thread.start()

    def add(self, what: str, write: Callable[[], object], *, holds: bool = True) -> None:
        """Have something written; returns at once.

        ``what``: in words for who must note it elsewhere if it cannot be written; empty: nobody
        must. ``holds``: what comes later waits for it; without this only others without it do.
        """
        with self._changed:
            task = _Task(what, write, holds)
            self._tasks.append(task)
            self._given.add(task)
            self._changed.notify_all()

    def begin(self) -> None:
        """Begin a group: `when_written` waits for all tasks that are added from now on."""
        with self._changed:
            self._given.clear()

    def when_written(self, then: Callable[[], object]) -> None:
        """Call something when all that was given since `begin` is written, or at once where it is.

        It is called by the writing thread, and never where any of that is lost; it must return at
        once.
        """
        with self._changed:
            if self._given:  # what is lost stays there: nobody calls for it any more
                self._waiters.append(_Waiter(set(self._given), then))
                return
        then()

    @property
    def is_idle(self) -> bool:
        """Whether all is written."""
        with self._changed:
            return not self._tasks

    @property
    def trouble(self) -> str:
        """Return what is not written and why, in words; empty while all goes well."""
        with self._changed:
            parts = []
            if self._trouble and self._tasks:
                number = len(self._tasks)
                things = "1 entry" if number == 1 else f"{number} entries"
                parts.append(f"Not kept in the diary yet: {things} ({self._trouble}).")
            if self._lost:
                more = f", and {len(self._lost) - 1} more" if len(self._lost) > 1 else ""
                parts.append(f"Cannot be kept in the diary: {self._lost[0]}{more}.")
            return " ".join(parts)

    def close(self, seconds: float, is_hurried: Callable[[], bool] | None = None) -> list[str]:
        """Wait until all is written, but no longer than so many seconds; list what is not.

        ``is_hurried``: as soon as it returns True, wait for one more second only.
        """
        end = time.monotonic() + seconds
        with self._changed:
            while self._tasks and time.monotonic() < end:
                # Who is in a hurry may be a signal's handler, which must not notify.
                self._changed.wait(min(_LOOK_S, max(0.0, end - time.monotonic())))
                if is_hurried is not None and is_hurried():
                    end, is_hurried = min(end, time.monotonic() + _HURRY_S), None
            why = self._trouble or "it took too long"
            left = [f"{task.what}: {why}" for task in self._tasks if task.what]
            self._tasks.clear()
            self._is_over = True
            self._changed.notify_all()
            return [*self._lost, *left]

    def _run(self) -> None:
        while True:
            with self._changed:
                task = self._next()
                while task is None and not self._is_over:
                    self._changed.wait(0.05 if self._tasks else None)
                    task = self._next()
                if task is None:
                    return
            failed = ""
            try:
                task.write()
            except OSError as error:
                self._postpone(task, str(error))
                continue
            except Exception as error:  # whatever it was: the others must be written
                failed = f"{task.what or 'state of the session'}: {error}"
            self._done(task, failed)

    def _next(self) -> _Task | None:
        """The first one that need not wait for another one."""
        now = time.monotonic()
        waits = False
        for task in self._tasks:
            if task.due <= now and (task.holds or not waits):
                return task
            if task.holds:
                return None
            waits = True
        return None

    def _postpone(self, task: _Task, reason: str) -> None:
        with self._changed:
            self._trouble = reason
            task.due = time.monotonic() + _AGAIN_S

    def _done(self, task: _Task, failed: str) -> None:
        with self._changed:
            if failed:
                self._lost.append(failed)
            if task in self._tasks:  # else nobody waits for it any more
                self._tasks.remove(task)
            if failed:
                self._waiters = [one for one in self._waiters if task not in one.tasks]
            else:
                self._note_written(task)
            if not self._tasks:
                self._trouble = ""
            self._changed.notify_all()

    def _note_written(self, task: _Task) -> None:
        self._given.discard(task)
        for waiter in self._waiters:
            waiter.tasks.discard(task)
        ready = [waiter for waiter in self._waiters if not waiter.tasks]
        self._waiters = [waiter for waiter in self._waiters if waiter.tasks]
        for waiter in ready:
            waiter.then()
