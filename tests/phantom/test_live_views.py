"""Views of the live page: side by side, first person, and in an emulated headset (iwer)."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from live_stage import Stage, keep_picture, press, screenshot, text_of
from numpy.typing import NDArray

import capsule_body
from manip3d.phantom import simulated_patient
from manip3d.serve import make_certificate
from manip3d.viewer import _chromium
from manip3d.viewer.page import BUNDLE
from waiting import wait_for

EMULATOR = BUNDLE.parents[1] / "node_modules" / "iwer" / "build" / "iwer.min.js"
PHANTOM_HAND = {10, 11, 23, 24}


@pytest.fixture
def stage(chromium: None, request: pytest.FixtureRequest) -> Iterator[Stage]:
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate.sources import open_source

    motion = getattr(request, "param", "arm-raise")
    address = simulated_patient("right_arm").replace("arm-raise", motion) + "&frames=400"
    found = Stage(iter(open_source(address, threads=1)))  # type: ignore[arg-type]
    yield found
    found.server.stop()


def test_side_by_side_shows_two_pictures_that_differ_by_the_eyes(stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (1280, 900)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(20)
        press(tab, "d")
        assert tab.evaluate("document.querySelector('#way').value") == "side-by-side"
        assert not tab.evaluate("document.querySelector('#card').offsetParent")
        assert "when you are ready" in tab.evaluate("manip3dLive.panel()")
        image = screenshot(tab)
        keep_picture(tab, "side-by-side")
        left, right = image[60:500, :640], image[60:500, 640:]
        drawn = [(np.abs(half - half[0, 0]).max(axis=-1) > 40) for half in (left, right)]
        assert drawn[0].sum() > 8_000  # a person in each half
        assert drawn[1].sum() == pytest.approx(drawn[0].sum(), rel=0.05)
        assert (left != right).any()
        # Parallax between the eyes is a few pixels only.
        columns = [np.nonzero(half)[1].mean() for half in drawn]
        assert abs(columns[0] - columns[1]) < 12
        press(tab, "d")
        assert tab.evaluate("manip3dLive.panel()") is None


@pytest.mark.parametrize("stage", ["reach"], indirect=True)
def test_from_ones_own_eyes_what_the_camera_cannot_see_is_hatched(stage: Stage) -> None:
    with _chromium.open_address(stage.server.new_url(), (1280, 900)) as tab:
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(30)  # the arms are stretched out
        outside = tab.evaluate("manip3dLive.eye()")
        press(tab, "e")
        stage.show(3)
        screenshot(tab)  # pictures have been drawn since
        head = json.loads(tab.evaluate("JSON.stringify(manip3dLive.status().joints[3])"))
        eye = tab.evaluate("manip3dLive.eye()")
        # The scene has y up and z towards the camera; the eyes are before and above that joint.
        there = np.array([head[0], -head[1], -head[2]])
        assert np.linalg.norm(np.array(eye) - there) < 0.15
        assert np.linalg.norm(np.array(eye) - np.array(outside)) > 1.0
        assert eye[2] > there[2]  # ahead is towards the camera, which the person faces
        assert "hatched" in text_of(tab, "#status")
        image = screenshot(tab)
        keep_picture(tab, "own-eyes")
        red, green, blue = np.moveaxis(image[260:600], -1, 0)
        assert ((red > 90) & (red > blue + 20)).sum() > 5_000  # both arms, stretched out
        # The camera sees them from above as the eyes do; of the hands some is seen from behind.
        assert ((red > blue + 70) & (green > blue + 50)).sum() > 50  # yellow stripes
        press(tab, "e")
        stage.show(1)
        assert "hatched" not in text_of(tab, "#status")
        back = np.array(tab.evaluate("manip3dLive.eye()"))
        assert np.linalg.norm(back - np.array(outside)) < 0.01


def test_the_view_goes_along_when_another_vertical_is_measured(chromium: None) -> None:
    """The view stays in place when the floor corrects the vertical of a seated person."""
    pytest.importorskip("open3d", reason="the extra 'simulate' is not installed")
    from manip3d.simulate import BodySimulator

    options: dict[str, Any] = {
        "motion": "still",
        "sitting": True,
        "amputated": "right_arm",
        "tilt": 25.0,
        "threads": 1,
    }
    bare, room = (BodySimulator(**options, room=has_room) for has_room in (False, True))
    stage = Stage(iter([*bare[:4], *room[4:8]]))

    def seen() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the vertical, and the vector from the middle of the person to the viewer's eye."""
        told = json.loads(tab.evaluate("JSON.stringify(manip3dLive.status())"))
        middle = np.array(told["joints"][1]) * (0.0, -1.0, -1.0)  # as the scene has it
        return np.array(told["down"]), np.array(tab.evaluate("manip3dLive.eye()")) - middle

    try:
        with _chromium.open_address(stage.server.new_url(), (1280, 900)) as tab:
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(4)
            screenshot(tab)
            before = seen()
            stage.show(4)
            screenshot(tab)
            after = seen()
    finally:
        stage.server.stop()
    assert np.degrees(np.arcsin(after[0][2])) == pytest.approx(25.0, abs=0.5)
    assert after[0][2] - before[0][2] > 0.05
    np.testing.assert_allclose(after[1], before[1], atol=0.03)


