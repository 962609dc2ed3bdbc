"""``manip3d inspect`` of drives and of packets: a line a scan, and the gravest verdict."""

from __future__ import annotations

import functools
import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import command_line
import lattice_scans as scans
import manip3d
import turn_scans
from manip3d import InputError, authenticate, report
from manip3d.capture._past_errors import past_errors
from manip3d.cli.inspect import _code_of_rows
from manip3d.report._drive_evidence import scanner_poses
from real_data import RealData
from velodyne_packets import ethernet, pcap, udp_frame

LATTICE = scans.lattice()
SCANS = Path("velodyne_points") / "data"


run = functools.partial(command_line.run, "inspect")


def street(seed: int) -> manip3d.LidarFrame:
    points = scans.scan(np.random.default_rng(seed))
    reading = LATTICE.read(points)
    row = np.flatnonzero(reading.ring == 0)[100:101]  # something far
    beam = scans.beam_points(LATTICE, reading.ring[row], reading.count[row], np.full(1, 79.0))
    points[row] = scans.rounded(beam)
    return manip3d.LidarFrame(points, scans.reflectances(points))


def with_moved_object(frame: manip3d.LidarFrame) -> manip3d.LidarFrame:
    points = frame.points.copy()
    rows = np.all(np.abs(points - [12.0, 3.0, -0.9]) < [3.0, 1.0, 0.6], axis=1)
    points[rows] = np.round((points[rows] + np.float32([1.3, 0.7, 0.0])) * 1000) / 1000
    return frame.replace(points=points)


@pytest.fixture(scope="module")
def frames() -> list[manip3d.LidarFrame]:
    return [street(5), with_moved_object(street(6)), street(7)]


@pytest.fixture
def drive(tmp_path: Path, frames: list[manip3d.LidarFrame]) -> Path:
    folder = tmp_path / "drive"
    (folder / SCANS).mkdir(parents=True)
    for number, frame in enumerate(frames):
        frame.write(folder / SCANS / f"{number:010d}.bin")
    LATTICE.save(tmp_path / "lattice.json")
    return folder


def test_a_drive_is_a_line_a_scan_and_a_table(drive: Path, tmp_path: Path) -> None:
    lattice = ("--lattice", tmp_path / "lattice.json")
    done = run(drive, *lattice, "-q", "--log", tmp_path / "case.jsonl")
    assert done.exit_code == 3, done.output
    lines = done.stdout.splitlines()
    assert [line.split()[:2] for line in lines[:3]] == [
        ["0000000000.bin", "no_trace"], ["0000000001.bin", "tampered"],
        ["0000000002.bin", "no_trace"],
    ]  # fmt: skip
    assert lines[-1].startswith(
        "tampered: 1 of 3 scans accused (number 1): in number 1, points lie where the sensor "
        "cannot measure; of clean drives as long 1.1% at most are called so"
    )
    log = report.read_log(tmp_path / "case.jsonl")
    assert [entry["verdict"] for entry in log] == ["no_trace", "tampered", "no_trace", "tampered"]
    assert all(len(entry["source_sha256"]) == 64 for entry in log[:3])
    assert (log[3]["source"], log[3]["scans"], log[3]["accused"]) == (str(drive), 3, [1])
    assert log[3]["source_sha256"] == manip3d.datasets.folder_sha256(drive)

    asked = run(drive, *lattice, "--json", "-q", "-o", tmp_path / "found.json")
    whole = json.loads(asked.stdout)
    assert asked.exit_code == 3
    assert whole["verdict"] == "tampered"
    assert whole["reason"] in lines[-1]
    assert (whole["scans"], whole["failed"]) == (3, 0)
    assert (whole["accused_scans"], whole["accused"]) == (1, [1])
    assert whole["evidence"]["judged"] == 3
    assert whole["evidence"]["alarms"] == []
    found = whole["frames"]
    assert [each["frame"] for each in found] == [f"{n:010d}.bin" for n in range(3)]
    assert found[1]["regions"]
    assert json.loads((tmp_path / "found.json").read_text()) == whole
    assert run(drive, *lattice, "-q", "--policy", "tampered=9").exit_code == 9


