"""Several files and the poses of their cameras: one mesh in a file."""

from __future__ import annotations

import json
import tracemalloc
from collections import Counter
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from command_line import error_line, manip3d
from manip3d import FormatError, InputError, Intrinsics, io, metrics, simplify
from manip3d.simplify import _camera_files

CAMERA = "130,130,79.5,59.5"
TURNED = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])  # by 90 degrees around z: q = (0, 0, s, s)
POSES = """# timestamp tx ty tz qx qy qz qw
10.000 0 0 0 0 0 0 1
10.030 0.5 0 0 0 0 0 1
10.060 1 2 3 0 0 0.70710678 0.70710678
"""


@pytest.fixture
def walls(tmp_path: Path) -> Path:
    """Two images of a wall with a box before it, the second from half a metre to the right."""
    for name, shift in (("10.005.npy", 0), ("10.031.npy", 36)):  # 0.5 m at 1.8 m are 36 pixels
        depth = np.full((120, 160), 1800, np.uint16)
        depth[40:80, 70 - shift : 110 - shift] = 1795
        np.save(tmp_path / name, depth)
    (tmp_path / "groundtruth.txt").write_text(POSES)
    return tmp_path


def test_poses_of_a_trajectory_by_time_and_in_order(tmp_path: Path) -> None:
    (tmp_path / "truth.txt").write_text(POSES)
    found = simplify.poses_of_files(["d/10.04.png", "d/10.055.png"], tmp_path / "truth.txt")
    np.testing.assert_array_equal(found[0][:3, 3], [0.5, 0, 0])
    np.testing.assert_allclose(found[1][:3, :3], TURNED, atol=1e-8)
    np.testing.assert_array_equal(found[1][:3, 3], [1, 2, 3])
    ordered = simplify.poses_of_files(["a.png", "b.png", "c.png"], tmp_path / "truth.txt")
    np.testing.assert_allclose(ordered[2], found[1])
    with pytest.raises(InputError, match=r"expected file names that are times, or 2 poses"):
        simplify.poses_of_files(["a.png", "b.png"], tmp_path / "truth.txt")
    with pytest.raises(InputError, match=r"within 0\.02 s of .*11\.png, the nearest is 0\.940 s"):
        simplify.poses_of_files(["10.06.png", "11.png"], tmp_path / "truth.txt")


def test_the_nearest_of_many_times_takes_little_memory(tmp_path: Path) -> None:
    """Differences of all names and all times took a gigabyte for a long trajectory."""
    random = np.random.default_rng(4)
    ticks = random.permutation(np.arange(3000) % 500) + 1000  # each one six times
    lines = (f"{tick / 64} {k} 0 0 0 0 0 1" for k, tick in enumerate(ticks))
    (tmp_path / "truth.txt").write_text("\n".join(lines))
    asked = random.integers(1999, 3000, 2000) / 128  # half of them between two times
    tracemalloc.start()
    poses = simplify.poses_of_files([f"{time}.png" for time in asked], tmp_path / "truth.txt")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    nearest = np.abs(asked[:, None] - ticks / 64).argmin(axis=1)
    assert [pose[0, 3] for pose in poses] == nearest.tolist()
    assert peak < 8 * len(asked) * len(ticks)


def test_the_number_of_a_frame_without_a_pose_is_told_with_all_digits(tmp_path: Path) -> None:
    (tmp_path / "trajectory.log").write_text("5 5 6\n" + MATRIX)
    with pytest.raises(InputError, match="expected one of frame 1234567 in"):
        simplify.poses_of_files(["1234567.png"], tmp_path / "trajectory.log")


def test_times_are_never_dropped_for_the_order(tmp_path: Path) -> None:
    lines = [f"{k}.00 {k} 0 0 0 0 0 1" for k in (1, 2, 3)]
    (tmp_path / "truth.txt").write_text("\n".join(lines))

    def places(*names: str) -> list[float]:
        return [p[0, 3] for p in simplify.poses_of_files(names, tmp_path / "truth.txt")]

    assert places("3.00.png", "1.00.png", "2.01.png.xz") == [3, 1, 2]
    assert places("nan.png", "inf.png", "1_0.png") == [1, 2, 3]
    assert places("000100.png", "000200.png", "000300.png") == [1, 2, 3]  # counts
    with pytest.raises(InputError, match=r"of 2\.03\.png, the nearest is 0\.030 s away"):
        places("3.00.png", "1.00.png", "2.03.png")
    with pytest.raises(InputError, match=r"of .*\.05\.png, the nearest is 0\.050 s away"):
        places("3.05.png", "1.05.png", "2.05.png")  # another clock, and another order
    with pytest.raises(InputError, match=r"of nan\.png, whose name is not a time"):
        places("1.00.png", "nan.png", "3.00.png")


def test_numbers_of_frames_are_no_seconds(tmp_path: Path) -> None:
    """At ten poses a second, frame 1 is not the one after a second, although both are called 1."""
    place = tmp_path / "truth.txt"
    place.write_text("\n".join(f"{k / 10} {k} 0 0 0 0 0 1" for k in range(31)))
    names = [f"{k:06}.png" for k in range(31)]
    found = simplify.poses_of_files(names, place)
    assert [pose[0, 3] for pose in found] == list(range(31))
    told = r"such as 000000\.png, are numbers of frames, .* fractions: expected 3 .*, found 31$"
    with pytest.raises(InputError, match=told):
        simplify.poses_of_files(names[:3], place)
    with pytest.raises(InputError, match=r"expected 31 ascending numbers and as many poses"):
        simplify.poses_of_files(names[::-1], place)
    with pytest.raises(InputError, match=r"of preview\.png, whose name is not a time"):
        simplify.poses_of_files(["preview.png", *names], place)
    found = simplify.poses_of_files(["0.png", "1.5.png"], place)
    assert [pose[0, 3] for pose in found] == [0, 15]


def test_a_first_line_may_name_the_columns(tmp_path: Path) -> None:
    """Stray Scanner's has the number of the frame beside its time."""
    place = tmp_path / "odometry.csv"
    lines = [f"{k / 10}, {k:06}, {k}, 0, 0, 0, 0, 0, 1" for k in range(20)]
    place.write_text("\n".join(["timestamp, frame, x, y, z, qx, qy, qz, qw", *lines]))
    found = simplify.poses_of_files(["000011.png", "000003.png"], place)
    assert [pose[0, 3] for pose in found] == [11, 3]
    place.write_text("# of a tool\nTime,tx,ty,tz,qx,qy,qz,qw\n1.0,1,0,0,0,0,0,1\n1.5,2,0,0,0,0,0,1")
    (pose,) = simplify.poses_of_files(["1.50.png"], place)
    assert pose[0, 3] == 2
    place.write_text("\n".join(["x, y, z, qx, qy, qz, qw", *lines]))
    with pytest.raises(FormatError, match="expected names of the 9 columns below") as error:
        simplify.poses_of_files(["000003.png"], place)
    assert error.value.line == 1


