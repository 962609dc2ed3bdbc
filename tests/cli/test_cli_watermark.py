"""``manip3d watermark``: keys, scans, drives, exit codes."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import functools
import json
import lzma
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import command_line
import manip3d
from manip3d.authenticate import (
    KeyFile,
    Watermarked,
    Watermarker,
    _watermark_drives,
    embed_files,
    verify_files,
)
from manip3d.cli import main
from manip3d.cli.terminal import Terminal
from manip3d.cli.watermark import _write_private
from manip3d.errors import FormatError, InputError
from manip3d.io._scan_tables import grid_of

RANDOM = np.random.default_rng(0)


run = functools.partial(command_line.run, "watermark")


def scan(seed: int) -> manip3d.LidarFrame:
    random = np.random.default_rng(seed)
    points = (random.integers(-20_000, 20_000, (8000, 3)) / 1000).astype(np.float32)
    return manip3d.LidarFrame(points, random.integers(0, 99, 8000).astype(np.float32) / 100)


@pytest.fixture
def key(tmp_path: Path) -> Path:
    path = tmp_path / "sensor.key"
    assert run("keygen", path, "-q").exit_code == 0
    return path


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    folder = tmp_path / "drive"
    (folder / "velodyne_points" / "data").mkdir(parents=True)
    for number in range(4):
        scan(number).write(folder / "velodyne_points" / "data" / f"{number:010d}.bin")
    times = "".join(f"2011-09-26 13:02:25.{n}94360375\n" for n in range(4))
    (folder / "velodyne_points" / "timestamps.txt").write_text(times)
    return folder


def test_loose_scans_are_said_to_have_no_chain(key: Path, drive: Path, tmp_path: Path) -> None:
    loose = tmp_path / "loose"
    shutil.copytree(drive / "velodyne_points" / "data", loose)
    told = run("embed", loose, "--key", key, "-o", tmp_path / "signed", "--jobs", 1)
    assert told.exit_code == 0
    assert "4 scans, each a session of its own: if one is missing" in " ".join(told.output.split())
    whole = run("embed", drive, "--key", key, "-o", tmp_path / "whole")
    assert "of its own" not in whole.output


def test_a_survey_file_is_signed_as_it_is(key: Path, tmp_path: Path) -> None:
    pytest.importorskip("laspy")
    corner = np.array([500_000.0, 5_400_000.0, 200.0])
    exact = np.round(np.random.default_rng(2).uniform(-30, 30, (3000, 3)), 3) + corner
    survey = tmp_path / "survey.las"
    manip3d.io.write_scan(manip3d.LidarFrame(exact.astype(np.float32)), survey)
    read = manip3d.io.read_scan(survey)
    assert read.exact is not None
    out = tmp_path / "signed.las"
    refused = run("embed", survey, "--key", key, "-o", out, "--embedding", "qim")
    assert refused.exit_code == 1
    assert not out.exists()
    done = run("embed", survey, "--key", key, "-o", out, "--embedding", "detached")
    assert done.exit_code == 0, done.output
    assert out.read_bytes() == survey.read_bytes()
    assert verify(out, key)[0] == 0
    other = read.exact.copy()
    other[5, 0] += 0.001
    manip3d.io.write_scan(read.replace(exact=other), out)
    assert verify(out, key)[0] == 3


@pytest.fixture
def signed(key: Path, drive: Path, tmp_path: Path) -> Path:
    out = tmp_path / "signed"
    done = run("embed", drive, "--key", key, "-o", out, "--json", "-q")
    assert done.exit_code == 0, done.output
    assert len(json.loads(done.stdout)["frames"]) == 4
    return out


def verify(source: Path, key: Path, *more: object) -> tuple[int, dict[str, object]]:
    done = run("verify", source, "--key", key, "--json", "-q", *more)
    return done.exit_code, json.loads(done.stdout) if done.stdout.startswith("{") else {}


def test_a_report_changes_the_mode_of_regular_files_only(tmp_path: Path) -> None:
    """The report of an administrator to /dev/null closed that device for all others."""
    file, pipe = tmp_path / "report.json", tmp_path / "pipe"
    file.touch(0o644)
    os.mkfifo(pipe)
    pipe.chmod(0o666)
    descriptor = os.open(pipe, os.O_RDWR)
    for path in (file, pipe):
        _write_private(path, {"rows": [1]})
    assert json.loads(os.read(descriptor, 100)) == json.loads(file.read_text())
    os.close(descriptor)
    assert file.stat().st_mode & 0o777 == 0o600
    assert pipe.stat().st_mode & 0o777 == 0o666


def test_the_verdict_is_printed_although_the_report_cannot_be_written(
    key: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan(1).write(tmp_path / "a.bin")
    run("embed", tmp_path / "a.bin", "--key", key, "-o", tmp_path / "signed.bin")

    def full(path: Path, value: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr("manip3d.cli.watermark._write_private", full)
    done = run("verify", tmp_path / "signed.bin", "--key", key, "--report", tmp_path / "r.json")
    assert isinstance(done.exception, OSError)
    assert done.stdout.startswith("authentic:")


def frame_of(folder: Path, number: int) -> Path:
    return folder / "velodyne_points" / "data" / f"{number:010d}.bin"


def test_a_shorter_drive_in_the_place_of_a_longer_one_is_whole(
    key: Path, signed: Path, drive: Path
) -> None:
    frame_of(drive, 3).unlink()
    other = frame_of(signed, 0).with_name("notes.txt")
    other.write_text("kept")
    done = run("embed", drive, "--key", key, "-o", signed, "--force")
    assert done.exit_code == 0, done.output
    assert verify(signed, key)[0] == 0
    names = sorted(path.name for path in other.parent.iterdir())
    assert names == sorted([*(f"{n:010d}.bin{end}" for n in range(3) for end in ("", ".wm")),
                            "notes.txt"])  # fmt: skip


def test_a_drive_that_nobody_signed_is_not_replaced(key: Path, drive: Path, tmp_path: Path) -> None:
    """Scans without records are not replaced, since no other copy of them may exist."""
    other = tmp_path / "other"
    frame_of(other, 0).parent.mkdir(parents=True)
    for number in (0, 7):
        frame_of(other, number).write_bytes(bytes(16))
    done = run("embed", drive, "--key", key, "-o", other, "--force")
    assert "other holds scans that nobody signed" in str(done.exception)
    assert [frame_of(other, number).read_bytes() for number in (0, 7)] == [bytes(16)] * 2


def test_scans_that_nobody_signed_are_not_replaced_beside_signed_ones(
    key: Path, drive: Path, signed: Path
) -> None:
    """One record in the folder stood for all of its scans, and the others were deleted."""
    frame_of(signed, 2).with_name("0000000002.bin.wm").unlink()
    scan(9).write(frame_of(signed, 2))
    before = frame_of(signed, 2).read_bytes()
    frame_of(drive, 3).unlink()
    done = run("embed", drive, "--key", key, "-o", signed, "--force")
    assert "signed holds scans that nobody signed, which would be lost, such as 0000000002" in str(
        done.exception
    )
    assert frame_of(signed, 2).read_bytes() == before
    assert frame_of(signed, 3).is_file()


@pytest.mark.parametrize("embedding", ["lbm", "detached"])
@pytest.mark.parametrize("number", [0, 2])
def test_a_drive_is_replaced_after_a_kill_between_a_scan_and_its_record(
    key: Path, drive: Path, signed: Path, number: int, embedding: str
) -> None:
    """The scan without a record was taken for one that nobody signed, and the drive stayed torn."""
    record = frame_of(signed, number).with_name(f"{number:010d}.bin.wm")
    told = record.read_bytes()
    record.unlink()
    command = ("embed", drive, "--key", key, "-o", signed, "--embedding", embedding, "--force")
    assert run(*command).exit_code == 0
    assert record.read_bytes() != told
    assert verify(signed, key)[0] == 0
    for torn in (number, 3):  # no kill leaves two
        frame_of(signed, torn).with_name(f"{torn:010d}.bin.wm").unlink()
    refused = run(*command)
    assert "which would be lost, such as 0000000003" in str(refused.exception)


def test_a_drive_is_signed_by_a_watermarker_that_embedded_nothing(
    key: Path, drive: Path, tmp_path: Path, full_disk: dict[str, int]
) -> None:
    """Its frames would be those of a session without a beginning."""
    out = tmp_path / "signed"
    with KeyFile(key) as secret, Watermarker(secret) as marker:
        with pytest.raises(OSError, match="No space left"):
            embed_files(marker, drive, out)
        full_disk["left"] = 9
        for replace in (False, True):
            with pytest.raises(InputError, match="marker: expected one that has embedded no frame"):
                embed_files(marker, drive, out, replace=replace)
        assert [each.was_there for each in embed_files(Watermarker(secret), drive, out)] == [
            True, True, False, False
        ]  # fmt: skip
        assert verify_files(marker, out).verdict == "authentic"


@pytest.mark.parametrize("name", ["mistyped", "mistyped.bin", "mistyped.bin.wm"])
def test_a_source_that_is_missing_has_no_verdict(key: Path, tmp_path: Path, name: str) -> None:
    with KeyFile(key) as secret, Watermarker(secret) as marker:
        with pytest.raises(FileNotFoundError, match=name):
            verify_files(marker, tmp_path / name)
        with pytest.raises(FileNotFoundError, match=name):
            embed_files(marker, tmp_path / name, tmp_path / "out.bin")


@pytest.mark.parametrize("number", [3, 7])
def test_a_run_that_goes_on_loses_no_scan_that_nobody_signed(
    key: Path, drive: Path, tmp_path: Path, full_disk: dict[str, int], number: int
) -> None:
    out = tmp_path / "signed"
    assert run("embed", drive, "--key", key, "-o", out).exit_code == 1
    full_disk["left"] = 9
    scan(9).write(frame_of(out, number))
    before = frame_of(out, number).read_bytes()
    refused = run("embed", drive, "--key", key, "-o", out)
    assert f"scans that nobody signed, which would be lost, such as 000000000{number}" in str(
        refused.exception
    )
    assert frame_of(out, number).read_bytes() == before


@pytest.mark.parametrize("more", [(), ("--force",)])
def test_a_link_to_the_folder_of_the_scans_is_no_place_for_signed_ones(
    key: Path, drive: Path, tmp_path: Path, more: tuple[str, ...]
) -> None:
    """Originals were overwritten, and those of no signed scan deleted."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "velodyne_points").symlink_to(drive / "velodyne_points")
    before = [frame_of(drive, number).read_bytes() for number in range(4)]
    refused = run("embed", drive, "--key", key, "-o", out, *more)
    assert "expected another folder than the drive's" in str(refused.exception)
    assert [frame_of(drive, number).read_bytes() for number in range(4)] == before
    assert len(list((drive / "velodyne_points" / "data").iterdir())) == 4


