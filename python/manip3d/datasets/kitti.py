"""Reader of KITTI's layouts: raw drives, and the object, odometry and stereo-2015 benchmarks.

Geiger, Lenz, Stiller, Urtasun, "Vision meets Robotics: The KITTI Dataset", IJRR 2013. Simulators
may write the same layouts. Scans may be compressed (``.bin.xz``). Files are read on demand.
"""

from __future__ import annotations

import copy
import functools
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np

from manip3d._util.arrays import rows
from manip3d._util.checked import checked
from manip3d._util.linear import inverse, product
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d._util.text_files import parse_xml, text_of
from manip3d._util.texts import counted
from manip3d.errors import FormatError, InputError
from manip3d.io._files import regular_bytes
from manip3d.io._frame_times import drive_times
from manip3d.io._images import decoded_picture
from manip3d.io._scan_files import read_scan, readable_scans
from manip3d.io._scan_tables import scan_stem
from manip3d.lidar import Box, LidarFrame

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    from numpy.typing import ArrayLike, NDArray

__all__ = ["KittiCalibration", "KittiDrive", "KittiFrame", "open_kitti"]

_IMAGE_SUFFIXES = (".png", ".jpg")
_DAY_FILES = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt")
"""Files with the calibration of a day, of its cameras and of the LiDAR."""
_SINGLE_FILE = (("R0_rect", "Tr_velo_to_cam"), ("R_rect", "Tr_velo_cam"), ("", "Tr"))
"""Names of the rectification and of the transform from the LiDAR in a calibration of one file: of
the object, the tracking and the odometry benchmark, whose transform includes the rectification."""
_OXTS_COLUMNS = (8, 9, 22)  # vf, vl and wu in KITTI's dataformat.txt


