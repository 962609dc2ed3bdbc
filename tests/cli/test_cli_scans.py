"""``info``, ``convert`` and ``view`` on scans and recordings."""

from __future__ import annotations

import csv
import json
import os
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from command_line import manip3d
from manip3d import Intrinsics, LidarFrame, RgbdCalibration, RgbdFrame, capture, simulate
from manip3d.datasets import open_kitti
from manip3d.io import read_range_grid, read_scan
from velodyne_packets import block, ethernet, packet, pcap, seen_turns, udp_frame

ALONE = ("--jobs", 1)
"""Without processes for several files, each of which takes longer to start than the files."""


def run(*arguments: object, code: int = 0) -> str:
    done = manip3d(*map(str, arguments))
    assert done.returncode == code, done.stderr
    return done.stdout if code == 0 else done.stderr


def scan(num_points: int = 300) -> LidarFrame:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(num_points, 3)) * 10
    points[0] = 0
    return LidarFrame(points, rng.random(num_points).astype(np.float32))


def recording(path: Path) -> Path:
    """Two and a half turns of a VLP-16, and a packet that is none."""
    frames = []
    for start in range(0, 90000, 480):
        blocks = [block(start + 40 * b, [1000 + b] * 32) for b in range(12)]
        frames.append(ethernet(udp_frame(packet(blocks, product=0x22))))
    path.write_bytes(pcap([*frames, ethernet(udp_frame(b"noise"))], step=0.001))
    return path


def test_info_of_a_scan(tmp_path: Path) -> None:
    scan().write(tmp_path / "a.pcd")
    (told,) = json.loads(run("info", tmp_path / "a.pcd", "--json"))["scans"]
    assert (told["format"], told["points"], told["no_return"], told["dropped"]) == (
        "pcd",
        300,
        1,
        0,
    )
    assert told["origin"] == [0.0, 0.0, 0.0]
    assert np.allclose(told["bounds"][1], scan().points[1:].max(axis=0))
    assert "300" in run("info", tmp_path / "a.pcd")


def test_a_table_of_scans_and_depth_images_has_their_counts(tmp_path: Path) -> None:
    scan().write(tmp_path / "a.pcd")
    scan(20).write(tmp_path / "b.bin")
    depth = np.zeros((4, 5), np.uint16)
    depth[1:3, 1:] = [[1000, 1500, 2000, 2500]] * 2
    Image.fromarray(depth).save(tmp_path / "c.png")
    named = [tmp_path / name for name in ("a.pcd", "b.bin", "c.png")]
    wrong = manip3d("info", named[2], "--unit", "nan")
    assert "error: --unit: expected guess, mm, " in wrong.stderr
    header, *rows = run("info", *named, "--unit", "mm", *ALONE).splitlines()
    assert header.split() == ["source", "format", "points", "pixels", "measured", "frames", "range"]
    told = [row.split() for row in rows]
    assert [row[1:-1] for row in told] == [["pcd", "300", "1"], ["kitti", "20", "1"], ["20", "8"]]
    assert told[2][-1] == "1..2.5"

    run("info", *named, "--unit", "mm", "--table", tmp_path / "t.csv", *ALONE)
    with (tmp_path / "t.csv").open(encoding="utf-8") as file:
        first, *_, last = csv.DictReader(file)
    assert (first["points"], first["frames"], first["format"]) == ("300", "1", "pcd")
    points = scan().points[1:]
    low, high = ([float(first[f"bounds.{end}.{i}"]) for i in range(3)] for end in (0, 1))
    assert np.allclose([low, high], [points.min(axis=0), points.max(axis=0)])
    assert (last["pixels"], last["range.0"], last["range.1"]) == ("20", "1.0", "2.5")


def test_the_counts_of_a_recording_are_those_of_all_frames(tmp_path: Path) -> None:
    told = json.loads(run("info", recording(tmp_path / "drive.pcap"), "--json"))
    assert told["frames"] == len(told["scans"])
    assert told["points"] == sum(each["points"] for each in told["scans"])
    assert told["range"][1] == max(each["range"][1] for each in told["scans"])


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (("--max-points", 299), "300 points, more than max_points = 299"),
        (("--max-bytes", 1000), "max_bytes = 1000"),
        (("--max-seconds", 1e-9), "reading takes more than max_seconds = 1e-09"),
    ],
)
def test_limits_of_readers_hold_for_every_verb(
    tmp_path: Path, limit: tuple[str, float], words: str
) -> None:
    scan().write(tmp_path / "many.pcd")
    said = run(*limit, "info", tmp_path / "many.pcd", code=1)
    assert words in said
    LidarFrame(np.zeros((2, 3))).write(tmp_path / "few.pcd")
    done = manip3d(*limit, "info", tmp_path, "--jobs", "2", "--json")
    assert done.returncode == 1
    few, many = json.loads(done.stdout)
    assert words in many["error"]
    assert (few["error"] == "") == (limit[0] != "--max-seconds")
    assert run("info", tmp_path / "many.pcd")