def test_a_link_to_the_folder_of_the_pictures_is_no_place_for_carriers(
    key: Path, drive: Path, tmp_path: Path
) -> None:
    image = pytest.importorskip("PIL.Image")
    out, pictures = tmp_path / "out", drive / "image_02"
    out.mkdir()
    pictures.mkdir()
    for number in range(4):
        image.fromarray(np.zeros((160, 160), np.uint8)).save(pictures / f"{number:010d}.png")
    before = (pictures / "0000000000.png").read_bytes()
    (out / "image_02").symlink_to(pictures)
    refused = run("embed", drive, "--key", key, "-o", out, "--picture", "image_02")
    assert "expected another folder than the drive's" in str(refused.exception)
    assert (pictures / "0000000000.png").read_bytes() == before


def test_scans_behind_a_link_exist(key: Path, drive: Path, tmp_path: Path) -> None:
    out, other = tmp_path / "out", tmp_path / "other"
    out.mkdir()
    frame_of(other, 0).parent.mkdir(parents=True)
    scan(9).write(frame_of(other, 9))
    (out / "velodyne_points").symlink_to(other / "velodyne_points")
    refused = run("embed", drive, "--key", key, "-o", out)
    assert "exists already" in str(refused.exception)
    assert [path.name for path in frame_of(other, 0).parent.iterdir()] == ["0000000009.bin"]