@dataclass(frozen=True, eq=False)
class KittiCalibration:
    """Calibration of the cameras and the LiDAR of one drive.

    Attributes
    ----------
    projections : mapping of int to (3, 4) float64
        Projection from the frame of the rectified camera 0 to the pixels of each camera: 0 and 1
        are grey, 2 and 3 colour.
    T_rect_velo : (4, 4) float64
        Transform from the LiDAR frame to the frame of the rectified camera 0 (x right, y down,
        z forward), metres.
    sizes : mapping of int to (int, int)
        Width and height of each camera's rectified pictures; only raw drives state them.
    """

    projections: Mapping[int, NDArray[np.float64]]
    T_rect_velo: NDArray[np.float64]
    sizes: Mapping[int, tuple[int, int]] = field(default_factory=dict)

    __repr__ = short_repr

    def project(
        self, points: ArrayLike, camera: int = 2
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project LiDAR points to the pixels of a camera.

        Parameters
        ----------
        points : (N, 3), metres
            Points in the LiDAR frame.
        camera : int
            Number of the camera, 0 to 3.

        Returns
        -------
        pixels : (N, 2) float64
            Column and row; meaningless if the depth is not positive.
        depth : (N,) float64
            Depth along the camera's optical axis, metres.

        Raises
        ------
        InputError
            There is no such camera, or ``points`` has another shape.
        """
        projection = self._projection(camera, "camera")
        xyz = rows(points, 3, np.float64, "points")
        matrix = product(projection, self.T_rect_velo)
        image = product(xyz, matrix[:, :3].T) + matrix[:, 3]
        depth = image[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = image[:, :2] / depth[:, None]
        return pixels, depth

    def baseline(self, left: int = 2, right: int = 3) -> float:
        """Return the baseline of two cameras.

        Parameters
        ----------
        left, right : int
            Numbers of the two cameras.

        Returns
        -------
        float
            Distance in metres; positive if ``right`` is to the right of ``left``.

        Raises
        ------
        InputError
            There is no such camera.
        """
        pair = self._projection(left, "left"), self._projection(right, "right")
        shift = [projection[0, 3] / projection[0, 0] for projection in pair]
        return float(shift[0] - shift[1])

    def _projection(self, camera: int, argument: str) -> NDArray[np.float64]:
        if camera not in self.projections:
            known = sorted(self.projections)
            raise InputError(f"{argument}: expected one of {known}, got {camera}")
        return self.projections[camera]


@dataclass(frozen=True)
class KittiFrame:
    """The files of one frame of a drive: the scan, and images and labels recorded with it.

    Attributes
    ----------
    name : str
        Name of the frame's files without their suffix: ``0000000005``, ``000005``, ...
    scan_path : Path
        File with the LiDAR points.
    images : mapping of int to Path
        Image file of each camera; cameras whose image is missing are left out. KITTI has cameras
        0 to 3; higher numbers are further stereo pairs of simulated cars.
    time_ns : int or None
        Time of the scan in nanoseconds since 1970 (odometry drives: since their first frame).
    label_path : Path or None
        File with labelled objects (``label_2``).
    truth_path : Path or None
        File with labels of points (``labels/NAME.label``, one uint32 per point as in
        SemanticKITTI).
    disparity_path : Path or None
        File with the true disparity (``disp_occ_0``).
    oxts_path : Path or None
        File with position and velocity of the car (``oxts``).
    drive : KittiDrive
        The drive to which the frame belongs.
    """

    name: str
    scan_path: Path
    images: Mapping[int, Path]
    time_ns: int | None
    label_path: Path | None
    truth_path: Path | None
    disparity_path: Path | None
    oxts_path: Path | None
    drive: KittiDrive = field(repr=False)

    def scan(self, *, labels: bool = True) -> LidarFrame:
        """Read the points; labels of points, if there are any, are in ``fields["label"]``.

        Parameters
        ----------
        labels : bool
            Read the labels. Without them, the frame holds only what the scanner measured, and
            labels that do not fit an edited scan cannot prevent that it is read.

        Returns
        -------
        LidarFrame
            The labels are a read-only array of uint32, because they are the bytes of the file.

        Raises
        ------
        FormatError
            The scan is damaged, or the numbers of labels and of points differ.
        """
        frame = read_scan(self.scan_path).replace(time_ns=self.time_ns)
        if self.truth_path is None or not labels:
            return frame
        raw = regular_bytes(self.truth_path)
        if len(raw) != 4 * frame.num_points:
            raise FormatError(
                f"expected {frame.num_points} labels of 4 bytes, got {len(raw)} bytes",
                file=str(self.truth_path),
                byte_offset=len(raw),
            )
        return frame.replace(fields={**frame.fields, "label": np.frombuffer(raw, "<u4")})

    def calibration(self) -> KittiCalibration:
        """Read the calibration of this frame (object benchmark) or of its drive.

        Raises
        ------
        InputError
            There is no calibration, or none of this frame in a folder with a file for each frame.
        FormatError
            The calibration is damaged.
        OSError
            The calibration cannot be read, such as a file named to `open_kitti` that is missing.
        """
        place = self._calibration_path
        if place is None:
            missing = f"frame {self.name}" if self.drive.per_frame else "these scans"
            raise InputError(f"{self.drive.path}: no calibration of {missing}")
        return read_calibration(place)

    @property
    def calibration_files(self) -> tuple[Path, ...]:
        """Files that `calibration` reads; empty if there is no calibration."""
        place = self._calibration_path
        if place is None:
            return ()
        return tuple(place / name for name in _DAY_FILES) if place.is_dir() else (place,)

    @property
    def _calibration_path(self) -> Path | None:
        """The day's folder or the file with the calibration; None if there is none."""
        folder = self.drive.calibration_path
        if folder is None or not self.drive.per_frame:
            return folder
        return _first([folder / f"{self.name}.txt"])

    def velocity(self) -> tuple[float, float, float] | None:
        """Read the car's velocity: m/s forward, m/s left, rad/s counter-clockwise; None: unknown.

        Raises
        ------
        FormatError
            The file of ``oxts`` is damaged.
        """
        if self.oxts_path is None:
            return None
        words = text_of(self.oxts_path).split()
        try:
            ahead, left, turn = (_finite(words[column]) for column in _OXTS_COLUMNS)
        except (IndexError, ValueError):
            raise FormatError(
                f"expected at least {max(_OXTS_COLUMNS) + 1} numbers of an inertial unit, got "
                f"{len(words)} words",
                file=str(self.oxts_path),
                line=1,
            ) from None
        return ahead, left, turn

    def pictures(
        self, left: int = 2, right: int = 3
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]] | None:
        """Read the two pictures of a stereo pair.

        Parameters
        ----------
        left, right : int
            Numbers of the two cameras; 2 and 3 are KITTI's colour cameras.

        Returns
        -------
        (left, right) or None
            Pictures (H, W), grey, or (H, W, 3), red, green and blue; None if one is missing.

        Raises
        ------
        FormatError
            A picture is damaged, or the two differ in size.
        OSError
            A picture cannot be read.
        MissingExtraError
            Pillow is not installed.
        """
        if left not in self.images or right not in self.images:
            return None
        pair = _picture(self.images[left]), _picture(self.images[right])
        if pair[0].shape != pair[1].shape:
            raise FormatError(
                f"expected {pair[0].shape} as the left picture has, got {pair[1].shape}",
                file=str(self.images[right]),
            )
        return pair

    def boxes(self) -> tuple[Box, ...]:
        """Read the boxes of labelled objects, in the LiDAR frame; empty without labels.

        They are read from ``label_2``, or else from a raw drive's ``tracklet_labels.xml``.

        Raises
        ------
        FormatError
            The labels or the calibration are damaged; the error names the file.
        InputError
            There is a file of ``label_2``, but no calibration of this frame, which its boxes need.
        OSError
            The labels or the calibration cannot be read.
        """
        if self.label_path is None:
            if not self.name.isdecimal():
                return ()  # tracklets belong to numbered frames
            return self.drive.tracklets.get(int(self.name), ())
        return read_labels(self.label_path, self.calibration())


