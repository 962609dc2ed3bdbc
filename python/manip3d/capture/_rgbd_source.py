"""Sources of RGB-D frames, which `open_rgbd` and `from_frames` return."""

from __future__ import annotations

import operator
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, cast, overload

from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d.camera import Intrinsics, Registration
from manip3d.capture._folder_warnings import unit_in_doubt
from manip3d.capture._frame_source import ClosedSource, FrameSource
from manip3d.capture._frames_in_memory import IteratedFrames
from manip3d.capture._past_errors import past_errors
from manip3d.errors import FormatError, InputError
from manip3d.rgbd import RgbdCalibration, RgbdFrame, Skeleton

_MAX_ERRORS = 1000  # largest number of unreadable frames if the number of frames is unknown


@checked
class RgbdSource(FrameSource[RgbdFrame]):
    """Iterable source of the frames of an RGB-D camera or recording; made by `open`.

    Iterating continues where reading stopped. If a recording has ended, iterating begins again at
    its first frame, except after `stop`. After a ``with`` statement iterating raises `InputError`,
    until `start` or `seek` opens the source again. `start` rewinds a recording that is read as fast
    as possible, whether it has ended or not; one that is played in real time continues, as a camera
    does, unless a ``with`` statement has closed it. Sources made by `from_frames` can be rewound if
    their frames are a sequence, a simulator or a data set, but not if they come from an iterator.

    Sources that can be rewound also have an index: ``source[10]`` is the eleventh frame,
    ``source[-1]`` the last one, ``source[10:20]`` a list. An index does not move the place at which
    `read` continues; `seek` does. ``len()`` is `num_frames`, and raises `TypeError` if that is not
    known. Folders and recordings of this library go to a frame directly; recordings of the Azure
    Kinect are read from their beginning up to the frame.

    Each frame owns its images: reading the next frame does not change them. They are not copied
    when they come from the core.

    Attributes
    ----------
    uri : str
        Address of the source.
    is_live : bool
        Whether frames arrive whether or not they are read, as from a camera or from a recording
        that is played in real time; the reader gets the latest one.
    errors : dict of int to str
        Index in `past_errors` of each frame that could not be read, with the reason.
    """

    _how_to_reopen = "open it again, or call start()"

    def __init__(
        self,
        uri: str,
        source: Any,
        reopen: Callable[[], Any] | None = None,
        open_indexed: Callable[[], Any] | None = None,
        assumed_units: float | None = None,
    ) -> None:
        self.uri = uri
        self.is_live = bool(source.is_live())
        self._source = source
        self._reopen = reopen
        self._open_indexed = open_indexed or reopen
        self._indexed: Any = None
        self._is_started = self._is_stopped = False
        self._calibration: RgbdCalibration | None = None
        self.errors: dict[int, str] = {}
        self._is_color_checked = False
        self._assumed_units = assumed_units  # per metre, until a frame has been checked by them
        self.start()

    @property
    def calibration(self) -> RgbdCalibration:
        """Calibration of all frames."""
        assert self._calibration is not None
        return self._calibration

    @property
    def counters(self) -> dict[str, int]:
        """Numbers of frames read (``frames``), lost (``dropped``) and refused, by reason."""
        found: dict[str, int] = self._source.counters()
        return found

    @property
    def num_frames(self) -> int | None:
        """Number of frames of a recording; None if it is not known."""
        found: int | None = self._source.num_frames()
        return found

    @property
    def flipped(self) -> tuple[str, ...]:
        """Names of the images, ``depth`` and ``color``, that are stored mirrored.

        They are flipped when they are read. Pixels that another program found in the stored images
        belong to the mirrored ones. ``color`` is named even if no frame has colour: it would be of
        the depth camera where the calibration has no other.
        """
        found = self._source.conversions()
        return tuple(name for name in ("depth", "color") if found.get(f"flipped_{name}"))

    @property
    def assumed_rate(self) -> float | None:
        """Frames per second of a folder of images without times; None if frames have times."""
        return self._source.conversions().get("assumed_rate") or None

    @property
    def begins_anew(self) -> bool:
        """Whether the source can be rewound: it is neither live nor an iterator."""
        return not self.is_live and self._reopen is not None

    @property
    def has_known_end(self) -> bool:
        """Whether the source surely ends: it is neither live nor an iterable without a length."""
        is_iterated = isinstance(self._source, IteratedFrames)
        return not self.is_live and not (is_iterated and self.num_frames is None)

    def start(self) -> None:
        """Open the device again after a `DeviceError`, or rewind a recording and its counters.

        `open` has started a new source already. A recording that is played in real time is not
        rewound: it continues where `stop` or an error stopped it, as a camera does. A recording
        that a ``with`` statement has closed begins at its first frame.

        Raises
        ------
        DeviceError
            The device is not connected.
        FormatError, OSError
            The recording was changed or removed, and cannot be read.
        """
        goes_on = self.is_live and not self._is_closed
        if self._is_started and self._reopen is not None and not goes_on:
            self._open_again(self._reopen)
        self._begin()

    def _open_again(self, reopen: Callable[[], Any]) -> None:
        self._source.stop()
        self._source = reopen()

    def seek(self, index: int) -> None:
        """Go to a frame, so that it is the next one to be read; the counters start at 0 again.

        If that frame is damaged, a Matroska recording continues with the frame after it; in a
        folder of images the next `read` raises `FormatError`, which names the file.

        Parameters
        ----------
        index : int
            0 is the first frame and -1 the last; `num_frames` is the end.

        Raises
        ------
        InputError
            The source is a camera or an iterator, or ``index`` is out of range.
        """
        length = self.num_frames
        if length is None and index < 0:
            raise InputError(
                f"index: expected >= 0, because the number of frames is unknown; got {index}"
            )
        if length is not None and not -length <= index <= length:
            raise InputError(f"index: expected {-length} to {length}, got {index}")
        self._open_again(self._recorded(self._reopen))
        self._source.seek(index if index >= 0 else index + (length or 0))
        self._begin()

    def _recorded(self, reopen: Callable[[], Any] | None) -> Callable[[], Any]:
        if reopen is None:
            raise InputError(
                f"source: expected a recording, whose frames have an index, got {self.uri}"
            )
        return reopen

    @overload
    def __getitem__(self, index: int) -> RgbdFrame: ...
    @overload
    def __getitem__(self, index: slice) -> list[RgbdFrame]: ...
    def __getitem__(self, index: int | slice) -> RgbdFrame | list[RgbdFrame]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        at, length = operator.index(index), self.num_frames
        at += length if at < 0 and length is not None else 0
        if at < 0 or (length is not None and at >= length):
            raise IndexError(
                f"frame {index} of {'an unknown number' if length is None else length}"
            )
        open_indexed = self._recorded(self._open_indexed)
        indexed = self._indexed  # read once, because another thread may stop the source
        if indexed is None:
            indexed = self._indexed = open_indexed()
        try:
            found = indexed.read_at(at)
        except InputError:
            raise IndexError(f"frame {index}: the recording ends before it") from None
        finally:
            indexed.stop()  # no thread needs to read ahead between two indexed frames
        return self._to_frame(found) if isinstance(found, Mapping) else found

    def __len__(self) -> int:
        if (length := self.num_frames) is None:
            raise TypeError(f"{self.uri}: the number of frames is unknown")
        return length

    def __bool__(self) -> bool:
        return True  # without this method, bool() would call __len__

    def _begin(self) -> None:
        self._is_started = True
        self._has_ended = self._is_stopped = self._is_closed = False
        self._source.start()
        self._calibration = _to_calibration(self._source.calibration())

    def read(self, timeout: float | None = None) -> RgbdFrame | None:
        """Read the next frame; of a live source the latest.

        Parameters
        ----------
        timeout : float, optional, seconds
            Longest time to wait for a frame of a live source; default: no limit.

        Returns
        -------
        RgbdFrame or None
            None if the recording has ended, the source was stopped, or no frame came in time.

        Raises
        ------
        FormatError
            A file is damaged; the next call continues after the damaged frame.
        DeviceError
            The camera was disconnected; `start` tries to open it again.
        """
        frame = self._wait(timeout)
        if not self._is_color_checked and self.counters.get("unregistered_color"):
            self._is_color_checked = True
            warnings.warn(
                f"{self.uri}: the colour images are of another size than the depth images, and the "
                "calibration has no registration: frames have no colour",
                stacklevel=caller_level(),
            )
        if frame is not None and self._assumed_units is not None and frame.depth.any():
            doubt = unit_in_doubt(
                frame.depth,
                self._assumed_units,
                has_8_bits=self.counters.get("depth_of_8_bits", 0) > 0,
            )
            self._assumed_units = None
            if doubt:
                warnings.warn(f"{self.uri}: {doubt}", stacklevel=caller_level())
        return frame

    def past_errors(self) -> Iterator[RgbdFrame | None]:
        """Read to the end without stopping at unreadable frames; `errors` is cleared first.

        Yields
        ------
        RgbdFrame or None
            None if the frame cannot be read; `errors` states the reason.

        Raises
        ------
        FormatError, OSError
            No frame can be read; this is the first error.
        DeviceError
            The camera was disconnected.
        InputError
            A ``with`` statement has closed the source.
        """
        yield from self._past_errors(lambda: True)

    def _past_errors(self, goes_on: Callable[[], bool]) -> Iterator[RgbdFrame | None]:
        self._check_open()
        self.errors.clear()
        frames = cast("Iterator[RgbdFrame]", iter(self.read, None))
        most = self.num_frames or _MAX_ERRORS
        reasons = (FormatError, OSError)
        yield from past_errors(frames, self.errors, reasons, most=most, goes_on=goes_on)

    @property
    def _goes_on(self) -> bool:
        """Whether frames may follow after one that cannot be read."""
        return not isinstance(self._source, IteratedFrames) or self._source.goes_on()

    def _readable(self) -> Iterator[RgbdFrame]:
        """Read frames without those of a recording that cannot be read; these are in `errors`.

        Errors of other sources are raised: a camera or a generator does not continue after one. An
        error after which a recording does not continue is raised, too.
        """
        if self._has_ended:
            self._rewind()
        if self.num_frames is None or not self._goes_on:
            yield from self
            return
        for frame in self._past_errors(lambda: self._goes_on):
            if frame is not None:
                yield frame
            elif self.is_live:  # a recording in real time repeats an error until it is started
                self.start()

    def _counted(self) -> dict[str, int]:
        """Return `counters`, with the frames in `errors` as ``damaged``."""
        damaged = max(self.counters.get("damaged", 0), len(self.errors))
        return self.counters | ({"damaged": damaged} if damaged else {})

    def _rewind(self) -> None:
        if self._reopen is not None and not self._is_stopped:
            self._open_again(self._reopen)
            self._begin()

    def _to_frame(self, fields: Mapping[str, Any]) -> RgbdFrame:
        skeletons = tuple(Skeleton(**skeleton) for skeleton in fields["skeletons"])
        return RgbdFrame(**{**fields, "skeletons": skeletons}, calibration=self.calibration)

    def stop(self) -> None:
        """End a live source's thread; the frame that it holds can still be read.

        Other sources yield no further frames until `start` or `seek` is called. A loop over an
        endless iterator ends with the frame that it is waiting for.
        """
        self._is_stopped = True
        self._source.stop()
        self._indexed = None

    def _release(self) -> None:
        if hasattr(self._source, "close"):
            self._source.close()
        elif self._reopen is not None:  # a camera has closed its device, and `start` opens it again
            self._source = _ClosedRecording(self._source)


