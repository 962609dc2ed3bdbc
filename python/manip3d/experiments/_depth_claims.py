"""Common parts of figures of chapter 3: claims about one error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from manip3d.experiments._depth import SHORT, listing
from manip3d.experiments._model import Claim, Finding, Row, by_model

_CS3 = "cios"


def cs3_below_others(others: Sequence[str], name: str, what: str, source: str) -> Claim:
    """Return the claim that CS3 has a lower value of a measure than each of ``others``."""

    def judge(rows: Sequence[Row]) -> Iterator[Finding]:
        for model, group in by_model(rows):
            present = {m: group[m] for m in (_CS3, *others) if m in group}
            if _CS3 in present and len(present) > 1:
                least = min(float(row[name]) for row in present.values())
                holds = present[_CS3][name] <= least
                yield Finding(model, holds, f"{listing(present, name, 1e3)} (1e-3)")

    names = ", ".join(SHORT[other] for other in others)
    return Claim(f"{SHORT[_CS3]} has a lower {what} than {names}", source, judge)


def cs3_twenty_times_faster(rows: Sequence[Row], than: str) -> Iterator[Finding]:
    """Judge by model whether CS3 takes at most a twentieth of another method's time."""
    for model, group in by_model(rows):
        ratio = group[than]["time_ms"] / group[_CS3]["time_ms"]
        numbers = f"{ratio:.0f} times: {listing(group, 'time_ms', digits=2)} ms"
        yield Finding(model, ratio >= 20, numbers)
