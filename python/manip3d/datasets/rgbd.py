"""RGB-D recordings of people and scenes, whose units and file layouts differ.

``rgbd.csv`` holds paths and checksums. Units are those that each data set states; none is guessed
from the numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from manip3d import Intrinsics
from manip3d._util.checked import checked
from manip3d._util.reprs import short_repr
from manip3d._util.text_files import text_of
from manip3d.datasets._registry import DataSet, get, require
from manip3d.datasets._tables import data_file, table
from manip3d.errors import FormatError, InputError
from manip3d.io import read_depth
from manip3d.io._images import read_color

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_RAW = "https://raw.githubusercontent.com/"
_INTERNAL = "none stated: for tests and measurements only, not to be published"


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """A depth image with its camera, colour image, mask and pose.

    Attributes
    ----------
    name : str
        Names of the data set and of the frame.
    depth : (H, W) uint16 in millimetres, or float32 in metres
        0 = no measurement.
    intrinsics : Intrinsics
        Intrinsics of the depth camera.
    color : (H', W', 3) uint8 or None
        Colour image; None if the recording has none.
    is_registered : bool
        Whether colour pixel (u, v) shows the surface measured by depth pixel (u, v).
    mask : (H, W) bool or None
        Pixels of the person; None if the recording has no mask.
    pose : (4, 4) float64 or None
        Transform from camera to world; None if it is not known.
    """

    name: str
    depth: NDArray[np.uint16] | NDArray[np.float32]
    intrinsics: Intrinsics
    color: NDArray[np.uint8] | None = None
    is_registered: bool = False
    mask: NDArray[np.bool_] | None = None
    pose: NDArray[np.float64] | None = None

    __repr__ = short_repr

    @property
    def person(self) -> NDArray[np.uint16] | NDArray[np.float32]:
        """Depth of the person's pixels, 0 elsewhere; the whole depth image if there is no mask."""
        return self.depth if self.mask is None else np.where(self.mask, self.depth, 0)


_ReadPose = Callable[["Path", str], "NDArray[np.float64]"]


@dataclass(frozen=True)
class _Recording:
    """File layout of a data set: path templates in which ``*`` stands for the frame's name."""

    title: str
    folder: str
    depth: str
    intrinsics: Intrinsics
    licence: str
    origin: str
    page: str
    home: str = ""
    units_per_metre: float = 1000.0
    color: str = ""
    mask: str = ""
    pose: str = ""
    read_pose: _ReadPose | None = None


def _matrix_pose(path: Path, _: str) -> NDArray[np.float64]:
    from manip3d.io._poses import matrix_pose

    return matrix_pose(path)


def _log_pose(path: Path, frame: str) -> NDArray[np.float64]:
    from manip3d.io._poses import poses_of_log

    try:
        return poses_of_log(path)[int(frame)]
    except KeyError:
        raise FormatError(f"expected a pose of frame {frame}", file=str(path)) from None


def _quaternion_pose(path: Path, frame: str) -> NDArray[np.float64]:
    """Read the pose of a frame from a file with a line per frame, beginning with frame 1."""
    from manip3d.io._poses import trajectory

    return trajectory(path)[1][int(frame) - 1]


def _turntable_pose(path: Path, _: str) -> NDArray[np.float64]:
    """Read rotation and translation from an OpenCV XML file."""
    numbers = {
        name: [float(word) for word in data.split()]
        for name, data in re.findall(
            r"<(R|t) type_id.*?<data>(.*?)</data>", text_of(path), re.DOTALL
        )
    }
    if {name: len(values) for name, values in numbers.items()} != {"R": 9, "t": 3}:
        raise FormatError("expected a rotation R and a translation t", file=str(path))
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(numbers["R"], (3, 3))
    pose[:3, 3] = numbers["t"]
    return pose


_KINECT2_BODY = Intrinsics(512, 424, 364.276, 364.276, 256.512, 207.939)