def test_a_headset_on_the_network_gets_the_page_encrypted(chromium: None) -> None:
    """HTTPS makes WebXR available at an address that is not loopback."""
    pytest.importorskip("cryptography", reason="the extra 'live' is not installed")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        try:
            asked.connect(("192.0.2.1", 9))  # nothing is sent
        except OSError:
            pytest.skip("this machine has no network")
        host = asked.getsockname()[0]
    frames = iter([capsule_body.painted(number) for number in range(12)])
    stage = Stage(frames, host=host, certificate=make_certificate(host))
    try:
        with _chromium.open_address("about:blank", (640, 480)) as tab:
            # Accept the certificate, as a user does after comparing the fingerprint.
            tab.send("Security.setIgnoreCertificateErrors", ignore=True)
            tab.send("Page.navigate", url=stage.server.new_url())
            wait_for(lambda: stage.server.num_clients == 1)
            stage.show(5)
            assert tab.evaluate("isSecureContext")
            assert tab.evaluate("location.origin") == f"https://{host}:{stage.server.port}"
            assert tab.evaluate("'xr' in navigator")
            wait_for(lambda: tab.evaluate("manip3dLive.stats().clockWithinMs") is not None)
            stage.show(5)
            stats = tab.evaluate("manip3dLive.stats()")
            assert (stats["frames"], stats["lost"], stats["bad"]) == (10, 0, 0)
            assert 0 < stats["clockWithinMs"] < 500  # two clocks of one machine
            assert -500 < stats["latencyMs"]["p50"] < 5000
        assert dict(stage.server.refused) == {}
    finally:
        stage.server.stop()


DEVICE = """
;globalThis.device = new IWER.XRDevice(IWER.metaQuest3);
device.stereoEnabled = true;
device.installRuntime({forceInstall: true});
delete globalThis.XRWebGLBinding; // of the browser itself; it takes no emulated session
device.position.set(0, 1.6, 0);
"""


def entered(tab: _chromium.Tab, url: str, stage: Stage) -> None:
    """Open the page with an emulated headset, and enter it."""
    tab.send("Page.addScriptToEvaluateOnNewDocument", source=EMULATOR.read_text() + DEVICE)
    tab.send("Page.navigate", url=url)
    wait_for(lambda: stage.server.num_clients == 1)
    stage.show(10)
    wait_for(lambda: tab.evaluate("document.querySelector('#headset')?.hidden === false"))
    tab.evaluate("document.querySelector('#headset').click()")
    wait_for(lambda: text_of(tab, "#headset") == "Leave headset")


def trigger(tab: _chromium.Tab) -> None:
    """Press and let go of the right controller's trigger."""
    for value in (1, 0):
        tab.evaluate(f"device.controllers.right.updateButtonValue('trigger', {value})")
        tab.evaluate("new Promise(d => setTimeout(d, 300))")


def hold_grip(tab: _chromium.Tab, ms: int) -> None:
    """Hold the right controller's squeeze button."""
    tab.evaluate("device.controllers.right.updateButtonValue('squeeze', 1)")
    tab.evaluate(f"new Promise(d => setTimeout(d, {ms}))")
    tab.evaluate("device.controllers.right.updateButtonValue('squeeze', 0)")
    tab.evaluate("new Promise(d => setTimeout(d, 300))")


