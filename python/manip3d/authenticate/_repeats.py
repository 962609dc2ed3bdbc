"""Find scans with the points of another scan, which no two turns of a scanner have."""

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

MIN_SHARED = 0.9
"""Scans that have at least this share of points in common, bit for bit, are copies. Different turns
never do: noise moves most points to another range step even if nothing in the scene moves."""

SKETCH, LOOKED_UP, MIN_COMPARED = 128, 16, 16
"""SKETCH: number of hashes that represent a scan. LOOKED_UP: number of these by which earlier scans
are looked up. MIN_COMPARED: fewest hashes from which a share is estimated. An hour at ten scans
per second takes 100 MB."""

_MIXERS = tuple(np.uint32(value) for value in (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D, 0x27D4EB2F))


class Sketch(NamedTuple):
    """Sketch of a scan's points, by which copies are recognised in any order of the rows.

    Attributes
    ----------
    num_points : int
        Number of points that are not at the origin, where scanners write missing returns.
    everything, in_order : int
        Sums of the hashes of all points, independent of their order and dependent on it.
    smallest : (K,) uint64
        The smallest distinct hashes, ascending: a sample that copies share [Broder, On the
        resemblance and containment of documents, 1997].
    """

    num_points: int
    everything: int
    in_order: int
    smallest: NDArray[np.uint64]


GROUPS, GROUP_BITS, MIN_SAME_GROUPS = 8, 16, 6
"""GROUPS: number of groups of points in an id. GROUP_BITS: bits of each group's sum.
MIN_SAME_GROUPS: fewest equal sums of scans that have the same points except for one, which
changes at most two groups."""


@checked
def points_id(points: ArrayLike) -> str:
    """Return an id of a scan's points that does not depend on the order of the rows.

    Parameters
    ----------
    points : (N, 3) float32
        Points at the origin, which some scanners write for missing returns, do not count.

    Returns
    -------
    str
        32 hexadecimal digits; if one point differs, at most eight digits differ, see
        `are_same_points`. Empty if there are no points.

    Raises
    ------
    InputError
        ``points`` has another shape.

    Notes
    -----
    The id recognises copies. It is no protection against forgery: two scans with the same id can be
    constructed.

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
    """Return whether two ids belong to the same points, except for at most one changed point.

    Parameters
    ----------
    one, other : str
        Ids from `points_id`.

    Returns
    -------
    bool
        False if one of the ids is empty.

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
    return same >= MIN_SAME_GROUPS


def first_copies(ids: Sequence[str]) -> list[int | None]:
    """Return for each id the place of the first earlier id of the same points, or None.

    Parameters
    ----------
    ids : sequence of str
        Ids from `points_id`.
    """
    digits = GROUP_BITS // 4
    # If MIN_SAME_GROUPS of all groups are equal, at least one of these is.
    starts = range(0, (GROUPS - MIN_SAME_GROUPS + 1) * digits, digits)
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
    most = 8 * SKETCH  # if a scan of few distinct points has more, all are sorted
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
    """A hash of each point; a changed bit of a coordinate changes about half of its bits."""
    x, y, z = (words[:, k] for k in range(3))
    hashes = x * _MIXERS[0]
    for column in (y, z):
        hashes ^= hashes >> np.uint32(15)
        hashes = (hashes ^ column) * _MIXERS[1]
    hashes ^= hashes >> np.uint32(13)
    hashes *= _MIXERS[2]
    return hashes ^ (hashes >> np.uint32(16))


def _longer(hashes: NDArray[np.uint32], words: NDArray[np.uint32]) -> NDArray[np.uint64]:
    """Hashes of 64 bits in the order of the 32-bit hashes; equal hashes of two points are rare."""
    more = _hashes(words[:, ::-1])
    return (hashes.astype(np.uint64) << np.uint64(32)) | more


def share_in_common(one: Sketch, other: Sketch) -> float:
    """Return an estimate of the share of the smaller scan's points that the other scan has, too.

    Parameters
    ----------
    one, other : Sketch
        Sketches of the scans; the result is 0 if one of them has too few points.
    """
    if min(one.num_points, other.num_points) == 0:
        return 0.0
    if (one.num_points, one.everything) == (other.num_points, other.everything):
        return 1.0
    few, many = sorted((one, other), key=lambda each: each.num_points)
    known = [each.smallest[-1] for each in (few, many) if len(each.smallest) == SKETCH]
    compared = few.smallest[few.smallest <= min(known)] if known else few.smallest
    if len(compared) < MIN_COMPARED:
        return 0.0
    return float(np.isin(compared, many.smallest, assume_unique=True).mean())


def in_common(one: Sketch, other: Sketch) -> str:
    """Return in words which points two scans have in common; empty if fewer than copies have.

    Parameters
    ----------
    one, other : Sketch
    """
    share = share_in_common(one, other)
    if share < MIN_SHARED:
        return ""
    if (one.num_points, one.everything) != (other.num_points, other.everything):
        of = "" if one.num_points == other.num_points else " of the smaller of the two"
        return f"about {min(share, 0.999):.1%} of the points{of}"
    return "the same points" + ("" if one.in_order == other.in_order else " in another order")


class EarlierScans:
    """Memory of the scans of a drive, to recognise a scan that repeats an earlier one."""

    def __init__(self) -> None:
        self._sketches: list[Sketch] = []
        self._places: list[int] = []
        self._first: dict[int, int] = {}

    def repeated(self, points: NDArray[np.float32], place: int) -> tuple[int, str] | None:
        """Return the place of an earlier scan with these points, and their share in words; or None.

        Parameters
        ----------
        points : (N, 3) float32
            Points of the scan.
        place : int
            Place of the scan in the drive, which is returned for later copies of it.
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
