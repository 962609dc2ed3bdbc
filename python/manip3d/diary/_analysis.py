"""Analysis of a study: changes of the McGill index from baseline, responders and adherence."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.reprs import short_repr
from manip3d._util.shares import clopper_pearson
from manip3d.diary._diary import Diary
from manip3d.diary._protocol import Adherence, Protocol, adherence
from manip3d.diary._records import Occasion, day_of, local_day
from manip3d.errors import InputError

OCCASIONS = tuple(name for name in get_args(Occasion) if name != "other")
_LEVEL = 0.95
_RATIO_MAX = 1e6  # largest ratio of the variances between and within participants


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % confidence interval.

    Attributes
    ----------
    value, low, high : float
        The number and the ends of its interval.
    p : float
        p-value of a two-sided t test that the number is 0.
    df : float
        Degrees of freedom of its t distribution.
    """

    value: float
    low: float
    high: float
    p: float
    df: float

    __repr__ = short_repr


@dataclass(frozen=True)
class Share:
    """A share of participants with its exact (Clopper-Pearson) 95 % interval.

    Attributes
    ----------
    number, of : int
        The share is ``number`` / ``of``.
    low, high : float
        Ends of the interval.
    """

    number: int
    of: int
    low: float
    high: float


@dataclass(frozen=True)
class MixedModel:
    """Mixed model: score = mean of the occasion + random intercept of the participant + noise.

    Attributes
    ----------
    means : tuple of float
        Mean score of each occasion.
    changes : tuple of Estimate
        Change from the first occasion to each other one.
    sd_between, sd_within : float
        Standard deviations of the participants' levels, and of a participant's scores about their
        own level.
    participants, scores : int
        Numbers of participants and of scores that the model was fitted to.
    """

    means: tuple[float, ...]
    changes: tuple[Estimate, ...]
    sd_between: float
    sd_within: float
    participants: int
    scores: int

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class DiaryAnalysis:
    """Results of the diaries of a study.

    Attributes
    ----------
    identifiers : tuple of str
    scores : (N, 3) float64
        Pain rating index of each participant at baseline, week 1 and week 4; NaN: none.
    model : MixedModel or None
        Mixed model of the scores at ``model_occasions``; None: it cannot be fitted, and
        ``why_no_model`` says why.
    paired : tuple of (Estimate or None)
        Mean changes from baseline to week 1 and to week 4 of participants with both scores, with
        the t interval of paired differences. This interval stays valid if participants respond
        differently. None: there are fewer than two of them, or all have the same change, which does
        not show how changes vary; ``why_not_paired`` says which.
    responders_30, responders_50 : Share
        Participants whose index fell by at least 30 or 50 % from baseline to week 4, among those
        with both scores. A participant with an index of 0 at baseline counts as without response,
        because nothing can fall from 0 and leaving out those who got worse would raise the share.
    adherence : mapping of str to Adherence
        Adherence of each participant.
    adherence_slope : Estimate or None
        Slope of the least-squares line of the index's change to week 4 over adherence, in points
        per whole protocol. None: fewer than three participants have both scores, or their adherence
        is equal; ``why_no_slope`` says which.
    why_no_model, why_no_slope : str
        Reason for which there is no model or no slope so far; empty if there is one.
    why_not_paired : tuple of str
        The same reason for each entry of ``paired``.
    model_occasions : tuple of str
        Occasions at which somebody has a score, and which a model is of; without baseline or a
        later one there is no model.
    num_without_pain : int
        Number of those with both scores whose index is 0 at baseline.
    """

    identifiers: tuple[str, ...]
    scores: NDArray[np.float64]
    model: MixedModel | None
    paired: tuple[Estimate | None, ...]
    responders_30: Share
    responders_50: Share
    adherence: Mapping[str, Adherence]
    adherence_slope: Estimate | None
    why_no_model: str = ""
    why_not_paired: tuple[str, ...] = ("", "")
    why_no_slope: str = ""
    model_occasions: tuple[str, ...] = OCCASIONS
    num_without_pain: int = 0

    __repr__ = short_repr


