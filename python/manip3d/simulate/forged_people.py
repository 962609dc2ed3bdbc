"""Forged streams of six simulated people in four actions before three backgrounds (section 5.2)."""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d import capture, forge
from manip3d._util.checked import checked
from manip3d._util.extras import require
from manip3d._util.fingerprint import code_fingerprint
from manip3d._util.options import fraction_only, reporting
from manip3d._util.paths import path_of
from manip3d._util.remaining import RemainingTime
from manip3d._util.reprs import short_repr
from manip3d.batch import Rows, run_stored, write_table
from manip3d.errors import InputError
from manip3d.io._files import atomic_write
from manip3d.rgbd import RgbdCalibration, RgbdFrame, Skeleton
from manip3d.simulate._scenery import SCENES
from manip3d.simulate.people import BodySimulator

if TYPE_CHECKING:
    from manip3d._util.options import Progress
    from manip3d.batch._stored import Finished

__all__ = ["ACTIONS", "KINDS", "PEOPLE", "SCENES", "ForgedPeople", "write_forged_people"]

PEOPLE = (0.86, 0.92, 0.98, 1.04, 1.12, 1.2)
"""Girths of the six people."""

STRIPED = 2
"""Number of the person who wears stripes."""

ACTIONS = (("wave", "both"), ("arm-raise", "left"), ("arm-raise", "right"), ("arm-raise", "both"))
"""Waving, raising the left arm, the right arm, both arms (section 5.2)."""

KINDS = ("real", "type1", "type2")
"""``real``: the recorded person; ``type1``: the person of another recording; ``type2``: that person
in the poses of a third one."""

_NAMES = ("wave", "raise-left", "raise-right", "raise-both")
_AWAY_S = 60.0  # seconds later, at which the empty scene is captured
_BYTES = {"depth": 180_000, "color": 26_000}  # approximate size of a frame of 512 x 424
_NEAREST, _FARTHEST = 2.1, 2.7  # metres from the camera to a person


@dataclass(frozen=True)
class ForgedPeople:
    """Result of `write_forged_people`.

    Attributes
    ----------
    folder : Path
        Folder of the recordings.
    rows : list of dict
        One row per recording, as in ``streams.csv``; ``error`` is empty if there is none.
    resumed : int
        Number of recordings that existed before.
    failed : int
        Number of recordings that failed.
    """

    folder: Path
    rows: list[dict[str, Any]]
    resumed: int
    failed: int

    __repr__ = short_repr


@checked
def write_forged_people(
    folder: str | os.PathLike[str],
    *,
    people: int = 6,
    actions: int = 4,
    scenes: int = 3,
    kinds: Sequence[str] = KINDS,
    frames: int = 60,
    still: bool = False,
    color: bool = True,
    matroska: bool = False,
    seed: int = 0,
    jobs: int = 0,
    overwrite: bool = False,
    progress: Progress = None,
    on_error: Callable[[str, str], object] = lambda name, error: None,
) -> ForgedPeople:
    """Write a simulated version of the published streams: real ones and both types of forgery.

    Parameters
    ----------
    folder : path-like
        New folder. It gets a recording for each person, action, scene and kind, such as
        ``p1-wave-office-type2``, with the ground truth of forged ones (``.truth.npz``, see
        `forge.read_stream_truth`), ``streams.csv`` with a row for each recording, and
        ``provenance.json``. Repeat an interrupted call to continue it.
    people, actions, scenes : int
        Numbers of people (at most 6), actions (at most 4: waving, raising the left arm, the right
        arm, both) and scenes (at most 3, `SCENES`).
    kinds : sequence of str
        Names in `KINDS`.
    frames : int
        Number of frames of each recording, at 30 per second.
    still : bool
        Use one still frame as the background of forgeries; otherwise a sequence.
    color : bool
        Also write colour images.
    matroska : bool
        Write ``.mkv`` files; otherwise folders of images.
    seed : int
        Seed of all random choices.
    jobs : int
        Number of processes; 0: one per core; 1: this process.
    overwrite : bool
        Make existing recordings again.
    progress : None, True or callable(fraction, message)
        Function that gets the fraction done and a message with the name of the finished recording
        and the remaining time.
    on_error : callable(name, error)
        Function that is called for each recording that fails; the others are still made, unless the
        disk is full.

    Returns
    -------
    ForgedPeople

    Raises
    ------
    InputError
        A number is out of range; the folder has other files, or streams with other options.
    MissingExtraError
        Open3D is not installed.
    OSError
        The folder cannot be written, or there is not enough free space for the recordings.

    Notes
    -----
    In type 1, the person is shown as recorded in another scene. In type 2, the person, recorded in
    another scene and in the next action, takes the poses of the next person, who performs the named
    action. All are recorded by the simulated Kinect V2 of `BodySimulator`. The recordings of the
    publication are not public.

    Examples
    --------
    >>> from manip3d import simulate
    >>> made = simulate.write_forged_people("streams", people=1, frames=10)  # doctest: +SKIP
    >>> len(made.rows)  # doctest: +SKIP
    36
    """
    _check_numbers(people=people, actions=actions, scenes=scenes, frames=frames)
    if jobs < 0 or not 0 <= seed < 2**31:
        raise InputError(f"jobs, seed: expected >= 0, got {jobs} and {seed}")
    if not kinds or not set(kinds) <= set(KINDS) or len(set(kinds)) != len(kinds):
        raise InputError(f"kinds: expected some of {', '.join(KINDS)}, got {', '.join(kinds)}")
    require("simulate")
    target = path_of(folder, "folder")
    stored = target / "streams.csv.rows"
    if target.exists() and not stored.is_dir() and any(target.iterdir()):
        raise InputError(f"folder: expected a new one, {target} holds something else")
    options: dict[str, Any] = {"frames": frames, "still": still, "color": color, "seed": seed}
    wanted = _planned(people, actions, scenes, kinds, options)
    target.mkdir(parents=True, exist_ok=True)
    suffix = ".mkv" if matroska else ""
    made_of = {"function": "write_forged_people", "library": code_fingerprint(), **options}
    store = Rows(str(stored), made_of | {"suffix": suffix}, overwrite=overwrite)
    try:
        found = _write_all(
            wanted, target, suffix, _WholeOnly(store, target), jobs, progress, on_error
        )
    finally:
        store.flush()
    rows = [
        found.done.get(each.name) or {"stream": each.name, "error": found.failed[each.name]}
        for each in wanted
    ]
    write_table(rows, target / "streams.csv")
    provenance = made_of | {
        "people": "simulated before a simulated Kinect V2 (manip3d.simulate.BodySimulator)",
        "streams": [each.provenance() for each in wanted],
    }
    atomic_write(target / "provenance.json", json.dumps(provenance, indent=1) + "\n")
    return ForgedPeople(target, rows, found.resumed, len(found.failed))


