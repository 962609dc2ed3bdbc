"""Scores of the McGill Pain Questionnaire (Melzack, 1975), without its words, which are protected.

Whoever has a licence of the questionnaire shows its words; here a group's answer is the rank of the
chosen word, 1 for the first one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from manip3d._util.checked import checked
from manip3d.diary._questionnaires import MCGILL
from manip3d.errors import InputError

MCGILL_GROUPS = tuple(item.high for item in MCGILL.items[:-1])
"""Number of words of each of the 20 groups: sensory 1 to 10, affective 11 to 15, evaluative 16,
miscellaneous 17 to 20."""


@dataclass(frozen=True)
class McGillScore:
    """Indices of a filled-in questionnaire.

    Attributes
    ----------
    sensory, affective, evaluative, miscellaneous : int
        Sums of ranks: at most 42, 14, 5 and 17.
    pri : int
        Pain rating index: their sum, at most 78.
    nwc : int
        Number of words chosen, 0 to 20.
    ppi : int
        Present pain intensity, 0 to 5.
    """

    sensory: int
    affective: int
    evaluative: int
    miscellaneous: int
    pri: int
    nwc: int
    ppi: int


@checked
def score_mcgill(ranks: Sequence[int], ppi: int) -> McGillScore:
    """Score a McGill Pain Questionnaire [1]_.

    Parameters
    ----------
    ranks : sequence of 20 int
        For each group of words the rank of the chosen word, from 1, or 0 where none was chosen;
        `MCGILL_GROUPS` has the highest rank of each group.
    ppi : int
        Present pain intensity, 0 to 5.

    Returns
    -------
    McGillScore
        Sums of ranks, and the number of words chosen.

    Raises
    ------
    InputError
        Not 20 ranks, a rank that the group does not have, or an intensity out of range.

    References
    ----------
    .. [1] R. Melzack, "The McGill Pain Questionnaire: major properties and scoring methods",
       Pain 1(3), 1975.

    Examples
    --------
    >>> from manip3d.diary import MCGILL_GROUPS, score_mcgill
    >>> score_mcgill([1] * 20, 3).pri
    20
    >>> score_mcgill(MCGILL_GROUPS, 5).pri
    78
    """
    if len(ranks) != len(MCGILL_GROUPS):
        raise InputError(f"ranks: expected {len(MCGILL_GROUPS)}, got {len(ranks)}")
    ranks = [int(rank) for rank in ranks]  # of NumPy, too
    for number, (rank, most) in enumerate(zip(ranks, MCGILL_GROUPS, strict=True), 1):
        if not 0 <= rank <= most:
            raise InputError(f"ranks: expected 0 to {most} in group {number}, got {rank!r}")
    if not 0 <= ppi <= 5:
        raise InputError(f"ppi: expected 0 to 5, got {ppi}")
    scores: dict[str, Any] = MCGILL.score((*ranks, ppi))
    return McGillScore(**scores)
