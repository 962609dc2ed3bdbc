"""Frames out of sensors and recordings: ``open("pcap:FILE")``, ``open("folder:walk")``, ...

A source is iterated; each item is a `manip3d.LidarFrame` or a `manip3d.RgbdFrame`. What was seen
and what was refused is in its ``counters``. `sources` lists what can be opened; `record` writes
recordings of RGB-D frames.

Drivers of RGB-D cameras, each where its library was at build time, and what it was tried with:

============== ============================ ==================================================
``openni2:``   OpenNI2 2.2                  its Dummy device; no camera
``freenect2:`` libfreenect2 0.2             the library without a camera
``realsense:`` librealsense2 2.53 or later  2.59: a D435's recording (``FILE.bag``); no camera
``orbbec:``    OrbbecSDK 2                  2.9: the library without a camera or a recording
============== ============================ ==================================================
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import _core
from manip3d._capture_rgbd import (
    Recording,
    RgbdSource,
    Scheme,
    core_schemes,
    from_frames,
    open_rgbd,
    record,
)
from manip3d._frame_source import FrameSource
from manip3d.errors import InputError
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "RETURN_TYPES",
    "LidarSource",
    "Recording",
    "RgbdSource",
    "Scheme",
    "VelodyneCalibration",
    "from_frames",
    "open",
    "open_lidar",
    "open_rgbd",
    "read_velodyne_calibration",
    "record",
    "sources",
]

RETURN_TYPES: tuple[str, ...] = ("unknown", "strongest", "last", "both")
"""What the values of ``fields["return_type"]`` mean; both: the last return is the strongest."""

DEFAULT_PORT = 2368


@dataclass(frozen=True, eq=False)
class VelodyneCalibration:
    """Where each laser looks and what its ranges need, in the terms of the HDL-64E's db.xml.

    Attributes
    ----------
    elevation, azimuth_offset : (L,) float64
        Degrees; the offset is added to the rotor's azimuth, clockwise from above.
    range_offset : (L,) float64
        Metres, added to every range; at 25.04 m for lasers with ``two_points``.
    two_points : (L,) bool
        Lasers with offsets measured at two distances.
    range_offset_x, range_offset_y : (L,) float64
        Metres, at 2.4 m along x and at 1.93 m along y.
    vertical_offset, horizontal_offset : (L,) float64
        Of the laser, metres, at right angles to its beam.
    range_unit : float
        Metres.
    """

    elevation: NDArray[np.float64]
    azimuth_offset: NDArray[np.float64]
    range_offset: NDArray[np.float64]
    two_points: NDArray[np.bool_]
    range_offset_x: NDArray[np.float64]
    range_offset_y: NDArray[np.float64]
    vertical_offset: NDArray[np.float64]
    horizontal_offset: NDArray[np.float64]
    range_unit: float = 0.002

    def table(self) -> NDArray[np.float64]:
        """(L, 8) float64: the attributes as columns, in their order."""
        columns = [
            self.elevation,
            self.azimuth_offset,
            self.range_offset,
            self.two_points,
            self.range_offset_x,
            self.range_offset_y,
            self.vertical_offset,
            self.horizontal_offset,
        ]
        return np.ascontiguousarray(np.column_stack(columns), np.float64)


def read_velodyne_calibration(path: str | os.PathLike[str]) -> VelodyneCalibration:
    """Read an HDL-64E's calibration: Velodyne's ``db.xml``, or the YAML that ROS makes of it.

    Raises
    ------
    FormatError
        The file is damaged or hostile (entities are refused), or a laser is missing.
    MissingExtraError
        PyYAML is not installed and the file is YAML: ``pip install 'manip3d[velodyne]'``.
    """
    from manip3d._velodyne_calibration import read

    return VelodyneCalibration(**read(Path(path)))


class LidarSource(FrameSource[LidarFrame]):
    """Scans one after the other; made by `open`.

    Attributes
    ----------
    uri : str
    counters : dict of str to int
        What was seen and refused so far; every firing of a good block is exactly one of
        ``points``, ``no_return``, ``duplicates`` and ``out_of_range``.
    """

    def __init__(self, uri: str, source: Any, *, live: bool) -> None:
        self.uri = uri
        self.is_live = live
        self._source = source
        self._skipped = 0

    @property
    def counters(self) -> dict[str, int]:
        """What was seen and refused so far."""
        found: dict[str, int] = self._source.counters()
        return found | {"skipped": self._skipped}

    @property
    def port(self) -> int:
        """The UDP port that a live source listens on."""
        if not self.is_live:
            raise InputError(f"port: {self.uri} is a recording")
        return int(self._source.port())

    def read(self, timeout: float | None = None) -> LidarFrame | None:
        """The next frame.

        Parameters
        ----------
        timeout : float, optional
            Seconds to wait for a live source; without it until there is one.

        Returns
        -------
        LidarFrame or None
            None: the recording ends, the source was stopped, or the time is over.
        """
        return self._wait(timeout)

    def _to_frame(self, fields: Mapping[str, Any]) -> LidarFrame:
        return _to_frame(dict(fields), self.uri)

    def read_latest(self, timeout: float | None = None) -> LidarFrame | None:
        """The newest frame of a live source; older ones that wait are skipped, and counted.

        For displays: every packet is still decoded. ``counters["skipped"]`` has the frames.

        Parameters
        ----------
        timeout : float, optional
            As for `read`.

        Raises
        ------
        InputError
            The source is a recording.
        """
        if not self.is_live:
            raise InputError(f"read_latest: {self.uri} is a recording")
        frame = self.read(timeout)
        while frame is not None and (newer := self.read(timeout=0.0)) is not None:
            self._skipped += 1
            frame = newer
        return frame

    def stop(self) -> None:
        """End a live source's thread; what it has collected can still be read."""
        if self.is_live:
            self._source.stop()


