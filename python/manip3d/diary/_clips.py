"""Clips of a diary: storage of pictures in a row of the file, and conversion to a film."""

from __future__ import annotations

import io
import itertools
import os
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from manip3d._util.checked import checked
from manip3d._util.extras import imported
from manip3d._util.paths import legible_path_of, refuse_existing
from manip3d.diary._sealing import seal, unseal
from manip3d.errors import FormatError, InputError
from manip3d.io._files import atomic_folder, refuse_other_files

if TYPE_CHECKING:
    from manip3d.diary._diary import Diary

Pictures = Sequence[tuple[float, bytes]]
"""Time of play in seconds, and JPEG image, of each picture."""

_NOT_IN_NAMES = re.compile(r'[/\\:*?"<>|\x00-\x1f\x7f]')
"""Characters that file names on some system cannot have; names of games can."""
_MARK = b"M3CL\x01\0\0\0"
_PICTURE = struct.Struct("<dI")
MAX_BYTES = 64_000_000


@dataclass(frozen=True)
class Clip:
    """A short film of an anomaly.

    Attributes
    ----------
    at : datetime
        Time at which the game ended.
    game : str
    start, end : float
        Start and end of the anomaly, seconds of play.
    pictures : tuple of (float, bytes)
        Time of play in seconds and JPEG image of each; the first is up to 5 s before ``start``.
    """

    at: datetime
    game: str
    start: float
    end: float
    pictures: tuple[tuple[float, bytes], ...] = field(repr=False)


def pack(pictures: Pictures) -> bytes:
    """Return pictures as one byte string."""
    parts = [_MARK]
    before = -1.0
    for seconds, content in pictures:
        if not 0.0 <= seconds < 1e6 or seconds < before:
            raise InputError(f"clips: expected times that do not fall, got {seconds:g} s")
        if not content.startswith(b"\xff\xd8"):
            raise InputError("clips: expected JPEG images")
        before = seconds
        parts += [_PICTURE.pack(seconds, len(content)), content]
    packed = b"".join(parts)
    if len(packed) > MAX_BYTES:
        raise InputError(f"clips: expected at most {MAX_BYTES} bytes, got {len(packed)}")
    return packed


def unpack(packed: bytes, about: str) -> tuple[tuple[float, bytes], ...]:
    """Return the pictures of a byte string; raise a FormatError if it holds none."""
    found = []
    place = len(_MARK)
    whole = packed.startswith(_MARK)
    while whole and place < len(packed):
        whole = place + _PICTURE.size <= len(packed)
        if whole:
            seconds, size = _PICTURE.unpack_from(packed, place)
            place += _PICTURE.size
            whole = place + size <= len(packed)
            found.append((seconds, packed[place : place + size]))
            place += size
    if not whole:
        raise FormatError(f"{about}: expected the pictures of a clip; the diary is damaged")
    return tuple(found)


def seal_pictures(key: bytes | None, pictures: Pictures, about: str) -> bytes:
    return seal(key, pack(pictures), about)


def unseal_pictures(
    key: bytes | None, sealed: bytes, about: str
) -> tuple[tuple[float, bytes], ...]:
    return unpack(unseal(key, sealed, about), about)


@checked
def film(clip: Clip) -> bytes:
    """Make an animated WebP of a clip, which browsers can show.

    Parameters
    ----------
    clip : Clip

    Returns
    -------
    bytes
        The file, which plays in real time and in a loop.

    Raises
    ------
    InputError
        The clip has no pictures.
    FormatError
        A picture is not an image.
    MissingExtraError
        Pillow is not installed.

    Examples
    --------
    >>> from datetime import UTC, datetime
    >>> from manip3d.diary import Clip, film
    >>> film(Clip(datetime.now(UTC), "piano", 5.0, 20.0, ()))
    Traceback (most recent call last):
        ...
    manip3d.errors.InputError: clip: expected pictures, got none
    """
    if not clip.pictures:
        raise InputError("clip: expected pictures, got none")
    pillow = imported("PIL.Image", "diary")
    images = []
    try:
        for _, content in clip.pictures:
            with pillow.open(io.BytesIO(content), formats=["JPEG"]) as image:
                images.append(image.convert("RGB"))
    except (pillow.UnidentifiedImageError, OSError) as error:
        raise FormatError(f"clip: expected JPEG images: {error}") from error
    times = [seconds for seconds, _ in clip.pictures]
    lasts = [round(1000 * (b - a)) for a, b in itertools.pairwise(times)] + [1000]
    made = io.BytesIO()
    images[0].save(
        made,
        "WEBP",
        save_all=True,
        append_images=images[1:],
        duration=[min(max(one, 20), 2000) for one in lasts],
        loop=0,
        quality=60,
        method=2,
    )
    return made.getvalue()


@checked
def export_clips(
    diary: Diary, output: str | os.PathLike[str], identifier: str, *, overwrite: bool = False
) -> list[Path]:
    """Write the clips of a participant as films (WebP), which are not encrypted.

    Parameters
    ----------
    diary : Diary
    output : path
        Folder to create.
    identifier : str
        Pseudonym of the participant.
    overwrite : bool
        Replace a folder that contains only such films.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        No such participant, the folder exists, or its path has control characters or is not UTF-8.
    OSError
        The folder cannot be written.
    MissingExtraError
        Pillow is not installed.

    Examples
    --------
    >>> from manip3d.diary import Diary, export_clips
    >>> with Diary("clips.diary", create=True) as diary:
    ...     _ = diary.enrol("P01")
    ...     export_clips(diary, "clips", "P01")
    []
    """
    target = legible_path_of(output, "output")
    refuse_existing(target, overwrite=overwrite, name="output")
    refuse_other_files(target, lambda name: is_film_of(identifier, name))
    clips = diary.clips(identifier)
    diary.note_export(identifier)
    names = []
    with atomic_folder(target) as folder:
        for number, clip in enumerate(clips, 1):
            game = _NOT_IN_NAMES.sub("_", clip.game)
            name = f"{identifier}-{clip.at:%Y-%m-%d-%H%M}-{game}-{number:03d}.webp"
            (folder / name).write_bytes(film(clip))
            names.append(target / name)
    diary.note_files(identifier, names)
    return names


def is_film_of(identifier: str, name: str) -> bool:
    """Return whether `export_clips` writes a film of this name for a participant."""
    pattern = rf"{re.escape(identifier)}-\d{{4}}-\d\d-\d\d-\d{{4}}-.*\.webp"
    return bool(re.fullmatch(pattern, name))
