"""Drives as files: KITTI's layout, read back by the loader that reads KITTI."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from manip3d import InputError
from manip3d.datasets import open_kitti
from manip3d.simulate import DriveFrame, Street, cameras, drive, drives, write_drive
from manip3d.simulate.lidar import TURN_PERIOD

pytest.importorskip("open3d")
image = pytest.importorskip("PIL.Image")

FRAMES = 2


@pytest.fixture(scope="module")
def place(busy_street: Street) -> Street:
    return busy_street


@pytest.fixture(scope="module")
def frames(place: Street) -> list[DriveFrame]:
    return list(drive(place, FRAMES, rng=5))


@pytest.fixture(scope="module")
def folder(place: Street, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("drives") / "mine"
    return write_drive(place, target, FRAMES, number=7, rng=5)


def test_the_layout_is_kitti_s(folder: Path) -> None:
    assert folder.name == "2000_01_01_drive_0007_sync"
    for file in (
        "velodyne_points/data/0000000001.bin",
        "velodyne_points/timestamps_start.txt",
        "velodyne_points/timestamps_end.txt",
        "image_02/data/0000000001.png",
        "image_03/timestamps.txt",
        "oxts/data/0000000001.txt",
        "oxts/dataformat.txt",
        "../calib_imu_to_velo.txt",
    ):
        assert (folder / file).is_file(), file
    assert len((folder / "oxts/data/0000000000.txt").read_text().split()) == 30


def test_scans_and_truth_come_back(folder: Path, frames: list[DriveFrame]) -> None:
    read = open_kitti(folder)
    assert len(read) == FRAMES
    for got, made in zip(read, frames, strict=True):
        scan = got.scan()
        np.testing.assert_array_equal(scan.points, made.scan.points)
        np.testing.assert_array_equal(scan.intensity, made.scan.intensity)
        label = scan.fields["label"]
        np.testing.assert_array_equal(label & 0xFFFF, made.scan.label)
        np.testing.assert_array_equal((label >> 16).astype(int) - 1, made.scan.object)
        assert scan.time_ns == pytest.approx(1e9 * (946_728_000 + made.time_s), abs=1000)


def test_pictures_come_back(folder: Path, frames: list[DriveFrame]) -> None:
    for got, made in zip(open_kitti(folder), frames, strict=True):
        assert made.pictures is not None
        for camera, pixels in ((2, made.pictures.left), (3, made.pictures.right)):
            with image.open(got.images[camera]) as picture:
                np.testing.assert_array_equal(np.asarray(picture), pixels)


def test_boxes_come_back(folder: Path, frames: list[DriveFrame]) -> None:
    for got, made in zip(open_kitti(folder), frames, strict=True):
        read = got.boxes()
        assert len(read) == len(made.boxes) > 5
        for a, b in zip(read, made.boxes, strict=True):
            assert a.label == b.label
            np.testing.assert_allclose(a.center, b.center, atol=2e-4)
            np.testing.assert_allclose(a.size, b.size, atol=1e-4)
            assert abs(math.remainder(a.yaw - b.yaw, 2 * math.pi)) < 2e-4


def test_boxes_hold_the_points_of_their_objects(frames: list[DriveFrame]) -> None:
    for frame in frames:
        assert np.isin(frame.scan.object, [box.track for box in frame.boxes]).sum() > 500
        for box in frame.boxes:
            mine = frame.scan.points[frame.scan.object == box.track]
            grown = type(box)(box.center, tuple(s + 1.0 for s in box.size), box.yaw)
            assert grown.contains(mine).all()


def test_calibration_comes_back(folder: Path) -> None:
    calibration = open_kitti(folder)[0].calibration()
    matrices, rigid = cameras.projections()
    np.testing.assert_allclose(calibration.T_rect_velo, rigid, atol=1e-9)
    for camera in range(4):
        np.testing.assert_allclose(
            calibration.projections[camera], matrices[camera], rtol=1e-8, atol=1e-9
        )
    assert calibration.baseline() == pytest.approx(0.5327, abs=1e-6)


def test_positions_are_the_car_s(folder: Path, place: Street, frames: list[DriveFrame]) -> None:
    for index, made in enumerate(frames):
        values = np.loadtxt(folder / "oxts" / "data" / f"{index:010d}.txt")
        # The devkit's Mercator projection.
        scale = math.cos(math.radians(49.0))
        x = scale * math.radians(values[1] - 8.4) * 6378137.0
        y = [
            scale * 6378137.0 * math.log(math.tan(math.radians(90.0 + lat) / 2.0))
            for lat in (values[0], 49.0)
        ]
        position, yaw = place.pose([made.time_s])
        np.testing.assert_allclose([x, y[0] - y[1], values[2]], position[0], atol=1e-4)
        assert values[5] == pytest.approx(yaw[0], abs=1e-9)
        assert values[8] == pytest.approx(place.speed, rel=0.01)


def test_frames_do_not_depend_on_how_many_follow(place: Street, frames: list[DriveFrame]) -> None:
    (alone,) = drive(place, 1, rng=5, pictures=False)
    assert alone.pictures is None
    np.testing.assert_array_equal(alone.scan.points, frames[0].scan.points)


def test_each_camera_of_a_surround_drive_has_its_times(place: Street, tmp_path: Path) -> None:
    """Pairs expose when the LiDAR, which turns clockwise, looks in their direction."""
    folder = write_drive(place, tmp_path / "mine", 1, start=1.0, surround=True)
    seconds = {
        camera: float((folder / f"image_{camera:02d}/timestamps.txt").read_text()[17:].strip())
        for camera in range(2, 12)
    }
    turns = {"front": 0.0, "left": -0.2, "rear-left": -0.4, "rear-right": 0.4, "right": 0.2}
    for name, pair in drives.surround_pairs().items():
        assert seconds[pair.left] == seconds[pair.right]
        assert seconds[pair.left] == pytest.approx(1.0 + turns[name] * TURN_PERIOD)
        assert (folder / f"image_{pair.right:02d}/data/0000000000.png").is_file()


def test_one_time_for_all_rays_is_as_a_time_for_each(place: Street) -> None:
    rays = np.tile(np.float32([1.0, 0.0, 0.0]), (4, 1))
    origins = np.tile(np.float32([60.0, 0.0, 2.0]), (4, 1))
    together = place.stage.cast(origins, rays, 0.5)
    each = place.stage.cast(origins, rays, np.full(4, 0.5, np.float32))
    np.testing.assert_array_equal(together.distance, each.distance)
    np.testing.assert_array_equal(together.object, each.object)


def test_a_stopped_run_leaves_nothing(place: Street, tmp_path: Path) -> None:
    def stop(fraction: float, message: str) -> None:
        if fraction > 0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_drive(place, tmp_path / "drive", 3, pictures=False, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_folder_and_a_short_street_are_refused(place: Street, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a new folder, but this one exists"):
        write_drive(place, tmp_path, 1)
    with pytest.raises(InputError, match="times: expected the car on the street"):
        write_drive(place, tmp_path / "far", 100_000)
    with pytest.raises(InputError, match="frames: expected at least 1, got 0"):
        list(drive(place, 0))
    with pytest.raises(InputError, match="surround: requires pictures=True"):
        list(drive(place, 1, pictures=False, surround=True))
    with pytest.raises(InputError, match="number: expected 0 to 9999"):
        write_drive(place, tmp_path / "far", 1, number=10_000)
    assert list(tmp_path.iterdir()) == []


def test_only_a_simulated_drive_is_replaced(place: Street, tmp_path: Path) -> None:
    target = tmp_path / "drive"
    first = write_drive(place, target, 2, pictures=False)
    second = write_drive(place, target, 1, number=1, pictures=False, overwrite=True)
    assert not first.exists()
    assert len(open_kitti(second)) == 1
    (target / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="or one of a simulated drive, but this one exists"):
        write_drive(place, target, 1, pictures=False, overwrite=True)
    assert len(open_kitti(second)) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["drive"]


def test_a_box_beside_the_camera_has_no_rectangle() -> None:
    from manip3d import Box

    words = drives._label_line(Box((-5.0, 2.0, -0.8), (4.0, 1.8, 1.5), 0.3, "Car")).split()
    assert words[:3] == ["Car", "1.00", "3"]
    assert words[4:8] == ["0.0000"] * 4
    words = drives._label_line(Box((20.0, 0.0, -0.8), (4.0, 1.8, 1.5), 0.0, "Car")).split()
    assert words[1] == "0.00"
    assert 500 < float(words[4]) < float(words[6]) < 720
    assert float(words[14]) == pytest.approx(-np.pi / 2, abs=1e-4)
