"""A live session with a page in a real browser, in lock-step, for tests."""

from __future__ import annotations

import asyncio
import base64
import io
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from manip3d.phantom import MESSAGES, LiveSession
from manip3d.phantom._live import hear
from manip3d.phantom._messages import CONNECTION_MESSAGES
from manip3d.phantom._page import live_pages
from manip3d.phantom._recorder import Recorder
from manip3d.rgbd import RgbdFrame
from manip3d.serve import Certificate, LocalServer, StreamClient, read_message
from manip3d.viewer import _chromium
from waiting import wait_for


class Stage:
    """A session with its server; each frame is shown by the page before the next one is sent."""

    def __init__(
        self,
        frames: Iterator[RgbdFrame],
        limb: str = "right_arm",
        recorder: Recorder | None = None,
        host: str = "127.0.0.1",
        certificate: Certificate | None = None,
        **options: Any,
    ) -> None:
        self.session = LiveSession(limb, recorder=recorder, **{"seed": 3, **options})  # type: ignore[arg-type]
        self.frames = frames
        pages = live_pages(limb, "sim:body", asks=recorder is not None)
        self.server = LocalServer(pages, self._hear, host=host, certificate=certificate).start()
        self.heard: list[str] = []

    def _hear(self, client: StreamClient, text: str) -> None:
        hear(self.session, client, text, self.server.new_code)
        name = read_message(text, MESSAGES)[0]
        if name not in CONNECTION_MESSAGES:
            self.heard.append(name)

    def disconnect(self) -> None:
        """End all streams, as a network does that fails for a moment."""
        assert self.server._loop is not None
        for _, stream in tuple(self.server._clients.values()):
            asyncio.run_coroutine_threadsafe(stream.close(), self.server._loop)

    def show(self, count: int) -> None:
        """Send frames, and wait after each one until the page has decoded it."""
        for _ in range(count):
            captured = time.time_ns()
            sequence = self.session.sequence
            message = self.session.process(next(self.frames), captured_ns=captured)
            assert message is not None
            before = self.acknowledged()
            self.server.publish(message, sequence=sequence, captured_ns=captured)
            wait_for(lambda: self.acknowledged() == before + 1)  # noqa: B023

    def acknowledged(self) -> int:
        return int(self.server.report()[-1]["acknowledged"])


def press(tab: _chromium.Tab, key: str) -> None:
    tab.evaluate(f"document.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")


def type_key(tab: _chromium.Tab, key: str, code: int, text: str = "") -> None:
    """Type a key into the browser; ``press`` only dispatches an event to the page."""
    about = {"key": key, "code": key, "windowsVirtualKeyCode": code}
    tab.send("Input.dispatchKeyEvent", type="keyDown", text=text, **about)
    tab.send("Input.dispatchKeyEvent", type="keyUp", **about)


def click_at(tab: _chromium.Tab, selector: str) -> None:
    """Click an element with the pointer, which gives it the focus; its ``click()`` does not."""
    box = tab.evaluate(
        f"(e => (e.scrollIntoView({{block: 'center'}}), e.getBoundingClientRect().toJSON()))"
        f"(document.querySelector('{selector}'))"
    )
    at = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
    for kind in ("mousePressed", "mouseReleased"):
        tab.send("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **at)


def rate(tab: _chromium.Tab, value: int) -> None:
    """Say how strong the pain is."""
    tab.evaluate(
        f"document.querySelector('#pain').value = '{value}';"
        "document.querySelector('#rating').requestSubmit()"
    )


def text_of(tab: _chromium.Tab, selector: str) -> str:
    return str(tab.evaluate(f"document.querySelector('{selector}').innerText"))


def keep_picture(tab: _chromium.Tab, name: str) -> None:
    """Save a screenshot for people if MANIP3D_PICTURES names a folder."""
    folder = os.environ.get("MANIP3D_PICTURES")
    if folder:
        content = base64.b64decode(tab.send("Page.captureScreenshot", format="png")["data"])
        (Path(folder) / f"{name}.png").write_bytes(content)


def screenshot(tab: _chromium.Tab) -> NDArray[np.int16]:
    from PIL import Image

    # The page draws earlier commands with the next picture but one.
    tab.evaluate("new Promise(d => requestAnimationFrame(() => requestAnimationFrame(d)))")
    content = base64.b64decode(tab.send("Page.captureScreenshot", format="png")["data"])
    with Image.open(io.BytesIO(content)) as image:
        return np.asarray(image.convert("RGB")).astype(np.int16)
