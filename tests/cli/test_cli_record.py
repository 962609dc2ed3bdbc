"""``manip3d capture record``: events that begin a recording, the first frame, TUM sequences."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from itertools import islice
from pathlib import Path

import pytest

import rgbd_frames
from command_line import error_line, manip3d
from manip3d import InputError, capture
from manip3d.cli.capture import check_recording_output, write_recording
from manip3d.cli.terminal import Terminal
from manip3d.cli.triggers import trigger_of


def test_a_signal_is_a_trigger_while_it_is_waited_for() -> None:
    frame = next(rgbd_frames.frames(1))
    before = signal.getsignal(signal.SIGUSR2)
    with trigger_of("SIGUSR2") as (has_come, told):
        assert f"kill -s USR2 {os.getpid()}" in told
        assert not has_come(frame)
        os.kill(os.getpid(), signal.SIGUSR2)
        assert has_come(frame)
        assert has_come(frame)
    assert signal.getsignal(signal.SIGUSR2) == before
    with pytest.raises(InputError, match="--trigger: expected one of key, person, SIGUSR1"):
        trigger_of("SIGKILL").__enter__()


def test_a_key_is_a_trigger(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = next(rgbd_frames.frames(1))
    ours, theirs = os.pipe()
    with os.fdopen(ours) as typed:
        monkeypatch.setattr(sys, "stdin", typed)
        with trigger_of("key") as (has_come, _):
            assert not has_come(frame)
            os.write(theirs, b"\n")
            assert has_come(frame)
            assert not has_come(frame)
            os.close(theirs)
            with pytest.raises(InputError, match="standard input has ended"):
                has_come(frame)
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(InputError, match="expected a terminal"):
        trigger_of("key").__enter__()


def test_a_recording_begins_with_the_seconds_before_a_signal(tmp_path: Path) -> None:
    """Up to six frames, 0.2 s at 30 Hz, are kept from before the signal."""
    words = ["record", "sim:body?frames=1800&color=none", "-o", str(tmp_path / "a"), "--json"]
    words += ["--trigger", "SIGUSR1", "--before", "0.2", "--frames", "3"]
    program = subprocess.Popen(
        [sys.executable, "-m", "manip3d", "capture", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert program.stderr is not None
    told = next(line for line in program.stderr if "waiting for" in line)
    assert told.strip().endswith(
        f"waiting for SIGUSR1: kill -s USR1 {program.pid}; the last 0.2 s are kept"
    )
    time.sleep(4.0)  # frames are made meanwhile
    program.send_signal(signal.SIGUSR1)
    out, _ = program.communicate(timeout=120)
    assert program.returncode == 0
    record = json.loads(out)
    numbers = [frame.number for frame in capture.open_rgbd(f"folder:{tmp_path / 'a'}")]
    begun = numbers[-1] - 2  # the first of the three
    assert numbers == list(range(begun - min(begun, 6), begun + 3))
    assert (record["frames"], record["stop"]) == (len(numbers), "frames")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_what_ends_the_program_finishes_the_recording(tmp_path: Path, number: int) -> None:
    output = tmp_path / "a.mkv"
    code = (
        "import os, signal, sys, rgbd_frames; from manip3d import capture, cli\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # nohup ignores it
        "def frames():\n"
        "    yield from rgbd_frames.frames(3)\n"
        f"    os.kill(os.getpid(), {int(number)})\n"
        "    signal.pause()\n"
        "capture.open_rgbd = lambda *_, **__: capture.from_frames(frames())\n"
        "cli.main(['capture', 'record', 'sim:body', '-o', sys.argv[1]])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(output)],
        capture_output=True, text=True, timeout=120, check=False,
        env={**os.environ, "PYTHONPATH": str(Path(rgbd_frames.__file__).parent)},
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert f"interrupted: {output} has 3 frames, which are whole" in done.stderr
    with capture.open_rgbd(f"mkv:{output}") as source:
        assert len(list(source)) == 3
        assert source.counters["unfinished"] == 0


def test_a_trigger_that_does_not_come_is_an_error(walk: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = manip3d("capture", "record", walk, "-o", out, "--trigger", "SIGUSR1")
    assert done.returncode == 1
    assert "--trigger SIGUSR1: the event did not occur before the source ended" in done.stderr
    assert not out.exists()
    film = manip3d("capture", "record", walk, "-o", tmp_path / "a.mkv", "--trigger", "SIGUSR1")
    assert "a.mkv was not written" in film.stderr
    out.mkdir()
    again = manip3d("capture", "record", walk, "-o", out, "--trigger", "SIGUSR1", "--force")
    assert "the event did not occur" in again.stderr
    assert [path.name for path in tmp_path.iterdir() if path != walk] == ["out"]  # it was there
    refused = manip3d("capture", "record", walk, "-o", tmp_path / "b", "--before", "1")
    assert "--before: can only be given with --trigger" in error_line(refused)
    seen = manip3d("capture", "record", walk, "-o", tmp_path / "c", "--trigger", "person", "-q")
    assert (seen.returncode, seen.stderr) == (0, "")
    assert capture.open_rgbd(f"folder:{tmp_path / 'c'}").num_frames == 9


def test_a_quality_of_no_jpeg_is_refused(tmp_path: Path) -> None:
    order = ("capture", "record", "sim:body?frames=2", "-o", tmp_path / "a.mkv", "--quality", 70)
    refused = manip3d(*order, "--lossless-color")
    assert "--quality: expected none with --lossless-color" in error_line(refused)
    assert not (tmp_path / "a.mkv").exists()


def test_an_unknown_trigger_leaves_no_camera_open(tmp_path: Path) -> None:
    source = capture.from_frames(list(rgbd_frames.frames(2)))
    with pytest.raises(InputError, match="--trigger: expected one of"):
        write_recording(
            source,
            tmp_path / "out",
            Terminal(quiet=True),
            frames=None,
            seconds=None,
            lossless_color=False,
            jpeg_quality=90,
            trigger="SIGKILL",
            force=False,
        )
    assert source._is_stopped


@pytest.mark.parametrize(("scheme", "name"), [("folder", "a"), ("mkv", "a.mkv"), ("tum", "a")])
def test_an_output_with_its_kind_is_checked_like_one_without(
    tmp_path: Path, scheme: str, name: str
) -> None:
    place = tmp_path / name
    check_recording_output(Path(f"{scheme}:{place}"), force=False)
    place.touch()
    with pytest.raises(InputError) as plain:
        check_recording_output(place, force=False)
    with pytest.raises(InputError) as told:
        check_recording_output(Path(f"{scheme}:{place}"), force=False)
    assert str(told.value) == str(plain.value)


def test_a_recording_cannot_go_to_stdout() -> None:
    """``-o -`` is refused; it once made a folder with the name "-"."""
    with pytest.raises(InputError, match="-o -: expected a folder or a file"):
        check_recording_output(Path("-"), force=False)


def test_a_tum_sequence_of_the_frames_from_one_on(walk: Path, tmp_path: Path) -> None:
    out = tmp_path / "sequence"
    words = ("capture", "record", walk, "-o", f"tum:{out}", "--start", "7")
    done = manip3d(*words, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == 2
    # The copy has no joints, which its users must know.
    assert "skeletons of 2 frames left out: a TUM sequence has no place for them" in done.stderr
    assert "pixels left out: beyond 13.106 m" in done.stderr
    refused = manip3d(*words)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "exists already; --force replaces it" in refused.stderr
    assert manip3d(*words, "--force", "-q").returncode == 0
    info = json.loads(manip3d("capture", "info", out, "--json").stdout)
    assert (info["source"], info["frames"]) == (f"tum:{out}", 2)
    expected = [frame.time_ns for frame in islice(rgbd_frames.frames(9), 7, None)]
    assert [info["first_time_ns"], info["last_time_ns"]] == expected
    played = manip3d("capture", "play", walk, "--speed", "0", "--start", "6", "--json")
    assert json.loads(played.stdout)["frames"] == 3
    beyond = manip3d("capture", "play", walk, "--start", "9")
    assert "start: expected less than the 9 frames" in error_line(beyond)


def test_nothing_replaces_a_recording_where_no_frame_comes(walk: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    capture.record(rgbd_frames.frames(2), other, trigger=lambda _: False)
    again = ("capture", "record", other, "-o", walk, "--force", "-q")
    assert f"expected a frame, found none; {walk} is as it was" in error_line(manip3d(*again))
    done = manip3d(*again, "--trigger", "SIGUSR1")
    assert f"{walk} is as it was" in error_line(done)
    assert capture.open_rgbd(f"folder:{walk}").num_frames == 9
    new = tmp_path / "new"
    for words in (("record", other, "-o", new), ("play", other, "-o", new), ("info", other)):
        done = manip3d("capture", *words, "-q")
        assert done.returncode == 1
        assert "expected a frame, found none" in error_line(done)
        assert not new.exists()
