"""``manip3d forge stream`` and ``manip3d inspect`` of recordings, as a user types them."""

from __future__ import annotations

import json
import shutil
import subprocess
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import command_line
from capsule_body import SMALL, frame, pose
from manip3d import InputError, RgbdCalibration, RgbdFrame, authenticate, capture, forge
from manip3d.cli.forge import forge_frames
from manip3d.cli.inspect import inspect_recording
from manip3d.cli.terminal import Terminal
from manip3d.datasets import folder_sha256
from manip3d.forge import _recorded


def manip3d(*arguments: object) -> subprocess.CompletedProcess[str]:
    return command_line.manip3d(*map(str, arguments), COLUMNS="200")


@pytest.fixture
def person(tmp_path: Path) -> Path:
    """A person who stands before a noisy wall for 8 frames."""
    frames = []
    for number in range(8):
        seen = frame(pose(), SMALL, number=number)
        rng = np.random.default_rng(number)
        wall = np.rint(3600 + 20 * rng.standard_normal(seen.depth.shape)).astype(np.uint16)
        wall[rng.random(wall.shape) < 0.003] = 0
        frames.append(replace(seen, depth=np.where(seen.depth > 0, seen.depth, wall)))
    capture.record(frames, tmp_path / "person")
    return tmp_path / "person"