class _ClosedRecording(ClosedSource):
    """Counts and properties of a recording that was closed."""

    def __init__(self, source: Any) -> None:
        super().__init__(source)
        self._num_frames: int | None = source.num_frames()
        self._conversions: Mapping[str, Any] = source.conversions()

    def num_frames(self) -> int | None:
        """Return the number of frames of the recording; None if it is not known."""
        return self._num_frames

    def conversions(self) -> Mapping[str, Any]:
        """Return how the recording's frames differ from what its files hold."""
        return self._conversions


@checked
class ForgedSource(RgbdSource):
    """A source whose frames are forged or real, switched while it runs: ``forged:SOURCE``.

    Attributes
    ----------
    forged : bool
        Whether the next frames are forged; may be set at any time, from any thread. Options of the
        address have precedence: ``switch``, and the seconds of ``show``.
    """

    @property
    def forged(self) -> bool:
        """Whether the next frames are forged."""
        return bool(self._source.is_forged)

    @forged.setter
    def forged(self, value: bool) -> None:
        if not isinstance(value, bool):
            raise InputError(f"forged: expected True or False, got {value!r}")
        self._source.is_forged = value

    @property
    def begins_anew(self) -> bool:
        """Whether the source that is forged can be read again from its first frame."""
        return not self.is_live

    def _rewind(self) -> None:
        if not self.is_live and not self._is_stopped:
            self.start()


