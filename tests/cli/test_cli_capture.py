"""``manip3d capture``: list, record, play, info."""

from __future__ import annotations

import errno
import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import command_line
import rgbd_frames
from command_line import error_line
from manip3d import capture, viewer
from manip3d.cli import capture as cli_capture
from manip3d.cli.terminal import Terminal


def manip3d(*arguments: object) -> subprocess.CompletedProcess[str]:
    return command_line.manip3d(*map(str, arguments), COLUMNS="200")


def test_list_names_the_absent_with_reason_and_cure() -> None:
    done = manip3d("capture", "list", "--json")
    assert done.returncode == 0, done.stderr
    records = {record["name"]: record for record in json.loads(done.stdout)}
    assert records["folder"]["reason"] == ""
    assert records["freenect2"]["reason"]
    assert records["freenect2"]["cure"]
    shown = manip3d("capture", "list").stdout
    assert "folder:FOLDER" in shown
    assert records["freenect2"]["cure"] in shown


def test_record_refuses_what_exists_and_guesses_the_source(walk: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    done = manip3d("capture", "record", walk, "-o", again, "--frames", 4, "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["frames"], record["stop"]) == (4, "frames")
    assert f"opened folder:{walk}: 16 x 12 pixels, 9 frames" in done.stderr
    assert capture.open_rgbd(f"folder:{again}").num_frames == 4
    refused = manip3d("capture", "record", walk, "-o", again)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "exists already; --force replaces it" in refused.stderr
    assert manip3d("capture", "record", walk, "-o", again, "--force", "-q").stderr == ""
    assert capture.open_rgbd(f"folder:{again}").num_frames == 9
    assert manip3d("capture", "record", walk).returncode == 2


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--seconds", "nan"), "--seconds: expected > 0, got nan"),
        (("--before", "nan", "--trigger", "person"), "--before: expected 0 to 60 seconds, got nan"),
        (("--rate", "3"), "--intrinsics, --units-per-metre, --rate: expected none of them for sim"),
    ],
)
def test_wrong_numbers_name_their_option(
    options: tuple[str, ...], told: str, walk: Path, tmp_path: Path
) -> None:
    source = "sim:body?frames=3" if "--rate" in options else walk
    done = manip3d("capture", "record", source, "-o", tmp_path / "new", *options)
    assert f"error: {told}" in done.stderr
    assert done.returncode == 1


def test_info_counts_gaps(walk: Path) -> None:
    done = manip3d("capture", "info", walk, "--json")
    record = json.loads(done.stdout)
    assert record["frames"] == 9
    assert record["with"] == {"colour": 9, "body_index": 9, "skeletons": 9}
    assert record["missing_numbers"] == 4
    assert record["frames_per_second"] == pytest.approx(30.0, abs=0.01)
    assert record["depth"]["fx"] == 15.0
    assert record["counters"]["frames"] == 9
    assert json.loads(manip3d("info", walk, "--json").stdout) == record
    shown = manip3d("capture", "info", walk).stdout
    assert "depth   16 x 12" in shown
    assert "4 numbers missing" in shown


