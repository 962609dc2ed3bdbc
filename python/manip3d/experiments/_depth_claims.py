"""Common parts of figures of chapter 3: claims about one error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from manip3d.experiments._depth import SHORT, listing
from manip3d.experiments._model import Claim, Finding, Row, by_model


def below_others(method: str, others: Sequence[str], name: str, what: str, source: str) -> Claim:
    """Return the claim that a method has a lower value of a measure than each of ``others``."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for model, group in by_model(rows):
            present = {m: group[m] for m in (method, *others) if m in group}
            if method in present and len(present) > 1:
                least = min(float(row[name]) for row in present.values())
                holds = present[method][name] <= least
                yield Finding(model, holds, f"{listing(present, name, 1e3)} (1e-3)")

    names = ", ".join(SHORT[other] for other in others)
    return Claim(f"{SHORT[method]} has a lower {what} than {names}", source, judge)


def twenty_times_faster(rows: Sequence[Row], method: str, than: str) -> Iterator[Finding]:
    """Judge by model whether a method takes at most a twentieth of another one's time."""
    for model, group in by_model(rows):
        ratio = group[than]["time_ms"] / group[method]["time_ms"]
        numbers = f"{ratio:.0f} times: {listing(group, 'time_ms', digits=2)} ms"
        yield Finding(model, ratio >= 20, numbers)