@pytest.mark.filterwarnings("ignore:poses. those of EuRoC")
def test_columns_of_poses_are_taken_by_their_names(tmp_path: Path) -> None:
    """Order and number of the columns are those of EuRoC, TUM-VI, Kalibr and Stray Scanner."""
    place = tmp_path / "data.csv"
    pose, axes = "1,2,3", ("x", "y", "z")
    euroc = ",".join([f" p_RS_R_{a} [m]" for a in axes] + [f" q_RS_{a} []" for a in ("w", *axes)])
    rest = "".join(f", v_RS_R_{a} [m s^-1], b_w_RS_S_{a} [rad s^-1], b_a_{a}" for a in axes)
    stray = "timestamp, frame, x, y, z, qx, qy, qz, qw, fx, fy, cx, cy"
    w_first, w_last = "0.6,0,0,0.8", "0,0,0.8,0.6"
    for head, values in (
        (f"#timestamp [ns],{euroc}", f"1403636579763555584,{pose},{w_first}"),
        (f"#timestamp,{euroc}{rest}", f"1403636579763555584,{pose},{w_first},7,8,9,7,8,9,7,8,9"),
        ("# timestamp tx ty tz qw qx qy qz", f"1403636579.763556 {pose} {w_first}"),
        ("timestamp,tx,ty,tz,qw,qx,qy,qz", f"1403636579.763556,{pose},{w_first}"),
        ("# time qx qy qz qw tx ty tz", f"1403636579.763556,{w_last},{pose}"),
        ("# t [s] tx ty tz w x y z", f"1403636579.763556,{pose},{w_first}"),
        ("# tx ty tz qw qx qy qz", f"{pose} {w_first}"),
        ("#format: frame_id tx ty tz qw qx qy qz gps", f"1403636579763555584,{pose},{w_first},0"),
        (stray, f"0.1, 1403636579763555584, {pose}, {w_last}, 5, 5, 3, 3"),
        (f"{stray}, distortion_center_x", f"0.1, 1403636579763555584, {pose}, {w_last},5,5,3,3, "),
        ("# unix_time tx ty tz qx qy qz qw", f"1403636579.763556,{pose},{w_last}"),
        ("frame_no,tx,ty,tz,qw,qx,qy,qz", f"1403636579.763556,{pose},{w_first}"),
        ("# Format: timestamp [tx ty tz] [qw qx qy qz]", f"1403636579.763556,{pose},{w_first}"),
        ("#timestamp [s] (tx ty tz qw qx qy qz)", f"1403636579.763556,{pose},{w_first}"),
        ("#timestamp;tx;ty;tz;qw;qx;qy;qz", f"1403636579.763556,{pose},{w_first}"),
        ("# time|tx|ty|tz|qw|qx|qy|qz", f"1403636579.763556,{pose},{w_first}"),
        ("# time - tx - ty - tz - qw - qx - qy - qz", f"1403636579.763556,{pose},{w_first}"),
        ("# t pos.x pos.y pos.z q.w q.x q.y q.z", f"1403636579.763556,{pose},{w_first}"),
        ("# t p[x] p[y] p[z] q[w] q[x] q[y] q[z]", f"1403636579.763556,{pose},{w_first}"),
        ("# <time> <tx> <ty> <tz> <qw> <qx> <qy> <qz>", f"1403636579.763556,{pose},{w_first}"),
        ("# 'time' 'tx' 'ty' 'tz' 'qw' 'qx' 'qy' 'qz'", f"1403636579.763556,{pose},{w_first}"),
        ("# timestamp x y z qw qi qj qk", f"1403636579.763556,{pose},{w_first}"),
        ("# timestamp tx ty tz qw qx qy qz (qw first)", f"1403636579.763556,{pose},{w_first}"),
    ):
        other = values.replace(pose, "7,8,9").replace("14036365", "14036364")
        rows = values if head.startswith("# tx") else f"{other}\n{values}"
        place.write_text(f"# of a tool\n{head}\n{rows}\n")
        (found,) = simplify.poses_of_files(["1403636579763555584.png"], place)
        np.testing.assert_array_equal(found[:3, 3], [1, 2, 3], head)
        turned = [[-0.28, -0.96, 0], [0.96, -0.28, 0], [0, 0, 1]]
        np.testing.assert_allclose(found[:3, :3], turned, atol=1e-12, err_msg=head)


@pytest.mark.parametrize(
    "remark",
    [
        "x right, y down, z forward; world W, z up",
        "y up, x right, z back, W world",
        "camera c in world w: x right y down z forward",
        "Rot r1 r2 r3",
        "run q1 of a robot, w up",
        "the quaternion is x y z w",
        "quaternion is x y z w (Hamilton), not w x y z",
        "xyzw, not wxyz",
        "time [s] position [m] quaternion (x,y,z,w)",
        "rotation as quaternion qx,qy,qz,qw; translation tx,ty,tz",
        "qx qy qz qw, where qw is the real part and qx, qy, qz the vector",
        "qx qy qz qw = 0 0 0 1 for the first; tx ty tz in m",
    ],
)
@pytest.mark.parametrize("is_first", [True, False])
def test_remarks_in_a_trajectory_are_skipped(remark: str, is_first: bool, tmp_path: Path) -> None:
    lines = ["4 7 8 9 0 0 0 1", "5 1 2 3 0 0 0.8 0.6"]
    lines.insert(0 if is_first else 1, f"# {remark}")
    (tmp_path / "truth.txt").write_text("\n".join(lines))
    (pose,) = simplify.poses_of_files(["5.png"], tmp_path / "truth.txt")
    np.testing.assert_allclose(pose[:2, 0], [-0.28, 0.96], rtol=1e-12)
    assert pose[:3, 3].tolist() == [1, 2, 3]


def test_poses_of_euroc_are_told_to_be_of_the_imu(tmp_path: Path) -> None:
    names = [f"p_RS_R_{axis} [m]" for axis in "xyz"] + [f"q_RS_{axis} []" for axis in "wxyz"]
    (tmp_path / "data.csv").write_text(f"#timestamp, {', '.join(names)}\n1,1,2,3,1,0,0,0\n")
    with pytest.warns(UserWarning, match=r"data\.csv has, are of the IMU; multiply .* by T_BS of"):
        simplify.poses_of_files(["1.png"], tmp_path / "data.csv")


@pytest.mark.parametrize(
    ("head", "line", "told"),
    [
        ("# t tx ty tz q0 q1 q2 q3", 1, "expected names of the 8 columns below, tx ty tz qx"),
        ("# quaternions are w x y z", 1, "in any order, got '# quaternions are w x y z'"),
        ("# tx ty tz qw qx qy qz", 1, "expected names of the 8 columns"),  # there are 8 numbers
        ("# timestamp position(x y z) quaternion(w x y z)", 1, "expected names of the 8 columns"),
        ("# quaternion order wxyz", 1, "expected names of the 8 columns"),
        ("1,1,2,3,1,0,0,0\n# quaternions are w x y z", 2, "expected names of the 8 columns"),
        ("1,1,2,3,1,0,0,0\n# t tx ty tz qw qx qy qz", 2, "expected one order of the columns in"),
        ("# t tx ty tz qx qy qz qw\n# t tx ty tz qw qx qy qz", 2, "one order .* got '# t tx ty tz"),
        ("name,tx,ty,tz,qw,qx,qy,qz\na.png,1,2,3,1,0,0,0", 2, "expected finite numbers"),
        ("a,b,c,d,e,f,g,h", 1, "in any order, got 'a,b,c,d,e,f,g,h'"),
        ("time,x,y,z,qw,qx,qy,qz,fx\n1,1,2,3,1,0,0,0,5", 3, "expected 9 fields, as in the lines"),
        ("time,x,y,z,qw,qx,qy,qz\n1,1,2,3,1,,0,0", 2, "expected finite numbers"),
    ],
)
def test_names_of_columns_that_are_not_understood(
    head: str, line: int, told: str, tmp_path: Path
) -> None:
    """The order of the numbers matters: a wrong one gives poses that only look right."""
    (tmp_path / "truth.txt").write_text(f"{head}\n1,1,2,3,1,0,0,0\n")
    with pytest.raises(FormatError, match=told) as error:
        simplify.poses_of_files(["1.png"], tmp_path / "truth.txt")
    assert error.value.line == line


