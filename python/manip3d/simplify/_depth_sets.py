"""Sets of depth images: the colour image of each, and their common unit."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Hashable, Sequence
from pathlib import Path

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import by_number, path_of
from manip3d.camera import camera_depth_unit
from manip3d.errors import FormatError, InputError
from manip3d.io import DEPTH_SUFFIXES, read_depth_guessing
from manip3d.simplify._depth_words import COMMON_GUESS

_IMAGE_SUFFIXES = (*DEPTH_SUFFIXES, ".jpg", ".jpeg", ".bmp", ".ppm", ".webp")
_FRAMES_FOR_A_GUESS = 9


@checked
def colors_of_frames(
    frames: Sequence[str | os.PathLike[str]],
    colors: str | os.PathLike[str],
    *,
    name: str = "color",
) -> dict[str, str]:
    """Return the colour image of each depth image.

    If each depth image has a colour image of the same name (without suffix), they are matched by
    name, and other colour images are ignored. Names are also the same if they differ only in the
    words depth and color: ``1.depth.png``, ``1.color.png``; ``depth_1.png``, ``rgb_1.png``;
    ``1_depth.png``, ``1.jpg``. If less than half of the depth images have such a colour image, both
    are sorted by name (numbers in names by their value) and matched in order; if half or more have,
    but not all, it is an error, as the order would be shifted. Hidden files and files whose suffix
    is not that of an image are ignored.

    If ``colors`` also holds the depth images, these are left out, and only images with such a word
    in their names are matched in order. Masks and confidences then need their word in any case.

    Parameters
    ----------
    frames : sequence of path-like
    colors : path-like
        Folder of the colour images; or masks, or confidences.
    name : str
        What the images are, and the argument's name in errors: ``color`` (words in names: color,
        colour, rgb), ``mask`` (mask) or ``confidence`` (confidence, conf).

    Returns
    -------
    dict of str to str
        The colour image of each depth image.

    Raises
    ------
    InputError
        Half or more of the depth images have a colour image of their name and others have not; less
        than half have, and there are not as many colour images as depth images; or ``name`` is
        unknown.
    OSError
        The folder cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from manip3d import simplify
    >>> Path("colors").mkdir()
    >>> Path("colors", "a.jpg").touch()
    >>> Path("colors", "b.jpg").touch()
    >>> simplify.colors_of_frames(["d1.png", "d2.png"], "colors")
    {'d1.png': 'colors/a.jpg', 'd2.png': 'colors/b.jpg'}
    """
    if name not in _KINDS:
        raise InputError(f"name: expected one of {', '.join(_KINDS)}, got {name!r}")
    found = [path for path in path_of(colors, name).iterdir() if _is_image(path)]
    found.sort(key=lambda path: by_number(path.name))
    own = {os.path.realpath(path_of(frame, "frames")) for frame in frames}
    images = [path for path in found if os.path.realpath(path) not in own]
    shares_folder = len(images) < len(found)
    named = [path for path in images if _without(path.stem, name) != _words(path.stem)]
    names = sorted((os.fspath(frame) for frame in frames), key=by_number)
    keys = [_without(Path(frame).stem, "depth") for frame in names]
    tries = [_by_key(keys, named, [_without(path.stem, name) for path in named])]
    if name == "color" or not shares_folder:
        # Beside the depth images, a file without the word for a mask would be a colour image.
        stems = [Path(frame).stem for frame in names]
        tries.append(_by_key(stems, images, [path.stem for path in images]))
        tries.append(_by_key(keys, images, [_words(path.stem) for path in images]))
    best = max(tries, key=lambda pairs: sum(image is not None for image in pairs))
    chosen = [image for image in best if image is not None]
    if 2 * len(chosen) < len(frames):
        chosen = []  # time stamps agree by chance
    if 0 < len(chosen) < len(frames):
        absent = [Path(names[i]).name for i, image in enumerate(best) if image is None]
        listed = ", ".join(absent[:5]) + (", ..." if len(absent) > 5 else "")
        raise InputError(
            f"{name}: expected an image in {os.fspath(colors)} by the name of each depth image, "
            f"found {len(chosen)} of {len(frames)}, none for {listed}"
        )
    if not chosen:
        chosen = named if shares_folder else images
    if len(chosen) != len(frames):
        raise InputError(
            f"{name}: expected {len(frames)} images in {os.fspath(colors)}, found {len(chosen)}"
            f"{' beside the depth images' if shares_folder else ''}, "
            "not one of each depth image's name"
        )
    return dict(zip(names, map(str, chosen), strict=True))


_WORDS = {
    "depth": {"depth"},
    "color": {"color", "colour", "rgb"},
    "mask": {"mask"},
    "confidence": {"confidence", "conf"},
}
"""Words by which names of files say what an image holds."""
_KINDS = ("color", "mask", "confidence")


def _words(stem: str) -> tuple[str, ...]:
    return tuple(re.findall(r"[^\W\d_]+|\d+", stem.lower()))


def _without(stem: str, kind: str) -> tuple[str, ...]:
    """Return the words of a name without the last one that says what kind the image is of."""
    words = _words(stem)
    places = [i for i, word in enumerate(words) if word in _WORDS[kind]]
    return words[: places[-1]] + words[places[-1] + 1 :] if places else words


def _by_key(
    wanted: Sequence[Hashable], images: Sequence[Path], keys: Sequence[Hashable]
) -> list[Path | None]:
    """Return the image of each key; None for a key that is wanted twice or has not one image."""
    image_of, times, uses = dict(zip(keys, images, strict=True)), Counter(keys), Counter(wanted)
    return [image_of[key] if times[key] == uses[key] == 1 else None for key in wanted]


def _is_image(path: Path) -> bool:
    return (
        path.suffix.lower() in _IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()
    )


@checked
def common_depth_unit(
    frames: Sequence[str | os.PathLike[str]], unit: str = "guess", intrinsics: str = ""
) -> str:
    """Return the unit that most depth images seem to have, to use for all of them.

    Parameters
    ----------
    frames : sequence of path-like or URL
        Depth images of one camera. Up to nine of them, evenly spaced, are read.
    unit : str
        Returned as it is unless it is ``"guess"``.
    intrinsics : str
        If this camera (a preset or a file) states a unit, ``"guess"`` is returned: each image is
        then read with the camera's unit.

    Returns
    -------
    str
        A unit as `manip3d.io.read_depth_guessing` takes it.

    Raises
    ------
    OSError
        A file cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from manip3d import simplify
    >>> np.save("a.npy", np.full((48, 64), 2000, np.uint16))
    >>> simplify.common_depth_unit(["a.npy"])
    'mm'
    """
    if unit != "guess" or camera_depth_unit(intrinsics) != "guess":
        return unit
    guesses: Counter[str] = Counter()
    for number in np.linspace(0, len(frames) - 1, min(len(frames), _FRAMES_FOR_A_GUESS)):
        try:
            guesses[read_depth_guessing(frames[int(number)]).unit] += 1
        except (FormatError, OSError):  # reported when that frame is simplified
            continue
    return guesses.most_common(1)[0][0] if guesses else "guess"


def common_guess(
    frames: Sequence[str | os.PathLike[str]], unit: str = "guess", intrinsics: str = ""
) -> str:
    """Return `common_depth_unit`, marked as a guess (`COMMON_GUESS`) if it is one."""
    found = common_depth_unit(frames, unit, intrinsics)
    return f"{COMMON_GUESS}{found}" if unit == "guess" != found else found
