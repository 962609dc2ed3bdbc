"""Just noticeable difference of simplification, measured by staircases (section 2.6)."""

from __future__ import annotations

import csv
import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.csv_tables import csv_records
from manip3d._util.extras import imported
from manip3d._util.options import generator_of
from manip3d._util.paths import refuse_existing
from manip3d._util.reprs import short_repr
from manip3d._util.texts import float_or_nan
from manip3d.errors import FormatError, InputError
from manip3d.study._definition import Common, Section
from manip3d.study._engine import Study, next_screen_step
from manip3d.study._psychometric import (
    Estimate,
    SimulatedObserver,
    estimate_threshold,
)
from manip3d.study._replacing import refuse_other_stimuli
from manip3d.study._steps import Field, Step, Value
from manip3d.study._store import Session

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Rng
    from manip3d.mesh import Mesh

    Floats = NDArray[np.float64]

METHODS = ("qem_orig", "qem_bp", "qem_tp", "qem_btp", "qem4vr")
"""Simplification methods by their names in `manip3d.simplify`."""

CLASSES = ("manifold", "boundaries", "non-manifold")
"""Kinds of models: manifold without boundaries, manifold with boundaries, non-manifold."""

LEVELS = "levels.csv"
"""File name of the table in a folder of stimuli, which lists model, method and level of files."""

Side = Literal["left", "right"]


@dataclass
class Staircase:
    """One-up-two-down staircase: harder after two right answers, easier after a wrong one.

    Levels are differences in polygon counts, percent of the original's. The staircase settles at
    the level at which it goes up as often as down: p(right)^2 = 1/2, the 70.7 % point [H. Levitt,
    Transformed up-down methods in psychoacoustics, J. Acoust. Soc. Am. 49, 1971].

    Attributes
    ----------
    level : int
        Level of the next comparison.
    step : int
        Amount by which the level changes.
    lowest, highest : int
        Bounds of the level.
    trials : list of (int, bool)
        Level and whether the answer was right.
    reversals : list of int
        Levels at which the direction changed.

    Examples
    --------
    >>> from manip3d.study import Staircase
    >>> stairs = Staircase(level=50)
    >>> for is_right in (True, True, False, True, True):
    ...     stairs.answer(is_right)
    >>> stairs.level, stairs.reversals
    (45, [45, 50])
    """

    level: int
    step: int = 5
    lowest: int = 5
    highest: int = 95
    trials: list[tuple[int, bool]] = field(default_factory=list)
    reversals: list[int] = field(default_factory=list)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        self._right = 0
        self._direction = 0

    def answer(self, is_right: bool, shown: int | None = None) -> None:
        """Record the answer to the comparison at `level`.

        Parameters
        ----------
        is_right : bool
            Whether the participant chose the original.
        shown : int, optional
            Difference that was shown, percent, if it is not that of `level`. It is recorded in
            place of the level.
        """
        shown = self.level if shown is None else shown
        self.trials.append((shown, is_right))
        if is_right:
            self._right += 1
            if self._right < 2:
                return
        direction = -1 if is_right else 1
        self._right = 0
        if self._direction not in (0, direction):
            self.reversals.append(shown)
        self._direction = direction
        self.level = min(self.highest, max(self.lowest, self.level + direction * self.step))


@dataclass(frozen=True)
class Rules:
    """Stopping rules of a staircase.

    Attributes
    ----------
    start, step, lowest, highest : int
        First level, change of the level, and bounds of it; percent of the original's polygons.
    reversals : int
        Number of reversals after which a staircase ends.
    most_trials : int
        Number of comparisons after which it ends in any case.
    """

    start: int = 50
    step: int = 5
    lowest: int = 5
    highest: int = 95
    reversals: int = 12
    most_trials: int = 80

    def begin(self) -> Staircase:
        """Return a new staircase."""
        return Staircase(self.start, self.step, self.lowest, self.highest)

    def is_over(self, stairs: Staircase) -> bool:
        """Return whether the staircase has enough reversals or the largest number of comparisons.

        Parameters
        ----------
        stairs : Staircase
            The staircase so far.
        """
        return len(stairs.reversals) >= self.reversals or len(stairs.trials) >= self.most_trials


