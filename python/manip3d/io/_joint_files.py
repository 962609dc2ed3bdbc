"""Readers of the joints that NTU RGB+D, OpenPose, COCO, Azure Kinect and tables have in files."""

from __future__ import annotations

import codecs
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, islice
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from manip3d._util.csv_tables import csv_rows
from manip3d._util.paths import is_hidden
from manip3d._util.texts import float_or_nan
from manip3d.errors import FormatError
from manip3d.io._files import limited_bytes
from manip3d.rgbd import INFERRED, JOINTS, NOT_TRACKED, TRACKED

MAX_PEOPLE = 64
"""Largest number of people in a frame, as in recordings of this library."""

_MAX_BYTES = 1 << 28  # of a file; an hour of one person in NTU RGB+D has 300 MB at most
_MAX_FRAME_BYTES = 1 << 22  # of a file of OpenPose, which holds one frame
_MAX_FRAMES = 1 << 20  # files of OpenPose in a folder
_FARTHEST_M = 1000.0  # larger coordinates are errors of unit
_NEAREST_M = 0.05  # median depth of joints; smaller ones are errors of unit, too
_LARGEST = 2.0**62  # of numbers of people and frames
_OPENPOSE_ENDING = "_keypoints.json"
_OPENPOSE = 25  # joints of its model BODY_25
_AZURE = 32  # joints of the Azure Kinect
_COCO = {17: "coco", 133: "coco-wholebody"}
_PARTS = (("keypoints", 17), ("foot_kpts", 6), ("face_kpts", 68), ("lefthand_kpts", 21),
          ("righthand_kpts", 21))  # fmt: skip
"""Lists of COCO-WholeBody, in its order, with their numbers of joints."""
_COLUMNS = ("frame", "id", "joint", "x", "y", "z", "state")
_TIME = "time_ns"  # a column that a table may lack

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SeenPerson:
    """Joints of a person in a frame, in the order of the file's layout.

    Attributes
    ----------
    joints : (J, 3) or (J, 2) float64
        Metres, or pixels of the colour image.
    trust : (J,) float64
        `TRACKED`, `INFERRED` or `NOT_TRACKED` of joints in metres; confidences of joints in pixels,
        of which 0 means that the joint was not found.
    id : int
        Number of the person.
    """

    joints: Floats
    trust: Floats
    id: int


@dataclass(frozen=True, eq=False)
class JointFile:
    """Joints of people in the frames of a recording.

    Attributes
    ----------
    layout : str
        Tracker of the joints, as in `manip3d.modify.joint_layouts`.
    axes : str
        ``camera`` (x right, y down, z ahead), ``kinect`` (x left, y up) or ``pixels``.
    frames : mapping of int to tuple of SeenPerson
        People by the frame's index in the recording, its number or its time, see ``key``.
    key : str
        ``index``, ``number`` (`RgbdFrame.number`) or ``time`` (microseconds of the camera's clock).
    num_frames : int or None
        Number of frames of the recording; None if the file does not state it.
    times_ns : mapping of int to int
        Times of frames by their number, nanoseconds, where a table states them.
    """

    layout: str
    axes: Literal["camera", "kinect", "pixels"]
    frames: Mapping[int, tuple[SeenPerson, ...]]
    key: Literal["index", "number", "time"]
    num_frames: int | None = None
    times_ns: Mapping[int, int] = field(default_factory=dict)


def read_joint_file(path: str | os.PathLike[str]) -> JointFile:
    """Read a file of joints, or a folder of OpenPose's files; the content tells its kind.

    - ``.skeleton``: NTU RGB+D [Shahroudy et al., CVPR 2016], one text file for each recording.
    - A folder of ``*_keypoints.json``: OpenPose's ``--write_json`` with its model BODY_25, in
      pixels, one file for each frame, in the order of their names.
    - ``.json``, a list: results in COCO's format with 17 joints, or those of COCO-WholeBody (also
      ``foot_kpts`` and so on, or 133 ``keypoints``), in pixels. Each ``image_id`` is the number of
      a frame, or a file name that consists of it (``12.jpg``).
    - ``.json``, with ``frames``: the output of Azure Kinect's sample ``offline_processor``.
    - ``.csv``: a table as written by `manip3d.capture.export_joints`.

    Raises
    ------
    FormatError
        The file is of none of these kinds, damaged, or its joints have another unit.
    OSError
        The file cannot be read.
    """
    place = Path(path)
    if place.is_dir():
        return _openpose(place)
    suffix = place.suffix.lower()
    if suffix == ".skeleton":
        return _ntu(place)
    if suffix == ".csv":
        return _table(place)
    if suffix == ".json":
        content = _json(place, _MAX_BYTES)
        if isinstance(content, list):
            return _coco(content, str(place))
        if isinstance(content, dict) and "people" in content:
            raise FormatError(
                "expected the folder of OpenPose's files, got one file of it", file=str(place)
            )
        return _azure(content, str(place))
    raise FormatError(
        "expected joints: .skeleton (NTU RGB+D), .csv, .json (COCO, Azure Kinect) or a folder of "
        f"OpenPose's *{_OPENPOSE_ENDING}",
        file=str(place),
    )