def test_a_limit_is_more_than_nothing(tmp_path: Path) -> None:
    assert "--max-seconds: expected > 0" in run("--max-seconds", 0, "info", tmp_path, code=1)
    assert manip3d("--max-points", "0", "info", tmp_path).returncode == 2


def test_info_of_a_recording(tmp_path: Path) -> None:
    path = recording(tmp_path / "a.pcap")
    told = json.loads(run("info", path, "--json"))
    assert [s["is_complete"] for s in told["scans"]] == [False, True, False]
    assert {s["model"] for s in told["scans"]} == {"vlp16"}
    assert told["counters"]["bad_length"] == 1
    assert told["counters"]["points"] == sum(s["points"] for s in told["scans"])
    assert "bad length 1" in run("info", f"pcap:{path}")


def test_lost_packets_are_told(tmp_path: Path) -> None:
    packets = seen_turns(0, 360)
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap(ethernet(udp_frame(each)) for each in packets))
    done = manip3d("convert", path, "-o", tmp_path / "whole")
    assert (done.returncode, "loss" in done.stderr) == (0, False), done.stderr
    del packets[300]
    path.write_bytes(pcap(ethernet(udp_frame(each)) for each in packets))
    done = manip3d("convert", path, "-o", tmp_path / "cut")
    assert done.returncode == 0, done.stderr
    assert f"pcap:{path}: scans have gaps, because 1 packet was lost\n" in done.stderr
    assert "lost packets 1" in run("info", path)


def test_ply_with_faces_is_a_mesh(tmp_path: Path) -> None:
    from manip3d.simulate import models

    models.airplane(4000).write(tmp_path / "mesh.ply")
    scan().write(tmp_path / "scan.ply.xz")
    assert "faces" in run("info", tmp_path / "mesh.ply")
    assert "scans" in json.loads(run("info", tmp_path / "scan.ply.xz", "--json"))
    assert "No such file" in run("info", tmp_path / "none.ply", code=1)


def test_several_texts_become_other_scans_and_back(tmp_path: Path) -> None:
    """Folders are not searched for texts, so that their suffixes have to be known by name."""
    for name in ("a.csv", "b.txt"):
        scan().write(tmp_path / name)
    texts = (tmp_path / "a.csv", tmp_path / "b.txt")
    run("convert", *texts, "--to", ".xyz", "-o", tmp_path / "xyz", *ALONE)
    assert sorted(path.name for path in (tmp_path / "xyz").glob("*.xyz")) == ["a.xyz", "b.xyz"]
    run("convert", tmp_path / "xyz", "--to", ".csv", "-o", tmp_path / "csv", *ALONE)
    assert np.array_equal(read_scan(tmp_path / "csv" / "b.csv").points, scan().points)


def test_convert(tmp_path: Path) -> None:
    scan().write(tmp_path / "a.bin")
    run("convert", tmp_path / "a.bin", "-o", tmp_path / "b.pcd")
    assert np.array_equal(read_scan(tmp_path / "b.pcd").points, scan().points)
    assert "exists already" in run("convert", tmp_path / "a.bin", "-o", tmp_path / "b.pcd", code=1)
    run("convert", tmp_path / "a.bin", "-o", tmp_path / "c.pcd", "--up", "z", code=2)
    scan().replace(fields={"red": np.arange(300.0)}).write(tmp_path / "red.ply")
    done = manip3d("convert", str(tmp_path / "red.ply"), "-o", str(tmp_path / "red.bin"))
    assert "red left out" in done.stderr
    shutil.copy(tmp_path / "red.ply", tmp_path / "red2.ply")  # one line for both files
    done = manip3d(
        "convert", str(tmp_path / "red.ply"), str(tmp_path / "red2.ply"),
        "-o", str(tmp_path / "bins"), "--to", ".bin", "--jobs", "1",
    )  # fmt: skip
    told = "and 1 more file: warning: red left out, which .bin does not hold\n"
    assert f"{tmp_path / 'red2.ply'} {told}" in done.stderr
    assert "expected a name that ends in .pcd.bin" in run(
        "convert", tmp_path / "a.bin", "-o", tmp_path / "c.obj", code=1
    )


