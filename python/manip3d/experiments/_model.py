"""Experiments: cases, a function that runs one, and claims about the rows."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from manip3d._util.checked import checked
from manip3d._util.json import canonical_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Row = dict[str, Any]
Note = str | Callable[[Sequence[Row]], str]
DataTier = Literal["auto", "real", "simulated"]
Scale = Literal["quick", "full"]


@dataclass(frozen=True)
class Plan:
    """Options of a run.

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
        """Return the name of its result: a hash of function, options, inputs and code.

        Parameters
        ----------
        inputs_sha256 : mapping of str to str
            SHA-256 of each input by its name.
        code : str
            Fingerprint of the code.
        """
        record = {
            "function": self.function,
            "options": dict(self.options),
            "inputs": dict(inputs_sha256),
            "code": code,
        }
        return hashlib.sha256(canonical_json(record)).hexdigest()[:32]


DATA_KINDS: dict[str, str] = {
    "published": "the published file",
    "stand-in": "a public file in the place of the published one",
    "recorded": "recorded data that stand for nothing published",
    "simulated": "simulated",
}
"""Data on which a row was measured: the values of ``data``, in words."""


@dataclass(frozen=True)
class Finding:
    """Verdict of one model (or other part) on a claim.

    Attributes
    ----------
    subject : str
    holds : bool or None
        None: not applicable there.
    numbers : str
        What was compared.
    data : str
        What it was measured on: one of `DATA_KINDS`, or several of them, separated by commas;
        filled in by `Claim.verdict`.
    unjudged : str
        Why this run cannot judge it although it applies: another file, too small a scale.
    """

    subject: str
    holds: bool | None
    numbers: str
    data: str = ""
    unjudged: str = ""


@dataclass(frozen=True)
class Verdict:
    """A claim judged: it holds if every applicable finding holds.

    Attributes
    ----------
    claim : str
    source : str
        Where the claim is made.
    findings : tuple of Finding
    unjudged : str
        Why the claim could not be judged: a case that it needs failed; ``""``: it could.
    reported : bool
        Whether the numbers are reported without any claim.
    """

    claim: str
    source: str
    findings: tuple[Finding, ...]
    unjudged: str = ""
    reported: bool = False

    @property
    def holds(self) -> bool | None:
        """True, False, or None where nothing applies or a case that the claim needs failed."""
        judged = [finding.holds for finding in self.findings if finding.holds is not None]
        return all(judged) if judged and not self.unjudged else None

    @property
    def word(self) -> str:
        """``holds``, ``does not hold``, ``undecided``, or why there is no verdict.

        Undecided: a published claim that fails on stand-ins or simulated data alone; only the
        published files can refute it. Without a verdict: ``not judged`` (a case failed),
        ``reported`` or ``not applicable``.
        """
        if self.unjudged:
            return "not judged"
        if self.holds is None:
            return "reported" if self.reported and self.findings else "not applicable"
        if self.holds:
            return "holds"
        refuted = any(self._refutes(finding) for finding in self.findings)
        return "does not hold" if refuted else "undecided"

    def _refutes(self, finding: Finding) -> bool:
        """An aim of ours can fail on any data, what is published only on what it was said of."""
        decisive = self.source.startswith("aim") or not finding.data or "published" in finding.data
        return finding.holds is False and decisive


def _every_row(_: Row) -> bool:
    """Return True: a claim needs every row unless it says otherwise.

    Parameters
    ----------
    _ : dict
        The row; it is not looked at.
    """
    return True


