"""Scores of the McGill Pain Questionnaire (Melzack, 1975), without its words, which are protected.

To show the words, a licence of the questionnaire is needed. Here the answer of a group is the rank
of the chosen word, 1 for the first word.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from manip3d._util.checked import checked
from manip3d.diary._questionnaires import MCGILL
from manip3d.errors import InputError

MCGILL_GROUPS = tuple(item.high for item in MCGILL.items[:-1])
"""Number of words in each of the 20 groups: groups 1 to 10 are sensory, 11 to 15 affective, 16
evaluative, and 17 to 20 miscellaneous."""


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
        Rank of the chosen word of each group, from 1; 0: no word was chosen. `MCGILL_GROUPS` lists
        the highest ranks.
    ppi : int
        Present pain intensity, 0 to 5.

    Returns
    -------
    McGillScore
        Sums of ranks, and the number of words chosen.

    Raises
    ------
    InputError
        The number of ranks is not 20, or a rank or the intensity is out of range.

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
    ranks = [int(rank) for rank in ranks]  # NumPy's integers become Python's
    for number, (rank, most) in enumerate(zip(ranks, MCGILL_GROUPS, strict=True), 1):
        if not 0 <= rank <= most:
            raise InputError(f"ranks: expected 0 to {most} in group {number}, got {rank!r}")
    if not 0 <= ppi <= 5:
        raise InputError(f"ppi: expected 0 to 5, got {ppi}")
    scores: dict[str, Any] = MCGILL.score((*ranks, ppi))
    return McGillScore(**scores)