@checked
def fit_mixed_model(scores: ArrayLike) -> MixedModel:
    """Fit a mixed model with a random intercept by restricted maximum likelihood.

    The standard error of a change is that of generalised least squares at the estimated variances,
    sqrt(c' (X' V^-1 X)^-1 c), as in other programs. Intervals use the t distribution with
    Satterthwaite's degrees of freedom (Giesbrecht and Burns 1985), because intervals of the normal
    distribution are too short for ten participants. For complete data they equal those of the
    analysis of variance with repeated measures. In 2000 simulated studies of ten participants the
    intervals contained the true value in 95 % of the studies. If participants respond differently
    (standard deviation of 8 points, noise of 4), the share at week 4 was only 89 %, but 95 % for
    `DiaryAnalysis.paired`, which is preferable in this case. It is not if many scores are missing:
    ``paired`` leaves out participants without both scores, and is biased if it depends on earlier
    scores who has a later one; the model uses all scores and allows for that.

    Parameters
    ----------
    scores : (N, T) float
        Scores of N participants at T occasions; NaN: missing.

    Returns
    -------
    MixedModel

    Raises
    ------
    InputError
        The array has another shape, a score is infinite, an occasion has no score, fewer than two
        participants have two scores each, there are no more scores than parameters for participants
        and occasions, or the scores have no noise.
    MissingExtraError
        scipy is not installed.

    Examples
    --------
    >>> from manip3d.diary import fit_mixed_model
    >>> model = fit_mixed_model([[40, 35, 30], [30, 26, 22], [50, 47, 36]])
    >>> round(model.changes[1].value, 2)
    -10.67
    """
    table = np.asarray(scores, np.float64)
    if table.ndim != 2 or table.shape[1] < 2:
        raise InputError(f"scores: expected (N, T) with T >= 2, got {table.shape}")
    if np.isinf(table).any():
        raise InputError("scores: expected finite numbers or NaN")
    seen = ~np.isnan(table)
    if not seen.any(axis=0).all():
        raise InputError("scores: expected a score of somebody at each occasion")
    if (seen.sum(axis=1) >= 2).sum() < 2:
        raise InputError("scores: expected two participants with two scores each")
    who, when = np.nonzero(seen)
    y = table[seen]
    design = (when[:, None] == np.arange(table.shape[1])).astype(np.float64)
    people = (who[:, None] == np.arange(len(table))).astype(np.float64)
    if np.linalg.matrix_rank(np.hstack([design, people])) == len(y):
        raise InputError(f"scores: expected more of them to tell the noise, got {len(y)}")
    together = (who[:, None] == who).astype(np.float64)  # J: 1 for two scores of one participant
    ratio = _best_ratio(y, design, together)
    beta, squares, inverse, _ = _generalised(y, design, together, ratio)
    within = squares / (len(y) - design.shape[1])
    if ratio > 0.5 * _RATIO_MAX or within <= 1e-12 * max(float(y @ y), 1e-300):
        raise InputError("scores: expected scores that vary; these follow the means exactly")
    variance = within * inverse  # of beta
    changes = []
    for occasion in range(1, table.shape[1]):
        contrast = np.zeros(table.shape[1])
        contrast[[0, occasion]] = -1.0, 1.0
        df = _satterthwaite(design, together, within, ratio * within, contrast)
        spread = math.sqrt(float(contrast @ variance @ contrast))
        changes.append(_t_estimate(float(contrast @ beta), spread, df))
    return MixedModel(
        means=tuple(beta.tolist()),
        changes=tuple(changes),
        sd_between=math.sqrt(ratio * within),
        sd_within=math.sqrt(within),
        participants=len(np.unique(who)),
        scores=len(y),
    )


def _generalised(
    y: NDArray[np.float64],
    design: NDArray[np.float64],
    together: NDArray[np.float64],
    ratio: float,
) -> tuple[NDArray[np.float64], float, NDArray[np.float64], float]:
    """Solve generalised least squares for the covariance V = I + ratio J.

    With the residuals r = y - X beta, return beta, r' V^-1 r, (X' V^-1 X)^-1 and
    log|V| + log|X' V^-1 X|.
    """
    covariance = np.eye(len(y)) + ratio * together
    weights = np.linalg.inv(covariance)
    information = design.T @ weights @ design
    inverse = np.linalg.inv(information).astype(np.float64)
    beta = inverse @ (design.T @ weights @ y)
    residual = y - design @ beta
    logs = float(np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1])
    return beta, float(residual @ weights @ residual), inverse, logs


def _best_ratio(
    y: NDArray[np.float64], design: NDArray[np.float64], together: NDArray[np.float64]
) -> float:
    """Find the ratio of the two variances at which the restricted likelihood is largest."""
    from scipy.optimize import minimize_scalar

    free = len(y) - design.shape[1]

    def deviance(ratio: float) -> float:
        _, squares, _, logs = _generalised(y, design, together, ratio)
        return float(free * math.log(max(squares, 1e-300)) + logs)

    def of_logarithm(logarithm: float) -> float:
        return deviance(math.exp(logarithm))

    found = minimize_scalar(
        of_logarithm, bounds=(math.log(1e-4), math.log(_RATIO_MAX)), method="bounded",
        options={"xatol": 1e-5},
    )  # fmt: skip
    ratio = math.exp(float(found.x))
    return ratio if deviance(ratio) < deviance(0.0) else 0.0