@checked
def simulate_staircase(
    observer: SimulatedObserver, *, rules: Rules | None = None, rng: Rng = None
) -> Staircase:
    """Run a staircase with a simulated observer to its end.

    Parameters
    ----------
    observer : SimulatedObserver
    rules : Rules, optional
        Rules of the staircase.
    rng : int, Generator or None
        Seed or generator; None: other answers each time.

    Returns
    -------
    Staircase

    Raises
    ------
    InputError
        ``rng`` is not a seed.

    Examples
    --------
    >>> from manip3d.study import SimulatedObserver, simulate_staircase
    >>> stairs = simulate_staircase(SimulatedObserver(30.0), rng=3)
    >>> len(stairs.reversals)
    12
    """
    rules = rules or Rules()
    random = generator_of(rng)
    stairs = rules.begin()
    while not rules.is_over(stairs):
        stairs.answer(bool(random.random() < observer.probability(stairs.level)))
    return stairs


@dataclass(frozen=True)
class JndModel:
    """A mesh of a JND study.

    Attributes
    ----------
    name : str
    file : str
        Path relative to the definition, or ``data:`` and the name of a public mesh.
    kind : str
        One of `CLASSES`.
    up : {"y", "z"}
        The mesh's axis that points upwards, about which it turns.
    """

    name: str
    file: str
    kind: str
    up: str = "y"


def _models(own: Section) -> tuple[JndModel, ...]:
    """Read the models of a definition."""
    models = []
    for section in own.sections("models", most=30):
        models.append(
            JndModel(
                section.name("name"),
                section.text("file"),
                section.word("class", CLASSES),
                section.word("up", ("y", "z"), "y"),
            )
        )
        section.finish()
    names = [model.name for model in models]
    if len(set(names)) != len(names):
        own.fail("models", "names that differ")
    return tuple(models)


def _rules(own: Section) -> Rules:
    """Read the rules of the staircases; whole steps must lead from the start to both bounds."""
    step = own.whole("step_percent", 1, 25, 5)
    rules = Rules(
        step=step,
        lowest=own.whole("lowest_percent", 1, 95, step),
        highest=own.whole("highest_percent", 5, 99, 95),
        start=own.whole("start_percent", 1, 99, 50),
        reversals=own.whole("reversals", 2, 100, 12),
        most_trials=own.whole("most_trials", 2, 1000, 80),
    )
    if not rules.lowest <= rules.start <= rules.highest:
        own.fail("start_percent", "a level between the lowest and the highest")
    for end in (rules.lowest, rules.highest):
        if (rules.start - end) % step:
            own.fail("step_percent", "levels that lead from the start to both ends")
    return rules


