"""Opening of any viewable source: a file, a folder of frames, or the address of a source."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from manip3d import capture, io
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import InputError
from manip3d.io._images import read_color
from manip3d.io._scan_files import SCAN_SUFFIXES, are_points_only, holds_points, ply_elements
from manip3d.io._scan_tables import scan_suffix
from manip3d.lidar import LidarFrame
from manip3d.viewer.sensor_points import DepthImage

if TYPE_CHECKING:
    from manip3d.camera import Intrinsics
    from manip3d.mesh import Mesh
    from manip3d.rgbd import RgbdFrame

__all__ = ["Kind", "Opened", "kind_of", "open_thing"]

Kind = Literal["mesh", "scan", "depth", "rgbd"]

_OPTIONS: Mapping[Kind, frozenset[str]] = {
    "mesh": frozenset(),
    "scan": frozenset({"frame"}),
    "depth": frozenset({"intrinsics", "unit", "color"}),
    "rgbd": frozenset({"frame", "intrinsics"}),
}
"""Options of `open_thing` that apply to each kind of source; ``calibration``: see `options_of`."""

_WORDS: Mapping[Kind, str] = {
    "mesh": "mesh file",
    "scan": "scan",
    "depth": "depth image",
    "rgbd": "recording",
}
"""Names of the kinds in messages."""


@dataclass(frozen=True, eq=False)
class Opened:
    """Result of `open_thing`.

    Attributes
    ----------
    kind : 'mesh', 'scan', 'depth' or 'rgbd'
    thing : Mesh, LidarFrame, DepthImage or RgbdFrame
    note : str
        Sentence about choices and assumptions; empty: there were none.
    """

    kind: Kind
    thing: Mesh | LidarFrame | DepthImage | RgbdFrame
    note: str = ""


@checked
def kind_of(source: str | os.PathLike[str]) -> Kind:
    """Return the kind of content of a file, folder or address, by its name and content.

    Anything that is not a scan, a depth image or a source of RGB-D frames counts as ``mesh``.

    Parameters
    ----------
    source : path or str
        Source, as for `open_thing`.

    Returns
    -------
    'mesh', 'scan', 'depth' or 'rgbd'

    Raises
    ------
    InputError
        ``source`` is neither a path nor a text.
    OSError
        The name does not decide, and the file cannot be read.

    Examples
    --------
    >>> from manip3d import viewer
    >>> names = ("bunny.obj", "0.bin", "walk.mkv", "depth.png", "sim:body")
    >>> [viewer.kind_of(name) for name in names]
    ['mesh', 'scan', 'rgbd', 'depth', 'rgbd']
    """
    path_of(source, "source")
    name = os.fspath(source)
    if capture.scan_address(name) is not None:
        return "scan"
    if capture.rgbd_address(name) is not None:
        return "rgbd"
    path = Path(name)
    if path.suffix.lower() in (".npy", ".npz") and path.is_file() and holds_points(path):
        return "scan"
    if path.suffix.lower() in io.DEPTH_SUFFIXES:
        return "depth"
    suffix = scan_suffix(name)
    if suffix in SCAN_SUFFIXES and (suffix != ".ply" or _is_cloud(Path(name))):
        return "scan"
    return "mesh"


def options_of(source: str, kind: Kind) -> frozenset[str]:
    """Return the names of the options of `open_thing` that apply to a source of this kind."""
    # The reader of the address refuses a calibration unless it reads packets of an HDL-64E.
    has_address = kind == "scan" and capture.scan_address(source) is not None
    return _OPTIONS[kind] | ({"calibration"} if has_address else frozenset())


def _is_cloud(path: Path) -> bool:
    """Return whether a PLY file contains only points; False if the file cannot be read."""
    elements = ply_elements(path)
    return elements is not None and are_points_only(elements)


@checked
def open_thing(
    source: str | os.PathLike[str],
    *,
    frame: int | None = None,
    intrinsics: Intrinsics | None = None,
    unit: str | float = "guess",
    color: str | os.PathLike[str] | None = None,
    calibration: str | os.PathLike[str] | None = None,
) -> Opened:
    """Open a mesh, a scan, a depth image, or one frame of a recording.

    Parameters
    ----------
    source : path or str
        A file, a folder of frames, or an address for `manip3d.capture.open`.
    frame : int, optional
        Number of the scan or frame, from 0 on. Default: the first one; for LiDAR packets the first
        whole turn.
    intrinsics : Intrinsics, optional
        Camera of a depth image or of a folder of depth images.
    unit : str or float
        Unit of a depth image, as for `manip3d.io.read_depth_guessing`.
    color : path, optional
        Colour image of a depth image, of the same size.
    calibration : path, optional
        Calibration file of an HDL-64E, for recordings of its packets.

    Returns
    -------
    Opened
        The object, its kind, and a sentence about choices and assumptions.

    Raises
    ------
    InputError
        There is no such frame, or an option does not apply to this kind of source.
    FormatError, DeviceError, MissingExtraError, OSError
        As raised by the readers.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, io, viewer
    >>> io.write_scan(LidarFrame(np.ones((5, 3), np.float32)), "scan.bin")
    >>> opened = viewer.open_thing("scan.bin")
    >>> opened.kind, opened.thing.num_points
    ('scan', 5)
    """
    name = os.fspath(source)
    kind = kind_of(source)
    beside = None if calibration is None else path_of(calibration, "calibration")
    color = None if color is None else path_of(color, "color")
    if frame is not None and frame < 0:
        raise InputError(f"frame: expected 0 or more, got {frame}")
    _refuse_useless(
        name,
        kind,
        {
            "frame": frame or None,  # 0 is the only one of a file
            "intrinsics": intrinsics,
            "unit": None if unit == "guess" else unit,
            "color": color,
            "calibration": calibration,
        },
    )
    if kind == "scan":
        scan, note = _scan(name, frame, beside)
        return Opened(kind, scan, note)
    if kind == "rgbd":
        return Opened(kind, *_rgbd_frame(name, frame or 0, intrinsics))
    if kind == "depth":
        reading = io.read_depth_guessing(name, unit=unit)
        image = None if color is None else read_color(color, reading.depth.shape)
        depth = DepthImage(reading.depth, intrinsics, image)
        return Opened(kind, depth, "; ".join(filter(None, (reading.sentence, depth.note))))
    return Opened(kind, io.read_mesh(name))


def _refuse_useless(source: str, kind: Kind, given: Mapping[str, object]) -> None:
    """Refuse options that do not apply to this kind of source; None: not given."""
    known = options_of(source, kind)
    is_folder = kind == "mesh" and Path(source).is_dir()  # no mesh, but no reader knows it either
    what = "folder without a drive or a recording" if is_folder else _WORDS[kind]
    for name, value in given.items():
        if value is not None and name not in known:
            got = os.fspath(value) if isinstance(value, os.PathLike) else repr(value)
            raise InputError(f"{name}: expected none for a {what}, got {got}")


def _scan(
    name: str, frame: int | None, calibration: str | os.PathLike[str] | None
) -> tuple[LidarFrame, str]:
    uri = capture.scan_address(name)
    if uri is None:
        scans = io.read_scans(name)
        chosen = _numbered(iter(scans), frame or 0, name)
        return chosen, f"scan {frame or 0} of {len(scans)}" if len(scans) > 1 else ""
    with capture.open_lidar(uri, calibration=calibration) as recording:
        if frame is not None:
            return _numbered(iter(recording), frame, name), f"frame {frame}"
        return _first_whole(iter(recording), name)


def _first_whole(scans: Iterator[LidarFrame], name: str) -> tuple[LidarFrame, str]:
    """Return the first whole turn, or else the largest partial one; and a sentence about it."""
    best: tuple[LidarFrame, int] | None = None
    for number, scan in enumerate(scans):
        header = {} if scan.format is None else scan.format.header
        if header.get("is_complete", True):
            note = "" if number == 0 else f", the first whole turn; {number} before it"
            return scan, f"frame {number}{note}"
        if best is None or scan.num_points > best[0].num_points:
            best = scan, number
    if best is None:
        raise InputError(f"{name}: expected a scan, found none")
    return best[0], f"frame {best[1]}, a part of a turn: no turn is whole"


def _rgbd_frame(name: str, frame: int, intrinsics: Intrinsics | None) -> tuple[RgbdFrame, str]:
    uri = capture.rgbd_address(name)
    assert uri is not None
    options: dict[str, Any] = {} if intrinsics is None else {"camera": intrinsics}
    with capture.open_rgbd(uri, **options) as source:
        chosen = _numbered(iter(source), frame, name)
        total = f" of {source.num_frames}" if source.num_frames else ""
        return chosen, f"frame {frame}{total}"


def _numbered(frames: Iterator[Any], number: int, name: str) -> Any:
    found = 0
    for found, frame in enumerate(itertools.islice(frames, number + 1), 1):
        if found == number + 1:
            return frame
    if not found:
        raise InputError(f"{name}: expected a frame, found none")
    raise InputError(f"frame: expected at most {found - 1} of {name}, got {number}")
