"""KITTI's layouts: one loader for raw drives, object, odometry and stereo-2015."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from manip3d import FormatError, InputError, LidarFrame, authenticate, capture
from manip3d._util.linear import product
from manip3d._util.times import parse_time
from manip3d.authenticate._watermark_files import copy_rest_of_drive
from manip3d.datasets import KittiDrive, open_kitti
from manip3d.lidar import Box
from real_data import RealData

# x forward, y left, z up to x right, y down, z forward.
AXES = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]])


def line(name: str, values: np.ndarray) -> str:
    return f"{name}: " + " ".join(f"{v:.12e}" for v in np.ravel(values)) + "\n"


def projection(shift: float) -> np.ndarray:
    return np.array([[700, 0, 600, shift], [0, 700, 180, 0], [0, 0, 1, 0]])


def scan(seed: int) -> LidarFrame:
    rng = np.random.default_rng(seed)
    return LidarFrame(rng.normal(size=(50, 3)), rng.random(50).astype(np.float32))


def write_raw(folder: Path) -> Path:
    drive = folder / "2011_01_01" / "2011_01_01_drive_0001_sync"
    points = drive / "velodyne_points"
    (points / "data").mkdir(parents=True)
    for index, suffix in ((0, ".bin"), (2, ".bin.xz")):  # frame 1 is missing
        scan(index).write(points / "data" / f"{index:010d}{suffix}")
    times = [f"2011-01-01 00:00:0{i}.500000001" for i in range(3)]
    (points / "timestamps.txt").write_text("\n".join(times) + "\n")
    (points / "labels").mkdir()
    (points / "labels" / "0000000002.label").write_bytes(np.arange(50, dtype="<u4").tobytes())
    (drive / "image_02" / "data").mkdir(parents=True)
    (drive / "image_02" / "data" / "0000000002.png").write_bytes(b"")
    day = drive.parent
    (day / "calib_cam_to_cam.txt").write_text(
        "calib_time: 09-Jan-2012 13:57:47\n"
        + line("R_rect_00", np.eye(3))
        + line("P_rect_02", projection(0.0))
        + line("P_rect_03", projection(-350.0))
    )
    (day / "calib_velo_to_cam.txt").write_text(line("R", AXES) + line("T", np.array([0, 0, -0.25])))
    return drive


def test_raw_drive(tmp_path: Path) -> None:
    drive = open_kitti(write_raw(tmp_path))
    assert [f.name for f in drive] == ["0000000000", "0000000002"]
    first, second = drive[0], drive[-1]
    assert np.array_equal(second.scan().points, scan(2).points)
    assert second.scan().fields["label"].tolist() == list(range(50))
    assert first.scan().fields == {}
    # The second scan is frame 2: the third line of the timestamps.
    assert second.time_ns == 1_293_840_002_500_000_001
    assert second.scan().time_ns == second.time_ns
    assert (sorted(first.images), sorted(second.images)) == ([], [2])
    assert [f.name for f in drive[1:]] == ["0000000002"]
    calibration = drive[0].calibration()
    assert calibration.baseline() == pytest.approx(0.5)
    # 10 m ahead, 1 m to the left, 0.5 m up; the camera stands 0.25 m ahead of the LiDAR.
    pixels, depth = calibration.project([[10.0, 1.0, 0.5]])
    assert depth[0] == pytest.approx(9.75)
    assert pixels[0] == pytest.approx([600 - 700 / 9.75, 180 - 350 / 9.75])
    with pytest.raises(InputError, match=r"camera: expected one of \[2, 3\], got 0"):
        calibration.project([[1.0, 0.0, 0.0]], 0)
    with pytest.raises(InputError, match=r"points: expected shape \(N, 3\), got \(1, 4\)"):
        calibration.project([[1.0, 2.0, 3.0, 4.0]])
    with pytest.raises(InputError, match=r"left: expected one of \[2, 3\], got 0"):
        calibration.baseline(0)
    with pytest.raises(InputError, match=r"right: expected one of \[2, 3\], got 1"):
        calibration.baseline(2, 1)


def write_object(folder: Path) -> Path:
    for name in ("velodyne", "calib", "label_2"):
        (folder / name).mkdir(parents=True)
    scan(0).write(folder / "velodyne" / "000007.bin")
    (folder / "calib" / "000007.txt").write_text(
        line("P2", projection(0.0))
        + line("R0_rect", np.eye(3))
        + line("Tr_velo_to_cam", np.column_stack([AXES, [0, 0, 0]]))
    )
    (folder / "label_2" / "000007.txt").write_text(
        "Car 0.00 0 -1.57 599 156 629 189 1.5 1.6 4.0 -3.0 1.5 20.0 0.1\n"
        "DontCare -1 -1 -10 503 169 590 190 -1 -1 -1 -1000 -1000 -1000 -10\n"
    )
    return folder


@pytest.mark.parametrize("suffix", [".txt", ".npz", ".bin"])
def test_scans_of_a_drive_may_be_texts_and_arrays(tmp_path: Path, suffix: str) -> None:
    """KITTI's raw drives that were not synchronised hold texts."""
    drive = write_raw(tmp_path)
    data = drive / "velodyne_points" / "data"
    for path in data.iterdir():
        path.unlink()
    (data / "readme.txt").write_text("measured on Monday\n")
    for index in (0, 2):
        scan(index).write(data / f"{index:010d}{suffix}")
    found = open_kitti(drive)
    assert [frame.name for frame in found] == ["0000000000", "0000000002"]
    assert [len(frame.scan().points) for frame in found] == [50, 50]
    with capture.open(f"kitti:{drive}") as source:
        assert len(list(source)) == 2