def _with_own_ids(people: Sequence[tuple[Floats, Floats, int | None]]) -> tuple[SeenPerson, ...]:
    """Return the people of a frame by their joints, trust and ids, of which each occurs once.

    The first person keeps an id; others with it, or without any, take the smallest free numbers.
    """
    used = {identity for *_, identity in people}
    free = (number for number in count() if number not in used)
    kept: dict[int, SeenPerson] = {}
    for places, trust, identity in people:
        own = next(free) if identity is None or identity in kept else identity
        kept[own] = SeenPerson(places, trust, own)
    return tuple(kept.values())


def _found(frames: Mapping[int, tuple[SeenPerson, ...]]) -> Floats:
    """Return the joints of all people that were found; those at the origin were not."""
    places = [
        one.joints[(one.trust > 0) & one.joints.any(axis=1)]
        for people in frames.values()
        for one in people
    ]
    return np.concatenate(places) if places else np.zeros((0, 3))


def _check_pixels(frames: Mapping[int, tuple[SeenPerson, ...]], file: str) -> None:
    places = np.abs(_found(frames))
    if places.size and places.max() <= 1.0:
        raise FormatError(
            "expected joints in pixels of the colour image, got none beyond 1 (shares of the "
            "image's size)",
            file=file,
        )


# --- NTU RGB+D ------------------------------------------------------------------------------------


class _Lines:
    """The lines of a text, each split into words."""

    def __init__(self, path: Path) -> None:
        self._file = str(path)
        self._lines = limited_bytes(path, _MAX_BYTES).removeprefix(codecs.BOM_UTF8).splitlines()
        self._at = 0

    def fail(self, reason: str) -> FormatError:
        return FormatError(reason, file=self._file, line=max(1, self._at))

    def words(self, count: int, expected: str) -> list[str]:
        """Return the words of the next line that is not blank."""
        while self._at < len(self._lines):
            words = self._lines[self._at].decode("utf-8", "replace").split()
            self._at += 1
            if words:
                if len(words) != count:
                    raise self.fail(f"expected {expected}, got {len(words)} words")
                return words
        raise self.fail(f"expected {expected}, found the end of the file")

    def whole(self, text: str, expected: str, low: int, high: int) -> int:
        if text.isascii() and text.isdigit() and len(text) < 20 and low <= int(text) <= high:
            return int(text)
        raise self.fail(f"expected {expected}, {low} to {high}, got {text[:40]!r}")

    def number(self, text: str, expected: str) -> float:
        try:
            value = math.nan if "_" in text else float(text)
        except ValueError:
            value = math.inf
        if math.isinf(value) or abs(value) > _FARTHEST_M or "_" in text:
            raise self.fail(f"expected {expected}, got {text[:40]!r}")
        return value

    @property
    def at_end(self) -> bool:
        return not any(line.strip() for line in islice(self._lines, self._at, None))

    def __len__(self) -> int:
        return len(self._lines)


def _ntu(path: Path) -> JointFile:
    """Read a ``.skeleton`` file.

    It has the number of frames; for each frame the number of bodies; for each body a line that
    begins with its id, the number of joints, and for each joint a line: x, y, z, four numbers of
    pixels, four of the orientation, and the state.
    """
    lines = _Lines(path)
    (word,) = lines.words(1, "the number of frames")
    total = lines.whole(word, "the number of frames", 1, len(lines))
    frames = {}
    for frame in range(total):
        (word,) = lines.words(1, "the number of bodies")
        bodies = lines.whole(word, "the number of bodies", 0, MAX_PEOPLE)
        frames[frame] = _with_own_ids([_ntu_body(lines) for _ in range(bodies)])
    if not lines.at_end:
        raise lines.fail(f"expected {total} frames, found more")
    return JointFile("kinect-v2", "kinect", frames, "index", total)


