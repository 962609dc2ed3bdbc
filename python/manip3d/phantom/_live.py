"""`run_live`: run a live session from a source of frames to a page in the browser."""

from __future__ import annotations

import functools
import ipaddress
import json
import math
import os
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from manip3d._util.callers import caller_level
from manip3d._util.checked import checked
from manip3d._util.extras import require
from manip3d._util.reprs import short_repr
from manip3d.errors import DeviceError, FormatError, InputError
from manip3d.modify import Limb, PoseTracker
from manip3d.phantom._diary import DiaryRecorder
from manip3d.phantom._interrupts import Interrupts
from manip3d.phantom._log import SessionLog
from manip3d.phantom._messages import LIMBS, MESSAGES
from manip3d.phantom._page import live_pages
from manip3d.phantom._recorder import GameSummary
from manip3d.phantom._session import NO_COLOR, LiveSession
from manip3d.phantom.games import GAMES
from manip3d.serve import (
    Certificate,
    LocalServer,
    StreamClient,
    kept_certificate,
    make_certificate,
    read_message,
)
from manip3d.viewer.phantom import limb_of

if TYPE_CHECKING:
    from manip3d.camera import Intrinsics
    from manip3d.capture import RgbdSource
    from manip3d.rgbd import RgbdCalibration, RgbdFrame

    _Found = RgbdFrame | str | None

__all__ = ["LiveReport", "run_live", "simulated_patient"]

_ENDLESS = 1 << 31  # number of frames of a simulated person, more than any session has
_MAX_UNREAD = 100  # number of consecutive unreadable frames after which a recording is given up
_FRAMES_WITHOUT_COLOR = 10  # number after which a source counts as one without colour
_AGAIN_S = 1.0  # seconds between attempts to open a camera that was disconnected


@dataclass(frozen=True)
class LiveReport:
    """Result of `run_live`.

    Attributes
    ----------
    affected : str
        The limb that was replaced at the end; the page can choose another one.
    frames : int
        Number of frames that were shown.
    seconds : float
        Duration of the session.
    first_frame_s : float or None
        Seconds from the call to the first published frame.
    states : mapping of str to int
        Number of frames in each state of the phantom limb.
    stage_ms : mapping of str to float
        Mean time of pipeline, rules and encoder over the last frames, milliseconds.
    clients : sequence of mapping
        Result of `manip3d.serve.LocalServer.report`.
    refused : mapping of str to int
        Number of requests that the server refused, by reason.
    games : sequence of GameSummary
        Games of the session.
    unkept : sequence of str
        Descriptions of entries that could not be written to the diary, with the reason.
    lost_log_lines : int
        Number of log lines that could not be written, for example because the disk was full.
    """

    affected: str
    frames: int
    seconds: float
    first_frame_s: float | None
    states: Mapping[str, int]
    stage_ms: Mapping[str, float]
    clients: tuple[Mapping[str, Any], ...]
    refused: Mapping[str, int]
    games: tuple[GameSummary, ...]
    unkept: tuple[str, ...] = ()
    lost_log_lines: int = 0

    __repr__ = short_repr


@checked
def simulated_patient(limb: str, game: str | None = None) -> str:
    """Return the address of a simulated person who has lost a limb and exercises the other one.

    Parameters
    ----------
    limb : str
        ``left_arm``, ``right_arm``, ``left_leg`` or ``right_leg``: the limb that is missing.
    game : str, optional
        Key of `manip3d.phantom.games.GAMES`; the person makes the movement of this game.

    Returns
    -------
    str
        Address for `manip3d.capture.open_rgbd`.

    Raises
    ------
    InputError
        There is no such limb or game.

    Examples
    --------
    >>> from manip3d.phantom import simulated_patient
    >>> simulated_patient("left_leg")
    'sim:body?amputated=left-leg&motion=knee-extension&tracker=kinect-v2'
    >>> simulated_patient("left_leg", "piano")
    'sim:body?amputated=left-leg&motion=stepping&sitting=yes&tracker=kinect-v2'
    """
    if limb not in LIMBS:
        raise InputError(f"limb: expected one of {', '.join(LIMBS)}, got {limb!r}")
    if game is not None and game not in GAMES:
        raise InputError(f"game: expected one of {', '.join(GAMES)}, got {game!r}")
    motion = "arm-raise" if limb.endswith("arm") else "knee-extension"
    if not limb.endswith("arm"):
        motion = {"pedal": "dorsiflexion", "piano": "stepping&sitting=yes"}.get(game or "", motion)
    return f"sim:body?amputated={limb.replace('_', '-')}&motion={motion}&tracker=kinect-v2"


