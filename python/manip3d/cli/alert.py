"""``manip3d alert``: watch the LiDAR of a drive."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from manip3d._util.times import SECOND_NS
from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import MISSED, Force, Json, MostFrames, OptionalOutput, Quiet
from manip3d.cli.terminal import Terminal, check_output, counted, table
from manip3d.cli.watermark import (
    MOST_POINTS,
    MaxAge,
    MaxPoints,
    OnlyEmbedding,
    OnlySensor,
    OnlySession,
    Picture,
    State,
    key_of,
    of_one_only,
    picture_of,
    policy_of,
)
from manip3d.errors import Error, FormatError, InputError

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d import LidarFrame
    from manip3d.authenticate import Alert, AlertCounts, AlertMonitor, StereoRig
    from manip3d.batch import Summary
    from manip3d.datasets import KittiFrame
    from manip3d.report import AlertTimeline
    from manip3d.simulate import DriveFrame

    Cameras = StereoRig | Mapping[str, StereoRig] | None

app = typer.Typer(
    name="alert",
    help="Watch the LiDAR of a drive: watermark, cameras, forensics, risk.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

EXIT_CODES = {"authentic": 0, "no_trace": 0, "tampered": 3, "undecidable": MISSED}
"""Exit code of each verdict."""

_LIVE_BUDGET = 0.1  # seconds: ten frames a second
_FARTHEST_BEHIND = 1.0  # seconds that a frame may wait for those before it
_SPEED = 10.0  # m/s, where the drive does not tell


@app.callback()
def _group() -> None:
    """Keep ``run`` a command of its own."""


class _Moment(NamedTuple):
    """Scan and pictures of one time: those of one stereo pair, or of several by their names.

    Where the scan cannot be read, the reason stands in its place; reasons of pictures and records
    stand in ``unread``, by the witness that lacks them.
    """

    frame: LidarFrame | str
    pictures: tuple[Any, Any] | None
    record: bytes | None
    velocity: tuple[float, float, float] | None
    time: float | None
    pairs: Mapping[str, tuple[Any, Any]] | None = None
    carrier: Any = None
    unread: Mapping[str, str] = MappingProxyType({})


OVERVIEW = "overview.html"
"""Page of all vehicles, in the folder of the pages of each."""


def _overview(summary: Summary, output: str) -> None:
    """Write the page that shows all vehicles and leads to the page of each."""
    from manip3d import report
    from manip3d.io import local_output

    drives = []
    for row in summary.rows:
        page = str(row["output"]).removeprefix(output.rstrip("/") + "/")
        drives.append({**row, "page": page if page.endswith(".html") else ""})
    with local_output(f"{output.rstrip('/')}/{OVERVIEW}") as path:
        report.write_alert_overview(drives, path)


@app.command("run")
@over_files(
    lambda: (".pcap", ".pcapng", ".mcap"),
    writable=lambda: (".html", ".json"),
    otherwise=".html",
    drives=True,
    prepare=of_one_only,
    depends=key_of,
    finish=_overview,
)
def run(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A folder of a KITTI drive, a recording of a LiDAR (.pcap, .mcap, a ROS bag), or "
            "sim:street?seed=0&frames=10 for a simulated drive.",
        ),
    ],
    key: Annotated[
        list[Path] | None,
        typer.Option(
            "--key",
            help="Key file of the watermark, or a folder of .key files; without one it is not "
            "verified. Give it again for the keys that the sensor had before.",
        ),
    ] = None,
    embedding: OnlyEmbedding = "",
    sensor: OnlySensor = "",
    session: OnlySession = "",
    max_age: MaxAge = None,
    max_points: MaxPoints = MOST_POINTS,
    state: State = None,
    picture: Picture = "",
    output: OptionalOutput = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Calibration of the drive, when not where KITTI has it; of a recording of an "
            "HDL-64E the file of its lasers (db.xml)."
        ),
    ] = None,
    rigs: Annotated[
        Path | None,
        typer.Option(
            help="Stereo pairs of the drive, which may look all around; by default rigs.json in "
            "its folder, else KITTI's front pair."
        ),
    ] = None,
    speed: Annotated[
        float,
        typer.Option(min=0, help="Speed of the car where the drive has no oxts, m/s."),
    ] = _SPEED,
    budget: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            help="Seconds that a verdict may take; by default 0.1 under --live, else as many as it "
            "needs.",
        ),
    ] = None,
    every: Annotated[
        float,
        typer.Option(
            min=0.001, help="Seconds in which cameras and forensics judge at least one frame."
        ),
    ] = 1.0,
    live: Annotated[
        bool,
        typer.Option("--live", help="Play in real time; checks are skipped when time runs out."),
    ] = False,
    frames: MostFrames = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Judge every frame of a drive and follow the risk.

    The watermark is verified in every frame if there is a key, LiDAR and cameras are compared in
    every frame (under --live where there is time), and forensics are asked once a second (under
    --live beside the frames, so that their word comes some frames later). The
    output is a timeline with maps and boxes (.html) or the numbers (.json). The exit code is 0 when
    nothing was found, 3 when a frame was tampered with, and 4 when nothing can be said of a frame
    or when the drive is not one whole session of a watermark (with --frames and --live a part of
    one will do). A picture, record or speed that cannot be read silences no other witness; a drive
    that ends in an error is judged by the frames before it. The verdict is said also where the
    output cannot be written; the exit code is 1 then unless a frame was tampered with.
    Of several drives, each is watched by itself, and the output is a folder with the page of each
    and one of all vehicles, overview.html.

    Example: manip3d alert run signed --key sensor.key -o alert.html
    """
    from manip3d import authenticate, report

    shell = Terminal(as_json=as_json, quiet=quiet)
    if not key:
        _refuse_without_key(
            {"embedding": embedding, "sensor": sensor, "session": session, "max-age": max_age,
             "max-points": None if max_points == MOST_POINTS else max_points,
             "state": state, "picture": picture}
        )  # fmt: skip
    policy = policy_of(
        embedding=embedding,
        sensor=sensor,
        session=session,
        max_age=max_age,
        max_points=max_points,
        order="chain",
        carrier="picture" if picture else "sidecar",
    )
    check_output(output, report.ALERT_KINDS, force=force)
    files = _Files(source, frames, calibration, rigs, picture if key else None, shell.say)
    rig, moments, total = _opened(files)
    timeline = report.AlertTimeline(source)
    tally = authenticate.AlertTally()
    stopped: BaseException | None = None
    last = None
    with ExitStack() as stack:
        marker = None
        if key:
            ring = stack.enter_context(authenticate.KeyRing.open(key))
            marker = stack.enter_context(authenticate.Watermarker(ring, state=state))
        if budget is None:
            budget = _LIVE_BUDGET if live else math.inf
        monitor = authenticate.AlertMonitor(
            marker, policy=policy, rig=rig, budget_s=budget, every_s=every, background=live
        )
        view = stack.enter_context(_View(shell, source, total))
        try:
            for alert in _judged(monitor, moments, speed, live=live):
                tally.add(alert)  # first: showing it can fail
                timeline.add(alert)
                view.show(alert)
            last = monitor.finish()
        except (Error, OSError, KeyboardInterrupt) as error:
            if not tally.num_frames:
                raise
            stopped = error
            if not isinstance(error, KeyboardInterrupt):
                last = monitor.finish()
    if not tally.num_frames:
        raise InputError(f"{source}: expected frames, found none")
    whole = bool(key) and frames is None and not live
    verdict, reason = tally.verdict(whole=whole and stopped is None)
    if last is not None and last.verdict == "tampered" and verdict != "tampered":
        verdict, reason = "tampered", f"forensics: {last.reason}"
    if stopped is not None:
        verdict, reason = _until(stopped, tally.num_frames, verdict, reason)
    counts = monitor.counts
    unwritten: OSError | None = None
    if output is not None:
        try:
            timeline.write(output, verdict=verdict, reason=reason, counts=counts)
            shell.say(f"wrote {output}")
        except OSError as error:
            unwritten = error
            reason += f"; {output} was not written: {error}"
    # Every frame's numbers at once: only where somebody takes them.
    is_taken = as_json or shell.is_collecting
    summary = timeline.summary(verdict, reason, counts) if is_taken else None
    shell.result(summary, lambda console: _show(console, timeline, verdict, reason, counts))
    if isinstance(stopped, KeyboardInterrupt):
        raise stopped
    if unwritten is not None and verdict != "tampered":
        raise unwritten  # an alarm is more than an error, an error more than no alarm
    raise typer.Exit(EXIT_CODES[verdict])