def _satterthwaite(
    design: NDArray[np.float64],
    together: NDArray[np.float64],
    within: float,
    between: float,
    contrast: NDArray[np.float64],
) -> float:
    """Return Satterthwaite's degrees of freedom 2 f^2 / (g' I^-1 g) of a contrast.

    f is the contrast's variance, g its gradient with respect to the two variances, and I the
    restricted information of the variances, I_jk = tr(P V_j P V_k) / 2.
    """
    parts = (np.eye(len(design)), together)
    weights = np.linalg.inv(within * parts[0] + between * parts[1])
    inverse = np.linalg.inv(design.T @ weights @ design)
    projection = weights - weights @ design @ inverse @ design.T @ weights
    projected = [projection @ part for part in parts]
    information = [[0.5 * float(np.sum(a * b.T)) for b in projected] for a in projected]
    seen = weights @ design @ inverse @ contrast
    gradient = np.array([float(seen @ part @ seen) for part in parts])
    value = float(contrast @ inverse @ contrast)
    return 2.0 * value**2 / float(gradient @ np.linalg.solve(np.array(information), gradient))


def _t_estimate(value: float, spread: float, df: float) -> Estimate:
    from scipy import special

    if spread == 0.0:
        return Estimate(value, value, value, float(value == 0.0), df)
    half = spread * float(special.stdtrit(df, 0.5 + _LEVEL / 2))
    p = 2.0 * float(special.stdtr(df, -abs(value / spread)))
    return Estimate(value, value - half, value + half, p, df)


def _share(number: int, of: int) -> Share:
    """Return a share with its exact (Clopper-Pearson) confidence interval."""
    return Share(number, of, *clopper_pearson(number, of, _LEVEL))


def _paired(change: NDArray[np.float64]) -> tuple[Estimate | None, str]:
    """Return the mean change with the t interval of paired differences, or why there is none."""
    if len(change) < 2:
        return None, f"expected two participants with both scores, got {len(change)}"
    if np.ptp(change) == 0.0:
        return None, (
            f"all {len(change)} participants have the same change, {change[0]:+.0f}, which does "
            "not show how changes vary"
        )
    spread = float(np.std(change, ddof=1)) / math.sqrt(len(change))
    return _t_estimate(float(np.mean(change)), spread, len(change) - 1.0), ""


def _why_no_slope(change: NDArray[np.float64]) -> str:
    """Return why no slope over adherence was fitted to the changes of those with both scores."""
    if len(change) < 3:
        return f"expected three participants with both scores, got {len(change)}"
    return "all participants with both scores have the same adherence"


def fit_slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> Estimate | None:
    """Fit the least-squares slope; None: fewer than three points, or all at the same x."""
    known = ~(np.isnan(x) | np.isnan(y))
    x, y = x[known], y[known]
    if len(x) < 3 or float(np.ptp(x)) < 1e-9:
        return None
    off = x - x.mean()
    value = float(off @ y / (off @ off))
    residual = y - y.mean() - value * off
    df = len(x) - 2.0
    return _t_estimate(value, math.sqrt(float(residual @ residual) / df / float(off @ off)), df)


@checked
def analyse(
    diary: Diary, *, today: date | None = None, protocol: Protocol | None = None
) -> DiaryAnalysis:
    """Analyse all participants of a diary.

    Parameters
    ----------
    diary : Diary
    today : date, optional
        Last day on which sessions were due, in this machine's time zone; default: today, or the day
        of the enrolment where this is later.
    protocol : Protocol, optional
        Protocol of the study.

    Returns
    -------
    DiaryAnalysis

    Raises
    ------
    InputError
        Nobody is enrolled, a participant was enrolled after the given ``today``, or this has a
        time.
    MissingExtraError
        scipy is not installed.

    Examples
    --------
    >>> from manip3d.diary import Diary, analyse
    >>> with Diary("study.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     _ = diary.add_mcgill("P01", [1] * 20, 3, occasion="baseline")
    ...     _ = diary.add_mcgill("P01", [0] * 20, 0, occasion="week-4")
    ...     analyse(diary).responders_50.number
    1
    """
    if today is not None:
        day_of(today)
    imported("scipy.special", "diary")
    people = diary.participants()
    if not people:
        raise InputError("diary: expected participants, got none")
    scores = np.full((len(people), len(OCCASIONS)), np.nan)
    kept = {}
    for number, person in enumerate(people):
        for filled in diary.mcgill(person.identifier):
            if filled.occasion in OCCASIONS:
                scores[number, OCCASIONS.index(filled.occasion)] = filled.score.pri
        day = today or max(date.today(), local_day(person.enrolled))
        kept[person.identifier] = adherence(
            diary.sessions(person.identifier), person.enrolled, day, protocol=protocol
        )
    model, occasions, why = _fit_existing(scores)
    first, last = scores[:, 0], scores[:, -1]
    both = ~np.isnan(first + last)
    changes = [change[~np.isnan(change)] for change in (scores[:, 1:] - first[:, None]).T]
    paired, why_not_paired = zip(*map(_paired, changes), strict=True)
    shares = np.array([kept[person.identifier].share for person in people])
    slope = fit_slope(shares, last - first)
    return DiaryAnalysis(
        tuple(person.identifier for person in people),
        scores,
        model,
        paired,
        _responders(first[both], last[both], 0.3),
        _responders(first[both], last[both], 0.5),
        kept,
        slope,
        why,
        why_not_paired,
        _why_no_slope(changes[-1]) if slope is None else "",
        occasions,
        int((first[both] == 0).sum()),
    )