def _planned(
    people: int, actions: int, scenes: int, kinds: Sequence[str], options: Mapping[str, Any]
) -> list[_Stream]:
    """All streams of the set, in the order of the table."""
    return [
        _Stream(person, action, scene, kind, **options)
        for person in range(people)
        for action in range(actions)
        for scene in range(scenes)
        for kind in KINDS
        if kind in kinds
    ]


def _write_all(
    wanted: Sequence[_Stream],
    target: Path,
    suffix: str,
    stored: _WholeOnly,
    jobs: int,
    progress: Progress,
    on_error: Callable[[str, str], object],
) -> Finished:
    """Write the streams that are not stored yet; only a full disk ends the run."""
    missing = [each for each in wanted if stored.load(each.name) is None]
    _check_space(target, missing)
    remaining = RemainingTime(1.0 - len(missing) / len(wanted))

    def failed(name: str, error: str) -> None:
        on_error(name, error)
        if os.strerror(errno.ENOSPC) in error:  # all further ones would fail as well
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))

    with reporting(None if callable(progress) else progress, "streams") as told:
        return run_stored(
            {each.name: (_write, (each, str(target), suffix)) for each in wanted},
            stored,
            jobs or len(os.sched_getaffinity(0)),
            progress=_with_remaining(progress, remaining)
            if callable(progress)
            else fraction_only(told),
            on_error=failed,
        )


def _check_numbers(**given: int) -> None:
    most = {
        "people": len(PEOPLE),
        "actions": len(ACTIONS),
        "scenes": len(SCENES),
        "frames": 100_000,
    }
    for name, value in given.items():
        if not 1 <= value <= most[name]:
            raise InputError(f"{name}: expected 1 to {most[name]}, got {value}")


def _check_space(folder: Path, streams: Sequence[_Stream]) -> None:
    """Raise OSError before the run if the disk does not have enough free space."""
    each = _BYTES["depth"], _BYTES["color"]
    needed = sum(stream.frames * (each[0] + each[1] * stream.color) for stream in streams)
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise OSError(
            errno.ENOSPC,
            f"expected {math.ceil(needed / 1e6):,} MB free for {len(streams)} recordings, "
            f"got {free // 10**6:,} MB",
            str(folder),
        )


def _with_remaining(
    progress: Callable[[float, str], object], remaining: RemainingTime
) -> Callable[[float, str], object]:
    def report(fraction: float, name: str) -> None:
        left = remaining(fraction)
        progress(fraction, f"{name}, {left}" if left else name)

    return report


class _WholeOnly:
    """Stored rows whose recordings still exist."""

    def __init__(self, rows: Rows, folder: Path) -> None:
        self._rows, self._folder = rows, folder

    def load(self, key: str) -> dict[str, Any] | None:
        row = self._rows.load(key)
        if row is None or not (self._folder / row["recording"]).exists():
            return None
        return None if row["truth"] and not (self._folder / row["truth"]).exists() else row

    def save(self, key: str, row: dict[str, Any]) -> dict[str, Any]:
        return self._rows.save(key, row)


