"""``manip3d alert``: watch the LiDAR of a drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from manip3d.cli.kinds import expect_kind
from manip3d.cli.many import over_files
from manip3d.cli.options import MISSED, Force, Json, MostFrames, OptionalOutput, Quiet
from manip3d.cli.terminal import Terminal, check_output, count, counted, naming_options, table
from manip3d.cli.watermark import (
    MAX_POINTS,
    MaxAge,
    MaxPoints,
    OnlyEmbedding,
    OnlySensor,
    OnlySession,
    Picture,
    State,
    key_of,
    of_one_only,
    policy_of,
)
from manip3d.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console

    from manip3d.authenticate import Alert, AlertCounts, DriveWatch, WatchedDrive, WitnessReport
    from manip3d.batch import Summary
    from manip3d.report import AlertTimeline

app = typer.Typer(
    name="alert",
    help="Watch the LiDAR of a drive by watermark, cameras and forensics.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

EXIT_CODES = {"authentic": 0, "no_trace": 0, "tampered": 3, "undecidable": MISSED}
"""Exit code of each verdict."""

_SPEED = 10.0  # default speed of the car in m/s, for drives that do not state it


@app.callback()
def _group() -> None:
    """Keep ``run`` a subcommand; Typer would drop its name without a callback."""


OVERVIEW = "overview.html"
"""Name of the page of all vehicles, in the folder with the page of each."""


def _overview(summary: Summary, output: str) -> None:
    """Write the page of all vehicles, with links to the page of each."""
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
    lambda: (".pcap", ".pcapng", ".osf", ".mcap"),
    writable=lambda: (".html", ".json"),
    otherwise=".html",
    drives=True,
    prepare=of_one_only,
    depends=key_of,
    finish=_overview,
    finished=OVERVIEW,
    columns=("source", "verdict", "reason"),
)
def run(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A folder of a KITTI drive, a recording of a LiDAR (.pcap, .osf, .mcap, a ROS "
            "bag), or sim:street?seed=0&frames=10 for a simulated drive.",
        ),
    ],
    key: Annotated[
        list[Path] | None,
        typer.Option(
            "--key",
            help="Key file of the watermark, or a folder of .key files; without a key the "
            "watermark is not verified. Repeat the option for earlier keys of the sensor.",
        ),
    ] = None,
    embedding: OnlyEmbedding = None,
    sensor: OnlySensor = "",
    session: OnlySession = "",
    max_age: MaxAge = None,
    max_points: MaxPoints = MAX_POINTS,
    state: State = None,
    picture: Picture = "",
    output: OptionalOutput = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Calibration of the drive, if it is not where KITTI has it; for a recording of an "
            "HDL-64E, the file of its lasers (db.xml)."
        ),
    ] = None,
    rigs: Annotated[
        Path | None,
        typer.Option(
            help="Stereo pairs of the drive, which may look all around; by default rigs.json in "
            "its folder, else KITTI's front pair. For a ROS bag the file must hold one pair, which "
            "replaces the calibration in the bag."
        ),
    ] = None,
    cameras: Annotated[
        str | None,
        typer.Option(
            metavar="LEFT,RIGHT",
            help="Topics of the rectified pictures of a stereo pair in a ROS bag, or none; by "
            "default the only pair that the bag holds with its calibration.",
        ),
    ] = None,
    speed: Annotated[
        float,
        typer.Option(min=0, help="Speed of the car if the drive has no oxts, m/s."),
    ] = _SPEED,
    budget: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            help="Seconds that the verdict on a frame may take; by default 0.1 with --live, else "
            "without a limit.",
        ),
    ] = None,
    every: Annotated[
        float,
        typer.Option(
            min=0.001, help="Cameras and forensics judge at least one frame in this many seconds."
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

    Three checks judge the frames. The watermark is verified in every frame if there is a key.
    LiDAR and cameras are compared in every frame (with --live, if there is time). Forensics judge
    one frame a second, each frame that the others cannot judge, and each frame that only the
    cameras accuse. With --budget, forensics judge at most one accused frame more each second. With
    --live they work in the background, so that their verdict comes some frames later, and frames
    that only the cameras accuse come first. If a picture, record or speed cannot be read, or the
    calibration is missing or of pictures of another size, the other checks still judge the frame. A
    drive that ends in an error is judged by the frames before the error.

    The output is a timeline with maps and boxes (.html) or the numbers (.json). The exit code is 0
    if nothing was found, 3 if a frame was tampered with, and 4 if a frame cannot be judged or the
    drive is not one whole session of a watermark (with --frames or --live, a part of a session is
    enough). If the output cannot be written, the verdict is printed all the same, and the exit code
    is 1 unless a frame was tampered with. For several drives the output is a folder with a page for
    each and a page of all vehicles, overview.html.

    Example: manip3d alert run signed --key sensor.key -o alert.html
    """
    from manip3d import authenticate, report

    shell = Terminal(as_json=as_json, quiet=quiet)
    if not key:
        _refuse_without_key(
            {"embedding": embedding, "sensor": sensor, "session": session, "max-age": max_age,
             "max-points": None if max_points == MAX_POINTS else max_points,
             "state": state, "picture": picture}
        )  # fmt: skip
    for name, value in {"speed": speed, "every": every}.items():
        if not math.isfinite(value):
            raise InputError(f"--{name}: expected a finite number, got {value}")
    policy = policy_of(
        embedding=embedding,
        sensor=sensor,
        session=session,
        max_age=max_age,
        max_points=max_points,
        order="chain",
        carrier="picture" if picture else "sidecar",
    )
    check_output(output, report.EVIDENCE_KINDS, force=force)
    drive = _opened(
        _Files(source, frames, calibration, rigs, cameras, picture if key else None, shell.say)
    )
    timeline = report.AlertTimeline(source)
    with ExitStack() as stack:
        marker = None
        if key:
            ring = stack.enter_context(authenticate.KeyRing.open(key))
            marker = stack.enter_context(authenticate.Watermarker(ring, state=state))
        if budget is None:
            budget = authenticate.TURN_S if live else math.inf
        with naming_options(budget_s="budget"):
            monitor = authenticate.AlertMonitor(
                marker, policy=policy, rig=drive.rig, budget_s=budget, every_s=every,
                background=live,
            )  # fmt: skip
        view = stack.enter_context(_View(shell, source, drive.num_frames))
        log = _FrameLog(timeline, view)
        watched = authenticate.watch_drive(
            monitor, drive.moments, speed_mps=speed, live=live,
            whole=bool(key) and frames is None and not live, show=log.add,
        )  # fmt: skip
    if log.error is not None:
        watched = replace(watched, reason=f"{watched.reason}; not kept: {log.error}")
    if log.num_blind:
        share = f"{count(log.num_blind)} of {counted(watched.num_frames, 'frame')}"
        shell.warn(f"the cameras could not judge {share}: {log.why_blind}")
    _conclude(shell, log, watched, monitor.counts, output, as_json=as_json)