@dataclass(frozen=True)
class JndStudy(Study):
    """A study of just noticeable differences.

    Attributes
    ----------
    common : Common
    models : sequence of JndModel
    methods : sequence of str
        Some of `METHODS`.
    rules : Rules
        Rules of the staircases.
    size_deg : float
        Width of each mesh's pane in visual degrees.
    turn_s : float
        Time of one revolution of a mesh, seconds.
    stimuli : Path or None
        Folder written by `make_jnd_stimuli`; None: the study is read for its answers only.
    base : Path or None
        Folder that the definition's relative paths start from.
    """

    common: Common
    models: tuple[JndModel, ...]
    methods: tuple[str, ...]
    rules: Rules
    size_deg: float
    turn_s: float
    stimuli: Path | None
    base: Path | None = None

    __repr__ = short_repr

    @classmethod
    def read(cls, top: Section, base: Path | None) -> JndStudy:
        """Read the study from a definition.

        Parameters
        ----------
        top : Section
            The whole definition.
        base : Path or None
            Folder that relative paths start from; None: the files of the stimuli are not needed.

        Raises
        ------
        FormatError
            A key is missing, unknown, or has a wrong value.
        """
        common = Common.read(top, ("jnd",))
        own = top.section("jnd")
        models = _models(own)
        methods = own.texts("methods", most=len(METHODS))
        if not set(methods) <= set(METHODS):
            own.fail("methods", f"some of {', '.join(METHODS)}")
        rules = _rules(own)
        stimuli = own.text("stimuli")
        found = cls(
            common=common,
            models=models,
            methods=methods,
            rules=rules,
            size_deg=own.number("size_deg", 1, 60, 12.0),
            turn_s=own.number("turn_s", 0, 60, 8.0),
            stimuli=None if base is None else base / stimuli,
            base=base,
        )
        own.finish()
        top.finish()
        return found

    @property
    def conditions(self) -> list[tuple[str, str]]:
        """Return model and method of each staircase."""
        return [(model.name, method) for model in self.models for method in self.methods]

    @property
    def levels(self) -> list[int]:
        """Return the differences that may be shown, percent."""
        return list(range(self.rules.lowest, self.rules.highest + 1, self.rules.step))

    def staircases(self, session: Session) -> list[Staircase]:
        """Return the state of each staircase of a participant.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """
        found = [self.rules.begin() for _ in self.conditions]
        places = {condition: n for n, condition in enumerate(self.conditions)}
        for answer in session.answers:
            truth = answer.condition
            if "method" in truth:
                found[places[truth["model"], truth["method"]]].answer(
                    answer.values["chosen"] == truth["original"], truth.get("reached_percent")
                )
        return found

    def next_step(self, session: Session) -> Step | None:
        """Return a comparison of a staircase that is not over, or first a measure of the screen.

        Staircase and side are drawn from the session and the number of its trials, so that a page
        that is opened again shows the same comparison.

        Parameters
        ----------
        session : Session
            The participant's answers so far.
        """
        staircases = self.staircases(session)
        open_ones = [n for n, stairs in enumerate(staircases) if not self.rules.is_over(stairs)]
        if not open_ones:
            return None
        if (measure := next_screen_step(session)) is not None:
            return measure
        trial = sum(len(stairs.trials) for stairs in staircases)
        # Staircases are interleaved at random, so that participants cannot follow one of them.
        rng = self.generator(session, f"trial {trial}")
        place = open_ones[int(rng.integers(len(open_ones)))]
        original: Side = "left" if rng.random() < 0.5 else "right"
        model, method = self.conditions[place]
        level = staircases[place].level
        reached = self._reached.get(file_of(model, method, level), level)
        files = [file_of(model), file_of(model, method, level)]
        if original == "right":
            files.reverse()
        side = Field(
            "chosen",
            "Which of the two has the higher visual quality?",
            "choice",
            (("left", "The left one"), ("right", "The right one")),
            is_side=True,
        )
        return Step(
            f"t{trial:04d}",
            f"Comparison {trial + 1}",
            (),
            (side,),
            tuple(self.stimulus(name) for name in files),
            size_deg=self.size_deg,
            turn_s=self.turn_s,
            condition={
                "model": model,
                "method": method,
                "difference_percent": level,
                "reached_percent": reached,
                "original": original,
            },
        )

    @functools.cached_property
    def _reached(self) -> dict[str, int]:
        """Differences of the stimuli that were made, whole percent; empty if none were.

        A method may stop before it has removed as many faces as the level says.

        Raises
        ------
        FormatError
            The table of the stimuli is damaged, or a stimulus does not differ from its original.
        """
        table = None if self.stimuli is None else self.stimuli / LEVELS
        if table is None or not table.is_file():
            return {}
        found = {}
        for row in csv_records(table, errors="replace"):
            percent = float_or_nan(row.get("reached_percent", ""))
            if not 0.0 < percent <= 100.0:
                raise FormatError(
                    f"{row.get('file')}: expected a difference from the original, got "
                    f"{row.get('reached_percent')} percent; 'manip3d study stimuli --force' "
                    "makes the stimuli anew",
                    file=str(table),
                )
            found[str(row.get("file"))] = max(1, round(percent))
        return found

    def check_stimuli(self) -> None:
        super().check_stimuli()
        _ = self._reached

    def progress(self, session: Session) -> float:
        reversals = sum(
            min(len(stairs.reversals), self.rules.reversals)
            if not self.rules.is_over(stairs)
            else self.rules.reversals
            for stairs in self.staircases(session)
        )
        return reversals / (self.rules.reversals * len(self.conditions))

    def files(self) -> Mapping[str, Path]:
        if self.stimuli is None:
            return {}
        names = [file_of(model.name) for model in self.models]
        names += [
            file_of(*condition, level) for condition in self.conditions for level in self.levels
        ]
        return {name: self.stimuli / name for name in names}

    def variables(self) -> Sequence[tuple[str, Field]]:
        found = []
        for place, (model, method) in enumerate(self.conditions):
            key, part = f"c{place + 1}", f"{model}, {method}"
            for suffix, label in (
                ("jnd", "JND, percent of the polygons"),
                ("low", "JND: 95 % interval, low end"),
                ("high", "JND: 95 % interval, high end"),
                ("trials", "Comparisons"),
            ):
                found.append(
                    (part, Field(f"{key}_{suffix}", f"{part}: {label}", "number", optional=True))
                )
        return found

    def wide(self, session: Session) -> dict[str, Value]:
        row: dict[str, Value] = {}
        for place, stairs in enumerate(self.staircases(session)):
            if not stairs.trials:
                continue
            found = estimate_threshold(stairs.trials)
            key = f"c{place + 1}"
            row[f"{key}_jnd"] = round(found.threshold, 3)
            row[f"{key}_low"], row[f"{key}_high"] = round(found.low, 3), round(found.high, 3)
            row[f"{key}_trials"] = len(stairs.trials)
        return row

    def simulate(self, session: Session, step: Step, rng: np.random.Generator) -> dict[str, Value]:
        if step.id == "screen":  # the only one of the study's own steps without a difference
            return {"card_px": 324.0, "distance_cm": 60.0}
        observer = SimulatedObserver(25.0 + 5.0 * self.methods.index(str(step.condition["method"])))
        is_right = rng.random() < observer.probability(float(step.condition["reached_percent"]))
        original = str(step.condition["original"])
        return {"chosen": original if is_right else {"left": "right", "right": "left"}[original]}

    def summary(self, sessions: Sequence[Session]) -> list[dict[str, Any]]:
        """Return thresholds: one row for each participant and staircase, then one for each method.

        Parameters
        ----------
        sessions : sequence of Session
            One per participant.

        Returns
        -------
        list of dict
            Participant (empty: the mean of all), model, method, JND in percent with its 95 %
            interval, numbers of comparisons and reversals, and the mean of the last reversals. The
            interval of a mean is Student's interval over the participants' means; None for fewer
            than two. Differences are those of the stimuli that were shown, which are smaller than
            wanted where a method could not remove more faces.
        """
        rows = []
        means: dict[str, list[float]] = {method: [] for method in self.methods}
        for session in sessions:
            own: dict[str, list[float]] = {method: [] for method in self.methods}
            for (model, method), stairs in zip(
                self.conditions, self.staircases(session), strict=True
            ):
                if not stairs.trials or not self.rules.is_over(stairs):
                    continue
                found = estimate_threshold(stairs.trials)
                own[method].append(found.threshold)
                rows.append(
                    {
                        "participant": session.participant,
                        "model": model,
                        "method": method,
                        "jnd_percent": found.threshold,
                        "low": found.low,
                        "high": found.high,
                        "comparisons": len(stairs.trials),
                        "reversals": len(stairs.reversals),
                        "reversal_mean": reversal_mean(stairs),
                    }
                )
            for method, values in own.items():
                if len(values) == len(self.models):
                    means[method].append(float(np.mean(values)))
        for method, values in means.items():
            low, high = mean_interval(values)
            rows.append(
                {
                    "participant": "",
                    "model": "",
                    "method": method,
                    "jnd_percent": float(np.mean(values)) if values else None,
                    "low": low,
                    "high": high,
                    "comparisons": len(values),
                    "reversals": None,
                    "reversal_mean": None,
                }
            )
        return rows


