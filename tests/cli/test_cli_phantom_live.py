"""``manip3d phantom live`` as a user starts and ends it."""

from __future__ import annotations

import json
import re
import signal
import ssl
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from pathlib import Path

import pytest

import rgbd_frames
from manip3d import __version__, capture

pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")


pytestmark = pytest.mark.usefixtures("live_page")


@pytest.fixture
def recording(tmp_path: Path) -> str:
    capture.record(rgbd_frames.frames(6), tmp_path / "walk")
    return f"folder:{tmp_path / 'walk'}"


def started(
    *arguments: str, code: Sequence[str] = ("-m", "manip3d")
) -> tuple[subprocess.Popen[str], str]:
    """The program and the address that it prints."""
    program = subprocess.Popen(
        [sys.executable, *code, "phantom", "live", "--no-open", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert program.stderr is not None
    found = re.match(
        r"open (http://127\.0\.0\.1:\d+/\?token=[\w-]{43})\n", program.stderr.readline()
    )
    assert found is not None
    return program, found[1]


def test_ctrl_c_ends_a_session_and_says_what_it_was(recording: str) -> None:
    program, url = started("--source", recording, "--limb", "left-arm", "--json")
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(url.partition("?")[0], timeout=10)
    time.sleep(1.5)
    program.send_signal(signal.SIGINT)
    out, err = program.communicate(timeout=20)
    assert program.returncode == 0, err
    report = json.loads(out)
    assert report["limb"] == "left_arm"
    assert report["frames"] > 6  # a recording is played over again
    assert report["first_frame_s"] < 5.0
    assert report["clients"] == []
    assert list(report["refused"].values()) == [1]
    assert "token" not in err  # but in the line that was read


def test_a_folder_of_images_is_played_with_the_camera_that_is_told(
    recording: str, tmp_path: Path
) -> None:
    walk = tmp_path / "walk"
    (walk / "frames.jsonl").unlink()
    (walk / "calibration.json").unlink()
    words = ["--source", str(walk), "--seconds", "1", "--json"]
    command = [sys.executable, "-m", "manip3d", "phantom", "live", "--no-open", *words]
    refused = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "has no calibration.json" in refused.stderr
    assert "--intrinsics" in refused.stderr
    program, _ = started(*words, "--intrinsics", "15,15,7.5,5.5", "--units-per-metre", "1000")
    out, err = program.communicate(timeout=60)
    assert program.returncode == 0, err
    assert json.loads(out)["frames"] >= 1


def test_the_address_opens_the_page(recording: str) -> None:
    program, url = started("--source", recording, "--seconds", "2")
    opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
    page = opener.open(url, timeout=10).read().decode()
    assert "not a medical device" in page
    assert opener.open(url.partition("?")[0] + "live.js", timeout=10).read()[:1]
    program.communicate(timeout=20)
    assert program.returncode == 0


def test_another_machine_is_served_encrypted_with_the_kept_certificate(
    recording: str, tmp_path: Path
) -> None:
    pytest.importorskip("cryptography", reason="the extra 'live' is not installed")
    kept = tmp_path / "own.pem"
    pages = []
    for _ in range(2):
        program = subprocess.Popen(
            [sys.executable, "-m", "manip3d", "phantom", "live", "--no-open", "--source", recording,
             "--host", "127.0.0.1", "--certificate", str(kept)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert program.stderr is not None
        found = re.match(
            r"open (https://127\.0\.0\.1:\d+/\?token=\S+)\n", program.stderr.readline()
        )
        assert found is not None
        assert "compare SHA-256" in program.stderr.readline()
        fingerprint = program.stderr.readline().strip()
        assert re.fullmatch(r"([0-9A-F]{2}:){31}[0-9A-F]{2}", fingerprint)
        pem = kept.read_text()
        trusting = ssl.create_default_context(cadata=pem[pem.index("-----BEGIN CERT") :])
        opener = urllib.request.build_opener(
            urllib.request.HTTPCookieProcessor(), urllib.request.HTTPSHandler(context=trusting)
        )
        pages.append((fingerprint, opener.open(found[1], timeout=10).read()))
        program.send_signal(signal.SIGINT)
        program.communicate(timeout=20)
        assert program.returncode == 0
    assert pages[0] == pages[1]
    assert b"not a medical device" in pages[0][1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--host", "0.0.0.0"], "--host: expected the address of one network interface"),
        (["--host", "example.org"], "--host: expected an address"),
        (["--gain", "3"], "3"),
        (["--source", "mkv:absent.mkv"], "absent.mkv"),
        (["--source", "sim:body?motion=fly"], "motion: expected one of"),
        (["--source", "sim:street"], "sim:body"),
        (["--source", "nothing:"], "--source: expected one of folder:"),
        (["--source", "absent.mkv"], "absent.mkv: No such file"),
        (["--seconds", "0"], "--seconds: expected > 0"),
        (
            ["--intrinsics", "kinect-v2"],
            "--intrinsics, --units-per-metre, --rate: can only be given with --source",
        ),
        (
            ["--rate", "15"],
            "--intrinsics, --units-per-metre, --rate: can only be given with --source",
        ),
        (["--source", "mkv:a.mkv", "--intrinsics", "kinect-v2"], "--intrinsics: expected a bag or"),
    ],
)
def test_a_bad_source_is_said_before_a_page_is(arguments: list[str], message: str) -> None:
    command = [sys.executable, "-m", "manip3d", "phantom", "live", "--no-open", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode in (1, 2)
    assert message in done.stderr
    assert "open http" not in done.stderr


def test_ctrl_c_in_the_middle_of_a_game_keeps_it_in_the_diary(
    chromium: None, tmp_path: Path
) -> None:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary
    from manip3d.viewer import _chromium

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="left_leg")
    words = ["--game", "piano", "--diary", str(path), "--participant", "P01"]
    program, url = started(*words, "--json")
    try:
        with _chromium.open_address(url, (640, 480)) as tab:
            press = "document.querySelector('#start').click()"
            say = (
                "{const list = document.querySelector('#pain'); list.value = '3';"
                "document.querySelector('#rating').requestSubmit();}"
            )
            phase = "globalThis.manip3dLive?.status()?.game.phase"
            end = time.monotonic() + 60.0
            while tab.evaluate(phase) not in ("playing", "paused"):
                if tab.evaluate(phase) == "waiting":
                    tab.evaluate(say)
                    tab.evaluate(press)
                assert time.monotonic() < end
                time.sleep(0.3)
            time.sleep(1.0)
            program.send_signal(signal.SIGINT)
            out, err = program.communicate(timeout=30)
    finally:
        program.kill()
    assert program.returncode == 0, err
    (told,) = json.loads(out)["games"]
    with Diary(path) as diary:
        (session,) = diary.sessions("P01")
        (game,) = session.games
        diary.check()
    assert (game.game, game.ending, game.score) == ("piano", "stopped", told["score"])
    assert session.ended is not None
    assert (game.limb, game.is_simulated, game.version) == ("left_leg", True, __version__)


_SIGNALLED_AT_THE_END = """
import signal
signal.signal(signal.{name}, signal.SIG_DFL)  # the tests may run under nohup
from manip3d.phantom._diary import DiaryRecorder
end = DiaryRecorder.end
def signalled(recorder, *hurry):
    signal.raise_signal(signal.{name})
    return end(recorder, *hurry)
DiaryRecorder.end = signalled
from manip3d.__main__ import main
main()
"""


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_what_ends_the_program_lets_it_come_to_an_end(
    recording: str, tmp_path: Path, name: str
) -> None:
    """A machine that is shut down, a terminal that is closed; again while it comes to its end."""
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="left_leg")
    words = ["--source", recording, "--diary", str(path), "--participant", "P01"]
    code = ("-c", _SIGNALLED_AT_THE_END.format(name=name))
    program, _ = started(*words, "--json", code=code)
    try:
        time.sleep(1.0)
        program.send_signal(getattr(signal, name))
        out, err = program.communicate(timeout=30)
    finally:
        program.kill()
    assert program.returncode == 0, err
    assert json.loads(out)["unkept"] == []
    with Diary(path) as diary:
        (session,) = diary.sessions("P01")
    assert session.ended is not None


def test_what_nohup_ignores_stays_ignored() -> None:
    from manip3d.cli.signals import ended_like_ctrl_c

    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ended_like_ctrl_c():
            signal.raise_signal(signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGTERM)  # the end is under way
        assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_participant_who_is_not_there_is_said_before_a_page_is(tmp_path: Path) -> None:
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary

    path = tmp_path / "study.diary"
    with Diary(path, create=True):
        pass
    command = [
        sys.executable,
        "-m",
        "manip3d",
        "phantom",
        "live",
        "--no-open",
        "--diary",
        str(path),
    ]
    for words, message in (
        (["--participant", "P01"], "--participant: 'P01' is not enrolled"),
        ([], "--diary, --participant: expected both or none"),
    ):
        done = subprocess.run(
            [*command, *words], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 1
        assert message in done.stderr
        assert "open http" not in done.stderr
