"""Films and folders of pictures of people with a phantom limb."""

from __future__ import annotations

import heapq
import itertools
import math
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args
from urllib.parse import parse_qs, urlsplit

import numpy as np

from manip3d._util.extras import imported, require
from manip3d._util.options import reporting
from manip3d._util.paths import refuse_existing
from manip3d.errors import InputError
from manip3d.io._files import atomic_folder, atomic_path, atomic_write, holds_only

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d._util.options import Progress
    from manip3d.modify import PhantomFrame
    from manip3d.rgbd import RgbdFrame

    Image = NDArray[np.uint8]

RATE = 30
"""Frames per second of a film of frames without times."""

_TICKS = 30_000  # per second of a film; encoders of MPEG-4 know 65,535 at most
_LONGEST_S = 10.0  # a longer gap between two frames is shown as this

_WORST, _COLUMNS, _WIDTH = 40, 8, 200
"""Number of frames of a contact sheet, number per row, and width of each in pixels."""

_PICTURE = re.compile(r"\d{6}\.png")
_UNREAD = "The frame cannot be read."


@dataclass(frozen=True)
class PhantomFilm:
    """Result of `render_phantom`.

    Attributes
    ----------
    path : Path
    affected : str
        The limb that was replaced, such as ``right_arm``.
    frames : int
    frames_with_skeleton : int
        Number of frames with a person's skeleton; if it is 0, there is no phantom.
    frames_with_color : int
        Number of frames with a colour image, which ``pose`` needs.
    states : mapping of str to int
        Number of frames in each state of the pipeline.
    stage_ms : mapping of str to float
        Mean time of each stage of the pipeline, milliseconds per frame.
    messages : mapping of str to int
        Reasons why frames were not ``tracking``, as sentences for an operator, with the numbers of
        frames.
    errors : mapping of int to str
        Reasons why frames could not be read, by the frames' indices. The picture of the previous
        frame is shown instead, and the frame counts as ``holding``; unreadable frames before the
        first readable one are left out.
    counters : mapping of str to int
        Counters of the source, such as the number of dropped frames; may be empty.
    """

    path: Path
    affected: str
    frames: int
    frames_with_skeleton: int
    frames_with_color: int
    states: Mapping[str, int]
    stage_ms: Mapping[str, float]
    messages: Mapping[str, int]
    errors: Mapping[int, str]
    counters: Mapping[str, int]


def render_phantom(
    source: str | Iterable[RgbdFrame],
    output: str | os.PathLike[str],
    *,
    affected: str | None = None,
    mode: Literal["reflection", "paper", "2d"] = "reflection",
    segmentation: Literal["skin", "paper"] = "skin",
    smoothing: Literal["default", "seated"] | None = "default",
    plane: Literal["trunk", "joints"] | None = None,
    pose: bool = False,
    azimuth: float = 35.0,
    frames: int | None = None,
    overwrite: bool = False,
    threads: int = 0,
    progress: Progress = None,
) -> PhantomFilm:
    """Draw people with a phantom limb: camera image, phantom, and the mesh from the side.

    Parameters
    ----------
    source : str or iterable of RgbdFrame
        An address for `manip3d.capture.open_rgbd`, a recording's path, or frames with a skeleton.
    output : path-like
        ``.mp4``: a film at the speed of the frames' times, in which gaps last 10 s at most; without
        times, 30 frames per second. ``.png``: a contact sheet of the 40 worst frames
        by `manip3d.modify.PhantomQuality.score`, the worst first; each is cropped to the person and
        shows the camera image above the phantom. A name without a suffix: a folder of PNG pictures.
    affected : str, optional
        The affected limb: ``left_arm``, ``right_arm``, ``left_leg`` or ``right_leg`` (the person's
        own left and right). Default: the limb that a simulated person has lost, or the right arm.
    mode, segmentation, smoothing, plane
        Same as for `manip3d.modify.PhantomPipeline`.
    pose : bool
        Find the person's joints with `manip3d.modify.PoseTracker`, for sources without skeletons.
    azimuth : float, degrees
        Direction from which the mesh is drawn.
    frames : int, optional
        Stop after this many frames.
    overwrite : bool
        Replace a film, a sheet, or a folder that contains only PNG pictures.
    threads : int
        Number of threads; 0: ``MANIP3D_THREADS`` if it is set, otherwise all cores.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    PhantomFilm

    Raises
    ------
    InputError
        An option is out of range, ``output`` has another suffix or exists, or there is no frame.
    FormatError, OSError
        No frame can be read.
    MissingExtraError
        PyAV (films), Pillow (pictures) or MediaPipe (``pose``) is not installed.
    """
    from manip3d.modify import PhantomPipeline, PoseTracker

    if not math.isfinite(azimuth):
        raise InputError(f"azimuth: expected a finite number, got {azimuth}")
    if frames is not None and frames < 1:
        raise InputError(f"frames: expected 1 or more, got {frames}")
    limb = affected or (limb_of(source) if isinstance(source, str) else "right_arm")
    options: dict[str, Any] = {"affected": limb, "mode": mode, "segmentation": segmentation}
    pipeline = PhantomPipeline(smoothing=smoothing, plane=plane, **options)
    counted = _FrameCounts()
    path = Path(output)
    if path.suffix.lower() == ".mp4":
        require("video", "simulate")  # together, so that users install both at once
    with (
        _opened(source) as stream,
        _sink(path, overwrite=overwrite) as sink,
        reporting(progress, "render") as report,
        PoseTracker() if pose else nullcontext() as tracker,
    ):
        total = frames or getattr(stream, "num_frames", None)
        past_errors: Any = getattr(stream, "past_errors", stream.__iter__)
        taken: Iterable[RgbdFrame | None] = itertools.islice(past_errors(), frames)
        if tracker is not None:
            # The first frames of some cameras have no colour.
            taken = (f if f is None or f.color is None else tracker.annotate(f) for f in taken)
        for frame, picture, phantom in _pictures(taken, pipeline, azimuth, threads):
            sink.add(picture, phantom, None if frame is None else frame.time_ns)
            counted.add(frame, phantom)
            if frame is not None and report is not None:
                report(min(counted.total / total, 1.0) if total else 0.0)
        if not counted.total:
            name = source if isinstance(source, str) else "source"
            raise InputError(f"{name}: expected frames, found none")
    return PhantomFilm(
        path=path,
        affected=limb,
        frames=counted.total,
        frames_with_skeleton=counted.with_skeleton,
        frames_with_color=counted.with_color,
        states=dict(counted.states),
        stage_ms={name: 1e3 * spent / counted.total for name, spent in counted.seconds.items()},
        messages=counted.messages_of_all(is_tracked=pose),
        errors=dict(getattr(stream, "errors", {})),
        counters=dict(getattr(stream, "counters", {})),
    )


