"""The loop that experiments and batches share: what is stored is taken, the rest is run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from manip3d._util.checked import checked
from manip3d._util.parallel import Task, run_tasks

Row = dict[str, Any]


@runtime_checkable
class Store(Protocol):
    """A place in which rows are kept under keys."""

    def load(self, key: str) -> Row | None:
        """Return the row of a key, or None where there is none that can be trusted."""

    def save(self, key: str, row: Row) -> Row:
        """Keep a row, and return it as a later `load` will."""


@dataclass
class Finished:
    """The rows and errors of a run, by key.

    Attributes
    ----------
    done : dict of str to dict
    failed : dict of str to str
        Errors. They are not stored: the next run tries these tasks again.
    details : dict of str to mapping
        The same errors' `manip3d.errors.error_details`.
    resumed : int
        Number of rows that an earlier run had stored.
    """

    done: dict[str, Row] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    details: dict[str, Mapping[str, object]] = field(default_factory=dict)
    resumed: int = 0


@checked
def run_stored(
    tasks: Mapping[str, Task],
    store: Store,
    jobs: int,
    *,
    dask: str = "",
    progress: Callable[[float, str], object] | None = None,
    describe: Callable[[str], str] = str,
    on_error: Callable[[str, str], object] = lambda key, error: None,
) -> Finished:
    """Run the tasks whose rows are not in the store, and store each row as it comes.

    Parameters
    ----------
    tasks : mapping of str to Task
        By key; each returns a row.
    store : Store
    jobs, dask
        Same as for `manip3d._util.parallel.run_tasks`.
    progress : callable(fraction, message), optional
    describe : callable
        Words for the task of a key, as the message of ``progress``.
    on_error : callable(key, error)
        Called for each task that fails.

    Returns
    -------
    Finished
        Rows and errors by key, and how many rows were in the store before.

    Raises
    ------
    KeyboardInterrupt
        The workers were stopped; what had finished stays stored.

    Examples
    --------
    >>> from manip3d import batch
    >>> rows = batch.Rows("rows", {"function": "square"})
    >>> tasks = {str(number): (dict, ({"square": number**2},)) for number in range(3)}
    >>> sorted(batch.run_stored(tasks, rows, 1).done.items())
    [('0', {'square': 0}), ('1', {'square': 1}), ('2', {'square': 4})]
    >>> rows.flush()
    >>> batch.run_stored(tasks, batch.Rows("rows", {"function": "square"}), 1).resumed
    3
    """
    loaded = ((key, store.load(key)) for key in tasks)
    found = Finished({key: row for key, row in loaded if row is not None})
    found.resumed = len(found.done)
    waiting = {key: task for key, task in tasks.items() if key not in found.done}
    with closing(run_tasks(waiting, jobs, dask=dask)) as outcomes:
        for key, outcome in outcomes:
            if outcome.error:
                found.failed[key], found.details[key] = outcome.error, outcome.details
                on_error(key, outcome.error)
            else:
                found.done[key] = store.save(key, outcome.value)
            if progress is not None:
                progress((len(found.done) + len(found.failed)) / len(tasks), describe(key))
    return found