def _fit_existing(
    scores: NDArray[np.float64],
) -> tuple[MixedModel | None, tuple[str, ...], str]:
    """Fit the model to the occasions at which somebody has a score.

    Returns
    -------
    MixedModel or None
    tuple of str
        The occasions of the model.
    str
        Reason for which there is no model; empty if there is one.
    """
    exist = np.asarray((~np.isnan(scores)).any(axis=0))
    occasions = tuple(name for name, some in zip(OCCASIONS, exist, strict=True) if some)
    if len(occasions) < 2 or not exist[0]:
        return None, occasions, "expected scores at baseline and at a later occasion"
    try:
        return fit_mixed_model(scores[:, exist]), occasions, ""
    except InputError as error:  # there are too few scores so far
        return None, occasions, str(error).removeprefix("scores: ")


def _responders(first: NDArray[np.float64], last: NDArray[np.float64], least: float) -> Share:
    """Return the share of those whose score fell by at least a part of the first one."""
    fell = (first > 0) & (first - last >= (least - 1e-12) * first)
    return _share(int(fell.sum()), len(first))


@checked
def simulate_cohort(
    effects: Sequence[float] = (-4.0, -10.0),
    *,
    participants: int = 10,
    baseline: float = 38.0,
    sd_between: float = 8.0,
    sd_within: float = 4.0,
    sd_response: float = 0.0,
    missing: float = 0.0,
    seed: int = 0,
) -> NDArray[np.float64]:
    """Draw the pain rating indices of a study with a known effect.

    Parameters
    ----------
    effects : sequence of float
        Mean changes from baseline to each further occasion.
    participants : int
        Number of participants.
    baseline, sd_between, sd_within : float
        Mean at baseline, and standard deviations of the participants' levels and of a participant's
        scores about their own level.
    sd_response : float
        Standard deviation between participants of the effect at the last occasion; at earlier
        occasions in proportion.
    missing : float
        Probability that a score after baseline is missing, independent of the score.
    seed : int
        Seed of all random choices.

    Returns
    -------
    (N, T) float64
        Whole numbers from 0 to 78; NaN: missing.

    Raises
    ------
    InputError
        No participants or effects, a number that is not finite, a negative standard deviation or
        seed, or a probability outside of 0 to 1.

    Examples
    --------
    >>> from manip3d.diary import simulate_cohort
    >>> simulate_cohort().shape
    (10, 3)
    """
    if participants < 1 or len(effects) < 1:
        raise InputError("participants, effects: expected at least one of each")
    if not all(map(math.isfinite, (baseline, *effects))):
        raise InputError("baseline, effects: expected finite numbers")
    for name, value in (
        ("sd_between", sd_between), ("sd_within", sd_within), ("sd_response", sd_response),
        ("seed", seed),
    ):  # fmt: skip
        if not 0 <= value < math.inf:
            raise InputError(f"{name}: expected a finite number >= 0, got {value}")
    if not 0 <= missing < 1:
        raise InputError(f"missing: expected 0 to 1, got {missing}")
    random = np.random.default_rng(seed)
    mean = baseline + np.array([0.0, *effects])
    grows = np.arange(len(mean)) / (len(mean) - 1)
    level = sd_between * random.standard_normal((participants, 1))
    response = sd_response * random.standard_normal((participants, 1)) * grows
    noise = sd_within * random.standard_normal((participants, len(mean)))
    scores = np.clip(np.rint(mean + level + response + noise), 0.0, 78.0)
    lost = random.random(scores.shape) < missing
    lost[:, 0] = False
    scores[lost] = np.nan
    return scores