def _ntu_body(lines: _Lines) -> tuple[Floats, Floats, int]:
    identity = lines.words(10, "ten words about a body")[0]
    person = lines.whole(identity, "the id of a body", 0, 2**63 - 1)
    (word,) = lines.words(1, "the number of joints")
    lines.whole(word, "the number of joints", len(JOINTS), len(JOINTS))
    places, states = np.zeros((len(JOINTS), 3)), np.zeros(len(JOINTS))
    for joint in range(len(JOINTS)):
        words = lines.words(12, "twelve numbers of a joint")
        places[joint] = [lines.number(text, "metres of a joint") for text in words[:3]]
        states[joint] = lines.whole(words[11], "the state of a joint", NOT_TRACKED, TRACKED)
    return places, states, person


# --- tables ---------------------------------------------------------------------------------------


def _table(path: Path) -> JointFile:
    """Read a table with the columns of `export_joints`, of which `_COLUMNS` are needed."""
    rows = csv_rows(path, most_bytes=_MAX_BYTES, errors="replace")
    people: dict[tuple[int, int], tuple[Floats, Floats]] = {}
    times: dict[int, int] = {}
    line, head = next(rows, (1, []))
    names = [name.strip().lower() for name in head]
    missing = [name for name in _COLUMNS if names.count(name) != 1]
    if missing:
        told = f"expected columns {', '.join(missing)}, each once, got {names!r:.80}"
        raise FormatError(told, file=str(path), line=line)
    at = [names.index(name) for name in _COLUMNS]
    time_at = names.index(_TIME) if _TIME in names else len(names)
    for line, row in rows:
        try:
            frame = _add_joint(people, [row[i] if i < len(row) else "" for i in at])
            _add_time(times, frame, row[time_at] if time_at < len(row) else "")
        except ValueError as error:
            raise FormatError(str(error), file=str(path), line=line) from None
    frames: dict[int, tuple[SeenPerson, ...]] = {}
    for (number, identity), (places, states) in people.items():
        seen = SeenPerson(places, np.nan_to_num(states), identity)
        frames[number] = (*frames.get(number, ()), seen)
        if len(frames[number]) > MAX_PEOPLE:
            raise FormatError(f"expected at most {MAX_PEOPLE} people in a frame", file=str(path))
    return JointFile("kinect-v2", "camera", frames, "number", times_ns=times)


def _add_joint(people: dict[tuple[int, int], tuple[Floats, Floats]], row: list[str]) -> int:
    """Add a row of a table and return its frame; raises ValueError with what is wrong."""
    frame, person, joint, state = (_whole(row[i]) for i in (0, 1, 2, 6))
    if frame is None or person is None:
        raise ValueError(f"expected whole numbers of a frame and an id, got {row[:2]!r:.80}")
    if joint not in range(len(JOINTS)) or state not in (NOT_TRACKED, INFERRED, TRACKED):
        raise ValueError(f"expected a joint 0 to {len(JOINTS) - 1} and a state 0 to 2")
    place = [float_or_nan(text) for text in row[3:6]]
    if state != NOT_TRACKED:
        _check_place(place, row[3:6])
    nobody = np.zeros((len(JOINTS), 3)), np.full(len(JOINTS), np.nan)
    places, states = people.setdefault((frame, person), nobody)
    if not math.isnan(states[joint]):
        raise ValueError(f"expected joint {joint} of frame {frame} once, got it again")
    places[joint], states[joint] = place, state
    return frame


def _add_time(times: dict[int, int], frame: int, text: str) -> None:
    """Add the time of a row, which may be empty; raises ValueError with what is wrong."""
    time = _whole(text)
    if time is None and text.strip():
        raise ValueError(f"expected whole nanoseconds as {_TIME}, got {text!r:.40}")
    if time is not None and times.setdefault(frame, time) != time:
        raise ValueError(f"expected the {_TIME} {times[frame]} of frame {frame}, got {time}")


