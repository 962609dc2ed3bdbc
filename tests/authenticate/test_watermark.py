"""The keyed watermark: what it proves, what it refuses, and what it never calls authentic."""

from __future__ import annotations

import math
import os
import pickle
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import watermark_oracle as oracle
from numpy.typing import NDArray

from manip3d import LidarFrame, _core, io
from manip3d.authenticate import (
    MAX_MOVE_M,
    KeyFile,
    Policy,
    Watermarked,
    Watermarker,
    WatermarkResult,
    embed_files,
    read_record,
    record_path,
    verdict_of_stream,
)
from manip3d.authenticate._watermark_files import StreamTally
from manip3d.errors import Error, FormatError, InputError
from watermark_scans import ROOT_KEY, grid_scan, key_file, reflectances

Points = NDArray[np.float32]

CARRYING = ("lbm", "qim")
ALL = ("lbm", "qim", "detached")


def frame(count: int = 6000, seed: int = 0) -> LidarFrame:
    return LidarFrame(grid_scan(count, seed), reflectances(count, seed))


def marker_of(key: KeyFile, embedding: str = "lbm", **options: object) -> Watermarker:
    return Watermarker(key, embedding=embedding, least_points=150, **options)  # type: ignore[arg-type]


def verify(
    key: KeyFile, scan: LidarFrame, record: bytes | None, **policy: object
) -> WatermarkResult:
    """Verify by a new verifier, which has seen no other frame."""
    chosen = Policy(**{"order": "any", **policy})  # type: ignore[arg-type]
    return Watermarker(key).verify(scan, record, policy=chosen)


# --- What holds ----------------------------------------------------------------------------------


@pytest.mark.parametrize("embedding", ALL)
def test_any_order_and_a_round_trip_through_float32_verify(key: KeyFile, embedding: str) -> None:
    sent = marker_of(key, embedding).embed(frame())
    assert sent.num_tiles > 10
    shuffled = sent.frame.select(np.random.default_rng(1).permutation(sent.frame.num_points))
    again = np.frombuffer(shuffled.points.astype("<f4").tobytes(), "<f4").reshape(-1, 3)
    for scan in (sent.frame, shuffled, shuffled.replace(points=again)):
        found = verify(key, scan, sent.record)
        assert (found.verdict, found.content, found.order) == ("authentic", "intact", "in order")
        assert found.score == 0.0
        assert found.regions == ()
        assert len(found.suspected) == 0


@pytest.mark.parametrize("embedding", ALL)
def test_no_point_moves_further_than_it_may(key: KeyFile, embedding: str) -> None:
    scan = frame(20_000)
    moved = marker_of(key, embedding).embed(scan).points.astype(np.float64) - scan.points
    farthest = np.sqrt((moved**2).sum(axis=1))[scan.points.any(axis=1)].max()
    # Coordinates of 30 m are rounded to 2 micrometres in float32.
    assert farthest <= MAX_MOVE_M[embedding] + (4e-6 if embedding != "detached" else 0.0)
    if embedding != "detached":
        assert farthest > 0.9 * MAX_MOVE_M[embedding]


@pytest.mark.parametrize("embedding", [0, 1, 2])
def test_the_canonical_order_is_that_of_any_order(embedding: int) -> None:
    scan = frame()
    assert scan.intensity is not None
    rows = _core.watermark_order(scan.points, scan.intensity, embedding, 36, 150)
    shuffle = np.random.default_rng(1).permutation(len(rows))
    points, shine = scan.points[shuffle], scan.intensity[shuffle]
    again = _core.watermark_order(points, shine, embedding, 36, 150)
    assert sorted(rows) == list(range(len(rows)))
    changes = [1.0, 500.0, 400.0][embedding]  # what embedding clears: cells of z, lowest bits
    wide = np.floor(np.round(scan.points.astype(np.float64), 3) * changes)
    mine, theirs = wide[rows], np.floor(np.round(points.astype(np.float64), 3) * changes)[again]
    assert np.array_equal(mine[:, 2], theirs[:, 2])
    with pytest.raises(InputError, match="at least one"):
        _core.watermark_order(scan.points[:0], scan.intensity[:0], embedding, 36, 150)
    for least in (0, -1):  # as the embedder
        with pytest.raises(InputError, match=f"least_points: expected 1 or more, got {least}"):
            _core.watermark_order(scan.points, scan.intensity, embedding, 36, least)


@pytest.mark.parametrize("units", [1000, 1600])
def test_products_write_the_same_floats_as_quotients(units: int) -> None:
    """The core multiplies where the format says q / units: all that it writes is equal."""
    q = np.arange(2**23, dtype=np.float64)
    assert np.array_equal((q / units).astype(np.float32), (q * (1.0 / units)).astype(np.float32))


def test_points_without_a_return_stay_where_they_are(key: KeyFile) -> None:
    for embedding in CARRYING:
        sent = marker_of(key, embedding).embed(frame())
        assert not sent.points[9:12].any()


def test_bits_are_as_random_as_they_must_be(key: KeyFile) -> None:
    sent = marker_of(key).embed(frame(40_000))
    ones = (np.rint(sent.points[:, 0] * 1000).astype(int) & 1).mean()
    assert abs(ones - 0.5) < 0.02


def test_every_session_and_frame_has_other_bits(key: KeyFile) -> None:
    marker = marker_of(key)
    one, two, other = marker.embed(frame()), marker.embed(frame()), marker_of(key).embed(frame())
    for a, b in ((one, two), (one, other), (two, other)):
        assert a.record != b.record
        assert 0.4 < np.any(a.points != b.points, axis=1).mean() < 0.6


def test_points_off_the_grid_are_refused_rounded_or_left_alone(key: KeyFile) -> None:
    points = grid_scan(3000) + np.float32(0.0003)
    with pytest.raises(InputError, match="grid of 1 mm"):
        marker_of(key).embed(points)
    sent = marker_of(key, round_points=True).embed(points)
    assert verify(key, sent.frame, sent.record).verdict == "authentic"
    moved = np.sqrt(((sent.points.astype(np.float64) - points) ** 2).sum(axis=1)).max()
    assert moved <= MAX_MOVE_M["lbm"] + math.sqrt(3) / 2000 + 5e-6
    sent = marker_of(key, "detached").embed(points)
    assert sent.points is not None
    assert np.array_equal(sent.points, points)
    assert verify(key, sent.frame, sent.record).verdict == "authentic"


