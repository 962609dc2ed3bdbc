"""Independent tasks in parallel processes (or on Dask), with outcomes in the order of finishing.

An error of a task is part of its outcome, even if the task crashes its process. Ctrl-C ends the
workers immediately, and so does the end of the process that started them.
"""

from __future__ import annotations

import functools
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Generator, Hashable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, TypeVar

from manip3d._util.extras import imported
from manip3d.errors import InputError, error_details

if TYPE_CHECKING:
    from multiprocessing.synchronize import Event

_Key = TypeVar("_Key", bound=Hashable)
Task = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function, which must be importable by name, and its arguments."""

_DASK_WINDOW = 1000
"""Number of tasks submitted to a Dask scheduler at a time: enough for hundreds of workers, while
the scheduler needs little memory."""

_ATTEMPTS = 3
"""Number of runs of a task that a Dask scheduler loses with its connection: a second loss during
the repetition is survived, and a scheduler that loses all tasks is not asked for ever."""

_SPAWN = multiprocessing.get_context("spawn")

_GUARD = 'below `if __name__ == "__main__":`, because its worker processes import it'

_log = logging.getLogger("manip3d")


@dataclass(frozen=True)
class Outcome:
    """The value of a task, or the error that ended it ('' if none) and its `error_details`."""

    value: Any = None
    error: str = ""
    details: Mapping[str, object] = field(default_factory=dict)


def check_function(function: Callable[..., Any], jobs: int, dask: str) -> None:
    """Raise InputError if workers could not import a function, before any of them is started.

    A worker that cannot would die as if it had crashed, and once for each task. Dask sends the code
    of functions that have no module.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # it imports the script
        raise InputError(f"jobs: a script must call this {_GUARD}")
    if dask or jobs == 1:
        return
    try:
        pickle.dumps(function)
        if function.__module__ == "__main__" and not _is_main_importable():
            raise pickle.PicklingError("the module __main__ is no file")
    except Exception as error:  # pickle raises various types
        raise InputError(
            f"function: expected one that workers can import, got {function!r}; define it at the "
            "top level of a module (a .py file other than __main__.py), or give jobs=1 or "
            'dask="local"'
        ) from error


def _is_main_importable() -> bool:
    """Return whether workers import ``__main__``, by the rules of ``multiprocessing.spawn``."""
    main = sys.modules["__main__"]
    if (spec := getattr(main, "__spec__", None)) is not None:
        return str(spec.name).rpartition(".")[2] != "__main__"
    return os.path.isfile(getattr(main, "__file__", None) or "")  # not in notebooks and shells


def run_tasks(
    tasks: Mapping[_Key, Task], jobs: int, *, dask: str = ""
) -> Generator[tuple[_Key, Outcome]]:
    """Run tasks and yield each key once with its outcome, in the order of finishing.

    Tasks must be repeatable: one whose worker dies, or that runs beside one, runs again.

    Parameters
    ----------
    tasks : mapping
        Tasks by key. It is read while the work proceeds; the workers hold only a few tasks at any
        time.
    jobs : int
        Number of worker processes; 1 runs the tasks in this process, in order. The environment
        variable ``MANIP3D_THREADS`` of each worker is its share of the cores.
    dask : str
        Address of a Dask scheduler to use instead; ``"local"`` starts one with ``jobs`` workers.
        If a worker is lost, its tasks run again on another one. Workers without
        ``MANIP3D_THREADS`` run each task with one thread, because Dask plans one thread per task.

    Notes
    -----
    Close the generator if you leave the loop early, so that the workers stop.
    """
    workers = min(jobs, max(1, len(tasks)))
    if dask:
        yield from _run_on_dask(tasks, workers, dask)
    elif jobs == 1:
        yield from ((key, _attempt(*task)) for key, task in tasks.items())
    else:
        yield from _run_in_processes(tasks, workers)


def _run_on_dask(
    tasks: Mapping[_Key, Task], workers: int, address: str
) -> Iterator[tuple[_Key, Outcome]]:
    attempt = functools.partial(_attempt_on_dask, _log.getEffectiveLevel())
    with _dask_client(workers, address) as client:
        # pure=False: Dask does not reuse the result of an equal task, so that it can run again.
        executor = client.get_executor(pure=False)
        yield from _outcomes(
            lambda *task: executor.submit(attempt, *task), iter(tasks.items()), {}, _DASK_WINDOW
        )


def _run_in_processes(tasks: Mapping[_Key, Task], workers: int) -> Iterator[tuple[_Key, Outcome]]:
    waiting = iter(tasks.items())
    has_started = _SPAWN.Event()
    is_done = False
    while not is_done:
        unfinished: dict[_Key, Task] = {}
        try:
            with _executor(workers, has_started) as executor:
                yield from _outcomes(
                    lambda *task: executor.submit(_attempt, *task), waiting, unfinished, 2 * workers
                )
            is_done = True
        except BrokenProcessPool as error:
            if not has_started.is_set():
                raise InputError(
                    "jobs: all workers ended at their start (see their output); if a script "
                    f"calls this, it must do so {_GUARD}"
                ) from error
            # A task crashed its worker: run each alone to find which one.
            for key, task in unfinished.items():
                yield key, _isolated(task, has_started)


