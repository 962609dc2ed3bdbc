"""BVH files: positions by an independent reader, what other programs write, and hostile files."""

from __future__ import annotations

import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from bvh_motions import read_bvh as read_directly
from bvh_motions import waving
from manip3d import FormatError, InputError, capture, io, modify
from manip3d.io import _bvh
from manip3d.rgbd import INFERRED, JOINTS, NOT_TRACKED, TRACKED

SMALL = """HIERARCHY
ROOT Hips
{
  OFFSET 1 2 3
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Upper arm
  {
    OFFSET 0 10 0
    CHANNELS 3 Xrotation Yrotation Zrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.025
0 0 0 0 0 0 0 0 0
10 20 30 90 0
0 0 0 0
"""


def read(text: str | bytes, folder: Path) -> io.Motion:
    file = folder / "motion.bvh"
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return io.read_bvh(file)


def test_positions_follow_the_channels_in_their_order(tmp_path: Path) -> None:
    motion = read(SMALL, tmp_path)
    assert motion.names == ("Hips", "Upper arm")
    assert motion.parents == (-1, 0)
    assert motion.frame_s == 0.025
    np.testing.assert_allclose(motion.positions[0], [(0, 0, 0), (0, 10, 0)], atol=1e-12)
    np.testing.assert_allclose(motion.positions[1], [(10, 20, 30), (0, 20, 30)], atol=1e-12)


def test_a_root_without_position_channels_stays_at_its_offset(tmp_path: Path) -> None:
    text = "hierarchy root a { offset 1 2 3 channels 1 yrotation } motion frames: 1 frame time: 1 9"
    np.testing.assert_array_equal(read(text, tmp_path).positions, [[(1, 2, 3)]])


def test_a_position_channel_of_the_root_replaces_the_offset_along_its_axis(tmp_path: Path) -> None:
    text = "hierarchy root a { offset 1 2 3 channels 1 yposition } motion frames: 1 frame time: 1 9"
    np.testing.assert_array_equal(read(text, tmp_path).positions, [[(1, 9, 3)]])


def test_a_byte_order_mark_is_skipped(tmp_path: Path) -> None:
    motion = read(b"\xef\xbb\xbf" + SMALL.encode(), tmp_path)
    np.testing.assert_array_equal(motion.positions, read(SMALL, tmp_path).positions)


def test_numbers_may_stand_on_one_long_line(tmp_path: Path) -> None:
    """A line of several pieces has the values of many lines, and little memory for its words."""
    head = "HIERARCHY ROOT a { OFFSET 0 0 0 CHANNELS 3 Xposition Yposition Zposition }\nMOTION\n"
    values = np.arange(90_000, dtype=float).reshape(-1, 3)
    head += f"Frames: {len(values)}\nFrame Time: 1\n"
    motion = read(head + " ".join(str(value) for value in values.ravel()), tmp_path)
    np.testing.assert_array_equal(motion.positions[:, 0], values)
    with pytest.raises(FormatError, match="line 6: expected a number, got 'x'"):
        read(head + "1 " * 80_000 + "\rx" + " 1" * 99_999, tmp_path)
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match=r"line 5: .* found more"):
            read(head.replace("Frames: 30000", "Frames: 2") + "10 " * 1_000_000, tmp_path)
        assert tracemalloc.get_traced_memory()[1] < 12 << 20  # thrice the file, of 3 MiB
    finally:
        tracemalloc.stop()


def test_memory_of_rotations_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    motion = read(SMALL, tmp_path)
    monkeypatch.setattr(_bvh, "_MAX_ROTATIONS", 3)  # one frame of two joints at a time
    np.testing.assert_array_equal(read(SMALL, tmp_path).positions, motion.positions)


def test_what_was_exported_comes_back(tmp_path: Path) -> None:
    frames = waving()
    file = tmp_path / "wave.bvh"
    capture.export_joints(frames, file)
    motion = io.read_bvh(file)
    names, places, step = read_directly(file)
    kept = [number for number, name in enumerate(names) if name]
    assert motion.names == tuple(names[number] for number in kept)
    np.testing.assert_allclose(motion.positions, places[:, kept], atol=1e-6)
    assert motion.frame_s == pytest.approx(step)

    poses = modify.skeletons_from_motion(motion)
    assert len(poses) == len(frames)
    for pose, frame in zip(poses, frames, strict=True):
        wanted = frame.skeletons[0].positions.astype(float)
        # The same body, turned and moved as a whole: distances between joints stay.
        for joints in ((5, 9), (3, 7), (6, 18), (4, 14)):
            given, seen = (float(np.linalg.norm(np.subtract(*p[list(joints)]))) for p in (
                pose.positions.astype(float), wanted
            ))  # fmt: skip
            assert given == pytest.approx(seen, abs=0.01)
        assert (pose.states == TRACKED).all()
    across = poses[0].positions[4] - poses[0].positions[8]
    assert across[0] > 0.2  # the left shoulder is on the right of the picture: facing the camera
    assert abs(across[2]) < 0.03
    assert poses[0].positions[3, 1] < poses[0].positions[0, 1]  # y is down
    half = modify.skeletons_from_motion(motion, rate=0.5 / motion.frame_s)
    np.testing.assert_array_equal(half[2].positions, poses[4].positions)