def test_several_drives_are_judged_as_a_whole_each(drive: Path, tmp_path: Path) -> None:
    """Their scans were listed one by one, without their neighbours."""
    other = drive.parent / "more" / "other"
    shutil.copytree(drive, other)
    (other / SCANS / "0000000001.bin").unlink()
    options = ("--lattice", tmp_path / "lattice.json", "--jobs", 1, "--json", "-q")
    for sources in ((drive, other), (tmp_path,)):
        done = run(*sources, *options)
        assert done.exit_code == 3, done.output
        rows = json.loads(done.stdout)
        assert [row["source"] for row in rows] == [str(drive), str(other)]
        assert [row["verdict"] for row in rows] == ["tampered", "no_trace"]
        assert [row["scans"] for row in rows] == [3, 2]


def test_a_policy_can_act_on_remarks(drive: Path, tmp_path: Path) -> None:
    lattice = ("--lattice", tmp_path / "lattice.json", "-q")
    quiet = "tampered=0,processed=0,undecidable=0"
    last = (drive / SCANS / "0000000002.bin").rename(tmp_path / "last.bin")
    assert run(drive, *lattice, "--policy", f"{quiet},remarks=7").exit_code == 0
    last.rename(drive / SCANS / "0000000005.bin")  # three scans are missing before it
    assert run(drive, *lattice, "--policy", quiet).exit_code == 0
    assert run(drive, *lattice, "--policy", f"{quiet},remarks=7").exit_code == 7
    assert run(drive, *lattice, "--policy", "remarks=7").exit_code == 3
    row = {"source": "one.pcap", **json.loads(run(drive, *lattice, "--json").stdout)}
    row["verdict"] = "no_trace"
    assert _code_of_rows([row], {"policy": "remarks=7"}) == 7
    assert _code_of_rows([row, {"verdict": "tampered"}], {"policy": "remarks=7"}) == 3
    assert _code_of_rows([row], {"policy": ""}) == 0
    unread = [row, {"source": "two.pcap", "error": "cut"}, {"verdict": "tampered"}]
    assert _code_of_rows(unread, {"policy": "tampered=0,remarks=7"}) == 1
    assert _code_of_rows(unread, {"policy": "remarks=7"}) == 3


def test_a_drive_is_one_page(drive: Path, tmp_path: Path) -> None:
    page = tmp_path / "drive.html"
    (drive / SCANS / "0000000003.bin").write_bytes(b"<no scan>")
    done = run(drive, "--lattice", tmp_path / "lattice.json", "-q", "-o", page)
    assert done.exit_code == 3, done.output  # tampering outranks the scan that cannot be read
    text = page.read_text()
    assert text.count("<rect") == 4
    for part in ("0000000001.bin: tampered", "0000000003.bin: not read", "Timeline", "<svg"):
        assert part in text
    assert "script" not in text
    assert "http" not in text
    again = run(drive, "-q", "-o", page)
    assert "--force" in str(again.exception)
    assert page.read_text() == text


def test_the_map_shows_the_way_and_what_is_suspected(tmp_path: Path) -> None:
    clouds = [turn_scans.turn(0.9 * k, 30 + k) for k in range(4)]
    clouds[2] = clouds[2][~turn_scans.box_at(0, 1.8).contains(clouds[2])]
    far = np.float32([[79.0, 0.0, 1.0]])
    scenes = [manip3d.LidarFrame(np.vstack([far, cloud]), origin=(0, 0, 0)) for cloud in clouds]
    found = list(authenticate.inspect_drive(scenes, lattice=turn_scans.LATTICE))
    poses = scanner_poses(found)
    assert all(pose is not None for pose in poses)
    way = np.array([pose[:3, 3] for pose in poses if pose is not None])
    np.testing.assert_allclose(way, [(0.9 * k, 0, 0) for k in range(4)], atol=0.05)
    page = tmp_path / "drive.html"
    report.write_drive_evidence(found, page, names=[f"a & {k}" for k in range(4)])
    text = page.read_text()
    assert text.count("<polyline") == 1
    assert text.count("<polygon") == sum(
        len(each.regions) for each in found if each is not None and each.verdict == "tampered"
    )
    assert "a &amp; 2: tampered" in text
    with pytest.raises(manip3d.InputError, match="names"):
        report.write_drive_evidence(found, page, names=["one"])
    with pytest.raises(manip3d.InputError, match="output"):
        report.write_drive_evidence(found, tmp_path / "x.txt", names=list("abcd"))


