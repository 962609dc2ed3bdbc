"""Common parts of figures of chapter 3: claims about one error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from manip3d.experiments._depth import SHORT, by_model, listing
from manip3d.experiments._model import Claim, Finding, Row


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
