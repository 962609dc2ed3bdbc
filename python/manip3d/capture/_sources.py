"""Opening of any sensor or recording by its address, and the list of all kinds of sources."""

from __future__ import annotations

from typing import Any

from manip3d._util.checked import checked
from manip3d.capture._lidar import LidarSource, open_lidar
from manip3d.capture._rgbd import Scheme, core_schemes, open_rgbd
from manip3d.capture._rgbd_source import RgbdSource

_LIDAR = ("pcap", "velodyne", "ouster", "kitti", "bag")


@checked
def open(uri: str, **options: Any) -> LidarSource | RgbdSource:
    """Open a sensor or a recording by its address; `sources` lists the kinds.

    Parameters
    ----------
    uri : str
        Address of the form ``SCHEME:PLACE``.
    **options
        Options of `open_lidar` (``pcap:``, ``velodyne:``, ``ouster:``, ``kitti:``, ``bag:``) or of
        `open_rgbd` (all others).

    Returns
    -------
    LidarSource or RgbdSource
        The result of `open_lidar` or of `open_rgbd`; type checkers know its type only if these are
        called directly.

    Raises
    ------
    InputError, FormatError, DeviceError, OSError, MissingExtraError
        See `open_lidar` and `open_rgbd`.

    Examples
    --------
    >>> with manip3d.capture.open("folder:walk") as source:  # doctest: +SKIP
    ...     for frame in source:
    ...         print(frame.time_ns, frame.depth.shape)
    """
    return open_lidar(uri, **options) if _scheme(uri) in _LIDAR else open_rgbd(uri, **options)


def _scheme(uri: str) -> str:
    return uri.partition(":")[0]


def sources() -> tuple[Scheme, ...]:
    """Return all kinds of sources, including those that cannot be opened on this computer.

    This looks for connected devices, which may take a second.

    Returns
    -------
    tuple of Scheme
        ``reason`` and ``cure`` are empty for kinds that can be opened.

    Examples
    --------
    >>> from manip3d import capture
    >>> schemes = {scheme.name: scheme for scheme in capture.sources()}
    >>> schemes["tum"].frames, schemes["tum"].is_available
    ('rgbd', True)
    """
    from importlib.util import find_spec

    ouster, open3d, rosbags = (
        find_spec(module) is None for module in ("ouster", "open3d", "rosbags")
    )
    no_bags = ("rosbags is not installed", "pip install 'manip3d[bags]'") if rosbags else ()
    return (
        *core_schemes(),
        Scheme(
            "sim",
            "body...",
            "a simulated person before a depth camera",
            "rgbd",
            "Open3D is not installed" if open3d else "",
            "pip install 'manip3d[simulate]'" if open3d else "",
        ),
        *(
            Scheme(name, place, "people of the data sets (manip3d data list)", "rgbd")
            for name, place in (
                ("utd-mhad", "NAME or PATH"),
                ("labanotation", "NAME"),
                ("people", "NAME"),
            )
        ),
        Scheme(
            "rgbd-bag",
            "PATH[#TOPIC]",
            "images of an RGB-D camera in ROS 1, ROS 2 and MCAP bags (RealSense's recordings)",
            "rgbd",
            *no_bags,
        ),
        Scheme(
            "joints",
            "SOURCE#FILE",
            "a recording with joints of NTU RGB+D, OpenPose, COCO, Azure Kinect or a table",
            "rgbd",
        ),
        Scheme("forged", "SOURCE[#OPTIONS]", "another source's person, forged on demand", "rgbd"),
        Scheme("pcap", "FILE[#SENSOR]", "recorded packets of Velodyne LiDARs", "lidar"),
        Scheme("velodyne", "[ADDRESS:]PORT", "a Velodyne LiDAR on the network", "lidar"),
        Scheme(
            "ouster",
            "FILE",
            "recorded packets of Ouster LiDARs, and .osf",
            "lidar",
            "ouster-sdk is not installed" if ouster else "",
            "pip install 'manip3d[ouster]'" if ouster else "",
        ),
        Scheme("kitti", "FOLDER", "drives in KITTI's layout", "lidar"),
        Scheme(
            "bag",
            "PATH[#TOPIC]",
            "point clouds of ROS 1, ROS 2 and MCAP bags",
            "lidar",
            *no_bags,
        ),
    )
