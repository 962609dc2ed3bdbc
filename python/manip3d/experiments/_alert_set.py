"""Frames of table 7.2: as many of simulated streets as of the published drives, and attacks."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.errors import InputError
from manip3d.experiments import _published
from manip3d.experiments._model import Case, Plan, Row

if TYPE_CHECKING:
    from manip3d.forge import Forgery
    from manip3d.lidar import Box, LidarFrame

TABLE = "table_7_2_alert_detection"

DRIVES = (1, 2, 3)

ATTACKS = {
    "original": "original",
    "additive": "1",
    "subtractive": "2",
    "additive_subtractive": "3",
    "replacement": "4",
    "translation": "5",
    "rotation": "6",
}
"""Name of each attack in the table, by this package's name."""

MIN_POINTS = 20
"""Smallest number of points of an object that is attacked."""

_MAX_TURNS = 100
"""Largest number of frames of one street; further frames come from the next street."""

_TURNS_DEG = (180.0, 150.0, 210.0, 120.0, 240.0, 90.0, 270.0, 60.0, 300.0, 30.0, 330.0)
"""Azimuths relative to the object, degrees, at which a place for its copy is tried in this order;
180 is behind the scanner's car."""


def published_lines() -> tuple[Mapping[str, str], ...]:
    """Return the published table."""
    return _published.published_rows(TABLE)


def published_frames(drive: int, attack: str) -> int:
    """Return the published number of frames of a drive with this attack, or of clean frames."""
    wanted = (str(drive), ATTACKS[attack])
    return next(
        int(line["frames"])
        for line in published_lines()
        if (line["drive"], line["attack"]) == wanted
    )


def seed_of(drive: int, seed: int) -> int:
    """Return the seed of a drive's first street."""
    return Plan(seed=seed).street(100 * drive)


def cases_of_drives(
    run: Callable[[Case], Row], plan: Plan, name: str, values: Collection[str], **options: int
) -> list[Case]:
    """Return a case for each drive and each value of the option ``name``, with further options."""
    return [
        Case(
            run,
            {"model": f"drive {drive}", name: each, **options, "seed": seed_of(drive, plan.seed)},
        )
        for drive in DRIVES
        for each in values
    ]


def frames(seed: int, first: int, count: int) -> Iterator[tuple[int, LidarFrame, tuple[Box, ...]]]:
    """Yield number, scan and boxes of ``count`` frames of simulated streets, from ``first`` on.

    The noise of a frame depends on the street and on the street's first frame in this call, so that
    no earlier frame has to be simulated.
    """
    from manip3d.simulate.drives import drive
    from manip3d.simulate.lidar import TURN_PERIOD
    from manip3d.simulate.streets import street

    number, wanted = 0, range(first, first + count)
    while number < wanted.stop:
        place = street(seed)
        turns = min(_MAX_TURNS, int(min(place.duration, 1e3) / TURN_PERIOD))
        inside = range(max(wanted.start - number, 0), min(wanted.stop - number, turns))
        if inside:
            source = drive(
                place, len(inside), start=inside.start * TURN_PERIOD, pictures=False,
                rng=np.random.default_rng([seed, inside.start]), threads=1,
            )  # fmt: skip
            for turn, frame in zip(inside, source, strict=True):
                yield number + turn, _as_frame(frame.scan), frame.boxes
        number += turns
        seed += 1


def _as_frame(scan: Any) -> LidarFrame:
    from manip3d.lidar import LidarFrame

    return LidarFrame(scan.points, scan.intensity)


def attacked(frame: LidarFrame, boxes: Sequence[Box], attack: str) -> Forgery | None:
    """Attack the nearest labelled object for which there is a free place; None: there is none."""
    for target in _targets(frame, boxes):
        for turn in _TURNS_DEG if attack.startswith("additive") else (0.0,):
            try:
                return _forged(frame, target, attack, math.radians(turn))
            except InputError:  # the object would intersect another one
                continue
    return None


def _forged(frame: LidarFrame, target: Box, attack: str, turn: float) -> Forgery:
    from manip3d import forge

    if attack in ("subtractive", "translation", "rotation"):
        return forge.ALERT_ATTACKS[attack](frame, target, threads=1)
    inside = frame.select(target.contains(frame.points))
    x, y = target.center[:2]
    elsewhere = (
        math.cos(turn) * x - math.sin(turn) * y - x,
        math.sin(turn) * x + math.cos(turn) * y - y,
        0.0,
    )
    if attack == "additive":
        return forge.additive(frame, inside, offset=elsewhere, threads=1)
    if attack == "additive_subtractive":
        return forge.additive_subtractive(frame, inside, target, offset=elsewhere, threads=1)
    # Replace the object by a copy of itself, rotated by half a turn about the scanner's z axis.
    turned = inside.points * np.array([-1, -1, 1], np.float32)
    return forge.replacement(frame, inside.replace(points=turned), target, threads=1)


def _targets(frame: LidarFrame, boxes: Sequence[Box]) -> Iterator[Box]:
    """Yield the objects with at least `MIN_POINTS` points, nearest first."""
    for box in sorted(boxes, key=lambda box: float(np.hypot(*box.center[:2]))):
        if np.count_nonzero(box.contains(frame.points)) >= MIN_POINTS:
            yield box
