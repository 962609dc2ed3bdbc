"""LiDARs and their recordings as `LidarFrame`s: Velodyne, Ouster, ROS bags, KITTI drives."""

from __future__ import annotations

import contextlib
import inspect
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d.capture._bag import place_and_topic
from manip3d.capture._frame_source import FrameSource
from manip3d.capture._velodyne_calibration import VelodyneCalibration, read_velodyne_calibration
from manip3d.errors import FormatError, InputError
from manip3d.lidar import LidarFrame, ScanFormat

RETURN_TYPES: tuple[str, ...] = ("unknown", "strongest", "last", "both")
"""Meanings of ``fields["return_type"]``, by value; both: the last return is the strongest."""

DEFAULT_PORT = 2368

_Item = TypeVar("_Item")


@checked
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
        self._lock = threading.Lock()

    @property
    def counters(self) -> dict[str, int]:
        """Counts of packets and points that were seen and refused so far."""
        found: dict[str, int] = self._source.counters()
        return found | {"skipped": self._skipped}

    @property
    def port(self) -> int:
        """The UDP port that a live source listens on.

        Raises
        ------
        InputError
            The source is a recording.
        """
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
            with self._lock:
                self._skipped += 1
            frame = newer
        return frame

    def stop(self) -> None:
        """End a live source's thread; what it has collected can still be read.

        A recording gives no more frames.
        """
        self._is_stopped = True
        if self.is_live:
            self._source.stop()