@pytest.mark.parametrize("embedding", ["lbm", "qim"])
def test_points_off_the_grid_are_refused_with_the_options_that_help(
    key: Path, tmp_path: Path, embedding: str
) -> None:
    """``--round`` moves no point farther than the help says."""
    off = scan(0).points + np.random.default_rng(1).uniform(-5e-4, 5e-4, (8000, 3))
    source, out = tmp_path / "a.bin", tmp_path / "b.bin"
    manip3d.LidarFrame(off.astype(np.float32)).write(source)
    asked = ("embed", source, "--key", key, "-o", out, "--embedding", embedding)
    refused = str(run(*asked).exception)
    assert refused.endswith("; give --embedding detached, which moves no point, or --round")
    assert run(*asked, "--round").exit_code == 0
    before, after = manip3d.io.read_scan(source).points, manip3d.io.read_scan(out).points
    moved = np.linalg.norm(after.astype(np.float64) - before, axis=1).max()
    help_text = " ".join(run("embed", "--help").output.split())
    said = re.search(
        r"with --round by at most ([\d.]+) mm \(lbm\) or ([\d.]+) mm \(qim\)", help_text
    )
    assert said is not None
    most = float(said[1 if embedding == "lbm" else 2]) / 1000.0
    assert 0.9 * most < moved < most + 1e-5


@pytest.mark.parametrize("embedding", ["lbm", "qim", "detached"])
def test_a_scan(key: Path, tmp_path: Path, embedding: str) -> None:
    scan(1).write(tmp_path / "a.bin")
    out = tmp_path / "b.bin"
    done = run("embed", tmp_path / "a.bin", "--key", key, "-o", out, "--embedding", embedding)
    assert done.exit_code == 0, done.output
    same = out.read_bytes() == (tmp_path / "a.bin").read_bytes()
    assert same == (embedding == "detached")
    assert verify(out, key)[0] == 0
    assert verify(out, key, "--embedding", "lbm")[0] == (0 if embedding == "lbm" else 4)
    again = run("embed", tmp_path / "a.bin", "--key", key, "-o", out)
    assert again.exit_code == 1

    data = bytearray(out.read_bytes())
    data[4000] ^= 1
    out.write_bytes(data)
    code, record = verify(out, key, "--report", tmp_path / "report.json")
    assert (code, record["verdict"]) == (3, "tampered")
    report = tmp_path / "report.json"
    assert report.stat().st_mode & 0o777 == 0o600
    assert "suspected_rows" in report.read_text()
    assert "suspected_rows" not in json.dumps(record)

    out.with_name("b.bin.wm").unlink()
    assert verify(out, key)[0] == 4


def test_what_is_signed_is_signed_again_only_when_asked(
    key: Path, drive: Path, tmp_path: Path
) -> None:
    """A signed scan is refused without --again, since signing it anew moves its points twice."""
    signed, again = tmp_path / "signed", tmp_path / "again"
    assert run("embed", drive, "--key", key, "-o", signed, "-q").exit_code == 0
    done = run("embed", signed, "--key", key, "-o", again, "-q")
    assert done.exit_code == 1
    assert "0000000000.bin: is signed already" in str(done.exception)
    assert "and 3 more; --again (again=True)" in str(done.exception)
    assert not again.exists()
    one = signed / "velodyne_points" / "data" / "0000000001.bin"
    place = ("--key", key, "-o", one, "--force", "-q")
    before = one.read_bytes()
    assert run("embed", one, *place).exit_code == 1  # in its own place
    assert one.read_bytes() == before
    assert run("embed", one, *place, "--again").exit_code == 0
    assert verify(one, key)[0] == 0
    assert run("embed", signed, "--key", key, "-o", again, "--again", "-q").exit_code == 0
    assert verify(again, key)[0] == 0
    packed = tmp_path / "packed.bin.xz"
    packed.write_bytes(lzma.compress(before))
    shutil.copy(one.with_name(one.name + ".wm"), tmp_path / "packed.bin.wm")
    with pytest.raises(manip3d.InputError, match=r"signed already \(.*packed\.bin\.wm\)"):
        embed_files(Watermarker(KeyFile(key)), packed, tmp_path / "c.bin")


def test_formats_that_round_are_refused(key: Path, tmp_path: Path) -> None:
    scan(1).write(tmp_path / "a.bin")
    for suffix in (".pcd", ".ply"):
        out = tmp_path / f"b{suffix}"
        assert run("embed", tmp_path / "a.bin", "--key", key, "-o", out).exit_code == 0
        assert verify(out, key)[0] == 0
    for suffix in (".las", ".e57", ".3d"):
        out = tmp_path / f"b{suffix}"
        done = run("embed", tmp_path / "a.bin", "--key", key, "-o", out)
        assert done.exit_code == 1
        assert "float32" in str(done.exception)
        assert not out.exists()
    # No folder is searched for these, so that nothing would verify them there.
    for suffix in (".asc", ".pts", ".txt", ".csv", ".npy"):
        out = tmp_path / f"b{suffix}"
        done = run("embed", tmp_path / "a.bin", "--key", key, "-o", out)
        assert done.exit_code == 1
        assert "expected a name that ends in" in str(done.exception)
        assert not out.exists()


@pytest.mark.parametrize("suffix", [".bin", ".pcd.bin", ".pcd", ".ply"])
@pytest.mark.parametrize("embedding", ["lbm", "detached"])
def test_organised_scans_and_scans_without_intensity_verify(
    key: Path, tmp_path: Path, suffix: str, embedding: str
) -> None:
    points = scan(1).points.copy()
    points[[5, 70]] = np.nan
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in points.tolist())
    organised = tmp_path / "organised.pcd"
    organised.write_text(
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 4000\nHEIGHT 2\n"
        f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 8000\nDATA ascii\n{rows}"
    )
    assert manip3d.io.read_scan(organised).num_dropped == 2
    out = tmp_path / f"signed{suffix}"
    lost = pytest.warns(UserWarning, match="grid of 4000 x 2 pixels is not kept in")
    with lost if suffix != ".pcd" else contextlib.nullcontext():
        done = run("embed", organised, "--key", key, "-o", out, "--embedding", embedding)
    assert done.exit_code == 0, done.output
    assert verify(out, key)[0] == 0
    again = manip3d.io.read_scan(out)
    if suffix == ".pcd":
        assert grid_of(again) == (2, 4000)
        assert again.num_dropped == 2
        assert again.file_rows is not None
        assert not np.isin([5, 70], again.file_rows).any()
    else:
        assert again.num_dropped == 0
    same = out.read_bytes() == organised.read_bytes()
    assert same == (embedding == "detached" and suffix == ".pcd")