@checked
class KittiDrive:
    """A folder of scans in one of KITTI's layouts, as a sequence of `KittiFrame`; see `open_kitti`.

    ``len(drive)``, ``drive[3]``, ``drive[2:5]`` and loops work as for a tuple. Frames are in the
    order of the numbers in their file names. Their files are read only by the frame's methods.

    Attributes
    ----------
    path : Path
        The folder of the drive.
    layout : str
        ``raw``: a raw drive, with ``velodyne_points/data``. ``flat``: the object, odometry or
        stereo-2015 benchmark, with ``velodyne``.
    scan_folder : Path
        The folder with the scans.
    calibration_path : Path or None
        File or folder with the calibration; None if there is none.
    per_frame : bool
        Whether ``calibration_path`` is a folder with a file for each frame.
    tracklet_path : Path or None
        ``tracklet_labels.xml``, the labelled boxes of a raw drive; None if there is none.
    """

    def __init__(self, path: Path, *, calibration: Path | None = None) -> None:
        self.path = path
        self.layout = "raw" if (path / "velodyne_points" / "data").is_dir() else "flat"
        raw = self.layout == "raw"
        self.scan_folder = path / "velodyne_points" / "data" if raw else path / "velodyne"
        if not self.scan_folder.is_dir():
            raise InputError(
                f"{path}: expected a folder with velodyne_points/data or velodyne, found neither"
            )
        self.calibration_path, self.per_frame = _find_calibration(path, calibration)
        self.tracklet_path = _first([path / "tracklet_labels.xml"])
        self._scans = tuple(readable_scans(self.scan_folder))
        self._times = drive_times(path)

    @functools.cached_property
    def tracklets(self) -> Mapping[int, tuple[Box, ...]]:
        """Boxes of ``tracklet_labels.xml`` by frame number; empty if there is no such file."""
        return {} if self.tracklet_path is None else read_tracklets(self.tracklet_path)

    @functools.cached_property
    def _cameras(self) -> tuple[int, ...]:
        """Numbers of the cameras with a folder of images: 0 to 3 in KITTI, or more."""
        digits = "[0-9][0-9]" if self.layout == "raw" else "[0-9]*"
        names = (folder.name[6:] for folder in self.path.glob(f"image_{digits}"))
        return tuple(sorted({int(name) for name in names if name.isdecimal() and len(name) <= 2}))

    def with_scans(self, scans: Sequence[Path]) -> KittiDrive:
        """Return the drive with other scans, such as its text files.

        Parameters
        ----------
        scans : sequence of Path
            Files in the folder of the scans, in order.

        Returns
        -------
        KittiDrive
        """
        drive = copy.copy(self)
        drive._scans = tuple(scans)
        return drive

    def __len__(self) -> int:
        return len(self._scans)

    @overload
    def __getitem__(self, index: int) -> KittiFrame: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[KittiFrame, ...]: ...
    def __getitem__(self, index: int | slice) -> KittiFrame | tuple[KittiFrame, ...]:
        if isinstance(index, slice):
            return tuple(self._frame(path) for path in self._scans[index])
        return self._frame(self._scans[index])

    def __iter__(self) -> Iterator[KittiFrame]:
        return (self._frame(path) for path in self._scans)

    def _frame(self, scan: Path) -> KittiFrame:
        name = scan_stem(scan)
        raw = self.layout == "raw"
        images = {}
        for camera in self._cameras:
            folder = self.path / (f"image_{camera:02d}/data" if raw else f"image_{camera}")
            found = _first(folder / f"{name}{suffix}" for suffix in _IMAGE_SUFFIXES)
            if found is not None:
                images[camera] = found
        truth = self.path / "velodyne_points" if raw else self.path
        return KittiFrame(
            name=name,
            scan_path=scan,
            images=images,
            time_ns=self._times.get(int(name)) if name.isdecimal() else None,
            label_path=_first([self.path / "label_2" / f"{name}.txt"]),
            truth_path=_first([truth / "labels" / f"{name}.label"]),
            disparity_path=_first([self.path / "disp_occ_0" / f"{name}.png"]),
            oxts_path=_first([self.path / "oxts" / "data" / f"{name}.txt"]),
            drive=self,
        )

    def __repr__(self) -> str:
        return f"<manip3d.datasets.KittiDrive: {self.path}, {counted(len(self), 'frame')}>"