def file_of(model: str, method: str = "", difference: int = 0) -> str:
    """Return the file name of a stimulus: the original, or its simplification by a method."""
    return f"{model}.glb" if not difference else f"{model}-{method}-{100 - difference:02d}.glb"


@checked
def reversal_mean(stairs: Staircase) -> float | None:
    """Return the mean of the levels of the last reversals.

    Parameters
    ----------
    stairs : Staircase

    Returns
    -------
    float or None
        Mean over an even number of reversals, without the first two; None for fewer than four.

    Examples
    --------
    >>> from manip3d.study import Staircase, reversal_mean
    >>> stairs = Staircase(50)
    >>> stairs.reversals = [45, 50, 45, 60]
    >>> reversal_mean(stairs)
    52.5
    """
    levels = stairs.reversals[2:]
    levels = levels[len(levels) % 2 :]
    return float(np.mean(levels)) if len(levels) >= 2 else None


def mean_interval(values: Sequence[float]) -> tuple[float | None, float | None]:
    """Return Student's 95 % interval of a mean; None for fewer than two values."""
    if len(values) < 2:
        return None, None
    stats = imported("scipy.stats", "live")
    half = float(stats.t.ppf(0.975, len(values) - 1)) * float(np.std(values, ddof=1))
    half /= math.sqrt(len(values))
    return float(np.mean(values)) - half, float(np.mean(values)) + half


