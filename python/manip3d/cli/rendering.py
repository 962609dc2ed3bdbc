"""``manip3d phantom render``: what the phantom limb looks like, frame by frame."""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import parse_qs, urlsplit

import numpy as np

from manip3d.cli.terminal import Terminal, count
from manip3d.errors import InputError, MissingExtraError
from manip3d.io._files import atomic_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.rgbd import RgbdFrame

    Image = NDArray[np.uint8]

RATE = 30
"""Frames a second of the film."""

_HELD = 64
"""Colour images that are kept for phantoms that are held: two seconds."""


class Sink(Protocol):
    """Takes pictures one after the other."""

    def add(self, picture: Image) -> None:
        """The next picture."""


def render(
    source: str,
    output: Path,
    terminal: Terminal,
    *,
    limb: str | None,
    mode: str,
    segmentation: str,
    smoothing: str,
    azimuth: float,
    frames: int,
    force: bool,
    threads: int,
) -> dict[str, Any]:
    """Draw the frames of ``source`` with a phantom limb into a film or a folder of pictures.

    Raises
    ------
    InputError
        An option is out of range, ``output`` is no ``.mp4`` and has another suffix, or the source
        has no frames.
    MissingExtraError
        PyAV (films), Pillow (pictures) or Open3D is not installed.
    """
    from manip3d.capture import open_rgbd
    from manip3d.modify import PhantomPipeline

    affected = (limb or _limb_of(source)).replace("-", "_")
    options: dict[str, Any] = {"affected": affected, "mode": mode, "segmentation": segmentation}
    pipeline = PhantomPipeline(smoothing=None if smoothing == "none" else smoothing, **options)  # type: ignore[arg-type]
    states: Counter[str] = Counter()
    seconds: Counter[str] = Counter()
    with (
        open_rgbd(source) as stream,
        _sink(output, force=force) as sink,
        terminal.progress("render") as progress,
    ):
        limited = itertools.islice(stream, frames or None)
        for picture, phantom in _pictures(limited, pipeline, azimuth, threads):
            sink.add(picture)
            states[phantom.state.value] += 1
            seconds.update(phantom.seconds)
            if progress is not None:
                done = states.total() / frames if frames else 0.0
                progress(done, f"frame {states.total()}: {phantom.state.value}")
        if not states:
            raise InputError(f"{source}: expected frames, found none")
    number = states.total()
    terminal.say(f"wrote {output}: {count(number)} frames, {affected.replace('_', ' ')}")
    return {
        "source": source,
        "output": str(output),
        "limb": affected,
        "frames": number,
        "states": dict(states),
        "stage_ms": {name: 1e3 * spent / number for name, spent in seconds.items()},
    }


def _limb_of(source: str) -> str:
    """The limb that a simulated person has lost; else the right arm."""
    named = parse_qs(urlsplit(source).query).get("amputated", [])
    return named[0] if named else "right_arm"


def _pictures(
    frames: Iterable[RgbdFrame], pipeline: Any, azimuth: float, threads: int
) -> Iterator[tuple[Image, Any]]:
    from manip3d.viewer import people

    older: deque[tuple[int, Image]] = deque(maxlen=_HELD)
    for frame in frames:
        phantom = pipeline.process(frame)
        if frame.colour is not None:
            older.append((frame.number, frame.colour))
        colour = dict(older).get(phantom.texture_number)
        sheet = people.phantom_sheet(
            frame, phantom, phantom_colour=colour, azimuth=azimuth, threads=threads
        )
        yield sheet, phantom


@contextmanager
def _sink(output: Path, *, force: bool) -> Iterator[Sink]:
    """A film or a folder that appears whole, or not at all."""
    if output.suffix == ".mp4":
        with atomic_path(output) as temporary, closing(_Film(temporary)) as film:
            yield film
        return
    if output.suffix:
        raise InputError(f"{output}: expected .mp4, or a folder's name without a suffix")
    if output.exists() and not (force and _holds_pictures_only(output)):
        raise InputError(f"{output}: expected a new folder, or one of pictures and --force")
    temporary = Path(tempfile.mkdtemp(prefix=".manip3d-", dir=output.parent))
    try:
        new = temporary / "new"
        new.mkdir()
        yield _Folder(new)
        if output.exists():
            output.rename(temporary / "old")
        new.rename(output)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _holds_pictures_only(folder: Path) -> bool:
    return folder.is_dir() and all(path.suffix == ".png" for path in folder.iterdir())


class _Folder:
    """``000000.png`` and so on."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._number = 0

    def add(self, picture: Image) -> None:
        from manip3d.viewer import png_bytes

        (self._folder / f"{self._number:06d}.png").write_bytes(png_bytes(picture))
        self._number += 1


class _Film:
    """H.264, or MPEG-4 where that encoder is missing; even sizes, as its colours need."""

    def __init__(self, path: Path) -> None:
        try:
            import av
        except ImportError as error:
            raise MissingExtraError("av", "video") from error
        self._av = av
        self._container = av.open(os.fspath(path), "w", format="mp4")
        self._stream: Any = None

    def add(self, picture: Image) -> None:
        height, width = (side - side % 2 for side in picture.shape[:2])
        if self._stream is None:
            codec = "libx264" if "libx264" in self._av.codecs_available else "mpeg4"
            self._stream = self._container.add_stream(codec, rate=Fraction(RATE))
            self._stream.width, self._stream.height = width, height
            self._stream.pix_fmt = "yuv420p"
            self._stream.bit_rate = 4_000_000
        even = np.ascontiguousarray(picture[:height, :width])
        frame = self._av.VideoFrame.from_ndarray(even, format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        if self._stream is not None:
            self._container.mux(self._stream.encode(None))
        self._container.close()