_RECORDINGS: Mapping[str, _Recording] = {
    "person_turning": _Recording(
        title="A man from head to hips who turns once, a glass wall behind him",
        folder="person_turning_uva",
        depth="*_depth.png",
        color="*.jpg",
        mask="*_mask.jpg",
        pose="*_camera.xml",
        read_pose=_turntable_pose,
        intrinsics=Intrinsics(640, 480, 525.0, 525.0, 320.0, 240.0),
        licence=_INTERNAL,
        origin="University of Amsterdam, course Computer Vision 2; Tomaat/CV2 "
        "@f0023d5ad52c784349ae2c9787766be4ce1f5d84 a1/data",
        page="https://github.com/Tomaat/CV2/tree/f0023d5ad52c784349ae2c9787766be4ce1f5d84/a1/data",
    ),
    "person_ddrnet": _Recording(
        title="A person from the hips up, 20 frames; DDRNet, group 1",
        folder="person_ddrnet/group1",
        depth="depth_map/frame_*.png",
        color="color_map/frame_*.png",
        mask="mask/frame_*.png",
        intrinsics=Intrinsics(640, 480, 536.628, 536.606, 310.591, 234.759),
        licence="MIT",
        origin="DDRNet, Yan et al., ECCV 2018; neycyanshi/DDRNet "
        "@28771990f22ad5b5a917f911058e1304b8d2697d dataset/20170907",
        page="https://github.com/neycyanshi/DDRNet",
        home="neycyanshi/DDRNet/28771990f22ad5b5a917f911058e1304b8d2697d/dataset/20170907/group1/",
    ),
    "person_ddrnet_arms_up": _Recording(
        title="A person from the hips up with both arms raised, 2 frames; DDRNet, group 2",
        folder="person_ddrnet/group2",
        depth="depth_map/frame_*.png",
        color="color_map/frame_*.png",
        mask="mask/frame_*.png",
        intrinsics=Intrinsics(640, 480, 536.628, 536.606, 310.591, 234.759),
        licence="MIT",
        origin="DDRNet, Yan et al., ECCV 2018; neycyanshi/DDRNet "
        "@28771990f22ad5b5a917f911058e1304b8d2697d dataset/20170907",
        page="https://github.com/neycyanshi/DDRNet",
        home="neycyanshi/DDRNet/28771990f22ad5b5a917f911058e1304b8d2697d/dataset/20170907/group2/",
    ),
    "person_normalgan": _Recording(
        title="Three whole people in Kinect V2 geometry, background removed; NormalGAN",
        folder="person_v2geometry/normalgan",
        depth="depth/*.png",
        color="color/*.png",
        intrinsics=_KINECT2_BODY,
        licence=_INTERNAL,
        origin="NormalGAN, Wang et al., ECCV 2020; LizhenWangT/NormalGAN "
        "@74cd832ba12bd9f82006da7e00e414e204196479 datasets/testdata",
        page="https://github.com/LizhenWangT/NormalGAN",
    ),
    "person_frontsurfaces": _Recording(
        title="Three whole people with arms and legs in the air, Kinect V2 noise simulated",
        folder="person_v2geometry/frontsurfaces",
        depth="depth/*.png",
        color="color/*.png",
        intrinsics=_KINECT2_BODY,
        licence=_INTERNAL,
        origin="Fang et al., Computer Graphics Forum 2023; AHU-VRV/RGBD_FrontSurfaces "
        "@35d17012dd9a9ddad1763a4bbf331be4ee6e73da data",
        page="https://github.com/AHU-VRV/RGBD_FrontSurfaces",
    ),
    "person_utd_mhad": _Recording(
        title="One whole person each in six actions, background removed; UTD-MHAD",
        folder="person_utd_mhad/png",
        depth="*.png",
        intrinsics=Intrinsics(320, 240, 285.63, 285.63, 160.0, 120.0),
        licence="free for research with citation; not for redistribution",
        origin="UTD-MHAD, Chen, Jafari & Kehtarnavaz, ICIP 2015, Kinect V1; converted from "
        "woo-chia-wei/kinect-sequence-classification @65e9b13950d7971c8d1e49e960f6796bd0dc9257",
        page="https://personal.utdallas.edu/~kehtar/UTD-MHAD.html",
    ),
    "scene_kitchen": _Recording(
        title="A red kitchen, moving Kinect; 7-Scenes",
        folder="scene_7scenes_redkitchen",
        depth="*.depth.png",
        color="*.color.jpg",
        pose="*.pose.txt",
        read_pose=_matrix_pose,
        intrinsics=Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0),
        licence="non-commercial research use (7-Scenes)",
        origin="7-Scenes, Shotton et al., CVPR 2013; andyzeng/tsdf-fusion-python "
        "@3f22a940d90f684145b1f29b1feaa92e09eb1db6 data",
        page="https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/",
        home="andyzeng/tsdf-fusion-python/3f22a940d90f684145b1f29b1feaa92e09eb1db6/data/",
    ),
    "scene_redwood": _Recording(
        title="A rendered living room with a chair; Redwood",
        folder="scene_redwood_synthetic",
        depth="depth/*.png",
        color="color/*.jpg",
        pose="trajectory.log",
        read_pose=_log_pose,
        intrinsics=Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5),
        licence="MIT",
        origin="Choi et al., CVPR 2015; IntelVCL/Open3D "
        "@6c4080d2aec2c0df95e2e37ed75fc0911f14dbe9 examples/test_data/RGBD",
        page="https://github.com/isl-org/Open3D",
        home="IntelVCL/Open3D/6c4080d2aec2c0df95e2e37ed75fc0911f14dbe9/examples/test_data/RGBD/",
    ),
    "scene_livingroom": _Recording(
        title="A rendered living room without noise; ICL-NUIM",
        folder="scene_icl_nuim_livingroom",
        depth="depth/*.png",
        color="color/*.png",
        pose="pose.txt",
        read_pose=_quaternion_pose,
        units_per_metre=5000.0,
        intrinsics=Intrinsics(640, 480, 481.2, -480.0, 319.5, 239.5),
        licence="CC BY 3.0",
        origin="ICL-NUIM, Handa et al., ICRA 2014; gaoxiang12/slambook2 "
        "@e62d9cd1f95bab337fb4251608543b71d004c420 ch12/dense_RGBD/data",
        page="https://www.doc.ic.ac.uk/~ahanda/VaFRIC/iclnuim.html",
        home="gaoxiang12/slambook2/e62d9cd1f95bab337fb4251608543b71d004c420/ch12/dense_RGBD/data/",
    ),
    "scene_tum_desk": _Recording(
        title="Two views of a desk; TUM RGB-D, freiburg2",
        folder="scene_tum_fr2_desk",
        depth="*_depth.png",
        color="*_color.png",
        units_per_metre=5000.0,
        intrinsics=Intrinsics(640, 480, 520.9, 521.0, 325.1, 249.7),
        licence="CC BY 4.0",
        origin="TUM RGB-D, Sturm et al., IROS 2012, Kinect V1; gaoxiang12/slambook2 "
        "@e62d9cd1f95bab337fb4251608543b71d004c420 ch7",
        page="https://cvg.cit.tum.de/data/datasets/rgbd-dataset",
    ),
    "scene_kinect2_desk": _Recording(
        title="One raw Kinect V2 frame of a desk, with flying pixels",
        folder="scene_kinect2_desk",
        depth="left-Depth-*.png",
        intrinsics=Intrinsics(512, 424, 365.0, 365.0, 254.0, 206.0),
        licence=_INTERNAL,
        origin="ZengChen94/3D-Reconstruction-KinectV2 "
        "@94c93018bb5d5d8a9a9152388cb5f43b696015e5 src/MCI_Cancellation",
        page="https://github.com/ZengChen94/3D-Reconstruction-KinectV2",
    ),
    "wall_realsense": _Recording(
        title="Two RealSense D435 frames of a wall with a bag and a board",
        folder="recording_realsense_d435",
        depth="extracted_depth_*.png",
        intrinsics=Intrinsics(640, 480, 390.431, 390.431, 331.388, 242.187),
        licence="Apache-2.0",
        origin="librealsense, unit-test recording; IntelRealSense/librealsense "
        "@cacc8e701a963a44b49fe51911443797e8b3a517 unit-tests/resources",
        page="https://github.com/IntelRealSense/librealsense",
    ),
}
_NOT_REGISTERED = ("scene_kitchen",)  # colour and depth are aligned only roughly
_MASK_THRESHOLD = 127  # half of 255, since masks stored as JPEG have intermediate values
_RAY_TABLE = "kinect2_rays"