def test_forge_writes_a_recording_and_its_truth(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "forged"
    command = ("forge", "stream", person, "--type", 2, "--pose", person, "-o", out)
    done = manip3d(*command, "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["frames"], record["type"], record["frames_without_person"]) == (8, 2, 0)
    truth = forge.read_stream_truth(tmp_path / "forged.truth.npz")
    assert truth.masks.mean() == pytest.approx(record["forged_share"])
    assert capture.open_rgbd(f"folder:{out}").num_frames == 8
    refused = manip3d(*command)
    assert refused.returncode == 1
    assert "exists already; --force replaces it" in refused.stderr
    assert (tmp_path / "forged.truth.npz").is_file()
    assert manip3d(*command, "--force", "-q").returncode == 0


@pytest.mark.parametrize("scheme", ["folder", "mkv", "tum"])
def test_the_truth_lies_beside_a_recording_with_a_scheme(
    scheme: str, person: Path, tmp_path: Path
) -> None:
    place = tmp_path / ("forged.mkv" if scheme == "mkv" else "forged")
    command = ("forge", "stream", person, "--type", 1, "-o", f"{scheme}:{place}", "-q")
    done = manip3d(*command)
    assert done.returncode == 0, done.stderr
    truth = place.with_name(f"{place.name}.truth.npz")
    assert sorted(tmp_path.iterdir()) == sorted([person, place, truth])
    assert forge.read_stream_truth(truth).masks.any()
    assert capture.open_rgbd(f"{scheme}:{place}").num_frames == 8
    assert "exists already; --force replaces it" in manip3d(*command).stderr
    assert manip3d(*command, "--force").returncode == 0


def test_poses_without_a_skeleton_are_named(person: Path, tmp_path: Path) -> None:
    frames = capture.open_rgbd(f"folder:{person}")
    capture.record([replace(frame, skeletons=()) for frame in frames], tmp_path / "poses")
    command = ("forge", "stream", person, "--type", 2, "--pose", tmp_path / "poses")
    done = manip3d(*command, "-o", tmp_path / "forged")
    assert done.returncode == 1
    assert "--pose: expected skeletons, got frames without" in done.stderr
    assert not (tmp_path / "forged").exists()


def test_a_person_who_is_hidden_is_told_of(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "forged"
    moved = ("--move", 0, 0, 50)  # far behind the wall
    done = manip3d("forge", "stream", person, "--type", 1, *moved, "-o", out)
    assert done.returncode == 1
    assert "no frame of " in done.stderr
    assert "has a forged pixel" in done.stderr
    assert "behind the background" in done.stderr


def test_the_truth_of_a_stream_is_no_depth_image(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "forged"
    manip3d("forge", "stream", person, "--type", 1, "-o", out)
    for verb in ("info", "inspect"):
        done = manip3d(verb, tmp_path / "forged.truth.npz")
        assert done.returncode == 1
        assert "is the truth of a forged stream" in done.stderr
        assert "manip3d.forge.read_stream_truth" in done.stderr


def test_a_forged_source_tells_how_many_frames_are_forged(person: Path, tmp_path: Path) -> None:
    """Without a background the first frames only teach what is behind the person."""
    for options, told in (
        ("", "0 of 8 frames forged; without a"),
        (f"#background={person}", "8 of 8 frames forged"),
    ):
        place = f"forged:folder:{person}{options.replace('=', '=folder:')}"
        done = manip3d("capture", "record", place, "-o", tmp_path / f"out{len(options)}")
        assert done.returncode == 0, done.stderr
        assert told in done.stderr


def test_a_kind_that_is_given_twice_is_refused_by_its_option(tmp_path: Path) -> None:
    done = manip3d("forge", "people", "-o", tmp_path / "set", *("--kind", "real") * 2)
    assert done.returncode == 1
    assert "--kind: expected some of real, type1, type2, got real, real" in done.stderr


def test_the_log_holds_the_hash_of_a_folder(person: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    page = tmp_path / "page.html"
    assert manip3d("inspect", person, "--log", log, "-o", page).returncode in (0, 3, 4)
    listed = "find -L . -type f -print0 | LC_ALL=C sort -z | xargs -0 sha256sum | sha256sum"

    def expected_now() -> str:
        done = subprocess.run(listed, shell=True, cwd=person, text=True, capture_output=True)
        return done.stdout.split()[0]

    expected = expected_now()
    assert json.loads(log.read_text())["source_sha256"] == expected
    assert expected in page.read_text()
    image = sorted((person / "depth").iterdir())[3]
    image.write_bytes(image.read_bytes()[::-1])
    assert folder_sha256(person) != expected
    (person / "again").symlink_to(person)  # a circle
    (person / "alias").symlink_to(person / "depth")
    (person / "nowhere").symlink_to(person / "absent")
    (person / "Straße 1").mkdir()
    (person / "Straße 1" / "empty").touch()
    assert folder_sha256(person) == expected_now()


def test_a_recording_that_is_stopped_has_no_old_truth(
    person: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, truth = tmp_path / "forged", tmp_path / "forged.truth.npz"

    def forge_it(*, force: bool) -> None:
        forge_frames(
            str(person), out, Terminal(quiet=True), kind=1, pose="", background="", still=False,
            frames=8, force=force, options={},
        )  # fmt: skip

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    def fail_at_once(_: object) -> Iterator[RgbdFrame]:
        fail()
        yield from ()

    for owner, name, stopped in (
        (forge.ForgedStream, "__iter__", fail_at_once),  # before a frame is forged
        (forge.ForgedStream, "write_truth", fail),  # after all of them
    ):
        forge_it(force=True)
        assert truth.is_file()
        with monkeypatch.context() as patch:
            patch.setattr(owner, name, stopped)
            with pytest.raises(OSError, match="No space"):
                forge_it(force=True)
        assert not truth.exists()


def test_poses_of_a_motion_file(person: Path, tmp_path: Path) -> None:
    motion, out = tmp_path / "motion.bvh", tmp_path / "forged"
    assert manip3d("capture", "export", person, "-o", motion).returncode == 0
    command = ("forge", "stream", person, "--type", 2, "--pose", motion, "-o", out, "--json")
    done = manip3d(*command)
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert (record["frames"], record["frames_without_person"]) == (8, 0)
    assert record["forged_share"] > 0.03
    motion.write_text("HIERARCHY\nROOT Hips {")
    broken = manip3d(*command, "--force")
    assert broken.returncode == 1
    assert "motion.bvh: line 2: expected" in broken.stderr


class _Counted:
    """Frames of a person who stands before a wall, made one by one; counts those that are alive."""

    def __init__(self, frames: int, *, rate: float = 30.0, skeletons: bool = True) -> None:
        self.calibration = RgbdCalibration(SMALL)
        self.most = self.passes = 0
        self._frames, self._rate, self._skeletons = frames, rate, skeletons
        self._seen = frame(pose(), SMALL)
        self._alive: weakref.WeakSet[RgbdFrame] = weakref.WeakSet()

    def __iter__(self) -> Iterator[RgbdFrame]:
        self.passes += 1
        for number in range(self._frames):
            depth = self._seen.depth.copy()
            depth[depth == 0] = 3600 + number
            made = replace(
                self._seen,
                depth=depth,
                number=number,
                time_ns=round(number * 1e9 / self._rate),
                skeletons=self._seen.skeletons if self._skeletons else (),
            )
            self._alive.add(made)
            self.most = max(self.most, len(self._alive))
            yield made
            del made, depth


def _sources_by_name(monkeypatch: pytest.MonkeyPatch, places: dict[str, _Counted]) -> None:
    """Open these instead of addresses; those whose names begin with "live" are live."""
    from manip3d.cli import capture as cli_capture

    def opened(place: str, _: Terminal, **__: object) -> capture.RgbdSource:
        source = capture.from_frames(places[place], uri=place)
        source.is_live = place.startswith("live")
        return source

    monkeypatch.setattr(cli_capture, "open_source", opened)


def _forge_of(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, places: dict[str, _Counted], **options: Any
) -> list[RgbdFrame]:
    """Forge a stream of sources by name; its frames."""
    _sources_by_name(monkeypatch, places)
    given: dict[str, Any] = {
        "kind": 1,
        "pose": "",
        "background": "",
        "still": False,
        "frames": None,
    }
    forge_frames(
        next(iter(places)), tmp_path / "out", Terminal(quiet=True), force=True,
        **(given | {"options": {"smoothing": False}} | options),
    )  # fmt: skip
    return list(capture.open_rgbd(f"folder:{tmp_path / 'out'}"))


def test_forging_keeps_few_frames_however_long_the_recordings_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in (forge, _recorded):
        monkeypatch.setattr(place, "MAX_KEPT", 10)
    people, scenes, poses = _Counted(80), _Counted(40), _Counted(40)
    places = {"people": people, "scenes": scenes, "poses": poses}
    made = _forge_of(monkeypatch, tmp_path, places, kind=2, background="scenes", pose="poses")
    assert len(made) == 80
    assert people.most < 8  # a few at a time are on their way to the recorder
    assert scenes.most <= 12
    assert poses.most <= 2  # their skeletons alone are kept
    alone = _Counted(80)
    assert len(_forge_of(monkeypatch, tmp_path, {"alone": alone})) == 80
    assert alone.passes >= 2
    assert alone.most <= 10 + 8


def test_a_recording_of_unknown_length_is_judged_all_over_without_being_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recorded = _Counted(200)
    _sources_by_name(monkeypatch, {"unfinished": recorded})
    monkeypatch.setattr(capture.RgbdSource, "has_known_end", True)  # as that of a file
    judged: list[int] = []

    def inspect(frames: list[RgbdFrame], **_: object) -> None:
        judged.extend(frame.number for frame in frames)
        raise InputError("enough")

    monkeypatch.setattr(authenticate, "inspect_stream", inspect)
    with pytest.raises(InputError, match="enough"):
        inspect_recording("unfinished", None, None, Terminal(quiet=True))
    assert len(judged) == 60
    assert (judged[:7], judged[-1]) == ([0, 1, 2, 3, 4, 5, 21], 199)
    assert recorded.most <= 62


def test_the_plate_is_learnt_from_frames_of_the_whole_recording(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_recorded, "MAX_KEPT", 10)
    spread = _recorded._Spread()
    for each in _Counted(47):
        spread.add(each)
    assert [each.number for each in spread.kept] == [0, 8, 16, 24, 32, 40]
    few = _recorded._Spread()
    for each in _Counted(10):
        few.add(each)
    assert [each.number for each in few.kept] == list(range(10))


def test_a_background_of_another_rate_keeps_its_pace(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    places = {"people": _Counted(8), "scenes": _Counted(6, rate=10.0)}
    made = _forge_of(monkeypatch, tmp_path, places, background="scenes")
    # The corner shows the wall, whose depth tells the number of the background's frame.
    assert [int(each.depth[0, 0]) - 3600 for each in made] == [0, 0, 1, 1, 1, 2, 2, 2]
    slow = _recorded._AtStep(list(_Counted(3)), 1e18, 1e-3)  # no list of 10^21 frames
    assert len(slow) > 2**60
    assert slow[10**9].number == 0


def test_live_sources_are_forged_for_so_many_frames_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    orders: list[dict[str, Any]] = [
        {},
        {"background": "live2"},
        {"background": "recorded", "kind": 2, "pose": "live2"},
    ]
    for options in orders:
        first = "live" if not options else "people"
        places = {first: _Counted(5), "live2": _Counted(5), "recorded": _Counted(5)}
        with pytest.raises(InputError, match=r"--frames: needed with live2?, which is live"):
            _forge_of(monkeypatch, tmp_path, places, **options)
        assert not (tmp_path / "out").exists()
    live = _Counted(9)
    assert len(_forge_of(monkeypatch, tmp_path, {"live": live}, frames=4)) == 4
    assert live.passes == 1  # what a camera has seen does not come again


def test_forge_names_wrong_options(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = manip3d("forge", "stream", person, "--type", 2, "-o", out)
    assert done.returncode == 1
    assert done.stderr == "manip3d: error: --pose: expected a motion for type 2, got none\n"
    for option, value in (("--method", "rigid"), ("--scope", "body")):
        done = manip3d("forge", "stream", person, "--type", 1, option, value, "-o", out)
        assert done.returncode == 1
        assert f"{option}: can only be given with --type 2, got {value}" in done.stderr
    assert manip3d("forge", "stream", person, "--type", 3, "-o", out).returncode == 2
    assert manip3d("forge", "stream", person, "-o", out).returncode == 2
    assert not out.exists()


def test_inspect_takes_recordings(person: Path, tmp_path: Path) -> None:
    out = tmp_path / "forged"
    forging = ("forge", "stream", person, "--type", 1, "--still", "--background", person)
    assert manip3d(*forging, "-o", out, "-q").returncode == 0
    evidence = tmp_path / "evidence.json"
    done = manip3d("inspect", out, "-o", evidence, "--json")
    record = json.loads(done.stdout)
    assert record == json.loads(evidence.read_text())
    # 192 x 160 pixels are no camera's: whatever was done, nobody is accused.
    assert (record["verdict"], done.returncode) == ("processed", 4)
    assert {report["name"] for report in record["detectors"]} == {
        "repetition",
        "silhouettes",
        "noise",
    }
    shown = manip3d("inspect", out)
    assert shown.stdout.startswith("processed: cropped")
    assert manip3d("inspect", out, "--policy", "processed=0", "-q").returncode == 0
    log = tmp_path / "case.jsonl"
    assert manip3d("inspect", out, "--log", log, "-q").returncode == 4
    assert json.loads(log.read_text())["verdict"] == "processed"
    for option in ("rows", "previous", "following", "lattice", "key", "watermark", "calibration"):
        ignored = manip3d("inspect", out, f"--{option}", tmp_path / "x")
        assert ignored.returncode == 1
        assert f"--{option}: can only be given with a LiDAR scan or drive" in ignored.stderr
    refused = manip3d("inspect", out, "-o", tmp_path / "page.pdf")
    assert "expected a name that ends in" in refused.stderr
    page = tmp_path / "page.html"
    assert manip3d("inspect", out, "-o", page, "-q").returncode == 4
    text = page.read_text()
    assert text.count("<figure>") == 6
    assert text.count("<polyline") == 2
    assert "http" not in text


def test_inspect_says_how_a_folder_of_depth_images_is_to_be_laid_out(
    person: Path, tmp_path: Path
) -> None:
    """Poses beside the images, as 7-Scenes has them, are no scans."""
    flat = tmp_path / "flat"
    flat.mkdir()
    for number, image in enumerate(sorted((person / "depth").iterdir())[:3]):
        (flat / f"frame-{number}.depth.png").write_bytes(image.read_bytes())
    for _ in range(2):  # without poses, then with them
        done = manip3d("inspect", flat)
        assert done.returncode == 1
        assert (
            "expected scans or an RGB-D recording, got 3 depth images; a recording has"
            in done.stderr
        )
        for number in range(3):
            np.savetxt(flat / f"frame-{number}.pose.txt", np.eye(4))
        np.savetxt(flat / "camera.txt", np.eye(3))
    for number in range(4):  # as many clouds again: they are what is to be judged
        np.savetxt(flat / f"cloud-{number}.txt", np.eye(3))
    assert "depth images" not in manip3d("inspect", flat).stderr


def test_forge_takes_the_camera_of_a_background_of_images_alone(
    person: Path, tmp_path: Path
) -> None:
    """The error about its missing calibration names ``--intrinsics``; the source keeps its own."""
    scene = tmp_path / "scene"
    shutil.copytree(person / "depth", scene / "depth")
    command = ("forge", "stream", person, "--type", 1, "--background", scene, "-o", tmp_path / "f")
    done = manip3d(*command)
    assert done.returncode == 1
    assert "--intrinsics" in done.stderr
    camera = f"{SMALL.fx},{SMALL.fy},{SMALL.cx},{SMALL.cy}"
    assert manip3d(*command, "--intrinsics", camera).returncode == 0
    assert capture.open_rgbd(f"folder:{tmp_path / 'f'}").num_frames == 8