def test_the_map_goes_on_where_the_scanner_is_too_fast_to_judge() -> None:
    """At 1.6 m a turn detector IV has no thresholds, but its alignments hold."""
    clouds = [turn_scans.turn(1.6 * k, 30 + k) for k in range(3)]
    scenes = [manip3d.LidarFrame(cloud, origin=(0, 0, 0)) for cloud in clouds]
    found = list(authenticate.inspect_drive(scenes, lattice=turn_scans.LATTICE, power=False))
    middle = found[1]
    assert middle is not None
    assert middle.turns is not None
    assert (middle.turns.verdict, middle.turns.aligned) == ("undecidable", True)
    poses = scanner_poses(found)
    way = np.array([pose[:3, 3] for pose in poses if pose is not None])
    np.testing.assert_allclose(way, [(1.6 * k, 0, 0) for k in range(3)], atol=0.05)
    lost = replace(middle, turns=replace(middle.turns, aligned=False))
    assert scanner_poses([found[0], lost, found[2]])[1] is None


def test_the_verdicts_of_a_drive_do_not_depend_on_threads(
    frames: list[manip3d.LidarFrame],
) -> None:
    mixed: list[manip3d.LidarFrame | None] = [None, *frames, None, *frames]

    def records(threads: int) -> list[object]:
        found = authenticate.inspect_drive(mixed, lattice=LATTICE, threads=threads)
        return [None if each is None else each.record() for each in found]

    one = records(1)
    assert [each is None for each in one] == [each is None for each in mixed]
    assert records(3) == one


def test_an_error_in_a_drive_arrives() -> None:
    bad = manip3d.LidarFrame(np.full((5000, 3), np.float32(1.0)))
    frames = iter([bad, bad, "no frame"])
    found = authenticate.inspect_drive(frames, lattice=LATTICE, threads=2)  # type: ignore[arg-type]
    with pytest.raises(manip3d.InputError):
        list(found)


def test_no_scans_are_a_page(tmp_path: Path) -> None:
    report.write_drive_evidence([], tmp_path / "none.html", names=[])
    assert "There are no scans" in (tmp_path / "none.html").read_text()


def test_a_scan_that_cannot_be_read_is_an_error_and_no_end(drive: Path, tmp_path: Path) -> None:
    (drive / SCANS / "0000000001.bin").write_bytes(b"\0" * 7)
    done = run(drive, "--lattice", tmp_path / "lattice.json", "--json", "-q")
    assert done.exit_code == 1
    found = json.loads(done.stdout)["frames"]
    assert "error" in found[1]
    assert [each.get("verdict") for each in found] == ["no_trace", None, "no_trace"]
    assert json.loads(done.stdout)["failed"] == 1
    assert done.stderr.endswith("manip3d: error: 1 of 3 scans could not be read\n")


def test_tampering_outranks_what_cannot_be_read(drive: Path, tmp_path: Path) -> None:
    (drive / SCANS / "0000000003.bin").write_bytes(b"<no scan>")
    lattice = ("--lattice", tmp_path / "lattice.json", "-q")
    assert run(drive, *lattice).exit_code == 3
    assert run(drive, *lattice, "--policy", "tampered=9").exit_code == 9
    assert run(drive, *lattice, "--policy", "tampered=0").exit_code == 1


def test_packets_of_no_scanner_are_said_to_be_so(tmp_path: Path) -> None:
    """Another maker's packets, for one: their number is told."""
    recording = tmp_path / "a.pcap"
    recording.write_bytes(pcap([ethernet(udp_frame(b"noise"))] * 3))
    done = run(recording, "-q")
    assert done.exit_code == 1
    told = f"{recording}: expected scans, found none; counted: bad length 3"
    assert told in str(done.exception)
    assert "an Ouster's with its JSON file" in str(done.exception)


@pytest.mark.parametrize("verb", ["info", "convert"])
def test_packets_without_a_scan_are_told_by_all_commands(tmp_path: Path, verb: str) -> None:
    recording = tmp_path / "a.pcap"
    recording.write_bytes(pcap([ethernet(udp_frame(b"noise"))] * 3))
    output = ("-o", str(tmp_path / "drive")) if verb == "convert" else ()
    done = command_line.run(verb, recording, *output)
    assert done.exit_code == 1
    assert "found none; counted: bad length 3" in str(done.exception)
    assert not (tmp_path / "drive").exists()


