"""``manip3d alert run`` on drives, watermarked and not, with and without cameras."""

from __future__ import annotations

import io
import json
import re
import resource
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from rich.live import Live
from typer.testing import CliRunner, Result

from command_line import error_line
from command_line import manip3d as run
from landmarks import assert_accessible
from manip3d import LidarFrame
from manip3d.authenticate import AlertMonitor
from manip3d.capture import open_drive, watched_recording
from manip3d.cli import app
from manip3d.cli.alert import _View
from manip3d.cli.terminal import Terminal
from velodyne_packets import LOWER, UPPER, block, ethernet, packet, pcap, udp_frame
from watermark_scans import grid_scan, key_file


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Three scans, a file of each, 100 ms apart, at 10 m/s."""
    folder = tmp_path / "drive"
    scans = folder / "velodyne_points" / "data"
    scans.mkdir(parents=True)
    (folder / "oxts" / "data").mkdir(parents=True)
    for number in range(3):
        points = grid_scan(3000, seed=number)
        rows = np.column_stack([points, np.zeros(len(points))]).astype("<f4")
        (scans / f"{number:010d}.bin").write_bytes(rows.tobytes())
        words = ["0"] * 30
        words[8] = "10.0"
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text(" ".join(words) + "\n")
    (folder / "velodyne_points" / "timestamps.txt").write_text(
        "".join(f"2011-09-26 13:02:25.{n}00000000\n" for n in range(3))
    )
    return folder


def test_a_signed_drive_is_authentic_until_a_point_moves(drive: Path, tmp_path: Path) -> None:
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded = run("watermark", "embed", str(drive), "--key", str(key), "-o", str(signed), "-q")
    assert embedded.returncode == 0, embedded.stderr
    assert (signed / "oxts").is_dir()
    page = tmp_path / "alert.html"
    done = run("alert", "run", str(signed), "--key", str(key), "-o", str(page), "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["verdict"] == "authentic"
    assert [frame["verdict"] for frame in told["frames"]] == ["authentic"] * 3
    assert told["counts"]["frames"] == 3
    html = page.read_text()
    assert_accessible(html)
    assert html.count("<svg") >= 5
    assert "authentic" in html
    assert not re.search(r"(src|href)=.?https?:", html)  # it loads nothing
    assert str(tmp_path) not in html.replace(str(signed), "")

    other, spliced = tmp_path / "other", Path(shutil.copytree(signed, tmp_path / "spliced"))
    run("watermark", "embed", str(drive), "--key", str(key), "-o", str(other), "-q")
    for suffix in (".bin", ".bin.wm"):  # one frame of another session
        name = Path("velodyne_points", "data", f"0000000001{suffix}")
        shutil.copy(other / name, spliced / name)
    done = run("alert", "run", str(spliced), "--key", str(key), "--json")
    told = json.loads(done.stdout)
    assert (done.returncode, told["verdict"]) == (3, "tampered")
    assert "frame 2 (counted from 1) is of another session" in told["reason"]
    verdicts = [frame["verdict"] for frame in told["frames"]]
    assert verdicts == ["authentic", "undecidable", "undecidable"]

    gap = Path(shutil.copytree(signed, tmp_path / "gap"))
    for lost in (gap / "velodyne_points" / "data").glob("0000000001.*"):
        lost.unlink()
    accused = gap / "velodyne_points" / "data" / "0000000002.bin"
    rows = np.fromfile(accused, "<f4").reshape(-1, 4)
    rows[5, 0] += 1.0
    accused.write_bytes(rows.tobytes())
    done = run("alert", "run", str(gap), "--key", str(key), "-o", str(page), "--force")
    assert done.returncode == 3, done.stderr
    row = next(line for line in done.stdout.splitlines() if " tampered " in line)
    assert row.split()[:3] == ["1", "0000000002", "tampered"]
    assert "<td>1</td><td>0000000002</td><td class=tampered>" in page.read_text()
    assert "<h3>Frame 1 (scan 0000000002): watermark: " in page.read_text()
    told = json.loads(in_process(gap, "--key", key, "--json").stdout)
    assert [frame["scan"] for frame in told["frames"]] == ["0000000000", "0000000002"]

    cut = Path(shutil.copytree(signed, tmp_path / "cut"))
    for last in (cut / "velodyne_points" / "data").glob("0000000002.*"):
        last.unlink()
    done = run("alert", "run", str(cut), "--key", str(key))
    assert done.returncode == 4, done.stderr
    assert "end are missing" in done.stdout
    assert run("alert", "run", str(cut), "--key", str(key), "--frames", "2").returncode == 0

    victim = signed / "velodyne_points" / "data" / "0000000001.bin"
    rows = np.fromfile(victim, "<f4").reshape(-1, 4)
    rows[5, 0] += 1.0
    victim.write_bytes(rows.tobytes())
    done = run("alert", "run", str(signed), "--key", str(key), "-o", str(page), "--force")
    assert done.returncode == 3, done.stderr
    assert "tampered: watermark" in done.stdout
    assert "modification" in done.stdout
    html = page.read_text()
    assert "tampered" in html
    shown = html[html.index("What was seen") :]  # without cameras: from above, with the sectors
    assert "data:image/png" not in shown
    assert "only the LiDAR sees it" not in shown
    assert "sectors that the watermark finds tampered" in shown
    assert 1 <= shown.count("class=sector") <= 3  # runs of slices of one tile
    assert "<polygon" in shown
    done = in_process(signed, "--key", key, "--json")
    tiles = [frame["watermark"]["changed_tiles"] for frame in json.loads(done.stdout)["frames"]]
    assert [len(each) for each in tiles] == [0, 1, 0]
    assert "suspected" not in done.stdout


def test_without_key_and_cameras_nothing_can_be_said(drive: Path) -> None:
    done = run("alert", "run", str(drive), "--json", "--frames", "2")
    assert done.returncode == 4, done.stderr
    told = json.loads(done.stdout)
    assert told["verdict"] == "undecidable"
    assert len(told["frames"]) == 2


def test_json_output_has_the_same_numbers(drive: Path, tmp_path: Path) -> None:
    path = tmp_path / "alert.json"
    done = run("alert", "run", str(drive), "-o", str(path), "--json")
    stored, printed = json.loads(path.read_text()), json.loads(done.stdout)
    assert [f["verdict"] for f in stored["frames"]] == [f["verdict"] for f in printed["frames"]]


def test_an_unreadable_scan_is_one_undecidable_frame(drive: Path, tmp_path: Path) -> None:
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    run("watermark", "embed", str(drive), "--key", str(key), "-o", str(signed), "-q")
    (signed / "velodyne_points" / "data" / "0000000001.bin").write_bytes(b"12345")
    done = run("alert", "run", str(signed), "--key", str(key), "--json")
    assert done.returncode == 4, done.stderr
    frames = json.loads(done.stdout)["frames"]
    assert [frame["verdict"] for frame in frames] == ["authentic", "undecidable", "authentic"]
    assert "unreadable" in frames[1]["reason"]
    (signed / "velodyne_points" / "data" / "0000000001.bin").write_bytes(b"")
    done = run("alert", "run", str(signed), "--key", str(key), "--json")
    assert done.returncode == 4, done.stderr
    assert "the scan holds no points" in json.loads(done.stdout)["frames"][1]["reason"]


@pytest.mark.parametrize("layout", ["raw", "flat"])
def test_labels_of_points_silence_no_alarm(drive: Path, tmp_path: Path, layout: str) -> None:
    """A scan that lost points no longer fits its labels; a damaged label is no sign of forgery."""
    if layout == "flat":  # as in SemanticKITTI
        (drive / "velodyne_points" / "data").rename(drive / "velodyne")
        shutil.rmtree(drive / "velodyne_points")
        shutil.rmtree(drive / "oxts")
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(drive, key, signed)
    beside = signed / "velodyne_points" if layout == "raw" else signed
    scans = beside / "data" if layout == "raw" else signed / "velodyne"
    (beside / "labels").mkdir()
    for scan in scans.glob("*.bin"):
        labels = np.zeros(scan.stat().st_size // 16, "<u4")
        (beside / "labels" / f"{scan.stem}.label").write_bytes(labels.tobytes())
    middle = sorted(scans.glob("*.bin"))[1]

    label = beside / "labels" / f"{middle.stem}.label"
    label.write_bytes(label.read_bytes()[:-7])
    done = run("alert", "run", str(signed), "--key", str(key), "--json")
    assert (done.returncode, json.loads(done.stdout)["verdict"]) == (0, "authentic")

    middle.write_bytes(middle.read_bytes()[: -16 * 20])
    done = run("alert", "run", str(signed), "--key", str(key), "--json")
    assert done.returncode == 3, done.stdout
    frames = json.loads(done.stdout)["frames"]
    assert [frame["verdict"] for frame in frames] == ["authentic", "tampered", "authentic"]
    for recording in (open_drive(f"kitti:{signed}"), open_drive(signed)):
        assert [scan.num_points for scan in recording if scan is not None] == [3000, 2980, 3000]
    moments = list(watched_recording(f"kitti:{signed}").moments)
    assert [isinstance(moment.frame, LidarFrame) for moment in moments] == [True] * 3


def test_scans_that_became_arrays_are_frames_of_their_drive(drive: Path, tmp_path: Path) -> None:
    """Beside a record they are frames, whatever their suffix; in a drive of arrays they all are."""
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    run("watermark", "embed", str(drive), "--key", str(key), "-o", str(signed), "-q")
    scans = signed / "velodyne_points" / "data"
    for number in range(3):
        old = scans / f"{number:010d}.bin"
        rows = np.fromfile(old, "<f4").reshape(-1, 4)
        rows[5, 0] += 1.0 * (number == 1)
        np.save(old.with_suffix(".npy"), rows)
        old.unlink()
        Path(f"{old}.wm").rename(old.with_suffix(".npy.wm"))
        done = run("alert", "run", str(signed), "--key", str(key), "--json")
        frames = json.loads(done.stdout)["frames"]
        verdicts = ["authentic", "authentic" if number == 0 else "tampered", "authentic"]
        assert [frame["verdict"] for frame in frames] == verdicts
        assert done.returncode == (0 if number == 0 else 3)
    done = run("alert", "run", str(signed), "--json")
    assert len(json.loads(done.stdout)["frames"]) == 3


def in_process(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["alert", "run", *(str(a) for a in arguments)])


def test_a_ros1_bag_of_clouds_is_watched(tmp_path: Path) -> None:
    rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="the extra 'bags' is not installed")
    from rosbags import typesys

    from ros_bags import CLOUD, message, points_of

    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    image = "sensor_msgs/msg/Image"
    for name, kinds in (("lidar", (CLOUD, image)), ("camera", (image,))):
        path = tmp_path / f"{name}.bag"
        writer = rosbag1.Writer(path)
        writer.set_compression(rosbag1.Writer.CompressionFormat.BZ2)
        with writer:
            made = [writer.add_connection(f"/{n}", k, typestore=types) for n, k in enumerate(kinds)]
            if name == "lidar":
                cloud = message(types, points_of(1), ros1=True)
                writer.write(made[0], 7 * 10**9, types.serialize_ros1(cloud, CLOUD))
    done = in_process(tmp_path / "lidar.bag", "--json")
    assert done.exit_code == 4, done.output
    assert len(json.loads(done.stdout)["frames"]) == 1
    done = in_process(tmp_path / "camera.bag")
    assert "is an RGB-D recording" in str(done.exception)
    for address in ("lidar.bag#/0", "lidar.bag#/9"):  # one topic of a bag, and one that is not
        done = in_process(tmp_path / address, "--json")
        assert (done.exit_code == 4) == address.endswith("0"), done.output
    assert "expected bag:" in str(done.exception)
    whole = (tmp_path / "lidar.bag").read_bytes()
    (tmp_path / "cut.bag").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "open.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(5000))
    for name in ("cut.bag", "open.bag"):
        for command in (("alert", "run"), ("info",), ("view",), ("inspect",)):
            failed = CliRunner().invoke(app, [*command, str(tmp_path / name)])
            assert f"{name}: expected the index of a ROS 1 bag" in str(failed.exception)


def test_packets_of_an_hdl64e_take_their_calibration(tmp_path: Path) -> None:
    halves = [block(18 * (n // 2), [3000] * 32, flag=(UPPER, LOWER)[n % 2]) for n in range(12)]
    turns = [halves] + [[(flag, a + 20_000, f) for flag, a, f in halves]] + [halves] * 2
    recording = tmp_path / "turns.pcap"
    recording.write_bytes(pcap([ethernet(udp_frame(packet(blocks))) for blocks in turns]))
    lasers = [
        {"laser_id": n, "rot_correction": 0.0, "vert_correction": 0.01 * (10 - n),
         "dist_correction": 1.0, "vert_offset_correction": 0.0, "horiz_offset_correction": 0.0}
        for n in range(64)
    ]  # fmt: skip
    beside = tmp_path / "lasers.yaml"
    beside.write_text(
        json.dumps({"lasers": lasers, "num_lasers": 64, "distance_resolution": 0.002})
    )
    assert "needs the file of its own sensor" in str(in_process(recording).exception)
    done = in_process(recording, "--calibration", beside, "--json")
    assert done.exit_code == 4, (done.output, done.exception)
    assert json.loads(done.stdout)["frames"]


def test_the_verifiers_policy_holds_for_a_drive(drive: Path, tmp_path: Path) -> None:
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedding = ["watermark", "embed", str(drive), "--key", str(key), "--sensor", "roof", "--json"]
    made = CliRunner().invoke(app, [*embedding, "-q", "-o", str(signed)])
    session = json.loads(made.stdout)["session"]

    def verdict_of(*options: object) -> tuple[int, str]:
        done = in_process(signed, "--key", key, "--json", *options)
        return done.exit_code, json.loads(done.stdout)["reason"]

    state = tmp_path / "seen"
    agreed = ("--sensor", "roof", "--session", session, "--embedding", "lbm", "--state", state)
    assert verdict_of(*agreed)[0] == 0
    assert verdict_of("--state", state)[0] == 3  # a replay
    for option, value, words in (
        ("--sensor", "bumper", "another sensor"),
        ("--session", "0" * 32, "another session"),
        ("--embedding", "qim", "refuses this embedding"),
        ("--max-age", 60, "too old"),
        ("--max-points", 2999, "more points than the policy allows"),
    ):
        code, reason = verdict_of(option, value)
        assert code == 4
        assert words in reason
    done = in_process(signed, "--sensor", "roof")
    assert "--sensor: can only be given with --key" in str(done.exception)
    verify = ["watermark", "verify", str(signed), "--key", str(key), "--max-points", "2999"]
    assert CliRunner().invoke(app, verify).exit_code == 4


def test_bad_input_is_named(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    recording = tmp_path / "a.pcap"
    recording.write_bytes(pcap([ethernet(udp_frame(packet([block(0, [3000] * 32)] * 12)))]))
    for arguments, words in (
        ((str(tmp_path / "nothing"),), "nothing"),
        (
            (str(tmp_path / "empty"),),
            "expected drives in KITTI's layout, or files (.pcap, .pcapng, .osf, .mcap), found none",
        ),
        (
            ("sim:street?frames=1", "--calibration", "x"),
            "--calibration: can only be given with a folder",
        ),
        ((str(drive), "--calibration", "no such file"), "no such file: No such file"),
        (
            (str(recording), "--rigs", "rigs.json"),
            "error: --rigs: can only be given with a ROS bag",
        ),
        (("sim:indoor-00",), "address: expected sim:street"),
        ((str(drive), "-o", str(tmp_path / "a.pdf")), ".html"),
        ((str(drive), "--speed", "nan"), "--speed: expected a finite number, got nan"),
        ((str(drive), "--every", "nan"), "--every: expected a finite number, got nan"),
        ((str(drive), "--budget", "nan"), "--budget: expected a number > 0, got nan"),
    ):
        done = run("alert", "run", *arguments)
        assert words in error_line(done)
    for option, value in (("--max-points", "5"), ("--picture", "image_02")):
        done = run("alert", "run", str(drive), option, value)
        assert f"{option}: can only be given with --key" in error_line(done)
    key = key_file(tmp_path / "sensor.key")
    done = run("alert", "run", str(drive), "--key", str(key), "--picture", "image_07")
    assert "--picture: expected a folder of pictures" in error_line(done)
    done = run("alert", "run", "sim:street?frames=1", "--key", str(key), "--picture", "x")
    assert "--picture: can only be given with a folder" in error_line(done)


def with_cameras(drive: Path) -> Path:
    """The drive with a stereo pair that shows nothing, and KITTI's calibration of it."""
    cv2 = pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    fog = np.full((160, 640), 77, np.uint8)
    for camera in (2, 3):
        folder = drive / f"image_0{camera}" / "data"
        folder.mkdir(parents=True)
        for number in range(3):
            assert cv2.imwrite(str(folder / f"{number:010d}.png"), fog)
    lines = ["calib_time: 09-Jan-2012 13:57:47", "R_rect_00: 1 0 0 0 1 0 0 0 1"]
    for camera in range(4):
        shift = {3: -360 * 0.54}.get(camera, 0)
        lines += [f"S_rect_0{camera}: 640 160",
                  f"P_rect_0{camera}: 360 0 320 {shift} 0 360 80 0 0 0 1 0"]  # fmt: skip
    (drive / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    turned = "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 0 0\n"
    (drive / "calib_velo_to_cam.txt").write_text(turned)
    (drive / "calib_imu_to_velo.txt").write_text("R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n")
    return drive


def forged(drive: Path, number: int) -> None:
    victim = drive / "velodyne_points" / "data" / f"{number:010d}.bin"
    rows = np.fromfile(victim, "<f4").reshape(-1, 4)
    rows[5, 0] += 1.0
    victim.write_bytes(rows.tobytes())


def embedded(drive: Path, key: Path, signed: Path, *options: str) -> None:
    done = CliRunner().invoke(
        app, ["watermark", "embed", str(drive), "--key", str(key), "-o", str(signed), *options]
    )
    assert done.exit_code == 0, done.output


def test_pictures_of_another_size_than_the_calibration_are_told(drive: Path) -> None:
    """Half as large, they were compared under the wrong focal length, without a word."""
    cv2 = pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    with_cameras(drive)
    for picture in drive.glob("image_0*/data/*.png"):
        assert cv2.imwrite(str(picture), np.full((80, 320), 77, np.uint8))
    done = CliRunner().invoke(app, ["alert", "run", str(drive), "--json"])
    told = [frame["witnesses"]["cross-modal"] for frame in json.loads(done.stdout)["frames"]]
    assert {each["verdict"] for each in told} == {"undecidable"}
    assert "expected 640 x 160 pixels, as the calibration says, got 320 x 80" in told[0]["reason"]
    assert "the cameras could not judge 3 of 3 frames: unreadable: " in done.stderr


@pytest.mark.parametrize("module", ["cv2", "PIL"])
def test_without_the_extra_the_cameras_are_absent_and_the_rest_judges(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    """A drive with pictures was not judged at all: neither its watermark nor its points."""
    with_cameras(drive)
    key, signed = tmp_path / "a.key", tmp_path / "signed"
    assert CliRunner().invoke(app, ["watermark", "keygen", str(key)]).exit_code == 0
    embedded(drive, key, signed)
    assert list(signed.glob("image_0*/data/*.png"))
    forged(signed, 1)
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    done = CliRunner().invoke(app, ["alert", "run", str(signed), "--key", str(key), "--json"])
    assert done.exit_code == 3, done.output
    frames = json.loads(done.stdout)["frames"]
    assert [frame["verdict"] for frame in frames] == ["authentic", "tampered", "authentic"]
    for frame in frames:
        told = frame["witnesses"]["cross-modal"]
        assert (told["verdict"], told["reason"]) == (
            "absent",
            "needs the extra alert (pip install 'manip3d[alert]')",
        )
    assert "the cameras could not judge 3 of 3 frames: needs the extra alert" in done.stderr


NO_LIBRARY = "libGL.so.1: cannot open shared object file"


def broken_module(module: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a module that cannot be imported in front of the installed one."""
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    folder.mkdir()
    (folder / f"{module}.py").write_text(f"raise ImportError({NO_LIBRARY!r})\n")
    monkeypatch.syspath_prepend(folder)


@pytest.mark.parametrize(
    ("module", "package"), [("cv2", "opencv-python-headless"), ("PIL", "pillow")]
)
def test_with_a_broken_package_the_cameras_are_absent_and_the_rest_judges(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, package: str
) -> None:
    """The watch of a drive with pictures ended without a verdict on its points."""
    with_cameras(drive)
    broken_module(module, tmp_path / "broken", monkeypatch)
    done = CliRunner().invoke(app, ["alert", "run", str(drive), "--json"])
    frames = json.loads(done.stdout)["frames"]
    assert len(frames) == 3
    why = f"{package} is installed but cannot be imported: {NO_LIBRARY}"
    for frame in frames:
        told = frame["witnesses"]["cross-modal"]
        assert (told["verdict"], told["reason"]) == ("absent", why)
    assert frames[0]["witnesses"]["forensics"]["verdict"] != "absent"
    assert f"the cameras could not judge 3 of 3 frames: {why}" in done.stderr


def test_pictures_in_memory_are_left_out_with_a_broken_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken_module("cv2", tmp_path / "broken", monkeypatch)
    done = CliRunner().invoke(app, ["alert", "run", "sim:street", "--frames", "1", "--json"])
    (frame,) = json.loads(done.stdout)["frames"]
    assert frame["witnesses"]["cross-modal"]["verdict"] == "absent"
    assert NO_LIBRARY in frame["witnesses"]["cross-modal"]["reason"]


def test_pictures_in_memory_are_left_out_without_the_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    done = CliRunner().invoke(app, ["alert", "run", "sim:street", "--frames", "1", "--json"])
    (frame,) = json.loads(done.stdout)["frames"]
    assert frame["witnesses"]["cross-modal"]["verdict"] == "absent"
    assert frame["witnesses"]["forensics"]["verdict"] != "absent"


def test_cameras_without_a_calibration_silence_no_other_witness(drive: Path) -> None:
    with_cameras(drive)
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"):
        (drive / name).unlink()
    done = CliRunner().invoke(app, ["alert", "run", str(drive), "--json"])
    assert len(json.loads(done.stdout)["frames"]) == 3, done.output
    assert "the cameras have no calibration, which KITTI keeps beside" in done.stderr


def test_a_damaged_picture_speed_or_record_silences_no_alarm(drive: Path, tmp_path: Path) -> None:
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(with_cameras(drive), key, signed)
    forged(signed, 0)
    picture = signed / "image_02" / "data" / "0000000001.png"
    picture.write_bytes(picture.read_bytes()[:100])
    (signed / "oxts" / "data" / "0000000002.txt").write_text("1 2 3\n")
    page = tmp_path / "alert.json"
    done = in_process(signed, "--key", key, "-o", page)
    assert done.exit_code == 3, done.output
    told = json.loads(page.read_text())
    assert [frame["verdict"] for frame in told["frames"]] == ["tampered", "authentic", "authentic"]
    cameras = [frame["witnesses"]["cross-modal"] for frame in told["frames"]]
    assert cameras[1]["verdict"] == "undecidable"
    assert "unreadable" in cameras[1]["reason"]
    assert "0000000001.png" in cameras[1]["reason"]
    assert "unreadable" not in cameras[2]["reason"]
    assert "frame 0000000002 has no speed of its own" in done.stderr
    assert "expected at least 23 numbers" in done.stderr

    cv2 = pytest.importorskip("cv2")
    for camera in (2, 3):  # no camera takes such pictures
        small = signed / f"image_0{camera}" / "data" / "0000000001.png"
        assert cv2.imwrite(str(small), np.zeros((10, 10), np.uint8))
    (signed / "velodyne_points" / "data" / "0000000002.bin.wm").unlink()
    (signed / "velodyne_points" / "data" / "0000000002.bin.wm").mkdir()
    done = in_process(signed, "--key", key, "-o", page, "--force")
    assert done.exit_code == 3, done.output
    told = json.loads(page.read_text())
    assert [frame["verdict"] for frame in told["frames"]] == ["tampered", "authentic",
                                                              "undecidable"]  # fmt: skip
    cameras = [frame["witnesses"]["cross-modal"] for frame in told["frames"]]
    assert "expected 640 x 160 pixels, as the calibration says, got 10 x 10" in cameras[1]["reason"]


@pytest.mark.parametrize("line", ["", "9999-09-26 13:02:25.1", "soon"])
def test_a_time_that_cannot_be_read_ends_no_verb(drive: Path, tmp_path: Path, line: str) -> None:
    """Nobody signs the file, and one damaged line must not hide the drive."""
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(drive, key, signed)
    times = signed / "velodyne_points" / "timestamps.txt"
    first, _, last = times.read_text().splitlines()
    times.write_text("\n".join([first, line, last]))
    watched = run("alert", "run", str(signed), "--key", str(key), "--json")
    assert watched.returncode == 0, watched.stderr
    verdicts = [frame["verdict"] for frame in json.loads(watched.stdout)["frames"]]
    assert verdicts == ["authentic"] * 3
    inspected = run("inspect", str(signed), "--no-power", "--json")
    assert inspected.returncode == 4, inspected.stderr
    assert len(json.loads(inspected.stdout)["frames"]) == 3
    for done in (watched, inspected):
        told = f"timestamps.txt: line 2: expected a time, got {line!r}"
        assert (told in done.stderr) == bool(line)


@pytest.mark.parametrize("wrong", ["time", "speed"])
def test_a_wrong_time_or_speed_hides_no_later_frame(
    drive: Path, tmp_path: Path, wrong: str
) -> None:
    """Neither is signed, so that anybody can change a line."""
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(drive, key, signed)
    forged(signed, 2)
    times = signed / "velodyne_points" / "timestamps.txt"
    if wrong == "time":
        first, _, last = times.read_text().splitlines()
        times.write_text("\n".join([first, first.replace("2011", "2024"), last]))
    else:
        words = ["0"] * 8 + ["4e7"] + ["0"] * 21
        (signed / "oxts" / "data" / "0000000001.txt").write_text(" ".join(words))
    page = tmp_path / "alert.json"
    done = in_process(signed, "--key", key, "-o", page)
    assert done.exit_code == 3, done.output
    told = json.loads(page.read_text())
    assert [frame["verdict"] for frame in told["frames"]] == ["authentic", "authentic", "tampered"]
    assert told["reason"].count("its time or speed is wrong, the motion counts as unknown") == 1
    assert "; frame 1: " in told["reason"]


def test_a_drive_that_ends_in_an_error_is_judged_by_its_frames_before(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from manip3d.authenticate import AlertMonitor

    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(drive, key, signed)
    judge = AlertMonitor.judge

    def fail_at_last(self: AlertMonitor, *arguments: object, **options: object) -> object:
        if self.counts.frames == 2:
            raise OSError(5, "Input/output error")
        return judge(self, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(AlertMonitor, "judge", fail_at_last)
    page = tmp_path / "alert.json"
    for code, verdict in ((4, "undecidable"), (3, "tampered")):
        done = in_process(signed, "--key", key, "-o", page, "--force")
        assert done.exit_code == code, done.output
        told = json.loads(page.read_text())
        assert told["verdict"] == verdict
        assert "ended after 2 frames: [Errno 5] Input/output error" in told["reason"]
        assert len(told["frames"]) == 2
        forged(signed, 1)


def test_records_that_pictures_carry_are_verified(drive: Path, tmp_path: Path) -> None:
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(with_cameras(drive), key, signed, "--picture", "image_02")
    options = ("--key", key, "--json", "--picture", "image_02")
    done = in_process(signed, *options)
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert [frame["verdict"] for frame in told["frames"]] == ["authentic"] * 3
    assert in_process(signed, "--key", key).exit_code == 4  # no records beside the scans
    cv2 = pytest.importorskip("cv2")
    path = signed / "image_02" / "data" / "0000000001.png"
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    picture[80, 320] ^= 0x80
    assert cv2.imwrite(str(path), picture)
    done = in_process(signed, *options)
    assert done.exit_code == 3, done.output
    told = json.loads(done.stdout)
    assert [frame["verdict"] for frame in told["frames"]] == ["authentic", "tampered", "authentic"]
    (signed / "velodyne_points" / "data" / "0000000002.bin").write_bytes(b"12345")
    path.write_bytes(b"no picture")
    told = json.loads(in_process(signed, *options).stdout)
    assert [frame["verdict"] for frame in told["frames"]] == ["authentic", "undecidable",
                                                              "undecidable"]  # fmt: skip


def pictures_of(drive: Path, camera: int, *sizes: tuple[int, int]) -> None:
    """Pictures of a camera that show nothing, (height, width) of each frame."""
    cv2 = pytest.importorskip("cv2", reason="the extra 'alert' is not installed")
    folder = drive / f"image_{camera:02d}" / "data"
    folder.mkdir(parents=True, exist_ok=True)
    for number, size in enumerate(sizes):
        assert cv2.imwrite(str(folder / f"{number:010d}.png"), np.full(size, 77, np.uint8))


SIZE, SMALL = (160, 640), (10, 10)


def test_bad_pictures_do_not_silence_the_carrier_nor_the_other_way_round(
    drive: Path, tmp_path: Path
) -> None:
    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    pictures_of(with_cameras(drive), 0, SIZE, SIZE, SIZE)
    embedded(drive, key, signed, "--picture", "image_00")
    forged(signed, 0)
    for camera in (2, 3):
        pictures_of(signed, camera, SMALL, SIZE, SMALL)
    small = tmp_path / "small"
    pictures_of(small, 0, SMALL)
    for number in (1, 2):
        beside = small / "image_00" / "data" / "0000000000.png"
        shutil.copy(beside, signed / "image_00" / "data" / f"{number:010d}.png")
    page = tmp_path / "alert.json"
    options = ("--key", key, "--picture", "image_00", "-o", page, "--force")
    assert in_process(signed, *options).exit_code == 3
    frames = [frame["witnesses"] for frame in json.loads(page.read_text())["frames"]]
    assert frames[0]["watermark"]["verdict"] == "tampered"
    assert "got 10 x 10" in frames[0]["cross-modal"]["reason"]
    assert "samples" in frames[1]["watermark"]["reason"]
    assert "expected at least" not in frames[1]["cross-modal"]["reason"]
    assert "got 10 x 10" in frames[2]["cross-modal"]["reason"]
    assert "samples" in frames[2]["watermark"]["reason"]

    (signed / "velodyne_points" / "data" / "0000000002.bin").write_bytes(b"12345")
    assert in_process(signed, *options).exit_code == 3
    told = json.loads(page.read_text())
    assert len(told["frames"]) == 3
    assert "unreadable" in told["frames"][2]["witnesses"]["forensics"]["reason"]
    assert "samples" in told["frames"][2]["witnesses"]["forensics"]["reason"]


def test_a_bad_pair_silences_no_other_pair(drive: Path, tmp_path: Path) -> None:
    from manip3d.authenticate import CameraPair, StereoRig, write_rigs

    for camera, size in ((2, SIZE), (3, SIZE), (4, SMALL), (5, SMALL)):
        pictures_of(drive, camera, size, size, size)
    ahead = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
    rig = StereoRig(360.0, (320.0, 80.0), 0.54, ahead)
    pairs = {"front": CameraPair(rig, 2, 3), "left": CameraPair(rig, 4, 5)}
    write_rigs(pairs, drive / "rigs.json")
    page = tmp_path / "alert.json"
    assert in_process(drive, "-o", page, "--frames", 1).exit_code == 4
    (told,) = json.loads(page.read_text())["frames"]
    reason = told["witnesses"]["cross-modal"]["reason"]
    assert "left: unreadable: left: expected at least 192 x 20 pixels, got 10 x 10" in reason
    assert "not asked: left" in reason  # and the front pair was


def test_what_was_judged_counts_though_it_cannot_be_shown(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from manip3d.report import AlertTimeline

    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(drive, key, signed)

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(AlertTimeline, "add", fail)
    page = tmp_path / "alert.json"
    done = in_process(signed, "--key", key, "--json", "-o", page)
    assert isinstance(done.exception, OSError)  # an error is more than no alarm
    assert "not kept: [Errno 28]" in json.loads(done.stdout)["reason"]
    assert not page.exists()
    forged(signed, 0)
    done = in_process(signed, "--key", key, "--json")
    assert done.exit_code == 3, done.output
    assert "not kept: [Errno 28]" in json.loads(done.stdout)["reason"]


def test_names_in_the_live_table_are_no_markup() -> None:
    stream = io.StringIO()
    view = _View(Terminal(quiet=True), "drive[/b]", 1)
    console = Console(file=stream, force_terminal=True, color_system=None, width=120)
    view._live = Live(console=console, auto_refresh=False)
    with view._live:
        view.show(AlertMonitor().skip("too [red]late"))
    assert "drive[/b]: frame 1 of 1" in stream.getvalue()
    assert "too [red]late" in stream.getvalue()


@pytest.mark.parametrize("is_closed", [False, True])
def test_a_terminal_that_cannot_print_ends_no_drive(is_closed: bool) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    view = _View(Terminal(quiet=True), "Straße", 1)  # ASCII has no sharp s
    view._live = Live(console=Console(file=stream, force_terminal=True), auto_refresh=False)
    view._live.start()
    if is_closed:
        stream.close()
    alert = AlertMonitor().skip("too late")
    view.show(alert)
    assert view._live is None
    view.show(alert)


def test_a_terminal_that_is_gone_at_the_end_takes_no_verdict_away() -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    with _View(Terminal(quiet=True), "drive", 1) as view:
        view._live = Live(console=Console(file=stream, force_terminal=True), auto_refresh=False)
        view._live.start()
        view.show(AlertMonitor().skip("too late"))
        stream.close()
    assert view._live is None


def test_a_page_that_cannot_be_written_takes_no_verdict_away(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from manip3d.report import AlertTimeline

    key, signed = key_file(tmp_path / "sensor.key"), tmp_path / "signed"
    embedded(drive, key, signed)

    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device", "alert.html")

    monkeypatch.setattr(AlertTimeline, "write", fail)
    page = tmp_path / "alert.html"
    for code, verdict in ((1, "authentic"), (3, "tampered")):
        done = in_process(signed, "--key", key, "-o", page, "--json")
        told = json.loads(done.stdout)
        assert told["verdict"] == verdict
        assert len(told["frames"]) == 3
        assert f"{page} was not written: [Errno 28]" in told["reason"]
        assert done.exit_code == code, done.output
        assert verdict in in_process(signed, "--key", key, "-o", page).stdout
        forged(signed, 1)
    assert not page.exists()


def test_the_last_word_of_forensics_is_heard_though_the_drive_ends_in_an_error(
    drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from manip3d.authenticate import AlertMonitor, WitnessReport

    last = WitnessReport("tampered", "frame 0: a point where nothing can be measured")
    monkeypatch.setattr(AlertMonitor, "finish", lambda _: last)
    judge = AlertMonitor.judge

    def fail_at_last(self: AlertMonitor, *arguments: object, **options: object) -> object:
        if self.counts.frames == 1:
            raise OSError(5, "Input/output error")
        return judge(self, *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(AlertMonitor, "judge", fail_at_last)
    done = in_process(drive, "--json")
    assert done.exit_code == 3, done.output
    assert json.loads(done.stdout)["reason"].startswith(f"forensics: {last.reason}; ended after")


def test_a_drive_without_times_is_played_as_a_scanner_turns(
    drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (drive / "velodyne_points" / "timestamps.txt").unlink()
    slept: list[float] = []
    clock = SimpleNamespace(monotonic=lambda: 7.0 + sum(slept), sleep=slept.append)
    monkeypatch.setattr("manip3d.authenticate._watch.time", clock)
    done = in_process(drive, "--live", "--json")
    assert slept == pytest.approx([0.1, 0.1])
    assert len(json.loads(done.stdout)["frames"]) == 3


def test_records_before_a_full_disk_stay() -> None:
    """A line that was written in part is no record, and the next one stands in its place."""
    from manip3d.report._alert import _Records

    records = _Records()
    records.append({"frame": 0})
    kept = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (records._lines.tell() + 8, kept[1]))
    try:
        for _ in range(2):
            with pytest.raises(OSError, match="File too large"):
                records.append({"frame": 1, "reason": "too long"})
        assert list(records) == [{"frame": 0}]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, kept)
    records.append({"frame": 1})
    assert list(records) == [{"frame": 0}, {"frame": 1}]
    assert len(records) == 2


def test_a_quiet_run_says_that_the_cameras_judged_no_frame(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The warning was all that told it, and -q prints none."""
    with_cameras(drive)
    monkeypatch.delitem(sys.modules, "cv2", raising=False)
    monkeypatch.setitem(sys.modules, "cv2", None)
    page = tmp_path / "page.html"
    told = "the cameras judged no frame: needs the extra alert"
    order = ["alert", "run", str(drive), "-q"]
    assert told in " ".join(CliRunner().invoke(app, [*order, "-o", str(page)]).stdout.split())
    assert told in page.read_text()
    assert told in json.loads(CliRunner().invoke(app, [*order, "--json"]).stdout)["reason"]
