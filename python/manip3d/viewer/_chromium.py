"""Pictures drawn by the viewer's page in a headless Chromium, which is controlled by a pipe."""

from __future__ import annotations

import base64
import contextlib
import fcntl
import io
import itertools
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from manip3d.errors import RenderError
from manip3d.viewer.scene import Camera, Style, downsampled, pillow

if TYPE_CHECKING:
    from manip3d.mesh import Mesh
    from manip3d.viewer.points import DrawnPoints
    from manip3d.viewer.scene import Image

PROGRAMS = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome")
SUPERSAMPLING = 2
SECONDS = 60.0  # time limit of a page; software rendering of 360 000 faces takes 5 s

_ENDED = "Chromium ended before it answered"

# Chromium reads commands from descriptor 3 and writes answers to 4 [--remote-debugging-pipe].
_LAUNCH = (
    "import os, sys; os.dup2(int(sys.argv[1]), 3); os.dup2(int(sys.argv[2]), 4); "
    "os.execv(sys.argv[3], sys.argv[3:])"
)


def program() -> str:
    """Return the path of this machine's Chromium."""
    found = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if found is None:
        raise RenderError(f"none of {', '.join(PROGRAMS)} is installed")
    return found


class Tab:
    """A page in a headless browser."""

    def __init__(self, commands: int, answers: int) -> None:
        self._commands = commands
        self._answers = answers
        self._buffer = b""
        self._numbers = itertools.count(1)
        self._session: str | None = None
        self.patience = SECONDS
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        attached = self.send("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the DevTools protocol and return its result."""
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._write(json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + self.patience
        while True:
            answer = self._next_message(deadline)
            if answer.get("id") == number:
                break
        if "error" in answer:
            raise RenderError(f"Chromium refused {method}: {answer['error'].get('message')}")
        result: dict[str, Any] = answer["result"]
        return result

    def _write(self, rest: bytes) -> None:
        try:
            while rest:
                rest = rest[os.write(self._commands, rest) :]
        except BrokenPipeError:
            raise RenderError(_ENDED) from None

    def _next_message(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            left = max(0.0, deadline - time.monotonic())
            ready, _, _ = select.select([self._answers], [], [], left)
            if not ready:
                raise RenderError(f"Chromium gave no answer within {self.patience:.0f} s")
            received = os.read(self._answers, 1 << 20)
            if not received:
                raise RenderError(_ENDED)
            self._buffer += received
        text, _, self._buffer = self._buffer.partition(b"\0")
        message: dict[str, Any] = json.loads(text)
        return message

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression; a promise is awaited."""
        answer = self.send(
            "Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            details = answer["exceptionDetails"]
            raise RenderError(f"the page failed: {details.get('exception', details)}")
        return answer["result"].get("value")


@contextlib.contextmanager
def open_page(page: str, size: tuple[int, int]) -> Iterator[Tab]:
    """Open a page in a browser window of ``size`` pixels; yield it after it has loaded."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "page.html"
        path.write_text(page, encoding="utf-8")
        with open_address(path.as_uri(), size) as tab:
            yield tab


@contextlib.contextmanager
def open_address(url: str, size: tuple[int, int]) -> Iterator[Tab]:
    """Open an address in a browser window of ``size`` pixels; yield it after it has loaded."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True)))
        tab = stack.enter_context(_browser(folder, size))
        tab.send("Page.enable")
        tab.send("Page.navigate", url=url)
        tab.evaluate(
            "new Promise(done => document.readyState === 'complete' ? done() "
            ": addEventListener('load', () => done()))"
        )
        yield tab


@contextlib.contextmanager
def _browser(folder: Path, size: tuple[int, int]) -> Iterator[Tab]:
    """Start a browser without a window and yield its tab; the browser ends with the context."""
    with contextlib.ExitStack() as ours, contextlib.ExitStack() as theirs:
        theirs_in, ours_out = _pipe(theirs, ours)
        ours_in, theirs_out = _pipe(ours, theirs)
        process = subprocess.Popen(
            [
                *(sys.executable, "-c", _LAUNCH, str(theirs_in), str(theirs_out), program()),
                "--headless=new",
                "--remote-debugging-pipe",
                f"--user-data-dir={folder / 'profile'}",
                f"--window-size={size[0]},{size[1]}",
                *("--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
                *("--no-first-run", "--disable-extensions", "--disable-background-networking"),
                *("--force-color-profile=srgb", "--hide-scrollbars", "--mute-audio"),
                *(["--no-sandbox"] if os.geteuid() == 0 else []),  # root cannot use the sandbox
            ],
            pass_fds=(theirs_in, theirs_out),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        ours.callback(_end, process)
        theirs.close()  # the browser has its own copies
        yield Tab(ours_out, ours_in)


def _pipe(reader: contextlib.ExitStack, writer: contextlib.ExitStack) -> tuple[int, int]:
    """Return the descriptors of a pipe's reading and writing end; each stack closes its end."""
    high = []
    for end, stack in zip(os.pipe(), (reader, writer), strict=True):
        # Use descriptors from 10 on, so that 3 and 4 are free for the launcher.
        high.append(fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10))
        stack.callback(os.close, high[-1])
        os.close(end)
    return high[0], high[1]


def _end(process: subprocess.Popen[bytes]) -> None:
    """End the browser and its child processes, which form one process group."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def draw(thing: Mesh | DrawnPoints, camera: Camera, style: Style) -> Image:
    """Draw a mesh or points as seen by ``camera``."""
    from manip3d.viewer.page import still_page

    width, height = (SUPERSAMPLING * n for n in style.size)
    with open_page(still_page(thing, camera, style, SUPERSAMPLING), (width, height)) as tab:
        url = tab.evaluate("manip3d")
    return downsampled(picture_of(url), SUPERSAMPLING)


def picture_of(url: str) -> Image:
    """Decode the picture in a data URL."""
    with pillow().open(io.BytesIO(base64.b64decode(url.partition(",")[2]))) as image:
        return np.asarray(image.convert("RGB"))