def test_numbers_of_frames_have_the_poses_of_their_numbers(tmp_path: Path) -> None:
    place = tmp_path / "truth.txt"
    place.write_text("\n".join(f"{k} {k} 0 0 0 0 0 1" for k in range(31)))
    found = simplify.poses_of_files(["000007.png", "000003.png"], place)
    assert [pose[0, 3] for pose in found] == [7, 3]


@pytest.mark.parametrize("time", ["1305031102.5", "1305031102500000000"])
@pytest.mark.parametrize("name", ["1305031102.500000", "1305031102510", "1305031102500000005"])
def test_times_since_1970_have_any_unit(time: str, name: str, tmp_path: Path) -> None:
    place = tmp_path / "truth.txt"
    place.write_text(f"1305031101.0 1 0 0 0 0 0 1\n{time} 2 0 0 0 0 0 1")
    (pose,) = simplify.poses_of_files([f"{name}.png"], place)
    assert pose[0, 3] == 2
    place.write_text("1305031102.0 1 0 0 0 0 0 1\n1305031102.5 2 0 0 0 0 0 1")
    (pose,) = simplify.poses_of_files(["1305031102.png"], place)
    assert pose[0, 3] == 1


def test_all_images_of_a_mesh_have_one_unit(tmp_path: Path) -> None:
    """The numbers of one frame fit another unit better than those of most do."""
    for k, depth in enumerate((8000, 8100, 1200)):
        np.save(tmp_path / f"{k}.00.npy", np.full((48, 64), depth, np.uint16))
    lines = [f"{k}.00 {4 * k} 0 0 0 0 0 1" for k in range(3)]
    (tmp_path / "truth.txt").write_text("\n".join(lines))
    files = [tmp_path / f"{k}.00.npy" for k in range(3)]
    camera = "60,60,31.5,23.5"
    options = simplify.DepthOptions(60, intrinsics=camera)
    found = simplify.simplify_camera_files(
        files, tmp_path / "truth.txt", tmp_path / "a.ply", options
    )
    assert simplify.common_depth_unit(files[2:]) == "mm"
    assert found.options.unit == simplify.common_depth_unit(files) == "tum"  # fifths of them
    depths = np.asarray(io.read_mesh(tmp_path / "a.ply").vertices)[:, 2]
    assert np.unique(depths) == pytest.approx([0.24, 1.6, 1.62])


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("1 2 3", r"expected eight numbers \(time tx ty tz"),
        ("1 0 0 0 0 0 0 2", "expected a quaternion of length 1"),
        ("1 0 0 nan 0 0 0 1", "expected finite numbers"),
        ("1 b c d e f g h", "expected finite numbers with spaces or commas between them"),
        ("2 0 0 5 0 2 0 6 0 0 2 7", "expected a rigid transform"),
        ("0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1", "as in the lines before"),
    ],
)
def test_lines_that_are_no_poses_are_told(line: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "truth.txt").write_text(f"# time\n{line}\n")
    with pytest.raises(FormatError, match=told) as error:
        simplify.poses_of_files(["1.png"], tmp_path / "truth.txt")
    assert error.value.line == 2 + line.count("\n")


MATRIX = "0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n"


def test_lines_without_times_are_poses_in_order(tmp_path: Path) -> None:
    (tmp_path / "seven.txt").write_text("0 0 0 0 0 0 1\n1 2 3 0 0 0.70710678 0.70710678\n")
    (tmp_path / "kitti.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n0 -1 0 1 1 0 0 2 0 0 1 3\n")
    for name in ("seven.txt", "kitti.txt"):
        _, pose = simplify.poses_of_files(["7.png", "9.png"], tmp_path / name)
        np.testing.assert_allclose(pose, np.loadtxt(MATRIX.splitlines()), atol=1e-7)
        with pytest.raises(InputError, match="or 1 poses in"):
            simplify.poses_of_files(["7.png"], tmp_path / name)


def test_a_folder_has_a_matrix_for_each_image(tmp_path: Path) -> None:
    """In 7-Scenes beside its image, in ScanNet of the same name; the last is a lost camera's."""
    (tmp_path / "frame-000001.pose.txt").write_text(MATRIX)
    (tmp_path / "12.txt").write_text(MATRIX)
    for name in ("frame-000001.depth.png", "depth/12.png", "12.png.xz"):
        (pose,) = simplify.poses_of_files([name], tmp_path)
        np.testing.assert_array_equal(pose, np.loadtxt(MATRIX.splitlines()))
    with pytest.raises(InputError, match=r"expected frame-2\.pose\.txt or frame-2\.txt in"):
        simplify.poses_of_files(["frame-2.depth.png"], tmp_path)
    (tmp_path / "12.txt").write_text("-inf -inf -inf -inf\n" * 4)
    with pytest.raises(FormatError, match="expected finite numbers"):
        simplify.poses_of_files(["12.png"], tmp_path)


@pytest.mark.parametrize("name", ["truth.txt", "trajectory.log", "a/00005.txt", "a.conf"])
def test_damaged_poses_end_in_errors_of_ours(name: str, tmp_path: Path) -> None:
    whole = {
        "truth.txt": POSES,
        "trajectory.log": "5 5 6\n" + MATRIX,
        "a/00005.txt": MATRIX,
        "a.conf": "bmesh 00005.png 0 0 0 0 0 0 1\n",
    }[name].encode()
    place = tmp_path / name
    place.parent.mkdir(exist_ok=True)
    random = np.random.default_rng(0)
    outcomes = Counter[str]()
    for _ in range(400):
        damaged = bytearray(whole)
        for at in random.integers(0, len(whole), random.integers(1, 4)):
            damaged[at] = random.choice(list(b"\n \0\xff-.#e,9n0i")).item()
        place.write_bytes(damaged[: random.integers(1, len(whole) + 1)])
        poses = place.parent if name.startswith("a/") else place
        try:
            (pose,) = simplify.poses_of_files(["00005.png"], poses)
            assert np.isfinite(pose).all()
            outcomes["read"] += 1
        except (FormatError, InputError):
            outcomes["refused"] += 1
    assert outcomes["refused"] > 200


def test_a_log_has_matrices_by_number(tmp_path: Path) -> None:
    log = tmp_path / "trajectory.log"
    log.write_text("0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n5 5 6\n" + MATRIX)
    for names in (("00000.png", "00005.png"), ("a.png", "b.png")):
        poses = simplify.poses_of_files(names, log)
        np.testing.assert_array_equal(poses, [np.eye(4), np.loadtxt(MATRIX.splitlines())])
    with pytest.raises(InputError, match="expected one of frame 4 in"):
        simplify.poses_of_files(["00004.png"], log)
    log.write_text(log.read_text().rsplit("\n", 2)[0])
    with pytest.raises(FormatError, match="expected a rigid transform: four lines") as error:
        simplify.poses_of_files(["00000.png"], log)
    assert error.value.line == 7
    log.write_text(MATRIX)
    with pytest.raises(FormatError, match="expected three whole numbers before"):
        simplify.poses_of_files(["00000.png"], log)


