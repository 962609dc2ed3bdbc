"""The watermark as printed: it holds, and a forgery that needs no key passes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from watermark_oracle import slice_of

import manip3d
from manip3d import LidarFrame
from manip3d.authenticate import (
    PAPER_EMBEDDINGS,
    KeyFile,
    Policy,
    Watermarker,
    compare_paper,
    embed_paper,
    noise_blocks,
)
from manip3d.errors import InputError
from real_data import RealData
from watermark_scans import grid_scan, key_file, reflectances

BLOCKS = noise_blocks(1, block_bits=100)

MAX_MOVE_M = {"lbm": 3**0.5 / 1000, "qim": 0.001875, "qim-printed": 0.00125}
"""Largest moves; the first and the last are the published Hausdorff distances."""


def frame(count: int = 6000, seed: int = 0) -> LidarFrame:
    points = grid_scan(count, seed)
    points[9:12] = [[1, 2, 1]]
    return LidarFrame(points, reflectances(count, seed))


@pytest.mark.parametrize("embedding", PAPER_EMBEDDINGS)
@pytest.mark.parametrize("extraction", ["compare_all", "paper_and"])
@pytest.mark.parametrize("merge", ["adjacent", "paper"])
def test_no_wrong_bit(embedding: str, extraction: str, merge: str) -> None:
    sent = embed_paper(frame(), BLOCKS, embedding=embedding, key_2=7, frame=3, merge=merge)
    moved = sent.frame.points.astype(np.float64) - frame().points
    farthest = np.sqrt((moved**2).sum(axis=1)).max()
    assert 0.9 * MAX_MOVE_M[embedding] < farthest <= MAX_MOVE_M[embedding] + 4e-6
    shuffled = sent.frame.select(np.random.default_rng(1).permutation(6000))
    found = compare_paper(shuffled, BLOCKS, sent.metadata, extraction=extraction)
    assert found.verdict == "consistent"
    assert not found.mismatches.any()


@pytest.mark.parametrize("embedding", PAPER_EMBEDDINGS)
def test_other_bits_keys_and_frames_differ_in_half_of_the_points(embedding: str) -> None:
    sent = embed_paper(frame(), BLOCKS, embedding=embedding, key_2=7, frame=3)
    other = compare_paper(sent.frame, noise_blocks(2, block_bits=100), sent.metadata)
    assert other.verdict == "inconsistent"
    assert 0.45 < other.mismatches.sum() / 6000 < 0.55


@pytest.mark.parametrize("embedding", PAPER_EMBEDDINGS)
def test_a_moved_object_is_noticed_in_its_tile(embedding: str) -> None:
    sent = embed_paper(frame(), BLOCKS, embedding=embedding)
    points = sent.frame.points.copy()
    angle = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    points[(angle > 41) & (angle < 49), 0] += np.float32(0.1)
    points[(angle > 41) & (angle < 49), 2] += np.float32(0.5)
    found = compare_paper(sent.frame.replace(points=points), BLOCKS, sent.metadata)
    assert found.verdict == "inconsistent"
    assert set(found.changed_tiles) <= {3, 4, 5}
    assert 4 in found.changed_tiles


def test_and_hides_changes_from_0_to_1() -> None:
    sent = embed_paper(frame(), BLOCKS)
    units = np.rint(sent.frame.points.astype(np.float64) * 1000).astype(np.int64)
    hidden = 0
    for row in range(100, 160):
        one = units.copy()
        one[row] ^= 1
        scan = sent.frame.replace(points=(one / 1000).astype(np.float32))
        assert compare_paper(scan, BLOCKS, sent.metadata).suspected.tolist() == [row]
        by_and = compare_paper(scan, BLOCKS, sent.metadata, extraction="paper_and")
        hidden += by_and.verdict == "consistent"
    assert 15 < hidden < 50


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(InputError, match="blocks"):
        embed_paper(frame(), np.full((36, 100), 2))
    with pytest.raises(InputError, match="blocks"):
        embed_paper(frame(), np.zeros(100))
    with pytest.raises(InputError, match="embedding"):
        embed_paper(frame(), BLOCKS, embedding="detached")
    with pytest.raises(InputError, match="at least one"):
        embed_paper(np.empty((0, 3), np.float32), BLOCKS)
    sent = embed_paper(frame(), BLOCKS)
    with pytest.raises(InputError, match="metadata"):
        compare_paper(frame(), BLOCKS[:35], sent.metadata)
    for wrong in ([0.5] * 36, [-1] * 36, [[0] * 36]):
        with pytest.raises(InputError, match="tile_of_slice: expected"):
            replace(sent.metadata, tile_of_slice=wrong)


def test_metadata_may_be_lists() -> None:
    sent = embed_paper(frame(), BLOCKS)
    tiles, counts = (getattr(sent.metadata, name).tolist() for name in ("tile_of_slice", "counts"))
    lists = replace(sent.metadata, tile_of_slice=tiles, counts=counts)
    assert compare_paper(sent.frame, BLOCKS.tolist(), lists).verdict == "consistent"


# --- The forgery that needs no key ---------------------------------------------------------------


def units_of(points: NDArray[np.float32]) -> NDArray[np.int64]:
    return np.rint(points.astype(np.float64) * 1000).astype(np.int64)


def rank(cleared: NDArray[np.int64], slices: NDArray[np.int64]) -> NDArray[np.intp]:
    """The public order of points: anybody can derive it."""
    x, y, z = cleared.T
    return np.lexsort((y, x, x * x + y * y, z, slices))


def slices_of(cleared: NDArray[np.int64]) -> NDArray[np.int64]:
    angle = np.degrees(np.arctan2(cleared[:, 1], cleared[:, 0])) % 360
    near = np.abs(angle / 10 - np.rint(angle / 10)) < 1e-6  # where floats may be wrong
    slices = (angle // 10).astype(np.int64)
    for row in np.flatnonzero(near):
        slices[row] = slice_of(int(cleared[row, 0]), int(cleared[row, 1]), 36)
    return slices


def reembedded(
    points: NDArray[np.float32], moved: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], int]:
    """Read the bits by rank, move points along their rays to 1.6 times their range, and write the
    same bits back by rank."""
    units = units_of(points)
    cleared, bits = units & ~1, units & 1
    slices = slices_of(cleared)
    read = bits[rank(cleared, slices)]
    forged = cleared.copy()
    forged[moved] = np.rint(cleared[moved] * 1.6).astype(np.int64) & ~1
    stay = slices_of(forged) == slices  # those that would leave their slice are left alone
    forged[~stay] = cleared[~stay]
    order = rank(forged, slices)
    written = forged.copy()
    written[order] |= read
    return (written / 1000).astype(np.float32), int(np.count_nonzero(moved & stay))


def sector(points: NDArray[np.float32], low: float, high: float) -> NDArray[np.bool_]:
    angle = np.degrees(np.arctan2(points[:, 1], points[:, 0])) % 360
    inside: NDArray[np.bool_] = (angle > low) & (angle < high)
    return inside


def without_ties(scan: LidarFrame) -> LidarFrame:
    """The order of the forger's is that of points whose intensities do not matter."""
    cleared = units_of(scan.points) & ~1
    _, first = np.unique(cleared, axis=0, return_index=True)
    return scan.select(np.sort(first))


