"""Addresses (``bag:PATH``, ``tum:PATH``, ...) under which files and folders are opened."""

from __future__ import annotations

import re
from pathlib import Path

from manip3d._util.checked import checked
from manip3d.capture._bag import holds_clouds
from manip3d.errors import FormatError
from manip3d.io._files import limited_bytes
from manip3d.io._packet_files import PACKETS, ouster_metadata_names
from manip3d.io._scan_tables import scan_suffix
from manip3d.io._utd_mhad import trial_at

_BAGS = (".mcap", ".db3")
_OUSTER = ".osf"
_LIDAR_SCHEMES = ("pcap:", "ouster:", "kitti:", "velodyne:", "bag:")
_SCHEME = re.compile(r"[a-z][a-z0-9-]+:")  # two letters or more, because C:\scan.pcd is a file
_METADATA_BYTES = 1 << 20  # limit for an Ouster's JSON file, which has about 10 kB


@checked
def scan_address(source: str) -> str | None:
    """Return the address under which `open_lidar` opens a LiDAR recording, or None.

    Parameters
    ----------
    source : str
        A file, a folder or an address. ``#`` may add the topic of a bag (``drive.bag#/top``) or the
        number of a sensor in a recording of packets (``drive.osf#1``). ``drive.pcap`` is read as an
        Ouster's recording if an Ouster's JSON file lies in the same folder: ``drive.json``,
        ``drive_0.json``, or, for ``drive_part.pcap``, the longest ``NAME.json`` for which the
        recording's name begins with ``NAME_``.

    Returns
    -------
    str or None
        None if ``source`` is no recording of packets, no bag with point clouds and no drive.

    Raises
    ------
    InputError
        ``source`` is not a str.
    FormatError
        A ROS 1 bag has no index.
    OSError
        A ROS bag cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import capture
    >>> Path("drive/velodyne").mkdir(parents=True)
    >>> [capture.scan_address(name) for name in ("turns.pcap", "drive", "bunny.obj")]
    ['pcap:turns.pcap', 'kitti:drive', None]
    """
    if source.startswith(_LIDAR_SCHEMES):
        return source
    if scan_suffix(source) == _OUSTER:
        return f"ouster:{source}"
    if scan_suffix(source) in PACKETS:
        return f"{'pcap' if ouster_metadata(Path(source)) is None else 'ouster'}:{source}"
    file, mark, topic = source.rpartition("#")
    if mark and topic and not Path(source).exists() and Path(file).exists():
        address = scan_address(file)
        takes_part = address and address.startswith(("bag:", "ouster:", "pcap:"))
        return f"{address}#{topic}" if takes_part else None
    path = Path(source)
    is_bag = scan_suffix(source) in _BAGS or is_ros2(path) or _is_ros1(path)
    if is_bag and (not path.exists() or holds_clouds(path)):
        return f"bag:{source}"
    is_drive = (path / "velodyne").is_dir() or (path / "velodyne_points").is_dir()
    return f"kitti:{source}" if is_drive else None


def ouster_metadata(recording: Path) -> Path | None:
    """Return the JSON file beside an Ouster's recording of packets; None if there is none.

    An ``.osf`` file needs no JSON file, because it contains the sensor's metadata.
    """
    files = (recording.parent / name for name in ouster_metadata_names(recording))
    return next((file for file in files if _is_ouster_metadata(file)), None)


def _is_ouster_metadata(file: Path) -> bool:
    try:
        return b'"beam_altitude_angles"' in limited_bytes(file, _METADATA_BYTES)
    except (FormatError, OSError, ValueError):  # ValueError: a name with a zero byte
        return False


def _is_ros1(path: Path) -> bool:
    return path.suffix.lower() == ".bag" and path.is_file()


def is_ros2(path: Path) -> bool:
    """Return whether an existing file or folder is a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file()
    return path.suffix.lower() in _BAGS and path.is_file()


@checked
def rgbd_address(source: str) -> str | None:
    """Return the address under which `open_rgbd` opens RGB-D frames, or None.

    Parameters
    ----------
    source : str
        A file, a folder or an address. ``#`` may add a topic of depth images to a ROS bag. A depth
        file of UTD-MHAD (``a3_s1_t1_depth.mat``) is a recording because its joints lie beside it.

    Returns
    -------
    str or None
        None if ``source`` holds no RGB-D frames.

    Raises
    ------
    InputError
        ``source`` is not a str.
    FormatError
        A ROS 1 bag has no index.
    OSError
        A ROS bag cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import capture
    >>> Path("tum").mkdir()
    >>> Path("tum", "depth.txt").touch()
    >>> [capture.rgbd_address(name) for name in ("walk.mkv", "tum", "openni2:", "bunny.obj")]
    ['mkv:walk.mkv', 'tum:tum', 'openni2:', None]
    """
    path = Path(source)
    if _SCHEME.match(source) and not path.exists():
        return None if source.startswith(_LIDAR_SCHEMES) else source
    file, mark, topic = source.rpartition("#")
    bag = Path(file) if mark and topic and not path.exists() else path
    if _is_ros1(bag) or is_ros2(bag):
        return None if holds_clouds(bag) else f"rgbd-bag:{source}"
    if path.suffix.lower() == ".mkv":
        return f"mkv:{source}"
    if path.is_dir():
        if (path / "depth.txt").is_file():
            return f"tum:{source}"
        if (path / "frames.jsonl").is_file() or (path / "depth").is_dir():
            return f"folder:{source}"
    trial = trial_at(source)
    return None if trial is None else f"utd-mhad:{trial}"