def test_poses_of_scans_are_found_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.conf").write_text("camera 0 0 0 0 0 0 1\nbmesh one.ply 1 2 3 0 0 0 1\n")
    (pose,) = simplify.poses_of_files(["x/one.ply.xz"], tmp_path / "a.conf")
    np.testing.assert_array_equal(pose[:3, 3], [1, 2, 3])
    with pytest.raises(InputError, match=r"expected one of two\.ply in"):
        simplify.poses_of_files(["two.ply"], tmp_path / "a.conf")


@pytest.mark.parametrize("method", ["relief", "cs3"])
def test_several_images_become_one_mesh(walls: Path, method: str) -> None:
    base = ("depth", walls / "10.005.npy", walls / "10.031.npy", "--intrinsics", CAMERA, "--points",
            "100", "--method", method, "--poses", walls / "groundtruth.txt", "--json",
            "--strict")  # fmt: skip
    done = manip3d(*base, "-o", walls / "wall.ply")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert record["points_before"] == 2 * 120 * 160
    assert 99 <= record["points"] <= 100
    assert record["target_missed"] is False
    assert record["coverage"] > 0.97
    assert record["bridges"] < 0.01
    assert "% of the measured pixels" in done.stderr
    mesh = io.read_mesh(walls / "wall.ply")
    width = np.ptp(np.asarray(mesh.vertices)[:, 0])
    assert width == pytest.approx(0.5 + 159 / 130 * 1.8, abs=0.05)
    assert manip3d(*base, "-o", walls / "wall.ply").returncode != 0  # it is there
    share = {"--points": "--ratio", "100": "0.005"}
    done = manip3d(*(share.get(str(each), each) for each in base), "-o", walls / "c.ply")
    assert json.loads(done.stdout)["target_points"] == int(0.005 * record["points_before"])
    low = manip3d(*base, "-o", walls / "b.ply", "--min-coverage", "1", "--points", "3")
    assert low.returncode == 4


@pytest.mark.parametrize(("points", "missed"), [(98, True), (99, False)])
def test_a_missed_target_of_several_views(points: int, missed: bool) -> None:
    options = simplify.DepthOptions(100)
    result = simplify.JointFileResult((), Path("x"), options, 500, points, 9, 0.0, 1.0, 0.0)
    assert result.target_missed is missed
    assert not replace(result, points_before=points).target_missed  # there are no more


def test_strict_fails_where_several_views_have_too_few_points(walls: Path) -> None:
    """Both views show one wall: half of what is asked for falls out as seen twice."""
    (walls / "groundtruth.txt").write_text(POSES.replace("0.5", "0.0"))
    base = ("depth", walls / "10.005.npy", walls / "10.031.npy", "--intrinsics", CAMERA, "--points",
            "38000", "--poses", walls / "groundtruth.txt", "-o", walls / "a.ply")  # fmt: skip
    done = manip3d(*base, "--strict", "--json")
    assert done.returncode == 4
    assert json.loads(done.stdout)["target_missed"]
    assert "points missed" in done.stderr
    assert manip3d(*base, "--force").returncode == 0


def test_several_images_of_lone_pixels_are_said_to_be_sparse(walls: Path) -> None:
    files = sorted(walls.glob("*.npy"))
    options = simplify.DepthOptions(200, intrinsics="130,130,79.5,59.5", unit="mm")
    given = (files, walls / "groundtruth.txt", walls / "wall.ply", options)
    whole = simplify.simplify_camera_files(*given)
    assert whole.lone_pixels == 0
    assert not whole.is_sparse
    for file in files:
        depth = np.load(file)
        depth[np.arange(120) % 5 > 0] = 0
        depth[52:54, 10:12] = 1800  # four measured pixels of a surface
        np.save(file, depth)
    sparse = simplify.simplify_camera_files(*given)
    assert sparse.lone_pixels == sparse.points_before - 2 * 4
    assert sparse.is_sparse
    for file in files:
        depth = np.load(file)
        depth[52:54, 10:12] = 0
        np.save(file, depth)
    with pytest.raises(FormatError, match="found none; most measured pixels stand alone"):
        simplify.simplify_camera_files(*given)


@pytest.mark.parametrize("method", ["relief", "cs3"])
def test_the_mesh_of_a_gltf_is_upright(walls: Path, method: simplify.DepthMethod) -> None:
    options = simplify.DepthOptions(50, method, intrinsics=CAMERA, unit="mm")
    files = [walls / "10.005.npy", walls / "10.031.npy"]
    for name in ("a.glb", "a.ply"):
        simplify.simplify_camera_files(files, walls / "groundtruth.txt", walls / name, options)
    upright, as_seen = (io.read_mesh(walls / name) for name in ("a.glb", "a.ply"))
    upright, as_seen = upright.vertices[upright.faces], as_seen.vertices[as_seen.faces]
    assert upright[..., 2].max() < -1.7
    np.testing.assert_allclose(np.sort(upright, 0), np.sort(as_seen * [1, -1, -1], 0), atol=1e-6)


def test_the_mesh_of_cameras_with_y_up_is_upright(walls: Path) -> None:
    """The box in the images' upper part is at the top of a glTF file."""
    for path in walls.glob("*.npy"):
        depth = np.full((120, 160), 1800, np.uint16)
        depth[10:30, 60:100] = 1500
        np.save(path, depth)
    (walls / "groundtruth.txt").write_text(POSES.replace("0.5", "0.0"))
    options = simplify.DepthOptions(200, intrinsics="130,-130,79.5,59.5", unit="mm")
    files = [walls / "10.005.npy", walls / "10.031.npy"]
    for name in ("a.glb", "a.ply"):
        simplify.simplify_camera_files(files, walls / "groundtruth.txt", walls / name, options)
    simplify.simplify_depth_file(files[0], walls / "one.glb", options)
    upright, as_seen, one = (io.read_mesh(walls / name) for name in ("a.glb", "a.ply", "one.glb"))
    for mesh in (upright, one):
        near = mesh.vertices[abs(mesh.vertices[:, 2]) < 1.6]
        assert len(near)
        assert near[:, 1].min() > 0.3
        corners = mesh.vertices[mesh.faces]
        assert (np.linalg.det(corners) < 0).all()  # they face the camera, which is at the origin
    upright, as_seen = upright.vertices[upright.faces], as_seen.vertices[as_seen.faces]
    np.testing.assert_allclose(np.sort(upright, 0), np.sort(as_seen, 0), atol=1e-6)  # as the poses


@pytest.mark.parametrize("up", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_a_gltf_is_upright_whatever_axis_of_the_poses_is_up(walls: Path, up: str) -> None:
    """Cameras that look ahead and down, in worlds whose vertical axis is any."""
    axis, sign = "xyz".index(up[1]), float(f"{up[0]}1")
    vertical = sign * np.eye(3)[axis]
    ahead = np.eye(3)[(axis + 1) % 3] + 0.3 * np.eye(3)[(axis + 2) % 3]
    forward = ahead / np.linalg.norm(ahead) - 0.5 * vertical
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, vertical)
    right /= np.linalg.norm(right)
    pose = np.column_stack([right, np.cross(forward, right), forward, np.zeros(3)])
    line = " ".join(f"{number:.9f}" for number in pose.ravel())
    (walls / "kitti.txt").write_text(f"{line}\n{line}\n")
    files = [walls / "10.005.npy", walls / "10.031.npy"]
    options = simplify.DepthOptions(50, intrinsics=CAMERA, unit="mm")
    for name in ("a.glb", "a.ply"):
        simplify.simplify_camera_files(files, walls / "kitti.txt", walls / name, options)
    upright, as_given = (io.read_mesh(walls / name) for name in ("a.glb", "a.ply"))
    heights = np.sort(upright.vertices[upright.faces][..., 1].ravel())
    expected = np.sort((as_given.vertices @ vertical)[as_given.faces].ravel())
    np.testing.assert_allclose(heights, expected, atol=1e-5)
    volumes = [np.linalg.det(m.vertices[m.faces]).sum() for m in (upright, as_given)]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-4)  # rotated, not mirrored


