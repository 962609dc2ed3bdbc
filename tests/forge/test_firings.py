"""White-box attacks change ranges of the scanner's own firings, exactly on its lattice."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import lattice_scans as scans
import manip3d
from manip3d import Box, InputError, LidarFrame, forge
from manip3d.authenticate import generic_consistency
from manip3d.authenticate._lattice import COLUMNS
from manip3d.cli import app
from manip3d.forge import Forgery
from manip3d.forge._firings import _noise_of

LATTICE = scans.lattice()
STREET = scans.scan(np.random.default_rng(3))
FRAME = LidarFrame(STREET, np.arange(len(STREET), dtype=np.float32) % 100 / 100)
BOX = Box((12.0, 3.0, -0.9), (6.0, 2.0, 1.2))


def pillar() -> np.ndarray:
    """Return the points of a pillar 6 m ahead, at every second encoder count."""
    ring, count = (a.ravel() for a in np.meshgrid(np.arange(20, 40), np.arange(0, 60, 2)))
    return scans.rounded(scans.beam_points(LATTICE, ring, count, np.full(len(ring), 6.0)))


def center_azimuth(points: np.ndarray) -> float:
    x, y, _ = points.mean(axis=0)
    return math.atan2(y, x)


def check_truth(forged: Forgery) -> None:
    """Check that untouched points keep bits and order, and that moved ones name their old rows."""
    assert forged.added.size == forged.removed.size == 0
    assert forged.frame.intensity is not None
    source = forged.source_index
    assert sorted(source.tolist()) == list(range(len(STREET)))
    untouched = forged.label == 0
    assert (np.diff(source[untouched]) > 0).all()
    assert forged.points[untouched].tobytes() == STREET[source[untouched]].tobytes()
    np.testing.assert_array_equal(source[forged.moved], forged.moved_from)
    assert (forged.points[forged.moved] != STREET[forged.moved_from]).any(axis=1).all()
    assert forged.box.contains(forged.points[forged.moved]).all()


def check_lattice(forged: Forgery) -> None:
    """Check that rewritten points keep their firing and lie on line, step and range."""
    was = LATTICE.read(STREET[forged.moved_from])
    now = LATTICE.read(forged.points[forged.moved])
    np.testing.assert_array_equal(now.ring, was.ring)
    np.testing.assert_array_equal(now.count, was.count)
    assert np.abs(now.line_error).max() < 1e-3
    assert np.abs(now.step_error).max() < 1e-3
    assert generic_consistency(forged.frame, lattice=LATTICE).verdict == "no_trace"


@pytest.mark.parametrize("turn", [0.0, 1.0, math.pi, -2.5])
def test_inserted_object_is_seen_by_firings_that_saw_what_is_behind(turn: float) -> None:
    forged = forge.lattice_insert(FRAME, pillar(), lattice=LATTICE, turn=turn)
    assert len(forged.moved) > 100
    check_truth(forged)
    check_lattice(forged)
    reach = np.hypot(*forged.points[forged.moved, :2].T)
    np.testing.assert_allclose(reach, 6.0, atol=0.01)
    assert (np.hypot(*STREET[forged.moved_from, :2].T) > 6.0).all()
    where = center_azimuth(forged.points[forged.moved]) - center_azimuth(pillar()) - turn
    assert abs(math.remainder(where, 2.0 * math.pi)) < 0.05


def test_intensities_come_along() -> None:
    thing = LidarFrame(pillar(), np.full(len(pillar()), 0.5, np.float32))
    forged = forge.lattice_insert(FRAME, thing, lattice=LATTICE)
    assert forged.intensity is not None
    assert set(forged.intensity[forged.moved].tolist()) == {0.5}
    untouched = forged.label == 0
    assert FRAME.intensity is not None
    kept = FRAME.intensity[forged.source_index[untouched]]
    np.testing.assert_array_equal(forged.intensity[untouched], kept)


def test_what_stands_behind_is_not_seen() -> None:
    hidden = pillar().astype(np.float64) * 20.0
    for attack in (forge.lattice_insert, forge.spoof):
        for hoax in (hidden, np.empty((0, 3))):
            with pytest.raises(InputError, match=r"hoax: .* but no point would change"):
                attack(FRAME, hoax, lattice=LATTICE)


def test_spoofing_injects_at_most_200_returns() -> None:
    forged = forge.spoof(FRAME, pillar(), lattice=LATTICE, turn=1.0)
    assert len(forged.moved) == forge.MAX_SPOOFED == 200
    check_truth(forged)
    check_lattice(forged)
    whole = forge.lattice_insert(FRAME, pillar(), lattice=LATTICE, turn=1.0)
    assert set(forged.moved_from.tolist()) < set(whole.moved_from.tolist())
    few = forge.spoof(FRAME, pillar(), lattice=LATTICE, most=7, rng=1)
    assert len(few.moved) == 7


def test_removed_object_gives_way_to_what_stands_beside_it() -> None:
    with_pillar = forge.lattice_insert(FRAME, pillar(), lattice=LATTICE, turn=1.0)
    box = with_pillar.box
    box = Box(box.center, tuple(side + 0.1 for side in box.size))
    healed = forge.lattice_remove(with_pillar.frame, box, lattice=LATTICE)
    touched = np.isin(healed.source_index, with_pillar.moved)
    assert np.count_nonzero(touched & (healed.label == 2)) > 0.95 * len(with_pillar.moved)
    assert generic_consistency(healed.frame, lattice=LATTICE).verdict == "no_trace"
    # The flat street between walls is what it was, but for noise and for corners.
    before = STREET[with_pillar.source_index[healed.source_index]]
    off = np.linalg.norm(healed.points - before, axis=1)[healed.label == 2]
    assert np.median(off) < 0.1


def test_an_empty_box_is_refused() -> None:
    with pytest.raises(InputError, match="box: expected scene points on the lattice in it, got"):
        forge.lattice_remove(FRAME, Box((0, 0, 50), (1, 1, 1)), lattice=LATTICE)


def test_other_orders_are_kept() -> None:
    shuffled = STREET[np.random.default_rng(0).permutation(len(STREET))]
    forged = forge.lattice_insert(shuffled, pillar(), lattice=LATTICE)
    np.testing.assert_array_equal(forged.moved, forged.moved_from)


def test_bad_arguments_are_named() -> None:
    blind = manip3d.authenticate.SensorLattice(
        **{name: getattr(LATTICE, name) for name in LATTICE.__dataclass_fields__} | {"steps": 0}
    )
    with pytest.raises(InputError, match="lattice: expected one with an encoder"):
        forge.lattice_insert(FRAME, pillar(), lattice=blind)
    with pytest.raises(InputError, match="turn: expected at most one turn"):
        forge.spoof(FRAME, pillar(), lattice=LATTICE, turn=math.nan)
    with pytest.raises(InputError, match="most: expected at least 1, got 0"):
        forge.spoof(FRAME, pillar(), lattice=LATTICE, most=0)
    rings = len(LATTICE.slope)
    with pytest.raises(InputError, match=f"offset: expected {rings} values, one for each laser"):
        dataclasses.replace(LATTICE, offset=LATTICE.offset[:-1])


def test_a_lattice_may_be_lists() -> None:
    lists: dict[str, Any] = {name: getattr(LATTICE, name).tolist() for name in COLUMNS}
    lattice = dataclasses.replace(LATTICE, **lists)
    for attack in (forge.lattice_insert, forge.spoof):
        one, other = (attack(FRAME, pillar(), lattice=each) for each in (lattice, LATTICE))
        np.testing.assert_array_equal(one.points, other.points)


@pytest.mark.parametrize("attack", ["lattice-insert", "lattice-remove", "spoof"])
def test_commands_write_the_truth_of_their_bytes(attack: str, tmp_path: Path) -> None:
    source, output, lattice = (tmp_path / name for name in ("a.bin", "b.bin", "lattice.json"))
    FRAME.write(source)
    LATTICE.save(lattice)
    turn = () if attack == "lattice-remove" else ("--yaw", "0.4")
    done = CliRunner().invoke(
        app,
        ["forge", "lidar", attack, str(source), "-o", str(output), "--lattice", str(lattice), "-q",
         "--box", *map(str, (*BOX.center, *BOX.size, 0.0)), *turn],
    )  # fmt: skip
    assert done.exit_code == 0, (done.output, done.exception)
    truth = json.loads((tmp_path / "b.bin.truth.json").read_text())
    before = np.fromfile(source, np.float32).reshape(-1, 4)
    after = np.fromfile(output, np.float32).reshape(-1, 4)
    assert len(before) == len(after) == truth["points"]
    assert truth["moved"]
    assert not truth["added"]
    assert not truth["removed"]
    kept = np.delete(after, truth["moved"], axis=0)
    assert kept.tobytes() == np.delete(before, truth["moved_from"], axis=0).tobytes()
    changed = after[truth["moved"], :3] != before[truth["moved_from"], :3]
    assert changed.any(axis=1).all()


def test_a_box_with_nothing_beside_it_is_refused() -> None:
    everything = Box((0.0, 0.0, 0.0), (500.0, 500.0, 100.0))
    with pytest.raises(InputError, match=r"box: .* no point would change"):
        forge.lattice_remove(FRAME, everything, lattice=LATTICE)
    reading = LATTICE.read(STREET)
    low = STREET[reading.ring == reading.ring.max()]  # the only laser that is left sees no side
    center, size = (low.min(axis=0) + low.max(axis=0)) / 2, np.ptp(low, axis=0) + 0.1
    with pytest.raises(InputError, match=r"box: .* no point would change"):
        forge.lattice_remove(low, Box(center, size), lattice=LATTICE)


def test_an_object_at_the_end_of_the_first_and_the_last_laser_stays() -> None:
    """Returns of these lasers have a neighbour of the same laser at one side only."""
    ring, count = np.divmod(np.arange(3 * 500), 500)
    ring = np.array([0, 30, len(LATTICE.slope) - 1])[ring]
    is_car = (count < 10) | (count >= 490)
    inner = ring == 30
    is_car[inner] = abs(count[inner] - 250) < 10
    distance = np.where(is_car, 10, 16) + LATTICE.range_phase[ring]
    scan = LATTICE.points_at(ring, 2 * count, distance).round(3).astype(np.float32)
    boxes = [scan[is_car & (ring == laser)] for laser in (0, 30, len(LATTICE.slope) - 1)]
    low, high = np.vstack(boxes).min(axis=0), np.vstack(boxes).max(axis=0)
    forged = forge.lattice_remove(scan, Box((low + high) / 2, high - low + 0.1), lattice=LATTICE)
    assert set(LATTICE.read(forged.points).ring[forged.moved]) == {30}


def test_the_noise_of_ranges_is_that_of_single_shots() -> None:
    """The estimate is right on a wall, as second differences cancel its slope and offset."""
    random = np.random.default_rng(0)
    place = np.arange(20_000)
    seen = 10.0 + 0.003 * place + 0.02 * random.standard_normal(len(place))
    assert _noise_of(seen, place) == pytest.approx(0.02, rel=0.03)