_LIDAR = ("pcap", "velodyne", "ouster", "kitti")


def open(uri: str, **options: Any) -> LidarSource | RgbdSource:
    """Open a sensor or a recording by its address; `sources` lists the kinds.

    Parameters
    ----------
    uri : str
        ``SCHEME:PLACE``.
    **options
        Those of `open_lidar` (``pcap:``, ``velodyne:``, ``ouster:``, ``kitti:``) or of `open_rgbd`
        (all others).

    Returns
    -------
    LidarSource or RgbdSource
        As the functions of those names, which also have the exact types.

    Raises
    ------
    InputError, FormatError, DeviceError, OSError, MissingExtraError
        As those functions.

    Examples
    --------
    >>> with manip3d.capture.open("folder:walk") as source:  # doctest: +SKIP
    ...     for frame in source:
    ...         print(frame.time, frame.depth.shape)
    """
    return open_lidar(uri, **options) if _scheme(uri) in _LIDAR else open_rgbd(uri, **options)


def _scheme(uri: str) -> str:
    return uri.partition(":")[0]


def sources() -> tuple[Scheme, ...]:
    """All kinds of sources, also those that cannot be opened here, with the reason and the cure.

    Looks for devices, which may take a second.
    """
    from importlib.util import find_spec

    ouster, open3d = (find_spec(module) is None for module in ("ouster", "open3d"))
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
            Scheme(name, "NAME", "people of the data sets (manip3d data list)", "rgbd")
            for name in ("utd-mhad", "labanotation", "people")
        ),
        Scheme("pcap", "FILE", "recorded packets of Velodyne LiDARs", "lidar"),
        Scheme("velodyne", "[ADDRESS:]PORT", "a Velodyne LiDAR on the network", "lidar"),
        Scheme(
            "ouster",
            "FILE",
            "recorded packets of Ouster LiDARs",
            "lidar",
            "ouster-sdk is not installed" if ouster else "",
            "pip install 'manip3d[ouster]'" if ouster else "",
        ),
        Scheme("kitti", "FOLDER", "drives in KITTI's layout", "lidar"),
    )