@checked
def paired_power(
    participants: int, effect: float, *, alpha: float = 0.05, comparisons: int = 1
) -> float:
    """Return the power of a paired t test of two methods' JNDs.

    Parameters
    ----------
    participants : int
        Number of participants, at least 2.
    effect : float
        Mean of the participants' differences over their standard deviation (Cohen's d_z).
    alpha : float
        Probability of an error of the first kind, two-sided, of all comparisons together.
    comparisons : int
        Number of comparisons among which ``alpha`` is shared evenly (Bonferroni).

    Returns
    -------
    float
        Probability that the test finds the effect, 0 to 1.

    Raises
    ------
    InputError
        A number is out of range.
    MissingExtraError
        SciPy is not installed.

    Examples
    --------
    >>> from manip3d.study import paired_power
    >>> round(paired_power(34, 0.5), 3)  # as in tables of power
    0.808
    """
    for name, value, low, high in (
        ("participants", participants, 2, 100_000),
        ("effect", effect, -100, 100),
        ("comparisons", comparisons, 1, 1000),
    ):
        if not low <= value <= high:
            raise InputError(f"{name}: expected {low} to {high}, got {value}")
    if not 0.0 < alpha < 1.0:
        raise InputError(f"alpha: expected between 0 and 1, got {alpha}")
    stats = imported("scipy.stats", "live")
    freedom = participants - 1
    critical = float(stats.t.ppf(1.0 - alpha / comparisons / 2.0, freedom))
    shifted = stats.nct(freedom, abs(effect) * math.sqrt(participants))  # the test is two-sided
    other_side = float(shifted.cdf(-critical))
    # For some effects far from 0 SciPy returns NaN for the other side, which is below 1e-20.
    return float(shifted.sf(critical)) + (0.0 if math.isnan(other_side) else other_side)


_MAX_PARTICIPANTS = 1 << 16  # the last power of two that `paired_power` accepts


@checked
def required_participants(
    effect: float, *, power: float = 0.8, alpha: float = 0.05, comparisons: int = 1
) -> int:
    """Return the smallest number of participants with which a paired t test has a given power.

    The test compares the just noticeable differences (JNDs) of two methods, as in `paired_power`.

    Parameters
    ----------
    effect : float
        Expected effect: the mean of the participants' differences over their standard deviation
        (Cohen's d_z); not 0.
    power : float
        Wanted probability that the test finds the effect, in (0, 1). The default of 0.8 is
        customary.
    alpha : float
        Probability of an error of the first kind, two-sided, of all comparisons together.
    comparisons : int
        Number of comparisons among which ``alpha`` is shared evenly (Bonferroni).

    Returns
    -------
    int
        At least 2.

    Raises
    ------
    InputError
        A number is out of range, or more than 65 536 participants would be needed.
    MissingExtraError
        SciPy is not installed.

    Examples
    --------
    >>> from manip3d.study import required_participants
    >>> required_participants(0.5)
    34
    """
    if not 0.0 < power < 1.0:
        raise InputError(f"power: expected between 0 and 1, got {power}")

    def is_enough(participants: int) -> bool:
        return paired_power(participants, effect, alpha=alpha, comparisons=comparisons) >= power

    # Power grows with the number of participants: double it until it is enough, then bisect.
    low, high = 2, 4
    while not is_enough(high):
        if high >= _MAX_PARTICIPANTS:
            raise InputError(
                f"effect: expected an effect that {_MAX_PARTICIPANTS} participants can show, "
                f"got {effect:g}"
            )
        low, high = high, 2 * high
    while low < high:
        middle = (low + high) // 2
        if is_enough(middle):
            high = middle
        else:
            low = middle + 1
    return low


@dataclass(frozen=True)
class JndLevel:
    """One stimulus of a JND study.

    Attributes
    ----------
    file : str
    model, method : str
    difference_percent : int
        Wanted difference in faces, percent of the original's number.
    faces : int
        Number of faces of the stimulus.
    reached_percent : float
        Actual difference, percent of the original's number of faces.
    """

    file: str
    model: str
    method: str
    difference_percent: int
    faces: int
    reached_percent: float