class _FrameCounts:
    """Counts of a film's frames by state and by reason for not tracking; time of each stage."""

    def __init__(self) -> None:
        self.states: Counter[str] = Counter()
        self.messages: Counter[str] = Counter()
        self.seconds: Counter[str] = Counter()
        self.with_skeleton = 0
        self.with_color = 0

    @property
    def total(self) -> int:
        return self.states.total()

    def add(self, frame: RgbdFrame | None, phantom: PhantomFrame) -> None:
        """Count a frame; None: a frame that could not be read."""
        if frame is None:
            self.states["holding"] += 1
            self.messages[_UNREAD] += 1
            return
        self.with_skeleton += bool(frame.skeletons)
        self.with_color += frame.color is not None
        self.states[phantom.state.value] += 1
        if phantom.state != "tracking":
            self.messages[phantom.message] += 1
        self.seconds.update(phantom.seconds)

    def messages_of_all(self, *, is_tracked: bool) -> dict[str, int]:
        """Return the messages, in view of the whole source.

        The pipeline waits for a second before it says that a source has no skeletons, and until
        then says that the tracker has no joints. ``is_tracked``: joints were looked for, and it has
        none.
        """
        from manip3d.modify import PhantomReason

        messages = self.messages.copy()
        if not self.with_skeleton and not is_tracked:
            none = messages.pop(PhantomReason.NO_JOINTS.message, 0)
            messages.update({PhantomReason.NO_SKELETON.message: none} if none else {})
        return dict(messages)


def _opened(source: str | Iterable[RgbdFrame]) -> Any:
    if not isinstance(source, str):
        return nullcontext(source)
    from manip3d import capture

    return capture.open_rgbd(capture.rgbd_address(source) or source)


class Sink(Protocol):
    """Receives pictures one after another."""

    def add(self, picture: Image, phantom: PhantomFrame, time_ns: int | None) -> None:
        """Add the next picture, the frame that it shows, and its time; None: it was not read."""


def limb_of(source: str) -> str:
    """Return the limb that a simulated person has lost, or the right arm.

    Wrong names of limbs are not refused here but by the simulator, which names its option.
    """
    from manip3d.modify import Limb

    named = parse_qs(urlsplit(source).query).get("amputated", [])
    limb = named[0].replace("-", "_") if named else "right_arm"
    return limb if limb in get_args(Limb) else "right_arm"


def _pictures(
    frames: Iterable[RgbdFrame | None], pipeline: Any, azimuth: float, threads: int
) -> Iterator[tuple[RgbdFrame | None, Image, Any]]:
    """Yield the picture of each frame; for an unreadable frame, the previous picture."""
    from manip3d.viewer import people

    sheet: Image | None = None
    phantom: Any = None
    for frame in frames:
        if frame is None:
            if sheet is not None:
                yield None, sheet, phantom
            continue
        phantom = pipeline.process(frame)
        sheet = people.phantom_sheet(frame, phantom, azimuth=azimuth, threads=threads)
        yield frame, sheet, phantom


