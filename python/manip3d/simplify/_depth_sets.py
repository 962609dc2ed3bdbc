"""Sets of depth images: the colour image of each, and their common unit."""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from manip3d._util.checked import checked
from manip3d._util.paths import by_number, has_decimals, in_order, is_hidden, path_of
from manip3d.camera import camera_depth_unit
from manip3d.errors import FormatError, InputError
from manip3d.io import DEPTH_SUFFIXES, read_depth_guessing
from manip3d.simplify._depth_inputs import read_frame
from manip3d.simplify._depth_options import DepthOptions
from manip3d.simplify._depth_words import COMMON_GUESS, DepthFound
from manip3d.simplify._time_stamps import MAX_SECONDS_APART, associate, seconds

_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_IMAGE_SUFFIXES = (*DEPTH_SUFFIXES, ".jpg", ".jpeg", ".bmp", ".ppm", ".webp")
_FRAMES_FOR_A_GUESS = 9  # the most frequent guess among these counts
_LEAST_EPOCH = 10**9  # the year 2001 in seconds since 1970: greater numbers are no frame numbers
_MOST_FRAMES = 90_000_000  # a longer range is one of times: these are five weeks at 30 Hz
_Frame = TypeVar("_Frame")
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
    a colour image, and that depth images may be a selection: any number of colour images may be
    left over.

    If each depth image has a colour image of the same name (without suffix), they are matched by
    name, and other colour images are ignored. Names are also the same if they differ only in the
    words depth and color: ``1.depth.png``, ``1.color.png``; ``depth_1.png``, ``rgb_1.png``;
    ``1_depth.png``, ``1.jpg``; ``1_depth.npy``, ``1_depth_mask.npy``; or if the same numbers are
    in them: ``img_1.png``, ``0001.jpg``. Numbers are compared by value. Else, if the names are
    times in seconds with a fraction, or in smaller units since 1970, they are paired as those of a
    TUM folder: the most pairs at most 0.02 s apart, each image once, in the order of time, and of
    these the least differences. If they are not, both are sorted by name (numbers in names by their
    value) and matched in order, provided that none has the name of another; that one in ten has at
    most, and the numbers are no frame numbers (milliseconds, say); or that both are counted without
    gaps, from the same number, or one from 0, the other from 1 (by the first or the last number
    that changes from name to name). If only some depth images have a colour image of their name, it
    is an error otherwise, as the order would be shifted. Numbers with a point are decimals if they
    are as fine as times, or else two whole numbers (1.9, 1.10). Hidden files and files whose suffix
    is not that of an image are ignored.

    If ``colors`` also holds the depth images, these are left out, and only images with such a word
    in their names are matched in order. Masks and confidences then need their word in any case.

    Parameters
    ----------
    frames : sequence of path-like
    colors : path-like
        Folder of the colour images; or masks, or confidences.
    name : str
        Kind of the images, and the argument's name in errors: ``color`` (words in names: color,
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
    names = [os.fspath(frame) for frame in frames]
    names.sort(key=by_number(names))
    # Beside the depth images, a file without the word for a mask would be a colour image.
    needs_word = shares_folder and name != "color"
    candidates = named if shares_folder else images
    files = [Path(frame) for frame in names]
    stem = _stems_of([*files, *candidates])
    best = _by_name(files, named if needs_word else images, candidates, named, name, stem)
    chosen = [image for image in best if image is not None]
    if len(chosen) < len(frames):
        stamps = [_time_of(each, "depth") for each in map(_stems_of(files), files)]
        times = [_time_of(each, name) for each in map(_stems_of(candidates), candidates)]
        if _are_times(stamps) and _are_times(times):
            pairs = associate(stamps, times)
            best = [None if i is None else candidates[i] for i in pairs]
            chosen = _all_of(best, names, f"within {MAX_SECONDS_APART} s", colors, name)
        elif chosen and not _have_one_order(
            [stem(path) for path in files], [stem(path) for path in candidates], len(chosen)
        ):
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


def _stems_of(paths: Sequence[Path]) -> Callable[[Path], str]:
    """Return the function that gives the name of one of these paths, without its suffix.

    Unless they are decimals, numbers with a point become two numbers.
    """
    if has_decimals(path.stem for path in paths):
        return lambda path: path.stem
    return lambda path: re.sub(r"(?<=[0-9])\.(?=[0-9])", " ", path.stem)