def test_a_bubble_is_burst_in_a_headset(stage: Stage) -> None:
    if not EMULATOR.is_file():
        pytest.skip("the emulator is not installed: make setup")
    # Pictures for two eyes, drawn by the processor: a small page.
    with _chromium.open_address("about:blank", (640, 450)) as tab:
        entered(tab, stage.server.new_url(), stage)
        stage.show(2)
        assert "the trigger of a controller" in tab.evaluate("manip3dLive.panel()")
        image = screenshot(tab)
        keep_picture(tab, "headset")
        left, right = image[30:250, :320], image[30:250, 320:]
        assert (left != right).any()
        for half in (left, right):
            assert (np.abs(half - half[0, 0]).max(axis=-1) > 40).sum() > 1250

        trigger(tab)
        wait_for(lambda: stage.heard == ["ready"])
        own: dict[int, Any] = {}
        for _ in range(300):
            stage.show(1)
            status = json.loads(tab.evaluate("JSON.stringify(manip3dLive.status())"))
            events = status["game"].get("events", [])
            own |= {e[7]: e for e in events if e[0] == "burst" and e[2] in PHANTOM_HAND}
            if own:
                break
        assert own, "the phantom hand burst nothing"
        assert tab.evaluate("manip3dLive.pulses()")[-1]["hand"] in ("left", "right")
        keep_picture(tab, "headset-playing")
        assert "Score" in tab.evaluate("manip3dLive.panel()")

        # Through one's own eyes: the emulated head is where the joints say.
        press(tab, "e")
        stage.show(2)
        screenshot(tab)
        status = json.loads(tab.evaluate("JSON.stringify(manip3dLive.status())"))
        x, y, z = status["joints"][3]
        eye = np.array(tab.evaluate("manip3dLive.eye()"))
        assert np.linalg.norm(eye - np.array([x, -y, -z])) < 0.25
        keep_picture(tab, "headset-own-eyes")

        # A grip that is pressed for a moment says nothing, one that is held that it is enough.
        assert "hold the grip of a controller" in tab.evaluate("manip3dLive.panel()")
        stage.heard.clear()
        hold_grip(tab, 300)
        stage.show(1)
        assert stage.heard == []
        hold_grip(tab, 1500)
        wait_for(lambda: stage.heard == ["enough"])
        stage.show(2)
        assert tab.evaluate("manip3dLive.panel()").startswith("Session over")
        keep_picture(tab, "headset-enough")
        trigger(tab)  # begins nothing by mistake
        stage.show(2)
        assert stage.session._sitting.state == "over"

        tab.evaluate("document.querySelector('#headset').click()")
        wait_for(lambda: text_of(tab, "#headset") == "Enter headset")
        stage.show(2)
        assert tab.evaluate("manip3dLive.panel()") is None
        assert tab.evaluate("manip3dLive.stats().bad") == 0


def test_a_headset_that_does_not_start_says_why(stage: Stage) -> None:
    """The reason stays on the page when the next pictures arrive."""
    refusing = (
        "Object.defineProperty(navigator, 'xr', {value: {isSessionSupported: async () => true, "
        "requestSession: async () => { throw new Error('it is in use'); }}})"
    )
    with _chromium.open_address("about:blank", (640, 450)) as tab:
        tab.send("Page.addScriptToEvaluateOnNewDocument", source=refusing)
        tab.send("Page.navigate", url=stage.server.new_url())
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(2)
        wait_for(lambda: tab.evaluate("document.querySelector('#headset')?.hidden === false"))
        tab.evaluate("document.querySelector('#headset').click()")
        wait_for(lambda: text_of(tab, "#headset-told") != "")
        stage.show(3)
        assert text_of(tab, "#headset-told") == "The headset did not start: it is in use"
        assert text_of(tab, "#headset") == "Enter headset"


def test_a_headset_that_shows_no_picture_is_let_go(stage: Stage) -> None:
    """A headset session that cannot draw is ended, so that it can be entered again."""
    useless = """
        class Session extends EventTarget {
          async end() {
            window.numEnded = (window.numEnded ?? 0) + 1;
            this.dispatchEvent(new Event('end'));
          }
          updateRenderState() { throw new Error('it has no screen'); }
        }
        window.XRWebGLLayer = class {};
        delete window.XRWebGLBinding;
        WebGL2RenderingContext.prototype.makeXRCompatible = async () => {
          if (!window.numEnded) throw new Error('it is on another graphics card');
        };
        Object.defineProperty(navigator, 'xr', {value: {isSessionSupported: async () => true,
          requestSession: async () => new Session()}});
    """
    with _chromium.open_address("about:blank", (640, 450)) as tab:
        tab.send("Page.addScriptToEvaluateOnNewDocument", source=useless)
        tab.send("Page.navigate", url=stage.server.new_url())
        wait_for(lambda: stage.server.num_clients == 1)
        stage.show(2)
        wait_for(lambda: tab.evaluate("document.querySelector('#headset')?.hidden === false"))
        size = "JSON.stringify([document.querySelector('canvas').width, devicePixelRatio])"
        before = tab.evaluate(size)
        for num_ended, reason in enumerate(
            ("it is on another graphics card", "it has no screen"), 1
        ):
            tab.evaluate("document.querySelector('#headset').click()")
            why = f"The headset did not start: {reason}"
            wait_for(lambda why=why: text_of(tab, "#headset-told") == why)
            assert text_of(tab, "#headset") == "Enter headset"
            assert tab.evaluate("window.numEnded") == num_ended
            assert tab.evaluate(size) == before