def test_the_unit_of_several_views_is_told(walls: Path) -> None:
    for path in walls.glob("*.npy"):
        depth = 4 * np.load(path)  # 7.2 m away, which nearly every depth camera stores as 1/5000 m
        depth[0, :5] = 65535
        np.save(path, depth)
    base = ("depth", walls / "10.005.npy", walls / "10.031.npy", "--poses",
            walls / "groundtruth.txt", "--intrinsics", CAMERA, "--points", "60")  # fmt: skip
    done = manip3d(*base, "-o", walls / "a.ply", "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["unit"], record["unit_guessed"]) == ("tum", True)
    assert record["depth"] in done.stderr.replace("\n", " ")
    told = "read 2 depth images, depth 1.44 to 1.44 m, unit tum (1/5000 m: TUM RGB-D, ICL-NUIM)"
    assert f"{told}, guessed" in done.stderr
    assert "10 pixels of 65535 taken as not measured; --unit overrides it" in done.stderr
    done = manip3d(*base, "-o", walls / "b.ply", "--json", "--unit", "10")
    record = json.loads(done.stdout)
    assert (record["unit"], record["unit_guessed"]) == ("10", False)
    assert "warning for 2 of them: half of the image is beyond 720 m" in done.stderr
    assert "--unit" not in done.stderr


@pytest.mark.parametrize("method", ["relief", "cs3"])
def test_long_edges_and_colours_of_several_views(walls: Path, method: simplify.DepthMethod) -> None:
    pytest.importorskip("PIL")
    from PIL import Image

    files = [walls / "10.005.npy", walls / "10.031.npy"]
    colors = []
    for number, color in enumerate(((200, 30, 30), (30, 200, 30))):
        colors.append(walls / f"{number}.png")
        Image.new("RGB", (160, 120), color).save(colors[-1])
    options = simplify.DepthOptions(300, method, intrinsics=CAMERA, unit="mm")
    given = (files, walls / "groundtruth.txt", walls / "a.glb")
    whole = simplify.simplify_camera_files(*given, options, colors=colors)
    mesh = io.read_mesh(walls / "a.glb")
    images = [Image.open(BytesIO(m.textures["base_color"].data)) for m in mesh.materials]
    shown = {tuple(np.rint(np.asarray(one).mean(axis=(0, 1)) / 10) * 10) for one in images}
    assert shown == {(200, 30, 30), (30, 200, 30)}
    cut = simplify.simplify_camera_files(*given, replace(options, max_edge=0.1))
    assert cut.faces > 0
    if method == "relief":  # neighbouring pixels are nearer than that
        assert cut.faces == whole.faces
        return
    corners = (mesh := io.read_mesh(walls / "a.glb")).vertices[mesh.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= 0.1 * (1 + 1e-5)
    assert cut.faces != whole.faces


def test_what_several_views_cannot_follow_is_refused(walls: Path) -> None:
    base = ("depth", walls / "10.005.npy", "-o", walls / "x.ply", "--intrinsics", CAMERA, "-q",
            "--points", "50", "--poses", walls / "groundtruth.txt")  # fmt: skip
    for option in (
        ("--move-points",),
        ("--table", "t.csv"),
        ("--mask", "m.png"),
        ("--confidence-max", "2"),
    ):
        assert f"{option[0]}: cannot be given with" in error_line(manip3d(*base, *option))
    assert "--method: expected relief or cs3" in error_line(manip3d(*base, "--method", "ssa"))
    assert not (walls / "x.ply").exists()


def test_the_first_frames_are_joined(walls: Path) -> None:
    """The poses are in the order of all images, and there is a colour image for each."""
    pytest.importorskip("PIL")
    from PIL import Image

    (walls / "poses.txt").write_text("0 0 0 0 0 0 1\n0.5 0 0 0 0 0 1\n1 2 3 0 0 0 1\n")
    for number, name in enumerate(("10.005", "10.031", "10.060")):
        np.save(walls / f"{name}.npy", np.full((120, 160), 1800, np.uint16))
        Image.new("RGB", (160, 120), (80 * number, 0, 0)).save(walls / f"{number}.png")
    (walls / "color").mkdir()
    for path in walls.glob("*.png"):
        path.rename(walls / "color" / path.name)
    base = ("depth", walls / "*.npy", "--intrinsics", CAMERA, "--poses", walls / "poses.txt",
            "--color", walls / "color", "--points", "60", "--json")  # fmt: skip
    done = manip3d(*base, "--frames", "2", "-o", walls / "two.glb")
    assert done.returncode == 0, done.stderr
    assert [Path(name).name for name in json.loads(done.stdout)["inputs"]] == [
        "10.005.npy",
        "10.031.npy",
    ]
    mesh = io.read_mesh(walls / "two.glb")
    assert np.abs(mesh.vertices[:, 1]).max() < 1
    assert len(mesh.materials) == 2
    options = simplify.DepthOptions(60, intrinsics=CAMERA)
    with pytest.raises(InputError, match="num_frames: expected at least 1, got 0"):
        simplify.simplify_camera_files(
            sorted(walls.glob("*.npy")), walls / "poses.txt", walls / "x.ply", options, num_frames=0
        )


def test_a_folder_of_clouds_becomes_one_mesh(tmp_path: Path) -> None:
    v, u = np.mgrid[:48, :64]
    points = np.stack([(u - 31.5) / 60, (v - 23.5) / 60, 1 + 0 * u], axis=-1) * 2.0
    header = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 64\nHEIGHT 48\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3072\nDATA binary\n"
    )
    (tmp_path / "clouds").mkdir()
    for number in range(2):
        data = header.encode() + points.astype("<f4").tobytes()
        (tmp_path / "clouds" / f"{number}.pcd").write_bytes(data)
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n0.5 0 0 0 0 0 1\n")
    done = manip3d("depth", tmp_path / "clouds", "--poses", tmp_path / "poses.txt", "--points",
                   "60", "-o", tmp_path / "wall.ply")  # fmt: skip
    assert done.returncode == 0, done.stderr
    width = np.ptp(io.read_mesh(tmp_path / "wall.ply").vertices[:, 0])
    assert width == pytest.approx(0.5 + 2 * 63 / 60, abs=0.02)


def write_clouds(
    images: Path, folder: Path, turn: NDArray[np.float64], shift: NDArray[np.float64], unit: float
) -> None:
    """Write images of a box before a wall, and as clouds in a frame of their own, with poses."""
    camera = Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5)
    images.mkdir()
    folder.mkdir()
    lines = []
    for number, place in enumerate((0.0, 0.48)):  # 52 pixels at 1.2 m
        depth = np.full((120, 160), 1800, np.uint16)
        depth[40:80, 70 - 52 * number : 110 - 52 * number] = 1200
        np.save(images / f"{number}.npy", depth)
        points = camera.unproject(depth)
        moved = unit * (points @ turn.T + shift)
        header = (
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 160\n"
            "HEIGHT 120\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 19200\nDATA binary\n"
        )
        data = header.encode() + moved.astype("<f4").tobytes()
        (folder / f"{number}.pcd").write_bytes(data)
        pose = np.column_stack([turn.T, unit * ([place, 0, 0] - turn.T @ shift)])
        lines.append(" ".join(str(value) for value in pose.ravel()))
    (folder / "poses.txt").write_text("\n".join(lines))
    (images / "poses.txt").write_text("0 0 0 0 0 0 1\n0.48 0 0 0 0 0 1\n")