class _FrameLog:
    """Shows every judged frame, and adds it to the timeline until writing to the disk fails."""

    def __init__(self, timeline: AlertTimeline, view: _View) -> None:
        self.timeline = timeline
        self.error: OSError | None = None
        """Error that left the timeline incomplete, or None; the drive is still judged."""
        self.num_blind = 0
        """Number of frames that the cameras could not judge."""
        self.why_blind = ""
        """Reason why the cameras could not judge the first of these frames."""
        self._view = view

    def add(self, alert: Alert) -> None:
        """Add the next frame."""
        self._view.show(alert)
        cameras = alert.witnesses["cross-modal"]
        if _is_blind(cameras):
            if self.num_blind == 0:
                self.why_blind = cameras.reason
            self.num_blind += 1
        if self.error is not None:
            return
        try:
            self.timeline.add(alert)
        except OSError as error:
            self.error = error


def _is_blind(cameras: WitnessReport) -> bool:
    """Return whether a frame has pictures that could not be judged."""
    from manip3d.authenticate._alert_verdict import NO_PAIR

    is_left_out = cameras.verdict == "absent" and cameras.reason != NO_PAIR
    return cameras.verdict == "undecidable" or is_left_out


def _conclude(
    shell: Terminal,
    log: _FrameLog,
    watched: DriveWatch,
    counts: AlertCounts,
    output: Path | None,
    *,
    as_json: bool,
) -> None:
    """Write and print the result, and exit with the code of the verdict.

    An incomplete timeline is not written.
    """
    verdict, reason = watched.verdict, watched.reason
    timeline, unwritten = log.timeline, log.error
    if output is not None and unwritten is None:
        try:
            timeline.write(output, verdict=verdict, reason=reason, counts=counts)
        except OSError as error:
            unwritten = error
            reason += f"; {output} was not written: {error}"
        else:
            with suppress(OSError):
                shell.say(f"wrote {output}")
    # The summary holds all frames, so that it is made only if an output needs it.
    is_taken = as_json or shell.is_collecting
    summary = timeline.summary(verdict, reason, counts) if is_taken else None
    shell.result(summary, lambda console: _show(console, timeline, verdict, reason, counts))
    if isinstance(watched.stopped, KeyboardInterrupt):
        raise watched.stopped
    if unwritten is not None and verdict != "tampered":
        raise unwritten  # the exit code of an alarm has precedence over that of an error
    raise typer.Exit(EXIT_CODES[verdict])


