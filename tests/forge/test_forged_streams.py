"""Forged RGB-D streams: what is the person's, what is the background's, and the truth beside."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from capsule_body import SMALL, frame, pose
from manip3d import (
    FormatError,
    InputError,
    Intrinsics,
    Registration,
    RgbdCalibration,
    RgbdFrame,
    capture,
    forge,
)
from manip3d.forge._plates import _median_seen
from manip3d.forge._stream import _joined_bits
from manip3d.rgbd import NO_BODY

HANDS_UP = {
    "ElbowLeft": (0.45, 0.60, 0.0),
    "WristLeft": (0.50, 0.85, 0.0),
    "HandLeft": (0.51, 0.92, 0.0),
}


def person(number: int = 0, moved: Any = None) -> RgbdFrame:
    seen = frame(pose(moved), SMALL)
    color = np.full((*seen.depth.shape, 3), (200, 40, 40), np.uint8)
    return replace(seen, color=color, number=number, time_ns=number * 33_333_333)


def wall(depth_mm: int = 4000, number: int = 0) -> RgbdFrame:
    shape = (SMALL.height, SMALL.width)
    return RgbdFrame(
        np.full(shape, depth_mm, np.uint16),
        RgbdCalibration(SMALL),
        np.full((*shape, 3), (30, 160, 60), np.uint8),
        number=number,
    )


def one(stream: forge.ForgedStream) -> forge.ForgedFrame:
    return next(iter(stream.frames()))


def test_type_1_keeps_each_measured_depth_and_the_background() -> None:
    source, scene = person(), wall()
    forged = one(forge.stream([source], scene, kind=1, blend=0))
    np.testing.assert_array_equal(forged.frame.depth[forged.mask], source.depth[forged.mask])
    np.testing.assert_array_equal(forged.frame.depth[~forged.mask], scene.depth[~forged.mask])
    own = np.asarray(source.body_index == 0)
    assert forged.mask[own].mean() > 0.98
    assert not forged.mask[~own].any()
    assert forged.frame.color is not None
    inside = (
        own & np.roll(own, 2, 0) & np.roll(own, -2, 0) & np.roll(own, 2, 1) & np.roll(own, -2, 1)
    )
    assert (forged.frame.color[inside & forged.mask] == (200, 40, 40)).all()
    assert (forged.frame.color[~own] == (30, 160, 60)).all()
    assert forged.frame.skeletons[0].body == 0
    np.testing.assert_array_equal(np.asarray(forged.frame.body_index) == 0, forged.mask)


def test_the_nearer_surface_wins() -> None:
    forged = one(forge.stream([person()], wall(1500), kind=1))
    assert not forged.mask.any()
    np.testing.assert_array_equal(forged.frame.depth, wall(1500).depth)
    assert forged.frame.color is not None
    assert (forged.frame.color == (30, 160, 60)).all()
    nothing = one(forge.stream([person()], wall(0), kind=1))
    assert nothing.mask.any()


def test_type_2_takes_the_pose_and_keeps_the_trunk() -> None:
    stream = forge.stream([person()], wall(), kind=2, pose=[person(0, HANDS_UP)], smoothing=False)
    forged = one(stream)
    wanted = np.asarray(person(0, HANDS_UP).body_index == 0)
    overlap = (forged.mask & wanted).sum() / (forged.mask | wanted).sum()
    assert overlap > 0.8
    before = np.asarray(person().body_index == 0)
    assert overlap > (before & wanted).sum() / (before | wanted).sum() + 0.02


def test_points_are_filled_between_and_never_outwards() -> None:
    options: dict[str, Any] = {"kind": 1, "move": (0.0, 0.0, -0.5), "surface": "points"}
    holes = one(forge.stream([person()], wall(), fill_pinholes=False, **options)).mask
    filled = one(forge.stream([person()], wall(), **options)).mask
    mesh = one(forge.stream([person()], wall(), **(options | {"surface": "mesh"}))).mask
    assert holes.sum() < filled.sum()
    across, down = (np.roll(filled, 1, axis) & np.roll(filled, -1, axis) for axis in (1, 0))
    assert ((filled & ~holes) <= (across | down)).all()
    assert (filled & mesh).sum() / (filled | mesh).sum() > 0.8


def test_moving_the_person_moves_depth() -> None:
    still = one(forge.stream([person()], wall(), kind=1))
    moved = one(forge.stream([person()], wall(), kind=1, move=(0.0, 0.0, 0.5)))
    near, far = (np.median(f.frame.depth[f.mask]) for f in (still, moved))
    assert far - near == pytest.approx(500, abs=5)
    assert moved.mask.sum() < still.mask.sum()


def test_edges_fade() -> None:
    sharp, soft = (
        one(forge.stream([person()], wall(), kind=1, blend=n)).frame.color for n in (0, 2)
    )
    assert sharp is not None
    assert soft is not None
    assert len(np.unique(sharp.reshape(-1, 3), axis=0)) == 2
    assert len(np.unique(soft.reshape(-1, 3), axis=0)) > 5


def test_lists_are_played_to_and_fro_and_iterators_end() -> None:
    people = [person(n) for n in range(5)]
    scenes = [wall(4000), wall(4100), wall(4200)]
    given = [f.depth[0, 0] for f in forge.stream(people, scenes, kind=1)]
    assert given == [4000, 4100, 4200, 4100, 4000]
    assert [f.number for f in forge.stream(people, scenes, kind=1)] == list(range(5))
    poses = (person(0, HANDS_UP) for _ in range(2))
    assert len(list(forge.stream(people, scenes, kind=2, pose=poses))) == 2


def test_iterations_that_overlap_have_their_own_truth() -> None:
    stream = forge.stream([person(n) for n in range(3)], wall(), kind=1)
    first, second = stream.frames(), stream.frames()
    for frames in (first, second, first, first):
        pixels = np.count_nonzero(next(frames).mask)
    assert stream.truth.numbers.tolist() == [0]  # that of the iteration that began last
    assert stream.forged_pixels == pixels
    next(second)
    assert stream.truth.numbers.tolist() == [0, 1]


@pytest.mark.parametrize("name", ["source", "pose"])
def test_a_second_iteration_over_an_iterator_is_refused(name: str) -> None:
    given: dict[str, Any] = {
        "source": [person(0), person(1)],
        "background": [wall(), wall()],
        "pose": [person(0, HANDS_UP), person(1)],
    }
    given[name] = iter(given[name])
    stream = forge.stream(**given, kind=2)
    assert len(list(stream)) == 2
    with pytest.raises(InputError, match=f"^{name}: expected a sequence for a second iteration"):
        list(stream)
    assert stream.truth.numbers.tolist() == [0, 1]  # the truth of the first one stays


def test_without_a_skeleton_the_persons_pixels_are_taken() -> None:
    source = replace(person(), skeletons=())
    forged = one(forge.stream([source], wall(), kind=1))
    np.testing.assert_array_equal(forged.mask, np.asarray(source.body_index == 0))
    stream = forge.stream([source], wall(), kind=2, pose=[person()])
    assert not one(stream).mask.any()
    assert stream.missed == 1
    with pytest.raises(InputError, match="expected a skeleton or people's pixels"):
        list(forge.stream([replace(source, body_index=None)], wall(), kind=1))


def test_poses_without_skeletons_are_refused() -> None:
    gone = [replace(person(number), skeletons=()) for number in range(2)]
    with pytest.raises(InputError, match="pose: expected skeletons, got frames without"):
        forge.stream([person()], wall(), kind=2, pose=gone)
    for poses in (iter(gone), forge.at_pace(gone, 0.0)):  # these are not looked through before
        with pytest.raises(InputError, match="pose: expected skeletons, got none in 2 frames"):
            list(forge.stream([person(0), person(1)], wall(), kind=2, pose=poses))
    late = forge.stream([person(0), person(1)], wall(), kind=2, pose=[gone[0], person()])
    assert [bool(each.mask.any()) for each in late.frames()] == [False, True]


def test_frames_without_anybody_show_the_background() -> None:
    there = person()
    gone = replace(there, skeletons=(), body_index=None)
    for kind, motion in ((1, None), (2, [there])):
        stream = forge.stream([gone, there, gone], wall(), kind=kind, pose=motion)
        assert [bool(f.mask.any()) for f in stream.frames()] == [False, True, False]
        assert stream.missed == 2


def test_one_person_is_followed_among_others() -> None:
    first = person()
    (own_body,) = first.skeletons
    aside = np.add(own_body.positions, np.float32([0.9, 0, 0]))
    other = replace(own_body, positions=aside, id=own_body.id + 1)
    alone = replace(first, skeletons=(other,), body_index=None)
    both = replace(first, skeletons=(other, own_body))
    own = replace(first, skeletons=(replace(own_body, id=99),))  # found again
    masks = [f.mask for f in forge.stream([first, both, alone, own], wall(), kind=1).frames()]
    assert masks[0].sum() > 500
    np.testing.assert_array_equal(masks[1], masks[0])
    assert not masks[2].any()
    np.testing.assert_array_equal(masks[3], masks[0])


def test_backgrounds_of_other_sizes_are_refused() -> None:
    scene = wall()
    camera = replace(scene.calibration.depth, width=100)
    small = RgbdFrame(np.ascontiguousarray(scene.depth[:, :100]), RgbdCalibration(camera))
    with pytest.raises(InputError, match="background: expected images of"):
        list(forge.stream([person()] * 2, [scene, small], kind=1))


def test_the_plate_is_told_by_skeletons_where_there_are_no_pixels_of_people() -> None:
    frames = [replace(person(), body_index=None)] * 3
    plate = forge.background_plate(frames)
    hidden = np.asarray(person().body_index == 0)
    change = np.abs(plate.depth.astype(int) - person().depth)[hidden]
    assert (change > 200).mean() > 0.9


def test_consumers_and_recorders_read_it(tmp_path: Path) -> None:
    stream = forge.stream([person(n) for n in range(3)], wall(), kind=1)
    done = capture.record(capture.from_frames(stream), tmp_path / "forged", lossless_color=True)
    assert done.frames == 3
    assert done.frames_with_skeleton == 3
    stream.truth.write(tmp_path / "truth.npz")
    truth = forge.read_stream_truth(tmp_path / "truth.npz")
    assert (truth.kind, truth.numbers.tolist()) == (1, [0, 1, 2])
    with capture.open_rgbd(f"folder:{tmp_path / 'forged'}") as source:
        for mask, read in zip(truth.masks, source, strict=True):
            np.testing.assert_array_equal(read.body_index == 0, mask)
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 nothing")
    for content in (b"", b"PK\x03\x04 nothing", (tmp_path / "truth.npz").read_bytes()[:-40]):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(FormatError, match="truth of a forged stream"):
            forge.read_stream_truth(tmp_path / "bad.npz")


def test_the_plate_shows_what_people_hide() -> None:
    scene = wall(3000)
    frames = []
    for shift in (0, 60, -60):
        seen = person()
        index = np.roll(np.asarray(seen.body_index), shift, axis=1)
        depth = np.where(index == 0, np.roll(seen.depth, shift, axis=1), scene.depth)
        frames.append(replace(seen, depth=depth, body_index=index, color=scene.color))
    plate = forge.background_plate(frames)
    np.testing.assert_array_equal(plate.depth, scene.depth)
    assert plate.body_index is not None
    assert (plate.body_index == NO_BODY).all()
    alone = forge.background_plate(frames[:1])
    np.testing.assert_array_equal(alone.depth, scene.depth)  # from beside the person
    np.testing.assert_array_equal(forge.without_people(frames[0], plate).depth, scene.depth)


def test_lost_pixels_at_a_person_s_edge_do_not_stay_in_the_scene() -> None:
    """Their depth is lost, so the body index does not name them, but their colour is hers."""
    seen, scene = person(), wall(3000)
    inside = np.asarray(seen.body_index) == 0
    edge = inside & ~(np.roll(inside, 1, 1) & np.roll(inside, -1, 1))
    index = np.where(inside & ~edge, 0, NO_BODY).astype(np.uint8)
    depth = np.where(inside, np.where(edge, 0, seen.depth), scene.depth).astype(np.uint16)
    assert seen.color is not None and scene.color is not None  # noqa: PT018
    color = np.where(inside[..., None], seen.color, scene.color)
    frames = [replace(seen, depth=depth, body_index=index, color=color)]
    plate = forge.background_plate(frames)
    np.testing.assert_array_equal(plate.color, scene.color)
    np.testing.assert_array_equal(plate.depth, scene.depth)
    alone = forge.without_people(frames[0], plate)
    np.testing.assert_array_equal(alone.color, scene.color)


def test_no_person_stays_in_colours_that_the_plate_cannot_repaint() -> None:
    seen = person()
    bare = replace(wall(3000), color=None)
    assert forge.without_people(seen, bare).color is None
    other = replace(SMALL, fx=SMALL.fx * 1.5)
    apart = replace(seen.calibration, registration=Registration(other, np.eye(3), np.zeros(3)))
    found = forge.without_people(replace(seen, calibration=apart), wall(3000))
    assert found.color is None
    assert found.calibration.registration is None


def test_wrong_arguments_are_named() -> None:
    for options, message in (
        ({"kind": 3}, "kind: expected 1 or 2, got 3"),
        ({"kind": 2}, "pose: expected a motion for type 2"),
        ({"kind": 1, "pose": [person()]}, "pose: expected none for type 1"),
        ({"kind": 1, "blend": 65}, "blend: expected 0 to 64"),
        ({"kind": 1, "surface": "voxels"}, "surface: expected 'mesh' or 'points'"),
        ({"kind": 1, "move": (0.0, np.nan, 0.0)}, "move"),
    ):
        with pytest.raises(InputError, match=message):
            forge.stream([person()], wall(), **options)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="background: expected at least one frame"):
        forge.stream([person()], [], kind=1)


def test_single_lost_pixels_of_a_moved_person_are_filled() -> None:
    source = person()
    depth = source.depth.copy()
    rows, columns = np.nonzero(np.asarray(source.body_index == 0))
    inside = np.flatnonzero((rows > 60) & (rows < 90) & (np.abs(columns - 96) < 8))[::40]
    assert len(inside) > 5
    depth[rows[inside], columns[inside]] = 0
    whole, speckled = (
        one(forge.stream([replace(source, depth=d)], wall(), kind=1, move=(0, 0, 0.2))).mask
        for d in (source.depth, depth)
    )
    assert (whole ^ speckled).sum() <= 2


def test_the_median_of_what_was_seen_is_a_depth_that_was_seen() -> None:
    seen = {(0, 0, 0): 0, (0, 0, 7): 7, (9, 0, 4): 4, (9, 5, 4): 5}
    depths = np.array(list(seen), np.uint16).T.reshape(3, 1, 4)
    assert _median_seen(depths).tolist() == [list(seen.values())]


def archive_of(
    masks: bytes, *, version: int = 20, shape: tuple[int, int, int] = (1, 2, 4)
) -> bytes:
    """A truth whose masks are these bytes of ``.npy``."""

    def array(values: object) -> bytes:
        stream = io.BytesIO()
        np.save(stream, np.asarray(values))
        return stream.getvalue()

    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("kind.npy", array(np.int64(1)))
        archive.writestr("shape.npy", array(shape))
        archive.writestr("masks.npy", masks)
        archive.writestr("numbers.npy", array([0]))
    content = bytearray(stream.getvalue())
    begin = -1
    while (begin := content.find(b"PK\x01\x02", begin + 1)) >= 0:
        content[begin + 6] = version
    return bytes(content)


def test_truths_that_claim_more_than_they_have_are_refused(tmp_path: Path) -> None:
    stream = io.BytesIO()
    np.save(stream, np.zeros(1, np.uint8))
    honest = stream.getvalue()
    path = tmp_path / "a.npz"
    path.write_bytes(archive_of(honest))
    assert forge.read_stream_truth(path).masks.shape == (1, 2, 4)
    claims = honest.replace(b"(1,), }           ", b"(99999999999,), } ")
    assert claims != honest
    empty = honest.replace(b"(1,), } ", b"(0,), } ")[:-1]
    assert np.load(io.BytesIO(empty)).shape == (0,)
    for content in (
        archive_of(claims),
        archive_of(empty, shape=(0, 10**18, 10**18)),
        archive_of(b"\x93NUMPY\x02" + honest[7:]),
        archive_of(honest, version=255),
        honest,
    ):
        path.write_bytes(content)
        with pytest.raises(FormatError, match="expected the truth of a forged stream"):
            forge.read_stream_truth(path)


def test_a_truth_too_large_to_be_read_is_not_written(tmp_path: Path) -> None:
    masks = np.broadcast_to(np.False_, (2**20, 2**10, 2**9))
    with pytest.raises(InputError, match="masks: expected at most 274877906944 pixels"):
        forge.StreamTruth(1, masks, np.arange(2**20)).write(tmp_path / "truth.npz")


def test_the_truth_is_written_from_packed_bits(tmp_path: Path) -> None:
    # 9 frames of 15 pixels: neither a frame nor eight frames and one end with a byte.
    camera = Intrinsics(5, 3, 4.0, 4.0, 2.0, 1.0)
    rng = np.random.default_rng(0)
    frames = []
    for number in range(9):
        body = np.where(rng.random((3, 5)) < 0.4, 0, NO_BODY).astype(np.uint8)
        depth = np.full((3, 5), 1000, np.uint16)
        frames.append(RgbdFrame(depth, RgbdCalibration(camera), body_index=body, number=number + 3))
    scene = RgbdFrame(np.full((3, 5), 4000, np.uint16), RgbdCalibration(camera))
    stream = forge.stream(frames, scene, kind=1)
    masks = np.stack([forged.mask for forged in stream.frames()])
    assert 20 < masks.sum() < masks.size - 20
    stream.write_truth(tmp_path / "packed.npz")
    stream.truth.write(tmp_path / "whole.npz")
    assert (tmp_path / "packed.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()
    found = forge.read_stream_truth(tmp_path / "packed.npz")
    assert found.masks.dtype == np.bool_
    np.testing.assert_array_equal(found.masks, masks)
    np.testing.assert_array_equal(stream.truth.masks, masks)
    assert found.numbers.tolist() == list(range(3, 12))
    assert stream.forged_pixels == masks.sum()
    assert stream.forged_share == masks.mean()


def test_the_truth_takes_no_more_memory_than_its_masks() -> None:
    shape = (212, 256)
    camera = RgbdCalibration(Intrinsics(shape[1], shape[0], 180.0, 180.0, 128.0, 106.0))
    scene = RgbdFrame(np.full(shape, 4000, np.uint16), camera)
    stream = forge.stream([scene], scene, kind=1)
    stream._tally.bits = [np.packbits(np.ones(shape, bool))] * 400
    stream._tally.numbers = list(range(400))
    size = 400 * shape[0] * shape[1]
    tracemalloc.start()
    try:
        assert stream.truth.masks.all()
        assert tracemalloc.get_traced_memory()[1] < 1.2 * size
        tracemalloc.reset_peak()
        _joined_bits(stream._tally.bits, shape[0] * shape[1])
        assert tracemalloc.get_traced_memory()[1] < 0.2 * size
    finally:
        tracemalloc.stop()


def test_a_small_truth_takes_no_more_memory_than_is_allowed(tmp_path: Path) -> None:
    path, side = tmp_path / "a.npz", 18_500  # 342 million pixels
    np.savez_compressed(
        path, kind=np.int64(1), shape=np.array([1, side, side]), numbers=np.zeros(1, np.int64),
        masks=np.zeros((side * side + 7) // 8, np.uint8),
    )  # fmt: skip
    assert path.stat().st_size < 50_000
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match="more than max_bytes = 167772160"):
            forge.read_stream_truth(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    np.savez_compressed(  # numbers of no mask
        path, kind=np.int64(1), shape=np.array([1, 2, 4]), numbers=np.zeros(10**7, np.int64),
        masks=np.zeros(1, np.uint8),
    )  # fmt: skip
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match="numbers do not agree with the masks"):
            forge.read_stream_truth(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    masks = np.zeros((2, 4, 4), np.bool_)
    forge.StreamTruth(1, masks, np.arange(2)).write(path)
    assert forge.read_stream_truth(path, max_bytes=32).masks.shape == (2, 4, 4)
    with pytest.raises(FormatError, match="32 pixels are more than max_bytes = 31"):
        forge.read_stream_truth(path, max_bytes=31)


def test_a_truth_that_cannot_be_read_back_is_refused(tmp_path: Path) -> None:
    masks = np.zeros((2, 4, 4), np.bool_)
    path = tmp_path / "a.npz"
    forge.StreamTruth(1, masks, np.arange(2, dtype=np.int32)).write(path)
    assert forge.read_stream_truth(path).numbers.tolist() == [0, 1]
    for kind, seen, numbers, message in (
        (3, masks, [0, 1], "kind: expected 1 or 2, got 3"),
        (1, masks, [0, 1, 2], "numbers: expected 2, one for each mask, got 3"),
        (1, masks, [0.5, 1], "numbers: expected whole numbers"),
        (1, masks[0], [0, 1], r"masks: expected bool \(T, H, W\)"),
        (1, masks.astype(np.float32), [0, 1], r"masks: expected bool \(T, H, W\)"),
        (1, masks[:, :0], [0, 1], r"masks: expected bool \(T, H, W\)"),
    ):
        with pytest.raises(InputError, match=message):
            forge.StreamTruth(kind, seen, numbers)  # type: ignore[arg-type]


def test_many_small_frames_and_long_recordings_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    small = np.zeros((1000, 2, 2), np.bool_)
    forge.StreamTruth(1, small, np.arange(1000)).write(path)
    assert forge.read_stream_truth(path, max_bytes=4000).numbers[-1] == 999
    long = np.zeros((780, 424, 512), np.bool_)  # 26 seconds of a Kinect V2: more than 160 MiB
    sides = 210 + np.random.default_rng(0).integers(0, 20, (780, 300))
    for mask, rights in zip(long, sides, strict=True):
        mask[60:360] = (np.arange(512) >= 150) & (np.arange(512) < rights[:, None])
    forge.StreamTruth(1, long, np.arange(780)).write(path)
    del small
    np.testing.assert_array_equal(forge.read_stream_truth(path).masks, long)


def test_frames_at_a_pace_are_a_sequence() -> None:
    """Its last frame was no frame, and a pace that is none counted as unknown."""
    slow = [replace(person(n), time_ns=n * 100_000_000) for n in range(3)]
    played = forge.at_pace(slow, 5e7)
    numbers = [frame.number for frame in played]
    assert numbers == [0, 1, 1, 2, 2]
    queue = forge.at_pace(deque(slow), 5e7)
    assert [frame.number for frame in queue] == numbers
    assert [played[n].number for n in range(-5, 0)] == numbers
    assert [frame.number for frame in played[-2:]] == [2, 2]
    for wrong in (5, -6):
        with pytest.raises(IndexError):
            played[wrong]
    for step in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="step_ns: expected a finite number >= 0"):
            forge.at_pace(slow, step)


def test_poses_are_as_many_as_wanted() -> None:
    recording = [frame(pose())] * (forge.NUM_POSES + 20)
    assert len(forge.recorded_poses(recording)) == forge.NUM_POSES
    assert len(forge.recorded_poses(recording, num_frames=forge.NUM_POSES + 10)) == 9010
    assert len(forge.recorded_poses(recording[:5], num_frames=9010)) == 5