@pytest.mark.parametrize(
    ("angle", "shift", "unit"),
    [(0.0, (0.0, 0.0, 0.0), 1.0), (0.7, (0.3, -0.2, 1.1), 1.0), (0.7, (0.3, -0.2, 1.1), 1000.0)],
)
def test_clouds_of_cameras_become_what_their_images_do(
    angle: float, shift: tuple[float, float, float], unit: float, tmp_path: Path
) -> None:
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])
    write_clouds(tmp_path / "images", tmp_path / "clouds", turn, np.array(shift), unit)
    done = [
        manip3d("depth", tmp_path / name, "--poses", tmp_path / name / "poses.txt", "--points", 500,
                "-o", tmp_path / f"{name}.glb", "--json", *more)
        for name, more in (("images", ("--intrinsics", CAMERA)), ("clouds", ()))
    ]  # fmt: skip
    assert "organised clouds of cameras, as 2 depth images, depth 1.20 to 1.80 m" in done[1].stderr
    told = [json.loads(each.stdout) for each in done]
    assert told[1]["coverage"] == pytest.approx(told[0]["coverage"], abs=0.01)
    assert told[1]["bridges"] < 0.001
    one, two = (io.read_mesh(tmp_path / f"{name}.glb") for name in ("images", "clouds"))
    # Both lack the sheet between the box and the wall, and both are upright.
    far = metrics.closest_points(one, two.vertices / unit).distance
    assert far.max() < 0.02  # a pixel at the border
    centroids = two.vertices[two.faces].mean(axis=1) / unit
    assert metrics.closest_points(one, centroids).distance.max() < 0.03


def test_the_limit_of_edges_is_in_the_unit_of_the_clouds(tmp_path: Path) -> None:
    faces = {}
    for unit in (1.0, 1000.0):
        folder = tmp_path / f"{unit}"
        write_clouds(tmp_path / f"images{unit}", folder, np.eye(3), np.zeros(3), unit)
        for limit in (0.0135, 10.0):
            done = manip3d("depth", folder, "--poses", folder / "poses.txt", "--points", 500,
                           "--max-edge", limit * unit, "-o", tmp_path / "mesh.ply", "--force",
                           "--json")  # fmt: skip
            assert done.returncode == 0, done.stderr
            faces[unit, limit] = json.loads(done.stdout)["faces"]
    assert faces[1.0, 0.0135] != faces[1.0, 10.0]  # without the wall, the box has all points
    for limit in (0.0135, 10.0):
        assert faces[1000.0, limit] == pytest.approx(faces[1.0, limit], abs=20)


def test_clouds_without_a_camera_are_named(tmp_path: Path) -> None:
    v, u = np.mgrid[:40, :90]
    azimuth, height = np.deg2rad(4.0 * u), 0.1 * (v - 20)
    points = np.stack([3 * np.cos(azimuth), 3 * np.sin(azimuth), height], axis=-1)
    np.save(tmp_path / "0.npy", points)
    np.save(tmp_path / "1.npy", points)
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n0 0 9 0 0 0 1\n")
    base = ("depth", tmp_path / "0.npy", tmp_path / "1.npy", "--poses", tmp_path / "poses.txt",
            "--points", "60", "-o", tmp_path / "wall.ply", "--force")  # fmt: skip
    words = "an organised cloud whose points are not those of a camera's pixels"
    assert words in manip3d(*base).stderr
    assert words not in manip3d(*base, "--max-edge", 1).stderr
    error = error_line(manip3d(*base, "--unit", "mm"))
    assert "--unit: can only be given with a depth image, got a scan" in error


def test_a_camera_of_another_image_is_doubted(tmp_path: Path) -> None:
    for number, shape in enumerate([(120, 160), (60, 80)]):
        np.save(tmp_path / f"{number}.npy", np.full(shape, 2.0, np.float32))
    (tmp_path / "poses.txt").write_text("0 0 0 0 0 0 1\n0.5 0 0 0 0 0 1\n")
    base = ("depth", tmp_path / "0.npy", tmp_path / "1.npy", "--poses", tmp_path / "poses.txt",
            "--points", "60", "-o", tmp_path / "wall.ply", "--force", "--intrinsics")  # fmt: skip
    outside = manip3d(*base, "130,130,99.5,59.5").stderr
    assert "warning for 1 of them: the camera's centre (99.5, 59.5) lies outside" in outside
    inside = manip3d(*base, "130,130,60,50").stderr
    assert "lies outside" not in inside
    for told in (outside, inside):
        assert "images of 2 sizes (160 x 120, 80 x 60 pixels) have the same numbers" in told


def test_joining_tells_its_progress_and_can_be_stopped(walls: Path) -> None:
    options = simplify.DepthOptions(100, intrinsics=CAMERA, unit="mm")
    given = (sorted(walls.glob("*.npy")), walls / "groundtruth.txt", walls / "wall.ply", options)
    told: list[float] = []
    simplify.simplify_camera_files(*given, progress=lambda share, _: told.append(share))
    assert told == sorted(told)
    assert told[0] > 0
    assert told[-1] == 1
    assert len(told) >= 8  # each view is read, prepared, compared and joined
    (walls / "wall.ply").unlink()

    def stop(share: float, _: str) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simplify.simplify_camera_files(*given, progress=stop)
    assert not (walls / "wall.ply").exists()


