"""Experiments: cases, a function that runs one, and claims about the rows."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

from manip3d._util import texts
from manip3d._util.checked import checked
from manip3d._util.json import canonical_json
from manip3d._util.reprs import short_repr

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
        ``auto``: real data that is present, simulated models in place of the rest; ``real``: real
        data only; ``simulated``: simulated models
        only. Experiments without such data are skipped.
    scale : 'quick' or 'full'
        ``quick``: few small cases, for a first look; ``full``: all cases.
    seed : int
        Seed of every random choice of the cases.
    """

    data: DataTier = "auto"
    scale: Scale = "full"
    seed: int = 0

    def street(self, number: int) -> int:
        """Return the number of a simulated street; no seed has a street of another seed.

        Parameters
        ----------
        number : int
            The street's number with seed 0.

        Returns
        -------
        int

        Examples
        --------
        >>> from manip3d.experiments import Plan
        >>> Plan(seed=2).street(91_000)
        2091000
        """
        return number + 1_000_000 * self.seed


@dataclass(frozen=True)
class Case:
    """One unit of work: a function of a module and its options.

    Attributes
    ----------
    run : callable
        ``run(case) -> dict``, importable by name. Values that are a `Mesh` or `bytes` are stored in
        files of their own; all others are JSON values.
    options : mapping of JSON values
        Everything that the result depends on, including seeds, except code and `inputs`. The
        option ``files`` holds the SHA-256 of each file that the case opens by its path, by this
        path relative to the data root (`_recorded.sums`).
    inputs : tuple of str
        Names of the registered data sets that the case opens by name.
    """

    run: Callable[[Case], Row]
    options: Mapping[str, Any]
    inputs: tuple[str, ...] = ()

    @property
    def function(self) -> str:
        """``module:name`` of `run`."""
        return f"{self.run.__module__}:{self.run.__qualname__}"

    @property
    def data(self) -> str:
        """Kind of data, one of `DATA_KINDS`: the option ``data``, or by whether it has inputs."""
        return str(self.options.get("data", "recorded" if self.inputs else "simulated"))

    @property
    def files(self) -> Mapping[str, str]:
        """SHA-256 of the files that the case opens by path: the option ``files``."""
        return dict(self.options.get("files", {}))

    def key(self, inputs_sha256: Mapping[str, str], code: str) -> str:
        """Return the name of the stored result: a hash of function, options, inputs and code.

        Parameters
        ----------
        inputs_sha256 : mapping of str to str
            SHA-256 of each input, by its name.
        code : str
            Hash of the code.
        """
        record = {
            "function": self.function,
            "options": dict(self.options),
            "inputs": dict(inputs_sha256),
            "code": code,
        }
        return hashlib.sha256(canonical_json(record)).hexdigest()[:32]


_NOUNS = {"stand-in": "stand-ins", "recorded": "recorded data", "simulated": "simulated data"}
"""Nouns for the kinds of data that do not decide a claim about the published files."""

DATA_KINDS: dict[str, str] = {
    "published": "the published file",
    "stand-in": "a public file in the place of the published one",
    "recorded": "recorded data that stand for nothing published",
    "simulated": "simulated",
}
"""Kinds of data on which a row can be measured (values of ``data``), with their descriptions."""


@dataclass(frozen=True)
class Finding:
    """Result of a claim for one model or another part of the rows.

    Attributes
    ----------
    subject : str
        The model or part.
    holds : bool or None
        Whether the claim holds for it; None: not applicable, or not judged (`unjudged`).
    numbers : str
        The compared numbers.
    data : str
        Kind of data of the numbers: one of `DATA_KINDS`, or several of them, separated by commas;
        filled in by `Claim.verdict` if the judge does not state it.
    unjudged : str
        Reason why this run cannot judge the claim although it applies, such as another file, a
        missing one or too small a scale; ``""``: it can.
    """

    subject: str
    holds: bool | None
    numbers: str
    data: str = ""
    unjudged: str = ""


@dataclass(frozen=True)
class Verdict:
    """Verdict on a claim, which holds if every applicable finding holds on some kind of data.

    Attributes
    ----------
    claim : str
        Text of the claim.
    source : str
        Table, figure or section that makes the claim.
    findings : tuple of Finding
    unjudged : str
        Reason why the claim could not be judged, such as a failed case; ``""``: it was judged.
    reported : bool
        Whether the numbers are reported without any claim.
    """

    claim: str
    source: str
    findings: tuple[Finding, ...]
    unjudged: str = ""
    reported: bool = False

    __repr__ = short_repr

    @property
    def holds(self) -> bool | None:
        """True or False; None if no finding applies or if a case that the claim needs failed.

        None, too, if on each kind of data some finding applies that could not be judged.
        """
        if self.unjudged or not self.judged_on:
            return None
        if any(finding.holds is False for finding in self.findings):
            return False
        return True if self._confirmed_on else None

    @property
    def judged_on(self) -> tuple[str, ...]:
        """Kinds of data on which findings were judged, each of them once."""
        judged = (finding.data for finding in self.findings if finding.holds is not None)
        return tuple(dict.fromkeys(kind for data in judged for kind in data.split(", ")))

    @property
    def _confirmed_on(self) -> list[str]:
        """Kinds of data, as in `Finding.data`, on which all that applies was judged and holds."""
        open_on = {f.data for f in self.findings if f.unjudged or f.holds is False}
        return list(
            dict.fromkeys(f.data for f in self.findings if f.holds and f.data not in open_on)
        )

    @property
    def word(self) -> str:
        """``holds``, ``holds on ...``, ``does not hold``, ``undecided``, or why there is none.

        Only the published files decide a published claim, and any data an aim of this package.
        ``holds on simulated data`` (or ``stand-ins``, ``recorded data``) means that a published
        claim holds on data that do not decide it. ``undecided`` means that it fails on such data,
        or that it was not refuted, but on each kind of data some finding could not be judged. If
        there is no verdict, the word is ``not judged`` (a case failed), ``reported`` or ``not
        applicable``.
        """
        if self.unjudged:
            return "not judged"
        if not self.judged_on and self.reported and self.findings:
            return "reported"
        if not self.judged_on and not any(finding.unjudged for finding in self.findings):
            return "not applicable"
        if self.holds:
            return self._holds_on(self._confirmed_on)
        refuted = any(f.holds is False and self._decides(f.data) for f in self.findings)
        return "does not hold" if refuted else "undecided"

    def _holds_on(self, kinds: Sequence[str]) -> str:
        if any(self._decides(kind) for kind in kinds):
            return "holds"
        names = dict.fromkeys(_NOUNS.get(name, name) for kind in kinds for name in kind.split(", "))
        return f"holds on {' and '.join(names)}"

    def _decides(self, data: str) -> bool:
        return self.source.startswith("aim") or not data or "published" in data