@checked
def run_live(
    source: str | None = None,
    *,
    affected: Limb | None = None,
    game: str | None = None,
    difficulty: int = 1,
    seed: int = 0,
    host: str = "127.0.0.1",
    port: int = 0,
    certificate: str | os.PathLike[str] | None = None,
    seconds: float | None = None,
    jpeg_quality: int = 80,
    gain: float = 1.0,
    pose: bool = False,
    camera: Intrinsics | RgbdCalibration | None = None,
    units_per_metre: float | None = None,
    rate: float | None = None,
    diary: str | os.PathLike[str] | None = None,
    participant: str | None = None,
    diary_key: str | os.PathLike[str] | None = None,
    log: str | os.PathLike[str] | None = None,
    on_start: Callable[[str, Certificate | None], object] | None = None,
    open_page: Callable[[str], object] | None = None,
) -> LiveReport:
    """Show a person with a phantom limb in a browser, live, with a game.

    Research software, no medical device.

    Parameters
    ----------
    source : str, optional
        Address or path for `manip3d.capture.open_rgbd`: a camera, a recording (played in real time,
        repeatedly) or a simulated person; default: `simulated_patient`.
    affected : str, optional
        The limb to replace. Default: the limb of the participant's enrolment, else the limb that a
        simulated person has lost, else the right arm, or the right leg for a game of legs.
    game : str, optional
        Key of `manip3d.phantom.games.GAMES`; default: a game for that limb.
    difficulty, seed : int
        Difficulty and seed of the first game.
    host : str
        Address of this machine at which the page is served. Other machines, such as a headset, can
        reach an address that is not a loopback address; the connection is encrypted then.
    port : int
        Port of the page; 0: a free one.
    certificate : path, optional
        File with private key and certificate (PEM) of an encrypted connection; made if it does not
        exist. By default a new certificate is made for each session whose ``host`` is not a
        loopback address, and browsers ask about each new certificate.
    seconds : float, optional
        Duration of the session; default: until Ctrl-C. Another Ctrl-C ends the wait for diary
        entries to be written.
    jpeg_quality : int
        JPEG quality of the colour images, 1 to 100.
    gain : float
        Virtual enhancement, see `LiveSession`; the page can change it.
    pose : bool
        Find the person's joints in the colour images with `manip3d.modify.PoseTracker`, for cameras
        and recordings without skeletons. A source without colour images is warned about.
    camera, units_per_metre, rate
        Same as for `manip3d.capture.open_rgbd`, for a folder of images without calibration or
        times.
    diary, participant, diary_key : path, str, path, optional
        A diary file, the pseudonym of the participant who plays, and the key file of an encrypted
        diary. A participant can have only one live session at a time, because ratings of two
        sessions would not be compared. Games and ratings of pain are written at once, by a thread
        of their own; entries that are lost are listed in the report. Games of a simulated person
        are marked, and `manip3d.diary.analyse` and `manip3d.diary.adherence` leave them out.
    log : path, optional
        File of JSON lines, one every ten seconds: frames, states, latency, times of stages, memory.
    on_start : callable(str, Certificate or None), optional
        Called with the page's address, as soon as it can be opened, and its certificate.
    open_page : callable(str), optional
        Called with a second address for a browser on this machine. Each address admits one browser,
        so that a headset can still use the first one.

    Returns
    -------
    LiveReport

    Raises
    ------
    InputError, FormatError, DeviceError, OSError
        The source cannot be opened (a camera that is disconnected later is waited for), the port is
        in use, the participant has a live session in another program, or ``log`` is a file with
        other content.
    MissingExtraError
        aiohttp or, for simulated people, Open3D is not installed; SQLAlchemy for a diary,
        MediaPipe for ``pose``.

    Examples
    --------
    >>> from manip3d import phantom
    >>> report = phantom.run_live(affected="left_arm", seconds=60)  # doctest: +SKIP
    >>> report.frames  # doctest: +SKIP
    """
    if (diary is None) != (participant is None):
        raise InputError("diary, participant: expected both or none")
    if diary_key is not None and diary is None:
        raise InputError("diary_key: can only be given with diary, got none")
    if seconds is not None and not seconds > 0:
        raise InputError(f"seconds: expected > 0, got {seconds}")
    from manip3d.capture import open_rgbd, rgbd_address

    began = time.monotonic()
    written = SessionLog(log)
    if source is not None:
        source = rgbd_address(source) or source
    limb = affected or _default_limb(source, game)
    if source is None or source.startswith("sim:"):
        require("live")
    unkept: list[str] = []
    # `opened` is closed before the server stops, and after any error.
    with Interrupts() as interrupts, ExitStack() as opened:
        recorder = None
        if diary is not None:
            recorder = DiaryRecorder(diary, str(participant), diary_key, source or "sim:")
            ended = recorder.end
            opened.callback(lambda: unkept.extend(ended(interrupts.is_hurried)))
            if affected is None and recorder.limb in LIMBS:
                limb = recorder.limb
        address = source or simulated_patient(limb, game)
        session = LiveSession(
            limb,  # type: ignore[arg-type]
            game=game,
            difficulty=difficulty,
            seed=seed,
            jpeg_quality=jpeg_quality,
            gain=gain,
            recorder=recorder,
            pose=pose,
        )
        played = _PlayedPage()

        def on_message(client: StreamClient, text: str) -> None:
            if hear(session, client, text, lambda: server.new_code()) == "ready":
                played.note(client)

        tracker = PoseTracker() if pose else None
        if tracker is not None:
            opened.callback(tracker.close)
        end = math.inf if seconds is None else began + seconds
        begin = functools.partial(
            open_rgbd, speed=1.0, camera=camera, units_per_metre=units_per_metre, rate=rate
        )
        feed = _frames(address, end, begin, opened)
        pages = live_pages(limb, address, asks=recorder is not None)
        made = _certificate(host, certificate)
        server = LocalServer(pages, on_message, host=host, port=port, certificate=made)
        show = _Show(session, server, tracker, began)
        with written as journal, server:
            if recorder is not None:
                session.halt(recorder.start(played.latency))
            try:
                _announce(server, on_start, open_page)
                show.run(feed, end, journal)
            except KeyboardInterrupt:  # the usual end of a session without `seconds`
                pass
            finally:
                interrupts.note_end()
                session.end()
                opened.close()
    return show.report(unkept, journal)


