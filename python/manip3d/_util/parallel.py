"""Independent tasks in parallel processes (or on Dask), each outcome as it comes.

An error of a task is part of its outcome, also when the task takes its process down; Ctrl-C stops
the workers at once, and so does the end of the process that started them.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Hashable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from queue import SimpleQueue
from typing import Any, TypeVar

from manip3d.errors import InputError, MissingExtraError, error_details

_Key = TypeVar("_Key", bound=Hashable)
Task = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function that can be imported by name, and its arguments."""

_DASK_WINDOW = 1000
"""Tasks that a Dask scheduler has at once: enough for hundreds of workers, and little memory."""

_log = logging.getLogger("manip3d")


@dataclass(frozen=True)
class Outcome:
    """The value of a task, or the error it ended with (``""``: none) and its `error_details`."""

    value: Any = None
    error: str = ""
    details: Mapping[str, object] = field(default_factory=dict)


def run_tasks(
    tasks: Mapping[_Key, Task], jobs: int, *, dask: str = ""
) -> Generator[tuple[_Key, Outcome]]:
    """Run tasks and yield each key with its outcome, in the order of finishing.

    Parameters
    ----------
    tasks : mapping
        Read as the work proceeds: only a window of it is with the workers at any time.
    jobs : int
        Processes; 1: in this one, in order. Each worker's ``MANIP3D_THREADS`` is its share of
        the cores.
    dask : str
        Address of a Dask scheduler to use instead; ``"local"`` starts one with ``jobs`` workers.
        A task whose worker is lost runs again on another one. Workers that do not set
        ``MANIP3D_THREADS`` run each task with one thread, as Dask counts threads.

    Notes
    -----
    Close the generator when leaving early, so that the workers stop.
    """
    if jobs == 1 and not dask:
        yield from ((key, _attempt(*task)) for key, task in tasks.items())
        return
    workers = min(jobs, max(1, len(tasks)))
    attempt, window = (_attempt_on_dask, _DASK_WINDOW) if dask else (_attempt, 2 * workers)
    waiting = iter(tasks.items())
    is_done = False
    while not is_done:
        running: dict[_Key, Task] = {}
        try:
            with _executor(workers, dask) as executor:
                yield from _outcomes(
                    lambda *task: executor.submit(attempt, *task), waiting, running, window
                )
            is_done = True
        except BrokenProcessPool:  # one task took its worker down: find out which, each on its own
            for key, task in running.items():
                yield key, _isolated(task)


def _outcomes(
    submit: Callable[..., Future[Outcome]],
    waiting: Iterator[tuple[_Key, Task]],
    running: dict[_Key, Task],
    window: int,
    attempts: int = 3,
) -> Generator[tuple[_Key, Outcome]]:
    """Keep ``window`` tasks with the workers until none waits; ``running`` says which they are.

    Dask gives up all tasks that were with a worker that died once too often: they run again one
    after the other, so that only the one that is to blame has an error. Tasks that are lost
    because the connection to the scheduler broke run again, too.
    """
    finished: SimpleQueue[tuple[_Key, Future[Outcome]]] = SimpleQueue()
    given_up: dict[_Key, Task] = {}
    lost: dict[_Key, Task] = {}

    def start(key: _Key, task: Task) -> None:
        running[key] = task
        function, arguments = task
        future = submit(function, arguments)
        future.add_done_callback(lambda done: finished.put((key, done)))

    for key, task in islice(waiting, window):
        start(key, task)
    while running:
        key, future = finished.get()
        error = CancelledError() if future.cancelled() else future.exception()
        if isinstance(error, BrokenProcessPool):
            raise error
        task = running.pop(key)
        for following in islice(waiting, 1):
            start(*following)
        if error is None:
            yield key, future.result()
        elif isinstance(error, CancelledError) and attempts > 1:
            lost[key] = task
        elif window > 1:
            given_up[key] = task
        else:
            yield key, _failure(error)
    if lost:
        yield from _outcomes(submit, iter(lost.items()), running, window, attempts - 1)
    if given_up:
        yield from _outcomes(submit, iter(given_up.items()), running, 1, 1)


def _attempt_on_dask(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    os.environ.setdefault("MANIP3D_THREADS", "1")
    return _attempt(function, arguments)


def _attempt(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    try:
        return Outcome(function(*arguments))
    except Exception as error:  # part of the outcome, never lost
        _log.debug("%s", traceback.format_exc())
        return _failure(error)


def _failure(error: BaseException) -> Outcome:
    return Outcome(error=f"{type(error).__name__}: {error}", details=error_details(error))


def _isolated(task: Task) -> Outcome:
    try:
        with _executor(1, "") as executor:
            future: Future[Outcome] = executor.submit(_attempt, *task)
            return future.result()
    except BrokenProcessPool:
        line = "the process that ran it died (out of memory, or a crash)"
        return Outcome(error=line, details={"code": "process", "message": line})


@contextmanager
def _executor(workers: int, dask: str) -> Iterator[Executor]:
    if dask:
        with _dask_client(workers, dask) as client:
            yield client.get_executor(pure=False)  # a task that failed may be tried again
        return
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(max(1, len(os.sched_getaffinity(0)) // workers),),
    )
    try:
        yield executor
        executor.shutdown()
    except BaseException:  # Ctrl-C among them: at once, not after the tasks at work
        executor.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        raise


def _start_worker(threads: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what Ctrl-C means
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["MANIP3D_THREADS"] = str(threads)


def _end_with_parent() -> None:
    """End this process when the one that started it has ended, killed or not.

    Nothing else would: a worker waits for tasks at a pipe that the other workers hold open, too.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _dask_client(workers: int, address: str) -> Any:
    try:
        from distributed import Client
    except ImportError:
        raise MissingExtraError("distributed", "dask") from None
    if address == "local":
        # A free port for the dashboard: Dask's own may be taken by another cluster.
        return Client(n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0")
    try:
        return Client(address)
    except ValueError as error:  # no address at all
        raise InputError(
            f"dask: expected local or the address of a scheduler, such as tcp://127.0.0.1:8786, "
            f"got {address!r}: {error}"
        ) from error