def placed(path: Path, grid: str = "WIDTH 8000\nHEIGHT 1") -> Path:
    """Write a PCD file whose scanner does not stand at the origin."""
    rows = "".join(f"{x} {y} {z}\n" for x, y, z in scan(1).points.tolist())
    path.write_text(
        f"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n{grid}\n"
        f"VIEWPOINT 6 -4 1.5 1 0 0 0\nPOINTS 8000\nDATA ascii\n{rows}"
    )
    return path


def test_a_lost_position_of_the_scanner_is_told(key: Path, tmp_path: Path) -> None:
    source, known = placed(tmp_path / "a.pcd"), tmp_path / "known.bin"
    with pytest.warns(UserWarning, match=r"the scanner stands at 6.000 -4.000 1.500, which .bin"):
        assert run("embed", source, "--key", key, "-o", known).exit_code == 0
    assert run("embed", source, "--key", key, "-o", tmp_path / "same.pcd").exit_code == 0
    manip3d.io.read_scan(source).write(tmp_path / "a.ply")
    with pytest.warns(UserWarning, match="where the scanner stood is not known"):
        done = run("embed", tmp_path / "a.ply", "--key", key, "-o", tmp_path / "unknown.bin")
    assert done.exit_code == 0


def test_a_refused_format_is_told_before_what_it_would_lose(key: Path, tmp_path: Path) -> None:
    """A warning of the grid, which is an error here, came before the format was refused."""
    source = placed(tmp_path / "a.pcd", "WIDTH 4000\nHEIGHT 2")
    done = run("embed", source, "--key", key, "-o", tmp_path / "a.las")
    assert "expected a format that keeps float32 coordinates" in str(done.exception)


def test_verify_says_what_of_a_pcd_is_not_signed() -> None:
    said = " ".join(run("verify", "--help").stdout.split())
    assert "the grid and the viewpoint of a PCD file, are not signed" in said


def test_what_a_format_does_not_give_back_is_not_written(key: Path, tmp_path: Path) -> None:
    bare = manip3d.LidarFrame(scan(1).points)
    with manip3d.authenticate.KeyFile(key) as secret:
        sent = manip3d.authenticate.Watermarker(secret).embed(bare)
    out = tmp_path / "signed.bin"
    with pytest.raises(manip3d.InputError, match="does not give the intensities back"):
        manip3d.authenticate.write_watermarked(sent, out)
    assert list(tmp_path.glob("signed*")) == []


def test_a_scan_whose_signing_fails_keeps_the_record_that_it_had(key: Path, tmp_path: Path) -> None:
    """If the new record cannot be written, the old scan and its record both stay."""
    out = tmp_path / "signed.bin"
    with manip3d.authenticate.KeyFile(key) as secret:
        first, second = (
            manip3d.authenticate.Watermarker(secret).embed(scan(number)) for number in (1, 2)
        )
    manip3d.authenticate.write_watermarked(first, out)
    assert verify(out, key)[1]["verdict"] == "authentic"
    unwritable = dataclasses.replace(second, record=None)
    with pytest.raises((TypeError, OSError)):
        manip3d.authenticate.write_watermarked(unwritable, out)
    assert verify(out, key)[1]["verdict"] == "authentic"
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith("signed")) == [
        "signed.bin",
        "signed.bin.wm",
    ]


def test_a_drive(key: Path, signed: Path, tmp_path: Path) -> None:
    code, record = verify(signed, key)
    assert (code, record["verdict"]) == (0, "authentic")
    frames = record["frames"]
    assert isinstance(frames, list)
    assert [frame["order"] for frame in frames] == ["in order"] * 4

    moved = scan(9).points
    manip3d.LidarFrame(moved, scan(9).intensity).write(frame_of(signed, 2))
    code, record = verify(signed, key)
    assert (code, record["verdict"]) == (3, "tampered")


def test_a_signed_drive_is_a_drive(key: Path, drive: Path, tmp_path: Path) -> None:
    """Embedding copies the other files of the drive, and the calibration files of its day."""
    beside = ("oxts/data/0000000000.txt", "image_02/data/0000000000.png", "rigs.json",
              "tracklet_labels.xml", "velodyne_points/labels/a.label")  # fmt: skip
    for number, name in enumerate(beside):
        (drive / name).parent.mkdir(parents=True, exist_ok=True)
        (drive / name).write_bytes(bytes([number]) * 9)
    (drive / "image_03").symlink_to(drive / "image_02")
    (drive / "image_02" / "again").symlink_to(drive)
    day = ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt", "calib_imu_to_velo.txt")
    for name in day:
        (drive.parent / name).write_text(name)
    (frame_of(drive, 0).parent / "0000000000.bin.wm").write_bytes(b"an old record")
    out = drive / "signed"
    assert run("embed", drive, "--key", key, "-o", out, "--again", "-q").exit_code == 0
    for name in (*beside, "velodyne_points/timestamps.txt"):
        assert (out / name).read_bytes() == (drive / name).read_bytes()
    for name in day:
        assert (out / name).read_text() == name
    assert (out / "image_03" / "data" / "0000000000.png").is_file()
    assert not list(out.rglob("signed"))
    assert verify(out, key)[0] == 0
    bare = tmp_path / "bare"
    assert run("embed", drive, "--key", key, "-o", bare, "--scans-only", "--again").exit_code == 0
    assert [path.name for path in bare.iterdir()] == ["velodyne_points"]


def test_records_bear_the_times_of_the_drive(key: Path, drive: Path, tmp_path: Path) -> None:
    """Times are matched to scans by name, since scans may be missing as in KITTI's drive 0009."""
    frame_of(drive, 1).unlink()

    def times_of(source: Path, name: str) -> list[int]:
        out = tmp_path / name
        assert run("embed", source, "--key", key, "-o", out, "-q").exit_code == 0
        records = sorted(out.rglob("*.wm"))
        with manip3d.authenticate.KeyFile(key) as secret:
            marker = manip3d.authenticate.Watermarker(secret)
            found = [
                marker.verify(
                    manip3d.io.read_scan(record.with_suffix("")), record.read_bytes()
                ).time_ns
                for record in records
            ]
        return [time for time in found if time is not None]

    begin = 1_317_042_145_094_360_375
    assert times_of(drive, "raw") == [begin + n * 100_000_000 for n in (0, 2, 3)]
    odometry = tmp_path / "odometry"
    (odometry / "velodyne").mkdir(parents=True)
    shutil.copy(frame_of(drive, 2), odometry / "velodyne" / "000001.bin")
    (odometry / "times.txt").write_text("0.0\n1.038e-01\n")
    assert times_of(odometry, "flat") == [103_800_000]