def _data_sets() -> tuple[DataSet, ...]:
    """Return the data sets of all recordings and of the Kinect's ray table."""
    rows = list(table("rgbd.csv"))
    sets = []
    for name, recording in _RECORDINGS.items():
        inside = f"{recording.folder}/"
        mine = [row for row in rows if row["path"].startswith(inside)]
        for row in mine:
            beyond = row["path"].removeprefix(inside)
            row["url"] = f"{_RAW}{recording.home}{beyond}" if recording.home else ""
        sets.append(
            DataSet(
                name=name,
                title=recording.title,
                kind="rgbd",
                files=tuple(data_file("rgbd", row) for row in mine),
                licence=recording.licence,
                origin=recording.origin,
                page=recording.page,
                facts={"frames": len(_frames_of(recording, [row["path"] for row in mine]))},
            )
        )
    rays = next(row for row in rows if row["path"].startswith("calib_kinect2/"))
    source = "Vaufreyd/RGBDSyncSDK @29e6f93c1a976cd409112c750fc6f3dd9421b881 mobile_rgbd_reader"
    sets.append(
        DataSet(
            name=_RAY_TABLE,
            title="Lines of sight of one real Kinect V2's depth pixels, lens distortion included",
            kind="rgbd",
            files=(data_file("rgbd", rays | {"url": ""}),),
            licence="LGPL-3.0 (repository)",
            origin=f"MobileRGBD; {source}",
            page="https://github.com/Vaufreyd/RGBDSyncSDK",
        )
    )
    return tuple(sets)