def _refuse_without_key(options: Mapping[str, object]) -> None:
    for name, value in options.items():
        if value not in ("", None):
            raise InputError(f"--{name}: expected with --key, without which nothing is verified")


def _until(stopped: BaseException, count: int, verdict: str, reason: str) -> tuple[str, str]:
    """The verdict of a drive of which only the frames before an error were judged."""
    why = "it was interrupted" if isinstance(stopped, KeyboardInterrupt) else str(stopped)
    ended = f"ended after {counted(count, 'frame')}: {why}"
    return (verdict, f"{reason}; {ended}") if verdict == "tampered" else ("undecidable", ended)


def _judged(
    monitor: AlertMonitor, moments: Iterator[_Moment], speed: float, *, live: bool
) -> Iterator[Alert]:
    """One alert for each frame; in real time, those that come a second too soon are skipped."""
    begin, first, last = time.monotonic(), None, None
    for moment in moments:
        now, waited = moment.time, 0.0
        if live:
            # A drive without times is played as a scanner turns.
            now = (0.0 if last is None else last + _LIVE_BUDGET) if now is None else now
            first = now if first is None else first
            late = time.monotonic() - begin - (now - first)
            if late < 0.0:
                time.sleep(-late)
            waited = max(late, 0.0)
        step = 0.0 if last is None or now is None else max(now - last, 0.0)
        ahead, left, turn = moment.velocity or (speed, 0.0, 0.0)
        motion = (ahead * step, left * step, turn * step)
        is_first, last = last is None, now
        if waited > _FARTHEST_BEHIND and not is_first:
            yield monitor.skip(motion=motion)
            continue
        if isinstance(moment.frame, str):
            yield _judged_unread(monitor, moment.frame, moment, motion)
            continue
        judge = partial(
            monitor.judge, moment.frame, speed_mps=abs(ahead), motion=motion, time_s=now,
            waited_s=waited,
        )  # fmt: skip
        yield _judged_without_refused(judge, moment)