@contextmanager
def _sink(output: Path, *, overwrite: bool) -> Iterator[Sink]:
    """Yield a film, sheet or folder, which is written atomically."""
    refuse_existing(output, overwrite=overwrite, name="output")
    suffix = output.suffix.lower()
    if suffix == ".mp4":
        with atomic_path(output) as temporary, closing(_Film(temporary)) as film:
            yield film
        return
    if suffix == ".png":
        worst = _Worst()
        yield worst
        worst.write(output)
        return
    if output.suffix:
        raise InputError(
            f"output: expected .mp4, .png, or a folder's name without a suffix, got {output}"
        )
    if output.exists() and not holds_only(output, is_picture_of_phantom):
        raise InputError(
            f"output: expected a new folder, or one of pictures to overwrite, got {output}"
        )
    with atomic_folder(output) as new:
        yield _Folder(new)


def is_picture_of_phantom(name: str) -> bool:
    """Return whether `render_phantom` writes a picture of this name into its folder."""
    return bool(_PICTURE.fullmatch(name))


def _around(picture: Image, phantom: PhantomFrame) -> Image:
    """Crop camera image and phantom to a square around the person, one above the other.

    Without a person the square contains the whole image.
    """
    rows, columns = np.nonzero(phantom.depth > 0)
    height, width = phantom.depth.shape
    if not len(rows):
        rows, columns = np.array([0, height - 1]), np.array([0, width - 1])
    ends = [(int(axis.min()), int(axis.max())) for axis in (rows, columns)]
    half = max(last - first for first, last in ends) / 2 + 8  # pixels, with a margin
    steps = np.linspace(-half, half, _WIDTH)
    v, u = (
        np.clip(np.rint((first + last) / 2 + steps).astype(int), 0, size - 1)
        for (first, last), size in zip(ends, (height, width), strict=True)
    )
    return np.vstack([picture[np.ix_(v, u + left)] for left in (0, width)])


class _Worst:
    """Sheet of the pictures with the highest scores; of equal scores the earlier pictures."""

    def __init__(self) -> None:
        self._kept: list[tuple[float, int, Image]] = []  # heap with the lowest score first
        self._number = 0

    def add(self, picture: Image, phantom: PhantomFrame, time_ns: int | None) -> None:
        self._number += 1
        push = heapq.heappush if len(self._kept) < _WORST else heapq.heappushpop
        push(self._kept, (phantom.quality.score, -self._number, _around(picture, phantom)))

    def write(self, output: Path) -> None:
        from manip3d.viewer import png_bytes

        if not self._kept:
            return  # there was no frame, for which the caller raises an error
        pairs = [pair for _, _, pair in sorted(self._kept, key=lambda one: one[:2], reverse=True)]
        pairs += [np.zeros_like(pairs[0])] * (-len(pairs) % min(len(pairs), _COLUMNS))
        rows = [np.hstack(pairs[i : i + _COLUMNS]) for i in range(0, len(pairs), _COLUMNS)]
        atomic_write(output, png_bytes(np.vstack(rows)))


class _Folder:
    """Folder of pictures ``000000.png``, ``000001.png``, ..."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._number = 0

    def add(self, picture: Image, phantom: PhantomFrame, time_ns: int | None) -> None:
        from manip3d.viewer import png_bytes

        (self._folder / f"{self._number:06d}.png").write_bytes(png_bytes(picture))
        self._number += 1


class _Film:
    """Film in H.264, or in MPEG-4 if that encoder is missing.

    Width and height are even, because colours are stored at half the resolution.
    """

    def __init__(self, path: Path) -> None:
        self._av = av = imported("av", "video")
        self._container = av.open(os.fspath(path), "w", format="mp4")
        self._stream: Any = None
        self._step = _TICKS // RATE  # between the last two frames
        self._ticks = -self._step  # of the last frame
        self._read: tuple[int, int] | None = None  # time in ns, and ticks, of the last frame read

    def add(self, picture: Image, phantom: PhantomFrame, time_ns: int | None) -> None:
        height, width = (side - side % 2 for side in picture.shape[:2])
        if self._stream is None:
            codec = "libx264" if "libx264" in self._av.codecs_available else "mpeg4"
            self._stream = self._container.add_stream(codec, rate=Fraction(RATE))
            self._stream.width, self._stream.height = width, height
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.time_base = Fraction(1, _TICKS)
            self._stream.bit_rate = 4_000_000
        even = np.ascontiguousarray(picture[:height, :width])
        frame = self._av.VideoFrame.from_ndarray(even, format="rgb24")
        frame.pts, frame.time_base = self._next_ticks(time_ns), Fraction(1, _TICKS)
        self._container.mux(self._stream.encode(frame))

    def _next_ticks(self, time_ns: int | None) -> int:
        """Return when the next frame is shown.

        A frame that was not read, or whose time is not later than that of the frame before, follows
        after the last known step.
        """
        ticks = self._ticks + self._step
        if time_ns is not None:
            if self._read is not None and time_ns > self._read[0]:
                seconds = min((time_ns - self._read[0]) / 1e9, _LONGEST_S)
                ticks = max(self._ticks + 1, self._read[1] + round(_TICKS * seconds))
                self._step = min(ticks - self._ticks, _TICKS // 4)  # a longer one is a gap
            self._read = time_ns, ticks
        self._ticks = ticks
        return ticks

    def close(self) -> None:
        if self._stream is not None:
            self._container.mux(self._stream.encode(None))
        self._container.close()