def test_dropped_swapped_repeated_and_foreign_frames(
    key: Path, signed: Path, drive: Path, tmp_path: Path
) -> None:
    def changed(name: str) -> Path:
        return Path(shutil.copytree(signed, tmp_path / name))

    def copy(source: Path, target: Path) -> None:
        shutil.copy(source, target)
        shutil.copy(f"{source}.wm", f"{target}.wm")

    def drop(folder: Path, number: int) -> None:
        frame_of(folder, number).unlink()
        Path(f"{frame_of(folder, number)}.wm").unlink()

    dropped = changed("dropped")
    drop(dropped, 1)
    assert verify(dropped, key)[0] == 4
    shortened = changed("shortened")
    drop(shortened, 3)
    assert verify(shortened, key)[0] == 4  # the end is missing
    beheaded = changed("beheaded")
    drop(beheaded, 0)
    assert verify(beheaded, key)[0] == 4
    repeated = changed("repeated")
    copy(frame_of(signed, 1), frame_of(repeated, 2))
    assert verify(repeated, key)[0] == 3
    swapped = changed("swapped")
    copy(frame_of(signed, 2), frame_of(swapped, 1))
    copy(frame_of(signed, 1), frame_of(swapped, 2))
    assert verify(swapped, key)[0] == 3
    foreign = changed("foreign")
    other = tmp_path / "other"
    assert run("embed", drive, "--key", key, "-o", other, "-q").exit_code == 0
    copy(frame_of(other, 2), frame_of(foreign, 2))
    code, record = verify(foreign, key)
    assert (code, record["verdict"]) == (3, "tampered")
    assert str(record["reason"]).startswith("frame 3 (counted from 1) is of another session")
    assert [each["verdict"] for each in record["frames"]] == [
        "authentic", "authentic", "undecidable", "undecidable"
    ]  # fmt: skip
    assert verify(other, key)[0] == 0


