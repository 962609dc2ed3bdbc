"""Points of forged and inspected scans, coloured by the forgery or by the detectors' suspicion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from manip3d._util.arrays import as_array
from manip3d._util.checked import checked
from manip3d.errors import InputError
from manip3d.lidar import Box, LidarFrame
from manip3d.viewer.points import (
    ALARM,
    CLEAR,
    DOUBT,
    QUIET,
    Classes,
    DrawnPoints,
    box_lines,
)
from manip3d.viewer.sensor_points import scan_points

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from manip3d.forge import Forgery
    from manip3d.viewer.scene import Rgb

_SUSPECTED: tuple[Rgb, ...] = (ALARM, (232, 120, 20), (170, 40, 160), (120, 60, 20))
_SEVERAL: Rgb = (110, 0, 10)
_MOVED: Rgb = (232, 120, 20)
_REMOVED: Rgb = (60, 110, 220)
_VERDICTS: dict[str, Rgb] = {
    "tampered": QUIET,
    "undecidable": DOUBT,
    "processed": DOUBT,
    "no_trace": CLEAR,
    "authentic": CLEAR,
}
"""Colours of points that no detector suspects, by verdict."""


@checked
def evidence(
    scan: LidarFrame,
    *,
    verdict: Literal["no_trace", "authentic", "tampered", "processed", "undecidable"],
    suspected: Mapping[str, ArrayLike],
    boxes: Mapping[str, Sequence[Box]] | None = None,
) -> DrawnPoints:
    """Return a scan with suspected points and boxes coloured by the detector that suspects them.

    Parameters
    ----------
    scan : LidarFrame
    verdict : 'no_trace', 'authentic', 'tampered', 'processed' or 'undecidable'
        Verdict on the whole scan. Points that no detector suspects are grey in a ``tampered`` scan,
        amber in an ``undecidable`` or ``processed`` one, and green in the others.
    suspected : mapping of str to (K,) integers or (N,) bool
        Rows or mask of the points that each detector suspects, by the detector's name.
    boxes : mapping of str to sequence of Box, optional
        Boxes of each detector, by the detector's name.

    Returns
    -------
    DrawnPoints

    Raises
    ------
    InputError
        The verdict is unknown; a row is out of range, or rows are neither integers nor a mask of
        all points.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, viewer
    >>> scan = LidarFrame(np.random.default_rng(0).normal(size=(100, 3)))
    >>> cloud = viewer.evidence(scan, verdict="tampered", suspected={"density": [3, 4, 5]})
    >>> cloud.columns[0].labels, cloud.columns[0].counts()
    (['not suspected', 'suspected by density'], [97, 3])
    """
    values = np.zeros(scan.num_points, np.uint8)
    labels, palette = ["not suspected"], [_VERDICTS[verdict]]
    colors: dict[str, Rgb] = {}
    several = len(suspected) + 1
    for i, (name, given) in enumerate(suspected.items()):
        rows = _rows(given, name, scan.num_points)
        if rows.size and not (rows.min() >= 0 and rows.max() < scan.num_points):
            raise InputError(
                f"suspected: expected rows in [0, {scan.num_points - 1}] by {name}, "
                f"got {rows.min()} to {rows.max()}"
            )
        values[rows] = np.where(values[rows] == 0, i + 1, several)
        colors[name] = _SUSPECTED[i % len(_SUSPECTED)]
        labels.append(f"suspected by {name}")
        palette.append(colors[name])
    labels.append("suspected by several")
    palette.append(_SEVERAL)
    classes = _used(Classes("verdict", values, labels, palette, range(1, len(labels))))
    cloud = scan_points(scan, classes=classes)
    return replace(cloud, lines=box_lines(boxes or {}, colors))


@checked
def forgery_points(forgery: Forgery) -> DrawnPoints:
    """Return a forged scan with added and moved points, and with removed points if known.

    Parameters
    ----------
    forgery : Forgery
        Result of one of the attacks of `manip3d.forge`.

    Returns
    -------
    DrawnPoints
        Points of the forged scan, then the removed points.

    Raises
    ------
    InputError
        ``forgery`` is not a forgery.

    Examples
    --------
    >>> from manip3d import forge, viewer
    >>> forged = forge.ctp([[5, 0, 0], [6, 0, 0]], [[0, 0, 0]], position=(3, 0, 0))
    >>> cloud = viewer.forgery_points(forged)
    >>> cloud.columns[0].labels, cloud.columns[0].counts()
    (['untouched', 'added'], [2, 1])
    """
    from manip3d.forge import Forgery

    if not isinstance(forgery, Forgery):
        raise InputError(f"forgery: expected a Forgery, got {type(forgery).__name__}")
    frame, label = forgery.frame, forgery.label
    original = forgery.original
    if original is not None and len(forgery.removed):
        removed = original.points[forgery.removed]
        frame = LidarFrame(
            np.concatenate([frame.points, removed]),
            _joined(frame.intensity, original.intensity, forgery),
            origin=frame.origin,
        )
        label = np.concatenate([label, np.full(len(removed), 3, np.uint8)])
    labels = ("untouched", "added", "moved", "removed")
    palette = (QUIET, ALARM, _MOVED, _REMOVED)
    truth = _used(Classes("truth", label, labels, palette, (1, 2, 3)))
    cloud = scan_points(frame, classes=truth)
    name = f"forged: {forgery.attack}"
    detail = f"{len(forgery.points):,} points, {forgery.num_touched:,} touched"
    lines = box_lines({"forged region": [forgery.box]}, {"forged region": ALARM})
    return replace(cloud, lines=lines, name=name, detail=detail)


def _joined(
    forged: np.ndarray | None, original: np.ndarray | None, forgery: Forgery
) -> np.ndarray | None:
    if forged is None or original is None:
        return None
    joined: np.ndarray = np.concatenate([forged, original[forgery.removed]])
    return joined


def _rows(given: ArrayLike, name: str, count: int) -> NDArray[np.int64]:
    """Return the numbers of the rows that a detector suspects, which it may state as a mask."""
    array = as_array(given, f"suspected[{name!r}]")
    if array.dtype == np.bool_ and array.shape == (count,):
        return np.flatnonzero(array).astype(np.int64)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise InputError(
            f"suspected[{name!r}]: expected row numbers of shape (K,) or a mask of shape "
            f"({count},), got {array.dtype} {array.shape}"
        )
    return array.astype(np.int64)


def _used(classes: Classes) -> Classes:
    """Return the classes without labels that no point has."""
    used = [i for i, count in enumerate(classes.counts()) if count or i == 0]
    new = np.zeros(len(classes.labels), np.uint8)
    new[used] = np.arange(len(used))
    return Classes(
        classes.name,
        new[classes.values],
        [classes.labels[i] for i in used],
        [classes.palette[i] for i in used],
        [int(new[i]) for i in used if i in classes.emphasis],
    )
