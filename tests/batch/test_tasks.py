"""`run_tasks` hands out a window of tasks at a time, and repeats those that were lost."""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from manip3d._util.parallel import Outcome, _outcomes, run_tasks


def double(number: int) -> int:
    return 2 * number


def fail(number: int) -> int:
    raise ValueError(f"no {number}")


def test_tasks_are_read_as_the_work_proceeds() -> None:
    at_most = 0
    futures: list[Future[Outcome]] = []

    def submit(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Outcome]:
        nonlocal at_most
        future: Future[Outcome] = Future()
        futures.append(future)
        at_most = max(at_most, sum(not f.done() for f in futures))
        if len(futures) >= 3:  # the workers are done with the oldest
            next(f for f in futures if not f.done()).set_result(Outcome(function(*arguments)))
        return future

    tasks = {n: (double, (n,)) for n in range(100)}
    found = []
    for key, _ in _outcomes(submit, iter(tasks.items()), {}, 3):
        found.append(key)
        if len(found) >= 97:  # nothing is submitted any more
            for future in futures:
                if not future.done():
                    future.set_result(Outcome(0))
    assert sorted(found) == list(range(100))
    assert at_most <= 3


def test_lost_tasks_run_again_and_not_for_ever() -> None:
    losses = {1: 1, 2: 9}
    runs: list[int] = []

    def submit(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Outcome]:
        future: Future[Outcome] = Future()
        (number,) = arguments
        runs.append(number)
        if losses.get(number, 0) >= runs.count(number):
            future.cancel()
            future.set_running_or_notify_cancel()
        else:
            future.set_result(Outcome(function(number)))
        return future

    tasks = {n: (double, (n,)) for n in range(4)}
    found = dict(_outcomes(submit, iter(tasks.items()), {}, 2))
    assert {key: outcome.value for key, outcome in found.items()} == {0: 0, 1: 2, 2: None, 3: 6}
    assert "CancelledError" in found[2].error
    assert runs.count(2) == 4


def test_errors_are_outcomes() -> None:
    tasks = {1: (double, (1,)), 2: (fail, (2,))}
    found = dict(run_tasks(tasks, 1))
    assert found[1] == Outcome(2)
    details = {"code": "internal", "message": "no 2"}
    assert found[2] == Outcome(error="ValueError: no 2", details=details)


def level_of_log() -> int:
    return logging.getLogger("manip3d").getEffectiveLevel()


def test_workers_log_as_much_as_their_parent() -> None:
    """Workers take the log level of their parent, so that -q also silences their warnings."""
    logger = logging.getLogger("manip3d")
    before = logger.level
    try:
        logger.setLevel(logging.ERROR)
        found = dict(run_tasks({n: (level_of_log, ()) for n in range(2)}, 2))
    finally:
        logger.setLevel(before)
    assert [outcome.value for outcome in found.values()] == [logging.ERROR] * 2
