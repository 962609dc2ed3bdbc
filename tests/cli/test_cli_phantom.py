"""``manip3d phantom render``: films, folders, what is refused."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from command_line import run
from manip3d import InputError, RgbdFrame, capture
from manip3d.modify import PhantomFrame, PhantomPipeline, PhantomReason
from manip3d.viewer import people
from manip3d.viewer.phantom import render_phantom

pytest.importorskip("open3d")
Image = pytest.importorskip("PIL.Image")

SOURCE = "sim:body?amputated=left-arm&motion=wave&frames=3&side=both"


def test_a_folder_of_pictures(tmp_path: Path) -> None:
    output = tmp_path / "frames"
    done = run("phantom", "render", SOURCE, "-o", output, "--json", "--quiet")
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert record["limb"] == "left_arm"
    assert record["frames"] == 3
    assert record["states"] == {"tracking": 3}
    assert set(record["stage_ms"]) >= {"mirroring", "textured mesh"}
    names = sorted(path.name for path in output.iterdir())
    assert names == ["000000.png", "000001.png", "000002.png"]
    picture = np.asarray(Image.open(output / names[0]))
    assert picture.shape == (424, 3 * 512, 3)
    assert [path.name for path in tmp_path.iterdir()] == ["frames"]  # nothing is left behind
    assert "exists already" in str(run("phantom", "render", SOURCE, "-o", output).exception)
    again = run("phantom", "render", SOURCE, "-o", output, "--force", "--frames", 1, "--quiet",
                "--segmentation", "paper")  # fmt: skip
    assert again.exit_code == 0, again.output
    assert len(list(output.iterdir())) == 1


def test_a_limb_that_nobody_has_lost_is_refused_by_the_option_s_name(tmp_path: Path) -> None:
    render = "phantom", "render", "sim:body?amputated=tail", "-o", tmp_path / "out"
    refused = str(run(*render).exception)
    assert refused.startswith("amputated: expected one of left_arm")
    assert "got 'tail'" in refused


def test_pictures_without_a_phantom_limb_are_no_success(tmp_path: Path) -> None:
    """The camera is told wrong: somebody is there, and nothing can be mirrored."""
    with capture.open_rgbd(SOURCE) as simulated:
        capture.record(simulated, tmp_path / "walk")
    calibration = tmp_path / "walk" / "calibration.json"
    told = calibration.read_text()
    assert '"fx": 365.0' in told
    calibration.write_text(told.replace('"fx": 365.0', '"fx": 36500.0'))
    words = ("phantom", "render", tmp_path / "walk", "--limb", "left-arm", "-o", tmp_path / "out")
    done = run(*words)
    assert done.exit_code == 1, done.output
    assert "3 frames, left arm; no frame shows a phantom limb" in done.stderr
    assert len(list((tmp_path / "out").iterdir())) == 3


def test_a_sheet_of_the_worst_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The worst by the score of the pipeline's gate comes first; three of 43 are left out."""
    output = tmp_path / "worst.png"
    source = "sim:body?amputated=left-arm&motion=wave&frames=43&turn=40"
    shown: list[tuple[PhantomFrame, RgbdFrame]] = []
    process = PhantomPipeline.process

    def noting(pipeline: PhantomPipeline, frame: RgbdFrame, **options: Any) -> PhantomFrame:
        shown.append((process(pipeline, frame, **options), frame))
        return shown[-1][0]

    monkeypatch.setattr(PhantomPipeline, "process", noting)
    done = run("phantom", "render", source, "-o", output, "--quiet")
    assert done.exit_code == 0, done.output
    assert len(shown) == 43
    sheet = np.asarray(Image.open(output))
    assert sheet.shape == (5 * 400, 8 * 200, 3)
    phantom, worst = max(shown, key=lambda one: one[0].quality.score)
    seen = people.phantom_sheet(worst, phantom)[:, :512]
    rows, columns = np.nonzero(phantom.depth > 0)
    middle = [(int(axis.min()) + int(axis.max())) / 2 for axis in (rows, columns)]
    half = max(np.ptp(rows), np.ptp(columns)) / 2 + 8
    v, u = (np.rint(one + np.linspace(-half, half, 200)).astype(int) for one in middle)
    np.testing.assert_array_equal(sheet[:200, :200], seen[np.ix_(v, u)])
    assert "exists already" in str(run("phantom", "render", source, "-o", output).exception)
    assert [path.name for path in tmp_path.iterdir()] == ["worst.png"]


