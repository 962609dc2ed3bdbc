"""The Stanford range scans: single range images, with the poses that align them.

``scans.csv`` holds names, checksums, sources and the counts measured on the stored files. A 2x2
cell of pixels counts as two faces if it has four points, and as one if it has three.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d.datasets._registry import DataFile, DataSet, get, locate, require
from manip3d.datasets._tables import data_file, table
from manip3d.errors import InputError
from manip3d.io import read_range_grid
from manip3d.io._poses import poses_by_file

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

_SETS = {
    "bunny": ("bunny_scans", "Stanford Bunny, ten single range scans"),
    "dragon_stand": ("dragon_stand", "Stanford Dragon standing, fifteen single range scans"),
    "happy_stand": ("happy_stand", "Stanford Happy Buddha standing, fifteen single range scans"),
}
_LICENCE = (
    "Stanford terms: research use, mirroring and free redistribution allowed with acknowledgement "
    "of the Stanford Computer Graphics Laboratory; commercial use needs permission. The Dragon and "
    "the Buddha are religious symbols: keep their use in good taste"
)
_COPY = "thegyro/Project4-Scan-Matching @8cdb8ae86bade5717851d7dbb7080993c138c150 data"


def _data_sets() -> tuple[DataSet, ...]:
    rows = list(table("scans.csv"))
    sets = []
    for folder, (name, title) in _SETS.items():
        mine = [row for row in rows if row["path"].startswith(f"{folder}/")]
        scans = [row for row in mine if row["faces"]]
        files = (data_file("range_scans", row) for row in mine)
        facts = {"scans": len(scans), "points": sum(int(row["vertices"]) for row in scans)}
        sets.append(
            DataSet(
                name=name,
                title=title,
                kind="scan",
                files=tuple(files),
                licence=_LICENCE,
                origin=f"Stanford 3D Scanning Repository, Cyberware 3030MS; this copy: {_COPY}",
                page="https://graphics.stanford.edu/data/3Dscanrep/",
                facts=facts,
            )
        )
    return tuple(sets)


DATA_SETS = _data_sets()


@dataclass(frozen=True, eq=False)
class RangeScan:
    """One range image and its pose.

    Attributes
    ----------
    name : str
        Name of the scan.
    points : (H, W, 3) float64
        Points in metres and in the file's own axes; NaN without a measurement.
    valid : (H, W) bool
        Whether the pixel has a measurement.
    pose : (4, 4) float64
        Rigid transform from the scan's frame to the common frame of all scans of its set.
    """

    name: str
    points: NDArray[np.float64]
    valid: NDArray[np.bool_]
    pose: NDArray[np.float64]

    __repr__ = short_repr


@cache
def _sets_of_scans() -> Mapping[str, tuple[DataSet, DataFile]]:
    return {
        PurePosixPath(file.plain_path).stem: (data_set, file)
        for data_set in DATA_SETS
        for file in data_set.files
        if file.plain_path.endswith(".ply")
    }


@checked
def scan_names(data_set: str = "") -> tuple[str, ...]:
    """Return the names of the range scans of a data set, or of all data sets of kind ``scan``.

    Parameters
    ----------
    data_set : str
        Name of the data set; default: all.

    Returns
    -------
    tuple of str
        Names for `load_scan`.

    Raises
    ------
    InputError
        There is no such data set, or it has another kind.

    Examples
    --------
    >>> from manip3d import datasets
    >>> "bun000" in datasets.scan_names()
    True
    """
    wanted = get(data_set) if data_set else None
    if wanted is not None and wanted.kind != "scan":
        raise InputError(f"data set: expected range scans, got {wanted.name!r} ({wanted.kind})")
    return tuple(n for n, (of, _) in _sets_of_scans().items() if wanted in (None, of))


@checked
def scan_path(name: str) -> Path:
    """Return the path of the file of a scan after verifying its checksum.

    Parameters
    ----------
    name : str
        One of `scan_names`.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    InputError
        There is no such scan.
    DataMissingError, ChecksumError
        The file is not on this computer, or has another SHA-256 than the registered one.

    Examples
    --------
    >>> from manip3d import datasets
    >>> datasets.scan_path("bun000").name  # doctest: +SKIP
    """
    data_set, file = _find(name)
    return require(file, data_set.name)


@checked
def scan_is_here(name: str) -> bool:
    """Return whether a scan and the poses of its set are on this computer.

    Parameters
    ----------
    name : str
        One of `scan_names`.

    Returns
    -------
    bool
        Checksums are not verified.

    Raises
    ------
    InputError
        There is no such scan.

    Examples
    --------
    >>> from manip3d import datasets
    >>> isinstance(datasets.scan_is_here("bun000"), bool)
    True
    """
    data_set, file = _find(name)
    return locate(file) is not None and locate(_poses_file(data_set)) is not None


@checked
def load_scan(name: str) -> RangeScan:
    """Open a range scan after verifying its checksum.

    Parameters
    ----------
    name : str
        One of `scan_names`: ``bun000``, ``happyStandRight_0``, ...

    Returns
    -------
    RangeScan
        Its grid of points, and its pose in the common frame of its set.

    Raises
    ------
    InputError
        There is no such scan.
    DataMissingError, ChecksumError
        The file is not on this computer, or has another SHA-256 than the registered one.

    Examples
    --------
    >>> from manip3d import datasets
    >>> datasets.load_scan("bun000").points.shape  # doctest: +SKIP
    """
    data_set, file = _find(name)
    grid = read_range_grid(require(file, data_set.name))
    poses = read_poses(require(_poses_file(data_set), data_set.name))
    return RangeScan(name, grid.points, grid.valid, poses[f"{name}.ply"])


def _find(name: str) -> tuple[DataSet, DataFile]:
    known = _sets_of_scans()
    if name not in known:
        raise InputError(f"scan: expected one of {', '.join(known)}, got {name!r}")
    return known[name]


def _poses_file(data_set: DataSet) -> DataFile:
    return next(file for file in data_set.files if file.path.endswith(".conf"))


@checked
def read_poses(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read the poses of a Stanford ``.conf`` file: ``bmesh FILE tx ty tz qx qy qz qw``.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict of str to (4, 4) float64
        For each file, the transform from the scan's frame to the common frame. In this format the
        rotation is the inverse of the quaternion's.

    Raises
    ------
    FormatError
        A line has other fields.
    OSError
        The file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import datasets
    >>> _ = Path("bun.conf").write_text("bmesh bun000.ply 1 2 3 0 0 0 1")
    >>> datasets.read_poses(Path("bun.conf"))["bun000.ply"][:3, 3].tolist()
    [1.0, 2.0, 3.0]
    """
    return poses_by_file(path_of(path))