# --- What is noticed -----------------------------------------------------------------------------


@pytest.mark.parametrize("embedding", ALL)
def test_a_moved_object_is_found_in_its_sectors(key: KeyFile, embedding: str) -> None:
    sent = marker_of(key, embedding).embed(frame())
    angle = np.degrees(np.arctan2(sent.points[:, 1], sent.points[:, 0])) % 360
    points = sent.points.copy()
    points[(angle > 41) & (angle < 49), 2] += np.float32(0.5)
    found = verify(key, sent.frame.replace(points=points), sent.record)
    assert found.verdict == "tampered"
    assert [found.tiles[n].azimuths_deg for n in found.changed_tiles] == [((40.0, 50.0),)]
    (region,) = found.regions
    assert region.box.contains(points[(angle > 41) & (angle < 49)]).all()
    assert len(region.rows) == 0  # a list would help who wants to try again
    assert "suspected_rows" not in found.record()


@pytest.mark.parametrize("embedding", CARRYING)
def test_flipped_bits_are_listed_where_the_content_holds(key: KeyFile, embedding: str) -> None:
    sent = marker_of(key, embedding).embed(frame())
    points = sent.points.copy()
    rows = [77, 2500, 5999]
    for row in rows:
        if embedding == "lbm":
            points[row, 1] = (round(float(points[row, 1]) * 1000) ^ 1) / 1000
        else:
            points[row, 2] = (round(float(points[row, 2]) * 1600) ^ 2) / 1600
    found = verify(key, sent.frame.replace(points=points), sent.record)
    assert found.verdict == "tampered"
    assert found.suspected.tolist() == rows
    assert {tile.state for tile in found.tiles} == {"intact", "bits"}
    assert found.record(operator=True)["suspected_rows"] == rows


def test_repeated_points_are_a_multiset(key: KeyFile) -> None:
    group = np.array([5, 6, 7, 8, 5999])
    for _ in range(50):  # the bits of five points are the same in one session of 16
        sent = marker_of(key).embed(LidarFrame(grid_scan()))
        if len(np.unique(sent.points[group], axis=0)) == 2:
            break
    else:
        pytest.fail("all sessions give the five points one bit")
    swapped = sent.points.copy()
    swapped[group] = swapped[group[::-1]]
    assert verify(key, sent.frame.replace(points=swapped), sent.record).verdict == "authentic"
    one_more = sent.frame.select(np.append(np.arange(6000), 5))
    assert verify(key, one_more, sent.record).verdict == "tampered"
    one_less = sent.frame.select(np.delete(np.arange(6000), 5))
    assert verify(key, one_less, sent.record).verdict == "tampered"


def test_added_no_returns_and_other_columns_are_noticed(key: KeyFile) -> None:
    sent = marker_of(key).embed(frame())
    more = LidarFrame(
        np.vstack([sent.points, np.zeros((1, 3), np.float32)]),
        np.append(sent.frame.intensity, np.float32(0)),  # type: ignore[arg-type]
    )
    assert verify(key, more, sent.record).verdict == "tampered"
    without = LidarFrame(sent.points)
    assert verify(key, without, sent.record).verdict == "undecidable"
    dropped = sent.frame.replace(num_dropped=1)
    assert verify(key, dropped, sent.record).verdict == "tampered"


