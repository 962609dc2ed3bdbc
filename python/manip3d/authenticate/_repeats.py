"""Scans that hold the points of another one: no two turns of a scanner do."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from manip3d._util.arrays import rows as as_rows
from manip3d._util.checked import checked
from manip3d.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

LEAST_SHARED = 0.9
"""Share of the points, to the bit, that two scans of different turns do not have in common: noise
moves most of them to another step of the ranges even where nothing moves."""

SKETCH, LOOKED_UP, FEWEST_COMPARED = 128, 16, 16
"""Points that stand for a scan; those of them by which earlier scans are looked up; and fewest that
tell a share. An hour of ten scans a second takes 100 MB."""

_MIXERS = tuple(np.uint32(value) for value in (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D, 0x27D4EB2F))


class Sketch(NamedTuple):
    """A sketch of a scan's points, by which a copy of it is known in any order of the rows.

    Attributes
    ----------
    num_points : int
        Points away from the origin: scanners write missing returns there.
    everything, in_order : int
        Sums of the hashes of all points, without regard to their order and with it.
    smallest : (K,) uint64
        The smallest distinct hashes, ascending: a sample that copies share [Broder, On the
        resemblance and containment of documents, 1997].
    """

    num_points: int
    everything: int
    in_order: int
    smallest: NDArray[np.uint64]


GROUPS, GROUP_BITS, FEWEST_SAME_GROUPS = 8, 16, 6
"""Groups of points that an id sums up, bits of each sum, and how many are the same of scans that
have the same points but for a few: a changed point changes two groups at most."""


@checked
def points_id(points: ArrayLike) -> str:
    """Return an id of a scan's points, which is the same in any order of the rows.

    Parameters
    ----------
    points : (N, 3) float32
        Points at the origin, which some scanners write for missing returns, do not count.

    Returns
    -------
    str
        32 hexadecimal digits; ids of scans that differ in one point differ in eight at most, see
        `are_same_points`. Empty if there are no points.

    Raises
    ------
    InputError
        ``points`` has another shape.

    Notes
    -----
    It tells copies from each other, not forgeries: whoever wants to can make two scans with one id.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import points_id
    >>> points = np.float32([[1, 2, 3], [4, 5, 6]])
    >>> points_id(points) == points_id(points[::-1])
    True
    """
    hashes = _hashes(_words(as_rows(points, 3, np.float32, "points")))
    if len(hashes) == 0:
        return ""
    group = hashes % np.uint32(GROUPS)
    sums = [int(hashes[group == k].sum(dtype=np.uint64)) >> 4 for k in range(GROUPS)]
    return "".join(f"{each % 2**GROUP_BITS:0{GROUP_BITS // 4}x}" for each in sums)


@checked
def are_same_points(one: str, other: str) -> bool:
    """Return whether two ids are of the same points, but for one that was changed.

    Parameters
    ----------
    one, other : str
        From `points_id`.

    Returns
    -------
    bool
        False where one of them is empty.

    Raises
    ------
    InputError
        An id has another length.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d.authenticate import are_same_points, points_id
    >>> points = np.arange(30, dtype=np.float32).reshape(-1, 3)
    >>> changed = points.copy()
    >>> changed[4, 1] += 1
    >>> are_same_points(points_id(points), points_id(changed))
    True
    >>> are_same_points(points_id(points), points_id(points + 1))
    False
    """
    digits = GROUP_BITS // 4
    for name, text in (("one", one), ("other", other)):
        if len(text) not in (0, GROUPS * digits):
            raise InputError(f"{name}: expected an id of {GROUPS * digits} digits, got {text!r}")
    if not one or not other:
        return False
    starts = range(0, GROUPS * digits, digits)
    same = sum(one[k : k + digits] == other[k : k + digits] for k in starts)
    return same >= FEWEST_SAME_GROUPS


def first_copies(ids: Sequence[str]) -> list[int | None]:
    """Return the place of the first id before each one that is of the same points, or None.

    Parameters
    ----------
    ids : sequence of str
        From `points_id`.
    """
    digits = GROUP_BITS // 4
    # One group of these at least is the same where FEWEST_SAME_GROUPS of all are.
    starts = range(0, (GROUPS - FEWEST_SAME_GROUPS + 1) * digits, digits)
    places: defaultdict[tuple[int, str], list[int]] = defaultdict(list)
    found: list[int | None] = []
    for place, own in enumerate(ids):
        groups = [(start, own[start : start + digits]) for start in starts] if own else []
        near = sorted({other for group in groups for other in places[group]})
        first = next((other for other in near if are_same_points(own, ids[other])), None)
        found.append(first)
        if first is None or ids[first] != own:
            for group in groups:
                places[group].append(place)
    return found


def sketch_of(points: NDArray[np.float32]) -> Sketch:
    """Return the sketch of a scan.

    Parameters
    ----------
    points : (N, 3) float32
    """
    words = _words(points)
    hashes = _hashes(words)
    if len(hashes) == 0:
        return Sketch(0, 0, 0, np.empty(0, np.uint64))
    rows = np.arange(1, len(hashes) + 1, dtype=np.uint32) * _MIXERS[3]
    in_order = int((hashes ^ rows).sum(dtype=np.uint64))
    most = 8 * SKETCH  # a scan of few distinct points has more copies than these, and is sorted
    few = np.flatnonzero(hashes < min(2.0 * most / len(hashes), 1.0) * 2.0**32)
    if len(few) < most < len(hashes):
        few = np.argpartition(hashes, most)[:most]
    smallest = np.unique(_longer(hashes[few], words[few]))
    if len(smallest) < SKETCH:
        smallest = np.unique(_longer(hashes, words))
    everything = int(hashes.sum(dtype=np.uint64))
    return Sketch(len(hashes), everything, in_order, smallest[:SKETCH].copy())


def _words(points: NDArray[np.float32]) -> NDArray[np.uint32]:
    """The bits of the coordinates of the points away from the origin."""
    words = (np.ascontiguousarray(points) + np.float32(0.0)).view(np.uint32)  # -0.0 is 0.0
    is_away = (words[:, 0] | words[:, 1] | words[:, 2]) != 0
    return words if is_away.all() else words[is_away]


def _hashes(words: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """A hash of each point: each bit of a coordinate turns half of its bits."""
    x, y, z = (words[:, k] for k in range(3))
    hashes = x * _MIXERS[0]
    for column in (y, z):
        hashes ^= hashes >> np.uint32(15)
        hashes = (hashes ^ column) * _MIXERS[1]
    hashes ^= hashes >> np.uint32(13)
    hashes *= _MIXERS[2]
    return hashes ^ (hashes >> np.uint32(16))


def _longer(hashes: NDArray[np.uint32], words: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """Hashes of 64 bits in the order of those of 32, by which two points are seldom the same."""
    more = _hashes(words[:, ::-1])
    return (hashes.astype(np.uint64) << np.uint64(32)) | more


def share_in_common(one: Sketch, other: Sketch) -> float:
    """Return the share of the points of the smaller scan that the other one has, too; an estimate.

    Parameters
    ----------
    one, other : Sketch
        0 where one of them has too few points to tell.
    """
    if min(one.num_points, other.num_points) == 0:
        return 0.0
    if (one.num_points, one.everything) == (other.num_points, other.everything):
        return 1.0
    few, many = sorted((one, other), key=lambda each: each.num_points)
    known = [each.smallest[-1] for each in (few, many) if len(each.smallest) == SKETCH]
    compared = few.smallest[few.smallest <= min(known)] if known else few.smallest
    if len(compared) < FEWEST_COMPARED:
        return 0.0
    return float(np.isin(compared, many.smallest, assume_unique=True).mean())


def in_common(one: Sketch, other: Sketch) -> str:
    """Return in words what a scan has of another one; empty: no more than chance explains.

    Parameters
    ----------
    one, other : Sketch
    """
    share = share_in_common(one, other)
    if share < LEAST_SHARED:
        return ""
    if (one.num_points, one.everything) != (other.num_points, other.everything):
        of = "" if one.num_points == other.num_points else " of the smaller of the two"
        return f"about {min(share, 0.999):.1%} of the points{of}"
    return "the same points" + ("" if one.in_order == other.in_order else " in another order")


class EarlierScans:
    """The scans of a drive so far, by which one that repeats an earlier one is known."""

    def __init__(self) -> None:
        self._sketches: list[Sketch] = []
        self._places: list[int] = []
        self._first: dict[int, int] = {}

    def repeated(self, points: NDArray[np.float32], place: int) -> tuple[int, str] | None:
        """Return the place of the earlier scan with these points, and what it has of them; or None.

        Parameters
        ----------
        points : (N, 3) float32
        place : int
            Place of the scan in the drive, at which later ones find it.
        """
        sketch = sketch_of(points)
        keys = sketch.smallest[:LOOKED_UP].tolist()
        votes = Counter(self._first[key] for key in keys if key in self._first)
        for key in keys:
            self._first.setdefault(key, len(self._sketches))
        self._sketches.append(sketch)
        self._places.append(place)
        for number, _ in votes.most_common(1):
            if told := in_common(sketch, self._sketches[number]):
                return self._places[number], told
        return None