def _refuse_without_key(options: Mapping[str, object]) -> None:
    for name, value in options.items():
        if value not in ("", None):
            raise InputError(
                f"--{name}: can only be given with --key, because nothing is verified without a key"
            )


class _Files(NamedTuple):
    """The source that is watched, and its options."""

    source: str
    frames: int | None
    calibration: Path | None
    rigs: Path | None
    cameras: str | None
    picture: str | None
    """Folder of the pictures that carry the records; empty: the records are files beside the scans;
    None: no records are read."""
    note: Callable[[str], None]


def _opened(files: _Files) -> WatchedDrive:
    """Open the drive with its cameras."""
    from manip3d import authenticate, capture, datasets, simulate

    if files.source.startswith("sim:"):
        _refuse_files("a simulated drive", "a folder", files, "calibration", "rigs", "picture")
        _refuse_files("a simulated drive", "a ROS bag", files, "cameras")
        return simulate.watched_street(files.source, frames=files.frames)
    kind = expect_kind(files.source, "drive", "packets", verb="alert run")
    if kind == "drive":
        _refuse_files("a KITTI drive", "a ROS bag", files, "cameras")
        carriers = None
        if files.picture:
            with naming_options("picture"):
                carriers = authenticate.drive_pictures(files.source, files.picture)
        return datasets.watched_kitti(
            files.source, calibration=files.calibration, rigs=files.rigs, carriers=carriers,
            records=files.picture is not None, frames=files.frames,
            note=lambda text: files.note(f"{files.source}: {text}; that of --speed is taken"),
        )  # fmt: skip
    _refuse_files("a recording of a LiDAR", "a KITTI drive", files, "picture")
    address = capture.scan_address(files.source)
    if address is None:
        raise InputError(f"{files.source}: expected a drive or a recording of a LiDAR")
    with naming_options("calibration", "cameras", "rigs"):
        return capture.watched_recording(
            address, calibration=files.calibration, rigs=files.rigs, cameras=files.cameras,
            frames=files.frames, note=lambda text: files.note(f"{files.source}: {text}"),
        )  # fmt: skip


def _refuse_files(got: str, expected: str, files: _Files, *names: str) -> None:
    for name in names:
        if getattr(files, name):
            raise InputError(f"--{name}: can only be given with {expected}, got {got}")


class _View:
    """Live table of the last judged frames on a terminal."""

    def __init__(self, shell: Terminal, source: str, total: int) -> None:
        self._shell, self._source, self._total = shell, source, total
        self._recent: list[tuple[str, ...]] = []
        self._live: Any = None

    def __enter__(self) -> _View:
        import sys

        if not self._shell.quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.live import Live

            console = Console(stderr=True, markup=False, emoji=False)
            self._live = Live(console=console, transient=True, auto_refresh=False)
            try:
                self._live.__enter__()
            except (OSError, ValueError):
                self._end()
        return self

    def __exit__(self, *error: object) -> None:
        self._end()

    def _end(self) -> None:
        """Restore the terminal, and ignore errors if it was closed."""
        live, self._live = self._live, None
        if live is not None:
            with suppress(OSError, ValueError):
                live.__exit__(None, None, None)

    def show(self, alert: Alert) -> None:
        """Show the next frame."""
        if self._live is None:
            return
        from rich.table import Table
        from rich.text import Text

        self._recent = [*self._recent[-14:], _row(alert.record())]
        total = f" of {self._total}" if self._total else ""
        title = f"{self._source}: frame {alert.number + 1}{total}"
        grid = Table(title=Text(title, style="table.title"), box=None)
        for name in _COLUMNS:
            grid.add_column(name)
        for row in self._recent:
            verdict = row[_COLUMNS.index("verdict")]
            style = {"tampered": "red", "undecidable": "yellow"}.get(verdict, "")
            grid.add_row(*(Text(cell) for cell in row), style=style)
        try:
            self._live.update(grid, refresh=True)
        # The terminal was closed, or cannot encode the text; the drive is still judged.
        except (OSError, ValueError):
            self._end()


_COLUMNS = ("frame", "scan", "verdict", "attack", "risk", "ms", "why")


def _row(record: dict[str, Any]) -> tuple[str, ...]:
    risk = record["risk"]
    return (
        str(record["frame"]),
        record["scan"],
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