CHAIN = {
    "mocap": (
        "Hips Spine Neck Head LeftArm LeftForeArm LeftHand RightArm RightForeArm RightHand "
        "LeftUpLeg LeftLeg LeftFoot RightUpLeg RightLeg RightFoot"
    ),
    "biovision": (
        "Hips Chest Neck Head LeftShoulder LeftElbow LeftWrist RightShoulder RightElbow RightWrist "
        "LeftHip LeftKnee LeftAnkle RightHip RightKnee RightAnkle"
    ),
    "poser": (
        "hip chest neck head lShldr lForeArm lHand rShldr rForeArm rHand "
        "lThigh lShin lFoot rThigh rShin rFoot"
    ),
}
PLACES = [
    (0, 90, 0), (0, 110, 0), (0, 140, 0), (0, 160, 0),
    (20, 135, 0), (45, 135, 0), (70, 135, 0), (-20, 135, 0), (-20, 110, 0), (-20, 85, 0),
    (10, 88, 0), (10, 46, 0), (10, 4, 0), (-10, 88, 0), (-10, 46, 0), (-10, 4, 0),
]  # fmt: skip


def star(names: str, scale: float = 1.0, prefix: str = "") -> str:
    """A file in which each joint hangs from the root and stands where `PLACES` says."""
    first, *others = names.split()
    joints = "".join(
        f"JOINT {prefix}{name} {{ OFFSET {' '.join(str(scale * v) for v in place)} "
        "CHANNELS 3 Zrotation Xrotation Yrotation End Site { OFFSET 0 0 0 } }\n"
        for name, place in zip(others, PLACES[1:], strict=True)
    )
    return (
        f"HIERARCHY\nROOT {prefix}{first} {{ OFFSET 0 0 0\n"
        f"CHANNELS 3 Zrotation Xrotation Yrotation\n{joints}}}\n"
        f"MOTION\nFrames: 1\nFrame Time: .0083333\n{'0 ' * 3 * len(PLACES)}\n"
    )


@pytest.mark.parametrize("layout", CHAIN)
@pytest.mark.parametrize("scale", [1.0, 0.01, 10.0, 1 / 2.54])
def test_names_and_units_of_other_programs(layout: str, scale: float, tmp_path: Path) -> None:
    motion = read(star(CHAIN[layout], scale, "mixamorig:"), tmp_path)
    (pose,) = modify.skeletons_from_motion(motion)
    named = dict(zip(JOINTS, pose.positions.astype(float), strict=True))
    states = dict(zip(JOINTS, pose.states, strict=True))
    assert named["KneeLeft"][1] - named["HipLeft"][1] == pytest.approx(0.42, abs=1e-3)
    assert named["WristLeft"][0] - named["ShoulderLeft"][0] == pytest.approx(0.5, abs=1e-3)
    assert named["SpineBase"][2] == pytest.approx(2.5)
    assert states["ElbowLeft"] == TRACKED
    assert states["Neck"] == INFERRED
    assert states["HandTipLeft"] == NOT_TRACKED


def test_a_skeleton_that_is_not_known_is_refused(tmp_path: Path) -> None:
    motion = read(SMALL, tmp_path)
    with pytest.raises(InputError, match="motion: expected names of joints such as"):
        modify.skeletons_from_motion(motion)
    good = read(star(CHAIN["mocap"]), tmp_path)
    for options in ({"rate": 0.0}, {"rate": np.nan}, {"metres_per_unit": -1.0}):
        with pytest.raises(InputError, match=next(iter(options))):
            modify.skeletons_from_motion(good, **options)
    flat = read(star(CHAIN["mocap"], 0.0), tmp_path)
    with pytest.raises(InputError, match="legs that have a length"):
        modify.skeletons_from_motion(flat)


