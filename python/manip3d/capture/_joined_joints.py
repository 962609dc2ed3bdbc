"""Frames of a recording with the joints that another program wrote to a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import cast

import numpy as np

from manip3d.capture._rgbd_source import RgbdSource
from manip3d.errors import FormatError, InputError
from manip3d.io._joint_files import JointFile, SeenPerson, read_joint_file
from manip3d.modify import skeleton_from
from manip3d.modify._joints import JointLayout
from manip3d.modify._pose import body_under, depth_under_color, lifted_joints
from manip3d.rgbd import RgbdFrame, Skeleton

_LEFT_OUT = ("damaged", "out_of_order")  # counters of frames after which an index is wrong
_NEAR_US = (0, 1, -1)  # microseconds by which times may be rounded


def source_and_file(uri: str) -> tuple[str, str]:
    """Return the source and the file of ``joints:SOURCE#FILE``.

    Raises
    ------
    InputError
        One of the two is missing.
    """
    source, _, file = uri.removeprefix("joints:").rpartition("#")
    if not source or not file:
        raise InputError(f"uri: expected joints:SOURCE#FILE, got {uri!r}")
    return source, file


class JoinedJoints:
    """Iterable of a recording's frames, whose skeletons are those of a file of joints.

    Parameters
    ----------
    uri : str
        ``joints:SOURCE#FILE``, for messages.
    opened : callable
        Opens the source at its first frame.
    path : str
        The file of joints, see `read_joint_file`.
    """

    def __init__(self, uri: str, opened: Callable[[], RgbdSource], path: str) -> None:
        self._path, self._opened = path, opened
        self._file = read_joint_file(path)
        with opened() as source:
            if source.is_live or not source.begins_anew:
                raise InputError(f"uri: expected a recording before #, got {uri!r}")
            self.calibration = source.calibration
            self._length = source.num_frames
        wanted = self._file.num_frames
        if self._file.key == "index" and self._length is not None and wanted != self._length:
            raise self._differs(self._length)

    def __len__(self) -> int:
        if self._length is None:
            raise TypeError("the number of frames is not known")
        return self._length

    def __iter__(self) -> Iterator[RgbdFrame]:
        return self.since(0)

    def since(self, start: int) -> Iterator[RgbdFrame]:
        """Yield the frames from an index on."""
        has_joints = False
        index = start - 1
        with self._opened() as source:
            if start:
                source.seek(start)
            for index, frame in enumerate(source, start):
                if self._file.key == "index":
                    self._check_order(source)
                people = self._people(index, frame)
                has_joints = has_joints or people is not None
                yield replace(frame, skeletons=_skeletons(frame, self._file, people or ()))
        if start == 0 and self._file.key == "index" and index + 1 != self._file.num_frames:
            raise self._differs(index + 1)
        if start == 0 and not has_joints:
            what = "number" if self._file.key == "number" else "time"
            raise FormatError(
                f"expected joints of the recording's frames, no frame has the {what} of any",
                file=self._path,
            )

    def _people(self, index: int, frame: RgbdFrame) -> tuple[SeenPerson, ...] | None:
        frames = self._file.frames
        if self._file.key == "index":
            return frames.get(index)
        if self._file.key == "number":
            return frames.get(frame.number)
        time = frame.time_ns // 1000
        return next((frames[time + near] for near in _NEAR_US if time + near in frames), None)

    def _check_order(self, source: RgbdSource) -> None:
        counters = source.counters
        if any(counters.get(name) for name in _LEFT_OUT):
            raise FormatError(
                "expected a recording whose frames can all be read, because joints are assigned by "
                f"their order, got {source.uri}",
                file=self._path,
            )

    def _differs(self, there: int) -> FormatError:
        return FormatError(
            f"expected joints of the recording's {there} frames, got those of "
            f"{self._file.num_frames}",
            file=self._path,
        )


def _skeletons(
    frame: RgbdFrame, file: JointFile, people: tuple[SeenPerson, ...]
) -> tuple[Skeleton, ...]:
    layout = cast("JointLayout", file.layout)
    if file.axes == "pixels":
        under = frame if frame.color is None else depth_under_color(frame)
        lifted = (
            lifted_joints(frame, under, one.joints, one.trust, layout, id=one.id) for one in people
        )
        return tuple(skeleton for skeleton in lifted if skeleton is not None)
    found = []
    for one in people:
        states = one.trust.astype(np.uint8)
        made = skeleton_from(one.joints, states, layout=layout, axes=file.axes, id=one.id)
        body = body_under(made.positions.astype(np.float64), made.states, frame)
        found.append(replace(made, body=body))
    return tuple(found)