@checked
def make_jnd_stimuli(
    study: JndStudy, *, overwrite: bool = False, progress: Any = None
) -> list[JndLevel]:
    """Make the stimuli of a JND study: each model, and each model simplified to each level.

    Parameters
    ----------
    study : JndStudy
        A study that was read from a file. Its folder ``stimuli`` is written: one .glb file for each
        stimulus, and a table of them (`LEVELS`).
    overwrite : bool
        Replace the folder if it contains only such stimuli.
    progress : callable, optional
        Called with the fraction done and the name of the file.

    Returns
    -------
    list of JndLevel
        One for each model, method and level, in this order.

    Raises
    ------
    InputError
        The folder exists already or holds other files. A method does not apply to a model, or
        cannot remove as many of its faces as the first level of a staircase.
    FormatError, OSError
        A mesh cannot be read, or the folder cannot be written.
    """
    from manip3d.io._files import atomic_folder
    from manip3d.viewer._placement import Placement
    from manip3d.viewer.page import placed_glb

    if study.stimuli is None or study.base is None:
        raise InputError("study: expected a study that was read from a file")
    refuse_existing(study.stimuli, overwrite=overwrite)
    refuse_other_stimuli(study.stimuli, LEVELS)
    found: list[JndLevel] = []
    total = len(study.conditions) * len(study.levels)
    study.stimuli.parent.mkdir(parents=True, exist_ok=True)
    with atomic_folder(study.stimuli) as folder:
        for model in study.models:
            mesh = _mesh_of(model, study.base)
            placement = Placement.of(mesh)
            (folder / file_of(model.name)).write_bytes(placed_glb(mesh, placement))
            for method, level in itertools.product(study.methods, study.levels):
                made, light = _simplified(model, mesh, method, level, study.rules)
                (folder / made.file).write_bytes(placed_glb(light, placement))
                found.append(made)
                if progress is not None:
                    progress(len(found) / total, made.file)
        with (folder / LEVELS).open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(JndLevel.__dataclass_fields__)
            writer.writerows(vars(level).values() for level in found)
    return found


def _mesh_of(model: JndModel, base: Path) -> Mesh:
    """Read a model, a file below ``base`` or a public data set, with y up."""
    from manip3d.datasets import load_mesh
    from manip3d.io import read_mesh

    name = model.file.removeprefix("data:")
    is_public = name != model.file
    mesh = load_mesh(name) if is_public else read_mesh(base / model.file)
    return _turned_up(mesh) if model.up == "z" else mesh


def _simplified(
    model: JndModel, mesh: Mesh, method: str, level: int, rules: Rules
) -> tuple[JndLevel, Mesh]:
    """Simplify a model so that it has ``level`` percent fewer faces.

    Raises
    ------
    InputError
        The method refuses the model, or misses a level up to the start by half a step or more.
    """
    from manip3d import simplify

    target = max(1, round(mesh.num_faces * (100 - level) / 100))
    done = getattr(simplify, method)(mesh, target_faces=target)
    light = done.mesh
    reached = 100.0 * (1.0 - light.num_faces / max(mesh.num_faces, 1))
    if done.stop == "refused":
        raise InputError(
            f"models: expected models that {method} can simplify, got {model.name}: {done.message}"
        )
    if level <= rules.start and reached <= level - rules.step / 2:
        raise InputError(
            f"models: expected models of which {method} can remove {rules.start} % of the faces, "
            f"got {model.name}, of which it removes {reached:.1f} % in place of {level} %"
        )
    file = file_of(model.name, method, level)
    return JndLevel(file, model.name, method, level, light.num_faces, round(reached, 3)), light


def _turned_up(mesh: Mesh) -> Mesh:
    """Return a mesh with z up rotated so that y is up."""

    def turned(vectors: Floats) -> Floats:
        return np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)

    normals = None if mesh.normals is None else turned(mesh.normals)
    return mesh.replace(vertices=turned(mesh.vertices), normals=normals)


__all__ = [
    "Estimate",
    "JndLevel",
    "JndModel",
    "JndStudy",
    "Rules",
    "SimulatedObserver",
    "Staircase",
    "estimate_threshold",
    "make_jnd_stimuli",
    "paired_power",
    "required_participants",
    "simulate_staircase",
]