def _default_limb(source: str | None, game: str | None) -> str:
    """Return the limb that a simulated person has lost, else the right limb that the game is for.

    The limb of a participant of the diary takes precedence over both.
    """
    if source:
        return limb_of(source)
    plays_legs = game is not None and game in GAMES and GAMES[game].limbs == "legs"
    return "right_leg" if plays_legs else "right_arm"


def _announce(
    server: LocalServer,
    on_start: Callable[[str, Certificate | None], object] | None,
    open_page: Callable[[str], object] | None,
) -> None:
    """Pass on the page's addresses, each of which admits one browser."""
    if on_start is not None:
        on_start(server.new_url(), server.certificate)
    if open_page is not None:
        open_page(server.new_url())


@dataclass
class _Show:
    """Passes frames from the source through the session to the page, and counts them."""

    session: LiveSession
    server: LocalServer
    tracker: PoseTracker | None
    began: float
    frames: int = 0
    first_frame_s: float | None = None
    states: dict[str, int] = field(default_factory=dict)
    _has_color: bool = False
    _without_color: int = 0

    def run(self, feed: Iterator[_Found], end: float, journal: SessionLog) -> None:
        """Show frames until the source ends, or the time ``end`` of `time.monotonic` has come."""
        for found in feed:
            if found is None:
                self._begin_again()
                continue
            self._take(found)
            journal.tell(self.session, self.server, self.frames, self.states)
            if time.monotonic() >= end:
                return

    def _begin_again(self) -> None:
        self.session.restart()
        if self.tracker is not None:
            self.tracker.reset()

    def _take(self, found: RgbdFrame | str) -> None:
        grabbed_ns = 0 if isinstance(found, str) else found.grabbed_ns
        # For cameras this includes the time that the frame waited to be read.
        captured_ns = grabbed_ns or time.time_ns()
        sequence = self.session.sequence
        message = self._message(found, captured_ns)
        if message is None:
            return
        self.server.publish(message, sequence=sequence, captured_ns=captured_ns)
        state = self.session.state
        self.states[state] = self.states.get(state, 0) + 1
        self.frames += not isinstance(found, str)
        if self.first_frame_s is None:
            self.first_frame_s = time.monotonic() - self.began

    def _message(self, found: RgbdFrame | str, captured_ns: int) -> bytes | None:
        if isinstance(found, str):
            return self.session.notice(found)
        if self.tracker is not None:
            self._check_color(found)
            if found.color is not None:
                found = self.tracker.annotate(found)
        return self.session.process(found, captured_ns=captured_ns)

    def _check_color(self, frame: RgbdFrame) -> None:
        """Warn once that the joints cannot be found if no frame so far had a colour image."""
        if frame.color is not None:
            self._has_color = True
        elif not self._has_color:
            self._without_color += 1
            if self._without_color == _FRAMES_WITHOUT_COLOR:
                warnings.warn(NO_COLOR, stacklevel=caller_level())

    def report(self, unkept: Iterable[str], journal: SessionLog) -> LiveReport:
        """Return the counts of a session that is over."""
        return LiveReport(
            affected=self.session.affected,
            frames=self.frames,
            seconds=time.monotonic() - self.began,
            first_frame_s=self.first_frame_s,
            states=self.states,
            stage_ms=self.session.stage_ms,
            clients=tuple(self.server.report()),
            refused=dict(self.server.refused),
            games=tuple(self.session.summaries),
            unkept=tuple(unkept),
            lost_log_lines=journal.lost_lines,
        )


