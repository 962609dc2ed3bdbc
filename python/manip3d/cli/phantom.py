"""``manip3d phantom render``: what the phantom limb looks like, frame by frame."""

from __future__ import annotations

import itertools
import os
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import closing, contextmanager
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Protocol
from urllib.parse import parse_qs, urlsplit

import numpy as np
import typer

from manip3d.cli.options import Force, Jobs, Json, Output, Quiet
from manip3d.cli.terminal import Terminal, count, refuse_existing
from manip3d.errors import InputError, MissingExtraError
from manip3d.io._files import atomic_folder, atomic_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from manip3d.rgbd import RgbdFrame

    Image = NDArray[np.uint8]

app = typer.Typer(
    name="phantom",
    help="Render a missing limb by mirroring the intact one.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

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
    with atomic_folder(output) as new:
        yield _Folder(new)


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


class LimbName(StrEnum):
    """The person's own left and right."""

    left_arm = "left-arm"
    right_arm = "right-arm"
    left_leg = "left-leg"
    right_leg = "right-leg"


class Mirroring(StrEnum):
    """At the person's plane of symmetry, as printed, or in the image."""

    reflection = "reflection"
    paper = "paper"
    image = "2d"


class Segmenting(StrEnum):
    """By the nearest skin, or by the nearest bone as printed."""

    skin = "skin"
    paper = "paper"


class Smoothing(StrEnum):
    """Presets of the filter of joints."""

    default = "default"
    seated = "seated"
    none = "none"


@app.command("render")
def phantom_render(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="sim:body?amputated=right-arm, mkv:FILE, ..."),
    ],
    output: Output,
    limb: Annotated[
        LimbName | None,
        typer.Option(help="To replace; else the simulated person's, or the right arm."),
    ] = None,
    mode: Annotated[Mirroring, typer.Option(help="How to mirror.")] = Mirroring.reflection,
    segmentation: Annotated[
        Segmenting, typer.Option(help="Of the person among its bones.")
    ] = Segmenting.skin,
    smoothing: Annotated[Smoothing, typer.Option(help="Of the joints.")] = Smoothing.default,
    azimuth: Annotated[float, typer.Option(help="Of the mesh's view, degrees.")] = 35.0,
    frames: Annotated[int, typer.Option(min=0, help="At most so many; 0: all.")] = 0,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
    jobs: Jobs = 0,
) -> None:
    """Draw people with a phantom limb: what was seen, the phantom, the mesh from the side.

    OUT.mp4 is a film; a name without a suffix is a folder of PNG pictures.
    """
    refuse_existing(output, force=force)
    shell = Terminal(as_json=as_json, quiet=quiet)
    record = render(
        source,
        output,
        shell,
        limb=limb.value if limb else None,
        mode=mode.value,
        segmentation=segmentation.value,
        smoothing=smoothing.value,
        azimuth=azimuth,
        frames=frames,
        force=force,
        threads=jobs,
    )
    shell.result(record)
