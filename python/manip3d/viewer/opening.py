"""Opening whatever somebody names: a file, a folder of frames, or the address of a source."""

from __future__ import annotations

import gzip
import itertools
import lzma
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from manip3d import capture, io
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.errors import FormatError, InputError
from manip3d.io._files import limited_bytes
from manip3d.io._scan_files import SCAN_SUFFIXES
from manip3d.io._scan_npy import is_npy_scan
from manip3d.io._scan_tables import scan_suffix
from manip3d.lidar import LidarFrame
from manip3d.viewer.points import DepthImage
from manip3d.viewer.scene import pillow

if TYPE_CHECKING:
    from manip3d.camera import Intrinsics
    from manip3d.mesh import Mesh
    from manip3d.rgbd import RgbdFrame
    from manip3d.viewer.scene import Image

__all__ = ["Kind", "Opened", "kind_of", "open_thing", "rgbd_address", "scan_address"]

Kind = Literal["mesh", "scan", "depth", "rgbd"]

_PACKETS = (".pcap", ".pcapng")
_BAGS = (".mcap", ".db3")
_LIDAR_SCHEMES = ("pcap:", "ouster:", "kitti:", "velodyne:", "bag:")
_SCHEME = re.compile(r"[a-z][a-z0-9-]+:")  # of two characters at least: C:\scan.pcd is a file
_HEADER_BYTES = 1 << 16  # where a PLY file names its elements
_METADATA_BYTES = 1 << 20  # of an Ouster's JSON file, which has about 10 kB


@dataclass(frozen=True, eq=False)
class Opened:
    """Result of `open_any`.

    Attributes
    ----------
    kind : 'mesh', 'scan', 'depth' or 'rgbd'
    thing : Mesh, LidarFrame, DepthImage or RgbdFrame
    note : str
        What was chosen or assumed, in words; empty if there was nothing to choose.
    """

    kind: Kind
    thing: Mesh | LidarFrame | DepthImage | RgbdFrame
    note: str = ""


@checked
def kind_of(source: str | os.PathLike[str]) -> Kind:
    """Return what a file, a folder or an address holds, by its name and by what stands there.

    Anything that is no scan, no depth image and no source of RGB-D frames is a ``mesh``.

    Parameters
    ----------
    source : path or str
        As for `open_thing`.

    Returns
    -------
    'mesh', 'scan', 'depth' or 'rgbd'

    Raises
    ------
    InputError
        ``source`` is neither a path nor a text.
    OSError
        The file must be looked at, and cannot be read.

    Examples
    --------
    >>> from manip3d import viewer
    >>> names = ("bunny.obj", "0.bin", "walk.mkv", "depth.png", "sim:body")
    >>> [viewer.kind_of(name) for name in names]
    ['mesh', 'scan', 'rgbd', 'depth', 'rgbd']
    """
    path_of(source, "source")
    name = os.fspath(source)
    if scan_address(name) is not None:
        return "scan"
    if rgbd_address(name) is not None:
        return "rgbd"
    path = Path(name)
    if path.suffix.lower() == ".npy" and path.is_file() and is_npy_scan(path):
        return "scan"
    if path.suffix.lower() in io.DEPTH_SUFFIXES:
        return "depth"
    suffix = scan_suffix(name)
    if suffix in SCAN_SUFFIXES and (suffix != ".ply" or not _has_faces(Path(name))):
        return "scan"
    return "mesh"


@checked
def scan_address(source: str) -> str | None:
    """Return the address of packets, a bag or a drive, for `manip3d.capture.open_lidar`; or None.

    Parameters
    ----------
    source : str
        A file, a folder or an address; a bag also with one of its topics, as ``drive.bag#/top``.
        A ``.pcap`` beside an Ouster's JSON file of the same name is read as an Ouster's.

    Returns
    -------
    str or None

    Raises
    ------
    InputError
        ``source`` is no text.
    FormatError
        A ROS 1 bag has no index.
    OSError
        A ROS 1 bag cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import viewer
    >>> Path("drive/velodyne").mkdir(parents=True)
    >>> [viewer.scan_address(name) for name in ("turns.pcap", "drive", "bunny.obj")]
    ['pcap:turns.pcap', 'kitti:drive', None]
    """
    if source.startswith(_LIDAR_SCHEMES):
        return source
    if scan_suffix(source) in _PACKETS:
        return f"{'ouster' if _has_ouster_metadata(Path(source)) else 'pcap'}:{source}"
    file, mark, topic = source.rpartition("#")
    if mark and topic and not Path(source).exists() and Path(file).exists():
        address = scan_address(file)
        return f"{address}#{topic}" if address and address.startswith("bag:") else None
    path = Path(source)
    is_bag = scan_suffix(source) in _BAGS or (path / "metadata.yaml").is_file()
    if is_bag or (_is_ros1(path) and capture.holds_clouds(path)):
        return f"bag:{source}"
    is_drive = (path / "velodyne").is_dir() or (path / "velodyne_points").is_dir()
    return f"kitti:{source}" if is_drive else None