def test_convert_tells_that_a_grid_is_not_kept(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(1, 2, (6, 8, 3)).astype(np.float32)
    points[2, 3] = np.nan
    np.save(tmp_path / "a.npy", points)
    done = manip3d("convert", str(tmp_path / "a.npy"), "-o", str(tmp_path / "a.xyz"))
    assert "the cloud's grid of 8 x 6 pixels is not kept in .xyz" in done.stderr
    done = manip3d("convert", str(tmp_path / "a.npy"), "-o", str(tmp_path / "a.pcd"))
    assert "not kept" not in done.stderr
    assert np.array_equal(read_range_grid(tmp_path / "a.pcd").valid, ~np.isnan(points[..., 0]))


def test_the_help_of_convert_names_what_it_takes() -> None:
    words = " ".join(manip3d("convert", "--help").stdout.replace("\u2502", " ").split())
    assert "A mesh, a scan or a recording of a LiDAR" in words
    assert "depth image" not in words


def test_a_recording_becomes_a_drive(tmp_path: Path) -> None:
    path = recording(tmp_path / "a.pcap")
    run("convert", path, "-o", tmp_path / "drive")
    drive = open_kitti(tmp_path / "drive")
    assert [f.name for f in drive] == ["000000", "000001", "000002"]
    assert drive[0].time_ns == 1000 * 10**9
    assert drive[1].scan().num_points == 75 * 384
    told = json.loads(run("info", tmp_path / "drive", "--json"))
    assert [s["points"] for s in told["scans"]] == [f.scan().num_points for f in drive]
    assert told["counters"] == {"frames": 3, "points": 188 * 384, "skipped": 0}
    source = capture.open(f"kitti:{tmp_path / 'drive'}")
    assert [frame.time_ns for frame in source] == [f.time_ns for f in drive]
    assert "3 scans, and .bin one: name a folder" in run(
        "convert", path, "-o", tmp_path / "a.bin", code=1
    )


def test_a_drive_that_is_replaced_holds_no_scan_of_the_earlier_one(tmp_path: Path) -> None:
    drive = tmp_path / "drive"
    run("convert", recording(tmp_path / "a.pcap"), "-o", drive)
    (drive / "velodyne" / "notes.txt").write_text("kept")
    scan().write(tmp_path / "a.bin")  # a scan without a time
    done = manip3d("convert", str(tmp_path / "a.bin"), "-o", str(drive), "--force")
    assert f"wrote 1 scan to {drive}{os.sep}" in done.stderr
    assert "removed 2 scans of an earlier run" in done.stderr
    assert sorted(p.name for p in drive.iterdir()) == ["velodyne"]
    assert sorted(p.name for p in (drive / "velodyne").iterdir()) == ["000000.bin", "notes.txt"]


@pytest.mark.parametrize("name", ["0000000007.bin", "one.bin"])
def test_scans_that_no_run_wrote_are_neither_removed_nor_mixed(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "drive" / "velodyne"
    folder.mkdir(parents=True)
    scan().write(folder / name)
    (folder.parent / "times.txt").write_text("0.0\n")
    scan().write(tmp_path / "a.bin")
    said = run("convert", tmp_path / "a.bin", "-o", folder.parent, "--force", code=1)
    assert "expected no scans in velodyne with names other than 000000.bin" in said
    assert [p.name for p in folder.iterdir()] == [name]
    assert (folder.parent / "times.txt").is_file()


def test_scans_beside_a_drive_are_converted_into_it(tmp_path: Path) -> None:
    folder = tmp_path / "drive" / "velodyne"
    folder.mkdir(parents=True)
    scan().write(folder / "a.pcd")
    run("convert", folder / "a.pcd", "-o", folder.parent, "--force")
    assert sorted(p.name for p in folder.iterdir()) == ["000000.bin", "a.pcd"]


@pytest.mark.parametrize("source", ["drive", "kitti:drive", "drive/velodyne/000100.bin"])
def test_a_drive_is_not_converted_within_its_own_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    """Scans whose numbers are higher than those of the result would be removed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "drive" / "velodyne").mkdir(parents=True)
    scan().write(tmp_path / "drive" / "velodyne" / "000100.bin")
    said = run("convert", source, "-o", "drive", "--force", code=1)
    assert "expected another folder, because the scans would be replaced" in said
    assert (tmp_path / "drive" / "velodyne" / "000100.bin").is_file()


def test_view_writes_a_picture(tmp_path: Path) -> None:
    pytest.importorskip("pyvista")
    scan().write(tmp_path / "a.bin")
    run("view", tmp_path / "a.bin", "-o", tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def test_a_folder_of_exported_clouds_is_inspected(tmp_path: Path) -> None:
    """Tables that hold no points are passed over."""
    points = np.random.default_rng(0).normal(0.0, 9.0, (50, 3)).astype(np.float32)
    for name in ("a.csv", "b.npy"):
        LidarFrame(points).write(tmp_path / name)
    (tmp_path / "notes.csv").write_text("name,value\na,1\n")
    rows = json.loads(run("inspect", tmp_path, "--json", "--policy", "undecidable=0", *ALONE))
    assert [Path(row["source"]).name for row in rows] == ["a.csv", "b.npy"]


def test_a_name_that_is_not_utf_8_gets_its_page(tmp_path: Path) -> None:
    folder = tmp_path / os.fsdecode(b"drive\xe9") / "velodyne"
    folder.mkdir(parents=True)
    path = folder / os.fsdecode(b"caf\xe9.bin")
    scan().write(path)
    run("inspect", path, "-o", tmp_path / "scan.html", *ALONE, code=4)
    assert "caf\\udce9.bin" in (tmp_path / "scan.html").read_text(encoding="utf-8")
    scan().write(path.rename(folder / "0.bin").with_name("1.bin"))
    run("inspect", folder.parent, "-o", tmp_path / "drive.html", *ALONE, code=4)
    assert "drive\\udce9" in (tmp_path / "drive.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("verb", "name"),
    [
        *(("info", "a.bin"), ("convert", "a.bin"), ("view", "a.bin"), ("inspect", "a.bin")),
        *(("info", "a.ply"), ("convert", "a.ply"), ("view", "a.ply")),
    ],
)
def test_a_calibration_of_lasers_is_for_packets(verb: str, name: str, tmp_path: Path) -> None:
    source = tmp_path / name
    (simulate.models.floor() if name == "a.ply" else scan()).write(source)
    output = () if verb == "info" else ("-o", tmp_path / "out.html")
    done = manip3d(verb, source, "--calibration", tmp_path / "lasers.xml", *output)
    assert done.returncode == 1
    assert "--calibration: can only be given with a" in done.stderr


def test_coordinates_of_a_map_that_are_lost_are_told(tmp_path: Path) -> None:
    rows = [f"{458_000 + i % 7} {5_428_000 + i % 5} {110 + i % 3}\n" for i in range(50)]
    (tmp_path / "a.xyz").write_text("".join(rows))
    for name in ("b.bin", "b.3d", "b.csv", "b.xyz", "b.pcd", "b.ply"):
        done = manip3d("convert", tmp_path / "a.xyz", "-o", tmp_path / name)
        assert done.returncode == 0, done.stderr
        assert ("those of the map are 4580" in done.stderr) == (name in ("b.bin", "b.3d"))
        assert ("which PCL and Open3D do not read" in done.stderr) == (name == "b.pcd")


def test_columns_that_a_forgery_or_a_signed_scan_loses_are_told(tmp_path: Path) -> None:
    frame = scan().replace(ring=np.arange(300, dtype=np.uint16) % 32)
    frame.write(tmp_path / "a.pcd")
    key = tmp_path / "a.key"
    run("watermark", "keygen", key)
    for order in (
        ("convert",),
        ("forge", "lidar", "deform", "--box", 0, 0, 0, 90, 90, 90, 0),
        ("watermark", "embed", "--key", key, "--embedding", "detached"),
    ):
        for name, lost in (("b.bin", True), ("b.ply", False)):
            done = manip3d(*order, tmp_path / "a.pcd", "-o", tmp_path / name, "--force")
            assert done.returncode == 0, done.stderr
            assert ("ring left out, which .bin does not hold" in done.stderr) == lost, order


def test_coordinates_that_are_rounded_are_told(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-90, 90, (300, 3)).astype(np.float32)
    LidarFrame(points).write(tmp_path / "fine.pcd")
    LidarFrame(np.round(points, 3)).write(tmp_path / "whole.pcd")
    for source, target, rounded in (
        ("fine.pcd", "a.las", True),
        ("fine.pcd", "a.laz", True),
        ("fine.pcd", "a.ply", False),
        ("whole.pcd", "b.las", False),
        ("a.las", "c.las", False),
    ):
        done = manip3d("convert", tmp_path / source, "-o", tmp_path / target)
        assert done.returncode == 0, done.stderr
        assert ("coordinates are rounded to 0.1 mm" in done.stderr) == rounded, (source, target)


def test_an_output_of_another_option_is_named_by_it(tmp_path: Path) -> None:
    np.zeros((9, 4), np.float32).tofile(tmp_path / "a.bin")
    done = manip3d("inspect", tmp_path / "a.bin", "--rows", tmp_path / "rows.txt")
    assert done.returncode == 1
    assert (
        f"error: --rows {tmp_path / 'rows.txt'}: expected a name that ends in .csv" in done.stderr
    )


def test_several_recordings_that_are_folders_are_one_source_each(tmp_path: Path) -> None:
    """Their images were listed one by one, and inspect found no scans in them."""
    camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    for name in ("a", "b"):
        depth = np.full((48, 64), 2000, np.uint16)
        frames = [RgbdFrame(depth, camera, time_ns=n * 33_000_000, number=n) for n in range(3)]
        capture.record(frames, tmp_path / name)
    both = (tmp_path / "a", tmp_path / "b")
    rows = json.loads(run("info", *both, "--json", *ALONE))
    assert [(row["source"], row["frames"]) for row in rows] == [(str(path), 3) for path in both]
    rows = json.loads(manip3d("inspect", *both, "--json", "--jobs", "1").stdout)
    assert [row["source"] for row in rows] == list(map(str, both))
    run("view", *both, "-o", tmp_path / "pages", "--to", ".html", *ALONE)
    assert sorted(path.name for path in (tmp_path / "pages").glob("*.html")) == ["a.html", "b.html"]


def test_recordings_in_a_folder_are_one_source_each(tmp_path: Path) -> None:
    """Their folder was "72 depth images", and the truth beside a forgery a damaged one."""
    camera = RgbdCalibration(Intrinsics(fx=60, fy=60, cx=31.5, cy=23.5, width=64, height=48))
    day = tmp_path / "day"
    for name in ("a", "more/b", ".trash/c"):
        depth = np.full((48, 64), 2000, np.uint16)
        frames = [RgbdFrame(depth, camera, time_ns=n * 33_000_000, number=n) for n in range(3)]
        (day / name).parent.mkdir(parents=True, exist_ok=True)
        capture.record(frames, day / name)
    np.savez(day / "a.truth.npz", masks=np.zeros((3, 4)), kind=1)
    (day / "bag").mkdir()
    (day / "bag" / "metadata.yaml").write_text("damaged")
    places = [str(day / name) for name in ("a", "more/b")]
    rows = json.loads(manip3d("inspect", day, "--json", "--jobs", "1").stdout)
    assert [row["source"] for row in rows] == [places[0], str(day / "bag"), places[1]]
    assert "the bag cannot be read" in rows[1]["error"]
    shutil.rmtree(day / "bag")
    for verb in (("info",), ("capture", "info")):
        rows = json.loads(run(*verb, day, "--json", *ALONE))
        assert [(row["source"], row["frames"]) for row in rows] == [(place, 3) for place in places]
    run("view", day, "-o", tmp_path / "pages", "--to", ".html", *ALONE)
    pages = {str(path.relative_to(tmp_path / "pages")) for path in tmp_path.rglob("*.html")}
    assert pages == {"a.html", "more/b.html"}
    forging = ("forge", "stream", day, "--type", "1", "-o", tmp_path / "forged")
    done = manip3d(*forging, "--json", "--jobs", "1")
    assert [row["source"] for row in json.loads(done.stdout)] == places


def test_info_names_the_unit_of_a_survey_in_feet(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales = np.full(3, 0.01)
    keys = struct.pack("<8H", 1, 1, 0, 1, 3076, 0, 1, 9003)
    header.vlrs.append(laspy.vlrs.VLR(user_id="LASF_Projection", record_id=34735, record_data=keys))
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.random.default_rng(0).uniform(0, 90, (3, 50))
    las.write(str(tmp_path / "survey.las"))
    said = run("info", tmp_path / "survey.las")
    assert said.count("feet") >= 1
    assert "metres" not in said
    told = json.loads(run("info", tmp_path / "survey.las", "--json"))
    assert told["unit"] == "feet"
    found = manip3d("inspect", tmp_path / "survey.las", "--json")
    assert found.returncode == 4
    assert "in feet" in json.loads(found.stdout)["reason"]


def test_helps_promise_no_more_than_is_done() -> None:
    """Scans change their coordinates in E57 and PTX, and two edits are only examples."""
    convert = " ".join(run("convert", "--help").split())
    assert "Coordinates of meshes change only with --unit or --up." in convert
    assert ".e57 and .ptx hold points relative to the scanner" in convert
    assert "These two edits of a drive have no remark" in " ".join(run("inspect", "--help").split())
