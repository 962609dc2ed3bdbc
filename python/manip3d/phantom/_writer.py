"""A thread that writes to the disk, so that the game does not wait for it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

_AGAIN_S = 1.0  # seconds between attempts to write an entry
_LOOK_S = 0.1  # seconds between calls of `is_hurried`
_HURRY_S = (
    1.0  # seconds in which a working disk writes all entries, so that none is reported as lost
)


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
    """Calls writing functions one after the other, in the order in which they were added.

    A task that raises an OSError (locked file, full disk) is tried again every second, and later
    tasks wait for it, so that the order is kept. A task that raises another error would fail again:
    it is reported as lost.
    """

    def __init__(self) -> None:
        self._tasks: list[_Task] = []
        self._given: set[_Task] = set()  # tasks since `begin` that are not written
        self._waiters: list[_Waiter] = []
        self._lost: list[str] = []
        self._trouble = ""
        self._is_over = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="diary", daemon=True)
        self._thread.start()

    def add(self, what: str, write: Callable[[], object], *, holds: bool = True) -> None:
        """Add a task, and return at once.

        ``what``: description for the therapist, who must note the entry elsewhere if it is lost;
        empty: it is not reported. ``holds``: later tasks wait for this one; False: only later tasks
        that do not hold others wait.
        """
        with self._changed:
            task = _Task(what, write, holds)
            self._tasks.append(task)
            self._given.add(task)
            self._changed.notify_all()

    def begin(self) -> None:
        """Begin a group of tasks, for which `when_written` waits."""
        with self._changed:
            self._given.clear()

    def when_written(self, then: Callable[[], object]) -> None:
        """Call ``then`` when all tasks since `begin` are written, or at once if they are.

        It is called by the writing thread, never if one of these tasks is lost, and must return at
        once.
        """
        with self._changed:
            if self._given:  # a lost task stays in the group, so that ``then`` is never called
                self._waiters.append(_Waiter(set(self._given), then))
                return
        then()

    @property
    def is_idle(self) -> bool:
        """Whether all tasks are written."""
        with self._changed:
            return not self._tasks

    @property
    def trouble(self) -> str:
        """Return a sentence on tasks that are not written and why; empty if there is no problem."""
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
        """Wait until all tasks are written, for at most ``seconds``; list those that are not.

        ``is_hurried``: once it returns True, the wait ends after one more second.
        """
        end = time.monotonic() + seconds
        with self._changed:
            while self._tasks and time.monotonic() < end:
                # `is_hurried` is polled, because a signal handler must not notify a condition.
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
            except Exception as error:  # any error: the other tasks must still be written
                failed = f"{task.what or 'state of the session'}: {error}"
            self._done(task, failed)

    def _next(self) -> _Task | None:
        """Return the first task that need not wait for another one."""
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
            if task in self._tasks:  # close() may have given it up
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
