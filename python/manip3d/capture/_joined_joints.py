"""Frames of a recording with the joints that another program wrote to a file."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache, partial
from typing import cast

import numpy as np

from manip3d._util.callers import caller_level
from manip3d.capture._joint_sides import exchanges_sides, file_and_options, other_sides
from manip3d.capture._rgbd_source import RgbdSource
from manip3d.errors import FormatError, InputError
from manip3d.io._joint_files import SeenPerson, read_joint_file
from manip3d.modify import skeleton_from
from manip3d.modify._joints import JointLayout
from manip3d.modify._pose import body_under, depth_under_color, lifted_joints
from manip3d.rgbd import RgbdFrame, Skeleton

_NEAR_US = (0, 1, -1)  # microseconds by which times may be rounded


def source_and_file(uri: str) -> tuple[str, str]:
    """Return the source and the file, with its options, of ``joints:SOURCE#FILE?OPTIONS``.

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
        The file of joints, see `read_joint_file`; ``?`` may add options of joints in pixels.
    """

    def __init__(self, uri: str, opened: Callable[[], RgbdSource], path: str) -> None:
        self._path, self._options = file_and_options(path)
        self._opened = opened
        self._file = read_joint_file(self._path)
        self._are_times_checked = not self._file.times_ns
        with opened() as source:
            if source.is_live or not source.begins_anew:
                raise InputError(f"uri: expected a recording before #, got {uri!r}")
            self.calibration = source.calibration
            self._conversions = source._source.conversions()
            self._flipped, self._assumed_rate = source.flipped, source.assumed_rate
            self._length = source.num_frames
            first = next(source._readable(), None) if self._file.axes == "pixels" else None
        wanted = self._file.num_frames
        if self._file.key == "index" and self._length is not None and wanted != self._length:
            raise self._differs(self._length)
        self._exchanges = cache(partial(exchanges_sides, self._file, self._path, self._options))
        self._exchanges(first is not None and self._is_mirrored(first))  # raises its errors now

    def __len__(self) -> int:
        if self._length is None:
            raise TypeError("the number of frames is not known")
        return self._length

    def __iter__(self) -> Iterator[RgbdFrame]:
        return self.since(0)

    def since(self, start: int) -> Iterator[RgbdFrame]:
        """Iterate from a frame on; after an error the iterator continues if the source does."""
        return _JoinedFrames(self, start)

    def _joined(self, index: int, frame: RgbdFrame) -> tuple[RgbdFrame, bool]:
        """Return the frame with its skeletons, and whether the file has an entry for it."""
        people = self._people(index, frame)
        return replace(frame, skeletons=self._skeletons(frame, people or ())), people is not None

    def _people(self, index: int, frame: RgbdFrame) -> tuple[SeenPerson, ...] | None:
        frames = self._file.frames
        if self._file.key == "index":
            return frames.get(index)
        if self._file.key == "number":
            return frames.get(frame.number)
        time = frame.time_ns // 1000
        return next((frames[time + near] for near in _NEAR_US if time + near in frames), None)

    def _check_time(self, clocks: _Clocks, frame: RgbdFrame) -> None:
        """Warn at the first frame whose time the table contradicts."""
        if self._are_times_checked or (found := clocks.contradiction(frame)) is None:
            return
        self._are_times_checked = True
        told, seen = found
        rate = self._assumed_rate
        why = (
            f": a folder without times, for which {rate:g} frames a second are assumed (--rate, or "
            "rate= in Python, sets another rate)"
            if rate
            else ", whose times are used"
        )
        warnings.warn(
            f"{self._path}: frame {frame.number} is {told:.3f} s after the first one by time_ns, "
            f"but {seen:.3f} s by the recording{why}",
            stacklevel=caller_level(),
        )

    def _skeletons(self, frame: RgbdFrame, people: tuple[SeenPerson, ...]) -> tuple[Skeleton, ...]:
        layout = cast("JointLayout", self._file.layout)
        if self._file.axes == "pixels":
            under = frame if frame.color is None else depth_under_color(frame)
            seen = (self._unmirrored(one, frame) for one in people)
            lifted = (
                lifted_joints(frame, under, one.joints, one.trust, layout, id=one.id)
                for one in seen
            )
            return tuple(skeleton for skeleton in lifted if skeleton is not None)
        found = []
        for one in people:
            states = one.trust.astype(np.uint8)
            made = skeleton_from(one.joints, states, layout=layout, axes=self._file.axes, id=one.id)
            body = body_under(made.positions.astype(np.float64), made.states, frame)
            found.append(replace(made, body=body))
        return tuple(found)

    def _unmirrored(self, one: SeenPerson, frame: RgbdFrame) -> SeenPerson:
        """Return a person's pixels as they are in the frame's image, which is not mirrored."""
        is_mirrored = self._is_mirrored(frame)
        image = frame.depth if frame.color is None else frame.color
        joints, trust = one.joints, one.trust
        if is_mirrored:
            joints = joints * (-1.0, 1.0) + (image.shape[1] - 1.0, 0.0)
        if self._exchanges(is_mirrored):
            order = list(other_sides(self._file.layout))
            joints, trust = joints[order], trust[order]
        return replace(one, joints=joints, trust=trust)

    def _is_mirrored(self, frame: RgbdFrame) -> bool:
        """Return whether the tracker saw the image of a frame's pixels mirrored."""
        if self._options.mirrored is not None:
            return self._options.mirrored
        return ("depth" if frame.color is None else "color") in self._flipped

    def _differs(self, there: int) -> FormatError:
        return FormatError(
            f"expected joints of the recording's {there} frames, got those of "
            f"{self._file.num_frames}",
            file=self._path,
        )