def test_a_recording_that_is_cut_off_keeps_its_verdict(
    frames: list[manip3d.LidarFrame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, page, log = tmp_path / "a.pcap", tmp_path / "a.html", tmp_path / "case.jsonl"
    recording.write_bytes(pcap([]))
    LATTICE.save(tmp_path / "lattice.json")
    whole = 2

    def turns() -> Iterator[manip3d.LidarFrame]:
        yield from frames[:whole]
        raise manip3d.FormatError("expected a packet, the file ends", file=str(recording))

    class Packets:
        counters: Mapping[str, int] = {}
        errors: dict[int, str]

        def past_errors(self) -> Iterator[manip3d.LidarFrame | None]:
            return past_errors(turns(), self.errors, (manip3d.Error,))

    monkeypatch.setattr(
        "manip3d.capture._drive.open_unlabelled", lambda *_, **__: nullcontext(Packets())
    )
    options = ("--lattice", tmp_path / "lattice.json", "-q", "--force", "--log", log)
    done = run(recording, *options, "-o", page)
    assert done.exit_code == 3, done.output
    assert "frame 2: not read" in page.read_text()
    assert report.read_log(log)[-1]["verdict"] == "tampered"
    digest = manip3d.datasets.file_sha256(recording)
    assert [entry["source_sha256"] for entry in report.read_log(log)] == [
        digest
    ] * 4  # two scans, what cannot be read, and the joint verdict
    whole = 1
    done = run(recording, *options, "--json")
    assert done.exit_code == 1
    told = json.loads(done.stdout)
    assert (told["scans"], told["failed"]) == (2, 1)
    assert "the file ends" in told["frames"][1]["error"]
    whole = 0
    assert "the file ends" in str(run(recording, *options).exception)


def test_accused_scans_stand_first_in_the_table(tmp_path: Path) -> None:
    nothing = authenticate.inspect(np.zeros((0, 3), np.float32))
    accused = authenticate.DetectorReport("generic", "tampered", "off the lattice", 9.0, 0.002)
    found = [nothing, replace(nothing, verdict="tampered", detectors=(accused,)), nothing]
    page = tmp_path / "drive.html"
    report.write_drive_evidence(found, page, names=["one", "two", "three"])
    table = page.read_text().partition("Scans of which something is said")[2]
    places = [table.index(f"<td>{name}</td>") for name in ("two", "one", "three")]
    assert places == sorted(places)


def test_the_watermarks_of_a_drive_are_allowed_for(
    frames: list[manip3d.LidarFrame], drive: Path, tmp_path: Path
) -> None:
    lattice = ("--lattice", tmp_path / "lattice.json")
    with (
        authenticate.KeyFile.create(tmp_path / "key") as key,
        authenticate.Watermarker(key) as marker,
    ):
        for number, frame in enumerate(frames):
            path = tmp_path / "signed" / SCANS / f"{number:010d}.bin"
            authenticate.write_watermarked(marker.embed(frame), path)
    signed = tmp_path / "signed"
    bare = run(signed, *lattice, "--json", "-q")
    assert bare.exit_code == 4
    assert {each["verdict"] for each in json.loads(bare.stdout)["frames"]} == {"processed"}
    keyed = run(signed, *lattice, "--key", tmp_path / "key", "--json", "-q")
    found = json.loads(keyed.stdout)["frames"]
    assert [each["verdict"] for each in found] == ["no_trace", "tampered", "no_trace"]
    assert {each["watermark"]["content"] for each in found} == {"intact"}
    one = signed / SCANS / "0000000000.bin"
    assert run(one, *lattice, "--key", tmp_path / "key", "-q").exit_code == 0
    assert run(one, *lattice, "-q").exit_code == 4
    record = authenticate.record_path(one)
    named = run(one, *lattice, "--watermark", record, "--key", tmp_path / "key", "-q")
    assert named.exit_code == 0
    absent = run(one, "--watermark", tmp_path / "absent.wm", "--key", tmp_path / "key", "-q")
    assert isinstance(absent.exception, FileNotFoundError)
    record.unlink()
    assert run(one, *lattice, "--key", tmp_path / "key", "-q").exit_code == 4
    record.mkdir()  # the other scans are judged, and the drive has its verdict
    keyed = run(signed, *lattice, "--key", tmp_path / "key", "--json", "-q")
    assert keyed.exit_code == 3, keyed.output
    verdicts = [each["verdict"] for each in json.loads(keyed.stdout)["frames"]]
    assert verdicts == ["processed", "tampered", "no_trace"]


def test_a_lattice_is_made_and_measured(drive: Path, tmp_path: Path) -> None:
    (drive / SCANS / "0000000001.bin").unlink()  # the one that was edited
    other = tmp_path / "other"
    (other / SCANS).mkdir(parents=True)
    for number in range(3):
        street(8 + number).write(other / SCANS / f"{number:010d}.bin")
    scans = sorted(tmp_path.rglob("*.bin"))
    out = tmp_path / "mine.json"
    made = command_line.run("lattice", *scans[:4], "-o", out, "--planted", "1", "--json", "-q")
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert (told["lasers"], told["steps"], told["range_step"]) == (64, 4000, 0.002)
    assert told["power"]["added"]["share"] == 1.0
    loaded = authenticate.SensorLattice.load(out)
    assert loaded.power["added"].source == "2 clean scans of 0000000000.bin and 3 more"
    same = authenticate.calibrate_lattice([drive, other], most=4, planted=1)
    assert same.power["added"].source == f"2 clean scans of {drive.name} and 1 more"
    assert same.power["added"].planted == 2
    copy = shutil.copy(scans[0], tmp_path / "copy.bin")
    twice = command_line.run("lattice", *scans[:3], copy, "-o", tmp_path / "twice.json")
    told = f"SOURCE: expected different scans; {copy} has the points of {scans[0]}"
    assert str(twice.exception) == told
    with pytest.raises(InputError, match="most: expected at least 4, got 3"):
        authenticate.calibrate_lattice([drive, drive], most=3)
    few = command_line.run("lattice", drive, "-o", tmp_path / "few.json")
    assert "expected at least 4 scans, got 2" in str(few.exception)


@pytest.mark.realdata
def test_a_lattice_is_made_of_a_recording(realdata: RealData, tmp_path: Path) -> None:
    """Its scans have rings, which scans of KITTI's format would lose."""
    recording, out = realdata("lidar/packets/reference/vlp16.pcap"), tmp_path / "mine.json"
    made = command_line.run("lattice", recording, "-o", out, "--planted", "1", "--json", "-q")
    assert made.exit_code == 0, made.output
    assert json.loads(made.stdout)["power"]["added"]["planted"] == 2
    judged = run(recording, "--lattice", out, "--json", "-q")
    verdicts = [each["verdict"] for each in json.loads(judged.stdout)["frames"]]
    assert verdicts == ["no_trace"] * 4 + ["undecidable"]  # the last packet alone


def test_options_of_single_scans_are_refused(drive: Path, tmp_path: Path) -> None:
    for option in ("--previous", "--following", "--watermark", "--rows"):
        done = run(drive, option, tmp_path / "x.csv")
        assert done.exit_code == 1
        assert f"{option}: can only be given with a single scan, got a drive" in str(done.exception)
    scan = drive / SCANS / "0000000000.bin"
    done = run(scan, "--calibration", tmp_path / "db.xml")
    assert "--calibration: can only be given with a recording" in str(done.exception)
    assert "pcap:PATH" in str(run("nothing:here").exception)
    refused = run(drive, "-o", tmp_path / "page.csv")
    assert ".json" in str(refused.exception)


def test_verdicts_of_drives(frames: list[manip3d.LidarFrame], tmp_path: Path) -> None:
    found = list(authenticate.inspect_drive([frames[0], None, frames[1]], lattice=LATTICE))
    assert [each and each.verdict for each in found] == ["no_trace", None, "tampered"]
    assert authenticate.verdict_of_drive(found)[0] == "tampered"
    assert authenticate.verdict_of_drive(found[:2]) == ("undecidable", "1 of 2 scans")
    assert authenticate.verdict_of_drive(found[:1]) == ("no_trace", "1 of 1 scans")
    assert authenticate.verdict_of_drive([]) == ("undecidable", "there are no scans")
    page = tmp_path / "one.html"
    report.write_drive_evidence(found[:1], page, names=["a.bin"], source="drive")
    text = page.read_text()
    assert "<p>drive: 1 scan; 1 no_trace</p>" in text
    assert "scanner of 1 scan: " in text
    with (
        authenticate.KeyFile.create(tmp_path / "key") as key,
        pytest.raises(manip3d.InputError, match="key: can only be given with the records"),
    ):
        authenticate.inspect_drive([], key=key)


def test_only_frames_a_turn_apart_are_neighbours(
    frames: list[manip3d.LidarFrame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[bool, bool]] = []
    real = authenticate.inspect

    def spy(frame: object, left_out: object, **options: object) -> object:
        seen.append((options["previous"] is not None, options["following"] is not None))
        return real(np.zeros((0, 3), np.float32))

    monkeypatch.setattr("manip3d.authenticate._drives.inspect_beside", spy)
    for numbers, expected in (
        (None, [(False, True), (True, True), (True, False)]),
        ([0, 2, 4], [(False, False)] * 3),
        ([5, 6, 9], [(False, True), (True, False), (False, False)]),
        ([2, 1, 0], [(False, False)] * 3),
    ):
        seen.clear()
        assert len(list(authenticate.inspect_drive(frames, numbers=numbers))) == 3
        assert seen == expected
    raw, flat = tmp_path / "raw" / SCANS, tmp_path / "flat" / "velodyne"
    for folder in (raw, flat):
        folder.mkdir(parents=True)
        for number in (3, 4, 6):
            (folder / f"{number:06d}.bin").write_bytes(b"")
    assert authenticate.drive_numbers(tmp_path / "raw") == [3, 4, 6]
    assert authenticate.drive_numbers(tmp_path / "flat") == [0, 2, 4]
    (tmp_path / "flat" / "times.txt").write_text("0\n0.1\n0.3\n")
    assert authenticate.drive_numbers(tmp_path / "flat") == [3, 4, 7]
    times = tmp_path / "flat" / "times.txt"
    times.write_text("0\n0.2\n0.3\n")  # a line for each scan
    assert authenticate.drive_numbers(tmp_path / "flat") == [3, 5, 7]
    times.write_text("".join(f"{time}\n" for time in (0, 0, 0, 0.3, 0.4, 0.5, 0.6)))  # by number
    assert authenticate.drive_numbers(tmp_path / "flat") == [3, 4, 7]
    times.write_text("0\n0.2\n")  # of other scans
    assert authenticate.drive_numbers(tmp_path / "flat") == [3, 4, 6]
    raw_times = tmp_path / "raw" / "velodyne_points" / "timestamps.txt"
    day = "2011-09-26 13:04:32.{}\n"
    raw_times.write_text("".join(day.format(part) for part in ("300000000", "500000001", "6")))
    assert authenticate.drive_numbers(tmp_path / "raw") == [3, 5, 7]
    raw_times.write_text("yesterday\n")
    with pytest.warns(UserWarning, match="line 1: expected a time, got 'yesterday'"):
        assert authenticate.drive_numbers(tmp_path / "raw") == [3, 4, 6]
    # The gap in the times may be before or behind the scan of unknown time.
    for last, expected in ((0.2, [3, 4, 6]), (0.3, [3, 5, 8])):
        times.write_text(f"0\nsoon\n{last}\n")
        with pytest.warns(UserWarning, match="line 2: expected a time, got 'soon'"):
            assert authenticate.drive_numbers(tmp_path / "flat") == expected


@pytest.mark.realdata
def test_packets_are_judged_turn_by_turn(realdata: RealData) -> None:
    done = run(realdata("lidar/packets/reference/vlp16.pcap"), "--json", "-q")
    assert done.exit_code == 4, done.output
    found = json.loads(done.stdout)["frames"]
    assert len(found) > 1
    assert {each["verdict"] for each in found} == {"undecidable"}
    # By its exact lattice, although two of its 16 lasers see less than a twentieth of the turn.
    assert {each["sensor"] for each in found[:-1]} == {"VLP-16"}
    assert found[-1]["sensor"] == "unknown"  # the beginning of a turn, 32 points
