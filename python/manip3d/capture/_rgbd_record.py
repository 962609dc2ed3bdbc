"""Recording of the frames of an RGB-D source in a file or a folder."""

from __future__ import annotations

import os
import shutil
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manip3d import _core
from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d._util.paths import path_of
from manip3d.capture._one_camera import with_one_camera
from manip3d.capture._rgbd import RECORDINGS, open_rgbd
from manip3d.capture._rgbd_source import RgbdSource, from_frames
from manip3d.errors import InputError
from manip3d.rgbd import RgbdCalibration, RgbdFrame

if TYPE_CHECKING:
    from manip3d._util.options import Progress

_CALIBRATION = "calibration.json"
_IMAGES_AND_LISTS = {
    "folder": ("frames.jsonl", "depth", "body_index", "colour"),
    "tum": ("depth.txt", "rgb.txt", "associations.txt", "depth", "rgb"),
}
"""Names in the folder of a recording; the first one marks a folder as a recording."""
_TEMPORARY = ".manip3d-"  # begin of the names of files that a killed writer leaves
_LONGEST_BEFORE = 60.0  # largest `before` in seconds, since these frames are kept in memory


@dataclass(frozen=True)
class Recording:
    """Result of `record`.

    Attributes
    ----------
    path : Path
        The file or folder that was written.
    frames : int
        Number of frames written; 0 if the source has none that was wanted. ``path`` is then an
        empty recording, or the earlier one as it was. An iterable without frames and without the
        attribute ``calibration``, such as an empty list, is an `InputError`.
    frames_with_skeleton : int
        Number of frames with a person's skeleton, which the phantom limb needs.
    seconds : float
        Time from the first frame to the last.
    stop : str
        Reason why recording ended: ``end`` (of the source), or the limit ``frames`` or ``seconds``.
    counters : dict of str to int
        Counters of the recorder.
    source_counters : dict of str to int
        Counters of the source, among them lost frames.
    """

    path: Path
    frames: int
    frames_with_skeleton: int
    seconds: float
    stop: str
    counters: dict[str, int]
    source_counters: dict[str, int]