def _edits(random: np.random.Generator, sent: Watermarked) -> tuple[LidarFrame, bytes, str]:
    """A scan and a record that somebody without the key made of them, and how."""
    scan, record = sent.frame, bytearray(sent.record)
    points = scan.points.copy()
    count = len(points)
    row = int(random.integers(count))
    kind = str(random.choice(EDITS))
    if kind == "move a little":
        points[row, random.integers(3)] += np.float32(random.choice([-1, 1]) * 0.001)
    elif kind == "move far":
        points[row] += random.uniform(-5, 5, 3).astype(np.float32)
    elif kind == "one bit of a float":
        axis = int(random.integers(3))
        bits = points.view(np.uint32)
        bits[row, axis] ^= np.uint32(1) << np.uint32(random.integers(31))
        if not np.isfinite(points[row, axis]):
            bits[row, axis] ^= np.uint32(1)
            points[row, axis] = np.float32(1e30)
    elif kind == "sign of zero":
        points[row] = np.where(points[row] == 0, -points[row], -points[row] - np.float32(0.002))
    elif kind == "intensity":
        values = scan.intensity.copy()  # type: ignore[union-attr]
        values[row] += np.float32(0.01)
        scan = scan.replace(intensity=values)
    elif kind == "delete":
        gone = random.choice(count, int(random.integers(1, 50)), replace=False)
        return scan.select(np.delete(np.arange(count), gone)), bytes(record), kind
    elif kind == "duplicate":
        rows = np.append(np.arange(count), np.full(int(random.integers(1, 50)), row))
        return scan.select(rows), bytes(record), kind
    elif kind == "stuff duplicates and delete":
        others = random.choice(count, 5, replace=False)
        rows = np.delete(np.arange(count), others)
        return scan.select(np.append(rows, np.full(5, rows[0]))), bytes(record), kind
    elif kind == "swap two points' intensities":
        other = (row + 1 + int(random.integers(count - 1))) % count
        values = scan.intensity.copy()  # type: ignore[union-attr]
        if values[row] == values[other]:
            values[other] += np.float32(0.01)
        values[[row, other]] = values[[other, row]]
        scan = scan.replace(intensity=values)
    elif kind == "flip a carrier bit":
        axis = int(random.integers(3))
        points[row, axis] = (round(float(points[row, axis]) * 1000) ^ 1) / 1000
    elif kind == "clear all carrier bits":
        points = ((np.rint(points.astype(np.float64) * 1000).astype(np.int64) & ~1) / 1000).astype(
            np.float32
        )
    elif kind == "turn":
        angle = random.uniform(1e-4, 6.2)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        points[:, :2] = points[:, :2] @ turn.T
    elif kind == "turn by whole slices":
        points[:, :2] = np.stack([-points[:, 1], points[:, 0]], axis=1)
    elif kind == "shift":
        points += np.float32(random.choice([-0.002, 0.002, 1.0]))
    elif kind == "round to centimetres":
        points = np.round(points, 2)
    elif kind == "empty":
        return scan.select(np.arange(0)), bytes(record), kind
    elif kind == "half":
        return scan.select(np.arange(count // 2)), bytes(record), kind
    elif kind == "a bit of the record":
        place = int(random.integers(8 * len(record)))
        record[place // 8] ^= 1 << place % 8
    elif kind == "cut the record":
        del record[int(random.integers(len(record))) :]
    elif kind == "lengthen the record":
        record += bytes(int(random.integers(1, 100)))
    elif kind == "swap tags of tiles":
        begin = 102 + 72 + 32
        record[begin : begin + 20], record[begin + 20 : begin + 40] = (
            record[begin + 20 : begin + 40],
            record[begin : begin + 20],
        )
    elif kind == "downgrade":
        record[int(random.choice([8, 9, 10, 11]))] ^= int(random.integers(1, 256))
    elif kind == "strip":
        record = bytearray()
    elif kind == "noise for a record":
        record = bytearray(random.bytes(len(record)))
    if np.array_equal(points, sent.points) and scan is sent.frame and record == sent.record:
        points[row, 0] += np.float32(0.01)
    return scan.replace(points=points), bytes(record), kind


EDITS = (
    "move a little", "move far", "one bit of a float", "sign of zero", "intensity", "delete",
    "duplicate", "stuff duplicates and delete", "swap two points' intensities",
    "flip a carrier bit", "clear all carrier bits", "turn", "turn by whole slices", "shift",
    "round to centimetres", "empty", "half", "a bit of the record", "cut the record",
    "lengthen the record", "swap tags of tiles", "downgrade", "strip", "noise for a record",
)  # fmt: skip


def rows_of(scan: LidarFrame) -> list[bytes]:
    """The points with their intensities, to the bit, in any order."""
    assert scan.intensity is not None
    table = np.column_stack([scan.points, scan.intensity])
    return sorted(row.tobytes() for row in table)


def _any_edit_called_authentic(key: KeyFile, embedding: str, trials: int, seed: int) -> list[str]:
    random = np.random.default_rng(seed)
    marker = marker_of(key, embedding)
    sent = [marker.embed(frame(600 + 10 * n, n)) for n in range(8)]
    authentic = []
    seen = set()
    for _ in range(trials):
        original = sent[int(random.integers(len(sent)))]
        scan, record, kind = _edits(random, original)
        seen.add(kind)
        if verify(key, scan, record).verdict != "authentic":
            continue
        # Two points at one place that swap their intensities are the same points in another order.
        if rows_of(scan) != rows_of(original.frame) or record != original.record:
            authentic.append(kind)
    assert seen == set(EDITS) or trials < 500
    return authentic


@pytest.mark.parametrize("embedding", ALL)
def test_no_edit_is_called_authentic(key: KeyFile, embedding: str) -> None:
    trials = int(os.environ.get("MANIP3D_WATERMARK_EDITS", "10000")) // 3 + 1
    assert _any_edit_called_authentic(key, embedding, trials, seed=1) == []


def test_no_delivery_out_of_turn_is_called_authentic(key: KeyFile) -> None:
    """Replays, rollbacks, exchanged records, edits and what the report names, in one stream."""
    random = np.random.default_rng(2)
    trials = int(os.environ.get("MANIP3D_WATERMARK_EDITS", "10000")) // 10
    sender = marker_of(key)
    sent = [sender.embed(frame(600, n)) for n in range(60)]
    verifier, accepted, done = marker_of(key), -1, dict.fromkeys(DELIVERIES, 0)
    for _ in range(trials):
        if accepted > len(sent) - 3:  # the stream is over; the next verifier begins anew
            verifier, accepted = marker_of(key), -1
        kind = str(random.choice(DELIVERIES)) if accepted >= 0 else "next"
        number = int(random.integers(accepted + 1)) if kind == "rollback" else accepted + 1
        scan, record = sent[number].frame, sent[number].record
        if kind == "edit":
            scan, record, _ = _edits(random, sent[number])
        elif kind == "record of another frame":
            record = sent[(number + 1 + int(random.integers(len(sent) - 1))) % len(sent)].record
        elif kind == "oracle":
            scan, _, _ = _edits(random, sent[number])
            found = verifier.verify(scan, record)
            points = scan.points.copy()
            points[found.suspected, 2] += np.float32(0.001)
            scan = scan.replace(points=points)
        told = verifier.verify(scan, record).verdict
        if told == "authentic":
            assert record == sent[number].record
            assert number > accepted, kind
            assert rows_of(scan) == rows_of(sent[number].frame), kind
            accepted = number
            done[kind] += 1
        elif kind == "next":
            # A genuine record of a later frame came before: its verifier knows no earlier ones.
            verifier, accepted = marker_of(key), -1
    assert done["next"] >= trials // 20
    assert done["rollback"] == done["record of another frame"] == 0


DELIVERIES = ("next", "rollback", "edit", "record of another frame", "oracle")


def test_the_report_is_no_oracle_for_forging(key: KeyFile) -> None:
    """Move a point, ask which bits are wrong, flip those, ask again: never accepted."""
    sent = marker_of(key).embed(frame())
    points = sent.points.copy()
    points[100] += np.float32(0.25)
    units = np.rint(points.astype(np.float64) * 1000).astype(np.int64)
    for _ in range(4):
        forged = sent.frame.replace(points=(units / 1000).astype(np.float32))
        found = verify(key, forged, sent.record)
        assert found.verdict == "tampered"
        tile_of_forged = [n for n in found.changed_tiles if found.tiles[n].state == "changed"]
        assert tile_of_forged
        assert len(found.suspected) == 0  # nothing to flip
        units[100] ^= 1


def test_swapped_records_are_refused(key: KeyFile) -> None:
    marker = marker_of(key)
    sent = [marker.embed(frame(1000, n)) for n in range(6)]
    for a in range(6):
        for b in range(6):
            found = verify(key, sent[a].frame, sent[b].record)
            assert (found.verdict == "authentic") == (a == b)


def test_tiles_of_two_frames_cannot_be_joined(key: KeyFile) -> None:
    marker = marker_of(key)
    one, two = marker.embed(frame(seed=1)), marker.embed(frame(seed=1))  # the same scene twice
    left = one.points[:, 1] > 0
    joined = np.where(left[:, None], one.points, two.points)
    for record in (one.record, two.record):
        found = verify(key, one.frame.replace(points=joined), record)
        assert found.verdict == "tampered"


# --- Keys, policies, order -----------------------------------------------------------------------


def test_another_key_verifies_nothing(key: KeyFile, tmp_path: Path) -> None:
    sent = marker_of(key).embed(frame())
    found = verify(KeyFile.create(tmp_path / "other.key"), sent.frame, sent.record)
    assert (found.verdict, found.content) == ("undecidable", "unverifiable")
    assert found.tiles == ()
    assert found.number is None


def test_the_policy_decides_and_not_the_record(key: KeyFile) -> None:
    sent = marker_of(key, sensor="roof").embed(frame())
    good = verify(key, sent.frame, sent.record, sensors=("roof",))
    assert good.verdict == "authentic"
    for policy in (
        {"embeddings": ("qim",)},
        {"sensors": ("trunk",)},
        {"sessions": ("00" * 16,)},
        {"max_points": 5999},
    ):
        assert verify(key, sent.frame, sent.record, **policy).verdict == "undecidable"
    assert verify(key, sent.frame, sent.record, sessions=(good.session,)).verdict == "authentic"


def test_frames_are_a_chain(key: KeyFile) -> None:
    marker = marker_of(key)
    sent = [marker.embed(frame(1000, n), is_end=n == 5) for n in range(6)]
    verifier = Watermarker(key)

    def see(n: int) -> tuple[str, str, int]:
        found = verifier.verify(sent[n].frame, sent[n].record)
        return found.verdict, found.order, found.gap

    assert see(0) == ("authentic", "in order", 0)
    assert see(1) == ("authentic", "in order", 0)
    assert see(1) == ("tampered", "replay", 0)
    assert see(4) == ("undecidable", "gap", 2)
    assert see(3) == ("tampered", "replay", 0)
    assert see(5) == ("authentic", "in order", 0)
    assert see(0) == ("tampered", "replay", 0)
    with pytest.raises(Error, match="ended"):
        marker.embed(frame())

    other = marker_of(key)
    next_session = [other.embed(frame(1000, n)) for n in range(2)]
    assert verifier.verify(next_session[0].frame, next_session[0].record).order == "in order"
    assert see(5) == ("tampered", "replay", 0)  # of a session that is over

    verifier.reset()
    assert see(2) == ("undecidable", "unknown", 0)
    assert see(3) == ("authentic", "in order", 0)


@pytest.mark.parametrize("num_foreign", [1, 2])
def test_frames_of_other_sessions_do_not_break_the_chain(
    key: KeyFile, num_foreign: int, tmp_path: Path
) -> None:
    """The verifier continues with the session after them, but frames that were seen are replays."""
    genuine, *others = (
        [marker.embed(frame(400, n), is_end=n == 7) for n in range(8)]
        for marker in (marker_of(key), marker_of(key), marker_of(key))
    )
    inserted = [other[n] for other, n in zip(others[:num_foreign], (2, 0), strict=False)]
    first = 2 + num_foreign
    sent = [*genuine[:2], *inserted, *genuine[first:]]
    results = []
    for each in sent:  # the state file remembers the sessions that were left
        with Watermarker(key, state=tmp_path / "seen") as verifier:
            results.append(verifier.verify(each.frame, each.record))
    assert [found.verdict for found in results] == [
        *["authentic"] * 2,
        *["undecidable"] * (num_foreign + 1),
        *["authentic"] * (7 - first),
    ]
    for found in results[2:first]:
        assert found.reason.endswith("the frame is of another session than the one before it")
    assert (results[first].order, results[first].gap) == ("gap", num_foreign)
    last = f"to {first} " if num_foreign > 1 else ""
    for whole in (True, False):
        verdict, reason = verdict_of_stream(results, whole=whole)
        assert verdict == "tampered"
        assert reason.startswith(f"frame{'s' if last else ''} 3 {last}(counted from 1)")
    tally = StreamTally()
    tally.skip()  # a frame that `alert run` left out
    for found in results:
        tally.add(found)
    assert tally.splice.startswith(f"frame{'s' if last else ''} 4 ")
    with Watermarker(key, state=tmp_path / "seen") as verifier:
        for each in (*genuine, inserted[0]):
            found = verifier.verify(each.frame, each.record)
            assert (found.verdict, found.order) == ("tampered", "replay")


def test_a_session_that_begins_anew_without_an_end_of_the_old_one(key: KeyFile) -> None:
    """A device that was stopped begins a new session; whether frames are lost cannot be told."""
    old, new = (
        [marker.embed(frame(400, n)) for n in range(3)]
        for marker in (marker_of(key), marker_of(key))
    )
    verifier = Watermarker(key)
    results = [verifier.verify(each.frame, each.record) for each in (*old[:2], *new)]
    assert [found.order for found in results] == ["in order"] * 2 + ["gap"] + ["in order"] * 2
    assert verdict_of_stream(results)[0] == "undecidable"
    late = verifier.verify(old[2].frame, old[2].record)  # was held back until now
    assert (late.verdict, late.order) == ("undecidable", "gap")
    assert verdict_of_stream([*results, late])[0] == "tampered"
    assert verifier.verify(old[1].frame, old[1].record).order == "replay"


def test_a_tampered_frame_does_not_break_the_chain(key: KeyFile) -> None:
    marker, verifier = marker_of(key), Watermarker(key)
    sent = [marker.embed(frame(1000, n), is_end=n == 2) for n in range(3)]
    results = [
        verifier.verify(sent[0].frame, sent[0].record),
        verifier.verify(sent[1].frame.select(np.arange(999)), sent[1].record),
        verifier.verify(sent[2].frame, sent[2].record),
    ]
    assert [found.verdict for found in results] == ["authentic", "tampered", "authentic"]
    assert verdict_of_stream(results)[0] == "tampered"
    assert verdict_of_stream(results[:1])[0] == "undecidable"  # no end
    assert verdict_of_stream(results[2:])[0] == "undecidable"  # no beginning
    assert verdict_of_stream(results[2:], whole=False)[0] == "authentic"


def test_several_sessions_are_no_whole_drive(key: KeyFile) -> None:
    """A verifier takes a session's first frame wherever the one before it has ended."""
    single = [marker_of(key).embed(frame(1000, n), is_end=True) for n in range(4)]
    verifier = Watermarker(key)
    results = [verifier.verify(single[n].frame, single[n].record) for n in (2, 0, 3)]
    assert [found.verdict for found in results] == ["authentic"] * 3
    verdict, reason = verdict_of_stream(results)
    assert verdict == "undecidable"
    assert "3 sessions" in reason
    assert verdict_of_stream(results, whole=False)[0] == "authentic"
    assert verdict_of_stream(results[:1])[0] == "authentic"


def test_the_state_survives_and_cannot_be_forged(key: KeyFile, tmp_path: Path) -> None:
    marker = marker_of(key)
    sent = [marker.embed(frame(500, n)) for n in range(3)]
    state = tmp_path / "seen.state"
    with Watermarker(key, state=state) as verifier:
        assert verifier.verify(sent[0].frame, sent[0].record).order == "in order"
    with Watermarker(key, state=state) as verifier:
        assert verifier.verify(sent[0].frame, sent[0].record).order == "replay"
        assert verifier.verify(sent[1].frame, sent[1].record).order == "in order"
    text = bytearray(state.read_bytes())
    text[20] ^= 1
    state.write_bytes(text)
    with pytest.raises(FormatError, match=r"seen\.state.*damaged"):
        Watermarker(key, state=state)


def test_old_frames_are_stale(key: KeyFile) -> None:
    sent = marker_of(key).embed(frame(), time_ns=10**18)
    verifier = Watermarker(key)
    policy = Policy(max_age_s=1.0)
    late = verifier.verify(sent.frame, sent.record, policy=policy, now_ns=10**18 + 2 * 10**9)
    assert (late.verdict, late.freshness) == ("undecidable", "stale")
    assert late.reason == "the content holds, but the frame is too old"
    verifier.reset()
    early = verifier.verify(sent.frame, sent.record, policy=policy, now_ns=10**18 - 2 * 10**9)
    assert (early.verdict, early.freshness) == ("undecidable", "stale")
    assert early.reason == "the content holds, but the frame states a time to come"
    verifier.reset()
    soon = verifier.verify(sent.frame, sent.record, policy=policy, now_ns=10**18 + 10**8)
    assert (soon.verdict, soon.freshness) == ("authentic", "fresh")


@pytest.mark.parametrize("age", [4e-10, 1e-300])
def test_an_age_below_a_nanosecond_is_an_age(age: float, key: KeyFile) -> None:
    """Rounded to nanoseconds it would be 0, which accepts any age."""
    sent = marker_of(key).embed(frame(), time_ns=10**15)
    for later, freshness in ((1, "fresh"), (2, "stale"), (10**9, "stale")):
        found = Watermarker(key).verify(
            sent.frame, sent.record, policy=Policy(max_age_s=age), now_ns=10**15 + later
        )
        assert found.freshness == freshness


# --- Key files -----------------------------------------------------------------------------------


def test_key_files_are_private_and_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "sensor.key"
    created = KeyFile.create(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.stat().st_size == 112
    assert created.key_id == KeyFile(path).key_id
    text = path.read_bytes()
    with pytest.raises(FileExistsError):
        KeyFile.create(path)
    assert path.read_bytes() == text
    assert [p.name for p in tmp_path.iterdir()] == ["sensor.key"]
    for mode in (0o640, 0o604, 0o660, 0o644):
        path.chmod(mode)
        with pytest.raises(InputError, match="only its owner"):
            KeyFile(path)
    assert text[48:80].hex() not in repr(created)
    with pytest.raises(FileNotFoundError):
        KeyFile(tmp_path / "absent.key")
    with pytest.raises(TypeError):
        pickle.dumps(created)


@pytest.mark.parametrize("damage", ["flip", "cut", "longer", "empty", "kind"])
def test_damaged_key_files_are_refused(tmp_path: Path, damage: str) -> None:
    path = key_file(tmp_path / "sensor.key")
    text = bytearray(path.read_bytes())
    if damage == "flip":
        text[60] ^= 1
    elif damage == "cut":
        del text[100:]
    elif damage == "longer":
        text += b"\0"
    elif damage == "empty":
        text.clear()
    else:
        text[8] = 2
    path.write_bytes(text)
    with pytest.raises(FormatError, match=r"sensor\.key"):
        KeyFile(path)


def test_an_expired_key_embeds_no_more(tmp_path: Path) -> None:
    key = KeyFile(key_file(tmp_path / "old.key", expires_ns=10**9))
    with pytest.raises(InputError, match="expired"):
        marker_of(key).embed(frame())


def test_closed_objects_say_so(key: KeyFile) -> None:
    marker = marker_of(key)
    sent = marker.embed(frame())
    marker.close()
    marker.close()
    with pytest.raises(Error, match="closed"):
        marker.embed(frame())
    with pytest.raises(Error, match="closed"):
        marker.verify(sent.frame, sent.record)
    key.close()
    key.close()
    with pytest.raises(Error, match="closed"):
        Watermarker(key)


PROGRAM = """
import sys, numpy as np
from manip3d.authenticate import KeyFile, Watermarker
key = KeyFile(sys.argv[1])
marker = Watermarker(key, round_points=True, least_points=10)
sent = marker.embed(np.random.default_rng(0).uniform(-9, 9, (5000, 3)).astype(np.float32))
assert marker.verify(sent.frame, sent.record).verdict == "authentic"
if sys.argv[2] == "close":
    marker.close(); key.close()
print("ready", flush=True)
sys.stdin.read()
"""


def _memory_holds(process: int, secret: bytes) -> bool:
    """Whether a part of the process's memory that it can write holds the bytes."""
    with open(f"/proc/{process}/maps") as maps, open(f"/proc/{process}/mem", "rb", 0) as memory:
        for line in maps:
            span, mode, *_ = line.split()
            if not mode.startswith("rw"):
                continue
            begin, end = (int(text, 16) for text in span.split("-"))
            memory.seek(begin)
            try:
                if secret in memory.read(end - begin):
                    return True
            except OSError:  # guard pages
                continue
    return False


@pytest.mark.parametrize("how", ["close", "keep"])
def test_no_key_in_memory_after_close(tmp_path: Path, how: str) -> None:
    path = KeyFile.create(tmp_path / "sensor.key") and tmp_path / "sensor.key"
    secret = path.read_bytes()[48:80]
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(path), how], stdin=-1, stdout=-1
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        try:
            found = _memory_holds(process.pid, secret)
        except PermissionError:
            pytest.skip("this system does not let a parent read its child's memory")
        finally:
            process.communicate()
    assert found == (how == "keep")  # the search itself finds a key that is still held


# --- Degenerate input ----------------------------------------------------------------------------


@pytest.mark.parametrize("embedding", ALL)
@pytest.mark.parametrize(
    "make",
    [
        lambda: np.empty((0, 3), np.float32),
        lambda: np.zeros((1, 3), np.float32),
        lambda: np.zeros((500, 3), np.float32),
        lambda: np.full((3000, 3), 1.0, np.float32),
        lambda: grid_scan(14),
        lambda: np.float32([[x, 0, 0] for x in range(3000)]),
        lambda: np.float32([[3999.998, -3999.998, 3999.998], [1, 2, 3]]),
    ],
)  # fmt: skip
def test_odd_scans_verify(key: KeyFile, embedding: str, make: Callable[[], Points]) -> None:
    sent = marker_of(key, embedding).embed(make())
    assert verify(key, sent.frame, sent.record).verdict == "authentic"


@pytest.mark.parametrize("embedding", ALL)
def test_an_empty_frame_is_signed_as_empty(key: KeyFile, embedding: str) -> None:
    marker, verifier = marker_of(key, embedding), Watermarker(key)
    empty = np.empty((0, 3), np.float32)
    sent = [marker.embed(points) for points in (grid_scan(900), empty, grid_scan(900, seed=1))]
    found = [verifier.verify(each.frame, each.record) for each in sent]
    assert [(each.verdict, each.order) for each in found] == [("authentic", "in order")] * 3
    for points in (np.float32([[0, 0, 0]]), grid_scan(900)):
        assert verify(key, LidarFrame(points), sent[1].record).verdict == "tampered"
    assert verify(key, LidarFrame(empty), sent[0].record).verdict == "tampered"


def test_a_frame_without_its_scan_keeps_its_place(key: KeyFile) -> None:
    marker, verifier = marker_of(key), Watermarker(key)
    sent = [marker.embed(frame(1000, n), is_end=n == 2) for n in range(3)]
    assert verifier.verify(sent[0].frame, sent[0].record).verdict == "authentic"
    found = verifier.verify_without_scan(sent[1].record, "unreadable")
    assert (found.verdict, found.reason, found.number) == ("undecidable", "unreadable", 1)
    assert (found.content, found.tiles) == ("unverifiable", ())
    assert verifier.verify(sent[2].frame, sent[2].record).verdict == "authentic"
    again = verifier.verify_without_scan(sent[1].record, "unreadable")
    assert (again.verdict, again.order) == ("tampered", "replay")
    assert verifier.verify_without_scan(None, "unreadable").verdict == "undecidable"


def test_bad_input_is_refused(key: KeyFile) -> None:
    marker = marker_of(key)
    for bad in (np.nan, np.inf):
        with pytest.raises(InputError, match="finite"):
            marker.embed(np.float32([[1, 2, bad]]))
        with pytest.raises(InputError, match="finite"):
            marker.verify(np.float32([[1, 2, bad]]), b"")
    for far in (4e3, 1e6, 1e30):
        with pytest.raises(InputError, match="grid"):
            marker.embed(np.float32([[1, 2, far]]))
    with pytest.raises(InputError, match="embedding"):
        Watermarker(key, embedding="qim-printed")
    with pytest.raises(InputError, match="16 bytes"):
        Watermarker(key, sensor="a name that is too long")
    for options in ({"slices": 3}, {"slices": 361}, {"least_points": 0}):
        with pytest.raises(InputError, match=next(iter(options))):
            Watermarker(key, **options)  # type: ignore[arg-type]
    off = np.array([[1.0001, 2, 3]])
    scan = LidarFrame(off.astype(np.float32), exact=off)
    with pytest.raises(InputError, match="grid of 1 mm"):
        marker.embed(scan)


@pytest.mark.parametrize("shine", [True, False])
def test_coordinates_in_float64_are_bound_by_a_detached_record(key: KeyFile, shine: bool) -> None:
    """A survey in a national grid: 0.1 micrometre at 5 000 km is beyond float32, not float64."""
    random = np.random.default_rng(3)
    corner = np.array([5e6, 4e5, 200.0])
    exact = random.uniform(-40, 40, (3000, 3)) + corner
    points = (exact - corner).astype(np.float32)
    scan = LidarFrame(points, reflectances(3000) if shine else None, exact=exact)
    sent = marker_of(key, "detached").embed(scan)
    assert np.array_equal(sent.frame.exact, exact)  # type: ignore[arg-type]
    order = random.permutation(3000)
    assert verify(key, sent.frame.select(order), sent.record).verdict == "authentic"

    moved = exact.copy()
    moved[77, 1] += 1e-7
    changed = scan.replace(exact=moved)
    assert np.array_equal(changed.points, scan.points)
    found = verify(key, changed, sent.record)
    assert (found.verdict, found.content) == ("tampered", "tampered")
    assert "float32" in found.reason
    swapped = exact.copy()
    swapped[[3, 4]] = swapped[[4, 3]]
    assert verify(key, scan.replace(exact=swapped), sent.record).verdict == "tampered"

    rounded = verify(key, scan.replace(exact=None), sent.record)
    assert (rounded.verdict, rounded.content) == ("undecidable", "unverifiable")
    assert "float32 part only" in rounded.reason
    bare = marker_of(key, "detached").embed(scan.replace(exact=None))
    assert verify(key, scan.replace(exact=None), bare.record).verdict == "authentic"
    assert verify(key, scan, bare.record).verdict == "undecidable"
    with pytest.raises(InputError, match="'lbm' or 'detached'"):
        marker_of(key, "qim").embed(scan)


@pytest.mark.parametrize("embedding", ALL)
@pytest.mark.parametrize("suffix", [".csv", ".xyz", ".pts", ".ptx", ".las"])
def test_float32_points_that_became_decimals_are_authentic(
    key: KeyFile, tmp_path: Path, embedding: str, suffix: str
) -> None:
    """The float32 nearest to 12.345 is 12.34500026, and files say 12.345 or 12.3450003."""
    if suffix == ".las":
        pytest.importorskip("laspy")
    sent = marker_of(key, embedding).embed(LidarFrame(grid_scan(3000), reflectances(3000)))
    io.write_scan(sent.frame, tmp_path / f"a{suffix}")
    read = io.read_scan(tmp_path / f"a{suffix}")
    assert read.exact is not None
    is_moved = (suffix, embedding) == (".las", "qim")  # its cells are no whole steps of 0.1 mm
    assert verify(key, read, sent.record).verdict == ("tampered" if is_moved else "authentic")


@pytest.mark.filterwarnings("ignore:where the scanner stood is not known")
@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".bin"])
@pytest.mark.parametrize("embedding", ["lbm", "detached"])
def test_decimals_are_signed_in_float32_for_files_that_hold_no_more(
    key: KeyFile, tmp_path: Path, embedding: str, suffix: str
) -> None:
    rows = np.random.default_rng(5).uniform(-40, 40, (3000, 3))
    (tmp_path / "a.xyz").write_text("\n".join("{:.9f} {:.9f} {:.9f}".format(*row) for row in rows))
    assert io.read_scan(tmp_path / "a.xyz").exact is not None
    target = tmp_path / f"b{suffix}"
    with Watermarker(key, embedding=embedding, round_points=True) as marker:
        embed_files(marker, tmp_path / "a.xyz", target)
    found = verify(key, io.read_scan(target), read_record(record_path(target)))
    assert found.verdict == "authentic", found.reason


def test_coordinates_that_are_too_far_away_are_named(key: KeyFile) -> None:
    exact = np.array([[4.5e8, 1.0, 2.0], [4.5e8, 3.0, 4.0]])
    scan = LidarFrame(exact.astype(np.float32), exact=exact)
    with pytest.raises(InputError, match=r"^points: .* 2\^37 steps .* \(450000000, 2, 3\) m"):
        Watermarker(key).embed(scan)
    with pytest.raises(InputError, match=r"^origin: .* \(450000000, 0, 0\) m"):
        Watermarker(key, origin=(4.5e8, 0.0, 0.0)).embed(scan)


def test_a_chain_takes_one_version_of_a_frame_that_was_signed_twice(key: KeyFile) -> None:
    first, lost = Watermarker(key), Watermarker(key)
    kept = first.embed(grid_scan(3000, seed=1))
    twice = first.embed(grid_scan(3000, seed=2), time_ns=1)
    lost.resume(kept.record)
    again = lost.embed(grid_scan(3000, seed=2), time_ns=2)
    last = lost.embed(grid_scan(3000, seed=3))
    assert (twice.number, again.number) == (1, 1)

    def verdicts(*frames: Watermarked, order: str = "chain") -> list[str]:
        with Watermarker(key) as verifier:
            policy = Policy(order=order)
            return [verifier.verify(f.frame, f.record, policy=policy).verdict for f in frames]

    assert verdicts(twice, order="any") == verdicts(again, order="any") == ["authentic"]
    assert verdicts(kept, again, last) == 3 * ["authentic"]
    assert verdicts(kept, twice, last) == ["authentic", "authentic", "undecidable"]
    assert verdicts(kept, twice, again) == ["authentic", "authentic", "tampered"]
    assert verdicts(kept, again, twice, last) == [*2 * ["authentic"], "tampered", "authentic"]


@pytest.mark.parametrize("embedding", ALL)
def test_intensities_of_0_where_none_were_signed_are_no_edit(key: KeyFile, embedding: str) -> None:
    """KITTI's files and LAS have a column of intensities, whatever was measured."""
    sent = marker_of(key, embedding).embed(grid_scan(3000))
    shine = np.zeros(3000, np.float32)
    assert verify(key, sent.frame.replace(intensity=shine), sent.record).verdict == "authentic"
    shine[7] = 0.01
    found = verify(key, sent.frame.replace(intensity=shine), sent.record)
    assert (found.verdict, len(found.changed_tiles)) == ("tampered", 1)


@pytest.mark.parametrize("embedding", ALL)
@pytest.mark.parametrize("is_zero", [False, True])
def test_without_the_intensities_that_were_signed_nothing_is_authentic(
    key: KeyFile, embedding: str, is_zero: bool
) -> None:
    """Tools drop the column. Numbers of points and the lattice still reveal a change."""
    shine = np.float32(not is_zero) * reflectances(3000)
    signer = marker_of(key, embedding)
    first, second = (
        signer.embed(LidarFrame(grid_scan(3000, n), shine), is_end=n == 1) for n in range(2)
    )
    without = first.frame.replace(intensity=None)
    verifier = marker_of(key, embedding)
    found = verifier.verify(without, first.record)
    assert (found.verdict, found.content) == ("undecidable", "unverifiable")
    assert found.reason == "intensities were signed, and the scan has none"
    assert (found.tiles, found.order) == ((), "in order")
    assert verifier.verify(second.frame, second.record).order == "in order"
    assert verifier.verify(without, first.record).verdict == "tampered"  # it is a replay
    moved = without.points.copy()
    moved[7] = moved[8]
    same_tile = verify(key, without.replace(points=moved), first.record)
    assert same_tile.verdict in ("undecidable", "tampered")
    fewer = verify(key, without.select(np.arange(3000) != 7), first.record)
    assert (fewer.verdict, len(fewer.changed_tiles)) == ("tampered", 1)
    more = LidarFrame(np.vstack([without.points, moved[7:8]]))
    assert verify(key, more, first.record).verdict == "tampered"
    assert verify(key, without.replace(num_dropped=1), first.record).verdict == "tampered"


def test_changed_intensities_are_named(key: KeyFile) -> None:
    sent = marker_of(key, "lbm").embed(LidarFrame(grid_scan(3000), reflectances(3000)))
    assert sent.frame.intensity is not None
    brighter = sent.frame.replace(intensity=255 * sent.frame.intensity)
    reason = verify(key, brighter, sent.record).reason
    assert reason.startswith("points or intensities of ")
    plain = marker_of(key, "lbm").embed(grid_scan(3000))
    gone = verify(key, plain.frame.select(np.arange(3000) > 5), plain.record)
    assert gone.reason.startswith("points of ")


def with_zeros(scan: LidarFrame, zero: float) -> LidarFrame:
    """The scan with some coordinates and intensities of 0 or -0, on all axes."""
    points = scan.points.copy()
    points[::7, 0] = points[::11, 1] = points[::13, 2] = zero
    assert scan.intensity is not None
    return scan.replace(
        points=points, intensity=np.where(scan.intensity < 0.2, zero, scan.intensity)
    )


@pytest.mark.parametrize("embedding", ALL)
@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_the_sign_of_a_zero_is_no_edit(key: KeyFile, embedding: str, zero: float) -> None:
    """-0 equals 0. Scanners write both, and LAS and a sum with 0 only the latter."""
    sent = marker_of(key, embedding).embed(with_zeros(frame(3000), zero))
    marked = sent.frame
    assert marked.intensity is not None
    assert verify(key, marked, sent.record).verdict == "authentic"
    positive = marked.replace(points=marked.points + 0.0, intensity=marked.intensity + 0.0)
    negative = positive.replace(
        points=np.where(positive.points == 0, np.float32(-0.0), positive.points),
        intensity=np.where(marked.intensity == 0, np.float32(-0.0), marked.intensity),
    )
    for scan in (positive, negative):
        assert np.array_equal(scan.points, marked.points)
        assert verify(key, scan, sent.record).verdict == "authentic"
    # Nothing else is forgiven: the smallest numbers beside 0, and one bit of another number.
    row = np.flatnonzero((positive.points == 0).any(axis=1))[5]
    axis = int(np.flatnonzero(positive.points[row] == 0)[0])
    for tiny in (1e-45, -1e-45):
        points = negative.points.copy()
        points[row, axis] = tiny
        assert verify(key, negative.replace(points=points), sent.record).verdict == "tampered"
    points = positive.points.copy()
    points[1, 0] = np.nextafter(points[1, 0], np.float32(9e9))
    assert verify(key, positive.replace(points=points), sent.record).verdict == "tampered"
    shine = negative.intensity.copy()  # type: ignore[union-attr]
    shine[np.flatnonzero(shine == 0)[3]] = 1e-45
    assert verify(key, negative.replace(intensity=shine), sent.record).verdict == "tampered"


@pytest.mark.parametrize("embedding", [oracle.DETACHED, oracle.LBM])
def test_early_records_that_bound_the_signs_of_zeros_verify(key: KeyFile, embedding: int) -> None:
    scan = with_zeros(frame(3000), -0.0)
    assert scan.intensity is not None
    signer = oracle.Embedder(
        ROOT_KEY, b"sensor".ljust(16, b"\0"), bytes(16), embedding, least=150, binds_signs=True
    )
    points = [tuple(map(float, row)) for row in scan.points]
    sent = signer.embed(points, [float(value) for value in scan.intensity])
    marked = scan.replace(points=np.array(sent.points, np.float32))
    assert np.signbit(marked.intensity[marked.intensity == 0]).all()  # type: ignore[index]
    assert verify(key, marked, sent.record).verdict == "authentic"
    # Such a record holds for the signs that were signed only, and locates what was moved.
    shine = scan.intensity.copy()
    shine[np.flatnonzero(shine == 0)[0]] = 0.0
    assert verify(key, marked.replace(intensity=shine), sent.record).verdict == "tampered"
    moved = marked.points.copy()
    moved[1, 2] += 1.0
    found = verify(key, marked.replace(points=moved), sent.record)
    assert (found.verdict, len(found.changed_tiles)) == ("tampered", 1)


@pytest.mark.parametrize("zero", [0.0, -0.0])
def test_the_sign_of_a_zero_in_float64_is_no_edit(key: KeyFile, zero: float) -> None:
    exact = np.random.default_rng(3).uniform(-40, 40, (3000, 3))
    exact[::7, 0] = exact[::5, 2] = zero
    scan = LidarFrame(exact.astype(np.float32), reflectances(3000), exact=exact)
    sent = marker_of(key, "detached").embed(scan)
    for other in (exact + 0.0, np.where(exact == 0, -0.0, exact)):
        changed = scan.replace(points=other.astype(np.float32), exact=other)
        assert verify(key, changed, sent.record).verdict == "authentic"
    moved = exact.copy()
    moved[7, 0] = 1e-300
    assert verify(key, scan.replace(exact=moved), sent.record).verdict == "tampered"


def test_digits_beyond_the_float32_that_was_signed_are_undecidable(key: KeyFile) -> None:
    sent = marker_of(key, "lbm").embed(grid_scan(3000))
    exact = np.round(sent.points.astype(np.float64), 3)
    scan = sent.frame.replace(exact=exact)
    assert verify(key, scan, sent.record).verdict == "authentic"
    longer = exact.copy()
    longer[7, 0] += 1e-8
    assert np.array_equal(longer.astype(np.float32), sent.points)
    assert verify(key, scan.replace(exact=longer), sent.record).verdict == "undecidable"


def test_five_million_points(key: KeyFile) -> None:
    random = np.random.default_rng(0)
    points = (random.integers(-60_000, 60_000, (5_000_000, 3)) / 1000).astype(np.float32)
    sent = Watermarker(key).embed(points)
    assert verify(key, sent.frame, sent.record).verdict == "authentic"
    changed = sent.points.copy()
    changed[4_000_000, 1] += np.float32(0.002)
    assert verify(key, sent.frame.replace(points=changed), sent.record).verdict == "tampered"


def test_many_equal_points_take_no_longer(key: KeyFile) -> None:
    """Ties are sorted by comparisons, and never in quadratic time."""
    points = np.zeros((400_000, 3), np.float32)
    points[:, 0] = np.repeat(np.arange(200_000) % 3, 2)
    sent = Watermarker(key).embed(points)
    assert verify(key, sent.frame, sent.record).verdict == "authentic"


def test_every_cut_of_a_record_is_undecidable(key: KeyFile) -> None:
    sent = marker_of(key).embed(frame(300))
    for size in range(len(sent.record)):
        assert verify(key, sent.frame, sent.record[:size]).verdict == "undecidable"
    whole = verify(key, sent.frame, sent.record)
    assert whole.verdict == "authentic"
    assert struct.pack("<Q", whole.number) in sent.record
    assert ROOT_KEY not in sent.record