HOSTILE = {
    "empty": ("", "expected HIERARCHY, found the end"),
    "binary": (b"\x00\xff\xfe" * 50, "expected HIERARCHY, got"),
    "one long word": ("HIERARCHY " + "x" * 100_000, "a word of 100000 bytes"),
    "no root": ("HIERARCHY JOINT a {", "expected ROOT"),
    "ends in a joint": (SMALL[:150], "found the end of the file"),
    "two roots": (SMALL.replace("MOTION", "ROOT b"), "second ROOT"),
    "no offset": (SMALL.replace("OFFSET 0 10 0", ""), "expected OFFSET of the joint Upper arm"),
    "no channels": (
        SMALL.replace("CHANNELS 3 Xrotation Yrotation Zrotation", ""),
        "expected CHANNELS of the joint Upper arm",
    ),
    "offset twice": (SMALL.replace("OFFSET 0 10 0", "OFFSET 0 0 0 OFFSET 0 0 0"), "got 'OFFSET'"),
    "nan offset": (SMALL.replace("OFFSET 0 10 0", "OFFSET 0 nan 0"), "got 'nan'"),
    "far offset": (SMALL.replace("OFFSET 0 10 0", "OFFSET 0 1e300 0"), "got '1e300'"),
    "no name": (SMALL.replace("Upper arm", ""), "expected a joint's name"),
    "0 channels": (SMALL.replace("CHANNELS 3", "CHANNELS 0"), "1 to 6, got '0'"),
    "many channels": (SMALL.replace("CHANNELS 3", "CHANNELS 999999999"), "1 to 6"),
    "unknown channel": (SMALL.replace("CHANNELS 3 X", "CHANNELS 3 Q"), "got 'qrotation'"),
    "same channel": (SMALL.replace("3 Xrotation Y", "3 Zrotation Y"), "different channels"),
    "no frames": (SMALL.replace("Frames: 2", "Frames: 0"), "the number of frames"),
    "minus frames": (SMALL.replace("Frames: 2", "Frames: -2"), "the number of frames"),
    "claimed frames": (SMALL.replace("Frames: 2", "Frames: 9999999"), "found 18 numbers"),
    "fewer frames": (SMALL.replace("Frames: 2", "Frames: 1"), "found more"),
    "time 0": (SMALL.replace("0.025", "0"), "time of a frame in seconds"),
    "time nan": (SMALL.replace("0.025", "nan"), "the time of a frame"),
    "a word": (SMALL.replace("90", "ninety"), "expected a number, got 'ninety'"),
    "a word behind a long number": (SMALL.replace("90", "0" * 300 + " ninety"), "got 'ninety'"),
    "infinite": (SMALL.replace("90", "inf"), "expected a number, got 'inf'"),
    "underscore": (SMALL.replace("90", "9_0"), "expected a number, got '9_0'"),
    "one too few": (SMALL.rstrip()[:-1], "found 17 numbers"),
    "deep": ("HIERARCHY ROOT r { " + "JOINT a { " * 5000, "at most 1024 joints"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hostile_files_end_in_a_format_error(case: str, tmp_path: Path) -> None:
    content, message = HOSTILE[case]
    with pytest.raises(FormatError) as caught:
        read(content, tmp_path)
    assert message in str(caught.value)
    assert caught.value.line is not None
    assert caught.value.file.endswith("motion.bvh")


def test_lines_are_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        read(SMALL.replace("90", "x"), tmp_path)
    assert caught.value.line == 1 + SMALL[: SMALL.index("90")].count("\n")


def test_changed_bytes_never_do_more_than_raise_a_format_error(tmp_path: Path) -> None:
    """3 000 files with flipped, cut, doubled and swapped pieces."""
    rng = np.random.default_rng(5)
    original = star(CHAIN["mocap"]).encode()
    words = (b"{", b"}", b"JOINT ", b"OFFSET ", b"CHANNELS ", b"1e999 ", b"-", b"nan ", b"\0")
    outcomes = {"read": 0, "refused": 0}
    for _ in range(3000):
        data = bytearray(original)
        for _ in range(int(rng.integers(1, 6))):
            at = int(rng.integers(len(data)))
            match int(rng.integers(4)):
                case 0:
                    data[at] ^= 1 << int(rng.integers(8))
                case 1:
                    del data[at : at + int(rng.integers(1, 80))]
                case 2:
                    data[at:at] = words[int(rng.integers(len(words)))]
                case _:
                    data[at:at] = data[at : at + int(rng.integers(1, 200))]
            if not data:
                data = bytearray(original)
        try:
            motion = read(bytes(data), tmp_path)
            assert np.isfinite(motion.positions).all()
            outcomes["read"] += 1
        except FormatError:
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 20  # both happen


@pytest.mark.parametrize(
    "piece", [b"JOINT a { ", b"0 ", b"\n", b"End Site { OFFSET 0 0 0 } ", b"a "]
)
def test_a_mebibyte_of_anything_is_answered_soon(piece: bytes, tmp_path: Path) -> None:
    heads = (b"", b"HIERARCHY ROOT a { OFFSET 0 0 0 CHANNELS 1 Xrotation ", SMALL[:-2].encode())
    for head in heads:
        begun = time.thread_time()
        with pytest.raises(FormatError):
            read(head + piece * ((1 << 20) // len(piece)), tmp_path)
        assert time.thread_time() - begun < 2.0
