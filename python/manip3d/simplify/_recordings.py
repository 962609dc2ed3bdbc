"""Simplification of the frames of an RGB-D recording, from a camera or file, to mesh files."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d._util.checked import checked
from manip3d._util.options import reporting
from manip3d._util.paths import path_of
from manip3d._util.regular_files import open_regular
from manip3d._util.reprs import short_repr
from manip3d.errors import FormatError, InputError
from manip3d.rgbd import RgbdFrame
from manip3d.simplify._depth_files import DepthInput, frame_alone, from_depth
from manip3d.simplify._depth_inputs import Maps
from manip3d.simplify._depth_options import DepthFileResult, DepthOptions
from manip3d.simplify._depth_sequence import Smoothing

if TYPE_CHECKING:
    from manip3d._util.options import Progress

_SUFFIX = ".glb"
_HEAD_BYTES = 4096  # of a GLB: they contain the name of the program that wrote it
_FRAME_NAME = re.compile(rf"([0-9]{{6}}|[1-9][0-9]{{6,}}){re.escape(_SUFFIX)}")


@dataclass(frozen=True)
class RecordingResult:
    """Results of a recording's frames; see `simplify_recording`.

    Attributes
    ----------
    frames : tuple of DepthFileResult
        One result for each frame that became a mesh; ``source`` is the frame's number.
    failed : mapping of int to str
        Reason why a frame became no mesh, by the frame's number.
    """

    frames: tuple[DepthFileResult, ...]
    failed: Mapping[int, str]

    __repr__ = short_repr


@checked
def simplify_recording(
    frames: Iterable[RgbdFrame],
    output: str | os.PathLike[str],
    options: DepthOptions,
    *,
    stable: bool = False,
    num_frames: int | None = None,
    replace: bool = False,
    progress: Progress = None,
) -> RecordingResult:
    """Turn the frames of an RGB-D recording into sparse textured meshes in a folder.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        A source from `manip3d.capture.open_rgbd`, or any other iterable of frames. A frame's colour
        image becomes the texture. `manip3d.capture.folder_depth` returns the unit of a folder of
        images that no file states.
    output : path-like
        Folder of the meshes, which is created. Files are named by the frames' numbers,
        ``000000.glb``, ...; existing files of these names are replaced. Frames that all have the
        number 0, which is the default, are numbered by their places.
    options : DepthOptions
        Options without camera and unit, which the frames contain.
    stable : bool
        Process all frames by one `ReliefStream` (method ``relief``), so that static surfaces have
        the same mesh in every frame.
    num_frames : int, optional
        Stop after this many frames.
    replace : bool
        Remove the meshes of an earlier run: at the end, files in the folder that have the name of
        a frame, and that this run did not write, are removed. All other files stay.
    progress : None, True or callable
        ``True`` shows a bar; a callable gets ``(fraction, message)``. The fraction is 0 if the
        number of frames is unknown.

    Returns
    -------
    RecordingResult
        The results. A frame without a surface, such as the first ones of some cameras, is left out
        and listed in ``failed``.

    Raises
    ------
    InputError
        ``options`` with a camera, a unit or a bandwidth, ``stable`` with another method than
        ``relief``, ``num_frames`` below 1, no frame, or two frames of one number. Meshes that were
        written stay.
    FormatError
        The recording is damaged, or no frame has a surface. Meshes that were written stay.
    OSError
        A mesh cannot be written, or not removed.

    Examples
    --------
    >>> from manip3d import capture, simplify
    >>> with capture.open_rgbd("sim:body?frames=2") as person:
    ...     made = simplify.simplify_recording(person, "meshes", simplify.DepthOptions(500))
    >>> [result.output.name for result in made.frames]
    ['000000.glb', '000001.glb']
    >>> all(result.coverage > 0.9 for result in made.frames)
    True
    """
    if options.intrinsics or options.unit != "guess":
        raise InputError("options: expected neither intrinsics nor unit, which the frames bring")
    if options.ray_depth:
        raise InputError("ray_depth: can only be given with a depth image, got a recording")
    if options.bandwidth is not None:
        raise InputError("options: expected points or ratio, and no bandwidth")
    if stable and options.method != "relief":
        raise InputError(f"stable: expected method relief, got {options.method}")
    if num_frames is not None and num_frames < 1:
        raise InputError(f"num_frames: expected at least 1, got {num_frames}")
    folder = path_of(output, "output")
    take = Smoothing().take if stable else frame_alone
    total = num_frames if num_frames is not None else getattr(frames, "num_frames", None)
    done: list[DepthFileResult] = []
    failed: dict[int, str] = {}
    with reporting(progress, "simplify") as report:
        for count, (number, frame) in enumerate(_with_numbers(frames), 1):
            folder.mkdir(parents=True, exist_ok=True)
            name = f"{number:06}"
            maps = Maps(frame.color, registration=frame.calibration.registration)
            image = DepthInput(frame.depth, frame.calibration.depth, maps, Path(name), unit="mm")
            try:
                done.append(from_depth(image, folder / f"{name}{_SUFFIX}", options, take))
            except FormatError as error:
                failed[number] = error.reason
            if report is not None:
                report(min(1.0, count / total) if total else 0.0)
            if count == num_frames:
                break
    if not done and failed:
        number, reason = next(iter(failed.items()))
        raise FormatError(
            f"expected a surface in at least one frame, found none in {len(failed)}; "
            f"frame {number}: "
            f"{reason}"
        )
    if not done:
        raise InputError("frames: expected at least one, got none")
    if replace:
        _remove_others(folder, {result.output.name for result in done})
    return RecordingResult(tuple(done), failed)


def _with_numbers(frames: Iterable[RgbdFrame]) -> Iterator[tuple[int, RgbdFrame]]:
    """Yield each frame after its number, or after its place as long as all have the number 0."""
    taken: set[int] = set()
    are_numbered = False
    num_zeros = 0  # frames of number 0 that have their place as number
    for place, frame in enumerate(frames):
        are_numbered = are_numbered or frame.number != 0
        if not are_numbered:
            num_zeros += 1
        elif num_zeros > 1:
            raise InputError("frames: expected one frame of each number, got two of 0")
        number = frame.number if are_numbered else place
        if number in taken:
            raise InputError(f"frames: expected one frame of each number, got two of {number}")
        taken.add(number)
        yield number, frame


def _remove_others(folder: Path, written: set[str]) -> None:
    """Remove frames of earlier runs: files that manip3d wrote, under other numbers of frames."""
    for path in sorted(folder.iterdir()):
        if not _FRAME_NAME.fullmatch(path.name) or path.name in written or not path.is_file():
            continue
        with open_regular(path) as file:
            head = file.read(_HEAD_BYTES)
        if head.startswith(b"glTF") and b'"generator":"manip3d ' in head:
            path.unlink()