def check_forgery(scan: LidarFrame, folder: Path, least: int, low: float, high: float) -> int:
    blocks = noise_blocks(1, block_bits=least)
    printed = embed_paper(scan, blocks, key_2=99)
    points, moved = reembedded(printed.frame.points, sector(scan.points, low, high))
    found = compare_paper(scan.replace(points=points), blocks, printed.metadata)
    assert found.verdict == "consistent"  # and no bit is wrong
    assert not found.mismatches.any()

    key = KeyFile(key_file(folder / "key"))
    marker = Watermarker(key, least_points=least)
    sent = marker.embed(scan)
    points, also = reembedded(sent.points, sector(scan.points, low, high))
    caught = marker.verify(
        sent.frame.replace(points=points), sent.record, policy=Policy(order="any")
    )
    assert caught.verdict == "tampered"
    assert also > 0
    spans = [span for n in caught.changed_tiles for span in caught.tiles[n].azimuths_deg]
    assert min(begin for begin, _ in spans) <= low
    assert max(end for _, end in spans) >= high
    assert all(begin < high and end > low for begin, end in spans)
    assert all(tile.state in ("intact", "changed") for tile in caught.tiles)
    return moved


def test_reembedding_passes_as_printed_and_is_caught_with_a_key(tmp_path: Path) -> None:
    assert check_forgery(without_ties(frame()), tmp_path, 100, 41.0, 69.0) > 300


@pytest.mark.realdata
def test_reembedding_a_real_scan(realdata: RealData, tmp_path: Path) -> None:
    drive = "lidar/kitti_raw/2011_09_26/2011_09_26_drive_0002_sync/velodyne_points/data"
    scan = without_ties(manip3d.io.read_scan(realdata(f"{drive}/0000000000.bin.xz")))
    assert check_forgery(scan, tmp_path, 1000, 1.0, 9.0) > 1000


@pytest.mark.realdata
@pytest.mark.parametrize("slices", [3, 361])
def test_the_number_of_slices_is_that_of_the_blocks(slices: int) -> None:
    points = np.ones((10, 3), np.float32)
    with pytest.raises(InputError, match=f"blocks: expected 4 to 360 slices, got {slices}"):
        embed_paper(points, noise_blocks(1, slices=slices, block_bits=2))


def test_blocks_of_another_length_accuse_nobody() -> None:
    sent = embed_paper(frame(), BLOCKS)
    with pytest.raises(InputError, match="blocks: expected 100 bits for each slice, got 50"):
        compare_paper(sent.frame, BLOCKS[:, :50], sent.metadata)


@pytest.mark.parametrize("embedding", PAPER_EMBEDDINGS)
def test_no_wrong_bit_on_real_scans(realdata: RealData, tmp_path: Path, embedding: str) -> None:
    blocks = noise_blocks(3)
    paths = sorted(
        path
        for folder in realdata("lidar").glob("kitti_*")
        if folder.name != "kitti_odometry"  # off the grid
        for path in folder.rglob("*.bin.xz")
    )
    assert len(paths) >= 40
    for number, path in enumerate(paths):
        scan = manip3d.io.read_scan(path)
        sent = embed_paper(scan, blocks, embedding=embedding, frame=number)
        moved = sent.frame.points.astype(np.float64) - scan.points
        farthest = np.sqrt((moved**2).sum(axis=1)).max()
        assert farthest <= MAX_MOVE_M[embedding] + 1.4e-5  # float32 at 80 m
        copy = tmp_path / "copy.bin"
        sent.frame.select(np.random.default_rng(number).permutation(scan.num_points)).write(copy)
        found = compare_paper(manip3d.io.read_scan(copy), blocks, sent.metadata)
        assert found.verdict == "consistent", path
