"""What an experiment is: cases, a function that runs one, and claims about the rows."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]
DataTier = Literal["auto", "real", "simulated"]
Scale = Literal["quick", "full"]


@dataclass(frozen=True)
class Plan:
    """What a run was asked for.

    Attributes
    ----------
    data : 'auto', 'real' or 'simulated'
        ``auto``: real data where it is here, simulated models in the place of the rest.
    scale : 'quick' or 'full'
    seed : int
        Seeds every random choice of the cases.
    """

    data: DataTier = "auto"
    scale: Scale = "full"
    seed: int = 0


@dataclass(frozen=True)
class Case:
    """One unit of work: a function of a module and its options.

    Attributes
    ----------
    run : callable
        ``run(case) -> dict``, importable by name. Values that are a `Mesh` or `bytes` are stored
        beside the row; all others are JSON values.
    options : mapping of JSON values
        All that the result depends on, seeds included, apart from the code and `inputs`.
    inputs : tuple of str
        Names of the registered meshes that it opens.
    """

    run: Callable[[Case], Row]
    options: Mapping[str, Any]
    inputs: tuple[str, ...] = ()

    @property
    def function(self) -> str:
        """``module:name`` of `run`."""
        return f"{self.run.__module__}:{self.run.__qualname__}"

    def key(self, inputs_sha256: Mapping[str, str], code: str) -> str:
        """Name of its result: a hash of function, options, the inputs' bytes and the code."""
        record = {
            "function": self.function,
            "options": dict(self.options),
            "inputs": dict(inputs_sha256),
            "code": code,
        }
        return hashlib.sha256(canonical_json(record)).hexdigest()[:32]


def canonical_json(value: Any) -> bytes:
    """The one spelling of a JSON value that hashes are taken of; NaN stays NaN."""
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode()


@dataclass(frozen=True)
class Finding:
    """What one model (or other part) says about a claim.

    Attributes
    ----------
    subject : str
    holds : bool or None
        None: not applicable there.
    numbers : str
        What was compared.
    """

    subject: str
    holds: bool | None
    numbers: str


@dataclass(frozen=True)
class Verdict:
    """A claim judged: it holds if every applicable finding holds.

    Attributes
    ----------
    claim : str
    source : str
        Where the claim is made.
    findings : tuple of Finding
    """

    claim: str
    source: str
    findings: tuple[Finding, ...]

    @property
    def holds(self) -> bool | None:
        """True, False, or None where nothing applies."""
        judged = [finding.holds for finding in self.findings if finding.holds is not None]
        return all(judged) if judged else None

    @property
    def word(self) -> str:
        """``holds``, ``does not hold`` or ``not applicable``."""
        return {True: "holds", False: "does not hold", None: "not applicable"}[self.holds]


@dataclass(frozen=True)
class Claim:
    """What a source says in words, as a predicate over an experiment's rows.

    Attributes
    ----------
    text : str
    source : str
        Table, figure or section that says so, or ``aim`` for one of our own.
    judge : callable
        Rows that did not fail -> findings.
    """

    text: str
    source: str
    judge: Callable[[Sequence[Row]], Iterable[Finding]]

    def verdict(self, rows: Sequence[Row]) -> Verdict:
        """The claim judged on the rows that did not fail."""
        sound = [row for row in rows if not row.get("error")]
        return Verdict(self.text, self.source, tuple(self.judge(sound)))


@dataclass(frozen=True)
class Column:
    """How a report shows one value of the rows.

    Attributes
    ----------
    name : str
        Key in the row.
    title : str
    scale : float
        Shown is the value times this.
    digits : int or None
        Decimals; None: as it is.
    published : str
        Key of the published value that stands beside it; ``""``: none.
    ratio : bool
        Whether their ratio stands there too, where both are of the same file.
    lower_is_better : bool
        Whether the report marks each model's lowest value, among rows whose ``reached`` is not
        false.
    words : mapping of str to str
        How the row's words are shown.
    """

    name: str
    title: str
    scale: float = 1.0
    digits: int | None = None
    published: str = ""
    ratio: bool = True
    lower_is_better: bool = False
    words: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Sheet:
    """Pictures that belong together: one model and what was made of it.

    Attributes
    ----------
    about : str
        Said beside its name.
    draw : callable
        ``draw(folder, options)``, importable by name: draws into the results folder and returns
        a list of dicts with ``label``, ``faces``, and the file of each style.
    options : mapping
    """

    about: str
    draw: Callable[[str, Mapping[str, Any]], list[dict[str, Any]]]
    options: Mapping[str, Any]


def _as_it_is(row: Row) -> Row:
    """Nothing is printed about the row."""
    return row


@dataclass(frozen=True)
class Experiment:
    """One published table or figure, answered by measurements.

    Attributes
    ----------
    id : str
        ``table-2.2``.
    title : str
    published : str
        Name of the CSV in ``experiments/published`` it answers; ``""``: none.
    data : tuple of str
        Registered meshes that it wants.
    cases : callable
        Plan -> cases, in the order of the table.
    columns : tuple of Column
        What the report's table shows, below a heading for each model.
    claims : tuple of Claim
    complete : callable
        Row -> row with what the publication says about it; runs after the case.
    figures : callable or None
        Rows that did not fail -> figures by name.
    sheets : callable or None
        Rows that did not fail -> pictures by the name of their model.
    notes : tuple of str
        What a reader must know to read the numbers.
    """

    id: str
    title: str
    published: str
    data: tuple[str, ...]
    cases: Callable[[Plan], Sequence[Case]]
    columns: tuple[Column, ...]
    claims: tuple[Claim, ...] = ()
    complete: Callable[[Row], Row] = _as_it_is
    figures: Callable[[Sequence[Row]], dict[str, Figure]] | None = None
    sheets: Callable[[Sequence[Row]], dict[str, Sheet]] | None = None
    notes: tuple[str, ...] = ()