def test_object_labels_become_boxes_of_the_lidar(tmp_path: Path) -> None:
    frame = open_kitti(write_object(tmp_path))[0]
    (box,) = frame.boxes()
    assert box.label == "Car"
    assert box.size == (4.0, 1.6, 1.5)
    # x = camera z, y = -camera x, z = -camera y; the label's place is the middle of the bottom.
    assert box.center == pytest.approx((20.0, 3.0, -1.5 + 0.75))
    # rotation_y 0 looks to the camera's right: -y of the LiDAR; positive turns look backwards.
    assert box.yaw == pytest.approx(-np.pi / 2 - 0.1)


def test_a_frame_without_its_file_of_calibration(tmp_path: Path) -> None:
    (write_object(tmp_path) / "calib" / "000007.txt").unlink()
    frame = open_kitti(tmp_path)[0]
    assert frame.calibration_files == ()
    for read in (frame.calibration, frame.boxes):
        with pytest.raises(InputError, match="no calibration of frame 000007"):
            read()


def test_labels_of_points_are_read_only(tmp_path: Path) -> None:
    folder = write_object(tmp_path)
    (folder / "labels").mkdir()
    labels = np.arange(scan(0).num_points, dtype="<u4")
    (folder / "labels" / "000007.label").write_bytes(labels.tobytes())
    found = open_kitti(folder)[0].scan().fields["label"]
    np.testing.assert_array_equal(found, labels)
    assert not found.flags.writeable


def test_a_name_may_have_dots(tmp_path: Path) -> None:
    """Only the suffix is left out, so that labels and images of the same name are found."""
    drive = write_object(tmp_path)
    for folder, suffix in (("velodyne", ".bin"), ("calib", ".txt"), ("label_2", ".txt")):
        (drive / folder / f"000007{suffix}").rename(drive / folder / f"7.a.b{suffix}")
    (drive / "times.txt").write_text("".join(f"{i}.0\n" for i in range(8)))
    frame = open_kitti(drive)[0]
    assert (frame.name, frame.time_ns) == ("7.a.b", None)
    assert [box.label for box in frame.boxes()] == ["Car"]
    assert authenticate.drive_numbers(drive) == [0]
    scans = capture.open_drive(drive)
    assert len(list(scans)) == 1
    assert scans.times_ns == {}


def test_odometry_and_stereo_2015(tmp_path: Path) -> None:
    sequence = tmp_path / "00"
    (sequence / "velodyne").mkdir(parents=True)
    for i in range(2):
        scan(i).write(sequence / "velodyne" / f"{i:06d}.bin")
    (sequence / "times.txt").write_text("0.0\n1.037e-01\n")
    (sequence / "calib.txt").write_text(
        line("P0", projection(0.0)) + line("Tr", np.column_stack([AXES, [0, 0, 0]]))
    )
    (sequence / "disp_occ_0").mkdir()
    (sequence / "disp_occ_0" / "000001.png").write_bytes(b"")
    drive = open_kitti(sequence)
    assert [f.time_ns for f in drive] == [0, 103_700_000]
    assert drive[0].calibration().T_rect_velo[:3, :3].tolist() == AXES.tolist()
    assert drive[0].disparity_path is None
    assert drive[1].disparity_path is not None
    elsewhere = open_kitti(write_object(tmp_path / "object"), calibration=sequence / "calib.txt")
    assert elsewhere[0].calibration().projections.keys() == {0}


