"""Sets of depth images: the colour image of each, and their common unit."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Hashable, Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import by_number, in_order, path_of
from manip3d.camera import camera_depth_unit
from manip3d.errors import FormatError, InputError
from manip3d.io import DEPTH_SUFFIXES, read_depth_guessing
from manip3d.simplify._depth_words import COMMON_GUESS
from manip3d.simplify._time_stamps import MAX_SECONDS_APART, associate, seconds

_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_IMAGE_SUFFIXES = (*DEPTH_SUFFIXES, ".jpg", ".jpeg", ".bmp", ".ppm", ".webp")
_FRAMES_FOR_A_GUESS = 9
_MOST_SECONDS = 9e9  # greater numbers are dates; nanoseconds of these do not fit 64 bits


@checked
def colors_of_frames(
    frames: Sequence[str | os.PathLike[str]],
    colors: str | os.PathLike[str],
    *,
    name: str = "color",
) -> dict[str, str]:
    """Return the colour image of each depth image.

    The rule is that of `manip3d.capture.open_rgbd`, with the difference that each depth image needs
    a colour image.

    If each depth image has a colour image of the same name (without suffix), they are matched by
    name, and other colour images are ignored. Names are also the same if they differ only in the
    words depth and color: ``1.depth.png``, ``1.color.png``; ``depth_1.png``, ``rgb_1.png``;
    ``1_depth.png``, ``1.jpg``; ``1_depth.npy``, ``1_depth_mask.npy``; or if the same numbers are
    in them: ``img_1.png``, ``0001.jpg``. Numbers are compared by value. Else, if the names are
    times in seconds with a fraction, or in smaller units since 1970, they are paired as those of a
    TUM folder: the most pairs at most 0.02 s apart, each image once, in the order of time, and of
    these the least differences. If they are not, both are sorted by name (numbers in names by their
    value) and matched in order, provided that none has the name of another, or that one is numbered
    from 0, the other from 1, and no number is missing. If only some depth images have a colour
    image of their name, it is an error, as the order would be shifted. Hidden files and files whose
    suffix is not that of an image are ignored.

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
        Names are times, and a depth image has no colour image within 0.02 s; some depth images have
        a colour image of their name and others have not; none has, and there are not as many colour
        images as depth images; or ``name`` is unknown.
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
    found = in_order(path for path in path_of(colors, name).iterdir() if _is_image(path))
    own = {os.path.realpath(path_of(frame, "frames")) for frame in frames}
    images = [path for path in found if os.path.realpath(path) not in own]
    shares_folder = len(images) < len(found)
    named = [path for path in images if _WORDS[name] & set(_words(path.stem))]
    names = sorted((os.fspath(frame) for frame in frames), key=by_number)
    # Beside the depth images, a file without the word for a mask would be a colour image.
    needs_word = shares_folder and name != "color"
    candidates = named if shares_folder else images
    best = _by_name(names, named if needs_word else images, candidates, named, name)
    chosen = [image for image in best if image is not None]
    if len(chosen) < len(frames):
        stamps = [_time_of(Path(frame).stem, "depth") for frame in names]
        times = [_time_of(path.stem, name) for path in candidates]
        if _are_times(stamps) and _are_times(times):
            pairs = associate(stamps, times)
            best = [None if i is None else candidates[i] for i in pairs]
            chosen = _all_of(best, names, f"within {MAX_SECONDS_APART} s", colors, name)
        elif chosen and not _count_from_0_and_1(names, candidates):
            chosen = _all_of(best, names, "by the name", colors, name)
        else:
            chosen = candidates
    if len(chosen) != len(frames):
        raise InputError(
            f"{name}: expected {len(frames)} images in {os.fspath(colors)}, found {len(chosen)}"
            f"{' beside the depth images' if shares_folder else ''}, "
            "not one of each depth image's name"
        )
    return dict(zip(names, map(str, chosen), strict=True))


