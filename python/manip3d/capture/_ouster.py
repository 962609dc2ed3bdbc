"""Ouster recordings through ouster-sdk."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d._util.extras import imported
from manip3d._util.paths import path_of
from manip3d.capture._addresses import ouster_metadata
from manip3d.errors import FormatError, InputError
from manip3d.io._files import check_regular
from manip3d.io._packet_files import PACKETS
from manip3d.io._scan_tables import scan_suffix
from manip3d.lidar import LidarFrame, ScanFormat

if TYPE_CHECKING:
    from numpy.typing import NDArray

_NOT_COLUMNS = ("FLAGS", "RANGE")


class OusterRecording:
    """Frames of one sensor of a recording, with the interface of the sources in ``_core``."""

    def __init__(self, path: Path, sensor: str, metadata: str | os.PathLike[str] | None) -> None:
        meta = None if metadata is None else path_of(metadata, "metadata")
        if meta is None and scan_suffix(path.name) in PACKETS:
            meta = ouster_metadata(path) or path.with_suffix(".json")
        sdk = imported("ouster.sdk", "ouster")
        core = imported("ouster.sdk.core", "ouster")
        is_folder = (path / "metadata.yaml").is_file()  # of a ROS 2 bag
        if not is_folder:
            check_regular(path)  # raises OSError before the parser runs
        if meta is not None and not meta.is_file():
            raise InputError(f"metadata: expected the sensor's JSON file, {meta} is not there")
        if not is_folder and path.stat().st_size == 0:
            raise FormatError("the file is empty", file=str(path))
        self._path, self._core = path, core
        self._uri = f"ouster:{path}"
        self._counters = {"frames": 0, "points": 0, "no_return": 0}
        self._lock = threading.RLock()
        more = {} if meta is None else {"meta": [str(meta)]}
        self._frames = self._guarded(sdk.open_source, str(path), **more)
        self._sensor = self._number(sensor, len(self._frames.sensor_info))
        self._next = iter(self._frames)

    def read(self, timeout_ms: int) -> LidarFrame | bool:
        """Return the next frame, or False at the end."""
        with self._lock:
            scan = None
            while scan is None:  # a set of simultaneous frames may lack this sensor's
                scans = self._guarded(next, self._next, None)
                if scans is None:
                    return False
                scan = scans[self._sensor] if hasattr(scans, "__getitem__") else scans
            frame: LidarFrame = self._guarded(self._to_frame, scan)
            self._counters["frames"] += 1
            self._counters["points"] += frame.num_points
            return frame

    def counters(self) -> dict[str, int]:
        """Return the numbers of frames, of points, and of firings without a return."""
        return dict(self._counters)

    def _number(self, sensor: str, count: int) -> int:
        """Return the index of the sensor in a recording with ``count`` sensors."""
        if not sensor and count == 1:
            return 0
        if sensor.isascii() and sensor.isdecimal() and int(sensor) < count:
            return int(sensor)
        last = f" to #{count - 1}" if count > 1 else ""
        raise InputError(
            f"uri: expected {self._uri}#0{last}, one of the sensors of the recording; got "
            + (f"#{sensor}" if sensor else "none")
        )

    def _guarded(self, call: Any, *arguments: Any, **options: Any) -> Any:
        try:
            return call(*arguments, **options)
        except (OSError, MemoryError):
            raise
        except Exception as error:  # ouster-sdk raises various types for damaged files
            said = str(error).rpartition("more details: ")[2].strip()
            reason = f"damaged Ouster recording: {said[:200]}"
            raise FormatError(reason, file=str(self._path)) from error

    def _to_frame(self, scan: Any) -> LidarFrame:
        info = scan.sensor_info
        to_xyz = self._core.XYZLut(info, use_extrinsics=False)
        returns = list(self._returns(scan, to_xyz))
        names = [name for name in returns[0] if name not in ("points", "REFLECTIVITY", "row")]
        merged = {key: np.concatenate([part[key] for part in returns]) for key in returns[0]}
        reflectivity = merged.get("REFLECTIVITY")
        received = np.asarray(scan.packet_timestamp)
        received = received[received > 0]
        stamps = np.asarray(scan.timestamp)
        stamps = stamps[stamps > 0]  # missing columns have 0
        header = {
            "model": info.prod_line,
            "sensor_time": float(stamps.min()) * 1e-9 if stamps.size else None,
            "is_complete": bool(scan.complete()),
        }
        return LidarFrame(
            points=merged["points"],
            intensity=None if reflectivity is None else reflectivity.astype(np.float32),
            time_ns=int(received.min()) if received.size else None,
            ring=merged["row"],
            origin=(0.0, 0.0, 0.0),
            source=self._uri,
            fields={name.lower(): merged[name] for name in names},
            format=ScanFormat("ouster", header=header),
        )

    def _returns(self, scan: Any, to_xyz: Any) -> Iterator[dict[str, NDArray[Any]]]:
        """Yield the table columns of each return number, without firings that had no return."""
        stamps = np.asarray(scan.timestamp, np.int64)
        started = stamps[stamps > 0].min(initial=np.iinfo(np.int64).max)
        known = set(scan.fields)
        bases = sorted(name for name in known if not (name[-1] == "2" and name[:-1] in known))
        for number, suffix in enumerate(("", "2"), 1):
            if f"RANGE{suffix}" not in known:
                continue
            reach = scan.field(f"RANGE{suffix}")
            row, column = np.nonzero(reach)
            self._counters["no_return"] += int(reach.size - row.size)
            part = {
                "points": to_xyz(reach)[row, column].astype(np.float32),
                "row": row.astype(np.uint16),
                "column": column.astype(np.uint16),
                "range": (reach[row, column] * 1e-3).astype(np.float32),
                "time": ((stamps[column] - started) * 1e-9).astype(np.float32),
                "return": np.full(row.size, number, np.uint8),
            }
            for base in bases:
                own = f"{base}{suffix}"
                values = scan.field(own if own in known else base)
                if base not in _NOT_COLUMNS and values.shape == reach.shape:
                    part[base] = values[row, column]
            yield part
