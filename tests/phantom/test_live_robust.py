"""A camera that is pulled out, a program that is killed: the session goes on, nothing is lost."""

from __future__ import annotations

import json
import math
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any, Self, cast

import numpy as np
import pytest

import capsule_body
import rgbd_frames
from manip3d import DeviceError, FormatError, InputError, capture
from manip3d.phantom import LiveReport, _live, run_live
from manip3d.rgbd import RgbdFrame

pytest.importorskip("aiohttp", reason="the extra 'live' is not installed")

from live_player import Player

pytestmark = pytest.mark.usefixtures("live_page")


def played(opened: threading.Event) -> tuple[LiveReport, Player]:
    """Run a session that a page joins, which sets ``opened``; the page is closed afterwards."""
    players: list[Player] = []

    def on_start(url: str, made: object) -> None:
        def join() -> None:
            players.append(Player(url))
            opened.set()

        threading.Thread(target=join, daemon=True).start()

    report = run_live("openni2:", affected="right_arm", seconds=60.0, on_start=on_start)
    (player,) = players
    player.close()
    return report, player


class PulledCamera:
    """Gives frames; its cable is pulled out and put back twice."""

    num_frames: int | None = None

    def __init__(self) -> None:
        self.number = 0
        self.starts = 0
        self.gone = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        pass

    def start(self) -> None:
        self.starts += 1
        if self.starts % 3:
            raise DeviceError("no such device")

    def read(self, timeout: float) -> RgbdFrame | None:
        time.sleep(0.02)
        self.number += 1
        if self.number in (40, 80):
            self.gone += 1
            raise DeviceError("transfer failed")
        step = self.number % 80  # to and fro
        frame = capsule_body.painted(step if step < 40 else 80 - step)
        return replace(frame, time_ns=self.number * 33_333_333, number=self.number)


def test_a_camera_that_is_pulled_out_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    class Camera(PulledCamera):
        """Waits for the page and ends the session as Ctrl-C does: no time of the machine counts."""

        def read(self, timeout: float) -> RgbdFrame | None:
            if self.number == 20:
                opened.wait(30.0)
            if self.number == 140:
                raise KeyboardInterrupt
            return super().read(timeout)

    camera, opened = Camera(), threading.Event()
    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: camera)
    monkeypatch.setattr(_live, "_AGAIN_S", 0.05)
    report, player = played(opened)
    assert opened.is_set()
    assert (camera.gone, camera.starts) == (2, 6)
    gone = "The camera is gone: check its cable."
    told = player.messages
    assert told.count(gone) == 2
    after = [message for message in told[told.index(gone) + 1 :] if message != gone]
    assert "The phantom limb follows the intact limb." in after
    assert report.states["tracking"] > 50
    assert report.frames == 138
    assert dict(report.refused) == {}