@pytest.mark.parametrize(
    ("rectification", "transform", "is_turned"),
    [
        ("R0_rect: {}", "Tr_velo_to_cam: {}", True),
        ("R_rect {}", "Tr_velo_cam {}", True),  # the tracking benchmark
        ("R0_rect: {}", "Tr: {}", False),  # Tr includes the rectification
    ],
)
def test_the_rectification_belongs_to_a_transform_that_does_not_include_it(
    rectification: str, transform: str, is_turned: bool, tmp_path: Path
) -> None:
    half_turn, place = np.diag([-1.0, -1.0, 1.0]), tmp_path / "000007.txt"
    texts = (
        line("", matrix).lstrip(": ") for matrix in (half_turn, np.column_stack([AXES, [1, 2, 3]]))
    )
    place.write_text("".join(map(str.format, (rectification, transform), texts)))
    write_object(tmp_path / "object")
    found = open_kitti(tmp_path / "object", calibration=place)[0].calibration().T_rect_velo
    expected = product(half_turn if is_turned else np.eye(3), AXES)
    assert found[:3, :3].tolist() == expected.tolist()


def test_the_files_of_a_day_may_lie_in_the_folder_calib(tmp_path: Path) -> None:
    day = write_raw(tmp_path / "raw").parent
    folder = write_object(tmp_path / "object")
    (folder / "calib" / "000007.txt").unlink()
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"):
        (day / name).rename(folder / "calib" / name)
    assert open_kitti(folder)[0].calibration().projections.keys() == {2, 3}


@pytest.mark.parametrize("is_copied", [False, True])
@pytest.mark.parametrize("per_frame", [False, True])
def test_a_calibration_in_the_folder_precedes_that_of_the_day(
    tmp_path: Path, is_copied: bool, per_frame: bool
) -> None:
    """A sequence of odometry or of the object set that lies beside raw drives."""
    day = write_raw(tmp_path).parent
    sequence = write_object(day / "object")
    if not per_frame:
        (sequence / "calib" / "000007.txt").rename(sequence / "calib.txt")
        (sequence / "calib").rmdir()
    if is_copied:
        copy = tmp_path / "signed"
        copy_rest_of_drive(sequence, copy)
        (copy / "velodyne").mkdir()
        scan(0).write(copy / "velodyne" / "000007.bin")
        sequence = copy
    assert open_kitti(sequence)[0].calibration().projections.keys() == {2}  # the day has 2 and 3


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda d: (d / "velodyne_points/labels/0000000002.label").write_bytes(bytes(7)),
         FormatError, "byte 7: expected 50 labels of 4 bytes, got 7 bytes"),
        (lambda d: (d.parent / "calib_velo_to_cam.txt").write_text("R: 1 2 3\n"), FormatError,
         "R: expected 9 finite numbers, got 3 numbers"),
        (lambda d: (d.parent / "calib_velo_to_cam.txt").write_text(""), FormatError,
         "R: expected 9 finite numbers, got no such line"),
        (lambda d: (d.parent / "calib_cam_to_cam.txt").unlink(), InputError, "no calibration"),
        (lambda d: (d.parent / "calib_cam_to_cam.txt").write_text("R_rect_00: 1 0 0 0 1 0 0 0 1,"),
         FormatError, "R_rect_00: expected 9 finite numbers, got [1.0, 0.0, 0.0, 0.0, 1.0"),
        (lambda d: (d.parent / "calib_cam_to_cam.txt").write_text("P_rect_02: 1 0 no\n"),
         FormatError, "P_rect_02: expected 12 finite numbers, got 3 numbers"),
        (lambda d: (d.parent / "calib_velo_to_cam.txt").write_text("R: 1 0 0 0 1 0 0 0 0\nT: 0 0"),
         FormatError, "R: expected a rotation, got a matrix 1 off an orthogonal one"),
    ],
)  # fmt: skip
def test_damage(tmp_path: Path, spoil, error: type[Exception], message: str) -> None:  # type: ignore[no-untyped-def]
    path = write_raw(tmp_path)
    spoil(path)

    def read_all() -> None:
        for frame in open_kitti(path):
            frame.scan()
            frame.calibration()

    with pytest.raises(error, match=re.escape(message)):
        read_all()