def _check_place(place: list[float], texts: list[str]) -> None:
    """Raise ValueError unless the coordinates of a joint that was seen are numbers and near."""
    for axis, value, text in zip("xyz", place, texts, strict=True):
        if math.isnan(value):
            raise ValueError(
                f"expected a number as {axis}, got {text!r:.40}: write state {NOT_TRACKED} for a "
                "joint that was not seen"
            )
    if not all(abs(value) <= _FARTHEST_M for value in place):
        raise ValueError(f"expected x, y, z within {_FARTHEST_M:g} m of the camera")


def _whole(text: str) -> int | None:
    found = re.fullmatch(r"\s*([+-]?[0-9]{1,19})\s*", text, re.ASCII)
    return int(found[1]) if found and abs(int(found[1])) < 2**63 else None


# --- JSON -----------------------------------------------------------------------------------------


def _json(path: Path, most: int) -> Any:
    try:
        return json.loads(limited_bytes(path, most))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"expected JSON: {error}", file=str(path)) from None


def _member(value: Any, name: str, kind: Any, place: str, file: str) -> Any:
    found: Any = value.get(name) if isinstance(value, dict) else None
    if not isinstance(found, kind) or isinstance(found, bool):
        words = {list: "a list", int: "a whole number", dict: "an object"}[kind]
        raise FormatError(f"{place}: expected {name}, {words}", file=file)
    if kind is int and abs(found) > _LARGEST:
        raise FormatError(f"{place}: expected {name} within 2^62", file=file)
    return found


def _numbers(values: Any, shape: tuple[int, int], place: str, file: str) -> Floats:
    """Return a list of finite numbers, flat or in rows, in that shape."""
    rows: list[Any] = [values] if isinstance(values, list) else []
    if rows and values and isinstance(values[0], list):
        rows = values
    flat: list[Any] = [
        v for row in rows if isinstance(row, list) for v in islice(row, math.prod(shape) + 1)
    ]
    is_right = len(flat) == math.prod(shape) and all(
        isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= _LARGEST for v in flat
    )
    if not is_right:
        raise FormatError(f"{place}: expected {shape[0]} times {shape[1]} numbers", file=file)
    return np.array(flat, np.float64).reshape(shape)


def _in_pixels(rows: Floats, person: Any) -> tuple[Floats, Floats, int | None]:
    """Return the joints, their confidences and the id, None if it is none, of a person."""
    is_id = type(person) is int and 0 <= person <= _LARGEST
    return rows[:, :2], np.maximum(rows[:, 2], 0.0), person if is_id else None


def _openpose(folder: Path) -> JointFile:
    names = sorted(
        islice(filter(_is_openpose, os.listdir(folder)), _MAX_FRAMES + 1),
        key=_by_numbers,
    )
    if not 1 <= len(names) <= _MAX_FRAMES:
        raise FormatError(
            f"expected OpenPose's files, 1 to {_MAX_FRAMES} *{_OPENPOSE_ENDING}, got {len(names)}",
            file=str(folder),
        )
    frames = {}
    for index, name in enumerate(names):
        file = folder / name
        people = _member(_json(file, _MAX_FRAME_BYTES), "people", list, "the file", str(file))
        frames[index] = _openpose_people(people, str(file))
    _check_pixels(frames, str(folder))
    return JointFile("openpose", "pixels", frames, "index", len(names))


def _is_openpose(name: str) -> bool:
    return name.endswith(_OPENPOSE_ENDING) and not is_hidden(name)


def _by_numbers(name: str) -> tuple[list[tuple[int, str]], str]:
    """Return a key that sorts names by the numbers in them: 2 before 10."""
    parts = re.findall(r"[0-9]+|[^0-9]", name)
    return [(len(p.lstrip("0")), p.lstrip("0")) if p.isdigit() else (99, p) for p in parts], name


def _openpose_people(people: list[Any], file: str) -> tuple[SeenPerson, ...]:
    if len(people) > MAX_PEOPLE:
        raise FormatError(f"people: expected at most {MAX_PEOPLE}, got {len(people)}", file=file)
    found = []
    for number, one in enumerate(people):
        place = f"people[{number}]"
        values = _member(one, "pose_keypoints_2d", list, place, file)
        if len(values) == 3 * 18:
            raise FormatError(
                f"{place}: expected joints of OpenPose's model BODY_25, got those of its model "
                "COCO (18 joints)",
                file=file,
            )
        rows = _numbers(values, (_OPENPOSE, 3), f"{place}.pose_keypoints_2d", file)
        given = one.get("person_id", [])  # [-1] without OpenPose's tracking
        is_one = isinstance(given, list) and len(given) == 1
        found.append(_in_pixels(rows, given[0] if is_one else None))
    return _with_own_ids(found)