def _frames_of(recording: _Recording, paths: list[str]) -> tuple[str, ...]:
    before, after = f"{recording.folder}/{recording.depth}".split("*")
    return tuple(
        path[len(before) : len(path) - len(after)]
        for path in paths
        if path.startswith(before) and path.endswith(after)
    )


DATA_SETS = _data_sets()


def _recording(name: str) -> tuple[DataSet, _Recording]:
    data_set = get(name)
    if data_set.name not in _RECORDINGS:
        known = ", ".join(_RECORDINGS)
        raise InputError(f"data set: expected one of {known}, got {data_set.name!r}")
    return data_set, _RECORDINGS[data_set.name]


@checked
@cache
def frame_names(name: str) -> tuple[str, ...]:
    """Return the names of the frames of an RGB-D recording, in order.

    Parameters
    ----------
    name : str
        A data set of kind ``rgbd``.

    Returns
    -------
    tuple of str
        Names for `load_frame`.

    Raises
    ------
    InputError
        There is no such data set, or it is no recording of images.

    Examples
    --------
    >>> from manip3d import datasets
    >>> recordings = [each.name for each in datasets.registry().values() if each.kind == "rgbd"]
    >>> recordings[0], datasets.frame_names(recordings[0])[:2]
    ('person_turning', ('0000000000', '0000000001'))
    """
    data_set, recording = _recording(name)
    return _frames_of(recording, [file.path.removeprefix("rgbd/") for file in data_set.files])


@checked
def load_frame(name: str, frame: str | int = 0) -> DepthFrame:
    """Open one frame of an RGB-D recording after verifying its checksums.

    Parameters
    ----------
    name : str
        A data set of kind ``rgbd``.
    frame : str or int
        One of `frame_names`, or its index.

    Returns
    -------
    DepthFrame
        Depth in millimetres, or in metres if the data set has another unit.

    Raises
    ------
    InputError
        There is no such data set or frame.
    DataMissingError, ChecksumError
        A file is not on this computer, or has another SHA-256 than the registered one.
    FormatError
        A file cannot be read.
    MissingExtraError
        Pillow is not installed.

    Examples
    --------
    >>> from manip3d import datasets
    >>> datasets.load_frame("person_turning", 0).depth.shape  # doctest: +SKIP
    """
    data_set, recording = _recording(name)
    names = frame_names(data_set.name)
    if isinstance(frame, int):
        if not -len(names) <= frame < len(names):
            raise InputError(f"frame: expected an index below {len(names)}, got {frame}")
        frame = names[frame]
    if frame not in names:
        raise InputError(f"frame: expected one of {names[0]} to {names[-1]}, got {frame!r}")
    files = {file.path: file for file in data_set.files}

    def find(template: str) -> Path | None:
        path = f"rgbd/{recording.folder}/{template.replace('*', frame)}"
        return require(files[path], data_set.name) if template and path in files else None

    depth_path = find(recording.depth)
    assert depth_path is not None  # frame names come from the depth files
    depth = read_depth(depth_path, units_per_metre=recording.units_per_metre)
    color_path, mask_path, pose_path = map(find, (recording.color, recording.mask, recording.pose))
    read_pose = recording.read_pose
    return DepthFrame(
        name=f"{data_set.name} {frame}",
        depth=depth,
        intrinsics=recording.intrinsics,
        color=None if color_path is None else read_color(color_path),
        is_registered=color_path is not None and data_set.name not in _NOT_REGISTERED,
        mask=None if mask_path is None else _read_mask(mask_path),
        pose=None if pose_path is None or read_pose is None else read_pose(pose_path, frame),
    )


def _read_mask(path: Path) -> NDArray[np.bool_]:
    mask: NDArray[np.bool_] = read_color(path)[..., 0] > _MASK_THRESHOLD
    return mask


def load_kinect2_intrinsics() -> Intrinsics:
    """Return the depth camera of a real Kinect V2, with a line of sight for each pixel.

    Its y axis points up, as in the table from which it is read.

    Returns
    -------
    Intrinsics
        512 x 424 pixels with ``rays``.

    Raises
    ------
    DataMissingError, ChecksumError
        The table is not on this computer, or has another SHA-256 than the registered one.

    Examples
    --------
    >>> from manip3d import datasets
    >>> datasets.load_kinect2_intrinsics().rays.shape  # doctest: +SKIP
    (424, 512, 2)
    """
    path = require(get(_RAY_TABLE).files[0], _RAY_TABLE)
    rays = np.fromfile(path, "<f4").astype(np.float32).reshape(424, 512, 2)
    return Intrinsics(512, 424, 364.78, -364.78, 252.95, 205.88, rays=rays)
