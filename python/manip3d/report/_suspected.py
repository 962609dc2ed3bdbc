"""Text output of an inspection: the scanner's position, and a table of suspected points."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import InputError
from manip3d.io._files import atomic_write
from manip3d.lidar import LidarFrame, map_shift

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.authenticate import Inspection


@checked
def place_sentence(inspection: Inspection) -> str:
    """Return a phrase with the scanner's position and its source.

    Parameters
    ----------
    inspection : Inspection
        The result of `manip3d.authenticate.inspect`.

    Returns
    -------
    str
        The position in the file's coordinates, metres, and whether it was given, stated by the
        file or estimated.

    Raises
    ------
    InputError
        ``inspection`` is no `Inspection`.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, report
    >>> found = authenticate.inspect(np.zeros((0, 3), np.float32), origin=(1, 2, 0))
    >>> report.place_sentence(found)
    'scanner at (1.000, 2.000, 0.000) m, given'
    """
    from manip3d.authenticate import Inspection

    if not isinstance(inspection, Inspection):
        raise InputError(f"inspection: expected an Inspection, got {type(inspection).__name__}")
    place = inspection.origin_in_file
    if place is None:
        return "the scanner's position is not known"
    x, y, z = place
    source = {"argument": "given", "file": "stated by the file"}.get(
        inspection.origin_from, f"found from {inspection.origin_from}"
    )
    return f"scanner at ({x:.3f}, {y:.3f}, {z:.3f}) m, {source}"


@checked
def write_suspected_rows(inspection: Inspection, output: str | os.PathLike[str]) -> None:
    """Write the rows of the suspected points of a scan as a table.

    Parameters
    ----------
    inspection : Inspection
        The result of `manip3d.authenticate.inspect`.
    output : path
        Output file that ends in ``.csv``, with these columns: row in the scan's file (from 0;
        points without coordinates, which are dropped on reading, are counted; row in the scan, if
        it has points that its file lacks), x, y, z in metres (coordinates of a map as in the file),
        detector, region (from 1), p-value, and a note if the points may be those that were measured
        (`Region.note`). An existing file is replaced.

    Raises
    ------
    InputError
        The suffix is another one, or the inspection does not contain its scan.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import authenticate, report
    >>> found = authenticate.inspect(np.zeros((0, 3), np.float32))
    >>> report.write_suspected_rows(found, "rows.csv")
    >>> from pathlib import Path
    >>> Path("rows.csv").read_text().strip()
    'row,x,y,z,detector,region,p_value,note'
    """
    path = path_of(output, "output")
    if path.suffix.lower() != ".csv":
        raise InputError(f"output: expected a name that ends in .csv, got {path.name}")
    if inspection.scan is None:
        raise InputError("inspection: expected one with its scan")
    lines = ["row,x,y,z,detector,region,p_value,note"]
    in_file = _rows_in_file(inspection.scan)
    for report in inspection.detectors:
        for number, region in enumerate(report.regions, 1):
            p_value = "" if region.p_value is None else f"{region.p_value:.3e}"
            points = _in_file(inspection.scan, region.rows).tolist()
            lines += [
                f"{row},{x:.4f},{y:.4f},{z:.4f},{report.name},{number},{p_value},{region.note}"
                for row, (x, y, z) in zip(in_file[region.rows].tolist(), points, strict=True)
            ]
    atomic_write(path, "\n".join(lines) + "\n")


def _rows_in_file(scan: LidarFrame) -> NDArray[np.int64]:
    """Return the file's row of each point; the rows of the scan if it has points of no file."""
    rows = scan.file_rows
    return np.arange(scan.num_points) if rows is None or (rows < 0).any() else rows


def _in_file(
    scan: LidarFrame, rows: NDArray[np.int64]
) -> NDArray[np.float32] | NDArray[np.float64]:
    """Points of a scan as they are read, or in coordinates of a map as they are in the file."""
    shift = map_shift(scan)
    if scan.exact is not None and shift.any():
        return scan.exact[rows]
    return scan.points[rows] + shift if shift.any() else scan.points[rows]
