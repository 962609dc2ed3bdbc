"""`run_tasks` hands out a window of tasks at a time, and repeats those that were lost."""

from __future__ import annotations

import logging
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest

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


@pytest.mark.parametrize("jobs", [1, 2])
def test_errors_are_outcomes(jobs: int) -> None:
    tasks = {1: (double, (1,)), 2: (fail, (2,)), 3: (sys.exit, ("no 3",)), 4: (double, (4,))}
    found = dict(run_tasks(tasks, jobs))
    assert (found[1], found[4]) == (Outcome(2), Outcome(8))
    for number, name in ((2, "ValueError"), (3, "SystemExit")):
        details = {"code": "internal", "message": f"no {number}"}
        assert found[number] == Outcome(error=f"{name}: no {number}", details=details)


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


# --- workers that die -----------------------------------------------------------------------------


def die(signal: str) -> None:
    """End this process as soon as a file exists."""
    while not Path(signal).exists():
        time.sleep(0.01)
    os._exit(3)


def unsendable(number: int) -> Callable[[], int]:
    """Return a value that cannot be pickled."""
    return lambda: number


def outcomes_around_a_death(
    tasks: dict[int, tuple[Callable[..., Any], tuple[Any, ...]]], signal: Path
) -> list[tuple[int, Outcome]]:
    """Run tasks; the worker that waits for ``signal`` dies while the first outcome is used."""
    found = []
    for key, outcome in run_tasks(tasks, 2):
        found.append((key, outcome))
        if not signal.exists():
            signal.touch()
            while multiprocessing.active_children():  # the executor ends the other worker
                time.sleep(0.01)
    return found


def test_no_outcome_is_lost_when_a_worker_dies_while_the_caller_is_busy(tmp_path: Path) -> None:
    signal = tmp_path / "signal"
    tasks: dict[int, Any] = {n: (double, (n,)) for n in range(12)}
    tasks[0] = (die, (str(signal),))
    found = outcomes_around_a_death(tasks, signal)
    assert sorted(key for key, _ in found) == list(range(12))
    assert "the process that ran it died" in dict(found)[0].error
    assert [dict(found)[key].value for key in range(1, 12)] == [2 * key for key in range(1, 12)]


def test_a_task_whose_value_cannot_be_sent_is_not_lost_when_a_worker_dies(tmp_path: Path) -> None:
    signal = tmp_path / "signal"
    tasks: dict[int, Any] = {n: (double, (n,)) for n in range(12)}
    tasks |= {0: (die, (str(signal),)), 1: (unsendable, (1,))}
    found = outcomes_around_a_death(tasks, signal)
    assert sorted(key for key, _ in found) == list(range(12))
    assert "pickle" in dict(found)[1].error


def test_what_is_finished_is_yielded_before_a_submission_that_fails() -> None:
    num_submitted = 0

    def submit(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Future[Outcome]:
        nonlocal num_submitted
        num_submitted += 1
        if num_submitted == 3:
            raise BrokenProcessPool
        future: Future[Outcome] = Future()
        future.set_result(Outcome(function(*arguments)))
        return future

    unfinished: dict[int, Any] = {}
    outcomes = _outcomes(submit, iter({n: (double, (n,)) for n in range(9)}.items()), unfinished, 2)
    assert next(outcomes) == (0, Outcome(0))
    with pytest.raises(BrokenProcessPool):
        next(outcomes)
    assert list(unfinished) == [1, 2]