@checked
def record(
    source: str | Iterable[RgbdFrame],
    path: str | os.PathLike[str],
    *,
    frames: int | None = None,
    seconds: float | None = None,
    trigger: Callable[[RgbdFrame], bool] | None = None,
    before: float = 0.0,
    lossless_color: bool = False,
    jpeg_quality: int = 90,
    overwrite: bool = False,
    progress: Progress = None,
) -> Recording:
    """Write frames to a recording: a folder, Matroska for ``.mkv``, or a TUM sequence.

    If Ctrl-C, an error or a kill stops the recording, the frames written before can be read.
    Images of a mirrored camera are written as they are read, which is flipped.

    Parameters
    ----------
    source : str or iterable of RgbdFrame
        A URI for `open`, or an iterable of frames: a source, a simulator, a list.
    path : path-like
        A new folder, or a file that ends in ``.mkv``. The prefix ``folder:``, ``mkv:`` or ``tum:``
        selects the kind. ``tum:FOLDER`` is a sequence in the layout of the TUM RGB-D benchmark, see
        `Notes`.
    frames : int, optional
        Largest number of frames to write.
    seconds : float, optional
        Stop at the first frame that is at least this much later than the first one.
    trigger : callable(RgbdFrame) -> bool, optional
        Begin with the first frame for which it returns True; ``frames`` and ``seconds`` count from
        this frame.
    before : float, seconds
        Time before the trigger's frame that is also written, 0 to 60. These frames wait in memory:
        about 200 MB per second with colour of 1920 x 1080 pixels.
    lossless_color : bool
        Write colour without loss instead of as JPEG.
    jpeg_quality : int
        Quality of JPEG, 1 to 100.
    overwrite : bool
        Replace a recording of the same kind, unless another program reads or records it. The old
        recording stays unchanged until the first frame is written. It is not replaced if there is
        none: the source is empty, or ``trigger`` never returns True.
    progress : None, True or callable(fraction, message)
        True shows a bar; a callable gets the fraction done and a message.

    Returns
    -------
    Recording
        Path of the recording, and the numbers of frames written and lost.

    Raises
    ------
    InputError
        ``path`` exists, is being read or recorded, or has an unknown suffix; a frame does not fit
        the calibration or the frames before; times or numbers of frames do not increase; the
        source is closed, or is an iterable without frames that states no ``calibration``.
    OSError
        Writing failed, for example because the disk is full. The frames written before can be read,
        and a note of the error states their number; a new recording without frames is removed.
    FormatError, DeviceError
        The source cannot be read. Frames of a recording that cannot be read are left out, unless
        all are, and are ``damaged`` in the counters; `RgbdSource.errors` says which.

    Notes
    -----
    A TUM sequence has ``depth.txt`` and ``rgb.txt`` with a time in seconds and a file in each line,
    16-bit depth with 5000 units per metre, colour as PNG, ``associations.txt`` with the pairs, and
    ``calibration.json``, from which `open` reads the camera; times are exact. The layout has a
    single camera, so that colour of a separate colour camera is resampled to the depth pixels.
    Skeletons, body indices and frame numbers are left out; depths beyond 13.106 m become 0 and are
    counted as ``too_far``. There is no ``groundtruth.txt``, because frames do not state the pose of
    their camera.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from manip3d import Intrinsics, RgbdCalibration, RgbdFrame, Skeleton, capture
    >>> camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    >>> depth = np.full((48, 64), 2000, np.uint16)
    >>> frames = [RgbdFrame(depth, camera, time_ns=n * 33_000_000, number=n) for n in range(3)]
    >>> recording = capture.record(frames, "walk.mkv", frames=2)
    >>> recording.path.name, recording.frames
    ('walk.mkv', 2)

    The last second before somebody comes into the picture, and all that follows:

    >>> frames[2] = replace(frames[2], skeletons=(Skeleton(np.full((25, 3), 2.0)),))
    >>> capture.record(frames, "visit", trigger=lambda f: bool(f.skeletons), before=1.0).frames
    3

    A sequence for other programs:

    >>> capture.record(frames, "tum:sequence").path.name
    'sequence'
    >>> with capture.open("tum:sequence") as source:
    ...     len(source), source[-1].time_ns
    (3, 66000000)
    """
    for name, value in (("frames", frames), ("seconds", seconds)):
        if value is not None and not value > 0:
            raise InputError(f"{name}: expected > 0, got {value}")
    if not 0.0 <= before <= _LONGEST_BEFORE:
        raise InputError(f"before: expected 0 to {_LONGEST_BEFORE:g} seconds, got {before}")
    if before and trigger is None:
        raise InputError("before: can only be given with a trigger")
    place, kind = _place_of(path)
    if isinstance(source, RgbdSource):
        opened = source
    elif isinstance(source, str):
        opened = open_rgbd(source)
    else:
        opened = from_frames(source)
    is_tum = kind == _core.RecordingKind.tum
    was_there = place.exists()
    try:
        recorder = _core.open_recorder(
            os.fsencode(place),
            RgbdCalibration(opened.calibration.depth) if is_tum else opened.calibration,
            lossless_color,
            jpeg_quality,
            overwrite,
            kind,
        )
    except OSError:
        if not was_there:
            with suppress(OSError):
                place.rmdir()  # if it is empty
        raise

    def write(frame: RgbdFrame) -> None:
        recorder.write(with_one_camera(frame) if is_tum else frame)

    with _noting_frames(place, recorder, is_new=not was_there), ExitStack() as ends:
        if isinstance(source, str):
            ends.callback(opened.stop)
        ends.callback(recorder.close)
        with reporting(progress, "record") as report:
            copied = _copy(opened, write, frames, seconds, _since(trigger, before, opened), report)
    return Recording(place, *copied, recorder.counters(), opened._counted())