def test_the_latency_counts_from_the_grab(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame that waited half a second to be taken is half a second older."""

    class Late(PulledCamera):
        def read(self, timeout: float) -> RgbdFrame | None:
            opened.wait(30.0)
            time.sleep(0.02)
            self.number += 1
            if self.number > 60:
                raise KeyboardInterrupt
            frame = replace(
                capsule_body.painted(self.number % 40), time_ns=self.number * 33_333_333
            )
            return replace(frame, grabbed_ns=time.time_ns() - 500_000_000)

    opened = threading.Event()
    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: Late())
    report, _ = played(opened)
    (client,) = report.clients
    assert client["round_trip_ms"][0] >= 500.0


@pytest.mark.parametrize("is_live", [False, True])
def test_only_a_camera_is_said_to_give_no_frames(
    monkeypatch: pytest.MonkeyPatch, is_live: bool
) -> None:
    """A recording of one frame in some seconds is waited for, and ends where it is over."""

    class Slow(PulledCamera):
        def __init__(self) -> None:
            super().__init__()
            self.is_live = is_live
            self.asked = 0

        def read(self, timeout: float) -> RgbdFrame | None:
            self.asked += 1
            if self.asked in (2, 4):
                return capsule_body.painted(self.asked)
            if self.asked < 5:
                time.sleep(timeout)  # until then no frame is due
            return None

    monkeypatch.setattr(_live, "_AGAIN_S", 0.2)
    found = list(_live._captured("slow", cast(capture.RgbdSource, Slow()), math.inf, None))
    told = [each for each in found if isinstance(each, str)]
    assert told == ["The camera gives no frames."] * (2 if is_live else 0)
    assert len(found) - len(told) == 2


def test_a_live_session_goes_on_past_frames_that_cannot_be_read() -> None:
    class Torn(PulledCamera):
        is_live = False

        def __init__(self) -> None:
            super().__init__()
            self.asked = 0

        def read(self, timeout: float) -> RgbdFrame | None:
            self.asked += 1
            if self.asked in (2, 3):
                raise [FormatError("damaged"), FileNotFoundError("000003.png")][self.asked - 2]
            return capsule_body.painted(self.asked) if self.asked < 5 else None

    source = cast(capture.RgbdSource, Torn())
    found = list(_live._captured("torn", source, math.inf, None))
    assert found[1:3] == ["A frame of the recording cannot be read."] * 2
    assert len(found) == 4


def test_a_recording_whose_next_frame_is_far_away_does_not_outlast_the_session() -> None:
    class Still(PulledCamera):
        is_live = False

        def __init__(self) -> None:
            super().__init__()
            self.waits: list[float] = []

        def read(self, timeout: float) -> RgbdFrame | None:
            self.waits.append(timeout)
            if len(self.waits) == 1:
                return capsule_body.painted(0)
            if len(self.waits) > 9:
                raise AssertionError("it is still read")
            time.sleep(timeout)
            return None

    def again() -> capture.RgbdSource:
        raise AssertionError("it begins again")

    still = Still()
    end = time.monotonic() + 1.5
    found = list(_live._captured("still", cast(capture.RgbdSource, still), end, again))
    assert len(found) == 1  # and it does not begin again
    assert all(wait <= _live._AGAIN_S for wait in still.waits)
    assert sum(still.waits[1:]) <= 1.5


def test_a_source_is_closed_if_its_page_cannot_be_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """No frame of it was asked for then."""

    class Closed(PulledCamera):
        is_closed = False

        def __exit__(self, *error: object) -> None:
            self.is_closed = True

    camera = Closed()
    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: camera)
    with (
        socket.create_server(("127.0.0.1", 0)) as taken,
        pytest.raises(DeviceError, match="in use"),
    ):
        run_live("openni2:", port=taken.getsockname()[1], seconds=1.0)
    assert camera.is_closed


def test_a_source_without_frames_is_refused_before_a_page_is_shown() -> None:
    shown: list[str] = []
    with pytest.raises(InputError, match=r"^sim:body\?frames=0: expected frames, found none$"):
        run_live("sim:body?frames=0", on_start=lambda url, _: shown.append(url))
    assert shown == []


def test_a_camera_without_a_body_tracker_is_shown_with_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from manip3d.modify import PoseTracker

    class Camera(PulledCamera):
        def start(self) -> None:
            pass

        def read(self, timeout: float) -> RgbdFrame | None:
            time.sleep(0.01)
            self.number += 1
            frame = capsule_body.painted(self.number % 40)
            found = replace(frame, time_ns=self.number * 33_333_333, number=self.number)
            color = np.full((*frame.depth.shape, 3), 128, np.uint8)
            return replace(found, skeletons=(), color=None if self.number == 9 else color)

    class Finds(PoseTracker):
        def _start(self) -> Any:
            return type("Model", (), {"reset": lambda _: None, "close": lambda _: None})()

        def annotate(self, frame: RgbdFrame) -> RgbdFrame:
            assert frame.color is not None
            return replace(frame, skeletons=capsule_body.painted(frame.number % 40).skeletons)

    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: Camera())
    monkeypatch.setattr(_live, "PoseTracker", Finds)
    report = run_live("openni2:", affected="right_arm", seconds=2.0, pose=True)
    assert report.states["tracking"] > 5  # a loaded machine shows few
    without = run_live("openni2:", affected="right_arm", seconds=1.0)
    assert set(without.states) == {"lost"}


def test_a_source_without_colour_is_warned_about_once_with_pose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from manip3d.modify import PoseTracker

    class Colorless(PulledCamera):
        def read(self, timeout: float) -> RgbdFrame | None:
            if self.number == 39:
                raise KeyboardInterrupt
            frame = super().read(timeout)
            return None if frame is None else replace(frame, skeletons=(), color=None)

    class Idle(PoseTracker):
        def _start(self) -> Any:
            return type("Model", (), {"reset": lambda _: None, "close": lambda _: None})()

    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: Colorless())
    monkeypatch.setattr(_live, "PoseTracker", Idle)
    with pytest.warns(UserWarning, match="no colour images, in which --pose") as told:
        report = run_live("openni2:", affected="right_arm", pose=True)
    assert len(told) == 1
    assert report.frames == 39


class Delayed(Player):
    """A page on which each frame is decoded a fixed time after it was captured."""

    def __init__(self, url: str, delay_ms: float, **options: Any) -> None:
        self.delay_ms = delay_ms
        super().__init__(url, **options)

    def say(self, name: str, **fields: Any) -> None:
        if name == "ack":
            fields["decoded_ms"] = self.captured_ms + self.delay_ms
        super().say(name, **fields)


def test_the_diary_has_the_latency_of_the_page_that_started_the_game(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A second screen that is slow, for example a therapist's, does not count."""
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="right_arm")
    is_over = threading.Event()
    pages: list[Player] = []

    class Camera(PulledCamera):
        def start(self) -> None:
            pass

        def read(self, timeout: float) -> RgbdFrame | None:
            if is_over.is_set():
                raise KeyboardInterrupt
            time.sleep(0.02)
            self.number += 1
            frame = capsule_body.painted(self.number % 40)
            return replace(frame, time_ns=self.number * 33_333_333, number=self.number)

    def play(url: str) -> None:
        try:
            patient = Delayed(url, 40.0)
            patient.wait(lambda s: len(patient.sequences) > 3)
            therapist = Delayed(url, 4000.0, cookie=patient.stream.cookie)
            pages.extend((patient, therapist))
            therapist.wait(lambda s: len(therapist.sequences) > 3)
            patient.say("pain", value=2)
            patient.say("ready")
            patient.wait(lambda s: s["game"]["phase"] == "playing")
            patient.say("stop")
            patient.wait(lambda s: s["game"]["phase"] == "over")
        finally:
            is_over.set()

    def on_start(url: str, made: object) -> None:
        threading.Thread(target=play, args=(url,), daemon=True).start()

    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: Camera())
    run_live("openni2:", affected="right_arm", diary=path, participant="P01", on_start=on_start)
    for page in pages:
        page.close()
    with Diary(path) as diary:
        (game,) = diary.sessions("P01")[0].games
        assert game.latency_ms == pytest.approx(40.0, abs=0.1)