def _outcomes(
    submit: Callable[..., Future[Outcome]],
    waiting: Iterator[tuple[_Key, Task]],
    unfinished: dict[_Key, Task],
    window: int,
) -> Iterator[tuple[_Key, Outcome]]:
    """Yield the outcomes of all waiting tasks, of which ``window`` are submitted at any time.

    Tasks that are lost because the connection to a scheduler broke run again. If a worker of Dask
    dies too often, all tasks on it fail. They run again one after the other, so that only the task
    that crashes has an error.

    Parameters
    ----------
    submit : callable
        Submits a function and its arguments to an executor.
    waiting : iterator
        Keys and tasks, read while the work proceeds.
    unfinished : dict
        Receives each task that is read, until its outcome is yielded. After a BrokenProcessPool the
        caller must run these tasks itself; some of them may have run already.
    window : int
        Number of tasks that are submitted at any time.

    Raises
    ------
    BrokenProcessPool
        A worker process died.
    """
    given_up: dict[_Key, Task] = {}
    for _ in range(_ATTEMPTS):
        lost: dict[_Key, Task] = {}
        for key, future in _finished(submit, waiting, unfinished, window):
            error = _error_of(future)
            if error is None:
                del unfinished[key]
                yield key, future.result()
            elif isinstance(error, CancelledError):
                lost[key] = unfinished[key]
            else:
                given_up[key] = unfinished[key]
        waiting = iter(lost.items())
    yield from _one_by_one(submit, given_up | lost, unfinished)


def _one_by_one(
    submit: Callable[..., Future[Outcome]],
    tasks: Mapping[_Key, Task],
    unfinished: dict[_Key, Task],
) -> Iterator[tuple[_Key, Outcome]]:
    """Yield the outcomes of tasks that run alone, so that each error is that of its own task."""
    for key, future in _finished(submit, iter(tasks.items()), unfinished, 1):
        error = _error_of(future)
        del unfinished[key]
        yield key, future.result() if error is None else _failure(error)


def _finished(
    submit: Callable[..., Future[Outcome]],
    waiting: Iterator[tuple[_Key, Task]],
    unfinished: dict[_Key, Task],
    window: int,
) -> Iterator[tuple[_Key, Future[Outcome]]]:
    """Keep ``window`` tasks submitted until none is waiting; yield their futures when done.

    A done future is yielded before the next task is submitted, because submitting may raise
    BrokenProcessPool. Each task that is read is added to ``unfinished``.
    """
    done: SimpleQueue[tuple[_Key, Future[Outcome]]] = SimpleQueue()
    num_running = 0

    def start(key: _Key, task: Task) -> None:
        unfinished[key] = task
        submit(*task).add_done_callback(lambda future: done.put((key, future)))

    while True:
        for key, task in islice(waiting, window - num_running):
            start(key, task)
            num_running += 1
        if not num_running:
            return
        key, future = done.get()
        num_running -= 1
        if isinstance(error := _error_of(future), BrokenProcessPool):
            raise error
        yield key, future


def _error_of(future: Future[Outcome]) -> BaseException | None:
    """Return the error of a future that is done, CancelledError if it was cancelled."""
    return CancelledError() if future.cancelled() else future.exception()


def _attempt_on_dask(
    log_level: int, function: Callable[..., Any], arguments: tuple[Any, ...]
) -> Outcome:
    os.environ.setdefault("MANIP3D_THREADS", "1")
    _log.setLevel(log_level)
    if log_level <= logging.WARNING:
        return _attempt(function, arguments)
    # The worker may serve others afterwards. With several threads it may stay quiet for them, too.
    with warnings.catch_warnings(action="ignore"):
        return _attempt(function, arguments)


def _attempt(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Outcome:
    try:
        return Outcome(function(*arguments))
    except (Exception, SystemExit) as error:  # becomes a part of the outcome
        _log.debug("%s", traceback.format_exc())
        return _failure(error)


def _failure(error: BaseException) -> Outcome:
    return Outcome(error=f"{type(error).__name__}: {error}", details=error_details(error))


def _isolated(task: Task, has_started: Event) -> Outcome:
    try:
        with _executor(1, has_started) as executor:
            future: Future[Outcome] = executor.submit(_attempt, *task)
            error = future.exception()
            if isinstance(error, BrokenProcessPool):
                raise error
            # The value of a task may be one that cannot be sent to this process.
            return future.result() if error is None else _failure(error)
    except BrokenProcessPool:
        line = "the process that ran it died (out of memory, or a crash)"
        return Outcome(error=line, details={"code": "process", "message": line})


@contextmanager
def _executor(workers: int, has_started: Event) -> Iterator[Executor]:
    """Start workers; the first of them that is ready for tasks sets ``has_started``."""
    others = set(multiprocessing.active_children())
    executor = ProcessPoolExecutor(
        workers,
        mp_context=_SPAWN,
        initializer=_start_worker,
        initargs=(
            max(1, len(os.sched_getaffinity(0)) // workers),
            _log.getEffectiveLevel(),
            has_started,
        ),
    )
    try:
        yield executor
        executor.shutdown()
    except BaseException:  # including Ctrl-C: do not wait for running tasks
        executor.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.kill()
        raise


def _start_worker(threads: int, log_level: int, has_started: Event) -> None:
    _log.setLevel(log_level)
    if log_level > logging.WARNING:
        warnings.simplefilter("ignore")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.environ["MANIP3D_THREADS"] = str(threads)
    has_started.set()


def _end_with_parent() -> None:
    """End this process when its parent has ended, even if that was killed.

    Otherwise it would wait for ever, because other workers keep the pipe for tasks open.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _dask_client(workers: int, address: str) -> Any:
    Client = imported("distributed", "dask").Client
    if address == "local":
        # Port 0 is any free port; another cluster may use the default port of the dashboard.
        return Client(n_workers=workers, threads_per_worker=1, dashboard_address="127.0.0.1:0")
    try:
        return Client(address)
    except ValueError as error:  # the text is no address
        raise InputError(
            f"dask: expected local or the address of a scheduler, such as tcp://127.0.0.1:8786, "
            f"got {address!r}: {error}"
        ) from error