def _judged_unread(
    monitor: AlertMonitor, why: str, moment: _Moment, motion: tuple[float, float, float]
) -> Alert:
    """The alert of a scan that cannot be read, without its carrier where that is refused."""
    judge = partial(monitor.judge_unread, record=moment.record, motion=motion)
    try:
        return judge(why, carrier=moment.carrier)
    except InputError as error:
        if moment.carrier is None:
            raise
        return judge(f"{why}; {error}")


def _judged_without_refused(judge: Callable[..., Alert], moment: _Moment) -> Alert:
    """The alert of a scan; pictures or a carrier that the monitor refuses silence only themselves.

    The monitor refuses before it judges, so that the same frame can be given again.
    """
    pair = moment.pictures or (None, None)
    cameras = {"left": pair[0], "right": pair[1], "pairs": moment.pairs}
    by_cameras = by_carrier = None  # what the last trial with each of them was refused for
    for shown, carrier in (
        (cameras, moment.carrier),
        ({}, moment.carrier),
        (cameras, None),
        ({}, None),
    ):
        unread = dict(moment.unread)
        if not shown and by_cameras is not None:
            unread["cross-modal"] = str(by_cameras)
        if carrier is None and by_carrier is not None:
            unread["watermark"] = str(by_carrier)
        try:
            return judge(record=moment.record, carrier=carrier, unread=unread, **shown)
        except InputError as error:
            refused = error
            by_cameras = error if shown else by_cameras
            by_carrier = error if carrier is not None else by_carrier
    raise refused


class _Files(NamedTuple):
    """The drive that is watched, and the files that belong to it."""

    source: str
    frames: int | None
    calibration: Path | None
    rigs: Path | None
    picture: str | None
    """Folder of the pictures that carry the records; empty: records beside the scans; None: no
    records are read."""
    note: Callable[[str], None]


