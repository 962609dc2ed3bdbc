"""Table 6.2: accuracies of detectors I and II, and their verdicts on other attacks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.experiments import _forensics, _published
from manip3d.experiments._model import Claim, Experiment, Finding, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TABLE = "table_6_2_lidar_forensics_accuracy_percent"


def _printed() -> dict[str, Mapping[str, str]]:
    return {line["class"]: line for line in _published.published_rows(_TABLE)}


def _reaches(rows: Sequence[Row], detector: str, classes: Sequence[str]) -> Iterator[Finding]:
    for name in classes:
        found = _forensics.entries(rows, name)
        if found:
            mine = _forensics.accuracy(found, detector)
            printed = float(_printed()[name][detector])
            numbers = f"{mine:.2f} %, published {printed:.2f} % (n = {len(found)})"
            yield _forensics.finding(rows, name, mine >= printed, numbers)


def _overall(rows: Sequence[Row]) -> Iterator[Finding]:
    found = [entry for name in _forensics.CLASSES for entry in _forensics.entries(rows, name)]
    for detector in _forensics.DETECTORS:
        if found:
            mine = _forensics.accuracy(found, detector)
            printed = float(_printed()["overall"][detector])
            numbers = f"{mine:.2f} %, published {printed:.2f} %"
            yield _forensics.finding(rows, detector, mine >= printed, numbers)


def _misses_crtp(rows: Sequence[Row]) -> Iterator[Finding]:
    found = _forensics.entries(rows, "CRTP")
    if found:
        mine = _forensics.accuracy(found, "I")
        printed = float(_printed()["CRTP"]["I"])
        numbers = f"{mine:.2f} % detected, published {printed:.2f} %"
        yield _forensics.finding(rows, "I, CRTP", mine < 50.0, numbers)


def _fronts(rows: Sequence[Row]) -> Iterator[Finding]:
    for attack in ("CTP", "CRTP"):
        found = _forensics.entries(rows, attack, front=True)
        for detector in _forensics.DETECTORS:
            if found:
                mine = _forensics.accuracy(found, detector)
                yield Finding(f"{detector}, {attack}", None, f"{mine:.2f} % (n = {len(found)})")


def _other_attacks(rows: Sequence[Row]) -> Iterator[Finding]:
    for attack in ("subtractive", "deforming"):
        found = _forensics.entries(rows, attack)
        for detector in _forensics.DETECTORS:
            if found:
                right = sum(_forensics.is_right(entry, detector) for entry in found)
                yield Finding(f"{detector}, {attack}", None, f"{right} of {len(found)} detected")


def _literal(rows: Sequence[Row]) -> Iterator[Finding]:
    for name in _forensics.CLASSES:
        found = _forensics.entries(rows, name)
        for detector in _forensics.DETECTORS:
            if found:
                mine = _forensics.accuracy(found, f"{detector}_paper")
                yield Finding(f"{detector}, {name}", None, f"{mine:.2f} % (n = {len(found)})")


def _curve(clean: Sequence[float], forged: Sequence[float]) -> tuple[Any, Any, float]:
    """Return false- and true-alarm rates over all thresholds, and the area (ties count half)."""
    scores = np.concatenate([clean, forged])
    limits = np.concatenate([[np.inf], np.sort(np.unique(scores))[::-1]])
    false = [(np.asarray(clean) >= limit).mean() for limit in limits]
    true = [(np.asarray(forged) >= limit).mean() for limit in limits]
    difference = np.subtract.outer(np.asarray(forged), np.asarray(clean))
    area = float(((difference > 0) + 0.5 * (difference == 0)).mean())
    return false, true, area


def _roc(rows: Sequence[Row]) -> dict[str, Figure]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.8), layout="constrained")
    for place, detector in enumerate(_forensics.DETECTORS):
        axes = figure.add_subplot(1, 2, place + 1)
        clean = [e[f"{detector}_score"] for e in _forensics.entries(rows, "original")]
        for attack in ("CTP", "CRTP", "subtractive", "deforming"):
            forged = [e[f"{detector}_score"] for e in _forensics.entries(rows, attack)]
            if clean and forged:
                false, true, area = _curve(clean, forged)
                axes.plot(false, true, label=f"{attack}: area {area:.3f}", drawstyle="steps-post")
        axes.set(title=f"Detector {detector}", xlabel="false alarms", ylabel="detected")
        axes.set(xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        axes.grid(alpha=0.3)
        if axes.lines:
            axes.legend(loc="lower right", fontsize="small")
    return {"Detection against false alarms, per attack": figure}


def _claim(detector: str, classes: Sequence[str]) -> Claim:
    return Claim(
        f"Detector {detector} reaches the published accuracy on {', '.join(classes)}",
        "table 6.2",
        partial(_reaches, detector=detector, classes=classes),
    )


EXPERIMENT = Experiment(
    id="table-6.2",
    title="Accuracy of detectors I and II, and other attacks",
    published=_TABLE,
    data=_forensics.HOAXES,
    cases=_forensics.cases,
    columns=_forensics.COLUMNS,
    claims=(
        _claim("II", _forensics.CLASSES),
        _claim("I", ("original", "CTP")),
        Claim("The overall accuracy of both is reached", "table 6.2", _overall),
        Claim("Detector I misses most CRTP forgeries", "table 6.2", _misses_crtp),
        Claim("Hoaxes of which only the front was pasted", "aim", _fronts, reported=True),
        Claim("Subtractive and deforming forgeries", "aim", _other_attacks, reported=True),
        Claim("Parameters as printed instead of calibrated", "aim", _literal, reported=True),
    ),
    complete=_forensics.complete,
    figures=_roc,
    notes=(
        _forensics.resolution_note,
        _forensics.NOTE,
        "Neither detector looks for what was removed or bent. Undecidable counts as wrong.",
    ),
)