def test_more_views_than_the_memory_holds_are_refused(
    walls: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The views that were read until then tell how many fit."""
    lines = [f"{number}.00 {number} 0 0 0 0 0 1" for number in range(9)]
    (walls / "truth.txt").write_text("\n".join(lines))
    for number in range(9):
        np.save(walls / f"{number}.00.npy", np.full((120, 160), 1800, np.uint16))
    options = simplify.DepthOptions(100, intrinsics=CAMERA, unit="mm")
    given = (sorted(walls.glob("?.00.npy")), walls / "truth.txt", walls / "wall.ply", options)
    room = 2.5 * 120 * 160 * _camera_files._BYTES_PER_PIXEL
    monkeypatch.setattr(_camera_files, "available_bytes", lambda: int(room))
    with pytest.raises(InputError, match=r"at most 2 views for .* GB .*, got 9: .* every 5th of"):
        simplify.simplify_camera_files(*given)
    assert simplify.simplify_camera_files(*given, num_frames=2).points > 90
    monkeypatch.setattr(_camera_files, "available_bytes", lambda: None)
    assert simplify.simplify_camera_files(*given, num_frames=3).points > 90


def box(jump: float) -> tuple[NDArray[np.uint16], simplify.CameraView]:
    from manip3d import Intrinsics

    depth = np.full((120, 160), 2000, np.uint16)
    depth[30:90, 50:110] = 2000 - round(1000 * jump)
    return depth, simplify.CameraView(depth, Intrinsics(160, 120, 130.0, 130.0, 79.5, 59.5))


def test_bridges_are_what_lies_far_from_each_dense_mesh() -> None:
    _, view = box(1.0)
    shares = {}
    for step in (None, 0.05):
        joint = simplify.relief_cameras([view], 200, depth_step=step)
        shares[step] = joint.bridges
        assert joint.num_measured == 120 * 160
    assert shares[None] == 0  # without steps the dense mesh joins box and wall as well
    assert shares[0.05] < 0.01
    joined = simplify.cs3_cameras([view], 30)
    cut = simplify.cs3_cameras([view], 30, depth_step=0.05)
    assert cut.bridges < 0.02
    assert joined.bridges > 0.1  # triangles from the box to the wall, long ones


def test_the_budget_of_a_joint_mesh_is_points(tmp_path: Path) -> None:
    done = manip3d("depth", "a.png", "b.png", "--poses", "p.txt", "-o", tmp_path / "a.glb")
    assert done.returncode == 2
    assert "give --points" in done.stderr
    assert "--bandwidth" not in done.stderr


def test_colors_beside_the_depth_images_are_no_views(tmp_path: Path) -> None:
    """7-Scenes has the colour images as PNG in the folder of the depth images and the poses."""
    image = pytest.importorskip("PIL.Image")
    for i in range(2):
        depth = np.full((48, 64), 2000, np.uint16)
        image.fromarray(depth).save(tmp_path / f"frame-{i}.depth.png")
        image.fromarray(np.full((48, 64, 3), 90 * i, np.uint8)).save(
            tmp_path / f"frame-{i}.color.png"
        )
        np.savetxt(tmp_path / f"frame-{i}.pose.txt", np.eye(4) + np.eye(4, k=3) * i)
    options = ("--poses", tmp_path, "--intrinsics", "60,60,31.5,23.5", "--points", "50")
    options += ("--color", tmp_path, "-o", tmp_path / "a.glb")
    done = manip3d("depth", tmp_path, *options, "--json")
    assert done.returncode == 0, done.stderr
    assert "2 files skipped, of another kind (picture)" in done.stderr
    views = [Path(name).name for name in json.loads(done.stdout)["inputs"]]
    assert views == ["frame-0.depth.png", "frame-1.depth.png"]
    named = manip3d("depth", f"{tmp_path}/*.png", *options, "--force")
    assert "frame-0.color.png" in error_line(named)
    assert "picture" in error_line(named)


def test_a_mask_of_8_bits_is_counted_once(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    for i in range(3):
        np.save(tmp_path / f"{i}_depth.npy", np.full((48, 64), 2.0, np.float32))
    image.fromarray(np.full((48, 64), 255, np.uint8)).save(tmp_path / "0_mask.png")
    np.save(tmp_path / "2_depth_mask.npy", np.ones((48, 64), np.uint8))
    (tmp_path / "poses.txt").write_text("".join(f"{i} 0 0 0 0 0 1\n" for i in range(3)))
    done = manip3d("depth", tmp_path, "--poses", tmp_path / "poses.txt", "--points", "50",
                   "--intrinsics", "60,60,31.5,23.5", "-o", tmp_path / "a.glb")  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr.count(" skipped, of another kind") == 1
    assert "2 files skipped, of another kind (mask or confidences)" in done.stderr


def test_views_of_a_lost_camera_are_left_out(tmp_path: Path) -> None:
    """ScanNet has infinite numbers for these frames."""
    files = []
    for i in range(4):
        files.append(tmp_path / f"{i}.npy")
        np.save(files[-1], np.full((48, 64), 2000, np.uint16))
        np.savetxt(tmp_path / f"{i}.txt", np.eye(4) + np.eye(4, k=3) * 4 * i)
    for lost, row in ((0, "-inf -inf -inf -inf\n"), (2, "nan,nan, nan,nan,\n")):
        (tmp_path / f"{lost}.txt").write_text("# lost\n" + row * 4)
    options = simplify.DepthOptions(50, intrinsics="60,60,31.5,23.5")
    given = (files, tmp_path, tmp_path / "a.ply", options)
    with pytest.warns(
        UserWarning, match=r"left out 2 of 4 views, .* lost camera: .*0\.txt, \.\.\."
    ):
        found = simplify.simplify_camera_files(*given)
    assert found.sources == (files[1], files[3])
    across = np.asarray(io.read_mesh(tmp_path / "a.ply").vertices)[:, 0]
    assert across.min() == pytest.approx(4 - 31.5 / 30)
    assert across.max() == pytest.approx(12 + 31.5 / 30)
    with pytest.warns(UserWarning, match="left out 2 of 4 views"):
        found = simplify.simplify_camera_files(*given, num_frames=1)
    assert found.sources == (files[1],)
    (tmp_path / "0.txt").write_text("-inf -inf -inf\n" * 4)  # no matrix
    with pytest.raises(FormatError, match="expected finite numbers"):
        simplify.simplify_camera_files(*given)
    for lost in range(4):
        (tmp_path / f"{lost}.txt").write_text("1 0 0 nan\n" * 4)
    with pytest.raises(FormatError, match="expected finite numbers"):
        simplify.simplify_camera_files(*given)


def look_at(eye: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a camera of OpenGL (x right, y up, looking along -z) in a world whose z is up."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.column_stack([right, np.cross(back, right), back, eye])
    return pose


def depth_of_ball(pose: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Return the depth image, in tenths of millimetres, of a ball of 0.5 m at the origin."""
    v, u = np.mgrid[:120, :160]
    rays = np.stack([(u - 79.5) / 130, -(v - 59.5) / 130, -np.ones(u.shape)], axis=-1)
    rays = rays @ pose[:3, :3].T  # of the depth 1, in the world's axes
    a, b = (rays**2).sum(axis=-1), rays @ pose[:3, 3]
    root = b**2 - a * (pose[:3, 3] @ pose[:3, 3] - 0.25)
    depth = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, 0.0)
    return np.round(10_000 * depth).astype(np.uint16)


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_views_of_a_transforms_json_meet_on_one_surface(tmp_path: Path, scale: float) -> None:
    """The ball is seen from all sides; the frames are stored in another order than the images."""
    frames = []
    for i, angle in enumerate(np.arange(5) * 2 * np.pi / 5):
        eye = np.array([1.4 * np.cos(angle), 1.4 * np.sin(angle), 0.6 - 0.3 * i])
        pose = look_at(eye, np.zeros(3))
        np.save(tmp_path / f"view_{i}.npy", depth_of_ball(pose))
        pose[:3, 3] *= scale
        frames.append({"file_path": f".\\images\\view_{i}.jpg", "transform_matrix": pose.tolist()})
    text = json.dumps({"applied_scale": scale, "frames": frames[::-1]})
    (tmp_path / "transforms.json").write_text(text)
    done = manip3d(
        "depth", *sorted(tmp_path.glob("*.npy")), "--intrinsics", CAMERA, "--unit", "10000",
        "--poses", tmp_path / "transforms.json", "--points", "2000", "-o", tmp_path / "ball.ply",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    vertices = io.read_mesh(tmp_path / "ball.ply").vertices
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.5).max() < 2e-4  # depths have steps of 1e-4
    assert (vertices.min(axis=0)[:2] < -0.49).all()
    assert (vertices.max(axis=0)[:2] > 0.49).all()


def transforms(path: Path, *frames: object, **fields: object) -> Path:
    path.write_text(json.dumps({"frames": list(frames), **fields}))
    return path


def frame_at(x: float, **names: object) -> dict[str, object]:
    pose = np.eye(4)
    pose[0, 3] = x
    return {"transform_matrix": pose.tolist(), **names}


