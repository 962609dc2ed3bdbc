"""Reader of motion files in Biovision's BVH format: a skeleton, and its joint angles per frame."""

from __future__ import annotations

import codecs
import math
import os
import re
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from manip3d._util.checked import checked
from manip3d._util.paths import path_of
from manip3d._util.reprs import short_repr
from manip3d._util.texts import float_or_nan
from manip3d.errors import FormatError, InputError
from manip3d.io._files import over_max_bytes, regular_bytes
from manip3d.io._limits import byte_limit, check_points, clock

Floats = NDArray[np.float64]

MAX_BYTES = 1 << 26
"""Largest size of a motion file, in bytes."""

MAX_JOINTS = 1024
"""Largest number of joints of a skeleton; motion capture of bodies with hands has about 100."""

_MAX_FRAMES = 1 << 24  # largest number of frames of a motion
_FARTHEST = 1e9  # largest offset or channel value; sums of larger ones lose their decimals
_MAX_WORD = 256  # largest length of a word in bytes; names of joints have at most about 50
_MAX_NAME_WORDS = 16  # largest number of words of a joint's name, which usually has one
_MAX_DIGITS = 11  # of a whole number; all limits of whole numbers have fewer
# Number of bytes of channel values that are split into words at a time: enough to be fast, while
# the words, each of which is an object, need little memory however long a line is.
_PIECE_BYTES = 1 << 16
# Number of frames times joints for which rotations are held at a time, 72 bytes each.
_MAX_ROTATIONS = 1 << 20
_WORD, _GAP, _LINE_END = (re.compile(each) for each in (rb"\S+", rb"\s", rb"\r\n?|\n"))
_CHANNELS = {
    f"{axis}{kind}".lower(): (number, kind == "rotation")
    for kind in ("position", "rotation")
    for number, axis in enumerate("XYZ")
}