@dataclass(frozen=True)
class Claim:
    """Claim of a source as a predicate over an experiment's rows.

    Attributes
    ----------
    text : str
    source : str
        Table, figure or section that says so, or ``aim`` for one of our own.
    judge : callable
        Rows that did not fail -> findings. Each kind of data is judged apart, so that a verdict
        says on which data it rests.
    about : callable
        Tells whether the claim needs a row. It may look at options only, since failed rows have
        nothing else.
    data : tuple of str
        Kinds of data that can judge it: ``("published",)`` where it is about numbers of the
        published files. On other data the numbers are shown and nothing is judged.
    together : bool
        Judge rows of all kinds of data at once: for claims that compare them.
    reported : bool
        Numbers without a claim.
    """

    text: str
    source: str
    judge: Callable[[Sequence[Row]], Iterable[Finding]]
    about: Callable[[Row], bool] = _every_row
    data: tuple[str, ...] = tuple(DATA_KINDS)
    together: bool = False
    reported: bool = False

    def verdict(self, rows: Sequence[Row]) -> Verdict:
        """Judge the claim on the rows that it needs.

        Without any, or if one of them failed, the claim is not judged; what the other models say
        stands in the findings. Models with a failed case are left out, since judges compare whole
        models.

        Parameters
        ----------
        rows : sequence of dict
            All rows of the experiment.
        """
        needed = [row for row in rows if self.about(row)]
        if not needed:
            return Verdict(self.text, self.source, (), "there is no case", self.reported)
        failed = [row for row in needed if row.get("error")]
        incomplete = {row.get("model") for row in failed}
        whole = [row for row in needed if row.get("model") not in incomplete]
        unjudged = f"{counted(len(failed), 'case')} failed" if failed else ""
        findings: list[Finding] = []
        try:
            for kinds, group in self._by_data(whole):
                findings += self._found(kinds, group)
        except Exception as error:  # the report is written all the same, and says so
            unjudged = unjudged or f"the judge failed: {type(error).__name__}: {error}"
        findings += [
            Finding(_subject(row), None, f"failed: {row['error']}", _kind(row)) for row in failed
        ]
        return Verdict(self.text, self.source, tuple(findings), unjudged, self.reported)

    def _by_data(self, rows: Sequence[Row]) -> list[tuple[str, Sequence[Row]]]:
        kinds = [kind for kind in DATA_KINDS if any(_kind(row) == kind for row in rows)]
        if self.together or not rows:
            return [(", ".join(kinds), rows)]
        return [(kind, [row for row in rows if _kind(row) == kind]) for kind in kinds]

    def _found(self, kinds: str, rows: Sequence[Row]) -> Iterable[Finding]:
        for finding in self.judge(rows):
            if kinds and finding.holds is not None and not set(kinds.split(", ")) <= set(self.data):
                why = f"only {_listed(self.data)} can judge this"
                yield replace(finding, holds=None, data=kinds, unjudged=why)
            else:
                yield replace(finding, data=kinds)


def _kind(row: Row) -> str:
    return str(row.get("data", "simulated"))


def _listed(kinds: Sequence[str]) -> str:
    return " or ".join(DATA_KINDS[kind] for kind in kinds)


def _subject(row: Row) -> str:
    """Model, method and level of a row, as far as it has them."""
    words = (row.get(name) for name in ("model", "method", "level"))
    return " ".join(str(word) for word in words if word not in (None, ""))


@checked
def counted(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun in the singular or plural, for pages: ``1 face``, ``2 faces``.

    Parameters
    ----------
    number : int
        How many there are.
    noun : str
        The singular.
    plural : str
        The plural; empty: the singular and an ``s``.

    Returns
    -------
    str
        Groups of thousands are separated by a narrow no-break space, U+202F.

    Raises
    ------
    InputError
        ``number`` is not an integer.

    Examples
    --------
    >>> from manip3d.experiments import counted
    >>> counted(1, "face"), counted(2, "face"), counted(3, "mesh", "meshes")
    ('1 face', '2 faces', '3 meshes')
    """
    text = f"{number:,}".replace(",", "\u202f")
    return f"{text} {noun if number == 1 else plural or noun + 's'}"


@dataclass(frozen=True)
class Column:
    """Presentation of one value of the rows in a report.

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
    """Return the row without adding anything to it.

    Parameters
    ----------
    row : dict
        One result.
    """
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
    gather : callable or None
        Rows of cases, failed ones among them -> rows of the table, where cases are pieces of rows,
        so that a stopped run resumes within them; runs before `complete`.
    figures : callable or None
        Rows that did not fail -> figures by name.
    sheets : callable or None
        Rows that did not fail -> pictures by the name of their model.
    notes : tuple of str or callable
        What a reader must know to read the numbers. What depends on the run is a function of the
        rows that did not fail; ``""``: nothing to say.
    role : str
        What its data are, where cases do not say it.
    split : str
        Key in the rows by whose values the report makes several tables; ``""``: one table.
    """

    id: str
    title: str
    published: str
    data: tuple[str, ...]
    cases: Callable[[Plan], Sequence[Case]]
    columns: tuple[Column, ...]
    claims: tuple[Claim, ...] = ()
    complete: Callable[[Row], Row] = _as_it_is
    gather: Callable[[Sequence[Row]], list[Row]] | None = None
    figures: Callable[[Sequence[Row]], dict[str, Figure]] | None = None
    sheets: Callable[[Sequence[Row]], dict[str, Sheet]] | None = None
    notes: tuple[Note, ...] = ()
    role: str = ""
    split: str = ""