@pytest.mark.parametrize(
    "line", ["now", "\udcff\x1b[2J", "2011-01-01 00:00:00.1e9", "9999-01-01 00:00:00", "0001-01-01"]
)
def test_a_line_that_is_no_time_is_told_and_hides_no_frame(tmp_path: Path, line: str) -> None:
    path = write_raw(tmp_path)
    times = path / "velodyne_points/timestamps.txt"
    known = [frame.time_ns for frame in open_kitti(path)]
    good = times.read_text().splitlines()
    bad = [line, *good[1:-1], line]
    times.write_bytes("\n".join(bad).encode("utf-8", "surrogateescape"))
    message = f"timestamps.txt: line 1: expected a time, got {line!r}; 1 more line is no time"
    with pytest.warns(UserWarning, match=re.escape(message)):
        drive = open_kitti(path)
    lost = {0, len(good) - 1}
    assert [frame.time_ns for frame in drive] == [
        None if int(frame.name) in lost else time_ns
        for frame, time_ns in zip(drive, known, strict=True)
    ]


def test_times_of_iso_8601_with_a_byte_order_mark(tmp_path: Path) -> None:
    path = write_raw(tmp_path)
    times = path / "velodyne_points/timestamps.txt"
    known = [frame.time_ns for frame in open_kitti(path)]
    times.write_text("\ufeff" + times.read_text().replace(" ", "T"), encoding="utf-8")
    assert [frame.time_ns for frame in open_kitti(path)] == known


@pytest.mark.parametrize("word", ["nan", "inf", "1e999", "wide"])
def test_numbers_of_labels_and_times_are_finite(tmp_path: Path, word: str) -> None:
    path = write_object(tmp_path)
    label = path / "label_2" / "000007.txt"
    label.write_text(label.read_text().replace("4.0", word, 1))
    with pytest.raises(FormatError, match="line 1: expected a label of 15 words, the last"):
        open_kitti(path)[0].boxes()
    label.write_text(label.read_text().replace(word, "-4.0", 1))
    with pytest.raises(FormatError, match="the first 3 are sizes >= 0"):
        open_kitti(path)[0].boxes()
    label.unlink()
    (path / "times.txt").write_text(f"0.0\n{word}\n")
    with pytest.warns(UserWarning, match="line 2: expected a time"):
        open_kitti(path)