def _every_row(_: Row) -> bool:
    """Return True: by default a claim needs every row.

    Parameters
    ----------
    _ : dict
        The row, which is not used.
    """
    return True


@dataclass(frozen=True)
class Claim:
    """Claim of a source as a predicate over an experiment's rows.

    Attributes
    ----------
    text : str
        The claim as a sentence.
    source : str
        Table, figure or section that makes the claim, or ``aim`` for an aim of this package.
    judge : callable
        Function from rows of cases that did not fail to findings. It is called for each kind of
        data separately, so that each finding is based on one kind.
    about : callable
        Function from a row to whether the claim needs it. It may use only the row's options,
        because failed rows have nothing else.
    data : tuple of str
        Kinds of data that can judge the claim: ``("published",)`` if it is about numbers of the
        published files. On other data the numbers are shown without a judgement.
    together : bool
        Judge rows of all kinds of data in one call, for claims that compare them.
    reported : bool
        Report numbers without a claim.
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

        If there is no such row, or if one of them failed, the claim is not judged, but the findings
        contain the results of the other models. Models with a failed case are left out, because
        judges compare all methods of a model.

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
        except Exception as error:  # the report is still written, and contains the error
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
                yield replace(finding, data=finding.data or kinds)


def _kind(row: Row) -> str:
    return str(row.get("data", "simulated"))


def _listed(kinds: Sequence[str]) -> str:
    return " or ".join(DATA_KINDS[kind] for kind in kinds)


def _subject(row: Row) -> str:
    """Return model, method and level of a row, without those that it lacks."""
    words = (row.get(name) for name in ("model", "method", "level"))
    return " ".join(str(word) for word in words if word not in (None, ""))


@checked
def counted(number: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun in the singular or plural, such as ``1 face``, ``2 faces``.

    Parameters
    ----------
    number : int
        The count.
    noun : str
        The noun in the singular.
    plural : str
        The noun in the plural; empty: the singular with an ``s``.

    Returns
    -------
    str
        The text, in which groups of thousands are separated by a narrow no-break space, U+202F.

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
    return texts.counted(number, noun, plural, separator="\u202f")


@dataclass(frozen=True)
class Column:
    """Presentation of one value of the rows in a report.

    Attributes
    ----------
    name : str
        Key of the value in the row.
    title : str
        Heading of the column.
    scale : float
        Factor by which the value is multiplied before it is shown.
    digits : int or None
        Number of decimals; None: the value is not rounded.
    published : str
        Key of the published value that is shown next to it; ``""``: none.
    ratio : bool
        Whether the ratio of both values is shown, too, if they were measured on the same file.
    lower_is_better : bool
        Whether the report marks each model's lowest value among rows whose ``reached`` is not
        false.
    words : mapping of str to str
        Texts shown in place of values that are words.
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
    """Group of pictures of one model and its results.

    Attributes
    ----------
    about : str
        Description shown next to the model's name.
    draw : callable
        ``draw(folder, options)``, importable by name, which draws into the results folder and
        returns a list of dicts with ``label``, ``faces``, and the file of each style.
    options : mapping
        Second argument of ``draw``.
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
        Name such as ``table-2.2``.
    title : str
        Heading in the report.
    published : str
        Name of the CSV in ``experiments/published`` that is reproduced; ``""``: none.
    data : tuple of str
        Names of the registered data sets that it uses if present.
    cases : callable
        Function from a plan to cases, in the order of the table.
    columns : tuple of Column
        Columns of the report's table, which has a heading for each model.
    claims : tuple of Claim
        Claims to judge.
    complete : callable
        Function that adds published values to a row; runs after the case.
    gather : callable or None
        Function from the rows of all cases, including failed ones, to rows of the table. It is
        needed if several cases form one row, so that a stopped run can resume within a row; runs
        before `complete`.
    figures : callable or None
        Function from the rows that did not fail to figures by name.
    sheets : callable or None
        Function from the rows that did not fail to pictures by the name of their model.
    notes : tuple of str or callable
        Explanations of the numbers. A note that depends on the run is a function of the rows that
        did not fail; it may return ``""`` for no note.
    role : str
        Description of the data, for cases that do not give one.
    split : str
        Key in the rows; the report makes one table for each of its values. ``""``: one table.
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

    def __repr__(self) -> str:
        return f"<manip3d.experiments.Experiment: {self.id}; {self.title}>"


def by_model(rows: Sequence[Row]) -> Iterator[tuple[str, dict[str, Row]]]:
    """Yield each model with its rows by method, in the order of the table."""
    groups: dict[str, dict[str, Row]] = {}
    for row in rows:
        groups.setdefault(row["model"], {})[row["method"]] = row
    yield from groups.items()