def open_lidar(
    uri: str,
    *,
    model: str | None = None,
    calibration: VelodyneCalibration | str | os.PathLike[str] | None = None,
    cut_azimuth: float = 0.0,
    interpolate_azimuth: bool = True,
    min_range: float = 0.0,
    max_range: float = 1000.0,
    port: int | None = None,
    sender: str | None = None,
    ring_packets: int = 16384,
    metadata: str | os.PathLike[str] | None = None,
    max_bytes: int | None = None,
) -> LidarSource:
    """Open a LiDAR or its recording: Velodyne HDL-64E, HDL-32E, VLP-16, VLP-32C; Ouster.

    Parameters
    ----------
    uri : str
        ``pcap:FILE`` (pcap or pcapng, also ``.gz`` and ``.xz``), or
        ``velodyne:[ADDRESS:]PORT``, which listens on an address of this machine (127.0.0.1;
        0.0.0.0 for a sensor on the network; port 2368; 0: a free one), or ``ouster:FILE`` (a pcap
        of an Ouster, through ouster-sdk; of the options below only ``metadata`` is for it), or
        ``kitti:FOLDER`` (`manip3d.datasets.open_kitti`; takes none of them).
    model : str, optional
        ``hdl64e``, ``hdl32e``, ``vlp16`` or ``vlp32c``; without it the first packet says.
    calibration : VelodyneCalibration or path, optional
        An HDL-64E needs it (see `read_velodyne_calibration`); without it the model's own table.
    cut_azimuth : float
        A frame ends where the azimuth passes this angle, degrees in [0, 360), clockwise from
        above, 0 ahead.
    interpolate_azimuth : bool
        Turn the azimuth on with the time of each firing in a block.
    min_range, max_range : float, metres
        Other returns are left out, and counted.
    port : int, optional
        Of a recording, take packets sent to this port only: one of several sensors.
    sender : str, optional
        Take packets from this address only (live).
    ring_packets : int
        Packets that wait to be read before more are dropped, and counted (live).
    metadata : path, optional
        The Ouster's JSON file; without it the one beside the recording, of the same name.
    max_bytes : int, optional
        The most uncompressed bytes to read of a recording.

    Returns
    -------
    LidarSource
        Its frames have x forward, y left, z up, metres; ``intensity`` 0 to 255 as sent; ``ring``
        0 the highest laser; ``fields``: ``laser`` (number in the packet), ``azimuth`` (degrees),
        ``range`` (metres, as sent), ``time`` (seconds after ``timestamp``), ``return_type`` (see
        `RETURN_TYPES`). ``timestamp`` is when the frame's first packet was received. ``format``
        tells the model, the sensor's own time and whether the turn is complete. An Ouster's
        ``fields`` are ``column``, ``range``, ``time``, ``return`` (1, 2) and its own (``near_ir``).

    Raises
    ------
    InputError
        An unknown scheme, an option out of range, an HDL-64E without calibration (when read).
    FormatError
        The recording is damaged.
    DeviceError
        The port is taken.
    MissingExtraError
        ouster-sdk is not installed: ``pip install 'manip3d[ouster]'``.
    """
    if isinstance(calibration, str | os.PathLike):
        calibration = read_velodyne_calibration(calibration)
    options = _core.VelodyneOptions(
        model=model or "",
        lasers=np.empty((0, 8)) if calibration is None else calibration.table(),
        range_unit=0.002 if calibration is None else calibration.range_unit,
        cut_azimuth=cut_azimuth,
        interpolate_azimuth=interpolate_azimuth,
        min_range=min_range,
        max_range=max_range,
    )
    scheme, colon, rest = uri.partition(":")
    if colon and scheme == "pcap":
        from manip3d._scan_files import byte_limit

        limit = byte_limit(max_bytes)
        wanted = -1 if port is None else port
        if not -1 <= wanted < 1 << 16:
            raise InputError(f"port: expected 0 to 65535, got {port}")
        recording = _core.VelodynePcapSource(os.fsencode(rest), options, wanted, limit)
        return LidarSource(uri, recording, live=False)
    if colon and scheme == "ouster":
        from manip3d._capture_ouster import OusterRecording

        return LidarSource(uri, OusterRecording(Path(rest), metadata), live=False)
    if colon and scheme == "kitti":
        return LidarSource(uri, _Drive(Path(rest)), live=False)
    if colon and scheme == "velodyne":
        address, bound = _address(rest)
        if not 0 < ring_packets <= 1 << 20:
            raise InputError(f"ring_packets: expected 1 to {1 << 20}, got {ring_packets}")
        source = _core.VelodyneUdpSource(address, bound, sender or "", ring_packets, options)
        source.start()
        return LidarSource(uri, source, live=True)
    raise InputError(
        f"uri: expected pcap:FILE, ouster:FILE or velodyne:[ADDRESS:]PORT, got {uri!r}"
    )


class _Drive:
    """The scans of a drive; the same face as the core's sources."""

    def __init__(self, folder: Path) -> None:
        from manip3d.datasets import open_kitti

        self._frames = iter(open_kitti(folder))
        self._counters = {"frames": 0, "points": 0}

    def read(self, timeout_ms: int) -> LidarFrame | bool:
        """The next scan, or False at the end."""
        frame = next(self._frames, None)
        if frame is None:
            return False
        scan = frame.scan()
        self._counters["frames"] += 1
        self._counters["points"] += scan.num_points
        return scan

    def counters(self) -> dict[str, int]:
        """Frames and points."""
        return dict(self._counters)


def _address(text: str) -> tuple[str, int]:
    address, colon, port = text.rpartition(":")
    number = -1
    with contextlib.suppress(ValueError):
        number = int(port) if port else DEFAULT_PORT
    if not 0 <= number < 1 << 16:
        raise InputError(f"uri: expected a port from 0 to 65535, got {port!r}")
    return (address if colon else "127.0.0.1"), number


def _to_frame(fields: dict[str, Any], uri: str) -> LidarFrame:
    header = {key: fields.pop(key) for key in ("model", "sensor_time", "packets", "is_complete")}
    return LidarFrame(
        points=fields.pop("points").reshape(-1, 3),
        intensity=fields.pop("intensity"),
        timestamp=fields.pop("receive_time"),
        ring=fields.pop("ring"),
        origin=(0.0, 0.0, 0.0),
        source=uri,
        fields=fields,
        format=ScanFormat("velodyne", header=header),
    )