@dataclass(frozen=True)
class _Stream:
    """Ingredients of a stream: person, action, scene, kind of forgery and options."""

    person: int
    action: int
    scene: int
    kind: str
    frames: int
    still: bool
    color: bool
    seed: int

    @property
    def name(self) -> str:
        action = _NAMES[self.action]
        return f"p{self.person + 1}-{action}-{SCENES[self.scene]}-{self.kind}"

    @property
    def _own_seed(self) -> int:
        """Seed of noise and tracker, which depends on the stream alone."""
        place = (self.person, self.action, self.scene, KINDS.index(self.kind))
        return int(np.random.default_rng([self.seed, *place]).integers(2**31))

    @property
    def _distance(self) -> float:
        return float(np.linspace(_NEAREST, _FARTHEST, len(PEOPLE))[self.person])

    def provenance(self) -> dict[str, Any]:
        """Ingredients of the stream, as JSON values."""
        found: dict[str, Any] = {"stream": self.name, "seed": self._own_seed, "kind": self.kind}
        if self.kind != "real":
            found["recorded in"] = SCENES[self._studio]
            found["background"] = "one still frame" if self.still else "running"
        if self.kind == "type2":
            found["recorded action"] = _NAMES[(self.action + 1) % len(ACTIONS)]
            found["poses of"] = f"p{(self.person + 1) % len(PEOPLE) + 1}"
        return found

    @property
    def _studio(self) -> int:
        """The scene in which the person of a forgery was recorded."""
        return (self.scene + 1) % len(SCENES)

    def _simulator(self, person: int, action: int, scene: int, **options: Any) -> BodySimulator:
        motion, side = ACTIONS[action]
        given: dict[str, Any] = {
            "motion": motion,
            "side": side,
            "girth": PEOPLE[person],
            "stripes": person == STRIPED,
            "distance": self._distance,
            "scene": SCENES[scene],
            "tracker": "kinect-v2",
            "color": "depth" if self.color else "none",
            "frames": self.frames,
            "seed": self._own_seed,
            "threads": 1,  # streams are made in parallel
        }
        return BodySimulator(**given | options)

    def source(self) -> BodySimulator | forge.ForgedStream:
        """Return the frames of the stream."""
        if self.kind == "real":
            return self._simulator(self.person, self.action, self.scene)
        scene = _EmptyScene(self._simulator(self.person, self.action, self.scene), self.still)
        if self.kind == "type1":
            actor = self._simulator(self.person, self.action, self._studio)
            return forge.stream(actor, scene, kind=1)
        recorded = (self.action + 1) % len(ACTIONS)
        actor = self._simulator(self.person, recorded, self._studio)
        other = (self.person + 1) % len(PEOPLE)
        mover = self._simulator(other, self.action, self.scene, color="none", room=False)
        return forge.stream(actor, scene, kind=2, pose=_poses(mover))


def _poses(mover: BodySimulator) -> Iterator[Skeleton]:
    for frame in mover:
        yield frame.skeletons[0]


class _EmptyScene:
    """Frames of a scene without people."""

    def __init__(self, simulator: BodySimulator, still: bool) -> None:
        self._simulator, self._still = simulator, still
        self.calibration: RgbdCalibration = simulator.calibration

    def __iter__(self) -> Iterator[RgbdFrame]:
        look = self._simulator.background
        first = look(_AWAY_S)
        for number in range(self._simulator.frames):
            yield first if self._still else look(_AWAY_S + number / self._simulator.rate)


def _write(stream: _Stream, folder: str, suffix: str) -> dict[str, Any]:
    """Record one stream with its ground truth, and return its row."""
    target = Path(folder) / f"{stream.name}{suffix}"
    truth = Path(folder) / f"{stream.name}.truth.npz"
    source = stream.source()
    # an interrupted run must not leave the truth of an older recording
    truth.unlink(missing_ok=True)
    done = capture.record(source, target, overwrite=target.exists())
    is_forged = isinstance(source, forge.ForgedStream)
    share = 0.0
    if isinstance(source, forge.ForgedStream):
        source.write_truth(truth)
        share = source.forged_share
    return {
        "stream": stream.name,
        "recording": target.name,
        "truth": truth.name if is_forged else "",
        "person": stream.person + 1,
        "action": _NAMES[stream.action],
        "scene": SCENES[stream.scene],
        "kind": stream.kind,
        "background": ("still" if stream.still else "running") if is_forged else "",
        "frames": done.frames,
        "forged_share": share,
        "frames_without_person": source.missed if isinstance(source, forge.ForgedStream) else 0,
        "error": "",
    }