def _by_name(
    frames: Sequence[Path],
    images: Sequence[Path],
    candidates: Sequence[Path],
    named: Sequence[Path],
    kind: str,
    stem: Callable[[Path], str],
) -> list[Path | None]:
    """Return the image of each depth image's name; None: there is none.

    ``named`` are those of the images that have the word for their kind in their names;
    ``candidates`` are those that may have other words than the depth images.
    """
    stems = [stem(frame) for frame in frames]
    keys = [_without(_words(each), "depth") for each in stems]
    names = [_without(_words(stem(path)), kind) for path in named]
    tries = [
        _by_key(keys, named, names),
        _by_key(keys, named, [_without(words, "depth") for words in names]),  # 1_depth_mask
        _by_key(stems, images, [stem(path) for path in images]),
        _by_key(keys, images, [_words(stem(path)) for path in images]),
        _by_key(
            [_numbers(each) or each for each in stems],
            candidates,
            [_numbers(stem(path)) or stem(path) for path in candidates],
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


def keys_of_name(stem: str) -> tuple[Hashable, Hashable, Hashable]:
    """Return what two names of one frame may have in common, the strictest first.

    It is the whole name, its words without those for depth and colour, and its numbers.
    """
    words = _without(_without(_words(stem), "depth"), "color")
    return stem, words or stem, _numbers(stem) or stem


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


def _have_one_order(stems: Sequence[str], others: Sequence[str], agreeing: int) -> bool:
    """Return whether two lists are in the same order although few names agree.

    The rule is that of ``have_one_order`` in cpp/src/capture/image_names.cpp.
    """
    if len(stems) != len(others):
        return False
    last = _ascending_numbers(stems, -1), _ascending_numbers(others, -1)
    first = _ascending_numbers(stems, 1), _ascending_numbers(others, 1)
    have_others = all(last) and not all(map(_are_frame_numbers, last))
    few = have_others and 10 * agreeing <= len(stems)
    return few or _are_counted_alike(*last) or _are_counted_alike(*first)


def _ascending_numbers(stems: Sequence[str], step: int) -> list[int]:
    """Return the first (step 1) or last (-1) number that is not the same in all names.

    Others are a date or a size. Empty: a name has none that is below 1e9, or they do not ascend.
    """
    places = list(zip(*(_numbers(stem)[::step] for stem in stems), strict=False))
    changing = [place for place in places if len(set(place)) > 1] or places[-1:]
    numbers = [int(number) for number in changing[0]] if changing else []
    ascend = all(a < b for a, b in pairwise(numbers))
    return numbers if ascend and numbers and numbers[-1] < _LEAST_EPOCH else []


def _are_frame_numbers(numbers: Sequence[int]) -> bool:
    """Return whether ascending numbers are those of frames, of which some may be lost."""
    steps = [b - a for a, b in pairwise(numbers)]
    if not steps:
        return False
    step = min(steps)
    is_usual = 2 * steps.count(step) > len(steps)
    is_short = (numbers[-1] - numbers[0]) // step < _MOST_FRAMES
    return is_usual and is_short and all(each % step == 0 for each in steps)


def _are_counted_alike(a: Sequence[int], b: Sequence[int]) -> bool:
    """Return whether both are counted in steps of 1, from the same number, or from 0 and 1."""
    if not a or not b:
        return False
    have_no_gaps = all(each[-1] == each[0] + len(each) - 1 for each in (a, b))
    return have_no_gaps and (a[0] == b[0] or {a[0], b[0]} == {0, 1})


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
    return path.suffix.lower() in _IMAGE_SUFFIXES and not is_hidden(path.name) and path.is_file()


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
    for frame in _some(frames):
        try:
            guesses[read_depth_guessing(frame).unit] += 1
        except (FormatError, OSError):  # reported when that frame is simplified
            continue
    return guesses.most_common(1)[0][0] if guesses else "guess"


def _some(frames: Sequence[_Frame]) -> list[_Frame]:
    """Return up to nine evenly spaced frames."""
    numbers = np.linspace(0, len(frames) - 1, min(len(frames), _FRAMES_FOR_A_GUESS))
    return [frames[int(number)] for number in numbers]


def common_guess(
    frames: Sequence[str | os.PathLike[str]], unit: str = "guess", intrinsics: str = ""
) -> str:
    """Return `common_depth_unit`, marked as a guess (`COMMON_GUESS`) if it is one."""
    found = common_depth_unit(frames, unit, intrinsics)
    return f"{COMMON_GUESS}{found}" if unit == "guess" != found else found


def depths_of_some(images: Sequence[Path], options: DepthOptions) -> list[DepthFound]:
    """Return what up to nine depth images of one camera hold, all in one unit.

    Images that cannot be read are left out, since their own turn reports them.
    """
    unit = common_guess(images, options.unit, options.intrinsics)
    found = []
    for image in _some(images):
        try:
            reading, camera, _, doubt = read_frame(image, replace(options, unit=unit))
        except (FormatError, OSError):
            continue
        found.append(DepthFound.of(reading, doubt, camera))
    return found