class _JoinedFrames(Iterator[RgbdFrame]):
    """Iterator of the joined frames from an index on.

    It is no generator, because a generator ends with its first error, and a recording continues
    after a frame that cannot be read.
    """

    def __init__(self, joined: JoinedJoints, start: int) -> None:
        self._joined, self._start = joined, start
        self._clocks = _Clocks(joined._file.times_ns)
        self._source: RgbdSource | None = None  # opened at the first frame
        self._index = start
        self._num_unread = 0
        self._has_joints = self._has_ended = False

    @property
    def _goes_on(self) -> bool:
        """Whether frames may follow after the last error."""
        return not self._has_ended and (self._source is None or self._source._goes_on)

    def __next__(self) -> RgbdFrame:
        if self._has_ended:
            raise StopIteration
        source = self._source = self._source or self._opened()
        frame = self._read(source)
        if frame is None:
            self._end(source)
            self._check_whole()
            raise StopIteration
        index, self._index = self._index, self._index + 1
        if self._joined._file.key == "index":
            self._check_order(source)
        joined, has_joints = self._joined._joined(index, frame)
        self._has_joints = self._has_joints or has_joints
        self._joined._check_time(self._clocks, frame)
        return joined

    def _opened(self) -> RgbdSource:
        self._has_ended = True  # if it cannot be opened
        source = self._joined._opened()
        try:
            if self._start:
                source.seek(self._start)
        except BaseException:
            source._close()
            raise
        self._has_ended = False
        return source

    def _read(self, source: RgbdSource) -> RgbdFrame | None:
        """Read a frame; one that cannot be read has an index, too."""
        try:
            return source.read()
        except Exception:
            self._index += 1
            self._num_unread += 1
            raise

    def _check_order(self, source: RgbdSource) -> None:
        """Raise `FormatError` if the source has left out frames without an error.

        The index of the frames after them is wrong.
        """
        counters = source.counters
        unread = counters.get("damaged", 0) + counters.get("lost", 0)
        if unread > self._num_unread or counters.get("out_of_order"):
            self._end(source)
            raise FormatError(
                "expected a recording whose frames can all be read, because joints are assigned by "
                f"their order, got {source.uri}",
                file=self._joined._path,
            )

    def _end(self, source: RgbdSource) -> None:
        self._has_ended = True
        source._close()

    def _check_whole(self) -> None:
        """Raise `FormatError` if frames were read and the joints are not those of them."""
        file = self._joined._file
        if self._start or 0 < self._num_unread == self._index:
            return
        if file.key == "index" and self._index != file.num_frames:
            raise self._joined._differs(self._index)
        if not self._has_joints:
            what = "number" if file.key == "number" else "time"
            raise FormatError(
                f"expected joints of the recording's frames, no frame has the {what} of any",
                file=self._joined._path,
            )


class _Clocks:
    """Comparison of the times that a table of joints states with those of the frames.

    Times count from the first frame that both have, because the clocks may differ. Times that are
    all equal tell nothing.
    """

    def __init__(self, times_ns: Mapping[int, int]) -> None:
        self._told = times_ns if len(set(times_ns.values())) > 1 else {}
        self._first: tuple[int, int] | None = None
        self._last = 0

    def contradiction(self, frame: RgbdFrame) -> tuple[float, float] | None:
        """Return both times of a frame in seconds if they are more than half a frame apart."""
        step, self._last = frame.time_ns - self._last, frame.time_ns
        if (told := self._told.get(frame.number)) is None:
            return None
        if self._first is None:
            self._first = told, frame.time_ns
        after = told - self._first[0], frame.time_ns - self._first[1]
        if 2 * abs(after[0] - after[1]) <= abs(step):  # below 0 where a clock began again
            return None
        return after[0] * 1e-9, after[1] * 1e-9