def test_frames_of_a_transforms_json_are_found_by_name(tmp_path: Path) -> None:
    place = tmp_path / "transforms.json"

    def places(*names: str) -> list[float]:
        return [float(p[0, 3]) for p in simplify.poses_of_files(names, place)]

    transforms(
        place,
        frame_at(1, file_path="images/b.jpg", depth_file_path="depth/a.png"),
        frame_at(2, file_path="images/a.jpg", depth_file_path="depth/b.png"),
        frame_at(3, file_path="./train/1305031102.16"),  # without a suffix
    )
    assert places("depth/b.png", "a.npy", "1305031102.16.png.xz") == [2, 1, 3]
    with pytest.raises(InputError, match=r"expected a frame of c\.png in .*transforms\.json"):
        places("a.png", "c.png")
    transforms(place, *(frame_at(i, file_path=f"rgb/{i}.png") for i in (10, 2, 1)))
    assert places("x.png", "y.png", "z.png") == [1, 2, 10]
    with pytest.raises(InputError, match=r"names of frames, or 2 poses in .*, found 3"):
        places("x.png", "y.png")
    transforms(place, frame_at(5), frame_at(4, file_path=7, depth_file_path="x" * 5000))
    assert places("x.png", "y.png") == [5, 4]
    (pose,) = simplify.poses_of_files(["a.png"], transforms(place, frame_at(1)))
    np.testing.assert_array_equal(pose @ [0, 0, 2, 1], [1, 0, -2, 1])  # before OpenGL's camera


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("{", "expected JSON"),
        ("[" * 100_000, "expected JSON"),
        ('{"frames": [' + "9" * 5000 + "]}", "expected JSON"),
        ("[]", "expected 'frames' with a 'transform_matrix' each"),
        ('{"frames": []}', "expected 'frames'"),
        ('{"frames": {"a": 1}}', "expected 'frames'"),
        ('{"frames": [3]}', r"frames\[0\]: expected an object"),
        ('{"frames": [{}]}', r"frames\[0\]\.transform_matrix: expected a matrix, found none"),
    ],
)
def test_a_transforms_json_without_frames_is_refused(
    content: str, told: str, tmp_path: Path
) -> None:
    (tmp_path / "transforms.json").write_text(content)
    with pytest.raises(FormatError, match=f"transforms.json: .*{told}"):
        simplify.poses_of_files(["a.png"], tmp_path / "transforms.json")


MIRRORED = np.diag([1.0, 1.0, -1.0, 1.0]).tolist()
TWICE = np.diag([2.0, 2.0, 2.0, 1.0]).tolist()
LOST = np.full((4, 4), np.nan).tolist()
HUGE = np.diag([1e300, 1e300, 1e300, 1.0]).tolist()
WORDS = [["1", "0", "0", "0"], ["0", "1", "0", "0"], ["0", "0", "1", "0"], ["0", "0", "0", "1"]]


@pytest.mark.parametrize(
    "matrix",
    [MIRRORED, TWICE, LOST, HUGE, WORDS, np.eye(3).tolist(), [[1, 0], [0]], 1, "x", {}, [],
     [[10**400] * 4] * 4, np.eye(4).T[:3].tolist()],
)  # fmt: skip
def test_a_matrix_of_a_frame_that_is_no_pose_is_refused(matrix: object, tmp_path: Path) -> None:
    wrong = {"transform_matrix": matrix}
    place = transforms(tmp_path / "transforms.json", frame_at(0), wrong)
    told = r"frames\[1\]\.transform_matrix: expected a rigid transform, 4 x 4 finite numbers"
    with pytest.raises(FormatError, match=told):
        simplify.poses_of_files(["a.png", "b.png"], place)


@pytest.mark.parametrize("scale", [0, -1, True, "1", [1], None, float("nan"), float("inf")])
def test_a_scale_of_a_transforms_json_is_above_0(scale: object, tmp_path: Path) -> None:
    place = transforms(tmp_path / "transforms.json", frame_at(0), applied_scale=scale)
    with pytest.raises(FormatError, match="applied_scale: expected a number above 0"):
        simplify.poses_of_files(["a.png"], place)


def test_what_a_scale_makes_infinite_is_no_pose(tmp_path: Path) -> None:
    place = transforms(tmp_path / "transforms.json", frame_at(1e300), applied_scale=1e-300)
    with pytest.raises(FormatError, match="expected a rigid transform"):
        simplify.poses_of_files(["a.png"], place)


def test_two_frames_of_one_name_are_refused_only_if_it_is_asked_for(tmp_path: Path) -> None:
    paths = ("left/0001.png", "right/0001.png", "left/0002.png")
    frames = [frame_at(i, file_path=path) for i, path in enumerate(paths)]
    place = transforms(tmp_path / "transforms.json", *frames)
    with pytest.raises(InputError, match=r"expected a frame of 0001\.png in .*, found 2"):
        simplify.poses_of_files(["0002.png", "0001.png"], place)
    (pose,) = simplify.poses_of_files(["0002.png"], place)
    assert pose[0, 3] == 2
    poses = simplify.poses_of_files(["a.png", "b.png", "c.png"], place)  # left before right
    assert [pose[0, 3] for pose in poses] == [0, 2, 1]


@pytest.mark.parametrize(
    ("files", "frames", "found"),
    [
        (("depth_2.png", "depth_3.png"), ("rgb_1.png", "rgb_2.png", "rgb_3.png"), [2, 3]),
        (("2_depth.png", "3_depth.png"), ("1.png", "2.png", "3.png"), [2, 3]),
        (("3.png", "2.png"), ("0001.png", "0002.png", "0003.png"), [3, 2]),
        (("img_0002.png",), ("frame 1.jpg", "frame 2.jpg"), [2]),
        (("depth.png",), ("rgb.png",), [1]),  # without numbers, in order
    ],
)
def test_frames_of_a_transforms_json_are_found_by_numbers(
    files: tuple[str, ...], frames: tuple[str, ...], found: list[float], tmp_path: Path
) -> None:
    """Some depth images of many were refused, or got the poses of the first frames."""
    named = [frame_at(i, file_path=name) for i, name in enumerate(frames, start=1)]
    place = transforms(tmp_path / "transforms.json", *named)
    assert [pose[0, 3] for pose in simplify.poses_of_files(files, place)] == found


def test_files_get_no_poses_of_frames_with_other_numbers(tmp_path: Path) -> None:
    """There are as many frames as files, so that they were assigned in order."""
    named = [frame_at(i, file_path=f"rgb_{i:04}.png") for i in (1, 2)]
    place = transforms(tmp_path / "transforms.json", *named)
    with pytest.raises(InputError, match=r"expected a frame of depth_0003\.png in .*, found none"):
        simplify.poses_of_files(["depth_0002.png", "depth_0003.png"], place)
    with pytest.raises(InputError, match=r"a frame of b1\.png in .*, found that of a1\.png"):
        simplify.poses_of_files(["a1.png", "b1.png"], place)


@pytest.mark.parametrize("name", ["transforms.json", "truth.txt", "a.log", "a.conf"])
def test_poses_may_begin_with_a_byte_order_mark(name: str, tmp_path: Path) -> None:
    """The editor of Windows writes one."""
    texts = {
        "transforms.json": json.dumps({"frames": [frame_at(1, file_path="5.png")]}),
        "truth.txt": POSES,
        "a.log": "5 5 6\n" + MATRIX,
        "a.conf": "bmesh 5.png 1 0 0 0 0 0 1\n",
    }
    place = tmp_path / name
    given = []
    for encoding in ("utf-8", "utf-8-sig"):
        place.write_text(texts[name], encoding)
        files = ["10.005.png"] if name == "truth.txt" else ["5.png"]
        given += simplify.poses_of_files(files, place)
    np.testing.assert_array_equal(*given)
