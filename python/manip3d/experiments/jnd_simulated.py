"""Coverage of the confidence interval of a staircase's 70.7 % point, on simulated observers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from manip3d.experiments._model import Case, Claim, Column, Experiment, Finding, Plan, Row, counted

_LOW, _HIGH = 93.0, 97.0
_OBSERVED = 1000  # of fewer, the coverage may leave these limits by chance
_ALL = "mixed"
_EVEN = (1.5, 6.0)
_SPREAD = None  # log-normal: median 3, two thirds between 1.7 and 5.2

Ends = tuple[float, float]

# Thresholds, slopes and lapse rates of observers, drawn uniformly between two ends; and the law of
# the psychometric function.
_OBSERVERS: dict[str, tuple[Ends, Ends | None, Ends, str]] = {
    _ALL: ((10.0, 60.0), _SPREAD, (0.0, 0.05), "weibull"),
    "near 10 to 20 %": ((10.0, 20.0), _SPREAD, (0.0, 0.05), "weibull"),
    "near 40 to 60 %": ((40.0, 60.0), _SPREAD, (0.0, 0.05), "weibull"),
    "slopes 1.5 to 6": ((10.0, 60.0), _EVEN, (0.0, 0.05), "weibull"),
    "slope 1.5": ((10.0, 60.0), (1.5, 1.5), (0.0, 0.05), "weibull"),
    "slope 6": ((10.0, 60.0), (6.0, 6.0), (0.0, 0.05), "weibull"),
    "no lapses": ((10.0, 60.0), _SPREAD, (0.0, 0.0), "weibull"),
    "lapses of 8 %": ((10.0, 60.0), _SPREAD, (0.08, 0.08), "weibull"),
    "another law": ((10.0, 60.0), _SPREAD, (0.0, 0.05), "lognormal"),
}


def _cases(plan: Plan) -> list[Case]:
    count = {"full": _OBSERVED, "quick": 100}[plan.scale]
    return [
        Case(observe, {"model": name, "count": count, "seed": plan.seed}) for name in _OBSERVERS
    ]


def observe(case: Case) -> Row:
    """Measure the coverage of the 95 % interval and the errors of two estimates.

    The estimates are the fitted threshold and the mean of the reversals.
    """
    from manip3d.study import (
        Rules,
        SimulatedObserver,
        estimate_threshold,
        reversal_mean,
        simulate_staircase,
    )

    name, count = case.options["model"], case.options["count"]
    thresholds, slopes, lapses, law = _OBSERVERS[name]
    rng = np.random.default_rng([case.options["seed"], list(_OBSERVERS).index(name)])
    held, trials, widths, errors, plain = 0, 0, [], [], []
    for _ in range(count):
        observer = SimulatedObserver(
            rng.uniform(*thresholds),
            rng.uniform(*slopes) if slopes else 3.0 ** (1.0 + 0.5 * rng.standard_normal()),
            rng.uniform(*lapses),
            law,  # type: ignore[arg-type]
        )
        stairs = simulate_staircase(observer, rules=Rules(), rng=rng)
        found = estimate_threshold(stairs.trials or [])
        held += found.low <= observer.threshold <= found.high
        trials += len(stairs.trials or ())
        widths.append(found.high - found.low)
        errors.append(found.threshold - observer.threshold)
        mean = reversal_mean(stairs)
        if mean is not None:
            plain.append(mean - observer.threshold)
    return {
        "coverage": 100.0 * held / count,
        "trials": trials / count,
        "width": float(np.median(widths)),
        "bias": float(np.mean(errors)),
        "rms": float(np.sqrt(np.mean(np.square(errors)))),
        "reversal_bias": float(np.mean(plain)),
        "reversal_rms": float(np.sqrt(np.mean(np.square(plain)))),
    }


_TOO_FEW = "a quick run has too few observers to judge this"


def _covered(wanted: Callable[[str], bool]) -> Callable[[Sequence[Row]], Iterator[Finding]]:
    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for row in rows:
            if wanted(row["model"]):
                numbers = f"{row['coverage']:.1f} % of {counted(row['count'], 'observer')}"
                if row["count"] < _OBSERVED:
                    yield Finding(row["model"], None, numbers, unjudged=_TOO_FEW)
                    continue
                yield Finding(row["model"], _LOW <= row["coverage"] <= _HIGH, numbers)

    return judge


EXPERIMENT = Experiment(
    id="jnd-simulated",
    title="Coverage of the 95 % interval of the just noticeable difference",
    published="",
    data=(),
    cases=_cases,
    role="simulated observers",
    columns=(
        Column("coverage", "intervals that hold the truth, %", digits=1),
        Column("trials", "comparisons", digits=1),
        Column("width", "median width, %", digits=1),
        Column("bias", "mean error, %", digits=2),
        Column("rms", "RMS error, %", digits=2),
        Column("reversal_bias", "mean error of the mean of reversals", digits=2),
        Column("reversal_rms", "RMS error of the mean of reversals", digits=2),
    ),
    claims=(
        Claim(
            f"The interval holds the truth in {_LOW:g} to {_HIGH:g} % of {_OBSERVED} observers",
            "aim",
            _covered(lambda name: name == _ALL),
        ),
        Claim(
            f"It does so for observers of one kind ({_LOW:g} to {_HIGH:g} %)",
            "aim",
            _covered(lambda name: name != _ALL),
        ),
    ),
    notes=(
        "One-up-two-down in steps of 5 % of the polygons from 50 %, between 5 and 95 %, until 12 "
        "reversals or 80 comparisons. Thresholds and lapse rates are drawn evenly, slopes "
        "log-normally with the spread that the estimate's prior has, or as the row says; the prior "
        "is flat in the threshold from 0 to 100 %. With so few comparisons the slope is hardly "
        "known: shallow observers are covered too seldom, steep ones too often.",
        "Published: the plan of two studies (section 2.6), without participants.",
    ),
)
