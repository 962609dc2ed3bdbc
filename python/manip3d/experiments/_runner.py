"""Runner of experiments: cases run in parallel, and each result is stored as soon as it is ready.

A run may be interrupted and resumed at any time. A stored row is used again only if its inputs,
options and code are the same and none of its bytes has changed.
"""

from __future__ import annotations

import hashlib
import io
import json
import logging
import math
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from manip3d import datasets
from manip3d._util.checked import checked
from manip3d._util.fingerprint import code_fingerprint
from manip3d._util.json import canonical_json
from manip3d._util.parallel import run_tasks
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.batch import run_stored
from manip3d.batch._table import csv_text
from manip3d.errors import InputError
from manip3d.experiments import _recorded
from manip3d.experiments._environment import environment, machine
from manip3d.experiments._model import DATA_KINDS, Case, Experiment, Plan, Row, Sheet
from manip3d.experiments._store import Store
from manip3d.io._files import regular_bytes

Progress = Callable[[float, str], None]
T = TypeVar("T")

RESULTS_FORMAT = 3
"""Version of the format of ``results.json``; increased with each incompatible change."""

_MEASURED_BY = "measured_by"
"""Key in a stored row of the environment in which its case ran."""

_log = logging.getLogger("manip3d")


@dataclass(frozen=True)
class RunSummary:
    """Result of a run.

    Attributes
    ----------
    folder : Path
        The results folder.
    experiments : list of str
        Ids of the experiments.
    cases : int
        Number of different cases of all experiments; shared ones count once.
    resumed : int
        Number of these cases whose stored result was used again.
    failed : int
        Number of failed cases.
    seconds : float
        Wall time.
    problems : list of str
        Other errors: claims that could not be judged although no case failed, and figures that
        could not be drawn.
    results : dict
        The content of ``results.json``, without records that were kept from an earlier run.
    skipped : list of str
        Ids of the experiments that were left out because they have no data of the plan's kind: no
        simulated data (``data='simulated'``), or no real data that is present.
    kept : list of str
        Ids of other experiments of an earlier run, whose records are kept in the folder.
    dropped : list of str
        Ids of other experiments of an earlier run, whose records were replaced because another plan
        or another version of the code had made them. Their finished cases stay stored.
    """

    folder: Path
    experiments: list[str]
    cases: int
    resumed: int
    failed: int
    seconds: float
    problems: list[str]
    results: dict[str, Any]
    skipped: list[str] = field(default_factory=list)
    kept: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)

    __repr__ = short_repr