def test_a_folder_of_images_gets_its_camera_and_a_word_about_joints(tmp_path: Path) -> None:
    """Images that another program wrote: no camera, no skeleton."""
    (tmp_path / "walk" / "depth").mkdir(parents=True)
    for i in range(2):
        depth = np.full((48, 64), 10_000, np.uint16)
        Image.fromarray(depth).save(tmp_path / "walk" / "depth" / f"{i}.png")
    words = ("phantom", "render", tmp_path / "walk", "-o", tmp_path / "out")
    refused = str(run(*words).exception)
    assert "expected the camera of its images (--intrinsics, or camera= in Python)" in refused
    camera = ("--intrinsics", "60,60,31.5,23.5", "--units-per-metre", "5000")
    done = run(*words, *camera, "--json")
    assert done.exit_code == 1, done.output  # the pictures show no phantom limb
    told = json.loads(done.stdout)["messages"]
    assert told == {"There is no skeleton in this source: use --pose.": 2}
    assert "2 frames, right arm; no frame of the source has a skeleton" in done.stderr
    assert "nor a colour image, in which --pose would find the joints" in done.stderr
    assert "not in view" not in done.stderr  # nobody was looked for
    picture = np.asarray(Image.open(tmp_path / "out" / "000001.png"))
    assert picture.shape == (48, 3 * 64, 3)


def test_frames_that_cannot_be_read_are_told_and_passed_over(tmp_path: Path) -> None:
    recording = tmp_path / "walk"
    with capture.open_rgbd(SOURCE.replace("frames=3", "frames=6")) as simulated:
        capture.record(simulated, recording)
    (recording / "depth" / "000000.png").unlink()
    (recording / "depth" / "000002.png").unlink()
    (recording / "depth" / "000003.png").write_bytes(b"no picture")
    words = ("phantom", "render", recording, "--limb", "left-arm", "-o", tmp_path / "out")
    done = run(*words, "--json")
    assert done.exit_code == 1, done.output
    record = json.loads(done.stdout)
    assert record["frames"] == 5  # there is no picture before the first one that is read
    assert record["states"] == {"tracking": 3, "holding": 2}
    assert list(record["errors"]) == ["0", "2", "3"]
    assert "3 frames cannot be read" in done.stderr
    assert "000003.png: damaged" in done.stderr
    assert "000002.png: No such file or directory" in done.stderr
    assert "Errno" not in done.stderr
    pictures = [path.read_bytes() for path in sorted((tmp_path / "out").iterdir())]
    assert len(pictures) == 5
    assert pictures[0] == pictures[1] == pictures[2] != pictures[3]
    for depth in (recording / "depth").iterdir():
        depth.unlink()
    nothing = run(*words, "--force")
    assert nothing.exit_code == 1
    assert isinstance(nothing.exception, FileNotFoundError)


