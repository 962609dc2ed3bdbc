"""Table 7.2: its cases, its counts and what its claims make of them."""

from __future__ import annotations

import pytest

from manip3d.experiments import Case, Plan, registry, table_7_2
from manip3d.experiments._model import Row

QUICK = Plan("simulated", "quick")


def test_full_scale_has_the_published_frames() -> None:
    cases = table_7_2.EXPERIMENT.cases(Plan("simulated", "full"))
    assert registry()["table-7.2"] is table_7_2.EXPERIMENT
    clean = [c.options["frames"] for c in cases if c.options["attack"] == "original"]
    attacks = [c.options["frames"] for c in cases if c.options["attack"] != "original"]
    assert sum(clean) == 1765
    assert sum(attacks) == 8735


def rows(detected: int, accused: int) -> list[Row]:
    made = []
    for case in table_7_2.EXPERIMENT.cases(QUICK):
        count = accused if case.options["attack"] == "original" else detected
        row: Row = {**case.options, **dict.fromkeys(table_7_2._KINDS, count), "attacked": 3}
        made.append(table_7_2.EXPERIMENT.complete(row | {"data": "simulated", "error": None}))
    return made


@pytest.mark.parametrize(
    ("detected", "accused", "holds"),
    [(3, 0, [True] * 4), (2, 0, [False, True] * 2), (3, 1, [True, False] * 2)],
)
def test_claims(detected: int, accused: int, holds: list[bool]) -> None:
    found = rows(detected, accused)
    assert found[0]["published frames"] == 800
    verdicts = [claim.verdict(found).holds for claim in table_7_2.EXPERIMENT.claims]
    assert verdicts == holds


def test_one_frame_of_each_attack() -> None:
    pytest.importorskip("open3d")
    for case in table_7_2.EXPERIMENT.cases(QUICK)[:7:3]:
        row = table_7_2.detect(Case(case.run, {**case.options, "frames": 1}))
        assert row["attacked"] == 1
        expected = 0 if case.options["attack"] == "original" else 1
        assert [row[kind] for kind in table_7_2._KINDS] == [expected] * 5