@checked
def open_kitti(
    path: str | os.PathLike[str], *, calibration: str | os.PathLike[str] | None = None
) -> KittiDrive:
    """Open a folder of scans in one of KITTI's layouts.

    Parameters
    ----------
    path : path-like
        A raw drive (``velodyne_points/data``, ``image_0N/data``), or a folder with ``velodyne``
        and ``image_N`` (object, odometry sequence, stereo-2015), which a simulator may have
        written.
    calibration : path-like, optional
        Place of the calibration if it is not where KITTI has it: a day's folder with
        ``calib_cam_to_cam.txt``, a file such as odometry's ``calib.txt`` or one of the tracking
        benchmark, or a folder with a file for each frame. By default it is one of these in
        ``path``, else ``calib_cam_to_cam.txt`` in the folder above.

    Returns
    -------
    KittiDrive
        A sequence of frames, in the order of their file names.

    Raises
    ------
    InputError
        The folder has neither layout.
    OSError
        The folder or the place of the calibration is missing.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from manip3d import LidarFrame, datasets, io
    >>> Path("drive/velodyne").mkdir(parents=True)
    >>> io.write_scan(LidarFrame(np.ones((5, 3), np.float32)), "drive/velodyne/000000.bin")
    >>> drive = datasets.open_kitti("drive")
    >>> len(drive), drive[0].scan().num_points
    (1, 5)
    """
    folder = path_of(path)
    if not folder.is_dir():
        raise FileNotFoundError(2, os.strerror(2), str(path))
    place = None if calibration is None else path_of(calibration, "calibration")
    if place is not None and not place.exists():  # it is not read if the drive has no pictures
        raise FileNotFoundError(2, os.strerror(2), str(place))
    return KittiDrive(folder, calibration=place)