def test_play_draws_a_sheet_and_pictures(walk: Path, tmp_path: Path) -> None:
    sheet = tmp_path / "sheet.png"
    done = manip3d("capture", "play", walk, "--speed", 0, "-o", sheet, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == 9
    with Image.open(sheet) as image:
        assert image.size == (3 * 32, 3 * 12)
        assert np.asarray(image).std() > 10
    loud = tmp_path / "SHEET.PNG"
    assert manip3d("capture", "play", walk, "--speed", 0, "-o", loud).returncode == 0
    assert loud.read_bytes() == sheet.read_bytes()
    folder = tmp_path / "pictures"
    done = manip3d("capture", "play", walk, "--speed", 0, "--frames", 3, "-o", folder)
    assert sorted(path.name for path in folder.iterdir()) == [f"00000{i}.png" for i in range(3)]
    assert "3 frames in" in done.stdout
    again = ("capture", "play", walk, "--speed", 0, "--frames", 2, "-o", folder)
    for other in ("notes.png", "0000000000.png", "0000001.png"):
        (folder / other).touch()
        assert f"holds other files ({other})" in error_line(manip3d(*again, "--force"))
        (folder / other).unlink()
    assert "exists already" in manip3d(*again).stderr
    assert manip3d(*again, "--force").returncode == 0
    assert sorted(path.name for path in folder.iterdir()) == ["000000.png", "000001.png"]


def test_play_draws_every_frame_also_if_drawing_takes_longer_than_the_time_between_them(
    tmp_path: Path,
) -> None:
    frames = [
        replace(frame, time_ns=number * 1000) for number, frame in enumerate(rgbd_frames.frames(40))
    ]
    capture.record(frames, tmp_path / "fast")
    folder, sheet = tmp_path / "pictures", tmp_path / "a.png"
    for output in (folder, sheet):
        done = manip3d("capture", "play", tmp_path / "fast", "-o", output, "--json")
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["frames"] == 40
    assert len(list(folder.iterdir())) == 40
    chosen = manip3d("capture", "play", tmp_path / "fast", "-o", sheet, "--force", "--speed", 1)
    assert chosen.returncode == 0, chosen.stderr


def test_play_removes_no_picture_before_it_has_read_all(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    (folder / "000007.png").touch()

    def broken(frame: object) -> None:
        raise OSError("no frame")

    monkeypatch.setattr(viewer, "rgbd_picture", broken)
    source = cli_capture.open_source(str(walk), Terminal(quiet=True))
    with pytest.raises(OSError, match="no frame"):
        cli_capture.play(source, folder, Terminal(quiet=True), frames=None, force=True)
    assert (folder / "000007.png").is_file()


def test_play_leaves_no_empty_folder_on_a_full_disk(
    walk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    out = tmp_path / "pictures"
    monkeypatch.setattr(cli_capture, "_write_png", full)
    source = cli_capture.open_source(str(walk), Terminal(quiet=True))
    with pytest.raises(OSError, match="No space left"):
        cli_capture.play(source, out, Terminal(quiet=True), frames=None, force=False)
    assert not out.exists()


@pytest.mark.parametrize(
    ("place", "told"),
    [(".", "holds other files (body_index, "), ("depth", "expected a place outside of the rec")],
)
def test_play_writes_nothing_into_the_folder_that_it_reads(
    walk: Path, place: str, told: str
) -> None:
    before = sorted(walk.rglob("*"))
    done = manip3d("capture", "play", walk, "-o", walk / place, "--force", "-q")
    assert told in error_line(done)
    assert sorted(walk.rglob("*")) == before


def test_plain_folders_need_intrinsics(walk: Path, tmp_path: Path) -> None:
    (walk / "frames.jsonl").unlink()
    (walk / "calibration.json").unlink()
    done = manip3d("capture", "info", walk)
    assert done.returncode == 1
    assert "has no calibration.json" in done.stderr
    done = manip3d("capture", "info", walk, "--intrinsics", "15,15,7.5,5.5", "--json")
    assert json.loads(done.stdout)["depth"]["cx"] == 7.5
    exported = manip3d(
        "capture", "export", walk, "-o", tmp_path / "a.csv", "--intrinsics", "15,15,7.5,5.5"
    )
    assert "expected a skeleton in some frame, found none (--pose, or" in exported.stderr
    capture.record(rgbd_frames.frames(2), tmp_path / "a.mkv")
    ignored = manip3d("capture", "info", tmp_path / "a.mkv", "--units-per-metre", "5000")
    assert "--units-per-metre: can only be given with a folder of images or a bag" in ignored.stderr
    done = manip3d("capture", "info", "nothing:there")
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.splitlines()) == 1


def test_the_unit_of_a_folder_is_stated_as_for_depth_images(walk: Path) -> None:
    (walk / "frames.jsonl").unlink()
    (walk / "calibration.json").unlink()
    order = ("capture", "info", walk, "--intrinsics", "15,15,7.5,5.5", "--json")
    ranges = {
        words: json.loads(manip3d(*order, *words).stdout)["range"]
        for words in (
            (), ("--unit", "0"), ("--unit", "0.00"), ("--unit", "mm"), ("--unit", "tum"),
            ("--unit", "5000"), ("--units-per-metre", "5000"), ("--units-per-metre", "tum"),
        )
    }  # fmt: skip
    millimetres, *_, tum = ranges.values()
    assert list(ranges.values()) == 4 * [millimetres] + 4 * [tum]
    assert tum == pytest.approx([far / 5 for far in millimetres], abs=0.0005)  # rounded to mm
    for unit in ("kinect-raw", "guess", "-1", "disparity:9", "foo"):
        refused = manip3d(*order, "--unit", unit)
        assert refused.returncode == 2
        assert "a number of units per metre" in refused.stderr


def test_the_camera_of_a_folder_is_that_of_the_images_it_shows(walk: Path) -> None:
    (walk / "frames.jsonl").unlink()
    (walk / "calibration.json").unlink()
    for image in sorted((walk / "depth").iterdir()):
        image.rename(image.with_suffix(".PNG"))
    (walk / "depth" / "._hidden.png").write_bytes(b"what macOS leaves beside each file")
    done = manip3d("capture", "info", walk, "--intrinsics", "15,15,7.5,5.5", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["depth"]["width"] == 16


def test_the_size_of_images_of_8_bits_is_read_from_their_header(walk: Path) -> None:
    image = pytest.importorskip("PIL.Image", reason="the extra 'io' is not installed")
    (walk / "frames.jsonl").unlink()
    (walk / "calibration.json").unlink()
    for path in (walk / "depth").iterdir():
        image.fromarray(np.full((12, 16), 100, np.uint8)).save(path)
    camera = ("--intrinsics", "15,15,7.5,5.5", "--units-per-metre", "50")
    done = manip3d("capture", "info", walk, *camera, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["depth"]["width"], found["depth"]["height"]) == (16, 12)
    assert found["range"] == [2.0, 2.0]
    for path in (walk / "depth").iterdir():
        path.write_bytes(b"\xff\xd8\xff\xe0 no PNG, whatever its name says")
    done = manip3d("capture", "info", walk, *camera)
    assert done.returncode == 1
    assert "000000.png" in error_line(done)
    assert "expected a PNG" in error_line(done)
    for path in list((walk / "depth").iterdir()):
        path.rename(path.with_suffix(".npy"))
    done = manip3d("capture", "info", walk, *camera)
    assert error_line(done).endswith("where depth/ holds .npy and no PNG")


def test_the_camera_of_a_tum_sequence_is_that_of_the_images_it_lists(tmp_path: Path) -> None:
    capture.record(rgbd_frames.frames(2), f"tum:{tmp_path / 'walk'}")
    walk = tmp_path / "walk"
    (walk / "calibration.json").unlink()
    (walk / "depth").rename(walk / "depth_registered")
    listed = (walk / "depth.txt").read_text().replace(" depth/", " depth_registered/")
    camera = ("--intrinsics", "15,15,7.5,5.5", "--json")
    for listing in (f"# depth maps\n\n{listed}", listed.replace("\n", "\r\n")):
        (walk / "depth.txt").write_bytes(listing.encode())
        done = manip3d("capture", "info", walk, *camera)
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)["depth"]["width"] == 16
    (walk / "depth.txt").write_text("# nothing\n")
    done = manip3d("capture", "info", walk, *camera)
    assert "--intrinsics: expected a bag or a folder of depth images, got tum:" in error_line(done)


def test_a_folder_without_times_is_told_and_takes_a_rate(walk: Path, tmp_path: Path) -> None:
    (walk / "frames.jsonl").unlink()
    told = manip3d("capture", "info", walk)
    assert "times   none in this folder, 30 a second assumed" in told.stdout
    told = manip3d("capture", "info", walk, "--rate", "15", "--json")
    record = json.loads(told.stdout)
    assert (record["assumed_rate"], record["frames_per_second"]) == (15.0, pytest.approx(15.0))
    done = manip3d("capture", "record", walk, "-o", tmp_path / "again", "--rate", "15")
    assert "times: none in this folder, 15 a second assumed; --rate" in done.stderr
    record = json.loads(manip3d("capture", "info", tmp_path / "again", "--json").stdout)
    assert (record["assumed_rate"], record["frames_per_second"]) == (None, pytest.approx(15.0))
    plain = manip3d("info", walk)  # has no option --rate
    assert "times: none in this folder, 30 a second assumed\n" in plain.stderr
    refused = manip3d("capture", "info", tmp_path / "again", "--rate", "15")
    assert "--rate: expected none, since the frames" in error_line(refused)