@contextmanager
def _noting_frames(place: Path, recorder: Any, *, is_new: bool) -> Iterator[None]:
    """Add the number of written frames to an error; remove a new recording without frames."""
    try:
        yield
    except BaseException as error:
        if written := recorder.counters()["frames"]:
            told = "1 frame, which is" if written == 1 else f"{written} frames, which are"
            error.add_note(f"{place} has {told} whole")
        elif is_new:
            remove_recording(place)
        raise


def is_file_of_recording(folder: Path, name: str, *, is_tum: bool = False) -> bool:
    """Return whether a file or subfolder of a folder belongs to a recording, as recorders judge it.

    Images belong to a recording only beside its calibration and its list of frames, because folders
    of images by other programs have the same names.
    """
    if name == _CALIBRATION or name.startswith(_TEMPORARY):
        return True
    names = _IMAGES_AND_LISTS["tum" if is_tum else "folder"]
    is_begun = (folder / _CALIBRATION).is_file() and (folder / names[0]).is_file()
    return is_begun and name in names


def remove_recording(place: Path) -> None:
    """Remove a recording that is a folder or a file."""
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    else:
        place.unlink(missing_ok=True)


def _place_of(path: str | os.PathLike[str]) -> tuple[Path, Any]:
    """Return the path of a recording to be written, and its kind if the address states it."""
    whole = path_of(path)
    scheme, colon, rest = str(whole).partition(":")
    if not colon or scheme not in RECORDINGS:
        return whole, None
    if not rest:
        raise InputError(f"path: expected a place after {scheme}:, got none")
    return Path(rest), getattr(_core.RecordingKind, scheme)


def _copy(
    source: RgbdSource,
    write: Callable[[RgbdFrame], None],
    frames: int | None,
    seconds: float | None,
    wanted: Iterator[tuple[Sequence[RgbdFrame], RgbdFrame]],
    report: Any,
) -> tuple[int, int, float, str]:
    """Write the frames; return the first five attributes of `Recording` after ``path``."""
    written = with_skeleton = count = 0
    first = since = last = 0
    stop = "end"
    expected = min((n for n in (frames, source.num_frames) if n), default=None)
    for earlier, frame in wanted:
        if count == 0:
            first, since = (earlier[0] if earlier else frame).time_ns, frame.time_ns
        if seconds is not None and frame.time_ns - since >= seconds * 1e9:
            stop = "seconds"
            break
        for one in (*earlier, frame):
            write(one)
            written, with_skeleton = written + 1, with_skeleton + bool(one.skeletons)
        count, last = count + 1, frame.time_ns
        if report is not None:
            done = count / expected if expected else 0.0
            if seconds is not None:
                done = max(done, (last - since) / 1e9 / seconds)
            report(min(done, 1.0))
        if count == frames:
            stop = "frames"
            break
    return written, with_skeleton, (last - first) / 1e9, stop


def _since(
    trigger: Callable[[RgbdFrame], bool] | None, before: float, source: RgbdSource
) -> Iterator[tuple[Sequence[RgbdFrame], RgbdFrame]]:
    """Yield each frame from the trigger's on, as (earlier frames, frame).

    ``earlier`` holds the frames of the last ``before`` seconds for the first frame, and is empty
    for the others.
    """
    earlier: deque[RgbdFrame] = deque()
    is_on = trigger is None
    for frame in source._readable():
        if earlier and frame.time_ns <= earlier[-1].time_ns:
            earlier.clear()  # the clock began again
        if not is_on and trigger is not None and not trigger(frame):
            earlier.append(frame)
            while frame.time_ns - earlier[0].time_ns > before * 1e9:
                earlier.popleft()
            continue
        while earlier and frame.time_ns - earlier[0].time_ns > before * 1e9:
            earlier.popleft()
        is_on = True
        yield tuple(earlier), frame
        earlier.clear()
