"""Simulated drives with LiDAR and stereo cameras, as frames or as files in KITTI's raw layout."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.linear import product
from manip3d._util.options import generator_of, reporting
from manip3d._util.paths import path_of
from manip3d._util.texts import counted
from manip3d._util.times import SECOND_NS
from manip3d.authenticate import RIGS_FILE, CameraPair, write_rigs
from manip3d.errors import InputError
from manip3d.io._files import atomic_folder, holds_only
from manip3d.lidar import Box
from manip3d.simulate import cameras
from manip3d.simulate.cameras import StereoPair, stereo_pair
from manip3d.simulate.lidar import TURN_PERIOD, LidarScan, hdl64e
from manip3d.simulate.streets import Street

if TYPE_CHECKING:
    import PIL.Image

    from manip3d._util.options import Progress, Rng

__all__ = ["DriveFrame", "drive", "write_drive"]

DATE = "2000_01_01"
"""Date of simulated drives; no real drive of KITTI has it."""
_START = datetime(2000, 1, 1, 12, 0, 0, tzinfo=UTC)
EPOCH_NS = int(_START.timestamp()) * SECOND_NS
"""Time 0 of a street, nanoseconds since 1970."""
_ORIGIN = (49.0, 8.4)  # latitude and longitude of the street's origin, arbitrary
_EARTH_RADIUS = 6378137.0

_OXTS = """\
lat:   latitude (deg)
lon:   longitude (deg)
alt:   altitude (m)
roll:  roll angle (rad)
pitch: pitch angle (rad)
yaw:   heading (rad), 0 = east, positive = counter clockwise
vn:    velocity towards north (m/s)
ve:    velocity towards east (m/s)
vf:    forward velocity (m/s)
vl:    leftward velocity (m/s)
vu:    upward velocity (m/s)
ax ay az af al au: accelerations (m/s^2), not simulated: 0
wx wy wz wf wl wu: angular rates (rad/s), wz and wu as driven
pos_accuracy vel_accuracy: 0, exact
navstat numsats posmode velmode orimode: 0
"""


@dataclass(frozen=True, eq=False)
class DriveFrame:
    """One moment of a drive.

    Attributes
    ----------
    time_s : float
        Time at which the LiDAR looks ahead and the cameras expose, seconds.
    scan : LidarScan
        The sweep of the LiDAR.
    pictures : StereoPair or None
        Pictures of the pair that looks ahead; None: no cameras.
    boxes : tuple of manip3d.Box
        Boxes of the cars, people and cyclists with points in the scan, in the LiDAR's frame;
        ``track`` is the object's number in scan and pictures.
    velocity : (float, float, float)
        Velocity of the car: m/s ahead, m/s to the left, rad/s counter-clockwise.
    around : mapping of str to StereoPair
        Pictures of all pairs of `cameras.SURROUND`, including ``front``, in a drive with surround
        cameras. Each pair exposes when the LiDAR looks in its direction.
    """

    time_s: float
    scan: LidarScan
    pictures: StereoPair | None
    boxes: tuple[Box, ...]
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    around: Mapping[str, StereoPair] = field(default_factory=dict)

    def __repr__(self) -> str:
        pairs = len(self.around) or int(self.pictures is not None)
        parts = [
            counted(len(self.scan.points), "point"),
            counted(len(self.boxes), "box", "boxes"),
        ]
        if pairs:
            parts.append(counted(pairs, "stereo pair"))
        return f"<manip3d.simulate.DriveFrame: {', '.join(parts)}; t = {self.time_s:.3f} s>"


@checked
def drive(
    street: Street,
    frames: int,
    *,
    start: float = 0.0,
    pictures: bool = True,
    surround: bool = False,
    rng: Rng = 0,
    threads: int = 0,
) -> Iterator[DriveFrame]:
    """Yield the frames of a drive along a street, one per turn of the LiDAR.

    Parameters
    ----------
    street : Street
        Street with traffic.
    frames : int
        Number of frames.
    start : float, seconds
        Time of the first frame.
    pictures : bool
        Whether to render pictures.
    surround : bool
        Whether to render pictures of all pairs of `cameras.SURROUND`; requires ``pictures``.
    rng : int, numpy.random.Generator or None
        Seed or generator of the noise; frame n does not depend on the number of frames.
    threads : int
        0: ``MANIP3D_THREADS``, else all cores.

    Yields
    ------
    DriveFrame

    Raises
    ------
    InputError
        The street ends before the last frame, or ``surround`` is set without ``pictures``.
    MissingExtraError
        Open3D is not installed.
    """
    if frames < 1:
        raise InputError(f"frames: expected at least 1, got {frames}")
    if surround and not pictures:
        raise InputError("surround: requires pictures=True")
    times = start + TURN_PERIOD * np.arange(frames)
    street.pose([times[0] - TURN_PERIOD, times[-1] + TURN_PERIOD])  # raises before the first frame
    seeds = generator_of(rng).spawn(frames)
    for time, random in zip(times.tolist(), seeds, strict=True):
        scan = hdl64e(street, time, rng=random, threads=threads)
        pair = stereo_pair(street, time, rng=random, threads=threads) if pictures else None
        seen = set(np.unique(scan.object).tolist())
        boxes = tuple(box for box in street.boxes(time) if box.track in seen)
        velocity, turn = _motion(street, time)
        speed = float(np.hypot(*velocity[:2]))
        around = {}
        if pair is not None and surround:
            around = {"front": pair} | _around(street, time, random, threads)
        yield DriveFrame(time, scan, pair, boxes, (speed, 0.0, turn), around)


def _around(
    street: Street, time: float, random: np.random.Generator, threads: int
) -> dict[str, StereoPair]:
    """Pictures of the pairs that do not look ahead; the LiDAR turns clockwise past them."""
    return {
        name: stereo_pair(
            street,
            time + _exposure_shift(heading),
            heading=heading,
            rng=random,
            threads=threads,
        )
        for name, heading in cameras.SURROUND.items()
        if heading != 0.0
    }


def _exposure_shift(heading: float) -> float:
    """Seconds from when the LiDAR looks ahead to when it looks in a direction, degrees."""
    return -heading / 360.0 * TURN_PERIOD


@checked
def write_drive(
    street: Street,
    folder: str | os.PathLike[str],
    frames: int,
    *,
    number: int = 0,
    start: float = 0.0,
    pictures: bool = True,
    surround: bool = False,
    rng: Rng = 0,
    threads: int = 0,
    overwrite: bool = False,
    progress: Progress = None,
) -> Path:
    """Write a drive in KITTI's raw layout, which `manip3d.datasets.open_kitti` reads.

    In addition to KITTI's files there are ``velodyne_points/labels`` (per point: the label in the
    lower 16 bits, the object's number plus 1 in the upper 16) and ``label_2`` (boxes). LiDAR,
    ``oxts`` and each camera have ``timestamps.txt``. The folder is written atomically.

    Parameters
    ----------
    street : Street
        Street with traffic.
    folder : path-like
        New folder; the drive is ``2000_01_01/2000_01_01_drive_NNNN_sync`` in it.
    frames : int
        Number of frames.
    number : int
        NNNN in the name of the drive.
    start, pictures, surround, rng, threads
        Same as for `drive`. Surround pairs are ``image_02`` and ``image_03`` (ahead) to
        ``image_10`` and ``image_11``; ``rigs.json`` has their geometry
        (`manip3d.authenticate.read_rigs`).
    overwrite : bool
        Replace ``folder`` if it only holds a simulated drive.
    progress : None, True or callable
        True draws a bar; a callable gets the fraction done and a message.

    Returns
    -------
    Path
        The drive's folder.

    Raises
    ------
    InputError
        ``folder`` exists and must not be replaced, the street is too short, or ``surround`` is set
        without ``pictures``.
    MissingExtraError
        Open3D is not installed, or Pillow is not although ``pictures`` is set.
    OSError
        The folder cannot be written; no files are left behind.
    """
    target = path_of(folder, "folder")
    if target.exists() and not (overwrite and holds_only(target, is_part_of_drives)):
        kind = "a new folder or one of a simulated drive" if overwrite else "a new folder"
        raise InputError(f"{target}: expected {kind}, but this one exists")
    if not 0 <= number <= 9999:
        raise InputError(f"number: expected 0 to 9999, got {number}")
    name = f"{DATE}_drive_{number:04d}_sync"
    with atomic_folder(target) as new:
        day = new / DATE
        _write_calibration(day)
        moments = []
        source = drive(
            street,
            frames,
            start=start,
            pictures=pictures,
            surround=surround,
            rng=rng,
            threads=threads,
        )
        if surround:
            (day / name).mkdir(parents=True)
            write_rigs(surround_pairs(), day / name / RIGS_FILE)
        with reporting(progress, "frames") as report:
            for index, frame in enumerate(source):
                _write_frame(day / name, index, frame, street)
                moments.append(frame.time_s)
                if report is not None:
                    report((index + 1) / frames)
        headings = cameras.SURROUND if surround else {"front": 0.0}
        _write_times(day / name, moments, headings if pictures else {})
    return target / DATE / name


def is_part_of_drives(name: str) -> bool:
    """Return whether `write_drive` makes a subfolder of this name in its folder."""
    return name == DATE


def _write_frame(folder: Path, index: int, frame: DriveFrame, street: Street) -> None:
    """Write scan, labels, boxes, pictures and position of one frame."""
    name = f"{index:010d}"
    scan = frame.scan
    rows = np.column_stack([scan.points, scan.intensity]).astype("<f4")
    _write(folder / "velodyne_points" / "data" / f"{name}.bin", rows.tobytes())
    label = scan.label.astype("<u4") | ((scan.object + 1).astype("<u4") << 16)
    _write(folder / "velodyne_points" / "labels" / f"{name}.label", label.tobytes())
    lines = [_label_line(box) for box in frame.boxes]
    _write(folder / "label_2" / f"{name}.txt", "".join(lines).encode())
    _write(folder / "oxts" / "data" / f"{name}.txt", _oxts_line(street, frame.time_s).encode())
    pairs = [] if frame.pictures is None else [frame.pictures]
    pairs += [pair for place, pair in frame.around.items() if place != "front"]
    pictures = [pixels for pair in pairs for pixels in (pair.left, pair.right)]
    for camera, pixels in enumerate(pictures, start=2):
        path = folder / f"image_{camera:02d}" / "data" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        _image(pixels).save(path, compress_level=1)


def surround_pairs() -> dict[str, CameraPair]:
    """Return the pairs of `cameras.SURROUND` with the numbers of their cameras in a drive."""
    return {
        name: CameraPair(rig, 2 + 2 * number, 3 + 2 * number)
        for number, (name, rig) in enumerate(cameras.surround_rigs().items())
    }


def _image(pixels: NDArray[np.uint8]) -> PIL.Image.Image:
    image: PIL.Image.Image = imported("PIL.Image", "simulate").fromarray(pixels)
    return image


def _write(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def _write_times(folder: Path, moments: list[float], headings: Mapping[str, float]) -> None:
    """Write the timestamps of LiDAR, position and cameras, one line per frame.

    ``headings`` are those of the stereo pairs with pictures.
    """
    half = TURN_PERIOD / 2.0
    files = [(f"{part}/timestamps.txt", 0.0) for part in ("velodyne_points", "oxts")]
    pairs = surround_pairs()
    files += [
        (f"image_{camera:02d}/timestamps.txt", _exposure_shift(heading))
        for name, heading in headings.items()
        for camera in (pairs[name].left, pairs[name].right)
    ]
    files += [
        ("velodyne_points/timestamps_start.txt", -half),
        ("velodyne_points/timestamps_end.txt", half),
    ]
    for file, shift in files:
        lines = [_stamp(time + shift) for time in moments]
        _write(folder / file, "".join(lines).encode())
    _write(folder / "oxts" / "dataformat.txt", _OXTS.encode())


def _stamp(time: float) -> str:
    moment = _START + timedelta(seconds=time)
    return f"{moment:%Y-%m-%d %H:%M:%S.%f}000\n"


def _write_calibration(day: Path) -> None:
    """Write the three calibration files of a day."""
    matrices, rigid = cameras.projections()
    lines = ["calib_time: 01-Jan-2000 12:00:00\n"]
    for camera, matrix in matrices.items():
        size = np.array([cameras.WIDTH, cameras.HEIGHT])
        for key, values in (
            ("S", size),
            ("K", matrix[:, :3]),
            ("D", np.zeros(5)),
            ("R", np.eye(3)),
            ("T", np.linalg.solve(matrix[:, :3], matrix[:, 3])),
            ("S_rect", size),
            ("R_rect", np.eye(3)),
            ("P_rect", matrix),
        ):
            lines.append(f"{key}_{camera:02d}: {_numbers(values)}\n")
    _write(day / "calib_cam_to_cam.txt", "".join(lines).encode())
    for file, rotation, shift in (
        ("calib_velo_to_cam.txt", rigid[:3, :3], rigid[:3, 3]),
        ("calib_imu_to_velo.txt", np.eye(3), np.zeros(3)),
    ):
        text = f"{lines[0]}R: {_numbers(rotation)}\nT: {_numbers(shift)}\n"
        _write(day / file, text.encode())


def _numbers(values: NDArray[Any]) -> str:
    return " ".join(f"{value:.9e}" for value in np.ravel(values).tolist())


def _oxts_line(street: Street, time: float) -> str:
    """Position and motion in one line; KITTI's devkit maps it to metres by Mercator projection."""
    (position,), (yaw,) = street.pose([time])
    velocity, turn = _motion(street, time)
    x, y, z = position.tolist()
    scale = math.cos(math.radians(_ORIGIN[0]))
    longitude = _ORIGIN[1] + math.degrees(x / (scale * _EARTH_RADIUS))
    north = math.log(math.tan(math.radians(90.0 + _ORIGIN[0]) / 2.0))
    north += y / (scale * _EARTH_RADIUS)
    latitude = math.degrees(2.0 * math.atan(math.exp(north))) - 90.0
    ahead = float(np.hypot(*velocity[:2]))
    motion = [velocity[1], velocity[0], ahead, 0.0, velocity[2], *[0.0] * 6]
    turns = [0.0, 0.0, turn, 0.0, 0.0, turn]
    values = [latitude, longitude, z, 0.0, 0.0, yaw, *motion, *turns, 0.0, 0.0]
    return " ".join(f"{value:.13g}" for value in values) + " 0 0 0 0 0\n"