def test_two_drives_joined_are_not_one(
    key: Path, signed: Path, drive: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    assert run("embed", drive, "--key", key, "-o", other, "-q").exit_code == 0
    for number in range(4):
        for suffix in ("", ".wm"):
            source = f"{frame_of(other, number)}{suffix}"
            shutil.copy(source, f"{frame_of(signed, 4 + number)}{suffix}")
    code, record = verify(signed, key)
    assert (code, record["verdict"]) == (4, "undecidable")
    assert "2 sessions" in str(record["reason"])


def test_another_key_and_bad_key_files(key: Path, signed: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.key"
    assert run("keygen", other).exit_code == 0
    assert verify(signed, other)[0] == 4
    assert run("keygen", key).exit_code == 1  # never replaced
    key.chmod(0o644)
    done = run("verify", signed, "--key", key)
    assert done.exit_code == 1
    assert "0644" in str(done.exception)


def test_a_verifier_that_remembers(key: Path, signed: Path, tmp_path: Path) -> None:
    state = tmp_path / "seen"
    assert verify(signed, key, "--state", state)[0] == 0
    assert verify(signed, key, "--state", state)[0] == 3
    nowhere = tmp_path / "absent" / "seen"
    with pytest.raises(FileNotFoundError) as refused:
        raise run("verify", signed, "--key", key, "--state", nowhere).exception
    assert refused.value.filename == str(nowhere)  # and not its lock
    assert verify(signed, key)[0] == 0


def test_a_scan_that_was_compressed_since_finds_its_record(
    key: Path, signed: Path, tmp_path: Path
) -> None:
    for number in (0, 2):
        path = frame_of(signed, number)
        Path(f"{path}.xz").write_bytes(lzma.compress(path.read_bytes()))
        path.unlink()
    assert verify(signed, key)[0] == 0
    loose = tmp_path / "loose"
    loose.mkdir()
    for name in ("0000000000.bin.xz", "0000000000.bin.wm"):
        shutil.copy(frame_of(signed, 0).with_name(name), loose / name)
    done = run("verify", loose, "--key", key, "--json", "-q", "--jobs", 1)
    assert done.exit_code == 0, done.output
    (loose / "0000000000.bin.wm").rename(loose / "0000000000.bin.xz.wm")
    shutil.copy(frame_of(signed, 1), loose / "other.bin")  # without a record
    (loose / "0000000000.bin").write_bytes(
        lzma.decompress((loose / "0000000000.bin.xz").read_bytes())
    )
    (loose / "0000000000.bin.xz").unlink()
    assert verify(loose / "0000000000.bin", key)[0] == 0
    assert verify(loose / "other.bin", key)[0] == 4


def test_what_a_folder_hides_is_undecidable(key: Path, tmp_path: Path) -> None:
    """A signed scan that was turned into a mesh or taken away makes its folder undecidable."""
    folder = tmp_path / "signed"
    folder.mkdir()
    for number, name in enumerate(("a.ply", "b.bin", "c.bin")):
        scan(number).write(tmp_path / name)
        assert run("embed", tmp_path / name, "--key", key, "-o", folder / name).exit_code == 0

    def codes() -> tuple[int, dict[str, int]]:
        done = run("verify", folder, "--key", key, "--json", "-q", "--jobs", 1)
        rows = json.loads(done.stdout)
        return done.exit_code, {Path(row["source"]).name: row["exit_code"] for row in rows}

    assert codes() == (0, {"a.ply": 0, "b.bin": 0, "c.bin": 0})
    head, body = (folder / "a.ply").read_bytes().split(b"end_header\n", 1)
    head += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    face = bytes([3]) + np.array([0, 1, 2], "<i4").tobytes()
    (folder / "a.ply").write_bytes(head + bytes([body[0] ^ 64]) + body[1:] + face)
    assert codes() == (4, {"a.ply": 4, "b.bin": 0, "c.bin": 0})
    (folder / "c.bin").unlink()
    assert codes() == (4, {"a.ply": 4, "b.bin": 0, "c.bin.wm": 4})
    assert verify(folder / "c.bin.wm", key)[1]["reason"] == "the record's scan is missing"
    assert run("verify", folder / "b.bin.wm", "--key", key).exit_code == 1
    (folder / "c.bin").mkdir()  # whatever it holds, it is not the scan
    assert run("verify", folder, "--key", key, "--jobs", 1).exit_code == 1


def exported(scan: Path, suffix: str, *, is_forged: bool = False) -> None:
    """Write a KITTI scan in another format in its place, and rename its record accordingly."""
    frame = manip3d.io.read_scan(scan)
    points = frame.points + np.float32(is_forged) * (np.arange(len(frame.points)) == 5)[:, None]
    manip3d.LidarFrame(points, frame.intensity).write(scan.with_suffix(suffix))
    scan.unlink()
    Path(f"{scan}.wm").rename(scan.with_suffix(f"{suffix}.wm"))


@pytest.mark.parametrize("suffix", [".npy", ".csv", ".npz", ".csv.gz"])
def test_scans_of_any_suffix_are_verified_if_they_have_a_record(
    key: Path, tmp_path: Path, suffix: str
) -> None:
    folder = tmp_path / "signed"
    folder.mkdir()
    for number, name in enumerate(("a.bin", "b.bin", "c.bin")):
        scan(number).write(tmp_path / name)
        assert run("embed", tmp_path / name, "--key", key, "-o", folder / name).exit_code == 0
    exported(folder / "b.bin", suffix)
    exported(folder / "c.bin", suffix, is_forged=True)
    (folder / "notes.csv").write_text("x,y,z\n1,2,3\n")  # has no record

    def codes(*sources: object) -> tuple[int, dict[str, int]]:
        done = run("verify", *sources, "--key", key, "--json", "-q", "--jobs", 1)
        rows = json.loads(done.stdout)
        return done.exit_code, {Path(row["source"]).name: row["exit_code"] for row in rows}

    expected = {"a.bin": 0, f"b{suffix}": 0, f"c{suffix}": 3}
    assert codes(folder) == (3, expected)
    assert codes(folder / "*.wm") == (3, expected)
    (folder / "a.bin").unlink()
    assert codes(folder) == (3, {"a.bin.wm": 4, f"b{suffix}": 0, f"c{suffix}": 3})
    Path(folder / f"c{suffix}").rename(folder / "c.sky")
    Path(folder / f"c{suffix}.wm").rename(folder / "c.sky.wm")
    assert codes(folder) == (4, {"a.bin.wm": 4, f"b{suffix}": 0, "c.sky": 4})


def test_a_drive_of_scans_of_any_suffix_is_one_chain(key: Path, signed: Path) -> None:
    exported(frame_of(signed, 1), ".npy")
    code, record = verify(signed, key)
    assert (code, record["num_frames"]) == (0, 4)
    exported(frame_of(signed, 3), ".csv", is_forged=True)
    code, record = verify(signed, key)
    frames = record["frames"]
    assert code == 3
    assert isinstance(frames, list)
    assert [frame["verdict"] for frame in frames] == ["authentic"] * 3 + ["tampered"]
    exported(frame_of(signed, 0), ".npz")
    for name in ("", ".wm"):
        Path(f"{frame_of(signed, 2)}{name}").rename(frame_of(signed, 2).with_suffix(f".sky{name}"))
    code, record = verify(signed, key)
    frames = record["frames"]
    assert code == 3
    assert isinstance(frames, list)
    assert [frame["scan"][-4:] for frame in frames] == [".npz", ".npy", ".sky", ".csv"]
    assert frames[2]["reason"].startswith("unreadable: ")


def test_folders_without_a_scan_to_sign_are_refused_with_what_can_be_signed(
    key: Path, drive: Path
) -> None:
    for number in range(4):
        table = scan(number)
        table.write(frame_of(drive, number).with_suffix(".npy"))
        frame_of(drive, number).unlink()
    for verb in (("embed", "-o", drive.with_name("out")), ("verify",)):
        done = run(*verb, drive, "--key", key)
        told = str(done.exception)
        assert "expected scans, found none; text files and arrays such as 0000000000.npy" in told
        assert "writes them as .bin, .pcd or .ply, which can be signed" in told


def test_a_drive_names_the_scan_that_is_missing(key: Path, signed: Path) -> None:
    frame_of(signed, 1).unlink()
    code, record = verify(signed, key)
    assert (code, record["verdict"]) == (4, "undecidable")
    frames = record["frames"]
    assert isinstance(frames, list)
    assert [frame["verdict"] for frame in frames] == [
        "authentic", "undecidable", "authentic", "authentic",
    ]  # fmt: skip
    assert frames[1]["scan"] == "0000000001.bin"
    assert "scan is missing" in frames[1]["reason"]


def test_one_unreadable_scan_does_not_silence_the_others(key: Path, signed: Path) -> None:
    frame_of(signed, 1).write_bytes(b"12345")
    code, record = verify(signed, key)
    assert (code, record["verdict"]) == (4, "undecidable")
    frames = record["frames"]
    assert isinstance(frames, list)
    assert [frame["verdict"] for frame in frames] == [
        "authentic", "undecidable", "authentic", "authentic",
    ]  # fmt: skip
    assert frames[1]["reason"].startswith("unreadable")
    manip3d.LidarFrame(scan(9).points, scan(9).intensity).write(frame_of(signed, 3))
    assert verify(signed, key)[0] == 3
    assert run("verify", frame_of(signed, 1), "--key", key).exit_code == 1


def test_an_empty_scan_does_not_end_a_session(key: Path, drive: Path, tmp_path: Path) -> None:
    frame_of(drive, 2).write_bytes(b"")
    out = tmp_path / "signed"
    assert run("embed", drive, "--key", key, "-o", out, "-q").exit_code == 0
    assert verify(out, key)[0] == 0


def test_an_emptied_file_is_as_undecidable_as_a_missing_one(key: Path, signed: Path) -> None:
    frame_of(signed, 1).write_bytes(b"")
    code, record = verify(signed, key)
    frames = record["frames"]
    assert code == 4
    assert isinstance(frames, list)
    assert [frame["verdict"] for frame in frames] == [
        "authentic", "undecidable", "authentic", "authentic",
    ]  # fmt: skip
    assert frames[1]["reason"] == "the scan holds no points, and points were signed"
    shutil.copy(f"{frame_of(signed, 0)}.wm", f"{frame_of(signed, 1)}.wm")
    assert verify(signed, key)[0] == 3  # a replay, whatever the file holds


def test_wrong_sources(key: Path, tmp_path: Path) -> None:
    (tmp_path / "empty" / "velodyne").mkdir(parents=True)
    assert run("verify", tmp_path / "empty", "--key", key).exit_code == 1
    assert run("verify", tmp_path / "nothing.bin", "--key", key).exit_code == 1
    (tmp_path / "text.txt").write_text("a")
    assert run("embed", tmp_path / "text.txt", "--key", key, "-o", "x.bin").exit_code == 1


def test_a_drive_of_a_key_that_was_replaced(drive: Path, tmp_path: Path) -> None:
    """A replaced key verifies what it signed before its replacement only.

    Keys are given one by one or as a folder of keys, also to ``alert run``.
    """
    (drive / "velodyne_points" / "timestamps.txt").unlink()  # the records bear the clock's time
    ring = tmp_path / "ring"
    ring.mkdir()
    old, new = ring / "old.key", ring / "new.key"
    before, after = tmp_path / "before", tmp_path / "after"
    assert run("keygen", old, "-q").exit_code == 0
    assert run("embed", drive, "--key", old, "-q", "-o", before).exit_code == 0
    assert run("keygen", new, "-q").exit_code == 0
    assert run("embed", drive, "--key", old, "-q", "-o", after).exit_code == 0
    for keys in ((new, "--key", old), (ring,)):
        code, told = verify(before, *keys)
        assert code == 0
        frames = told["frames"]
        assert isinstance(frames, list)
        assert {frame["key_id"] for frame in frames} == {KeyFile(old).key_id}
        code, told = verify(after, *keys)
        assert code == 4
        assert "had been replaced" in str(told["reason"])
    for key, code in ((ring, 0), (new, 4)):
        watched = command_line.run("alert", "run", before, "--key", key)
        assert watched.exit_code == code, watched.output


def test_several_drives_are_told_in_a_line_each(key: Path, signed: Path, tmp_path: Path) -> None:
    """Several drives are printed as a row each, without columns for single frames."""
    for name in ("a", "b"):
        shutil.copytree(signed, tmp_path / "all" / name)
    done = run("verify", tmp_path / "all", "--key", key)
    heads, *lines = done.stdout.splitlines()
    assert done.exit_code == 0
    assert heads.split() == ["source", "verdict", "num_frames", "reason"]
    assert len(lines) == 2


@pytest.mark.parametrize(
    ("option", "value"),
    [("sensor", "x" * 17), ("session", "zz"), ("max-age", "0"), ("max-age", "nan")],
)
def test_the_verifier_names_the_option_that_is_wrong(
    option: str, value: str, key: Path, signed: Path
) -> None:
    found = run("verify", signed, "--key", key, f"--{option}", value)
    assert found.exit_code == 1
    assert str(found.exception).startswith(f"--{option}: ")


@pytest.mark.parametrize(("option", "value"), [("sensor", "x" * 17), ("units-per-m", "0")])
def test_the_embedder_names_the_option_that_is_wrong(
    option: str, value: str, key: Path, tmp_path: Path
) -> None:
    scan(0).write(tmp_path / "scan.bin")
    out = tmp_path / "out.bin"
    found = run("embed", tmp_path / "scan.bin", "--key", key, "-o", out, f"--{option}", value)
    assert found.exit_code == 1
    assert str(found.exception).startswith(f"--{option}: ")
    assert not out.exists()


def test_stdin_has_no_record(key: Path) -> None:
    done = run("verify", "-", "--key", key)
    assert done.exit_code == 1
    assert "stdin has no record" in str(done.exception)


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Simulate a disk that takes as many scans as ``left`` says, and no more."""
    disk = {"left": 2}
    write = _watermark_drives.write_watermarked

    def writes(sent: Watermarked, path: Path, **options: Any) -> None:
        if disk["left"] == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        disk["left"] -= 1
        write(sent, path, **options)

    monkeypatch.setattr(_watermark_drives, "write_watermarked", writes)
    return disk


def test_a_drive_is_written_by_one_program_at_a_time(
    key: Path, drive: Path, tmp_path: Path
) -> None:
    """A second writer is refused, since nobody could verify two sessions in one folder."""
    from manip3d._util.locks import new_folder_locked

    signed = tmp_path / "signed"
    with new_folder_locked(signed) as is_ours:
        assert is_ours
        done = run("embed", drive, "--key", key, "-o", signed)
        assert (done.exit_code, list(signed.iterdir())) == (1, [])
        assert str(done.exception) == f"-o: another program is writing to {signed}"
    assert not signed.exists()
    assert run("embed", drive, "--key", key, "-o", signed).exit_code == 0


@pytest.mark.parametrize("embedding", ["lbm", "qim", "detached"])
def test_a_drive_goes_on_after_a_full_disk(
    key: Path, drive: Path, tmp_path: Path, full_disk: dict[str, int], embedding: str
) -> None:
    out = tmp_path / "signed"
    (drive / "calib.txt").write_text("P0: 1\n")
    command = ("embed", drive, "--key", key, "-o", out, "--embedding", embedding)
    failed = run(*command)
    assert isinstance(failed.exception, OSError)
    (note,) = failed.exception.__notes__
    assert note == (
        f"{out} has 2 of 4 scans, each whole; run again without replace=True, it goes on after them"
    )
    half = run("verify", out, "--key", key, "--json")
    assert json.loads(half.stdout)["verdicts"] == {"authentic": 2}
    assert half.exit_code == 4  # the end of its session is missing
    full_disk["left"] = 4
    went_on = run(*command)
    assert went_on.exit_code == 0
    assert "went on after 2 scans of an earlier run" in went_on.stderr
    assert full_disk["left"] == 2  # the first two are not written again
    whole = run("verify", out, "--key", key, "--json")
    assert (whole.exit_code, json.loads(whole.stdout)["num_frames"]) == (0, 4)
    assert (out / "calib.txt").is_file()
    again = run(*command)  # a session that has ended is no beginning
    assert isinstance(again.exception, InputError)
    assert str(again.exception).startswith(f"-o: {out} exists already; replace=True")


@pytest.mark.parametrize("other", ["key", "sensor", "embedding", "drive", "shine", "times"])
def test_a_drive_goes_on_with_its_own_session_only(
    key: Path, drive: Path, tmp_path: Path, full_disk: dict[str, int], other: str
) -> None:
    out = tmp_path / "signed"
    assert run("embed", drive, "--key", key, "-o", out).exit_code == 1
    full_disk["left"] = 9
    options: list[object] = []
    if other == "key":
        key = tmp_path / "other.key"
        run("keygen", key)
    elif other == "sensor":
        options = ["--sensor", "roof"]
    elif other == "embedding":
        options = ["--embedding", "qim"]
    elif other == "drive":
        scan(9).write(drive / "velodyne_points" / "data" / "0000000000.bin")
    elif other == "shine":
        brighter = scan(0).replace(intensity=np.full(8000, 0.5, np.float32))
        brighter.write(drive / "velodyne_points" / "data" / "0000000000.bin")
    else:
        (drive / "velodyne_points" / "timestamps.txt").unlink()
        told = (f"2012-09-26 13:02:25.{n}94360375\n" for n in range(4))
        (drive / "velodyne_points" / "timestamps.txt").write_text("".join(told))
    refused = run("embed", drive, "--key", key, "-o", out, *options)
    assert "exists already" in str(refused.exception)
    assert run("embed", drive, "--key", key, "-o", out, "--force", *options).exit_code == 0
    assert run("verify", out, "--key", key).exit_code == 0


def test_a_drive_in_pictures_goes_on_where_its_last_scan_was_cut_off(
    key: Path, drive: Path, tmp_path: Path, full_disk: dict[str, int]
) -> None:
    Image = pytest.importorskip("PIL.Image")
    pictures = drive / "image_02" / "data"
    pictures.mkdir(parents=True)
    for number in range(4):
        grey = np.random.default_rng(number).integers(0, 256, (160, 160)).astype(np.uint8)
        Image.fromarray(grey).save(pictures / f"{number:010d}.png")
    out = tmp_path / "signed"
    full_disk["left"] = 3
    command = ("embed", drive, "--key", key, "-o", out, "--picture", "image_02")
    assert run(*command).exit_code == 1
    (out / "image_02" / "data" / "0000000002.png").unlink()  # as a kill between the two leaves it
    full_disk["left"] = 9
    went_on = run(*command)
    assert "went on after 2 scans" in went_on.stderr
    assert run("verify", out, "--key", key, "--picture", "image_02").exit_code == 0


def test_scans_that_would_replace_each_other_are_refused(
    key: Path, drive: Path, tmp_path: Path
) -> None:
    first, second = frame_of(drive, 0), frame_of(drive, 0).with_name("0000000000.bin.xz")
    second.write_bytes(lzma.compress(frame_of(drive, 1).read_bytes()))
    out = tmp_path / "signed"
    refused = run("embed", drive, "--key", key, "-o", out)
    assert isinstance(refused.exception, InputError)
    assert f"{first} and {second}: expected an output for each" in str(refused.exception)
    second.rename(first.with_name("0000000000.pcd"))
    (drive / "image_02").mkdir()
    refused = run("embed", drive, "--key", key, "-o", out, "--picture", "image_02")
    assert f"got {out / 'image_02' / '0000000000.png'} for both" in str(refused.exception)
    assert not out.exists()


def test_scans_named_by_times_have_a_picture_each(key: Path, tmp_path: Path) -> None:
    Image = pytest.importorskip("PIL.Image")
    drive, out = tmp_path / "drive", tmp_path / "signed"
    (drive / "velodyne").mkdir(parents=True)
    (drive / "image_02").mkdir()
    for number, suffix in enumerate((".bin", ".bin.xz")):
        name = f"1317013345.{number}00"
        scan(number).write(drive / "velodyne" / f"{name}.bin")
        if suffix == ".bin.xz":
            plain = drive / "velodyne" / f"{name}.bin"
            plain.with_name(f"{name}.bin.xz").write_bytes(lzma.compress(plain.read_bytes()))
            plain.unlink()
        grey = np.random.default_rng(number).integers(0, 256, (160, 160)).astype(np.uint8)
        Image.fromarray(grey).save(drive / "image_02" / f"{name}.png")
    done = run("embed", drive, "--key", key, "-o", out, "--picture", "image_02")
    assert done.exit_code == 0, done.output
    assert verify(out, key, "--picture", "image_02")[0] == 0
    watched = manip3d.datasets.watched_kitti(out, records=True, carriers=out / "image_02")
    assert [moment.carrier is not None for moment in watched.moments] == [True, True]


def test_what_was_written_is_told_with_the_error(
    key: Path, drive: Path, tmp_path: Path, full_disk: dict[str, int],
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(Terminal, "has_answered", False)  # of other tests' commands
    out = tmp_path / "signed"
    with pytest.raises(SystemExit) as ended:
        main(["watermark", "embed", str(drive), "--key", str(key), "-o", str(out), "--json"])
    told = capsys.readouterr()
    assert ended.value.code == 1
    assert "No space left on device; " in told.err
    assert "has 2 of 4 scans, each whole" in told.err
    assert "has 2 of 4 scans" in json.loads(told.out)["error"]["message"]


def test_only_a_last_record_of_the_own_key_is_gone_on_after(key: Path, tmp_path: Path) -> None:
    with KeyFile(key) as secret, KeyFile.create(tmp_path / "other.key") as other:
        first = Watermarker(secret)
        sent = first.embed(scan(0))
        last = first.embed(scan(1), is_end=True)
        with pytest.raises(InputError, match="before the first frame"):
            first.resume(sent.record)
        with pytest.raises(FormatError, match="of another key or sensor"):
            Watermarker(other).resume(sent.record)
        with pytest.raises(FormatError, match="of another key or sensor"):
            Watermarker(secret, sensor="roof").resume(sent.record)
        with pytest.raises(InputError, match="same embedding and grid"):
            Watermarker(secret, embedding="qim").resume(sent.record)
        with pytest.raises(InputError, match="its session has ended"):
            Watermarker(secret).resume(last.record)
        for damaged in (b"", sent.record[:-1], bytes(len(sent.record))):
            with pytest.raises(FormatError):
                Watermarker(secret).resume(damaged)
        second = Watermarker(secret)
        second.resume(sent.record)
        assert second.session == first.session
        assert second.embed(scan(1), is_end=True, time_ns=7).number == 1