@checked
def run(
    experiments: Sequence[Experiment],
    folder: Path,
    *,
    plan: Plan | None = None,
    jobs: int = 0,
    dask: str = "",
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RunSummary:
    """Run experiments and write their results to a folder.

    Parameters
    ----------
    experiments : sequence of Experiment
    folder : Path
        Results folder, created if absent. Finished cases in it are used again if nothing that they
        depend on has changed. Records of other experiments in it are kept if the same plan and code
        made them.
    plan : Plan, optional
        Options of the run.
    jobs : int
        Number of processes; 0: one per core; 1: this process only.
    dask : str
        Address of a Dask scheduler whose workers can read the data folder; ``"local"`` starts a
        scheduler on this machine.
    overwrite : bool
        Run finished cases again, and replace their results.
    progress : callable, optional
        Called with the finished fraction and the name of the case that has just finished.

    Returns
    -------
    RunSummary

    Raises
    ------
    InputError
        An argument is out of range, or none of the experiments has data of the plan's kind.
    DataMissingError
        ``data='real'`` and a mesh is absent.
    KeyboardInterrupt
        Raised again after the workers have stopped; finished cases remain stored.

    Notes
    -----
    A case that fails, as for a damaged file of its data, is recorded with its error and tried again
    by the next run. Claims that need it are not judged.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import experiments
    >>> one = experiments.select(["table-6.1"])  # doctest: +SKIP
    >>> experiments.run(one, Path("results"), jobs=1)  # doctest: +SKIP
    """
    if jobs < 0:
        raise InputError(f"jobs: expected >= 0, got {jobs}")
    plan = plan or Plan()
    jobs = jobs or len(os.sched_getaffinity(0))
    started = time.perf_counter()
    planned = {experiment.id: experiment.cases(plan) for experiment in experiments}
    skipped = [
        name for name, made in planned.items() if not (_real(made) if plan.data == "real" else made)
    ]
    experiments = [experiment for experiment in experiments if experiment.id not in skipped]
    if skipped and not experiments:
        kind = "simulated" if plan.data == "simulated" else "real"
        raise InputError(f"data: expected an experiment with {kind} data, got {', '.join(skipped)}")
    store = Store(path_of(folder, "folder"), overwrite)
    folder.mkdir(parents=True, exist_ok=True)

    cases = {experiment.id: _keyed(planned[experiment.id]) for experiment in experiments}
    todo = {key: case for keyed in cases.values() for key, case in keyed.items()}
    found = run_stored(
        {key: (_measure, (case,)) for key, case in todo.items()},
        store,
        jobs,
        dask=dask,
        progress=progress,
        describe=lambda key: describe(todo[key]),
        on_error=lambda key, error: _log.error("%s: %s", describe(todo[key]), error),
    )

    machines = {key: row.pop(_MEASURED_BY) for key, row in found.done.items()}
    rows = {
        experiment.id: _rows(experiment, cases[experiment.id], found.done, found.failed)
        for experiment in experiments
    }
    records = {e.id: _record(e, rows[e.id], store) for e in experiments}
    for name, record in records.items():
        record["environments"] = _distinct(machines[key] for key in cases[name] if key in machines)
    problems = [f"{name}: {text}" for name, r in records.items() for text in r["problems"]]
    bad = {row["key"] for record in rows.values() for row in record if row["error"]}
    results: dict[str, Any] = {
        "format": RESULTS_FORMAT,
        "environment": environment() | {"jobs": jobs, "executor": dask or "processes"},
        "environments": {_name(each): each for each in machines.values()},
        "plan": asdict(plan),
        "wall_time_s": round(time.perf_counter() - started, 3),
        "cases": {"all": len(todo), "resumed": found.resumed, "failed": len(bad)},
        "data": _provenance(todo.values()),
        "experiments": records,
        "pictures": _draw_pictures(experiments, rows, folder, jobs, problems),
    }
    earlier = _earlier_results(folder)
    others = [name for name in earlier.get("experiments", {}) if name not in records]
    kept = others if _is_same_run(earlier, results) else []
    written = _with_earlier(results, earlier, kept)
    store.write("results.json", json.dumps(_strict(written), indent=1, allow_nan=False))
    store.write("results.csv", _csv({n: r["rows"] for n, r in written["experiments"].items()}))
    return RunSummary(
        folder,
        [e.id for e in experiments],
        len(todo),
        found.resumed,
        len(bad),
        time.perf_counter() - started,
        problems,
        results,
        skipped,
        kept,
        [] if kept else others,
    )


def _real(cases: Sequence[Case]) -> list[Case]:
    """Return the cases that need other data than simulated ones."""
    return [case for case in cases if case.inputs or case.data != "simulated"]


def _earlier_results(folder: Path) -> dict[str, Any]:
    """Return the content of the folder's ``results.json``; empty if it is absent or damaged."""
    try:
        found = json.loads(regular_bytes(folder / "results.json"))
        rows = [row for record in found["experiments"].values() for row in record["rows"]]
        is_sound = all(isinstance(row, dict) for row in rows) and isinstance(found["data"], list)
        # Formats before 3 have no environments; their records are not kept, but they are named.
        is_sound = is_sound and isinstance(found.setdefault("environments", {}), dict)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    return found if is_sound and isinstance(found.get("pictures"), dict) else {}


def _is_same_run(earlier: Mapping[str, Any], results: Mapping[str, Any]) -> bool:
    """Return whether plan, format and code of two results are the same."""

    def made_by(found: Mapping[str, Any]) -> list[Any]:
        return [found.get("format"), found.get("plan"), found["environment"]["code"]]

    try:
        return made_by(earlier) == made_by(results)
    except (KeyError, TypeError):
        return False


def _with_earlier(
    results: Mapping[str, Any], earlier: Mapping[str, Any], kept: Sequence[str]
) -> dict[str, Any]:
    """Return results with the records of other experiments of an earlier run.

    Numbers of cases and the wall time stay those of the last run.
    """
    if not kept:
        return dict(results)
    records = {name: earlier["experiments"][name] for name in kept}
    data = [each for each in earlier["data"] if not _is_listed(each, results["data"])]
    return {
        **results,
        "data": [*data, *results["data"]],
        "environments": earlier["environments"] | results["environments"],
        "experiments": records | results["experiments"],
        "pictures": earlier["pictures"] | results["pictures"],
    }


def _is_listed(record: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether all files of a data set are listed by other records with the same hashes."""
    same = (other["files"] for other in others if other["name"] == record["name"])
    return any(record["files"].items() <= files.items() for files in same)


def describe(case: Case) -> str:
    """Describe a case in a few words, for progress messages."""
    words = (case.options.get(name) for name in ("model", "method", "level"))
    return " ".join(str(word) for word in words if word not in (None, "")) or case.function


def _keyed(cases: Sequence[Case]) -> dict[str, Case]:
    return {case.key(_input_hashes(case), code_fingerprint()): case for case in cases}


def _input_hashes(case: Case) -> dict[str, str]:
    sets = (datasets.get(datasets.source_of(name)) for name in case.inputs)
    return {file.path: _hash_of(file, each.name) for each in sets for file in each.files}


def _hash_of(file: datasets.DataFile, name: str) -> str:
    """Return the hash of a file; ``damaged`` if it is not the registered one.

    The case that reads a damaged file fails, and no other.
    """
    try:
        return datasets.file_sha256(datasets.require(file, name))
    except datasets.ChecksumError:
        return "damaged"


def _measure(case: Case) -> Row:
    """Run one case, and add the environment of this process, which may be on another computer."""
    return _run_case(case) | {_MEASURED_BY: machine()}


def _run_case(case: Case) -> Row:
    """Run one case in the current process."""
    return {name: _plain(value) for name, value in case.run(case).items()}


def _name(environment: Mapping[str, Any]) -> str:
    """Return a short name of an environment, the same for equal ones."""
    return hashlib.sha256(canonical_json(environment)).hexdigest()[:8]


def _distinct(environments: Iterable[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(map(_name, environments)))


def _plain(value: Any) -> Any:
    """Convert NumPy scalars and arrays to JSON values."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


# --- collecting --------------------------------------------------------------------------------


def _rows(
    experiment: Experiment,
    cases: Mapping[str, Case],
    done: Mapping[str, Row],
    failed: Mapping[str, str],
) -> list[Row]:
    rows = [
        {"experiment": experiment.id, "model": describe(case), "data": case.data}
        | {**case.options, **done.get(key, {})}
        | {"error": failed.get(key, ""), "key": key}
        for key, case in cases.items()
    ]
    if experiment.gather is not None:
        rows = experiment.gather(rows)
    return [_completed(experiment, row) for row in rows]


def _completed(experiment: Experiment, row: Row) -> Row:
    try:
        row = experiment.complete(row)
    except Exception as error:  # an error in one row must not end the run
        row = row | {"error": row["error"] or f"{type(error).__name__}: {error}"}
    return {"role": experiment.role or DATA_KINDS[row["data"]]} | row


def _sound(rows: Sequence[Row]) -> list[Row]:
    return [row for row in rows if not row["error"]]


def _provenance(cases: Collection[Case]) -> list[dict[str, Any]]:
    """Return origin, licence and hashes of all files that the cases read, by data set."""
    names = dict.fromkeys(datasets.source_of(name) for case in cases for name in case.inputs)
    found = {}
    for name in names:
        with suppress(datasets.ChecksumError):  # cases that read it fail
            found[name] = datasets.provenance(name)
    read = {path: digest for case in cases for path, digest in case.files.items()}
    for record in _recorded.provenance(read):
        known = found.setdefault(record["name"], record)
        known["files"] = known["files"] | record["files"]
    return list(found.values())


def _record(experiment: Experiment, rows: list[Row], store: Store) -> dict[str, Any]:
    problems: list[str] = []
    verdicts = [claim.verdict(rows) for claim in experiment.claims]
    failed = len(_sound(rows)) < len(rows)
    if not failed:
        problems += [f"{v.claim}: {v.unjudged}" for v in verdicts if v.unjudged]
    return {
        "title": experiment.title,
        "published": experiment.published,
        "split": experiment.split,
        "columns": [asdict(column) for column in experiment.columns],
        "notes": [text for text in _notes(experiment, rows, problems) if text],
        "rows": rows,
        "verdicts": [
            asdict(each) | {"word": each.word, "judged_on": list(each.judged_on)}
            for each in verdicts
        ],
        "figures": _figures(experiment, rows, store, problems),
        "problems": problems,
    }


def _notes(experiment: Experiment, rows: list[Row], problems: list[str]) -> Iterator[str]:
    for note in experiment.notes:
        yield note if isinstance(note, str) else _attempted("note", note, rows, problems) or ""


def _attempted(
    what: str, make: Callable[[Sequence[Row]], T], rows: list[Row], problems: list[str]
) -> T | None:
    """Call ``make`` with the rows that did not fail; None, and a problem, if it fails."""
    try:
        return make(_sound(rows))
    except Exception as error:  # the report is still written, and lists the problem
        _log.warning("%s: %s: %s", what, type(error).__name__, error)
        problems.append(f"{what}: {type(error).__name__}: {error}")
        return None


def _figures(
    experiment: Experiment, rows: list[Row], store: Store, problems: list[str]
) -> dict[str, str]:
    """Draw the figures as SVG; return the files by name."""
    if experiment.figures is None:
        return {}
    written = {}
    drawn = _attempted("figures", experiment.figures, rows, problems) or {}
    for number, (name, figure) in enumerate(drawn.items()):
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None}, transparent=True)
        relative = f"figures/{experiment.id}-{number}.svg"
        store.write(relative, stream.getvalue())
        written[name] = relative
    return written