def test_a_headset_has_an_address_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture, "open_rgbd", lambda *_, **__: PulledCamera())
    printed: list[str] = []
    opened: list[str] = []
    players: list[Player] = []

    def open_page(url: str) -> None:
        opened.append(url)

        def join() -> None:
            players.extend(Player(url) for url in (*opened, *printed))

        threading.Thread(target=join, daemon=True).start()

    run_live("openni2:", affected="right_arm", seconds=2.0, open_page=open_page,
             on_start=lambda url, made: printed.append(url))  # fmt: skip
    assert len(players) == 2  # each address has let one in
    for player in players:
        player.close()


# --- killed ---------------------------------------------------------------------------------------


# The command, which keeps a game that goes on every second instead of every ten.
KEPT_EACH_SECOND = (
    "from manip3d import _entry\n"
    "from manip3d.phantom import _play\n"
    "_play._TELL_S = 1.0\n"
    "_entry.main()\n"
)


def started(diary: Path) -> tuple[subprocess.Popen[str], str]:
    program = subprocess.Popen(
        [sys.executable, "-c", KEPT_EACH_SECOND, "phantom", "live", "--no-open",
         "--limb", "right-arm", "--diary", str(diary), "--participant", "P01"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert program.stderr is not None
    found = re.match(r"open (http://\S+)\n", program.stderr.readline())
    assert found is not None
    return program, found[1]


@pytest.fixture
def programs() -> Iterator[list[subprocess.Popen[str]]]:
    made: list[subprocess.Popen[str]] = []
    yield made
    for program in made:
        program.kill()
        program.communicate(timeout=30)


@pytest.mark.parametrize("pains", [(3,), pytest.param((3, 4), marks=pytest.mark.slow)])
def test_what_was_recorded_survives_a_kill_in_the_middle_of_a_game(
    pains: tuple[int, ...], tmp_path: Path, programs: list[subprocess.Popen[str]]
) -> None:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="right_arm")

    def play(url: str, pain: int) -> tuple[Player, int, float]:
        """A game that is stopped after two seconds, and another one, with the time of its begin."""
        player = Player(url)
        player.say("pain", value=pain)
        player.wait(lambda s: s["game"]["pain"] == pain)
        player.say("ready")
        player.wait(lambda s: s["game"]["phase"] == "playing" and s["game"]["left_s"] < 58)
        player.say("stop")
        player.wait(lambda s: s["game"]["phase"] == "over")
        score = player.status["game"]["score"]
        begin = time.monotonic()
        player.say("ready")
        player.wait(lambda s: s["game"]["phase"] == "playing" and s["game"]["left_s"] < 56.5)
        return player, score, begin

    scores, at_most = [], []
    for pain in pains:
        program, url = started(path)
        programs.append(program)
        player, score, begin = play(url, pain)
        scores.append(score)
        program.send_signal(signal.SIGKILL)
        program.wait(30)
        at_most.append(time.monotonic() - begin)
        player.close()
    with Diary(path) as diary:
        diary.check()
        sessions = diary.sessions("P01")
        stopped, going = zip(*(session.games for session in sessions), strict=True)
        assert [game.score for game in stopped] == scores
        assert {game.ending for game in stopped} == {"stopped"}
        assert {game.ending for game in going} == {"interrupted"}
        for game, longest in zip(going, at_most, strict=True):
            assert 1.9 < game.seconds + game.paused_s <= longest
        assert tuple(session.pain_before for session in sessions) == pains
        assert {session.ended for session in sessions} == {None}


def test_a_page_that_hangs_slows_nobody(tmp_path: Path) -> None:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    log = tmp_path / "log"
    players: list[Player] = []

    def on_start(url: str, made: object) -> None:
        def join() -> None:
            players.append(Player(url, acknowledges=False))
            players.append(Player(url, cookie=players[0].stream.cookie))

        threading.Thread(target=join, daemon=True).start()

    with pytest.MonkeyPatch.context() as patch:
        from manip3d.phantom import _log

        patch.setattr(_log, "_EVERY_S", 1.0)
        report = run_live(seconds=6.0, log=log, on_start=on_start)
    for player in players:
        player.close()
    lines: list[dict[str, Any]] = [json.loads(line) for line in log.read_text().splitlines()]
    assert len(lines) >= 4
    frames = [line["frames"] for line in lines]
    assert frames == sorted(frames)
    assert frames[-1] <= report.frames
    assert all(line["memory_mib"] > 10 for line in lines)
    assert {"pipeline", "rules", "encode"} <= set(lines[-1]["stage_ms"])
    stuck = max(report.clients, key=lambda one: one["dropped"])
    assert stuck["sent"] == 2  # as many as may stay unacknowledged
    assert stuck["dropped"] >= report.frames / 2


def test_ctrl_c_while_the_address_is_told_ends_the_session(tmp_path: Path) -> None:
    capture.record(rgbd_frames.frames(3), tmp_path / "walk")

    def on_start(url: str, made: object) -> None:
        raise KeyboardInterrupt

    report = run_live(f"folder:{tmp_path / 'walk'}", affected="right_arm", on_start=on_start)
    assert report.frames == 0


def test_a_page_need_not_know_the_clock_of_the_program() -> None:
    taken: list[tuple[int, float | None]] = []
    client = SimpleNamespace(acknowledge=lambda number, ms: taken.append((number, ms)))
    for text in (
        '{"type": "ack", "sequence": 1}',
        '{"type": "ack", "sequence": 2, "decoded_ms": 5}',
    ):
        _live.hear(cast(Any, None), cast(Any, client), text, lambda: "")
    assert taken == [(1, None), (2, 5.0)]