def _coco(results: list[Any], file: str) -> JointFile:
    """Read results in COCO's format: a list with an entry for each person."""
    found: dict[int, list[tuple[Floats, Floats, int | None]]] = {}
    joints = 0
    for number, one in enumerate(results):
        place = f"[{number}]"
        values = _member(one, "keypoints", list, place, file)
        image = _frame_number(one.get("image_id"), place, file)
        if len(values) == 3 * 17 and any(name in one for name, _ in _PARTS[1:]):
            rows = _whole_body(one, place, file)
        elif len(values) // 3 in _COCO:
            rows = _numbers(values, (len(values) // 3, 3), f"{place}.keypoints", file)
        else:
            raise FormatError(
                f"{place}.keypoints: expected x, y and score of 17 or 133 joints, got "
                f"{len(values)} numbers",
                file=file,
            )
        joints = joints or len(rows)
        if len(rows) != joints:
            raise FormatError(f"{place}: expected {joints} joints as before, got {len(rows)}",
                              file=file)  # fmt: skip
        people = found.setdefault(image, [])
        if len(people) == MAX_PEOPLE:
            raise FormatError(f"image {image}: expected at most {MAX_PEOPLE} people", file=file)
        people.append(_in_pixels(rows, one.get("idx", one.get("track_id"))))  # AlphaPose's ids
    if not found:
        raise FormatError("expected results of at least one person, got an empty list", file=file)
    frames = {image: _with_own_ids(people) for image, people in found.items()}
    _check_pixels(frames, file)
    return JointFile(_COCO[joints], "pixels", frames, "number")


def _whole_body(one: Mapping[str, Any], place: str, file: str) -> Floats:
    """Return the joints of COCO-WholeBody; lists that are missing have confidence 0."""
    rows = [
        _numbers(one[name], (count, 3), f"{place}.{name}", file)
        if name in one
        else np.zeros((count, 3))
        for name, count in _PARTS
    ]
    return np.concatenate(rows)


def _frame_number(image: Any, place: str, file: str) -> int:
    if type(image) is int and 0 <= image <= _LARGEST:
        return image
    if isinstance(image, str) and (found := re.fullmatch(r"([0-9]{1,18})(\.[A-Za-z]+)?", image)):
        return int(found[1])
    raise FormatError(
        f"{place}.image_id: expected the number of a frame, or a file name that consists of it "
        f"(12.jpg), got {image!r:.60}",
        file=file,
    )


def _azure(content: Any, file: str) -> JointFile:
    """Read the output of Azure Kinect's ``offline_processor``: millimetres, depth camera's axes."""
    frames: dict[int, tuple[SeenPerson, ...]] = {}
    for index, frame in enumerate(_member(content, "frames", list, "the file", file)):
        place = f"frames[{index}]"
        time = _member(frame, "timestamp_usec", int, place, file)
        bodies = _member(frame, "bodies", list, place, file)
        if len(bodies) > MAX_PEOPLE:
            raise FormatError(f"{place}: expected at most {MAX_PEOPLE} bodies", file=file)
        if time in frames:
            raise FormatError(f"{place}: expected another time than that before", file=file)
        people = []
        for number, body in enumerate(bodies):
            at = f"{place}.bodies[{number}]"
            person = _member(body, "body_id", int, at, file)
            values = _member(body, "joint_positions", list, at, file)
            places = _numbers(values, (_AZURE, 3), f"{at}.joint_positions", file) / 1000.0
            if not (np.abs(places) <= _FARTHEST_M).all():
                raise FormatError(f"{at}.joint_positions: expected at most 1000 m", file=file)
            people.append((places, np.full(_AZURE, float(TRACKED)), person))
        frames[time] = _with_own_ids(people)
    depths = np.abs(_found(frames)[:, 2])
    if len(depths) and np.median(depths) < _NEAREST_M:
        raise FormatError(
            "joint_positions: expected millimetres from the camera, got a median depth of "
            f"{1000 * np.median(depths):.3g} (metres?)",
            file=file,
        )
    return JointFile("azure-kinect", "camera", frames, "time", len(frames))