def _to_calibration(found: Any) -> RgbdCalibration:
    if isinstance(found, RgbdCalibration):
        return found
    registration = None
    if "color" in found:
        registration = Registration(
            Intrinsics(**found["color"]), found["rotation"], found["translation"]
        )
    return RgbdCalibration(Intrinsics(**found["depth"]), registration)


@checked
def from_frames(frames: Iterable[RgbdFrame], *, uri: str = "frames") -> RgbdSource:
    """Make a source of frames that are in memory, or that a generator makes.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        Frames of one camera. The first one is read immediately, unless ``frames`` has an attribute
        ``calibration``. The iterable may be endless; `RgbdSource.stop` then ends a loop over it.
        `RgbdSource.read` waits for the iterator and ignores its ``timeout``.
    uri : str
        Name of the source in messages.

    Returns
    -------
    RgbdSource
        A source that ends with the last frame.

    Raises
    ------
    InputError
        There is no frame, and ``frames`` has no ``calibration``.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, capture
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> frames = [RgbdFrame(depth, camera, time_ns=n * 33_000_000, number=n) for n in range(3)]
    >>> source = capture.from_frames(frames)
    >>> source.read().number, [frame.number for frame in source]
    (0, [1, 2])
    """

    return source_of(frames, uri)


def source_of(
    frames: Iterable[RgbdFrame],
    uri: str,
    speed: float = 0.0,
    start: int = 0,
    assumed_units: float | None = None,
) -> RgbdSource:
    def opened() -> IteratedFrames:
        source = IteratedFrames(frames, getattr(frames, "calibration", None), speed)
        if start:
            source.seek(start)
        return source

    # An iterator can be read only once, so it cannot be rewound.
    again = None if isinstance(frames, Iterator) else opened
    return RgbdSource(uri, opened(), again, assumed_units=assumed_units)