def test_no_such_layout(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="velodyne_points/data or velodyne, found neither"):
        open_kitti(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_kitti(tmp_path / "none")


def test_time_without_fraction() -> None:
    assert parse_time("1970-01-02 00:00:01") == 86_401 * 10**9


def manifest_counts(realdata: RealData) -> list[tuple[str, int, float, float]]:
    """Scan, points, least and largest range of table 2 of the manifest."""
    rows = []
    for text in realdata("lidar/MANIFEST.md").read_text().splitlines():
        cells = [cell.strip() for cell in text.strip("|").split("|")]
        if len(cells) == 9 and cells[1].isdecimal():
            low, high = map(float, cells[2].split("-"))
            rows.append((cells[0].strip("`"), int(cells[1]), low, high))
    return rows


def drive_of(realdata: RealData, cloud: str) -> tuple[KittiDrive, str]:
    """The drive that holds a cloud of the manifest, which shortens paths by an ellipsis."""
    folder, name = cloud.rsplit("/", 1)
    day = realdata("lidar/kitti_raw/2011_09_26")
    drive = realdata("lidar") / folder.replace("/…", "").removesuffix("/velodyne")
    return open_kitti(drive, calibration=day), name.split(".")[0]


def test_every_cloud_of_the_manifest(realdata: RealData) -> None:
    rows = manifest_counts(realdata)
    assert len(rows) == 53
    for cloud, num_points, low, high in rows:
        drive, name = drive_of(realdata, cloud)
        (frame,) = (f for f in drive if f.name == name)
        points = frame.scan().points.astype(np.float64)
        distance = np.linalg.norm(points, axis=1)
        assert len(points) == num_points
        assert distance.min() == pytest.approx(low, abs=0.005)
        assert distance.max() == pytest.approx(high, abs=0.005)


@pytest.mark.parametrize(
    ("folder", "camera", "size", "expected"),
    [
        ("kitti_raw/2011_09_26/2011_09_26_drive_0002_sync", 2, (1242, 375), 19145),
        ("kitti_raw/2011_09_26/2011_09_26_drive_0005_sync", 2, (1242, 375), 20478),
        ("kitti_stereo2015", 2, (1242, 375), 20343),
        ("kitti_object", 2, (1242, 375), 17835),
        ("kitti_odometry/00", 0, (1241, 376), 19362),
    ],
)
def test_points_in_the_left_image(
    realdata: RealData, folder: str, camera: int, size: tuple[int, int], expected: int
) -> None:
    day = realdata("lidar/kitti_raw/2011_09_26")
    calibration = day if folder == "kitti_stereo2015" else None
    frame = open_kitti(realdata(f"lidar/{folder}"), calibration=calibration)[0]
    assert camera in frame.images
    pixels, depth = frame.calibration().project(frame.scan().points, camera)
    ahead = depth > 0
    inside = np.all((pixels[ahead] >= 0) & (pixels[ahead] < size), axis=1)
    assert np.count_nonzero(inside) == expected


def test_real_drive_in_time(realdata: RealData) -> None:
    drive = open_kitti(realdata("lidar/kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"))
    times = [frame.time_ns / 1e9 for frame in drive if frame.time_ns is not None]
    steps = np.diff(np.array(times, dtype=np.float64))
    assert len(times) == 20
    assert np.all((steps > 0.09) & (steps < 0.12))


TRACKLETS = """<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>
<!DOCTYPE boost_serialization>
<boost_serialization signature="serialization::archive" version="9">
<tracklets class_id="0" tracking_level="0" version="0">
<count>2</count><item_version>1</item_version>
<item class_id="1" tracking_level="0" version="1">
<objectType>Car</objectType><h>1.5</h><w>1.75</w><l>4</l><first_frame>0</first_frame>
<poses class_id="2" tracking_level="0" version="0"><count>2</count><item_version>2</item_version>
<item><tx>10</tx><ty>2</ty><tz>-1.75</tz><rx>0</rx><ry>0</ry><rz>0.5</rz><state>2</state></item>
<item><tx>11</tx><ty>2</ty><tz>-1.75</tz><rx>0</rx><ry>0</ry><rz>0.25</rz><state>2</state></item>
</poses><finished>1</finished></item>
<item><objectType>Pedestrian</objectType><h>1.8</h><w>0.6</w><l>0.5</l><first_frame>1</first_frame>
<poses><count>1</count><item_version>2</item_version>
<item><tx>5</tx><ty>-1</ty><tz>-1.8</tz><rx>0</rx><ry>0</ry><rz>-1</rz></item>
</poses><finished>1</finished></item>
</tracklets></boost_serialization>
"""


def test_tracklets_of_a_raw_drive(tmp_path: Path) -> None:
    drive_path = write_raw(tmp_path)
    assert open_kitti(drive_path)[0].boxes() == ()
    (drive_path / "tracklet_labels.xml").write_text(TRACKLETS)
    drive = open_kitti(drive_path)
    # The place of a tracklet is the middle of the bottom.
    assert drive.tracklets[0] == (Box((10.0, 2.0, -1.0), (4.0, 1.75, 1.5), 0.5, "Car", 0),)
    second = drive.tracklets[1]
    assert [(box.label, box.track) for box in second] == [("Car", 0), ("Pedestrian", 1)]
    assert second[1].center == pytest.approx((5.0, -1.0, -0.9))
    assert set(drive.tracklets) == {0, 1}
    frame = drive[0]
    assert frame.boxes() == drive.tracklets.get(int(frame.name), ())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<h>1.5</h>", "<h>tall</h>", "h, w, l: expected finite numbers"),
        ("<h>1.5</h>", "", "h, w, l: expected finite numbers"),
        ("<h>1.5</h>", "<h>-1.5</h>", "expected sizes >= 0 of object 0"),
        ("<tx>10</tx>", "<tx>inf</tx>", "tx, ty, tz, rz"),
        ("tracklets", "tricklets", "expected an element tracklets"),
        ("</item>", "", "not well-formed"),
        ("<!DOCTYPE boost_serialization>", '<!DOCTYPE a [<!ENTITY b "c">]>', "entities"),
    ],
)
def test_damaged_tracklets(tmp_path: Path, old: str, new: str, message: str) -> None:
    drive = write_raw(tmp_path)
    (drive / "tracklet_labels.xml").write_text(TRACKLETS.replace(old, new))
    with pytest.raises(FormatError, match=message):
        open_kitti(drive)[0].boxes()