def _opened(files: _Files) -> tuple[Cameras, Iterator[_Moment], int]:
    """The cameras, the frames, and how many there are."""
    if files.source.startswith("sim:"):
        _refuse_files("a simulated drive", "a folder", files, "calibration", "rigs", "picture")
        return _simulated(files.source, files.frames)
    kind = expect_kind(files.source, "drive", "packets", verb="alert run")
    if kind == "drive":
        return _recorded(files)
    _refuse_files("a recording of a LiDAR", "a KITTI drive", files, "rigs", "picture")
    return _scans_only(files.source, files.calibration, files.frames)


def _refuse_files(got: str, expected: str, files: _Files, *names: str) -> None:
    for name in names:
        if getattr(files, name):
            raise InputError(f"--{name}: expected with {expected}, got {got}")


def _scans_only(
    source: str, calibration: Path | None, frames: int | None
) -> tuple[Cameras, Iterator[_Moment], int]:
    """A recording without cameras, records and speeds."""
    from manip3d import capture
    from manip3d.viewer import scan_address

    address = scan_address(source)
    if address is None:
        raise InputError(f"{source}: expected a drive or a recording of a LiDAR")

    def moments() -> Iterator[_Moment]:
        with capture.open_lidar(address, calibration=calibration) as recording:
            for frame in itertools.islice(recording, frames):
                yield _Moment(frame, None, None, None, _seconds(frame.time_ns))

    return None, moments(), frames or 0


def _simulated(address: str, frames: int | None) -> tuple[Cameras, Iterator[_Moment], int]:
    from manip3d import simulate
    from manip3d.simulate import cameras

    source = iter(simulate.open_drive(address))
    first = next(source)
    around = cameras.surround_rigs()
    rigs: Cameras = around if first.around else around["front"]

    def moments() -> Iterator[_Moment]:
        for frame in itertools.islice(itertools.chain([first], source), frames):
            yield _simulated_moment(frame)

    return rigs, moments(), frames or 0


def _simulated_moment(frame: DriveFrame) -> _Moment:
    one = None if frame.pictures is None else (frame.pictures.left, frame.pictures.right)
    pairs = {name: (pair.left, pair.right) for name, pair in frame.around.items()}
    pictures = None if pairs else one
    return _Moment(frame.scan.frame, pictures, None, frame.velocity, frame.time, pairs or None)


def _recorded(files: _Files) -> tuple[Cameras, Iterator[_Moment], int]:
    from manip3d import authenticate, datasets

    drive = datasets.open_kitti(files.source, calibration=files.calibration)
    if not len(drive):
        raise InputError(f"{files.source}: expected scans, found none")
    chosen = drive[: len(drive) if files.frames is None else files.frames]
    if files.picture:
        picture_of(chosen[0].scan_path, files.source, files.picture)  # the folder is there
    beside = Path(files.source) / authenticate.RIGS_FILE
    path = files.rigs if files.rigs is not None or not beside.is_file() else beside
    around = {} if path is None else authenticate.read_rigs(path)
    pair = None if around else _front_pair(chosen)
    cameras: Cameras = {name: each.rig for name, each in around.items()} or None
    if pair is not None:
        cameras = authenticate.StereoRig.from_calibration(
            chosen[0].calibration(), left=pair[0], right=pair[1]
        )
    numbers = {name: (left, right) for name, (_, left, right) in around.items()}
    return cameras, (_moment(frame, files, pair, numbers) for frame in chosen), len(chosen)


def _moment(
    frame: KittiFrame,
    files: _Files,
    pair: tuple[int, int] | None,
    around: Mapping[str, tuple[int, int]],
) -> _Moment:
    """One frame with what its files hold, and why the others cannot be read."""
    unread: dict[str, str] = {}
    record, carrier, why = None, None, ""
    if files.picture is not None:
        (record, carrier), why = _or_why((None, None), partial(_record_of, frame, files))
    if why:
        unread["watermark"] = why
    pictures, why = (None, "") if pair is None else _or_why(None, partial(frame.pictures, *pair))
    seen = {name: _or_why(None, partial(_pair_of, frame, each)) for name, each in around.items()}
    reasons = [why, *(f"{name}: {why}" for name, (_, why) in seen.items() if why)]
    if any(reasons):
        unread["cross-modal"] = "; ".join(filter(None, reasons))
    pairs = {name: both for name, (both, _) in seen.items() if both is not None}
    velocity, why = _or_why(None, frame.velocity)
    if why:
        files.note(f"{files.source}: frame {frame.name} at the speed of --speed, its own {why}")
    scan, why = _or_why(None, frame.scan)
    return _Moment(
        why if scan is None else scan,
        pictures,
        record,
        velocity,
        _seconds(frame.time_ns),
        pairs or None,
        carrier,
        unread,
    )