def read_calibration(path: Path) -> KittiCalibration:
    """Read a calibration: a day's folder (raw drives) or a single file (object, odometry)."""
    if path.is_dir():
        file, rigid_file = (path / name for name in _DAY_FILES)
        cameras, rigid = _matrices(file), _matrices(rigid_file)
        projections = {c: f"P_rect_0{c}" for c in range(4)}
        rotation = "R_rect_00"
        velo = np.column_stack(
            [_rotation(rigid, "R", rigid_file), _shaped(rigid, "T", (3,), rigid_file)]
        )
    else:
        cameras, file = _matrices(path), path
        projections = {c: f"P{c}" for c in range(4)}
        rotation, rigid_name = next(
            (names for names in _SINGLE_FILE if names[1] in cameras), _SINGLE_FILE[0]
        )
        velo = _shaped(cameras, rigid_name, (3, 4), path)
        _check_rotation(velo[:, :3], rigid_name, path)
    rectify = np.eye(4)
    if rotation in cameras:
        rectify[:3, :3] = _rotation(cameras, rotation, file)
    rigid_velo = np.vstack([velo, [0.0, 0.0, 0.0, 1.0]])
    return KittiCalibration(
        {
            c: _shaped(cameras, key, (3, 4), file)
            for c, key in projections.items()
            if key in cameras
        },
        product(rectify, rigid_velo),
        {c: _size(cameras, f"S_rect_0{c}", file) for c in range(4) if f"S_rect_0{c}" in cameras},
    )


def _size(matrices: Mapping[str, NDArray[np.float64]], name: str, file: Path) -> tuple[int, int]:
    width, height = _shaped(matrices, name, (2,), file).tolist()
    return round(width), round(height)


def read_labels(path: Path, calibration: KittiCalibration) -> tuple[Box, ...]:
    """Read a file of the object benchmark (``label_2``) as boxes in the LiDAR frame.

    ``DontCare`` regions, which have no box, are left out.

    Parameters
    ----------
    path : Path
        A text file with a line of 15 words for each object, or of 16 with a score.
    calibration : KittiCalibration
        The inverse of its ``T_rect_velo`` transforms boxes from the rectified camera's frame to the
        LiDAR frame.

    Returns
    -------
    tuple of Box
        Boxes in the order of the lines.

    Raises
    ------
    FormatError
        Words 9 to 15 of a line are not seven finite numbers, or a size is negative; the error names
        the line.
    """
    boxes = []
    velo_rect = inverse(calibration.T_rect_velo)
    for number, line in enumerate(text_of(path).splitlines(), 1):
        words = line.split()
        if not words or words[0] == "DontCare":
            continue
        try:
            values = [_finite(word) for word in words[8:15]]
            height, width, length, x, y, z, rotation = values
            if min(height, width, length) < 0:
                raise ValueError
        except ValueError:
            raise FormatError(
                "expected a label of 15 words, the last 7 finite numbers, of which the first 3 are "
                f"sizes >= 0, got {line[:80]!r}",
                file=str(path),
                line=number,
            ) from None
        # The position is the centre of the bottom face; the rotation is about the camera's y axis,
        # which points down. Half the height is added along the LiDAR's z axis, and not along the
        # camera's -y, because a `Box` stands upright in the LiDAR frame; KITTI's cameras lean by
        # about a degree.
        bottom = product(velo_rect, [x, y, z, 1.0])
        heading = product(velo_rect[:3, :3], [np.cos(rotation), 0.0, -np.sin(rotation)])
        boxes.append(
            Box(
                (float(bottom[0]), float(bottom[1]), float(bottom[2]) + height / 2.0),
                (length, width, height),
                float(np.arctan2(heading[1], heading[0])),
                words[0],
            )
        )
    return tuple(boxes)


