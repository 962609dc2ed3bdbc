"""Recordings of people as sequences of `manip3d.RgbdFrame`; mirrored images are flipped back.

======================  ===========================================================================
``utd-mhad:a3_s1``      UTD-MHAD: one person by a Kinect V1, background removed, 20 joints
``utd-mhad:PATH``       the same from the user's own files: ``..._depth.mat`` with its joints
``labanotation:NAME``   Labanotation Suite: joints of a Kinect V2 with their states, no images
``people:DATA_SET``     images of people with a mask: `frame_names` of ``person_turning``,
                        ``person_ddrnet``, ``person_ddrnet_arms_up``, ``person_normalgan``,
                        ``person_frontsurfaces``; no joints
======================  ===========================================================================
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, overload

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.indexing import indexed
from manip3d._util.paths import path_of
from manip3d._util.texts import counted
from manip3d._util.times import NOMINAL_PERIOD_NS
from manip3d.camera import CAMERA_PRESETS, Intrinsics
from manip3d.datasets._registry import DataFile, DataSet, get, require
from manip3d.datasets._tables import data_file, table
from manip3d.datasets.rgbd import frame_names, load_frame
from manip3d.errors import FormatError, InputError
from manip3d.io._utd_mhad import read_trial, trial_at
from manip3d.rgbd import NO_BODY, RgbdCalibration, RgbdFrame, Skeleton

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_UTD_MHAD = "people_utd_mhad"
_LABANOTATION = "skeletons_labanotation"
_IMAGES = (
    "person_turning",
    "person_ddrnet",
    "person_ddrnet_arms_up",
    "person_normalgan",
    "person_frontsurfaces",
)
# The writing on this person's shirt is mirrored, as in the unprocessed images of a Kinect.
_MIRRORED_IMAGES = (("person_normalgan", "01"),)

# Index in the data set of each joint in the Kinect V1's order. The data set begins with head,
# shoulder centre, spine and hip centre, the Kinect with the hip centre.
_UTD_JOINTS = (3, 2, 1, 0, *range(4, 20))
_UTD_CAMERA = Intrinsics(320, 240, 285.63, 285.63, 160.0, 120.0)  # nominal Kinect V1, mirrored
_KINECT2_CAMERA = CAMERA_PRESETS["kinect-v2"].cameras[0]  # nominal


def _data_sets() -> tuple[DataSet, ...]:
    rows = [row | {"url": ""} for row in table("rgbd.csv")]

    def files_below(folder: str) -> tuple[DataFile, ...]:
        return tuple(data_file("rgbd", row) for row in rows if row["path"].startswith(folder))

    return (
        DataSet(
            name=_UTD_MHAD,
            title="62 sequences of 8 people in 27 actions, background removed, 20 joints; UTD-MHAD",
            kind="rgbd",
            files=files_below("person_utd_mhad/mat/"),
            licence="free for research with citation; not for redistribution",
            origin="UTD-MHAD, Chen, Jafari & Kehtarnavaz, ICIP 2015, Kinect V1; "
            "woo-chia-wei/kinect-sequence-classification "
            "@65e9b13950d7971c8d1e49e960f6796bd0dc9257 data",
            page="https://personal.utdallas.edu/~kehtar/UTD-MHAD.html",
            facts={"frames": 4127},
        ),
        DataSet(
            name=_LABANOTATION,
            title="Gestures as Kinect V2 skeletons with states; Labanotation Suite",
            kind="rgbd",
            files=files_below("skeleton_kinect2/labanotation/"),
            licence="MIT",
            origin="microsoft/LabanotationSuite @c135c9016783444b112083aad3dd63e851b9f8fe",
            page="https://github.com/microsoft/LabanotationSuite",
        ),
    )


DATA_SETS = _data_sets()


class RgbdSequence(Sequence[RgbdFrame]):
    """Frames of one recording, made on demand; returned by `open_people`.

    Attributes
    ----------
    uri : str
        Address of the recording.
    title : str
        Title of the data set.
    """

    def __init__(self, uri: str, title: str, num_frames: int, load: Callable[[int], RgbdFrame]):
        self.uri = uri
        self.title = title
        self._num_frames = num_frames
        self._load = load

    def __len__(self) -> int:
        return self._num_frames

    @overload
    def __getitem__(self, index: int) -> RgbdFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[RgbdFrame]: ...
    def __getitem__(self, index: int | slice) -> RgbdFrame | list[RgbdFrame]:
        return indexed(index, self._num_frames, self._load, "frame")

    def __iter__(self) -> Iterator[RgbdFrame]:
        return map(self._load, range(self._num_frames))

    def __repr__(self) -> str:
        return f"<manip3d.datasets.RgbdSequence: {self.uri}, {counted(self._num_frames, 'frame')}>"


def unmirrored(camera: Intrinsics) -> Intrinsics:
    """Return the camera of the image with its columns reversed.

    Raises
    ------
    InputError
        The camera has a distortion or a ray table.
    """
    if camera.rays is not None or any(camera.distortion):
        raise InputError("camera: expected a pinhole without distortion or ray table")
    return replace(camera, cx=camera.width - 1 - camera.cx, mirrored=False)


@cache
def people_uris() -> tuple[str, ...]:
    """Return all registered addresses for `open_people`, including those of missing data."""
    return (
        *(f"utd-mhad:{name}" for name in _sequences(_UTD_MHAD, r"(a\d+_s\d)_t1_depth\.mat")),
        *(f"labanotation:{name}" for name in _sequences(_LABANOTATION, r"([^/]+)\.csv")),
        *(f"people:{name}" for name in _IMAGES),
    )


def _sequences(data_set: str, pattern: str) -> list[str]:
    """Return the names of sequences, from the file names of a data set, sorted by number."""
    matches = (re.search(f"/{pattern}$", file.path) for file in get(data_set).files)
    names = [match[1] for match in matches if match]
    return sorted(names, key=lambda name: [int(n) for n in re.findall(r"\d+", name)])


@checked
def open_people(uri: str) -> RgbdSequence:
    """Open a recording of people of a public data set, after verifying its checksum.

    Parameters
    ----------
    uri : str
        One of `people_uris`: ``utd-mhad:a3_s1`` (action 3, subject 1), ``labanotation:NAME`` or
        ``people:DATA_SET``. Also ``utd-mhad:PATH`` of another trial of UTD-MHAD, which is not
        verified: its depth file (``a3_s1_t1_depth.mat``), or a folder that holds one trial. Its
        joints are read from ``a3_s1_t1_skeleton.mat`` in the same folder or in ``../Skeleton``. The
        data set's colour videos (``a3_s1_t1_color.avi``) are not read, because the pose of their
        camera is not known.

    Returns
    -------
    RgbdSequence
        ``body_index`` is 0 at the person's pixels. If a table of joints lacks a joint of a frame,
        that frame has no skeleton. Times are those of the recording (Labanotation) or nominal, 30
        frames per second. UTD-MHAD has no colour and does not state which joints were inferred;
        Labanotation has no images, so that its depth is 0 everywhere.

    Raises
    ------
    InputError
        There is no such recording.
    DataMissingError, ChecksumError
        A file is not on this computer, or has another SHA-256 than the registered one.
    FormatError
        A file is damaged, or the joints of a trial are missing.
    OSError
        A file cannot be read.
    MissingExtraError
        Pillow, which reads the images, is not installed.

    Examples
    --------
    >>> from manip3d import datasets
    >>> recording = datasets.open_people("utd-mhad:a3_s1")  # doctest: +SKIP
    >>> recording[0].skeletons  # doctest: +SKIP
    """
    scheme, _, name = uri.partition(":")
    if uri not in people_uris():
        trial = trial_at(path_of(name, "uri")) if scheme == "utd-mhad" and name else None
        if trial is not None:
            return _utd_mhad(uri, trial)
        import difflib

        similar = difflib.get_close_matches(uri, people_uris(), cutoff=0.4)
        raise InputError(
            f"uri: expected a recording such as {', '.join(similar or people_uris()[:1])}, "
            f"got {uri!r}"
        )
    if scheme == "utd-mhad":
        files = (_file(_UTD_MHAD, f"{name}_t1_{kind}.mat") for kind in ("depth", "skeleton"))
        return _utd_mhad(uri, *files)
    return {"labanotation": _labanotation, "people": _images}[scheme](uri, name)


def _file(data_set: str, ending: str) -> Path:
    found = next(file for file in get(data_set).files if file.path.endswith(f"/{ending}"))
    return require(found, data_set)


def _utd_mhad(uri: str, trial: Path, skeleton: Path | None = None) -> RgbdSequence:
    from manip3d.modify import skeleton_from

    depth, joints = read_trial(trial, skeleton)
    images = np.ascontiguousarray(depth[:, :, ::-1])
    calibration = RgbdCalibration(unmirrored(_UTD_CAMERA))

    def load(number: int) -> RgbdFrame:
        told = joints[number][list(_UTD_JOINTS)]
        is_told = bool(np.isfinite(told).all())
        return RgbdFrame(
            depth=images[number],
            calibration=calibration,
            body_index=_body(images[number] > 0),
            skeletons=(
                (skeleton_from(told, layout="kinect-v1", axes="kinect", body=0),) if is_told else ()
            ),
            time_ns=number * NOMINAL_PERIOD_NS,
            number=number,
        )

    return RgbdSequence(uri, get(_UTD_MHAD).title, len(images), load)


def _body(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.where(mask, 0, NO_BODY).astype(np.uint8)


def _labanotation(uri: str, name: str) -> RgbdSequence:
    from manip3d.modify import skeleton_from

    path = _file(_LABANOTATION, f"{name}.csv")
    try:
        # The columns are given because some lines end in a comma.
        values = np.loadtxt(path, np.float64, delimiter=",", ndmin=2, usecols=range(1 + 25 * 4))
    except ValueError as error:
        raise FormatError(str(error), file=str(path)) from None
    if not np.isfinite(values).all():
        raise FormatError("expected a time and 25 times x, y, z, state per line", file=str(path))
    joints = values[:, 1:].reshape(-1, 25, 4)
    calibration = RgbdCalibration(_KINECT2_CAMERA)
    nothing = np.zeros((_KINECT2_CAMERA.height, _KINECT2_CAMERA.width), np.uint16)

    def load(number: int) -> RgbdFrame:
        positions, states = joints[number, :, :3], joints[number, :, 3]
        skeleton: Skeleton = skeleton_from(positions, states, layout="kinect-v2", axes="kinect")
        return RgbdFrame(
            depth=nothing,
            calibration=calibration,
            skeletons=(skeleton,),
            time_ns=int(values[number, 0]) * 100,  # the file counts units of 100 ns
            number=number,
        )

    return RgbdSequence(uri, get(_LABANOTATION).title, len(values), load)


def _images(uri: str, name: str) -> RgbdSequence:
    frames = frame_names(name)

    def load(number: int) -> RgbdFrame:
        frame = load_frame(name, number)
        mirrored = (name, frames[number]) in _MIRRORED_IMAGES
        columns = slice(None, None, -1 if mirrored else 1)
        depth = np.asarray(frame.depth, np.uint16)  # all data sets in _IMAGES have millimetres
        camera = unmirrored(frame.intrinsics) if mirrored else frame.intrinsics
        body = _body(depth > 0 if frame.mask is None else frame.mask)
        return RgbdFrame(
            depth=np.ascontiguousarray(depth[:, columns]),
            calibration=RgbdCalibration(camera),
            color=None if frame.color is None else np.ascontiguousarray(frame.color[:, columns]),
            body_index=np.ascontiguousarray(body[:, columns]),
            time_ns=number * NOMINAL_PERIOD_NS,
            number=number,
        )

    return RgbdSequence(uri, get(name).title, len(frames), load)