def _has_ouster_metadata(recording: Path) -> bool:
    """Whether a sensor's JSON file, which only Ouster's recordings need, lies beside this one."""
    try:
        metadata = limited_bytes(recording.with_suffix(".json"), _METADATA_BYTES)
    except (FormatError, OSError, ValueError):  # ValueError: a name with a zero byte
        return False
    return b'"beam_altitude_angles"' in metadata


def _is_ros1(path: Path) -> bool:
    return path.suffix.lower() == ".bag" and path.is_file()


@checked
def rgbd_address(source: str) -> str | None:
    """Return the address of RGB-D frames, for `manip3d.capture.open_rgbd`; None for anything else.

    Parameters
    ----------
    source : str
        A file, a folder or an address; a ROS 1 bag also with one of its topics of depth images.

    Returns
    -------
    str or None

    Raises
    ------
    InputError
        ``source`` is no text.
    FormatError
        A ROS 1 bag has no index.
    OSError
        A ROS 1 bag cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import viewer
    >>> Path("tum").mkdir()
    >>> Path("tum", "depth.txt").touch()
    >>> [viewer.rgbd_address(name) for name in ("walk.mkv", "tum", "openni2:", "bunny.obj")]
    ['mkv:walk.mkv', 'tum:tum', 'openni2:', None]
    """
    path = Path(source)
    file, mark, topic = source.rpartition("#")
    bag = Path(file) if mark and topic and not path.exists() else path
    if _is_ros1(bag):
        return None if capture.holds_clouds(bag) else f"rgbd-bag:{source}"
    if path.suffix.lower() == ".mkv":
        return source if source.startswith("mkv:") else f"mkv:{source}"
    if path.is_dir():
        if (path / "depth.txt").is_file():
            return f"tum:{source}"
        is_recording = (path / "frames.jsonl").is_file() or (path / "depth").is_dir()
        return f"folder:{source}" if is_recording else None
    if _SCHEME.match(source) and not source.startswith(_LIDAR_SCHEMES) and not path.exists():
        return source
    return None


def _has_faces(path: Path) -> bool:
    """Whether a PLY file has more than points; True for a file that cannot be read."""
    openers: dict[str, Any] = {".gz": gzip.open, ".xz": lzma.open}
    try:
        with openers.get(path.suffix, open)(path, "rb") as stream:
            header = stream.read(_HEADER_BYTES).partition(b"end_header")[0]
    except (OSError, EOFError, lzma.LZMAError):
        return True  # the reader of meshes says what is wrong
    elements = {line.split()[1] for line in header.splitlines() if line.startswith(b"element ")}
    return not elements <= {b"vertex", b"camera"}


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
        A file, a folder of frames, or an address as `manip3d.capture.open` takes it.
    frame : int, optional
        Number of the scan or frame, from 0 on. Default: the first one; for LiDAR packets the first
        whole turn.
    intrinsics : Intrinsics, optional
        Camera of a depth image or of a folder of them.
    unit : str or float
        Unit of a depth image, as `manip3d.io.read_depth_guessing` takes it.
    color : path, optional
        Colour image of a depth image, of the same size.
    calibration : path, optional
        Calibration file of an HDL-64E, for recordings of its packets.

    Returns
    -------
    Opened
        What was read, its kind, and a sentence about how it was read.

    Raises
    ------
    InputError
        There is no such frame, or an option is not for this kind of source.
    FormatError, DeviceError, MissingExtraError, OSError
        As the readers.

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
    if frame and kind in ("mesh", "depth"):
        raise InputError(f"frame: expected none for a {kind} file, which holds one, got {frame}")
    if kind == "scan":
        scan, note = _scan(name, frame, beside)
        return Opened(kind, scan, note)
    if kind == "rgbd":
        return Opened(kind, *_rgbd_frame(name, frame or 0, intrinsics))
    if kind == "depth":
        reading = io.read_depth_guessing(name, unit=unit)
        image = None if color is None else _color_image(color)
        depth = DepthImage(reading.depth, intrinsics, image)
        return Opened(kind, depth, "; ".join(filter(None, (reading.sentence, depth.note))))
    return Opened(kind, io.read_mesh(name))


def _scan(
    name: str, frame: int | None, calibration: str | os.PathLike[str] | None
) -> tuple[LidarFrame, str]:
    uri = scan_address(name)
    if uri is None:
        scans = io.read_scans(name)
        chosen = _numbered(iter(scans), frame or 0, name)
        return chosen, f"scan {frame or 0} of {len(scans)}" if len(scans) > 1 else ""
    with capture.open_lidar(uri, calibration=calibration) as recording:
        if frame is not None:
            return _numbered(iter(recording), frame, name), f"frame {frame}"
        return _first_whole(iter(recording), name)


def _first_whole(scans: Iterator[LidarFrame], name: str) -> tuple[LidarFrame, str]:
    """The first whole turn, the largest part of one where none is whole; and which it is."""
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
    uri = rgbd_address(name)
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


def _color_image(path: Path) -> Image:
    module = pillow()
    try:
        with module.open(path) as image:
            return np.array(image.convert("RGB"))
    except (module.UnidentifiedImageError, ValueError, module.DecompressionBombError) as error:
        raise FormatError(f"expected a colour image: {error}", file=str(path)) from error