def read_tracklets(path: Path) -> dict[int, tuple[Box, ...]]:
    """Read ``tracklet_labels.xml`` of a raw drive: boxes in the LiDAR frame, by frame number.

    Raises
    ------
    FormatError
        The file is not KITTI's XML of tracklets, or a number in it cannot be parsed.
    """
    tracklets = parse_xml(path).find("tracklets")
    if tracklets is None:
        raise FormatError("expected an element tracklets, found none", file=str(path))
    found: dict[int, list[Box]] = {}
    for track, item in enumerate(tracklets.findall("item")):
        height, width, length = _numbers(item, ("h", "w", "l"), path)
        if min(height, width, length) < 0:
            raise FormatError(
                f"expected sizes >= 0 of object {track}, got {length} {width} {height}",
                file=str(path),
            )
        (first,) = _numbers(item, ("first_frame",), path)
        label = (item.findtext("objectType") or "").strip()
        for frame, pose in enumerate(item.findall("poses/item"), round(first)):
            # The position is the centre of the bottom face. Annotators rotated boxes about z only.
            x, y, z, yaw = _numbers(pose, ("tx", "ty", "tz", "rz"), path)
            box = Box((x, y, z + height / 2.0), (length, width, height), yaw, label, track)
            found.setdefault(frame, []).append(box)
    return {frame: tuple(boxes) for frame, boxes in found.items()}


def _numbers(element: Element, names: tuple[str, ...], path: Path) -> list[float]:
    texts = [element.findtext(name) for name in names]
    try:
        return [_finite(text or "") for text in texts]
    except ValueError:
        raise FormatError(
            f"{', '.join(names)}: expected finite numbers, got {texts}", file=str(path)
        ) from None


def _finite(text: str) -> float:
    """Parse a finite number; raise ValueError for nan, inf and overflow (1e999)."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _matrices(path: Path) -> dict[str, NDArray[np.float64]]:
    """Return the lines ``name: numbers`` of a calibration file, NaN for a word that is no number.

    The tracking benchmark leaves out the colon of some lines.
    """
    found = {}
    for line in text_of(path).splitlines():
        name, *words = line.replace(":", " ", 1).split() or [""]
        found[name] = np.array([_number(word) for word in words])
    return found


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _shaped(
    matrices: Mapping[str, NDArray[np.float64]], name: str, shape: tuple[int, ...], file: Path
) -> NDArray[np.float64]:
    values = matrices.get(name)
    if values is None or values.size != np.prod(shape) or not np.isfinite(values).all():
        got = (
            "no such line"
            if values is None
            else f"{values.size} numbers"
            if values.size != np.prod(shape)
            else f"{values.tolist()}"
        )
        raise FormatError(
            f"{name}: expected {np.prod(shape)} finite numbers, got {got}", file=str(file)
        )
    return values.reshape(shape)


def _rotation(
    matrices: Mapping[str, NDArray[np.float64]], name: str, file: Path
) -> NDArray[np.float64]:
    matrix = _shaped(matrices, name, (3, 3), file)
    _check_rotation(matrix, name, file)
    return matrix


def _check_rotation(matrix: NDArray[np.float64], name: str, file: Path) -> None:
    """Refuse a matrix for which R R^T differs from the identity by 1e-3 or more.

    KITTI's files have seven digits, so that their rotations pass.
    """
    worst = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if not worst < 1e-3:
        raise FormatError(
            f"{name}: expected a rotation, got a matrix {worst:.3g} off an orthogonal one",
            file=str(file),
        )


def _find_calibration(path: Path, given: Path | None) -> tuple[Path | None, bool]:
    if given is not None:
        return given, given.is_dir() and not (given / _DAY_FILES[0]).is_file()
    # Files in the folder of the scans are theirs; the parent may be the day of other drives.
    if (path / "calib_cam_to_cam.txt").is_file():
        return path, False
    if (path / "calib.txt").is_file():
        return path / "calib.txt", False
    if (path / "calib").is_dir():
        return _find_calibration(path, path / "calib")
    if (path.resolve().parent / "calib_cam_to_cam.txt").is_file():
        return path.resolve().parent, False
    return None, False


def _picture(path: Path) -> NDArray[np.uint8]:
    try:
        return decoded_picture(regular_bytes(path))
    except FormatError as error:
        raise FormatError(error.reason, file=str(path)) from error


def _first(candidates: Iterator[Path] | list[Path]) -> Path | None:
    return next((path for path in candidates if path.is_file()), None)