class _PlayedPage:
    """The page on which the patient plays: the one that started the last game."""

    def __init__(self) -> None:
        self._client: StreamClient | None = None

    def note(self, client: StreamClient) -> None:
        """Note that a client has started a game."""
        self._client = client

    def latency(self) -> float | None:
        """Return the latency (95 %, milliseconds) of this page; None if it is not known."""
        times = None if self._client is None else self._client.report()["latency_ms"]
        return None if times is None else round(float(times[1]), 1)


def _certificate(host: str, path: str | os.PathLike[str] | None) -> Certificate | None:
    if path is not None:
        return kept_certificate(path, host)
    try:
        is_here = ipaddress.ip_address(host).is_loopback
    except ValueError:
        is_here = True  # ``host`` is not an address, and LocalServer will refuse it
    return None if is_here else make_certificate(host)


def hear(session: LiveSession, client: StreamClient, text: str, new_code: Callable[[], str]) -> str:
    """Handle a message of a page and return its name.

    All messages but those about the connection go to the session.

    ``new_code`` makes a code that admits another screen. A message with a ``number`` must not be
    lost: it is answered at once (``taken``) and when it is written to the diary (``heard``). Until
    then the page sends it again over each new connection.

    Raises
    ------
    FormatError
        The message is not one of `MESSAGES`.
    """
    name, fields = read_message(text, MESSAGES)
    if name == "ack":
        # A page does not know the offset of its clock before the first answer to ``clock``.
        decoded = fields.get("decoded_ms")
        client.acknowledge(int(fields["sequence"]), None if decoded is None else float(decoded))
    elif name == "bad":
        client.fail()
    elif name == "clock":  # a page on another machine measures the offset of its clock
        client.say(json.dumps({"clock": [fields["sent_ms"], time.time_ns() / 1e6]}))
    elif name == "screen":
        client.say(json.dumps({"code": new_code()}))
    else:
        answer = functools.partial(client.say, json.dumps({"heard": fields.get("number")}))
        session.command(name, fields, done=answer if "number" in fields else None)
        if "number" in fields:  # the message has arrived, even if writing it takes long
            client.say(json.dumps({"taken": fields["number"]}))
    return name


