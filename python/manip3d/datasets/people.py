"""Recordings of people as sequences of `manip3d.RgbdFrame`, turned into cameras that do not mirror.

======================  ===========================================================================
``utd-mhad:a3_s1``      UTD-MHAD: one person by a Kinect V1, background removed, 20 joints
``utd-mhad:PATH``       the same of files of one's own: ``..._depth.mat`` with its joints
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
from manip3d._util.paths import path_of
from manip3d.camera import Intrinsics
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
# The writing on this one's shirt reads backwards: a Kinect's own picture.
_MIRRORED_IMAGES = (("person_normalgan", "01"),)
_NOMINAL_PERIOD_NS = 33_333_333  # of recordings that keep no times

# The data set's order of joints -> Kinect V1's: head, shoulder centre, spine, hip centre come
# first, from the top down.
_UTD_JOINTS = (3, 2, 1, 0, *range(4, 20))
_UTD_CAMERA = Intrinsics(320, 240, 285.63, 285.63, 160.0, 120.0)  # nominal Kinect V1, mirrored
_KINECT2_CAMERA = Intrinsics(512, 424, 365.0, 365.0, 255.5, 211.5)  # nominal


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
    """Frames of one recording, each made when it is asked for; from `open_people`.

    Attributes
    ----------
    uri : str
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
        if isinstance(index, slice):
            return [self._load(i) for i in range(*index.indices(self._num_frames))]
        if not -self._num_frames <= index < self._num_frames:
            raise IndexError(f"frame {index} of {self._num_frames}")
        return self._load(index % self._num_frames)

    def __iter__(self) -> Iterator[RgbdFrame]:
        return map(self._load, range(self._num_frames))

    def __repr__(self) -> str:
        return f"<manip3d.datasets.RgbdSequence: {self.uri}, {self._num_frames} frames>"


def unmirrored(camera: Intrinsics) -> Intrinsics:
    """The camera of the image whose columns are reversed.

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
    """Return all addresses that `open_people` takes, also of data that are not here."""
    return (
        *(f"utd-mhad:{name}" for name in _sequences(_UTD_MHAD, r"(a\d+_s\d)_t1_depth\.mat")),
        *(f"labanotation:{name}" for name in _sequences(_LABANOTATION, r"([^/]+)\.csv")),
        *(f"people:{name}" for name in _IMAGES),
    )


def _sequences(data_set: str, pattern: str) -> list[str]:
    """The sequences that the names of a data set's files tell, by number."""
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
        ``people:DATA_SET``; or a trial of UTD-MHAD that is not verified: ``utd-mhad:PATH`` of its
        depth file (``a3_s1_t1_depth.mat``), or of a folder that holds one trial. The joints are
        beside it, in ``a3_s1_t1_skeleton.mat``, or in ``../Skeleton``. The data set's films of
        another camera (``a3_s1_t1_color.avi``) are not read, as nobody knows where that was.

    Returns
    -------
    RgbdSequence
        Its frames have ``body_index`` 0 where the person is. A frame of which a table of joints
        lacks a row has no skeleton. Times are the recording's own
        (Labanotation) or nominal, 30 frames a second. UTD-MHAD has no colour and says of no joint
        whether it was inferred; Labanotation has no images: their depth is 0 everywhere.

    Raises
    ------
    InputError
        No such recording.
    DataMissingError, ChecksumError
        A file is not on this machine, or not the registered one.
    FormatError
        A file is damaged, or the joints of a trial are not there.
    OSError
        `FileNotFoundError` and the like.
    MissingExtraError
        Pillow (images) is not installed.

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
            time_ns=number * _NOMINAL_PERIOD_NS,
            number=number,
        )

    return RgbdSequence(uri, get(_UTD_MHAD).title, len(images), load)


def _body(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return np.where(mask, 0, NO_BODY).astype(np.uint8)


def _labanotation(uri: str, name: str) -> RgbdSequence:
    from manip3d.modify import skeleton_from

    path = _file(_LABANOTATION, f"{name}.csv")
    try:
        # Some lines end in a comma, hence the columns.
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
            time_ns=int(values[number, 0]) * 100,  # counted in 100 ns
            number=number,
        )

    return RgbdSequence(uri, get(_LABANOTATION).title, len(values), load)


def _images(uri: str, name: str) -> RgbdSequence:
    frames = frame_names(name)

    def load(number: int) -> RgbdFrame:
        frame = load_frame(name, number)
        mirrored = (name, frames[number]) in _MIRRORED_IMAGES
        columns = slice(None, None, -1 if mirrored else 1)
        depth = np.asarray(frame.depth, np.uint16)  # all of these are stored in millimetres
        camera = unmirrored(frame.intrinsics) if mirrored else frame.intrinsics
        body = _body(depth > 0 if frame.mask is None else frame.mask)
        return RgbdFrame(
            depth=np.ascontiguousarray(depth[:, columns]),
            calibration=RgbdCalibration(camera),
            color=None if frame.color is None else np.ascontiguousarray(frame.color[:, columns]),
            body_index=np.ascontiguousarray(body[:, columns]),
            time_ns=number * _NOMINAL_PERIOD_NS,
            number=number,
        )

    return RgbdSequence(uri, get(name).title, len(frames), load)