def _motion(street: Street, time: float) -> tuple[NDArray[np.float64], float]:
    """Velocity in the street's frame, m/s, and yaw rate, rad/s."""
    step = 1e-3
    position, yaw = street.pose([time - step, time + step])
    velocity: NDArray[np.float64] = (position[1] - position[0]) / (2.0 * step)
    return velocity, float((yaw[1] - yaw[0]) / (2.0 * step))


def _label_line(box: Box) -> str:
    """One line of ``label_2``; occlusion 3: unknown."""
    matrices, rigid = cameras.projections()
    length, width, height = box.size
    along = np.array([math.cos(box.yaw), math.sin(box.yaw)])
    aside = np.array([-along[1], along[0]])
    corners = np.array(
        [
            [*(np.array(box.center[:2]) + sx * along * length + sy * aside * width), sz]
            for sx in (-0.5, 0.5)
            for sy in (-0.5, 0.5)
            for sz in (box.center[2] - height / 2, box.center[2] + height / 2)
        ]
    )
    image = product(np.column_stack([corners, np.ones(8)]), product(matrices[2], rigid).T)
    frame, truncated = np.zeros(4), 1.0
    if image[:, 2].min() > 0.1:
        pixels = image[:, :2] / image[:, 2:]
        whole = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
        limit = np.array([cameras.WIDTH - 1.0, cameras.HEIGHT - 1.0])
        frame = np.clip(whole, 0.0, np.tile(limit, 2))
        area = np.prod(whole[2:] - whole[:2])
        truncated = float(1.0 - np.prod(frame[2:] - frame[:2]) / area)
    bottom = product(rigid, [*box.center[:2], box.center[2] - height / 2, 1.0])
    heading = product(rigid[:3, :3], [along[0], along[1], 0.0])
    turn = math.atan2(-heading[2], heading[0])
    alpha = math.remainder(turn - math.atan2(bottom[0], bottom[2]), 2.0 * math.pi)
    numbers = [alpha, *frame, height, width, length, *bottom[:3], turn]
    return f"{box.label} {truncated:.2f} 3 " + " ".join(f"{v:.4f}" for v in numbers) + "\n"