def test_frames_that_a_recording_does_not_give_are_told(tmp_path: Path) -> None:
    """A camera's clock that began again, a damaged cluster, a copy that was cut short."""
    with capture.open_rgbd(SOURCE.replace("frames=3", "frames=6")) as simulated:
        capture.record(simulated, tmp_path / "walk")
        simulated.seek(0)
        capture.record(simulated, tmp_path / "walk.mkv")
    lines = tmp_path / "walk" / "frames.jsonl"
    rows = [json.loads(line) for line in lines.read_text().splitlines()]
    for row in rows[-4:]:
        row["time_ns"] -= 10**9
    lines.write_text("".join(json.dumps(row) + "\n" for row in rows))
    words = ("phantom", "render", tmp_path / "walk", "--limb", "left-arm")
    done = run(*words, "-o", tmp_path / "a.png", "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["frames"] == 2
    assert json.loads(done.stdout)["counters"]["out_of_order"] == 4
    assert "4 frames left out: no later than the frame before" in done.stderr
    for verb in (
        ("capture", "export", "-o", tmp_path / "joints.csv"),
        ("capture", "record", "-o", tmp_path / "again"),
        ("forge", "stream", "--type", 1, "-o", tmp_path / "forged"),
        ("inspect",),
    ):
        other = run(*verb, tmp_path / "walk")
        assert "4 frames left out: no later than the frame before" in other.stderr, verb
    content = (tmp_path / "walk.mkv").read_bytes()
    (tmp_path / "cut.mkv").write_bytes(content[: len(content) // 2])
    cut = run("phantom", "render", tmp_path / "cut.mkv", "-o", tmp_path / "cut.png")
    assert cut.exit_code == 0, cut.output
    assert "the recording ends in the middle of a frame: its end is missing" in cut.stderr
    middle = len(content) // 2
    torn = content[:middle] + bytes(64) + content[middle + 64 :]
    (tmp_path / "torn.mkv").write_bytes(torn)
    damaged = run("phantom", "render", tmp_path / "torn.mkv", "-o", tmp_path / "torn.png")
    assert damaged.exit_code == 1, damaged.output
    assert "1 frame left out: damaged" in damaged.stderr


def test_other_folders_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "dear.txt").write_text("keep me")
    refused = run("phantom", "render", SOURCE, "-o", tmp_path / "letters", "--force")
    assert "letters: holds other files (dear.txt); give another" in str(refused.exception)
    with pytest.raises(InputError, match="output: expected a new folder, or one of pictures"):
        render_phantom(SOURCE, tmp_path / "letters", overwrite=True)
    assert os.listdir(tmp_path / "letters") == ["dear.txt"]


@pytest.mark.parametrize("name", ["film.mp4", "sheet.png", "pictures"])
def test_nothing_is_replaced_unasked(tmp_path: Path, name: str) -> None:
    output = tmp_path / name
    output.mkdir() if name == "pictures" else output.write_bytes(b"keep me")
    with pytest.raises(InputError, match=r"output: .* exists already; overwrite=True"):
        render_phantom(SOURCE, output)
    assert output.is_dir() or output.read_bytes() == b"keep me"


@pytest.mark.parametrize("frames", [0, -1])
def test_no_film_has_less_than_one_frame(tmp_path: Path, frames: int) -> None:
    with pytest.raises(InputError, match=f"frames: expected 1 or more, got {frames}"):
        render_phantom(SOURCE, tmp_path / "film", frames=frames)
    assert not (tmp_path / "film").exists()


def test_a_film(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    output = tmp_path / "phantom.mp4"
    done = run("phantom", "render", SOURCE, "-o", output, "--quiet", "--limb", "left-arm")
    assert done.exit_code == 0, done.output
    with av.open(str(output)) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == 3
    assert frames[0].shape == (424, 1536, 3)
    assert (frames[0][:, 600:900] > 250).mean() > 0.5  # the person on white


def test_a_film_has_the_speed_of_its_frames(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    source = list(capture.open_rgbd(SOURCE))
    steps_ms = {
        (0, 100, 350): (0, 100, 350),
        (7, 7, 7): (0, 33, 67),  # no times
        (500, 400, 417): (0, 33, 50),  # the clock went back
        (0, 60_000, 60_100): (0, 10_000, 10_100),
        (0, 60_000, 0): (0, 10_000, 10_250),  # the step after a gap is not the gap's
    }
    for times, shown in steps_ms.items():
        frames = [replace(f, time_ns=t * 10**6) for f, t in zip(source, times, strict=True)]
        path = tmp_path / "film.mp4"
        render_phantom(frames, path, affected="left_arm", overwrite=True)
        with av.open(str(path)) as film:
            found = [1000 * float(frame.time) for frame in film.decode(video=0)]
        assert found == pytest.approx(shown, abs=1)


def test_a_short_source_without_skeletons_is_not_one_without_a_person(tmp_path: Path) -> None:
    """The pipeline tells the two apart after a second; at the end of a film it is known."""
    frames = list(capture.open_rgbd(SOURCE))
    bare = [replace(frame, skeletons=()) for frame in frames]
    film = render_phantom(bare, tmp_path / "bare", affected="left_arm")
    assert film.messages == {PhantomReason.NO_SKELETON.message: 3}
    film = render_phantom([*bare[:2], frames[2]], tmp_path / "late", affected="left_arm")
    assert film.messages[PhantomReason.NO_JOINTS.message] == 2
    assert PhantomReason.NO_SKELETON.message not in film.messages


def test_what_is_refused(tmp_path: Path) -> None:
    def message(*arguments: object) -> str:
        return str(run("phantom", "render", *arguments).exception)

    assert "expected a name that ends in .mp4" in message(SOURCE, "-o", tmp_path / "x.gif")
    empty = message("sim:body?frames=0", "-o", tmp_path / "none")
    assert "expected frames, found none" in empty
    assert "--azimuth: expected a finite number" in message(SOURCE, "-o", "x", "--azimuth", "nan")
    assert "unknown option" in message("sim:body?speed=3", "-o", tmp_path / "x")
    assert message("nothing:", "-o", tmp_path / "x").startswith("SOURCE: expected one of folder:")
    exported = run("capture", "export", SOURCE, "-o", tmp_path / "x.csv", "--person", 90)
    assert "--person: expected a skeleton with id 90" in str(exported.exception)
    assert "found only ids " in str(exported.exception)
    assert list(tmp_path.iterdir()) == []


def test_verbs_of_one_recording_take_several(tmp_path: Path) -> None:
    """Tables, motions, films and forgeries of a folder of recordings, by one command each."""
    rec = tmp_path / "rec"
    rec.mkdir()
    for name in "ab":
        run("capture", "record", "sim:body?frames=3&amputated=right-arm", "-o", rec / f"{name}.mkv")
    told = json.loads(run("capture", "info", rec, "--json", "--jobs", 1).stdout)
    assert [row["frames"] for row in told] == [3, 3]
    for verb, suffix in {
        ("capture", "export"): ".csv",
        ("forge", "stream", "--type", "1", "--still"): ".mkv",
        ("phantom", "render", "--frames", "2"): ".mp4",
    }.items():
        output = tmp_path / verb[1]
        # Here: a process for each takes longer to start than all that they do.
        run(*verb, rec, "-o", output, "--jobs", 1)
        assert {f"a{suffix}", f"b{suffix}"} <= {file.name for file in output.iterdir()}