@checked
@dataclass(frozen=True, eq=False)
class Motion:
    """Positions of the joints of a skeleton over time.

    Attributes
    ----------
    names : tuple of str
        Names of the J joints, in the order of the file; End Sites are left out.
    parents : tuple of int
        Index of each joint's parent; -1 for the root.
    positions : (T, J, 3) float64
        Positions in T frames, in the file's own unit; y is up in nearly all files.
    frame_s : float
        Seconds from frame to frame.

    Raises
    ------
    InputError
        The sizes do not agree, a position is not finite, or ``frame_s`` is not positive.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    positions: NDArray[np.float64] = field(repr=False)
    frame_s: float

    __repr__ = short_repr

    def __post_init__(self) -> None:
        joints = len(self.names)
        if self.positions.ndim != 3 or self.positions.shape[1:] != (joints, 3):
            raise InputError(
                f"positions: expected shape (T, {joints}, 3), got {self.positions.shape}"
            )
        if not len(self.positions) or not np.isfinite(self.positions).all():
            raise InputError("positions: expected finite numbers of at least one frame")
        if len(self.parents) != joints:
            raise InputError(f"parents: expected {joints}, got {len(self.parents)}")
        if not 0.0 < self.frame_s < math.inf:
            raise InputError(f"frame_s: expected > 0, got {self.frame_s}")

    def __len__(self) -> int:
        return len(self.positions)


@dataclass
class _Joint:
    name: str
    parent: int
    offset: tuple[float, ...] = ()
    channels: tuple[str, ...] | None = None


@checked
def read_bvh(path: str | os.PathLike[str]) -> Motion:
    """Read a motion from a BVH file.

    Parameters
    ----------
    path : path-like
        A file with one ROOT, and with at least one channel for each joint, in any order. The
        numbers of a frame may be spread over several lines.

    Returns
    -------
    Motion
        Joint positions of all frames.

    Raises
    ------
    FormatError
        The file is not a BVH file, is damaged (the error names the line), or is larger than 64 MiB
        or than `ReadLimits` allow.
    OSError
        The file cannot be read.

    Notes
    -----
    A joint's coordinate frame is that of its parent, moved by OFFSET and by its position channels,
    and rotated by its rotation channels in the order of the file [M. Meredith and S. Maddock,
    "Motion Capture File Formats Explained", Sheffield 2001]. A position channel of the root
    replaces its OFFSET along that axis; those of other joints are added to it.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from manip3d.io import read_bvh
    >>> text = '''HIERARCHY
    ... ROOT Hips { OFFSET 0 0 0 CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation
    ...   Yrotation JOINT Head { OFFSET 0 60 0 CHANNELS 3 Zrotation Xrotation Yrotation
    ...   End Site { OFFSET 0 20 0 } } }
    ... MOTION
    ... Frames: 1
    ... Frame Time: 0.0333
    ... 0 90 0 90 0 0 0 0 0'''
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = (Path(folder) / "bow.bvh").write_text(text)
    ...     motion = read_bvh(Path(folder) / "bow.bvh")
    >>> motion.names, motion.positions[0, 1].round(3).tolist()
    (('Hips', 'Head'), [-60.0, 90.0, 0.0])
    """
    name = str(path)
    size, limit = os.stat(path_of(path)).st_size, byte_limit(None)
    if limit and size > limit:
        raise FormatError(over_max_bytes(limit), file=name)
    if size > MAX_BYTES:
        raise FormatError(f"expected at most {MAX_BYTES} bytes, got {size}", file=name)
    with clock(name) as look:
        reader = _Reader(regular_bytes(path_of(path)), name, look)
        joints = _hierarchy(reader)
        count, frame_s = _header(reader)
        check_points(count * len(joints), name)
        values = _numbers(reader, count, sum(len(j.channels or ()) for j in joints))
        return Motion(
            tuple(joint.name for joint in joints),
            tuple(joint.parent for joint in joints),
            _positions(joints, values),
            frame_s,
        )


class _Reader:
    """Tokenizer: yields the words of a file in order; errors name the line of the last word."""

    def __init__(self, data: bytes, file: str, look: Callable[[float], None] | None) -> None:
        self._data = data.removeprefix(codecs.BOM_UTF8).rstrip()
        self._file = file
        self._look = look  # raises FormatError when a time limit is exceeded; None without one
        self._end = 0  # of the last word

    def fail(self, reason: str) -> FormatError:
        line_ends = sum(1 for _ in _LINE_END.finditer(self._data, 0, self._end))
        return FormatError(reason, file=self._file, line=1 + line_ends)

    def word(self, expected: str) -> str:
        """Return the next word."""
        if self._look is not None:
            self._look(self._end / max(1, len(self._data)))
        found = _WORD.search(self._data, self._end)
        if found is None:
            raise self.fail(f"expected {expected}, found the end of the file")
        self._end = found.end()
        if (size := found.end() - found.start()) > _MAX_WORD:
            raise self.fail(f"expected {expected}, got a word of {size} bytes")
        return found.group().decode("utf-8", "surrogateescape")

    def expect(self, *words: str) -> None:
        """Read the given words, and raise if the file has others."""
        for wanted in words:
            if (got := self.word(wanted)).lower() != wanted.lower():
                raise self.fail(f"expected {wanted}, got {got!r}")

    def number(self, expected: str) -> float:
        """Read a number of at most `_FARTHEST` in size."""
        got = self.word(expected)
        value = float_or_nan(got)
        if not abs(value) <= _FARTHEST:  # also raises on NaN
            raise self.fail(f"expected {expected}, got {got!r}")
        return value

    def whole(self, expected: str, low: int, high: int) -> int:
        """Read an integer from ``low`` to ``high``."""
        got = self.word(expected)
        if not (
            got.isascii() and got.isdigit() and len(got) <= _MAX_DIGITS and low <= int(got) <= high
        ):
            raise self.fail(f"expected {expected}, {low} to {high}, got {got!r}")
        return int(got)

    def pieces(self) -> Iterator[list[bytes]]:
        """Yield the words of the rest of the file, a piece of the file at a time.

        While a piece is used, the reader stays at its beginning, see `skip`.
        """
        while self._end < len(self._data):
            if self._look is not None:
                self._look(self._end / len(self._data))
            gap = _GAP.search(self._data, self._end + _PIECE_BYTES)
            end = gap.start() if gap else len(self._data)
            yield self._data[self._end : end].split()
            self._end = end

    def skip(self, count: int) -> str:
        """Skip words of any length, and return the next one, so that an error names its line."""
        found = next(islice(_WORD.finditer(self._data, self._end), count, None))
        self._end = found.end()
        return found.group().decode("utf-8", "surrogateescape")


def _hierarchy(reader: _Reader) -> list[_Joint]:
    """Read the joints in the order of the file, each after its parent."""
    reader.expect("HIERARCHY", "ROOT")
    joints: list[_Joint] = []
    open_: list[int] = []  # numbers of the joints whose braces are open
    _begin(reader, joints, open_)
    while open_:
        joint = joints[open_[-1]]
        word = reader.word("OFFSET, CHANNELS, JOINT, End Site or }")
        match word.lower():
            case "offset" if not joint.offset:
                joint.offset = tuple(reader.number("three numbers of an OFFSET") for _ in range(3))
            case "channels" if joint.channels is None:
                joint.channels = _channels(reader)
            case "joint":
                _begin(reader, joints, open_)
            case "end":
                reader.expect("Site", "{", "OFFSET")
                for _ in range(3):
                    reader.number("three numbers of an OFFSET")
                reader.expect("}")
            case "}" if joint.offset and joint.channels:
                open_.pop()
            case "}":
                missing = "CHANNELS" if joint.offset else "OFFSET"
                raise reader.fail(f"expected {missing} of the joint {joint.name}, found none")
            case _:
                raise reader.fail(f"expected OFFSET, CHANNELS, JOINT, End Site or }}, got {word!r}")
    return joints


def _begin(reader: _Reader, joints: list[_Joint], open_: list[int]) -> None:
    """Read the name of a joint, which may contain spaces, and the opening brace; add the joint."""
    words = [reader.word("a joint's name")]
    while (word := reader.word("{")) != "{":
        words.append(word)
        if len(words) > _MAX_NAME_WORDS:
            raise reader.fail("expected { behind a joint's name")
    if words[0] == "{":
        raise reader.fail("expected a joint's name, got '{'")
    if len(joints) >= MAX_JOINTS:
        raise reader.fail(f"expected at most {MAX_JOINTS} joints")
    joints.append(_Joint(" ".join(words), open_[-1] if open_ else -1))
    open_.append(len(joints) - 1)


def _channels(reader: _Reader) -> tuple[str, ...]:
    count = reader.whole("the number of CHANNELS", 1, len(_CHANNELS))
    names = tuple(reader.word("a channel").lower() for _ in range(count))
    for name in names:
        if name not in _CHANNELS or names.count(name) > 1:
            raise reader.fail(f"expected different channels such as Xrotation, got {name!r}")
    return names


def _header(reader: _Reader) -> tuple[int, float]:
    """Read the number of frames, and the seconds from one to the next."""
    word = reader.word("MOTION")
    if word.lower() == "root":
        raise reader.fail("expected MOTION, got a second ROOT: one person a file")
    if word.lower() != "motion":
        raise reader.fail(f"expected MOTION, got {word!r}")
    reader.expect("Frames:")
    count = reader.whole("the number of frames", 1, _MAX_FRAMES)
    reader.expect("Frame", "Time:")
    frame_s = reader.number("the time of a frame")
    if not 1e-6 <= frame_s <= 3600.0:
        raise reader.fail(f"expected a time of a frame in seconds, got {frame_s:g}")
    return count, frame_s


def _numbers(reader: _Reader, frames: int, channels: int) -> Floats:
    """Read the channel values, (frames, channels).

    Memory is allocated for the numbers that the file holds, not for the number that it claims.
    """
    total = frames * channels
    found = array("d")
    for words in reader.pieces():
        values = np.array([float_or_nan(word.decode("latin-1")) for word in words])
        is_good = np.abs(values) <= _FARTHEST  # not NaN
        is_good[total - len(found) :] = False
        if not is_good.all():
            num_good = int(np.argmin(is_good))
            word = reader.skip(num_good)
            if len(found) + num_good < total:
                raise reader.fail(f"expected a number, got {word[:40]!r}")
            raise reader.fail(f"expected {frames} frames of {channels} numbers, found more")
        found.frombytes(values.tobytes())
    if len(found) != total:
        raise reader.fail(
            f"expected {frames} frames of {channels} numbers, found {len(found)} numbers"
        )
    return np.frombuffer(found).reshape(frames, channels)


def _positions(joints: list[_Joint], values: Floats) -> Floats:
    """Return positions (T, J, 3); rotations are held for some of the frames at a time."""
    positions = np.empty((len(values), len(joints), 3))
    step = max(1, _MAX_ROTATIONS // len(joints))
    for start in range(0, len(values), step):
        _place(joints, values[start : start + step], positions[start : start + step])
    return positions


def _place(joints: list[_Joint], values: Floats, positions: Floats) -> None:
    """Fill positions (T, J, 3) by forward kinematics, from the root outwards."""
    rotations: list[Floats] = []
    column = 0
    for number, joint in enumerate(joints):
        translation = np.tile(joint.offset, (len(values), 1))
        rotation = np.tile(np.eye(3), (len(values), 1, 1))
        for channel in joint.channels or ():
            axis, is_rotation = _CHANNELS[channel]
            if is_rotation:
                rotation = _rotated(rotation, axis, values[:, column])
            elif joint.parent < 0:
                translation[:, axis] = values[:, column]
            else:
                translation[:, axis] += values[:, column]
            column += 1
        if joint.parent < 0:
            positions[:, number] = translation
        else:
            parent_rotation = rotations[joint.parent]
            moved = np.einsum("tij,tj->ti", parent_rotation, translation)
            positions[:, number] = positions[:, joint.parent] + moved
            rotation = np.einsum("tij,tjk->tik", parent_rotation, rotation)
        rotations.append(rotation)


def _rotated(rotation: Floats, axis: int, degrees: Floats) -> Floats:
    """Return rotations (T, 3, 3), each times a rotation by ``degrees`` about its own ``axis``."""
    angle = np.deg2rad(degrees)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    i, j = (axis + 1) % 3, (axis + 2) % 3
    result = rotation.copy()
    result[:, :, i] = rotation[:, :, i] * cosine + rotation[:, :, j] * sine
    result[:, :, j] = rotation[:, :, j] * cosine - rotation[:, :, i] * sine
    return result