def _frames(
    address: str, end: float, begin: Callable[[str], RgbdSource], opened: ExitStack
) -> Iterator[_Found]:
    """Open a source by ``begin``, and return an iterator over its frames in real time.

    Errors of opening are raised at once, not with the first frame. The iterator yields a sentence
    if there is no frame at the moment, and None before a recording is repeated. Waiting for a frame
    stops at the time ``end`` of `time.monotonic`. ``opened`` closes the source.
    """
    is_simulated = address.startswith("sim:body")
    has_end = is_simulated and "frames" in parse_qs(urlsplit(address).query)
    if is_simulated and not has_end:
        address += f"{'&' if '?' in address else '?'}frames={_ENDLESS}"
    # If the server cannot start, the iterator is never begun, and does not close the source.
    source = opened.enter_context(begin(address))
    if source.num_frames == 0:
        raise InputError(f"{address}: expected frames, found none")
    again = None if has_end else functools.partial(begin, address)
    feed = _captured(address, source, end, again)
    opened.callback(feed.close)
    return feed


def _captured(
    address: str, source: RgbdSource, end: float, again: Callable[[], RgbdSource] | None
) -> Generator[_Found, None, None]:
    """Yield the frames of a source, and repeat it from its end.

    ``again`` opens the source again; None: it is not repeated.
    """
    while True:
        seen = False
        with source:
            for found in _until_the_end(source, end):
                seen = seen or not isinstance(found, str)
                yield found
        if time.monotonic() >= end:
            return
        if not seen:
            raise InputError(f"{address}: expected frames, found none")
        if again is None:
            return
        yield None
        source = again()


def _until_the_end(source: RgbdSource, end: float) -> Iterator[RgbdFrame | str]:
    """Yield the frames of a source until its end; wait for a camera that was disconnected."""
    is_there = True
    unread = 0
    while True:
        asked = time.monotonic()
        # Wait for a first frame even if opening the source took longer than the session may last.
        wait = min(_AGAIN_S, end - asked) if asked < end else _AGAIN_S
        try:
            if not is_there:
                source.start()
                is_there = True
            frame = source.read(wait)
        except DeviceError:
            is_there = False
            yield "The camera is gone: check its cable."
            time.sleep(_AGAIN_S)
            continue
        except (FormatError, OSError):
            unread += 1
            if unread > _MAX_UNREAD:
                raise
            is_there = not source.is_live
            yield "A frame of the recording cannot be read."
            continue
        if frame is not None:
            unread = 0
            yield frame
            continue
        now = time.monotonic()
        if now - asked < 0.9 * wait or now >= end:  # the recording or the session is over
            return
        if source.is_live:  # a slow recording needs no message
            yield "The camera gives no frames."
