"""Sources of `LidarFrame`s: Velodyne and Ouster scanners, ROS bags, KITTI drives."""

from __future__ import annotations

import contextlib
import inspect
import itertools
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
from manip3d.capture._frame_source import ClosedSource, FrameSource
from manip3d.capture._past_errors import past_errors
from manip3d.capture._velodyne_calibration import VelodyneCalibration, read_velodyne_calibration
from manip3d.errors import Error, FormatError, InputError
from manip3d.lidar import LidarFrame, ScanFormat

RETURN_TYPES: tuple[str, ...] = ("unknown", "strongest", "last", "both")
"""Names of the values of ``fields["return_type"]``.

In dual return mode, "both" means that the two returns are equal, since only one was detected. The
"strongest" of a VLP-16 or VLP-32C is the second-strongest return if the strongest is the last, too.
"""

DEFAULT_PORT = 2368  # UDP port to which Velodyne's scanners send data by default

_Item = TypeVar("_Item")


@checked
class LidarSource(FrameSource[LidarFrame]):
    """Iterable source of scans; made by `open`.

    After a ``with`` statement, which closes the source, iterating raises `InputError`.

    Attributes
    ----------
    uri : str
        Address of the source.
    counters : dict of str to int
        Numbers of frames, packets and points that were read or refused so far. Each firing of a
        valid block counts once: as ``points``, ``no_return``, ``duplicates`` or ``out_of_range``.
        ``lost_packets`` is the number of a Velodyne's packets that are missing: by the times of the
        others, and in directions that earlier turns measured. It does not count packets in the
        first turn, in gaps of more than a second, and of an HDL-64E, whose rate is not known.
        ``repeated_packets`` is the number of a Velodyne's packets that equal the one before, as in
        captures of two interfaces; they are left out.
    errors : dict of int to str
        Index in `past_errors` of each frame that could not be read, with the reason.
    """

    def __init__(self, uri: str, source: Any, *, live: bool) -> None:
        self.uri = uri
        self.errors: dict[int, str] = {}
        self.is_live = live
        self._source = source
        self._port = int(source.port()) if live else 0
        self._skipped = 0
        self._lock = threading.Lock()

    @property
    def counters(self) -> dict[str, int]:
        """Numbers of frames, packets and points that were read or refused so far."""
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
        return self._port

    def read(self, timeout: float | None = None) -> LidarFrame | None:
        """Read the next frame.

        Parameters
        ----------
        timeout : float, optional, seconds
            Longest time to wait for a frame of a live source; default: no limit.

        Returns
        -------
        LidarFrame or None
            None if the recording has ended, the source was stopped, or no frame came in time.
        """
        return self._wait(timeout)

    def _to_frame(self, fields: Mapping[str, Any]) -> LidarFrame:
        return _to_frame(dict(fields), self.uri)

    def read_latest(self, timeout: float | None = None) -> LidarFrame | None:
        """Read the newest frame of a live source, and skip older ones that are waiting.

        This is meant for displays. All packets are decoded; ``counters["skipped"]`` is the number
        of skipped frames.

        Parameters
        ----------
        timeout : float, optional
            See `read`.

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

    def past_errors(self) -> Iterator[LidarFrame | None]:
        """Read to the end without stopping at unreadable frames; `errors` is cleared first.

        Bags and drives continue after a frame that cannot be read. Other recordings, and a bag that
        is damaged between its messages, end with it.

        Yields
        ------
        LidarFrame or None
            None if the frame cannot be read; `errors` states the reason.

        Raises
        ------
        FormatError, InputError, OSError
            No frame can be read; this is the first error. InputError also if a ``with`` statement
            has closed the source.
        """
        self._check_open()
        self.errors.clear()
        has_read = False
        for frame in past_errors(_Frames(self), self.errors, (Error, OSError)):
            if frame is None and not has_read:
                continue  # it is yielded only if another frame can be read
            if not has_read:
                yield from itertools.repeat(None, len(self.errors))
            has_read = True
            yield frame

    @property
    def goes_on(self) -> bool:
        """Whether frames may follow after one that cannot be read.

        It is True for drives, and for bags until their end, and False for other sources.
        """
        return getattr(self._source, "goes_on", False)

    def stop(self) -> None:
        """End a live source's thread; frames that it has collected can still be read.

        A recording yields no further frames.
        """
        self._is_stopped = True
        if self.is_live:
            self._source.stop()

    def _release(self) -> None:
        self._source = ClosedSource(self._source)


class _Frames(Iterator[LidarFrame]):
    """Iterator of the frames that goes on after an error if the source does."""

    def __init__(self, source: LidarSource) -> None:
        self._source = source
        self._has_ended = False

    def __next__(self) -> LidarFrame:
        if self._has_ended:
            raise StopIteration
        try:
            frame = self._source.read()
        except Exception:
            self._has_ended = not self._source.goes_on
            raise
        if frame is None:
            raise StopIteration
        return frame


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

    The VLP-16 Hi-Res (Puck Hi-Res) is read, too; the VLS-128 (Alpha Prime) is refused.

    Parameters
    ----------
    uri : str
        One of these addresses:

        - ``pcap:FILE[#SENSOR]``: packets of a Velodyne (pcap or pcapng, also ``.gz`` and
          ``.xz``). SENSOR is needed if several sensors sent data: their number in order of
          appearance, from 0, or their ``ADDRESS`` or ``ADDRESS:PORT``, where PORT is the one to
          which they send. Without it, an `InputError` lists them.
        - ``velodyne:[ADDRESS:]PORT``: listens on an address of this machine. Default: 127.0.0.1
          and port 2368. Use 0.0.0.0 for a sensor on the network, and port 0 for any free port. If
          several sensors send and none is chosen by ``sender``, the first one is read; data packets
          of the others are counted as ``udp_other_sender``.
        - ``ouster:PATH[#N]``: packets of an Ouster in a pcap or a ROS bag (a file, or the folder of
          a ROS 2 bag), or an ``.osf`` file, through ouster-sdk. N is the number of the sensor, from
          0, and is needed if there are several. The only option is ``metadata``.
        - ``kitti:FOLDER``: a drive, see `manip3d.datasets.open_kitti`. It takes no options.
        - ``bag:PATH[#TOPIC]``: PointCloud2 or Livox CustomMsg messages of a ROS bag (a ``.mcap``
          or ``.db3`` file, a ROS 2 bag's folder, a ROS 1 ``.bag``) through rosbags. The topic may
          be left out if the bag has a single topic of clouds. The only option is ``max_bytes``.
    model : str, optional
        ``hdl64e``, ``hdl32e``, ``vlp16``, ``vlp16-hires`` or ``vlp32c``; default: as the first
        packet with a valid block states.
    calibration : VelodyneCalibration or path, optional
        Calibration, which an HDL-64E needs (see `read_velodyne_calibration`); default: the nominal
        table of the model.
    cut_azimuth : float, degrees
        Azimuth in [0, 360) at which one frame ends and the next begins, clockwise seen from above;
        0 is straight ahead.
    interpolate_azimuth : bool
        Interpolate the azimuth of each firing within a block by its time.
    min_range, max_range : float, metres
        Returns outside these limits are left out, and counted.
    port : int, optional
        Read only packets sent to this UDP port, to select one of several sensors in a recording.
    sender : str, optional
        Read only packets from this address (live sources only).
    ring_packets : int
        Capacity of the packet buffer; further packets are dropped and counted (live sources only).
    metadata : path, optional
        The Ouster's JSON file; default: the one beside the pcap (see `scan_address`).
    max_bytes : int, optional
        Largest number of uncompressed bytes to read from a recording.

    Returns
    -------
    LidarSource
        The frames have x forward, y left, z up, in metres. ``intensity`` is 0 to 255, as sent by
        the sensor; ``ring`` 0 is the highest laser. ``fields`` are ``laser`` (number in the
        packet), ``azimuth`` (degrees), ``range`` (metres, before the calibration), ``time``
        (seconds after ``time_ns``) and ``return_type`` (see `RETURN_TYPES`). ``time_ns`` is the
        time at which the frame's first packet was received; None if the recording states no times
        (Simple Packet Blocks of pcapng). ``format`` holds the model, the sensor's own time, and
        whether the turn is complete: it begins and ends at ``cut_azimuth``, or at the gap around
        it that a limited field of view leaves, and has no gaps that are as large as the rest. A
        pause of more than a second, or a step of the sensor's clock, ends a frame, too.

        For an Ouster, ``fields`` are ``column``, ``range``, ``time``, ``return`` (1 or 2) and the
        sensor's own fields (``near_ir``). For a bag, ``fields`` are those of its messages, and
        ``time_ns`` is the message's stamp, or the time of recording if it has none. ``origin`` is
        None if the name of the coordinate frame (``base_link``, ``map``, ``odom``) shows that its
        origin is not the scanner. 64-bit coordinates far from 0, as in maps, are shifted near 0,
        all frames by the same amount; ``format.to_file`` and ``exact`` hold those of the bag.

    Raises
    ------
    InputError
        The scheme is unknown; an option is out of range, or not one of this scheme. Raised by
        `LidarSource.read`: an HDL-64E has no calibration; a recording of packets has several
        sensors and none is chosen, or not the chosen one.
    FormatError
        The recording is damaged (raised by `LidarSource.read` after the frames before the damage,
        of which the last may be incomplete; a bag goes on with its next message), or it is a
        VLS-128's.
    DeviceError
        Another program uses the port, or the address is not one of this machine.
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
        place, chosen = place_and_topic(uri)
        recording = _core.VelodynePcapSource(
            os.fsencode(place), options, wanted, limit, os.fsencode(chosen)
        )
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
        return LidarSource(uri, _Drive(path_of(rest, "uri"), labels=True), live=False)
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
        "uri: expected pcap:FILE[#SENSOR], ouster:FILE[#N], kitti:FOLDER, bag:PATH[#TOPIC] or "
        f"velodyne:[ADDRESS:]PORT, got {uri!r}"
    )


def open_unlabelled(
    uri: str, *, calibration: VelodyneCalibration | str | os.PathLike[str] | None = None
) -> LidarSource:
    """Open a recording as `open_lidar` does, without the labels of a drive's points.

    A verdict is based on this. Labels are no evidence, and a scan that lost or gained points, which
    its labels no longer fit, must be judged.
    """
    scheme, colon, rest = uri.partition(":")
    if colon and scheme == "kitti" and calibration is None:
        return LidarSource(uri, _Drive(path_of(rest, "uri"), labels=False), live=False)
    return open_lidar(uri, calibration=calibration)


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
"""Options of `open_lidar` that each scheme uses."""


_OTHER_SCANNERS = ("bad_length", "unknown_product", "file_fragments")
"""Counters of packets that may be those of a scanner that is not read."""


def _refuse_unused(scheme: str, arguments: Mapping[str, Any]) -> None:
    """Raise `InputError` if an option is given that the scheme would ignore."""
    parameters = inspect.signature(open_lidar).parameters
    for name in sorted(set(parameters) - {"uri"} - _USED.get(scheme, frozenset(parameters))):
        value = arguments[name]
        if value is not parameters[name].default and value != parameters[name].default:
            raise InputError(f"{name}: expected none for {scheme}:, got {value!r}")


def expect_scans(
    items: Iterable[_Item], uri: str, counters: Callable[[], Mapping[str, int]]
) -> Iterator[_Item]:
    """Yield the items, one for each scan of a recording; raise `FormatError` if there are none.

    The error lists the recording's counters, because these show why its packets gave no scan.
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
    file = place_and_topic(uri)[0] if scheme in ("bag", "pcap") else place
    if scheme == "pcap" and any(counted.get(name) for name in _OTHER_SCANNERS):
        reason += (
            "; packets of Velodyne's HDL-64E, HDL-32E, VLP-16, Puck Hi-Res and VLP-32C are read, "
            "and an Ouster's with its JSON file of the same name beside the recording"
        )
    raise FormatError(reason, file=file)


class _Drive:
    """Scans of a drive, with the interface of the sources in ``_core``."""

    def __init__(self, folder: Path, *, labels: bool) -> None:
        from manip3d.datasets import open_kitti

        self._frames = iter(open_kitti(folder))
        self._labels = labels
        self.goes_on = True
        self._counters = {"frames": 0, "points": 0}
        self._lock = threading.RLock()

    def read(self, timeout_ms: int) -> LidarFrame | bool:
        """Return the next scan, or False at the end."""
        with self._lock:
            frame = next(self._frames, None)
            if frame is None:
                return False
            scan = frame.scan(labels=self._labels)
            self._counters["frames"] += 1
            self._counters["points"] += scan.num_points
            return scan

    def counters(self) -> dict[str, int]:
        """Return the numbers of frames and points."""
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