def _by_name(
    frames: Sequence[str],
    images: Sequence[Path],
    candidates: Sequence[Path],
    named: Sequence[Path],
    kind: str,
) -> list[Path | None]:
    """Return the image of each depth image's name; None: there is none.

    ``named`` are those of the images that have the word for their kind in their names;
    ``candidates`` are those that may have other words than the depth images.
    """
    stems = [Path(frame).stem for frame in frames]
    keys = [_without(_words(stem), "depth") for stem in stems]
    names = [_without(_words(path.stem), kind) for path in named]
    tries = [
        _by_key(keys, named, names),
        _by_key(keys, named, [_without(words, "depth") for words in names]),  # 1_depth_mask
        _by_key(stems, images, [path.stem for path in images]),
        _by_key(keys, images, [_words(path.stem) for path in images]),
        _by_key(
            [_numbers(stem) or stem for stem in stems],
            candidates,
            [_numbers(path.stem) or path.stem for path in candidates],
        ),
    ]
    return max(tries, key=lambda pairs: sum(image is not None for image in pairs))


def _all_of(
    found: Sequence[Path | None],
    names: Sequence[str],
    match: str,
    colors: str | os.PathLike[str],
    name: str,
) -> list[Path]:
    """Return the image of each depth image, and raise if there is none of some."""
    absent = [Path(names[i]).name for i, image in enumerate(found) if image is None]
    if absent:
        listed = ", ".join(absent[:5]) + (", ..." if len(absent) > 5 else "")
        raise InputError(
            f"{name}: expected an image in {os.fspath(colors)} {match} of each depth image, "
            f"found {len(found) - len(absent)} of {len(found)}, none for {listed}"
        )
    return [image for image in found if image is not None]


_WORDS = {
    "depth": {"depth"},
    "color": {"color", "colour", "rgb"},
    "mask": {"mask"},
    "confidence": {"confidence", "conf"},
}
"""Words by which names of files say what an image holds."""
_KINDS = ("color", "mask", "confidence")


_Words = tuple[str | Fraction, ...]


def _words(stem: str) -> _Words:
    """Return the words and the values of the numbers in a name."""
    found = re.findall(rf"[^\W\d_]+|{_NUMBER}", stem.lower())
    return tuple(Fraction(word) if word[0] in "0123456789" else word for word in found)


def _numbers(stem: str) -> tuple[Fraction, ...]:
    return tuple(word for word in _words(stem) if isinstance(word, Fraction))


def _without(words: _Words, kind: str) -> _Words:
    """Return the words of a name without the last one that says what kind the image is of."""
    places = [i for i, word in enumerate(words) if word in _WORDS[kind]]
    return words[: places[-1]] + words[places[-1] + 1 :] if places else words


def maps_by_name(names: Sequence[str]) -> set[str]:
    """Return the names of masks and confidences among those of depth images in a folder.

    Their last word says so (``1_depth_mask.npy``), apart from numbers, and others have the word for
    depth.
    """
    last = {name: _last_word(Path(name).stem) for name in names}
    maps = {name for name in names if last[name] in _WORDS["mask"] | _WORDS["confidence"]}
    has_depth = any("depth" in _words(Path(name).stem) for name in names if name not in maps)
    return maps if has_depth else set()


def _last_word(stem: str) -> str:
    """Return the last word of a name that is no number; empty if there is none."""
    return next((word for word in reversed(_words(stem)) if isinstance(word, str)), "")


def _time_of(stem: str, kind: str) -> float:
    """Return the time in seconds that a name consists of beside its word; NaN if it is no time.

    A time has a fraction, or so many digits that it counts milliseconds or less since 1970.
    """
    numbers = re.findall(_NUMBER, stem)
    others = set(re.findall(r"[^\W\d_]+", stem.lower())) - _WORDS[kind]
    if len(numbers) != 1 or others:
        return math.nan
    (number,) = numbers
    time = seconds(float(number))
    is_time = "." in number or time < float(number)
    return time if is_time and time < _MOST_SECONDS else math.nan


def _count_from_0_and_1(frames: Sequence[str], images: Sequence[Path]) -> bool:
    """Return whether one of two lists is numbered from 0, the other from 1, both without gaps."""
    stems = [Path(frame).stem for frame in frames]
    lists = [[_numbers(stem)[-1:] for stem in each] for each in (stems, [p.stem for p in images])]
    wanted = [[(Fraction(i),) for i in range(first, first + len(frames))] for first in (0, 1)]
    return lists in (wanted, wanted[::-1])


def _are_times(stamps: Sequence[float]) -> bool:
    """Return whether nine of ten are times; others may lie beside them, such as a preview."""
    return len(stamps) > 0 and np.isnan(stamps).mean() <= 0.1


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
