"""The McGill scoring engine: its published maxima, and answers that are none."""

from __future__ import annotations

import numpy as np
import pytest

from manip3d import InputError
from manip3d.diary import MCGILL_GROUPS, McGillScore, score_mcgill


def test_the_published_maxima() -> None:
    assert len(MCGILL_GROUPS) == 20
    assert score_mcgill(MCGILL_GROUPS, 5) == McGillScore(42, 14, 5, 17, 78, 20, 5)
    ranks = np.array(MCGILL_GROUPS)  # as a table of answers has them
    assert score_mcgill(ranks, np.int64(5)) == score_mcgill(MCGILL_GROUPS, 5)  # type: ignore[arg-type]
    assert score_mcgill([0] * 20, 0) == McGillScore(0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("group", "scale"),
    [*((g, "sensory") for g in range(1, 11)), *((g, "affective") for g in range(11, 16)),
     (16, "evaluative"), *((g, "miscellaneous") for g in range(17, 21))],
)  # fmt: skip
def test_each_group_counts_in_its_scale(group: int, scale: str) -> None:
    ranks = [0] * 20
    ranks[group - 1] = 2
    score = score_mcgill(ranks, 1)
    scales = ("sensory", "affective", "evaluative", "miscellaneous")
    assert {name: getattr(score, name) for name in scales} == {
        name: 2 if name == scale else 0 for name in scales
    }
    assert (score.pri, score.nwc, score.ppi) == (2, 1, 1)


@pytest.mark.parametrize(
    ("ranks", "ppi", "message"),
    [
        ([1] * 19, 0, "ranks: expected 20, got 19"),
        ([7] + [1] * 19, 0, "ranks: expected 0 to 6 in group 1, got 7"),
        ([1] * 10 + [3] + [1] * 9, 0, "ranks: expected 0 to 2 in group 11, got 3"),
        ([-1] + [1] * 19, 0, "group 1, got -1"),
        ([True] + [1] * 19, 0, "ranks"),
        ([1] * 20, 6, "ppi: expected 0 to 5, got 6"),
        ([1] * 20, -1, "ppi: expected 0 to 5"),
    ],
)
def test_answers_that_are_none(ranks: list[int], ppi: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        score_mcgill(ranks, ppi)