@checked
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
        0.0.0.0 for a sensor on the network; port 2368; 0: a free one), or ``ouster:FILE[#N]``
        (packets of an Ouster in a pcap or a ROS bag, or an ``.osf``, through ouster-sdk; of the
        options below only ``metadata`` is for it; N: the sensor, from 0, where there are several),
        or
        ``kitti:FOLDER`` (`manip3d.datasets.open_kitti`; takes none of them), or
        ``bag:PATH[#TOPIC]``: the PointCloud2 or Livox CustomMsg messages of a ROS bag (a ``.mcap``
        or ``.db3`` file, a ROS 2 bag's folder, a ROS 1 ``.bag``) through rosbags; it takes
        ``max_bytes`` only. Without a topic the bag has one of clouds.
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
        Take only packets that were sent to this port, as for one of several sensors in a recording.
    sender : str, optional
        Take packets from this address only (live).
    ring_packets : int
        Packets that wait to be read before more are dropped, and counted (live).
    metadata : path, optional
        The Ouster's JSON file; without it the one beside the pcap (see `scan_address`).
    max_bytes : int, optional
        The most uncompressed bytes to read of a recording.

    Returns
    -------
    LidarSource
        Its frames have x forward, y left, z up, metres; ``intensity`` 0 to 255 as sent; ``ring``
        0 the highest laser; ``fields``: ``laser`` (number in the packet), ``azimuth`` (degrees),
        ``range`` (metres, as sent), ``time`` (seconds after ``time_ns``), ``return_type`` (see
        `RETURN_TYPES`). ``time_ns`` is when the frame's first packet was received. ``format``
        tells the model, the sensor's own time and whether the turn is complete. An Ouster's
        ``fields`` are ``column``, ``range``, ``time``, ``return`` (1, 2) and its own (``near_ir``).
        A bag's are those of its messages; ``time_ns`` is the message's own, else when it was
        recorded; ``origin`` is None where the frame's name says that the scanner is elsewhere
        (``base_link``, ``map``, ``odom``).

    Raises
    ------
    InputError
        An unknown scheme, an option out of range or of another scheme, an HDL-64E without
        calibration (when read).
    FormatError
        The recording is damaged.
    DeviceError
        The port is taken.
    MissingExtraError
        ouster-sdk or rosbags is not installed: ``pip install 'manip3d[ouster]'``, ``[bags]``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import LidarFrame, capture, io
    >>> from pathlib import Path
    >>> Path("drive/velodyne").mkdir(parents=True)
    >>> io.write_scan(LidarFrame(np.ones((5, 3), np.float32)), "drive/velodyne/000000.bin")
    >>> [frame.num_points for frame in capture.open_lidar("kitti:drive")]
    [5]
    """
    scheme, colon, rest = uri.partition(":")
    _refuse_unused(scheme, locals())
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
    if colon and scheme == "pcap":
        from manip3d.io._limits import byte_limit

        limit = byte_limit(max_bytes)
        wanted = -1 if port is None else port
        if not -1 <= wanted < 1 << 16:
            raise InputError(f"port: expected 0 to 65535, got {port}")
        recording = _core.VelodynePcapSource(os.fsencode(rest), options, wanted, limit)
        return LidarSource(uri, recording, live=False)
    if colon and scheme == "ouster":
        from manip3d.capture._ouster import OusterRecording

        place, mark, sensor = rest.rpartition("#")
        if not mark or Path(rest).exists():
            place, sensor = rest, ""
        ouster = OusterRecording(path_of(place, "uri"), sensor, metadata)
        return LidarSource(uri, ouster, live=False)
    if colon and scheme == "bag":
        from manip3d.capture._bag import BagRecording
        from manip3d.io._limits import byte_limit

        place, topic = place_and_topic(uri)
        bag = BagRecording(path_of(place, "uri"), topic, byte_limit(max_bytes) or None)
        return LidarSource(uri, bag, live=False)
    if colon and scheme == "kitti":
        return LidarSource(uri, _Drive(path_of(rest, "uri")), live=False)
    if colon and scheme == "velodyne":
        address, bound = _address(rest)
        if not 0 < ring_packets <= 1 << 20:
            raise InputError(f"ring_packets: expected 1 to {1 << 20}, got {ring_packets}")
        source = _core.VelodyneUdpSource(
            os.fsencode(address), bound, os.fsencode(sender or ""), ring_packets, options
        )
        source.start()
        return LidarSource(uri, source, live=True)
    raise InputError(
        "uri: expected pcap:FILE, ouster:FILE[#N], kitti:FOLDER, bag:PATH[#TOPIC] or "
        f"velodyne:[ADDRESS:]PORT, got {uri!r}"
    )


_VELODYNE = frozenset(
    ("model", "calibration", "cut_azimuth", "interpolate_azimuth", "min_range", "max_range")
)
_USED = {
    "pcap": _VELODYNE | {"port", "max_bytes"},
    "velodyne": _VELODYNE | {"sender", "ring_packets"},
    "ouster": frozenset({"metadata"}),
    "kitti": frozenset[str](),
    "bag": frozenset({"max_bytes"}),
}
"""The options of `open_lidar` that each scheme uses."""


def _refuse_unused(scheme: str, arguments: Mapping[str, Any]) -> None:
    """Raise where an option is given that the scheme would ignore."""
    parameters = inspect.signature(open_lidar).parameters
    for name in sorted(set(parameters) - {"uri"} - _USED.get(scheme, frozenset(parameters))):
        value = arguments[name]
        if value is not parameters[name].default and value != parameters[name].default:
            raise InputError(f"{name}: expected none for {scheme}:, got {value!r}")


def expect_scans(
    items: Iterable[_Item], uri: str, counters: Callable[[], Mapping[str, int]]
) -> Iterator[_Item]:
    """Pass on what is made of a recording's scans, and refuse a recording that ends without one.

    The error tells what was counted instead: only that shows why packets gave no scan.
    """
    is_empty = True
    for item in items:
        is_empty = False
        yield item
    if not is_empty:
        return
    counted = counters()
    told = ", ".join(f"{name.replace('_', ' ')} {n}" for name, n in counted.items() if n)
    reason = "expected scans, found none" + (f"; counted: {told}" if told else "")
    scheme, _, place = uri.partition(":")
    file = place_and_topic(uri)[0] if scheme == "bag" else place
    if scheme == "pcap" and (counted.get("bad_length") or counted.get("file_fragments")):
        reason += "; an Ouster's recording needs its JSON file of the same name beside it"
    raise FormatError(reason, file=file)


class _Drive:
    """The scans of a drive; the same interface as the core's sources."""

    def __init__(self, folder: Path) -> None:
        from manip3d.datasets import open_kitti

        self._frames = iter(open_kitti(folder))
        self._counters = {"frames": 0, "points": 0}
        self._lock = threading.RLock()

    def read(self, timeout_ms: int) -> LidarFrame | bool:
        """The next scan, or False at the end."""
        with self._lock:
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
        time_ns=fields.pop("time_ns"),
        ring=fields.pop("ring"),
        origin=(0.0, 0.0, 0.0),
        source=uri,
        fields=fields,
        format=ScanFormat("velodyne", header=header),
    )