def _pair_of(frame: KittiFrame, cameras: tuple[int, int]) -> tuple[Any, Any] | None:
    """The pictures of one of several pairs; bad ones are refused here, not with the good ones."""
    from manip3d.authenticate._stereo import checked_pair

    pictures = frame.pictures(*cameras)
    if pictures is not None:
        try:
            checked_pair(*pictures)
        except InputError as error:
            raise FormatError(str(error)) from error
    return pictures


def _or_why(otherwise: Any, read: Callable[[], Any]) -> tuple[Any, str]:
    """Return what ``read`` gives and no reason, or ``otherwise`` and why it cannot be read."""
    try:
        return read(), ""
    except (FormatError, OSError) as error:
        return otherwise, f"unreadable: {error}"


def _record_of(frame: KittiFrame, files: _Files) -> tuple[bytes | None, Any]:
    """The record of a scan: that beside it, or the picture that carries it."""
    from manip3d import authenticate

    seen = picture_of(frame.scan_path, files.source, files.picture or "")
    if seen is not None:
        return None, authenticate.read_carrier(seen) if seen.is_file() else None
    return authenticate.read_record(authenticate.find_record(frame.scan_path)), None


def _front_pair(frames: Sequence[KittiFrame]) -> tuple[int, int] | None:
    """KITTI's colour pair, else its grey one, if any frame has pictures of it."""
    pairs = ((2, 3), (0, 1))
    return next((p for p in pairs for frame in frames if set(p) <= set(frame.images)), None)


def _seconds(time_ns: int | None) -> float | None:
    return None if time_ns is None else time_ns / SECOND_NS


class _View:
    """The last frames on a terminal, while they are judged."""

    def __init__(self, shell: Terminal, source: str, total: int) -> None:
        self._shell, self._source, self._total = shell, source, total
        self._recent: list[tuple[str, ...]] = []
        self._live: Any = None

    def __enter__(self) -> _View:
        import sys

        if not self._shell.quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.live import Live

            self._live = Live(console=Console(stderr=True), transient=True, auto_refresh=False)
            self._live.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        if self._live is not None:
            self._live.__exit__(None, None, None)

    def show(self, alert: Alert) -> None:
        """Show the next frame."""
        if self._live is None:
            return
        from rich.table import Table

        self._recent = [*self._recent[-14:], _row(alert.record())]
        total = f" of {self._total}" if self._total else ""
        grid = Table(title=f"{self._source}: frame {alert.number + 1}{total}", box=None)
        for name in _COLUMNS:
            grid.add_column(name)
        for row in self._recent:
            style = "red" if row[1] == "tampered" else "yellow" if row[1] == "undecidable" else ""
            grid.add_row(*row, style=style)
        self._live.update(grid, refresh=True)


_COLUMNS = ("frame", "verdict", "attack", "risk", "ms", "why")


def _row(record: dict[str, Any]) -> tuple[str, ...]:
    risk = record["risk"]
    return (
        str(record["frame"]),
        record["verdict"],
        record["attack"],
        f"{risk['level']} {risk['score']:.2f}",
        f"{1e3 * record['seconds']:.0f}",
        record["reason"],
    )


def _show(
    console: Console, timeline: AlertTimeline, verdict: str, reason: str, counts: AlertCounts
) -> None:
    console.print(f"{verdict}: {reason}", soft_wrap=True)
    gravest, count = timeline.gravest(20)
    if gravest:
        console.print()
        table(console, [_row(record) for record in gravest], _COLUMNS)
    if count > len(gravest):
        console.print(f"and {count - len(gravest)} more")
    skipped = ", ".join(f"{name} in {counted(n, 'frame')}" for name, n in counts.skipped.items())
    console.print(
        f"mean {1e3 * counts.mean_s:.0f} ms, slowest {1e3 * counts.slowest_s:.0f} ms, "
        f"{counts.late} late; skipped: {skipped or 'none'}",
        soft_wrap=True,
    )