def _draw_pictures(
    experiments: Sequence[Experiment],
    rows: Mapping[str, list[Row]],
    folder: Path,
    jobs: int,
    problems: list[str],
) -> dict[str, Any]:
    """Draw the sheets of pictures by model, or return the reason why there are none."""
    sheets: dict[str, Sheet] = {}
    for experiment in experiments:
        if experiment.sheets is not None:
            sheets |= _attempted("pictures", experiment.sheets, rows[experiment.id], problems) or {}
    tasks = {model: (sheet.draw, (str(folder), sheet.options)) for model, sheet in sheets.items()}
    drawn: dict[str, Any] = {}
    with closing(run_tasks(tasks, jobs)) as outcomes:
        for model, outcome in outcomes:
            items = outcome.value or []
            drawn[model] = {"about": sheets[model].about, "items": items, "error": outcome.error}
    return {model: drawn[model] for model in sheets}


def _strict(value: Any) -> Any:
    """Convert a value to strict JSON: infinities and NaN become strings.

    NumPy numbers, which claims may compute, become Python numbers.
    """
    if hasattr(value, "item") and not hasattr(value, "__len__"):
        value = value.item()
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def _csv(rows_by_experiment: Mapping[str, list[Row]]) -> str:
    """Return the rows as CSV. Lists and mappings are left out; ``results.json`` contains them."""
    rows = [row for rows in rows_by_experiment.values() for row in rows]
    nested = {k for row in rows for k, value in row.items() if isinstance(value, dict | list)}
    names = [name for name in dict.fromkeys(k for row in rows for k in row) if name not in nested]
    return csv_text(rows, names)
