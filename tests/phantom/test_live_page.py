"""The live session in a real browser: the simulated amputee bursts a bubble with a phantom hand."""

from __future__ import annotations

import itertools
import json
import socket
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_stage import (
    Stage,
    click_at,
    keep_picture,
    press,
    rate,
    screenshot,
    text_of,
    type_key,
)

import capsule_body
from manip3d.phantom import _touch, simulated_patient
from manip3d.phantom._page import INTENDED_USE
from manip3d.phantom.games import GAMES
from manip3d.rgbd import RgbdFrame
from manip3d.serve import StreamClient
from manip3d.viewer import _chromium
from waiting import wait_for

TITLES = {game.name: game.title for game in GAMES.values()}
# Whether the page can be left without a question of the browser.
LEAVES = "dispatchEvent(new Event('beforeunload', {cancelable: true}))"
PHANTOM_HAND = {10, 11, 23, 24}


@pytest.fixture
def stage() -> Iterator[Stage]:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate.sources import open_source

    address = simulated_patient("right_arm") + "&frames=400"
    found = Stage(iter(open_source(address, threads=1)))  # type: ignore[arg-type]
    yield found
    found.server.stop()


def test_an_empty_message_does_not_indent_what_follows(chromium: None, stage: Stage) -> None:
    """On a page as narrow as a phone, wrapped questions start at the same column."""
    lefts = "['rating', 'unwell'].map((id) => document.getElementById(id).offsetLeft)"
    with _chromium.open_address(stage.server.new_url(), (390, 900)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        tab.evaluate("document.body.style.width = '390px'")  # windows are not so narrow
        tab.evaluate("document.getElementById('asking').hidden = false")
        left, below = json.loads(tab.evaluate(f"JSON.stringify({lefts})"))
        assert left == below


@pytest.mark.parametrize("is_large", [False, True])
def test_nothing_is_wider_than_a_small_phone(chromium: None, stage: Stage, is_large: bool) -> None:
    fits = "document.documentElement.scrollWidth <= innerWidth"
    with _chromium.open_address(stage.server.new_url(), (500, 900)) as tab:
        phone_or_desktop(tab, 360)
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(2)
        tab.evaluate("document.getElementById('asking').hidden = false")
        if is_large:
            press(tab, "l")
        assert tab.evaluate(fits)
        for key in ("u", "t"):
            press(tab, key)
            assert tab.evaluate(fits)
            press(tab, key)
        tab.send("Page.navigate", url=stage.server.origin + "/hazards")
        wait_for(lambda: "sickness" in tab.evaluate("document.body?.innerText ?? ''"))
        keep_picture(tab, "hazards-360")
        assert tab.evaluate(fits)


def test_only_the_floor_is_drawn_before_the_first_picture(chromium: None, stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (800, 700)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        press(tab, "c")  # shows the colliders
        press(tab, "s")
        main = screenshot(tab)[100:300]
        colorful = main.max(axis=-1) - main.min(axis=-1) > 50
        assert colorful.sum() == 0
        assert (main.max(axis=-1) > 60).any()  # the lines of the floor


def test_the_page_gets_pictures_at_an_ipv6_address(chromium: None) -> None:
    try:
        with socket.socket(socket.AF_INET6) as asked:
            asked.bind(("::1", 0))
    except OSError:
        pytest.skip("this machine has no IPv6")
    stage = Stage(iter([capsule_body.painted(0)]), host="::1")
    try:
        with _chromium.open_address(stage.server.new_url(), (800, 700)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(1)
            assert tab.evaluate("manip3dLive.stats().frames") == 1
    finally:
        stage.server.stop()


@pytest.mark.parametrize("limb", ["right_arm", "right_leg"])
def test_the_card_leaves_the_limb_in_view_on_a_phone(chromium: None, limb: str) -> None:
    """The card of a waiting or paused game is below the arms, or above the legs."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate.sources import open_source

    address = simulated_patient(limb) + "&frames=20"
    stage = Stage(iter(open_source(address, threads=1)), limb)  # type: ignore[arg-type]
    try:
        with _chromium.open_address(stage.server.new_url(), (500, 900)) as tab:
            phone_or_desktop(tab, 390)
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(3)
            box = "document.querySelector('{}').getBoundingClientRect()"
            card, main = (
                json.loads(tab.evaluate(f"JSON.stringify({box.format(name)})"))
                for name in ("#card", "main")
            )
            middle = (main["top"] + main["bottom"]) / 2
        if limb == "right_leg":
            assert card["bottom"] < middle
        else:
            assert card["top"] > middle
    finally:
        stage.server.stop()


def test_the_phantom_hand_bursts_a_bubble_on_the_page(chromium: None, stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (1280, 800)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        assert tab.evaluate("location.search") == ""  # the token has left the address bar
        stage.show(20)
        assert "follows the intact limb" in text_of(tab, "#message")
        assert INTENDED_USE in text_of(tab, "#use")
        assert "when you are ready" in text_of(tab, "#card")

        plain = screenshot(tab)
        press(tab, "p")  # marks the phantom limb blue
        marked = screenshot(tab)
        blue = (np.abs(marked - plain).max(axis=-1) > 20) & (marked[..., 2] > marked[..., 0])
        main = blue[60:600]
        assert 200 < main.sum() < 30_000
        # In the mirror the right arm is on the right.
        assert np.nonzero(main)[1].min() > 640

        press(tab, " ")
        wait_for(lambda: stage.heard == ["ready"])
        own: dict[int, Any] = {}  # each event is told for a second
        for _ in range(300):
            stage.show(1)
            status = json.loads(tab.evaluate("JSON.stringify(manip3dLive.status())"))
            events = status["game"].get("events", [])
            own |= {e[7]: e for e in events if e[0] == "burst" and e[2] in PHANTOM_HAND}
            if own and status["state"] == "tracking":
                break
        assert own, "the phantom hand burst nothing"
        game = status["game"]
        assert game["phase"] == "playing"
        assert game["by_phantom"] == len(own)
        assert text_of(tab, "#score").startswith(f"Score {game['score']}")
        assert game["score"] >= game["by_phantom"] >= 1

        press(tab, " ")
        wait_for(lambda: stage.heard == ["ready", "stop"])
        stage.show(2)
        told = text_of(tab, "#card")
        assert told.startswith("Stopped")
        assert f"of these {game['by_phantom']} with the phantom limb" in told
        stats = tab.evaluate("manip3dLive.stats()")
        assert (stats["lost"], stats["bad"]) == (0, 0)
        assert stats["latencyMs"]["p50"] > 0
        assert stage.server.report()[-1]["latency_ms"] is not None
    assert dict(stage.server.refused) == {}


@pytest.mark.parametrize(
    ("game", "kind", "told"),
    [
        ("pedal", "stroke", "Strokes 1 and 1 of 8"),
        ("piano", "note", "Score 1"),
        ("bubbles-legs", "burst", "Score 1"),
    ],
)
def test_games_for_feet_are_played_with_the_phantom_leg(
    chromium: None, game: str, kind: str, told: str
) -> None:
    """The simulated patient draws up the toes, or steps; the phantom foot scores on the page."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate.sources import open_source

    address = simulated_patient("left_leg", game) + "&frames=300"
    frames = iter(open_source(address, threads=1))  # type: ignore[arg-type]
    stage = Stage(frames, "left_leg", game=game, seed=1)  # the first key is where the foot steps
    phantom_foot = 15
    try:
        with _chromium.open_address(stage.server.new_url(), (1000, 800)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(45)  # the foot has been on the floor
            assert text_of(tab, "#card").startswith(TITLES[game])
            idle = screenshot(tab)
            press(tab, " ")
            wait_for(lambda: stage.heard == ["ready"])
            told_by: dict[int, Any] = {}
            own: list[Any] = []
            status: dict[str, Any] = {}
            for _ in range(240):
                stage.show(1)
                status = json.loads(tab.evaluate("JSON.stringify(manip3dLive.status())"))
                told_by |= {event[7]: event for event in status["game"].get("events", [])}
                own = [e for e in told_by.values() if e[0] == kind and e[2] == phantom_foot]
                if own and status["state"] == "tracking":
                    break
            assert own, f"no {kind} by the phantom foot"
            assert status["game"]["by_phantom"] == len(own)
            assert told in text_of(tab, "#score") or status["game"]["score"] > 1
            playing = screenshot(tab)
            keep_picture(tab, f"{game}-playing")
            if game == "pedal":
                # The body is whole after the phantom limb has grown: no shoe between the feet.
                red, _, blue = np.moveaxis(playing[455:490, 492:520], -1, 0)
                assert not (red > blue + 20).any()
            assert (np.abs(playing - idle).max(axis=-1) > 40).sum() > 2000  # keys, or disks
            sounds = json.loads(tab.evaluate("JSON.stringify(manip3dLive.sounds())"))
            assert sounds[-1]["kind"] == kind
            if game == "piano":
                semitones = [0, 2, 4, 5, 7, 9, 11][own[-1][6]]
                assert sounds[-1]["hertz"] == pytest.approx(261.63 * 2 ** (semitones / 12), abs=0.1)
            press(tab, " ")
            wait_for(lambda: stage.heard == ["ready", "stop"])
            stage.show(2)
            assert text_of(tab, "#card").startswith("Stopped")
            keep_picture(tab, game)
    finally:
        stage.server.stop()


def test_a_played_game_and_the_pain_are_in_the_diary(chromium: None, tmp_path: Path) -> None:
    """Game and pain reach the diary and its FHIR export; pain that rises by 2 ends the play."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary, fhir_bundle
    from manip3d.phantom._diary import DiaryRecorder
    from manip3d.simulate.sources import open_source

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="right_arm")
    recorder = DiaryRecorder(path, "P01", None)
    address = simulated_patient("right_arm") + "&frames=200"
    stage = Stage(iter(open_source(address, threads=1)), recorder=recorder)  # type: ignore[arg-type]
    recorder.start()

    def say(value: int) -> None:
        before = len(stage.heard)
        rate(tab, value)
        wait_for(lambda: len(stage.heard) > before)
        stage.show(1)

    try:
        with _chromium.open_address(stage.server.new_url(), (1000, 800)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(3)
            say(3)
            wait_for(lambda: text_of(tab, "#pain-told") == "Noted: 3.")
            press(tab, " ")
            wait_for(lambda: stage.heard == ["pain", "ready"])
            stage.show(90)
            press(tab, " ")
            wait_for(lambda: stage.heard[-1] == "stop")
            stage.show(2)
            assert "How strong is the phantom pain now?" in text_of(tab, "#card")
            say(6)
            told = text_of(tab, "#card")
            assert told.startswith("Stop for today\n")
            assert "The pain rose from 3 to 6." in told
            assert tab.evaluate("document.querySelector('#start').disabled")
            keep_picture(tab, "diary")
            press(tab, " ")
            wait_for(lambda: stage.heard[-1] == "ready")
            stage.show(2)
            assert text_of(tab, "#card").startswith("Stop for today")
    finally:
        stage.server.stop()
        recorder.end()
    with Diary(path) as diary:
        (session,) = diary.sessions("P01")
        (game,) = session.games
        summary = stage.session.summaries[0]
        assert (game.game, game.ending, game.score) == ("bubbles", "stopped", summary.score)
        assert game.by_phantom == summary.by_phantom >= 1
        assert (session.pain_before, session.pain_after) == (3, 6)
        assert session.ended is not None
        assert [event.kind for event in diary.events("P01")] == ["pain"]
        kinds = [entry["resource"]["resourceType"] for entry in fhir_bundle(diary, "P01")["entry"]]
        assert (kinds.count("Observation"), kinds.count("AdverseEvent")) == (4, 1)


def phone_or_desktop(tab: _chromium.Tab, width: int) -> None:
    """Emulate a screen of this width, since windows of Chromium are at least 500 pixels wide."""
    tab.send(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=900,
        deviceScaleFactor=1,
        mobile=False,
    )
    assert tab.evaluate("innerWidth") == width


@pytest.mark.parametrize("width", [390, pytest.param(1280, marks=pytest.mark.slow)])
def test_set_up_touch_and_hazards_on_the_page(chromium: None, tmp_path: Path, width: int) -> None:
    """The diary keeps set-up, touch cue and hazards that a therapist enters on the page."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary
    from manip3d.phantom._diary import DiaryRecorder
    from manip3d.simulate.sources import open_source

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="right_arm")
    recorder = DiaryRecorder(path, "P01", None)
    address = simulated_patient("right_arm") + "&frames=400"
    stage = Stage(iter(open_source(address, threads=1)), recorder=recorder)  # type: ignore[arg-type]
    recorder.start()
    quotes = '"' * 480  # twice as long in JSON

    def click(selector: str) -> None:
        tab.evaluate(f"document.querySelector('{selector}').click()")

    def said(name: str) -> None:
        wait_for(lambda: name in stage.heard)
        stage.show(1)

    def picture(name: str) -> None:
        screenshot(tab)
        keep_picture(tab, f"{name}-{width}")
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")

    try:
        with _chromium.open_address(stage.server.new_url(), (width, 900)) as tab:
            phone_or_desktop(tab, width)
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(35)
            picture("live")
            press(tab, "u")
            assert text_of(tab, "#setup h2") == "1 of 5: Intended use"
            assert tab.evaluate("document.querySelector('#setup-next').disabled")
            picture("setup-1")
            click("#setup-read")
            click("#setup-next")
            stage.show(1)
            told = text_of(tab, "#setup")
            assert "2 of 5: Camera" in told
            assert "Distance." in told
            picture("setup-2")
            click("#setup-next")
            assert "This is the patient" in text_of(tab, "#setup")
            picture("setup-3")
            click("#setup-next")
            click("#setup-still")
            said("calibrate")
            assert "Hold still" in text_of(tab, "#setup")
            picture("setup-4")
            click("#setup-next")
            click("#setup-clips")
            said("consent")
            assert tab.evaluate("document.querySelector('#setup-clips').checked")
            picture("setup-5")
            press(tab, "u")
            assert tab.evaluate("document.querySelector('#setup').hidden")

            # The connection is lost while the therapist writes; the text is one that was pasted.
            stage.disconnect()
            wait_for(lambda: stage.server.num_clients == 0)
            pasted = json.dumps("a chair\tfell over" + quotes)
            tab.evaluate(f"document.querySelector('#event').value = {pasted}")
            click("#note")
            assert text_of(tab, "#event-told") == "Being noted."
            said("event")
            wait_for(lambda: text_of(tab, "#event-told") == "Noted.")
            assert tab.evaluate("document.querySelector('#event').value") == ""

            press(tab, "t")
            tab.evaluate("document.querySelector('#felt [name=length]').value = '60'")
            tab.evaluate("document.querySelector('#felt').requestSubmit()")
            said("felt")
            rate(tab, 2)  # else a touch would begin with nothing to compare the pain with
            said("pain")
            click("#touch-asynchronous")
            said("touch")
            ticks = "manip3dLive.sounds().filter(s => s.kind === 'touch').length"
            wait_for(lambda: (stage.show(1), tab.evaluate(ticks))[1] >= 1)
            picture("touch")
            assert "asynchronous: " in text_of(tab, "#touch")
            cue = stage.session._cue
            assert cue is not None
            cue.clock = _touch.SECONDS  # the minute is over
            stage.show(1)
            assert "How was it?" in text_of(tab, "#touch")
            picture("ownership")
            for number in range(1, 7):
                tab.evaluate(
                    f"document.querySelector('#ownership [name=q{number}]').value = '{number - 4}'"
                )
            tab.evaluate("document.querySelector('#ownership').requestSubmit()")
            said("ownership")
            assert "How was it?" not in text_of(tab, "#touch")

            tab.send("Page.navigate", url=stage.server.origin + "/hazards")
            wait_for(lambda: "sickness" in tab.evaluate("document.body?.innerText ?? ''"))
            picture("hazards")
    finally:
        stage.server.stop()
        recorder.end()
    assert dict(stage.server.refused) == {}
    with Diary(path) as diary:
        assert diary.participant("P01").clips
        assert [(e.kind, e.text) for e in diary.events("P01")] == [
            ("other", "a chair fell over" + quotes)
        ]
        (felt,) = diary.felt("P01")
        assert (felt.length, felt.telescoping, felt.raised, felt.bent) == (60, 0, 0, 0)
        (answers,) = diary.ownership("P01")
        assert (answers.mode, answers.answers) == ("asynchronous", (-3, -2, -1, 0, 1, 2))
        assert (answers.ownership, answers.control) == (-2.0, 1.0)


def test_what_the_patient_says_is_said_on_purpose(chromium: None, tmp_path: Path) -> None:
    """Ratings, sickness and the end of a session need deliberate input, also after a reload."""
    pytest.importorskip("sqlalchemy", reason="the extra 'diary' is not installed")
    from manip3d.diary import Diary
    from manip3d.phantom._diary import DiaryRecorder

    path = tmp_path / "study.diary"
    with Diary(path, create=True) as diary:
        diary.enrol("P01", limb="right_arm")
    recorder = DiaryRecorder(path, "P01", None)
    frames = (capsule_body.painted(number % 40) for number in itertools.count())
    numbered = (
        replace(frame, time_ns=number * 33_333_333, number=number)
        for number, frame in enumerate(frames)
    )
    stage = Stage(numbered, recorder=recorder)
    recorder.start()

    def click(selector: str) -> None:
        tab.evaluate(f"document.querySelector('{selector}').click()")

    def is_seen(selector: str) -> bool:
        return bool(tab.evaluate(f"!!document.querySelector('{selector}').offsetParent"))

    def said(*names: str) -> None:
        wait_for(lambda: stage.heard == list(names))
        stage.heard.clear()
        stage.show(2)

    try:
        with _chromium.open_address(stage.server.new_url(), (1000, 900)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(3)
            tab.evaluate("document.querySelector('#pain').focus()")
            for _ in range(4):
                type_key(tab, "ArrowDown", 40)
            stage.show(2)
            assert tab.evaluate("document.querySelector('#pain').value") == "3"
            assert stage.heard == []  # looked at, not said
            type_key(tab, "Tab", 9)
            type_key(tab, "Enter", 13, "\r")
            said("pain")
            wait_for(lambda: text_of(tab, "#pain-told") == "Noted: 3.")

            tab.evaluate("document.querySelector('#event').focus()")
            tab.send("Input.insertText", text="a chair fell over")
            type_key(tab, "Enter", 13, "\r")
            said("event")
            wait_for(lambda: text_of(tab, "#event-told") == "Noted.")

            # While a ball touches the limb, the key and the button stop it.
            stage.session.command("touch", {"mode": "synchronous"})
            stage.show(2)
            assert text_of(tab, "#start") == "Stop"
            press(tab, " ")
            said("stop")
            assert stage.session._cue is None
            assert text_of(tab, "#start") == "Start when ready"

            # A cue that is over is asked about on a page that was loaded since.
            stage.session.command("touch", {"mode": "synchronous"})
            stage.show(2)
            tab.send("Page.reload")
            wait_for(lambda: len(stage.server.report()) == 2 and stage.server.num_clients == 1)
            assert stage.session._cue is not None
            stage.session._cue.clock = _touch.SECONDS
            stage.show(2)
            press(tab, "t")
            stage.show(1)
            assert "How was it?" in text_of(tab, "#touch")
            press(tab, "t")

            click("#unwell")
            assert is_seen("#sure")
            keep_picture(tab, "sure")
            click("#well")
            assert not is_seen("#sure")
            stage.show(2)
            assert stage.heard == []
            press(tab, " ")
            said("ready")
            assert stage.session._play.game is not None
            click("#unwell")
            said("stop")  # the play ends at once
            click("#well")

            assert not is_seen("#unanswered")
            press(tab, "q")
            said("enough")
            assert is_seen("#unanswered")
            assert text_of(tab, "#card").startswith("Session over\n")
            assert tab.evaluate("document.querySelector('#start').disabled")
            assert "How strong is the phantom pain now?" in text_of(tab, "#card")
            keep_picture(tab, "enough")
            press(tab, " ")
            said("ready")
            rate(tab, 2)
            said("pain")
            assert "This session is over." in text_of(tab, "#card")
            assert text_of(tab, "#start") == "Begin another session"
            click("#start")
            said("again")
            rate(tab, 4)
            said("pain")
            press(tab, "q")
            said("enough")
            click("#unanswered")  # of a patient who gives no last rating
            said("unanswered")
            assert "This session is over." in text_of(tab, "#card")
            assert not is_seen("#unanswered")
            click("#start")
            said("again")
            rate(tab, 4)
            said("pain")
            click("#unwell")
            click("#sick")
            said("unwell")
            assert text_of(tab, "#card").startswith("Stop for today\n")
            assert "when you are ready" not in text_of(tab, "#card")
    finally:
        stage.server.stop()
        recorder.end()
    with Diary(path) as diary:
        first, second, third = diary.sessions("P01")
        assert [rating.pain for rating in first.ratings] == [3, 2]
        assert [rating.pain for one in (second, third) for rating in one.ratings] == [4, 4]
        assert [one.answered for one in (first, second, third)] == [True, False, True]
        assert [event.kind for event in diary.events("P01")] == ["other", "sickness"]
    assert dict(stage.server.refused) == {}


def test_entries_that_a_lost_program_has_not_noted_are_counted_and_kept(chromium: None) -> None:
    """The program is started anew at the same port: the page says what its new address lacks."""
    stage = Stage(capsule_body.painted(number) for number in range(40))
    try:
        with _chromium.open_address(stage.server.new_url(), (1000, 900)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(2)
            assert tab.evaluate(LEAVES)
            tab.evaluate("document.querySelector('#asking').hidden = false")
            tab.send("Network.clearBrowserCookies")  # as those of another program
            stage.disconnect()
            wait_for(lambda: text_of(tab, "#state") == "No connection")
            assert "not noted" not in text_of(tab, "#status")
            press(tab, "q")  # ends a session, which is over with its program
            assert "not noted" not in text_of(tab, "#status")
            rate(tab, 5)
            told = text_of(tab, "#status")
            assert told.startswith("No connection")
            assert told.endswith(
                "1 entry is not noted yet: write it down, and enter it again there."
            )
            assert text_of(tab, "#pain-told") == "Being noted: 5."
            click_at(tab, "#unwell")
            click_at(tab, "#sick")
            told = text_of(tab, "#status")
            assert "2 entries are not noted yet: write them down" in told
            press(tab, "e")
            assert text_of(tab, "#status") == told
            assert not tab.evaluate(LEAVES)
            assert stage.heard == []
    finally:
        stage.server.stop()


def test_the_space_bar_stops_a_game_wherever_the_focus_is(chromium: None) -> None:
    """A button keeps the focus after a click, and would take the space bar for itself."""
    stage = Stage(capsule_body.painted(number % 40) for number in itertools.count())
    skeleton = "[title='Key S']"
    is_pressed = f'document.querySelector("{skeleton}").ariaPressed'

    def space(*heard: str) -> None:
        type_key(tab, " ", 32, " ")
        tab.evaluate("new Promise(requestAnimationFrame)")
        wait_for(lambda: stage.heard == list(heard))
        stage.heard.clear()
        stage.show(2)

    try:
        with _chromium.open_address(stage.server.new_url(), (1000, 900)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(3)
            click_at(tab, "#start")
            wait_for(lambda: stage.heard == ["ready"])
            stage.heard.clear()
            stage.show(1)
            for button in ("#open-setup", "#setup-read", "#setup .row button:last-child"):
                click_at(tab, button)
                assert not tab.evaluate("document.activeElement.matches('button, input')")
            assert tab.evaluate("document.querySelector('#setup').hidden")
            space("stop")
            for holder in ("#open-touch", "#start", "#game"):  # as the Tab key leaves it
                space("ready")
                tab.evaluate(f"document.querySelector('{holder}').focus()")
                space("stop")
                assert tab.evaluate("document.querySelector('#touch').hidden")
            tab.evaluate(f'document.querySelector("{skeleton}").focus()')
            space()  # no game runs: the button has the key
            assert tab.evaluate(is_pressed) == "true"

            tab.evaluate("document.activeElement.blur()")
            space("ready")
            tab.evaluate("document.querySelector('#asking').hidden = false")
            click_at(tab, "#event")
            space()
            assert tab.evaluate("document.querySelector('#event').value") == " "
            click_at(tab, "#unwell")
            stage.show(2)
            wait_for(lambda: stage.heard == ["stop"])
            stage.heard.clear()
            space("ready")  # not the answer to whether the patient is sick
    finally:
        stage.server.stop()


def test_a_second_screen_joins_by_a_short_code(chromium: None) -> None:
    """A second screen joins by a short code, since long addresses are hard to type in a headset."""
    frames = iter([capsule_body.painted(number) for number in range(8)])
    stage = Stage(frames)

    def code_of(tab: _chromium.Tab) -> str:
        tab.evaluate("document.querySelector('#add-screen').click()")
        wait_for(lambda: "/join and type" in text_of(tab, "#screen-told"))
        told = text_of(tab, "#screen-told")
        assert f"There open {stage.server.origin}/join" in told
        assert told.endswith("for other devices start with --host.")
        return told.partition(" type ")[2][:9]

    def join(tab: _chromium.Tab, code: str) -> None:
        field = "document.querySelector('#code')"
        wait_for(lambda: tab.evaluate(f"!!{field}"))
        tab.evaluate(f"{field}.value = '{code}'; {field}.form.requestSubmit()")
        wait_for(lambda: stage.server.num_clients == 2)
        assert tab.evaluate("location.pathname + location.search") == "/"

    try:
        with _chromium.open_address(stage.server.new_url(), (800, 700)) as first:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(2)
            code = code_of(first)
            keep_picture(first, "add-screen")
            with _chromium.open_address(stage.server.origin + "/join", (800, 700)) as second:
                keep_picture(second, "join")
                join(second, code)
                stage.show(2)
                # A browser that has lost its cookie comes back in the same way.
                code = code_of(second)
                first.send("Network.clearBrowserCookies")
                first.send("Page.reload")
                wait_for(lambda: stage.server.num_clients == 1)
                first.send("Page.navigate", url=stage.server.origin + "/join")
                join(first, code)
                stage.show(1)
    finally:
        stage.server.stop()


def test_a_reload_rejoins_and_the_gate_speaks(chromium: None, stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (420, 800)) as tab:
        phone_or_desktop(tab, 420)
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(3)
        tab.send("Page.reload")
        wait_for(lambda: len(stage.server.report()) == 2 and stage.server.num_clients == 1)
        stage.show(3)
        before = stage.acknowledged()
        message = stage.session.notice("The camera is gone: check its cable.")
        sequence = stage.session.sequence - 1
        stage.server.publish(message, sequence=sequence, captured_ns=time.time_ns())
        wait_for(lambda: stage.acknowledged() == before + 1)
        assert text_of(tab, "#status") == "Not visible The camera is gone: check its cable."
        # Nothing is wider than the window of a phone.
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
        press(tab, "l")
        assert tab.evaluate("getComputedStyle(document.documentElement).fontSize") == "24px"
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_a_limb_that_nobody_has_described_has_sliders_of_its_own(
    chromium: None, stage: Stage
) -> None:
    length = "document.querySelector('#felt [name=length]').value"
    with _chromium.open_address(stage.server.new_url(), (640, 480)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        told = {"length": 60, "telescoping": 0, "raised": 0, "bent": 0}
        stage.session.command("felt", told)
        stage.show(1)
        assert tab.evaluate(length) == "60"
        stage.session.command("limb", {"limb": "left_arm"})
        stage.show(2)
        assert tab.evaluate(length) == "100"


class WithoutClock(Stage):
    """A stage that answers no question about its clock before ``answer_clock`` is called."""

    def __init__(self, frames: Iterator[RgbdFrame]) -> None:
        self.asked: list[tuple[StreamClient, str]] = []
        self.answers = False
        super().__init__(frames)

    def _hear(self, client: StreamClient, text: str) -> None:
        if not self.answers and json.loads(text)["type"] == "clock":
            self.asked.append((client, text))
            return
        super()._hear(client, text)

    def answer_clock(self) -> None:
        self.answers = True
        for client, text in self.asked:
            super()._hear(client, text)


def test_no_latency_is_stated_before_the_clocks_are_compared(chromium: None) -> None:
    """The clock of a headset may be seconds off."""
    stage = WithoutClock(capsule_body.painted(number) for number in range(40))
    try:
        with _chromium.open_address(stage.server.new_url(), (640, 480)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(3)
            assert tab.evaluate("manip3dLive.stats().frames") == 3
            assert tab.evaluate("manip3dLive.stats().latencyMs") is None
            assert stage.server.report()[-1]["latency_ms"] is None
            wait_for(lambda: stage.asked)
            stage.answer_clock()
            wait_for(lambda: tab.evaluate("Number.isFinite(manip3dLive.stats().clockWithinMs)"))
            stage.show(1)
            assert tab.evaluate("manip3dLive.stats().latencyMs") is not None
            assert stage.server.report()[-1]["latency_ms"] is not None
    finally:
        stage.server.stop()


def test_a_text_that_is_no_message_does_no_harm(chromium: None, stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (640, 480)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        tab.evaluate("window.failures = []; addEventListener('error', () => failures.push(1)); 0")
        for client, _ in tuple(stage.server._clients.values()):
            client.say("{")
        stage.show(1)
        assert tab.evaluate("failures.length") == 0


def test_bad_frames_are_counted_and_do_no_harm(chromium: None, stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (640, 480)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(1)
        message = stage.session.process(next(stage.frames), captured_ns=1)
        assert message is not None
        kinds = (message[: len(message) // 2], b"M3DL" + bytes(100), b"")
        bad = kinds * 2  # more than may stay unacknowledged
        for number, content in enumerate(bad, 1):
            stage.server.publish(content, sequence=10_000 + number, captured_ns=0)
            wait_for(lambda: tab.evaluate("manip3dLive.stats().bad") == number)  # noqa: B023
        assert tab.evaluate("manip3dLive.stats().frames") == 1
        wait_for(lambda: text_of(tab, "#status").startswith("No picture For"))
        stage.show(2)
        assert tab.evaluate("manip3dLive.stats().frames") == 3
        assert text_of(tab, "#status").startswith("Following")
        report = stage.server.report()[-1]
        assert (report["unreadable"], report["acknowledged"]) == (len(bad), 3)


def test_a_browser_without_webgl_says_so_and_all_else_works(chromium: None, stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (1000, 700)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        assert text_of(tab, "#blind") == ""
        source = "HTMLCanvasElement.prototype.getContext = () => null"
        tab.send("Page.addScriptToEvaluateOnNewDocument", source=source)
        tab.send("Page.reload")
        wait_for(lambda: len(stage.server.report()) == 2 and stage.server.num_clients == 1)
        stage.show(2)
        keep_picture(tab, "without-webgl")
        assert text_of(tab, "#blind").startswith("This browser draws no 3D pictures (WebGL).")
        assert text_of(tab, "#status").startswith("Following")
        press(tab, " ")
        wait_for(lambda: "ready" in stage.heard)
        stage.show(2)
        assert tab.evaluate("manip3dLive.status().game.phase") == "playing"
        press(tab, "d")  # another way to draw
        stage.show(1)


def test_who_types_goes_through_a_list_to_its_end(chromium: None, stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (1000, 700)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(1)
        tab.evaluate("document.getElementById('difficulty').focus()")
        for value in ("2", "3"):
            type_key(tab, "ArrowDown", 40)
            wait_for(lambda: tab.evaluate("document.getElementById('difficulty').value") == value)  # noqa: B023
        wait_for(lambda: stage.heard.count("choose") == 2)
        stage.show(1)
        assert tab.evaluate("manip3dLive.status().game.difficulty") == 3
        # With a pointer the list is let go of, and the page's keys work at once.
        tab.evaluate(
            "document.dispatchEvent(new PointerEvent('pointerdown')), "
            "document.getElementById('difficulty').dispatchEvent(new Event('change'))"
        )
        assert tab.evaluate("document.activeElement === document.body")

        press(tab, "u")
        tab.evaluate("document.getElementById('setup-read').click()")
        for _ in range(2):
            tab.evaluate("document.getElementById('setup-next').click()")
        stage.show(1)
        tab.evaluate("document.getElementById('setup-limb').focus()")
        for count in (1, 2):
            type_key(tab, "ArrowDown", 40)
            wait_for(lambda: stage.heard.count("limb") == count)  # noqa: B023
            stage.show(1)
        assert tab.evaluate("document.activeElement.id") == "setup-limb"
